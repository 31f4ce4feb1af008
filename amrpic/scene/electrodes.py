"""Electrodes: metal of some shape, at a voltage or with a charge."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic_core import PydanticCustomError

from ..errors import InputError
from ..shapes import Shape
from ..units import UNITS
from .expression import formula
from .units import NUMBER, to_si

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
        if self.charge is not None:
            object.__setattr__(self, "charge", _quantity(f"{where}: its charge", self.charge, "charge"))
        elif isinstance(self.voltage, str) and not re.fullmatch(rf"\s*{NUMBER}\s*[^\W\d]+\s*", self.voltage):
            self._check_formula(where)
            if not re.search(r"\bt\b", self.voltage):
                object.__setattr__(self, "voltage", self.voltage_at(0.0))
        else:
            object.__setattr__(self, "voltage", _quantity(f"{where}: its voltage", self.voltage, "potential"))

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
        with np.errstate(all="ignore"):
            value = float(formula(_in_si(self.voltage), "t")(np.float64(time)))
        if not math.isfinite(value):
            raise InputError(
                f'electrode {self.name}: its voltage "{self.voltage}" is {value} at t = {time:g} s; '
                "write a formula that is finite throughout"
            )
        return value

    def _check_formula(self, where: str) -> None:
        try:
            self.voltage_at(0.0)
        except PydanticCustomError as refused:
            raise InputError(f'{where}: its voltage "{self.voltage}" {_said(refused)}') from None


def _in_si(text: str) -> str:
    return _IN_FORMULA.sub(lambda match: f"({match[1]}*{_UNITS[match[2]]!r})", text)


def _quantity(where: str, value: Any, kind: str) -> float:
    try:
        return to_si(value, kind)
    except PydanticCustomError as refused:
        raise InputError(f"{where} ({value!r}) {_said(refused)}") from None


def _said(refused: PydanticCustomError) -> str:
    context = refused.context or {}
    return f"{context['what']}; {context['remedy']}"
