"""Fields between meshes: orders, integrals, bounds, ranks."""

from __future__ import annotations

import itertools
from typing import cast

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Domain, Field, Hierarchy, VectorField
from amrpic.errors import HierarchyError, InputError
from amrpic.mesh.domain import BoundarySpec
from amrpic.stages.regrid import Regridding, carry_over, regrid

LOWER, UPPER = (0.0, -0.2, 0.1), (1.0, 1.0, 0.9)


def domain(cells, boundary: BoundarySpec = "dirichlet") -> Domain:
    return Domain(LOWER, UPPER, cells, boundary)


def in_the_middle(comm: MPI.Comm, n: int, boundary: BoundarySpec = "dirichlet", at: float = 0.25) -> Hierarchy:
    """A base of n cells along each axis, half of it refined along each axis, from a wall on where `at` is zero."""
    first = round(2 * n * at)
    return Hierarchy(comm, domain(n, boundary), [[((first,) * 3, (first + n - 1,) * 3)]], 16, 2)


def random_mesh(comm: MPI.Comm, seed: int, cells, boundary: BoundarySpec = "open", levels: int = 3) -> Hierarchy:
    rng = np.random.default_rng(seed)
    hierarchy = Hierarchy(comm, domain(cells, boundary), (), int(rng.choice([8, 16, 24])), 4)
    static = []
    for level in range(1, levels):
        lower = (2**level * np.array(cells) * rng.choice([0.0, 0.3, 0.5, 0.7], (2, 3))).astype(int)
        static.append(np.hstack([lower, lower + rng.integers(4 * level, 8 * level, (2, 3))]))
    return regrid(hierarchy, [], Regridding(max_levels=levels), static)


def sinc(x):
    return np.sinc(x / np.pi)


def smooth(hierarchy: Hierarchy) -> Field:
    """Means over cells of sin(3x + 0.3) exp(y) cos(2z)."""
    out = Field(hierarchy)
    for patch in out.patches:
        x, y, z = patch.centres()
        a = hierarchy.spacing(patch.level) / 2
        of_x, of_y, of_z = np.sin(3 * x + 0.3) * sinc(3 * a[0]), np.exp(y) * np.sinh(a[1]) / a[1], np.cos(2 * z)
        patch.data[...] = of_x * of_y * of_z * sinc(2 * a[2])
    return out


def waves(hierarchy: Hierarchy) -> Field:
    """Means over cells of 2 plus a wave with the domain's periods, where this is an odd function of no axis."""
    out, length = Field(hierarchy), np.subtract(UPPER, LOWER)
    for patch in out.patches:
        axes = []
        for d, centres in enumerate(patch.centres()):
            k = 2 * np.pi / length[d]
            axes.append(np.sin(k * centres + d) * sinc(k * hierarchy.spacing(patch.level)[d] / 2))
        patch.data[...] = 2 + axes[0] * axes[1] * axes[2]
    return out


def whole(field: Field, level: int) -> np.ndarray:
    """All cells of a level on every rank, nan where it has none. Collective."""
    out = np.full(np.array(field.hierarchy.domain.cells) * 2**level, np.nan)
    parts = [(p.lower, np.array(p.data)) for p in field.patches if p.level == level]
    for lower, data in itertools.chain(*field.comm.allgather(parts)):
        out[tuple(slice(i, i + n) for i, n in zip(lower, data.shape, strict=True))] = data
    return out


