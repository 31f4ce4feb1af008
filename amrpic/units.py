"""Constants of physics, the units that scenes know, and numbers with units as text."""

from __future__ import annotations

import math
from dataclasses import dataclass

from . import _native

# CODATA 2022; the charge, the speed of light and Boltzmann's constant are exact.
ELEMENTARY_CHARGE = 1.602176634e-19  # C
SPEED_OF_LIGHT = 299792458.0  # m/s
VACUUM_PERMITTIVITY = _native.vacuum_permittivity  # F/m
BOLTZMANN = 1.380649e-23  # J/K
ELECTRON_MASS = 9.1093837139e-31  # kg
PROTON_MASS = 1.67262192595e-27  # kg
DEUTERON_MASS = 3.3435837768e-27  # kg
ALPHA_MASS = 6.6446573450e-27  # kg

_ENERGY = {
    "J": 1.0,
    **{f"{p}eV": f * ELEMENTARY_CHARGE for p, f in {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}.items()},
    **{"mJ": 1e-3, "uJ": 1e-6, "µJ": 1e-6, "nJ": 1e-9, "pJ": 1e-12},
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
    "current": {"A": 1.0, "mA": 1e-3, "uA": 1e-6, "µA": 1e-6, "nA": 1e-9, "kA": 1e3},
    "current density": {"A/m^2": 1.0, "A/cm^2": 1e4, "mA/cm^2": 10.0, "A/mm^2": 1e6},
    "temperature": {"K": 1.0},
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
    "magnetic field": {"T": 1.0, "mT": 1e-3, "G": 1e-4, "kG": 0.1},
    "gradient": {"T/m": 1.0, "mT/m": 1e-3, "G/cm": 1e-2},
    "electric gradient": {"V/m^2": 1.0, "kV/m^2": 1e3, "MV/m^2": 1e6},
    "wave number": {"1/m": 1.0, "1/cm": 1e2, "1/mm": 1e3},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "density": {"kg/m^3": 1.0, "g/cm^3": 1e3},
    "energy per area": {"J/m^2": 1.0, "mJ/m^2": 1e-3, "kJ/m^2": 1e3},
    "acceleration": {"m/s^2": 1.0},
    "duration": {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0},
}

PREFIXES = {1e9: "G", 1e6: "M", 1e3: "k", 1.0: "", 1e-3: "m", 1e-6: "µ", 1e-9: "n", 1e-12: "p", 1e-15: "f"}


def prefix_of(largest: float) -> tuple[float, str]:
    """Return the SI prefix, as a factor and a letter, that brings the largest magnitude between 1 and 1000."""
    for factor, letter in PREFIXES.items():
        if abs(largest) >= 0.9995 * factor:
            return factor, letter
    return 1.0, ""


def falls_short(value: float, advised: float) -> bool:
    """Whether a value is below one that is advised by more than 1 %: people round what they are advised."""
    return value < 0.99 * advised


def quantity(value: float, unit: str, like: float | None = None) -> str:
    """Return a number with its unit, in the prefix that suits it, or `like`."""
    factor, letter = prefix_of(value if like is None else like)
    # To a thousandth of what it is compared with: the centre of a cloud of particles is not known better.
    digits = 3 - len(f"{abs(value if like is None else like) / factor:.0f}")
    return f"{round(value / factor, digits + 1) + 0.0:g} {letter}{unit}"


@dataclass(frozen=True)
class Column:
    """A column of a table: its name, its unit, and whether it counts something or is a text instead of a number."""

    name: str
    unit: str = ""
    counts: bool = False
    is_text: bool = False
