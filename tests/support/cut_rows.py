# mypy: disable-error-code="arg-type, call-overload, misc"
"""An independent oracle for conductors: the equations of one level, written from what they say, and solved directly.

Along each axis the potential of a cell lies on a parabola through its own value and those at the ends of its two arms, which
are the centres of its neighbours, or the first surface on the way: metal at some share of the arm, or a wall half-way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.constants import epsilon_0
from scipy.sparse.linalg import splu

from amrpic import Domain, Electrode
from gap_charges import charges_at_gaps

Array = np.ndarray
TOUCH = 1e-9  # of an arm: a surface that is nearer to a centre has it in its metal
ZERO: Callable[..., float] = lambda *_: 0.0  # noqa: E731


def weights(lower: Array, upper: Array, at: float | None) -> Array:
    """Return the factors (3, n) of values at -lower, 0 and upper: the parabola through them at a place, or its slope at 0."""
    nodes = np.stack([-lower, np.zeros_like(lower), upper])
    out = np.empty_like(nodes)
    for n in range(3):
        one, other = (nodes[m] for m in range(3) if m != n)
        bottom = (nodes[n] - one) * (nodes[n] - other)
        out[n] = -(one + other) / bottom if at is None else (at - one) * (at - other) / bottom
    return out


def curvature(lower: Array, upper: Array) -> Array:
    """Return the factors (3, n) of values at -lower, 0 and upper of the second derivative of the parabola."""
    whole = lower + upper
    return np.stack([2 / (lower * whole), -2 / (lower * upper), 2 / (upper * whole)])


@dataclass(frozen=True)
class Metal:
    """Where metal is in a domain of some cells (x, y, z)."""

    solid: Array  # (x, y, z) electrode in which a centre lies, or -1
    theta: Array  # (3, 2, x, y, z) lengths of arms to the first surface; inf where there is none
    owner: Array  # (3, 2, x, y, z) electrode that cuts an arm, or -1

    @classmethod
    def on(cls, domain: Domain, shape: Sequence[int], electrodes: Sequence[Electrode]) -> Metal:
        out = cls(np.full(shape, -1), np.full((3, 2, *shape), np.inf), np.full((3, 2, *shape), -1))
        spacing = np.subtract(domain.upper, domain.lower) / shape
        for number, electrode in reversed(list(enumerate(electrodes))):
            for axis in range(3):
                out._trace(number, electrode, axis, np.asarray(domain.lower), spacing)
        for axis, side in ((axis, side) for axis in range(3) for side in range(2)):
            out._end_arms(axis, side, domain.periodic[axis])
        return out

    def _trace(self, number: int, electrode: Electrode, axis: int, lower: Array, spacing: Array) -> None:
        u, v = (a for a in range(3) if a != axis)
        shape = self.solid.shape
        centres = [lower[a] + (np.arange(shape[a]) + 0.5) * spacing[a] for a in range(3)]
        grid = np.zeros((shape[u], shape[v], 3))
        grid[..., u], grid[..., v] = np.meshgrid(centres[u], centres[v], indexing="ij")
        spans = electrode.shape.spans(grid.reshape(-1, 3), axis)
        x, h = centres[axis], spacing[axis]
        for line, enter, leave in zip(spans.line, spans.enter, spans.leave, strict=True):
            i, j = np.unravel_index(line, grid.shape[:2])
            at = [slice(None)] * 3
            at[u], at[v] = i, j
            inside = (x >= enter - TOUCH * h) & (x <= leave + TOUCH * h)
            self.solid[tuple(at)][inside] = number
            for side, way in ((1, (enter - x) / h), (0, (x - leave) / h)):
                theta, owner = self.theta[(axis, side, *at)], self.owner[(axis, side, *at)]
                nearer = (way > 0) & (way <= 1 + TOUCH) & (way <= theta) & ~inside
                theta[nearer], owner[nearer] = np.minimum(way, 1)[nearer], number

    def _end_arms(self, axis: int, side: int, is_periodic: bool) -> None:
        """Cut arms at centres in metal where rounding hides the surface; none behind walls."""
        theta, owner = self.theta[axis, side], self.owner[axis, side]
        beyond = np.roll(self.solid, 1 if side == 0 else -1, axis)
        edge = [slice(None)] * 3
        edge[axis] = 0 if side == 0 else -1
        if not is_periodic:
            beyond[tuple(edge)] = -1
        late = (beyond >= 0) & ~(theta <= 1)
        theta[late], owner[late] = 1.0, beyond[late]
        if not is_periodic:
            behind = theta[tuple(edge)] >= 0.5
            theta[tuple(edge)][behind], owner[tuple(edge)][behind] = np.inf, -1
        inside = self.solid >= 0
        theta[inside], owner[inside] = np.inf, -1

    def is_cut(self, cells: Array, axis: int, side: int) -> Array:
        """Whether arms of cells (n, 3) are cut."""
        return self.owner[(axis, side, *cells.T)] >= 0

    def is_near(self, cells: Array) -> Array:
        """Whether cells are in metal, or any of their arms is cut."""
        return (self.solid[tuple(cells.T)] >= 0) | (self.owner[(..., *cells.T)] >= 0).any(axis=(0, 1))

    def between(self, cells: Array, sides: Sequence[tuple[int, Array]], away: float) -> Array:
        """Return the electrode whose surface, a plane through the ends of a cell's cut arms, passes between the centre and a
        place that is `away` along sides of the three axes; -1 if none does."""
        total, nearest, out = np.zeros(len(cells)), np.full(len(cells), 2.0), np.full(len(cells), -1)
        for axis, side in sides:
            own = (axis, side, *cells.T)
            arm, owner = self.theta[own], self.owner[own]
            opposite, is_opposite = self.theta[(axis, 1 - side, *cells.T)], self.owner[(axis, 1 - side, *cells.T)] >= 0
            with np.errstate(divide="ignore"):
                total += np.where(owner >= 0, away / arm, np.where(is_opposite, -away / opposite, 0.0))
            closer = (owner >= 0) & (arm < nearest)
            nearest, out = np.where(closer, arm, nearest), np.where(closer, owner, out)
        return np.where(total >= 1, out, -1)


class CutRows:
    """The equations of all cells (x, y, z) of a domain with electrodes; `values` on Dirichlet faces, `flux` on Neumann ones."""

    def __init__(
        self,
        domain: Domain,
        electrodes: Sequence[Electrode],
        values: Callable[..., float] = ZERO,
        flux: Callable[..., float] = ZERO,
        stretch: Sequence[float] = (1, 1, 1),
    ) -> None:
        self.domain, self.electrodes, self.shape = domain, electrodes, tuple(domain.cells)
        self.values, self.flux, self.stretch = values, flux, np.array(stretch, float)
        self.spacing = np.array(domain.spacing)
        metal = Metal.on(domain, self.shape, electrodes)
        self.solid, self.theta, self.owner = metal.solid, metal.theta, metal.owner
        self.fluid = self.solid < 0
        self.number = np.full(self.shape, -1)
        self.number[self.fluid] = np.arange(self.fluid.sum())
        self.cells = np.argwhere(self.fluid)
        self.arms = [self._ends(axis) for axis in range(3)]
        self.at_gaps = charges_at_gaps(domain, self.shape, electrodes, values, self.stretch)

    def points(self) -> Array:
        """Return the centres of fluid cells (n, 3)."""
        return np.array(self.domain.lower) + (self.cells + 0.5) * self.spacing

    # --- what is at the ends of arms

    def _ends(self, axis: int) -> tuple[Array, Array, Array, Array]:
        """Return per side and fluid cell: length of the arm (2, n), which cell is at its end (-1: none), which electrode (-1:
        none), and what is known there: a potential, or the change up to the end of a Neumann face (cell itself there)."""
        n = len(self.cells)
        length, cell = np.ones((2, n)), np.empty((2, n), int)
        electrode, known = np.full((2, n), -1), np.zeros((2, n))
        last = self.shape[axis] - 1
        for side, step in ((0, -1), (1, 1)):
            beyond = self.cells.copy()
            beyond[:, axis] += step
            theta = self.theta[axis, side][self.fluid]
            owner = self.owner[axis, side][self.fluid]
            ends = self.cells[:, axis] == (0 if side == 0 else last)
            kind = self.domain.boundary[axis][side]
            beyond[:, axis] %= last + 1
            cell[side] = self.number[tuple(beyond.T)]
            cut = theta <= 1
            if kind != "periodic":
                wall = ends & ~cut
                place = self.points()[wall]
                place[:, axis] += step * self.spacing[axis] / 2
                if kind == "neumann":
                    cell[side][wall] = np.flatnonzero(wall)
                    known[side][wall] = self.flux(*place.T) * self.spacing[axis]
                else:
                    length[side][wall], cell[side][wall] = 0.5, -1
                    known[side][wall] = self.values(*place.T)
            length[side][cut], cell[side][cut], electrode[side][cut] = theta[cut], -1, owner[cut]
        return length, cell, electrode, known

    def _operator(self, axis: int, factors: Array) -> tuple[sp.csr_matrix, sp.csr_matrix, Array]:
        """Return what factors (3, n) of lower end, centre and upper end make: of cells, of electrodes, and what is known."""
        _, cell, electrode, known = self.arms[axis]
        n, rows = len(self.cells), np.arange(len(self.cells))
        of_cells = sp.diags(factors[1], shape=(n, n)).tocsr()
        of_metal, of_data = sp.csr_matrix((n, len(self.electrodes))), np.zeros(n)
        for side in range(2):
            factor = factors[2 * side]
            there, metal = cell[side] >= 0, electrode[side] >= 0
            of_cells += sp.csr_matrix((factor[there], (rows[there], cell[side][there])), shape=of_cells.shape)
            of_metal += sp.csr_matrix((factor[metal], (rows[metal], electrode[side][metal])), shape=of_metal.shape)
            of_data += factor * known[side]
        return of_cells, of_metal, of_data

    # --- equations

    def solve(self, rho: Array | None = None, time: float = 0.0) -> Solution:
        """Return the solution for a charge density (x, y, z), C/m³."""
        h = self.spacing * self.stretch
        sums = [self._operator(axis, curvature(*self.arms[axis][0]) / h[axis] ** 2) for axis in range(3)]
        of_cells, of_metal, of_data = (sum(parts[1:], parts[0]) for parts in zip(*sums, strict=True))
        f = np.zeros(len(self.cells)) if rho is None else -rho[self.fluid] / epsilon_0
        floats = [n for n, e in enumerate(self.electrodes) if e.floats]
        voltages = np.array([0.0 if e.floats else e.voltage_at(time) for e in self.electrodes])
        imaged = self.charge_in_metal(rho)
        right = f - of_data - of_metal @ voltages
        matrix = of_cells
        if floats:
            cells, metal, data = self._charges()
            wanted = np.array([self.electrodes[n].charge for n in floats]) + imaged[floats]
            unit = epsilon_0 * min(self.spacing)
            below = [cells[floats] / unit, metal[floats][:, floats] / unit]
            matrix = sp.bmat([[of_cells, of_metal[:, floats]], below])
            right = np.append(right, (wanted - data[floats] - metal[floats] @ voltages) / unit)
        # rows of short arms are large; pivots want them of one size
        scale = 1 / abs(matrix).max(axis=1).toarray().ravel()
        factors = splu((sp.diags(scale) @ matrix).tocsc())
        phi = factors.solve(scale * right)
        phi += factors.solve(scale * (right - matrix @ phi))
        voltages[floats] = phi[len(self.cells) :]
        return Solution(self, phi[: len(self.cells)], voltages, imaged)

    def charge_in_metal(self, rho: Array | None) -> Array:
        """Return the charge in the cells of each electrode, C: it is imaged there, and acts on nothing outside."""
        volume = np.prod(self.spacing)
        return np.array(
            [0.0 if rho is None else rho[self.solid == n].sum() * volume for n in range(len(self.electrodes))]
        )

    def _fluxes(self, axis: int, side: int) -> tuple[sp.csr_matrix, sp.csr_matrix, Array]:
        """Return ε₀ times the flux of E into each cell through a face, C: of cells, of electrodes, and what is known."""
        factors = weights(*self.arms[axis][0], at=-1.0 if side == 0 else 1.0)
        factors[1] -= 1
        area = np.prod(self.spacing) / (self.spacing * self.stretch**2)[axis] / self.spacing[axis] * epsilon_0
        return self._operator(axis, factors * area)

    def _charges(self) -> tuple[sp.csr_matrix, sp.csr_matrix, Array]:
        """Return the charges on electrodes as sums: of cells, of electrodes, and what is known."""
        count, n = len(self.electrodes), len(self.cells)
        out = [sp.csr_matrix((count, n)), sp.csr_matrix(self.at_gaps[0]), self.at_gaps[1]]
        for axis in range(3):
            for side in range(2):
                owner = self.arms[axis][2][side]
                cut = np.flatnonzero(owner >= 0)
                to = sp.csr_matrix((np.ones(len(cut)), (owner[cut], cut)), shape=(count, n))
                out = [old + to @ part for old, part in zip(out, self._fluxes(axis, side), strict=True)]
        return out[0].tocsr(), out[1].tocsr(), np.asarray(out[2])


class Solution:
    """The potential of fluid cells and of electrodes, and what follows."""

    def __init__(self, rows: CutRows, phi: Array, voltages: Array, imaged: Array) -> None:
        self.rows, self.fluid, self.voltages, self.imaged = rows, phi, voltages, imaged

    @property
    def phi(self) -> Array:
        """On all cells (x, y, z), V; in metal its voltage."""
        rows = self.rows
        out = np.append(self.voltages, 0.0)[rows.solid]
        out[rows.fluid] = self.fluid
        return out

    def charges(self) -> Array:
        """On the electrodes, C, those included that image the charge in their cells."""
        cells, metal, data = self.rows._charges()
        return cells @ self.fluid + metal @ self.voltages + data - self.imaged

    def efield(self, axis: int) -> Array:
        """A component of E (x, y, z), V/m; zero in metal."""
        rows = self.rows
        factors = weights(*rows.arms[axis][0], at=None)
        cells, metal, data = rows._operator(axis, factors)
        out = np.zeros(rows.shape)
        scale = -1 / (rows.spacing * rows.stretch**2)[axis]
        out[rows.fluid] = scale * (cells @ self.fluid + metal @ self.voltages + data)
        return out

    def through_walls(self) -> float:
        """ε₀ times the flux of E into the domain through its walls, C."""
        rows = self.rows
        of_metal, of_walls = rows.at_gaps
        total = -float((of_metal @ self.voltages + of_walls).sum())
        for axis in range(3):
            _, cell, electrode, _ = rows.arms[axis]
            for side in range(2):
                if rows.domain.boundary[axis][side] == "periodic":
                    continue
                ends = rows.cells[:, axis] == (0 if side == 0 else rows.shape[axis] - 1)
                wall = ends & (electrode[side] < 0)
                cells, metal, data = rows._fluxes(axis, side)
                total += float((cells @ self.fluid + metal @ self.voltages + data)[wall].sum())
        return total
