"""One run of a scaling study: steps of a scene on the ranks that there are. `python -m amrpic.scaling.measure` is one."""

from __future__ import annotations

import argparse
import resource
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..failure import Meeting, sentence
from ..mesh.boxes import cells_of
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..parallel import own, together
from ..pic.simulation import Simulation
from ..run.clock import Spent
from ..scene.scene import Scene
from .measured import WAITING, WALLS, MeasuredRun, Stage

UNCOUNTED = 1  # first steps, in which memory is touched for the first time


CLOCKS: Mapping[str, Callable[[], float]] = {"wall": time.perf_counter, "processor": time.process_time}


def measure(
    comm: MPI.Comm,
    scene: Scene,
    steps: int,
    kind: str = "strong",
    name: str = "",
    clock: str = "wall",
    apart: bool = False,
) -> MeasuredRun:
    """Return what so many steps of a run take, after the uncounted first ones, with all that the scene writes. Collective.

    Files go into the scene's folder. What a step writes counts for the next one; what the end writes stands apart. By the clock
    of the "processor" the time in which others use it does not count, nor what a rank waits for another without polling.
    Stages that are kept `apart` begin together on all ranks; what ranks wait for each other then is a stage of its own.
    """
    comm, now = own(comm), CLOCKS[clock]
    run = Simulation(comm, _with_steps(scene, UNCOUNTED + steps))
    run.clock.now = now
    between = Between(run, comm, apart)
    seconds: list[float] = []
    stages: list[dict[str, Stage]] = []
    cycles: list[int] = []
    meshes: list[int] = []
    cells: list[int] = []
    since = now()

    def step_over(of: Simulation) -> None:
        nonlocal since
        duration, made, waiting = now() - since, between.meshes, between.waited()
        if of.step > UNCOUNTED:
            seconds.append(comm.allreduce(duration, op=MPI.MAX))
            walls = of.report.seconds.get("open boundary", 0.0) * _pace(of, clock)
            stages.append(over_ranks(comm, {**_with_walls(_of_motion(of), walls), **waiting}))
            cycles.append(of.report.cycles)
            meshes.append(made)
            cells.append(of.hierarchy.cells())
        comm.Barrier()
        since = now()

    run.on_step(step_over)
    run.run()
    end = comm.allreduce(now() - since, op=MPI.MAX)
    mesh, number = run.hierarchy, len(run.particles)
    total = run.particles.global_count(comm)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0
    return MeasuredRun(
        kind,
        comm.size,
        name,
        cells,
        total,
        cell_imbalance(mesh),
        comm.allreduce(number, op=MPI.MAX) * comm.size / total if total else 1.0,
        _spread(comm, np.array([memory]))[0],
        cycles,
        seconds,
        stages,
        meshes,
        end,
    )


def _with_steps(scene: Scene, steps: int) -> Scene:
    schedule = scene.schedule.model_copy(update={"steps": steps, "solves": None})
    return scene.model_copy(update={"schedule": schedule})


class Between:
    """What happens between the stages of a run: its ranks wait for each other, if stages are to begin together."""

    def __init__(self, run: Simulation, comm: MPI.Comm, together: bool) -> None:
        self._comm, self._clock, self._together = comm, run.clock, together
        self._waited, self._sorted = 0.0, 0
        run.clock.before = self._enter

    def _enter(self, stage: str) -> None:
        self._sorted += stage == "migrate"
        if self._together:
            since = self._clock.now()
            MPI.Intracomm.Barrier(self._comm)  # is not counted among the collective calls of the run
            self._waited += self._clock.now() - since

    @property
    def meshes(self) -> int:
        """New meshes of a step: particles are sorted once anyway, and on each of them."""
        return max(self._sorted - 1, 0)

    def waited(self) -> dict[str, Spent]:
        """Return the time that this rank has waited since the last call, as a stage, and begin a step."""
        seconds, self._waited, self._sorted = self._waited, 0.0, 0
        return {WAITING: Spent(seconds)} if self._together and self._comm.size > 1 else {}


