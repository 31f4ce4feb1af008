"""How the charge of a source comes in time."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
import scipy
from pydantic import Field, model_validator

from .section import Section
from .units import Time

NODES = 4096  # of the table that a smooth rise is inverted by
TAIL = 6.0  # rms lengths of a Gaussian rise that are kept on either side


class Pulse(Section):
    """A profile in time; `share` and `time_of` are inverse to each other between its ends."""

    start: Time = Field(default=0.0, description="When the first particles are born, s.")

    @property
    def duration(self) -> float:
        """From the first to the last birth, s."""
        raise NotImplementedError

    def share(self, time: np.ndarray | float) -> np.ndarray:
        """Return which part of the charge is born until a time (s), 0 to 1."""
        raise NotImplementedError

    def time_of(self, share: np.ndarray) -> np.ndarray:
        """Return the time (s) until which a part of the charge is born."""
        raise NotImplementedError


class SteadyPulse(Pulse):
    """A constant current."""

    shape: Literal["steady"] = "steady"
    stop: Time | None = Field(default=None, description="When the last particles are born, s; without it never.")

    @model_validator(mode="after")
    def _begins_first(self) -> Self:
        if self.stop is not None and self.stop <= self.start:
            self.refuse("stop", "is not after start", "swap them")
        return self

    @property
    def duration(self) -> float:
        return math.inf if self.stop is None else self.stop - self.start


class FlatPulse(Pulse):
    """A constant current for a while."""

    shape: Literal["flat"] = "flat"
    length: Time = Field(gt=0, description="From the first to the last birth, s.")

    @property
    def duration(self) -> float:
        return self.length

    def share(self, time: np.ndarray | float) -> np.ndarray:
        return np.clip((np.asarray(time) - self.start) / self.length, 0.0, 1.0)

    def time_of(self, share: np.ndarray) -> np.ndarray:
        return self.start + self.length * share


class GaussianPulse(Pulse):
    """A Gaussian, cut on both sides; its middle is `cutoff` rms lengths after the start."""

    shape: Literal["gaussian"] = "gaussian"
    sigma: Time = Field(gt=0, description="Rms length before the cut, s.")
    cutoff: float = Field(default=4.0, gt=0, description="Half of the length that is kept, in rms lengths.")

    @property
    def duration(self) -> float:
        return 2 * self.cutoff * self.sigma

    def share(self, time: np.ndarray | float) -> np.ndarray:
        tail = scipy.special.ndtr(-self.cutoff)
        units = np.clip((np.asarray(time) - self.start) / self.sigma - self.cutoff, -self.cutoff, self.cutoff)
        return (scipy.special.ndtr(units) - tail) / (1 - 2 * tail)

    def time_of(self, share: np.ndarray) -> np.ndarray:
        tail = scipy.special.ndtr(-self.cutoff)
        return self.start + self.sigma * (self.cutoff + scipy.special.ndtri(tail + (1 - 2 * tail) * share))


class TabulatedPulse(Pulse):
    """A profile that is linear between nodes."""

    @property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Times after the start (n,), s, and the current there over any scale (n,)."""
        raise NotImplementedError

    @property
    def duration(self) -> float:
        return float(self.nodes[0][-1])

    @cached_property
    def _sums(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times, currents, and charge until then, of which all is 1."""
        times, values = self.nodes
        sums = np.concatenate([[0.0], np.cumsum(np.diff(times) * (values[1:] + values[:-1]) / 2)])
        return times, values / sums[-1], sums / sums[-1]

    def share(self, time: np.ndarray | float) -> np.ndarray:
        times, values, sums = self._sums
        at = np.clip(np.asarray(time) - self.start, 0.0, times[-1])
        n = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
        past, slope = at - times[n], (values[n + 1] - values[n]) / (times[n + 1] - times[n])
        return sums[n] + past * (values[n] + slope * past / 2)

    def time_of(self, share: np.ndarray) -> np.ndarray:
        times, values, sums = self._sums
        n = np.clip(np.searchsorted(sums, share, side="right") - 1, 0, len(times) - 2)
        excess, slope = np.maximum(share - sums[n], 0.0), (values[n + 1] - values[n]) / (times[n + 1] - times[n])
        below = values[n] + np.sqrt(np.maximum(values[n] ** 2 + 2 * slope * excess, 0.0))
        past = np.divide(2 * excess, below, out=np.zeros_like(excess), where=below > 0)
        return self.start + times[n] + np.minimum(past, times[n + 1] - times[n])


class PlateauPulse(TabulatedPulse):
    """A constant current whose rise and fall are those of a box convolved with a Gaussian."""

    shape: Literal["plateau"] = "plateau"
    width: Time = Field(gt=0, description="At half of the height, s.")
    rise: Time = Field(gt=0, description="Rms length of the Gaussian that softens both ends, s.")

    @property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        half = self.width / 2 + TAIL * self.rise
        times = np.linspace(-half, half, NODES)
        up, down = ((times + sign * self.width / 2) / self.rise for sign in (1, -1))
        return times + half, np.maximum(scipy.special.ndtr(up) - scipy.special.ndtr(down), 0.0)


class TablePulse(TabulatedPulse):
    """A profile by a table."""

    shape: Literal["table"] = "table"
    times: list[Time] = Field(min_length=2, description="After the start, ascending from 0, s.")
    values: list[Annotated[float, Field(ge=0)]] = Field(
        description="Current at these times over any scale; linear between."
    )

    @model_validator(mode="after")
    def _table(self) -> Self:
        if len(self.values) != len(self.times):
            self.refuse(
                "values", f"has {len(self.values)} members, times has {len(self.times)}", "give one for each", found=""
            )
        if self.times[0] != 0 or not (np.diff(self.times) > 0).all():
            self.refuse("times", "do not ascend from 0", "sort them, and move the rest into start", found="")
        if not any(self.values):
            self.refuse("values", "are all zero", "give a current", found="")
        return self

    @property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array(self.times), np.array(self.values)


AnyPulse = Annotated[SteadyPulse | FlatPulse | GaussianPulse | PlateauPulse | TablePulse, Field(discriminator="shape")]
