"""Random Poisson problems: the answer and its cost may not depend on ranks, boxes, backend or instruction set.

    python tests/support/fuzz.py --cases 200 --seed 7        # a table, and each failure as a few lines to paste
    python tests/support/fuzz.py --seed 7 --only 31          # one case again

Every case is solved as drawn and, at the same time, on one rank, matrix-free, in boxes of the default size. `fuzz_draw`
tells what is drawn, `judge` what must hold; the ranks live on between cases (`fuzz_pool`).
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import secrets
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

sys.path.insert(1, str(Path(__file__).parents[1]))  # where exact answers are; pytest knows it

from fuzz_case import TOLERANCE, Case, Outcome
from fuzz_draw import LARGE, SMALL, Size, draw, plainer
from fuzz_pool import SANITIZED, Broken, Pool
from lattice_between_faces import LatticeBetweenFaces, counted_at_ghosts, ghost_errors

# Goals: aspect ratio of the cells up to which so many cycles to 1e-10 are allowed.
CYCLE_LIMITS = ((1.0, 9), (10.0, 12), (math.inf, 16))
ONE_LEVEL = 12  # the most without refinement
VARIATION = 1  # cycles that a case may differ from its reference
# More of both where refined levels of cells longer than 1:10 meet axes along which no wall holds the potential: there the
# rows of all levels at once are up to 7/4 as stiff, per level, as the coarser one believes (docs/theory.md, "Slow cycles").
# Of 96 such cases (seed 49) none took more than 16 cycles.
LOOSE_CYCLES, LOOSE_VARIATION = 4, 2
# More cycles where blocks of so few cells may leave narrow gaps, whose fits sweeps do not see (docs/theory.md); 13 were seen
# on scattered holes of one block, 10 behind last blocks of two cells.
SMALL_BLOCKS, GAP_CYCLES = 4, 4
# Memory of a matrix-free solve: potential, charge, solver, plans for each box, which copies of levels of long cells have
# too, those of few cells whole on each rank, what Python holds; and sixteen corrections with what they do to the residual,
# where slow cycles are combined (docs/theory.md, "Slow cycles"). Around small blocks any coarse face may lie in a gap like
# no other, whose fit weighs up to 168 fine cells, 40 bytes each. Each further rank has tables of its own for open faces.
BYTES_PER_CELL, BYTES_PER_BOX, BYTES_PER_FIT, BYTES_FREE = 100, 4000, 168 * 40, 100e6
BYTES_PER_OPEN_RANK = 10e6
BYTES_OF_ACCELERATION = 128  # per cell
BYTES_PER_ROW = 4000  # of a domain a few cells wide and long: rows are padded, and each has neighbours and coefficients

# Ghosts at open faces of one level, and the potential and field that they make, against the lattice; of the largest values.
# More in boxes a few cells thin, where conductors leave little of the potential. Of 133 cases that are not so thin (seed 92313)
# the median of the error of the field is 6e-6, the largest 3.9e-4; of thin ones the largest is 3.7e-4.
LATTICE_BOUNDS = {"ghosts": 1.5e-4, "phi": 1e-4, "field": 5e-4}
THIN_BOUNDS = {"ghosts": 3e-4, "phi": 2e-4, "field": 6e-4}
THIN = 8  # cells
LATTICE_CELLS = 40_000  # for more the exact potential takes long

# Refusals that are documented: of cells for which there is no method or no memory.
REFUSALS = (
    "too much for the table of the lattice Green's function",
    "give the base numbers of cells with more factors of two",
)
GOALS = ("unconverged", "phi", "lattice", "memory", "cycles differ", "cycles")  # failures that are no crash
PER_POOL = 50  # cases before the processes are started anew with another instruction set
TIMEOUT = {SMALL: 30.0, LARGE: 120.0}


@dataclass
class Failure:
    """What went wrong with a case."""

    kind: str
    text: str


@dataclass
class Result:
    """A case, how it and its reference went, and what failed, the gravest first."""

    number: int
    case: Case
    found: Outcome | None = None
    plain: Outcome | None = None
    failures: list[Failure] = field(default_factory=list)
    difference: float = 0.0  # of the potentials, relative to the largest

    @property
    def kind(self) -> str:
        return self.failures[0].kind if self.failures else ""

    @property
    def refused(self) -> bool:
        return any(o is not None and o.error and is_refusal(o) for o in (self.found, self.plain))


def limit(case: Case) -> int:
    """Cycles that the aspect ratio allows."""
    cycles = next(cycles for aspect, cycles in CYCLE_LIMITS if case.aspect_ratio <= aspect * (1 + 1e-9))
    if not case.levels:
        return min(cycles, ONE_LEVEL)
    gaps = case.levels and shortest_block(case) <= SMALL_BLOCKS
    return cycles + (LOOSE_CYCLES if case.levels and is_loose(case) else GAP_CYCLES if gaps else 0)


def shortest_block(case: Case) -> int:
    """Cells along the shortest edge of a block: the last ones of an axis may be shorter than the others."""
    ends = (n * 2**level % case.blocking_factor for n in case.cells for level in range(1, len(case.levels) + 1))
    return min((end for end in ends if end), default=case.blocking_factor)


def is_loose(case: Case) -> bool:
    """Whether nothing holds the potential along some axis of a mesh of long cells."""
    return case.aspect_ratio > 10 and any(not {"dirichlet", "open"} & set(pair) for pair in case.boundary)


def cycles_taken(case: Case, outcome: Outcome) -> int:
    """Cycles to the tolerance, or to within ten times of what rounding leaves, where the residual may fall in steps.

    That is the least residual where the solver ended for its rounding; whether it ended too early, the potential tells.
    """
    spacing = case.edges / 2 ** len(case.levels)
    floor = np.finfo(float).eps * np.sum(2 / spacing**2) * outcome.largest_phi / (case.largest_source() or 1.0)
    if "rounding" in outcome.reason:
        floor = max(floor, min(outcome.residuals))
    return next((n for n, r in enumerate(outcome.residuals) if r <= max(TOLERANCE, 10 * floor)), outcome.cycles)


def allowed_cycles(case: Case, outcome: Outcome) -> int:
    """Cycles that are allowed; a guess that makes the residual larger takes one more for every digit."""
    first = outcome.residuals[0] if len(outcome.residuals) else 1.0
    return limit(case) + max(0, math.ceil(math.log10(first))) if first > 0 else limit(case)


def is_refusal(outcome: Outcome) -> bool:
    return outcome.error.startswith("SolverError") and any(text in outcome.error for text in REFUSALS)


def allowed_difference(case: Case, plain: Outcome) -> float:
    """What two potentials with residuals below the tolerance may differ by, V.

    A residual r makes an error of at most |r| times the largest potential of a right-hand side of 1 V/m², which no walls make
    larger than the square of the width over 2 (one Dirichlet or open wall), 8 (two) or, for what has no mean, 4, the least
    over the axes that have such walls. Tolerances refer to the right-hand side with its open walls. The composite operator
    does not obey a maximum principle at interfaces, so four such errors are allowed; and ten tolerances of the potential. What
    rounding leaves of a residual may make thirty ε of that largest potential over h², of the potential.
    """
    widths = case.edges * case.cells
    bounds = []
    wall = 0.0
    finest = case.edges / 2 ** len(case.levels)
    for axis, pair in enumerate(case.boundary):
        fixed = sum(face in ("dirichlet", "open") for face in pair)
        if fixed:
            bounds.append(widths[axis] ** 2 / (2 if fixed == 1 else 8))
        wall += 8 / 3 / finest[axis] ** 2 * plain.largest_phi * ("open" in pair)
    if case.screening:
        bounds.append(1 / case.screening**2)
    solution = min(bounds) if bounds else float(np.sum(widths**2)) / 4
    size = case.largest_source() + wall
    rounding = 30 * np.finfo(float).eps * solution / float(finest.min()) ** 2
    return max(10 * TOLERANCE * plain.largest_phi, 4 * TOLERANCE * solution * size, rounding * plain.largest_phi)


def judge(case: Case, found: Outcome, plain: Outcome) -> tuple[list[Failure], float]:
    """What fails, the gravest first, and the relative difference of the potentials."""
    failures: list[Failure] = []

    def fail(kind: str, text: str) -> None:
        if kind not in [failure.kind for failure in failures]:
            failures.append(Failure(kind, text))

    difference = 0.0
    for name, outcome in (("", found), ("reference: ", plain)):
        if outcome.error and not is_refusal(outcome):
            fail(outcome.error.split(":")[0], name + outcome.error)
    if found.error or plain.error:
        return failures, difference
    for name, outcome in (("", found), ("reference: ", plain)):
        if not outcome.converged:
            fail("unconverged", f"{name}{outcome.reason} after {outcome.cycles} cycles: {shown(outcome.residuals)}")
    if found.phi is not None and plain.phi is not None:
        pairs = list(zip(found.phi, plain.phi, strict=True))
        if not all(np.isfinite(mine).all() for mine, _ in pairs):
            fail("phi", "not finite")
        worst = max(float(np.abs(mine - other).max()) for mine, other in pairs)
        difference = worst / plain.largest_phi if plain.largest_phi else worst
        if found.converged and plain.converged and worst > (bound := allowed_difference(case, plain)):
            fail("phi", f"differs by {worst:.2e} V, allowed are {bound:.2e} V, largest {plain.largest_phi:.2e} V")
    if found.ghosts is not None and case.total_cells <= LATTICE_CELLS:
        errors = lattice_errors(case, found.ghosts)
        bounds = THIN_BOUNDS if min(case.cells) < THIN else LATTICE_BOUNDS
        if not all(errors[name] <= bound for name, bound in bounds.items()):
            fail("lattice", ", ".join(f"{name} {error:.1e}" for name, error in errors.items()))
    for name, outcome, matrix_free in (("", found, case.backend == "matrix-free"), ("reference: ", plain, True)):
        per_cell = BYTES_PER_CELL + BYTES_OF_ACCELERATION * outcome.accelerated
        solved = case.plain() if name else case
        boxes = outcome.boxes * (1 + solved.ranks if case.levels and case.aspect_ratio > 1.8 else 1)
        fits = solved.most_fits_in_gaps if case.blocking_factor <= SMALL_BLOCKS else 0
        rows = outcome.cells // case.cells[0] if max(case.cells) > 256 else 0
        tables = BYTES_PER_OPEN_RANK * (solved.ranks - 1) * case.has_open
        most = (
            per_cell * outcome.cells
            + BYTES_PER_BOX * boxes
            + BYTES_PER_FIT * fits
            + BYTES_PER_ROW * rows
            + tables
            + BYTES_FREE
        )
        if matrix_free and outcome.growth > most:
            fail("memory", f"{name}{outcome.growth / 1e6:.0f} MB for {outcome.cells} cells, at most {most / 1e6:.0f}")
    # Compressed rows may take fewer. Around an odd number of cells they relax the last ones as colours of their own; what is
    # constant along axes of short cells that nothing holds loses digits in the single precision of the other cycle; and that
    # one's exact bottom has one ghost for each open wall, also if some cells there are covered by finer ones.
    odd_ring = any("periodic" in pair and n % 2 for n, pair in zip(case.cells, case.boundary, strict=True))
    open_bottom = math.prod(case.cells) <= (512 if case.levels else 64) and case.has_open
    taken, reference = cycles_taken(case, found), cycles_taken(case, plain)
    fewer = case.backend == "crs" and (odd_ring or open_bottom or is_loose(case)) and taken < reference
    if abs(taken - reference) > (LOOSE_VARIATION if case.levels and is_loose(case) else VARIATION) and not fewer:
        fail("cycles differ", f"{taken}, reference {reference}")
    for name, outcome, cycles in (("", found, taken), ("reference: ", plain, reference)):
        if cycles > (most_cycles := allowed_cycles(case, outcome)):
            fail("cycles", f"{name}{cycles} cycles, at most {most_cycles}: {shown(outcome.residuals)}")
    return failures, difference


def lattice_errors(case: Case, ghosts: Sequence[np.ndarray]) -> dict[str, float]:
    """Those of ghosts against the exact lattice potential; of values that charge of one sign would make."""
    counted = counted_at_ghosts(case.charges(), case.boundary)
    lattice = LatticeBetweenFaces(case.cells, case.spacing, case.boundary)
    exact, of_magnitudes = lattice(np.array([counted, abs(counted)]))
    return ghost_errors(ghosts, exact, of_magnitudes, case.spacing, case.boundary)


def shown(residuals: Sequence[float]) -> str:
    return " ".join(f"{r:.0e}" for r in residuals[:6]) + (f" … {residuals[-1]:.0e}" if len(residuals) > 6 else "")


class Fuzzer:
    """Runs cases; owns the processes."""

    def __init__(self, timeout: float, ignored: Sequence[str] = ()) -> None:
        self.timeout = timeout * (5 if SANITIZED else 1)
        self.ignored = ignored
        self.isa: str | None = None
        self.plain: Pool | None = None
        self.several: Pool | None = None

    def __enter__(self) -> Fuzzer:
        return self

    def __exit__(self, *_: object) -> None:
        self.renew()

    def renew(self) -> None:
        """End the processes, so that new ones run the next case."""
        for pool in (self.plain, self.several):
            if pool:
                pool.close()
        self.plain = self.several = None

    def pool(self, isa: str) -> Pool:
        """Four ranks that run with an instruction set."""
        if self.several is None or self.isa != isa:
            if self.several:
                self.several.close()
            self.several = Pool(4, {"AMRPIC_ISA": isa} if isa else {})
            self.isa = isa
            warm_up(self.several)
        return self.several

    def run(self, number: int, case: Case) -> Result:
        """Solve a case and its reference at the same time and compare."""
        if self.plain is None:
            self.plain = Pool(1, {"AMRPIC_TEST_BACKEND": "matrix-free"})
            warm_up(self.plain)
        pools = {"": self.pool(case.isa), "reference: ": self.plain}
        for name, pool in pools.items():
            part = case.plain() if name else case
            pool.submit("fuzz_case:solve", part.ranks, part, timeout=self.timeout)
        outcomes, broken = [], []
        for name, pool in pools.items():
            try:
                outcomes.append(pool.result())
                if said := pool.output():
                    broken.append(Failure("output", name + said))
            except Broken as error:
                broken.append(Failure(error.kind, f"{name}{error}"))
        if len(outcomes) < 2:
            return Result(number, case, failures=broken)
        found, plain = outcomes
        judged, difference = judge(case, found, plain)
        failures = [failure for failure in judged if failure.kind not in self.ignored]
        found.phi = plain.phi = found.ghosts = plain.ghosts = None
        return Result(number, case, found, plain, broken + failures, difference)

    def shrunk(self, result: Result, seconds: float = 60.0) -> Result:
        """The plainest case found in so much time that fails in the same way."""
        end = time.monotonic() + seconds
        again = True
        while again:
            again = False
            for case in plainer(result.case):
                if time.monotonic() > end:
                    return result
                tried = self.run(result.number, case)
                if tried.kind == result.kind:
                    result, again = tried, True
                    break
        return result


def warm_up(pool: Pool) -> None:
    """Let the processes load what solves need, so that no case is charged with it."""
    faces = ("open", "dirichlet")
    box = (((4, 4, 4), (11, 11, 11)),)
    for backend in ("crs", "matrix-free"):
        case = Case((8, 8, 8), boundary=(faces,) * 3, levels=(box,), blocking_factor=4, backend=backend)
        for ranks in {1, pool.ranks}:
            pool.call("fuzz_case:solve", ranks, case)


def instruction_sets() -> list[str]:
    """Those that were built and that this processor has, the plainest first; "" where one alone was built."""
    package = importlib.util.find_spec("amrpic")  # does not import it: MPI is for the processes that solve
    folders = [Path(folder) for folder in (package and package.submodule_search_locations) or ()]
    built = {path.name.split(".")[0] for folder in folders for path in folder.glob("_native_*.so")}
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    flags = set(next((line for line in text.splitlines() if line.startswith("flags")), "").split())
    out = ["v2"]
    if {"avx2", "fma", "bmi2"} <= flags:
        out.append("v3")
        if {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"} <= flags:
            out.append("v4")
    usable = [name for name in out if f"_native_{name}" in built]
    return usable if len(usable) > 1 else [""]


def cases(seed: int, numbers: Sequence[int], size: Size) -> Iterator[tuple[int, Case]]:
    """The cases of a seed; the instruction set changes every so many, with the processes."""
    for number in numbers:
        sets = instruction_sets()
        isa = sets[(seed + number // PER_POOL) % len(sets)]
        yield number, replace(draw(seed, number, size), isa=isa)


def run_all(
    seed: int,
    numbers: Sequence[int],
    size: Size = SMALL,
    shrink: int = 2,
    seconds: float = math.inf,
    verbose: bool = False,
    ignored: Sequence[str] = (),
) -> tuple[list[Result], list[tuple[Result, Result]]]:
    """Run cases for at most so many seconds; all results, and pairs of a failure and what it shrank to: at most `shrink` of a
    kind and class of aspect ratio."""
    start, results, small = time.monotonic(), [], []
    counts: dict[tuple[str, int], int] = {}
    with Fuzzer(TIMEOUT[size], ignored) as fuzzer:
        for done, (number, case) in enumerate(cases(seed, numbers, size)):
            if time.monotonic() - start > seconds:
                print(f"{done} of {len(numbers)} cases in {seconds:.0f} s; the rest was left out", flush=True)
                break
            if done and done % PER_POOL == 0:
                fuzzer.renew()
            result = fuzzer.run(number, case)
            results.append(result)
            if verbose or result.failures:
                print(line(seed, result), flush=True)
            key = result.kind, limit(case)
            counts[key] = counts.get(key, 0) + 1
            if result.failures and counts[key] <= shrink:
                small.append((result, fuzzer.shrunk(result)))
                print(explained(seed, *small[-1]), flush=True)
    return results, small


def line(seed: int, result: Result) -> str:
    """A case and how it went."""
    case, found, plain = result.case, result.found, result.plain
    cycles = f"{found.cycles}/{plain.cycles} cycles" if found and plain else "–"
    seconds = f"{max(found.seconds, plain.seconds):.1f} s" if found and plain else "–"
    walls = " ".join(a[0] + b[0] for a, b in case.boundary)
    failures = "; ".join(f"{f.kind.upper()} {f.text}" for f in result.failures) or (
        "refused" if result.refused else "ok"
    )
    return (
        f"seed {seed} case {result.number}: {case.cells} {walls} 1:{case.aspect_ratio:.3g} {len(case.levels)} levels "
        f"{case.total_cells} cells bf {case.blocking_factor} boxes {case.max_grid_size} {case.ranks} ranks {case.backend} "
        f"{case.isa} guess {case.guess}: {cycles} {seconds} {failures}"
    )


def explained(seed: int, result: Result, small: Result) -> str:
    """A failure as lines to paste."""
    failures = "\n".join(f"{f.kind}: {f.text}" for f in small.failures).replace("\n", "\n# ")
    return f"\n# seed {seed}, case {result.number}, shrunk:\n# {failures}\n{small.case.snippet()}"


def summary(seed: int, results: Sequence[Result]) -> str:
    """A table of cycles by aspect ratio, extremes, and failures by kind."""
    lines = [f"seed {seed}: {len(results)} cases, {sum(r.refused for r in results)} refused"]
    lines.append(f"{'aspect ratio':>14} {'cases':>6} {'median':>7} {'largest':>8} {'goal':>5}   cycles without a guess")
    lower = 0.0
    for upper, goal in CYCLE_LIMITS:
        inside = [r for r in results if lower * (1 + 1e-9) < r.case.aspect_ratio <= upper * (1 + 1e-9)]
        cycles = [o.cycles for r in inside for o in (r.found, r.plain) if o and not o.error and r.case.guess == "none"]
        if cycles:
            name = "1" if upper == 1 else f"{lower:g} to {upper:g}"
            lines.append(f"{name:>14} {len(inside):>6} {statistics.median(cycles):>7g} {max(cycles):>8} {goal:>5}")
        lower = upper
    both = [(r, o) for r in results for o in (r.found, r.plain) if o and not o.error]
    if both:
        lines.append(f"largest difference of phi: {max(r.difference for r in results):.1e} of the largest")
        free = [(r, o) for r, o in both if o is r.plain or r.case.backend == "matrix-free"]
        lines.append(f"largest memory of a matrix-free solve: {max(o.growth for _, o in free) / 1e6:.0f} MB")
        lines.append(f"longest solve with its set-up: {max(o.seconds for _, o in both):.1f} s")
    kinds: dict[str, list[int]] = {}
    for r in results:
        for failure in r.failures:
            kinds.setdefault(failure.kind, []).append(r.number)
    for kind, numbers in sorted(kinds.items()):
        lines.append(f"{kind:>14} {len(numbers):>6}   cases {' '.join(map(str, numbers[:30]))}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, help="default: a fresh one")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of cases")
    parser.add_argument("--large", action="store_true", help="up to 300,000 cells instead of 40,000")
    parser.add_argument("--shrink", type=int, default=2, help="failures to shrink of a kind and class of aspect ratio")
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after so long")
    parser.add_argument("--verbose", action="store_true", help="a line for every case")
    parser.add_argument("--only-crashes", action="store_true", help="whatever the cycles, potential and memory are")
    chosen = parser.parse_args()
    seed = secrets.randbelow(10**6) if chosen.seed is None else chosen.seed
    print(f"seed {seed}", flush=True)
    numbers = chosen.only or range(chosen.cases)
    results, _ = run_all(
        seed,
        numbers,
        LARGE if chosen.large else SMALL,
        chosen.shrink,
        chosen.seconds,
        chosen.verbose or chosen.only is not None,
        GOALS if chosen.only_crashes else (),
    )
    print(summary(seed, results))
    sys.exit(any(result.failures for result in results))


if __name__ == "__main__":
    main()
