"""An independent oracle for the eight operators and for the composite solution.

Everything is written cell by cell from the formulas, in the most obvious way. A quantity is a linear form: a
dictionary from what it depends on, `Phi(level, cell)` or `Wall(level, cell, axis, side)`, to a weight. `Phi` is the
potential of a cell; `Wall` is the datum given at a physical face: the potential at the face centre (Dirichlet), the
outward derivative there (Neumann), or the potential at the ghost's centre (open). Speed does not matter here.
"""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import cache, wraps
from types import SimpleNamespace
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar, cast

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

Cell = tuple[int, int, int]
Offset = tuple[int, int]  # in coarse cells, along the two tangential axes of a face in ascending order
Fit = tuple[str, Mapping[Offset, Fraction]]


class Phi(NamedTuple):
    level: int
    cell: Cell


class Wall(NamedTuple):
    """A face of a cell: side -1 is the lower one along the axis, +1 the upper one."""

    level: int
    cell: Cell
    axis: int
    side: int


Form = dict[Phi | Wall, float]

# --- interpolation in the interface plane -----------------------------------------------------------------------------

CENTRED, LEFT, RIGHT = (-1, 0, 1), (-2, -1, 0), (0, 1, 2)
PLACEMENTS = (
    ("biquadratic (c, c)", CENTRED, CENTRED),
    ("biquadratic (-, c)", LEFT, CENTRED),
    ("biquadratic (c, -)", CENTRED, LEFT),
    ("biquadratic (+, c)", RIGHT, CENTRED),
    ("biquadratic (c, +)", CENTRED, RIGHT),
    ("biquadratic (-, +)", LEFT, RIGHT),
    ("biquadratic (-, -)", LEFT, LEFT),
    ("biquadratic (+, -)", RIGHT, LEFT),
    ("biquadratic (+, +)", RIGHT, RIGHT),
)
IN_GAPS = ("in a gap, constant", "in a gap, linear", "in a gap, quadratic")  # by the order of the fit
QUADRATIC_FITS = frozenset(name for name, _, _ in PLACEMENTS) | {IN_GAPS[2]}
LINES = ("in a gap of long cells, constant", "in a gap of long cells, one slope", "in a gap of long cells, two slopes")
LINEAR_FITS = QUADRATIC_FITS | {IN_GAPS[1], LINES[2]}
FITS = (*(name for name, _, _ in PLACEMENTS), IN_GAPS[2], *LINES)


@cache
def lagrange(nodes: tuple[int, ...], at: Fraction) -> list[Fraction]:
    """Return the weight of each node in the polynomial through all of them, evaluated at `at`."""
    weights = []
    for node in nodes:
        weight = Fraction(1)
        for other in nodes:
            if other != node:
                weight *= (at - other) / Fraction(node - other)
        weights.append(weight)
    return weights


def fit(usable: Callable[[int, int], bool], at: tuple[Fraction, Fraction]) -> Fit | None:
    """Return the name and the weights, by offset from the cell that holds the ghost, of the first complete placement."""
    for name, columns, rows in PLACEMENTS:
        if all(usable(i, j) for i in columns for j in rows):
            return name, product(columns, rows, at)
    return None


@cache
def product(columns: tuple[int, ...], rows: tuple[int, ...], at: tuple[Fraction, Fraction]) -> dict[Offset, Fraction]:
    """Return the weights of the tensor product of the Lagrange polynomials through the columns and through the rows."""
    along_u, along_v = lagrange(columns, at[0]), lagrange(rows, at[1])
    return {(i, j): along_u[a] * along_v[b] for a, i in enumerate(columns) for b, j in enumerate(rows)}


# --- where no placement is complete: least squares in space -----------------------------------------------------------

REACH = 3.0  # fine widths
LARGEST_SUM = 10.0  # of the magnitudes of the weights
LEAST_OF_NEAREST = 0.1  # the weight in a quadratic fit of the cell behind the face
LONG = 1.8  # aspect ratio of cells beyond which they are


