"""The solvers of a self-field, kept by frame as long as their mesh."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import SolverError
from ..mesh.field import Field, Function, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.mirror import Mirror
from ..particles.energy_bins import Frames
from ..particles.frame import LABORATORY, Frame
from ..scene.solver_options import SolverSection
from ..stages.poisson import PoissonSolver, SolveReport

Potential = tuple[Field, VectorField]  # φ, V, and E, V/m


class Solvers:
    """Solves for potentials, and keeps the reports.

    `walls`: what these hold, potential (V) and slope of it (V/m). `remark`: is given a sentence on what may not be meant.
    """

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
        self._walls: Potential | None = None
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
        solver = self._kept.get((frame, part))
        if solver is not None and solver.hierarchy is hierarchy and solver.mirror == mirror:
            return solver
        reuse = solver.base_setup if solver is not None and options.reuse else None
        # the old operators go before the new ones come
        solver = None
        self._kept.pop((frame, part), None)
        self._kept = {key: solver_kept for key, solver_kept in self._kept.items() if solver_kept.hierarchy is hierarchy}
        background = "neutralizing" if part else self._background
        self._kept[frame, part] = PoissonSolver(
            hierarchy, options=options, background=background, mirror=mirror, reuse=reuse
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
        """Return φ and E of what the walls hold where a solution in these frames is without it, being of others. Collective.

        It is solved for once on each mesh, in the laboratory; `covered` as for `PoissonSolver.electric_field`. Raises
        SolverError if its flux has no potential.
        """
        if frames.only == LABORATORY or (self._potential is None and self._slope is None):
            return None
        if self._walls is None or self._walls[0].hierarchy is not hierarchy:
            solver = PoissonSolver(hierarchy, options=self._options, background=self._background)
            try:
                phi, report = solver.solve(Field(hierarchy), None, self._potential, self._slope)
            except SolverError as refused:
                raise SolverError(
                    f"domain.slope, whose field is solved for apart from charge that moves: {refused}"
                ) from None
            self._require_converged(report)
            self._walls = phi, solver.deferred_field(phi, covered=covered)
        return self._walls

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
