"""What users read: every public name has a docstring, links lead somewhere."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

import amrpic
from amrpic import gmls

ROOT = Path(__file__).parents[2]


def public(module: Any) -> Iterator[tuple[str, object]]:
    """Names of a module, and of its classes' own methods and properties, with what holds their docstring."""
    for name in module.__all__:
        thing = getattr(module, name)
        if not callable(thing):
            continue
        yield name, thing
        for key in vars(thing) if inspect.isclass(thing) else ():
            if key.startswith("_") or hasattr(BaseModel, key):
                continue
            member = inspect.getattr_static(thing, key)
            if inspect.isfunction(member) or isinstance(member, property | classmethod | staticmethod):
                yield f"{name}.{key}", getattr(thing, key) if isinstance(member, classmethod) else member


@pytest.mark.parametrize("module", [amrpic, gmls], ids=lambda module: module.__name__)
def test_every_public_name_has_a_docstring(module):
    found = dict(public(module))
    inherited = [vars(base) for name in module.__all__ for base in getattr(getattr(module, name), "__mro__", ())]
    missing = [
        name
        for name, thing in found.items()
        if not inspect.getdoc(thing)
        and not any(inspect.getdoc(of.get(name.split(".")[-1])) for of in inherited if name.split(".")[-1] in of)
    ]
    assert len(found) > 60
    assert not missing
