"""Fields of fast charge before walls across its motion: those of the charge and of its images, which move against it.

The references are closed forms of charges in uniform motion, and Liénard's and Wiechert's, in `charges_in_motion`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import SolverError
from amrpic.mesh.mirror import Mirror, MirrorPlane
from amrpic.stages.poisson import PoissonSolver
from charges_in_motion import EPS0, Ball, C, between, force, mirrored, retarded, total

CATHODE = {"x": "open", "y": "open", "z": ("dirichlet", "open")}
MAGNETIC = {"x": "open", "y": "open", "z": ("neumann", "open")}
Fields = tuple[np.ndarray, np.ndarray]


def ball(gamma: float, at_rest: float = 0.3, sigma: float = 0.1) -> Ball:
    """A bunch that is round at rest, so far before a wall at z = 0 there."""
    return Ball(EPS0, at_rest / gamma, float(np.sqrt(1 - gamma**-2)), sigma)


def mesh(
    n: int, gamma: float, boundary: Any = CATHODE, comm: MPI.Comm = MPI.COMM_SELF, first: float = 0.0, levels: Any = ()
) -> amrpic.Hierarchy:
    """A cube of unit length at rest, round x = y = 0, from the place `first` along z at rest."""
    lower, upper = (-0.5, -0.5, first / gamma), (0.5, 0.5, (first + 1) / gamma)
    return amrpic.Hierarchy(comm, amrpic.Domain(lower, upper, (n,) * 3, boundary), levels, 16, 4)


def solved(
    hierarchy: amrpic.Hierarchy, bunch: Ball, mirror: Mirror | None = None, **options: Any
) -> tuple[list[amrpic.Field], list[amrpic.VectorField]]:
    """φ and E of a bunch, and of its images that move against it."""
    mirror = mirror if mirror is not None else Mirror.of_faces(hierarchy.domain, 2)
    rho = amrpic.Field(hierarchy).fill(bunch.density)
    solver = PoissonSolver(hierarchy, stretch=(1, 1, bunch.gamma), mirror=mirror, **{"tolerance": 1e-8, **options})
    potentials, fields = [], []
    for image in (False, True) if mirror.reflects else (False,):
        phi, report = solver.solve(rho, image=image)
        assert report.converged
        potentials.append(phi)
        fields.append(solver.electric_field(phi))
    return potentials, fields


def found(fields: list[amrpic.VectorField], beta: float, level: int = 0) -> Fields:
    """E = E₊ + E₋ and B = β × (E₊ - E₋) / c in this rank's cells of a level."""
    parts = [np.stack([part.array(level) for part in field.components], axis=1) for field in fields]
    return np.sum(parts, axis=0), np.cross((0, 0, beta), parts[0] - np.sum(parts[1:], axis=0)) / C


def centres(hierarchy: amrpic.Hierarchy, level: int = 0) -> np.ndarray:
    """Of this rank's cells of a level, (n, 3) m."""
    out = []
    for patch in amrpic.Field(hierarchy).patches:
        if patch.level == level:
            grid = np.broadcast_arrays(*patch.centres())
            out.append(np.stack([x.ravel(order="F") for x in grid], axis=1))
    return np.concatenate(out)


