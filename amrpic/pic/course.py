"""The reference particle and the window: how the mesh goes along with a beam."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from .. import _native
from ..external import ExternalFields
from ..mesh.domain import AXES
from ..mesh.window import AT_REST, Vector, Window, vector, window_of
from ..scene.scene import Scene
from ..stages.push import pusher_of
from ..units import SPEED_OF_LIGHT
from .emitters import Emitter


@dataclass(frozen=True)
class ReferenceParticle:
    """A particle that moves by the fields of elements alone; place and momentum are of one time, in the laboratory."""

    position: Vector  # m
    momentum: Vector  # kg m/s
    charge: float  # C
    mass: float  # kg
    path: float = 0.0  # m, the length of its way so far

    @property
    def velocity(self) -> np.ndarray:
        """(3,) m/s."""
        momentum = np.array(self.momentum)
        return momentum / math.hypot(self.mass, float(np.linalg.norm(momentum)) / SPEED_OF_LIGHT)

    def after(self, dt: float, time: float, external: ExternalFields, pusher: str) -> ReferenceParticle:
        """Return the particle `dt` s later than `time` s, moved as `push` moves those of a beam, by kick, drift and kick."""
        constants = self.charge, self.mass
        fields = external.native
        method = pusher_of(pusher)
        position, half = _native.push_one(
            self.position, self.momentum, *constants, 0.0, dt / 2, dt, method, fields, time
        )
        position, whole = _native.push_one(position, half, *constants, dt / 2, 0.0, 0.0, method, fields, time + dt)
        path = self.path + math.dist(position, self.position)
        return ReferenceParticle(vector(position), vector(whole), *constants, path)


@dataclass(frozen=True)
class Course:
    """Where the reference particle is, if there is one, and the window."""

    reference: ReferenceParticle | None = None
    window: Window = AT_REST
    goes: str = "nowhere"  # with the reference particle: "x", "y" or "z" along that axis, "turning" wherever it goes
    stride: float = 0.0  # m by which it goes along an axis: a wall left behind stays on the lattice of the mesh; 0: any
    start: float = 0.0  # place of the reference particle along that axis where the window is at rest, m
    stays: float = -math.inf  # s until which the window is at rest at least, as sources at the wall behind it emit

    @property
    def path(self) -> float:
        """Length s of the way of the reference particle so far, m; nan without one."""
        return math.nan if self.reference is None else self.reference.path

    @property
    def velocity(self) -> np.ndarray:
        """Velocity (3,) of the window along its own axes, m/s."""
        if self.reference is None or self.goes == "nowhere":
            return np.zeros(3)
        along = [self.goes in (axis, "turning") for axis in AXES]
        return self.window.from_laboratory(np.where(along, self.reference.velocity, 0.0))

    @classmethod
    def of_scene(cls, scene: Scene, emitters: Sequence[Emitter] = ()) -> Course:
        """Return the course at the start of a scene with these sources."""
        start = scene.reference
        if start is None:
            return cls()
        species = start.species
        reference = ReferenceParticle(start.position, start.mean_momentum, species.charge, species.mass)
        if (axis := scene.window_axis) is None:
            return cls(reference)
        if not all(face == "open" for pair in scene.domain.boundary.values() for face in pair):
            return cls(reference, goes=AXES[axis], start=reference.position[axis]).on_base_of(scene, emitters)
        window = _turned(AT_REST, reference, np.eye(3)[axis] * reference.momentum[axis], reference)
        return cls(reference, window, goes="turning")

    def on_base_of(self, scene: Scene, emitters: Sequence[Emitter]) -> Course:
        """Return the course with a window that goes by the base cells of a scene, if it leaves a wall behind: not before the
        sources at that wall have ended, nor before the reference particle is in the middle.
        """
        axis = scene.axis_of_wall_left
        if axis is None:
            return self
        out = replace(self, stride=float(scene.domain.value.spacing[axis]))
        stops = [emitter.stop_time for emitter in emitters if emitter.source.emits_at(axis)]
        if not stops or self.window.origin != AT_REST.origin:
            return out
        middle = (scene.domain.lower[axis] + scene.domain.upper[axis]) / 2
        return replace(out, start=max(self.start, middle), stays=max(0.0, *stops))

    def after(self, dt: float, time: float, external: ExternalFields, pusher: str) -> Course:
        """Return the course `dt` s later than `time` s, in fields of elements in the laboratory."""
        if self.reference is None:
            return self
        now, later = self.reference, self.reference.after(dt, time, external, pusher)
        window = self.window
        if self.goes == "turning":
            window = _turned(window, now, np.array(now.momentum), later)
        elif self.goes in AXES:
            along = [axis == self.goes for axis in AXES]
            place = later.position[AXES.index(self.goes)]
            if self._waits(time + dt, place):
                return replace(self, reference=later, start=max(self.start, place))
            if self.stride > 0:
                origin = self.stride * np.round(np.subtract(later.position, self.start) / self.stride)
            else:
                origin = window.origin + np.subtract(later.position, now.position)
            window = window.at(np.where(along, origin, 0.0))
        return replace(self, reference=later, window=window)

    def _waits(self, time: float, place: float) -> bool:
        """Whether the window is at rest still: until sources behind it end, and the reference particle is in the middle."""
        emits = self.stays > -math.inf and self.window.origin == AT_REST.origin
        return emits and (time < self.stays or place < self.start)

    def to_dict(self) -> dict[str, Any]:
        """Return what JSON can hold; numbers keep every bit."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Course:
        """Return the course that `to_dict` gave."""
        reference = values["reference"]
        if reference is not None:
            vectors = {key: tuple(reference[key]) for key in ("position", "momentum")}
            reference = ReferenceParticle(**{**reference, **vectors})
        optional = {key: values[key] for key in ("stride", "start", "stays") if key in values}
        return cls(reference, window_of(values["window"]), values["goes"], **optional)


def _turned(window: Window, now: ReferenceParticle, direction: np.ndarray, later: ReferenceParticle) -> Window:
    """Return the window that goes with a particle and turns from a direction to its new one: it keeps its place on the mesh."""
    place = window.from_laboratory(np.subtract(now.position, window.origin))
    turned = window.turned(direction, np.array(later.momentum))
    return replace(turned.at(later.position - turned.to_laboratory(place)), pivot=vector(place))
