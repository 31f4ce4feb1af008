"""Space charge as an element of a line of Xsuite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import InputError
from ..space_charge.engine import SpaceCharge as Engine
from ..units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT


class SpaceCharge:
    """A kick by the field of all living particles for a path of `length` (m), where the element stands.

    Places are x, y and zeta, taken as z, at which the particles are at one time; the charge of each is weight · q0 e. With
    `longitudinal` it changes delta as well. `charges`: an `amrpic.SpaceCharge`, which several elements may share; one made
    with `settings` by default. Copies of a line copy settings, and share no mesh.
    """

    iscollective = True  # the tracker gives all particles at once
    isthick = False
    needs_cpu = True
    needs_hidden_lost_particles = True  # so that arrays hold the living alone

    def __init__(
        self, length: float, longitudinal: bool = True, charges: Engine | None = None, **settings: Any
    ) -> None:
        if charges is not None and settings:
            raise InputError(f"charges are given as well as {', '.join(settings)}; keep one of the two")
        self.length, self.longitudinal = length, longitudinal
        self.charges = Engine(**settings) if charges is None else charges

    def track(self, particles: Any) -> None:
        """Kick the particles. Collective over the ranks of the engine."""
        beta0, gamma0 = _reference(particles.beta0), _reference(particles.gamma0)
        ratio = particles.q0 * ELEMENTARY_CHARGE / (particles.mass0 * ELEMENTARY_CHARGE / SPEED_OF_LIGHT**2)
        kick = self.charges.kick(
            particles.x,
            particles.y,
            particles.zeta,
            particles.weight * (particles.q0 * ELEMENTARY_CHARGE),
            self.length,
            beta0,
            gamma0,
            particles.chi * ratio,
            alive=np.asarray(particles.state) > 0,
        )
        particles.px += kick[:, 0]
        particles.py += kick[:, 1]
        if self.longitudinal:
            particles.delta = particles.delta + kick[:, 2]  # keeps ptau, rvv and rpp right

    def copy(self, _context: Any = None, _buffer: Any = None, _offset: Any = None) -> SpaceCharge:
        """Return an element with the same settings, as lines ask for it."""
        return SpaceCharge.from_dict(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return what `from_dict` makes an element of."""
        return {
            "__class__": "SpaceCharge",
            "length": self.length,
            "longitudinal": self.longitudinal,
            **self.charges.settings,
        }

    @classmethod
    def from_dict(cls, of: Mapping[str, Any], **_: Any) -> SpaceCharge:
        """Return the element of `to_dict`."""
        return cls(**{name: value for name, value in of.items() if name != "__class__"})


def install_space_charge(line: Any, count: int, **settings: Any) -> list[SpaceCharge]:
    """Put so many elements into a line and return them: in the middles of equal parts of its length, and for the path of these.

    They share one engine. `settings`: those of `amrpic.SpaceCharge`, and `longitudinal`. Thick elements are cut.
    """
    path = line.get_length() / count
    elements = _sharing([path] * count, settings)
    names = [f"space_charge_{n}" for n in range(count)]
    line.discard_tracker()
    for name, element in zip(names, elements, strict=True):
        line.env.elements[name] = element
    line.insert([line.env.place(name, at=(n + 0.5) * path) for n, name in enumerate(names)])
    return elements


def replace_space_charge(line: Any, **settings: Any) -> list[SpaceCharge]:
    """Put elements into the places of those that `xfields.install_spacecharge_frozen` put into a line, and return them.

    They have the names and lengths of these, and share one engine; `settings` as above.
    """
    elements_by_name = line.element_dict
    names = [name for name in line.element_names if type(elements_by_name[name]).__name__.startswith("SpaceCharge")]
    if not names:
        raise InputError("the line has no elements of space charge; call xfields.install_spacecharge_frozen first")
    elements = _sharing([float(elements_by_name[name].length) for name in names], settings)
    line.discard_tracker()
    for name, element in zip(names, elements, strict=True):
        line.env.remove(name)
        line.env.elements[name] = element
    return elements


def _sharing(lengths: Sequence[float], settings: dict[str, Any]) -> list[SpaceCharge]:
    longitudinal = settings.pop("longitudinal", True)
    charges = Engine(**settings)
    return [SpaceCharge(length, longitudinal, charges) for length in lengths]


def _reference(values: Any) -> float:
    """Return what all particles have in common; InputError if they differ. 1 where there are none."""
    values = np.asarray(values)
    if len(values) > 0 and np.ptp(values) > 1e-12 * abs(values[0]):
        raise InputError("particles have different reference momenta (p0c); track them apart")
    return float(values[0]) if len(values) else 1.0
