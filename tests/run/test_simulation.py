"""The loop: conserved charge, the same run on one rank and on two, physics with known answers, stopping and going on."""

from __future__ import annotations

import os
import signal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from amrpic.io import openpmd_reader, time_series
from amrpic.io import openpmd_writer as dumps
from amrpic.parallel import Traffic, own, share
from amrpic.pic.simulation import Simulation
from amrpic.run.clock import Clock
from amrpic.scene import scene as model
from amrpic.stages.diagnostics import moments
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, VACUUM_PERMITTIVITY
from particle_cases import everywhere

QUIET: dict[str, Any] = {"write": []}
GAUSSIAN = {"distribution": "gaussian", "sigma": 0.01, "charge": 1e-11, "particles": 4000}
POINTS = np.random.default_rng(3).uniform(-0.09, 0.09, (200, 3))


def scene(**changes: Any) -> model.Scene:
    """A refined bunch that walks at random, sections replaced as given."""
    data: dict[str, Any] = {
        "domain": {"lower": -0.1, "upper": 0.1, "cells": 16, "boundary": "dirichlet"},
        "bunches": [GAUSSIAN],
        "refinement": {"levels": 2, "max_grid_size": 16, "regrid_every": 2, "blocking_factor": 4},
        "motion": {"kind": "random-walk", "amplitude": "3 mm"},
        "schedule": {"steps": 4},
        "output": QUIET,
    }
    return model.Scene.from_dict({**data, **changes})


def run(comm: Any, given: model.Scene) -> Simulation:
    simulation = Simulation(comm, given)
    assert simulation.run().stopped is None
    return simulation


def everything(simulation: Simulation) -> dict[str, np.ndarray]:
    """Particles and fields of this rank."""
    particles, efield = simulation.particles, simulation.efield
    fields = {"rho": simulation.rho, "phi": simulation.phi, "x": efield.x, "y": efield.y, "z": efield.z}
    levels = range(simulation.hierarchy.levels)
    return {
        "position": particles.position,
        "momentum": particles.momentum,
        "id": particles.id,
        **{name: np.concatenate([field.array(level) for level in levels]) for name, field in fields.items()},
    }


@pytest.mark.mpi(ranks=(1, 2))
def test_charge_is_conserved_through_moves_and_regrids(comm):
    simulation = Simulation(comm, scene())
    meshes = []

    def look(now: Simulation) -> None:
        meshes.append([now.hierarchy.boxes(level).tolist() for level in range(now.hierarchy.levels)])
        assert now.particles.global_count(comm) == 4000
        assert now.rho.integral() == pytest.approx(1e-11, rel=1e-13, abs=0)

    simulation.on_step(look)
    simulation.run()
    assert len(meshes) == 4
    assert meshes[0] != meshes[3]  # the mesh did follow


@pytest.mark.mpi(ranks=2)
def test_same_run_on_one_rank_and_on_two(comm):
    from mpi4py import MPI

    whole = {"levels": 2, "max_grid_size": 8, "regrid_every": 2, "blocking_factor": 4}  # of boxes that are never halved
    alone, together = run(MPI.COMM_SELF, scene(refinement=whole)), run(comm, scene(refinement=whole))
    for level in range(alone.hierarchy.levels):
        assert np.array_equal(alone.hierarchy.boxes(level), together.hierarchy.boxes(level))
    assert alone.report.cycles == together.report.cycles
    difference = together.phi.sample(POINTS) - alone.phi.sample(POINTS)
    assert np.abs(difference).max() < 1e-8 * alone.phi.max_abs()
    order = np.argsort(alone.particles.id)
    ids = np.concatenate(comm.allgather(together.particles.id))
    position = np.concatenate(comm.allgather(together.particles.position))
    assert np.array_equal(position[np.argsort(ids)], alone.particles.position[order])


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("solver", [{"tolerance": 1e-10}, {"tolerance": "discretization"}, {"backend": "kokkos"}])
@pytest.mark.parametrize("motion", [{"kind": "leapfrog", "dt": 2e-9}, {"kind": "random-walk", "amplitude": 3e-3}])
def test_restart_goes_on_bit_by_bit(comm, tmp_path, motion, solver):
    given = scene(motion=motion, schedule={"steps": 5}, solver=solver)
    simulation = Simulation(comm, given)
    simulation.on_step(lambda now: now.checkpoint(tmp_path / "half") if now.step == 3 else None)
    simulation.run()
    again = Simulation.restart(comm, tmp_path / "half")
    assert again.scene == simulation.scene
    changed = given.model_copy(update={"bunches": []})
    remarks = [set(Simulation.restart(comm, tmp_path / "half", s).remarks) for s in (given, changed)]
    assert [r for r in remarks[1] - remarks[0] if "go on as they are" in r] and not any(
        "go on" in r for r in remarks[0]
    )
    assert (again.step, again.time) == (3, pytest.approx(3 * motion.get("dt", 0)))
    again.run()
    assert again.particles.global_count(comm) > 3900
    for name, values in everything(simulation).items():
        assert np.array_equal(values, everything(again)[name]), name