def _pace(of: Simulation, clock: str) -> float:
    """Return the seconds by a clock for each on the wall, over the latest solve."""
    on_wall = sum(of.report.seconds.values())
    return 1.0 if clock == "wall" else min(of.state.spent["solve"].seconds / max(on_wall, 1e-300), 1.0)


def _of_motion(of: Simulation) -> dict[str, Spent]:
    """Return what stages spent; that of a push in fields, which reads these, is the gather's, and of a walk the push's."""
    spent = of.state.spent
    if not of.scene.motion.follows_fields:
        return spent
    return {**spent, "gather": spent["push"], "push": Spent()}


def _with_walls(spent: Mapping[str, Spent], walls: float) -> dict[str, Spent]:
    """Return what stages spent, with the seconds of open walls in the latest solve as a stage of its own; messages stay."""
    if walls == 0 or "solve" not in spent:
        return dict(spent)
    return {**spent, "solve": spent["solve"] - Spent(walls), WALLS: Spent(walls)}


def _spread(comm: MPI.Comm, values: np.ndarray) -> list[tuple[float, float, float]]:
    """Return the least, mean and most of each value over the ranks. Collective."""
    least, total, most = (_reduced(comm, values, op) for op in (MPI.MIN, MPI.SUM, MPI.MAX))
    return list(zip(least.tolist(), (total / comm.size).tolist(), most.tolist(), strict=True))


def _reduced(comm: MPI.Comm, values: np.ndarray, op: MPI.Op) -> np.ndarray:
    out = np.empty_like(values)
    comm.Allreduce(values, out, op=op)
    return out


def over_ranks(comm: MPI.Comm, spent: Mapping[str, Spent]) -> dict[str, Stage]:
    """Return what all ranks spent on the stages of a step. Collective."""
    seconds = _spread(comm, np.array([of.seconds for of in spent.values()]))
    traffic = np.array([list(asdict(of.traffic).values()) for of in spent.values()], dtype=float).reshape(-1, 3)
    busiest = _reduced(comm, traffic, MPI.MAX)
    return {name: Stage(*s, *t) for name, s, t in zip(spent, seconds, busiest.tolist(), strict=True)}


def cells_of_ranks(mesh: Hierarchy) -> np.ndarray:
    """Return the cells of each level on each rank, int64 (levels, ranks)."""
    return np.array(
        [
            np.bincount(mesh.owners(level), cells_of(mesh.boxes(level)), mesh.comm.size).astype(np.int64)
            for level in range(mesh.levels)
        ]
    )


def cell_imbalance(mesh: Hierarchy) -> float:
    """Return Σ_l max ÷ Σ_l mean over ranks of the cells of level l: a cycle visits the levels in turn."""
    cells = cells_of_ranks(mesh)
    return float(cells.max(axis=1).sum() / cells.mean(axis=1).sum())


def main() -> int:
    """Go through one start of a study under mpiexec, and return its exit status. Collective."""
    parser = argparse.ArgumentParser(prog="python -m amrpic.scaling.measure")
    for name in ("output", "scene", "kind", "name"):
        parser.add_argument(name)
    parser.add_argument("steps", type=int)
    parser.add_argument("clock", choices=CLOCKS)
    parser.add_argument("apart", choices=("together", "apart"))
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_args()
    world = MPI.COMM_WORLD
    meeting = Meeting(world)
    folder = Path(options.output).with_suffix(".output")
    try:
        with together(world, InputError):
            scene = Scene.from_toml(options.scene, [*options.overrides, f"output.directory={folder}"])
        measured = measure(
            world, scene, options.steps, options.kind, options.name, options.clock, options.apart == "apart"
        )
        if world.rank == 0:
            measured.write(Path(options.output))
    except Exception as failure:
        return meeting.report(failure, sentence(failure))
    finally:
        if world.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
