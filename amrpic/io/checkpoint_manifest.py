"""The layout of a checkpoint, and its manifest: what the state is, where its arrays lie, and their checksums.

checkpoint_00001200/
    manifest.json      everything small: step, time, scene, boxes, owners; size and checksum of each part
    part_0000.h5       the cells and particles of a group of ranks, in the order of ranks
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..mesh.boxes import cells_of
from .provenance import Provenance
from .writer_ranks import one_line

FORMAT = "amrpic checkpoint"
FORMAT_VERSION = 2
MANIFEST = "manifest.json"
REMEDY = "restart from another checkpoint"

Array = NDArray[Any]


@dataclass(frozen=True)
class Header:
    """What every rank knows of a state. `domain` and `extra` hold what JSON can; numbers keep every bit."""

    step: int
    time: float  # s
    domain: Mapping[str, Any]
    boxes: Sequence[Array]  # per level (n, 6): lower x, y, z, upper x, y, z, inclusive
    owners: Sequence[Array]  # per level (n,): rank of each box
    about: Provenance = field(default_factory=Provenance)
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Part:
    """One file of a checkpoint, and the ranks whose data it holds."""

    file: str
    first_rank: int
    end_rank: int
    bytes: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """The header and where the rest lies."""

    header: Header
    fields: Sequence[str]
    tables: Mapping[str, Sequence[str]]  # their columns
    rows: Mapping[str, Sequence[int]]  # per table the rows of each rank that wrote
    parts: Sequence[Part]

    @property
    def ranks(self) -> int:
        """Number of ranks that wrote."""
        return self.parts[-1].end_rank

    def places(self, level: int) -> tuple[Array, Array]:
        """Return the part that holds the cells of each box of a level, and the row of its first cell there."""
        cells, writers = cells_of(self.header.boxes[level]), self.header.owners[level]
        part = np.searchsorted([p.end_rank for p in self.parts], writers, side="right")
        order = np.lexsort((np.arange(len(cells)), writers))  # as written: by rank, then in box order
        start = np.empty_like(cells)
        start[order] = np.cumsum(cells[order]) - cells[order]
        first = np.full(len(self.parts), np.iinfo(np.int64).max)
        np.minimum.at(first, part, start)
        return part, start - first[part]


def encode(manifest: Manifest) -> str:
    body = json.dumps(_plain(asdict(manifest)), sort_keys=True)
    digest = hashlib.sha256(body.encode()).hexdigest()
    return f'{{"format": "{FORMAT}", "format_version": {FORMAT_VERSION}, "sha256": "{digest}", "content":\n{body}}}\n'


def _plain(value: Any) -> Any:
    """Return `value` with arrays and NumPy numbers as what JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def decode(path: Path) -> Manifest:
    """Return the manifest of a checkpoint directory; raises InputError if it is not one or is damaged."""
    try:
        envelope = json.loads((path / MANIFEST).read_text())
        if envelope["format"] != FORMAT:
            raise KeyError("format")
        version, content, digest = int(envelope["format_version"]), envelope["content"], envelope["sha256"]
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path} is not a checkpoint: it has no {MANIFEST}; {REMEDY}") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {one_line(error)}; {REMEDY}") from None
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path / MANIFEST} is damaged or foreign; {REMEDY}") from None
    if version != FORMAT_VERSION:
        raise InputError(
            f"{path} has checkpoint format {version}, this version reads {FORMAT_VERSION}; use what wrote it"
        )
    if hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest() != digest:
        raise InputError(f"{path / MANIFEST} is damaged: its checksum is wrong; {REMEDY}")
    return _manifest(content)


def _manifest(content: Mapping[str, Any]) -> Manifest:
    header = dict(content["header"])
    header["boxes"] = [np.array(boxes, dtype=np.int64).reshape(-1, 6) for boxes in header["boxes"]]
    header["owners"] = [np.array(owners, dtype=np.int64) for owners in header["owners"]]
    header.pop("weights", None)  # of older checkpoints: work per box, by which boxes were shared out
    parts = [Part(**part) for part in content["parts"]]
    header["about"] = Provenance(**header["about"])
    return Manifest(Header(**header), content["fields"], content["tables"], content["rows"], parts)
