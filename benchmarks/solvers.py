"""Measure every choice of the solver's menu, and write a report: `make solvers`.

One thing at a time is varied from the default. Each row converges to 1e-10 to the default's potential, or is refused at
construction with the reason; any other row makes the exit status 1.
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.errors import SolverError
from amrpic.pic.step import begin
from amrpic.scene import solver_options
from amrpic.stages.poisson import BaseSetup, PoissonSolver
from measuring import ENVIRONMENT, ROOT, RUNNER, work_unit

sys.path.insert(0, str(ROOT / "tests" / "support"))
from static_case import EPS0, STATIC, static_hierarchy

TOLERANCE = 1e-10
SAME = 1e-8  # largest difference of two potentials over the largest potential that counts as none

Function = Callable[..., np.ndarray]
Options = dict[str, Any]


# ---- the cases ----


@dataclass
class Problem:
    """A charge density, and the potential on Dirichlet faces if it has any."""

    rho: amrpic.Field
    values: Function | None = None

    @property
    def cells(self) -> list[int]:
        return [self.rho.hierarchy.cells(level) for level in range(self.rho.hierarchy.levels)]


def static(comm: MPI.Comm, quick: bool) -> Problem:
    """`static 64`: the unit cube of 64³ cells, two nested cubes refined, a Gaussian charge, given potential on the faces."""
    hierarchy = static_hierarchy(comm, 16 if quick else 64, 24)
    return Problem(amrpic.Field(hierarchy).fill(STATIC.density), STATIC.potential)


def ten_bunches(comm: MPI.Comm, quick: bool) -> Problem:
    """`ten_bunches`: examples/ten_bunches.toml with open faces, on a base of 48³ cells in place of 96³, two refined levels in
    place of three, and 20 000 particles to a bunch."""
    cells, levels = (16, 1) if quick else (48, 2)
    overrides = [f"domain.cells={cells}", f"refinement.levels={levels}", "bunches.0.particles=20000", "output.write=[]"]
    scene = amrpic.Scene.from_toml(ROOT / "examples" / "ten_bunches.toml", overrides)
    return Problem(begin(comm, scene)[0].rho)


def long_cells(comm: MPI.Comm, quick: bool) -> Problem:
    """`1:1:10`: a base of 64³ cells ten times as long as wide, its middle refined, a charge as long, open faces."""
    n = 16 if quick else 64
    domain = amrpic.Domain((0, 0, 0), (1, 1, 10), (n, n, n), "open")
    middle = [[((n // 2,) * 3, (3 * n // 2 - 1,) * 3)]]
    hierarchy = amrpic.Hierarchy(comm, domain, middle, max_grid_size=24)

    def density(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return EPS0 * np.exp(-((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z / 10 - 0.5) ** 2) / (2 * 0.06**2))

    return Problem(amrpic.Field(hierarchy).fill(density))


CASES: dict[str, Callable[[MPI.Comm, bool], Problem]] = {
    "static 64": static,
    "ten_bunches": ten_bunches,
    "1:1:10": long_cells,
}


# ---- the rows: the default, then one thing after the other ----


def rows(quick: bool) -> Iterator[tuple[str, list[Options]]]:
    """Yield the groups of the table: what is varied, and the options of each row; of few of them to be quick."""
    for group, choices in all_rows():
        yield group, [choices[0], *choices[1:][-1:]] if quick and group != "default" else choices


def all_rows() -> Iterator[tuple[str, list[Options]]]:
    """Yield the groups of the table: what is varied, and the options of each row."""
    yield "default", [{}]
    yield "backend", [{"backend": "matrix-free"}]
    yield "smoother", [{"smoother": name} for name in get_args(solver_options.Smoother)[1:]]
    yield (
        "sweeps",
        [
            *({"sweeps": pair} for pair in ((1, 1), (1, 2), (3, 3), (4, 4), (0, 4))),
            *({"smoother": "chebyshev", "sweeps": (degree, degree)} for degree in (3, 4)),
            {"smoother": "symmetric-gauss-seidel", "sweeps": (1, 1)},
        ],
    )
    yield (
        "relaxation",
        [
            *({"relaxation": factor} for factor in (1.0, 1.15, 1.35)),
            {"smoother": "gauss-seidel", "relaxation": 1.25},
            {"smoother": "jacobi", "relaxation": 1.25},
            {"smoother": "chebyshev", "relaxation": 0.8},
        ],
    )
    yield "prolongation", [{"prolongation": "constant"}, {"prolongation": "constant", "sweeps": (4, 4)}]
    yield (
        "krylov",
        [{"krylov": name, **more} for more in ({}, {"sweeps": (1, 1)}) for name in get_args(solver_options.Krylov)[1:]],
    )
    kinds = list(get_args(solver_options.BottomPreconditioner))
    aggregation = [kind for kind in kinds if kind.endswith("aggregation")]
    bottoms: list[Options] = [
        {},
        *({"bottom_preconditioner": kind} for kind in kinds),
        *({"bottom": "cg", "bottom_preconditioner": kind} for kind in ("none", "ilu", "smoothed-aggregation")),
        *({"bottom": "bicgstab", "bottom_preconditioner": kind} for kind in ("none", "ilu", "smoothed-aggregation")),
        *({"bottom": "multigrid", "bottom_preconditioner": kind} for kind in [*aggregation, "jacobi"]),
        {"bottom": "direct"},
        {"bottom": "direct", "bottom_preconditioner": "ilu"},
    ]
    yield (
        "bottom and its preconditioner, two multigrid levels below the base",
        [{"coarse_levels": 2, **options} for options in bottoms],
    )
    yield (
        "the base itself as the bottom",
        [{"coarse_levels": 0}, {"coarse_levels": 0, "bottom": "cg"}, {"coarse_levels": 0, "bottom": "direct"}],
    )


def label(options: Options, whole: bool = False) -> str:
    """Return a row's name; `whole`: with what its group has in common."""
    named = {name: value for name, value in options.items() if whole or name != "coarse_levels"} or options
    return ", ".join(f"{name} {value}" for name, value in named.items()) or "default"


