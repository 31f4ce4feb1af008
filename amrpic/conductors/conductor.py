"""What stages ask of an electrode."""

from __future__ import annotations

from typing import Protocol

from ..shapes import Shape


class Conductor(Protocol):
    """Metal of some shape: `amrpic.Electrode`."""

    @property
    def name(self) -> str: ...
    @property
    def shape(self) -> Shape: ...
    @property
    def voltage(self) -> object:
        """What is equal for two that may touch; None where the voltage is not known, as it floats."""
