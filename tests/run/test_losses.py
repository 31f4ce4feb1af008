"""Particles that are scraped, leave the domain, or pass screens: where, when, with what momentum, and the files of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import beamphysics
import h5py
import numpy as np
import pytest

from amrpic import Scene, Simulation
from amrpic.errors import SceneError
from amrpic.io import time_series
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT

MC = ELECTRON_MASS * SPEED_OF_LIGHT
SIGMA, RADIUS, FRONT = 2e-3, 3e-3, 0.01
U = 0.6  # β γ of the cold bunch
SPEED = U / np.hypot(1, U) * SPEED_OF_LIGHT

COLD = {
    "distribution": "gaussian",
    "species": "electron",
    "sigma": [SIGMA, SIGMA, 1e-3],
    "charge": -1e-22,  # so little that paths are straight
    "particles": 4000,
    "momentum": [0, 0, U * MC],
    "centre": [0, 0, -0.02],
}
SCRAPER = {"kind": "round", "name": "scraper", "centre": [0, 0, FRONT + 0.005], "length": "1 cm", "radius": RADIUS}


def scene(folder: Path, **changes: Any) -> Scene:
    """A cold bunch that flies 6 cm up z."""
    data: dict[str, Any] = {
        "domain": {
            "lower": [-0.02, -0.02, -0.05],
            "upper": [0.02, 0.02, 0.05],
            "cells": [8, 8, 20],
            "boundary": "open",
        },
        "bunches": [COLD],
        "motion": {"kind": "leapfrog", "dt": 0.06 / SPEED / 10},
        "schedule": {"steps": 10},
        "output": {"directory": str(folder), "write": ["losses"]},
    }
    return Scene.from_dict({**data, **changes})


def run(comm: Any, given: Scene) -> Simulation:
    simulation = Simulation(comm, given)
    simulation.run()
    comm.barrier()
    return simulation


def gathered(comm: Any, record: Any) -> dict[str, np.ndarray]:
    """A record of all ranks, in the order of ids and times, and the names of causes."""
    mine = {
        "id": record.particles.id,
        "position": np.array(record.particles.position),
        "momentum": np.array(record.particles.momentum),
        "weight": np.array(record.particles.weight),
        "time": record.time,
        "direction": record.direction,
        "cause": np.array(record.names)[record.cause] if record.names else np.zeros(0, dtype="U1"),
    }
    whole = {name: np.concatenate(comm.allgather(value)) for name, value in mine.items()}
    order = np.lexsort((whole["time"], whole["id"]))
    return {name: value[order] for name, value in whole.items()}


def first_places(comm: Any, given: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Ids and places of a scene's particles at its start."""
    particles = Simulation(comm, given).particles
    ids, places = (np.concatenate(comm.allgather(np.array(a))) for a in (particles.id, particles.position))
    order = np.argsort(ids)
    return ids[order], places[order]


def columns_of(path: Path) -> dict[str, np.ndarray]:
    """What an openPMD file holds of its particles, species after species."""
    out: dict[str, list[np.ndarray]] = {}
    with h5py.File(path) as h5:
        (iteration,) = h5["data"].values()
        for species in iteration["particles"].values():
            species.visititems(
                lambda name, item: out.setdefault(name, []).append(item[:]) if isinstance(item, h5py.Dataset) else None
            )
    return {name: np.concatenate(parts) for name, parts in out.items()}


