"""The layout of a checkpoint, and its manifest: what the state is, where its arrays lie, and their checksums.

checkpoint_00001200/
    manifest.json      everything small: step, time, scene, boxes, owners; what each part holds and where
    part_0000.h5       the cells and particles of a group of ranks, in the order of ranks; in `index` the rows of each of them
                       and a checksum of each piece of its rows, `piece_bytes` long at most

Datasets are contiguous, so a restart reads rows at their places in the file, and checks them piece by piece. The checksum of
the index is in the manifest, that of the manifest's content in itself.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
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
FORMAT_VERSION = 3
CONTENT, END = ', "content":\n', "}\n"  # around the content in the file
MANIFEST = "manifest.json"
REMEDY = "restart from another checkpoint"

Array = NDArray[Any]


class UnreadableCheckpoint(InputError):
    """A checkpoint that is incomplete, damaged or foreign; another one may do."""


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
class Kind:
    """What the rows of an array are, which is the same in all parts."""

    name: str  # of the dataset
    dtype: str
    shape: Sequence[int]  # of a row

    @property
    def bytes(self) -> int:
        """Bytes of a row."""
        return np.dtype(self.dtype).itemsize * math.prod(self.shape)


@dataclass(frozen=True)
class Part:
    """One file of a checkpoint, and the ranks whose data it holds."""

    file: str
    first_rank: int
    end_rank: int
    bytes: int
    rows: Mapping[str, int]  # per table
    offsets: Sequence[int]  # of the first byte of each array; 0 of empty ones
    rows_offset: int  # of the rows of each array on each rank, (ranks, arrays) int64
    digests_offset: int  # of the checksums of the pieces, by rank, then by array
    sha256: str  # of these two
    sha256_of_rest: str = ""  # of the bytes besides all of these, which are HDF5's own; older checkpoints lack it

    def spans(self, rows: Array, kinds: Sequence[Kind], digest_bytes: int) -> list[tuple[int, int]]:
        """Return where arrays and index lie, (first byte, end) in order; `rows` are those of an index."""
        sizes = [*(rows.sum(axis=0) * [kind.bytes for kind in kinds]).tolist(), rows.nbytes, digest_bytes]
        offsets = [*self.offsets, self.rows_offset, self.digests_offset]
        return sorted((offset, offset + size) for offset, size in zip(offsets, sizes, strict=True) if size)


@dataclass(frozen=True)
class Manifest:
    """The header and where the rest lies."""

    header: Header
    fields: Sequence[str]
    tables: Mapping[str, Sequence[str]]  # their columns
    arrays: Sequence[Kind]  # of which the parts hold rows
    piece_bytes: int
    parts: Sequence[Part]

    @property
    def ranks(self) -> int:
        """Number of ranks that wrote."""
        return self.parts[-1].end_rank

    def rows(self, table: str) -> list[int]:
        """Return the rows of a table in each part."""
        return [part.rows[table] for part in self.parts]

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
    return _with_checksum(body)


def _with_checksum(body: str) -> str:
    digest = hashlib.sha256(body.encode()).hexdigest()
    return f'{{"format": "{FORMAT}", "format_version": {FORMAT_VERSION}, "sha256": "{digest}"{CONTENT}{body}{END}'


def _plain(value: Any) -> Any:
    """Return `value` with arrays and NumPy numbers as what JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):  # as bytes: there may be a million boxes
        text = base64.b64encode(value.tobytes()).decode()
        return {"dtype": value.dtype.str, "shape": value.shape, "base64": text}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def decode(path: Path) -> Manifest:
    """Return the manifest of a checkpoint directory; raises UnreadableCheckpoint if it is not one or is damaged."""
    try:
        text = (path / MANIFEST).read_text()
        envelope = json.loads(text)
        if envelope["format"] != FORMAT:
            raise KeyError("format")
        version, content = int(envelope["format_version"]), envelope["content"]
    except (FileNotFoundError, NotADirectoryError):
        raise UnreadableCheckpoint(f"{path} is not a checkpoint: it has no {MANIFEST}; {REMEDY}") from None
    except OSError as error:
        raise UnreadableCheckpoint(f"{path} cannot be read: {one_line(error)}; {REMEDY}") from None
    except (ValueError, KeyError, TypeError):
        raise UnreadableCheckpoint(f"{path / MANIFEST} is damaged or foreign; {REMEDY}") from None
    if version != FORMAT_VERSION:
        raise UnreadableCheckpoint(
            f"{path} has checkpoint format {version}, this version reads {FORMAT_VERSION}; use what wrote it"
        )
    if text != _with_checksum(text.partition(CONTENT)[2].removesuffix(END)):
        raise UnreadableCheckpoint(f"{path / MANIFEST} is damaged: its checksum is wrong; {REMEDY}")
    return _manifest(content)


def _manifest(content: Mapping[str, Any]) -> Manifest:
    header = dict(content["header"])
    for name in ("boxes", "owners"):
        header[name] = [_array(packed) for packed in header[name]]
    header.pop("weights", None)  # of older checkpoints: work per box, by which boxes were shared out
    header["about"] = Provenance(**header["about"])
    kinds, parts = [Kind(**one) for one in content["arrays"]], [Part(**one) for one in content["parts"]]
    return Manifest(Header(**header), content["fields"], content["tables"], kinds, int(content["piece_bytes"]), parts)


def _array(packed: Mapping[str, Any]) -> Array:
    values = np.frombuffer(base64.b64decode(packed["base64"]), packed["dtype"])
    return values.reshape(packed["shape"]).copy()  # which may be written to
