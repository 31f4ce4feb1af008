"""Compare two runs of `make bench` that were recorded: python benchmarks compare_records BEFORE.json AFTER.json

They were made at different times, so differences below a tenth are not decided; `compare`, which runs two builds
in turns, decides 3 %.

What was timed beside a work unit in both is compared in work units, so that a slower machine is not slower code; the rest
in seconds. A difference counts where the medians are further apart than the threshold and than the noise, three standard
errors of the medians as the spread of the runs gives them; what ran but once has none, and its time is left out. More
cycles, or more memory beyond the threshold, count as slower. The exit status is 1 if anything became slower.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated

from goals import printed
from measuring import Record, figure, read

THRESHOLD = 0.1
ERRORS = 3.0  # standard errors of a median that are noise


@dataclass(frozen=True)
class Change:
    """How something differs: before, after and what is noise, of the larger over the smaller."""

    name: str
    unit: str
    before: float
    after: float
    noise: float = 0.0
    exact: bool = False  # whether any difference counts

    @property
    def ratio(self) -> float:
        if self.before == 0:
            return 1.0 if self.after == 0 else math.inf
        return self.after / self.before

    def verdict(self, threshold: float) -> str:
        """ "slower", "faster" or "as before"."""
        limit = 1 if self.exact else 1 + max(threshold, self.noise)
        return "slower" if self.ratio > limit else "faster" if self.ratio * limit < 1 else "as before"


def changes(before: Sequence[Record], after: Sequence[Record]) -> list[Change]:
    """Return what both runs measured, the times and then cycles and bytes of each record."""
    known = {record.name: record for record in before}
    out = []
    for record in after:
        old = known.get(record.name)
        if old is not None:
            timed = min(len(old.seconds), len(record.seconds)) > 1
            out += [*([changed(old, record)] if timed else []), *counted(old, record)]
    return out


def changed(old: Record, new: Record) -> Change:
    noise = ERRORS * math.hypot(error(old.seconds), error(new.seconds))
    if min(old.unit, new.unit) > 0:
        return Change(new.name, "WU", old.units, new.units, noise)
    return Change(new.name, "s", old.median, new.median, noise)


def counted(old: Record, new: Record) -> list[Change]:
    """Return the changes of what is counted, not timed: any cycle more is one, bytes are held to the threshold."""
    out = []
    for what, value in new.facts.items():
        if not isinstance(value, int | float):
            continue
        if what in old.facts and what == "cycles":
            out.append(Change(f"{new.name}: cycles", "", old.facts[what], value, exact=True))
        elif what in old.facts and what.startswith("bytes"):
            out.append(Change(f"{new.name}: {what}", "B", old.facts[what], value))
    return out


def error(seconds: Sequence[float]) -> float:
    """Return the standard error of a median over the median, from the median of the distances to it; 0 of a single run."""
    middle = median(seconds)
    if len(seconds) < 2 or middle == 0:
        return 0.0
    deviation = 1.4826 * median(abs(value - middle) for value in seconds)
    return 1.2533 * deviation / math.sqrt(len(seconds)) / middle


def table_rows(found: Sequence[Change], threshold: float, everything: bool = False) -> list[tuple[str, ...]]:
    """Return the rows of what became slower, then faster, then (of `everything`) is as before; the largest changes first."""
    rows: list[tuple[str, ...]] = [("", "before", "after", "ratio", "what")]
    for verdict in ("slower", "faster", "as before")[: 3 if everything else 2]:
        mine = [change for change in found if change.verdict(threshold) == verdict]
        for change in sorted(mine, key=lambda change: -abs(math.log(max(change.ratio, 1e-300)))):
            values = (f"{figure(value)} {change.unit}".strip() for value in (change.before, change.after))
            rows.append((verdict, *values, f"{change.ratio:.2f}", change.name))
    return rows


def run(
    before: Path,
    after: Path,
    threshold: Annotated[float, "relative change that counts"] = THRESHOLD,
    all: Annotated[bool, "show what is as before, too"] = False,
) -> int:
    """Compare, and print the table; 1 if something is slower."""
    olds, news = read(before), read(after)
    found = changes(olds, news)
    print(printed(table_rows(found, threshold, all)))
    slower = sum(change.verdict(threshold) == "slower" for change in found)
    faster = sum(change.verdict(threshold) == "faster" for change in found)
    alone = len({record.name for record in olds} ^ {record.name for record in news})
    print(f"{slower} slower, {faster} faster, {len(found) - slower - faster} as before; {alone} in one run only")
    return int(slower > 0)