@pytest.mark.mpi(ranks=(1, 3))
def test_a_round_aperture_cuts_a_gaussian_beam(comm, tmp_path):
    given = scene(tmp_path, apertures=[SCRAPER])
    ids, start = first_places(comm, given)
    simulation = run(comm, given)
    lost = gathered(comm, simulation.lost)
    outside = np.hypot(start[:, 0], start[:, 1]) > RADIUS
    assert np.array_equal(lost["id"], ids[outside])
    share, expected = outside.mean(), np.exp(-(RADIUS**2) / (2 * SIGMA**2))
    assert abs(share - expected) < 4 * np.sqrt(expected * (1 - expected) / len(ids))
    assert set(lost["cause"]) == {"scraper"} and np.all(lost["direction"] == 1)
    np.testing.assert_allclose(lost["position"][:, :2], start[outside, :2], rtol=1e-12)
    np.testing.assert_allclose(lost["position"][:, 2], FRONT, rtol=0, atol=1e-16)
    np.testing.assert_allclose(lost["time"], (FRONT - start[outside, 2]) / SPEED, rtol=1e-12)
    np.testing.assert_allclose(lost["momentum"][:, 2], U * MC, rtol=1e-9)
    alive = np.concatenate(comm.allgather(simulation.particles.id))
    assert np.array_equal(np.sort(np.concatenate([alive, lost["id"]])), ids)


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
def test_files_of_losses_are_the_same_on_any_number_of_ranks(comm, tmp_path):
    """Openings of all kinds, faces of the domain, and space charge: the oracle is the record itself on one rank."""
    from mpi4py import MPI

    hot = {**COLD, "momentum_spread": [0.06 * MC] * 3, "charge": "-1 pC"}
    changes = {
        "bunches": [hot],
        "apertures": [
            {**SCRAPER, "radius": "8 mm"},
            {"kind": "elliptic", "centre": [0, 0, -0.01], "length": "1 mm", "half_widths": ["7 mm", "5 mm"]},
            {"kind": "rectangular", "centre": [0, 0, 0.03], "length": "2 mm", "half_widths": ["4 mm", "6 mm"]},
        ],
        "screens": [{"name": "middle", "z": 0}, {"name": "end", "z": "35 mm"}],
        "schedule": {"steps": 12},
        "diagnostics": {"loss_bin": "1 mm"},
    }
    simulation = run(comm, scene(tmp_path / "all", **changes))
    if comm.rank == 0:
        Simulation(MPI.COMM_SELF, scene(tmp_path / "one", **changes)).run()
    comm.barrier()
    lost = gathered(comm, simulation.lost)
    assert {"scraper", "aperture_1", "aperture_2", "z_upper"} <= set(lost["cause"])
    for name in ("losses.h5", "screen_middle.h5", "screen_end.h5"):
        one, all_ = (columns_of(tmp_path / folder / name) for folder in ("one", "all"))
        assert one.keys() == all_.keys() and len(one["id"]) > 300
        for column, values in one.items():
            if values.dtype.kind == "f":
                scale = np.abs(values).max()
                np.testing.assert_allclose(all_[column], values, rtol=0, atol=1e-8 * scale, err_msg=f"{name} {column}")
            else:
                assert np.array_equal(all_[column], values), column
    file = columns_of(tmp_path / "all/losses.h5")
    assert np.array_equal(file["id"], lost["id"]) and np.array_equal(file["time"], lost["time"])
    assert np.array_equal(file["momentum/x"], lost["momentum"][:, 0])
    table = time_series.read(tmp_path / "all/losses.csv")
    energy = lost["weight"] * (np.hypot(1, np.linalg.norm(lost["momentum"], axis=1) / MC) - 1) * MC * SPEED_OF_LIGHT
    for cause in set(lost["cause"]):
        mine, rows = lost["cause"] == cause, table[table["cause"] == cause]
        assert rows["particles"].sum() == mine.sum()
        assert rows["energy"].sum() == pytest.approx(energy[mine].sum(), rel=1e-9, abs=0)
        assert rows["charge"].sum() == pytest.approx(-lost["weight"][mine].sum() * ELEMENTARY_CHARGE, rel=1e-12, abs=0)
        z = lost["position"][mine, 2]
        for row in rows:
            in_bin = (z >= row["lower"] - 1e-12) & (z <= row["upper"] + 1e-12)
            assert in_bin.sum() >= row["particles"] > 0 and row["upper"] - row["lower"] == pytest.approx(1e-3)
    assert table["upper"].max() == pytest.approx(0.05)  # what leaves at the upper face is in the last bin


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("bent", [False, True])
def test_a_restart_in_the_middle_leaves_the_same_records_bit_by_bit(comm, tmp_path, bent):
    changes: dict[str, Any] = {
        "bunches": [{**COLD, "momentum_spread": [0.05 * MC] * 3, "charge": "-2 pC", "particles": 2000}],
        "apertures": [{**SCRAPER, "length": "4 cm"}],
        "screens": [{"name": "s", "z": "1 mm"}, {"name": "t", "z": "3 cm"}],
        "refinement": {"levels": 1, "regrid_every": 3},
        "schedule": {"steps": 11},
    }
    if bent:
        changes["elements"] = [{"kind": "quadrupole", "length": "4 cm", "gradient": "1 T/m"}]

    def of(folder: str) -> Scene:
        write = ["checkpoint", "losses"]
        output = {"directory": str(tmp_path / folder), "write": write, "checkpoint_every": 7, "keep": 9}
        return scene(tmp_path, **changes, output=output)

    whole = run(comm, of("whole"))
    half = tmp_path / "whole/checkpoint_00000007"
    again = Simulation.restart(comm, half, of("again"))
    known = len(again.lost), len(again.screens)
    again.run()
    comm.barrier()
    for before, now, old in zip((whole.lost, whole.screens), (again.lost, again.screens), known, strict=True):
        new = comm.allreduce(len(now) - old)
        assert new > 50 and comm.allreduce(old) > 50
        for a, b in zip(before.particles.arrays, now.particles.arrays, strict=True):
            assert np.array_equal(a, b)
        for name in ("time", "direction", "cause"):
            assert np.array_equal(getattr(before, name), getattr(now, name))
        assert before.names == now.names
    if comm.rank == 0:
        for name in ("losses.h5", "screen_s.h5", "screen_t.h5"):
            one, other = (columns_of(tmp_path / folder / name) for folder in ("whole", "again"))
            assert all(np.array_equal(one[column], other[column]) for column in one), name
        rows = [
            [line for line in (tmp_path / folder / "losses.csv").read_text().splitlines() if line[0] != "#"]
            for folder in ("whole", "again")
        ]
        assert rows[0] == rows[1] and len(rows[0]) > 2


