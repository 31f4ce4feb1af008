"""Deposit and gather: charge is kept, and both follow the rules at faces, walls and covered cells."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import hierarchies
from amrpic.errors import ParticleError
from amrpic.particles.particles import Particles
from amrpic.stages.deposit import deposit
from amrpic.stages.gather import gather
from amrpic.stages.migrate import migrate
from amrpic.stages.push import push
from particle_cases import (
    CHARGE,
    ONE_KIND,
    Mesh,
    assert_as_by_hand,
    dense,
    gather_by_hand,
    hierarchy_of,
    placed,
    random_field,
    scattered,
)

CASES = list(hierarchies.all_cases().values())


@pytest.mark.mpi(ranks=(1, 2, 3), timeout=120)
def test_deposit_keeps_the_total_charge(comm):
    for case in CASES:
        hierarchy, particles = placed(case, comm, 5000)
        total = particles.total_charge(comm)
        assert deposit(particles, hierarchy).integral() == pytest.approx(total, rel=1e-13, abs=0), case.name


@pytest.mark.mpi(ranks=(3,), timeout=120)
def test_deposit_follows_its_rules_in_every_cell(comm):
    for case in CASES:
        assert_as_by_hand(*placed(case, comm, 200), case)


@pytest.mark.mpi(ranks=(1, 2), timeout=120)
def test_deposit_follows_its_rules_on_corners_of_cells(comm):
    """Particles on cell corners, faces and centres, the corners of boxes among them."""
    for case in CASES:
        hierarchy = hierarchy_of(case, comm)
        if not (np.log2(hierarchy.spacing(0)) % 1 == 0).all():
            continue  # its corners are not exact in binary
        random = scattered(hierarchy, 400)
        half_cells = hierarchy.spacing(hierarchy.levels - 1) / 2
        corners = np.array(case.lower) + np.floor((random.position - case.lower) / half_cells) * half_cells
        particles, lost = migrate(random.replace(position=corners), hierarchy)
        assert len(lost) == 0
        assert_as_by_hand(hierarchy, particles, case)


@pytest.mark.mpi(ranks=(2, 3), timeout=120)
def test_density_is_the_same_on_one_rank_and_on_all(comm):
    for case in CASES[:12]:
        alone, together = (deposit(p, h) for h, p in (placed(case, c, 2000) for c in (MPI.COMM_SELF, comm)))
        for level in range(len(case.levels) + 1):
            a, b = dense(alone, level), dense(together, level)
            assert np.nan_to_num(b) == pytest.approx(np.nan_to_num(a), rel=0, abs=1e-13 * np.nanmax(np.abs(a))), (
                case.name
            )


@pytest.mark.mpi(ranks=(1, 3), timeout=120)
def test_gather_follows_its_rules_at_every_particle(comm):
    for case in CASES:
        hierarchy, particles = placed(case, comm, 150)
        field, mesh = random_field(hierarchy), Mesh(hierarchy)
        values = [dense(field, level) for level in range(hierarchy.levels)]
        found = gather(amrpic.VectorField(field, field, field), particles)
        expected = gather_by_hand(mesh, values, particles.position)
        for axis in range(3):
            assert found[:, axis] == pytest.approx(expected, rel=0, abs=1e-12), case.name


@pytest.mark.mpi(ranks=(1, 2))
def test_linear_field_is_gathered_exactly_away_from_walls(comm):
    checked = 0
    for case in CASES:
        hierarchy, particles = placed(case, comm, 2000)
        components = (
            amrpic.Field(hierarchy).fill(lambda x, y, z: 1 + 0.3 * x - 2 * y + z),
            amrpic.Field(hierarchy).fill(lambda x, y, z: x + 0 * y * z),
            amrpic.Field(hierarchy).fill(lambda x, y, z: -1 + 2 * x + 3 * y + 4 * z),
        )
        found = gather(amrpic.VectorField(*components), particles)
        x, y, z = particles.position.T
        expected = np.stack([1 + 0.3 * x - 2 * y + z, x, -1 + 2 * x + 3 * y + 4 * z], axis=1)
        margin = hierarchy.spacing(0)
        inside = (
            (particles.position > np.array(case.lower) + margin) & (particles.position < np.array(case.upper) - margin)
        ).all(axis=1)
        checked += comm.allreduce(int(inside.sum()))
        assert np.abs(found - expected)[inside].max(initial=0) < 1e-12, case.name
    assert checked > 300 * len(CASES)


@pytest.mark.mpi(ranks=(1, 2))
def test_uniform_field_is_gathered_exactly_everywhere(comm):
    for case in CASES:
        hierarchy, particles = placed(case, comm, 2000)
        components = [amrpic.Field(hierarchy) for _ in range(3)]
        for component, value in zip(components, (1.0, -2.0, 3e5), strict=True):
            for patch in component.patches:
                patch.data[...] = value
        found = gather(amrpic.VectorField(*components), particles)
        assert found == pytest.approx(np.broadcast_to([1.0, -2.0, 3e5], found.shape), rel=1e-14), case.name


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_gather_is_the_adjoint_of_deposit_on_one_level(comm):
    """The power of the field on the charge is the same, summed over cells or over particles."""
    for boundary in ("oooooo", "pppppp", "dndnpp"):
        case = hierarchies.make(f"one level {boundary}", (12, 8, 16), boundary, 4, [])
        hierarchy, particles = placed(case, comm, 1000)
        field = random_field(hierarchy)
        density = deposit(particles, hierarchy)
        for patch, other in zip(density.patches, field.patches, strict=True):
            patch.data[...] *= other.data
        felt = gather(amrpic.VectorField(field, field, field), particles)[:, 1]
        power = comm.allreduce(CHARGE * float((particles.weight * felt).sum()))
        assert density.integral() == pytest.approx(power, rel=0, abs=1e-13 * 1000 * abs(CHARGE))


def test_overhang_is_folded_onto_the_wall_cell(comm):
    domain = amrpic.Domain((0, 0, 0), (8, 8, 8), (8, 8, 8), "dirichlet")
    hierarchy = amrpic.Hierarchy(comm, domain)
    at_wall = Particles(np.array([[0.0, 7.75, 0.5]]), np.zeros((1, 3)), np.ones(1), np.zeros(1), ONE_KIND)
    density = dense(deposit(migrate(at_wall, hierarchy)[0], hierarchy), 0)
    assert density[0, 7, 0] == CHARGE
    assert density.sum() == CHARGE


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_no_particles_are_ordinary(comm):
    for case in CASES[:4]:
        hierarchy, particles = placed(case, comm, 0)
        assert deposit(particles, hierarchy).max_abs() == 0
        field = random_field(hierarchy)
        assert gather(amrpic.VectorField(field, field, field), particles).shape == (0, 3)


@pytest.mark.mpi(ranks=(2, 3))
def test_particles_on_one_rank_only_are_ordinary(comm):
    hierarchy = hierarchy_of(hierarchies.all_cases()["U of small blocks, three levels"], comm)
    spot = scattered(hierarchy, 1).position if comm.rank == 0 else np.full((1, 3), np.nan)
    spot = comm.bcast(spot)
    count = 10 if comm.rank == 0 else 0
    particles = Particles(
        np.repeat(spot, count, axis=0), np.zeros((count, 3)), np.ones(count), np.arange(count), ONE_KIND
    )
    particles, _ = migrate(particles, hierarchy)
    assert deposit(particles, hierarchy).integral() == pytest.approx(10 * CHARGE, rel=1e-14, abs=0)


def test_particles_that_have_not_migrated_are_refused(comm):
    hierarchy = hierarchy_of(CASES[1], comm)
    with pytest.raises(ParticleError, match="migrate"):
        deposit(scattered(hierarchy, 3), hierarchy)


@pytest.mark.mpi(ranks=(1, 2))
def test_particles_moved_behind_the_back_of_migrate_are_refused_by_all_ranks(comm):
    hierarchy, particles = placed(CASES[1], comm, 40)
    field = random_field(hierarchy)
    if comm.rank == comm.size - 1:
        particles.position[3] = 1e9
    for use in (
        lambda: deposit(particles, hierarchy),
        lambda: gather(amrpic.VectorField(field, field, field), particles),
        lambda: push(amrpic.VectorField(field, field, field), particles, 1.0, 1.0, 1.0),
    ):
        with pytest.raises(ParticleError, match=r"particle \d+ has left .*migrate"):
            use()
