# %% [markdown]
# # Reading results
#
# A run leaves a folder. `amrpic.open` reads it: tables, fields, particles and losses, each when it is asked for. First, a small run: a
# bunch of electrons that flies through a hole in a plate.

# %%
import amrpic

scene = amrpic.Scene(
    name="plate",
    domain=amrpic.Domain(
        lower=(-0.01, -0.01, -0.02), upper=(0.01, 0.01, 0.02), cells=(16, 16, 32)
    ),  # m
    bunches=[
        amrpic.GaussianBunch(
            species="electron",
            centre=(0, 0, "-10 mm"),
            sigma="1.5 mm",
            charge="-5 pC",
            particles=20_000,
            velocity=(0, 0, "0.2 c"),
        )
    ],
    refinement=amrpic.Refinement(levels=1),
    apertures=[
        amrpic.RoundAperture(
            name="plate", centre=(0, 0, 0), length="1 mm", radius="2.5 mm"
        )
    ],
    motion=amrpic.Leapfrog(dt="20 ps"),
    schedule={"steps": 16},
    output={
        "write": ["series", "fields", "particles", "losses"],
        "fields_every": 8,
        "particles_every": 8,
    },
)
amrpic.Simulation(scene).run(log="silent")
results = amrpic.open("runs/plate")
results

# %% [markdown]
# ## Tables
#
# `series` has a row per step, `residuals` those of each solve, `beam` emittances and Twiss parameters. Units are in `attrs`.

# %%
series = results.series
series.attrs["units"]["rms_x"], series.attrs["units"]["kinetic_energy"]

# %%
axes = series.plot("time", ["rms_x", "rms_z"], xlabel="time, s", ylabel="rms size, m")

# %% [markdown]
# ## Fields
#
# `fields[step]` holds φ, ρ and **E** on all levels. A slice is an array of the finest values in a plane:

# %%
fields = results.fields[8]
plane = fields.phi.slice("x", 0.0)
plane.values.shape, plane.values.min()

# %%
fields.E.magnitude().plot("x", 0.0, name="|E|")

# %% [markdown]
# xarray, yt and PyVista take fields as they are; of xarray it is one level, with coordinates in m.

# %%
phi = fields.phi.to_xarray(level=0)
axes = phi.sel(x=0, y=0, method="nearest").plot()

# %%
import yt

yt.set_log_level("error")
data = fields.phi.to_yt("phi")
data.find_min("phi")

# %% [markdown]
# ## Particles
#
# A `ParticleGroup` of openPMD-beamphysics knows the statistics of beams. `results.particles(step)` gives plain arrays instead.

# %%
beam = results.particle_group(16)
beam.n_particle, beam["sigma_x"], beam["norm_emit_x"]

# %% [markdown]
# ## Losses
#
# A row per lost particle: where, when, with which momentum, and at what.

# %%
losses = results.losses
losses.groupby("at").agg(
    particles=("id", "size"), first=("time", "min"), last=("time", "max")
)

# %%
axes = losses.plot.scatter("x", "y", s=1, title="where the plate was hit")
axes.set_aspect("equal")

# %% [markdown]
# ## The scene
#
# What was run is there as well, to be run again with other values:

# %%
again = results.scene.replace(
    name="narrower", apertures=[results.scene.apertures[0].replace(radius="1.5 mm")]
)
len(amrpic.Simulation(again).run(log="silent").losses)
