"""The potential behind an open wall: the one that the 7-point operator itself has on an infinite lattice.

The reference is the convolution with the lattice Green's function by FFT, exact to rounding.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI
from scipy.special import erf

from amrpic import Domain, Field, Hierarchy, PoissonSolver
from amrpic._native import kernel_table_bytes, lattice_green, multipole_moments, translate_moments
from amrpic.errors import SolverError
from exact.lattice import FreeLattice
from exact.meshes import Mesh
from exact.sources import EPS0, Gaussian, fill
from lattice_between_faces import ghosts_of, solved
from open_walls import density, greatest_difference, mesh, noise, own_walls, planes_of, walls, with_patch

# ---- the reference ----


@pytest.fixture(scope="module")
def exact_48():
    return FreeLattice((48, 48, 48))


def field(charges, planes):
    """Potential and E on unit cells, solved with given ghost values."""
    return solved(charges, (1.0, 1.0, 1.0), (("open", "open"),) * 3, planes)


# ---- sources on [-1.04, 1.04]^3 ----


def gaussian(n, centre, sigma, charge=1.0, half_width=1.04):
    faces = np.linspace(-half_width, half_width, n + 1)
    x, y, z = (np.diff(erf((faces - c) / (np.sqrt(2) * sigma))) / 2 for c in centre)
    return charge * x[:, None, None] * y[:, None] * z


def ball(n, radius, half_width=1.04):
    h = 2 * half_width / n
    x = (np.arange(4 * n) + 0.5) * h / 4 - half_width
    inside = (x[:, None, None] ** 2 + x[:, None] ** 2 + x**2 < radius**2).astype(np.float32)
    charge = inside.reshape(n, 4, n, 4, n, 4).sum((1, 3, 5), dtype=float)
    return charge / charge.sum()


SOURCES = {
    "ball up to the wall": lambda n: ball(n, 1.0),
    "ball of half the width": lambda n: ball(n, 0.5),
    "bunch": lambda n: gaussian(n, (0, 0, 0), 1 / 5.5),
    "bunch off centre": lambda n: gaussian(n, (0.5, 0.3, -0.4), 0.08),
    "train on the diagonal": lambda n: sum(gaussian(n, (x, x, 0), 0.04, 0.1) for x in np.linspace(-0.9, 0.9, 10)),
    "neutral pair": lambda n: gaussian(n, (0.3, 0, 0), 0.1) - gaussian(n, (-0.3, 0.1, 0), 0.1),
}


# ---- the operator of fourth order: potentials are means over cells ----


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (1.0, 2.0, 10.0), (1.0, 1.0, 40.0)])
def test_lattice_green_of_fourth_order_inverts_its_operator_and_fades(spacing):
    octant = lattice_green(spacing, (14, 14, 14), order=4).T
    offsets = np.abs(np.arange(-13, 14))
    g = octant[np.ix_(offsets, offsets, offsets)]
    weights = {0: 30, 1: -16, -1: -16, 2: 1, -2: 1}
    minus_laplacian = sum(w * np.roll(g, n, d) / 12 / spacing[d] ** 2 for d in range(3) for n, w in weights.items())[
        (slice(2, -2),) * 3
    ]
    unit = np.zeros_like(minus_laplacian)
    unit[11, 11, 11] = 1 / np.prod(spacing)
    assert np.abs(minus_laplacian - unit).max() < 1e-14
    far = lattice_green(spacing, (0, 0, 64), order=4)[-1, 0, 0]
    assert 4 * np.pi * 64 * spacing[2] * far == pytest.approx(1, abs=1e-7)


def largest_error_of_ghosts(cells, spacing, charges):
    """Of both ghosts of fourth order at 40 faces against sums over the lattice, over the largest of these."""
    faces, inside, values = own_walls(density(mesh(tuple(cells), spacing), charges), order=4)[0]
    green = lattice_green(spacing, tuple(cells + 3), order=4).T
    places = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"))
    sums = np.zeros((40, 2))
    chosen = np.random.default_rng(2).integers(0, len(faces), len(sums))
    for n, layer in np.ndindex(sums.shape):
        ghost = inside[chosen[n]].copy()
        ghost[faces[chosen[n]] // 2] += (1 + layer) * (1 if faces[chosen[n]] % 2 else -1)
        sums[n, layer] = (green[tuple(np.abs(places - ghost[:, None, None, None]))] * charges).sum()
    return np.abs(values[chosen] - sums).max() / np.abs(sums).max()


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (1.0, 1.0, 4.0), (1.0, 2.0, 10.0)])
def test_both_ghosts_of_fourth_order_are_sums_over_the_lattice(spacing):
    cells = np.array((24, 20, 16))
    charges = np.random.default_rng(1).normal(size=tuple(cells)) + 1
    assert largest_error_of_ghosts(cells, spacing, charges) < 1e-5


def test_tails_next_to_walls_may_be_multipoles_sooner():
    cells = np.array((48, 48, 48))
    r2 = sum((axis - 23.5) ** 2 for axis in np.meshgrid(*map(np.arange, cells), indexing="ij"))
    assert largest_error_of_ghosts(cells, (1.0, 1.0, 1.0), np.exp(-r2 / (2 * 7.0**2))) < 2e-6


@pytest.mark.parametrize("size", [(1.0, 1.0, 1.0), (1.0, 1.0, 10.0)])
def test_ghosts_of_fourth_order_are_means_whatever_level_the_charge_is_on(size):
    """Charge inside a refined patch, ghosts of the patch and of the base: long cells differ in their means by h²."""
    levels = (((0, 2, 2), (3, 6, 6)),)
    source = Gaussian(tuple(0.035 * np.array(size)), tuple(np.array((0.2, 0.5, 0.5)) * size))
    worst = []
    for n in (32, 64):
        hierarchy = Mesh((levels,), size).hierarchy(MPI.COMM_SELF, n, "open")
        rho = fill(Field(hierarchy), source)
        worst.append(0.0)
        for level, (faces, cells, values) in enumerate(own_walls(rho, order=4)):
            h = np.array(hierarchy.spacing(level))
            for layer in (0, 1):
                ghosts = cells.astype(float)
                ghosts[np.arange(len(ghosts)), faces // 2] += (1 + layer) * np.where(faces % 2, 1, -1)
                mean = np.zeros(len(ghosts))
                for corner in itertools.product((-1, 1), repeat=3):  # Gauss's points
                    at = (ghosts + 0.5 + np.array(corner) / np.sqrt(12)) * h
                    mean += source.potential(*at.T) / 8
                worst[-1] = max(worst[-1], np.abs(values[:, layer] / EPS0 - mean).max() / mean.max())
    assert worst[1] < (3e-6 if size[2] == 1 else 3e-5)  # values at the ghosts' centres are 8e-7 and 3e-3 off
    assert worst[0] / worst[1] > 7  # 16 less what the tree leaves


# ---- the Green's function and the multipoles ----


def test_lattice_green_has_the_known_values():
    table = lattice_green((1.0, 1.0, 1.0), (32, 32, 32))
    assert table[0, 0, 0] == pytest.approx(0.2527310098586627, abs=1e-15)
    assert table[0, 0, 1] == pytest.approx(0.0860643431919963, abs=1e-15)
    assert table[0, 1, 1] == pytest.approx(0.0551914336877373, abs=1e-15)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (1.0, 2.0, 10.0), (1.0, 1.0, 100.0)])
def test_lattice_green_inverts_the_operator(spacing):
    octant = lattice_green(spacing, (13, 13, 13)).T
    offsets = np.abs(np.arange(-12, 13))
    g = octant[np.ix_(offsets, offsets, offsets)]
    inner = (slice(1, -1),) * 3
    minus_laplacian = sum((2 * g - np.roll(g, 1, d) - np.roll(g, -1, d))[inner] / spacing[d] ** 2 for d in range(3))
    delta = np.zeros((23, 23, 23))
    delta[11, 11, 11] = 1 / np.prod(spacing)
    assert np.abs(minus_laplacian - delta).max() < 2e-14 * delta.max()


def test_moved_moments_are_those_about_the_new_centre():
    rng = np.random.default_rng(1)
    positions, charges = rng.uniform(-1, 1, (50, 3)), rng.standard_normal(50)
    old, new, shift = (0.1, -0.2, 0.3), (-0.7, 0.5, 0.2), (0.8, -0.7, 0.1)
    moved = translate_moments(multipole_moments(positions, charges, old), shift)
    assert moved == pytest.approx(multipole_moments(positions, charges, new), abs=1e-13)


# ---- walls ----


@pytest.mark.parametrize("source", SOURCES)
def test_wall_values_are_those_of_the_infinite_lattice(source, exact_48):
    charges = SOURCES[source](48)
    expected = exact_48(charges)
    assert greatest_difference(walls(charges), ghosts_of(expected)) < 6e-5 * np.abs(expected).max()


def test_wall_values_of_a_train_on_a_finer_lattice():
    charges = SOURCES["train on the diagonal"](96)
    expected = FreeLattice((96, 96, 96))(charges)
    assert greatest_difference(walls(charges), ghosts_of(expected)) < 6e-5 * np.abs(expected).max()


def test_no_narrow_peak_hides_behind_a_wide_one(exact_48):
    # Weak single cells in the outermost layer, anywhere, behind the field of a strong wide bunch.
    rng = np.random.default_rng(7)
    for _ in range(6):
        charges = gaussian(48, (0, 0, 0), 1 / 5.5)
        cell = rng.integers(0, 48, 3)
        cell[rng.integers(3)] = 0
        charges[tuple(cell)] += 3e-4
        expected = exact_48(charges)
        assert greatest_difference(walls(charges), ghosts_of(expected)) < 4e-5 * np.abs(expected).max()


def test_random_charge_along_a_wall(exact_48):
    charges = np.zeros((48, 48, 48))
    charges[:, :6] = np.random.default_rng(3).standard_normal((48, 6, 48))
    planes = ghosts_of(exact_48(charges))
    expected, _ = field(charges, planes)
    assert greatest_difference(walls(charges), planes) < 4e-4 * np.abs(expected).max()


def test_no_charge_gives_no_potential():
    assert greatest_difference(walls(np.zeros((16, 16, 16))), [np.zeros((16, 16))] * 6) == 0


def test_only_open_walls_are_computed():
    boundary = [["open", "dirichlet"], ["open", "open"], ["dirichlet", "dirichlet"]]
    charges = np.zeros((16, 16, 16))
    charges[8, 8, 8] = 1
    planes = planes_of(density(mesh(charges.shape, boundary=boundary), charges))
    assert [bool(np.isfinite(p).all()) for p in planes] == [True, False, True, True, False, False]


@pytest.mark.parametrize("cells", [(2, 3, 5), (20, 33, 50), (8, 100, 17)])
def test_boxes_of_any_shape(cells):
    charges = np.random.default_rng(2).random(cells) ** 4
    expected = FreeLattice(cells)(charges)
    assert greatest_difference(walls(charges), ghosts_of(expected)) < 5e-5 * np.abs(expected).max()


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 10.0), (10.0, 1.0, 1.0), (3.0, 1.0, 2.0)])
def test_cells_that_are_not_cubes(spacing):
    cells = (32, 24, 40)
    charges = np.zeros(cells)
    charges[3:20, 5:15, 10:30] = np.random.default_rng(4).random((17, 10, 20))
    charges[0, 3, 39] = 30
    expected = FreeLattice(cells, spacing)(charges)
    assert greatest_difference(walls(charges, spacing), ghosts_of(expected)) < 2e-4 * np.abs(expected).max()


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 10.0), (10.0, 1.0, 1.0)])
def test_long_cells_with_charge_all_over(spacing):
    charges = np.random.default_rng(6).random((40, 40, 40)) ** 8
    expected = FreeLattice(charges.shape, spacing)(charges)
    assert greatest_difference(walls(charges, spacing), ghosts_of(expected)) < 5e-5 * np.abs(expected).max()


@pytest.mark.parametrize("charge", [1e-30, 1e3])
@pytest.mark.parametrize("spacing", [1e-9, 1e6])
def test_neither_charge_nor_size_matters(charge, spacing):
    charges = gaussian(16, (0.5, 0.3, -0.4), 0.2)
    for plane, expected in zip(walls(charge * charges, (spacing,) * 3), walls(charges), strict=True):
        assert pytest.approx(charge / spacing * expected, rel=1e-12) == plane


@pytest.mark.parametrize("source", SOURCES)
def test_interpolation_over_patches_adds_nothing_that_is_seen(source, exact_48):
    charges = SOURCES[source](48)
    found = [walls(charges, separation=far) for far in (1.25, 1e9)]  # 1e9: all of the tree is evaluated at every ghost
    assert greatest_difference(*found) < 1e-6 * np.abs(exact_48(charges)).max()


# ---- refined charge ----


def point_charges(rho):
    """Positions and charges of the uncovered cells."""
    positions, charges = [], []
    for patch in rho.patches:
        counts = ~patch.covered
        positions.append(np.stack(np.broadcast_arrays(*patch.centres()), -1)[counts])
        charges.append(patch.data[counts] * np.prod(rho.hierarchy.spacing(patch.level)))
    return np.concatenate(positions), np.concatenate(charges)


def test_potential_of_refined_charge_at_distant_walls():
    n = 16
    rho = with_patch(gaussian(2 * n, (0.0, 0.05, -0.05), 0.07, half_width=0.5), (5, 5, 5), (10, 10, 10))
    positions, charges = point_charges(rho)
    u = (np.arange(n) + 0.5) / n
    places = np.stack(np.meshgrid([-0.5 / n], u, u, indexing="ij"), -1)[0]
    expected = (charges / (4 * np.pi * np.linalg.norm(places[:, :, None] - positions, axis=-1))).sum(-1)
    # What is left is the lattice: (h / 2r)^2 of the fine one.
    assert pytest.approx(expected, rel=2e-3) == planes_of(rho)[0]


def test_patch_at_the_wall_agrees_with_a_lattice_that_is_fine_everywhere():
    n, lower, upper = 16, (0, 3, 3), (7, 12, 12)
    fine = gaussian(2 * n, (-0.44, 0.0, -0.03), 0.05, half_width=0.5)
    rho = with_patch(fine, lower, upper)

    margin = 4
    around = FreeLattice((2 * n + 2 * margin,) * 3)(np.pad(fine, margin)) * 2 * n
    around = around[1:-1, 1:-1, 1:-1]
    scale = np.abs(around).max()
    wall = slice(margin, -margin)
    base_ghosts = around[margin - 2 : margin, wall, wall].reshape(2, n, 2, n, 2).mean((0, 2, 4))
    assert np.abs(planes_of(rho)[0] - base_ghosts).max() < 1e-4 * scale

    patch = slice(2 * lower[1], 2 * upper[1] + 2)
    expected = around[margin - 1, wall, wall][patch, patch]
    assert np.abs(planes_of(rho, 1)[0][patch, patch] - expected).max() < 1e-4 * scale


def test_fine_ghosts_beside_coarse_charge_continue_the_coarse_potential():
    n = 16
    base, fine = np.zeros((n,) * 3), np.zeros((2 * n,) * 3)
    base[2, 8, 8] = 1
    rho = density(mesh((n,) * 3, (1 / n,) * 3, [((0, 20, 0), (3, 31, 31)), ((0, 0, 0), (3, 11, 31))]), base, fine)
    found = planes_of(rho, 1)[0]
    ghosts = np.array([[-1, 23, 15], [-1, 0, 0], [-1, 20, 22]])
    distance = np.linalg.norm((ghosts + 0.5) / (2 * n) - (np.array([2, 8, 8]) + 0.5) / n, axis=1)
    assert found[tuple(ghosts[:, 1:].T)] == pytest.approx(1 / (4 * np.pi * distance), rel=2e-2)


@pytest.mark.parametrize("shape", [(1, 1, 20), (20, 1, 1), (1, 20, 20), (1, 3, 50)])
def test_interpolation_across_long_cells_adds_nothing_that_is_seen(shape):
    """Over patches of ghosts, over the charges of wide blocks, and between the points of tables: on two levels."""
    n, patch = 48, ((0, 8, 8), (31, 39, 31))
    fine = np.random.default_rng(8).normal(size=(2 * n,) * 3) ** 3
    rho = with_patch(fine, *patch, shape)
    found = []
    for separation in (1.25, 1e9):  # 1e9: charges are summed where they are, at each ghost
        base, refined = (planes_of(rho, level, separation=separation) for level in (0, 1))
        found.append([*base, refined[0][16:80, 16:64]])
    scale = max(np.abs(plane).max() for plane in planes_of(with_patch(np.abs(fine), *patch, shape)))
    assert greatest_difference(*found) < 5e-6 * scale


# ---- ranks ----


def one_corner(shape):
    out = np.zeros(shape)
    out[:5, :5, :5] = 1.0
    return out


CASES = {
    "boxes in blocks": lambda comm: with_patch(noise((64,) * 3), (0, 8, 8), (15, 23, 23), comm=comm, max_grid_size=8),
    "blocks in several boxes": lambda comm: with_patch(
        noise((64,) * 3), (0, 7, 14), (10, 25, 26), comm=comm, max_grid_size=6
    ),
    "long cells": lambda comm: with_patch(
        noise((64,) * 3), (0, 14, 14), (9, 25, 25), (1, 1, 20), comm=comm, max_grid_size=10
    ),
    "odd cells": lambda comm: density(mesh((13, 22, 37), comm=comm, max_grid_size=6), noise((13, 22, 37))),
    "more ranks than boxes": lambda comm: density(mesh((20, 20, 20), comm=comm, max_grid_size=24), noise((20,) * 3)),
    "charge of one rank": lambda comm: density(mesh((48,) * 3, comm=comm, max_grid_size=8), one_corner((48,) * 3)),
    "one block": lambda comm: density(mesh((8, 8, 8), comm=comm, max_grid_size=4), noise((8,) * 3)),
    "no charge": lambda comm: density(mesh((16,) * 3, comm=comm, max_grid_size=8), np.zeros((16,) * 3)),
    "one open face": lambda comm: density(
        mesh(
            (24, 24, 24),
            comm=comm,
            max_grid_size=8,
            boundary=[["dirichlet"] * 2, ["dirichlet", "open"], ["dirichlet"] * 2],
        ),
        noise((24,) * 3),
    ),
}


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
@pytest.mark.parametrize("case", CASES)
def test_walls_do_not_depend_on_the_ranks(comm, case):
    """Not in a single bit: whoever joins the moments of a block and evaluates a patch does it in the same order."""
    alone, together = CASES[case](MPI.COMM_SELF), CASES[case](comm)
    for level in range(alone.hierarchy.levels):
        for plane, expected in zip(planes_of(together, level), planes_of(alone, level), strict=True):
            assert np.array_equal(plane, expected, equal_nan=True)


# ---- long cells and many levels: the tables of the near field ----


@pytest.mark.parametrize("aspect", [5, 30, 100])
def test_walls_beside_long_cells_match_the_lattice_at_all_distances(aspect):
    """Charge at some hundred short cells from ghosts is still near; the reference sums the lattice's function itself."""
    cells, spacing = (144, 8, 8), (1.0, 1.0, float(aspect))
    rng = np.random.default_rng(3)
    charges = np.zeros(cells)
    charges[3:40:3, 1:7, 2:6] = rng.uniform(0.5, 1.5, charges[3:40:3, 1:7, 2:6].shape)
    kernel = lattice_green(spacing, cells).transpose(2, 1, 0)  # offsets 0 .. cells
    found = walls(charges, spacing)
    places = np.argwhere(charges != 0)
    largest = max(np.abs(plane).max() for plane in found)
    for axis, side in itertools.product(range(3), (0, 1)):
        for _ in range(20):
            ghost = np.array([rng.integers(n) for n in cells])
            ghost[axis] = cells[axis] if side else -1
            i, j, k = np.abs(places - ghost).T
            exact = kernel[i, j, k] @ charges[tuple(places.T)]
            here = tuple(n for d, n in enumerate(ghost) if d != axis)
            assert found[2 * axis + side][here] == pytest.approx(exact, abs=6e-5 * largest)


