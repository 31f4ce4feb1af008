"""The scene of a solid that is carried by material points: where, of what, how held and moved, what is written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from ..errors import InputError
from ..fem.conjugate_gradients import Coarse
from ..fem.hexahedra import DEGREES
from ..fem.layouts import MOST_PER_AXIS
from ..fem.points import Weights
from ..scene.any_scene import AnyScene
from ..scene.complaints import complaint_of
from ..scene.domain_section import CuboidSection
from ..scene.parts import SceneParts
from ..scene.run_sections import Files
from ..scene.section import Section
from ..scene.units import Acceleration3, Density, Index3, Length, Pressure, Toughness
from .faces import FACES_SCHEMA, Face, faces_of
from .loads import Loads
from .materials import MOST_TERMS, Damage, Material, NeoHookean, Ogden
from .structure import EMPTY, Regions, Voronoi, Voxels

Faces = Annotated[
    dict[Literal["x", "y", "z"], tuple[Face, Face]], BeforeValidator(faces_of), WithJsonSchema(FACES_SCHEMA)
]
FEWEST_SPACINGS = 2  # of nodes, in the length of a crack's profile


class MeshSection(CuboidSection):
    """The cuboid at the start, cut into equal hexahedra."""

    cells: Index3 = Field(description="Elements per axis, at least 2.")
    degree: int = Field(default=1, ge=DEGREES[0], le=DEGREES[-1], description="Of the polynomials on an element.")


class PointsSection(Section):
    """Where points lie at the start, and how they weigh."""

    per_axis: int = Field(default=4, ge=1, le=MOST_PER_AXIS, description="Points along each axis of an element.")
    layout: Literal["jittered", "uniform", "random", "gauss"] = Field(
        default="jittered",
        description="jittered: one random point in each of per_axis³ parts of an element; uniform: in their middle; random: "
        "anywhere in the element; gauss: those of Gauss's rule.",
    )
    weights: Weights = Field(
        default="moments",
        description="moments: weights near the volumes that are exact to the highest degree there is, in elements of one "
        "material, and volumes in others; volume: the volumes.",
    )


class LoadSection(Section):
    """How the load comes on: platens move, and gravity grows, in proportion."""

    steps: int = Field(default=10, ge=1, le=10**6, description="Load steps, if none of them is cut.")
    smallest: float = Field(
        default=1e-3, gt=0, lt=1, description="The least part of the load that a step is cut to; below it the run ends."
    )
    easy: int = Field(
        default=4, ge=0, description="After a step of at most so many Newton iterations the next is half as long again."
    )
    damage_step: float = Field(
        default=0.1,
        gt=0,
        le=1,
        description="The damage of a point may grow by so much in a step, by a quarter of it in the first; a step in which it "
        "grows by more is cut, down to `breaking`. 1: as much as will.",
    )
    breaking: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="The least part of the load to which a step is cut because of `damage_step`; by default a sixteenth of "
        "1/steps. Shorter steps do not help against a crack that runs through at once.",
    )

    @property
    def last_step(self) -> int:
        """Number of the last step, if none is cut."""
        return self.steps

    def loads(self, begin: float = 0.0, length: float | None = None) -> Loads:
        """Return the load from where it is, with the length of the next step if it is not the first one."""
        damage_step = self.damage_step if self.damage_step < 1 else math.inf
        return Loads(self.steps, self.smallest, self.easy, damage_step, self.breaking, begin, length)


class SolveSection(Section):
    """How the equilibrium of a step is found."""

    tolerance: float = Field(
        default=1e-8, gt=0, lt=0.1, description="Of the forces that are left, over the size of all forces."
    )
    damage_tolerance: float = Field(
        default=1e-3,
        gt=0,
        lt=0.1,
        description="Turns between displacement and damage end where one more would change forces by less, over the size of "
        "all forces; then forces are brought to balance with the damage as it is, to `tolerance`.",
    )
    iterations: int = Field(default=30, ge=1, description="Newton iterations of a solve, at most.")
    turns: int = Field(default=60, ge=1, description="Turns between displacement and damage in a step, at most.")
    coarse: Coarse = Field(
        default="geometric", description="What solves degree 1: halves of the elements, or MueLu's aggregates."
    )


class DamageSection(Section):
    """A phase field (AT2) by which a material breaks."""

    toughness: Toughness = Field(gt=0, description="Energy that a crack takes per area, J/m².")
    length: Length = Field(gt=0, description="Of a crack's profile, m; at least two distances of nodes.")
    residual: float = Field(default=0.01, gt=0, lt=1, description="Part of the stiffness that the broken keeps.")


class NeoHookeanSection(Section):
    """A neo-Hookean solid."""

    law: Literal["neo-hookean"] = "neo-hookean"
    young: Pressure = Field(gt=0, description="Young's modulus of small strains, Pa.")
    poisson: float = Field(gt=-1, lt=0.5, description="Poisson's ratio of small strains.")
    density: Density = Field(default=0.0, ge=0, description="Mass per initial volume, kg/m³.")
    damage: DamageSection | None = Field(default=None, description="How it breaks, if it can.")

    @property
    def value(self) -> Material:
        """The material that solids are made of."""
        breaks = None if self.damage is None else Damage(**self.damage.model_dump())
        return NeoHookean(self.young, self.poisson, breaks)


class OgdenTerm(Section):
    """A term μ/α (λ₁^α + λ₂^α + λ₃^α - 3) of Ogden's law."""

    mu: Pressure = Field(description="μ, Pa.")
    alpha: float = Field(description="α.")


