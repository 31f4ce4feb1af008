"""What the arguments of several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NoReturn

from ..errors import InputError
from ..mpi import MPI
from ..parallel import from_rank_0, together
from ..scene.any_scene import AnyScene, read_data, read_text
from .methods import scene_from

Commands = argparse._SubParsersAction


class Parser(argparse.ArgumentParser):
    """Raises InputError for wrong arguments, so that one rank reports them, not all."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see {self.prog} --help")


def command(
    commands: Commands, name: str, call: Callable[[argparse.Namespace], int], help: str, doing: str = ""
) -> argparse.ArgumentParser:
    """Return the parser of a new command; `call` runs it and returns its exit status.

    `doing` says what takes its time, as in "still checking files"; without it no progress is reported.
    """
    added: argparse.ArgumentParser = commands.add_parser(name, help=help, description=help)
    added.set_defaults(command=call, doing=doing)
    added.add_argument("--traceback", action="store_true", help="show where in the code an error comes from")
    return added


def count(text: str) -> int:
    """Return a positive number."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is not positive; give at least 1")
    return number


def seconds(name: str, least: float) -> Callable[[str], float]:
    """Return a parser of a time up to an hour; `name` says in its message what the time is for."""

    def parsed(text: str) -> float:
        time = float(text)
        if not least <= time <= 3600:
            raise argparse.ArgumentTypeError(f"{text} s is no {name}; give {least:g} to 3600")
        return time

    parsed.__name__ = "seconds"  # argparse tells it for what is no number
    return parsed


def scene_arguments(command: argparse.ArgumentParser, kind: str = "a scene file in TOML") -> None:
    """Add the scene file, or `kind` may be in its place, and its overrides."""
    command.add_argument("scene", metavar="SCENE", help=kind)
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a value, such as solver.tolerance=1e-8",
    )


def scene_on_all_ranks(comm: MPI.Comm, chosen: argparse.Namespace) -> AnyScene:
    """Return the same on all ranks; rank 0 alone reads the file. Collective; SceneError on all ranks."""
    text = from_rank_0(comm, lambda: read_text(chosen.scene), InputError)
    with together(comm, InputError):
        scene = scene_of(chosen, text)
    return scene


def scene_of(chosen: argparse.Namespace, text: str | None = None) -> AnyScene:
    """Return the scene that the arguments name, with its overrides and output folder; `text`: of its file, read before."""
    scene = scene_from(read_data(chosen.scene, chosen.set, text), chosen.scene)
    if getattr(chosen, "output", None) is None:
        return scene
    if not chosen.output:
        raise InputError("--output is empty; name a folder, or leave it out for runs/<name of the scene>")
    return scene.model_copy(update={"output": scene.output.model_copy(update={"directory": chosen.output})})
