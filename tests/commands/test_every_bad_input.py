"""Every bad input of `bad_inputs`: one sentence, a failing exit status, no traceback, no hang, and nothing written lost.

An ordinary run takes a sixth of them, on two ranks; the long form (`pytest -m long`) all, on one rank and on two.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import bad_inputs
from refusals import ended

EVERY = 6  # of an ordinary run

Case = tuple[str, tuple[str, ...]]  # name, command


def run(scene: Path | str, *more: str) -> tuple[str, ...]:
    return ("run", str(scene), "--output", "run", *more)


def overrides(comm: Any, every: int) -> Iterator[Case]:
    for override in bad_inputs.OVERRIDES[::every]:
        folder = () if override.startswith("output.directory") else ("--output", "run")
        yield override, ("run", "good.toml", "--set", override, *folder)


def scene_files(comm: Any, every: int) -> Iterator[Case]:
    for number, (name, data) in enumerate([*bad_inputs.SCENE_FILES.items()][::every]):
        alone(comm, partial(Path(f"scene{number}.toml").write_bytes, data))
        yield name, run(f"scene{number}.toml")


def commands(comm: Any, every: int) -> Iterator[Case]:
    for command in bad_inputs.COMMANDS[::every]:
        yield " ".join(command), tuple({"SCENE": "good.toml", "OUT": "run"}.get(word, word) for word in command)


def beams(comm: Any, every: int) -> Iterator[Case]:
    for number, (name, (distribution, write)) in enumerate([*bad_inputs.BEAMS.items()][::every]):
        path = Path(f"beam{number}" + (".npz" if distribution == "arrays" else ".h5"))
        alone(comm, partial(write, path))
        charge = ",charge=-1e-12,species='electron'" if distribution == "arrays" else ""
        yield name, run("good.toml", "--set", f"bunches=[{{distribution='{distribution}',file='{path}'{charge}}}]")


def outputs(comm: Any, every: int) -> Iterator[Case]:
    for name, (file, damage, command) in [*bad_inputs.OUTPUTS.items()][::every]:

        def prepare(file: str = file, damage: Callable[[Path], object] = damage) -> None:
            shutil.rmtree("damaged", ignore_errors=True)
            shutil.copytree("run", "damaged")
            damage(Path(file.replace("run/", "damaged/")))

        alone(comm, prepare)
        words = {"SCENE": "good.toml", "OUT": "run"}
        yield name, tuple(words.get(word, word).replace("run/", "damaged/") for word in command)


def alone(comm: Any, act: Callable[[], object]) -> None:
    """Do something on rank 0 while the others wait."""
    if comm.rank == 0:
        act()
    comm.Barrier()


def contents() -> set[bytes]:
    """The checksums of the files in the run's folder, wherever they are in it."""
    files = (path for path in Path("run").rglob("*") if path.is_file() and path.name != ".lock")
    return {hashlib.sha256(path.read_bytes()).digest() for path in files}


def fault(status: int, text: str) -> str | None:
    """What is wrong with the end of a command that must fail."""
    if status not in (1, 2):
        return f"status {status}"
    if text.count("\n") != 1 or "; " not in text or "unexpected" in text or "Traceback" in text:
        return "not one sentence with a remedy"
    return None


KINDS = (overrides, scene_files, commands, beams, outputs)


@pytest.mark.mpi(ranks=(2,), timeout=600)
@pytest.mark.parametrize("cases", KINDS)
def test_some_bad_inputs_are_refused_and_nothing_is_lost(comm, tmp_path, monkeypatch, cases):
    monkeypatch.chdir(tmp_path)
    refuse(comm, partial(cases, every=EVERY))


@pytest.mark.long
@pytest.mark.mpi(ranks=(1, 2), timeout=600)
@pytest.mark.parametrize("cases", KINDS)
def test_all_bad_inputs_are_refused_and_nothing_is_lost(comm, tmp_path, monkeypatch, cases):
    monkeypatch.chdir(tmp_path)
    refuse(comm, partial(cases, every=1))


def refuse(comm: Any, cases: Callable[[Any], Iterator[Case]]) -> None:
    """Assert that each case is refused as it must be, in the present folder. Collective."""
    alone(comm, lambda: Path("good.toml").write_text(bad_inputs.SCENE))
    assert ended(comm, *run("good.toml")) == (0, "")
    kept = contents()
    assert len(kept) >= 5
    faults = []
    for name, command in cases(comm):
        status, text = ended(comm, *command)
        if wrong := fault(status, text):
            faults.append(f"{name}: {wrong}: {text}")
        if not kept <= contents():
            faults.append(f"{name}: what was written before is lost")
            break
    assert not faults, "\n".join(faults)


def test_there_are_250_of_them():
    tables = (bad_inputs.OVERRIDES, bad_inputs.SCENE_FILES, bad_inputs.COMMANDS, bad_inputs.BEAMS, bad_inputs.OUTPUTS)
    assert sum(len(set(table)) for table in tables) >= 250
