"""The mesh follows the particles: the base level at first, refined as the scene's rule asks."""

from __future__ import annotations

import numpy as np

from ..mesh.hierarchy import Hierarchy
from ..space_charge.tagging_rules import refined, tags_of
from ..stages.tag import Tags, living, tagged
from .limits import require_room
from .memory import Share, base_boxes
from .particle_fields import ParticleFields
from .plan import Plan


def make_base(plan: Plan) -> Hierarchy:
    """Return the hierarchy of the base level alone, if the machine can hold it with the particles. Collective."""
    scene = plan.scene
    require_room(plan.comm, scene, base_boxes(scene), scene.particle_count(), "domain.cells")
    refinement = scene.refinement
    return Hierarchy(plan.comm, scene.domain.value, (), refinement.max_grid_size, refinement.blocking_factor)


def follow(fields: ParticleFields, hysteresis: float = 1.0) -> ParticleFields:
    """Return the particles sorted on a mesh that is refined where the rule asks for it. Collective.

    What is refined already stays while the rule asks for it with thresholds down to `hysteresis` of themselves. Tags reach
    one level up at a time, and what cells hold changes with the mesh, so it goes on until the mesh stays.
    """
    with fields.plan.clock("regrid"):
        for _ in range(2 * fields.plan.scene.refinement.levels):  # not for ever, where a rule goes round in circles
            made = _refined(fields, hysteresis)
            if made is fields.hierarchy:
                break
            fields = fields.on(made)
    return fields


def outrun(fields: ParticleFields) -> bool:
    """Return whether more particles than the scene allows lie in cells that the rule wants finer than they are. Collective."""
    plan, refinement = fields.plan, fields.plan.scene.refinement
    if refinement.regrid_outrun is None:
        return False
    with plan.clock("regrid"):
        tags = tags_of(refinement.rule, fields)
        numbers = living(fields.particles_per_cell)[: refinement.levels]
        slow = int(sum(held[tags[level]].sum() for level, held in enumerate(numbers)))
        behind, all_ = plan.comm.allreduce(np.array([slow, len(fields.particles)]))
    return bool(behind > refinement.regrid_outrun * all_)


def _refined(fields: ParticleFields, hysteresis: float) -> Hierarchy:
    """Return the hierarchy that the rule asks for. Collective."""
    made, tags = refined(fields, fields.plan.scene.refinement, hysteresis)
    if tags is not None:
        _remark_on_tags(tags, fields)
    if made is not fields.hierarchy:
        _require_room(made, fields)
    return made


def _require_room(made: Hierarchy, fields: ParticleFields) -> None:
    """Raise SceneError on all ranks if a rank's machine cannot hold its cells of a new hierarchy and its particles."""
    plan, particles = fields.plan, fields.particles
    boxes = [made.boxes(level) for level in range(made.levels)]
    held = Share(plan.comm.rank, made.own_cells, len(particles))
    require_room(plan.comm, plan.scene, boxes, particles.global_count(plan.comm), "the refined hierarchy", held)


def _remark_on_tags(tags: Tags, fields: ParticleFields) -> None:
    plan, count = fields.plan, tagged(fields.plan.comm, tags)[0]
    rule, unless = "refinement.rule tags", "its thresholds if that is not meant"
    if count == 0 and fields.hierarchy.levels == 1 and fields.particles.global_count(plan.comm) > 0:
        plan.remark(f"{rule} no cell, so nothing is refined; lower {unless}")
    elif count == fields.hierarchy.cells(0):
        plan.remark(f"{rule} every cell, so all of the domain is refined; raise {unless}")
