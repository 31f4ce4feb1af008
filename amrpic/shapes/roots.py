"""Roots of many functions at once, each between two places where its signs differ."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .spans import Floats, Ints

MOST_STEPS = 200
ROUNDING = 2.3e-16


def roots_between(function: Callable[[Floats, Ints], Floats], low: Floats, high: Floats, at_low: Floats) -> Floats:
    """Return a root of each function between `low` and `high` (n,), to rounding.

    `function(s, number)` gives the values at `s` of the functions that `number` names; those at `low` are `at_low`, and
    those at `high` have the other sign. Chandrupatla's method: inverse quadratic steps where they are safe, else halves.
    """
    root = np.array(high)
    number = np.arange(len(root))
    a, b, c = np.array(high), np.array(low), np.array(high)  # b: newest; a: the other side; c: the one before
    fb = np.array(at_low)
    fa = function(a, number)
    fc, share = fa, np.full(len(root), 0.5)
    for _ in range(MOST_STEPS):
        if not len(number):
            break
        s = a + share * (b - a)
        value = function(s, number)
        same = np.sign(value) == np.sign(fa)
        c, fc = np.where(same, a, b), np.where(same, fa, fb)
        b, fb = np.where(same, b, a), np.where(same, fb, fa)
        a, fa = s, value
        best = np.where(abs(fa) < abs(fb), a, b)
        width = abs(b - a)
        precise = 2 * ROUNDING * abs(best) + 1e-300
        done = (width <= 2 * precise) | (fa == 0)
        root[number[done]] = best[done]
        left = ~done
        number, a, b, c, fa, fb, fc = (part[left] for part in (number, a, b, c, fa, fb, fc))
        least = (precise / np.where(width > 0, width, 1))[left]
        xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
        safe = (phi**2 < xi) & ((1 - phi) ** 2 < 1 - xi)
        step = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        share = np.where(safe & np.isfinite(step), np.clip(step, least, 1 - least), 0.5)
    root[number] = a
    return root
