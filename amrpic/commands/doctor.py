"""amrpic doctor: is this machine fit to compute? One line per check, with a fix if it failed."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from .. import _native, isa
from ..errors import AmrpicError, SolverError
from ..mesh.domain import Domain
from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from ..mesh.patch import Patch
from ..mpi import MPI, is_alone, under_mpiexec
from ..parallel import global_max
from ..stages.poisson import PoissonSolver
from ..units import VACUUM_PERMITTIVITY
from .arguments import Commands, command

OLDEST_TRILINOS = (13, 2)
SECONDS = 120.0  # for a solve that takes one

FIX_MPI = (
    "build mpi4py with the system's MPI (pip install --force-reinstall --no-binary mpi4py mpi4py), "
    "and put the mpiexec of the same MPI first in PATH"
)
FIX_HDF5 = "reinstall h5py from its wheel (pip install --force-reinstall h5py) and set no LD_PRELOAD"
FIX_TRILINOS = "install Debian's trilinos-all-dev, or Trilinos 13.2 or newer, and build again (make clean setup)"
FIX_SOLVE = "fix the failures above first, then build again (make clean setup)"


@dataclass(frozen=True)
class Check:
    """What one check found, and the fix if it failed."""

    subject: str
    passed: bool
    text: str
    fix: str = ""

    def __str__(self) -> str:
        mark, advice = ("ok  ", "") if self.passed else ("FAIL", f"\n     fix: {self.fix}")
        return f"{mark} {self.subject}: {self.text}{advice}"


def examine(comm: MPI.Comm) -> list[Check]:
    """Return the checks of this machine, the same on all ranks. Collective.

    Under mpiexec the solve runs on these ranks, which could not start others; else on two processes that are started for it.
    """
    checks = [
        check("MPI", one_mpi_library, FIX_MPI),
        check("HDF5", hdf5_works_beside_trilinos, FIX_HDF5),
        check("Trilinos", trilinos_and_backend, FIX_TRILINOS),
        check("kernels", isa.description, FIX_TRILINOS),
        check("solve", (lambda: solve_known(comm)) if under_mpiexec() else solve_on_two_ranks, FIX_SOLVE),
    ]
    return [worst(of_ranks) for of_ranks in zip(*comm.allgather(checks), strict=True)]


def check(subject: str, find: Callable[[], str], fix: str) -> Check:
    """Return the check by a function that returns what it found, or raises what is wrong."""
    try:
        return Check(subject, True, find())
    except Exception as wrong:  # anything that goes wrong here is a failed check
        return Check(subject, False, str(wrong) or type(wrong).__name__, fix)


def worst(checks: tuple[Check, ...]) -> Check:
    """The first check that failed, or the first."""
    return next((check for check in checks if not check.passed), checks[0])


def loaded(library: str) -> list[str]:
    """Files of a shared library that are mapped into this process, without links and doubles."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    paths = {line.split(maxsplit=5)[5] for line in lines if f"/{library}" in line}
    return sorted({os.path.realpath(path) for path in paths})


def one_mpi_library() -> str:
    """Return the MPI that mpi4py and the native module share, or that there is none; raise if there are two."""
    if is_alone():
        return "none, so one rank alone; for more: pip install mpi4py mpich"
    of_mpi4py, of_module = MPI.Get_library_version().splitlines()[0].strip("\0 ,"), _native.mpi_library().strip("\0 ,")
    files = loaded("libmpi.so") + loaded("libmpich.so")
    if of_mpi4py != of_module or len(files) != 1:
        raise AmrpicError(f"mpi4py runs on {of_mpi4py}, the native module on {of_module}; loaded are {files}")
    return f"{of_mpi4py.split(', package')[0]}, shared by mpi4py and the native module ({files[0]})"


def hdf5_works_beside_trilinos() -> str:
    """Return the HDF5 that h5py uses; raise if it does not read back what it wrote, now that Trilinos is loaded."""
    built, running = h5py.version.hdf5_version, ".".join(map(str, h5py.h5.get_libversion()))
    if not running.startswith(".".join(built.split(".")[:2])):
        raise AmrpicError(f"h5py was built for HDF5 {built} and runs on {running}")
    values = np.arange(1000.0)
    with h5py.File("doctor", "w", driver="core", backing_store=False) as file:
        file["values"] = values
        if not np.array_equal(file["values"][()], values):
            raise AmrpicError("h5py reads back other numbers than it wrote")
    loaded_too = [path for path in loaded("libhdf5") if "h5py" not in path]
    return f"h5py on HDF5 {running}" + (f", beside {', '.join(loaded_too)}" if loaded_too else "")


