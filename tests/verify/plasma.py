"""Waves in a plasma: electrons over a background at rest that neutralizes them, between periodic faces, along x.

Lengths follow from CELL and speeds from SPEED, slow enough for the plasma not to be relativistic; times are in 1/ω_p.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.optimize import curve_fit, newton
from scipy.special import ndtri, wofz

from amrpic.mesh.field import Field
from amrpic.particles.clouds import CompensationKind, Shape
from amrpic.particles.uniform_numbers import draw
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from amrpic.verify.described import before_shift
from amrpic.verify.table import Cell, Goal, Table, picture
from exact.runs import states
from exact.sources import EPS0

CELLS = (64, 8, 8)
CELL = 1e-3  # m
LENGTH = CELLS[0] * CELL
SPEED = 3e-3 * SPEED_OF_LIGHT  # of beams and of thermal electrons
DT = 0.2  # of the cold oscillation, 1/ω_p
SHAPES: tuple[Shape, ...] = ("cloud-in-cell", "triangular-shaped-cloud")  # a nearest-grid-point has no linear response


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of waves in a plasma. Collective."""
    yield _oscillations(comm)
    yield _two_stream(comm)
    yield _landau(comm)


# ---- theory ----


def mesh_frequency(kh: float, shape: Shape, dt: float) -> float:
    """The frequency of a cold plasma on the mesh, over ω_p; `kh` is the phase from cell to cell, `dt` the step in 1/ω_p.

    ω² = ω_p² κ / K² Σ_n k_n S(k_n)², with κ = sin(kh) / h of the difference across two cells, K² = (2 sin(kh/2) / h)² of the
    Laplacian, and the cloud S = (sin(kh/2) / (kh/2))^m at all k_n = k + 2π n/h that cells do not distinguish (C. K. Birdsall
    and A. B. Langdon, Plasma Physics via Computer Simulation, 1985, chapter 8). The sum follows from derivatives of
    Σ 1 / (θ + π n) = cot θ, θ = kh/2: it is κ for m = 2 (cloud-in-cell), and κ (1 - sin²θ / 3) for m = 3. Leapfrog makes
    2 sin(ω Δt / 2) / Δt of ω.
    """
    theta = kh / 2
    softened = {"cloud-in-cell": 1.0, "triangular-shaped-cloud": 1 - np.sin(theta) ** 2 / 3}[shape]
    return float(2 / dt * np.arcsin(dt / 2 * np.cos(theta) * np.sqrt(softened)))


def landau_root(k: float, guess: complex = 1.4 - 0.15j) -> complex:
    """ω/ω_p of the least damped wave of Maxwellian electrons, k λ_D = `k`: 1 + (1 + ζ Z(ζ)) / k² = 0, ζ = ω / (√2 k)."""

    def dielectric(omega: complex) -> complex:
        zeta = omega / (np.sqrt(2) * k)
        return 1 + (1 + zeta * 1j * np.sqrt(np.pi) * wofz(zeta)) / k**2

    return complex(newton(dielectric, guess, tol=1e-13))


# ---- runs ----


def wave_of(
    comm: MPI.Comm,
    position: np.ndarray,
    velocity: np.ndarray,
    plasma_frequency: float,
    dt: float,
    steps: int,
    shape: Shape = "cloud-in-cell",
    waves: int = 1,
    compensation: CompensationKind = "none",
) -> tuple[np.ndarray, np.ndarray]:
    """Times in 1/ω_p, and the potential's complex amplitude of so many waves along x, over that of electrons which all lie in
    one plane. Collective.

    Electrons of equal charge at (n, 3) m with (n, 3) m/s, which have this plasma frequency (1/s) together; `dt` in 1/ω_p.
    """
    density = EPS0 * ELECTRON_MASS * (plasma_frequency / ELEMENTARY_CHARGE) ** 2
    size = np.array(CELLS) * CELL
    scene = {
        "domain": {"lower": 0, "upper": size.tolist(), "cells": CELLS, "boundary": "periodic"},
        "background": "neutralizing",
        "bunches": [
            {
                "distribution": "arrays",
                "species": "electron",
                "position": position % size,
                "momenta": ELECTRON_MASS * velocity,
                "charge": -ELEMENTARY_CHARGE * density * float(np.prod(size)),
            }
        ],
        "particles": {"shape": shape, "compensation": compensation},
        "motion": {"kind": "leapfrog", "dt": dt / plasma_frequency},
        "schedule": {"steps": steps},
    }
    k = 2 * np.pi * waves / LENGTH
    largest = -ELEMENTARY_CHARGE * density / (EPS0 * k**2)
    found = [_amplitude(comm, state.phi, waves) / largest for state in states(comm, scene)]
    return dt * np.arange(steps + 1), np.array(found)


