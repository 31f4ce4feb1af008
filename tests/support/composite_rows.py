# mypy: disable-error-code="arg-type, call-overload, misc"
"""An independent oracle for conductors on several levels: the composite equations, written from what docs/theory.md says
("Conductors"), and solved directly.

A quantity is a row of a sparse matrix over all values: those of the cells of all levels, covered ones too, of the electrodes,
and one that is 1, for what walls hold. In the end covered cells are replaced by the means of their children, and cells in metal
by its voltage. Fits in narrow gaps come from `oracle`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.constants import epsilon_0
from scipy.sparse.linalg import splu

from amrpic import Domain, Electrode
from cut_rows import ZERO, Array, Metal, curvature, weights
from gap_charges import charges_at_gaps
from oracle import PLACEMENTS, Oracle, Phi, lagrange

FAR = 1e9  # the arm to an end that is nowhere
TO_FINE, TO_COARSE = 0.75, 1.5  # from a centre to those behind a face between levels, along its normal
SHORTEST = 0.25  # arm from which alone a slope is taken
Boxes = Sequence[tuple[Sequence[int], Sequence[int]]]


@dataclass
class Level:
    """What a level has; arrays are over all cells (x, y, z) that it would have in the whole domain."""

    shape: tuple[int, ...]
    spacing: Array  # m, not stretched
    metal: Metal
    exists: Array
    covered: Array
    first: int  # number of the value of its first cell

    def numbers(self, cells: Array) -> Array:
        return self.first + np.ravel_multi_index(tuple(cells.T), self.shape)


@dataclass
class Terms:
    """Rows of a sparse matrix, under way."""

    shape: tuple[int, int]
    parts: list[tuple[Array, Array, Array]] = field(default_factory=list)

    def add(self, row: Array, column: Array | int, weight: Array | float) -> None:
        self.parts.append((row, np.broadcast_to(column, row.shape), np.broadcast_to(weight, row.shape)))

    def matrix(self) -> sp.csr_matrix:
        row, column, weight = (np.concatenate([np.empty(0, int), *part]) for part in zip(*self.parts, strict=True))
        return sp.csr_matrix((weight, (row, column)), shape=self.shape)


class Ends(NamedTuple):
    """The ends of the arms of n cells towards a side."""

    length: Array  # (n,) of the spacing
    owner: Array  # (n,) electrode, or -1
    value: sp.csr_matrix  # (n, values)


class Interface(NamedTuple):
    """The n cells of a level that lie before coarser ones on a side."""

    place: Array  # (x, y, z) which of the n a cell is, or -1
    linked: Array  # (n,) whether the coarse cell is seen past metal
    length: Array  # (n,) of arms that end on metal instead; FAR where it is not on their line
    owner: Array  # (n,) of that metal
    ghost: sp.csr_matrix  # (n, values)


def at(values: Array, cells: Array) -> Array:
    """Return values (..., x, y, z) of cells (n, 3)."""
    return values[(..., *cells.T)]


class CompositeRows:
    """The equations of all cells of a domain with refined `boxes` (lower, upper) per level, and electrodes.

    Dirichlet faces hold `values`, Neumann ones `flux`; `screening` is in 1/m.
    """

    def __init__(
        self,
        domain: Domain,
        boxes: Sequence[Boxes],
        electrodes: Sequence[Electrode],
        values: Callable[..., float] = ZERO,
        flux: Callable[..., float] = ZERO,
        stretch: Sequence[float] = (1, 1, 1),
        screening: float = 0.0,
    ) -> None:
        self.domain, self.boxes, self.electrodes = domain, boxes, electrodes
        self.values, self.flux, self.screening = values, flux, screening
        self.stretch = np.array(stretch, float)
        self.levels = self._levels()
        self.first_metal = sum(int(np.prod(level.shape)) for level in self.levels)
        self.one = self.first_metal + len(electrodes)
        self._gaps: Oracle | None = None
        self.interfaces = {
            (n, axis, side): self._interface(n, axis, side)
            for n, axis, side in itertools.product(range(1, len(self.levels)), range(3), range(2))
        }
        self.own = [np.argwhere(level.exists & ~level.covered & (level.metal.solid < 0)) for level in self.levels]
        self.shared: dict[tuple[int, int, int], tuple[Array, Array, Array]] = {}  # faces that metal has a share of
        self.ends = [self._ends(n) for n in range(len(self.levels))]
        self.in_unknowns = self._in_unknowns()
        of_levels = [
            charges_at_gaps(domain, level.shape, electrodes, values, self.stretch, level.exists, level.covered)
            for level in self.levels
        ]
        # (electrodes, electrodes and the one that is 1)
        self.at_gaps = np.sum([np.column_stack(of_level) for of_level in of_levels], axis=0)

    # --- where cells and metal are

    def _levels(self) -> list[Level]:
        out: list[Level] = []
        first = 0
        for n in range(len(self.boxes) + 1):
            shape = tuple(int(count) << n for count in self.domain.cells)
            exists, covered = np.full(shape, n == 0), np.zeros(shape, bool)
            for lower, upper in self.boxes[n - 1] if n > 0 else ():
                exists[tuple(slice(a, b + 1) for a, b in zip(lower, upper, strict=True))] = True
            for lower, upper in self.boxes[n] if n < len(self.boxes) else ():
                covered[tuple(slice(a // 2, b // 2 + 1) for a, b in zip(lower, upper, strict=True))] = True
            spacing = np.array(self.domain.spacing) / 2**n
            out.append(Level(shape, spacing, Metal.on(self.domain, shape, self.electrodes), exists, covered, first))
            first += int(np.prod(shape))
        return out

    def _next(self, n: int, cells: Array, axis: int, by: int) -> tuple[Array, Array]:
        """Return the cells beside some, those behind periodic faces as what they are images of, and which lie behind walls."""
        out, extent = cells.copy(), self.levels[n].shape[axis]
        out[:, axis] += by
        outside = (out[:, axis] < 0) | (out[:, axis] >= extent)
        out[:, axis] %= extent
        return out, outside & (not self.domain.periodic[axis])

    def _usable(self, n: int, cells: Array, outside: Array) -> Array:
        level = self.levels[n]
        return ~outside & at(level.exists & ~level.covered, cells)

    # --- faces between levels

    def _interface(self, n: int, axis: int, side: int) -> Interface:
        level, coarser = self.levels[n], self.levels[n - 1]
        step = 1 if side else -1
        cells = np.argwhere(level.exists)
        ghosts, outside = self._next(n, cells, axis, step)
        before = ~outside & ~at(level.exists, ghosts)
        cells, ghosts = cells[before], ghosts[before]
        place = np.full(level.shape, -1)
        place[tuple(cells.T)] = np.arange(len(cells))
        linked, length, owner = self._seen(n, axis, side, cells, ghosts)
        coarse = ghosts // 2
        # what makes a face another one: any of its four cells cut or not linked, or metal at the coarse cell
        face = np.ravel_multi_index(tuple(coarse.T), coarser.shape)
        odd = np.unique(face[level.metal.is_near(cells) | ~linked])
        is_odd = np.isin(face, odd) | coarser.metal.is_near(coarse)
        star = self._stars(n, axis, ghosts, side, is_odd, linked)
        cut_inside = level.metal.is_cut(cells, axis, 1 - side)
        second, _ = self._next(n, cells, axis, -step)
        share = np.where(cut_inside, 2 / 3, 8 / 15)
        rest = Terms(star.shape)
        rows = np.arange(len(cells))
        rest.add(rows, level.numbers(cells), np.where(cut_inside, 1 / 3, 2 / 3))
        rest.add(rows, level.numbers(second), np.where(cut_inside, 0, -1 / 5))
        return Interface(place, linked, length, owner, sp.diags(share, shape=(len(cells),) * 2) @ star + rest.matrix())

    def _seen(self, n: int, axis: int, side: int, cells: Array, ghosts: Array) -> tuple[Array, Array, Array]:
        """Return which cells see the coarse one behind the ghost, and where the arms of others end, on which electrode."""
        fine, coarse = self.levels[n].metal, self.levels[n - 1].metal
        parents = ghosts // 2
        u, v = (a for a in range(3) if a != axis)
        # from the ghost half a cell towards the coarse centre, from there a quarter of the way back
        towards = [(d, np.where(ghosts[:, d] % 2 == 0, 1, 0)) for d in (u, v)]
        there = [*towards, (axis, np.full(len(cells), side))]
        back = [(d, 1 - s) for d, s in there]
        on = at(coarse.solid, parents)
        on = np.where(on < 0, fine.between(ghosts, there, 0.5), on)
        on = np.where(on < 0, coarse.between(parents, back, 0.25), on)
        behind = fine.is_cut(ghosts, axis, side)
        length = np.where(behind, 1 + at(fine.theta[axis, side], ghosts), FAR)
        owner = np.where((on >= 0) & behind, at(fine.owner[axis, side], ghosts), on)
        own = fine.is_cut(cells, axis, side)
        length = np.where(own, at(fine.theta[axis, side], cells), length)
        owner = np.where(own, at(fine.owner[axis, side], cells), owner)
        solid = at(fine.solid, cells)
        owner = np.where(solid >= 0, solid, owner)
        return owner < 0, length, owner

    def _stars(self, n: int, axis: int, ghosts: Array, side: int, is_odd: Array, linked: Array) -> sp.csr_matrix:
        """Return phi* (cells, values), at the places of ghosts in the plane of the coarse cells behind them."""
        coarser = self.levels[n - 1]
        u, v = (a for a in range(3) if a != axis)
        coarse = ghosts // 2
        out = Terms((len(ghosts), self.one + 1))
        near = {}
        for i, j in itertools.product(range(-2, 3), repeat=2):
            step_u, behind_u = self._next(n - 1, coarse, u, i)
            cell, behind_v = self._next(n - 1, step_u, v, j)
            near[i, j] = cell, self._usable(n - 1, cell, behind_u | behind_v)
        left, complete = np.ones(len(ghosts), bool), np.zeros(len(ghosts), bool)
        for _, columns, rows in PLACEMENTS:
            whole = np.logical_and.reduce([near[i, j][1] for i in columns for j in rows])
            complete |= whole
            clean = np.ones(len(ghosts), bool)
            for i, j in itertools.product(columns, rows):
                cell = near[i, j][0]
                clean &= at(coarser.metal.solid, cell) < 0
                clean &= ~coarser.metal.is_cut(cell, u, 1) | (i == columns[-1])
                clean &= ~coarser.metal.is_cut(cell, v, 1) | (j == rows[-1])
            chosen = np.flatnonzero(whole & clean & left)
            left[chosen] = False
            along = [self._lagrange(nodes, ghosts[chosen, d]) for nodes, d in ((columns, u), (rows, v))]
            for (p, i), (q, j) in itertools.product(enumerate(columns), enumerate(rows)):
                out.add(chosen, coarser.numbers(near[i, j][0][chosen]), along[0][p] * along[1][q])
        in_gap = left & ~complete & ~is_odd & ~self._metal_around(n - 1, coarse)
        for row in np.flatnonzero(in_gap & linked):
            for key, weight in self._gap_fit(n, tuple(ghosts[row]), axis, 2 * side - 1).items():
                out.add(np.array([row]), self.levels[key.level].numbers(np.array([key.cell])), weight)
        self._add_slopes(out, n, np.flatnonzero(left & ~in_gap & linked), ghosts, coarse, (u, v))
        return out.matrix()

    @staticmethod
    def _lagrange(nodes: tuple[int, ...], ghost: Array) -> Array:
        """Return the weights (3, n) of nodes at a quarter of a coarse cell below or above the middle."""
        both = np.array([[float(w) for w in lagrange(nodes, Fraction(s, 4))] for s in (-1, 1)])
        return both[ghost % 2].T

    def _metal_around(self, n: int, cells: Array) -> Array:
        """Return whether metal is in, or cuts an arm of, the cells or one of the 26 around each."""
        out = np.zeros(len(cells), bool)
        for steps in itertools.product((-1, 0, 1), repeat=3):
            there, outside = cells, np.zeros(len(cells), bool)
            for axis, by in enumerate(steps):
                there, behind = self._next(n, there, axis, by)
                outside = outside | behind
            out |= ~outside & self.levels[n].metal.is_near(there)
        return out

    def _gap_fit(self, n: int, ghost: tuple[int, ...], axis: int, step: int) -> dict:
        if self._gaps is None:
            lower, upper = self.domain.lower * self.stretch, self.domain.upper * self.stretch
            domain = SimpleNamespace(
                lower=lower, upper=upper, cells=self.domain.cells, boundary=[tuple(f) for f in self.domain.boundary]
            )
            base = [((0, 0, 0), tuple(int(c) - 1 for c in self.domain.cells))]
            self._gaps = Oracle(domain, [[(*a, *b) for a, b in level] for level in (base, *self.boxes)])
        form = self._gaps.fit_in_gap(n, tuple(map(int, ghost)), axis, step)[1]
        return {key: weight for key, weight in form.items() if isinstance(key, Phi)}

    def _add_slopes(self, out: Terms, n: int, rows: Array, ghosts: Array, coarse: Array, axes: tuple[int, int]) -> None:
        """Add the value of the coarse cell, and its slopes between what ends its arms in the plane."""
        coarser, cells = self.levels[n - 1], coarse[rows]
        out.add(rows, coarser.numbers(cells), 1.0)
        for d in axes:
            arm, number = np.zeros((2, len(rows))), np.zeros((2, len(rows)), int)
            for side in range(2):
                there, outside = self._next(n - 1, cells, d, 1 if side else -1)
                usable = self._usable(n - 1, there, outside)
                cut = coarser.metal.is_cut(cells, d, side)
                arm[side] = np.where(cut, at(coarser.metal.theta[d, side], cells), usable)
                surface = self.first_metal + at(coarser.metal.owner[d, side], cells)
                number[side] = np.where(cut, surface, coarser.numbers(there))
            both = (arm > 0).all(axis=0)
            length = np.where(both, arm.sum(axis=0), np.maximum(arm.max(axis=0), SHORTEST))
            shift = (ghosts[rows, d] % 2 - 0.5) / 2
            for side, sign in ((0, -1), (1, 1)):
                weight = np.where(arm[side] > 0, sign * shift / length, 0.0)
                out.add(rows, number[side], weight)
                out.add(rows, coarser.numbers(cells), np.where(both, 0.0, -weight))

    # --- what is at the ends of arms

    def _ends(self, n: int) -> list[list[Ends]]:
        """Return the ends of arms by axis and side."""
        pairs = [[self._towards(n, axis, side) for side in range(2)] for axis in range(3)]
        # where metal on no line would drop all three axes, arms end as far away as the centres of the cells behind the faces
        away = np.array([[end.length == FAR for end in pair] for pair in pairs])  # (3, 2, cells)
        dropped = away.any(axis=1).all(axis=0)
        for axis, side in itertools.product(range(3), range(2)):
            length = pairs[axis][side].length
            behind, _ = self._next(n, self.own[n], axis, 1 if side else -1)
            to_centre = np.where(at(self.levels[n].covered, behind), TO_FINE, TO_COARSE)
            length[:] = np.where(dropped & away[axis, side], to_centre, length)
        for axis, side in itertools.product(range(3), range(2)):
            self._add_wall(n, axis, side, pairs[axis][side], pairs[axis][1 - side].owner >= 0)
        return [[Ends(end.length, end.owner, end.value.matrix()) for end in pair] for pair in pairs]

    def _towards(self, n: int, axis: int, side: int) -> Ends:
        """Return what ends arms, walls still to come."""
        level, cells = self.levels[n], self.own[n]
        rows = np.arange(len(cells))
        out = Ends(np.ones(len(cells)), np.full(len(cells), -1), Terms((len(cells), self.one + 1)))
        cut = level.metal.is_cut(cells, axis, side)
        out.length[cut] = at(level.metal.theta[axis, side], cells[cut])
        out.owner[cut] = at(level.metal.owner[axis, side], cells[cut])
        beyond, outside = self._next(n, cells, axis, 1 if side else -1)
        finer = ~outside & at(level.covered, beyond)
        coarser = ~outside & ~at(level.exists, beyond)
        if finer.any():
            self._add_finer(out, n, axis, side, rows[finer], beyond[finer])
        if coarser.any():
            self._add_coarser(out, self.interfaces[n, axis, side], rows[coarser], cells[coarser])
        inside = ~outside & ~finer & ~coarser & (out.owner < 0)
        out.value.add(rows[inside], level.numbers(beyond[inside]), 1.0)
        metal = out.owner >= 0
        out.value.add(rows[metal], self.first_metal + out.owner[metal], 1.0)
        return out

    def _add_coarser(self, out: Ends, face: Interface, rows: Array, cells: Array) -> None:
        which = at(face.place, cells)
        ends = ~face.linked[which]
        out.length[rows[ends]], out.owner[rows[ends]] = face.length[which[ends]], face.owner[which[ends]]
        ghost = face.ghost[which[~ends]].tocoo()
        out.value.parts.append((rows[~ends][ghost.row], ghost.col, ghost.data))

    def _add_finer(self, out: Ends, n: int, axis: int, side: int, rows: Array, beyond: Array) -> None:
        """Let the difference across a face that finer cells share be twice the mean of those of linked ones."""
        face, level, own = self.interfaces[n + 1, axis, 1 - side], self.levels[n], self.own[n]
        u, v = (a for a in range(3) if a != axis)
        child = np.repeat(2 * beyond[None], 4, axis=0)
        for number, (b, a) in enumerate(itertools.product(range(2), repeat=2)):
            child[number, :, axis] += 1 - side
            child[number, :, u] += a
            child[number, :, v] += b
        which = at(face.place, child.reshape(-1, 3)).reshape(4, -1)
        linked = face.linked[which]
        links, last = linked.sum(axis=0), np.full(len(rows), -1)
        for number in range(4):
            last = np.where(linked[number], last, face.owner[which[number]])
        uncut = out.owner[rows] < 0
        out.length[rows] = np.where(links > 0, 1.0, np.where(uncut, FAR, out.length[rows]))
        out.owner[rows] = np.where(links > 0, -1, np.where(uncut, last, out.owner[rows]))
        some = rows[links > 0]
        out.value.add(some, level.numbers(own[some]), 1.0)
        for number in range(4):
            on = linked[number]
            out.value.add(rows[on], self.levels[n + 1].numbers(child[number, on]), 2 / links[on])
            ghost = (sp.diags(-2 / links[on], shape=(on.sum(),) * 2) @ face.ghost[which[number, on]]).tocoo()
            out.value.parts.append((rows[on][ghost.row], ghost.col, ghost.data))
        self.shared[n, axis, side] = rows, np.where(links > 0, 1 - links / 4, 0.0), last

    def _add_wall(self, n: int, axis: int, side: int, out: Ends, is_opposite_cut: Array) -> None:
        level, step = self.levels[n], 1 if side else -1
        inward, _ = self._next(n, self.own[n], axis, -step)
        _, outside = self._next(n, self.own[n], axis, step)
        rows = np.flatnonzero(outside & (out.owner < 0))
        cells, opposite = self.own[n][rows], is_opposite_cut[rows]
        place = self.centres(n, cells)
        place[:, axis] += step * level.spacing[axis] / 2
        if self.domain.boundary[axis][side] == "neumann":
            out.value.add(rows, level.numbers(cells), 1.0)
            out.value.add(rows, self.one, self.flux(*place.T) * level.spacing[axis])
            return
        # a parabola through the wall and two cells, or through the wall, the cell and what ends its other arm
        out.length[rows[opposite]] = 0.5
        out.value.add(rows, self.one, np.where(opposite, 1.0, 8 / 3) * self.values(*place.T))
        out.value.add(rows, level.numbers(cells), np.where(opposite, 0.0, -2.0))
        out.value.add(rows, level.numbers(inward[rows]), np.where(opposite, 0.0, 1 / 3))

    def centres(self, n: int, cells: Array) -> Array:
        """Return the centres (m, 3) of cells, m."""
        return np.asarray(self.domain.lower) + (cells + 0.5) * self.levels[n].spacing

    # --- equations

    def _in_unknowns(self) -> sp.csr_matrix:
        """Return all values by those of fluid cells, of electrodes, and the one that is 1."""
        count = sum(map(len, self.own))
        width = count + len(self.electrodes) + 1
        parts: list[sp.csr_matrix] = []
        first = count
        for level, own in zip(reversed(self.levels), reversed(self.own), strict=True):
            first -= len(own)
            size = int(np.prod(level.shape))
            known = Terms((size, width))
            known.add(level.numbers(own) - level.first, first + np.arange(len(own)), 1.0)
            solid = np.argwhere(level.exists & ~level.covered & (level.metal.solid >= 0))
            known.add(level.numbers(solid) - level.first, count + at(level.metal.solid, solid), 1.0)
            part = known.matrix()
            if parts:
                parents = np.argwhere(level.covered)
                means = Terms((size, parts[0].shape[0]))
                for by in itertools.product(range(2), repeat=3):
                    child = np.ravel_multi_index(tuple((2 * parents + by).T), tuple(2 * c for c in level.shape))
                    means.add(level.numbers(parents) - level.first, child, 1 / 8)
                part = part + means.matrix() @ parts[0]
            parts.insert(0, part)
        more = sp.hstack([sp.csr_matrix((width - count, count)), sp.identity(width - count)])
        return sp.vstack([*parts, more]).tocsr()

    def _rows(self, n: int, axis: int, factors: Array) -> sp.csr_matrix:
        """Return what factors (3, cells) of lower end, centre and upper end make of a level's cells, of unknowns."""
        lower, upper = self.ends[n][axis]
        own = Terms(lower.value.shape)
        own.add(np.arange(len(self.own[n])), self.levels[n].numbers(self.own[n]), factors[1])
        ends = [
            sp.diags(factors[2 * side], shape=(len(self.own[n]),) * 2) @ end.value
            for side, end in enumerate((lower, upper))
        ]
        return (ends[0] + own.matrix() + ends[1]) @ self.in_unknowns

    def _lengths(self, n: int, axis: int) -> tuple[Array, Array]:
        lower, upper = self.ends[n][axis]
        return lower.length, upper.length

    def _laplacian(self) -> sp.csr_matrix:
        levels = []
        for n, level in enumerate(self.levels):
            h = level.spacing * self.stretch
            rows = [self._rows(n, d, curvature(*self._lengths(n, d)) / h[d] ** 2) for d in range(3)]
            levels.append(sum(rows[1:], rows[0]))
        out = sp.vstack(levels).tocsr()
        return out - self.screening**2 * sp.eye(*out.shape, format="csr")

    def _fluxes(self, n: int, axis: int, side: int) -> sp.csr_matrix:
        """Return ε₀ times the flux of E into each cell of a level through a face, C, of unknowns."""
        factors = weights(*self._lengths(n, axis), at=-1.0 if side == 0 else 1.0)
        factors[1] -= 1
        spacing = self.levels[n].spacing
        area = epsilon_0 * np.prod(spacing) / (spacing[axis] * self.stretch[axis]) ** 2
        return self._rows(n, axis, factors * area)

    def _charges(self) -> sp.csr_matrix:
        """Return the charges on electrodes as sums of unknowns."""
        count = len(self.electrodes)
        cells = self.in_unknowns.shape[1] - self.at_gaps.shape[1]
        out = sp.hstack([sp.csr_matrix((count, cells)), sp.csr_matrix(self.at_gaps)])
        for n, axis, side in itertools.product(range(len(self.levels)), range(3), range(2)):
            owner = self.ends[n][axis][side].owner
            cut, to = np.flatnonzero(owner >= 0), Terms((count, len(owner)))
            to.add(owner[cut], cut, 1.0)
            if (n, axis, side) in self.shared:
                rows, share, last = self.shared[n, axis, side]
                to.add(last[share > 0], rows[share > 0], share[share > 0])
            out = out + to.matrix() @ self._fluxes(n, axis, side)
        return out.tocsr()

    def solve(self, rho: Sequence[Array]) -> CompositeSolution:
        """Return the solution for charge densities (x, y, z) per level, C/m³."""
        count = sum(map(len, self.own))
        whole = self._laplacian()
        f = np.concatenate([-at(values, own) for values, own in zip(rho, self.own, strict=True)]) / epsilon_0
        floats = np.array([e.floats for e in self.electrodes])
        voltages = np.array([0.0 if e.floats else e.voltage_at(0.0) for e in self.electrodes])
        rest = np.append(voltages, 1.0)  # those that float are zero there
        imaged = self.charge_in_metal(rho)
        matrix, right = whole[:, :count], f - whole[:, count:] @ rest
        charges = self._charges()
        if floats.any():
            wanted = np.array([e.charge for e in self.electrodes if e.floats]) + imaged[floats]
            columns = count + np.flatnonzero(floats)
            below = charges[floats]
            matrix = sp.bmat([[matrix, whole[:, columns]], [below[:, :count], below[:, columns]]])
            right = np.append(right, wanted - below[:, count:] @ rest)
        scale = 1 / abs(matrix).max(axis=1).toarray().ravel()
        factors = splu((sp.diags(scale) @ matrix).tocsc())
        found = factors.solve(scale * right)
        found += factors.solve(scale * (right - matrix @ found))
        voltages[floats] = found[count:]
        return CompositeSolution(self, np.concatenate([found[:count], voltages, [1.0]]), charges, imaged)

    def charge_in_metal(self, rho: Sequence[Array]) -> Array:
        """Return the charge in the cells of each electrode, C: it is imaged there, and acts on nothing outside."""
        out = np.zeros(len(self.electrodes))
        for values, level in zip(rho, self.levels, strict=True):
            inside = level.exists & ~level.covered & (level.metal.solid >= 0)
            np.add.at(out, level.metal.solid[inside], values[inside] * np.prod(level.spacing))
        return out