def errors(one: Fields, exact: Fields, beta: float, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Of E, B and the force across on charge of the bunch, over their largest values."""
    pairs = [*zip(one, exact, strict=True), (force(one, beta)[:, :2], force(exact, beta)[:, :2])]
    return np.array([np.abs(a - b)[cells].max() / np.abs(b)[cells].max() for a, b in pairs])


def test_charges_in_uniform_motion_have_the_fields_of_lienard_and_wiechert() -> None:
    """The two references, without a mesh: of a charge and its image, also one that moves away."""
    points = np.random.default_rng(1).uniform((-1, -1, 0), (1, 1, 2), (50, 3))
    for beta in (0.3, -0.9, 0.99):
        charge = Ball(EPS0, 0.4, beta)
        for one in (charge, *mirrored([charge], 0.0)):
            for closed, late in zip(one.fields(points), zip(*retarded(one, points), strict=True), strict=True):
                assert np.abs(closed - np.array(late)).max() < 1e-12 * np.abs(closed).max()


@pytest.mark.parametrize(
    ("gamma", "at_rest", "bounds"),
    [(5.0, 0.3, (1.0e-2, 1.0e-2)), (5.0, 0.5, (1.0e-2, 1.0e-2)), (100.0, 0.6, (1e-2, 1e-2))],
)
def test_field_before_a_cathode_is_that_of_bunch_and_image_to_second_order(
    gamma: float, at_rest: float, bounds: tuple[float, float]
) -> None:
    """A bunch of σ = 0.1 at rest, of which a wall at 3σ cuts off what is beyond."""
    bunch, out = ball(gamma, at_rest), []
    for n in (16, 32, 48):
        hierarchy = mesh(n, gamma)
        _, fields = solved(hierarchy, bunch)
        exact = total([bunch, *mirrored([bunch], 0.0)], centres(hierarchy))
        out.append(errors(found(fields, bunch.beta), exact, bunch.beta))
    order = np.log(np.array(out[0]) / out[2]) / np.log(3)
    assert (order[:2] > 1.8).all()
    assert (out[2][:2] < bounds[0]).all()


@pytest.mark.parametrize("beta", [0.3, 0.99])
def test_fields_outside_a_bunch_are_those_of_retarded_charges(beta: float) -> None:
    """Beyond 5σ a round bunch has the field of a point, by Liénard and Wiechert, and so has its image."""
    gamma = float(1 / np.sqrt(1 - beta**2))
    bunch = ball(gamma, 0.4, 0.06)
    hierarchy = mesh(48, gamma)
    _, fields = solved(hierarchy, bunch)
    places = centres(hierarchy)
    outside = np.linalg.norm((places - (0, 0, bunch.place)) * (1, 1, gamma), axis=1) > 0.3
    some = np.flatnonzero(outside)[::41]
    point = Ball(bunch.charge, bunch.place, beta)
    exact = [np.zeros((len(some), 3)), np.zeros((len(some), 3))]
    for one in (point, *mirrored([point], 0.0)):
        for sums, late in zip(exact, zip(*retarded(one, places[some]), strict=True), strict=True):
            sums += np.array(late)
    e, b = found(fields, beta)
    assert (errors((e[some], b[some]), (exact[0], exact[1]), beta)[:2] < 8e-3).all()


def test_the_wall_has_no_potential() -> None:
    """φ₊ + φ₋, which is odd about it on the lattice, in its first cells and the ghosts behind."""
    n, bunch = 32, ball(5.0)
    hierarchy = mesh(n, 5.0)
    rho = amrpic.Field(hierarchy).fill(bunch.density)
    solver = PoissonSolver(hierarchy, tolerance=1e-9, stretch=(1, 1, 5.0), mirror=Mirror.of_faces(hierarchy.domain, 2))
    _, axes, places = solver.native.wall_faces(0)
    faces = (axes == 2) & (places[:, 2] < 1e-9)
    at = np.floor((places[faces, :2] + 0.5) * n).astype(int)
    both, largest = np.zeros((n, n)), 0.0
    for image in (False, True):
        phi = solver.solve(rho, image=image)[0]
        for patch in phi.patches:
            here = (at >= patch.lower[:2]).all(axis=1) & (at <= patch.upper[:2]).all(axis=1) & (patch.lower[2] == 0)
            i, j = at[here].T
            both[i, j] += (
                patch.data[i - patch.lower[0], j - patch.lower[1], 0] + solver.native.wall_data(0)[faces][here]
            )
        largest = max(largest, phi.max_abs())
    assert len(at) == n * n and np.abs(both).max() / 2 < 1e-4 * largest


def test_a_magnetic_wall_has_images_of_the_same_sign() -> None:
    bunch = ball(5.0, 0.5)
    hierarchy = mesh(48, 5.0, MAGNETIC)
    _, fields = solved(hierarchy, bunch)
    exact = total([bunch, *mirrored([bunch], 0.0, 1)], centres(hierarchy))
    assert (errors(found(fields, bunch.beta), exact, bunch.beta)[:2] < 1.2e-2).all()


def test_between_two_plates_all_images_act() -> None:
    """The sum over 400 reflections; of a long sum of charges of one sign what is left goes as 1/n²."""
    gamma = 5.0
    bunch = ball(gamma, 0.4)
    hierarchy = mesh(32, gamma, {"x": "open", "y": "open", "z": "dirichlet"})
    _, fields = solved(hierarchy, bunch)
    exact = total(between([bunch], 1 / gamma, 200), centres(hierarchy))
    assert (errors(found(fields, bunch.beta), exact, bunch.beta)[:2] < 2e-2).all()


@pytest.mark.parametrize("moved", [0.25, 1.5])
def test_a_plane_outside_the_mesh_mirrors_as_one_at_its_face(moved: float) -> None:
    """The part of a longer mesh: images do not change, and the force is that of bunch and image."""
    gamma, n = 5.0, 32
    bunch = ball(gamma, 0.5 + moved)
    hierarchy = mesh(n, gamma, first=moved)
    mirror = Mirror.of_faces(hierarchy.domain, 2, moved / gamma)
    assert mirror.lower is not None and abs(mirror.lower.place) < 1e-15
    _, fields = solved(hierarchy, bunch, mirror)
    images = mirrored([bunch], 0.0)
    exact = total([bunch, *images], centres(hierarchy))
    assert (errors(found(fields, bunch.beta), exact, bunch.beta) < 3e-2).all()
    e = np.stack([part.array(0) for part in fields[1].components], axis=1)
    of_images = total(images, centres(hierarchy))[0]
    assert np.abs(e - of_images).max() < 3e-3 * np.abs(of_images).max()


@pytest.mark.mpi(ranks=(1, 3))
def test_refined_levels_see_the_images_too(comm: MPI.Comm) -> None:
    """A patch at the wall: errors on it are those of a mesh twice as fine."""
    gamma = 5.0
    bunch = ball(gamma, 0.3)
    hierarchy = mesh(24, gamma, comm=comm, levels=[[((8, 8, 0), (39, 39, 31))]])
    _, fields = solved(hierarchy, bunch)
    for level in range(2):
        exact = total([bunch, *mirrored([bunch], 0.0)], centres(hierarchy, level))
        here = found(fields, bunch.beta, level)
        worst = [np.abs(a - b).max(initial=0) for a, b in zip(here, exact, strict=True)]
        largest = [np.abs(b).max(initial=0) for b in exact]
        shares = [comm.allreduce(w, MPI.MAX) / comm.allreduce(l, MPI.MAX) for w, l in zip(worst, largest, strict=True)]
        assert max(shares) < 2.5e-2


@pytest.mark.parametrize("at_rest", [5.0, 500.0])
def test_force_is_that_of_an_open_box_and_of_the_image(at_rest: float) -> None:
    """The image has 0.5 of the force at 50 σ there, and 1e-6 in the laboratory: of E and v × B, which cancel to 1/γ², no more
    is lost by two solves than by one."""
    gamma = 100.0
    bunch, first = ball(gamma, at_rest), at_rest - 0.5
    hierarchy = mesh(32, gamma, first=first)
    _, fields = solved(hierarchy, bunch, Mirror.of_faces(hierarchy.domain, 2, first / gamma), tolerance=1e-6)
    opened = mesh(32, gamma, "open", first=first)
    alone = PoissonSolver(opened, stretch=(1, 1, gamma), tolerance=1e-6)
    phi = alone.solve(amrpic.Field(opened).fill(bunch.density))[0]
    both, own = (force(found(of, bunch.beta), bunch.beta) for of in (fields, [alone.electric_field(phi)]))
    of_image = force(total(mirrored([bunch], 0.0), centres(hierarchy)), bunch.beta)
    shares = [np.abs(of_image)[:, axes].max() / np.abs(own)[:, axes].max() for axes in (slice(0, 2), slice(2, 3))]
    assert shares[0] > 0.3 if at_rest == 5 else shares[0] < 1e-5
    for axes in (slice(0, 2), slice(2, 3)):
        assert np.abs(both - own - of_image)[:, axes].max() < 2e-3 * np.abs(own)[:, axes].max()


CLOSED = [
    ("dirichlet", "dirichlet", "dirichlet"),
    ("dirichlet", "neumann", "dirichlet"),
    ("periodic", ("neumann", "dirichlet"), "neumann"),
    ("dirichlet", "periodic", ("dirichlet", "neumann")),
    (("dirichlet", "neumann"), ("dirichlet", "neumann"), "dirichlet"),
]


@pytest.mark.parametrize("cells", [(32, 32, 32), (48, 80, 16), (16, 16, 64)])
@pytest.mark.parametrize("faces", CLOSED)
def test_between_closed_sides_sum_and_difference_are_those_of_walls_at_rest(
    faces: tuple[Any, Any, Any], cells: tuple[int, int, int]
) -> None:
    """φ₊ + φ₋ is a plain solve between these walls, φ₊ - φ₋ between walls of the other kind; also if they are near or far."""
    other = {"dirichlet": "neumann", "neumann": "dirichlet"}
    across = faces[2] if isinstance(faces[2], tuple) else (faces[2], faces[2])
    boundary = [{"x": faces[0], "y": faces[1], "z": z} for z in (across, tuple(other[face] for face in across))]
    upper = tuple(n / 32 for n in cells)
    with_walls, with_others = (
        amrpic.Hierarchy(MPI.COMM_SELF, amrpic.Domain((0, 0, 0), upper, cells, of), (), 16, 4) for of in boundary
    )
    middle, width = np.array(upper) * (0.6, 0.45, 0.55), 0.12 * min(upper) + 1 / 32

    def density(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        r = ((x - middle[0]) ** 2 + (y - middle[1]) ** 2 + (z - middle[2]) ** 2) / width**2
        return EPS0 * np.exp(-4 * r)

    solver = PoissonSolver(with_walls, tolerance=1e-9, mirror=Mirror.of_faces(with_walls.domain, 2))
    rho = amrpic.Field(with_walls).fill(density)
    plus, minus = (solver.solve(rho, image=image)[0].array(0) for image in (False, True))
    for mesh_of_walls, found_there in ((with_walls, plus + minus), (with_others, plus - minus)):
        plain = PoissonSolver(mesh_of_walls, tolerance=1e-9)
        expected = plain.solve(amrpic.Field(mesh_of_walls).fill(density))[0].array(0)
        assert np.abs(found_there - expected).max() < (6e-4 if cells[2] == 16 else 1e-4) * np.abs(expected).max()


def test_without_planes_the_faces_are_open() -> None:
    """What is left when images are given up."""
    bunch = ball(5.0, 0.5)
    (closed,), _ = solved(mesh(16, 5.0), bunch, Mirror(2))
    opened = PoissonSolver(mesh(16, 5.0, "open"), stretch=(1, 1, bunch.gamma), tolerance=1e-8)
    expected, _ = opened.solve(amrpic.Field(opened.hierarchy).fill(bunch.density))
    assert np.abs(closed.array(0) - expected.array(0)).max() < 1e-7 * expected.max_abs()


@pytest.mark.parametrize("options", [{"backend": "crs"}, {"backend": "kokkos"}, {"order": 4}])
def test_images_are_the_same_on_all_backends_and_nearly_in_fourth_order(options: dict[str, Any]) -> None:
    """Of a plane half a cell outside the mesh, on two levels."""
    bunch, moved = ball(5.0, 0.5), 1 / 32
    hierarchy = mesh(16, 5.0, first=moved, levels=[[((8, 8, 0), (23, 23, 15))]])
    mirror = Mirror.of_faces(hierarchy.domain, 2, moved / 5)
    plain, other = (solved(hierarchy, bunch, mirror, **{"tolerance": 1e-10, **more})[0] for more in ({}, options))
    for one, two in zip(plain, other, strict=True):
        for level in range(2):
            off = np.abs(one.array(level) - two.as_points().array(level)).max()
            assert off < (1e-7 if "backend" in options else 0.02) * one.max_abs()


def test_mirrors_that_cannot_be_are_refused() -> None:
    hierarchy = mesh(16, 1.0)
    rho = amrpic.Field(hierarchy).fill(ball(1.0 + 1e-9).density)
    refused = [
        (
            Mirror(2, MirrorPlane(0.25, "dirichlet")),
            r"mirror.lower lies inside the mesh, at z = 0.25 m; put it at the face, 0 m",
        ),
        (Mirror(2, MirrorPlane(-0.01, "dirichlet")), r"mirror.lower lies 0.16 base cells outside the face"),
        (Mirror(2, upper=MirrorPlane(1.01, "neumann")), r"mirror.upper lies 0.16 base cells outside the face"),
        (Mirror(2, MirrorPlane(0.0, "open")), r"mirror.lower is of kind 'open'; use one of dirichlet, neumann"),
        (Mirror(3), r"mirror.axis is 3; give that of faces that are not periodic"),
    ]
    for mirror, said in refused:
        with pytest.raises(SolverError, match=said):
            PoissonSolver(hierarchy, mirror=mirror)
    for solver in (PoissonSolver(hierarchy), PoissonSolver(hierarchy, mirror=Mirror(2))):
        with pytest.raises(SolverError, match="images of ρ are asked for, but no plane mirrors it"):
            solver.solve(rho, image=True)
    mirrors = PoissonSolver(hierarchy, mirror=Mirror.of_faces(hierarchy.domain, 2))
    with pytest.raises(SolverError, match="walls are given values, which are at rest, in a solver with a mirror"):
        mirrors.solve(rho, boundary_values=lambda x, y, z: 1.0)
    sides = mesh(16, 1.0, {"x": "neumann", "y": "periodic", "z": "dirichlet"})
    with pytest.raises(SolverError, match="a mirror has two planes and all sides are neumann or periodic"):
        PoissonSolver(sides, mirror=Mirror.of_faces(sides.domain, 2))
    closed = mesh(16, 1.0, "dirichlet")
    with pytest.raises(SolverError, match="screening is 2 with a mirror"):
        PoissonSolver(closed, screening=2.0, mirror=Mirror.of_faces(closed.domain, 2))