@pytest.mark.mpi(ranks=2)
def test_records_go_on_on_another_number_of_ranks_and_with_other_apertures(comm, tmp_path):
    from mpi4py import MPI

    changes = {"apertures": [SCRAPER], "screens": [{"name": "s", "z": 0.005}, {"name": "t", "z": 0.03}]}
    given = scene(tmp_path / "a", **changes)
    whole = Simulation(comm, given)
    whole.on_step(lambda now: now.checkpoint(tmp_path / "half") if now.step == 5 else None)
    whole.run()
    should = [gathered(comm, record) for record in (whole.lost, whole.screens)]
    other = {**changes, "apertures": [{**SCRAPER, "name": "new"}], "screens": changes["screens"][1:]}
    if comm.rank == 0:
        again = Simulation.restart(MPI.COMM_SELF, tmp_path / "half", scene(tmp_path / "b", **other))
        lost_before = len(again.lost)
        again.run()
        lost, screens = (gathered(MPI.COMM_SELF, record) for record in (again.lost, again.screens))
        assert np.array_equal(lost["id"], should[0]["id"]) and np.array_equal(screens["id"], should[1]["id"])
        np.testing.assert_allclose(lost["position"], should[0]["position"], rtol=0, atol=1e-12)
        assert 0 < lost_before == (lost["cause"] == "scraper").sum() < len(lost["id"])
        assert set(lost["cause"]) == {"scraper", "new"} and set(screens["cause"]) == {"s", "t"}
        assert any("apertures" in remark and "screens" in remark for remark in again.remarks)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_screen_sees_a_drifting_bunch_in_both_directions(comm, tmp_path):
    """Straight paths: places and times exact to rounding; particles fly through each other, each passes once."""
    rng = np.random.default_rng(5)
    count = 500
    position = rng.uniform(-1, 1, (count, 3)) * (0.002, 0.002, 0.02)
    u = rng.normal(0, 0.02, (count, 3)) + np.outer(np.where(np.arange(count) % 2, 0.6, -0.6), (0, 0, 1))
    given = scene(
        tmp_path,
        bunches=[
            {
                "distribution": "arrays",
                "species": "electron",
                "position": position.tolist(),
                "momenta": (u * MC).tolist(),
                "charge": -1e-26,
            }
        ],
        screens=[{"name": "mid", "z": 0.001}],
        motion={"kind": "leapfrog", "dt": 0.03 / SPEED / 7},
        schedule={"steps": 7},
    )
    simulation = run(comm, given)
    seen = gathered(comm, simulation.screens)
    velocity = u / np.sqrt(1 + (u**2).sum(axis=1, keepdims=True)) * SPEED_OF_LIGHT
    time = (0.001 - position[:, 2]) / velocity[:, 2]
    passes = (time > 0) & (time < 0.03 / SPEED)
    assert np.array_equal(seen["id"], np.flatnonzero(passes)) and passes.sum() > 150
    assert np.all(seen["position"][:, 2] == 0.001)
    np.testing.assert_allclose(seen["time"], time[passes], rtol=1e-12, atol=1e-22)
    where = (position + velocity * time[:, None])[passes]
    np.testing.assert_allclose(seen["position"], where, rtol=0, atol=1e-15)
    np.testing.assert_allclose(seen["momentum"], u[passes] * MC, rtol=1e-9)
    assert np.array_equal(seen["direction"], np.sign(u[passes, 2])) and set(seen["direction"]) == {-1, 1}
    if comm.rank == 0:
        group = beamphysics.ParticleGroup(str(tmp_path / "screen_mid.h5"))
        np.testing.assert_allclose(group.x, seen["position"][:, 0])
        np.testing.assert_allclose(group.t, seen["time"])
        np.testing.assert_allclose(group.pz, seen["momentum"][:, 2] * SPEED_OF_LIGHT / ELEMENTARY_CHARGE)
        assert np.array_equal(group.id, seen["id"]) and group.n_alive == len(seen["id"])


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("bent", [False, True])
def test_apertures_and_screens_stay_in_the_laboratory_when_the_mesh_moves(comm, tmp_path, bent):
    """A mesh that goes along with the bunch, and turns with it, finds what a large one at rest does."""
    changes: dict[str, Any] = {
        "apertures": [
            SCRAPER,
            {"kind": "elliptic", "name": "late", "centre": [0, 0, 0.03], "half_widths": [0.002, 0.0015]},
        ],
        "screens": [{"name": "s", "z": 0.005}, {"name": "t", "z": 0.029}],
        "bunches": [{**COLD, "momentum_spread": [0.02 * MC] * 3}],
    }
    changes["apertures"][1]["length"] = "1 mm"
    if bent:
        changes["elements"] = [{"kind": "uniform", "magnetic_field": [0, "1.5 mT", 0], "length": "4 cm"}]
    still = run(comm, scene(tmp_path / "still", **changes))
    small = {"lower": [-0.02, -0.02, -0.04], "upper": [0.02, 0.02, 0.0], "cells": [8, 8, 8], "boundary": "open"}
    dt = 0.06 / SPEED / 10
    moves = {"kind": "leapfrog", "dt": dt, "window": "reference"}
    moving = run(comm, scene(tmp_path / "moving", **changes, domain=small, motion=moves))
    assert moving.state.window.is_turned == bent and moving.state.window.origin[2] > 0.05
    for one, other, causes in (
        (still.lost, moving.lost, {"scraper", "late"}),
        (still.screens, moving.screens, {"s", "t"}),
    ):
        should, found = gathered(comm, one), gathered(comm, other)
        assert np.array_equal(found["id"], should["id"]) and len(found["id"]) > 1000
        assert np.array_equal(found["cause"], should["cause"]) and causes == set(found["cause"])
        np.testing.assert_allclose(found["position"], should["position"], rtol=0, atol=2e-10)
        np.testing.assert_allclose(found["time"], should["time"], rtol=0, atol=1e-18)
        np.testing.assert_allclose(found["momentum"], should["momentum"], rtol=0, atol=1e-8 * MC)


