"""The section [output] of a scene: what a run writes, and when."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from .section import Section

PART_BYTES = 2**30


class Files(Section):
    """What a run of any method writes."""

    directory: str | None = Field(
        default=None, min_length=1, description="Where to write; runs/<name of the scene> if not given."
    )
    write: Sequence[str] = Field(default=[], description="The kinds of output wanted.")
    checkpoint_every: int = Field(
        default=10, ge=0, description="Steps between checkpoints; 0 writes the last one only."
    )
    keep: int = Field(
        default=2, ge=1, description="Newest checkpoints kept: two, so that one remains if a disk fails the last."
    )
    keep_every: int = Field(
        default=0,
        ge=0,
        description="Of the checkpoints one in so many stays for good, besides the newest: those of steps that are multiples "
        "of keep_every times checkpoint_every; 0: none does.",
    )
    writers: int | None = Field(
        default=None,
        ge=0,
        description="Ranks that write a checkpoint, field or particle file, each a part of its own; 0 lets all of them. If not "
        "given, one for each `part_bytes` of the file, and for each 128 ranks.",
    )
    part_bytes: int = Field(
        default=PART_BYTES,
        ge=1,
        description="Bytes of a file from which on one more rank writes, if `writers` is not given.",
    )


class Output(Files):
    """What a run writes."""

    write: list[Literal["checkpoint", "fields", "particles", "series", "losses", "pictures", "report"]] = Field(
        default=["checkpoint", "fields", "series", "losses", "pictures"],
        description="The kinds of output wanted; particles are openPMD files, which a restart does without; losses are the "
        "records of lost particles and of screens, as openPMD, and a map of losses along z: written where there are any; "
        "report is a page for a browser with all that is known of the run, made at its end.",
    )
    fields_every: int = Field(default=0, ge=0, description="Steps between field files; 0 writes the last one only.")
    particles_every: int = Field(
        default=0, ge=0, description="Steps between particle files; 0 writes the last one only."
    )
