"""The command line: the parser of all commands, and the exit status of the one that was chosen."""

from __future__ import annotations

import argparse
import contextlib
import sys
import traceback
from collections.abc import Sequence
from importlib.metadata import version

from ..failure import Meeting, replace_unprintable, sentence
from ..mpi import MPI
from ..progress import progress, reported
from . import check, compare, doctor, lattice, plot, preview, report, run, scaling, scan, schema, verify, watch
from .arguments import Parser

COMMANDS = (
    run,
    check,
    preview,
    watch,
    report,
    compare,
    scan,
    plot,
    lattice,
    schema,
    verify,
    scaling,
    doctor,
)  # as --help lists them


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command that the arguments name and exit with its status. Collective under mpiexec."""
    meeting, show_traceback = Meeting(MPI.COMM_WORLD), False
    replace_unprintable()
    try:
        chosen = parser().parse_args(arguments)
        show_traceback = chosen.traceback
        with contextlib.ExitStack() as during:
            if chosen.doing:
                during.enter_context(reported(MPI.COMM_WORLD))
                during.enter_context(progress(chosen.doing))
            status = chosen.command(chosen)
        sys.stdout.flush()
    except (Exception, KeyboardInterrupt) as failure:
        status = meeting.report(failure, traceback.format_exc() if show_traceback else sentence(failure))
    sys.exit(status)


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = Parser(prog="amrpic", description="Self-fields of charged-particle bunches on adaptive meshes.")
    top.add_argument("--version", action="version", version=f"amrpic {version('amrpic')}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add(commands)
    return top