def monomials(order: int, x: np.ndarray) -> np.ndarray:
    """Return the monomials of at most this order at points (n, 3), one column each."""
    powers = [e for e in itertools.product(range(order + 1), repeat=3) if sum(e) <= order]
    return np.stack([np.prod(x ** np.array(e), axis=1) for e in powers], axis=1)


@cache
def within_reach(width: int, place: tuple[float, float, float]) -> list[tuple[Cell, np.ndarray]]:
    """Return the cells of a lattice of this width near a place in the cell at the origin, with the way to their centres."""
    near = range(-4, 5)
    cells = [(i, j, k) for i in near for j in near for k in near]
    found = [(cell, width * (np.array(cell) + 0.5) - np.array(place)) for cell in cells]
    return [(cell, away) for cell, away in found if (away**2).sum() < REACH**2]


KNOWN: dict[bytes, tuple[int, np.ndarray]] = {}


def space_fit(sites: np.ndarray) -> tuple[int, np.ndarray]:
    """Return `new_space_fit(sites)`, found once for the same sites."""
    key = sites.tobytes()
    if key not in KNOWN:
        KNOWN[key] = new_space_fit(sites)
    return KNOWN[key]


def new_space_fit(sites: np.ndarray) -> tuple[int, np.ndarray]:
    """Return the order and the weights of the least squares fit at the origin to values at sites (n, 3), in units of the
    reach: the quadratic one if it is determined and goes by the nearest value, else the linear one, else the constant one.

    Of all weights that reproduce the polynomials, those of least sum of squares over (1 - r²)², by SVD.
    """
    root = 1 - (sites**2).sum(axis=1)
    for order in (2, 1, 0):
        rows, wanted = monomials(order, sites), monomials(order, np.zeros((1, 3)))[0]
        weights = root * (np.linalg.pinv((root[:, None] * rows).T, rcond=1e-10) @ wanted)
        goes_by_nearest = order < 2 or weights[np.argmax(root)] >= LEAST_OF_NEAREST
        if goes_by_nearest and np.abs(rows.T @ weights - wanted).max() < 1e-9 and np.abs(weights).sum() < LARGEST_SUM:
            return order, weights
    raise AssertionError("no site")


# --- the composite grid ---------------------------------------------------------------------------------------------


def face_types(boundary: Any) -> list[tuple[str, str]]:
    """Return per axis the boundary types of the lower and the upper face, from any of the public spellings."""
    if isinstance(boundary, str):
        boundary = [boundary] * 3
    if isinstance(boundary, Mapping):
        boundary = [boundary[name] for name in "xyz"]
    return [(entry, entry) if isinstance(entry, str) else (str(entry[0]), str(entry[1])) for entry in boundary]


def shifted(cell: Cell, axis: int, step: int) -> Cell:
    i, j, k = cell
    return (i + step, j, k) if axis == 0 else (i, j + step, k) if axis == 1 else (i, j, k + step)


