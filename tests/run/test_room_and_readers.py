"""Before memory is taken, each rank's need is compared with its machine; files that all need are read by rank 0 alone."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

from amrpic import InputError, Scene
from amrpic.commands.arguments import scene_on_all_ranks
from amrpic.errors import SceneError
from amrpic.io import field_maps
from amrpic.parallel import from_rank_0
from amrpic.pic import limits
from amrpic.pic.memory import DRAWING, Share, base_boxes, rank_memory, run_memory
from amrpic.pic.setup import set_up
from amrpic.run import machine

PIC = {
    "domain": {"lower": -1, "upper": 1, "cells": 32},
    "bunches": [
        {"distribution": "gaussian", "species": "electron", "sigma": 0.1, "charge": "-1 pC", "particles": 1000}
    ],
    "motion": {"kind": "leapfrog", "dt": "1 ps"},
    "schedule": {"steps": 1},
}
LARGE = 10**12  # particles, of which no machine holds as many


@pytest.mark.mpi(ranks=(1, 3))
def test_the_rank_that_needs_most_is_named(comm):
    scene = Scene.from_dict(PIC)
    boxes, cells = base_boxes(scene), 32**3
    limits.require_room(comm, scene, boxes, 1000, "here")
    full = comm.size - 1
    held = Share(comm.rank, cells // comm.size, LARGE if comm.rank == full else 0)
    with pytest.raises(
        SceneError, match=f"here: rank {full} takes about .* and {LARGE} particles.* are free; use more mach"
    ):
        limits.require_room(comm, scene, boxes, LARGE, "here", held)


@pytest.mark.mpi(ranks=2)
def test_what_a_node_lacks_is_refused_though_all_have_it_together(comm, monkeypatch):
    """Each rank on a machine of its own: one machine has no room left, the other more than both need."""
    scene = Scene.from_dict(PIC)
    node = comm.Split(comm.rank)
    for module in (limits, machine):
        monkeypatch.setattr(module, "node_of", lambda comm: node)
        monkeypatch.setattr(module, "available_memory", lambda: -(2**40) if comm.rank == 1 else 2**50)
    assert machine.machine_memory(comm) > 2**49
    with pytest.raises(SceneError, match="rank 1 takes about"):
        limits.require_room(comm, scene, base_boxes(scene), 1000, "here")
    node.Free()


def test_shares_of_ranks_add_up_to_the_whole():
    scene = Scene.from_dict(PIC)
    whole = run_memory(scene, base_boxes(scene), 1000, 2)
    of_each = [rank_memory(scene, base_boxes(scene), 1000, 2, Share(rank, 32**3 // 2, 500)) for rank in range(2)]
    assert sum(of_each) == pytest.approx(sum(whole.values()), rel=1e-12)
    assert of_each[0] - of_each[1] == pytest.approx(DRAWING + whole["files"])  # rank 0 draws and writes


@pytest.mark.mpi(ranks=2)
def test_rank_0_alone_reads_the_scene_and_maps(comm, tmp_path, monkeypatch):
    calls = []
    given = field_maps.FieldMap(
        axisymmetric=False, lower=(-1.0, -1.0, -1.0), spacing=(1.0, 1.0, 1.0),
        electric=np.full((3, 3, 3, 3), 2.0), magnetic=None,
    )  # fmt: skip

    def read(file, iteration=None):
        calls.append(file)
        return given

    monkeypatch.setattr(field_maps, "read", read)
    scene = Scene.from_dict({**PIC, "elements": [{"kind": "map", "file": "nowhere.h5", "centre": [0, 0, 0]}]})
    e, _ = set_up(comm, scene).external.fields([(0.1, 0.2, 0.3)])
    assert e == pytest.approx(2.0)
    assert len(calls) == (1 if comm.rank == 0 else 0)


@pytest.mark.mpi(ranks=2)
def test_what_rank_0_cannot_read_is_refused_on_all_ranks(comm, tmp_path):
    chosen = argparse.Namespace(scene="nowhere.toml", set=(), output=None)
    with pytest.raises(SceneError, match=r"nowhere\.toml cannot be read"):
        scene_on_all_ranks(comm, chosen)

    def fail():
        raise ValueError("seven")

    with pytest.raises(InputError, match="ValueError: seven"):
        from_rank_0(comm, fail, InputError)
    assert from_rank_0(comm, lambda: comm.rank) == 0
