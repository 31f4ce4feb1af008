"""amrpic verify: speed against error of a scene."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import InputError, OutputError
from ..mpi import MPI
from ..parallel import together
from ..scene.scene import Scene
from .arguments import Commands, command


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    verify = command(
        commands,
        "verify",
        _verify,
        "measure speed against error of a scene, over meshes, tolerances, box sizes and guesses, in both orders if its own is "
        "4; under mpiexec on many ranks",
        "measuring",
    )
    verify.add_argument("scenes", nargs="+", metavar="SCENE", help="a TOML file; several if repeated")
    verify.add_argument("--quick", action="store_true", help="try fewer settings")
    verify.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a value of these scenes"
    )
    verify.add_argument(
        "--output", metavar="DIR", help="write verification.md and its pictures there, beside other tables"
    )


def _verify(chosen: argparse.Namespace) -> int:
    from ..verify import pareto, write  # no other command needs its imports

    comm, measured = MPI.COMM_WORLD, []
    with together(comm, InputError):
        scenes = [Scene.from_toml(path, chosen.set) for path in chosen.scenes]
    for scene in scenes:
        for table in pareto.tables(comm, scene, chosen.quick):
            measured.append(table)
            if comm.rank == 0:
                print(f"{table.title}\n{table.markdown()}\n", flush=True)
    with together(comm, OutputError):
        if comm.rank == 0 and chosen.output is not None:
            write(measured, Path(chosen.output))
    missed = [table.title for table in measured if not table.met]
    if comm.rank == 0:
        print("all goals are met" if not missed else f"goals are missed in {'; '.join(missed)}")
    return 0 if not missed else 1
