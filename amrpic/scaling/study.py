"""A scaling study: runs of a scene on lists of ranks, started here or as batch jobs, whose files add up in a folder."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..errors import InputError, OutputError
from ..mesh.boxes import scaled_cells
from ..mpi import MPI
from ..scene.scene import Scene
from .measured import MeasuredRun

KINDS = ("strong", "weak")
LAUNCHER = "mpiexec -n {ranks}"
ROOT = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM")  # without them Open MPI starts nothing for root
RUNS = "scaling"  # folder of the runs of a study, in that of the scene


def name_of(path: str | Path, overrides: Sequence[str]) -> str:
    """Return what a scene is known by in a study: its name, and a digest of all but where and how long it runs."""
    scene = Scene.from_toml(path, overrides)
    values = {key: value for key, value in scene.to_dict().items() if key not in ("output", "schedule")}
    digest = hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()
    return f"{scene.name} {digest[:12]}"


def grown(scene: Scene, factor: float) -> list[str]:
    """Return the overrides that give a scene so many times its particles and, nearly, its cells: a finer mesh.

    Along axes whose cells are a multiple of the blocking factor they stay one.
    """
    cells = scaled_cells(scene.domain.value.cells, factor ** (1 / 3), scene.refinement.blocking_factor)
    bunches = scene.to_dict()["bunches"]
    counts = [
        0 if "file" in bunch else bunch.get("particles", 0) for bunch in bunches
    ]  # those of a file are what they are
    overrides = [f"bunches.{number}.particles={round(count * factor)}" for number, count in enumerate(counts) if count]
    return [f"domain.cells={list(cells)}", *overrides]


class Study:
    """Runs of a scene, in ascending numbers of ranks, kept as files of a folder to which each start adds one.

    `strong`: the scene as it is; `weak`: particles and cells in proportion to the ranks, the scene as it is on the fewest.
    `launcher` is the command that starts {ranks} ranks, put before the program; `apart` as in `measure`. Raises InputError for
    one that does not name the ranks.
    """

    def __init__(
        self,
        path: str | Path,
        folder: Path,
        overrides: Sequence[str] = (),
        ranks: Sequence[int] = (1, 2),
        kinds: Sequence[str] = KINDS,
        steps: int = 5,
        launcher: str = LAUNCHER,
        clock: str = "wall",
        apart: bool = False,
    ) -> None:
        if "{ranks}" not in launcher:
            raise InputError(
                f'launcher is "{launcher}"; name the number of ranks in it as {{ranks}}, as in "{LAUNCHER}"'
            )
        if MPI.COMM_WORLD.size > 1:
            raise InputError(
                f"scaling starts ranks of its own, but is on {MPI.COMM_WORLD.size}; start it without mpiexec"
            )
        self.path, self.overrides, self.ranks, self.kinds = path, list(overrides), sorted(set(ranks)), kinds
        self.steps, self.launcher, self.clock, self.name = steps, launcher, clock, name_of(path, overrides)
        self.apart = apart
        self.name += f" by the {clock}'s clock" if clock != "wall" else ""
        self.name += ", stages apart" if apart else ""
        self.folder = folder / RUNS
        self._scene = Scene.from_toml(path, overrides)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as reason:
            raise OutputError(f"cannot make {self.folder}: {reason.strerror}; choose another --output") from None

    def start(self, repeat: int = 1) -> Iterator[MeasuredRun]:
        """Yield what each start measures. All numbers of ranks take turns, `repeat` times: a machine that is loaded for a while
        slows down each of them, not one. InputError if a run cannot be started or fails, after what it said itself."""
        for _ in range(repeat):
            for kind in self.kinds:
                for ranks in self.ranks:
                    output = self._file(kind, ranks)
                    launch(self.launcher, ranks, self.arguments(kind, ranks, output), "the run")
                    yield MeasuredRun.read(output)

    def arguments(self, kind: str, ranks: int, output: Path | str) -> list[str]:
        """Return the module that measures a number of ranks, and its arguments."""
        overrides = grown(self._scene, ranks / self.ranks[0]) if kind == "weak" else []
        clocks = "apart" if self.apart else "together"
        arguments = [output, self.path, kind, self.name, self.steps, self.clock, clocks, *self.overrides, *overrides]
        return ["amrpic.scaling.measure", *map(str, arguments)]

    def runs(self) -> list[MeasuredRun]:
        """Return all runs of this scene in the folder, from earlier starts too. Raises InputError for files that are none."""
        runs = [MeasuredRun.read(path) for path in sorted(self.folder.glob("*.json"))]
        return [run for run in runs if run.scene == self.name]

    def write_jobs(self, options: str, repeat: int = 1) -> list[Path]:
        """Write a script for sbatch for each kind and number of ranks, with `options` of sbatch; return their paths.

        Each adds its runs to the folder, where `runs` finds them later.
        """
        written = []
        for kind in self.kinds:
            for ranks in self.ranks:
                path = self.folder / f"{kind}_{ranks}.sbatch"
                output = self.folder.resolve() / f"{kind}_{ranks}_job"
                launcher = self.launcher.format(ranks=ranks)
                command = shlex.join([sys.executable, "-m", *self.arguments(kind, ranks, "OUTPUT")])
                command = command.replace("OUTPUT", f'"{output}${{SLURM_JOB_ID}}_$run.json"')
                lines = [
                    "#!/bin/bash",
                    f"#SBATCH --ntasks={ranks} --job-name=amrpic_{kind}_{ranks}",
                    *([f"#SBATCH {options}"] if options else []),
                    f"cd {shlex.quote(str(Path.cwd()))}",
                    f"for run in $(seq {repeat}); do",
                    f"  {launcher} {command}",
                    "done",
                ]
                try:
                    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
                except OSError as reason:
                    raise OutputError(f"cannot write {path}: {reason.strerror}; choose another --output") from None
                written.append(path)
        return written

    def _file(self, kind: str, ranks: int) -> Path:
        numbers = (number for number in range(10**6) if not self._numbered(kind, ranks, number).exists())
        return self._numbered(kind, ranks, next(numbers))

    def _numbered(self, kind: str, ranks: int, number: int) -> Path:
        return self.folder / f"{kind}_{ranks}_{number:03}.json"


def launch(launcher: str, ranks: int, module: Sequence[str], purpose: str) -> None:
    """Run a module of Python with arguments on so many ranks; what it says on stdout is dropped.

    Raises InputError if it cannot be started or fails, after what it said itself; `purpose` it was.
    """
    command = [*shlex.split(launcher.format(ranks=ranks)), sys.executable, "-m", *module]
    # os.environ is what this process started with; MPI has added to its own that it is a rank of a run
    environment = dict(os.environ)
    if os.geteuid() == 0 and not environment.keys() & set(ROOT):
        environment |= dict.fromkeys(ROOT, "1")  # who started this as root meant to
    try:
        status = subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=False).returncode
    except OSError as reason:
        raise InputError(f"{command[0]} cannot be started ({reason.strerror}); choose another --launcher") from None
    if status != 0 or not Path(module[1]).exists():
        raise InputError(f"{purpose} on {ranks} ranks ended with status {status}; correct what it says above")
