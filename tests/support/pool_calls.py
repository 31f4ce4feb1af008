"""Calls that a pool of ranks is tried on."""

from __future__ import annotations

import os


def sleep_on_the_last_rank(comm, *_):
    import time

    time.sleep(60 if comm.rank == comm.size - 1 else 0)
    comm.barrier()


def end_on_the_last_rank(comm, *_):
    if comm.rank == comm.size - 1:
        print("no more", flush=True)
        os._exit(3)
    comm.barrier()


def ranks_and_sum(comm, value):
    return comm.size, comm.allreduce(value)
