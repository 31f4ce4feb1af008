"""The page on first steps: its beam line does what it says."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import amrpic

PAGE = (Path(__file__).parents[2] / "docs" / "quickstart.md").read_text()


def test_the_beam_line_of_the_page_loses_a_sixth_at_its_collimator(tmp_path: Path) -> None:
    [text] = [block for block in re.findall(r"^```toml[^\n]*\n(.*?)^```", PAGE, re.M | re.S) if "collimator" in block]
    given = tomllib.loads(text) | {"output": {"directory": str(tmp_path), "write": ["losses"]}}
    simulation = amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict(given))
    simulation.run()
    lost, seen = simulation.lost, simulation.screens
    at_collimator = np.array(lost.names)[lost.cause] == "collimator"
    assert at_collimator.sum() / 20_000 == pytest.approx(1 / 6, abs=0.02)
    assert np.all(np.abs(lost.particles.position[at_collimator, 2] - 0.1) < 0.0101)
    assert len(seen) == pytest.approx(20_000 - len(lost), abs=20)
    [remark] = simulation.remarks
    assert "outside the domain at the start" in remark
