"""The scene: everything that a run depends on, as one frozen model that TOML files and Python share."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, ValidationError, WithJsonSchema, model_validator

from . import menu, toml
from .bunch_data import ArrayBunch, OpenPMDBunch
from .bunch_shapes import (
    GaussianBunch,
    HaloBunch,
    HollowBunch,
    KVBunch,
    ParabolicBunch,
    SphereBunch,
    WaterbagBunch,
)
from .bunches import LatticeBunch
from .clouds import Shape
from .complaints import close_match, sentences
from .errors import HierarchyError, SceneError
from .hierarchy import AXES, BOUNDARIES, Domain
from .refinement import Refinement, StaticBox, StaticRule, every_rule
from .section import Section
from .units import Index3, Length, Length3, Time, complaint
from .walls import Function, Potentials, Slopes, require_kind, wall_function

LARGEST_INDEX = 2**31 - 1  # cells are counted in 32 bits along an axis and on a rank
LARGEST_ROW = 2**63 - 1  # rows of the equations are counted in 64 bits over all ranks


class RefusedScene(SceneError):
    """A scene with mistakes: the message tells the first, `problems` has a sentence for each."""

    def __init__(self, message: str, problems: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.problems = list(problems) or [message]


_FACE = {"enum": list(BOUNDARIES)}
_FACES = {"anyOf": [_FACE, {"type": "array", "items": _FACE, "minItems": 2, "maxItems": 2}]}
BOUNDARY_SCHEMA = {
    "anyOf": [
        _FACE,
        {"type": "object", "properties": dict.fromkeys(AXES, _FACES), "additionalProperties": False},
    ]
}


class DomainSection(Section):
    """The cuboid that is computed, its base cells and what holds at its faces."""

    lower: Length3 = Field(description="Lower corner, m.")
    upper: Length3 = Field(description="Upper corner, m; above the lower one along each axis.")
    cells: Index3 = Field(description="Base cells per axis, at least 2; any number will do.")
    boundary: Annotated[
        dict[str, tuple[str, str]],
        BeforeValidator(lambda value: _per_face(value)),
        WithJsonSchema(BOUNDARY_SCHEMA),
    ] = Field(
        default=dict.fromkeys(AXES, ("open", "open")),
        description="open, dirichlet (0 V), neumann (no flux) or periodic: one for all faces, or per axis one or a "
        "pair (lower, upper). Open, φ(∞) = 0, is the default because a bunch in free space is the usual case.",
    )
    potential: Potentials = Field(
        default={},
        description='Potential of Dirichlet faces, V, per axis one or a pair (lower, upper): numbers, strings such as "5 kV", '
        'or formulas in x, y and z (m) such as "1e6*(x^2 - y^2)". Faces without one are at 0 V.',
    )
    slope: Slopes = Field(
        default={},
        description="Outward derivative of φ on Neumann faces, V/m, per axis one or a pair (lower, upper), as for "
        "potential; the flux of E out of the face is minus this. Faces without one have none.",
    )

    @model_validator(mode="after")
    def _sound(self) -> Self:
        try:
            domain = self.value
        except HierarchyError as refused:
            what, _, remedy = str(refused).partition("; ")
            raise complaint(f"is refused: {what}", remedy, found="") from None
        if any("open" in pair for pair in domain.boundary) and any(domain.periodic):
            raise complaint(
                "mixes open and periodic faces, for which there is no method yet",
                "make all faces open, or the open ones dirichlet or neumann with room around the charge",
                path="boundary",
                found=domain.boundary,
            )
        require_kind(self.potential, self.boundary, "dirichlet", "potential")
        require_kind(self.slope, self.boundary, "neumann", "slope")
        return self

    def wall_functions(self) -> tuple[Function | None, Function | None]:
        """The potential on Dirichlet faces and the slope on Neumann faces, as functions of x, y and z; None where zero."""
        return (
            wall_function(self.potential, self.lower, self.upper, "domain.potential"),
            wall_function(self.slope, self.lower, self.upper, "domain.slope"),
        )

    @property
    def value(self) -> Domain:
        """The domain that hierarchies are made of."""
        return Domain(self.lower, self.upper, self.cells, self.boundary)


def _per_face(value: Any) -> Any:
    if isinstance(value, str):
        value = dict.fromkeys(AXES, value)
    if not isinstance(value, Mapping):
        raise complaint("is no boundary", f"write one of {', '.join(BOUNDARIES)}, or one per axis")
    pairs = {axis: tuple(face) if isinstance(face, list | tuple) else (face, face) for axis, face in value.items()}
    for axis in pairs:
        if axis not in AXES:
            raise complaint("is not an axis", "use x, y and z", path=str(axis))
    for axis, pair in pairs.items():
        for name in pair:
            if name not in BOUNDARIES:
                raise complaint(
                    "is not a boundary condition", close_match(str(name), BOUNDARIES), path=axis, found=name
                )
        if len(pair) != 2 or ("periodic" in pair and pair != ("periodic", "periodic")):
            raise complaint(
                "does not fit the two faces of an axis",
                "write one condition or a pair (lower, upper), periodic on both or on none",
                path=axis,
                found=value[axis],
            )
    return {axis: pairs.get(axis, ("open", "open")) for axis in AXES}


class ParticlesSection(Section):
    """How particles meet the mesh: their clouds, in deposit and gather alike."""

    shape: Shape = Field(
        default="cloud-in-cell",
        description="Cloud of a particle: nearest-grid-point touches its own cell alone and is noisy, cloud-in-cell two cells "
        "per axis, triangular-shaped-cloud three, smoother and nearly three times as dear. All keep the charge exactly.",
    )
    interface: Literal["auto", "matched", "own-level"] = Field(
        default="auto",
        description="Particles less than two fine cells inside a coarse-fine face. own-level: clouds of the fine cells; such "
        "a particle pushes itself by up to 0.6 q²/(4πε₀h²). matched: clouds of the coarse cells, which bring that below 0.02 "
        "but see the field as the coarse level does. auto: matched unless every bunch has more than 140 (σ/h)² particles, "
        "σ its rms size and h the cell width of the finest level; the log and the scene in the outputs say which was taken.",
    )


class Solver(Section):
    """How Poisson's equation is solved."""

    tolerance: Annotated[
        float | Literal["discretization"],
        BeforeValidator(
            menu.tolerance, json_schema_input_type=Annotated[float, Field(gt=0, lt=1)] | Literal["discretization"]
        ),
    ] = Field(
        default=1e-10,
        description="Residual relative to that of a zero potential at which the solve has converged; or discretization: stop "
        "where the error left in φ is a tenth of the estimated error of the mesh, which takes half the cycles or less.",
    )
    absolute_tolerance: float = Field(
        default=0.0,
        ge=0,
        description="Residual at which the solve has converged as well, in V/m² (in V m for norm l1, V/m^0.5 for l2): for "
        "scenes whose charge all but vanishes.",
    )
    norm: menu.Norm = Field(
        default="max",
        description="Norm of the residual over uncovered cells, l1 and l2 weighted by volume; max sees every cell alike.",
    )
    backend: menu.Backend = Field(
        default="matrix-free",
        description="How the stencils are executed. matrix-free: loops over the rows of boxes, by far the fastest and "
        "smallest. crs: compressed rows (Tpetra's matrices), with the whole menu of smoothers, prolongation, coarse_levels, "
        "bottoms and krylov, which matrix-free does not have.",
    )
    smoother: menu.Smoother = Field(
        default="red-black",
        description="What damps the errors of a level. red-black (over-relaxed Gauss-Seidel) is the fastest measured, and the "
        "same on any number of ranks; the others are Ifpack2's, of which the Gauss-Seidel ones relax each rank's cells "
        "by themselves.",
    )
    relaxation: float | None = Field(
        default=None,
        gt=0,
        lt=2,
        description="Factor of a relaxation step; by default 1.28 for red-black, 6/7 for jacobi and 1 for Gauss-Seidel. "
        "Red-black takes it on refined levels of cubes; from the base down it takes 0.7, and where cells are long or flat "
        "0.55, of what lies beyond 1. Refused for chebyshev, which has none.",
    )
    sweeps: Annotated[tuple[int, int], BeforeValidator(menu.both, json_schema_input_type=int | tuple[int, int])] = (
        Field(
            default=(2, 2),
            description="Smoothing sweeps before, and after, the coarse correction: one number for both, or two. For chebyshev "
            "the degree of its polynomial.",
        )
    )
    prolongation: menu.Prolongation = Field(
        default="trilinear", description="Interpolation of coarse corrections; trilinear saves cycles."
    )
    stretch: tuple[float, float, float] = Field(
        default=(1.0, 1.0, 1.0),
        description="Factors s on the lengths: the equation is Σ s⁻² ∂²φ/∂x² = −ρ/ε₀ and E = −s⁻² ∂φ/∂x. "
        "(1, 1, γ) gives φ and E, seen at rest, of a bunch that moves along z with the Lorentz factor γ.",
    )
    coarse_levels: int | None = Field(
        default=None,
        ge=0,
        description="Multigrid levels below the base; as many as its numbers of cells have factors of two if not given, "
        "which is the fastest. 0 leaves the whole base to the bottom solver.",
    )
    bottom: menu.Bottom = Field(
        default="gmres",
        description="What solves the coarsest level, which each rank holds whole: Krylov iterations (Belos), MueLu's "
        "multigrid alone, or direct (KLU2, up to 10 000 cells). gmres works for all; cg is refused unless the matrix is "
        "symmetric.",
    )
    bottom_preconditioner: menu.BottomPreconditioner | None = Field(
        default=None,
        description="What helps the iterations of the bottom: a point method (Ifpack2), or multigrid by smoothed, plain, "
        "brick or structured aggregation (MueLu). smoothed-aggregation if not given; refused for direct.",
    )
    krylov: menu.Krylov = Field(
        default="none",
        description="Krylov acceleration over all levels, with the cycle as its preconditioner: flexible GMRES or BiCGStab. "
        "Without it is faster wherever the cycle converges well.",
    )
    max_cycles: int = Field(default=50, ge=1, description="Cycles after which a solve is given up as unconverged.")
    reuse: bool = Field(
        default=True,
        description="Keep the operators of levels that a regrid leaves alone, the set-up of the bottom, and the tables of open "
        "walls.",
    )

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        wrong = menu.refusal(self.smoother, self.relaxation, self.sweeps, self.bottom, self.bottom_preconditioner)
        wrong = wrong or menu.stopping_refusal(self.tolerance, self.krylov)
        wrong = wrong or menu.backend_refusal(self.backend, {name: getattr(self, name) for name in menu.MATRIX_FREE})
        if wrong:
            raise complaint(wrong.what, wrong.remedy, path=wrong.option, found=wrong.found)
        return self

    @model_validator(mode="after")
    def _positive_stretch(self) -> Self:
        for axis, factor in enumerate(self.stretch):
            if not 0 < factor < menu.LARGEST_STRETCH:
                remedy = f"give a factor above 0, below {menu.LARGEST_STRETCH:g}"
                raise complaint("is no stretch", remedy, path=f"stretch.{axis}", found=factor)
        return self


