"""Loads that come on in steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..errors import InputError, SolverError

FACTORS = (1.5, 1.0, 0.75, 0.5)  # of lengths of steps: few, so that rounding does not change them
NEAR = 0.75  # part of what damage may grow by in a step, at which the next one is aimed
AT_FIRST = 0.25  # part of damage_step in the first step: there the mean of the forces at its ends understates work
LEAST = 1 / 16  # of the first length, for the sake of damage: a crack that runs through at once does so in any step


@dataclass(frozen=True)
class Loads:
    """How far a load has come on, and how large its next step is: 1/`steps` of it, less after steps that failed.

    A step goes from `begin` to `end`, parts of the load; `taken` and `cut` return what follows if it succeeds, and if not. The
    damage of a point may grow by `damage_step` in a step, unless it is one of the shortest that are cut for that: `breaking`,
    or a sixteenth of 1/`steps` without it, and no less than `smallest`.
    """

    steps: int
    smallest: float = 1e-3
    easy: int = 4
    damage_step: float = math.inf
    breaking: float | None = None
    begin: float = 0.0
    length: float | None = None
    refused: tuple[tuple[float, float], ...] = ()  # since the last step that was taken

    def __post_init__(self) -> None:
        if self.steps < 1 or not 0 < self.smallest < 1:
            raise InputError(
                f"steps are {self.steps} and the smallest is {self.smallest}; give at least one, and a part of the load"
            )

    @property
    def end(self) -> float:
        """Where the next step ends."""
        remaining, length = 1 - self.begin, self.length or 1 / self.steps
        return 1.0 if remaining < length * (1 + 1e-9) else self.begin + length

    @property
    def steps_left(self) -> int:
        """How many steps are left, if all are like the next."""
        return math.ceil((1 - self.begin) / (self.end - self.begin) - 1e-9) if self.begin < 1 else 0

    @property
    def most_growth(self) -> float:
        """By how much the damage of a point may grow in the next step."""
        if self.begin == 0:
            most, least = AT_FIRST * self.damage_step, 2 * self.smallest
        else:
            most, least = self.damage_step, 1.5 * self._shortest
        return most if self.end - self.begin >= least else math.inf

    @property
    def _shortest(self) -> float:
        return max(self.breaking or LEAST / self.steps, self.smallest)

    def taken(self, iterations: int, growth: float = 0.0) -> Loads:
        """Return what follows the step: one half as long again after few iterations, up to the first length.

        It is shorter if the damage of a point, which grew by `growth`, would come near to what it may.
        """
        length, most = self.length or 1 / self.steps, NEAR * self.damage_step
        likely = [f for f in FACTORS if f * growth <= most and (f <= 1 or iterations <= self.easy)]
        longest = length * max(likely, default=FACTORS[-1])
        return replace(
            self,
            begin=self.end,
            length=min(1 / self.steps, max(longest, min(length, self._shortest))),
            refused=(),
        )

    def cut(self, why: str) -> Loads:
        """Return what follows if the step fails, for a reason: half of it. SolverError if that is too small."""
        refused, length = (*self.refused, (self.begin, self.end)), (self.end - self.begin) / 2
        if length < self.smallest:
            history = ", ".join(f"{begin:.4g} to {end:.4g}" for begin, end in refused)
            raise SolverError(
                f"no equilibrium beyond {self.begin:.4g} of the load; steps that failed: {history}; the last: {why}"
            )
        return replace(self, length=length, refused=refused)
