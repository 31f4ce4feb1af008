"""amrpic report: a page on a run, for any browser."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import InputError
from ..mpi import MPI
from ..parallel import from_rank_0
from .arguments import Commands, command


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    added = command(
        commands, "report", _report, "write a page on a run, pictures included, for any browser", "writing the page"
    )
    added.add_argument("run", metavar="RUN", help="the folder of a run")


def _report(chosen: argparse.Namespace) -> int:
    from ..results import report_page  # matplotlib takes long to import

    folder = Path(chosen.run)
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; give that of a run, such as runs/drift")
    path = from_rank_0(MPI.COMM_WORLD, lambda: report_page.write(folder))
    if MPI.COMM_WORLD.rank == 0:
        print(path)
    return 0
