"""The mesh follows the particles: the base level at first, refined as the scene's rule asks."""

from __future__ import annotations

import numpy as np

from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..particles.particles import Particles
from ..scene.scene import Scene
from ..space_charge import self_field
from ..space_charge.tagging_rules import refined, tags_of
from ..stages.tag import Tags, living, tagged
from .limits import require_room
from .memory import Share, base_boxes
from .meshed import MeshedParticles
from .rule_quantities import Quantities
from .setup import Setup
from .solution import Solution
from .state import State


def make_base(comm: MPI.Comm, scene: Scene) -> Hierarchy:
    """Return the hierarchy of the base level alone, if the machine can hold it with the particles. Collective."""
    require_room(comm, scene, base_boxes(scene), scene.particle_count(), "domain.cells")
    refinement = scene.refinement
    return Hierarchy(comm, scene.domain.value, (), refinement.max_grid_size, refinement.blocking_factor)


def regrid_if_due(beam: MeshedParticles, state: State, setup: Setup) -> MeshedParticles:
    """Return the particles of the step after a state on a mesh that is refined anew, if that is due. Collective.

    It is due every so many steps, and where too many particles have outrun the mesh.
    """
    refinement = setup.scene.refinement
    quantities = Quantities(beam, state.solution, setup)
    if refinement.regrids_at(state.step + 1) or _outrun(quantities, setup):
        quantities = _follow(quantities, state.solution, setup, refinement.hysteresis)
    return quantities.beam


def follow(beam: MeshedParticles, last: Solution | None, setup: Setup, hysteresis: float = 1.0) -> MeshedParticles:
    """Return the particles sorted on a mesh that is refined where the rule asks for it. Collective.

    `last`: the solution of the step before, if there is one. What is refined already stays while the rule asks for it with
    thresholds down to `hysteresis` of themselves.
    """
    return _follow(Quantities(beam, last, setup), last, setup, hysteresis).beam


def _follow(quantities: Quantities, last: Solution | None, setup: Setup, hysteresis: float) -> Quantities:
    """Return the same for what is known of the particles already."""
    with setup.clock("regrid"):
        return self_field.follow(
            quantities,
            setup.scene.refinement.levels,
            lambda present: _refined(present, setup, hysteresis),
            lambda present, hierarchy: Quantities(present.beam.on(hierarchy, setup), last, setup),
        )


def _outrun(quantities: Quantities, setup: Setup) -> bool:
    """Return whether more particles than the scene allows lie in cells that the rule wants finer than they are. Collective."""
    refinement = setup.scene.refinement
    if refinement.regrid_outrun is None:
        return False
    with setup.clock("regrid"):
        tags = tags_of(refinement.rule, quantities)
        numbers = living(quantities["particles_per_cell"])[: refinement.levels]
        slow = int(sum(number[tags[level]].sum() for level, number in enumerate(numbers)))
        behind, all_ = setup.comm.allreduce(np.array([slow, len(quantities.particles)]))
    return bool(behind > refinement.regrid_outrun * all_)


def _refined(quantities: Quantities, setup: Setup, hysteresis: float) -> Hierarchy:
    """Return the hierarchy that the rule asks for. Collective."""
    hierarchy, tags = refined(quantities, setup.scene.refinement, hysteresis)
    if tags is not None:
        _remark_on_tags(tags, quantities, setup)
    if hierarchy is not quantities.hierarchy:
        _require_room(hierarchy, quantities.particles, setup)
    return hierarchy


def _require_room(hierarchy: Hierarchy, particles: Particles, setup: Setup) -> None:
    """Raise SceneError on all ranks if a rank's machine cannot hold its cells of a new hierarchy and its particles."""
    boxes = [hierarchy.boxes(level) for level in range(hierarchy.levels)]
    share = Share(setup.comm.rank, hierarchy.own_cells, len(particles))
    require_room(setup.comm, setup.scene, boxes, particles.global_count(setup.comm), "the refined hierarchy", share)


def _remark_on_tags(tags: Tags, quantities: Quantities, setup: Setup) -> None:
    comm, hierarchy, count = setup.comm, quantities.hierarchy, tagged(setup.comm, tags)[0]
    rule, unless = "refinement.rule tags", "its thresholds if that is not meant"
    if count == 0 and hierarchy.levels == 1 and quantities.particles.global_count(comm) > 0:
        setup.remarks.remark(f"{rule} no cell, so nothing is refined; lower {unless}")
    elif count == hierarchy.cells(0):
        setup.remarks.remark(f"{rule} every cell, so all of the domain is refined; raise {unless}")
