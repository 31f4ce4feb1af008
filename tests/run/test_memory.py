"""The memory that a run is said to take, against what it takes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import mpi_batch
from amrpic import Domain, Hierarchy, PoissonSolver, Scene
from amrpic.mesh.boxes import table_of
from amrpic.pic.memory import run_memory
from examples import EXAMPLES, with_bunches
from hierarchies import all_cases

PROGRAM = str(Path(sys.executable).with_name("amrpic"))

# What a run takes over all ranks: the sum of the peaks of its processes, pictures and all.
MEASURED = """
import resource
from mpi4py import MPI
from amrpic.commands.main import main
try:
    main()
except SystemExit as end:
    assert end.code == 0
peaks = MPI.COMM_WORLD.gather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
if MPI.COMM_WORLD.rank == 0:
    print("measured", sum(peaks), "MiB")
"""


def mebibytes(pattern: str, ranks: int, *command: str) -> float:
    done = subprocess.run(
        ["mpiexec", "-n", str(ranks), sys.executable, *command],
        env=mpi_batch.ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=1800,
    )
    found = re.search(pattern + r" ([\d.]+) MiB", done.stdout)
    assert found, done.stdout + done.stderr
    return float(found[1])


def compare(scene: Path, ranks: int, folder: Path, *overrides: str) -> None:
    options = [str(scene), "--output", str(folder), *(f"--set={override}" for override in overrides)]
    said = mebibytes("about", ranks, PROGRAM, "preview", *options)
    taken = mebibytes("measured", ranks, "-c", MEASURED, "run", *options)
    print(f"\n{scene.stem} on {ranks} ranks: {said:.0f} MiB previewed, {taken:.0f} MiB taken, {said / taken - 1:+.1%}")
    assert said == pytest.approx(taken, rel=0.25)


@pytest.mark.parametrize("case", all_cases().values(), ids=lambda case: case.name)
def test_outer_faces_are_those_of_the_painted_cells(case):
    for level in range(len(case.levels) + 1):
        boxes = np.array(case.boxes(level))
        painted = np.zeros(boxes[:, 3:].max(axis=0) + 3, dtype=np.int8)
        for box in boxes:
            painted[tuple(slice(a + 1, b + 2) for a, b in zip(box[:3], box[3:], strict=True))] = 1
        expected = sum(int(np.abs(np.diff(painted, axis=axis)).sum()) for axis in range(3))
        assert table_of(boxes).outer_faces == expected


def test_compressed_rows_take_the_bytes_that_are_counted(comm):
    domain = Domain((-1, -1, -1), (1, 1, 1), (32, 32, 32), "open")
    levels = [[((16, 16, 16), (47, 47, 47))], [((48, 48, 48), (79, 79, 79))]]
    hierarchy = Hierarchy(comm, domain, levels, 16, 8)
    solver = PoissonSolver(hierarchy, backend="crs")
    scene = Scene.from_dict(
        {
            "domain": {"lower": -1, "upper": 1, "cells": 32},
            "refinement": {"levels": 2},
            "solver": {"backend": "crs"},
        }
    )
    parts = run_memory(scene, [hierarchy.boxes(level) for level in range(3)], 0, 1)
    assert solver.native.backend_bytes == pytest.approx(parts["solver"], rel=0.25)


@pytest.mark.parametrize("max_grid_size", [8, 32])
def test_the_matrix_free_solver_takes_the_bytes_that_are_counted(max_grid_size):
    domain = Domain((-1, -1, -1), (1, 1, 1), (64, 64, 64), "dirichlet")
    levels = [[((32, 32, 32), (95, 95, 95))], [((96, 96, 96), (159, 159, 159))]]
    hierarchy = Hierarchy(MPI.COMM_SELF, domain, levels, max_grid_size, 8)
    scene = Scene.from_dict({"domain": {"lower": -1, "upper": 1, "cells": 64}, "refinement": {"levels": 2}})
    parts = run_memory(scene, [hierarchy.boxes(level) for level in range(3)], 0, 1)
    taken = PoissonSolver(hierarchy).native.backend_bytes
    assert parts["solver"] == pytest.approx(taken, rel=0.25)
    assert taken <= 15 * sum(hierarchy.cells(level) for level in range(3))


def test_each_fit_in_a_gap_is_held_once_and_with_the_cells_that_it_weighs():
    """Of blocks scattered at random each coarse cell has surroundings of its own: a fit for each axis, of about half the 168
    fine cells within reach. Once residual and cycle had fits of their own, with all cells around: 29 kB per coarse cell."""
    mask = np.random.default_rng(1).random((12,) * 3) < 0.5
    boxes = [((2 * i, 2 * j, 2 * k), (2 * i + 1, 2 * j + 1, 2 * k + 1)) for i, j, k in np.argwhere(mask).tolist()]
    hierarchy = Hierarchy(MPI.COMM_SELF, Domain(0, 1, 12, "dirichlet"), [boxes], 16, 2)
    taken = PoissonSolver(hierarchy).native.backend_bytes
    coarse = mask.size - len(boxes)
    assert taken <= 3 * 84 * 40 * coarse + 4000 * len(boxes)


@pytest.mark.parametrize(
    ("upper", "stretch"), [((0, 0, 15), (1, 1, 1)), ((0, 15, 15), (1, 1, 1)), ((0, 0, 1), (1, 1, 12))]
)
def test_levels_with_long_cells_take_the_bytes_that_are_counted(comm, upper, stretch):
    """Such levels are coarsened by themselves, and so is the base below it along its short axes first."""
    reach = tuple(float(1 + u) for u in upper)
    domain = Domain((-1, -1, -1), reach, (32, 32, 32), "open")
    hierarchy = Hierarchy(comm, domain, [[((16, 16, 16), (47, 47, 47))]], 16, 8)
    solver = PoissonSolver(hierarchy, stretch=stretch, backend="crs")
    scene = Scene.from_dict(
        {
            "domain": {"lower": -1, "upper": reach, "cells": 32},
            "refinement": {"levels": 1},
            "solver": {"stretch": stretch, "backend": "crs"},
        }
    )
    parts = run_memory(scene, [hierarchy.boxes(level) for level in range(2)], 0, 1)
    assert solver.native.backend_bytes == pytest.approx(parts["solver"], rel=0.25)


def test_a_short_run_takes_the_memory_that_its_preview_tells(tmp_path):
    compare(EXAMPLES / "cathode.toml", 2, tmp_path, "schedule.steps=2")


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("path", with_bunches(), ids=lambda path: path.stem)
def test_every_example_takes_the_memory_that_its_preview_tells(tmp_path, path, ranks):
    # Nothing is new after the first steps of a mesh that stays.
    static = Scene.from_toml(path).refinement.regrid_every == 0
    compare(path, ranks, tmp_path, *(["schedule.solves=10"] if static else []))
