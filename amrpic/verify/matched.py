"""Beams that their focusing and their own field keep: envelopes of KV beams, emittance of a thermal one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.integrate import solve_ivp

from ..particles.equivalent_beam import line_gradient
from ..run.plan import Plan
from ..run.state import State
from ..run.step import advance, begin
from ..units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from .chosen import scene_of

RADIUS = 1e-3  # m, of the matched KV beam
SIZE = RADIUS / 2
PIPE = 6 * RADIUS  # half width of the square pipe
OMEGA = 1e9  # 1/s, of the oscillation without charge
PERIOD = 2 * math.pi / OMEGA
GRADIENT = -ELECTRON_MASS * OMEGA**2 / ELEMENTARY_CHARGE  # V/m²
DEPRESSION = 0.5


def line_charge(size: float, omega: float = OMEGA, depression: float = DEPRESSION) -> float:
    """C/m of the electrons at rest that are matched with this rms size: (1 - η²) of the focusing is their own field's."""
    return -(1 - depression**2) * ELECTRON_MASS * omega**2 / (ELEMENTARY_CHARGE * line_gradient(1.0, size, size))


def slab(length: float, cells: tuple[int, int, int], levels: int, **more: Any) -> dict[str, Any]:
    return {
        "domain": {
            "lower": [-PIPE, -PIPE, -length / 2],
            "upper": [PIPE, PIPE, length / 2],
            "cells": list(cells),
            "boundary": {"x": "dirichlet", "y": "dirichlet", "z": "periodic"},
        },
        "elements": [{"kind": "constant-focusing", "gradient": [GRADIENT, GRADIENT, 0.0]}],
        "refinement": {"levels": levels, "regrid_every": 10, "rule": {"kind": "charge-density", "relative": 0.02}},
        **more,
    }
