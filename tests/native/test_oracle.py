"""Laws which the oracle itself obeys, without the native code: so that what the operators are compared with is right."""

from __future__ import annotations

import itertools
from collections import Counter
from fractions import Fraction
from functools import cache, lru_cache, partial

import numpy as np
import pytest

import operator_laws
from hierarchies import all_cases, for_the_oracle
from oracle import (
    FITS,
    LINEAR_FITS,
    PLACEMENTS,
    QUADRATIC_FITS,
    Cell,
    Oracle,
    Phi,
    composite_system,
    fit,
    lagrange,
    monomials,
    shifted,
    space_fit,
)

CASES = all_cases()
each_case = pytest.mark.parametrize("name", CASES, scope="module")
each_case_with_its_operators = pytest.mark.parametrize("name", for_the_oracle(CASES), scope="module")
SINGULAR = [
    name
    for name, case in CASES.items()
    if all(kind in ("neumann", "periodic") for faces in case.boundary.values() for kind in faces)
]


OPEN = ("corner", "corner of large blocks", "open face", "crossings normal to y", "scattered 11")

# Small, with walls that fix the potential, and with fits of first order at least.
SOLVED = ("single level", "L at the walls, anisotropic", "corner", "edge", "crossings normal to x", "region wrapping x")


@lru_cache(maxsize=1)
def oracle_of(name: str) -> Oracle:
    return Oracle(CASES[name], CASES[name].all_boxes())


@lru_cache(maxsize=1)
def operators_of(name: str) -> operator_laws.Operators:
    return [oracle_of(name).operators(level) for level in range(oracle_of(name).levels)]


def fractions(*texts: str) -> list[Fraction]:
    return [Fraction(text) for text in texts]


@pytest.mark.parametrize(
    ("nodes", "at", "weights"),
    [
        ((-1, 0, 1), "-1/4", ("5/32", "15/16", "-3/32")),
        ((-1, 0, 1), "1/4", ("-3/32", "15/16", "5/32")),
        ((0, 1, 2), "-1/4", ("45/32", "-9/16", "5/32")),
        ((0, 1, 2), "1/4", ("21/32", "7/16", "-3/32")),
        ((-2, -1, 0), "1/4", ("5/32", "-9/16", "45/32")),
        ((-2, -1, 0), "-1/4", ("-3/32", "7/16", "21/32")),
    ],
)
def test_tabulated_tangential_weights_are_lagrange_weights(nodes, at, weights):
    assert lagrange(nodes, Fraction(at)) == fractions(*weights)


def test_ghost_weights_are_lagrange_weights_along_the_normal():
    """Positions in quarters of a fine cell width, ghost at 1/2, coarse plane at 1, fine cells at -1/2 and -3/2."""
    assert lagrange((4, -2, -6), Fraction(2)) == fractions("8/15", "2/3", "-1/5")
    # Dirichlet: face at 0, cells at -1/2 and -3/2, ghost at 1/2
    assert lagrange((0, -1, -3), Fraction(1)) == fractions("8/3", "-2", "1/3")


def test_placements_and_their_order_are_the_seed_s_bit_patterns():
    patterns = [sum(2 ** (5 * (i + 2) + j + 2) for i in columns for j in rows) for _, columns, rows in PLACEMENTS]
    assert patterns == [473536, 14798, 236768, 15153152, 947072, 29596, 7399, 7576576, 30306304]


def is_in(cells: set[tuple[int, int]], i: int, j: int) -> bool:
    return (i, j) in cells


def test_every_placement_reproduces_biquadratic_polynomials():
    """In each of the nine blocks alone, and nowhere in fewer cells."""
    for (name, columns, rows), s, t in itertools.product(PLACEMENTS, (-1, 1), (-1, 1)):
        cells, at = set(itertools.product(columns, rows)), (Fraction(s, 4), Fraction(t, 4))
        found = fit(partial(is_in, cells), at)
        assert found is not None and found[0] == name and set(found[1]) == cells
        for p, q in itertools.product(range(3), range(3)):
            assert sum(w * i**p * j**q for (i, j), w in found[1].items()) == at[0] ** p * at[1] ** q
        for cell in cells:
            assert fit(partial(is_in, cells - {cell}), at) is None


