"""The composite Laplacian without matrices is that of the CRS operators, on every mesh, boundary and number of ranks."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy import sparse
from scipy.constants import epsilon_0

import amrpic
from amrpic import _native
from amrpic.mesh.domain import BOUNDARIES
from amrpic.particles.clouds import SHAPES, Clouds
from amrpic.stages.gather import gather
from amrpic.stages.migrate import migrate
from exact.meshes import MESHES
from hierarchies import all_cases
from particle_cases import scattered as scattered_particles
from rank_subsets import hierarchy_of, wait_quietly

CASES = all_cases()
MIXED = {"x": ("dirichlet", "neumann"), "y": ("open", "dirichlet"), "z": ("neumann", "open")}
WALLS: dict[str, Any] = {
    "open": "open",
    "dirichlet": "dirichlet",
    "neumann": "neumann",
    "periodic": "periodic",
    "mixed": MIXED,
}
NORMS = ("max", "l1", "l2")
ROUNDING = 2e-14  # of the largest term, for sums of some ten terms
Levels = list[np.ndarray]


class Problem:
    """A hierarchy with charge, potential and wall data without any pattern, and what the CRS operators make of them.

    Values are drawn for cells and walls of the whole mesh, so that they are the same on any boxes and ranks.
    """

    def __init__(self, hierarchy: amrpic.Hierarchy, stretch: Sequence[float] = (1, 1, 1)) -> None:
        self.hierarchy, self.stretch = hierarchy, np.array(stretch, dtype=float)
        self.solver = amrpic.PoissonSolver(hierarchy, backend="crs", bottom="direct", stretch=stretch)
        self.laplacian = _native.CompositeLaplacian(hierarchy.native, list(self.stretch))
        self.rho, self.phi = self.drawn(1, epsilon_0), self.drawn(2, 1.0)
        self.phi.native.average_down()
        self.walls = self.set_walls()
        self.mean = 0.3
        self.ones = [1.0] * hierarchy.levels

    def drawn(self, seed: int, unit: float) -> amrpic.Field:
        field = amrpic.Field(self.hierarchy)
        for patch in field.patches:
            cells = np.ogrid[tuple(slice(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True))]
            patch.data[...] = unit * scattered(seed + 10 * patch.level, *cells)
        return field

    def set_walls(self) -> Levels:
        """Data of the walls, also of the solver's; [level]."""
        out = []
        for level in range(self.hierarchy.levels):
            _, axis, cells, upper = self.wall_cells(level)
            data = self.solver.native.wall_data(level)
            data[...] = scattered(3 + 10 * level + 0.1 * axis + 0.5 * upper, *cells.T)
            out.append(data.copy())
        return out

    def shape(self, level: int) -> tuple[int, ...]:
        return tuple(2**level * n for n in self.hierarchy.domain.cells)

    def spacing(self, level: int) -> np.ndarray:
        return np.array(self.hierarchy.spacing(level)) * self.stretch

    def wall_cells(self, level: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Kind, axis, cell, and whether it is an upper face, of each wall face of this rank."""
        kind, axis, position = self.solver.native.wall_faces(level)
        domain, faces = self.hierarchy.domain, np.arange(len(kind))
        place = (position - np.array(domain.lower)) / np.array(self.hierarchy.spacing(level))
        cells = np.floor(place).astype(int)
        upper = place[faces, axis] > 1
        cells[faces, axis] = np.where(upper, np.array(self.shape(level))[axis] - 1, 0)
        return kind, axis, cells, upper

    def right_hand_side(self, level: int, term=lambda x: x) -> np.ndarray:
        """-rho / eps0 less the mean and what the data of the walls add to the Laplacian; `term` of each of the three."""
        h = self.spacing(level)
        out = term(-self.rho.native.level(level) / _native.vacuum_permittivity) + term(-self.mean)
        for row, d, _, ghost in self.data_in_ghosts(level):
            out[row] += term(-ghost / h[d] ** 2)
        return out

    def data_in_ghosts(self, level: int) -> Iterator[tuple[int, int, bool, float]]:
        """Row, axis, whether it is an upper face, and what the datum adds to the ghost, of each wall face of this rank."""
        rows = np.full(self.shape(level), -1)
        first = 0
        for patch in self.rho.patches:
            if patch.level == level:
                rows[slices_of(patch)] = first + np.arange(patch.data.size).reshape(patch.data.shape, order="F")
                first += patch.data.size
        for kind, axis, cell, upper, datum in zip(*self.wall_cells(level), self.walls[level], strict=True):
            yield rows[tuple(cell)], axis, upper, self.ghost(BOUNDARIES[kind], axis, level, 0.0, 0.0, datum)

    def ghost(self, kind: str, axis: int, level: int, first: Any, second: Any, datum: Any) -> Any:
        """The value behind a wall from the first and second cell before it."""
        if kind == "dirichlet":
            return 8 / 3 * datum - 2 * first + second / 3
        return datum if kind == "open" else first + self.spacing(level)[axis] * datum

    def field_of_operators(self, axis: int, covered: str) -> amrpic.Field:
        """E along an axis; in covered cells the mean of the children, or differences between cells of their level."""
        out = amrpic.Field(self.hierarchy)
        for level in range(self.hierarchy.levels):
            values = np.zeros_like(out.native.level(level))
            for name, other in (("own", level), ("coarse", level - 1), ("fine", level + 1)):
                if 0 <= other < self.hierarchy.levels:
                    values += self.operator(level, f"gradient_{name}", other, axis) @ self.whole(self.phi, other)
            for row, d, upper, ghost in self.data_in_ghosts(level):
                if d == axis:
                    values[row] += (-ghost if upper else ghost) / (2 * self.spacing(level)[axis])
            out.native.level(level)[...] = np.where(self.uncovered(level), values / self.stretch[axis], 0.0)
        out.native.average_down()
        if covered == "difference":
            for level in range(self.hierarchy.levels):
                own = np.where(self.uncovered(level), out.native.level(level), self.differences(level, axis))
                out.native.level(level)[...] = own
        return out

    def differences(self, level: int, axis: int) -> np.ndarray:
        """E in this rank's cells of a level from the neighbours on it, nan where one is missing."""
        (phi,) = self.dense([self.phi.native.level(level)], level)
        phi = np.moveaxis(np.where(np.isinf(phi), np.nan, phi), axis, 0)
        low, high = np.roll(phi, 1, 0), np.roll(phi, -1, 0)
        cells = np.moveaxis(np.indices(self.shape(level)), axis + 1, 1)
        for side, (kind, beyond) in enumerate(zip(self.hierarchy.domain.boundary[axis], (low, high), strict=True)):
            first, second = (0, 1) if side == 0 else (-1, -2)
            if kind != "periodic":
                datum = scattered(3 + 10 * level + 0.1 * axis + 0.5 * side, *cells[:, first])
                beyond[first] = self.ghost(kind, axis, level, phi[first], phi[second], datum)
        e = np.moveaxis(low - high, 0, axis) / (2 * self.spacing(level)[axis] * self.stretch[axis])
        parts = [e[slices_of(patch)].ravel(order="F") for patch in self.phi.patches if patch.level == level]
        return np.concatenate([np.empty(0), *parts])

    def operator(self, level: int, name: str, columns: int, axis: int = 0) -> sparse.csr_array:
        """This rank's rows, all columns."""
        native = partial(_native.operators_of, self.solver.native)
        start, column, value = native(level).rows_of(name, native(columns), axis)
        return sparse.csr_array((value, column, start), shape=(len(start) - 1, self.hierarchy.cells(columns)))

    def whole(self, field: amrpic.Field, level: int) -> np.ndarray:
        """All cells of a level in their order."""
        return np.concatenate(self.hierarchy.comm.allgather(np.array(field.native.level(level))))

    def uncovered(self, level: int) -> np.ndarray:
        return _native.operators_of(self.solver.native, level).uncovered().astype(bool)

    def residual(self, level: int) -> np.ndarray:
        out = self.right_hand_side(level)
        for name, other in (("composite", level), ("coarse_boundary", level - 1), ("fine_boundary", level + 1)):
            if 0 <= other < self.hierarchy.levels:
                out -= self.operator(level, name, other) @ self.whole(self.phi, other)
        return np.where(self.uncovered(level), out, 0.0)

    def electric_field(self, covered: _native.CoveredField) -> _native.ElectricField:
        return self.laplacian.electric_field(self.phi.native, self.walls, covered)

    def components(self, field: _native.ElectricField) -> tuple[amrpic.Field, ...]:
        return amrpic.VectorField.deferred(field, self.hierarchy, "V/m").components

    def norm(self, values: Levels, norm: str) -> float:
        """Over uncovered cells of all levels and ranks."""
        parts = [
            (np.prod(self.hierarchy.spacing(level)), np.abs(v[self.uncovered(level)])) for level, v in enumerate(values)
        ]
        comm = self.hierarchy.comm
        if norm == "max":
            return comm.allreduce(max(v.max(initial=0.0) for _, v in parts), MPI.MAX)
        power = {"l1": 1, "l2": 2}[norm]
        return comm.allreduce(sum(volume * np.sum(v**power) for volume, v in parts)) ** (1 / power)

    def largest_term(self, level: int) -> float:
        finest = self.spacing(min(level + 1, self.hierarchy.levels - 1))
        size = max(np.abs(self.phi.native.level(lv)).max(initial=0.0) for lv in range(self.hierarchy.levels))
        return self.hierarchy.comm.allreduce(size, MPI.MAX) * np.sum(8 / finest**2)

    def dense(self, values: Levels, coarsest: int = 0) -> list[np.ndarray]:
        """Each level, from `coarsest` on, as an array over the domain, -inf where it has no cells, on all ranks."""
        out = []
        for level, own in enumerate(values, coarsest):
            whole, first = np.full(self.shape(level), -np.inf), 0
            for patch in self.rho.patches:
                if patch.level == level:
                    part = own[first : first + patch.data.size]
                    whole[slices_of(patch)] = part.reshape(patch.data.shape, order="F")
                    first += patch.data.size
            self.hierarchy.comm.Allreduce(MPI.IN_PLACE, whole, MPI.MAX)
            out.append(whole)
        return out


def scattered(seed: Any, *cell: np.ndarray) -> np.ndarray:
    """Numbers between -1 and 1 without a pattern, of cells by their indices."""
    return np.sin(1e4 * np.sin(seed + 12.9898 * cell[0] + 78.233 * cell[1] + 37.719 * cell[2]))


def slices_of(patch: Any) -> tuple[slice, ...]:
    return tuple(slice(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True))


def norm_of(name: str) -> Any:
    return getattr(_native.Norm, name)


NAMES = [
    *CASES,
    *(f"{mesh}, mixed" for mesh in MESHES),
    *(f"patch at an edge, {walls}" for walls in WALLS if walls != "mixed"),
]


def hierarchy_named(name: str, comm: Any, largest: int | None = None) -> amrpic.Hierarchy:
    """The hierarchy of that name in small boxes, or in boxes of at most `largest` cells along each axis."""
    if name in CASES:
        case = CASES[name]
        return hierarchy_of(replace(case, max_grid_size=largest or case.max_grid_size), comm)
    mesh, walls = name.rsplit(", ", 1)
    return MESHES[mesh].hierarchy(comm, 8, WALLS[walls], max_grid_size=largest or 6)


@lru_cache(maxsize=1)
def _problem(name: str, comm: int) -> Problem:
    return Problem(hierarchy_named(name, MPI.Comm.f2py(comm)))


def problem(name: str, comm: Any) -> Problem:
    """The problem of that name, as the latest test has left it; tests do not change it."""
    return _problem(name, comm.py2f())


LARGEST = "six levels off centre, mixed"  # half a minute for its matrices
each_case = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name == LARGEST else name for name in NAMES], scope="module"
)
on_ranks = pytest.mark.mpi(ranks=(1, 2, 3))


