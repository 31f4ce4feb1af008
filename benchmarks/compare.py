"""Tell which of two builds is faster: python benchmarks compare OLD NEW [--cases ...] [--turns 11] [--minutes 30]

OLD and NEW are git revisions, working trees, or folders with a built package, and may end in environment variables:
`main HEAD`, `../other .`, `. .@AMRPIC_ISA=v3`. Each is built in a folder of its own with the same flags. The two take turns,
OLD, NEW, OLD, NEW, each turn in a fresh process, so that what slows the machine down slows both, and what differs from process
to process is averaged. A figure is decided by the ratios of the pairs, turns being added until it can be, or time is over.

Times are CPU times: on cores that others use as well a process waits, which wall time counts and CPU time does not (measured:
of two waiting neighbours wall time more than doubled, CPU time moved by 5 %). What shared memory and caches cost remains in
both; so the solver's times are divided by that of scipy's sine transform on 128³ cells in the same process, per cell. The exit
status is 1 if a figure became slower.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import NormalDist, median
from typing import Annotated

import turn
from builds import Build, build
from goals import printed

THRESHOLD = 0.03  # a relative difference that must stand out from noise
LARGEST_ERROR = 0.01  # standard error of a figure that is decided
CONFIDENCE = 0.99
ERRORS = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)  # standard errors to either side
TURNS, MINUTES = 11, 30.0


# ---- statistics ----


@dataclass(frozen=True)
class Difference:
    """The median of the ratios NEW / OLD of so many turns, less one, and its standard error."""

    change: float
    error: float
    turns: int

    def decided(self, threshold: float = THRESHOLD) -> bool:
        """Whether the error is so small that the verdict cannot be "too noisy". It does not look at the change: whoever
        stops when a change looks large finds changes where there are none."""
        return self.error <= min(LARGEST_ERROR, threshold / (2 * ERRORS))

    def verdict(self, threshold: float = THRESHOLD) -> str:
        """Return whether the interval of confidence lies within the threshold, or beyond zero, or decides nothing."""
        size, margin = abs(self.change), ERRORS * self.error
        if size + margin < threshold:
            return f"no difference above {threshold:.0%}"
        if size > margin:
            return f"{'slower' if self.change > 0 else 'faster'} by {size:.1%} ± {self.error:.1%}"
        wanted = min(LARGEST_ERROR, threshold / (2 * ERRORS))
        if not math.isfinite(self.error):
            return "too noisy to tell: needs more turns"
        return f"too noisy to tell: needs about {math.ceil(self.turns * (self.error / wanted) ** 2)} turns"


def difference(old: Sequence[float], new: Sequence[float]) -> Difference:
    """Return how NEW differs from OLD, by pairs of turns."""
    ratios = [math.log(b / a) for a, b in zip(old, new, strict=True)]
    return Difference(math.expm1(median(ratios)), median_error(ratios), len(ratios))


def median_error(values: Sequence[float]) -> float:
    """Return the standard error of the median, from the two values of ranks about √n from the middle; infinite below five.

    Between them the median of the population lies with a probability that is known for any distribution, from which the error
    follows as if it was normal: Price and Bonett, J. Stat. Comput. Simul. 68 (2001) 295. Some outliers do not change it.
    """
    count = len(values)
    if count < 5:
        return math.inf
    ordered = sorted(values)
    rank = max(1, round((count + 1) / 2 - math.sqrt(count)))
    outside = sum(math.comb(count, k) for k in range(rank)) / 2**count  # on one side
    width = ordered[count - rank] - ordered[rank - 1]
    return width / (2 * NormalDist().inv_cdf(1 - outside))


# ---- turns ----


@dataclass
class Case:
    """The times of all turns of a case: of each of its works the CPU seconds per cell or particle, OLD's and NEW's."""

    name: str
    times: dict[str, tuple[list[float], list[float]]] = field(default_factory=dict)
    missing: set[tuple[str, str]] = field(default_factory=set)  # a work, and the build that does not have it

    def add(self, old: dict[str, float], new: dict[str, float]) -> None:
        self.missing |= {(work, "old") for work in new.keys() - old.keys()}
        self.missing |= {(work, "new") for work in old.keys() - new.keys()}
        for work in old.keys() & new.keys():
            for taken, value in zip(self.times.setdefault(work, ([], [])), (old[work], new[work]), strict=True):
                taken.append(value)

    def figures(self) -> dict[str, tuple[list[float], list[float], str]]:
        """Return by name the values of OLD and NEW, and their unit: over the sine transform's time, or in ns."""
        out = {}
        for work, sides in sorted(self.times.items()):
            name = self.name if work == self.name else f"{self.name}: {work}"
            if work == "DST":
                continue
            if self.name.startswith("particles"):
                out[name] = (*([1e9 * value for value in side] for side in sides), "ns")
            else:
                of_dst = self.times["DST"]
                out[name] = (
                    *([a / b for a, b in zip(*both, strict=True)] for both in zip(sides, of_dst, strict=True)),
                    "DST",
                )
        return out  # type: ignore[return-value]

    def decided(self, threshold: float) -> bool:
        return bool(self.times) and all(difference(a, b).decided(threshold) for a, b, _ in self.figures().values())


def take_turns(old: Build, new: Build, cases: Sequence[Case], turns: int, minutes: float, threshold: float) -> None:
    """Let the builds take turns in all cases, `turns` times, and then in those that are not decided, until time is over."""
    end = time.monotonic() + 60 * minutes
    done = 0
    left = list(cases)
    while left and time.monotonic() < end:
        for case in left:
            one, other = (json.loads(side.run("turn", "--case", case.name).splitlines()[-1]) for side in (old, new))
            case.add(one["cpu"], other["cpu"])
            if time.monotonic() > end:
                break
        done += 1
        if done >= turns:
            left = [case for case in left if not case.decided(threshold)]
        print(f"turn {done}, {max(0.0, end - time.monotonic()) / 60:.0f} min left", file=sys.stderr, flush=True)


def table(cases: Sequence[Case], threshold: float = THRESHOLD) -> list[tuple[str, ...]]:
    """Return the rows: the medians, the ratio with its standard error, and the verdict."""
    rows: list[tuple[str, ...]] = [("figure", "old", "new", "new / old", "±", "turns", "verdict")]
    for case in cases:
        for name, (old, new, unit) in case.figures().items():
            found = difference(old, new)
            values = (f"{median(side):.3g} {unit}" for side in (old, new))
            ratio = (f"{1 + found.change:.3f}", f"{found.error:.3f}", str(found.turns))
            rows.append((name, *values, *ratio, found.verdict(threshold)))
        rows += [(f"{case.name}: {work}", *5 * ("–",), f"missing in {side}") for work, side in sorted(case.missing)]
    return rows


def run(
    old: str,
    new: str,
    cases: Annotated[tuple[str, ...], "what is measured", tuple(turn.CASES)] = tuple(turn.CASES),
    turns: Annotated[int, "of each build at least"] = TURNS,
    minutes: Annotated[float, "after which no turn begins"] = MINUTES,
    threshold: Annotated[float, "difference in percent that counts"] = 100 * THRESHOLD,
) -> int:
    """Compare, and print the table; 1 if NEW is slower."""
    chosen = [Case(name) for name in cases]
    take_turns(build(old), build(new), chosen, turns, minutes, threshold / 100)
    rows = table([case for case in chosen if case.times], threshold / 100)
    print(printed(rows))
    return int(any(row[-1].startswith("slower") for row in rows))
