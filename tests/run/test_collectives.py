"""What ranks do together in a step: few collectives, all small, and none in which each rank speaks to each."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import mpi_batch

SUPPORT = Path(__file__).parents[1] / "support"
KILOBYTE = 1024
MOST = 20  # in a step, besides those of cycles
PER_CYCLE = 2
STEPS = 4
SCENE: dict[str, Any] = {
    "domain": {"lower": -0.02, "upper": 0.02, "cells": 24, "boundary": "dirichlet"},
    "bunches": [
        {
            "distribution": "gaussian", "species": "electron", "sigma": "2 mm", "charge": "-1 pC", "particles": 4000,
            "count": 4, "spacing": [0, 0, "6 mm"],
        }
    ],
    "refinement": {"levels": 2, "regrid_every": 0},
    "motion": {"kind": "leapfrog", "dt": "20 ps"},
    "schedule": {"steps": STEPS},
    "diagnostics": {"every": 1},
    "output": {"write": ["series"]},
}  # fmt: skip

# Counts the calls between the ends of the records of two steps, for each step but the first.
COUNTED = """
import ctypes, json, sys
from mpi4py import MPI
import amrpic
from amrpic.parallel import traffic
from amrpic.run.recorder import Recorder

class Counts(ctypes.Structure):
    _fields_ = [(name, ctypes.c_long) for name in ("calls", "all_to_all", "pickled", "most_bytes")]

library = ctypes.CDLL(None)
library.collectives_begin.restype = ctypes.POINTER(Counts)
steps, before = [], None

def state(self, state, record=Recorder.state):
    global before
    record(self, state)
    if before is not None:
        counts, ours = before
        found = {name: getattr(counts.contents, name) for name, _ in Counts._fields_}
        steps.append({**found, "cycles": state.report.cycles, "ours": (traffic() - ours).collectives})
    before = library.collectives_begin(), traffic()

Recorder.state = state
scene = amrpic.Scene.from_dict(json.loads(sys.argv[1]))
amrpic.Simulation(MPI.COMM_WORLD, scene).run()
gathered = MPI.COMM_WORLD.gather(steps)
if gathered:
    print("counted", json.dumps(gathered))
"""


@pytest.fixture(scope="module")
def counter(tmp_path_factory) -> Path:
    library = tmp_path_factory.mktemp("counter") / "collectives.so"
    subprocess.run(["mpicc", "-shared", "-fPIC", "-O1", "-o", str(library), str(SUPPORT / "collectives.c")], check=True)
    return library


def counted(counter: Path, folder: Path, ranks: int, **changes: object) -> list[list[dict[str, int]]]:
    """Return what each rank counted in each step."""
    scene = {**SCENE, **changes, "output": {**SCENE["output"], "directory": str(folder)}}
    done = subprocess.run(
        ["mpiexec", "-n", str(ranks), "-x", "LD_PRELOAD=" + str(counter), sys.executable, "-c", COUNTED, json.dumps(scene)],
        env=mpi_batch.ENVIRONMENT, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("counted ")]
    assert lines, done.stdout + done.stderr
    return json.loads(lines[0].removeprefix("counted "))


@pytest.mark.parametrize("ranks", [2, 3])
def test_a_step_with_diagnostics_has_few_and_small_collectives(counter, tmp_path, ranks):
    for steps in counted(counter, tmp_path, ranks):
        assert len(steps) == STEPS
        for step in steps:
            assert step["calls"] <= MOST + PER_CYCLE * step["cycles"], step
            assert step["most_bytes"] <= 64 * KILOBYTE, step
            assert step["all_to_all"] == 0 and step["pickled"] == 0, step
            assert step["calls"] == step["ours"], "a collective is not counted by the library"
