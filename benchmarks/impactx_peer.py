"""Time ImpactX's steps with space charge: a ball of charge in free flight, one refined level. A worker of `pic_step`.

It is sequential, from PyPI's `impactx-noacc`. Each step: half a drift, transformation to the frame of the bunch, boxes fitted
to it, redistribution, deposition, the solve (AMReX's multigrid, level by level), the field, gather and kick, half a drift.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from pathlib import Path
from typing import Annotated

from impactx import ImpactX, distribution, elements


def steps(cells: int, particles: int, runs: int, each: int, solver: str, tolerance: float) -> list[float]:
    """Return the seconds per step of each run of so many steps; a first run is not counted."""
    simulation = ImpactX()
    simulation.n_cell = [cells] * 3
    simulation.max_level = 1
    simulation.prob_relative = [3.0, 1.1]  # the base three times as wide as the bunch, the refined box a tenth wider
    simulation.particle_shape = 1
    simulation.space_charge = "3D"
    simulation.poisson_solver = solver
    simulation.mlmg_relative_tolerance = tolerance
    simulation.dynamic_size = True
    simulation.slice_step_diagnostics = False
    simulation.diagnostics = False
    simulation.verbose = 0
    simulation.tiny_profiler = False
    simulation.mlmg_verbosity = 0
    simulation.init_grids()
    reference = simulation.beam.ref
    reference.set_charge_qe(-1.0).set_mass_MeV(0.510998950).set_kin_energy_MeV(250.0)
    # as long in its own frame as wide: a ball, of uniform charge
    ball = distribution.Kurth6D(4.472135955e-4, 4.472135955e-4, 9.12241869e-7, 0.0, 0.0, 0.0)
    simulation.add_particles(1e-9, ball, particles)
    simulation.lattice.extend([elements.Drift(ds=0.15 * each, nslice=each)])
    taken = []
    for _ in range(runs + 1):
        start = time.perf_counter()
        simulation.track_particles()
        taken.append((time.perf_counter() - start) / each)
    levels = simulation.finest_level + 1
    simulation.finalize()
    if levels != 2:
        raise SystemExit(
            f"ImpactX made {levels} levels instead of 2; its interface has changed, so impactx_peer.py must follow"
        )
    return taken[1:]


def run(
    output: Annotated[Path, "the JSON to write"],
    cells: int = 64,
    particles: int = 1_000_000,
    runs: int = 5,
    each: Annotated[int, "steps of a run"] = 4,
    solver: Annotated[str, "of Poisson's equation", ("multigrid", "fft")] = "multigrid",
    tolerance: Annotated[float, "of a solve"] = 1e-7,
) -> None:
    """Time steps, and write their seconds."""
    output = output.resolve()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # it writes into the present directory
        taken = steps(cells, particles, runs, each, solver, tolerance)
    output.write_text(json.dumps(taken), encoding="utf-8")
