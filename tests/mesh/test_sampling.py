"""Values and gradients at points, by least squares across levels."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Domain, Field, Hierarchy, VectorField
from amrpic.errors import InputError
from amrpic.mesh import sampling
from amrpic.mesh.composite import LiveFields

LOWER, UPPER = np.array([0.0, -0.2, 0.1]), np.array([1.0, 1.0, 0.9])


def mesh(comm: MPI.Comm, n: int = 16, boundary: str = "dirichlet", size: int = 16) -> Hierarchy:
    """Three levels: half of the domain along each axis, and a quarter at a wall."""
    levels = [[((n // 2,) * 3, (3 * n // 2 - 1,) * 3)], [((n + n // 2,) * 3, (2 * n - 1,) * 3)]]
    return Hierarchy(comm, Domain(LOWER.tolist(), UPPER.tolist(), n, boundary), levels, size, 4)


def points(count: int = 300, margin: float = 0.0) -> np.ndarray:
    """Random places, half of them beside the faces of level 1, and corners of the domain."""
    rng = np.random.default_rng(3)
    some = rng.uniform(LOWER + margin, UPPER - margin, (count, 3))
    low = LOWER + (UPPER - LOWER) / 4
    some[::2, 0] = low[0] + rng.normal(0, 0.02, len(some[::2]))
    if margin == 0:
        some[:2] = LOWER, UPPER
    return some


def cubic(x, y, z):
    return 1 + x - 2 * y * z + 3 * x**3 - y**2 * z + x * y * z


def gradient_of_cubic(x, y, z):
    return np.stack([1 + 9 * x**2 + y * z, -2 * z - 2 * y * z + x * z, -2 * y - y**2 + x * y], axis=-1)


def smooth(x, y, z):
    return np.sin(3 * x + 0.3) * np.exp(y) * np.cos(2 * z)


def gradient_of_smooth(x, y, z):
    e = np.exp(y)
    s, c = np.sin(3 * x + 0.3), np.cos(3 * x + 0.3)
    return np.stack([3 * c * e * np.cos(2 * z), s * e * np.cos(2 * z), -2 * s * e * np.sin(2 * z)], axis=-1)


def order_of(errors: list[float], sizes: list[int]) -> float:
    return float(-np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def test_cubics_are_exact_across_faces_and_up_to_walls():
    field, at = Field(mesh(MPI.COMM_SELF)).fill(cubic), points()
    assert np.abs(field.sample(at, order=3) - cubic(*at.T)).max() < 1e-12
    assert np.abs(field.sample(at, order=3, what="gradient") - gradient_of_cubic(*at.T)).max() < 1e-10
    assert np.abs(field.sample(at) - cubic(*at.T)).max() > 1e-3


@pytest.mark.parametrize("order", [2, 3, 4])
def test_values_are_of_order_plus_one_and_gradients_of_order(order):
    sizes, values, largest, gradients, at = [16, 24, 32, 48], [], [], [], points()
    for n in sizes:
        field = Field(mesh(MPI.COMM_SELF, n)).fill(smooth)
        apart = field.sample(at, order) - smooth(*at.T)
        values.append(np.sqrt(np.mean(apart**2)))
        largest.append(np.abs(apart).max())
        gradients.append(np.sqrt(np.mean((field.sample(at, order, "gradient") - gradient_of_smooth(*at.T)) ** 2)))
    assert order_of(values, sizes) > order + 0.8
    assert order_of(gradients, sizes) > order - 0.2
    assert order != 3 or order_of(largest, sizes) > 3.8


def test_the_gradient_of_order_one_is_exact_for_linear_fields():
    field = Field(mesh(MPI.COMM_SELF)).fill(lambda x, y, z: 2 * x - y + 3 * z)
    assert np.allclose(field.sample(points(), what="gradient"), [2, -1, 3], rtol=0, atol=1e-11)


@pytest.mark.parametrize("kappa", [1 / 24, 1 / 30, -1 / 120])
def test_kappa_says_what_cells_hold(kappa):
    """x³ + x z² with what κ h² times its Laplacian adds, cell by cell."""
    hierarchy, at = mesh(MPI.COMM_SELF), points()
    field = Field(hierarchy)
    for patch in field.patches:
        x, y, z = patch.centres()
        h = hierarchy.spacing(patch.level)
        patch.data[...] = x**3 + x * z**2 + 0 * y + kappa * (6 * h[0] ** 2 * x + 2 * h[2] ** 2 * x)
    exact = at[:, 0] ** 3 + at[:, 0] * at[:, 2] ** 2
    assert np.abs(field.sample(at, order=3, kappa=kappa) - exact).max() < 1e-12
    assert np.abs(field.sample(at, order=3) - exact).max() > 1e-6


def wave_of(length):
    def wave(x, y, z):
        parts = [np.sin(2 * np.pi * c / l + d) for d, (c, l) in enumerate(zip((x, y, z), length, strict=True))]
        return parts[0] * parts[1] * parts[2]

    return wave


def test_periodic_faces_are_no_walls():
    length = UPPER - LOWER
    wave = wave_of(length)
    field = Field(Hierarchy(MPI.COMM_SELF, Domain(LOWER.tolist(), UPPER.tolist(), 32, "periodic"), (), 16, 4)).fill(
        wave
    )
    rng = np.random.default_rng(1)
    within = rng.uniform(LOWER + 0.3 * length, UPPER - 0.3 * length, (300, 3))
    beside = within + length / 2
    errors = [np.abs(field.sample(at, order=3) - wave(*at.T)).max() for at in (within, beside)]
    assert errors[1] < 1.3 * errors[0] < 1e-3
    assert field.sample(beside - length, order=3) == pytest.approx(field.sample(beside, order=3), abs=1e-12)


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_ranks_and_boxes_do_not_matter(comm):
    at = points(60)
    alone = Field(mesh(MPI.COMM_SELF)).fill(smooth)
    for what in ("value", "gradient"):
        wanted = alone.sample(at, 3, what)
        for size in (8, 24):
            assert np.array_equal(Field(mesh(comm, size=size)).fill(smooth).sample(at, 3, what), wanted)


def test_long_cells_take_as_many_neighbours_as_cubes():
    boxes = [[((8, 8, 8), (23, 23, 23))]]
    cube, long = (Hierarchy(MPI.COMM_SELF, Domain((0, 0, 0), (1, 1, l), 16), boxes, 16, 4) for l in (1, 40))
    at = np.random.default_rng(1).uniform(size=(100, 3))
    one = Field(cube).fill(lambda x, y, z: smooth(x, y, z)).sample(at, 4, "gradient")
    other = Field(long).fill(lambda x, y, z: smooth(x, y, z / 40)).sample(at * [1, 1, 40], 4, "gradient")
    assert other * [1, 1, 40] == pytest.approx(one, abs=1e-10)


def test_points_outside_and_none_at_all():
    field = Field(mesh(MPI.COMM_SELF)).fill(smooth)
    found = field.sample([(2, 0, 0.5), (np.nan, 0, 0.5), (0.5, 0.3, np.inf), (0.5, 0.3, 0.5)], order=2)
    assert np.array_equal(np.isnan(found), [True, True, True, False])
    assert field.sample([], order=3).shape == (0,) and field.sample([], 3, "gradient").shape == (0, 3)
    assert field.sample((0.5, 0.5, 0.5), order=2).shape == (1,)


def test_vectors_are_sampled_component_by_component():
    hierarchy, at = mesh(MPI.COMM_SELF), points(40)
    parts = [Field(hierarchy).fill(f) for f in (cubic, smooth, lambda x, y, z: x * y + 0 * z)]
    vector = VectorField(*parts)
    assert np.array_equal(vector.sample(at, 3), np.stack([part.sample(at, 3) for part in parts], axis=1))
    gradient = vector.sample(at, 3, "gradient")
    assert gradient.shape == (40, 3, 3)
    assert np.abs(gradient[:, 0] - gradient_of_cubic(*at.T)).max() < 1e-10


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"order": 5}, "the order of a sample is 5; use 1, 2, 3 or 4"),
        ({"order": 0}, "the order of a sample is 0; use 1, 2, 3 or 4"),
        ({"order": 1.0}, "the order of a sample is 1.0; use 1, 2, 3 or 4"),
        ({"order": np.arange(3)}, r"the order of a sample is array\(\[0, 1, 2\]\); use 1, 2, 3 or 4"),
        ({"order": True}, "the order of a sample is True; use 1, 2, 3 or 4"),
        ({"order": "3"}, "the order of a sample is '3'; use 1, 2, 3 or 4"),
        ({"what": "curl"}, "'curl' cannot be sampled; use \"value\" or \"gradient\""),
        ({"order": 3, "kappa": np.nan}, "kappa is nan; give a number, such as 1/24 for means over cells"),
        ({"order": 3, "kappa": "mean"}, "kappa is 'mean'; give a number"),
        ({"kappa": 1 / 24}, "kappa has no effect on trilinear values; leave it out"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_a_sentence(comm, arguments, message):
    with pytest.raises(InputError, match=message):
        Field(mesh(comm)).sample([(0.5, 0.5, 0.5)], **arguments)


@pytest.mark.mpi(ranks=(1, 2))
def test_too_few_cells_around_a_point_are_refused(comm):
    thin = Field(Hierarchy(comm, Domain(0, 1, (16, 16, 2), "dirichlet"), (), 16, 2)).fill(lambda x, y, z: x + y + z)
    with pytest.raises(
        InputError, match=r"too few cells lie around the point \[0.5, 0.5, 0.5\] m for order 3; use a lower"
    ):
        thin.sample([(0.5, 0.5, 0.5)], order=3)
    assert thin.sample([(0.5, 0.5, 0.5)], what="gradient") == pytest.approx(np.ones((1, 3)))


def deep() -> Hierarchy:
    """Eighteen nested blocks of 8^3 cells, whose finest lie within the reach of points with base cells around them."""
    middle = [8 * 2**level for level in range(1, 19)]
    return Hierarchy(Domain(0, 16, 16), [[((m - 4,) * 3, (m + 3,) * 3)] for m in middle], blocking_factor=4)


def test_cubics_are_exact_where_eighteen_levels_meet():
    """Also where cells within reach of a point are 2^18 times as fine as its own."""
    distance = np.concatenate([np.linspace(0, 5, 200), 2.0 ** -np.arange(0, 20, 0.25)])
    at = 8 + distance[:, None] * [-1, 0.01, 0.3]
    field, scaled = Field(deep()).fill(lambda *c: cubic(*(np.asarray(x) / 8 - 1 for x in c))), at / 8 - 1
    assert np.abs(field.sample(at, order=3) - cubic(*scaled.T)).max() < 1e-12
    width = np.maximum(2.0 ** (np.ceil(np.log2(np.maximum(distance, 1e-9))) - 2), 2.0**-18)  # of the cells, or twice it
    wrong = field.sample(at, order=3, what="gradient") - gradient_of_cubic(*scaled.T) / 8
    assert np.abs(wrong * width[:, None]).max() < 1e-12


def test_far_finer_cells_are_thinned_out():
    """Beside 16 levels finer than a quarter of a base cell, one base cell wide, a point takes 4^3 cells of them."""
    shown = LiveFields(deep(), {"field": [Field(deep())]})
    cells = sampling._Sampler(shown, "field", sampling.Request(), np.array([[5.5, 8.0, 8.0]]))._around(
        np.array([0]), 2.6
    )
    assert 8 <= np.sum(cells.level > 2) <= 64
    few = np.arange(8)
    within = [(24 + few + 0.5) / 4 for _ in range(3)]  # level 2, which is not thinned out, begins there
    x, y, z = np.meshgrid(within[0] + 1, within[1] + 1, within[2] + 1, indexing="ij")
    covered = np.max(np.abs([x - 8, y - 8, z - 8]), axis=0) < 0.5
    near = (x - 5.5) ** 2 + (y - 8) ** 2 + (z - 8) ** 2 < 2.6**2
    assert np.sum(cells.level == 2) == np.sum(near & ~covered)
