"""A page on a run that needs nothing else: scene, pictures, beam, solver, time and remarks, for any browser."""

from __future__ import annotations

import contextlib
from base64 import b64encode
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .. import tables
from ..errors import InputError, OutputError
from ..io import particle_reader, time_series
from ..io.atomic_files import publish, temporary
from ..io.field_reader import open_dump
from ..io.run_status import RunStatus
from ..io.writer_ranks import one_line
from ..mesh.domain import AXES
from ..mesh.pictures import png
from ..scene import toml
from ..scene.scene import Scene
from ..units import ELEMENTARY_CHARGE, quantity
from ..view import draw, emission_plots, phase_space_plots
from ..view.views import overview_of
from . import curves
from .dumped_fields import is_of_points, scene_of
from .run_results import SERIES, rows_of

FILE = "report.html"
DPI = 110
MOST_PARTICLES = 2_000_000  # whose phase space is drawn
PLANES = ("x-px", "z-pz")
Table = NDArray[Any]

STYLE = """
body { font: 16px/1.45 system-ui, sans-serif; max-width: 64rem; margin: 0 auto; padding: 1rem; color: #222; background: #fff }
h1 { margin: 0 0 .3rem } h2 { margin: 2rem 0 .5rem; border-bottom: 1px solid #ccc }
.pictures { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr)) }
img { max-width: 100%; height: auto; display: block } .wide { overflow-x: auto }
table { border-collapse: collapse; font-size: .9rem; margin: .5rem 0 } th, td { padding: .2rem .7rem .2rem 0; text-align: left }
td { white-space: nowrap }
thead th { border-bottom: 1px solid #999 } tbody tr:nth-child(even) { background: #f5f5f5 } caption { text-align: left }
pre { overflow-x: auto; background: #f5f5f5; padding: .7rem; font-size: .8rem } .finished { color: #17662f }
.stopped { color: #8a5a00 } .failed, .gone { color: #a11 } .warning { background: #fff3d6; padding: .4rem .7rem }
"""


def write(folder: Path) -> Path:
    """Write the report of a run into its folder and return its path. Serial.

    Raises InputError if the folder holds no series, OutputError if the page cannot be written.
    """
    folder = Path(folder)
    page, path = make(folder), folder / FILE
    try:
        temporary(path).write_text(page, encoding="utf-8")
        publish(path)
    except OSError as error:
        raise OutputError(
            f"cannot write report {path}: {one_line(error)}; free some space or check the folder"
        ) from None
    return path


def make(folder: Path) -> str:
    """Return the report of a run as HTML. Raises InputError if its folder holds no series."""
    path = folder / SERIES
    series, about = rows_of(folder), time_series.about_of(path)
    data = about["scene"]
    status = None
    with contextlib.suppress(InputError):
        status = RunStatus.read(folder)
    name, remarks = str(data["name"]), list(status.warnings if status else [])
    if is_of_points(data):
        summary = f"{name}: material points"
        of_method = [("Body", _image(curves.draw(series, curves.BODY, "load"), "body"))]
    else:
        scene = scene_of(data, path)
        summary, remarks = scene.summary(), [*remarks, *scene.remarks()]
        of_method = [("Beam", _beam(folder, series, scene)), ("Sources", _sources(folder, scene))]
    sections = [
        ("Pictures", _pictures(folder, int(_last(series, "particles")))),
        *of_method,
        ("Solver", _solver(folder, series)),
        ("Time", _time(series, status)),
        ("Remarks", _remarks(remarks, status)),
        (
            "Scene",
            f"<details><summary>{escape(summary)}</summary><pre>{escape(toml.dumps(data))}</pre></details>",
        ),
    ]
    body = "".join(f"<section><h2>{name}</h2>{content}</section>" for name, content in sections if content)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(name)}</title><style>{STYLE}</style></head>"
        f"<body><header><h1>{escape(name)}</h1>{_head(series, about, status)}</header>{body}"
        f"<footer><p><small>Made by amrpic {version('amrpic')}.</small></p></footer></body></html>\n"
    )


def _head(series: Table, about: dict[str, Any], status: RunStatus | None) -> str:
    last = series[-1]
    rows: list[tuple[str, object]] = [("step", int(last["step"]))]
    if is_of_points(about["scene"]):
        rows += [("load", f"{100 * last['load']:.4g} %"), ("points", last["points"])]
    else:
        levels = [int(last[name]) for name in _cells(series) if last[name]]
        rows += [
            ("simulated time", quantity(float(last["time"]), "s")),
            ("particles", f"{last['particles']}, {last['lost_particles']} lost"),
            ("mesh", f"{len(levels)} levels, {sum(levels)} cells"),
        ]
    rows += [("amrpic", f"{about['version']}, seed {about['seed']}")]
    if status is None:
        return _wide(tables.html((), rows))
    rows[0] = ("step", f"{status.step} of {status.of}")
    rows += [("ranks", f"{status.ranks} on {status.host}"), ("from", status.started), ("to", status.updated)]
    why = f": {status.why}" if status.why else ""
    return f'<p class="{status.state}"><b>{status.state}</b>{escape(why)}</p>{_wide(tables.html((), rows))}'


def _last(series: Table, column: str) -> float:
    """Return the last value of a column, 0 if the series has none."""
    return float(series[column][-1]) if column in (series.dtype.names or ()) else 0.0


def _cells(series: Table) -> list[str]:
    return [name for name in series.dtype.names or () if name.startswith("cells_")]


