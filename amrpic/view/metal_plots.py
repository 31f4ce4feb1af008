"""Electrodes in pictures of a dump."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from ..conductors.surface import in_plane, outline
from ..errors import InputError
from ..io.field_reader import Dump
from ..mesh.raster import Raster
from ..scene.electrodes import ApertureMetal, ElectrodeSection, apertures_of_metal
from ..scene.obstacles import AnyAperture
from ..shapes import Shape

Array = NDArray[Any]

PIXELS = 800  # along the longer side


def metal_in(dump: Dump, raster: Raster) -> tuple[Array, Array] | None:
    """Return which pixels lie in electrodes of a dump's scene, and through which surfaces go; None without any.

    Of what was summed up along an axis these are outlines of electrodes alone.
    """
    shapes = _shapes(dump)
    if not shapes:
        return None
    extent = raster.upper - raster.lower
    most = PIXELS if raster.position is not None else PIXELS // 2  # of an outline each pixel is a line
    pixels = tuple(np.maximum(np.rint(most * extent / extent.max()), 1).astype(int).tolist())
    inside, surface = np.zeros((2, *pixels), bool)
    depth = dump.lower[raster.axis], dump.upper[raster.axis]
    for shape in shapes:
        if raster.position is None:
            surface |= outline(shape, raster.axes, depth, raster.lower, raster.upper, pixels)
            continue
        of_shape = in_plane(shape, raster.axes, raster.position, raster.lower, raster.upper, pixels)
        inside |= of_shape[0]
        surface |= of_shape[1]
    return inside, surface


def _shapes(dump: Dump) -> list[Shape]:
    """Return the shapes of electrodes, without those whose file is no longer there."""
    out: list[Shape] = []
    scene = json.loads(dump.scene_text)
    apertures = TypeAdapter(list[AnyAperture]).validate_python(scene.get("apertures", []))
    conductors: list[ElectrodeSection | ApertureMetal] = [
        ElectrodeSection(**electrode) for electrode in scene.get("electrodes", [])
    ]
    conductors += apertures_of_metal(apertures, dump.lower, dump.upper)
    for conductor in conductors:
        with suppress(InputError):
            out.append(conductor.value.shape)
    return out
