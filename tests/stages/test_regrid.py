"""Tagging by fields, fields carried over to new hierarchies, and the balance of work."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Domain, Field, Hierarchy
from amrpic.errors import HierarchyError
from amrpic.mesh.domain import BoundarySpec
from amrpic.stages.regrid import Regridding, carry_over, regrid
from amrpic.stages.tag import exceeding, magnitude

CELLS = (24, 16, 32)


def domain(boundary: BoundarySpec = "open", cells=CELLS) -> Domain:
    return Domain((0, 0, 0), (1.5, 1.0, 2.0), cells, boundary)


def random_mesh(comm: MPI.Comm, seed: int, boundary: BoundarySpec = "open", levels: int = 3) -> Hierarchy:
    """A mesh around a few random places, with boxes of random sizes."""
    rng = np.random.default_rng(seed)
    hierarchy = Hierarchy(comm, domain(boundary), (), int(rng.choice([8, 16, 24])), 4)
    static = []
    for level in range(1, levels):
        lower = (2**level * np.array(CELLS) * rng.choice([0.0, 0.3, 0.5, 0.7], (3, 3))).astype(int)
        static.append(np.hstack([lower, lower + rng.integers(4 * level, 12 * level, (3, 3))]))
    return regrid(hierarchy, [], Regridding(max_levels=levels), static)


def linear(x, y, z):
    return 3.0 + 2.0 * x - 1.0 * y + 0.5 * z


def gaussian(p):
    return lambda x, y, z: np.exp(-20 * ((x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2))


def deviation(field: Field, function) -> float:
    """Largest difference from a function at cell centres, covered cells included. Collective."""
    exact = Field(field.hierarchy).fill(function)
    levels = range(field.hierarchy.levels)
    here = [np.abs(field.array(l) - exact.array(l)).max(initial=0.0) for l in levels]
    return field.comm.allreduce(max(here), op=MPI.MAX)


def whole(field: Field, level: int) -> np.ndarray:
    """All cells of a level as one array on every rank, nan where it has none. Collective."""
    out = np.full(np.array(CELLS) * 2**level, np.nan)
    parts = [(p.lower, np.array(p.data)) for p in field.patches if p.level == level]
    for lower, data in itertools.chain(*field.comm.allgather(parts)):
        out[tuple(slice(i, i + n) for i, n in zip(lower, data.shape, strict=True))] = data
    return out


def family_means(fine: np.ndarray) -> np.ndarray:
    a, b, c = (n // 2 for n in fine.shape)
    return fine.reshape(a, 2, b, 2, c, 2).mean(axis=(1, 3, 5))


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize(
    "boundary", ["open", "periodic", {"x": "periodic", "y": ("dirichlet", "neumann"), "z": "neumann"}]
)
def test_constants_are_carried_over_exactly(comm, boundary):
    field = Field(random_mesh(comm, 1, boundary), "V").fill(lambda x, y, z: 7.25)
    for seed in range(2, 8):
        field = carry_over(field, random_mesh(comm, seed, boundary, levels=2 + seed % 3))
        assert deviation(field, lambda x, y, z: 7.25) < 1e-14
    assert field.unit == "V"


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_linear_fields_are_carried_over_exactly_up_to_the_walls(comm):
    field = Field(random_mesh(comm, 1)).fill(linear)
    for seed in range(2, 8):
        field = carry_over(field, random_mesh(comm, seed, levels=2 + seed % 3))
        assert deviation(field, linear) < 1e-13


@pytest.mark.mpi(ranks=(1, 2))
def test_interpolation_is_of_third_order(comm):
    """Means over cells of products of cosines, periodic, refined everywhere."""
    errors = []
    for n in (8, 16, 32):
        cube = Domain((0, 0, 0), (1, 1, 1), (n, n, n), "periodic")
        coarse = Hierarchy(comm, cube, (), 16, 8)
        fine = Hierarchy(comm, cube, [[((0, 0, 0), (2 * n - 1, 2 * n - 1, 2 * n - 1))]], 16, 8)

        def cell_means(hierarchy, level):
            h = float(hierarchy.spacing(level)[0])
            damping = np.sinc(h) ** 3  # mean of a cosine of period 1 over a cell, per axis
            return lambda x, y, z: damping * np.cos(2 * np.pi * x) * np.sin(2 * np.pi * y) * np.cos(2 * np.pi * z)

        field = carry_over(Field(coarse).fill(cell_means(coarse, 0)), fine)
        exact = Field(fine).fill(cell_means(fine, 1))
        here = np.abs(field.array(1) - exact.array(1)).max(initial=0.0)
        errors.append(comm.allreduce(here, op=MPI.MAX))
    assert np.log2(errors[1] / errors[2]) > 2.8


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("boundary", ["open", "periodic"])
def test_what_existed_is_copied_and_what_is_new_has_the_mean_of_its_parent(comm, boundary):
    rng = np.random.default_rng(comm.rank)
    old = random_mesh(comm, 4, boundary)
    field = Field(old)
    for level in range(old.levels):
        field.array(level)[:] = rng.random(field.array(level).size)
    make_covered_cells_means(field)
    new = random_mesh(comm, 5, boundary)
    out = carry_over(field, new)
    before = [whole(field, level) for level in range(old.levels)]
    after = [whole(out, level) for level in range(new.levels)]
    for level in range(3):
        both = ~np.isnan(before[level]) & ~np.isnan(after[level])
        assert both.any() and np.array_equal(before[level][both], after[level][both])
        assert np.all(~np.isnan(after[level]) == (whole(Field(new), level) == 0)), "a cell was left without a value"
    for level in range(1, 3):
        means = family_means(after[level])
        there = ~np.isnan(means)
        assert np.abs(means - after[level - 1])[there].max() < 1e-14
        assert (np.isnan(family_means(before[level])) & there).any(), "nothing was newly refined"
    assert out.integral() == pytest.approx(field.integral(), rel=1e-13, abs=0)


def make_covered_cells_means(field: Field) -> None:
    for level in range(field.hierarchy.levels - 1, 0, -1):
        means = family_means(whole(field, level))
        for patch in field.patches:
            if patch.level == level - 1:
                part = means[tuple(slice(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True))]
                patch.data[...] = np.where(np.isnan(part), patch.data, part)


@pytest.mark.mpi(ranks=(2, 3))
def test_ranks_agree_bit_for_bit(comm):
    def carried(on: MPI.Comm) -> list[np.ndarray]:
        field = Field(random_mesh(on, 1, "periodic")).fill(lambda x, y, z: np.sin(9 * x) * np.cos(7 * y + z))
        for seed in (2, 3, 4):
            field = carry_over(field, random_mesh(on, seed, "periodic"))
        return [whole(field, level) for level in range(3)]

    for alone, together in zip(carried(MPI.COMM_SELF), carried(comm), strict=True):
        assert np.array_equal(alone, together, equal_nan=True)


@pytest.mark.mpi(ranks=(1, 2, 3), timeout=120)
def test_fifty_regrids_in_a_row_do_not_drift(comm):
    """A tagged region that wanders: the integral stays, and where nothing was ever refined the values stay."""
    rng = np.random.default_rng(5)
    settings = Regridding(max_levels=3, buffer=1, nesting=1)
    hierarchy = Hierarchy(comm, domain("periodic"), (), 16, 4)
    field = Field(hierarchy).fill(lambda x, y, z: 1.0 + x * y * z)
    base, charge, mesh_changes = whole(field, 0), field.integral(), 0
    for _ in range(50):
        place, shape = rng.random(3) * (1.5, 1.0, 2.0), Field(hierarchy)
        shape.fill(gaussian(place))
        values = magnitude(shape, "shape")
        new = regrid(hierarchy, exceeding(values, np.full(len(values), 0.5)), settings)
        mesh_changes += new is not hierarchy
        field, hierarchy = carry_over(field, new), new
    assert mesh_changes > 40
    assert field.integral() == pytest.approx(charge, rel=1e-12, abs=0)
    assert np.abs(whole(field, 0) - base).max() < 1e-12


@pytest.mark.mpi(ranks=(1, 2))
def test_carrying_over_to_another_domain_is_refused(comm):
    other = Hierarchy(comm, domain("periodic"), (), 16, 4)
    with pytest.raises(HierarchyError, match="another domain"):
        carry_over(Field(random_mesh(comm, 1)), other)
