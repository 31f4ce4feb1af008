"""The external fields of a scene: those of its elements, at any places."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from .errors import InputError
from .io import field_maps
from .mesh.domain import AXES, Domain
from .mesh.window import AT_REST, Window, axes, vector
from .particles.species import Species
from .scene.bunches import DescribedBunch
from .scene.elements import (
    CavityElement,
    ConstantFocusingElement,
    DipoleElement,
    Element,
    FringedElement,
    GapElement,
    MapElement,
    MultipoleElement,
    PossiblyEverywhere,
    QuadrupoleElement,
    SolenoidElement,
    UniformElement,
    enge_reach,
)
from .scene.scene import Scene

Array = NDArray[np.float64]
Kind = (
    _native.UniformField
    | _native.FocusingField
    | _native.QuadrupoleField
    | _native.DipoleField
    | _native.MultipoleField
    | _native.SolenoidField
    | _native.GapField
    | _native.PillboxField
    | _native.MapField
)
Maps = Mapping[tuple[str, int | None], field_maps.FieldMap]  # by file and iteration
EVERYWHERE = (-math.inf, math.inf)
ROUNDING = 1e-9  # of a period, by which what is as long may be longer


class ExternalFields:
    """The fields of elements; where these overlap, fields add. `elements` has focusing by gradients, in the laboratory."""

    def __init__(
        self,
        elements: Sequence[Element] = (),
        species: Species | None = None,
        momentum: tuple[float, float, float] = (0.0, 0.0, 0.0),
        maps: Maps | None = None,
        domain: Domain | None = None,
        repeats: Sequence[int] = (),
    ) -> None:
        """Make the fields of elements; wave numbers of focusing refer to a species and its mean momentum in kg m/s.

        Maps that are not given are read from their files. Along the axes `repeats` of a `domain` elements repeat with its
        period, see `images`. Raises InputError if a map cannot be used, or an element would lie over its own images.
        """
        by_file = read_maps(elements) if maps is None else maps
        self.elements = [
            element.model_copy(update={"gradient": element.gradient_for(species, momentum), "wavenumber": None})
            if isinstance(element, ConstantFocusingElement) and element.wavenumber is not None and species is not None
            else element
            for element in elements
        ]
        self.native = _native.ExternalFields(
            [
                native_element(image, by_file)
                for number, element in enumerate(self.elements)
                for image in images(element, f"elements.{number}", by_file, domain, repeats)
            ]
        )

    @classmethod
    def of_scene(cls, scene: Scene, maps: Maps | None = None) -> Self:
        """Return the fields of the elements of a scene, which repeat where space does, unless the mesh moves along it."""
        domain, first = scene.domain.value, scene.bunches[0] if scene.bunches else None
        repeats = [axis for axis in np.flatnonzero(domain.periodic).tolist() if axis != scene.window_axis]
        if isinstance(first, DescribedBunch):
            return cls(scene.elements, first.species, first.mean_momentum, maps, domain, repeats)
        return cls(scene.elements, maps=maps, domain=domain, repeats=repeats)

    def seen_from(self, window: Window) -> Self:
        """Return the same fields in the coordinates of a window."""
        if window == AT_REST:
            return self
        out = type(self)()
        out.elements = self.elements
        out.native = self.native.seen_from(window.origin, window.axes)
        return out

    def fields(self, position: ArrayLike, time: float = 0.0) -> tuple[Array, Array]:
        """Return E (n, 3) in V/m and B (n, 3) in T at places (n, 3) in m and a time in s.

        What hard edges have in their planes alone, the radial field of a solenoid, is in no point: see `means`.
        """
        return self.means(position, np.zeros_like(position, dtype=float), time, 0.0, 0.0)

    def means(
        self, position: ArrayLike, velocity: ArrayLike, time: float, start: float, stop: float
    ) -> tuple[Array, Array]:
        """Return the means of E and B along the flights position + velocity τ, τ from start to stop in s, at `time`.

        With hard edges, the part of the flight between them counts, and the field in their planes where they are crossed.
        """
        places, velocities = (np.ascontiguousarray(array, dtype=float) for array in (position, velocity))
        return self.native.means(places, velocities, time, start, stop)


def read_maps(elements: Sequence[Element]) -> Maps:
    """Return the maps of elements by file and iteration. Raises InputError if one cannot be used."""
    files = {(element.file, element.iteration) for element in elements if isinstance(element, MapElement)}
    return {source: field_maps.read(*source) for source in sorted(files, key=str)}


def native_element(element: Element, maps: Maps) -> _native.ExternalElement:
    """Return an element as the kernels take it; `maps` holds its map if it is one."""
    if isinstance(element, MapElement):
        field_map, omega = maps[element.file, element.iteration], 2 * math.pi * element.frequency
        field = map_field(field_map, element.scale, omega, element.phase)
    else:
        field = kind(element)
    return _native.ExternalElement(
        element.centre,
        axes(element.direction, element.roll),
        extent(element),
        field,
        slopes(element),
        element.reach or math.inf,
    )


def images(
    element: Element, name: str, maps: Maps, domain: Domain | None = None, repeats: Sequence[int] = ()
) -> list[Element]:
    """Return an element and its images where space repeats along the axis that it lies along.

    They are those whose fields reach into the domain, or half a period beyond its faces, where flights end. What reaches over
    all of the domain has no ends, and no images. Raises InputError, with the `name`, for what would lie over its own images.
    """
    frame = np.array(axes(element.direction, element.roll))
    along = int(np.argmax(np.abs(frame[2])))
    first, last = ends(element, maps)
    if domain is None or along not in repeats or math.isinf(last - first):
        return [element]
    # in its own axes: the domain, how far the planes at its ends rise within, and the way from one image to the next
    corners = (
        np.array(list(itertools.product(*zip(domain.lower, domain.upper, strict=True)))) - element.centre
    ) @ frame.T
    low, high = corners[:, 2].min(), corners[:, 2].max()
    rises = np.abs(corners[:, 0]).max() * np.abs(slopes(element))
    period = domain.period(along)
    step = period * frame[2, along]
    if last - first > (1 + ROUNDING) * abs(step):
        if first + rises[0] <= low and high <= last - rises[1]:
            return [element]
        raise InputError(
            f"{name} is {last - first:g} m long, where space repeats along {AXES[along]} after {period:g} m, so that it would "
            "lie over its own images; shorten it, or let it reach over all of the domain"
        )
    lower, upper = extent(element)
    if math.isinf(upper - lower):  # the next image on either side of a coil, all of a map
        beyond = 0.0 if isinstance(element, MapElement) else abs(step)
        lower, upper = first - beyond, last + beyond
    margin = abs(step) / 2
    numbers = sorted([(low - margin - upper - rises[1]) / step, (high + margin - lower + rises[0]) / step])
    shift = period * np.eye(3)[along]
    return [
        element.model_copy(update={"centre": vector(element.centre + n * shift)})
        for n in range(math.ceil(numbers[0]), math.floor(numbers[1]) + 1)
    ]


def ends(element: Element, maps: Maps) -> tuple[float, float]:
    """Return where along its own axis an element begins and ends, in m from its centre; fringes reach beyond."""
    if isinstance(element, MapElement):
        field_map = maps[element.file, element.iteration]
        nodes = next(values for values in (field_map.electric, field_map.magnetic) if values is not None).shape[-2]
        return field_map.lower[-1], field_map.lower[-1] + (nodes - 1) * field_map.spacing[-1]
    length = element.length  # type: ignore[attr-defined]
    return EVERYWHERE if length is None else (-length / 2, length / 2)


def extent(element: Element) -> tuple[float, float]:
    """Return where along its own axis an element may have a field, in m from its centre."""
    if isinstance(element, PossiblyEverywhere) and element.length is None:
        return EVERYWHERE
    if isinstance(element, MapElement) or (isinstance(element, SolenoidElement) and element.fringe == "sheet"):
        return EVERYWHERE
    half = element.length / 2  # type: ignore[attr-defined]
    if not isinstance(element, FringedElement) or element.gap is None:
        return (-half, half)
    fringe = enge_reach(element.coefficients) * element.gap
    entrance, exit = faces(element)
    return (-half - fringe / math.cos(entrance), half + fringe / math.cos(exit))


def fields_between(elements: Sequence[Element]) -> list[tuple[float, float]]:
    """Return where along their own axes elements have fields, in m from their centres, of a thin coil where it is wound.

    Reads the files of maps. Raises InputError if one cannot be used.
    """
    maps = read_maps(elements)
    ranges = ((extent(element), ends(element, maps)) for element in elements)
    return [inner if math.isinf(outer[1]) else outer for outer, inner in ranges]


def slopes(element: Element) -> tuple[float, float]:
    """Return by how much the planes at both ends of an element rise along its z, per x."""
    entrance, exit = faces(element)
    return (math.tan(entrance), -math.tan(exit))


def faces(element: Element) -> tuple[float, float]:
    """Return the angles of the pole faces of an element in rad."""
    return (element.entrance_angle, element.exit_angle) if isinstance(element, DipoleElement) else (0.0, 0.0)


def kind(element: Element) -> Kind:
    """Return the field of an element, but of a map, in its own axes."""
    match element:
        case UniformElement():
            return _native.UniformField(element.electric_field, element.magnetic_field)
        case ConstantFocusingElement():
            assert element.gradient is not None, "the wave numbers of an element need a species and a momentum"
            return _native.FocusingField(element.gradient)
        case QuadrupoleElement():
            return _native.QuadrupoleField(element.gradient, element.length / 2, fringe(element))
        case DipoleElement():
            half, ends, lost = element.length / 2, fringe(element), lost_at_faces(element)
            return _native.DipoleField(element.field, half, ends, faces(element), element.gradient, element.turn, lost)
        case MultipoleElement():
            normal, skew = (
                [strength / math.factorial(n) for n, strength in enumerate(of)] + [0.0] * (6 - len(of))
                for of in (element.normal, element.skew)
            )
            return _native.MultipoleField(normal, skew)
        case SolenoidElement():
            return _native.SolenoidField(element.field, element.length / 2, element.radius or 0.0)
        case GapElement():
            return _native.GapField(element.voltage, element.length / 2, 2 * math.pi * element.frequency, element.phase)
        case CavityElement():
            return _native.PillboxField(element.field, 2 * math.pi * element.frequency, element.phase)
    raise TypeError(f"no field of {element}")


def lost_at_faces(element: DipoleElement) -> tuple[float, float]:
    """Return by how much less hard faces seem to rise with x across the bend, since the field falls over some length.

    A particle that meets a face at an angle e gets as much across as from one at e - ψ, ψ = h K (1 + sin² e) / cos e, of a
    curvature h and an integral K (K. L. Brown, SLAC-75, 1972).
    """
    half = element.turn / 2
    curvature = 2 * math.sin(half) / element.length

    def lost(face: float, integral: float) -> float:
        e = face + half
        psi = curvature * integral * (1 + math.sin(e) ** 2) / math.cos(e)
        return (1 - math.tan(face) * math.tan(half)) * (math.tan(e) - math.tan(e - psi))

    entrance, exit = map(lost, faces(element), element.edge_integrals)
    return entrance, -exit


def fringe(element: FringedElement) -> _native.EngeFringe:
    """Return the ends of a magnet."""
    if element.gap is None:
        return _native.EngeFringe()
    return _native.EngeFringe(element.gap, element.coefficients, enge_reach(element.coefficients))


# ---- maps: a ghost node beyond each end, so that all cells are interpolated by one formula ----


def map_field(field_map: field_maps.FieldMap, scale: float = 1.0, omega: float = 0.0, phase: float = 0.0) -> Kind:
    """Return the field of a map; omega in 1/s, phase in rad."""
    present = next(values for values in (field_map.electric, field_map.magnetic) if values is not None)
    cells = [n - 1 for n in present.shape[:-1]]
    lower, before = list(field_map.lower), [1] * len(cells)
    mirrored = nodes_through_axis(field_map) if field_map.axisymmetric else 0
    if mirrored == 2:  # the axis lies between two nodes
        lower[0] -= field_map.spacing[0]
        cells[0] += 1
    arrays = [None if v is None else padded(v, mirrored) for v in (field_map.electric, field_map.magnetic)]
    spacing = list(field_map.spacing)
    if field_map.axisymmetric:  # one node along the middle axis, which is not looked at
        lower, spacing = ([pair[0], 0.0, pair[1]] for pair in (lower, spacing))
        cells, before = ([pair[0], 0, pair[1]] for pair in (cells, before))
        arrays = [None if v is None else v[:, None] for v in arrays]
    electric, magnetic = arrays
    return _native.MapField(
        field_map.axisymmetric, lower, spacing, cells, before, electric, magnetic, scale, omega, phase
    )


def nodes_through_axis(field_map: field_maps.FieldMap) -> int:
    """Return how many nodes beyond the axis those of a map determine by symmetry: its first is on it or half a spacing off."""
    return 1 if field_map.lower[0] < field_map.spacing[0] / 4 else 2


def padded(values: Array, mirrored: int) -> Array:
    """Return the values of a map with one more node at each end, by the parabola through three nodes, and a fourth component
    of zero; along the first axis with so many nodes before the first that mirror those behind: r and φ components change
    sign."""
    out = values
    for axis in range(values.ndim - 1):
        out = np.moveaxis(out, axis, 0)
        lower = 3 * out[0] - 3 * out[1] + out[2]
        upper = 3 * out[-1] - 3 * out[-2] + out[-3]
        before = lower[None]
        if axis == 0 and mirrored == 1:
            before = out[1:2] * (-1, -1, 1)
        if axis == 0 and mirrored == 2:
            before = out[1::-1] * (-1, -1, 1)
        out = np.moveaxis(np.concatenate([before, out, upper[None]]), 0, axis)
    return np.ascontiguousarray(np.concatenate([out, np.zeros((*out.shape[:-1], 1))], axis=-1))
