"""Shapes of clouds, and matched clouds at coarse-fine faces: charge, first moment, momentum and the force on oneself."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import hierarchies
from amrpic.errors import SolverError
from amrpic.particles.clouds import SHAPES, Clouds
from amrpic.particles.particles import Particles
from amrpic.particles.species import Species, SpeciesTable
from amrpic.stages.deposit import deposit
from amrpic.stages.gather import gather
from amrpic.stages.migrate import migrate
from amrpic.stages.poisson import PoissonSolver
from particle_cases import CHARGE, Mesh, assert_as_by_hand, dense, gather_by_hand, placed, random_field

CASES = hierarchies.all_cases()
ALL = [Clouds(shape, matched) for shape in SHAPES for matched in (False, True)]
NEW = [clouds for clouds in ALL if clouds != Clouds()]  # test_deposit has the default
EPSILON_0 = 8.8541878188e-12  # F/m

# Concave edges, walls, periodic faces that the refined region crosses, levels nested by one cell only, single blocks.
CHOSEN = [
    CASES[name]
    for name in (
        "L at the walls, anisotropic",
        "U of small blocks, three levels",
        "checkerboard 2",
        "columns of a checkerboard",
        "hole of one block",
        "corner",
        "region wrapping all axes, four levels",
        "narrow periodic axis",
        "all refined",
    )
]


@pytest.mark.mpi(ranks=(1, 3), timeout=120)
def test_every_cloud_is_deposited_by_its_rule_in_every_cell(comm):
    for case in CHOSEN[:: comm.size]:
        hierarchy, particles = placed(case, comm, 45)
        for clouds in NEW:
            assert_as_by_hand(hierarchy, particles, case, clouds)


@pytest.mark.mpi(ranks=(1, 2), timeout=120)
def test_every_cloud_is_gathered_by_its_rule(comm):
    for case in CHOSEN:
        hierarchy, particles = placed(case, comm, 60)
        field, mesh = random_field(hierarchy), Mesh(hierarchy)
        values = [dense(field, level) for level in range(hierarchy.levels)]
        for clouds in NEW:
            found = gather(amrpic.VectorField(field, field, field), particles, clouds)[:, 1]
            expected = gather_by_hand(mesh, values, particles.position, clouds)
            assert found == pytest.approx(expected, rel=0, abs=1e-12), (case.name, clouds)


@pytest.mark.mpi(ranks=(1, 3), more=(4,), timeout=120)
def test_every_cloud_keeps_the_total_charge(comm):
    for case in CASES.values():
        hierarchy, particles = placed(case, comm, 300)
        total = particles.total_charge(comm)
        for clouds in NEW:
            assert deposit(particles, hierarchy, clouds).integral() == pytest.approx(total, rel=1e-13, abs=0), (
                case.name,
                clouds,
            )


@pytest.mark.mpi(ranks=(1, 2))
def test_clouds_of_particles_a_rounding_error_from_a_face_are_ordinary(comm):
    """The largest numbers below a face belong to the cell below it, also where a cell or wall follows."""
    kinds = {"x": ("dirichlet", "dirichlet"), "y": ("neumann", "neumann"), "z": ("periodic", "periodic")}
    case = hierarchies.Case(
        "at the walls",
        (8, 8, 8),
        kinds,
        4,
        8,
        (((((0, 0, 0), (7, 7, 7)), ((8, 8, 8), (15, 15, 15)))),),
        (0, 0, 0),
        (8, 8, 8),
    )
    hierarchy, _ = placed(case, comm, 0)
    ends = np.array([np.nextafter(0, 1), np.nextafter(4, 0), 4.0, np.nextafter(6, 0), np.nextafter(8, 0)])
    places = np.array(list(itertools.product(ends, repeat=3)))
    particles, lost = migrate(some(comm, places, np.ones(len(places)), CHARGE), hierarchy)
    assert len(lost) == 0
    for clouds in ALL:
        assert_as_by_hand(hierarchy, particles, case, clouds)


def first_moment(density: amrpic.Field, origin: np.ndarray) -> np.ndarray:
    total = []
    for axis in range(3):
        product = density.copy()
        for patch in product.patches:
            patch.data[...] *= patch.centres()[axis] - origin[axis]
        total.append(product.integral())
    return np.array(total)


@pytest.mark.mpi(ranks=(1, 2), timeout=120)
def test_matched_clouds_keep_the_first_moment_across_coarse_fine_faces(comm):
    """Linear and quadratic shares have the particle as their centre, and the children of a cell that cell's centre."""
    for name in ("L, away from walls", "U of small blocks, three levels", "hole of one block", "corner"):
        hierarchy, particles = placed(CASES[name], comm, 2000)
        lower, upper = np.array(hierarchy.domain.lower), np.array(hierarchy.domain.upper)
        margin = 1.5 * hierarchy.spacing(0)
        inside = np.all((particles.position > lower + margin) & (particles.position < upper - margin), axis=1)
        particles, _ = migrate(particles.select(inside), hierarchy)
        exact = comm.allreduce(CHARGE * particles.weight @ (particles.position - lower))
        for shape in ("cloud-in-cell", "triangular-shaped-cloud"):
            found = first_moment(deposit(particles, hierarchy, Clouds(shape, matched=True)), lower)
            assert found == pytest.approx(exact, rel=1e-12), (name, shape)


