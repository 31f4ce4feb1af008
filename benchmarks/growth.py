"""How cost grows: power laws through what was measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import regridding
from measuring import Record, figure
from particles import STAGES, record_name

LEVELS, BOXES, CELLS, PARTICLES = "levels", "boxes", "cells", "particles"


@dataclass(frozen=True)
class Law:
    """seconds = scale · (size / first size)^exponent, by least squares of the logarithms."""

    what: str
    of: str  # what grows
    sizes: tuple[float, ...]
    seconds: tuple[float, ...]
    scale: float
    exponent: float

    @property
    def off(self) -> float:
        """Largest deviation of what was measured from the law, over the law."""
        return float(np.abs(np.array(self.seconds) / self.at(np.array(self.sizes)) - 1).max())

    def at(self, size: np.ndarray) -> np.ndarray:
        return self.scale * (size / self.sizes[0]) ** self.exponent


def law(what: str, of: str, points: Sequence[tuple[float, float]]) -> Law:
    """Return the law through (size, seconds), of two points at least and different sizes."""
    points = sorted(points)
    sizes, seconds = (np.array(column, dtype=float) for column in zip(*points, strict=True))
    exponent, offset = np.polyfit(np.log(sizes / sizes[0]), np.log(seconds), 1)
    return Law(what, of, tuple(sizes), tuple(seconds), float(np.exp(offset)), float(exponent))


def laws(records: Sequence[Record]) -> list[Law]:
    """Return the laws of set-up and solve over cells, levels and boxes, of regrid over boxes, of particles by number."""
    return [law(what, of, points) for what, of, points in series(records) if len({size for size, _ in points}) > 1]


def series(records: Sequence[Record]) -> Iterator[tuple[str, str, list[tuple[float, float]]]]:
    """Yield what is measured, what grows, and its points."""
    beginnings: tuple[tuple[str, str, Callable[[Record], float]], ...] = (
        (CELLS, "growth, base ", lambda record: record.cells),
        (LEVELS, "growth, levels ", lambda record: record.facts["levels"]),
        (BOXES, "growth, boxes of ", lambda record: record.facts["boxes"]),
    )
    for of, beginning, size in beginnings:
        for what, ending in (("solve", "1e-10"), ("set-up", "set-up")):
            mine = [r for r in records if r.name.startswith(beginning) and r.name.endswith(f", {ending}")]
            yield what, of, [(size(record), record.median) for record in mine]
    for stage in regridding.STAGES:
        yield f"{stage} of boxes alone", BOXES, regridding.points(records, stage)
    for stage in (stage for stage in STAGES if stage != "field"):  # which is of the mesh alone
        mine = [r for r in records if r.particles and r.name == record_name(stage, r.particles, "cloud-in-cell")]
        yield stage, PARTICLES, [(record.particles, record.median) for record in mine]


def rows(found: Sequence[Law]) -> list[tuple[str, ...]]:
    """Return the laws as rows of a table."""
    out: list[tuple[str, ...]] = [("time of", "grows with", "from", "to", "exponent", "largest deviation")]
    for one in found:
        ends = (figure(one.sizes[0]), figure(one.sizes[-1]))
        out.append((one.what, one.of, *ends, f"{one.exponent:.2f}", f"{one.off:.0%}"))
    return out