class OgdenSection(Section):
    """Ogden's solid, of up to three terms."""

    law: Literal["ogden"] = "ogden"
    terms: list[OgdenTerm] = Field(min_length=1, max_length=MOST_TERMS, description="Its terms.")
    lame: Pressure = Field(description="λ, Pa.")
    density: Density = Field(default=0.0, ge=0, description="Mass per initial volume, kg/m³.")

    damage: ClassVar[None] = None

    @model_validator(mode="after")
    def _sound(self) -> Self:
        try:
            _ = self.value
        except InputError as refused:
            raise complaint_of(refused) from None
        return self

    @property
    def value(self) -> Material:
        """The material that solids are made of."""
        return Ogden(tuple((term.mu, term.alpha) for term in self.terms), self.lame)


class MpmOutput(Files):
    """What a run writes."""

    write: list[Literal["checkpoint", "points", "fields", "series", "pictures", "report"]] = Field(
        default=["checkpoint", "points", "fields", "series", "pictures"],
        description="The kinds of output wanted: points with what they carry, and fields, which are means over elements, as "
        "VTKHDF; a table with a row per step; pictures of the last state; report is a page for a browser with all that is "
        "known of the run, made at its end.",
    )
    fields_every: int = Field(default=0, ge=0, description="Steps between field files; 0 writes the last one only.")
    points_every: int = Field(default=0, ge=0, description="Steps between files of points; 0 writes the last one only.")


