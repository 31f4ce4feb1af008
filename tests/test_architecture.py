"""Who may know whom: the order of the native folders and of the packages of `amrpic`.

Each Python module imports from below only. Stages are functions from values to a value and do not know each other.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# ---- native: folder -> folders it may include ----
NATIVE = {
    "base": set(),
    "gmls": {"base"},
    "geometry": {"base"},
    "stencil": {"gmls", "base"},
    "mesh": {"stencil", "base"},
    "multigrid": {"mesh", "stencil", "base"},
    "matrices": {"multigrid", "mesh", "stencil", "base"},
    "freespace": {"mesh", "stencil", "base"},
    "fem": {"mesh", "base"},
    "material": {"base"},
    "mpm": {"fem", "material", "mesh", "base"},
    "composite": {"multigrid", "stencil", "mesh", "base"},
    "cycle": {"multigrid", "stencil", "mesh", "base"},
    "kokkos": {"particle", "composite", "cycle", "multigrid", "stencil", "mesh", "base"},
    "solver": {"kokkos", "composite", "cycle", "matrices", "multigrid", "freespace", "fem", "stencil", "mesh", "base"},
    "external": {"base"},
    "particle": {"external", "mesh", "stencil", "base"},
    "processor": set(),
    "one_rank": set(),
    "bind": {
        "solver",
        "kokkos",
        "composite",
        "cycle",
        "matrices",
        "multigrid",
        "freespace",
        "particle",
        "external",
        "stencil",
        "mesh",
        "gmls",
        "geometry",
        "fem",
        "material",
        "mpm",
        "base",
    },
}

# What may be named in some folders only.
CONFINED = {
    r'#include\s*[<"](nanobind|Python)': {"bind", "processor"},
    r"#include\s*<(MueLu|Belos|Ifpack2|Amesos2|Zoltan2|Xpetra)": {"solver"},
    r"#include\s*<(Tpetra|Teuchos)": {"base", "matrices", "solver"},
    r"\bParameterList\b": {"solver", "matrices"},  # there in tpetra.hpp, what differs between releases
    r"\bMPI_(?!Comm_f2c|Wtime)\w+\(": {"base", "one_rank"},  # `Communicator` and `Messages` send, and count
    r"#include\s*[<\"](hdf5|H5)": set(),  # h5py brings an HDF5 of its own, Trilinos another
}

# ---- Python: modules and packages of `amrpic` from the bottom to the top; each may import those before it ----
ORDER = (
    "errors",
    "one_rank",
    "mpi",
    "_processor",
    "isa",
    "_native",
    "units",
    "arithmetic",
    "shapes",
    "tables",
    "failure",
    "progress",
    "parallel",
    "gmls",
    "conductors",
    "mesh",
    "fem",
    "particles",
    "lattice",
    "scene",
    "stages",
    "space_charge",
    "hosts",
    "io",
    "external",
    "view",
    "results",
    "run",
    "pic",
    "mpm",
    "__init__",
    "drivers",
    "picmi",
    "scaling",
    "verify",
    "commands",
)
APART = ("stages",)  # packages whose modules do not import each other


def native_files() -> list[Path]:
    return sorted(path for path in (ROOT / "native").rglob("*") if path.suffix in (".cpp", ".hpp"))


def python_files() -> list[Path]:
    return sorted((ROOT / "amrpic").rglob("*.py"))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def included(text: str) -> Iterator[str]:
    """Folders of the own headers that a native source includes."""
    return (folder for folder in re.findall(r'^\s*#\s*include\s*"(\w+)/', text, re.MULTILINE))


def forbidden_includes(folder: str, text: str) -> set[str]:
    """Folders that a source in `folder` includes and may not."""
    return {other for other in included(text) if other != folder and other not in NATIVE[folder]}


def module_of(path: Path) -> tuple[str, ...]:
    """The module that a file of the package is, as its name in parts; a package is its `__init__`."""
    return path.relative_to(ROOT / "amrpic").with_suffix("").parts


MODULES = {module_of(path) for path in python_files()} | {("_processor",)}


def imported(module: tuple[str, ...], text: str) -> set[tuple[str, ...]]:
    """Modules of the package that the source of a module imports anywhere in it."""
    found: set[tuple[str, ...]] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names = [tuple(alias.name.split(".")) for alias in node.names]
            found |= {resolved(name[1:]) for name in names if name[0] == "amrpic"}
        elif isinstance(node, ast.ImportFrom):
            path = tuple(node.module.split(".")) if node.module else ()
            if node.level == 0 and path[:1] != ("amrpic",):
                continue
            start = module[: len(module) - node.level] + path if node.level else path[1:]
            found |= {resolved((*start, alias.name)) for alias in node.names}
    return found - {module}


def resolved(name: tuple[str, ...]) -> tuple[str, ...]:
    """The module that a dotted name lies in; its last part may be something that the module defines."""
    candidates = (name, (*name, "__init__"), name[:-1], (*name[:-1], "__init__"))
    return next(candidate for candidate in candidates if candidate in MODULES)


def forbidden_imports(module: tuple[str, ...], text: str) -> set[str]:
    """Modules that the source of a module imports and may not."""
    package = module[0]
    own = imported(module, text)
    above = {other for other in own if ORDER.index(other[0]) > ORDER.index(package)}
    beside = {other for other in own if other[0] == package and package in APART}
    return {".".join(other) for other in above | beside}


def test_native_folders_include_only_what_lies_below_them():
    found = {name_of(path): forbidden_includes(path.parent.name, path.read_text()) for path in native_files()}
    assert {name: folders for name, folders in found.items() if folders} == {}


@pytest.mark.parametrize("pattern", CONFINED)
def test_what_belongs_to_some_native_folders_is_in_no_other(pattern):
    others = [path for path in native_files() if path.parent.name not in CONFINED[pattern]]
    assert [name_of(path) for path in others if re.search(pattern, path.read_text())] == []


def test_modules_import_from_below_only():
    found = {name_of(path): forbidden_imports(module_of(path), path.read_text()) for path in python_files()}
    assert {name: modules for name, modules in found.items() if modules} == {}


def test_all_modules_have_a_place_in_the_order():
    assert {module[0] for module in MODULES} == set(ORDER)


def test_modules_of_a_package_import_each_other_without_cycles():
    graph = {module_of(path): imported(module_of(path), path.read_text()) for path in python_files()}
    TopologicalSorter(graph).prepare()  # raises CycleError


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


def listed(name: str) -> list[str]:
    """The values of a list in CMakeLists.txt."""
    found = re.search(rf"set\({name}\s+([^)]*)\)", (ROOT / "CMakeLists.txt").read_text())
    assert found
    return found[1].split()


def common_sources() -> list[str]:
    """The sources that CMake compiles once for all instruction sets."""
    return listed("COMMON_SOURCES")


TRILINOS = re.compile(r"#include <(Tpetra|Teuchos|MueLu|Belos|Ifpack2|Amesos2|Trilinos)")
KOKKOS = re.compile(r"#include <Kokkos_Core")


def test_a_build_without_them_leaves_out_just_what_includes_trilinos_or_kokkos():
    def includes(library: re.Pattern[str], source: Path) -> bool:
        return any(library.search(path.read_text()) for path in {source, *own_headers(source)})

    sources = {str(path.relative_to(ROOT)): path for path in native_files() if path.suffix == ".cpp"}
    of_kokkos = set(listed("OF_KOKKOS"))
    of_trilinos = {name for name, path in sources.items() if includes(TRILINOS, path)} - {"native/base/runtime.cpp"}
    assert of_trilinos == set(listed("OF_TRILINOS"))
    assert {name for name, path in sources.items() if includes(KOKKOS, path)} - of_trilinos == of_kokkos


def test_what_is_compiled_once_knows_nothing_of_instruction_sets():
    """But for `fused`, whose one call rounds once or twice: none of these sources forms a number by it."""
    read = {path for name in common_sources() for path in [ROOT / name, *own_headers(ROOT / name)]}
    of_sets = re.compile(r"vector_size|__(AVX|SSE[34]|FMA)")
    assert [name_of(path) for path in sorted(read) if of_sets.search(path.read_text())] == ["native/base/fused.hpp"]
    on_numbers = re.compile(r"\bfused\(|\bright_hand_side\(\w|\blaplacian\(\w*equation")
    assert [name for name in common_sources() if on_numbers.search((ROOT / name).read_text())] == []


# What a cycle on compressed rows is made of; the smoothers' set-up and the ends of a solve lie in other files.
LOOP_OVER_CELLS = re.compile(r"for_each_cell|for_rows|for \(\w+(::\w+)? (row|r|n|i) = ")


@pytest.mark.parametrize("name", ["matrices/sparse_matrix.cpp", "solver/multigrid.cpp", "solver/bicgstab.cpp"])
def test_a_cycle_on_compressed_rows_loops_over_no_cells_on_the_host(name):
    assert not LOOP_OVER_CELLS.search((ROOT / "native" / name).read_text())


def test_loops_over_cells_are_found():
    assert LOOP_OVER_CELLS.search((ROOT / "native/solver/crs_backend.cpp").read_text())  # around a solve


# Weights of the formulas in docs/theory.md: 3/4, 1/4, 1/8 and 1/5 as numbers, and the quotients 8/15, 2/3, 8/3, 1/5, 5/32,
# 3/32, 3/4, 15/16.
NUMBERS = r"0?\.(75|25|125|2)f?"
QUOTIENTS = r"(8 ?/ ?15|[28] ?/ ?3|1 ?/ ?5|[53] ?/ ?32|3 ?/ ?4|15 ?/ ?16)"
WEIGHTS = re.compile(rf"(?<![\w.])({NUMBERS}|{QUOTIENTS})(?![\w.])")
# Numbers that are no weights: how near to its centre corrections may vanish in a cell, from where copies are multipoles, and
# those of the lattice's function.
OTHER_NUMBERS = {
    "multigrid/semicoarse.cpp": 1,
    "freespace/acceptance.hpp": 2,
    "freespace/lattice_green.cpp": 2,
    "freespace/lattice_green.hpp": 1,
}


def weights_in(text: str) -> list[str]:
    without_comments = re.sub(r"//[^\n]*", "", text)
    whole_numbers = re.sub(r"(?<=\d)\.0*(?![\d])", "", without_comments)
    return [match[0] for match in WEIGHTS.finditer(whole_numbers)]


def test_weights_of_formulas_stand_in_native_stencil_alone():
    others = [path for path in native_files() if path.parent.name != "stencil"]
    found = {str(path.relative_to(ROOT / "native")): weights_in(path.read_text()) for path in others}
    assert {name: weights for name, weights in found.items() if len(weights) > OTHER_NUMBERS.get(name, 0)} == {}


def test_weights_are_found():
    assert len(weights_in("a = 8.0 / 15.0 * b + 2.0/3 * c - 0.25f * d; // 0.75")) == 3
    assert weights_in("x = 1.25 + 0.5 * y / 3; n = 22 / 3") == []


def test_the_table_of_formulas_names_what_there_is():
    """docs/theory.md: each formula, the function that holds it, and where the two executions take it from."""
    text = (ROOT / "docs" / "theory.md").read_text()
    table = text[text.index("### Where each formula is") : text.index("## Particles")]
    rows = [line.split(" | ") for line in table.splitlines() if line.startswith("| ") and "`" in line]
    assert len(rows) > 10
    files = {path.name: path for path in native_files()}
    stencil, native = (
        "".join(path.read_text() for path in native_files() if path.parent.name in folders)
        for folders in ({"stencil"}, NATIVE)
    )
    for row in rows[1:]:
        for column, cell in enumerate(row[1:]):
            for name in re.findall(r"`([^`]+)`", cell):
                text = stencil if column == 0 else native
                assert name in files if "." in name else re.search(rf"\b{name}\b", text), name


def test_pages_name_native_files_that_there_are():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    named = {name for page in pages for name in re.findall(r"`(native/[\w/.]+)`", page.read_text())}
    assert len(named) > 20
    assert {name for name in named if not (ROOT / name).exists()} == set()


def test_native_graph_has_no_cycle():
    assert all(folder not in NATIVE[below] for folder, belows in NATIVE.items() for below in belows)


def test_forbidden_lines_are_found():
    assert forbidden_includes("mesh", '#include "solver/cycle.hpp"\n#include "base/types.hpp"') == {"solver"}
    assert forbidden_includes("particle", '  #  include "matrices/x.hpp"') == {"matrices"}
    stage, field = ("stages", "deposit"), ("mesh", "field")
    assert forbidden_imports(stage, "from .gather import gather\nfrom ..mesh.field import Field") == {"stages.gather"}
    assert forbidden_imports(stage, "def f():\n    from amrpic.stages.migrate import x") == {"stages.migrate"}
    assert forbidden_imports(field, "from .. import _native, stages") == {"stages.__init__"}
    assert forbidden_imports(field, "from ..stages import deposit") == {"stages.deposit"}
    assert forbidden_imports(("pic", "step"), "import amrpic.commands.main") == {"commands.main"}
    assert forbidden_imports(("io", "vtkhdf_writer"), "from ..pic.step import State\nfrom .writer_ranks import x") == {
        "pic.step"
    }
    assert forbidden_imports(("stages", "push"), "import amrpic") == {"__init__"}
    assert forbidden_imports(("commands", "run"), "from ..pic import step\nfrom ..errors import AmrpicError") == set()


# Names that say how something came, or point at it, instead of what it is.
PRONOUNS = """
    found one held there here given made wanted known kept mine theirs ours which what apart rest others another taken some both
    shown then each every around it drawn seen none gone asked said more come came
