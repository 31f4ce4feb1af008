"""The Python of the README runs as it stands, in a folder with the examples."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_the_code_of_the_readme_runs(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    [code] = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), re.M | re.S)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(code, names)
    assert names["report"].converged
    assert names["simulation"].step == names["simulation"].scene.schedule.last_step
    assert {"step", "rms_x"} <= set(names["results"].series)
    assert (tmp_path / "runs" / "drift" / "own_far.csv").exists()
