"""Where space repeats: images in the domain against exact fractions, and the middle of what goes round against complex sums."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Domain, Field, Hierarchy, VectorField
from amrpic.mesh.composite import LiveFields
from amrpic.mesh.periods import middle, nearest, wrapped
from amrpic.mesh.raster import spread_of

LOWER, UPPER = np.array([-0.1, 3.0, -7e-3]), np.array([0.2, 3.7, 11e-3])
BOXES = [[((8, 8, 8), (23, 23, 23))]]


def test_images_are_in_the_domain_and_those_of_exact_remainders():
    rng = np.random.default_rng(2)
    length = UPPER - LOWER
    points = rng.uniform(LOWER, UPPER, (2000, 3)) + length * np.rint(10.0 ** rng.uniform(0, 6, (2000, 3)))
    points[:3] = np.nextafter(LOWER, -np.inf), UPPER, np.nextafter(UPPER, np.inf)
    images = wrapped(points, LOWER, UPPER, (True, True, False))
    assert np.array_equal(images[:, 2], points[:, 2])
    for axis in (0, 1):
        lower, upper = Fraction(LOWER[axis]), Fraction(UPPER[axis])
        assert np.all((LOWER[axis] <= images[:, axis]) & (images[:, axis] < UPPER[axis]))
        exact = [lower + (Fraction(x) - lower) % (upper - lower) for x in points[:, axis]]
        apart = np.array([float(Fraction(x) - e) for x, e in zip(images[:, axis], exact, strict=True)])
        # the remainder is of the rounded length, which each period adds to
        periods = np.abs(points[:, axis] - LOWER[axis]) / length[axis] + 2
        assert np.all(np.abs(nearest(apart, length[axis])) <= 2 * np.finfo(float).eps * periods * np.abs(UPPER[axis]))
    again = wrapped(images, LOWER, UPPER, (True, True, False))
    assert np.array_equal(again, images)
    odd = wrapped(np.array([[np.nan, np.inf, 0.0]]), LOWER, UPPER, (True, True, True))
    assert np.isnan(odd[0, 0]) and np.isinf(odd[0, 1])


def smooth(x, y, z):
    parts = [
        np.sin(2 * np.pi * c / (u - l) + n) for n, (c, l, u) in enumerate(zip((x, y, z), LOWER, UPPER, strict=True))
    ]
    return parts[0] + parts[1] * parts[2]


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("size", [8, 24])
def test_samples_of_all_orders_repeat_after_any_number_of_periods(comm, size):
    domain = Domain(LOWER.tolist(), UPPER.tolist(), 16, "periodic")
    hierarchy = Hierarchy(comm, domain, [[((0, 8, 20), (11, 19, 31))]], size, 4)
    field = Field(hierarchy).fill(smooth)
    vector = VectorField(field, Field(hierarchy).fill(lambda x, y, z: smooth(x, y, z) ** 2), field)
    rng = np.random.default_rng(3)
    at = rng.uniform(LOWER, UPPER, (8, 3))
    length = UPPER - LOWER
    for order in (1, 2, 3, 4):
        for sampled in (field, vector):
            for what in ("value", "gradient"):
                wanted = sampled.sample(at, order, what)
                assert np.isfinite(wanted).all()
                for periods in ((1, 0, -1), (1000, 8, -7)):
                    # a fit's weights follow from places, which are rounded; trilinear ones are continuous as well
                    assert sampled.sample(at + length * periods, order, what) == pytest.approx(
                        wanted, rel=0, abs=1e-9 * np.abs(wanted).max()
                    )
        middle_of_it = (LOWER + UPPER) / 2
        for axis in range(3):  # one rounding to either side of both faces
            for face in (LOWER[axis], UPPER[axis]):
                beside = np.tile(middle_of_it, (3, 1))
                beside[:, axis] = np.nextafter(face, -np.inf), face, np.nextafter(face, np.inf)
                found = field.sample(beside, order)
                assert found == pytest.approx(np.full(3, found[1]), abs=1e-12)


def test_a_wall_along_another_axis_still_ends_samples():
    kinds = {"x": "periodic", "y": "dirichlet", "z": "neumann"}
    field = Field(Hierarchy(MPI.COMM_SELF, Domain(0, 1, 16, kinds), (), 16, 4)).fill(
        lambda x, y, z: 1 + 0 * (x + y + z)
    )
    at = [(7.3, 0.5, 0.5), (0.5, 1.3, 0.5), (0.5, 0.5, -1e-9), (np.inf, 0.5, 0.5), (-3.0, 1.0, 0.0)]
    for order in (1, 2, 3):
        assert np.array_equal(np.isnan(field.sample(at, order)), [False, True, True, True, False])


def test_planes_and_lines_go_on_behind_periodic_faces():
    field = Field(Hierarchy(MPI.COMM_SELF, Domain(0, 1, 32, "periodic"), (), 16, 4)).fill(
        lambda x, y, z: np.sin(2 * np.pi * x) + 0 * y + 0 * z
    )
    for axis in "xz":
        assert np.array_equal(field.slice(axis, 0.3).values, field.slice(axis, 4.3).values)
    inside, beyond = (field.line((a, 0.5, 0.5), (a + 1, 0.5, 0.5), 65) for a in (0.003, -5 + 0.003))
    assert np.array_equal(inside.values[:-1], beyond.values[:-1])


@pytest.mark.parametrize("cells", [64, (64, 32, 48)])
def test_where_a_density_is_does_not_depend_on_where_the_period_is_cut(cells):
    length, sizes = np.array([1.0, 2.0, 3.0]), np.array([0.05, 0.1, 0.12])

    def blob(at):
        def density(x, y, z):
            u = [nearest(c - a, l) / s for c, a, l, s in zip((x, y, z), at, length, sizes, strict=True)]
            return np.exp(-(u[0] ** 2 + u[1] ** 2 + u[2] ** 2 + u[0] * u[1]) / 2)

        return density

    domain = Domain((0, 0, 0), length.tolist(), cells, "periodic")
    spacing = domain.spacing
    for shift in (0, 17, 31):
        at = (np.array([0.5, 0.5, 0.5]) * length + shift * spacing) % length
        hierarchy = Hierarchy(MPI.COMM_SELF, domain, (), 32, 8)
        fields = LiveFields(hierarchy, {"rho": [Field(hierarchy).fill(blob(at))]})
        spread = spread_of(fields)
        assert np.abs(nearest((spread.centre - at) / length, 1.0)).max() < 1e-9
        if shift == 0:
            wanted = spread.covariance
        assert spread.covariance == pytest.approx(wanted, rel=1e-9, abs=1e-9 * wanted.max())


def test_what_goes_round_has_its_circular_middle_unless_it_is_even():
    rng = np.random.default_rng(4)
    for size, centre in ((0.02, 0.0), (0.1, 0.93), (0.15, 0.4)):
        x = (centre + size * rng.normal(size=20000)) % 1
        place, fill = middle(np.cos(2 * np.pi * x).mean(), np.sin(2 * np.pi * x).mean(), len(x))
        assert abs(nearest(np.array(place - centre), 1.0)) < 5 * size / 100
        assert fill == pytest.approx(size, rel=0.03)
    evens = [rng.random(n) for n in (50, 500, 100_000) for _ in range(200)]
    for x in evens:  # noise makes no middle
        place, fill = middle(np.cos(2 * np.pi * x).mean(), np.sin(2 * np.pi * x).mean(), len(x))
        assert np.isnan(place) and fill > 1 / 6
    assert np.isnan(middle(0.0, 0.0, 10)[0]) and middle(0.0, 0.0, 10)[1] == np.inf
    assert middle(-1.0, 0.0, 1) == (0.5, 0.0)
