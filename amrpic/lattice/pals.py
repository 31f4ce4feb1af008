"""Lattices in YAML of the Particle Accelerator Lattice Standard (PALS): names, inheritance and repetition expanded.

What is not understood is refused in one sentence: an unknown key may be what makes a magnet another one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from ..arithmetic import number
from ..errors import InputError
from ..particles.species import SPECIES, Species
from ..units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from .pieces import Beamline, Hole, LatticePiece

Definition = Mapping[str, Any]
OF_LINES = {"repeat", "direction", "inherit", "kind", "line", "periodic", "length", "zero_point", "multipass", "name"}
MAGNETS = {"Quadrupole", "Sextupole", "Octupole", "Multipole", "Kicker"}
PLACES = {"Marker", "BeginningEle", "Instrument", "Fiducial"}
KNOWN = MAGNETS | PLACES | {"Drift", "Bend", "SBend", "RBend", "Solenoid", "RFCavity", "Mask"}
IGNORED = {"MetaP", "TwissP", "FloorP", "TrackingP", "kind", "length", "inherit", "repeat", "direction", "name"}
STRENGTH = re.compile(r"([BK])([ns])(\d+)(L?)$")
DEEPEST = 100  # lines within lines
MOST = 1_000_000  # elements of a line


def read(file: str, line: str | None = None) -> Beamline:
    """Return the line of a file that a name says, else the one that is used. InputError for what is not understood."""
    return _File(file, _facility(file)).line(line)


def _facility(file: str) -> list[Any]:
    try:
        import yaml
    except ImportError:
        raise InputError('a PALS file needs PyYAML; install "amrpic[lattice]"') from None
    try:
        data = yaml.safe_load(Path(file).read_text(encoding="utf-8"))
    except OSError as refused:
        raise InputError(f"lattice {file} cannot be read ({refused.strerror}); check the path") from None
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as refused:
        raise InputError(f"lattice {file} is not YAML: {' '.join(str(refused).split())[:200]}") from None
    top = data.get("PALS") if isinstance(data, Mapping) else None
    members = (top.get("facility") or top.get("elements")) if isinstance(top, Mapping) else None
    if not isinstance(members, list):
        raise InputError(f"lattice {file} has no list PALS: facility; see pals-project.readthedocs.io")
    return members


class _File:
    """The definitions of a file by name."""

    def __init__(self, file: str, members: list[Any]) -> None:
        self.file, self.used = file, ""
        self.definitions: dict[str, Definition] = {}
        self.names: dict[str, float] = {}
        self.lattices: list[str] = []
        self.count = 0  # of elements that lines have been expanded to
        self.of_members(members)

    def of_members(self, members: list[Any]) -> None:
        for member in members:
            if not isinstance(member, Mapping) or len(member) != 1:
                self.refuse(f"{member!r:.60} is no definition; write it as a name with its keys below")
            name, value = next(iter(member.items()))
            if name == "use":
                self.used = str(value)
            elif name in ("constants", "variables"):
                for key, written in value.items() if isinstance(value, Mapping) else ():
                    self.names[key] = self.number(written, key)
            elif not isinstance(value, Mapping):
                self.refuse(f"{name} has no keys; give it a kind")
            elif value.get("kind") == "Lattice":
                self.lattices.append(name)
                self.definitions[name] = value
            elif "kind" in value or "inherit" in value:
                self.definitions[name] = value
            elif name in ("include", "load", "set", "sets", "superimpose", "controllers", "controller"):
                self.refuse(f"{name} is not understood; expand the lattice before")

    def refuse(self, mistake: str) -> NoReturn:
        raise InputError(f"lattice {self.file}: {mistake}")

    def number(self, written: Any, where: str) -> float:
        return number(written, f"lattice {self.file}: {where}", self.names)

    # ---- lines ----
    def line(self, name: str | None) -> Beamline:
        pieces, begins = [], []
        for label, definition, reversed_ in self.expanded(self.root(name), False, 0):
            if definition["kind"] == "BeginningEle":
                begins.append(definition)
            pieces.append((label, definition, reversed_))
        species, momentum = self.reference(begins[0]) if begins else (None, None)
        rigidity = momentum / species.charge if species is not None and momentum is not None else None
        return Beamline(tuple(_Element(self, *one, rigidity).piece() for one in pieces), species, momentum)

    def root(self, name: str | None) -> str:
        """Return the name of a line: of that of a lattice with one branch, where it is not given."""
        name = name or self.used or (self.lattices[-1] if self.lattices else "")
        if not name:
            lines = [label for label, one in self.definitions.items() if one.get("kind") == "BeamLine"]
            name = lines[-1] if lines else ""
        definition = self.definitions.get(name)
        if definition is None:
            self.refuse(f"there is no line {name!r}; name one of {', '.join(self.definitions) or 'none'}")
        if definition.get("kind") != "Lattice":
            return name
        branches = definition.get("branches") or []
        if len(branches) != 1:
            self.refuse(f"{name} has {len(branches)} branches; name a line")
        label, keys = self.item(branches[0], name)
        return str(keys.get("inherit", label))

    def item(self, item: Any, within: str) -> tuple[str, Definition]:
        """Return name and keys of an item of a list."""
        if isinstance(item, str):
            return item, {}
        if isinstance(item, Mapping) and len(item) == 1:
            name, keys = next(iter(item.items()))
            if keys is None or isinstance(keys, Mapping):
                return str(name), keys or {}
        self.refuse(f"{within} has the item {item!r:.60}; give a name, or a name with keys below")

    def resolved(self, name: str, keys: Definition, depth: int = 0) -> Definition:
        """Return a definition with what it inherits; groups are merged key by key."""
        of = keys.get("inherit", name if "kind" not in keys else None)
        if of is None or (of == name and name not in self.definitions and "kind" in keys):
            return keys
        base = self.definitions.get(str(of))
        if base is None or depth > DEEPEST:
            self.refuse(f"{name} is {of!r}, which is not defined")
        below = self.resolved(str(of), base, depth + 1) if base is not keys else base
        merged = dict(below)
        for key, value in keys.items():
            both = isinstance(value, Mapping) and isinstance(below.get(key), Mapping)
            merged[key] = {**below[key], **value} if both else value
        return merged

    def expanded(self, name: str, reversed_: bool, depth: int) -> Iterator[tuple[str, Definition, bool]]:
        """Yield names and definitions of the elements of a line, and whether beams pass them backwards."""
        definition = self.resolved(name, self.definitions.get(name, {}))
        if definition.get("kind") != "BeamLine":
            self.refuse(f"{name} is a {definition.get('kind')}, no BeamLine")
        if depth > DEEPEST:
            self.refuse(f"{name} holds itself")
        self.require_known(name, definition, OF_LINES)
        if "length" in definition:
            self.refuse(f"{name} has a length of its own, which is not understood; end it with a drift")
        items = definition.get("line") or []
        for item in reversed(items) if reversed_ else items:
            label, keys = self.item(item, name)
            if "placement" in keys:
                self.refuse(f"{label} in {name} has a placement, which is not understood; put drifts before it")
            element = self.resolved(label, keys)
            repeat = self.repeat(label, keys)
            backwards = reversed_ != (self.number(keys.get("direction", 1), f"direction of {label}") < 0)
            for _ in range(abs(repeat)):
                if element.get("kind") != "BeamLine":
                    self.count += 1
                    if self.count > MOST:
                        self.refuse(f"its line has more than {MOST} elements, with {label} in {name}; correct repeat")
                    yield label, element, backwards
                    continue
                inner = str(keys.get("inherit", label))
                members = list(self.expanded(inner, backwards, depth + 1))
                yield from reversed(members) if repeat < 0 else members

    def repeat(self, label: str, keys: Definition) -> int:
        """Return how often an item of a line follows itself, negative: backwards."""
        times = self.number(keys.get("repeat", 1), f"repeat of {label}")
        if times != int(times):
            self.refuse(f"repeat of {label} is {times:g}; give a whole number")
        return int(times)

    def require_known(self, name: str, keys: Definition, allowed: set[str]) -> None:
        for key in keys:
            if key not in allowed and not isinstance(keys[key], Mapping):
                self.refuse(f"{name} has the unknown key {key!r}")

    # ---- the reference particle ----
    def reference(self, begin: Definition) -> tuple[Species | None, float | None]:
        of = begin.get("ReferenceP") or {}
        name = str(of.get("species_ref", "")).lstrip("#")
        species = next((member for label, member in SPECIES.items() if label.lower() == name.lower()), None)
        if name and species is None:
            self.refuse(f"species_ref is {name!r}; use one of {', '.join(SPECIES)}, or give species in [lattice]")
        if species is None:
            return None, None
        rest_energy = species.mass * SPEED_OF_LIGHT**2 / ELEMENTARY_CHARGE  # eV
        if "pc_ref" in of:
            pc = self.number(of["pc_ref"], "pc_ref")
        elif "E_tot_ref" in of:
            total = self.number(of["E_tot_ref"], "E_tot_ref")
            if not total > rest_energy:
                self.refuse(f"E_tot_ref is {total:g} eV, of a {name} of {rest_energy:g} eV; give the total energy")
            pc = math.sqrt(total**2 - rest_energy**2)
        else:
            return species, None
        return species, pc * ELEMENTARY_CHARGE / SPEED_OF_LIGHT


class _Element:
    """One element of a file, as a piece."""

    def __init__(self, file: _File, name: str, definition: Definition, backwards: bool, rigidity: float | None) -> None:
        self.file, self.name, self.of, self.backwards, self.rigidity = file, name, definition, backwards, rigidity

    def piece(self) -> LatticePiece:
        kind = self.of.get("kind")
        length = self.number("length", self.of, 0.0)
        piece = LatticePiece(self.name, "unknown", str(kind), length)
        used = set(IGNORED) | {"ApertureP", "ReferenceP"}
        if kind in PLACES:
            piece = replace(piece, kind="drift" if length else "place", monitor=kind == "Instrument")
        elif kind in ("Drift", "Mask"):
            piece = replace(piece, kind="drift")
        elif kind in MAGNETS:
            piece = replace(piece, kind="magnet", **self.multipoles(length))
            used.add("MagneticMultipoleP")
        elif kind in ("Bend", "SBend", "RBend"):
            piece = self.bend(piece)
            used |= {"BendP", "MagneticMultipoleP"}
        elif kind == "Solenoid":
            piece = replace(piece, kind="solenoid", solenoid=self.solenoid())
            used.add("SolenoidP")
        elif kind == "RFCavity":
            piece = self.cavity(piece)
            used.add("RFP")
        lacking = [group for group, keys in self.of.items() if group not in used and self.says_something(group, keys)]
        return replace(piece, hole=self.hole(), lacking=(*piece.lacking, *lacking))

    def says_something(self, group: str, keys: Any) -> bool:
        """Whether a group matters; those of extensions, which do not end in P, do not."""
        if not isinstance(keys, Mapping):
            self.file.refuse(f"{self.name} has the unknown key {group!r}")
        return group.endswith("P") and any(value not in (0, 0.0, None, False) for value in keys.values())

    def number(self, key: str, of: Definition, default: float) -> float:
        value = of.get(key, default)
        return default if value is None else self.file.number(value, f"{key} of {self.name}")

    def group(self, name: str, allowed: set[str]) -> Definition:
        of = self.of.get(name) or {}
        if not isinstance(of, Mapping):
            self.file.refuse(f"{name} of {self.name} has no keys")
        for key in of:
            if key not in allowed:
                self.file.refuse(f"{name} of {self.name} has the unknown key {key!r}")
        return of

    def normalised(self, key: str, strength: float) -> float:
        """Return a strength over the rigidity of the reference particle, if it is a field."""
        if key[0] == "K":
            return strength
        if self.rigidity is None:
            self.file.refuse(
                f"{key} of {self.name} is a field, but no BeginningEle says species and momentum (ReferenceP)"
            )
        return strength / self.rigidity

    def multipoles(self, length: float) -> dict[str, Any]:
        """Return normal and skew strengths, those of thin elements times length; a tilt apart where there is one multipole."""
        of = self.of.get("MagneticMultipoleP") or {}
        strengths: dict[str, dict[int, float]] = {"n": {}, "s": {}}
        for key in of:
            match = STRENGTH.match(key)
            if match is None and not re.match(r"tilt\d+$", key):
                self.file.refuse(f"MagneticMultipoleP of {self.name} has the unknown key {key!r}")
            if match is not None:
                field, component, order, integrated = match.groups()
                value = self.normalised(field, self.number(key, of, 0.0))
                if integrated and length:
                    value /= length
                if not integrated and not length and value:
                    self.file.refuse(f"{key} of {self.name} has no length; give {key}L")
                strengths[component][int(order)] = value
        tilts = {int(key[4:]): self.number(key, of, 0.0) for key in of if key.startswith("tilt")}
        orders = {order for strength in strengths.values() for order, value in strength.items() if value}
        if len(orders) == 1 and orders == {order for order, tilt in tilts.items() if tilt}:
            return {"normal": strengths["n"], "skew": strengths["s"], "tilt": tilts[orders.pop()]}
        for order, tilt in tilts.items():
            n, s = (strengths[component].get(order, 0.0) for component in "ns")
            c, sine = math.cos((order + 1) * tilt), math.sin((order + 1) * tilt)
            strengths["n"][order], strengths["s"][order] = n * c + s * sine, s * c - n * sine
        return {"normal": strengths["n"], "skew": strengths["s"]}

    def bend(self, piece: LatticePiece) -> LatticePiece:
        allowed = {"angle_ref", "bend_field_ref", "e1", "e2", "e1_rect", "e2_rect", "edge1_int", "edge2_int", "g_ref"}
        allowed |= {"h1", "h2", "L_chord", "ref_coords", "ref_geometry", "rho_ref", "radius_ref", "tilt_ref"}
        of = self.group("BendP", allowed | {"multipole_type"})
        geometry = str(of.get("ref_geometry", of.get("ref_coords", "arc"))).lower()
        if geometry not in ("arc", "chord"):
            self.file.refuse(f"{self.name} has the reference {geometry}, which is not understood; use arc or chord")
        length, angle = self.shape(piece.length, of)
        faces = self.faces(of, angle)
        curved = any(self.number(key, of, 0.0) for key in ("h1", "h2"))
        lacking: tuple[str, ...] = ("curved pole faces",) if curved else ()
        multipoles = self.multipoles(length)
        if multipoles.pop("tilt", 0.0):
            lacking += ("a tilted multipole",)
        dipole = multipoles["normal"].pop(0, 0.0)
        if multipoles["skew"].pop(0, 0.0):
            lacking += ("a field in the plane of the bend",)
        curvature = (angle / length if length else 0.0) + dipole
        tilt = self.number("tilt_ref", of, 0.0)
        entrance, exit = (2 * self.number(f"edge{end}_int", of, 0.0) for end in (1, 2))  # of half a gap there
        integrals = (exit, entrance) if self.backwards else (entrance, exit)
        bend = replace(piece, kind="bend", length=length, angle=angle, faces=faces, tilt=tilt, curvature=curvature)
        return replace(bend, lacking=lacking, edge_integrals=integrals, **multipoles)

    def shape(self, length: float, of: Definition) -> tuple[float, float]:
        """Return length and angle, of which two of length, angle and curvature are given."""
        curvature = None
        for key in ("g_ref", "rho_ref", "radius_ref", "bend_field_ref"):
            if of.get(key) not in (None, 0, 0.0):
                value = self.number(key, of, 0.0)
                curvature = value if key == "g_ref" else 1 / value if key != "bend_field_ref" else None
                curvature = self.normalised("B", value) if curvature is None else curvature
        angle = self.number("angle_ref", of, 0.0) if "angle_ref" in of else None
        if "L_chord" in of and not length:
            chord = self.number("L_chord", of, 0.0)
            if angle is None:
                angle = 2 * math.asin((curvature or 0.0) * chord / 2)
            length = chord * (angle / 2) / math.sin(angle / 2) if angle else chord
        if angle is None:
            angle = (curvature or 0.0) * length
        if not length and curvature:
            length = angle / curvature
        if curvature is not None and abs(angle - curvature * length) > 1e-6 * abs(angle):
            self.file.refuse(f"{self.name} has an angle of {angle:g}, but {curvature * length:g} by its curvature")
        return length, angle

    def faces(self, of: Definition, angle: float) -> tuple[float, float]:
        """Return e1 and e2 in the order in which beams pass them."""

        def face(key: str) -> float:
            if f"{key}_rect" in of:
                return self.number(f"{key}_rect", of, 0.0) + angle / 2
            return self.number(key, of, angle / 2 if self.of.get("kind") == "RBend" else 0.0)

        entrance, exit = face("e1"), face("e2")
        return (exit, entrance) if self.backwards else (entrance, exit)

    def solenoid(self) -> float:
        of = self.group("SolenoidP", {"Ksol", "Bsol"})
        if "Bsol" in of:
            return self.normalised("B", self.number("Bsol", of, 0.0))
        return self.number("Ksol", of, 0.0)

    def cavity(self, piece: LatticePiece) -> LatticePiece:
        allowed = {"frequency", "voltage", "gradient", "phase", "zero_phase", "cavity_type", "num_cells", "harmon"}
        of = self.group("RFP", allowed | {"multipass_phase", "num_cells", "L_active"})
        if of.get("harmon") or of.get("multipass_phase"):
            self.file.refuse(f"{self.name} has a harmonic number or a multipass phase; give its frequency and phase")
        if str(of.get("cavity_type", "STANDING_WAVE")) != "STANDING_WAVE":
            piece = replace(piece, lacking=("a travelling wave",))
        zero = {"ACCELERATING": 0.0, "BELOW_TRANSITION": -0.25, "ABOVE_TRANSITION": 0.25}.get(
            str(of.get("zero_phase", "ACCELERATING"))
        )
        if zero is None:
            self.file.refuse(f"{self.name} has the zero_phase {of['zero_phase']!r}, which is not understood")
        voltage = self.number("voltage", of, 0.0) or self.number("gradient", of, 0.0) * piece.length
        phase = 2 * math.pi * (self.number("phase", of, 0.0) + zero)
        return replace(piece, kind="cavity", voltage=voltage, frequency=self.number("frequency", of, 0.0), phase=phase)

    def hole(self) -> Hole | None:
        of = self.of.get("ApertureP") or {}
        where = str(of.get("location", "ENTRANCE_END"))
        if not of or where == "NOWHERE" or of.get("aperture_active") is False:
            return None
        shape = str(of.get("shape", "ELLIPTICAL"))
        at = {"ENTRANCE_END": "entrance", "EXIT_END": "exit", "EVERYWHERE": "everywhere"}.get(where)
        if shape not in ("ELLIPTICAL", "RECTANGULAR") or at is None:
            self.file.refuse(f"{self.name} has a {shape} aperture at {where}, which is not understood")
        sides = [self.side(of, axis) for axis in "xy"]
        if shape == "ELLIPTICAL" and any(math.isinf(half) for _, half in sides):
            return None
        (x, width), (y, height) = sides
        return Hole(
            "elliptic" if shape == "ELLIPTICAL" else "rectangular",
            (width, height),
            (x, y),
            at,  # type: ignore[arg-type]
        )

    def side(self, of: Definition, axis: str) -> tuple[float, float]:
        """Return middle and half width of a hole along an axis, m; far sides where none is given."""
        if f"{axis}_width" in of:
            return self.number(f"{axis}_center", of, 0.0), self.number(f"{axis}_width", of, 0.0) / 2
        ends = [self.number(f"{axis}_{end}", of, math.inf) for end in ("min", "max")]
        lower, upper = (sign * FAR if math.isinf(end) else end for end, sign in zip(ends, (-1, 1), strict=True))
        return (lower + upper) / 2, (upper - lower) / 2


FAR = 1e3  # m, where a side of a hole is that has none
