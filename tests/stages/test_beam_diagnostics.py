"""Diagnostics of groups of particles against NumPy on all particles, and against exact values of known distributions."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from mpi4py import MPI
from scipy.stats import qmc

from amrpic import Domain
from amrpic.particles import distributions
from amrpic.particles.groups import Groups, NamedBunches, layers
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from amrpic.stages import beam_diagnostics as diagnostics
from amrpic.stages.beam_diagnostics import FRACTIONS, Beam
from amrpic.units import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY

ELECTRON, PROTON = SPECIES["electron"], SPECIES["proton"]
TABLE = SpeciesTable.of_runs([(0, ELECTRON), (900, PROTON), (1500, ELECTRON)])
BUNCHES = [NamedBunches("", 1, 900), NamedBunches("pair", 2, 300), NamedBunches("", 1, 503)]
COUNT = 2003


def share(comm, values):
    """This rank's part of what all ranks hold together, in a mixed order."""
    return values[comm.rank :: comm.size]


def phase_space(seed=7):
    """Places (n, 3), momenta over m c (n, 3), weights (n,) of all ranks, far off the origin, with a few far out."""
    random = np.random.default_rng(seed)
    x, u = np.array([1e-3, 2e-3, 5e-3]) * random.normal(size=(COUNT, 3)), 1e-2 * random.normal(size=(COUNT, 3))
    u += 3 * x + [0, 0.1, 2]
    x[::400] *= 50
    return x + np.array([3, -2, 100]), u, 0.5 + random.random(COUNT)


def beam_of(comm, x, u, weight, table=TABLE, order=None):
    ids = np.arange(len(x)) if order is None else order
    masses = table.masses[table.find(ids)]
    momentum = u[ids] * (masses * SPEED_OF_LIGHT)[:, None]
    mine = [share(comm, a) for a in (x[ids], momentum, np.broadcast_to(weight, len(x))[ids], ids)]
    # Momenta of two times whose mean, a quarter of the way, are those meant.
    early, later = mine[1] - 0.01 * np.abs(mine[1]), mine[1] + 0.03 * np.abs(mine[1])
    particles = Particles(mine[0], early, mine[2], mine[3], table)
    return Beam(particles, particles.replace(momentum=later), 0.25)


def measured(comm, beam, groups):
    moments = diagnostics.group_moments(comm, beam, groups)
    return moments, diagnostics.group_quantiles(comm, beam, groups, moments)


def weighted_quantiles(values, weight):
    order = np.argsort(values)
    reached = np.cumsum(weight[order]) / weight.sum()
    return [values[order][min(np.searchsorted(reached, f - 1e-12), len(values) - 1)] for f in FRACTIONS]


