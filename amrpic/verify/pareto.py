"""Speed against error: what settings of a scene cost, and how far they are from its exact field."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from .. import _native
from ..mesh.boxes import scaled_cells
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..particles.particles import concatenate
from ..pic.adapt import follow, make_base
from ..pic.frames import first_frames
from ..pic.initial_particles import make_bunches
from ..pic.meshed import MeshedParticles
from ..pic.setup import Setup, resolved, set_up
from ..scene.motion import NoMotion
from ..scene.refinement_rules import StaticRule, every_rule
from ..scene.scene import Scene
from ..stages.diagnostics import field_energy
from ..stages.migrate import migrate
from .described import ExactField, Moved, density_of, exact_field
from .known_charges import Array, Density, Vector, errors, fill
from .table import MARKERS, Cell, Goal, Table, picture, text

SPARED = 1.1  # what the scene may lose to the best: of its error at no more cost, or of its cost at no more error
LEFT = 0.1  # part of the mesh's error that a solve may leave; what leaves more does not count for the frontier
LESS = 0.99  # an error that is smaller by less is the same
AT_EQUAL_TIME, ASKED_FROM = 1 / 40, 64  # of the error of order 2, that order 4 may make; base cells along an axis
LARGEST = 4, 2  # times the cells of the scene as it is: larger meshes are left out, also where few settings are tried
FINER = 4  # times the base cells per axis of a reference, where no exact field is known
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, "discretization")
COLUMNS = (
    *("base cells", "levels", "boxes", "order", "tolerance", "guess", "cells", "cycles", "visits, 1e6", "seconds"),
    "work units",
    *("set-up, s", "E error", "left by the solve", "frontier"),
)


@dataclass(frozen=True)
class Setting:
    """One way to solve a scene."""

    cells: tuple[int, int, int]  # of the base
    levels: int  # refined ones
    box: int  # largest, cells per axis
    order: Literal[2, 4]
    tolerance: float | str
    warm: bool  # starts from the potential of the charge half a finest cell away

    @property
    def mesh(self) -> tuple[tuple[int, int, int], int, int]:
        return self.cells, self.levels, self.box


@dataclass(frozen=True)
class MeasuredSetting:
    """What a setting costs and yields."""

    setting: Setting
    cells: int  # of all levels, covered ones too
    cycles: int  # with that of the estimate, where the tolerance asks for one
    setup: float  # s
    seconds: float  # of the solve and its field, the best of three
    error: float  # of E, L2 over the domain relative to E
    left: float  # of it by the solve, as a part of what the mesh makes

    @property
    def visits(self) -> int:
        """Cells times cycles: work that no other process disturbs."""
        return self.cells * self.cycles


def tables(comm: MPI.Comm, scene: Scene, quick: bool = False) -> Iterator[Table]:
    """The work-precision table of a scene, with its picture; for a scene of order 4 also that of both orders. Collective.

    `quick` tries fewer settings. Raises InputError for a scene whose charge has no formula.
    """
    density, default = density_of(scene), default_of(scene)
    exact = exact_field(scene, density)
    tried = settings(scene, exact is not None, quick)
    measured = list(_measured(comm, scene, density, exact, tried, LARGEST[quick]))
    (own,) = (m for m in measured if m.setting == default)
    unit = comm.allreduce(_native.measure_work_unit(max(own.cells // comm.size, 1)).seconds, op=MPI.MAX)
    against = "the exact field" if exact else f"the field on {FINER} times as many base cells per axis"
    yield Table(
        f"Speed against error: {scene.name}",
        f"Relative error of E (L2 over the domain) against {against} of the density of `{scene.name}`'s bunches, averaged "
        "over cells, on the mesh that their particles refine. Seconds: one solve and its field, best of three. Work unit: "
        f"one plain 7-point Laplacian on as many cells as the scene's own mesh has ({own.cells}), or 24 bytes per cell at "
        "triad bandwidth out of cache if that is less. Visits: cells times cycles; the frontier (Pareto front) goes by "
        "visits. Warm guess: the potential of the charge half a finest cell away. Left by the solve: its part of the "
        "error of E over the mesh's. Goal: the distance of the scene's own settings from the frontier of those that leave "
        f"at most {text(LEFT)}, the smaller of two ratios: their error over the smallest for as many visits, and their "
        "visits less one cycle over the fewest for an error up to a tenth larger.",
        COLUMNS,
        [
            _row(m, unit, own, measured)
            for m in sorted(measured, key=lambda m: (m.setting.mesh, m.setting.warm, m.cycles))
        ],
        upwards="error of E against seconds",
        picture=partial(draw, measured, own, f"Speed against error: {scene.name}"),
    )
    if default.order == 4:
        yield _orders(measured, scene.name, default)


def default_of(scene: Scene) -> Setting:
    """The settings that the scene gives: its solves but the first start from the potential before."""
    warm = scene.schedule.last_step > 0 and not isinstance(scene.motion, NoMotion)
    refinement = scene.refinement
    solver = scene.solver
    return Setting(
        scene.domain.cells, refinement.levels, refinement.max_grid_size, solver.order, solver.tolerance, warm
    )


def settings(scene: Scene, exact: bool, quick: bool) -> list[Setting]:
    """What is tried: base cells and levels with each tolerance, for a scene of order 4 also in order 2, then boxes and
    guesses with the scene's mesh."""
    default, block = default_of(scene), scene.refinement.blocking_factor
    tolerances: Sequence[float | str] = (1e-4, 1e-10, "discretization") if quick else TOLERANCES
    tolerances = tuple(dict.fromkeys([*tolerances, default.tolerance]))
    factors: Sequence[float] = (0.5, 1) if quick else (0.5, 0.75, 1, 1.25, 1.5)
    levels = range(max(default.levels - 1, 0), default.levels + (2 if exact else 1))
    if any(isinstance(rule, StaticRule) for _, rule in every_rule(scene.refinement.rule, "")):
        factors, levels = (1,), range(default.levels, default.levels + 1)  # its boxes belong to its mesh
    orders: tuple[Literal[2, 4], ...] = (2, 4) if default.order == 4 else (2,)
    settings_tried = [
        replace(
            default, cells=scaled_cells(default.cells, factor, block), levels=level, order=order, tolerance=tolerance
        )
        for factor in factors
        for level in levels
        for order in orders
        for tolerance in tolerances
    ]
    boxes = [box for box in ((16,) if quick else (8, 16, 24, 32, 64)) if box % block == 0]
    settings_tried += [replace(default, box=box) for box in boxes]
    settings_tried += [replace(default, tolerance=tolerance, warm=not default.warm) for tolerance in tolerances]
    return list(dict.fromkeys([*settings_tried, default]))


