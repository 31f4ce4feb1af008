# mypy: disable-error-code="arg-type"
"""Charge on the sides of gaps between electrodes in which no centre of a cell lies."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI
from scipy.constants import epsilon_0

from amrpic import Domain, Electrode, Field, Hierarchy, PoissonSolver, shapes

CLOSED = "dirichlet"
SLABS = {"x": "periodic", "y": "periodic", "z": "dirichlet"}


def plates(*gaps, thick=0.35, middle=0.013, half=3.0, volts=(1, 0)):
    """Return square plates one above the other, so far apart: the outer ones at voltages, the others without a charge."""
    lower_faces = np.cumsum([0.0, *gaps]) + np.arange(len(gaps) + 1) * thick
    electrodes = []
    for n, lower in enumerate(middle + lower_faces - lower_faces.mean() - thick / 2):
        drive = {"voltage": volts[0]} if n == 0 else {"voltage": volts[1]} if n == len(gaps) else {"charge": 0}
        electrodes.append(Electrode(f"p{n}", shapes.Box((-half, -half, lower), (half, half, lower + thick)), **drive))
    return electrodes


def solver(electrodes, cells=16, boundary=CLOSED, levels=(), comm=MPI.COMM_SELF, size=16, **options):
    mesh = Hierarchy(comm, Domain(-1, 1, cells, boundary), levels, size, 4)
    return PoissonSolver(mesh, electrodes=electrodes, **{"tolerance": 1e-12, **options})


def test_a_capacitor_whose_gap_is_a_third_of_a_cell_has_the_capacitance_that_long_resolved_cells_find():
    """Cells of the second mesh are 1/27 as high, so that eight lie in the gap."""
    gap = 0.3 / 8
    pair = plates(gap, half=0.5)
    coarse, fine = (solver(pair, (16, 16, nz)).capacitance() for nz in (16, 16 * 27))
    assert 1 < -coarse[0, 1] / (epsilon_0 / gap) < 1.1  # with what the edges add
    assert coarse == pytest.approx(fine, rel=0.005)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("share", [0.05, 0.4])
def test_concentric_spheres_have_their_capacitance_and_a_symmetric_matrix(comm, share):
    """Nothing is aligned. All rows of what is enclosed add up to zero: Gauss's law."""
    a, cells = 0.6, 32
    b = a + share * 2 / cells
    shell = shapes.Box((-0.9, -0.9, -0.9), (0.9, 0.9, 0.9)) - shapes.Sphere((0.011, -0.02, 0.007), b)
    pair = [
        Electrode("ball", shapes.Sphere((0.011, -0.02, 0.007), a), voltage=1),
        Electrode("shell", shell, voltage=0),
    ]
    matrix = solver(pair, cells, comm=comm).capacitance()
    exact = 4 * np.pi * epsilon_0 * a * b / (b - a)
    assert matrix[0, 0] == pytest.approx(exact, rel=1e-3)
    assert matrix[0] == pytest.approx(matrix[:, 0], rel=1e-11)
    assert abs(matrix[:, 0].sum()) < 1e-12 * exact


QUICK = [("matrix-free", (1, 1, 1), 8), ("kokkos", (4, 1, 5), 16), ("crs", (4, 1, 5), 8)]
MESHES = {
    "one level": (),
    "a refined part along the gap": [[((8, 8, 8), (23, 23, 23))]],
    "a refined side of the gap": [[((0, 0, 16), (31, 31, 31))]],
    "three levels": [[((4, 4, 8), (27, 27, 23))], [((16, 16, 24), (47, 47, 39))]],
}


@pytest.mark.mpi(ranks=(1, 4))
@pytest.mark.parametrize(
    ("backend", "stretch", "size"),
    [
        pytest.param(*case, marks=[] if case in QUICK else [pytest.mark.long])
        for case in itertools.product(("matrix-free", "kokkos", "crs"), ((1, 1, 1), (4, 1, 5)), (16, 8))
    ],
)
@pytest.mark.parametrize("name", MESHES)
def test_slabs_are_exact_on_any_levels_ranks_and_executions_and_in_stretched_coordinates(
    comm, name, backend, stretch, size
):
    pair, options = plates(0.01, middle=0.0), {"stretch": stretch, "backend": backend}
    matrix = solver(pair, boundary=SLABS, levels=MESHES[name], comm=comm, size=size, **options).capacitance()
    assert matrix == pytest.approx(matrix.T, rel=1e-11)
    assert -matrix[0, 1] * stretch[2] ** 2 == pytest.approx(epsilon_0 * 4 / 0.01, rel=1e-11)


