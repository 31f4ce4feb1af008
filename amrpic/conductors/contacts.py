"""Contacts: electrodes of different voltages that touch or overlap on lines along the axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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


NO_KEY = np.iinfo(np.int64).min  # of a line


class LineSpans(NamedTuple):
    """The spans of a shape on lines along an axis, whose parameter is the coordinate."""

    axis: int
    key: Ints  # (lines,) which line it is, each once, ascending
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


def sentence_at_wall(two: Sequence[Conductor], contact: Contact) -> str:
    """Return what is said of an electrode and a face of the domain that touch."""
    x, y, z = contact.place
    return (
        f"electrode {two[0].name} meets {two[1].name} at ({x:.6g}, {y:.6g}, {z:.6g}) m, which has another potential: the "
        "charge there grows without end as cells become finer; give both the same, or end the electrode a cell before the face"
    )


def sentence_of_gap(two: Sequence[Conductor], gap: Gap) -> str:
    """Return what is said of a gap between two electrodes, or one and a face of the domain, without a centre of a cell."""
    width, (x, y, z) = gap
    first, second = (metal.name for metal in two)
    return (
        f"{first} and {second} are {width:.3g} m apart at ({x:.6g}, {y:.6g}, {z:.6g}) m, with no centre of a cell "
        "between them there, so that the charge on both sides of the gap is that of parallel plates, and particles in it "
        "feel no field; refine there"
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
    leave, enter, place = _between(first, second)
    met = np.flatnonzero(enter <= leave + slack)
    if not len(met):
        return None
    n = met[0]
    place[n, first.axis] = enter[n] if np.isfinite(enter[n]) else leave[n]
    x, y, z = place[n].tolist()
    return x, y, z


class Gap(NamedTuple):
    """What lies between two electrodes on a line."""

    width: float  # m
    place: tuple[float, float, float]  # m, in its middle


def narrowest(first: LineSpans, second: LineSpans, index: Callable[[Floats], Floats]) -> Gap | None:
    """Return the narrowest gap between two shapes on the same lines in which no centre of a cell lies.

    `index` returns the indices of cells with their centres at coordinates along the lines.
    """
    leave, enter, place = _between(first, second)
    missed = np.flatnonzero((enter > leave) & (np.floor(index(leave)) + 1 >= index(enter)))
    if not len(missed):
        return None
    width = (enter - leave)[missed]
    narrow = missed[width <= (1 + 1e-9) * width.min()]
    n = narrow[len(narrow) // 2]
    place[n, first.axis] = (leave[n] + enter[n]) / 2
    x, y, z = place[n].tolist()
    return Gap(float(enter[n] - leave[n]), (x, y, z))


def _between(first: LineSpans, second: LineSpans) -> tuple[Floats, Floats, Floats]:
    """Return where the spans of one of two shapes end and those of the other begin next on the same lines, and these lines."""
    parts = []
    for number, ((_, keys, places, spans), others) in enumerate(((first, second.key), (second, first.key))):
        same = np.append(others, NO_KEY)[np.searchsorted(others, keys)] == keys
        chosen = np.flatnonzero(same[spans.line])
        line = spans.line[chosen]
        parts.append((keys[line], spans.enter[chosen], spans.leave[chosen], np.full(len(line), number), places[line]))
    key, enter, leave, owner, place = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((enter, key))
    key, enter, leave, owner, place = (column[order] for column in (key, enter, leave, owner, place))
    # Spans of one shape are apart, so that those of two overlap only where neighbours in this order do.
    near = np.flatnonzero((key[1:] == key[:-1]) & (owner[1:] != owner[:-1]))
    return leave[near], enter[near + 1], place[near + 1]