def power_defect(hierarchy: amrpic.Hierarchy, particles: Particles, clouds: Clouds) -> float:
    """Return by how much the power of a field on the charge differs between cells and particles, relative to the charge
    times the largest field."""
    field = random_field(hierarchy)
    felt = gather(amrpic.VectorField(field, field, field), particles, clouds)[:, 0]
    density = deposit(particles, hierarchy, clouds)
    for patch, other in zip(density.patches, field.patches, strict=True):
        patch.data[...] *= np.where(patch.covered, 0, other.data)
    power = sum(float(p.data.sum()) * np.prod(hierarchy.spacing(p.level)) for p in density.patches)
    defect = hierarchy.comm.allreduce(power - CHARGE * float(particles.weight @ felt))
    return abs(defect / particles.total_charge(hierarchy.comm))


@pytest.mark.mpi(ranks=(1, 2, 3), timeout=120)
def test_gather_is_the_adjoint_of_deposit(comm):
    """Matched clouds: on every hierarchy, since a covered cell holds the mean of the children that share its charge. Own-level
    clouds: on one level; across a face their interpolation is none."""
    for case in CHOSEN:
        hierarchy, particles = placed(case, comm, 500)
        for shape in SHAPES:
            assert power_defect(hierarchy, particles, Clouds(shape, matched=True)) < 1e-14, (case.name, shape)
    hierarchy, particles = placed(CASES["hole of one block"], comm, 500)
    assert power_defect(hierarchy, particles, Clouds()) > 1e-6
    hierarchy, particles = placed(CASES["single level"], comm, 500)
    for shape in SHAPES:
        assert power_defect(hierarchy, particles, Clouds(shape)) < 1e-14


@pytest.mark.mpi(ranks=(1, 2))
def test_field_of_covered_cells_is_the_difference_of_their_potentials(comm):
    for name in (
        "L at the walls, anisotropic",
        "U of small blocks, three levels",
        "region wrapping all axes, four levels",
    ):
        hierarchy, _ = placed(CASES[name], comm, 0)
        solver, phi, mesh = PoissonSolver(hierarchy), random_field(hierarchy), Mesh(hierarchy)
        mean, difference = (solver.electric_field(phi, covered=kind) for kind in ("mean", "difference"))
        for axis, level in itertools.product(range(3), range(hierarchy.levels - 1)):
            values = dense(phi, level)
            expected = (np.roll(values, 1, axis) - np.roll(values, -1, axis)) / (2 * hierarchy.spacing(level)[axis])
            covered = np.array([mesh.covered(level, cell) for cell in np.ndindex(values.shape)]).reshape(values.shape)
            checked = covered.copy()
            if not hierarchy.domain.periodic[axis]:
                np.moveaxis(checked, axis, 0)[[0, -1]] = False  # walls come next
            assert checked.any()
            found = dense(difference.components[axis], level)
            assert found[checked] == pytest.approx(expected[checked], rel=0, abs=1e-11 * np.nanmax(np.abs(expected)))
            same = mesh.exists[level] & ~covered
            assert np.array_equal(found[same], dense(mean.components[axis], level)[same])
    with pytest.raises(SolverError, match="covered is 'none'; use one of mean, difference"):
        solver.electric_field(phi, covered="none")


