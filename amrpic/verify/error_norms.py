"""How far fields are from exact ones, over the uncovered cells of all levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..mesh.field import Field
from ..mpi import MPI

Exact = Callable[[np.ndarray, np.ndarray, np.ndarray], "np.ndarray | tuple[np.ndarray, ...]"]


def errors(fields: Sequence[Field], exact: Exact, offset: float = 0.0) -> tuple[float, float]:
    """The L2 error over the L2 norm of the exact field, and the largest error over the largest exact value. Collective.

    Several fields are the components of a vector, as `exact` then gives them. An `offset` is no error.
    """
    squares, largest = measured(fields, exact, offset)
    wrong, right = squares.sum(axis=0)
    return float(np.sqrt(wrong / right)), float(np.sqrt(largest[:, 0].max() / largest[:, 1].max()))


def measured(fields: Sequence[Field], exact: Exact, offset: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Per level (error, exact): volume integrals of the squares, and largest squares."""
    levels, comm = fields[0].hierarchy.levels, fields[0].comm
    squares, largest = np.zeros((levels, 2)), np.zeros((levels, 2))
    for i, patch in enumerate(fields[0].patches):
        use, volume = ~patch.covered, np.prod(patch.hierarchy.spacing(patch.level))
        expected = [np.broadcast_to(e, patch.data.shape)[use] for e in components(exact, patch.centres())]
        wrong = sum((f.patches[i].data[use] - offset - t) ** 2 for f, t in zip(fields, expected, strict=True))
        right = sum(t**2 for t in expected)
        squares[patch.level] += volume * np.array([np.sum(wrong), np.sum(right)])
        top = [np.max(wrong, initial=0.0), np.max(right, initial=0.0)]
        largest[patch.level] = np.maximum(largest[patch.level], top)
    comm.Allreduce(MPI.IN_PLACE, squares, op=MPI.SUM)
    comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
    return squares, largest


def components(exact: Exact, places: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    values = exact(*places)
    return values if isinstance(values, tuple) else (values,)
