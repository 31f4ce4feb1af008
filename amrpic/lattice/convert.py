"""A lattice as elements, apertures and screens of a scene."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import InputError
from .pieces import START, Beamline, Hole, LatticePiece, LatticeReference, OrbitFrame, chord, exit_of, middle

Section = dict[str, Any]  # as a scene file has it
GAP = 0.1  # m, length of a cavity that has none
MULTIPOLES = 6  # orders from 0 that a multipole has


@dataclass(frozen=True)
class LatticeSettings:
    """How a lattice becomes part of a scene."""

    drift_for_missing: bool = False  # what has no counterpart is a drift, or left out of an element
    reach: float = 0.5  # m, from their axes, within which elements act
    thin: float = 1e-3  # m, length of what has none; cavities, whose ends are smooth, get GAP
    start: OrbitFrame = START


@dataclass
class PlacedPiece:
    """A piece, where it is, and what became of it."""

    piece: LatticePiece
    s: float  # m, of its entry
    entry: OrbitFrame
    became: list[str] = field(default_factory=list)


@dataclass
class Converted:
    """What a scene gets of a lattice."""

    reference: LatticeReference
    placed: list[PlacedPiece]
    end: OrbitFrame
    elements: list[Section] = field(default_factory=list)
    apertures: list[Section] = field(default_factory=list)
    screens: list[Section] = field(default_factory=list)


def converted(line: Beamline, reference: LatticeReference, settings: LatticeSettings) -> Converted:
    """Return the sections of a lattice. InputError, by name and place, for what has no counterpart."""
    placed, s, frame = [], 0.0, settings.start
    for piece in line.pieces:
        placed.append(PlacedPiece(piece, s, frame))
        s, frame = s + piece.length, exit_of(frame, piece)
    out = Converted(reference, placed, frame)
    missing = [problem for element in placed for problem in _missing(element)]
    if missing and not settings.drift_for_missing:
        further = f", and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(
            f'{missing[0]}{further}; set missing = "drift" in [lattice] to leave out what has no counterpart'
        )
    names: set[str] = set()
    for element in placed:
        _convert(element, out, settings, names)
    return out


def _missing(element: PlacedPiece) -> list[str]:
    piece = element.piece
    where = f"{piece.name} at s = {element.s:.6g} m"
    if piece.kind == "unknown":
        return [f"{where} is a {piece.called}, which has no counterpart"]
    return [f"{where} has {what}, which has no counterpart" for what in _lacking(piece)]


def _lacking(piece: LatticePiece) -> list[str]:
    out = list(piece.lacking)
    orders = {n for of in (piece.normal, piece.skew) for n, strength in of.items() if strength != 0}
    if piece.kind == "bend" and (any(piece.skew.values()) or orders - {1}):
        out.append("multipoles on a curved orbit")
    if orders and max(orders) >= MULTIPOLES:
        out.append(f"multipoles of order {max(orders)}")
    return out


def _convert(element: PlacedPiece, out: Converted, settings: LatticeSettings, names: set[str]) -> None:
    piece = element.piece
    frame = middle(element.entry, piece)
    makes = {"magnet": _magnet, "bend": _bend, "solenoid": _solenoid, "cavity": _cavity}
    if piece.kind in makes:
        length = chord(piece) or (GAP if piece.kind == "cavity" else settings.thin)
        section = makes[piece.kind](piece, length, out.reference, element)
        if section is not None:
            out.elements.append(
                {"name": piece.name, **_place(frame), "length": length, "reach": settings.reach, **section}
            )
            element.became.append(section["kind"])
    for what in _lacking(piece):
        element.became.append(f"without {what}")
    if piece.hole is not None:
        out.apertures.append(_aperture(element, piece.hole, settings, names))
        element.became.append(f"{piece.hole.shape} aperture")
    if piece.monitor:
        out.screens.append({"name": _word(piece.name, names), **_place(frame), "reach": settings.reach})
        element.became.append("screen")
    if not element.became:
        element.became.append("drift" if piece.length else "–")


def _place(frame: OrbitFrame) -> Section:
    section: Section = {"centre": frame.origin.tolist(), "direction": list(frame.direction)}
    if abs(frame.roll) > 1e-15:
        section["roll"] = frame.roll
    return section


def _magnet(piece: LatticePiece, length: float, reference: LatticeReference, _: PlacedPiece) -> Section | None:
    """A quadrupole where it is nothing else, or a multipole; None without a field."""
    per_length = 1.0 if piece.length else 1 / length
    normal, skew = (
        [reference.rigidity * per_length * of.get(n, 0.0) for n in range(MULTIPOLES)]
        for of in (piece.normal, piece.skew)
    )
    if not any(normal) and not any(skew):
        return None
    if not any(skew) and not any(normal[:1] + normal[2:]):
        return {"kind": "quadrupole", "gradient": normal[1]}
    return {"kind": "multipole", "normal": _trimmed(normal), "skew": _trimmed(skew)}


def _trimmed(strengths: Sequence[float]) -> list[float]:
    last = max((n for n, strength in enumerate(strengths) if strength), default=-1)
    return list(strengths[: last + 1])


def _bend(piece: LatticePiece, length: float, reference: LatticeReference, _: PlacedPiece) -> Section | None:
    curvature = piece.curvature if piece.curvature is not None else piece.angle / (piece.length or length)
    if curvature == 0:
        return None
    entrance, exit = (face - piece.angle / 2 for face in piece.faces)
    gradient = reference.rigidity * piece.normal.get(1, 0.0)
    section = {"kind": "dipole", "field": curvature * reference.rigidity}
    if gradient or any(piece.edge_integrals):
        section |= {"turn": piece.angle, "gradient": gradient, "edge_integrals": list(piece.edge_integrals)}
    return section | {
        key: angle for key, angle in (("entrance_angle", entrance), ("exit_angle", exit)) if abs(angle) > 1e-15
    }


def _solenoid(piece: LatticePiece, _: float, reference: LatticeReference, __: PlacedPiece) -> Section | None:
    return {"kind": "solenoid", "field": piece.solenoid * reference.rigidity} if piece.solenoid else None


def _cavity(piece: LatticePiece, length: float, reference: LatticeReference, element: PlacedPiece) -> Section | None:
    """A gap in which the reference particle, which keeps its speed, gains the voltage at the crest, in its phase."""
    if piece.voltage == 0:
        return None
    omega = 2 * math.pi * piece.frequency
    arrival = (element.s + piece.length / 2) / reference.speed
    phase = (piece.phase - omega * arrival) % (2 * math.pi)
    section = {"kind": "rf-gap", "voltage": piece.voltage / _transit(omega * length / (2 * reference.speed))}
    return section | ({"frequency": piece.frequency, "phase": phase} if omega else {})


def _transit(half: float) -> float:
    """Return ∫ (1 - u²)⁴ cos(half u) du over ∫ (1 - u²)⁴ du, u from -1 to 1: the transit factor of a gap."""
    u, weight = np.polynomial.legendre.leggauss(64)
    profile = weight * (1 - u**2) ** 4
    return float(profile @ np.cos(half * u) / profile.sum())


def _aperture(element: PlacedPiece, hole: Hole, settings: LatticeSettings, names: set[str]) -> Section:
    piece = element.piece
    frames = {
        "entrance": element.entry,
        "exit": exit_of(element.entry, piece),
        "everywhere": middle(element.entry, piece),
    }
    place = _place(frames[hole.at].moved(*hole.centre, 0.0))
    length = chord(piece) if hole.at == "everywhere" and piece.length else settings.thin
    widths = {"kind": hole.shape, "half_widths": list(hole.half_widths)}
    return {"name": _word(piece.name, names), **place, "length": length, "reach": settings.reach, **widths}


def _word(name: str, names: set[str]) -> str:
    """Return a name that files can have, and that no other has."""
    word = re.sub(r"[^\w+-]", "_", name)
    number = 1
    while (out := word if number == 1 else f"{word}_{number}") in names:
        number += 1
    names.add(out)
    return out
