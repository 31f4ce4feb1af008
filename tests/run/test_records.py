"""Records of losses: what is added to them, and what earlier ones go on to hold."""

from __future__ import annotations

import numpy as np

from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from amrpic.pic.records import Record

ELECTRONS = SpeciesTable.of_runs([(0, SPECIES["electron"])])


def record(rng: np.random.Generator, count: int, *names: str) -> Record:
    columns = (rng.normal(size=(count, 3)), rng.normal(size=(count, 3)), rng.uniform(1, 2, count))
    particles = Particles(*columns, rng.integers(0, 10**6, count), ELECTRONS)
    return Record.of(
        particles, rng.normal(size=count), rng.integers(-1, 2, count), rng.integers(0, len(names), count), names
    )


def values(of: Record) -> np.ndarray:
    """Return all columns (n, 11), with the name of what was met as its length."""
    names = np.array([len(name) for name in of.names])
    return np.column_stack([*of.particles.arrays, of.time, of.direction, names[of.cause]])


def test_records_hold_what_was_added_in_its_order():
    rng = np.random.default_rng(3)
    pieces = [record(rng, count, "a", "bb") for count in (0, 3, 0, 700, 1, 900, 5000)]
    pieces.append(record(rng, 10, "bb", "ccc"))
    whole = pieces[0]
    until = []
    for piece in pieces[1:]:
        whole = whole.joined(piece)
        until.append(whole)
    for number, earlier in enumerate(until):
        np.testing.assert_array_equal(values(earlier), np.concatenate([values(of) for of in pieces[: number + 2]]))
        met = np.bincount(earlier.cause, earlier.particles.weight * earlier.particles.charge, len(earlier.names))
        np.testing.assert_allclose(earlier.charges, met, rtol=1e-12)
    assert whole.names == ("a", "bb", "ccc")


def test_two_continuations_of_a_record_do_not_mix():
    rng = np.random.default_rng(4)
    begun = record(rng, 5, "a").joined(record(rng, 7, "a"))
    more = [record(rng, count, "a") for count in (4, 6)]
    one, other = (begun.joined(piece) for piece in more)
    for joined, piece in zip((one, other), more, strict=True):
        np.testing.assert_array_equal(values(joined), np.concatenate([values(begun), values(piece)]))


def test_losses_of_many_steps_are_copied_few_times():
    """Each step costs what it loses, not what was lost before."""
    rng = np.random.default_rng(5)
    piece = record(rng, 100, "a")
    whole, moved = piece, 0
    for _ in range(1000):
        before, whole = whole, whole.joined(piece)
        moved += 0 if np.shares_memory(before.time, whole.time) else len(before)
    assert len(whole) == 100_100 and moved < 3 * len(whole)
