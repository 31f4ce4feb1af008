"""What the fast path must show, and what it aims at, against what was measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from bases import base_of, base_ratio, is_base
from electrodes import SCENES as SCENES_OF_METAL
from electrodes import WIRES
from electrodes import name as metal_name
from gamma import CUBES, gamma_ratio, memory_ratio
from growth import BOXES as OVER_BOXES
from growth import law
from least_squares import ORDERS
from least_squares import record_name as stencil_record
from measuring import Record, figure
from orders import CASES as CELLS_OF_ORDERS
from orders import WALLS as WALLS_OF_ORDERS
from orders import name as order_name
from particles import BY_KOKKOS, OWN_B, SOLENOID, kernels_name, plain_name, record_name
from pic_step import IMPACTX_WALLS, step_name
from points import COLUMN_OF_KRATOS, MEMORY, beyond_cache_name, layout_name, points_step_name, solve_name, tangent_name
from points import record_name as product_name
from regridding import REGRIDDING, STAGES, points
from solving import BESIDE_DST, BOXES, EACH_BACKEND, IN_TURNS, assembly_name, following_name, name
from walls import walls_name

NAN = float("nan")
SAME = 1e-8  # largest difference of the backends' potentials over the largest that counts as none
OPERATORS = 8  # of a level, as compressed rows
REGRIDDED = 16_000  # boxes
ROUNDING = 1e-12  # of the largest residual of a rough potential, relative


@dataclass(frozen=True)
class Goal:
    """A figure with its bounds. `measured` is nan where the run did not measure it."""

    what: str
    measured: float
    must: float
    aim: float | None = None
    unit: str = ""
    at_least: bool = False  # whether more is better
    note: str = ""

    @property
    def verdict(self) -> str:
        """ "not measured", "missed", "met" or "aim met"."""
        if math.isnan(self.measured):
            return "not measured"
        if not self._reaches(self.must):
            return "missed"
        return "aim met" if self.aim is not None and self._reaches(self.aim) else "met"

    def _reaches(self, bound: float) -> bool:
        return self.measured >= bound if self.at_least else self.measured <= bound

    def bound(self, value: float | None) -> str:
        if value is None:
            return ""
        return f"{'≥' if self.at_least else '≤'} {value:g}{self.unit}"


class Found:
    """Records by name."""

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = {record.name: record for record in records}

    def units(self, name: str) -> float:
        """Median in work units; nan where it was not measured."""
        record = self.records.get(name)
        return NAN if record is None else record.units

    def in_units(self, what: str, names: Sequence[str], must: float, aim: float) -> Goal:
        """The goal for the least of these in work units."""
        return Goal(what, least(map(self.units, names)), must, aim, " WU")

    def seconds(self, name: str) -> float:
        record = self.records.get(name)
        return NAN if record is None else record.median

    def fact(self, name: str, what: str) -> float:
        record = self.records.get(name)
        return NAN if record is None else float(record.facts.get(what, NAN))

    def unknowns_per_second(self, name: str) -> float:
        return self.fact(name, "unknowns") / self.seconds(name)

    def points_per_second(self, name: str) -> float:
        return self.fact(name, "points") / self.seconds(name)

    def ratio(self, name: str, other: str) -> float:
        """How many times as long one takes as another. Of runs in turns the median of the ratios."""
        one, two = self.records.get(name), self.records.get(other)
        if one is None or two is None:
            return NAN
        if len(one.seconds) == len(two.seconds):
            return median(a / b for a, b in zip(one.seconds, two.seconds, strict=True))
        return one.median / two.median

    def of(self, what: str) -> list[Record]:
        return [record for record in self.records.values() if record.keys[0] == what]


def goals(records: Sequence[Record]) -> list[Goal]:
    """Return all goals in the order of the tables."""
    found = Found(records)
    return [
        goal
        for topic in (
            over_dst,
            solver,
            any_base,
            ranks,
            shapes,
            long_cells,
            memory,
            setup,
            boxes,
            metal,
            of_order_4,
            assembly,
            particles,
            step,
            backends,
            stencils,
            elements,
        )
        for goal in topic(found)
    ]


def stencils(found: Found) -> Iterator[Goal]:
    for order in ORDERS:
        mine, lattice, theirs = (stencil_record(order, kind) for kind in ("jittered", "lattice", "dgels"))
        what = f"least squares of order {order}"
        yield Goal(f"{what}, targets/s over LAPACK's dgels", found.ratio(theirs, mine), 5, 8, "×", at_least=True)
        peer = stencil_record(order, "pycompadre")
        yield Goal(f"{what}, targets/s over pycompadre", found.ratio(peer, mine), 20, 40, "×", at_least=True)
        apart = found.fact(peer, "largest difference of weights")
        yield Goal(f"{what}, weights beside pycompadre's", apart, 1e-10)
        yield Goal(f"{what}, lattice over jittered", found.ratio(mine, lattice), 0.5, 0.8, "×", at_least=True)
        memory = max(found.fact(one, "MiB beyond what is returned") for one in (mine, lattice))
        yield Goal(f"{what}, memory beyond what is returned", memory, 16, 2, " MiB")
    yield Goal(
        "least squares of order 2, a leaf of a mesh",
        1e6 * found.seconds("least squares, order 2, leaves"),
        1,
        0.3,
        " µs",
    )


def elements(found: Found) -> Iterator[Goal]:
    for problem in ("BP3", "BP4"):
        for degree, per_axis in ((2, 4), (3, 4), (4, 5)):
            layout = layout_name(degree, per_axis)
            record = found.records.get(product_name(problem, degree, layout))
            share = (
                NAN if record is None else 100 * record.facts["nominal flops"] / record.median / record.facts["peak"]
            )
            yield Goal(
                f"{problem} at points, degree {degree}, {layout}: nominal flops over the peak",
                share,
                50,
                70,
                " %",
                True,
            )
        mine, theirs = (product_name(problem, 2, layout_name(2, 3), who) for who in ("amrpic", "libCEED"))
        faster = found.unknowns_per_second(mine) / found.unknowns_per_second(theirs)
        yield Goal(f"{problem} at 27 points, degree 2, against libCEED's basis", faster, 25, 50, "×", at_least=True)
    for problem in ("BP1", "BP2", "BP3", "BP4"):
        for degree in (2, 3, 4):
            mine, theirs = (product_name(problem, degree, "Gauss", who) for who in ("amrpic", "libCEED"))
            faster = found.unknowns_per_second(mine) / found.unknowns_per_second(theirs)
            yield Goal(f"{problem} at Gauss points, degree {degree}, against libCEED", faster, 2, 4, "×", at_least=True)
    for who, must, aim in (("neo-Hookean", 0.6, 0.85), ("Ogden", 0.4, 0.6)):
        slower = found.ratio(tangent_name("BP4"), tangent_name(who))
        yield Goal(f"{who} tangent against BP4, points/s", slower, must, aim, "×", at_least=True)
    for degree in (1, 2):
        share = found.ratio(points_step_name(degree, "points"), points_step_name(degree, "Newton"))
        what = f"locate, migrate, sort and weigh, degree {degree}, over a Newton iteration"
        yield Goal(what, share, 0.5, 0.15, "×")
    ours, theirs = points_step_name(1, "Newton"), points_step_name(1, "Kratos")
    faster = found.points_per_second(ours) / found.points_per_second(theirs)
    yield Goal("a Newton iteration, degree 1, 64 points, against Kratos", faster, 8, 30, "×", at_least=True)
    apart = found.fact(COLUMN_OF_KRATOS, "difference")
    yield Goal("displacements of a column's first step beside Kratos's", apart, 1e-6)
    yield Goal(
        "memory of a run, degree 2, 64 points an element", found.fact(MEMORY, "bytes per point"), 400, 300, " B/point"
    )
    for cells, must, aim in ((16, 0.6, 0.3), (32, 0.35, 0.15)):
        share = found.ratio(solve_name(cells, "p-multigrid"), solve_name(cells, "jacobi"))
        yield Goal(f"p-multigrid over the diagonal, degree 2, contrast 800, {cells}³ elements", share, must, aim, "×")
    rates = {
        (ranks, size): found.fact(name, "points") / found.seconds(name)
        for ranks in (1, 2)
        for size in ("in cache", "beyond it")
        for name in (beyond_cache_name(ranks, size),)
    }
    beyond = rates[1, "beyond it"] / rates[1, "in cache"]
    yield Goal("7.4 million points against points in cache, each", beyond, 0.6, 0.8, "×", at_least=True)
    yield Goal(
        "7.4 million points, 2 ranks against 1",
        rates[2, "beyond it"] / rates[1, "beyond it"],
        1.8,
        1.95,
        "×",
        at_least=True,
    )


def solver(found: Found) -> Iterator[Goal]:
    bunch = name("bunch 64", 24, 1)
    yield found.in_units("bunch 64, boxes 24, to 1e-10", [bunch], 100, 57)
    yield Goal("bunch 64, boxes 24: cycles", found.fact(bunch, "cycles"), 8)
    for case in ("static 64", "static 128"):
        names = [name(case, boxes, 1) for boxes in (32, 64)]
        yield found.in_units(f"{case}, boxes 32 or 64, to 1e-10", names, 80, 50)
    for case in ("static 64", "static 128"):
        names = [name(case, boxes, 1, "discretization") for boxes in (32, 64)]
        yield found.in_units(f"{case}, to the discretization error", names, 45, 25)
        error = -least(-found.fact(n, "error over the converged one") for n in names)
        yield Goal(f"{case}: true error then, over the converged one", error, 1.05)


def over_dst(found: Found) -> Iterator[Goal]:
    for case, boxes, must, aim in (
        ("uniform 128", 64, 1.1, 1.0),
        ("static 64", 64, 1.5, 1.3),
        ("static 64", 24, 1.65, 1.5),
        ("static 128", 64, 1.5, 1.3),
        ("bunch 64", 24, 2.2, 1.9),
    ):
        record = found.records.get(name(case, boxes, 1, BESIDE_DST))
        each = NAN if record is None else record.over_dst
        yield Goal(f"{case}, boxes {boxes}, to 1e-10: time per cell over the DST's", each, must, aim, "×")


def any_base(found: Found) -> Iterator[Goal]:
    mine = [record for record in found.records.values() if is_base(record)]
    ratios = {base_of(record): base_ratio(found.records, record) for record in mine}
    above = {n: ratio for n, ratio in ratios.items() if n > 64}
    yield worst("bases above 64³: time per cell over that of the nearest 2^k or 3·2^k", above, 1.3)
    yield Goal("250³ against 256³, time per cell", ratios.get(250, NAN), 1.3, unit="×")


def long_cells(found: Found) -> Iterator[Goal]:
    mine = {record.name: record for record in found.of("gamma") if not record.name.endswith(CUBES)}
    ratios = {what.removeprefix("gamma, "): gamma_ratio(found.records, record) for what, record in mine.items()}
    yield worst("γ of 10 to 100: time per cell over that of cubes", ratios, 2.0, 1.6)
    memory = {what.removeprefix("gamma, "): memory_ratio(record) for what, record in mine.items()}
    yield worst("γ of 10 to 100: memory of the solver beyond φ and ρ over 40 B/cell + 100 MB", memory, 1.0)


def worst(what: str, values: Mapping[Any, float], must: float, aim: float | None = None) -> Goal:
    """The goal for the largest of several values, by name; of those that were skipped, infinite, it says so."""
    if not values:
        return Goal(what, NAN, must, aim, "×")
    at = max(values, key=lambda key: values[key])
    skipped = sum(math.isinf(value) for value in values.values())
    note = f"{skipped} of {len(values)} not done" if skipped else f"at {at}"
    return Goal(what, values[at], must, aim, "×", note=note)


def ranks(found: Found) -> Iterator[Goal]:
    one, two = (name("static 128", 32, ranks, IN_TURNS) for ranks in (1, 2))
    yield Goal("2 ranks against 1, static 128, boxes 32", found.ratio(one, two), 1.7, 1.9, "×", at_least=True)
    for case in ("static 64", "bunch 64"):
        counts = {
            int(record.facts["cycles"])
            for boxes in BOXES
            for ranks in (1, 2, 3, 4)
            if (record := found.records.get(name(case, boxes, ranks))) is not None
        }
        several = float(max(counts) - min(counts)) if counts else NAN
        listed = ", ".join(map(str, sorted(counts)))
        yield Goal(f"{case}: spread of cycles over boxes and 1 to 4 ranks", several, 0, note=f"cycles: {listed}")


def shapes(found: Found) -> Iterator[Goal]:
    for cells in ("1:1:10", "1:5:5"):
        ratio = found.ratio(name(f"{cells} 64", 32, 1), name("cubes 64", 32, 1))  # of as many cells
        yield Goal(f"cells {cells} against cubes, to 1e-10", ratio, 2, 1.3, "×")


def memory(found: Found) -> Iterator[Goal]:
    for record in found.of("memory"):
        if not record.cells:
            continue
        peak = float(record.facts["bytes per cell, peak"])
        yield Goal(f"{record.keys[1]}: memory of the solver beyond φ and ρ", peak, 40, 15, " B/cell")


def setup(found: Found) -> Iterator[Goal]:
    lists = found.ratio(name("bunch 64", 24, 1, "set-up"), name("bunch 64", 24, 1))
    yield Goal("bunch 64: set-up of a new mesh against a solve to 1e-10", lists, 0.1, unit="×")
    regrid, solve = (following_name("bunch 64", 24, what) for what in ("regrid", "1e-06 from zero φ"))
    yield Goal("bunch 64: regrid with φ carried over against a solve to 1e-6", found.ratio(regrid, solve), 1, unit="×")
    walls = found.ratio(walls_name(144, "open"), walls_name(144, "dirichlet"))
    yield Goal("open walls against grounded ones, ten_bunches 144", walls, 1.5, 1.15, "×")


def boxes(found: Found) -> Iterator[Goal]:
    """What each rank does with the boxes of all."""
    records = found.of(REGRIDDING)
    most = max((float(record.facts["bytes per box"]) for record in records), default=NAN)
    yield Goal("boxes: metadata of each", most, 200, unit=" B")
    by_stage = {stage: sorted(points(records, stage)) for stage in STAGES}
    for stage, measured in by_stage.items():
        exponent = law(stage, OVER_BOXES, measured).exponent if len(measured) > 1 else NAN
        yield Goal(f"boxes: exponent of {stage}", exponent, 1.1)
    sizes = [size for size, _ in by_stage["refine"]]
    regrid = sum(np.array([seconds for _, seconds in by_stage[stage]]) for stage in ("refine", "memory estimate"))
    inside = bool(sizes) and sizes[0] <= REGRIDDED <= sizes[-1]
    taken = np.exp(np.interp(np.log(REGRIDDED), np.log(sizes), np.log(regrid))) if inside else NAN
    yield Goal(f"boxes: a regrid of {REGRIDDED}", 1e3 * float(taken), 50, unit=" ms")


def metal(found: Found) -> Iterator[Goal]:
    for scene in SCENES_OF_METAL:
        beside, plain = (
            [metal_name(scene, has, what) for what in ("cycle", "solve", "set-up")] for has in (True, False)
        )
        yield Goal(
            f"{scene}: a cycle with electrodes over one without", found.ratio(beside[0], plain[0]), 1.25, unit="×"
        )
        if scene == WIRES:
            yield Goal(f"{scene}: cycles with electrodes", found.fact(beside[1], "cycles"), 20)
        else:
            yield Goal(
                f"{scene}: a solve with electrodes over one without", found.ratio(beside[1], plain[1]), 1.6, unit="×"
            )
            more = found.fact(beside[1], "cycles") - found.fact(plain[1], "cycles")
            yield Goal(f"{scene}: cycles more with electrodes", more, 2)
        yield Goal(f"{scene}: set-up with electrodes over a solve", found.ratio(beside[2], beside[1]), 1, unit="×")


def of_order_4(found: Found) -> Iterator[Goal]:
    for cells in CELLS_OF_ORDERS:
        for walls in WALLS_OF_ORDERS:
            second, fourth = (order_name(cells, walls, density) for density in ("order 2", "order 4"))
            case = f"order 4 beside order 2, static {cells}, {walls} walls"
            yield Goal(f"{case}: time", found.ratio(fourth, second), 1.9, unit="×")
            more = found.fact(fourth, "bytes per cell") - found.fact(second, "bytes per cell")
            yield Goal(f"{case}: more memory", more, 2, unit=" B/cell")


def assembly(found: Found) -> Iterator[Goal]:
    record = found.records.get(assembly_name("bunch 64", 24))
    each = NAN if record is None else 1e9 * record.median / record.cells / OPERATORS
    yield Goal("bunch 64: assembly of compressed rows, each row of an operator", each, 60, unit=" ns")


def particles(found: Found) -> Iterator[Goal]:
    for stage, few, many in (
        ("deposit", (0.5, 0.3), (0.6, 0.4)),
        ("gather+push", (0.4, 0.25), (0.35, 0.2)),
        ("migrate", (1.0, 0.7), (0.3, 0.15)),
        ("moments", (0.6, 0.4), (0.6, 0.4)),
    ):
        for count, (must, aim) in ((1_000_000, few), (10_000_000, many)):
            ours, plain = (record_name(one, count, "cloud-in-cell") for one in (stage, plain_name(stage)))
            what = f"{stage}, {count:.0e} particles: time over a plain loop's"
            yield Goal(what, found.ratio(ours, plain), must, aim, "×")
    for stage in (OWN_B, SOLENOID):
        plain, turned = (record_name(one, 1_000_000, "cloud-in-cell") for one in ("gather+push", stage))
        yield Goal(f"{stage}, against that without B", found.ratio(turned, plain), 1.6, unit="×")


def step(found: Found) -> Iterator[Goal]:
    for walls in IMPACTX_WALLS:
        ours, theirs = (found.seconds(step_name(who, 64, 1_000_000, walls)) for who in ("amrpic", "ImpactX"))
        yield Goal(f"whole step against ImpactX, {walls} walls", theirs / ours, 4, 8, "×", at_least=True)


def backends(found: Found) -> Iterator[Goal]:
    compared = [record for record in found.of("agreement") if len(record.facts["backends"]) > 1]
    worst = max((float(record.facts["difference"]) for record in compared), default=NAN)
    if not all(record.facts["converged"] for record in compared):
        worst = math.inf
    yield Goal(f"Kokkos and CRS against matrix-free: φ on {len(compared)} meshes of the verification", worst, SAME)
    apart = max((float(record.facts["residuals apart"]) for record in compared), default=NAN)
    yield Goal("Kokkos and CRS against matrix-free: residual of a rough φ on them", apart, ROUNDING)
    cycles = [dict(zip(record.facts["backends"], record.facts["cycles of each"], strict=True)) for record in compared]
    others = max((abs(each["kokkos"] - each["matrix-free"]) for each in cycles), default=NAN)
    yield Goal("Kokkos against matrix-free: cycles on them", others, 0)
    kernels, tuned = (name(*EACH_BACKEND, 1, f"by {backend}") for backend in ("kokkos", "matrix-free"))
    yield Goal(f"{EACH_BACKEND[0]}: solve by Kokkos against matrix-free", found.ratio(kernels, tuned), 2.5, unit="×")
    for stage in BY_KOKKOS:
        for count in (1_000_000, 10_000_000):
            kernels, tuned = (kernels_name(stage, count, each) for each in ("kokkos", "vectors"))
            yield Goal(f"{stage} by Kokkos against vectors, {count:.0e}", found.ratio(kernels, tuned), 2.5, unit="×")


def least(values: Iterable[float]) -> float:
    """The least of those that were measured."""
    return min((value for value in values if not math.isnan(value)), default=NAN)


def table(goals: Sequence[Goal]) -> list[tuple[str, str, str, str, str]]:
    """Return the rows: what, must, aim, measured, verdict."""
    rows = [("what", "must", "aim", "measured", "verdict")]
    for goal in goals:
        value = "–" if math.isnan(goal.measured) else f"{figure(goal.measured)}{goal.unit}"
        note = f" ({goal.note})" if goal.note and not math.isnan(goal.measured) else ""
        rows.append((goal.what + note, goal.bound(goal.must), goal.bound(goal.aim), value, goal.verdict))
    return rows


def printed(rows: Sequence[tuple[str, ...]]) -> str:
    """Return rows as text in columns."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def markdown(rows: Sequence[tuple[str, ...]]) -> str:
    """Return rows as a table in Markdown."""
    head, *body = ("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)
    return "\n".join([head, "|" + "---|" * len(rows[0]), *body])
