"""Kernels are built for several instruction sets; each that the processor has gives the same potential."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence

import numpy as np
import pytest

import mpi_batch
from amrpic import isa

SOLVE = """
import json
import sys
import amrpic
import numpy as np
from amrpic import isa
from mpi4py import MPI
domain = amrpic.Domain(lower=(-1, -1, -1), upper=(1, 1, 1), cells=(24, 32, 20), boundary="open")
refined = [[((16, 24, 12), (35, 39, 27))]]
hierarchy = amrpic.Hierarchy(MPI.COMM_WORLD, domain, levels=refined, max_grid_size=12, blocking_factor=4)
rho = amrpic.Field(hierarchy, unit="C/m^3")
rho.fill(lambda x, y, z: 1e-9 * np.exp(-20 * ((x - 0.05) ** 2 + y**2 + z**2)))
phi, report = amrpic.PoissonSolver(hierarchy, tolerance=1e-11).solve(rho)
axis = np.linspace(-0.9, 0.9, 7)
points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
values = [float(value) for value in phi.sample(points)]
print(json.dumps({"set": isa.in_use, "cycles": report.cycles, "phi": values}))
"""
INSTRUCTION = re.compile(r"^\s*([0-9a-f]+):\t(\S+)\s*(.*)$")
PACKED = re.compile(r"v?(add|mul|sub|fn?m(add|sub)\d+)ps")  # arithmetic of whole vectors
SINGLE = re.compile(r"v?(mov|add|sub|mul|fn?m(add|sub)\d+)ss|v?(insert|extract)ps|v?p(insr|extr)d")  # of one element


def python(code: str, wanted: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process that is asked for a set."""
    environment = {**mpi_batch.ENVIRONMENT, isa.VARIABLE: wanted}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=100)


def solved(wanted: str) -> dict:
    done = python(SOLVE, wanted)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.skipif(len(isa.usable) < 2, reason="there is one set here")
def test_all_sets_give_the_same_potential_in_the_same_cycles():
    best, *others = (solved(name) for name in isa.usable)
    assert best == solved("") | {"phi": best["phi"]}
    for other in others:
        assert other["cycles"] == best["cycles"]
        assert np.array(other["phi"]) == pytest.approx(np.array(best["phi"]), rel=0, abs=1e-9 * max(best["phi"]))
    assert [each["set"] for each in (best, *others)] == isa.usable


@pytest.mark.parametrize(
    ("processor", "wanted", "taken"),
    [
        (("v3", "v2"), "", "v3"),
        (("v4", "v3", "v2"), "v2", "v2"),
        (("v4", "v3", "v2"), "", "v4"),
        (("v3", "v4", "v2"), "", "v3"),
    ],
)
def test_the_fastest_set_of_the_processor_is_taken_unless_one_is_wanted(processor, wanted, taken):
    assert isa.choose(("v4", "v3", "v2"), processor, wanted) == taken


@pytest.mark.parametrize(
    ("built", "processor", "wanted", "sentence"),
    [
        (("v4", "v3", "v2"), ("v2",), "v3", "AMRPIC_ISA=v3 names a set that this processor lacks; choose one of v2"),
        (("v4", "v3", "v2"), ("v3", "v2"), "v9", "AMRPIC_ISA=v9 names no instruction set; choose one of v3, v2"),
        (("baseline",), (), "v4", "AMRPIC_ISA=v4 names a set that was not built; choose one of baseline"),
        (("v4", "v3", "v2"), (), "", "this processor has none of the instruction sets that were built (v4, v3, v2)"),
    ],
)
def test_a_set_that_cannot_run_is_refused(built, processor, wanted, sentence):
    with pytest.raises(isa.InstructionSetError, match=re.escape(sentence)):
        isa.choose(built, processor, wanted)


def test_a_processor_that_wide_vectors_slow_down_is_named(monkeypatch):
    monkeypatch.delenv(isa.VARIABLE, raising=False)
    monkeypatch.setattr(isa, "sets_of_the_processor", lambda: ["v3", "v4", "v2"])
    monkeypatch.setattr(isa, "slowed_by_wide_vectors", lambda: True)
    monkeypatch.setattr(isa, "usable", ["v3", "v4"])
    monkeypatch.setattr(isa, "in_use", "v3")
    assert isa.description() == (
        "x86-64-v3, which is as fast as v4 here: the processor's clock falls where vectors have 512 bits "
        "(AMRPIC_ISA can choose v4)"
    )


def test_an_unknown_set_ends_the_process_with_one_sentence():
    done = python("import amrpic", "v9")
    assert done.returncode == 1
    assert done.stderr == f"amrpic: AMRPIC_ISA=v9 names no instruction set; choose one of {', '.join(isa.usable)}\n"


# ---- what the compiler made of the kernels ----

Instruction = tuple[int, str, str]  # address, operation, operands


def objdump(*arguments: str) -> str:
    return subprocess.run(["objdump", *arguments], capture_output=True, text=True, check=True).stdout


def instructions(library: str, function: str) -> list[Instruction]:
    """The instructions of the exported function whose mangled name holds a text."""
    names = {line.split()[-1] for line in objdump("-T", library).splitlines() if function in line}
    assert len(names) == 1, f"{function} is not exported once: {names}"
    lines = objdump("-d", "--no-show-raw-insn", f"--disassemble={names.pop()}", library).splitlines()
    found = (INSTRUCTION.match(line) for line in lines)
    return [(int(each[1], 16), each[2], each[3]) for each in found if each]


def innermost_loops(code: Sequence[Instruction]) -> list[list[str]]:
    """The operations from where a jump leads back to that jump, where no other such pair lies between them."""
    targets = [(re.match(r"[0-9a-f]+", operands), at) for at, operation, operands in code if operation[0] == "j"]
    first = code[0][0]
    pairs = {(int(target[0], 16), at) for target, at in targets if target and first <= int(target[0], 16) < at}
    inner = [a for a in pairs if not any(a != b and a[0] <= b[0] and b[1] <= a[1] for b in pairs)]
    return [[operation for at, operation, _ in code if start <= at <= end] for start, end in sorted(inner)]


@pytest.mark.skipif(shutil.which("objdump") is None, reason="without objdump")
@pytest.mark.parametrize("name", ["v3", "v4"])
def test_relaxation_works_on_whole_vectors(name):
    modules = isa.built()
    if name not in modules:
        pytest.skip("this set is not built")
    library = modules[name].origin
    assert library is not None
    loops = innermost_loops(instructions(library, "Sweep5relaxE"))
    kernels = [loop for loop in loops if any(map(PACKED.fullmatch, loop))]
    assert len(kernels) >= 4  # two widths, with and without equal weights along the axes
    assert [operation for loop in kernels for operation in loop if SINGLE.fullmatch(operation)] == []
