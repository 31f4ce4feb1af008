"""Gradient and Laplacian of a function that is known at scattered points, and how their errors fall.

Prints a line per number of points. Run it by `.venv/bin/python examples/gmls_cloud.py`; `--order` chooses the polynomials,
`--picture FILE` draws the errors.
"""

import argparse
from pathlib import Path

import numpy as np

import amrpic  # noqa: F401  (starts MPI and the native module)
from amrpic import gmls

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--order", type=int, default=3, choices=(2, 3, 4), help="of the polynomials")
parser.add_argument("--picture", type=Path, help="a PNG of the errors")
given = parser.parse_args()
order, counts, errors = given.order, (8, 12, 18, 27), []

rng = np.random.default_rng(1)
targets = rng.uniform(0.25, 0.75, (500, 3))
x, y, z = targets.T
gradient = np.stack([np.cos(x) * np.exp(y) * z, np.sin(x) * np.exp(y) * z, np.sin(x) * np.exp(y)], axis=1)

print("points  neighbours  rms error of the gradient  of the Laplacian, which is zero")
for n in counts:
    lattice = np.stack(np.meshgrid(*[np.arange(n) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    sites = (lattice + rng.uniform(-0.25, 0.25, lattice.shape)) / n
    values = np.sin(sites[:, 0]) * np.exp(sites[:, 1]) * sites[:, 2]
    near = gmls.nearby(sites, targets, order=order, reach=1.8)
    stencils = gmls.stencils(
        targets,
        near,
        space=gmls.Scalar(order),
        samples=gmls.Points(sites),
        wanted=[gmls.GRADIENT, gmls.LAPLACIAN],
    )
    found = stencils.apply(values)
    errors.append([np.sqrt(np.mean((found["gradient"] - gradient) ** 2)), np.sqrt(np.mean(found["laplacian"] ** 2))])
    print(f"{n**3:6d}  {stencils.quality.neighbours.mean():10.0f}  {errors[-1][0]:25.1e}  {errors[-1][1]:31.1e}")

if given.picture:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, plot = plt.subplots(figsize=(6.4, 4.8), layout="constrained")
    width = 1 / np.array(counts)
    for name, error, expected in zip(("gradient", "Laplacian"), np.transpose(errors), (order, order - 1), strict=True):
        (line,) = plot.loglog(width, error, "o-", label=name)
        slope = error[-1] * (width / width[-1]) ** expected
        plot.loglog(width, slope, ":", color=line.get_color(), label=f"order {expected}")
    plot.set(xlabel="distance of points", ylabel="rms error", title=f"polynomials of order {order}")
    plot.set_xticks(width, [f"1/{n}" for n in counts], minor=False)
    plot.minorticks_off()
    plot.legend()
    figure.savefig(given.picture, dpi=120)
