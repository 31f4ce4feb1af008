"""Bad input: one sentence, printed once, the same on all ranks, a failing exit status, no hang, and nothing written lost.

What is legal although it looks odd runs to its end, with one warning.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import mpi_batch
from refusals import ended, refusal

SCENE = """
[domain]
lower = -0.1
upper = 0.1
cells = 16
boundary = "dirichlet"

[[bunches]]
distribution = "gaussian"
sigma = "10 mm"
charge = "10 pC"
particles = 500

[motion]
kind = "random-walk"
amplitude = "1 mm"

[schedule]
steps = 1

[output]
write = ["checkpoint"]
"""


def scene_file(folder: Path) -> str:
    """A small scene that can run, in a file of its own."""
    path = folder / "small.toml"
    path.write_text(SCENE)
    return str(path)


RULE = "refinement.rule={kind='charge-density',relative=1e-3}"

REFUSED_SCENES = {
    "unknown key": (["refinement.levles=1"], ["refinement.levles", 'did you mean "levels"']),
    "wrong unit": (["bunches.0.sigma=2.5 pC"], ["bunches.0.sigma", "pC", "mm"]),
    "bunch outside": (["bunches.0.centre=[1,0,0]"], ["bunches.0.centre", "outside the domain"]),
    "negative size": (["bunches.0.sigma=[1e-3,-1e-3,1e-3]"], ["bunches.0.sigma.1", "-0.001", "negative"]),
    "zero charge": (["bunches.0.charge=0"], ["bunches.0.charge", "zero"]),
    "a single cell": (["domain.cells=[16,1,16]"], ["domain.cells along y is 1", "at least 2"]),
    "too many for 32 bits": (["domain.cells=2048"], ["domain.cells", "2147483647", "at least"]),
    "too many for 64 bits": (["domain.cells=4194304"], ["domain.cells", "9223372036854775807"]),
    "too much memory": (["domain.cells=1536"], ["domain.cells", "GiB of memory", "GiB are free"]),
    "unbalanced charge": (["domain.boundary=periodic"], ["background", "1e-11 C", "neutralizing"]),
    "unbalanced charge, neumann": (["domain.boundary=neumann"], ["background", "1e-11 C", "neutralizing"]),
    "two mistakes": (["solver.tolerance=0", "seed=-1"], ["1 more"]),
    "override of nothing": (["bunches.4.sigma=1"], ["--set bunches.4.sigma"]),
}


@pytest.mark.mpi(ranks=2)
@pytest.mark.parametrize("name", REFUSED_SCENES)
def test_scene_is_refused(comm, tmp_path, name):
    overrides, words = REFUSED_SCENES[name]
    flags = [flag for override in overrides for flag in ("--set", override)]
    text = refusal(comm, "run", scene_file(tmp_path), *flags, "--output", str(tmp_path / "out"))
    for word in words:
        assert word in text
    assert {path.name for path in tmp_path.glob("out/*")} <= {"status.json"}  # which says that and why it failed


@pytest.mark.mpi(ranks=2)
@pytest.mark.parametrize(
    "given", [("rnu",), ("run",), ("run", "x", "--setup", "a=1"), ("run", "x", "--walltime", "soon")]
)
def test_command_line_is_refused(comm, tmp_path, given):
    arguments = [scene_file(tmp_path) if argument == "x" else argument for argument in given]
    text = refusal(comm, *arguments)
    assert "--help" in text or "90 min" in text


@pytest.mark.mpi(ranks=2)
def test_missing_files(comm, tmp_path):
    assert "nowhere.toml" in refusal(comm, "run", str(tmp_path / "nowhere.toml"))
    scene = scene_file(tmp_path)
    out = ["--output", str(tmp_path / "out")]
    assert "nowhere" in refusal(comm, "run", scene, *out, "--restart", str(tmp_path / "nowhere"))
    bunch = "bunches=[{distribution='arrays',file='nowhere.npz',charge=1e-12}]"
    assert "nowhere.npz" in refusal(comm, "run", scene, *out, "--set", bunch)


@pytest.mark.mpi(ranks=2)
def test_scene_that_is_not_toml(comm, tmp_path):
    (tmp_path / "broken.toml").write_text("[domain\nlower = 1")
    assert "broken.toml" in refusal(comm, "run", str(tmp_path / "broken.toml"))


@pytest.mark.mpi(ranks=2)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_positions_that_are_not_finite(comm, tmp_path, bad):
    position = np.zeros((6, 3))
    position[4, 1] = bad
    if comm.rank == 0:
        np.savez(tmp_path / "beam.npz", position=position)
    bunch = "bunches=[{distribution='arrays',file='beam.npz',charge=1e-12}]"
    text = refusal(comm, "run", scene_file(tmp_path), "--output", str(tmp_path / "out"), "--set", bunch)
    assert "position of 1 particles" in text and "beam.npz" in text


@pytest.mark.mpi(ranks=2)
def test_all_particles_outside(comm, tmp_path):
    if comm.rank == 0:
        np.savez(tmp_path / "beam.npz", position=np.ones((6, 3)))
    bunch = "bunches=[{distribution='arrays',file='beam.npz',charge=1e-12}]"
    text = refusal(comm, "run", scene_file(tmp_path), "--output", str(tmp_path / "out"), "--set", bunch)
    assert "6 particles" in text and "outside the domain" in text


@pytest.mark.mpi(ranks=2)
def test_foreign_particle_file(comm, tmp_path):
    (tmp_path / "beam.npz").write_text("not an archive")
    bunch = "bunches=[{distribution='arrays',file='beam.npz',charge=1e-12}]"
    text = refusal(comm, "run", scene_file(tmp_path), "--output", str(tmp_path / "out"), "--set", bunch)
    assert "beam.npz" in text and "np.savez" in text


@pytest.mark.mpi(ranks=2)
def test_folder_that_cannot_be_written(comm, tmp_path):
    (tmp_path / "file").write_text("")
    text = refusal(comm, "run", scene_file(tmp_path), "--output", str(tmp_path / "file" / "out"), status=1)
    assert "file/out" in text and "--output" in text


@pytest.mark.mpi(ranks=2)
def test_damaged_and_foreign_checkpoints(comm, tmp_path):
    scene, out = scene_file(tmp_path), tmp_path / "out"
    assert ended(comm, "run", scene, "--output", str(out)) == (0, "")
    good = out / "checkpoint_00000001"

    def attempt(name: str) -> str:
        return refusal(comm, "run", scene, "--output", str(tmp_path / "other"), "--restart", str(tmp_path / name))

    def copy(name: str) -> Path:
        if comm.rank == 0:
            shutil.copytree(good, tmp_path / name)
        comm.Barrier()
        return tmp_path / name

    part = copy("truncated") / "state.h5"
    if comm.rank == 0:
        part.write_bytes(part.read_bytes()[:1000])
    assert "state.h5" in attempt("truncated")
    part = copy("flipped") / "state.h5"
    if comm.rank == 0:
        data = bytearray(part.read_bytes())
        data[len(data) // 2] ^= 1
        part.write_bytes(data)
    assert "state.h5" in attempt("flipped")
    part = copy("foreign") / "state.h5"
    if comm.rank == 0:
        with h5py.File(part, "w") as file:
            file["x"] = [1, 2, 3]
    assert "state.h5" in attempt("foreign")
    state = copy("garbled") / "state.h5"
    state.write_text("something else")
    assert "state.h5" in attempt("garbled")
    (tmp_path / "empty").mkdir(exist_ok=True)
    assert "state.h5" in attempt("empty")
    assert ended(comm, "run", scene, "--output", str(out), "--restart", str(good)) == (
        0,
        "",
    )  # the good one is still good


@pytest.mark.mpi(ranks=2)
def test_checkpoint_of_another_mesh(comm, tmp_path):
    scene, out = scene_file(tmp_path), tmp_path / "out"
    assert ended(comm, "run", scene, "--output", str(out)) == (0, "")
    restart = ["--output", str(out), "--restart", str(out / "checkpoint_00000001")]
    assert "domain.upper is [0.2, 0.2, 0.2] instead of" in refusal(
        comm, "run", scene, *restart, "--set", "domain.upper=0.2"
    )
    for changed in ("refinement.max_grid_size=16", "domain.cells=12"):  # on these it goes on
        assert ended(comm, "run", scene, *restart, "--set", changed) == (0, "")


def test_plot_of_foreign_files(comm, tmp_path):
    (tmp_path / "text.vtkhdf").write_text("not HDF5")
    with h5py.File(tmp_path / "foreign.vtkhdf", "w") as file:
        file["x"] = [1, 2, 3]
    for name in "text.vtkhdf", "foreign.vtkhdf", "missing.vtkhdf":
        assert name in refusal(comm, "plot", str(tmp_path / name))


# ---- one rank alone ----

ALONE = {
    "python": "raise ValueError('this rank has had enough')",
    "native": "amrpic.Hierarchy(MPI.COMM_SELF, simulation.hierarchy.domain, [[((1, 1, 1), (2, 2, 2))]])",
    "own error": "raise amrpic.errors.ParticleError('this rank alone lost its particles; shorten dt')",
}

SCRIPT = """
import amrpic, amrpic.errors
from mpi4py import MPI
from amrpic.commands import main
from amrpic.pic.simulation import Simulation

