"""Pictures of lattices: from above, and along the orbit."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon, Rectangle

from ..lattice.convert import Converted, PlacedPiece
from ..lattice.pieces import chord, middle

COLOURS = {
    "dipole": "tab:blue",
    "quadrupole": "tab:red",
    "multipole": "tab:green",
    "solenoid": "tab:purple",
    "rf-gap": "tab:orange",
}
WIDTH = 0.02  # of the line's length, of an element from above
LEAST = 0.002  # of it, along the orbit


def drawn(of: Converted) -> Figure:
    """Return the line from above (x against z), and its elements along s."""
    figure = Figure(figsize=(9, 6.5), layout="constrained")
    above, along = figure.subplots(2, 1, height_ratios=(3, 1))
    path = np.array([element.entry.origin for element in of.placed] + [of.end.origin])
    above.plot(path[:, 2], path[:, 0], color="0.6", linewidth=0.8)
    total = max((element.s + element.piece.length for element in of.placed), default=1.0) or 1.0
    kinds = []
    for element in of.placed:
        kind = next((name for name in element.became if name in COLOURS), None)
        if kind is not None:
            kinds.append(kind)
            above.add_patch(Polygon(_corners(element, WIDTH * total), color=COLOURS[kind], alpha=0.8))
            width = max(element.piece.length, LEAST * total)
            start = element.s + element.piece.length / 2 - width / 2
            along.add_patch(
                Rectangle((start, -_up(element)), width, 2 * _up(element) or 1, color=COLOURS[kind], alpha=0.8)
            )
    above.set(xlabel="z / m", ylabel="x / m", aspect="equal")
    above.autoscale_view()
    along.set(xlabel="s / m", xlim=(0, total), ylim=(-1.2, 1.2), yticks=[])
    along.axhline(0, color="0.6", linewidth=0.8)
    if kinds:
        above.legend(
            handles=[Patch(color=COLOURS[kind], label=kind) for kind in dict.fromkeys(kinds)], fontsize="small"
        )
    return figure


def _corners(element: PlacedPiece, width: float) -> np.ndarray:
    """Return the corners (4, 2) of an element in z and x."""
    frame, half = middle(element.entry, element.piece), max(chord(element.piece), width / 4) / 2
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = [frame.moved(x * width / 2, 0, z * half).origin for x, z in signs]
    return np.array(corners)[:, [2, 0]]


def _up(element: PlacedPiece) -> float:
    """Return how high an element is drawn: quadrupoles by whether they focus, others in the middle."""
    return 1.0 if element.piece.kind == "bend" else 0.7
