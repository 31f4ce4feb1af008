"""Finite elements at points: orders of the bakeoff problems BP1 to BP4, and their operators beside dense matrices.

BP1 and BP2 are projections, BP3 and BP4 Poisson's equation with zeros on the surface; BP2 and BP4 have three components.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from mpi4py import MPI

from amrpic import fem
from amrpic.verify.table import Goal, Table
from exact.dense_elements import matrix, of_one_dimension, on_all_nodes, rows_at, smooth_vector

Make = Callable[[fem.Mesh], fem.Points]
PROBLEMS = {
    "BP1": (fem.Mass, 1),
    "BP2": (fem.Mass, 3),
    "BP3": (fem.Poisson, 1),
    "BP4": (fem.Poisson, 3),
}
COARSE = {1: 16, 2: 8, 3: 4, 4: 6}  # elements per axis of the coarser mesh, by degree
SEEDS = (1, 2, 3, 4, 5)
DEGREES = (1, 2, 3, 4)


# ---- exact solutions ----


@dataclass(frozen=True)
class Factor:
    """A function of one coordinate, and its second derivative."""

    value: Callable[[np.ndarray], np.ndarray]
    second: Callable[[np.ndarray], np.ndarray]


def _sine(k: int) -> Factor:
    return Factor(lambda x: np.sin(k * np.pi * x), lambda x: -((k * np.pi) ** 2) * np.sin(k * np.pi * x))


def _weierstrass() -> Factor:
    """Σ aⁿ cos(bⁿ π x) for n up to 2, a = 1/2, b = 3/2, times x (1 - x)."""
    terms = [(0.5**n, 1.5**n * np.pi) for n in range(3)]

    def derivative(order: int, x: np.ndarray) -> np.ndarray:
        return sum((a * b**order * np.cos(b * x + order * np.pi / 2) for a, b in terms), np.zeros_like(x))

    def value(x: np.ndarray) -> np.ndarray:
        return x * (1 - x) * derivative(0, x)

    def second(x: np.ndarray) -> np.ndarray:
        return x * (1 - x) * derivative(2, x) + 2 * (1 - 2 * x) * derivative(1, x) - 2 * derivative(0, x)

    return Factor(value, second)


def _tilted() -> Factor:
    return Factor(
        lambda x: (1 + x) * np.sin(np.pi * x),
        lambda x: 2 * np.pi * np.cos(np.pi * x) - np.pi**2 * (1 + x) * np.sin(np.pi * x),
    )


SOLUTIONS = {"smooth": (_tilted(), _sine(2), _sine(1)), "Weierstrass": (_weierstrass(),) * 3}


def exact(solution: str, x: np.ndarray, components: int) -> np.ndarray:
    """The solution at places (n, 3): (n,), or (n, 3), each component with its factors along other axes."""
    return _of_components(_value, solution, x, components)


def source(solution: str, x: np.ndarray, components: int) -> np.ndarray:
    """Minus its Laplacian."""
    return _of_components(_minus_laplacian, solution, x, components)


def _of_components(f: Callable, solution: str, x: np.ndarray, components: int) -> np.ndarray:
    factors = SOLUTIONS[solution]
    rows = [f(factors[c:] + factors[:c], x) for c in range(components)]
    return rows[0] if components == 1 else np.stack(rows, axis=1)


def _value(factors: Sequence[Factor], x: np.ndarray) -> np.ndarray:
    return factors[0].value(x[:, 0]) * factors[1].value(x[:, 1]) * factors[2].value(x[:, 2])


def _minus_laplacian(factors: Sequence[Factor], x: np.ndarray) -> np.ndarray:
    values = [f.value(x[:, d]) for d, f in enumerate(factors)]
    second = [f.second(x[:, d]) for d, f in enumerate(factors)]
    return -(second[0] * values[1] * values[2] + values[0] * second[1] * values[2] + values[0] * values[1] * second[2])


# ---- errors and orders ----


def errors(
    comm: MPI.Comm, solution: str, degree: int, cells: int, make: Make, problems: Sequence[str] = tuple(PROBLEMS)
) -> dict[str, float]:
    """The L2 error of each problem, by Gauss's degree + 3 points along each axis of the mesh's elements. Collective."""
    mesh = fem.Mesh(comm, 0, 1, cells, degree=degree)
    points, at = make(mesh), fem.gauss(mesh, degree + 3)
    out = {}
    for name in problems:
        kind, components = PROBLEMS[name]
        right = (exact if kind is fem.Mass else source)(solution, points.position, components)
        operator, load = kind(points, components=components), points.integrate(right)
        if kind is fem.Mass:
            u, report = fem.solve(operator, load, preconditioner="jacobi", tolerance=1e-11)
        else:
            u, report = fem.solve(operator, load, fixed=mesh.boundary, tolerance=1e-11)
        assert report.converged, report.reason
        wrong = (at.values(u) - exact(solution, at.position, components)).reshape(len(at), components)
        out[name] = float(np.sqrt(mesh.comm.allreduce((at.weight * (wrong**2).sum(axis=1)).sum())))
    return out


def orders(
    comm: MPI.Comm, solution: str, degree: int, make: Make, problems: Sequence[str] = tuple(PROBLEMS)
) -> dict[str, tuple[float, float]]:
    """For each problem the order of the error between two meshes, and the error on the finer one. Collective."""
    coarse, fine = (errors(comm, solution, degree, n * COARSE[degree], make, problems) for n in (1, 2))
    return {name: (float(np.log2(coarse[name] / fine[name])), fine[name]) for name in problems}


# ---- layouts ----


@dataclass(frozen=True)
class Layout:
    """Points of a row of the table."""

    degree: int
    kind: str  # "uniform" or "jittered"
    per_axis: int
    weights: fem.points.Weights
    least: float | None = None  # order of BP3 and BP4 that must be reached
    as_gauss: bool = False  # whether their errors must be those of Gauss's points

    def make(self, seed: int) -> Make:
        if self.kind == "uniform":
            return partial(fem.uniform, per_axis=self.per_axis, weights=self.weights)
        kind = fem.jittered if self.kind == "jittered" else fem.random
        return partial(kind, per_axis=self.per_axis, seed=seed, weights=self.weights)


LAYOUTS = (
    *(Layout(p, "uniform", k, "moments", p + 0.8, True) for p, k in ((1, 3), (2, 4), (3, 6), (4, 8))),
    Layout(1, "jittered", 3, "moments", 1.8),
    Layout(2, "jittered", 6, "moments", 2.8),
    Layout(3, "jittered", 8, "moments", 2.6),
    Layout(1, "random", 4, "volume"),
    Layout(2, "uniform", 4, "volume"),
    Layout(2, "jittered", 6, "volume"),
    Layout(2, "random", 6, "volume"),
    Layout(3, "uniform", 6, "volume"),
    Layout(3, "jittered", 8, "volume"),
)
MOST_OF_GAUSS = 1.05


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield Table(
        "Elements: orders at Gauss points",
        "Order of the L2 error from n to 2n elements along each axis, n = 16, 8, 4, 6 for degrees 1 to 4; the smooth solution "
        "is (1 + x) sin πx sin 2πy sin πz, the other Weierstrass's sum of three terms times x (1 - x) along each axis. Sum "
        "factorisation at degree + 1 points.",
        ("solution", "degree", *PROBLEMS, "error of BP3, 2n"),
        [_at_gauss(comm, solution, degree) for solution in SOLUTIONS for degree in DEGREES],
    )
    yield Table(
        "Elements: orders at points",
        "The smooth solution at points in all elements; jittered: a random one in each of k³ parts; orders of BP3 there are "
        "the median of five seeds. Weights by moments are exact to Qm, volumes "
        "to nothing but constants. The errors of BP3 and BP4 on the finer mesh stand beside those at Gauss's points.",
        ("degree", "points", "weights", "m", *PROBLEMS, "error of BP3 over Gauss's", "of BP4"),
        [_at_points(comm, layout) for layout in LAYOUTS],
    )
    yield Table(
        "Elements: operators beside dense matrices",
        "Largest differences, in parts of the largest entry, on 3 × 2 × 4 elements in boxes of two: Gauss's points against "
        "products of one-dimensional matrices; points, ragged and with empty elements, against dense ones from powers of x. "
        "Asymmetry: <u, Av> - <v, Au> over |Au||v|. One rank against all of them: vectors, diagonals and transfers.",
        ("degree", "operator", "Gauss", "points", "diagonal", "values", "slopes", "asymmetry", "ranks"),
        [_beside_dense(comm, degree, kind) for degree in DEGREES for kind in (fem.Mass, fem.Poisson)],
    )


def _at_gauss(comm: MPI.Comm, solution: str, degree: int) -> list[str | float | Goal]:
    found = orders(comm, solution, degree, fem.gauss)
    shown: list[float | Goal] = [
        Goal(o, degree + 0.8, least=True) if solution == "smooth" else o for o, _ in found.values()
    ]
    return [solution, degree, *shown, found["BP3"][1]]


def _at_points(comm: MPI.Comm, layout: Layout) -> list[str | float | Goal]:
    found = {name: [values] for name, values in orders(comm, "smooth", layout.degree, layout.make(SEEDS[0])).items()}
    for seed in SEEDS[1:] if layout.kind != "uniform" else ():
        found["BP3"].append(orders(comm, "smooth", layout.degree, layout.make(seed), ["BP3"])["BP3"])
    at_gauss = errors(comm, "smooth", layout.degree, 2 * COARSE[layout.degree], fem.gauss, ["BP3", "BP4"])
    shown: list[float | Goal] = []
    for name, values in found.items():
        least = layout.degree + 0.8 if PROBLEMS[name][0] is fem.Mass else layout.least
        median = float(np.median([o for o, _ in values]))
        shown.append(median if least is None else Goal(median, least, least=True))
    for name, of_gauss in at_gauss.items():
        ratio = float(np.median([e for _, e in found[name]])) / of_gauss
        shown.append(Goal(ratio, MOST_OF_GAUSS) if layout.as_gauss else ratio)
    return [layout.degree, f"{layout.kind} {layout.per_axis}³", layout.weights, _reached(comm, layout), *shown]


def _reached(comm: MPI.Comm, layout: Layout) -> str:
    """The least and the highest degree of weights on the coarser mesh. Collective."""
    reached = list(layout.make(SEEDS[0])(fem.Mesh(comm, 0, 1, COARSE[layout.degree], degree=layout.degree)).exactness())
    if layout.weights == "volume":
        return ""
    return str(reached[0]) if len(reached) == 1 else f"{reached[0]} to {reached[-1]}"


# ---- beside dense matrices ----


def ragged(mesh: fem.Mesh) -> fem.Points:
    """From none to some dozens of points in an element, also on faces between elements and on those of the mesh. Collective."""
    rng = np.random.default_rng(5)
    lower, upper = np.array(mesh.domain.lower), np.array(mesh.domain.upper)
    dense = lower + rng.uniform(size=(300, 3)) * mesh.spacing * [2, 1, 1]
    sparse = lower + rng.uniform(size=(40, 3)) * (upper - lower) * [1, 1, 0.7]
    faces = np.minimum(lower + rng.integers(0, 3, (20, 3)) * mesh.spacing, upper)
    corners = np.array([upper, [upper[0], lower[1], lower[2] + 0.01 * mesh.spacing[2]]])
    places = np.concatenate([dense, sparse, faces, corners])
    volume = rng.uniform(0.1, 1, len(places)) * mesh.element_volume / 100
    return fem.given(mesh, places, volume=volume, weights="volume")


def small_mesh(comm: MPI.Comm, degree: int) -> fem.Mesh:
    return fem.Mesh(comm, (0.1, -1, 2), (1.3, 0.2, 2.9), (3, 2, 4), degree=degree, max_grid_size=2)


def _beside_dense(comm: MPI.Comm, degree: int, kind: type[fem.Operator]) -> list[str | float | Goal]:
    mesh = small_mesh(MPI.COMM_SELF, degree)
    points = ragged(mesh)
    u, (value, slope) = smooth_vector(mesh, 3), rows_at(points)
    whole, dense = on_all_nodes(mesh, u), matrix(points, kind)
    operator, at_gauss = kind(points, components=3), kind(fem.gauss(mesh), components=3)
    v = np.random.default_rng(1).standard_normal(u.shape)
    asymmetry = abs((u * (operator @ v)).sum() - (v * (operator @ u)).sum())
    return [
        degree,
        kind.__name__,
        Goal(difference(on_all_nodes(mesh, at_gauss @ u), of_one_dimension(mesh, kind) @ whole), 1e-12),
        Goal(difference(on_all_nodes(mesh, operator @ u), dense @ whole), 1e-12),
        Goal(difference(on_all_nodes(mesh, operator.diagonal())[:, 0], np.diag(dense)), 1e-12),
        Goal(difference(points.values(u), value @ whole), 1e-12),
        Goal(difference(points.slopes(u), np.moveaxis(slope @ whole, 0, -1)), 1e-12),
        Goal(float(asymmetry / np.linalg.norm(operator @ u) / np.linalg.norm(v)), 1e-13),
        Goal(_of_ranks(comm, degree, kind), 1e-12),
    ]


def difference(found: np.ndarray, expected: np.ndarray) -> float:
    """The largest one, in parts of the largest expected value."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def _of_ranks(comm: MPI.Comm, degree: int, kind: type[fem.Operator]) -> float:
    """The largest difference of what all ranks find together and one alone. Collective."""
    found = []
    for who in (comm, MPI.COMM_SELF):
        mesh = small_mesh(who, degree)
        points = ragged(mesh)
        operator = kind(points, components=3)
        vectors = (operator @ smooth_vector(mesh, 3), operator.diagonal(), points.integrate(points.position))
        found.append([on_all_nodes(mesh, v) for v in vectors])
    return max(difference(one, other) for one, other in zip(*found, strict=True))
