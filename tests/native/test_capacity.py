"""Places of the padded layout are 32-bit numbers; a hierarchy that needs more is refused before anything is allocated."""

from __future__ import annotations

import pytest

from amrpic import _native


def boxes(count: int, edge: int) -> list[tuple[int, ...]]:
    return [(edge * n, 0, 0, edge * (n + 1) - 1, edge - 1, edge - 1) for n in range(count)]


@pytest.mark.parametrize("edge", [4, 20, 64])
def test_padding_is_counted_per_row_and_plane(edge):
    row = -(-edge // 16) * 16
    assert _native.padded_cells(boxes(3, edge), 0) == 3 * edge * (edge * row + 32)
    assert _native.padded_cells(boxes(3, edge), 4) > _native.padded_cells(boxes(3, edge), 0)


def test_cells_that_32_bits_count_may_have_places_that_they_do_not():
    """Boxes of four cells take 16 places a row: 2^29 of their cells are 2^31 places and the padding of planes."""
    count = 2**29 // 4**3
    per_box = _native.padded_cells(boxes(1, 4), 0)
    assert count * 4**3 < 2**31 - 1 < count * per_box
    refusal = _native.refusal_of_places(count * per_box, 2, 1)
    assert refusal.startswith(f"level 2 takes {count * per_box} padded cells on rank 1, more than 32-bit numbers count")
    assert _native.refusal_of_places(2**31 - 1, 2, 1) == "" != _native.refusal_of_places(2**31, 2, 1)
