# %% [markdown]
# # Refinement for a halo
#
# A beam that is wider than its channel holds in balance breathes, and throws some of its particles far out: the halo. A mesh fine enough
# for it everywhere is dear. Here the mesh is fine where particles are, and follows them. [Refinement for a halo](../halo.md) has
# the whole story, with 60 periods of the focusing instead of 12.

# %%
import amrpic

coarse = amrpic.Scene.from_dict(
    {
        "name": "halo",
        "domain": {
            "lower": ["-8 mm", "-8 mm", "-0.5 mm"],
            "upper": ["8 mm", "8 mm", "0.5 mm"],
            "cells": [32, 32, 2],
            "boundary": {"x": "dirichlet", "y": "dirichlet", "z": "periodic"},
        },
        "elements": [
            amrpic.ConstantFocusingElement(gradient=[-5.68563e6, -5.68563e6, 0])
        ],  # V/m²: a period is 6.283 ns
        "bunches": [
            amrpic.ThermalBunch(
                name="beam",
                species="electron",
                gradient=-5.68563e6,
                charge="-0.237229 pC",  # matched at an rms size of 0.5 mm
                length="1 mm",
                tune_depression=0.5,
                mismatch=1.5,
                particles=20_000,
                sampling="sobol",
            )
        ],
        "solver": {"tolerance": "discretization"},
        "motion": amrpic.Leapfrog(dt="0.314159 ns"),  # 20 steps a period
        "schedule": {"steps": 240},
        "diagnostics": {"every": 1},
        "output": {"write": ["series", "particles"]},
    }
)

# %% [markdown]
# `replace` makes other scenes of it: one with a mesh that follows the particles, and one that is as fine everywhere.

# %%
scenes = {
    "coarse": coarse.replace(name="halo_coarse"),
    "follows the particles": coarse.replace(
        name="halo_refined",
        refinement=amrpic.Refinement(levels=2, rule=amrpic.ParticlesRule(at_least=1)),
    ),
    "fine everywhere": coarse.replace(
        name="halo_fine", domain=coarse.domain.replace(cells=[128, 128, 8])
    ),
}
runs = {
    name: amrpic.Simulation(scene).run(log="silent") for name, scene in scenes.items()
}

# %% [markdown]
# ## What comes out
#
# The radius within which 99.9 % of the particles lie, in matched rms sizes, and what the runs cost:

# %%
import pandas

radii = pandas.DataFrame()
for name, run in runs.items():
    beam = run.beam.query("group == 'all'").set_index("time")
    radii[name] = beam.radius_xy_99_9 / 0.5e-3
axes = radii.plot(xlabel="time, s", ylabel="radius of 99.9 %, matched rms sizes")

# %%
cells = {
    name: run.series.filter(regex=r"cells_\d").iloc[-1].sum()
    for name, run in runs.items()
}
seconds = {name: run.series.seconds.sum() for name, run in runs.items()}
pandas.DataFrame({"cells": cells, "seconds": seconds, "largest radius": radii.max()})

# %% [markdown]
# The mesh that follows the particles gives the radius of the one that is fine everywhere.
#
# ## Phase space at the end
#
# The core is small and dense; a few particles in a thousand are far outside of it.

# %%
beam = runs["follows the particles"].particle_group()
plane = pandas.DataFrame({"x, mm": 1e3 * beam.x, "px, keV/c": 1e-3 * beam.px})
axes = plane.plot.scatter("x, mm", "px, keV/c", s=0.2)
