"""The solvers of a self-field, kept by frame as long as their mesh."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import add
from typing import NamedTuple

from ..conductors.metal import MetalOnMesh
from ..errors import SolverError
from ..mesh.field import Field, Function, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.mirror import Mirror
from ..particles.energy_bins import Frames
from ..particles.frame import LABORATORY, Frame
from ..scene.solver_options import SolverSection
from ..stages.poisson import PoissonSolver, SolveReport
from .drive import NO_ELECTRODES, Drive

CONSTANT = ""  # name of what walls and constant voltages hold together


class Potential(NamedTuple):
    """What is solved for apart from charge."""

    phi: Field  # V
    efield: VectorField  # V/m
    charges: Mapping[str, float] = {}  # of each electrode, C
    voltages: Mapping[str, float] = {}  # V


class Solvers:
    """Solves for potentials, and keeps the reports.

    `walls`: what these hold, potential (V) and slope of it (V/m). `remark`: is given a sentence on what may not be meant.
    `drive` is that of the electrodes, and is set before a solve at another time.
    """

    drive: Drive = NO_ELECTRODES

    def __init__(
        self,
        options: SolverSection,
        background: str | None = None,
        walls: tuple[Function | None, Function | None] = (None, None),
        remark: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._options, self._background, self._remark = options, background, remark
        self._potential, self._slope = walls
        self._kept: dict[tuple[Frame, bool], PoissonSolver] = {}
        self._apart: dict[
            str, Potential
        ] = {}  # of walls and constant voltages, and of each electrode at 1 V that varies
        self._mesh: Hierarchy | None = None  # of these
        self._metal: MetalOnMesh | None = None  # of these
        self._reports: list[SolveReport] = []

    def poisson(
        self, hierarchy: Hierarchy, frame: Frame = LABORATORY, part: bool = False, mirror: Mirror | None = None
    ) -> PoissonSolver:
        """Return the solver of a hierarchy in a frame, set up at the first call. Collective.

        That of a part of the charge leaves the mean of it out where no wall fixes φ: those of all parts cancel.
        """
        options = self._options
        if frame != LABORATORY:
            options = options.model_copy(update={"stretch": self.stretch(frame)})
        electrodes = self.drive.with_charge(frame == LABORATORY and not part)
        solver = self._kept.get((frame, part))
        serves = solver is not None and solver.hierarchy is hierarchy and solver.mirror == mirror
        if solver is not None and serves and solver.takes(electrodes):
            return solver
        reuse = solver.base_setup if solver is not None and options.reuse else None
        # the old operators go before the new ones come
        solver = None
        self._kept.pop((frame, part), None)
        self._kept = {key: solver_kept for key, solver_kept in self._kept.items() if solver_kept.hierarchy is hierarchy}
        background = "neutralizing" if part else self._background
        self._kept[frame, part] = PoissonSolver(
            hierarchy, options=options, background=background, mirror=mirror, electrodes=electrodes, reuse=reuse
        )
        return self._kept[frame, part]

    def stretch(self, frame: Frame) -> tuple[float, float, float]:
        """Return what lengths are multiplied by where the equation of charge that rests in a frame is Poisson's."""
        return self._options.stretch if frame == LABORATORY else frame.stretch

    def keep(self, frames: Frames) -> None:
        """Free the solvers of other frames."""
        self._kept = {key: solver for key, solver in self._kept.items() if key[0] in frames.members}

    def solve(
        self,
        rho: Field,
        guess: Field | None,
        frame: Frame = LABORATORY,
        part: bool = False,
        last: SolveReport | None = None,
        deposited: float = 0.0,
        mirror: Mirror | None = None,
        image: bool = False,
    ) -> tuple[Field, SolveReport]:
        """Return the potential of a charge density and how the solve went. Collective; SolverError if it does not converge.

        It is that of the laboratory. What the walls hold counts in the laboratory's frame alone, and not for a `part` of the
        charge. `last`: of the solve in this frame and on this hierarchy that found the guess. `deposited`: Σ |w q|, C.
        `mirror`, `image`: see `PoissonSolver`.
        """
        at_rest = frame == LABORATORY and not part
        phi, report = self.poisson(rho.hierarchy, frame, part, mirror).solve(
            rho,
            guess=guess,
            boundary_values=self._potential if at_rest else None,
            boundary_flux=self._slope if at_rest else None,
            last=last,
            deposited=deposited,
            image=image,
            time=self.drive.time,
        )
        self._reports.append(report)
        self._require_converged(report)
        if report.floor > 0:
            self._remark(
                f"solver.tolerance {self._options.tolerance} lies below what rounding leaves of the residual, about "
                f"{max(report.residuals[-1], report.floor):.0e}; solves stop there"
            )
        return phi, report

    def walls(self, hierarchy: Hierarchy, frames: Frames, covered: str) -> Potential | None:
        """Return φ and E of what walls and electrodes hold where a solution in these frames is without it. Collective.

        That is all of it for frames other than the laboratory's, and of electrodes whose voltage varies always: it is solved
        for once on each mesh, and summed up with the voltages of the time. `covered` as for `PoissonSolver.electric_field`.
        Raises SolverError if the flux of walls has no potential.
        """
        at_rest = frames.only == LABORATORY
        apart = self.drive.apart(at_rest)
        weights = {electrode.name: electrode.voltage_at(self.drive.time) for electrode in apart if electrode.varies}
        constant = [electrode.name for electrode in apart if not electrode.varies]
        if not at_rest and (constant or self._potential is not None or self._slope is not None):
            weights[CONSTANT] = 1.0
        if not weights:
            return None
        self._forget_others(hierarchy)
        for name in weights.keys() - self._apart.keys():
            self._apart[name] = self._alone(name, constant, hierarchy, covered)
        return _summed([(weight, self._apart[name]) for name, weight in weights.items()])

    def _forget_others(self, hierarchy: Hierarchy) -> None:
        """Forget what was solved for apart from charge on another mesh, or with other metal."""
        same = self._metal is None or self._metal.becomes(self.drive.electrodes, hierarchy.comm)
        if self._mesh is not hierarchy or not same:
            self._apart, self._mesh, self._metal = {}, hierarchy, None

    def _alone(self, name: str, constant: Sequence[str], hierarchy: Hierarchy, covered: str) -> Potential:
        """Return φ and E of an electrode at 1 V, or of walls and constant voltages, without charge. Collective."""
        of_walls = name == CONSTANT
        electrodes = self.drive.alone(*constant) if of_walls else self.drive.alone(name, volts=1.0)
        solver = PoissonSolver(hierarchy, options=self._options, background=self._background, electrodes=electrodes)
        self._metal = solver.metal
        walls = (self._potential, self._slope) if of_walls else (None, None)
        try:
            phi, report = solver.solve(Field(hierarchy), None, *walls)
        except SolverError as refused:
            raise SolverError(
                f"domain.slope, whose field is solved for apart from charge that moves: {refused}"
            ) from None
        self._require_converged(report)
        return Potential(phi, solver.deferred_field(phi, covered=covered), report.charges, report.voltages)

    def take_reports(self) -> list[SolveReport]:
        """Return how the solves since the latest call went, and forget them."""
        reports, self._reports = self._reports, []
        return reports

    def _require_converged(self, report: SolveReport) -> None:
        if report.converged:
            return
        reached = report.residuals[-1] if report.residuals else float("nan")
        raise SolverError(
            f"residual {reached:.1e} after {report.cycles} cycles instead of {self._options.tolerance} "
            f"({report.reason}); {report.remedy}"
        )


def _summed(parts: Sequence[tuple[float, Potential]]) -> Potential:
    """Return the sum of potentials with factors."""
    first = parts[0][1]
    if len(parts) == 1 and parts[0][0] == 1:
        return first
    fields = [(weight, (part.phi, *part.efield.with_components().components)) for weight, part in parts]
    phi, *efield = (reduce(add, (weight * of[n] for weight, of in fields)) for n in range(4))
    totals = [
        {name: sum(weight * getattr(part, of)[name] for weight, part in parts) for name in getattr(first, of)}
        for of in ("charges", "voltages")
    ]
    return Potential(phi, VectorField(*efield), *totals)