def test_momenta_where_particles_are_lost_are_of_second_order(comm, tmp_path):
    """In a uniform field they are exact; of a particle that turns the error falls with the square of the step."""
    accelerating = scene(
        tmp_path,
        elements=[{"kind": "uniform", "electric_field": [0, 0, "-3 MV/m"]}],
        apertures=[SCRAPER],
        screens=[{"name": "early", "z": "-1 mm"}],
    )
    simulation = run(comm, accelerating)
    for record in (simulation.lost, simulation.screens):
        gained = record.particles.momentum[:, 2] - U * MC
        assert len(record) > 500
        np.testing.assert_allclose(gained, 3e6 * ELEMENTARY_CHARGE * record.time, rtol=1e-8)
    errors = []
    for steps in (16, 32, 64):
        turning = scene(
            tmp_path,
            elements=[{"kind": "uniform", "magnetic_field": [0, 0, "0.1 T"]}],
            bunches=[{**COLD, "momentum": [0.04 * MC, 0, U * MC], "particles": 300}],
            screens=[{"name": "s", "z": 0.0123}],
            motion={"kind": "leapfrog", "dt": 0.06 / SPEED / steps},
            schedule={"steps": steps},
        )
        seen = run(comm, turning).screens
        gamma = np.sqrt(1 + 0.04**2 + U**2)
        angle = 0.1 * ELEMENTARY_CHARGE / (gamma * ELECTRON_MASS) * seen.time
        assert len(seen) == 300
        should = 0.04 * MC * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        errors.append(np.sqrt(np.mean((seen.particles.momentum[:, :2] - should) ** 2)) / (0.04 * MC))
    assert np.log2(errors[0] / errors[2]) / 2 > 1.8, errors


