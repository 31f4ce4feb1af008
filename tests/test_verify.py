"""The verification itself: its exact answers, and that it can fail."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from amrpic.cli import main
from amrpic.errors import InputError
from amrpic.units import VACUUM_PERMITTIVITY as EPS0
from amrpic.verify import TOPICS, verify
from amrpic.verify.hard import CASES
from amrpic.verify.meshes import MESHES
from amrpic.verify.sources import Gaussian, Layer, Plummer, Product, Sphere, Together, Wave
from amrpic.verify.table import Goal, Table

SOURCES = {
    "sphere": Sphere(0.2, (0.05, 0, 0)),
    "round": Gaussian((0.05,) * 3),
    "ellipsoid": Gaussian((0.03, 0.08, 0.2)),
    "plummer": Plummer(0.1),
    "product": Product((Wave(3.0), Layer(0.3), Wave(2.0, 1.0))),
    "pair": Together((Gaussian((0.03, 0.03, 0.1), (0.1, 0, 0)), Gaussian((0.05,) * 3, (-0.1, 0, 0), -EPS0))),
}
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_field_is_minus_the_gradient_of_the_potential(source):
    points, step = np.random.default_rng(1).uniform(-0.5, 0.5, (3, 100)), 1e-4
    for axis in range(3):
        shift = step * (np.arange(3) == axis)[:, None]
        slope = (source.potential(*(points + shift)) - source.potential(*(points - shift))) / (2 * step)
        assert source.field(*points)[axis] == pytest.approx(-slope, abs=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_mean_density_is_the_flux_out_of_the_cell(source):
    """Gauss's law for one cell, its faces integrated by quadrature."""
    centre, width = np.array([0.1, 0.05, -0.07]), 0.02
    flux = 0.0
    for axis in range(3):
        for side in (-1, 1):
            place = [c + width / 2 * n for c, n in zip(centre, np.meshgrid(*[NODES] * 3, indexing="ij"), strict=True)]
            place[axis] = np.full_like(place[axis], centre[axis] + side * width / 2)
            weight = np.ones((8, 8, 8))
            for d in range(3):
                shape = [8 if d == e else 1 for e in range(3)]
                weight = weight * (np.ones(8) / 4 if d == axis else WEIGHTS * width / 2).reshape(shape)
            flux += side * np.sum(source.field(*place)[axis] * weight) / 2
    mean = source.mean(*(np.array([c - width / 2, c + width / 2]) for c in centre))
    assert EPS0 * flux / width**3 == pytest.approx(float(np.squeeze(mean)), rel=1e-6)


@pytest.mark.parametrize("mesh", MESHES)
def test_meshes_exist_at_every_multiple_of_eight(mesh):
    for cells in (16, 24, 40):
        assert MESHES[mesh].hierarchy(MPI.COMM_SELF, cells, "dirichlet").levels == 1 + len(MESHES[mesh].levels)


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("case", ["checkerboard of blocks of 4", "level without charge", "tolerance 0", "one particle"])
def test_hard_cases_come_out_alike_on_any_number_of_ranks(comm, case):
    alone, together = (CASES[case](c) for c in (MPI.COMM_SELF, comm))
    for (what, value), (same, other) in zip(alone, together, strict=True):
        assert isinstance(value, Goal) and isinstance(other, Goal)
        assert value.met and other.met
        if "floor" not in what and "reason" not in what:
            assert what == same and other.measured == pytest.approx(value.measured, rel=1e-6)


def test_a_missed_goal_is_marked_and_fails_the_command(monkeypatch, capsys, tmp_path):
    good, bad = Goal(2.0, 1.9, least=True), Goal(float("nan"), 1e-3)
    rows: list[list[str | float | Goal]] = [["here", good], ["there", bad]]
    table = Table("Odd", "Nothing.", ("case", "value"), rows, {"here": ([8, 16], [0.1, 0.025])}, upwards="E")
    assert not table.met and good.met and not bad.met
    monkeypatch.setitem(TOPICS, "odd", lambda comm: iter([table]))
    with pytest.raises(SystemExit) as exit_:
        main(["verify", "odd", "--output", str(tmp_path)])
    assert exit_.value.code == 1
    assert "| there | nan (≤ 1.0e-03) MISSED |" in capsys.readouterr().out
    assert "MISSED" in (tmp_path / "verification.md").read_text()
    assert (tmp_path / "pictures" / "verify_odd.png").stat().st_size > 1000


def test_an_unknown_topic_is_told():
    with pytest.raises(InputError, match="knows no topic"):
        list(verify(MPI.COMM_SELF, ["everything"]))
