"""The scaling study: it starts ranks, grows scenes with them, and tells efficiency from work and time."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mpi_batch
from amrpic.commands.scaling import Measured, by_kind, draw, efficiency, grown, study, table
from amrpic.errors import InputError
from amrpic.scene.scene import Scene

SCENE = Path(__file__).parents[2] / "examples" / "sphere.toml"
SMALL = ["domain.cells=16", "refinement.levels=1", "bunches.0.particles=2000"]


def one(kind: str, ranks: int, cells: int, particles: int, seconds: float) -> Measured:
    stages = {"solve": seconds / 2, "push": seconds / 4}
    traffic = {stage: {"messages": 12.0, "bytes": 3e4, "collectives": 5.0} for stage in stages}
    return Measured(kind, ranks, cells, particles, seconds, stages, traffic)


def test_efficiency_is_one_where_time_falls_with_ranks_or_work_grows_with_them():
    first = one("strong", 1, 1000, 500, 4.0)
    assert efficiency(first, one("strong", 4, 1000, 500, 1.0)) == pytest.approx(1)
    assert efficiency(first, one("strong", 4, 1000, 500, 2.0)) == pytest.approx(0.5)
    assert efficiency(first, one("weak", 4, 4000, 2000, 4.0)) == pytest.approx(1)
    assert efficiency(first, one("weak", 4, 4000, 2000, 5.0)) == pytest.approx(0.8)


def test_a_scene_grows_by_cells_and_particles():
    scene = Scene.from_toml(SCENE, SMALL)
    assert scene.refinement.blocking_factor == 8
    assert grown(scene, 1) == ["domain.cells=[16, 16, 16]", "bunches.0.particles=2000"]
    larger = Scene.from_toml(SCENE, [*SMALL, *grown(scene, 8)])
    assert list(larger.domain.value.cells) == [32, 32, 32]
    assert [bunch["particles"] for bunch in larger.to_dict()["bunches"]] == [16000]


def test_command_measures_both_kinds_on_one_and_two_ranks(tmp_path):
    changes = [part for change in SMALL for part in ("--set", change)]
    command = [str(Path(sys.executable).parent / "amrpic"), "scaling", str(SCENE), *changes]
    command += ["--ranks", "1", "2", "--steps", "2", "--output", str(tmp_path / "out")]
    done = subprocess.run(command, cwd=tmp_path, env=mpi_batch.ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = [Measured(**row) for row in json.loads((tmp_path / "out" / "scaling.json").read_text())]
    assert [(m.kind, m.ranks, m.particles) for m in found] == [
        ("strong", 1, 2000),
        ("strong", 2, 2000),
        ("weak", 1, 2000),
        ("weak", 2, 4000),
    ]
    assert found[0].cells == found[1].cells and all(m.seconds > 0 and "solve" in m.stages for m in found)
    assert re.search(r"strong +1 .* 100%", done.stdout)
    assert (tmp_path / "out" / "scaling.png").stat().st_size > 1000
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]  # nothing else is left


def test_what_cannot_be_started_is_reported():
    with pytest.raises(InputError, match="name the number of ranks"):
        list(study(SCENE, launcher="mpiexec"))
    with pytest.raises(InputError, match="no-such-launcher cannot be started"):
        list(study(SCENE, SMALL, launcher="no-such-launcher {ranks}"))
    with pytest.raises(InputError, match="the run on 1 ranks ended with status 1"):
        list(study(SCENE, SMALL, ranks=[1], launcher="false {ranks}"))


def test_table_and_picture_show_every_run():
    runs = [one("strong", 1, 1000, 500, 4.0), one("strong", 2, 1000, 500, 2.5), one("weak", 1, 1000, 500, 4.0)]
    assert table(runs).count("\n") == 3 and "80%" in table(runs)
    assert list(by_kind(runs)) == ["strong", "weak"]
    assert len(draw(runs).axes) == 3
