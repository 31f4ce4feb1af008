"""What a run does now: a small file in its folder that is whole at any moment, for people and scripts that look on."""

from __future__ import annotations

import contextlib
import json
import math
import os
import socket
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from ..errors import InputError
from ..failure import sentence
from ..mpi import MPI
from ..scene.any_scene import AnyScene
from .atomic_files import temporary
from .writer_ranks import one_line

FILE = "status.json"
RUNNING, FINISHED, STOPPED, FAILED, GONE = "running", "finished", "stopped", "failed", "gone"


@dataclass(frozen=True)
class RunStatus:
    """The state of a run, as its file holds it. Times of day are UTC in ISO 8601; numbers that are not known are None."""

    scene: str
    version: str
    ranks: int
    host: str  # of rank 0
    process: int
    started: str
    updated: str
    state: str = RUNNING  # finished; stopped: it can go on from its checkpoint; failed
    why: str = ""  # it stopped or failed
    step: int = 0
    of: int = 0  # the last step of the scene
    time: float | None = None  # s, simulated
    dt: float | None = None  # s; 0 without leapfrog
    seconds_per_step: float | None = None  # smoothed over the latest steps
    estimated_end: str = ""
    particles: int = 0
    lost_particles: int = 0
    levels: int = 0
    cells: int = 0
    cycles: int = 0  # of the latest solve
    residual: float | None = None
    memory: int = 0  # bytes, the most that a rank has taken
    written: dict[str, int] = field(default_factory=dict)  # the latest step of each kind of output
    notes: list[str] = field(default_factory=list)  # what the run chose by itself
    warnings: list[str] = field(default_factory=list)
    method: str = ""  # "mpm": material points, whose `time` is the part of the load; else particle-in-cell

    def write(self, folder: Path) -> None:
        """Replace the file in the folder of the run. Raises OSError."""
        path = Path(folder) / FILE
        temporary(path).write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")
        os.replace(temporary(path), path)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Return that of the run in a folder; "gone" if its process is there no longer but had no time to say so.

        Raises InputError if there is none.
        """
        path = Path(folder) / FILE
        try:
            status = cls(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"{path} cannot be read: {one_line(error)}; name the folder of a run of amrpic that has begun"
            ) from None
        return cls(**{**asdict(status), "state": GONE}) if status.state == RUNNING and not status._lives() else status

    def _lives(self) -> bool:
        """Whether the process is there, as far as this machine can tell."""
        if self.host != socket.gethostname():
            return True
        try:
            os.kill(self.process, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass
        return True


def now() -> str:
    """Return the time of day."""
    return stamp(datetime.now(UTC))


def stamp(time: datetime) -> str:
    """Return a time of day as the file holds it."""
    return time.isoformat(timespec="seconds")


def known(value: Any) -> float | None:
    """Return a number, None if it is not finite: JSON has no nan."""
    return float(value) if math.isfinite(value) else None


EVERY = 1.0  # s between two versions of the file


def start_failed(comm: MPI.Comm, scene: AnyScene, failure: BaseException) -> None:
    """Say in the folder of a run that it failed before its first step, unless an earlier one left its status there. Local."""
    status = Status(comm, scene, 0, begin=False)
    if not (scene.directory / FILE).exists():
        status.failed(failure, {})


class Status:
    """Writes `status.json`, on rank 0, at the start, then at most once a second, and at the end. Local.

    A file that cannot be written is left out: no run fails because of it.
    """

    def __init__(self, comm: MPI.Comm, scene: AnyScene, step: int, begin: bool = True) -> None:
        self._folder = scene.directory if comm.rank == 0 and scene.output.write else None
        self._latest = -EVERY
        self._status = RunStatus(
            scene=scene.name,
            version=version("amrpic"),
            ranks=comm.size,
            host=socket.gethostname(),
            process=os.getpid(),
            started=now(),
            updated=now(),
            step=step,
            of=scene.schedule.last_step,
            method=str(scene.to_dict().get("method", "")),
        )
        if begin:
            self._write()

    def step(self, row: Mapping[str, float], pace: float, dt: float, written: Mapping[str, int]) -> None:
        """Take in a step: its row of the series, the pace in s per step, Δt in s, the latest step of each kind of output."""
        cells = [int(value) for name, value in row.items() if name.startswith("cells_")]
        last = int(row.get("last_step", self._status.of))
        left = timedelta(seconds=max(last - int(row["step"]), 0) * pace)
        self._status = replace(
            self._status,
            step=int(row["step"]),
            of=last,
            time=known(row["time"]),
            dt=known(dt),
            seconds_per_step=known(pace),
            estimated_end=stamp(datetime.now(UTC) + left),
            particles=int(row.get("particles", row.get("points", 0))),
            lost_particles=int(row.get("lost_particles", 0)),
            levels=len(cells),
            cells=sum(cells),
            cycles=int(row.get("cycles", row.get("cg_iterations", 0))),
            residual=known(row.get("residual", 0.0)),
            memory=int(row["memory"]),
            written=dict(written),
        )
        if time.monotonic() >= self._latest + EVERY:
            self._write()

    def says(self, notes: Sequence[str], warnings: Iterable[str]) -> None:
        """Take in what the log of the run has said so far besides its steps."""
        self._status = replace(self._status, notes=list(notes), warnings=list(warnings))

    def end(self, state: str, why: str, written: Mapping[str, int]) -> None:
        """Say how the run ended."""
        self._status = replace(self._status, state=state, why=why, written=dict(written), estimated_end=now())
        self._write()

    def failed(self, failure: BaseException, written: Mapping[str, int]) -> None:
        """Say that the run failed, and why."""
        self.end(FAILED, sentence(failure).removeprefix("amrpic: "), written)

    def _write(self) -> None:
        self._latest = time.monotonic()
        self._status = replace(self._status, updated=now())
        if self._folder is not None:
            with contextlib.suppress(OSError):
                self._status.write(self._folder)
