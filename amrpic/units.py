"""Physical quantities as people write them: SI numbers, or strings such as "2.5 mm" and "100 pC"."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from . import _native
from .errors import InputError

# CODATA 2022; the charge and the speed of light are exact.
ELEMENTARY_CHARGE = 1.602176634e-19  # C
SPEED_OF_LIGHT = 299792458.0  # m/s
VACUUM_PERMITTIVITY = _native.vacuum_permittivity  # F/m
ELECTRON_MASS = 9.1093837139e-31  # kg
PROTON_MASS = 1.67262192595e-27  # kg
DEUTERON_MASS = 3.3435837768e-27  # kg
ALPHA_MASS = 6.6446573450e-27  # kg

_ENERGY = {
    "J": 1.0,
    **{f"{p}eV": f * ELEMENTARY_CHARGE for p, f in {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}.items()},
}

# One table per kind of quantity; the first unit is the SI unit that plain numbers are in.
UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "nm": 1e-9, "km": 1e3},
    "emittance": {
        "m rad": 1.0,
        "mm mrad": 1e-6,
        "um rad": 1e-6,
        "nm rad": 1e-9,
        "m": 1.0,
        "mm": 1e-3,
        "um": 1e-6,
        "nm": 1e-9,
    },
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "ps": 1e-12, "fs": 1e-15},
    "charge": {
        "C": 1.0,
        **{"mC": 1e-3, "uC": 1e-6, "µC": 1e-6, "nC": 1e-9, "pC": 1e-12, "fC": 1e-15, "e": ELEMENTARY_CHARGE},
    },
    "mass": {
        "kg": 1.0,
        **{f"{unit}/c^2": value / SPEED_OF_LIGHT**2 for unit, value in _ENERGY.items() if unit.endswith("eV")},
        "u": 1.66053906892e-27,
    },
    "momentum": {
        "kg m/s": 1.0,
        **{f"{unit}/c": value / SPEED_OF_LIGHT for unit, value in _ENERGY.items() if unit.endswith("eV")},
    },
    "velocity": {"m/s": 1.0, "km/s": 1e3, "mm/ns": 1e6, "c": SPEED_OF_LIGHT},
    "energy": _ENERGY,
    "charge density": {
        "C/m^3": 1.0,
        "uC/m^3": 1e-6,
        "nC/m^3": 1e-9,
        "pC/mm^3": 1e-3,
        "nC/mm^3": 1.0,
        "e/m^3": ELEMENTARY_CHARGE,
    },
    "potential": {"V": 1.0, "mV": 1e-3, "kV": 1e3, "MV": 1e6},
    "field": {"V/m": 1.0, "kV/m": 1e3, "MV/m": 1e6, "GV/m": 1e9},
    "duration": {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0},
}

PREFIXES = {1e9: "G", 1e6: "M", 1e3: "k", 1.0: "", 1e-3: "m", 1e-6: "µ", 1e-9: "n", 1e-12: "p", 1e-15: "f"}

_NUMBER = r"[-+]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*")


def complaint(what: str, remedy: str, *, path: str = "", found: Any = None) -> PydanticCustomError:
    """Return a validation error that already knows its wording: what is wrong, and what to do about it.

    `path` is relative to the section that is being validated; `found` replaces the value that pydantic would report.
    """
    # Braces in the message would be read as placeholders by pydantic, so the words travel as context.
    return PydanticCustomError(
        "amrpic", "{what}; {remedy}", {"what": what, "remedy": remedy, "path": path, "found": found}
    )


def to_si(value: Any, kind: str) -> float:
    """Return `value` in the SI unit of `kind`; plain numbers are taken to be in that unit already."""
    table = UNITS[kind]
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise complaint(f"is not a {kind}", f"write a number in {next(iter(table))} or a string {_example(kind)}")
    if not isinstance(value, str):
        return _finite(float(value) if abs(value) <= sys.float_info.max else math.inf, kind)  # an int has no limit
    match = _QUANTITY.fullmatch(value)
    number, unit = match.groups() if match else ("", "")
    if not match or not unit:
        raise complaint(
            f"is not a {kind} with a unit", f"write a string {_example(kind)}, or a plain number in {next(iter(table))}"
        )
    if unit not in table:
        raise complaint(f'has the unit "{unit}", which is not a {kind}', f"use one of {', '.join(table)}")
    return _finite(_scaled(number, table[unit]), kind)


@dataclass(frozen=True)
class Quantity:
    """Annotation of a field that holds a quantity in SI units and accepts it with a unit."""

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(lambda value: to_si(value, self.kind), handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        # The pattern constrains strings alone, limits constrain numbers alone.
        units = "|".join(UNITS[self.kind]).replace("^", r"\^")
        pattern = rf"^\s*{_NUMBER}\s*({units})\s*$"
        unit = next(iter(UNITS[self.kind]))
        return {**handler(schema), "type": ["number", "string"], "pattern": pattern, "unit": unit}


@dataclass(frozen=True)
class Spread:
    """Annotation of a triple: a single value stands for all three axes."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(_spread, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        one = handler(schema)["prefixItems"][0]
        return {"anyOf": [one, {"type": "array", "items": one, "minItems": 3, "maxItems": 3}]}


