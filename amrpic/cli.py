"""The command line: arguments in, calls out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from mpi4py import MPI

    from .scene import Scene

STOPPED = 75  # "try again later": stopped by a signal or the clock after a checkpoint, to be resubmitted


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command that the arguments name and exit with its status. Collective under mpiexec."""
    from .failure import Meeting

    meeting, show_traceback = Meeting(), False
    try:
        chosen = parser().parse_args(arguments)
        show_traceback = chosen.traceback
        status = chosen.command(chosen)
    except (Exception, KeyboardInterrupt) as failure:
        status = meeting.told(failure, show_traceback)
    sys.exit(status)


class Parser(argparse.ArgumentParser):
    """One whose complaints are told like all others: once, not by every rank."""

    def error(self, message: str) -> NoReturn:
        from .errors import InputError

        raise InputError(f"{message}; see {self.prog} --help")


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = Parser(prog="amrpic", description="Self-fields of charged-particle bunches on adaptive meshes.")
    commands = top.add_subparsers(required=True, metavar="COMMAND")

    run = _command(commands, "run", _run, "run a scene; under mpiexec on many ranks")
    _scene_arguments(run)
    run.add_argument("--output", metavar="DIR", help="where to write; default runs/<scene>")
    run.add_argument(
        "--restart", metavar="auto|PATH", help="go on from a checkpoint; auto: the newest valid one, if any"
    )
    run.add_argument(
        "--walltime", metavar="TIME", help='stop with a checkpoint before so much time has passed: "01:30:00", "90 min"'
    )
    check = _command(commands, "check", _check, "tell whether a scene can run, without running it")
    _scene_arguments(check)
    check.add_argument("--ranks", type=_count, default=1, metavar="N", help="number of ranks it is meant for")
    check.add_argument("--resolved", action="store_true", help="print the scene with all defaults filled in, as TOML")

    preview = _command(
        commands, "preview", _preview, "show mesh, bunches, memory and pictures of a scene, without a solve"
    )
    _scene_arguments(preview)
    preview.add_argument("--ranks", type=_count, metavar="N", help="ranks of the run; default those of the preview")
    preview.add_argument("--output", metavar="DIR", help="where to put the pictures; default runs/<scene>")

    plot = _command(commands, "plot", _plot, "draw pictures of a run that was written")
    plot.add_argument("path", metavar="PATH", help="directory of a run, a fields file or a checkpoint")
    plot.add_argument(
        "--quantity",
        metavar="NAME",
        action="append",
        help="phi, rho, |E|, Ex, Ey or Ez, several if repeated; default an overview in four pictures",
    )
    plot.add_argument(
        "--kind", choices=("slice", "projection", "line"), help="of pictures; default slice of a quantity"
    )
    plot.add_argument(
        "--axis",
        choices=tuple("xyz"),
        help="normal of slices, direction of the rest; default z, lines follow the charge",
    )
    plot.add_argument(
        "--position", metavar="LENGTH", help='of slices along it, m or such as "2.5 mm"; default through the charge'
    )
    plot.add_argument(
        "--level", type=int, metavar="N", help="show this level alone; default the finest cells everywhere"
    )
    plot.add_argument("--scale", choices=("auto", "linear", "symmetric", "log"), help="of the colours; default auto")
    plot.add_argument(
        "--no-boxes", dest="boxes", action="store_const", const=False, help="leave out the outlines of boxes"
    )
    plot.add_argument("--output", metavar="DIR", help="where to put the pictures; default beside what they show")

    schema = _command(commands, "schema", _schema, "print what a scene may hold, as a JSON schema for editors")
    schema.add_argument("--markdown", action="store_true", help="as a reference for people, in Markdown")
    schema.add_argument("--output", metavar="FILE", help="write it into a file")

    verify = _command(
        commands, "verify", _verify, "measure accuracy against exact answers; under mpiexec on many ranks"
    )
    verify.add_argument("topics", nargs="*", metavar="TOPIC", help="such as convergence; default all of them")
    verify.add_argument(
        "--pareto",
        metavar="SCENE",
        action="append",
        default=[],
        help="speed against error of a scene, over meshes, tolerances, box sizes and guesses; several if repeated, with TOPIC "
        "only if named too",
    )
    verify.add_argument("--quick", action="store_true", help="try fewer settings of each scene")
    verify.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a value of these scenes"
    )
    verify.add_argument("--backend", metavar="NAME", help="of the solver; default that of the package")
    verify.add_argument(
        "--output",
        metavar="DIR",
        help="write verification.md and its pictures there; single topics leave the rest of it",
    )

    scaling = _command(
        commands, "scaling", _scaling, "measure how steps of a scene speed up with ranks, which it starts"
    )
    _scene_arguments(scaling)
    scaling.add_argument("--ranks", type=_count, nargs="+", default=[1, 2], metavar="N", help="numbers of ranks")
    scaling.add_argument(
        "--kind",
        choices=("strong", "weak"),
        help="strong: the same scene on all; weak: cells and particles grow with the ranks; default both",
    )
    scaling.add_argument("--steps", type=_count, default=5, metavar="N", help="steps of a run; medians are told")
    scaling.add_argument(
        "--launcher",
        default="mpiexec -n {ranks}",
        metavar="COMMAND",
        help='what starts the ranks, such as "srun -n {ranks}"',
    )
    scaling.add_argument("--output", metavar="DIR", help="where to write; default runs/<scene>")

    _command(commands, "doctor", _doctor, "check this machine and tell how to mend what is wrong")
    return top


