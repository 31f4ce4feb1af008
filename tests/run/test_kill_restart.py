"""Runs that are killed or stopped go on from the newest checkpoint that is whole, and end as if nothing had happened.

An ordinary run of the tests kills leapfrog three times and stops two ranks in three ways; the long form (`pytest -m long`)
kills runs of all kinds ten times, and stops in all ways.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import pty
import random
import shutil
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from amrpic.io import checkpoint, checkpoint_folder, time_series
from amrpic.io.checkpoint import Snapshot
from amrpic.io.run_status import RunStatus
from mpi_batch import ENVIRONMENT, PATIENCE

LAST = 12
TIMEOUT = 120.0 * PATIENCE
SCENE = """
[domain]
lower = "-20 mm"
upper = "20 mm"
cells = 16
boundary = "open"

[[bunches]]
distribution = "gaussian"
species = "electron"
sigma = "2 mm"
charge = "-20 pC"
particles = 4000

[refinement]
levels = 2
max_grid_size = 8
blocking_factor = 4
regrid_every = 3

[schedule]
steps = {last}

[diagnostics]
every = 2
slices = 3

[output]
write = ["checkpoint", "fields", "series"]
checkpoint_every = 1
fields_every = 4
writers = 0

[motion]
{motion}
"""
PRESS = """
method = "mpm"

[domain]
lower = 0
upper = ["2.4 mm", "2 mm", "3 mm"]
cells = [4, 3, 5]
degree = 1

[faces]
x = "slip"
y = "slip"
z = ["slip", {{ press = 0.02 }}]

[structure]
kind = "voronoi"
grains = 12
grain = "grain"
binder = "binder"

[materials.grain]
law = "neo-hookean"
young = "4 GPa"
poisson = 0.25
damage = {{ toughness = "60 J/m^2", length = "1.4 mm" }}

[materials.binder]
law = "neo-hookean"
young = "300 MPa"
poisson = 0.25
damage = {{ toughness = "100 J/m^2", length = "1.4 mm" }}

[schedule]
steps = {last}
damage_step = 1

[output]
write = ["checkpoint", "fields", "points", "series"]
checkpoint_every = 1
fields_every = 4
points_every = 4
writers = 0
"""
MOTIONS = {
    "leapfrog": 'kind = "leapfrog"\ndt = "0.2 ns"',
    "random-walk": 'kind = "random-walk"\namplitude = "1 mm"',
    "leapfrog amid births": """kind = "leapfrog"
dt = "0.2 ns"

[[sources]]
process = "given"
plane = { centre = [0, 0, "-8 mm"] }
spot = { shape = "gaussian", sigma = ["1 mm", "2 mm"] }
pulse = { shape = "gaussian", sigma = "0.6 ns", cutoff = 2 }
charge = "-5 pC"
particles = 3000
momenta = { kind = "beam", energy = "1 keV" }""",
    "leapfrog beside walls that emit": """kind = "leapfrog"
dt = "0.2 ns"

[[electrodes]]
name = "knob"
voltage = "-300 V"
shape = { kind = "sphere", centre = ["2 mm", "-1 mm", "9 mm"], radius = "6 mm" }

[[sources]]
process = "space-charge-limited"
electrode = "knob"
per_face = 1
momenta = { kind = "thermal", energy = "0.1 eV" }

[[sources]]
process = "space-charge-limited"
face = "z_lower"
spot = { shape = "disc", radius = "9 mm" }
species = "positron"
momenta = { kind = "thermal", energy = "0.1 eV" }""",
    "leapfrog by Kokkos": 'kind = "leapfrog"\ndt = "0.2 ns"\n\n[solver]\nbackend = "kokkos"',
}


def command(ranks: int, folder: Path) -> list[str]:
    """What runs the scene beside a folder into it."""
    program = str(Path(sys.executable).with_name("amrpic"))
    scene = str(folder.parent / "scene.toml")
    return ["mpiexec", "-n", str(ranks), program, "run", scene, "--output", str(folder), "--restart", "auto"]


@contextlib.contextmanager
def running(ranks: int, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A run that has begun, and is over afterwards whatever happens."""
    with (folder.parent / "log").open("ab") as log:
        process = subprocess.Popen(command(ranks, folder), env=ENVIRONMENT, stdout=log, stderr=log)
    try:
        yield process
    finally:
        if process.poll() is None:
            kill(process)


