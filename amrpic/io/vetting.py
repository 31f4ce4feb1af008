"""Foreign HDF5 files are opened in another process first: a damaged one may crash HDF5, and with it whoever reads it."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from ..errors import InputError
from ..mpi import MPI
from ..parallel import from_rank_0
from . import vetting_child

PATIENCE, BYTES_PER_SECOND = 20.0, 20e6  # s of the processor for any file, and the slowest pace of reading one
STALLED = 15  # times as long by the clock on the wall: machines and disks of many users may stand still for a while
REMEDY = "replace it by a whole copy"

Key = tuple[str, int, int]  # path, time of the last change in ns, bytes

_fine: set[Key] = set()  # files that were read to their end, as they were
_child: subprocess.Popen[str] | None = None


def require_readable(path: Path) -> None:
    """Raise InputError if reading an HDF5 file crashes, or does not end. A file is read once while it does not change.

    Whether it is missing, or no HDF5 file, is left to whoever opens it.
    """
    if (key := _key(path)) is not None and key not in _fine:
        answer = _answer(path, PATIENCE + key[2] / BYTES_PER_SECOND)
        if answer != "fine":
            raise InputError(f"{path} cannot be read: {answer}; {REMEDY}")
        _fine.add(key)


def require_readable_on_all(comm: MPI.Comm, paths: Iterable[Path]) -> None:
    """Do the same on rank 0 for some files, so that no other rank needs to. Collective; InputError on all ranks."""

    def read() -> set[Key]:
        for path in files:
            require_readable(path)
        return {key for path in files if (key := _key(path)) is not None}

    if files := list(paths):
        _fine.update(from_rank_0(comm, read, InputError))


def _key(path: Path) -> Key | None:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return os.path.realpath(path), status.st_mtime_ns, status.st_size


def _answer(path: Path, patience: float) -> str:
    """Return what the child says of a file, or of its end; it may take so many seconds of the processor."""
    global _child
    if _child is None or _child.poll() is not None:
        _child = _start()
    child = _child
    assert child.stdin is not None and child.stdout is not None
    with contextlib.suppress(BrokenPipeError):
        child.stdin.write(json.dumps([str(path), patience]) + "\n")
        child.stdin.flush()
    ready, _, _ = select.select([child.stdout], [], [], STALLED * patience)
    if answer := child.stdout.readline().rstrip() if ready else "":
        return answer
    _end()
    status = child.returncode
    if not ready or status == -signal.SIGPROF:
        return f"HDF5 does not come to an end with it in {patience * (1 if ready else STALLED):.0f} s"
    cause = signal.Signals(-status).name if status < 0 else f"status {status}"
    return f"it is damaged, and HDF5 crashes on it ({cause})"


def _start() -> subprocess.Popen[str]:
    # Isolated: neither the working directory nor the user's own modules can stand in for h5py.
    command = [sys.executable, "-I", vetting_child.__file__]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        start_new_session=True,  # Ctrl-C is for the run, which ends the child by closing its input
    )  # fmt: skip


@atexit.register
def _end() -> None:
    """End the child, if there is one."""
    global _child
    if _child is not None:
        if _child.poll() is None:
            _child.kill()
        _child.wait()
        for stream in (_child.stdin, _child.stdout):
            with contextlib.suppress(OSError):
                stream.close()  # type: ignore[union-attr]
        _child = None
