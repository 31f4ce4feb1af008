"""Hierarchies on part of the ranks, so that one test compares several numbers of ranks with one expectation."""

from __future__ import annotations

import time
from functools import lru_cache
from typing import Any

from mpi4py import MPI

import amrpic
from hierarchies import Case


def hierarchy_of(case: Case, comm: Any) -> amrpic.Hierarchy:
    domain = amrpic.Domain(case.lower, case.upper, case.cells, case.boundary)
    return amrpic.Hierarchy(comm, domain, case.levels, case.max_grid_size, case.blocking_factor)


@lru_cache
def first_ranks(count: int) -> Any:
    """Return the communicator of the first ranks of all, None on the others. Collective at the first call."""
    part = MPI.COMM_WORLD.Split(0 if MPI.COMM_WORLD.rank < count else MPI.UNDEFINED)
    return None if part == MPI.COMM_NULL else part


def wait_quietly(comm: Any) -> None:
    """Wait for the other ranks without keeping a core busy."""
    request = comm.Ibarrier()
    while not request.Test():
        time.sleep(0.005)