@dataclass
class Measured:
    """What came of a row."""

    group: str
    options: Options
    refused: str = ""
    converged: bool = False
    cycles: int = 0
    seconds: float = 0.0  # of the faster of two solves, without the potential of open faces, which no option touches
    setup: float = 0.0  # s
    difference: float = 0.0  # of the potential from the default's, over the largest

    @property
    def sound(self) -> bool:
        return bool(self.refused) or (self.converged and self.difference <= SAME)


@dataclass
class Table:
    """All rows of a case on so many ranks."""

    case: str
    ranks: int
    cells: list[int]
    unit: float  # s, the work unit of as many cells
    rows: list[Measured] = field(default_factory=list)
    contest: list[tuple[Options, float]] = field(default_factory=list)  # the fastest rows again, s
    reuse: list[tuple[str, float, float]] = field(default_factory=list)  # what, s of set-up without and with


# ---- a worker: all rows of one case, on all ranks ----


def measure(comm: MPI.Comm, case: str, quick: bool) -> Table:
    problem = CASES[case](comm, quick)
    unit = work_unit(comm, sum(problem.cells))
    table = Table(case, comm.size, problem.cells, unit.seconds)
    wanted: amrpic.Field | None = None
    for group, choices in rows(quick):
        for options in choices:
            row, phi = measured(problem, group, options, wanted)
            wanted = phi if wanted is None else wanted
            table.rows.append(row)
    table.contest = contest(problem, table.rows)
    table.reuse = reuse(problem)
    return table


def made(hierarchy: amrpic.Hierarchy, **options: Any) -> PoissonSolver:
    """Return a solver by compressed rows, which offer the whole menu, unless the options say otherwise. Collective."""
    return PoissonSolver(hierarchy, **{"tolerance": TOLERANCE, "backend": "crs", **options})


def measured(
    problem: Problem, group: str, options: Options, wanted: amrpic.Field | None
) -> tuple[Measured, amrpic.Field | None]:
    row = Measured(group, options)
    comm = problem.rho.comm
    comm.Barrier()
    start = time.perf_counter()
    try:
        solver = made(problem.rho.hierarchy, **options)
    except SolverError as refused:
        row.refused = str(refused)
        return row, None
    comm.Barrier()
    row.setup = time.perf_counter() - start
    row.seconds = np.inf
    for _ in range(2):
        start = time.perf_counter()
        phi, report = solver.solve(problem.rho, boundary_values=problem.values)
        seconds = time.perf_counter() - start - report.seconds.get("open boundary", 0.0)
        row.seconds = min(row.seconds, comm.allreduce(seconds, op=MPI.MAX))
    row.converged, row.cycles = report.converged, report.cycles
    if wanted is not None:
        row.difference = difference(phi, wanted)
    return row, phi