class CompositeSolution:
    """The potential of fluid cells and of electrodes, and what follows."""

    def __init__(self, rows: CompositeRows, unknowns: Array, charges: sp.csr_matrix, imaged: Array) -> None:
        self.rows, self.unknowns, self._charges, self.imaged = rows, unknowns, charges, imaged

    @property
    def phi(self) -> list[Array]:
        """Of the uncovered cells outside metal, level by level, in the order of `rows.own`, V."""
        return np.split(self.unknowns, np.cumsum([len(own) for own in self.rows.own]))[:-1]

    @property
    def voltages(self) -> Array:
        return self.unknowns[-1 - len(self.rows.electrodes) : -1]

    def charges(self) -> Array:
        """On the electrodes, C, those included that image the charge in their cells."""
        return self._charges @ self.unknowns - self.imaged

    def efield(self, axis: int) -> list[Array]:
        """A component of E at those cells, V/m."""
        rows, out = self.rows, []
        for n, level in enumerate(rows.levels):
            slope = rows._rows(n, axis, weights(*rows._lengths(n, axis), at=None))
            out.append(-(slope @ self.unknowns) / (level.spacing[axis] * rows.stretch[axis] ** 2))
        return out

    def through_walls(self) -> float:
        """ε₀ times the flux of E into the domain through its walls, C."""
        rows = self.rows
        total = -float((rows.at_gaps @ self.unknowns[-rows.at_gaps.shape[1] :]).sum())
        for n, axis, side in itertools.product(range(len(rows.levels)), range(3), range(2)):
            if not rows.domain.periodic[axis]:
                end = 0 if side == 0 else rows.levels[n].shape[axis] - 1
                wall = (rows.own[n][:, axis] == end) & (rows.ends[n][axis][side].owner < 0)
                total += float((rows._fluxes(n, axis, side) @ self.unknowns)[wall].sum())
        return total
