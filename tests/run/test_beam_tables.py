"""Tables of the beam: rows when they are due, the same after a restart, a script's own values, and failures in those."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from amrpic import Scene, Simulation
from amrpic.errors import InputError
from amrpic.io import time_series
from amrpic.io.provenance import Provenance
from amrpic.io.time_series import Series
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT, Column
from mpi_batch import ENVIRONMENT

GROUPS = ["all", "electron", "proton", "bunch_0", "pair_0", "pair_1"]


def scene(folder: Path, **changes: Any) -> Scene:
    """Three bunches that fly apart, some of them out of the domain."""
    data: dict[str, Any] = {
        "domain": {"lower": -0.02, "upper": 0.02, "cells": 16, "boundary": "open"},
        "bunches": [
            {
                "distribution": "gaussian",
                "species": "electron",
                "sigma": "4 mm",
                "charge": "-10 pC",
                "particles": 900,
                "velocity": [0, 0, "0.3 c"],
                "momentum_spread": "10 keV/c",
            },
            {
                "distribution": "gaussian",
                "name": "pair",
                "species": "proton",
                "sigma": "1 mm",
                "charge": "5 pC",
                "particles": 300,
                "count": 2,
                "spacing": ["8 mm", 0, 0],
            },
        ],
        "motion": {"kind": "leapfrog", "dt": "20 ps"},
        "schedule": {"steps": 7},
        "diagnostics": {"every": 2, "slices": 5},
        "output": {"directory": str(folder), "write": ["checkpoint", "series"], "checkpoint_every": 2, "keep": 9},
    }
    return Scene.from_dict({**data, **changes})


def spread(state):
    """A diagnostic that asks all ranks."""
    mine = np.array([state.particles.momentum[:, 2].max(initial=0.0), float(state.step)])
    return {
        "step_again": state.step,
        "shape": np.arange(6).reshape(2, 3),
        "most": state.hierarchy.comm.allgather(mine)[0],
    }


def run(comm, folder, **changes):
    simulation = Simulation(comm, scene(folder, **changes))
    simulation.diagnose("spread", spread)
    simulation.run()
    comm.barrier()
    return simulation


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_tables_hold_a_row_per_group_and_slice_of_each_step_that_is_due(comm, tmp_path):
    simulation = run(comm, tmp_path)
    series, beam, slices, own = (
        time_series.read(tmp_path / name) for name in ("series.csv", "beam.csv", "slices.csv", "own_spread.csv")
    )
    steps = [0, 2, 4, 6, 7]
    assert beam["step"].tolist() == [step for step in steps for _ in GROUPS]
    assert beam["group"].tolist() == GROUPS * len(steps)
    assert slices["slice"].tolist() == list(range(5)) * len(GROUPS) * len(steps)
    assert own["step"].tolist() == own["step_again"].tolist() == steps
    assert own.dtype.names == (
        "step",
        "time",
        "s",
        "step_again",
        *(f"shape_{i}_{j}" for i in (0, 1) for j in range(3)),
        "most_0",
        "most_1",
    )
    whole, row = beam[beam["group"] == "all"], series[np.isin(series["step"], steps)]
    assert np.array_equal(whole["particles"], row["particles"]) and np.array_equal(
        whole["lost_particles"], row["lost_particles"]
    )
    assert row["lost_particles"][-1] > 0
    for name in ("lost_charge", "kinetic_energy", *(f"rms_{a}" for a in "xyz"), *(f"emittance_{a}" for a in "xyz")):
        np.testing.assert_allclose(whole[name], row[name], rtol=1e-10, err_msg=name)
    for axis in "xyz":
        np.testing.assert_allclose(whole[f"mean_{axis}"], row[f"mean_{axis}"], rtol=0, atol=1e-16)
        scale = np.abs(row["momentum_z"]).max()
        np.testing.assert_allclose(whole[f"momentum_{axis}"], row[f"momentum_{axis}"], rtol=0, atol=1e-12 * scale)
    for number, step in enumerate(steps):
        now = beam[beam["step"] == step]
        for total in ("particles", "lost_particles"):
            assert (
                now[total][0] == now[total][1:3].sum() == now[total][3:].sum() and now[total][2] == now[total][4:].sum()
            )
        of = slices[(slices["step"] == step) & (slices["group"] == "all")]
        assert of["charge"].sum() == pytest.approx(now["charge"][0], rel=1e-9, abs=1e-24)
        assert now["charge"][1] + now["lost_charge"][1] == pytest.approx(-10e-12, rel=1e-12)
        assert number == 0 or now["time"][0] == pytest.approx(step * 20e-12)
    assert simulation.step == 7


@pytest.mark.mpi(ranks=(1, 2))
def test_a_restart_goes_on_with_the_tables_bit_by_bit(comm, tmp_path):
    run(comm, tmp_path / "whole")
    run(comm, tmp_path / "parts")
    again = Simulation.restart(
        comm, tmp_path / "parts" / "checkpoint_00000004", scene(tmp_path / "parts", schedule={"steps": 7})
    )
    again.diagnose("spread", spread)
    again.run()
    comm.barrier()
    for name in ("beam.csv", "slices.csv", "own_spread.csv"):
        one, other = (
            [line for line in (tmp_path / part / name).read_text().splitlines() if not line.startswith("# scene")]
            for part in ("whole", "parts")
        )
        assert one == other, name


@pytest.mark.mpi(ranks=(1, 2))
def test_a_beam_that_is_lost_leaves_rows_to_the_end(comm, tmp_path):
    run(comm, tmp_path, motion={"kind": "leapfrog", "dt": "2 ns"}, bunches=scene(tmp_path).to_dict()["bunches"][:1])
    beam = time_series.read(tmp_path / "beam.csv")
    assert beam["particles"][-1] == 0 and beam["lost_particles"][-1] == 900
    assert np.isnan(beam["rms_x"][-1]) and np.isnan(beam["emittance_z_90"][-1]) and beam["charge"][-1] == 0


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("boundary", ["open", "periodic"])
def test_a_group_of_test_particles_among_others_is_measured_by_number(comm, tmp_path, boundary):
    """As NumPy has it of the places and momenta at the start; the bunch that makes the field is measured as without them."""
    from mpi4py import MPI

    bunches = scene(tmp_path).to_dict()["bunches"][:1]
    tests = {**bunches[0], "name": "tests", "particles": 400, "sigma": "2 mm", "self_field": False}
    changes = {
        "schedule": {"steps": 0},
        "domain": {"lower": -0.02, "upper": 0.02, "cells": 16, "boundary": boundary},
        "background": "neutralizing" if boundary == "periodic" else "none",
    }
    run(comm, tmp_path / "alone", bunches=bunches, **changes)
    simulation = run(comm, tmp_path / "both", bunches=[*bunches, tests], **changes)
    beams, slices = (
        {folder: time_series.read(tmp_path / folder / name) for folder in ("alone", "both")}
        for name in ("beam.csv", "slices.csv")
    )
    for table in beams, slices:
        one, other = (table[folder][table[folder]["group"] == "bunch_0"] for folder in ("alone", "both"))
        for name in one.dtype.names:
            if name != "group":
                np.testing.assert_allclose(other[name], one[name], rtol=1e-9, atol=1e-30, err_msg=name)
    particles = simulation.particles
    mine = particles.id >= 900
    x, p = (np.concatenate(comm.allgather(of[mine])) for of in (particles.position, particles.momentum))
    row = beams["both"][beams["both"]["group"] == "tests"][0]
    assert len(x) == row["particles"] > 390 and row["charge"] == 0
    x, u = x - x.mean(axis=0), p / (ELECTRON_MASS * SPEED_OF_LIGHT)
    u -= u.mean(axis=0)
    for d, axis in enumerate("xyz"):
        square = (x[:, d] ** 2).mean() * (u[:, d] ** 2).mean() - (x[:, d] * u[:, d]).mean() ** 2
        assert row[f"rms_{axis}"] == pytest.approx(x[:, d].std(), rel=1e-9)
        assert row[f"emittance_{axis}"] == pytest.approx(np.sqrt(square), rel=1e-9)
    assert row["radius_xyz_50"] == pytest.approx(np.median(np.linalg.norm(x, axis=1)), rel=0.02)
    of = slices["both"][slices["both"]["group"] == "tests"]
    assert of["particles"].sum() == len(x) and np.isfinite(of["rms_x"][of["particles"] > 0]).all()
    assert of["particles"] @ of["mean_x"] == pytest.approx(len(x) * row["mean_x"], abs=1e-9)
    assert comm.allreduce(len(particles), MPI.SUM) == beams["both"]["particles"][0]


@pytest.mark.mpi(ranks=(1, 2))
def test_no_rows_where_none_are_wanted(comm, tmp_path):
    run(comm, tmp_path, diagnostics={"every": 0, "slices": 5})
    assert {path.name for path in tmp_path.glob("*.csv")} == {"series.csv", "residuals.csv"}


def fails_on_last_rank(state):
    if state.hierarchy.comm.rank == state.hierarchy.comm.size - 1 and state.step == 2:
        raise ZeroDivisionError("no spread")
    return {"a": 1.0}


def changes(state):
    return {"a": np.zeros(1 + (state.step > 0))}


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize(
    ("diagnostic", "message"),
    [
        (fails_on_last_rank, r'the diagnostic "mine" failed \(ZeroDivisionError: no spread\)'),
        (changes, 'the diagnostic "mine" gives other values at step 2 than before; give the same ones'),
        (lambda state: {"a": "text"}, r'the diagnostic "mine" failed \(ValueError: could not convert'),
        (lambda state: 3.0, r'the diagnostic "mine" failed \(AttributeError'),
        (lambda state: {"a,b": 1.0}, r"failed \(ValueError: 'a,b' is no name of a column; leave commas"),
        (lambda state: {"a": [1.0, 2.0], "a_0": 3.0}, r'failed \(ValueError: two columns are called "a_0"; give'),
        (lambda state: {"step": 3.0}, r'failed \(ValueError: two columns are called "step"; give'),
    ],
)
def test_a_diagnostic_that_fails_is_one_sentence_on_all_ranks(comm, tmp_path, diagnostic, message):
    simulation = Simulation(comm, scene(tmp_path))
    simulation.diagnose("mine", diagnostic)
    with pytest.raises(InputError, match=message) as caught:
        simulation.run()
    assert len(set(comm.allgather(str(caught.value)))) == 1


def test_a_name_that_is_no_file_is_refused(comm, tmp_path):
    with pytest.raises(InputError, match='the diagnostic "a/b" names a file'):
        Simulation(comm, scene(tmp_path)).diagnose("a/b", changes)


SCRIPT = """
import sys
from mpi4py import MPI
from amrpic import Scene, Simulation

