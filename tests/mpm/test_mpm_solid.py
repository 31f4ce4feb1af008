"""Internal forces and tangents of solids at points, against differences of the energy and of the forces."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import fem, mpm
from amrpic.errors import InputError

YOUNG, POISSON = 300e6, 0.25
MU = YOUNG / (2 * (1 + POISSON))
DAMAGE = mpm.Damage(toughness=60.0, length=0.25)
PLAIN = mpm.NeoHookean(YOUNG, POISSON)
MATERIALS: dict[str, tuple[mpm.Material, ...]] = {
    "neo-hookean": (PLAIN,),
    "ogden": (mpm.Ogden(((0.6 * MU, 1.3), (0.5 * MU, 5.0), (-0.1 * MU, -2.0)), PLAIN.lame),),
    "damaged": (mpm.NeoHookean(YOUNG, POISSON, DAMAGE),),
    "all of them": (
        PLAIN,
        mpm.Ogden(((MU, 2.0),), PLAIN.lame),
        mpm.NeoHookean(10 * YOUNG, 0.1, DAMAGE),
    ),
}
LAYOUTS = {
    "gauss": fem.gauss,
    "jittered": lambda mesh: fem.jittered(mesh, 3, seed=2, weights="volume"),
}


def solid_of(materials, layout, degree=2, comm=MPI.COMM_SELF, boxes=8, bent=0.1):
    """Materials mixed point by point, that were deformed before."""
    mesh = fem.Mesh(comm, 0, (1, 1.2, 0.9), (2, 3, 2), degree=degree, max_grid_size=boxes)
    points = layout(mesh)
    wave = np.sin(7 * points.position[:, :, None] + [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    return mpm.Solid(
        points,
        materials,
        points.number % len(materials),
        deformation=np.eye(3) + bent * wave,
        damage=0.4 + 0.3 * np.sin(points.number),
    )


def displacement(mesh, seed=0, size=0.03):
    return size * np.stack([np.sin(3 * mesh.nodes @ [1, 2, 1.5 + d] + 5 * d + seed) for d in range(3)], axis=1)


def slope(f):
    """Derivative at 0, to fourth order."""
    h = 1e-3
    return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("materials", MATERIALS)
def test_forces_are_slopes_of_the_energy_and_tangents_of_forces(materials, degree, layout):
    solid = solid_of(MATERIALS[materials], LAYOUTS[layout], degree)
    u, v = displacement(solid.mesh), displacement(solid.mesh, seed=3)
    found = solid.respond(u)
    work = slope(lambda t: solid.respond(u + t * v).energy)
    assert (found.force * v).sum() == pytest.approx(work, abs=1e-7 * np.abs(found.force * v).sum())
    change = slope(lambda t: solid.respond(u + t * v).force)
    assert np.abs(solid.tangent(u) @ v - change).max() < 1e-7 * np.abs(change).max()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_the_initial_form_of_the_tangent_is_the_current_one(degree, layout):
    solid = solid_of((PLAIN,), LAYOUTS[layout], degree)
    u, v = displacement(solid.mesh), displacement(solid.mesh, seed=3)
    initial, current = (solid.tangent(u, form) for form in ("initial", "current"))
    assert np.abs(initial @ v - current @ v).max() < 1e-12 * np.abs(current @ v).max()
    assert np.abs(initial.diagonal() - current.diagonal()).max() < 1e-12 * current.diagonal().max()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("materials", MATERIALS)
def test_tangents_are_their_matrices(materials, layout):
    solid = solid_of(MATERIALS[materials], LAYOUTS[layout])
    tangent, v = solid.tangent(displacement(solid.mesh)), displacement(solid.mesh, seed=3)
    rows = tangent.to_scipy()
    assert rows is not None
    dense = rows.toarray()
    assert np.abs(dense - dense.T).max() < 1e-13 * np.abs(dense).max()
    assert np.abs(np.diag(dense) - tangent.diagonal().ravel()).max() < 1e-13 * np.abs(dense).max()
    assert np.abs(dense @ v.ravel() - (tangent @ v).ravel()).max() < 1e-13 * np.abs(dense).max() * np.abs(v).max() * 30


@pytest.mark.parametrize("per_axis", [1, 2, 3])  # odd and even numbers of blocks, whatever the width of vectors
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("materials", [*MATERIALS, "initial"])
def test_smoothers_have_the_tangent_in_single_precision_at_any_size(materials, degree, per_axis):
    solid = solid_of(
        MATERIALS.get(materials, (PLAIN,)), lambda mesh: fem.jittered(mesh, per_axis, weights="volume"), degree
    )
    tangent = solid.tangent(displacement(solid.mesh), "initial" if materials == "initial" else "current")
    u, other = displacement(solid.mesh, seed=1), displacement(solid.mesh, seed=2)
    exact, near = tangent @ u, tangent.native.apply_nearly(u.reshape(-1)).reshape(-1, 3)
    assert 0 < abs(near - exact).max() < 3e-6 * abs(exact).max()
    assert (other * near).sum() == pytest.approx(
        u.reshape(-1) @ tangent.native.apply_nearly(other.reshape(-1)), abs=1e-6 * abs(other * exact).sum()
    )
    for size in 2.0**-300, 2.0**300:
        np.testing.assert_allclose(
            tangent.native.apply_nearly(size * u.reshape(-1)), size * near.reshape(-1), rtol=1e-12
        )


@pytest.mark.parametrize("materials", MATERIALS)
def test_a_stiffened_tangent_has_no_direction_without_stiffness(materials):
    """Where the body is pressed flat, and the tangent itself has such directions; elsewhere it is the tangent."""
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 2, degree=1)
    points, laws = fem.jittered(mesh, 3, weights="volume"), MATERIALS[materials]
    which, rest = points.number % len(laws), 0 * mesh.nodes

    def least(stiffening, stretches):
        flat = np.tile(np.diag(stretches), (len(points), 1, 1))
        rows = mpm.Solid(points, laws, which, deformation=flat).tangent(rest, stiffening=stiffening).to_scipy()
        assert rows is not None
        values = np.linalg.eigvalsh(rows.toarray())
        return values[0] / values[-1]

    none, half, all_of_it = (least(part, [1, 1, 0.2]) for part in (0, 0.5, 1))
    assert none < -1e-3 and none < half < all_of_it
    assert all_of_it > -1e-13
    pulled = mpm.Solid(points, laws, which, deformation=np.tile(np.diag([1.2, 1.2, 1.2]), (len(points), 1, 1)))
    v = displacement(mesh)
    one, other = (pulled.tangent(rest, stiffening=part) @ v for part in (0, 1))
    assert np.abs(one - other).max() < 1e-13 * np.abs(one).max()


def test_one_term_of_ogden_is_neo_hookean_at_points():
    made = [solid_of((law,), LAYOUTS["jittered"]) for law in (PLAIN, mpm.Ogden(((MU, 2.0),), PLAIN.lame))]
    u, v = displacement(made[0].mesh), displacement(made[0].mesh, seed=3)
    plain, ogden = (solid.tangent(u) @ v for solid in made)
    assert np.abs(plain - ogden).max() < 1e-12 * np.abs(plain).max()
    assert made[0].respond(u).energy == pytest.approx(made[1].respond(u).energy, rel=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_gauss_points_are_the_same_points_wherever_a_kernel_works_on_them(degree):
    """By sums along axes, and by those at points anywhere."""
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 3, degree=degree)
    gauss = fem.gauss(mesh)
    anywhere = fem.given(mesh, gauss.position, gauss.volume, weights="volume")
    u, v = displacement(mesh), displacement(mesh, seed=3)
    for law in MATERIALS["all of them"]:
        one, other = (mpm.Solid(points, law) for points in (gauss, anywhere))
        a, b = (solid.tangent(u) @ v for solid in (one, other))
        assert np.abs(a - b).max() < 1e-12 * np.abs(a).max()


@pytest.mark.parametrize("materials", MATERIALS)
def test_internal_forces_have_no_sum_and_no_moment(materials):
    solid = solid_of(MATERIALS[materials], LAYOUTS["jittered"], bent=0.05)
    u = displacement(solid.mesh)
    force, at = solid.respond(u).force, solid.mesh.nodes + u
    size = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * size
    assert np.abs(np.cross(at, force).sum(axis=0)).max() < 1e-12 * size


def test_a_rotation_by_any_angle_makes_no_force():
    for angle in (0.3, 2.0, 3.1):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        solid = solid_of(MATERIALS["all of them"], LAYOUTS["jittered"], bent=0.0)
        found = solid.respond(solid.mesh.nodes @ (turn - np.eye(3)).T)
        assert np.abs(found.force).max() < 1e-12 * 10 * YOUNG
        assert found.smallest_j == pytest.approx(1, abs=1e-13)


def test_stress_turns_with_the_body():
    solid = solid_of(MATERIALS["all of them"], LAYOUTS["jittered"])
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    here = solid.states(np.zeros((len(solid.mesh.nodes), 3)))
    there = solid.states(solid.mesh.nodes @ (turn - np.eye(3)).T)
    assert np.abs(there.cauchy - turn @ here.cauchy @ turn.T).max() < 1e-12 * 10 * YOUNG
    assert there.energy == pytest.approx(here.energy, rel=1e-12)


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_forces_and_energy_are_the_same_on_all_ranks(comm):
    found = []
    for who, boxes in ((MPI.COMM_SELF, 8), (comm, 2)):
        solid = solid_of(MATERIALS["all of them"], LAYOUTS["jittered"], comm=who, boxes=boxes)
        u = displacement(solid.mesh)
        response = solid.respond(u)
        both = np.concatenate([response.force, solid.tangent(u) @ displacement(solid.mesh, seed=3)], axis=1)
        parts = solid.mesh.comm.allgather((solid.mesh.numbers, both))
        whole = np.empty((int(solid.mesh.node_counts.prod()), 6))
        for numbers, values in parts:
            whole[numbers] = values
        found.append((whole, response.energy, response.smallest_j))
    assert np.abs(found[0][0] - found[1][0]).max() < 1e-12 * np.abs(found[0][0]).max()
    assert found[0][1] == pytest.approx(found[1][1], rel=1e-12)
    assert found[0][2] == pytest.approx(found[1][2], rel=1e-12)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: mpm.NeoHookean(0, 0.2), "Young's modulus is 0; give a positive one in Pa"),
        (lambda: mpm.NeoHookean(1e9, 0.5), "Poisson's ratio is 0.5; give one between -1 and 1/2"),
        (lambda: mpm.Damage(60, -1), "length of damage is -1; give a positive one in m"),
        (lambda: mpm.Damage(0, 1), "toughness is 0; give a positive energy per area"),
        (lambda: mpm.Damage(60, 1, 1.0), "residual is 1.0; give a part of the stiffness between 0 and 1"),
        (lambda: mpm.Ogden((), 1.0), "Ogden's law has 0 terms; give 1 to 3"),
        (lambda: mpm.Ogden(((1e6, 0.0),), 1.0), "a term with α = 0; leave it out"),
        (lambda: mpm.Ogden(((-1e6, 2.0),), 1.0), "Σ μ α / 2, is -1000000.0 Pa; it must be positive"),
        (lambda: mpm.Ogden(((1e6, 2.0),), -1e6), "the bulk modulus is not positive"),
    ],
)
def test_materials_that_cannot_be_are_refused(call, message):
    with pytest.raises(InputError) as refused:
        call()
    assert message in str(refused.value)


@pytest.mark.mpi(ranks=(1, 2))
def test_solids_that_cannot_be_are_refused(comm):
    mesh = fem.Mesh(comm, 0, 1, 4, degree=1, max_grid_size=2)
    points = fem.uniform(mesh, 2)
    inverted = np.broadcast_to(np.diag([1.0, 1, -1]), (len(points), 3, 3))
    with pytest.raises(InputError, match=r"point \d+ at .* m has det F = -1.0; it must be positive"):
        mpm.Solid(points, PLAIN, deformation=inverted)
    with pytest.raises(InputError, match=r"numbers that are no material's; give .* numbers from 0 to 0"):
        mpm.Solid(points, PLAIN, np.ones(len(points)))
    with pytest.raises(InputError, match="damage has shape"):
        mpm.Solid(points, PLAIN, damage=np.zeros(3))
    u = np.zeros((len(mesh.nodes), 3))
    with pytest.raises(InputError, match='form is "initial", which neo-Hookean materials without damage have'):
        mpm.Solid(points, MATERIALS["ogden"]).tangent(u, "initial")
    with pytest.raises(InputError, match="the displacement has shape"):
        mpm.Solid(points, PLAIN).respond(u[:3])
