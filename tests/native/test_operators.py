"""The eight operators equal those of an independent oracle, and obey the laws by themselves."""

from __future__ import annotations

from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import amrpic
import operator_laws
from amrpic.parallel import traffic
from hierarchies import all_cases, for_the_oracle
from oracle import LINEAR_FITS, QUADRATIC_FITS, Oracle
from rank_subsets import first_ranks, hierarchy_of, wait_quietly

CASES = all_cases()
NAMES = ("no_fine", "composite", "coarse_boundary", "fine_boundary", "restriction", "prolongation", "uncovered")
each_case = pytest.mark.parametrize("name", CASES, scope="module")
each_case_of_the_oracle = pytest.mark.parametrize("name", for_the_oracle(CASES), scope="module")


def matrices(solver: amrpic.PoissonSolver, level: int) -> SimpleNamespace:
    """Return the operators of a level as SciPy matrices under their names; None for each but on rank 0. Collective."""
    operators = solver.operators(level)
    gradient = [
        SimpleNamespace(own=axis.own.to_scipy(), coarse=axis.coarse.to_scipy(), fine=axis.fine.to_scipy())
        for axis in operators.gradient
    ]
    return SimpleNamespace(gradient=gradient, **{name: getattr(operators, name).to_scipy() for name in NAMES})


def by_name(operators: SimpleNamespace) -> dict[str, sp.sparray]:
    flat = {name: getattr(operators, name) for name in NAMES}
    for axis, blocks in zip("xyz", operators.gradient, strict=True):
        flat |= {f"gradient {axis} {block}": getattr(blocks, block) for block in ("own", "coarse", "fine")}
    return flat


def difference(found: sp.sparray, expected: sp.sparray) -> float:
    """Return the largest difference of two matrices relative to the largest entry expected."""
    assert found.shape == expected.shape
    size = abs(expected).max() if expected.nnz else 0.0
    error = abs(found - expected).max() if found.nnz + expected.nnz else 0.0
    return float(error / size) if size else float(error)


def oracle_for(name: str, hierarchy: amrpic.Hierarchy) -> Oracle:
    """Return the oracle of a case with the boxes that the hierarchy really has."""
    boxes = (np.ascontiguousarray(hierarchy.boxes(level), dtype=np.int64) for level in range(hierarchy.levels))
    return _oracle(name, tuple(level.tobytes() for level in boxes))


@lru_cache(maxsize=1)
def _oracle(name: str, boxes: tuple[bytes, ...]) -> Oracle:
    return Oracle(CASES[name], [np.frombuffer(level, dtype=np.int64).reshape(-1, 6) for level in boxes])


@lru_cache(maxsize=1)
def expected_of(oracle: Oracle) -> list[dict[str, sp.sparray]]:
    """Return the operators of an oracle per level."""
    operators = [by_name(oracle.operators(level)) for level in range(oracle.levels)]
    for level, expected in enumerate(operators):
        expected["constant prolongation"] = oracle.prolongation(level, "constant")
    return operators


def differences(name: str, comm: Any) -> dict[tuple[int, str], float]:
    """Return by level and operator how far it is from the oracle's; empty but on rank 0. Collective."""
    hierarchy = hierarchy_of(CASES[name], comm)
    trilinear, constant = (
        amrpic.PoissonSolver(hierarchy, prolongation=p, backend="crs") for p in ("trilinear", "constant")
    )
    result: dict[tuple[int, str], float] = {}
    for level in range(hierarchy.levels):
        found = by_name(matrices(trilinear, level))
        found["constant prolongation"] = constant.operators(level).prolongation.to_scipy()
        if comm.rank == 0:
            expected = expected_of(oracle_for(name, hierarchy))[level]
            result |= {(level, o): difference(found[o], matrix) for o, matrix in expected.items()}
    return result


@each_case_of_the_oracle
@pytest.mark.mpi(ranks=3, timeout=120)
def test_operators_equal_the_oracle_on_one_two_and_three_ranks(name, comm):
    for ranks in (1, 2, 3):
        part = first_ranks(ranks)
        found = differences(name, part) if part else {}
        wait_quietly(comm)
        assert {place: d for place, d in found.items() if not d <= 1e-12} == {}, f"on {ranks} ranks"


@each_case
@pytest.mark.mpi(ranks=3)
def test_operators_obey_the_laws(name, comm):
    """Gauss's law to rounding; polynomials of the degree of the interface fits exactly; transfers of linear functions."""
    hierarchy = hierarchy_of(CASES[name], comm)
    solver = amrpic.PoissonSolver(hierarchy)
    found = [matrices(solver, level) for level in range(hierarchy.levels)]
    if comm.rank == 0:
        oracle = oracle_for(name, hierarchy)
        assert operator_laws.gauss_defect(oracle, found) < 1e-13
        assert operator_laws.transfer_defect(oracle, found) < 1e-13
        for degree, fits in ((1, LINEAR_FITS), (2, QUADRATIC_FITS)):
            defects = operator_laws.exactness_defects(oracle, found, degree, fits)
            assert defects["laplacian"] < 1e-12
            assert defects["field"] < 1e-12
        if all(kind in ("neumann", "periodic") for types in oracle.types for kind in types):
            assert operator_laws.constant_defect(oracle, found) < 1e-12
    wait_quietly(comm)


