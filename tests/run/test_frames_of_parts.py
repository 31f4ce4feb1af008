"""Each part of the charge has the frame in which it rests: ions, beams both ways, warm beams, and what is left over."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import InputError, SolverError
from amrpic.particles.frame import LABORATORY
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from exact.sources import Gaussian
from verify import moving_charges

MC = ELECTRON_MASS * SPEED_OF_LIGHT
LONG = ["1 mm", "1 mm", "10 mm"]


def described(*bunches: dict[str, Any], boundary: Any = "open", **motion: Any) -> dict[str, Any]:
    bunch = {"distribution": "gaussian", "sigma": LONG, "particles": 20000, "sampling": "halton"}
    return {
        "domain": {"lower": ["-8 mm", "-8 mm", "-50 mm"], "upper": ["8 mm", "8 mm", "50 mm"], "cells": 32}
        | {"boundary": boundary},
        "bunches": [{**bunch, **one} for one in bunches],
        "motion": {"kind": "leapfrog", "dt": "5 ps", **motion},
        "output": {"write": []},
    }


def run(
    *bunches: dict[str, Any], comm: MPI.Comm = MPI.COMM_SELF, boundary: Any = "open", **motion: Any
) -> amrpic.Simulation:
    return amrpic.Simulation(comm, amrpic.Scene.from_dict(described(*bunches, boundary=boundary, **motion)))


BEAM = {"species": "electron", "kinetic_energy": "5 MeV", "charge": "-10 pC"}
BETA = np.sqrt(1 - (1 + 5 / 0.51099895) ** -2)
XENON = {"name": "xenon", "charge": 1.602176634e-19, "mass": 2.18e-25}


def force_left(simulation: amrpic.Simulation) -> float:
    """Of that of E on an electron of the beam, at its side."""
    at = [(1.5e-3, 0, 0)]
    magnetic = BETA * SPEED_OF_LIGHT * simulation.bfield.sample(at)[0, 1]
    return float(1 - magnetic / simulation.efield.sample(at)[0, 0])


@pytest.mark.parametrize(
    ("species", "charge"), [("proton", 0.1e-15), ("proton", 20e-15), (XENON, 9e-15), (XENON, 0.5e-12)]
)
def test_ions_at_rest_leave_a_beam_its_magnetic_field(species, charge):
    """(E - v B) / E of the beam is 1/γ², and ions with a share f of the charge add E alone: (1/γ² - f') / (1 - f')."""
    alone, among = run(BEAM), run(BEAM, {"species": species, "charge": charge})
    gamma = 1 / np.sqrt(1 - BETA**2)
    beam, ions = (
        Gaussian((1e-3, 1e-3, length), (0, 0, 0), 1e-12).field(*np.array([[1.5e-3], [0], [0]]))[0][0]
        for length in (gamma * 1e-2, 1e-2)
    )
    share = charge / 10e-12 * ions / (gamma * beam)
    assert force_left(alone) == pytest.approx(1 - BETA**2, rel=1e-7)
    assert force_left(among) == pytest.approx((1 - BETA**2 - share) / (1 - share), rel=0.01, abs=1e-5)
    assert not among.remarks


@pytest.mark.mpi(ranks=(1, 3))
def test_beams_both_ways_have_the_magnetic_field_of_both_currents(comm):
    """-8.4e-6 T by the integral, of which clouds leave -7.7e-6 T at σ = 2 h."""
    beams = [
        {"species": kind, "velocity": [0, 0, v], "charge": q}
        for kind, v, q in (("electron", "0.4 c", -1e-11), ("positron", "-0.4 c", 1e-11))
    ]
    assert run(*beams, comm=comm).bfield.sample([(1.5e-3, 0, 0)])[0, 1] == pytest.approx(-7.7e-6, rel=0.01)
    with pytest.raises(
        InputError, match=r'"lab", but the particles move with 0.4 c, where their magnetic field counts, by about'
    ):
        run(*beams, comm=comm, frame="lab")
    one = run(*beams, comm=comm, energy_bins=1)
    assert any("in 1 frame (motion.energy_bins)" in remark and 'to "auto"' in remark for remark in one.remarks)
    assert not run(*beams, comm=comm).remarks


def test_slow_currents_of_both_signs_are_not_lost():
    """E cancels, so that the force is all magnetic, however slow they are."""
    parts = [
        {"species": kind, "velocity": [0, 0, v], "charge": q}
        for kind, v, q in (("electron", "0.03 c", -1e-11), ("proton", 0, 1e-11))
    ]
    both, beam = run(*parts), run(parts[0])
    at = [(1.5e-3, 0, 0)]
    assert both.bfield.sample(at)[0, 1] == pytest.approx(beam.bfield.sample(at)[0, 1], rel=1e-6)


@pytest.mark.parametrize("momentum", [0.1, 0.3, 1.0, 3.0])
def test_the_force_of_a_warm_beam_is_within_its_estimate(momentum):
    ratios, simulation = moving_charges.compared(MPI.COMM_SELF, moving_charges.warm(momentum))
    error = simulation.state.solution.frames.error
    assert max(abs(ratio - 0.993) for ratio in ratios) < max(0.01, error)
    assert momentum**2 / 4 < error * (1 + momentum**2) < momentum**2 * 1.1
    assert any(f"off by about {error:.1%}" in remark for remark in simulation.remarks) == (error > 0.01)


def test_bins_make_the_force_of_a_beam_of_many_energies_exact():
    beam = moving_charges.spread("electron", 0.5)
    ratios, simulation = moving_charges.compared(MPI.COMM_SELF, beam)
    assert ratios == pytest.approx([0.993, 0.993], abs=0.01) and not simulation.remarks
    one, rough = moving_charges.compared(MPI.COMM_SELF, beam, energy_bins=1)
    error = rough.state.solution.frames.error
    assert 0.05 < abs(one[1] - 1) < error and any('energy_bins to "auto"' in remark for remark in rough.remarks)


def test_the_direct_sum_is_the_boosted_field_of_a_charge():
    """Of two charges by Lorentz transformations of Coulomb's field, there and back."""
    rng = np.random.default_rng(1)
    x, u, q = rng.normal(size=(2, 3)), rng.normal(size=(2, 3)), np.array([2e-9, -3e-9])
    found = moving_charges.forces(MPI.COMM_SELF, moving_charges.Charges(x, u, q, np.full(2, "electron")))
    for i, j in ((0, 1), (1, 0)):
        gamma = np.hypot(1, np.linalg.norm(u[j]))
        beta = u[j] / gamma
        r = x[i] - x[j]
        at_rest = r + gamma**2 / (gamma + 1) * beta * (beta @ r)
        coulomb = 8.9875517862e9 * q[j] * at_rest / np.linalg.norm(at_rest) ** 3
        field = gamma * coulomb - gamma**2 / (gamma + 1) * beta * (beta @ coulomb)
        magnetic = np.cross(beta, field)
        own = u[i] / np.hypot(1, np.linalg.norm(u[i]))
        assert found[i] == pytest.approx(q[i] * (field + np.cross(own, magnetic)), rel=1e-8)


