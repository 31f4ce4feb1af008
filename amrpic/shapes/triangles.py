"""Surfaces of triangles: read from STL files, repaired, closed."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from .. import _native
from ..arithmetic import is_number
from ..errors import InputError
from .spans import Floats, Ints

HEADER, RECORD = 80, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# Corners on open edges that are nearer to each other than this share of the body are one: files round them.
SAME = 1e-6
# Of the surface, in holes: more is no small hole.
MOST_OPEN = 0.05


class Report(NamedTuple):
    """What a surface was like before it was repaired."""

    triangles: int
    degenerate: int  # without area, dropped
    duplicates: int  # dropped
    flipped: int  # turned round
    open_edges: int  # that other than two triangles share, after that
    holes: int  # closed by fans
    hole_area: float  # of the fans, m²
    area: float  # of the surface, m²

    def __str__(self) -> str:
        words = [
            f"{count} {defect}"
            for count, defect in (
                (self.degenerate, "without area"),
                (self.duplicates, "twice"),
                (self.flipped, "flipped"),
            )
            if count
        ]
        text = f"{self.triangles} triangles" + (f" ({', '.join(words)})" if words else "")
        if not self.open_edges:
            return f"{text}, closed"
        return (
            f"{text}, {self.open_edges} open edges around {self.holes} holes of {self.hole_area:.3g} m² in all, closed"
        )


@dataclass(frozen=True, eq=False)
class TriangleSurface:
    """Triangles that close a body, the same whatever their order in a file was."""

    corners: Floats  # (n, 3, 3) m, counter-clockwise seen from outside
    weight: NDArray[np.int32]  # (n,) how often each counts
    report: Report


def read_stl(path: str | os.PathLike[str]) -> Floats:
    """Return the corners (n, 3, 3) of an STL file, binary or text, as they stand there. Raises InputError."""
    try:
        data = Path(path).read_bytes()
    except OSError as reason:
        raise InputError(f"Mesh: {path} cannot be read ({reason.strerror}); check the path") from None
    count = int.from_bytes(data[HEADER : HEADER + 4], "little") if len(data) >= HEADER + 4 else 0
    expected = HEADER + 4 + count * RECORD.itemsize
    if (
        data.lstrip()[:5].lower() == b"solid"
        and len(data) != expected
        and b"facet" in data[:4096].lower() + data[-4096:]
    ):
        return read_text(path, data)
    if len(data) < HEADER + 4:
        raise InputError(f"Mesh: {path} has {len(data)} bytes, too few for an STL file; export it again")
    if len(data) < expected:
        raise InputError(
            f"Mesh: {path} has {len(data)} bytes, but its {count} triangles need {expected}; it is cut off or "
            "no STL file: export it again"
        )
    return np.frombuffer(data, RECORD, count, HEADER + 4)["corners"].astype(float)


def read_text(path: str | os.PathLike[str], data: bytes) -> Floats:
    """Return the corners (n, 3, 3) of an STL file of text. Raises InputError."""
    text = data.lower()
    rows = re.findall(rb"vertex((?:[ \t]+\S+){3})[ \t\r]*$", text, re.MULTILINE)
    facets = len(re.findall(rb"^[ \t]*facet\b", text, re.MULTILINE))
    try:
        corners = np.array(b" ".join(rows).split(), float).reshape(-1, 3)
    except ValueError:
        corners = np.empty((0, 3))
    if len(corners) == 3 * facets and len(rows) == text.count(b"vertex"):
        return corners.reshape(-1, 3, 3)
    for number, line in enumerate(text.split(b"\n"), 1):
        words = line.split()
        if words[:1] == [b"vertex"] and not (len(words) == 4 and all(map(is_number, words[1:]))):
            excerpt = line.decode(errors="replace").strip()[:60]
            raise InputError(f'Mesh: {path} has "{excerpt}" in line {number}; write "vertex" and three numbers')
    raise InputError(
        f"Mesh: {path} has {len(rows)} corners in {facets} facets; each needs three, so it may be cut off: export it again"
    )


def closed(where: str, corners: Floats) -> TriangleSurface:
    """Return a closed surface of triangles (n, 3, 3), repaired; holes are filled. Raises InputError."""
    if not len(corners):
        raise InputError(f"{where} has no triangles; export it again, with its surface")
    if not np.isfinite(corners).all():
        row = int(np.argmin(np.isfinite(corners).all(axis=(1, 2))))
        raise InputError(f"{where}: triangle {row} has a corner that is not finite; export it again")
    points, triangles = welded(corners)
    sides = points[triangles]
    doubled = np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
    # One without area still closes a gap where it joins a long edge to two short ones: only true edges are dropped.
    degenerate = (
        (triangles[:, 0] == triangles[:, 1])
        | (triangles[:, 1] == triangles[:, 2])
        | (triangles[:, 2] == triangles[:, 0])
    )
    triangles, area = triangles[~degenerate], float(doubled.sum() / 2)
    triangles, duplicates = without_duplicates(triangles)
    if not area:
        raise InputError(f"{where}: its {len(corners)} triangles have no area; export it again")
    as_given = triangles
    triangles = outward(points, *oriented(triangles))
    flipped = int((triangles != as_given).any(axis=1).sum())
    fans, weight, holes, edges = filled(points, triangles)
    hole_area = float(np.linalg.norm(np.cross(fans[:, 1] - fans[:, 0], fans[:, 2] - fans[:, 0]), axis=1) @ weight / 2)
    report = Report(len(corners), int(degenerate.sum()), duplicates, flipped, edges, holes, hole_area, area)
    if hole_area > MOST_OPEN * area:
        raise InputError(
            f"{where}: its surface of {area:.3g} m² has {edges} open edges around holes of {hole_area:.3g} m²; "
            "close them, or give it as a foil (foil=True)"
        )
    sides = np.concatenate([points[canonical(triangles)], fans])
    weights = np.concatenate([np.ones(len(triangles), np.int32), weight.astype(np.int32)])
    if volumes(sides) @ weights < 1e-12 * area * np.ptp(points, axis=0).max():
        raise InputError(
            f"{where}: its triangles enclose no volume; close the surface, or give it as a foil (foil=True)"
        )
    return TriangleSurface(sides, weights, report)


def as_foil(where: str, corners: Floats) -> TriangleSurface:
    """Return triangles (n, 3, 3) as they are, for a foil. Raises InputError."""
    if not len(corners) or not np.isfinite(corners).all():
        closed(where, corners)
    points, triangles = welded(corners)
    sides = points[canonical(without_duplicates(triangles)[0])]
    area = float(np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1).sum() / 2)
    report = Report(len(corners), 0, len(corners) - len(sides), 0, 0, 0, 0.0, area)
    return TriangleSurface(sides, np.ones(len(sides), np.int32), report)


def welded(corners: Floats) -> tuple[Floats, Ints]:
    """Return the different corners (m, 3), in order, and triangles (n, 3) of their numbers; near ones on open edges are one."""
    first, number = unique_rows(corners.reshape(-1, 3))
    points, triangles = corners.reshape(-1, 3)[first], number.reshape(-1, 3)
    loose = np.unique(open_edges(triangles)[0])
    if len(loose):
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        pairs = scipy.spatial.cKDTree(points[loose]).query_pairs(SAME * size, output_type="ndarray")
        if len(pairs):
            _, group = groups(pairs, len(loose))
            _, first = np.unique(group, return_index=True)
            to = np.arange(len(points))
            to[loose] = loose[first[group]]
            triangles = to[triangles]
    return points, triangles


def groups(pairs: Ints, count: int) -> tuple[int, Ints]:
    """Return how many groups pairs (n, 2) join `count` things to, and the group of each."""
    links = scipy.sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    number, group = scipy.sparse.csgraph.connected_components(links, directed=False)
    return int(number), group


def edges_of(triangles: Ints) -> Ints:
    """Return the directed edges (3 n, 2) of triangles (n, 3), one side of all of them after the other."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def open_edges(triangles: Ints) -> tuple[Ints, Ints]:
    """Return directed edges (m, 2) that go one way more often than the other, and how much more often (m,)."""
    edges = edges_of(triangles)
    forwards = edges[:, 0] < edges[:, 1]
    first, number = unique_rows(np.sort(edges, axis=1))
    ends = np.sort(edges[first], axis=1)
    excess = np.bincount(number, np.where(forwards, 1, -1), len(ends)).astype(np.int64)
    excess[ends[:, 0] == ends[:, 1]] = 0
    chosen = np.flatnonzero(excess)
    backwards = excess[chosen] < 0
    return np.where(backwards[:, None], ends[chosen][:, ::-1], ends[chosen]), abs(excess[chosen])


