"""The scene: everything that a run depends on, as one frozen model that TOML files and Python share."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from ..errors import SceneError
from ..mesh.domain import AXES, FACES
from . import toml
from .bunch_files import ArrayBunch, OpenPMDBunch
from .bunch_shapes import GaussianBunch, HaloBunch, HollowBunch, KVBunch, ParabolicBunch, SphereBunch, WaterbagBunch
from .bunches import DescribedBunch, LatticeBunch
from .complaints import complaint, refusal
from .diagnostics import Diagnostics
from .domain import LARGEST_INDEX, DomainSection
from .elements import AnyElement, ConstantFocusingElement
from .motion import Leapfrog, NoMotion, RandomWalk, Reference
from .obstacles import AnyAperture, Screen, aperture_names, out_of_reach, repeated_names
from .output import Output
from .particles import ParticlesSection
from .refinement import Refinement, StaticBox, StaticRule, every_rule
from .schedule import Schedule
from .section import Section
from .solver_options import SolverSection
from .thermal_bunch import ThermalBunch

MOST_BINS = 1_000_000  # of a map of losses
LARGEST_ROW = 2**63 - 1  # rows of the equations are counted in 64 bits over all ranks


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a scene file. Raises SceneError in one sentence."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as reason:
        raise SceneError(f"scene file {path} cannot be read ({reason.strerror}); check the path") from None
    except UnicodeDecodeError as reason:
        raise SceneError(f"scene file {path} is not TOML: {reason}; correct that line") from None


class Scene(Section):
    """A run, described: where, what charge, how refined, how solved, how moved, how long, what written."""

    name: str = Field(default="scene", min_length=1, description="Name of the scene and of its output folder.")
    seed: int = Field(default=1, ge=0, lt=2**63, description="Of all random numbers; the same seed gives the same run.")
    background: Literal["none", "neutralizing"] = Field(
        default="none", description="neutralizing: a uniform density that cancels the net charge, for periodic scenes."
    )
    domain: DomainSection
    bunches: list[
        Annotated[
            GaussianBunch
            | SphereBunch
            | WaterbagBunch
            | KVBunch
            | ParabolicBunch
            | HollowBunch
            | HaloBunch
            | ThermalBunch
            | LatticeBunch
            | ArrayBunch
            | OpenPMDBunch,
            Field(discriminator="distribution"),
        ]
    ] = Field(default=[], description="The particles; without any, the scene runs with ρ = 0.")
    elements: list[AnyElement] = Field(
        default=[], description="Magnets, cavities and other fields along the beam line."
    )
    apertures: list[AnyAperture] = Field(default=[], description="Holes in solids at which particles are lost.")
    screens: list[Screen] = Field(default=[], description="Planes where particles are recorded as they pass.")
    refinement: Refinement = Refinement()
    particles: ParticlesSection = ParticlesSection()
    solver: SolverSection = SolverSection()
    motion: Annotated[NoMotion | Leapfrog | RandomWalk, Field(discriminator="kind")] = NoMotion()
    schedule: Schedule = Schedule()
    diagnostics: Diagnostics = Diagnostics()
    output: Output = Output()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if "/" in self.name or self.name in (".", ".."):
            raise complaint(
                "is a path", "give a plain name, and the folder as output.directory", path="name", found=self.name
            )
        self._check_cells()
        self._check_boxes()
        self._check_places()
        self._check_balance()
        self._check_stretch()
        self._check_screening()
        self._check_elements()
        self._check_window()
        self._check_names()
        self._check_bins()
        return self

    def _check_cells(self) -> None:
        cells = self.domain.cells
        for axis, number in enumerate(cells):
            if number * 2**self.refinement.levels > LARGEST_INDEX:
                raise complaint(
                    f"makes {number * 2**self.refinement.levels} cells on the finest level, more than 32 bits count",
                    "use fewer base cells or levels",
                    path=f"domain.cells.{axis}",
                    found=number,
                )
        if (rows := int(cells[0]) * int(cells[1]) * int(cells[2])) > LARGEST_ROW:
            raise complaint(
                f"makes {rows} equations, more than the {LARGEST_ROW} that 64-bit row numbers count",
                "use fewer base cells",
                path="domain.cells",
                found=list(cells),
            )

    def _check_boxes(self) -> None:
        for path, rule in every_rule(self.refinement.rule, "refinement.rule"):
            for number, box in enumerate(rule.boxes if isinstance(rule, StaticRule) else ()):
                self._check_box(box, f"{path}.boxes.{number}")

    def _check_box(self, box: StaticBox, path: str) -> None:
        for axis in range(3):
            last = self.domain.cells[axis] * 2**box.level - 1
            outside = box.first and box.last and (box.first[axis] < 0 or box.last[axis] > last)
            if outside and not self.domain.value.periodic[axis]:
                raise complaint(
                    f"leaves the domain, whose cells of level {box.level} reach from 0 to {last} along {AXES[axis]}",
                    "move it inside",
                    path=path,
                    found=[box.first, box.last],
                )

    def _check_places(self) -> None:
        for number, bunch in enumerate(self.bunches):
            for place in bunch.places():
                for axis in range(3):
                    if not self.domain.lower[axis] <= place[axis] <= self.domain.upper[axis]:
                        raise complaint(
                            f"puts a bunch outside the domain, at {AXES[axis]} = {place[axis]:g} m where it reaches "
                            f"from {self.domain.lower[axis]:g} to {self.domain.upper[axis]:g} m",
                            "move the bunch or enlarge the domain",
                            path=f"bunches.{number}.centre",
                            found=list(place),
                        )

    def _check_balance(self) -> None:
        singular = self.domain.value.singular and self.solver.screening == 0
        if self.background == "neutralizing" and not singular:
            raise complaint(
                "needs a domain whose faces are all periodic or neumann, and no screening",
                "change domain.boundary or solver.screening, or leave the background out",
                path="background",
                found=self.background,
            )
        charges = [bunch.bunch_charge * bunch.copies for bunch in self.bunches]
        scale = sum(abs(charge) for charge in charges)
        if singular and not self.domain.slope and self.background == "none" and abs(sum(charges)) > 1e-12 * scale:
            raise complaint(
                f"has no solution: all faces are periodic or neumann, and the net charge is {sum(charges):g} C",
                'set background = "neutralizing", or charges that add up to zero',
                path="background",
                found=self.background,
            )

    def _check_stretch(self) -> None:
        if isinstance(self.motion, Leapfrog) and self.solver.stretch != (1.0, 1.0, 1.0):
            raise complaint(
                "is for bunches at rest in the scene; the leapfrog finds that of a moving one by itself",
                "leave stretch out, and set motion.frame",
                path="solver.stretch",
                found=list(self.solver.stretch),
            )

    def _check_screening(self) -> None:
        if refused := self.solver.screening_refusal(self.domain.value):
            raise complaint(*refused, path="solver.screening", found=self.solver.screening)

    def _check_elements(self) -> None:
        for number, element in enumerate(self.elements):
            if not isinstance(element, ConstantFocusingElement) or element.wavenumber is None:
                continue
            first = self.bunches[0] if self.bunches else None
            if not isinstance(first, DescribedBunch) or not any(first.mean_momentum) or first.species.charge == 0:
                raise complaint(
                    "needs a first bunch whose species is charged and whose mean momentum is not zero, both in the scene",
                    "give it one, or the element a gradient",
                    path=f"elements.{number}.wavenumber",
                    found=list(element.wavenumber),
                )

    @property
    def reference(self) -> Reference | None:
        """The reference particle at the start, if there is one."""
        motion = self.motion
        if not isinstance(motion, Leapfrog) or motion.reference is not None or motion.window == "none":
            return motion.reference if isinstance(motion, Leapfrog) else None
        first = self.bunches[0] if self.bunches else None
        if not isinstance(first, DescribedBunch):
            return None
        places = first.places() or [self.domain.lower, self.domain.upper]
        x, y, z = np.mean(places, axis=0).tolist()
        return Reference(species=first.species, momentum=first.mean_momentum, position=(x, y, z))

    def _check_window(self) -> None:
        if not isinstance(self.motion, Leapfrog) or self.motion.window == "none":
            return
        reference = self.reference
        if reference is None or not any(reference.mean_momentum):
            raise complaint(
                "needs a reference particle that moves",
                "give motion.reference a momentum, or the first bunch one in the scene",
                path="motion.window",
                found=self.motion.window,
            )
        axis = AXES[int(np.argmax(np.abs(reference.mean_momentum)))]
        across = self.domain.boundary[axis]
        if not set(across) <= {"open", "periodic"}:
            raise complaint(
                "has a wall across the motion, which the window would take along",
                'make both faces "open" or "periodic"',
                path=f"domain.boundary.{axis}",
                found=list(across),
            )
        for kind, given in (("potential", self.domain.potential), ("slope", self.domain.slope)):
            for name, pair in given.items():
                if any(isinstance(value, str) for value in pair):
                    raise complaint(
                        "is a formula, which the window would take along",
                        "give numbers, or the field as an element",
                        path=f"domain.{kind}.{name}",
                        found=list(pair),
                    )

    def _check_names(self) -> None:
        screens = [screen.name for screen in self.screens]
        for key, names, taken in (("apertures", aperture_names(self.apertures), FACES), ("screens", screens, ())):
            for number, name in repeated_names(names, taken):
                has_it = "a face of the domain" if name in taken else f"one of the {key} before it"
                raise complaint(
                    f"is the name of {has_it} already",
                    "give each one of its own",
                    path=f"{key}.{number}.name",
                    found=name,
                )

    def _check_bins(self) -> None:
        length, width = self.domain.upper[2] - self.domain.lower[2], self.diagnostics.loss_bin
        if width is not None and length > MOST_BINS * width:
            raise complaint(
                f"makes more than {MOST_BINS} bins of a domain {length:g} m long",
                "give a longer one",
                path="diagnostics.loss_bin",
                found=width,
            )

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str], overrides: Iterable[str] = (), text: str | None = None) -> Self:
        """Return the scene of a TOML file, with `key.path=value` overrides.

        `text` is what the file holds, where `read_text` read it before: on rank 0 alone, for all. Raises SceneError in one
        sentence; paths in the file are relative to it.
        """
        path = Path(path)
        try:
            data = tomllib.loads(read_text(path) if text is None else text)
        except tomllib.TOMLDecodeError as reason:
            raise SceneError(f"scene file {path} is not TOML: {reason}; correct that line") from None
        toml.override(data, overrides)
        data.setdefault("name", path.stem)
        _anchor_files(data, path.parent)
        return cls.from_dict(data, source=str(path))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: str = "scene") -> Self:
        """Return the scene of nested mappings and lists, as TOML and JSON hold. Raises SceneError in one sentence."""
        try:
            return cls.model_validate(data)
        except ValidationError as refused:
            raise refusal(refused, source, cls) from None

    def to_dict(self) -> dict[str, Any]:
        """Return the resolved scene, all defaults filled in, as plain values; `from_dict` gives the scene back."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_toml(self) -> str:
        """Return the resolved scene as the text of a TOML file."""
        return toml.dumps(self.to_dict())

    def with_interface(self, interface: str) -> Self:
        """Return the scene with `particles.interface` as given."""
        return self.model_copy(update={"particles": self.particles.model_copy(update={"interface": interface})})

    @property
    def directory(self) -> Path:
        """Where the run writes."""
        return Path(self.output.directory) if self.output.directory is not None else Path("runs") / self.name

    def particle_count(self) -> int:
        """Macroparticles of the whole scene at its start."""
        return sum(bunch.number * bunch.copies for bunch in self.bunches)

    def summary(self) -> str:
        """Return in one line what the scene is."""
        cells = "x".join(map(str, self.domain.cells))
        bunches = sum(bunch.copies for bunch in self.bunches)
        more = " and those in files" if any(bunch.source for bunch in self.bunches) else ""
        return (
            f"{self.name}: {cells} cells and {self.refinement.levels} refined levels, {bunches} bunches of "
            f"{self.particle_count()} particles in all{more}, {self.schedule.last_step} steps after the first solve"
        )

    def remarks(self) -> list[str]:
        """Return one sentence for each thing that is legal and yet may not be meant."""
        out = []
        if self.particle_count() == 0 and not any(bunch.source for bunch in self.bunches):
            out.append("the scene has zero particles; the field is that of the boundary alone")
        if self.elements and not isinstance(self.motion, Leapfrog):
            out.append(f'elements act on nothing, since motion.kind is "{self.motion.kind}"; set it to "leapfrog"')
        for number, bunch in enumerate(self.bunches):
            if isinstance(bunch, ThermalBunch) and not math.isclose(bunch.length, self.domain.value.period(2)):
                out.append(
                    f"bunches.{number} is a piece of a continuous beam, {bunch.length:g} m long, which a domain would continue "
                    "that is periodic along z over this length"
                )
        if self.screens and isinstance(self.motion, NoMotion):
            out.append('nothing passes screens, since motion.kind is "none"; set it to "leapfrog"')
        if not isinstance(self.motion, Leapfrog) or self.motion.window == "none":
            out += out_of_reach(self.apertures, self.screens, self.domain.lower[2], self.domain.upper[2])
        flat = [str(number) for number, bunch in enumerate(self.bunches) if bunch.zero_size()]
        if flat:
            out.append(f"bunches.{', '.join(flat)} has zero size; its field is limited by the cell width alone")
        return out


def _anchor_files(data: Mapping[str, Any], folder: Path) -> None:
    for key in ("bunches", "elements"):
        members = data.get(key)
        for member in members if isinstance(members, list) else []:
            if isinstance(member, dict) and isinstance(member.get("file"), str):
                member["file"] = str(folder / member["file"])
