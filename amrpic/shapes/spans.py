"""Spans: where lines are in a body, and the set operations on them, which are operations on sorted intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Spans:
    """Stretches of lines inside a body, closed, line by line and along each of them; those of foils have no length."""

    line: Ints  # (m,) number of the line
    enter: Floats  # (m,) parameter of the line
    leave: Floats  # (m,) at least as large
    first: Ints  # (m,) which of the body's surfaces, as `Shape.surfaces` counts them, is entered by
    last: Ints  # (m,) and left by

    def __len__(self) -> int:
        return len(self.line)

    @classmethod
    def of_convex(cls, enter: Floats, leave: Floats, foil: bool = False) -> Self:
        """Return those of a body that each line (n,) meets once at most; where it does not, `enter` is not below `leave`."""
        line = np.flatnonzero(enter == leave if foil else enter < leave)
        surface = np.zeros(len(line), np.int64)
        return cls(line, enter[line], leave[line], surface, surface)

    def select(self, chosen: NDArray[np.bool_]) -> Self:
        """Return those that a mask names."""
        return type(self)(
            self.line[chosen], self.enter[chosen], self.leave[chosen], self.first[chosen], self.last[chosen]
        )

    def part(self, first: int, end: int, line: int) -> Self:
        """Return those from `first` to `end`, with lines counted from `line` on."""
        at = slice(first, end)
        return type(self)(self.line[at] - line, self.enter[at], self.leave[at], self.first[at], self.last[at])


def combined(bodies: Sequence[Spans], surfaces: Sequence[int], needed: int, holes: int = 0) -> Spans:
    """Return the spans in at least `needed` of the bodies and in none of the last `holes` ones.

    `surfaces` says how many surfaces each body has. All bodies are closed: spans that touch become one. What has no
    length is dropped, unless it is a foil's.
    """
    solid = [np.full(len(body), number < len(bodies) - holes) for number, body in enumerate(bodies)]
    offset = np.repeat(np.cumsum([0, *surfaces[:-1]]), [len(body) for body in bodies])
    line, enter, leave, first, last = (
        np.concatenate([getattr(body, name) for body in bodies]) for name in ("line", "enter", "leave", "first", "last")
    )
    step = np.where(np.concatenate(solid), 1, 0)
    return swept(line, enter, leave, (first + offset, last + offset), step, 1 - step, needed)


def swept(
    line: Ints, enter: Floats, leave: Floats, surfaces: tuple[Ints, Ints], step: Ints, hole: Ints, needed: int = 1
) -> Spans:
    """Return where the sum of the `step`s of intervals (n,) reaches `needed` and that of their `hole`s is zero.

    At one place sums first rise, then fall, so that intervals that touch are one.
    """
    return swept_ends(
        np.tile(line, 2),
        np.concatenate([enter, leave]),
        np.concatenate(surfaces),
        np.concatenate([step, -step]),
        np.concatenate([hole, -hole]),
        np.tile(enter == leave, 2),
        needed,
    )


def swept_ends(
    line: Ints,
    parameter: Floats,
    surface: Ints,
    step: Ints,
    hole: Ints | None = None,
    foil: NDArray[np.bool_] | None = None,
    needed: int = 1,
) -> Spans:
    """Return the same from single ends, at which the sums change by `step` and `hole`; `foil` names those of foils."""
    hole = np.zeros_like(step) if hole is None else hole
    foil = np.zeros(len(line), bool) if foil is None else foil
    rises = step + hole > 0
    # Ends of foils between those of bodies: a foil on the surface of a body lies in it.
    rank = np.where(foil, np.where(rises, 1, 2), np.where(rises, 0, 3))
    order = np.lexsort((rank, parameter, line))
    within = (np.cumsum(step[order]) >= needed) & (np.cumsum(hole[order]) <= 0)
    before = np.concatenate([[False], within[:-1]])[: len(within)]
    start, stop = order[within & ~before], order[~within & before]
    spans = Spans(line[start], parameter[start], parameter[stop], surface[start], surface[stop])
    return spans.select((spans.leave > spans.enter) | foil[start] | foil[stop])
