"""What scenes of all methods share: one frozen model that TOML files and Python share, and where its run writes."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

from pydantic import Field, ValidationError

from ..errors import SceneError
from . import toml
from .complaints import refusal
from .section import Section

if TYPE_CHECKING:
    from .run_sections import Files


class Steps(Protocol):
    """A schedule."""

    @property
    def last_step(self) -> int:
        """Number of the step that ends the run."""


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a scene file. Raises SceneError in one sentence."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as reason:
        raise SceneError(f"scene file {path} cannot be read ({reason.strerror}); check the path") from None
    except UnicodeDecodeError as reason:
        raise SceneError(f"scene file {path} is not TOML: {reason}; correct that line") from None


def read_data(path: str | os.PathLike[str], overrides: Iterable[str] = (), text: str | None = None) -> dict[str, Any]:
    """Return what a scene file holds, with `key.path=value` overrides, its name filled in. Raises SceneError.

    `text` is what the file holds, where `read_text` read it before: on rank 0 alone, for all.
    """
    try:
        data = tomllib.loads(read_text(path) if text is None else text)
    except tomllib.TOMLDecodeError as reason:
        raise SceneError(f"scene file {path} is not TOML: {reason}; correct that line") from None
    except RecursionError:
        raise SceneError(f"scene file {path} has tables or arrays in too many others; make it flatter") from None
    toml.override(data, overrides)
    # What is not UTF-8 in a file's name stands as lone surrogates in Python, which no text can hold.
    data.setdefault("name", re.sub("[\ud800-\udfff]", "_", Path(path).stem))
    return data


class AnyScene(Section):
    """A run, described. Each method's scene has its sections, among them `output` and `schedule`."""

    if TYPE_CHECKING:
        output: Files
        schedule: Steps

    name: str = Field(default="scene", min_length=1, description="Name of the scene and of its output folder.")
    seed: int = Field(default=1, ge=0, lt=2**63, description="Of all random numbers; the same seed gives the same run.")

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str], overrides: Iterable[str] = ()) -> Self:
        """Return the scene of a TOML file, with `key.path=value` overrides.

        Raises SceneError in one sentence; paths in the file are relative to it.
        """
        return cls.from_data(read_data(path, overrides), path)

    @classmethod
    def from_data(cls, data: dict[str, Any], path: str | os.PathLike[str]) -> Self:
        """Return the scene of what `read_data` gave of a file. Raises SceneError in one sentence."""
        cls._anchor_files(data, Path(path).parent)
        return cls.from_dict(data, source=str(path))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: str = "scene") -> Self:
        """Return the scene of nested mappings and lists, as TOML and JSON hold. Raises SceneError in one sentence."""
        try:
            return cls.model_validate(data)
        except ValidationError as refused:
            raise refusal(refused, source, cls) from None

    @staticmethod
    def _anchor_files(data: dict[str, Any], folder: Path) -> None:
        """Make paths of files in the scene start at its folder."""

    def to_dict(self) -> dict[str, Any]:
        """Return the resolved scene, all defaults filled in, as plain values; `from_dict` gives the scene back."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_toml(self) -> str:
        """Return the resolved scene as the text of a TOML file."""
        return toml.dumps(self.to_dict())

    @property
    def directory(self) -> Path:
        """Where the run writes."""
        return Path(self.output.directory) if self.output.directory is not None else Path("runs") / self.name

    def summary(self) -> str:
        """Return in one line what the scene is."""
        return self.name

    def remarks(self) -> list[str]:
        """Return one sentence for each thing that is legal and yet may not be meant."""
        return []
