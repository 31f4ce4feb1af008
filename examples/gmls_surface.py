"""Curvatures of an ellipsoid that is known by points alone.

Prints a line per number of points. Run it by `.venv/bin/python examples/gmls_surface.py`; `--picture FILE` draws the curvature.
"""

import argparse
from pathlib import Path

import numpy as np

import amrpic  # noqa: F401  (starts MPI and the native module)
from amrpic import gmls

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", type=Path, help="a PNG of the Gaussian curvature")
picture = parser.parse_args().picture

axes = np.array([1.0, 1.2, 0.8])
print("points  rms error of the Gaussian curvature  of the mean curvature")
for count in (1000, 4000, 16000):
    k = np.arange(count) + 0.5  # points of about equal density on the sphere, stretched
    height, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - height**2)
    sites = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1) * axes
    near = gmls.nearby(sites, sites, radius=np.sqrt(8 * np.pi * 15 / count))  # some 45 neighbours for 15 polynomials
    found = gmls.surface(sites, sites, near, order=4)
    slope = (sites**2 / axes**4).sum(axis=1)
    gaussian = 1 / (axes.prod() ** 2 * slope**2)
    mean = ((axes**2).sum() - (sites**2).sum(axis=1)) / (2 * axes.prod() ** 2 * slope**1.5)
    errors = [found.gaussian_curvature - gaussian, np.abs(found.mean_curvature) - mean]  # normals may point inwards
    print(f"{count:6d}  {np.sqrt(np.mean(errors[0] ** 2)):35.1e}  {np.sqrt(np.mean(errors[1] ** 2)):21.1e}")

if picture:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure = plt.figure(figsize=(6, 5))
    plot = figure.add_subplot(projection="3d")
    points = plot.scatter(*sites.T, c=found.gaussian_curvature, s=3)
    plot.set_box_aspect(axes)
    plot.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    figure.colorbar(points, label="Gaussian curvature, 1/m²", shrink=0.7)
    figure.savefig(picture, dpi=120)
