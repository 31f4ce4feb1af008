"""Potentials on Dirichlet faces and slopes on Neumann faces that meet open faces: the wall goes on beyond these.

There it has the constant potential that it is given at its rim, or no slope.
"""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.special import j0

from amrpic import Domain, Field, Hierarchy, PoissonSolver
from exact.errors import errors, observed_order
from exact.sources import Gaussian, fill

AXES = "xyz"
WIDTH = 0.1  # of the bumps, m
OF_BUMPS = 1.75  # order that 3 to 5 cells per width show; with the exact potential on all faces it is 1.78


def cube(n, boundary, refined=(), comm=MPI.COMM_SELF, max_grid_size=32, depth=1):
    """The unit cube, or a part of it along z; faces of axes that `boundary` does not name are open."""
    domain = Domain((0, 0, 0), (1, 1, depth), (n, n, round(n * depth)), boundary)
    return Hierarchy(comm, domain, [list(refined)] if refined else [], max_grid_size=max_grid_size, blocking_factor=2)


def solve(hierarchy, values=None, slopes=None, source=None, **options):
    """φ and E with data on walls."""
    rho = Field(hierarchy)
    if source is not None:
        fill(rho, source)
    solver = PoissonSolver(hierarchy, **options)
    phi, report = solver.solve(rho, boundary_values=values, boundary_flux=slopes)
    assert report.converged, report.reason
    return phi, solver.electric_field(phi)


