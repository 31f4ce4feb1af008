"""The rules of a scene that say which cells shall be refined."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from .complaints import close_match, complaint
from .section import Section
from .units import Angle, ChargeDensity, FieldStrength, Index3, Length, Length3, Momentum, Potential

#: What a function that tags cells may ask for by the names of its parameters; arrays are of one box.
ARGUMENTS = {
    "level": "number of the level, 0 the base",
    "x": "centres of the cells along x, m; x, y and z broadcast to (nx, ny, nz)",
    "y": "along y, m",
    "z": "along z, m",
    "rho": "charge density, C/m³, (nx, ny, nz)",
    "phi": "potential, V",
    "efield": "electric field, V/m, three arrays",
    "particles_per_cell": "macroparticles in each cell",
    "hysteresis": "1 for what shall be refined, refinement.hysteresis for what may stay so: a factor for thresholds",
}


class Rule(Section):
    """Tags cells that shall be refined."""

    levels: list[Annotated[int, Field(ge=0)]] | None = Field(
        default=None, min_length=1, description="Levels whose cells it tags, 0 the base; all if left out."
    )


class Threshold(Rule):
    """Tag where the magnitude of a quantity exceeds a threshold."""

    absolute: float | None = Field(default=None, ge=0, description="Threshold.")
    relative: float | None = Field(default=None, ge=0, description="Threshold as a part of the largest magnitude.")
    relative_to: Literal["whole", "level"] = Field(
        default="whole",
        description="Where that largest magnitude is looked for: on the whole mesh, or on the level of the cell. "
        "They differ for what grows as cells shrink, such as the density of few particles.",
    )

    @model_validator(mode="after")
    def _one_threshold(self) -> Self:
        self.require_one("relative", "absolute")
        if self.absolute is not None and self.relative_to == "level":
            self.refuse("relative_to", "has no meaning beside absolute", "leave it out, or give relative")
        return self


class ChargeDensityRule(Threshold):
    """Refine where |ρ| is large: there is the source of the field."""

    kind: Literal["charge-density"] = "charge-density"
    absolute: ChargeDensity | None = Field(ge=0, default=None, description="Threshold, C/m³.")


class PotentialRule(Threshold):
    """Refine where |φ| is large; costs a solve for each level that is made at the start."""

    kind: Literal["potential"] = "potential"
    absolute: Potential | None = Field(ge=0, default=None, description="Threshold, V.")


class FieldStrengthRule(Threshold):
    """Refine where |E| is large; costs a solve for each level that is made at the start."""

    kind: Literal["field-strength"] = "field-strength"
    absolute: FieldStrength | None = Field(ge=0, default=None, description="Threshold, V/m.")


class MomentumRule(Threshold):
    """Refine the cells that hold a particle whose |p| is large, compared with the particles of all ranks."""

    kind: Literal["momentum"] = "momentum"
    absolute: Momentum | None = Field(ge=0, default=None, description="Threshold, kg m/s, of one real particle.")
    relative_to: Literal["whole", "level", "rms"] = Field(  # type: ignore[assignment]
        default="whole",
        description="What relative is a part of: the largest |p| of all particles, or of those inside the level of the cell. "
        "With rms it is the number of rms spreads from the mean: of p - ⟨p⟩, each component over its own rms.",
    )


class Bounds(Rule):
    """Tag where a quantity lies within bounds."""

    @model_validator(mode="after")
    def _some_bound(self) -> Self:
        at_least, at_most = getattr(self, "at_least", None), getattr(self, "at_most", None)
        if at_least is None and at_most is None:
            self.refuse("at_least", "must be given, or at_most, or both", "add one", found="")
        if at_least is not None and at_most is not None and at_least > at_most:
            self.refuse("at_least", f"lies above at_most = {at_most}, so that no cell fits", "swap them")
        return self


class ParticlesRule(Bounds):
    """Refine the cells with at least, or at most, so many macroparticles; empty cells never.

    A cell that is refined already counts the particles of its children.
    """

    kind: Literal["particles-per-cell"] = "particles-per-cell"
    at_least: int | None = Field(default=None, ge=1, description="Fewest particles of a cell that is refined.")
    at_most: int | None = Field(
        default=None, ge=1, description="Most particles of a cell that is refined: with few, the edge of a beam."
    )


class RadiusRule(Bounds):
    """Refine the cells that reach between two distances from the centre of all particles, in units of their rms size.

    The distance is that of ((x - ⟨x⟩)/σ_x, (y - ⟨y⟩)/σ_y, …): the bounds are ellipses that breathe with the beam.
    Along periodic axes nearest images count.
    """

    kind: Literal["radius"] = "radius"
    axes: Literal["xy", "xz", "yz", "xyz"] = Field(
        default="xy", description="Along which it is measured; the default is across a beam along z."
    )
    at_least: float | None = Field(default=None, ge=0, description="Least distance, rms sizes.")
    at_most: float | None = Field(default=None, ge=0, description="Largest distance, rms sizes.")


class EmissionRule(Rule):
    """Refine a layer at the faces of the domain that sources emit from, within their spots."""

    kind: Literal["emission"] = "emission"
    depth: Length | None = Field(default=None, gt=0, description="Of the layer on all levels, m.")
    cells: int | None = Field(
        default=None,
        ge=1,
        description="Depth of the layer in cells of each level that is made, so that it is half as deep on each next one.",
    )

    @model_validator(mode="after")
    def _one_depth(self) -> Self:
        self.require_one("depth", "cells")
        return self

    def depth_on(self, width: float) -> float:
        """Return the depth, m, of the layer of cells of a width in m."""
        return self.depth if self.depth is not None else (self.cells or 0) * width


class RuleOfElectrodes(Rule):
    """Tag at electrodes."""

    electrodes: list[str] | None = Field(
        default=None, min_length=1, description="Names of the electrodes; all if left out."
    )


class ConductorsRule(RuleOfElectrodes):
    """Refine the cells at the surfaces of electrodes: those with a neighbour that metal hides from them."""

    kind: Literal["conductors"] = "conductors"


class ConductorEdgesRule(RuleOfElectrodes):
    """Refine the cells at edges and strong curvature of electrodes, where fields are large."""

    kind: Literal["conductor-edges"] = "conductor-edges"
    angle: Angle = Field(
        default=0.35,
        gt=0,
        lt=1.57,
        description="An edge is where the normal of the metal turns by more than this angle, rad, over a cell and a half.",
    )


class CallableRule(Rule):
    """Refine where a Python function says so; from Python only, as files and checkpoints keep nothing but its name.

    It is called for each box with the arguments that its parameters name, such as `lambda x, y, z, rho: …`, and returns a
    bool per cell, or what broadcasts to that. `amrpic.scene.refinement_rules.ARGUMENTS` lists the names.
    """

    kind: Literal["callable"] = "callable"
    function: Any = Field(default=None, exclude=True, repr=False, description="The function.")
    name: str = Field(default="", description="Name of the function; filled in.")

    @model_validator(mode="before")
    @classmethod
    def _note_name(cls, data: Any) -> Any:
        if isinstance(data, dict) and callable(data.get("function")):
            function = data["function"]
            return {**data, "name": getattr(function, "__qualname__", type(function).__qualname__)}
        return data

    @model_validator(mode="after")
    def _can_be_called(self) -> Self:
        if self.function is None:
            self.refuse(
                "function",
                f"is missing: {self.name or 'it'} is a Python function, which no file or checkpoint keeps",
                "pass the scene from Python with function=…, at a restart by Simulation.restart(comm, path, scene)",
                found="",
            )
        if not callable(self.function):
            self.refuse("function", "is not a function", "give one")
        for parameter in _parameters(self.function):
            if parameter.name not in ARGUMENTS and parameter.default is parameter.empty:
                self.refuse(
                    "function",
                    f"has the parameter {parameter.name}, which names nothing that can be passed",
                    close_match(parameter.name, ARGUMENTS),
                    found=self.name,
                )
        return self

    @property
    def arguments(self) -> list[str]:
        """What the function asks for."""
        return [parameter.name for parameter in _parameters(self.function) if parameter.name in ARGUMENTS]


def _parameters(function: Any) -> list[inspect.Parameter]:
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:
        raise complaint(
            "has no readable parameters", "wrap it, as in lambda x, y, z: …", path="function", found=str(function)
        ) from None
    return [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]


class StaticBox(Section):
    """A cuboid to refine, in metres or in cells."""

    level: int = Field(ge=1, description="Level of the cells inside the box; 1 is the first refined one.")
    lower: Length3 | None = Field(default=None, description="Lower corner, m; rounded outwards to the blocking factor.")
    upper: Length3 | None = Field(default=None, description="Upper corner, m.")
    first: Index3 | None = Field(
        default=None, description="First cell per axis in the index space of the level, exact."
    )
    last: Index3 | None = Field(default=None, description="Last cell per axis, inclusive.")

    @model_validator(mode="after")
    def _one_pair(self) -> Self:
        metres: tuple[Any, Any] = (self.lower, self.upper)
        cells: tuple[Any, Any] = (self.first, self.last)
        pairs = [pair for pair in (metres, cells) if pair != (None, None)]
        if len(pairs) != 1 or None in pairs[0]:
            raise complaint("needs its corners", "give lower and upper in metres, or first and last in cells", found="")
        if (
            any(a >= b for a, b in zip(*metres, strict=True))
            if metres[0]
            else any(a > b for a, b in zip(*cells, strict=True))
        ):
            raise complaint("has no volume", "put its upper corner above the lower one", found=pairs[0])
        return self


class StaticRule(Section):
    """Refine given boxes, and keep them. Below `all` they bound where the other rules refine."""

    kind: Literal["static"] = "static"
    boxes: list[StaticBox] = Field(min_length=1, description="The boxes of all refined levels.")


class RuleCombination(Rule):
    """A rule made of others."""

    of: list[RuleKind] = Field(description="The rules.")

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        if not self.of:
            self.refuse(
                "of", "names no rule", 'list some, such as { kind = "charge-density", relative = 1e-3 }', found=[]
            )
        return self


class AnyRule(RuleCombination):
    """Refine the cells that any of the rules tags."""

    kind: Literal["any"] = "any"


class AllRule(RuleCombination):
    """Refine the cells that all of the rules tag."""

    kind: Literal["all"] = "all"


RuleKind = Annotated[
    ChargeDensityRule
    | PotentialRule
    | FieldStrengthRule
    | MomentumRule
    | ParticlesRule
    | RadiusRule
    | EmissionRule
    | ConductorsRule
    | ConductorEdgesRule
    | CallableRule
    | StaticRule
    | AnyRule
    | AllRule,
    Field(discriminator="kind"),
]


def every_rule(rule: RuleKind, path: str = "rule") -> Iterator[tuple[str, RuleKind]]:
    """Yield a rule and all that it is made of, each with its path in the section."""
    yield path, rule
    if isinstance(rule, RuleCombination):
        for number, part in enumerate(rule.of):
            yield from every_rule(part, f"{path}.of.{number}")
