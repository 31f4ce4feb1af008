"""Points that carry a solid: what they have, their way to the ranks of their elements, and their place in a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from mmap import MAP_ANONYMOUS, MAP_PRIVATE, mmap

import numpy as np
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError, ParticleError
from ..fem import Mesh, Points, gauss
from ..fem.full import WALLS
from ..fem.points import Weights
from ..mpi import MPI
from ..parallel import raise_together
from .materials import Material, NeoHookean
from .solid import Solid, determinants

AT_FACE = 1e-9  # parts of a mesh's size: so far outside points may be, by rounding and the solver's tolerance
FILLED = 0.05  # where the weights of its points add up to an element's volume so nearly it needs no floor
OWNERS = np.zeros(0, dtype=np.int64)  # in place of servers: points go to the ranks of their elements
NONE = np.zeros(0, dtype=np.int64)
Columns = dict[str, np.ndarray]  # of points, by their names in MaterialPoints


@dataclass(frozen=True, eq=False)
class MaterialPoints:
    """This rank's points, one entry or row each: all that a step hands to the next."""

    position: np.ndarray  # (n, 3) m
    id: np.ndarray  # (n,) int64, the number of the point at the start
    material: np.ndarray  # (n,) int32, an index of the scene's materials
    deformation: np.ndarray  # (n, 3, 3) F, since the start
    initial_volume: np.ndarray  # (n,) m³
    damage: np.ndarray  # (n,) from 0 to 1
    driving: np.ndarray  # (n,) J/m³, the largest driving energy that the point has seen

    def __len__(self) -> int:
        return len(self.id)

    @property
    def j(self) -> np.ndarray:
        """det F, (n,)."""
        return determinants(self.deformation)

    @property
    def volume(self) -> np.ndarray:
        """Present volumes, (n,) in m³."""
        return self.j * self.initial_volume

    def columns(self) -> Columns:
        """Return the arrays by their names, as checkpoints hold them and as they migrate."""
        return {name: getattr(self, name) for name in type(self).__dataclass_fields__}


def require_inside(columns: Columns, mesh: Mesh, load: float) -> None:
    """Put points on the mesh's faces, to rounding, into it. Collective.

    ParticleError on all ranks for one that is farther outside, or whose det F is not positive.
    """
    lower, upper = np.array(mesh.domain.lower), np.array(mesh.domain.upper)
    places, j = columns["position"], determinants(columns["deformation"])
    place = np.empty_like(places)
    far = AT_FACE * float((upper - lower).max())
    out = np.zeros(len(places), dtype=bool)
    for d in range(3):
        np.clip(places[:, d], lower[d], upper[d], out=place[:, d])
        out |= ~(np.abs(places[:, d] - place[:, d]) <= far)
    bad = np.flatnonzero(out | ~(j > 0))
    problem = None
    if len(bad):
        n = bad[0]
        why = "lies outside the mesh" if out[n] else "is turned inside out"
        at = ", ".join(f"{x:.6g}" for x in places[n])
        problem = (
            f"point {columns['id'][n]} at ({at}) m with det F = {j[n]:.4g} {why} at {load:.4g} of the load, as {len(bad)} do "
            "on a rank; take smaller steps, or enlarge the domain"
        )
    raise_together(mesh.comm, problem, ParticleError)
    columns["position"] = place


def migrate(columns: Columns, mesh: Mesh) -> tuple[MaterialPoints, int]:
    """Return the points of this rank's elements, by element and id, and how many came from other ranks. Collective.

    Nothing is left in `columns`: each is freed as soon as its values are in their places, so that not all are there twice, and
    F is written over where it has room for what comes.
    """
    places = np.asfortranarray(columns.pop("position"))
    plan = _native.Migration(
        mesh.hierarchy.particle_mesh,
        OWNERS,
        places,
        places,  # in place of momenta, which these points do not have
        np.ascontiguousarray(columns.pop("initial_volume")),
        np.ascontiguousarray(columns.pop("id")),
        NONE,
        has_weights=True,
    )
    del places
    count, arrived = plan.arriving, plan.from_others
    place, volume, number = np.empty((3, count)).T, np.empty(count), np.empty(count, dtype=np.int64)
    finite = plan.start(place, place, volume, number)
    plan.receive(place, place, volume, number)
    raise_together(mesh.comm, None if finite and not len(plan.lost) else "points are not in the mesh", ParticleError)
    place = np.ascontiguousarray(place)
    order = np.lexsort((number, mesh.native.locate(place)[0]))
    place, volume, number = place[order], volume[order], number[order]

    def carried(column: np.ndarray) -> np.ndarray:
        deformations = np.empty((1, count))
        plan.carry(np.ascontiguousarray(column, dtype=np.float64)[None], deformations)
        return deformations[0, order]

    before = np.ascontiguousarray(columns.pop("deformation"))
    deformations = before[:count] if count <= len(before) else np.empty((count, 3, 3))
    for i, j in np.ndindex(3, 3):
        deformations[:, i, j] = carried(before[:, i, j])
    del before
    material = carried(columns.pop("material")).astype(np.int32)
    damage, driving = (
        carried(column) if mesh.comm.allreduce(column.any(), MPI.LOR) else _zeros(count)
        for column in (columns.pop("damage"), columns.pop("driving"))
    )
    return MaterialPoints(place, number, material, deformations, volume, damage, driving), arrived


