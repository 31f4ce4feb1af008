"""A mesh that goes with the beam: what happens in it is what happens without."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import SceneError
from amrpic.mesh.window import AT_REST
from amrpic.units import PROTON_MASS, SPEED_OF_LIGHT

MC = PROTON_MASS * SPEED_OF_LIGHT
BETA_GAMMA = 0.09  # slow enough for a self-field without B, also across axes
SPEED = BETA_GAMMA / np.hypot(1, BETA_GAMMA) * SPEED_OF_LIGHT
LINE = [  # bends by about 20 degrees
    {"kind": "quadrupole", "centre": [0, 0, "0.15 m"], "length": "0.1 m", "gradient": "2 T/m"},
    {"kind": "solenoid", "centre": [0, 0, "0.3 m"], "length": "0.1 m", "field": "0.15 T"},
    {"kind": "dipole", "centre": ["-1 cm", 0, "0.5 m"], "length": "0.2 m", "field": "0.45 T"},
]


def scene(window: str, half: float, start: list[float], direction: list[float], **more: Any) -> amrpic.Scene:
    """Protons without weight to speak of in a cube of a half width, which starts around their middle."""
    rng = np.random.default_rng(4)
    along = np.array(direction) / np.linalg.norm(direction)
    position = rng.normal(0, 1e-3, (40, 3)) + start
    momentum = (rng.normal(0, 1e-3, (40, 3)) + along) * BETA_GAMMA * MC
    reference = {"position": start, "momentum": (along * BETA_GAMMA * MC).tolist()}
    return amrpic.Scene.from_dict(
        {
            "domain": {"lower": [x - half for x in start], "upper": [x + half for x in start], "cells": [8, 8, 8]},
            "bunches": [
                {
                    "distribution": "arrays",
                    "position": position.tolist(),
                    "momenta": momentum.tolist(),
                    "charge": 1e-25,
                }
            ],
            "elements": LINE,
            "motion": {
                "kind": "leapfrog",
                "dt": 0.7 / SPEED / 50,
                "frame": "lab",
                "window": window,
                "reference": reference,
            },
            "schedule": {"steps": 50},
            "diagnostics": {"every": 10},
            "output": {"write": []},
        }
        | more
    )


def in_laboratory(run: amrpic.Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Places and momenta of all particles in the order of ids, along the axes of the laboratory."""
    found = run.particles.in_laboratory(run.window)
    parts = [np.concatenate(run.comm.allgather(np.array(a))) for a in (found.id, found.position, found.momentum)]
    order = np.argsort(parts[0])
    return parts[1][order], parts[2][order]


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("direction", [[0, 0, 1], [0.05, -0.03, 1], [0, 0.6, 0.8]])
def test_particles_go_where_they_go_on_a_mesh_at_rest(comm: MPI.Comm, direction: list[float]) -> None:
    """Along a straight, and along a bent line, where the window turns; also for a beam off all axes from the start."""
    start = [0.0, 0.0, 0.0]
    run = amrpic.Simulation(comm, scene("reference", 0.03, start, direction))
    run.run()
    resting = amrpic.Simulation(comm, scene("none", 2.0, start, direction))
    resting.run()
    assert run.particles.global_count(run.comm) == 40
    for found, expected in zip(in_laboratory(run), in_laboratory(resting), strict=True):
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-13)
    reference = run.reference
    assert reference is not None
    held = run.window.from_laboratory(np.subtract(reference.position, run.window.origin))
    np.testing.assert_allclose(held, start, atol=1e-14)  # on the mesh
    np.testing.assert_allclose(reference.path, 0.7, rtol=1e-3)
    if direction == [0, 0, 1]:
        bend = np.arctan2(-reference.momentum[0], reference.momentum[2])
        assert 0.25 < bend < 0.35
        np.testing.assert_allclose(
            run.window.axes[2], np.array(reference.momentum) / np.linalg.norm(reference.momentum)
        )
        np.testing.assert_allclose(run.window.axes @ np.transpose(run.window.axes), np.eye(3), atol=1e-15)


def test_the_reference_particle_moves_as_a_particle_of_the_beam() -> None:
    momenta = [[0, 0, BETA_GAMMA * MC]]
    bunch = {"distribution": "arrays", "charge": 1e-30, "position": [[0, 0, 0]], "momenta": momenta}
    run = amrpic.Simulation(MPI.COMM_SELF, scene("reference", 0.03, [0, 0, 0], [0, 0, 1], bunches=[bunch]))
    run.run()
    place, momentum = in_laboratory(run)
    assert run.reference is not None
    np.testing.assert_allclose(place[0], run.reference.position, rtol=0, atol=1e-15)
    np.testing.assert_allclose(momentum[0] / MC, np.array(run.reference.momentum) / MC, rtol=0, atol=2e-15)


