"""Tables as HTML, as notebooks and reports show them; nothing in them is loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def table(head: Sequence[object], rows: Iterable[Sequence[object]], caption: str = "") -> str:
    """Return a table with a head, which may be empty, and a caption over it; texts are escaped."""
    top = f"<caption>{escape(caption)}</caption>" if caption else ""
    top += f"<thead>{_row('th', head)}</thead>" if head else ""
    return f"<table>{top}<tbody>{''.join(_row('td', row) for row in rows)}</tbody></table>"


def _row(tag: str, cells: Sequence[object]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(str(cell))}</{tag}>' for cell in cells)}</tr>"
