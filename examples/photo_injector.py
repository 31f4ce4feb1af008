"""A photo-injector: a laser pulse on the cathode of a gun of 1.6 cells at 2.856 GHz, a solenoid, and 1.5 m to go.

Writes the map of the gun's field into the folder of the run, runs, and prints size, emittance and energy at the end. Run it by
`mpiexec -n 2 .venv/bin/python examples/photo_injector.py`. `--cells`, `--step` and `--particles` ask for finer ones, and
`--cells 96 --levels 0 --length 0.15` for a uniform mesh and the first 0.15 m.
"""

import argparse
from pathlib import Path

import h5py
import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT

FREQUENCY = 2.856e9  # Hz
PEAK = 100e6  # V/m, at the cathode


def write_map(path: Path) -> None:
    """E and B of the gun on r and z: on the axis a standing wave that ends behind the iris of the full cell.

    Off the axis the expansion of Maxwell's equations to third order in r, as for the gaps of docs/theory.md.
    """
    k = 2 * np.pi * FREQUENCY / SPEED_OF_LIGHT
    r, z = np.linspace(0, 8e-3, 17), np.linspace(0, 0.16, 161)
    s = np.linspace(0, 0.16, 6401)
    wave = k / 1.05  # cells a little longer than half a wave, for electrons that start from rest
    on_axis = np.cos(wave * s) / (1 + np.exp((s - 1.5 * np.pi / wave) / 6e-3))
    slopes = [on_axis / on_axis[0]]
    for _ in range(3):
        slopes.append(np.gradient(slopes[-1], s, edge_order=2))
    e, e1, e2, e3 = (np.interp(z, s, values) for values in slopes)
    excess, excess_slope = e2 + k**2 * e, e3 + k**2 * e1
    r = r[:, None]
    electric = {"r": -e1 * r / 2 + excess_slope * r**3 / 16, "z": e - excess * r**2 / 4}
    magnetic = {"t": k / SPEED_OF_LIGHT * (e * r / 2 - excess * r**3 / 16)}
    with h5py.File(path, "w") as file:
        file.attrs.update({"openPMD": "1.1.0", "basePath": "/data/%T/", "meshesPath": "fields/"})
        for name, parts, units in (
            ("E", electric, [1.0, 1, -3, -1, 0, 0, 0]),
            ("B", magnetic, [0.0, 1, -2, -1, 0, 0, 0]),
        ):
            group = file.create_group(f"data/0/fields/{name}")
            group.attrs.update({"geometry": "thetaMode", "dataOrder": "C", "gridUnitSI": 1.0})
            group.attrs["axisLabels"] = np.array(["r", "z"], dtype="S")
            group.attrs["gridSpacing"] = [float(r[1, 0] - r[0, 0]), float(z[1] - z[0])]
            group.attrs["gridGlobalOffset"] = [0.0, 0.0]
            group.attrs["unitDimension"] = units
            for part in "rtz":
                group[part] = (PEAK * parts.get(part, np.zeros_like(electric["r"])))[None]


def steps(first: float, length: float) -> int:
    """How many steps pass the end: of the pulse and those that grow, in the coil, and in the drift."""
    return round(60 / first + 1e12 * length / SPEED_OF_LIGHT / (20 * first))


def scene(folder: Path, cells: int, step: float, particles: int, levels: int, length: float) -> amrpic.Scene:
    """The run with so many base cells across, and steps that start at so many ps."""
    return amrpic.Scene.from_dict(
        {
            "domain": {
                "lower": ["-6 mm", "-6 mm", 0],
                "upper": ["6 mm", "6 mm", "8 mm"],
                "cells": [cells, cells, 4 * cells // 3],
                "boundary": {"x": "open", "y": "open", "z": ["dirichlet", "open"]},
            },
            "sources": [
                {
                    "name": "cathode",
                    "process": "photo",
                    "face": "z_lower",
                    "spot": {"shape": "disc", "radius": "0.8 mm"},
                    "pulse": {"shape": "plateau", "width": "8 ps", "rise": "0.5 ps"},
                    "mean_transverse_energy": "0.4 eV",
                    "charge": "-200 pC",
                    "particles": particles,
                    "sampling": "sobol",
                }
            ],
            "elements": [
                {
                    "kind": "map",
                    "file": str((folder / "gun.h5").resolve()),
                    "frequency": FREQUENCY,
                    "phase": "-45 deg",
                    "scale": -1,
                },
                {
                    "kind": "solenoid",
                    "fringe": "sheet",
                    "radius": "25 mm",
                    "length": "0.16 m",
                    "centre": [0, 0, "0.2 m"],
                    "field": "0.205 T",
                },
            ],
            "refinement": {
                "levels": levels,
                "regrid_every": 5,
                "blocking_factor": 4,
                "rule": {
                    "kind": "any",
                    "of": [{"kind": "charge-density", "relative": 0.1}, {"kind": "emission", "cells": 4}],
                },
            },
            "solver": {"tolerance": "discretization"},
            "motion": {
                "kind": "leapfrog",
                "dt": f"{step} ps",
                "growth": 0.2 * step,
                "longest": f"{20 * step} ps",
                "window": "reference",
                "reference": {"species": "electron", "position": [0, 0, "1 um"], "momentum": [0, 0, "1 keV/c"]},
            },
            "schedule": {"steps": steps(step, length)},
            "diagnostics": {"slices": 20},
            "output": {"directory": str(folder), "write": ["series", "report"]},
        }
    )


def tell(folder: Path, picture: Path | None, length: float) -> None:
    """Print what the beam is at the end, and draw it along the way."""
    rows = np.genfromtxt(folder / "beam.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    rows = rows[(rows["group"] == "cathode") & (rows["particles"] > 0)]
    columns = {"rms_x": ("rms x", 1e3, "mm"), "rms_z": ("rms z", 1e3, "mm"), "emittance_x": ("emittance", 1e6, "µm")}
    for name, (label, factor, unit) in columns.items():
        print(f"{label}: {factor * np.interp(length, rows['s'], rows[name]):.4f} {unit}")
    energy = np.interp(length, rows["s"], rows["mean_energy"]) / ELEMENTARY_CHARGE
    print(f"kinetic energy: {1e-6 * energy:.4f} MeV")
    if picture is not None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(8, 4), layout="constrained")
        axes = figure.add_subplot()
        for name, (label, factor, unit) in columns.items():
            axes.plot(rows["s"], factor * rows[name], label=f"{label} / {unit}")
        axes.set(xlabel="s / m", xlim=(0, length), ylim=(0, 4))
        axes.legend(fontsize="small")
        figure.savefig(picture, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=24, help="base cells across")
    parser.add_argument("--levels", type=int, default=2, help="levels of refinement")
    parser.add_argument("--step", type=float, default=0.1, help="first time step, ps")
    parser.add_argument("--particles", type=int, default=100_000)
    parser.add_argument("--length", type=float, default=1.5, help="where the figures are printed, m")
    parser.add_argument("--folder", type=Path, default=Path("runs/photo_injector"))
    parser.add_argument("--picture", type=Path, help="a PNG of sizes and emittance along the way")
    chosen = parser.parse_args()
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        chosen.folder.mkdir(parents=True, exist_ok=True)
        write_map(chosen.folder / "gun.h5")
    comm.Barrier()
    simulation = amrpic.Simulation(
        comm, scene(chosen.folder, chosen.cells, chosen.step, chosen.particles, chosen.levels, chosen.length)
    )
    simulation.run()
    if comm.rank == 0:
        tell(chosen.folder, chosen.picture, chosen.length)


if __name__ == "__main__":
    main()
