"""The rules of refinement applied to what the cells hold, and the mesh that they ask for."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..conductors.conductor import Conductor
from ..conductors.refined import remembered_edges, remembered_surfaces
from ..mesh.domain import AXES, Domain
from ..mesh.hierarchy import Hierarchy
from ..scene.refinement import Refinement
from ..scene.refinement_rules import (
    AllRule,
    AnyRule,
    CallableRule,
    ChargeDensityRule,
    ConductorEdgesRule,
    ConductorsRule,
    EmissionRule,
    FieldStrengthRule,
    MomentumRule,
    ParticlesRule,
    PotentialRule,
    RadiusRule,
    RuleKind,
    StaticRule,
    Threshold,
)
from ..stages import tag
from ..stages.diagnostics import moments
from ..stages.regrid import Regridding, regrid
from ..stages.tag import Tags
from .quantities import QuantitiesOnMesh


def refined(
    quantities: QuantitiesOnMesh, refinement: Refinement, hysteresis: float = 1.0
) -> tuple[Hierarchy, Tags | None]:
    """Return the hierarchy that the rule asks for, the present one if it is that; and the tags, None of static boxes alone.

    What is refined already stays while the rule asks for it with thresholds down to `hysteresis` of themselves. Tags reach one
    level up at a time. Collective.
    """
    rule, static = apart(refinement.rule)
    tags = [] if rule is None else tags_of(rule, quantities)
    lasting = [] if rule is None or hysteresis == 1 else tags_of(rule, quantities, hysteresis)
    settings = Regridding(refinement.levels + 1, refinement.buffer, refinement.nesting, refinement.efficiency)
    hierarchy = regrid(quantities.hierarchy, tags, settings, index_boxes(static, quantities.hierarchy.domain), lasting)
    return hierarchy, None if rule is None else tags


def tags_of(rule: RuleKind, quantities: QuantitiesOnMesh, part: float = 1.0) -> Tags:
    """Return the cells that a rule tags if its thresholds are taken `part` as strict. Collective."""
    tags = _tags(rule, quantities, part)
    levels = None if isinstance(rule, StaticRule) else rule.levels
    return tags if levels is None else tag.on_levels(tags, levels)


def _tags(rule: RuleKind, quantities: QuantitiesOnMesh, part: float) -> Tags:
    match rule:
        case StaticRule():
            return tag.inside(quantities.hierarchy, index_boxes([rule], quantities.hierarchy.domain))
        case AnyRule():
            return tag.either(*(tags_of(member, quantities, part) for member in rule.of))
        case AllRule():
            return tag.both(*(tags_of(member, quantities, part) for member in rule.of))
        case ParticlesRule():
            at_least = part * (rule.at_least or 0)
            return tag.between(quantities["particles_per_cell"], at_least, _over(rule.at_most, part))
        case CallableRule():
            values_of = {name: quantities[name] for name in QuantitiesOnMesh.NAMES if name in rule.arguments}
            return tag.by_function(
                quantities.hierarchy, rule.function, rule.name, rule.arguments, {**values_of, "hysteresis": part}
            )
        case EmissionRule():
            return tag.inside(quantities.hierarchy, _layers(rule, quantities))
        case ConductorsRule():
            return tag.at_electrodes(
                quantities.hierarchy, _named(quantities.electrodes, rule.electrodes), remembered_surfaces
            )
        case ConductorEdgesRule():
            beside = remembered_edges(rule.angle)
            return tag.at_electrodes(quantities.hierarchy, _named(quantities.electrodes, rule.electrodes), beside)
        case MomentumRule():
            return _by_momentum(rule, quantities, part)
        case RadiusRule():
            beam = moments(quantities.hierarchy.comm, quantities.particles, domain=quantities.hierarchy.domain)
            at_least, at_most = part * (rule.at_least or 0.0), _over(rule.at_most, part)
            axes = [AXES.index(axis) for axis in rule.axes]
            return tag.within(quantities.hierarchy, beam.mean, beam.rms, axes, at_least, at_most)
        case ChargeDensityRule():
            values = tag.magnitude(quantities["rho"], "charge density")
        case PotentialRule():
            values = tag.magnitude(quantities["phi"], "potential")
        case FieldStrengthRule():
            values = tag.magnitude(quantities["efield"], "field")
    return tag.exceeding(values, part * _thresholds(rule, tag.largest(quantities.hierarchy.comm, values)))


def _layers(rule: EmissionRule, quantities: QuantitiesOnMesh) -> list[np.ndarray]:
    """Return the index boxes (n, 6) per refined level, and one level more, of the layers at surfaces that emit."""
    hierarchy, regions = quantities.hierarchy, []
    for level in range(1, hierarchy.levels + 1):
        for face, lower, upper in quantities.surfaces:
            axis, side = divmod(face, 2)
            depth = rule.depth_on(float(hierarchy.domain.spacing[axis]) / 2**level)
            reach = np.where(np.arange(3) == axis, depth, 0.0)
            regions.append((level, lower - reach * side, upper + reach * (1 - side)))
    return tag.static_boxes(hierarchy.domain, regions)


def _named(electrodes: Sequence[Conductor], names: Sequence[str] | None) -> list[Conductor]:
    return [electrode for electrode in electrodes if names is None or electrode.name in names]


def _over(at_most: float | None, part: float) -> float:
    return math.inf if at_most is None else at_most / part


def _by_momentum(rule: MomentumRule, quantities: QuantitiesOnMesh, part: float) -> Tags:
    particles, hierarchy = quantities.particles, quantities.hierarchy
    if rule.relative_to == "rms":
        beam = moments(hierarchy.comm, particles.replace(position=particles.momentum))  # momenta in place of positions
        spreads = tag.in_spreads(particles.momentum, beam.mean, beam.rms)
        return tag.holding(spreads, particles, hierarchy, np.full(hierarchy.levels, part * (rule.relative or 0.0)))
    size = np.linalg.norm(particles.momentum, axis=1)
    most = tag.largest_inside(size, particles, hierarchy)
    return tag.holding(size, particles, hierarchy, part * _thresholds(rule, most))


def _thresholds(rule: Threshold, most: np.ndarray) -> np.ndarray:
    """Return the threshold of each level, given the largest magnitude on each."""
    if rule.relative is None:
        return np.full(len(most), rule.absolute)
    return rule.relative * (most if rule.relative_to == "level" else np.full(len(most), most.max()))


def apart(rule: RuleKind) -> tuple[RuleKind | None, list[StaticRule]]:
    """Return what a rule tags by what cells hold, None if nothing, and the static boxes that it adds to that.

    Boxes that are added exist at once and exactly; those below `all` bound tags, and so come with a buffer like these.
    """
    match rule:
        case StaticRule():
            return None, [rule]
        case AnyRule(levels=None):
            parts = [apart(member) for member in rule.of]
            rules = [member for member, _ in parts if member is not None]
            return rule.model_copy(update={"of": rules}) if rules else None, [
                box for _, boxes in parts for box in boxes
            ]
    return rule, []


def index_boxes(rules: Sequence[StaticRule], domain: Domain) -> list[np.ndarray]:
    """Return the boxes of static rules as index boxes (n, 6) per refined level."""
    boxes = [box for rule in rules for box in rule.boxes]
    in_metres = [(b.level, b.lower, b.upper) for b in boxes if b.lower is not None and b.upper is not None]
    in_cells = [(b.level, [*b.first, *b.last]) for b in boxes if b.first is not None and b.last is not None]
    levels = tag.static_boxes(domain, in_metres)
    levels += [np.empty((0, 6), np.int32)] * (max((box.level for box in boxes), default=0) - len(levels))
    for level, box in in_cells:
        levels[level - 1] = np.concatenate([levels[level - 1], np.array([box], np.int32)])
    return levels
