"""Pictures of examples that `amrpic plot` does not draw: what a run has, beside what it is compared with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.special import erfi

import amrpic
from amrpic.io import time_series
from amrpic.units import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY

MM = 1e-3  # m


def bunch_and_image(run: Path, picture: Path) -> None:
    """Draw the charge and the potential of a bunch above a grounded plane z = 0 in the plane y = 0, and its image below."""
    fields = amrpic.open(run).fields[40]
    x, z = np.linspace(-3, 3, 241) * MM, np.linspace(0.005, 2.195, 220) * MM
    places = np.stack(np.broadcast_arrays(x, 0.0, z[:, None]), axis=-1)
    phi, rho = (
        field.sample(places.reshape(-1, 3), order=2).reshape(places.shape[:2]) for field in (fields.phi, fields.rho)
    )
    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.add_subplot()
    both = np.vstack([-rho[::-1], rho]) / abs(rho).max()
    axes.imshow(
        both, origin="lower", extent=(-3, 3, -2.2, 2.2), cmap="RdBu_r", vmin=-1, vmax=1, interpolation="bilinear"
    )
    levels = [-60, -50, -40, -30, -20, -10, -5]  # V
    lines = axes.contour(x / MM, z / MM, phi, levels, colors="0.2", linewidths=0.9, linestyles="solid")
    axes.clabel(lines, levels[1:-1], fmt="%g V", fontsize="x-small")
    mirrored = [-level for level in reversed(levels)]
    axes.contour(x / MM, -z / MM, -phi, mirrored, colors="0.2", linewidths=0.9, linestyles="dotted")
    axes.axhspan(-0.07, 0.07, color="0.4")
    white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    for height, text in (
        (1.95, "bunch, in free space above the plane"),
        (-2.05, "image: the same charge, of the other sign"),
    ):
        axes.text(-2.85, height, text, fontsize="small", bbox=white)
    axes.text(-2.85, 0, "cathode, 0 V", color="white", fontsize="small", verticalalignment="center")
    axes.set(xlabel="x / mm", ylabel="z / mm")
    figure.savefig(picture, dpi=100)


def spread(run: Path, picture: Path) -> None:
    """Draw the radius of a round beam that spreads by its own charge beside the universal curve, and its last potential."""
    series, results = time_series.read(run / "series.csv"), amrpic.open(run)
    beam, period = results.scene.bunches[0], results.scene.domain.upper[2] - results.scene.domain.lower[2]
    assert beam.species is not None
    speed = series["window_z"][-1] / series["time"][-1]
    gamma = 1 / np.sqrt(1 - (speed / SPEED_OF_LIGHT) ** 2)
    per_length = beam.bunch_charge / period
    strength = beam.species.charge * per_length / (2 * np.pi * VACUUM_PERMITTIVITY * beam.species.mass * gamma**3)
    radius = 2 * series["rms_x"]
    ratio = np.linspace(1, radius[-1] / radius[0], 200)
    time = radius[0] * np.sqrt(np.pi / (2 * strength)) * erfi(np.sqrt(np.log(ratio)))  # of r'' = strength / r
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(speed * time / MM, ratio * radius[0] / MM, "C1", label="universal curve")
    left.plot(series["window_z"][::3] / MM, radius[::3] / MM, "C0o", markersize=4, label="run")
    left.set(xlabel="path / mm", ylabel="radius / mm")
    x = np.linspace(0, 2.9, 30) * MM
    phi = results.fields[36].phi.sample(np.stack([x, 0 * x, 0 * x], axis=1), order=3)
    outside = x > radius[-1]
    exact = -per_length / (2 * np.pi * VACUUM_PERMITTIVITY) * np.log(x[outside] / (gamma * period))
    right.plot(x[outside] / MM, exact, "C1", label="-(λ / 2πε₀) ln(r / γL)")
    right.plot(x / MM, phi, "C0o", markersize=4, label="run, at the end")
    right.set(xlabel="x / mm", ylabel="φ / V")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(picture, dpi=100)


def swing(run: Path, picture: Path) -> None:
    """Draw the voltage of a grid, and the current of the cathode and to the anode, over a period of the voltage or two."""
    series, sources = time_series.read(run / "series.csv"), time_series.read(run / "sources.csv")
    time = series["time"] * 1e9
    window = np.ones(40) / 40  # steps: of the current of single particles
    middle = np.convolve(time, window, "valid")
    emitted = np.convolve(-sources["current"], window, "valid")
    arrived = np.gradient(series["hit_charge_grid"] - series["lost_charge"], series["time"])  # not at the grid
    figure = Figure(figsize=(8, 5), layout="constrained")
    above, below = figure.subplots(2, sharex=True, height_ratios=[1, 2])
    above.plot(time, series["voltage_grid"])
    above.axhline(-12, color="0.6", linewidth=0.8, linestyle="dotted")
    above.set(ylabel="grid / V")
    below.plot(middle, emitted * 1e6, label="from the cathode")
    below.plot(middle, np.convolve(arrived, window, "valid") * 1e6, label="to the anode")
    below.set(xlabel="t / ns", ylabel="current / µA", ylim=(0, 70))
    below.legend(fontsize="small")
    figure.savefig(picture, dpi=100)