@pytest.mark.mpi(ranks=(1, 2, 3, 4))
def test_groups_are_measured_as_numpy_does_it_on_all_particles(comm):
    x, u, weight = phase_space()
    groups = Groups.of(TABLE, BUNCHES)
    moments, quantiles = measured(
        comm, beam_of(comm, x, u, weight, order=np.random.default_rng(3).permutation(COUNT)), groups
    )
    ids = {
        "all": np.arange(COUNT),
        "electron": np.r_[0:900, 1500:COUNT],
        "proton": np.arange(900, 1500),
        "bunch_0": np.arange(900),
        "pair_0": np.arange(900, 1200),
        "pair_1": np.arange(1200, 1500),
        "bunch_2": np.arange(1500, COUNT),
    }
    assert groups.names == tuple(ids)
    mass = TABLE.masses[TABLE.find(np.arange(COUNT))]
    charge = TABLE.charges[TABLE.find(np.arange(COUNT))]
    for (name, chosen), members in zip(ids.items(), groups.members, strict=True):
        part, found = moments[members], quantiles[members]
        w = weight[chosen].astype(np.longdouble)
        gamma = np.sqrt(1 + (u[chosen].astype(np.longdouble) ** 2).sum(axis=1))
        energy = (gamma - 1) * mass[chosen] * SPEED_OF_LIGHT**2
        coordinates = np.column_stack([x[chosen], u[chosen], energy]).astype(np.longdouble)
        mean = np.average(coordinates, axis=0, weights=w)
        deviation = coordinates - mean
        covariance = (deviation * w[:, None]).T @ deviation / w.sum()
        scale = np.sqrt(np.diag(covariance))
        assert part.particles == len(chosen)
        assert part.weight == pytest.approx(float(w.sum()), rel=1e-14)
        assert part.charge == pytest.approx(float(weight[chosen] @ charge[chosen]), rel=1e-13)
        np.testing.assert_allclose(
            part.momentum,
            (weight * mass)[chosen] @ u[chosen] * SPEED_OF_LIGHT,
            rtol=0,
            atol=1e-13 * np.abs(part.momentum).max(),
        )
        np.testing.assert_allclose(part.mean, mean.astype(float), rtol=1e-13, atol=0)
        # Momenta are given as mean of two that are rounded.
        np.testing.assert_allclose(
            part.covariance / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=2e-11
        )
        np.testing.assert_allclose(part.lowest[:3], x[chosen].min(axis=0), rtol=0)
        np.testing.assert_allclose(part.highest[:3], x[chosen].max(axis=0), rtol=0)
        for axis in range(3):
            q, p = deviation[:, axis], deviation[:, axis + 3]
            for a in range(5):
                for b in range(5 - a):
                    size = scale[axis] ** a * scale[axis + 3] ** b
                    exact = float((w * q**a * p**b).sum() / w.sum() / size)
                    spread = float((w * np.abs(q**a * p**b)).sum() / w.sum() / size)
                    assert part.planes[axis, a, b] / size == pytest.approx(exact, rel=0, abs=2e-10 * spread), (
                        name,
                        a,
                        b,
                    )
            emittance = part.emittance(axis)
            qq, qp, pp = (float(covariance[i, j]) for i, j in ((axis, axis), (axis, axis + 3), (axis + 3, axis + 3)))
            assert emittance == pytest.approx((qq * pp - qp**2) ** 0.5, rel=1e-9)
            form = ((pp * q * q - 2 * qp * q * p + qq * p * p) / emittance).astype(float)
            np.testing.assert_allclose(found.emittance[axis], weighted_quantiles(form, weight[chosen]), rtol=1e-7)
        radius = np.hypot(deviation[:, 0].astype(float), deviation[:, 1].astype(float))
        np.testing.assert_allclose(found.transverse, weighted_quantiles(radius, weight[chosen]), rtol=1e-10)
        distance = np.linalg.norm(deviation[:, :3].astype(float), axis=1)
        np.testing.assert_allclose(found.spatial, weighted_quantiles(distance, weight[chosen]), rtol=1e-10)


@pytest.mark.mpi(ranks=(2, 3, 4))
def test_any_number_of_ranks_finds_the_same_to_rounding(comm):
    from mpi4py import MPI

    groups = Groups.of(TABLE, BUNCHES)
    for weight in (phase_space()[2], 3.0):
        x, u, _ = phase_space()
        rows = []
        for ranks in (comm, MPI.COMM_SELF):
            beam = beam_of(ranks, x, u, weight)
            moments, quantiles = measured(ranks, beam, groups)
            lost = diagnostics.group_losses(ranks, beam.particles, groups)
            slices = diagnostics.group_slices(ranks, beam, groups, moments, 7)
            values = [diagnostics.group_values(moments[m], quantiles[m], lost[m]) for m in groups.members]
            of_slices = [diagnostics.slice_values(one) for m in groups.members for one in slices[m]]
            rows.append([np.array([[value for _, value in row] for row in table]) for table in (values, of_slices)])
        for here, alone in zip(*rows, strict=True):
            scale = np.nanmax(np.abs(alone), axis=0)
            np.testing.assert_allclose(here / scale, alone / scale, rtol=1e-9, atol=1e-11)


