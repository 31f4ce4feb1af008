"""What the series of a run of material points has in a row: forces and work of faces, energies, extremes, effort."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..fem.points import HIGHEST_DEGREE
from ..mesh.domain import AXES, FACES
from ..mpi import MPI
from ..units import Column
from .conditions import body_force, held_by, nodes_of
from .damage import DamageReport, Settled
from .loads import Loads
from .material_points import PlacedPoints
from .scene import Scene
from .solid import Solid
from .state import LoadState, Plan

MOST_LOOSE = 0.05  # of the full elements
STAGES = ("sample", "migrate", "weigh", "equilibrium", "output")


def quantities(scene: Scene) -> Sequence[Column]:
    """Return the columns of the series."""
    joule = [
        *(f"work_{face}" for face in FACES),
        "work_gravity",
        "work",
        "stored",
        *(f"stored_{name}" for name in scene.materials),
        "dissipated",
        *(f"dissipated_{name}" for name in scene.materials),
        "gap",  # work less what is stored and dissipated
        "unbalanced",  # of that, what forces out of balance let go: those of points on a new mesh, where elements change
    ]
    effort = ("cuts", "turns", "newton_iterations", "newton_most", "cg_iterations", "cg_most")
    return (
        Column("step", counts=True),
        Column("load"),
        *(Column(f"travel_{axis}", "m") for axis in AXES),  # how much shorter the mesh is than at the start
        *(Column(f"force_{face}", "N") for face in FACES),  # along the axis, of the face on the body
        Column("floor_share"),  # of the forces of faces, by the floor stiffness
        *(Column(name, "J") for name in joule),
        *(Column(name) for name in ("j_min", "j_max", "damage_max", "damage_growth")),
        *(Column(name, counts=True) for name in ("points", "changed_rank", *effort)),
        Column("residual"),
        *(Column(name, counts=True) for name in degrees(scene)),  # elements with weights that are exact to a degree
        *(Column(f"seconds_{stage}", "s") for stage in STAGES),
        Column("seconds", "s"),
        Column("memory", "B"),
    )


def degrees(scene: Scene) -> list[str]:
    """Return the names of columns that count elements by the exactness of their weights."""
    highest = 2 * max(scene.domain.degree, scene.points.per_axis if scene.points.layout == "gauss" else 0) - 1
    return ["weights_are_volumes", *(f"weights_exact_to_{m}" for m in range(highest + 1))]


def loose_weights(placed: PlacedPoints) -> list[str]:
    """Return a sentence if weights of more than `MOST_LOOSE` of the full elements are not exact to their degree. Collective."""
    exact, degree = placed.weighed.exactness(), placed.mesh.degree
    full, loose = (sum(count for m, count in exact.items() if 0 <= m < most) for most in (HIGHEST_DEGREE + 1, degree))
    if loose <= MOST_LOOSE * full:
        return []
    return [
        f"{loose} of {full} full elements have points whose weights cannot be exact to degree {degree}: stresses there are off "
        "by 5 % and more on any mesh; give elements more points (points.per_axis)"
    ]


def at_rest(placed: PlacedPoints, plan: Plan) -> dict[str, float]:
    """Return what points by themselves say. Collective."""
    points, comm = placed.points, plan.comm
    j = points.j
    exact = placed.weighed.exactness()
    return {
        "points": comm.allreduce(len(points)),
        "j_min": comm.allreduce(float(j.min(initial=np.inf)), MPI.MIN),
        "j_max": comm.allreduce(float(j.max(initial=0)), MPI.MAX),
        "damage_max": comm.allreduce(float(points.damage.max(initial=0)), MPI.MAX),
        **{name: exact.get(number - 1, 0) for number, name in enumerate(degrees(plan.scene))},
    }


def measure(state: LoadState, loads: Loads, settled: Settled, report: DamageReport, plan: Plan) -> dict[str, float]:
    """Return the row of a step that led from a state to equilibrium. Collective.

    Work is since the start, by the mean of forces before and after a step; forces before it are those of the points on the
    present mesh.
    """
    scene, placed, u = plan.scene, state.placed, settled.displacement
    mesh, solid = placed.mesh, settled.solid
    fixed, values = held_by(scene, mesh, loads)
    loaded = [body_force(placed, plan, load) for load in (loads.begin, loads.end)]
    forces = [placed.solid.respond(0 * u).force - loaded[0], solid.respond(u).force - loaded[1]]
    mean = (forces[0] + forces[1]) / 2
    of_floor = placed.floor.respond(u).force if placed.floor is not None else np.zeros_like(u)
    faces = [(axis, nodes_of(mesh, axis, side)) for axis in range(3) for side in range(2)]  # in the order of FACES
    materials = len(scene.materials)
    total = _summed(
        plan.comm,
        force=[forces[1][on, axis].sum() for axis, on in faces],
        size=[np.abs(forces[1][on, axis]).sum() for axis, on in faces],
        floor=[np.abs(of_floor[on, axis]).sum() for axis, on in faces],
        work=[
            *((mean[on, axis] * values[on, axis]).sum() for axis, on in faces),
            ((loaded[0] + loaded[1]) / 2 * u).sum(),
        ],
        unbalanced=[-(mean * u)[~fixed].sum()],
        stored=_per_material(solid, solid.energies(u)[0], materials),
        dissipated=_per_material(solid, solid.dissipation(settled.damage), materials),
    )
    stored, dissipated = total["stored"], total["dissipated"]
    names = [*(f"work_{face}" for face in FACES), "work_gravity", "unbalanced"]
    done = zip(names, [*total["work"], *total["unbalanced"]], strict=True)
    totals = {name: state.measured.get(name, 0.0) + float(value) for name, value in done}
    all_work = sum(totals[name] for name in names[:-1])
    newton = [solved.iterations for solved in report.equilibria]
    cg = [count for solved in report.equilibria for count in solved.gradients]
    before, after = scene.extent(0.0), scene.extent(loads.end)
    shorter = (before[1] - before[0]) - (after[1] - after[0])
    return {
        "load": loads.end,
        **{f"travel_{axis}": float(shorter[d]) for d, axis in enumerate(AXES)},
        **{f"force_{face}": float(value) for face, value in zip(FACES, total["force"], strict=True)},
        "floor_share": float(total["floor"].sum() / (total["size"].sum() or 1)),
        **totals,
        "work": all_work,
        "stored": float(sum(stored)),
        **{f"stored_{name}": float(solved) for name, solved in zip(scene.materials, stored, strict=True)},
        "dissipated": float(sum(dissipated)),
        **{f"dissipated_{name}": float(solved) for name, solved in zip(scene.materials, dissipated, strict=True)},
        "gap": all_work - float(sum(stored)) - float(sum(dissipated)),
        "damage_growth": report.growth,
        "turns": report.turns,
        "newton_iterations": sum(newton),
        "newton_most": report.most_iterations,
        "cg_iterations": sum(cg),
        "cg_most": max(cg, default=0),
        "residual": report.residuals[-1],
    }


def _summed(comm: MPI.Comm, **parts: Sequence[float] | np.ndarray) -> dict[str, np.ndarray]:
    """The sums over ranks of several numbers each. Collective."""
    total = comm.allreduce(np.concatenate([np.asarray(values, dtype=np.float64) for values in parts.values()]))
    ends = np.cumsum([len(values) for values in parts.values()])
    return dict(zip(parts, np.split(total, ends[:-1]), strict=True))


def _per_material(solid: Solid, density: np.ndarray, count: int) -> np.ndarray:
    """The integrals of an energy density over the points of each material; the floor is none. Local."""
    return np.bincount(solid.material, solid.initial_volume * density, minlength=count)[:count]
