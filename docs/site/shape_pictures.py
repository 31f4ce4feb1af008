"""The picture on docs/shapes.md: bodies in a slice, cells in metal, and arms that are cut. Run it to draw it anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from amrpic import Electrode, shapes
from amrpic.conductors.arms import arms_of_boxes
from amrpic.conductors.edges import edge_cells

CELLS, WIDTH = 44, 0.5  # per axis, mm
COLOURS = ("#c44e52", "#4c72b0", "#55a868", "#8172b3")


def electrodes() -> list[Electrode]:
    """Return bodies of several kinds, mm."""
    lens = shapes.Revolved([(-9, 4), (-4, 4), (-2.6, 6), (-2.6, 9), (-9, 9)])
    block = shapes.Box((-3, -3, 4), (3, 3, 9)) - shapes.Sphere((0, 0, 4), 2.2)
    ring = shapes.Torus((0, 0, 1.4), (0.3, 0, 1), 7, 1)
    foil = shapes.Disk((6.2, 0, 6.4), (1, 0, 0.7), 3)
    return [
        Electrode(name, shape, voltage=volts)
        for volts, (name, shape) in enumerate(
            {"revolved": lens, "box-sphere": block, "torus": ring, "disk": foil}.items()
        )
    ]


def draw(picture: Path) -> None:
    """Draw the plane of cells beside y = 0."""
    bodies, start = electrodes(), -CELLS * WIDTH / 2
    middle = CELLS // 2
    box = [[0, middle, 0, CELLS - 1, middle, CELLS - 1]]
    y = start + (middle + 0.5) * WIDTH
    arms, _ = arms_of_boxes(bodies, box, start, WIDTH)
    walls = arms.crossings(bodies, box, start, WIDTH)
    figure = Figure(figsize=(8, 7.2), layout="constrained")
    axes = figure.add_subplot()
    fine = np.linspace(start, -start, 881)
    places = np.stack(np.broadcast_arrays(fine, y, fine[:, None]), axis=-1).reshape(-1, 3)
    for number, (body, colour) in enumerate(zip(bodies, COLOURS, strict=True)):
        inside = body.shape.inside(places).reshape(len(fine), -1)
        axes.contourf(fine, fine, inside, [0.5, 1.5], colors=[colour], alpha=0.3)
        k, i = np.divmod(arms.solid[arms.solid_electrode == number], CELLS)
        axes.plot(start + (i + 0.5) * WIDTH, start + (k + 0.5) * WIDTH, "s", color=colour, markersize=3)
    for side in (0, 1, 4, 5):
        chosen = walls.side == side
        centre = start + (walls.cells[chosen] + 0.5) * WIDTH
        place = walls.place[chosen]
        axes.plot([centre[:, 0], place[:, 0]], [centre[:, 2], place[:, 2]], color="0.25", linewidth=0.8)
        axes.plot(place[:, 0], place[:, 2], "o", color="black", markersize=2)
    k, i = np.divmod(edge_cells(bodies, box, start, WIDTH)[0], CELLS)
    axes.plot(
        start + (i + 0.5) * WIDTH, start + (k + 0.5) * WIDTH, "s", color="#dd8452", markersize=6, fillstyle="none"
    )
    for body, colour, place in zip(
        bodies, COLOURS, [(-10.5, -10.2), (-2.6, 9.4), (-10.5, 1.2), (5.4, 9.4)], strict=True
    ):
        axes.text(*place, body.name, color=colour)
    axes.set(xlabel="x / mm", ylabel="z / mm", aspect="equal", xlim=(start, -start), ylim=(start, -start))
    figure.savefig(picture, dpi=100)


if __name__ == "__main__":
    draw(Path(__file__).parents[1] / "pictures" / "shapes.png")
