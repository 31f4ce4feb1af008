"""amrpic compare finds what differs between two runs, and by how much."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.commands.main import main
from amrpic.results.comparison import Comparison, compare


def scene(folder: Path, levels: int = 1, cells: int = 16, size: int = 16, wall: float = 0.1, **more) -> amrpic.Scene:
    return amrpic.Scene(
        domain=amrpic.Domain(-wall, wall, cells, boundary="dirichlet"),
        bunches=[amrpic.GaussianBunch(species="electron", sigma=0.01, charge="-10 pC", particles=900)],
        refinement={"levels": levels, "blocking_factor": 4, "max_grid_size": size},
        solver={"tolerance": 1e-11},
        motion=amrpic.Leapfrog(dt="50 ps"),
        schedule={"steps": 3},
        output={"directory": str(folder), "write": ["fields", "series", "checkpoint"]},
        **more,
    )


def ran(folder: Path, comm: MPI.Comm = MPI.COMM_SELF, kick: float = 0.0, **more) -> amrpic.Simulation:
    simulation = amrpic.Simulation(comm, scene(folder, **more))
    if kick:
        change = np.zeros((len(simulation.particles), 3))
        change[0, 1] = kick
        simulation.kick(change)
    simulation.run(log="silent")
    return simulation


def largest(found: Comparison, part: str) -> dict[str, float]:
    return {one.what: one.relative for one in found.parts[part]}


def status_of(capsys, *arguments: str) -> tuple[object, str]:
    with pytest.raises(SystemExit) as ended:
        main(["compare", *arguments])
    return ended.value.code, capsys.readouterr().out


def test_the_same_run_twice_is_the_same_bit_by_bit(comm, tmp_path, capsys):
    for name in "ab":
        ran(tmp_path / name)
    code, text = status_of(capsys, str(tmp_path / "a"), str(tmp_path / "b"), "--tolerance", "0")
    assert code == 0 and text.splitlines()[-1] == "results are the same within a relative tolerance of 0"
    assert [line.split()[0] for line in text.splitlines()[:2]] == ["scene", "output.directory"]
    found = compare(tmp_path / "a", tmp_path / "b")
    assert set(found.parts) == {"series", "beam", "fields", "particles"}
    assert all(one.relative == 0 for part in found.parts.values() for one in part)
    assert [key for key, _, _ in found.scenes] == ["output.directory"]


@pytest.mark.mpi(ranks=(2,), timeout=120)
def test_other_ranks_find_the_same_to_rounding(comm, tmp_path):
    ran(tmp_path / "two", comm)
    if comm.rank == 0:
        ran(tmp_path / "one")
        found = compare(tmp_path / "one", tmp_path / "two")
        assert found.equal(1e-8) and not found.equal(0)
        speed = {what: (one, two) for what, one, two in found.speed}
        assert speed["memory"][1] == amrpic.open(MPI.COMM_SELF, tmp_path / "two").series.memory.max()


def test_a_kick_shows_as_large_as_it_is(comm, tmp_path, capsys):
    one, kick = ran(tmp_path / "a"), 1e-26
    other = ran(tmp_path / "b", kick=kick)
    found = compare(tmp_path / "a", tmp_path / "b")
    apart = {
        what: np.abs(getattr(one.particles, what) - getattr(other.particles, what)).max()
        / np.sqrt(np.mean(getattr(one.particles, what) ** 2))
        for what in ("position", "momentum")
    }
    given = largest(found, "particles")
    for what, expected in apart.items():
        assert given[f"{what} over its rms"] == pytest.approx(expected, rel=1e-6) and expected > 1e-4
    difference = amrpic.open(tmp_path / "a").fields[3]
    theirs = amrpic.open(tmp_path / "b").fields[3].on(difference.hierarchy)
    for kind in ("l2", "max"):
        norm = (difference.phi - theirs.phi).norm(kind) / max(difference.phi.norm(kind), theirs.phi.norm(kind))
        assert largest(found, "fields")[f"phi in the {kind} norm"] == pytest.approx(norm, rel=1e-9) and norm > 0
    code, text = status_of(capsys, str(tmp_path / "a"), str(tmp_path / "b"))
    assert code == 1 and "particles, different" in text and "results are different" in text


def test_a_changed_number_a_missing_step_and_a_missing_column_are_found(comm, tmp_path):
    ran(tmp_path / "a")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    path = tmp_path / "b" / "series.csv"
    head, *rows = path.read_text().splitlines()
    column = head.split(",").index("rms_x")
    cells = rows[2].split(",")
    cells[column] = repr(float(cells[column]) * (1 + 1e-4))
    path.write_text("\n".join([head, rows[0], rows[1], ",".join(cells), rows[3], ""]))
    found = compare(tmp_path / "a", tmp_path / "b")
    [only] = [one for one in found.parts["series"] if one.relative > 0]
    assert only.what == "rms_x" and only.where == "at step 2" and only.relative == pytest.approx(1e-4, rel=0.1)
    assert found.equal(1e-3) and not found.equal(1e-5)
    path.write_text("\n".join([head, *rows[:3], ""]))
    missing = compare(tmp_path / "a", tmp_path / "b")
    assert missing.parts["series"][0].where == "1 of one run alone" and not missing.equal(0.9)


@pytest.mark.parametrize("other", [{"levels": 0}, {"cells": 20}, {"cells": 32, "levels": 0}])
def test_fields_on_other_meshes_are_carried_to_that_of_the_first(comm, tmp_path, capsys, other):
    ran(tmp_path / "a")
    ran(tmp_path / "b", **other)
    found = compare(tmp_path / "a", tmp_path / "b")
    assert found.remarks == [
        "the meshes of step 3 differ; fields of the second run are carried to the mesh of the first"
    ]
    mine, theirs = (amrpic.open(tmp_path / name).fields[3] for name in "ab")
    moved = theirs.phi.remap(mine.hierarchy)
    norm = (mine.phi - moved).norm("l2") / max(mine.phi.norm("l2"), moved.norm("l2"))
    assert largest(found, "fields")["phi in the l2 norm"] == pytest.approx(norm, rel=1e-12) and 1e-5 < norm < 0.2
    assert not found.equal(1e-6)
    code, text = status_of(capsys, str(tmp_path / "a"), str(tmp_path / "b"))
    assert code == 1 and f"remark: {found.remarks[0]}" in text


def test_other_boxes_are_the_same_mesh(comm, tmp_path):
    ran(tmp_path / "a")
    ran(tmp_path / "b", size=8)
    found = compare(tmp_path / "a", tmp_path / "b")
    assert not found.remarks and found.equal(1e-9)


def test_norms_alone_are_compared_on_other_domains(comm, tmp_path):
    ran(tmp_path / "a")
    ran(tmp_path / "b", wall=0.12)
    found = compare(tmp_path / "a", tmp_path / "b")
    fields = largest(found, "fields")
    assert fields["domain"] == math.inf and not found.equal(0.9)
    norms = [amrpic.open(tmp_path / name).fields[3].phi.norm("max") for name in "ab"]
    assert fields["phi in the max norm"] == pytest.approx(abs(norms[0] - norms[1]) / max(norms), rel=1e-12)


def test_what_one_of_them_did_not_write_is_left_out(comm, tmp_path):
    ran(tmp_path / "a")
    shutil.copytree(tmp_path / "a", tmp_path / "b", ignore=shutil.ignore_patterns("fields*", "checkpoint*", "beam*"))
    assert set(compare(tmp_path / "a", tmp_path / "b").parts) == {"series"}


def test_a_series_without_rows_is_one_sentence(comm, tmp_path):
    ran(tmp_path / "a")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    head, *_ = (tmp_path / "a" / "series.csv").read_text().splitlines(keepends=True)
    (tmp_path / "b" / "series.csv").write_text(head)
    with pytest.raises(amrpic.InputError, match=r"series\.csv has no rows yet; let the run make its first step"):
        compare(tmp_path / "a", tmp_path / "b")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere", "."], "nowhere does not exist; give the folder of a run"),
        ([".", "."], "series.csv cannot be read: No such file or directory"),
        ([".", ".", "--tolerance", "2"], "2 is no relative tolerance; give 0 or more, and less than 1"),
    ],
)
def test_what_cannot_be_compared_is_one_sentence(comm, tmp_path, monkeypatch, capfd, arguments, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["compare", *arguments])
    error = capfd.readouterr().err
    assert ended.value.code == 2 and message in error and error.count("\n") == 1


def test_lost_particles_are_compared_by_their_numbers(comm, tmp_path):
    pipe = amrpic.RoundAperture(name="pipe", radius="18 mm")
    for name, kick in (("a", 0.0), ("b", 0.0), ("c", 1e-21)):
        given = scene(tmp_path / name, apertures=[pipe]).replace(
            motion=amrpic.Leapfrog(dt="2 ns"), output={"directory": str(tmp_path / name), "write": ["series", "losses"]}
        )
        simulation = amrpic.Simulation(given)
        simulation.kick(np.full((len(simulation.particles), 3), kick))
        simulation.run(log="silent")
    assert len(amrpic.open(tmp_path / "a").losses) > 20
    same = compare(tmp_path / "a", tmp_path / "b")
    assert set(largest(same, "losses").values()) == {0.0} and len(same.parts["losses"]) == 4
    kicked = largest(compare(tmp_path / "a", tmp_path / "c"), "losses")
    assert kicked["lost particles"] == math.inf and 0 < kicked["time of losses over its rms"] < 10


@pytest.mark.mpi(ranks=(2,))
def test_charge_that_cancels_is_compared_with_what_cancels(comm, tmp_path):
    """Which a sum on other ranks leaves another rounding of."""
    both = [
        amrpic.GaussianBunch(species=kind, sigma=0.01, charge=charge, particles=701)
        for kind, charge in (("electron", "-10 pC"), ("proton", "10 pC"))
    ]
    for name, ranks in (("alone", MPI.COMM_SELF), ("together", comm)):
        if ranks is comm or comm.rank == 0:
            given = scene(tmp_path / name, levels=0).model_copy(update={"bunches": both})
            amrpic.Simulation(ranks, given).run(log="silent")
        comm.barrier()
    found = compare(tmp_path / "alone", tmp_path / "together")
    assert found.equal(1e-6), found.beyond(1e-6)
