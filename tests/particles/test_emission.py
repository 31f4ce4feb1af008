"""Momenta of emission against their known means."""

from __future__ import annotations

import numpy as np
import pytest

from amrpic.particles import emission
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE

EV = ELEMENTARY_CHARGE
COUNT = 200_000
U = np.random.default_rng(5).uniform(size=(3, COUNT))


@pytest.mark.parametrize(
    ("momenta", "mte", "normal"),
    [
        (emission.thermal(U, 0.1 * EV, ELECTRON_MASS), 0.1, 0.1),
        (emission.isotropic(U, 0.6 * EV, ELECTRON_MASS), 0.4, 0.2),
        (emission.lambert(U, 0.6 * EV, ELECTRON_MASS), 0.3, 0.3),
        (emission.three_step(U, 4.65 * EV, 4.31 * EV, 7.0 * EV, ELECTRON_MASS), 0.34 / 3, None),
    ],
)
def test_mean_energies_are_known(momenta, mte, normal):
    along, across = momenta[0] ** 2, (momenta[1:] ** 2).sum(axis=0)
    for values, mean in ((across, mte), (along, normal)):
        energies = values / (2 * ELECTRON_MASS * EV)
        if mean is not None:
            error = energies.std() / np.sqrt(COUNT)
            assert abs(energies.mean() - mean) < 5 * error + 2e-4 * mean
    assert (momenta[0] >= 0).all()
