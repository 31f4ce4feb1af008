"""External fields that are Python functions of place and time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..mesh.window import Window
from ..mpi import MPI
from ..parallel import call_together
from ..particles.arrays import empty_columns
from ..particles.particles import Particles
from ..scene.units import with_article

Components = Sequence[ArrayLike]
FieldFunction = Callable[[np.ndarray, np.ndarray, np.ndarray, float], tuple[Components, Components]]


class FieldFunctions:
    """Functions (x, y, z, t) -> (E, B) whose fields add.

    x, y, z (n,) in m are the places of this rank's particles, read-only, and t in s is their time. E in V/m and B in T have
    three components each, along x, y, z, each an array (n,) or one number. All are in the laboratory. A function is called on
    all ranks, also for n = 0, once per step and kick, and may communicate.
    """

    def __init__(self, comm: MPI.Comm, functions: Sequence[FieldFunction]) -> None:
        """Raises InputError if one is no function."""
        self._comm, self._functions = comm, tuple(functions)
        for number, function in enumerate(self._functions):
            if not callable(function):
                raise InputError(f"fields[{number}] is {function!r}; give a function of x, y, z, t that returns E, B")

    def __len__(self) -> int:
        return len(self._functions)

    @property
    def names(self) -> list[str]:
        """What the functions are called."""
        return [str(getattr(function, "__name__", type(function).__name__)) for function in self._functions]

    def at(self, particles: Particles, time: float, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Return E in V/m and B in T, (n, 3), at the particles of a window and along its axes, at `time` in s. Collective.

        InputError on all ranks if a function fails, or returns other shapes or numbers that are not finite.
        """
        places = window.places(particles.position)
        places.flags.writeable = False
        fields = [empty_columns(len(particles)) for _ in range(2)]
        for field in fields:
            field[...] = 0

        def add(function: FieldFunction) -> None:
            x, y, z = places.T
            values = function(x, y, z, time)
            if not isinstance(values, tuple | list | np.ndarray) or len(values) != 2:
                raise ValueError(f"it returns {_shapes(values)}; return two, E and B")
            for name, field, components in zip("EB", fields, values, strict=True):
                field += window.from_laboratory(_columns(name, components, places))

        for number, (function, name) in enumerate(zip(self._functions, self.names, strict=True)):
            purpose = f'fields[{number}], "{name}", failed at t = {time:g} s'
            call_together(self._comm, lambda function=function: add(function), InputError, purpose)  # type: ignore[misc]
        return fields[0], fields[1]


def _columns(name: str, components: Any, places: np.ndarray) -> np.ndarray:
    """Return three components as (n, 3). Raises ValueError if they do not fit, or are not finite."""
    count, remedy = len(places), "return its x, y, z, each an array (n,) or one number"
    if not isinstance(components, tuple | list | np.ndarray) or len(components) != 3:
        raise ValueError(f"{name} is {_shapes(components)} for n = {count} particles; {remedy}")
    values = [np.asarray(component, dtype=np.float64) for component in components]
    if any(value.shape not in ((), (count,)) for value in values):
        raise ValueError(f"{name} is {_shapes(components)} for n = {count} particles; {remedy}")
    out = np.stack([np.broadcast_to(value, count) for value in values], axis=1)
    bad = np.flatnonzero(~np.isfinite(out).all(axis=1))
    if len(bad):
        place = ", ".join(f"{x:g}" for x in places[bad[0]])
        raise ValueError(
            f"{name} = {out[bad[0]].tolist()} at ({place}) m, one of {len(bad)} places where it is not finite; "
            "return finite numbers at all particles"
        )
    return out


def _shapes(values: Any) -> str:
    """Return what something is, in words."""
    if isinstance(values, np.ndarray):
        return f"an array of shape {values.shape}"
    if isinstance(values, tuple | list):
        return f"{len(values)} values of shapes {', '.join(str(np.shape(value)) for value in values) or 'none'}"
    return with_article(type(values).__name__)
