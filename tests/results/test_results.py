"""Results: what a run wrote reads back as what the simulation held."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import amrpic


def scene(folder: Path, **output: Any) -> amrpic.Scene:
    return amrpic.Scene(
        name="read back",
        domain=amrpic.Domain(-0.1, 0.1, 16, boundary="dirichlet"),
        bunches=[amrpic.GaussianBunch(species="electron", sigma=0.01, charge="-10 pC", particles=3000)],
        refinement={"levels": 1, "blocking_factor": 4, "rule": amrpic.ChargeDensityRule(relative=0.05)},
        motion=amrpic.Leapfrog(dt="50 ps"),
        schedule={"steps": 3},
        output={"directory": str(folder), "write": ["fields", "series", "checkpoint", "particles", "losses"], **output},
    )


def levels_of(field: Any) -> np.ndarray:
    return np.concatenate([field.array(level) for level in range(field.hierarchy.levels)])


@pytest.mark.mpi(ranks=(1, 2))
def test_fields_particles_and_tables_are_those_of_the_run(comm, tmp_path):
    simulation = amrpic.Simulation(comm, scene(tmp_path, fields_every=2))
    results = simulation.run(log="silent")
    assert results.stopped is None and results.path == tmp_path
    for found in (results, amrpic.open(comm, tmp_path)):
        assert found.scene == simulation.scene
        assert list(found.series.step) == [0, 1, 2, 3] and found.series.attrs["units"]["charge"] == "C"
        assert found.series.charge.iloc[-1] == simulation.rho.integral()
        assert list(found.beam.group.unique()) == ["all", "electron", "bunch_0"]
        assert set(found.residuals.step) == {0, 1, 2, 3}
        assert list(found.fields) == [0, 2, 3]
        last = found.fields[3]
        assert (last.step, last.time, set(last)) == (3, simulation.time, {"rho", "phi", "E"})
        np.testing.assert_array_equal(levels_of(last.phi), levels_of(simulation.phi))
        np.testing.assert_array_equal(levels_of(last.E.y), levels_of(simulation.efield.y))
        assert last.phi.unit == "V" and last.hierarchy.same_mesh(simulation.hierarchy)
        held, read = simulation.particles, found.particles()
        assert comm.allreduce(len(read)) == comm.allreduce(len(held))
        mine = dict(zip(read.id.tolist(), read.position.tolist(), strict=True))
        everyones = {id: place for part in comm.allgather(mine) for id, place in part.items()}
        assert all(everyones[id] == place for id, place in zip(held.id.tolist(), held.position.tolist(), strict=True))


@pytest.mark.parametrize(("order", "holds"), [(2, "points"), (4, "means")])
def test_a_dump_and_a_checkpoint_are_read_by_themselves(tmp_path, order, holds):
    simulation = amrpic.Simulation(scene(tmp_path).replace(solver={"order": order}))
    simulation.run(log="silent")
    for name in ("fields_00000003.vtkhdf", "checkpoint_00000003"):
        found = amrpic.open(tmp_path / name)
        assert list(found.fields) == [3] and found.scene == simulation.scene
        np.testing.assert_array_equal(levels_of(found.fields[3].rho), levels_of(simulation.rho))
        assert found.fields[3].phi.holds == simulation.phi.holds == holds and found.fields[3].rho.holds == "points"
    assert amrpic.Simulation.restart(tmp_path / "checkpoint_00000003").phi.holds == holds
    assert len(amrpic.open(tmp_path / "checkpoint_00000003").particles(3)) == 3000


def test_a_particle_group_has_the_particles_in_its_units(tmp_path):
    simulation = amrpic.Simulation(scene(tmp_path))
    group = simulation.run(log="silent").particle_group()
    assert group.species == "electron" and group.n_particle == 3000
    assert group.charge == pytest.approx(10e-12, rel=1e-12)
    assert group["sigma_x"] == pytest.approx(simulation.particles.position[:, 0].std(), rel=1e-3)
    assert group["mean_pz"] * 1.602176634e-19 / 299792458 == pytest.approx(
        simulation.particles.momentum[:, 2].mean(), rel=1e-9, abs=1e-30
    )


def test_losses_have_a_row_each(tmp_path):
    given = scene(tmp_path).replace(
        domain=amrpic.Domain(-0.1, 0.1, 16),
        apertures=[amrpic.RoundAperture(name="hole", centre=(0, 0, 0), length=0.01, radius=0.01)],
        bunches=[
            amrpic.GaussianBunch(
                species="electron",
                sigma=0.01,
                charge="-10 pC",
                particles=2000,
                centre=(0, 0, -0.05),
                velocity=(0, 0, "0.1 c"),
            )
        ],
        motion=amrpic.Leapfrog(dt="0.5 ns"),
        schedule={"steps": 6},
    )
    simulation = amrpic.Simulation(given)
    losses = simulation.run(log="silent").losses
    lost = simulation.lost
    assert len(losses) == len(lost) > 100
    order = np.argsort(lost.particles.id)
    np.testing.assert_array_equal(losses.sort_values("id").z, lost.particles.position[order, 2])
    np.testing.assert_array_equal(losses.sort_values("id")["at"], np.array(lost.names)[lost.cause[order]])
    assert set(losses.species) == {"electron"}


def test_a_checkpoint_that_a_killed_run_left_unfinished_is_none(tmp_path):
    results = amrpic.Simulation(scene(tmp_path, write=["series", "checkpoint"])).run(log="silent")
    (tmp_path / "checkpoint_00000009.tmp").mkdir()
    assert list(results.fields) == [3] and len(results.particles()) == 3000


@pytest.mark.mpi(ranks=(2,))
def test_what_is_not_there_is_one_sentence_on_all_ranks(comm, tmp_path):
    with pytest.raises(amrpic.InputError, match="does not exist; give the folder of a run"):
        amrpic.open(comm, tmp_path / "nothing")
    found = amrpic.open(comm, tmp_path)
    with pytest.raises(amrpic.InputError, match=r"holds no series\.csv; it has no tables"):
        found.series  # noqa: B018
    with pytest.raises(amrpic.InputError, match=r"there are no fields of step 3; see output\.write"):
        found.fields[3]
    with pytest.raises(amrpic.InputError, match=r"holds no particles; see output\.write"):
        found.particles()


def test_an_error_of_a_reading_rank_is_shown_once(tmp_path, monkeypatch):
    amrpic.Simulation(scene(tmp_path)).run(log="silent")
    results = amrpic.open(tmp_path)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(amrpic.InputError, match="tables need pandas") as raised:
        _ = results.series
    assert raised.value.__cause__ is None
