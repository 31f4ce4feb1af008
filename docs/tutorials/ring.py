# %% [markdown]
# # A bunch of your own, and a ring of Xsuite
#
# The particles of another code are arrays. `amrpic.SpaceCharge` gives their field; as an element of
# [Xsuite](https://xsuite.readthedocs.io) it kicks them in a ring. `pip install "amrpic[hosts]"` installs both codes.

# %%
import matplotlib.pyplot as plt
import numpy as np
import xtrack
from scipy.special import erf, ndtri
from scipy.stats import qmc

import amrpic
from amrpic.hosts import xsuite
from amrpic.units import VACUUM_PERMITTIVITY

xtrack.settings.print_mode = "suppress"
rng = np.random.default_rng(1)

# %% [markdown]
# ## The field of a bunch
#
# A Gaussian bunch at rest: 1 nC with an rms size of 1 mm, and the exact field beside. Its particles are points of a Sobol sequence, so
# that `compensation` can take back what their clouds smooth.

# %%
charge, sigma, number = 1e-9, 1e-3, 2**17  # C, m
x, y, z = sigma * ndtri(qmc.Sobol(3, seed=1).random(number)).T
r = np.linspace(0.1e-3, 6e-3, 60)
charges = amrpic.SpaceCharge(compensation="clouds-and-mesh")
E = charges.field(x, y, z, charge / number, at=(r, 0 * r, 0 * r))

inside = erf(r / sigma / np.sqrt(2))
inside -= np.sqrt(2 / np.pi) * r / sigma * np.exp(-((r / sigma) ** 2) / 2)
exact = charge * inside / (4 * np.pi * VACUUM_PERMITTIVITY * r**2)
error = np.abs(E[:, 0] - exact).max() / exact.max()
fig, axes = plt.subplots(figsize=(6, 3))
axes.plot(r * 1e3, exact / 1e6, label="exact")
axes.plot(r * 1e3, E[:, 0] / 1e6, ".", label="amrpic")
axes.set(xlabel="x / mm", ylabel="E / (MV/m)", title=f"largest error {error:.1%}")
legend = axes.legend()

# %% [markdown]
# ## A ring
#
# Eight cells of two quadrupoles, for protons at γ = 1.2, and a bunch whose sizes match the cells.

# %%
cell = [
    xtrack.Quadrupole(length=0.1, k1=5.0),
    xtrack.Drift(length=0.8),
    xtrack.Quadrupole(length=0.2, k1=-5.0),
    xtrack.Drift(length=0.8),
    xtrack.Quadrupole(length=0.1, k1=5.0),
]


def ring():
    """Return a line of eight cells."""
    line = xtrack.Line(elements=[part.copy() for _ in range(8) for part in cell])
    line.particle_ref = xtrack.Particles(mass0=xtrack.PROTON_MASS_EV, q0=1, gamma0=1.2)
    return line


bare = ring()
twiss = bare.twiss(method="4d")
beta = np.array([twiss.betx[0], twiss.bety[0]])
print("tunes without charge:", twiss.qx.round(4), twiss.qy.round(4))

# %%
count, protons, emittance = 10_000, 1.7e11, 2.5e-6  # m rad, rms
at, slopes = rng.normal(size=(2, 2, count)) * np.sqrt(emittance)
start = {
    "x": at[0] * np.sqrt(beta[0]),
    "px": slopes[0] / np.sqrt(beta[0]),
    "y": at[1] * np.sqrt(beta[1]),
    "py": slopes[1] / np.sqrt(beta[1]),
    "zeta": rng.normal(size=count),  # m
    "weight": protons / count,
}

# %% [markdown]
# ## Twenty turns
#
# `install_space_charge` puts two kicks into each cell; they share one mesh, which follows the bunch.

# %%
charged = ring()
xsuite.install_space_charge(charged, 16)


def phases(particles):
    """Return the phases of the betatron oscillations in x and y, (2, n), in turns."""
    x, y = particles.x / np.sqrt(beta[0]), particles.y / np.sqrt(beta[1])
    px, py = particles.px * np.sqrt(beta[0]), particles.py * np.sqrt(beta[1])
    return np.arctan2([-px, -py], [x, y]) / (2 * np.pi)


def track(line, turns=20):
    """Return the tunes of all particles (2, n), and their rms sizes (turns + 1, 2)."""
    particles = line.build_particles(**start)
    seen, sizes = [phases(particles)], [(particles.x.std(), particles.y.std())]
    for _ in range(turns):
        line.track(particles, num_turns=1)
        seen.append(phases(particles))
        sizes.append((particles.x.std(), particles.y.std()))
    return np.mean(np.diff(seen, axis=0) % 1, axis=0), np.array(sizes)


tunes, sizes = track(charged)
alone, _ = track(bare)
shift = tunes - alone
print("mean shift of x and y:", shift.mean(axis=1).round(3))
print("largest:", shift.min(axis=1).round(3))

# %% [markdown]
# Space charge defocuses: tunes are lower, most for small amplitudes in the middle of the bunch. The sizes oscillate, since the bunch was
# matched to the ring without charge.

# %%
amplitude = np.hypot(at[0], slopes[0]) / np.sqrt(emittance)
middle = np.abs(start["zeta"]) < 0.5
fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2))
left.plot(amplitude[middle], shift[0, middle], ".", markersize=2)
left.set(xlabel="amplitude in x / rms size", ylabel="shift of its tune")
right.plot(sizes * 1e3, label=["x", "y"])
right.set(xlabel="turn", ylabel="rms size / mm")
right.legend()
fig.tight_layout()
