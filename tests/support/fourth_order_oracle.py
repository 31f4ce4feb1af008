"""An independent oracle for the fourth-order operator, cell by cell: rows over the uncovered cells, for SciPy.

A form is a dictionary of weights, of `(level, cell)`, the mean of an uncovered cell, and of `("wall", level, cell, axis,
side)`, the mean of the datum over a wall's face. Polynomials come from NumPy's least squares through what is known of them.
"""

from __future__ import annotations

import itertools
from collections import Counter
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp

Form = Counter
FLUX = {-2: -1 / 12, -1: 15 / 12, 0: -15 / 12, 1: 1 / 12}  # outwards: of the cells 2 and 1 inside, then 1 and 2 outside


def _monomials(known: tuple[Any, ...], degree: int) -> np.ndarray:
    """A mean over (a, b), a value at ("value", x), a slope at ("slope", x), of each power up to a degree."""
    rows = []
    for what in known:
        powers = [np.poly1d([1.0] + [0.0] * k) for k in range(degree + 1)]
        if what[0] == "value":
            rows.append([p(what[1]) for p in powers])
        elif what[0] == "slope":
            rows.append([p.deriv()(what[1]) for p in powers])
        else:
            a, b = what
            rows.append([(p.integ()(b) - p.integ()(a)) / (b - a) for p in powers])
    return np.array(rows)


@cache
def polynomial(known: tuple[Any, ...], asked: tuple[float, float]) -> np.ndarray:
    """The weights of what is known in the mean over an interval of the polynomial through all of it."""
    degree = len(known) - 1
    return np.linalg.lstsq(_monomials(known, degree).T, _monomials((asked,), degree)[0], rcond=None)[0]


