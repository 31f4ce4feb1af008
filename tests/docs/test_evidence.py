"""docs/reports/evidence.md: every test that it names is there, and every table of the verification is in it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from verify import TOPICS
from verify.evidence import EVIDENCE, tables_of_topics
from verify.test_topics import SHORT

TESTS = Path(__file__).parents[1]


def names_of_tests(path: Path) -> set[str]:
    """Names of the tests of a file."""
    return {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


def test_every_test_that_holds_a_law_is_there():
    named = re.findall(r"`([a-z_]+/test_\w+\.py)::(test_\w+)`", EVIDENCE.read_text(encoding="utf-8"))
    assert len(named) > 60
    assert [f"{path}::{name}" for path, name in named if name not in names_of_tests(TESTS / path)] == []


def test_every_law_names_a_test():
    laws = EVIDENCE.read_text(encoding="utf-8").split("## Laws")[1].split("## Tables")[0]
    rows = [line for line in laws.splitlines() if line.startswith("| ")][1:]
    assert len(rows) >= 54 and all("::test_" in row.split(" | ")[-1] for row in rows)


def test_every_table_of_the_verification_belongs_to_a_topic():
    tables = tables_of_topics()
    assert list(tables) == list(TOPICS)
    known = {title for titles in tables.values() for title in titles}
    published = re.findall(
        r"^## (.*)$", EVIDENCE.with_name("verification.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert {
        title for title in published if not title.startswith(("Speed against error: ", "Order 4 and order 2: "))
    } <= known


def test_topics_with_a_short_form_are_marked():
    marked = re.findall(r"^\| `([a-z0-9-]+)` °", EVIDENCE.read_text(encoding="utf-8"), re.MULTILINE)
    assert tuple(marked) == tuple(topic for topic in TOPICS if topic in SHORT)
