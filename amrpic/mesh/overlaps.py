"""What cells of two lattices on one domain have in common, and the means of polynomials there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Interval:
    """Along one axis: what each of some cells has in common with one of the cells of the other lattice."""

    other: Array  # (n,) which one
    there: Array  # (n,) bool: whether it has anything in common
    moments: (
        Array  # (5, n): means of the powers of the coordinate in the source cell, -1/2 to 1/2, over the common part
    )
    of_source: Array  # (n,) the common part over the source cell
    of_target: Array  # (n,) the same over the target cell


def intervals(cells: Array, extent: int, extent_of_other: int, source_here: bool) -> list[Interval]:
    """Return the common parts of cells (n,) of a lattice of `extent` cells with those of one of `extent_of_other`, in order.

    `source_here`: polynomials live on the cells here, else on those there. Ends are found in whole numbers.
    """
    first = cells * extent_of_other // extent
    count = ((cells + 1) * extent_of_other - 1) // extent - first + 1
    return [
        _interval(cells, first + n, n < count, extent, extent_of_other, source_here)
        for n in range(int(count.max(initial=0)))
    ]


def _interval(
    cells: Array, partner: Array, valid: Array, extent: int, extent_of_other: int, source_here: bool
) -> Interval:
    source, target = (cells, partner) if source_here else (partner, cells)
    of_source, of_target = (extent, extent_of_other) if source_here else (extent_of_other, extent)
    low = np.maximum(target * of_source - source * of_target, 0)  # from the source cell's lower end, width of_target
    high = np.minimum((target + 1) * of_source - source * of_target, of_target)
    length = np.where(valid, high - low, 0)
    u, a = (low + high) / (2 * of_target) - 0.5, (high - low) / (2 * of_target)
    moments = np.stack([np.ones(len(u)), u, u**2 + a**2 / 3, u**3 + u * a**2, u**4 + 2 * u**2 * a**2 + a**4 / 5])
    return Interval(partner, valid, moments, length / of_target, length / of_source)


@dataclass(frozen=True)
class CommonPart:
    """Common parts of a block of cells with one cell of the other lattice each."""

    axes: tuple[Interval, Interval, Interval]

    @property
    def there(self) -> tuple[Array, ...]:
        """The other cells, to index an array by."""
        return np.ix_(*(axis.other for axis in self.axes))

    @property
    def of_source(self) -> Array:
        """The common volume over that of the source cell, (nx, ny, nz)."""
        return _product([axis.of_source for axis in self.axes])

    @property
    def of_target(self) -> Array:
        """The common volume over that of the target cell."""
        return _product([axis.of_target for axis in self.axes])

    def deviation(self, coefficients: Array, exponents: Array) -> Array:
        """Return means over the common parts of polynomials less those over their cells, from coefficients (n, nx, ny, nz).

        Summed in the order of the monomials: the same whatever block a cell is in.
        """
        out = np.zeros(coefficients.shape[1:])
        for coefficient, powers in zip(coefficients, exponents, strict=True):
            factors = [axis.moments[p] for axis, p in zip(self.axes, powers, strict=True)]
            out += coefficient * (_product(factors) - float(np.prod(CELL_MOMENTS[powers])))
        return out


CELL_MOMENTS = np.array([1.0, 0.0, 1 / 12, 0.0, 1 / 80])  # means of powers over a whole cell


def _product(axes: Sequence[Array]) -> Array:
    x, y, z = axes
    return x[:, None, None] * y[None, :, None] * z[None, None, :]


def parts(corners: Array, extents: Array, extents_of_other: Array, source_here: bool) -> Iterator[CommonPart]:
    """Yield the common parts of a box of cells of a lattice with all those of another; lattices by cells along the axes."""
    along = [
        intervals(np.arange(corners[d], corners[3 + d] + 1), int(extents[d]), int(extents_of_other[d]), source_here)
        for d in range(3)
    ]
    for z, y, x in product(*along[::-1]):
        yield CommonPart((x, y, z))
