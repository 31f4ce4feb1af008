"""The process that opens foreign HDF5 files first: a program of its own, which knows h5py and nothing of amrpic.

It reads a path a line, as JSON, with the seconds of the processor that the file may take, and answers each with a line: "fine",
or what is wrong with the file. A file that merely is not HDF5, or not what somebody expects, is fine here: what matters is that
reading it ends, and not this process. One that takes longer ends it by SIGPROF.
"""

import json
import signal
import sys

import h5py

READ_WHOLE = 2**26  # bytes; of larger datasets the ends are read
MOST_PER_BYTE = 2000  # bytes that a dataset may take in memory for each of the file, which is what compression may do


def main() -> None:
    """Answer until the input ends."""
    for line in sys.stdin:
        path, seconds = json.loads(line)
        signal.setitimer(signal.ITIMER_PROF, seconds)
        try:
            answer = _read(path)
        except MemoryError:
            answer = "it asks for more memory than there is"
        except Exception:
            answer = "fine"  # whoever opens it next meets the same, and says it better
        signal.setitimer(signal.ITIMER_PROF, 0)
        print(answer, flush=True)


def _read(path: str) -> str:
    """Read all groups, attributes and datasets of a file."""
    with open(path, "rb") as file:
        size = file.seek(0, 2)
    with h5py.File(path, "r", locking=False) as h5:
        return _read_below(h5["/"], size, set())


def _read_below(group: h5py.Group, size: int, places: set) -> str:
    for _ in group.attrs.items():
        pass
    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.SoftLink | h5py.ExternalLink):
            continue
        try:
            member = group[name]
            place = h5py.h5o.get_info(member.id).addr
        except (OSError, KeyError, RuntimeError, ValueError):
            continue
        if place in places:
            continue
        places.add(place)
        answer = _read_below(member, size, places) if isinstance(member, h5py.Group) else _read_values(member, size)
        if answer != "fine":
            return answer
    return "fine"


def _read_values(member: object, size: int) -> str:
    if not isinstance(member, h5py.Dataset):
        return "fine"
    for _ in member.attrs.items():
        pass
    if member.shape is None:
        return "fine"
    length = member.size * member.dtype.itemsize
    if not member.is_virtual and length > MOST_PER_BYTE * size:
        return f"its dataset {member.name} of shape {member.shape} is far larger than the file of {size} bytes"
    if length <= READ_WHOLE:
        member[()]
    else:
        member[:1], member[-1:]
    return "fine"


if __name__ == "__main__":
    main()
