"""All that is measured: `python benchmarks NAME [options]`; each NAME has its own `--help`."""

from __future__ import annotations

import argparse
import importlib
import inspect
import re
import sys
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

HERE = Path(__file__).parent
TESTS = HERE.parent / "tests"  # whose exact answers benchmarks share


def names() -> list[str]:
    """What can be measured: the modules here that have a `run` or a `main`."""
    files = [*HERE.glob("*.py"), *HERE.glob("*/command.py")]
    found = [path for path in files if re.search(r"^def (run|main)\(", path.read_text(encoding="utf-8"), re.MULTILINE)]
    return sorted(path.stem if path.parent == HERE else path.parent.name for path in found if path.stem != "__main__")


def main() -> int | None:
    """Run what is named."""
    if len(sys.argv) < 2 or sys.argv[1] not in names():
        sys.exit(f"{__doc__}\n\n  {'  '.join(names())}")
    name = sys.argv.pop(1)
    sys.argv[0] = f"python benchmarks {name}"
    sys.path.insert(1, str(TESTS))
    module = importlib.import_module(f"{name}.command" if (HERE / name).is_dir() else name)
    return measure(module, sys.argv[1:]) if hasattr(module, "run") else module.main()


def measure(module: ModuleType, words: list[str]) -> int | None:
    """Call `run` of a module with options of the command line; records that it yields are printed, and written on request."""
    chosen = vars(parser_of(module.run, module.__doc__).parse_args(words))
    if not yields_records(module.run):
        return module.run(**chosen)
    from mpi4py import MPI

    from measuring import printed, write

    output, records = chosen.pop("output"), []
    show = getattr(module, "printed", printed)
    for record in module.run(**chosen):
        records.append(record)
        if MPI.COMM_WORLD.rank == 0:
            print(show(record), flush=True)
    if MPI.COMM_WORLD.rank == 0 and output is not None:
        write(output, records)
    return None


def yields_records(run: Callable[..., Any]) -> bool:
    return typing.get_origin(typing.get_type_hints(run).get("return")) is Iterator


def parser_of(run: Callable[..., Any], about: str | None) -> argparse.ArgumentParser:
    """Options as a function has parameters: `Annotated[type, help, choices]`; a bool is a flag, a tuple takes several."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    hints = typing.get_type_hints(run, include_extras=True)
    for name, parameter in inspect.signature(run).parameters.items():
        add(parser, name, parameter, hints[name])
    if yields_records(run):
        parser.add_argument("--output", type=Path, metavar="FILE", help="the JSON to write")
    return parser


def add(parser: argparse.ArgumentParser, name: str, parameter: inspect.Parameter, hint: Any) -> None:
    """Add the option of a parameter; one without a default is an argument."""
    kind, *notes = typing.get_args(hint) if hasattr(hint, "__metadata__") else (hint,)
    options: dict[str, Any] = {"help": next((note for note in notes if isinstance(note, str)), None)}
    choices = next((note for note in notes if not isinstance(note, str)), None)
    if choices is not None:
        options["choices"] = list(choices)
    if kind is bool:
        options["action"] = "store_true"
    elif typing.get_origin(kind) is tuple:
        each = typing.get_args(kind)[0]
        options |= {"type": str if typing.get_origin(each) is typing.Literal else each, "nargs": "+"}
    else:
        options["type"] = next(
            (each for each in typing.get_args(kind) if each is not type(None)), kind
        )  # of an optional one
    if parameter.default is inspect.Parameter.empty:
        parser.add_argument(name, **options)
    else:
        parser.add_argument(f"--{name.replace('_', '-')}", default=parameter.default, **options)


if __name__ == "__main__":
    sys.exit(main())
