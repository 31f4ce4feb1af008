"""A density with an edge on another mesh, with bounds and without, and its values on a line by fits and by steps.

Prints a line per way: integral over that before, least and largest value. Run it by
`.venv/bin/python examples/fields_between_meshes.py`; `--picture FILE` draws planes and the line.
"""

import argparse
from pathlib import Path

import numpy as np
from mpi4py import MPI

import amrpic

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", type=Path, help="a PNG of the planes and the line")
picture = parser.parse_args().picture

here = amrpic.Hierarchy(MPI.COMM_SELF, amrpic.Domain(-1, 1, 20, "dirichlet"), (), 20, 4)
there = amrpic.Hierarchy(MPI.COMM_SELF, amrpic.Domain(-1, 1, 48, "dirichlet"), (), 24, 4)
ball = amrpic.Field(here, "C/m^3").fill(
    lambda x, y, z: np.where(x**2 + y**2 + z**2 < 0.5, 1 + 0.3 * np.sin(4 * x) * np.cos(3 * y), 0.0)
)
ways = {
    "before": ball,
    "order 3": ball.remap(there, order=3),
    "order 3, bounds by neighbours": ball.remap(there, order=3, bounds="neighbours"),
}
print("integral  least  largest")
for field in ways.values():
    print(f"{field.integral() / ball.integral():.15f}  {field.min():+.6f}  {field.max():+.6f}")

smooth = amrpic.Field(here, "V").fill(lambda x, y, z: np.exp(-8 * (x**2 + y**2 + z**2)) * np.cos(6 * x))
x = np.linspace(-1, 1, 401)
places = np.stack([x, 0 * x, 0 * x], axis=1)
exact = np.exp(-8 * x**2) * np.cos(6 * x)

if picture:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 4, figsize=(13, 3.2), layout="constrained")
    for panel, (name, field) in zip(panels, ways.items(), strict=False):
        raster = field.slice("z", 0.01)
        shown = panel.imshow(
            raster.values.T, origin="lower", extent=(-1, 1, -1, 1), vmin=-0.3, vmax=1.6, cmap="nipy_spectral"
        )
        panel.set(title=name, xlabel="x (m)", ylabel="y (m)")
        panel.title.set_fontsize("medium")
    figure.colorbar(shown, ax=panels[2], label="density (C/m³)")
    for order, colour in ((1, "C1"), (3, "C0")):
        error = smooth.sample(places, order=order) - exact
        panels[3].plot(x, error, colour, label="trilinear" if order == 1 else f"fit of order {order}")
    panels[3].set(title="error of sample(), smooth field", xlabel="x (m)", ylabel="V")
    panels[3].title.set_fontsize("medium")
    panels[3].legend(fontsize="small", loc="lower right")
    figure.savefig(picture, dpi=110)
