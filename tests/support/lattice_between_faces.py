"""The exact potential of the 7-point Laplacian between open faces, walls and periodic faces, in NumPy and SciPy alone.

The lattice does not end at open faces. The potential is the integral over time of three heat kernels, one per axis, times
the charges: kernels of the infinite lattice for open axes, with one mirror image beside a wall, and finite sums of waves
where two walls or a period bound the axis. Dirichlet walls have linear ghosts here: the potential changes its sign from
the first cell to its ghost. Charges come per cell, in units of ε₀.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from exact.lattice import heat_kernel

Faces = tuple[tuple[str, str], tuple[str, str], tuple[str, str]]
SIGNS = {"dirichlet": -1, "neumann": 1}  # of the image in a wall


class LatticeBetweenFaces:
    """Potentials of charges in the cells of a box, one face of which at least is open.

    Without a Dirichlet face, zero is fixed by the lattice alone: with one axis between two walls or periodic, of period P,
    φ → -(λ/2π) ln(ρ/P), λ the charge per length; with two such axes φ → -σ|z|/2, σ the charge per area, images included.
    """

    def __init__(self, cells: Sequence[int], spacing: Sequence[float], boundary: Faces) -> None:
        self.cells, self.spacing, self.boundary = tuple(cells), np.array(spacing, dtype=float), boundary
        width = max((n + 1) * h for n, h in zip(self.cells, self.spacing, strict=True))
        self.times, self.weights = quadrature(0.25 * self.spacing.min() ** 2, 64 * width**2)
        self.kernels = [
            axis_kernel(n, faces, 2 * self.times / h**2)
            for n, faces, h in zip(self.cells, boundary, self.spacing, strict=True)
        ]

    def __call__(self, charges: np.ndarray) -> np.ndarray:
        """Potential (..., nx + 2, ny + 2, nz + 2) of charges (..., nx, ny, nz), ghosts on all sides included."""
        charged = [
            np.flatnonzero(np.moveaxis(charges, axis, 0).any(axis=tuple(range(1, charges.ndim))))
            for axis in (-3, -2, -1)
        ]
        cells = np.ix_(*charged)
        used = charges[..., cells[0], cells[1], cells[2]]
        kernels = [np.ascontiguousarray(k[:, :, cells]) for k, cells in zip(self.kernels, charged, strict=True)]
        shape = tuple(n + 2 for n in self.cells)
        potential = np.zeros((*charges.shape[:-3], *shape))
        for weight, kx, ky, kz in zip(self.weights, *kernels, strict=True):
            along_x = kx @ used.reshape(*used.shape[:-2], used.shape[-2] * used.shape[-1])
            along_xy = ky @ along_x.reshape(*along_x.shape[:-1], *used.shape[-2:])
            potential += along_xy @ (weight * kz.T)
        potential /= np.prod(self.spacing)
        return potential - charges.sum(axis=(-3, -2, -1))[..., None, None, None] * self._background()

    def between(self, place: Sequence[int], charge: Sequence[int]) -> float:
        """Potential at a cell of a unit charge in another one."""
        product = np.prod([k[:, i + 1, j] for k, i, j in zip(self.kernels, place, charge, strict=True)], axis=0)
        return float(self.weights @ product / np.prod(self.spacing) - self._background())

    def _background(self) -> float:
        return background(self.boundary, self.spacing * self.cells, self.times, self.weights)


def background(boundary: Faces, lengths: np.ndarray, times: np.ndarray, weights: np.ndarray) -> float:
    """What the integral over so many times of a unit charge is too large by where no face holds the potential.

    At late times the heat kernels of a net charge are those of a line or a sheet, whose integral over time diverges. One of
    these at a distance P is subtracted at all times: ∫ (exp(-ρ²/4t) - exp(-P²/4t)) dt/4πt = -ln(ρ/P)/2π, and
    ∫ (exp(-z²/4t) - exp(-P²/4t)) dt/√(4πt) = (P - |z|)/2.
    """
    is_open = ["open" in faces for faces in boundary]
    if all(is_open) or any("dirichlet" in faces for faces in boundary):
        return 0.0
    closed = is_open.index(False)
    period = lengths[closed] * (1 if "periodic" in boundary[closed] else 2)
    images = 2.0 ** sum("open" in faces and "neumann" in faces for faces in boundary)
    per_area = images / np.prod(lengths, where=np.logical_not(is_open))
    late = (4 * np.pi * times) ** (-sum(is_open) / 2) * np.exp(-(period**2) / (4 * times))
    return float(per_area * (weights @ late + (0.0 if sum(is_open) == 2 else period / 2)))


def quadrature(shortest: float, late: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights over all times for sums of exponentials that are series in 1/√t after `late`: Gauss-Legendre over
    intervals that double from `shortest`, and over 1/√t at the end."""
    x, w = np.polynomial.legendre.leggauss(12)
    x, w = (x + 1) / 2, w / 2
    times, weights = [], []
    start, length = 0.0, shortest
    while start < late:
        times.append(start + length * x)
        weights.append(length * w)
        start, length = start + length, start + length
    inverse_root = start**-0.5 * x
    times.append(inverse_root**-2)
    weights.append(start**-0.5 * w * 2 * inverse_root**-3)
    return np.concatenate(times), np.concatenate(weights)


