# %% [markdown]
# # A convergence study
#
# How fine must the mesh be? Solve a problem with a known answer on finer and finer meshes, and look at how the error falls. Here the
# charge is a Gaussian ball in free space, whose potential is $\phi = \frac{Q}{4\pi\varepsilon_0 r}\,\mathrm{erf}\frac{r}{\sqrt2\,\sigma}$.

# %%
import numpy as np
import pandas
from scipy.special import erf

import amrpic

sigma, charge, epsilon0 = 0.1, 1e-9, 8.8541878128e-12  # m, C, F/m


def density(x, y, z):
    return (
        charge
        / (2 * np.pi * sigma**2) ** 1.5
        * np.exp(-(x**2 + y**2 + z**2) / (2 * sigma**2))
    )


def potential(x, y, z):
    r = np.sqrt(x**2 + y**2 + z**2)
    return charge / (4 * np.pi * epsilon0 * r) * erf(r / (np.sqrt(2) * sigma))


# %% [markdown]
# `levels` of a `Hierarchy` lists the boxes of each refined level, as first and last cell in its own numbering. Here each level halves the
# extent of the level below. Cell centres never lie at r = 0.


# %%
def solve(cells, levels):
    """Return the error of φ in the max norm over its maximum, the number of cells, and the cycles."""
    first = [
        (2**level - 1) * cells // 2 for level in range(1, levels + 1)
    ]  # in the middle, `cells` along each axis
    boxes = [[((i,) * 3, (i + cells - 1,) * 3)] for i in first]
    hierarchy = amrpic.Hierarchy(amrpic.Domain(-1, 1, cells), levels=boxes)
    rho = amrpic.Field(hierarchy, "C/m^3").fill(density)
    phi, report = amrpic.PoissonSolver(hierarchy, tolerance=1e-9).solve(rho)
    exact = amrpic.Field(hierarchy, "V").fill(potential)
    count = sum(hierarchy.cells(level) for level in range(hierarchy.levels))
    return {
        "error": (phi - exact).norm("max") / exact.max(),
        "cells": count,
        "cycles": report.cycles,
    }


rows = [
    {"mesh": mesh, "cell width": 2 / cells / 2**levels, **solve(cells, levels)}
    for mesh, levels, sizes in (
        ("one level", 0, (16, 32, 64, 128)),
        ("two more levels", 2, (16, 32, 48)),
    )
    for cells in sizes
]
study = pandas.DataFrame(rows)
study

# %% [markdown]
# ## The order
#
# On logarithmic axes an error proportional to the square of the cell width is a line of slope 2.

# %%
errors = study.pivot(index="cell width", columns="mesh", values="error")
errors["slope 2"] = 5 * errors.index**2
axes = errors.interpolate("index", limit_area="inside").plot(
    loglog=True, style=["o-", "o-", ":"], ylabel="largest error over largest φ"
)

# %% [markdown]
# Between the two finest meshes of each kind the error falls by this power of the cell width:

# %%
finest = study.groupby("mesh").tail(2)
falls = np.log(finest[["cell width", "error"]]).groupby(finest.mesh).diff().dropna()
orders = dict(
    zip(study.mesh.unique(), falls["error"] / falls["cell width"], strict=True)
)
orders

# %% [markdown]
# Both fall with the square of the cell width. Refined meshes reach the error of uniform ones with a fraction of the cells:

# %%
axes = (
    study.pivot(index="cells", columns="mesh", values="error")
    .interpolate("index", limit_area="inside")
    .plot(loglog=True, style="o-", ylabel="error")
)
