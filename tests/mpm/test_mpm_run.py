"""Runs of material points: closed forms, restart, files, on one rank and on two."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import mpm
from amrpic.commands.main import main
from amrpic.commands.watch import SHOWN_OF_POINTS, Look
from amrpic.errors import InputError, ParticleError
from amrpic.fem import Mesh
from amrpic.io import time_series
from amrpic.io.field_reader import open_dump
from amrpic.io.run_status import RunStatus
from amrpic.mesh.field import Field
from amrpic.mpm.material_points import migrate, require_inside
from amrpic.mpm.means import element_means
from amrpic.mpm.point_preview import preview
from amrpic.mpm.rows import loose_weights
from amrpic.mpm.step import mesh_of, sample
from amrpic.results.comparison import compare
from amrpic.view.draw import figures
from amrpic.view.views import View
from verify.mpm import GROUND, OF_SOFT, SOFT, column_errors, press
from vtk_files import vtk_read

EXAMPLES = Path(__file__).parents[2] / "examples"
RUBBER = {"law": "neo-hookean", "young": "300 MPa", "poisson": 0.25, "density": 1000}
INSIDE = 1 - 1e-12  # what lies on an upper wall is moved to the next number below it
WALLS = {"x": "slip", "y": "slip", "z": ["slip", {"press": 0.4}]}


def scene(tmp_path, **changes):
    return mpm.Scene.from_dict(
        {
            "name": "pressed",
            "domain": {"lower": 0, "upper": 1, "cells": [2, 2, 4], "degree": 1},
            "faces": WALLS,
            "materials": {"rubber": RUBBER},
            "schedule": {"steps": 10},
            "output": {"directory": str(tmp_path / "run"), "write": ["series", "checkpoint"], "checkpoint_every": 1},
            **changes,
        }
    )


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("law", ["neo-hookean", "ogden"])
def test_confined_compression_has_the_stress_in_closed_form(comm, tmp_path, law):
    plain = mpm.NeoHookean(300e6, 0.25)
    ogden = {"law": "ogden", "terms": [{"mu": plain.mu, "alpha": 2}], "lame": plain.lame}
    run = mpm.Simulation(comm, scene(tmp_path, materials={"rubber": RUBBER if law == "neo-hookean" else ogden}))
    *_, state = run
    stress = state.placed.solid.states(np.zeros((len(state.placed.mesh.nodes), 3))).cauchy
    for axis, exact in ((2, -230.165e6), (0, -102.165e6)):
        ends = [np.abs(stress[:, axis, axis] - exact).max(initial=0)]
        assert comm.allreduce(max(ends), MPI.MAX) < 500
    s = 0.6
    axial = plain.mu * (s - 1 / s) + plain.lame * np.log(s) / s
    assert np.abs(stress[:, 2, 2] / axial - 1).max(initial=0) < 1e-8
    row = state.measured
    assert row["force_z_upper"] == pytest.approx(axial, rel=1e-8)
    assert abs(row["force_z_upper"] + row["force_z_lower"]) < 1e-8 * abs(axial)
    assert row["travel_z"] == pytest.approx(0.4)
    energy = plain.mu / 2 * (s**2 - 1) - plain.mu * np.log(s) + plain.lame / 2 * np.log(s) ** 2
    assert row["stored"] == pytest.approx(energy, rel=1e-8)
    assert row["work"] == pytest.approx(energy, rel=0.01) and row["work"] == row["work_z_upper"] + row["work_gravity"]


@pytest.mark.mpi(ranks=(1, 2))
def test_a_column_compacts_under_its_own_weight(comm):
    """The stress along z is the weight above, in the first configuration: to 0.42 % at 64 elements."""
    column = mpm.Scene.from_toml(EXAMPLES / "column.toml")
    run = mpm.Simulation(comm, column)
    points = run.state.placed.points
    height = comm.allreduce(dict(zip(points.id.tolist(), points.position[:, 2].tolist(), strict=True)), MERGED)
    *_, state = run
    points = state.placed.points
    exact = -2000 * 9.81 * (16 - np.array([height[i] for i in points.id]))
    rest = np.zeros((len(state.placed.mesh.nodes), 3))
    found = state.placed.solid.states(rest).cauchy[state.placed.body][:, 2, 2]
    sums = np.array([points.volume @ (found - exact) ** 2, points.volume @ exact**2])
    apart, size = comm.allreduce(sums)
    assert np.sqrt(apart / size) < 0.0042
    assert state.measured["force_z_lower"] == pytest.approx(2000 * 9.81 * 4, rel=1e-7)
    assert 0 < state.measured["floor_share"] < 1e-6
    assert abs(state.measured["unbalanced"]) < 5e-4 * state.measured["stored"]
    assert state.measured["work_gravity"] == pytest.approx(state.measured["stored"], rel=0.01)


@pytest.mark.parametrize("column", [SOFT, GROUND])
def test_stress_of_a_column_converges_where_rows_of_two_points_cross_faces(column):
    """Mean error over points, in parts of the largest: order 1.1 or more."""
    coarse, fine = (column_errors(MPI.COMM_SELF, column, n, "uniform", 2)[1] for n in (16, 32))
    assert coarse < OF_SOFT[16] and fine < OF_SOFT[32]
    assert np.log2(coarse / fine) > 1.1


@pytest.mark.mpi(ranks=(1, 2))
def test_too_few_points_in_disorder_are_remarked_on(comm, tmp_path):
    for per_axis, remarks in ((2, 1), (3, 0)):
        few = scene(tmp_path, points={"per_axis": per_axis}, output={"directory": str(tmp_path / "few"), "write": []})
        found = loose_weights(mpm.Simulation(comm, few).state.placed)
        assert len(found) == remarks
        assert all(
            re.match(r"\d+ of 16 full elements have points whose weights cannot be exact to degree 1", one)
            for one in found
        )


def _merged(one, other, _):
    return {**one, **other}


MERGED = MPI.Op.Create(_merged, commute=True)


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
def test_points_are_bitwise_the_same_after_a_hundred_random_moves(comm):
    """Columns, masses and their first moments, by id, are those of one rank, and each point is with its element's rank."""
    moves, count = 100, 700
    draw = np.random.default_rng(3)
    columns = {
        "position": draw.uniform(size=(count, 3)),
        "id": np.arange(count),
        "material": draw.integers(0, 3, count),
        "deformation": np.eye(3) + 0.1 * draw.uniform(size=(count, 3, 3)),
        "initial_volume": draw.uniform(0.5, 1, count),
        "damage": draw.uniform(size=count),
        "driving": draw.uniform(size=count),
    }
    mesh = Mesh(comm, 0, 1, (6, 5, 7), degree=2, max_grid_size=4)
    mine = slice(comm.rank, None, comm.size)
    points, came = migrate({name: one[mine].copy() for name, one in columns.items()}, mesh)
    changed = 0
    for _ in range(moves):
        step = draw.uniform(-0.2, 0.2, size=(count, 3))
        columns["position"] = np.clip(columns["position"] + step, 0, INSIDE)
        moved = {**points.columns(), "position": np.clip(points.position + step[points.id], 0, INSIDE)}
        points, came = migrate(moved, mesh)
        changed += came
        element, _ = mesh.native.locate(points.position)
        assert (element >= 0).all()
        assert (np.diff(element) >= 0).all() and (np.diff(points.id)[np.diff(element) == 0] > 0).all()
    assert comm.allreduce(len(points)) == count
    assert comm.allreduce(changed) > (0 if comm.size > 1 else -1)
    for name, column in points.columns().items():
        np.testing.assert_array_equal(column, columns[name][points.id], err_msg=name)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_run_that_is_killed_goes_on_bit_by_bit(comm, tmp_path):
    whole = mpm.Simulation(
        comm, scene(tmp_path, structure=GRAINS, materials=TWO, schedule={"steps": 4, "damage_step": 1})
    )
    ids = whole.state.placed.points.id
    for _ in range(2):
        whole.advance()
    whole.checkpoint(tmp_path / "checkpoint_00000002")
    again = mpm.Simulation.restart(comm, tmp_path / "checkpoint_00000002")
    assert whole.state.measured == again.state.measured
    for run in (whole, again):
        for _ in range(2):
            run.advance()
    assert len(ids) > 0
    for name, column in whole.state.placed.points.columns().items():
        np.testing.assert_array_equal(column, again.state.placed.points.columns()[name], err_msg=name)
    assert whole.state.measured == again.state.measured and whole.state.load == again.state.load == 1


