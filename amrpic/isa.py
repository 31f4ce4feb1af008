"""Instruction sets: the native module is built once for each, and one of these modules is loaded.

The one that is fastest on the processor is taken; the environment variable AMRPIC_ISA takes another.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Collection
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from types import ModuleType, TracebackType

from ._processor import sets as sets_of_the_processor
from ._processor import slowed_by_wide_vectors

VARIABLE = "AMRPIC_ISA"
X86_64 = ("v4", "v3", "v2")  # the levels of the x86-64 psABI, best first
ALONE = ("native", "baseline")  # built for the building machine's processor alone, and on other kinds of processors
TITLES = {name: f"x86-64-{name}" for name in X86_64} | {
    "native": "that of the processor it was built on",
    "baseline": "this kind of processor's common one",
}


class InstructionSetError(ImportError):
    """The kernels cannot be loaded for the instruction set that is wanted."""


def built() -> dict[str, ModuleSpec]:
    """Return where the module of each set lies that was built."""
    modules = ((name, find_spec(f"{__package__}._native_{name}")) for name in (*ALONE, *X86_64))
    return {name: spec for name, spec in modules if spec is not None}


def available(built: Collection[str], processor: Collection[str]) -> list[str]:
    """Return the sets that can be loaded, the fastest first; `processor` names those of the processor in this order."""
    return [name for name in (*ALONE, *processor) if name in built]


def choose(built: Collection[str], processor: Collection[str], choice: str = "") -> str:
    """Return the set to load; raise InstructionSetError if there is none, or not the one that is wanted."""
    usable = available(built, processor)
    if choice and choice not in (*X86_64, *built):
        raise InstructionSetError(f"{VARIABLE}={choice} names no instruction set; choose one of {', '.join(usable)}")
    if choice and choice not in built:
        raise InstructionSetError(
            f"{VARIABLE}={choice} names a set that was not built; choose one of {', '.join(usable)}"
        )
    if choice and choice not in usable:
        raise InstructionSetError(
            f"{VARIABLE}={choice} names a set that this processor lacks; choose one of {', '.join(usable)}"
        )
    if not usable:
        raise InstructionSetError(
            f"this processor has none of the instruction sets that were built ({', '.join(built) or 'none'}); "
            "build on it: make clean setup"
        )
    return choice or usable[0]


def load(name: str) -> ModuleType:
    """Return the native module under a name, for the best set or the one that AMRPIC_ISA names."""
    global in_use, usable
    modules, processor = built(), sets_of_the_processor()
    try:
        in_use = choose(modules, processor, os.environ.get(VARIABLE, ""))
    except InstructionSetError:
        _report_in_one_sentence()
        raise
    usable = available(modules, processor)
    spec = spec_from_file_location(name, modules[in_use].origin)
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


in_use = ""  # the set that is loaded
usable: list[str] = []  # those that could have been, the fastest first


def description() -> str:
    """Return which set is in use and why it comes before a wider one, and which others could be."""
    unused = [name for name in usable if name != in_use]
    why = ""
    if in_use == "v3" and not os.environ.get(VARIABLE) and "v4" in sets_of_the_processor() and slowed_by_wide_vectors():
        why = ", which is as fast as v4 here: the processor's clock falls where vectors have 512 bits"
    return f"{TITLES[in_use]}{why}" + (f" ({VARIABLE} can choose {' or '.join(unused)})" if unused else "")


def _report_in_one_sentence() -> None:
    """Let Python end without a traceback if nobody catches the error: the user can change the environment."""
    before = sys.excepthook

    def report(kind: type[BaseException], value: BaseException, trace: TracebackType | None) -> None:
        if issubclass(kind, InstructionSetError):
            print(f"amrpic: {value}", file=sys.stderr, flush=True)
        else:
            before(kind, value, trace)

    sys.excepthook = report
