"""Electrodes at one time of a run: their voltages and charges then, in the coordinates of the mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..mesh.window import Window
from ..scene.electrodes import Electrode
from ..shapes.shape import placed


@dataclass(frozen=True)
class Drive:
    """Electrodes at a time, s. Floating ones have the charge that they have then."""

    electrodes: tuple[Electrode, ...] = ()
    time: float = 0.0

    @classmethod
    def of(cls, electrodes: Sequence[Electrode], time: float, window: Window, collected: Mapping[str, float]) -> Drive:
        """Return electrodes, at rest in the laboratory, as a window shows them; `collected`: what particles brought that hit
        them, C."""
        return cls(tuple(_gained(_seen_from(window, e), collected.get(e.name, 0.0)) for e in electrodes), time)

    def with_charge(self, at_rest: bool) -> tuple[Electrode, ...]:
        """Return the electrodes of the equation that has the charge: without voltages that are solved for `apart` from it."""
        apart = {electrode.name for electrode in self.apart(at_rest)}
        return tuple(replace(e, voltage=0.0) if e.name in apart else e for e in self.electrodes)

    def apart(self, at_rest: bool) -> list[Electrode]:
        """Return the electrodes whose voltages have a field of their own: those that vary, since one solution serves all times;
        and beside charge that is not `at_rest` all, since its images alone move with it."""
        return [e for e in self.electrodes if not e.floats and (e.varies or (not at_rest and e.voltage != 0))]

    def alone(self, *at: str, volts: float | None = None) -> tuple[Electrode, ...]:
        """Return the electrodes without charge, those of these names at their voltages or at `volts`, all others at 0 V."""
        out = []
        for electrode in self.electrodes:
            if electrode.floats:
                out.append(replace(electrode, charge=0.0))
            elif electrode.name in at:
                out.append(electrode if volts is None else replace(electrode, voltage=volts))
            else:
                out.append(replace(electrode, voltage=0.0))
        return tuple(out)


NO_ELECTRODES = Drive()


def _seen_from(window: Window, electrode: Electrode) -> Electrode:
    if window == Window(pivot=window.pivot):
        return electrode
    axes = np.array(window.axes)
    return replace(electrode, shape=placed(electrode.shape, axes, -axes @ np.array(window.origin)))


def _gained(electrode: Electrode, charge: float) -> Electrode:
    floats = electrode.floats and charge
    return replace(electrode, charge=float(electrode.charge or 0.0) + charge) if floats else electrode
