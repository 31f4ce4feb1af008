"""Self-fields of charged-particle bunches on an adaptively refined mesh, and the motion of particles in them."""

import atexit

# h5py before the native module: the Trilinos libraries bring an HDF5 of their own, and h5py must meet its own first.
import h5py  # noqa: F401
from mpi4py import MPI  # noqa: F401  (MPI must run before Kokkos starts, and end after it)

from . import _native

_native.initialize()
atexit.register(_native.finalize)

from .mesh.domain import Domain  # noqa: E402
from .mesh.field import Field, VectorField  # noqa: E402
from .mesh.hierarchy import Hierarchy  # noqa: E402
from .particles.particles import Particles  # noqa: E402
from .particles.species import Species, SpeciesTable  # noqa: E402
from .run.simulation import Simulation  # noqa: E402
from .scene.scene import Scene  # noqa: E402
from .scene.solver_options import SolverOptions  # noqa: E402
from .stages.poisson import PoissonSolver, SolveReport  # noqa: E402

__all__ = [
    "Domain",
    "Field",
    "Hierarchy",
    "Particles",
    "PoissonSolver",
    "Scene",
    "Simulation",
    "SolveReport",
    "SolverOptions",
    "Species",
    "SpeciesTable",
    "VectorField",
]
