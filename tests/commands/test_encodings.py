"""Commands in terminals of old encodings, with names of files that are no text, in folders that something is in the way in."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from amrpic.commands.main import main

AMRPIC = [sys.executable, "-c", "from amrpic.commands.main import main; main()"]
SCENE = """
[domain]
lower = "-5 mm"
upper = "5 mm"
cells = 16
[[bunches]]
name = "σ bunch"
distribution = "gaussian"
species = "electron"
sigma = "1 mm"
charge = "-1 pC"
particles = 20000
[refinement]
levels = 1
rule = { kind = "charge-density", relative = 1e-2 }
[output]
write = ["series", "fields", "checkpoint", "particles"]
"""
COMMANDS = [
    "run s.toml",  # its log says (σ/h)²
    "run s.toml --restart auto",
    "check s.toml --resolved",
    "check runs/s",
    "preview s.toml --seconds 0.1",
    "watch runs/s --once",
    "report runs/s",
    "compare runs/s runs/s",
    "plot runs/s --kind line --quantity phi",
    "schema --markdown",
    "scaling s.toml --ranks 1 --steps 1",
    "doctor",
    "verify σ",  # refused, with the letter in what is said
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "s.toml").write_text(SCENE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(command: str, encoding: str, monkeypatch: pytest.MonkeyPatch) -> tuple[int, str]:
    """The exit status of a command and what it printed in an encoding."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in "oe"]
    for name, stream in zip(("stdout", "stderr"), streams, strict=True):
        monkeypatch.setattr(sys, name, stream)
    with pytest.raises(SystemExit) as end:
        main(command.split())
    for stream in streams:
        stream.flush()
    return int(end.value.code or 0), "".join(stream.buffer.getvalue().decode(encoding) for stream in streams)


@pytest.mark.long
@pytest.mark.parametrize("encoding", ["latin-1", "ascii"])
def test_every_command_prints_in_any_encoding(folder: Path, encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for command in COMMANDS:
        status, text = said(command, encoding, monkeypatch)
        assert status == (2 if command.startswith("verify") else 0), (command, text)
        assert text and "unexpected" not in text, (command, text)
        if command in ("run s.toml", "check s.toml --resolved") or command.startswith("verify"):
            assert "?" in text, (command, text)


def test_a_run_prints_and_previews_in_ascii(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status, text = said("run s.toml", "ascii", monkeypatch)
    assert (status, "more than 140 (?/h)? particles" in text) == (0, True)
    status, text = said("preview s.toml --seconds 0", "utf-8", monkeypatch)
    assert status == 0 and " -1 pC " in text and "−" not in text


def test_files_are_written_where_the_locale_is_ascii(folder: Path) -> None:
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [*AMRPIC, "run", "s.toml"], env=os.environ | locale, capture_output=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (folder / "runs" / "s" / "checkpoint_00000000").is_dir()


def test_names_that_are_no_text_are_names(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Latin-1 names of scene, folder and bunch file, in a terminal of UTF-8."""
    name = os.fsdecode(b"\xfc.toml")
    (folder / "s.toml").rename(name)
    status, text = said(f"run {name}", "utf-8", monkeypatch)
    assert status == 0, text
    assert (folder / "runs" / "_" / "series.csv").exists()  # named after the scene
    odd = os.fsdecode(b"\xe9")
    (folder / odd).mkdir()
    (folder / "runs" / "_").rename(folder / odd / "run")
    for command in (
        f"check {odd}/run",
        f"compare {odd}/run {odd}/run",
        f"run {name} --output {odd}/run --restart auto",
    ):
        status, text = said(command, "utf-8", monkeypatch)
        assert status == 0, (command, text)
    file = '[[bunches]]\ndistribution = "openpmd"\nfile = "run/particles_00000000.h5"\n'
    (folder / odd / "f.toml").write_text('domain = { lower = "-5 mm", upper = "5 mm", cells = 8 }\n' + file)
    status, text = said(f"run {odd}/f.toml --output {odd}/f", "utf-8", monkeypatch)
    assert status == 0, text
    assert (folder / odd / "f" / "checkpoint_00000000").is_dir()


def test_a_lock_that_is_a_folder_is_one_sentence_and_nothing_is_moved(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = folder / "runs" / "s"
    (directory / ".lock").mkdir(parents=True)
    (directory / "series.csv").write_text("step\n0\n")
    status, text = said("run s.toml", "utf-8", monkeypatch)
    assert status == 1 and "runs/s/.lock" in text and "Is a directory" in text and "unexpected" not in text
    assert (directory / "series.csv").read_text() == "step\n0\n"


def test_nothing_is_moved_away_before_a_run_can_begin(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever goes wrong before the first row: here the first line of the log."""
    from amrpic.run.log import RunLog

    directory = folder / "runs" / "s"
    directory.mkdir(parents=True)
    (directory / "series.csv").write_text("step\n0\n")

    def fails(self: RunLog, text: str) -> None:
        raise RuntimeError(text)

    monkeypatch.setattr(RunLog, "note", fails)
    status, _ = said("run s.toml", "utf-8", monkeypatch)
    assert status == 1
    assert (directory / "series.csv").read_text() == "step\n0\n" and not (directory / "earlier_1").exists()
