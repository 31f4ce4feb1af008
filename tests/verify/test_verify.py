"""The verification itself: its exact answers, and that it can fail."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import get_args

import numpy as np
import pytest
from mpi4py import MPI

from amrpic.commands.main import main
from amrpic.errors import InputError
from amrpic.pic.initial_particles import make_particles
from amrpic.scene import solver_options
from amrpic.scene.scene import Scene
from amrpic.units import VACUUM_PERMITTIVITY as EPS0
from amrpic.verify import pareto, write
from amrpic.verify.described import ChargedCylinder, DisplacedLattice, density_of, exact_field
from amrpic.verify.table import Goal, Table
from exact.meshes import MESHES
from exact.sources import Gaussian, Layer, Plummer, Product, Sphere, Together, Wave
from examples import EXAMPLES, with_bunches
from verify import TOPICS, backends, conservation, convergence
from verify.curves import Curves
from verify.hard import CASES

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
def test_hard_cases_come_out_the_same_on_any_number_of_ranks(comm, case):
    alone, together = (CASES[case](c) for c in (MPI.COMM_SELF, comm))
    for (what, value), (same, other) in zip(alone, together, strict=True):
        assert isinstance(value, Goal) and isinstance(other, Goal)
        assert value.met and other.met
        if "floor" not in what and "reason" not in what:
            # At tolerance 0 cycles end where rounding does, which depends on how sums are cut; nowhere else.
            near = 1 if case == "tolerance 0" and "cycles" in what else 0
            assert what == same and other.measured == pytest.approx(value.measured, rel=1e-6, abs=near)


def test_a_missed_goal_is_marked_and_fails_the_command(monkeypatch, capsys, tmp_path):
    good, bad = Goal(2.0, 1.9, least=True), Goal(float("nan"), 1e-3)
    rows: list[list[str | float | Goal]] = [["here", good], ["there", bad]]
    table = Curves("Odd", "Nothing.", ("case", "value"), rows, "E", curves={"here": ([8, 16], [0.1, 0.025])})
    assert not table.met and good.met and not bad.met
    monkeypatch.setattr(pareto, "tables", lambda *_: iter([table]))
    with pytest.raises(SystemExit) as exit_:
        main(["verify", str(EXAMPLES / "drift.toml"), "--output", str(tmp_path)])
    assert exit_.value.code == 1
    output = capsys.readouterr().out
    assert "| there | nan (≤ 1.0e-03) MISSED |" in output and output.endswith("goals are missed in Odd\n")
    assert "MISSED" in (tmp_path / "verification.md").read_text()
    assert (tmp_path / "pictures" / "verify_odd.png").stat().st_size > 1000


def test_what_was_not_measured_now_stays_in_the_document(tmp_path):
    tables = {title: Table(title, "About it.", ("case", "value"), [["here", 1.0]]) for title in ("One", "Two")}
    write(tables.values(), tmp_path)
    text = write([replace(tables["Two"], rows=[["there", 2.0]])], tmp_path).read_text()
    assert text.index("## One") < text.index("## Two") and text.count("## ") == 2
    assert "| here | 1     |" in text and "| there | 2     |" in text


# ---- the same tables on any number of ranks ----

ROUNDING = 1e-9  # what is smaller may be nothing but rounding
OF_THIS_RUN = ("memory", "floor", "reason", "tolerance 0")  # rows that show a process or rounding, not a solution


def value(cell):
    return cell.measured if isinstance(cell, Goal) else float(cell)


def assert_same(found, wanted, rel):
    assert found.title == wanted.title and len(found.rows) == len(wanted.rows)
    for row, expected in zip(found.rows, wanted.rows, strict=True):
        if any(isinstance(cell, str) and word in cell for cell in row for word in OF_THIS_RUN):
            continue
        for cell, other in zip(row, expected, strict=True):
            assert cell == other or value(cell) == pytest.approx(value(other), rel=rel, abs=ROUNDING), (
                found.title,
                expected[0],
            )


def some_of_convergence(comm):
    cases = dict(convergence._faces())
    names = ("smooth, Neumann", "smooth, periodic along x", "boundary layer, Dirichlet and Neumann")
    yield convergence._table(comm, "Faces", "", {name: replace(cases[name], cells=(16, 24)) for name in names})


def some_of_conservation(comm):
    yield from itertools.islice(conservation.tables(comm), 1)


Tables = Callable[[MPI.Comm], Iterator[Table]]
SOME: dict[str, Tables] = {"convergence": some_of_convergence, "conservation": some_of_conservation}
ALL: dict[str, Tables] = {
    **{
        name: TOPICS[name]
        for name in ("open-boundary", "self-force", "stopping", "conservation", "hard-cases", "backends")
    },
    "convergence": partial(convergence.tables, resolutions=2),
}


WHOLE = [pytest.param(topic, tables, id=f"all of {topic}", marks=pytest.mark.long) for topic, tables in ALL.items()]


@pytest.mark.mpi(ranks=(3,), timeout=120)
@pytest.mark.parametrize(("topic", "tables"), [*SOME.items(), *WHOLE])
def test_tables_are_the_same_on_one_two_and_three_ranks(comm, topic, tables):
    """The first rank by itself and, at the same time, the two others together; then all three."""
    apart = list(tables(comm.Split(comm.rank > 0)))
    together = list(tables(comm))
    assert len(apart) == len(together)
    for found, wanted in zip(apart, together, strict=True):
        # a solve that stops at a tenth of an error is reported apart by the rounding of its single-precision corrections
        assert_same(found, wanted, 1e-3 if topic == "stopping" else 1e-4)


# ---- backends ----


@pytest.mark.mpi(ranks=1, more=(2,))
def test_backends_are_compared_as_soon_as_there_are_two(comm):
    found = list(backends.tables(comm))
    assert len(found) == len(get_args(solver_options.Backend)) - 1
    assert all(table.met and len(table.rows) == 4 * len(MESHES) for table in found)


# ---- speed against error ----


WITHOUT_FORMULA = {"fodo": "waterbag", "halo": "thermal"}  # examples, and their distribution


@pytest.mark.parametrize("name", WITHOUT_FORMULA)
def test_a_density_without_a_formula_is_refused(name):
    with pytest.raises(InputError, match=f"is a {WITHOUT_FORMULA[name]} bunch, whose density has no formula here"):
        density_of(Scene.from_toml(EXAMPLES / f"{name}.toml"))


@pytest.mark.parametrize(
    "path",
    [path for path in with_bunches() if path.stem not in WITHOUT_FORMULA and Scene.from_toml(path).bunches],
    ids=lambda path: path.stem,
)
def test_density_of_an_example_is_that_of_its_particles(path):
    """Charge and second moments of cells all over the domain, against those of the particles: within five standard errors."""
    scene = Scene.from_toml(path)
    edges = [np.linspace(a, b, 65) for a, b in zip(scene.domain.lower, scene.domain.upper, strict=True)]
    volume = np.prod([np.diff(e)[0] for e in edges])
    charge = density_of(scene).mean(*edges) * volume
    particles = make_particles(MPI.COMM_SELF, scene)
    weight = particles.weight * particles.charge
    assert charge.sum() == pytest.approx(weight.sum(), rel=1e-4)
    centres = [(e[1:] + e[:-1]) / 2 for e in edges]
    for axis in range(3):
        share = charge.sum(axis=tuple({0, 1, 2} - {axis})) / charge.sum()
        counts = np.histogram(particles.position[:, axis], edges[axis], weights=weight / weight.sum())[0]
        assert np.abs(share - counts).max() < 5 / np.sqrt(len(particles)) * np.sqrt(share.max()), axis
        assert share @ centres[axis] == pytest.approx(counts @ centres[axis], abs=0.01 * np.ptp(edges[axis]))


def test_field_of_shifted_sheets_obeys_gauss():
    lattice = DisplacedLattice((0, 0, 0), (1, 1, 1), (0.05, 0, 0), (2, 1, 1), EPS0)
    x = np.linspace(0.0, 1.0, 41)
    y = np.array([0.0, 1.0])
    flux = lattice.field(x[:, None, None], np.zeros((1, 1, 1)), np.zeros((1, 1, 1)))[0].ravel()
    density = lattice.mean(x, y, y).ravel()
    assert np.diff(flux) == pytest.approx((density / EPS0 - 1) * np.diff(x), abs=1e-13)
    assert np.ptp(density) > 0.5 * EPS0


def test_cylinder_holds_its_charge_whatever_the_cells():
    for normal in (False, True):
        cylinder = ChargedCylinder((0.04, 0.06, 0.1), (0.5, 0.45, 0.5), 3.0, normal)
        edges = [np.linspace(-1, 2, 301)] * 3
        density = cylinder.mean(*edges)
        assert density.sum() * 1e-6 == pytest.approx(3.0, rel=1e-4)
        middle = density[150, 145, 150]
        expected = 3.0 / (np.pi * 0.08 * 0.12) / (np.sqrt(2 * np.pi) * 0.1 if normal else 2 * np.sqrt(3) * 0.1)
        assert middle == pytest.approx(expected, rel=2e-3)


def test_scenes_without_a_formula_are_refused():
    domain = {"lower": -1, "upper": 1, "cells": 16}
    bunch = {"distribution": "waterbag", "sigma": 0.1, "charge": 1e-9, "particles": 100}
    for bunches, reported in (
        ([], "has no bunches"),
        ([bunch], "bunches.0 is a waterbag bunch, whose density has no formula"),
        ([{**bunch, "distribution": "gaussian", "sigma": 0}], "bunches.0 has zero size"),
    ):
        with pytest.raises(InputError, match=reported):
            density_of(Scene.from_dict({"domain": domain, "bunches": bunches}))


def test_no_exact_field_is_claimed_between_metal_walls():
    bunch = {"distribution": "gaussian", "sigma": 0.1, "charge": 1e-9, "particles": 100}
    for boundary, known in (("open", True), ("dirichlet", False)):
        domain = {"lower": -1, "upper": 1, "cells": 16, "boundary": boundary}
        scene = Scene.from_dict({"domain": domain, "bunches": [bunch]})
        assert (exact_field(scene, density_of(scene)) is not None) == known


def measured(cells, cycles, error, left=0.0):
    setting = pareto.Setting((8, 8, 8), 0, 32, 2, "discretization", False)
    return pareto.MeasuredSetting(setting, cells, cycles, 0.0, 0.0, error, left)


def test_frontier_holds_what_nothing_beats():
    cheap, dear, beaten, spoilt = (
        measured(10, 1, 0.1),
        measured(10, 4, 0.01),
        measured(10, 9, 0.05),
        measured(1, 1, 0.001, 0.5),
    )
    found = [dear, beaten, cheap, spoilt]
    assert pareto.frontier(found) == [cheap, dear]
    assert pareto.loss(dear, found) == 1
    assert pareto.loss(beaten, found) == 2.0  # (90 - 10) / 40, or 0.05 / 0.01: the lesser
    assert pareto.loss(measured(10, 2, 0.1), found) == 1  # one cycle is spared


@pytest.mark.mpi(ranks=2, more=(1,), timeout=120)
def test_speed_against_error_of_a_scene(comm, tmp_path):
    scene = Scene.from_toml(
        EXAMPLES / "drift.toml", ["bunches.0.particles=5000", "domain.cells=16", "refinement.levels=1"]
    )
    (table,) = pareto.tables(comm, scene, quick=True)
    columns = dict(zip(table.columns, zip(*table.rows, strict=True), strict=True))
    levels, error = (np.array([value(cell) for cell in columns[name]]) for name in ("levels", "E error"))
    assert table.met and any(isinstance(cell, Goal) for cell in columns["frontier"])
    assert error[levels == 2].min() < 0.5 * error[levels == 0].min()
    if comm.rank == 0:
        path = write([table], tmp_path)
        assert "(pictures/verify_speed_against_error_drift.png)" in path.read_text()
        assert (tmp_path / "pictures" / "verify_speed_against_error_drift.png").stat().st_size > 1000


@pytest.mark.mpi(ranks=1, more=(2,), timeout=120)
def test_a_scene_of_order_4_is_measured_in_both_orders(comm, tmp_path):
    scene = Scene.from_dict(
        {
            "name": "smooth",
            "domain": {"lower": -1, "upper": 1, "cells": 32, "boundary": "open"},
            "bunches": [{"distribution": "gaussian", "sigma": 0.15, "charge": "1 nC", "particles": 2000}],
            "refinement": {"levels": 0},
            "solver": {"order": 4},
        }
    )
    by_setting, both = pareto.tables(comm, scene, quick=True)
    assert set(dict(zip(by_setting.columns, zip(*by_setting.rows, strict=True), strict=True))["order"]) == {2, 4}
    assert [row[0] for row in both.rows] == ["16×16×16", "32×32×32"]
    second, fourth = (np.array([value(row[column]) for row in both.rows]) for column in (2, 4))
    assert second[0] / second[1] < 5 < fourth[0] / fourth[1]
    if comm.rank == 0:
        write([both], tmp_path)
        assert (tmp_path / "pictures" / "verify_order_4_and_order_2_smooth.png").stat().st_size > 1000
