"""amrpic verify: accuracy against exact answers."""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

from ..errors import InputError, OutputError
from ..parallel import together
from ..scene.scene import Scene
from .arguments import Commands, command


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    verify = command(
        commands, "verify", _verify, "measure accuracy against exact answers; under mpiexec on many ranks", "measuring"
    )
    verify.add_argument("topics", nargs="*", metavar="TOPIC", help="such as convergence; default all of them")
    verify.add_argument(
        "--pareto",
        metavar="SCENE",
        action="append",
        default=[],
        help="speed against error of a scene, over meshes, tolerances, box sizes and guesses, in both orders if its own is 4; "
        "several if repeated, with TOPIC only if named too",
    )
    verify.add_argument(
        "--quick",
        action="store_true",
        help="try fewer settings of each scene, and fewer cases of operators, materials and mpm",
    )
    verify.add_argument(
        "--long", action="store_true", help="make comparisons in full that are shortened otherwise; hours, not minutes"
    )
    verify.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a value of these scenes"
    )
    verify.add_argument("--backend", metavar="NAME", help="of the solver; default that of the package")
    verify.add_argument(
        "--output",
        metavar="DIR",
        help="write verification.md and its pictures there; single topics leave the rest of it",
    )


def _verify(chosen: argparse.Namespace) -> int:
    from ..verify import verify, write  # no other command needs its imports

    comm, found = MPI.COMM_WORLD, []
    with together(comm, InputError):
        scenes = [Scene.from_toml(path, chosen.set) for path in chosen.pareto]
    tables = verify(comm, chosen.topics, scenes, quick=chosen.quick, backend=chosen.backend, long=chosen.long)
    for topic, table in tables:
        found.append((topic, table))
        if comm.rank == 0:
            print(f"{table.title} ({topic})\n{table.markdown()}\n", flush=True)
    with together(comm, OutputError):
        if comm.rank == 0 and chosen.output is not None:
            write(found, Path(chosen.output), afresh=not chosen.topics and not chosen.pareto)
    missed = [f"{topic}: {table.title}" for topic, table in found if not table.met]
    if comm.rank == 0:
        print("all goals are met" if not missed else f"goals are missed in {'; '.join(missed)}")
    return 0 if not missed else 1