@each_case
def test_residual_is_that_of_the_operators(comm, name):
    p = problem(name, comm)
    arguments = p.rho.native, p.mean, p.walls, p.phi.native
    expected = [p.residual(level) for level in range(p.hierarchy.levels)]
    for norm in NORMS:
        size, found, clean = p.laplacian.residual(*arguments, norm_of(norm), p.ones)
        assert clean
        assert size == pytest.approx(p.norm(expected, norm), rel=1e-10)
    for level, values in enumerate(found):
        assert values == pytest.approx(expected[level], rel=0, abs=ROUNDING * p.largest_term(level))
    scale = [0.5**level for level in range(p.hierarchy.levels)]
    size, single, clean = p.laplacian.single_residual(*arguments, norm_of("max"), scale)
    assert clean and size == pytest.approx(p.norm(found, "max"), rel=1e-15)
    for level, values in enumerate(single):
        assert np.array_equal(values, (scale[level] * found[level]).astype(np.float32))
        assert np.all(values[~p.uncovered(level)] == 0)


@each_case
def test_field_is_that_of_the_operators(comm, name):
    p = problem(name, comm)
    for covered in ("mean", "difference"):
        components = p.components(p.electric_field(getattr(_native.CoveredField, covered)))
        for axis, found in enumerate(components):
            expected = p.field_of_operators(axis, covered)
            for level in range(p.hierarchy.levels):
                size = ROUNDING * p.largest_term(level) * p.spacing(level).max()
                assert found.native.level(level) == pytest.approx(expected.native.level(level), rel=0, abs=size)