def kill(process: subprocess.Popen[bytes], how: signal.Signals = signal.SIGKILL) -> None:
    """Kill all ranks of a run at once, as a lost node does, and mpiexec after them; or let them write a checkpoint first."""
    ours = [process.pid] if how == signal.SIGKILL else []
    for pid in [*children(process.pid), *ours]:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, how)
    process.wait(TIMEOUT)


def children(parent: int) -> list[int]:
    """Ids of the processes that a process has started and that still live."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(stat.read_text().rpartition(")")[2].split()[1]) == parent:
                found.append(int(stat.parent.name))
    return found


def finish(ranks: int, folder: Path) -> None:
    """Let a run go on to its end."""
    with running(ranks, folder) as process:
        status = process.wait(TIMEOUT)
    assert status == 0, (folder.parent / "log").read_text()


def killed_when(moment: Callable[[], bool], ranks: int, folder: Path, how: signal.Signals = signal.SIGKILL) -> bool:
    """Begin a run and kill it at a moment; return whether it came before the end of the run."""
    deadline = time.monotonic() + TIMEOUT
    with running(ranks, folder) as process:
        while not moment():
            if process.poll() is not None:
                return False
            assert time.monotonic() < deadline
        kill(process, how)
    return True


def steps_recorded(folder: Path) -> int:
    """Rows of a run's time series so far."""
    with contextlib.suppress(FileNotFoundError):
        return sum(line[:1].isdigit() for line in (folder / "series.csv").read_text().splitlines())
    return 0


def after_steps(folder: Path, steps: int, seconds: float) -> Callable[[], bool]:
    """The moment so many seconds after so many more steps were recorded: progress, for clocks run unevenly under load."""
    goal, end = steps_recorded(folder) + steps, math.inf

    def come() -> bool:
        nonlocal end
        time.sleep(0.001)
        if end == math.inf and steps_recorded(folder) >= goal:
            end = time.monotonic() + seconds
        return time.monotonic() >= end

    return come


def while_writing(folder: Path, which: int) -> Callable[[], bool]:
    """A moment at which a checkpoint is being written: that of the `which`-th one since the run began."""
    seen: set[str] = set()

    def come() -> bool:
        with contextlib.suppress(FileNotFoundError):
            seen.update(name for name in os.listdir(folder) if name.startswith("checkpoint_") and name.endswith(".tmp"))
        time.sleep(1e-4)  # a checkpoint takes some milliseconds; the ranks need the processor
        return len(seen) >= which

    return come


def last_state(folder: Path, last: int) -> Snapshot:
    """The state at the end of a run, of all ranks."""
    from mpi4py import MPI

    path = checkpoint_folder.path_of(folder, last)
    return checkpoint.read(MPI.COMM_SELF, path, owners=lambda header: [0 * owners for owners in header.owners])


def arrays(state: Snapshot) -> dict[str, np.ndarray]:
    tables = {f"{t}/{c}": values for t, columns in state.tables.items() for c, values in columns.items()}
    return tables | {f"{name}/{l}": v for name, levels in state.fields.items() for l, v in enumerate(levels)}


def rows(folder: Path) -> dict[str, np.ndarray]:
    """The time series, the residuals and the tables of the beam, without what depends on the machine's mood."""
    columns: dict[str, np.ndarray] = {}
    for file in ("series.csv", "residuals.csv", "beam.csv", "slices.csv"):
        if not (folder / file).exists():
            continue
        table = time_series.read(folder / file)
        columns |= {f"{file}/{name}": table[name] for name in table.dtype.names or ()}
    return {name: c for name, c in columns.items() if not name.startswith(("series.csv/seconds", "series.csv/memory"))}


