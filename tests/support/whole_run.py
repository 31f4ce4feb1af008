"""A small run that writes one of everything: dumps, views, particles, losses, a screen, tables, pictures, a checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mpi4py import MPI

from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene

SCENE: dict[str, Any] = {
    "domain": {"lower": -0.01, "upper": 0.01, "cells": 16, "boundary": "dirichlet"},
    "bunches": [
        {
            "distribution": "gaussian",
            "species": "electron",
            "charge": "-1 pC",
            "sigma": "2 mm",
            "particles": 400,
            "momentum": [0, 0, "30 keV/c"],
        }
    ],
    "refinement": {"levels": 1, "max_grid_size": 8, "rule": {"kind": "charge-density", "relative": 0.1}},
    "motion": {"kind": "leapfrog", "dt": "20 ps"},
    "schedule": {"steps": 4},
    "screens": [{"name": "end", "z": "1 um"}],
    "apertures": [{"name": "pipe", "kind": "round", "radius": "2 mm"}],
    "diagnostics": {"every": 2, "slices": 3},
}
WRITE = ["checkpoint", "fields", "particles", "series", "losses", "pictures"]


def run(comm: MPI.Comm, folder: Path, **output: Any) -> None:
    """Run it; fields are written in steps 0, 2 and 4, particles in 0 and 4. Collective."""
    wanted = {"write": WRITE, "fields_every": 2, "particles_every": 4, "directory": str(folder), **output}
    Simulation(comm, Scene.from_dict({**SCENE, "output": wanted})).run(log="silent")
    comm.Barrier()
