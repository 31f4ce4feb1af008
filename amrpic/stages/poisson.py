"""The Poisson solver: charge density in, potential and electric field out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from scipy import sparse

from .. import _native
from ..errors import SolverError
from ..mesh.domain import BOUNDARIES
from ..mesh.field import Field, Function, VectorField
from ..mesh.hierarchy import Hierarchy
from ..parallel import together
from ..scene import solver_options

COVERED = ("mean", "difference")
SMALLEST = 1e-12  # tolerance that ends a solve to the discretization error, where the mesh makes none
DIRICHLET, NEUMANN = BOUNDARIES.index("dirichlet"), BOUNDARIES.index("neumann")


@dataclass(frozen=True)
class SolveReport:
    """How a solve went."""

    converged: bool  # the tolerance was met, or lies below the rounding floor and the floor was reached
    cycles: int
    residuals: list[float]  # before the first cycle and after each, relative to the right-hand side
    seconds: dict[str, float]  # per stage, of this rank
    reason: str  # why the solve stopped
    floor: float  # estimate of the relative residual that rounding alone leaves; 0 unless it was met
    discretization_error: float = 0.0  # estimate of the largest error of φ that the mesh makes, V; 0 unless asked for


class PoissonSolver:
    """Solves Δφ = −ρ/ε₀ over all levels of a hierarchy at once. Collective; set up once, solved many times.

    `tolerance` bounds the residual over the right-hand side (its boundary part included) in `norm`: "max", or "l1" or "l2"
    weighted by volume, over uncovered cells; `absolute_tolerance` bounds the residual itself, in V/m² (times m³ for "l1",
    m^1.5 for "l2"). With `tolerance="discretization"` a solve ends where the error left in φ is a tenth of what the mesh
    makes by an estimate: the Laplacian of each next coarser level, applied to φ, shows the truncation error, and one cycle
    with that the error of φ. `background="neutralizing"` takes the mean charge away where all faces are periodic or Neumann.
    With `stretch` = s the equation is Σ s_d⁻² ∂²φ/∂x_d² = −ρ/ε₀, and E_d = −s_d⁻² ∂φ/∂x_d: (1, 1, γ) gives φ and E of charge
    that moves along z with the Lorentz factor γ, as seen at rest; solved as a Poisson equation in coordinates s_d x_d.

    A cycle is a V-cycle over the refined levels, and an F-cycle over the base and the multigrid levels below it, of which the
    coarsest is solved exactly, with `sweeps` (before, after) of a smoother. Backend "matrix-free" loops over the rows of
    boxes, by `kernels` "tuned" for vector registers or "portable", Kokkos' team policies, slower on these processors; "crs"
    holds the operators as compressed rows, many times slower and larger, and offers the menu of smoothers, `prolongation`,
    `coarse_levels`, `bottom` methods and `krylov` accelerations. `amrpic.scene.solver_options` describes each choice. `reuse`
    is the `base_setup` of the solver of an earlier hierarchy on the same domain.

    Raises SolverError for an option out of range, or one that does not go with the others or the hierarchy.
    """

    def __init__(
        self,
        hierarchy: Hierarchy,
        tolerance: float | Literal["discretization"] = 1e-10,
        norm: str = "max",
        backend: str = "matrix-free",
        *,
        kernels: str = "tuned",
        absolute_tolerance: float = 0.0,
        smoother: str = "red-black",
        relaxation: float | None = None,
        sweeps: int | Sequence[int] = 2,
        prolongation: str = "trilinear",
        coarse_levels: int | None = None,
        bottom: str = "gmres",
        bottom_preconditioner: str | None = None,
        krylov: str = "none",
        max_cycles: int = 100,
        background: str | None = None,
        stretch: Sequence[float] = (1.0, 1.0, 1.0),
        reuse: BaseSetup | None = None,
    ) -> None:
        _one_of("norm", norm, get_args(solver_options.Norm))
        _one_of("backend", backend, get_args(solver_options.Backend))
        _one_of("kernels", kernels, get_args(solver_options.Kernels))
        _one_of("smoother", smoother, get_args(solver_options.Smoother))
        _one_of("prolongation", prolongation, get_args(solver_options.Prolongation))
        _one_of("bottom", bottom, get_args(solver_options.Bottom))
        if bottom_preconditioner is not None:
            _one_of("bottom_preconditioner", bottom_preconditioner, get_args(solver_options.BottomPreconditioner))
        _one_of("krylov", krylov, get_args(solver_options.Krylov))
        if background is not None:
            _one_of("background", background, ("neutralizing",))
        to_discretization = tolerance == "discretization"
        stopping = solver_options.stopping_refusal(tolerance, krylov)
        if to_discretization:
            tolerance = SMALLEST
        if isinstance(tolerance, str) or not 0 <= tolerance < 1:
            raise SolverError(
                f'tolerance is {tolerance!r}; give a number from 0 up to, not including, 1, or "discretization"'
            )
        if not 0 <= absolute_tolerance < np.inf:
            raise SolverError(f"absolute_tolerance is {absolute_tolerance} V/m²; give zero or a finite positive number")
        before_and_after = tuple(solver_options.both(sweeps))
        if len(before_and_after) != 2:
            raise SolverError(f"sweeps is {before_and_after}; give one number, or two, before and after")
        if relaxation is not None and not 0 < relaxation < 2:
            raise SolverError(f"relaxation is {relaxation}; give a number between 0 and 2")
        if max_cycles < 1:
            raise SolverError(f"max_cycles is {max_cycles}; give at least 1")
        if len(stretch) != 3 or not all(0 < s < solver_options.LARGEST_STRETCH for s in stretch):
            raise SolverError(
                f"stretch is {tuple(stretch)}; give three positive numbers below {solver_options.LARGEST_STRETCH:g}"
            )
        if coarse_levels is not None and coarse_levels < 0:
            raise SolverError(f"coarse_levels is {coarse_levels}; give zero or a positive number")
        wrong = (
            solver_options.refusal(smoother, relaxation, before_and_after, bottom, bottom_preconditioner) or stopping
        )
        choices = {
            "smoother": smoother,
            "prolongation": prolongation,
            "coarse_levels": coarse_levels,
            "bottom": bottom,
            "bottom_preconditioner": bottom_preconditioner,
            "krylov": krylov,
        }
        wrong = wrong or solver_options.backend_refusal(backend, choices)
        if wrong:
            raise SolverError(f"{wrong.option} is {wrong.found!r}, which {wrong.what}; {wrong.remedy}")
        options = _native.SolverOptions()
        options.backend = _choice(_native.Backend, backend)
        options.kernels = _choice(_native.Kernels, kernels)
        options.tolerance = tolerance
        options.to_discretisation = to_discretization
        options.absolute_tolerance = absolute_tolerance
        options.norm = getattr(_native.Norm, norm)
        options.smoother = _choice(_native.Smoother, smoother)
        options.pre_sweeps, options.post_sweeps = before_and_after
        options.relaxation = solver_options.RELAXATION[smoother] if relaxation is None else relaxation
        options.prolongation = getattr(_native.Prolongation, prolongation)
        if coarse_levels is not None:
            options.coarse_levels = min(coarse_levels, 100)  # more than any number of cells allows
        options.bottom = _choice(_native.Bottom, bottom)
        if bottom_preconditioner is not None:
            options.bottom_preconditioner = _choice(_native.BottomPreconditioner, bottom_preconditioner)
        options.krylov = _choice(_native.Krylov, krylov)
        options.max_cycles = int(max_cycles)
        options.neutralize = background is not None
        options.stretch = self.stretch = tuple(float(s) for s in stretch)
        self._base = hierarchy.comm, hierarchy.domain, bottom, bottom_preconditioner, self.stretch
        if reuse is not None and reuse.base != self._base:
            raise SolverError(
                "reuse comes from a solver of another domain, stretch or bottom; make this one without it"
            )
        self.hierarchy = hierarchy
        self._walls: tuple[Function | None, Function | None] | None = (None, None)  # whose values the walls hold
        try:
            self.native = _native.PoissonSolver(
                hierarchy.native, options, reuse.native if reuse is not None else _native.Reusable()
            )
        except _native.SolverError as refused:
            raise SolverError(str(refused)) from None

    def solve(
        self,
        rho: Field,
        guess: Field | None = None,
        boundary_values: Function | None = None,
        boundary_flux: Function | None = None,
    ) -> tuple[Field, SolveReport]:
        """Return the potential in V and how the solve went. Collective.

        `rho` is in C/m³; what it holds in covered cells is ignored. `guess` is a potential to start from.
        `boundary_values(x, y, z)` gives V on Dirichlet faces, `boundary_flux(x, y, z)` the outward derivative of φ in V/m on
        Neumann faces; both are called with arrays of face centres in m, and are zero by default.

        Check `report.converged`: an unconverged potential is returned as what it is. Raises SolverError for a charge that
        no potential can balance, for a right-hand side that is not finite, and for fields of another hierarchy.
        """
        self._require_home("rho", rho)
        if guess is not None:
            self._require_home("guess", guess)
        self._set_walls(boundary_values, boundary_flux)
        phi = guess.copy() if guess is not None else Field(self.hierarchy)
        phi.unit = "V"
        try:
            report = self.native.solve(rho.native, phi.native, guess is None)
        except _native.SolverError as refused:
            raise SolverError(str(refused)) from None
        return phi, SolveReport(
            report.converged,
            report.cycles,
            report.residuals,
            report.seconds,
            report.reason,
            report.floor,
            report.discretisation_error,
        )

    @property
    def base_setup(self) -> BaseSetup:
        """What the solver of another hierarchy on the same domain may `reuse`: the operators of levels that stay as they are
        between the same neighbours, the set-up of the bottom, if the coarsest level comes out the same, and the tables of
        free space. Operators go to the first that takes them."""
        return BaseSetup(self._base, self.native.reusable)

    def electric_field(self, phi: Field, covered: str = "mean") -> VectorField:
        """Return E = −∇φ in V/m at cell centres, from the fluxes through the cell faces; stretched as the equation. Collective.

        Walls count with the data of the latest solve. In cells that a finer level covers stands the mean of the children, or,
        for `covered="difference"`, the central difference of the mean potentials, as matched clouds need it (see `Clouds`).
        """
        return self._field(phi, covered).with_components()

    def deferred_field(self, phi: Field, covered: str = "mean") -> VectorField:
        """Return what `electric_field` would, with components that are made when they are asked for. Collective.

        Gather, push and the energy of the field do without them, in less memory and time. The field follows from `phi` as
        long as it lives, so `phi` is locked: its arrays are read-only from now on.
        """
        field = self._field(phi, covered)
        phi.lock()
        return field

    def _field(self, phi: Field, covered: str) -> VectorField:
        self._require_home("phi", phi)
        _one_of("covered", covered, COVERED)
        native = self.native.electric_field(phi.native, getattr(_native.CoveredField, covered))
        return VectorField.deferred(native, self.hierarchy, "V/m")

    def operators(self, level: int) -> LevelOperators:
        """The eight operators of a level, to look at. Collective at the first call."""
        return LevelOperators(self, self.hierarchy._checked(level))

    def _require_home(self, name: str, field: Field) -> None:
        if field.hierarchy is not self.hierarchy:
            raise SolverError(
                f"{name} lives on another hierarchy than the solver; make a solver for it, or carry it over"
            )

    def _set_walls(self, values: Function | None, flux: Function | None) -> None:
        if (values, flux) == (None, None) == self._walls:
            return  # all of it is zero already
        self._walls = None  # until all of them are set
        with together(self.hierarchy.comm, SolverError):
            for level in range(self.hierarchy.levels):
                kinds, axes, points = self.native.wall_faces(level)
                data = self.native.wall_data(level)
                for kind, function in ((DIRICHLET, values), (NEUMANN, flux)):
                    faces = kinds == kind
                    data[faces] = 0.0 if function is None else function(*points[faces].T)
                # the native side works in stretched coordinates
                data[kinds == NEUMANN] /= np.array(self.stretch)[axes[kinds == NEUMANN]]
        self._walls = values, flux


@dataclass(frozen=True)
class BaseSetup:
    """What a solver hands on to the next one on its domain."""

    base: tuple  # communicator, domain, bottom and its preconditioner, stretch
    native: _native.Reusable


def _choice(kind: Any, name: str) -> Any:
    """Return the member of a native enumeration."""
    return getattr(kind, name.replace("-", "_"))


def _one_of(name: str, value: str, allowed: Sequence[str]) -> None:
    if value not in allowed:
        raise SolverError(f"{name} is {value!r}; use one of {', '.join(allowed)}")


@dataclass(frozen=True)
class Operator:
    """One sparse operator between the cells of two levels; in the native module, or `entries` of its own."""

    hierarchy: Hierarchy
    shape: tuple[int, int]
    entries: tuple[np.ndarray, np.ndarray, np.ndarray]  # this rank's rows: row starts, global columns, values
    source: tuple[_native.LevelOperators, str, _native.LevelOperators, int] | None = None
    first_column: int = 0  # of this rank's cells of the column level, where there is no source

    def to_scipy(self) -> sparse.csr_array | None:
        """The whole operator on rank 0, None elsewhere; rows and columns in the order of the levels' cells. Collective."""
        parts = self.hierarchy.comm.gather(self.entries, root=0)
        if parts is None:
            return None
        lengths = np.concatenate([np.diff(start) for start, _, _ in parts])
        start = np.concatenate([[0], np.cumsum(lengths)])
        columns = np.concatenate([column for _, column, _ in parts])
        values = np.concatenate([value for _, _, value in parts])
        return sparse.csr_array((values, columns, start), shape=self.shape)

    def multiply(self, values: np.ndarray) -> np.ndarray:
        """This rank's part of the operator times `values`, its cells of the column level, by Tpetra. Collective.

        For looking and testing: the matrix is made anew for each call.
        """
        if self.source is None:
            start, columns, own = self.entries
            local = sparse.csr_array((own, columns - self.first_column, start), shape=(len(start) - 1, len(values)))
            return local @ values
        operators, name, other, axis = self.source
        return operators.multiply_by_tpetra(name, other, axis, self.hierarchy.comm.py2f(), np.ascontiguousarray(values))


