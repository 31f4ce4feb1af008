"""The gallery: runs every example, draws what it shows, and writes docs/gallery.md. `make gallery`."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import example_pictures
from amrpic.io import time_series
from amrpic.results import curves
from amrpic.view import emission_plots

ROOT = Path(__file__).parents[2]
EXAMPLES, PAGE, PICTURES = ROOT / "examples", ROOT / "docs" / "gallery.md", ROOT / "docs" / "pictures"
AMRPIC = Path(sys.executable).with_name("amrpic")
HEAD = """# Gallery

Every example, and what it shows: `make gallery` runs them all and writes this page. A scene runs by
`make run SCENE=examples/sphere.toml`, or by `amrpic run examples/sphere.toml`; a script by `python examples/gmls_mesh.py`. The
[tutorials](tutorials/bunch.md) show their pictures themselves.
"""


@dataclass(frozen=True)
class Shown:
    """An example in the gallery: its title, what is drawn of its folder, and what its picture shows."""

    title: str
    draw: Callable[[Path, Path], None]  # from the folder of a run into a file
    caption: str
    changes: tuple[str, ...] = ()  # of the run, where the example takes long


def plot(*options: str) -> Callable[[Path, Path], None]:
    """Return what draws one picture by `amrpic plot`."""

    def draw(run: Path, picture: Path) -> None:
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([AMRPIC, "plot", run, *options, "--output", folder], check=True, stdout=subprocess.DEVNULL)
            [found] = Path(folder).glob("*.png")
            shutil.copyfile(found, picture)

    return draw


def currents(run: Path, picture: Path) -> None:
    """Draw the currents of sources into a file."""
    next(emission_plots.figures(run))[1].savefig(picture, dpi=100)


def curve(*labels: str) -> Callable[[Path, Path], None]:
    """Return what draws columns of the series by the time, named by their ordinates."""
    panels = [panel for panel in curves.BEAM if panel.label in labels]

    def draw(run: Path, picture: Path) -> None:
        curves.draw(time_series.read(run / "series.csv"), panels, "time", "s").savefig(picture, dpi=100)

    return draw


SCENES = {
    "sphere": Shown("Uniform sphere", plot("--quantity", "phi", "--kind", "line"), "φ along a line through the centre"),
    "ten_bunches": Shown(
        "Ten bunches", plot("--quantity", "rho", "--kind", "projection"), "charge per area, and the boxes of each level"
    ),
    "three_bunches": Shown(
        "Three bunches",
        plot("--quantity", "|E|"),
        "the electric field after the first of the 100 solves",
        ("--set", "schedule.solves=1"),
    ),
    "drift": Shown("A bunch expands", plot("--quantity", "|E|"), "the electric field after 40 steps"),
    "cathode": Shown(
        "A bunch leaves a cathode",
        example_pictures.bunch_and_image,
        "charge and potential of the bunch after 40 steps in the plane y = 0, and below the plane those of its image",
    ),
    "diode": Shown(
        "A planar diode", currents, "the current of the cathode: a sheet at first, then as space charge allows"
    ),
    "triode": Shown(
        "A triode",
        example_pictures.swing,
        "voltage of the grid, dotted where it cuts off, and currents over two periods",
    ),
    "long_beam": Shown(
        "A long beam spreads",
        example_pictures.spread,
        "left the radius along the path, right the potential across the beam at the end, L being the period",
    ),
    "periodic": Shown(
        "Plasma oscillation", curve("energy"), "two periods: energy goes to the field and back, twice each"
    ),
    "waist": Shown("A beam through its waist", curve("rms size", "emittance"), "sizes and emittances"),
    "fodo": Shown("Two FODO cells", curve("rms size", "emittance"), "sizes and emittances along the channel"),
    "halo": Shown(
        "Halo of a mismatched beam",
        plot("--quantity", "x-px", "--kind", "phase-space"),
        "phase space after 60 periods of the focusing",
    ),
    "einzel_lens": Shown(
        "An einzel lens",
        plot("--quantity", "phi", "--axis", "y"),
        "potential in the plane y = 0 after the bunch has passed",
    ),
    "collimator": Shown(
        "A collimator",
        plot("--quantity", "rho", "--axis", "y", "--scale", "log"),
        "charge density behind it in the plane y = 0",
    ),
    "paul_trap": Shown(
        "A Paul trap",
        plot("--quantity", "phi", "--axis", "y", "--position", "0"),
        "potential in the plane y = 0 after 30 periods, and the surfaces of ring and caps",
    ),
    "press": Shown("A press", plot("--quantity", "material", "--axis", "y"), "grains, binder and voids after it"),
    "press_fine": Shown("A finer press", plot("--quantity", "damage", "--axis", "y"), "damage after it"),
    "sinker": Shown("A ball that sinks", plot("--quantity", "pressure", "--axis", "y"), "the pressure around it"),
    "crack": Shown("A crack", plot("--quantity", "damage", "--axis", "y"), "damage, from the notch through the bar"),
    "column": Shown(
        "A column under its own weight", plot("--quantity", "pressure", "--axis", "y"), "the pressure in it"
    ),
}
SCRIPTS = {
    "cube_capacitance": Shown(
        "Capacitance of a cube",
        lambda _, picture: script("cube_capacitance", picture),
        "levels at the edges, and the error for so many cells",
    ),
    "photo_injector": Shown(
        "A photo-injector",
        lambda folder, picture: script("photo_injector", picture, "--folder", folder),
        "size, length and emittance from the cathode to 1.5 m",
    ),
    "gmls_cloud": Shown(
        "Scattered points", lambda _, picture: script("gmls_cloud", picture), "errors against the distance"
    ),
    "gmls_mesh": Shown(
        "Across a coarse-fine face", lambda _, picture: script("gmls_mesh", picture), "weights of the cells"
    ),
    "gmls_surface": Shown(
        "Curvature of an ellipsoid", lambda _, picture: script("gmls_surface", picture), "Gaussian curvature"
    ),
    "fields_between_meshes": Shown(
        "Fields between meshes",
        lambda _, picture: script("fields_between_meshes", picture),
        "a density with an edge on another mesh, and values on a line",
    ),
}


def script(name: str, picture: Path, *options: str | Path) -> None:
    """Run an example in Python, which draws its picture."""
    command: list[str | Path] = [sys.executable, EXAMPLES / f"{name}.py", "--picture", picture, *options]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def about(example: Path) -> str:
    """Return what an example says of itself: the first paragraph of its docstring, or the comment at its head."""
    text = example.read_text(encoding="utf-8")
    if example.suffix == ".py":
        return (ast.get_docstring(ast.parse(text)) or "").split("\n\n")[0].replace("\n", " ")
    found = re.match(r"(?:#.*\n)+", text)
    return " ".join(line.lstrip("# ") for line in found[0].splitlines()) if found else ""


def entry(example: Path, shown: Shown) -> str:
    """Return the section of an example."""
    language = {".toml": "toml", ".py": "python"}[example.suffix]
    code = example.read_text(encoding="utf-8").rstrip()
    return (
        f"\n## {shown.title}\n\n{about(example)}\n\n![{shown.caption}](pictures/gallery_{example.stem}.png)\n\n"
        f"<details markdown><summary><code>examples/{example.name}</code>: {shown.caption}</summary>\n\n"
        f"```{language}\n{code}\n```\n\n</details>\n"
    )


def page() -> str:
    """Return the page, of the examples as they are now."""
    scenes = (entry(EXAMPLES / f"{name}.toml", shown) for name, shown in SCENES.items())
    return HEAD + "".join([*scenes, *(entry(EXAMPLES / f"{name}.py", shown) for name, shown in SCRIPTS.items())])


def main() -> None:
    """Run everything; names of examples as arguments choose some."""
    chosen = sys.argv[1:]
    for name, shown in {**SCENES, **SCRIPTS}.items():
        if chosen and name not in chosen:
            continue
        print(name, flush=True)
        with tempfile.TemporaryDirectory() as folder:
            if name in SCENES:
                run: list[str | Path] = [AMRPIC, "run", EXAMPLES / f"{name}.toml", "--output", folder, *shown.changes]
                subprocess.run(run, check=True, stdout=subprocess.DEVNULL)
            shown.draw(Path(folder), PICTURES / f"gallery_{name}.png")
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
