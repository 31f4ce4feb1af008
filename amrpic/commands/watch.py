"""amrpic watch: how a run is getting on, until it ends."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from ..errors import InputError
from ..io import time_series
from ..io.run_status import FINISHED, RUNNING, STOPPED, RunStatus
from ..results.run_results import SERIES
from ..tables import columns
from ..units import quantity
from .arguments import Commands, command, seconds
from .methods import MPM
from .run import STOPPED as EXIT_STOPPED

SHOWN: Mapping[str, str] = {  # columns of the series, with their units
    "rms_x": "m",
    "rms_y": "m",
    "rms_z": "m",
    "kinetic_energy": "J",
    "potential_energy": "J",
    "particles": "",
    "cycles": "",
    "seconds": "s",
}
SHOWN_OF_POINTS: Mapping[str, str] = {
    "work": "J",
    "stored": "J",
    "dissipated": "J",
    "turns": "",
    "newton_iterations": "",
    "cg_iterations": "",
    "seconds": "s",
}
WIDTH = 40  # steps in a sparkline
BARS = "▁▂▃▄▅▆▇█"
ENDS = {RUNNING: 0, FINISHED: 0, STOPPED: EXIT_STOPPED}  # exit status; 1 for others


@dataclass(frozen=True)
class Look:
    """What is shown of a run at one moment: facts, and the latest values of a few series."""

    title: str
    facts: list[tuple[str, str]]
    series: list[tuple[str, str, str]]  # name, sparkline, latest value

    @classmethod
    def at(cls, folder: Path, status: RunStatus) -> Look:
        """Return how a run looks now. Raises InputError if its series is damaged."""
        path, latest, columns_shown = folder / SERIES, {}, SHOWN_OF_POINTS if status.method == MPM else SHOWN
        if path.exists():
            latest = time_series.latest(path, list(columns_shown), WIDTH)
        series = [
            (name, sparkline(values), _value(values[-1], columns_shown[name]))
            for name, values in latest.items()
            if values
        ]
        return cls(f"{status.scene}: {status.state}{': ' * bool(status.why)}{status.why}", _facts(status), series)

    @property
    def text(self) -> str:
        """All of it as lines."""
        rows = [*columns(self.facts), "", *columns(self.series)] if self.series else columns(self.facts)
        return "\n".join([self.title, "", *rows])


def sparkline(values: Sequence[float]) -> str:
    """Return bars between the least and the largest value, blank where one is nan."""
    finite = [value for value in values if math.isfinite(value)]
    low, high = min(finite, default=0.0), max(finite, default=0.0)
    step = (high - low) / (len(BARS) - 1) or 1.0
    return "".join(BARS[round((value - low) / step)] if math.isfinite(value) else " " for value in values)


def _facts(status: RunStatus) -> list[tuple[str, str]]:
    done = f"{100 * status.step / status.of:.0f} %" if status.of else "100 %"
    pace, left = status.seconds_per_step, ""
    if status.state == RUNNING and status.estimated_end:
        remaining = datetime.fromisoformat(status.estimated_end) - datetime.now().astimezone()
        left = f", {max(timedelta(seconds=round(remaining.total_seconds())), timedelta(0))} left"
    written = ", ".join(f"{kind} {step}" for kind, step in status.written.items())
    reached, *facts_of_method = _of_points(status) if status.method == MPM else _of_particles(status)
    facts = [
        ("step", f"{status.step} of {status.of}, {done}"),
        reached,
        ("pace", f"{_value(pace, 's')} per step on {status.ranks} rank{'s' * (status.ranks > 1)}{left}"),
        *facts_of_method,
        ("memory", f"{status.memory / 2**20:.0f} MiB on the largest rank"),
        ("written", f"steps: {written}" if written else "nothing yet"),
        ("updated", f"{status.updated}, process {status.process} on {status.host}"),
    ]  # fmt: skip
    return facts


def _of_particles(status: RunStatus) -> list[tuple[str, str]]:
    time = _value(status.time, "s")
    return [
        ("time", f"{time}, step of {_value(status.dt, 's')}" if status.dt else time),
        ("particles", f"{status.particles}, {status.lost_particles} lost"),
        ("mesh", f"{status.levels} levels, {status.cells} cells"),
        ("solve", f"{status.cycles} cycles to {status.residual:.1e}" if status.residual is not None else "none"),
    ]


def _of_points(status: RunStatus) -> list[tuple[str, str]]:
    left = "none" if status.residual is None else f"{status.cycles} CG iterations, {status.residual:.1e} of forces left"
    return [
        ("load", "none" if status.time is None else f"{100 * status.time:.2f} %"),
        ("points", f"{status.particles}"),
        ("solve", left),
    ]


def _value(value: float | None, unit: str) -> str:
    if value is None or not math.isfinite(value):
        return "none"
    return quantity(value, unit) if unit else f"{value:.0f}"


def show(look: Look) -> None:
    """Print a look, on a terminal in place of the one before."""
    place = "\x1b[2J\x1b[H" if sys.stdout.isatty() else ""
    print(f"{place}{look.text}{'' if place else chr(10)}", flush=True)


# ---- the command ----


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    added = command(commands, "watch", _watch, "show how a run is getting on, until it ends")
    added.add_argument("run", metavar="RUN", help="the folder of a run that has begun")
    added.add_argument(
        "--once", action="store_true", help="show it once; exit status 0 unless it was stopped or failed"
    )
    added.add_argument(
        "--every",
        type=seconds("time between two updates", 0.1),
        default=1.0,
        metavar="SECONDS",
        help="time between two updates; default 1",
    )


def _watch(chosen: argparse.Namespace) -> int:
    folder = Path(chosen.run)
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; give that of a run, such as runs/drift")
    latest = None
    while True:
        status = RunStatus.read(folder)
        if status != latest:
            show(Look.at(folder, status))
        latest = status
        if chosen.once or status.state != RUNNING:
            return ENDS.get(status.state, 1)
        time.sleep(chosen.every)