def axis_kernel(n: int, faces: tuple[str, str], x: np.ndarray) -> np.ndarray:
    """Heat kernel at the cells -1 .. n for a start in the cells 0 .. n - 1, at times x/2 in units of h²: (x.size, n + 2, n)."""
    place, start = np.arange(-1, n + 1)[:, None], np.arange(n)
    lower, upper = (SIGNS.get(face, 0) for face in faces)
    if lower and upper:
        period = 2 * n if lower == upper else 4 * n
        copies = [(1, place - start), (lower, place + start + 1)]
        if lower != upper:
            copies += [(-sign, offset + 2 * n) for sign, offset in copies]
        waves = ring_kernel(period, x)
        out = sum(sign * waves[offset % period] for sign, offset in copies)
    elif faces[0] == "periodic":
        out = ring_kernel(n, x)[(place - start) % n]
    else:
        line = heat_kernel(2 * n, x)
        out = line[abs(place - start)] + lower * line[place + start + 1] + upper * line[2 * n - 1 - place - start]
    return np.ascontiguousarray(np.moveaxis(out, -1, 0))


def ring_kernel(n: int, x: np.ndarray) -> np.ndarray:
    """Heat kernel on a ring of n cells, at the cells 0 .. n - 1 for a start in cell 0: (n, x.size)."""
    turns = 2 * np.pi * np.arange(n) / n
    return np.cos(np.outer(np.arange(n), turns)) @ np.exp(-np.outer(1 - np.cos(turns), x)) / n


# ---- ghosts at open faces, and the potential in the box that they make ----


def counted_at_ghosts(charges: np.ndarray, boundary: Faces) -> np.ndarray:
    """Charges (..., nx, ny, nz) as they act on ghosts far away where Dirichlet walls have quadratic ghosts: 3/4 in the first
    layer there, exactly."""
    out = charges.copy()
    for axis, side in itertools.product(range(3), (0, 1)):
        if boundary[axis][side] == "dirichlet":
            np.moveaxis(out, axis - 3, 0)[-side] *= 0.75
    return out


