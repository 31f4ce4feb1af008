"""Is it right? Measured against exact answers, topic by topic, each value beside its goal."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import get_args

from mpi4py import MPI

from ..errors import InputError, ParticleError, SolverError
from ..scene import solver_options
from ..scene.scene import Scene
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
    pareto,
    peers,
    selfforce,
    stopping,
)
from .chosen import backend as chosen_backend
from .chosen import lengths
from .draw import draw_curves
from .table import Goal, Table

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


def verify(
    comm: MPI.Comm,
    topics: Sequence[str] = (),
    scenes: Sequence[Scene] = (),
    *,
    quick: bool = False,
    backend: str | None = None,
    long: bool = False,
) -> Iterator[tuple[str, Table]]:
    """Each table as it is measured, with its topic; the same on all ranks. Collective.

    Of the topics named and of speed against error of the scenes, with fewer settings and cases if `quick`; of all topics if
    neither is named. `backend` is that of the solver, if not the default; with `long` comparisons that take longer are made
    in full. A topic in which a run ends early has a table that says so and misses its goal, and the others follow. Raises
    InputError for a topic or a backend that does not exist, and for a scene whose charge has no formula.
    """
    for topic in topics:
        if topic not in TOPICS:
            raise InputError(f'verify knows no topic "{topic}"; use {", ".join(TOPICS)}')
    require_backend(backend)
    with chosen_backend(backend), lengths(long, quick):
        for topic in topics or (() if scenes else TOPICS):
            for table in _to_the_end(topic, TOPICS[topic](comm)):
                yield topic, table
        for scene in scenes:
            for table in pareto.tables(comm, scene, quick):
                yield "pareto", table


def _to_the_end(topic: str, tables: Iterator[Table]) -> Iterator[Table]:
    """The tables of a topic, and where it raises, on all ranks, one more: the page has what was measured before and after."""
    try:
        yield from tables
    except (SolverError, ParticleError) as why:
        yield Table(f"{topic}: not measured to its end", str(why), ("errors",), [[Goal(1, 0)]])


def require_backend(name: str | None) -> None:
    """Raise InputError unless the solver has this backend, or none is named."""
    if name is not None and name not in get_args(solver_options.Backend):
        raise InputError(f'the solver has no backend "{name}"; use {", ".join(get_args(solver_options.Backend))}')


OPENING = (
    "# Verification\n\nWritten by `amrpic verify --output FOLDER`; `make verify PUBLISH=1` writes it into `docs/reports`. A "
    "goal stands in brackets behind each measured value that has one; a missed goal is marked and fails the command.\n"
)


def write(found: Sequence[tuple[str, Table]], folder: Path, afresh: bool = False) -> Path:
    """Write `verification.md` and its pictures into a folder; return its path. OSError if that is not possible.

    Tables that the file holds already and that were not measured now stay in it, unless it is written `afresh`.
    """
    pictures, path = folder / "pictures", folder / "verification.md"
    pictures.mkdir(parents=True, exist_ok=True)
    parts = {} if afresh else _parts(path)
    for _, table in found:
        part = f"## {table.title}\n\n{table.about}\n\n{table.markdown()}\n"
        if table.picture or table.curves:
            name = f"verify_{'_'.join(re.findall(r'[a-z0-9]+', table.title.lower()))}.png"
            (table.picture or partial(draw_curves, table))(pictures / name)
            part += f"\n![{table.title}: {table.upwards}](pictures/{name})\n"
        parts[table.title] = part
    path.write_text("\n".join([OPENING, *parts.values()]), encoding="utf-8")
    return path


def _parts(path: Path) -> dict[str, str]:
    """What a file holds under each title."""
    if not path.exists():
        return {}
    _, *parts = re.split(r"^(?=## )", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {part.splitlines()[0].removeprefix("## "): part.rstrip("\n") + "\n" for part in parts}
