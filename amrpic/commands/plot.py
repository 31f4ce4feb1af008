"""amrpic plot: pictures of a run that was written."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..errors import InputError, OutputError
from ..io.field_reader import open_dump
from ..mpi import MPI
from ..parallel import together
from ..scene.units import to_metres
from ..view.draw import draw
from ..view.views import View, of_points, overview_of, with_options
from .arguments import Commands, command


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    plot = command(commands, "plot", _plot, "draw pictures of a run that was written", "drawing")
    plot.add_argument(
        "path", metavar="PATH", help="directory of a run, a fields file, a checkpoint, a particles file, or losses.csv"
    )
    plot.add_argument(
        "--quantity",
        metavar="NAME",
        action="append",
        help="phi, rho, |E|, Ex, Ey or Ez; of phase-space x-px, y-py, z-pz, x-y, z-x, z-y or slices; of losses energy, "
        "charge or particles; several if repeated; default an overview",
    )
    plot.add_argument(
        "--kind",
        choices=("slice", "projection", "line", "phase-space", "losses"),
        help="of pictures; default slice of a quantity; phase-space shows the particles of a checkpoint or particles file, "
        "losses the map of losses along z",
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
    plot.add_argument(
        "--group",
        metavar="NAME",
        help="of particles in phase space, as in beam.csv: all, a species, a bunch; default all",
    )
    plot.add_argument("--output", metavar="DIR", help="where to put the pictures; default beside what they show")


def _plot(chosen: argparse.Namespace) -> int:
    folder = None if chosen.output is None else Path(chosen.output)
    with together(MPI.COMM_WORLD, OutputError):
        if MPI.COMM_WORLD.rank == 0:
            draw = {"phase-space": _draw_particles, "losses": _draw_losses}.get(chosen.kind, _draw_fields)
            print(*draw(chosen, folder), sep="\n")
    return 0


def _draw_fields(chosen: argparse.Namespace, folder: Path | None) -> list[Path]:
    with open_dump(Path(chosen.path)) as dump:
        views = [View(name, chosen.kind or "slice") for name in chosen.quantity or ()]
        views = views or [view for view in overview_of(dump) if chosen.kind in (None, view.kind)]
        if not views:
            raise InputError(f"there is no {chosen.kind} by default of {dump.path}; name a --quantity")
        folder = folder or dump.path.parent
        pictures = draw(dump, folder, with_options(views, **_given(chosen)))
        if of_points(dump) and Path(chosen.path).is_dir() and not chosen.quantity:
            from ..mpm.point_pictures import draw_forces  # no other run imports it

            pictures += draw_forces(Path(chosen.path), folder)
    return pictures


def _draw_particles(chosen: argparse.Namespace, folder: Path | None) -> list[Path]:
    from ..view.phase_space_plots import OVERVIEW, plot  # matplotlib takes long to import

    options = _given(chosen)
    group = options.pop("group", "all")
    for name in options:
        raise InputError(f"{name} has no effect on phase space; leave it out, or choose another kind of picture")
    return plot(Path(chosen.path), folder, chosen.quantity or OVERVIEW, group)


def _draw_losses(chosen: argparse.Namespace, folder: Path | None) -> list[Path]:
    from ..view.loss_plots import OVERVIEW, plot

    for name in _given(chosen):
        raise InputError(f"{name} has no effect on a map of losses; leave it out, or choose another kind of picture")
    return plot(Path(chosen.path), folder, chosen.quantity or OVERVIEW)


def _given(chosen: argparse.Namespace) -> dict[str, Any]:
    """Return those options of pictures that are given."""
    options = {
        "axis": None if chosen.axis is None else "xyz".index(chosen.axis),
        "position": None if chosen.position is None else to_metres(chosen.position),
        "level": chosen.level,
        "scale": chosen.scale,
        "boxes": chosen.boxes,
        "group": chosen.group,
    }
    return {name: value for name, value in options.items() if value is not None}
