"""Newton's method: buckling, cuts, an independent finite element code, and trouble; its order and closed forms are in
`verify/materials.py`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skfem
from mpi4py import MPI
from scipy.sparse.linalg import spsolve
from skfem.helpers import ddot, det, grad, identity, inv, mul, trace, transpose

from amrpic import fem, mpm
from amrpic.errors import InputError, ParticleError
from exact.press import between_walls, confined, exact_stress, upper_face

EXAMPLES = Path(__file__).parents[2] / "examples"
YOUNG = 300e6
PLAIN = mpm.NeoHookean(YOUNG, 0.25)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_slender_column_buckles(comm):
    """Straight, it has more than three times the energy, and a tangent that is not positive."""
    mesh = fem.Mesh(comm, 0, (1, 1, 10), (2, 2, 10), degree=2)
    solid = mpm.Solid(fem.gauss(mesh), PLAIN)
    ends = (mesh.node_indices[:, 2] == 0) | upper_face(mesh)
    straight = np.zeros((len(mesh.nodes), 3))
    straight[:, 2] = -0.15 * mesh.nodes[:, 2]
    u, report = mpm.equilibrium(solid, fixed=ends, values=straight, start=straight)
    assert report.converged and report.energy < 0.4 * solid.respond(straight).energy, report


@pytest.mark.mpi(ranks=(1, 2))
def test_ranks_press_alike(comm):
    assert exact_stress(PLAIN) == pytest.approx((-230.165e6, -102.165e6), abs=500)
    found = confined(comm, PLAIN, 1, lambda mesh: fem.jittered(mesh, 4), 5)
    assert found.axial == pytest.approx((exact_stress(PLAIN)[0],) * 2, rel=1e-8)
    assert found.iterations <= 3


def bent(degree=1, cells=3):
    """A block of which one face is held and the opposite one turned about x by a large angle."""
    mesh = fem.Mesh(MPI.COMM_SELF, 0, (1, 1, 2), (cells, cells, 2 * cells), degree=degree)
    top = upper_face(mesh)
    fixed = (mesh.node_indices[:, 2] == 0) | top
    values = np.zeros((len(mesh.nodes), 3))
    angle, y = 0.5, mesh.nodes[top, 1] - 0.5
    values[top, 1], values[top, 2] = y * (np.cos(angle) - 1), y * np.sin(angle)
    return mpm.Solid(fem.gauss(mesh), PLAIN), fixed, values


@pytest.mark.parametrize("form", ["initial", "current"])
def test_preconditioners_and_forms_lead_to_the_same_place(form):
    solid, fixed, values = bent()
    plain, _ = mpm.equilibrium(solid, fixed=fixed, values=values, tolerance=1e-11)
    every: list[dict[str, Any]] = [{"preconditioner": "jacobi"}, {"coarse": "aggregation"}]
    for options in every:
        other, report = mpm.equilibrium(solid, fixed=fixed, values=values, tolerance=1e-11, form=form, **options)
        assert report.converged
        assert np.abs(other - plain).max() < 1e-9


def test_steps_that_turn_points_inside_out_are_cut():
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 4, degree=1)
    solid = mpm.Solid(fem.gauss(mesh), PLAIN)
    load = np.where((mesh.node_indices == 2).all(axis=1)[:, None], [1e8, 0, 0], 0)
    u, report = mpm.equilibrium(solid, fixed=mesh.boundary, load=load, tolerance=1e-12)
    assert report.converged and min(report.lengths) < 1 and report.lengths[-1] == 1, report
    assert 0 < solid.respond(u).smallest_j < 1
    start = 0.12 * np.sin(40 * mesh.nodes) * ~mesh.boundary[:, None]
    assert 0 < solid.respond(start).smallest_j < 1e-3
    u, report = mpm.equilibrium(solid, fixed=mesh.boundary, start=start, tolerance=1e-12)
    assert report.converged and np.abs(u).max() < 1e-10, report


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_a_first_step_is_cut_towards_an_even_motion(share):
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 4, degree=2)
    solid = mpm.Solid(fem.jittered(mesh, 5), PLAIN)
    even = -share * mesh.nodes * [0, 0, 1]
    start = 0.01 * np.sin(20 * mesh.nodes) * ~mesh.boundary[:, None]
    u, report = mpm.equilibrium(solid, fixed=mesh.boundary, values=even, even=even, start=start, tolerance=1e-11)
    assert report.converged and np.abs(u - even).max() < 1e-9, report
    assert report.iterations <= 8, report
    with pytest.raises(InputError, match="the even displacement"):
        mpm.equilibrium(solid, fixed=mesh.boundary, values=even, even=even[:5])


def test_walls_that_meet_have_no_equilibrium():
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 2, degree=1)
    solid = mpm.Solid(fem.gauss(mesh), PLAIN)
    values = -1.5 * mesh.nodes * [0, 0, 1]
    u, report = mpm.equilibrium(solid, fixed=between_walls(mesh), values=values, most_iterations=15)
    assert not report.converged and report.reason != "the tolerance was met"
    assert solid.respond(u).smallest_j > 0


# ---- beside scikit-fem ----


@dataclass(frozen=True)
class Sinker:
    """A heavy ball in a soft block of 1 m, which clamps its lower face."""

    soft: mpm.NeoHookean
    stiff: mpm.NeoHookean
    centre: tuple[float, float, float]
    radius: float  # m
    weight: float  # N/m³
    walls: bool  # whether the other faces let nothing through

    def inside(self, x):
        return ((x - np.array(self.centre)) ** 2).sum(axis=-1) <= self.radius**2

    def held(self, x, quarter=False):
        """Which components of the displacement are zero at places (n, 3), (n, 3); in a quarter also on what cuts it out."""
        faces = ((np.abs(x) < 1e-9) | (np.abs(x - 1) < 1e-9)) & self.walls
        cuts = (np.abs(x - 0.5) < 1e-9) & [True, True, False] & quarter
        return (np.abs(x[:, 2:]) < 1e-9) | faces | cuts

    def deep(self, points, u):
        """How far the ball has sunk in the mean, m."""
        ball = self.inside(points.position)
        return -float(np.average(points.values(u)[ball, 2], weights=points.volume[ball]))


BALL = Sinker(mpm.NeoHookean(5e3, 0.3), mpm.NeoHookean(1.9e5, 0.3), (0.5, 0.5, 0.5), 0.28, 1e4, walls=False)
IN_EXAMPLE = Sinker(BALL.soft, BALL.stiff, (0.5, 0.5, 0.6), 0.2, 9810.0, walls=True)  # examples/sinker.toml


@dataclass(frozen=True)
class Theirs:
    """What scikit-fem finds, component after component of a node."""

    places: np.ndarray
    displacement: np.ndarray
    unbalanced: np.ndarray
    stored: float
    deep: float  # how far the ball has sunk in the mean


def by_scikit_fem(case, degree, cells, order=None, quarter=False):
    """The same problem, by forms and quadrature of scikit-fem and its own Newton iteration."""
    element = skfem.ElementVector(skfem.ElementHex1() if degree == 1 else skfem.ElementHex2())
    along = np.linspace(0, 1, cells + 1)
    across = along[along < 0.5 + 1e-9] if quarter else along
    basis = skfem.Basis(skfem.MeshHex.init_tensor(across, across, along), element, intorder=order or 2 * degree + 1)

    def moduli(w):
        ball = case.inside(np.moveaxis(w.x, 0, -1))
        return (
            np.where(ball, case.stiff.mu, case.soft.mu),
            np.where(ball, case.stiff.lame, case.soft.lame),
            ball,
        )

    def piola(f, mu, lame):
        back = transpose(inv(f))
        return mu * (f - back) + lame * np.log(det(f)) * back

    @skfem.LinearForm
    def unbalanced(v, w):
        mu, lame, ball = moduli(w)
        f = grad(w["u"]) + identity(grad(w["u"]))
        return ddot(piola(f, mu, lame), grad(v)) + case.weight * ball * v[2]

    @skfem.BilinearForm
    def change(du, v, w):
        mu, lame, _ = moduli(w)
        f = grad(w["u"]) + identity(grad(w["u"]))
        back, h = inv(f), mul(grad(du), inv(f))
        turned = transpose(mul(back, h))
        return ddot(mu * grad(du) + (mu - lame * np.log(det(f))) * turned + lame * trace(h) * transpose(back), grad(v))

    @skfem.Functional
    def stored(w):
        mu, lame, _ = moduli(w)
        f = grad(w["u"]) + identity(grad(w["u"]))
        return mu / 2 * (ddot(f, f) - 3) - mu * np.log(det(f)) + lame / 2 * np.log(det(f)) ** 2

    @skfem.Functional
    def fallen(w):
        return -w["u"][2] * moduli(w)[2]

    @skfem.Functional
    def volume(w):
        return 1.0 * moduli(w)[2]

    u = np.zeros(basis.N)
    free = np.flatnonzero(~case.held(basis.doflocs.T, quarter)[np.arange(basis.N), np.arange(basis.N) % 3])
    for _ in range(20):
        r = unbalanced.assemble(basis, u=basis.interpolate(u))
        if np.linalg.norm(r[free]) < 1e-12 * np.linalg.norm(r):
            break
        a = change.assemble(basis, u=basis.interpolate(u)).tocsc()
        u[free] -= spsolve(a[free][:, free], r[free])
    found = basis.interpolate(u)
    sunk, size = (float(one.assemble(basis, u=found)) for one in (fallen, volume))
    return Theirs(basis.doflocs, u, r, float(stored.assemble(basis, u=found)), sunk / size)


def sunk(case, points):
    """The displacement of a ball's weight, what holds it, and the stored energy."""
    ball, mesh = case.inside(points.position), points.mesh
    load = points.integrate(np.where(ball[:, None], [0, 0, -case.weight], 0.0))
    solid = mpm.Solid(points, (case.soft, case.stiff), ball.astype(int))
    u, report = mpm.equilibrium(solid, fixed=case.held(mesh.nodes), load=load, tolerance=1e-12)
    assert report.converged, report
    return u, solid.respond(u).force - load, report.energy


