"""Files of HDF5 on a disk that fills up."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SUPPORT = Path(__file__).parents[1] / "support"
WRITES_TEXT_ON_A_FULL_DISK = """
import sys
import numpy as np
from amrpic.io.atomic_files import Hdf5Writer
from full_disk import file_size_limit

with file_size_limit(int(sys.argv[2])):
    writer = Hdf5Writer(sys.argv[1])
    writer.h5["values"] = np.ones(1000)
    writer.h5["text"] = "of a length that HDF5 keeps elsewhere: it reads the place before it writes"
    try:
        writer.close()
    except OSError as error:
        print(error.strerror)
"""


@pytest.mark.parametrize("room", [0, 2_000, 5_000])
def test_what_was_not_written_is_not_read_back_as_what_memory_held_before(tmp_path, room):
    script = [sys.executable, "-c", WRITES_TEXT_ON_A_FULL_DISK, str(tmp_path / "x.h5"), str(room)]
    memory = {"MALLOC_PERTURB_": "165", "PYTHONPATH": str(SUPPORT)}  # glibc fills what it hands out
    end = subprocess.run(script, env=os.environ | memory, capture_output=True, text=True, timeout=60)
    assert (end.returncode, end.stdout, end.stderr) == (0, "File too large\n", "")
