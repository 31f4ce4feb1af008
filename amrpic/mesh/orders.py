"""Orders of polynomials that are fitted to cells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError


def require_order(order: object, orders: Sequence[int], name: str) -> None:
    """Raise InputError unless an order, said to be that of `name`, is a whole number among these. Local."""
    if isinstance(order, bool) or not isinstance(order, int | np.integer) or order not in orders:
        *first, last = map(str, orders)
        raise InputError(f"the order of {name} is {order!r:.60}; use {', '.join(first)} or {last}")