def test_walls_along_the_beam_keep_the_axes() -> None:
    """In a pipe the window goes along z alone, whatever the reference particle does across."""
    walls = {"x": "dirichlet", "y": "dirichlet", "z": "periodic"}
    domain = {"lower": [-0.03] * 3, "upper": [0.03] * 3, "cells": [8] * 3, "boundary": walls}
    run = amrpic.Simulation(MPI.COMM_SELF, scene("reference", 0.03, [0, 0, 0], [0, 0, 1], domain=domain))
    run.run()
    assert run.reference is not None and run.reference.position[0] < -0.01
    assert run.window.axes == ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    assert run.window.origin[:2] == (0, 0)
    np.testing.assert_allclose(run.window.origin[2], run.reference.position[2], rtol=1e-15)


def test_a_run_goes_on_in_its_window(tmp_path: Path) -> None:
    """In the middle of the dipole, bit by bit."""
    given = scene("reference", 0.03, [0, 0, 0], [0, 0, 1], schedule={"steps": 37})
    first = amrpic.Simulation(MPI.COMM_SELF, given)
    first.run()
    first.checkpoint(tmp_path / "checkpoint")
    longer = scene("reference", 0.03, [0, 0, 0], [0, 0, 1])
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "checkpoint", longer)
    again.run()
    whole = amrpic.Simulation(MPI.COMM_SELF, longer)
    whole.run()
    assert again.state.course == whole.state.course
    for found, expected in zip(in_laboratory(again), in_laboratory(whole), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"boundary": {"z": ["open", "dirichlet"]}}, "wall ahead of the window"),
        ({"boundary": {"x": "dirichlet"}, "potential": {"x": "5*z"}}, "is a formula"),
    ],
)
def test_what_a_window_would_take_along_is_refused(change: dict[str, Any], part: str) -> None:
    given = scene("reference", 0.03, [0, 0, 0], [0, 0, 1]).to_dict()
    with pytest.raises(SceneError, match=part):
        amrpic.Scene.from_dict(given | {"domain": {**given["domain"], **change}})


def test_a_window_needs_a_particle_that_moves() -> None:
    given = scene("reference", 0.03, [0, 0, 0], [0, 0, 1]).to_dict()
    given["motion"].pop("reference")
    with pytest.raises(SceneError, match="reference particle that moves"):
        amrpic.Scene.from_dict(given)


def test_outputs_are_in_the_laboratory(tmp_path: Path) -> None:
    """Files of particles hold places and momenta of the laboratory, series where the window is."""
    given = scene(
        "reference", 0.03, [0, 0, 0], [0, 0, 1], output={"write": ["series", "particles"], "directory": str(tmp_path)}
    )
    run = amrpic.Simulation(MPI.COMM_SELF, given)
    run.run()
    place, momentum = in_laboratory(run)
    bunch = {"distribution": "openpmd", "file": str(tmp_path / "particles_00000050.h5")}
    domain = {"lower": [-1, -1, -1], "upper": [1, 1, 1], "cells": [8, 8, 8]}
    read = amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict({"domain": domain, "bunches": [bunch]})).particles
    order = np.argsort(read.id)
    np.testing.assert_allclose(read.position[order], place, rtol=0, atol=1e-15)
    np.testing.assert_allclose(read.momentum[order] / MC, momentum / MC, rtol=0, atol=1e-16)
    lines = [line for line in (tmp_path / "series.csv").read_text().splitlines() if not line.startswith("#")]
    row = dict(zip(lines[0].split(","), lines[-1].split(","), strict=True))
    assert run.reference is not None and float(row["s"]) == run.reference.path
    assert float(row["window_z"]) == run.window.origin[2] != 0


def test_a_window_backs_up_where_its_particle_turns_round() -> None:
    """It does not turn over: particles off the reference stay on the mesh."""
    window = AT_REST.turned(np.array([0, 0, 2.0]), np.array([0, 1e-3, -1.0]))
    np.testing.assert_allclose(window.axes[2], [0, -1e-3, 1], atol=1e-6)
    np.testing.assert_allclose(window.axes[1], [0, 1, 1e-3], atol=1e-6)
    assert window.turned(np.array([0, 0, 1.0]), np.zeros(3)) == window
