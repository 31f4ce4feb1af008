"""Solids between walls without friction, and what elasticity says of them in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from amrpic import fem, mpm
from amrpic.fem.conjugate_gradients import Coarse, Preconditioner
from amrpic.parallel import global_sum

Layout = Callable[[fem.Mesh], fem.Points]


def between_walls(mesh: fem.Mesh) -> np.ndarray:
    """Nodes (n, 3) whose displacement along an axis is given: those on the faces across it. Local."""
    return (mesh.node_indices == 0) | (mesh.node_indices == mesh.node_counts - 1)


def upper_face(mesh: fem.Mesh) -> np.ndarray:
    """Nodes on the upper face along z. Local."""
    return mesh.node_indices[:, 2] == mesh.node_counts[2] - 1


@dataclass(frozen=True)
class Pressed:
    """A block after confined compression: ranges of Cauchy's stress in Pa, work of the walls and stored energy in J."""

    axial: tuple[float, float]
    lateral: tuple[float, float]
    work: float
    energy: float
    iterations: int  # most of Newton's in a step


def confined(
    comm: MPI.Comm, law: mpm.Material, degree: int, layout: Layout, steps: int, height: float = 0.6
) -> Pressed:
    """Press a unit cube to `height` between walls without friction; the mesh is made anew for each step. Collective."""
    cells, base = (2, 2, 4), fem.Mesh(comm, 0, 1, (2, 2, 4), degree=degree)
    solid, work, most = mpm.Solid(layout(base), law), 0.0, 0
    for step in range(steps):
        before, after = (1 - (1 - height) * n / steps for n in (step, step + 1))
        mesh, top = solid.mesh, upper_face(solid.mesh)
        down = np.zeros((len(mesh.nodes), 3))
        down[top, 2] = after - before
        u, report = mpm.equilibrium(solid, fixed=between_walls(mesh), values=down, tolerance=1e-12)
        assert report.converged, report.reason
        forces = [global_sum(comm, float(solid.respond(v).force[top, 2].sum())) for v in (0 * u, u)]
        work += sum(forces) / 2 * (after - before)
        states, energy, most = solid.states(u), report.energy, max(most, report.iterations)
        solid = mpm.carried(solid, u, fem.Mesh(comm, 0, (1, 1, after), cells, degree=degree))
    stress = states.cauchy
    ranges = []
    for axis in (2, 0):
        least, largest = stress[:, axis, axis].min(initial=np.inf), stress[:, axis, axis].max(initial=-np.inf)
        ranges.append((comm.allreduce(float(least), op=MPI.MIN), comm.allreduce(float(largest), op=MPI.MAX)))
    return Pressed(ranges[0], ranges[1], work, energy, most)


def exact_stress(law: mpm.NeoHookean, height: float = 0.6) -> tuple[float, float]:
    """Cauchy's stress along the press and across it, in Pa: μ (s - 1/s) + λ ln s / s, and λ ln s / s."""
    volume = law.lame * np.log(height) / height
    return float(law.mu * (height - 1 / height) + volume), float(volume)


# ---- grains in a binder, with voids of sticky air ----


def structure(places: np.ndarray, grains: int = 60, voids: int = 14, seed: int = 7) -> np.ndarray:
    """The material of places (n, 3) in a unit cube: 0 in Voronoi's cells, 1 in the joints between them, 2 in round voids."""
    rng = np.random.default_rng(seed)
    centres, holes, radii = rng.uniform(size=(grains, 3)), rng.uniform(size=(voids, 3)), rng.uniform(0.06, 0.13, voids)
    near = cKDTree(centres).query(places, k=2)[0]
    out = np.where(near[:, 1] - near[:, 0] < 0.05, 1, 0)
    for hole, radius in zip(holes, radii, strict=True):
        out[((places - hole) ** 2).sum(axis=1) < radius**2] = 2
    return out


def first_tangent(
    comm: MPI.Comm, degree: int, cells: int, per_axis: int, air: float | None
) -> tuple[mpm.Tangent, np.ndarray, np.ndarray]:
    """The first tangent of a press, what is fixed, and where it goes; of grains alone without `air`, in Pa. Collective."""
    mesh = fem.Mesh(comm, 0, 1, cells, degree=degree)
    points = fem.jittered(mesh, per_axis, weights="volume")
    materials = [mpm.NeoHookean(4e9, 0.25), mpm.NeoHookean(300e6, 0.25), mpm.NeoHookean(air or 1.0, 0.0)]
    solid = mpm.Solid(points, materials, None if air is None else structure(points.position))
    values = np.zeros((len(mesh.nodes), 3))
    values[upper_face(mesh), 2] = -0.01
    return solid.tangent(0 * values), between_walls(mesh), values


def iterations(comm: MPI.Comm, degree: int, cells: int, per_axis: int, air: float | None) -> dict[str, int]:
    """Iterations of conjugate gradients to 1e-8, by preconditioner. Collective."""
    tangent, fixed, values = first_tangent(comm, degree, cells, per_axis, air)
    zero = np.zeros_like(values)

    def taken(preconditioner: Preconditioner, coarse: Coarse) -> int:
        _, report = fem.solve(
            tangent,
            zero,
            fixed=fixed,
            values=values,
            tolerance=1e-8,
            preconditioner=preconditioner,
            coarse=coarse,
        )
        assert report.converged, report.reason
        return report.iterations

    return {
        "geometric": taken("p-multigrid", "geometric"),
        "aggregation": taken("p-multigrid", "aggregation"),
        "jacobi": taken("jacobi", "geometric"),
    }
