"""How strong the fields of elements are, how fast they change in time, and over what lengths."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from ..io import field_maps
from ..scene.elements import (
    CavityElement,
    ConstantFocusingElement,
    DipoleElement,
    Element,
    GapElement,
    MapElement,
    MultipoleElement,
    QuadrupoleElement,
    SolenoidElement,
    UniformElement,
)
from ..units import SPEED_OF_LIGHT

FRINGE = 4.0  # gaps, in which Enge's profile of the usual magnets falls from 1 to 0
COIL = 2.0  # radii of a thin coil, in which its field falls by most


@dataclass(frozen=True)
class Strength:
    """Largest values of an element's field; what it lacks is 0, and infinity among lengths."""

    electric: float = 0.0  # V/m
    magnetic: float = 0.0  # T
    electric_gradient: float = 0.0  # V/m²
    magnetic_gradient: float = 0.0  # T/m
    frequency: float = 0.0  # Hz
    length: float = math.inf  # m, over which the field comes and goes, at the least
    # whether it does so smoothly, sampled at steps: between hard ends it is averaged along flights
    smooth: bool = False
    node: float = math.inf  # m, between nodes of a map


def strength(element: Element) -> Strength:
    """Return how strong an element is; wave numbers of focusing must have become gradients. Reads the files of maps."""
    match element:
        case UniformElement():
            sizes = math.hypot(*element.electric_field), math.hypot(*element.magnetic_field)
            return Strength(*sizes, length=element.length or math.inf)
        case ConstantFocusingElement():
            assert element.gradient is not None, "the wave numbers of an element need a species and a momentum"
            return Strength(electric_gradient=max(map(abs, element.gradient)), length=element.length or math.inf)
        case QuadrupoleElement() | DipoleElement():
            field = element.field if isinstance(element, DipoleElement) else 0.0
            fringe = math.inf if element.gap is None else FRINGE * element.gap
            length, smooth = min(element.length, fringe), element.fringe != "hard"
            return Strength(0.0, abs(field), 0.0, abs(element.gradient), length=length, smooth=smooth)
        case MultipoleElement():
            return _of_multipole(element)
        case SolenoidElement():
            coil = math.inf if element.radius is None else COIL * element.radius
            smooth = element.radius is not None
            return Strength(magnetic=abs(element.field), length=min(element.length, coil), smooth=smooth)
        case GapElement():
            return _of_gap(element)
        case CavityElement():  # near the axis B_φ = E0 k r / (2 c)
            k = 2 * math.pi * element.frequency / SPEED_OF_LIGHT
            field, slope = abs(element.field), abs(element.field) * k / (2 * SPEED_OF_LIGHT)
            return Strength(field, 0.0, 0.0, slope, element.frequency, element.length)
        case MapElement():
            return _of_map(element)
    raise TypeError(f"no strength of {element}")


def _of_multipole(element: MultipoleElement) -> Strength:
    """Of higher orders the gradient where the elements reach to, or at a tenth of their length."""
    r = min(element.reach or math.inf, element.length / 10)
    pairs = list(itertools.zip_longest(element.normal, element.skew, fillvalue=0.0))
    sizes = [math.hypot(*pair) for pair in pairs]
    slopes = (size * r ** (n - 1) / math.factorial(n - 1) for n, size in enumerate(sizes) if n > 0)
    return Strength(magnetic=sizes[0] if sizes else 0.0, magnetic_gradient=sum(slopes))


def _of_gap(element: GapElement) -> Strength:
    """On the axis e = peak (1 - u²)⁴, whose largest slope is peak (8/√7) (6/7)³ per half of the length; E_r = -r e'/2."""
    peak = abs(element.voltage) * 315 / 128 / element.length
    slope = 8 / math.sqrt(7) * (6 / 7) ** 3 * peak / (element.length / 2)
    return Strength(peak, 0.0, slope, 0.0, element.frequency, element.length, smooth=True)


def _of_map(element: MapElement) -> Strength:
    field_map, scale = field_maps.read(element.file, element.iteration), abs(element.scale)
    (electric, electric_gradient), (magnetic, magnetic_gradient) = (
        _largest(values, field_map.spacing) for values in (field_map.electric, field_map.magnetic)
    )
    sizes, slopes = (scale * electric, scale * magnetic), (scale * electric_gradient, scale * magnetic_gradient)
    return Strength(*sizes, *slopes, element.frequency, node=min(field_map.spacing))


def _largest(values: np.ndarray | None, spacing: tuple[float, ...]) -> tuple[float, float]:
    """Return the largest magnitude of a field at nodes, and its largest change between neighbours per m."""
    if values is None:
        return 0.0, 0.0
    slopes = [
        float(np.linalg.norm(np.diff(values, axis=axis), axis=-1).max(initial=0.0)) / width
        for axis, width in enumerate(spacing)
    ]
    return float(np.linalg.norm(values, axis=-1).max()), max(slopes)