def contest(problem: Problem, rows: list[Measured]) -> list[tuple[Options, float]]:
    """Return the seconds of the default and of the three fastest other rows by compressed rows, in turns, best of three."""
    others = sorted(
        (row for row in rows[1:] if row.converged and "backend" not in row.options), key=lambda row: row.seconds
    )
    choices: list[Options] = [{}, *(row.options for row in others[:3])]
    hierarchy, comm = problem.rho.hierarchy, problem.rho.comm
    solvers = [made(hierarchy, **options) for options in choices]
    best = [np.inf] * len(solvers)
    for _, (number, solver) in itertools.product(range(3), enumerate(solvers)):
        comm.Barrier()
        start = time.perf_counter()
        _, report = solver.solve(problem.rho, boundary_values=problem.values)
        seconds = time.perf_counter() - start - report.seconds.get("open boundary", 0.0)
        best[number] = min(best[number], comm.allreduce(seconds, op=MPI.MAX))
    return list(zip(choices, best, strict=True))


def difference(phi: amrpic.Field, wanted: amrpic.Field) -> float:
    levels = range(phi.hierarchy.levels)
    apart = max(float(np.abs(phi.array(l) - wanted.array(l)).max(initial=0.0)) for l in levels)
    return phi.comm.allreduce(apart, op=MPI.MAX) / wanted.max_abs()


def reuse(problem: Problem) -> list[tuple[str, float, float]]:
    """Return what keeping the base's set-up saves: seconds of set-up and of the first solve's open faces, without and with."""
    out = []
    hierarchy, comm = problem.rho.hierarchy, problem.rho.comm
    for name, levels in (("default", None), ("the base itself as the bottom", 0)):
        kept: BaseSetup | None = None
        seconds: list[float] = []
        for _ in range(2):
            comm.Barrier()
            start = time.perf_counter()
            solver = made(hierarchy, tolerance=0.5, reuse=kept, coarse_levels=levels)
            _, report = solver.solve(problem.rho, boundary_values=problem.values)
            own = time.perf_counter() - start - sum(report.seconds.values()) + report.seconds.get("open boundary", 0.0)
            seconds.append(comm.allreduce(own, op=MPI.MAX))
            kept = solver.base_setup
        out.append((name, seconds[0], seconds[1]))
    return out


# ---- the document ----


def document(tables: list[Table]) -> str:
    parts = [HEAD]
    for table in tables:
        sizes = " + ".join(f"{cells:,}".replace(",", " ") for cells in table.cells)
        parts.append(
            f"\n## {table.case}, {table.ranks} rank{'s' * (table.ranks > 1)}\n\n"
            f"{(CASES[table.case].__doc__ or '').strip()}\n\nCells per level: {sizes}. One work unit takes "
            f"{table.unit * 1e3:.3g} ms, {table.unit / sum(table.cells) * 1e9:.2f} ns per cell. {verdict(table)}\n"
        )
        parts.append(COLUMNS)
        for group, members in itertools.groupby(table.rows, key=lambda row: row.group):
            if group != "default":
                parts.append(f"| **{group}** | | | | | |\n")
            parts.extend(line(row, table.unit) for row in members)
        parts.append("\n")
        for name, without, having in table.reuse:
            parts.append(
                f"Set-up, with the tables of open faces where there are any, {name}: {without:.2f} s, and {having:.2f} s where "
                "the base's is reused.\n"
            )
    return "".join(parts) + TAIL


def line(row: Measured, unit: float) -> str:
    if row.refused:
        return f"| {label(row.options)} | refused: {row.refused} | | | | |\n"
    return (
        f"| {label(row.options)} | {row.cycles}{'' if row.converged else ' (not converged)'} | {row.seconds:.2f} "
        f"| {row.seconds / unit:.0f} | {row.setup:.2f} | {row.difference:.0e} |\n"
    )


def verdict(table: Table) -> str:
    """How the default stands among the rows that converge."""
    if not table.contest:
        return ""
    (_, default), *others = table.contest
    listed = "; ".join(f"{label(options, whole=True)}: {seconds / table.unit:.0f}" for options, seconds in others)
    return (
        f"In turns with the three fastest other rows, best of three, the default takes {default / table.unit:.0f} work units "
        f"({listed})."
    )


COLUMNS = """
| choice | cycles | solve, s | work units | set-up, s | φ against the default's |
|---|---|---|---|---|---|
"""

