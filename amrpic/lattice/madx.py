"""Sequences of MAD-X, which xtrack reads: `pip install "amrpic[hosts]"`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..particles.species import SPECIES, Species
from ..units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from .pieces import Beamline, Hole, Kind, LatticePiece

ORDER = 20  # of multipoles that are looked for
SAME = 1e-6  # relative, of masses of one species
MAGNETS = ("Quadrupole", "Sextupole", "Octupole", "Multipole", "Magnet")
PLACES = {"Marker": "place", "Device": "drift", "Drift": "drift"}
MONITORS = ("monitor", "hmonitor", "vmonitor", "instrument")


def read(file: str, line: str | None = None) -> Beamline:
    """Return a sequence of a file; its name may be left out where there is one alone. InputError where there are others."""
    if not Path(file).is_file():
        raise InputError(f"lattice {file} cannot be read; check the path")
    try:
        import xtrack
    except ImportError:
        raise InputError('a lattice of MAD-X needs xtrack; install "amrpic[hosts]"') from None
    try:
        env = xtrack.load(str(file), format="madx")
    except Exception as refused:  # of a parser of another code
        raise InputError(f"xtrack cannot read the lattice {file}: {' '.join(str(refused).split())[:200]}") from None
    lines = env.lines
    if line is None and len(lines) == 1:
        line = next(iter(lines))
    if line not in lines:
        raise InputError(f"lattice {file} has the sequences {', '.join(lines) or 'none'}; name one by line")
    return of_xtrack(lines[line])


def of_xtrack(line: Any) -> Beamline:
    """Return a line of xtrack."""
    elements = line.element_dict
    names = list(line.element_names)
    holes: dict[str, Hole] = {}
    pieces = []
    for name in names:
        element = elements[name]
        if (hole := _hole(element)) is not None:
            holes[name] = hole
            pieces.append(LatticePiece(name, "place", type(element).__name__, hole=hole))
        else:
            pieces.append(_piece(name, element))
    reference = line.particle_ref
    if reference is None:
        return Beamline(tuple(pieces))
    mass, charge = float(reference.mass0), float(reference.q0)  # eV, e
    momentum = float(np.asarray(reference.p0c)[0]) * ELEMENTARY_CHARGE / SPEED_OF_LIGHT
    return Beamline(tuple(pieces), _species(mass, charge), momentum)


def _species(mass: float, charge: float) -> Species:
    """Return one by its rest energy (eV) and its elementary charges."""
    kilograms = mass * ELEMENTARY_CHARGE / SPEED_OF_LIGHT**2
    for species in SPECIES.values():
        if abs(species.mass / kilograms - 1) < SAME and abs(species.charge / ELEMENTARY_CHARGE - charge) < SAME:
            return species
    return Species(name="reference", charge=charge * ELEMENTARY_CHARGE, mass=kilograms)


def _piece(name: str, element: Any) -> LatticePiece:
    called = type(element).__name__
    of = element.to_dict()
    length, tilt = float(of.get("length", 0.0)), float(of.get("rot_s_rad", 0.0))
    shared: dict[str, Any] = {"called": called, "length": length, "tilt": tilt, "lacking": _shifts(of)}
    if called in PLACES:
        kind: Kind = "drift" if length else "place"
        prototype = str(of.get("prototype", "")).split("/")[0]
        return LatticePiece(name, kind, monitor=prototype in MONITORS, **shared)
    if called in MAGNETS:
        normal, skew = _multipoles(of, length)
        return LatticePiece(name, "magnet", normal=normal, skew=skew, **shared)
    if called in ("Bend", "RBend"):
        return _bend(name, of, shared)
    if called in ("UniformSolenoid", "Solenoid"):
        return LatticePiece(name, "solenoid", solenoid=float(of.get("ks", 0.0)), **shared)
    if called == "Cavity":
        lag = math.radians(float(of.get("lag", 0.0))) + float(of.get("phase", 0.0))
        return LatticePiece(
            name,
            "cavity",
            voltage=float(of.get("voltage", 0.0)),
            frequency=float(of.get("frequency", 0.0)),
            phase=lag - math.pi / 2,  # V sin(lag + ω Δt) there, Δt of a late particle
            **shared,
        )
    return LatticePiece(name, "unknown", **shared)


def _bend(name: str, of: Mapping[str, Any], shared: dict[str, Any]) -> LatticePiece:
    """Faces of a sector are measured from the normals of the orbit, those of a rectangle from parallel ones."""
    length, angle = shared["length"], float(of.get("angle", 0.0))
    parallel = angle / 2 if shared["called"] == "RBend" else 0.0
    faces = tuple(parallel + float(of.get(f"edge_{end}_angle", 0.0)) for end in ("entry", "exit"))
    h = angle / length if length else 0.0
    strength = of.get("k0") if of.get("k0_from_h") in (None, False) else None
    normal, skew = _multipoles({**of, "k0": 0.0}, length)
    integrals = tuple(
        2 * float(of.get(f"edge_{end}_fint", 0.0)) * float(of.get(f"edge_{end}_hgap", 0.0)) for end in ("entry", "exit")
    )
    curvature = h if strength is None or isinstance(strength, str) else float(strength)
    of_bend: dict[str, Any] = {"angle": angle, "faces": faces, "curvature": curvature, "edge_integrals": integrals}
    return LatticePiece(name, "bend", normal=normal, skew=skew, **of_bend, **shared)


def _multipoles(of: Mapping[str, Any], length: float) -> tuple[dict[int, float], dict[int, float]]:
    """Return normal and skew strengths, those of thin elements times length."""
    out = []
    for single, integrated in (("k{}", "knl"), ("k{}s", "ksl")):
        strengths: dict[int, float] = {}
        for order, value in enumerate(np.atleast_1d(of.get(integrated, [])).tolist()):
            strengths[order] = value / length if length else value
        for order in range(ORDER):
            if (value := of.get(single.format(order))) is not None and not isinstance(value, str):
                strengths[order] = strengths.get(order, 0.0) + float(value)
        out.append({order: value for order, value in strengths.items() if value})
    normal, skew = out
    return normal, skew


def _shifts(of: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what misplaces an element."""
    return tuple(f"a shift ({key})" for key in ("shift_x", "shift_y", "shift_s") if of.get(key))


def _hole(element: Any) -> Hole | None:
    called, of = type(element).__name__, element.to_dict()
    if called == "LimitEllipse":
        return Hole("elliptic", (math.sqrt(of["a_squ"]), math.sqrt(of["b_squ"])))
    if called == "LimitRect":
        x, y = ((float(of[f"min_{axis}"]), float(of[f"max_{axis}"])) for axis in "xy")
        return Hole("rectangular", ((x[1] - x[0]) / 2, (y[1] - y[0]) / 2), ((x[0] + x[1]) / 2, (y[0] + y[1]) / 2))
    return None
