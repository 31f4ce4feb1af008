"""Pictures of phase space show the particles that a dump holds."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.patches import StepPatch

from amrpic import Scene, Simulation
from amrpic.commands.main import parser
from amrpic.errors import InputError
from amrpic.io import particle_reader
from amrpic.particles.groups import Groups
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from amrpic.stages.beam_diagnostics import Beam, group_moments, group_slices
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from amrpic.view import phase_space_plots

BUNCHES = [
    {
        "distribution": "gaussian",
        "species": "electron",
        "charge": "-10 pC",
        "particles": 3000,
        "velocity": [0, 0, "0.3 c"],
        "twiss": {axis: {"emittance": "2 um rad", "alpha": 1, "sigma": "1 mm"} for axis in "xyz"},
    },
    {
        "distribution": "sphere",
        "name": "ions",
        "species": "proton",
        "radius": "3 mm",
        "charge": "5 pC",
        "particles": 300,
    },
]


def dumped(comm, folder, bunches=BUNCHES, **output):
    scene = Scene.from_dict(
        {
            "domain": {"lower": -0.02, "upper": 0.02, "cells": 16, "boundary": "open"},
            "bunches": bunches,
            "output": {"directory": str(folder), "write": ["checkpoint", "particles"], **output},
        }
    )
    simulation = Simulation(comm, scene)
    simulation.run()
    return simulation


@pytest.mark.mpi(ranks=(2,))
@pytest.mark.parametrize("writers", [1, 2])
def test_a_checkpoint_and_a_particle_file_hold_the_same_particles(comm, tmp_path, writers):
    simulation = dumped(comm, tmp_path, writers=writers)
    ids = np.concatenate(comm.allgather(simulation.particles.id))
    place = np.concatenate(comm.allgather(simulation.particles.position))[np.argsort(ids)]
    if comm.rank == 0:
        latest, file = particle_reader.read(tmp_path), particle_reader.read(tmp_path / "particles_00000000.h5")
        assert latest.path.name == "checkpoint_00000000"
        assert latest.groups.names == ("all", "electron", "proton", "bunch_0", "ions")
        assert file.groups.names == ("all", "electron", "proton")
        for dump in (latest, file):
            assert (dump.step, dump.time) == (0, 0.0)
            order = np.argsort(dump.particles.id)
            if dump is latest or writers == 1:
                np.testing.assert_array_equal(dump.particles.position[order], place)
            else:  # ids are numbers of rows, which are in order within each part of the file
                assert set(map(tuple, dump.particles.position.tolist())) == set(map(tuple, place.tolist()))
            assert dump.particles.charge[order].tolist() == [-ELEMENTARY_CHARGE] * 3000 + [ELEMENTARY_CHARGE] * 300


def bunch(x, u, weight=1e6):
    """Electrons at places (m) with momenta over m c."""
    table = SpeciesTable((SPECIES["electron"],))
    particles = Particles(
        x, u * ELECTRON_MASS * SPEED_OF_LIGHT, np.broadcast_to(weight, len(x)), np.arange(len(x)), table
    )
    groups, beam = Groups.of(table), Beam(particles, particles)
    return particles, groups, beam


def test_the_pixels_of_a_plane_hold_all_of_the_charge_in_their_places(comm):
    random = np.random.default_rng(1)
    particles, groups, beam = bunch(
        1e-3 * random.normal(size=(5000, 3)), 0.01 * random.normal(size=(5000, 3)) + [0, 0, 1]
    )
    part = group_moments(comm, beam, groups)[groups.members[0]]
    for name, (first, second) in phase_space_plots.PLANES.items():
        figure = phase_space_plots.draw_plane(particles, part, name, "test")
        plane = figure.axes[0]
        (mesh,) = (one for one in plane.collections if isinstance(one, QuadMesh))
        charge: np.ndarray = np.ma.filled(np.ma.asarray(mesh.get_array()), 0)
        assert np.nansum(charge) == pytest.approx(5000 * 1e6 * ELEMENTARY_CHARGE / 1e-12, rel=1e-9)  # drawn in pC
        corners = np.array(mesh.get_coordinates())
        centres = (corners[:-1, :-1] + corners[1:, 1:]) / 2
        scales = [1e3 if index < 3 else 510.99895 for index in (first, second)]  # mm, keV/c
        values = np.column_stack([beam.particles.position, beam.particles.momentum / (ELECTRON_MASS * SPEED_OF_LIGHT)])
        for axis, index in enumerate((first, second)):
            mean = np.nansum(charge * centres[..., axis]) / np.nansum(charge)
            width = np.ptp(corners[..., axis]) / charge.shape[0]
            assert mean == pytest.approx(values[:, index].mean() * scales[axis], abs=width / 10)
        (ellipse,) = plane.lines
        reach = np.ptp(np.array(ellipse.get_data()), axis=1) / 2
        np.testing.assert_allclose(
            reach, [values[:, i].std() * s for i, s in zip((first, second), scales, strict=True)], rtol=1e-3
        )


def test_the_picture_of_slices_shows_the_current(comm):
    random = np.random.default_rng(1)
    _, groups, beam = bunch(1e-3 * random.normal(size=(5000, 3)), 0.01 * random.normal(size=(5000, 3)) + [0, 0, 1])
    slices = group_slices(comm, beam, groups, group_moments(comm, beam, groups), 10)[groups.members[0]]
    current, *others = phase_space_plots.draw_slices(slices, "test").axes
    (shown,) = (one for one in current.patches if isinstance(one, StepPatch))
    np.testing.assert_allclose(shown.get_data()[0], np.array([one.current for one in slices]), rtol=1e-9)
    assert current.get_ylabel() == "current / A"
    assert [panel.get_ylabel().partition(" /")[0] for panel in others] == [
        "rms size", "emittance", "kinetic energy", "energy spread",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("count", "size", "momentum"), [(1, 1e-3, 0.1), (1, 0.0, 0.0), (50, 0.0, 0.0), (50, 1e-3, 0.0), (50, 0.0, 0.1)]
)
def test_degenerate_beams_can_be_drawn(comm, count, size, momentum):
    random = np.random.default_rng(1)
    particles, groups, beam = bunch(size * random.normal(size=(count, 3)), momentum * random.normal(size=(count, 3)))
    moments = group_moments(comm, beam, groups)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in phase_space_plots.PLANES:
            phase_space_plots.draw_plane(particles, moments[groups.members[0]], name, "test").canvas.draw()
        phase_space_plots.draw_slices(
            group_slices(comm, beam, groups, moments, 5)[groups.members[0]], "test"
        ).canvas.draw()


def test_the_command_draws_what_is_asked_for_and_refuses_the_rest(comm, tmp_path, capsys):
    dumped(comm, tmp_path)

    def draw(*arguments):
        chosen = parser().parse_args(["plot", str(tmp_path), "--kind", "phase-space", *arguments])
        assert chosen.command(chosen) == 0
        return {line.rpartition("/")[2] for line in capsys.readouterr().out.splitlines() if line.endswith(".png")}

    stem = "checkpoint_00000000"
    assert draw() == {f"{stem}_{name}.png" for name in ("x-px", "y-py", "z-pz", "x-y", "slices")}
    assert draw("--group", "ions", "--quantity", "x-y") == {f"{stem}_ions_x-y.png"}
    assert {path.name for path in tmp_path.glob("*.png")} >= {f"{stem}_ions_x-y.png", f"{stem}_slices.png"}
    for arguments, message in (
        (["--group", "muons"], "has no group muons; choose among all, electron, proton, bunch_0, ions"),
        (["--quantity", "phi"], "phase space has no picture phi; choose among x-px"),
        (["--axis", "x"], "axis has no effect on phase space"),
    ):
        with pytest.raises(InputError, match=message):
            draw(*arguments)
    with pytest.raises(InputError, match="group has no effect on a slice"):
        chosen = parser().parse_args(["plot", str(tmp_path), "--group", "ions"])
        chosen.command(chosen)


def test_a_folder_without_particles_and_a_lost_group_are_named(comm, tmp_path):
    with pytest.raises(InputError, match=r"holds neither checkpoint_\* nor particles_\*\.h5"):
        phase_space_plots.plot(tmp_path)
    dumped(comm, tmp_path, [{**BUNCHES[0]}, {**BUNCHES[1], "particles": 0}])
    with pytest.raises(InputError, match=r"ions of .* has no particles left to draw"):
        phase_space_plots.plot(tmp_path, group="ions")


def test_test_particles_are_drawn_each_as_one(comm, tmp_path):
    """A group of them among others, and a run of them alone, without a charge that they do not have."""
    tests = {**BUNCHES[1], "self_field": False, "charge": 0}
    for bunches, group in (([BUNCHES[0], tests], "ions"), ([tests], "all")):
        dumped(comm, tmp_path, bunches)
        dump = particle_reader.read(tmp_path)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = dict(phase_space_plots.figures(dump, group=group))
            for figure in found.values():
                figure.canvas.draw()
        assert list(found) == list(phase_space_plots.OVERVIEW)
        plane = found["x-y"]
        assert plane.axes[-1].get_ylabel() == "particles per pixel"
        [image] = (values for one in plane.axes[0].collections if (values := one.get_array()) is not None)
        assert np.nansum(np.ma.filled(image, 0)) == pytest.approx(BUNCHES[1]["particles"])