def at_nodes_of(mesh, places, values):
    """What scikit-fem numbers by component after component of a node, as a vector of a mesh."""
    of = {
        (*np.round(place, 6), axis): n
        for n, (place, axis) in enumerate(zip(places.T, np.arange(len(values)) % 3, strict=True))
    }
    order = np.array([[of[(*np.round(place, 6), axis)] for axis in range(3)] for place in mesh.nodes])
    return values[order]


@pytest.mark.parametrize("degree, cells", [(1, 4), (2, 2)])
@pytest.mark.parametrize("case", [BALL, IN_EXAMPLE], ids=["free block", "between walls"])
def test_a_heavy_ball_sinks_as_scikit_fem_has_it(case, degree, cells):
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, cells, degree=degree)
    u, forces, energy = sunk(case, fem.gauss(mesh))
    theirs = by_scikit_fem(case, degree, cells)
    size, held = np.abs(theirs.displacement).max(), case.held(mesh.nodes)
    assert size > 0.01
    assert np.abs(u - at_nodes_of(mesh, theirs.places, theirs.displacement)).max() < 1e-8 * size
    assert energy == pytest.approx(theirs.stored, rel=1e-9)
    reactions = at_nodes_of(mesh, theirs.places, theirs.unbalanced)
    assert np.abs(forces - reactions)[held].max() < 1e-8 * np.abs(forces).max()


