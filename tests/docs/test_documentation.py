"""What users read: every public name has a docstring, code on pages runs, and the site builds without a warning."""

from __future__ import annotations

import inspect
import re
import shutil
import subprocess
import sys
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


@pytest.mark.parametrize("page", ["extend"])
def test_code_on_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen: dict[str, Any] = {}
    for block in re.findall(
        r"```python\n(.*?)```", (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8"), re.DOTALL
    ):
        exec(block, seen)
    assert seen["with_wire"].step == 2
    assert seen["simulation"].hierarchy.levels == 2


def test_the_site_builds_without_a_warning(tmp_path):
    mkdocs = shutil.which("mkdocs", path=str(Path(sys.executable).parent))
    if mkdocs is None:
        pytest.skip("needs mkdocs: make docs")
    command = [mkdocs, "build", "-f", str(ROOT / ".mkdocs.yml"), "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    theory = (tmp_path / "site" / "theory.html").read_text(encoding="utf-8")
    assert theory.count("<math") > 100 and "arithmatex" not in theory
    pages = {page.name for page in (tmp_path / "site").glob("*.html")}
    assert {"index.html", "api.html", "extend.html", "scene.html"} <= pages
