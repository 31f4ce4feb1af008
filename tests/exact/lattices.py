"""A line with all that lattices have, for MAD-X and in PALS, and transfer matrices by tracking without charge."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.scene.lattice_file import LatticeSection
from amrpic.units import SPEED_OF_LIGHT

MADX = """
beam, particle=proton, pc=0.3;
qf: quadrupole, l=0.2, k1=3.0;
qd: quadrupole, l=0.2, k1=-3.0;
qt: quadrupole, l=0.1, k1=1.0, tilt=0.3;
b1: sbend, l=0.5, angle=0.2, e1=0.05, e2=-0.03;
b2: sbend, l=0.4, angle=-0.15;
r1: rbend, l=0.4, angle=0.1;
so: solenoid, l=0.3, ks=0.5;
c1: rfcavity, l=0.0, volt=0.0004, freq=20, lag=0.5;
hk: hkicker, l=0.1, kick=1e-4;
vk: vkicker, l=0.1, kick=2e-4;
sx: sextupole, l=0.1, k2=3;
sq: sequence, l=6, refer=centre;
qf, at=0.3; b1, at=0.9; qd, at=1.5; r1, at=2.0; qt, at=2.5; so, at=3.0; c1, at=3.4; qf, at=3.7; b2, at=4.2;
sx, at=4.6; hk, at=4.9; vk, at=5.2; qd, at=5.5;
endsequence;
"""
PALS = """
PALS:
  facility:
    - begin: {kind: BeginningEle, ReferenceP: {species_ref: proton, pc_ref: 3.0e8}}
    - d: {kind: Drift, length: 0.2}
    - e: {kind: Drift, length: 0.25}
    - qf: {kind: Quadrupole, length: 0.2, MagneticMultipoleP: {Kn1: 3.0}}
    - qd: {inherit: qf, MagneticMultipoleP: {Kn1: -3.0}}
    - qt: {kind: Quadrupole, length: 0.1, MagneticMultipoleP: {Kn1: 1.0, tilt1: 0.3}}
    - b1: {kind: Bend, length: 0.5, BendP: {angle_ref: 0.2, e1: 0.05, e2: -0.03}}
    - b2: {kind: Bend, length: 0.4, BendP: {angle_ref: -0.15}}
    - r1: {kind: Bend, BendP: {angle_ref: 0.1, L_chord: 0.4, e1_rect: 0.0, e2_rect: 0.0}}
    - so: {kind: Solenoid, length: 0.3, SolenoidP: {Ksol: 0.5}}
    - c1: {kind: RFCavity, RFP: {voltage: 4.0e2, frequency: 2.0e7, phase: 0.25}}
    - hk: {kind: Kicker, length: 0.1, MagneticMultipoleP: {Kn0L: -1.0e-4}}
    - vk: {kind: Kicker, length: 0.1, MagneticMultipoleP: {Ks0L: 2.0e-4}}
    - sx: {kind: Sextupole, length: 0.1, MagneticMultipoleP: {Kn2: 3.0}}
    - sq:
        kind: BeamLine
        line: [begin, d, qf, e, b1, e, qd, before_r1: {kind: Drift, length: 0.1999166423547}, r1,
          after_r1: {kind: Drift, length: 0.2499166423547}, qt, f: {kind: Drift, length: 0.3}, so, e, c1, d, qf, d, b2,
          g: {kind: Drift, length: 0.15}, sx, d, hk, d, vk, g: {kind: Drift, length: 0.15}, qd, d: {repeat: 2}]
    - use: sq
"""
FROM_END = 0.2  # m, of a line whose end is a drift, where tracking ends
STEPS = np.array([1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-4])  # of x, px, y, py, ζ, δ


def starts() -> np.ndarray:
    """x, px, y, py, ζ, δ (13, 6) of the reference particle, and of others on either side of it."""
    return np.concatenate([np.zeros((1, 6)), np.diag(STEPS), -np.diag(STEPS)])


def matrix(ends: np.ndarray) -> np.ndarray:
    """The matrix (6, 6) that took `starts` to these."""
    return ((ends[1:7] - ends[7:]) / (2 * STEPS)[:, None]).T


def tracked(file: Path, dt: float | None = None, from_end: float = FROM_END) -> np.ndarray:
    """Where `starts` come to at the end of a lattice, (13, 6), by a run without charge with about this step (s), or "auto".

    It goes to so many m before the end, in a drift."""
    of = LatticeSection(file=str(file)).converted()
    reference, begin = of.reference, starts()
    p0, mc = reference.momentum, reference.species.mass * SPEED_OF_LIGHT
    momenta = p0 * np.stack([begin[:, 1], begin[:, 3], np.zeros(13)], axis=1)
    momenta[:, 2] = p0 * np.sqrt((1 + begin[:, 5]) ** 2 - begin[:, 1] ** 2 - begin[:, 3] ** 2)
    velocity = SPEED_OF_LIGHT * momenta / np.hypot(mc, p0 * (1 + begin[:, 5]))[:, None]
    places = np.stack([begin[:, 0], begin[:, 2], np.zeros(13)], axis=1)
    places += velocity * (begin[:, 4] / reference.speed)[:, None]
    length = sum(one.piece.length for one in of.placed)
    time = (length - from_end) / reference.speed
    scene: dict[str, Any] = {
        "domain": {"lower": -0.05, "upper": 0.05, "cells": 8, "boundary": "open"},
        "lattice": str(file),
        "motion": {"kind": "leapfrog", "window": "reference", "dt": "auto"},
        "bunches": [
            {
                "distribution": "arrays",
                "species": "proton",
                "charge": 1e-25,
                "position": places.tolist(),
                "momenta": momenta.tolist(),
            }
        ],
        "schedule": {"steps": 1},
        "output": {"directory": str(file.parent / "run"), "write": []},
    }
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        if dt is None:
            dt = amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict(scene)).advance().time
        steps = int(np.ceil(time / dt))
        scene["motion"]["dt"], scene["schedule"]["steps"] = time / steps, steps
        run = amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict(scene))
        run.run()
    seen = run.particles.in_laboratory(run.window)
    order = np.argsort(seen.id)
    at, p = (values[order] @ of.end.axes.T for values in (seen.position - of.end.origin, seen.momentum))
    sizes = np.linalg.norm(p, axis=1)
    speeds = SPEED_OF_LIGHT * sizes / np.hypot(mc, sizes)
    arrival = time - at[:, 2] / (speeds * p[:, 2] / sizes)
    across = at[:, :2] - at[:, 2:] * p[:, :2] / p[:, 2:]
    columns = across[:, 0], p[:, 0] / p0, across[:, 1], p[:, 1] / p0, length - reference.speed * arrival, sizes / p0 - 1
    return np.stack(columns, axis=1)