# ---- the frontier ----


def frontier(measured: Sequence[MeasuredSetting]) -> list[MeasuredSetting]:
    """Those that no other beats in both visits and error, cheapest first, among the ones that the solve does not spoil."""
    best: list[MeasuredSetting] = []
    for m in sorted((m for m in measured if m.left <= LEFT), key=lambda m: (m.visits, m.error)):
        if not best or m.error < LESS * best[-1].error:
            best.append(m)
    return best


def loss(own: MeasuredSetting, measured: Sequence[MeasuredSetting]) -> float:
    """What a setting loses to the frontier: 1 on it."""
    best = frontier([*measured, own])
    error = min(m.error for m in best if m.visits <= own.visits)
    visits = min(m.visits for m in best if m.error <= SPARED * own.error)
    return max(min(own.error / error, (own.visits - own.cells) / visits), 1.0)


def _row(m: MeasuredSetting, unit: float, own: MeasuredSetting, measured: Sequence[MeasuredSetting]) -> list[Cell]:
    s = m.setting
    mark: Cell = "yes" if m in frontier(measured) else ""
    return [
        _by(s.cells),
        s.levels,
        s.box,
        s.order,
        s.tolerance if isinstance(s.tolerance, str) else f"{s.tolerance:.0e}",
        "warm" if s.warm else "zero",
        str(m.cells),
        m.cycles,
        m.visits / 1e6,
        m.seconds,
        m.seconds / unit,
        m.setup,
        m.error,
        m.left,
        Goal(loss(m, measured) if m.left <= LEFT else np.nan, SPARED) if m is own else mark,
    ]


