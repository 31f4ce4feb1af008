"""What users read: every public name has a docstring, links lead somewhere."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

import amrpic
from amrpic import gmls

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"\]\(<?([^)>\s]+)>?\)")


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


def anchors(page: Path) -> set[str]:
    """What links can point at on a page: its headings, as sites and GitHub name them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def test_links_between_pages_lead_somewhere():
    missing, seen = [], 0
    made = {
        f"docs/tutorials/{path.stem}.md" for path in (ROOT / "docs" / "tutorials").glob("*.py")
    }  # on the site alone
    for page in PAGES:
        for link in LINK.findall(page.read_text(encoding="utf-8")):
            if re.match("[a-z]+:", link):
                continue
            seen += 1
            path, _, anchor = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            if str(target.relative_to(ROOT)) not in made and (
                not target.exists() or (anchor and anchor not in anchors(target))
            ):
                missing.append(f"{page.name}: {link}")
    assert seen > 100 and missing == []


def test_links_to_other_servers_are_listed():
    """`docs/site/external_links.txt` is what to try by hand now and then; tests ask no other server."""
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    found = sorted({link.rstrip(".,;") for text in texts for link in re.findall(r"https?://[^\s)>\"`\]]+", text)})
    assert (ROOT / "docs" / "site" / "external_links.txt").read_text(encoding="utf-8").splitlines() == found