def prefix_of(largest: float) -> tuple[float, str]:
    """Return the SI prefix, as a factor and a letter, that brings the largest magnitude between 1 and 1000."""
    for factor, letter in PREFIXES.items():
        if abs(largest) >= 0.9995 * factor:
            return factor, letter
    return 1.0, ""


def quantity(value: float, unit: str, like: float | None = None) -> str:
    """Return a number with its unit, in the prefix that suits it, or `like`."""
    factor, letter = prefix_of(value if like is None else like)
    # To a thousandth of what it is compared with: the centre of a cloud of particles is not known better.
    digits = 3 - len(f"{abs(value if like is None else like) / factor:.0f}")
    return f"{round(value / factor, digits + 1) + 0.0:g} {letter}{unit}".replace("-", "−")


def to_seconds(text: str) -> float:
    """Return a duration in s, written as "01:30:00", "90 min" or a number of seconds. Raises InputError."""
    try:
        if ":" in text:
            return float(sum(int(part) * 60**power for power, part in enumerate(reversed(text.split(":")))))
        return float(text) if re.fullmatch(r"[\d.]+", text) else to_si(text, "duration")
    except (ValueError, PydanticCustomError):
        raise InputError(
            f'"{text}" is not a duration; write it as "01:30:00", "90 min" or a number of seconds'
        ) from None


def to_metres(text: str) -> float:
    """Return a length in m, written as "2.5 mm" or a number of metres. Raises InputError."""
    try:
        return to_si(float(text) if re.fullmatch(_NUMBER, text) else text, "length")
    except PydanticCustomError:
        raise InputError(f'"{text}" is not a length; write it as "2.5 mm" or a number of metres') from None


def _spread(value: Any) -> Any:
    if isinstance(value, (int, float, str)):
        return (value, value, value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise complaint("does not hold one value per axis", "write three values such as [x, y, z], or one for all axes")
    return tuple(value)


def _scaled(number: str, unit: float) -> float:
    # In decimal, so that "28.28 mm" is the float nearest to 0.02828.
    return float(Decimal(number) * Decimal(repr(unit)))


def _finite(value: float, kind: str) -> float:
    if not math.isfinite(value):
        raise complaint(f"is not a finite {kind}", "write a finite number")
    return value


def _example(kind: str) -> str:
    table = list(UNITS[kind])
    return f'such as "2.5 {table[1] if len(table) > 1 else table[0]}"'


Length = Annotated[float, Quantity("length")]
Emittance = Annotated[float, Quantity("emittance")]
Time = Annotated[float, Quantity("time")]
Charge = Annotated[float, Quantity("charge")]
Mass = Annotated[float, Quantity("mass")]
Momentum = Annotated[float, Quantity("momentum")]
Velocity = Annotated[float, Quantity("velocity")]
ChargeDensity = Annotated[float, Quantity("charge density")]
Potential = Annotated[float, Quantity("potential")]
FieldStrength = Annotated[float, Quantity("field")]
Length3 = Annotated[tuple[Length, Length, Length], Spread()]
Momentum3 = Annotated[tuple[Momentum, Momentum, Momentum], Spread()]
Velocity3 = Annotated[tuple[Velocity, Velocity, Velocity], Spread()]
Index3 = Annotated[tuple[int, int, int], Spread()]

#: Charge (C) and mass (kg) of one particle of the species that have a name.
SPECIES: dict[str, tuple[float, float]] = {
    "electron": (-ELEMENTARY_CHARGE, ELECTRON_MASS),
    "positron": (ELEMENTARY_CHARGE, ELECTRON_MASS),
    "proton": (ELEMENTARY_CHARGE, PROTON_MASS),
    "antiproton": (-ELEMENTARY_CHARGE, PROTON_MASS),
    "deuteron": (ELEMENTARY_CHARGE, DEUTERON_MASS),
    "alpha": (2 * ELEMENTARY_CHARGE, ALPHA_MASS),
    "H-": (-ELEMENTARY_CHARGE, PROTON_MASS + 2 * ELECTRON_MASS),
}
