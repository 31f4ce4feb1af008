"""What compensated clouds take of a step: `python benchmarks compensation`, on one rank.

The step is one of leapfrog with the bunches and the mesh of examples/three_bunches.toml, from the same state each time. The
choices take turns. The least of the turns counts, since what disturbs a run can only make it longer.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Annotated, get_args

from mpi4py import MPI

from amrpic.particles.clouds import SHAPES, CompensationKind, Shape
from amrpic.pic.state import State
from amrpic.pic.step import advance, begin
from amrpic.scene.scene import Scene
from measuring import CPU_TIME, ROOT, Record, timed

KINDS: tuple[CompensationKind, ...] = get_args(CompensationKind)
CELLS = 144  # of the base along an axis, as in the example
DT = 1e-13  # s


def name(kind: CompensationKind, shape: Shape, particles: int) -> str:
    return f"step, {shape}, {particles:.0e} particles a bunch, compensation {kind}"


def scene(kind: CompensationKind, shape: Shape, particles: int, cells: int = CELLS) -> Scene:
    content = Scene.from_toml(ROOT / "examples" / "three_bunches.toml").model_dump()
    for bunch in content["bunches"]:
        bunch["particles"] = particles
    content["domain"]["cells"] = cells
    content["particles"] |= {"shape": shape, "compensation": kind}
    content["motion"] = {"kind": "leapfrog", "dt": DT}
    content["output"]["write"] = []
    return Scene.model_validate(content)


def steps(shape: Shape, particles: int, runs: int, cells: int = CELLS) -> Iterator[Record]:
    """Yield the CPU seconds of a step with each choice; the least wall seconds of each stage are in the facts."""
    begun = [begin(MPI.COMM_SELF, scene(kind, shape, particles, cells)) for kind in KINDS]
    setups, states = (
        [setup for _, setup in begun],
        [advance(*pair) for pair in begun],
    )  # the first step makes what lasts
    seconds: list[list[float]] = [[] for _ in KINDS]
    stages: list[list[dict[str, float]]] = [[] for _ in KINDS]
    for _ in range(runs):
        for n, (setup, state) in enumerate(zip(setups, states, strict=True)):
            work: partial[State] = partial(advance, state, setup)
            taken, after = timed(MPI.COMM_SELF, 1, work, CPU_TIME)
            seconds[n] += taken
            stages[n].append(after.seconds)
    for kind, taken, spent in zip(KINDS, seconds, stages, strict=True):
        least = {stage: min(each[stage] for each in spent) for stage in spent[0]}
        yield Record(name(kind, shape, particles), taken, particles=particles, facts={"stages": least})


def told(shape: Shape, particles: int, runs: int) -> list[Record]:
    """Return `steps`, after a line for each."""
    found = list(steps(shape, particles, runs))
    for record in found:
        least = min(record.seconds)
        spent = ", ".join(f"{stage} {1e3 * seconds:.1f}" for stage, seconds in record.facts["stages"].items())
        print(
            f"{record.name}: {1e3 * least:.1f} ms, {least / min(found[0].seconds):.3f} of none's; {spent}", flush=True
        )
    return found


def run(
    runs: Annotated[int, "turns of each"] = 9,
    particles: Annotated[float, "of each of the three bunches"] = 1e6,
    shape: Annotated[tuple[Shape, ...], "of clouds", SHAPES] = ("cloud-in-cell", "triangular-shaped-cloud"),
) -> Iterator[Record]:
    """Steps with each kind of compensation, and a line for each."""
    for one in shape:
        yield from told(one, int(particles), runs)
