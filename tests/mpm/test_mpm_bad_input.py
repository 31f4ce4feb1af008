"""What a scene of material points cannot have: one clear sentence each, the same on all ranks."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from amrpic import mpm
from amrpic.commands.methods import scene_from, simulation_of
from amrpic.errors import InputError, SceneError, SolverError
from amrpic.scene.parts import OF_POINTS
from amrpic.scene.scene import Scene
from amrpic.scene.toml import override

GOOD = """
method = "mpm"
domain = { lower = 0, upper = 1, cells = 2, degree = 1 }
faces = { x = "slip", y = "slip", z = ["clamped", { press = 0.1 }] }
[materials.rubber]
law = "neo-hookean"
young = "3 MPa"
poisson = 0.3
"""

MISTAKES = {
    'method="fem"': 'method .*fem.* is not one of the choices; use "mpm", or leave it out for particle-in-cell',
    "bunches=[]": 'bunches .* is an unknown key; it is for particle-in-cell: leave it out, or leave out method = "mpm"',
    'materials.rubber.law="steel"': "materials.rubber .*steel.* has an unknown law; use one of neo-hookean, ogden",
    "materials.rubber.young=0": "materials.rubber.young .* is not greater than 0",
    "materials.rubber.poisson=0.5": "materials.rubber.poisson .* is not less than 0.5",
    "materials.rubber.poisson=-1.5": "materials.rubber.poisson .* is not greater than -1",
    'materials.rubber.damage={toughness=1,length="1 mm"}': "damage.length .* is shorter than two distances of nodes, 1 m",
    "domain.degree=5": "domain.degree .*5.* is not less than or equal to 4",
    "domain.cells=1": "domain.* is refused: domain.cells along x is 1; give at least 2",
    "domain.upper=1e-40": "domain along x reaches from 0 to 1e-40 m, which is 1e-40 m; give it a length from 1e-30",
    'faces.x="glued"': "faces.x.* .*glued.* is no face; use one of slip, clamped, free",
    'faces.w="slip"': "faces.w .* is not an axis; use x, y and z",
    'faces.z=["slip",{press=1.5}]': "press .*1.5.* is no part of the length that goes; give a number between 0 and 1",
    'faces.z=["slip",{press=0}]': "press .*0.* is no part of the length that goes; give a number between 0 and 1",
    'faces={x="free",y="slip",z="slip"}': 'let the body go along x; make one of x "slip", or any "clamped"',
    "faces={}": 'faces let the body go along x; make one of x "slip"',
    'faces.z=["slip"]': "faces.z .* does not fit the two faces of an axis; write one value or a pair",
    "faces.z={pull=true}": "pull .* is no part of the length that comes; give a positive number",
    'structure={kind="regions",material="iron"}': "structure.material .*iron.* is no material of the scene; use rubber",
    'structure={kind="crystals"}': "structure .*crystals.* has an unknown kind; use one of voronoi, voxels, regions",
    "points={per_axis=0}": "points.per_axis .* is not greater than or equal to 1",
    "floor_stiffness=-1": "floor_stiffness .* is not greater than or equal to 0",
    'gravity="9.81 N"': 'gravity.* has the unit "N", which is not an acceleration',
}


def given(*changes: str) -> mpm.Scene:
    data = tomllib.loads(GOOD)
    override(data, changes)
    scene = scene_from({"name": "block", **data}, "block.toml")
    assert isinstance(scene, mpm.Scene)
    return scene


@pytest.mark.mpi(ranks=2)
def test_mistakes_in_a_scene_are_one_sentence_each(comm):
    assert isinstance(given(), mpm.Scene)
    for change, sentence in MISTAKES.items():
        with pytest.raises(SceneError, match=sentence) as refused:
            given(change)
        assert "\n" not in str(refused.value)
        assert len(set(comm.allgather(str(refused.value)))) == 1


def test_keys_of_material_points_are_no_keys_of_particle_in_cell():
    assert set(mpm.Scene.model_fields) - set(Scene.model_fields) == {*OF_POINTS, "method"}
    with pytest.raises(
        SceneError, match=r"faces .* is an unknown key; it is for material points: begin the file with method"
    ):
        Scene.from_dict({"domain": {"lower": 0, "upper": 1, "cells": 8}, "faces": {}})


@pytest.mark.mpi(ranks=2)
def test_checkpoints_of_one_method_are_not_gone_on_with_by_the_other(comm, tmp_path):
    points = given()
    charges = Scene.from_dict({"domain": {"lower": 0, "upper": 1, "cells": 8}})
    for number, scene in enumerate((points, charges)):
        simulation_of(comm, scene).checkpoint(tmp_path / f"checkpoint_0000000{number}")
    with pytest.raises(InputError, match="holds material points; go on from it by a scene of theirs"):
        simulation_of(comm, charges, tmp_path / "checkpoint_00000000")
    with pytest.raises(InputError, match="is of a particle-in-cell run; go on from it by such a scene"):
        simulation_of(comm, points, tmp_path / "checkpoint_00000001")
    other = given("domain.upper=2")
    with pytest.raises(InputError, match=r"cannot go on from checkpoint .*: domain.upper is .*2.0.* instead of .*1.0"):
        simulation_of(comm, other, tmp_path / "checkpoint_00000000")
    data = points.to_dict()
    other = mpm.Scene.from_dict({**data, "materials": {"foam": data["materials"]["rubber"]}})
    with pytest.raises(InputError, match=r"materials is \['foam'\] instead of \['rubber'\]; restore that"):
        simulation_of(comm, other, tmp_path / "checkpoint_00000000")


@pytest.mark.mpi(ranks=2)
def test_voxels_must_be_labels_of_materials(comm, tmp_path):
    def run(voxels: np.ndarray | None) -> mpm.Simulation:
        if comm.rank == 0 and voxels is not None:
            np.save(tmp_path / "labels.npy", voxels)
        comm.barrier()
        file = str(tmp_path / "labels.npy")
        return mpm.Simulation(
            comm, given(f'structure={{kind="voxels",file="{file}",materials={{0="rubber",1="empty"}}}}')
        )

    with pytest.raises(SceneError, match=r"structure.file .* cannot be read .*; give a .npy of labels"):
        run(None)
    with pytest.raises(SceneError, match=r"structure.file .* cannot be read \(No data left in file\); give a .npy of"):
        (tmp_path / "labels.npy").touch()
        run(None)
    with pytest.raises(SceneError, match=r"holds float64 of shape \(2, 2, 2\); give whole numbers with three axes"):
        run(np.zeros((2, 2, 2)))
    with pytest.raises(SceneError, match=r"holds int64 of shape \(2, 2\)"):
        run(np.zeros((2, 2), dtype=int))
    with pytest.raises(SceneError, match=r"has the label 7, which means no material; add 7 to structure.materials"):
        run(np.full((2, 2, 2), 7))
    with pytest.raises(SceneError, match="the structure is empty; give it a material"):
        run(np.ones((2, 2, 2), dtype=int))
    with pytest.raises(InputError, match=r"has 0 points, .* set floor_stiffness, or fill it with a soft material"):
        run(np.arange(8).reshape(2, 2, 2) % 2)
    assert comm.allreduce(len(run(np.zeros((3, 3, 3), dtype=int)).state.placed.points)) == 8 * 64


@pytest.mark.mpi(ranks=2)
def test_too_little_memory_is_said_before_anything_is_made(comm):
    with pytest.raises(
        SceneError, match=r"points take about .* GiB of memory, and .* GiB are free; use fewer elements"
    ):
        simulation_of(comm, given("domain.cells=2000"))


@pytest.mark.mpi(ranks=2)
def test_a_load_beyond_the_smallest_step_leaves_its_last_state(comm, tmp_path):
    output = f'output.directory="{tmp_path}/run"'
    heavy = ("gravity=[0,0,-1000]", "materials.rubber.density=500", 'faces.y="free"')
    scene = given("solver.iterations=1", output, *heavy, "schedule.smallest=0.05", "schedule.steps=2")
    with pytest.raises(SolverError, match=r"no equilibrium beyond 0 of the load; steps that failed: 0 to 0.5, 0 to"):
        simulation_of(comm, scene).run(log="silent")
    again = mpm.Simulation.restart(comm, tmp_path / "run" / "checkpoint_00000000")
    assert again.state.load == 0 and (tmp_path / "run" / "points_00000000.vtkhdf").exists()


@pytest.mark.mpi(ranks=2)
def test_a_point_that_no_step_keeps_in_the_mesh_is_named(comm, tmp_path):
    """The block widens beyond its free face, however short a step is."""
    output = f'output.directory="{tmp_path}/run"'
    scene = given('faces.x=["slip","free"]', output, "schedule.smallest=0.1", "schedule.steps=2")
    history = "no equilibrium beyond 0 of the load; steps that failed: 0 to 0.5, 0 to 0.25, 0 to 0.125; the last: "
    point = r"point \d+ at \(1\.\d+, 0\.\d+, 0\.\d+\) m with det F = 0\.\d+ lies outside the mesh at 0.125 of the load"
    with pytest.raises(SolverError, match=history + point) as ended:
        simulation_of(comm, scene).run(log="silent")
    assert len(set(comm.allgather(str(ended.value)))) == 1
