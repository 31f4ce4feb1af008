"""Damage by a phase field against closed forms, and loads that come on in steps."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import fem, mpm
from amrpic.errors import InputError, SolverError

TOUGHNESS = 60.0


def shear(mesh, amount):
    return mesh.nodes @ np.array([[0, amount, 0], [0, 0, 0], [0, 0, 0]]).T


def test_damage_of_a_point_is_in_closed_form_and_never_falls():
    law = mpm.NeoHookean(4e9, 0.25, mpm.Damage(TOUGHNESS, 0.25e-3))
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1e-3, 2, degree=1)
    solid, before, least = mpm.Solid(fem.gauss(mesh), law), 0.0, 0.0
    for amount in (1e-3, 3e-3, 0, 2e-3, 4e-3, 0, 5e-3, 1e-3):  # three cycles
        settled, report = mpm.settle(solid, fixed=mesh.boundary, values=shear(mesh, amount), tolerance=1e-12)
        assert report.converged
        solid = settled.solid
        by = 2 * 0.99 * solid.driving
        assert solid.damage == pytest.approx(by / (by + TOUGHNESS / 0.25e-3), rel=1e-10)
        largest = max(before, settled.solid.states(settled.displacement).driving.max())
        assert solid.driving == pytest.approx(np.full(len(solid.driving), largest), rel=1e-12)
        assert solid.damage.min() >= least * (1 - 1e-13)
        before, least = float(solid.driving.max()), float(solid.damage.min())
    assert least > 0.1


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("degree, cells", [(1, 80), (2, 40)])
def test_a_crack_has_its_profile_and_dissipates_its_toughness(comm, degree, cells):
    mesh = fem.Mesh(comm, 0, (1, 0.05, 0.05), (cells, 2, 2), degree=degree)
    length = 4 / (cells * degree)  # node spacings
    law = mpm.NeoHookean(4e9, 0.25, mpm.Damage(TOUGHNESS, length))
    solid = mpm.Solid(fem.jittered(mesh, 6), law)
    away = np.abs(mesh.nodes[:, 0] - 0.5)
    d = mpm.damage_field(solid, np.zeros(len(solid.points)), fixed=away < 1e-9, values=1.0)
    assert np.abs(d - np.exp(-away / length)).max(initial=0.0) < 0.02
    assert solid.dissipated(d) == pytest.approx(TOUGHNESS * 0.05**2, rel=0.02)
    for start in (np.where(away < 1e-9, 1.0, 0.3), d):
        again = mpm.damage_field(solid, 0 * solid.driving, fixed=away < 1e-9, values=1.0, start=start)
        assert np.abs(again - d).max(initial=0.0) < 1e-10


def test_what_does_not_break_has_no_damage():
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1e-3, 4, degree=1)
    points = fem.uniform(mesh, 2)
    upper = points.position[:, 2] > 0.5e-3
    laws = (mpm.NeoHookean(4e9, 0.25, mpm.Damage(TOUGHNESS, 0.5e-3)), mpm.NeoHookean(4e9, 0.25))
    solid = mpm.Solid(points, laws, upper.astype(int))
    d = mpm.damage_field(solid, np.full(len(points), 1e5))
    assert (d[mesh.node_indices[:, 2] > 2] == 0).all() and (d[mesh.node_indices[:, 2] <= 2] > 0.4).all()


def pulled(comm):
    """A bar with a weak middle, and how far its end goes."""
    mesh = fem.Mesh(comm, 0, (4e-3, 1e-3, 1e-3), (16, 4, 4), degree=1)
    points = fem.uniform(mesh, 2)
    damage = mpm.Damage(TOUGHNESS, 0.5e-3)
    weak = np.abs(points.position[:, 0] - 2e-3) < 0.25e-3
    laws = (mpm.NeoHookean(4e9, 0.25, damage), mpm.NeoHookean(3.6e9, 0.25, damage))
    return mpm.Solid(points, laws, weak.astype(int))


def test_a_bar_pulled_apart_breaks_in_its_weak_middle_and_keeps_its_energy():
    solid = pulled(MPI.COMM_SELF)
    mesh = solid.mesh
    end = mesh.node_indices[:, 0] == 16
    fixed = np.stack([end | (mesh.node_indices[:, 0] == 0), *(mesh.node_indices[:, d] == 0 for d in (1, 2))], axis=1)
    forces, work, pull = [0.0], 0.0, 40e-6
    broken, u, loads = solid, np.zeros((len(mesh.nodes), 3)), mpm.Loads(steps=20)
    dissipated: list[tuple[float, float, float]] = []
    while loads.begin < 1:
        values = np.zeros((len(mesh.nodes), 3))
        values[end, 0] = loads.end * pull
        settled, report = mpm.settle(broken, fixed=fixed, values=values, start=u, tolerance=1e-7, most_turns=300)
        assert report.converged
        broken, u = settled.solid, settled.displacement
        after = broken.respond(u).force[end, 0].sum()
        work += (forces[-1] + after) / 2 * (loads.end - loads.begin) * pull
        forces.append(after)
        dissipated.append((broken.dissipated(settled.damage), report.equilibria[-1].energy, work))
        loads = loads.taken(report.most_iterations)
    assert forces[-1] < 0.5 * max(forces)
    middle = np.abs(broken.points.position[:, 0] - 2e-3) < 0.5e-3
    assert broken.damage[middle].max() > 0.9 > broken.damage[~middle].max()
    for lost, stored, done in dissipated[:5]:  # before it breaks at once
        assert lost + stored == pytest.approx(done, rel=0.03)


def test_turns_go_beyond_what_the_last_led_to_and_not_back_to_states_that_are_not_stable(monkeypatch):
    """Before the bar breaks fewer turns find the same damage; where it breaks within a step, it does so all the same."""
    solid = pulled(MPI.COMM_SELF)
    mesh = solid.mesh
    end = mesh.node_indices[:, 0] == 16
    fixed = np.stack([end | (mesh.node_indices[:, 0] == 0), *(mesh.node_indices[:, d] == 0 for d in (1, 2))], axis=1)

    def turns(pull, tolerance):
        values = np.where(end[:, None] & [True, False, False], pull, 0.0)
        settled, report = mpm.settle(solid, fixed=fixed, values=values, tolerance=tolerance, most_turns=300)
        assert report.converged
        return settled.solid.damage, report.turns

    whole, few = turns(10e-6, 1e-7)
    broken, _ = turns(22e-6, 1e-5)
    monkeypatch.setattr("amrpic.mpm.damage._farther_on", lambda solid, past: past[-1][1])
    expected, many = turns(10e-6, 1e-7)
    assert few < 0.7 * many, (few, many)
    assert np.abs(whole - expected).max() < 1e-6
    assert broken.max() > 0.9


@pytest.mark.parametrize("fails_at", [0.31, 0.77])
def test_steps_are_halved_where_there_is_no_state_and_grow_again(fails_at):
    loads, taken, cuts = mpm.Loads(steps=10), [(0.0, 0.0)], 0
    while loads.begin < 1:
        if loads.end - loads.begin > 0.06 and loads.begin <= fails_at < loads.end:
            loads, cuts = loads.cut("no state was found"), cuts + 1
        else:
            taken.append((loads.begin, loads.end))
            loads = loads.taken(iterations=2 if loads.begin < fails_at else 6)
    assert cuts > 0 and all(a[1] == b[0] for a, b in pairwise(taken)) and taken[-1][1] == 1
    lengths = [end - begin for begin, end in taken[1:]]
    assert max(lengths) <= 0.1 + 1e-12 and min(lengths) <= 0.05 + 1e-12


def test_loads_without_a_state_end_with_their_history():
    loads = mpm.Loads(steps=10, begin=0.5, smallest=0.03)
    with pytest.raises(
        SolverError, match=r"beyond 0.5 of the load; steps that failed: 0.5 to 0.6, 0.5 to 0.55; the last: why"
    ):
        loads.cut("not this").cut("why")
    with pytest.raises(InputError, match="give at least one, and a part of the load"):
        mpm.Loads(steps=0)


def test_lengths_of_steps_follow_what_breaks_and_a_crack_at_once_is_one_step():
    loads = mpm.Loads(steps=10, damage_step=0.2)
    assert loads.most_growth == 0.2 / 4 and loads.taken(9).most_growth == 0.2
    assert loads.taken(9, growth=0.1).length == pytest.approx(0.1)
    assert loads.taken(9, growth=0.19).length == pytest.approx(0.075)
    assert loads.taken(2, growth=0.3).length == pytest.approx(0.05)
    for _ in range(4):
        loads = loads.cut("it breaks")
    assert loads.length == pytest.approx(0.1 / 16) and loads.most_growth == 0.2 / 4
    after = loads.taken(2, growth=0.9)
    assert after.begin == loads.length == after.length  # no shorter for what broke
    assert after.most_growth == np.inf
    assert after.taken(2, growth=0.01).length == pytest.approx(1.5 * after.length)


@pytest.mark.parametrize("limits", [{"breaking": 0.03}, {"smallest": 0.03}])
def test_the_shortest_steps_that_break_are_as_long_as_asked_for(limits):
    loads = mpm.Loads(steps=10, damage_step=0.2, begin=0.5, **limits)
    assert loads.most_growth == 0.2
    assert replace(loads, length=0.04).most_growth == np.inf
    assert replace(loads, length=0.04).taken(9, growth=1.0).length == pytest.approx(0.03)


def test_a_step_that_breaks_too_much_is_left_at_its_first_turns():
    solid = pulled(MPI.COMM_SELF)
    mesh = solid.mesh
    end = mesh.node_indices[:, 0] == 16
    fixed = np.stack([end | (mesh.node_indices[:, 0] == 0), *(mesh.node_indices[:, d] == 0 for d in (1, 2))], axis=1)
    values = np.where(end[:, None] & [True, False, False], 30e-6, 0.0)
    settled, report = mpm.settle(solid, fixed=fixed, values=values, most_growth=0.3, tolerance=1e-7, most_turns=300)
    assert not report.converged and report.growth > 0.3 and report.turns < 5
    assert settled.solid.damage.max() == pytest.approx(report.growth)
