"""What a mesh cuts of electrodes, in words: how many cells, how small the pieces of arms are, and what STL files were like."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..conductors.arms import CutArms, arms_of_boxes
from ..mesh.hierarchy import Hierarchy
from ..scene.electrodes import Electrode
from ..scene.scene import Scene
from ..shapes import Mesh, Shape
from ..shapes.shape import Combination, Placed
from ..units import quantity
from .driven_electrodes import compared_electrodes


def describe_scene(scene: Scene) -> list[str]:
    """Return a line for each electrode of a scene, on its base level, and remarks on them. Serial; raises InputError."""
    if not scene.conductors:
        return []
    domain, (electrodes, remarks) = scene.domain.value, compared_electrodes(scene)
    arms, _ = arms_of_boxes(electrodes, [[0, 0, 0, *(n - 1 for n in domain.cells)]], domain.lower, domain.spacing)
    return [*_lines(electrodes, [arms], "of the base level"), *(f"note: {remark}" for remark in remarks)]


def describe(electrodes: Sequence[Electrode], hierarchy: Hierarchy) -> list[str]:
    """Return a line for each electrode on the finest cells of a mesh. Collective."""
    if not electrodes:
        return []
    parts = hierarchy.comm.allgather(_own_arms(electrodes, hierarchy))
    return _lines(electrodes, [arms for part in parts for arms in part], "of all levels")


def cut_cells(electrodes: Sequence[Electrode], hierarchy: Hierarchy) -> int:
    """Return the number of cells of a mesh beside metal. Collective."""
    return hierarchy.comm.allreduce(sum(len(arms.cell) for arms in _own_arms(electrodes, hierarchy)))


def _own_arms(electrodes: Sequence[Electrode], hierarchy: Hierarchy) -> list[CutArms]:
    """Return the arms of the boxes of this rank that metal cuts, by levels. Local."""
    return [
        arms_of_boxes(electrodes, boxes, hierarchy.domain.lower, hierarchy.spacing(level))[0]
        for level in range(hierarchy.levels)
        if electrodes and len(boxes := hierarchy.boxes(level)[hierarchy.owners(level) == hierarchy.comm.rank])
    ]


def _lines(electrodes: Sequence[Electrode], parts: Sequence[CutArms], where: str) -> list[str]:
    out = []
    for number, electrode in enumerate(electrodes):
        solid = sum(int((arms.solid_electrode == number).sum()) for arms in parts)
        beside = sum(int((arms.electrode == number).any(axis=1).sum()) for arms in parts)
        shares = np.concatenate([arms.theta[arms.electrode == number] for arms in parts])
        text = f"electrode {electrode.name}, {_drive(electrode)}: {solid} cells {where} in metal, {beside} beside it"
        if len(shares):
            text += f", {len(shares)} arms cut, the shortest at {shares.min():.2g} of it"
        else:
            text += (
                "; no arm between centres of cells meets it, so that the field does not see it: refine the mesh there"
            )
        out += [text]
        out += [f"  {mesh.path}: {mesh.report}" for mesh in _meshes(electrode.shape)]
    return out


def _drive(electrode: Electrode) -> str:
    value, unit = (electrode.charge, "C") if electrode.floats else (electrode.voltage, "V")
    return value if isinstance(value, str) else quantity(float(value or 0), unit)


def _meshes(shape: Shape) -> Iterator[Mesh]:
    """Yield the STL files that a shape is made of."""
    if isinstance(shape, Mesh):
        yield shape
    parts = shape.parts if isinstance(shape, Combination) else (shape.shape,) if isinstance(shape, Placed) else ()
    for part in parts:
        yield from _meshes(part)
