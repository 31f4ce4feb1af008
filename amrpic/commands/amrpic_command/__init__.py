"""The command `amrpic` while it starts: Ctrl-C ends it with one sentence, and standard streams that are closed lead nowhere.

It is a package of its own, because a module of `amrpic` imports that package first, which takes a second or more.
"""

import os
import signal
import sys
from types import FrameType


def main() -> None:
    """Run the command line and exit with its status."""
    _open_streams()
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _interrupted)
    try:
        from amrpic.commands.main import main as command_line
    except ImportError as error:
        if not str(error).startswith("amrpic: "):
            raise
        sys.exit(str(error))  # of amrpic/mpi.py, in one sentence
    signal.signal(signal.SIGINT, before)
    command_line()


def _interrupted(number: int, frame: FrameType | None) -> None:
    os.write(2, b"amrpic: interrupted\n")
    os._exit(1)


def _open_streams() -> None:
    """Open those of the standard streams that are closed, lest a file that is opened later takes what is printed."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(descriptor, "w", closefd=False))
