"""What a cycle takes of a rank: a virtual one counts the same as a real one, and what follows from the boxes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic import _native
from amrpic.parallel import Traffic, traffic
from amrpic.scene.solver_options import SolverOptions
from exact.virtual_rank import VirtualRank
from hierarchies import Case, all_cases

CASES = dict(sorted(all_cases().items())[::6])


def hierarchy_of(case: Case, comm: Any) -> amrpic.Hierarchy:
    domain = amrpic.Domain(case.lower, case.upper, case.cells, boundary=case.boundary)
    return amrpic.Hierarchy(comm, domain, case.levels, case.max_grid_size, case.blocking_factor)


def sent(mesh: amrpic.Hierarchy, cycles: int) -> Traffic:
    """What this rank sends in so many cycles, and in what surrounds them."""
    given: dict[str, Any] = {"backend": "matrix-free", "background": "neutralizing"}
    solver = amrpic.PoissonSolver(mesh, tolerance=1e-30, max_cycles=cycles, **given)
    rho = amrpic.Field(mesh, "C/m^3").fill(lambda x, y, z: np.sin(5 * x) * np.cos(3 * y) + z)
    before = traffic()
    solver.solve(rho)
    return traffic() - before


@contextmanager
def most_direct_readers(most: int) -> Iterator[None]:
    """Let coarser corrections that more than so many ranks read of one pass through others, with all solvers made here."""
    values = SolverOptions.native_values
    with patch.object(SolverOptions, "native_values", lambda self: values(self) | {"most_direct_readers": most}):
        yield


def of_norm(mesh: amrpic.Hierarchy) -> int:
    """Collective calls of a norm."""
    before = traffic()
    _native.CompositeLaplacian(mesh.native, (1, 1, 1)).diagonal_norm(amrpic.Field(mesh).native, _native.Norm.max)
    return (traffic() - before).collectives


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,), timeout=240)
@pytest.mark.parametrize("most", [32, 1])
@pytest.mark.parametrize("name", CASES)
def test_a_real_cycle_sends_what_a_rehearsal_on_a_virtual_rank_does(comm, name, most):
    mesh = hierarchy_of(CASES[name], comm)
    unreal = hierarchy_of(CASES[name], VirtualRank(comm.rank, comm.size))
    with most_direct_readers(most):
        found = sent(mesh, 2) - sent(mesh, 1)
        work = _native.cycle_work(unreal.native, 2, 2, most_direct_readers=most)
    beside = residual_and_field(unreal)[0] + of_correction(unreal)
    assert found.messages == sum(level.messages for level in work) + beside.messages
    assert found.bytes == sum(level.bytes for level in work) + beside.bytes
    assert found.collectives == sum(level.collectives for level in work) + of_norm(mesh)
    if comm.size == 1:
        assert found == Traffic()


def found_of(call: Any) -> Traffic:
    before = traffic()
    call()
    return traffic() - before


def residual_and_field(mesh: amrpic.Hierarchy) -> tuple[Traffic, Traffic]:
    """What this rank, which may be virtual, sends for a residual with its norm, and for the field of a potential."""
    solver = amrpic.PoissonSolver(mesh)
    laplacian, field = _native.CompositeLaplacian(mesh.native, (1, 1, 1)), amrpic.Field(mesh)
    walls = [solver.native.wall_data(level).copy() for level in range(mesh.levels)]
    given = field.native, 0.0, walls, field.native, _native.Norm.max, [1.0] * mesh.levels
    return found_of(lambda: laplacian.residual(*given)), found_of(lambda: solver.electric_field(field))


def of_correction(mesh: amrpic.Hierarchy) -> Traffic:
    """What this rank sends for a correction that is added."""
    laplacian, field = _native.CompositeLaplacian(mesh.native, (1, 1, 1)), amrpic.Field(mesh)
    nothing = [np.zeros(field.array(level).size) for level in range(mesh.levels)]
    return found_of(lambda: laplacian.add(nothing, 1.0, field.native))


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,), timeout=240)
@pytest.mark.parametrize("name", CASES)
def test_a_residual_and_a_field_send_the_same_on_virtual_ranks(comm, name):
    residual, field = residual_and_field(hierarchy_of(CASES[name], comm))
    unreal = hierarchy_of(CASES[name], VirtualRank(comm.rank, comm.size))
    assert (residual, field) == residual_and_field(unreal)
    if comm.size == 1:
        assert residual == field == Traffic()
    elif comm.allreduce(len(unreal.local_boxes(0)) > 0, op=MPI.LAND):
        assert comm.allreduce(residual.messages) > 0 and comm.allreduce(field.messages) > 0


def cube(cells: int, rank: int, ranks: int, most: int = 32) -> dict[int, _native.LevelWork]:
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells,) * 3, boundary="dirichlet")
    mesh = amrpic.Hierarchy(VirtualRank(rank, ranks), domain, max_grid_size=24)
    return {level.level: level for level in _native.cycle_work(mesh.native, 2, 2, most_direct_readers=most)}


def test_copies_are_relaxed_as_far_as_sweeps_read_them():
    """Whole slabs of deep copies would make it 1.1 times the own cells; of small levels no copy is relaxed."""
    large = cube(96, 0, 2)
    assert 1.02 * large[0].cells < large[0].relaxed / large[0].sweeps < 1.06 * large[0].cells
    middle = max((cube(72, rank, 27) for rank in range(27)), key=lambda work: work[0].neighbours)
    assert middle[0].cells == 24**3 and middle[0].neighbours == 26
    alone = cube(72, 0, 1)
    assert all(middle[level].relaxed == middle[level].cells * middle[level].sweeps for level in (0, -1))
    # Right-hand sides do not pass; of corrections half of the 6 faces 9 times, and twice the coarser cells around.
    assert middle[0].bytes == 4 * (9 * 3 * 24**2 + 2 * (14**3 - 12**3))
    assert all(level.relaxed == level.cells * level.sweeps for level in alone.values())


def test_levels_of_few_cells_come_together_on_every_eighth_rank():
    by_rank = [cube(192, rank, 512) for rank in range(0, 512, 7)]
    assert {work[0].cells for work in by_rank} == {24**3}
    assert {work[-1].cells for work in by_rank} == {12**3}
    assert {(rank % 8 == 0, work[-2].cells) for rank, work in zip(range(0, 512, 7), by_rank, strict=True)} == {
        (True, 12**3),
        (False, 0),
    }
    assert {work[-3].cells for work in by_rank} <= {0, 12**3}
    assert max(level.neighbours for work in by_rank for level in work.values()) <= 100


@pytest.mark.mpi(ranks=(3, 4), timeout=240)
@pytest.mark.parametrize("name", CASES)
def test_corrections_that_pass_through_other_ranks_are_the_same(comm, name):
    mesh = hierarchy_of(CASES[name], comm)
    rho = amrpic.Field(mesh, "C/m^3").fill(lambda x, y, z: np.sin(5 * x) * np.cos(3 * y) + z)
    found = []
    for most in (32, 1):
        with most_direct_readers(most):
            solver = amrpic.PoissonSolver(mesh, tolerance=1e-30, max_cycles=2, background="neutralizing")
            phi, _ = solver.solve(rho)
        found.append([phi.array(level).copy() for level in range(mesh.levels)])
    assert all(np.array_equal(*levels) for levels in zip(*found, strict=True))


def test_what_many_read_passes_through_some_of_them():
    """A rank of a coarser level has the cells of eight ranks, and 4³ ranks read of it; each value passes at most twice."""

    def found(most: int) -> list[_native.LevelWork]:
        return [cube(192, rank, 512, most)[-1] for rank in range(512)]

    passed_on, direct = found(32), found(1000)
    assert max(work.messages for work in passed_on) < 0.65 * max(work.messages for work in direct)
    bytes_passed_on, bytes_direct = (sum(work.bytes for work in ranks) for ranks in (passed_on, direct))
    assert bytes_direct < bytes_passed_on < 2 * bytes_direct
