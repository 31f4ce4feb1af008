"""Where the walls are in which fast charge has images that move against it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..mesh.domain import AXES, FACES, Domain
from ..mesh.mirror import SIGNS, Mirror
from ..mesh.window import Window
from ..particles.energy_bins import Frames
from ..scene.scene import Scene


def mirrored(frames: Frames, last: Frames, scene: Scene, window: Window) -> Frames:
    """Return the frames with the walls across the motion, as they are from a window. InputError for walls that have no images.

    Images that were given up in the frames of the step before, `last`, stay so.
    """
    domain, axis = scene.domain.value, scene.axis_of_wall_left
    fast = any(member.is_fast for member in frames.members)
    if axis is not None and fast and frames.axis != axis:
        raise InputError(
            f"the window leaves a wall across {AXES[axis]} behind, and particles faster than 0.1 c move along "
            f'{AXES[frames.axis]}, beside it; make the faces of {AXES[axis]} "open", or set motion.window to "none"'
        )
    if axis is None or _is_at_wall(scene, axis, window):
        across = fast and bool(set(domain.boundary[frames.axis]) & set(SIGNS))
        return replace(frames, mirror=Mirror.of_faces(domain, frames.axis) if across else None, leaves=False)
    if last.leaves and last.mirror is not None and not last.mirror.reflects:
        return replace(frames, mirror=Mirror(axis), leaves=True)
    half = domain.spacing[axis] / 2
    mirror = Mirror.of_faces(domain, axis, half * float(np.round(window.origin[axis] / half)))
    _require_behind(mirror, domain)
    return replace(frames, mirror=mirror, leaves=True)


def _is_at_wall(scene: Scene, axis: int, window: Window) -> bool:
    """Whether the window rests at a wall that emits: for charge that is slow there it is a face of the mesh."""
    return window.origin[axis] == 0 and any(source.emits_at(axis) for source in scene.sources)


def _require_behind(mirror: Mirror, domain: Domain) -> None:
    """Raise InputError if the window has come back over the wall that it left."""
    axis, outwards = mirror.axis, (-1, 1)
    for side, (plane, face) in enumerate(zip(mirror.planes, (domain.lower[axis], domain.upper[axis]), strict=True)):
        if plane is not None and (face - plane.place) * outwards[side] > domain.spacing[axis] / 4:
            raise InputError(
                f"the window has come back by {abs(face - plane.place):.3g} m over the wall of {FACES[2 * axis + side]}, which "
                'it left behind; end the run before, or set motion.window to "none" and give the domain the length of the way'
            )
