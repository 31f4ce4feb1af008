"""Runs of material points: closed forms, patch test, a column under its own weight, energy of a press, restart."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mpi4py import MPI

from amrpic import fem, mpm
from amrpic.fem.conjugate_gradients import Preconditioner
from amrpic.mpm.conditions import held_by
from amrpic.mpm.state import LoadState, Plan
from amrpic.mpm.step import begin
from amrpic.parallel import from_rank_0, global_sum
from amrpic.verify.table import Cell, Goal, Table, picture
from exact.press import exact_stress

from .curves import Curves

RUBBER = mpm.NeoHookean(300e6, 0.25)
LAWS: Mapping[str, Mapping[str, Any]] = {
    "neo-hookean": {"law": "neo-hookean", "young": RUBBER.young, "poisson": RUBBER.poisson},
    "ogden, one term": {"law": "ogden", "terms": [{"mu": RUBBER.mu, "alpha": 2}], "lame": RUBBER.lame},
}
HEIGHT = 0.6


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield Table(
        "Material points: confined compression",
        "Runs of a cube between walls without friction, E = 300 MPa, ν = 0.25, pressed to 0.6 of its height with a new mesh "
        "for each step, jittered points. Axial and lateral Cauchy stress off -230.165 and -102.165 MPa, the worst point's; "
        "force of the platen; work, by the mean of forces before and after a step, over the stored energy, less 1.",
        ("law", "degree", "steps", "axial", "lateral", "force", "work - energy", "over that of twice the steps"),
        [_confined(comm, law, degree) for law in LAWS for degree in (1, 2)],
    )
    yield Table(
        "Material points: patch test",
        "A cube of 3³ elements between six walls, pressed by a tenth along x, pulled by a fifth along y, pressed by three "
        "tenths along z in 5 steps with a new mesh for each. Largest difference of F from its closed form, and of stress "
        "between points, in parts of Young's modulus.",
        ("degree", "points", "weights", "F", "stress"),
        [_patch(comm, *case) for case in PATCHES],
    )
    yield _column(comm)
    yield _press_without_damage(comm)
    yield _presses(comm)
    yield _first_step(comm)
    yield Table(
        "Material points: restart",
        "A press with damage, written to a checkpoint half-way and read back: columns of points and of the series that differ "
        "in any bit at the end.",
        ("ranks", "steps after it", "columns of points", "of the series"),
        [_restart(comm)],
    )


def scene(changes: Mapping[str, Any]) -> mpm.Scene:
    """A scene that writes nothing."""
    return mpm.Scene.from_dict({"name": "verify", "output": {"write": []}, **changes})


def states(comm: MPI.Comm, changes: Mapping[str, Any]) -> Iterator[LoadState]:
    """The states of a run after each step. Collective."""
    yield from mpm.Simulation(comm, scene(changes))


def _stress(state: LoadState) -> np.ndarray:
    """Cauchy's stress at this rank's points, without the floor's. Collective."""
    rest = np.zeros((len(state.placed.mesh.nodes), 3))
    return state.placed.solid.states(rest).cauchy[state.placed.body]


def _largest(comm: MPI.Comm, values: np.ndarray) -> float:
    return comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX)


# ---- closed forms ----


def _confined(comm: MPI.Comm, law: str, degree: int) -> list[Cell]:
    gaps, exact = [], exact_stress(RUBBER, HEIGHT)
    for steps in (20, 10):
        *_, last = states(
            comm,
            {
                "domain": {"lower": 0, "upper": 1, "cells": [2, 2, 4], "degree": degree},
                "faces": {"x": "slip", "y": "slip", "z": ["slip", {"press": 1 - HEIGHT}]},
                "points": {"per_axis": 3 + degree},
                "materials": {"rubber": LAWS[law]},
                "schedule": {"steps": steps},
                "solver": {"tolerance": 1e-11},
            },
        )
        row, stress = last.measured, _stress(last)
        gaps.append(abs(row["work"] / row["stored"] - 1))
    return [
        law,
        degree,
        steps,
        *(Goal(_largest(comm, stress[:, a, a] / value - 1), 1e-8) for a, value in zip((2, 0), exact, strict=True)),
        Goal(abs(row["force_z_upper"] / exact[0] - 1), 1e-8),
        Goal(gaps[1], 0.01),
        Goal(gaps[1] / gaps[0], 3.8, least=True),
    ]


