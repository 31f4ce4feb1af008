"""A solid as its points carry it, and what a displacement of the mesh does to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError
from ..fem import Operator, Points
from ..fem.points import checked_vector, reals
from ..parallel import global_sum, together
from .materials import Material, NeoHookean

Form = Literal["initial", "current"]  # in the order of the native ones


@dataclass(frozen=True, eq=False)
class Response:
    """Internal `force` of this rank's nodes (nodes, 3) in N; of all ranks the `energy` in J and the smallest det F.

    Nothing but the last is of use unless that is positive.
    """

    force: np.ndarray
    energy: float
    smallest_j: float


@dataclass(frozen=True, eq=False)
class States:
    """What points have: F (n, 3, 3), det F (n,), Kirchhoff's stress (n, 3, 3) in Pa, energies (n,) in J per initial m³."""

    deformation: np.ndarray
    j: np.ndarray
    kirchhoff: np.ndarray
    energy: np.ndarray
    driving: np.ndarray  # what drives damage, zero without

    @property
    def cauchy(self) -> np.ndarray:
        """Cauchy's stress, (n, 3, 3) in Pa."""
        return self.kirchhoff / self.j[:, None, None]


class Tangent(Operator):
    """How internal forces change with the displacement: a symmetric operator of three components, N/m. See `Solid.tangent`."""

    def __init__(self, points: Points, native: _native.FemOperator) -> None:
        self.points, self.mesh, self.components, self.native = points, points.mesh, 3, native


