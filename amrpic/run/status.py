"""The status of a run, kept up to date in its folder."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from importlib.metadata import version

from ..failure import sentence
from ..io.run_status import FAILED, FILE, RunStatus, known, now, stamp
from ..mpi import MPI
from ..scene.any_scene import AnyScene

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
