"""The mesh follows the particles: the base level at first, refined as the scene's rule asks, its boxes shared out anew."""

from __future__ import annotations

import numpy as np

from .deposit import deposit
from .field import VectorField
from .hierarchy import Hierarchy
from .limits import require_room
from .memory import base_boxes
from .migrate import migrate, particles_per_box
from .particles import Particles
from .plan import Plan
from .regrid import Regridding, balance, regrid
from .scene import ChargeDensityRule, FieldStrengthRule, Scene, StaticRule
from .tag import Tags, by_density, by_field, static_boxes, tagged


def make_base(plan: Plan) -> Hierarchy:
    """Return the hierarchy of the base level alone, if the machine can hold it with the particles. Collective."""
    scene = plan.scene
    require_room(plan.comm, scene, base_boxes(scene), scene.particle_count(), "domain.cells")
    refinement = scene.refinement
    return Hierarchy(plan.comm, scene.domain.value, (), refinement.max_grid_size, refinement.blocking_factor)


def follow(
    particles: Particles, hierarchy: Hierarchy, plan: Plan, efield: VectorField | None = None
) -> tuple[Particles, Hierarchy]:
    """Return the particles sorted on a mesh that is refined where they ask for it. Collective.

    Tags add a level at a time, so it goes on while levels are added. `efield` is the field on the hierarchy as it comes in.
    """
    refinement = plan.scene.refinement
    if refinement.levels == 0:
        return particles, hierarchy
    while True:
        tags = _tags(particles, hierarchy, plan, efield)
        with plan.clock("regrid"):
            made = _refined(particles, hierarchy, tags, plan)
        grown = made.levels > hierarchy.levels
        if made is not hierarchy:
            with plan.clock("migrate"):
                particles, _ = migrate(particles, made)
            hierarchy, efield = made, None
        if not grown or hierarchy.levels > refinement.levels or isinstance(refinement.rule, StaticRule):
            return particles, hierarchy


def _tags(particles: Particles, hierarchy: Hierarchy, plan: Plan, efield: VectorField | None) -> Tags:
    rule = plan.scene.refinement.rule
    if isinstance(rule, StaticRule):
        return []
    relative = rule.relative is not None
    threshold = rule.relative if rule.relative is not None else rule.absolute
    assert threshold is not None
    if isinstance(rule, ChargeDensityRule) or efield is None:
        with plan.clock("deposit"):
            rho = deposit(particles, hierarchy)
    if isinstance(rule, FieldStrengthRule):
        if efield is None:
            with plan.clock("solve"):
                efield = plan.poisson(hierarchy).electric_field(plan.solve(rho, None)[0])
        tags = by_field(efield, threshold, relative)
    else:
        tags = by_density(rho, threshold, relative)
    _remark_on_tags(tags, hierarchy, particles, plan)
    return tags


def _remark_on_tags(tags: Tags, hierarchy: Hierarchy, particles: Particles, plan: Plan) -> None:
    count = tagged(plan.comm, tags)[0]
    where = "the threshold of refinement.rule"
    if count == 0 and particles.global_count(plan.comm) > 0:
        plan.remark(f"{where} tags no cell, so nothing is refined; lower it if that is not meant")
    elif count == hierarchy.cells(0):
        plan.remark(f"{where} tags every cell, so all of the domain is refined; raise it if that is not meant")


def _refined(particles: Particles, hierarchy: Hierarchy, tags: Tags, plan: Plan) -> Hierarchy:
    """Return the hierarchy for these tags, its boxes shared out by cells and particles. Collective."""
    refinement = plan.scene.refinement
    settings = Regridding(refinement.levels + 1, refinement.buffer, refinement.nesting, refinement.efficiency)
    made = regrid(hierarchy, tags, settings, _static(plan.scene))
    if made is hierarchy:
        return hierarchy
    boxes = [made.boxes(level) for level in range(made.levels)]
    require_room(plan.comm, plan.scene, boxes, particles.global_count(plan.comm), "the refined hierarchy")
    return balance(made, particles_per_box(particles, made))


def _static(scene: Scene) -> list[np.ndarray]:
    """Return the static boxes of a scene as index boxes per refined level."""
    rule = scene.refinement.rule
    if not isinstance(rule, StaticRule):
        return []
    in_metres = [(b.level, b.lower, b.upper) for b in rule.boxes if b.lower is not None and b.upper is not None]
    in_cells = [(b.level, [*b.first, *b.last]) for b in rule.boxes if b.first is not None and b.last is not None]
    levels = static_boxes(scene.domain.value, in_metres)
    levels += [np.empty((0, 6), np.int32)] * (max(box.level for box in rule.boxes) - len(levels))
    for level, box in in_cells:
        levels[level - 1] = np.concatenate([levels[level - 1], np.array([box], np.int32)])
    return levels
