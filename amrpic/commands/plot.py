"""amrpic plot: pictures of a run that was written."""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

from ..errors import OutputError
from ..parallel import together
from ..scene.units import to_metres
from .arguments import Commands, command


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    plot = command(commands, "plot", _plot, "draw pictures of a run that was written")
    plot.add_argument("path", metavar="PATH", help="directory of a run, a fields file or a checkpoint")
    plot.add_argument(
        "--quantity",
        metavar="NAME",
        action="append",
        help="phi, rho, |E|, Ex, Ey or Ez, several if repeated; default an overview in four pictures",
    )
    plot.add_argument(
        "--kind", choices=("slice", "projection", "line"), help="of pictures; default slice of a quantity"
    )
    plot.add_argument(
        "--axis",
        choices=tuple("xyz"),
        help="normal of slices, direction of the rest; default z, lines follow the charge",
    )
    plot.add_argument(
        "--position", metavar="LENGTH", help='of slices along it, m or such as "2.5 mm"; default through the charge'
    )
    plot.add_argument(
        "--level", type=int, metavar="N", help="show this level alone; default the finest cells everywhere"
    )
    plot.add_argument("--scale", choices=("auto", "linear", "symmetric", "log"), help="of the colours; default auto")
    plot.add_argument(
        "--no-boxes", dest="boxes", action="store_const", const=False, help="leave out the outlines of boxes"
    )
    plot.add_argument("--output", metavar="DIR", help="where to put the pictures; default beside what they show")


def _plot(chosen: argparse.Namespace) -> int:
    from ..view.plot import OVERVIEW, View, plot, with_options  # matplotlib takes long to import

    folder = None if chosen.output is None else Path(chosen.output)
    with together(MPI.COMM_WORLD, OutputError):
        if MPI.COMM_WORLD.rank == 0:
            views = [View(name, chosen.kind or "slice") for name in chosen.quantity or ()]
            views = views or [view for view in OVERVIEW if chosen.kind in (None, view.kind)]
            options = {
                "axis": None if chosen.axis is None else "xyz".index(chosen.axis),
                "position": None if chosen.position is None else to_metres(chosen.position),
                "level": chosen.level,
                "scale": chosen.scale,
                "boxes": chosen.boxes,
            }
            given = {name: value for name, value in options.items() if value is not None}
            print(*plot(Path(chosen.path), folder, with_options(views, **given)), sep="\n")
    return 0
