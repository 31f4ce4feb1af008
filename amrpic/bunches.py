"""The bunches of a scene: how many particles of which charge lie where, and how they move."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from .errors import InputError
from .section import Section, refuse_negative
from .species import Species
from .units import Charge, Index3, Length, Length3, Momentum3, Velocity3, complaint


class Bunch(Section):
    """What all bunches have; a train repeats it along a straight line or at given places."""

    name: str = Field(default="", description="A name of your own, kept in the outputs.")
    species: Species = Field(
        default=Species.model_validate("proton"),
        description="A name, or charge (C) and mass (kg) of one real particle. The default is a proton: "
        "only motion depends on the species, the field on the charge of the bunch alone.",
    )
    charge: Charge | None = Field(default=None, description="Charge of one bunch, C; has the sign of the species.")
    particle_charge: Charge | None = Field(
        default=None, description="Charge of one macroparticle, C, in place of the charge of the bunch."
    )
    momentum: Momentum3 | None = Field(default=None, description="Mean momentum of one real particle, kg m/s.")
    velocity: Velocity3 | None = Field(default=None, description="Mean velocity, m/s, in place of the momentum.")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.momentum is not None and self.velocity is not None:
            raise complaint("is given as well as momentum", "keep one of the two", path="velocity", found=self.velocity)
        if self.charge is not None and self.particle_charge is not None:
            raise complaint(
                "is given as well as charge", "keep one of the two", path="particle_charge", found=self.particle_charge
            )
        key = "charge" if self.particle_charge is None else "particle_charge"
        given = getattr(self, key)
        if given is not None and given * self.species.charge < 0:
            raise complaint(
                f"has the other sign than the {self.species.charge:g} C of its species",
                f"write {-given:g} or change the species",
                path=key,
                found=given,
            )
        if given is not None and self.number > 0 and (given == 0 or self.species.charge == 0):
            where = key if given == 0 else "species.charge"
            raise complaint(
                "makes every particle's charge zero", "give a charge, or particles = 0", path=where, found=0.0
            )
        return self

    @property
    def number(self) -> int:
        """Macroparticles of one bunch."""
        raise NotImplementedError

    @property
    def bunch_charge(self) -> float:
        """Charge of one bunch in C."""
        return self.charge_of(self.number)

    def charge_of(self, number: int) -> float:
        """Charge in C of a bunch of so many macroparticles."""
        return self.particle_charge * number if self.particle_charge is not None else self.charge or 0.0

    @property
    def mean_momentum(self) -> tuple[float, float, float]:
        """Mean momentum of one real particle in kg m/s."""
        if self.momentum is not None:
            return self.momentum
        x, y, z = self.velocity or (0.0, 0.0, 0.0)
        return (x * self.species.mass, y * self.species.mass, z * self.species.mass)

    def places(self) -> list[tuple[float, float, float]]:
        """Centres of the bunches of the train in m."""
        return []

    @property
    def copies(self) -> int:
        """Bunches of this kind."""
        return max(len(self.places()), 1)

    def zero_size(self) -> bool:
        """Whether all particles of a bunch sit in one point, line or plane."""
        return False


class Train(Bunch):
    """A bunch with a centre, or several of them."""

    particles: int = Field(ge=0, description="Macroparticles per bunch; the noise of ρ falls with its root.")
    centre: Length3 = Field(default=(0.0, 0.0, 0.0), description="Centre of the bunch or the train, m.")
    count: int = Field(default=1, ge=1, description="Bunches in the train, symmetric about the centre.")
    spacing: Length3 | None = Field(default=None, description="From one bunch of the train to the next, m.")
    centres: list[Length3] | None = Field(
        default=None, min_length=1, description="Centres one by one, m, in place of a train."
    )
    momentum_spread: Momentum3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Standard deviation of the momentum per axis, kg m/s; 0 is cold.",
    )

    @model_validator(mode="after")
    def _train(self) -> Self:
        for axis, spread in enumerate(self.momentum_spread):
            refuse_negative(f"momentum_spread.{axis}", spread, "kg m/s")
        if self.charge is None and self.particle_charge is None:
            raise complaint(
                "is missing", 'add the charge of one bunch, such as charge = "10 pC"', path="charge", found="nothing"
            )
        if self.count > 1 and self.spacing is None:
            raise complaint(
                "is missing for a train", "add the step from bunch to bunch", path="spacing", found="nothing"
            )
        if self.centres is not None and (self.count > 1 or self.spacing is not None):
            raise complaint(
                "is given as well as count and spacing", "keep one of the two", path="centres", found=self.centres
            )
        return self

    @property
    def number(self) -> int:
        return self.particles

    def places(self) -> list[tuple[float, float, float]]:
        if self.centres is not None:
            return list(self.centres)
        step = self.spacing or (0.0, 0.0, 0.0)
        middle = (self.count - 1) / 2
        return [tuple(self.centre[d] + (b - middle) * step[d] for d in range(3)) for b in range(self.count)]  # type: ignore[misc]


class GaussianBunch(Train):
    """Normal distribution along each axis."""

    distribution: Literal["gaussian"]
    sigma: Length3 = Field(description="Standard deviation per axis, m; 0 is legal.")

    @model_validator(mode="after")
    def _size(self) -> Self:
        for axis, sigma in enumerate(self.sigma):
            refuse_negative(f"sigma.{axis}", sigma, "m")
        return self

    def zero_size(self) -> bool:
        return self.particles > 0 and min(self.sigma) == 0


class SphereBunch(Train):
    """Constant density in a sphere."""

    distribution: Literal["sphere"]
    radius: Length = Field(description="Radius, m; 0 is legal.")

    @model_validator(mode="after")
    def _size(self) -> Self:
        refuse_negative("radius", self.radius, "m")
        return self

    def zero_size(self) -> bool:
        return self.particles > 0 and self.radius == 0


class LatticeBunch(Bunch):
    """Particles on a regular lattice that fills the domain, shifted by a sine wave: a cold plasma without noise."""

    distribution: Literal["lattice"]
    per_axis: Index3 = Field(description="Particles per axis; a multiple of the cells gives each cell as many.")
    displacement: Length3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Amplitude of the shift, m, along each axis, by a sine along that axis.",
    )
    waves: Index3 = Field(default=(1, 1, 1), description="Wavelengths of the sine across the domain, per axis.")

    @model_validator(mode="after")
    def _lattice(self) -> Self:
        for axis, number in enumerate(self.per_axis):
            refuse_negative(f"per_axis.{axis}", number, "particles")
        if self.charge is None and self.particle_charge is None:
            raise complaint("is missing", "add the charge of all particles together", path="charge", found="nothing")
        return self

    @property
    def number(self) -> int:
        return int(np.prod([int(n) for n in self.per_axis], dtype=object))


class ArrayBunch(Bunch):
    """Particles given one by one: arrays from Python, or an .npz file that holds them.

    The arrays themselves are no part of the resolved scene, which keeps their number and digest instead.
    """

    distribution: Literal["arrays"]
    file: str | None = Field(
        default=None, description="An .npz file with position, and momentum and weight if need be."
    )
    position: Any = Field(default=None, exclude=True, repr=False, description="Positions (n, 3), m.")
    momenta: Any = Field(
        default=None, exclude=True, repr=False, description="Momenta of one real particle each (n, 3), kg m/s."
    )
    weight: Any = Field(default=None, exclude=True, repr=False, description="Real particles per macroparticle (n,).")
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
            raise complaint(
                "is missing",
                "give arrays from Python, or file = an .npz that holds them",
                path="position",
                found="nothing",
            )
        if self.position is not None and (self.weight is None) == (
            self.charge is None and self.particle_charge is None
        ):
            raise complaint(
                "must be given, or else charge", "keep one of the two", path="weight", found="both or neither"
            )
        return self

    @property
    def number(self) -> int:
        return self.particles or 0

    def arrays(self) -> dict[str, np.ndarray | None]:
        """Return position, momenta and weight, read from the file if one is named.

        Raises InputError if they are nowhere to be found, or not finite.
        """
        if self.position is not None:
            found = {"position": self.position, "momenta": self.momenta, "weight": self.weight}
        elif self.file is not None:
            found = _read_arrays(Path(self.file))
            if found["weight"] is None and self.charge is None and self.particle_charge is None:
                raise InputError(f"{self.file} holds no weight and the scene names no charge; add one of the two")
        else:
            raise InputError(
                f"a bunch of {self.particles} particles was given as arrays from Python, not kept by scene files; "
                "pass the arrays again, or restart from a checkpoint"
            )
        where = self.file or "arrays given from Python"
        for key, array in found.items():
            if array is not None and not np.isfinite(array).all():
                bad = int((~np.isfinite(array).reshape(len(array), -1).all(axis=1)).sum())
                raise InputError(f"{key} of {bad} particles in {where} is NaN or infinite; remove or mend these rows")
        weight = found["weight"]
        if weight is not None and not (weight > 0).all():
            bad = int((weight <= 0).sum())
            raise InputError(f"weight of {bad} particles in {where} is zero or negative; remove or mend these rows")
        return found

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
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise complaint("is not an array of numbers", "give a NumPy array of floats", path=key, found="") from None
    if array.ndim != len(shape) or array.shape[1:] != shape[1:]:
        wanted = "(n, 3)" if len(shape) == 2 else "(n,)"
        raise complaint(f"has the shape {array.shape}", f"give an array of shape {wanted}", path=key, found="")
    return array


def _read_arrays(path: Path) -> dict[str, np.ndarray | None]:
    if not path.exists():
        raise InputError(f"particle file {path} does not exist; mend the path (relative ones start at the scene file)")
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