def draw(measured: Sequence[MeasuredSetting], own: MeasuredSetting, title: str, path: Path) -> None:
    """Error against seconds: a colour per mesh, a shape per tolerance; the frontier and the scene's own are marked."""
    meshes = list(dict.fromkeys(m.setting.mesh[:2] for m in measured))
    tolerances = list(dict.fromkeys(str(m.setting.tolerance) for m in measured))
    with picture(path, title, "seconds of a solve and its field", "relative error of E, L2") as axes:
        for m in measured:
            axes.plot(
                m.seconds,
                m.error,
                MARKERS[tolerances.index(str(m.setting.tolerance))],
                color=f"C{meshes.index(m.setting.mesh[:2]) % 10}",
                fillstyle="full" if m.setting.warm else "none",
                markersize=5 if m.setting.order == own.setting.order else 3,
            )
        best = frontier(measured)
        axes.plot(
            [m.seconds for m in best],
            [m.error for m in best],
            "k-",
            linewidth=0.8,
            alpha=0.6,
            label="frontier (by visits)",
        )
        axes.plot(own.seconds, own.error, "ko", markersize=13, fillstyle="none", label="the scene as it is")
        for number, (cells, levels) in enumerate(meshes):
            axes.plot(
                [],
                [],
                "s",
                color=f"C{number % 10}",
                markersize=5,
                label=f"{_by(cells)}, {levels} refined",
            )
        for number, tolerance in enumerate(tolerances):
            axes.plot([], [], MARKERS[number], color="grey", markersize=5, label=f"tolerance {tolerance}")
        if own.setting.order == 4:
            axes.plot([], [], "o", color="grey", fillstyle="none", markersize=3, label="order 2")
        for style, label in (("full", "from a warm guess"), ("none", "from zero")):
            axes.plot([], [], "o", color="grey", fillstyle=style, markersize=5, label=label)
        axes.set(xscale="log", yscale="log")


# ---- both orders ----


@dataclass(frozen=True)
class Law:
    """An error that falls by a power of the time that is spent."""

    power: float
    factor: float

    @classmethod
    def fitted(cls, seconds: Sequence[float], error: Sequence[float]) -> Self:
        power, start = np.polyfit(np.log(seconds), np.log(error), 1)
        return cls(float(power), float(np.exp(start)))

    def __call__(self, seconds: Array | float) -> Any:
        return self.factor * np.asarray(seconds) ** self.power


def _orders(measured: Sequence[MeasuredSetting], name: str, default: Setting) -> Table:
    """What was found of meshes that differ in their base cells alone, solved to the least tolerance."""
    finest = replace(default, tolerance=min(t for t in TOLERANCES if not isinstance(t, str)))
    curves: dict[int, dict[str, tuple[float, float]]] = {}
    for order in (2, 4):
        of_order = (m for m in measured if m.setting == replace(finest, cells=m.setting.cells, order=order))
        curves[order] = {_by(m.setting.cells): (m.seconds, m.error) for m in of_order}
    return orders_against_seconds(
        f"Order 4 and order 2: {name}",
        f"The density of `{name}`'s bunches with {default.levels} refined levels, solved to {finest.tolerance:.0e}; seconds "
        "and errors as above.",
        curves,
        sum(max(m.setting.cells) < ASKED_FROM for m in measured if m.setting == replace(finest, cells=m.setting.cells)),
    )


