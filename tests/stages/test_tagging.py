"""Each rule refines the cells that plain NumPy asks for, on any number of ranks, and refuses what makes no sense."""

from __future__ import annotations

import itertools
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import InputError, SceneError
from amrpic.mesh.domain import Domain
from amrpic.mesh.field import Field
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.pic.adapt import follow, make_base
from amrpic.pic.frames import first_frames
from amrpic.pic.initial_particles import make_particles
from amrpic.pic.meshed import MeshedParticles
from amrpic.pic.rule_quantities import Quantities
from amrpic.pic.setup import Setup, set_up
from amrpic.pic.simulation import Simulation
from amrpic.scene.refinement_rules import ARGUMENTS
from amrpic.scene.scene import Scene
from amrpic.space_charge.tagging_rules import apart, index_boxes, tags_of
from amrpic.stages.migrate import migrate
from amrpic.stages.regrid import Regridding, regrid
from amrpic.stages.tag import Tags, inside
from particle_cases import dense, everywhere
from regions import coarser, mask, same_region, wanted_blocks

CELLS = 16
DOMAIN = {"lower": -0.1, "upper": 0.1, "cells": CELLS, "boundary": "dirichlet"}


def scene(rule: Any, **refinement: Any) -> Scene:
    """A scene with a rule for two bunches, one of them at rest, the other fast, and a thin halo."""
    rng = np.random.default_rng(8)
    position = np.concatenate(
        [
            rng.normal((-0.04, -0.04, 0), 0.008, (300, 3)),
            rng.normal((0.05, 0.03, 0), 0.004, (200, 3)),
            rng.uniform(-0.09, 0.09, (100, 3)),
        ]
    )
    momenta = np.concatenate(
        [rng.normal(0, 1e-22, (300, 3)), rng.normal((5e-22, 0, 0), 1e-22, (200, 3)), np.zeros((100, 3))]
    )
    bunch = {"distribution": "arrays", "position": position, "momenta": momenta, "charge": 1e-11}
    sizes = {"levels": 2, "blocking_factor": 4, "max_grid_size": 64, **refinement}
    data = {"domain": DOMAIN, "bunches": [bunch], "refinement": {"rule": rule, **sizes}, "output": {"write": []}}
    return Scene.from_dict(data)


def on_base(comm: MPI.Comm, given: Scene) -> tuple[MeshedParticles, Setup]:
    setup = set_up(comm, given)
    base = make_base(setup.comm, given)
    particles, _ = migrate(make_particles(comm, given), base)
    return MeshedParticles(particles, base, first_frames(particles, setup)), setup


def on_first_mesh(comm: MPI.Comm, given: Scene) -> Quantities:
    beam, setup = on_base(comm, given)
    return Quantities(beam, None, setup)


def on_last_mesh(comm: MPI.Comm, given: Scene) -> Quantities:
    beam, setup = on_base(comm, given)
    return Quantities(follow(beam, None, setup), None, setup)


