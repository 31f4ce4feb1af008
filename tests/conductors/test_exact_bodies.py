"""Conductors whose fields are known: potential, field at the wall and charge, and how their errors fall."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from mpi4py import MPI
from scipy.constants import epsilon_0

from amrpic import Domain, Electrode, Field, Hierarchy, PoissonSolver, shapes
from cut_rows import CutRows
from exact.errors import observed_order

COULOMB = 4 * np.pi * epsilon_0
OFF = np.array((0.013, -0.021, 0.008))  # from the corners and centres of cells
ALL = 512  # cells of a box: one per level


def cube(n, boundary="dirichlet", lower=-1.0, upper=1.0) -> Hierarchy:
    return Hierarchy(MPI.COMM_SELF, Domain(lower, upper, n, boundary), (), ALL)


def values(field: Field) -> np.ndarray:
    (patch,) = field.patches
    return patch.data


def centres(hierarchy: Hierarchy) -> list[np.ndarray]:
    domain = hierarchy.domain
    lines = [domain.lower[a] + (np.arange(domain.cells[a]) + 0.5) * domain.spacing[a] for a in range(3)]
    return list(np.meshgrid(*lines, indexing="ij"))


def solve(hierarchy, electrodes, potential=None, rho=None, **options):
    solver = PoissonSolver(hierarchy, electrodes=electrodes, **{"tolerance": 1e-10, **options})
    phi, report = solver.solve(rho or Field(hierarchy), boundary_values=potential)
    assert report.converged, report.reason
    return solver, phi, report


def error(hierarchy, phi, exact: Callable, outside: Callable) -> float:
    """Return the largest error of φ in cells outside metal."""
    places = centres(hierarchy)
    return float(abs(values(phi) - exact(*places))[outside(*places)].max())


def distance(x, y, z, centre=OFF):
    return np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)


def test_a_sphere_of_twelve_cells_a_radius_has_its_capacitance_to_one_in_ten_thousand():
    a = 0.5
    hierarchy = cube(48)
    _, _, report = solve(
        hierarchy, [Electrode("ball", shapes.Sphere(tuple(OFF), a), voltage=1)], lambda *x: a / distance(*x)
    )
    assert report.charges["ball"] == pytest.approx(COULOMB * a, rel=1e-4)
    assert report.voltages["ball"] == 1


def wall_slopes(rows: CutRows, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where arms meet metal at 1 V (n, 3), and the slopes of φ there along these arms, by the parabolas."""
    fluid = phi[rows.fluid]
    places, slopes = [], []
    for axis in range(3):
        length, cell, electrode, known = rows.arms[axis]
        ends = np.where(electrode >= 0, 1.0, np.where(cell >= 0, fluid[cell], known))
        for side, way in ((0, -1), (1, 1)):
            cut = electrode[side] >= 0
            near, far = length[side][cut], length[1 - side][cut]
            here, wall, other = fluid[cut], ends[side][cut], ends[1 - side][cut]
            rise, fall = (wall - here) / near, (here - other) / far
            slopes.append(way * (rise + near * (rise - fall) / (near + far)) / rows.spacing[axis])
            place = rows.points()[cut]
            place[:, axis] += way * near * rows.spacing[axis]
            places.append((place, np.full(len(place), axis)))
    points = np.concatenate([place for place, _ in places])
    axes = np.concatenate([axis for _, axis in places])
    return np.column_stack([points, axes]), np.concatenate(slopes)