@pytest.mark.mpi(ranks=(1, 2))
def test_momenta_are_those_of_the_time_of_positions_whenever_somebody_looks(comm, tmp_path):
    """In the midst of a run to rounding, in files in all digits; and a run goes on the same, whoever looks."""
    given = scene(
        motion={"kind": "leapfrog", "dt": 2e-9},
        schedule={"steps": 3},
        output={"directory": str(tmp_path / "out"), "write": ["series", "particles"], "particles_every": 1},
    )
    seen, undisturbed = [], run(comm, given)

    def look(now: Simulation) -> None:
        whole_kick = now.state.staggered.moved.momentum - now.state.particles.momentum
        early, synchronized = now.state.particles.momentum, now.particles.momentum
        kick = np.abs(whole_kick).max(initial=0)
        assert kick > 0 and np.abs(synchronized - early - whole_kick / 2).max(initial=0) <= 1e-12 * kick
        now.checkpoint(tmp_path / f"at_{now.step}")
        exact = Simulation.restart(comm, tmp_path / f"at_{now.step}").particles.momentum
        assert np.abs(exact - synchronized).max(initial=0) <= 1e-12 * kick
        now.write_particles(tmp_path / "particles.h5")
        for path in (tmp_path / "particles.h5", dumps.path_of(tmp_path / "out", now.step)):
            written = everywhere(comm, openpmd_reader.read(path, partial(share, comm)))
            assert np.abs(written["momentum"] - everywhere(comm, now.particles)["momentum"]).max() <= 1e-12 * kick
        seen.append(moments(comm, now.particles))

    watched = Simulation(comm, given.replace(output=given.output.replace(directory=str(tmp_path / "watched"))))
    watched.on_step(look)
    watched.run()
    for name, values in everything(undisturbed).items():
        assert np.array_equal(values, everything(watched)[name]), name
    if comm.rank == 0:
        rows = time_series.read(tmp_path / "out" / "series.csv")
        for column, measured in (
            ("kinetic_energy", [m.kinetic_energy for m in seen]),
            ("emittance_x", [m.emittance[0] for m in seen]),
            ("momentum_z", [m.momentum[2] for m in seen]),
        ):
            np.testing.assert_allclose(rows[column][1:], measured, rtol=1e-9)


def test_a_run_tells_that_all_particles_are_lost(comm, tmp_path, capsys):
    walk = {"kind": "random-walk", "amplitude": "10 m"}
    output = {"directory": str(tmp_path), "write": []}
    for motion, reported in ((walk, True), ({**walk, "amplitude": "1 mm"}, False)):
        run(comm, scene(motion=motion, schedule={"steps": 2}, output=output))
        assert ("all particles have left the domain" in capsys.readouterr().err) == reported


