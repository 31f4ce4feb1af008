"""Time operators at points and at Gauss's points: the bakeoff problems BP1 to BP4. A worker of `bench`.

Each product with an operator beside the machine's peak of fused products and sums, measured in turns with it, and beside
libCEED 0.12 where it can be had: its operators at Gauss's points, and its basis at points, which has the gradient there and
back alone. Tangents of solids beside BP4 at the same points; what a load step does to points beside an iteration of
Newton's method, and that beside Kratos's material points; multigrid beside the diagonal on grains, binder and air; memory of a
run.
Thread time on one rank; on two ranks wall time of the slower one.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import partial
from typing import Annotated, Any

import numpy as np
from mpi4py import MPI

import ceed_peer
import kratos_peer
from amrpic import _native, fem, mpm
from amrpic.mpm.state import Plan
from amrpic.mpm.step import begin, put
from exact.press import first_tangent
from measuring import Record, Runs, reset_peak, resident, watched

PROBLEMS = {"BP1": (fem.Mass, 1), "BP2": (fem.Mass, 3), "BP3": (fem.Poisson, 1), "BP4": (fem.Poisson, 3)}
CELLS = {1: 16, 2: 10, 3: 8, 4: 6}  # elements per axis at points, by degree
GAUSS_CELLS = {1: 32, 2: 16, 3: 12, 4: 10}
AT_POINTS = ((1, 4), (2, 3), (2, 4), (3, 4), (4, 5))  # degree, points per axis
DEGREES = (1, 2, 3, 4)
BEYOND_CACHE = {"degree": 2, "cells": (48, 40, 60), "per_axis": 4}
CEED_ELEMENTS = 20
LAWS: dict[str, mpm.Material] = {
    "neo-Hookean": mpm.NeoHookean(300e6, 0.25),
    "Ogden": mpm.Ogden(((72e6, 1.3), (60e6, 5.0), (-12e6, -2.0)), 120e6),
}
STEP_CELLS = {1: 16, 2: 8}  # elements per axis of runs, by degree
AIR = 5e6  # Pa, an 800th of the grains' stiffness


def nominal_flops(kind: type[fem.Operator], degree: int) -> int:
    """Return the operations of a point and a component: there and back by sums along one axis after another."""
    p = degree + 1
    return 4 * (2 * p**3 + 3 * p**2 + 3 * p) if kind is fem.Poisson else 4 * (p**3 + p**2 + p)


def record_name(problem: str, degree: int, layout: str, who: str = "amrpic") -> str:
    return f"elements, {problem}, p = {degree}, {layout}, {who}"


def layout_name(degree: int, per_axis: int) -> str:
    return f"{per_axis**3} points"


def beyond_cache_name(ranks: int, size: str) -> str:
    return f"elements, BP3, p = 2, 64 points, {size}, {ranks} ranks"


def tangent_name(who: str) -> str:
    return f"elements, product, p = 2, 64 points, {who}"


def points_step_name(degree: int, what: str) -> str:
    return f"load step, p = {degree}, 64 points, {what}"


def solve_name(cells: int, preconditioner: str) -> str:
    return f"solve, p = 2, contrast 800, {cells}³ elements, {preconditioner}"


MEMORY = "load step, p = 2, 64 points, memory"
COLUMN_OF_KRATOS = "column, p = 1, 64 points, first step, Kratos"
COLUMN = kratos_peer.Block((0.5, 0.5, 16.0), (2, 2, 64), 4, 1e6, 0.3, 2000.0, 9.81 / 5)  # examples/column.toml
BLOCK = kratos_peer.Block((1.0, 1.0, 1.0), (16, 16, 16), 4, 300e6, 0.25, 2000.0, 9.81)


def seconds(call: Callable[[], Any], least: float = 0.02) -> float:
    """Return the thread seconds of a call, repeated until it takes long enough to tell."""
    count, start = 0, time.thread_time()
    while (taken := time.thread_time() - start) < least or count == 0:
        call()
        count += 1
    return taken / count


def timed(name: str, calls: dict[str, Callable[[], Any]], runs: int, facts: dict[str, dict[str, Any]]) -> list[Record]:
    """Return a record for each call; they take turns with each other and with the peak."""
    found: dict[str, list[float]] = {who: [] for who in calls}
    peaks: list[float] = []
    for call in calls.values():
        call()
    for _ in range(runs):
        peaks.append(_native.measure_fma_peak())
        for who, call in calls.items():
            found[who].append(seconds(call))
    peak = statistics.median(peaks)
    return [Record(name.format(who=who), found[who], facts={**facts[who], "peak": peak}) for who in calls]


def at_points(problem: str, degree: int, per_axis: int, runs: int, peer: bool) -> list[Record]:
    """Return the records of one operator at jittered points, and of libCEED's gradients there and back."""
    kind, components = PROBLEMS[problem]
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, CELLS[degree], degree=degree)
    points = fem.jittered(mesh, per_axis, weights="volume")
    operator, u = kind(points, components=components), vector(mesh, components)
    calls: dict[str, Callable[[], Any]] = {"amrpic": lambda: operator @ u}
    elements = len(mesh.elements)
    facts = {"amrpic": facts_of(mesh, components, len(points), nominal_flops(kind, degree))}
    if peer and kind is fem.Poisson:
        calls["libCEED"] = ceed_peer.gradient_there_and_back(mesh, components, per_axis**3, CEED_ELEMENTS)
        share = CEED_ELEMENTS / elements
        facts["libCEED"] = {name: value * share for name, value in facts["amrpic"].items()}
    name = record_name(problem, degree, layout_name(degree, per_axis), "{who}")
    return timed(name, calls, runs, facts)


