"""Runs described by PICMI, the particle-in-cell modelling interface: `from amrpic import picmi` (`pip install picmistandard`).

Electrostatic runs in three dimensions: `ElectrostaticSolver` on a `Cartesian3DGrid`, species with distributions that are drawn
or given, fields that are applied, diagnostics. What a script asks for besides is refused in one sentence. u is γ v, in m/s.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from .arithmetic import CONSTANTS, parsed, value
from .errors import InputError
from .mpi import MPI

try:
    import picmistandard
except ImportError:
    raise InputError('PICMI needs picmistandard; install "amrpic[drivers]"') from None

from .particles.species import SPECIES
from .particles.species import Species as RealSpecies
from .pic.simulation import Simulation as Run
from .scene.scene import Scene
from .units import ELECTRON_MASS, ELEMENTARY_CHARGE, PROTON_MASS, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY

codename = "amrpic"
picmistandard.register_codename(codename)
SHAPES = {"NGP": "nearest-grid-point", "linear": "cloud-in-cell", "quadratic": "triangular-shaped-cloud"}
ORDERS = ("NGP", "linear", "quadratic")
FACES = {"open": "open", "dirichlet": "dirichlet", "neumann": "neumann", "periodic": "periodic"}
Array = NDArray[np.float64]


class constants:
    """Constants of nature, as scripts ask for them."""

    c, q_e, m_e, m_p, ep0 = SPEED_OF_LIGHT, ELEMENTARY_CHARGE, ELECTRON_MASS, PROTON_MASS, VACUUM_PERMITTIVITY


picmistandard.register_constants(constants)


class Cartesian3DGrid(picmistandard.PICMI_Cartesian3DGrid):
    """A box of cells; refined regions become static boxes."""


class ElectrostaticSolver(picmistandard.PICMI_ElectrostaticSolver):
    """Multigrid, whatever `method` says."""


class GaussianBunchDistribution(picmistandard.PICMI_GaussianBunchDistribution):
    """A normal bunch."""

    def drawn(self, number: int, rng: np.random.Generator, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
        """Return places (n, 3) in m, u (n, 3) in m/s and weights (n,)."""
        places = np.array(self.centroid_position) + np.array(self.rms_bunch_size) * rng.normal(size=(number, 3))
        spread = np.array(self.rms_velocity) * rng.normal(size=(number, 3))
        u = (
            np.array(self.centroid_velocity)
            + spread
            + np.array(self.velocity_divergence) * (places - np.array(self.centroid_position))
        )
        return places, u, np.full(number, self.n_physical_particles / max(number, 1))


class UniformDistribution(picmistandard.PICMI_UniformDistribution):
    """Even density in a box."""

    def drawn(self, number: int, rng: np.random.Generator, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
        """Return places (n, 3) in m, u (n, 3) in m/s and weights (n,)."""
        low, high = _within(self, lower, upper)
        places = rng.uniform(low, high, (number, 3))
        weight = self.density * float(np.prod(high - low)) / max(number, 1)
        return places, _thermal(self, number, rng), np.full(number, weight)


class AnalyticDistribution(picmistandard.PICMI_AnalyticDistribution):
    """A density (1/m³) that is an expression of x, y and z."""

    def drawn(self, number: int, rng: np.random.Generator, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
        """Return places (n, 3) in m, u (n, 3) in m/s and weights (n,): evenly spread, each with its density; none without."""
        if any(
            expression is not None for expression in [*self.momentum_expressions, *self.momentum_spread_expressions]
        ):
            raise InputError("momentum expressions of an AnalyticDistribution are not taken; give directed_velocity")
        low, high = _within(self, lower, upper)
        places = low + (high - low) * _quiet(number, rng)
        density = _values(str(self.density_expression), places, self.user_defined_kw)
        weight = density * float(np.prod(high - low)) / max(number, 1)
        u, weighed = _thermal(self, number, rng), weight > 0
        return places[weighed], u[weighed], weight[weighed]


class ParticleListDistribution(picmistandard.PICMI_ParticleListDistribution):
    """Particles one by one."""

    def drawn(self, number: int, rng: np.random.Generator, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
        """Return places (n, 3) in m, u (n, 3) in m/s and weights (n,)."""
        places, u = np.stack([self.x, self.y, self.z], axis=1), np.stack([self.ux, self.uy, self.uz], axis=1)
        return places, u, np.broadcast_to(np.asarray(self.weight, dtype=float), len(places)).copy()


class PseudoRandomLayout(picmistandard.PICMI_PseudoRandomLayout):
    """Particles at random places."""


class GriddedLayout(picmistandard.PICMI_GriddedLayout):
    """So many particles per cell; they are drawn."""


class PICMISpecies(picmistandard.PICMI_Species):
    """Particles of one kind."""

    def real(self) -> RealSpecies:
        """Return one real particle of it."""
        kinds = {"electron": "electron", "positron": "positron", "proton": "proton", "antiproton": "antiproton"}
        by_name = SPECIES[kinds[self.particle_type]] if self.particle_type in kinds else None
        charge = _number(self.charge, by_name.charge if by_name else None, "charge")
        mass = _number(self.mass, by_name.mass if by_name else None, "mass")
        return RealSpecies(name=self.name or self.particle_type or "species", charge=charge, mass=mass)


Species = PICMISpecies


class ConstantAppliedField(picmistandard.PICMI_ConstantAppliedField):
    """A uniform field everywhere."""

    def element(self) -> dict[str, Any]:
        """Return it as an element of a scene."""
        if any(bound is not None for bound in [*self.lower_bound, *self.upper_bound]):
            raise InputError("bounds of a ConstantAppliedField are not taken; leave them out")
        electric, magnetic = ([float(getattr(self, f"{kind}{axis}") or 0.0) for axis in "xyz"] for kind in ("E", "B"))
        return {"kind": "uniform", "electric_field": electric, "magnetic_field": magnetic}


class FieldDiagnostic(picmistandard.PICMI_FieldDiagnostic):
    """Fields at some steps."""


class ElectrostaticFieldDiagnostic(picmistandard.PICMI_ElectrostaticFieldDiagnostic):
    """Fields at some steps."""


class ParticleDiagnostic(picmistandard.PICMI_ParticleDiagnostic):
    """Particles at some steps."""


class Simulation(picmistandard.PICMI_Simulation):
    """A run: `step` makes steps, `write_input_file` writes the scene, `run_of_scene` is the `amrpic.Simulation` beneath."""

    amrpic_directory: str | None = Field(default=None, description="Where the run writes.")
    amrpic_levels: int = Field(default=0, ge=0, description="Refined levels, where the charge density is high.")
    amrpic_scene: dict = Field(default={}, description="Further keys of the scene, as nested dictionaries.")

    def scene(self) -> Scene:
        """Return the scene that this describes. InputError for what it cannot be."""
        solver = self.solver
        if not isinstance(solver, picmistandard.PICMI_ElectrostaticSolver):
            raise InputError(f"the solver is a {type(solver).__name__}; give an ElectrostaticSolver")
        if self.lasers or self.interactions:
            raise InputError("lasers and interactions are not there; leave them out")
        if not self.time_step_size:
            raise InputError("time_step_size is missing; give it in s")
        grid = solver.grid
        tolerance = {"tolerance": solver.required_precision} if solver.required_precision else {}
        boxes = [{"level": level, "lower": list(lo), "upper": list(hi)} for level, lo, hi, *_ in grid.refined_regions]
        levels = max([self.amrpic_levels, *(box["level"] for box in boxes)])
        rule: dict[str, Any] = {"rule": {"kind": "static", "boxes": boxes}} if boxes else {}
        data: dict[str, Any] = {
            "domain": {
                "lower": list(grid.lower_bound),
                "upper": list(grid.upper_bound),
                "cells": list(grid.number_of_cells),
                "boundary": dict(zip("xyz", self._faces(grid), strict=True)),
            },
            "bunches": list(self._bunches(np.array(grid.lower_bound), np.array(grid.upper_bound), grid)),
            "elements": [self._element(applied) for applied in self.applied_fields],
            "refinement": {"levels": levels, **rule},
            "particles": {"shape": self._shape()},
            "solver": tolerance,
            "motion": {"kind": "leapfrog", "dt": self.time_step_size},
            "schedule": {"steps": self.max_steps or 1},
            "output": self._output(),
        }
        for key, section in self.amrpic_scene.items():
            data[key] = {**data.get(key, {}), **section} if isinstance(section, dict) else section
        return Scene.from_dict(data)

    def run_of_scene(self) -> Run:
        """Return the run that steps go on with. Collective."""
        run = getattr(self, "_run", None)
        if run is None:
            run = Run(MPI.COMM_WORLD, self.scene())
            object.__setattr__(self, "_run", run)
        return run

    def step(self, nsteps: int | None = 1) -> None:
        """Make so many steps; None: up to max_steps. Collective."""
        run = self.run_of_scene()
        last = self.max_steps if nsteps is None else run.step + nsteps
        if last is None:
            raise InputError("there is no max_steps; give the number of steps")
        while run.step < last:
            run.advance()

    def write_input_file(self, file_name: str = "inputs") -> None:
        """Write the scene in TOML; arrays of particles stand beside it."""
        Path(file_name).write_text(self.scene().to_toml(), encoding="utf-8")

    def _faces(self, grid: Any) -> Iterator[list[str]]:
        pairs = zip(grid.lower_boundary_conditions, grid.upper_boundary_conditions, strict=True)
        for axis, pair in zip("xyz", pairs, strict=True):
            for condition in pair:
                if condition not in FACES:
                    raise InputError(f"the boundary along {axis} is {condition!r}; use one of {', '.join(FACES)}")
            yield [FACES[condition] for condition in pair]

    def _shape(self) -> str:
        shape = next(
            (species.particle_shape for species in self.species if species.particle_shape is not None),
            self.particle_shape,
        )
        name = ORDERS[shape] if isinstance(shape, int) and shape < len(ORDERS) else shape
        if name is not None and name not in SHAPES:
            warnings.warn(f"particle_shape {shape!r} becomes quadratic, the smoothest there is", stacklevel=3)
            name = "quadratic"
        return SHAPES[str(name or "linear")]

    def _bunches(self, lower: Array, upper: Array, grid: Any) -> Iterator[dict[str, Any]]:
        for number, (species, layout) in enumerate(zip(self.species, self.layouts, strict=True)):
            distributions = species.initial_distribution
            many: Sequence[Any] = distributions if isinstance(distributions, list) else [distributions]
            for member in many:
                if not hasattr(member, "drawn"):
                    raise InputError(f"the distribution {type(member).__name__} is not there; give one of amrpic.picmi")
                count, seed = _count(layout, member, grid, lower, upper)
                rng = np.random.default_rng([number, seed])
                places, u, weight = member.drawn(count, rng, lower, upper)
                real, scale = species.real(), species.density_scale or 1.0
                inside = ((places >= lower) & (places < upper)).all(axis=1)
                yield {
                    "distribution": "arrays",
                    "name": _word(real.name),
                    "species": {"name": real.name, "charge": real.charge, "mass": real.mass},
                    "position": places[inside],
                    "momenta": u[inside] * real.mass,
                    "weight": weight[inside] * scale,
                }

    def _element(self, applied: Any) -> dict[str, Any]:
        if not isinstance(applied, ConstantAppliedField):
            raise InputError(f"the applied field {type(applied).__name__} is not there; give a ConstantAppliedField")
        return applied.element()

    def _output(self) -> dict[str, Any]:
        write: list[str] = []
        out: dict[str, Any] = {"directory": self.amrpic_directory} if self.amrpic_directory else {}
        for diagnostic in self.diagnostics:
            particles = isinstance(diagnostic, picmistandard.PICMI_ParticleDiagnostic)
            kind = "particles" if particles else "fields"
            write.append(kind)
            out[f"{kind}_every"] = int(getattr(diagnostic, "period", 1) or 1)
        return {**out, "write": sorted({*write, "series"})}


def _count(layout: Any, distribution: Any, grid: Any, lower: Array, upper: Array) -> tuple[int, int]:
    """Return how many particles a layout asks for, and its seed."""
    if layout is None or isinstance(distribution, ParticleListDistribution):
        return 0, 0
    seed = getattr(layout, "seed", None) or 0
    total = getattr(layout, "n_macroparticles", None)
    if total is not None:
        return int(total), seed
    per_cell = int(np.prod(layout.n_macroparticles_per_cell))
    low, high = _within(distribution, lower, upper) if hasattr(distribution, "lower_bound") else (lower, upper)
    part = float(np.prod((high - low) / (upper - lower)))
    return round(per_cell * part * float(np.prod(grid.number_of_cells))), seed


def _within(distribution: Any, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return where a distribution lies in a domain."""
    low, high = (
        np.array([limit if bound is None else bound for bound, limit in zip(bounds, limits, strict=True)], dtype=float)
        for bounds, limits in ((distribution.lower_bound, lower), (distribution.upper_bound, upper))
    )
    return np.maximum(low, lower), np.minimum(high, upper)


