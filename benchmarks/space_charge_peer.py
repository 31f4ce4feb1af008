"""Errors and seconds of `amrpic.SpaceCharge` and of xfields' 3-D solver for bunches whose field is known.

`python benchmarks space_charge_peer`, where xfields is installed; on one rank. Particles are a quiet start. Errors are those of
E at particles, rms over the largest field, against exact integrals. A call is one with mesh, solver and order of particles
there already. xfields takes its FFT solver on a box that holds all particles, with cells as wide as our finest ones, and 2, 4
and 8 times as wide; seconds at equal error lie on lines through these.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from mpi4py import MPI

import amrpic
from exact.bunches import ellipsoid_field, gaussian_field, quiet_ellipsoid, quiet_gaussian
from measuring import CPU_TIME, Record

CHARGE = 1e-9  # C
SAMPLE = 4000  # particles, about, at which errors are taken
MOST_CELLS = 200  # along an axis, of xfields: its FFTs take eight times as many numbers
QUIET: dict[str, Any] = {"compensation": "clouds-and-mesh", "comm": MPI.COMM_SELF}
ROUND, FLAT, LONG = (1e-3 * np.array(sizes) for sizes in ((1, 1, 1), (50, 50, 1), (1, 1, 50)))
AXES = 1e-3 * np.array([1.0, 1.5, 2.0])  # of an ellipsoid
HALO, HALO_CHARGE = (
    10.0,
    1 / 64,
)  # radius of an even ball round the core, in its rms sizes, and the part of the charge in it


@dataclass(frozen=True)
class Bunch:
    """Places (n, 3) in m of equal particles, those at which errors are taken, the exact field (V/m) there, and settings."""

    places: np.ndarray
    sample: np.ndarray
    exact: np.ndarray
    settings: dict[str, Any]

    def error(self, field: np.ndarray) -> float:
        wrong = ((field[self.sample] - self.exact) ** 2).sum(axis=1)
        return float(np.sqrt(wrong.mean() / (self.exact**2).sum(axis=1).max()))


def gaussian(number: int, sizes: np.ndarray, **settings: Any) -> Bunch:
    places = quiet_gaussian(number, sizes)
    sample = np.arange(0, number, max(1, number // SAMPLE))
    return Bunch(places, sample, gaussian_field(places[sample], sizes, CHARGE), settings)


def ellipsoid(number: int) -> Bunch:
    """Away from the surface."""
    places = quiet_ellipsoid(number, AXES)
    inside = np.flatnonzero(((places / AXES) ** 2).sum(axis=1) < 0.75**2)
    sample = inside[:: max(1, number // SAMPLE)]
    return Bunch(places, sample, ellipsoid_field(places[sample], AXES, CHARGE), {"levels": 1})


def core_with_halo(number: int) -> Bunch:
    """A normal core, and a thin even ball round it."""
    of_halo = int(number * HALO_CHARGE)
    radius = np.full(3, HALO * ROUND[0])
    core = quiet_gaussian(number, ROUND)[: number - of_halo]
    places = np.concatenate([core, quiet_ellipsoid(of_halo, radius, seed=2)])
    sample = np.arange(0, number, max(1, number // SAMPLE))
    exact = gaussian_field(places[sample], ROUND, CHARGE * (1 - HALO_CHARGE))
    exact += ellipsoid_field(places[sample], radius, CHARGE * HALO_CHARGE)
    return Bunch(places, sample, exact, {"levels": 3})


BUNCHES: dict[str, Callable[[int], Bunch]] = {
    "round": lambda number: gaussian(number, ROUND),
    "ellipsoid": ellipsoid,
    "flat 50:50:1": lambda number: gaussian(number, FLAT),
    "long 1:1:50": lambda number: gaussian(number, LONG, cells=(32, 32, 64), levels=2),
    "core with halo": core_with_halo,
}


def run(
    log2_particles: Annotated[int, "log₂ of the number of particles"] = 20,
    bunches: Annotated[tuple[str, ...], "which"] = tuple(BUNCHES),
    runs: Annotated[int, "calls that are timed"] = 3,
    steps: Annotated[int, "meshes of xfields, each with half the cells along an axis of the one before"] = 4,
) -> Iterator[Record]:
    """Yield CPU seconds of a call with error and cells, ours and xfields', and the ratio of seconds at equal error."""
    for name in bunches:
        bunch = BUNCHES[name](2**log2_particles)
        mine, widths = ours(name, bunch, runs)
        yield mine
        theirs = []
        for step in range(steps):
            theirs.append(of_xfields(name, bunch, widths * 2**step, runs))
            yield theirs[-1]
        seconds = at_error([one for one in theirs if one.seconds], mine.facts["error"])
        facts = {"seconds of xfields at our error": seconds, "times as fast": seconds / mine.median}
        yield Record(f"space charge, {name}, at equal error", mine.seconds, facts=facts)


