"""When a run starts: at the time of the files that it reads, or when the scene says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.commands.preview import preview
from amrpic.errors import InputError
from amrpic.io import openpmd_reader
from amrpic.io.field_reader import open_dump
from amrpic.scene.run_sections import Schedule
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT

DT = 24e-12
LINE: dict[str, Any] = {
    "domain": {"lower": ["-10 mm", "-10 mm", "-60 mm"], "upper": ["10 mm", "10 mm", "250 mm"], "cells": [8, 8, 32]},
    "elements": [
        {"kind": "rf-gap", "centre": [0, 0, 0.1], "length": "6 cm", "voltage": "200 kV", "frequency": "1 GHz"}
    ],
    "motion": {"kind": "leapfrog", "dt": DT},
}
BEAM = {
    "distribution": "gaussian",
    "species": "electron",
    "kinetic_energy": "1 MeV",
    "sigma": "1 mm",
    "cutoff": 4,
    "charge": "-1e-20 C",
    "particles": 300,
}


def begun(comm: MPI.Comm, bunches: list[dict[str, Any]], **changes: Any) -> amrpic.Simulation:
    return amrpic.Simulation(comm, amrpic.Scene.from_dict({**LINE, "bunches": bunches, **changes}))


def momenta(run: amrpic.Simulation) -> np.ndarray:
    """Over m c, (n, 3), of all ranks in the order of ids."""
    particles = run.particles
    order = np.argsort(np.concatenate(run.comm.allgather(np.array(particles.id))))
    mine = np.ascontiguousarray(particles.momentum) / (ELECTRON_MASS * SPEED_OF_LIGHT)
    return np.concatenate(run.comm.allgather(mine))[order]


@pytest.mark.mpi(ranks=(1, 2), timeout=120)
def test_a_run_cut_in_two_by_a_file_goes_on_in_phase(comm, tmp_path):
    """Through an RF gap of 1 GHz, 5 of 30 steps before the file: the same momenta, to what the solver leaves of the field."""
    whole, first = begun(comm, [BEAM]), begun(comm, [BEAM])
    whole.advance(30)
    first.advance(5)
    first.write_particles(tmp_path / "first.h5")
    file = {"distribution": "openpmd", "file": str(tmp_path / "first.h5")}
    second = begun(comm, [file])
    assert second.time == first.time == pytest.approx(5 * DT, rel=1e-14)
    assert any(note.startswith("schedule.start: 1.2e-10 s, the time of ") for note in second._setup.remarks.notes)
    second.advance(25)
    assert second.time == pytest.approx(whole.time, rel=1e-14)
    np.testing.assert_allclose(momenta(second), momenta(whole), rtol=0, atol=1e-9)
    late = begun(comm, [file], schedule={"start": 0.0})
    assert late.time == 0 and any("in place of 1.2e-10 s of" in note for note in late._setup.remarks.notes)
    late.advance(25)
    assert np.abs(momenta(late) - momenta(whole)).max() > 0.1  # another phase


def test_formulas_fields_files_and_losses_know_the_start(tmp_path: Path) -> None:
    times: list[float] = []

    def field(x: Any, y: Any, z: Any, t: float) -> Any:
        times.append(t)
        return (0.0, 0.0, 1e6 * t / DT), (0.0, 0.0, 0.0)

    outside = {**BEAM, "cutoff": None, "sigma": ["1 mm", "4 mm", "1 mm"]}
    scene = amrpic.Scene.from_dict(
        {
            **LINE,
            "elements": [],
            "bunches": [outside],
            "schedule": {"start": "1 ns", "steps": 2},
            "output": {"directory": str(tmp_path), "write": ["fields", "particles", "series", "losses"]},
        }
    )
    run = amrpic.Simulation(MPI.COMM_SELF, scene, [field])
    assert len(run.lost) > 0 and set(run.lost.time) == {1e-9}
    run.run(log="silent")
    assert times[0] == 1e-9 and run.time == pytest.approx(1e-9 + 2 * DT, rel=1e-15)
    found = amrpic.open(MPI.COMM_SELF, tmp_path)
    assert found.series["time"].tolist() == pytest.approx([1e-9, 1e-9 + DT, 1e-9 + 2 * DT], rel=1e-15)
    assert openpmd_reader.when(tmp_path / "particles_00000002.h5") == (2, run.time)
    with open_dump(tmp_path) as dump:
        assert dump.time == run.time


def test_files_of_several_times_are_refused_unless_the_scene_chooses(tmp_path: Path) -> None:
    run = begun(MPI.COMM_SELF, [BEAM])
    run.write_particles(tmp_path / "early.h5")
    run.advance(2)
    run.write_particles(tmp_path / "late.h5")
    bunches = [{"distribution": "openpmd", "file": str(tmp_path / f"{name}.h5")} for name in ("early", "late")]
    run.checkpoint(tmp_path / "checkpoint")
    later = run.scene.model_copy(update={"schedule": Schedule(start="1 ns")})
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "checkpoint", later)
    assert again.time == run.time
    assert "schedule.start has no effect: the run goes on at the 4.8e-11 s of the checkpoint" in again.remarks
    with pytest.raises(InputError, match=r"early\.h5 is of the time 0 s, .*late\.h5 of 4.8e-11 s; set schedule.start"):
        begun(MPI.COMM_SELF, bunches)
    directory = {"output": {"directory": str(tmp_path / "preview"), "write": []}}
    with pytest.raises(InputError, match=r"set schedule\.start"):
        preview(MPI.COMM_SELF, amrpic.Scene.from_dict({**LINE, **directory, "bunches": bunches}), 1)
    said = preview(MPI.COMM_SELF, amrpic.Scene.from_dict({**LINE, **directory, "bunches": bunches[1:]}), 1)
    assert "note: schedule.start: 4.8e-11 s, the time of" in said
    with open_dump(tmp_path / "preview" / "preview.vtkhdf") as dump:
        assert dump.time == run.time
    assert begun(MPI.COMM_SELF, bunches, schedule={"start": "48 ps"}).time == 48e-12
    with h5py.File(tmp_path / "late.h5", "r+") as h5:
        h5["data/2/particles/electron/time"].attrs["value"] = np.nan
    with pytest.raises(InputError, match=r"late\.h5"):
        begun(MPI.COMM_SELF, bunches[1:])


@pytest.mark.mpi(ranks=(1, 2))
def test_test_particles_feel_the_field_and_make_none(comm):
    """A bunch of the same seed without self-field flies as the one that makes the field; statistics count each once."""
    cloud = {**BEAM, "kinetic_energy": 0, "charge": "-1 pC", "cutoff": None}
    both = [cloud, {**cloud, "self_field": False, "sampling": "sobol", "particles": 256}]
    quiet = {"elements": [], "domain": {"lower": "-8 mm", "upper": "8 mm", "cells": 16}}
    alone, run = begun(comm, both[:1], **quiet), begun(comm, both, **quiet)
    np.testing.assert_allclose(run.rho.max_abs(), alone.rho.max_abs(), rtol=1e-12)
    for one in alone, run:
        one.advance(4)
    np.testing.assert_allclose(momenta(run)[:300], momenta(alone), rtol=0, atol=1e-9)
    assert 1e-6 < np.abs(momenta(run)[300:]).mean() < 10 * np.abs(momenta(alone)).mean()
    assert run.particles.global_count(comm) == 556
    free = begun(comm, both[1:], **quiet)
    assert free.rho.max_abs() == 0 and free.efield.integral_of_square() == 0
    assert free.state.moments().rms == pytest.approx([1e-3] * 3, rel=0.02)