def test_dead_particles_say_what_they_died_at_in_beamphysics(comm, tmp_path):
    simulation = run(comm, scene(tmp_path, apertures=[SCRAPER]))
    group = beamphysics.ParticleGroup(str(tmp_path / "losses.h5"))
    assert group.n_alive == 0 and len(group) == len(simulation.lost)
    with h5py.File(tmp_path / "losses.h5") as h5:
        causes = [name.decode() for name in h5["amrpic/causes"]]
    assert {causes[int(status) - 2] for status in group.status} == {"scraper"}
    assert group.charge == pytest.approx((simulation.lost.particles.weight * ELEMENTARY_CHARGE).sum())


def test_what_starts_in_the_solid_is_lost_at_once_and_behind_screens_nothing_is_seen(comm, tmp_path):
    plate = {"kind": "round", "centre": [0, 0, 0.01], "length": "1 mm", "radius": "0.1 um"}
    block = {
        "kind": "rectangular",
        "name": "block",
        "centre": [0, 0, -0.0195],
        "length": "1 mm",
        "half_widths": ["1 mm", 1],
    }
    simulation = run(comm, scene(tmp_path, apertures=[plate, block], screens=[{"name": "behind", "z": 0.0101}]))
    lost, start = gathered(comm, simulation.lost), first_places(comm, scene(tmp_path))[1]
    solid = (np.abs(start[:, 0]) > 1e-3) & (np.abs(start[:, 2] + 0.0195) <= 0.5e-3)
    assert np.array_equal(lost["time"] == 0, solid) and solid.sum() > 300
    assert np.array_equal(lost["position"][solid], start[solid])
    assert len(simulation.screens) == 0 == len(simulation.particles) and len(lost["id"]) == 4000


def test_faces_of_the_domain_are_causes_like_apertures(comm, tmp_path):
    rays = np.concatenate([np.eye(3), -np.eye(3)]) * 2 * U * MC
    bunch = {
        "distribution": "arrays",
        "species": "electron",
        "position": [[1e-3, 2e-3, 3e-3]] * 6,
        "momenta": rays.tolist(),
        "charge": -1e-26,
    }
    lost = run(comm, scene(tmp_path, bunches=[bunch])).lost
    where = {lost.names[c]: x.tolist() for c, x in zip(lost.cause, lost.particles.position, strict=True)}
    assert where.keys() == {"x_upper", "y_upper", "z_upper", "x_lower", "y_lower", "z_lower"}
    for name, x in where.items():
        axis = "xyz".index(name[0])
        at = {"x": 0.02, "y": 0.02, "z": 0.05}[name[0]] * (1 if name.endswith("upper") else -1)
        expected = [1e-3, 2e-3, 3e-3]
        expected[axis] = at
        assert x[axis] == at and x == pytest.approx(expected, rel=1e-12)
    assert (tmp_path / "losses.h5").exists()


