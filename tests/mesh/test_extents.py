"""Any number of base cells: odd, prime, or fewer than a block. Boxes, tags, fields and particles up to the upper faces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.stages.deposit import deposit
from amrpic.stages.migrate import migrate
from amrpic.stages.regrid import Regridding, carry_over, regrid
from particle_cases import dense, everywhere, scattered
from regions import coarser, mask, same_region, wanted_blocks

SEEDS = range(10)
on_ranks = pytest.mark.mpi(ranks=(1, 2, 3), timeout=120)


def base(comm: MPI.Comm, seed: int) -> amrpic.Hierarchy:
    """A base of 2 to 19 cells per axis; walls, blocks and boxes are drawn from the seed as well."""
    rng = np.random.default_rng(seed)
    block = int(rng.choice([2, 4, 8]))
    walls = {axis: str(rng.choice(["periodic", "dirichlet", "neumann"])) for axis in "xyz"}
    domain = amrpic.Domain((0, 0, 0), tuple(rng.uniform(0.7, 1.4, 3)), tuple(map(int, rng.integers(2, 20, 3))), walls)
    return amrpic.Hierarchy(comm, domain, (), block * int(rng.integers(1, 4)), block)


def tags_of(hierarchy: amrpic.Hierarchy, seed: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Few cells here and there and some at the upper faces: of this rank, and over the whole domain."""
    own, whole = [], []
    at_face = np.random.default_rng(seed).random(3) < 0.7
    for level in range(min(hierarchy.levels, 2)):
        rng = np.random.default_rng([seed, level])
        shape = np.array(hierarchy.domain.cells) * 2**level
        marks = rng.random(shape) < 4 / np.prod(shape)
        marks[tuple(np.where(at_face, -1, shape // 2))] = True  # on level 1 inside the same cell of the base
        boxes = [hierarchy.boxes(level)[b] for b in hierarchy.local_boxes(level)]
        parts = [marks[a : d + 1, b : e + 1, c : f + 1].ravel(order="F") for a, b, c, d, e, f in boxes]
        own.append(np.concatenate([np.zeros(0, dtype=bool), *parts]))
        whole.append(marks)
    return own, whole


def refined(hierarchy: amrpic.Hierarchy, seed: int, settings: Regridding) -> amrpic.Hierarchy:
    for _ in range(3):
        hierarchy = regrid(hierarchy, tags_of(hierarchy, seed)[0], settings)
    return hierarchy


def check_boxes(hierarchy: amrpic.Hierarchy) -> None:
    block, most = hierarchy.blocking_factor, hierarchy.max_grid_size
    for level in range(hierarchy.levels):
        boxes, cells = hierarchy.boxes(level), np.array(hierarchy.domain.cells) * 2**level
        sizes, ends = boxes[:, 3:] - boxes[:, :3] + 1, boxes[:, 3:] == cells - 1
        assert not np.any(boxes[:, :3] % block)
        assert np.all((sizes % block == 0) | ends)
        assert sizes.min() >= 2 and np.all(sizes <= most + (ends & (cells % block == 1)))
        assert mask(hierarchy, level).max() == 1
    assert np.all(mask(hierarchy, 0) == 1)


@on_ranks
@pytest.mark.parametrize("seed", SEEDS)
def test_tags_refine_the_blocks_that_numpy_asks_for_up_to_the_upper_faces(comm, seed):
    settings = Regridding(max_levels=3, buffer=seed % 3, nesting=1 + seed % 2, efficiency=1.0)
    hierarchy = base(comm, seed)
    check_boxes(hierarchy)
    for _ in range(3):  # the hierarchies check their nesting by themselves
        own, whole = tags_of(hierarchy, seed)
        made = regrid(hierarchy, own, settings, staying=own)
        for level, blocks in enumerate(wanted_blocks(hierarchy, whole, settings), start=1):
            assert np.array_equal(coarser(mask(made, level) == 1, hierarchy.blocking_factor), blocks)
        check_boxes(made)
        hierarchy = made
    assert hierarchy.levels == 3
    assert same_region(hierarchy, refined(base(MPI.COMM_SELF, seed), seed, settings))
    check_boxes(refined(base(comm, seed), seed, Regridding(max_levels=3, efficiency=0.5)))


@on_ranks
def test_charge_is_kept_by_deposit_and_by_a_new_mesh(comm):
    for seed in SEEDS:
        old = refined(base(comm, seed), seed, Regridding(max_levels=3, buffer=1))
        new = refined(base(comm, seed), seed + 100, Regridding(max_levels=3, buffer=1))
        particles, lost = migrate(scattered(old, 2000, seed), old)
        assert len(lost) == 0
        charge = particles.total_charge(comm)
        density = deposit(particles, old)
        assert density.integral() == pytest.approx(charge, rel=1e-12, abs=0)
        assert carry_over(density, new).integral() == pytest.approx(charge, rel=1e-12, abs=0)
        assert deposit(migrate(particles, new)[0], new).integral() == pytest.approx(charge, rel=1e-12, abs=0)


@pytest.mark.parametrize(
    ("cells", "most", "extents"),
    [
        (17, 24, [17]),
        (17, 16, [8, 9]),
        (17, 8, [8, 9]),  # a single layer joins the box before it
        (81, 24, [16, 24, 24, 17]),
        (127, 32, [32, 32, 32, 31]),
        (5, 8, [5]),
        (18, 8, [8, 8, 2]),
    ],
)
def test_extents_are_cut_into_boxes_of_equal_size_to_one_block(cells, most, extents):
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells, 2, 2))
    boxes = amrpic.Hierarchy(MPI.COMM_SELF, domain, (), most, 8).boxes(0)
    assert (boxes[:, 3] - boxes[:, 0] + 1).tolist() == extents


@pytest.mark.mpi(ranks=2)
def test_open_walls_of_an_odd_domain_carry_the_potential_of_free_space(comm):
    """That of a larger domain with the same charge in the same cells, within what the octree leaves out."""

    def solved(cells: tuple[int, int, int]) -> amrpic.Field:
        domain = amrpic.Domain((0, 0, 0), tuple(0.1 * n for n in cells), cells, "open")
        hierarchy = amrpic.Hierarchy(comm, domain, (), 8, 8)
        rho = amrpic.Field(hierarchy).fill(
            lambda x, y, z: np.exp(-50 * ((x - 0.8) ** 2 + (y - 0.5) ** 2 + (z - 0.6) ** 2)) * (y < 0.8)
        )
        phi, report = amrpic.PoissonSolver(hierarchy, tolerance=1e-10).solve(rho)
        assert report.converged, report.reason
        return phi

    odd, even = solved((17, 9, 13)), solved((24, 16, 16))
    points = np.stack(np.meshgrid(*(0.1 * (np.arange(n) + 0.5) for n in (17, 9, 13))), axis=-1).reshape(-1, 3)
    assert odd.sample(points) == pytest.approx(even.sample(points), rel=0, abs=6e-5 * even.max_abs())


def moving(folder: Any, steps: int) -> Scene:
    bunch = {"distribution": "gaussian", "sigma": 0.03, "charge": 1e-11, "particles": 800}
    return Scene.from_dict(
        {
            "domain": {"lower": -0.1, "upper": 0.1, "cells": [9, 13, 7], "boundary": "open"},
            "bunches": [{**bunch, "centre": [0.07, 0.05, 0.08]}],
            "refinement": {"levels": 2, "regrid_every": 1, "max_grid_size": 8, "rule": CROWDED},
            "motion": {"kind": "random-walk", "amplitude": "2 mm"},
            "schedule": {"steps": steps},
            "output": {"directory": str(folder), "write": ["checkpoint", "fields"]},
        }
    )


CROWDED = {"kind": "particles-per-cell", "at_least": 4}


@pytest.mark.mpi(ranks=3, timeout=120)
def test_a_run_goes_on_from_a_checkpoint_on_another_number_of_ranks(comm, tmp_path):
    Simulation(comm, moving(tmp_path, 1)).run()
    whole = Simulation(comm, moving(tmp_path / "whole", 2))
    whole.run()
    alone = Simulation.restart(MPI.COMM_SELF, tmp_path / "checkpoint_00000001", moving(tmp_path / f"{comm.rank}", 2))
    alone.run()
    assert same_region(whole.hierarchy, alone.hierarchy) and alone.hierarchy.levels == 3
    for level in range(3):
        reaches = whole.hierarchy.boxes(level)[:, 3:].max(axis=0) + 1
        assert np.array_equal(reaches, np.array([9, 13, 7]) * 2**level)
        found, expected = dense(alone.phi, level), dense(whole.phi, level)
        assert found == pytest.approx(expected, rel=0, abs=1e-5 * alone.phi.max_abs(), nan_ok=True)
    position = everywhere(comm, whole.particles)["position"]
    assert np.array_equal(everywhere(MPI.COMM_SELF, alone.particles)["position"], position)