@each_case
def test_what_follows_from_a_deferred_field_follows_from_its_components(comm, name):
    """What particles feel to the last bit, and the energy."""
    p = problem(name, comm)
    particles, lost = migrate(scattered_particles(p.hierarchy, 300), p.hierarchy)
    assert len(lost) == 0
    for matched, shape in itertools.product((False, True), SHAPES):
        clouds = Clouds(shape, matched)
        native = p.electric_field(getattr(_native.CoveredField, clouds.covered))
        deferred = amrpic.VectorField.deferred(native, p.hierarchy, "V/m")
        felt = gather(deferred, particles, clouds)
        given = amrpic.VectorField(*p.components(native))
        assert np.array_equal(felt, gather(given, particles, clouds)), clouds
        by_component = sum(component.integral(component) for component in given.components)
        assert deferred.integral_of_square() == pytest.approx(by_component, rel=1e-12, abs=0)
        assert given.integral_of_square() == pytest.approx(by_component, rel=1e-12, abs=0)


@each_case
def test_norms_and_integrals_of_the_right_hand_side(comm, name):
    p = problem(name, comm)
    source = p.rho.native, p.mean, p.walls
    f = [p.right_hand_side(level) for level in range(p.hierarchy.levels)]
    terms = []
    for level in range(p.hierarchy.levels):
        native = _native.operators_of(p.solver.native, level)
        start, _, value = native.rows_of("no_fine", native, 0)
        terms.append(value[start[:-1]] * p.phi.native.level(level))
    for norm in NORMS:
        assert p.laplacian.right_hand_side_norm(*source, norm_of(norm)) == pytest.approx(p.norm(f, norm), rel=1e-10)
        assert p.laplacian.diagonal_norm(p.phi.native, norm_of(norm)) == pytest.approx(p.norm(terms, norm), rel=1e-10)
    net, magnitude = p.laplacian.integrate_right_hand_side(*source)
    parts = [np.prod(p.spacing(level)) * v[p.uncovered(level)].sum() for level, v in enumerate(f)]
    sizes = [p.right_hand_side(level, np.abs) for level in range(p.hierarchy.levels)]
    assert magnitude == pytest.approx(p.norm(sizes, "l1") * np.prod(p.stretch), rel=1e-10)
    assert net == pytest.approx(comm.allreduce(sum(parts)), abs=1e-12 * magnitude)


