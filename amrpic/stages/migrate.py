"""Migrate: particles to the ranks that serve them.

A rank serves the particles of a part of a curve through all bricks of 8³ cells, whoever owns these cells; bricks with many
particles are shared. Who serves a particle follows from its brick, its id and where the parts start.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .. import _native
from ..errors import ParticleError
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..parallel import raise_together, together
from ..particles.arrays import empty_columns, recycled
from ..particles.particles import Particles, Sorting, emptied, joined, one_weight_and_most

NONE = np.zeros(0, dtype=np.int64)
BRICK_COST = 64  # particles that take as long as a brick by itself, about: its part of the field is brought to it
REMOTE_COST = 8192  # the same over a network that is slow for so many ranks, at most
OF_PARTICLES = 1 / 16  # of the particles of a brick on average; so no rank has many more particles because of it
MOST_SUMMED = 2**13  # numbers in a sum over ranks
UNEVEN, FEW = 1.1, 4096  # the most work over its mean, and how many particles more than that do not matter


def migrate(
    particles: Particles, hierarchy: Hierarchy, servers: np.ndarray | None = None
) -> tuple[Particles, Particles]:
    """Return this rank's particles, and those that it lost because they lie outside the domain. Collective.

    Positions are wrapped along periodic axes. Each particle goes to its server, and is sorted there by slot and brick of 8³
    cells (`Sorting`). Those of a brick keep their order: by the rank and the place where they were, and behind them those that
    came through a periodic face. Lost particles stay as they are, on the rank that held them. `servers` as in `Sorting`; by
    default equal parts of these particles. Raises ParticleError on all ranks if a position or momentum is not finite.
    """
    arrived, lost, _ = migrate_without(particles, hierarchy, NONE, servers)
    return arrived, particles.select(lost)


def migrate_without(
    particles: Particles,
    hierarchy: Hierarchy,
    gone: np.ndarray,
    servers: np.ndarray | None = None,
    evenly: bool = False,
    meanwhile: Callable[[Particles, _native.Migration], None] = lambda arrived, migration: None,
    at_rest: bool = False,
) -> tuple[Particles, np.ndarray, int]:
    """Return the same as `migrate` without the particles at some indices, int64 (m,) ascending; of the lost ones the indices,
    and how many of all ranks are lost or left out.

    `evenly`: servers of unequal work are replaced. `at_rest`: momenta are zero, and none are moved. `meanwhile` is called while
    messages pass, with this rank's particles, of which those that stay are in their places, and the migration, which says of
    which others the values are not there yet. It may not communicate; an exception in it on some ranks is raised on all, once
    the messages are there. Collective.
    """
    comm = hierarchy.comm
    if servers is None:
        servers = share_out(comm, *weights(particles, hierarchy))
    weight, most = one_weight_and_most(comm, [particles])
    _require_few(most)
    columns = _passing(particles if weight is not None else particles.with_own_weights(), at_rest)
    plan = _native.Migration(hierarchy.particle_mesh, servers, *columns, gone, weight is None)
    most, uneven = _most_and_uneven(comm, plan)
    if evenly and uneven:
        servers = shared_out_by_work(particles, hierarchy)
        plan = _native.Migration(hierarchy.particle_mesh, servers, *columns, gone, weight is None)
        most, _ = _most_and_uneven(comm, plan)
    _require_few(most)
    arrived = Particles.allocate(plan.arriving, particles.species, weight, at_rest)
    finite = plan.start(*_passing(arrived, at_rest))
    sorting = Sorting(hierarchy, plan.starts, plan.remote(hierarchy.native), servers)
    arrived = Particles(*arrived.arrays, arrived.species, sorting)
    failure: Exception | None = None
    try:
        meanwhile(arrived, plan)
    except Exception as caught:
        failure = caught
    finally:
        plan.receive(*_passing(arrived, at_rest))
    counts = np.array([not finite, failure is not None, len(plan.lost) + len(gone)], dtype=np.int64)
    bad, failed, missing = comm.allreduce(counts).tolist()
    if bad:
        _refuse_not_finite(particles, comm)
    if failed:
        with together(comm, ParticleError):
            if failure is not None:
                raise failure
    return arrived, plan.lost, missing


def _passing(particles: Particles, at_rest: bool) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]:
    """Return the arrays that a migration moves."""
    position, momentum, weight, number = particles.arrays
    return position, None if at_rest else momentum, weight, number


def arranged(parts: list[Particles], hierarchy: Hierarchy, servers: np.ndarray) -> Particles:
    """Return particles that came to their `servers` in parts, as `migrate` returns all of them at once. Collective.

    The list is empty afterwards, and each column is freed as soon as its values are in their places: never are there two copies
    of all. Raises ParticleError on all ranks if there are too many on one.
    """
    weight, most = one_weight_and_most(hierarchy.comm, parts)
    _require_few(most)
    (positions, momenta, weights, ids), species = emptied(parts)
    position, id = joined(positions), joined(ids)
    positions.clear()
    ids.clear()
    plan = _native.Arrangement(hierarchy.particle_mesh, servers, position, id)
    places, sorting = plan.places, Sorting(hierarchy, plan.starts, plan.remote(hierarchy.native), servers)
    del plan
    positions.append(position)
    ids.append(id)
    del position, id
    own = np.broadcast_to(weight, len(places)) if weight is not None else _in_places(weights, places)
    return Particles(
        _in_places(positions, places), _in_places(momenta, places), own, _in_places(ids, places), species, sorting
    )


def _in_places(arrays: list[np.ndarray], places: np.ndarray) -> np.ndarray:
    """Return an array with the values of some, one after the other, in these places; the list is empty afterwards."""
    vectors = arrays[0].ndim == 2
    out, first = empty_columns(len(places)) if vectors else recycled(len(places), arrays[0].dtype.type), 0
    while arrays:
        values = arrays.pop(0)
        targets = places[first : first + len(values)]
        for target, source in zip(out.T, values.T, strict=True) if vectors else [(out, values)]:
            target[targets] = source
        first += len(values)
    return out


def _require_few(most: int) -> None:
    """Raise ParticleError if a rank would have more particles than it can number."""
    if most > _native.MOST_PARTICLES:
        raise ParticleError(
            f"{most} particles on one rank, more than the {_native.MOST_PARTICLES} that it can number; use more ranks"
        )


def _largest_and_sum(first: Any, other: Any, _: MPI.Datatype) -> None:
    pairs, out = (np.frombuffer(values, dtype=np.int64).reshape(-1, 2) for values in (first, other))
    out[:, 0] = np.maximum(pairs[:, 0], out[:, 0])
    out[:, 1] += pairs[:, 1]


PAIR = MPI.INT64_T.Create_contiguous(2).Commit()  # so that no pair is cut in two
LARGEST_AND_SUM = MPI.Op.Create(_largest_and_sum, commute=True)


def _most_and_uneven(comm: MPI.Comm, plan: _native.Migration) -> tuple[int, bool]:
    """Return the most particles that come to a rank, and whether one has too much of the work of all. Collective."""
    work = plan.arriving + BRICK_COST * plan.bricks
    work_of_all = np.array([plan.arriving, 0, work, work], dtype=np.int64)
    comm.Allreduce(MPI.IN_PLACE, [work_of_all, 2, PAIR], LARGEST_AND_SUM)
    return int(work_of_all[0]), bool(work_of_all[2] > UNEVEN * work_of_all[3] / comm.size + FEW)


def shared_out_by_work(particles: Particles, hierarchy: Hierarchy) -> np.ndarray:
    """Return servers, as in `Sorting`, that have equally much to do with particles that are sorted, about. Collective."""
    places, counts = weights(particles, hierarchy)
    return share_out(hierarchy.comm, places, counts + brick_cost(hierarchy.comm, counts))


def brick_cost(comm: MPI.Comm, counts: np.ndarray) -> int:
    """Return for how many particles a brick counts that holds some, given how many are in those of this rank. Collective."""
    particles, bricks = comm.allreduce(np.array([counts.sum(), len(counts)]))
    return int(np.clip(OF_PARTICLES * particles / max(bricks, 1), BRICK_COST, REMOTE_COST))


def weights(particles: Particles, hierarchy: Hierarchy) -> tuple[np.ndarray, np.ndarray]:
    """Return the places on the curve of the bricks that hold particles of this rank, int64 (n,), and how many, int64 (n,).

    The particles may be sorted on another hierarchy, or not at all; those outside the domain do not count. Nothing on one rank.
    """
    if hierarchy.comm.size == 1:
        return NONE, NONE
    return _native.count_per_brick(hierarchy.native, particles.position)


def share_out(comm: MPI.Comm, places: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return where each rank's part of the curve starts, int64 (ranks + 1,), so that all parts weigh the same. Collective.

    `places` and `weights` (n,), int64, are those of this rank; others may have the same places. What lies within a brick is
    taken as spread evenly.
    """
    bricks, member = np.unique(places, return_inverse=True)
    heavy = np.bincount(member, weights, len(bricks)).astype(np.int64)
    before = np.concatenate([[0], np.cumsum(heavy)])
    cuts = comm.allreduce(int(before[-1])) * np.arange(1, comm.size) // comm.size
    starts = np.zeros(comm.size - 1, dtype=np.int64)
    # So many binary digits at a time, the last place before which there is not more than wanted: few sums of few numbers.
    digits = next(d for d in (9, 7, 3, 1) if d == 1 or (2**d - 1) * comm.size <= MOST_SUMMED)
    for shift in range(63 - digits, -1, -digits) if comm.size > 1 else ():
        tried = starts[:, None] + (np.arange(1, 2**digits) << shift)
        brick = np.maximum(np.searchsorted(bricks, tried, side="right") - 1, 0)
        below = np.zeros_like(tried)
        if len(bricks) > 0:
            inside = np.clip(tried - bricks[brick], 0, _native.PLACES_PER_BRICK)
            below = before[brick] + heavy[brick] * inside // _native.PLACES_PER_BRICK
        comm.Allreduce(MPI.IN_PLACE, below)
        starts += np.count_nonzero(below <= cuts[:, None], axis=1) << shift
    return np.concatenate([[0], starts, [_native.END_OF_CURVE]])


def _refuse_not_finite(particles: Particles, comm: MPI.Comm) -> None:
    """Raise ParticleError on all ranks: a rank that holds particles that are not finite names one. Collective."""
    bad = np.flatnonzero(~(np.isfinite(particles.position) & np.isfinite(particles.momentum)).all(axis=1))
    count = comm.allreduce(len(bad))
    raise_together(comm, _complaint(particles, bad[0], count) if len(bad) else None, ParticleError)


def _complaint(particles: Particles, first: int, count: int) -> str:
    return (
        f"{count} particles have a position or momentum that is not finite, among them id {particles.id[first]} at "
        f"{particles.position[first].tolist()} m with {particles.momentum[first].tolist()} kg m/s; correct the input or "
        "the fields of elements, or shorten the time step"
    )