class Solid:
    """Points with materials, in a mesh that has no displacement yet. Collective to make.

    `materials` are one or several, `material` (n,) says which each point has. Points carry their `deformation` F (n, 3, 3),
    1 if not given, `damage` (n,) from 0 to 1, and the largest `driving` energy they have seen, (n,) in J/m³. A displacement
    u (nodes, 3) in m is from the mesh as it is: F = (1 + ∇u) F of the point. A point's initial volume is its weight over its
    det F. Arrays are kept, not copied: leave them as they are.

    InputError on all ranks for arrays of other shapes, a material that does not exist, and det F that is not positive.
    """

    def __init__(
        self,
        points: Points,
        materials: Material | Sequence[Material],
        material: ArrayLike | None = None,
        *,
        deformation: ArrayLike | None = None,
        damage: ArrayLike | None = None,
        driving: ArrayLike | None = None,
    ) -> None:
        count = len(points)
        self.points, self.mesh = points, points.mesh
        with together(self.mesh.comm, InputError):
            self.materials = tuple(materials) if isinstance(materials, Sequence) else (materials,)
            numbers = np.zeros(count, dtype=np.int32) if material is None else np.asarray(material)
            self.material = np.ascontiguousarray(numbers, dtype=np.int32)
            unknown = (self.material < 0) | (self.material >= len(self.materials))
            if self.material.shape != (count,) or unknown.any():
                raise InputError(
                    f"material has shape {self.material.shape} and holds numbers that are no material's; give {count} "
                    f"numbers from 0 to {len(self.materials) - 1}"
                )
            unit = np.broadcast_to(np.eye(3), (count, 3, 3))
            self.deformation = _array(unit if deformation is None else deformation, (count, 3, 3), "deformation")
            self.damage = _array(np.zeros(count) if damage is None else damage, (count,), "damage")
            self.driving = _array(np.zeros(count) if driving is None else driving, (count,), "driving")
            if not ((j := self.j) > 0).all():
                first = int(np.argmin(j > 0))
                raise InputError(
                    f"point {int(points.number[first])} at {points.position[first]} m has det F = {j[first]}; it must be "
                    "positive"
                )
        laws = [m.native() for m in self.materials]
        self.native = _native.MpmSolid(points.native, laws, self.material, self.deformation.reshape(-1), self.damage)

    def with_damage(self, damage: np.ndarray, driving: np.ndarray) -> Solid:
        """Return the same solid with other damage and driving energy. Collective."""
        return Solid(
            self.points,
            self.materials,
            self.material,
            deformation=self.deformation,
            damage=damage,
            driving=driving,
        )

    @property
    def j(self) -> np.ndarray:
        """det F of the points as they are, (n,)."""
        return determinants(self.deformation)

    @property
    def initial_volume(self) -> np.ndarray:
        """Volumes that integrals are over, (n,) in m³."""
        return self.points.weight / self.j

    def respond(self, u: ArrayLike) -> Response:
        """Return internal forces and energy of a displacement. Collective. InputError on all ranks for another shape."""
        displacement, _ = checked_vector(self.mesh, u, "the displacement", 3)
        force, energy, smallest_j = self.native.respond(displacement)
        return Response(force.reshape(-1, 3), energy, smallest_j)

    def tangent(self, u: ArrayLike, form: Form = "current", stiffening: float = 0.0) -> Tangent:
        """Return how internal forces change at a displacement, where all det F must be positive. Collective.

        "current" and "initial" are the same operator; the latter has gradients in the mesh as it is, and neo-Hookean materials
        without damage alone. InputError on all ranks otherwise. With `stiffening` the operator is stiffer against rotation
        where stress compresses: by a part of what leaves no direction without stiffness.
        """
        displacement, _ = checked_vector(self.mesh, u, "the displacement", 3)
        with together(self.mesh.comm, InputError):
            if form not in get_args(Form):
                raise InputError(f'form is "{form}"; use {" or ".join(get_args(Form))}')
            plain = all(isinstance(m, NeoHookean) and m.damage is None for m in self.materials)
            if form == "initial" and not plain:
                raise InputError('form is "initial", which neo-Hookean materials without damage have; use "current"')
        return Tangent(self.points, self.native.tangent(displacement, get_args(Form).index(form), stiffening))

    def states(self, u: ArrayLike) -> States:
        """Return what points have at a displacement, where all det F must be positive. Collective."""
        whole, (energy, driving) = self.displaced(u), self.energies(u)
        stress = self.native.stresses(whole.reshape(-1)).reshape(-1, 3, 3)
        return States(whole, determinants(whole), stress, energy, driving)

    def displaced(self, u: ArrayLike) -> np.ndarray:
        """Return F of points at a displacement, (n, 3, 3). Collective. InputError on all ranks for another shape."""
        displacement, _ = checked_vector(self.mesh, u, "the displacement", 3)
        return self.native.deformation(displacement).reshape(-1, 3, 3)

    def energies(self, u: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return energies of points at a displacement and what drives damage, (n,) in J per initial m³. Collective.

        All det F must be positive. InputError on all ranks for another shape.
        """
        displacement, _ = checked_vector(self.mesh, u, "the displacement", 3)
        return self.native.energies(displacement)

    def dissipation(self, damage_at_nodes: ArrayLike) -> np.ndarray:
        """Return G/(2ℓ) (d² + ℓ² |∇d|²) of each point, (n,) in J per initial m³: what breaking took. Collective."""
        if not any(m.damage for m in self.materials):
            return np.zeros(len(self.points))
        d, slope = self.points.values(damage_at_nodes), self.points.slopes(damage_at_nodes)
        surface, length = self.surface_and_length()
        return np.asarray(surface / 2 * (d**2 + length**2 * (slope**2).sum(axis=1)))

    def dissipated(self, damage_at_nodes: ArrayLike) -> float:
        """Return the integral of `dissipation` over initial volumes, J. Collective."""
        return global_sum(self.mesh.comm, float(self.initial_volume @ self.dissipation(damage_at_nodes)))

    def surface_and_length(self) -> tuple[np.ndarray, np.ndarray]:
        """Return G/ℓ in J/m³ and ℓ in m of each point, zeros where its material does not break. Local."""
        of_damages = [
            (m.damage.toughness / m.damage.length, m.damage.length) if m.damage else (0.0, 0.0) for m in self.materials
        ]
        surface, length = np.array(of_damages)[self.material].T
        return np.ascontiguousarray(surface), np.ascontiguousarray(length)


def determinants(deformation: np.ndarray) -> np.ndarray:
    """Return det F of each point, (n,), for F (n, 3, 3). Local."""
    return _native.mpm_determinants(np.ascontiguousarray(deformation).reshape(-1))


def _array(values: ArrayLike, shape: tuple[int, ...], name: str) -> np.ndarray:
    array = reals(values, name, f"{shape} there")
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape} on a rank; give {shape} there")
    return array
