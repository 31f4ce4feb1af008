"""Electrodes: metal of some shape, at a voltage or with a charge."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, PlainValidator, WithJsonSchema, model_validator
from pydantic_core import PydanticCustomError

from ..errors import InputError
from ..shapes import Shape
from ..units import UNITS
from .complaints import complaint
from .electrode_shapes import ShapeKind
from .expression import formula
from .obstacles import AnyAperture, Obstacle, aperture_names
from .units import NUMBER, Charge, to_si

# Numbers with a unit in a formula: "5 kV*cos(2*pi*1 MHz*t)".
_UNITS = {unit: factor for kind in ("potential", "frequency", "time") for unit, factor in UNITS[kind].items()}
_IN_FORMULA = re.compile(rf"({NUMBER})\s+({'|'.join(sorted(_UNITS, key=len, reverse=True))})\b")


@dataclass(frozen=True)
class Electrode:
    """A conductor: held at a voltage (V; a number, "5 kV", or a formula of t in s), or floating with a charge (C).

    Frozen, so that it can be compared and sent to other ranks. Raises InputError in one sentence.
    """

    name: str
    shape: Shape
    voltage: float | str | None = None
    charge: float | str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not re.fullmatch(r"[\w+-]+", self.name):
            raise InputError(
                f"an electrode is named {self.name!r}, which cannot stand in tables and names of files; "
                "use letters, digits, _, + and - alone"
            )
        where = f"electrode {self.name}"
        if not isinstance(self.shape, Shape):
            raise InputError(f"{where}: its shape is {self.shape!r}; give one of amrpic.shapes")
        if (self.voltage is None) == (self.charge is None):
            drives = "neither a voltage nor" if self.charge is None else "both a voltage and"
            raise InputError(f"{where} has {drives} a charge; give a voltage, or the charge of one that floats")
        key = "voltage" if self.charge is None else "charge"
        try:
            value = _voltage(self.voltage) if self.charge is None else to_si(self.charge, "charge")
        except PydanticCustomError as refused:
            context = refused.context or {}
            raise InputError(
                f"{where}: its {key} ({getattr(self, key)!r}) {context['what']}; {context['remedy']}"
            ) from None
        object.__setattr__(self, key, value)

    @property
    def floats(self) -> bool:
        """Whether its charge is known instead of its voltage."""
        return self.voltage is None

    @property
    def varies(self) -> bool:
        """Whether its voltage is a formula of time."""
        return isinstance(self.voltage, str)

    def voltage_at(self, time: float) -> float:
        """Return its voltage at a time in s, V. Raises InputError where a formula has no value."""
        if not isinstance(self.voltage, str):
            if self.voltage is None:
                raise InputError(f"electrode {self.name} floats: its voltage is part of the solution; ask its charge")
            return self.voltage
        value = float(self.voltages_at(np.array([time]))[0])
        if not math.isfinite(value):
            raise InputError(
                f'electrode {self.name}: its voltage "{self.voltage}" is {value} at t = {time:g} s; '
                "write a formula that is finite throughout"
            )
        return value

    def voltages_at(self, times: np.ndarray) -> np.ndarray:
        """Return what the formula of its voltage is at times (n,) in s, V (n,); not finite where it has no value."""
        with np.errstate(all="ignore"):
            return np.broadcast_to(np.asarray(formula(_in_si(str(self.voltage)), "t")(times), dtype=float), times.shape)


def _is_formula(voltage: Any) -> bool:
    """Whether a voltage is more than a quantity."""
    return isinstance(voltage, str) and not re.fullmatch(rf"\s*{NUMBER}\s*[^\W\d]+\s*", voltage)


def _in_si(text: str) -> str:
    return _IN_FORMULA.sub(lambda match: f"({match[1]}*{_UNITS[match[2]]!r})", text)


def _voltage(value: Any) -> float | str:
    """Return a voltage in V, or the formula of t that it is. Complains of what is neither, or not finite at the start."""
    if not _is_formula(value):
        return to_si(value, "potential")
    with np.errstate(all="ignore"):
        at_start = float(formula(_in_si(value), "t")(np.float64(0.0)))
    if not math.isfinite(at_start):
        raise complaint(f"is {at_start} at t = 0 s", "write a formula that is finite throughout", found=value)
    return value if re.search(r"\bt\b", value) else at_start


# ---- the section [[electrodes]] ----


VoltageOfTime = Annotated[
    float | str | None,
    PlainValidator(_voltage),
    WithJsonSchema({"type": ["number", "string"], "unit": "V, or a formula of t"}),
]


class ElectrodeSection(Obstacle):
    """Metal, at which the field ends and particles are lost: held at a voltage, or floating with a charge."""

    name: str = Field(min_length=1, description="A name of your own, in outputs.")
    shape: ShapeKind = Field(description="The metal.")
    voltage: VoltageOfTime = Field(
        default=None,
        description='At which it is held: a number, a string such as "5 kV", or a formula of t such as '
        '"5 kV*cos(2*pi*1 MHz*t)", with t in s.',
    )
    charge: Charge | None = Field(
        default=None, description="In place of a voltage: it floats, with this charge at the start, C."
    )

    @model_validator(mode="after")
    def _one_drive(self) -> Self:
        self.require_one("voltage", "charge", remedy="give a voltage, or the charge of one that floats")
        return self

    @property
    def value(self) -> Electrode:
        """The electrode, its shape read from files where it is in any. Raises InputError."""
        return Electrode(self.name, self.shape.value, self.voltage, self.charge)


@dataclass(frozen=True)
class ApertureMetal:
    """An aperture that the field ends on: metal at 0 V."""

    name: str
    aperture: AnyAperture
    domain: float  # m, the farthest that a place of the domain is from 0
    voltage: float = 0.0

    @property
    def value(self) -> Electrode:
        """It as an electrode. Raises InputError."""
        return Electrode(self.name, self.aperture.solid(self.domain), self.voltage)


def apertures_of_metal(
    apertures: Sequence[AnyAperture], lower: Sequence[float] | np.ndarray, upper: Sequence[float] | np.ndarray
) -> list[ApertureMetal]:
    """Return the apertures that the field ends on, in a domain."""
    domain = float(np.linalg.norm(np.abs([list(lower), list(upper)]).max(axis=0)))
    pairs = zip(aperture_names(apertures), apertures, strict=True)
    return [ApertureMetal(name, aperture, domain) for name, aperture in pairs if aperture.field]
