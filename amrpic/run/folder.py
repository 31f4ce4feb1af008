"""The folder of a run: made, held by one run at a time, and cleared of what an earlier one left."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import socket
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from ..errors import OutputError
from ..mpi import MPI
from ..parallel import together
from ..scene.any_scene import AnyScene

LOCK = ".lock"
STOP = "STOP"  # a file of this name ends the run after a checkpoint
WRITTEN = re.compile(  # what a run writes
    r"(checkpoint|fields|particles|points)_\d{8,}.*|(series|residuals|beam|slices|losses|own_.+)\.(csv|json)|(losses|screen_.+)\.h5|"
    r"(fields|points)\.vtkhdf\.series|status\.json|report\.html|force\.png|openpmd|STOP"
)


def prepare(comm: MPI.Comm, scene: AnyScene) -> None:
    """Make the folder that a scene writes into. Collective; OutputError on all ranks if that is not possible."""
    directory, trial = scene.directory, scene.directory / f".trial_{os.getpid()}"
    with together(comm, OutputError):
        try:
            if comm.rank == 0:
                directory.mkdir(parents=True, exist_ok=True)
                trial.touch()
                trial.unlink()
        except OSError as reason:
            raise OutputError(
                f"output folder {directory} cannot be written ({reason.strerror}); choose another one by --output"
            ) from None


def claimed(comm: MPI.Comm, scene: AnyScene) -> AbstractContextManager[object]:
    """Return a hold on the folder of a scene's run, if anything is written into it. Collective.

    Raises OutputError on all ranks if the folder cannot be written, or another run holds it.
    """
    if not scene.output.write:
        return nullcontext()
    prepare(comm, scene)
    return Claim(comm, scene.directory)


class Claim:
    """A run's hold on its folder, which another run is refused meanwhile; a context manager. Collective to make.

    Raises OutputError on all ranks if another run holds it.
    """

    def __init__(self, comm: MPI.Comm, directory: Path) -> None:
        self._file = -1
        with together(comm, OutputError):
            if comm.rank == 0:
                self._lock(directory)

    def _lock(self, directory: Path) -> None:
        try:
            self._file = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as reason:
            raise OutputError(
                f"{directory / LOCK}, by which a run holds its folder, cannot be opened ({reason.strerror}); remove it, or "
                "choose another folder by --output"
            ) from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as reason:
            holder = os.read(self._file, 200).decode(errors="replace").strip()
            self.release()
            if reason.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise OutputError(
                    f"another run writes into {directory} ({holder}); wait for its end, or choose another folder by --output"
                ) from None
            return  # a file system without locks
        os.ftruncate(self._file, 0)
        os.write(self._file, f"process {os.getpid()} on {socket.gethostname()}".encode())

    def release(self) -> None:
        """Let others write there."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def __enter__(self) -> Claim:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def set_aside(comm: MPI.Comm, directory: Path) -> str | None:
    """Move what an earlier run left in a folder into a folder in it, and return a sentence on that, if there is anything.

    Collective; OutputError on all ranks.
    """
    sentence = None
    with together(comm, OutputError):
        left = [path for path in directory.iterdir() if WRITTEN.fullmatch(path.name)] if comm.rank == 0 else []
        if left:
            number = 1
            while (earlier := directory / f"earlier_{number}").exists():
                number += 1
            earlier.mkdir()
            for path in left:
                path.rename(earlier / path.name)
            sentence = f"what an earlier run left in {directory} is now in {earlier}"
    return sentence
