"""The sections [[sources]] of a scene: surfaces from which particles come over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..mesh.domain import FACES, Domain
from ..mesh.window import axes
from ..particles.emission import fowler_nordheim, richardson
from ..particles.species import SPECIES
from ..particles.uniform_numbers import Sampling
from ..units import BOLTZMANN, SPEED_OF_LIGHT
from .bunch_files import GroupOfParticles, Iteration, ParticleFile
from .emitted_momenta import MOST_OF_REST, AnyMomenta, BeamMomenta, ColdMomenta, ThermalMomenta
from .obstacles import Obstacle
from .pulses import AnyPulse, SteadyPulse
from .real_particle import Species
from .section import Section
from .spots import AnySpot, DiscSpot, RectangleSpot
from .units import Angle, Charge, Current, CurrentDensity, Direction3, Energy, Length3, Temperature, Time

Limit = Literal["none", "space-charge"]
LIMIT = (
    "none: all that is supplied is born, and what space charge turns back is lost at the wall. space-charge: no more is born "
    "than makes the field at the wall zero."
)


class PlaneSection(Section):
    """A plane in the scene, from which particles leave along its own z."""

    centre: Length3 = Field(default=(0.0, 0.0, 0.0), description="Origin of the plane's own coordinates, m.")
    direction: Direction3 = Field(
        default=(0.0, 0.0, 1.0), description="Where its own z points to, along which particles leave; any length but 0."
    )
    roll: Angle = Field(default=0.0, description="Turn about it, from its own x towards y, rad.")


class OfSpecies(Obstacle):
    """What all sources have."""

    name: str = Field(default="", description="A name of your own, kept in the outputs; source_0, … if not given.")
    species: Species = Field(
        default=SPECIES["electron"], description="A name, or charge (C) and mass (kg) of one real particle."
    )
    face: Literal[FACES] | None = Field(  # type: ignore[valid-type]
        default=None, description="Face of the domain that particles leave, such as z_lower."
    )

    @property
    def face_number(self) -> int | None:
        """Index of the face in `FACES`."""
        return None if self.face is None else FACES.index(self.face)

    @property
    def surface(self) -> int | str | None:
        """Which wall it is on: the number of a face."""
        return self.face_number

    @property
    def is_limited(self) -> bool:
        """Whether no more is born than Gauss's law takes until the field at the wall is zero."""
        return False

    @property
    def stop_time(self) -> float:
        """When the last particles are born, s, as far as the scene says so."""
        return -math.inf

    @property
    def reach(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Corners (2,) in m, along its own axes, of the part of its surface that emits; None for all of it."""
        return None

    def surfaces(self, domain: Domain) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Return the number of the face of a domain that emits, and the corners (3,) of the part that does, m; none of a plane
        inside. Along periodic axes it may reach beyond the domain.
        """
        if self.face_number is None:
            return []
        axis, side = divmod(self.face_number, 2)
        first, last = np.array(domain.lower), np.array(domain.upper)
        first[axis] = last[axis] = (domain.lower, domain.upper)[side][axis]
        across = [other for other in range(3) if other != axis]
        if self.reach is not None:
            wall = ~np.array(domain.periodic)[across]
            first[across] = np.where(wall, np.maximum(first[across], self.reach[0]), self.reach[0])
            last[across] = np.where(wall, np.minimum(last[across], self.reach[1]), self.reach[1])
        return [(self.face_number, first, last)]

    def emits_at(self, axis: int) -> bool:
        """Whether particles leave a face across an axis."""
        return self.face_number is not None and self.face_number // 2 == axis


class Source(OfSpecies):
    """Particles that are born on a face of the domain, on a plane inside, or on an electrode."""

    plane: PlaneSection | None = Field(default=None, description="A plane, in place of a face.")
    electrode: str | None = Field(
        default=None, description="Name of an electrode, in place of a face: all of its surface in the domain emits."
    )
    spot: AnySpot | None = Field(
        default=None, description="Where on it; without one evenly on all of the face. A plane needs one."
    )
    momenta: AnyMomenta = Field(default=ColdMomenta(), description="With which particles are born.")

    @model_validator(mode="after")
    def _one_surface(self) -> Self:
        self.require_one("face", "plane", "electrode", remedy="name one face or electrode, or give a plane")
        if self.electrode is not None and self.spot is not None:
            self.refuse(
                "spot",
                "is no part of an electrode's surface",
                "leave it out, or make the part that emits an electrode of its own",
                found=self.spot.shape,
            )
        if self.plane is not None and self.reach is None:
            self.refuse("spot", "is missing on a plane, which has no end", "add one")
        if self.species.charge == 0:
            self.refuse("species", "has no charge, by which sources count", "take a charged one", found="")
        most = self.emitted.largest_energy() / (self.species.mass * SPEED_OF_LIGHT**2)
        if most > MOST_OF_REST and not isinstance(self.emitted, BeamMomenta):
            self.refuse(
                "momenta",
                f"has an energy of {most:.2g} m c², where its formulas are not relativistic",
                'use kind = "beam", or correct the unit',
                found=self.emitted.kind,
            )
        return self

    @property
    def surface(self) -> int | str | None:
        """Which wall or electrode it is on: the number of a face, or a name."""
        return self.face_number if self.electrode is None else self.electrode

    @property
    def reach(self) -> tuple[np.ndarray, np.ndarray] | None:
        return None if self.spot is None else self.spot.reach

    @property
    def emitted(self) -> AnyMomenta:
        """With which momenta particles are born."""
        return self.momenta

    def born(self, u: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
        """Return places (2, n) in m along its own axes, None without a spot, and momenta (3, n) in kg m/s, along the normal
        and across, for numbers (7, n) in (0, 1).
        """
        places = None if self.spot is None else self.spot.place(u[:2])
        return places, self.emitted.momenta(u[2:5], self.species.mass)

    def frame(self, lower: tuple[float, ...], upper: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return the origin (3,) in m, and as rows (3, 3) unit vectors across and the normal, in a domain of these corners."""
        if self.plane is not None:
            return np.array(self.plane.centre), np.array(axes(self.plane.direction, self.plane.roll))
        if self.face_number is None:  # an electrode, which has a frame of its own at each place
            return np.zeros(3), np.eye(3)
        axis, side = divmod(self.face_number, 2)
        rows = [np.eye(3)[side_axis] for side_axis in range(3) if side_axis != axis]
        origin = np.where(np.arange(3) == axis, (lower, upper)[side], 0.0)
        return origin, np.array([*rows, (1 - 2 * side) * np.eye(3)[axis]])


class GivenSource(Source):
    """A source whose charge in time is given."""

    process: Literal["given"] = "given"
    pulse: AnyPulse = Field(default=SteadyPulse(), description="How the charge comes in time.")
    charge: Charge | None = Field(default=None, description="Of all of the pulse, C; has the sign of the species.")
    current: Current | None = Field(
        default=None, description="Of a steady pulse, in place of a charge, A; has the sign of the species."
    )
    particles: int | None = Field(
        default=None, ge=1, description="Macroparticles of all of the pulse, each with the same charge."
    )
    particle_charge: Charge | None = Field(
        default=None, description="Charge of one macroparticle, C, in place of their number."
    )
    per_step: int | None = Field(
        default=None,
        ge=1,
        description="Macroparticles per step, in place of their number: they share what is born in it, evenly in time.",
    )
    sampling: Sampling = Field(
        default="random",
        description="How places and momenta are drawn: at random, or quiet by sobol or halton. Times of birth are quiet "
        "always: one in each part of the pulse that has the charge of a macroparticle.",
    )
    limit: Limit = Field(default="none", description=LIMIT)

    @model_validator(mode="after")
    def _amounts(self) -> Self:
        steady = isinstance(self.pulse, SteadyPulse)
        key, foreign = ("current", "charge") if steady else ("charge", "current")
        if getattr(self, foreign) is not None:
            self.refuse(foreign, f"is not what a {self.pulse.shape} pulse has", f"give its {key}")
        if self.current is None and self.total == 0:
            self.refuse(key, "is missing", f"add the {key} of the source", found="nothing")
        for name in (key, "particle_charge"):
            value = getattr(self, name)
            if value is not None and not value * self.species.charge > 0:
                self.refuse(
                    name,
                    f"has not the sign of the {self.species.charge:g} C of its species",
                    "change it or the species",
                )
        self.require_one("particles", "particle_charge", "per_step")
        if self.particles is not None and math.isinf(self.pulse.duration):
            self.refuse("particles", "is a number for a pulse without an end", "give particle_charge or per_step")
        return self

    @property
    def total(self) -> float:
        """Charge of all that is ever born, C."""
        return self.current * self.pulse.duration if self.current is not None else self.charge or 0.0

    @property
    def is_limited(self) -> bool:
        return self.limit == "space-charge"

    @property
    def stop_time(self) -> float:
        return self.pulse.start + self.pulse.duration

    def charge_until(self, time: float) -> float:
        """Return the charge in C that is born until a time in s."""
        if self.current is not None:
            return self.current * min(max(time - self.pulse.start, 0.0), self.pulse.duration)
        return self.total * float(self.pulse.share(time))

    def time_of(self, charge: np.ndarray) -> np.ndarray:
        """Return the times in s until which so much charge is born, C."""
        if self.current is not None:
            return self.pulse.start + charge / self.current
        return self.pulse.time_of(charge / self.total)

    @property
    def unit_charge(self) -> float | None:
        """Charge in C of each macroparticle, if all have the same."""
        return self.particle_charge if self.particles is None else self.total / self.particles

    @property
    def parts(self) -> float:
        """Into how many parts with the charge of a macroparticle the pulse is cut; the last may have less."""
        if self.particles is not None:
            return self.particles
        parts = self.total / self.particle_charge if self.particle_charge else 0.0
        whole = round(parts) if math.isfinite(parts) else parts
        return whole if abs(parts - whole) < 1e-9 * whole else parts

    def expected(self, start: float, stop: float, dt: float) -> int:
        """Return how many macroparticles are born between two times in s, by steps of `dt` s."""
        charge = self.charge_until(stop) - self.charge_until(start)
        if self.unit_charge is not None:
            return round(charge / self.unit_charge)
        first, last = max(start, self.pulse.start), min(stop, self.pulse.start + self.pulse.duration)
        return (self.per_step or 0) * math.ceil(max(last - first, 0.0) / dt)


class PhotoSource(GivenSource):
    """A photo-cathode: the charge of a pulse is given, or follows from that of a laser."""

    process: Literal["photo"] = "photo"  # type: ignore[assignment]
    momenta: AnyMomenta | None = Field(  # type: ignore[assignment]
        default=None, description="With which particles are born; by default thermal, of the mean transverse energy."
    )
    mean_transverse_energy: Energy | None = Field(default=None, gt=0, description="<p_x² + p_y²> / 2m at birth, J.")
    laser_energy: Energy | None = Field(default=None, gt=0, description="Of the pulse, in place of a charge, J.")
    photon_energy: Energy | None = Field(default=None, gt=0, description="Of one photon of it, J.")
    quantum_efficiency: float | None = Field(default=None, gt=0, le=1, description="Particles per photon.")

    @model_validator(mode="after")
    def _light(self) -> Self:
        self.require_one("mean_transverse_energy", "momenta")
        light = self.given(*LIGHT)
        if light and (len(light) < len(LIGHT) or self.charge is not None or self.current is not None):
            self.refuse(
                light[0],
                f"goes with all of {', '.join(LIGHT)}, and without charge and current",
                "give the three, or the charge",
            )
        return self

    @property
    def emitted(self) -> AnyMomenta:
        energy = self.mean_transverse_energy
        return self.momenta or (ColdMomenta() if energy is None else ThermalMomenta(energy=energy))

    @property
    def total(self) -> float:
        if self.laser_energy is None or self.photon_energy is None or self.quantum_efficiency is None:
            return super().total
        return self.species.charge * self.quantum_efficiency * self.laser_energy / self.photon_energy


LIGHT = ("laser_energy", "photon_energy", "quantum_efficiency")


class WallSource(Source):
    """A Dirichlet face of the domain that emits by itself, from each face of a cell on it."""

    spot: DiscSpot | RectangleSpot | None = Field(
        default=None, discriminator="shape", description="Which part of the face emits; without one all of it."
    )
    start: Time = Field(default=0.0, description="When it begins to emit, s.")
    stop: Time | None = Field(default=None, description="When it ends, s; without it never.")
    per_face: int = Field(default=2, ge=1, description="Macroparticles per step from each face of a cell that emits.")

    @model_validator(mode="after")
    def _on_a_face(self) -> Self:
        if self.plane is not None:
            self.refuse(
                "plane",
                "has no field that decides what it emits",
                "name a face or an electrode",
                found=self.plane.centre,
            )
        if self.stop is not None and self.stop <= self.start:
            self.refuse("stop", "is not after start", "swap them")
        return self

    @property
    def stop_time(self) -> float:
        return math.inf if self.stop is None else self.stop

    def current_density(self, pull: np.ndarray) -> np.ndarray:
        """Return what the surface supplies in A/m², without its sign, where the field pulls so much, V/m (negative: pushes)."""
        raise NotImplementedError


class SpaceChargeLimitedSource(WallSource):
    """A wall that gives what makes the field at it zero, so that space charge limits the current."""

    process: Literal["space-charge-limited"] = "space-charge-limited"
    supply: CurrentDensity | None = Field(
        default=None, gt=0, description="The most that it gives, A/m²; without it anything."
    )

    def current_density(self, pull: np.ndarray) -> np.ndarray:
        return np.full(len(pull), math.inf if self.supply is None else self.supply)

    @property
    def is_limited(self) -> bool:
        return True


class SuppliedSource(WallSource):
    """A wall that gives what its surface supplies."""

    work_function: Energy = Field(gt=0, description="Without a field, J.")
    limit: Limit = Field(default="none", description=LIMIT)

    @property
    def is_limited(self) -> bool:
        return self.limit == "space-charge"


class ThermionicSource(SuppliedSource):
    """A hot wall, by Richardson and Dushman's law; particles leave it as the flux of a Maxwellian."""

    process: Literal["thermionic"] = "thermionic"
    temperature: Temperature = Field(gt=0, description="K.")
    schottky: bool = Field(default=True, description="Whether a field at the wall that pulls lowers the work function.")
    momenta: AnyMomenta | None = Field(  # type: ignore[assignment]
        default=None, description="With which particles are born; by default thermal, of the temperature."
    )

    @property
    def emitted(self) -> AnyMomenta:
        return self.momenta or ThermalMomenta(energy=BOLTZMANN * self.temperature)

    def current_density(self, pull: np.ndarray) -> np.ndarray:
        return richardson(self.temperature, self.work_function, pull if self.schottky else np.zeros_like(pull))


class FieldSource(SuppliedSource):
    """A cold wall from which a strong field pulls electrons, by Fowler and Nordheim's law."""

    process: Literal["field"] = "field"
    enhancement: float = Field(default=1.0, gt=0, description="Of the field at tips that the mesh does not see.")

    def current_density(self, pull: np.ndarray) -> np.ndarray:
        return fowler_nordheim(self.work_function, self.enhancement * pull)


def first_ids(sources: Sequence[Obstacle]) -> list[int]:
    """Return the first id of each source: behind those of all bunches, and so far apart that none comes to the next."""
    return [(number + 1) * IDS for number in range(len(sources))]


class FileSource(OfSpecies):
    """Particles in a file that are born at times and places of their own.

    An openPMD file (HDF5) with particles of status 0, as beamphysics and distgen write those at a cathode, or of status 1 with
    times of their own; or a text of ten columns, as ASTRA writes it, of which those of status -1 and 5 are taken.
    """

    process: Literal["file"] = "file"
    file: ParticleFile
    iteration: Iteration = None
    group: GroupOfParticles = None
    shift: Length3 = Field(default=(0.0, 0.0, 0.0), description="By how much places are moved, m.")
    delay: Time = Field(default=0.0, description="By how much births are later, s.")


IDS = 2**48  # of a source