# degree, layout, points along each axis, weights
PATCHES = (
    (1, "jittered", 4, "moments"),
    (2, "jittered", 5, "moments"),
    (3, "jittered", 8, "moments"),
    (4, "uniform", 8, "moments"),
    (1, "jittered", 4, "volume"),
    (2, "jittered", 5, "volume"),
)


def _patch(comm: MPI.Comm, degree: int, layout: str, per_axis: int, weights: str) -> list[Cell]:
    *_, last = states(
        comm,
        {
            "domain": {"lower": 0, "upper": 1, "cells": 3, "degree": degree},
            "faces": {
                "x": ["slip", {"press": 0.1}],
                "y": [{"pull": 0.2}, "slip"],
                "z": ["slip", {"press": 0.3}],
            },
            "points": {"per_axis": per_axis, "layout": layout, "weights": weights},
            "materials": {"rubber": LAWS["neo-hookean"]},
            "schedule": {"steps": 5},
            "solver": {"tolerance": 1e-12},
        },
    )
    stress = _stress(last)
    first = comm.allgather(stress[:1])
    off = _largest(comm, last.placed.points.deformation - np.diag([0.9, 1.2, 0.7]))
    uneven = _largest(comm, stress - np.concatenate(first)[0]) / RUBBER.young
    found: list[Cell] = [Goal(off, 1e-10), Goal(uneven, 1e-10)] if weights == "moments" else [off, uneven]
    return [degree, f"{layout} {per_axis}³", weights, *found]


# ---- a column under its own weight ----


@dataclass(frozen=True)
class Column:
    """Soil, a height in m, and the load: gravity, in so many steps."""

    tall: float
    young: float
    poisson: float
    density: float
    gravity: float
    steps: int

    def stress(self, height: np.ndarray) -> np.ndarray:
        """Minus the weight above places at this height before the load."""
        return -self.density * self.gravity * (self.tall - height)


GROUND = Column(16.0, 1e6, 0.3, 2000.0, 9.81, steps=5)  # examples/column.toml: 25 % at the floor
SOFT = Column(50.0, 1e6, 0.0, 80.0, 10.0, steps=20)  # 4 % at the floor
COLUMNS = (16, 32, 64, 128)  # elements along the height
POINTS_OF_COLUMNS = (("jittered", 2), ("jittered", 3), ("jittered", 4), ("uniform", 4))
OF_GROUND, OF_SOFT = {16: 0.016, 32: 0.007, 64: 0.0042}, {16: 0.014, 32: 0.0035, 64: 0.0012}  # goals


def column_errors(comm: MPI.Comm, column: Column, cells: int, layout: str, per_axis: int) -> tuple[float, float]:
    """How far the stress along z at points of a column is from the weight above them. Collective.

    In L2 over points, relative, and the mean over them in parts of the largest.
    """
    run = mpm.Simulation(
        comm,
        scene(
            {
                "domain": {"lower": 0, "upper": [0.5, 0.5, column.tall], "cells": [2, 2, cells], "degree": 1},
                "faces": {"x": "slip", "y": "slip", "z": ["slip", "free"]},
                "points": {"per_axis": per_axis, "layout": layout},
                "materials": {
                    "ground": {
                        "law": "neo-hookean",
                        "young": column.young,
                        "poisson": column.poisson,
                        "density": column.density,
                    }
                },
                "schedule": {"steps": column.steps},
                "gravity": [0, 0, -column.gravity],
                "floor_stiffness": 1e3,
            }
        ),
    )
    first = run.state.placed.points
    ids, heights = (np.concatenate(comm.allgather(one)) for one in (first.id, first.position[:, 2]))
    *_, last = run
    points = last.placed.points
    exact = column.stress(heights[np.argsort(ids)][np.searchsorted(np.sort(ids), points.id)])
    off, volume = _stress(last)[:, 2, 2] - exact, points.volume
    whole = comm.allreduce(
        np.array([volume @ off**2, volume @ exact**2, points.initial_volume @ np.abs(off), points.initial_volume.sum()])
    )
    largest = abs(float(column.stress(np.zeros(1))[0]))
    return float(np.sqrt(whole[0] / whole[1])), float(whole[2] / whole[3] / largest)


