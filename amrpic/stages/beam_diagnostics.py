"""What is measured of a beam: moments, emittances, Twiss parameters, halo and quantiles of groups of particles, and slices.

Pure reductions over all ranks, to rounding the same on any number of them. The formulas are in docs/theory.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _native
from ..mesh.domain import AXES, Domain
from ..mpi import MPI
from ..particles.groups import Groups, layers
from ..particles.images import NO_IMAGES, Images, periods
from ..particles.particles import Particles
from ..particles.thermal_equilibrium import ellipsoid_gradient, line_gradient, tune_depression
from ..units import SPEED_OF_LIGHT, Column

COORDINATES = ("x", "y", "z", "ux", "uy", "uz")  # u: momentum over m c, which is βγ along an axis
ENERGY = 6  # the coordinate behind them: kinetic energy
FRACTIONS = (0.5, 0.8, 0.9, 0.95, 0.99, 0.999, 0.9999, 1.0)  # of the particles
CLOUD = 4.0  # rms lengths on either side of the centre that slices reach
ROUNDING = 64 * float(np.finfo(float).eps)  # of <q^2><p^2>: a squared emittance below it is zero
UNKNOWN = math.nan

Array = NDArray[Any]
Value = tuple[Column, float]


@dataclass(frozen=True)
class Beam:
    """Particles, and the same ones `later`: momenta are the mean of both, in which those have this `weight`."""

    particles: Particles
    later: Particles
    weight: float = 0.0

    @property
    def arguments(self) -> tuple[Array, Array, Array, Array, Array, Array, float]:
        """The beam as native functions take it."""
        return (*self.particles.arrays, self.particles.mass, self.later.momentum, self.weight)


@dataclass(frozen=True)
class PartMoments:
    """Moments of a part of a beam, about its mean; nan where there are no particles.

    Coordinates are those of `COORDINATES` and the kinetic energy. Positions in m, momenta over m c, energy in J.
    """

    particles: int  # macroparticles
    weight: float  # real ones
    charge: float  # C
    mass: float  # kg, of one real particle; nan for several species
    flow: float  # C m/s: charge times velocity along z, that of each species
    momentum: np.ndarray  # (3,) kg m/s, of all together
    mean: np.ndarray  # (7,)
    covariance: np.ndarray  # (7, 7)
    planes: np.ndarray  # (3, 5, 5): <q^a p^b> with a + b <= 4, along each axis
    lowest: np.ndarray  # (7,)
    highest: np.ndarray  # (7,)
    images: Images = NO_IMAGES  # which places are those of, where space repeats

    @property
    def rms(self) -> np.ndarray:
        """Rms of the coordinates about their mean, (7,)."""
        # what rounding leaves of none may be below zero, as of a cold beam among test particles of another momentum
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def plane(self, axis: int) -> tuple[float, float, float]:
        """<q^2>, <q p> and <p^2> along an axis."""
        of = self.planes[axis]
        return float(of[2, 0]), float(of[1, 1]), float(of[0, 2])

    def emittance(self, axis: int) -> float:
        """Normalised rms emittance, m rad; zero if it is no more than rounding."""
        qq, qp, pp = self.plane(axis)
        if self.has_ellipse(axis):
            return math.sqrt(qq * pp - qp**2)
        return 0.0 if self.weight > 0 else UNKNOWN

    def has_ellipse(self, axis: int) -> bool:
        """Whether the emittance along an axis is more than rounding, so that there is an rms ellipse."""
        qq, qp, pp = self.plane(axis)
        return bool(qq * pp - qp**2 > ROUNDING * qq * pp)

    def twiss(self, axis: int) -> tuple[float, float, float]:
        """α, and β (m) and γ (1/m) of the ellipse in q and u, that is for βγ = 1; nan without an ellipse."""
        if not self.has_ellipse(axis):
            return UNKNOWN, UNKNOWN, UNKNOWN
        qq, qp, pp = (value / self.emittance(axis) for value in self.plane(axis))
        return -qp, qq, pp

    @property
    def speed(self) -> float:
        """βγ of the mean momentum; nan if there is none."""
        out = float(np.linalg.norm(self.mean[3:6]))
        return out if out > 0 else UNKNOWN

    def profile_halo(self, axis: int) -> float:
        """Halo parameter of the profile along an axis, <q^4> / <q^2>^2 - 2."""
        of = self.planes[axis]
        return _ratio(float(of[4, 0]), float(of[2, 0]) ** 2) - 2

    def phase_space_halo(self, axis: int) -> float:
        """Halo parameter in the plane along an axis, which no linear motion changes."""
        if not self.has_ellipse(axis):
            return UNKNOWN
        of = self.planes[axis]
        second = float(of[2, 0] * of[0, 2] - of[1, 1] ** 2)
        fourth = float(of[4, 0] * of[0, 4] + 3 * of[2, 2] ** 2 - 4 * of[1, 3] * of[3, 1])
        return _ratio(math.sqrt(max(3 * fourth, 0.0)), 2 * second) - 2

    @property
    def gamma(self) -> float:
        """Mean γ; nan for several species."""
        return 1 + float(self.mean[ENERGY]) / (self.mass * SPEED_OF_LIGHT**2)

    @property
    def frame_gamma(self) -> float:
        """γ of the frame in which the momentum along z is zero, of velocity <u_z>/<γ>; nan for several species.

        <γ>² - <u_z>² is summed up without their difference, which fast particles would round off.
        """
        of_gamma = self.covariance[ENERGY, ENERGY] / (self.mass * SPEED_OF_LIGHT**2) ** 2
        across = sum(self.mean[i] ** 2 + self.covariance[i, i] for i in (3, 4))
        return self.gamma / math.sqrt(max(1 + across + self.covariance[5, 5] - of_gamma, 1.0))

    def tune_depression(self, axis: int, period: float) -> float:
        """Tune depression across z of the matched beam with these moments; nan for several species or without a size.

        That of a continuous beam where z repeats after `period` m, else (infinity) that of an ellipsoid.
        """
        size, across, along = (float(self.rms[i]) for i in (axis, 1 - axis, 2))
        if not size > 0 or math.isnan(self.mass):
            return UNKNOWN
        frame = self.frame_gamma
        if math.isfinite(period):
            gradient = line_gradient(self.charge / period, size, across) / frame**2
        else:
            gradient = ellipsoid_gradient(self.charge, size, across, frame * along) / frame
        return tune_depression(self.emittance(axis), size, gradient, self.charge / self.weight, self.mass, self.gamma)


def _ratio(a: float, b: float) -> float:
    return a / b if b > 0 else UNKNOWN


# ---- moments ----


def group_moments(
    comm: MPI.Comm, beam: Beam, groups: Groups, domain: Domain | None = None
) -> dict[frozenset[int], PartMoments]:
    """Return the moments of each distinct group. Collective.

    The particles are read once. Where the domain is periodic, the images of a group's particles count that are nearest to its
    circular mean, see `Images`, and particles are read once more, and then once for each of the layers of groups.
    """
    runs = len(groups.starts)
    zeros = [0.0] * runs
    parts = _native.BeamParts(groups.starts, range(runs), zeros, zeros, 1)
    if domain is None or not any(domain.periodic):
        of_runs = _native.beam_moments(comm.py2f(), *beam.arguments, parts)
        return {
            members: _joined([(run, of_runs[run]) for run in sorted(members)], groups) for members in groups.distinct
        }
    circular = np.array(_native.circular_sums(comm.py2f(), *beam.arguments, parts, domain.lower, periods(domain)))
    images = {members: Images.of(circular[sorted(members)].sum(axis=0), domain) for members in groups.distinct}
    out = {}
    for layer in layers(groups.distinct):
        pieces, piece_of_run = _pieces(layer, groups)
        zeros = [0.0] * len(pieces)
        of_pieces = [images[layer[place]] for place, _ in pieces]
        parts = _native.BeamParts(groups.starts, piece_of_run, zeros, zeros, 1, *_centres_and_periods(of_pieces))
        sums = _native.beam_moments(comm.py2f(), *beam.arguments, parts)
        for place, members in enumerate(layer):
            own = [(run, sums[index]) for index, (at, run) in enumerate(pieces) if at == place]
            out[members] = _in_domain(_joined(own, groups), images[members], domain)
    return {members: out[members] for members in groups.distinct}


def moments_by_kind(
    comm: MPI.Comm, beam: Beam, groups: Groups, domain: Domain | None = None
) -> list[tuple[Beam, Groups, dict[frozenset[int], PartMoments]]]:
    """Return the moments of each distinct group, with the beam and the groups that they are of. Collective.

    Those of groups with test particles alone are by number: each weighs the same, without charge. The particles are then read
    once more.
    """
    moments = group_moments(comm, beam, groups, domain)
    tests = [members for members, part in moments.items() if part.particles > 0 and not part.weight > 0]
    weighed = {members: part for members, part in moments.items() if members not in tests}
    groups_found = [(beam, groups.only(list(weighed)), weighed)] if weighed else []
    if tests:
        ones = beam.particles.with_weight(np.broadcast_to(1.0, len(beam.particles)))
        by_number, of_tests = replace(beam, particles=ones), groups.only(tests)
        of_tests = replace(of_tests, species=tuple(replace(kind, charge=0.0) for kind in groups.species))
        groups_found.append((by_number, of_tests, group_moments(comm, by_number, of_tests, domain)))
    return groups_found


def _pieces(layer: Sequence[frozenset[int]], groups: Groups) -> tuple[list[tuple[int, int]], list[int]]:
    """Return the species of each group of a layer, apart since charges differ: (place in the layer, first run), and of each run
    in which of them it is; -1: in none."""
    pieces = [(place, run) for place, members in enumerate(layer) for run in _one_of_each(members, groups)]
    piece_of_run = [-1] * len(groups.starts)
    for index, (place, first) in enumerate(pieces):
        for run in layer[place]:
            if groups.species[run] == groups.species[first]:
                piece_of_run[run] = index
    return pieces, piece_of_run


def _centres_and_periods(images: Sequence[Images]) -> tuple[list[list[float]], list[list[float]]]:
    return [of.centre.tolist() for of in images], [of.period.tolist() for of in images]


def _in_domain(part: PartMoments, images: Images, domain: Domain) -> PartMoments:
    """Return a part that was measured about images with its mean in the domain."""
    if not part.weight > 0:
        return replace(part, images=images)
    about = images.about(part.mean[:3], domain)
    shift = np.concatenate([about.centre - images.centre, np.zeros(4)])
    return replace(part, mean=part.mean + shift, lowest=part.lowest + shift, highest=part.highest + shift, images=about)


def _joined(of_runs: Sequence[tuple[int, _native.BeamMoments]], groups: Groups) -> PartMoments:
    """Return the moments of some runs together; a run stands for all of its species here."""
    sums = _native.joined_moments([moments for _, moments in of_runs])
    with_charge = [(groups.species[run], moments) for run, moments in of_runs if moments.weight > 0]
    charge = sum(species.charge * moments.weight for species, moments in with_charge)
    flow = sum(
        species.charge * moments.weight * _velocity(moments.mean, species.mass) for species, moments in with_charge
    )
    kinds = {species for species, _ in with_charge}
    momentum = sum(
        (
            species.mass * SPEED_OF_LIGHT * moments.weight * np.array(moments.mean[3:6])
            for species, moments in with_charge
        ),
        start=np.zeros(3),
    )
    if not sums.weight > 0:
        unknown, square, planes = np.full(7, UNKNOWN), np.full((7, 7), UNKNOWN), np.full((3, 5, 5), UNKNOWN)
        return PartMoments(int(sums.count), 0.0, 0.0, UNKNOWN, 0.0, momentum, unknown, square, planes, unknown, unknown)
    return PartMoments(
        int(sums.count),
        sums.weight,
        charge,
        kinds.pop().mass if len(kinds) == 1 else UNKNOWN,
        flow,
        momentum,
        np.array(sums.mean),
        np.array(sums.second) / sums.weight,
        np.array(sums.planes) / sums.weight,
        np.array(sums.lowest),
        np.array(sums.highest),
    )


def _velocity(mean: Sequence[float], mass: float) -> float:
    """Return the velocity along z, m/s, of particles of a mass (kg) with these means (7,): c <u_z>/<γ>."""
    return SPEED_OF_LIGHT * mean[5] / (1 + mean[ENERGY] / (mass * SPEED_OF_LIGHT**2))


# ---- quantiles ----


@dataclass(frozen=True)
class Quantiles:
    """Amplitudes that hold the `FRACTIONS` of the particles of a group."""

    emittance: np.ndarray  # (3, fractions) m rad: normalised, of the ellipses like the rms one
    transverse: np.ndarray  # (fractions,) m: distance from the axis along z through the centre
    spatial: np.ndarray  # (fractions,) m: distance from the centre


def group_quantiles(
    comm: MPI.Comm, beam: Beam, groups: Groups, moments: dict[frozenset[int], PartMoments]
) -> dict[frozenset[int], Quantiles]:
    """Return the quantiles of each distinct group. Collective.

    Exact: each is the amplitude of a particle. No rank holds all of them.
    """
    distinct, parts = layers(groups.distinct), []
    for layer in distinct:
        zeros, images = [0.0] * len(layer), [moments[members].images for members in layer]
        places = _place_of_runs(layer, len(groups.starts))
        parts.append(_native.BeamParts(groups.starts, places, zeros, zeros, 1, *_centres_and_periods(images)))
    order = [members for layer in distinct for members in layer]
    centres, forms, typical = zip(*(_frame(moments[members]) for members in order), strict=True)
    flat = _native.amplitude_quantiles(comm.py2f(), *beam.arguments, parts, centres, forms, typical, FRACTIONS)
    quantiles = np.array(flat).reshape(len(order), 5, len(FRACTIONS))
    return {
        members: Quantiles(values[:3], values[3], values[4]) for members, values in zip(order, quantiles, strict=True)
    }


def _place_of_runs(layer: Sequence[frozenset[int]], runs: int) -> list[int]:
    """Return in which set of the layer each run is; -1: in none."""
    return [next((place for place, members in enumerate(layer) if run in members), -1) for run in range(runs)]


def _frame(part: PartMoments) -> tuple[list[float], list[tuple[float, float, float]], list[float]]:
    """Return what amplitudes of a part refer to: centre, the form γ q² + 2 α q u + β u² in each plane, typical values."""
    forms = []
    for axis in range(3):
        alpha, beta, gamma = part.twiss(axis)
        forms.append((gamma, 2 * alpha, beta))
    emittances = [part.emittance(axis) if part.has_ellipse(axis) else UNKNOWN for axis in range(3)]
    x, y, z = np.diag(part.covariance)[:3].tolist()
    return part.mean[:6].tolist(), forms, [*emittances, x + y, x + y + z]


# ---- slices ----


@dataclass(frozen=True)
class Slice:
    """A slice of a group along z."""

    lower: float  # m
    upper: float  # m
    part: PartMoments

    @property
    def charge_per_length(self) -> float:
        """C/m."""
        return self.part.charge / (self.upper - self.lower) if self.upper > self.lower else UNKNOWN

    @property
    def current(self) -> float:
        """A."""
        return self.part.flow / (self.upper - self.lower) if self.upper > self.lower else UNKNOWN


def group_slices(
    comm: MPI.Comm, beam: Beam, groups: Groups, moments: dict[frozenset[int], PartMoments], slices: int
) -> dict[frozenset[int], list[Slice]]:
    """Return slices of each distinct group, of equal length, from its lower end upwards. Collective.

    They reach over the group, but at most `CLOUD` rms lengths to either side of its centre, so that few particles far off do
    not make them long; those are counted in the outermost ones, so that nothing is missing in the sum over the slices.
    """
    out: dict[frozenset[int], list[Slice]] = {}
    for layer in layers(groups.distinct):
        pieces, piece_of_run = _pieces(layer, groups)
        edges = [_edges(moments[members], slices) for members in layer]
        lower = [edges[place][0] for place, _ in pieces]
        lengths = [edges[place][-1] - edges[place][0] for place, _ in pieces]
        per_length = [slices / length if length > 0 else 0.0 for length in lengths]
        images = _centres_and_periods([moments[layer[place]].images for place, _ in pieces])
        parts = _native.BeamParts(groups.starts, piece_of_run, lower, per_length, slices, *images)
        sums = _native.beam_moments(comm.py2f(), *beam.arguments, parts)
        for place, members in enumerate(layer):
            own = [(index, run) for index, (at, run) in enumerate(pieces) if at == place]
            out[members] = [
                Slice(
                    float(edges[place][s]),
                    float(edges[place][s + 1]),
                    _joined([(run, sums[index * slices + s]) for index, run in own], groups),
                )
                for s in range(slices)
            ]
    return out


def _one_of_each(members: Iterable[int], groups: Groups) -> list[int]:
    """Return the first run of each species among some runs."""
    first: dict[object, int] = {}
    for run in sorted(members):
        first.setdefault(groups.species[run], run)
    return list(first.values())


def _edges(part: PartMoments, slices: int) -> np.ndarray:
    if not part.weight > 0:
        return np.zeros(slices + 1)
    reach = CLOUD * part.rms[2]
    lower, upper = max(part.lowest[2], part.mean[2] - reach), min(part.highest[2], part.mean[2] + reach)
    return np.linspace(lower, upper, slices + 1)


# ---- losses ----


def group_losses(comm: MPI.Comm, lost: Particles, groups: Groups) -> dict[frozenset[int], tuple[int, float]]:
    """Return how many macroparticles of each distinct group are lost, and their charge in C. Collective."""
    run, count = groups.run_of(lost.id), len(groups.starts)
    own_sums = np.stack(
        [np.bincount(run, minlength=count), np.bincount(run, lost.weight * lost.charge, minlength=count)]
    )
    total = comm.allreduce(own_sums)
    return {
        members: (int(total[0, list(members)].sum()), float(total[1, list(members)].sum()))
        for members in groups.distinct
    }


# ---- tables ----


def group_values(
    part: PartMoments, quantiles: Quantiles, lost: tuple[int, float], period: float = math.inf
) -> list[Value]:
    """Return all that is measured of a group, in the order of its table; z repeats after `period` m."""
    return [
        (Column("particles", counts=True), part.particles),
        (Column("charge", "C"), part.charge),
        (Column("lost_particles", counts=True), lost[0]),
        (Column("lost_charge", "C"), lost[1]),
        *_energy(part),
        (Column("kinetic_energy", "J"), part.weight * part.mean[ENERGY] if part.weight > 0 else 0.0),
        *((Column(f"momentum_{axis}", "kg m/s"), part.momentum[i]) for i, axis in enumerate(AXES)),
        *_means_and_sizes(part),
        *_extremes(part),
        *_correlations(part),
        *(value for axis in range(3) for value in _ellipse(part, axis)),
        *((Column(f"tune_depression_{AXES[i]}"), part.tune_depression(i, period)) for i in range(2)),
        *(value for axis in range(3) for value in _fourth_moments(part, axis)),
        *(value for axis in range(3) for value in _halo(part, axis)),
        *(
            value
            for axis, values in zip(AXES, quantiles.emittance, strict=True)
            for value in _quantiles(f"emittance_{axis}", "m rad", values)
        ),
        *_quantiles("radius_xy", "m", quantiles.transverse),
        *_quantiles("radius_xyz", "m", quantiles.spatial),
    ]


def slice_values(of: Slice) -> list[Value]:
    """Return all that is measured of a slice, in the order of its table."""
    part = of.part
    return [
        (Column("lower", "m"), of.lower),
        (Column("upper", "m"), of.upper),
        (Column("particles", counts=True), part.particles),
        (Column("charge", "C"), part.charge),
        (Column("charge_per_length", "C/m"), of.charge_per_length),
        (Column("current", "A"), of.current),
        *_energy(part),
        *_means_and_sizes(part),
        *((Column(f"emittance_{axis}", "m rad"), part.emittance(i)) for i, axis in enumerate(AXES)),
    ]


def _unit(coordinate: str) -> str:
    return "m" if coordinate in AXES else ""


def _energy(part: PartMoments) -> list[Value]:
    return [
        (Column("mean_energy", "J"), part.mean[ENERGY]),  # kinetic, of one real particle
        (Column("rms_energy", "J"), part.rms[ENERGY]),
    ]


def _means_and_sizes(part: PartMoments) -> list[Value]:
    return [
        *((Column(f"mean_{name}", _unit(name)), part.mean[i]) for i, name in enumerate(COORDINATES)),
        *((Column(f"rms_{name}", _unit(name)), part.rms[i]) for i, name in enumerate(COORDINATES)),
    ]


def _extremes(part: PartMoments) -> list[Value]:
    return [
        value
        for i, axis in enumerate(AXES)
        for value in ((Column(f"min_{axis}", "m"), part.lowest[i]), (Column(f"max_{axis}", "m"), part.highest[i]))
    ]


def _correlations(part: PartMoments) -> list[Value]:
    """Return the covariances of different coordinates; variances are the squares of the sizes."""
    units = {0: "", 1: "m", 2: "m^2"}
    return [
        (
            Column(f"cov_{a}_{b}", units[sum(name in AXES for name in (a, b))]),
            part.covariance[i, i + 1 + j],
        )
        for i, a in enumerate(COORDINATES)
        for j, b in enumerate(COORDINATES[i + 1 :])
    ]


def _ellipse(part: PartMoments, axis: int) -> list[Value]:
    name, (alpha, beta, gamma) = AXES[axis], part.twiss(axis)
    return [
        (Column(f"emittance_{name}", "m rad"), part.emittance(axis)),
        (Column(f"geometric_emittance_{name}", "m rad"), part.emittance(axis) / part.speed),
        (Column(f"alpha_{name}"), alpha),
        (Column(f"beta_{name}", "m"), beta * part.speed),
        (Column(f"gamma_{name}", "1/m"), gamma / part.speed),
    ]


def _fourth_moments(part: PartMoments, axis: int) -> list[Value]:
    name, powers = AXES[axis], ((4, 0), (3, 1), (2, 2), (1, 3), (0, 4))
    units = ("m^4", "m^3", "m^2", "m", "")
    return [
        (Column(f"moment_{name * a}{f'u{name}' * b}", unit), part.planes[axis, a, b])
        for (a, b), unit in zip(powers, units, strict=True)
    ]


def _halo(part: PartMoments, axis: int) -> list[Value]:
    name = AXES[axis]
    return [
        (Column(f"halo_{name}"), part.profile_halo(axis)),
        (Column(f"phase_space_halo_{name}"), part.phase_space_halo(axis)),
    ]


def _quantiles(name: str, unit: str, values: np.ndarray) -> list[Value]:
    percent = (f"{100 * fraction:g}".replace(".", "_") for fraction in FRACTIONS)
    return [(Column(f"{name}_{text}", unit), value) for text, value in zip(percent, values, strict=True)]
