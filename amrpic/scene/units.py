"""Quantities as people write them in a scene: SI numbers, or strings such as "2.5 mm" and "100 pC"."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any

from pydantic import AfterValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from ..errors import InputError
from ..units import UNITS
from .complaints import complaint

LARGEST = 1e60  # of any quantity in SI units, so that products of a few of them are numbers still
NUMBER = r"[-+]?(?:\d+(?:_\d+)*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
MICRO, GREEK_MU = "\u00b5", "\u03bc"  # the micro sign and the Greek letter; keyboards have one or the other
_QUANTITY = re.compile(rf"\s*({NUMBER})\s*(.*?)\s*")


def to_si(value: Any, kind: str) -> float:
    """Return `value` in the SI unit of `kind`; plain numbers are taken to be in that unit already."""
    table = UNITS[kind]
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise complaint(
            f"is not {with_article(kind)}", f"write a number in {next(iter(table))} or a string {_example(kind)}"
        )
    if not isinstance(value, str):
        return _finite(float(value) if abs(value) <= sys.float_info.max else math.inf, kind)  # an int has no limit
    match = _QUANTITY.fullmatch(value)
    number, unit = match.groups() if match else ("", "")
    unit = unit.replace(GREEK_MU, MICRO)
    if not match or not unit:
        raise complaint(
            f"is not {with_article(kind)} with a unit",
            f"write a string {_example(kind)}, or a plain number in {next(iter(table))}",
        )
    if unit not in table:
        raise complaint(f'has the unit "{unit}", which is not {with_article(kind)}', f"use one of {', '.join(table)}")
    return _finite(_scaled(number, table[unit]), kind)


@dataclass(frozen=True)
class Quantity:
    """Annotation of a field that holds a quantity in SI units and accepts it with a unit."""

    kind: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(lambda value: to_si(value, self.kind), handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        # The pattern constrains strings alone, limits constrain numbers alone.
        units = "|".join(UNITS[self.kind]).replace("^", r"\^").replace(MICRO, f"[{MICRO}{GREEK_MU}]")
        pattern = rf"^\s*{NUMBER}\s*({units})\s*$"
        unit = next(iter(UNITS[self.kind]))
        return {**handler(schema), "type": ["number", "string"], "pattern": pattern, "unit": unit}


@dataclass(frozen=True)
class Spread:
    """Annotation of a triple: a single value stands for all three axes."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(_spread, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        single = handler(schema)["prefixItems"][0]
        return {"anyOf": [single, {"type": "array", "items": single, "minItems": 3, "maxItems": 3}]}


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
        return to_si(float(text) if re.fullmatch(NUMBER, text) else text, "length")
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
    if abs(value) > LARGEST:
        raise complaint(
            f"is {with_article(kind)} beyond all measure", f"write one of less than {LARGEST:g} in SI units"
        )
    return value


def with_article(noun: str) -> str:
    """Return a noun with "a" or "an" before it."""
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _example(kind: str) -> str:
    table = list(UNITS[kind])
    return f'such as "2.5 {table[1] if len(table) > 1 else table[0]}"'


def _points_somewhere(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(vector):
        raise complaint("points nowhere", "give a vector such as [0, 0, 1]", found=list(vector))
    return vector


_Positive = Annotated[float, Field(gt=0)]
#: A vector of any length but 0.
Direction3 = Annotated[tuple[float, float, float], AfterValidator(_points_somewhere)]
Length = Annotated[float, Quantity("length")]
Emittance = Annotated[float, Quantity("emittance")]
Time = Annotated[float, Quantity("time")]
Charge = Annotated[float, Quantity("charge")]
CurrentDensity = Annotated[float, Quantity("current density")]
Temperature = Annotated[float, Quantity("temperature")]
Current = Annotated[float, Quantity("current")]
Mass = Annotated[float, Quantity("mass")]
Momentum = Annotated[float, Quantity("momentum")]
Velocity = Annotated[float, Quantity("velocity")]
Energy = Annotated[float, Quantity("energy")]
ChargeDensity = Annotated[float, Quantity("charge density")]
Potential = Annotated[float, Quantity("potential")]
FieldStrength = Annotated[float, Quantity("field")]
MagneticField = Annotated[float, Quantity("magnetic field")]
MagneticGradient = Annotated[float, Quantity("gradient")]
ElectricGradient = Annotated[float, Quantity("electric gradient")]
WaveNumber = Annotated[float, Quantity("wave number")]
Frequency = Annotated[float, Quantity("frequency")]
Angle = Annotated[float, Quantity("angle")]
Pressure = Annotated[float, Quantity("pressure")]
Density = Annotated[float, Quantity("density")]
Toughness = Annotated[float, Quantity("energy per area")]
Acceleration = Annotated[float, Quantity("acceleration")]
Length3 = Annotated[tuple[Length, Length, Length], Spread()]
Momentum3 = Annotated[tuple[Momentum, Momentum, Momentum], Spread()]
Velocity3 = Annotated[tuple[Velocity, Velocity, Velocity], Spread()]
FieldStrength3 = Annotated[tuple[FieldStrength, FieldStrength, FieldStrength], Spread()]
MagneticField3 = Annotated[tuple[MagneticField, MagneticField, MagneticField], Spread()]
ElectricGradient3 = Annotated[tuple[ElectricGradient, ElectricGradient, ElectricGradient], Spread()]
WaveNumber3 = Annotated[tuple[WaveNumber, WaveNumber, WaveNumber], Spread()]
Acceleration3 = Annotated[tuple[Acceleration, Acceleration, Acceleration], Spread()]
Positive3 = Annotated[tuple[_Positive, _Positive, _Positive], Spread()]
Index3 = Annotated[tuple[int, int, int], Spread()]