def orders_against_seconds(
    title: str, about: str, curves: Mapping[int, Mapping[str, tuple[float, float]]], asked: int
) -> Table:
    """A table of both orders on the same meshes, by order and mesh (seconds, error); from mesh number `asked` on the error of
    order 4 has its goal."""
    laws = {order: Law.fitted(*zip(*of_order.values(), strict=True)) for order, of_order in curves.items()}
    rows: list[list[Cell]] = []
    for number, (mesh, second) in enumerate(curves[2].items()):
        fourth = curves[4][mesh]
        at_equal_time = fourth[1] / float(laws[2](fourth[0]))
        goal: Cell = Goal(at_equal_time, AT_EQUAL_TIME) if number >= asked else at_equal_time
        rows.append([mesh, *second, *fourth, fourth[0] / second[0], goal])
    fitted = ", ".join(f"{law.factor:.2g} t^{law.power:.2f} in order {order}" for order, law in laws.items())
    return Table(
        title,
        f"{about} Errors fitted by powers of seconds t: {fitted}. Last column: the error of order 4 over that which order 2 "
        "makes in the same time by its law.",
        ("base cells", "order 2, s", "E", "order 4, s", "E", "time, of order 2's", "error at equal time"),
        rows,
        upwards="error of E against seconds",
        picture=partial(_draw_orders, title, curves, laws),
    )


def _draw_orders(
    title: str, curves: Mapping[int, Mapping[str, tuple[float, float]]], laws: Mapping[int, Law], path: Path
) -> None:
    with picture(path, title, "seconds of a solve", "relative error of E, L2") as axes:
        for n, (order, of_order) in enumerate(curves.items()):
            seconds, error = map(np.array, zip(*of_order.values(), strict=True))
            axes.plot(seconds, error, f"C{n}{MARKERS[n]}", markersize=5, label=f"order {order}")
            label = f"{laws[order].factor:.2g} t^{laws[order].power:.2f}"
            axes.plot(seconds, laws[order](seconds), f"C{n}--", linewidth=0.9, label=label)
        axes.set(xscale="log", yscale="log")


def _by(cells: Sequence[int]) -> str:
    return "×".join(map(str, cells))


# ---- measuring ----


@dataclass(frozen=True, eq=False)
class Case:
    """A mesh, and what is solved on it in an order."""

    scene: Scene
    hierarchy: Hierarchy
    density: Density
    order: Literal[2, 4]

    @property
    def cells(self) -> int:
        """All cells, covered ones too."""
        return self.hierarchy.cells()

    @cached_property
    def rho(self) -> Field:
        """C/m³."""
        return self.filled(self.density)

    @cached_property
    def guess(self) -> Field:
        """The potential of the charge half a finest cell away along all axes."""
        shift = tuple(float(h) / 2 for h in self.hierarchy.spacing(self.hierarchy.levels - 1))
        moved = Moved(self.density, shift)  # type: ignore[arg-type]
        return self.set_up(1e-10).solvers.solve(self.filled(moved), None)[0]

    @cached_property
    def converged(self) -> VectorField:
        """The field that a solve to 1e-10 gives."""
        solvers = self.set_up(1e-10).solvers
        phi, _ = solvers.solve(self.rho, self.guess)
        return solvers.poisson(self.hierarchy).electric_field(phi)

    def filled(self, density: Density) -> Field:
        """Means over cells: in order 4 known as such."""
        out = fill(Field(self.hierarchy), density)
        if self.order == 4:
            out.holds = "means"
        return out

    def set_up(self, tolerance: float | str) -> Setup:
        chosen = {"tolerance": tolerance, "order": self.order}
        solver = self.scene.solver.model_copy(update=chosen)
        return set_up(self.hierarchy.comm, self.scene.model_copy(update={"solver": solver}))


