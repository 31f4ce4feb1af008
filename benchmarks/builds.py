"""Builds of revisions and working trees side by side, each in a folder of its own under build/compare."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "build" / "compare"
SOURCES = ("CMakeLists.txt", "native", "amrpic", "benchmarks", "tests")  # benchmarks share exact answers with tests
VARIABLE = re.compile(r"@([A-Za-z_]\w*)=([^@]*)")


@dataclass(frozen=True)
class Build:
    """A folder that holds the package `amrpic` with its native module, and the environment that it runs in."""

    name: str
    package: Path
    environment: dict[str, str] = field(default_factory=dict)

    def run(self, name: str, *arguments: str) -> str:
        """Return what `python benchmarks NAME` prints that imports `amrpic` from this build. Raises CalledProcessError.

        A build whose package has other modules than the present one runs the benchmark of its own revision.
        """
        own, script = self.package.parent / "benchmarks", [str(Path(__file__).parent), name]
        if own.exists() and modules(self.package) != modules(ROOT):
            script = [str(own), name] if (own / "__main__.py").exists() else [str(own / f"{name}.py")]
        # -S: the present environment's own installation of amrpic would come first.
        command = [sys.executable, "-S", *script, *arguments]
        path = os.pathsep.join([str(self.package), sysconfig.get_paths()["platlib"]])
        environment = {**os.environ, "OMP_NUM_THREADS": "1", **self.environment, "PYTHONPATH": path}
        return subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout


def modules(folder: Path) -> set[str]:
    """Return the names of the modules and folders of the package in a folder."""
    return {
        path.stem
        for path in (folder / "amrpic").iterdir()
        if not path.name.startswith(("_native", "_processor", "__pycache__"))
    }


def build(given: str) -> Build:
    """Return the build of a git revision, of a working tree, or of a folder that holds a built package `amrpic`.

    `given` may end in environment variables, as in "HEAD@AMRPIC_ISA=v3". Raises SystemExit for what is none of these, and
    CalledProcessError if it cannot be compiled.
    """
    where = VARIABLE.sub("", given)
    return Build(given, package_of(where), dict(VARIABLE.findall(given)))


def package_of(where: str) -> Path:
    folder = Path(where).resolve()
    if any(folder.glob("amrpic/_native*.so")):
        return folder
    if (folder / "CMakeLists.txt").exists():
        own = FOLDER / f"{folder.name}-{hashlib.sha256(str(folder).encode()).hexdigest()[:8]}"
        own.mkdir(parents=True, exist_ok=True)
        for part in SOURCES:
            (own / part).unlink(missing_ok=True)
            (own / part).symlink_to(folder / part)
        return compiled(own)
    commit = subprocess.run(
        ["git", "rev-parse", "--verify", "--quiet", f"{where}^{{commit}}"], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    if not commit:
        raise SystemExit(f"{where} is no git revision, no working tree, and no folder with a built amrpic")
    own = FOLDER / commit[:12]
    if not (own / "package").exists():
        own.mkdir(parents=True, exist_ok=True)
        archive = subprocess.run(
            ["git", "archive", commit, *SOURCES], cwd=ROOT, check=True, stdout=subprocess.PIPE
        ).stdout
        subprocess.run(["tar", "-x", "-C", str(own)], input=archive, check=True)
        compiled(own)
    return own / "package"


def compiled(own: Path) -> Path:
    """Return the package that was compiled, what changed alone, from the sources in the folder `own`.

    Objects lie where `make build` has them, seen from the sources, so that ccache knows what it compiled there.
    """
    objects, new, package = own / "build" / "native", own / "package.new", own / "package"
    print(f"building {own}", file=sys.stderr, flush=True)
    make = ["cmake", "-S", str(own), "-B", str(objects), "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release"]
    make += [f"-DCMAKE_CXX_COMPILER={compiler}" for compiler in (sysconfig.get_config_var("CXX") or "").split()[:1]]
    shutil.rmtree(new, ignore_errors=True)
    shutil.copytree(own / "amrpic", new / "amrpic", ignore=shutil.ignore_patterns("__pycache__", "_native*.so"))
    for command in (
        [*make, f"-DPython_EXECUTABLE={sys.executable}"],
        ["nice", "cmake", "--build", str(objects)],
        ["cmake", "--install", str(objects), "--prefix", str(new)],
    ):
        environment = {**os.environ, "CCACHE_BASEDIR": str(own), "CCACHE_NOHASHDIR": "1"}
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    shutil.rmtree(package, ignore_errors=True)
    return new.rename(package)
