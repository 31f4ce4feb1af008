"""The photo-injector of Argonne's wakefield accelerator beside OPAL: 1 nC from a gun at 1.3 GHz and two solenoids, to 1.5 m.

`python -m benchmarks.awa_gun FOLDER` reads the fields and OPAL's figures from the folder RegressionTests/AWAGun-1 of OPAL's
regression tests (Neveu et al., NAPAC 2016, THPOA46, compare it with ASTRA and GPT), runs, and prints both side by side.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY

FREQUENCY = 1.3e9  # Hz
PEAK = 60e6  # V/m, at the cathode
CREST = 140.4697  # deg, of the field when the middle of the pulse is born: OPAL's phase of the highest energy
COILS = {"BF_550.T7": 0.120154, "M_440.T7": 0.379111}  # T, at most on the axis
FLAT, RISE = 11.6245e-12, 3.556773e-12  # s: of 20 ps between half heights, and 6 ps between 10 and 90 %
CUT = 4.0  # rms lengths of a rise
EDGE = 0.75e-3  # m, of the disc that emits
END = 1.5  # m


def write_map(path: Path, size: tuple[float, float], **records: dict[str, np.ndarray]) -> None:
    """Records E (V/m) and B (T) of components r, t, z, of shape (r, z), from the axis and the cathode out to `size`, m."""
    units = {"E": [1.0, 1, -3, -1, 0, 0, 0], "B": [0.0, 1, -2, -1, 0, 0, 0]}
    with h5py.File(path, "w") as file:
        file.attrs.update({"openPMD": "1.1.0", "basePath": "/data/%T/", "meshesPath": "fields/"})
        for name, parts in records.items():
            shape = next(iter(parts.values())).shape
            group = file.create_group(f"data/0/fields/{name}")
            group.attrs.update({"geometry": "thetaMode", "dataOrder": "C", "gridUnitSI": 1.0})
            group.attrs["axisLabels"] = np.array(["r", "z"], dtype="S")
            group.attrs["gridSpacing"] = [size[0] / (shape[0] - 1), size[1] / (shape[1] - 1)]
            group.attrs["gridGlobalOffset"] = [0.0, 0.0]
            group.attrs["unitDimension"] = units[name]
            for part in "rtz":
                group[part] = parts.get(part, np.zeros(shape))[None]


def write_maps(opal: Path, folder: Path) -> None:
    """Maps of gun and coils from OPAL's, which are scaled to a largest field of 1 on the axis."""
    ez, er, _, h = (column.reshape(11, 301) for column in np.loadtxt(opal / "DriveGun.T7", skiprows=4).T)
    scale = PEAK / np.abs(ez[0]).max()  # of MV/m
    permeability = 1 / (VACUUM_PERMITTIVITY * SPEED_OF_LIGHT**2)
    write_map(
        folder / "gun.h5",
        (25e-3, 0.29270745),
        E={"z": scale * ez, "r": scale * er},
        B={"t": 1e-6 * scale * permeability * h},
    )
    for name, peak in COILS.items():
        br, bz = (column.reshape(200, 20).T for column in np.loadtxt(opal / name, skiprows=3).T)
        scale = peak / np.abs(bz[0]).max()
        write_map((folder / name).with_suffix(".h5"), (50e-3, 0.5), B={"z": scale * bz, "r": scale * br})


def pulse() -> dict[str, Any]:
    """A flat top between halves of Gaussians."""
    out = np.linspace(0, CUT, 41)
    rise, fall = CUT * RISE - RISE * out[::-1], CUT * RISE + FLAT + RISE * out
    height = np.exp(-(out**2) / 2)
    times, values = np.concatenate([rise, fall]), np.concatenate([height[::-1], height])
    return {"shape": "table", "times": (times - times[0]).tolist(), "values": values.tolist()}