@pytest.mark.mpi(ranks=(1, 2))
def test_field_of_covered_cells_sees_the_walls(comm):
    """A linear potential has the same field everywhere, also in covered cells at walls that hold its values and slopes."""
    slope = np.array([3.0, -2.0, 1.0])
    case = CASES["L at the walls, anisotropic"]
    hierarchy, _ = placed(case, comm, 0)
    kinds, lower = case.boundary, np.array(case.lower)

    def flux(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Outward derivative on the Neumann face that a point lies on."""
        total = np.zeros(len(x))
        for axis, along in enumerate((x, y, z)):
            for side, end in enumerate((lower[axis], case.upper[axis])):
                if kinds["xyz"[axis]][side] == "neumann":
                    total[np.isclose(along, end)] = slope[axis] * (2 * side - 1)
        return total

    solver = PoissonSolver(hierarchy, tolerance=1e-12)
    linear = lambda x, y, z: slope[0] * x + slope[1] * y + slope[2] * z  # noqa: E731
    phi, report = solver.solve(amrpic.Field(hierarchy), boundary_values=linear, boundary_flux=flux)
    assert report.converged
    for axis, component in enumerate(solver.electric_field(phi, covered="difference").components):
        for patch in component.patches:
            assert patch.data == pytest.approx(np.full(patch.data.shape, -slope[axis]), abs=1e-9)


def some(comm: MPI.Comm, position: np.ndarray, weight: np.ndarray, charge: float = 1.0) -> Particles:
    """Return particles of `charge` C times their weight, made on the first rank."""
    count = len(position) if comm.rank == 0 else 0
    one = SpeciesTable((Species(charge=charge, mass=1.0),))
    return Particles(position[:count], np.zeros((count, 3)), weight[:count], np.arange(count), one)


def forces(solver: PoissonSolver, position: np.ndarray, weight: np.ndarray, clouds: Clouds) -> np.ndarray:
    """Return the forces (n, 3) in N on charges of `weight` C in the field of all of them, on every rank."""
    hierarchy = solver.hierarchy
    particles, _ = migrate(some(hierarchy.comm, position, weight), hierarchy)
    phi, report = solver.solve(deposit(particles, hierarchy, clouds))
    assert report.converged
    felt = gather(solver.electric_field(phi, covered=clouds.covered), particles, clouds)
    ids, found = zip(*hierarchy.comm.allgather((particles.id, particles.weight[:, None] * felt)), strict=True)
    return np.concatenate(found)[np.argsort(np.concatenate(ids))]


@pytest.mark.mpi(ranks=(1, 2))
def test_particles_on_a_uniform_grid_exert_no_force_on_themselves(comm):
    """One particle feels nothing, and the forces of many add up to nothing: momentum is kept."""
    domain = amrpic.Domain((0, 0, 0), (8, 8, 8), (8, 8, 8), "periodic")
    solver = PoissonSolver(amrpic.Hierarchy(comm, domain, (), 4, 4), tolerance=1e-13, background="neutralizing")
    rng = np.random.default_rng(5)
    scale = 1 / (4 * np.pi * EPSILON_0)  # N, of two charges of 1 C one cell width apart
    for shape in SHAPES:
        alone = forces(solver, 8 * rng.random((1, 3)), np.ones(1), Clouds(shape))
        assert np.abs(alone).max() < 1e-11 * scale, shape
        many = forces(solver, 8 * rng.random((40, 3)), rng.normal(size=40), Clouds(shape))
        assert np.abs(many.sum(axis=0)).max() < 1e-11 * np.abs(many).sum(), shape


# ---- near the faces of a refined cube ----

CELLS = 16  # of the base, 1 m wide; the cube is as many fine cells wide, in the middle
FINE, FACE, MIDDLE = 0.5, CELLS / 4, CELLS / 2
LINES: dict[str, Callable[[float], list[tuple[float, float, float]]]] = {
    "face": lambda d: [(FACE + d * FINE, MIDDLE + 0.5 * FINE * t, MIDDLE + 0.3 * FINE) for t in (0, 1)],
    "edge": lambda d: [(FACE + d * FINE, FACE + d * FINE, MIDDLE + 0.5 * FINE * t) for t in (0, 1)],
    "corner": lambda d: [(FACE + d * FINE,) * 3],
}
OFFSETS = (-1.0, -0.1, 0.1, 0.5, 0.75, 1.0, 1.25, 1.5, 1.9, 2.01)  # into the cube, in fine cells


def cube(comm: MPI.Comm) -> PoissonSolver:
    domain = amrpic.Domain((0, 0, 0), (CELLS,) * 3, (CELLS,) * 3, "open")
    box = ((CELLS // 2,) * 3, (3 * CELLS // 2 - 1,) * 3)
    return PoissonSolver(amrpic.Hierarchy(comm, domain, [[box]], 8, 4), tolerance=1e-8)


def peak(solver: PoissonSolver, line: str, clouds: Clouds, offsets: tuple[float, ...] = OFFSETS) -> float:
    """Return the largest force of a particle on itself along a line, in q²/(4πε₀h²) of the fine cells."""
    places = [place for d in offsets for place in LINES[line](d)]
    largest = max(np.abs(forces(solver, np.array([place]), np.ones(1), clouds)).max() for place in places)
    return float(largest) * 4 * np.pi * EPSILON_0 * FINE**2


# Measured: own-level 0.42, 0.62, 0.66 at d = 0.5; matched 0.0082, 0.011, 0.015 at d = 1.
@pytest.mark.mpi(ranks=(2,), more=(1,), timeout=120)
def test_matched_particles_hardly_push_themselves_near_coarse_fine_faces(comm):
    solver = cube(comm)
    for line, own, bound in (("face", 0.4, 1.5e-2), ("edge", 0.6, 2.5e-2), ("corner", 0.6, 4e-2)):
        assert peak(solver, line, Clouds(), (0.5,)) > own
        assert peak(solver, line, Clouds(matched=True)) < bound
        for shape in ("nearest-grid-point", "triangular-shaped-cloud"):
            assert peak(solver, line, Clouds(shape, matched=True), (0.25, 1.0, 2.01)) < bound


# Measured: own-level 0.31, 0.66, 0.037; matched 0.0064, 0.0052, 0.0007.
@pytest.mark.mpi(ranks=(2,), more=(1,), timeout=120)
def test_matched_particles_hardly_push_themselves_at_nested_levels_and_in_concave_edges(comm):
    """Levels one coarse cell apart, where the coarse cloud itself lies in the buffer of its level; an L-shaped region."""
    domain = amrpic.Domain((0, 0, 0), (CELLS,) * 3, (CELLS,) * 3, "open")
    cubes = [[((8, 8, 8), (23, 23, 23))], [((18, 18, 18), (45, 45, 45))]]
    nested = PoissonSolver(amrpic.Hierarchy(comm, domain, cubes, 14, 2), tolerance=1e-8)
    edge = PoissonSolver(
        amrpic.Hierarchy(comm, domain, [[((8, 8, 8), (15, 23, 23)), ((16, 8, 8), (23, 15, 23))]], 8, 4), tolerance=1e-8
    )

    def largest(solver: PoissonSolver, places: list[tuple[float, float, float]], h: float, matched: bool) -> float:
        clouds = Clouds(matched=matched)
        most = max(np.abs(forces(solver, np.array([place]), np.ones(1), clouds)).max() for place in places)
        return float(most) * 4 * np.pi * EPSILON_0 * h**2

    for solver, h, own, bound, places in (
        (nested, FINE / 2, 0.3, 1.5e-2, [(4.5 + d * FINE / 2, 8.1, 8.2) for d in (0.5, 1.0, 2.01)]),
        (nested, FINE / 2, 0.6, 1.5e-2, [(4.5 + d * FINE / 2,) * 3 for d in (0.5, 1.0, 2.01)]),
        (edge, FINE, 0.03, 2e-3, [(8 - d * FINE, 8 - d * FINE, 8.1) for d in (0.1, 0.5, 1.0)]),
    ):
        assert largest(solver, places, h, matched=False) > own
        assert largest(solver, places, h, matched=True) < bound


@pytest.mark.mpi(ranks=(2, 3, 4), timeout=120)
def test_forces_are_the_same_on_one_rank_and_on_all(comm):
    rng = np.random.default_rng(9)
    position, weight = FACE - 1 + (CELLS / 2 + 2) * rng.random((300, 3)), rng.normal(size=300)
    for clouds in (
        Clouds(matched=True),
        Clouds("triangular-shaped-cloud"),
        Clouds("triangular-shaped-cloud", matched=True),
    ):
        alone, together = (forces(cube(c), position, weight, clouds) for c in (MPI.COMM_SELF, comm))
        assert together == pytest.approx(alone, rel=0, abs=1e-6 * np.abs(alone).max()), clouds