class World:
    """What the cells of all ranks hold, as dense arrays per level; nan, or nothing, where a level has no cells."""

    def __init__(self, seen: Quantities, fields: bool) -> None:
        levels = range(seen.hierarchy.levels)
        self.exists = [mask(seen.hierarchy, level) == 1 for level in levels]
        self.rho = [np.abs(dense(seen["rho"], level)) for level in levels]
        if fields:
            self.phi = [np.abs(dense(seen["phi"], level)) for level in levels]
            components = [[dense(c, level) for c in seen["efield"].components] for level in levels]
            self.e = [np.linalg.norm(parts, axis=0) for parts in components]
        all_ = everywhere(seen.hierarchy.comm, seen.particles)
        speed = np.linalg.norm(all_["momentum"], axis=1)
        self.centre, self.size = (f(all_["position"], axis=0) for f in (np.mean, np.std))
        about = all_["momentum"] - all_["momentum"].mean(axis=0)
        deviation = np.linalg.norm(about / about.std(axis=0), axis=1)
        self.fastest, self.number, self.momentum, self.deviation = float(speed.max()), [], [], []
        for level in levels:
            cell = tuple(np.floor((all_["position"] + 0.1) / (0.2 / CELLS / 2**level)).astype(int).T)
            number, momentum, most = (np.zeros(self.exists[level].shape) for _ in range(3))
            np.add.at(number, cell, 1)
            np.maximum.at(momentum, cell, speed)
            np.maximum.at(most, cell, deviation)
            self.number.append(np.where(self.exists[level], number, 0))
            self.momentum.append(np.where(self.exists[level], momentum, 0))
            self.deviation.append(np.where(self.exists[level], most, 0))

    def radius(self, level: int, axes: str) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest distance of the cells from the centre of the particles, in rms sizes, at their corners."""
        n = CELLS * 2**level
        edge = np.linspace(-0.1, 0.1, n + 1)
        ends = []
        for d in ("xyz".index(axis) for axis in axes):
            corners = np.abs(edge - self.centre[d]) / self.size[d]
            inside = (edge[:-1] < self.centre[d]) & (self.centre[d] < edge[1:])
            shape = [n if d == e else 1 for e in range(3)]
            near = np.where(inside, 0, np.minimum(corners[:-1], corners[1:]))
            ends.append((near.reshape(shape), np.maximum(corners[:-1], corners[1:]).reshape(shape)))
        near, far = (np.sqrt(sum(part**2 for part in parts)) for parts in zip(*ends, strict=True))
        return np.broadcast_to(near, (n,) * 3), np.broadcast_to(far, (n,) * 3)

    def x(self, level: int) -> np.ndarray:
        n = CELLS * 2**level
        return ((np.arange(n) + 0.5) * 0.2 / n - 0.1)[:, None, None]


def whole(values: list[np.ndarray]) -> float:
    return max(float(np.nanmax(v)) for v in values)


CHARGE = {"kind": "charge-density", "relative": 0.1}
FAST = {"kind": "momentum", "absolute": "0.9 keV/c"}
BOX = {"kind": "static", "boxes": [{"level": 1, "lower": [-0.1, -0.1, -0.05], "upper": [0, 0.025, 0.05]}]}
KEV_C = 1.602176634e-16 / 299792458.0


def in_box(w: World, level: int) -> np.ndarray:
    """The cells that touch the box of level 1, whose corners are faces of level 0; the box bounds no deeper level."""
    out = np.zeros(w.exists[level].shape, dtype=bool)
    if level == 0:
        out[0:8, 0:10, 4:12] = True
    return out


def by_hand(x, level, rho, efield, particles_per_cell):
    return (x < 0.01 * level) & (np.abs(rho) > 1e-7) | (particles_per_cell > 8) | (np.abs(efield[0]) > 1e9)


def in_shell(w: World, level: int, axes: str, at_least: float, at_most: float) -> np.ndarray:
    near, far = w.radius(level, axes)
    return (near <= at_most) & (far >= at_least)


SHELL = {"kind": "radius", "at_least": 1.2, "at_most": 1.6}
Oracle = Callable[[World, int], np.ndarray]
CASES: dict[str, tuple[dict[str, Any], Oracle]] = {
    "charge": (CHARGE, lambda w, l: w.rho[l] > 0.1 * whole(w.rho)),
    "charge of level": (
        {**CHARGE, "relative_to": "level"},
        lambda w, l: w.rho[l] > 0.1 * np.nanmax(w.rho[l]),
    ),
    "potential": ({"kind": "potential", "relative": 0.5}, lambda w, l: w.phi[l] > 0.5 * whole(w.phi)),
    "field": ({"kind": "field-strength", "relative": 0.4}, lambda w, l: w.e[l] > 0.4 * whole(w.e)),
    "field of level": (
        {"kind": "field-strength", "relative": 0.6, "relative_to": "level"},
        lambda w, l: w.e[l] > 0.6 * np.nanmax(w.e[l]),
    ),
    "momentum": ({"kind": "momentum", "relative": 0.8}, lambda w, l: w.momentum[l] > 0.8 * w.fastest),
    "momentum of level": (
        {"kind": "momentum", "relative": 0.9, "relative_to": "level"},
        lambda w, l: w.momentum[l] > 0.9 * w.momentum[l].max(),
    ),
    "momentum absolute": (FAST, lambda w, l: w.momentum[l] > 0.9 * KEV_C),
    "momentum in rms spreads": (
        {"kind": "momentum", "relative": 2.5, "relative_to": "rms"},
        lambda w, l: w.deviation[l] > 2.5,
    ),
    "radius": ({"kind": "radius", "at_most": 0.8}, lambda w, l: in_shell(w, l, "xy", 0, 0.8)),
    "shell": ({**SHELL, "axes": "xyz"}, lambda w, l: in_shell(w, l, "xyz", 1.2, 1.6)),
    "halo": (
        {"kind": "all", "of": [{"kind": "radius", "at_least": 1.5}, {"kind": "particles-per-cell", "at_least": 1}]},
        lambda w, l: in_shell(w, l, "xy", 1.5, np.inf) & (w.number[l] > 0),
    ),
    "at most": (
        {"kind": "particles-per-cell", "at_most": 1, "levels": [0]},
        lambda w, l: (w.number[l] == 1) & (l == 0),
    ),
    "between": (
        {"kind": "particles-per-cell", "at_least": 3, "at_most": 9},
        lambda w, l: (w.number[l] >= 3) & (w.number[l] <= 9),
    ),
    "function": (
        {"kind": "callable", "function": by_hand},
        lambda w, l: (w.x(l) < 0.01 * l) & (w.rho[l] > 1e-7) | (w.number[l] > 8),
    ),
    "any": (
        {"kind": "any", "of": [{**CHARGE, "levels": [0]}, {**FAST, "levels": [1]}]},
        lambda w, l: w.rho[l] > 0.1 * whole(w.rho) if l == 0 else w.momentum[l] > 0.9 * KEV_C,
    ),
    "all": (
        {"kind": "all", "of": [CHARGE, {"kind": "particles-per-cell", "at_least": 2}]},
        lambda w, l: (w.rho[l] > 0.1 * whole(w.rho)) & (w.number[l] >= 2),
    ),
    "all inside a box": (
        {"kind": "all", "of": [{"kind": "any", "of": [CHARGE, FAST]}, BOX]},
        lambda w, l: ((w.rho[l] > 0.1 * whole(w.rho)) | (w.momentum[l] > 0.9 * KEV_C)) & in_box(w, l),
    ),
    "any or a box": ({"kind": "any", "of": [FAST, BOX]}, lambda w, l: w.momentum[l] > 0.9 * KEV_C),
}
BOX_CELLS = [[[0, 0, 8, 15, 19, 23]]]  # of level 1


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,), timeout=120)
@pytest.mark.parametrize("name", CASES)
def test_rule_refines_the_cells_that_numpy_asks_for(comm, name):
    """With full boxes the refined region is that of the tags, their buffer and the room around finer levels, exactly."""
    rule, oracle = CASES[name]
    given = scene(rule, efficiency=1.0, max_grid_size=8)
    settings = Regridding(3, given.refinement.buffer, given.refinement.nesting, 1.0)
    static = BOX_CELLS if name == "any or a box" else []
    seen, followed = on_first_mesh(comm, given), on_last_mesh(comm, given)
    assert followed.hierarchy.levels == (2 if name in ONE_LEVEL else 3)
    for now in seen, followed:  # what the first mesh makes of the base, and the one that stays
        world = World(now, fields=name.startswith(("potential", "field")))
        tags = [oracle(world, level) & world.exists[level] for level in range(min(now.hierarchy.levels, 2))]
        assert tags[0].any() and not tags[0].all()
        made = refined(now, given, settings)
        for level, blocks in enumerate(wanted_blocks(now.hierarchy, tags, settings, static=static), start=1):
            assert np.array_equal(coarser(mask(made, level) == 1, 4), blocks)
    assert made is followed.hierarchy


ONE_LEVEL = {"at most", "all inside a box"}


def refined(seen: Quantities, given: Scene, settings: Regridding):
    rule, static = apart(given.refinement.rule)
    assert rule is not None
    return regrid(seen.hierarchy, tags_of(rule, seen), settings, index_boxes(static, seen.hierarchy.domain))


@pytest.mark.mpi(ranks=(2, 4))
@pytest.mark.parametrize("name", ["charge", "momentum"])
def test_boxes_are_those_of_one_rank_and_as_full_as_asked(comm, name):
    rule, oracle = CASES[name]
    given = scene(rule)
    together, alone = on_last_mesh(comm, given), on_last_mesh(MPI.COMM_SELF, given)
    assert same_region(together.hierarchy, alone.hierarchy)
    world, settings = World(together, fields=False), Regridding(3)
    tags = [oracle(world, level) & world.exists[level] for level in range(2)]
    # The mesh as it is asks for itself: what is wanted is there, and boxes hold enough of it.
    made = refined(together, given, settings)
    blocks = wanted_blocks(together.hierarchy, tags, settings)
    for level in (1, 2):
        assert not np.any(blocks[level - 1] & ~coarser(mask(made, level) == 1, 4))
    for box in refined(alone, given, settings).boxes(2) // 4:  # on more ranks, boxes of overfull ones are halved
        part = blocks[1][box[0] : box[3] + 1, box[1] : box[4] + 1, box[2] : box[5] + 1]
        assert part.mean() >= settings.efficiency or part.size == 1


DEGENERATE = {
    "one particle": (np.full((1, 3), 0.03), np.full((1, 3), 1e-22)),
    "a sheet": (
        np.stack([np.full(50, 0.03), *np.random.default_rng(3).normal(0, 0.01, (2, 50))], axis=1),
        np.zeros((50, 3)),
    ),
    "a beam of one momentum": (np.random.default_rng(4).normal(0, 0.01, (50, 3)), np.full((50, 3), 1.1e-22)),
}


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("name", DEGENERATE)
def test_beams_without_a_size_or_a_spread_have_a_centre_and_no_outliers(comm, name):
    position, momenta = DEGENERATE[name]
    bunch = {"distribution": "arrays", "position": position, "momenta": momenta, "charge": 1e-11}
    data = {"domain": DOMAIN, "bunches": [bunch], "refinement": {"levels": 2, "blocking_factor": 4}}
    seen = on_first_mesh(comm, Scene.from_dict(data))
    near, outliers = (
        on_cells(seen.hierarchy, tags_of(scene(rule).refinement.rule, seen))[0]
        for rule in ({"kind": "radius", "at_most": 1}, {"kind": "momentum", "relative": 0.5, "relative_to": "rms"})
    )
    middle = np.floor((position.mean(axis=0) + 0.1) / (0.2 / CELLS)).astype(int)
    assert near[tuple(middle)] and near.sum() < 0.1 * near.size
    assert not outliers.any()


def on_cells(hierarchy: Hierarchy, tags: Tags) -> list[np.ndarray]:
    """Tags over all cells of each level, on every rank."""
    field = Field(hierarchy)
    for level, values in enumerate(tags):
        field.array(level)[:] = values
    return [dense(field, level) == 1 for level in range(hierarchy.levels)]


FULL = Regridding(max_levels=3, buffer=1, efficiency=1.0)
ELSEWHERE = {
    "kind": "static",
    "boxes": [{"level": 1, "first": 4, "last": 19}, {"level": 2, "first": 16, "last": 31}],
}

# Rules, and what they tag with thresholds taken as strict as `p` says.
LOOSENED = {
    "charge": ({**CHARGE, "relative": 0.3}, lambda w, l, p: w.rho[l] > p * 0.3 * whole(w.rho)),
    "between": (
        {"kind": "particles-per-cell", "at_least": 6, "at_most": 6},
        lambda w, l, p: (w.number[l] >= p * 6) & (w.number[l] <= 6 / p),
    ),
    "shell": (SHELL, lambda w, l, p: in_shell(w, l, "xy", p * 1.2, 1.6 / p)),
    "momentum in rms spreads": (
        {"kind": "momentum", "relative": 3.5, "relative_to": "rms"},
        lambda w, l, p: w.deviation[l] > p * 3.5,
    ),
    "function": (
        {"kind": "callable", "function": lambda rho, hysteresis: np.abs(rho) > 1e-6 * hysteresis},
        lambda w, l, p: w.rho[l] > p * 1e-6,
    ),
    "all": (
        {"kind": "all", "of": [CHARGE, {"kind": "particles-per-cell", "at_least": 8}]},
        lambda w, l, p: (w.rho[l] > p * 0.1 * whole(w.rho)) & (w.number[l] >= p * 8),
    ),
}


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("name", LOOSENED)
def test_what_is_refined_stays_while_loosened_thresholds_ask_for_it(comm, name):
    """On a mesh that was refined for something else; what loosened thresholds ask for elsewhere does not come."""
    rule, oracle = LOOSENED[name]
    beam, setup = on_base(comm, scene(ELSEWHERE))
    given = scene(rule, efficiency=1.0)
    seen = Quantities(replace(follow(beam, None, setup), rho=None), None, set_up(comm, given))
    world = World(seen, fields=False)
    strict, loose = ([oracle(world, level, part) & world.exists[level] for level in range(2)] for part in (1, 0.25))
    kept, plain = (wanted_blocks(seen.hierarchy, strict, FULL, stays) for stays in (loose, []))
    asked = given.refinement.rule
    loosened = tags_of(asked, seen, 0.25)
    assert all(
        np.array_equal(found, loose[level]) for level, found in enumerate(on_cells(seen.hierarchy, loosened)[:2])
    )
    made = regrid(seen.hierarchy, tags_of(asked, seen), FULL, staying=loosened)
    for level in (1, 2):
        assert np.array_equal(coarser(mask(made, level) == 1, 4), kept[level - 1])
    assert any(np.any(a & ~b) for a, b in zip(kept, plain, strict=True)), "nothing was kept"


@pytest.mark.mpi(ranks=2)
def test_cells_that_touch_boxes_are_found_across_periodic_faces(comm):
    domain = Domain((0, 0, 0), (1, 1, 1), (8, 8, 16), {"x": "periodic", "y": "dirichlet", "z": "periodic"})
    hierarchy = Hierarchy(comm, domain, [[((0, 0, 0), (15, 7, 15))]], 8, 4)
    boxes = [np.array([[-3, 2, 30, 1, 9, 33]]), np.array([[5, 20, 7, 6, 27, 9], [60, 0, 0, 63, 0, 0]])]
    marks = [np.zeros((8 * 2**level, 8 * 2**level, 16 * 2**level), dtype=bool) for level in range(3)]
    for level, of_level in enumerate(boxes, start=1):
        for box in of_level:
            cells = np.ix_(*(np.arange(box[d], box[d + 3] + 1) % marks[level].shape[d] for d in range(3)))
            for coarse in range(level):
                inside_it = np.zeros_like(marks[level])
                inside_it[cells] = True
                marks[coarse] |= coarser(inside_it, 2 ** (level - coarse))
    for level, found in enumerate(on_cells(hierarchy, inside(hierarchy, boxes))):
        exists = mask(hierarchy, level) == 1
        assert np.array_equal(found, marks[level] & exists)
        assert 0 < found.sum() < exists.sum()


# ---- a mesh in motion ----
def meshes(comm: MPI.Comm, hysteresis: float, charges: list[float]) -> list[Hierarchy]:
    """The meshes that follow particles whose charge changes, each made from the one before."""
    given = scene({"kind": "charge-density", "absolute": "200 nC/m^3"})
    (beam, setup), out = on_base(comm, given), list[Hierarchy]()
    weight = np.array(beam.particles.weight)
    for charge in charges:
        particles = replace(beam.particles, weight=weight * charge)
        particles, _ = migrate(particles, beam.hierarchy)
        moved = MeshedParticles(particles, beam.hierarchy, beam.frames)
        beam = follow(moved, None, setup, hysteresis if out else 1.0)
        weight = np.array(beam.particles.weight) / charge
        out.append(beam.hierarchy)
    return out


@pytest.mark.mpi(ranks=2)
def test_charge_that_swings_about_the_threshold_makes_the_mesh_flicker_without_hysteresis_only(comm):
    def changes(made: list[Hierarchy]) -> int:
        return sum(not a.same_mesh(b) for a, b in itertools.pairwise(made))

    swinging = [1.0, 1.3, 0.8] * 4
    assert changes(meshes(comm, 1.0, swinging)) == len(swinging) - 1
    assert changes(meshes(comm, 0.5, swinging)[2:]) == 0
    assert changes(meshes(comm, 0.5, [1.0] * 4)) == 0
    fading = meshes(comm, 0.5, [1.0, 0.3, 0.01])
    assert changes(fading) == 2 and fading[-1].levels == 1  # what is no longer asked for goes


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("limit", [0.0, 0.3])
def test_the_mesh_follows_a_drifting_bunch_when_and_only_when_it_outruns_its_level(comm, limit):
    """Two fifths of a base cell per step. Every cell with a particle is wanted fine, so particles elsewhere have outrun it."""
    drift = {
        "distribution": "sphere",
        "radius": 0.008,
        "centre": [-0.04, 0.003, 0.003],
        "charge": 1e-25,
        "particles": 300,
        "velocity": [5e6, 0, 0],
    }
    given = Scene.from_dict(
        {
            "domain": DOMAIN,
            "bunches": [drift],
            "motion": {"kind": "leapfrog", "dt": "1 ns"},
            "schedule": {"steps": 14},
            "output": {"write": []},
            "solver": {"tolerance": 1e-4},
            "refinement": {
                "levels": 2,
                "blocking_factor": 4,
                "buffer": 1,
                "rule": {"kind": "particles-per-cell", "at_least": 1},
                "regrid_every": 0,
                "regrid_outrun": limit,
            },
        }
    )
    simulation = Simulation(comm, given)
    meshes, followed = [simulation.hierarchy], []

    def behind(hierarchy: Hierarchy) -> float:
        """Share of the particles that are not on the finest level of a mesh."""
        cell = np.floor((everywhere(comm, simulation.particles)["position"] + 0.1) / (0.2 / CELLS / 4)).astype(int)
        return float(np.mean(mask(hierarchy, 2)[tuple(cell.T)] == 0))

    def look(_: Simulation) -> None:
        changed = not simulation.hierarchy.same_mesh(meshes[-1])
        assert changed == (behind(meshes[-1]) > limit) == simulation.state.regridded
        assert behind(simulation.hierarchy) <= limit
        followed.append(changed)
        meshes.append(simulation.hierarchy)

    simulation.on_step(look)
    simulation.run()
    x = everywhere(comm, simulation.particles)["position"][:, 0].mean()
    assert x == pytest.approx(-0.04 + 14 * 5e-3, abs=1e-3)
    assert 2 <= sum(followed) <= 12


# ---- what is refused ----
DEEP = {"level": 1, "first": 0, "last": 7}
STATIC = {"kind": "static", "boxes": [DEEP]}
REFUSED: dict[str, tuple[dict[str, Any], list[str]]] = {
    "level too high": ({"rule": {**CHARGE, "levels": [0, 2]}}, ["rule.levels ([0, 2])", "2 refined levels", "below 2"]),
    "level below 0": ({"rule": {**CHARGE, "levels": [-1]}}, ["rule.levels.0 (-1)"]),
    "two thresholds": ({"rule": {**CHARGE, "absolute": 1}}, ["rule.relative is given as well as absolute"]),
    "no threshold": ({"rule": {"kind": "potential"}}, ["rule.relative is missing, as is absolute; give relative or absolute"]),
    "relative to nothing": (
        {"rule": {"kind": "momentum", "absolute": "1 eV/c", "relative_to": "level"}},
        ["rule.relative_to ('level')", "beside absolute"],
    ),
    "wrong unit": ({"rule": {"kind": "momentum", "absolute": "1 V"}}, ["rule.absolute ('1 V')", "momentum", "eV/c"]),
    "no count": ({"rule": {"kind": "particles-per-cell"}}, ["rule.at_least", "at_most"]),
    "no cell fits": ({"rule": {"kind": "particles-per-cell", "at_least": 5, "at_most": 4}}, ["at_least (5)", "swap"]),
    "no shell": ({"rule": {"kind": "radius", "at_least": 5, "at_most": 4.5}}, ["rule.at_least (5", "4.5", "swap"]),
    "no radius": ({"rule": {"kind": "radius", "axes": "xz"}}, ["rule.at_least must be given", "at_most"]),
    "unknown axes": ({"rule": {"kind": "radius", "at_most": 1, "axes": "r"}}, ["rule.axes ('r')", "use one of xy, "]),
    "any of nothing": ({"rule": {"kind": "any", "of": []}}, ["rule.of ([])", "names no rule"]),
    "mistake inside": ({"rule": {"kind": "all", "of": [CHARGE, {"kind": "potential"}]}}, ["rule.of.1.relative is missing"]),
    "unknown inside": (
        {"rule": {"kind": "any", "of": [{"kind": "all", "of": [{"kind": "potental"}]}]}},
        ["rule.of.0.of.0 ('potental')", 'did you mean "potential"'],
    ),
    "box too deep inside": (
        {"levels": 1, "rule": {"kind": "all", "of": [CHARGE, {"kind": "static", "boxes": [{**DEEP, "level": 2}]}]}},
        ["rule.of.1.boxes.0.level (2)", "1 refined levels"],
    ),
    "box outside inside": (
        {"rule": {"kind": "any", "of": [{"kind": "static", "boxes": [{**DEEP, "last": 32}]}]}},
        ["rule.of.0.boxes.0", "leaves the domain"],
    ),
    "no function": ({"rule": {"kind": "callable", "name": "where"}}, ["where is a Python function", "restart"]),
    "not a function": ({"rule": {"kind": "callable", "function": 3}}, ["rule.function (3)", "not a function"]),
    "unknown argument": (
        {"rule": {"kind": "callable", "function": lambda x, roh: x > roh}},
        ["parameter roh", 'did you mean "rho"'],
    ),
    "outrun boxes": ({"rule": STATIC, "regrid_outrun": 0.1}, ["regrid_outrun (0.1)", "never changes"]),
    "hysteresis": ({"hysteresis": 0, "rule": CHARGE}, ["refinement.hysteresis (0)", "greater than 0"]),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_rule_without_sense_is_refused_in_one_sentence(name):
    changes, words = REFUSED[name]
    with pytest.raises(SceneError) as refused:
        scene(**changes)
    message = str(refused.value)
    assert message.startswith("scene: refinement.") and "; " in message and "\n" not in message
    for word in words:
        assert word in message


def test_a_mistake_in_a_key_that_has_the_name_of_a_rule_is_reported_with_its_place():
    with pytest.raises(SceneError, match=r"bunches\.0\.momentum\.0 \('3 mm'\) "):
        Scene.from_dict({"domain": DOMAIN, "bunches": [{**LONE, "momentum": "3 mm"}]})


LONE = {"distribution": "gaussian", "sigma": 0.01, "charge": 1e-11, "particles": 500}


def fails(rho):
    if MPI.COMM_WORLD.rank == 1:
        raise ZeroDivisionError("no such cell")
    return rho > 1


@pytest.mark.mpi(ranks=2)
@pytest.mark.parametrize(
    "function, words",
    [
        (
            fails,
            ["function fails of refinement.rule on level 0", "raised ZeroDivisionError: no such cell", "correct it"],
        ),
        (lambda rho: rho, ["values of type float64", "return bool"]),
        (lambda rho: rho[:3] > 0, ["shape (3, 8, 8)", "(8, 8, 8)"]),
        (lambda rho: rho.__setitem__(0, 1), ["raised ValueError", "read-only"]),
    ],
)
def test_function_that_fails_on_one_rank_is_reported_by_all(comm, function, words):
    beam, setup = on_base(comm, scene({"kind": "callable", "function": function}, max_grid_size=8))
    with pytest.raises(InputError) as failed:
        follow(beam, None, setup)
    (message,) = set(comm.allgather(str(failed.value)))
    for word in words:
        assert word in message


@pytest.mark.mpi(ranks=2)
def test_a_run_with_a_function_goes_on_from_a_checkpoint_once_it_is_given_again(comm, tmp_path):
    def given(steps: int) -> Scene:
        output = {"directory": str(tmp_path), "write": ["checkpoint"]}
        rule = {"kind": "callable", "function": by_hand}
        moves = {"motion": {"kind": "random-walk", "amplitude": "3 mm"}, "schedule": {"steps": steps}}
        sizes = {"levels": 1, "blocking_factor": 4, "rule": rule, "regrid_every": 1}
        return Scene.from_dict({"domain": DOMAIN, "bunches": [LONE], "refinement": sizes, "output": output, **moves})

    first, whole_run = Simulation(comm, given(1)), Simulation(comm, given(2))
    first.run()
    path = tmp_path / "checkpoint_00000001"
    with pytest.raises(
        SceneError, match=r"by_hand is a Python function, which no file or checkpoint keeps; pass the scene"
    ):
        Simulation.restart(comm, path)
    resumed = Simulation.restart(comm, path, given(2))
    resumed.run()
    whole_run.run()
    assert resumed.hierarchy.levels == 2 and same_region(resumed.hierarchy, whole_run.hierarchy)
    assert np.array_equal(resumed.phi.array(1), whole_run.phi.array(1))


# ---- what people read ----
PAGE = (Path(__file__).parents[2] / "docs" / "refinement.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_examples_of_the_page_on_refinement_are_scenes():
    for text in blocks("toml"):
        Scene.from_dict({"domain": DOMAIN, **tomllib.loads(text)})
    for text in blocks("python"):
        names: dict[str, Any] = {"amrpic": amrpic}
        exec(text, names)
        rule = names["scene"].refinement.rule
        assert (rule.name, rule.arguments) == ("near_the_axis", ["x", "y", "rho", "hysteresis"])
    assert len(blocks("toml")) == 5 and len(blocks("python")) == 1


@pytest.mark.parametrize("name", [name for name in CASES if name != "function"])
def test_scene_with_a_rule_reads_back_equal(name):
    given = scene(CASES[name][0])
    assert Scene.from_dict(tomllib.loads(given.to_toml())) == given


def test_the_page_on_refinement_knows_all_kinds_and_arguments():
    kinds = Scene.model_json_schema()["$defs"]["Refinement"]["properties"]["rule"]["discriminator"]["mapping"]
    table = {name for row in PAGE.splitlines() if row.startswith("|") for name in re.findall("`([a-z_-]+)`", row)}
    assert {*kinds, *ARGUMENTS} <= table
