"""Particles are shared out evenly whatever box they lie in, from the start on, and the field is that of one rank.

An ordinary run of the tests takes fewer particles and steps; the long form (`pytest -m long`) 2e6
particles, and 200 steps of drifting bunches.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Scene
from amrpic.pic.adapt import make_base
from amrpic.pic.course import Course
from amrpic.pic.flight import place
from amrpic.pic.initial_particles import make_bunches
from amrpic.pic.setup import set_up
from amrpic.pic.state import State
from amrpic.pic.step import advance, begin
from amrpic.stages.migrate import BRICK_COST

MANY = 2_000_000
BYTES = 8 * 7  # of a particle: position, momentum, id
POINTS = np.random.default_rng(3).uniform(-0.02, 0.02, (500, 3))
TEN_BUNCHES = Path(__file__).parents[2] / "examples" / "ten_bunches.toml"


def one_box(levels: int, particles: int) -> Scene:
    """Six of ten particles in a box of 16³ cells that does not lie in the middle, the others around the middle."""

    def bunch(share: float, centre: list[float], sigma: float) -> dict[str, object]:
        return {
            "distribution": "waterbag",
            "species": "electron",
            "charge": -1e-11 * share,
            "particles": int(particles * share),
            "centre": centre,
            "sigma": sigma,
        }

    return Scene.from_dict(
        {
            "domain": {"lower": -0.024, "upper": 0.024, "cells": 48, "boundary": "dirichlet"},
            "bunches": [bunch(0.6, [0.016, -0.016, 0.016], 0.0015), bunch(0.4, [0.0, 0.0, 0.0], 0.004)],
            "refinement": {"levels": levels, "max_grid_size": 16, "regrid_every": 2},
            "solver": {"tolerance": 1e-10},
            "particles": {"interface": "own-level"},
            "motion": {"kind": "leapfrog", "dt": 5e-11},
            "schedule": {"steps": 4},
        },
        source="one box",
    )


def imbalance(state: State, brick_cost: int = 0) -> float:
    """The largest work of a rank over the mean, in particles. Collective."""
    comm, sorting = state.hierarchy.comm, state.particles.sorted_on(state.hierarchy)
    work = len(state.particles) + brick_cost * np.count_nonzero(np.diff(sorting.starts))
    return float(comm.allreduce(work, MPI.MAX) * comm.size / comm.allreduce(work))


def outcome(comm: MPI.Comm, scene: Scene) -> tuple[list[float], dict[str, np.ndarray]]:
    """The imbalance after the start and each step, and what the last state comes to."""
    state, setup = begin(comm, scene)
    found = [imbalance(state)]
    while state.step < scene.schedule.last_step:
        state = advance(state, setup)
        found.append(imbalance(state))
    moments = state.moments()
    return found, {
        "charge": np.array([state.rho.integral()]),
        "position": np.concatenate([moments.mean, moments.rms]),
        "field": state.efield.sample(POINTS),
        "cells": np.array([state.hierarchy.cells(level) for level in range(state.hierarchy.levels)]),
    }


@pytest.mark.mpi(ranks=(4,), timeout=240)
@pytest.mark.parametrize("levels", [0, 1])
def test_a_box_with_most_particles_is_shared_and_all_else_is_as_on_one_rank(comm, levels, long):
    scene = one_box(levels, MANY if long else 200_000)
    balance, together = outcome(comm, scene)
    assert max(balance) <= 1.2, balance
    alone = outcome(MPI.COMM_SELF, scene)[1] if comm.rank == 0 else None
    comm.Barrier()
    if alone is None:
        return
    assert np.array_equal(together["cells"], alone["cells"])
    assert together["charge"] == pytest.approx(alone["charge"], rel=1e-13, abs=0)
    assert together["position"] == pytest.approx(alone["position"], rel=1e-9, abs=1e-15)
    assert np.abs(together["field"] - alone["field"]).max() <= 1e-8 * np.abs(alone["field"]).max()


def resident(what: str) -> int:
    """Bytes of this process: VmRSS, or VmHWM, the most since `forget_peak`."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith(what)).split()[1])


def forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


@pytest.mark.mpi(ranks=(1, 4), timeout=600)
@pytest.mark.parametrize("bunches", [1, 2])
def test_placing_particles_takes_less_than_twice_their_bytes(comm, bunches):
    scene = one_box(0, MANY // 4 * comm.size)
    scene = scene.model_copy(update={"bunches": scene.bunches[:bunches]})
    setup = set_up(comm, scene)
    base = make_base(setup.comm, scene)
    base.particle_mesh  # noqa: B018  (made at the first access)
    made = make_bunches(comm, scene)
    many = comm.allreduce(sum(map(len, made)))
    forget_peak()
    before, window = resident("VmRSS"), Course.of_scene(scene).window
    particles = place(made, base, window, 0.0, setup).particles
    share = BYTES * many / comm.size
    assert comm.allreduce(len(particles), MPI.MAX) <= 1.05 * many / comm.size
    held = comm.allreduce((share + resident("VmHWM") - before) / share, MPI.MAX)
    assert held <= 2.0, held


@pytest.mark.mpi(ranks=(4,), timeout=240)
def test_drifting_bunches_stay_shared_out_in_the_same_memory(comm, long):
    """Ten bunches cross the domain, the mesh follows, and particles change their servers as often as it takes."""
    steps, settled = (200, 50) if long else (16, 8)
    given = tomllib.loads(TEN_BUNCHES.read_text())
    given["domain"] |= {"cells": 64, "lower": [-0.15, -0.15, -0.05], "upper": [0.15, 0.15, 0.25]}
    given["bunches"][0] |= {"particles": 20_000, "species": "electron", "charge": "-1 pC", "momentum": [0, 0, 3e-22]}
    given["refinement"] |= {"levels": 2, "regrid_every": 4}
    given["motion"] = {"kind": "leapfrog", "dt": 0.6e-9 / steps}  # 0.13 m along z
    given["schedule"] = {"steps": steps}
    scene = Scene.from_dict(given)
    state, setup = begin(comm, scene)
    work, servers, meshes, held = [], set(), set(), {}
    for step in range(1, steps + 1):
        state = advance(state, setup)
        work.append(imbalance(state, BRICK_COST))
        servers.add(bytes(state.particles.sorted_on(state.hierarchy).servers))
        meshes.add(tuple(state.hierarchy.boxes(level).tobytes() for level in range(state.hierarchy.levels)))
        held[step] = resident("VmRSS")
    assert max(work) < 1.3, work
    assert len(servers) > 1 and len(meshes) > 1
    assert comm.allreduce(held[steps] / held[settled], MPI.MAX) < 1.1