def test_files_of_losses_are_there_if_there_is_something_to_say(comm, tmp_path):
    run(comm, scene(tmp_path, apertures=[SCRAPER]))
    assert {path.name for path in tmp_path.glob("losses*")} == {"losses.h5", "losses.csv", "losses.json"}
    run(comm, scene(tmp_path))
    assert (tmp_path / "earlier_1").is_dir()
    assert not list(tmp_path.glob("losses*"))  # those of the earlier run would be taken for its own
    run(comm, scene(tmp_path, apertures=[{**SCRAPER, "radius": 1}], screens=[{"name": "s", "z": 1}]))
    assert len(columns_of(tmp_path / "screen_s.h5")["id"]) == 0 == len(time_series.read(tmp_path / "losses.csv"))


@pytest.mark.mpi(ranks=2)
def test_random_walkers_are_lost_at_apertures_too(comm, tmp_path):
    given = scene(
        tmp_path,
        apertures=[{"kind": "round", "radius": "4 mm"}],
        motion={"kind": "random-walk", "amplitude": "1 mm"},
    )
    simulation = run(comm, given)
    lost = gathered(comm, simulation.lost)
    assert len(lost["id"]) + simulation.particles.global_count(comm) == 4000 and len(lost["id"]) > 500
    assert np.all(np.hypot(*simulation.particles.position[:, :2].T) <= 4e-3)
    r = np.hypot(lost["position"][:, 0], lost["position"][:, 1])
    at_once = r > 4e-3 * (1 + 1e-12)
    assert 300 < at_once.sum() < len(r) and r[~at_once] == pytest.approx(4e-3, rel=1e-12)


BAD = [
    ({"apertures": [{**SCRAPER, "radius": 0}]}, "apertures.0.radius (0.0)", "greater than 0"),
    ({"apertures": [{**SCRAPER, "length": "0 mm"}]}, "apertures.0.length", "greater than 0"),
    ({"apertures": [{**SCRAPER, "kind": "square"}]}, "apertures.0", "unknown kind"),
    (
        {"apertures": [{"kind": "elliptic", "half_widths": ["1 mm", "-2 mm"]}]},
        "apertures.0.half_widths.1",
        "greater than 0",
    ),
    ({"apertures": [{"kind": "elliptic"}]}, "apertures.0.half_widths", "is missing"),
    ({"apertures": [SCRAPER, SCRAPER]}, "apertures.1.name", "one of the apertures before it"),
    ({"apertures": [{**SCRAPER, "name": "x_lower"}]}, "apertures.0.name", "a face of the domain"),
    ({"apertures": [{**SCRAPER, "name": "a/b"}]}, "apertures.0.name", "use letters, digits"),
    ({"screens": [{"name": "s", "z": 0}, {"name": "s", "z": 1}]}, "screens.1.name", "one of the screens before it"),
    ({"screens": [{"z": 0}]}, "screens.0.name", "is missing"),
    ({"screens": [{"name": "s", "z": "1 T"}]}, "screens.0.z", "use one of m"),
    ({"screens": [{"name": "s", "x": 0, "z": 0}]}, "screens.0.x", "unknown key"),
    ({"diagnostics": {"loss_bin": 0}}, "diagnostics.loss_bin", "greater than 0"),
]


@pytest.mark.parametrize("changes, where, what", BAD, ids=[f"{bad[1]}-{n}" for n, bad in enumerate(BAD)])
def test_bad_apertures_and_screens_get_one_sentence(tmp_path, changes, where, what):
    with pytest.raises(SceneError) as refused:
        scene(tmp_path, **changes)
    assert where in str(refused.value) and what in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_scene_with_apertures_and_screens_comes_back_from_its_text(tmp_path):
    given = scene(
        tmp_path,
        apertures=[SCRAPER, {"kind": "elliptic", "half_widths": ["1 mm", "2 mm"]}],
        screens=[{"name": "s", "z": 0}],
    )
    assert Scene.from_dict(json.loads(json.dumps(given.to_dict()))) == given
