"""Checkpoints: nothing is lost, nothing is half there, and any number of ranks can go on from them."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest

from amrpic.errors import InputError, OutputError
from amrpic.io import atomic_files, checkpoint, checkpoint_folder, writer_ranks
from amrpic.io.checkpoint import STATE, Header, Snapshot, UnreadableCheckpoint
from amrpic.io.provenance import Provenance
from amrpic.io.writer_ranks import Writers
from amrpic.mesh.boxes import cells_of
from full_disk import file_size_limit

DOMAIN = {"lower": [-0.15, -0.15, -0.3], "upper": [0.15, 0.15, 0.3], "cells": [16, 16, 16]}
SCENE = {"solver": {"tolerance": 1e-10}, "bunches": [{"sigma": 0.1 + 0.2}]}


def boxes_of(level: int) -> np.ndarray:
    """Boxes of several sizes, 3 (level + 2) of them."""
    n = np.arange(3 * (level + 2))
    lower = np.stack([8 * n, 8 * (n % 2), 0 * n], axis=1)
    return np.concatenate([lower, lower + np.stack([7 + 0 * n, 3 + n % 3, 3 + n % 2], axis=1)], axis=1)


def cell_values(boxes: np.ndarray, level: int) -> np.ndarray:
    """Values that tell each cell of each box of each level from all others."""
    return np.concatenate([level + 10.0 * b + np.arange(c) / 3e4 for b, c in enumerate(cells_of(boxes))])


def snapshot(ranks: int, rank: int, step: int = 7, per_rank: int = 50) -> Snapshot:
    """A state on 3 levels; rank 1 owns no cells of level 0 and holds no particles."""
    boxes = [boxes_of(level) for level in range(3)]
    owners = [(np.arange(len(b)) * 5 + level) % ranks for level, b in enumerate(boxes)]
    owners[0][owners[0] == 1] = 0
    phi = []
    for level, (b, o) in enumerate(zip(boxes, owners, strict=True)):
        phi.append(cell_values(b, level)[np.repeat(o == rank, cells_of(b))])
    random = np.random.default_rng(rank)
    count = 0 if rank == 1 else per_rank + rank
    buffer = random.normal(size=(3, count + 17))
    particles = {
        "position": buffer[:, :count].T,  # as Particles hold it: a view of a longer structure of arrays
        "momentum": random.normal(size=(count, 3)),
        "weight": random.random(count),
        "id": 1000 * rank + random.permutation(count).astype(np.uint64),
    }
    lost = {"id": np.arange(rank, dtype=np.uint64), "time": np.full(rank, 0.1 * rank)}
    header = Header(step, 0.1 * step, DOMAIN, boxes, owners, Provenance(SCENE, "0.1.0", 42), {"charge": -1.602e-19})
    return Snapshot(header, {"phi": phi}, {"particles": particles, "lost": lost})


def assert_same(a: Snapshot, b: Snapshot) -> None:
    """Bit for bit, in the same order."""
    assert (a.header.step, a.header.time, a.header.about) == (b.header.step, b.header.time, b.header.about)
    assert (a.header.domain, a.header.extra) == (b.header.domain, b.header.extra)
    for left, right in zip(a.header.boxes, b.header.boxes, strict=True):
        np.testing.assert_array_equal(left, right)
    for name in a.fields:
        for left, right in zip(a.fields[name], b.fields[name], strict=True):
            np.testing.assert_array_equal(left, right)
    for table, columns in a.tables.items():
        for column, values in columns.items():
            np.testing.assert_array_equal(values, b.tables[table][column])
            assert values.dtype == b.tables[table][column].dtype


def everything(comm, state: Snapshot) -> tuple[dict, dict]:
    """Return all cells of all levels by box, and all table rows in the order of ranks, on every rank."""
    cells: dict[tuple[int, int], np.ndarray] = {}
    header = state.header
    for level, boxes in enumerate(header.boxes):
        mine = np.flatnonzero(header.owners[level] == comm.rank)
        pieces = np.split(state.fields["phi"][level], np.cumsum(cells_of(boxes[mine])))[:-1]
        cells |= {(level, int(b)): piece for b, piece in zip(mine, pieces, strict=True)}
    all_cells = {key: piece for part in comm.allgather(cells) for key, piece in part.items()}
    rows = {
        (table, column): np.concatenate(comm.allgather(np.asarray(values)))
        for table, columns in state.tables.items()
        for column, values in columns.items()
    }
    return all_cells, rows


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("writers", [0, 1, 2, 64])
def test_the_same_ranks_get_every_bit_back_in_order(comm, tmp_path, monkeypatch, writers):
    monkeypatch.setattr(writer_ranks, "PIECE_BYTES", 200)  # many pieces per array
    state = snapshot(comm.size, comm.rank)
    path = checkpoint_folder.path_of(tmp_path, 7)
    checkpoint.write(comm, path, state, Writers(writers))
    assert path.name == "checkpoint_00000007"
    parts = min(writers, comm.size) or comm.size
    assert len(list(path.glob("state.part*"))) == (parts if parts > 1 else 0)
    assert_same(checkpoint.read(comm, path), state)
    np.testing.assert_array_equal(checkpoint.read(comm, path).header.owners[1], state.header.owners[1])


@pytest.mark.mpi(ranks=(3,))
@pytest.mark.parametrize("writers", [1, 2])
def test_any_number_of_ranks_gets_the_same_cells_and_particles(comm, tmp_path, writers):
    from mpi4py import MPI

    path = checkpoint_folder.path_of(tmp_path, 7)
    checkpoint.write(comm, path, snapshot(comm.size, comm.rank), Writers(writers))
    cells, rows = everything(comm, snapshot(comm.size, comm.rank))
    for colour in (0, comm.rank // 2):  # two ranks and one
        part = comm.Split(colour if colour else min(comm.rank, 1), comm.rank)
        other_cells, other_rows = everything(part, checkpoint.read(part, path))
        part.Free()
        assert cells.keys() == other_cells.keys()
        assert all(np.array_equal(cells[key], other_cells[key]) for key in cells)
        assert all(np.array_equal(rows[key], other_rows[key]) for key in rows)
    alone = checkpoint.read(MPI.COMM_SELF, path)
    assert all(np.array_equal(cell_values(b, l), alone.fields["phi"][l]) for l, b in enumerate(alone.header.boxes))


@pytest.mark.mpi(ranks=(2,))
def test_what_one_rank_wrote_spreads_over_two(comm, tmp_path):
    from mpi4py import MPI

    path = checkpoint_folder.path_of(tmp_path, 7)
    if comm.rank == 0:
        checkpoint.write(MPI.COMM_SELF, path, snapshot(1, 0))
    comm.barrier()
    state = checkpoint.read(comm, path)
    assert all(len(cells) > 0 for cells in state.fields["phi"])
    assert len(state.tables["particles"]["id"]) == 25
    cells, rows = everything(comm, state)
    reference, reference_rows = everything(MPI.COMM_SELF, snapshot(1, 0))
    assert all(np.array_equal(cells[key], reference[key]) for key in reference)
    assert all(np.array_equal(rows[key], reference_rows[key]) for key in reference_rows)


@pytest.mark.mpi(ranks=(2,))
def test_the_caller_may_say_who_owns_what(comm, tmp_path):
    path = checkpoint_folder.path_of(tmp_path, 7)
    checkpoint.write(comm, path, snapshot(comm.size, comm.rank))
    state = checkpoint.read(comm, path, owners=lambda header: [np.ones(len(b), int) for b in header.boxes])
    for level, boxes in enumerate(state.header.boxes):
        np.testing.assert_array_equal(state.fields["phi"][level], cell_values(boxes, level) if comm.rank == 1 else [])


@pytest.mark.mpi(ranks=(1, 2))
def test_no_particles_and_no_fields_are_a_state_too(comm, tmp_path):
    state = snapshot(comm.size, comm.rank, per_rank=-comm.rank)
    bare = Snapshot(state.header, {}, state.tables)
    checkpoint.write(comm, tmp_path / "checkpoint_00000001", bare, Writers(2))
    back = checkpoint.read(comm, tmp_path / "checkpoint_00000001")
    assert_same(back, bare)
    assert back.tables["particles"]["position"].shape == (0, 3)


PART = "state.part0000"


def truncate(path: Path) -> None:
    part = path / PART
    part.write_bytes(part.read_bytes()[:-100])


def flip_a_bit(path: Path) -> None:
    part = path / PART
    content = bytearray(part.read_bytes())
    content[content.index(cell_values(boxes_of(0), 0)[:2].tobytes())] ^= 1
    part.write_bytes(content)


def flip_a_checksum(path: Path) -> None:
    part = path / PART
    content = bytearray(part.read_bytes())
    content[-1] ^= 1
    part.write_bytes(content)


def exchange_with_another(path: Path) -> None:
    other = checkpoint_folder.path_of(path.parent, 10) / PART
    shutil.copy(other, path / PART)


def foreign(path: Path) -> None:
    (path / STATE).write_text("something else")


def torn(path: Path) -> None:
    content = (path / STATE).read_bytes()
    (path / STATE).write_bytes(content[: len(content) // 2])


def edited(path: Path) -> None:
    content = (path / STATE).read_bytes()
    assert b'"seed": 42' in content
    (path / STATE).write_bytes(content.replace(b'"seed": 42', b'"seed": 43'))


def from_the_future(path: Path) -> None:
    """As another version would write it, which seals it as well."""
    content = (path / STATE).read_bytes().replace(b'"format_version": 4', b'"format_version": 9')
    content = content[: -atomic_files.SEAL_BYTES]
    digest = hashlib.sha256(content).hexdigest().encode()
    (path / STATE).write_bytes(content + atomic_files.SEAL + digest)


def of_a_version_before(path: Path) -> None:
    shutil.rmtree(path)
    path.mkdir()
    (path / "manifest.json").write_text('{"format": "amrpic checkpoint", "format_version": 3}')


DAMAGES = {
    truncate: "has .* bytes instead of",
    flip_a_bit: "of its part state.part0000, its checksum is wrong",
    flip_a_checksum: "its part state.part0000 is another one, or changed since",
    exchange_with_another: "its part state.part0000 (is another one, or changed since|has .* bytes instead of)",
    lambda path: (path / PART).unlink(): "its part state.part0000 is not beside it",
    lambda path: (path / STATE).unlink(): "has no state.h5",
    foreign: "damaged",
    torn: "damaged",
    edited: "its checksum is wrong",
    from_the_future: "format 9, this version reads 4",
    of_a_version_before: "is a checkpoint of an earlier version of amrpic, which alone reads it",
    shutil.rmtree: "is not a checkpoint",
}


@pytest.mark.mpi(ranks=(2,))
@pytest.mark.parametrize("damage", range(len(DAMAGES)))
def test_a_damaged_checkpoint_is_named_on_all_ranks_and_passed_over(comm, tmp_path, damage):
    act, complaint = list(DAMAGES.items())[damage]
    for step in (10, 20):
        path = checkpoint_folder.path_of(tmp_path, step)
        checkpoint.write(comm, path, snapshot(comm.size, comm.rank, step, 40 + step), Writers(0))
    older, newest = (checkpoint_folder.path_of(tmp_path, step) for step in (10, 20))
    assert checkpoint_folder.candidates(comm, tmp_path) == [newest, older]
    if comm.rank == 0:
        act(newest)
    comm.barrier()
    with pytest.raises(UnreadableCheckpoint, match=complaint) as caught:
        checkpoint.read(comm, newest)
    messages = comm.allgather(str(caught.value))
    assert len(set(messages)) == 1
    assert str(newest) in messages[0]
    assert "\n" not in messages[0]
    if checkpoint.is_checkpoint(newest):  # else it never was finished
        assert checkpoint_folder.candidates(comm, tmp_path) == [newest, older]
    else:
        assert checkpoint_folder.candidates(comm, tmp_path)[0] == older
    checkpoint.read(comm, older)


@pytest.mark.mpi(ranks=(2,))
def test_a_flipped_bit_anywhere_is_found(comm, tmp_path):
    path, state = checkpoint_folder.path_of(tmp_path, 7), snapshot(comm.size, comm.rank)
    checkpoint.write(comm, path, state, Writers(2))
    part = path / "state.part0001"
    content = part.read_bytes()
    comm.barrier()  # before rank 0 writes
    for place in range(0, len(content), max(1, len(content) // 50)):
        if comm.rank == 0:
            part.write_bytes(content[:place] + bytes([content[place] ^ 16]) + content[place + 1 :])
        comm.barrier()
        with pytest.raises(UnreadableCheckpoint):
            checkpoint.read(comm, path)
        comm.barrier()
    if comm.rank == 0:
        part.write_bytes(content)
    comm.barrier()
    assert_same(checkpoint.read(comm, path), state)


@pytest.mark.mpi(ranks=(2,))
def test_a_file_is_not_a_checkpoint(comm, tmp_path):
    if comm.rank == 0:
        (tmp_path / "beam.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    comm.barrier()
    with pytest.raises(InputError, match="is not a checkpoint"):
        checkpoint.read(comm, tmp_path / "beam.h5")


@pytest.mark.mpi(ranks=(2,))
def test_an_empty_or_missing_directory_has_no_checkpoint(comm, tmp_path):
    assert checkpoint_folder.candidates(comm, tmp_path) == []
    assert checkpoint_folder.candidates(comm, tmp_path / "nowhere") == []


@pytest.mark.mpi(ranks=(1, 2))
def test_the_newest_are_kept_and_leftovers_of_dead_runs_go(comm, tmp_path):
    if comm.rank == 0:
        (tmp_path / "checkpoint_00000099.tmp").mkdir()
        (tmp_path / "checkpoint_00000099.tmp" / "state.h5").write_bytes(b"half")
    comm.barrier()
    assert checkpoint_folder.candidates(comm, tmp_path) == []
    for step in (900, 10, 20, 30):  # 900: an earlier, longer run in the same directory
        checkpoint.write(comm, checkpoint_folder.path_of(tmp_path, step), snapshot(comm.size, comm.rank, step))
        checkpoint_folder.prune(comm, tmp_path, keep=2)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["checkpoint_00000020", "checkpoint_00000030"]
    assert checkpoint_folder.candidates(comm, tmp_path)[0] == checkpoint_folder.path_of(tmp_path, 30)


@pytest.mark.mpi(ranks=(2,))
def test_those_of_every_so_many_steps_stay_besides_the_newest(comm, tmp_path):
    for step in range(5, 50, 5):
        checkpoint.write(comm, checkpoint_folder.path_of(tmp_path, step), snapshot(comm.size, comm.rank, step))
        checkpoint_folder.prune(comm, tmp_path, keep=2, stride=15)
    assert sorted(int(p.name[-8:]) for p in tmp_path.iterdir()) == [15, 30, 40, 45]


@pytest.mark.mpi(ranks=(2,))
def test_writing_again_replaces_as_a_whole(comm, tmp_path):
    path = checkpoint_folder.path_of(tmp_path, 5)
    for per_rank in (10, 20):
        checkpoint.write(comm, path, snapshot(comm.size, comm.rank, 5, per_rank))
    assert_same(checkpoint.read(comm, path), snapshot(comm.size, comm.rank, 5, 20))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.mpi(ranks=(1,))
def test_one_that_stepped_aside_is_found_until_its_successor_is_there(comm, tmp_path):
    path = checkpoint_folder.path_of(tmp_path, 5)
    checkpoint.write(comm, path, snapshot(1, 0, 5))
    path.rename(atomic_files.replaced(path))  # where a kill between the two renames leaves it
    assert checkpoint_folder.candidates(comm, tmp_path)[0] == atomic_files.replaced(path)
    checkpoint.write(comm, path, snapshot(1, 0, 5))
    assert checkpoint_folder.candidates(comm, tmp_path)[0] == path


@pytest.mark.mpi(ranks=(2,))
def test_a_folder_that_cannot_be_made_is_one_error_on_all_ranks(comm, tmp_path):
    if comm.rank == 0:
        (tmp_path / "file").write_text("in the way")
    comm.barrier()
    with pytest.raises(OutputError, match=r"cannot write checkpoint .*: File exists; .* output folder") as caught:
        checkpoint.write(comm, tmp_path / "file" / "checkpoint_00000001", snapshot(comm.size, comm.rank))
    assert len(set(comm.allgather(str(caught.value)))) == 1


@pytest.mark.mpi(ranks=(3,))
@pytest.mark.parametrize(("full", "limit"), [(0, 100), (0, 100_000), (1, 5000), (2, 50_000)])
def test_a_disk_that_fills_up_on_one_rank_keeps_the_old_checkpoint(comm, tmp_path, full, limit):
    checkpoint.write(comm, checkpoint_folder.path_of(tmp_path, 1), snapshot(comm.size, comm.rank, 1))
    state = snapshot(comm.size, comm.rank, 2)
    state = Snapshot(state.header, state.fields, {**state.tables, "more": {"x": np.zeros(20_000)}})
    with (
        file_size_limit(limit if comm.rank == full else None),
        pytest.raises(OutputError, match=r"cannot write checkpoint .*: File too large; free some space") as caught,
    ):
        checkpoint.write(comm, checkpoint_folder.path_of(tmp_path, 2), state, Writers(3))
    assert len(set(comm.allgather(str(caught.value)))) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint_00000001"]
    assert checkpoint_folder.candidates(comm, tmp_path)[0] == checkpoint_folder.path_of(tmp_path, 1)
