"""Numbers in (0, 1) for the particles of a bunch: random, or quasi-random for a quiet start.

Those of a particle depend on seed, bunch and its number in it alone: not on the ranks, nor on which particles are asked for.
"""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np

from .. import _native
from .distributions import DRAWS

Sampling = Literal["random", "sobol", "halton"]

STREAMS = 2, 3  # of the counter-based generator; the random walk draws from another
BITS = 32  # of a Sobol number, the most that SciPy skips ahead in; there are 2^32 of them


def draw(sampling: Sampling, seed: int, first_id: int, start: int, stop: int) -> np.ndarray:
    """Return the numbers (7, n) of the particles start ... stop - 1 of the bunch whose ids begin at `first_id`."""
    if sampling == "random":
        return _random(seed, np.arange(first_id + start, first_id + stop, dtype=np.int64))
    # Each bunch scrambles in its own way: two of a train must not be copies of each other.
    scramble = np.random.default_rng([seed, first_id])
    return _sobol(scramble, start, stop) if sampling == "sobol" else _halton(scramble, start, stop)


def _random(seed: int, ids: np.ndarray) -> np.ndarray:
    first, second = np.empty((4, len(ids))), np.empty((4, len(ids)))
    for stream, out in zip(STREAMS, (first, second), strict=True):
        _native.uniforms(seed, stream, 0, ids, out)
    return np.concatenate([first[:3], second[:3], first[3:]])


def _sobol(scramble: np.random.Generator, start: int, stop: int) -> np.ndarray:
    from scipy.stats import qmc  # takes half a second to import

    engine = qmc.Sobol(DRAWS, bits=BITS, rng=scramble)
    if start > 0:
        engine.fast_forward(start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about counts that are no power of two
        return engine.random(stop - start).T + 0.5 * 2.0**-BITS


def _halton(scramble: np.random.Generator, start: int, stop: int) -> np.ndarray:
    from scipy.stats import qmc

    engine = qmc.Halton(DRAWS, rng=scramble)
    engine.num_generated = start  # numbers are found from their index; fast_forward would make all that it passes
    return np.clip(engine.random(stop - start).T, 2.0**-53, 1 - 2.0**-53)
