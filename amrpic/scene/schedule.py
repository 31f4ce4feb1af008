"""The section [schedule] of a scene: how long a run is."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from .section import Section
from .units import Time

MOST = 2**31 - 1  # steps


class Schedule(Section):
    """How long a run is. The first solve comes before the first step."""

    steps: int | None = Field(default=None, ge=0, le=MOST, description="Steps after the first solve.")
    start: Time | None = Field(
        default=None,
        description="Time at the start, s, of RF phases and all that depends on time. By default that of the openPMD files "
        "that bunches are read from, else 0.",
    )
    solves: int | None = Field(default=None, ge=1, le=MOST, description="Solves in all instead: one more than steps.")

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if self.steps is not None and self.solves is not None:
            self.refuse("solves", "is given as well as steps", "keep one of the two")
        return self

    @property
    def last_step(self) -> int:
        """Number of the step that ends the run."""
        return self.steps if self.steps is not None else (self.solves or 1) - 1
