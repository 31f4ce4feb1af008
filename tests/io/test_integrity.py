"""`amrpic check` on what a run wrote: a changed bit, a lost end or a lost part of any file is found and named."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mpi_batch
import whole_run
from amrpic.errors import InputError
from amrpic.io import integrity, time_series

PROGRAM = str(Path(sys.executable).with_name("amrpic"))
KINDS = {  # a file of each kind, and what is checked for it
    "fields_00000002.vtkhdf": "",
    "fields.vtkhdf.series": "",
    "openpmd/openpmd_00000004.h5": "",
    "particles_00000004.h5": "",
    "losses.h5": "",
    "screen_end.h5": "",
    "checkpoint_00000004/state.h5": "checkpoint_00000004",
    "series.csv": "",
    "series.json": "series.csv",
    "residuals.csv": "",
    "beam.csv": "",
    "slices.csv": "",
    "losses.csv": "",
    "fields_00000004_E_z.png": "",
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a run that wrote one of everything."""
    from mpi4py import MPI

    folder = tmp_path_factory.mktemp("whole") / "run"
    whole_run.run(MPI.COMM_SELF, folder)
    return folder


def test_what_a_run_wrote_is_whole_and_nothing_is_left_out(whole):
    files = [path for path in whole.rglob("*") if path.is_file() and path.name[0] != "." and path.name != "status.json"]
    described = [path for path in files if path.with_suffix(".csv").exists() and path.suffix == ".json"]
    assert integrity.require_whole(whole) == len(files) - len(described)
    for name, owner in KINDS.items():
        assert integrity.require_whole(whole / (owner or name)) == 1
    assert {path.suffix for path in files} == {Path(name).suffix for name in KINDS}


@pytest.mark.parametrize("name", KINDS)
def test_any_changed_bit_and_any_lost_end_is_found(whole, name):
    path, checked = whole / name, whole / (KINDS[name] or name)
    data = path.read_bytes()
    random = np.random.default_rng(len(data))
    places = random.integers(len(data), size=60)
    try:
        for place in [0, len(data) - 1, *places.tolist()]:
            changed = bytearray(data)
            changed[place] ^= 1 << int(random.integers(8))
            path.write_bytes(changed)
            if name == "fields.vtkhdf.series" and not _names_change(bytes(changed), data):
                continue  # a time: any number may be right
            require_refusal(checked, path.name, f"byte {place} of {len(data)}")
        for length in [0, 1, len(data) // 2, len(data) - 1, *random.integers(len(data), size=5).tolist()]:
            if length == len(data) - 1 and name.endswith((".series", ".json")):
                continue  # the last line end, which JSON does without
            path.write_bytes(data[:length])
            require_refusal(checked, path.name, f"{length} of {len(data)} bytes")
        path.unlink()
        with pytest.raises(InputError):
            integrity.require_whole(checked)
    finally:
        path.write_bytes(data)
    assert integrity.require_whole(checked) == 1


def _names_change(changed: bytes, data: bytes) -> bool:
    """Whether the names in a list of times are others than before."""
    import json

    try:
        return [one["name"] for one in json.loads(changed)["files"]] != [
            one["name"] for one in json.loads(data)["files"]
        ]
    except (ValueError, KeyError, TypeError):
        return True


def require_refusal(path: Path, name: str, what: str) -> None:
    """Require that a check raises one sentence that names a file, or the folder it is in."""
    with pytest.raises(InputError) as refused:
        integrity.require_whole(path)
        pytest.fail(f"{name} with another {what} passed for whole")
    text = str(refused.value)
    assert "\n" not in text and "; " in text, text
    assert name in text or path.name in text, text


def test_a_folder_is_checked_whole_and_each_damage_is_a_line(whole, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(whole, run)
    (run / "fields_00000002.vtkhdf").unlink()
    with (run / "beam.csv").open("r+b") as file:
        file.truncate((whole / "beam.csv").stat().st_size - 5)
    with pytest.raises(InputError) as refused:
        integrity.require_whole(run)
    lines = sorted(Path(line.split(" is damaged")[0].split()[-1]).name for line in str(refused.value).splitlines())
    assert lines == ["beam.csv", "fields.vtkhdf.series", "openpmd_00000002.h5"]


@pytest.mark.mpi(ranks=(2,))
def test_lost_and_damaged_parts_are_found(comm, tmp_path):
    whole_run.run(comm, tmp_path, writers=0, write=["fields", "particles", "losses", "checkpoint"])
    if comm.rank > 0:
        return
    assert integrity.require_whole(tmp_path) > 0
    for name in ("fields_00000004.part0001", "particles_00000004.part0000", "checkpoint_00000004/state.part0001"):
        path = tmp_path / name
        data = path.read_bytes()
        path.unlink()
        with pytest.raises(InputError, match=path.name):
            integrity.require_whole(tmp_path)
        path.write_bytes(data[: len(data) // 2] + b"!" + data[len(data) // 2 + 1 :])
        with pytest.raises(InputError, match=path.name):
            integrity.require_whole(tmp_path)
        path.write_bytes(data)
    assert integrity.require_whole(tmp_path) > 0


def test_rows_after_the_last_checksum_count_if_they_are_whole(whole, tmp_path):
    path = tmp_path / "series.csv"
    for name in ("series.csv", "series.json"):
        shutil.copy(whole / name, tmp_path / name)
    last = path.read_bytes().split(b"\n")[-2]
    with path.open("ab") as file:  # as a run that is killed between the row and its checksum
        file.write(last + b"\n")
    time_series.require_whole(path)
    with path.open("ab") as file:
        file.write(last[:10])
    with pytest.raises(InputError, match="its last line is incomplete"):
        time_series.require_whole(path)


@pytest.mark.parametrize("ranks", [1, 2])
def test_the_command_says_it_once(whole, tmp_path, ranks):
    def check(path: Path) -> subprocess.CompletedProcess[str]:
        command = ["mpiexec", "-n", str(ranks), PROGRAM, "check", str(path)]
        return subprocess.run(command, env=mpi_batch.ENVIRONMENT, capture_output=True, text=True, timeout=60)

    end = check(whole)
    assert (end.returncode, end.stderr) == (0, "")
    assert end.stdout.count("is whole") == 1
    (tmp_path / "losses.h5").write_bytes((whole / "losses.h5").read_bytes()[:-1])
    end = check(tmp_path)
    assert (end.returncode, end.stdout) == (2, "")
    assert end.stderr.count("losses.h5 is damaged") == 1
    scene = tmp_path / "small.toml"
    scene.write_text("[domain]\nlower = 0\nupper = 1\ncells = 8\n")
    end = check(scene)
    assert end.returncode == 0 and end.stdout.count("8x8x8 cells") == 1
