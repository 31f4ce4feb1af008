"""Two runs beside each other: where their scenes differ, by how much what they found does, and their speed."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ..io import openpmd_reader, particle_reader, points_writer, time_series
from ..mesh.domain import AXES
from ..mesh.field import Field, VectorField
from ..mesh.periods import nearest
from ..particles.particles import Particles
from ..scene.differences import differences
from ..units import SPEED_OF_LIGHT
from .dumped_fields import DumpedFields
from .run_results import LOSSES, PARTICLES, SERIES, Results, rows_of

Table = NDArray[Any]

HOW = (
    "seconds",
    "memory",
    "imbalance",
    "boxes",
    "cycles",
    "residual",
    "cg_",
    "changed_rank",
)  # columns on how a run went, not on what it found
FINAL = (
    "particles",
    "charge",
    "mean_energy",
    "rms_energy",
    *(f"{of}_{axis}" for of in ("rms", "emittance") for axis in AXES),
)


@dataclass(frozen=True)
class Difference:
    """By how much one thing differs between two runs."""

    what: str
    relative: float  # to the scale of what is compared; inf where one of the runs does not have it
    where: str = ""


@dataclass(frozen=True)
class Comparison:
    """What differs between two runs. Parts that one of them did not write are not in `parts`."""

    scenes: list[tuple[str, Any, Any]]  # key, value of the first run, of the second
    parts: Mapping[str, list[Difference]]  # of what they found: series, beam, fields, particles, losses
    speed: list[tuple[str, float, float]]  # what, in s or bytes, of both
    remarks: Sequence[str] = ()  # on how they were compared

    def beyond(self, tolerance: float) -> dict[str, list[Difference]]:
        """Return the differences above a tolerance, the largest first, by part."""
        return {
            part: sorted((one for one in found if not one.relative <= tolerance), key=lambda one: -one.relative)
            for part, found in self.parts.items()
        }

    def equal(self, tolerance: float) -> bool:
        """Whether the runs found the same within a tolerance; their scenes and speed do not count."""
        return not any(self.beyond(tolerance).values())


def compare(first: Path, second: Path) -> Comparison:
    """Compare the runs in two folders. Serial.

    Raises InputError if one of them holds no rows of a series.
    """
    runs = [Results.open(MPI.COMM_SELF, folder) for folder in (first, second)]
    tables = [rows_of(run.folder) for run in runs]
    scenes = [time_series.scene_of(run.folder / SERIES) for run in runs]
    parts: dict[str, list[Difference]] = {"series": list(_series(tables[0], tables[1], max(map(_charge, runs))))}
    remarks: list[str] = []
    for name, part in (
        ("beam", _beam),
        ("fields", partial(_fields, remarks=remarks)),
        ("particles", _particles),
        ("points", _points),
        ("losses", _losses),
    ):
        with contextlib.suppress(_Missing):
            parts[name] = list(part(*runs))
    return Comparison(list(differences(scenes[0], scenes[1])), parts, list(_speed(*tables)), remarks)


class _Missing(Exception):
    """One of the runs did not write what would be compared."""


def _relative(one: Table, other: Table, scale: float | None = None) -> tuple[float, int]:
    """Return the largest difference over the largest magnitude, or a larger scale, and its place; nan equals nan."""
    if len(one) == 0:
        return 0.0, 0
    with np.errstate(invalid="ignore"):
        apart = np.where((one == other) | (np.isnan(one) & np.isnan(other)), 0.0, np.abs(one - other))
    apart = np.where(np.isnan(apart), np.inf, apart)
    place = int(np.argmax(apart))
    finite = np.abs(np.concatenate([one, other]))
    largest = max(float(finite[np.isfinite(finite)].max(initial=0.0)), scale or 0.0)
    return (float(apart[place]) / largest if largest > 0 else float(apart[place])), place


def _charge(run: Results) -> float:
    """Return the largest charge of a group of particles, C, with which sums that cancel are compared; 0 if it is not known."""
    path = run.folder / "beam.csv"
    found = np.abs(time_series.read(path)["charge"]) if path.exists() else np.zeros(0)
    return float(found.max(initial=0.0))


def _series(one: Table, other: Table, charge: float = 0.0) -> Iterator[Difference]:
    """Compare the columns that both have, at the steps that both have; a step of one alone is a difference.

    `charge`: of the largest group of particles, C.
    """
    steps, here, there = np.intersect1d(one["step"], other["step"], return_indices=True)
    alone = len(one) + len(other) - 2 * len(steps)
    yield Difference("steps", math.inf if alone else 0.0, f"{alone} of one run alone" if alone else "")
    one, other = one[here], other[there]
    names = [name for name in one.dtype.names or () if name in (other.dtype.names or ()) and not name.startswith(HOW)]
    for name in names[1:]:
        scale = charge if name == "charge" else _scale(name, one)
        relative, place = _relative(one[name].astype(float), other[name].astype(float), scale)
        yield Difference(name, relative, f"at step {steps[place]}" if relative > 0 else "")


def _scale(name: str, table: Table) -> float:
    """Return what means and total momenta, which may vanish, are compared with: sizes, and 2 E/c, below the sum of all |p|."""
    of, _, axis = name.rpartition("_")
    if of == "mean" and axis in AXES:
        found = np.array([table[f"rms_{one}"] for one in AXES])
    elif of == "momentum":
        found = np.array(
            [*(np.abs(table[f"momentum_{one}"]) for one in AXES), 2 * table["kinetic_energy"] / SPEED_OF_LIGHT]
        )
    else:
        return 0.0
    return float(found[np.isfinite(found)].max(initial=0.0))


def _beam(one: Results, other: Results) -> Iterator[Difference]:
    """Compare final moments of the groups of particles."""
    tables = []
    for run in (one, other):
        path = run.folder / "beam.csv"
        if not path.exists():
            raise _Missing
        tables.append(time_series.read(path))
    steps = np.intersect1d(tables[0]["step"], tables[1]["step"])
    if len(steps) == 0:
        raise _Missing
    rows = [{str(row["group"]): row for row in table[table["step"] == steps[-1]]} for table in tables]
    charge = max(map(_charge, (one, other)))
    for group in dict.fromkeys([*rows[0], *rows[1]]):
        if not all(group in held for held in rows):
            yield Difference(group, math.inf, "in one run alone")
            continue
        for name in FINAL:
            a, b = (np.array([float(held[group][name])]) for held in rows)
            scale = charge if name == "charge" else 0.0
            yield Difference(f"{name} of {group}", _relative(a, b, scale)[0], f"at step {steps[-1]}")


def _latest_common(steps: Sequence[Iterable[int]]) -> int:
    common = set(steps[0]) & set(steps[1])
    if not common:
        raise _Missing
    return max(common)


def _fields(one: Results, other: Results, remarks: list[str]) -> Iterator[Difference]:
    """Compare the fields of the latest step that both have: norms of the differences on the mesh of the first run.

    Those of the second are carried to it where meshes differ; where domains do, norms of both are compared.
    """
    step = _latest_common([one.fields, other.fields])
    mine, theirs = one.fields[step], other.fields[step]
    names = [name for name in mine if name in theirs]
    if mine.window != theirs.window:  # fields are compared place by place on the mesh
        way = float(np.abs(mine.window.shift - theirs.window.shift).max())
        yield Difference("place of the mesh over its size", way / _extent(mine), f"at step {step}")
        mine, theirs = mine.at_rest, theirs.at_rest
    domains = [fields.hierarchy.domain for fields in (mine, theirs)]
    if (domains[0].lower, domains[0].upper) != (domains[1].lower, domains[1].upper):
        yield Difference("domain", math.inf, f"the fields of step {step} live on two domains; their norms are compared")
        for name in names:
            a, b = _scalar(mine[name]), _scalar(theirs[name])
            yield from _of_norms(name, step, {kind: abs(a.norm(kind) - b.norm(kind)) for kind in NORMS}, (a, b))
        return
    moved: Mapping[str, Field | VectorField] = theirs.on(mine.hierarchy)
    if not mine.hierarchy.same_cells(theirs.hierarchy):
        moved = {name: theirs[name].remap(mine.hierarchy) for name in names}
        remarks.append(
            f"the meshes of step {step} differ; fields of the second run are carried to the mesh of the first"
        )
    for name in names:
        apart = _apart(mine[name], moved[name])
        both = _scalar(mine[name]), _scalar(moved[name])
        yield from _of_norms(name, step, {kind: apart.norm(kind) for kind in NORMS}, both)


def _extent(fields: DumpedFields) -> float:
    """Return the longest edge of the domain, m."""
    domain = fields.hierarchy.domain
    return float(np.max(np.subtract(domain.upper, domain.lower)))


NORMS = ("l2", "max")


def _of_norms(name: str, step: int, apart: Mapping[str, float], both: Sequence[Field]) -> Iterator[Difference]:
    """Yield the differences of a field in some norms, over the larger norm of both fields."""
    for kind, difference in apart.items():
        scale = max(field.norm(kind) for field in both)
        relative = difference / scale if scale > 0 else difference
        yield Difference(f"{name} in the {kind} norm", relative, f"at step {step}")


def _apart(one: Field | VectorField, other: Field | VectorField) -> Field:
    parts = [a - b for a, b in zip(one.parts, other.parts, strict=True)]
    return parts[0] if len(parts) == 1 else VectorField(*parts).magnitude()


def _scalar(field: Field | VectorField) -> Field:
    return field if isinstance(field, Field) else field.magnitude()


def _particles(one: Results, other: Results) -> Iterator[Difference]:
    """Compare the particles of the latest step that both have, by their numbers."""
    if one.of_points or other.of_points:
        raise _Missing
    dumps = [run._dumps(*PARTICLES) for run in (one, other)]
    step = _latest_common(dumps)
    dumped, others = (particle_reader.read(held[step]) for held in dumps)
    mine, theirs = dumped.particles, others.particles
    _, here, there = np.intersect1d(mine.id, theirs.id, return_indices=True)
    alone = len(mine) + len(theirs) - 2 * len(here)
    yield Difference(
        "particles", math.inf if alone else 0.0, f"{alone} of one run alone" if alone else f"at step {step}"
    )
    mine, theirs = mine.select(here), theirs.select(there)
    for what in ("position", "momentum"):
        apart = getattr(mine, what) - getattr(theirs, what)
        if (
            what == "position" and dumped.domain is not None
        ):  # rounding may have taken one of two through a periodic face
            apart = np.stack([nearest(apart[:, d], dumped.domain.period(d)) for d in range(3)], axis=1)
        spread = _spread(mine, what)
        worst = float(np.abs(apart).max(initial=0.0))
        yield Difference(f"{what} over its rms", worst / spread if spread > 0 else worst, f"at step {step}")


def _points(one: Results, other: Results) -> Iterator[Difference]:
    """Compare the material points of the latest step that both have, by their numbers."""
    dumps = [run._dumps("points_*.vtkhdf") for run in (one, other)]
    step = _latest_common(dumps)
    mine, theirs = (points_writer.read(paths[step]) for paths in dumps)
    _, here, there = np.intersect1d(mine["id"], theirs["id"], return_indices=True)
    alone = len(mine["id"]) + len(theirs["id"]) - 2 * len(here)
    yield Difference("points", math.inf if alone else 0.0, f"{alone} of one run alone" if alone else f"at step {step}")
    for name in mine:
        if name in theirs and name != "id":
            a, b = (values[name][rows].astype(float).ravel() for values, rows in ((mine, here), (theirs, there)))
            yield Difference(f"{name} of points", _relative(a, b)[0], f"at step {step}")


def _losses(one: Results, other: Results) -> Iterator[Difference]:
    """Compare the lost particles, by their numbers: which they are, at what, when and where they were lost."""
    paths = [run.folder / LOSSES for run in (one, other)]
    if not all(path.exists() for path in paths):
        raise _Missing
    tables = [_lost(path) for path in paths]
    _, here, there = np.intersect1d(tables[0]["id"], tables[1]["id"], return_indices=True)
    alone = len(tables[0]["id"]) + len(tables[1]["id"]) - 2 * len(here)
    yield Difference("lost particles", math.inf if alone else 0.0, f"{alone} of one run alone" if alone else "")
    mine, theirs = (
        {name: values[rows] for name, values in t.items()} for t, rows in zip(tables, (here, there), strict=True)
    )
    elsewhere = int(np.count_nonzero(mine["cause"] != theirs["cause"]))
    yield Difference(
        "causes of losses", math.inf if elsewhere else 0.0, f"{elsewhere} at something else" if elsewhere else ""
    )
    for what in ("time", "position"):
        spread = float(np.sqrt(np.mean(np.square(mine[what])))) if len(here) else 0.0
        worst = float(np.abs(mine[what] - theirs[what]).max(initial=0.0))
        yield Difference(f"{what} of losses over its rms", worst / spread if spread > 0 else worst)


def _lost(path: Path) -> dict[str, NDArray[Any]]:
    """Return the numbers, causes, times (s) and places (m) of lost particles, of all species."""
    records = list(openpmd_reader.records(path))
    return {
        "id": np.concatenate([record.id for record in records]),
        "cause": np.concatenate([np.asarray(record.cause, dtype=str) for record in records]),
        "time": np.concatenate([record.time for record in records]),
        "position": np.concatenate([record.position for record in records]),
    }


def _spread(particles: Particles, what: str) -> float:
    values = getattr(particles, what)
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def _speed(one: Table, other: Table) -> Iterator[tuple[str, float, float]]:
    """Yield time of a step after the first, that of the stages, and memory."""

    def mean(table: Table, name: str) -> float:
        return float(table[name][1:].mean() if len(table) > 1 else table[name].mean())

    for name in one.dtype.names or ():
        if name.startswith("seconds") and name in (other.dtype.names or ()):
            yield name, mean(one, name), mean(other, name)
    yield "memory", float(one["memory"].max()), float(other["memory"].max())
