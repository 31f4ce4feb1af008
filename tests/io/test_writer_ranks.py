"""Who writes what: groups by size, the loads that are planned are those that happen, and no rank has more than its share."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import beamphysics
import h5py
import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Scene, Simulation
from amrpic.io import checkpoint, openpmd_reader, openpmd_writer, shared_file, writer_ranks
from amrpic.io.checkpoint import Header, Snapshot
from amrpic.io.provenance import Moment, Provenance
from amrpic.io.writer_ranks import RANKS_PER_WRITER, Writers
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from amrpic.scene.run_sections import PART_BYTES
from scaling_model.writer_loads import checkpoint_loads

SMALL = 2**17  # bytes: what a rank reads and writes besides: headers


class Counting(MPI.Intracomm):
    """A communicator that counts what this rank receives in buffers."""

    messages = received = 0

    def _count(self, buffer: Any) -> None:
        self.messages += 1
        self.received += (buffer[0] if isinstance(buffer, list) else buffer).nbytes

    def Recv(self, buf: Any, *given: Any, **named: Any) -> None:
        self._count(buf)
        super().Recv(buf, *given, **named)

    def Irecv(self, buf: Any, *given: Any, **named: Any) -> MPI.Request:
        self._count(buf)
        return super().Irecv(buf, *given, **named)


def state_of(comm: MPI.Comm, cells: int = 32, particles: int = 20_000) -> Snapshot:
    """A level of four boxes of so many cells per edge on each rank, and so many particles."""
    boxes = np.array([[cells * b, 0, 0, cells * b + cells - 1, cells - 1, cells - 1] for b in range(4 * comm.size)])
    owners = np.repeat(np.arange(comm.size), 4)
    random = np.random.default_rng(comm.rank)
    phi = [random.random(4 * cells**3)]
    table = {"position": random.random((particles, 3)), "id": particles * comm.rank + np.arange(particles)}
    return Snapshot(Header(3, 0.0, {}, [boxes], [owners]), {"phi": phi, "rho": phi}, {"particles": table})


def share_of(state: Snapshot) -> int:
    """Bytes of this rank's arrays."""
    arrays = [level for levels in state.fields.values() for level in levels]
    return sum(a.nbytes for a in [*arrays, *(a for columns in state.tables.values() for a in columns.values())])


def io_of_process() -> tuple[int, int]:
    """Bytes that this process has read and written so far, by all of its system calls."""
    counters = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return int(counters["rchar"]), int(counters["wchar"])


