"""The derivative across a coarse-fine face, from the cells of both levels around it: the weights of a stencil.

Prints a line per weight of the cells in one plane, of which there are more. Run it by `.venv/bin/python examples/gmls_mesh.py`;
`--picture FILE` draws the plane.
"""

import argparse
from pathlib import Path

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic import gmls

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", type=Path, help="a PNG of the weights in the plane")
picture = parser.parse_args().picture

domain = amrpic.Domain((0, 0, 0), (16, 16, 16), (16, 16, 16))
mesh = amrpic.Hierarchy(MPI.COMM_SELF, domain, [[((0, 8, 8), (15, 23, 23))]], max_grid_size=16, blocking_factor=8)
centres, widths = gmls.cells(mesh)
face = np.array([[8.0, 8.25, 8.25]])  # the middle of the face of a fine cell, on the end of the fine level
near = gmls.cells_around(mesh, face, 2.0)
stencil = gmls.stencils(
    face,
    near,
    space=gmls.Scalar(2),
    samples=gmls.WithLaplacian(centres, widths, 1 / 30),  # what a cell's φ is
    wanted=[gmls.Derivative(1, 0, 0).called("slope")],
)
cells, weights = stencil.index, stencil.weights[:, 0]
in_plane = np.abs(centres[cells, 2] - face[0, 2]) < 0.51 * widths[cells, 2]
print("     x      y  width   weight (per m)")
for cell, weight in zip(cells[in_plane], weights[in_plane], strict=True):
    print(f"{centres[cell, 0]:6.2f} {centres[cell, 1]:6.2f}  {widths[cell, 0]:5.2f}  {weight:+15.4f}")

if picture:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.patches import Rectangle

    figure, plot = plt.subplots(figsize=(6.4, 5), layout="constrained")
    largest = np.abs(weights).max()
    colour = plt.cm.ScalarMappable(plt.Normalize(-largest, largest), "RdBu_r")
    for cell, weight in zip(cells[in_plane], weights[in_plane], strict=True):
        corner, width = centres[cell, :2] - widths[cell, :2] / 2, widths[cell, 0]
        plot.add_patch(Rectangle(corner, width, width, facecolor=colour.to_rgba(weight), edgecolor="black"))
        ink = "white" if abs(weight) > 0.6 * largest else "black"
        plot.annotate(f"{weight:+.3f}", centres[cell, :2], ha="center", va="center", fontsize=8, color=ink)
    plot.plot(*face[0, :2], "k>", markersize=9)
    plot.set(aspect="equal", xlim=(5.9, 10.1), ylim=(6, 10.5), xlabel="x (m)", ylabel="y (m)")
    figure.colorbar(colour, ax=plot, label="weight of φ in ∂φ/∂x at the arrow (1/m)")
    figure.savefig(picture, dpi=120)
