"""Who may know whom: the dependency graphs of the native folders and of the Python modules.

Stages are functions from values to a value and do not know each other; only the step puts them in order.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# ---- native: folder -> folders it may include ----
NATIVE = {
    "base": set(),
    "stencil": {"base"},
    "mesh": {"stencil", "base"},
    "operators": {"mesh", "stencil", "base"},
    "freespace": {"mesh", "stencil", "base"},
    "matrixfree": {"operators", "stencil", "mesh", "base"},
    "solver": {"matrixfree", "operators", "freespace", "stencil", "mesh", "base"},
    "particle": {"mesh", "stencil", "base"},
    "processor": set(),
    "bind": {"solver", "matrixfree", "operators", "freespace", "particle", "stencil", "mesh", "base"},
}

# What may be named in some folders only.
CONFINED = {
    r'#include\s*[<"](nanobind|Python)': {"bind", "processor"},
    r"#include\s*<(MueLu|Belos|Ifpack2|Amesos2|Zoltan2|Xpetra)": {"solver"},
    r"#include\s*<(Tpetra|Teuchos)": {"base", "matrixfree", "operators", "solver"},
    r"\bParameterList\b": {"solver"},
    r"#include\s*[<\"](hdf5|H5)": set(),  # h5py brings an HDF5 of its own, Trilinos another
}

# ---- Python: module -> groups and modules it may import; a folder counts as one module ----
GROUPS = {
    "common": {
        "boxes",
        "distributions",
        "errors",
        "failure",
        "menu",
        "parallel",
        "phase_space",
        "sampling",
        "stop",
        "units",
    },
    "native": {"_native", "_processor", "isa"},
    "values": {"clouds", "hierarchy", "field", "particles", "scene"},
    "scene parts": {
        "bunch_data",
        "bunch_shapes",
        "bunches",
        "complaints",
        "expression",
        "limits",
        "memory",
        "refinement",
        "schema",
        "section",
        "species",
        "toml",
        "walls",
    },
    "stages": {"beam", "tag", "regrid", "migrate", "deposit", "poisson", "gather", "push"},
    "reductions": {"diagnostics"},
    "output": {"io", "plot", "raster", "report"},
    "order": {
        "step",
        "follow",
        "plan",
        "populate",
        "preview",
        "quantities",
        "record",
        "resume",
        "rules",
        "simulation",
    },  # compose stages and output
    "machine": {"doctor"},
    "study": {"scaling"},  # of whole steps, each in a run of its own
    "proof": {"verify"},
    "surface": {"cli", "__init__", "__main__"},
}
IMPORTS = {
    "common": {"common", "native"},
    "native": {"native"},
    "values": {"common", "native", "values", "scene parts"},
    "scene parts": {"common", "scene parts", "scene"},
    "stages": {"common", "native", "values", "species"},
    "reductions": {"common", "native", "values"},
    "output": {"common", "native", "values", "scene parts", "reductions", "output"},
    "order": {"common", "native", "values", "scene parts", "stages", "reductions", "output", "order"},
    "machine": {"common", "native", "values", "poisson"},
    "study": {"common", "values", "order"},
    "proof": {"common", "native", "values", "scene parts", "stages", "reductions", "order", "proof"},
    "surface": {
        "common",
        "native",
        "values",
        "scene parts",
        "stages",
        "reductions",
        "output",
        "order",
        "machine",
        "proof",
        "study",
    },
}


def native_files() -> list[Path]:
    return sorted(path for path in (ROOT / "native").rglob("*") if path.suffix in (".cpp", ".hpp"))


def python_files() -> list[Path]:
    return sorted((ROOT / "amrpic").rglob("*.py"))


def included(text: str) -> Iterator[str]:
    """Folders of the own headers that a native source includes."""
    return (folder for folder in re.findall(r'^\s*#\s*include\s*"(\w+)/', text, re.MULTILINE))


def forbidden_includes(folder: str, text: str) -> set[str]:
    """Folders that a source in `folder` includes and may not."""
    return {other for other in included(text) if other != folder and other not in NATIVE[folder]}


def group_of(module: str) -> str:
    """The group of a module of the package; one that has none must be given its place above."""
    found = [group for group, modules in GROUPS.items() if module in modules]
    assert found, f"amrpic/{module} has no place in the dependency graph; give it one in {Path(__file__).name}"
    return found[0]


def module_of(path: Path) -> str:
    """The module, or the folder, that a file of the package belongs to."""
    return path.relative_to(ROOT / "amrpic").parts[0].removesuffix(".py")


def imported(text: str, depth: int) -> set[str]:
    """Modules of the package that a source imports anywhere in it; it lies `depth` folders below the package."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
            found |= {(name[1:] or ["__init__"])[0] for name in names if name[0] == "amrpic"}
        elif isinstance(node, ast.ImportFrom):
            found |= imported_from(node, depth)
    return found


def imported_from(node: ast.ImportFrom, depth: int) -> set[str]:
    """Modules of the package that one `from` line imports."""
    name = node.module.split(".") if node.module else []
    if node.level == 0:
        if name[0] != "amrpic":
            return set()
        name = name[1:]
    elif node.level <= depth:
        return set()  # within its own folder
    return {name[0]} if name else {package_name(alias.name) for alias in node.names}


