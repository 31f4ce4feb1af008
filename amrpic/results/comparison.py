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
from numpy.typing import NDArray

from ..io import openpmd_reader, particle_reader, points_writer, time_series
from ..mesh.domain import AXES
from ..mesh.field import Field, VectorField
from ..mesh.periods import nearest
from ..mpi import MPI
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
            part: sorted(
                (difference for difference in differences if not difference.relative <= tolerance),
                key=lambda difference: -difference.relative,
            )
            for part, differences in self.parts.items()
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
            if found := list(part(*runs)):
                parts[name] = found
    return Comparison(list(differences(scenes[0], scenes[1])), parts, list(_speed(*tables)), remarks)


class _Missing(Exception):
    """One of the runs did not write what would be compared."""


def _relative(first: Table, second: Table, scale: float | None = None) -> tuple[float, int]:
    """Return the largest difference over the largest magnitude, or a larger scale, and its place; nan equals nan."""
    if len(first) == 0:
        return 0.0, 0
    with np.errstate(invalid="ignore"):
        distance = np.where((first == second) | (np.isnan(first) & np.isnan(second)), 0.0, np.abs(first - second))
    distance = np.where(np.isnan(distance), np.inf, distance)
    place = int(np.argmax(distance))
    finite = np.abs(np.concatenate([first, second]))
    largest = max(float(finite[np.isfinite(finite)].max(initial=0.0)), scale or 0.0)
    return (float(distance[place]) / largest if largest > 0 else float(distance[place])), place


def _charge(run: Results) -> float:
    """Return the largest charge of a group of particles, C, with which sums that cancel are compared; 0 if it is not known."""
    path = run.folder / "beam.csv"
    charges = np.abs(time_series.read(path)["charge"]) if path.exists() else np.zeros(0)
    return float(charges.max(initial=0.0))


def _series(first: Table, second: Table, charge: float = 0.0) -> Iterator[Difference]:
    """Compare the columns that both have, at the moments that both have; one of one run alone is a difference.

    `charge`: of the largest group of particles, C.
    """
    rows, alone = _in_both(_moments(first), _moments(second))
    yield _counted("steps", alone, "of one run alone")
    first, second = first[rows[0]], second[rows[1]]
    names = [
        name for name in first.dtype.names or () if name in (second.dtype.names or ()) and not name.startswith(HOW)
    ]
    for name in names[1:]:
        scale = charge if name == "charge" else _scale(name, first)
        relative, place = _relative(first[name].astype(float), second[name].astype(float), scale)
        yield Difference(name, relative, f"at step {first['step'][place]}" if relative > 0 else "")


def _scale(name: str, table: Table) -> float:
    """Return what means and total momenta, which may vanish, are compared with: sizes, and 2 E/c, below the sum of all |p|."""
    of, _, axis = name.rpartition("_")
    if of == "mean" and axis in AXES:
        values = np.array([table[f"rms_{along}"] for along in AXES])
    elif of == "momentum":
        values = np.array(
            [*(np.abs(table[f"momentum_{along}"]) for along in AXES), 2 * table["kinetic_energy"] / SPEED_OF_LIGHT]
        )
    else:
        return 0.0
    return float(values[np.isfinite(values)].max(initial=0.0))


def _beam(first: Results, second: Results) -> Iterator[Difference]:
    """Compare final moments of the groups of particles."""
    tables = []
    for run in (first, second):
        path = run.folder / "beam.csv"
        if not path.exists():
            raise _Missing
        tables.append(time_series.read(path))
    steps = np.intersect1d(tables[0]["step"], tables[1]["step"])
    if len(steps) == 0:
        raise _Missing
    rows = [{str(row["group"]): row for row in table[table["step"] == steps[-1]]} for table in tables]
    charge = max(map(_charge, (first, second)))
    for group in dict.fromkeys([*rows[0], *rows[1]]):
        if not all(group in of_run for of_run in rows):
            yield Difference(group, math.inf, "in one run alone")
            continue
        for name in FINAL:
            a, b = (np.array([float(of_run[group][name])]) for of_run in rows)
            scale = charge if name == "charge" else 0.0
            yield Difference(f"{name} of {group}", _relative(a, b, scale)[0], f"at step {steps[-1]}")


