# mypy: disable-error-code="arg-type, index, union-attr, operator, misc, assignment"
"""Laws of solves with electrodes: digits on any boxes and ranks, Gauss's law, cycles, and bodies at the limits."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.constants import epsilon_0

from amrpic import Domain, Electrode, Field, Hierarchy, PoissonSolver, shapes
from cut_rows import CutRows
from rank_subsets import first_ranks, wait_quietly

FACES = {"x": ("dirichlet", "neumann"), "y": "periodic", "z": "dirichlet"}
N = 32
H = 2 / N


def hierarchy(n=N, boundary="dirichlet", comm=MPI.COMM_SELF, size=512, levels=(), blocking_factor=4) -> Hierarchy:
    return Hierarchy(comm, Domain(-1, 1, n, boundary), levels, size, blocking_factor)


def charge(x, y, z):
    """Return ρ, C/m³, that changes from cell to cell."""
    return 1e-10 * np.sin(91 * x + 53 * y + 77 * z + 1) + 1e-11 * np.exp(-9 * ((x - 0.2) ** 2 + y**2 + z**2))


def tube(lower, upper, inner=0.4, outer=0.5):
    def rod(low, high, radius):
        return shapes.Cylinder((0.01, 0.02, low), (0.01, 0.02, high), radius)

    return rod(lower, upper, outer) - rod(lower - 1, upper + 1, inner)


def sheet(*slits):
    """Return a foil across the box, with slits along y at these x."""
    out = shapes.Box((-2, -2, 0.3 * H), (2, 2, 0.3 * H + 1e-4))
    for x in slits:
        out = out - shapes.Box((x - 0.05, -0.8, -1), (x + 0.05, 0.8, 1))
    return out


def wire(x, z, radius):
    return shapes.Cylinder((x, -3, z), (x, 3, z), radius)


BODIES = {
    "sphere": [Electrode("ball", shapes.Sphere((0.013, -0.02, 0.03), 0.5), voltage=1)],
    "foil": [Electrode("foil", sheet(), voltage=1)],
    "foil with a slit": [Electrode("foil", sheet(0), voltage=1)],
    "einzel lens": [
        Electrode(name, tube(*ends), voltage=volts)
        for name, ends, volts in (("a", (-0.8, -0.33), 0), ("b", (-0.25, 0.25), 5), ("c", (0.33, 0.8), 0))
    ],
    "two rods": [Electrode("rods", wire(0.2, 0.1 * H, 0.65 * H) | wire(-0.3, 0.1 * H, 0.65 * H), voltage=1)],
    "tilted disk": [Electrode("disk", shapes.Disk((0.01, 0.02, 0.03), (1, 2, 9), 0.7), voltage=1)],
    "a ball and one that floats": [
        Electrode("ball", shapes.Sphere((-0.4, 0.03, 0.02), 0.3), voltage=1),
        Electrode("free", shapes.Sphere((0.4, 0.03, 0.02), 0.3), charge=1e-12),
    ],
}


def solve(mesh, electrodes, potential=None, rho=charge, **options):
    solver = PoissonSolver(mesh, electrodes=electrodes, **{"tolerance": 1e-10, **options})
    phi, report = solver.solve(Field(mesh).fill(rho), boundary_values=potential)
    assert report.converged, report.reason
    return solver, phi, report


def on_cells(field: Field, level: int = 0) -> np.ndarray | None:
    """Return the values of a level (x, y, z) on rank 0, None elsewhere; nan where it has no cells. Collective."""
    comm = field.hierarchy.comm
    parts = comm.gather([(p.lower, p.upper, p.data.copy()) for p in field.patches if p.level == level])
    if parts is None:
        return None
    out = np.full(np.array(field.hierarchy.domain.cells) << level, np.nan)
    for lower, upper, data in (patch for part in parts for patch in part):
        out[tuple(slice(a, b + 1) for a, b in zip(lower, upper, strict=True))] = data
    return out


PATCH = [[((16, 16, 16), (47, 47, 47))]]
SMALL = {
    "sphere": [Electrode("ball", shapes.Sphere((0.013, -0.02, 0.03), 0.28), voltage=1)],
    "two, one of which floats": [
        Electrode("ball", shapes.Sphere((-0.14, 0.03, 0.02), 0.12), voltage=1),
        Electrode("disk", shapes.Disk((0.14, 0.03, 0.02), (1, 2, 3), 0.13), charge=1e-12),
    ],
}


@pytest.mark.parametrize("name", ["sphere", "foil with a slit", "einzel lens", "a ball and one that floats"])
def test_digits_do_not_depend_on_boxes(name):
    (_, phi, report), *others = (solve(hierarchy(size=size), BODIES[name]) for size in (512, 32, 16, 8, 12, 20))
    for _, other, said in others:
        if any(electrode.floats for electrode in BODIES[name]):  # its voltage comes from sums over all cells
            assert on_cells(other) == pytest.approx(on_cells(phi), abs=1e-12)
        else:
            assert np.array_equal(on_cells(other), on_cells(phi))
        assert said.cycles == report.cycles
        assert list(said.charges.values()) == pytest.approx(list(report.charges.values()), rel=1e-12)


@pytest.mark.parametrize("name", ["sphere", "two, one of which floats"])
def test_digits_in_a_refined_box_do_not_depend_on_boxes(name):
    (_, phi, _), *others = (solve(hierarchy(levels=PATCH, size=size), SMALL[name]) for size in (64, 16, 8))
    for _, other, _ in others:
        for level in range(2):
            ours, first = on_cells(other, level), on_cells(phi, level)
            # a floating voltage comes from sums over all cells
            assert np.nanmax(abs(ours - first)) <= (1e-12 if "floats" in name else 0)


@pytest.mark.mpi(ranks=4, timeout=180)
@pytest.mark.parametrize("boundary", ["dirichlet", FACES, "open"], ids=["closed", "mixed", "open"])
@pytest.mark.parametrize("name", ["sphere", "foil with a slit", "a ball and one that floats"])
def test_ranks_change_the_last_digits_at_most(comm, name, boundary):
    if name.startswith("foil") and boundary != "dirichlet":
        pytest.skip("a foil that goes through these faces is refused")
    alone = None
    for ranks in (1, 2, 3, 4):
        part = first_ranks(ranks)
        if part:
            _, phi, report = solve(hierarchy(boundary=boundary, comm=part, size=16), BODIES[name], tolerance=1e-12)
            values = on_cells(phi)
            if ranks == 1:
                alone = values, report
            elif values is not None:
                assert values == pytest.approx(alone[0], abs=1e-12 * abs(alone[0]).max())
                assert report.cycles == alone[1].cycles
                for electrode, amount in report.charges.items():
                    assert amount == pytest.approx(alone[1].charges[electrode], rel=1e-10)
        wait_quietly(comm)


@pytest.mark.mpi(ranks=2)
def test_a_rank_that_has_no_open_faces_goes_along(comm):
    """The mesh is one box, which one of two ranks has."""
    reports = []
    for part in (MPI.COMM_SELF, comm):
        mesh = hierarchy(14, "open", part, blocking_factor=2)
        assert len(mesh.boxes(0)) == 1
        reports.append(solve(mesh, BODIES["sphere"], tolerance=1e-12)[2])
    assert reports[1].cycles == reports[0].cycles
    assert reports[1].charges["ball"] == pytest.approx(reports[0].charges["ball"], rel=1e-10)


@pytest.mark.mpi(ranks=4, timeout=180)
@pytest.mark.parametrize("name", SMALL)
def test_ranks_change_the_last_digits_at_most_in_a_refined_box(comm, name):
    alone = None
    for ranks in (1, 2, 3, 4):
        part = first_ranks(ranks)
        if part:
            mesh = hierarchy(boundary=FACES, comm=part, size=16, levels=PATCH)
            _, phi, _ = solve(mesh, SMALL[name], tolerance=1e-12)
            values = [on_cells(phi, level) for level in range(2)]
            if ranks == 1:
                alone = values
            elif values[0] is not None:
                for ours, first in zip(values, alone, strict=True):
                    assert ours == pytest.approx(first, abs=1e-12 * np.nanmax(abs(first)), nan_ok=True)
        wait_quietly(comm)


@pytest.mark.parametrize("name", BODIES)
def test_gauss_s_law_holds_to_rounding(name):
    """Charges on electrodes, in cells outside them and in them, and the flux through walls add up to nothing."""
    mesh = hierarchy()
    _, phi, report = solve(mesh, BODIES[name], lambda x, y, z: x + z**2, tolerance=0)
    rows = CutRows(mesh.domain, BODIES[name], lambda x, y, z: x + z**2)
    rho = on_cells(Field(mesh).fill(charge))
    solution = rows.solve(rho)
    solution.fluid = on_cells(phi)[rows.fluid]
    solution.voltages = np.array(list(report.voltages.values()))
    total = sum(report.charges.values()) + rho.sum() * H**3 + solution.through_walls()
    largest = max(abs(rho).sum() * H**3, *map(abs, report.charges.values()))
    assert abs(total) < 1e-12 * largest


@pytest.mark.parametrize("name", ["sphere", "a ball and one that floats"])
def test_gauss_s_law_on_two_levels_between_walls_without_flux(name):
    """Neumann and periodic faces: charge on electrodes and charge between them add up to nothing."""
    mesh = hierarchy(boundary={"x": "neumann", "y": "periodic", "z": "neumann"}, levels=PATCH)
    electrodes = SMALL[name] if name in SMALL else SMALL["two, one of which floats"]
    _, _, report = solve(mesh, electrodes, tolerance=0)
    rho = Field(mesh).fill(charge).average_down()
    assert sum(report.charges.values()) == pytest.approx(-rho.integral(), abs=1e-12 * abs(rho).integral())


def cycles(electrodes, n=48, boundary="dirichlet") -> int:
    mesh = hierarchy(n, boundary)
    noise = np.random.default_rng(1).normal(size=(n,) * 3)
    rho = Field(mesh)
    rho.patches[0].data[...] = 1e-10 * noise
    _, report = PoissonSolver(mesh, electrodes=electrodes, tolerance=1e-10).solve(rho)
    assert report.converged, report.reason
    return report.cycles


@pytest.mark.parametrize("name", ["sphere", "foil", "foil with a slit", "einzel lens", "two rods", "tilted disk"])
def test_electrodes_take_two_cycles_more_at_most(name):
    assert cycles(BODIES[name]) <= cycles([]) + 2


@pytest.mark.parametrize("n", [32, 48, 64])
def test_a_grid_of_wires_that_coarse_levels_miss_takes_few_cycles(n):
    """Nine wires of 0.64 cells at a pitch of four: coarse corrections that did not know of them diverged."""
    h = 2 / n
    wires = wire(-15.9 * h, 0.2 * h, 0.64 * h)
    for m in range(-3, 5):
        wires = wires | wire((4 * m + 0.1) * h, 0.2 * h, 0.64 * h)
    assert cycles([Electrode("wires", wires, voltage=1)], n) <= 8


def test_wires_that_a_refined_level_alone_sees_take_few_cycles():
    """Seven wires of a quarter of a cell of the base, whose corrections once made the residual grow."""
    wires = wire(-12 * H + 0.02 * H, 0.03 * H, 0.27 * H)
    for m in range(-2, 4):
        wires = wires | wire(4 * m * H + 0.02 * H, 0.03 * H, 0.27 * H)
    mesh = hierarchy(levels=[[((0, 0, 24), (63, 63, 39))]])
    _, _, report = solve(mesh, [Electrode("wires", wires, voltage=1)])
    assert report.cycles <= 10 and max(report.residuals) == 1


def test_a_needle_in_a_duct_of_long_cells_takes_few_cycles():
    """Much thinner than the cells of coarse levels, and nothing else near holds the potential."""
    domain = Domain(0, (19.2, 1.6, 1.2), (48, 16, 12), {"x": "dirichlet", "y": "periodic", "z": "periodic"})
    needle = shapes.Sphere((0, 0, 0), 1).scaled((1.59, 0.144, 0.109)).moved((15.7, 1.23, 0.41))
    mesh = Hierarchy(MPI.COMM_SELF, domain, (), 512, 2)
    _, _, report = solve(mesh, [Electrode("needle", needle, voltage=1)])
    assert report.cycles <= 8 and max(report.residuals) == 1


def plates(low, high, boundary="dirichlet"):
    return [
        Electrode("low", shapes.Box((-2, -2, -2), (2, 2, low)), voltage=0),
        Electrode("high", shapes.Box((-2, -2, high), (2, 2, 2)), voltage=1),
    ]


LIMITS = {
    "a surface at 1e-12 of an arm from centres": [
        Electrode("e", shapes.Box((-0.3,) * 3, (0.5 * H + 1e-12 * H, 0.4, 0.4)), voltage=1)
    ],
    "a surface at 1e-8 of an arm from centres": [
        Electrode("e", shapes.Box((-0.3 - 0.3 * H,) * 3, ((0.5 - 1e-8) * H, 0.4, 0.4)), voltage=1)
    ],
    "metal that touches walls": [Electrode("e", shapes.Box((-1, -1, -1), (0.1, 0.3, 0.2)), voltage=1)],
    "metal past walls": [Electrode("e", shapes.Sphere((1, 1, 1), 0.7), voltage=1)],
    "metal in half of the box": [Electrode("e", shapes.Plane((0.01, 0, 0), (1, 0, 0)), voltage=1)],
    "metal in nearly all of the box": [
        Electrode("e", shapes.Box((-2,) * 3, (2,) * 3) - shapes.Sphere((0.1, 0.2, 0.1), 2.2 * H), voltage=1)
    ],
    "metal on one cell": [Electrode("e", shapes.Sphere((0.5 * H, 0.5 * H, 0.5 * H), 0.1 * H), voltage=1)],
    "metal on one line between centres": [Electrode("e", shapes.Sphere((H, 0.5 * H, 0.5 * H), 0.1 * H), voltage=1)],
    "a foil between centres": [Electrode("e", shapes.Disk((0, 0, 0), "z", 0.5), voltage=1)],
    "two foils between the same centres": [
        Electrode("e", shapes.Disk((0, 0, 0.3 * H), "z", 0.5), voltage=1),
        Electrode("f", shapes.Disk((0, 0, 0.4 * H), "z", 0.5), voltage=-1),
    ],
    "plates with one cell between them": plates(0.1 * H, 0.9 * H),
    "a hollow of one cell": [
        Electrode("e", shapes.Box((-0.5,) * 3, (0.5,) * 3) - shapes.Box((0.1 * H,) * 3, (0.9 * H,) * 3), voltage=1)
    ],
}


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize("name", LIMITS)
def test_bodies_at_the_limits_are_solved_as_by_a_direct_solve(name, boundary):
    n = 16
    body = [
        Electrode(e.name, e.shape.scaled(2), voltage=e.voltage)
        if "between" in name or "cell" in name or "arm" in name
        else e
        for e in LIMITS[name]
    ]
    mesh = hierarchy(n, boundary)
    rows = CutRows(mesh.domain, body, lambda x, y, z: x + z)
    rho = on_cells(Field(mesh).fill(charge))
    expected = rows.solve(rho)
    _, phi, report = solve(mesh, body, (lambda x, y, z: x + z) if boundary == "dirichlet" else None, tolerance=1e-12)
    size = abs(expected.phi).max()
    assert on_cells(phi) == pytest.approx(expected.phi, abs=1e-8 * size)
    # the oracle takes a flux as the difference over its arm, which has no digits across short ones; all of them together are
    # what walls and the charge between leave for them
    shortest = min(length[electrode >= 0].min(initial=1) for length, _, electrode, _ in rows.arms)
    for found, wanted in zip(report.charges.values(), expected.charges(), strict=True):
        assert found == pytest.approx(wanted, rel=max(1e-7, 1e-12 / shortest), abs=1e-7 * epsilon_0 * size)
    outside = -rho.sum() * float(np.prod(mesh.domain.spacing)) - expected.through_walls()
    assert sum(report.charges.values()) == pytest.approx(outside, abs=1e-8 * epsilon_0 * size)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_plates_with_no_cell_between_them_leave_nothing_to_solve(boundary):
    _, phi, report = solve(hierarchy(16, boundary), plates(-0.45 * H, 0.45 * H))
    z = np.arange(16)
    assert (on_cells(phi) == np.where(z < 8, 0, 1)).all() and np.isfinite(list(report.charges.values())).all()


def test_a_potential_with_electrodes_is_a_sum_of_those_of_its_causes():
    """Voltages, charge between electrodes and walls: φ is linear in each."""
    mesh = hierarchy(boundary="open")
    lens = BODIES["einzel lens"]
    solver, phi, report = solve(mesh, lens, tolerance=1e-11)
    grounded = [Electrode(e.name, e.shape, voltage=0) for e in lens]
    _, of_charge, said = solve(mesh, grounded, tolerance=1e-11)
    total = on_cells(of_charge) + sum(e.voltage * on_cells(solver.unit_potential(e.name)) for e in lens)
    assert total == pytest.approx(on_cells(phi), abs=1e-7)
    charges = np.array(list(said.charges.values())) + solver.capacitance() @ [e.voltage for e in lens]
    assert list(report.charges.values()) == pytest.approx(charges, abs=1e-6 * max(abs(charges)))


def test_an_electrode_that_floats_is_one_at_the_voltage_that_it_finds():
    """φ, E and charges, between open faces too."""
    pair = BODIES["a ball and one that floats"]
    mesh = hierarchy(boundary="open")
    solver, phi, report = solve(mesh, pair, tolerance=1e-11)
    assert report.charges["free"] == pytest.approx(1e-12, rel=1e-8)
    held = [pair[0], Electrode("free", pair[1].shape, voltage=report.voltages["free"])]
    other, same, said = solve(mesh, held, tolerance=1e-11)
    assert said.charges["free"] == pytest.approx(1e-12, rel=1e-5)
    assert on_cells(phi) == pytest.approx(on_cells(same), abs=1e-6)
    one, two = solver.electric_field(phi), other.electric_field(same)
    for ours, theirs in zip(one.components, two.components, strict=True):
        assert on_cells(ours) == pytest.approx(on_cells(theirs), abs=1e-4)


def test_voltages_that_vary_and_guesses():
    mesh = hierarchy()
    electrodes = [Electrode("e", shapes.Sphere((0, 0, 0), 0.4), voltage="3*cos(2*pi*1e6*t)")]
    solver = PoissonSolver(mesh, electrodes=electrodes, tolerance=1e-10)
    nothing = Field(mesh)
    phi, report = solver.solve(nothing)
    assert report.voltages["e"] == 3 and report.charges["e"] == pytest.approx(3 * solver.capacitance()[0, 0], rel=1e-8)
    again, said = solver.solve(nothing, guess=phi, last=report)
    assert said.cycles <= 1 and on_cells(again) == pytest.approx(on_cells(phi), abs=1e-8)
    later, said = solver.solve(nothing, guess=phi, time=0.5e-6)
    assert said.voltages["e"] == pytest.approx(-3) and on_cells(later) == pytest.approx(-on_cells(phi), abs=1e-7)


def test_the_field_of_a_unit_potential_is_its_own():
    """Whatever was solved last: E at the walls and beside electrodes is that of one electrode at 1 V."""
    mesh = hierarchy(16, "open")
    pair = [
        Electrode("a", shapes.Sphere((-0.3, 0, 0), 0.25), voltage=3),
        Electrode("b", shapes.Sphere((0.4, 0, 0), 0.2), voltage=-7),
    ]
    solver = PoissonSolver(mesh, electrodes=pair, tolerance=1e-10)
    alone = PoissonSolver(
        mesh, electrodes=[Electrode("a", pair[0].shape, voltage=1), Electrode("b", pair[1].shape, voltage=0)]
    )
    phi, _ = alone.solve(Field(mesh))
    expected = alone.electric_field(phi)
    latest, _ = solver.solve(Field(mesh).fill(charge))
    before = solver.electric_field(latest)
    unit = solver.electric_field(solver.unit_potential("a"))
    after = solver.electric_field(latest)
    for axis in range(3):
        size = abs(on_cells(expected.components[axis])).max()
        assert on_cells(unit.components[axis]) == pytest.approx(on_cells(expected.components[axis]), abs=1e-5 * size)
        assert np.array_equal(on_cells(after.components[axis]), on_cells(before.components[axis]))