def package_name(name: str) -> str:
    """What `from . import name` depends on: a module, or else the package's own surface."""
    return name if any(name in modules for modules in GROUPS.values()) else "__init__"


def forbidden_imports(module: str, text: str, depth: int = 0) -> set[str]:
    """Modules that a source of `module` imports and may not."""
    allowed = IMPORTS[group_of(module)]
    others = imported(text, depth) - {module}
    return {other for other in others if other not in allowed and group_of(other) not in allowed}


@pytest.mark.parametrize("path", native_files(), ids=lambda path: str(path.relative_to(ROOT)))
def test_native_folder_includes_only_what_lies_below_it(path):
    text = path.read_text()
    assert forbidden_includes(path.parent.name, text) == set()
    for pattern, folders in CONFINED.items():
        assert path.parent.name in folders or not re.search(pattern, text), (
            f"{pattern} belongs to {folders or 'nobody'}"
        )


@pytest.mark.parametrize("path", python_files(), ids=lambda path: str(path.relative_to(ROOT)))
def test_module_imports_only_what_lies_below_it(path):
    depth = len(path.relative_to(ROOT / "amrpic").parts) - 1
    assert forbidden_imports(module_of(path), path.read_text(), depth) == set()


def own_headers(source: Path) -> set[Path]:
    """The headers of the native folders that a source includes, directly or not."""
    found: set[Path] = set()
    to_read = [source]
    while to_read:
        names = re.findall(r'^\s*#\s*include\s*"([^"]+)"', to_read.pop().read_text(), re.MULTILINE)
        fresh = {ROOT / "native" / name for name in names if (ROOT / "native" / name).exists()} - found
        found |= fresh
        to_read += fresh
    return found


def common_sources() -> list[str]:
    """The sources that CMake compiles once for all instruction sets."""
    listed = re.search(r"set\(COMMON_SOURCES\s+([^)]*)\)", (ROOT / "CMakeLists.txt").read_text())
    assert listed
    return listed[1].split()


@pytest.mark.parametrize("source", common_sources())
def test_what_is_compiled_once_knows_nothing_of_instruction_sets(source):
    for path in [ROOT / source, *own_headers(ROOT / source)]:
        assert not re.search(r"vector_size|__(AVX|SSE|FMA)", path.read_text()), path


# Weights of the formulas in docs/theory.md: 3/4, 1/4, 1/8 and 1/5 as numbers, and the quotients 8/15, 2/3, 8/3, 1/5, 5/32,
# 3/32, 3/4, 15/16.
NUMBERS = r"0?\.(75|25|125|2)f?"
QUOTIENTS = r"(8 ?/ ?15|[28] ?/ ?3|1 ?/ ?5|[53] ?/ ?32|3 ?/ ?4|15 ?/ ?16)"
WEIGHTS = re.compile(rf"(?<![\w.])({NUMBERS}|{QUOTIENTS})(?![\w.])")
# Numbers that are no weights: how near to its centre corrections may vanish in a cell, and those of the lattice's function.
OTHER_NUMBERS = {"operators/semicoarse.cpp": 1, "freespace/lattice_green.cpp": 2, "freespace/lattice_green.hpp": 1}


def weights_in(text: str) -> list[str]:
    without_comments = re.sub(r"//[^\n]*", "", text)
    whole_numbers = re.sub(r"(?<=\d)\.0*(?![\d])", "", without_comments)
    return [match[0] for match in WEIGHTS.finditer(whole_numbers)]


@pytest.mark.parametrize("path", native_files(), ids=lambda path: str(path.relative_to(ROOT)))
def test_weights_of_formulas_stand_in_native_stencil_alone(path):
    found = weights_in(path.read_text())
    if path.parent.name != "stencil":
        assert len(found) <= OTHER_NUMBERS.get(str(path.relative_to(ROOT / "native")), 0), found


def test_weights_are_found():
    assert len(weights_in("a = 8.0 / 15.0 * b + 2.0/3 * c - 0.25f * d; // 0.75")) == 3
    assert weights_in("x = 1.25 + 0.5 * y / 3; n = 22 / 3") == []


def test_native_graph_has_no_cycle():
    assert all(folder not in NATIVE[below] for folder, belows in NATIVE.items() for below in belows)


def test_forbidden_lines_are_found():
    assert forbidden_includes("mesh", '#include "solver/cycle.hpp"\n#include "base/types.hpp"') == {"solver"}
    assert forbidden_includes("particle", '  #  include "operators/x.hpp"') == {"operators"}
    assert forbidden_imports("deposit", "from .gather import gather\nfrom .field import Field") == {"gather"}
    assert forbidden_imports("deposit", "def f():\n    from amrpic.migrate import migrate") == {"migrate"}
    assert forbidden_imports("field", "from . import deposit, _native") == {"deposit"}
    assert forbidden_imports("step", "import amrpic.cli") == {"cli"}
    assert forbidden_imports("io", "from ..step import State\nfrom .collect import rows", depth=1) == {"step"}
    assert forbidden_imports("push", "import amrpic") == {"__init__"}
    assert forbidden_imports("cli", "from . import step, report, io, doctor\nfrom .errors import AmrpicError") == set()
