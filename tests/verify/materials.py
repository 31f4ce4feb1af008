"""Solids at points: laws and their tangents, patch test, confined compression, Newton's order, damage, multigrid."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from mpi4py import MPI

from amrpic import fem, mpm
from amrpic.verify.table import Cell, Goal, Table
from exact.press import Pressed, confined, exact_stress, iterations, upper_face

from .lengths import in_brief

YOUNG = 300e6
PLAIN = mpm.NeoHookean(YOUNG, 0.25)
LAWS: dict[str, mpm.Material] = {
    "neo-hookean": PLAIN,
    "ogden, one term": mpm.Ogden(((PLAIN.mu, 2.0),), PLAIN.lame),
    "ogden, three terms": mpm.Ogden(
        ((0.6 * PLAIN.mu, 1.3), (0.5 * PLAIN.mu, 5.0), (-0.1 * PLAIN.mu, -2.0)), PLAIN.lame
    ),
    "damaged by 0.4": mpm.NeoHookean(YOUNG, 0.25, mpm.Damage(60.0, 0.25)),
}
LAYOUTS: dict[str, Callable[[fem.Mesh], fem.Points]] = {
    "Gauss": fem.gauss,
    "jittered 4³": lambda mesh: fem.jittered(mesh, 4),
}
ONE_STRESS = ("neo-hookean", "ogden, one term")  # the same law in two forms
PATCHES = (
    *((law, *case) for law in ONE_STRESS for case in ((1, "jittered", 4), (2, "jittered", 5), (3, "jittered", 8))),
    *((law, 4, "uniform", 8) for law in ONE_STRESS),
)
BY_VOLUMES = (("neo-hookean", 1, "jittered", 4), ("neo-hookean", 2, "jittered", 5))
GRADIENT = np.array([[0.1, 0.05, -0.08], [0.02, -0.2, 0.1], [0.1, 0, 0.15]])


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective: all ranks share the work of the last table; each does that of the others alone."""
    yield Table(
        "Solids: forces and tangents",
        "3³ elements of degree 2, points deformed before (those that break are stretched, as their modulus jumps at J = 1), "
        "and a wavy displacement. Largest differences in parts of the largest entry: work of internal forces against "
        "differences of the energy, tangent against differences of forces, the tangent with gradients in the initial against "
        "that in the current configuration; sums of internal forces and of their moments over those of their sizes.",
        ("law", "points", "forces", "tangent", "initial and current", "force", "moment"),
        [_derivatives(law, layout) for law in LAWS for layout in LAYOUTS],
    )
    yield Table(
        "Solids: patch test",
        "Walls of 3³ elements move affinely by up to 20 %; Newton's method starts 1 % of the size away. Largest difference of "
        "the displacement from the affine one, in parts of the size, and of stress, in parts of Young's modulus.",
        ("law", "degree", "points", "weights", "m", "displacement", "stress", "iterations"),
        [
            _patch(*case, fitted=fitted)
            for fitted, cases in ((True, PATCHES), (False, BY_VOLUMES))
            for case in cases
            if case[1] <= 2 or not in_brief()
        ],
    )
    yield Table(
        "Solids: confined compression",
        "A cube between walls without friction, E = 300 MPa, ν = 0.25, pressed to 0.6 of its height; F and volumes are carried "
        "by jittered points from one mesh to the next. Axial and lateral Cauchy stress off -230.165 and -102.165 MPa, the "
        "worst point's; work of the walls, by the trapezoidal rule over steps, over the stored energy.",
        ("law", "degree", "steps", "axial", "lateral", "work - energy", "over that of twice the steps"),
        [_pressed(law, degree) for law in ONE_STRESS for degree in ((1,) if in_brief() else (1, 2))],
    )
    yield Table(
        "Solids: Newton's method",
        "A block of 3 × 3 × 6 elements at Gauss's points, whose upper face turns about an axis in it by 0.3 rad at once. Order "
        "of the last three residuals above 1e-13 of all forces with linear solves to 1e-13; iterations of Newton's method and "
        "all of CG, with those solves and with forcing terms.",
        ("law", "degree", "order", "iterations", "CG", "with forcing terms", "CG"),
        [_newton(law, degree) for law in (ONE_STRESS if in_brief() else LAWS) for degree in (1, 2)],
    )
    yield Table(
        "Solids: damage",
        "d = 1 on a plane across a bar, ℓ four node spacings, jittered 6³ points: largest difference from exp(-|x|/ℓ), and "
        "energy over G times the area.",
        ("degree", "profile", "energy - 1"),
        [_crack(degree) for degree in ((1,) if in_brief() else (1, 2, 3))],
    )
    yield Table(
        "Solids: multigrid",
        "Iterations of CG to 1e-8 for the first tangent of a press, jittered points (64 an element, 216 for degrees 3 and 4), "
        "volume weights: one material, or Voronoi's grains (4 GPa) in a binder (300 MPa) with spherical voids of sticky air. "
        "Degree 1 and below by half the elements, or by MueLu's aggregates; growth is from elements twice as large.",
        ("degree", "elements", "air, MPa", "half the elements", "growth", "aggregates - half", "Jacobi", "growth"),
        _multigrid(comm),
    )


