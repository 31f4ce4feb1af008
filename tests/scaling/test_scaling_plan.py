"""Plans: virtual ranks send what real ones do, densities stand for particles, and the model is the formula that it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from amrpic.errors import InputError
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.parallel import VirtualRank, own
from amrpic.run.adapt import follow, make_base
from amrpic.run.initial_particles import make_particles
from amrpic.run.particle_fields import ParticleFields
from amrpic.run.plan import Plan as RunPlan
from amrpic.scaling.densities import clouds_of, particles_of_boxes, planned_mesh
from amrpic.scaling.machine import FOLDER, Machine, Network, Work
from amrpic.scaling.model import fitted, step_time, total
from amrpic.scaling.plan import Plan, Planner
from amrpic.scaling.virtual_ranks import Sent, chosen_ranks, counts, sample, without_open_walls
from amrpic.scene.scene import Scene
from amrpic.stages.migrate import migrate, particles_per_box

SCENE = {
    "domain": {"lower": "-20 mm", "upper": "20 mm", "cells": 48, "boundary": "open"},
    "bunches": [
        {"distribution": "gaussian", "species": "electron", "sigma": "2 mm", "charge": "-1 pC", "particles": 200_000,
         "centre": ["3 mm", "-4 mm", "1 mm"], "momentum_spread": 1e-24},
        {"distribution": "waterbag", "species": "electron", "sigma": "1 mm", "charge": "-1 pC", "particles": 100_000,
         "centre": ["-6 mm", "0 mm", "2 mm"], "momentum_spread": 1e-24},
    ],
    "refinement": {"levels": 2, "max_grid_size": 16, "rule": {"kind": "charge-density", "relative": 0.02}},
    "motion": {"kind": "leapfrog", "dt": "100 ps"},
    "particles": {"interface": "own-level"},
}  # fmt: skip


def scene() -> Scene:
    return Scene.from_dict(SCENE)


@pytest.mark.mpi(ranks=(2, 3, 4), timeout=240)
def test_virtual_ranks_send_what_real_ones_do(comm: MPI.Comm):
    made = scene()
    mesh = without_open_walls(planned_mesh(made, clouds_of(made))[0])
    boxes = [mesh.boxes(level) for level in range(1, mesh.levels)]
    some, each = sample(made, 10**9)
    assert each == 1.0
    real = counts(made, Hierarchy(comm, mesh.domain, boxes, 16, 8), some.select(slice(comm.rank, None, comm.size)), 1.0)
    first = Hierarchy(VirtualRank(0, comm.size), mesh.domain, boxes, 16, 8)
    virtual = counts(made, first.seen_by(comm.rank), some, each)
    for call in real:
        if call not in ("output", "set-up"):  # moments and set-up go through MPI in Python and Trilinos too
            assert virtual[call].traffic == real[call].traffic, call
    assert real["cycle"].traffic.messages > 0 and real["migrate"].traffic.bytes > 0


def test_mesh_and_particles_of_boxes_are_those_of_a_run():
    made, comm = scene(), own(MPI.COMM_SELF)
    mesh, notes = planned_mesh(made, clouds_of(made))
    plan = RunPlan(comm, made)
    base = make_base(plan)
    fields = follow(ParticleFields(migrate(make_particles(comm, made), base)[0], base, plan))
    assert notes == [] and mesh.levels == fields.hierarchy.levels == 3
    for level in range(3):
        # noise of the particles and their clouds move the edge by a cell at most, which a block of eight may follow
        assert mesh.cells(level) == pytest.approx(fields.hierarchy.cells(level), rel=0.15)
    planned = particles_of_boxes(clouds_of(made), mesh)
    real = particles_per_box(fields.particles, mesh)
    assert sum(p.sum() for p in planned) == pytest.approx(300_000, rel=1e-6)
    for expected, found in zip(planned, real, strict=True):
        assert np.abs(found - expected).max() < 6 * np.sqrt(expected.max())


def test_rules_that_need_fields_are_replaced_and_said():
    made = Scene.from_dict({**SCENE, "refinement": {"levels": 1, "rule": {"kind": "potential", "relative": 0.5}}})
    _, notes = planned_mesh(made, clouds_of(made))
    assert len(notes) == 1 and "asks for potential" in notes[0]


def machine(**network: float) -> Machine:
    constants = {"latency": 1e-6, "bandwidth": 1e9, "ranks_per_node": 4, "collective": 2e-6, **network}
    stages = {
        "solve": Work(call=1e-3, cell=1e-9, cycle=1e-8),
        "deposit": Work(particle=1e-8),
        "open walls": Work(wall=1e-9),
    }
    return Machine("test", "invented", Network(**constants), stages, {})  # type: ignore[arg-type]


def invented() -> Plan:
    from amrpic.parallel import Traffic

    sent = {call: Sent(Traffic(3, 4000, 2)) for call in ("migrate", "deposit", "solve", "cycle", "gather", "output")}
    ones = np.ones(8)
    cells = np.array([[100, 50] * 4, [0, 80] * 4])
    return Plan(8, cells, cells // 50, np.arange(8.0), 600, ones, ones, [0], [sent])


def test_the_model_is_its_formula():
    times = step_time(invented(), machine(), cycles=2)
    assert times["solve"].work == pytest.approx(1e-3 + 180 * (1e-9 + 2e-8))
    assert times["solve"].messages == pytest.approx(3 * (3e-6 + 4000 * 4 / 1e9))
    assert times["solve"].collectives == pytest.approx(3 * 2 * 3 * 2e-6)
    assert times["deposit"].work == pytest.approx(7e-8) and times["open walls"].total == pytest.approx(6e-7)
    shared = step_time(invented(), machine(), 2, balanced_particles=True, shared_walls=True)
    assert shared["deposit"].work == pytest.approx(3.5e-8) and shared["open walls"].total == pytest.approx(6e-7 / 8)
    assert total(step_time(invented(), machine().scaled("latency", 2), 2)) > total(times)


def test_constants_are_found_again_from_times():
    rng = np.random.default_rng(3)
    rows = np.column_stack([np.ones(9), rng.uniform(1e5, 1e7, 9), rng.uniform(1e4, 1e6, 9)])
    assert fitted(rows, rows @ [1e-3, 2e-9, 1e-8]) == pytest.approx([1e-3, 2e-9, 1e-8])


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_machines_are_read_and_written(path, tmp_path):
    made = Machine.read(path.stem)
    made.write(tmp_path / "again.toml")
    again = Machine.read(str(tmp_path / "again.toml"))
    assert again.source == made.source and again.network.latency == pytest.approx(made.network.latency, rel=1e-3)
    assert set(again.stages) == set(made.stages) >= {"solve", "deposit", "gather", "migrate", "open walls"}


def test_bad_machines_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"machine nowhere cannot be read .* give a TOML file, or one of aries"):
        Machine.read("nowhere")
    (tmp_path / "bad.toml").write_text("name = 3")
    with pytest.raises(InputError, match="describes no machine"):
        Machine.read(str(tmp_path / "bad.toml"))


def test_heavy_ranks_are_looked_at():
    loads = np.ones((2, 1000))
    loads[0, 17], loads[1, 801] = 5, 7
    chosen = chosen_ranks(loads, 10)
    assert {17, 801} <= set(chosen) and len(chosen) == 10 == len(set(chosen))
    assert chosen_ranks(loads, 1000) == list(range(1000))


def test_plans_of_all_ranks_hold_all_cells_and_particles():
    planner = Planner(scene())
    for plan in planner.plans([1, 5], looked_at=3):
        assert plan.cells.shape == (3, plan.ranks)
        assert plan.cells.sum(axis=1).tolist() == [planner.mesh.cells(level) for level in range(3)]
        assert plan.particles.sum() == pytest.approx(300_000, rel=1e-6)
        assert plan.wall_cells == 6 * 48**2
        assert plan.cell_imbalance >= 1 and plan.memory.max() > 100e6
        assert (plan.most("cycle", "messages") > 0) == (plan.ranks > 1)


def test_command_writes_plans(tmp_path):
    from amrpic.commands.main import parser

    file = Path(__file__).parents[2] / "examples" / "sphere.toml"
    arguments = ["scaling", str(file), "--plan", "4,64", "--machine", "aries", "--machine", "slingshot"]
    chosen = parser().parse_args([*arguments, "--set", "domain.cells=32", "--output", str(tmp_path)])
    assert chosen.command(chosen) == 0
    text = (tmp_path / "plan.md").read_text()
    assert "| 64 |" in text and "Modelled on slingshot" in text
    assert all((tmp_path / f"plan_{name}.png").stat().st_size > 1000 for name in ("aries", "slingshot"))