def _moments(table: Table) -> Table:
    """Return what rows of two runs at the same moment share: the step or, of material points, whose steps differ, the load."""
    return np.round(table["load"], 9) if "load" in (table.dtype.names or ()) else table["step"]


def _latest_common(runs: Sequence[Results], dumps: Sequence[Iterable[int]]) -> list[int]:
    """Return the step, in each run, of the latest moment of which both have a dump."""
    first, second = map(_dumped, runs, dumps)
    if not (common := first.keys() & second.keys()):
        raise _Missing
    return [of_run[max(common)] for of_run in (first, second)]


def _dumped(run: Results, steps: Iterable[int]) -> dict[float, int]:
    """Return the steps of some dumps by their moments."""
    if not run.of_points:
        return {step: step for step in steps}
    table = rows_of(run.folder)
    table = table[np.isin(table["step"], list(steps))]
    return dict(zip(_moments(table).tolist(), table["step"].tolist(), strict=True))


def _fields(first: Results, second: Results, remarks: list[str]) -> Iterator[Difference]:
    """Compare the fields of the latest step that both have: norms of the differences on the mesh of the first run.

    Those of the second are carried to it where meshes differ; where domains do, norms of both are compared.
    """
    step, of_second_run = _latest_common([first, second], [first.fields, second.fields])
    of_first, of_second = first.fields[step], second.fields[of_second_run]
    names = [name for name in of_first if name in of_second]
    if of_first.window != of_second.window:  # fields are compared place by place on the mesh
        way = float(np.abs(of_first.window.shift - of_second.window.shift).max())
        yield Difference("place of the mesh over its size", way / _extent(of_first), f"at step {step}")
        of_first, of_second = of_first.at_rest, of_second.at_rest
    domains = [fields.hierarchy.domain for fields in (of_first, of_second)]
    if (domains[0].lower, domains[0].upper) != (domains[1].lower, domains[1].upper):
        yield Difference("domain", math.inf, f"the fields of step {step} live on two domains; their norms are compared")
        for name in names:
            a, b = _scalar(of_first[name]), _scalar(of_second[name])
            yield from _of_norms(name, step, {kind: abs(a.norm(kind) - b.norm(kind)) for kind in NORMS}, (a, b))
        return
    moved: Mapping[str, Field | VectorField] = of_second.on(of_first.hierarchy)
    if not of_first.hierarchy.same_cells(of_second.hierarchy):
        moved = {name: of_second[name].remap(of_first.hierarchy) for name in names}
        remarks.append(
            f"the meshes of step {step} differ; fields of the second run are carried to the mesh of the first"
        )
    for name in names:
        difference = _apart(of_first[name], moved[name])
        scalars = _scalar(of_first[name]), _scalar(moved[name])
        yield from _of_norms(name, step, {kind: difference.norm(kind) for kind in NORMS}, scalars)


def _extent(fields: DumpedFields) -> float:
    """Return the longest edge of the domain, m."""
    domain = fields.hierarchy.domain
    return float(np.max(np.subtract(domain.upper, domain.lower)))


NORMS = ("l2", "max")


def _of_norms(name: str, step: int, distances: Mapping[str, float], fields: Sequence[Field]) -> Iterator[Difference]:
    """Yield the differences of a field in some norms, over the larger norm of both fields."""
    for kind, difference in distances.items():
        scale = max(field.norm(kind) for field in fields)
        relative = difference / scale if scale > 0 else difference
        yield Difference(f"{name} in the {kind} norm", relative, f"at step {step}")


def _apart(first: Field | VectorField, second: Field | VectorField) -> Field:
    parts = [a - b for a, b in zip(first.parts, second.parts, strict=True)]
    return parts[0] if len(parts) == 1 else VectorField(*parts).magnitude()


def _scalar(field: Field | VectorField) -> Field:
    return field if isinstance(field, Field) else field.magnitude()


