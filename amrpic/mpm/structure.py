"""Which material is where at the start."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import scipy
from pydantic import Field, model_validator

from ..errors import SceneError
from ..scene.section import Section
from ..scene.units import Length, Length3

EMPTY = "empty"  # where there is no material, and no point
JOINT = 0.12  # width of joints between grains, over the mean distance of these

Names = Iterator[tuple[str, str]]  # keys, and materials that they name
Corners = tuple[np.ndarray, np.ndarray]


class Ball(Section):
    """A ball."""

    shape: Literal["ball"] = "ball"
    material: str = Field(description="What is there.")
    centre: Length3 = Field(description="Its centre, m.")
    radius: Length = Field(gt=0, description="Its radius, m.")

    def holds(self, places: np.ndarray) -> np.ndarray:
        """Return which places (n, 3) in m lie in it. Local."""
        return np.asarray(((places - np.array(self.centre)) ** 2).sum(axis=1) <= self.radius**2)


class Cuboid(Section):
    """A cuboid along the axes."""

    shape: Literal["box"] = "box"
    material: str = Field(description="What is there.")
    lower: Length3 = Field(description="Lower corner, m.")
    upper: Length3 = Field(description="Upper corner, m.")

    def holds(self, places: np.ndarray) -> np.ndarray:
        """Return which places (n, 3) in m lie in it. Local."""
        inside = (places >= np.array(self.lower)) & (places < np.array(self.upper))
        return np.asarray(inside.all(axis=1))


class Structure(Section, ABC):
    """What all kinds of structure have."""

    @abstractmethod
    def names(self, materials: Sequence[str]) -> Names:
        """Yield the materials that are named, and where."""

    @abstractmethod
    def labels(self, places: np.ndarray, corners: Corners, materials: Sequence[str]) -> np.ndarray:
        """Return the number of the material at each place (n, 3) in m, (n,); -1 where there is none. Local.

        Raises SceneError for a file that is not there, is something else, or has a label that means no material.
        """

    def check(self) -> None:
        """Raise SceneError as `labels` does."""


class Regions(Structure):
    """One material with others in it."""

    kind: Literal["regions"] = "regions"
    material: str | None = Field(
        default=None, description="What is where no region is; the first material if not given."
    )
    regions: list[Annotated[Ball | Cuboid, Field(discriminator="shape")]] = Field(
        default=[], description="Bodies of other materials; where two overlap, the later one counts."
    )

    def names(self, materials: Sequence[str]) -> Names:
        yield "material", self._around(materials)
        for number, region in enumerate(self.regions):
            yield f"regions.{number}.material", region.material

    def labels(self, places: np.ndarray, corners: Corners, materials: Sequence[str]) -> np.ndarray:
        number = _numbers(materials)
        out = np.full(len(places), number[self._around(materials)])
        for region in self.regions:
            out[region.holds(places)] = number[region.material]
        return out

    def _around(self, materials: Sequence[str]) -> str:
        return materials[0] if self.material is None else self.material


class Voronoi(Structure):
    """Grains that grew from random seeds until joints of binder, 0.12 of their distance, were left between them, and voids."""

    kind: Literal["voronoi"] = "voronoi"
    grains: int = Field(ge=1, le=10**6, description="How many grains there are.")
    grain: str = Field(description="The material of grains.")
    binder: str = Field(description="The material between them.")
    voids: float = Field(
        default=0.0, ge=0, lt=0.9, description="Part of the volume that round voids take, in the mean."
    )
    void: str = Field(default=EMPTY, description="What is in them.")
    seed: int = Field(default=1, ge=0, description="Of their places.")

    def names(self, materials: Sequence[str]) -> Names:
        yield from (("grain", self.grain), ("binder", self.binder))
        if self.voids > 0:
            yield "void", self.void

    def labels(self, places: np.ndarray, corners: Corners, materials: Sequence[str]) -> np.ndarray:
        number, (lower, upper) = _numbers(materials), corners
        draw = np.random.default_rng(self.seed)
        volume = float(np.prod(upper - lower))
        spacing = (volume / self.grains) ** (1 / 3)
        centres = lower + draw.uniform(size=(self.grains, 3)) * (upper - lower)
        near = scipy.spatial.cKDTree(centres).query(places, k=min(2, self.grains))[0].reshape(len(places), -1)
        joint = near[:, -1] - near[:, 0] < JOINT * spacing if self.grains > 1 else np.zeros(len(places), dtype=bool)
        out = np.where(joint, number[self.binder], number[self.grain])
        # Balls overlap, and some reach in from outside: of centres without order, of balls that add up to a part a of the
        # space, a place is in none with the probability exp(-a).
        largest, reach = 0.5 * spacing, 0.0
        extent = upper - lower + 2 * largest
        while reach < -np.log(1 - self.voids):
            radius = draw.uniform(0.3, 0.5) * spacing
            centre = lower - largest + draw.uniform(size=3) * extent
            out[((places - centre) ** 2).sum(axis=1) <= radius**2] = number[self.void]
            reach += 4 / 3 * np.pi * radius**3 / float(np.prod(extent))
        return out


class Voxels(Structure):
    """Labels of voxels from a file, that fill the domain."""

    kind: Literal["voxels"] = "voxels"
    file: str = Field(
        description="A .npy of whole numbers with three axes, x first; relative paths start at the scene."
    )
    materials: dict[str, str] = Field(min_length=1, description='Which material each label means: { 0 = "sand" }.')

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for label in self.materials:
            if not label.lstrip("-").isdigit():
                self.refuse(f"materials.{label}", "is no label", "use whole numbers as keys", found=label)
        return self

    def names(self, materials: Sequence[str]) -> Names:
        yield from ((f"materials.{label}", name) for label, name in self.materials.items())

    def labels(self, places: np.ndarray, corners: Corners, materials: Sequence[str]) -> np.ndarray:
        number, (lower, upper) = _numbers(materials), corners
        voxels = self.read()
        labels = np.unique(voxels)
        meant = np.array([number[self.materials[str(label)]] for label in labels])
        at = ((places - lower) / (upper - lower) * voxels.shape).astype(int)
        i, j, k = np.clip(at, 0, np.array(voxels.shape) - 1).T
        return meant[np.searchsorted(labels, voxels[i, j, k])]

    def check(self) -> None:
        self.read()

    def read(self) -> np.ndarray:
        """Return the labels. Raises SceneError as `labels` does."""
        try:
            voxels = np.load(Path(self.file), allow_pickle=False)
            if not isinstance(voxels, np.ndarray):
                raise ValueError("it holds several arrays")
        except (OSError, ValueError, EOFError) as reason:
            raise SceneError(f"structure.file {self.file} cannot be read ({reason}); give a .npy of labels") from None
        if voxels.ndim != 3 or voxels.size == 0 or voxels.dtype.kind not in "iu":
            raise SceneError(
                f"structure.file {self.file} holds {voxels.dtype} of shape {voxels.shape}; give whole numbers with three axes"
            )
        for label in np.unique(voxels):
            if str(label) not in self.materials:
                raise SceneError(
                    f"structure.file {self.file} has the label {label}, which means no material; add {label} to "
                    "structure.materials"
                )
        return voxels


def _numbers(materials: Sequence[str]) -> dict[str, int]:
    """The number of each material, -1 for nothing."""
    return {name: number for number, name in enumerate(materials)} | {EMPTY: -1}
