"""Tutorials as pages: each script in `docs/tutorials` runs as a notebook, and its text, code and results become a page."""

from __future__ import annotations

import hashlib
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

SECONDS = 600  # of one cell


def run(script: Path) -> nbformat.NotebookNode:
    """Return the notebook of a script in jupytext's percent format, run in an empty folder.

    Raises nbclient's CellExecutionError if a cell fails.
    """
    notebook = jupytext.read(script)
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder, "work")
        work.mkdir()
        client = NotebookClient(
            notebook, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": work}}
        )
        manager = client.create_kernel_manager()
        manager.transport, manager.ip = "ipc", f"{folder}/kernel"  # sockets in the folder, which no one else opens
        client.execute(stderr=subprocess.DEVNULL)  # the kernel's own remarks; errors of cells are raised
    return notebook


def kept(script: Path, cache: Path) -> nbformat.NotebookNode:
    """Return what `run` gives, from a file in `cache` if the script has not changed since."""
    held = cache / f"{script.stem}-{hashlib.sha256(script.read_bytes()).hexdigest()[:16]}.ipynb"
    if not held.exists():
        cache.mkdir(parents=True, exist_ok=True)
        nbformat.write(run(script), held)
    return nbformat.read(held, as_version=4)


def pages(folder: Path, cache: Path) -> Iterator[tuple[str, str | bytes]]:
    """Yield the files of the site for the scripts in a folder, by their path below it: pages, pictures, notebooks."""
    for script in sorted(folder.glob("*.py")):
        notebook = kept(script, cache)
        pictures = {"output_files_dir": f"{script.stem}_files"}
        text, resources = MarkdownExporter().from_notebook_node(notebook, resources=pictures)
        head, rest = text.split("\n", 1)
        links = f"[as a notebook]({script.stem}.ipynb){{ download }} · [as a script]({script.stem}.py){{ download }}"
        rest = rest.replace('<table border="1" class="dataframe">', "<table>")  # drawn as the other tables of the site
        yield f"{script.stem}.md", f"{head}\n\n{links}\n{rest}"
        yield f"{script.stem}.ipynb", nbformat.writes(notebook)
        yield from resources["outputs"].items()