HEAD = f"""# The solver's menu, measured

Made by `make solvers` (`python benchmarks solvers`), which fails unless every row below converges to a residual of
{TOLERANCE:.0e} (max norm) to the default's potential within {SAME:.0e} of its largest value, or is refused at construction.
What the options mean, and why the defaults are what they are: `[solver]` in [scene.md](../scene.md).

The menu is that of compressed rows (`backend = "crs"`), which offer all of it; without matrices there is one choice, the
row "backend matrix-free". Each row differs from the default with compressed rows in what it names. *Solve* is the faster
of two solves from a zero guess, without the potential of open faces, which no option touches; *set-up* is the solver's
construction. A *work unit* is the time of one plain, vectorised 7-point apply in double precision on one array with as
many cells as the hierarchy, best of five, in the same run, or that of its 24 bytes per cell at the bandwidth of a triad
out of cache, if that is less. Times are of one run on a machine of two cores that others
used as well: only the comparison in turns above each table tells small differences.

With as many multigrid levels below the base as it has factors of two, the default, the bottom has few cells and every
bottom solver does the same; so they are compared with two levels below the base. A "bottom" row without a preconditioner
has smoothed aggregation.
"""

TAIL = """
## What was found on the way

- **Structured aggregation works** in Trilinos 13.2, though not by MueLu's plain parameter list, whose `aggregation: type`
  does not know it. It takes a list of factories: `StructuredAggregationFactory` (`aggregation: mode` "uncoupled", order 0,
  output "Aggregates"), whose `lCoarseNodesPerDim` a `CoordinatesTransferFactory` with `structured aggregation` hands to the
  next level, both named in `Hierarchy`/`All` as the makers of `lCoarseNodesPerDim`, `lNodesPerDim` and `numDimensions`; and
  in `user data` "int numDimensions" and "Array<LO> lNodesPerDim". Rows must be in the lexicographic order of the mesh,
  which the bottom is gathered in. The list is in `native/solver/options.cpp`.
- **KLU2** gives wrong answers, silently, for a matrix with rows on two ranks. The bottom is gathered by every rank and
  factored by it alone, where it is right; it is refused beyond 10 000 cells, since 32³ take it 11 s. Singular problems are
  solved by it too: the first diagonal entry is doubled, which for a charge without a mean picks the potential that vanishes
  there.
- **CG** is refused unless the bottom's matrix is symmetric entry by entry. It is not along axes with Dirichlet faces that
  no multigrid level coarsens: their quadratic ghosts touch two cells on one side only.
- **Long and flat cells** (1:1:10) took 100 cycles in a refined level, and flexible GMRES around them 24. Now such a level
  smooths by a V-cycle of its own over copies with fewer cells along the short axes, and levels below the base keep the
  base's ghosts along axes that they do not coarsen: 8 to 20 cycles,
  so no acceleration is switched on by itself.
- **The default**: the lines above the tables, in turns with the fastest other rows, tell how far it is from them; those rows
  differ from case to case, and between one rank and two.
- **Flexible GMRES** is run as generalised conjugate residuals, which give the same approximations and have the residual at
  hand in any norm; the residual of every cycle is computed anew from the potential, so that histories mean the same with
  and without.
"""


# ---- the command ----


def on_ranks(case: str, ranks: int, quick: bool) -> Table:
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "table.json"
        worker = [
            *RUNNER,
            "solvers",
            "--case",
            case,
            "--output",
            str(found),
            *(["--quick"] if quick else []),
        ]
        subprocess.run(["mpiexec", "-n", str(ranks), *worker], env={**os.environ, **ENVIRONMENT}, check=True)
        content = json.loads(found.read_text())
    content["rows"] = [Measured(**row) for row in content["rows"]]
    return Table(**content)


def run(
    output: Annotated[Path, "the document to write"] = ROOT / "runs" / "reports" / "solvers.md",
    quick: Annotated[bool, "tiny cases and few rows, to see that it works"] = False,
    ranks: Annotated[tuple[int, ...], "numbers of them"] = (1, 2),
    case: Annotated[str | None, "measure this one on the ranks at hand, as JSON", CASES] = None,
) -> int:
    """Measure all cases, and write the document; 1 if a row does not hold."""
    if case is not None:
        table = measure(MPI.COMM_WORLD, case, quick)
        if MPI.COMM_WORLD.rank == 0:
            output.write_text(json.dumps(asdict(table)))
        return 0
    tables = []
    for name, count in itertools.product(CASES, ranks):
        print(f"{name} on {count} ranks", flush=True)
        tables.append(on_ranks(name, count, quick))
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(document(tables), encoding="utf-8")
    unsound = [(table, row) for table in tables for row in table.rows if not row.sound]
    for table, row in unsound:
        print(f"{table.case}, {table.ranks} ranks, {label(row.options)}: not the default's potential", file=sys.stderr)
    return int(bool(unsound))
