"""Solids that are carried by material points, on a background mesh of `amrpic.fem`. See docs/mpm.md."""

from .carry import carried
from .damage import DamageReport, Settled, damage_field, settle
from .equilibrium import EquilibriumReport, equilibrium
from .loads import Loads
from .material_points import MaterialPoints
from .materials import Damage, Material, NeoHookean, Ogden
from .scene import Scene
from .simulation import Simulation
from .solid import Response, Solid, States, Tangent

__all__ = [
    "Damage",
    "DamageReport",
    "EquilibriumReport",
    "Loads",
    "Material",
    "MaterialPoints",
    "NeoHookean",
    "Ogden",
    "Response",
    "Scene",
    "Settled",
    "Simulation",
    "Solid",
    "States",
    "Tangent",
    "carried",
    "damage_field",
    "equilibrium",
    "settle",
]