def ours(name: str, bunch: Bunch, runs: int) -> tuple[Record, np.ndarray]:
    """Return the record of our calls, and the widths of our finest cells (3,) in m."""
    charges = amrpic.SpaceCharge(**QUIET, **bunch.settings)
    x, y, z = np.ascontiguousarray(bunch.places.T)
    charge = CHARGE / len(x)
    field = charges.field(x, y, z, charge)
    seconds = [taken(lambda: charges.field(x, y, z, charge)) for _ in range(runs)]
    mesh: Any = charges.hierarchy
    facts = {"error": bunch.error(field), "levels": mesh.levels}
    return Record(
        f"space charge, {name}, amrpic", seconds, cells=mesh.cells(), particles=len(x), facts=facts
    ), np.array(mesh.spacing(mesh.levels - 1))


def of_xfields(name: str, bunch: Bunch, widths: np.ndarray, runs: int) -> Record:
    """Return the record of xfields' FFT solver in cells about so wide (3,), m."""
    os.environ.setdefault("XSUITE_ALLOW_KERNEL_COMPILATION", "1")
    import xfields
    import xobjects

    reach = np.abs(bunch.places).max(axis=0) + 1.5 * widths
    cells = np.ceil(2 * reach / widths).astype(int)
    title = f"space charge, {name}, xfields {'x'.join(map(str, cells))}"
    if cells.max() > MOST_CELLS:
        return Record(title, [], facts={"skipped": f"more than {MOST_CELLS} cells along an axis"})
    ranges = dict(zip(("x_range", "y_range", "z_range"), zip(-reach, reach, strict=True), strict=True))
    numbers = dict(zip(("nx", "ny", "nz"), map(int, cells), strict=True))
    mesh = xfields.TriLinearInterpolatedFieldMap(
        _context=xobjects.ContextCpu(), solver="FFTSolver3D", **ranges, **numbers
    )
    x, y, z = np.ascontiguousarray(bunch.places.T)
    number = np.ones(len(x))

    def call() -> np.ndarray:
        mesh.update_from_particles(x_p=x, y_p=y, z_p=z, ncharges_p=number, q0_coulomb=CHARGE / len(x))
        return -np.stack(mesh.get_values_at_points(x, y, z, return_rho=False, return_phi=False), axis=1)

    facts = {"error": bunch.error(call())}
    seconds = [taken(call) for _ in range(runs)]
    return Record(title, seconds, cells=int(cells.prod()), particles=len(x), facts=facts)


def at_error(records: list[Record], error: float) -> float:
    """Return the seconds at an error: on the lines through the logarithms of those that were measured, fine ones first."""
    reached = [n for n, record in enumerate(records) if record.facts["error"] <= error]
    last = max(reached, default=0)  # the coarsest mesh that is as good, or the finest of all
    if last + 1 == len(records):
        return records[last].median
    fine, coarse = records[last], records[last + 1]
    factor = coarse.facts["error"] / fine.facts["error"]
    if factor <= 1:
        return float("inf")
    slope = np.log(coarse.median / fine.median) / np.log(factor)
    return float(fine.median * (error / fine.facts["error"]) ** slope)


def taken(work: Callable[[], Any]) -> float:
    """Return the CPU seconds of a call."""
    start = CPU_TIME()
    work()
    return CPU_TIME() - start
