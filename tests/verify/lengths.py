"""How long a topic may take: in brief, or its longer comparisons in full."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Literal

Length = Literal["brief", "whole", "full"]
_length: ContextVar[Length] = ContextVar("length", default="whole")


@contextmanager
def length(chosen: Length) -> Iterator[None]:
    """Let topics within measure fewer cases where they know which, or what takes hours too."""
    before = _length.set(chosen)
    try:
        yield
    finally:
        _length.reset(before)


def in_full() -> bool:
    """Whether longer comparisons are measured in full."""
    return _length.get() == "full"


def in_brief() -> bool:
    """Whether fewer cases are measured, where a topic knows which."""
    return _length.get() == "brief"
