"""Tables: as lines of text, and as HTML, as notebooks and reports show them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from .arithmetic import is_number


def html(head: Sequence[object], rows: Iterable[Sequence[object]], caption: str = "") -> str:
    """Return a table with a head, which may be empty, and a caption over it; texts are escaped."""
    top = f"<caption>{escape(caption)}</caption>" if caption else ""
    top += f"<thead>{_row('th', head)}</thead>" if head else ""
    return f"<table>{top}<tbody>{''.join(_row('td', row) for row in rows)}</tbody></table>"


def _row(tag: str, cells: Sequence[object]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(str(cell))}</{tag}>' for cell in cells)}</tr>"


def columns(rows: Sequence[Sequence[object]]) -> list[str]:
    """Return rows of cells, the first of which may be a head, as lines with aligned columns: numbers to the right."""
    table = [list(map(str, column)) for column in zip(*rows, strict=True)]
    widths = [max(map(len, column)) for column in table]
    to_right = [all(map(is_number, column[1:])) for column in table]
    return [
        "  ".join(
            str(cell).rjust(width) if right else str(cell).ljust(width)
            for cell, width, right in zip(row, widths, to_right, strict=True)
        ).rstrip()
        for row in rows
    ]