def test_potential_and_field_of_a_sphere_are_of_second_order_up_to_its_wall(long):
    """An octant between Neumann faces, over the mean of three radii, as single ones lie on the mesh in different ways."""
    cells = (48, 96) if long else (24, 48)
    errors = []
    for n in cells:
        found = []
        for a in (0.43, 0.47, 0.5):
            hierarchy = cube(n, [("neumann", "dirichlet")] * 3, 0.0, 0.75)
            electrodes = [Electrode("ball", shapes.Sphere((0, 0, 0), a), voltage=1)]

            def exact(x, y, z, a=a):
                return a / distance(x, y, z, (0, 0, 0))

            solver, phi, report = solve(hierarchy, electrodes, exact)
            assert report.charges["ball"] == pytest.approx(COULOMB * a / 8, rel=1e-4)
            x = centres(hierarchy)
            r = distance(x[0], x[1], x[2], (0, 0, 0))
            efield = solver.electric_field(phi)
            in_cells = max(abs(values(efield.components[d]) - a * x[d] / r**3)[r > a].max() for d in range(3))
            places, slopes = wall_slopes(CutRows(hierarchy.domain, electrodes, exact), values(phi))
            of_wall = slopes + np.take_along_axis(places, places[:, 3:].astype(int), 1)[:, 0] / a**2
            assert (values(phi)[r < a] == 1).all()
            found.append(
                (
                    error(hierarchy, phi, exact, lambda x, y, z, a=a: distance(x, y, z, (0, 0, 0)) > a),
                    in_cells * a,
                    abs(of_wall).max() * a,
                    np.sqrt((of_wall**2).mean()) * a,
                )
            )
        errors.append(np.mean(found, axis=0))
    phi_order, cell_order, wall_order, rms_order = (
        observed_order(cells, [level[n] for level in errors]) for n in range(4)
    )
    assert phi_order > 1.9 and rms_order > 1.9
    if long:
        assert cell_order > 1.9 and wall_order > 1.9


def test_the_field_at_the_wall_of_a_sphere_of_twelve_cells_a_radius():
    a = 0.375
    hierarchy = cube(24, [("neumann", "dirichlet")] * 3, 0.0, 0.75)
    ball = [Electrode("ball", shapes.Sphere((0, 0, 0), a), voltage=1)]

    def exact(x, y, z):
        return a / distance(x, y, z, (0, 0, 0))

    _, phi, _ = solve(hierarchy, ball, exact)
    places, slopes = wall_slopes(CutRows(hierarchy.domain, ball, exact), values(phi))
    of_wall = slopes + np.take_along_axis(places, places[:, 3:].astype(int), 1)[:, 0] / a**2
    assert abs(of_wall).max() * a < 0.013


def test_concentric_spheres():
    a, b = 0.4, 0.9
    capacitance = COULOMB * a * b / (b - a)
    shell = shapes.Box((-2,) * 3, (2,) * 3) - shapes.Sphere(tuple(OFF), b)
    errors, charges = [], []
    for n in (24, 48):
        hierarchy = cube(n)
        electrodes = [Electrode("in", shapes.Sphere(tuple(OFF), a), voltage=1), Electrode("out", shell, voltage=0)]
        _, phi, report = solve(hierarchy, electrodes)
        assert report.charges["out"] == pytest.approx(-report.charges["in"], rel=1e-8)
        charges.append(abs(report.charges["in"] / capacitance - 1))
        errors.append(
            error(
                hierarchy,
                phi,
                lambda *x: (1 / distance(*x) - 1 / b) / (1 / a - 1 / b),
                lambda *x: (distance(*x) > a) & (distance(*x) < b),
            )
        )
    assert charges[-1] < 2e-4 and observed_order((24, 48), charges) > 1.9
    assert observed_order((24, 48), errors) > 1.85


