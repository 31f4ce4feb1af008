"""The mesh that a scene's rule asks for, and where its particles are, from the densities of its bunches."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
import scipy
from mpi4py import MPI

from amrpic.errors import InputError
from amrpic.mesh.boxes import cells_of
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.particles.uniform_numbers import draw
from amrpic.pic.rule_quantities import Quantities
from amrpic.scene.bunch_shapes import GaussianBunch
from amrpic.scene.bunches import Bunch, LatticeBunch, Train
from amrpic.scene.motion import RandomWalk
from amrpic.scene.refinement_rules import ChargeDensityRule, ParticlesRule, RuleCombination, RuleKind
from amrpic.scene.scene import Scene
from amrpic.space_charge.tagging_rules import apart, index_boxes, tags_of
from amrpic.stages.regrid import Regridding, regrid
from amrpic.stages.tag import Tags

REACH = 7.0  # rms sizes of a Gaussian; one of 4e11 particles lies further out along an axis
SAMPLES = 2**18  # particles that stand for a bunch whose density is no product of functions of x, y and z
IN_PLACE = 1e-3  # relative density that stands for rules that ask for what a plan does not have: as by default

Edges = Sequence[np.ndarray]


@dataclass(frozen=True)
class Cloud:
    """The particles of one bunch as a density."""

    particles: int
    charge: float  # C, of all of them
    lower: np.ndarray  # (3,) m; nothing lies beyond
    upper: np.ndarray
    shares: Callable[[Edges], np.ndarray]  # of the bunch in the cells (nx, ny, nz) between edges along x, y, z in m


def clouds_of(scene: Scene, steps: int = 0) -> list[Cloud]:
    """Return the bunches of a scene as densities, after so many steps of a random walk if they take one.

    Raises InputError for those that are known only once a file is read.
    """
    walked = scene.motion.amplitude * math.sqrt(steps / 3) if isinstance(scene.motion, RandomWalk) else 0.0
    return [cloud for number, bunch in enumerate(scene.bunches) for cloud in _clouds(scene, number, bunch, walked)]


def _clouds(scene: Scene, number: int, bunch: Bunch, walked: float) -> Iterator[Cloud]:
    """Yield the densities of a bunch, each convolved with a Gaussian of rms size `walked` m: of many steps, evenly drawn."""
    if isinstance(bunch, LatticeBunch):
        lower, upper = np.array(scene.domain.lower), np.array(scene.domain.upper)
        yield Cloud(
            bunch.number,
            bunch.bunch_charge,
            lower,
            upper,
            _product([_even(*ends) for ends in zip(lower, upper, strict=True)]),
        )
        return
    if not isinstance(bunch, Train):
        raise InputError(
            f"{scene.name}: bunches.{number} comes from a file or from arrays, whose density a plan does not know; plan with "
            "a bunch of the same sizes, such as a gaussian one"
        )
    for place in bunch.places():
        centre, rms = np.array(place), np.array(bunch.rms)
        if isinstance(bunch, GaussianBunch) and rms.min() > 0:
            rms = np.hypot(rms, walked)
            axes = [_normal(c, s) for c, s in zip(centre, rms, strict=True)]
            yield Cloud(bunch.number, bunch.bunch_charge, centre - REACH * rms, centre + REACH * rms, _product(axes))
            continue
        unit = bunch.unit(draw(bunch.sampling, scene.seed, 0, 0, min(bunch.number, SAMPLES)))
        points = centre + rms * unit[:3].T
        if walked > 0:
            points = points + walked * np.random.default_rng(number).standard_normal(points.shape)
        if len(points):
            yield Cloud(bunch.number, bunch.bunch_charge, points.min(axis=0), points.max(axis=0), _counted(points))


def _normal(centre: float, size: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda edges: np.diff(scipy.special.ndtr((edges - centre) / size))


def _even(lower: float, upper: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda edges: np.diff(np.clip((edges - lower) / (upper - lower), 0, 1))


def _product(axes: Sequence[Callable[[np.ndarray], np.ndarray]]) -> Callable[[Edges], np.ndarray]:
    def shares(edges: Edges) -> np.ndarray:
        x, y, z = (of(along) for of, along in zip(axes, edges, strict=True))
        return x[:, None, None] * y[:, None] * z

    return shares


def _counted(points: np.ndarray) -> Callable[[Edges], np.ndarray]:
    points = points[np.argsort(points[:, 0])]

    def shares(edges: Edges) -> np.ndarray:
        first, end = np.searchsorted(points[:, 0], edges[0][0]), np.searchsorted(points[:, 0], edges[0][-1], "right")
        return np.histogramdd(points[first:end], edges)[0] / len(points)

    return shares


class Densities:
    """Cell values of clouds on a hierarchy of one rank, made box by box where there are any.

    `rho` and `particles_per_cell` stand for those of `pic.quantities` in the rules: their arrays hold the cells of `boxes`
    alone, one after the other; all others hold nothing.
    """

    def __init__(self, clouds: Sequence[Cloud], hierarchy: Hierarchy) -> None:
        self.hierarchy, self._clouds = hierarchy, clouds
        self.boxes: list[np.ndarray] = []  # numbers of the boxes of each level that meet a cloud
        self._corners = [hierarchy.boxes(level) for level in range(hierarchy.levels)]
        self._near: list[list[list[Cloud]]] = []  # for each of them, the clouds
        for level in range(hierarchy.levels):
            h, origin = hierarchy.spacing(level), np.array(hierarchy.domain.lower)
            boxes = self._corners[level]
            lower, upper = origin + boxes[:, :3] * h, origin + (boxes[:, 3:] + 1) * h
            meets = np.array([((c.lower < upper) & (lower < c.upper)).all(axis=1) for c in clouds], dtype=bool)
            meets = meets.reshape(len(clouds), len(boxes))
            self.boxes.append(np.flatnonzero(meets.any(axis=0)))
            self._near.append(
                [[c for c, near in zip(clouds, meets[:, b], strict=True) if near] for b in self.boxes[-1]]
            )

    def box_values(self, level: int, place: int, value: Callable[[Cloud], float]) -> np.ndarray:
        """Return the sum over clouds of a value times the share in each cell (nx, ny, nz) of `boxes[level][place]`."""
        box = self._corners[level][self.boxes[level][place]]
        h, origin = self.hierarchy.spacing(level), self.hierarchy.domain.lower
        edges = [origin[d] + h[d] * np.arange(box[d], box[3 + d] + 2) for d in range(3)]
        return sum((value(c) * c.shares(edges) for c in self._near[level][place]), np.zeros(()))

    def cells(self, level: int, value: Callable[[Cloud], float]) -> np.ndarray:
        """Return the same for all cells of `boxes[level]`, x fastest in each."""
        numbers = self.boxes[level]
        out, at = np.empty(int(cells_of(self._corners[level][numbers]).sum())), 0
        for place in range(len(numbers)):
            values = self.box_values(level, place, value).ravel(order="F")
            out[at : at + values.size] = values
            at += values.size
        return out

    def __getitem__(self, name: str) -> _Values:
        values: _Values = getattr(self, name)
        return values

    @cached_property
    def rho(self) -> _Values:
        volumes = [float(np.prod(self.hierarchy.spacing(level))) for level in range(self.hierarchy.levels)]
        return _Values(self.hierarchy, [self.cells(l, lambda c, v=v: c.charge / v) for l, v in enumerate(volumes)])  # type: ignore[misc]

    @cached_property
    def particles_per_cell(self) -> _Values:
        return _Values(self.hierarchy, [self.cells(l, lambda c: c.particles) for l in range(self.hierarchy.levels)])

    def spread(self, tags: Tags) -> Tags:
        """Return tags of the cells of `boxes` as those of all cells of the hierarchy."""
        out = []
        for level, (numbers, values) in enumerate(zip(self.boxes, tags, strict=True)):
            cells = cells_of(self.hierarchy.boxes(level))
            starts, at = np.cumsum([0, *cells]), 0
            all_ = np.zeros(starts[-1], dtype=bool)  # memory is taken where something is written alone
            for number in numbers:
                part = values[at : at + cells[number]]
                if part.any():
                    all_[starts[number] : starts[number + 1]] = part
                at += cells[number]
            out.append(all_)
        return out


@dataclass(frozen=True)
class _Values:
    hierarchy: Hierarchy
    levels: list[np.ndarray]

    def array(self, level: int) -> np.ndarray:
        return self.levels[level]


def planned_mesh(scene: Scene, clouds: Sequence[Cloud]) -> tuple[Hierarchy, list[str]]:
    """Return the mesh that a scene starts on, as one rank has it, and notes on what was done in place of the scene's rule.

    Tags come from exact cell averages, without the noise and the clouds of macroparticles.
    """
    refinement, asked = scene.refinement, list[str]()
    rule, static = apart(refinement.rule)
    rule = None if rule is None else _without_fields(rule, asked)
    settings = Regridding(refinement.levels + 1, refinement.buffer, refinement.nesting, refinement.efficiency)
    mesh = Hierarchy(MPI.COMM_SELF, scene.domain.value, (), refinement.max_grid_size, refinement.blocking_factor)
    for _ in range(2 * refinement.levels):  # as `pic.adapt.follow`
        tags: Tags = []
        if rule is not None:
            densities = Densities(clouds, mesh)
            tags = densities.spread(tags_of(rule, cast(Quantities, densities)))
        made = regrid(mesh, tags, settings, index_boxes(static, mesh.domain))
        if made is mesh:
            break
        mesh = made
    notes = [
        f"refinement.rule asks for {', '.join(asked)}, which a plan does not have; in its place cells are refined by "
        f"charge-density, relative = {IN_PLACE:g}"
    ]
    return mesh, notes if asked else []


def _without_fields(rule: RuleKind, asked: list[str]) -> RuleKind:
    """Return a rule with charge density in place of all that asks for more; `asked` grows by the kinds of these."""
    match rule:
        case RuleCombination():
            return rule.model_copy(update={"of": [_without_fields(one, asked) for one in rule.of]})
        case ChargeDensityRule() | ParticlesRule():
            return rule
    asked.append(rule.kind)
    return ChargeDensityRule(relative=IN_PLACE, levels=getattr(rule, "levels", None))


def charged_regions(clouds: Sequence[Cloud], mesh: Hierarchy) -> list[tuple[list[float], list[float]]]:
    """Return the lower and upper corners of where clouds are, in base cells."""
    origin, h, cells = np.array(mesh.domain.lower), mesh.spacing(0), np.array(mesh.domain.cells)

    def corner(x: np.ndarray) -> list[float]:
        return np.clip((x - origin) / h, 0, cells).tolist()

    return [(corner(cloud.lower), corner(cloud.upper)) for cloud in clouds]
