"""The bunches of a scene: how many particles of which charge there are, in which places, and how they move."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..particles.phase_space import PhasePlane
from ..particles.uniform_numbers import BITS, Sampling
from .real_particle import RealParticle
from .section import Section, refuse_negative
from .units import Charge, Index3, Length3, Momentum3


class Bunch(Section):
    """What all bunches have."""

    name: str = Field(default="", description="A name of your own, kept in the outputs.")
    self_field: bool = Field(
        default=True,
        description="false: test particles, which feel all fields and make none. Their weight is 0, whatever charge is given.",
    )

    @property
    def number(self) -> int:
        """Macroparticles of one bunch; 0 if that is known only once a file is read."""
        raise NotImplementedError

    @property
    def source(self) -> str | None:
        """The file that the particles are yet to be read from, if they are in one."""
        return None

    @property
    def bunch_charge(self) -> float:
        """Charge of one bunch in C; 0 if that is known only once a file is read, and of test particles."""
        return 0.0

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


class DescribedBunch(RealParticle, Bunch):
    """A bunch of which the scene gives species, charge and mean momentum."""

    charge: Charge | None = Field(default=None, description="Charge of one bunch, C; has the sign of the species.")
    particle_charge: Charge | None = Field(
        default=None, description="Charge of one macroparticle, C, in place of the charge of the bunch."
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self.require_at_most_one("particle_charge", "charge")
        key = "charge" if self.particle_charge is None else "particle_charge"
        value = getattr(self, key)
        if value is not None and value * self.species.charge < 0:
            self.refuse(
                key,
                f"has the other sign than the {self.species.charge:g} C of its species",
                f"write {-value:g} or change the species",
            )
        if value is not None and self.self_field and self.number > 0 and (value == 0 or self.species.charge == 0):
            where = key if value == 0 else "species.charge"
            self.refuse(where, "makes every particle's charge zero", "give a charge, or particles = 0", found=0.0)
        return self

    @property
    def bunch_charge(self) -> float:
        """Charge of one bunch in C."""
        return self.charge_of(self.number)

    def charge_of(self, number: int) -> float:
        """Charge in C of a bunch of so many macroparticles; 0 of test particles."""
        if not self.self_field:
            return 0.0
        return self.particle_charge * number if self.particle_charge is not None else self.charge or 0.0


class Train(DescribedBunch):
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

    sampling: Sampling = Field(
        default="random",
        description="How particles are drawn: at random, or quiet by the quasi-random numbers of sobol (best for a power of "
        "two particles) or halton, whose noise falls about as 1/N. Random is the default because real bunches are noisy.",
    )

    @model_validator(mode="after")
    def _train(self) -> Self:
        for axis, spread in enumerate(self.momentum_spread):
            refuse_negative(f"momentum_spread.{axis}", spread, "kg m/s")
        if self.sampling == "sobol" and self.particles > 2**BITS:
            self.refuse(
                "particles", f"are more than the {2**BITS} different Sobol numbers", 'use fewer, or sampling = "halton"'
            )
        if self.self_field and self.charge is None and self.particle_charge is None:
            self.refuse("charge", "is missing", 'add the charge of one bunch, such as charge = "10 pC"')
        if self.count > 1 and self.spacing is None:
            self.refuse("spacing", "is missing for a train", "add the step from bunch to bunch")
        if self.centres is not None and (self.count > 1 or self.spacing is not None):
            self.refuse("centres", "is given as well as count and spacing", "keep one of the two")
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

    @property
    def planes(self) -> tuple[PhasePlane, PhasePlane, PhasePlane]:
        """Size and momenta of a bunch along x, y, z."""
        raise NotImplementedError

    def unit(self, u: np.ndarray) -> np.ndarray:
        """The distribution in unit form: see `distributions`."""
        raise NotImplementedError

    @property
    def rms(self) -> tuple[float, float, float]:
        """Rms size of a bunch along x, y, z in m."""
        x, y, z = (plane.size for plane in self.planes)
        return (x, y, z)

    def zero_size(self) -> bool:
        return self.particles > 0 and min(self.rms) == 0


class LatticeBunch(DescribedBunch):
    """Particles on a regular lattice that fills the domain, shifted by a sine wave: a cold plasma without noise."""

    distribution: Literal["lattice"] = "lattice"
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
        if self.self_field and self.charge is None and self.particle_charge is None:
            self.refuse("charge", "is missing", "add the charge of all particles together")
        return self

    @property
    def number(self) -> int:
        return int(np.prod([int(n) for n in self.per_axis], dtype=object))
