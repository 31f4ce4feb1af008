"""Contacts: electrodes of different voltages that touch or overlap on lines along the axes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ..shapes.spans import Floats, Ints, Spans
from .conductor import Conductor


class Contact(NamedTuple):
    """Two electrodes of different voltages that touch or overlap, and a place where they do, m."""

    first: int
    second: int
    place: tuple[float, float, float]


class LineSpans(NamedTuple):
    """The spans of a shape on lines along an axis, whose parameter is the coordinate."""

    axis: int
    key: Ints  # (lines,) which line it is, each once
    place: Floats  # (lines, 3) m
    spans: Spans


def sentence(electrodes: Sequence[Conductor], contact: Contact) -> str:
    """Return why electrodes that touch are refused."""
    first, second = (electrodes[number].name for number in contact[:2])
    x, y, z = contact.place
    return (
        f"electrodes {first} and {second} touch at ({x:.6g}, {y:.6g}, {z:.6g}) m and have different voltages; "
        "move them apart, or give them the same voltage"
    )


def apart(electrodes: Sequence[Conductor]) -> Iterator[tuple[int, int]]:
    """Yield the numbers of each two electrodes that may not touch."""
    for first, second in combinations(range(len(electrodes)), 2):
        voltage = electrodes[first].voltage
        if voltage is None or voltage != electrodes[second].voltage:
            yield first, second


def contacts(electrodes: Sequence[Conductor], lines: Sequence[Sequence[LineSpans]], slack: Floats) -> Iterator[Contact]:
    """Yield a place for each two electrodes of different voltages that touch on lines along x, y and z.

    Gaps of less than `slack` (3,), m, are none.
    """
    for first, second in apart(electrodes):
        pairs = zip(lines[first], lines[second], strict=False)  # none for one that is elsewhere
        places = (touching(*pair, slack[pair[0].axis]) for pair in pairs)
        place = next((place for place in places if place is not None), None)
        if place is not None:
            yield Contact(first, second, place)


def touching(first: LineSpans, second: LineSpans, slack: float) -> tuple[float, float, float] | None:
    """Return a place where the spans of two shapes on the same lines touch or overlap."""
    common = np.intersect1d(first.key, second.key)
    if not len(common):
        return None
    parts = []
    for number, (_, keys, _, spans) in enumerate((first, second)):
        chosen = np.flatnonzero(np.isin(keys, common)[spans.line])
        line = spans.line[chosen]
        parts.append((keys[line], spans.enter[chosen], spans.leave[chosen], line, np.full(len(line), number)))
    key, enter, leave, line, owner = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((enter, key))
    key, enter, leave, line, owner = (column[order] for column in (key, enter, leave, line, owner))
    # Spans of one shape are apart, so that those of two overlap only where neighbours in this order do.
    near = (key[1:] == key[:-1]) & (owner[1:] != owner[:-1]) & (enter[1:] <= leave[:-1] + slack)
    met = np.flatnonzero(near)
    if not len(met):
        return None
    n = met[0] + 1
    place = (first, second)[int(owner[n])].place[line[n]].copy()
    place[first.axis] = enter[n] if np.isfinite(enter[n]) else leave[met[0]]
    return float(place[0]), float(place[1]), float(place[2])
