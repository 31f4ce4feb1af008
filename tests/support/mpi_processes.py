"""The processes of one `mpiexec`, which run batch after batch of tests until the launcher ends them."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path


class Processes:
    """So many ranks; see `mpi_server`."""

    def __init__(self, ranks: int, folder: Path, root: Path, environment: Mapping[str, str]) -> None:
        self.ranks, self.pids, self.memory = ranks, [0] * ranks, 0
        self._orders = []
        for rank in range(ranks):
            os.mkfifo(folder / f"orders{rank}")
            # Open for reading, too, so that it need not wait for the rank. No child inherits it.
            self._orders.append(os.open(folder / f"orders{rank}", os.O_RDWR))
        server = Path(__file__).with_name("mpi_server.py")
        environment = {**environment, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # each batch would look for them anew
        self.output = folder / "output"
        with self.output.open("wb") as output:
            self._process = subprocess.Popen(
                ["mpiexec", "-n", str(ranks), sys.executable, "-m", "mpi4py", str(server), str(folder)],
                env=environment, cwd=root, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
            )  # fmt: skip

    def order(self, folder: Path, arguments: Sequence[str]) -> None:
        """Let all ranks call pytest with these arguments; they write into the folder."""
        line = json.dumps({"folder": str(folder), "arguments": list(arguments)}) + "\n"
        for pipe in self._orders:
            os.write(pipe, line.encode())

    def status(self) -> int | None:
        """The exit status of mpiexec, None while it runs."""
        return self._process.poll()

    def said(self) -> str:
        """What they printed besides the batches' output."""
        return self.output.read_text(errors="replace")

    def close(self, patience: float) -> int | None:
        """Let the processes end within so many seconds; the exit status, None if they had to be killed."""
        self._hang_up()
        try:
            return self._process.wait(patience)
        except subprocess.TimeoutExpired:
            self.kill()
            return None

    def kill(self) -> None:
        """End mpiexec and its ranks if they still run."""
        self._hang_up()
        if self._process.poll() is not None:
            return
        self._process.terminate()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            for pid in [self._process.pid, *filter(None, self.pids)]:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self._process.wait()

    def _hang_up(self) -> None:
        for pipe in self._orders:
            os.close(pipe)
        self._orders = []
