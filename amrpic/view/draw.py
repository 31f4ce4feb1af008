"""Pictures of a dump, drawn together by the ranks that share it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OutputError
from ..io.field_reader import Dump, open_dump
from ..mesh.raster import spread_of
from ..parallel import together
from .views import OVERVIEW, View, density_of, numbers, overview_of, require

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot(path: Path, directory: Path | None = None, views: Sequence[View] = ()) -> list[Path]:
    """Draw a dump, or the latest one in the folder of a run, and return the pictures' paths. Serial: for one rank.

    Pictures go beside the dump unless `directory` is given; an overview if no views are. Raises InputError for what is no
    dump or not in it, OutputError if a picture cannot be written.
    """
    with open_dump(path) as dump:
        return draw(dump, dump.path.parent if directory is None else Path(directory), views or overview_of(dump))


def figures(dump: Dump, views: Sequence[View] = OVERVIEW) -> Iterator[tuple[str, Figure]]:
    """Yield the pictures of a dump by the names of their views. Serial. Raises InputError for what is not in the dump."""
    from .figures import figure

    spread = spread_of(dump, density_of(dump))
    for view in views:
        require(dump, view)
        yield view.name, figure(dump, spread, view, numbers(dump, spread, view))


def draw(dump: Dump, folder: Path, views: Sequence[View] = OVERVIEW) -> list[Path]:
    """Draw a dump into a folder and return the pictures' paths. Collective over the ranks that share the dump.

    Each rank rasters its own boxes, rank 0 draws the sum. Raises InputError for what is not in the dump, OutputError if a
    picture cannot be written.
    """
    return list(drawn(dump, folder, views))


def drawn(dump: Dump, folder: Path, views: Sequence[View] = OVERVIEW) -> Iterator[Path]:
    """Draw a dump as `draw` does, and yield the path of each picture when it is there. Collective."""
    for view in views:
        require(dump, view)
    spread = spread_of(dump, density_of(dump))
    for view in views:
        values = numbers(dump, spread, view)
        path = folder / f"{dump.path.stem}_{view.name}.png"
        with together(dump.comm, OutputError):
            if dump.comm.rank == 0:
                from .figures import figure, save  # matplotlib takes long to import, and no other rank needs it

                save(figure(dump, spread, view, values), path)
        yield path