def test_fits_in_space_take_the_highest_order_that_the_sites_determine():
    lattice = np.array(list(itertools.product((-0.6, -0.1, 0.4), repeat=3)))
    plane, line = lattice[lattice[:, 0] == 0.4] * 0.9, lattice[:1]
    for sites, order in ((lattice, 2), (lattice[:9:2], 0), (plane, 0), (line, 0), (plane - [0.36, 0, 0], 2)):
        found, weights = space_fit(sites)
        assert found == order
        wanted = monomials(order, np.zeros((1, 3)))[0]
        assert monomials(order, sites).T @ weights == pytest.approx(wanted, abs=1e-12)


@cache
def met_in_collection() -> Counter[tuple[str, frozenset[tuple[int, int]]]]:
    """Return how many coarse-fine faces of all cases use a fit in a block of usable cells."""
    met: Counter[tuple[str, frozenset[tuple[int, int]]]] = Counter()
    for case in CASES.values():
        oracle = Oracle(case, case.all_boxes())
        oracle.coverage()
        for face, name in oracle.interfaces.items():
            coarse, _ = oracle.in_plane(*face)
            near = [(i, j) for i in range(-2, 3) for j in range(-2, 3)]
            met[name, frozenset(c for c in near if oracle.is_usable(face.level - 1, coarse(*c)))] += 1
    return met


@pytest.mark.long  # of the collection, not of what is tested on it
def test_the_collection_meets_every_placement_and_fits_in_gaps():
    faces = {fit_name: sum(n for (name, _), n in met_in_collection().items() if name == fit_name) for fit_name in FITS}
    assert [name for name, count in faces.items() if count < 10] == []


def block(placement: tuple[str, tuple[int, ...], tuple[int, ...]]) -> set[tuple[int, int]]:
    return set(itertools.product(placement[1], placement[2]))


@pytest.mark.long  # of the collection, not of what is tested on it
def test_the_collection_tells_every_order_of_two_placements_apart():
    """For any two placements, some ghost uses the first and has the second, unless an earlier one is there with them."""
    for first, second in itertools.combinations(range(len(PLACEMENTS)), 2):
        both = block(PLACEMENTS[first]) | block(PLACEMENTS[second])
        if not any(block(earlier) <= both for earlier in PLACEMENTS[:first]):
            assert any(name == PLACEMENTS[first][0] and both <= usable for name, usable in met_in_collection())


def test_the_collection_holds_all_kinds_of_hierarchy():
    assert len(CASES) >= 24
    assert {case.blocking_factor for case in CASES.values()} == {2, 4, 8}
    assert {len(case.levels) + 1 for case in CASES.values()} == {1, 2, 3, 4}
    kinds = {kind for case in CASES.values() for faces in case.boundary.values() for kind in faces}
    assert kinds == {"dirichlet", "neumann", "periodic", "open"}


@each_case
def test_hierarchies_nest_properly(name):
    oracle = oracle_of(name)
    for level in range(oracle.levels):
        assert len(oracle.column[level]) == len(oracle.cells[level]), "boxes overlap"
    for level in range(1, oracle.levels):
        for cell in oracle.refined[level - 1]:
            for step in itertools.product((-1, 0, 1), repeat=3):
                there = oracle.wrapped(level - 1, tuple(c + s for c, s in zip(cell, step, strict=True)))  # type: ignore[arg-type]
                assert there is None or oracle.exists(level - 1, there)


@each_case_with_its_operators
def test_laplacian_integrates_to_the_flux_through_the_walls(name):
    assert operator_laws.gauss_defect(oracle_of(name), operators_of(name)) < 1e-13