def oriented(triangles: Ints) -> tuple[Ints, Ints]:
    """Return triangles turned so that neighbours agree, as most of each piece are, and the piece of each."""
    edges = edges_of(triangles)
    owner = np.tile(np.arange(len(triangles)), 3)
    _, number = unique_rows(np.sort(edges, axis=1))
    pairs = np.argsort(number, kind="stable")
    pairs = pairs[(np.bincount(number) == 2)[number[pairs]]].reshape(-1, 2)
    first_owner, second_owner = owner[pairs].T
    against = (edges[pairs[:, 0]] == edges[pairs[:, 1]]).all(axis=1)  # both go the same way along their edge
    n = len(triangles)
    # 1: they agree, 2: they do not; each pair of triangles once.
    keys, first = np.unique(
        np.minimum(first_owner, second_owner) * n + np.maximum(first_owner, second_owner), return_index=True
    )
    links = scipy.sparse.coo_matrix((np.where(against[first], 2, 1), (keys // n, keys % n)), shape=(n, n)).tocsr()
    links = links + links.T
    pieces, piece = scipy.sparse.csgraph.connected_components(links, directed=False)
    turned = np.zeros(n, bool)
    wrong = np.zeros(pieces, bool)
    wrong[piece[first_owner[against]]] = True
    for start in np.unique(piece, return_index=True)[1][wrong]:
        order, before = scipy.sparse.csgraph.breadth_first_order(links, start, directed=False)
        if len(order) > 1:
            differs = np.asarray(links[before[order[1:]], order[1:]]).ravel() == 2
            for triangle, parent, differ in zip(order[1:], before[order[1:]], differs, strict=True):
                turned[triangle] = turned[parent] ^ differ
        if 2 * turned[order].sum() > len(order):
            turned[order] = ~turned[order]
    return np.where(turned[:, None], triangles[:, ::-1], triangles), piece.astype(np.int64)


def outward(points: Floats, triangles: Ints, piece: Ints) -> Ints:
    """Return triangles with pieces that are inside out turned, unless they lie in other pieces: hollows in these."""
    parts = volumes(points[triangles])
    if parts.sum() < 0:
        triangles, parts = triangles[:, ::-1], -parts
    inside_out = np.bincount(piece, parts) < 0
    if not inside_out.any():
        return triangles
    upright = np.where(inside_out[piece][:, None], triangles[:, ::-1], triangles)
    chosen = np.flatnonzero(inside_out[piece])
    corner, owner = points[upright[chosen, 0]], piece[chosen]
    surface = _native.Triangles(points[upright].reshape(-1, 9), np.ones(len(upright), np.int32))
    line, parameter, depth, met, _ = surface.crossings(corner, np.tile((1.0, 0.0, 0.0), (len(corner), 1)))
    before = (parameter < 0) & (piece[met] != owner[line])
    free = np.bincount(line[before], depth[before], len(corner)) <= 0
    hollow = inside_out.copy()
    hollow[owner[free]] = False
    return np.where(hollow[piece][:, None], triangles, upright)


def filled(points: Floats, triangles: Ints) -> tuple[Floats, Ints, int, int]:
    """Return triangles (m, 3, 3) that close all holes, how often each counts, the number of holes and of open edges.

    Each hole gets a fan around the middle of its edges. The edges of the fan go against the open ones, so that in the
    end every edge goes both ways equally often, whatever was wrong.
    """
    edges, excess = open_edges(triangles)
    if not len(edges):
        return np.empty((0, 3, 3)), np.empty(0, np.int64), 0, 0
    corners, number = np.unique(edges, return_inverse=True)
    number = number.reshape(-1, 2)
    holes, hole = groups(number, len(corners))
    hole = hole[number[:, 0]]
    ends = points[edges]
    sums = np.stack([np.bincount(hole, ends.mean(axis=1)[:, axis], holes) for axis in range(3)], axis=1)
    middle = sums / np.bincount(hole, minlength=holes)[:, None]
    return np.stack([ends[:, 1], ends[:, 0], middle[hole]], axis=1), excess, holes, len(edges)


def volumes(corners: Floats) -> Floats:
    """Return parts of the volume that triangles (n, 3, 3) enclose, negative if they are seen from inside."""
    a, b, c = np.swapaxes(corners - corners.reshape(-1, 3).mean(axis=0), 0, 1)
    return np.asarray((a * np.cross(b, c)).sum(axis=1) / 6)


def canonical(triangles: Ints) -> Ints:
    """Return triangles (n, 3) that begin at their lowest corner and go round as before, in order: whatever it was before."""
    first = triangles.argmin(axis=1)[:, None]
    rolled = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    return rolled[np.lexsort(rolled.T[::-1])]


def without_duplicates(triangles: Ints) -> tuple[Ints, int]:
    """Return triangles (n, 3) of which no two have the same corners, and how many were dropped."""
    first, _ = unique_rows(np.sort(triangles, axis=1))
    return triangles[np.sort(first)], len(triangles) - len(first)


def unique_rows(rows: NDArray[Any]) -> tuple[Ints, Ints]:
    """Return which rows (n, k) come first of their kind, in the order of their values, and the kind of each row."""
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    fresh = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1)])[: len(rows)]
    kind = np.empty(len(rows), np.int64)
    kind[order] = np.cumsum(fresh) - 1
    return order[fresh], kind
