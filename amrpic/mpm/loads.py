"""Loads that come on in steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from ..errors import InputError, SolverError

State = TypeVar("State")
GROWTH = 1.5


@dataclass(frozen=True)
class LoadStep:
    """A step that was taken or refused, from one part of the load to another, and its Newton iterations."""

    begin: float
    end: float
    taken: bool
    iterations: int


def in_steps(
    state: State,
    advance: Callable[[State, float, float], tuple[State | None, int]],
    *,
    steps: int,
    smallest: float = 1e-3,
    easy: int = 4,
) -> tuple[State, Sequence[LoadStep]]:
    """Return the state under the whole load, and the steps that led there. Collective if `advance` is.

    advance(state, begin, end) gives the state at part `end` of the load, None where it finds none, and its Newton iterations.
    Steps are 1/`steps` of the load; one without a state is halved, and after one of at most `easy` iterations the next is half
    as long again, up to the first length. InputError for no number of steps; SolverError where a step below `smallest` fails.
    """
    if steps < 1 or not 0 < smallest < 1:
        raise InputError(f"steps are {steps} and the smallest is {smallest}; give at least one, and a part of the load")
    begin, length, taken = 0.0, 1.0 / steps, []
    while begin < 1:
        rest = 1 - begin
        end = 1.0 if rest < length * (1 + 1e-9) else begin + length
        found, iterations = advance(state, begin, end)
        taken.append(LoadStep(begin, end, found is not None, iterations))
        if found is not None:
            state, begin = found, end
            length = min(1.0 / steps, length * (GROWTH if iterations <= easy else 1))
            continue
        length = (end - begin) / 2
        if length < smallest:
            history = ", ".join(f"{s.begin:.4g} to {s.end:.4g}" for s in taken if not s.taken)
            raise SolverError(f"no equilibrium beyond {begin:.4g} of the load; steps that failed: {history}")
    return state, taken