@pytest.mark.mpi(ranks=(1, 2))
def test_restart_tells_what_goes_on_otherwise(comm, tmp_path):
    given = scene(motion={"kind": "leapfrog", "dt": 2e-9}, schedule={"steps": 1})
    Simulation(comm, given).checkpoint(tmp_path / "start")
    longer = scene(motion={"kind": "leapfrog", "dt": 2e-9}, schedule={"steps": 7})
    other = scene(motion={"kind": "random-walk", "amplitude": 3e-3}, seed=5)
    reported = [Simulation.restart(comm, tmp_path / "start", s).remarks for s in (longer, other)]
    assert not any("goes on otherwise" in remark for remark in reported[0])
    (remark,) = [remark for remark in reported[1] if "goes on otherwise" in remark]
    assert "seed is 5, before" in remark and "motion.kind is random-walk, before leapfrog" in remark
    assert "motion.dt is not given, before 2e-09" in remark


@pytest.mark.mpi(ranks=2)
def test_restart_on_another_number_of_ranks(comm, tmp_path):
    from mpi4py import MPI

    given = scene(schedule={"steps": 4})
    whole = Simulation(comm, given)
    whole.on_step(lambda now: now.checkpoint(tmp_path / "half") if now.step == 3 else None)
    whole.run()
    alone = Simulation.restart(MPI.COMM_SELF, tmp_path / "half")
    alone.run()
    difference = whole.phi.sample(POINTS) - alone.phi.sample(POINTS)
    assert np.abs(difference).max() < 1e-8 * alone.phi.max_abs()


@pytest.mark.mpi(ranks=(1, 2))
def test_lost_particles_are_recorded_and_kept_in_checkpoints(comm, tmp_path):
    fast = {**GAUSSIAN, "sigma": 0.002, "particles": 50, "velocity": [1e6, 0, 0]}
    given = scene(
        bunches=[fast],
        motion={"kind": "leapfrog", "dt": 4e-8},
        schedule={"steps": 4},
        refinement={"levels": 0},
    )
    simulation = run(comm, given)
    assert simulation.particles.global_count(comm) == 0
    assert simulation.lost.particles.global_count(comm) == 50
    assert simulation.lost.particles.total_charge(comm) == pytest.approx(1e-11, rel=1e-12, abs=0)
    assert np.all((simulation.lost.time > 8e-8) & (simulation.lost.time < 1.2e-7))
    assert np.all(simulation.lost.particles.position[:, 0] == 0.1)
    assert all(simulation.lost.names[cause] == "x_upper" for cause in simulation.lost.cause)
    simulation.checkpoint(tmp_path / "end")
    again = Simulation.restart(comm, tmp_path / "end")
    assert np.array_equal(again.lost.particles.id, simulation.lost.particles.id)


EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.mpi(ranks=2)
def test_sphere_has_the_potential_and_field_of_a_uniform_sphere(comm):
    simulation = Simulation(comm, model.Scene.from_toml(EXAMPLES / "sphere.toml", ["output.write=[]"]))
    radius = 0.005
    around = radius * np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [0.6, 0.8, 0], [0, -0.6, 0.8]])
    assert simulation.phi.sample(np.zeros((1, 3)))[0] == pytest.approx(75, rel=0.005)
    assert simulation.phi.sample(around) == pytest.approx(50, rel=0.005)
    outward = np.einsum("ij,ij->i", simulation.efield.sample(1.5 * around), around / radius)
    assert outward == pytest.approx(1e4 / 1.5**2, rel=0.01)


def plasma(density: float, amplitude: float, per_axis: int, dt: float, steps: int) -> model.Scene:
    """Cold electrons in a periodic cube of 1 cm, displaced by a sine along x."""
    return scene(
        domain={"lower": 0, "upper": 0.01, "cells": 16, "boundary": "periodic"},
        background="neutralizing",
        bunches=[
            {
                "distribution": "lattice",
                "species": "electron",
                "per_axis": per_axis,
                "displacement": [amplitude, 0, 0],
                "charge": -density * 1e-6 * ELEMENTARY_CHARGE,
            }
        ],
        refinement={"levels": 0},
        motion={"kind": "leapfrog", "dt": dt},
        schedule={"steps": steps},
    )