@pytest.mark.mpi(ranks=(1, 3))
def test_slices_hold_all_of_the_charge_and_are_those_of_numpy(comm):
    x, u, weight = phase_space()
    groups = Groups.of(TABLE, BUNCHES)
    beam = beam_of(comm, x, u, weight)
    moments = diagnostics.group_moments(comm, beam, groups)
    slices = diagnostics.group_slices(comm, beam, groups, moments, 9)
    kind = TABLE.find(np.arange(COUNT))
    everything = slices[groups.members[0]]
    part = moments[groups.members[0]]
    assert sum(one.part.particles for one in everything) == COUNT
    assert sum(one.part.charge for one in everything) == pytest.approx(part.charge, rel=1e-12)
    edges = [one.lower for one in everything] + [everything[-1].upper]
    reach = 4 * part.rms[2]
    assert (edges[0], edges[-1]) == pytest.approx((part.mean[2] - reach, part.mean[2] + reach), rel=1e-12)
    place = np.clip(np.searchsorted(edges, x[:, 2], side="right") - 1, 0, 8)
    for number, one in enumerate(everything):
        inside = place == number
        assert one.part.particles == inside.sum()
        if not inside.any():
            continue
        np.testing.assert_allclose(
            one.part.mean[:2], np.average(x[inside, :2], axis=0, weights=weight[inside]), rtol=1e-13
        )
        current = 0.0
        for species in (0, 1):
            of = inside & (kind == species)
            if of.any():
                gamma = np.sqrt(1 + (u[of] ** 2).sum(axis=1))
                current += TABLE.charges[species] * (weight[of] @ (u[of, 2] / gamma)) * SPEED_OF_LIGHT
        assert one.current == pytest.approx(current / (edges[1] - edges[0]), rel=2e-4)  # both of small spreads


@pytest.mark.parametrize("period", [0.5, math.inf])
def test_tune_depression_and_current_of_a_warm_beam_follow_from_its_mean_velocity(period):
    """k²/k0² = T/(T + S), T = <p_x v_x>, S = q <x E_x> (1 - V²/c²) of charge that moves with its mean velocity V. Of an
    elliptic beam <x E_x> is λ σ_x / (4π ε0 (σ_x + σ_y)) (Sacherer); what is a ball in its frame has E_x = γ Q x / (4π ε0 R³).
    """
    random = np.random.default_rng(11)
    u = random.normal(size=(4000, 3)).clip(-4, 4) * (1.5, 1.2, 0.5) + (0, 0, 30)
    gamma = np.sqrt(1 + (u**2).sum(axis=1))
    speed = (u[:, 2] / gamma).mean()
    boost = 1 / math.sqrt(1 - speed**2)
    x = random.normal(size=(4000, 3))
    x *= (random.random(4000) ** (1 / 3) / np.linalg.norm(x, axis=1))[:, None] * (1e-3, 1e-3, 1e-3 / boost)
    if math.isfinite(period):
        x[:, 1] *= 1.5
        sizes = x[:, :2].std(axis=0)
        of_charge = sizes[0] / (4 * np.pi * VACUUM_PERMITTIVITY * sizes.sum() * period)
    else:
        of_charge = boost * x[:, 0].var() / (4 * np.pi * VACUUM_PERMITTIVITY * 1e-9)
    warmth = ELECTRON.mass * SPEED_OF_LIGHT**2 * (u[:, 0] ** 2 / gamma).mean()
    charge = 2 * warmth / (ELECTRON.charge * of_charge * (1 - speed**2))  # S = 2 T
    table = SpeciesTable((ELECTRON,))
    weight = np.full(len(x), charge / ELECTRON.charge / len(x))
    particles = Particles(x, u * ELECTRON.mass * SPEED_OF_LIGHT, weight, np.arange(len(x)), table)
    groups, beam = Groups.of(table), Beam(particles, particles)
    moments = diagnostics.group_moments(MPI.COMM_SELF, beam, groups)
    part = moments[groups.members[0]]
    assert part.tune_depression(0, period) == pytest.approx(math.sqrt(1 / 3), rel=0.01)
    (whole,) = diagnostics.group_slices(MPI.COMM_SELF, beam, groups, moments, 1)[groups.members[0]]
    assert whole.current * (whole.upper - whole.lower) == pytest.approx(charge * speed * SPEED_OF_LIGHT, rel=1e-5)


def test_gamma_of_the_frame_keeps_its_digits_at_any_speed():
    """Of two electrons across whose momenta cancel, u_x = ± 2, it is γ/√5, to γ of 2e7."""
    table = SpeciesTable((ELECTRON,))
    for along in (0.0, 1.0, 1e3, 2e7):
        u = np.array([[2.0, 0, along], [-2.0, 0, along]])
        particles = Particles(np.eye(3)[:2], u * ELECTRON.mass * SPEED_OF_LIGHT, np.ones(2), np.arange(2), table)
        groups = Groups.of(table)
        part = diagnostics.group_moments(MPI.COMM_SELF, Beam(particles, particles), groups)[groups.members[0]]
        assert part.gamma == pytest.approx(math.sqrt(5 + along**2), rel=1e-12)
        assert part.frame_gamma == pytest.approx(math.sqrt(5 + along**2) / math.sqrt(5), rel=1e-9)