def parent(cell: Cell) -> Cell:
    return (cell[0] // 2, cell[1] // 2, cell[2] // 2)


def children(cell: Cell) -> list[Cell]:
    i, j, k = cell
    return [(2 * i + a, 2 * j + b, 2 * k + c) for c in (0, 1) for b in (0, 1) for a in (0, 1)]


def cells_of(boxes: Iterable[Sequence[int]]) -> list[Cell]:
    """Return the cells of boxes (lower x, y, z, upper x, y, z; inclusive) in the order of rows: x fastest within a box."""
    return [
        (i, j, k)
        for x0, y0, z0, x1, y1, z1 in (map(int, box) for box in boxes)
        for k in range(z0, z1 + 1)
        for j in range(y0, y1 + 1)
        for i in range(x0, x1 + 1)
    ]


def add(form: Form, other: Form, factor: float = 1.0) -> None:
    for key, weight in other.items():
        form[key] = form.get(key, 0.0) + factor * weight


P = ParamSpec("P")
T = TypeVar("T")


def found_once(method: Callable[Concatenate[Oracle, P], T]) -> Callable[Concatenate[Oracle, P], T]:
    """Let an oracle keep what a method returns for the same arguments; nobody may change it."""

    @wraps(method)
    def found(self: Oracle, *given: P.args, **named: P.kwargs) -> T:
        key = (method.__name__, given, *named.items())
        if key not in self.found:
            self.found[key] = method(self, *given, **named)
        return cast(T, self.found[key])

    return found


class Oracle:
    """The operators of a hierarchy given by its domain (lower, upper, cells, boundary) and the boxes of each level."""

    def __init__(self, domain: Any, boxes: Sequence[Iterable[Sequence[int]]]) -> None:
        self.cells = [cells_of(level) for level in boxes]
        self.column = [{cell: n for n, cell in enumerate(level)} for level in self.cells]
        self.levels = len(self.cells)
        self.types = face_types(domain.boundary)
        self.extent = [tuple(int(n) * 2**level for n in domain.cells) for level in range(self.levels)]
        self.lower = np.array(domain.lower, dtype=float)
        length = np.array(domain.upper, dtype=float) - self.lower
        self.spacing = [length / np.array(extent) for extent in self.extent]
        self.interfaces: dict[Wall, str] = {}  # the name of the fit behind each
        self.found: dict[tuple[Any, ...], Any] = {}
        self.refined = [{parent(cell) for cell in level} for level in self.cells[1:]] + [set()]
        self.usable = [set(cells) - refined for cells, refined in zip(self.cells, self.refined, strict=True)]

    @classmethod
    def of(cls, hierarchy: Any) -> Oracle:
        """Return the oracle of an `amrpic.Hierarchy`."""
        return cls(hierarchy.domain, [np.asarray(hierarchy.boxes(level)) for level in range(hierarchy.levels)])

    # --- where cells are

    def wrapped(self, level: int, cell: Cell) -> Cell | None:
        """Return the cell, brought back through periodic faces; None outside a wall."""
        a, b, c = self.extent[level]
        if 0 <= cell[0] < a and 0 <= cell[1] < b and 0 <= cell[2] < c:
            return cell
        for axis, extent in enumerate((a, b, c)):
            if not 0 <= cell[axis] < extent:
                if self.types[axis][0] != "periodic":
                    return None
                cell = shifted(cell, axis, cell[axis] % extent - cell[axis])
        return cell

    def exists(self, level: int, cell: Cell | None) -> bool:
        return cell is not None and 0 <= level < self.levels and cell in self.column[level]

    def is_covered(self, level: int, cell: Cell) -> bool:
        return cell in self.refined[level]

    def is_usable(self, level: int, cell: Cell) -> bool:
        """Return whether interpolation may use the cell: inside the domain, on the level, and uncovered."""
        return 0 <= level < self.levels and self.wrapped(level, cell) in self.usable[level]

    def uncovered(self, level: int) -> np.ndarray:
        return np.array([not self.is_covered(level, cell) for cell in self.cells[level]], dtype=bool)

    def volume(self, level: int) -> float:
        return float(np.prod(self.spacing[level]))

    def centre(self, level: int, cell: Cell) -> np.ndarray:
        return self.lower + (np.array(cell) + 0.5) * self.spacing[level]

    def centres(self, level: int) -> np.ndarray:
        """Return the centres of all cells of the level, (n, 3)."""
        return self.lower + (np.array(self.cells[level], dtype=float).reshape(-1, 3) + 0.5) * self.spacing[level]

    # --- ghosts, fluxes, and what is made of them

    @found_once
    def beyond(self, level: int, cell: Cell, axis: int, side: int) -> Form:
        """Return phi at the centre of the neighbour of the cell through one face (side -1 or +1), finer levels ignored."""
        neighbour = self.wrapped(level, shifted(cell, axis, side))
        if neighbour is None:
            return self.wall_ghost(level, cell, axis, side)
        if self.exists(level, neighbour):
            return {Phi(level, neighbour): 1.0}
        return self.interface_ghost(level, cell, axis, side)

    def wall_ghost(self, level: int, cell: Cell, axis: int, side: int) -> Form:
        datum = Wall(level, cell, axis, side)
        kind = self.types[axis][0 if side < 0 else 1]
        if kind == "dirichlet":
            return {datum: 8 / 3, Phi(level, cell): -2.0, Phi(level, self.inward(level, cell, axis, side)): 1 / 3}
        if kind == "neumann":
            return {Phi(level, cell): 1.0, datum: float(self.spacing[level][axis])}
        assert kind == "open", kind
        return {datum: 1.0, Phi(level, cell): self.open_wall_factor(level, cell, axis, side)}

    def open_wall_factor(self, level: int, cell: Cell, axis: int, side: int) -> float:
        """Return what the ghost behind an open wall takes from the cell: nothing if it is uncovered, since the potential is
        given there. A covered cell holds corrections alone, which vanish where the finest ghosts are: linear from the
        centre of the cell, half a spacing inside, to zero at half of the finest spacing (its mean over the wall face)
        outside."""
        own = float(self.spacing[level][axis])
        finest = self.finest_at_wall(level, cell, axis, side)
        return (finest - own) / (finest + own)

    def finest_at_wall(self, level: int, cell: Cell, axis: int, side: int) -> float:
        if not self.is_covered(level, cell):
            return float(self.spacing[level][axis])
        at_wall = [2 * c for c in cell]
        if side > 0:
            at_wall[axis] += 1
        u, v = [other for other in range(3) if other != axis]
        found = []
        for a, b in itertools.product((0, 1), repeat=2):
            child = shifted(shifted((at_wall[0], at_wall[1], at_wall[2]), u, a), v, b)
            found.append(self.finest_at_wall(level + 1, child, axis, side))
        return sum(found) / 4

    def inward(self, level: int, cell: Cell, axis: int, side: int) -> Cell:
        second = self.wrapped(level, shifted(cell, axis, -side))
        assert second is not None and self.exists(level, second), f"no second cell behind {cell} of level {level}"
        return second

    def in_plane(self, level: int, cell: Cell, axis: int, side: int) -> tuple[Callable[[int, int], Cell], Cell]:
        """Return the coarse cell by its offsets (along the lower, the higher tangential axis) from the one that holds the
        ghost at a coarse-fine face, as a function, and the fine cell where the ghost is."""
        ghost = self.wrapped(level, shifted(cell, axis, side))
        assert ghost is not None
        centre = parent(ghost)
        assert self.is_usable(level - 1, centre), f"ghost {ghost} of level {level} lies in no uncovered coarse cell"
        u, v = [other for other in range(3) if other != axis]
        return lambda i, j: shifted(shifted(centre, u, i), v, j), ghost

    def interface_ghost(self, level: int, cell: Cell, axis: int, side: int) -> Form:
        """Return the ghost of a fine cell at a coarse-fine face: 8/15 phi* + 2/3 phi_1 - 1/5 phi_2."""
        coarse, ghost = self.in_plane(level, cell, axis, side)
        u, v = [other for other in range(3) if other != axis]
        at = (Fraction(2 * (ghost[u] % 2) - 1, 4), Fraction(2 * (ghost[v] % 2) - 1, 4))
        found = fit(lambda i, j: self.is_usable(level - 1, coarse(i, j)), at)
        form: Form = {}
        if found is None:
            self.interfaces[Wall(level, cell, axis, side)], star = self.fit_in_gap(level, ghost, axis, side)
            add(form, star, 8 / 15)
        else:
            self.interfaces[Wall(level, cell, axis, side)] = found[0]
            for (i, j), weight in found[1].items():
                there = self.wrapped(level - 1, coarse(i, j))
                assert there is not None
                add(form, {Phi(level - 1, there): float(Fraction(8, 15) * weight)})
        add(form, {Phi(level, cell): 2 / 3})
        add(form, {Phi(level, self.inward(level, cell, axis, side)): -1 / 5})
        return form

    def fit_in_gap(self, level: int, ghost: Cell, axis: int, side: int) -> tuple[str, Form]:
        """Return phi* half a fine width further out than the ghost's centre, and the name of the fit: to all uncovered cells
        of both levels within the reach, in units of the cells; where cells are long, by lines through the cell behind."""
        if max(self.spacing[level]) > LONG * min(self.spacing[level]):
            return self.fit_by_lines(level, ghost, axis)
        place = np.array(ghost) + 0.5
        place[axis] += 0.5 * side
        found: list[tuple[Phi, np.ndarray]] = []
        for at_level, width in ((level - 1, 2), (level, 1)):
            nearest = np.floor(place / width).astype(int)
            inside, (a, b, c) = place - width * nearest, nearest.tolist()
            for (i, j, k), away in within_reach(width, (inside[0], inside[1], inside[2])):
                there = self.wrapped(at_level, (a + i, b + j, c + k))
                if there in self.usable[at_level]:
                    found.append((Phi(at_level, there), away))
        order, weights = space_fit(np.array([x for _, x in found]) / REACH)
        form: Form = {}
        for (key, _), weight in zip(found, weights, strict=True):
            add(form, {key: float(weight)})
        return IN_GAPS[order], form

    def fit_by_lines(self, level: int, ghost: Cell, axis: int) -> tuple[str, Form]:
        """Return the name of the fit and phi*, from the coarse cell behind a face by differences in its plane."""
        middle = parent(ghost)
        first = self.wrapped(level - 1, middle)
        assert first is not None
        form: Form = {Phi(level - 1, first): 1.0}
        slopes = 0
        for d in (other for other in range(3) if other != axis):
            near = [self.wrapped(level - 1, shifted(middle, d, side)) for side in (-1, 1)]
            ends = [first if cell is None or not self.is_usable(level - 1, cell) else cell for cell in near]
            distance = sum(end != first for end in ends)
            slopes += distance > 0
            for end, sign in zip(ends, (-1, 1), strict=True):
                if distance:
                    add(form, {Phi(level - 1, end): sign * (ghost[d] % 2 - 0.5) / 2 / distance})
        return LINES[slopes], form

    @found_once
    def slope(self, level: int, cell: Cell, axis: int, side: int, composite: bool) -> Form:
        """Return the outward derivative of phi at a face; on the composite grid a refined neighbour gives its mean."""
        neighbour = self.wrapped(level, shifted(cell, axis, side))
        form: Form = {}
        if composite and neighbour is not None and self.is_covered(level, neighbour):
            touching = [child for child in children(neighbour) if child[axis] % 2 == (0 if side > 0 else 1)]
            for child in touching:
                # The outward direction of the fine cell is the inward direction of the coarse one.
                add(form, self.slope(level + 1, child, axis, -side, composite=False), -1 / 4)
            return form
        h = float(self.spacing[level][axis])
        add(form, self.beyond(level, cell, axis, side), 1 / h)
        add(form, {Phi(level, cell): -1 / h})
        return form

    @found_once
    def laplacian(self, level: int, cell: Cell, composite: bool) -> Form:
        form: Form = {}
        for axis, side in itertools.product(range(3), (-1, 1)):
            add(form, self.slope(level, cell, axis, side, composite), 1 / float(self.spacing[level][axis]))
        return form

    @found_once
    def field(self, level: int, cell: Cell, axis: int) -> Form:
        """Return E along an axis at the centre of an uncovered cell: minus the mean of the derivatives at its two faces."""
        form: Form = {}
        for side in (-1, 1):
            add(form, self.slope(level, cell, axis, side, composite=True), -side / 2)
        return form

    def correction(self, level: int, cell: Cell, kind: str) -> Form:
        """Return the interpolation from the coarser level into the cell, of functions with homogeneous boundary data."""
        above = parent(cell)
        if kind == "constant":
            return {Phi(level - 1, above): 1.0}
        assert kind == "trilinear", kind
        form: Form = {}
        for away in itertools.product((False, True), repeat=3):
            place, weight = above, 1.0
            for axis in range(3):
                weight *= 1 / 4 if away[axis] else 3 / 4
                if away[axis]:
                    side = 1 if cell[axis] % 2 else -1
                    place, factor = self.towards(level - 1, place, axis, side, above)
                    weight *= factor
            assert self.exists(level - 1, place), f"{place} of level {level - 1} is missing beside level {level}"
            if weight:
                add(form, {Phi(level - 1, place): weight})
        return form

    def towards(self, level: int, cell: Cell, axis: int, side: int, above: Cell) -> tuple[Cell, float]:
        """Return the neighbour and 1, or at a wall the cell itself and the homogeneous linear ghost factor (behind an open wall
        that of the parent, `above`)."""
        neighbour = self.wrapped(level, shifted(cell, axis, side))
        if neighbour is not None:
            return neighbour, 1.0
        kind = self.types[axis][0 if side < 0 else 1]
        if kind == "open":
            return cell, self.open_wall_factor(level, above, axis, side)
        return cell, {"dirichlet": -1.0, "neumann": 1.0}[kind]

    # --- matrices

    def size(self, level: int) -> int:
        return len(self.cells[level]) if 0 <= level < self.levels else 0

    def block(self, row_level: int, forms: Sequence[Form], column_level: int) -> sp.csr_matrix:
        """Return the part of the rows that acts on one level."""
        rows, columns, values = [], [], []
        for row, form in enumerate(forms):
            for key, weight in form.items():
                if isinstance(key, Phi) and key.level == column_level:
                    rows.append(row)
                    columns.append(self.column[column_level][key.cell])
                    values.append(weight)
        shape = (self.size(row_level), self.size(column_level))
        return sp.csr_matrix((np.array(values, dtype=float), (rows, columns)), shape=shape)

    def rows(self, level: int, row: Callable[[Cell], Form], where: str = "all") -> list[Form]:
        """Return one form per cell of the level, empty unless the cell is `where`: all, covered or uncovered."""
        wanted = {"all": (False, True), "covered": (True,), "uncovered": (False,)}[where]
        return [row(cell) if self.is_covered(level, cell) in wanted else {} for cell in self.cells[level]]

    def operators(self, level: int) -> SimpleNamespace:
        """Return the eight operators of a level as SciPy matrices, under the names of `solver.operators(level)`."""
        plain = self.rows(level, lambda cell: self.laplacian(level, cell, composite=False))
        whole = self.rows(level, lambda cell: self.laplacian(level, cell, composite=True), "uncovered")
        mean = self.rows(level, lambda cell: {Phi(level + 1, child): 1 / 8 for child in children(cell)}, "covered")
        return SimpleNamespace(
            no_fine=self.block(level, plain, level),
            composite=self.block(level, whole, level),
            coarse_boundary=self.block(level, plain, level - 1),
            fine_boundary=self.block(level, whole, level + 1),
            restriction=self.block(level, mean, level + 1),
            prolongation=self.prolongation(level, "trilinear"),
            uncovered=sp.diags(self.uncovered(level).astype(float)).tocsr(),
            gradient=[self.gradient(level, axis) for axis in range(3)],
        )

    def prolongation(self, level: int, kind: str) -> sp.csr_matrix:
        finer = self.rows(level, lambda cell: self.correction(level, cell, kind)) if level else []
        return self.block(level, finer, level - 1)

    def gradient(self, level: int, axis: int) -> SimpleNamespace:
        forms = self.rows(level, lambda cell: self.field(level, cell, axis), "uncovered")
        return SimpleNamespace(
            own=self.block(level, forms, level),
            coarse=self.block(level, forms, level - 1),
            fine=self.block(level, forms, level + 1),
        )

    def coverage(self) -> Counter[str]:
        """Return how many coarse-fine faces have each fit."""
        for level, cells in enumerate(self.cells):
            for cell, axis, side in itertools.product(cells, range(3), (-1, 1)):
                self.beyond(level, cell, axis, side)
        return Counter(self.interfaces.values())

    def fits_of(self, level: int, cell: Cell) -> set[str]:
        """Return the names of the fits which the composite stencil of an uncovered cell uses."""
        names: set[str] = set()
        for axis, side in itertools.product(range(3), (-1, 1)):
            neighbour = self.wrapped(level, shifted(cell, axis, side))
            if neighbour is None:
                continue
            faces = [(level, cell, side)]
            if self.is_covered(level, neighbour):
                faces = [(level + 1, child, -side) for child in children(neighbour)]
            for at_level, at_cell, at_side in faces:
                self.beyond(at_level, at_cell, axis, at_side)
                names |= {
                    self.interfaces[face]
                    for face in [Wall(at_level, at_cell, axis, at_side)]
                    if face in self.interfaces
                }
        return names

    # --- boundary data

    def datum(self, wall: Wall, data: BoundaryData) -> float:
        """Return the datum of a physical face: at the face centre, or for open faces at the ghost's centre."""
        kind = self.types[wall.axis][0 if wall.side < 0 else 1]
        distance = 1.0 if kind == "open" else 0.5
        place = self.centre(wall.level, wall.cell)
        place[wall.axis] += wall.side * distance * self.spacing[wall.level][wall.axis]
        if kind == "neumann":
            return data.slope(*place, wall.axis) * wall.side
        return data.value(*place)

    def known(self, forms: Sequence[Form], data: BoundaryData) -> np.ndarray:
        """Return what the rows take from the boundary data."""
        total = np.zeros(len(forms))
        for row, form in enumerate(forms):
            total[row] = sum(w * self.datum(key, data) for key, w in form.items() if isinstance(key, Wall))
        return total

    def laplacian_of_data(self, level: int, data: BoundaryData) -> np.ndarray:
        """Return what the Laplacian rows of a level (all of them) take from the boundary data."""
        return self.known(self.rows(level, lambda cell: self.laplacian(level, cell, composite=False)), data)

    def field_of_data(self, level: int, axis: int, data: BoundaryData) -> np.ndarray:
        return self.known(self.rows(level, lambda cell: self.field(level, cell, axis), "uncovered"), data)


class BoundaryData(NamedTuple):
    """Data at physical faces: `value(x, y, z)` for Dirichlet and open, `slope(x, y, z, axis)` = dphi/dx_axis for Neumann."""

    value: Callable[..., float] = lambda x, y, z: 0.0
    slope: Callable[..., float] = lambda x, y, z, axis: 0.0


# --- the whole composite problem ------------------------------------------------------------------------------------


class CompositeSystem:
    """The equation `matrix @ phi = f - known` for the uncovered cells of all levels, one level after the other."""

    def __init__(self, oracle: Oracle, data: BoundaryData) -> None:
        self.oracle, self.data = oracle, data
        self.levels = range(oracle.levels)
        self.uncovered = [oracle.uncovered(level) for level in self.levels]
        self.unknown = self.number()
        self.means = [self.mean_rows(level) for level in self.levels]
        kept = [oracle.laplacian(level, cell, composite=True) for level, cell in self.unknown]
        self.matrix = self.assemble(kept)
        self.known = oracle.known(kept, data)
        self.volumes = np.concatenate([np.full(m.sum(), oracle.volume(n)) for n, m in enumerate(self.uncovered)])
        self.singular = all(kind in ("neumann", "periodic") for types in oracle.types for kind in types)

    def number(self) -> dict[Phi, int]:
        oracle = self.oracle
        keys = [Phi(n, c) for n in self.levels for c in oracle.cells[n] if not oracle.is_covered(n, c)]
        return {key: row for row, key in enumerate(keys)}

    def in_unknowns(self, level: int, cell: Cell) -> dict[int, float]:
        """Return phi of any cell by the unknowns: a covered cell holds the mean of its children."""
        if Phi(level, cell) in self.unknown:
            return {self.unknown[Phi(level, cell)]: 1.0}
        total: dict[int, float] = defaultdict(float)
        for child in children(cell):
            for column, weight in self.in_unknowns(level + 1, child).items():
                total[column] += weight / 8
        return total

    def assemble(self, forms: Sequence[Form]) -> sp.csr_matrix:
        rows, columns, values = [], [], []
        for row, form in enumerate(forms):
            for key, weight in form.items():
                if isinstance(key, Phi):
                    for column, share in self.in_unknowns(*key).items():
                        rows.append(row)
                        columns.append(column)
                        values.append(weight * share)
        return sp.csr_matrix((values, (rows, columns)), shape=(len(forms), len(self.unknown)))

    def mean_rows(self, level: int) -> sp.csr_matrix:
        """Return the matrix from the unknowns to all cells of a level."""
        return self.assemble([{Phi(level, cell): 1.0} for cell in self.oracle.cells[level]])

    def spread(self, unknowns: np.ndarray) -> list[np.ndarray]:
        """Return the values of all cells per level; covered cells hold the mean of their children."""
        return [mean @ unknowns for mean in self.means]

    def gather(self, values: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([v[mask] for v, mask in zip(values, self.uncovered, strict=True)])

    def mean(self, unknowns: np.ndarray) -> float:
        return float(self.volumes @ unknowns / self.volumes.sum())

    def solve(self, f: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return phi on all cells per level, for the right-hand side f per level (covered entries are ignored).

        In a singular problem the mean of the right-hand side is taken off and phi has zero mean.
        """
        rhs = self.gather(f) - self.known
        if not self.singular:
            return self.spread(spsolve(self.matrix.tocsc(), rhs))
        ones = np.ones((len(rhs), 1))
        scale = (
            1 / min(float(h.min()) for h in self.oracle.spacing) ** 2
        )  # as large as the matrix, for the pivots' sake
        bordered = sp.bmat([[self.matrix, scale * ones], [scale * self.volumes[None, :] / self.volumes.sum(), None]])
        return self.spread(spsolve(bordered.tocsc(), np.append(rhs, 0.0))[:-1])

    def field(self, phi: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return E on all cells per level, (n, 3); covered cells hold the mean of their children."""
        components = [self.component(phi, axis) for axis in range(3)]
        return [np.stack([component[level] for component in components], axis=1) for level in self.levels]

    def component(self, phi: Sequence[np.ndarray], axis: int) -> list[np.ndarray]:
        values = [self.oracle.field_of_data(level, axis, self.data) for level in self.levels]
        for level in self.levels:
            blocks = self.oracle.gradient(level, axis)
            values[level] += blocks.own @ phi[level]
            if level > 0:
                values[level] += blocks.coarse @ phi[level - 1]
            if level + 1 < self.oracle.levels:
                values[level] += blocks.fine @ phi[level + 1]
        return self.spread(self.gather(values))


def composite_system(hierarchy: Any, data: BoundaryData | None = None) -> CompositeSystem:
    """Return the composite system of an `amrpic.Hierarchy` (or of an `Oracle`) with its boundary data, zero by default."""
    oracle = hierarchy if isinstance(hierarchy, Oracle) else Oracle.of(hierarchy)
    return CompositeSystem(oracle, data or BoundaryData())