def at_gauss(problem: str, degree: int, runs: int, peer: bool) -> list[Record]:
    """Return the records of one operator at Gauss's points, and of libCEED's: the same product, to rounding."""
    kind, components = PROBLEMS[problem]
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, GAUSS_CELLS[degree], degree=degree)
    points = fem.gauss(mesh)
    operator, u = kind(points, components=components), vector(mesh, components)
    calls: dict[str, Callable[[], Any]] = {"amrpic": lambda: operator @ u}
    facts = {"amrpic": facts_of(mesh, components, len(points), 0)}
    if peer:
        theirs = ceed_peer.AtGauss(mesh, kind, components)
        theirs.set(u)
        theirs.apply()
        ours = (operator @ u).ravel()
        apart = float(np.abs(theirs.result() - ours).max() / np.abs(ours).max())
        calls["libCEED"] = theirs.apply
        facts["libCEED"] = {**facts["amrpic"], "difference": apart}
    return timed(record_name(problem, degree, "Gauss", "{who}"), calls, runs, facts)


def tangents(runs: int) -> list[Record]:
    """Return the records of products with BP4 and with tangents of solids, at the same points."""
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, CELLS[2], degree=2)
    points, u = fem.jittered(mesh, 4, weights="volume"), vector(mesh, 3)
    operators: dict[str, fem.Operator] = {"BP4": fem.Poisson(points, components=3)}
    operators |= {name: mpm.Solid(points, law).tangent(1e-3 * np.sin(mesh.nodes)) for name, law in LAWS.items()}
    calls: dict[str, Callable[[], Any]] = {
        name: partial(operator.__matmul__, u) for name, operator in operators.items()
    }
    return timed(tangent_name("{who}"), calls, runs, dict.fromkeys(calls, facts_of(mesh, 3, len(points), 0)))


def pressed(cells: int, degree: int) -> mpm.Scene:
    """A block between walls, 64 points an element, that writes nothing."""
    return mpm.Scene.from_dict(
        {
            "name": "bench",
            "domain": {"lower": 0, "upper": 1, "cells": cells, "degree": degree},
            "faces": {"x": "slip", "y": "slip", "z": ["slip", {"press": 0.1}]},
            "materials": {"rubber": {"law": "neo-hookean", "young": 300e6, "poisson": 0.25}},
            "schedule": {"steps": 10},
            "output": {"write": []},
        }
    )


