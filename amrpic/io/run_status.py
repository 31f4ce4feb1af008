"""What a run does now: a small file in its folder that is whole at any moment, for people and scripts that look on."""

from __future__ import annotations

import json
import math
import os
import socket
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from ..errors import InputError
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
