"""Self-fields of charged-particle bunches on an adaptively refined mesh, and the motion of particles in them."""

import atexit

# h5py before the native module: the Trilinos libraries bring an HDF5 of their own, and h5py must meet its own first.
import h5py  # noqa: F401

from .mpi import MPI  # noqa: F401  (MPI must run before Kokkos starts, and end after it)

# isort: split
from . import _native

_native.initialize()
atexit.register(_native.finalize)

from .errors import (  # noqa: E402
    AmrpicError,
    HierarchyError,
    InputError,
    OutputError,
    ParticleError,
    SceneError,
    SolverError,
)
from .mesh.domain import Domain  # noqa: E402
from .mesh.field import Field, VectorField  # noqa: E402
from .mesh.hierarchy import Hierarchy  # noqa: E402
from .particles.particles import Particles  # noqa: E402
from .particles.species import Species, SpeciesTable  # noqa: E402
from .pic.simulation import Simulation  # noqa: E402
from .results.run_results import Results  # noqa: E402
from .scene.bunch_files import ArrayBunch, OpenPMDBunch  # noqa: E402
from .scene.bunch_shapes import (  # noqa: E402
    GaussianBunch,
    HaloBunch,
    HollowBunch,
    KVBunch,
    ParabolicBunch,
    SphereBunch,
    WaterbagBunch,
)
from .scene.bunches import LatticeBunch  # noqa: E402
from .scene.electrodes import Electrode  # noqa: E402
from .scene.elements import (  # noqa: E402
    CavityElement,
    ConstantFocusingElement,
    DipoleElement,
    GapElement,
    MapElement,
    QuadrupoleElement,
    SolenoidElement,
    UniformElement,
)
from .scene.motion import Leapfrog, NoMotion, RandomWalk  # noqa: E402
from .scene.obstacles import EllipticAperture, RectangularAperture, RoundAperture, Screen, SolidAperture  # noqa: E402
from .scene.refinement import Refinement  # noqa: E402
from .scene.refinement_rules import (  # noqa: E402
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
    StaticRule,
)
from .scene.scene import Scene  # noqa: E402
from .scene.solver_options import SolverOptions  # noqa: E402
from .scene.thermal_bunch import ThermalBunch  # noqa: E402
from .space_charge.engine import SpaceCharge  # noqa: E402
from .stages.poisson import PoissonSolver, SolveReport  # noqa: E402

open = Results.open

__all__ = [
    "AllRule",
    "AmrpicError",
    "AnyRule",
    "ArrayBunch",
    "CallableRule",
    "CavityElement",
    "ChargeDensityRule",
    "ConductorEdgesRule",
    "ConductorsRule",
    "ConstantFocusingElement",
    "DipoleElement",
    "Domain",
    "Electrode",
    "EllipticAperture",
    "EmissionRule",
    "Field",
    "FieldStrengthRule",
    "GapElement",
    "GaussianBunch",
    "HaloBunch",
    "Hierarchy",
    "HierarchyError",
    "HollowBunch",
    "InputError",
    "KVBunch",
    "LatticeBunch",
    "Leapfrog",
    "MapElement",
    "MomentumRule",
    "NoMotion",
    "OpenPMDBunch",
    "OutputError",
    "ParabolicBunch",
    "ParticleError",
    "Particles",
    "ParticlesRule",
    "PoissonSolver",
    "PotentialRule",
    "QuadrupoleElement",
    "RadiusRule",
    "RandomWalk",
    "RectangularAperture",
    "Refinement",
    "Results",
    "RoundAperture",
    "Scene",
    "SceneError",
    "Screen",
    "Simulation",
    "SolenoidElement",
    "SolidAperture",
    "SolveReport",
    "SolverError",
    "SolverOptions",
    "SpaceCharge",
    "Species",
    "SpeciesTable",
    "SphereBunch",
    "StaticRule",
    "ThermalBunch",
    "UniformElement",
    "VectorField",
    "WaterbagBunch",
    "open",
]