def load_step(degree: int, runs: int) -> list[Record]:
    """Return the records of what a load step does to points, to locate, migrate, sort and weigh them, and of an iteration of
    Newton's method: forces, tangent, and its linear system to a hundredth."""
    scene = pressed(STEP_CELLS[degree], degree)
    plan = Plan(MPI.COMM_SELF, scene)
    state = begin(plan)
    points, solid, mesh = state.placed.points, state.placed.solid, state.placed.mesh
    walls = (mesh.node_indices == 0) | (mesh.node_indices == mesh.node_counts - 1)
    u = 1e-3 * np.sin(5 * mesh.nodes[:, [1, 2, 0]]) * ~walls

    def newton() -> None:
        force = solid.respond(u).force
        fem.solve(solid.tangent(u), force, fixed=walls, tolerance=1e-2)

    calls: dict[str, Callable[[], Any]] = {
        "points": lambda: put(deepcopy(points.columns()), plan, 0.0),
        "Newton": newton,
    }
    facts = {name: {"points": len(points)} for name in calls}
    return timed(points_step_name(degree, "{who}"), calls, runs, facts)


def beside_kratos(quick: bool) -> list[Record]:
    """Return the records of Newton's iterations of Kratos: of a column, with how far its displacements are from ours at its
    points, over the largest; and of as many points as `load_step` has."""
    step = kratos_peer.first_step(COLUMN)
    mesh = fem.Mesh(MPI.COMM_SELF, 0, COLUMN.size, COLUMN.cells)
    points = fem.given(mesh, step.position, step.volume, weights="volume")
    solid = mpm.Solid(points, mpm.NeoHookean(COLUMN.young, COLUMN.poisson))
    walls = (mesh.node_indices == 0) | ((mesh.node_indices == mesh.node_counts - 1) & [True, True, False])
    weight = np.zeros((len(points), 3))
    weight[:, 2] = -COLUMN.density * COLUMN.gravity
    u, report = mpm.equilibrium(solid, fixed=walls, load=points.integrate(weight), tolerance=1e-12)
    assert report.converged, report.reason
    order, theirs = np.lexsort(np.round(mesh.nodes, 9).T), np.lexsort(np.round(step.nodes, 9).T)
    apart = float(np.abs(u[order] - step.displacement[theirs]).max() / np.abs(u).max())
    block = dataclasses.replace(BLOCK, cells=(8, 8, 8)) if quick else BLOCK
    large = kratos_peer.first_step(block)
    return [
        Record(COLUMN_OF_KRATOS, [step.seconds / step.iterations], facts={"points": len(points), "difference": apart}),
        Record(
            points_step_name(1, "Kratos"), [large.seconds / large.iterations], facts={"points": len(large.position)}
        ),
    ]


def run_memory() -> Record:
    """Return the record of a load step and what memory it takes at its fullest, made in this process: of so many points that
    what does not grow with them is little, and after a small run, with which code has come into memory."""
    mpm.Simulation(MPI.COMM_SELF, pressed(2, 2)).advance()
    before = resident("VmRSS")
    reset_peak()
    run = mpm.Simulation(MPI.COMM_SELF, pressed(20, 2))
    start = time.thread_time()
    run.advance()
    taken, count = time.thread_time() - start, len(run.state.placed.points)
    facts = {"points": count, "bytes per point": (resident("VmHWM") - before) / count}
    return Record(MEMORY, [taken], facts=facts)


def solves(cells: int) -> list[Record]:
    """Return the records of the first linear system of a press, to 1e-8, by multigrid and by the diagonal."""
    tangent, fixed, values = first_tangent(MPI.COMM_SELF, 2, cells, 4, AIR)
    out = []
    for preconditioner in ("p-multigrid", "jacobi"):
        start = time.thread_time()
        _, report = fem.solve(
            tangent, 0 * values, fixed=fixed, values=values, tolerance=1e-8, preconditioner=preconditioner
        )
        assert report.converged, report.reason
        facts = {"points": len(tangent.points), "iterations": report.iterations}
        out.append(Record(solve_name(cells, preconditioner), [time.thread_time() - start], facts=facts))
    return out


