"""Named cases in which the cycles depended on ranks, boxes or shapes; each is a law of its own now.

The ordinary run takes the smaller bases; `pytest -m long` the others.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import pytest

from fuzz_case import GAUSSIAN, Box, Case, Outcome, noise
from fuzz_pool import Pool


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    with Pool(4) as several:
        yield several


def outcome(pool: Pool, case: Case) -> Outcome:
    found = pool.call("fuzz_case:solve", case.ranks, case, False, timeout=600)
    assert not found.error, found.error
    assert found.converged, found.reason
    return found


def cycles(pool: Pool, case: Case) -> int:
    return outcome(pool, case).cycles


def cube(lower: int, upper: int) -> tuple[tuple[Box, ...], ...]:
    """One refined level of one cubic box."""
    return ((((lower,) * 3, (upper,) * 3),),)


@pytest.mark.parametrize(
    ("n", "blocking_factor"),
    [(44, 2), (88, 4)] + [pytest.param(n, 8, marks=pytest.mark.long) for n in
                          (96, 176, 192, 256)],
)  # fmt: skip
def test_cycles_on_one_level_do_not_depend_on_ranks(pool, n, blocking_factor):
    """Boxes that are coarsened to odd extents made 9 to 14 of them: a family was cut by the border of a box."""
    case = Case((n,) * 3, blocking_factor=blocking_factor)
    found = [cycles(pool, replace(case, ranks=ranks)) for ranks in (1, 2, 3, 4)]
    assert max(found) <= 7 and max(found) - min(found) <= 1, found


@pytest.mark.parametrize("height", [10, 20])
@pytest.mark.parametrize("cells", [(16, 16, 8), (32, 32, 8)])
def test_odd_corners_do_not_end_coarsening_of_long_cells(pool, cells, height):
    """The corners of level 1 are odd once coarsened; that took 44 to 100 cycles."""
    nx, ny, nz = (2 * n for n in cells)
    box = (2, 2, 6), (nx - 3, ny - 3, nz - 7)
    case = Case(cells, (1.0, 1.0, float(height)), levels=((box,),), blocking_factor=2)
    found = cycles(pool, case)
    assert found <= 10, found


@pytest.mark.long  # 3 million cells
@pytest.mark.parametrize("gamma", [10, 20, 50, 100])
def test_a_stretched_bunch_takes_few_cycles_however_far_the_refined_box_reaches(pool, gamma):
    case = Case((64,) * 3, levels=cube(8, 119), stretch=(1.0, 1.0, float(gamma)), ranks=2)
    found = cycles(pool, case)
    assert found <= 10, found


def test_cycles_on_long_cells_do_not_depend_on_boxes(pool):
    """Where a level may be coarsened follows from the cells that it has, not from how they are cut into boxes."""
    case = Case((32,) * 3, (1.0, 1.0, 10.0), levels=cube(16, 47), blocking_factor=2)
    found = {size: cycles(pool, replace(case, max_grid_size=size)) for size in (6, 8, 12, 14, 16, 24)}
    assert max(found.values()) <= 10 and max(found.values()) - min(found.values()) <= 1, found


@pytest.mark.long  # half a million cells
def test_cycles_of_a_stretched_bunch_do_not_depend_on_boxes(pool):
    case = Case((64,) * 3, levels=cube(32, 95), stretch=(1.0, 1.0, 50.0), ranks=2)
    found = {size: cycles(pool, replace(case, max_grid_size=size)) for size in (16, 24, 32)}
    assert max(found.values()) <= 10 and max(found.values()) - min(found.values()) <= 1, found


def test_cycles_on_unequal_widths_do_not_depend_on_ranks(pool):
    case = Case((72,) * 3, (1.75, 1.25, 1.0), blocking_factor=4, max_grid_size=64)
    found = [cycles(pool, replace(case, ranks=ranks)) for ranks in (1, 2, 3, 4)]
    assert max(found) - min(found) <= 1, found


@pytest.mark.parametrize("source", [GAUSSIAN, noise(3)], ids=["gaussian", "noise"])
@pytest.mark.parametrize(("height", "limit"), [(1, 9), (10, 16)])
def test_columns_that_touch_along_edges_alone_take_few_cycles(pool, height, limit, source):
    """A checkerboard of refined columns along z: blocks meet at edges only, of which long cells made 18 cycles and more."""
    columns = itertools.product(range(0, 64, 8), range(0, 64, 8))
    boxes = tuple(((i, j, 0), (i + 7, j + 7, 63)) for i, j in columns if (i + j) // 8 % 2 == 0)
    found = cycles(pool, Case((32,) * 3, (1.0, 1.0, float(height)), levels=(boxes,), source=source))
    assert found <= limit, found


WALLS, RING, CLOSED = ("dirichlet", "dirichlet"), ("periodic", "periodic"), ("neumann", "neumann")


@pytest.mark.parametrize("upper", [CLOSED, WALLS])
@pytest.mark.parametrize(("cells", "every"), [((8, 8, 8), 11), ((8, 8, 8), 37), ((9, 31, 6), 23)])
def test_gaps_of_one_coarse_cell_hold_corrections_of_long_cells(pool, cells, every, upper):
    """Everything is refined except single coarse cells. Copies of the level that bridged these gaps overshot by factors of up
    to twenty, and cycles grew: 25 to more than 100 of them."""
    refined = (c for c in itertools.product(*map(range, cells)) if (3 * c[0] + 5 * c[1] + 7 * c[2]) % every)
    boxes = tuple(((2 * i, 2 * j, 2 * k), (2 * i + 1, 2 * j + 1, 2 * k + 1)) for i, j, k in refined)
    found = outcome(pool, Case(cells, (1.0, 1.0, 40.0), (CLOSED, CLOSED, upper), (boxes,), blocking_factor=2))
    assert found.cycles <= 16, found.cycles
    assert max(found.residuals) < 5, found.residuals


@pytest.mark.parametrize("walls", [CLOSED, WALLS])
def test_an_axis_of_one_cell_does_not_keep_copies_from_coarsening_others(pool, walls):
    """z has one cell on a copy when y has three. The copies ended there, and what is constant along y stayed: 23 and 26."""
    case = Case((40, 5, 2), (68.0, 1.0, 1.0), (walls, RING, RING), ((((4, 0, 0), (75, 9, 3)),),), blocking_factor=2)
    found = cycles(pool, case)
    assert found <= 13, found


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize(
    ("cells", "spacing", "boundary"),
    [
        ((26, 2, 2), (37.0, 1.0, 1.0), (WALLS, RING, RING)),
        ((26, 2, 2), (1.0, 1.0, 1.0), (WALLS, RING, RING)),
        ((3, 70, 3), (1.0, 46.0, 1.0), (RING, WALLS, RING)),
    ],
)
def test_rings_of_two_or_three_cells_converge_like_others(pool, cells, spacing, boundary, ranks):
    """Sweeps reach further across a periodic axis than it has cells: beyond the first image they took zeros, and diverged."""
    case = Case(cells, spacing, boundary, blocking_factor=2, source=noise(3), ranks=ranks)
    found = cycles(pool, case)
    assert found <= 8, found


def test_the_exact_bottom_knows_open_walls_of_a_base_that_is_covered(pool):
    """A base of a few cells is the bottom itself: it took corrections to vanish where those of the finer level do not."""
    case = Case((9, 2, 2), boundary=(("open", "open"),) * 3, levels=((((0, 0, 0), (17, 3, 3)),),), blocking_factor=2)
    found = [cycles(pool, replace(case, backend=backend)) for backend in ("matrix-free", "crs")]
    assert max(found) <= 6, found


def test_steps_behind_gaps_at_walls_are_as_long_in_both_backends(pool):
    """Slow cycles are followed by Jacobi steps on coarse cells behind narrow gaps. Matrix-free these took the diagonal of cells
    away from walls, and overshot beside walls: one or two cycles more."""
    corners = [((0, 20, 6), (5, 21, 7)), ((0, 22, 2), (3, 23, 5)), ((0, 24, 4), (5, 25, 7)), ((0, 26, 6), (3, 31, 7)),
               ((0, 30, 4), (3, 33, 5)), ((4, 32, 4), (5, 35, 7))]  # fmt: skip
    case = Case((3, 21, 4), levels=(tuple(corners),), blocking_factor=2, source=noise(3))
    found = [cycles(pool, replace(case, backend=backend)) for backend in ("matrix-free", "crs")]
    assert found[0] == found[1], found


@pytest.mark.parametrize(
    "boundary", [(CLOSED, CLOSED, RING), (CLOSED, WALLS, CLOSED), (WALLS, CLOSED, RING), (WALLS,) * 3]
)
def test_columns_of_refined_cells_between_walls_that_are_two_cells_apart(pool, boundary):
    """No coarse face has a whole block of cells in its plane. Fits in space extrapolated, with weights of up to 17 and negative
    ones of the cell behind the face, and errors at the ends of columns fell by a tenth per cycle: 14 and 15 of them."""
    columns = ((((0, 4, 46), (1, 5, 85)),), (((0, 10, 94), (1, 11, 117)),))
    case = Case((2, 3, 48), boundary=boundary, levels=columns, blocking_factor=2, source=noise(3))
    found = [cycles(pool, replace(case, backend=backend)) for backend in ("matrix-free", "kokkos", "crs")]
    assert max(found) <= 9, found


@pytest.mark.parametrize("boundary", [(WALLS, WALLS, WALLS), (RING, CLOSED, WALLS)])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (1.0, 1.0, 4.0), (1.0, 3.0, 10.0), (10.0, 10.0, 1.0)])
def test_both_backends_take_the_same_steps(pool, spacing, boundary):
    """On a refined box without narrow gaps all residuals are equal but for rounding. Matrix-free the copies of levels of long
    cells were relaxed as the level itself, whatever the shape of their own cells."""
    case = Case((16,) * 3, spacing, boundary, levels=cube(8, 23), source=noise(3))
    free, rows = (outcome(pool, replace(case, backend=backend)) for backend in ("matrix-free", "crs"))
    assert free.residuals[:7] == pytest.approx(rows.residuals[:7], rel=5e-3)


@pytest.mark.parametrize(
    ("cells", "spacing", "boundary", "source"),
    [
        ((4, 67, 14), (80.48, 80.48, 1.0), (CLOSED, RING, RING), noise(9)),
        ((2, 3, 13), (100.0, 100.0, 1.0), (WALLS, WALLS, RING), GAUSSIAN),
        ((16, 16, 64), (10.0, 10.0, 1.0), (WALLS, WALLS, WALLS), noise(9)),
    ],
)
def test_flat_cells_take_no_more_cycles_in_one_backend_than_in_the_other(pool, cells, spacing, boundary, source):
    """Errors couple along one axis alone. With over-relaxation their pace was that at which slow cycles are combined: one
    backend did so, for 7 or 8 cycles, the other took 10 or 11."""
    case = Case(cells, spacing, boundary, blocking_factor=2, source=source)
    free, rows = (outcome(pool, replace(case, backend=backend)) for backend in ("matrix-free", "crs"))
    assert not free.accelerated
    assert abs(free.cycles - rows.cycles) <= 1, (free.residuals, rows.residuals)
    assert max(free.cycles, rows.cycles) <= 11
