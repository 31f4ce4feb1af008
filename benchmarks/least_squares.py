"""Time stencils of moving least squares beside LAPACK's dgels, one call per target. A worker of `bench`.

Value, gradient and Laplacian at all points of a jittered 22³ lattice (±0.25 h), and of the lattice itself, reach 1.4 times the
distance of the n-th point, weight (1 - r)²; thread time, tests and repairs included, the search for neighbours not; and the
memory that it takes beyond what it returns. Where pycompadre is installed, its time and the largest difference of its weights.
Then the same at order 2 for all cells of a refined mesh, from the cells within 2.1 of their widths; the look-up included. And
fields carried to another base, per new cell, and sampled along a line, per point. Ends with the goals and whether they are met.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.util
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic import gmls
from amrpic.gmls import problem
from measuring import ENVIRONMENT, RUNNER, Record, Runs, reset_peak, resident

POINTS = 22  # per axis
ORDERS = (2, 3, 4)
WANTED = (gmls.VALUE, gmls.GRADIENT, gmls.LAPLACIAN)
LAPACK_TARGETS = 400
COMPARED_EACH = 97  # targets, of which one's weights are compared with pycompadre's
LEAVES = "least squares, order 2, leaves"
SAMPLES = "least squares, order 3, field at points"


def cloud(jitter: float) -> np.ndarray:
    """Return points (n, 3) of the unit cube."""
    lattice = np.stack(np.meshgrid(*[np.arange(POINTS) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return (lattice + np.random.default_rng(1).uniform(-jitter, jitter, lattice.shape)) / POINTS


def thread_seconds(runs: int, call: Callable[[], object]) -> list[float]:
    """Return the thread time of each call."""
    out = []
    for _ in range(runs):
        start = time.thread_time()
        call()
        out.append(time.thread_time() - start)
    return out


def ours(order: int, kind: str, runs: int) -> Record:
    """Return the record of our stencils, seconds per target."""
    x = cloud(0.25 if kind == "jittered" else 0.0)
    near = gmls.nearby(x, x, order=order, reach=1.4)

    def solve() -> gmls.Stencils:
        return gmls.stencils(x, near, space=gmls.Scalar(order), samples=gmls.Points(x), wanted=WANTED)

    before = resident("VmRSS")
    reset_peak()
    found = solve()
    quality = found.quality
    arrays = [*vars(found).values(), *vars(quality).values()]
    returned = sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
    facts = {
        "MiB beyond what is returned": (resident("VmHWM") - before - returned) / 2**20,
        "sites per target": float(quality.neighbours.mean()),
        "targets whose reach grew": int((quality.growth > 0).sum()),
    }
    return Record(record_name(order, kind), [s / len(x) for s in thread_seconds(runs, solve)], facts=facts)


def leaves(runs: int, cells: int) -> Record:
    """Return the record of the leaves of a mesh of so many base cells along each axis and two refined levels."""
    domain = amrpic.Domain(0, 1, cells, boundary="dirichlet")
    boxes = [[((cells // 2,) * 3, (cells + cells // 6 - 1,) * 3)], [((5 * cells // 4,) * 3, (5 * cells // 3 - 1,) * 3)]]
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, boxes, 24, 8)

    def solve() -> gmls.Stencils:
        sites, _ = gmls.cells(hierarchy)
        numbers, near = gmls.leaves_around(hierarchy, 2.1)
        space, samples, lattice = gmls.Scalar(2), gmls.Points(sites), hierarchy.spacing(2) / 2
        return gmls.stencils(sites[numbers], near, space=space, samples=samples, wanted=WANTED, lattice=lattice)

    solved = solve()
    facts = {"leaves": float(len(solved)), "entries solved": float(len(solved.solved))}
    return Record(LEAVES, [s / len(solved) for s in thread_seconds(runs, solve)], facts=facts)


def between_meshes(runs: int, cells: int) -> list[Record]:
    """Return the records of a field that is carried to another base, per new cell, and sampled along a line, per point."""
    domain = amrpic.Domain(0, 1, cells, boundary="dirichlet")
    box = [[((cells // 2,) * 3, (3 * cells // 2 - 1,) * 3)]]
    field = amrpic.Field(amrpic.Hierarchy(MPI.COMM_SELF, domain, box, 24, 8)).fill(lambda x, y, z: np.exp(x + y * z))
    base = amrpic.Domain(0, 1, 5 * cells // 4, boundary="dirichlet")
    to = amrpic.Hierarchy(MPI.COMM_SELF, base, (), 24, 8)
    points = np.linspace([0.01, 0.02, 0.03], [0.98, 0.99, 0.97], 4000)
    timed: list[tuple[str, int, Callable[[], object]]] = [
        *((remap_name(order), to.cells(0), lambda order=order: field.remap(to, order)) for order in ORDERS),
        (SAMPLES, len(points), lambda: field.sample(points, order=3)),
    ]
    return [Record(name, [s / count for s in thread_seconds(runs, call)]) for name, count, call in timed]


def remap_name(order: int) -> str:
    return f"least squares, order {order}, field on another base"


def lapack(order: int, runs: int) -> Record:
    """Return the record of dgels('T') on the same equations; the time of calls that return at once is taken off."""
    found = ctypes.util.find_library("lapack")
    if found is None:
        return Record(record_name(order, "dgels"), [])
    dgels = ctypes.CDLL(found).dgels_
    x = cloud(0.25)
    near = gmls.nearby(x, x, order=order, reach=1.4)
    equations = problem.assembled(
        x, near, gmls.Scalar(order), gmls.Points(x), WANTED, gmls.Power(2), (), None, False
    ).equations(near)
    calls, kept = [], []
    for target in range(0, len(x), len(x) // LAPACK_TARGETS):
        rows, _, tau = equations(target)
        m, n, count = rows.shape[0], rows.shape[1], tau.shape[1]
        matrix, right = np.asfortranarray(rows), np.zeros((m, count), order="F")
        right[:n] = tau
        work = np.empty(64 * (m + n + count))
        sizes = [ctypes.c_int(v) for v in (m, n, count, m, m, len(work), 0)]
        kept.append((matrix, right, work, sizes))
        m_, n_, c_, lda, ldb, lwork, info = map(ctypes.byref, sizes)
        address = [a.ctypes.data_as(ctypes.c_void_p) for a in (matrix, right, work)]
        calls.append((b"T", m_, n_, c_, address[0], lda, address[1], ldb, address[2], lwork, info))
    copies = [(matrix.copy(order="F"), right.copy(order="F")) for matrix, right, _, _ in kept]
    none = ctypes.byref(ctypes.c_int(0))
    seconds = []
    for _ in range(runs):
        for (matrix, right, _, _), (a, b) in zip(kept, copies, strict=True):
            matrix[:], right[:] = a, b
        all_of = thread_seconds(1, lambda: [dgels(*call) for call in calls])[0]
        empty = thread_seconds(1, lambda: [dgels(call[0], none, none, none, *call[4:]) for call in calls])[0]
        seconds.append((all_of - empty) / len(calls))
    return Record(record_name(order, "dgels"), seconds)


def compadre(order: int, runs: int) -> Record:
    """Return the record of pycompadre's pivoted QR, with the largest difference of its weights to ours over the largest of
    each quantity and target; without times where it is not installed. In a process of its own, as its Kokkos is another one."""
    name = record_name(order, "pycompadre")
    if importlib.util.find_spec("pycompadre") is None:
        return Record(name, [])
    x = cloud(0.25)
    near = gmls.nearby(x, x, order=order, reach=1.4)
    targets = np.arange(0, len(x), COMPARED_EACH)
    with tempfile.TemporaryDirectory() as folder:
        given, written = Path(folder) / "given.npz", Path(folder) / "found.npz"
        np.savez(
            given, x=x, start=near.start, index=near.index, reach=near.reach, order=order, runs=runs, targets=targets
        )
        worker = [*RUNNER, "compadre_peer", str(given), str(written)]
        subprocess.run(worker, check=True, env={**os.environ, **ENVIRONMENT}, stderr=subprocess.DEVNULL)
        found = np.load(written)
        seconds, theirs = found["seconds"] / len(x), found["weights"]
    mine = gmls.stencils(x, near, space=gmls.Scalar(order), samples=gmls.Points(x), wanted=WANTED)
    largest, at = 0.0, 0
    for target in targets:
        own = mine.weights[mine.start[target] : mine.start[target + 1]]
        apart = np.abs(own - theirs[at : at + len(own)]).max(axis=0) / np.abs(own).max(axis=0)
        largest, at = max(largest, float(apart.max())), at + len(own)
    return Record(name, list(seconds), facts={"largest difference of weights": largest})


def record_name(order: int, kind: str) -> str:
    return f"least squares, order {order}, {kind}"


def run(runs: Runs = 5) -> Iterator[Record]:
    """All orders, beside LAPACK and pycompadre."""
    records = []
    for order in ORDERS:
        records += [
            ours(order, "jittered", runs),
            ours(order, "lattice", runs),
            lapack(order, runs),
            compadre(order, runs),
        ]
    records += [leaves(runs, 96), *between_meshes(runs, 32)]
    records = [record for record in records if record.seconds]
    if importlib.util.find_spec("pycompadre") is None:
        print("pycompadre is not installed: it is left out")
    from goals import Found, printed, stencils, table  # which imports this module

    print(printed(table(list(stencils(Found(records))))))
    yield from records