def flat(seed: int, count: int, offset: float = 0.0, **motion: Any) -> amrpic.Simulation:
    """2 GeV, 3.3 m c across in its frame, and a mean momentum across of `offset` m c."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(count, 3)) * (3.3, 3.3, 0) + (offset, 0, 3914.0)
    bunch = {
        "distribution": "arrays",
        "species": "electron",
        "position": rng.normal(size=(count, 3)).clip(-4, 4) * 1e-6,
        "momenta": u * MC,
        "charge": -1e-11,
    }
    domain = {"lower": -12e-6, "upper": 12e-6, "cells": 8}
    return amrpic.Simulation(
        MPI.COMM_SELF,
        amrpic.Scene.from_dict(
            {"domain": domain, "bunches": [bunch], "motion": {"kind": "leapfrog", "dt": 1e-15, **motion}}
        ),
    )


def test_the_noise_of_a_mean_refuses_no_beam():
    for seed in range(12):
        for count in (30, 1000):
            flat(seed, count, energy_bins=4)
    for seed in range(3):
        with pytest.raises(InputError, match="off the z axis"):
            flat(seed, 1000, 2.5)


def test_dispersion_is_no_reason_to_refuse_a_beam():
    """Its bins move off the axis, and the beam does not."""
    rng = np.random.default_rng(1)
    energy = np.exp(rng.normal(size=2000).clip(-2.5, 2.5) * 0.2) * 20
    u = np.stack([0.5 * (energy / 20 - energy.mean() / 20), 0 * energy, energy], axis=1)
    beam = moving_charges.Charges(
        rng.normal(size=(2000, 3)).clip(-3, 3) * (1e-3, 1e-3, 5e-5), u, np.full(2000, -1e-15), np.full(2000, "electron")
    )
    simulation = moving_charges.compared(MPI.COMM_SELF, beam)[1]
    assert len(simulation.state.solution.frames.members) > 3


def test_a_hot_plasma_at_rest_has_one_frame_and_no_error():
    """What moves alike in all directions has the field of charge at rest."""
    rng = np.random.default_rng(1)
    plasma = moving_charges.Charges(
        rng.normal(size=(2000, 3)).clip(-2.5, 2.5) * 1e-3,
        rng.normal(size=(2000, 3)) * 0.3,
        np.full(2000, -1e-15),
        np.full(2000, "electron"),
    )
    ratios, simulation = moving_charges.compared(MPI.COMM_SELF, plasma)
    assert len(simulation.state.solution.frames.members) == 1 and not simulation.remarks
    assert ratios == pytest.approx([0.993, 0.993], abs=0.01)


@pytest.mark.mpi(ranks=(1, 3))
def test_frames_are_the_same_on_any_ranks(comm):
    bunches: list[dict[str, Any]] = [
        BEAM,
        {"species": "proton", "charge": 9e-15},
        {"species": "positron", "charge": 1e-12, "velocity": [0, 0, "-0.3 c"]},
    ]
    alone, together = run(*bunches), run(*bunches, comm=comm)
    assert together.state.solution.frames.of == alone.state.solution.frames.of
    for mine, own in zip(together.state.solution.frames.members, alone.state.solution.frames.members, strict=True):
        assert mine.momentum == pytest.approx(own.momentum, rel=1e-12)
    assert together.state.solution.frames.error == pytest.approx(alone.state.solution.frames.error, rel=1e-6, abs=1e-12)


def test_a_beam_that_is_slow_and_moves_towards_walls_is_solved_for_in_the_laboratory():
    """Of 0.05 c: without its magnetic field, 0.25 % of the force."""
    boundary = {"x": "open", "y": "open", "z": "dirichlet"}
    slow = {"species": "electron", "charge": "-10 pC", "velocity": [0, 0, "0.05 c"]}
    simulation = run(slow, boundary=boundary)
    found = simulation.state.solution.frames
    assert found.only == LABORATORY and found.error == pytest.approx(0.0025, rel=0.05) and not simulation.remarks


# ---- charge that cancels ----


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("boundary", ["periodic", "neumann"])
@pytest.mark.parametrize("speed", [0, "0.4 c"])
def test_charge_that_cancels_is_no_net_charge(comm, boundary, speed):
    """Also where both signs move against each other, and each is solved for in its own frame."""
    boundary = boundary if speed == 0 else {"x": boundary, "y": boundary, "z": "periodic"}
    lattices = [
        {"distribution": "lattice", "species": kind, "per_axis": 16, "charge": q, "velocity": [0, 0, v]}
        for kind, q, v in (("electron", "-1 nC", 0), ("proton", "1 nC", speed))
    ]
    scene = {
        "domain": {"lower": 0, "upper": 1, "cells": 8, "boundary": boundary},
        "bunches": lattices,
        "motion": {"kind": "leapfrog", "dt": 1e-12},
        "output": {"write": []},
    }
    simulation = amrpic.Simulation(comm, amrpic.Scene.from_dict(scene))
    assert len(simulation.state.solution.frames.members) == (1 if speed == 0 else 2)
    assert np.abs(simulation.phi.max()) < 1e-8  # of the 10 V that 1 nC makes at 1 m
    lattices[1]["charge"] = "1.001 nC"
    with pytest.raises(amrpic.AmrpicError, match="net charge"):
        amrpic.Simulation(comm, amrpic.Scene.from_dict(scene))


def test_what_is_left_of_a_neutral_plasma_is_refused_beyond_rounding():
    """1e-8 of what was deposited is a net charge, 1e-12 is not."""
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, amrpic.Domain((0, 0, 0), (1, 1, 1), (8, 8, 8), "periodic"), [])
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: 1e-20 + 0 * x)
    solver = amrpic.PoissonSolver(hierarchy)
    assert solver.solve(rho, deposited=1e-8)[0].max_abs() < 1e-12
    with pytest.raises(amrpic.AmrpicError, match="net charge"):
        solver.solve(rho, deposited=1e-12)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("form", ["kick-drift-kick", "drift-kick-drift"])
@pytest.mark.parametrize("energies", [(20.0, 20.4), (500.0,)])
def test_a_window_that_turns_with_beams_in_a_dipole_leaves_them_their_frames(comm, energies, form, tmp_path):
    """By 2π/1000 in a step, of which momenta lag half: more than 0.1/γ, and of the faster beam than 1/γ."""
    beams = [
        {**BEAM, "kinetic_energy": f"{one} MeV", "sigma": "1 mm", "charge": "-1 fC", "particles": 500}
        for one in energies
    ]
    given = run(*beams, comm=comm, window="reference", form=form, energy_bins=2).scene.to_dict()
    given["elements"] = [{"kind": "uniform", "magnetic_field": [0, "0.1 T", 0]}]
    given["motion"]["dt"] = "auto"
    simulation = amrpic.Simulation(comm, amrpic.Scene.from_dict(given))
    for _ in range(4):
        found = [frame.momentum for frame in simulation.state.solution.frames.members]
        assert found == pytest.approx([np.sqrt((1 + one / 0.51099895) ** 2 - 1) for one in energies], rel=1e-3)
        simulation.advance()
    assert simulation.window.is_turned and not simulation.remarks
    simulation.checkpoint(tmp_path / "checkpoint")
    again = amrpic.Simulation.restart(comm, tmp_path / "checkpoint")
    assert again.state.solution.frames.turn == simulation.state.solution.frames.turn is not None
    simulation.advance()
    again.advance()
    assert np.array_equal(again.state.particles.momentum, simulation.state.particles.momentum)


PIPE = {"x": "neumann", "y": "neumann", "z": "periodic"}


def in_pipe(*bunches: dict[str, Any], slope: float = 0.0, **more: Any) -> amrpic.Simulation:
    """Between Neumann faces 16 mm apart, of which the upper one along x has a slope (V/m)."""
    given = described(*bunches, boundary=PIPE) | more
    given["domain"] |= {"slope": {"x": [0, slope]}}
    return amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict(given))


def test_slopes_of_walls_beside_a_fast_beam_are_balanced_by_the_background():
    """E_x = -a (x + L/2) / L of a slope a, with the uniform charge that takes up its flux; of one frame and of two."""
    ions = {"species": "proton", "charge": 9e-15}
    for bunches in ([BEAM], [BEAM, ions]):
        simulation = in_pipe(*bunches, slope=1e3, background="neutralizing")
        alone = in_pipe(*bunches, background="neutralizing")
        x = np.linspace(-5e-3, 5e-3, 7)
        at = np.column_stack([x, 0 * x, 0 * x])
        of_walls = simulation.efield.sample(at)[:, 0] - alone.efield.sample(at)[:, 0]
        assert of_walls == pytest.approx(-1e3 * (x + 8e-3) / 16e-3, rel=1e-6)
        assert len(simulation.state.solution.frames.members) == len(bunches)


def test_flux_that_nothing_balances_beside_a_fast_beam_is_one_sentence():
    """Slopes that would balance the charge at rest balance none that moves; and slopes alone are told from the charge."""
    positrons = {**BEAM, "species": "positron", "charge": "10 pC"}
    area = 16e-3 * 100e-3
    slope = 10e-12 / VACUUM_PERMITTIVITY / area  # -(-10 pC) / ε0 through the face
    still = in_pipe({"species": "electron", "charge": "-10 pC"}, slope=slope)
    assert still.report.converged
    with pytest.raises(
        SolverError, match=r"net charge is -1e-11 C, which no potential and no domain\.slope, .*can balance"
    ):
        in_pipe(BEAM, slope=slope)
    with pytest.raises(
        SolverError, match=r"^domain\.slope, .*apart from charge that moves: all faces .* is 1\.00e-11 C"
    ):
        in_pipe(BEAM, positrons, slope=slope)