def files(folder: Path) -> set[str]:
    """What a run left, but for checkpoints on the way."""
    hidden = ".", "earlier_", "checkpoint_"
    return {path.name for path in folder.iterdir() if not path.name.startswith(hidden) or path.name.endswith(".tmp")}


def assert_same(folder: Path, reference: Path, last: int = LAST) -> None:
    """Two runs left the same, bit by bit."""
    found, expected = arrays(last_state(folder, last)), arrays(last_state(reference, last))
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)
    for name, values in rows(reference).items():
        np.testing.assert_array_equal(rows(folder)[name], values, err_msg=name)
    assert files(folder) == files(reference)  # and nothing half written


@pytest.fixture(
    scope="module",
    params=[
        "leapfrog",
        *(pytest.param(kind, marks=pytest.mark.long) for kind in (*list(MOTIONS)[1:], "material points")),
    ],
)
def undisturbed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run on two ranks that nobody disturbed."""
    folder = tmp_path_factory.mktemp(request.param.replace(" ", "_"))
    motion = MOTIONS.get(request.param)
    text = PRESS.format(last=LAST) if motion is None else SCENE.format(last=LAST, motion=motion)
    if "walls" in request.param:
        text = text.replace('"open"', '"dirichlet"').replace("levels = 2", "levels = 1")
    (folder / "scene.toml").write_text(text)
    finish(2, folder / "undisturbed")
    return folder / "undisturbed"


def test_killed_at_random_moments_it_ends_bit_by_bit_as_undisturbed(undisturbed, long):
    reference = undisturbed
    emits = "births" in reference.parent.name or "emit" in reference.parent.name
    wanted = 3 if not long else 20 if emits else 10
    folder = reference.parent / "killed"
    random.seed(wanted)
    kills = 0
    while kills < wanted:
        often = random.randint(1, 4)
        writing = kills % 2 == 1
        moment = while_writing(folder, often) if writing else after_steps(folder, often, random.uniform(0, 0.2))
        how = random.choice([signal.SIGKILL, signal.SIGTERM]) if long else signal.SIGKILL
        if killed_when(moment, 2, folder, how):
            kills += 1
        else:  # it came to its end before; the next kill needs a run to disturb
            assert_same(folder, reference)
            shutil.rmtree(folder)
    finish(2, folder)
    assert_same(folder, reference)


@pytest.mark.parametrize("ranks", [1, 3])
@pytest.mark.parametrize("undisturbed", ["leapfrog"], indirect=True)  # whose particles depend on the field
def test_killed_it_ends_the_same_on_another_number_of_ranks(undisturbed, ranks):
    reference = undisturbed
    folder = reference.parent / f"killed{ranks}"
    assert killed_when(while_writing(folder, LAST // 2), 2, folder)
    finish(ranks, folder)
    found, expected = last_state(folder, LAST), last_state(reference, LAST)
    for left, right in zip(found.header.boxes, expected.header.boxes, strict=True):
        np.testing.assert_array_equal(left, right)
    for name in ("phi", "rho"):
        scale = max(np.abs(values).max() for values in expected.fields[name])
        for left, right in zip(found.fields[name], expected.fields[name], strict=True):
            np.testing.assert_allclose(left, right, rtol=0, atol=1e-8 * scale, err_msg=name)
    order, expected_order = (np.argsort(s.tables["particles"]["id"]) for s in (found, expected))
    for column in ("id", "position", "momentum", "weight"):
        left, right = (s.tables["particles"][column] for s in (found, expected))
        np.testing.assert_allclose(left[order], right[expected_order], rtol=0, atol=1e-8 * np.abs(right).max(initial=0))


STEPS = 300  # of runs that are stopped in all ways: a signal takes its time under mpiexec, a step some milliseconds


def press(process: subprocess.Popen[bytes], folder: Path, how: str) -> None:
    """Ask a run to stop, by a signal or a file."""
    if how == "STOP":
        (folder / "STOP").touch()
    else:
        process.send_signal(signal.Signals[how])


def stopped(line: list[str], folder: Path, how: str) -> int:
    """Start a run, stop it after two more steps (in the walltime given: as soon as may be), and return its exit status."""
    if how == "walltime":
        return subprocess.run(
            [*line, "--walltime", "0.1"], env=ENVIRONMENT, timeout=TIMEOUT, capture_output=True
        ).returncode
    come = after_steps(folder, 2, 0.0)
    patient = how in ("SIGINT", "SIGTERM")
    process = subprocess.Popen(
        line,
        env=PATIENT if patient else ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        preexec_fn=listen,
    )
    try:
        while not come():
            assert process.poll() is None, process.communicate()[1].decode()
        press(process, folder, how)
        process.communicate(timeout=TIMEOUT)
    finally:
        if process.poll() is None:
            kill(process)
    return process.returncode


def listen() -> None:
    """Hear Ctrl-C, also where tests run in the background."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