def _amplitude(comm: MPI.Comm, phi: Field, waves: int) -> complex:
    """The mean of φ exp(-ikx) over the mesh, V. Collective."""
    total = 0j
    for patch in phi.patches:
        x = np.arange(patch.lower[0], patch.upper[0] + 1) + 0.5
        total += np.exp(-2j * np.pi * waves / CELLS[0] * x) @ patch.data.sum(axis=(1, 2))
    return complex(comm.allreduce(total) / np.prod(CELLS))


def even(per_axis: tuple[int, int, int]) -> np.ndarray:
    """Places of a lattice that fills the domain, (n, 3) m."""
    axes = [(np.arange(n) + 0.5) / n * cells * CELL for n, cells in zip(per_axis, CELLS, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def damped(time: np.ndarray, size: float, phase: float, frequency: float, rate: float) -> np.ndarray:
    """size e^(rate t) cos(frequency t + phase)."""
    return size * np.exp(rate * time) * np.cos(frequency * time + phase)


def fitted_wave(time: np.ndarray, wave: np.ndarray, guess: tuple[float, float, float, float]) -> np.ndarray:
    """Return size, phase, frequency and rate of the `damped` wave that is nearest to values (n,), by least squares.

    Slopes are given by formulas, not taken by differences: phase and rate may end at 1e-8, and steps in proportion to them
    change nothing.
    """

    def slopes(time: np.ndarray, size: float, phase: float, frequency: float, rate: float) -> np.ndarray:
        cosine, sine = (damped(time, 1.0, phase - turn, frequency, rate) for turn in (0, np.pi / 2))
        return np.stack([cosine, -size * sine, -size * time * sine, size * time * cosine], axis=1)

    found, _ = curve_fit(damped, time, wave, guess, jac=slopes)
    return np.asarray(found)


# ---- cold plasma ----


def _oscillations(comm: MPI.Comm) -> Table:
    found = {(shape, waves): _frequency(comm, shape, waves) for shape in SHAPES for waves in (1, 4, 8, 16)}

    def draw(path: Path) -> None:
        with picture(path, "Cold plasma oscillation", "k h", "ω/ω_p") as axes:
            every = np.linspace(0.01, 2, 100)
            for n, shape in enumerate(SHAPES):
                axes.plot(every, [mesh_frequency(kh, shape, DT) for kh in every], f"C{n}-", label=f"mesh, {shape}")
                at = {_angle(waves): frequency for (one, waves), frequency in found.items() if one == shape}
                axes.plot(list(at), list(at.values()), f"C{n}o", label=f"measured, {shape}")

    return Table(
        "Cold plasma oscillation",
        "Electrons at rest, 64×8×8 cells, displaced by a sine wave of 0.1 % of what makes them overtake each other; five "
        "periods, ω_p Δt = 0.2. Frequency ω/ω_p, against that of the mesh, which its difference of the potential across two "
        "cells, its Laplacian, its clouds with all their aliases, and leapfrog give together, and against 1, that of the "
        "continuum.",
        ("cloud", "cells per wave", "measured", "of the mesh", "off the mesh's", "off the continuum's"),
        [_oscillation_row(shape, waves, frequency) for (shape, waves), frequency in found.items()],
        upwards="ω/ω_p",
        picture=draw,
    )


def _oscillation_row(shape: Shape, waves: int, measured: float) -> list[Cell]:
    mesh = mesh_frequency(_angle(waves), shape, DT)
    off = Goal(abs(measured / mesh - 1), 5e-3)
    return [shape, CELLS[0] // waves, f"{measured:.5f}", f"{mesh:.5f}", off, f"{measured - 1:.1e}"]


def _frequency(comm: MPI.Comm, shape: Shape, waves: int) -> float:
    """The measured one, over ω_p. Collective."""
    k = _angle(waves) / CELL
    places = even((1024, 8, 8))
    places[:, 0] += 1e-3 / k * np.sin(k * places[:, 0])
    time, wave = wave_of(comm, places, np.zeros_like(places), 1e8, DT, round(10 * np.pi / DT), shape, waves)
    return float(fitted_wave(time, wave.real / abs(wave[0]), (np.sign(wave[0].real), 0.0, 1.0, 0.0))[2])


def _angle(waves: int) -> float:
    """The phase kh of so many waves along x from cell to cell."""
    return 2 * np.pi * waves / CELLS[0]


# ---- two streams ----


def _two_stream(comm: MPI.Comm) -> Table:
    """Beams of half the density each at ± v: 1 = (ω_p²/2) (1/(ω-kv)² + 1/(ω+kv)²) has its largest growth, ω_p/√8, at
    kv = √(3/8) ω_p."""
    k, growth = 2 * np.pi / LENGTH, 8**-0.5
    plasma_frequency = k * SPEED / np.sqrt(3 / 8)
    lattice, places, velocities = even((256, 8, 8)), [], []
    for sign in (1, -1):
        # Displacements of the growing wave: force over the frequency squared that the beam sees.
        seen = 1j * growth - sign * np.sqrt(3 / 8)
        moved = 1e-6 / k / seen**2 * np.exp(1j * k * lattice[:, 0])
        places.append(lattice + np.outer(moved.real, (1, 0, 0)))
        speed = sign * SPEED + plasma_frequency * (-1j * seen * moved).real
        velocities.append(np.outer(speed, (1, 0, 0)))
    time, wave = wave_of(comm, np.concatenate(places), np.concatenate(velocities), plasma_frequency, 0.1, 400)
    size = np.abs(wave)
    linear = (size < 0.02) & (time < time[np.argmax(size)])
    measured = np.polyfit(time[linear], np.log(size[linear]), 1)[0]

    def draw(path: Path) -> None:
        with picture(path, "Two-stream instability", "ω_p t", "amplitude of φ") as axes:
            axes.semilogy(time, size, label="measured")
            axes.semilogy(time[linear], size[0] * np.exp(growth * time[linear]), "k--", label="theory")

    return Table(
        "Two-stream instability",
        "Two cold electron beams of one density against each other, 64×8×8 cells, one wave of the fastest growth along x, from "
        "its growing mode at 10⁻⁶; ω_p Δt = 0.1. Growth rate over ω_p, fitted until the wave is 2 % of the largest possible "
        "one, against 1/√8, that of the continuum (Birdsall and Langdon, chapter 5).",
        ("measured", "theory", "relative error"),
        [[f"{measured:.4f}", f"{growth:.4f}", Goal(abs(measured / growth - 1), 0.03)]],
        upwards="amplitude of φ",
        picture=draw,
    )


# ---- Landau damping ----


def _landau(comm: MPI.Comm) -> Table:
    k, count, until = 2 * np.pi / LENGTH, 2**20, 20.0
    plasma_frequency = SPEED * k / 0.5
    numbers = draw("sobol", 0, 0, 0, count)
    places = numbers[:3].T * np.array(CELLS) * CELL
    places[:, 0] = before_shift(places[:, 0], 0.01 / k, k)  # density 1 + 0.01 cos kx
    velocities = np.outer(SPEED * ndtri(numbers[3]), (1, 0, 0))
    time, wave = wave_of(comm, places, velocities, plasma_frequency, 0.1, round(until / 0.1))
    root = landau_root(0.5)
    fitted = time > 4.0  # waves that are damped more are gone
    guess = (wave[0].real, 0.0, root.real, root.imag)
    *_, frequency, rate = fitted_wave(time[fitted], wave.real[fitted], guess)

    def draw_wave(path: Path) -> None:
        (size, *_), _ = curve_fit(
            lambda t, size, phase: damped(t, size, phase, root.real, root.imag),
            time[fitted],
            wave.real[fitted],
            guess[:2],
        )
        with picture(path, "Landau damping, kλ_D = 0.5", "ω_p t", "amplitude of φ") as axes:
            axes.semilogy(time, np.abs(wave), label="measured")
            axes.semilogy(time, abs(size) * np.exp(root.imag * time), "k--", label=f"theory, rate {root.imag:.4f} ω_p")

    return Table(
        "Landau damping",
        f"{count} Maxwellian electrons in a quiet start, kλ_D = 0.5, density 1 + 0.01 cos kx, 64×8×8 cells, ω_p Δt = 0.1. "
        f"Frequency and damping rate over ω_p, fitted to 4 < ω_p t < {until:g}, against the root of the dispersion relation "
        "(L. Landau, J. Phys. USSR 10 (1946) 25).",
        ("", "measured", "theory", "relative error"),
        [
            ["frequency", f"{frequency:.4f}", f"{root.real:.4f}", Goal(abs(frequency / root.real - 1), 0.03)],
            ["rate", f"{rate:.4f}", f"{root.imag:.4f}", Goal(abs(rate / root.imag - 1), 0.03)],
        ],
        upwards="amplitude of φ",
        picture=draw_wave,
    )