def fail(simulation):
    if simulation.step == 3 and simulation.comm.rank == 1:
        {failure}

whole_run = Simulation.run

def run_that_fails(simulation, *rest):
    simulation.on_step(fail)
    return whole_run(simulation, *rest)

Simulation.run = run_that_fails
main.main(["run", {scene!r}, "--output", {out!r}, "--set", "schedule.steps=6", "--set", "output.checkpoint_every=2"])
"""


PROGRAM = str(Path(sys.executable).with_name("amrpic"))


def mpiexec(*command: str, ranks: int = 2) -> subprocess.CompletedProcess[str]:
    """What becomes of a command on some ranks."""
    return subprocess.run(
        ["mpiexec", "-n", str(ranks), *command],
        env=mpi_batch.ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=60,
    )


@pytest.mark.parametrize("kind", ALONE)
def test_failure_of_one_rank_ends_all(tmp_path, kind):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(failure=ALONE[kind], scene=scene_file(tmp_path), out=str(tmp_path / "out")))
    end = mpiexec(sys.executable, str(script))
    assert end.returncode != 0
    assert end.stderr.count("amrpic: ") == 1
    assert "(on rank 1 of 2 alone)" in end.stderr
    assert "Traceback" not in end.stderr
    assert (tmp_path / "out" / "checkpoint_00000002" / "state.h5").exists()
    again = mpiexec(PROGRAM, "run", scene_file(tmp_path), "--output", str(tmp_path / "out"), "--restart", "auto")
    assert again.returncode == 0  # what was written before is still of use


def script_with(tmp_path: Path, *lines: str) -> subprocess.CompletedProcess[str]:
    """What becomes on two ranks of a script that makes a hierarchy first."""
    script = tmp_path / "script.py"
    start = (
        "import amrpic",
        "from mpi4py import MPI",
        "rank = MPI.COMM_WORLD.rank",
        "mesh = amrpic.Hierarchy(MPI.COMM_WORLD, amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16)), max_grid_size=8)",
    )
    script.write_text("\n".join([*start, *lines]))
    end = mpiexec(sys.executable, str(script))  # raises if it hangs
    assert end.returncode != 0
    return end


def test_exception_of_one_rank_in_a_script_ends_all(tmp_path):
    end = script_with(tmp_path, "1 / rank", "amrpic.PoissonSolver(mesh)")
    assert "ZeroDivisionError" in end.stderr
    assert end.stderr.count("amrpic: ") == 1
    assert "amrpic: the script ended with ZeroDivisionError (on rank 0 of 2 alone)" in end.stderr


def test_error_of_all_ranks_in_a_script_is_one_sentence(tmp_path):
    end = script_with(tmp_path, "amrpic.PoissonSolver(mesh, tolerance=-1)")
    assert end.stderr.count("amrpic: ") == 1 and "Traceback" not in end.stderr
    assert "tolerance is -1" in end.stderr and "script.py, line 5]" in end.stderr


def test_failure_within_an_exchange_ends_all_even_if_it_is_caught(tmp_path):
    """The other rank waits for a message that will not come."""
    end = script_with(
        tmp_path,
        "def pack(parcel):",
        "    raise ValueError('this rank cannot pack')",
        "comm = mesh.comm.py2f()",
        "try:",
        "    amrpic._native.exchange(comm, [(1 - rank, 3)], [(1 - rank, 3)], pack if rank else lambda n: [1, 2, 3])",
        "except Exception:",
        "    print('caught')",
    )
    assert "caught" not in end.stdout
    assert end.stderr.count("amrpic: ") == 1
    assert "an exchange between ranks failed: this rank cannot pack (on rank 1 of 2 alone)" in end.stderr


def test_message_of_another_length_than_was_planned_ends_all(tmp_path):
    end = script_with(
        tmp_path,
        "comm = mesh.comm.py2f()",
        "amrpic._native.exchange(comm, [(1 - rank, 3)], [(1 - rank, 3 - rank)], lambda n: [1, 2, 3])",
    )
    assert end.stderr.count("amrpic: ") == 1
    assert "amrpic: a message between ranks failed" in end.stderr and "(on rank 1 of 2 alone)" in end.stderr


def test_failure_of_a_callback_ends_all(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from mpi4py import MPI\n"
        "from amrpic import Scene, Simulation\n"
        f"run = Simulation(MPI.COMM_WORLD, Scene.from_toml({scene_file(tmp_path)!r}, ['output.write=[]']))\n"
        "run.on_step(lambda s: 1 / s.comm.rank)\n"
        f"run.scene.output.write or run.run()\n"
    )
    end = mpiexec(sys.executable, str(script))
    assert end.returncode != 0
    assert "ZeroDivisionError" in end.stderr and "rank 0 of 2" in end.stderr


def test_exit_status_reaches_the_shell(tmp_path):
    end = mpiexec(
        PROGRAM, "run", scene_file(tmp_path), "--set", "solver.tolerance=0", "--output", str(tmp_path / "out")
    )
    assert end.returncode == 2
    assert end.stderr.count("amrpic: ") == 1


# ---- legal, and worth a word ----

REFINE = ["refinement.levels=1", "refinement.regrid_every=1"]

ODD = {
    "no bunches": (["bunches=[]"], "zero particles"),
    "zero particles": (["bunches.0.particles=0", *REFINE], "zero particles"),
    "zero size": (["bunches.0.sigma=0", *REFINE], "zero size"),
    "zero size along x": (["bunches.0.sigma=[0,0.01,0.01]"], "zero size"),
    "tags nothing": ([*REFINE, "refinement.rule={kind='charge-density',absolute=1e9}"], "tags no cell"),
    "tags everything": (
        [*REFINE, "refinement.rule={kind='field-strength',absolute=0}", "bunches.0.sigma=0.02"],
        "tags every cell",
    ),
}


@pytest.mark.mpi(ranks=2)
@pytest.mark.parametrize("name", ODD)
def test_legal_oddity_runs_with_one_warning(comm, tmp_path, name):
    overrides, word = ODD[name]
    flags = [flag for override in overrides for flag in ("--set", override)]
    status, text = ended(comm, "run", scene_file(tmp_path), *flags, "--output", str(tmp_path / "out"))
    assert status == 0, text
    assert text.count("\n") == 1 and text.startswith("warning: ")
    assert word in text
    assert (tmp_path / "out" / "checkpoint_00000001" / "state.h5").exists()
