"""The benchmark of the solver's menu: it runs, writes its table, and finds a row that does not hold."""

from __future__ import annotations

import subprocess

import pytest

import mpi_batch
from measuring import RUNNER
from solvers import Measured, Table, document

pytestmark = pytest.mark.long  # what is tested is a tool, which users do not meet: for `make verify`


def test_quick_run_converges_or_refuses_in_every_row(tmp_path):
    output = tmp_path / "solvers.md"
    command = [*RUNNER, "solvers", "--quick", "--ranks", "2", "--output", str(output)]
    done = subprocess.run(command, env=mpi_batch.ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    text = output.read_text()
    for heading in ("## static 64, 2 ranks", "## ten_bunches, 2 ranks", "## 1:1:10, 2 ranks"):
        assert heading in text
    assert text.count("refused: relaxation is 0.8, which has no meaning for chebyshev") == 3
    assert "not converged" not in text


def test_a_row_that_does_not_hold_is_reported():
    good, off, stuck, refused = (
        Measured("", {}, converged=True, difference=1e-9),
        Measured("", {}, converged=True, difference=1e-6),
        Measured("", {}, converged=False),
        Measured("", {}, refused="it cannot work; do without"),
    )
    assert [row.sound for row in (good, off, stuck, refused)] == [True, False, False, True]
    text = document([Table("static 64", 1, [8], 1e-3, [good, stuck, refused])])
    assert "0 (not converged)" in text and "refused: it cannot work; do without" in text
