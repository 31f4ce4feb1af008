"""A preview tells of the mesh and the particles what the run finds, without a solve."""

from __future__ import annotations

import re

import numpy as np
import pytest

from amrpic import Leapfrog, PoissonSolver, Scene, Simulation, SphereBunch
from amrpic.commands.preview import preview, statistics

TRAIN = {
    "distribution": "gaussian",
    "count": 2,
    "spacing": [0.8, 0, 0],
    "sigma": [0.06, 0.09, 0.12],
    "charge": "1 nC",
    "particles": 4000,
}
DENSE = {
    "distribution": "sphere",
    "radius": 0.1,
    "charge": "2 nC",
    "particles": 3000,
    "centre": [0, 0.5, 0],
    "name": "ball",
}


def scene(tmp_path, **rule):
    return Scene.from_dict(
        {
            "domain": {"lower": -1, "upper": 1, "cells": 16},
            "bunches": [TRAIN, DENSE],
            "refinement": {"levels": 2, "rule": rule or {"kind": "charge-density", "relative": 1e-3}},
            "schedule": {"steps": 0},
            "output": {"directory": str(tmp_path), "write": []},
        }
    )


def rows(text: str) -> list[list[str]]:
    """The cells of the table lines, which are two blanks apart."""
    return [re.split(r"  +", line.strip()) for line in text.splitlines() if "  " in line]