def order_of(errors: list[float], sizes: list[int]) -> float:
    return float(-np.polyfit(np.log(sizes), np.log(errors), 1)[0])


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_another_base_has_the_order_of_the_fit_up_to_walls(order):
    sizes, errors = [16, 24, 32] if order < 4 else [24, 32, 40], []
    for n in sizes:
        field = smooth(in_the_middle(MPI.COMM_SELF, n))
        to = in_the_middle(MPI.COMM_SELF, n + n // 4, at=0.0)
        carried = field.remap(to, order)
        errors.append((carried - smooth(to)).max_abs())
        assert carried.integral() == pytest.approx(field.integral(), rel=1e-14, abs=0)
    assert order_of(errors, sizes) > order + 0.8


@pytest.mark.parametrize("at", [0.0, 0.25])
@pytest.mark.parametrize("order", [3, 4])
def test_refined_cells_have_the_order_of_the_fit_up_to_walls(order, at):
    sizes, errors = [16, 24, 32], []
    for n in sizes:
        field = smooth(Hierarchy(MPI.COMM_SELF, domain(n), (), 16, 4))
        to = in_the_middle(MPI.COMM_SELF, n, at=at)
        carried = carry_over(field, to, order)
        errors.append((carried - smooth(to)).max_abs())
        assert carried.integral() == pytest.approx(field.integral(), rel=1e-14, abs=0)
    assert order_of(errors, sizes) > order + 0.8


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_polynomials_are_carried_exactly_across_levels_and_walls(order):
    """Means of (x + y - 2z)^order by Gauss points, on random meshes of two bases."""

    def means(hierarchy: Hierarchy) -> Field:
        nodes, weights = np.polynomial.legendre.leggauss(3)
        out = Field(hierarchy)
        for patch in out.patches:
            x, y, z = patch.centres()
            h = hierarchy.spacing(patch.level) / 2
            for (u, wu), (v, wv), (w, ww) in itertools.product(zip(nodes, weights, strict=True), repeat=3):
                at = (x + u * h[0]) + (y + v * h[1]) - 2 * (z + w * h[2])
                patch.data[...] += wu * wv * ww / 8 * at**order
        return out

    for seed in range(3):
        a = random_mesh(MPI.COMM_SELF, seed, (24, 16, 20))
        b = random_mesh(MPI.COMM_SELF, seed + 10, (20, 20, 16) if seed else (24, 16, 20))
        assert (means(a).remap(b, order) - means(b)).max_abs() < 3e-12


@pytest.mark.mpi(ranks=(1, 2))
def test_what_is_carried_holds_what_it_held(comm):
    means = Field(in_the_middle(comm, 8)).fill(lambda x, y, z: x * x * y + z).as_means()
    other = Hierarchy(comm, domain(8), (), 16, 2)
    assert means.remap(other).holds == carry_over(means, other).holds == "means"
    assert means.as_points().remap(other).holds == carry_over(means.as_points(), other).holds == "points"


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize(
    ("boundary", "order", "bounds"), [("open", 2, None), ("periodic", 3, "neighbours"), ("open", 4, (0.5, 3.5))]
)
def test_ranks_agree_bit_for_bit(comm, boundary, order, bounds):
    def carried(on: MPI.Comm) -> list[np.ndarray]:
        levels = 3 if order < 4 else 2
        field = waves(random_mesh(on, 1, (16, 12, 12), boundary, levels))
        for seed, cells in enumerate([(16, 12, 12), (12, 16, 20)], start=2):
            field = field.remap(random_mesh(on, seed, cells, boundary, levels), order, bounds)
        return [whole(field, level) for level in range(field.hierarchy.levels)]

    for alone, together in zip(carried(MPI.COMM_SELF), carried(comm), strict=True):
        assert np.array_equal(alone, together, equal_nan=True)


def test_boxes_do_not_matter():
    field = waves(in_the_middle(MPI.COMM_SELF, 16))
    boxes = [[((0, 0, 0), (15, 15, 15))]]
    large, small = (Hierarchy(MPI.COMM_SELF, domain(20), boxes, size, 4) for size in (24, 8))
    for level in range(2):
        one, other = whole(field.remap(large, 3), level), whole(field.remap(small, 3), level)
        assert np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("order", [3, 4])
def test_periodic_faces_are_no_walls(order):
    """Errors at the faces are no larger than within, and a shift by half a period only shifts the result."""
    n = 16
    field = waves(Hierarchy(MPI.COMM_SELF, domain(n, "periodic"), (), 16, 4))
    to = Hierarchy(MPI.COMM_SELF, domain(n + 4, "periodic"), (), 20, 4)
    errors = np.abs(whole(field.remap(to, order), 0) - whole(waves(to), 0))
    within = errors[4:-4, 4:-4, 4:-4].max()
    assert errors.max() < 1.2 * within
    shifted = field.copy()
    rolled = np.roll(whole(field, 0), n // 2, axis=(0, 1, 2))
    for patch in shifted.patches:
        patch.data[...] = rolled[tuple(slice(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True))]
    again = np.roll(whole(shifted.remap(to, order), 0), -(n + 4) // 2, axis=(0, 1, 2))
    assert again == pytest.approx(whole(field.remap(to, order), 0), abs=1e-14)


def steps(hierarchy: Hierarchy) -> Field:
    """A ball of density one, cell by cell, on a smooth slope where it is zero."""
    return Field(hierarchy).fill(
        lambda x, y, z: np.where((x - 0.5) ** 2 + (y - 0.4) ** 2 + (z - 0.5) ** 2 < 0.04, 1.0, 0.1 * x * x)
    )


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("cells", [16, 22])
def test_with_bounds_no_value_is_outside(order, cells):
    field = steps(in_the_middle(MPI.COMM_SELF, 16))
    to = in_the_middle(MPI.COMM_SELF, cells, at=0.0)
    least, most = field.min(), field.max()
    free, held = field.remap(to, order), field.remap(to, order, (least, most))
    near = field.remap(to, order, "neighbours")
    assert free.min() < least - 1e-3, "without bounds the jump is overshot"
    for found in (held, near):
        assert least <= found.min() and found.max() <= most
        assert found.integral() == pytest.approx(field.integral(), rel=1e-14, abs=0)
    assert np.ptp(whole(carry_over(field, in_the_middle(MPI.COMM_SELF, 16, at=0.0), order, "neighbours"), 0)) <= 1


@pytest.mark.parametrize("bounds", [(0.0, np.inf), (-np.inf, 1.0), (-np.inf, np.inf)])
def test_one_bound_is_enough_and_keeps_the_integral(bounds):
    field = steps(in_the_middle(MPI.COMM_SELF, 16))
    to = in_the_middle(MPI.COMM_SELF, 20, at=0.0)
    found, free = (field.remap(to, 4, given) for given in (bounds, None))
    assert bounds[0] <= found.min() and found.max() <= bounds[1]
    assert found.integral() == pytest.approx(field.integral(), rel=1e-14, abs=0)
    if bounds == (-np.inf, np.inf):
        assert (found - free).max_abs() < 1e-15
    else:
        assert (found - free).max_abs() > 1e-3


def test_bounds_by_neighbours_are_those_of_the_cells_that_touch():
    field = steps(Hierarchy(MPI.COMM_SELF, domain(16), (), 16, 4))
    to = Hierarchy(MPI.COMM_SELF, domain(16), [[((0, 0, 0), (31, 31, 31))]], 32, 4)
    fine = whole(carry_over(field, to, 4, "neighbours"), 1)
    padded = np.pad(whole(field, 0), 1, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3, 3))
    least, most = (
        np.repeat(np.repeat(np.repeat(f(around, axis=(3, 4, 5)), 2, 0), 2, 1), 2, 2) for f in (np.min, np.max)
    )
    assert (fine >= least).all() and (fine <= most).all()


@pytest.mark.parametrize("bounds", ["neighbours", (0.0, 2.0)])
@pytest.mark.parametrize("order", [3, 4])
def test_bounds_keep_the_order_where_the_density_is_smooth(order, bounds):
    """A monotone density with a jump at x = 3/4: measured where x < 1/2."""

    def density(hierarchy: Hierarchy) -> Field:
        out = Field(hierarchy)
        for patch in out.patches:
            x, y, z = patch.centres()
            a = hierarchy.spacing(patch.level) / 2
            rising = np.exp(x / 2 + y / 3 + z / 4)
            for d, k in enumerate((1 / 2, 1 / 3, 1 / 4)):
                rising = rising * np.sinh(k * a[d]) / (k * a[d])
            patch.data[...] = np.where(x < 0.75, rising / 2, 0.0)
        return out

    sizes, errors = [16, 24, 32], []
    for n in sizes:
        field = density(Hierarchy(MPI.COMM_SELF, domain(n), (), 16, 4))
        to = Hierarchy(MPI.COMM_SELF, domain(n + n // 4), (), 20, 4)
        carried, exact = whole(field.remap(to, order, bounds), 0), whole(density(to), 0)
        assert carried.min() >= 0 and carried.max() <= 2
        errors.append(np.abs(carried - exact)[2 : len(exact) // 2, 2:-2, 2:-2].max())
    assert order_of(errors, sizes) > order + 0.8


def test_what_both_have_is_copied_and_a_way_there_and_back_changes_nothing():
    rng = np.random.default_rng(1)
    old = random_mesh(MPI.COMM_SELF, 4, (24, 16, 20))
    field = Field(old)
    for level in range(old.levels):
        field.array(level)[:] = rng.random(field.array(level).size)
    field.average_down()
    finer = random_mesh(MPI.COMM_SELF, 5, (24, 16, 20))
    out, copied = carry_over(field, finer, 4), 0
    for level in range(3):
        before, after = whole(field, level), whole(out, level)
        leaves = np.zeros(before.shape, bool)
        for mesh in (field, out):
            for patch in mesh.patches:
                if patch.level == level:
                    part = tuple(slice(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True))
                    leaves[part] |= patch.covered
        both = ~np.isnan(before) & ~np.isnan(after) & ~leaves
        assert np.array_equal(before[both], after[both])
        copied += both.sum()
    assert copied > 1000
    everywhere = Hierarchy(MPI.COMM_SELF, domain((24, 16, 20)), [[((0, 0, 0), (47, 31, 39))]], 24, 4)
    base = Hierarchy(MPI.COMM_SELF, domain((24, 16, 20)), (), 24, 4)
    start = whole(field.remap(base), 0)
    assert np.abs(whole(field.remap(base).remap(everywhere, 4).remap(base), 0) - start).max() < 1e-14


@pytest.mark.parametrize("cells", [(2, 16, 16), (3, 3, 3), (16, 4, 2)])
def test_few_cells_across_lower_the_order_alone(cells):
    """Linear fields stay exact where two cells lie across the domain."""

    def linear(hierarchy: Hierarchy) -> Field:
        return Field(hierarchy).fill(lambda x, y, z: 1 + x - 2 * y + 3 * z)

    field = linear(Hierarchy(MPI.COMM_SELF, domain(cells), (), 16, 2))
    to = Hierarchy(MPI.COMM_SELF, domain((12, 10, 9)), (), 16, 2)
    for order in (1, 2, 3, 4):
        assert (field.remap(to, order) - linear(to)).max_abs() < 1e-12


def test_long_cells_take_as_many_neighbours_as_cubes():
    long = Domain((0, 0, 0), (1, 1, 40), 16, "dirichlet")
    field = Field(Hierarchy(MPI.COMM_SELF, long, (), 16, 4)).fill(lambda x, y, z: np.exp(x + y + z / 40))
    to = Hierarchy(MPI.COMM_SELF, Domain((0, 0, 0), (1, 1, 40), 20, "dirichlet"), (), 20, 4)
    cube = Field(Hierarchy(MPI.COMM_SELF, Domain(0, 1, 16, "dirichlet"), (), 16, 4)).fill(
        lambda x, y, z: np.exp(x + y + z)
    )
    to_cube = Hierarchy(MPI.COMM_SELF, Domain(0, 1, 20, "dirichlet"), (), 20, 4)
    assert whole(field.remap(to, 4), 0) == pytest.approx(whole(cube.remap(to_cube, 4), 0), rel=1e-12)


def test_constants_stay_what_they_are():
    field = Field(random_mesh(MPI.COMM_SELF, 1, (24, 16, 20)), "V").fill(0.1)
    to = random_mesh(MPI.COMM_SELF, 2, (20, 28, 16))
    for order, bounds in ((1, None), (4, None), (4, "neighbours"), (3, (0.1, 0.1))):
        found = field.remap(to, order, bounds)
        assert found.min() == found.max() == 0.1 and found.unit == "V"


def test_vectors_are_carried_component_by_component():
    parts = [
        factor * smooth_field for smooth_field in [smooth(in_the_middle(MPI.COMM_SELF, 16))] for factor in (1, -2, 3)
    ]
    to = in_the_middle(MPI.COMM_SELF, 20)
    found = VectorField(*parts).remap(to, 3)
    for part, component in zip(parts, found.components, strict=True):
        assert np.array_equal(whole(component, 1), whole(part.remap(to, 3), 1), equal_nan=True)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda f, to: f.remap(to, order=5), InputError, "the order of the fit is 5; use 1, 2, 3 or 4"),
        (lambda f, to: f.remap(to, order=True), InputError, "the order of the fit is True; use 1, 2, 3 or 4"),
        (lambda f, to: f.remap(to, order="3"), InputError, "the order of the fit is '3'; use 1, 2, 3 or 4"),
        (lambda f, to: f.remap(to, order=2.0), InputError, "the order of the fit is 2.0; use 1, 2, 3 or 4"),
        (lambda f, to: f.remap(to, order=np.arange(3)), InputError, r"fit is array\(\[0, 1, 2\]\); use 1, 2, 3 or 4"),
        (lambda f, to: carry_over(f, f.hierarchy, cast(int, 3.0)), InputError, "is 3.0; use 2, 3 or 4"),
        (lambda f, to: f.remap(to, bounds="05"), InputError, "bounds are '05'; use \"neighbours\", or the least"),
        (lambda f, to: carry_over(f, f.hierarchy, 1), InputError, "is 1; use 2, 3 or 4"),
        (lambda f, to: f.remap(to, bounds="none"), InputError, "bounds are 'none'; use \"neighbours\", or the least"),
        (lambda f, to: f.remap(to, bounds=(1, 2, 3)), InputError, r"bounds are \(1, 2, 3\); use \"neighbours\""),
        (lambda f, to: f.remap(to, bounds=7), InputError, "bounds are 7; use \"neighbours\""),
        (lambda f, to: f.remap(to, bounds=(2, 1)), InputError, "bounds are 2.0 and 1.0; give the least value first"),
        (lambda f, to: f.remap(to, bounds=(0, np.nan)), InputError, "bounds are 0.0 and nan; give the least value first"),
        (lambda f, to: f.remap(to, bounds=(1.5, 4)), InputError, r"holds 1.\d+, outside of the bounds 1.5 and 4; give bounds"),
        (lambda f, to: f.remap(to, bounds=(0, 2)), InputError, r"holds 2.\d+, outside of the bounds 0 and 2; give bounds"),
        (lambda f, to: f.remap(None), InputError, "None to live on; give an amrpic.Hierarchy"),
        (
            lambda f, to: f.remap(Hierarchy(f.comm, Domain(0, 1, 16), (), 16, 4)),
            HierarchyError,
            r"the field lives on \(0.0, -0.2, 0.1\) to .* m, the new hierarchy on .*; make both on one domain",
        ),
        (lambda f, to: carry_over(f, to, 3), HierarchyError, "on another domain than the new hierarchy"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_a_sentence(comm, call, error, message):
    field = waves(in_the_middle(comm, 16))
    with pytest.raises(error, match=message):
        call(field, in_the_middle(comm, 20))


@pytest.mark.mpi(ranks=(2,))
def test_a_mesh_of_other_ranks_is_refused(comm):
    with pytest.raises(
        HierarchyError, match="lives on 2 ranks and the new hierarchy on 1; make both on one communicator"
    ):
        waves(in_the_middle(comm, 16)).remap(in_the_middle(MPI.COMM_SELF, 16))