def _thermal(distribution: Any, number: int, rng: np.random.Generator) -> Array:
    spread = np.array(distribution.rms_velocity, dtype=float) * rng.normal(size=(number, 3))
    return np.array(distribution.directed_velocity, dtype=float) + spread


def _quiet(number: int, rng: np.random.Generator) -> Array:
    """Return even places in the unit cube, which lie more evenly than if they were drawn."""
    ratio = 1.2207440846057596  # x⁴ = x + 1 (M. Roberts' sequence)
    steps = np.array([1 / ratio, 1 / ratio**2, 1 / ratio**3])
    return (rng.random(3) + np.arange(number)[:, None] * steps) % 1.0


FUNCTIONS = {name: getattr(np, name) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "abs", "where")}


def _values(expression: str, places: Array, parameters: dict[str, Any]) -> Array:
    """Return the values of an expression of x, y, z, parameters and functions of NumPy, such as "n0 * (x*x + y*y < R**2)"."""
    x, y, z = places.T
    names = {**CONSTANTS, **parameters, "x": x, "y": y, "z": z}
    try:
        values = np.asarray(value(parsed(expression), names, FUNCTIONS), dtype=float)
        return np.broadcast_to(values, len(places))
    except (SyntaxError, ArithmeticError, ValueError, TypeError, KeyError, RecursionError) as refused:
        why = f"{refused.args[0]!r} is unknown" if isinstance(refused, KeyError) else f"{refused}"
        raise InputError(f"the expression {expression!r:.80} has no value: {why}") from None


def _number(value: Any, default: float | None, what: str) -> float:
    if isinstance(value, str):
        constants = {"q_e": ELEMENTARY_CHARGE, "-q_e": -ELEMENTARY_CHARGE, "m_e": ELECTRON_MASS, "m_p": PROTON_MASS}
        value = constants.get(value, value)
    if value is None:
        value = default
    if not isinstance(value, int | float):
        raise InputError(f"the {what} of a species is {value!r}; give a number, or a particle_type such as electron")
    return float(value)


def _word(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "_+-" else "_" for letter in name)
