# %% [markdown]
# # A bunch from Python
#
# An electron bunch spreads in its own field. It is made in Python, taken through ten steps one by one, looked at, solved again with
# another charge, run to its end, and read back. Everything happens in this one process.

# %%
import amrpic

bunch = amrpic.GaussianBunch(
    species="electron", sigma="2 mm", charge="-20 pC", particles=50_000
)
scene = amrpic.Scene(
    name="bunch",
    domain=amrpic.Domain(lower=-0.02, upper=0.02, cells=32),  # m; its faces are open
    bunches=[bunch],
    refinement=amrpic.Refinement(levels=2),
    motion=amrpic.Leapfrog(dt="20 ps"),
    schedule={"steps": 30},
    diagnostics={"every": 1},
)
simulation = amrpic.Simulation(scene)

# %% [markdown]
# ## Ten steps, one by one
#
# `advance` takes a step and returns the state after it. It writes no files. `for state in simulation` would go on to the last step.

# %%
for _ in range(10):
    now = simulation.advance()
    print(f"step {now.step:2}: rms size {now.moments().rms[0]:.6f} m")

# %% [markdown]
# ## The potential
#
# The plane z = 0, with the boxes of each level. At each place the value of the finest cell is shown, constant in the cell.

# %%
simulation.phi.plot("z", 0.0, name="φ")

# %% [markdown]
# ## Another charge, another solve
#
# Fields are numbers on the cells of all levels, with arithmetic. Here a uniform ball of the opposite charge is put over the bunch, and
# Poisson's equation is solved for both.

# %%
ball = amrpic.Field(simulation.hierarchy, "C/m^3")
ball.fill(lambda x, y, z: 1.0 * (x**2 + y**2 + z**2 < 0.008**2))
rho = simulation.rho - ball * (simulation.rho.integral() / ball.integral())
phi, report = amrpic.PoissonSolver(simulation.hierarchy, tolerance=1e-8).solve(rho)
phi.line((-0.02, 0, 0), (0.02, 0, 0)).plot()

# %%
report

# %% [markdown]
# Outside of the ball nothing is left of the field: the charges cancel.
#
# ## The rest of the run, read back
#
# `run` goes on from step 10 to the last one and writes what the scene asks for into `runs/bunch`. Later, or in another program,
# `amrpic.open("runs/bunch")` reads it.

# %%
simulation.run(log="silent")
results = amrpic.open("runs/bunch")
results

# %% [markdown]
# Tables are data frames of pandas. The field of a Gaussian bunch is not linear, so it raises the emittance:

# %%
beam = results.beam.query("group == 'all'")
axes = beam.plot("time", ["emittance_x", "emittance_y", "emittance_z"])
