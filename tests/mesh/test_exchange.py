"""What passes between ranks: plans that follow from the boxes without a message, and values that reach those who read them."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import backends
from amrpic import _native
from amrpic.parallel import Communicator, own, traffic
from hierarchies import all_cases


@pytest.mark.mpi(ranks=(1, 2, 3, 4))
def test_parcels_arrive_in_order(comm):
    """Each rank draws the same plan: some parcels between each two ranks, of 0 to 40 values, each of a name of its own."""
    random = np.random.default_rng(5)
    for _ in range(20):
        counts = [
            (reader, owner, int(random.integers(41)))
            for reader in range(comm.size)
            for owner in range(comm.size)
            for _ in range(random.integers(4))
            if reader != owner
        ]
        named = [
            (reader, owner, [1e6 * reader + 1e3 * n + i for i in range(count)])
            for n, (reader, owner, count) in enumerate(counts)
        ]
        asked = sorted((p for p in named if p[1] == comm.rank), key=lambda p: p[0])
        wanted = sorted((p for p in named if p[0] == comm.rank), key=lambda p: p[1])
        before = traffic()
        arrived = _native.exchange(
            own(comm).py2f(),
            [(reader, len(values)) for reader, _, values in asked],
            [(owner, len(values)) for _, owner, values in wanted],
            lambda n, asked=asked: asked[n][2],
        )
        assert arrived == [values for _, _, values in wanted]
        sent = traffic() - before
        assert sent.messages == len({reader for reader, _, values in asked if values})
        assert sent.bytes == 8 * sum(len(values) for _, _, values in asked)


@pytest.mark.mpi(ranks=(2, 3, 4))
@pytest.mark.parametrize("backend", [backends.DEFAULT, "crs"])
def test_plans_are_made_without_messages(comm, backend, long):
    """All ranks know all boxes, so that each finds what others read of it; of all hierarchies in the long form."""
    for case in list(all_cases().values())[:: 1 if long else 4]:
        before = traffic()
        domain = amrpic.Domain(case.lower, case.upper, case.cells, boundary=case.boundary)
        mesh = amrpic.Hierarchy(comm, domain, case.levels, case.max_grid_size, case.blocking_factor)
        mesh.particle_mesh  # noqa: B018
        amrpic.PoissonSolver(mesh, backend=backend)
        assert (traffic() - before).messages == 0


@pytest.mark.mpi(ranks=2)
def test_a_communicator_has_one_duplicate(comm):
    mine = own(comm)
    assert own(comm) is mine and own(mine) is mine
    assert isinstance(mine, Communicator) and mine != comm and mine.size == comm.size
    assert MPI.Comm.Compare(mine, comm) == MPI.CONGRUENT
    part = comm.Split(0)
    of_part = own(part)
    assert of_part != mine
    part.Free()  # and the duplicate with it
    assert own(comm) is mine
