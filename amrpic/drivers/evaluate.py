"""A run as a function: settings in, numbers out, as optimisers want it."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import AmrpicError, InputError, OutputError
from ..io import time_series
from ..io.run_status import FILE as STATUS
from ..io.run_status import FINISHED, RunStatus
from ..results.run_results import rows_of
from ..scene import toml
from ..scene.any_scene import read_text

SETTINGS, LOG = "settings.json", "log.txt"  # what was set; what the run printed
PROGRAM = "amrpic: "  # begins what a command says when it fails
ALL = "all"  # the group of beam.csv that has all particles
DIGITS = 12  # of the name of a folder


def evaluate(
    inputs: Mapping[str, Any],
    scene: str | os.PathLike[str],
    folder: str | os.PathLike[str] = "runs",
    ranks: int = 1,
    outputs: Sequence[str] | None = None,
) -> dict[str, float]:
    """Run a scene with some values of it, and return the numbers of its last step.

    `inputs`: values by their keys, as `--set` has them: {"bunches.0.charge": "-10 pC", "solver.tolerance": 1e-8}. `scene`: its
    file. `folder`: where the run gets a folder of its own, by what the inputs are; a run that has ended there is read, not
    repeated. `outputs`: columns of series.csv and beam.csv (those of all particles) that are wanted; None: all of them.

    It can be called from many threads at once. InputError for a scene or an input that cannot be, AmrpicError for a run that
    fails.
    """
    numbers = last_of(run(inputs, scene, Path(folder), ranks))
    if outputs is None:
        return numbers
    if unknown := [name for name in outputs if name not in numbers]:
        raise InputError(f"there is no {unknown[0]} in the tables of the run; choose among {', '.join(numbers)}")
    return {name: numbers[name] for name in outputs}


def run(
    inputs: Mapping[str, Any],
    scene: str | os.PathLike[str],
    folder: Path,
    ranks: int = 1,
    timeout: float | None = None,
) -> Path:
    """Run a scene with some inputs in a folder of its own inside `folder`, and return that one.

    A run that has ended there is not repeated; one that was cut off goes on from its newest checkpoint. `timeout` in s: the run
    stops before, after a checkpoint, and AmrpicError says so.
    """
    own = folder / name_of(inputs, scene)
    if is_done(own):
        return own
    try:
        own.mkdir(parents=True, exist_ok=True)
        (own / SETTINGS).write_text(_recorded(inputs, scene), encoding="utf-8")
    except OSError as reason:
        raise OutputError(f"folder {own} cannot be written ({reason.strerror}); choose another one") from None
    command = [sys.executable, "-c", "from amrpic.commands.main import main; main()", "run", str(scene)]
    command += [part for assignment in assignments(inputs) for part in ("--set", assignment)]
    command += ["--output", str(own), "--restart", "auto"]
    command += [] if timeout is None else ["--walltime", f"{timeout} s"]
    if ranks > 1:
        if (mpiexec := shutil.which("mpiexec")) is None:
            raise InputError(f"{ranks} ranks are asked for, but there is no mpiexec; install an MPI, or use one rank")
        command = [mpiexec, "-n", str(ranks), *command]
    # The run writes into a file, not into a pipe: after Ctrl-C it outlives this process until its checkpoint is written.
    with (
        open(own / LOG, "w", encoding="utf-8") as log,
        subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=_environment()) as process,
    ):
        status = process.wait()
    if status != 0:
        lines = (own / LOG).read_text(encoding="utf-8", errors="replace").split("\n")
        message = next((line.removeprefix(PROGRAM) for line in lines if line.startswith(PROGRAM)), "")
        raise AmrpicError(f"the run in {own} ended with status {status}: {message or f'see {LOG} there'}")
    return own


def name_of(inputs: Mapping[str, Any], scene: str | os.PathLike[str]) -> str:
    """Return the name of a run's folder, another one for each text of the scene's file and for all inputs."""
    digest = hashlib.sha256(_recorded(inputs, scene).encode()).hexdigest()[:DIGITS]
    name = re.sub(r"[^\w-]", "_", Path(scene).stem)
    return f"{name}_{digest}"


def is_done(folder: Path) -> bool:
    """Whether the run in a folder has ended."""
    return (folder / STATUS).exists() and RunStatus.read(folder).state == FINISHED


def last_of(folder: Path) -> dict[str, float]:
    """Return the numbers of the last step of a run: columns of series.csv, then those of beam.csv that are not among them."""
    row = rows_of(folder)[-1]
    numbers = {name: float(row[name]) for name in row.dtype.names or () if _is_number(row[name])}
    if (beam := folder / "beam.csv").exists():
        rows = time_series.read(beam)
        rows = rows[rows["group"] == ALL] if "group" in (rows.dtype.names or ()) else rows
        for name in (rows.dtype.names or ()) if len(rows) else ():
            if _is_number(rows[name][-1]):
                numbers.setdefault(name, float(rows[name][-1]))
    return numbers


def assignments(inputs: Mapping[str, Any]) -> list[str]:
    """Return inputs as `--set` takes them."""
    return [f"{key}={_assigned(value)}" for key, value in inputs.items()]


def _assigned(value: Any) -> str:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    return value if isinstance(value, str) else toml.text(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _recorded(inputs: Mapping[str, Any], scene: str | os.PathLike[str]) -> str:
    """Return inputs and the text of a scene, which say whether a run is the same."""
    text = read_text(scene)
    values = {key: _assigned(inputs[key]) for key in sorted(inputs)}
    return json.dumps({"scene": hashlib.sha256(text.encode()).hexdigest(), "inputs": values}, indent=1)


def _environment() -> dict[str, str]:
    """Return the environment of a run that knows nothing of an MPI that this process may have begun."""
    own = ("OMPI_", "PMIX_", "PMI_", "MPI_LOCAL", "PRTE_")
    path = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {key: value for key, value in os.environ.items() if not key.startswith(own)} | {"PYTHONPATH": path}