class Scene(AnyScene):
    """A solid carried by material points, described."""

    foreign: ClassVar[Mapping[str, str]] = dict.fromkeys(
        set(SceneParts.model_fields) - {"name", "seed", "domain", "schedule", "output"},
        'it is for particle-in-cell: leave it out, or leave out method = "mpm"',
    )

    method: Literal["mpm"] = Field(default="mpm", description="Material points.")
    domain: MeshSection
    faces: Faces = Field(
        description='Per axis one, or a pair (lower, upper): "slip", which lets nothing through and does not rub, "clamped", '
        '"free", { press = 0.3 }, a platen that takes so large a part of the length along the axis, or { pull = 0.1 }, one '
        "that adds it; platens do not rub.",
    )
    points: PointsSection = PointsSection()
    materials: dict[str, Annotated[NeoHookeanSection | OgdenSection, Field(discriminator="law")]] = Field(
        min_length=1, description="The materials, by names."
    )
    structure: Annotated[Voronoi | Voxels | Regions, Field(discriminator="kind")] = Field(
        default=Regions(), description="Which material is where; one alone if there is one."
    )
    gravity: Acceleration3 = Field(default=(0.0, 0.0, 0.0), description="Body force per mass, m/s².")
    floor_stiffness: Pressure = Field(
        default=0.0,
        ge=0,
        description="Young's modulus, Pa, of what fills elements that points do not: where these are gone, or too few for the "
        "degree. Its share of the forces is in the series. 0: such elements are refused.",
    )
    schedule: LoadSection = LoadSection()
    solver: SolveSection = SolveSection()
    output: MpmOutput = MpmOutput()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        self._require_materials()
        clamped = any(face.kind == "clamped" for pair in self.faces.values() for face in pair)
        for axis, pair in self.faces.items():
            if not clamped and all(face.kind == "free" for face in pair):
                self.refuse(
                    "faces", f"let the body go along {axis}", f'make one of {axis} "slip", or any "clamped"', found=""
                )
        for name, material in self.materials.items():
            if material.damage is None:
                continue
            nodes = self.domain.value.spacing / self.domain.degree
            if material.damage.length < FEWEST_SPACINGS * (1 - 1e-9) * nodes.max():
                self.refuse(
                    f"materials.{name}.damage.length",
                    f"is shorter than two distances of nodes, {FEWEST_SPACINGS * nodes.max():g} m",
                    "use more elements or a higher degree, or a longer one",
                )
        return self

    def _require_materials(self) -> None:
        for path, name in self.structure.names(list(self.materials)):
            if name not in self.materials and name != EMPTY:
                materials = ", ".join(self.materials)
                self.refuse(
                    f"structure.{path}",
                    "is no material of the scene",
                    f'use {materials}, or "{EMPTY}" where there is nothing',
                    found=name,
                )
        if EMPTY in self.materials:
            self.refuse(f"materials.{EMPTY}", "means that there is nothing", "name the material otherwise", found="")

    @staticmethod
    def _anchor_files(data: Mapping[str, Any], folder: Path) -> None:
        structure = data.get("structure")
        if isinstance(structure, dict) and isinstance(structure.get("file"), str):
            structure["file"] = str(folder / structure["file"])

    def extent(self, load: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners of the mesh at a part of the load, each (3,) in m."""
        lower, upper = np.array(self.domain.lower), np.array(self.domain.upper)
        length = upper - lower
        for axis, (low, high) in enumerate(self.faces.values()):
            lower[axis] -= load * low.change * length[axis]
            upper[axis] += load * high.change * length[axis]
        return lower, upper

    def point_count(self) -> int:
        """Points at the start, at most."""
        return math.prod(self.domain.cells) * self.points.per_axis**3

    def summary(self) -> str:
        """Return in one line what the scene is."""
        cells = "x".join(map(str, self.domain.cells))
        return (
            f"{self.name}: material points, {cells} elements of degree {self.domain.degree}, up to {self.point_count()} points "
            f"of {', '.join(self.materials)}, {self.schedule.steps} load steps"
        )

    def remarks(self) -> list[str]:
        """Return one sentence for each thing that is legal and yet may not be meant."""
        used = {name for _, name in self.structure.names(list(self.materials))}
        out = [f"materials.{name} is nowhere in the structure" for name in self.materials if name not in used]
        moves = any(face.change != 0 for pair in self.faces.values() for face in pair)
        if not moves and not any(self.gravity):
            out.append("nothing loads the body: no face moves, and there is no gravity")
        if any(self.gravity) and all(material.density == 0 for material in self.materials.values()):
            out.append("gravity acts on nothing, since no material has a density")
        return out
