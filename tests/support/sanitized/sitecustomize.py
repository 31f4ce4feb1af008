"""Lets Python find the amrpic that lies beside this file, before the installed one; `make sanitize` puts both in one folder."""

import sys
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path


class Beside:
    """Finds one package in this folder; what is below it then follows from its path."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        return PathFinder.find_spec(name, [str(Path(__file__).parent)]) if name == "amrpic" else None


sys.meta_path[:] = [Beside, *(f for f in sys.meta_path if not type(f).__name__.startswith("ScikitBuild"))]
