"""Whether what a run wrote is all there and as it was written."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

from ..errors import InputError
from . import checkpoint, shared_file, time_series, vtkhdf_writer
from .writer_ranks import one_line

PNG = b"\x89PNG\r\n\x1a\n"
REMEDY = "restore it from a copy, or let a run write it anew"


def is_output(path: Path) -> bool:
    """Whether a path is, by its name, a folder or something that a run writes into one, rather than a scene."""
    return path.is_dir() or _check_of(path) is not None


def require_whole(path: Path) -> int:
    """Return the number of files and checkpoints checked: the one at a path, or all that a run wrote into the folder there.

    Serial. Raises InputError with a sentence, in lines, for each that is missing in part or damaged, or if there is none.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path} does not exist; give a file that a run wrote, or the folder of a run")
    outputs = [path] if _check_of(path) is not None else sorted(_outputs(path)) if path.is_dir() else []
    if not outputs:
        raise InputError(f"{path} is nothing that a run writes; give a file that a run wrote, or the folder of a run")
    problems = [problem for output in outputs if (problem := _problem(output)) is not None]
    if problems:
        raise InputError("\n".join(problems))
    return len(outputs)


def _outputs(folder: Path) -> Iterator[Path]:
    """Yield what is to be checked in a folder of a run; parts, and what describes tables, with what they belong to."""
    for path in (*folder.iterdir(), *(folder / "openpmd").glob("*.h5")):
        if _check_of(path) is not None and ".part" not in path.name and path.suffix != ".json":
            yield path


def _problem(path: Path) -> str | None:
    check = _check_of(path)
    assert check is not None
    try:
        check(path)
    except InputError as error:
        return str(error)
    except (OSError, ValueError, KeyError, zlib.error) as error:
        return f"{path} is damaged: {one_line(error)}; {REMEDY}"
    return None


def _check_of(path: Path) -> Callable[[Path], object] | None:
    """Return what checks a path, None if nothing does."""
    if path.is_dir():
        named = re.fullmatch(r"checkpoint_\d{8,}", path.name)
        return checkpoint.require_whole if named or checkpoint.is_checkpoint(path) else None
    return next((check for pattern, check in CHECKS.items() if re.fullmatch(pattern, path.name)), None)


def _require_picture(path: Path) -> None:
    """Raise ValueError if a picture in PNG is cut short or one of its checksums is wrong."""
    data, place = path.read_bytes(), len(PNG)
    if not data.startswith(PNG):
        raise ValueError("it is no picture in PNG")
    kind = b""
    while kind != b"IEND":
        length, kind = int.from_bytes(data[place : place + 4]), data[place + 4 : place + 8]
        end = place + 8 + length
        if len(data) < end + 4:
            raise ValueError("it is cut short")
        if zlib.crc32(data[place + 4 : end]) != int.from_bytes(data[end : end + 4]):
            raise ValueError("a checksum in it is wrong: bytes of it have changed")
        place = end + 4


def _require_listed(path: Path) -> None:
    """Raise ValueError if a list of times is damaged, or a file in it is not beside it."""
    for name in vtkhdf_writer.listed_times(path):
        if not path.with_name(name).exists():
            raise ValueError(f"{name} is not beside it")


CHECKS: dict[str, Callable[[Path], object]] = {  # by the name of a file
    r".+\.(vtkhdf|h5|part\d{4,})": shared_file.require_whole,
    r".+\.csv|(series|residuals|beam|slices|losses|own_.+)\.json": time_series.require_whole,
    r".+\.png": _require_picture,
    r".+\.vtkhdf\.series": _require_listed,
}
