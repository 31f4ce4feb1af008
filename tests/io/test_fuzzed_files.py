"""Mutated scenes, openPMD files, dumps and checkpoints: each is read, or refused in words; nothing crashes or hangs.

Files are opened as the package opens them, in a child process first. An ordinary run takes 400 mutations, always the same; the
long form (`pytest -m long`) 10,000 fresh ones, whose seed is in the message of a failure.
"""

from __future__ import annotations

import os
import resource
import shutil
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import bad_inputs
import whole_run
from amrpic.errors import AmrpicError, InputError
from amrpic.io import checkpoint, integrity, openpmd_reader, vetting, vetting_child
from amrpic.io.field_reader import open_dump
from amrpic.pic.limits import check_scene
from amrpic.results.run_results import Results
from amrpic.scene.scene import Scene
from mpi_batch import PATIENCE
from mutations import damaged, mistaken

COUNTS = {"scene": 3000, "openpmd": 3000, "dump": 2000, "checkpoint": 2000}
MEMORY = 8 * 2**30  # bytes of address space more than there is: what asks for more is not to get it


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a run that wrote one of everything."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    whole_run.run(MPI.COMM_SELF, folder)
    return folder


@pytest.fixture(autouse=True)
def bounded():
    """Bound the memory that a damaged file can make this process take."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def read_scene(path: Path) -> None:
    check_scene(Scene.from_toml(path), 1)


def read_particles(path: Path) -> None:
    for group in openpmd_reader.groups(path):
        openpmd_reader.read(path, lambda count: (0, count), group=group or None)
    openpmd_reader.when(path)


def read_dump(path: Path) -> None:
    fields = Results.open(MPI.COMM_SELF, path).fields
    for of_step in fields.values():
        for name in of_step:
            of_step[name]
    open_dump(path).close()


def read_checkpoint(path: Path) -> None:
    checkpoint.read(MPI.COMM_SELF, path)


def try_reading(read: Callable[[Path], object], path: Path, name: str) -> bool:
    """Whether a file was read; if it was not, the reason must be one sentence."""
    started = time.process_time()
    try:
        with warnings.catch_warnings(action="error", category=RuntimeWarning):
            read(path)
        return True
    except AmrpicError as refused:
        text = str(refused)
        assert "\n" not in text and text and "Error:" not in text, f"{name}: {text}"
        return False
    except Exception as error:
        pytest.fail(f"{name}: {type(error).__name__}: {error}")
    finally:
        assert time.process_time() - started < 40 * PATIENCE, f"{name} took {time.process_time() - started:.0f} s"


@pytest.mark.parametrize("kind", COUNTS)
def test_mutated_files_are_read_or_refused(whole, tmp_path, kind, long):
    count = COUNTS[kind] if long else COUNTS[kind] // 25
    seed = int.from_bytes(os.urandom(4)) if long else 1
    name, read = {
        "scene": ("", read_scene),
        "openpmd": ("particles_00000004.h5", read_particles),
        "dump": ("fields_00000004.vtkhdf", read_dump),
        "checkpoint": ("checkpoint_00000004", read_checkpoint),
    }[kind]
    source = whole / name
    read_count = 0
    for number in range(count):
        random = np.random.default_rng([seed, number])
        path = tmp_path / source.with_stem(f"{source.stem}_{number}").name
        if kind == "scene":
            path = tmp_path / f"scene_{number}.toml"
            path.write_bytes(mistaken(bad_inputs.SCENE.encode(), random))
        elif kind == "checkpoint":
            shutil.copytree(source, path)
            part = path / "state.h5"
            part.write_bytes(damaged(part.read_bytes(), random))
        else:
            path.write_bytes(damaged(source.read_bytes(), random))
        what = f"mutation {number} of {kind}, seed {seed}"
        read_count += try_reading(read, path, what)
        if kind != "scene":
            try_reading(integrity.require_whole, path, what)
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert 0 < read_count < count  # some do no harm, some do


CRASHING = """
import os, signal, sys, time
for line in sys.stdin:
    if "/crash.h5" in line:
        os.kill(os.getpid(), signal.SIGSEGV)
    if "/hang.h5" in line:
        time.sleep(60)
    print("fine", flush=True)
"""


@pytest.mark.parametrize(
    "name, words",
    [("crash.h5", r"it is damaged, and HDF5 crashes on it \(SIGSEGV\)"), ("hang.h5", "not come to an end")],
)
def test_a_crash_of_the_first_reader_is_one_sentence(tmp_path, monkeypatch, name, words):
    (tmp_path / "child.py").write_text(CRASHING)
    monkeypatch.setattr(vetting_child, "__file__", str(tmp_path / "child.py"))
    monkeypatch.setattr(vetting, "PATIENCE", 1.0)
    monkeypatch.setattr(vetting, "STALLED", 1)
    vetting._end()
    bad_inputs.beam(tmp_path / name)
    bad_inputs.beam(tmp_path / "good.h5")
    for _ in range(2):
        with pytest.raises(InputError, match=rf"{name} cannot be read: .*{words}.*; replace it by a whole copy"):
            read_particles(tmp_path / name)
        read_particles(tmp_path / "good.h5")
    vetting._end()


LOOPING = """
from importlib.util import module_from_spec, spec_from_file_location

spec = spec_from_file_location("child", {path!r})
child = module_from_spec(spec)
spec.loader.exec_module(child)
true_read = child._read

def read(path):
    while path.endswith("loop.h5"):
        pass
    return true_read(path)

child._read = read
child.main()
"""


def test_a_file_may_take_so_many_seconds_of_the_processor(tmp_path, monkeypatch):
    """Those of the wall are not counted: the machine may stand still meanwhile."""
    (tmp_path / "child.py").write_text(LOOPING.format(path=vetting_child.__file__))
    monkeypatch.setattr(vetting_child, "__file__", str(tmp_path / "child.py"))
    monkeypatch.setattr(vetting, "PATIENCE", 0.5)
    monkeypatch.setattr(vetting, "STALLED", 600)
    vetting._end()
    for name in ("loop.h5", "good.h5"):
        bad_inputs.beam(tmp_path / name)
    with pytest.raises(
        InputError, match=r"loop.h5 cannot be read: HDF5 does not come to an end with it in 1 s; replace it"
    ):
        read_particles(tmp_path / "loop.h5")
    read_particles(tmp_path / "good.h5")
    vetting._end()


def test_a_damaged_table_of_a_dumps_groups_is_one_sentence(whole, monkeypatch):
    """HDF5 finds it where it looks whether the dump has parts, as mutation 663 of seed 651422799 did."""

    def look(h5, folder):
        raise RuntimeError("Unable to check link existence (bad symbol table node signature)")

    monkeypatch.setattr("amrpic.io.shared_file.require_parts", look)
    with pytest.raises(InputError, match=r"cannot be read: Unable to check link existence .*; give a fields_"):
        open_dump(whole / "fields_00000004.vtkhdf")


def test_a_dataset_far_larger_than_its_file_is_refused(tmp_path):
    _, write = bad_inputs.BEAMS["openpmd: a shape too large"]
    write(tmp_path / "large.h5")
    with pytest.raises(InputError, match="is far larger than the file"):
        read_particles(tmp_path / "large.h5")