# mpiexec waits twice as long after each failing end
PATIENT = ENVIRONMENT | {"OMPI_MCA_odls_base_sigkill_timeout": "12"}
# 1 is what mpiexec makes of its own signals
WAYS = {
    1: {"SIGUSR1": 75, "SIGINT": 75, "STOP": 75, "walltime": 75, "SIGTERM": 75, "SIGHUP": 75},
    2: {"SIGUSR1": 75, "SIGINT": 1, "STOP": 75, "walltime": 75, "SIGTERM": 1},
}
IN_SHORT = ("SIGTERM", "STOP", "walltime")  # Ctrl-C and USR1: in a terminal, below


def test_stopped_in_every_way_and_resumed_each_time_it_ends_bit_by_bit_as_undisturbed(tmp_path, long):
    stop_and_resume(tmp_path, 2, list(WAYS[2]) if long else IN_SHORT)


@pytest.mark.long
def test_stopped_in_every_way_on_one_rank_it_ends_bit_by_bit_as_undisturbed(tmp_path):
    stop_and_resume(tmp_path, 1, list(WAYS[1]))


def stop_and_resume(tmp_path: Path, ranks: int, ways: Sequence[str]) -> None:
    """Each stop leaves a checkpoint; the resumed runs, three to six, make one series without gap or repetition."""
    text = SCENE.format(last=STEPS, motion=MOTIONS["leapfrog"].replace("0.2", "0.01"))  # the bunch stays inside
    for ours, here in ("checkpoint_every = 1", "checkpoint_every = 25"), ("fields_every = 4", "fields_every = 150"):
        text = text.replace(ours, here)
    text = text.replace("levels = 2", "levels = 1").replace("particles = 4000", "particles = 1000")
    (tmp_path / "scene.toml").write_text(text)
    finish(ranks, tmp_path / "undisturbed")
    folder = tmp_path / "stopped"
    line = command(ranks, folder) if ranks > 1 else command(ranks, folder)[3:]
    at = []
    for how in ways:
        assert stopped(line, folder, how) == WAYS[ranks][how], how
        status = RunStatus.read(folder)
        why = {"STOP": "the file", "walltime": "the time given"}.get(how, "signal")
        assert status.state == "stopped" and status.why.startswith(why), (how, status.why)
        assert checkpoint_folder.path_of(folder, status.step).is_dir()
        assert time_series.read(folder / "series.csv")["step"].tolist() == list(range(status.step + 1))
        at.append(status.step)
    assert at == sorted(at) and at[0] > 0 and at[-1] < STEPS
    finish(ranks, folder)
    assert_same(folder, tmp_path / "undisturbed", STEPS)


ROOT = Path(__file__).parents[2]


