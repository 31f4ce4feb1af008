"""Bunches whose particles are given one by one: by arrays, or by files."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..mesh.window import axes
from .bunches import Bunch, DescribedBunch
from .complaints import complaint
from .real_particle import Species
from .units import Angle, Length3

ParticleFile = Annotated[str, Field(description="The file; a relative path starts at the scene file.")]
Iteration = Annotated[int | None, Field(ge=0, description="Which iteration of the file; needed if it holds several.")]
GroupOfParticles = Annotated[
    str | None, Field(description="Name of the group of particles in the file; needed if it holds several.")
]


class MovedBunch(Bunch):
    """A bunch whose particles are turned about the origin of their own coordinates, then moved."""

    axis: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 1.0),
        description="Where the z axis of the given places and momenta points to in the scene, by the smallest turn about the "
        "origin; any length but 0.",
    )
    roll: Angle = Field(default=0.0, description="Turn about that axis, from its x towards y, rad.")
    shift: Length3 = Field(default=(0.0, 0.0, 0.0), description="By how much places are moved then, m.")

    @model_validator(mode="after")
    def _axis_has_length(self) -> Self:
        if not any(self.axis):
            self.refuse("axis", "has no length", "give a direction")
        return self

    @property
    def axes(self) -> np.ndarray:
        """Where its own axes point to: rows of a matrix (3, 3)."""
        return np.array(axes(self.axis, self.roll))


class OpenPMDBunch(MovedBunch):
    """Particles of one species in an openPMD file (HDF5), as the BeamPhysics package and other codes write it.

    Places and momenta are taken in the units that the file states; all particles must belong to one time, at which the run
    starts: see `schedule.start`. Each rank reads its share of the particles only.
    """

    distribution: Literal["openpmd"] = "openpmd"
    file: ParticleFile
    iteration: Iteration = None
    group: GroupOfParticles = None
    species: Species | None = Field(
        default=None, description="A name, or charge and mass of one real particle, in place of what the file says."
    )

    @property
    def number(self) -> int:
        return 0

    @property
    def source(self) -> str | None:
        return self.file


class ArrayBunch(MovedBunch, DescribedBunch):
    """Particles given one by one: arrays from Python, or an .npz file that holds them.

    The arrays themselves are no part of the resolved scene, which keeps their number and digest instead.
    """

    distribution: Literal["arrays"] = "arrays"
    file: str | None = Field(
        default=None, description="An .npz file with position, and momentum and weight if need be."
    )
    position: Any = Field(default=None, exclude=True, repr=False, description="Positions (n, 3), m.")
    momenta: Any = Field(
        default=None, exclude=True, repr=False, description="Momenta of one real particle each (n, 3), kg m/s."
    )
    weight: Any = Field(
        default=None,
        exclude=True,
        repr=False,
        description="Real particles per macroparticle (n,); 0 of test particles.",
    )
    particles: int | None = Field(default=None, ge=0, description="Number of particles; filled in.")
    digest: str | None = Field(default=None, description="SHA-256 of the arrays; filled in.")

    @model_validator(mode="before")
    @classmethod
    def _note_arrays(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or data.get("position") is None:
            return data
        arrays = {
            "position": _array(data, "position", (-1, 3)),
            "momenta": _array(data, "momenta", (-1, 3)),
            "weight": _array(data, "weight", (-1,)),
        }
        count = len(data["position"])
        for key, array in arrays.items():
            if array is not None and len(array) != count:
                raise complaint(
                    f"holds {len(array)} particles, position {count}", "give one row per particle", path=key, found=""
                )
        return {**data, **arrays, "particles": count, "digest": _digest(arrays.values())}

    @model_validator(mode="after")
    def _source(self) -> Self:
        if self.file is None and self.position is None and self.digest is None:
            self.refuse("position", "is missing", "give arrays from Python, or file = an .npz that holds them")
        without_charge = self.charge is None and self.particle_charge is None
        if self.position is not None and self.self_field and (self.weight is None) == without_charge:
            self.refuse("weight", "must be given, or else charge", "keep one of the two", found="both or neither")
        return self

    @property
    def number(self) -> int:
        return self.particles or 0

    @property
    def source(self) -> str | None:
        return self.file

    def arrays(self) -> dict[str, np.ndarray | None]:
        """Return position, momenta and weight, read from the file if one is named.

        Raises InputError if they are nowhere to be found, or not finite.
        """
        if self.position is not None:
            arrays = {"position": self.position, "momenta": self.momenta, "weight": self.weight}
        elif self.file is not None:
            arrays = _read_arrays(Path(self.file))
            if self.self_field and arrays["weight"] is None and self.charge is None and self.particle_charge is None:
                raise InputError(f"{self.file} holds no weight and the scene names no charge; add one of the two")
        else:
            raise InputError(
                f"a bunch of {self.particles} particles was given as arrays from Python, not kept by scene files; "
                "pass the arrays again, or restart from a checkpoint"
            )
        where = self.file or "arrays given from Python"
        for key, array in arrays.items():
            if array is not None and not np.isfinite(array).all():
                bad = int((~np.isfinite(array).reshape(len(array), -1).all(axis=1)).sum())
                raise InputError(
                    f"{key} of {bad} particles in {where} is NaN or infinite; remove or correct these rows"
                )
        weight = arrays["weight"]
        if weight is not None and not (weight >= 0).all():
            bad = int((weight < 0).sum())
            raise InputError(f"weight of {bad} particles in {where} is negative; remove or correct these rows")
        return arrays

    def __eq__(self, other: object) -> bool:
        # NumPy arrays do not compare to one truth value; the digest stands for them.
        return isinstance(other, ArrayBunch) and self.model_dump() == other.model_dump()

    def __hash__(self) -> int:
        return hash((self.file, self.digest))


def _array(data: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> np.ndarray | None:
    value = data.get(key)
    if value is None:
        return None
    try:
        if np.iscomplexobj(value):
            raise TypeError
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise complaint("is not an array of numbers", "give a NumPy array of floats", path=key, found="") from None
    if array.ndim != len(shape) or array.shape[1:] != shape[1:]:
        expected = "(n, 3)" if len(shape) == 2 else "(n,)"
        raise complaint(f"has the shape {array.shape}", f"give an array of shape {expected}", path=key, found="")
    return array


def _read_arrays(path: Path) -> dict[str, np.ndarray | None]:
    if not path.exists():
        raise InputError(
            f"particle file {path} does not exist; correct the path (relative ones start at the scene file)"
        )
    if path.suffix in (".h5", ".hdf5"):
        raise InputError(f'particle file {path} is no .npz file; give an openPMD file with distribution = "openpmd"')
    try:
        with np.load(path) as content:
            raw = {"position": content["position"], "momenta": content.get("momentum"), "weight": content.get("weight")}
            return {key: _array(raw, key, (-1,) if key == "weight" else (-1, 3)) for key in raw}
    except Exception as reason:
        raise InputError(
            f"particle file {path} cannot be read ({reason}); write it by "
            "np.savez(path, position=(n, 3), momentum=(n, 3), weight=(n,))"
        ) from None


def _digest(arrays: Iterable[np.ndarray | None]) -> str:
    total = hashlib.sha256()
    for array in arrays:
        total.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    return total.hexdigest()