@each_case
@pytest.mark.mpi(ranks=2)
def test_boxes_of_the_hierarchy_are_those_given_cut_to_size(name, comm):
    case = CASES[name]
    hierarchy = hierarchy_of(case, comm)
    for level in range(hierarchy.levels):
        boxes = hierarchy.boxes(level)
        size = boxes[:, 3:] - boxes[:, :3] + 1
        cells = np.array(case.cells) * 2**level
        shorter = (boxes[:, 3:] == cells - 1) & (cells % case.blocking_factor != 0)
        assert size.min() >= 2 and (size - (cells % case.blocking_factor == 1)).max() <= case.max_grid_size
        assert not (boxes[:, :3] % case.blocking_factor).any() and not (size % case.blocking_factor)[~shorter].any()
        assert set(Oracle(case, [boxes]).cells[0]) == set(Oracle(case, [case.boxes(level)]).cells[0])
        assert hierarchy.cells(level) == size.prod(axis=1).sum()
        assert hierarchy.spacing(level) == pytest.approx(Oracle(case, case.all_boxes()).spacing[level], rel=1e-15)


def nested(comm: Any, finest: tuple, boundary: str = "dirichlet") -> amrpic.Hierarchy:
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (32, 32, 32), boundary)
    levels = [[((8, 8, 8), (55, 55, 55))], [((32, 32, 32), (95, 95, 95))], [finest]]
    return amrpic.Hierarchy(comm, domain, levels, max_grid_size=16)


def entries(solver: amrpic.PoissonSolver) -> list[np.ndarray]:
    """Return all numbers of this rank's operators of the refinement levels and the base. Collective."""
    out = []
    for level in range(solver.hierarchy.levels):
        operators = solver.operators(level)
        own = [getattr(operators, name).entries for name in NAMES]
        own += [block.entries for axis in operators.gradient for block in (axis.own, axis.coarse, axis.fine)]
        out += [array for triple in own for array in triple]
    return out


HERE, THERE = ((80, 80, 80), (111, 111, 111)), ((96, 96, 96), (127, 127, 127))


@pytest.mark.mpi(ranks=(1, 2), more=(3,))
def test_only_levels_that_changed_are_assembled_anew(comm):
    """The finest level moves: its operators and the next coarser ones are new, all others are handed on, and equal."""
    first = amrpic.PoissonSolver(nested(comm, HERE), backend="crs")
    every = first.native.levels_assembled
    entries(first)  # the gradient is handed on as well
    moved = amrpic.PoissonSolver(nested(comm, THERE), reuse=first.base_setup, backend="crs")
    # With other ghosts on the next coarser level, the one below it must be numbered anew.
    assert moved.native.levels_assembled == 2 if comm.size == 1 else moved.native.levels_assembled <= 3
    assert every == 7
    fresh = amrpic.PoissonSolver(nested(comm, THERE), backend="crs")
    assert fresh.native.levels_assembled == every
    for ours, theirs in zip(entries(moved), entries(fresh), strict=True):
        assert np.array_equal(ours, theirs)
    rho = amrpic.Field(moved.hierarchy).fill(lambda x, y, z: np.sin(7 * x) * np.cos(5 * y + z))
    phi, expected = moved.solve(rho)[0], amrpic.PoissonSolver(moved.hierarchy, backend="crs").solve(rho)[0]
    for level in range(4):
        assert np.array_equal(phi.array(level), expected.array(level))
    before = traffic()
    again = amrpic.PoissonSolver(nested(comm, THERE), reuse=moved.base_setup, backend="crs")
    assert again.native.levels_assembled == 0
    assert (traffic() - before).messages == 0


@pytest.mark.mpi(ranks=(1, 2))
def test_open_walls_act_on_all_levels_below(comm):
    """Where a refined level touches an open wall, the rows below depend on the finest cells there."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), "open")
    levels = [[((0, 8, 8), (15, 23, 23))], [((0, 24, 24), (15, 39, 39))]]
    one, two = (amrpic.Hierarchy(comm, domain, levels[:n], 8) for n in (1, 2))
    solver = amrpic.PoissonSolver(two, backend="crs", reuse=amrpic.PoissonSolver(one, backend="crs").base_setup)
    fresh = amrpic.PoissonSolver(two, backend="crs")
    assert solver.native.levels_assembled == fresh.native.levels_assembled
    for ours, theirs in zip(entries(solver), entries(fresh), strict=True):
        assert np.array_equal(ours, theirs)