class Oracle:
    """The rows of a hierarchy's operator, +Δ less a shift, in 1/m²."""

    def __init__(self, hierarchy: Any, shift: float = 0.0) -> None:
        self.h, self.shift, self.domain = hierarchy, shift, hierarchy.domain
        self.cells: list[set[tuple[int, ...]]] = []
        for level in range(hierarchy.levels):
            found: set[tuple[int, ...]] = set()
            for box in hierarchy.boxes(level):
                found.update(itertools.product(*(range(box[d], box[3 + d] + 1) for d in range(3))))
            self.cells.append(found)
        self.extent = [tuple(n * 2**level for n in self.domain.cells) for level in range(hierarchy.levels)]
        self._mean = cache(self._mean)  # type: ignore[method-assign]

    def kind(self, axis: int, side: int) -> str:
        return self.domain.boundary[axis][side]

    def place(self, level: int, cell: tuple[int, ...]) -> tuple[int, ...] | None:
        """The cell inside the domain, itself or an image; None behind a wall."""
        out = []
        for d, (i, n) in enumerate(zip(cell, self.extent[level], strict=True)):
            if not 0 <= i < n and self.kind(d, 0) != "periodic":
                return None
            out.append(i % n)
        return tuple(out)

    def has(self, level: int, cell: tuple[int, ...]) -> bool:
        place = self.place(level, cell)
        return place is not None and place in self.cells[level]

    def covered(self, level: int, cell: tuple[int, ...]) -> bool:
        return level + 1 < len(self.cells) and tuple(2 * i for i in cell) in self.cells[level + 1]

    def _mean(self, level: int, cell: tuple[int, ...]) -> Form:
        """The mean of a cell of the level: its own, or that of its children."""
        if not self.covered(level, cell):
            return Form({(level, cell): 1.0})
        out: Form = Form()
        for child in itertools.product((0, 1), repeat=3):
            add(out, self._mean(level + 1, tuple(2 * i + c for i, c in zip(cell, child, strict=True))), 1 / 8)
        return out

    def mean(self, level: int, cell: tuple[int, ...]) -> Form:
        place = self.place(level, cell)
        assert place is not None
        return self._mean(level, place)

    def along(self, cell: tuple[int, ...], axis: int, n: int) -> tuple[int, ...]:
        return tuple(i + (n if d == axis else 0) for d, i in enumerate(cell))

    def beyond(self, level: int, cell: tuple[int, ...], axis: int, side: int, layer: int) -> Form:
        """The mean `layer` = 1 or 2 cells beyond the face of a cell, whatever lies there. `side`: -1 or 1."""
        there = self.along(cell, axis, side * layer)
        if self.has(level, there):
            return self.mean(level, there)
        first = cell  # the last cell of the level before the end
        while self.has(level, self.along(first, axis, side)):
            first = self.along(first, axis, side)
        depth = layer - abs(first[axis] - cell[axis])
        asked = (float(-depth), float(1 - depth))
        inside = [first]
        while len(inside) < 4 and self.has(level, self.along(inside[-1], axis, -side)):
            inside.append(self.along(inside[-1], axis, -side))
        out: Form = Form()
        if self.place(level, self.along(first, axis, side)) is None:
            kind = self.kind(axis, (side + 1) // 2)
            cells = inside[: 3 if kind == "dirichlet" else 4]
            known = (
                *((float(n), n + 1.0) for n in range(len(cells))),
                ("value" if kind == "dirichlet" else "slope", 0.0),
            )
            weights = polynomial(known, asked)
            for c, w in zip(cells, weights, strict=False):
                add(out, self.mean(level, c), w)
            width = 1.0 if kind == "dirichlet" else -self.h.spacing(level)[axis]
            out[("wall", level, self.place(level, first), axis, side)] += weights[-1] * width
            return out
        layers = self.coarse_layers(level, first, axis, side)
        fine = inside[:3]
        known = (
            *((-2.0 * n - 2, -2.0 * n) for n in range(len(layers))),
            *((float(n), n + 1.0) for n in range(len(fine))),
        )
        weights = polynomial(known, asked)
        for form, w in zip([*layers, *(self.mean(level, c) for c in fine)], weights, strict=True):
            add(out, form, w)
        return out

    def coarse_layers(self, level: int, cell: tuple[int, ...], axis: int, side: int) -> list[Form]:
        """Coarse means, over the face of a fine cell, of the first layer behind it, and of the second where it serves."""
        behind = tuple(i // 2 for i in self.along(cell, axis, side))
        u, v = (d for d in range(3) if d != axis)
        found, sizes = [], []
        for layer in (0, 1):
            middle = self.along(behind, axis, side * layer)
            size, block = self.block(level - 1, middle, u, v)
            form: Form = Form()
            weights = {}
            for d, first in ((u, block[0]), (v, block[1])):
                if size:
                    known = tuple((first + n - 0.5, first + n + 0.5) for n in range(size))
                    weights[d] = polynomial(known, (0.0, 0.5) if cell[d] % 2 else (-0.5, 0.0))
            for i, j in itertools.product(range(size), repeat=2):
                at = self.along(self.along(middle, u, block[0] + i), v, block[1] + j)
                add(form, self.mean(level - 1, at), weights[u][i] * weights[v][j])
            found.append(form)
            sizes.append(size)
        return found if sizes[1] >= min(sizes[0], 4) else found[:1]

    def block(self, level: int, middle: tuple[int, ...], u: int, v: int) -> tuple[int, tuple[int, int]]:
        """The largest block of cells of the level around one of them, and where it starts: its middle is the nearest one."""
        for size in (5, 4, 3, 2, 1):
            starts = sorted(
                itertools.product(range(1 - size, 1), repeat=2),
                key=lambda s, size=size: (sum((2 * i + size - 1) ** 2 for i in s), s[1], s[0]),
            )
            for a, b in starts:
                block = itertools.product(range(a, a + size), range(b, b + size))
                if all(self.has(level, self.along(self.along(middle, u, i), v, j)) for i, j in block):
                    return size, (a, b)
        return 0, (0, 0)

    def flux(self, level: int, cell: tuple[int, ...], axis: int, side: int) -> Form:
        """The mean derivative of φ over a face, outwards."""
        width = self.h.spacing(level)[axis]
        beyond = self.along(cell, axis, side)
        out: Form = Form()
        if self.has(level, beyond) and self.covered(level, self.place(level, beyond)) and not self.covered(level, cell):
            u, v = (d for d in range(3) if d != axis)
            for i, j in itertools.product((0, 1), repeat=2):
                fine = [2 * n for n in self.place(level, beyond)]
                fine[axis] += (1 - side) // 2
                fine[u] += i
                fine[v] += j
                add(out, self.flux(level + 1, tuple(fine), axis, -side), -1 / 4)
            return out
        for n, weight in FLUX.items():
            if n < 0 and self.has(level, self.along(cell, axis, side * (n + 1))):
                form = self.mean(level, self.along(cell, axis, side * (n + 1)))
            elif n < 0:
                form = self.beyond(level, cell, axis, -side, -n - 1)
            else:
                form = self.beyond(level, cell, axis, side, n + 1)
            # FLUX counts from the face: -1 the cell itself, -2 the one inside, 0 and 1 those beyond
            add(out, form, -weight / width)
        return out

    def row(self, level: int, cell: tuple[int, ...]) -> Form:
        out: Form = Form({(level, cell): -self.shift})
        for axis, side in itertools.product(range(3), (-1, 1)):
            add(out, self.flux(level, cell, axis, side), 1 / self.h.spacing(level)[axis])
        return out

    def leaves(self) -> list[tuple[int, tuple[int, ...]]]:
        """The uncovered cells, level by level, box by box, x fastest."""
        out = []
        for level in range(self.h.levels):
            for box in self.h.boxes(level):
                for k, j, i in itertools.product(*(range(box[d], box[3 + d] + 1) for d in (2, 1, 0))):
                    if not self.covered(level, (i, j, k)):
                        out.append((level, (i, j, k)))
        return out

    def matrix(self) -> tuple[sp.csr_array, dict[tuple, sp.coo_array], list]:
        """L over the uncovered cells, and the weights of the walls' data, by wall, as columns; and these cells."""
        leaves = self.leaves()
        number = {leaf: n for n, leaf in enumerate(leaves)}
        entries: list[tuple[int, int, float]] = []
        data: dict[tuple, list[tuple[int, float]]] = {}
        for n, leaf in enumerate(leaves):
            for what, weight in self.row(*leaf).items():
                if what[0] == "wall":
                    data.setdefault(what, []).append((n, weight))
                else:
                    entries.append((n, number[what], weight))
        rows, columns, values = zip(*entries, strict=True)
        return sp.csr_array((values, (rows, columns)), shape=(len(leaves),) * 2), data, leaves


def add(form: Form, other: Form, weight: float) -> None:
    for what, value in other.items():
        form[what] += weight * value
