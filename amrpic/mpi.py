"""MPI, as mpi4py has it; one rank alone where there is none and the native module has brought its own."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import one_rank

ONE_RANK = Path(__file__).parent / "libmpi_of_one_rank.so"  # in wheels that do without MPI
LAUNCHERS = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK")  # what they set for the processes that they start


def under_mpiexec() -> bool:
    """Return whether a launcher of MPI started this process."""
    return any(name in os.environ for name in LAUNCHERS)


def is_alone() -> bool:
    """Return whether this process has no MPI."""
    return MPI is one_rank


def _library() -> Any:
    """Return MPI. ImportError, in one sentence, if a launcher has started several processes that would not meet."""
    if not ONE_RANK.exists():
        from mpi4py import MPI

        return MPI
    try:
        from mpi4py import MPI

        refused = "" if _has_abi_of_mpich(MPI) else "mpi4py runs on another one"
    except (ImportError, RuntimeError):  # without mpi4py, without a library for it
        refused = "there is none"
    if not refused:
        return MPI
    if under_mpiexec():
        raise ImportError(f"amrpic: this wheel runs on one rank, or on MPICH, and {refused}; pip install mpi4py mpich")
    ctypes.CDLL(str(ONE_RANK), mode=ctypes.RTLD_GLOBAL)
    return one_rank


def _has_abi_of_mpich(mpi: Any) -> bool:
    return mpi.get_vendor()[0] in ("MPICH", "Intel MPI", "MVAPICH", "Cray MPICH")


if TYPE_CHECKING:
    from mpi4py import MPI
else:
    MPI = _library()
