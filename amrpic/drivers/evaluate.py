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

from ..errors import AmrpicError, InputError
from ..io import time_series
from ..io.atomic_files import temporary
from ..io.run_status import FINISHED, RunStatus
from ..results.run_results import rows_of
from ..scene import toml

SETTINGS = "settings.json"
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
    path = run(inputs, scene, Path(folder) / name_of(inputs, scene), ranks)
    numbers = last_of(path)
    if outputs is None:
        return numbers
    if unknown := [name for name in outputs if name not in numbers]:
        raise InputError(f"{path} has no {unknown[0]}; choose among {', '.join(numbers)}")
    return {name: numbers[name] for name in outputs}


def name_of(inputs: Mapping[str, Any], scene: str | os.PathLike[str]) -> str:
    """Return what the run of a scene with these inputs is called."""
    digest = hashlib.sha256(_recorded(inputs, scene).encode()).hexdigest()[:DIGITS]
    name = re.sub(r"[^\w-]", "_", Path(scene).stem)
    return f"{name}_{digest}"


def run(inputs: Mapping[str, Any], scene: str | os.PathLike[str], folder: Path, ranks: int = 1) -> Path:
    """Run a scene with some inputs in a folder, unless that has been done or go on where it stopped; return the folder."""
    recorded = _recorded(inputs, scene)
    if is_done(inputs, scene, folder):
        return folder
    settings = folder / SETTINGS
    same = settings.exists() and settings.read_text(encoding="utf-8") == recorded
    assignments = [part for key, value in inputs.items() for part in ("--set", f"{key}={assigned(value)}")]
    command = [sys.executable, "-c", "from amrpic.commands.main import main; main()", "run", str(scene), *assignments]
    command += ["--output", str(folder), *(["--restart", "auto"] if same else [])]
    if ranks > 1:
        if (mpiexec := shutil.which("mpiexec")) is None:
            raise InputError(f"{ranks} ranks are asked for, but there is no mpiexec; install an MPI, or use one rank")
        command = [mpiexec, "-n", str(ranks), *command]
    ended = subprocess.run(command, capture_output=True, text=True, env=_environment(), check=False)
    if folder.is_dir():
        temporary(settings).write_text(recorded, encoding="utf-8")
        os.replace(temporary(settings), settings)
    if ended.returncode != 0:
        lines = [line for line in ended.stderr.strip().splitlines() if line.strip()]
        message = next((line for line in lines if line.startswith("amrpic:")), lines[-1] if lines else "no message")
        raise AmrpicError(f"the run in {folder} ended with status {ended.returncode}: {message[:400]}")
    return folder


def is_done(inputs: Mapping[str, Any], scene: str | os.PathLike[str], folder: Path) -> bool:
    """Whether the run of a scene with these inputs has ended in a folder."""
    settings = folder / SETTINGS
    if not settings.exists() or settings.read_text(encoding="utf-8") != _recorded(inputs, scene):
        return False
    return RunStatus.read(folder).state == FINISHED


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


def assigned(value: Any) -> str:
    """Return a value as `--set` takes it."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    return value if isinstance(value, str) else toml.text(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _recorded(inputs: Mapping[str, Any], scene: str | os.PathLike[str]) -> str:
    """Return inputs and the text of a scene, which say whether a run is the same."""
    try:
        text = Path(scene).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as refused:
        raise InputError(f"scene file {scene} cannot be read ({refused}); check the path") from None
    assignments = {key: assigned(value) for key, value in inputs.items()}
    digest = hashlib.sha256(text.encode()).hexdigest()
    return json.dumps({"scene": digest, "inputs": dict(sorted(assignments.items()))}, indent=1)


def _environment() -> dict[str, str]:
    """Return the environment of a run that knows nothing of an MPI that this process may have begun."""
    own = ("OMPI_", "PMIX_", "PMI_", "MPI_LOCAL", "PRTE_")
    path = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {key: value for key, value in os.environ.items() if not key.startswith(own)} | {"PYTHONPATH": path}
