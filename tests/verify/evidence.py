"""docs/reports/evidence.md: which table belongs to which topic."""

from __future__ import annotations

import re
from pathlib import Path

EVIDENCE = Path(__file__).parents[2] / "docs" / "reports" / "evidence.md"


def tables_of_topics() -> dict[str, list[str]]:
    """The titles of the tables of each topic, as the page has them."""
    rows = re.findall(r"^\| `([a-z0-9-]+)`(?: °)? \| (.*) \|$", EVIDENCE.read_text(encoding="utf-8"), re.MULTILINE)
    return {topic: titles.split("; ") for topic, titles in rows}
