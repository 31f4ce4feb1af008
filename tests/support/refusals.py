"""Commands run in this process, and what becomes of those that must fail."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import pytest


def ended(comm: Any, *arguments: str) -> tuple[int, str]:
    """Exit status and standard error of a command: checked to be the same on all ranks, and printed by rank 0 alone."""
    from amrpic.commands.main import main

    comm.Barrier()
    errors = io.StringIO()
    with (
        contextlib.redirect_stderr(errors),
        contextlib.redirect_stdout(io.StringIO()),
        pytest.raises(SystemExit) as end,
    ):
        main(arguments)
    reported = comm.allgather((end.value.code, errors.getvalue()))
    assert len({status for status, _ in reported}) == 1
    assert all(text == "" for _, text in reported[1:])
    return reported[0]


def refusal(comm: Any, *arguments: str, status: int = 2) -> str:
    """The one sentence of a command that must fail."""
    code, text = ended(comm, *arguments)
    assert code == status
    assert text.count("\n") == 1 and text.startswith("amrpic: ")
    assert "; " in text and "Traceback" not in text
    return text
