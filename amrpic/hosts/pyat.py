"""Space charge as an element of a lattice of pyAT: `at.Element(name, PassMethod="amrpic.hosts.pyat", …)`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..space_charge.engine import SpaceCharge as Engine
from ..units import SPEED_OF_LIGHT

PASS_METHOD = "amrpic.hosts.pyat"


def space_charge(
    name: str, length: float, charge: float, mass: float, energy: float, charge_number: int = -1, **settings: Any
) -> Any:
    """Return an element that kicks for a path of `length` (m).

    `charge`: of each macroparticle, signed, C. `mass`, `energy`: rest energy and total energy of the reference particle, eV.
    `charge_number`: elementary charges of a real particle. `settings`: those of `amrpic.SpaceCharge`.
    """
    import at

    gamma0 = energy / mass
    if not gamma0 > 1:
        raise InputError(f"energy is {energy} eV, but mass {mass} eV; give the total energy, which lies above")
    return at.Element(
        name,
        PassMethod=PASS_METHOD,
        Length=0.0,
        path=length,
        macro_charge=charge,
        gamma0=gamma0,
        charge_to_mass=charge_number * SPEED_OF_LIGHT**2 / mass,
        charges=Engine(**settings),
    )


def trackFunction(rin: np.ndarray, elem: Any = None, **_: Any) -> np.ndarray:
    """Kick the particles rin (6, n): x, px/p₀, y, py/p₀, δ, ct, where ct > 0 is late; lost ones hold NaN. Changed in place."""
    beta0 = float(np.sqrt(1 - elem.gamma0**-2))
    kick = elem.charges.kick(
        rin[0],
        rin[2],
        rin[5] * -beta0,
        elem.macro_charge,
        elem.path,
        beta0,
        elem.gamma0,
        elem.charge_to_mass,
        alive=np.isfinite(rin[0]),
    )
    for row, change in zip((1, 3, 4), kick.T, strict=True):
        rin[row] += change
    return rin
