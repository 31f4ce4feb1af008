"""The axes of an element or a bunch that looks into a direction."""

from __future__ import annotations

import math

import numpy as np


def axes(direction: tuple[float, float, float], roll: float) -> list[list[float]]:
    """Return the unit vectors along x, y, z of what looks into a direction: turned from those of the laboratory by the smallest
    turn that takes z into the direction (about y if that is -z), then rolled about it."""
    x, y, z = np.array(direction) / math.hypot(*direction)
    s = x * x + y * y
    if s == 0:
        turned = np.diag([math.copysign(1.0, z), 1.0, math.copysign(1.0, z)])
    else:
        # rows are the new axes; c = (1 - cos) / sin² = 1 / (1 + cos), without cancellation for either sign of the cosine
        c = (1 - z) / s if z < 0 else 1 / (1 + z)
        turned = np.array([[1 - c * x * x, -c * x * y, -x], [-c * x * y, 1 - c * y * y, -y], [x, y, z]])
    cosine, sine = math.cos(roll), math.sin(roll)
    rolled: list[list[float]] = (np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]) @ turned).tolist()
    return rolled