def _zeros(count: int) -> np.ndarray:
    """Zeros (count,) that take no memory until they are written: no page of them is there. Local."""
    return np.frombuffer(mmap(-1, max(8 * count, 1), flags=MAP_PRIVATE | MAP_ANONYMOUS), count=count)


@dataclass(frozen=True, eq=False)
class PlacedPoints:
    """Points in a mesh that has no displacement: the solid that they are, with what fills elements where they are too few."""

    points: MaterialPoints
    solid: Solid
    body: np.ndarray | slice  # which of the solid's points these are; the others are of the floor stiffness
    weighed: Points  # the points alone
    floor: Solid | None = None  # the others alone, if there are any

    @property
    def mesh(self) -> Mesh:
        """The mesh."""
        return self.solid.mesh


def enough(degree: int) -> int:
    """Return the least number of points by which an element's stiffness has its full rank: each gives six stresses."""
    return -(-(3 * (degree + 1) ** 3 - 6) // 6)


def placed(
    points: MaterialPoints,
    mesh: Mesh,
    materials: list[Material],
    weights: Weights,
    floor_stiffness: float = 0.0,
    free: ArrayLike = WALLS,
) -> PlacedPoints:
    """Return points that are sorted by element and id as a solid in a mesh. Collective.

    Elements with points of several materials keep volumes as weights: no polynomial follows the jumps of stress there, and
    weights that change from step to step move forces about. Elements that they do not fill, or in which they are too few, get
    Gauss's points of a weak solid without Poisson's effect; InputError on all ranks for such elements if there is no floor
    stiffness.
    """
    element, reference = mesh.native.locate(points.position)
    rough = _several(element, points.material, len(mesh.elements))
    weighed = Points(mesh, element, reference, lambda: points.volume, points.id, weights, rough=rough, free=free)
    weight = np.bincount(element, weighed.weight, len(mesh.elements))
    points_of_elements = weighed.held
    poor = points_of_elements < enough(mesh.degree)
    if floor_stiffness == 0:
        _require_enough(mesh, points_of_elements, poor)
    carried = (points.material, points.deformation, points.damage, points.driving)
    thin = np.flatnonzero(poor | (np.abs(weight - mesh.element_volume) > FILLED * mesh.element_volume))
    filled_elements = int(mesh.comm.allreduce(len(thin) if floor_stiffness > 0 else 0))
    if filled_elements == 0:
        material, deformation, damage, driving = carried
        solid = Solid(weighed, materials, material, deformation=deformation, damage=damage, driving=driving)
        return PlacedPoints(points, solid, slice(None), weighed)
    rule, weak = gauss(mesh), NeoHookean(floor_stiffness, 0.0)
    of_floor = np.isin(rule.element, thin)
    added, no_ids = int(of_floor.sum()), np.full(of_floor.sum(), -1)
    order = np.argsort(np.concatenate([element, rule.element[of_floor]]), kind="stable")

    def joined(own: np.ndarray, floor: np.ndarray) -> np.ndarray:
        return np.concatenate([own, floor])[order]

    all_points = Points(
        mesh,
        joined(element, rule.element[of_floor]),
        joined(reference, rule.reference[of_floor]),
        joined(points.volume, rule.volume[of_floor]),
        joined(points.id, no_ids),
        weight=joined(weighed.weight, rule.weight[of_floor]),
    )
    solid = Solid(
        all_points,
        [*materials, weak],
        joined(points.material, np.full(added, len(materials))),
        deformation=joined(points.deformation, np.broadcast_to(np.eye(3), (added, 3, 3))),
        damage=joined(points.damage, np.zeros(added)),
        driving=joined(points.driving, np.zeros(added)),
    )
    own = (rule.element[of_floor], rule.reference[of_floor], rule.volume[of_floor], no_ids)
    floor = Solid(Points(mesh, *own, weight=rule.weight[of_floor]), weak)
    return PlacedPoints(points, solid, np.argsort(order)[: len(points)], weighed, floor)


def _several(element: np.ndarray, material: np.ndarray, count: int) -> np.ndarray:
    """Which elements have points, sorted by these, of several materials, (count,). Local."""
    out = np.zeros(count, dtype=bool)
    out[element[1:][(np.diff(element) == 0) & (np.diff(material) != 0)]] = True
    return out


def _require_enough(mesh: Mesh, counts: np.ndarray, poor: np.ndarray) -> None:
    """Raise InputError on all ranks if elements have too few points. Collective."""
    first = int(np.argmax(poor)) if poor.any() else 0
    raise_together(
        mesh.comm,
        f"element {mesh.elements[first].tolist()} has {counts[first]} points, fewer than the {enough(mesh.degree)} that degree "
        f"{mesh.degree} needs, and is one of {int(poor.sum())} such on a rank; "
        "set floor_stiffness, or fill it with a soft material"
        if poor.any()
        else None,
        InputError,
    )
