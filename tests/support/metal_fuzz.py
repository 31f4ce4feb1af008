# mypy: disable-error-code="arg-type"
"""Random bodies on random hierarchies, against a direct solve of an independent assembly (`composite_rows`).

python tests/support/metal_fuzz.py --cases 200 --seed 7      # a line for each failure, and a table
python tests/support/metal_fuzz.py --seed 7 --only 31        # one case again
"""

from __future__ import annotations

import argparse
import math
import secrets
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.constants import epsilon_0

import amrpic
from amrpic.errors import AmrpicError
from composite_rows import CompositeRows, CompositeSolution
from fuzz_case import Box
from fuzz_draw import draw_levels
from metal_cases import REFUSED, domain, tree

FEWEST, MOST = 1500, 20_000  # cells on all levels
WIDEST = 400_000  # cells that a level would have in the whole domain: the assembly has arrays of that size
BOUND = 1e-8  # of the largest potential; ten times that for charges and fields
MOST_CYCLES = 40


@dataclass(frozen=True)
class Case:
    """A domain with electrodes on several levels."""

    domain: amrpic.Domain
    levels: tuple[tuple[Box, ...], ...]
    blocking_factor: int
    max_grid_size: int
    electrodes: tuple[amrpic.Electrode, ...]
    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)
    screening: float = 0.0

    def hierarchy(self, comm: MPI.Comm = MPI.COMM_SELF) -> amrpic.Hierarchy:
        return amrpic.Hierarchy(comm, self.domain, self.levels, self.max_grid_size, self.blocking_factor)

    def solver(self, comm: MPI.Comm = MPI.COMM_SELF) -> amrpic.PoissonSolver:
        return amrpic.PoissonSolver(
            self.hierarchy(comm),
            tolerance=1e-12,
            electrodes=self.electrodes,
            stretch=self.stretch,
            screening=self.screening,
            max_cycles=100,
        )

    def rows(self) -> CompositeRows:
        return CompositeRows(
            self.domain, self.levels, self.electrodes, wall_potential, wall_slope, self.stretch, self.screening
        )


def wall_potential(x, y, z):
    return np.cos(2 * x) * np.sin(y + 0.5) + 0.5 * z**2


def wall_slope(x, y, z):
    return np.sin(3 * x - y) + z


def draw(seed: int, number: int) -> Case:
    """Return a case of a seed that a solver takes."""
    rng = np.random.default_rng([seed, number])
    while True:
        of = domain(rng)
        most = round(math.exp(rng.uniform(math.log(FEWEST), math.log(MOST))))
        blocking = int(rng.choice([2, 4, 4, 8]))
        levels = draw_levels(rng, tuple(of.cells), blocking, of.boundary, most)
        levels = tuple(level for n, level in enumerate(levels, 1) if math.prod(of.cells) * 8**n <= WIDEST)
        if not levels:
            continue
        boxes = max(blocking, int(rng.choice([blocking, 8, 16, 64])))
        edges = np.subtract(of.upper, of.lower)
        electrodes = []
        for name in range(rng.integers(1, 4)):
            shape = tree(rng, rng.uniform(0.05, 0.5, 3)).scaled(edges).moved(of.lower)
            floats = rng.random() < 0.3
            given = {"charge": rng.uniform(-1e-11, 1e-11)} if floats else {"voltage": rng.uniform(-2, 2)}
            electrodes.append(amrpic.Electrode(f"e{name}", shape, **given))
        stretch = (1.0, 1.0, float(rng.choice([1, 1, 1, 3])))
        screening = float(rng.choice([0, 0, 0, 1])) * math.exp(rng.uniform(-3, 3))
        case = Case(of, levels, blocking, boxes, tuple(electrodes), stretch, screening)
        if refusal(case) is None:
            return case


def refusal(case: Case) -> str | None:
    """Return why a solver does not take a case, of what is refused of random bodies."""
    try:
        case.solver()
    except AmrpicError as refused:
        if any(part in str(refused) for part in REFUSED):
            return str(refused)
        raise
    return None


@dataclass
class Result:
    """How a case went."""

    number: int
    cells: int
    levels: int
    cycles: int
    seconds: tuple[float, float]  # of the solve with its set-up, and of the direct one
    errors: dict[str, float]  # over what is allowed
    failure: str = ""