def _command(commands: argparse._SubParsersAction, name: str, call: object, help: str) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = commands.add_parser(name, help=help, description=help)
    command.set_defaults(command=call)
    command.add_argument("--traceback", action="store_true", help="show where in the code an error comes from")
    return command


def _count(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is not positive; give at least 1")
    return number


def _scene_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("scene", metavar="SCENE", help="a scene file in TOML")
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a value, such as solver.tolerance=1e-8",
    )


def _scene(chosen: argparse.Namespace) -> Scene:
    from .scene import Scene

    scene = Scene.from_toml(chosen.scene, chosen.set)
    if getattr(chosen, "output", None) is None:
        return scene
    return scene.model_copy(update={"output": scene.output.model_copy(update={"directory": chosen.output})})


def _run(chosen: argparse.Namespace) -> int:
    from mpi4py import MPI

    from .errors import InputError
    from .parallel import together
    from .record import prepare
    from .simulation import Simulation
    from .units import to_seconds

    comm = MPI.COMM_WORLD
    with together(comm, InputError):
        scene = _scene(chosen)
        walltime = None if chosen.walltime is None else to_seconds(chosen.walltime)
    prepare(comm, scene)
    path = _checkpoint(comm, scene, chosen.restart)
    simulation = Simulation(comm, scene) if path is None else Simulation.restart(comm, path, scene)
    return 0 if simulation.run(walltime) is None else STOPPED


def _checkpoint(comm: MPI.Comm, scene: Scene, restart: str | None) -> Path | None:
    """Return the checkpoint to go on from."""
    from .io.restart import find_latest_valid
    from .report import RunLog

    if restart == "auto":
        with RunLog(comm, scene.schedule.last_step):  # tells of broken ones
            return find_latest_valid(comm, scene.directory)
    return None if restart is None else Path(restart)


def _check(chosen: argparse.Namespace) -> int:
    from .failure import BAD_INPUT
    from .limits import check_scene
    from .scene import RefusedScene

    try:
        scene = _scene(chosen)
    except RefusedScene as refused:
        print("\n".join(refused.problems), file=sys.stderr)
        return BAD_INPUT
    check_scene(scene, chosen.ranks)
    print(scene.to_toml() if chosen.resolved else scene.summary())
    for remark in scene.remarks():
        print(f"note: {remark}", file=sys.stderr)
    return 0


def _preview(chosen: argparse.Namespace) -> int:
    from mpi4py import MPI

    from .errors import InputError
    from .parallel import together
    from .preview import preview

    comm = MPI.COMM_WORLD
    with together(comm, InputError):
        scene = _scene(chosen)
    text = preview(comm, scene, chosen.ranks or comm.size)
    if comm.rank == 0:
        print(text)
    return 0


def _plot(chosen: argparse.Namespace) -> int:
    from mpi4py import MPI

    from .errors import OutputError
    from .parallel import together
    from .plot import OVERVIEW, View, plot, with_options
    from .units import to_metres

    folder = None if chosen.output is None else Path(chosen.output)
    with together(MPI.COMM_WORLD, OutputError):
        if MPI.COMM_WORLD.rank == 0:
            views = [View(name, chosen.kind or "slice") for name in chosen.quantity or ()]
            views = views or [view for view in OVERVIEW if chosen.kind in (None, view.kind)]
            options = {
                "axis": None if chosen.axis is None else "xyz".index(chosen.axis),
                "position": None if chosen.position is None else to_metres(chosen.position),
                "level": chosen.level,
                "scale": chosen.scale,
                "boxes": chosen.boxes,
            }
            given = {name: value for name, value in options.items() if value is not None}
            print(*plot(Path(chosen.path), folder, with_options(views, **given)), sep="\n")
    return 0


def _schema(chosen: argparse.Namespace) -> int:
    import json

    from .errors import OutputError
    from .schema import scene_reference, scene_schema

    text = scene_reference() if chosen.markdown else json.dumps(scene_schema(), indent=2, ensure_ascii=False) + "\n"
    if chosen.output is None:
        print(text, end="")
        return 0
    try:
        Path(chosen.output).write_text(text, encoding="utf-8")
    except OSError as reason:
        raise OutputError(f"cannot write {chosen.output}: {reason.strerror}; choose another --output") from None
    return 0


def _verify(chosen: argparse.Namespace) -> int:
    from mpi4py import MPI

    from .errors import InputError, OutputError
    from .parallel import together
    from .scene import Scene
    from .verify import verify, write

    comm, found = MPI.COMM_WORLD, []
    with together(comm, InputError):
        scenes = [Scene.from_toml(path, chosen.set) for path in chosen.pareto]
    for topic, table in verify(comm, chosen.topics, scenes, quick=chosen.quick, backend=chosen.backend):
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


def _scaling(chosen: argparse.Namespace) -> int:
    from .scaling import KINDS, study, table, write

    folder = _scene(chosen).directory
    kinds = KINDS if chosen.kind is None else (chosen.kind,)
    found = []
    for measured in study(chosen.scene, chosen.set, chosen.ranks, kinds, chosen.steps, chosen.launcher):
        found.append(measured)
        print(f"{measured.kind}, {measured.ranks} ranks: {measured.seconds:.4g} s/step", flush=True)
    print(table(found))
    print(*write(found, folder), sep="\n")
    return 0


def _doctor(chosen: argparse.Namespace) -> int:
    from mpi4py import MPI

    from .doctor import examine

    findings = examine(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print("\n".join(map(str, findings)))
    return 0 if all(finding.well for finding in findings) else 1