def _measured(
    comm: MPI.Comm, scene: Scene, density: Density, exact: ExactField | None, tried: Sequence[Setting], largest: int
) -> Iterator[MeasuredSetting]:
    most = largest * _case(comm, scene, default_of(scene), density).cells
    exact = exact or _reference(scene, density)
    for mesh, order in dict.fromkeys((setting.mesh, setting.order) for setting in tried):
        settings_here = [setting for setting in tried if (setting.mesh, setting.order) == (mesh, order)]
        if np.prod(mesh[0]) > most:
            continue
        case = _case(comm, scene, settings_here[0], density)
        if case.cells <= most:
            by_mesh = errors(case.converged.components, exact)[0]
            yield from (_one(case, setting, exact, by_mesh) for setting in settings_here)


def _one(case: Case, setting: Setting, exact: ExactField, by_mesh: float) -> MeasuredSetting:
    comm, solvers = case.hierarchy.comm, case.set_up(setting.tolerance).solvers
    rho, guess = case.rho, case.guess if setting.warm else None
    comm.Barrier()
    start = time.perf_counter()
    solver = solvers.poisson(case.hierarchy)
    setup, seconds = time.perf_counter() - start, np.inf
    for _ in range(3):
        comm.Barrier()
        start = time.perf_counter()
        phi, report = solvers.solve(rho, guess)
        efield = solver.electric_field(phi)
        seconds = min(seconds, comm.allreduce(time.perf_counter() - start, op=MPI.MAX))
    error = errors(efield.components, exact)[0]
    cycles = report.cycles + (setting.tolerance == "discretization")
    return MeasuredSetting(setting, case.cells, cycles, setup, seconds, error, _apart(efield, case.converged) / by_mesh)


def _apart(solved: VectorField, reference: VectorField) -> float:
    """L2 norm of a difference over that of what is wanted. Collective."""
    remaining = [field.copy() for field in reference.components]
    for difference, field in zip(remaining, solved.components, strict=True):
        for level in range(reference.hierarchy.levels):
            difference.array(level)[:] -= field.array(level)
    return float(np.sqrt(field_energy(VectorField(*remaining)) / field_energy(reference)))


def _case(comm: MPI.Comm, scene: Scene, setting: Setting, density: Density) -> Case:
    """The mesh that the particles of the scene call for with other settings. Collective."""
    varied = scene.model_copy(
        update={
            "domain": scene.domain.model_copy(update={"cells": setting.cells}),
            "refinement": scene.refinement.model_copy(update={"levels": setting.levels, "max_grid_size": setting.box}),
        }
    )
    base = make_base(comm, varied)
    bunches = make_bunches(comm, varied)
    setup = resolved(set_up(comm, varied), bunches)
    particles, _ = migrate(concatenate(bunches), base)
    beam = follow(MeshedParticles(particles, base, first_frames(particles, setup)), None, setup)
    return Case(varied, beam.hierarchy, density, setting.order)


def _reference(scene: Scene, density: Density) -> ExactField:
    """The field on a much finer mesh, which every rank solves by itself."""
    default = default_of(scene)
    block = scene.refinement.blocking_factor
    fine = replace(default, cells=scaled_cells(default.cells, FINER, block), tolerance=1e-10, warm=False)
    case = _case(MPI.COMM_SELF, scene, fine, density)
    solvers = case.set_up(1e-8).solvers
    phi, _ = solvers.solve(case.rho, None)
    efield = solvers.poisson(case.hierarchy).electric_field(phi)
    return lambda *place: _sampled(efield, *place)


def _sampled(efield: VectorField, *place: Array) -> Vector:
    grid = np.broadcast_arrays(*place)
    values = efield.sample(np.stack([axis.ravel() for axis in grid], axis=1))
    return tuple(values[:, axis].reshape(grid[0].shape) for axis in range(3))  # type: ignore[return-value]
