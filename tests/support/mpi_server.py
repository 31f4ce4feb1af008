"""A rank that waits for batches of tests and runs one after the other, so that they share the start of its process.

`mpi_processes` starts it and writes orders, a line of JSON each, into a pipe that ends with the launcher.
"""

from __future__ import annotations

import gc
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

import mpi_rank


def serve(folder: Path) -> None:
    """Run what is ordered until the launcher closes the pipe or ends."""
    rank = int(os.environ.get("OMPI_COMM_WORLD_RANK") or os.environ["PMI_RANK"])  # of Open MPI, or of MPICH
    with (folder / f"orders{rank}").open() as orders:
        for line in orders:
            run(json.loads(line), rank)
            if gc.get_freeze_count() == 0:
                gc.freeze()  # modules stay; later searches for garbage pass them over


def run(order: dict[str, Any], rank: int) -> None:
    """Run a batch; what it prints goes into a file of its own."""
    folder = Path(order["folder"])
    output = os.open(folder / "output", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    sys.stdout.flush()
    sys.stderr.flush()
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.close(output)
    os.environ[mpi_rank.FOLDER] = str(folder)
    pytest.main(order["arguments"])
    gc.collect()
    (folder / f"rank{rank}.part").write_text(str(resident()))
    (folder / f"rank{rank}.part").rename(folder / f"rank{rank}.memory")


def resident() -> int:
    """Bytes of memory that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
