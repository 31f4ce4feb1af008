"""What is read as an attribute of a run, and kept, is made by each rank alone."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import amrpic
from amrpic.parallel import traffic
from amrpic.pic.solution import Solution
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT

PACKAGE = Path(amrpic.__file__).parent
KEPT = {("pic/solution.py", "Solution", "potential"), ("pic/solution.py", "Solution", "electric")}


def kept_in(package: str) -> set[tuple[str, str, str]]:
    """File, class and name of each attribute of a package that is kept once it is made."""
    return {
        (f"{package}/{path.name}", owner.name, member.name)
        for path in (PACKAGE / package).glob("*.py")
        for owner in ast.walk(ast.parse(path.read_text()))
        if isinstance(owner, ast.ClassDef)
        for member in owner.body
        if isinstance(member, ast.FunctionDef)
        and any("cached_property" in ast.unparse(decorator) for decorator in member.decorator_list)
    }


def test_these_are_all_attributes_that_are_kept():
    assert kept_in("run") | kept_in("pic") == KEPT
    assert ("mesh/hierarchy.py", "Hierarchy", "particle_mesh") in kept_in("mesh")


@pytest.mark.mpi(ranks=(2,))
def test_no_attribute_that_is_kept_communicates(comm):
    """Of a fast bunch before a wall with a potential: with images, and a field of what the wall holds."""
    momentum = 5 * ELECTRON_MASS * SPEED_OF_LIGHT
    bunch = {"distribution": "gaussian", "species": "electron", "charge": -1e-12, "particles": 1000, "sigma": 1e-3}
    run = amrpic.Simulation(
        comm,
        amrpic.Scene.from_dict(
            {
                "domain": {
                    "lower": [-5e-3] * 3,
                    "upper": [5e-3] * 3,
                    "cells": 16,
                    "boundary": {"x": "open", "y": "open", "z": ["dirichlet", "open"]},
                    "potential": {"z": [100.0, 0.0]},
                },
                "bunches": [{**bunch, "momentum": [0, 0, momentum]}],
                "motion": {"kind": "leapfrog", "dt": 1e-13},
                "output": {"write": []},
            }
        ),
    )
    solution = run.state.solution
    assert solution.images is not None and solution.walls is not None
    assert not {"potential", "electric"} & vars(solution).keys()
    before = traffic()
    parts = [getattr(solution, name) for _, owner, name in sorted(KEPT) if owner == Solution.__name__]
    assert traffic() == before
    assert all(np.isfinite(part.max_abs()) for part in (parts[1], *parts[0].components))