@each_case
def test_corrections_are_added_and_averaged_down(comm, name):
    p = problem(name, comm)
    rng = np.random.default_rng(comm.rank)
    correction = [rng.standard_normal(p.phi.native.level(level).size) for level in range(p.hierarchy.levels)]
    expected, found = p.phi.copy(), p.phi.copy()
    for level, values in enumerate(correction):
        expected.native.level(level)[...] += 0.7 * values.astype(np.float32).astype(float)
    expected.native.average_down()
    p.laplacian.add(correction, 0.7, found.native)
    for level in range(p.hierarchy.levels):
        assert found.native.level(level) == pytest.approx(expected.native.level(level), rel=0, abs=1e-15)
    other = found.copy()
    found.native.average_down()
    p.laplacian.average_down(other.native)
    for level in range(p.hierarchy.levels):
        assert np.array_equal(found.native.level(level), other.native.level(level))


@pytest.mark.parametrize("name", [name for name in NAMES if name != LARGEST], scope="module")
def test_truncation_error_is_what_coarser_laplacians_see(comm, name):
    check_truncation(problem(name, comm), (2, 2, 2))


@pytest.mark.parametrize("base_ratio", [(1, 2, 1), (2, 1, 2), (1, 1, 1)], ids=str)
def test_truncation_error_of_a_base_that_is_coarsened_along_some_axes(comm, base_ratio):
    check_truncation(problem("narrow periodic axis", comm), base_ratio)


