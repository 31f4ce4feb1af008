"""What a verification is asked for: the backend of its solvers and scenes, and how long it may take."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from ..mesh.hierarchy import Hierarchy
from ..scene.scene import Scene
from ..stages.poisson import PoissonSolver

_backend: ContextVar[str | None] = ContextVar("backend", default=None)  # None: the package's default
_long: ContextVar[bool] = ContextVar("long", default=False)
_quick: ContextVar[bool] = ContextVar("quick", default=False)


@contextmanager
def lengths(long: bool, quick: bool) -> Iterator[None]:
    """Let topics within measure their longer comparisons in full if `long`, and fewer cases if `quick`."""
    before = _long.set(long), _quick.set(quick)
    try:
        yield
    finally:
        _long.reset(before[0])
        _quick.reset(before[1])


def in_full() -> bool:
    """Whether longer comparisons are measured in full."""
    return _long.get()


def in_brief() -> bool:
    """Whether fewer cases are measured, where a topic knows which."""
    return _quick.get()


@contextmanager
def backend(name: str | None) -> Iterator[None]:
    """Let all solvers that are made within have this backend; None leaves the default."""
    before = _backend.set(name)
    try:
        yield
    finally:
        _backend.reset(before)


def solver_of(hierarchy: Hierarchy, **options: Any) -> PoissonSolver:
    """A Poisson solver. Collective."""
    return PoissonSolver(hierarchy, **with_backend(options))


def scene_of(data: Mapping[str, Any]) -> Scene:
    """A scene from nested mappings, as `Scene.from_dict`."""
    return Scene.from_dict({**data, "solver": with_backend(data.get("solver", {}))})


def with_backend(options: Mapping[str, Any]) -> dict[str, Any]:
    """Solver options with the backend, if one was chosen and they name none."""
    name = _backend.get()
    return {**options} if name is None else {"backend": name, **options}
