"""Arms that metal cuts in one box of cells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from amrpic.conductors.arms import CutArms, arms_of_boxes
from amrpic.conductors.conductor import Conductor
from amrpic.conductors.contacts import sentence
from amrpic.errors import InputError


def cut_arms(
    electrodes: Sequence[Conductor], lower: ArrayLike, shape: ArrayLike, origin: ArrayLike, spacing: ArrayLike
) -> CutArms:
    """Return those of a box of `shape` (3,) cells from the index `lower` (3,) on. InputError for electrodes that touch."""
    first = np.asarray(lower, np.int64)
    last = first + np.asarray(shape, np.int64) - 1
    arms, touching = arms_of_boxes(electrodes, [[*first, *last]], origin, spacing)
    if touching:
        raise InputError(sentence(electrodes, touching[0]))
    return arms


def of_box(arms: CutArms, number: int) -> CutArms:
    """Return those of one of several boxes."""
    solid = slice(*arms.first_solid[number : number + 2])
    cut = slice(*arms.first_cut[number : number + 2])
    return CutArms(
        arms.solid[solid],
        arms.solid_electrode[solid],
        arms.cell[cut],
        arms.theta[cut],
        arms.electrode[cut],
        arms.surface[cut],
        np.array([0, solid.stop - solid.start]),
        np.array([0, cut.stop - cut.start]),
    )