def at_wall(n, axis):
    """A refined patch in the middle of the lower wall along an axis."""
    lower, upper = [n // 2] * 3, [3 * n // 2 - 1] * 3
    lower[axis], upper[axis] = 0, n - 1
    return [(tuple(lower), tuple(upper))]


# ---- constants ----


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", (0, 1))
def test_one_plane_at_a_potential_makes_no_field(axis, side):
    pair = ("dirichlet", "open") if side == 0 else ("open", "dirichlet")
    hierarchy = cube(16, {AXES[axis]: pair}, at_wall(16, axis))
    phi, field = solve(hierarchy, values=lambda x, y, z: 7.0 + 0 * x * y * z)
    assert errors([phi], lambda x, y, z: 7.0 + 0 * x * y * z)[1] < 1e-8
    assert max(component.max_abs() for component in field.components) < 1e-8 * 7 * 32


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("others", ["open", "neumann", "periodic"])
def test_field_between_two_plates_is_uniform_up_to_open_faces(axis, others):
    boundary = {AXES[axis]: "dirichlet", AXES[(axis + 1) % 3]: others}
    hierarchy = cube(16, boundary, at_wall(16, axis))
    low, high = -3.0, 5.0

    def exact(*places):
        return low + (high - low) * places[axis] + 0 * sum(places)

    phi, field = solve(hierarchy, values=exact)
    assert errors([phi], exact)[1] < 1e-8
    expected = [np.zeros(()), np.zeros(()), np.zeros(())]
    expected[axis] = np.array(low - high)
    assert errors(field.components, lambda *x: tuple(e + 0 * sum(x) for e in expected))[1] < 1e-7


@pytest.mark.parametrize(
    "boundary",
    [
        {"z": ("dirichlet", "open")},
        {"x": ("open", "dirichlet"), "z": ("dirichlet", "open"), "y": "periodic"},
        {"x": "dirichlet", "y": ("dirichlet", "neumann")},
        {"x": "dirichlet", "y": "dirichlet", "z": ("dirichlet", "open")},
    ],
    ids=["plane", "edge", "pipe", "five walls"],
)
def test_one_potential_of_all_walls_is_added_to_that_of_the_charge(boundary):
    hierarchy = cube(16, boundary, at_wall(16, 2))
    source = Gaussian((0.08,) * 3, (0.5, 0.5, 0.4))
    grounded, _ = solve(hierarchy, source=source)
    raised, _ = solve(hierarchy, values=lambda x, y, z: 4.0 + 0 * x * y * z, source=source)
    assert max_difference(raised, grounded, 4.0) < 1e-8 * 4


def max_difference(field, other, constant):
    return max(np.abs(a.data - b.data - constant).max() for a, b in zip(field.patches, other.patches, strict=True))


@pytest.mark.parametrize(("walls", "most"), [("xz", 2.5e-3), ("xyz", 4e-3)], ids=["edge", "corner"])
def test_planes_of_different_potentials_that_meet(walls, most):
    """Four cells and more from where they meet: the potential jumps there."""
    n, volts = 32, {"x": 2.0, "y": -1.0, "z": 0.5}

    def exact(x, y, z):
        if "y" not in walls:
            return volts["z"] + (volts["x"] - volts["z"]) * 2 / np.pi * np.arctan2(z, x) + 0 * y
        r = np.sqrt(x**2 + y**2 + z**2)
        angles = {"x": np.arctan(y * z / (x * r)), "y": np.arctan(x * z / (y * r)), "z": np.arctan(x * y / (z * r))}
        return sum(2 / np.pi * volts[axis] * angle for axis, angle in angles.items())

    def on_walls(*places):
        return np.select([places[AXES.index(axis)] == 0 for axis in walls], [volts[axis] for axis in walls])

    phi, _ = solve(cube(n, dict.fromkeys(walls, ("dirichlet", "open"))), values=on_walls)
    worst = 0.0
    for patch in phi.patches:
        places = patch.centres()
        depth = np.sort(np.stack(np.broadcast_arrays(*(places[AXES.index(axis)] for axis in walls))), axis=0)
        away = np.broadcast_to(np.hypot(depth[0], depth[1]) > 4 / n, patch.data.shape)
        worst = max(worst, np.abs(patch.data - exact(*places))[away].max())
    assert worst < most * np.ptp([volts[axis] for axis in walls])


def ghosts(boundary, volts, upper=(1, 1, 1), n=12, **options):
    """Centres (m, 3) of all ghosts behind open faces and what they hold without charge, [face][layer]; walls at constants."""
    hierarchy = Hierarchy(MPI.COMM_SELF, Domain((0, 0, 0), upper, (n,) * 3, boundary), blocking_factor=2)
    solver = PoissonSolver(hierarchy, **options)

    def on_walls(*places):
        on = [(places[AXES.index(axis)] == end, volt) for (axis, end), volt in volts.items()]
        return np.select([where for where, _ in on], [volt for _, volt in on])

    _, report = solver.solve(Field(hierarchy), boundary_values=on_walls)
    assert report.converged, report.reason
    kinds, axes, places = solver.native.wall_faces(0)
    return places[kinds == 0], axes[kinds == 0], solver.native.wall_data(0)[kinds == 0]


def strip(volts, a, u, w):
    """Between plates w = 0 and a and a third one across their ends, u = 0; `volts` in this order."""
    end, low, high = volts[2], volts[0], volts[1]
    n = np.arange(1, 4000)[:, None] * np.pi / a
    # the sine series of what the end has above the linear potential between the plates
    uneven = 2 / (n * a) * ((end - low) - (end - high) * np.cos(n * a))
    return low + (high - low) * w / a + (uneven * np.sin(n * w) * np.exp(-n * u)).sum(axis=0)


def rectangle(volts, a, b, u, w):
    """Between four plates: u = 0, a and w = 0, b; each by its own sine series."""

    def of_one(volt, a, b, u, w):  # that at u = 0
        n = np.arange(1, 1500, 2)[:, None] * np.pi / b
        # sinh(n (a - u)) / sinh(n a), without large numbers
        return (
            4 * volt / (n * b) * np.sin(n * w) * np.exp(-n * u) * np.expm1(-2 * n * (a - u)) / np.expm1(-2 * n * a)
        ).sum(0)

    return (
        of_one(volts[0], a, b, u, w)
        + of_one(volts[1], a, b, a - u, w)
        + of_one(volts[2], b, a, w, u)
        + of_one(volts[3], b, a, b - w, u)
    )


def test_ghosts_have_the_potential_of_plates_that_end_a_strip():
    volts = {("x", 0): 1.0, ("x", 1.5): -2.0, ("z", 0): 3.0}
    (x, _, z), _, found = columns(*ghosts({"x": "dirichlet", "z": ("dirichlet", "open")}, volts, (1.5, 1, 1)))
    assert found == pytest.approx(strip((1.0, -2.0, 3.0), 1.5, z, x), abs=1e-10)


@pytest.mark.parametrize("height", [0.4, 1.0, 3.0])
def test_ghosts_have_the_potential_of_a_pipe_with_four_walls(height):
    volts = {("x", 0): 1.0, ("x", 1): -2.0, ("y", 0): 3.0, ("y", height): 0.5}
    (x, y, _), _, found = columns(*ghosts({"x": "dirichlet", "y": "dirichlet"}, volts, (1, height, 1)))
    assert found == pytest.approx(rectangle(tuple(volts.values()), 1.0, height, x, y), abs=1e-10)


def test_neumann_walls_reflect_plates():
    """Between plates, which a wall across z mirrors; and plates z = 0 and x = 0, of which a wall x = 1 makes three."""
    volts = {("x", 0): 1.0, ("x", 1): -2.0}
    (x, _, _), _, found = columns(*ghosts({"x": "dirichlet", "z": ("open", "neumann")}, volts))
    assert found == pytest.approx(1 - 3 * x, abs=1e-12)
    volts = {("x", 0): 1.0, ("z", 0): 3.0}
    (x, _, z), _, found = columns(*ghosts({"x": ("dirichlet", "neumann"), "z": ("dirichlet", "open")}, volts))
    assert found == pytest.approx(strip((1.0, 1.0, 3.0), 2.0, z, x), abs=1e-10)


def test_ghosts_have_the_potential_of_five_walls():
    """The fifth one at 1 V, so that each wave between the others fades with its own length."""
    volts = {("z", 0): 1.0}
    (x, y, z), _, found = columns(*ghosts({"x": "dirichlet", "y": "dirichlet", "z": ("dirichlet", "open")}, volts))
    exact = np.zeros_like(x)
    for m, n in np.ndindex(30, 30):
        k = np.pi * np.array([2 * m + 1, 2 * n + 1])
        exact += 16 / (k[0] * k[1]) * np.sin(k[0] * x) * np.sin(k[1] * y) * np.exp(-np.hypot(*k) * z)
    assert found == pytest.approx(exact, abs=1e-11)


def columns(places, axes, found):
    return places.T, axes, found


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("n", [16, 40])
def test_ghosts_at_an_edge_have_its_potential_or_the_mean_of_it(order, n):
    """In fourth order the mean over the ghost, here flat cells, but for h⁴ far from the edge."""
    volts = {("x", 0): 2.0, ("z", 0): -1.0}
    (x, y, z), axes, found = columns(
        *ghosts({"x": ("dirichlet", "open"), "z": ("dirichlet", "open")}, volts, (1, 1, 2), n, order=order)
    )
    h = np.array([1, 1, 2]) / n
    points, weights = np.polynomial.legendre.leggauss(8) if order == 4 else (np.zeros(1), np.full(1, 2.0))
    mean = sum(
        u * w / 4 * (-1 + 6 / np.pi * np.arctan2(z + 0.5 * h[2] * b, x + 0.5 * h[0] * a))
        for a, u in zip(points, weights, strict=True)
        for b, w in zip(points, weights, strict=True)
    )
    far = np.hypot(x, z) > (0 if order == 2 else 0.4)
    assert np.abs(found - mean)[far].max() < (1e-11 if order == 2 else 10.0 / n**4)


# ---- data that vanish towards the rim ----


def bump(*across):
    return np.exp(-sum((a - 0.5) ** 2 for a in across) / (2 * WIDTH**2))


def spread_bump(depth, radius, power):
    """∫ s² kᵖ exp(-k²s²/2) J₀(kρ) exp(-kz) dk: below a plane with this potential (p = 1) or slope (p = 0)."""
    x, w = np.polynomial.legendre.leggauss(120)
    total = 0.0
    for k, weight in zip((x + 1) * 4.5 / WIDTH, w * 4.5 / WIDTH, strict=True):
        total = total + weight * WIDTH**2 * k**power * np.exp(-((k * WIDTH) ** 2) / 2) * j0(k * radius) * np.exp(
            -k * depth
        )
    return total


def check_order_two(cells, found, least=1.9):
    """Errors (L2, max) on meshes of so many cells."""
    assert found[-1][1] < 2.2e-3 and observed_order(cells, [of_mesh[0] for of_mesh in found]) > least, found


def beside(kind, axis, side):
    """A bump of potential or slope on one face, which it goes through, and the potential that it makes."""

    def on_face(*places):
        on = np.abs(places[axis] - side) < 1e-9
        return np.where(on, bump(*(a for d, a in enumerate(places) if d != axis)), 0.0)

    def exact(*places):
        radius = np.sqrt(sum((a - 0.5) ** 2 for d, a in enumerate(places) if d != axis))
        return spread_bump(np.abs(places[axis] - side), radius, 1 if kind == "dirichlet" else 0)

    return on_face, exact


@pytest.mark.parametrize(
    ("axis", "side", "refined"),
    [(2, 0, False), (2, 0, True), (1, 0, True), (0, 1, False)],
    ids=["z lower", "z lower, two levels", "y lower, two levels", "x upper"],
)
@pytest.mark.parametrize("kind", ["dirichlet", "neumann"])
def test_bumps_on_one_face_are_of_second_order(kind, axis, side, refined):
    on_face, exact = beside(kind, axis, side)
    boundary = {AXES[axis]: (kind, "open") if side == 0 else ("open", kind)}
    cells = (32, 48)
    found = []
    for n in cells:
        hierarchy = cube(n, boundary, at_wall(n, axis) if refined else ())
        phi, _ = solve(hierarchy, **{"values" if kind == "dirichlet" else "slopes": on_face})
        found.append(errors([phi], exact))
    check_order_two(cells, found, OF_BUMPS)


@pytest.mark.parametrize(
    ("kind", "order", "n", "most"),
    [
        ("dirichlet", 2, 16, 0.025),
        ("dirichlet", 2, 32, 6.5e-3),
        ("dirichlet", 4, 16, 2e-3),
        ("dirichlet", 4, 32, 3e-4),  # the octree leaves most of it
        ("neumann", 2, 16, 1.5e-3),
        ("neumann", 2, 32, 5e-4),
        ("neumann", 4, 16, 1.2e-4),
        ("neumann", 4, 32, 8e-6),
    ],
)
def test_ghosts_have_the_potential_of_a_bump(kind, order, n, most):
    """The mean over a cube is that in its middle, but for h⁴."""
    on_face, exact = beside(kind, 2, 0)
    hierarchy = cube(n, {"z": (kind, "open")})
    solver = PoissonSolver(hierarchy, order=order)
    solver.solve(Field(hierarchy), boundary_values=on_face, boundary_flux=on_face)
    is_open = solver.native.wall_faces(0)[0] == 0
    expected = exact(*solver.native.wall_faces(0)[2][is_open].T)
    error = np.abs(solver.native.wall_data(0)[is_open] - expected).max()
    assert error < most * expected.max()


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("kind", ["dirichlet", "neumann"])
def test_bumps_have_the_error_of_a_box_with_the_exact_potential_on_all_other_faces(kind, order):
    on_face, exact = beside(kind, 2, 0)
    found = []
    for others in ("open", "dirichlet"):
        hierarchy = cube(32, {"x": others, "y": others, "z": (kind, others)}, at_wall(32, 2))

        def values(*at):
            return np.where(at[2] == 0, on_face(*at), exact(*at))

        phi, _ = solve(hierarchy, on_face if others == "open" else values, on_face, order=order)
        found.append(errors([phi.as_points()], exact)[1])
    assert found[0] < 1.05 * found[1], found


@pytest.mark.parametrize("kind", ["dirichlet", "neumann"])
@pytest.mark.parametrize("backend", ["kokkos", "crs"])
def test_backends_agree(kind, backend):
    on_face, _ = beside(kind, 2, 0)
    hierarchy = cube(16, {"x": ("open", "dirichlet"), "z": (kind, "open")}, at_wall(16, 2))
    data = {"values": lambda *at: on_face(*at) + (at[0] == 1)} if kind == "dirichlet" else {"slopes": on_face}
    one, _ = solve(hierarchy, **data, tolerance=1e-11)
    other, _ = solve(hierarchy, **data, tolerance=1e-11, backend=backend)
    assert max_difference(one, other, 0.0) < 1e-9 * one.max_abs()


def test_stretched_equations_are_those_of_a_longer_domain():
    """Data and plates included; a slope across the stretched axis counts per length of the given one."""
    boundary = {"x": ("neumann", "open"), "y": "dirichlet", "z": ("dirichlet", "open")}

    def on_walls(x, y, z):
        return np.where(y == 1, 2.0, 0.0) + np.where(z == 0, bump(x, y), 0.0)

    def slope(x, y, z):
        return bump(y, z)

    domains = [Domain((0, 0, 0), (1, 1, length), (16,) * 3, boundary) for length in (1, 2)]
    short, long = (Hierarchy(MPI.COMM_SELF, domain, blocking_factor=2) for domain in domains)
    phi, _ = solve(short, on_walls, slope, stretch=(1, 1, 2))
    expected, _ = solve(long, on_walls, lambda x, y, z: slope(x, y, z / 2))
    assert max_difference(phi, expected, 0.0) < 1e-9 * expected.max_abs()


def test_data_are_gone_with_the_next_solve():
    on_face, _ = beside("dirichlet", 2, 0)
    hierarchy = cube(16, {"y": ("dirichlet", "open"), "z": ("dirichlet", "open")})
    rho = fill(Field(hierarchy), Gaussian((0.08,) * 3, (0.5, 0.5, 0.4)))
    solver = PoissonSolver(hierarchy)
    expected, _ = solver.solve(rho)
    solver.solve(rho, boundary_values=lambda *at: on_face(*at) + np.where(at[1] == 0, 3.0, 1.0))
    again, _ = solver.solve(rho)
    assert max_difference(again, expected, 0.0) == 0


@pytest.mark.parametrize(
    ("plane", "other"), [("dirichlet", "neumann"), ("dirichlet", "dirichlet"), ("neumann", "neumann")]
)
def test_bumps_have_images_in_other_walls(plane, other):
    """At a wall x = 0 the bump is there a second time, at x = -0.5."""
    sign = -1 if other == "dirichlet" else 1

    def twice(function, x, y, z):
        return function(x, y, z) + sign * function(-x, y, z)

    on_face, exact = beside(plane, 2, 0)
    data = {
        "values" if plane == "dirichlet" else "slopes": lambda *at: np.where(at[0] > 1e-9, twice(on_face, *at), 0.0)
    }
    cells = (32, 48)
    found = []
    for n in cells:
        phi, _ = solve(cube(n, {"x": (other, "open"), "z": (plane, "open")}), **data)
        found.append(errors([phi], lambda *at: twice(exact, *at)))
    check_order_two(cells, found, OF_BUMPS)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("kind", ["dirichlet", "neumann"])
def test_waves_between_periodic_faces_fade_away_from_their_wall(kind, order):
    """With a mean potential of the wall, up to infinity; with slopes whose mean is zero."""
    k = 2 * np.pi
    mean = 0.3 if kind == "dirichlet" else 0.0

    def on_face(x, y, z):
        return mean + np.cos(k * x) + 0 * y * z

    def exact(x, y, z):
        return mean + np.cos(k * x) * np.exp(-k * z) / (1 if kind == "dirichlet" else k) + 0 * y

    def error(n, upper):
        hierarchy = cube(n, {"x": "periodic", "y": "periodic", "z": (kind, upper)}, depth=0.25)
        values = exact if upper == "dirichlet" else on_face
        phi, _ = solve(hierarchy, values=values, slopes=on_face if kind == "neumann" else None, order=order)
        return np.array(errors([phi.as_points()], exact))

    cells = (32, 48)
    found = [error(n, "open") for n in cells]
    if order == 2 and kind == "dirichlet":  # the mesh shows an order of 1.85 with the exact potential above, too
        assert all((of_open < 1.2 * error(n, "dirichlet")).all() for n, of_open in zip(cells, found, strict=True)), (
            found
        )
    elif order == 2:
        check_order_two(cells, found)
    else:
        assert found[-1][1] < 2e-5 and observed_order(cells, [of_mesh[0] for of_mesh in found]) > 3.5, found


def test_a_constant_potential_and_a_bump_add_up():
    on_face, _ = beside("dirichlet", 2, 0)
    hierarchy = cube(16, {"z": ("dirichlet", "open")})
    alone, _ = solve(hierarchy, values=on_face)
    raised, _ = solve(hierarchy, values=lambda *at: 2 + on_face(*at))
    assert max_difference(raised, alone, 2.0) < 1e-4  # the bump at the rim


def test_charge_and_data_add_up():
    on_face, _ = beside("dirichlet", 2, 0)
    hierarchy = cube(16, {"z": ("dirichlet", "open")}, at_wall(16, 2))
    source = Gaussian((0.08,) * 3, (0.5, 0.5, 0.4))
    parts = [solve(hierarchy, source=source)[0], solve(hierarchy, values=on_face)[0]]
    both, _ = solve(hierarchy, values=on_face, source=source)
    assert max_difference(both, parts[0] + parts[1], 0.0) < 2e-4 * both.max_abs()  # of the octree of other charges


# ---- a slope that ends at the rim ----


def below_square(x, y, z):
    """∫ dx'dy'/2πr over the unit square at z = 0: potential of a slope of 1 on it."""

    def corner(u, v):
        r = np.sqrt(u**2 + v**2 + z**2)
        return u * np.log(v + r) + v * np.log(u + r) - z * np.arctan(u * v / (z * r))

    return (corner(1 - x, 1 - y) - corner(-x, 1 - y) - corner(1 - x, -y) + corner(-x, -y)) / (2 * np.pi)


@pytest.mark.parametrize(("n", "most"), [(16, 1e-2), (32, 5e-3)])
def test_uniform_slope_ends_at_open_faces(n, most):
    phi, _ = solve(cube(n, {"z": ("neumann", "open")}), slopes=lambda x, y, z: 1.0 + 0 * x * y * z)
    assert errors([phi], below_square)[1] < most


# ---- ranks ----


@pytest.mark.mpi(ranks=(2, 3))
@pytest.mark.parametrize("kind", ["dirichlet", "neumann"])
def test_data_count_the_same_on_any_ranks_and_boxes(comm, kind):
    on_face, _ = beside(kind, 2, 0)
    boundary = {"y": "periodic", "z": (kind, "open")}
    data = {"values" if kind == "dirichlet" else "slopes": on_face}
    points = np.random.default_rng(2).uniform(0.02, 0.98, (200, 3))
    alone, _ = solve(cube(24, boundary, at_wall(24, 2)), **data)
    together, _ = solve(cube(24, boundary, at_wall(24, 2), comm, max_grid_size=8), **data)
    expected = alone.sample(points)
    assert together.sample(points) == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())
