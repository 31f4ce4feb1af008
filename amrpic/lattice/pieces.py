"""What a lattice is made of, whatever its file: pieces one after the other along the orbit of a reference particle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..mesh.window import axes as axes_of
from ..particles.species import Species
from ..units import SPEED_OF_LIGHT

Kind = Literal["place", "drift", "magnet", "bend", "solenoid", "cavity", "unknown"]


@dataclass(frozen=True)
class Hole:
    """What particles have to pass through, across the orbit."""

    shape: Literal["elliptic", "rectangular"]
    half_widths: tuple[float, float]  # m
    centre: tuple[float, float] = (0.0, 0.0)  # m
    at: Literal["entrance", "exit", "everywhere"] = "entrance"


@dataclass(frozen=True)
class LatticePiece:
    """An element of a lattice; strengths are those for the reference particle, as MAD-X has them."""

    name: str
    kind: Kind
    called: str = ""  # its kind in the file
    length: float = 0.0  # along the orbit, m
    angle: float = 0.0  # of a bend, towards -x, rad
    tilt: float = 0.0  # about the orbit, rad; a tilted bend bends in a tilted plane
    faces: tuple[float, float] = (0.0, 0.0)  # e1, e2 of a bend, from the normals of the orbit, rad
    edge_integrals: tuple[float, float] = (0.0, 0.0)  # ∫ f (1 - f) ds of the fringes of a bend, m
    curvature: float | None = None  # of a bend's field, 1/m, if that is not angle/length
    normal: Mapping[int, float] = field(default_factory=dict)  # K_n, 1/m^(n+1), of thin pieces times length
    skew: Mapping[int, float] = field(default_factory=dict)
    solenoid: float = 0.0  # q B / p, 1/m
    voltage: float = 0.0  # V, at the crest, on the reference particle
    frequency: float = 0.0  # Hz
    phase: float = 0.0  # rad, in which the reference particle arrives, from the crest
    hole: Hole | None = None
    monitor: bool = False
    lacking: tuple[str, ...] = ()  # what of it has no counterpart here


@dataclass(frozen=True)
class Beamline:
    """Pieces in order, and the reference particle that they are for, as far as the file says."""

    pieces: tuple[LatticePiece, ...]
    species: Species | None = None
    momentum: float | None = None  # kg m/s

    @property
    def length(self) -> float:
        """Along the orbit, m."""
        return sum(piece.length for piece in self.pieces)


@dataclass(frozen=True)
class LatticeReference:
    """The particle that a lattice is for."""

    species: Species
    momentum: float  # kg m/s

    @property
    def rigidity(self) -> float:
        """p/q, T m; signed."""
        return self.momentum / self.species.charge

    @property
    def speed(self) -> float:
        """In m/s."""
        over_mc = self.momentum / (self.species.mass * SPEED_OF_LIGHT)
        return SPEED_OF_LIGHT * over_mc / (1 + over_mc**2) ** 0.5


@dataclass(frozen=True, eq=False)
class OrbitFrame:
    """A place on the orbit: x and y across it, z along it."""

    origin: np.ndarray  # (3,) m
    axes: np.ndarray  # (3, 3), rows: x, y and z

    def moved(self, *by: float) -> OrbitFrame:
        """Return the frame moved by lengths along its own axes, m."""
        return OrbitFrame(self.origin + np.array(by) @ self.axes, self.axes)

    def rolled(self, angle: float) -> OrbitFrame:
        """Return the frame turned about z, from x towards y, rad."""
        c, s = math.cos(angle), math.sin(angle)
        return OrbitFrame(self.origin, np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ self.axes)

    def bent(self, angle: float) -> OrbitFrame:
        """Return the frame turned about y, from z towards -x, rad."""
        c, s = math.cos(angle), math.sin(angle)
        return OrbitFrame(self.origin, np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ self.axes)

    @property
    def direction(self) -> tuple[float, float, float]:
        """Of z."""
        x, y, z = self.axes[2].tolist()
        return (x, y, z)

    @property
    def roll(self) -> float:
        """Of x from that of an element with this direction and no roll, rad."""
        x, y, _ = np.array(axes_of(self.direction, 0.0))
        return math.atan2(self.axes[0] @ y, self.axes[0] @ x)


START = OrbitFrame(np.zeros(3), np.eye(3))


def chord(piece: LatticePiece) -> float:
    """Return the length from end to end of a piece, m."""
    half = piece.angle / 2
    return piece.length * (math.sin(half) / half if half else 1.0)


def middle(entry: OrbitFrame, piece: LatticePiece) -> OrbitFrame:
    """Return the frame halfway along the straight line from end to end of a piece, z along it."""
    return entry.rolled(piece.tilt).bent(piece.angle / 2).moved(0, 0, chord(piece) / 2)


def exit_of(entry: OrbitFrame, piece: LatticePiece) -> OrbitFrame:
    """Return the frame behind a piece."""
    half = middle(entry, piece).moved(0, 0, chord(piece) / 2)
    return half.bent(piece.angle / 2).rolled(-piece.tilt)
