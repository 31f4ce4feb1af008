"""The Poisson solver: charge density in, potential and electric field out."""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from .. import _native, tables
from ..conductors.arms import Lattice
from ..conductors.metal import MetalOnMesh, image_refusal
from ..errors import SolverError
from ..mesh.domain import BOUNDARIES
from ..mesh.field import Field, Function, Holds, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.level_operators import LevelOperators
from ..mesh.mirror import SIGNS, Mirror
from ..mesh.rims import rims_of
from ..parallel import together
from ..scene.complaints import settings
from ..scene.electrodes import Electrode
from ..scene.solver_options import SolverOptions

COVERED = ("mean", "difference")
# Gauss's points on the face of a cell, two along each edge, from its centre: signs of the steps along x, y and z. Each pair
# of axes has all four.
FACE_POINTS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))
DIRICHLET, NEUMANN = BOUNDARIES.index("dirichlet"), BOUNDARIES.index("neumann")


@dataclass(frozen=True)
class SolveReport:
    """How a solve went."""

    converged: bool  # the tolerance was met, or lies below the rounding floor and the floor was reached
    cycles: int
    residuals: list[float]  # before the first cycle and after each, relative to the right-hand side
    seconds: dict[str, float]  # per stage, of this rank
    reason: str  # why the solve stopped
    floor: float  # estimate of the relative residual that rounding alone leaves; 0 unless it was met, or φ has a larger mean
    discretization_error: float = 0.0  # estimate of the largest error of φ that the mesh makes, V; 0 unless asked for
    contraction: float = 0.0  # the latest known: largest change of φ by a second cycle over that by the first
    right_hand_side: float = 0.0  # its norm when the error was estimated
    solves_since: int = 0  # that estimate
    charges: Mapping[str, float] = field(default_factory=dict)  # on each electrode, C; ρ in its cells is imaged there
    voltages: Mapping[str, float] = field(default_factory=dict)  # of each electrode, V; found of those that float

    @property
    def remedy(self) -> str:
        """What may help a solve that did not converge."""
        residuals = self.residuals
        if self.floor > 0:
            return (
                "no other option of the solver helps: give a face a potential, a shorter domain or a stronger screening"
            )
        if len(residuals) > 2 and residuals[-1] < 0.5 * min(residuals[: (len(residuals) + 1) // 2]):
            return "raise solver.tolerance or solver.max_cycles"
        if residuals and residuals[-1] < 0.1:
            return f"raise solver.tolerance above {min(residuals):.0e}; more cycles do not help"
        return 'more cycles do not help; set solver.backend to "crs" and solver.krylov to "fgmres"'

    def _repr_html_(self) -> str:
        end = "converged" if self.converged else "not converged"
        caption = f"SolveReport: {end} after {self.cycles} cycles: {self.reason}"
        return tables.html(("cycle", "residual"), [[n, f"{r:.2e}"] for n, r in enumerate(self.residuals)], caption)


# Weight of the voltage of an electrode in the equation of a cell, over the diagonal, from which on the cell sees it: it is that
# small or less where the other end of the arm's axis lies on metal that is nowhere near, between levels.
LEAST_SIGHT = 1e-6


class PoissonSolver:
    """Solves Δφ = −ρ/ε₀ over all levels of a hierarchy at once. Collective; set up once, solved many times.

    `tolerance` bounds the residual over the right-hand side (its boundary part included) in `norm`: "max", or "l1" or "l2"
    weighted by volume, over uncovered cells; `absolute_tolerance` bounds the residual itself, in V/m² (times m³ for "l1",
    m^1.5 for "l2"). With `tolerance="discretization"` a solve ends where the error left in φ is a tenth of what the mesh
    makes by an estimate: the Laplacian of each next coarser level, applied to φ, shows the truncation error, and one cycle
    with that the error of φ. `background="neutralizing"` takes the mean charge away where all faces are periodic or Neumann.
    With `stretch` = s the equation is Σ s_d⁻² ∂²φ/∂x_d² = −ρ/ε₀, and E_d = −s_d⁻² ∂φ/∂x_d: (1, 1, γ) gives φ and E of charge
    that moves along z with the Lorentz factor γ, in the laboratory frame; solved as a Poisson equation in coordinates s_d x_d.
    With `order=4` the equation holds for means over cells, with an error of h⁴ where ρ is smooth: ρ that holds points is turned
    into means, and φ holds means (`Field.holds`); E comes at points, or as means.
    With `screening` = κ it is −Δφ + κ²φ = ρ/ε₀, between faces none of which is open.
    With `electrodes` φ is their voltage on their surfaces, which cut the arms between centres of cells: of second order up to
    them, with Gauss's law exact; they may pass through faces between levels, but have to end a cell before open faces.
    With a `mirror` the walls across its axis are open for the equation: a solve gives φ of the charge and of the images that
    move as it does, φ₊, or with `image=True` that of those that move against it, φ₋.

    A cycle is a V-cycle over the refined levels, and an F-cycle over the base and the multigrid levels below it, of which the
    coarsest is solved exactly, with `sweeps` (before, after) of a smoother. Backend "matrix-free" loops over the rows of
    boxes, tuned for vector registers; "kokkos" takes the same steps with kernels over all rows of a level; "crs" holds the
    operators as compressed rows, many times slower and larger, and offers the menu of smoothers, `prolongation`,
    `coarse_levels`, `bottom` methods and `krylov` accelerations. `reuse` is the `base_setup` of the solver of an earlier
    hierarchy on the same domain.

    `SolverOptions` describes each of these choices, which are its fields; `options` gives all of them as one.

    Raises SolverError for an option out of range, or one that does not go with the others or the hierarchy.
    """

    def __init__(
        self,
        hierarchy: Hierarchy,
        tolerance: float | Literal["discretization"] | None = None,
        norm: str | None = None,
        backend: str | None = None,
        *,
        options: SolverOptions | None = None,
        background: str | None = None,
        mirror: Mirror | None = None,
        electrodes: Sequence[Electrode] = (),
        reuse: BaseSetup | None = None,
        **choices: Any,
    ) -> None:
        if not isinstance(hierarchy, Hierarchy):
            raise SolverError(f"a solver was given {hierarchy!r:.60} to solve on; give an amrpic.Hierarchy")
        named = {"tolerance": tolerance, "norm": norm, "backend": backend}
        self.options = _options(options, {**{k: v for k, v in named.items() if v is not None}, **choices})
        if background is not None:
            _one_of("background", background, ("neutralizing",))
        self.hierarchy = hierarchy
        chosen = self.options
        if refused := chosen.screening_refusal(hierarchy.domain):
            raise SolverError(f"screening is {chosen.screening:g}, which {refused[0]}; {refused[1]}")
        if mirror is not None and (refusal := _mirror_refusal(mirror, hierarchy, chosen)):
            raise SolverError(refusal)
        self.mirror = mirror
        self.electrodes = tuple(electrodes)
        if self.electrodes and (refusal := _electrodes_refusal(self.electrodes, hierarchy, chosen, mirror)):
            raise SolverError(refusal)
        domain = hierarchy.domain
        metal = (
            MetalOnMesh(self.electrodes, domain.lower, domain.faces("dirichlet"), chosen.stretch)
            if self.electrodes
            else None
        )
        self.metal = metal  # as its cells see it; None without electrodes
        self._unit_potentials: list[Field] | None = None  # of each electrode at 1 V, when they are first needed
        self._unit_walls: list[list[np.ndarray]] = []  # what walls, open ones too, hold then
        self._units: list[
            tuple[weakref.ref[Field], int]
        ] = []  # such potentials that were handed out, and whose they are
        self._potentials = [0.0] * len(self.electrodes)  # of these, V, as the native solver has them
        self._capacitance: np.ndarray | None = None
        of_bottom = chosen.bottom, chosen.bottom_preconditioner, chosen.stretch, chosen.screening
        across = None if mirror is None else mirror.axis
        self._base = hierarchy.comm, hierarchy.domain, chosen.order, *of_bottom, across
        if reuse is not None and reuse.base != self._base:
            raise SolverError(
                "reuse comes from a solver of another domain, order, stretch, screening, bottom or axis of a mirror; make this "
                "one without it"
            )
        self._walls: tuple[Function | None, Function | None] | None = (None, None)  # whose values the walls hold
        native = native_options(chosen, mirror)
        native.neutralize = background is not None
        reusable = reuse.native if reuse is not None else _native.Reusable()
        try:
            of_metal = None if metal is None else metal.native()
            self.native = _native.PoissonSolver(hierarchy.native, native, reusable, of_metal)
        except _native.SolverError as refused:
            raise SolverError(str(refused)) from None
        if metal is not None:
            with together(hierarchy.comm, SolverError):
                metal.finish()
                for level in range(hierarchy.levels):
                    self.native.add_gaps(level, *metal.gaps(hierarchy.spacing(level)))
            self._require_arms_at_electrodes()

    def takes(self, electrodes: Sequence[Electrode]) -> bool:
        """Let electrodes take the place of its own, if its cells see the same metal. Returns whether they did. Collective."""
        same = (
            not (electrodes or self.electrodes)
            if self.metal is None
            else self.metal.becomes(electrodes, self.hierarchy.comm)
        )
        if same:
            self.electrodes = tuple(electrodes)
        return same

    def _require_arms_at_electrodes(self) -> None:
        """Refuse electrodes that no cell sees. Collective."""
        for electrode, sight in zip(self.electrodes, self.native.sights(), strict=True):
            if sight < 0:
                raise SolverError(
                    f"electrode {electrode.name} meets no line between the centres of neighbouring cells, so that the solver "
                    "does not see it; refine the mesh there, move it into the domain, or leave it out"
                )
            if electrode.floats and sight < LEAST_SIGHT:
                raise SolverError(
                    f"electrode {electrode.name} floats where no cell outside metal lies beside it, so that nothing fixes its "
                    "voltage; give it one, refine the mesh there, or leave it out"
                )

    def solve(
        self,
        rho: Field,
        guess: Field | None = None,
        boundary_values: Function | None = None,
        boundary_flux: Function | None = None,
        last: SolveReport | None = None,
        deposited: float = 0.0,
        image: bool = False,
        time: float = 0.0,
    ) -> tuple[Field, SolveReport]:
        """Return the potential in V and how the solve went. Collective.

        `rho` is in C/m³; what it holds in covered cells is ignored. `guess` is a potential to start from.
        `boundary_values(x, y, z)` gives V on Dirichlet faces, `boundary_flux(x, y, z)` the outward derivative of φ in V/m on
        Neumann faces; both are called with arrays of face centres in m, and are zero by default. `last` is the report of the
        solve on this hierarchy that found the guess: its estimate of the error that the mesh makes serves nine further
        solves, as long as the right-hand side is of about the same size, and these may take a single cycle. `deposited` is
        the sum of the magnitudes of the charges that ρ was made of, C: rounding of these is no net charge. With `image` it is
        the potential of the images of ρ in the `mirror` that move against it. Electrodes are at their voltages of `time`, s;
        in their cells φ is that voltage, and ρ there counts for nothing.

        Check `report.converged`: an unconverged potential is returned as what it is. Raises SolverError for a charge that
        no potential can balance, for a right-hand side that is not finite, for fields of another hierarchy, and for images
        without a plane that makes them.
        """
        self._require_home("rho", rho)
        if self.mirror is not None and (boundary_values, boundary_flux) != (None, None):
            raise SolverError(
                "walls are given values, which are at rest, in a solver with a mirror, for charge that moves; solve for their "
                "field by one without"
            )
        if image and not (self.mirror is not None and self.mirror.reflects):
            raise SolverError("images of ρ are asked for, but no plane mirrors it; give the solver a mirror with one")
        if guess is not None:
            self._require_home("guess", guess)
        self._set_walls(boundary_values, boundary_flux)
        phi = guess.copy() if guess is not None else Field(self.hierarchy)
        phi.unit = "V"
        phi.holds = self.options.potential_holds
        if phi.holds == "means":
            rho = self._in_means(rho)
        voltages = np.array([self._voltage(electrode, time, last) for electrode in self.electrodes])
        if self.electrodes:
            self._set_potentials(voltages.tolist())
        try:
            report = self.native.solve(rho.native, phi.native, guess is None, _known(last), deposited, image)
        except _native.SolverError as refused:
            raise SolverError(str(refused)) from None
        mesh = report.mesh_error
        out = SolveReport(
            report.converged,
            report.cycles,
            report.residuals,
            report.seconds,
            report.reason,
            report.floor,
            mesh.error,
            mesh.contraction,
            mesh.right_hand_side,
            mesh.solves,
        )
        return phi, self._with_electrodes(phi, rho, out, voltages) if self.electrodes else out

    @staticmethod
    def _voltage(electrode: Electrode, time: float, last: SolveReport | None) -> float:
        """Return the voltage of an electrode; of one that floats what it was, to begin with."""
        if not electrode.floats:
            return electrode.voltage_at(time)
        return 0.0 if last is None else last.voltages.get(electrode.name, 0.0)

    def capacitance(self) -> np.ndarray:
        """Return the charges on all electrodes, C, with one of them at 1 V and all else at zero: (n, n), F. Collective.

        Entry [i, j] is the charge on electrode i by the voltage of electrode j, open faces open and walls at 0 V. Raises
        SolverError, if there are no electrodes.
        """
        if not self.electrodes:
            raise SolverError("a capacitance is asked of a solver without electrodes; give it some")
        if self._capacitance is None:
            with self._restored():
                self._set_walls(None, None)
                self._solve_units()
        assert self._capacitance is not None
        return self._capacitance.copy()

    def _solve_units(self) -> None:
        """Solve for each electrode at 1 V, and all else at zero. Collective."""
        nothing = Field(self.hierarchy)
        potentials, charges, walls = [], [], []
        for unit in np.eye(len(self.electrodes)):
            phi = Field(self.hierarchy)
            phi.unit = "V"
            self._set_potentials(unit.tolist())
            self.native.solve(nothing.native, phi.native, True, _native.MeshError(), 0.0, False)
            potentials.append(phi)
            charges.append(self.native.charges(phi.native, nothing.native))
            walls.append(self._wall_data())
        self._unit_potentials, self._unit_walls, self._capacitance = potentials, walls, np.array(charges).T

    def unit_potential(self, name: str) -> Field:
        """Return φ with one electrode at 1 V, and all other electrodes and walls at zero: of all voltages the potential is
        the sum of theirs, and i = Σ q v·E the current that charge q induces on it (Shockley and Ramo). Collective."""
        self.capacitance()
        assert self._unit_potentials is not None
        names = [electrode.name for electrode in self.electrodes]
        if name not in names:
            raise SolverError(f"there is no electrode {name!r}; there are {', '.join(names)}")
        out = self._unit_potentials[names.index(name)].copy()
        self._units = [unit for unit in self._units if unit[0]() is not None]
        self._units.append((weakref.ref(out), names.index(name)))
        return out

    def _with_electrodes(self, phi: Field, rho: Field, report: SolveReport, voltages: np.ndarray) -> SolveReport:
        """Let electrodes float to their charges; return the report with charges and voltages. Collective."""
        charges = np.array(self.native.charges(phi.native, rho.native))
        floating = [n for n, electrode in enumerate(self.electrodes) if electrode.floats]
        if floating:
            faces = self._wall_data()
            capacitance = self.capacitance()
            wanted = np.array([electrode.charge for electrode in self.electrodes if electrode.floats], float)
            rise = np.linalg.solve(capacitance[np.ix_(floating, floating)], wanted - charges[floating])
            assert self._unit_potentials is not None
            for n, volts in zip(floating, rise, strict=True):
                for level in range(self.hierarchy.levels):
                    phi.array(level)[:] += volts * self._unit_potentials[n].array(level)
                    faces[level] += volts * self._unit_walls[n][level]
            voltages[floating] += rise
            charges += capacitance[:, floating] @ rise
            self._set_wall_data(faces)
            self._set_potentials(voltages.tolist())
        names = [electrode.name for electrode in self.electrodes]
        return replace(
            report,
            charges=dict(zip(names, charges.tolist(), strict=True)),
            voltages=dict(zip(names, voltages.tolist(), strict=True)),
        )

    def _wall_data(self) -> list[np.ndarray]:
        """Return what the walls of this rank hold, per level."""
        return [self.native.wall_data(level).copy() for level in range(self.hierarchy.levels)]

    def _set_wall_data(self, faces: Sequence[np.ndarray]) -> None:
        for level, data in enumerate(faces):
            self.native.wall_data(level)[...] = data

    def _set_potentials(self, potentials: list[float]) -> None:
        self._potentials = potentials
        self.native.set_potentials(potentials)

    @contextmanager
    def _restored(self) -> Iterator[None]:
        """Let walls and electrodes hold afterwards what they hold now."""
        walls, faces, potentials = self._walls, self._wall_data(), self._potentials
        try:
            yield
        finally:
            self._walls = walls
            self._set_wall_data(faces)
            self._set_potentials(potentials)

    @contextmanager
    def _surfaces_of(self, phi: Field) -> Iterator[None]:
        """Let walls and electrodes hold what they do in a potential: of one electrode at 1 V, else of the latest solve."""
        number = next((n for reference, n in self._units if reference() is phi), None)
        if number is None:
            yield
            return
        with self._restored():
            self._set_wall_data(self._unit_walls[number])
            self._set_potentials(np.eye(len(self.electrodes))[number].tolist())
            yield

    @property
    def base_setup(self) -> BaseSetup:
        """What the solver of another hierarchy on the same domain may `reuse`: the operators of levels that stay as they are
        between the same neighbours, the set-up of the bottom, if the coarsest level comes out the same, and the tables of
        free space. Operators go to the first that takes them."""
        return BaseSetup(self._base, self.native.reusable)

    def electric_field(self, phi: Field, covered: str = "mean", holds: Holds = "points") -> VectorField:
        """Return E = −∇φ in V/m at cell centres, from the fluxes through the cell faces; stretched as the equation. Collective.

        In fourth order from means over the faces; there `holds="means"` gives means over the cells.

        Walls and electrodes count with the data of the latest solve, or of a `unit_potential` that is asked for. In cells that
        a finer level covers stands the mean of the children, or, for `covered="difference"`, the central difference of the
        mean potentials, as matched clouds need it (see `Clouds`).
        """
        _one_of("holds", holds, get_args(Holds))
        if holds == "means" and self.options.order != 4:
            raise SolverError(
                "means of E over cells are what a solver of order 4 knows; leave holds out, or set order to 4"
            )
        out = self._field(phi, covered, holds).with_components()
        for component in out.components:
            component.holds = holds
        return out

    def deferred_field(self, phi: Field, covered: str = "mean") -> VectorField:
        """Return what `electric_field` would, with components that are made when they are asked for. Collective.

        Gather, push and the energy of the field do without them, in less memory and time. The field follows from `phi` as
        long as it lives, so `phi` is locked: its arrays are read-only from now on.
        """
        field = self._field(phi, covered)
        phi.lock()
        return field

    def _field(self, phi: Field, covered: str, holds: Holds = "points") -> VectorField:
        self._require_home("phi", phi)
        _one_of("covered", covered, COVERED)
        of_covered = getattr(_native.CoveredField, covered)
        if self.options.order == 4:
            phi = self._in_means(phi)
            native = self.native.electric_field_as(phi.native, of_covered, getattr(_native.Holds, holds))
        else:
            with self._surfaces_of(phi):
                native = self.native.electric_field(phi.native, of_covered)
        return VectorField.deferred(native, self.hierarchy, "V/m")

    def operators(self, level: int) -> LevelOperators:
        """The eight operators of a level, to look at. Collective at the first call."""
        return LevelOperators(self.native, self.hierarchy, self.hierarchy._checked(level))

    def _require_home(self, name: str, field: Field) -> None:
        if not isinstance(field, Field):
            raise SolverError(
                f"{name} is of type {type(field).__name__}; give an amrpic.Field on the hierarchy of the solver, whose values "
                "`fill` sets, or whose patches' data are arrays"
            )
        if field.hierarchy is not self.hierarchy:
            raise SolverError(
                f"{name} lives on another hierarchy than the solver; make a solver for it, or carry it over"
            )

    def _in_means(self, field: Field) -> Field:
        """Return a field's means, through the lists of the solver."""
        if field.holds == "means":
            return field
        out = Field.unset(self.hierarchy, field.unit)
        out.holds = "means"
        self.native.to_means(field.native, out.native)
        return out

    def _on_faces(self, level: int, function: Function, centres: np.ndarray, axes: np.ndarray) -> np.ndarray | float:
        """Return a function's values for wall faces (n,) of a level: at their centres (n, 3) in m, or in fourth order its means
        over the faces, by Gauss's two points along each of their edges."""
        if self.options.order == 2:
            return function(*centres.T)
        half = self.hierarchy.spacing(level)[:, None] / np.sqrt(12)
        out, steps = np.zeros(len(centres)), half * (np.arange(3)[:, None] != axes)
        for signs in FACE_POINTS:
            out += np.broadcast_to(function(*(centres.T + np.array(signs)[:, None] * steps)), len(centres))
        return out / len(FACE_POINTS)

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
                    data[faces] = (
                        0.0 if function is None else self._on_faces(level, function, points[faces], axes[faces])
                    )
                # the native side works in stretched coordinates
                data[kinds == NEUMANN] /= np.array(self.options.stretch)[axes[kinds == NEUMANN]]
            beyond = np.zeros((3, 2))
            if values is not None:
                for face, rim in rims_of(self.hierarchy.domain, values).items():
                    beyond[face] = rim.potential
            self.native.continue_walls(beyond.tolist())
        self._walls = values, flux


@dataclass(frozen=True)
class BaseSetup:
    """What a solver hands on to the next one on its domain."""

    base: tuple  # communicator, domain, order, bottom and its preconditioner, stretch, screening, axis of the mirror
    native: _native.Reusable


def _electrodes_refusal(
    electrodes: Sequence[Electrode], hierarchy: Hierarchy, options: SolverOptions, mirror: Mirror | None
) -> str | None:
    """Return why a solver has no such electrodes, and what to do; None if it has."""
    names = [electrode.name for electrode in electrodes]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        return f"two electrodes are named {twice[0]}; give each a name of its own"
    if options.order != 2:
        return f"order is {options.order} with electrodes, beside whose surfaces the equations are of order 2; set order to 2"
    if mirror is not None:
        return "electrodes are given beside a mirror, which knows walls alone; leave one of the two out"
    domain = hierarchy.domain
    free = all(face in ("periodic", "neumann") for faces in domain.boundary for face in faces)
    if free and all(electrode.floats for electrode in electrodes):
        return "all electrodes float between periodic and Neumann faces, so nothing fixes φ; give one of them a voltage"
    for level in range(hierarchy.levels):  # what is thin, fine cells may see alone
        cells = [count << level for count in domain.cells]
        lattice = Lattice.of(domain.lower, hierarchy.spacing(level))
        if refusal := image_refusal(electrodes, lattice, hierarchy.boxes(level), cells, domain.periodic):
            return refusal
    return None


def _mirror_refusal(mirror: Mirror, hierarchy: Hierarchy, options: SolverOptions) -> str | None:
    """Return why a solver has no such mirror, and what to do; None if it has."""
    if options.screening > 0:
        return (
            f"screening is {options.screening:g} with a mirror, behind whose faces the potential is an unscreened one; leave "
            "one of the two out"
        )
    return mirror.refusal(hierarchy.domain)


def _known(last: SolveReport | None) -> _native.MeshError:
    """Return what an earlier solve found of the error of the mesh."""
    if last is None:
        return _native.MeshError()
    return _native.MeshError(last.discretization_error, last.contraction, last.right_hand_side, last.solves_since)


def _options(options: SolverOptions | None, choices: Mapping[str, Any]) -> SolverOptions:
    """Return the options that are given as a whole or one by one. Raises SolverError."""
    if options is not None:
        if choices:
            raise SolverError(f"options are given as well as {', '.join(choices)}; keep one of the two")
        return options
    return settings(SolverOptions, {name: _plain(value) for name, value in choices.items()}, SolverError)


def _plain(value: Any) -> Any:
    """Return a value without NumPy's types, which the model does not take for numbers."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return tuple(map(_plain, value)) if isinstance(value, list | tuple) else value


def native_options(options: SolverOptions, mirror: Mirror | None = None) -> _native.SolverOptions:
    """Return the options as the native struct; the names of choices become members of its enumerations."""
    native = _native.SolverOptions()
    for name, value in options.native_values().items():
        if isinstance(value, str):
            value = getattr(type(getattr(native, name)), value.replace("-", "_"))
        setattr(native, name, value)
    if mirror is not None:
        native.across = mirror.axis
        native.mirror_places = [np.nan if plane is None else plane.place for plane in mirror.planes]
        native.mirror_signs = [1 if plane is None else SIGNS[plane.kind] for plane in mirror.planes]
    return native


def _one_of(name: str, value: str, allowed: Sequence[str]) -> None:
    if value not in allowed:
        raise SolverError(f"{name} is {value!r}; use one of {', '.join(allowed)}")
