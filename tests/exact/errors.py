"""How far fields are from exact ones, and the order that errors show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from amrpic.mesh.field import Field
from amrpic.mpi import MPI
from amrpic.verify import known_charges
from amrpic.verify.known_charges import Exact


def errors(fields: Sequence[Field], exact: Exact, shift: bool = False) -> tuple[float, float]:
    """Those of L2 and of the maximum, relative; with `shift` the mean error counts as none. Collective.

    Where no face fixes a potential, it is known up to a constant only.
    """
    return known_charges.errors(fields, exact, mean_error(fields[0], exact) if shift else 0.0)


def level_errors(fields: Sequence[Field], exact: Exact) -> list[tuple[float, float]]:
    """The same per level: L2 relative to the level's own norm, max to the largest exact value of all levels. Collective."""
    squares, largest = known_charges.measured(fields, exact)
    top = largest[:, 1].max()
    return [
        (float(np.sqrt(wrong / right)), float(np.sqrt(worst / top)))
        for (wrong, right), (worst, _) in zip(squares, largest, strict=True)
    ]


def mean_error(field: Field, exact: Exact) -> float:
    """Over all uncovered cells. Collective."""
    total = np.zeros(2)
    for patch in field.patches:
        use, volume = ~patch.covered, np.prod(patch.hierarchy.spacing(patch.level))
        (expected,) = known_charges.components(exact, patch.centres())
        wrong = (patch.data - expected)[use]
        total += volume * np.array([wrong.sum(), wrong.size])
    total = field.comm.allreduce(total, op=MPI.SUM)
    return float(total[0] / total[1])


def observed_order(cells: Sequence[int], error: Sequence[float]) -> float:
    """Slope of the error over the cell width, by least squares of the logarithms."""
    return -float(np.polyfit(np.log(cells), np.log(error), 1)[0])
