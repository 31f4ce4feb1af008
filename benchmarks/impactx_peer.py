"""Time ImpactX's steps with space charge: a ball of charge in free flight, one refined level. A worker of `pic_step`.

It is sequential, from PyPI's `impactx-noacc`. Each step: half a drift, transformation to the frame of the bunch, boxes fitted
to it, redistribution, deposition, the solve (AMReX's multigrid, level by level), the field, gather and kick, half a drift.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=64)
    parser.add_argument("--particles", type=int, default=1_000_000)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--each", type=int, default=4, help="steps of a run")
    parser.add_argument("--solver", choices=["multigrid", "fft"], default="multigrid")
    parser.add_argument("--tolerance", type=float, default=1e-7, help="of a solve")
    parser.add_argument("--output", type=Path, required=True)
    given = parser.parse_args()
    output = given.output.resolve()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # it writes into the present directory
        taken = steps(given.cells, given.particles, given.runs, given.each, given.solver, given.tolerance)
    output.write_text(json.dumps(taken), encoding="utf-8")
    return 0
