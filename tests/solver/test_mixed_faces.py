"""Open faces beside walls and periodic faces: images, against the exact lattice potential and exact Gaussians."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from mpi4py import MPI
from scipy.special import erf

from amrpic import Domain, Field, Hierarchy, PoissonSolver
from amrpic._native import FreeSpace, OpenWallPlans
from exact.errors import errors, level_errors, observed_order
from exact.lattice import FreeLattice
from exact.sources import EPS0, fill
from gaussian_between_faces import GaussianBetweenFaces
from lattice_between_faces import LatticeBetweenFaces, counted_at_ghosts, ghost_errors, ghosts_of, solved
from open_walls import density, mesh, noise, planes_of, walls, with_patch

KINDS = {
    "oo": ("open", "open"),
    "do": ("dirichlet", "open"),
    "no": ("neumann", "open"),
    "dd": ("dirichlet", "dirichlet"),
    "dn": ("dirichlet", "neumann"),
    "nn": ("neumann", "neumann"),
    "pp": ("periodic", "periodic"),
}
REVERSED = {"od": "do", "on": "no", "nd": "dn"}
ALL_OPEN = (KINDS["oo"],) * 3
# One order of the axes of each mix with an open face, other than six of these.
MIXES = [
    ",".join(axes)
    for axes in itertools.combinations_with_replacement(KINDS, 3)
    if any("o" in axis for axis in axes) and set(axes) != {"oo"}
]
TURNS = list(
    zip(
        itertools.permutations(range(3)),
        [(0, 0, 0), (1, 0, 1), (0, 1, 0), (1, 1, 1), (0, 0, 1), (1, 1, 0)],
        strict=True,
    )
)  # order of the axes, and which are reversed


def faces(mix):
    """The kinds of the six faces, by axis, of a mix as "oo,dd,nd"."""
    return tuple(KINDS[axis] if axis in KINDS else KINDS[REVERSED[axis]][::-1] for axis in mix.split(","))


def turned(array, axes, reverse):
    """An array, or several, with its three last axes in another order and some of them reversed."""
    lead = array.ndim - 3
    out = array.transpose(*range(lead), *(lead + axis for axis in axes))
    return np.flip(out, tuple(lead + d for d in range(3) if reverse[d]))


def turned_faces(boundary, axes, reverse):
    return tuple(boundary[axis][::-1] if back else boundary[axis] for axis, back in zip(axes, reverse, strict=True))


def error(found, exact):
    """The largest one over the largest exact value."""
    return float(np.abs(found - exact).max() / np.abs(exact).max())


# ---- the reference itself ----


def test_there_are_63_mixes():
    assert len(MIXES) == 63


@pytest.mark.parametrize("mix", MIXES)
def test_reference_solves_the_equation_on_the_lattice(mix):
    cells, spacing = (4, 5, 6), (1.0, 1.3, 0.8)
    charges = np.random.default_rng(1).normal(size=cells) + 1
    potential = LatticeBetweenFaces(cells, spacing, faces(mix))(charges)
    phi, _ = solved(charges, spacing, faces(mix), ghosts_of(potential))
    inside = potential[1:-1, 1:-1, 1:-1]
    assert error(phi, inside) < 1e-10


# Potential of the images of a charge q in the middle of a cube of edge L, over q/4πε₀L. Closed forms, and sums to 1e-5 (m).
CONSTANTS = {
    "do,oo,oo": -1.0,
    "no,oo,oo": 1.0,
    "do,do,oo": -1.292893,
    "do,do,do": -1.456030,
    "dd,oo,oo": -2 * np.log(2),
    "nn,oo,oo": 2 * np.euler_gamma,
    "dn,oo,oo": -np.log(2),
    "pp,oo,oo": 2 * (np.euler_gamma - np.log(2)),
    "dd,dd,oo": -1.615543,
    "pp,pp,oo": -3.900265,
    "nn,nn,oo": -3.900265,
    "pp,pp,do": 2.375050,
    "dd,dd,do": -1.68232,  # m
    "pp,dd,oo": -1.14236,  # m
    "dd,nn,oo": -1.14236,  # m
    "dn,pp,oo": 0.25125,  # m
    "oo,do,dd": -1.50445,  # m
}


def extrapolated(of_mesh):
    """The limit, at h = 0, of a value that differs from it by h²; from odd numbers of cells, of which one is in the middle."""
    coarse, fine = 17, 33
    return (fine**2 * of_mesh(fine) - coarse**2 * of_mesh(coarse)) / (fine**2 - coarse**2)


def images_alone(n, boundary, middle_potential):
    """4πL/q times a potential in the middle of a cube of n cells, without that of the charge itself."""
    middle = (n // 2,) * 3
    return (
        4 * np.pi * (middle_potential - LatticeBetweenFaces((n,) * 3, (1 / n,) * 3, ALL_OPEN).between(middle, middle))
    )


@pytest.mark.parametrize("mix", CONSTANTS)
def test_reference_has_the_known_constants(mix):
    def of_mesh(n):
        middle = (n // 2,) * 3
        of_images = LatticeBetweenFaces((n,) * 3, (1 / n,) * 3, faces(mix))
        return images_alone(n, faces(mix), of_images.between(middle, middle))

    assert extrapolated(of_mesh) == pytest.approx(CONSTANTS[mix], abs=1.5e-5)


def test_reference_has_the_force_of_a_charge_on_its_image():
    """q²/16πε₀a² at a distance a from a conductor: field of the image over a distance of 2a = 1."""

    def of_mesh(n):
        middle = (n // 2,) * 3
        images = [
            [
                LatticeBetweenFaces((n,) * 3, (1 / n,) * 3, of).between((n // 2, n // 2, n // 2 + d), middle)
                for d in (-1, 1)
            ]
            for of in (faces("oo,oo,do"), ALL_OPEN)
        ]
        (below, above), (free, _) = images
        return -4 * np.pi * ((above - free) - (below - free)) * n / 2

    assert extrapolated(of_mesh) == pytest.approx(-1, abs=1e-4)


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("mix", ["do,no,oo", "dd,oo,no", "pp,oo,oo", "pp,pp,oo", "nn,oo,oo", "nn,pp,no", "dn,nd,od"])
def test_exact_gaussians_are_limits_of_the_reference(mix, cut):
    """Zero of φ included."""
    source = GaussianBetweenFaces(faces(mix), 0.11, (0.55, 0.4, 0.3), cut=cut)
    worst = []
    for n in (8, 16):
        edges = np.linspace(0, 1, n + 1)
        charges = source.mean(edges, edges, edges) / EPS0 / n**3
        potential = LatticeBetweenFaces((n,) * 3, (1 / n,) * 3, faces(mix))(charges)[1:-1, 1:-1, 1:-1]
        exact = source.potential(*np.ix_(*[(edges[1:] + edges[:-1]) / 2] * 3))
        worst.append(error(potential, exact))
    assert worst[1] < 8e-3 and 3.5 < worst[0] / worst[1] < 5


# ---- ghosts against the lattice ----


@dataclass(frozen=True)
class Shape:
    """Of a box, and the largest error of φ over the largest φ."""

    cells: tuple[int, int, int]
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    phi: float = 1.5e-4


CUBE = Shape((24, 24, 24), phi=1e-4)
SHAPES = {
    "cells 1:1:4": Shape((16, 16, 16), (1.0, 1.0, 4.0), phi=1e-4),
    "few cells": Shape((2, 3, 5)),
    "no whole blocks": Shape((13, 21, 10)),
    "thin": Shape((32, 32, 8)),
    "long": Shape((8, 8, 64)),
    "of three lengths": Shape((8, 32, 16)),
}


def bunch(cells, centre, sigma):
    """Charges of a Gaussian; its centre and width are in units of the box."""
    shares = [
        np.diff(erf((np.linspace(0, 1, n + 1) - c) / (np.sqrt(2) * sigma))) / 2
        for n, c in zip(cells, centre, strict=True)
    ]
    return np.einsum("i,j,k->ijk", *shares)


def sources(cells):
    """A bunch, one near an edge, and charge all over: (3, nx, ny, nz)."""
    everywhere = np.random.default_rng(4).random(cells) ** 4
    return np.array([bunch(cells, (0.7, 0.6, 0.35), 0.08), bunch(cells, (0.88, 0.8, 0.12), 0.05), everywhere])


def check_ghosts(boundary, shape, turns):
    """Ghosts of the code for a box that is turned, and the potential and field that they make, are those of the lattice."""
    charges = sources(shape.cells)
    exact = LatticeBetweenFaces(shape.cells, shape.spacing, boundary)(counted_at_ghosts(charges, boundary))
    for axes, reverse in turns:
        of_box = turned_faces(boundary, axes, reverse)
        spacing = tuple(shape.spacing[axis] for axis in axes)
        for source, expected in zip(turned(charges, axes, reverse), turned(exact, axes, reverse), strict=True):
            found = ghost_errors(walls(source, spacing, of_box), expected, expected, spacing, of_box)
            assert found["ghosts"] < 1.5e-4 and found["phi"] < shape.phi and found["field"] < 3e-4, (of_box, found)


@pytest.mark.parametrize("mix", MIXES)
def test_ghosts_are_those_of_the_lattice(mix, long):
    number = MIXES.index(mix)
    check_ghosts(faces(mix), CUBE, TURNS if long else [TURNS[number % len(TURNS)]])


def orders_of_axes(mix):
    return sorted(set(itertools.permutations(mix.split(","))))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("mix", ["oo,oo,pp", "do,dn,pp", "no,nn,nn", "oo,dd,dd"])
def test_ghosts_of_boxes_of_other_shapes(mix, shape):
    for number, axes in enumerate(orders_of_axes(mix)):
        check_ghosts(faces(",".join(axes)), SHAPES[shape], [TURNS[number % len(TURNS)]])


@pytest.mark.long
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("mix", MIXES)
def test_ghosts_of_all_mixes_on_boxes_of_other_shapes(mix, shape):
    for axes in orders_of_axes(mix):
        check_ghosts(faces(",".join(axes)), SHAPES[shape], TURNS[:2])


# Conductors that are closer to each other than the box is long, or than its cells are: (cells, spacing).
GAPS = {
    "no,dd,do": ((16, 14, 16), (72.0, 1.0, 72.0)),
    "oo,pp,dn": ((32, 12, 20), (31.0, 31.0, 1.0)),
    "oo,od,dd": ((12, 12, 8), (100.0, 100.0, 1.0)),
    "oo,pp,dd": ((24, 32, 12), (10.0, 10.0, 1.0)),
    "oo,dd,nd": ((48, 8, 8), (1.0, 1.0, 1.0)),
}
LAYERS = 16  # until next to nothing is left of the potential


@pytest.mark.parametrize("mix", GAPS)
def test_ghosts_beside_narrow_gaps(mix):
    """Against a box that goes on, empty, behind its open faces until the potential has faded."""
    (cells, spacing), boundary = GAPS[mix], faces(mix)
    padding = [tuple(LAYERS if face == "open" else 0 for face in pair) for pair in boundary]
    around = [slice(before, before + n + 2) for (before, _), n in zip(padding, cells, strict=True)]
    for charges in sources(cells):
        longer = np.pad(counted_at_ghosts(charges, boundary), padding)
        empty = ghosts_of(np.zeros(np.add(longer.shape, 2)))
        exact = np.pad(solved(longer, spacing, boundary, empty)[0], 1)[tuple(around)]
        found = ghost_errors(walls(charges, spacing, boundary), exact, exact, spacing, boundary)
        assert found["ghosts"] < 1.5e-4 and found["phi"] < 5e-5 and found["field"] < 1e-4, found


# Long cells between so many images that these are summed axis by axis: (cells, spacing).
MANY_IMAGES = {
    "do,on,pp": ((3, 15, 3), (9.8, 98.0, 1.0)),
    "pp,no,nd": ((25, 12, 2), (1.0, 99.8, 1.0)),
    "dd,oo,nd": ((12, 9, 4), (40.2, 1.0, 1.0)),
    "oo,nd,nd": ((9, 3, 5), (86.0, 1.0, 1.0)),
    "oo,pp,nn": ((5, 4, 20), (30.0, 1.0, 5.0)),
    "nn,oo,od": ((4, 12, 10), (1.0, 20.0, 50.0)),
}


@pytest.mark.parametrize("mix", MANY_IMAGES)
def test_many_images_are_summed_to_nearly_all_digits(mix):
    (cells, spacing), boundary = MANY_IMAGES[mix], faces(mix)
    for charges in sources(cells):
        exact = LatticeBetweenFaces(cells, spacing, boundary)(counted_at_ghosts(charges, boundary))
        found = ghost_errors(walls(charges, spacing, boundary), exact, exact, spacing, boundary)
        assert max(found.values()) < 1e-9, found


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("mix", ["pp,oo,oo", "pp,nn,no", "dd,nd,do", "dn,od,oo"])
def test_the_tree_and_sums_by_axes_agree_on_two_levels(mix, order):
    """The more cells the lattice counts over, the more images are near."""
    charges = noise((32, 32, 32))
    rho = with_patch(charges, (0, 3, 9), (7, 11, 15), boundary=faces(mix))
    tree, by_axes = (
        FreeSpace(rho.hierarchy.native, order=order, lattice_limit=limit).walls(rho.native) for limit in (None, 1000)
    )
    for (_, _, some), (_, _, others) in zip(tree, by_axes, strict=True):
        assert 0 < np.abs(some - others).max() < 1.5e-4 * np.abs(others).max()


@pytest.mark.parametrize("mix", CONSTANTS)
def test_images_of_a_charge_have_the_known_potential(mix):
    def of_mesh(n):
        charges = np.zeros((n,) * 3)
        charges[(n // 2,) * 3] = 1
        spacing = (1 / n,) * 3
        phi, _ = solved(charges, spacing, faces(mix), walls(charges, spacing, faces(mix)))
        return images_alone(n, faces(mix), phi[(n // 2,) * 3])

    assert extrapolated(of_mesh) == pytest.approx(CONSTANTS[mix], abs=1e-4)


# ---- potentials of the solver ----


def potential(hierarchy, source, order=2, **data):
    """φ and E of a source, or of charges per cell, and of data on walls."""
    rho = Field(hierarchy)
    if isinstance(source, np.ndarray):
        rho = density(hierarchy, EPS0 * source)
    else:
        fill(rho, source)
    if order == 4:
        rho.holds = "means"
    solver = PoissonSolver(hierarchy, order=order)
    phi, report = solver.solve(rho, **data)
    assert report.converged, report.reason
    return phi, solver.electric_field(phi)


def array_of(field):
    """Values of the base on one rank, (nx, ny, nz)."""
    out = np.zeros(field.hierarchy.domain.cells)
    for patch in field.patches:
        if patch.level == 0:
            out[tuple(slice(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True))] = patch.data
    return out


@pytest.mark.parametrize("mix", ["oo,oo,do", "oo,oo,no", "oo,do,do", "od,no,oo"])
def test_walls_give_the_potential_of_a_mirrored_bunch_in_a_box_of_twice_the_size(mix):
    """With quadratic ghosts at Dirichlet walls; ghosts at open faces are those of the free lattice with the mirrored charge."""
    n, boundary = 32, faces(mix)
    charges = bunch((n,) * 3, (0.5, 0.5, 0.3), 0.1)
    doubled, inside = charges, [slice(None)] * 3
    for axis, pair in enumerate(boundary):
        for side, sign in ((side, {"dirichlet": -1, "neumann": 1}.get(face)) for side, face in enumerate(pair)):
            if sign:
                image = sign * np.flip(doubled, axis)
                doubled = np.concatenate([doubled, image] if side else [image, doubled], axis)
                inside[axis] = slice(0, n + 2) if side else slice(n, 2 * n + 2)
    expected = FreeLattice(doubled.shape, (1 / n,) * 3)(doubled)[tuple(inside)]
    exact, _ = solved(charges, (1 / n,) * 3, boundary, ghosts_of(expected), quadratic=True)
    phi, _ = potential(mesh((n,) * 3, (1 / n,) * 3, boundary=boundary), charges)
    assert error(array_of(phi), exact) < 5e-5


def first_layer(cells, centre, sigma):
    """Charges of a Gaussian disc in the first layer along z."""
    x, y = (np.exp(-((np.arange(n) + 0.5 - c) ** 2) / (2 * sigma**2)) for n, c in zip(cells, centre, strict=False))
    out = np.zeros(cells)
    out[..., 0] = x[:, None] * y
    return out


def test_charge_in_the_first_layer_at_a_cathode():
    """Against open faces 32 cells further out. Far away the disc is a dipole 3/4 as strong as that with linear ghosts."""
    n, boundary = 32, faces("oo,oo,do")
    far = (3 * n, 3 * n, 2 * n)
    charges = first_layer(far, (1.5 * n, 1.5 * n), 0.1 * n)
    ghosts = ghosts_of(LatticeBetweenFaces(far, (1.0,) * 3, boundary)(counted_at_ghosts(charges, boundary)))
    phi, _ = solved(charges, (1.0,) * 3, boundary, ghosts, quadratic=True)
    exact = phi[n : 2 * n, n : 2 * n, :n]
    found, _ = potential(mesh((n,) * 3, boundary=boundary), first_layer((n,) * 3, (0.5 * n, 0.5 * n), 0.1 * n))
    assert error(array_of(found), exact) < 1e-4


# ---- refined ----

# Corners in eighths of the domain: in the middle of a wall, and where that meets another face.
AT_WALL = ((2, 2, 0), (6, 6, 4))
AT_RIM = ((0, 1, 0), (5, 7, 5))


def refined(n, boundary, patch, doubled=False, comm=MPI.COMM_SELF):
    """The unit cube of n base cells an axis with a patch of twice as many; or with all of it mirrored at z = 0."""
    lower, upper = (np.array(corner) * n // 4 for corner in patch)
    below = n if doubled else 0
    box = (*lower[:2], -upper[2] + 2 * below if doubled else lower[2]), (*(upper[:2] - 1), upper[2] + 2 * below - 1)
    domain = Domain((0, 0, -1 if doubled else 0), (1, 1, 1), (n, n, n + below), boundary)
    boxes = [tuple(tuple(int(i) for i in corner) for corner in box)]
    return Hierarchy(comm, domain, [boxes], max_grid_size=32, blocking_factor=2)


@pytest.mark.parametrize("kind", ["do", "no"])
@pytest.mark.parametrize(
    ("patch", "centre"), [(AT_WALL, (0.5, 0.5, 0.25)), (AT_RIM, (0.36, 0.5, 0.25))], ids=["wall", "rim"]
)
def test_errors_beside_a_wall_are_those_of_the_mirrored_mesh(patch, centre, kind):
    boundary = faces(f"oo,oo,{kind}")
    source = GaussianBetweenFaces(boundary, 0.07, centre)
    found = []
    for doubled in (False, True):
        hierarchy = refined(24, ALL_OPEN if doubled else boundary, patch, doubled)
        phi, field = potential(hierarchy, source)
        found.append([level_errors([phi], source.potential), level_errors(field.components, source.field)])
    assert np.all(np.array(found[0]) <= 1.05 * np.array(found[1])), found


# Faces, patch and centre of a bunch; and bunches that a wall cuts off, so that there is charge in its first layer.
REFINED = {
    "cathode": ("oo,oo,do", AT_WALL, (0.5, 0.5, 0.25)),
    "cathode, charge on it": ("oo,oo,do", AT_WALL, (0.5, 0.5, 0.1)),
    "rim of a cathode, charge on it": ("oo,oo,do", AT_RIM, (0.36, 0.5, 0.1)),
    "edge of two walls": ("no,oo,do", AT_RIM, (0.25, 0.5, 0.25)),
    "corner of three walls, charge on them": ("do,no,do", ((0, 0, 0), (4, 4, 4)), (0.12, 0.12, 0.12)),
    "beam": ("oo,oo,pp", AT_WALL, (0.5, 0.5, 0.2)),
    "slab": ("pp,pp,oo", AT_RIM, (0.3, 0.5, 0.36)),
    "plates": ("oo,oo,dd", AT_RIM, (0.36, 0.5, 0.25)),
    "pipe": ("dd,nn,oo", AT_RIM, (0.3, 0.5, 0.36)),
    "five walls, charge on one": ("dd,dn,do", AT_RIM, (0.3, 0.5, 0.1)),
}


def refined_case(name):
    """Faces, patch and source of one of these."""
    mix, patch, centre = REFINED[name]
    return faces(mix), patch, GaussianBetweenFaces(faces(mix), 0.07, centre, cut="charge" in name)


@pytest.mark.parametrize("name", REFINED)
def test_potential_and_field_are_of_second_order_on_two_levels(name, long):
    """φ in the largest norm, E in L2."""
    boundary, patch, source = refined_case(name)
    cells, table = (32, 48, 64) if long else (32, 48), []
    for n in cells:
        phi, field = potential(refined(n, boundary, patch), source)
        table.append((errors([phi], source.potential)[1], errors(field.components, source.field)[0]))
    orders = [observed_order(cells, column) for column in np.array(table).T.tolist()]
    assert min(orders) >= 1.9, table


QUICK = {"cathode, charge on it", "slab"}


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in REFINED]
)
def test_order_4_stays_of_fourth_order_on_two_levels(name):
    """φ and E in L2; and φ in the largest norm is as exact as with exact potentials on all faces."""
    boundary, patch, source = refined_case(name)
    cells, table = (32, 48), []
    for n in cells:
        phi, field = potential(refined(n, boundary, patch), source, order=4)
        found = errors([phi.as_points()], source.potential)
        table.append((found[0], errors(field.components, source.field)[0]))
        given, _ = potential(refined(n, "dirichlet", patch), source, order=4, boundary_values=source.at_points)
        assert found[1] < 1.05 * errors([given.as_points()], source.potential)[1] + 2e-6
    orders = [observed_order(cells, column) for column in np.array(table).T.tolist()]
    assert min(orders) >= 3.5, table


# ---- symmetry ----


def test_potential_moves_with_charge_around_a_periodic_axis():
    n, boundary = 24, faces("oo,no,pp")
    charges = sources((n,) * 3)[0]
    still, _ = potential(mesh((n,) * 3, boundary=boundary), charges)
    for steps in (1, 5, 13):
        moved, _ = potential(mesh((n,) * 3, boundary=boundary), np.roll(charges, steps, axis=2))
        assert error(array_of(moved), np.roll(array_of(still), steps, axis=2)) < 1e-4


@pytest.mark.parametrize("others", ["oo,oo", "do,oo", "oo,pp", "no,dd"])
def test_between_neumann_walls_it_is_that_of_a_period_with_the_mirrored_charge(others):
    n = 16
    charges = sources((n,) * 3)[1]
    between, _ = potential(mesh((n,) * 3, boundary=faces(f"{others},nn")), charges)
    around, _ = potential(
        mesh((n, n, 2 * n), boundary=faces(f"{others},pp")), np.concatenate([charges, charges[..., ::-1]], axis=2)
    )
    assert error(array_of(between), array_of(around)[..., :n]) < 1e-4


# ---- ranks ----

ON_RANKS = ("oo,oo,do", "oo,oo,pp", "pp,pp,oo", "dd,dd,do")


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
@pytest.mark.parametrize("mix", ON_RANKS)
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 5)], ids=["cubes", "long cells"])
def test_ghosts_depend_neither_on_ranks_nor_on_boxes(comm, mix, shape):
    """Not in a single bit."""
    charges, patch = noise((48,) * 3), ((0, 0, 8), (11, 15, 19))
    alone, together = (
        with_patch(charges, *patch, shape, of, boundary=faces(mix), max_grid_size=size)
        for of, size in ((MPI.COMM_SELF, 32), (comm, 8))
    )
    for level in (0, 1):
        for plane, expected in zip(planes_of(together, level), planes_of(alone, level), strict=True):
            assert np.array_equal(plane, expected, equal_nan=True)


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
def test_sums_by_axes_depend_neither_on_ranks_nor_on_boxes(comm):
    """Not in a single bit."""
    charges, boundary = noise((16,) * 3), faces("oo,no,pp")
    alone, together = (
        with_patch(charges, (0, 0, 3), (2, 7, 6), (1, 9, 70), of, boundary=boundary, max_grid_size=size)
        for of, size in ((MPI.COMM_SELF, 32), (comm, 2))
    )
    for level in (0, 1):
        for plane, expected in zip(planes_of(together, level), planes_of(alone, level), strict=True):
            assert np.array_equal(plane, expected, equal_nan=True)


@pytest.mark.parametrize("ranks", [720, pytest.param(13824, marks=pytest.mark.long)])
def test_images_add_next_to_no_messages(ranks):
    """Of plans for ranks that need not exist, beside those of six open faces."""
    found = {}
    for mix in ("oo,oo,oo", *ON_RANKS):
        domain = Domain((0, 0, 0), (1, 1, 1), (576,) * 3, faces(mix))
        hierarchy = Hierarchy(MPI.COMM_SELF, domain, [], max_grid_size=24, blocking_factor=8)
        boxes = len(hierarchy.boxes(0))
        firsts = [[boxes * rank // ranks for rank in range(ranks + 1)]]
        plans = OpenWallPlans(hierarchy.native, firsts)
        counts = [plans.counts(rank) for rank in range(0, ranks, max(7, ranks // 100))]
        found[mix] = [np.mean([of_rank[key] for of_rank in counts]) for key in ("messages", "bytes")]
    for mix in ON_RANKS:
        assert np.all(np.array(found[mix]) <= 1.3 * np.array(found["oo,oo,oo"])), found