@pytest.mark.parametrize("gamma", [1, 10, 30])
def test_tables_of_many_levels_of_long_cells_are_small_shared_and_freed(gamma):
    before = kernel_table_bytes()
    corner = [[((0, 0, 0), (edge - 1,) * 3)] for edge in (12, 8, 4)]
    domain = Domain((0, 0, 0), (1, 1, 1), (16,) * 3, boundary="open")
    hierarchy = Hierarchy(MPI.COMM_SELF, domain, corner, blocking_factor=4)
    rho = Field(hierarchy).fill(lambda x, y, z: 1e-9 * np.exp(-20 * (x**2 + y**2 + z**2)))
    sizes, solvers = [], []
    for _ in range(2):
        solvers.append(PoissonSolver(hierarchy, stretch=(1, 1, gamma)))
        _, report = solvers[-1].solve(rho)
        assert report.converged
        sizes.append(kernel_table_bytes() - before)
    assert 0 < sizes[0] == sizes[1] < 16e6
    del solvers
    assert kernel_table_bytes() == before


def test_tables_of_all_solvers_together_are_bounded_and_made_again_as_needed():
    before = kernel_table_bytes()
    domain = Domain((0, 0, 0), (1, 1, 1), (16,) * 3, boundary="open")
    hierarchy = Hierarchy(MPI.COMM_SELF, domain, [[((0, 0, 0), (15, 15, 15))]], blocking_factor=4)
    rho = Field(hierarchy).fill(lambda x, y, z: 1e-9 * np.exp(-20 * (x**2 + y**2 + z**2)))
    solvers = [PoissonSolver(hierarchy, stretch=(1, 1, 1 + n / 4)) for n in range(60)]
    first = [solver.solve(rho)[0] for solver in solvers]
    assert 40e6 < kernel_table_bytes() - before < 64 * 2**20
    for solver, phi in list(zip(solvers, first, strict=True))[::-7]:
        again = solver.solve(rho)[0]
        assert all(np.array_equal(again.array(level), phi.array(level)) for level in range(hierarchy.levels))
    del solvers, solver
    assert kernel_table_bytes() == before


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("value", [1e300, np.inf, np.nan])
def test_charge_without_a_finite_potential_is_refused_on_all_ranks(comm, value):
    hierarchy = Hierarchy(comm, Domain(0, 1, 16, "open"), max_grid_size=8)
    rho = Field(hierarchy).fill(lambda x, y, z: np.where((x < 0.1) & (y < 0.1) & (z < 0.1), value, 1.0))
    with pytest.raises(SolverError, match="not finite"):
        PoissonSolver(hierarchy).solve(rho)