def unit_beam(comm, name, count=2**15, **options):
    """A quiet bunch of a distribution in unit form, sheared in all planes: the halo of phase space does not see that."""
    numbers = np.clip(qmc.Sobol(distributions.DRAWS, seed=1).random(count), 1e-12, 1 - 1e-12).T
    unit = getattr(distributions, name)(numbers, **options)
    x, u = 1e-3 * unit[:3].T, 1e-3 * unit[3:].T + 0.7e-3 * unit[:3].T
    table = SpeciesTable((ELECTRON,))
    return beam_of(comm, x, u, 1.0, table), Groups.of(table)


@pytest.mark.parametrize(
    ("name", "options", "profile", "phase_space"),
    [
        ("gaussian", {}, 1.0, 1.0),
        ("kapchinsky_vladimirsky", {"normal_z": True}, 0.0, 0.0),
        ("waterbag", {}, 0.4, 0.4),  # six-dimensional: <x^4> = 12/5 <x^2>^2
    ],
)
def test_halo_parameters_of_known_distributions(comm, name, options, profile, phase_space):
    beam, groups = unit_beam(comm, name, **options)
    part = diagnostics.group_moments(comm, beam, groups)[groups.members[0]]
    for axis in (0, 1):
        assert part.profile_halo(axis) == pytest.approx(profile, abs=0.02)
        assert part.phase_space_halo(axis) == pytest.approx(phase_space, abs=0.02)


def test_halo_parameters_of_a_waterbag_in_four_dimensions(comm):
    numbers = np.clip(qmc.Sobol(distributions.DRAWS, seed=1).random(2**15), 1e-12, 1 - 1e-12).T
    shell = distributions.kapchinsky_vladimirsky(numbers, normal_z=True)
    unit = np.sqrt(1.5) * numbers[5] ** 0.25 * shell  # the ball is filled evenly where the share of its volume is even
    table = SpeciesTable((ELECTRON,))
    beam, groups = beam_of(comm, 1e-3 * unit[:3].T, 1e-3 * unit[3:].T, 1.0, table), Groups.of(table)
    part = diagnostics.group_moments(comm, beam, groups)[groups.members[0]]
    for axis in (0, 1):
        assert part.profile_halo(axis) == pytest.approx(0.25, abs=0.02)
        assert part.phase_space_halo(axis) == pytest.approx(0.25, abs=0.02)


def test_profile_halo_of_a_sphere_is_one_seventh(comm):
    beam, groups = unit_beam(comm, "ball")
    part = diagnostics.group_moments(comm, beam, groups)[groups.members[0]]
    assert [part.profile_halo(axis) for axis in range(3)] == pytest.approx([1 / 7] * 3, abs=5e-3)


