"""Beams of nothing, of one particle, without size, without motion, or lost on the way: each runs to its end and restarts."""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import InputError
from amrpic.io import time_series
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT

MC = ELECTRON_MASS * SPEED_OF_LIGHT
STEPS, HALF = 4, 2
WRITE = ["checkpoint", "fields", "particles", "series", "losses"]

BUNCH = {
    "distribution": "gaussian",
    "species": "electron",
    "sigma": "2 mm",
    "charge": "-1 pC",
    "particles": 60,
    "momentum": [0, 0, 0.3 * MC],
    "momentum_spread": 0.01 * MC,
    "centre": [0, 0, "-8 mm"],
}
LINE = [
    {"kind": "quadrupole", "length": "4 mm", "gradient": "0.3 T/m"},
    {"kind": "solenoid", "centre": [0, 0, "6 mm"], "length": "5 mm", "field": "2 mT"},
]
PIPE = {"kind": "round", "name": "pipe", "radius": "18 mm"}
STOPPER = {"kind": "round", "name": "stopper", "centre": [0, 0, "2 mm"], "length": "1 mm", "radius": 1e-7}


def arrays(position: Any, momenta: Any, **more: Any) -> dict[str, Any]:
    """A bunch of electrons given one by one; momenta over m c."""
    u = np.array(momenta, float).reshape(-1, 3) * MC
    x = np.array(position, float).reshape(-1, 3)
    return {
        "distribution": "arrays", "species": "electron", "position": x.tolist(), "momenta": u.tolist(), "charge": -1e-15
    } | more  # fmt: skip


def bunch(**changes: Any) -> list[dict[str, Any]]:
    return [{**BUNCH, **changes}]


ONE = arrays([0, 0, -0.01], [0, 0, 0.3])
ROW = arrays([[1e-3, 0, z] for z in np.linspace(-0.015, 0.0, 5)], [[0, 0, 0.3]] * 5)
PERIODIC = {"boundary": {"x": "dirichlet", "y": "dirichlet", "z": "periodic"}}
RF = {"kind": "rf-gap", "length": "1 cm", "voltage": "10 kV", "frequency": "1 GHz"}
MIRROR = {"kind": "uniform", "centre": [0, 0, "5 mm"], "length": "1 cm", "electric_field": [0, 0, "5 MV/m"]}
FOLLOW = {"window": "reference"}
STATIC = {"kind": "none"}

CASES: dict[str, dict[str, Any]] = {
    "no bunch": {"bunches": []},
    "no particle": {"bunches": bunch(particles=0)},
    "no particle, the window follows": {"bunches": bunch(particles=0), "motion": FOLLOW},
    "one particle": {"bunches": [ONE]},
    "one particle at rest": {"bunches": [arrays([0, 0, 0], [0, 0, 0])]},
    "one particle in a window": {"bunches": [ONE], "motion": {"window": "reference", "reference": {
        "species": "electron", "momentum": [0, 0, 0.3 * MC], "position": [0, 0, -0.01]}}},
    "one particle in a periodic pipe": {"bunches": [ONE], "domain": PERIODIC},
    "one particle on a face": {"bunches": [arrays([-0.02, -0.02, -0.02], [0, 0, 0.3])]},
    "all lost at once": {"bunches": bunch(), "apertures": [{**PIPE, "name": "closed", "radius": 1e-9}]},
    "all lost in a window": {"bunches": bunch(), "apertures": [STOPPER], "motion": FOLLOW},
    "lost one by one": {"bunches": [ROW], "apertures": [STOPPER]},
    "all lost at the face": {"bunches": bunch(centre=[0, 0, "18 mm"], momentum=[0, 0, 3 * MC])},
    "a point": {"bunches": bunch(sigma=0, momentum_spread=0)},
    "a line": {"bunches": bunch(sigma=[0, 0, "2 mm"])},
    "a disk": {"bunches": bunch(sigma=["2 mm", "2 mm", 0])},
    "a sheet": {"bunches": bunch(sigma=[0, "2 mm", "2 mm"])},
    "no emittance": {"bunches": bunch(momentum_spread=0)},
    "hardly any charge": {"bunches": bunch(charge=-1e-300)},
    "neutral": {"bunches": [{**ROW, "charge": None, "weight": [1.0] * 5, "species": {"charge": 0, "mass": ELECTRON_MASS}}]},
    "one particle off all axes": {"bunches": [arrays([0, 0, 0], [0.3, 0.2, 0.4])]},
    "electrons and positrons": {"bunches": [*bunch(), *bunch(species="positron", charge="1 pC")]},
    "species that fly against each other": {"bunches": [
        *bunch(), *bunch(species="proton", charge="1 pC", momentum=[0, 0, -0.3 * MC], centre=[0, 0, "8 mm"])]},
    "two species, one without particles": {"bunches": [*bunch(), *bunch(species="proton", charge="1 pC", particles=0)]},
    "at rest in a cavity": {"bunches": bunch(momentum=0, momentum_spread=0, centre=0), "elements": [RF]},
    "turned round": {"bunches": bunch(momentum_spread=[0, 0, 0.001 * MC]), "elements": [MIRROR]},
    "turned round in its window": {"bunches": bunch(momentum_spread=[0, 0, 0.001 * MC]), "elements": [MIRROR],
        "motion": FOLLOW},
    "a window beyond the lattice": {"bunches": bunch(momentum=[0, 0, 20 * MC]), "motion": {**FOLLOW, "dt": "1 us"}},
    "steps across the whole domain": {"bunches": bunch(), "domain": PERIODIC, "motion": {"dt": "0.1 us"}},
    "no motion": {"bunches": bunch(), "motion": STATIC},
    "a single plane of cells": {"bunches": bunch(), "domain": {"cells": [2, 2, 2]}},
}  # fmt: skip