def run(number: int, case: Case) -> Result:
    """Solve a case both ways on one rank."""
    rng = np.random.default_rng(number)
    start = time.perf_counter()
    solver = case.solver()
    hierarchy = solver.hierarchy
    rho = amrpic.Field(hierarchy)
    rows_start = time.perf_counter()
    rows = case.rows()
    densities = [rng.normal(size=level.shape) * 5 * epsilon_0 for level in rows.levels]
    for patch in rho.patches:
        patch.data[...] = densities[patch.level][box_of(patch)]
    expected = rows.solve(densities)
    direct = time.perf_counter() - rows_start
    phi, report = solver.solve(rho, boundary_values=wall_potential, boundary_flux=wall_slope)
    efield = solver.electric_field(phi).components
    seconds = time.perf_counter() - start - direct
    cells = sum(hierarchy.cells(level) for level in range(hierarchy.levels))
    out = Result(number, cells, hierarchy.levels, report.cycles, (seconds, direct), {})
    out.errors = errors(rows, expected, densities, report, phi, efield)
    wrong = [f"{name} {error:.1e} of what is allowed" for name, error in out.errors.items() if not error <= 1]
    if not report.converged:
        wrong.insert(0, f"{report.reason} after {report.cycles} cycles")
    if report.cycles > MOST_CYCLES:
        wrong.append(f"{report.cycles} cycles")
    out.failure = "; ".join(wrong)
    return out


def box_of(patch) -> tuple[slice, ...]:
    return tuple(slice(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True))


def errors(
    rows: CompositeRows, expected: CompositeSolution, rho: Sequence[np.ndarray], report, phi, efield
) -> dict[str, float]:
    """Return the largest errors, each over what is allowed."""
    of_phi = expected.phi
    largest = max(abs(expected.unknowns[:-1]))
    of_domain = epsilon_0 * largest * float(min(np.subtract(rows.domain.upper, rows.domain.lower)))
    names = [electrode.name for electrode in rows.electrodes]
    charges = np.array([report.charges[name] for name in names])
    of_charges = expected.charges()
    volumes = [np.prod(level.spacing) for level in rows.levels]
    uncovered = [values[level.exists & ~level.covered] for values, level in zip(rho, rows.levels, strict=True)]
    inside = sum(values.sum() * volume for values, volume in zip(uncovered, volumes, strict=True))
    out = {
        "phi": difference(rows, phi, of_phi) / (BOUND * largest),
        "voltage": max(abs(np.array([report.voltages[name] for name in names]) - expected.voltages))
        / (BOUND * largest),
        "charge": max(abs(charges - of_charges)) / (10 * BOUND * max(of_domain, max(abs(of_charges)))),
    }
    fields = [expected.efield(axis) for axis in range(3)]
    strongest = max(float(abs(level).max(initial=0)) for field in fields for level in field)
    out["field"] = max(difference(rows, efield[d], fields[d]) for d in range(3)) / (10 * BOUND * strongest)
    if rows.screening == 0:
        balance = charges.sum() + inside + expected.through_walls()
        of_all = sum(abs(values).sum() * volume for values, volume in zip(uncovered, volumes, strict=True))
        out["Gauss"] = abs(balance) / (10 * BOUND * max(of_all, max(abs(of_charges))))
    return out


def difference(rows: CompositeRows, field, expected: Sequence[np.ndarray]) -> float:
    values = [np.zeros(level.shape) for level in rows.levels]
    for patch in field.patches:
        values[patch.level][box_of(patch)] = patch.data
    return max(
        float(abs(of_level[tuple(own.T)] - wanted).max(initial=0))
        for of_level, own, wanted in zip(values, rows.own, expected, strict=True)
    )


def run_all(seed: int, numbers: Sequence[int], seconds: float = math.inf) -> Iterator[Result]:
    """Yield how cases went, for at most so many seconds."""
    end = time.monotonic() + seconds
    for number in numbers:
        if time.monotonic() > end:
            return
        case = draw(seed, number)
        try:
            yield run(number, case)
        except AmrpicError as error:
            yield Result(number, 0, len(case.levels) + 1, 0, (0, 0), {}, f"{type(error).__name__}: {error}")


def line(seed: int, result: Result) -> str:
    return (
        f"seed {seed} case {result.number}: {result.levels} levels {result.cells} cells {result.cycles} cycles "
        f"{result.seconds[0]:.1f}/{result.seconds[1]:.1f} s {result.failure or 'ok'}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, help="default: a fresh one")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of cases")
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after so long")
    parser.add_argument("--verbose", action="store_true", help="a line for every case")
    chosen = parser.parse_args()
    seed = secrets.randbelow(10**6) if chosen.seed is None else chosen.seed
    results = []
    for result in run_all(seed, chosen.only or range(chosen.first, chosen.first + chosen.cases), chosen.seconds):
        results.append(result)
        if result.failure or chosen.verbose or chosen.only:
            print(
                line(seed, result),
                {k: f"{v:.1e}" for k, v in result.errors.items()} if result.failure else "",
                flush=True,
            )
    failed = [result.number for result in results if result.failure]
    cycles = [result.cycles for result in results]
    print(f"seed {seed}: {len(results)} cases, {len(failed)} failed {failed}; at most {max(cycles)} cycles")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