def check_truncation(p: Problem, base_ratio: tuple[int, int, int]) -> None:
    found, clean = p.laplacian.truncation(p.rho.native, p.mean, p.walls, p.phi.native, base_ratio, p.ones)
    assert clean
    levels = range(p.hierarchy.levels)
    phi, rho = (
        [np.where(np.isinf(x), np.nan, x) for x in p.dense([f.native.level(level) for level in levels])]
        for f in (p.phi, p.rho)
    )
    for level, values in enumerate(p.dense([v.astype(float) for v in found])):
        expected = truncation_by_definition(p, phi, rho, level, (2, 2, 2) if level else base_ratio)
        present = np.isfinite(phi[level])
        size = np.abs(expected).max()
        assert values[present] == pytest.approx(expected[present], rel=0, abs=1e-6 * size)
        assert np.all(np.isinf(values[~present]))


def truncation_by_definition(
    p: Problem, phi: list[np.ndarray], rho: list[np.ndarray], level: int, ratio: tuple[int, ...]
) -> np.ndarray:
    """On dense arrays that hold nan where a level has no cells. Along an axis with an odd number of them, the last one is
    left out, and there the mesh ends as at walls."""
    if ratio == (1, 1, 1):
        return np.zeros_like(phi[level])
    left = [(0, n % r) for n, r in zip(phi[level].shape, ratio, strict=True)]
    periodic = [wraps and alone == 0 for wraps, (_, alone) in zip(p.hierarchy.domain.periodic, left, strict=True)]
    nx, ny, nz = (n - alone for n, (_, alone) in zip(phi[level].shape, left, strict=True))
    paired = [values[:nx, :ny, :nz] for values in (phi[level], rho[level])]
    f = -paired[1] / epsilon_0 - p.mean
    covered = np.zeros(f.shape, dtype=bool)
    if level + 1 < p.hierarchy.levels:
        covered = np.isfinite(phi[level + 1][::2, ::2, ::2])[:nx, :ny, :nz]
    coarse_f = mean_of_blocks(np.where(covered, np.nan, f), ratio)
    coarse_phi = phi[level - 1] if level else mean_of_blocks(paired[0], ratio)
    seen = -coarse_f
    for d in range(3):
        second = np.roll(coarse_phi, 1, d) + np.roll(coarse_phi, -1, d) - 2 * coarse_phi
        if not periodic[d]:
            for end in (0, -1):
                second[(slice(None),) * d + (end,)] = np.nan
        seen = seen + second / (ratio[d] * p.spacing(level)[d]) ** 2
    out = np.nan_to_num(seen, nan=0.0) / 3
    for d in (d for d in range(3) if ratio[d] == 2):
        low, high = np.roll(out, 1, d), np.roll(out, -1, d)
        if not periodic[d]:
            low[(slice(None),) * d + (0,)] = high[(slice(None),) * d + (-1,)] = 0
        out = np.stack([0.75 * out + 0.25 * low, 0.75 * out + 0.25 * high], axis=d + 1)
        out = out.reshape([2 * n if a == d else n for a, n in enumerate(low.shape)])
    return np.pad(np.where(covered, 0.0, out), left)


