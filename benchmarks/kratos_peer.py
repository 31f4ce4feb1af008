"""A load step of Kratos's material points, a peer of amrpic.mpm that may not be there. A worker of `points`.

A block of degree 1 between walls without friction under its own weight, its top free: points at Gauss's places with their
volumes as weights. Kratos runs in a process of its own, on one thread.
"""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Block:
    """Lengths from the origin in m, elements, points of an element along an axis; Pa, kg/m³, m/s² downwards."""

    size: Sequence[float]
    cells: Sequence[int]
    per_axis: int
    young: float
    poisson: float
    density: float
    gravity: float
    tolerance: float = 1e-10


@dataclass(frozen=True)
class Step:
    """Places (n, 3) and volumes (n,) of points; places of nodes (m, 3) and their displacement, all in m; Newton's iterations
    and the seconds of a thread that they took."""

    position: np.ndarray
    volume: np.ndarray
    nodes: np.ndarray
    displacement: np.ndarray
    iterations: int
    seconds: float


def there_is() -> bool:
    """Return whether Kratos is installed."""
    return importlib.util.find_spec("KratosMultiphysics") is not None


def first_step(block: Block) -> Step:
    """Return what Kratos makes of a block in one step."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "step.npz"
        # Kratos reads the last option itself: it would take the launcher's variables for an MPI run of its own.
        subprocess.run(
            [sys.executable, __file__, json.dumps(asdict(block)), str(out), "--not-using-mpi"],
            cwd=folder,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            check=True,
        )
        with np.load(out) as found:
            values = {name: found[name] for name in found.files}
    return Step(**{**values, "iterations": int(values["iterations"]), "seconds": float(values["seconds"])})


# ---- in the other process ----


def _nodes(block: Block) -> np.ndarray:
    axes = [np.linspace(0, length, n + 1) for length, n in zip(block.size, block.cells, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)


def _model_part(block: Block, kind: str, properties: int, parts: Mapping[str, Sequence[int]]) -> str:
    """A mesh as Kratos reads it; `parts` are the numbers of nodes of submodel parts, of all elements where there are none."""
    nx, ny, nz = block.cells
    lines = [
        "Begin ModelPartData",
        "End ModelPartData",
        f"Begin Properties {properties}",
        "End Properties",
        "Begin Nodes",
    ]
    lines += [f"{n + 1} {x!r} {y!r} {z!r}" for n, (x, y, z) in enumerate(_nodes(block).tolist())]
    lines += ["End Nodes", f"Begin Elements {kind}"]
    row, layer = nx + 1, (nx + 1) * (ny + 1)
    for number, (k, j, i) in enumerate(itertools.product(range(nz), range(ny), range(nx)), start=1):
        first = 1 + i + row * j + layer * k
        base = [first, first + 1, first + row + 1, first + row]
        lines.append(" ".join(map(str, [number, properties, *base, *(n + layer for n in base)])))
    lines.append("End Elements")
    for name, nodes in parts.items():
        lines += [f"Begin SubModelPart {name}", "Begin SubModelPartNodes", *map(str, nodes), "End SubModelPartNodes"]
        if not nodes:
            lines += ["Begin SubModelPartElements", *map(str, range(1, nx * ny * nz + 1)), "End SubModelPartElements"]
        lines.append("End SubModelPart")
    return "\n".join(lines) + "\n"


def _settings(block: Block) -> dict[str, Any]:
    def fixed(axis: int) -> dict[str, Any]:
        return {
            "python_module": "assign_vector_variable_process",
            "kratos_module": "KratosMultiphysics",
            "Parameters": {
                "model_part_name": f"Background_Grid.across_{axis}",
                "variable_name": "DISPLACEMENT",
                "constrained": [axis == d for d in range(3)],
                "value": [0.0 if axis == d else None for d in range(3)],
                "interval": [0.0, "End"],
            },
        }

    gravity = {
        "python_module": "assign_gravity_to_material_point_process",
        "kratos_module": "KratosMultiphysics.MPMApplication",
        "Parameters": {"model_part_name": "MPM_Material", "modulus": block.gravity, "direction": [0.0, 0.0, -1.0]},
    }
    return {
        "problem_data": {
            "problem_name": "block",
            "parallel_type": "OpenMP",
            "echo_level": 0,
            "start_time": 0.0,
            "end_time": 1.0,
        },
        "solver_settings": {
            "solver_type": "static",
            "model_part_name": "MPM_Material",
            "domain_size": 3,
            "echo_level": 0,
            "analysis_type": "non_linear",
            "time_stepping": {"time_step": 1.1},
            "model_import_settings": {"input_type": "mdpa", "input_filename": "body"},
            "grid_model_import_settings": {"input_type": "mdpa", "input_filename": "grid"},
            "material_import_settings": {"materials_filename": "materials.json"},
            "convergence_criterion": "residual_criterion",
            "residual_relative_tolerance": block.tolerance,
            "residual_absolute_tolerance": 1e-300,
            "max_iteration": 30,
            "problem_domain_sub_model_part_list": ["body"],
            "processes_sub_model_part_list": [f"across_{axis}" for axis in range(3)],
            "linear_solver_settings": {"solver_type": "amgcl", "tolerance": block.tolerance, "max_iteration": 1000},
        },
        "processes": {
            "constraints_process_list": [fixed(axis) for axis in range(3)],
            "list_other_processes": [gravity],
        },
        "output_processes": {},
    }


def _materials(block: Block) -> dict[str, Any]:
    variables = {
        "MATERIAL_POINTS_PER_ELEMENT": block.per_axis**3,
        "DENSITY": block.density,
        "YOUNG_MODULUS": block.young,
        "POISSON_RATIO": block.poisson,
    }
    law = {"name": "HyperElasticNeoHookean3DLaw"}
    one = {"constitutive_law": law, "Variables": variables, "Tables": {}}
    return {"properties": [{"model_part_name": "Initial_MPM_Material.body", "properties_id": 1, "Material": one}]}


def _run(block: Block, out: Path) -> None:
    kratos: Any = importlib.import_module("KratosMultiphysics")
    of_points: Any = importlib.import_module("KratosMultiphysics.MPMApplication")
    analyses: Any = importlib.import_module("KratosMultiphysics.MPMApplication.mpm_analysis")

    places = _nodes(block)
    walls = {
        f"across_{axis}": (
            1 + np.flatnonzero((places[:, axis] == 0) | ((places[:, axis] == block.size[axis]) & (axis < 2)))
        ).tolist()
        for axis in range(3)
    }
    Path("grid.mdpa").write_text(_model_part(block, "Element3D8N", 0, walls))
    Path("body.mdpa").write_text(_model_part(block, "MPMUpdatedLagrangian3D8N", 1, {"body": []}))
    Path("materials.json").write_text(json.dumps(_materials(block)))

    analysis = analyses.MpmAnalysis(kratos.Model(), kratos.Parameters(json.dumps(_settings(block))))
    analysis.Initialize()
    solver = analysis._GetSolver()
    grid, material = solver.GetGridModelPart(), solver.GetComputingModelPart()
    info = material.ProcessInfo

    def of(element: Any, variable: Any) -> Any:
        return element.CalculateOnIntegrationPoints(variable, info)[0]

    position = np.array([list(of(e, of_points.MP_COORD)) for e in material.Elements])
    volume = np.array([of(e, of_points.MP_VOLUME) for e in material.Elements])
    analysis.time = solver.AdvanceInTime(analysis.time)
    analysis.InitializeSolutionStep()
    solver.Predict()
    start = time.thread_time()
    solver.SolveSolutionStep()
    seconds, iterations = time.thread_time() - start, info[kratos.NL_ITERATION_NUMBER]
    nodes = np.array([[n.X0, n.Y0, n.Z0] for n in grid.Nodes])
    moved = np.array([list(n.GetSolutionStepValue(kratos.DISPLACEMENT)) for n in grid.Nodes])
    np.savez(
        out, position=position, volume=volume, nodes=nodes, displacement=moved, iterations=iterations, seconds=seconds
    )


if __name__ == "__main__":
    _run(Block(**json.loads(sys.argv[1])), Path(sys.argv[2]))
