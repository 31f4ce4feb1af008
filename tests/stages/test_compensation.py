"""What clouds smooth and gather gives back: against the convolution, without self-force, the same on any boxes and ranks."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from amrpic.mesh.domain import Domain
from amrpic.mesh.field import VectorField
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.particles.clouds import SHAPES, SMOOTHING, Clouds
from amrpic.particles.particles import Particles
from amrpic.particles.species import Species, SpeciesTable
from amrpic.stages.deposit import deposit
from amrpic.stages.gather import compensate, gather
from amrpic.stages.migrate import migrate
from amrpic.stages.poisson import PoissonSolver
from amrpic.units import VACUUM_PERMITTIVITY

UNIT = SpeciesTable((Species(charge=1.0, mass=1.0),))
CELLS = 24
LEVELS = [[((12, 12, 12), (35, 35, 35))], [((32, 32, 32), (63, 63, 63))]]


def particles_at(comm: MPI.Comm, position: np.ndarray) -> Particles:
    """Unit charges, all of them made on the last rank."""
    count = len(position) if comm.rank == comm.size - 1 else 0
    return Particles(position[:count], np.zeros((count, 3)), np.ones(count), np.arange(count, dtype=np.int64), UNIT)


def felt(comm, hierarchy, position, clouds: Clouds) -> np.ndarray:
    """The field at particles, by their ids, (n, 3) V/m on every rank. Collective."""
    particles, _ = migrate(particles_at(comm, position), hierarchy)
    rho = deposit(particles, hierarchy, clouds)
    solver = PoissonSolver(hierarchy, tolerance=1e-12)
    efield = solver.deferred_field(solver.solve(rho)[0], covered=clouds.covered)
    compensate(efield, rho, clouds)
    found = gather(efield, particles, clouds)
    ids, values = (np.concatenate(comm.allgather(np.array(of))) for of in (particles.id, found))
    return values[np.argsort(ids)]


def added(comm, hierarchy, position, clouds: Clouds, **more) -> np.ndarray:
    """What compensation adds to a field of zeros at particles, by their ids, (n, 3) V/m on every rank. Collective."""
    from amrpic.pic.solution import zeros

    particles, _ = migrate(particles_at(comm, position), hierarchy)
    rho = deposit(particles, hierarchy, clouds)
    efield = zeros(hierarchy, "V/m")
    compensate(efield, rho, clouds, **more)
    found = gather(efield, particles, clouds)
    ids, values = (np.concatenate(comm.allgather(np.array(of))) for of in (particles.id, found))
    return values[np.argsort(ids)]


@pytest.mark.parametrize("shape", SHAPES)
def test_smoothing_is_half_the_variance_of_the_cloud(shape):
    """The mean of w_i (x_i - x)² over places in a cell and, for triangular clouds, everywhere; h = 1."""
    hierarchy = Hierarchy(MPI.COMM_SELF, Domain(lower=0, upper=8, cells=8, boundary="periodic"))
    clouds, variances = Clouds(shape), []
    for place in (np.arange(64) + 0.5) / 64:
        particles, _ = migrate(particles_at(MPI.COMM_SELF, np.array([[4 + place, 4.2, 3.9]])), hierarchy)
        weights = deposit(particles, hierarchy, clouds).patches[0].data.sum(axis=(1, 2))
        variances.append(weights @ (np.arange(8) + 0.5 - 4 - place) ** 2)
    assert np.mean(variances) / 2 == pytest.approx(SMOOTHING[shape], rel=1e-3)
    if shape == "triangular-shaped-cloud":
        assert np.ptp(variances) < 1e-12


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("matched", [False, True])
def test_added_field_is_the_difference_of_the_density_gathered(comm, shape, matched):
    """Against NumPy on a refined mesh: E = −κ∇ρ on each level, in cells whose neighbours the level has."""
    hierarchy = Hierarchy(comm, Domain(lower=0, upper=1, cells=CELLS), LEVELS, max_grid_size=16, blocking_factor=4)
    rng = np.random.default_rng(3)
    position = 0.5 + 0.16 * rng.standard_normal((3000, 3))
    position = position[(np.abs(position - 0.5) < 0.37).all(axis=1)]
    clouds = Clouds(shape, matched, "clouds")
    particles, _ = migrate(particles_at(comm, position), hierarchy)
    rho = deposit(particles, hierarchy, clouds)
    slopes = [VectorField(*(type(rho)(hierarchy) for _ in range(3)))][0]
    full = [np.zeros(tuple(CELLS * 2**level + 2 for _ in range(3))) for level in range(3)]
    for patch in rho.patches:
        inside = tuple(slice(a + 1, b + 2) for a, b in zip(patch.lower, patch.upper, strict=True))
        full[patch.level][inside] = patch.data
    for level in range(3):
        full[level] = comm.allreduce(full[level])
    for axis, component in enumerate(slopes.components):
        for patch in component.patches:
            kappa = clouds.compensated(hierarchy.spacing(patch.level)) / VACUUM_PERMITTIVITY
            width = hierarchy.spacing(patch.level)[axis]
            padded = full[patch.level]
            ahead, behind = (
                tuple(
                    slice(a + 1 + step * (d == axis), b + 2 + step * (d == axis))
                    for d, (a, b) in enumerate(zip(patch.lower, patch.upper, strict=True))
                )
                for step in (1, -1)
            )
            patch.data[:] = -kappa * (padded[ahead] - padded[behind]) / (2 * width)
    expected = gather(slopes, particles, clouds)
    efield = VectorField(*(type(rho)(hierarchy) for _ in range(3)))
    compensate(efield, rho, clouds)
    found = gather(efield, particles, clouds)
    # own-level clouds less than two cells inside a face see interpolated ghosts; walls are not reached
    place = np.array(particles.position)
    deep = np.ones(len(place), dtype=bool)
    for level, boxes in enumerate(LEVELS, 1):
        width = 1 / CELLS / 2**level
        low, high = np.array(boxes[0][0]) * width, (np.array(boxes[0][1]) + 1) * width
        outside = np.maximum(low - place, place - high).max(axis=1)
        deep &= matched or (outside > 0) | (outside < -2 * width)
    assert deep.sum() > 0.5 * len(place)
    size = np.abs(expected).max(initial=0.0)
    assert np.abs(found - expected)[deep].max(initial=0.0) < 1e-12 * comm.allreduce(size, MPI.MAX)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("matched", [False, True])
@pytest.mark.parametrize("boundary", ["open", "periodic"])
@pytest.mark.parametrize("spread", [0.05, 0.3])
def test_field_of_a_potential_is_felt_with_what_compensation_adds(comm, matched, boundary, spread):
    """Rows inside boxes take both at once; some bricks hold no particles, or all do."""
    domain = Domain(lower=0, upper=1, cells=CELLS, boundary=boundary)
    hierarchy = Hierarchy(comm, domain, LEVELS, max_grid_size=16, blocking_factor=4)
    position = np.clip(0.5 + spread * np.random.default_rng(7).standard_normal((20000, 3)), 0.001, 0.999)
    particles, _ = migrate(particles_at(comm, position), hierarchy)
    plain, clouds = (Clouds("triangular-shaped-cloud", matched, kind) for kind in ("none", "clouds"))
    rho = deposit(particles, hierarchy, clouds)
    phi = type(rho)(hierarchy, unit="V").fill(lambda x, y, z: 1e14 * np.sin(7 * x) * np.cos(5 * y + 2 * z))
    efield = PoissonSolver(hierarchy, background="neutralizing").deferred_field(phi, covered=clouds.covered)
    alone = gather(efield, particles, plain)
    zeros = VectorField(*(type(rho)(hierarchy) for _ in range(3)))
    compensate(zeros, rho, clouds)
    more = gather(zeros, particles, clouds)
    compensate(efield, rho, clouds)
    size = comm.allreduce(np.abs(more).max(initial=0.0), MPI.MAX)
    assert np.abs(alone).max(initial=0.0) < 1e3 * size < comm.allreduce(1e6 * np.abs(alone).max(initial=0.0), MPI.MAX)
    assert np.abs(gather(efield, particles, clouds) - alone - more).max(initial=0.0) < 1e-11 * size


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("compensation", ["clouds", "clouds-and-mesh"])
def test_no_particle_pushes_itself_on_a_uniform_mesh(shape, compensation):
    hierarchy = Hierarchy(MPI.COMM_SELF, Domain(lower=0, upper=1, cells=16, boundary="open"), max_grid_size=8)
    clouds = Clouds(shape, compensation=compensation)
    for place in np.random.default_rng(1).uniform(0.2, 0.8, (5, 1, 3)):
        own = added(MPI.COMM_SELF, hierarchy, place, clouds)
        scale = clouds.compensated(hierarchy.spacing(0)) / VACUUM_PERMITTIVITY * 16**4
        assert np.abs(own).max() < 1e-15 * scale


@pytest.mark.parametrize("shape", SHAPES)
def test_particles_push_each_other_equally(shape):
    """Action is reaction: the forces that compensation adds sum to nothing on a uniform mesh."""
    hierarchy = Hierarchy(MPI.COMM_SELF, Domain(lower=0, upper=1, cells=16, boundary="periodic"), max_grid_size=8)
    forces = added(
        MPI.COMM_SELF, hierarchy, np.random.default_rng(2).random((300, 3)), Clouds(shape, compensation="clouds")
    )
    assert np.abs(forces.sum(axis=0)).max() < 1e-12 * np.abs(forces).sum()


@pytest.mark.parametrize("shape", SHAPES)
def test_compensation_adds_no_force_on_itself_near_faces_where_clouds_are_matched(shape):
    """And with own-level clouds none from two fine cells inside on."""
    hierarchy = Hierarchy(MPI.COMM_SELF, Domain(lower=0, upper=1, cells=CELLS), LEVELS[:1], blocking_factor=4)
    fine = 1 / CELLS / 2
    for matched, inside in ((True, np.arange(-2, 4, 0.26)), (False, np.r_[np.arange(2.01, 4, 0.3), -1.3, -0.6])):
        clouds = Clouds(shape, matched, "clouds")
        scale = clouds.compensated(np.full(3, fine)) / VACUUM_PERMITTIVITY / fine**4
        for distance in inside:
            place = np.array([[12 * fine + distance * fine, 0.52, 0.47]])
            assert np.abs(added(MPI.COMM_SELF, hierarchy, place, clouds)).max() < 1e-15 * scale


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
@pytest.mark.parametrize("matched", [False, True])
@pytest.mark.parametrize(
    "boundary", ["open", "periodic", {"x": ("dirichlet", "neumann"), "y": "periodic", "z": "neumann"}], ids=str
)
def test_field_does_not_depend_on_boxes_and_ranks(comm, matched, boundary):
    position = np.random.default_rng(5).random((4000, 3)) ** 0.7
    domain = Domain(lower=0, upper=1, cells=CELLS, boundary=boundary)
    alone = Hierarchy(MPI.COMM_SELF, domain, LEVELS, max_grid_size=64, blocking_factor=4)
    cut = Hierarchy(comm, domain, LEVELS, max_grid_size=8, blocking_factor=4)
    clouds = Clouds("triangular-shaped-cloud", matched, "clouds-and-mesh")
    one = added(MPI.COMM_SELF, alone, position, clouds)
    other = added(comm, cut, position, clouds)
    assert np.abs(one - other).max() < 1e-12 * np.abs(one).max()