@pytest.mark.mpi(ranks=(1, 2), timeout=120)
def test_levels_and_particles_are_those_that_the_run_begins_with(comm, tmp_path):
    text = preview(comm, scene(tmp_path), 4)
    run = Simulation(comm, scene(tmp_path))
    hierarchy = run.hierarchy
    places = np.concatenate(comm.allgather(np.ascontiguousarray(run.particles.position)))
    reported = {int(row[0]): row[1:] for row in rows(text) if re.fullmatch(r"\d+", row[0]) and len(row) == 8}
    assert sorted(reported) == list(range(hierarchy.levels)) == [0, 1, 2]
    taken = np.zeros(len(places), dtype=bool)
    for level in reversed(range(hierarchy.levels)):  # each particle lives on the finest level around it
        boxes = hierarchy.boxes(level)
        cells = np.floor((places + 1) / hierarchy.spacing(level)).astype(int)
        here = np.any([np.all((box[:3] <= cells) & (cells <= box[3:]), axis=1) for box in boxes], axis=0) & ~taken
        taken |= here
        held = np.unique(cells[here], axis=0, return_counts=True)[1]
        middle, most = (np.sort(held)[(held.size - 1) // 2], held.max()) if held.size else (0, 0)
        expected = [len(boxes), hierarchy.cells(level), held.sum(), middle, most]
        row = reported[level]
        assert [int(row[k]) for k in (0, 1, 3, 5, 6)] == expected
        assert float(row[4]) == pytest.approx(held.mean() if held.size else 0, rel=5e-3)
        assert float(row[2].split()[0]) == pytest.approx(1e3 * hierarchy.spacing(level)[0], rel=1e-3)


def test_bunches_are_reported_with_their_size_in_cells(comm, tmp_path):
    train, ball = (row for row in rows(preview(comm, scene(tmp_path), 1)) if row[0] in ("0 gaussian", "1 ball"))
    assert train[1:4] == ["2", "4000", "1 nC"] and ball[1:4] == ["1", "3000", "2 nC"]
    sizes = [float(value.split()[0]) / 1e3 for value in train[4].split(", ")]
    assert sizes == pytest.approx(TRAIN["sigma"], rel=0.05)  # the noise of 8000 particles is a hundredth
    assert [float(value) for value in train[5:]] == pytest.approx(
        [sizes[0] * 8 * 2**level for level in range(3)], rel=0.05
    )
    assert [float(value.split()[0]) for value in ball[4].split(", ")] == pytest.approx([100 / 5**0.5] * 3, rel=0.05)


@pytest.mark.parametrize("kind", ["potential", "field-strength"])
def test_rules_that_need_the_field_are_replaced_and_that_is_said(comm, tmp_path, monkeypatch, kind):
    def refuse(*_, **__):
        raise AssertionError("a preview solves nothing")

    monkeypatch.setattr(PoissonSolver, "solve", refuse)
    dense = {"kind": "charge-density", "relative": 0.5}
    text = preview(comm, scene(tmp_path, kind="any", of=[dense, {"kind": kind, "relative": 0.2}]), 1)
    assert f"note: refinement.rule asks for the field ({kind}), which a preview does not solve for" in text
    same = preview(comm, scene(tmp_path), 1)
    assert [row[1:] for row in rows(text)][:4] == [row[1:] for row in rows(same)][:4]
    for axis in "xyz":
        assert (tmp_path / f"preview_rho_along_{axis}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.mpi(ranks=(1, 3))
def test_statistics_are_those_of_the_numbers_of_all_ranks(comm):
    for size in (0, 1, 10, 1001):
        numbers = np.random.default_rng(size).integers(1, 30, size)
        total, mean, median, most = statistics(comm, np.array_split(numbers, comm.size)[comm.rank])
        assert total == numbers.sum()
        if size:
            assert mean == pytest.approx(numbers.mean())
            assert median == np.sort(numbers)[(size - 1) // 2]
            assert most == numbers.max()


GOOD = {"distribution": "gaussian", "species": "electron", "sigma": 0.15, "charge": "-1 nC", "particles": 60_000}


@pytest.mark.mpi(ranks=(2,), timeout=120)
@pytest.mark.parametrize(
    ("changed", "dt", "warned"),
    [
        ({}, "10 ps", None),
        (
            {"sigma": [0.15, 0.06, 0.15]},
            "10 ps",
            r"bunches\.0 has 0\.9\d* cells of the finest level per rms size along y, where 2 are",
        ),
        (
            {"particles": 600},
            "10 ps",
            r"cells of level 1 that hold particles hold 1\.\d+ of them in the mean, where 3 are",
        ),
        ({"centre": [0, 0, 0.7]}, "10 ps", r"bunches\.0 has its centre 2 rms sizes from the face z_upper, where 4 are"),
        ({"velocity": [0.05, 0, 0]}, "10 ps", None),
        ({}, "1 us", r"motion\.dt of 1e-06 s is long: .* steps per plasma period"),
    ],
)
def test_what_spoils_results_is_warned_of(comm, tmp_path, changed, dt, warned):
    given = scene(tmp_path).to_dict()
    given |= {"bunches": [{**GOOD, **changed}], "motion": {"kind": "leapfrog", "dt": dt}, "schedule": {"steps": 1}}
    given["refinement"] = {"levels": 1}
    given["domain"]["cells"] = [16, 16, 16]
    notes = [line for line in preview(comm, Scene.from_dict(given), 1).splitlines() if line.startswith("note: ")]
    found = [line for line in notes if "particles.interface" not in line and "lie outside the domain" not in line]
    assert len(found) == (0 if warned is None else 1) and re.search(warned or "", "".join(found)), found


def test_a_bunch_that_ends_before_a_near_wall_is_well(comm, tmp_path):
    ball = {**DENSE, "particles": 20_000, "radius": 0.3, "centre": [0, 0, 0.5]}
    text = preview(comm, scene(tmp_path).replace(bunches=[SphereBunch(**ball_of(ball))]), 1)
    assert "rms sizes from the face" not in text
    beside = {**ball, "centre": [0, 0, 0.65]}
    text = preview(comm, scene(tmp_path).replace(bunches=[SphereBunch(**ball_of(beside))]), 1)
    assert "bunches.0 has its centre 2.6 rms sizes from the face z_upper" in text


def test_a_bunch_beside_a_cathode_is_well(comm, tmp_path):
    given = scene(tmp_path).to_dict()
    given["bunches"] = [{**DENSE, "particles": 20_000, "centre": [0, 0, -0.85]}]
    given["domain"]["boundary"] = {"z": ["dirichlet", "open"]}
    assert "rms sizes from the face" not in preview(comm, Scene.from_dict(given), 1)


def ball_of(given):
    return {key: value for key, value in given.items() if key != "distribution"}


@pytest.mark.mpi(ranks=(1, 2))
def test_the_time_of_a_run_is_part_of_the_preview(comm, tmp_path):
    moving = scene(tmp_path).replace(motion=Leapfrog(dt="1 ps"), schedule={"steps": 3})
    [line] = [line for line in preview(comm, moving, 8, 100.0).splitlines() if line.startswith("time: ")]
    time = r"[\d.e-]+ \S*s"
    assert re.match(
        rf"time: {time} to the end of the first solve, then {time} per step, {time} for all; from 3 steps", line
    )
    assert f"from 3 steps of it, if 8 ranks share the work of {comm.size} evenly; files" in line


def test_a_trial_that_fails_says_why(comm, tmp_path):
    given = scene(tmp_path).to_dict()
    given["solver"] = {"tolerance": 1e-10, "max_cycles": 1}
    assert "time: a trial of the run ended with: residual " in preview(comm, Scene.from_dict(given), 1, 100.0)