@pytest.mark.mpi(ranks=(1, 2))
def test_what_a_press_loses_is_let_go_by_forces_out_of_balance(comm):
    """Points take their forces into other elements at once; the mean of forces is right to a fifth of what that costs."""
    *_, last = mpm.Simulation(comm, mpm.Scene.from_dict({"name": "press", **press(4, breaks=False, part=0.15)}))
    row = last.measured
    assert row["gap"] > 0.01 * row["stored"]
    assert row["gap"] == pytest.approx(row["unbalanced"], rel=0.2)


@pytest.mark.mpi(ranks=2, more=(3, 4))
def test_ranks_press_a_structure_that_breaks_as_one_does(comm):
    """Steps and Newton's iterations are equal, CG's within one for each, displacements within 1e-6 of the largest."""
    small = mpm.Scene.from_dict({"name": "press", **press(3, breaks=True, part=0.006)})

    def pressed(ranks):
        run = mpm.Simulation(ranks, small)
        starts = by_id(ranks, run.state.placed.points)
        rows = [state.measured for state in run]
        return rows, by_id(ranks, run.state.placed.points) - starts

    rows, moved = pressed(comm)
    alone = comm.bcast(pressed(MPI.COMM_SELF) if comm.rank == 0 else None)
    assert len(rows) == len(alone[0]) and rows[-1]["damage_max"] > 0.5
    for mine, theirs in zip(rows, alone[0], strict=True):
        for name in ("load", "cuts", "turns", "newton_iterations", "newton_most"):
            assert mine[name] == theirs[name], name
        assert abs(mine["cg_most"] - theirs["cg_most"]) <= 1
        assert abs(mine["cg_iterations"] - theirs["cg_iterations"]) <= theirs["newton_iterations"]
    some = np.random.default_rng(1).choice(len(moved), 1000, replace=False)
    assert np.abs(moved - alone[1])[some].max() < 1e-6 * np.abs(alone[1]).max()


