"""Take the bunch of verify.beam_line through its cell with ImpactX, and write what the verification compares with.

ImpactX is sequential, from PyPI's `impactx-noacc`: exact maps of drifts, quadrupoles and sector dipoles, its linear map of
solenoids, kicks by space charge between them, from the field of FFT with integrated Green functions on a mesh that is fitted to
the bunch. The values are kept only if their own error is below ERROR: a third of the change from half the slices and half the
cells, as slices and cells are of second order. `make impactx` runs this.
"""

from __future__ import annotations

import json
import os
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
from impactx import ImpactX, elements
from mpi4py import MPI

from amrpic.pic.initial_particles import make_particles
from amrpic.scene.scene import Scene
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from verify import beam_line
from verify.beam_line import BETA, BETA_GAMMA, CELL, CHARGES, Piece

CELLS, SLICE = 96, 2e-2  # along an axis; m, about
ERROR = 3e-3  # relative
GAMMA = float(np.hypot(1, BETA_GAMMA))
MASS = ELECTRON_MASS * SPEED_OF_LIGHT**2 / ELEMENTARY_CHARGE * 1e-6  # MeV
Values = dict[str, list[float]]


def passage(charge: float, model: str, cells: int, slice_: float) -> Values:
    """Return the path and what beam_line.MEASURED names after each slice; `model` is that of space charge."""
    simulation = ImpactX()
    simulation.n_cell = [cells] * 3
    simulation.particle_shape = 2
    simulation.space_charge = model
    simulation.poisson_solver = "fft"
    simulation.dynamic_size = True
    simulation.prob_relative = [1.1]
    simulation.slice_step_diagnostics = True
    simulation.verbose = 0
    simulation.tiny_profiler = False
    simulation.init_grids()
    simulation.beam.ref.set_charge_qe(-1.0).set_mass_MeV(MASS).set_kin_energy_MeV((GAMMA - 1) * MASS)
    # a positive charge of the bunch has the sign of the reference particle
    simulation.beam.add_n_particles(*at_plane(charge), qm=-1e-6 / MASS, bunch_charge=abs(charge))
    simulation.lattice.extend([element(piece, round(piece.length / slice_)) for piece in CELL])
    simulation.track_particles()
    simulation.finalize()
    rows = np.genfromtxt("diags/reduced_beam_characteristics.0", names=True)
    columns = {
        "s": rows["s"],
        "x": rows["sigma_x"],
        "y": rows["sigma_y"],
        "z": BETA * rows["sigma_t"],
        "emittance_x": rows["emittance_xn"],
        "emittance_y": rows["emittance_yn"],
        "spread": BETA_GAMMA * rows["sigma_pt"],
    }
    return {name: column.tolist() for name, column in columns.items()}


def at_plane(charge: float) -> tuple[np.ndarray, ...]:
    """Return x, y, c t in m and px, py, pt over the reference momentum, as the particles of the scene pass its plane z = 0."""
    scene = Scene.from_dict(beam_line.scene(charge))
    particles = make_particles(MPI.COMM_SELF, scene)
    u = particles.momentum / (ELECTRON_MASS * SPEED_OF_LIGHT)
    gamma = np.sqrt(1 + np.sum(u**2, axis=1))
    way = -particles.position[:, 2] / u[:, 2]
    x, y = (particles.position[:, d] + way * u[:, d] for d in range(2))
    return x, y, way * gamma, u[:, 0] / BETA_GAMMA, u[:, 1] / BETA_GAMMA, (GAMMA - gamma) / BETA_GAMMA


def element(piece: Piece, slices: int) -> object:
    """Return ImpactX's element for a piece."""
    match piece.kind:
        case "drift":
            return elements.ExactDrift(ds=piece.length, nslice=slices)
        case "quadrupole":
            return elements.ExactQuad(ds=piece.length, k=piece.strength, int_order=4, mapsteps=4, nslice=slices)
        case "solenoid":
            return elements.Sol(ds=piece.length, ks=piece.strength, nslice=slices)
    return elements.ExactSbend(ds=piece.length, phi=np.degrees(piece.strength), nslice=slices)


def difference(values: Values, coarse: Values) -> float:
    """Return the largest relative difference at the screens."""
    pairs = ((beam_line.at(values, s), beam_line.at(coarse, s)) for s in beam_line.screens().values())
    return max(abs(b[what] / a[what] - 1) for a, b in pairs for what in beam_line.MEASURED)


def main() -> int:
    output = Path(beam_line.__file__).with_name(beam_line.REFERENCE)
    settings = (
        f"ImpactX {version('impactx-noacc')}, exact maps, 3D space charge by FFT on {CELLS}³ cells, slices of "
        f"{SLICE * 1e3:g} mm"
    )
    found: dict[str, object] = {"made by": settings, "of": beam_line.description()}
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # it writes into the present directory
        for name, charge in CHARGES.items():
            model = "3D" if name == "with" else "off"
            values = passage(charge, model, CELLS, SLICE)
            error = difference(values, passage(charge, model, CELLS // 2, 2 * SLICE)) / 3
            print(f"{name} space charge: the error of ImpactX's values at the screens is about {error:.1e}", flush=True)
            if error > ERROR:
                raise SystemExit(f"that is more than {ERROR:g}; use more slices or cells")
            found[name] = {what: [float(f"{value:.6g}") for value in column] for what, column in values.items()}
    output.write_text(json.dumps(found, separators=(",", ":")) + "\n", encoding="utf-8")
    return 0
