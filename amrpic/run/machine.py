"""How much memory the machine has left for processes."""

from __future__ import annotations

import resource
from pathlib import Path, PurePath

from ..mpi import MPI
from ..parallel import global_sum, node_of

MIB = 2**20


def available_memory() -> int:
    """Return the bytes that processes on this machine may still take, as its memory and its control groups allow."""
    fields = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text().splitlines())
    free = int(fields["MemAvailable"].split()[0]) * 1024
    return min([free, *_control_group_room()])


def machine_memory(comm: MPI.Comm) -> int:
    """Return the bytes that all ranks together may use, what they hold already included. Collective."""
    free = available_memory() if node_of(comm).rank == 0 else 0
    return int(global_sum(comm, free + resident()))


def resident() -> int:
    """Bytes that this process holds."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * resource.getpagesize()


def _control_group_room() -> list[int]:
    """Bytes left below the memory limits of this process's control groups and those around them, versions 1 and 2."""
    try:
        lines = Path("/proc/self/cgroup").read_text().splitlines()
    except OSError:
        return []
    room = []
    for _, controllers, name in (line.split(":", 2) for line in lines):
        if controllers and "memory" not in controllers.split(","):
            continue
        root = Path("/sys/fs/cgroup", "memory" if controllers else "")
        group = PurePath(name.lstrip("/"))
        for folder in (root / inside for inside in (group, *group.parents)):
            room += _room_in(folder)
    return room


def _room_in(folder: Path) -> list[int]:
    for limit, usage, cache in (
        ("memory.max", "memory.current", "inactive_file"),
        ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ):
        most, used = _number(folder / limit), _number(folder / usage)
        if most is not None and used is not None:
            # Pages of files that nobody uses count as used, but make room when it is needed.
            return [max(most - used + _counter(folder / "memory.stat", cache), 0)]
    return []


def _counter(path: Path, name: str) -> int:
    try:
        return int(dict(line.split() for line in path.read_text().splitlines())[name])
    except (OSError, ValueError, KeyError):
        return 0


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None
