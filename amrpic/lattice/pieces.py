"""What a lattice is made of, whatever its file: pieces one after the other along the orbit of a reference particle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

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
