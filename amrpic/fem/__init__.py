"""Finite elements whose integrals are sums over points, any number of them anywhere in each element. See docs/mpm.md."""

from .layouts import gauss, given, jittered, random, uniform
from .mesh import Mesh
from .operators import Mass, Operator, Poisson
from .points import Points
from .solve import Kept, SolveReport, solve

__all__ = [
    "Kept",
    "Mass",
    "Mesh",
    "Operator",
    "Points",
    "Poisson",
    "SolveReport",
    "gauss",
    "given",
    "jittered",
    "random",
    "solve",
    "uniform",
]
