"""Fields as objects of xarray, yt and PyVista, which are imported when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from .boxes import table_of
from .domain import AXES
from .hierarchy import Hierarchy

if TYPE_CHECKING:
    import pyvista
    import xarray


@dataclass(frozen=True)
class ExportedPart:
    """The values of a field in one box, from whatever rank."""

    level: int
    lower: tuple[int, int, int]
    data: np.ndarray  # (nx, ny, nz)
    covered: np.ndarray  # bool (nx, ny, nz)

    @property
    def upper(self) -> np.ndarray:
        return np.array(self.lower) + self.data.shape


@dataclass(frozen=True)
class Gathered:
    """A field with its boxes of all ranks, coarse to fine."""

    hierarchy: Hierarchy
    unit: str
    parts: list[ExportedPart]


def to_xarray(field: Gathered, level: int, name: str) -> xarray.DataArray:
    """Return a level over the smallest cuboid around its boxes, nan where it has no cells; see `Field.to_xarray`."""
    xarray = _imported("xarray")
    of_level = [part for part in field.parts if part.level == field.hierarchy._checked(level)]
    low = np.min([part.lower for part in of_level], axis=0)
    values = np.full(np.max([part.upper for part in of_level], axis=0) - low, np.nan)
    for part in of_level:
        values[tuple(map(slice, part.lower - low, part.upper - low))] = part.data
    h, origin = field.hierarchy.spacing(level), field.hierarchy.domain.lower
    centres = {
        axis: ((axis,), origin[d] + (low[d] + np.arange(n) + 0.5) * h[d], {"units": "m"})
        for d, (axis, n) in enumerate(zip(AXES, values.shape, strict=True))
    }
    about = {"units": field.unit, "level": level}
    return xarray.DataArray(values, dims=tuple(AXES), coords=centres, name=name, attrs=about)


def to_yt(fields: Mapping[str, Gathered]) -> Any:
    """Return fields of one hierarchy as a data set of yt, in m; see `Field.to_yt`."""
    yt = _imported("yt")
    first = next(iter(fields.values()))
    domain, grids = first.hierarchy.domain, []
    parents = [_Parents(first.hierarchy, level) for level in range(first.hierarchy.levels)]
    for together in zip(*(field.parts for field in fields.values()), strict=True):
        part = together[0]
        h = first.hierarchy.spacing(part.level)
        for lower, upper in parents[part.level].pieces(part):
            inside = tuple(map(slice, lower - part.lower, upper - part.lower))
            grids.append(
                {
                    "level": part.level,
                    "left_edge": domain.lower + lower * h,
                    "right_edge": domain.lower + upper * h,
                    "dimensions": upper - lower,
                    **{
                        name: (of_field.data[inside], field.unit.replace("^", "**") or "dimensionless")
                        for (name, field), of_field in zip(fields.items(), together, strict=True)
                    },
                }
            )
    return yt.load_amr_grids(
        grids,
        domain.cells,
        bbox=np.stack([domain.lower, domain.upper], axis=1),
        length_unit="m",
        unit_system="mks",
        refine_by=2,
        periodicity=domain.periodic,
    )


def to_pyvista(fields: Mapping[str, Gathered]) -> pyvista.MultiBlock:
    """Return fields of one hierarchy as a block per box, in which covered cells are hidden; see `Field.to_pyvista`."""
    pyvista = _imported("pyvista")
    first = next(iter(fields.values()))
    origin, blocks = np.array(first.hierarchy.domain.lower), pyvista.MultiBlock()
    for number, together in enumerate(zip(*(field.parts for field in fields.values()), strict=True)):
        part = together[0]
        h = first.hierarchy.spacing(part.level)
        shape = np.array(part.data.shape)
        block = pyvista.ImageData(dimensions=shape + 1, spacing=h, origin=origin + part.lower * h)
        for name, of_field in zip(fields, together, strict=True):
            block.cell_data[name] = of_field.data.ravel(order="F")
        block.cell_data["vtkGhostType"] = np.where(part.covered, HIDDEN, 0).astype(np.uint8).ravel(order="F")
        blocks.append(block, f"level {part.level}, box {number}")
    return blocks


HIDDEN = 8  # vtkDataSetAttributes.REFINEDCELL


class _Parents:
    """The boxes of the next coarser level, none of level 0."""

    def __init__(self, hierarchy: Hierarchy, level: int) -> None:
        self._boxes = hierarchy.boxes(level - 1) if level > 0 else None
        self._table = None if self._boxes is None else table_of(self._boxes)

    def pieces(self, part: ExportedPart) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the pieces of a part that lie within one of them each: yt hides what is covered by children of one parent."""
        lower, upper = np.array(part.lower), part.upper
        if self._boxes is None or self._table is None:
            yield lower, upper
            return
        for parent in self._boxes[self._table.meeting((lower // 2).tolist(), ((upper - 1) // 2).tolist())]:
            yield np.maximum(2 * parent[:3], lower), np.minimum(2 * parent[3:] + 2, upper)


def _imported(name: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError:
        raise InputError(f"{name} is not installed; pip install {name}") from None