"""
MOST_PRONOUNS = 0.005  # of all bound names; may only fall


def bound_names(text: str) -> Iterator[str]:
    """Names that a source binds: variables, and parameters but those of operators, whose second operand is `other`."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg


def test_bound_names_say_what_they_hold():
    names = [name for path in python_files() for name in bound_names(path.read_text())]
    pronouns = [name for name in names if name.strip("_") in PRONOUNS.split()]
    assert len(pronouns) <= MOST_PRONOUNS * len(names)


def test_bound_names_are_found():
    text = "found: int = 1\nfor one, _held in x:\n    pass\ndef f(given):\n    return lambda there: there.found"
    assert sorted(bound_names(text)) == ["_held", "found", "given", "one", "there"]


# Names of classes that stand twice, each for its reason.
TWICE = {
    "Scene": "public, of particles in cells and of material points",
    "Simulation": "public, of particles in cells and of material points",
    "Mesh": "public, of elements and of triangles",
    "SolveReport": "public, of elements and of Poisson's equation on refined meshes",
    "SpaceCharge": "public, on its own and as an element of each host",
}


def test_no_class_name_stands_twice():
    modules: dict[str, list[str]] = {}
    for path in python_files():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                modules.setdefault(node.name, []).append(name_of(path))
    assert {name: where for name, where in modules.items() if len(where) > 1 and name not in TWICE} == {}
    assert len(TWICE) <= 5


def test_commands_start_without_what_only_pictures_and_statistics_need():
    """They take long to import, and 27 MB and more of every process."""
    program = (
        "import sys, amrpic.commands.main; print({'matplotlib', 'scipy.stats', 'scipy.sparse'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()", done.stdout


# Names of files that stand twice.
TWO_METHODS = "the same part of two methods, of particles in cells and of material points"
FILES_TWICE = {
    "scene.py": TWO_METHODS,
    "simulation.py": TWO_METHODS,
    "state.py": TWO_METHODS,
    "step.py": TWO_METHODS,
    "units.py": "of the package, and of what people write in scenes",
}


def test_no_file_name_stands_twice():
    folders: dict[str, list[str]] = {}
    for path in python_files():
        if path.name != "__init__.py":
            folders.setdefault(path.name, []).append(path.parent.name)
    twice = {name: where for name, where in folders.items() if len(where) > 1}
    assert {name: where for name, where in twice.items() if name not in FILES_TWICE} == {}
    assert FILES_TWICE.keys() <= twice.keys() and len(FILES_TWICE) <= 5