@pytest.mark.parametrize(
    ("ranks", "total"), [(1, 10**12), (2, 1000), (720, 2 * 10**11), (13_824, 2 * 10**11), (10**5, 1)]
)
def test_groups_are_chosen_by_size_and_cover_all_ranks(ranks, total):
    groups = Writers().groups(ranks, total)
    assert [rank for group in groups for rank in group] == list(range(ranks))
    sizes = [len(group) for group in groups]
    assert max(sizes) <= RANKS_PER_WRITER and max(sizes) - min(sizes) <= 1
    assert len(groups) in (ranks, -(-total // PART_BYTES), -(-ranks // RANKS_PER_WRITER))
    assert max(sizes) * total / ranks <= 1.05 * PART_BYTES or max(sizes) == 1
    assert len(Writers(3).groups(ranks, total)) == min(3, ranks) and len(Writers(0).groups(ranks, total)) == ranks


@pytest.mark.mpi(ranks=(4,))
@pytest.mark.parametrize("piece_bytes", [2**20, 10_000])
def test_writers_receive_the_messages_that_are_planned(comm, tmp_path, monkeypatch, piece_bytes):
    monkeypatch.setattr(writer_ranks, "PIECE_BYTES", piece_bytes)
    counting = Counting(comm.Dup())
    state = state_of(comm)
    checkpoint.write(counting, tmp_path / "checkpoint_00000003", state, Writers(2))
    rows = np.array([[4 * 32**3] * 2 + [20_000] * 2] * comm.size)
    loads = checkpoint_loads(rows, [8, 8, 24, 8], Writers(2))
    assert [load.ranks for load in loads] == [range(0, 2), range(2, 4)]
    mine = next((load for load in loads if load.ranks.start == comm.rank), None)
    assert (counting.messages, counting.received) == ((mine.messages, mine.received) if mine else (0, 0))
    if mine:
        size = (tmp_path / "checkpoint_00000003" / f"state.part{comm.rank // 2:04d}").stat().st_size
        assert mine.bytes <= size <= mine.bytes + SMALL
    counting.Free()


@pytest.mark.mpi(ranks=(2,))
def test_pieces_of_others_are_under_way_while_a_writer_writes(comm):
    counting = Counting(comm.Dup())
    rows, posted, values = np.arange(3_000_000.0) + 1e9 * comm.rank, [], []
    counts = [len(rows)] * 2

    def write(offset: int, piece: np.ndarray) -> None:
        posted.append(counting.messages)
        values.append(piece.copy())

    writer_ranks.collect(counting, range(2), counts, rows, write)
    if comm.rank == 0:
        pieces = len(posted) // 2
        assert pieces > 2 * writer_ranks.AHEAD
        ahead = np.array(posted) - np.maximum(np.arange(2 * pieces) - pieces + 1, 0)
        assert np.all(ahead[: -writer_ranks.AHEAD] == writer_ranks.AHEAD)
        np.testing.assert_array_equal(np.concatenate(values), np.concatenate([rows, rows + 1e9]))
    counting.Free()


@pytest.mark.mpi(ranks=(4,))
def test_no_rank_reads_or_writes_more_than_its_share(comm, tmp_path, monkeypatch):
    monkeypatch.setattr(writer_ranks, "PIECE_BYTES", 2**16)
    state = state_of(comm)
    share, path = share_of(state), tmp_path / "checkpoint_00000003"
    comm.Barrier()
    _, before = io_of_process()
    checkpoint.write(comm, path, state, Writers(2))
    written = io_of_process()[1] - before
    assert share > 20 * SMALL
    assert written <= (2 * share if comm.rank % 2 == 0 else 0) + SMALL
    comm.Barrier()
    before, _ = io_of_process()
    held = checkpoint.read(comm, path)
    checked = 2 * share if comm.rank < 2 else 0  # a part whose checksum this rank looks at
    assert io_of_process()[0] - before <= share + checked + SMALL
    np.testing.assert_array_equal(held.tables["particles"]["position"], state.tables["particles"]["position"])
    three = comm.Split(0 if comm.rank < 3 else 1, comm.rank)
    if three.size == 3:
        before, _ = io_of_process()
        held = checkpoint.read(three, path)
        assert io_of_process()[0] - before <= share_of(held) + checked + SMALL
    three.Free()


SCENE = {
    "domain": {"lower": -1, "upper": 1, "cells": 32},
    "bunches": [{"distribution": "gaussian", "sigma": 0.15, "charge": "1 nC", "particles": 3000}],
    "refinement": {"levels": 1, "max_grid_size": 8},
    "output": {"writers": 2, "write": []},
}


def everything(simulation: Simulation) -> dict[str, np.ndarray]:
    """All cells by box, and all particles by id, on every rank."""
    comm, state = simulation.comm, simulation.state
    fields = {"phi": state.phi, "rho": state.rho, "Ex": state.efield.x, "Ez": state.efield.z}
    cells = {f"{n} {p.level} {p.box}": p.data.copy() for n, field in fields.items() for p in field.patches}
    out = {key: data for part in comm.allgather(cells) for key, data in part.items()}
    particles = {name: getattr(state.particles, name) for name in ("position", "momentum", "weight", "id")}
    gathered = {name: np.concatenate(comm.allgather(np.ascontiguousarray(a))) for name, a in particles.items()}
    order = np.argsort(gathered["id"])
    return out | {name: values[order] for name, values in gathered.items()}


@pytest.mark.mpi(ranks=(4,))
def test_four_ranks_three_one_and_four_again_hold_the_same_bits(comm, tmp_path):
    simulation = Simulation(comm, Scene.from_dict(SCENE))
    reference = everything(simulation)
    simulation.checkpoint(tmp_path / "checkpoint_4")
    for before, ranks in itertools.pairwise((4, 3, 1, 4)):
        some = comm.Split(0 if comm.rank < ranks else 1, comm.rank)
        if comm.rank < ranks:
            again = Simulation.restart(some, tmp_path / f"checkpoint_{before}")
            found = everything(again)
            assert found.keys() == reference.keys()
            for name, values in reference.items():
                np.testing.assert_array_equal(found[name], values, err_msg=f"{name} on {ranks} ranks")
            again.checkpoint(tmp_path / f"checkpoint_{ranks}")
            del again
        comm.Barrier()
        some.Free()


def drawn(comm: MPI.Comm, count: int) -> tuple[Particles, dict[str, np.ndarray]]:
    """This rank's part of particles whose ids come several times, at several times."""
    random = np.random.default_rng(5)
    id = random.permutation(np.repeat(np.arange(count // 4), 4))
    position, momentum, weight, time = (random.normal(size=(count, n)) for n in (3, 3, 1, 1))
    mine = random.integers(0, comm.size, count) == comm.rank
    table = SpeciesTable.of_runs([(0, SPECIES["electron"]), (count // 12, SPECIES["proton"])])
    particles = Particles(position[mine], momentum[mine], abs(weight[mine, 0]), id[mine], table)
    return particles, {"time": time[mine, 0]}


@pytest.mark.mpi(ranks=(3, 4))
@pytest.mark.parametrize("writers", [1, 2])
def test_particles_of_a_part_lie_in_the_order_of_ids(comm, tmp_path, monkeypatch, writers):
    monkeypatch.setattr(writer_ranks, "MERGED_BYTES", 5_000)  # some rows of each rank at once
    particles, columns = drawn(comm, 4000)
    path, alone = tmp_path / "particles_00000003.h5", tmp_path / f"alone{comm.rank}.h5"
    openpmd_writer.write(comm, path, particles, Moment(3, 0.0), Provenance(), columns=columns, writers=Writers(writers))
    whole, of_whole = drawn(MPI.COMM_SELF, 4000)
    openpmd_writer.write(MPI.COMM_SELF, alone, whole, Moment(3, 0.0), Provenance(), columns=of_whole)
    for name in ("electron", "proton"):
        with h5py.File(path) as one, h5py.File(alone) as other:
            found, expected = (h5[f"data/3/particles/{name}"] for h5 in (one, other))
            assert set(found) == set(expected) and dict(found.attrs).keys() == dict(expected.attrs).keys()
            keys = found["id"][:], found["time"][:]
            order = np.lexsort(keys[::-1])
            if writers == 1:
                assert np.array_equal(order, np.arange(len(order)))
            for record in ("id", "time", "weight", "position/x", "momentum/z"):
                np.testing.assert_array_equal(found[record][:][order], expected[record][:])
    names = {file.name for file in tmp_path.glob("particles*")}
    parts = {shared_file.part_of(path, index).name for index in range(writers)} if writers > 1 else set()
    assert names == {path.name} | parts
    for part in parts:
        with h5py.File(tmp_path / part) as h5:
            assert np.all(np.diff(h5["data/3/particles/proton/id"][:].astype(int)) >= 0)


@pytest.mark.mpi(ranks=(3,))
def test_clients_open_a_particle_file_of_several_parts(comm, tmp_path):
    particles = dataclasses.replace(drawn(comm, 300)[0], species=SpeciesTable((SPECIES["electron"],)))
    path = tmp_path / "particles_00000003.h5"
    openpmd_writer.write(comm, path, particles, Moment(3, 0.0), Provenance(), writers=Writers(0))
    group = beamphysics.ParticleGroup(str(path))
    assert len(group) == 300
    assert group.charge == pytest.approx(abs(particles.total_charge(comm)), rel=1e-12, abs=0)
    assert np.all(np.isfinite(group.x))
    assert len(openpmd_reader.read(path, lambda count: (100, 250))) == 150
    comm.Barrier()
    if comm.rank == 0:
        shared_file.part_of(path, 1).unlink()
    comm.Barrier()
    with pytest.raises(Exception, match=r"particles_00000003\.part0001 is not beside it"):
        openpmd_reader.read(path, lambda count: (0, count))
