"""The section [motion] of a scene: how the particles move."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from .complaints import complaint
from .real_particle import RealParticle
from .section import Section
from .units import Length, Length3, Time, to_si


class WithoutFields(Section):
    """Motion that follows no field, and so has no time step, pusher, frame, window or reference particle to choose."""

    follows_fields: ClassVar[bool] = False
    form: ClassVar[str] = ""
    pusher: ClassVar[str] = ""
    frame: ClassVar[str] = "lab"
    energy_bins: ClassVar[int] = 1
    window: ClassVar[str] = "none"
    reference: ClassVar[None] = None
    dt: ClassVar[float] = 0.0
    growth: ClassVar[float] = 0.0


class NoMotion(WithoutFields):
    """The particles rest."""

    kind: Literal["none"] = "none"


class Reference(RealParticle):
    """The particle that others are seen from: it moves by the fields of elements alone."""

    position: Length3 = Field(default=(0.0, 0.0, 0.0), description="At the start, m.")


def _step(value: Any) -> float | str:
    """Return a time step in s, or "auto"; a complaint if it is neither."""
    if value == "auto":
        return "auto"
    step = to_si(value, "time")
    if step <= 0:
        raise complaint("is not greater than 0", 'give a time, or "auto"')
    return step


class Leapfrog(Section):
    """Particles move in their own field, relativistically."""

    follows_fields: ClassVar[bool] = True
    kind: Literal["leapfrog"] = "leapfrog"
    form: Literal["kick-drift-kick", "drift-kick-drift"] = Field(
        default="kick-drift-kick",
        description="What a step is made of. drift-kick-drift: the run starts with half a drift, and what it writes of step "
        "n ≥ 1 is of the middle between two drifts, at (n - 1/2) dt; a reference particle moves by kick-drift-kick.",
    )
    pusher: Literal["higuera-cary", "boris"] = Field(
        default="higuera-cary",
        description="How magnetic fields turn momenta. Higuera and Cary's keeps particles at rest in their bunch where E and "
        "v × B cancel, for any length of step; Boris's does not, costs a root less, and acts as long as the self-field has no "
        "magnetic part.",
    )
    frame: Literal["auto", "lab", "rest"] = Field(
        default="auto",
        description="Where the self-field is electrostatic. rest: in the frame in which the charge of each part rests in the "
        "mean, along a mesh axis, so that the laboratory has its magnetic field too; lab: in the laboratory, without one, "
        "refused where that is more than 1 % of the force, of a single beam above β² = 0.01, unless a current between walls "
        "repeats without end beside itself, which has no such field; auto: lab for parts below "
        "β² = 1e-4, else rest.",
    )
    energy_bins: Literal["auto"] | Annotated[int, Field(ge=1)] = Field(
        default="auto",
        description="Parts of the charge by rapidity (artanh β, of fast particles ln 2γ) along its motion, each solved for in "
        "a frame of its own. auto: as many as beams, currents and spreads of energy ask for, at most 16, of rapidities within "
        "0.2, by sign of charge where both drift; a number: so many at most, of equal width. Chosen at the start, and anew "
        "when the motion that they leave has grown by half, or fallen by a third. What changes the force by less than 0.1 % "
        "joins its neighbour. The log estimates the error that is left.",
    )
    window: Literal["none", "reference"] = Field(
        default="none",
        description="reference: the mesh goes with the reference particle. It keeps its axes and goes along the one that the "
        "particle starts along; where all faces are open, it follows and turns with it. Coordinates of particles and fields "
        "are then those of the mesh at the start; elements stay where they are. A dirichlet or neumann face behind the "
        "particle, such as a cathode, stays too, as an infinite plane with images of the charge; the mesh then goes by whole "
        "base cells.",
    )
    reference: Reference | None = Field(
        default=None,
        description="The particle that the path length s belongs to. By default, with a window, it starts in the middle of the "
        "first bunch with its mean momentum.",
    )
    dt: Annotated[
        float | Literal["auto"],
        BeforeValidator(_step, json_schema_input_type=Annotated[Time, Field(gt=0)] | Literal["auto"]),
    ] = Field(
        description="Time step, s. auto: chosen once, at the start, from the time to cross a cell, the plasma period, what "
        "the particles' own field changes, and the periods and lengths of elements; the log says which was the shortest. A "
        "restart goes on with the same step."
    )
    growth: float = Field(
        default=0.0,
        ge=0,
        le=0.2,
        description="Part by which a step may be longer than the one before it. Every ten steps the rules of auto, with "
        "at most 100 steps per process, say how long steps may be by then; they are never shorter than dt. "
        "0: all steps are equal.",
    )
    longest: Time | None = Field(default=None, gt=0, description="Time step that they do not outgrow, s.")

    @model_validator(mode="after")
    def _growing(self) -> Self:
        if self.growth > 0 and self.form == "drift-kick-drift":
            self.refuse(
                "growth",
                "lets steps grow, which have their kick in the middle, where the next one is not known yet",
                'set form = "kick-drift-kick", or leave growth out',
            )
        least = 0.0 if self.dt == "auto" else self.dt
        if self.longest is not None and (self.growth == 0 or self.longest < least):
            wrong = "bounds steps that do not grow" if self.growth == 0 else f"is below dt, {least:g} s"
            self.refuse("longest", wrong, "give a growth and a step above dt")
        return self


class RandomWalk(WithoutFields):
    """Each coordinate of each particle takes a uniform random step: the reference benchmark's motion."""

    kind: Literal["random-walk"] = "random-walk"
    amplitude: Length = Field(ge=0, description="Largest change per step and axis, m.")


Motion = NoMotion | Leapfrog | RandomWalk