def _column(comm: MPI.Comm) -> Table:
    cells = COLUMNS
    errors = {
        f"16 m, {layout} {per_axis}³": [column_errors(comm, GROUND, n, layout, per_axis)[0] for n in cells]
        for layout, per_axis in POINTS_OF_COLUMNS
    }
    errors["50 m, uniform 2³"] = [column_errors(comm, SOFT, n, "uniform", 2)[1] for n in cells]
    goals = {"16 m, jittered 4³": OF_GROUND, "50 m, uniform 2³": OF_SOFT}
    rows: list[list[Cell]] = []
    for name, found in errors.items():
        most = goals.get(name, {})
        rows.append([name, *(Goal(e, most[n]) if n in most else e for n, e in zip(cells, found, strict=True))])
    return Curves(
        "Material points: column",
        "Ground that compacts under its own weight, by a quarter at the floor (16 m) or by 4 % (50 m), by degree 1 with 2 × 2 "
        "elements across: stress along z against the weight above, L2 over points (50 m: mean over points, in parts of the "
        "largest), by points of an element and elements along the height.",
        ("points", *(f"{n} elements" for n in cells)),
        rows,
        curves={name: (cells, found) for name, found in errors.items()},
        across="elements along the height",
        upwards="error of the stress along z",
    )


# ---- a press ----

MOST_NEWTON, MOST_CG = 12, 120


@dataclass(frozen=True)
class Size:
    """Of a press: elements, grains, and the length of damage in m, two distances of nodes of degree 2."""

    cells: tuple[int, int, int]
    grains: int
    length: float

    def __str__(self) -> str:
        return " × ".join(map(str, self.cells))


SMALL, FINER, AS_EXAMPLE = Size((4, 3, 5), 12, 0.7e-3), Size((8, 6, 10), 12, 0.35e-3), Size((6, 5, 8), 30, 0.4e-3)


def press(
    steps: int, breaks: bool, size: Size = SMALL, part: float = 0.3, degree: int = 2, seed: int = 7
) -> dict[str, Any]:
    """Grains in a binder with voids of sticky air, as in examples/press.toml. Without damage the laws are the same."""

    def solid(young: float, toughness: float) -> dict[str, Any]:
        damage = {"damage": {"toughness": toughness, "length": size.length * 2 / degree}} if breaks else {}
        return {"law": "neo-hookean", "young": young, "poisson": 0.25, **damage}

    structure = {"kind": "voronoi", "grains": size.grains, "voids": 0.35, "seed": seed}
    return {
        "domain": {"lower": 0, "upper": [2.4e-3, 2e-3, 3e-3], "cells": list(size.cells), "degree": degree},
        "faces": {"x": "slip", "y": "slip", "z": ["slip", {"press": part}]},
        "structure": {**structure, "grain": "grain", "binder": "binder", "void": "air"},
        "materials": {
            "grain": solid(4e9, 60.0),
            "binder": solid(300e6, 100.0),
            "air": {"law": "neo-hookean", "young": 5e6, "poisson": 0.0},
        },
        "schedule": {"steps": steps, "smallest": 1e-4, "easy": 6},
        "solver": {"damage_tolerance": 0.03, "turns": 30, "iterations": MOST_NEWTON},
    }


@dataclass(frozen=True)
class Pressed:
    """Rows of the series of a run, and its points at the end."""

    rows: Sequence[Mapping[str, float]]
    last: LoadState

    @classmethod
    def of(cls, comm: MPI.Comm, changes: Mapping[str, Any]) -> Pressed:
        """Run a scene. Collective."""
        rows = []
        for state in states(comm, changes):
            rows.append(state.measured)
        return cls(rows, state)

    def __getitem__(self, name: str) -> np.ndarray:
        return np.array([row[name] for row in self.rows])


