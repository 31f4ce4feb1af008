"""Laws that the operators of any hierarchy obey, as measured defects; they hold for the oracle and for the native code.

`operators` is a list with the eight operators of each level as SciPy matrices; the oracle serves as geometry.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence, Set
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from oracle import BoundaryData, Oracle, Phi

Operators = Sequence[SimpleNamespace]
Values = Sequence[np.ndarray]  # one array per level


class Polynomial(NamedTuple):
    """phi = 1 + linear . x + x . quadratic . x / 2, with the quadratic part symmetric."""

    linear: np.ndarray
    quadratic: np.ndarray

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return 1 + x @ self.linear + np.einsum("...i,ij,...j", x, self.quadratic, x) / 2

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return self.linear + x @ self.quadratic

    @property
    def laplacian(self) -> float:
        return float(np.trace(self.quadratic))

    def data(self) -> BoundaryData:
        return BoundaryData(
            lambda x, y, z: float(self(np.array([x, y, z]))),
            lambda x, y, z, axis: float(self.gradient(np.array([x, y, z]))[axis]),
        )


def random_polynomial(oracle: Oracle, degree: int, seed: int = 1) -> Polynomial:
    """Return a polynomial of degree 1 or 2 in the coordinates that are not periodic."""
    rng = np.random.default_rng(seed)
    free = np.array([types[0] != "periodic" for types in oracle.types], dtype=float)
    square = rng.normal(size=(3, 3)) * (degree - 1)
    return Polynomial(rng.normal(size=3) * free, (square + square.T) * np.outer(free, free))


def random_values(oracle: Oracle, seed: int = 2) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.normal(size=oracle.size(level)) for level in range(oracle.levels)]


def applied(own: sp.sparray, coarse: sp.sparray, fine: sp.sparray, phi: Values, level: int) -> np.ndarray:
    """Return what three blocks of rows make of phi on their own, the coarser and the finer level."""
    total = own @ phi[level]
    if level > 0:
        total = total + coarse @ phi[level - 1]
    if level + 1 < len(phi):
        total = total + fine @ phi[level + 1]
    return total


def laplacian(operators: Operators, phi: Values, level: int) -> np.ndarray:
    """Return the composite Laplacian of phi; only entries of uncovered cells have a meaning."""
    op = operators[level]
    return applied(op.composite, op.coarse_boundary, op.fine_boundary, phi, level)


def field(operators: Operators, phi: Values, level: int, axis: int) -> np.ndarray:
    op = operators[level].gradient[axis]
    return applied(op.own, op.coarse, op.fine, phi, level)


def gauss_defect(oracle: Oracle, operators: Operators) -> float:
    """Return by how much the Laplacian of a random phi, integrated over the composite grid, misses the flux through the
    walls, relative to the sum of magnitudes of the integrand."""
    phi = random_values(oracle)
    parts = [oracle.volume(n) * laplacian(operators, phi, n)[oracle.uncovered(n)] for n in range(oracle.levels)]
    integrand = np.concatenate(parts)
    return float(abs(integrand.sum() - wall_flux(oracle, phi)) / np.abs(integrand).sum())


def wall_flux(oracle: Oracle, phi: Values) -> float:
    """Return the flux of phi out of the domain with homogeneous boundary data."""
    total = 0.0
    for level, cells in enumerate(oracle.cells):
        for cell, axis, side in itertools.product(cells, range(3), (-1, 1)):
            at_wall = cell[axis] == (0 if side < 0 else oracle.extent[level][axis] - 1)
            if at_wall and oracle.types[axis][0] != "periodic" and not oracle.is_covered(level, cell):
                form = oracle.slope(level, cell, axis, side, composite=True)
                slope = sum(
                    w * phi[k.level][oracle.column[k.level][k.cell]] for k, w in form.items() if isinstance(k, Phi)
                )
                total += slope * oracle.volume(level) / float(oracle.spacing[level][axis])
    return total


def rows_with_fits(oracle: Oracle, level: int, fits: Set[str]) -> np.ndarray:
    """Return which cells are uncovered and use no interface interpolation but the given ones."""
    return np.array([not oracle.is_covered(level, c) and oracle.fits_of(level, c) <= fits for c in oracle.cells[level]])


def exactness_defects(oracle: Oracle, operators: Operators, degree: int, fits: Set[str]) -> dict[str, float]:
    """Return the worst error of the Laplacian and of E for a polynomial with its boundary data, in rows that use only the
    given fits, relative to the largest entry of the operator times the largest value; and the number of rows."""
    exact = random_polynomial(oracle, degree)
    phi = [exact(oracle.centres(level)) for level in range(oracle.levels)]
    size = max(float(np.abs(values).max(initial=0.0)) for values in phi)
    defects = {"laplacian": 0.0, "field": 0.0, "rows": 0.0}
    for level in range(oracle.levels):
        rows = rows_with_fits(oracle, level, fits)
        h = float(oracle.spacing[level].min())
        error = laplacian(operators, phi, level) + oracle.laplacian_of_data(level, exact.data()) - exact.laplacian
        defects["laplacian"] = max(defects["laplacian"], float(np.abs(error[rows]).max(initial=0.0)) * h**2 / size)
        for axis in range(3):
            error = field(operators, phi, level, axis) + oracle.field_of_data(level, axis, exact.data())
            error += exact.gradient(oracle.centres(level))[:, axis]
            defects["field"] = max(defects["field"], float(np.abs(error[rows]).max(initial=0.0)) * h / size)
        defects["rows"] += rows.sum()
    return defects


def constant_defect(oracle: Oracle, operators: Operators) -> float:
    """Return the largest result of Laplacian and gradient for a constant phi, relative to their largest entries.

    Zero is due where no wall fixes the potential.
    """
    ones = [np.ones(oracle.size(level)) for level in range(oracle.levels)]
    worst = 0.0
    for level in range(oracle.levels):
        h = float(oracle.spacing[level].min())
        uncovered = oracle.uncovered(level)
        worst = max(worst, float(np.abs(laplacian(operators, ones, level)[uncovered]).max(initial=0.0)) * h**2)
        for axis in range(3):
            worst = max(worst, float(np.abs(field(operators, ones, level, axis)).max(initial=0.0)) * h)
    return worst


def transfer_defect(oracle: Oracle, operators: Operators) -> float:
    """Return the worst error of restriction, and of trilinear prolongation away from walls, for a linear phi."""
    exact = random_polynomial(oracle, 1)
    phi = [exact(oracle.centres(level)) for level in range(oracle.levels)]
    size = max(float(np.abs(values).max(initial=0.0)) for values in phi)
    worst = 0.0
    for level in range(1, oracle.levels):
        covered = ~oracle.uncovered(level - 1)
        down = (operators[level - 1].restriction @ phi[level] - phi[level - 1])[covered]
        index, extent = np.array(oracle.cells[level]), np.array(oracle.extent[level])
        inside = ((index > 0) & (index < extent - 1) | [t[0] == "periodic" for t in oracle.types]).all(axis=1)
        up = (operators[level].prolongation @ phi[level - 1] - phi[level])[inside]
        worst = max(worst, float(np.abs(down).max(initial=0.0)), float(np.abs(up).max(initial=0.0)))
    return worst / size
