"""What users read of elements at points, and that nobody else loads them."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import fem, mpm
from amrpic.verify.table import Goal
from exact.press import exact_stress
from verify import operators
from verify.operators import SOLUTIONS, difference, errors, exact, orders, source

ROOT = Path(__file__).parents[2]


def test_the_page_runs():
    block, of_solids = re.findall(
        r"```python\n(.*?)```", (ROOT / "docs" / "mpm.md").read_text(encoding="utf-8"), re.DOTALL
    )
    seen: dict[str, Any] = {}
    exec(block, seen)
    assert seen["u"].max() == pytest.approx(0.0562, rel=0.01)  # of -Δu = 1 in the unit cube, at its centre
    exec(of_solids, seen)
    assert seen["stress"][:, 2, 2] == pytest.approx(exact_stress(seen["rubber"], 0.96)[0], rel=1e-6)


def test_public_names_have_docstrings():
    for package, name in [*((fem, name) for name in fem.__all__), *((mpm, name) for name in mpm.__all__)]:
        thing = getattr(package, name)
        if not (inspect.isclass(thing) or callable(thing)):
            continue
        assert inspect.getdoc(thing), name
        for key, member in vars(thing).items() if inspect.isclass(thing) else ():
            if not key.startswith("_") and (inspect.isfunction(member) or isinstance(member, property)):
                assert inspect.getdoc(getattr(thing, key)), f"{name}.{key}"


def test_particle_in_cell_loads_no_elements():
    loads = "import sys, amrpic, amrpic.commands.main, amrpic.commands.run, amrpic.pic.simulation, amrpic.io.checkpoint"
    done = subprocess.run(
        [sys.executable, "-c", f"{loads}; print([m for m in sys.modules if m.startswith(('amrpic.fem', 'amrpic.mpm'))])"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == "[]"


# ---- the verification itself ----


@pytest.mark.parametrize("solution", SOLUTIONS)
def test_sources_are_minus_the_laplacian_of_solutions_that_vanish_on_the_surface(solution):
    x, step = np.random.default_rng(1).uniform(0.1, 0.9, (50, 3)), 1e-3
    for components in (1, 3):
        sides = [exact(solution, x + sign * step * axis, components) for axis in np.eye(3) for sign in (1, -1)]
        laplacian = (np.sum(sides, axis=0) - 6 * exact(solution, x, components)) / step**2
        assert difference(-laplacian, source(solution, x, components)) < 1e-4
        for face in (0.0, 1.0):
            on_face = np.where(np.arange(3) == 1, face, x)
            assert np.abs(exact(solution, on_face, components)).max() < 1e-14


@pytest.mark.mpi(ranks=(1, 2))
def test_orders_are_those_of_their_elements_and_volumes_lose_them(comm):
    found = orders(comm, "smooth", 2, fem.gauss, ["BP3"])
    assert found["BP3"][0] > 2.8
    coarse, fine = (errors(comm, "smooth", 1, n, fem.gauss, ["BP1"])["BP1"] for n in (8, 16))
    assert coarse > 3 * fine

    def of(weights):
        return orders(comm, "smooth", 3, lambda mesh: fem.uniform(mesh, 6, weights=weights), ["BP3"])["BP3"][0]

    assert of("moments") > 3.8 and of("volume") < 1.5


def test_a_wrong_operator_is_found(monkeypatch):
    row = operators._beside_dense(MPI.COMM_SELF, 2, fem.Poisson)
    assert all(cell.met for cell in row[2:] if isinstance(cell, Goal))
    monkeypatch.setattr(
        operators, "matrix", lambda points, kind: 1.0001 * np.eye(operators.rows_at(points)[0].shape[1])
    )
    again = operators._beside_dense(MPI.COMM_SELF, 2, fem.Poisson)
    assert not all(cell.met for cell in again[2:] if isinstance(cell, Goal))