@dataclass(frozen=True)
class GradientAxis:
    """One component of E = −∇φ: own φ_l + coarse φ_{l−1} + fine φ_{l+1}, in uncovered cells."""

    own: Operator
    coarse: Operator
    fine: Operator


class LevelOperators:
    """The eight operators of a level; operators towards a level that does not exist have no columns."""

    def __init__(self, solver: PoissonSolver, level: int) -> None:
        self.hierarchy, self.level = solver.hierarchy, level
        self._native = solver.native.operators(level)
        self._coarse = solver.native.operators(level - 1) if level > 0 else None
        self._fine = solver.native.operators(level + 1) if level + 1 < self.hierarchy.levels else None

    @property
    def no_fine(self) -> Operator:
        """Laplacian of the level as if nothing finer existed; in covered cells, which hold corrections alone, what lies
        behind an open wall vanishes where the finest level's ghosts are."""
        return self._operator("no_fine", self._native)

    @property
    def composite(self) -> Operator:
        """Laplacian in uncovered cells, with the fluxes of the finer level."""
        return self._operator("composite", self._native)

    @property
    def coarse_boundary(self) -> Operator:
        """What the ghosts around the level take from the next coarser one."""
        return self._operator("coarse_boundary", self._coarse)

    @property
    def fine_boundary(self) -> Operator:
        """What the mean fine fluxes take from the next finer level."""
        return self._operator("fine_boundary", self._fine)

    @property
    def restriction(self) -> Operator:
        """Mean of the children, in rows of covered cells."""
        return self._operator("restriction", self._fine)

    @property
    def prolongation(self) -> Operator:
        """Values from the next coarser level."""
        return self._operator("prolongation", self._coarse)

    @property
    def uncovered(self) -> Operator:
        """1 on the diagonal where no finer level covers the cell."""
        ones = self._native.uncovered().astype(bool)
        start = np.concatenate([[0], np.cumsum(ones)])
        columns = self._native.first_row + np.flatnonzero(ones)
        size = self._native.rows
        entries = start, columns, np.ones(len(columns))
        return Operator(self.hierarchy, (size, size), entries, first_column=self._native.first_row)

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

    def _operator(self, name: str, columns: _native.LevelOperators | None, axis: int = 0) -> Operator:
        if columns is None:
            empty = np.zeros(self._native.local_rows + 1, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
            return Operator(self.hierarchy, (self._native.rows, 0), empty)
        shape = self._native.rows, columns.rows
        entries = self._native.rows_of(name, columns, axis)
        return Operator(self.hierarchy, shape, entries, (self._native, name, columns, axis))
