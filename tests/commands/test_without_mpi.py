"""Wheels that do without MPI: several processes that would not meet are refused in one sentence."""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any

import pytest

from amrpic import mpi
from amrpic.commands import amrpic_command


@pytest.fixture
def refused(monkeypatch) -> str:
    """What a process of such a wheel is told under a launcher whose MPI is another one."""
    monkeypatch.setattr(mpi, "ONE_RANK", Path(__file__))
    monkeypatch.setattr(mpi, "_has_abi_of_mpich", lambda of: False)
    monkeypatch.setenv("PMI_SIZE", "2")
    with pytest.raises(ImportError) as error:
        mpi._library()
    return str(error.value)


def test_another_mpi_is_refused_with_its_remedy(refused):
    assert refused.startswith("amrpic: ") and "mpi4py runs on another one; pip install mpi4py mpich" in refused


def test_the_command_ends_with_the_sentence_alone(refused, monkeypatch):
    class Refusing(MetaPathFinder):
        def find_spec(self, name: str, *_: Any) -> None:
            if name == "amrpic.commands.main":
                raise ImportError(refused)

    monkeypatch.setattr(amrpic_command.signal, "signal", lambda *_: None)
    monkeypatch.delitem(sys.modules, "amrpic.commands.main", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Refusing(), *sys.meta_path])
    with pytest.raises(SystemExit, match="this wheel runs on one rank"):
        amrpic_command.main()
