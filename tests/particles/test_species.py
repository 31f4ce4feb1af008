"""Electrons and protons in one scene: each with its own charge and mass, on any number of ranks and after a restart."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import backends
from amrpic import Domain, Field, Hierarchy, VectorField
from amrpic.particles.particles import Particles, concatenate
from amrpic.particles.species import SPECIES, Species, SpeciesTable
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.stages import diagnostics
from amrpic.stages.deposit import deposit
from amrpic.stages.migrate import migrate
from amrpic.stages.push import push
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, PROTON_MASS, SPEED_OF_LIGHT
from particle_cases import everywhere

ELECTRON, PROTON = (SPECIES[name] for name in ("electron", "proton"))
SIZE: dict[str, Any] = {"distribution": "gaussian", "sigma": 0.01}
BUNCHES = [
    {**SIZE, "species": "electron", "charge": -3e-12, "particles": 600, "centre": [-0.05, 0, 0]},
    {**SIZE, "species": "proton", "charge": 1e-12, "particles": 300, "centre": [0.05, 0, 0]},
    {
        **SIZE,
        "species": "electron",
        "charge": -1e-12,
        "particles": 100,
        "centre": [0, 0.085, 0],
        "velocity": [0, 6e6, 0],
    },
]


def scene(**changes: Any) -> Scene:
    return Scene.from_dict(
        {
            "domain": {"lower": -0.1, "upper": 0.1, "cells": 16, "boundary": "dirichlet"},
            "bunches": BUNCHES,
            "refinement": {"levels": 1, "max_grid_size": 8, "blocking_factor": 4, "regrid_every": 2},
            "motion": {"kind": "leapfrog", "dt": "2 ns"},
            "schedule": {"steps": 3},
            "output": {"write": []},
            **changes,
        }
    )


def test_a_table_finds_the_species_of_each_id():
    table = SpeciesTable.of_runs([(0, ELECTRON), (10, PROTON), (10, PROTON), (15, ELECTRON)])
    assert table.kinds == (ELECTRON, PROTON)
    assert table.find(np.array([0, 9, 10, 14, 15, 10**12])).tolist() == [0, 0, 1, 1, 0, 0]
    assert SpeciesTable.from_dict(table.to_dict()) == table
    ions = tuple(Species(charge=2 * PROTON.charge, mass=n * PROTON.mass) for n in (3, 4))
    assert SpeciesTable((*ions, PROTON)).names == ["particles_0", "particles_1", "proton"]


def test_equal_species_share_one_kind_and_take_no_memory():
    table = SpeciesTable.of_runs([(0, PROTON), (5, PROTON)])
    particles = Particles(np.zeros((9, 3)), np.zeros((9, 3)), np.ones(9), np.arange(9), table)
    assert len(table.kinds) == 1
    assert particles.charge.strides == particles.mass.strides == (0,)
    assert (particles.mass == PROTON_MASS).all()


def test_charge_over_mass_tells_how_far_a_field_moves_each():
    table = SpeciesTable.of_runs([(0, ELECTRON), (1, PROTON)])
    ids = np.array([1, 0, 0])
    hierarchy = Hierarchy(MPI.COMM_SELF, Domain((-1, -1, -1), (1, 1, 1), (8, 8, 8)))
    particles = Particles(np.zeros((3, 3)), np.zeros((3, 3)), np.ones(3), ids, table)
    five = Field(hierarchy).fill(lambda x, y, z: 5 + 0 * (x + y + z))
    particles, _ = migrate(particles, hierarchy)
    moved = push(VectorField(five, five, five), particles, 0.4e-9, 0.6e-9, 2e-9)
    ratio = np.array([1 / PROTON_MASS, -1 / ELECTRON_MASS, -1 / ELECTRON_MASS])
    u = ELEMENTARY_CHARGE * ratio * 5e-9 / SPEED_OF_LIGHT
    velocity = u * SPEED_OF_LIGHT / np.sqrt(1 + 3 * u**2)
    assert moved.position == pytest.approx(np.outer(velocity * 2e-9, np.ones(3)), rel=1e-14, abs=0)
    assert moved.select(slice(0, 2)).charge.tolist() == [ELEMENTARY_CHARGE, -ELEMENTARY_CHARGE]
    assert concatenate([moved, particles]).mass.tolist() == 2 * [PROTON_MASS, ELECTRON_MASS, ELECTRON_MASS]


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_both_species_are_measured_and_restarted(comm, tmp_path):
    simulation = Simulation(comm, scene())
    before = simulation.lost.particles.global_count(comm)
    assert simulation.rho.integral() == pytest.approx(-3e-12 + 1e-14 * before, rel=1e-13, abs=0)
    simulation.on_step(lambda now: now.checkpoint(tmp_path / "two") if now.step == 2 else None)
    simulation.run()
    particles, lost = simulation.particles, simulation.lost.particles
    assert lost.global_count(comm) > before  # electrons of the third bunch, which flies at the wall
    assert set(lost.charge) <= {-ELEMENTARY_CHARGE}
    assert lost.total_charge(comm) == pytest.approx(-1e-14 * lost.global_count(comm), rel=1e-12, abs=0)
    assert particles.total_charge(comm) + lost.total_charge(comm) == pytest.approx(-3e-12, rel=1e-13, abs=0)
    assert simulation.rho.integral() == pytest.approx(particles.total_charge(comm), rel=1e-12, abs=0)

    all_of = everywhere(comm, particles)
    proton = (all_of["id"] >= 600) & (all_of["id"] < 900)
    mass = np.where(proton, PROTON_MASS, ELECTRON_MASS)
    u = all_of["momentum"] / (mass * SPEED_OF_LIGHT)[:, None]
    energy = (np.sqrt(1 + (u**2).sum(axis=1)) - 1) * mass * SPEED_OF_LIGHT**2
    assert diagnostics.moments(comm, particles).kinetic_energy == pytest.approx(
        all_of["weight"] @ energy, rel=1e-6, abs=0
    )
    total = all_of["weight"] @ all_of["momentum"]
    np.testing.assert_allclose(diagnostics.moments(comm, particles).momentum, total, atol=1e-12 * np.abs(total).max())
    x = all_of["position"]
    area = [np.sqrt(np.linalg.det(np.cov(x[:, i], u[:, i], aweights=all_of["weight"], ddof=0))) for i in range(3)]
    np.testing.assert_allclose(diagnostics.moments(comm, particles).emittance, area, rtol=1e-9)

    again = Simulation.restart(comm, tmp_path / "two")
    assert again.particles.species == particles.species
    again.run()
    for after, before_it in ((again.particles, particles), (again.lost.particles, lost)):
        assert all(backends.same_sums(a, b, 1e-9) for a, b in zip(after.arrays, before_it.arrays, strict=True))
        assert np.array_equal(after.charge, before_it.charge) and np.array_equal(after.mass, before_it.mass)


@pytest.mark.mpi(ranks=(1, 2))
def test_density_is_the_sum_of_those_of_the_species(comm):
    simulation = Simulation(comm, scene(schedule={"steps": 0}))
    particles, hierarchy = simulation.particles, simulation.hierarchy
    apart = []
    for kind, species in enumerate(particles.species.kinds):
        one = particles.select(particles.kind == kind)
        apart.append(deposit(migrate(replace(one, species=SpeciesTable((species,))), hierarchy)[0], hierarchy))
    for level in range(hierarchy.levels):
        together = apart[0].array(level) + apart[1].array(level)
        scale = 1e-13 * simulation.rho.max_abs()
        np.testing.assert_allclose(simulation.rho.array(level), together, rtol=0, atol=scale)
    assert apart[1].integral() > 0 > apart[0].integral()


@pytest.mark.mpi(ranks=3)
def test_mixed_species_move_the_same_on_any_number_of_ranks(comm):
    alone, together = (Simulation(c, scene()) for c in (MPI.COMM_SELF, comm))
    for simulation in (alone, together):
        simulation.run()
    one, all_of = everywhere(MPI.COMM_SELF, alone.particles), everywhere(comm, together.particles)
    assert np.array_equal(one["id"], all_of["id"])
    assert all_of["position"] == pytest.approx(one["position"], rel=0, abs=1e-10)
    assert all_of["momentum"] == pytest.approx(one["momentum"], rel=1e-7, abs=1e-7 * np.abs(one["momentum"]).max())