def _pictures(folder: Path, particles: int) -> str:
    """Return pictures of the newest dumps; those that the run drew itself if there are no fields to draw."""
    figures = []
    with contextlib.suppress(InputError), open_dump(folder) as dump:
        figures += [_image(figure, name) for name, figure in draw.figures(dump, overview_of(dump))]
    if not figures:
        newest = max((path.name[:15] for path in folder.glob("fields_*.png")), default="")
        files = sorted(folder.glob(f"{newest}*.png")) if newest else []
        figures = [_inlined(path.read_bytes(), path.stem) for path in files]
    if 0 < particles <= MOST_PARTICLES:
        with contextlib.suppress(InputError):
            dumped = particle_reader.read(folder)
            figures += [_image(figure, name) for name, figure in phase_space_plots.figures(dumped, PLANES)]
    return f'<div class="pictures">{"".join(figures)}</div>' if figures else ""


def _beam(folder: Path, series: Table, scene: Scene) -> str:
    moves = len(np.unique(series["time"])) > 1
    out = _image(curves.draw(series, curves.BEAM, *(("time", "s") if moves else ("step",))), "beam")
    out += f"<p>Potential energy is ½ ∫ ρφ dV; {escape(scene.domain.value.zero_of_phi)}.</p>"
    with contextlib.suppress(InputError):
        beam = time_series.read(folder / "beam.csv")
        rows = [_group(row) for row in beam[beam["step"] == beam["step"].max(initial=0)]]
        head = ("group", "particles", "charge", "mean energy", "rms x, y, z", "emittance x, y, z")
        step = int(beam["step"].max(initial=0))
        out += _wide(tables.html(head, rows, f"Groups of particles at step {step}"))
    return out


def _sources(folder: Path, scene: Scene) -> str:
    """Return pictures of what sources gave, and of slices of the particles that are left of it, where these were written."""
    if not scene.sources:
        return ""
    pictures = []
    with contextlib.suppress(InputError):
        pictures += [_image(figure, name) for name, figure in emission_plots.figures(folder)]
    for source in scene.source_names:
        with contextlib.suppress(InputError):
            for _, figure in phase_space_plots.figures(particle_reader.read(folder), ("slices",), source):
                pictures.append(_image(figure, f"slices of {source}"))
    return f'<div class="pictures">{"".join(pictures)}</div>' if pictures else ""


def _group(row: Any) -> list[str]:
    energy = float(row["mean_energy"]) / ELEMENTARY_CHARGE
    return [
        str(row["group"]),
        str(row["particles"]),
        quantity(float(row["charge"]), "C"),
        _known(energy, "eV"),
        ", ".join(_known(float(row[f"rms_{axis}"]), "m") for axis in AXES),
        ", ".join(_known(float(row[f"emittance_{axis}"]), "m rad") for axis in AXES),
    ]


def _known(value: float, unit: str) -> str:
    return quantity(value, unit) if np.isfinite(value) else "none"


def _solver(folder: Path, series: Table) -> str:
    cells = curves.Panel("cells", "", _cells(series))
    out = _image(curves.draw(series, [*curves.SOLVER, cells]), "solver")
    with contextlib.suppress(InputError):
        history = time_series.read(folder / "residuals.csv")
        history = history[history["step"] == history["step"].max(initial=0)]
        last = history[history["solve"] == history["solve"].max(initial=0)]
        rows = [(row["cycle"], f"{row['residual']:.2e}") for row in last]
        out += _wide(tables.html(("cycle", "residual"), rows, "The last solve"))
    return out


def _time(series: Table, status: RunStatus | None) -> str:
    columns = series.dtype.names or ()
    stages = [name for name in columns if name.startswith("seconds_")]
    imbalances = [name for name in columns if name.startswith("imbalance_")]
    panels = [
        curves.Panel("time of a step", "s", stages, stacked=True),
        curves.Panel("most of a rank / mean", "", imbalances),
    ]
    total = sum(series[name].sum() for name in stages) or 1.0
    rows = [
        (name.removeprefix("seconds_"), quantity(float(series[name].sum()), "s"), f"{series[name].sum() / total:.1%}")
        for name in sorted(stages, key=lambda name: -series[name].sum())
    ]
    of_steps = series["seconds"][1:] if len(series) > 1 else series["seconds"]
    facts = [
        ("all steps", quantity(float(series["seconds"].sum()), "s")),
        ("a step after the first, mean", quantity(float(of_steps.mean()), "s")),
        ("memory of the largest rank", f"{series['memory'].max() / 2**20:.0f} MiB"),
        *(
            (
                f"{name.removeprefix('imbalance_')}: most of a rank / mean",
                f"{series[name].max():.3f} at most, {series[name].mean():.3f} in the mean",
            )
            for name in imbalances
        ),
    ]  # fmt: skip
    stages_table = tables.html(("stage", "time on the slowest rank", "share"), rows)
    return _image(curves.draw(series, panels if status is None or status.ranks > 1 else panels[:1]), "time") + _wide(
        tables.html((), facts) + stages_table
    )


def _remarks(remarks: list[str], status: RunStatus | None) -> str:
    out = "".join(f'<p class="warning">{escape(text)}</p>' for text in dict.fromkeys(remarks))
    out += "".join(f"<p>{escape(text)}</p>" for text in (status.notes if status else []))
    return out or "<p>None.</p>"


def _wide(content: str) -> str:
    """Return what may be wider than a phone, and is moved sideways there."""
    return f'<div class="wide">{content}</div>'


def _image(figure: Figure, name: str) -> str:
    return _inlined(png(figure, DPI), name)


def _inlined(content: bytes, name: str) -> str:
    return f'<img alt="{escape(name)}" src="data:image/png;base64,{b64encode(content).decode()}">'
