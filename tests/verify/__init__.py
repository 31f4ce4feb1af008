"""Is it right? Measured against exact answers, topic by topic: tables whose cells know their bounds.

`test_topics.py` holds each topic to them; `make verify` writes what it measured as docs/reports/verification.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from mpi4py import MPI

from amrpic.verify.table import Table

from . import (
    accuracy,
    backends,
    conservation,
    convergence,
    dynamics,
    fourth_order,
    gaps,
    hard,
    least_squares,
    materials,
    moving_charges,
    mpm,
    openboundary,
    operators,
    peers,
    selfforce,
    stopping,
)

TOPICS: Mapping[str, Callable[[MPI.Comm], Iterator[Table]]] = {
    "convergence": convergence.tables,
    "open-boundary": openboundary.tables,
    "peers": peers.tables,
    "self-force": selfforce.tables,
    "accuracy": accuracy.tables,
    "order-4": fourth_order.tables,
    "stopping": stopping.tables,
    "conservation": conservation.tables,
    "hard-cases": hard.tables,
    "backends": backends.tables,
    "dynamics": dynamics.tables,
    "moving-charges": moving_charges.tables,
    "least-squares": least_squares.tables,
    "gaps": gaps.tables,
    "operators": operators.tables,
    "materials": materials.tables,
    "mpm": mpm.tables,
}
