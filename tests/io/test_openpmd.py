"""Particles in openPMD files: BeamPhysics writes what we read and reads what we write, and nothing is lost in between."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import beamphysics
import h5py
import numpy as np
import pytest
from mpi4py import MPI

from amrpic.errors import InputError
from amrpic.io import openpmd_reader, openpmd_writer
from amrpic.io.provenance import Moment, Provenance
from amrpic.parallel import share
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, Species, SpeciesTable
from amrpic.pic.initial_particles import make_particles
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from particle_cases import everywhere

COUNT = 500
EV_PER_C = ELEMENTARY_CHARGE / SPEED_OF_LIGHT  # kg m/s


def group(species: str = "electron", seed: int = 0, **changes: Any) -> Any:
    """A bunch as BeamPhysics holds it: places in m, momenta in eV/c, weights in C."""
    random = np.random.default_rng(seed)
    columns = {key: random.normal(0, 1e-3, COUNT) for key in ("x", "y", "z")}
    columns |= {key: random.normal(1e5, 1e4, COUNT) for key in ("px", "py", "pz")}
    data = {**columns, "t": np.zeros(COUNT), "status": np.ones(COUNT), "weight": random.uniform(1, 2, COUNT) * 1e-15}
    return beamphysics.ParticleGroup(data={**data, "species": species, **changes})


def on_first(comm: MPI.Comm, act: Any) -> None:
    """Do something on rank 0 while the others wait."""
    if comm.rank == 0:
        act()
    comm.Barrier()


def scene(path: Path, **changes: Any) -> Scene:
    bunch = {"distribution": "openpmd", "file": str(path)}
    base = {
        "domain": {"lower": -0.01, "upper": 0.01, "cells": 16, "boundary": "dirichlet"},
        "bunches": [bunch],
        "refinement": {"max_grid_size": 8},
        "output": {"write": []},
    }
    return Scene.from_dict({**base, **changes})


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_a_beamphysics_file_goes_in_and_comes_out_unchanged(comm, tmp_path):
    on_first(comm, lambda: group().write(str(tmp_path / "in.h5")))
    keys = ("x", "y", "z", "px", "py", "pz", "t", "status", "weight", "charge", "norm_emit_x", "mean_energy", "sigma_z")
    given = comm.bcast({key: group()[key] for key in keys} if comm.rank == 0 else None)
    simulation = Simulation(comm, scene(tmp_path / "in.h5"))
    assert simulation.particles.total_charge(comm) == pytest.approx(-given["charge"], rel=1e-13, abs=0)
    assert simulation.rho.integral() == pytest.approx(-given["charge"], rel=1e-13, abs=0)
    mine = everywhere(comm, simulation.particles)
    assert np.array_equal(mine["position"], np.stack([given[axis] for axis in "xyz"], axis=1))
    np.testing.assert_allclose(mine["momentum"][:, 2], given["pz"] * EV_PER_C, rtol=1e-15)

    simulation.write_particles(tmp_path / "out.h5")
    if comm.rank == 0:
        back = beamphysics.ParticleGroup(str(tmp_path / "out.h5"))
        assert back.species == "electron"
        for key in ("x", "y", "z", "t", "status"):
            assert np.array_equal(back[key], given[key]), key
        for key in ("px", "py", "pz", "weight"):  # eV/c to kg m/s and C to electrons round once each way
            np.testing.assert_array_max_ulp(back[key], given[key], maxulp=3)
        for key in ("norm_emit_x", "mean_energy", "sigma_z", "charge"):
            assert back[key] == pytest.approx(given[key], rel=1e-12, abs=0), key

    again = make_particles(comm, scene(tmp_path / "out.h5"))  # in SI units nothing is rounded
    assert again.species == simulation.particles.species
    for name, values in everywhere(comm, again).items():
        assert np.array_equal(values, mine[name]), name


@pytest.mark.mpi(ranks=2)
def test_a_run_writes_the_same_particles_on_any_number_of_ranks(comm, tmp_path):
    on_first(comm, lambda: group().write(str(tmp_path / "in.h5")))
    for ranks, name in ((MPI.COMM_SELF, f"alone{comm.rank}"), (comm, "together")):
        output = {"write": ["particles"], "particles_every": 1, "directory": str(tmp_path / name)}
        motion = {"kind": "random-walk", "amplitude": "1 mm"}
        Simulation(ranks, scene(tmp_path / "in.h5", output=output, motion=motion, schedule={"steps": 2})).run()
    comm.Barrier()
    assert [path.name for path in sorted((tmp_path / "together").glob("*.h5"))] == [
        f"particles_{step:08d}.h5" for step in (0, 1, 2)
    ]
    alone, together = (
        beamphysics.ParticleGroup(str(tmp_path / n / "particles_00000002.h5")) for n in ("alone0", "together")
    )
    for key in ("x", "y", "z", "px", "py", "pz", "weight", "id"):
        assert np.array_equal(alone[key], together[key]), key
    assert np.array_equal(alone.id, np.arange(COUNT))


@pytest.mark.mpi(ranks=(1, 3))
def test_every_species_has_a_group_that_can_be_chosen(comm, tmp_path):
    ion = Species(name="argon", charge=2 * ELEMENTARY_CHARGE, mass=6.6e-26)
    table = SpeciesTable.of_runs([(0, SPECIES["proton"]), (10, ion), (25, SPECIES["proton"])])
    random = np.random.default_rng(1)
    all_of = Particles(
        random.normal(0, 1e-3, (40, 3)), random.normal(size=(40, 3)), random.random(40) + 1, np.arange(40), table
    )
    path = tmp_path / "two.h5"
    openpmd_writer.write(comm, path, all_of.select(slice(comm.rank, None, comm.size)), Moment(3, 1e-9), Provenance())
    with pytest.raises(InputError, match="2 groups; set group to one of argon, proton"):
        openpmd_reader.read(path, partial(share, comm))
    part = openpmd_reader.read(path, partial(share, comm), group="argon", iteration=3)
    assert part.species.kinds == (ion,)
    assert len(part) == pytest.approx(15 / comm.size, abs=1)
    assert np.array_equal(everywhere(comm, part)["momentum"], all_of.momentum[10:25])
    protons = everywhere(comm, openpmd_reader.read(path, partial(share, comm), group="proton", first_id=100))
    assert np.array_equal(protons["weight"], all_of.weight[np.r_[0:10, 25:40]])
    assert protons["id"].tolist() == list(range(100, 125))


def test_units_offsets_and_macroparticle_momenta_are_respected(comm, tmp_path):
    with h5py.File(tmp_path / "foreign.h5", "w") as h5:
        h5.attrs.update(basePath="/data/%T/", particlesPath="particles/")
        beam = h5.create_group("/data/7/particles/positron")
        for i, axis in enumerate("xyz"):
            beam[f"position/{axis}"] = np.arange(4.0) + i
            beam[f"position/{axis}"].attrs["unitSI"] = 1e-3
            offset = beam.create_group(f"positionOffset/{axis}")
            offset.attrs.update(value=2.0, shape=[4], unitSI=0.5)
            beam[f"momentum/{axis}"] = np.full(4, 6.0)
            beam[f"momentum/{axis}"].attrs["unitSI"] = 2.0
        beam["momentum"].attrs.update(macroWeighted=1, weightingPower=1.0)
        beam.create_group("weighting").attrs.update(value=3.0, shape=[4])
    particles = openpmd_reader.read(tmp_path / "foreign.h5", partial(share, comm))
    assert particles.position == pytest.approx(np.arange(4)[:, None] * 1e-3 + [1, 1.001, 1.002], rel=1e-14, abs=0)
    assert particles.momentum == pytest.approx(np.full((4, 3), 4.0), rel=1e-14, abs=0)
    assert particles.weight.tolist() == [3.0] * 4
    assert particles.species.kinds[0].name == "positron"


def broken(path: Path, how: str) -> None:
    if how == "foreign":
        path.write_bytes(b"not HDF5")
        return
    changes: dict[str, Any] = {
        "nan": {"px": np.where(np.arange(COUNT) == 400, np.nan, 1.0)},
        "lost": {"status": 1 + (np.arange(COUNT) == 450)},
        "times": {"t": 1e-9 * (np.arange(COUNT) > 300)},
        "muon": {"species": "muon"},
    }.get(how, {})
    group(**changes).write(str(path))
    with h5py.File(path, "r+") as h5:
        if how == "no momentum":
            del h5["particles/electron/momentum"]
        if how == "two iterations":
            for iteration in ("1", "2"):
                h5.copy("particles", f"data/{iteration}/particles")
            h5.attrs["basePath"] = np.bytes_(b"/data/%T/")


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize(
    "how, words",
    [
        ("missing", ["does not exist"]),
        ("foreign", ["cannot be read as openPMD"]),
        ("nan", ["momentum that is not finite", "row 400 of 500"]),
        ("lost", ["lost particle", "row 450"]),
        ("times", ["another time", "row 301", "drift"]),
        ("muon", ['species "muon"', "give the bunch a species"]),
        ("no momentum", ["momentum/x is missing", "cannot be read as openPMD"]),
        ("two iterations", ["2 iterations", "set iteration to one of"]),
    ],
)
def test_a_bad_file_is_refused_in_one_sentence_on_all_ranks(comm, tmp_path, how, words):
    path = tmp_path / "bad.h5"
    if how != "missing":
        on_first(comm, lambda: broken(path, how))
    with pytest.raises(InputError) as refused:
        make_particles(comm, scene(path))
    message = str(refused.value)
    assert "\n" not in message and "bad.h5" in message
    for word in words:
        assert word in message
    assert comm.allgather(message) == [message] * comm.size


def test_only_the_rows_asked_for_are_read(tmp_path):
    broken(tmp_path / "bad.h5", "nan")  # in row 400
    part = openpmd_reader.read(tmp_path / "bad.h5", lambda count: (100, 300), first_id=7)
    assert part.id.tolist() == list(range(107, 307))
    with pytest.raises(InputError, match="row 400 of 500"):
        openpmd_reader.read(tmp_path / "bad.h5", lambda count: (300, 500))


def test_what_cannot_be_written_is_reported_and_leaves_nothing(comm, tmp_path):
    from amrpic.errors import OutputError

    (tmp_path / "file").write_text("in the way")
    nothing = Particles.empty(SpeciesTable((SPECIES["proton"],)))
    with pytest.raises(OutputError, match="cannot write particles"):
        openpmd_writer.write(comm, tmp_path / "file" / "out.h5", nothing, Moment(0, 0.0), Provenance())
    openpmd_writer.write(comm, tmp_path / "none.h5", nothing, Moment(0, 0.0), Provenance())
    assert len(openpmd_reader.read(tmp_path / "none.h5", partial(share, comm))) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "none.h5"]


def foreign(path: Path, **changes: Any) -> None:
    """Electrons of another code: changes are arrays by record, or attributes of one by "record.attribute"."""
    count = 20
    columns = {f"position/{axis}": np.linspace(-1e-3, 1e-3, count) for axis in "xyz"}
    columns |= {f"momentum/{axis}": np.full(count, 1e-22) for axis in "xyz"} | {"weighting": np.full(count, 1e4)}
    with h5py.File(path, "w") as h5:
        h5.attrs.update(basePath="/data/%T/", particlesPath="particles/")
        electron = h5.create_group("data/0/particles/electron")
        for name, values in (columns | {name: one for name, one in changes.items() if "." not in name}).items():
            electron[name] = values
        for record, dimension in (("position", openpmd_writer.LENGTH), ("momentum", openpmd_writer.MOMENTUM)):
            electron[record].attrs["unitDimension"] = np.array(dimension, dtype=float)
        for name, value in changes.items():
            record, _, attribute = name.partition(".")
            if attribute:
                electron[record].attrs[attribute] = value


SPEED_OF_FILE, LENGTH = np.array([1, 0, -1, 0, 0, 0, 0.0]), np.array([1.0, 0, 0, 0, 0, 0, 0])
LOST = {"particleStatus": np.where(np.arange(20) == 7, 2, 1)}
ZERO = {"weighting": np.where(np.arange(20) == 3, 0.0, 1e4)}
MACRO = {"momentum.macroWeighted": np.uint32(1), "momentum.weightingPower": 1.0}


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(
    "changes, words",
    [
        ({"momentum.unitDimension": SPEED_OF_FILE}, ["/data/0/particles/electron/momentum", "m s^-1", "kg m/s"]),
        ({"momentum.unitDimension": 0 * LENGTH}, ["momentum has the dimension 1,"]),
        ({"momentum/y.unitDimension": SPEED_OF_FILE}, ["/momentum/y has the dimension m s^-1"]),
        ({"position.unitDimension": SPEED_OF_FILE}, ["/position has the dimension m s^-1", "that of m "]),
        ({"weighting.unitDimension": LENGTH}, ["/weighting has the dimension m,", "that of a number"]),
        ({"weight": np.ones(20), "weight.unitDimension": LENGTH}, ["/weight has the dimension m,", "that of C"]),
        ({"time": np.zeros(20), "time.unitDimension": LENGTH}, ["/time has the dimension m,", "that of s"]),
        (ZERO | MACRO, ["a weight of zero", "row 3 of 20", "momenta per real particle"]),
        ({"weighting": -np.ones(20)}, ["a weight that is negative", "row 0 of 20"]),
        # what is lost or has no weight is named before momenta that it would spoil
        (LOST | ZERO | MACRO | {"momentum/x": np.full(20, np.nan)}, ["the status of a lost particle", "row 7 of 20"]),
        ({"momentum/x": np.where(np.arange(20) == 5, 1e6, 0)}, ["bunches.0", "1e+06 kg m/s at id 5", "1e+09 m c"]),
    ],
)
def test_what_a_foreign_file_has_wrong_is_named_by_record_and_row(comm, tmp_path, changes, words):
    on_first(comm, lambda: foreign(tmp_path / "foreign.h5", **changes))
    with pytest.raises(InputError) as refused:
        make_particles(comm, scene(tmp_path / "foreign.h5"))
    message = str(refused.value)
    assert "foreign.h5" in message and "\n" not in message and "Warning" not in message
    for word in words:
        assert word in message
    assert comm.allgather(message) == [message] * comm.size


@pytest.mark.mpi(ranks=(1, 2))
def test_weights_of_zero_are_test_particles(comm, tmp_path):
    """They fly in the field of the others: as particles of weight do from the same places, and they change no field."""
    motion = {"kind": "leapfrog", "dt": "20 ps"}

    def after(name: str, **changes: Any) -> tuple[dict[str, np.ndarray], float]:
        on_first(comm, lambda: foreign(tmp_path / name, **changes))
        run = Simulation(comm, scene(tmp_path / name, motion=motion))
        field = run.efield.integral_of_square()
        run.advance(3)
        return everywhere(comm, run.particles), field

    slow = {f"momentum/{axis}": np.full(20, 1e-26) for axis in "xyz"}
    charge = 2e7 / 20  # real electrons, so that the field is felt
    real, field = after("real.h5", weighting=np.full(20, charge), **slow)
    doubled = {
        name: np.tile(values, 2)
        for name, values in ({f"position/{axis}": np.linspace(-1e-3, 1e-3, 20) for axis in "xyz"} | slow).items()
    }
    both, field_of_both = after("both.h5", weighting=np.repeat([charge, 0.0], 20), **doubled)
    assert field_of_both == pytest.approx(field, rel=1e-12)
    np.testing.assert_allclose(both["momentum"][20:], real["momentum"], rtol=1e-10)
    np.testing.assert_allclose(both["momentum"][:20], real["momentum"], rtol=1e-10)
    assert np.abs(real["momentum"] - 1e-26).max() > 1e-26


@pytest.mark.mpi(ranks=(1, 2))
def test_a_bunch_of_a_file_is_turned_and_moved(comm, tmp_path):
    """As far from each other as before, with momenta along the new axis; where a file's x, y, z point is known exactly."""
    on_first(comm, lambda: group().write(str(tmp_path / "in.h5")))
    bunch = {"distribution": "openpmd", "file": str(tmp_path / "in.h5")}
    moved = {**bunch, "axis": [1, 0, 0], "roll": "90 deg", "shift": ["1 mm", 0, "-2 mm"]}
    before = everywhere(comm, make_particles(comm, scene(tmp_path / "in.h5")))
    after = everywhere(comm, make_particles(comm, scene(tmp_path / "in.h5", bunches=[moved])))
    turned = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]).T  # x goes to y, y to z, z to x
    np.testing.assert_allclose(after["position"], before["position"] @ turned.T + [1e-3, 0, -2e-3], atol=1e-17)
    np.testing.assert_allclose(after["momentum"], before["momentum"] @ turned.T, atol=1e-15 * before["momentum"].max())
    with pytest.raises(InputError, match="those from files by their shift"):
        Simulation(comm, scene(tmp_path / "in.h5", bunches=[{**bunch, "shift": [0, 0, "1 m"]}]))


@pytest.mark.mpi(ranks=(1, 2))
def test_particles_outside_at_the_start_are_told_of(comm, tmp_path):
    on_first(comm, lambda: group(x=np.where(np.arange(COUNT) < 3, 0.02, 0.0)).write(str(tmp_path / "in.h5")))
    run = Simulation(comm, scene(tmp_path / "in.h5"))
    assert f"3 of {COUNT} particles of bunch 1 of 1 lie outside the domain at the start: lost" in run.remarks
    assert comm.allreduce(len(run.lost)) == 3
