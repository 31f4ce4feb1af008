"""amrpic compare: whether two runs found the same, and where they differ."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

from ..mpi import MPI
from ..parallel import from_rank_0
from ..results.comparison import Comparison, Difference, compare
from ..tables import columns
from ..units import quantity
from .arguments import Commands, command

TOLERANCE = 1e-6
MOST = 12  # differences of a part that are listed
DIFFERENT = 1  # exit status


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    added = command(
        commands,
        "compare",
        _compare,
        "compare two runs; exit status 0 if they found the same, 1 if not",
        "comparing the runs",
    )
    added.add_argument("first", metavar="RUN", help="the folder of a run")
    added.add_argument("second", metavar="RUN", help="that of another one")
    added.add_argument(
        "--tolerance",
        type=_tolerance,
        default=TOLERANCE,
        metavar="NUMBER",
        help=f"relative difference up to which results are the same; default {TOLERANCE:g}, 0: bit by bit",
    )


def _tolerance(text: str) -> float:
    value = float(text)
    if not 0 <= value < 1:
        raise argparse.ArgumentTypeError(f"{text} is no relative tolerance; give 0 or more, and less than 1")
    return value


def _compare(chosen: argparse.Namespace) -> int:
    comparison = from_rank_0(MPI.COMM_WORLD, lambda: compare(Path(chosen.first), Path(chosen.second)))
    if MPI.COMM_WORLD.rank == 0:
        print("\n".join(lines(comparison, chosen.tolerance)))
    return 0 if comparison.equal(chosen.tolerance) else DIFFERENT


def lines(comparison: Comparison, tolerance: float) -> Iterator[str]:
    """Yield the tables of a comparison: scenes, results, speed."""
    if comparison.scenes:
        yield from columns(
            [("scene", "first", "second"), *((key, _brief(a), _brief(b)) for key, a, b in comparison.scenes)]
        )
    else:
        yield "scene: the same"
    yield ""
    beyond = comparison.beyond(tolerance)
    yield from columns(
        [
            ("results", "compared", "different", "largest", "of"),
            *(_summary(part, of_part, beyond[part]) for part, of_part in comparison.parts.items()),
        ]
    )
    for part, different in beyond.items():
        if different:
            rows = [
                (difference.what, _number(difference.relative), difference.where) for difference in different[:MOST]
            ]
            yield ""
            yield from columns([(f"{part}, different", "relative", "where"), *rows])
            if len(different) > MOST:
                yield f"and {len(different) - MOST} more"
    yield ""
    yield from columns([("speed", "first", "second", "second / first"), *map(_speed, comparison.speed)])
    yield ""
    for remark in comparison.remarks:
        yield f"remark: {remark}"
    same = "the same" if comparison.equal(tolerance) else "different"
    yield f"results are {same} within a relative tolerance of {tolerance:g}"


def _summary(part: str, compared: list[Difference], different: list[Difference]) -> tuple[object, ...]:
    worst = max(compared, key=lambda difference: difference.relative)
    return part, len(compared), len(different), _number(worst.relative), worst.what if worst.relative > 0 else ""


def _speed(measured: tuple[str, float, float]) -> tuple[str, ...]:
    what, first, second = measured
    unit = "B" if what == "memory" else "s"
    ratio = f"{second / first:.2f}" if first > 0 else ""
    return what.replace("_", " "), quantity(first, unit), quantity(second, unit), ratio


def _number(value: float) -> str:
    return "missing" if math.isinf(value) else f"{value:.1e}" if value > 0 else "0"


def _brief(value: object) -> str:
    text = "none" if value is None else str(value)
    return text if len(text) <= 40 else text[:39] + "…"
