"""Particles that are left out of a migration: the others arrive as if these had never been there."""

from __future__ import annotations

import numpy as np
import pytest

import hierarchies
from amrpic.stages.migrate import migrate, migrate_without
from particle_cases import placed


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("portion", [0.0, 0.01, 0.5, 0.97, 1.0])
def test_those_that_are_left_out_change_nothing_for_the_others(comm, portion):
    for case in list(hierarchies.all_cases().values())[::7]:
        hierarchy, particles = placed(case, comm, 3000)
        rng = np.random.default_rng(comm.rank)
        length = np.subtract(case.upper, case.lower)
        moved = particles.replace(particles.position + rng.normal(0, 0.05, (len(particles), 3)) * length)
        gone = np.flatnonzero(rng.random(len(particles)) < portion)
        stays = np.setdiff1d(np.arange(len(particles)), gone)
        servers = particles.sorted_on(hierarchy).servers
        arrived, lost, missing = migrate_without(moved, hierarchy, gone, servers)
        should, lost_of_others = migrate(moved.select(stays), hierarchy, servers)
        for one, other in zip(arrived.arrays, should.arrays, strict=True):
            assert np.array_equal(one, other)
        assert np.array_equal(arrived.sorted_on(hierarchy).starts, should.sorted_on(hierarchy).starts)
        assert missing == comm.allreduce(len(lost) + len(gone))
        assert np.array_equal(moved.id[lost], lost_of_others.id) and not np.isin(lost, gone).any()
