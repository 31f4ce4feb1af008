"""The scaling study: it starts ranks, grows scenes with them, adds to what is there, and finds the efficiency."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import mpi_batch
from amrpic.errors import InputError
from amrpic.run.clock import Spent
from amrpic.scaling.measure import measure, over_ranks
from amrpic.scaling.measured import Measured, MeasuredRun, Stage, by_kind, efficiency, medians
from amrpic.scaling.show import draw, stage_table, table
from amrpic.scaling.study import ROOT, Study, grown, launch
from amrpic.scene.scene import Scene
from scaling_model.calibrate import least_disturbed

SCENE = Path(__file__).parents[2] / "examples" / "sphere.toml"
SMALL = ["domain.cells=16", "refinement.levels=1", "bunches.0.particles=2000", "output.write=['series']"]


def one(kind: str, ranks: int, cells: int, particles: int, seconds: float) -> Measured:
    stages = {"solve": Stage(seconds / 4, seconds / 3, seconds / 2, 12, 3e4, 5), "end": Stage(1, 1, 1)}
    return Measured(
        kind, ranks, cells, particles, 1.0, 1.0, (1e6, 1e6, 1e6), 1, 5, 2, seconds, stages, 0.0, [2], 0.0, cells
    )


def run(seconds: list[float], kind: str = "strong", ranks: int = 1) -> MeasuredRun:
    steps = [{"solve": Stage(s / 4, s / 3, s / 2)} for s in seconds]
    cycles, cells, meshes = ([number] * len(seconds) for number in (2, 10, 0))
    return MeasuredRun(kind, ranks, "x", cells, 10, 1.0, 1.0, (1, 2, 3), cycles, seconds, steps, meshes, 0.1)


def test_efficiency_is_one_where_time_falls_with_ranks_or_work_grows_with_them():
    first = one("strong", 1, 1000, 500, 4.0)
    assert efficiency(first, one("strong", 4, 1000, 500, 1.0)) == pytest.approx(1)
    assert efficiency(first, one("strong", 4, 1000, 500, 2.0), "solve") == pytest.approx(0.5)
    assert efficiency(first, one("weak", 4, 4000, 2000, 4.0)) == pytest.approx(1)
    assert efficiency(first, one("weak", 4, 4000, 2000, 5.0)) == pytest.approx(0.8)


def test_medians_are_over_the_steps_of_all_runs():
    found = medians([run([1.0, 2.0]), run([9.0]), run([4.0], ranks=2)])
    assert [(m.ranks, m.runs, m.steps, m.seconds) for m in found] == [(1, 2, 3, 2.0), (2, 1, 1, 4.0)]
    assert found[0].stages["solve"].most == 1.0


def test_a_scene_grows_by_cells_and_particles():
    scene = Scene.from_toml(SCENE, SMALL)
    assert scene.refinement.blocking_factor == 8
    assert grown(scene, 1) == ["domain.cells=[16, 16, 16]", "bunches.0.particles=2000"]
    larger = Scene.from_toml(SCENE, [*SMALL, *grown(scene, 8)])
    assert list(larger.domain.value.cells) == [32, 32, 32]
    assert [bunch["particles"] for bunch in larger.to_dict()["bunches"]] == [16000]


def test_what_new_meshes_take_more_stands_apart():
    def step(solve: float, migrate: float, **others: float) -> dict[str, Stage]:
        return {name: Stage(s, s, s) for name, s in {"solve": solve, "migrate": migrate, **others}.items()}

    usual, with_two = step(1, 1, waiting=5), step(4, 3, waiting=9, regrid=6)
    given = ([3, 9, 2], [1.0] * 3, [usual, with_two, usual], [0, 2, 0], 0.1)
    found = Measured.of([MeasuredRun("strong", 1, "x", [10, 12, 14], 10, 1.0, 1.0, (1, 2, 3), *given)])
    assert found.stages["solve"].most == 1 and found.stages["new solver"].most == 3
    assert found.stages["new mesh"].most == (2 + 6) / 2  # for each of two
    assert (found.meshes, found.remade) == pytest.approx((2 / 3, 1 / 3)) and found.of_solves == [3, 2]
    assert (found.cells, found.new_cells) == (12, 12)


def test_constants_come_from_the_fastest_run_and_each_stage_from_the_one_in_which_it_was():
    slow, fast = run([4.0, 4.0, 4.0]), run([2.0, 3.0, 2.0])
    slow.steps[:] = [{"solve": Stage(5, 5, 5), "deposit": Stage(1, 1, 1)}] * 3
    fast.steps[:] = [{"solve": Stage(1, 1, 1), "deposit": Stage(2, 2, 2)}] * 3
    (found,) = least_disturbed([slow, fast])
    assert found.seconds == 2.0 and [found.stages[name].most for name in ("solve", "deposit")] == [1, 1]


@pytest.mark.mpi(ranks=(1, 2))
def test_stages_that_begin_together_leave_waiting_apart(comm: MPI.Comm, tmp_path):
    scene = Scene.from_toml(
        SCENE, [*SMALL, f"output.directory={comm.bcast(str(tmp_path))}", "refinement.regrid_every=0"]
    )
    together, apart = (measure(comm, scene, 2, apart=apart) for apart in (False, True))
    assert "waiting" not in together.steps[0] and ("waiting" in apart.steps[0]) == (comm.size > 1)
    for call in ("solve", "deposit", "output"):
        assert apart.steps[1][call].collectives == together.steps[1][call].collectives
    assert apart.meshes == [0, 0]


@pytest.mark.mpi(ranks=(1, 3))
def test_a_stage_holds_the_fastest_and_the_slowest_rank(comm: MPI.Comm):
    stage = over_ranks(comm, {"solve": Spent(1.0 + comm.rank)})["solve"]
    assert (stage.least, stage.mean, stage.most) == (1.0, np.mean(1.0 + np.arange(comm.size)), float(comm.size))


def command(folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    changes = [part for change in SMALL for part in ("--set", change)]
    whole = [
        str(Path(sys.executable).parent / "amrpic"),
        "scaling",
        str(SCENE),
        *changes,
        "--output",
        str(folder / "out"),
    ]
    return subprocess.run(
        [*whole, *more], cwd=folder, env=mpi_batch.ENVIRONMENT, capture_output=True, text=True, check=False
    )


def test_command_measures_both_kinds_and_adds_to_the_study(tmp_path):
    done = command(tmp_path, "--ranks", "1", "2", "--steps", "2")
    assert done.returncode == 0, done.stderr
    again = command(tmp_path, "--ranks", "2", "--steps", "3", "--kind", "strong")
    assert again.returncode == 0, again.stderr
    found = json.loads((tmp_path / "out" / "scaling.json").read_text())
    assert [(m["kind"], m["ranks"], m["particles"], m["steps"]) for m in found] == [
        ("strong", 1, 2000, 2),
        ("strong", 2, 2000, 5),
        ("weak", 1, 2000, 2),
        ("weak", 2, 4000, 2),
    ]
    two = found[1]["stages"]
    assert found[0]["cells"] == found[1]["cells"] and {"solve", "output", "open walls", "end"} <= set(two)
    assert 0 < two["solve"]["least"] <= two["solve"]["mean"] <= two["solve"]["most"] and two["solve"]["messages"] > 0
    assert re.search(r"strong +1 .* 100%", again.stdout)
    assert (tmp_path / "out" / "scaling.png").stat().st_size > 1000
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]  # nothing else is left
    assert all(path.suffix == ".json" for path in (tmp_path / "out" / "scaling").iterdir())
    other = command(tmp_path, "--collect", "--set", "solver.tolerance=1e-3")
    assert other.returncode == 2 and "holds no run of sphere" in other.stderr


def test_batch_jobs_add_to_the_study(tmp_path):
    study = Study(SCENE, tmp_path, SMALL, [1], ["strong"], steps=1, launcher="mpiexec -n {ranks}")
    (job,) = study.write_jobs("--time=10")
    text = job.read_text()
    assert "#SBATCH --ntasks=1 " in text and "#SBATCH --time=10\n" in text
    done = subprocess.run(
        ["bash", str(job)],
        env={**mpi_batch.ENVIRONMENT, "SLURM_JOB_ID": "17"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert [len(run.steps) for run in study.runs()] == [1]


def test_what_cannot_be_started_is_reported(tmp_path):
    with pytest.raises(InputError, match="name the number of ranks"):
        Study(SCENE, tmp_path, launcher="mpiexec")
    with pytest.raises(InputError, match="no-such-launcher cannot be started"):
        list(Study(SCENE, tmp_path, SMALL, launcher="no-such-launcher {ranks}").start())
    with pytest.raises(InputError, match="the run on 1 ranks ended with status 1"):
        list(Study(SCENE, tmp_path, SMALL, ranks=[1], launcher="false {ranks}").start())


def test_root_starts_ranks_unless_it_has_said_whether_it_may(tmp_path, monkeypatch):
    monkeypatch.setattr("os.geteuid", lambda: 0)
    for name in ROOT:
        monkeypatch.delenv(name, raising=False)
    shows = f"sh -c 'env > {tmp_path}/environment' {{ranks}}"
    launch(shows, 1, ["module", str(tmp_path / "environment")], "the run")
    assert {f"{name}=1" for name in ROOT} <= set((tmp_path / "environment").read_text().splitlines())
    monkeypatch.setenv(ROOT[0], "0")
    launch(shows, 1, ["module", str(tmp_path / "environment")], "the run")
    assert not {f"{name}=1" for name in ROOT} & set((tmp_path / "environment").read_text().splitlines())


def test_files_that_are_no_runs_are_refused(tmp_path):
    study = Study(SCENE, tmp_path, SMALL)
    (study.folder / "strong_1_000.json").write_text("{}")
    with pytest.raises(InputError, match="is no run of a scaling study"):
        study.runs()


def test_table_and_picture_show_every_run():
    runs = [one("strong", 1, 1000, 500, 4.0), one("strong", 2, 1000, 500, 2.5), one("weak", 1, 1000, 500, 4.0)]
    assert len(table(runs)) == 4 and "80%" in table(runs)[2]
    assert stage_table(runs[0])[1][:4] == ["solve", "1e+03", "1.33e+03", "2e+03"]
    assert list(by_kind(runs)) == ["strong", "weak"]
    assert len(draw(runs).axes) == 3
