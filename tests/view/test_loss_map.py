"""Pictures of losses show what the map holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from amrpic.commands.main import parser
from amrpic.errors import InputError
from amrpic.io import time_series
from amrpic.io.provenance import Provenance
from amrpic.pic.loss_files import COLUMNS
from amrpic.view import loss_plots

ROWS: list[dict[str, Any]] = [
    {"cause": "pipe", "lower": 0.0, "upper": 0.5, "particles": 3, "charge": -2e-12, "energy": 4e-6},
    {"cause": "pipe", "lower": 1.0, "upper": 1.5, "particles": 1, "charge": -1e-12, "energy": 2e-6},
    {"cause": "z_upper", "lower": 1.0, "upper": 1.5, "particles": 9, "charge": -6e-11, "energy": 3e-4},
]


def test_bars_are_losses_per_length(comm, tmp_path):
    time_series.write(comm, tmp_path / "losses.csv", COLUMNS, ROWS, Provenance())
    table = time_series.read(tmp_path / "losses.csv")
    figure = loss_plots.draw(table, ["energy", "particles"])
    for panel, name, unit in zip(figure.axes, ("energy", "particles"), (1e-6, 1.0), strict=True):
        bars = [bar.get_bbox().bounds for bar in panel.patches if isinstance(bar, Rectangle)]
        values = [row[name] / 0.5 / unit for row in ROWS]
        assert np.allclose(bars, [(row["lower"], 0.0, 0.5, value) for row, value in zip(ROWS, values, strict=True)])
    assert [panel.get_yscale() for panel in figure.axes] == ["log", "linear"]


def test_the_command_draws_a_map_and_refuses_the_rest(comm, tmp_path, capsys):
    def draw(*arguments):
        chosen = parser().parse_args(["plot", str(tmp_path), "--kind", "losses", *arguments])
        assert chosen.command(chosen) == 0
        return capsys.readouterr().out.split()

    with pytest.raises(InputError, match=r"losses\.csv cannot be read"):
        draw()
    time_series.write(comm, tmp_path / "losses.csv", COLUMNS, ROWS, Provenance())
    assert draw("--quantity", "charge") == [str(tmp_path / "losses.png")]
    assert (tmp_path / "losses.png").stat().st_size > 5000
    with pytest.raises(InputError, match="a map of losses has no phi; choose among energy"):
        draw("--quantity", "phi")
    with pytest.raises(InputError, match="axis has no effect on a map of losses"):
        draw("--axis", "x")
    time_series.write(comm, tmp_path / "losses.csv", COLUMNS, [], Provenance())
    with pytest.raises(InputError, match="holds no losses to draw"):
        draw()
    time_series.write(comm, tmp_path / "losses.csv", COLUMNS[1:], ROWS, Provenance())
    with pytest.raises(InputError, match="is not a map of losses"):
        draw()