def scene(folder: Path, case: str, **output: Any) -> amrpic.Scene:
    changes = CASES[case]
    motion = {"kind": "leapfrog", "dt": "35 ps"} | changes.get("motion", {})
    return amrpic.Scene.from_dict(
        {
            "elements": LINE,
            "apertures": [PIPE],
            "screens": [{"name": "middle", "z": 0}, {"name": "edge", "z": 0.02}],
            "refinement": {"levels": 1, "regrid_every": 2},
            "schedule": {"steps": STEPS},
            "diagnostics": {"every": 1, "slices": 3},
            **changes,
            "domain": {"lower": -0.02, "upper": 0.02, "cells": 8, **changes.get("domain", {})},
            "motion": {"kind": "none"} if motion["kind"] == "none" else motion,
            "output": {"directory": str(folder), "write": WRITE, "checkpoint_every": HALF, **output},
        }
    )


def ended(comm: Any, simulation: amrpic.Simulation) -> str:
    """What a run prints as warnings; Python's own are errors, except those that the log takes."""
    said = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("error")
        simulation.run()
    comm.barrier()
    return said.getvalue()


# Shared out over ranks of which some have no particles; the other cases only in the long form.
SHARED_OUT = (
    "no bunch",
    "no particle, the window follows",
    "one particle",
    "one particle in a periodic pipe",
    "all lost in a window",
    "lost one by one",
    "a point",
    "species that fly against each other",
    "turned round in its window",
    "steps across the whole domain",
    "a single plane of cells",
)


@pytest.mark.mpi(ranks=1)
@pytest.mark.parametrize("case", CASES)
def test_degenerate_beams_run_to_their_end_and_again_from_the_middle(comm, tmp_path, case):
    run_and_restart(comm, tmp_path, case)


@pytest.mark.mpi(ranks=3)
@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[] if case in SHARED_OUT else [pytest.mark.long]) for case in CASES]
)
def test_degenerate_beams_do_so_on_ranks_without_particles(comm, tmp_path, case):
    run_and_restart(comm, tmp_path, case)