def scene(folder: Path, cells: int, step: float, particles: int, levels: int) -> amrpic.Scene:
    """The run with so many base cells across, and steps that start at so many ps."""
    middle = CUT * RISE + FLAT / 2
    maps: list[dict[str, Any]] = [{"file": "gun.h5", "frequency": FREQUENCY}]
    maps[0]["phase"] = f"{CREST - 360 * FREQUENCY * middle} deg"
    maps += [{"file": Path(name).with_suffix(".h5").name} for name in COILS]
    return amrpic.Scene.from_dict(
        {
            "domain": {
                "lower": ["-6 mm", "-6 mm", 0],
                "upper": ["6 mm", "6 mm", "32 mm"],
                "cells": [cells, cells, 8 * cells // 3],
                "boundary": {"x": "open", "y": "open", "z": ["dirichlet", "open"]},
            },
            "sources": [
                {
                    "name": "cathode",
                    "process": "given",
                    "face": "z_lower",
                    "spot": {"shape": "disc", "radius": EDGE},
                    "pulse": pulse(),
                    "momenta": {"kind": "isotropic", "energy": "0.55 eV"},
                    "charge": "-1 nC",
                    "particles": particles,
                    "sampling": "sobol",
                }
            ],
            "elements": [{**one, "kind": "map", "file": str((folder / one["file"]).resolve())} for one in maps],
            "refinement": {
                "levels": levels,
                "rule": {
                    "kind": "any",
                    "of": [{"kind": "charge-density", "relative": 0.02}, {"kind": "emission", "cells": 4}],
                },
            },
            "solver": {"tolerance": "discretization"},
            "motion": {
                "kind": "leapfrog",
                "dt": f"{step} ps",
                "growth": 0.1 * step,
                "longest": f"{10 * step} ps",
                "window": "reference",
                "reference": {"species": "electron", "position": [0, 0, "1 um"], "momentum": [0, 0, "1 keV/c"]},
            },
            "schedule": {"steps": round(100 / step + 1e12 * END / SPEED_OF_LIGHT / (10 * step))},
            "output": {"directory": str(folder), "write": ["series"]},
        }
    )


def opal_figures(opal: Path) -> tuple[float, dict[str, float]]:
    """When OPAL's bunch is at the end, s after the first birth, and its sizes, length and emittances in m, energy in MeV."""
    lines = (opal / "reference" / "AWAGun-1.stat").read_text().splitlines()
    names = [line.split("=")[1].rstrip(",") for line in lines if line.strip().startswith("name=")][3:]
    values = np.array([line.split() for line in lines if len(line.split()) == len(names)], dtype=float)
    rows = dict(zip(names, values.T, strict=True))
    columns = {"rms x": "rms_x", "rms y": "rms_y", "rms z": "rms_s", "emittance x": "emit_x", "emittance y": "emit_y"}
    found = {k: float(np.interp(END, rows["s"], rows[column])) for k, column in {**columns, "energy": "energy"}.items()}
    return 1e-9 * float(np.interp(END, rows["s"], rows["t"])) + CUT * RISE + FLAT / 2, found


def our_figures(folder: Path, time: float) -> dict[str, float]:
    """The same of a run, at the same time: `s` in its table is that of the reference particle, at the head of the bunch."""
    rows = np.genfromtxt(folder / "beam.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    rows = rows[(rows["group"] == "cathode") & (rows["particles"] > 0)]
    columns = {f"rms {axis}": f"rms_{axis}" for axis in "xyz"} | {
        f"emittance {axis}": f"emittance_{axis}" for axis in "xy"
    }
    found = {k: float(np.interp(time, rows["time"], rows[column])) for k, column in columns.items()}
    return {**found, "energy": 1e-6 * float(np.interp(time, rows["time"], rows["mean_energy"])) / ELEMENTARY_CHARGE}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("opal", type=Path, help="OPAL's folder AWAGun-1, with its reference")
    parser.add_argument("--cells", type=int, default=24, help="base cells across")
    parser.add_argument("--levels", type=int, default=2, help="levels of refinement")
    parser.add_argument("--step", type=float, default=0.2, help="first time step, ps")
    parser.add_argument("--particles", type=int, default=50_000)
    parser.add_argument("--folder", type=Path, default=Path("runs/awa_gun"))
    chosen = parser.parse_args()
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        chosen.folder.mkdir(parents=True, exist_ok=True)
        write_maps(chosen.opal, chosen.folder)
    comm.Barrier()
    amrpic.Simulation(comm, scene(chosen.folder, chosen.cells, chosen.step, chosen.particles, chosen.levels)).run()
    if comm.rank == 0:
        time, opal = opal_figures(chosen.opal)
        ours = our_figures(chosen.folder, time)
        for name, theirs in opal.items():
            factor, unit = (1, "MeV") if name == "energy" else (1e6, "µm") if "emittance" in name else (1e3, "mm")
            print(f"{name}: {factor * ours[name]:.4f} {unit}, OPAL {factor * theirs:.4f}")


if __name__ == "__main__":
    main()
