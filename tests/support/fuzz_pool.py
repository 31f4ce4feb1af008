"""Ranks that live on between solves: a pool of MPI processes to which one call after another is handed.

A call runs on the first so many ranks while the others wait. A crash or a hang ends the processes; the next call starts
new ones. `python tests/support/fuzz_pool.py ADDRESS` is one of them.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Any

import backends
import mpi_batch

START = 120.0  # seconds until all processes are there
SANITIZED = "libasan" in os.environ.get(
    "LD_PRELOAD", ""
)  # by `make sanitize`; that takes time, and addresses without end
MEMORY = 8 << 30  # bytes of address space for each: what explodes shall not take the machine with it


class Broken(Exception):
    """The processes crashed or did not answer in time; `kind` tells which, the message what they printed."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class Pool:
    """Up to `ranks` MPI processes, started with the first call."""

    def __init__(self, ranks: int, environment: dict[str, str] | None = None) -> None:
        self.ranks = ranks
        self.environment = environment or {}
        self.process: subprocess.Popen | None = None
        self.connection: Connection | None = None
        self.pids: list[int] = []
        self.said = 0

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Start the processes, unless they run."""
        if self.process is not None:
            return
        self.folder = tempfile.TemporaryDirectory(prefix="amrpic_pool_")
        self.said = 0
        address = str(Path(self.folder.name) / "socket")
        self.log = Path(self.folder.name) / "output"
        command = ["mpiexec", "-n", str(self.ranks), sys.executable, "-m", "mpi4py", __file__, address]
        try:
            with Listener(address) as listener, self.log.open("wb") as output:
                self.process = subprocess.Popen(
                    command, env={**mpi_batch.ENVIRONMENT, **self.environment}, start_new_session=True,
                    stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                )  # fmt: skip
                listener._listener._socket.settimeout(START)  # type: ignore[attr-defined]
                self.connection = listener.accept()
                self.pids = self._answer(START)
        except (OSError, EOFError) as error:
            said = self.output()
            self.kill()  # and the folder, in which the listener's address was
            raise Broken("start", f"the processes did not start: {error}\n{said}") from None

    def call(self, function: str, ranks: int, *arguments: Any, timeout: float = 60.0) -> Any:
        """What `module:function` returns on the first of so many ranks, called there with their communicator and the
        arguments. Raises Broken."""
        self.start()
        self.submit(function, ranks, *arguments, timeout=timeout)
        return self.result()

    def submit(self, function: str, ranks: int, *arguments: Any, timeout: float = 60.0) -> None:
        """Begin a call; `result` waits for it."""
        self.start()
        self.end = time.monotonic() + timeout
        with contextlib.suppress(OSError):  # `result` tells what happened
            self._connected().send((function, ranks, arguments, timeout))

    def result(self) -> Any:
        """What the call returned. Raises Broken."""
        try:
            return self._answer(max(0.0, self.end - time.monotonic()) + 2)
        except TimeoutError:
            kind, text = "hang", "no end in time"
        except (OSError, EOFError):
            kind, text = "crash", "the processes ended"
        time.sleep(0.5)  # for the last words
        said = self.output()
        self.kill()
        raise Broken(kind, f"{text}\n{said}")

    def _answer(self, timeout: float) -> Any:
        connection = self._connected()
        if not connection.poll(timeout):
            raise TimeoutError
        return connection.recv()

    def _connected(self) -> Connection:
        assert self.connection is not None, "the pool was not started"
        return self.connection

    def output(self) -> str:
        """What the processes printed since the last time."""
        if self.process is None:
            return ""
        text = self.log.read_bytes()[self.said :]
        self.said += len(text)
        return text.decode(errors="replace").strip()

    def close(self) -> None:
        """End the processes; they leave by themselves."""
        if self.process is None:
            return
        with contextlib.suppress(OSError):
            self._connected().send(None)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(10)
        self.kill()

    def kill(self) -> None:
        """End the processes at once."""
        if self.process is None:
            return
        if self.process.poll() is None:  # else its ranks are gone, too
            for pid in [*self.pids, self.process.pid]:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        self.process.wait()
        self.process, self.pids = None, []
        if self.connection is not None:
            self.connection.close()
            self.connection = None
        self.folder.cleanup()


def serve(address: str) -> None:
    """One rank: run calls until asked to end."""
    import resource

    from mpi4py import MPI

    faulthandler.enable()
    if not (SANITIZED or backends.on_a_card()):  # whose driver reserves addresses far beyond memory
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    world = MPI.COMM_WORLD.Dup()
    parts = [world.Split(0 if world.rank < n else MPI.UNDEFINED) for n in range(1, world.size + 1)]
    pids = world.gather(os.getpid())
    connection = Client(address) if world.rank == 0 else None
    if connection:
        connection.send(pids)
    while True:
        call = connection.recv() if connection else None
        waiting = world.Ibarrier()
        while not waiting.Test():  # without burning the processor that others need
            time.sleep(5e-4)
        call = world.bcast(call)
        if call is None:
            return
        function, ranks, arguments, timeout = call
        if world.rank < ranks:
            faulthandler.dump_traceback_later(timeout)
            module, name = function.split(":")
            answer = getattr(importlib.import_module(module), name)(parts[ranks - 1], *arguments)
            faulthandler.cancel_dump_traceback_later()
            if connection:
                connection.send(answer)


if __name__ == "__main__":
    serve(sys.argv[1])
