"""The laws of the verification: each table of each topic keeps its bounds.

`make verify` measures all of them and writes the page; `make test` those that have a short form, in it. With AMRPIC_REPORTS
set the tables go into verification.md in that folder; with AMRPIC_IN_FULL set some comparisons take hours instead of minutes.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from mpi4py import MPI

from amrpic.verify import write
from amrpic.verify.table import Table
from verify import TOPICS
from verify.evidence import tables_of_topics
from verify.lengths import Length, length

REPORTS = os.environ.get("AMRPIC_REPORTS")
WHOLE: Length = "full" if os.environ.get("AMRPIC_IN_FULL") else "whole"
SHORT = (
    "gaps",
    "hard-cases",
    "least-squares",
    "materials",
    "open-boundary",
    "peers",
)  # topics whose short form takes seconds


def hold(comm: MPI.Comm, topic: str, chosen: Length) -> None:
    """Measure the tables of a topic; all must keep their bounds. Collective."""
    missed: list[Table] = []
    titles = tables_of_topics()[topic]
    with length(chosen):
        for table in TOPICS[topic](comm):
            assert table.title in titles, f"docs/reports/evidence.md lacks {table.title}"
            if REPORTS and chosen != "brief" and comm.rank == 0:
                write([table], Path(REPORTS))
            if not table.met:
                missed.append(table)
    assert not missed, "\n\n".join(f"{table.title}\n{table.markdown()}" for table in missed)


@pytest.mark.mpi(ranks=1, more=(3,), timeout=120)
@pytest.mark.parametrize("topic", SHORT)
def test_a_short_form_keeps_its_bounds(comm, topic):
    hold(comm, topic, "brief")


@pytest.mark.long
@pytest.mark.mpi(ranks=2, timeout=600)
@pytest.mark.parametrize("topic", TOPICS)
def test_a_topic_keeps_its_bounds(comm, topic):
    hold(comm, topic, WHOLE)
