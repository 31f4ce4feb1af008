"""Bad input gets one sentence, on all ranks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import fem
from amrpic.errors import AmrpicError, InputError


def mesh_of(comm, **changed):
    return fem.Mesh(comm, **{"lower": 0, "upper": 1, "cells": 4, "degree": 2, "max_grid_size": 2, **changed})


def poisson(comm):
    mesh = mesh_of(comm)
    return fem.Poisson(fem.uniform(mesh, 3)), np.ones(len(mesh.nodes)), mesh


def solve(comm, **changed):
    operator, f, mesh = poisson(comm)
    given = {"f": f, "fixed": mesh.boundary, **changed}
    return fem.solve(operator, given.pop("f"), **given)


CASES: dict[str, Callable[[Any], Any]] = {
    "degree is 5": lambda comm: mesh_of(comm, degree=5),
    "degree is 0": lambda comm: mesh_of(comm, degree=0),
    "degree is 'two'": lambda comm: mesh_of(comm, degree="two"),
    "domain.cells along x is 1": lambda comm: mesh_of(comm, cells=1),
    "domain along x reaches from 0.0 to -1.0": lambda comm: mesh_of(comm, upper=-1),
    "max_grid_size is 2.5": lambda comm: mesh_of(comm, max_grid_size=2.5),
    "max_grid_size is 1099511627776": lambda comm: mesh_of(comm, max_grid_size=2**40),
    "degree is array([1, 2])": lambda comm: mesh_of(comm, degree=np.array([1, 2])),
    "max_grid_size is 1": lambda comm: mesh_of(comm, max_grid_size=1),
    "per_axis is 0": lambda comm: fem.uniform(mesh_of(comm), 0),
    "per_axis is 33": lambda comm: fem.jittered(mesh_of(comm), 33),
    "per_axis is 2.5": lambda comm: fem.random(mesh_of(comm), 2.5),  # type: ignore[arg-type]
    "seed is -1": lambda comm: fem.jittered(mesh_of(comm), 2, seed=-1),
    'weights are "mass"': lambda comm: fem.uniform(mesh_of(comm), 2, weights="mass"),  # type: ignore[arg-type]
    "position has shape (3,)": lambda comm: fem.given(mesh_of(comm), [0.5, 0.5, 0.5]),
    "position is no array of real numbers": lambda comm: fem.given(mesh_of(comm), [[1, 2], [3]]),
    "point 1 at (0.5, 1.1, 0.5) m lies outside": lambda comm: fem.given(mesh_of(comm), [[0.5] * 3, [0.5, 1.1, 0.5]]),
    "point 0 at (nan, 0, 0) m lies outside": lambda comm: fem.given(mesh_of(comm), [[np.nan, 0, 0]]),
    "volume has shape (2,) for 1 points": lambda comm: fem.given(mesh_of(comm), [[0.5] * 3], volume=[1, 2]),
    "the volume of point 0 is 0": lambda comm: fem.given(mesh_of(comm), [[0.5] * 3], volume=[0.0]),
    "the volume of point 0 is nan": lambda comm: fem.given(mesh_of(comm), [[0.5] * 3], volume=[np.nan]),
    "volume is no array of real numbers": lambda comm: fem.given(mesh_of(comm), [[0.5] * 3], volume=["a"]),  # type: ignore[list-item]
    "components are 2": lambda comm: fem.Mass(fem.gauss(mesh_of(comm)), components=2),
    "the vector has shape (5,) on a rank": lambda comm: poisson(comm)[0] @ np.ones(5),
    "the vector has 3 components; the operator has 1": lambda comm: poisson(comm)[0] @ np.ones((len(poisson(comm)[1]), 3)),
    "the array of values at points has shape (7,)": lambda comm: fem.gauss(mesh_of(comm)).integrate(np.ones(7)),
    "the right-hand side has shape (4,)": lambda comm: solve(comm, f=np.ones(4)),
    "fixed is of float64": lambda comm: solve(comm, fixed=np.ones(4)),
    "values do not fit nodes": lambda comm: solve(comm, values=np.ones(4)),
    'preconditioner is "ilu"': lambda comm: solve(comm, preconditioner="ilu"),
    "tolerance is 1.0": lambda comm: solve(comm, tolerance=1.0),
    "tolerance is 'small'": lambda comm: solve(comm, tolerance="small"),
    "most_iterations is 0": lambda comm: solve(comm, most_iterations=0),
    "most_iterations is 1099511627776": lambda comm: solve(comm, most_iterations=2**40),
    "and most_iterations 1.5": lambda comm: solve(comm, most_iterations=1.5),
    "the right-hand side of a free node is nan": lambda comm: solve(comm, f=poisson(comm)[1] * np.nan),
    "the right-hand side is no array of real numbers": lambda comm: solve(comm, f=poisson(comm)[1] * 1j),
    "the value of a fixed node is inf": lambda comm: solve(comm, values=np.inf),
    "values is no array of real numbers": lambda comm: solve(comm, values="none"),
    "the residual to start from is inf": lambda comm: solve(comm, f=poisson(comm)[1] * 1e300),
}  # fmt: skip


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("sentence", list(CASES))
def test_bad_input_gets_one_sentence(comm, sentence):
    with pytest.raises(AmrpicError) as caught:
        CASES[sentence](comm)
    text = str(caught.value)
    assert sentence in text
    assert ";" in text and "\n" not in text and not text.endswith(".")


@pytest.mark.mpi(ranks=2)
def test_what_one_rank_does_wrong_is_raised_on_both(comm):
    operator, u, _ = poisson(comm)
    with pytest.raises(InputError, match=r"has shape \(2,\) on a rank"):
        operator @ (u if comm.rank == 0 else np.ones(2))
    mesh = mesh_of(comm)
    with pytest.raises(InputError, match="ranks gave different points"):
        fem.given(mesh, np.full((2, 3), 0.1 + 0.8 * comm.rank))


def test_equations_and_values_that_are_not_used_need_not_be_finite():
    operator, f, mesh = poisson(MPI.COMM_SELF)
    expected, _ = fem.solve(operator, f, fixed=mesh.boundary)
    found, report = fem.solve(
        operator,
        np.where(mesh.boundary, np.nan, f),
        fixed=mesh.boundary,
        values=np.where(mesh.boundary, 0.0, np.nan),
    )
    assert report.converged
    np.testing.assert_array_equal(found, expected)