class NoMotion(Section):
    """The particles rest."""

    kind: Literal["none"] = "none"


class Leapfrog(Section):
    """Particles move in their own field, non-relativistically."""

    kind: Literal["leapfrog"]
    dt: Time = Field(gt=0, description="Time step, s; well below the plasma period and the time to cross a cell.")


class RandomWalk(Section):
    """Each coordinate of each particle takes a uniform random step: the reference benchmark's motion."""

    kind: Literal["random-walk"]
    amplitude: Length = Field(ge=0, description="Largest change per step and axis, m.")


class Schedule(Section):
    """How long a run is. The first solve comes before the first step."""

    steps: int | None = Field(default=None, ge=0, description="Steps after the first solve.")
    solves: int | None = Field(default=None, ge=1, description="Solves in all, in place of steps: one more than steps.")

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if self.steps is not None and self.solves is not None:
            raise complaint("is given as well as steps", "keep one of the two", path="solves", found=self.solves)
        return self

    @property
    def last_step(self) -> int:
        """Number of the step that ends the run."""
        return self.steps if self.steps is not None else (self.solves or 1) - 1


class Output(Section):
    """What a run leaves behind."""

    directory: str | None = Field(default=None, description="Where to write; runs/<name of the scene> if not given.")
    write: list[Literal["checkpoint", "fields", "particles", "series", "pictures"]] = Field(
        default=["checkpoint", "fields", "series", "pictures"],
        description="The kinds of output wanted; particles are openPMD files, which a restart does without.",
    )
    checkpoint_every: int = Field(
        default=10, ge=0, description="Steps between checkpoints; 0 writes the last one only."
    )
    keep: int = Field(
        default=2, ge=1, description="Newest checkpoints kept: two, so that one remains if a disk fails the last."
    )
    writers: int = Field(
        default=1, ge=0, description="Ranks that write a checkpoint, each a part of its own; 0 lets all of them."
    )
    fields_every: int = Field(default=0, ge=0, description="Steps between field files; 0 writes the last one only.")
    particles_every: int = Field(
        default=0, ge=0, description="Steps between particle files; 0 writes the last one only."
    )


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
            | LatticeBunch
            | ArrayBunch
            | OpenPMDBunch,
            Field(discriminator="distribution"),
        ]
    ] = Field(default=[], description="The particles; without any, the scene runs with ρ = 0.")
    refinement: Refinement = Refinement()
    particles: ParticlesSection = ParticlesSection()
    solver: Solver = Solver()
    motion: Annotated[NoMotion | Leapfrog | RandomWalk, Field(discriminator="kind")] = NoMotion()
    schedule: Schedule = Schedule()
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
        singular = self.domain.value.singular
        if self.background == "neutralizing" and not singular:
            raise complaint(
                "needs a domain whose faces are all periodic or neumann",
                "change domain.boundary, or leave the background out",
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
                "asks for the field of a relativistic bunch, but the leapfrog knows no magnetic force",
                "leave stretch out, or the motion",
                path="solver.stretch",
                found=list(self.solver.stretch),
            )

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str], overrides: Iterable[str] = ()) -> Self:
        """Return the scene of a TOML file, with `key.path=value` overrides.

        Raises SceneError in one sentence; paths in the file are relative to it.
        """
        path = Path(path)
        try:
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as reason:
            raise SceneError(f"scene file {path} cannot be read ({reason.strerror}); check the path") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as reason:
            raise SceneError(f"scene file {path} is not TOML: {reason}; mend that line") from None
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
            problems = sentences(refused, source, cls)
            more = f" (and {len(problems) - 1} more: see `amrpic check`)" if len(problems) > 1 else ""
            raise RefusedScene(problems[0] + more, problems) from None

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
        flat = [str(number) for number, bunch in enumerate(self.bunches) if bunch.zero_size()]
        if flat:
            out.append(f"bunches.{', '.join(flat)} has zero size; its field is limited by the cell width alone")
        return out


def _anchor_files(data: Mapping[str, Any], folder: Path) -> None:
    bunches = data.get("bunches")
    for bunch in bunches if isinstance(bunches, list) else []:
        if isinstance(bunch, dict) and isinstance(bunch.get("file"), str):
            bunch["file"] = str(folder / bunch["file"])
