"""What runs on some ranks measured, as files, and medians of them."""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..errors import InputError, OutputError

OUTPUT = "output"  # the stage of series, diagnostics and dumps in the course of a run
WALLS = "open walls"  # the part of a solve that finds the potential at them
WAITING = "waiting"  # for other ranks, between the stages, where these begin together
NEW_MESH = "new mesh"  # what a step takes more for each new mesh: to make it, and to sort and deposit particles on it
NEW_SOLVER = "new solver"  # what it takes more in other stages, once: the last mesh is solved on for the first time
OF_MESH = "regrid", "migrate", "deposit"
END = "end"  # what a run writes at its end; not part of a step


@dataclass(frozen=True)
class Stage:
    """What a stage of one step took: seconds of the fastest rank, of ranks on average and of the slowest; the rest is of the
    busiest rank."""

    least: float
    mean: float
    most: float
    messages: float = 0
    bytes: float = 0
    collectives: float = 0


NOTHING = Stage(0, 0, 0)


@dataclass(frozen=True)
class MeasuredRun:
    """What one start of a scene on so many ranks measured."""

    kind: str  # strong or weak
    ranks: int
    scene: str  # what the scene is known by: see `study.name_of`
    cells: list[int]  # of all levels, at the end of each step
    particles: int
    cell_imbalance: float  # Σ_l max ÷ Σ_l mean over ranks of the cells of level l: levels are visited in turn
    particle_imbalance: float  # max ÷ mean over ranks
    memory: tuple[float, float, float]  # bytes of a rank at its fullest: least, mean, most
    cycles: list[int]  # of the solves of each step
    seconds: list[float]  # of each step, of the slowest rank
    steps: list[dict[str, Stage]]
    meshes: list[int]  # new ones of each step
    end: float  # s, what is written at the end

    def write(self, path: Path) -> None:
        """Write the run as JSON. Raises OutputError."""
        try:
            path.write_text(json.dumps(asdict(self), indent=1), encoding="utf-8")
        except OSError as reason:
            raise OutputError(f"cannot write {path}: {reason.strerror}; choose another --output") from None

    @classmethod
    def read(cls, path: Path) -> Self:
        """Return a run that was written. Raises InputError if it is none."""
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            values["steps"] = [{name: Stage(**of) for name, of in step.items()} for step in values["steps"]]
            values["memory"] = tuple(values["memory"])
            if isinstance(values["cells"], int):  # runs of earlier versions kept those of the last step alone
                values["cells"] = [values["cells"]] * len(values["steps"])
            return cls(**values)
        except (OSError, ValueError, TypeError, KeyError) as reason:
            raise InputError(f"{path} is no run of a scaling study ({reason}); remove it") from None


@dataclass(frozen=True)
class Measured:
    """All runs of a kind on so many ranks: medians over their steps, stages over those that left the mesh as it was."""

    kind: str
    ranks: int
    cells: int
    particles: int
    cell_imbalance: float
    particle_imbalance: float
    memory: tuple[float, float, float]
    runs: int
    steps: int  # of all runs, over which medians are taken
    cycles: float
    seconds: float  # of a step
    stages: dict[str, Stage]
    meshes: float  # new ones of a step, on average
    of_solves: list[int]  # cycles of the solves from which the stages come
    remade: float  # the part of the steps that made new meshes
    new_cells: int  # of new meshes

    @property
    def work(self) -> float:
        """Cells and particles of a rank."""
        return (self.cells + self.particles) / self.ranks

    @classmethod
    def of(cls, runs: Sequence[MeasuredRun]) -> Self:
        """Return the medians of runs of one kind and number of ranks."""
        first = runs[0]
        all_ = [of_step for run in runs for of_step in zip(run.steps, run.cycles, run.meshes, run.cells, strict=True)]
        changed = [of_step for of_step in all_ if of_step[2]]
        steps = [of_step for of_step in all_ if not of_step[2]] or all_
        names = dict.fromkeys(name for step, *_ in all_ for name in step)
        stages = {name: _median(step.get(name, NOTHING) for step, *_ in steps) for name in names}
        if len(steps) < len(all_):
            usual, other_stages = dict(stages), names.keys() - {*OF_MESH, WAITING}
            stages[NEW_MESH] = _more([(step, meshes) for step, _, meshes, _ in changed], usual, OF_MESH)
            stages[NEW_SOLVER] = _more([(step, 1) for step, *_ in changed], usual, other_stages)
        ends = [run.end for run in runs]
        stages[END] = Stage(min(ends), statistics.fmean(ends), statistics.median(ends))
        return cls(
            first.kind,
            first.ranks,
            round(statistics.median(cells for *_, cells in steps)),
            first.particles,
            first.cell_imbalance,
            first.particle_imbalance,
            _each(max, [run.memory for run in runs]),
            len(runs),
            len(all_),
            statistics.median(cycles for run in runs for cycles in run.cycles),
            statistics.median(seconds for run in runs for seconds in run.seconds),
            stages,
            statistics.fmean(meshes for _, _, meshes, _ in all_),
            [cycles for _, cycles, *_ in steps],
            len(changed) / len(all_),
            round(statistics.median(cells for *_, cells in changed or steps)),
        )


def _median(stages: Iterable[Stage]) -> Stage:
    return Stage(*_each(statistics.median, [tuple(asdict(stage).values()) for stage in stages]))


def _more(steps: Sequence[tuple[dict[str, Stage], int]], usual: dict[str, Stage], names: Iterable[str]) -> Stage:
    """Return the median of what steps take more than usual in the named stages together, for each of as many times."""

    def total(step: dict[str, Stage]) -> Any:
        return np.array([astuple(step.get(name, NOTHING)) for name in names], dtype=float).sum(axis=0)

    extra = [(total(step) - total(usual)) / times for step, times in steps]
    return Stage(*np.maximum(np.median(extra, axis=0), 0.0).tolist())


def _each(function: Callable[[Any], float], rows: Sequence[Sequence[float]]) -> tuple[Any, ...]:
    return tuple(float(function(column)) for column in zip(*rows, strict=True))


def medians(runs: Iterable[MeasuredRun]) -> list[Measured]:
    """Return the medians of runs by kind and number of ranks, fewest ranks first."""
    groups: dict[tuple[str, int], list[MeasuredRun]] = {}
    for run in runs:
        groups.setdefault((run.kind, run.ranks), []).append(run)
    return [Measured.of(groups[key]) for key in sorted(groups)]


def by_kind(runs: Sequence[Measured]) -> dict[str, list[Measured]]:
    """Return the numbers of ranks of each kind, fewest first."""
    kinds = dict.fromkeys(measured.kind for measured in runs)
    return {kind: sorted((o for o in runs if o.kind == kind), key=lambda measured: measured.ranks) for kind in kinds}


def efficiency(first: Measured, second: Measured, stage: str | None = None) -> float:
    """Return the part of a rank's speed that is left of that with fewest ranks: cells and particles per second of a step, or of
    one of its stages (by its slowest rank); nan where a stage takes no time."""
    before, after = (run.seconds if stage is None else run.stages[stage].most for run in (first, second))
    return (second.work / after) / (first.work / before) if before > 0 and after > 0 else float("nan")
