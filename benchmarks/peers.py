"""Time solvers of others beside ours on one uniform mesh between grounded walls: scipy's sine transform, hypre, pyamg.

All get the same right-hand side and solve to 1e-10 from zero. A peer that is not there is left out with a line that says how
to install it. A worker of `bench`; it starts hypre on one and two ranks, so it is
not under mpiexec itself.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from mpi4py import MPI
from scipy import sparse

from amrpic.stages.poisson import PoissonSolver
from cases import problem
from exact.sources import EPS0
from measuring import BACKEND, ENVIRONMENT, Backend, Record, Runs, WorkUnit, work_unit
from sine import by_sine_transform, inverse_eigenvalues

HERE = Path(__file__).parent
Array = np.ndarray
FULL = 1e-10
SAME = 1e-8  # largest difference of two potentials of the same equations, over the largest
HYPRE = "apt-get install libhypre-dev"


class Missing(Exception):
    """A peer that is not installed; the message tells how to install it."""


def right_hand_side(n: int) -> Array:
    """The charge of `uniform n` over ε₀ times h², (n, n, n) with z first: what minus the Laplacian of φ is, cell by cell."""
    rho = problem(MPI.COMM_SELF, f"uniform {n}", n).rho
    (patch,) = rho.patches
    return np.ascontiguousarray(patch.data.T) / EPS0 / n**2


def matrix(n: int) -> sparse.csr_matrix:
    """h² times minus the Laplacian with ghosts of opposite sign, for the cells in the order of `right_hand_side`."""
    line = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(n, n)).tolil()
    line[0, 0] = line[n - 1, n - 1] = 3.0
    one, line = sparse.identity(n), line.tocsr()
    parts = (sparse.kron(sparse.kron(a, b), c) for a, b, c in ((line, one, one), (one, line, one), (one, one, line)))
    return sparse.csr_matrix(sum(parts))


# ---- what is timed ----


class Beside:
    """Times solvers on one mesh; the records have its size and work unit."""

    def __init__(self, n: int, runs: int) -> None:
        self.n, self.runs = n, runs
        self.f = right_hand_side(n)
        self.unit: WorkUnit = work_unit(MPI.COMM_SELF, n**3)
        self.inverse = inverse_eigenvalues(n)
        self.wanted = by_sine_transform(self.f, self.inverse)

    def record(self, who: str, seconds: list[float], **facts: object) -> Record:
        return Record(peer_name(self.n, who), seconds, facts=dict(facts), **self.unit.record_fields(self.n**3))

    def require_same(self, who: str, phi: Array) -> None:
        """Raise SystemExit unless a potential is the sine transform's: a peer that solves something else is no peer."""
        apart = float(np.abs(phi.reshape(self.wanted.shape) - self.wanted).max() / np.abs(self.wanted).max())
        if not apart <= SAME:
            raise SystemExit(
                f"{who} on uniform {self.n} differs by {apart:.1e} from the sine transform; its driver is wrong"
            )

    def ours_and_direct(self, backend: str, boxes: int) -> Iterator[Record]:
        """Yield our solver and the sine transform, run in turns, so that what disturbs one disturbs the other."""
        ours = problem(MPI.COMM_SELF, f"uniform {self.n}", boxes)
        solver = PoissonSolver(ours.hierarchy, tolerance=FULL, backend=backend)
        direct: list[float] = []
        multigrid: list[float] = []
        solver.solve(ours.rho)
        for _ in range(self.runs):
            direct.append(seconds(lambda: by_sine_transform(self.f, self.inverse)))
            multigrid.append(seconds(lambda: solver.solve(ours.rho)))
        yield self.record("amrpic", multigrid, backend=backend, boxes=boxes)
        yield self.record("scipy DST", direct)

    def hypre(self) -> Iterator[Record]:
        """Yield hypre's two solvers on one and two ranks. Raises Missing."""
        with tempfile.TemporaryDirectory() as folder:
            driver = compiled(Path(folder))
            rhs = Path(folder) / "rhs"
            self.f.tofile(rhs)
            for ranks in (1, 2):
                found = Path(folder) / "phi"
                command = ["mpiexec", "-n", str(ranks), str(driver), str(self.n), str(self.runs), str(rhs), str(found)]
                done = subprocess.run(
                    command, env={**os.environ, **ENVIRONMENT}, check=True, capture_output=True, text=True
                )
                for who, ending in (("PFMG-CG", "pfmg"), ("BoomerAMG-CG", "amg")):
                    self.require_same(f"hypre {who}", np.fromfile(f"{found}.{ending}"))
                yield from self.records(done.stdout, ranks)

    def records(self, text: str, ranks: int) -> Iterator[Record]:
        """Yield the records of what the driver printed."""
        lines = [line.split() for line in text.splitlines()]
        for who in dict.fromkeys(line[0] for line in lines):
            mine = [line for line in lines if line[0] == who]
            named = f"hypre {who}" + (f", {ranks} ranks" if ranks > 1 else "")
            iterations = int(mine[-1][3])
            yield self.record(named, [float(line[2]) for line in mine], iterations=iterations, ranks=ranks)
            yield self.record(f"{named}, set-up", [float(line[1]) for line in mine], ranks=ranks)

    def pyamg(self) -> Iterator[Record]:
        """Yield pyamg's Ruge-Stüben multigrid around conjugate gradients. Raises Missing."""
        if importlib.util.find_spec("pyamg") is None:
            raise Missing("pip install pyamg")
        import pyamg

        equations, f = matrix(self.n), self.f.ravel()
        start = time.perf_counter()
        solver = pyamg.ruge_stuben_solver(equations)
        setup = time.perf_counter() - start
        taken: list[float] = []
        for _ in range(self.runs):
            residuals: list[float] = []
            start = time.perf_counter()
            phi = solver.solve(f, tol=FULL, accel="cg", residuals=residuals)
            taken.append(time.perf_counter() - start)
        self.require_same("pyamg", phi)
        yield self.record("pyamg RS-CG", taken, iterations=len(residuals) - 1)
        yield self.record("pyamg RS-CG, set-up", [setup])


