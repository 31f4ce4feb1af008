"""Sources whose particles are born as a file says: openPMD with times of its own, and ASTRA's text."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from test_births import GAP, SLOW, STEP, ordered

from amrpic.errors import InputError
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT

COUNT = 200
RNG = np.random.default_rng(7)
TIME = RNG.uniform(0, 1e-9, COUNT)


def scene(source: dict[str, Any]) -> Scene:
    return Scene.from_dict(
        {
            "domain": GAP,
            "sources": [{"process": "file", **source}],
            "motion": {"kind": "leapfrog", "dt": STEP},
            "schedule": {"steps": 20},
            "output": {"write": []},
        }
    )


def openpmd(folder, status: int) -> str:
    """A file of particles at a cathode with times of birth."""
    position = np.column_stack([RNG.uniform(2e-4, 8e-4, (COUNT, 2)), np.zeros(COUNT)])
    momenta = np.tile([0, 0, SLOW * ELECTRON_MASS], (COUNT, 1))
    bunch = {
        "distribution": "arrays",
        "species": "electron",
        "charge": -1e-20,
        "position": position,
        "momenta": momenta,
    }
    at_rest = Scene.from_dict({"domain": GAP, "bunches": [bunch], "motion": {"kind": "none"}, "output": {"write": []}})
    path = folder / "births.h5"
    Simulation(MPI.COMM_SELF, at_rest).write_particles(path)
    with h5py.File(path, "r+") as h5:
        found: list[h5py.Group] = []
        h5.visititems(lambda name, item: found.append(item.parent) if name.endswith("position/x") else None)
        group = found[0].parent
        for name, values in (("time", TIME), ("particleStatus", np.full(COUNT, status))):
            attributes = dict(group[name].attrs) if name in group else {}
            if name in group:
                del group[name]
            group[name] = values
            group[name].attrs.update({key: value for key, value in attributes.items() if key not in ("value", "shape")})
    return str(path)


def astra(folder) -> str:
    """The same births as a text by ASTRA, behind a reference particle that has been lost."""
    table = np.zeros((COUNT + 1, 10))
    table[1:, 0:2] = RNG.uniform(2e-4, 8e-4, (COUNT, 2))
    table[:, 5] = 0
    table[0, 5] = SLOW * ELECTRON_MASS * SPEED_OF_LIGHT / ELEMENTARY_CHARGE
    table[0, 6], table[1:, 6] = 0.1, TIME * 1e9 - 0.1
    table[:, 7], table[:, 8], table[:, 9] = -1e-20 / COUNT * 1e9, 1, -1
    table[0, 9] = -89
    path = folder / "births.ini"
    np.savetxt(path, table, fmt="%.16e")
    return str(path)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("kind", ["cathode", "alive", "astra"])
def test_particles_of_a_file_fly_from_their_times_on(comm, tmp_path, kind):
    file = None
    if comm.rank == 0:
        file = astra(tmp_path) if kind == "astra" else openpmd(tmp_path, {"cathode": 0, "alive": 1}[kind])
    file = comm.bcast(file)
    run = Simulation(comm, scene({"file": file, "face": "z_lower", "delay": 3 * STEP}))
    run.advance(20)
    particles = ordered(comm, run)
    assert len(particles) == COUNT == run.state.tallies.of[0].particles
    speed = SLOW / np.sqrt(1 + (SLOW / SPEED_OF_LIGHT) ** 2)
    age = run.time - 3 * STEP - np.sort(TIME)
    np.testing.assert_allclose(particles[:, 3], speed * age, rtol=1e-6, atol=1e-9)
    assert run.state.tallies.of[0].charge == pytest.approx(-1e-20, rel=1e-9)


def test_files_that_cannot_be_used_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.h5"):
        Simulation(MPI.COMM_SELF, scene({"file": str(tmp_path / "nowhere.h5")}))
    (tmp_path / "few.txt").write_text("1 2 3\n")
    with pytest.raises(InputError, match="3 columns"):
        Simulation(MPI.COMM_SELF, scene({"file": str(tmp_path / "few.txt")}))
    (tmp_path / "words.txt").write_text("x y z\n")
    with pytest.raises(InputError, match="no table of numbers"):
        Simulation(MPI.COMM_SELF, scene({"file": str(tmp_path / "words.txt")}))
    with pytest.raises(InputError, match="lost particle"):
        Simulation(MPI.COMM_SELF, scene({"file": openpmd(tmp_path, 2)}))


@pytest.mark.parametrize(
    "column, value, words", [(-2, 3, "has protons, but its source electrons"), (-1, 1, "status -1 or 5")]
)
def test_particles_of_another_kind_or_of_the_past_are_refused(tmp_path, column, value, words):
    file = astra(tmp_path)
    table = np.loadtxt(file)
    table[1:, column] = value
    np.savetxt(file, table)
    with pytest.raises(InputError, match=words):
        Simulation(MPI.COMM_SELF, scene({"file": file, "face": "z_lower"}))


def test_a_file_of_another_species_than_its_source_is_refused(tmp_path):
    with pytest.raises(InputError, match="has electrons, but its source positrons"):
        Simulation(MPI.COMM_SELF, scene({"file": openpmd(tmp_path, 0), "species": "positron"}))


def test_births_before_the_run_draw_a_remark(tmp_path):
    remarks = Simulation(MPI.COMM_SELF, scene({"file": astra(tmp_path), "face": "z_lower", "delay": -2 * STEP})).remarks
    part = np.mean(TIME < 2 * STEP)
    assert [
        f"{part:.3g} of the charge of source_0 would be born before the run" in sentence for sentence in remarks
    ] == [True]
