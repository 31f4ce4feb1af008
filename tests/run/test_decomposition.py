"""The ten bunches give the same answer on any number of ranks and for any size of boxes.

An ordinary run of the tests takes a smaller scene; in the long form (`pytest -m long`) it is the example itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Scene
from amrpic.pic.step import advance, begin
from regions import blocks_of

SCENE = Path(__file__).parents[2] / "examples" / "ten_bunches.toml"
SMALLER = [
    "domain.cells=48",
    "refinement.levels=2",
    "bunches.0.particles=3000",
    "schedule.solves=4",
    "refinement.regrid_every=2",
]
POINTS = np.random.default_rng(7).uniform(-0.15, 0.15, (1000, 3))


@dataclass
class Outcome:
    """What a run leaves, on rank 0 of it."""

    blocks: list[list[set[tuple[int, ...]]]]  # per step and level
    region: list[list[int]]  # cells per step and level
    cycles: list[int]
    phi: np.ndarray  # at the probe points, after the last step
    largest: float
    charge: float


def run(comm: MPI.Comm, long: bool, *changes: str) -> Outcome:
    """Run the scene to its end without writing anything."""
    scene = Scene.from_toml(SCENE, ["solver.tolerance=1e-10", *([] if long else SMALLER), *changes])
    state, setup = begin(comm, scene)
    out = Outcome([], [], [], np.zeros(0), 0.0, 0.0)
    while True:
        levels = range(state.hierarchy.levels)
        out.blocks.append([blocks_of(state.hierarchy, level) for level in levels])
        out.region.append([state.hierarchy.cells(level) for level in levels])
        out.cycles.append(state.report.cycles)
        if state.step == scene.schedule.last_step:
            break
        state = advance(state, setup)
    out.phi, out.largest, out.charge = state.phi.sample(POINTS), state.phi.max_abs(), state.rho.integral()
    return out


def on_some(comm: MPI.Comm, ranks: int, long: bool) -> Outcome | None:
    """Run on the first ranks while the others wait; the outcome on rank 0."""
    part = comm.Split(color=0 if comm.rank < ranks else MPI.UNDEFINED)
    outcome = run(part, long) if part != MPI.COMM_NULL else None
    if part != MPI.COMM_NULL:
        part.Free()
    comm.Barrier()
    return outcome


@pytest.mark.mpi(ranks=(4,), timeout=240)
def test_one_to_four_ranks_give_the_same_mesh_cycles_potential_and_charge(comm, long):
    outcomes = [found for ranks in (1, 2, 3, 4) if (found := on_some(comm, ranks, long)) is not None]
    if comm.rank != 0:
        return
    alone = outcomes[0]
    assert len(outcomes) == 4
    assert len(set(map(tuple, alone.region))) > 1, "the mesh never followed the particles"
    for other in outcomes[1:]:
        assert other.blocks == alone.blocks
        assert other.cycles == alone.cycles
        assert np.abs(other.phi - alone.phi).max() <= 1e-8 * alone.largest
        assert other.charge == pytest.approx(alone.charge, rel=1e-13, abs=0)


@pytest.mark.mpi(ranks=(2,), timeout=240)
def test_boxes_of_16_24_and_32_cells_give_the_same_cycles_and_potential(comm, long):
    outcomes = [run(comm, long, f"refinement.max_grid_size={size}") for size in (16, 24, 32)]
    for other in outcomes[1:]:
        assert other.region == outcomes[0].region
        assert other.cycles == outcomes[0].cycles
        assert np.abs(other.phi - outcomes[0].phi).max() <= 1e-8 * outcomes[0].largest
        assert other.charge == pytest.approx(outcomes[0].charge, rel=1e-13, abs=0)