@pytest.mark.parametrize("name", for_the_oracle(SINGULAR), scope="module")
def test_laplacian_and_field_of_a_constant_vanish_where_no_wall_fixes_the_potential(name):
    assert operator_laws.constant_defect(oracle_of(name), operators_of(name)) < 1e-12


@each_case_with_its_operators
def test_laplacian_and_field_are_exact_for_polynomials_of_the_fits_degree(name):
    oracle = oracle_of(name)
    for degree, fits in ((1, LINEAR_FITS), (2, QUADRATIC_FITS)):
        defects = operator_laws.exactness_defects(oracle, operators_of(name), degree, fits)
        assert defects["rows"] > 0 or not fits & set(oracle.coverage())
        assert defects["laplacian"] < 1e-12
        assert defects["field"] < 1e-12


def spacing_at(oracle: Oracle, point: np.ndarray, axis: int) -> float:
    """Return the spacing along an axis of the finest cell that holds a point."""
    for level in reversed(range(oracle.levels)):
        i, j, k = np.floor((point - oracle.lower) / oracle.spacing[level]).astype(int)
        if oracle.exists(level, (int(i), int(j), int(k))):
            return float(oracle.spacing[level][axis])
    raise AssertionError(f"no cell holds {point}")


def mean_spacing_at_face(oracle: Oracle, level: int, cell: Cell, axis: int, side: int) -> float:
    """Return the mean of `spacing_at` over the face of a cell, by probes just inside it, one per cell of the finest level."""
    count = 2 ** (oracle.levels - 1 - level)
    steps = (np.arange(count) + 0.5) / count - 0.5
    found = []
    for a, b in itertools.product(steps, repeat=2):
        offset = np.insert([a, b], axis, side * (0.5 - 0.25 / count))
        found.append(spacing_at(oracle, oracle.centre(level, cell) + offset * oracle.spacing[level], axis))
    return float(np.mean(found))


@pytest.mark.parametrize("name", OPEN, scope="module")
def test_corrections_vanish_at_the_finest_ghosts_behind_open_walls(name):
    """The homogeneous ghost of a cell continues the line through it that is zero half of the finest spacing outside.

    For uncovered cells that is the ghost's own centre: the potential is given there, so the ghost takes nothing."""
    oracle, checked = oracle_of(name), Counter[bool]()
    for level, axis, side in itertools.product(range(oracle.levels), range(3), (-1, 1)):
        for cell in oracle.cells[level]:
            if oracle.types[axis][side > 0] == "open" and oracle.wrapped(level, shifted(cell, axis, side)) is None:
                own = oracle.spacing[level][axis]
                zero = -mean_spacing_at_face(oracle, level, cell, axis, side) / 2  # distance from the wall, inward
                line = (-own / 2 - zero) / (own / 2 - zero)
                ghost = oracle.beyond(level, cell, axis, side)
                assert {k: w for k, w in ghost.items() if isinstance(k, Phi)} == {
                    Phi(level, cell): pytest.approx(line, abs=1e-14)
                }
                checked[oracle.is_covered(level, cell)] += 1
    assert checked[True] and checked[False]


@each_case_with_its_operators
def test_transfers_are_exact_for_linear_functions(name):
    assert operator_laws.transfer_defect(oracle_of(name), operators_of(name)) < 1e-13


@pytest.mark.parametrize("name", SOLVED, scope="module")
def test_composite_solution_is_exact_for_linear_functions(name):
    """With a single-value fit nowhere, the linear function of its own boundary data solves the whole system."""
    oracle = oracle_of(name)
    assert set(oracle.coverage()) <= LINEAR_FITS
    exact = operator_laws.random_polynomial(oracle, 1)
    system = composite_system(oracle, exact.data())
    phi = system.solve([np.zeros(oracle.size(level)) for level in range(oracle.levels)])
    efield = system.field(phi)
    for level in range(oracle.levels):
        assert phi[level] == pytest.approx(exact(oracle.centres(level)), abs=1e-10)
        assert efield[level] == pytest.approx(np.broadcast_to(-exact.linear, efield[level].shape), abs=1e-9)
