"""Beam lines that cannot be meant: one sentence on all ranks at once; what is legal and odd gets one remark."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from test_bad_input import ended, refusal

SCENE = """
[domain]
lower = -0.02
upper = 0.02
cells = 8
boundary = "open"

[[bunches]]
distribution = "gaussian"
species = "electron"
sigma = "2 mm"
charge = "-1 pC"
particles = 60
momentum = [0, 0, "0.15 MeV/c"]
centre = [0, 0, "-8 mm"]

[[elements]]
kind = "quadrupole"
length = "4 mm"
gradient = "1 T/m"

[[apertures]]
kind = "round"
radius = "15 mm"

[[screens]]
name = "end"
z = "1 cm"

[motion]
kind = "leapfrog"
dt = "35 ps"

[schedule]
steps = 2

[output]
write = ["losses"]
"""

REFUSED = {
    "momentum without a unit": (["bunches.0.momentum=[0,0,0.15]"], ["bunches.0.momentum", "m c", "MeV/c"]),
    "mass of nothing": (["bunches.0.species={charge=-1.6e-19,mass=1e-300}"], ["bunches.0.momentum", "m c"]),
    "momentum twice": (["bunches.0.velocity=[0,0,3e8]"], ["bunches.0.velocity", "as well as momentum"]),
    "direction of nothing": (["elements.0.direction=[0,0,0]"], ["elements.0.direction", "points nowhere"]),
    "direction not finite": (["elements.0.direction=[0,0,inf]"], ["elements.0.direction.2", "change direction"]),
    "gradient not finite": (["elements.0.gradient=nan"], ["elements.0.gradient", "finite"]),
    "no length": (["elements.0.length=0"], ["elements.0.length", "greater than 0"]),
    "wrong unit": (["elements.0.gradient=1 T"], ["elements.0.gradient", "T/m"]),
    "no such kind": (["elements.0.kind=quadrupol"], ["elements.0", 'did you mean "quadrupole"']),
    "no such map": (["elements.0={kind='map',file='nowhere.h5'}"], ["nowhere.h5", "does not exist"]),
    "longer than its period": (
        ["domain.boundary={x='dirichlet',y='dirichlet',z='periodic'}", "elements.0.length=0.05",
         "elements.0.centre=[0,0,0.02]"],
        ["elements.0 is 0.05 m long", "repeats along z after 0.04 m", "shorten it"],
    ),
    "fringe that never falls": (
        ["elements.0.fringe=enge", "elements.0.gap=0.01", "elements.0.enge=[0,0]"], ["elements.0.enge", "does not let"]
    ),
    "a wall across a fast beam": (["domain.boundary=neumann", "background=neutralizing"], ["along z is neumann", "open"]),
    "a wall ahead of a window": (["domain.boundary=dirichlet", "motion.window=reference"], ["domain.boundary.z", "wall ahead"]),
    "a fast beam along no axis": (["bunches.0.momentum=['0.5 MeV/c',0,'0.5 MeV/c']"], ["off the", "0.1/γ"]),
    "aperture of a face's name": (["apertures.0.name=x_lower"], ["apertures.0.name", "face of the domain"]),
    "screen of a path": (["screens.0.name=../a"], ["screens.0.name", "letters"]),
    "bins of nothing": (["diagnostics.loss_bin=1e-300"], ["diagnostics.loss_bin", "longer"]),
    "a gradient beyond all": (["elements.0.gradient=1e300"], ["elements.0.gradient", "beyond all measure"]),
    "a step beyond all": (["motion.dt=1e300"], ["motion.dt", "beyond all measure"]),
    "step of nothing": (["motion.dt=0"], ["motion.dt", "greater than 0"]),
}  # fmt: skip

ODD: dict[str, tuple[list[str], str]] = {
    "screen outside": (["screens.0.z=1"], "screens.0 lies outside the domain"),
    "aperture outside": (["apertures.0.centre=[0,0,1]", "apertures.0.length=0.1"], "apertures.0 lies outside the domain"),
    "apertures that shut": (["apertures.0.radius=1 nm"], "all particles have left"),
}  # fmt: skip


def command(folder: Path, overrides: list[str]) -> list[str]:
    """A run of the scene with changes."""
    path = folder / "line.toml"
    path.write_text(SCENE)
    flags = [flag for override in overrides for flag in ("--set", override)]
    return ["run", str(path), *flags, "--output", str(folder / "out")]


@pytest.mark.mpi(ranks=2)
@pytest.mark.parametrize("name", REFUSED)
def test_beam_line_is_refused(comm: Any, tmp_path: Path, name: str) -> None:
    overrides, words = REFUSED[name]
    text = refusal(comm, *command(tmp_path, overrides))
    for word in words:
        assert word in text


@pytest.mark.mpi(ranks=2)
@pytest.mark.parametrize("name", ODD)
def test_odd_beam_line_runs_with_one_remark(comm: Any, tmp_path: Path, name: str) -> None:
    overrides, words = ODD[name]
    status, text = ended(comm, *command(tmp_path, overrides))
    assert status == 0 and words in text
    assert sum(line.startswith("warning: ") for line in text.splitlines()) == 1


@pytest.mark.mpi(ranks=2)
def test_the_beam_line_itself_runs_without_a_word(comm: Any, tmp_path: Path) -> None:
    assert ended(comm, *command(tmp_path, [])) == (0, "")
