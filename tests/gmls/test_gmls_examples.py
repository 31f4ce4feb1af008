"""The examples run, and the errors that they print fall."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def printed(script: str, *arguments: str) -> list[list[float]]:
    command = [sys.executable, str(EXAMPLES / script), *arguments]
    out = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300).stdout
    return [[float(word) for word in line.split()] for line in out.splitlines()[1:]]


@pytest.mark.parametrize("order", [2, 3])
def test_errors_on_a_cloud_fall(order):
    rows = printed("gmls_cloud.py", "--order", str(order))
    assert rows[0][2] > 2 ** (order - 0.5) * rows[2][2]
    assert rows[0][3] > 2 ** (order - 1.5) * rows[2][3]


def test_errors_on_a_surface_fall_and_the_picture_is_written(tmp_path):
    rows = printed("gmls_surface.py", "--picture", str(tmp_path / "curvature.png"))
    assert rows[0][1] > 8 * rows[1][1] > 64 * rows[2][1]
    assert rows[0][2] > 8 * rows[1][2] > 64 * rows[2][2]
    assert (tmp_path / "curvature.png").stat().st_size > 10000


def test_weights_across_a_face_are_those_of_a_derivative(tmp_path):
    rows = printed("gmls_mesh.py", "--picture", str(tmp_path / "weights.png"))
    x, _, width, weight = np.array(rows).T
    assert set(width) == {0.5, 1.0}
    assert weight[x > 8].sum() > 0 > weight[x < 8].sum()
    assert (tmp_path / "weights.png").stat().st_size > 10000


def test_errors_on_a_cloud_are_drawn(tmp_path):
    printed("gmls_cloud.py", "--picture", str(tmp_path / "errors.png"))
    assert (tmp_path / "errors.png").stat().st_size > 10000


def test_a_density_keeps_its_integral_and_with_bounds_its_range(tmp_path):
    before, free, held = printed("fields_between_meshes.py", "--picture", str(tmp_path / "planes.png"))
    assert max(abs(free[0] - 1), abs(held[0] - 1)) < 1e-14
    assert free[1] < before[1] - 0.05 and free[2] > before[2] + 0.05
    assert before[1] <= held[1] and held[2] <= before[2]
    assert (tmp_path / "planes.png").stat().st_size > 10000