def ghost_errors(
    ghosts: Sequence[np.ndarray],
    exact: np.ndarray,
    of_magnitudes: np.ndarray,
    spacing: Sequence[float],
    boundary: Faces,
) -> dict[str, float]:
    """How far ghosts at open faces are from an exact potential, and what potential and field the difference makes.

    Of the largest values of the potential that the magnitudes of the charges make.
    """
    missing = [
        np.where(boundary[face // 2][face % 2] == "open", found - wanted, 0.0)
        for face, (found, wanted) in enumerate(zip(ghosts, ghosts_of(exact), strict=True))
    ]
    inside = of_magnitudes[1:-1, 1:-1, 1:-1]
    phi, field = solved(np.zeros(inside.shape), spacing, boundary, missing)
    largest = float(np.abs(of_magnitudes).max()) or 1.0
    largest_field = float(np.abs(field_of(inside, spacing, boundary, ghosts_of(of_magnitudes))).max()) or 1.0
    return {
        "ghosts": max(float(np.abs(values).max()) for values in missing) / largest,
        "phi": float(np.abs(phi).max()) / largest,
        "field": float(np.abs(field).max()) / largest_field,
    }


def ghosts_of(potential: np.ndarray) -> list[np.ndarray]:
    """The six layers of ghost cells of a potential that has them, (lower, upper) per axis, edges left out."""
    inside = (slice(1, -1),) * 3
    return [potential[tuple(end if d == axis else inside[d] for d in range(3))] for axis in range(3) for end in (0, -1)]


def solved(
    charges: np.ndarray,
    spacing: Sequence[float],
    boundary: Faces,
    ghosts: Sequence[np.ndarray],
    quadratic: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Potential (nx, ny, nz) and field (3, nx, ny, nz) of charges, with given ghosts at open faces (as `ghosts_of`).

    By the eigenvectors of the second difference along each axis. Ghosts at Dirichlet walls are linear, or `quadratic`:
    -2 times the first cell plus a third of the second.
    """
    h = np.array(spacing, dtype=float)
    value = charges / np.prod(h)
    for axis in range(3):
        for side in (0, 1):
            if boundary[axis][side] == "open":
                np.moveaxis(value, axis, 0)[-side] += ghosts[2 * axis + side] / h[axis] ** 2
    waves = [
        np.linalg.eig(minus_second_difference(n, faces, quadratic) / d**2)
        for n, faces, d in zip(charges.shape, boundary, h, strict=True)
    ]
    symbol = sum(np.ix_(*(found.eigenvalues for found in waves)))
    into = [np.linalg.inv(found.eigenvectors) for found in waves]
    value = np.einsum("ia,jb,kc,abc->ijk", *into, value, optimize=True) / symbol
    phi = np.einsum("ia,jb,kc,abc->ijk", *(found.eigenvectors for found in waves), value, optimize=True)
    return phi, field_of(phi, spacing, boundary, ghosts, quadratic)


def minus_second_difference(n: int, faces: tuple[str, str], quadratic: bool) -> np.ndarray:
    """Its matrix for cells of width 1, with the ghosts at walls and periodic faces put in."""
    matrix = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    for face, first, second, last in ((faces[0], 0, 1, n - 1), (faces[1], n - 1, n - 2, 0)):
        if face == "periodic":
            matrix[first, last] -= 1
        for cell, weight in wall_ghost(face, quadratic):
            matrix[first, (first, second)[cell]] -= weight
    return matrix


def wall_ghost(face: str, quadratic: bool) -> tuple[tuple[int, float], ...]:
    """Weights of the first and second cell in the ghost behind a wall of potential or slope zero; none for other faces."""
    if face == "neumann":
        return ((0, 1.0),)
    if face == "dirichlet":
        return ((0, -2.0), (1, 1 / 3)) if quadratic else ((0, -1.0),)
    return ()


def field_of(
    phi: np.ndarray, spacing: Sequence[float], boundary: Faces, ghosts: Sequence[np.ndarray], quadratic: bool = False
) -> np.ndarray:
    """Central differences of -φ, with the ghosts of `solved`."""
    field = []
    for axis in range(3):
        cells = np.moveaxis(phi, axis, 0)
        ends = []
        for side, face in enumerate(boundary[axis]):
            inwards = cells[:: -1 if side else 1]
            if face == "open":
                ends.append(ghosts[2 * axis + side])
            elif face == "periodic":
                ends.append(inwards[-1])
            else:
                ends.append(sum(weight * inwards[cell] for cell, weight in wall_ghost(face, quadratic)))
        padded = np.concatenate([ends[0][None], cells, ends[1][None]])
        field.append(np.moveaxis(padded[:-2] - padded[2:], 0, axis) / (2 * spacing[axis]))
    return np.array(field)
