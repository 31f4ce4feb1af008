"""Compare what `amrpic preview` foresees with what runs take: `mpiexec -n 2 python benchmarks/forecasts.py [SCENE ...]`.

Each scene is forecast in five seconds, as the preview does, and then run to its end. Without a scene all examples are taken.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from goals import Goal
from measuring import ROOT
from mpi4py import MPI

import amrpic
from amrpic.commands.text_table import columns
from amrpic.run.forecast import forecast

TRIED = 5.0  # s of trials, as the preview takes by default
FACTOR = 1.5  # by which a forecast may be off


@dataclass(frozen=True)
class Compared:
    """Seconds of a scene as foreseen and as its run took: (to the first solve, of the mean step); files at the end apart."""

    scene: str
    steps: int
    source: str
    foreseen: tuple[float, float]
    taken: tuple[float, float]
    end: float

    @property
    def ratios(self) -> tuple[float, float]:
        """Foreseen over taken; nan for the steps of a run of one solve."""
        start, step = (own / run if run else math.nan for own, run in zip(self.foreseen, self.taken, strict=True))
        return start, step

    @property
    def factor(self) -> float:
        """By how much the seconds per step, or those of the only solve, are off, at least 1."""
        ratio = self.ratios[1 if self.steps else 0]
        return max(ratio, 1 / ratio)


def compare(comm: MPI.Comm, path: Path) -> Compared:
    """Forecast a scene and run it. Collective."""
    scene = amrpic.Scene.from_toml(path)
    folder = comm.bcast(tempfile.mkdtemp(prefix="amrpic-") if comm.rank == 0 else None)
    scene = scene.model_copy(update={"output": scene.output.model_copy(update={"directory": folder})})
    preview = amrpic.Simulation(comm, scene)
    cells = sum(preview.hierarchy.cells(level) for level in range(preview.hierarchy.levels))
    del preview
    found = forecast(comm, scene, cells, TRIED)
    assert found is not None
    comm.Barrier()
    begun = time.perf_counter()
    simulation = amrpic.Simulation(comm, scene)
    comm.Barrier()
    started = time.perf_counter()
    run = simulation.run(log="silent")
    comm.Barrier()
    steps = scene.schedule.last_step
    step = float(run.series["seconds"][1:].mean()) if steps else 0.0
    end = time.perf_counter() - started - steps * step
    return Compared(path.stem, steps, found.source, (found.start, found.step), (started - begun, step), end)


def rows(found: Sequence[Compared]) -> list[tuple[str, ...]]:
    """Return the comparison as rows of a table."""
    out: list[tuple[str, ...]] = [
        ("scene", "start s", "foreseen", "ratio", "step ms", "foreseen", "ratio", "end s", "from")
    ]
    for one in found:
        (start, step), (first, then) = one.taken, one.foreseen
        ratios = one.ratios
        steps = (f"{1e3 * step:.3g}", f"{1e3 * then:.3g}", f"{ratios[1]:.2f}") if one.steps else ("", "", "")
        out.append(
            (one.scene, f"{start:.3g}", f"{first:.3g}", f"{ratios[0]:.2f}", *steps, f"{one.end:.3g}", one.source)
        )
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", type=Path, help="scene files; default all examples")
    given = parser.parse_args()
    comm = MPI.COMM_WORLD
    found = [compare(comm, path) for path in given.scenes or sorted((ROOT / "examples").glob("*.toml"))]
    if comm.rank:
        return
    print(*columns(rows(found)), sep="\n")
    for one in found:
        goal = Goal(one.scene, one.factor, FACTOR)
        print(f"{goal.what}: off by a factor of {goal.measured:.3g}, {goal.bound(goal.must)}: {goal.verdict}")


if __name__ == "__main__":
    main()