def test_emittances_and_radii_of_known_distributions(comm):
    beam, groups = unit_beam(comm, "gaussian", 2**17)
    moments, quantiles = measured(comm, beam, groups)
    part, found = moments[groups.members[0]], quantiles[groups.members[0]]
    fractions = np.array(FRACTIONS[:5])
    for axis in range(3):
        # A normal plane: the invariant over the emittance is exponential with mean 2.
        np.testing.assert_allclose(
            found.emittance[axis, :5] / part.emittance(axis), -2 * np.log(1 - fractions), rtol=0.02
        )
        assert part.emittance(axis) == pytest.approx(1e-6, rel=2e-3)
        alpha, beta, gamma = part.twiss(axis)
        assert (alpha, beta) == pytest.approx((-0.7, 1.0), rel=5e-3)
        assert beta * gamma - alpha**2 == pytest.approx(1, rel=1e-9)
    np.testing.assert_allclose(found.transverse[:5], 1e-3 * np.sqrt(-2 * np.log(1 - fractions)), rtol=0.01)
    beam, groups = unit_beam(comm, "kapchinsky_vladimirsky", normal_z=True)
    moments, quantiles = measured(comm, beam, groups)
    part, found = moments[groups.members[0]], quantiles[groups.members[0]]
    for axis in (0, 1):  # a disc filled evenly, whose area over π is four rms emittances
        np.testing.assert_allclose(found.emittance[axis] / part.emittance(axis), 4 * np.array(FRACTIONS), rtol=5e-3)
    beam, groups = unit_beam(comm, "ball")
    found = measured(comm, beam, groups)[1][groups.members[0]]
    np.testing.assert_allclose(found.spatial, 5**0.5 * 1e-3 * np.cbrt(FRACTIONS), rtol=2e-3)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(
    ("count", "sizes", "momenta"),
    [
        (0, 1, 1),  # no particle
        (1, 1, 1),
        (2, 1, 1),
        (100, (0, 1, 1), 1),  # no size along x
        (100, 0, 0),  # all in one point of phase space
        (100, 1, 0),  # cold
        (100, 1e-60, 1e-60),
    ],
)
def test_degenerate_beams_have_honest_values(comm, count, sizes, momenta):
    random = np.random.default_rng(2)
    x, u = np.array(sizes) * random.normal(size=(count, 3)), np.array(momenta) * random.normal(size=(count, 3))
    table = SpeciesTable((ELECTRON,))
    groups = Groups.of(table)
    members = groups.members[0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        beam = beam_of(comm, x, u, 2.0, table)
        moments, quantiles = measured(comm, beam, groups)
        losses = diagnostics.group_losses(comm, beam.particles, groups)
        values = diagnostics.group_values(moments[members], quantiles[members], losses[members])
        slices = diagnostics.group_slices(comm, beam, groups, moments, 3)[members]
        found = {column.name: value for column, value in values}
        assert len(found) == len(values)
        of_slices = [diagnostics.slice_values(one) for one in slices]
    assert found["particles"] == count == sum(one.part.particles for one in slices) == found["lost_particles"]
    assert found["charge"] == pytest.approx(2 * count * ELECTRON.charge, abs=0) or count == 0
    assert all(math.isnan(value) or math.isfinite(value) for row in [values, *of_slices] for _, value in row)
    if count == 0:
        assert math.isnan(found["rms_x"]) and found["charge"] == 0 and found["kinetic_energy"] == 0
        return
    point = count == 1 or np.all(np.array(sizes) == 0)
    assert (found["rms_y"] == 0) == point
    assert (found["radius_xyz_100"] == 0) == point
    ellipse = count > 2 and momenta != 0
    for axis, size in zip("xyz", np.broadcast_to(sizes, 3), strict=True):
        has = ellipse and size > 0
        assert (found[f"emittance_{axis}"] > 0) == has or count == 2
        for name in ("alpha", "beta", "phase_space_halo"):
            if size != 1e-60:  # whose fourth powers are too small for numbers
                assert math.isnan(found[f"{name}_{axis}"]) != has, (name, axis)
        assert math.isnan(found[f"emittance_{axis}_90"]) != has


def test_weightless_particles_are_counted_and_nothing_else(comm):
    x, u, _ = phase_space()
    beam = beam_of(comm, x, u, 0.0)
    groups = Groups.of(TABLE, BUNCHES)
    moments, quantiles = measured(comm, beam, groups)
    part = moments[groups.members[0]]
    assert part.particles == COUNT and part.weight == part.charge == 0
    assert np.isnan(part.mean).all() and np.isnan(quantiles[groups.members[0]].spatial).all()


def test_a_part_of_the_weight_is_where_ties_and_steps_put_it(comm):
    """Ten particles, two of which carry most of the weight: the quantiles follow the weight, not the number."""
    table = SpeciesTable((ELECTRON,))
    x = np.zeros((10, 3))
    x[:, 0] = [-5, -4, -3, -2, -1, 1, 2, 3, 4, 5]
    weight = np.array([1, 1, 1, 1, 100, 100, 1, 1, 1, 1.0])
    groups = Groups.of(table)
    found = measured(comm, beam_of(comm, x, 0 * x, weight, table), groups)[1][groups.members[0]]
    np.testing.assert_allclose(found.transverse, [1, 1, 1, 1, 4, 5, 5, 5], rtol=1e-12)


def test_groups_have_plain_names_none_twice():
    table = SpeciesTable.of_runs([(0, ELECTRON), (10, PROTON), (20, ELECTRON)])
    bunches = [NamedBunches("electron", 1, 10), NamedBunches("a, b", 2, 5), NamedBunches("", 1, 0)]
    groups = Groups.of(table, bunches)
    assert groups.names == ("all", "electron", "proton", "electron_2", "a__b_0", "a__b_1", "bunch_2")
    assert groups.starts == (0, 10, 15, 20)
    assert groups.run_of(np.array([0, 9, 10, 14, 15, 19, 20, 99])).tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    # Bunches that are not those of the table leave its runs alone.
    assert Groups.of(table, bunches[:2]).names == ("all", "electron", "proton", "bunch_0", "bunch_1", "bunch_2")
    assert [len(layer) for layer in layers(groups.distinct)] == [1, 2, 4]


def test_a_cold_beam_is_cold_among_test_particles_of_another_momentum():
    """Without weight they leave rounding in its mean, and less than nothing must not come of that."""
    count, table = 100, SpeciesTable.of_runs([(0, ELECTRON)])
    tests = np.arange(count) % 3 == 0
    x, weight = phase_space()[0][:count], np.where(tests, 0.0, 1.7)
    groups = Groups.of(table, [NamedBunches("", 1, count)])
    for momentum in np.linspace(0.1, 3, 30):
        u = np.where(tests[:, None], [0.3, 0, 300], [0, 0, momentum])
        moments = diagnostics.group_moments(MPI.COMM_SELF, beam_of(MPI.COMM_SELF, x, u, weight, table), groups)
        for part in moments.values():
            assert part.rms[3:6] == pytest.approx(0, abs=1e-12)
            assert part.mean[5] == pytest.approx(momentum, rel=1e-12)


@pytest.mark.mpi(ranks=(1, 2, 3, 4))
def test_what_is_measured_of_groups_does_not_depend_on_where_a_period_is_cut(comm):
    x, u, weight = phase_space()
    x[::400] = x[1::400]  # none so far out that the period cuts it
    x -= np.average(x, axis=0, weights=weight)
    x[900:1200, 2] += 0.02  # bunches lie apart
    x[1200:1500, 2] -= 0.01
    length, groups = np.array([0.05, 1.0, 0.2]), Groups.of(TABLE, BUNCHES)
    domain = Domain((1, 0, -0.1), (1.05, 1, 0.1), 16, {"x": "periodic", "y": "neumann", "z": "periodic"})
    moments, quantiles = measured(comm, beam := beam_of(comm, x, u, weight), groups)
    slices = diagnostics.group_slices(comm, beam, groups, moments, 5)
    for shift in ((0, 0, 0.5), (0.3, 0, -0.45), (0.5, 0, 12.47)):
        moved = x + length * shift
        moved[:, ::2] = np.array(domain.lower)[::2] + (moved - domain.lower)[:, ::2] % length[::2]
        beam = beam_of(comm, moved, u, weight)
        of_moved = diagnostics.group_moments(comm, beam, groups, domain)
        quantiles_of_moved = diagnostics.group_quantiles(comm, beam, groups, of_moved)
        slices_of_moved = diagnostics.group_slices(comm, beam, groups, of_moved, 5)
        assert list(of_moved) == list(moments)
        for members, part in moments.items():
            other = of_moved[members]
            assert (other.particles, other.charge) == (part.particles, pytest.approx(part.charge, rel=1e-12))
            assert other.covariance == pytest.approx(part.covariance, rel=1e-8, abs=1e-10 * part.covariance.max())
            assert other.planes == pytest.approx(part.planes, rel=1e-8, abs=1e-14)
            apart = (other.mean - part.mean)[:3]
            periods = (apart / length - shift) * (1, 0, 1)
            assert periods == pytest.approx(np.rint(periods), abs=1e-9)
            for ends in ("lowest", "highest"):  # extremes are about the mean, whether beyond a face or not
                assert (getattr(other, ends) - getattr(part, ends))[:3] == pytest.approx(apart, abs=1e-9)
            assert np.all((other.mean[[0, 2]] >= (1, -0.1)) & (other.mean[[0, 2]] < (1.05, 0.1)))
            for kind in ("emittance", "transverse", "spatial"):
                wanted = getattr(quantiles[members], kind)
                assert getattr(quantiles_of_moved[members], kind) == pytest.approx(wanted, rel=1e-7)
            for one, two in zip(slices[members], slices_of_moved[members], strict=True):
                assert two.part.particles == one.part.particles
                assert two.lower - one.lower == pytest.approx(apart[2], abs=1e-9)
                assert two.current == pytest.approx(one.current, rel=1e-8)
                assert two.part.rms == pytest.approx(one.part.rms, rel=1e-6)
