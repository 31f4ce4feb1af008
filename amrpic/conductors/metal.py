"""Electrodes as a solver sees them: which cells of a level lie in metal, and which arms it cuts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import _native
from ..mesh.domain import Domain
from ..scene.electrodes import Electrode
from .arms import cut_arms


def metal_of(electrodes: Sequence[Electrode], domain: Domain, stretch: Sequence[float] = (1, 1, 1)) -> _native.Metal:
    """Return electrodes for a native solver, whose lengths are those of the domain times `stretch`."""
    bodies = tuple(electrodes)

    def ask(lower: Sequence[int], shape: Sequence[int], spacing: Sequence[float]) -> tuple[np.ndarray, ...]:
        arms = cut_arms(bodies, lower, shape, domain.lower, np.divide(spacing, stretch))
        return (
            np.asarray(arms.solid, np.int64),
            np.asarray(arms.solid_electrode, np.int32),
            np.asarray(arms.cell, np.int64),
            np.ascontiguousarray(arms.theta, float),
            np.ascontiguousarray(arms.electrode, np.int32),
        )

    return _native.Metal(len(bodies), ask)
