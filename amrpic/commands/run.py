"""amrpic run: a scene from its start, or from a checkpoint."""

from __future__ import annotations

import argparse
from typing import Any

from ..errors import InputError
from ..io.checkpoint import UnreadableCheckpoint
from ..io.checkpoint_folder import candidates
from ..io.run_status import start_failed
from ..mpi import MPI
from ..parallel import together
from ..run.folder import prepare
from ..run.life import Run
from ..run.log import RunLog
from ..scene.any_scene import AnyScene
from ..scene.units import to_seconds
from .arguments import Commands, command, scene_arguments, scene_on_all_ranks
from .methods import simulation_of

STOPPED = 75  # "try again later": stopped by a signal or the clock after a checkpoint, to be resubmitted


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    run = command(commands, "run", _run, "run a scene; under mpiexec on many ranks", "at work on the run")
    scene_arguments(run)
    run.add_argument("--output", metavar="DIR", help="where to write; default runs/<scene>")
    run.add_argument(
        "--restart", metavar="auto|PATH", help="go on from a checkpoint; auto: the newest valid one, if any"
    )
    run.add_argument(
        "--walltime", metavar="TIME", help='stop with a checkpoint before so much time has passed: "01:30:00", "90 min"'
    )


def _run(chosen: argparse.Namespace) -> int:
    comm = MPI.COMM_WORLD
    scene = scene_on_all_ranks(comm, chosen)
    with together(comm, InputError):
        walltime = None if chosen.walltime is None else to_seconds(chosen.walltime)
        if walltime is not None and walltime <= 0:
            raise InputError(f"--walltime {chosen.walltime} leaves no time; give more than 0 s")
    prepare(comm, scene)
    try:
        simulation = _begin(comm, scene, chosen.restart)
    except Exception as failure:
        start_failed(comm, scene, failure)
        raise
    return 0 if simulation.run(walltime).stopped is None else STOPPED


def _begin(comm: MPI.Comm, scene: AnyScene, restart: str | None) -> Run[Any]:
    """Return the run at its start or at a checkpoint, with "auto" the newest one that is whole; rank 0 warns of others."""
    if restart is not None and restart != "auto":
        return simulation_of(comm, scene, restart)
    for path in candidates(comm, scene.directory) if restart else ():
        try:
            return simulation_of(comm, scene, path)
        except UnreadableCheckpoint as error:
            RunLog(comm, scene.schedule.last_step).warn(str(error))
    return simulation_of(comm, scene)