def run_and_restart(comm: MPI.Comm, tmp_path: Path, case: str) -> None:
    with np.errstate(all="raise", under="ignore"):
        given = scene(tmp_path / "whole", case)
        whole = amrpic.Simulation(comm, given)
        made = whole.particles.global_count(comm) + comm.allreduce(len(whole.lost))
        said = ended(comm, whole)
        again = amrpic.Simulation.restart(comm, tmp_path / "whole/checkpoint_00000002", scene(tmp_path / "again", case))
        ended(comm, again)
    lines = said.splitlines()
    assert len(lines) <= 6 and len({line.partition("times in all")[2] or line for line in lines}) == len(lines), said
    assert not any("nan" in line for line in lines), said
    left, lost = whole.particles.global_count(comm), comm.allreduce(len(whole.lost))
    assert left + lost == made == given.particle_count()
    assert whole.step == again.step == STEPS
    for one, other in zip(whole.particles.arrays, again.particles.arrays, strict=True):
        assert np.array_equal(one, other)
        assert np.isfinite(one).all()
    assert np.array_equal(whole.phi.array(0), again.phi.array(0), equal_nan=True)
    if comm.rank == 0:
        _tables_hold(tmp_path, left, lost)


def _tables_hold(folder: Path, left: int, lost: int) -> None:
    """Series are finite but for s and what is of no particle; the beam's are nan there, and the restart's rows are the same."""
    series = time_series.read(folder / "whole/series.csv")
    some = series["particles"] > 0
    for name in series.dtype.names or ():
        of_particles = name.startswith(("mean_", "rms_", "emittance_"))
        assert name == "s" or np.isfinite(series[name][some] if of_particles else series[name]).all(), name
        assert not of_particles or np.isnan(series[name][~some]).all(), name
    assert series["particles"][-1] == left and series["lost_particles"][-1] == lost
    path = folder / "whole/beam.csv"
    if not path.exists():
        return
    beam = time_series.read(path)
    last = beam[(beam["step"] == STEPS) & (beam["group"] == "all")]
    assert last["particles"] == left and last["lost_particles"] == lost
    for name in beam.dtype.names or ():
        if name not in ("group", "s"):
            assert not np.isinf(beam[name]).any(), name
    if left == 0:
        assert np.isnan(last["mean_x"]) and np.isnan(last["emittance_x"]) and np.isnan(last["mean_energy"])
    if left == 1:
        assert last["rms_x"] == 0 and np.isnan(last["beta_x"])
    for name in ("beam.csv", "slices.csv"):
        rows, more = (
            [line for line in (folder / run / name).read_text().splitlines() if line[:1].isdigit()]
            for run in ("whole", "again")
        )
        after = [line for line in rows if int(line.split(",")[0]) > HALF]
        assert more[-len(after) :] == after


SIDE = {"kind": "rectangular", "centre": ["5 mm", 0, "4 mm"], "length": "1 mm", "half_widths": ["5 mm", "18 mm"]}


def scraped(folder: Path, few: int, sideways: float) -> amrpic.Scene:
    """40 electrons that meet a solid, and a few that pass its hole and fly off the axis."""
    places = [[-5e-3, 0, 0]] * 40 + [[2e-3, 0, 0]] * few
    momenta = [[0, 0, 0.3]] * 40 + [[sideways, 0, 0.3]] * few
    CASES["scraped"] = {"bunches": [arrays(places, momenta)], "apertures": [SIDE], "elements": []}
    return scene(folder, "scraped")


@pytest.mark.mpi(ranks=(1, 3))
def test_the_last_few_particles_go_on_in_the_frame_of_the_beam(comm, tmp_path):
    given = scraped(tmp_path / "whole", 2, 0.15)
    whole = amrpic.Simulation(comm, given)
    first = whole.state.solution.frames.only
    said = ended(comm, whole)
    last = whole.state.solution.frames.only
    assert whole.particles.global_count(comm) == 2 and first is not None and last is not None
    assert [first.momentum, last.momentum] == pytest.approx([0.3, 0.3], rel=1e-3)
    assert comm.rank > 0 or said.count("fits no frame") == 1
    again = amrpic.Simulation.restart(
        comm, tmp_path / "whole/checkpoint_00000002", scraped(tmp_path / "again", 2, 0.15)
    )
    again.run()
    assert again.state.solution.frames.only == whole.state.solution.frames.only
    for one, other in zip(whole.particles.arrays, again.particles.arrays, strict=True):
        assert np.array_equal(one, other)


def test_a_fifth_of_a_beam_that_turns_is_refused(comm, tmp_path):
    simulation = amrpic.Simulation(comm, scraped(tmp_path, 10, 0.1))
    with pytest.raises(InputError, match=r"lies 0\.333 rad off the z axis"):
        simulation.run()
