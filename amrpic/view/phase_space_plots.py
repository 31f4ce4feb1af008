"""Pictures of particles: planes of phase space with the rms ellipse, and slices along z."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from ..errors import InputError
from ..io.particle_reader import ParticleDump, read
from ..mesh.pictures import DECADES, ONE_SIGN, divisor
from ..mpi import MPI
from ..particles.groups import Groups
from ..particles.particles import Particles
from ..stages.beam_diagnostics import Beam, PartMoments, Slice, group_slices, moments_by_kind
from ..units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT, prefix_of, quantity
from .figures import save

Array = NDArray[Any]

PLANES = {"x-px": (0, 3), "y-py": (1, 4), "z-pz": (2, 5), "x-y": (0, 1), "z-x": (2, 0), "z-y": (2, 1)}
OVERVIEW = ("x-px", "y-py", "z-pz", "x-y", "slices")
NAMES = ("x", "y", "z", "$p_x$", "$p_y$", "$p_z$")
SLICES = 40
FEWEST_PIXELS, MOST_PIXELS = 48, 200  # along an axis; between them so that a pixel holds some particles
DARKEST = 0.35  # of the range of colours, below the least charge
ELLIPSE = "#7fe3ff"


def plot(
    path: Path, directory: Path | None = None, quantities: Sequence[str] = OVERVIEW, group: str = "all"
) -> list[Path]:
    """Draw the particles of a group in a dump, or of the latest one in a run's folder; return the pictures' paths.

    Quantities are planes, as in `PLANES`, or "slices". Pictures go beside the dump unless `directory` is given. Serial.
    Raises InputError for what is not there, OutputError if a picture cannot be written.
    """
    dump = read(Path(path))
    folder = dump.path.parent if directory is None else Path(directory)
    of = "" if group == "all" else f"_{group}"
    return [
        save(figure, folder / f"{dump.path.stem}{of}_{name}.png") for name, figure in figures(dump, quantities, group)
    ]


def figures(
    dump: ParticleDump, quantities: Sequence[str] = OVERVIEW, group: str = "all"
) -> Iterator[tuple[str, Figure]]:
    """Yield the pictures of the particles of a group by their quantities, as for `plot`. Serial; InputError."""
    for name in quantities:
        if name not in (*PLANES, "slices"):
            raise InputError(f"phase space has no picture {name}; choose among {', '.join((*PLANES, 'slices'))}")
    try:
        groups = dump.groups.named(group)
    except KeyError:
        raise InputError(f"{dump.path} has no group {group}; choose among {', '.join(dump.groups.names)}") from None
    particles = dump.particles
    ((beam, groups, moments),) = moments_by_kind(MPI.COMM_SELF, Beam(particles, particles), groups, dump.domain)
    of_tests = beam.particles is not particles  # each counts as one
    particles, part = beam.particles, moments[groups.members[0]]
    if not part.weight > 0:
        raise InputError(f"{group} of {dump.path} has no particles left to draw; choose another group or dump")
    if not (of_tests or particles.charge.any()):
        raise InputError(f"particles of {dump.path} have no charge, which pictures show; choose another dump")
    for name in quantities:
        if name == "slices":
            slices = group_slices(MPI.COMM_SELF, beam, groups, moments, SLICES)[groups.members[0]]
            yield name, draw_slices(slices, _title(dump, group))
        else:
            members = _members(particles, groups)
            members = members.replace(part.images.of_places(members.position))
            yield name, draw_plane(members, part, name, _title(dump, group), of_tests)


def _title(dump: ParticleDump, group: str) -> str:
    return f"{group}, step {dump.step}, t = {quantity(dump.time, 's')}"


def _members(particles: Particles, groups: Groups) -> Particles:
    if len(groups.members[0]) == len(groups.starts):
        return particles
    return particles.select(np.isin(groups.run_of(particles.id), list(groups.members[0])))


def coordinate(particles: Particles, index: int) -> tuple[Array, str]:
    """Return a coordinate of all particles and its unit: x, y, z in m, p_x, p_y, p_z in eV/c."""
    if index < 3:
        return particles.position[:, index], "m"
    return particles.momentum[:, index - 3] * (SPEED_OF_LIGHT / ELEMENTARY_CHARGE), "eV/c"


def draw_plane(particles: Particles, part: PartMoments, name: str, title: str, of_tests: bool = False) -> Figure:
    """Return the picture of the charge in a plane of phase space, with the rms ellipse and the profiles along both axes.

    Of test particles, which have none, it shows how many they are by their weights.
    """
    indices = PLANES[name]
    values, labels = [], []
    pixels = int(np.clip(np.sqrt(len(particles)) / 3, FEWEST_PIXELS, MOST_PIXELS))
    for index in indices:
        value, unit = coordinate(particles, index)
        factor, prefix = prefix_of(float(np.abs(value).max()))
        values.append(value / factor)
        labels.append(f"{NAMES[index]} / {divisor(prefix, unit)}")
    edges = _edges(values, pixels, same_scale=max(indices) < 3)
    charge = particles.weight if of_tests else np.abs(particles.weight * particles.charge)
    counts, _, _ = np.histogram2d(values[0], values[1], bins=(edges[0], edges[1]), weights=charge)
    factor, prefix = (1.0, "") if of_tests else prefix_of(float(counts.max()))
    counts /= factor
    least = max(float(counts[counts > 0].min()), float(counts.max()) * 10.0**-DECADES)

    figure = Figure(figsize=(7.2, 6.0), layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=(5, 1, 0.18), height_ratios=(1, 5), wspace=0.02, hspace=0.02)
    plane = figure.add_subplot(grid[1, 0])
    most = max(float(counts.max()), 1.001 * least)
    norm = LogNorm(least * (least / most) ** DARKEST, most)  # single particles are to be seen on the dark ground
    image = plane.pcolormesh(*edges, np.where(counts > 0, counts, np.nan).T, norm=norm, cmap=ONE_SIGN, rasterized=True)
    plane.set_facecolor("black")
    plane.set(xlabel=labels[0], ylabel=labels[1])
    _draw_ellipse(plane, values, charge)
    _draw_profile(figure.add_subplot(grid[0, 0], sharex=plane), edges[0], counts.sum(axis=1), upright=True)
    _draw_profile(figure.add_subplot(grid[1, 1], sharey=plane), edges[1], counts.sum(axis=0), upright=False)
    bar = figure.colorbar(image, cax=figure.add_subplot(grid[1, 2]))
    bar.set_label("particles per pixel" if of_tests else f"charge per pixel / {prefix}C")
    axis = indices[0]
    about = _twiss_text(part, axis) if indices[1] == axis + 3 else ""
    figure.suptitle(
        f"{name.replace('px', '$p_x$').replace('py', '$p_y$').replace('pz', '$p_z$')} of {title}{about}",
        fontsize="medium",
    )
    return figure


def _edges(values: Sequence[Array], pixels: int, same_scale: bool) -> list[Array]:
    """Return the edges of pixels over all values and a little beyond, along both axes."""
    low, high = (np.array([extreme(value) for value in values]) for extreme in (np.min, np.max))
    half = 0.54 * (high - low)
    half = np.where(half > 0, half, 0.04 * np.abs(high) + (high == 0))
    if same_scale:
        half[:] = half.max()
    return [np.linspace(m - h, m + h, pixels + 1) for m, h in zip((low + high) / 2, half, strict=True)]


def _draw_ellipse(plane: Axes, values: Sequence[Array], weight: Array) -> None:
    """Draw the ellipse whose projections on the axes are the rms sizes."""
    centre = np.average(values, axis=1, weights=weight)
    covariance = np.cov(values, aweights=weight, ddof=0)
    widths, axes = np.linalg.eigh(covariance)
    turn = np.linspace(0, 2 * np.pi, 400)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    x, y = centre[:, None] + axes @ (np.sqrt(np.maximum(widths, 0))[:, None] * circle)
    outline = [Stroke(linewidth=3.0, foreground="black"), Normal()]
    plane.plot(x, y, color=ELLIPSE, linewidth=1.4, label="rms ellipse", path_effects=outline)
    plane.legend(loc="upper right", fontsize="x-small", facecolor="black", labelcolor="white", framealpha=0.6)


def _draw_profile(panel: Axes, edges: Array, profile: Array, upright: bool) -> None:
    panel.stairs(profile, edges, orientation="vertical" if upright else "horizontal", color="C1", fill=True, alpha=0.8)
    panel.tick_params(labelbottom=False, labelleft=False, left=False, bottom=False)
    panel.spines[["top", "right", "left" if upright else "bottom"]].set_visible(False)
    panel.margins(0)


def _twiss_text(part: PartMoments, axis: int) -> str:
    """Return normalised emittance and Twiss parameters, where there are any."""
    if not part.has_ellipse(axis):
        return "\nno area in this plane"
    alpha, beta, _ = part.twiss(axis)
    text = f"\nnormalised rms emittance {quantity(part.emittance(axis), 'm rad')}, α = {alpha:.3g}"
    if np.isfinite(part.speed):
        text += f", β = {quantity(beta * part.speed, 'm')}"
    return text.replace("-", "−")


def draw_slices(slices: Sequence[Slice], title: str) -> Figure:
    """Return the picture of what slices along z hold: charge, sizes, emittances, energies."""
    edges = np.array([slices[0].lower, *(of_slice.upper for of_slice in slices)])
    length, length_prefix = prefix_of(float(np.abs(edges).max()))
    centres = (edges[1:] + edges[:-1]) / 2 / length
    moving = any(abs(of_slice.part.flow) > 1e-3 * SPEED_OF_LIGHT * abs(of_slice.part.charge) for of_slice in slices)
    profile = (
        "current",
        "A",
        [("", [of_slice.current if moving else of_slice.charge_per_length for of_slice in slices])],
    )
    if not moving:
        profile = ("charge per length", "C/m", profile[2])
    panels = [
        profile,
        ("rms size", "m", [(name, [of_slice.part.rms[axis] for of_slice in slices]) for axis, name in enumerate("xy")]),
        (
            "emittance",
            "m rad",
            [(name, [of_slice.part.emittance(axis) for of_slice in slices]) for axis, name in enumerate("xy")],
        ),
        ("kinetic energy", "eV", [("mean", [of_slice.part.mean[6] / ELEMENTARY_CHARGE for of_slice in slices])]),
        ("energy spread", "eV", [("rms", [of_slice.part.rms[6] / ELEMENTARY_CHARGE for of_slice in slices])]),
    ]
    figure = Figure(figsize=(8, 9), layout="constrained")
    for panel, (label, unit, curves) in zip(figure.subplots(len(panels), 1, sharex=True), panels, strict=True):
        magnitudes = [abs(value) for _, values in curves for value in values if np.isfinite(value)]
        factor, prefix = prefix_of(max(magnitudes, default=1.0))
        for number, (name, values) in enumerate(curves):
            scaled = np.array(values) / factor
            if label == profile[0]:
                panel.stairs(np.nan_to_num(scaled), edges / length, color="C1", fill=True, alpha=0.8)
            else:
                panel.plot(centres, scaled, color=f"C{3 * number}", marker=".", markersize=4, linewidth=1.0, label=name)
        panel.set_ylabel(f"{label} / {divisor(prefix, unit)}")
        panel.grid(alpha=0.3)
        panel.margins(x=0)
        if len(curves) > 1:
            panel.legend(fontsize="small", ncols=2)
        if label == "energy spread" or label.startswith(("rms", "emittance")):
            panel.set_ylim(bottom=0)
    panel.set_xlabel(f"z / {length_prefix}m")
    figure.suptitle(f"{len(slices)} slices of {title}", fontsize="medium")
    return figure
