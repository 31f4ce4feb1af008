"""What fast charge beside electrodes leaves out: its images are taken to move with it, as they do along uniform metal alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..conductors.arms import arms_of_boxes
from ..errors import InputError
from ..mesh.domain import AXES
from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from ..particles.frame import LABORATORY, Frame
from ..scene.electrodes import Electrode
from ..stages.diagnostics import moments
from ..units import VACUUM_PERMITTIVITY
from .charge_images import rms_force
from .meshed import MeshedParticles
from .remarks import LARGE
from .setup import Setup
from .solution import Solution

EVERY = 16  # steps from one look to the next
MOST = 0.25  # of the force: what is estimated to first order is small beside it


def check_images(beam: MeshedParticles, solution: Solution, step: int, setup: Setup) -> None:
    """Note how much of the force of fast charge is neglected beside electrodes, every so many steps. Collective.

    Raises InputError on all ranks if that is so much that the estimate does not hold.
    """
    frames = solution.frames
    if not setup.electrodes or step % EVERY > 0 or frames.only == LABORATORY:
        return
    fields = neglected(beam, solution)
    own = rms_force(solution, beam.particles, setup.clouds)
    if fields == 0 or own == 0:
        setup.remarks.note("electrodes are uniform along the motion, so that images of the charge move with it")
        return
    share, axis = fields / own, AXES[frames.axis]
    remark = f"electrodes are not uniform along the motion: about {share:.1%} of the force is neglected"
    setup.remarks.note(f"{remark} at step {step}") if step == 0 else None
    if share > MOST:
        raise InputError(
            f"{remark} at step {step}, more than an estimate holds for: images in surfaces across {axis} do not move with the "
            "charge; leave such surfaces out, or enlarge the holes in them"
        )
    if share > LARGE:
        setup.remarks.remark(
            f"{remark} at step {step}, since images in surfaces across {axis} do not move with the charge, as the solve takes "
            "them to; codes that solve Maxwell's equations follow them",
            "images beside electrodes",
        )


def neglected(beam: MeshedParticles, solution: Solution) -> float:
    """Return about the field, V/m, that is wrong at the charge. Collective.

    Charge that is induced on metal whose normal n points along the motion stays where it is, or moves against the charge, as
    in a plane. Its field across the motion, times 2 β² |n·β̂|, is what an image that moves along leaves out at most, in
    electric and magnetic force together; along the motion they are the same. The mean square is that over a Gaussian of the
    rms sizes, by six places.
    """
    hierarchy, electrodes = solution.rho.hierarchy, beam.drive.electrodes
    size = moments(hierarchy.comm, beam.particles, domain=hierarchy.domain)
    steps = np.sqrt(3) * np.concatenate([np.eye(3), -np.eye(3)])
    points, total = size.mean + steps * np.nan_to_num(size.rms), np.zeros((6, 3))
    walls = _walls(hierarchy, electrodes)
    for frame, phi in zip(solution.frames.members, solution.parts or (solution.phi,), strict=True):
        if frame != LABORATORY:
            total += 2 * frame.beta[frame.axis] ** 2 * _field_across(phi, frame, walls, points)
    total = np.delete(hierarchy.comm.allreduce(total), solution.frames.axis, axis=1)
    return float(np.sqrt((total**2).sum(axis=1).mean()))


class _LevelWalls(NamedTuple):
    """Where cut arms of a level's own, uncovered cells meet metal."""

    cell: np.ndarray  # (m,) of this rank's cells of the level
    place: np.ndarray  # (m, 3) m
    normal: np.ndarray  # (m, 3)
    axis: np.ndarray  # (m,) of the arm
    length: np.ndarray  # (m,) of it until the metal, m


def _walls(hierarchy: Hierarchy, electrodes: Sequence[Electrode]) -> list[_LevelWalls]:
    out: list[_LevelWalls] = []
    for level in range(hierarchy.levels):
        patches = [patch for patch in Field(hierarchy).patches if patch.level == level]
        boxes = np.array([[*patch.lower, *patch.upper] for patch in patches], np.int64).reshape(-1, 6)
        spacing = hierarchy.spacing(level)
        arms, _ = arms_of_boxes(electrodes, boxes, hierarchy.domain.lower, spacing)
        walls = arms.crossings(electrodes, boxes, hierarchy.domain.lower, spacing)
        sizes = np.concatenate([[0], np.cumsum((boxes[:, 3:] - boxes[:, :3] + 1).prod(axis=1))])
        box = np.repeat(np.arange(len(boxes)), np.diff(arms.first_cut))[walls.cut]
        axis, cell = walls.side // 2, sizes[box] + arms.cell[walls.cut]
        length = arms.theta[walls.cut, walls.side] * np.asarray(spacing)[axis]
        covered = [patch.covered.ravel(order="F") for patch in patches]
        shown = np.flatnonzero(~np.concatenate([np.zeros(0, bool), *covered])[cell])
        columns = (cell, walls.place, walls.normal, axis, length)
        out.append(_LevelWalls(*(column[shown] for column in columns)))
    return out


def _field_across(phi: Field, frame: Frame, walls: list[_LevelWalls], points: np.ndarray) -> np.ndarray:
    """Return the field (n, 3), V/m, at points of the charge that this rank's walls have, as far as they face the motion."""
    out, hierarchy = np.zeros_like(points), phi.hierarchy
    for level, wall in enumerate(walls):
        spacing = np.asarray(hierarchy.spacing(level))
        area = spacing.prod() / spacing[wall.axis]
        slope = phi.array(level)[wall.cell] / wall.length / np.array(frame.stretch)[wall.axis] ** 2
        charge = -VACUUM_PERMITTIVITY * slope * area * abs(wall.normal[:, frame.axis])
        for n, point in enumerate(points):
            way = point - wall.place
            distance = np.maximum(np.linalg.norm(way, axis=1), spacing.max())
            out[n] += (charge / distance**3) @ way / (4 * np.pi * VACUUM_PERMITTIVITY)
    return out