FLOOR = 50e3  # Pa, a hundredth of air: where few points are left in an element, it may come to have less than it needs


def _press_without_damage(comm: MPI.Comm) -> Table:
    cases = (SMALL, 1, 4), (SMALL, 2, 4), (SMALL, 2, 6), (FINER, 1, 2), (FINER, 1, 4)
    runs = {}
    for size, degree, per_axis in cases:
        for steps in (20, 40) if size == SMALL else (20,):
            changes = {**press(steps, breaks=False, size=size, degree=degree), "points": {"per_axis": per_axis}}
            changes["floor_stiffness"] = FLOOR if per_axis == 2 else 0.0
            runs[size, degree, per_axis, steps] = Pressed.of(comm, changes)
    return Table(
        "Material points: a press without damage",
        "Grains of 4 GPa and binder of 300 MPa with a third of sticky air, 5 MPa, pressed by three tenths: work less stored "
        "energy, the same less what forces out of balance let go, forces of platen and floor apart, over the largest values. "
        "Points that go over into other elements take forces along at once, which costs energy, whatever the steps: more with "
        "fewer points per node. Elements that have fewer points than they need get a floor of 50 kPa where there are 2³.",
        (
            "elements",
            "degree",
            "points",
            "per node",
            "steps",
            "work - stored",
            "without what is let go",
            "forces apart",
            "Newton, most",
            "median",
            "CG, most",
            "least J",
        ),
        [
            [
                str(size),
                degree,
                f"{per_axis}³",
                (per_axis / degree) ** 3,
                steps,
                Goal(gap, 0.4 / steps) if (size, degree) == (SMALL, 1) else gap,
                Goal(rest, 0.4 / steps),
                Goal(_apart(run), 1e-6),
                Goal(float(run["newton_most"].max()), MOST_NEWTON),
                Goal(float(np.median(run["newton_most"])), 5),
                Goal(float(run["cg_most"].max()), MOST_CG),
                float(run["j_min"].min()),
            ]
            for (size, degree, per_axis, steps), run in runs.items()
            for gap, rest in [
                (float(np.abs(one).max() / run["stored"][-1]) for one in (run["gap"], run["gap"] - run["unbalanced"]))
            ]
        ],
        picture=partial(_draw_energies, runs[SMALL, 2, 4, 20]),
    )


def _apart(run: Pressed) -> float:
    upper, lower = run["force_z_upper"], run["force_z_lower"]
    return float(np.abs(upper + lower).max() / np.abs(upper).max())


SEEDS = (1, 2, 3, 4, 5)  # of other structures than the example's


def _presses(comm: MPI.Comm) -> Table:
    cases = [(AS_EXAMPLE, 2, 7), *((SMALL, degree, seed) for degree in (1, 2) for seed in SEEDS)]
    runs = {
        case: Pressed.of(comm, press(20, breaks=True, size=case[0], degree=case[1], seed=case[2])) for case in cases
    }
    return Table(
        "Material points: presses that break",
        "The same with grains of 60 J/m² and binder of 100 J/m²; other seeds have grains and voids in other places. Load at "
        "the end. Energy: stored and dissipated over work, at most; steps that break more than is allowed are cut.",
        (
            "elements",
            "degree",
            "seed",
            "load",
            "steps",
            "cuts",
            "energy",
            "forces apart",
            "Newton, most",
            "median",
            "turns, median",
            "CG, most",
            "least J",
            "damage: grain",
            "binder",
            "air",
        ),
        [[str(size), degree, seed, *_broken(comm, run)] for (size, degree, seed), run in runs.items()],
        picture=partial(_draw_energies, next(iter(runs.values()))),
    )


def _broken(comm: MPI.Comm, run: Pressed) -> list[Cell]:
    """What is asked of a press that breaks, from the load at the end on. Collective."""
    points = run.last.placed.points
    grain, binder, air = (_largest(comm, points.damage[points.material == n]) for n in range(3))
    return [
        Goal(float(run["load"][-1]), 1.0, least=True),
        len(run.rows),
        float(run["cuts"].sum()),
        Goal(float(((run["stored"] + run["dissipated"]) / run["work"]).max()), 1.02),
        Goal(_apart(run), 1e-6),
        Goal(float(run["newton_most"].max()), MOST_NEWTON),
        Goal(float(np.median(run["newton_most"])), 5),
        Goal(float(np.median(run["turns"])), 10),
        Goal(float(run["cg_most"].max()), MOST_CG),
        float(run["j_min"].min()),
        Goal(grain, 0.3, least=True),
        Goal(binder, 0.3, least=True),
        Goal(air, 0.0),
    ]


