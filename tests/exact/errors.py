"""How far fields are from exact ones, and the order that errors show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from amrpic.verify.error_norms import errors, level_errors

__all__ = ["errors", "level_errors", "observed_order"]


def observed_order(cells: Sequence[int], error: Sequence[float]) -> float:
    """Slope of the error over the cell width, by least squares of the logarithms."""
    return -float(np.polyfit(np.log(cells), np.log(error), 1)[0])