def by_id(comm, points):
    """Positions of all ranks' points, in the order of their ids."""
    ids, positions = (np.concatenate(comm.allgather(one)) for one in (points.id, points.position))
    return positions[np.argsort(ids)]


BRITTLE = {**RUBBER, "damage": {"toughness": "200 kJ/m^2", "length": "1 m"}}
TWO = {"grain": {**BRITTLE, "young": "2 GPa"}, "binder": BRITTLE}
GRAINS = {"kind": "voronoi", "grains": 5, "grain": "grain", "binder": "binder", "seed": 2}


def test_files_of_a_run_say_what_its_points_have(tmp_path):
    """By VTK's own reader."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    write = ["series", "points", "fields", "pictures", "checkpoint"]
    small = scene(
        tmp_path,
        structure=GRAINS,
        materials=TWO,
        schedule={"steps": 2, "damage_step": 1},
        output={"directory": str(tmp_path / "run"), "write": write, "points_every": 1},
    )
    run = mpm.Simulation(MPI.COMM_SELF, small)
    run.run(log="silent")
    points, means = run.state.placed.points, element_means(run.state, small)
    read = vtk_read(tmp_path / "run" / "points_00000002.vtkhdf")
    assert read.GetClassName() == "vtkPolyData" and read.GetNumberOfPoints() == read.GetNumberOfVerts() == len(points)
    np.testing.assert_array_equal(vtk_to_numpy(read.GetPoints().GetData()), points.position)
    values = {name: vtk_to_numpy(read.GetPointData().GetArray(name)) for name in ("F", "J", "id", "damage", "material")}
    np.testing.assert_array_equal(values["F"], points.deformation.reshape(-1, 9))
    for name in ("J", "id", "damage", "material"):
        np.testing.assert_array_equal(values[name], getattr(points, name.lower()), err_msg=name)
    assert 0 < values["damage"].max() < 1
    amr = vtk_read(tmp_path / "run" / "fields_00000002.vtkhdf")
    image = amr.GetDataSetAsImageData(0, 0)
    assert amr.GetNumberOfBlocks(0) == 1
    np.testing.assert_allclose(image.GetBounds(), [0, 1, 0, 1, 0, 0.6], atol=1e-14)
    for name in ("filled", "damage", "J", "mises", "share_grain"):
        np.testing.assert_array_equal(
            vtk_to_numpy(image.GetCellData().GetArray(name)), means[name].array(0), err_msg=name
        )
    volume = run.state.placed.mesh.element_volume
    assert means["filled"].sum() * volume == pytest.approx(points.volume.sum())
    share = (means["share_grain"] * means["filled"]).sum() * volume
    assert share == pytest.approx(points.volume[points.material == 0].sum())
    rows = time_series.read(tmp_path / "run" / "series.csv")
    assert rows["step"].tolist() == [0, 1, 2] and rows["load"].tolist() == [0, 0.5, 1]
    assert rows["stored"][-1] == pytest.approx(rows["stored_grain"][-1] + rows["stored_binder"][-1])
    assert rows["dissipated"][-1] > 0
    assert rows["stored"][-1] + rows["dissipated"][-1] <= 1.02 * rows["work"][-1]
    assert len(list((tmp_path / "run").glob("*.png"))) == 5


def test_a_picture_names_the_material_that_has_most_of_an_element(tmp_path):
    mixed = {"shape": "box", "material": "soft", "lower": [0, 0, 0], "upper": [1.2, 1, 1]}  # 40 % of the third element
    hole = {"shape": "box", "material": "empty", "lower": [0, 0, 0.5], "upper": [1, 1, 1]}
    small = scene(
        tmp_path,
        domain={"lower": 0, "upper": [2, 1, 1], "cells": [4, 2, 2], "degree": 1},
        materials={"soft": RUBBER, "hard": RUBBER},
        floor_stiffness=1e3,
        structure={"kind": "regions", "material": "hard", "regions": [mixed, hole]},
    )
    preview(MPI.COMM_SELF, small)
    with open_dump(small.directory / "preview.vtkhdf") as dump:
        [(_, figure)] = figures(dump, [View("material", axis=1)])
    panel, bar = figure.axes
    names = {int(at): text.get_text() for at, text in zip(bar.get_yticks(), bar.get_yticklabels(), strict=True)}
    shown = np.array(panel.images[0].get_array())
    height, width = shown.shape
    middles = [[int(shown[j * height // 4, i * width // 8]) for i in (1, 3, 5, 7)] for j in (1, 3)]
    found = [[names[number] for number in row] for row in middles]
    assert found == [["soft", "soft", "hard", "hard"], ["none", "none", "hard", "hard"]]


@pytest.mark.mpi(ranks=2)
def test_a_run_is_read_back_by_the_commands_that_know_points(comm, tmp_path):
    write = ["series", "fields", "points", "checkpoint", "pictures", "report"]
    output = {"directory": str(tmp_path / "run"), "write": write}
    results = mpm.Simulation(comm, scene(tmp_path, schedule={"steps": 2}, output=output)).run(log="silent")
    look = Look.at(tmp_path / "run", RunStatus.read(tmp_path / "run"))
    assert [name for name, _, _ in look.series] == list(SHOWN_OF_POINTS)
    found = compare(tmp_path / "run", tmp_path / "run")
    assert set(found.parts) == {"series", "fields", "points"} and found.equal(0)
    assert len(found.parts["series"]) > 30 and len(found.parts["fields"]) > 20 and len(found.parts["points"]) > 6
    mises = results.fields[2]["mises"]
    assert (
        isinstance(mises, Field) and mises.norm("max") > 0 and mises.hierarchy.domain.upper[2] < 1
    )  # where the platen is
    with pytest.raises(InputError, match="is of material points, whose scene is not read back; look at"):
        _ = results.scene
    page = (tmp_path / "run" / "report.html").read_text()
    assert re.findall(r"<h2>(\w+)</h2>", page) == ["Pictures", "Body", "Solver", "Time", "Remarks", "Scene"]
    names = re.findall(r'<img alt="([^"]*)" src="data:image/png;base64,', page)
    assert names == ["material_y", "damage_y", "pressure_y", "mises_y", "body", "solver", "time"]
    assert "<td>load</td><td>100 %</td>" in page and "method = &quot;mpm&quot;" in page
    slower = scene(tmp_path, schedule={"steps": 3}, output={**output, "directory": str(tmp_path / "slower")})
    mpm.Simulation(comm, slower).run(log="silent")
    found = compare(tmp_path / "run", tmp_path / "slower")  # at the same loads, which are not those of the same steps
    assert set(found.parts) == {"series", "fields", "points"}
    assert [(one.what, one.relative, one.where) for one in found.parts["series"][:2]] == [
        ("steps", math.inf, "3 of one run alone"),
        ("load", 0.0, ""),
    ]
    assert {one.where for one in found.parts["points"]} == {"at step 2"} and found.parts["points"][0].relative == 0
    elsewhere = scene(tmp_path, schedule={"steps": 2}, output={**output, "directory": str(tmp_path / "other")})
    again = mpm.Simulation.restart(comm, tmp_path / "run" / "checkpoint_00000002", elsewhere)
    again.run(log="silent")
    assert (tmp_path / "other" / "fields_00000002_mises_y.png").exists()
    assert not (tmp_path / "other" / "force.png").exists()


@pytest.mark.mpi(ranks=(1, 2))
def test_points_outside_or_inside_out_are_named(comm, tmp_path):
    given = scene(tmp_path)
    points = sample(given, mesh_of(comm, given))
    lower = mesh_of(comm, given, 1.0)
    with pytest.raises(
        ParticleError, match=r"point \d+ at \(.*\) m with det F = 1 lies outside the mesh at 0.5 of the load"
    ):
        require_inside(points.columns(), lower, 0.5)
    flat = {**points.columns(), "deformation": -points.deformation}
    with pytest.raises(ParticleError, match="is turned inside out"):
        require_inside(flat, mesh_of(comm, given), 0.5)


@pytest.mark.mpi(ranks=(1, 2))
def test_elements_with_too_few_points_need_a_floor(comm, tmp_path):
    few = scene(tmp_path, domain={"lower": 0, "upper": 1, "cells": 4, "degree": 2}, points={"per_axis": 2})
    with pytest.raises(
        InputError,
        match=r"has 8 points, fewer than the 13 that degree 2 needs, and is one of \d+ such on a rank; set floor",
    ):
        mpm.Simulation(comm, few)
    run = mpm.Simulation(comm, few.replace(floor_stiffness=1e5))
    assert run.advance().measured["floor_share"] > 0


def test_commands_on_a_run_work_or_say_in_a_sentence_that_they_do_not(tmp_path, capsys):
    for name in ("one", "other"):
        output = {"directory": str(tmp_path / name), "write": ["series", "fields", "points"]}
        small = scene(tmp_path, schedule={"steps": 2}, output=output)
        mpm.Simulation(MPI.COMM_SELF, small).run(log="silent")
    one, other = (str(tmp_path / name) for name in ("one", "other"))

    def said(*arguments):
        with pytest.raises(SystemExit) as ended:
            main([*arguments])
        return ended.value.code, capsys.readouterr()

    code, shown = said("watch", one, "--once")
    assert code == 0 and "finished" in shown.out
    lines = {line.split()[0]: line for line in shown.out.splitlines() if line}
    assert "2 of 2, 100 %" in lines["step"] and "100.00 %" in lines["load"] and "1024" in lines["points"]
    assert {"work", "stored", "newton_iterations"} <= set(lines) and not {"particles", "mesh"} & set(lines)
    code, shown = said("compare", one, other, "--tolerance", "0")
    assert code == 0 and "results are the same" in shown.out and "fields" in shown.out and "points" in shown.out
    code, shown = said("report", one)
    assert code == 0 and shown.out == f"{Path(one) / 'report.html'}\n"
    code, shown = said("plot", one)
    assert code == 0 and "material" in shown.out
