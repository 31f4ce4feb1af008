"""amrpic lattice: what becomes of each element of a lattice of another code, and a picture of the line."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..lattice.convert import Converted
from ..mpi import MPI
from ..parallel import from_rank_0
from ..scene.lattice_file import LatticeSection
from ..tables import columns
from .arguments import Commands, command


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    added = command(
        commands, "lattice", _lattice, "show what becomes of each element of a lattice of another code", "reading"
    )
    added.add_argument("file", metavar="FILE", help="in YAML of PALS, or a sequence of MAD-X")
    added.add_argument("--line", metavar="NAME", help="which line or sequence, if the file has several")
    added.add_argument(
        "--missing", choices=("refuse", "drift"), default="drift", help="what has no counterpart; default drift"
    )
    added.add_argument("--species", metavar="NAME", help="of the reference particle, in place of what the file says")
    added.add_argument("--kinetic-energy", metavar="ENERGY", help='likewise, such as "45 MeV"')
    added.add_argument("--output", metavar="DIR", default=".", help="where to put the picture; default here")


def _lattice(chosen: argparse.Namespace) -> int:
    options = {key: getattr(chosen, key) for key in ("line", "missing", "species", "kinetic_energy")}
    given: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    lines = from_rank_0(
        MPI.COMM_WORLD, lambda: list(_lines(chosen, LatticeSection(file=chosen.file, **given))), InputError
    )
    if MPI.COMM_WORLD.rank == 0:
        print(*lines, sep="\n")
    return 0


def _lines(chosen: argparse.Namespace, lattice: LatticeSection) -> Iterator[str]:
    """Yield a table and a summary; draw the picture."""
    of = lattice.converted()
    head = ("element", "in the file", "s", "length", "x", "y", "z", "becomes")
    yield from columns([head, *_rows(of)])
    yield ""
    length = sum(placed.piece.length for placed in of.placed)
    x, y, z = of.end.origin.tolist()
    yield f"{length:.6g} m from end to end, which is at x = {x:.6g}, y = {y:.6g}, z = {z:.6g} m"
    counts = f"{len(of.elements)} elements, {len(of.apertures)} apertures, {len(of.screens)} screens"
    yield f"{of.reference.species.name or 'reference'} of p/q = {of.reference.rigidity:.6g} T m: {counts}"
    path = Path(chosen.output) / f"{Path(chosen.file).name.split('.')[0]}_lattice.png"
    from ..view.lattice_plots import drawn  # matplotlib takes long to import

    drawn(of).savefig(path, dpi=120)
    yield f"{path} shows it"


def _rows(of: Converted) -> Iterator[tuple[str, ...]]:
    for placed in of.placed:
        place = (f"{value:.6g}" for value in placed.entry.origin.tolist())
        yield (
            placed.piece.name,
            placed.piece.called or placed.piece.kind,
            f"{placed.s:.6g}",
            f"{placed.piece.length:.6g}",
            *place,
            ", ".join(placed.became),
        )