def test_a_gap_before_a_wall_takes_the_potential_of_the_wall_at_its_place():
    """The lower slab covers a part of its face, whose potential changes along x; what else it has is below a thousandth."""
    gap = 1e-4
    lower = Electrode("lower", shapes.Box((-0.75, -3, gap - 1), (0, 3, -0.5)), voltage=2)
    upper = Electrode("upper", shapes.Box((-3, -3, 0.5), (3, 3, 0.95)), voltage=0)
    solve = solver([lower, upper], boundary=SLABS)
    _, report = solve.solve(
        Field(solve.hierarchy), boundary_values=lambda x, y, z: np.where(z > 0, 3, np.sin(np.pi * x) + 0 * y)
    )
    centres = np.arange(-0.75, 0, 1 / 8) + 1 / 16
    at_gap = epsilon_0 * 1.5 / gap * (2 - np.sin(np.pi * centres).mean())
    assert report.charges["lower"] == pytest.approx(at_gap, rel=1e-3)
    assert report.charges["upper"] == pytest.approx(-epsilon_0 * 4 * 3 / 0.05, rel=0.1)


def test_metal_between_metal_floats_to_the_voltage_of_a_divider():
    """Chains of gaps: one plate between fills a centre, the other is thinner than a cell."""
    for thick in (0.2, 0.01):
        gaps = (0.01, 0.03)
        chain = plates(*gaps, thick=thick)
        matrix = solver(chain, boundary=SLABS).capacitance()
        report = (one := solver(chain, boundary=SLABS)).solve(Field(one.hierarchy))[1]
        assert report.voltages["p1"] == pytest.approx(gaps[1] / sum(gaps), rel=1e-11)
        assert report.charges["p1"] == pytest.approx(0, abs=1e-11 * matrix[1, 1])
        assert report.charges["p2"] == pytest.approx(-epsilon_0 * 4 / sum(gaps), rel=1e-11)


def test_electrodes_that_overlap_at_one_voltage_leave_no_gap_to_what_lies_in_the_other():
    post, collar, lid = (
        shapes.Box((-half, -half, low), (half, half, high))
        for half, low, high in ((0.5, -0.6, 0), (0.8, -0.4, -0.3), (3, 0.01, 0.5))
    )
    apart = [
        Electrode("post", post, voltage=1),
        Electrode("collar", collar, voltage=1),
        Electrode("lid", lid, voltage=0),
    ]
    as_one = [Electrode("both", post | collar, voltage=1), apart[-1]]
    charges, of_union = (
        (one := solver(electrodes, boundary=SLABS)).solve(Field(one.hierarchy))[1].charges
        for electrodes in (apart, as_one)
    )
    assert charges["lid"] == pytest.approx(of_union["lid"], rel=1e-11)
    assert charges["post"] + charges["collar"] == pytest.approx(of_union["both"], rel=1e-11)


def test_open_faces_see_the_two_layers_of_a_gap():
    """A ball in two halves at ±1 V (Jackson, Classical Electrodynamics, 3.3): a third of its dipole lies in the gap."""
    a, gap, cells = 0.4, 0.01, 32
    ball = shapes.Sphere((0, 0, 0), a)
    halves = [
        Electrode(name, ball & shapes.Plane((0, 0, sign * gap / 2), (0, 0, -sign)), voltage=sign)
        for name, sign in (("upper", 1), ("lower", -1))
    ]
    solve = solver(halves, cells, "open", tolerance=1e-8)
    phi, report = solve.solve(Field(solve.hierarchy))
    assert report.charges["upper"] == pytest.approx(-report.charges["lower"], rel=1e-6)
    direction = np.array([(0, 0, 1), (0.6, 0, 0.8), (0.48, 0.64, 0.6)])
    for radius in (0.6, 0.9):
        u, c = a / radius, direction[:, 2]
        legendre = c, (5 * c**3 - 3 * c) / 2, (63 * c**5 - 70 * c**3 + 15 * c) / 8
        exact = 3 / 2 * u**2 * legendre[0] - 7 / 8 * u**4 * legendre[1] + 11 / 16 * u**6 * legendre[2]
        assert phi.sample(radius * direction) == pytest.approx(exact, rel=0.03)


def test_another_gap_is_other_metal_and_operators_that_are_taken_over_keep_theirs():
    """Cells, in metal or cut, are the same; the gap alone grows."""
    pair = plates(0.01, middle=0.0)
    upper = Electrode("p1", shapes.Box((-3, -3, 0.02), (3, 3, 0.355)), voltage=0)
    first = solver(pair, boundary=SLABS)
    matrix = first.capacitance()
    assert first.takes(plates(0.01, middle=0.0, volts=(5, 0))) and not first.takes([pair[0], upper])
    again = solver(pair, boundary=SLABS, reuse=first.base_setup)
    assert again.capacitance() == pytest.approx(matrix, rel=1e-11)