def peer_name(n: int, who: str) -> str:
    return f"peer, uniform {n}, {who}"


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def compiled(folder: Path) -> Path:
    """Return the hypre driver, compiled into a folder. Raises Missing where hypre or the compiler is not installed."""
    include = next(
        (p for p in (Path("/usr/include/hypre"), Path("/usr/local/include")) if (p / "HYPRE.h").exists()), None
    )
    if include is None:
        raise Missing(HYPRE)
    if shutil.which("mpicc") is None:
        raise Missing("apt-get install libopenmpi-dev")
    out = folder / "hypre_driver"
    source = HERE / "hypre_driver.c"
    command = ["mpicc", "-O3", "-march=native", f"-I{include}", str(source), "-o", str(out), "-lHYPRE", "-lm"]
    subprocess.run(command, check=True)
    return out


def measure(sizes: Sequence[int], backend: str, boxes: int, runs: int) -> Iterator[Record | str]:
    """Yield the records of all peers that are installed, and a line for each that is not."""
    for n in sizes:
        beside = Beside(n, runs)
        for what, yields in (
            ("ours and scipy", lambda b=beside: b.ours_and_direct(backend, boxes)),
            ("hypre", beside.hypre),
            ("pyamg", beside.pyamg),
        ):
            try:
                yield from yields()
            except Missing as how:
                yield f"{what} is left out; to have it: {how}"


def run(
    backend: Backend = BACKEND,
    boxes: Annotated[int, "largest boxes of ours"] = 64,
    cells: Annotated[tuple[int, ...], "cells along an axis"] = (64, 128),
    runs: Runs = 5,
) -> Iterator[Record]:
    """All peers that are here; a line for each that is not."""
    for found in measure(cells, backend, boxes, runs):
        if isinstance(found, str):
            print(found, flush=True)
        else:
            yield found
