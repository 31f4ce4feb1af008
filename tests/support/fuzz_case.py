"""One Poisson problem as plain data, the Python text that solves it, and what is measured of a solve.

The text of `Case.program` is what the ranks run and, with a few lines that call it, what anyone can paste to see a failure
again.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import backends

Box = tuple[tuple[int, int, int], tuple[int, int, int]]
Faces = tuple[tuple[str, str], tuple[str, str], tuple[str, str]]

DEFAULT_BOXES = 24
TOLERANCE = 1e-10
# Centres x, y, z and cell widths h are in units of the domain, from 0 to 1.
GAUSSIAN = "np.exp(-((x - 0.41)**2 + (y - 0.55)**2 + (z - 0.47)**2) / (2 * 0.06**2))"


@dataclass(frozen=True)
class Case:
    """A Poisson problem and how it is solved; the domain starts at the origin."""

    cells: tuple[int, int, int]
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)  # of the base, m
    boundary: Faces = (("dirichlet", "dirichlet"),) * 3
    levels: tuple[tuple[Box, ...], ...] = ()
    blocking_factor: int = 8
    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)
    source: str = GAUSSIAN  # the charge density over ε₀ as an expression in x, y, z, h
    guess: str = "none"  # or "random", "previous": the potential of a charge that lay elsewhere
    max_grid_size: int = DEFAULT_BOXES
    ranks: int = 1
    backend: str = "matrix-free"
    isa: str = ""  # AMRPIC_ISA of the processes; "": the best one
    screening: float = 0.0  # 1/m

    @property
    def aspect_ratio(self) -> float:
        """Longest over shortest edge of a cell, as the solver has them."""
        edges = self.edges
        return float(edges.max() / edges.min())

    @property
    def edges(self) -> np.ndarray:
        return np.array(self.spacing) * self.stretch

    @property
    def singular(self) -> bool:
        return self.closed and self.screening == 0

    @property
    def closed(self) -> bool:
        """Whether no wall holds the potential."""
        return all(face in ("neumann", "periodic") for pair in self.boundary for face in pair)

    @property
    def has_open(self) -> bool:
        return any("open" in pair for pair in self.boundary)

    @property
    def total_cells(self) -> int:
        refined = [b for level in self.levels for b in level]
        return int(np.prod(self.cells)) + sum(int(np.prod(np.subtract(upper, lower) + 1)) for lower, upper in refined)

    @property
    def most_fits_in_gaps(self) -> int:
        """At most so many fits of potentials in narrow gaps: one for each coarse face of a box, and for each coarse cell that
        is not refined one along each axis, two if that passes from one rank to another. Those of long cells are small."""
        if self.aspect_ratio > 1.8:
            return 0
        faces = uncovered = 0
        coarse = math.prod(self.cells)
        for level in self.levels:
            extents = [np.subtract(upper, lower) + 1 for lower, upper in level]
            refined = sum(int(np.prod(n)) for n in extents)
            faces += sum(int(n[0] * n[1] + n[1] * n[2] + n[2] * n[0]) // 2 for n in extents)
            uncovered += coarse - refined // 8
            coarse = refined
        return min(faces, 3 * min(2, self.ranks) * uncovered)

    def density(self, level: int, box: Box) -> np.ndarray:
        """Charge density over ε₀ at the centres of the cells of a box of a level, (nx, ny, nz)."""
        h = 1 / (np.array(self.cells) * 2**level)
        lower, upper = np.array(box)
        x, y, z = np.ix_(*((np.arange(a, b + 1) + 0.5) * d for a, b, d in zip(lower, upper, h, strict=True)))
        values = eval(self.source, {"np": np, "x": x, "y": y, "z": z, "h": h})
        return np.broadcast_to(values, upper - lower + 1)

    @property
    def base(self) -> Box:
        nx, ny, nz = self.cells
        return (0, 0, 0), (nx - 1, ny - 1, nz - 1)

    def charges(self) -> np.ndarray:
        """Charge over ε₀ in each cell of the base, (nx, ny, nz)."""
        return self.density(0, self.base) * float(np.prod(self.spacing))

    def largest_source(self) -> float:
        """The largest density over ε₀ in a cell: a narrow bunch may lie between them."""
        levels = enumerate([(self.base,), *self.levels])
        return max(float(np.abs(self.density(level, box)).max()) for level, boxes in levels for box in boxes)

    def plain(self) -> Case:
        """The same problem on one rank, matrix-free, in boxes of the default size: the reference."""
        return replace(
            self, ranks=1, backend="matrix-free", isa="", max_grid_size=max(DEFAULT_BOXES, self.blocking_factor)
        )

    def program(self) -> str:
        """The definition of `solve(comm, max_grid_size, backend)`, which returns solver, phi and report."""
        upper = tuple(float(n * h) for n, h in zip(self.cells, self.spacing, strict=True))
        options = "tolerance=1e-10, backend=backend"
        if self.stretch != (1, 1, 1):
            options += f", stretch={self.stretch}"
        if self.screening > 0:
            options += f", screening={self.screening}"
        if self.singular:
            options += ', background="neutralizing"'
        pairs = [lower if lower == upper else (lower, upper) for lower, upper in self.boundary]
        one = len(set(pairs)) == 1 and isinstance(pairs[0], str)
        boundary: Any = pairs[0] if one else dict(zip("xyz", pairs, strict=True))
        lines = [
            "import amrpic",
            "import numpy as np",
            "from mpi4py import MPI",
            "",
            "def solve(comm, max_grid_size, backend):",
            f"    domain = amrpic.Domain((0, 0, 0), {upper}, {self.cells}, boundary={boundary!r})",
            f"    levels = {[list(level) for level in self.levels]}",
            f"    hierarchy = amrpic.Hierarchy(comm, domain, levels, max_grid_size, blocking_factor={self.blocking_factor})",
            f"    solver = amrpic.PoissonSolver(hierarchy, {options})",
            "    rho = amrpic.Field(hierarchy)",
            *self._fill("rho", f"8.8541878128e-12 * ({self.source})"),
        ]
        if self.guess == "none":
            lines += ["    phi, report = solver.solve(rho)"]
        elif self.guess == "random":
            size = 0.3 * float(self.edges.min() / 2 ** len(self.levels)) ** 2
            lines += [
                "    guess = amrpic.Field(hierarchy)",
                *self._fill("guess", f"{size!r} * ({noise(5)})"),
                "    phi, report = solver.solve(rho, guess=guess)",
            ]
        else:
            lines += [
                "    old = amrpic.Field(hierarchy)",
                *self._fill("old", f"8.8541878128e-12 * ({GAUSSIAN})"),
                "    phi, report = solver.solve(rho, guess=solver.solve(old)[0])",
            ]
        return "\n".join([*lines, "    return solver, phi, report"]) + "\n"

    def _fill(self, name: str, expression: str) -> list[str]:
        return [
            f"    for patch in {name}.patches:",
            "        size, h = np.array(domain.upper), hierarchy.spacing(patch.level) / domain.upper",
            "        x, y, z = (c / s for c, s in zip(patch.centres(), size))",
            f"        patch.data[...] = {expression}",
        ]

    def snippet(self, name: str = "case.py") -> str:
        """A whole program that shows this case beside its reference."""
        isa = f"AMRPIC_ISA={self.isa} " if self.isa else ""
        mine = f"MPI.COMM_WORLD, {self.max_grid_size}, {self.backend!r}"
        plain = f"MPI.COMM_SELF, {self.plain().max_grid_size}, 'matrix-free'"
        return (
            f"# {isa}mpiexec -n {self.ranks} python {name}\n"
            + self.program()
            + f"\nfor choice in (({plain}), ({mine})):\n"
            + "    _, phi, report = solve(*choice)\n"
            + "    largest = phi.max_abs()\n"
            + "    if MPI.COMM_WORLD.rank == 0:\n"
            + "        print(*choice[1:], report.cycles, 'cycles', report.residuals, report.reason, 'largest phi', largest)\n"
        )


def noise(seed: int) -> str:
    """An expression for values between -1 and 1 that look random and depend on the cell alone, not on its box."""
    return (
        f"np.modf(4096 * np.sin(({seed}.1 + np.rint(x / h[0] - 0.5)) * 12.9898) "
        "* np.cos(0.7 + np.rint(y / h[1] - 0.5) * 78.233) * np.sin(0.3 + np.rint(z / h[2] - 0.5) * 37.719))[0]"
    )


@dataclass
class Outcome:
    """What came of a solve, gathered on the first rank."""

    error: str = ""  # type and message of an exception, empty if there was none
    converged: bool = False
    reason: str = ""
    cycles: int = 0
    residuals: Sequence[float] = ()
    accelerated: bool = False  # whether slow cycles were combined, which keeps the latest corrections
    cells: int = 0
    boxes: int = 0
    solver_bytes: int = 0  # that the solver counts, over all ranks
    growth: float = 0.0  # of the peak of memory from before the mesh to after the solve, bytes over all ranks
    seconds: float = 0.0
    largest_phi: float = 0.0
    phi: Sequence[np.ndarray] | None = None  # per level, in the order of the cells
    ghosts: Sequence[np.ndarray] | None = (
        None  # behind the six faces, where there is one level; nan if they are not open
    )


def solve(comm: Any, case: Case, wants_phi: bool = True) -> Outcome:
    """Run the program of a case on the ranks of `comm`; whole on rank 0. Collective."""
    import amrpic  # noqa: F401  so that its own memory does not count

    program = compile(case.program(), "<case>", "exec")  # takes 7 MB itself where thousands of boxes are written out
    before, start = _status("VmRSS"), time.perf_counter()
    _forget_peak()
    out = Outcome()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            names: dict[str, Any] = {}
            exec(program, names)
            solver, phi, report = names["solve"](comm, case.max_grid_size, backends.executed(case.backend))
    except Exception as raised:
        out.error = f"{type(raised).__name__}: {raised}"
    errors = [error for error in comm.allgather(out.error) if error]
    if errors:
        same = len(errors) == comm.size and len(set(errors)) == 1
        out.error = errors[0] if same else f"DifferentErrors: {errors}"
        return out
    out.seconds = time.perf_counter() - start
    out.growth = comm.allreduce(max(0.0, _status("VmHWM") - before))
    out.solver_bytes = comm.allreduce(solver.native.backend_bytes)
    out.converged, out.reason = report.converged, report.reason
    out.cycles, out.residuals = report.cycles, list(report.residuals)
    out.accelerated = "acceleration" in report.seconds
    out.cells = sum(phi.hierarchy.cells(level) for level in range(phi.hierarchy.levels))
    out.boxes = sum(len(phi.hierarchy.boxes(level)) for level in range(phi.hierarchy.levels))
    out.largest_phi = phi.max_abs()
    if wants_phi:
        out.phi = _in_order(comm, phi)
        if case.has_open and not case.levels:
            from open_walls import density, planes_of

            out.ghosts = planes_of(density(phi.hierarchy, case.charges()))
    return out


def _in_order(comm: Any, phi: Any) -> list[np.ndarray] | None:
    """The values of each level in the order of their cells, on rank 0, whatever the boxes."""
    parts = comm.gather([(p.level, p.lower, np.array(p.data)) for p in phi.patches])
    if parts is None:
        return None
    values: list[list[np.ndarray]] = [[] for _ in range(phi.hierarchy.levels)]
    places: list[list[np.ndarray]] = [[] for _ in range(phi.hierarchy.levels)]
    for level, lower, data in (patch for part in parts for patch in part):
        index = np.indices(data.shape, dtype=np.int64)
        values[level].append(data.ravel())
        places[level].append(np.ravel(sum((index[d] + lower[d]) << 21 * d for d in range(3))))
    return [np.concatenate(v)[np.argsort(np.concatenate(p))] for v, p in zip(values, places, strict=True)]


def _status(name: str) -> float:
    """A line of this process' status in bytes."""
    with open("/proc/self/status") as lines:
        return next(1024.0 * int(line.split()[1]) for line in lines if line.startswith(name))


def _forget_peak() -> None:
    with open("/proc/self/clear_refs", "w") as peak:
        peak.write("5")
