"""How long a run will take, from a trial of it: of the run itself for some seconds, or of coarser ones that it follows from."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from statistics import median

from ..errors import AmrpicError, OutputError
from ..mpi import MPI
from ..parallel import own, together
from ..scene.bunches import LatticeBunch, Train
from ..scene.run_sections import Output
from ..scene.scene import Scene
from .particle_recorder import ParticleRecorder
from .simulation import Simulation

FOLDER = ".trial"
COARSER = tuple(2**power for power in range(10, -1, -1))  # how many times as wide base cells of trials are
FEWEST_CELLS = 8  # of a trial along an axis, if the scene has as many
SHARE = 0.05  # of the time, for a trial of a coarser one
STARTS = 3  # of a run of one solve, at most
MARGIN = 1.3  # what comes next may take so much longer than expected
DUMPS = {"checkpoint": "checkpoint_every", "fields": "fields_every", "particles": "particles_every"}


@dataclass(frozen=True)
class Trial:
    """What parts of a run take, s."""

    beam: float  # the particles
    start: float  # mesh and first solve
    step: float  # without regrid, 0 for a run of one solve
    regrid: float  # what a step with regrid takes besides
    dump: float  # a checkpoint
    first: float = 0.0  # what the first step takes besides: its memory and caches are new

    @property
    def total(self) -> float:
        """What a trial takes, of two steps at least."""
        return self.beam + self.start + self.first + 2 * self.step + self.regrid + self.dump

    def per_step(self, scene: Scene) -> float:
        """Return the mean time of a step of a scene, with its regrids and dumps."""
        steps = scene.schedule.last_step
        regrids = _times(steps, scene.refinement.regrid_every) if scene.refinement.follows else 0
        dumps = sum(
            _times(steps, getattr(scene.output, key)) for kind, key in DUMPS.items() if kind in scene.output.write
        )
        return self.step + (self.first + regrids * self.regrid + dumps * self.dump) / max(steps, 1)


def _times(steps: int, stride: int) -> int:
    """Return how often so many steps do what comes every so many of them; 0: never."""
    return steps // stride if stride else 0


@dataclass(frozen=True)
class Forecast:
    """How long a run will take on the ranks that made the forecast, s."""

    start: float  # until the first solve is done
    step: float  # the mean of all steps after it
    source: str  # what it follows from


def forecast(comm: MPI.Comm, scene: Scene, cells: int, making: float, seconds: float = 5.0) -> Forecast | None:
    """Return how long a run will take, from trials of about so many seconds; None if there is no time for any.

    The scene itself is tried if that is short enough, after coarser ones with fewer particles that show how long it will be;
    else the time follows from the last two of these, linearly in the number of cells. `cells` are those of all levels. `making`
    are the seconds that its particles took when this process first made them: a run loads modules and tabulates
    distributions then, which trials find done. The mesh is that of the start: its growth is not foreseen. Collective; raises
    what the run may raise, and OutputError.
    """
    comm, end = own(comm), time.perf_counter() + seconds
    tried: list[tuple[float, Trial]] = []  # with the cells of each
    for factor in COARSER if seconds > 0 else ():
        coarser = _coarser(scene, factor)
        if factor > 1 and coarser.domain.cells == _coarser(scene, factor // 2).domain.cells:
            continue
        if tried and not _in_time(comm, _expected(tried, _between(tried[-1][0], cells, factor)), end):
            break
        try:
            trial, cells_tried, steps = _tried(
                comm, coarser, end if factor == 1 else time.perf_counter() + seconds * SHARE
            )
        except AmrpicError:
            if factor == 1:
                raise
            continue  # boxes by their cells, for instance, do not fit a coarser mesh
        if factor == 1:
            return Forecast(
                making + trial.start, trial.per_step(scene), f"{steps} steps of it" if steps else "its first solve"
            )
        tried.append((cells_tried, trial))
    if not tried:
        return None
    trial_of_whole, share = _extrapolated(tried[-2:], cells), f"{tried[-1][0] / cells:.2g} of its cells"
    source = f"runs on up to {share}" if len(tried) > 1 else f"one run on {share}, in proportion: rather too long"
    return Forecast(making + trial_of_whole.start, trial_of_whole.per_step(scene), source)


def _expected(tried: list[tuple[float, Trial]], cells: float) -> float:
    """Return about how long a trial of so many cells takes: after one alone, much of whose time is for no cell, by the root."""
    if len(tried) > 1:
        return _extrapolated(tried[-2:], cells).total
    cells_tried, trial = tried[0]
    return trial.total * math.sqrt(cells / cells_tried)


def _between(tried: float, cells: float, factor: int) -> float:
    """Return about how many cells a trial has, given those of one on twice as wide base cells, and of the scene."""
    return float(tried * (cells / tried) ** (1 / math.log2(2 * factor)))


def _in_time(comm: MPI.Comm, expected: float, end: float) -> bool:
    """Return whether what is expected to take so long, s, is done before the end. Collective."""
    return comm.bcast(time.perf_counter() + MARGIN * expected < end)


def _coarser(scene: Scene, factor: int) -> Scene:
    """Return a scene on so many times as wide base cells, with fewer particles in proportion."""
    cells = tuple(max(number // factor, min(number, FEWEST_CELLS)) for number in scene.domain.cells)
    share = math.prod(cells) / math.prod(scene.domain.cells)
    bunches = []
    for bunch in scene.bunches:
        if isinstance(bunch, Train):
            bunch = bunch.model_copy(update={"particles": math.ceil(bunch.particles * share)})
        elif isinstance(bunch, LatticeBunch):
            bunch = bunch.model_copy(update={"per_axis": tuple(max(n // factor, 1) for n in bunch.per_axis)})
        bunches.append(bunch)
    return scene.model_copy(update={"domain": scene.domain.model_copy(update={"cells": cells}), "bunches": bunches})


def _tried(comm: MPI.Comm, scene: Scene, end: float) -> tuple[Trial, int, int]:
    """Return what a run takes that goes on until `end`, its cells and its steps: at least two, and one that regrids."""
    with _folder(comm, scene.directory / FOLDER) as folder:
        output = Output(directory=str(folder), write=[kind for kind in scene.output.write if kind == "series"])
        simulation, beam, start = _started(comm, scene.model_copy(update={"output": output}), end)
        setup = simulation._setup
        steps_taken: list[tuple[bool, float]] = []  # whether a step regrids, and its s
        begun = time.perf_counter()
        with ParticleRecorder(simulation.state, setup, False, log="silent") as record:
            record.state(simulation.state)
            start += time.perf_counter() - begun
            while simulation.step < scene.schedule.last_step:
                if len(steps_taken) > 1 and not _in_time(comm, steps_taken[-1][1], end):
                    regrids = any(regrids for regrids, _ in steps_taken)
                    if regrids or not scene.refinement.follows or setup.scene.refinement.regrid_every == 0:
                        break
                    # none came up to now: the next step makes one
                    refinement = setup.scene.refinement.model_copy(update={"regrid_every": 1})
                    simulation._setup = setup = replace(
                        setup, scene=setup.scene.model_copy(update={"refinement": refinement})
                    )
                begun = time.perf_counter()
                simulation.advance()
                record.state(simulation.state)
                regrids = setup.scene.refinement.regrids_at(simulation.step)
                steps_taken.append((regrids, time.perf_counter() - begun))
        begun = time.perf_counter()
        simulation.checkpoint(folder / "checkpoint")
        dump = time.perf_counter() - begun
        cells = simulation.hierarchy.cells()
    return Trial(beam, start, dump=dump, **_parts(steps_taken)), cells, simulation.step


def _parts(steps_taken: Sequence[tuple[bool, float]]) -> dict[str, float]:
    """Return `step`, `regrid` and `first` of a trial from whether each of its steps regrids and how long it took, s."""
    plain, regrids = (
        [seconds for regridded, seconds in steps_taken[1:] if regridded is kind] for kind in (False, True)
    )
    step = _mean(plain or regrids or [seconds for _, seconds in steps_taken] or [0.0])
    regrid = max(_mean(regrids) - step, 0.0) if regrids else 0.0
    first = max(steps_taken[0][1] - step - regrid * steps_taken[0][0], 0.0) if steps_taken else 0.0
    return {"step": step, "regrid": regrid, "first": first}


def _started(comm: MPI.Comm, scene: Scene, end: float) -> tuple[Simulation, float, float]:
    """Return a run before its first step, and what its particles and what came after them took, s. Collective.

    A run of one solve is that alone, so it is started a few times if `end` leaves time, for the median.
    """
    times: list[tuple[float, float]] = []
    for _ in range(1 if scene.schedule.last_step else STARTS):
        if times and not _in_time(comm, sum(times[-1]), end):
            break
        simulation = None  # its memory goes before the next one comes
        begun = time.perf_counter()
        simulation = Simulation(comm, scene)
        whole, beam = time.perf_counter() - begun, simulation.state.seconds["beam"]
        times.append((beam, whole - beam))
    assert simulation is not None
    beam, start = (median(parts) for parts in zip(*times, strict=True))
    return simulation, beam, start


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)


@contextmanager
def _folder(comm: MPI.Comm, folder: Path) -> Iterator[Path]:
    """Make an empty folder for a while. Collective; OutputError on all ranks."""
    with together(comm, OutputError):
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)


def _extrapolated(tried: list[tuple[float, Trial]], cells: float) -> Trial:
    """Return what a run of so many cells takes, linearly in their number; in proportion to it if one smaller run is known."""
    (cells_of_last, last), (before, first) = tried[-1], tried[0]
    values = {}
    for part in fields(Trial):
        in_first, in_last = getattr(first, part.name), getattr(last, part.name)
        slope = (in_last - in_first) / (cells_of_last - before) if cells_of_last > before else in_last / cells_of_last
        values[part.name] = in_last + max(slope, 0.0) * (cells - cells_of_last)
    return Trial(**values)
