"""Finite elements whose integrals are sums over points, any number of them anywhere in each element. See docs/mpm.md."""

from .conjugate_gradients import Kept, SolveReport, solve
from .hexahedra import Mesh
from .layouts import gauss, given, jittered, random, uniform
from .operators import Mass, Operator, Poisson
from .points import Points

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