def test_jittered_points_sink_as_far_as_scikit_fem_has_it():
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 4, degree=2)
    theirs, points = by_scikit_fem(BALL, 2, 4, quarter=True), fem.jittered(mesh, 4)
    u, _, _ = sunk(BALL, points)
    assert theirs.deep > 0.01 and BALL.deep(points, u) == pytest.approx(theirs.deep, rel=0.05)


@pytest.mark.long
def test_the_example_sinks_as_scikit_fem_has_it():
    """Four steps with a new mesh for each, against one solve on a mesh of as many elements, which deforms; over the weight."""
    run = mpm.Simulation(MPI.COMM_SELF, mpm.Scene.from_toml(EXAMPLES / "sinker.toml"))
    first = run.state.placed.points
    *_, last = run
    after, row = last.placed.points, last.measured
    order = np.argsort(after.id)[np.searchsorted(np.sort(after.id), first.id)]
    ball = first.material == 1
    fell = np.average((first.position - after.position[order])[ball, 2], weights=first.initial_volume[ball])
    theirs = by_scikit_fem(IN_EXAMPLE, 2, 6, order=9, quarter=True)
    axis = np.arange(len(theirs.displacement)) % 3
    lower, upper = (4 * theirs.unbalanced[(axis == 2) & (theirs.places[2] == end)].sum() for end in (0, 1))
    weight, of_theirs = row["force_z_lower"] + row["force_z_upper"], lower + upper
    assert weight == pytest.approx(IN_EXAMPLE.weight * 4 / 3 * np.pi * 0.2**3, rel=0.03)
    assert fell / weight == pytest.approx(theirs.deep / of_theirs, rel=0.05) and fell > 0.01
    assert row["force_z_lower"] / weight == pytest.approx(lower / of_theirs, rel=0.05)
    assert row["stored"] / weight**2 == pytest.approx(4 * theirs.stored / of_theirs**2, rel=0.05)


# ---- trouble ----


@pytest.mark.mpi(ranks=(1, 2))
def test_conditions_that_do_not_fit_are_refused(comm):
    mesh = fem.Mesh(comm, 0, 1, 4, degree=1, max_grid_size=2)
    solid = mpm.Solid(fem.uniform(mesh, 2), PLAIN)
    with pytest.raises(InputError, match=r"fixed is of .* with shape .* on a rank; give a mask \(\d+, 3\) there"):
        mpm.equilibrium(solid, fixed=[0])
    with pytest.raises(InputError, match=r"values do not fit nodes; give a number or an array \(\d+, 3\)"):
        mpm.equilibrium(solid, fixed=mesh.boundary, values=[1.0, 2.0])
    with pytest.raises(InputError, match="the load has shape"):
        mpm.equilibrium(solid, fixed=mesh.boundary, load=np.zeros(2))


@pytest.mark.mpi(ranks=(1, 2))
def test_points_that_leave_the_next_mesh_are_named(comm):
    mesh = fem.Mesh(comm, 0, 1, 4, degree=1, max_grid_size=2)
    solid = mpm.Solid(fem.uniform(mesh, 2), PLAIN)
    with pytest.raises(ParticleError, match=r"point \d+ at .* m with det F = 1 lies outside the mesh"):
        mpm.carried(solid, np.zeros((len(mesh.nodes), 3)), fem.Mesh(comm, 0, (1, 1, 0.5), 4))
