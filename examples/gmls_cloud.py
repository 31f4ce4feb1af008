"""Gradient and Laplacian of a function that is known at scattered points, and how their errors fall.

Prints a line per number of points. Run it by `.venv/bin/python examples/gmls_cloud.py`; `--order` chooses the polynomials.
"""

import argparse

import numpy as np

import amrpic  # noqa: F401  (starts MPI and the native module)
from amrpic import gmls

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--order", type=int, default=3, choices=(2, 3, 4), help="of the polynomials")
order = parser.parse_args().order

rng = np.random.default_rng(1)
targets = rng.uniform(0.25, 0.75, (500, 3))
x, y, z = targets.T
gradient = np.stack([np.cos(x) * np.exp(y) * z, np.sin(x) * np.exp(y) * z, np.sin(x) * np.exp(y)], axis=1)

print("points  neighbours  rms error of the gradient  of the Laplacian, which is zero")
for n in (8, 12, 18, 27):
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
    errors = [np.sqrt(np.mean((found["gradient"] - gradient) ** 2)), np.sqrt(np.mean(found["laplacian"] ** 2))]
    print(f"{n**3:6d}  {stencils.quality.neighbours.mean():10.0f}  {errors[0]:25.1e}  {errors[1]:31.1e}")
