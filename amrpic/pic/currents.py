"""What a run records of its electrodes: their voltages and charges, and the currents that flow onto them."""

from __future__ import annotations

from collections.abc import Sequence

from ..scene.electrodes import Electrode
from ..units import Column
from .driven_electrodes import collected
from .state import State


def columns_of(electrodes: Sequence[Electrode]) -> list[Column]:
    """Return the columns of the series for electrodes."""
    kinds = (("voltage", "V"), ("charge", "C"), ("hit_charge", "C"), ("current", "A"))
    return [Column(f"{kind}_{e.name}", unit) for e in electrodes for kind, unit in kinds]


class Currents:
    """The rows of electrodes, of states one after the other."""

    def __init__(self, state: State, electrodes: Sequence[Electrode]) -> None:
        self._electrodes = electrodes
        self._time = state.time
        self._supplied = self._of(state)[1]

    def row(self, state: State) -> dict[str, float]:
        """Return what columns of electrodes have of a state. Collective.

        `current` is what the supply of an electrode gives in the mean since the row before: by conservation of charge, the
        change of the charge on it without what particles brought that hit it. In a floating one none flows.
        """
        hit, supplied = self._of(state)
        duration, voltages, charges = state.time - self._time, state.solution.voltages, state.solution.charges
        out: dict[str, float] = {}
        for electrode in self._electrodes:
            name = electrode.name
            flown = 0.0 if electrode.floats else supplied[name] - self._supplied[name]
            out[f"voltage_{name}"], out[f"charge_{name}"] = voltages[name], charges[name]
            out[f"hit_charge_{name}"], out[f"current_{name}"] = hit[name], flown / duration if duration > 0 else 0.0
        self._time, self._supplied = state.time, supplied
        return out

    def _of(self, state: State) -> tuple[dict[str, float], dict[str, float]]:
        """Return the charge that has hit each electrode and what its supply has given it since, C. Collective."""
        if not self._electrodes:
            return {}, {}
        hit = collected(state.hierarchy.comm, state.lost, self._electrodes)
        return hit, {name: charge - hit[name] for name, charge in state.solution.charges.items()}