def _wavy(mesh: fem.Mesh, seed: int = 0, size: float = 0.03) -> np.ndarray:
    return size * np.stack([np.sin(3 * mesh.nodes @ [1, 2, 1.5 + d] + 5 * d + seed) for d in range(3)], axis=1)


def _slope(f: Callable[[float], np.ndarray]) -> np.ndarray:
    """Derivative at 0, to fourth order."""
    h = 1e-3
    return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)


def _derivatives(law: str, layout: str) -> list[Cell]:
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 3, degree=2)
    points = LAYOUTS[layout](mesh)
    wave = np.sin(7 * points.position[:, :, None] + [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    solid = mpm.Solid(
        points,
        LAWS[law],
        deformation=(np.eye(3) + 0.1 * wave) * (1.8 if law.startswith("damaged") else 1),
        damage=np.full(len(points), 0.4),
    )
    u, v = _wavy(mesh), _wavy(mesh, seed=3)
    force, tangent = solid.respond(u).force, solid.tangent(u) @ v
    work = float(_slope(lambda t: np.array(solid.respond(u + t * v).energy)))
    change = _slope(lambda t: solid.respond(u + t * v).force)
    forms: str | Goal = ""
    if law == "neo-hookean":
        initial = solid.tangent(u, "initial") @ v
        forms = Goal(float(np.abs(initial - tangent).max() / np.abs(tangent).max()), 1e-12)
    size, at = np.abs(force).sum(), mesh.nodes + u
    return [
        law,
        layout,
        Goal(abs(float((force * v).sum()) - work) / float(np.abs(force * v).sum()), 1e-7),
        Goal(float(np.abs(tangent - change).max() / np.abs(change).max()), 1e-7),
        forms,
        Goal(float(np.abs(force.sum(axis=0)).max() / size), 1e-12),
        Goal(float(np.abs(np.cross(at, force).sum(axis=0)).max() / size), 1e-12),
    ]


def _patch(law: str, degree: int, kind: str, per_axis: int, fitted: bool) -> list[Cell]:
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 3, degree=degree)
    weights: fem.points.Weights = "moments" if fitted else "volume"
    make = fem.jittered if kind == "jittered" else fem.uniform
    points = make(mesh, per_axis, weights=weights)
    exact = mesh.nodes @ GRADIENT.T
    start = exact + 0.01 * np.sin(20 * mesh.nodes) * ~mesh.boundary[:, None]
    solid = mpm.Solid(points, LAWS[law])
    u, report = mpm.equilibrium(solid, fixed=mesh.boundary, values=exact, start=start, tolerance=1e-12)
    assert report.converged, report.reason
    stress = solid.states(u).cauchy
    off, uneven = float(np.abs(u - exact).max()), float(np.abs(stress - stress[0]).max() / YOUNG)
    shown: list[Cell] = ["", off, uneven, report.iterations]
    if fitted:
        exactness = Goal(min(points.exactness()), degree, least=True)
        shown = [exactness, Goal(off, 1e-10), Goal(uneven, 1e-10), Goal(report.iterations, 6)]
    return [law, degree, f"{kind} {per_axis}³", weights, *shown]


def _pressed(law: str, degree: int) -> list[Cell]:
    def pressed(steps: int) -> Pressed:
        return confined(MPI.COMM_SELF, LAWS[law], degree, lambda mesh: fem.jittered(mesh, 3 + degree), steps)

    few, many = pressed(10), pressed(20)
    axial, lateral = exact_stress(PLAIN)
    gap, smaller = (abs(found.work / found.energy - 1) for found in (few, many))
    return [
        law,
        degree,
        10,
        Goal(max(abs(s / axial - 1) for s in few.axial), 1e-8),
        Goal(max(abs(s / lateral - 1) for s in few.lateral), 1e-8),
        Goal(gap, 0.01),
        Goal(gap / smaller, 3.9, least=True),
    ]


def _newton(law: str, degree: int) -> list[Cell]:
    mesh = fem.Mesh(MPI.COMM_SELF, 0, (1, 1, 2), (3, 3, 6), degree=degree)
    top = upper_face(mesh)
    values, y = np.zeros((len(mesh.nodes), 3)), mesh.nodes[top, 1] - 0.5
    values[top, 1], values[top, 2] = y * (np.cos(0.3) - 1), y * np.sin(0.3)
    points = fem.gauss(mesh)
    solid = mpm.Solid(points, LAWS[law], damage=np.full(len(points), 0.4))
    fixed = (mesh.node_indices[:, 2] == 0) | top
    tight, forced = (
        mpm.equilibrium(solid, fixed=fixed, values=values, tolerance=5e-14, linear_tolerance=linear)[1]
        for linear in (1e-13, None)
    )
    assert tight.converged and forced.converged
    residuals = [r for r in tight.residuals if r > 1e-13 * tight.size][-3:]
    first, second, third = np.log(residuals)
    return [
        law,
        degree,
        Goal(float((third - second) / (second - first)), 1.8, least=True),
        tight.iterations,
        sum(tight.gradients),
        Goal(forced.iterations, tight.iterations + 1),
        Goal(sum(forced.gradients), sum(tight.gradients) - 1),
    ]


def _crack(degree: int) -> list[Cell]:
    cells = {1: 80, 2: 40, 3: 24}[degree]
    mesh = fem.Mesh(MPI.COMM_SELF, (0, 0, 0), (1, 0.05, 0.05), (cells, 2, 2), degree=degree)
    length, toughness = 4 / (cells * degree), 60.0
    solid = mpm.Solid(fem.jittered(mesh, 6), mpm.NeoHookean(4e9, 0.25, mpm.Damage(toughness, length)))
    away = np.abs(mesh.nodes[:, 0] - 0.5)
    d = mpm.damage_field(solid, np.zeros(len(solid.points)), fixed=away < 1e-9, values=1.0)
    off = float(np.abs(d - np.exp(-away / length)).max())
    return [degree, Goal(off, 0.02), Goal(abs(solid.dissipated(d) / (toughness * 0.05**2) - 1), 0.02)]


# degree, elements and points along each axis, stiffness of air in MPa, most iterations
MULTIGRID = (
    (1, 8, 4, None, 8),
    (2, 8, 4, None, 8),
    (3, 8, 6, None, 11),
    (4, 4, 6, None, 15),
    (1, 16, 4, 5.0, None),
    (2, 8, 4, 0.05, None),
    (2, 8, 4, 50.0, None),
    (2, 8, 4, 5.0, 30),
    (2, 16, 4, 5.0, 35),
    (2, 32, 4, 5.0, 45),
    (3, 8, 6, 5.0, None),
    (4, 4, 6, 5.0, None),
)
BRIEF_MULTIGRID = ((1, 8, None), (2, 8, None), (3, 8, None), (2, 8, 5.0), (2, 16, 5.0))  # degrees, elements and air


def _multigrid(comm: MPI.Comm) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    found: dict[tuple[int, int, float | None], dict[str, int]] = {}
    for degree, cells, per_axis, air, most in MULTIGRID:
        if in_brief() and (degree, cells, air) not in BRIEF_MULTIGRID:
            continue
        taken = found[degree, cells, air] = iterations(comm, degree, cells, per_axis, air and air * 1e6)
        few: float | Goal = taken["geometric"] if most is None else Goal(taken["geometric"], most)
        growth: list[Cell] = ["", ""]
        if (larger := found.get((degree, cells // 2, air))) is not None:
            growth = [
                Goal(taken["geometric"] / larger["geometric"], 1.5),
                Goal(taken["jacobi"] / larger["jacobi"], 1.7, least=True),
            ]
        apart = Goal(abs(taken["aggregation"] - taken["geometric"]), 3)
        jacobi: Cell = taken["jacobi"] if larger is None else Goal(taken["jacobi"], 15 * taken["geometric"], least=True)
        rows.append([degree, f"{cells}³", "" if air is None else air, few, growth[0], apart, jacobi, growth[1]])
    return rows