def mean_of_blocks(values: np.ndarray, ratio: tuple[int, ...]) -> np.ndarray:
    shape = [m for n, r in zip(values.shape, ratio, strict=True) for m in (n // r, r)]
    return np.asarray(values.reshape(shape).mean(axis=(1, 3, 5)))


@on_ranks
@pytest.mark.parametrize("name", [*CASES, "nested cubes, mixed", "patch at a corner, open"])
def test_results_do_not_depend_on_boxes_and_ranks(comm, name):
    """Not even by rounding; sums over cells aside."""
    norms, fields = results_of(problem(name, comm))
    if comm.rank == 0:
        other_norms, other_fields = results_of(Problem(hierarchy_named(name, MPI.COMM_SELF, largest=64)))
        assert norms[0] == other_norms[0]
        assert norms == pytest.approx(other_norms, rel=1e-12, abs=1e-12 * max(other_norms))
        for name, levels in fields.items():
            for one, other in zip(levels, other_fields[name], strict=True):
                assert np.array_equal(one, other), name
    wait_quietly(comm)


def results_of(p: Problem) -> tuple[list[float], dict[str, list[np.ndarray]]]:
    """Norms, the largest residual first, and fields that all depend on the values of `p`."""
    source, levels = (p.rho.native, p.mean, p.walls), range(p.hierarchy.levels)
    fields: dict[str, Levels] = {}
    norms = []
    for norm in NORMS:
        size, fields["residual"], _ = p.laplacian.residual(*source, p.phi.native, norm_of(norm), p.ones)
        norms += [size, p.laplacian.right_hand_side_norm(*source, norm_of(norm))]
        norms += [p.laplacian.diagonal_norm(p.phi.native, norm_of(norm))]
    norms += p.laplacian.integrate_right_hand_side(*source)
    for kind in ("mean", "difference"):
        e = p.electric_field(getattr(_native.CoveredField, kind))
        for axis, component in zip("xyz", p.components(e), strict=True):
            fields[f"E_{axis}, {kind}"] = [component.native.level(level) for level in levels]
    fields["truncation"], _ = p.laplacian.truncation(*source, p.phi.native, (2, 2, 2), p.ones)
    improved = p.phi.copy()
    p.laplacian.add(fields["residual"], 0.7, improved.native)
    fields["improved"] = [improved.native.level(level) for level in levels]
    averaged = p.rho.copy()
    p.laplacian.average_down(averaged.native)
    fields["averaged"] = [averaged.native.level(level) for level in levels]
    return norms, {name: p.dense([v.astype(float) for v in values]) for name, values in fields.items()}


@on_ranks
def test_lengths_may_be_stretched(comm):
    p = Problem(hierarchy_named("L at the walls, anisotropic", comm), stretch=(1, 0.7, 3))
    size, found, _ = p.laplacian.residual(p.rho.native, p.mean, p.walls, p.phi.native, norm_of("l2"), p.ones)
    expected = [p.residual(level) for level in range(p.hierarchy.levels)]
    assert size == pytest.approx(p.norm(expected, "l2"), rel=1e-10)
    for level, values in enumerate(found):
        assert values == pytest.approx(expected[level], rel=0, abs=ROUNDING * p.largest_term(level))
    for axis, e in enumerate(p.components(p.electric_field(_native.CoveredField.mean))):
        by_operators = p.field_of_operators(axis, "mean")
        for level in range(p.hierarchy.levels):
            size = ROUNDING * p.largest_term(level)
            assert e.native.level(level) == pytest.approx(by_operators.native.level(level), rel=0, abs=size)


@on_ranks
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("norm", NORMS)
def test_a_value_that_is_not_finite_shows_in_the_norms(comm, bad, norm):
    p = Problem(hierarchy_named("nested cubes, mixed", comm))
    source = p.rho.native, p.mean, p.walls

    def norms() -> list[float]:
        residual, *_ = p.laplacian.residual(*source, p.phi.native, norm_of(norm), p.ones)
        return [residual, p.laplacian.right_hand_side_norm(*source, norm_of(norm))]

    for level in range(p.hierarchy.levels - 1):
        p.rho.native.level(level)[~p.uncovered(level)] = bad  # not used
    assert np.all(np.isfinite(norms()))
    if comm.rank == comm.size - 1:
        p.rho.native.level(2)[-1] = bad
    assert np.all(np.isnan(norms()))


def test_lists_take_little_memory(comm):
    """Next to the operators they replace, and per cell where boxes are of the usual size."""
    p = Problem(MESHES["nested cubes"].hierarchy(comm, 32, "dirichlet", max_grid_size=32))
    cells = sum(p.hierarchy.cells(level) for level in range(p.hierarchy.levels))
    assert p.laplacian.bytes < 4 * cells
    assert p.laplacian.bytes < 0.02 * p.solver.native.backend_bytes
