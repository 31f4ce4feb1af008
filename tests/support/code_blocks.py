"""The code blocks of a page, and what runs them in a folder one after the other, as a reader would."""

from __future__ import annotations

import difflib
import itertools
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import amrpic
from amrpic.commands.main import parser
from amrpic.commands.methods import scene_from

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r'^```(\w*)(?: title="([^"]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
BASE = """
[domain]
lower = -0.1
upper = 0.1
cells = 8

[[bunches]]
distribution = "gaussian"
species = "electron"
sigma = "5 mm"
charge = "-1 pC"
particles = 100
"""  # what parts of a scene are tried in
PRESS = ROOT / "examples" / "press.toml"  # and those of a scene of material points
ELSEWHERE = [
    "apt-get",
    "cmake",
    "conda",
    "spack",
    "docker",
    "export",
    "pip",
    "python3",
    "make",
    "sbatch",
    "srun",
    "tar",
    "cd",
    "git",
]
# Commands that other machines have, or that install and compile: their blocks are checked for their syntax alone.


@dataclass(frozen=True)
class Block:
    """Code on a page: its language, the name of the file that it is, if any, and its text."""

    page: str
    language: str
    file: str
    text: str


def pages() -> list[Path]:
    """Return all pages with text: README.md and those in docs."""
    return [
        ROOT / "README.md",
        *sorted((ROOT / "docs").glob("*.md")),
        *sorted((ROOT / "docs" / "reports").glob("*.md")),
    ]


def blocks(page: Path) -> list[Block]:
    """Return the code blocks of a page in order."""
    text = page.read_text(encoding="utf-8")
    found = [Block(page.stem, *match.groups(default="")) for match in FENCE.finditer(text)]
    assert 2 * len(found) == len(re.findall("^ *```", text, re.MULTILINE)), f"{page} has fences that are not understood"
    return found


@dataclass
class Reader:
    """Follows a page in a folder: files, names of Python, and options that make runs of `amrpic` shorter; previews are."""

    folder: Path
    shorter: str = ""
    loosely: bool = False  # compare the first word of each printed line alone
    names: dict[str, Any] = field(default_factory=dict)
    scene: str = BASE  # the last whole one

    def __post_init__(self) -> None:
        """Put `amrpic` and `python` on the path, as an activated environment does."""
        tools = self.folder / ".venv" / "bin"
        tools.mkdir(parents=True)
        binaries = Path(sys.executable).parent
        (tools / "python").symlink_to(sys.executable)
        (tools / "amrpic").write_text(
            "#!/bin/bash\ncase $1 in\n"
            f'run) exec {binaries}/amrpic "$@" {self.shorter};;\n'
            f'preview) exec {binaries}/amrpic "$@" --seconds 1;;\n'
            f'*) exec {binaries}/amrpic "$@";;\nesac\n'
        )
        (tools / "amrpic").chmod(0o755)
        (tools / "activate").touch()
        (self.folder / "examples").symlink_to(ROOT / "examples")

    def follow(self, block: Block) -> None:
        """Run a block, or check it where it can't run here. Raises whatever is wrong with it."""
        getattr(self, f"_{block.language}")(block)

    def _python(self, block: Block) -> None:
        exec(compile(block.text, f"{block.page}.md", "exec"), self.names)

    def _toml(self, block: Block) -> None:
        given = tomllib.loads(block.text)
        if block.file:
            (self.folder / block.file).write_text(block.text, encoding="utf-8")
        if "method" in given:
            scene_from(tomllib.loads(PRESS.read_text(encoding="utf-8")) | given, PRESS)
            return
        if {"domain", "bunches"} <= set(given):
            self.scene = block.text
        amrpic.Scene.from_dict(tomllib.loads(self.scene) | given)

    def _sh(self, block: Block) -> None:
        subprocess.run(["bash", "-n", "-c", block.text], check=True)
        commands = list(split(block.text))
        if any("SCENE" in command or Path(command[0]).name in ELSEWHERE for command in commands if command):
            for arguments in filter(None, map(of_amrpic, commands)):
                parser().parse_args(arguments)
        else:
            self.printed(block.text)

    def _console(self, block: Block) -> None:
        for found in re.finditer(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block.text, re.MULTILINE):
            command = found[1]
            if command.startswith("make run"):  # which prints the command that it runs
                command = found[2].splitlines()[0]
                found = re.match(r"()[^\n]*\n(.*)", found[2], re.DOTALL) or found
            look = first_words if self.loosely else masked
            agree(look(found[2]), look(self.printed(command)))

    def _text(self, block: Block) -> None:
        """Output by itself, of which the sentence before tells the command: a page's own check looks at it."""

    def printed(self, commands: str) -> str:
        """Return what commands print, both streams together, in the folder; raises AssertionError if one fails."""
        environment = os.environ | {
            "PATH": f"{self.folder / '.venv' / 'bin'}:{os.environ['PATH']}",
            "OMPI_ALLOW_RUN_AS_ROOT": "1",
            "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
            "OMPI_MCA_rmaps_base_oversubscribe": "1",
            "OMP_NUM_THREADS": "1",
        }
        environment = {name: value for name, value in environment.items() if not name.startswith(("OMPI_COMM", "PMIX"))}
        done = subprocess.run(
            ["bash", "-eu", "-o", "pipefail", "-c", commands],
            cwd=self.folder, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, f"{commands}\n{done.stdout}"
        return done.stdout


def split(script: str) -> Iterator[list[str]]:
    """Yield the words of each line of a script, without comments, tests before and ends after."""
    for line in script.splitlines():
        words = shlex.split(line, comments=True)
        if words:
            yield words


def of_amrpic(command: list[str]) -> list[str] | None:
    """Return the arguments of `amrpic` in a command, wherever it begins, if it is there."""
    where = [index for index, word in enumerate(command) if Path(word).name == "amrpic"]
    known = where and len(command) > where[-1] + 1 and command[where[-1] - 1] != "-czf"
    if not known or "docker" in command:
        return None
    return list(itertools.takewhile(lambda word: word not in ("||", "&&", "|", "&", ";"), command[where[-1] + 1 :]))


def masked(text: str) -> list[str]:
    """Return the lines of an output without what differs from run to run or from build to build: numbers, prefixes of units,
    blanks, how far a preview's trials of the run came, and which other sets of kernels are at hand.
    """
    text = re.sub(r" \(AMRPIC_ISA can choose .*?\)", "", text)
    text = re.sub(r"[-−]?\d[\d.,:]*(e[-+]?\d+)?", "#", text)
    text = re.sub(r"# (ms|µs|ns|s|min|h)\b", "# s", text)
    text = re.sub(r"from (its first solve|# steps of it|(one run|runs) on .*?of its cells)", "from trials", text)
    text = text.replace("from trials, in proportion: rather too long", "from trials")  # a busy machine
    return [" ".join(line.split()) for line in text.splitlines() if line.strip()]


def first_words(text: str) -> list[str]:
    """Return the first word of each line."""
    return [line.split()[0] for line in text.splitlines() if line.strip()]


def agree(documented: list[str], printed: list[str]) -> None:
    """Raise AssertionError unless lines are the same, where "..." stands for any."""
    if "..." in documented:
        at = documented.index("...")
        printed = [*printed[:at], "...", *printed[len(printed) - (len(documented) - at - 1) :]]
    difference = "\n".join(difflib.unified_diff(documented, printed, "on the page", "printed", lineterm=""))
    assert not difference, difference