def facts_of(mesh: fem.Mesh, components: int, points: int, flops: int) -> dict[str, Any]:
    return {
        "unknowns": len(mesh.node_indices) * components,
        "points": points,
        "nominal flops": points * components * flops,
    }


def vector(mesh: fem.Mesh, components: int) -> np.ndarray:
    u = np.random.default_rng(1).standard_normal((len(mesh.node_indices), components))
    return u[:, 0].copy() if components == 1 else u


def large(runs: int, small: bool) -> list[Record]:
    """Return the record of BP3 at points, few that stay in the cache or millions that do not, on all ranks. Collective."""
    comm, shape = MPI.COMM_WORLD, BEYOND_CACHE
    cells = (8, 8, 8) if small else shape["cells"]
    mesh = fem.Mesh(comm, 0, 1, cells, degree=int(shape["degree"]))  # type: ignore[call-overload]
    points = fem.jittered(mesh, int(shape["per_axis"]), weights="volume")  # type: ignore[call-overload]
    operator, u = fem.Poisson(points), vector(mesh, 1)
    repeats = 40 if small else 1
    operator @ u
    times = []
    for _ in range(runs):
        comm.Barrier()
        start = time.perf_counter() if comm.size > 1 else time.thread_time()
        for _ in range(repeats):
            operator @ u
        taken = (time.perf_counter() if comm.size > 1 else time.thread_time()) - start
        times.append(mesh.comm.allreduce(taken / repeats, op=MPI.MAX))
    count = mesh.comm.allreduce(len(points))
    facts = {"points": count, "bytes per point": points.native.bytes / max(1, len(points))}
    return [Record(beyond_cache_name(comm.size, "in cache" if small else "beyond it"), times, facts=facts)]


def printed(record: Record) -> str:
    facts = record.facts
    if "iterations" in facts:
        return f"{record.name}: {facts['iterations']} iterations in {record.median:.3g} s"
    if record.name == MEMORY:
        return f"{record.name}: {facts['bytes per point']:.0f} B a point"
    rate = f"{1e-6 * facts['points'] / record.median:.3g} million points/s"
    apart = f", {facts['difference']:.0e} apart" if "difference" in facts else ""
    if "unknowns" not in facts:
        return f"{record.name}: {rate}{apart}"
    peak = (
        f", {facts['nominal flops'] / record.median / facts['peak']:.0%} of the peak" if facts["nominal flops"] else ""
    )
    return f"{record.name}: {1e-6 * facts['unknowns'] / record.median:.3g} MDoF/s, {rate}{peak}{apart}"


def run(runs: Runs = 5, quick: Annotated[bool, "BP3 alone"] = False) -> Iterator[Record]:
    """All problems: those on one rank, and large ones on all. Collective."""
    comm = MPI.COMM_WORLD
    if comm.size == 1:
        yield from alone(runs, quick)
    for small in (True,) if quick else (True, False):
        yield from large(runs, small)


def alone(runs: int, quick: bool) -> list[Record]:
    """What is measured on one rank."""
    records: list[Record] = []
    core: dict[str, Any] = {}
    peer = ceed_peer.library() is not None
    if not peer:
        print("without libCEED, which cannot be imported: rows beside it are left out", flush=True)
    memory = run_memory()  # before others have taken some that is used again
    with watched(core):
        for problem in ("BP3",) if quick else tuple(PROBLEMS):
            for degree, per_axis in AT_POINTS:
                records += at_points(problem, degree, per_axis, runs, peer)
            for degree in DEGREES:
                records += at_gauss(problem, degree, runs, peer)
        records += tangents(runs)
        for degree in STEP_CELLS:
            records += load_step(degree, runs)
        if kratos_peer.there_is():
            records += beside_kratos(quick)
        else:
            print("without Kratos, which cannot be imported: rows beside it are left out", flush=True)
        for cells in (8,) if quick else (16, 32):
            records += solves(cells)
    records[0].facts.update(core)
    return [*records, memory]
