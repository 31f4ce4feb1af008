"""The checkpoints in the folder of a run: which there are, and which of them stay."""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import InputError, OutputError
from ..mpi import MPI
from ..parallel import from_rank_0, together
from .atomic_files import REPLACED, remove
from .checkpoint import BEFORE_HDF5, STATE

NAME = re.compile(rf"checkpoint_(?P<step>\d+)({re.escape(REPLACED)})?$")


def path_of(directory: Path, step: int) -> Path:
    """Return where the checkpoint of a step lies in a run's directory."""
    return Path(directory) / f"checkpoint_{step:08d}"


def candidates(comm: MPI.Comm, directory: Path) -> list[Path]:
    """Return the finished checkpoints of a directory, the one written last first. Collective."""
    return from_rank_0(comm, lambda: newest_first(Path(directory)), InputError)


def newest_first(directory: Path) -> list[Path]:
    """Return the finished checkpoints of a directory, the one written last first.

    Not by step: what an earlier, longer run left in the same directory is older.
    """
    if not directory.is_dir():
        return []
    finished = [path for path in directory.iterdir() if NAME.match(path.name) and not _succeeded(path)]
    return sorted(finished, key=lambda path: (_written(path), path.name), reverse=True)


def prune(comm: MPI.Comm, directory: Path, keep: int, stride: int = 0) -> None:
    """Delete all but the newest `keep` checkpoints of a directory, and those of steps that are multiples of `stride`.

    Collective; 0: no such steps.
    """
    with together(comm, OutputError):
        for old in newest_first(Path(directory))[max(keep, 1) :] if comm.rank == 0 else ():
            match = NAME.match(old.name)
            if match is None or stride == 0 or int(match["step"]) % stride != 0:
                remove(old)


def _succeeded(path: Path) -> bool:
    """Whether this is a checkpoint that stepped aside for another one, which is in its place."""
    return path.name.endswith(REPLACED) and path.with_name(path.name.removesuffix(REPLACED)).exists()


def _written(path: Path) -> int:
    """Return when a checkpoint was finished, in ns; 0 if it never was."""
    for name in (STATE, BEFORE_HDF5):
        try:
            return (path / name).stat().st_mtime_ns
        except OSError:
            continue
    return 0
