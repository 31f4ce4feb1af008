"""All kinds of sources."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from .injection import FunctionSource, InjectionSource
from .sources import FieldSource, FileSource, GivenSource, PhotoSource, SpaceChargeLimitedSource, ThermionicSource

AnySource = Annotated[
    GivenSource
    | PhotoSource
    | InjectionSource
    | FileSource
    | FunctionSource
    | SpaceChargeLimitedSource
    | ThermionicSource
    | FieldSource,
    Field(discriminator="process"),
]
