"""A beam between two grounded planes as sheets of charge in one dimension, without a mesh.

Lengths in gaps, times in flights of a free particle, currents in Child's for the beam's energy: 2/9 of ε₀ m v³ / e d² here.
"""

from __future__ import annotations

import numpy as np

UNIT = 2 / 9
Sheets = tuple[np.ndarray, np.ndarray, np.ndarray]  # place, speed, charge of each: shape (n,)


def force(place: np.ndarray, charge: np.ndarray) -> np.ndarray:
    """Force over mass at each sheet: the charge below it, with half of its own, and what keeps both planes at one potential."""
    order = np.argsort(place, kind="stable")
    below = np.empty_like(place)
    below[order] = np.cumsum(charge[order]) - charge[order] / 2
    return below - np.sum(charge * (1 - place))


def course(
    times: list[float], currents: list[float], start: Sheets | None = None, steps: int = 200, each: int = 4
) -> np.ndarray:
    """Time, and charge that came back and that passed up to then, after each step (n, 3); `each` sheets are born in a step."""
    place, speed, charge = start or (np.zeros(0),) * 3
    dt, back, passed, rows = 1 / steps, 0.0, 0.0, []
    flown = (np.arange(each) + 0.5) / each * dt
    for n in range(round(times[-1] * steps)):
        current = float(np.interp((n + 0.5) * dt, times, currents)) * UNIT
        place = place + speed * dt
        at_wall = -np.sum(charge * (1 - place))
        place = np.concatenate([place, flown + at_wall * flown**2 / 2])
        speed = np.concatenate([speed, 1 + at_wall * (flown - dt / 2)])
        charge = np.concatenate([charge, np.full(each, current * dt / each)])
        back, passed = back + charge[place < 0].sum(), passed + charge[place > 1].sum()
        inside = (place >= 0) & (place <= 1)
        place, speed, charge = place[inside], speed[inside], charge[inside]
        speed = speed + force(place, charge) * dt
        rows.append(((n + 1) * dt, back, passed))
    return np.array(rows)


def with_virtual_cathode(current: float, passed: float, number: int = 2000) -> Sheets:
    """A steady flow that comes to rest within the gap, and of which the part `passed` goes on: three flows of Child's kind."""
    share = (np.arange(number) + 0.5) / number  # of the time from rest: v goes with its square, z with its cube
    flows = []
    for amount, total, way, sign in (
        (current, 2 * current - passed, -1, 1),
        (current - passed, 2 * current - passed, -1, -1),
        (passed, passed, 1, 1),
    ):
        length = total**-0.5
        rest = (2 * current - passed) ** -0.5
        charge = np.full(number, 3 * amount * UNIT * length / number)
        flows.append((rest + way * length * share**3, sign * share**2, charge))
    place, speed, charge = (np.concatenate(parts) for parts in zip(*flows, strict=True))
    return place, speed, charge
