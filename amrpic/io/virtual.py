"""Virtual datasets: rows that lie elsewhere in a file or beside it, shown in another shape. They take no room of their own."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import h5py
import numpy as np

DOUBLE = np.dtype("<f8")


class RowSource(NamedTuple):
    """Rows of a dataset, all of them or one column of theirs."""

    dataset: str  # its path in the file
    shape: tuple[int, ...]  # of the whole dataset
    first: int
    rows: int
    column: int | None = None  # of rows with several


def show(
    h5: h5py.File, name: str, shape: tuple[int, ...], mappings: Iterable[tuple[Any, Any, RowSource]], file: str = "."
) -> h5py.Dataset:
    """Make a dataset of doubles whose boxes, each (first index, size, source), show rows of a source; the rest is nan.

    The elements of a box, last index fastest, are the rows in their order. `file` names the source's file, by default this one;
    relative names start at the folder of `h5`.
    """
    creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    creation.set_fill_value(np.array(np.nan, DOUBLE))
    for first, size, source in mappings:
        box_space = h5py.h5s.create_simple(shape)
        box_space.select_hyperslab(tuple(map(int, first)), tuple(map(int, size)))
        source_space = h5py.h5s.create_simple(source.shape)
        column = () if source.column is None else (source.column,)
        source_space.select_hyperslab((source.first, *column), (source.rows, *(1 for _ in column)))
        creation.set_virtual(box_space, file.encode(), source.dataset.encode(), source_space)
    links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    links.set_create_intermediate_group(True)
    kind, space = h5py.h5t.py_create(DOUBLE, logical=True), h5py.h5s.create_simple(shape)
    return h5py.Dataset(h5py.h5d.create(h5.id, name.encode(), kind, space, dcpl=creation, lcpl=links))