# points along each axis of an element
FIRST_STEPS = ((Size((24, 20, 30), 60, 0.25e-3), 3), (Size((48, 40, 60), 60, 0.25e-3), 4))
MOST_JACOBI = 200


def _first_step(comm: MPI.Comm) -> Table:
    rows: list[list[Cell]] = []
    taken = [first_solve(comm, size, per_axis) for size, per_axis in FIRST_STEPS]
    for (size, per_axis), (count, multigrid, jacobi) in zip(FIRST_STEPS, taken, strict=True):
        rows.append(
            [
                str(size),
                f"{per_axis}³",
                count,
                Goal(multigrid.iterations, 45),
                Goal(multigrid.iterations / taken[0][1].iterations, 1.3),
                multigrid.seconds,
                jacobi.iterations,
                float(jacobi.residuals[-1] / jacobi.residuals[0]),
                jacobi.seconds,
            ]
        )
    return Table(
        "Material points: first step of a large press",
        "The same, before anything breaks: iterations of CG to 1e-8 for the first tangent, and seconds; beside them those of "
        f"the diagonal, {MOST_JACOBI} at most, and what they leave of the residual.",
        ("elements", "points", "points in all", "iterations", "over the first", "s", "Jacobi", "residual", "s"),
        rows,
    )


def first_solve(comm: MPI.Comm, size: Size, per_axis: int) -> tuple[int, fem.SolveReport, fem.SolveReport]:
    """Points of a press, and how its first linear system is solved by p-multigrid and by the diagonal. Collective."""
    large = scene({**press(20, breaks=True, size=size), "points": {"per_axis": per_axis}})
    there = begin(Plan(comm, large)).placed
    fixed, values = held_by(large, there.mesh, large.schedule.loads())
    zero = np.zeros_like(values)
    tangent = there.solid.tangent(zero)

    def solved(preconditioner: Preconditioner, most: int) -> fem.SolveReport:
        return fem.solve(
            tangent,
            zero,
            fixed=fixed,
            values=values,
            preconditioner=preconditioner,
            tolerance=1e-8,
            most_iterations=most,
        )[1]

    count = int(global_sum(comm, len(there.points)))
    return count, solved("p-multigrid", MOST_JACOBI), solved("jacobi", MOST_JACOBI)


def _draw_energies(run: Pressed, path: Path) -> None:
    """Draw work, stored and dissipated energy over the travel of the platen."""
    with picture(path, "Energy of a press", "travel / mm", "energy / mJ") as axes:
        for name in ("work", "stored", "dissipated", "gap", "unbalanced"):
            if run[name].any():
                axes.plot(1e3 * run["travel_z"], 1e3 * run[name], "o-", markersize=3, label=name)


# ---- restart ----


def _restart(comm: MPI.Comm) -> list[Cell]:
    before, after = 2, 2
    whole = mpm.Simulation(comm, scene(press(40, breaks=True)))
    with TemporaryDirectory() as made:
        path = Path(from_rank_0(comm, lambda: made)) / "checkpoint_00000002"
        for _ in range(before):
            whole.advance()
        whole.checkpoint(path)
        again = mpm.Simulation.restart(comm, path)
        comm.Barrier()
    for run in (whole, again):
        for _ in range(after):
            run.advance()
    columns = [run.state.placed.points.columns() for run in (whole, again)]
    other = [name for name, one in columns[0].items() if not np.array_equal(one, columns[1][name])]
    series = [name for name, one in whole.state.measured.items() if again.state.measured[name] != one]
    counts = [comm.allreduce(len(one), MPI.MAX) for one in (other, series)]
    return [comm.size, after, *(Goal(count, 0) for count in counts)]
