"""The page on beam lines: its examples run and do what it says."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.external import ExternalFields
from amrpic.scene.elements import DipoleElement

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "elements.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def tables_of_elements() -> list[list[dict[str, Any]]]:
    """The elements of each example that gives some by itself, not by a lattice."""
    scenes = [tomllib.loads(text) for text in blocks("toml")]
    return [scene["elements"] for scene in scenes if "elements" in scene]


def test_examples_of_the_page_on_elements(tmp_path, monkeypatch):
    """The map is the quadrupole that it says; the undulator and the corrector act on the bunch of the FODO cells."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    writes, undulator, corrector = blocks("python")
    sector, coil = tables_of_elements()
    exec(writes, {})
    line = {"domain": {"lower": -0.1, "upper": 0.1, "cells": 8}, "elements": coil}
    _, B = ExternalFields.of_scene(amrpic.Scene.from_dict(line)).fields([[0.01, 0.004, 0.5]])
    assert B[0] == pytest.approx([5 * 0.004, 5 * 0.01, 0], rel=1e-12)
    names: dict[str, Any] = {}
    exec(undulator, names)
    wiggled = names["simulation"].state.moments().momentum
    exec(corrector, names)
    steered = names["simulation"].state.moments()
    p = steered.momentum
    assert p[0] / p[2] == pytest.approx(1e-3, rel=0.3)  # by the corrector, less what the lens behind it takes
    assert abs(wiggled[0] / wiggled[2]) > 1e-4 and abs(p[1] / p[2]) < 1e-5
    assert all(isinstance(DipoleElement.model_validate(one), DipoleElement) for one in sector)


def test_sector_of_the_page_turns_the_reference_particle_by_its_angle():
    [sector] = tables_of_elements()[0]
    half, angle, p = 0.34862 / 2, np.radians(5), 300.0
    start = np.array([0, 0, 0.5 - half]) - 0.2 * np.array([np.sin(angle), 0, np.cos(angle)])
    speed = 299792458 * p / np.hypot(p, 938.272)
    reference = {
        "position": start.tolist(),
        "momentum": [f"{p * np.sin(angle)} MeV/c", 0, f"{p * np.cos(angle)} MeV/c"],
    }
    bunch = {
        "distribution": "arrays",
        "species": "proton",
        "charge": 1e-25,
        "position": [[0, 0, 0]],
        "momenta": [[0, 0, 0]],
    }
    given = {
        "domain": {"lower": -0.5, "upper": 0.5, "cells": 8},
        "bunches": [bunch],
        "elements": [sector],
        "motion": {"kind": "leapfrog", "dt": 0.75 / speed / 200, "reference": reference},
        "schedule": {"steps": 200},
        "output": {"write": []},
    }
    run = amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict(given))
    run.run()
    end = run.reference
    assert end is not None
    assert np.degrees(np.arctan2(-end.momentum[0], end.momentum[2])) == pytest.approx(5, abs=0.002)
    on_axis = end.position[0] + (end.position[2] - 0.5 - half) * np.tan(angle)  # back at the exit
    assert on_axis == pytest.approx(0, abs=1e-5)


def test_the_page_on_elements_knows_all_kinds():
    kinds = amrpic.Scene.model_json_schema()["properties"]["elements"]["items"]["discriminator"]["mapping"]
    table = {name for row in PAGE.splitlines() if row.startswith("|") for name in re.findall("`([a-z-]+)`", row)}
    assert {*kinds} <= table