def test_ctrl_c_at_make_run_in_a_terminal_leaves_a_checkpoint(tmp_path):
    """The terminal interrupts make and its shell, which sends the ranks USR1 and waits for them."""
    folder, scene = tmp_path / "out", tmp_path / "scene.toml"
    text = SCENE.format(last=STEPS, motion=MOTIONS["leapfrog"].replace("0.2", "0.01"))
    scene.write_text(
        text.replace("[output]", f'[output]\ndirectory = "{folder}"').replace("_every = 1\n", "_every = 25\n")
    )
    line = ["make", "-o", "setup", "run", f"BIN={Path(sys.executable).parent}", "RANKS=2", f"SCENE={scene}"]
    ours, theirs = pty.openpty()

    def in_a_terminal() -> None:
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        listen()

    come = after_steps(folder, 2, 0.0)
    make = subprocess.Popen(
        line,
        cwd=ROOT,
        env=ENVIRONMENT,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
        preexec_fn=in_a_terminal,
    )
    os.close(theirs)
    printed: list[bytes] = []
    reader = threading.Thread(target=lambda: printed.extend(iter(lambda: read(ours), b"")))
    reader.start()
    try:
        while not come():
            assert make.poll() is None, b"".join(printed).decode()
        os.write(ours, b"\x03")
        make.wait(TIMEOUT)
    finally:
        if make.poll() is None:
            kill(make)
        reader.join(TIMEOUT)
        os.close(ours)
    status = RunStatus.read(folder)
    assert (status.state, status.why) == ("stopped", "signal SIGUSR1"), b"".join(printed).decode()
    assert make.returncode == -signal.SIGINT  # make waits for its shell, and then ends as Ctrl-C asks
    assert f"stopped at step {status.step}: signal SIGUSR1; go on with --restart auto" in b"".join(printed).decode()
    assert time_series.read(folder / "series.csv")["step"].tolist() == list(range(status.step + 1))
    assert 0 < status.step < STEPS and checkpoint_folder.path_of(folder, status.step).is_dir()


def read(terminal: int) -> bytes:
    """What a terminal shows next, nothing when all that wrote to it have ended."""
    try:
        return os.read(terminal, 4096)
    except OSError:  # Linux's word for that
        return b""


JOBS = {"slurm": ["job.sh", "scene.toml"], "pbs": ["job.sh"]}


@pytest.mark.parametrize("system", JOBS)
def test_job_scripts_submit_themselves_until_the_run_is_finished(tmp_path, system):
    """Beside commands that stand for those of the batch system: the first job has no time, the second enough."""
    text = SCENE.format(last=2, motion=MOTIONS["leapfrog"]).replace("[output]", '[output]\ndirectory = "out"')
    (tmp_path / "scene.toml").write_text(text)
    tools = tmp_path / "bin"
    tools.mkdir()
    submits = f'#!/bin/bash\necho "$@" >> {tmp_path}/submitted\n'
    runs = '#!/bin/bash\nexec "${@//03:50:00/$TIME}" ${MORE:-}\n'
    for name, content in {"srun": runs, "mpiexec": runs, "sbatch": submits, "qsub": submits}.items():
        (tools / name).write_text(content)
        (tools / name).chmod(0o755)
    script = ROOT / "examples" / system / "job.sh"
    path = f"{tools}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    common = ENVIRONMENT | {"PATH": path, "SCENE": "scene.toml", "PBS_O_WORKDIR": str(tmp_path)}
    for time_given, more, code in (("1", "--walltime 1", 75), ("03:50:00", "", 0)):
        environment = common | {"TIME": time_given, "MORE": more if system == "slurm" else ""}
        job = ["bash", str(script), *JOBS[system][1:]]
        done = subprocess.run(job, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=TIMEOUT)
        assert done.returncode == code, done.stderr
        submitted = (tmp_path / "submitted").read_text().splitlines()
        wanted = [str(script), "scene.toml"] if system == "slurm" else ["-v", "SCENE=scene.toml", str(script)]
        assert submitted == [" ".join(wanted)]  # once, by the first
    assert RunStatus.read(tmp_path / "out").state == "finished"