def trilinos_and_backend() -> str:
    """Return the version of Trilinos and the Kokkos backend, or what is missing without them; raise if it is older than
    what was tried."""
    version = _native.trilinos_version()
    if not version:
        kokkos = _native.kokkos_backend()
        backends = f'"matrix-free", and "kokkos" on {kokkos}' if kokkos else '"matrix-free" alone'
        return f"none: of the backends there is {backends}, and no equations on scattered points"
    if tuple(int(part) for part in version.split(".")[:2]) < OLDEST_TRILINOS:
        raise AmrpicError(f"Trilinos {version} is older than 13.2")
    return f"{version} on {_native.kokkos_backend()}"


def parabola(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A potential in V that the scheme reproduces to rounding, interfaces included, because it is of second degree."""
    return 1.0 + x - 2.0 * y + x * y + 3.0 * x**2 + 2.0 * y**2 - z**2


def solve_known(comm: MPI.Comm) -> str:
    """Return how well a refined problem with a known potential was solved; raise if not. Collective."""
    domain = Domain(lower=(-1.0, -1.0, -1.0), upper=(1.0, 1.0, 1.0), cells=(32, 32, 32), boundary="dirichlet")
    hierarchy = Hierarchy(comm, domain, levels=[[((16, 16, 16), (47, 47, 47))]], max_grid_size=16, blocking_factor=8)
    rho = Field(hierarchy, unit="C/m^3")
    rho.fill(lambda x, y, z: -8.0 * VACUUM_PERMITTIVITY + 0.0 * (x + y + z))
    phi, report = PoissonSolver(hierarchy, tolerance=1e-10).solve(rho, boundary_values=parabola)
    error = global_max(comm, max((patch_error(patch) for patch in phi.patches), default=0.0))
    if not (report.converged and error < 1e-7):
        raise SolverError(f"a known potential is missed by {error:.1e} V on {comm.size} ranks: {report.reason}")
    return f"a known potential is found within {error:.0e} V in {report.cycles} cycles on {comm.size} ranks"


def patch_error(patch: Patch) -> float:
    """The largest distance from the known potential in the cells that no finer level covers."""
    return float(np.max(np.abs(patch.data - parabola(*patch.centres())), where=~patch.covered, initial=0.0))


def solve_on_two_ranks() -> str:
    """Return what `solve_known` says in two processes that this one starts; raise if they fail. Without MPI, in this one."""
    if is_alone():
        return solve_known(MPI.COMM_SELF)
    code = "from mpi4py import MPI; from amrpic.commands import doctor; print(end=doctor.result_on_first_rank(MPI.COMM_WORLD))"
    command = ["mpiexec", "-n", "2", sys.executable, "-m", "mpi4py", "-c", code]
    # os.environ as Python found it: what MPI has since added to the environment would make the children's MPI fail.
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    environment = {**os.environ, **root, "OMPI_MCA_rmaps_base_oversubscribe": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=SECONDS)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        raise AmrpicError(
            "mpiexec -n 2 failed: " + next((line for line in lines if "Error" in line), " ".join(lines[-3:]))
        )
    return done.stdout


def result_on_first_rank(comm: MPI.Comm) -> str:
    """Return what `solve_known` says on the first rank, nothing on the others. Collective."""
    if comm.size != 2:
        raise AmrpicError(f"mpiexec -n 2 made {comm.size} rank: it belongs to another MPI than mpi4py")
    text = solve_known(comm)
    return text if comm.rank == 0 else ""


# ---- the command ----


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    command(commands, "doctor", _doctor, "check this machine; each failed check prints a fix", "checking this machine")


def _doctor(chosen: argparse.Namespace) -> int:
    checks = examine(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print("\n".join(map(str, checks)))
    return 0 if all(check.passed for check in checks) else 1