def crossings(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Times at which a curve passes through zero."""
    at = np.flatnonzero(values[:-1] * values[1:] < 0)
    return time[at] - values[at] * (time[at + 1] - time[at]) / (values[at + 1] - values[at])


@pytest.mark.mpi(ranks=(1, 2))
def test_cold_plasma_oscillates_with_its_plasma_period(comm):
    density = 1e14
    period = 2 * np.pi / np.sqrt(density * ELEMENTARY_CHARGE**2 / (VACUUM_PERMITTIVITY * ELECTRON_MASS))
    simulation = Simulation(comm, plasma(density, amplitude=2e-4, per_axis=32, dt=period / 40, steps=80))
    probe = np.array([[0.0025, 0.005, 0.005]])
    seen: list[tuple[float, float]] = []
    simulation.on_step(lambda now: seen.append((now.time, float(now.efield.sample(probe)[0, 0]))))
    simulation.run()
    time, values = np.array(seen).T
    half = np.diff(crossings(time, values))
    # Measured: 1.6 % longer, because clouds and differences of one cell soften the force at 16 cells to a wave.
    assert 2 * half.mean() == pytest.approx(1.016 * period, rel=0.005)
    assert np.abs(values[-40:]).max() == pytest.approx(np.abs(values[:40]).max(), rel=0.02)


@pytest.mark.mpi(ranks=(1, 2))
def test_expanding_bunch_turns_field_energy_into_motion(comm):
    given = scene(
        domain={"lower": -0.02, "upper": 0.02, "cells": 32, "boundary": "dirichlet"},
        bunches=[
            {"distribution": "sphere", "species": "electron", "radius": 0.004, "charge": -1e-11, "particles": 20000}
        ],
        refinement={"levels": 0},
        motion={"kind": "leapfrog", "dt": 1e-10},
        schedule={"steps": 20},
    )
    simulation = Simulation(comm, given)

    def energies() -> tuple[float, float]:
        from amrpic.stages.diagnostics import moments, potential_energy

        return moments(comm, simulation.particles).kinetic_energy, potential_energy(simulation.rho, simulation.phi)

    kinetic, potential = energies()
    assert kinetic == 0
    total = potential
    simulation.run()
    kinetic, potential = energies()
    assert kinetic > 0.3 * total
    # Measured: 1.4 % less at the end with any time step, the price of a gather that conserves momentum.
    assert kinetic + potential == pytest.approx(total, rel=0.02)


@pytest.mark.mpi(ranks=2)
@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGINT, signal.SIGHUP])
def test_signal_stops_with_a_checkpoint_and_the_run_goes_on_from_it(comm, tmp_path, number):
    output = {"directory": str(tmp_path / "out"), "write": ["checkpoint", "series"], "checkpoint_every": 0}
    given = scene(schedule={"steps": 4}, output=output)
    simulation = Simulation(comm, given)

    def warn_one_rank(now: Simulation) -> None:
        if now.step == 2 and comm.rank == 1:
            os.kill(os.getpid(), number)

    simulation.on_step(warn_one_rank)
    assert simulation.run().stopped == f"signal {signal.Signals(number).name}"
    assert simulation.step == 2
    again = Simulation.restart(comm, tmp_path / "out" / "checkpoint_00000002")
    assert again.run().stopped is None
    undisturbed = run(comm, scene(schedule={"steps": 4}))
    for name, values in everything(undisturbed).items():
        assert np.array_equal(values, everything(again)[name]), name
    if comm.rank == 0:
        table = time_series.read(tmp_path / "out" / "series.csv")
        assert table["step"].tolist() == [0, 1, 2, 3, 4]
        history = time_series.read(tmp_path / "out" / "residuals.csv")
        for step, cycles, residual in zip(table["step"], table["cycles"], table["residual"], strict=True):
            solve = history[history["step"] == step]
            assert solve["cycle"].tolist() == list(range(int(cycles) + 1))
            assert solve["residual"][-1] == residual


@pytest.mark.mpi(ranks=1)
def test_run_stops_before_its_time_is_over(comm, tmp_path):
    output = {"directory": str(tmp_path / "out"), "write": ["checkpoint"]}
    simulation = Simulation(comm, scene(schedule={"steps": 1000}, output=output))
    assert simulation.run(walltime=0.0).stopped == "the time given is nearly over"
    assert (tmp_path / "out" / "checkpoint_00000000").is_dir()


@pytest.mark.mpi(ranks=2)
def test_outputs_are_those_that_the_scene_wants(comm, tmp_path):
    def written(*kinds: str) -> set[str]:
        folder = tmp_path / "-".join(("out", *kinds))
        output = {"directory": str(folder), "write": list(kinds), "fields_every": 2, "checkpoint_every": 1, "keep": 2}
        run(comm, scene(schedule={"steps": 2}, output=output, refinement={"levels": 0}))
        comm.Barrier()
        return {path.name for path in Path(folder).glob("[!.]*")} - {"status.json"}

    assert written() == set()
    assert written("series") == {
        f"{table}.{kind}" for table in ("series", "residuals", "beam") for kind in ("csv", "json")
    }
    assert written("checkpoint") == {"checkpoint_00000001", "checkpoint_00000002"}
    of_fields = {"fields_00000000.vtkhdf", "fields_00000002.vtkhdf", "fields.vtkhdf.series", "openpmd"}
    assert written("fields") == of_fields
    assert {name.rpartition(".")[2] for name in written("pictures")} == {"png"}


@pytest.mark.mpi(ranks=(1, 2))
def test_static_boxes_stay(comm):
    boxes = [
        {"level": 1, "first": 8, "last": 23},
        {"level": 2, "lower": [-0.02, -0.02, -0.02], "upper": [0.02, 0.02, 0.02]},
    ]
    simulation = run(
        comm,
        scene(
            refinement={
                "levels": 2,
                "blocking_factor": 4,
                "max_grid_size": 16,
                "rule": {"kind": "static", "boxes": boxes},
            }
        ),
    )
    assert simulation.hierarchy.levels == 3
    assert simulation.hierarchy.cells(1) == 16**3
    assert simulation.hierarchy.boxes(2)[:, :3].min(axis=0).tolist() == [24, 24, 24]


@pytest.mark.mpi(ranks=2)
def test_field_strength_refines_where_the_field_is(comm):
    rule = {"kind": "field-strength", "relative": 0.5}
    simulation = run(comm, scene(refinement={"levels": 1, "blocking_factor": 4, "max_grid_size": 16, "rule": rule}))
    assert simulation.hierarchy.levels == 2
    assert 0 < simulation.hierarchy.cells(1) < 8 * 16**3


def test_seconds_of_a_stage_within_another_count_once():
    moments = iter([0.0, 1.0, 3.0, 10.0, 14.0, 20.0])  # outer, inner, its end, inner again, its end, the end of outer
    clock = Clock(lambda: next(moments))
    with clock("outer"):
        with clock("inner"):
            pass
        with clock("inner"):
            pass
    spent = clock.take()
    assert (spent["inner"].seconds, spent["outer"].seconds) == (6.0, 14.0)
    assert clock.take() == {}


@pytest.mark.mpi(ranks=2)
def test_stages_count_what_passes_between_ranks(comm):
    clock, mine = Clock(), own(comm)
    with clock("outer"):
        mine.allreduce(1)
        with clock("inner"):
            mine.allreduce(1), mine.bcast(1)
    spent = clock.take()
    assert spent["outer"].traffic == Traffic(collectives=1)
    assert spent["inner"].traffic == Traffic(collectives=2)
    spent = run(comm, scene()).state.spent
    assert spent["deposit"].traffic.messages > 0 and spent["deposit"].traffic.bytes > 0
    assert spent["solve"].traffic.messages > spent["deposit"].traffic.messages
    assert spent["solve"].traffic.collectives > 0
