"""How much of a period the beam takes up where space repeats, and what is said where that is too much for its moments."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ..mesh.domain import AXES
from ..mesh.periods import LARGEST_FILL


class Fills:
    """Remarks on groups whose nearest images say little of their size, one for each group and axis."""

    def __init__(self, remark: Callable[[str], None]) -> None:
        self._remark = remark
        self._said: set[tuple[str, int]] = set()

    def check(self, fills: Mapping[str, np.ndarray]) -> None:
        """Remark on groups by name whose rms size round an axis over its period, `fills` (3,) each, is too large."""
        for axis, letter in enumerate(AXES):
            full = {
                name: float(fill[axis])
                for name, fill in fills.items()
                if fill[axis] > LARGEST_FILL and (name, axis) not in self._said
            }
            if full:
                self._said |= {(name, axis) for name in full}
                most = max(full.values())
                size = "is even" if most > 1 else f"has an rms size of {most:.2g} of that"
                self._remark(
                    f"{', '.join(full)}: the beam takes up the period along {letter} ({size}, where nearest images serve up to "
                    f"{LARGEST_FILL:.2g}), so its mean, size and emittance along {letter} depend on where the period is cut"
                )