def diagnostic(state):
    if MPI.COMM_WORLD.rank == 1:
        raise ValueError("bad luck")
    return {"all": MPI.COMM_WORLD.allreduce(1)}

simulation = Simulation(MPI.COMM_WORLD, Scene.from_toml(sys.argv[1]))
simulation.diagnose("mine", diagnostic)
simulation.run()
"""


def test_ranks_that_wait_within_a_diagnostic_end_with_the_one_that_failed(tmp_path):
    (tmp_path / "scene.toml").write_text(scene(tmp_path).to_toml())
    (tmp_path / "script.py").write_text(SCRIPT)
    command = ["mpiexec", "-n", "2", sys.executable, str(tmp_path / "script.py"), str(tmp_path / "scene.toml")]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=60)
    assert done.returncode != 0
    sentences = [line for line in done.stderr.splitlines() if line.startswith("amrpic: ")]
    assert sentences == ['amrpic: the diagnostic "mine" failed (ValueError: bad luck) (on rank 1 of 2 alone)']


def test_columns_of_text_are_kept_over_a_restart(comm, tmp_path):
    columns = [Column("step", counts=True), Column("group", is_text=True), Column("value", "m")]
    path = tmp_path / "table.csv"
    table = Series(comm, path, columns, Provenance())
    for step in range(3):
        table.append(*({"step": step, "group": name, "value": step / 3} for name in ("all", "H-", "é_1")))
    table.close()
    Series(comm, path, columns, Provenance(), keep_to_step=1).close()
    rows = time_series.read(path)
    assert rows["group"].tolist() == ["all", "H-", "é_1"] * 2
    assert rows["value"].tolist() == [0.0] * 3 + [1 / 3] * 3
