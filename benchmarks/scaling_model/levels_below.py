"""The multigrid levels under the base, as many as the solver makes."""

from __future__ import annotations

import numpy as np

from amrpic.scene.scene import Scene

BOTTOM = 64  # cells of a multigrid level that is not coarsened further


def cells_below(scene: Scene) -> list[int]:
    """Return the cells of the multigrid levels under the base, fine to coarse: half as many along axes of small spacing."""
    cells, h = np.array(scene.domain.cells), scene.domain.value.spacing * np.array(scene.solver.stretch)
    most = np.inf if scene.solver.coarse_levels is None else scene.solver.coarse_levels
    out: list[int] = []
    while len(out) < most and cells.prod() > BOTTOM:
        short = (cells > 2) & (h <= 1.5 * h[cells > 2].min())
        cells, h = np.where(short, (cells + 1) // 2, cells), np.where(short, 2 * h, h)
        out.append(int(cells.prod()))
    return out
