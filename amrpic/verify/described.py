"""The charge that a scene describes as a density in closed form, without the noise of particles, and its exact field."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from ..errors import InputError
from ..particles.distributions import halo_core
from ..scene.bunch_shapes import GaussianBunch, HaloBunch, KVBunch, SphereBunch
from ..scene.bunches import Bunch, LatticeBunch, Train
from ..scene.scene import Scene
from .known_charges import EPS0, Array, ChargedSphere, Density, GaussianCharge, Vector

ExactField = Callable[[Array, Array, Array], Vector]


@dataclass(frozen=True)
class Sum:
    """Several densities at once."""

    parts: tuple[Density, ...]

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        return sum((part.mean(x, y, z) for part in self.parts), np.zeros((len(x) - 1, len(y) - 1, len(z) - 1)))


@dataclass(frozen=True)
class Moved:
    """A density elsewhere."""

    density: Density
    by: tuple[float, float, float]  # m

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        return self.density.mean(x - self.by[0], y - self.by[1], z - self.by[2])


@dataclass(frozen=True)
class ChargedCylinder:
    """Constant density across an ellipse of semi-axes 2 sigma in x and y; even in |z| < √3 sigma, or normal along z."""

    sigma: tuple[float, float, float]  # m
    centre: tuple[float, float, float]  # m
    charge: float  # C
    normal_z: bool = False

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        """Chords along y, clipped to the cells, over 64 lines per cell; exact along z."""
        a, b = 2 * self.sigma[0], 2 * self.sigma[1]
        lines = (x[:-1, None] + np.diff(x)[:, None] * (np.arange(64) + 0.5) / 64 - self.centre[0]) / a
        half = b * np.sqrt(np.maximum(1 - lines**2, 0.0))[..., None]
        across = np.diff(np.clip(y - self.centre[1], -half, half), axis=-1).mean(axis=1) / np.diff(y) / (np.pi * a * b)
        s = (z - self.centre[2]) / self.sigma[2]
        below = erf(s / np.sqrt(2)) / 2 if self.normal_z else np.clip(s / (2 * np.sqrt(3)), -0.5, 0.5)
        return self.charge * across[..., None] * np.diff(below) / np.diff(z)


@dataclass(frozen=True)
class DisplacedLattice:
    """An even density in a cuboid, shifted along each axis by a sine along that axis: x = a + A sin(2π n a / L)."""

    lower: tuple[float, float, float]  # m
    upper: tuple[float, float, float]  # m
    displacement: tuple[float, float, float]  # A, m; so small that no two places meet
    waves: tuple[int, int, int]
    charge: float  # C

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        shares = [np.diff(self._origin(axis, edge)) / np.diff(edge) for axis, edge in enumerate((x, y, z))]
        return self._even * np.einsum("i,j,k->ijk", *shares)

    def field(self, x: Array, y: Array, z: Array) -> Vector:
        """E in V/m over a neutralizing background where one axis alone is shifted: Gauss's law, sheet by sheet."""
        return tuple(self._even / EPS0 * (self._origin(axis, s) - s) for axis, s in enumerate((x, y, z)))

    @property
    def one_axis(self) -> bool:
        return sum(a != 0 for a in self.displacement) <= 1

    @property
    def _even(self) -> float:
        return float(self.charge / np.prod(np.subtract(self.upper, self.lower)))

    def wave_numbers(self) -> Array:
        """2π n / L per axis, 1/m."""
        return 2 * np.pi * np.array(self.waves) / np.subtract(self.upper, self.lower)

    def _origin(self, axis: int, s: Array) -> Array:
        """Where what is at s came from."""
        lower = self.lower[axis]
        return lower + before_shift(s - lower, self.displacement[axis], self.wave_numbers()[axis])


def before_shift(s: Array, shift: float, k: float) -> Array:
    """The a of a + shift sin(k a) = s, by Newton's method; |k shift| < 1."""
    at = np.array(s, dtype=float)
    for _ in range(50):
        at = at - (at + shift * np.sin(k * at) - s) / (1 + shift * k * np.cos(k * at))
    return at


def density_of(scene: Scene) -> Density:
    """The density that the bunches of a scene make at its start.

    Raises InputError for a scene without charge, and for a distribution that has no formula here.
    """
    parts = tuple(part for number, bunch in enumerate(scene.bunches) for part in _parts(scene, bunch, number))
    if not parts:
        raise InputError(f"{scene.name} has no bunches, so there is no field to measure; add one")
    return Sum(parts)


def exact_field(scene: Scene, density: Density) -> ExactField | None:
    """The field of that density, if it is known in closed form or by quadrature with the faces that the scene has."""
    parts = density.parts if isinstance(density, Sum) else (density,)
    faces = {kind for pair in scene.domain.boundary.values() for kind in pair}
    if scene.solver.stretch != (1.0, 1.0, 1.0):
        return None
    if faces == {"open"} and all(isinstance(part, GaussianCharge | ChargedSphere) for part in parts):
        return lambda *place: _sum_of_fields(parts, *place)
    if faces == {"periodic"} and scene.background == "neutralizing" and len(parts) == 1:
        (lattice,) = parts
        if isinstance(lattice, DisplacedLattice) and lattice.one_axis:
            return lattice.field
    return None


def _sum_of_fields(parts: tuple[Density, ...], *place: Array) -> Vector:
    fields = [part.field(*place) for part in parts if isinstance(part, GaussianCharge | ChargedSphere)]
    return tuple(sum(field[axis] for field in fields) for axis in range(3))  # type: ignore[return-value]


def _parts(scene: Scene, bunch: Bunch, number: int) -> Iterator[Density]:
    match bunch:
        case Train() if bunch.zero_size():
            raise InputError(f"bunches.{number} has zero size, so that its field has no end; give it one")
        case Train():
            for place in bunch.places():
                yield from _train(bunch, number, place)
        case LatticeBunch():
            domain = scene.domain
            lattice = DisplacedLattice(domain.lower, domain.upper, bunch.displacement, bunch.waves, bunch.bunch_charge)
            if np.abs(lattice.wave_numbers() * np.array(bunch.displacement)).max() >= 1:
                raise InputError(f"bunches.{number}.displacement makes particles overtake each other; make it smaller")
            yield lattice
        case _:
            raise _without_formula(bunch, number)


def _train(bunch: Train, number: int, place: tuple[float, float, float]) -> Iterator[Density]:
    x, y, z = (plane.size for plane in bunch.planes)
    match bunch:
        case GaussianBunch():
            yield GaussianCharge((x, y, z), place, bunch.bunch_charge)
        case HaloBunch():
            core = halo_core(bunch.tail_share, bunch.tail_size)
            for size, share in ((core, 1 - bunch.tail_share), (core * bunch.tail_size, bunch.tail_share)):
                yield GaussianCharge((size * x, size * y, size * z), place, share * bunch.bunch_charge)
        case SphereBunch():
            yield ChargedSphere(bunch.radius, place, bunch.bunch_charge)
        case KVBunch():
            yield ChargedCylinder((x, y, z), place, bunch.bunch_charge, bunch.profile == "gaussian")
        case _:
            raise _without_formula(bunch, number)


def _without_formula(bunch: Bunch, number: int) -> InputError:
    kind = getattr(bunch, "distribution", type(bunch).__name__)
    return InputError(
        f"bunches.{number} is a {kind} bunch, whose density has no formula here; use gaussian, halo, sphere, kv or lattice"
    )
