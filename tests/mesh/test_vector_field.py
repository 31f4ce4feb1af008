"""The electric field that follows from a potential: what is kept of it serves particles as its components do, and nobody can
change one without the other."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import HierarchyError, InputError
from amrpic.particles.clouds import Clouds
from amrpic.stages.gather import gather
from amrpic.stages.push import push
from hierarchies import all_cases
from particle_cases import placed, random_field

CASES = all_cases()


def solver_on(name: str, comm: MPI.Comm, particles: int = 100):
    hierarchy, made = placed(CASES[name], comm, particles)
    return amrpic.PoissonSolver(hierarchy), random_field(hierarchy), made


@pytest.mark.mpi(ranks=(1, 2))
def test_particles_are_pushed_the_same(comm):
    solver, phi, particles = solver_on("U of small blocks, three levels", comm)
    for matched in (False, True):
        clouds = Clouds(matched=matched)
        fields = (make(phi, covered=clouds.covered) for make in (solver.electric_field, solver.deferred_field))
        given, deferred = (push(field, particles, 1e-9, 1e-9, 2e-9, clouds) for field in fields)
        assert np.array_equal(given.momentum, deferred.momentum)
        assert np.array_equal(given.position, deferred.position)


def test_the_potential_lives_as_long_as_its_field():
    solver, phi, particles = solver_on("hole of one block", MPI.COMM_SELF)
    expected = gather(solver.electric_field(phi), particles)
    field = solver.deferred_field(phi)
    del phi
    gc.collect()
    others = [amrpic.Field(solver.hierarchy).fill(lambda x, y, z: x) for _ in range(3)]  # would take its memory
    assert np.array_equal(gather(field, particles), expected)
    del others


def test_what_a_field_follows_from_is_locked():
    solver, phi, _ = solver_on("hole of one block", MPI.COMM_SELF)
    early = phi.patches[0].data  # of before it is locked
    assert not solver.electric_field(phi).x.locked and not phi.locked  # the components stand alone
    field = solver.deferred_field(phi)
    for locked in (phi, *field.components):
        with pytest.raises(ValueError, match="read-only"):
            locked.patches[0].data[...] = 1
        with pytest.raises(ValueError, match="read-only"):
            locked.array(0)[...] = 1
        for write in (locked.average_down, lambda: locked.fill(lambda x, y, z: x)):  # noqa: B023
            with pytest.raises(InputError, match=r"locked.*write to a copy"):
                write()
    copy = phi.copy().fill(lambda x, y, z: x)
    assert not np.array_equal(copy.array(0), phi.array(0))
    assert early.flags.writeable  # views from before are their taker's


def test_components_are_kept_once_they_were_asked_for():
    solver, phi, _ = solver_on("hole of one block", MPI.COMM_SELF)
    field = solver.deferred_field(phi)
    assert field.x is field.components[0] and field.y is field.components[1] and field.z is field.components[2]
    apart = field.with_components()
    assert apart.x is not field.x and np.array_equal(apart.x.array(0), field.x.array(0))
    assert apart.with_components() is apart
    apart.x.array(0)[...] += 1  # and kernels see it
    assert apart.integral_of_square() != field.integral_of_square()


def test_components_of_several_hierarchies_are_refused():
    one, other = (placed(CASES["hole of one block"], MPI.COMM_SELF, 0)[0] for _ in "12")
    with pytest.raises(HierarchyError, match="several hierarchies; make all of them on one"):
        amrpic.VectorField(amrpic.Field(one), amrpic.Field(one), amrpic.Field(other))
