"""Tables as lines of text."""

from __future__ import annotations

from collections.abc import Sequence

from ..arithmetic import is_number


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
