"""The operators as Tpetra matrices do what their rows say, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest

import amrpic
from hierarchies import all_cases
from rank_subsets import hierarchy_of

NAMES = ("no_fine", "composite", "coarse_boundary", "fine_boundary", "restriction", "prolongation", "uncovered")


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("name", ["L, away from walls", "corner", "region wrapping all axes, four levels"])
def test_operators_multiply_the_same_as_tpetra_matrices(comm, name):
    hierarchy = hierarchy_of(all_cases()[name], comm)
    solver = amrpic.PoissonSolver(hierarchy)
    for level in range(hierarchy.levels):
        operators = solver.operators(level)
        every = [getattr(operators, which) for which in NAMES]
        every += [block for axis in operators.gradient for block in (axis.own, axis.coarse, axis.fine)]
        size_of = {hierarchy.cells(other): other for other in range(hierarchy.levels)}
        for operator in every:
            rows, columns = operator.shape
            values = np.random.default_rng(columns).standard_normal(columns)
            own = np.zeros(0)
            if columns:
                mine = len(amrpic.Field(hierarchy).array(size_of[columns]))
                first = sum(comm.allgather(mine)[: comm.rank])
                own = values[first : first + mine]
            found = comm.gather(operator.multiply(own), root=0)
            whole = operator.to_scipy()
            if comm.rank == 0:
                expected = whole @ values
                assert np.concatenate(found) == pytest.approx(
                    expected, rel=1e-12, abs=1e-12 * np.abs(expected).max(initial=1e-30)
                )
