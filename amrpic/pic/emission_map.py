"""The map of what sources have given: the charge of each part of their surfaces."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..scene.scene import Scene
from ..units import Column
from .emitters import Emitter
from .tallies import PARTS, Tally

EMISSION = "emission.csv"
COLUMNS = (
    Column("source", is_text=True),
    Column("x", "m"),
    Column("y", "m"),
    Column("area", "m^2"),
    Column("charge", "C"),
)


def rows(scene: Scene, emitters: tuple[Emitter, ...], tallies: tuple[Tally, ...]) -> Iterator[dict[str, float | str]]:
    """Yield a row per source and part of its surface: the middle along its own axes, the area and the charge that was born."""
    for name, emitter, tally in zip(scene.source_names, emitters, tallies, strict=True):
        if emitter.extent is None or not tally.map:
            continue
        lower, upper = emitter.extent
        width = (upper - lower) / PARTS
        for (x, y), charge in zip(np.ndindex(PARTS, PARTS), tally.map, strict=True):
            middle = lower + width * (np.array([x, y]) + 0.5)
            yield dict(
                zip(
                    (column.name for column in COLUMNS),
                    (name, *middle.tolist(), float(width.prod()), charge),
                    strict=True,
                )
            )