def _particles(first: Results, second: Results) -> Iterator[Difference]:
    """Compare the particles of the latest step that both have, by their numbers."""
    if first.of_points or second.of_points:
        raise _Missing
    dumps = [run._dumps(*PARTICLES) for run in (first, second)]
    steps = _latest_common([first, second], dumps)
    dumped, dumped_second = (particle_reader.read(paths[step]) for paths, step in zip(dumps, steps, strict=True))
    of_first, of_second = dumped.particles, dumped_second.particles
    rows, alone = _in_both(of_first.id, of_second.id)
    yield _counted("particles", alone, "of one run alone", f"at step {steps[0]}")
    of_first, of_second = of_first.select(rows[0]), of_second.select(rows[1])
    for quantity in ("position", "momentum"):
        distance = getattr(of_first, quantity) - getattr(of_second, quantity)
        if (
            quantity == "position" and dumped.domain is not None
        ):  # rounding may have taken one of two through a periodic face
            distance = np.stack([nearest(distance[:, d], dumped.domain.period(d)) for d in range(3)], axis=1)
        yield _over_rms(f"{quantity} over its rms", distance, getattr(of_first, quantity), f"at step {steps[0]}")


def _points(first: Results, second: Results) -> Iterator[Difference]:
    """Compare the material points of the latest step that both have, by their numbers."""
    dumps = [run._dumps("points_*.vtkhdf") for run in (first, second)]
    steps = _latest_common([first, second], dumps)
    of_first, of_second = (points_writer.read(paths[step]) for paths, step in zip(dumps, steps, strict=True))
    rows, alone = _in_both(of_first["id"], of_second["id"])
    yield _counted("points", alone, "of one run alone", f"at step {steps[0]}")
    for name in of_first:
        if name in of_second and name != "id":
            a, b = (
                of_run[name][own].astype(float).ravel() for of_run, own in zip((of_first, of_second), rows, strict=True)
            )
            yield Difference(f"{name} of points", _relative(a, b)[0], f"at step {steps[0]}")


def _losses(first: Results, second: Results) -> Iterator[Difference]:
    """Compare the lost particles, by their numbers: which they are, at what, when and where they were lost."""
    paths = [run.folder / LOSSES for run in (first, second)]
    if not all(path.exists() for path in paths):
        raise _Missing
    tables = [_lost(path) for path in paths]
    rows, alone = _in_both(tables[0]["id"], tables[1]["id"])
    yield _counted("lost particles", alone, "of one run alone")
    of_first, of_second = (
        {name: values[own] for name, values in table.items()} for table, own in zip(tables, rows, strict=True)
    )
    elsewhere = int(np.count_nonzero(of_first["cause"] != of_second["cause"]))
    yield _counted("causes of losses", elsewhere, "at something else")
    for quantity in ("time", "position"):
        distance = of_first[quantity] - of_second[quantity]
        yield _over_rms(f"{quantity} of losses over its rms", distance, of_first[quantity])


def _lost(path: Path) -> dict[str, NDArray[Any]]:
    """Return the numbers, causes, times (s) and places (m) of lost particles, of all species."""
    records = list(openpmd_reader.records(path))
    return {
        "id": np.concatenate([record.id for record in records]),
        "cause": np.concatenate([np.asarray(record.cause, dtype=str) for record in records]),
        "time": np.concatenate([record.time for record in records]),
        "position": np.concatenate([record.position for record in records]),
    }


def _in_both(first: Table, second: Table) -> tuple[list[Table], int]:
    """Return the rows, in each run, of the numbers that both have, and how many numbers one of them has alone."""
    _, *rows = np.intersect1d(first, second, return_indices=True)
    return rows, len(first) + len(second) - 2 * len(rows[0])


def _counted(name: str, number: int, how: str, otherwise: str = "") -> Difference:
    """Return a difference of which there must be none at all."""
    return Difference(name, math.inf if number else 0.0, f"{number} {how}" if number else otherwise)


def _over_rms(name: str, distance: Table, values: Table, where: str = "") -> Difference:
    """Return the largest distance, over the rms of the values that it is between unless that is zero."""
    rms = float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
    worst = float(np.abs(distance).max(initial=0.0))
    return Difference(name, worst / rms if rms > 0 else worst, where)


def _speed(first: Table, second: Table) -> Iterator[tuple[str, float, float]]:
    """Yield time of a step after the first, that of the stages, and memory."""

    def mean(table: Table, name: str) -> float:
        return float(table[name][1:].mean() if len(table) > 1 else table[name].mean())

    for name in first.dtype.names or ():
        if name.startswith("seconds") and name in (second.dtype.names or ()):
            yield name, mean(first, name), mean(second, name)
    yield "memory", float(first["memory"].max()), float(second["memory"].max())
