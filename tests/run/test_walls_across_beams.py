"""Fast bunches that fly from and towards walls: in one frame and in several, and from a wall that the window leaves behind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import InputError, SceneError
from amrpic.pic.charge_images import WEAK
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT
from charges_in_motion import Ball, force, mirrored, total

MC = ELECTRON_MASS * SPEED_OF_LIGHT
SIGMA, CHARGE = 1e-3, -1e-15  # m at rest; C, which moves nothing
CATHODE = {"x": "open", "y": "open", "z": ["dirichlet", "open"]}
WINDOW = {"window": "reference"}


def scene(
    gammas: list[float],
    boundary: Any = CATHODE,
    cells: int = 32,
    motion: dict[str, Any] | None = None,
    particles: int = 2**16,
    **more: Any,
) -> amrpic.Scene:
    """Round bunches at rest, in a cube of 10 σ there, of the first of them, from z = 0 on."""
    gamma = gammas[0]
    half, length = 5 * SIGMA, 10 * SIGMA / gamma
    bunches = [
        {
            "distribution": "gaussian",
            "species": "electron",
            "charge": CHARGE,
            "particles": particles,
            "sigma": [SIGMA, SIGMA, SIGMA / one],
            "centre": [0, 0, length / 2],
            "momentum": [0, 0, float(np.sqrt(one**2 - 1) * MC)],
            "momentum_spread": 0,
            "sampling": "sobol",
        }
        for one in gammas
    ]
    return amrpic.Scene.from_dict(
        {
            "domain": {"lower": [-half, -half, 0], "upper": [half, half, length], "cells": cells, "boundary": boundary},
            "bunches": bunches,
            "particles": {"compensation": "none", "interface": "own-level"},
            "motion": {"kind": "leapfrog", "dt": 1e-16, **(motion or {})},
            "output": {"write": []},
            **more,
        }
    )


def balls(run: amrpic.Simulation, gammas: list[float]) -> list[Ball]:
    """The bunches as they are in the laboratory, which do not change on their way, with what clouds in cells add to them."""
    width, out = run.scene.domain.value.spacing, []
    for gamma in gammas:
        beta = float(np.sqrt(1 - gamma**-2))
        cloud = float(((width * (1, 1, gamma)) ** 2).mean() / 6)  # mean square at rest
        place = 5 * SIGMA / gammas[0] + beta * SPEED_OF_LIGHT * run.time
        out.append(Ball(CHARGE, place, beta, float(np.sqrt(SIGMA**2 + cloud))))
    return out


def grid(gammas: list[float]) -> np.ndarray:
    """Places in the middle of the mesh, (n, 3) m."""
    x = np.linspace(-3 * SIGMA, 3 * SIGMA, 13)
    z = np.linspace(1, 9, 13) * SIGMA / gammas[0]
    return np.stack(np.meshgrid(x, x, z), axis=-1).reshape(-1, 3) + 1e-7


def off(run: amrpic.Simulation, exact: list[Ball], gammas: list[float]) -> tuple[float, float]:
    """Errors of E and B over their largest values."""
    points = grid(gammas)
    fields = run.efield.sample(points, order=3), run.bfield.sample(points, order=3)
    reference = total(exact, points + run.window.origin)
    e, b = (float(np.abs(a - c).max() / np.abs(c).max()) for a, c in zip(fields, reference, strict=True))
    return e, b


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("gammas", [[5.0], [4.0, 6.0]], ids=["one energy", "two energies"])
def test_field_of_a_run_is_that_of_the_bunches_and_their_images(comm: MPI.Comm, gammas: list[float]) -> None:
    run = amrpic.Simulation(comm, scene(gammas))
    assert len(run.state.solution.frames.members) == len(gammas)
    own = balls(run, gammas)
    errors = off(run, [*own, *mirrored(own, 0.0)], gammas)
    assert max(errors) < 0.015 and min(off(run, own, gammas)) > 0.025
    assert not run.remarks


@pytest.mark.parametrize("beta", [0.11, 0.09])
def test_slow_bunches_have_the_walls_themselves(beta: float) -> None:
    """Below β² = 0.01 in one solve in the laboratory, which leaves the same field up to β²."""
    gamma = float(1 / np.sqrt(1 - beta**2))
    run = amrpic.Simulation(MPI.COMM_SELF, scene([gamma]))
    assert (run.state.solution.images is None) == (beta < 0.1)
    own = balls(run, [gamma])
    assert off(run, [*own, *mirrored(own, 0.0)], [gamma])[0] < 0.015


def test_a_wall_ahead_has_images_that_come_nearer() -> None:
    gamma = 5.0
    boundary = {"x": "open", "y": "open", "z": ["open", "dirichlet"]}
    step = SIGMA / gamma / SPEED_OF_LIGHT  # of about a σ
    run = amrpic.Simulation(MPI.COMM_SELF, scene([gamma], boundary, motion={"dt": step}, schedule={"steps": 2}))
    for _ in range(2):
        run.advance()
    own = balls(run, [gamma])
    assert max(off(run, [*own, *mirrored(own, 10 * SIGMA / gamma)], [gamma])) < 0.015


def test_force_on_a_bunch_that_leaves_a_cathode_is_that_of_all_images_for_200_of_its_lengths() -> None:
    """Within 1 % of its largest value, in a window that goes on by whole cells; images end where they no longer count."""
    gamma, steps = 5.0, 54
    beta = float(np.sqrt(1 - gamma**-2))
    dt = 225 * SIGMA / gamma / (beta * SPEED_OF_LIGHT) / steps
    given = scene([gamma], cells=40, motion={**WINDOW, "dt": dt}, particles=2**16, schedule={"steps": steps})
    run = amrpic.Simulation(MPI.COMM_SELF, given)
    points, ended, cell = grid([gamma]), None, 10 * SIGMA / gamma / 40
    for step in range(steps + 1):
        own = balls(run, [gamma])
        inside = points + np.array([0, 0, own[0].place - run.window.origin[2] - 5 * SIGMA / gamma])
        if step % 6 == 0:
            fields = run.efield.sample(inside, order=3), run.bfield.sample(inside, order=3)
            exact = force(total([*own, *mirrored(own, 0.0)], inside + run.window.origin), beta)
            error = np.abs(force(fields, beta) - exact)[:, :2].max() / np.abs(exact)[:, :2].max()
            assert error < 0.01
        frames = run.state.solution.frames
        assert run.window.origin[2] / cell == pytest.approx(round(run.window.origin[2] / cell), abs=1e-9)
        if run.state.solution.images is None:
            ended = step if ended is None else ended
        else:
            assert ended is None and frames.mirror is not None and frames.mirror.lower is not None
            assert frames.mirror.lower.place == pytest.approx(-run.window.origin[2], abs=1e-12)
        if step < steps:
            run.advance()
    assert ended is not None and run.window.origin[2] == pytest.approx(225 * SIGMA / gamma, abs=cell)
    assert len(run.lost.particles) == 0
    (said,) = run.remarks
    assert "images of the charge in the wall across z that the window left behind act with" in said
    # where they ended, by the closed forms, the images have less than that of the force, and 16 steps before more
    shares = []
    for at in (ended - 16, ended):
        way = beta * SPEED_OF_LIGHT * dt * max(at - 1, 0)
        charge = Ball(CHARGE, 5 * SIGMA / gamma + way, beta, SIGMA)
        some = np.random.default_rng(2).normal(size=(4000, 3)) * (SIGMA, SIGMA, SIGMA / gamma) + (0, 0, charge.place)
        square = [(force(total(of, some), beta) ** 2).sum() for of in (mirrored([charge], 0.0), [charge])]
        shares.append(float(np.sqrt(square[0] / square[1])))
    assert shares[1] < WEAK < shares[0]


SLOW = {"window": "reference", "dt": 3e-11}


@pytest.mark.parametrize(
    ("gammas", "motion", "tolerance"),
    [
        ([5.0], {"dt": 2e-12}, 1e-10),
        ([5.0], {"dt": 2e-12}, "discretization"),
        ([1.004], SLOW, 1e-10),
        ([4.0, 6.0], {"dt": 1e-12}, 1e-10),
    ],
)
def test_a_run_from_a_wall_left_behind_goes_on_bit_by_bit(
    tmp_path: Path, gammas: list[float], motion: dict[str, Any], tolerance: Any
) -> None:
    given = scene(
        gammas,
        cells=16,
        motion={**WINDOW, **motion},
        particles=2**11,
        schedule={"steps": 4},
        solver={"tolerance": tolerance},
    )
    run = amrpic.Simulation(MPI.COMM_SELF, given)
    run.on_step(lambda now: now.checkpoint(tmp_path / "half") if now.step == 2 else None)
    run.run()
    assert run.state.solution.images is not None and run.window.origin[2] > 0
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "half")
    assert again.state.solution.frames.mirror is not None and again.state.solution.frames.leaves
    again.run()
    for name in ("position", "momentum", "id"):
        assert np.array_equal(getattr(run.particles, name), getattr(again.particles, name))


def test_images_that_ended_stay_so_after_a_restart(tmp_path: Path) -> None:
    far = {**WINDOW, "dt": 3e-9}
    run = amrpic.Simulation(MPI.COMM_SELF, scene([5.0], cells=16, motion=far, particles=2**11, schedule={"steps": 18}))
    run.run()
    assert run.state.solution.images is None and len(run.remarks) == 1
    run.checkpoint(tmp_path / "checkpoint")
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "checkpoint")
    for simulation in (run, again):
        simulation.advance()
        assert simulation.state.solution.images is None
    assert np.array_equal(run.particles.momentum, again.particles.momentum)


def test_a_restart_on_another_base_goes_on_from_the_same_wall(tmp_path: Path) -> None:
    """In a window that then goes on by cells of that base: in the next step the wall is where it was."""
    motion = {**WINDOW, "dt": 1e-12}
    run = amrpic.Simulation(
        MPI.COMM_SELF, scene([5.0], cells=16, motion=motion, particles=2**11, schedule={"steps": 3})
    )
    run.run()
    run.checkpoint(tmp_path / "checkpoint")
    other = scene([5.0], cells=20, motion=motion, particles=2**11, schedule={"steps": 4})
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "checkpoint", other)
    assert any("a quarter of a base cell off" in remark for remark in again.remarks)
    again.advance()
    mirror = again.state.solution.frames.mirror
    assert mirror is not None and mirror.lower is not None
    assert mirror.lower.place + again.window.origin[2] == pytest.approx(0, abs=1e-12)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("sides", ["neumann", "periodic"])
def test_sides_without_a_way_for_the_current_are_refused(comm: MPI.Comm, sides: str) -> None:
    boundary = {"x": sides, "y": "neumann", "z": "dirichlet"}
    kinds = "neumann or periodic" if sides == "periodic" else "neumann"
    with pytest.raises(
        InputError, match=rf"across the motion along z is dirichlet and all sides are {kinds}, round which"
    ):
        amrpic.Simulation(comm, scene([5.0], boundary, cells=8, particles=2**10))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"z": "dirichlet"},
            r"domain.boundary.z .* has a wall ahead of the window, which would take it along; make the upper",
        ),
        ({"z": ["open", "neumann"]}, r"domain.boundary.z .* has a wall ahead of the window"),
    ],
)
def test_a_window_with_a_wall_ahead_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scene([5.0], {**CATHODE, **change}, motion=WINDOW)


@pytest.mark.parametrize("given", [{"z": [-100, 0]}, {"z": [0, 0], "x": [5, 0]}])
def test_potentials_beside_a_wall_left_behind_are_refused(given: dict[str, Any]) -> None:
    plain = scene([5.0], {**CATHODE, "x": "dirichlet"}).to_dict()
    plain["domain"]["potential"], plain["motion"]["window"] = given, "reference"
    with pytest.raises(SceneError, match="has an image in the wall that the window leaves behind"):
        amrpic.Scene.from_dict(plain)


def test_a_beam_along_a_wall_left_behind_is_refused() -> None:
    """Of which the images would move with it, and the plane beside it."""
    plain = scene([5.0], cells=8, particles=2**10, motion=WINDOW).to_dict()
    plain["motion"]["reference"] = {"species": "electron", "momentum": [0, 0, MC], "position": [0, 0, 1e-3]}
    plain["bunches"][0]["momentum"] = [3 * MC, 0, 0]
    with pytest.raises(
        InputError, match=r"the window leaves a wall across z behind, and particles .* move along x, beside it"
    ):
        amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict(plain))


def test_a_window_that_comes_back_over_its_wall_is_refused() -> None:
    """By a field that turns the reference particle round."""
    field = {"kind": "uniform", "electric_field": [0, 0, "100 MV/m"]}
    motion = {**WINDOW, "dt": 2e-12}
    back = scene([1.2], cells=8, particles=100, motion=motion, elements=[field], schedule={"steps": 60})
    with pytest.raises(
        InputError, match=r"the window has come back by .* m over the wall of z_lower, which it left behind"
    ):
        amrpic.Simulation(MPI.COMM_SELF, back).run()