def test_a_coaxial_line_that_goes_on_through_periodic_faces():
    a, b, place, depth = 0.3, 0.9, (0.01, -0.02), 0.25

    def rod(radius, reach):
        return shapes.Cylinder((*place, -reach), (*place, reach), radius)

    capacitance = 2 * np.pi * epsilon_0 / np.log(b / a) * depth
    errors = []
    cells = (24, 48, 96)
    for n in cells:
        walls = {"x": "dirichlet", "y": "dirichlet", "z": "periodic"}
        hierarchy = Hierarchy(MPI.COMM_SELF, Domain((-1, -1, 0), (1, 1, depth), (n, n, n // 8), walls), (), ALL)
        electrodes = [
            Electrode("in", rod(a, 9), voltage=1),
            Electrode("out", shapes.Box((-2, -2, -8), (2, 2, 8)) - rod(b, 9), voltage=0),
        ]
        _, phi, report = solve(hierarchy, electrodes)
        x, y, _ = centres(hierarchy)
        r = np.hypot(x - place[0], y - place[1])
        between = (r > a) & (r < b)
        errors.append(abs(values(phi) - np.log(r / b) / np.log(a / b))[between].max())
        assert np.ptp(values(phi), axis=2).max() < 1e-8
    assert report.charges["in"] == pytest.approx(capacitance, rel=1e-5)
    assert report.charges["out"] == pytest.approx(-report.charges["in"], rel=1e-8)
    assert observed_order(cells, errors) > 1.9


@pytest.mark.parametrize("as_level_set", [False, True])
def test_a_prolate_spheroid(as_level_set):
    b = 0.35
    focus, at_wall = np.sqrt(3) * b, np.log((2 + np.sqrt(3)) / (2 - np.sqrt(3)))

    def exact(x, y, z):
        xi = (np.sqrt(x**2 + y**2 + (z - focus) ** 2) + np.sqrt(x**2 + y**2 + (z + focus) ** 2)) / (2 * focus)
        return np.log((xi + 1) / (xi - 1)) / at_wall

    def level(x, y, z):
        return x**2 + y**2 + z**2 / 4 - b**2

    shape = shapes.Sphere((0, 0, 0), b).scaled((1, 1, 2))
    if as_level_set:
        shape = shapes.LevelSet(level, (-b * 1.1, -b * 1.1, -b * 2.2), (b * 1.1, b * 1.1, b * 2.2))
    _, _, report = solve(cube(48), [Electrode("egg", shape, voltage=2)], lambda *x: 2 * exact(*x))
    assert report.charges["egg"] == pytest.approx(2 * 1.3151907 * COULOMB * b, rel=1e-4)


def test_two_equal_spheres_between_open_faces():
    a = 0.25
    pair = [
        Electrode(name, shapes.Sphere((0.003, 0.007, z), a), voltage=0) for name, z in (("a", -0.375), ("b", 0.375))
    ]
    capacitance = PoissonSolver(cube(48, "open"), electrodes=pair, tolerance=1e-10).capacitance() / (COULOMB * a)
    assert capacitance == pytest.approx(np.array([[1.1462874, -0.3890831], [-0.3890831, 1.1462874]]), rel=1.5e-3)
    # what the tree behind open faces leaves
    assert capacitance == pytest.approx(capacitance.T, abs=2e-6)


@pytest.mark.parametrize("share", [0.2, 0.6, 0.75])
def test_a_sphere_between_open_faces_is_known_to_the_error_of_the_mesh_in_twelve_cycles(share):
    ball = [Electrode("ball", shapes.Sphere((0.003, -0.002, 0.001), share), voltage=1)]
    hierarchy = cube(24, "open")
    solver = PoissonSolver(hierarchy, electrodes=ball, tolerance=1e-12, max_cycles=12)
    _, early = solver.solve(Field(hierarchy))
    _, _, report = solve(hierarchy, ball)
    of_mesh = abs(report.charges["ball"] / (COULOMB * share) - 1)
    assert of_mesh < 3e-3
    assert early.charges["ball"] == pytest.approx(report.charges["ball"], rel=0.1 * of_mesh)


DISK = 8 * epsilon_0  # F, of a foil of 1 m radius


@pytest.mark.parametrize("share", [0.3, 1e-2, 1e-5])
def test_open_faces_settle_beside_a_foil_however_near_to_centres_of_cells(share):
    """Charge on short arms is what the rest of the equation leaves: the error of φ over such an arm would never settle."""
    hierarchy = Hierarchy(MPI.COMM_SELF, Domain(-2, 2, 32, "open"))
    foil = [Electrode("foil", shapes.Disk((0.013, 0.021, (0.5 + share) / 8), (0, 0, 1), 1), voltage=1)]
    _, _, report = solve(hierarchy, foil, tolerance=1e-10)
    assert report.cycles <= 16
    assert report.charges["foil"] == pytest.approx(DISK, rel=0.025)


@pytest.mark.long
@pytest.mark.parametrize("height", [0.0, 8e-3])
def test_a_disk_with_levels_at_its_edge_has_its_capacitance_to_two_in_a_thousand(height):
    """-0.61, -0.09 and -0.17 % with 2, 3 and 4 levels, the last for either place in cells."""
    foil = [Electrode("foil", shapes.Disk((0.013, 0.021, height), (0, 0, 1), 1), voltage=1)]
    hierarchy = Hierarchy.around(Domain(-2, 2, 32), foil, levels=0, edges=4)
    _, _, report = solve(hierarchy, foil, tolerance=1e-8)
    assert report.charges["foil"] == pytest.approx(DISK, rel=2e-3)


def test_the_field_beside_a_rod_on_planes_of_the_mesh_points_away_from_it():
    """A round rod at 1 V in a pipe: E in the first cells outside is that of the line charge."""
    n, a, b = 64, 0.25, 0.9
    hierarchy = Hierarchy(
        MPI.COMM_SELF,
        Domain((-1, -1, 0), (1, 1, 0.125), (n, n, 4), {"x": "dirichlet", "y": "dirichlet", "z": "periodic"}),
        (),
        ALL,
    )

    def rod(radius, reach):
        return shapes.Cylinder((0, 0, -reach), (0, 0, reach), radius)

    pipe = shapes.Box((-2, -2, -8), (2, 2, 8)) - rod(b, 9)
    solver, phi, _ = solve(hierarchy, [Electrode("rod", rod(a, 9), voltage=1), Electrode("pipe", pipe, voltage=0)])
    efield = solver.electric_field(phi)
    x, y, _ = centres(hierarchy)
    r = np.hypot(x, y)
    first = (r > a) & (r < a + 2 / n * 1.5)
    for component, place in ((efield.x, x), (efield.y, y)):
        exact = place / r**2 / np.log(b / a)
        assert abs(values(component) - exact)[first].max() < 0.02 / a / np.log(b / a)
        assert (values(component) * place)[first].min() > 0
    assert abs(values(efield.z)).max() < 1e-6


@pytest.mark.parametrize("shift", [0.0, 0.5, 1e-13, 0.3])
def test_the_field_beside_a_grounded_box_on_planes_of_the_mesh(shift):
    """Plates of 1 and 0 V on planes between cells, through centres, within rounding of these, and anywhere: E is V/d in all
    cells between them, the first ones too, to rounding."""
    n = 16
    h = 1 / n
    hierarchy = cube(n, ["neumann", "neumann", "dirichlet"], 0.0, 1.0)
    low, high = (3 + shift) * h, (12 - shift) * h
    plates = [
        Electrode("low", shapes.Box((-1, -1, -1), (2, 2, low)), voltage=0),
        Electrode("high", shapes.Box((-1, -1, high), (2, 2, 2)), voltage=1),
    ]
    solver, phi, report = solve(hierarchy, plates, tolerance=0)
    efield = solver.electric_field(phi)
    _, _, z = centres(hierarchy)
    between = (z > low + 1e-9) & (z < high - 1e-9)
    assert values(efield.z)[between] == pytest.approx(-1 / (high - low), rel=1e-10)
    assert values(phi)[between] == pytest.approx((z[between] - low) / (high - low), abs=1e-11)
    assert abs(values(efield.x)).max() < 1e-9
    assert report.charges["high"] == pytest.approx(epsilon_0 / (high - low), rel=1e-10)


def test_a_foil_has_a_potential_on_either_side_and_no_cell_in_metal():
    """A thin sheet across a duct, at 1 V, between plates at 0 and 3 V: cut from both sides."""
    n = 16
    hierarchy = cube(n, ["periodic", "neumann", "dirichlet"], 0.0, 1.0)
    h = 1 / n
    foil = Electrode("foil", shapes.Box((-1, -1, 7.3 * h), (2, 2, 7.3 * h + 1e-7)), voltage=1)
    solver, phi, report = solve(hierarchy, [foil], lambda x, y, z: 3 * (z > 0.5), tolerance=0)
    _, _, z = centres(hierarchy)
    place = 7.3 * h
    expected = np.where(z < place, z / place, 1 + 2 * (z - place) / (1 - place))
    assert values(phi) == pytest.approx(expected, abs=1e-6)
    assert report.charges["foil"] == pytest.approx(epsilon_0 * (1 / place - 2 / (1 - place)), rel=1e-5)


def test_a_disk_screens_one_side_from_the_other():
    n = 24
    hierarchy = cube(n, "dirichlet", 0.0, 1.0)
    disk = Electrode("disk", shapes.Disk((0.5, 0.5, 0.512), (0.1, 0.2, 1), 2.0), voltage=0)
    _, phi, report = solve(hierarchy, [disk], lambda x, y, z: 1.0 * (z == 1.0), tolerance=1e-12)
    x, y, z = centres(hierarchy)
    below = 0.1 * (x - 0.5) + 0.2 * (y - 0.5) + (z - 0.512) < 0
    assert abs(values(phi)[below]).max() < 1e-9 and values(phi)[~below].min() > 0
    assert report.charges["disk"] < 0


def point_charge(hierarchy, place, charge=1e-12, width=1.0) -> Field:
    """Return the density of a charge spread over a ball of `width` cells, whose field outside is that of a point."""
    rho = Field(hierarchy)
    h = hierarchy.domain.spacing[0]
    steps = (np.arange(8) - 3.5) / 8 * h
    fine = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    x = np.stack(centres(hierarchy), axis=-1)
    near = np.argwhere(np.linalg.norm(x - place, axis=-1) < (width + 1) * h)
    for cell in map(tuple, near):
        values(rho)[cell] = (np.linalg.norm(x[cell] + fine - place, axis=1) < width * h).mean()
    values(rho)[...] *= charge / (values(rho).sum() * h**3)
    return rho


def force_of_images(rho, efield, place, charge) -> np.ndarray:
    """Return the force on a charge without that of its own field in free space, N."""
    n = rho.hierarchy.domain.cells
    free = cube(n, "open")
    alone = point_charge(free, place, charge)
    solver = PoissonSolver(free, tolerance=1e-10)
    own = solver.electric_field(solver.solve(alone)[0])
    volume = np.prod(free.domain.spacing)
    pairs = zip(efield.components, own.components, strict=True)
    return np.array([(values(rho) * (values(e) - values(o))).sum() * volume for e, o in pairs])


@pytest.mark.parametrize(("cells_away", "bound"), [(3.3, 0.01), (5.2, 0.005)])
def test_the_image_force_on_a_charge_inside_a_grounded_sphere(cells_away, bound):
    """q² a d / (4πε₀ (a² − d²)²) towards the wall, d from the centre; the wall holds −q."""
    n, a, q = 48, 0.8, 1e-12
    hierarchy = cube(n, "dirichlet")
    h = 2 / n
    d = a - cells_away * h
    place = OFF + np.array((0, 0, d))
    rho = point_charge(hierarchy, place, q)
    shell = Electrode("shell", shapes.Box((-2,) * 3, (2,) * 3) - shapes.Sphere(tuple(OFF), a), voltage=0)
    solver, phi, report = solve(hierarchy, [shell], rho=rho)
    assert report.charges["shell"] == pytest.approx(-q, rel=1e-8)
    force = force_of_images(rho, solver.electric_field(phi), place, q)
    exact = q**2 * a * d / (COULOMB * (a**2 - d**2) ** 2)
    assert force[2] == pytest.approx(exact, rel=bound)
    assert np.abs(force[:2]).max() < bound * exact


@pytest.mark.parametrize("cells_away", [3.3, 6.2])
def test_the_image_force_at_a_plane(cells_away):
    """A grounded half space in an open-like box: walls hold the potential of the charge and its image."""
    n, q = 48, 1e-12
    hierarchy = cube(n, "dirichlet")
    h = 2 / n
    wall = -0.4 * h
    d = cells_away * h
    place = np.array((0.003, -0.004, wall + d))
    image = place - (0, 0, 2 * d)

    def exact(x, y, z):
        return np.where(z > wall, q / COULOMB * (1 / distance(x, y, z, place) - 1 / distance(x, y, z, image)), 0)

    rho = point_charge(hierarchy, place, q)
    plane = Electrode("plane", shapes.Plane((0, 0, wall), (0, 0, 1)), voltage=0)
    solver, phi, _ = solve(hierarchy, [plane], exact, rho=rho)
    force = force_of_images(rho, solver.electric_field(phi), place, q)
    assert force[2] == pytest.approx(-(q**2) / (4 * COULOMB * d**2), rel=0.01)
