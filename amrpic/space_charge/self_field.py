"""The field of charge on a mesh: what a step of a run and a call with arrays do between deposit and gather."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.mirror import Mirror
from ..particles.clouds import Clouds
from ..particles.frame import LABORATORY, Frame
from ..stages.gather import compensate
from ..stages.poisson import SolveReport
from .quantities import QuantitiesOnMesh
from .solvers import Solvers

Q = TypeVar("Q", bound=QuantitiesOnMesh)


def self_field(
    solvers: Solvers,
    rho: Field,
    guess: Field | None,
    clouds: Clouds,
    frame: Frame = LABORATORY,
    part: bool = False,
    mirror: Mirror | None = None,
    image: bool = False,
    **of_solve: Any,
) -> tuple[Field, VectorField, SolveReport]:
    """Return φ (V) of a density that rests in a frame, the E (V/m) that its particles feel, and how the solve went. Collective.

    Compensated clouds take back what they smooth, except of a `part` of the charge and of its `image`.
    Arguments as for `Solvers.solve`. SolverError if the solve does not converge.
    """
    phi, report = solvers.solve(rho, guess, frame, part, mirror=mirror, image=image, **of_solve)
    solver = solvers.poisson(rho.hierarchy, frame, part, mirror)
    efield = solver.deferred_field(phi, covered=clouds.covered)
    if not part and not image:
        compensate(efield, rho, clouds, solvers.stretch(frame))
    return phi, efield, report


def follow(quantities: Q, levels: int, refined: Callable[[Q], Hierarchy], on: Callable[[Q, Hierarchy], Q]) -> Q:
    """Return what is known of particles on a mesh, those of the mesh that is asked for. Collective.

    `refined`: the hierarchy that the rule asks for, the present one if it is that. `on`: the same particles on another one.
    Tags reach one level up at a time, and what cells hold changes with the mesh, so it goes on until the mesh stays.
    """
    for _ in range(2 * levels):  # not for ever, where a rule goes round in circles
        hierarchy = refined(quantities)
        if hierarchy is quantities.hierarchy:
            break
        quantities = on(quantities, hierarchy)
    return quantities
