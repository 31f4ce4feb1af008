"""Hits: where particles on straight ways first meet electrodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..shapes.shape import columns
from ..shapes.spans import Floats, Ints
from .conductor import Conductor


class ElectrodeHits(NamedTuple):
    """Where segments first meet an electrode."""

    segment: Ints  # (m,), ascending
    electrode: NDArray[np.int32]  # (m,) the first one in the list where several are met at one place
    share: Floats  # (m,) of the segment until there, 0 to 1
    place: Floats  # (m, 3) m
    normal: Floats  # (m, 3) unit vector out of the metal
    cosine: Floats  # (m,) of the angle between the way and the normal into the metal: 1 for a hit head-on


def first_hits(electrodes: Sequence[Conductor], start: ArrayLike, end: ArrayLike) -> ElectrodeHits:
    """Return where segments between points (n, 3), m, first meet metal; at once, if they start in it."""
    begins, ends = columns("start", start).T, columns("end", end).T
    of_each = [electrode.shape.first_hits(begins, ends) for electrode in electrodes]
    count = [len(hits.segment) for hits in of_each]
    segment = np.concatenate([np.empty(0, np.int64), *(hits.segment for hits in of_each)])
    share = np.concatenate([np.empty(0), *(hits.share for hits in of_each)])
    normal = np.concatenate([np.empty((0, 3)), *(hits.normal for hits in of_each)])
    electrode = np.repeat(np.arange(len(electrodes), dtype=np.int32), count)
    order = np.lexsort((electrode, share, segment))
    first = order[np.unique(segment[order], return_index=True)[1]]
    segment, electrode, share, normal = segment[first], electrode[first], share[first], normal[first]
    way = ends[segment] - begins[segment]
    length = np.linalg.norm(way, axis=1)
    cosine = -(way * normal).sum(axis=1) / np.where(length > 0, length, 1.0)
    return ElectrodeHits(segment, electrode, share, begins[segment] + share[:, None] * way, normal, cosine)
