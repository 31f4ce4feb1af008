"""The operators between the cells of a hierarchy's levels, as sparse matrices to look at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from .. import _native
from ..errors import SolverError
from .hierarchy import Hierarchy


@dataclass(frozen=True)
class CompositeOperator:
    """One sparse operator between the cells of two levels; in the native module, or `entries` of its own."""

    hierarchy: Hierarchy
    shape: tuple[int, int]
    entries: tuple[np.ndarray, np.ndarray, np.ndarray]  # this rank's rows: row starts, global columns, values
    source: tuple[_native.LevelOperators, str, int] | None = None
    first_column: int = 0  # of this rank's cells of the column level, where there is no source

    def to_scipy(self) -> scipy.sparse.csr_array | None:
        """The whole operator on rank 0, None elsewhere; rows and columns in the order of the levels' cells. Collective."""
        parts = self.hierarchy.comm.gather(self.entries, root=0)
        if parts is None:
            return None
        lengths = np.concatenate([np.diff(start) for start, _, _ in parts])
        start = np.concatenate([[0], np.cumsum(lengths)])
        columns = np.concatenate([column for _, column, _ in parts])
        values = np.concatenate([value for _, _, value in parts])
        return scipy.sparse.csr_array((values, columns, start), shape=self.shape)

    def multiply(self, values: np.ndarray) -> np.ndarray:
        """This rank's part of the operator times `values`, its cells of the column level, by Tpetra. Collective."""
        if self.source is None:
            start, columns, own = self.entries
            local = scipy.sparse.csr_array(
                (own, columns - self.first_column, start), shape=(len(start) - 1, len(values))
            )
            return local @ values
        operators, name, axis = self.source
        return operators.multiply(name, axis, np.ascontiguousarray(values))


@dataclass(frozen=True)
class GradientAxis:
    """One component of E = −∇φ: own φ_l + coarse φ_{l−1} + fine φ_{l+1}, in uncovered cells."""

    own: CompositeOperator
    coarse: CompositeOperator
    fine: CompositeOperator


class LevelOperators:
    """The eight operators of a level; operators towards a level that does not exist have no columns."""

    def __init__(self, solver: _native.PoissonSolver, hierarchy: Hierarchy, level: int) -> None:
        self.hierarchy, self.level = hierarchy, level
        if not _native.trilinos_version():
            raise SolverError("operators as matrices need Trilinos, and amrpic was built without it")
        self._native = _native.operators_of(solver, level)
        self._coarse = _native.operators_of(solver, level - 1) if level > 0 else None
        self._fine = _native.operators_of(solver, level + 1) if level + 1 < self.hierarchy.levels else None

    @property
    def no_fine(self) -> CompositeOperator:
        """Laplacian of the level as if nothing finer existed; in covered cells, which hold corrections alone, what lies
        behind an open wall vanishes where the finest level's ghosts are."""
        return self._operator("no_fine", self._native)

    @property
    def composite(self) -> CompositeOperator:
        """Laplacian in uncovered cells, with the fluxes of the finer level."""
        return self._operator("composite", self._native)

    @property
    def coarse_boundary(self) -> CompositeOperator:
        """What the ghost cells of the level take from the next coarser one."""
        return self._operator("coarse_boundary", self._coarse)

    @property
    def fine_boundary(self) -> CompositeOperator:
        """What the mean fine fluxes take from the next finer level."""
        return self._operator("fine_boundary", self._fine)

    @property
    def restriction(self) -> CompositeOperator:
        """Mean of the children, in rows of covered cells."""
        return self._operator("restriction", self._fine)

    @property
    def prolongation(self) -> CompositeOperator:
        """Values from the next coarser level."""
        return self._operator("prolongation", self._coarse)

    @property
    def uncovered(self) -> CompositeOperator:
        """1 on the diagonal where no finer level covers the cell."""
        ones = self._native.uncovered().astype(bool)
        start = np.concatenate([[0], np.cumsum(ones)])
        columns = self._native.first_row + np.flatnonzero(ones)
        size = self._native.rows
        entries = start, columns, np.ones(len(columns))
        return CompositeOperator(self.hierarchy, (size, size), entries, first_column=self._native.first_row)

    @property
    def gradient(self) -> tuple[GradientAxis, ...]:
        """E = −∇φ along x, y and z."""
        return tuple(
            GradientAxis(
                self._operator("gradient_own", self._native, axis),
                self._operator("gradient_coarse", self._coarse, axis),
                self._operator("gradient_fine", self._fine, axis),
            )
            for axis in range(3)
        )

    def _operator(self, name: str, columns: _native.LevelOperators | None, axis: int = 0) -> CompositeOperator:
        if columns is None:
            empty = np.zeros(self._native.local_rows + 1, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
            return CompositeOperator(self.hierarchy, (self._native.rows, 0), empty)
        shape = self._native.rows, columns.rows
        entries = self._native.rows_of(name, columns, axis)
        return CompositeOperator(self.hierarchy, shape, entries, (self._native, name, axis))
