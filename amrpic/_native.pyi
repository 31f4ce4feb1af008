"""Native part of amrpic: meshes, operators, solver and particle kernels."""

from collections.abc import Callable, Sequence
import enum

import numpy
from numpy.typing import NDArray

def end_job_on_failure(comm: int) -> None:
    """
    Let a failure of MPI on a communicator of the library's own end the job with one sentence.
    """

def fail_alone(what: str) -> None:
    """
    Of a broken promise that one rank alone finds: end a job of several with this sentence; raise, if it has one rank.
    """

def traffic() -> list[int]:
    """
    Messages and bytes that this process has sent to other ranks so far, and collective calls.
    """

def take_destinations() -> dict[int, int]:
    """
    The ranks that virtual ranks of this process have sent messages to since the last call, and how many bytes.
    """

def count_collective() -> None:
    """Count a collective call that Python makes."""

def sums_and_largest(comm: int | Sequence[int], summed: Sequence[float], compared: Sequence[float]) -> list[float]:
    """
    The sums over all ranks of some numbers, and behind them the largest of others, in one reduction.
    """

def exchange(
    comm: int, asked: Sequence[tuple[int, int]], wanted: Sequence[tuple[int, int]], pack: Callable
) -> list[list[float]]:
    """
    Values of parcels between ranks, (rank, number) each, once; pack(n) gives those that rank asked[n][0] reads.
    """

def measure_fma_peak() -> float:
    """
    Most operations per second of products and sums of vectors in registers, two each, the best of many short runs.
    """

def initialize() -> None:
    """Start Kokkos and Tpetra on MPI_COMM_WORLD, once; MPI must be up."""

def finalize() -> None:
    """
    Release what solvers hold of Trilinos, then stop it; MPI must still be up.
    """

def trilinos_version() -> str:
    """Version of the Trilinos headers, such as '13.2'."""

def kokkos_backend() -> str:
    """
    Version of Kokkos, the execution space of its kernels, and how many threads that has; empty without it.
    """

def mpi_library() -> str:
    """Version line of the MPI library this module calls."""

class HierarchyError(Exception):
    pass

class SolverError(Exception):
    pass

def wrapped(
    points: NDArray[numpy.float64], lower: Sequence[float], upper: Sequence[float], periodic: Sequence[bool]
) -> NDArray[numpy.float64]:
    """
    Points (n, 3), those beyond periodic faces where their images are in the domain.
    """

class Hierarchy:
    def __init__(
        self,
        comm: int | Sequence[int],
        lower: Sequence[float],
        upper: Sequence[float],
        cells: Sequence[int],
        boundary: Sequence[int],
        levels: Sequence[NDArray[numpy.int32]],
        max_grid_size: int,
        blocking_factor: int,
        base: NDArray[numpy.int32],
        earlier: Hierarchy | None,
    ) -> None: ...
    def seen_by(self, rank: int) -> Hierarchy:
        """The hierarchy of a virtual rank as another virtual rank has it."""

    @property
    def levels(self) -> int: ...
    def boxes(self, level: int) -> NDArray[numpy.int32]: ...
    def owners(self, level: int) -> NDArray[numpy.int32]: ...
    def metadata_bytes(self, level: int) -> int:
        """
        What the boxes of a level take on each rank, which levels with the same boxes share.
        """

    def same_boxes(self, other: Hierarchy, level: int) -> bool: ...
    def local_boxes(self, level: int) -> list[int]: ...
    def cells(self, level: int) -> int: ...
    def covered(self, level: int, box: int) -> NDArray[numpy.int8]: ...
    def cells_around(self, points: NDArray[numpy.float64], radius: NDArray[numpy.float64]) -> tuple:
        """
        Starts and numbers of the uncovered cells within a radius of each point.
        """

    def leaves_around(self, reach: float) -> tuple:
        """
        Uncovered cells, their radii, starts and numbers of those near each, kinds, one of each kind.
        """

class Field:
    def __init__(self, hierarchy: Hierarchy, zero: bool = True) -> None: ...
    def level(self, level: int) -> NDArray[numpy.float64]: ...
    def average_down(self) -> None: ...
    def own_integral(self) -> float: ...
    def own_integral_with(self, other: Field) -> float: ...
    def own_integral_with_itself(self, other: Field, weight: Sequence[float]) -> float: ...
    def sample(self, points: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...

class ElectricField:
    def __init__(self, x: Field, y: Field, z: Field) -> None: ...
    def write(self, x: Field, y: Field, z: Field) -> None: ...
    def compensate(self, density: Field, factor: Sequence[Sequence[float]]) -> None:
        """
        Let gather add factor[level][axis] times the density below less that above; the field on the mesh stays.
        """

    def own_integral_of_square(self) -> float: ...

def fem_gauss_rule(count: int) -> tuple:
    """Places and weights of Gauss's rule on [-1, 1]."""

def fem_lobatto_nodes(degree: int) -> NDArray[numpy.float64]:
    """Nodes of an element along an axis, from -1 to 1."""

def fem_fit_moments(
    first: NDArray[numpy.int64],
    reference: NDArray[numpy.float64],
    volume: NDArray[numpy.float64],
    full: NDArray[numpy.bool_],
    element_volume: float,
    highest: int,
) -> tuple:
    """
    Weights of points near their volumes, and to which degree they are exact in each element that is full.
    """

class FemLattice:
    """
    Nodes of elements on the base cells of a hierarchy; amrpic.fem.Mesh has it.
    """

    def __init__(self, hierarchy: Hierarchy, degree: int) -> None: ...
    def nodes(self) -> NDArray[numpy.int32]: ...
    def elements(self) -> NDArray[numpy.int32]: ...
    def locate(self, places: NDArray[numpy.float64]) -> tuple:
        """The element of each place among this rank's, or -1, and where in it."""

class FemPoints:
    """Integration points; amrpic.fem.Points has them."""

    def __init__(
        self,
        lattice: FemLattice,
        element: NDArray[numpy.int32],
        reference: NDArray[numpy.float64],
        weight: NDArray[numpy.float64],
        gauss: bool,
    ) -> None: ...
    @property
    def bytes(self) -> int: ...
    def reference(self) -> NDArray[numpy.float64]:
        """Where points lie in their elements."""

    def weight(self) -> NDArray[numpy.float64]:
        """Weights of points."""

    def values(self, components: int, u: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...
    def slopes(self, components: int, u: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...
    def integrals(self, components: int, values: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...

def fem_mass(points: FemPoints, components: int) -> FemOperator: ...
def fem_poisson(points: FemPoints, components: int) -> FemOperator: ...

class FemMultigrid:
    """A preconditioner that solves of operators near each other share."""

class FemOperator:
    """An operator at points; amrpic.fem has those of mass and of Poisson."""

    def apply(self, u: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...
    def apply_nearly(self, u: NDArray[numpy.float64]) -> NDArray[numpy.float64]:
        """
        The product as smoothers have it, in single precision where there is such a form.
        """

    def diagonal(self) -> NDArray[numpy.float64]: ...
    def entries(self) -> tuple: ...
    def corner_rows(self, fixed: NDArray[numpy.bool_]) -> tuple:
        """
        This rank's rows of an operator of degree 1, as the coarse level of a solve has them.
        """

    def halved_rows(self, fixed: NDArray[numpy.bool_]) -> tuple:
        """
        The next level's nodes of this rank, by their indices along the axes, and their rows.
        """

    def solve(
        self,
        f: NDArray[numpy.float64],
        fixed: NDArray[numpy.bool_],
        values: NDArray[numpy.float64],
        preconditioner: int,
        tolerance: float,
        most_iterations: int,
        kept: FemMultigrid | None = None,
    ) -> tuple: ...

class NeoHookean:
    def __init__(self, mu: float, lambda_: float) -> None: ...
    def energy(self, f: Sequence[Sequence[float]]) -> float:
        """Per initial volume."""

    def stress(self, f: Sequence[Sequence[float]]) -> list[list[float]]:
        """Kirchhoff's."""

    def change_initially(
        self, f: Sequence[Sequence[float]], change: Sequence[Sequence[float]]
    ) -> list[list[float]]: ...
    def change(self, f: Sequence[Sequence[float]], h: Sequence[Sequence[float]]) -> list[list[float]]: ...

class Ogden:
    def __init__(self, terms: Sequence[tuple[float, float]], lambda_: float) -> None: ...
    def energy(self, f: Sequence[Sequence[float]]) -> float: ...
    def stress(self, f: Sequence[Sequence[float]]) -> list[list[float]]: ...
    def change_initially(
        self, f: Sequence[Sequence[float]], change: Sequence[Sequence[float]]
    ) -> list[list[float]]: ...
    def change(self, f: Sequence[Sequence[float]], h: Sequence[Sequence[float]]) -> list[list[float]]: ...

class DamagedNeoHookean:
    def __init__(self, mu: float, lambda_: float, residual: float) -> None: ...
    def energy(self, f: Sequence[Sequence[float]], damage: float) -> float: ...
    def driving_energy(self, f: Sequence[Sequence[float]]) -> float: ...
    def stress(self, f: Sequence[Sequence[float]], damage: float) -> list[list[float]]: ...
    def damage_of(self, driving: float, toughness: float, length: float) -> float: ...
    def change(
        self, f: Sequence[Sequence[float]], h: Sequence[Sequence[float]], damage: float
    ) -> list[list[float]]: ...

vacuum_permittivity: float = 8.8541878188e-12

class Norm(enum.Enum):
    l1 = 0

    l2 = 1

    max = 2

class Prolongation(enum.Enum):
    constant = 0

    trilinear = 1

class Smoother(enum.Enum):
    red_black = 0

    jacobi = 1

    gauss_seidel = 2

    symmetric_gauss_seidel = 3

    chebyshev = 4

class Bottom(enum.Enum):
    gmres = 0

    cg = 1

    bicgstab = 2

    multigrid = 3

    direct = 4

class BottomPreconditioner(enum.Enum):
    none = 0

    jacobi = 1

    gauss_seidel = 2

    ilu = 3

    smoothed_aggregation = 4

    plain_aggregation = 5

    brick_aggregation = 6

    structured_aggregation = 7

class Krylov(enum.Enum):
    none = 0

    fgmres = 1

    bicgstab = 2

class Backend(enum.Enum):
    matrix_free = 0

    kokkos = 1

    crs = 2

class CoveredField(enum.Enum):
    mean = 0

    difference = 1

class Holds(enum.Enum):
    points = 0

    means = 1

class WorkUnit:
    @property
    def seconds(self) -> float: ...
    @property
    def apply_seconds(self) -> float: ...
    @property
    def triad_throughput(self) -> float: ...

def measure_work_unit(cells: int) -> WorkUnit: ...

class SolverOptions:
    def __init__(self) -> None: ...
    @property
    def backend(self) -> Backend: ...
    @backend.setter
    def backend(self, arg: Backend, /) -> None: ...
    @property
    def tolerance(self) -> float: ...
    @tolerance.setter
    def tolerance(self, arg: float, /) -> None: ...
    @property
    def to_discretisation(self) -> bool: ...
    @to_discretisation.setter
    def to_discretisation(self, arg: bool, /) -> None: ...
    @property
    def absolute_tolerance(self) -> float: ...
    @absolute_tolerance.setter
    def absolute_tolerance(self, arg: float, /) -> None: ...
    @property
    def norm(self) -> Norm: ...
    @norm.setter
    def norm(self, arg: Norm, /) -> None: ...
    @property
    def order(self) -> int: ...
    @order.setter
    def order(self, arg: int, /) -> None: ...
    @property
    def max_cycles(self) -> int: ...
    @max_cycles.setter
    def max_cycles(self, arg: int, /) -> None: ...
    @property
    def smoother(self) -> Smoother: ...
    @smoother.setter
    def smoother(self, arg: Smoother, /) -> None: ...
    @property
    def pre_sweeps(self) -> int: ...
    @pre_sweeps.setter
    def pre_sweeps(self, arg: int, /) -> None: ...
    @property
    def post_sweeps(self) -> int: ...
    @post_sweeps.setter
    def post_sweeps(self, arg: int, /) -> None: ...
    @property
    def relaxation(self) -> float: ...
    @relaxation.setter
    def relaxation(self, arg: float, /) -> None: ...
    @property
    def prolongation(self) -> Prolongation: ...
    @prolongation.setter
    def prolongation(self, arg: Prolongation, /) -> None: ...
    @property
    def screening(self) -> float: ...
    @screening.setter
    def screening(self, arg: float, /) -> None: ...
    @property
    def stretch(self) -> list[float]: ...
    @stretch.setter
    def stretch(self, arg: Sequence[float], /) -> None: ...
    @property
    def across(self) -> int: ...
    @across.setter
    def across(self, arg: int, /) -> None: ...
    @property
    def mirror_places(self) -> list[float]: ...
    @mirror_places.setter
    def mirror_places(self, arg: Sequence[float], /) -> None: ...
    @property
    def mirror_signs(self) -> list[int]: ...
    @mirror_signs.setter
    def mirror_signs(self, arg: Sequence[int], /) -> None: ...
    @property
    def coarse_levels(self) -> int: ...
    @coarse_levels.setter
    def coarse_levels(self, arg: int, /) -> None: ...
    @property
    def bottom(self) -> Bottom: ...
    @bottom.setter
    def bottom(self, arg: Bottom, /) -> None: ...
    @property
    def bottom_preconditioner(self) -> BottomPreconditioner: ...
    @bottom_preconditioner.setter
    def bottom_preconditioner(self, arg: BottomPreconditioner, /) -> None: ...
    @property
    def krylov(self) -> Krylov: ...
    @krylov.setter
    def krylov(self, arg: Krylov, /) -> None: ...
    @property
    def most_direct_readers(self) -> int:
        """
        Coarser corrections that more than so many ranks read of one pass through others. The same on all ranks.
        """

    @most_direct_readers.setter
    def most_direct_readers(self, arg: int, /) -> None: ...
    @property
    def neutralize(self) -> bool: ...
    @neutralize.setter
    def neutralize(self, arg: bool, /) -> None: ...

class MeshError:
    def __init__(
        self, error: float = 0.0, contraction: float = 0.0, right_hand_side: float = 0.0, solves: int = 0
    ) -> None: ...
    @property
    def error(self) -> float: ...
    @property
    def contraction(self) -> float: ...
    @property
    def right_hand_side(self) -> float: ...
    @property
    def solves(self) -> int: ...

SOLVES_PER_ESTIMATE: int = 10

class SolveReport:
    @property
    def converged(self) -> bool: ...
    @property
    def cycles(self) -> int: ...
    @property
    def residuals(self) -> list[float]: ...
    @property
    def floor(self) -> float: ...
    @property
    def mesh_error(self) -> MeshError: ...
    @property
    def reason(self) -> str: ...
    @property
    def seconds(self) -> dict[str, float]: ...

class Reusable:
    def __init__(self) -> None: ...

class Metal:
    def __init__(self, electrodes: int, ask: Callable) -> None: ...

class PoissonSolver:
    def __init__(
        self, hierarchy: Hierarchy, options: SolverOptions, reusable: Reusable, metal: Metal | None = None
    ) -> None: ...
    def set_potentials(self, potentials: Sequence[float]) -> None: ...
    def add_gaps(self, level: int, gaps: NDArray[numpy.int32], widths: NDArray[numpy.float64]) -> None: ...
    def charges(self, phi: Field, rho: Field) -> list[float]: ...
    def sights(self) -> list[float]: ...
    def solve(
        self, rho: Field, phi: Field, from_zero: bool, known: MeshError, deposited: float, images: bool = False
    ) -> SolveReport: ...
    def electric_field(self, potential: Field, covered: CoveredField) -> ElectricField: ...
    def electric_field_as(self, potential: Field, covered: CoveredField, holds: Holds) -> ElectricField: ...
    def to_means(self, points: Field, means: Field) -> None: ...
    def wall_faces(self, level: int) -> tuple: ...
    def wall_data(self, level: int) -> NDArray[numpy.float64]: ...
    def continue_walls(self, potentials: Sequence[Sequence[float]]) -> None: ...
    @property
    def reusable(self) -> Reusable: ...
    @property
    def bottom_setups(self) -> int: ...
    @property
    def levels_assembled(self) -> int: ...
    @property
    def assemblies(self) -> int: ...
    @property
    def backend_bytes(self) -> int: ...

def cluster(blocks: NDArray[numpy.int32], efficiency: float) -> NDArray[numpy.int32]: ...
def refine(
    hierarchy: Hierarchy,
    tags: Sequence[NDArray[numpy.uint8]],
    fixed: Sequence[NDArray[numpy.int32]],
    max_levels: int,
    buffer: int,
    nesting: int,
    efficiency: float,
) -> list: ...

class BoxTable:
    """Disjoint boxes of a level, and a look-up by cells."""

    def __init__(self, boxes: NDArray[numpy.int32]) -> None: ...
    def meeting(self, lower: Sequence[int], upper: Sequence[int]) -> NDArray[numpy.int32]:
        """Ascending numbers of the boxes that have cells of a region."""

    def meets(self, regions: NDArray[numpy.int32]) -> NDArray[numpy.uint8]:
        """Whether a box has a cell of each region, a byte per region."""

    def find(self, cells: NDArray[numpy.int32]) -> NDArray[numpy.int32]:
        """The box that holds each cell, -1 if none does."""

    @property
    def outer_faces(self) -> int:
        """Number of cell faces on the surface of the union of the boxes."""

def stencil_sums(
    value: NDArray[numpy.float64],
    place: NDArray[numpy.int64],
    kind: NDArray[numpy.int64],
    first: NDArray[numpy.int64],
    offset: NDArray[numpy.int32],
    weight: NDArray[numpy.float64],
) -> NDArray[numpy.float64]:
    """
    Sums of weights times differences from the own value, (cells, rows), for cells at places of a dense array.
    """

def carry_over(from_: Field, to: Field) -> None: ...

class EngeFringe:
    def __init__(
        self, gap: float = 0.0, coefficient: Sequence[float] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], reach: float = 0.0
    ) -> None:
        """The profile of a magnet; gap = 0: hard edges."""

class UniformField:
    def __init__(self, E: Sequence[float], B: Sequence[float]) -> None: ...

class FocusingField:
    def __init__(self, gradient: Sequence[float]) -> None: ...

class QuadrupoleField:
    def __init__(self, gradient: float, half: float, fringe: EngeFringe) -> None: ...

class DipoleField:
    def __init__(
        self,
        field: float,
        half: float,
        fringe: EngeFringe,
        angle: Sequence[float] = [0.0, 0.0],
        gradient: float = 0.0,
        turn: float = 0.0,
        lost: Sequence[float] = [0.0, 0.0],
    ) -> None: ...

class MultipoleField:
    def __init__(self, normal: Sequence[float], skew: Sequence[float]) -> None:
        """Factors of (x + i y)^n in B_y + i B_x, T/m^n."""

class SolenoidField:
    def __init__(self, field: float, half: float, radius: float) -> None:
        """radius = 0: hard edges."""

class GapField:
    def __init__(self, voltage: float, half: float, omega: float, phase: float) -> None: ...

class PillboxField:
    def __init__(self, field: float, omega: float, phase: float) -> None: ...

class MapField:
    def __init__(
        self,
        axisymmetric: bool,
        lower: Sequence[float],
        spacing: Sequence[float],
        cells: Sequence[int],
        before: Sequence[int],
        E: NDArray[numpy.float64] | None = None,
        B: NDArray[numpy.float64] | None = None,
        scale: float = 1.0,
        omega: float = 0.0,
        phase: float = 0.0,
    ) -> None:
        """
        Values (x, y, z, component), the fourth 0; `before` nodes and one at the other end lie outside.
        """

class ExternalElement:
    def __init__(
        self,
        origin: Sequence[float],
        axes: Sequence[Sequence[float]],
        extent: Sequence[float],
        kind: UniformField
        | FocusingField
        | QuadrupoleField
        | DipoleField
        | MultipoleField
        | SolenoidField
        | GapField
        | PillboxField
        | MapField,
        slope: Sequence[float] = [0.0, 0.0],
        reach: float = float("inf"),
    ) -> None:
        """
        The extent is along z; its lower and upper end are planes that rise with x by the slopes. Reach: from z, m.
        """

class ExternalFields:
    def __init__(self, elements: Sequence[ExternalElement]) -> None: ...
    def seen_from(self, origin: Sequence[float], axes: Sequence[Sequence[float]]) -> ExternalFields:
        """
        The same fields in coordinates with another origin (m) and other unit vectors.
        """

    @property
    def electric(self) -> bool: ...
    @property
    def magnetic(self) -> bool: ...
    def edges(
        self, position: NDArray[numpy.float64], velocity: NDArray[numpy.float64], start: float, stop: float
    ) -> list[NDArray[numpy.float64]]:
        """
        What `means` has in B from planes: where flights enter a field and where they leave it (T), when they do (s, two columns and one of zeros), the normals of these planes, and 1 for flights that pass the end of a field.
        """

    def means(
        self,
        position: NDArray[numpy.float64],
        velocity: NDArray[numpy.float64],
        time: float,
        start: float,
        stop: float,
        by_eights: bool = True,
    ) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]:
        """
        Means of E (V/m) and B (T) along flights position + velocity τ, τ from `start` to `stop` (s).
        """

def lattice_green(spacing: Sequence[float], reach: Sequence[int], order: int = 2) -> NDArray[numpy.float64]:
    """
    Potential (k, j, i) of a unit charge at the origin of the lattice, offsets 0 .. reach, by the operator of order 2 or 4.
    """

def multipole_moments(
    positions: NDArray[numpy.float64], charges: NDArray[numpy.float64], centre: Sequence[float]
) -> NDArray[numpy.complex128]:
    """Moments (l, m >= 0), place l (l + 1) / 2 + m, of point charges."""

def translate_moments(moments: NDArray[numpy.complex128], shift: Sequence[float]) -> NDArray[numpy.complex128]:
    """Moments about a centre that lies `shift` before the old one."""

def kernel_table_bytes() -> int:
    """Bytes of the tables of near fields that are alive in this process."""

class FreeSpace:
    def __init__(
        self,
        hierarchy: Hierarchy,
        acceptance: float | None = None,
        lattice_limit: float | None = None,
        separation: float | None = None,
        order: int = 2,
        fewest_sharing_ranks: int = 33,
    ) -> None: ...
    def walls(self, density: Field) -> list:
        """
        Potential behind the open walls of this rank's cells, by a charge density / eps0. Per level: faces, 2 axis + side; cells (n, 3); and values (n,), all of free space; in order 4 (n, 2), of both ghosts. Collective.
        """

class OpenWallPlans:
    def __init__(
        self, hierarchy: Hierarchy, first_boxes: Sequence[Sequence[int]] = [], fewest_sharing_ranks: int = 33
    ) -> None:
        """
        What all ranks know of the open walls of a mesh. `first_boxes`: per level, where the run of each rank begins, ranks + 1 values, for ranks that need not exist; else those of the mesh. So many ranks and more share the nodes right below the top of the tree of charge while they are few. Local.
        """

    def counts(self, rank: int, charged: Sequence[Sequence[Sequence[float]]] = []) -> dict:
        """
        Counts of one solve on a rank, by the plan that a solve follows: patches evaluated, their interactions `far` and `near`, nodes and leaves received; messages and bytes sent, of each kind and of all; messages received; bytes of each collective. Where charge is, blocks are taken to be full: in the regions `charged`, (lower, upper) in cells of the base, or everywhere. Local.
        """

class Triangles:
    """A closed surface of triangles, searched by a hierarchy of boxes."""

    def __init__(self, corners: NDArray[numpy.float64], weight: NDArray[numpy.int32]) -> None: ...
    def crossings(self, start: NDArray[numpy.float64], direction: NDArray[numpy.float64]) -> tuple:
        """
        Line, parameter, change of depth and triangle of each crossing, line by line, and the lines that pass edges within rounding; arguments are rows of x, y, z.
        """

def mark_in_metal(
    first: NDArray[numpy.int64],
    count: NDArray[numpy.int64],
    stride: NDArray[numpy.int64],
    electrode: int,
    axis: int,
    owner: NDArray[numpy.int32],
    axes: NDArray[numpy.uint8],
) -> None:
    """
    Give stretches of cells along an axis to an electrode, and add its bit to theirs.
    """

def runs_in_metal(boxes: NDArray[numpy.int32], owner: NDArray[numpy.int32]) -> tuple:
    """
    First cells, numbers and electrodes of the runs along x in boxes, by the owners of the cells of each and of a layer around it.
    """

def gmls_exponents(dimension: int, order: int) -> NDArray[numpy.int32]:
    """
    Exponents of the monomials, (n, dimension), in the order of their coefficients.
    """

class GmlsProblem:
    """Stencils of generalized moving least squares; amrpic.gmls makes it."""

    def __init__(
        self,
        order: int,
        components: int,
        basis: NDArray[numpy.float64],
        weight: int,
        parameters: Sequence[float],
        aspect: Sequence[float],
        targets: NDArray[numpy.float64],
        reach: NDArray[numpy.float64],
        start: NDArray[numpy.int64],
        index: NDArray[numpy.int32],
        sites: NDArray[numpy.float64],
        samples: object | None,
        wanted: object,
        exact: object | None,
    ) -> None: ...
    def solve(
        self,
        residual_bound: float,
        sum_bound: float,
        portable: bool,
        weights: NDArray[numpy.float64],
        exact_weights: NDArray[numpy.float64],
        path: NDArray[numpy.int8],
        judgements: NDArray[numpy.float64],
    ) -> None:
        """Stencils of all targets, into arrays that are given."""

    def equations(self, target: int) -> tuple:
        """
        Weighted rows of a target's samples (m, n), roots of their weights, and the targets (n, rows wanted): weights are root * z with rows.T @ z = targets.
        """

def padded_cells(boxes: Sequence[Sequence[int]], halo: int) -> int:
    """
    The most padded cells that boxes, each lower x, y, z and upper x, y, z, take with a halo.
    """

def refusal_of_places(places: int, level: int, rank: int) -> str:
    """
    What is wrong with so many padded cells of a level on a rank; empty if nothing is.
    """

class LevelWork:
    @property
    def level(self) -> int:
        """0: the base; negative below it."""

    @property
    def cells(self) -> int:
        """Of this rank."""

    @property
    def stored(self) -> int:
        """Cells with copies of others'."""

    @property
    def relaxed(self) -> float:
        """Cells relaxed; without copies, cells times sweeps."""

    @property
    def sweeps(self) -> int: ...
    @property
    def neighbours(self) -> int:
        """Ranks with which this one exchanges values."""

    @property
    def messages(self) -> int: ...
    @property
    def bytes(self) -> int: ...
    @property
    def collectives(self) -> int: ...

def cycle_work(
    hierarchy: Hierarchy,
    pre_sweeps: int,
    post_sweeps: int,
    screening: float = 0.0,
    stretch: Sequence[float] = [1.0, 1.0, 1.0],
    most_direct_readers: int = 32,
) -> list[LevelWork]:
    """
    What one cycle takes of this rank, by levels, the coarsest first: it is rehearsed, and messages are counted. Local for a virtual rank, else collective.
    """

class CyclePlans:
    def __init__(
        self,
        hierarchy: Hierarchy,
        pre_sweeps: int,
        post_sweeps: int,
        screening: float = 0.0,
        stretch: Sequence[float] = [1.0, 1.0, 1.0],
    ) -> None:
        """
        What all ranks know of the cycle on the hierarchy of a virtual rank. Local.
        """

    def work(self, rank: int) -> list[LevelWork]:
        """What `cycle_work` gives of another rank. Local."""

class Means:
    """
    Leads from values at the centres of cells to means over them, and back.
    """

    def __init__(self, hierarchy: Hierarchy) -> None: ...
    def to_points(self, means: Field, points: Field) -> None: ...
    def to_means(self, points: Field, means: Field) -> None: ...

class CompositeLaplacian:
    def __init__(self, hierarchy: Hierarchy, stretch: Sequence[float], shift: float = 0.0, order: int = 2) -> None: ...
    def average_down(self, phi: Field) -> None: ...
    def add(self, correction: Sequence[NDArray[numpy.float64]], scale: float, phi: Field) -> None: ...
    def residual(
        self,
        rho: Field,
        mean: float,
        walls: Sequence[NDArray[numpy.float64]],
        phi: Field,
        norm: Norm,
        scale: Sequence[float],
    ) -> tuple: ...
    def single_residual(
        self,
        rho: Field,
        mean: float,
        walls: Sequence[NDArray[numpy.float64]],
        phi: Field,
        norm: Norm,
        scale: Sequence[float],
    ) -> tuple: ...
    def truncation(
        self,
        rho: Field,
        mean: float,
        walls: Sequence[NDArray[numpy.float64]],
        phi: Field,
        base_ratio: Sequence[int],
        scale: Sequence[float],
    ) -> tuple: ...
    def right_hand_side_norm(
        self, rho: Field, mean: float, walls: Sequence[NDArray[numpy.float64]], norm: Norm
    ) -> float: ...
    def integrate_right_hand_side(
        self, rho: Field, mean: float, walls: Sequence[NDArray[numpy.float64]]
    ) -> tuple[float, float]: ...
    def diagonal_norm(self, phi: Field, norm: Norm) -> float: ...
    def electric_field(
        self, potential: Field, walls: Sequence[NDArray[numpy.float64]], covered: CoveredField
    ) -> ElectricField: ...
    @property
    def bytes(self) -> int: ...

class MpmSolid:
    """Points that carry a solid; amrpic.mpm.Solid has it."""

    def __init__(
        self,
        points: FemPoints,
        laws: Sequence[NeoHookean | Ogden | DamagedNeoHookean],
        law: NDArray[numpy.int32],
        deformation: NDArray[numpy.float64],
        damage: NDArray[numpy.float64],
    ) -> None: ...
    def respond(self, u: NDArray[numpy.float64]) -> tuple:
        """Internal forces, energy, and the smallest det F."""

    def tangent(self, u: NDArray[numpy.float64], form: int, stiffening: float) -> FemOperator: ...
    def deformation(self, u: NDArray[numpy.float64]) -> NDArray[numpy.float64]:
        """F of each point, 9 numbers."""

    def energies(self, u: NDArray[numpy.float64]) -> tuple:
        """Energy and driving energy of each point."""

    def stresses(self, deformation: NDArray[numpy.float64]) -> NDArray[numpy.float64]:
        """Kirchhoff's stress of each point, 9 numbers."""

def mpm_determinants(deformation: NDArray[numpy.float64]) -> NDArray[numpy.float64]:
    """Of each point's 9 numbers."""

def mpm_damage(
    points: FemPoints,
    volume: NDArray[numpy.float64],
    driving: NDArray[numpy.float64],
    surface: NDArray[numpy.float64],
    length: NDArray[numpy.float64],
) -> FemOperator:
    """The operator that damage is found with."""

class LevelOperators:
    def rows_of(self, name: str, columns: LevelOperators, axis: int = 0) -> tuple: ...
    def multiply(self, name: str, axis: int, values: NDArray[numpy.float64]) -> NDArray[numpy.float64]: ...
    def uncovered(self) -> NDArray[numpy.int8]: ...
    @property
    def first_row(self) -> int: ...
    @property
    def rows(self) -> int: ...
    @property
    def local_rows(self) -> int: ...
    @property
    def bytes(self) -> int: ...

def operators_of(solver: PoissonSolver, level: int) -> LevelOperators:
    """The operators of a level."""

def recycled(bytes: int) -> NDArray[numpy.uint8]:
    """
    Memory whose former owner is gone, if there is such; with whatever it holds.
    """

def idle_bytes() -> int:
    """Memory that waits for `recycled` to be called again."""

class ReservedMemory:
    """So many more bytes wait for `recycled` as long as this lives."""

    def __init__(self, bytes: int) -> None: ...

class ParticleMesh:
    def __init__(self, hierarchy: Hierarchy) -> None: ...

class RemoteBricks:
    def __init__(self, hierarchy: Hierarchy) -> None:
        """None."""

    @property
    def bricks(self) -> NDArray[numpy.int32]:
        """Level, box, and number in the box, of each; int (n, 3)."""

    @property
    def cells(self) -> NDArray[numpy.int32]:
        """Those of each, in the indices of its level; int (n, 6)."""

    def __len__(self) -> int: ...

def brick_regions(hierarchy: Hierarchy, bricks: NDArray[numpy.int32], matched: bool) -> tuple:
    """
    What passes because of bricks, given by rows of level, box and number in it, where others serve them than own the cells: the place of each on the curve, and rows of brick, level, box and number of cells, of which the box's owner and the server exchange a component each way. From the boxes alone, whoever owns them.
    """

END_OF_CURVE: int = 9223372036854775807

PLACES_PER_BRICK: int = 2097152

MOST_PARTICLES: int = 2147483583

class Migration:
    def __init__(
        self,
        mesh: ParticleMesh,
        servers: NDArray[numpy.int64],
        position: NDArray[numpy.float64],
        momentum: NDArray[numpy.float64] | None,
        weight: NDArray[numpy.float64],
        id: NDArray[numpy.int64],
        gone: NDArray[numpy.int64],
        has_weights: bool,
    ) -> None: ...
    @property
    def lost(self) -> NDArray[numpy.int64]: ...
    @property
    def arriving(self) -> int: ...
    @property
    def from_others(self) -> int: ...
    @property
    def bricks(self) -> int: ...
    def start(
        self,
        position: NDArray[numpy.float64],
        momentum: NDArray[numpy.float64] | None,
        weight: NDArray[numpy.float64],
        id: NDArray[numpy.int64],
    ) -> bool: ...
    def receive(
        self,
        position: NDArray[numpy.float64],
        momentum: NDArray[numpy.float64] | None,
        weight: NDArray[numpy.float64],
        id: NDArray[numpy.int64],
    ) -> None: ...
    def carry(self, columns: NDArray[numpy.float64], out: NDArray[numpy.float64]) -> None:
        """
        After `receive`: further columns, (columns, n), of the same particles. Collective.
        """

    @property
    def starts(self) -> NDArray[numpy.int64]: ...
    def remote(self, hierarchy: Hierarchy) -> RemoteBricks: ...

class Arrangement:
    def __init__(
        self,
        mesh: ParticleMesh,
        servers: NDArray[numpy.int64],
        position: NDArray[numpy.float64],
        id: NDArray[numpy.int64],
    ) -> None: ...
    @property
    def places(self) -> NDArray[numpy.int32]: ...
    @property
    def starts(self) -> NDArray[numpy.int64]: ...
    def remote(self, hierarchy: Hierarchy) -> RemoteBricks: ...

class Hole(enum.Enum):
    ellipse = 0

    rectangle = 1

class Whereabouts:
    def __init__(self, origin: Sequence[float], axes: Sequence[Sequence[float]], reach: float) -> None:
        """Origin (m) and unit vectors; flights that start farther from z miss."""

    @property
    def is_turned(self) -> bool: ...

class Aperture:
    def __init__(
        self,
        hole: Hole,
        centre: Sequence[float],
        half_width: Sequence[float],
        z: Sequence[float],
        where: Whereabouts = ...,
    ) -> None: ...
    @property
    def where(self) -> Whereabouts: ...
    @property
    def hole(self) -> Hole: ...
    @property
    def centre(self) -> list[float]: ...
    @property
    def half_width(self) -> list[float]: ...
    @property
    def z(self) -> list[float]: ...

class Screen:
    def __init__(self, z: float, where: Whereabouts = ...) -> None: ...
    @property
    def z(self) -> float: ...
    @property
    def is_turned(self) -> bool: ...

def first_encounters(
    apertures: Sequence[Aperture],
    start: NDArray[numpy.float64],
    end: NDArray[numpy.float64],
    start_offset: Sequence[float],
    end_offset: Sequence[float],
) -> tuple: ...
def crossings(
    screens: Sequence[Screen],
    start: NDArray[numpy.float64],
    end: NDArray[numpy.float64],
    start_offset: Sequence[float],
    end_offset: Sequence[float],
) -> tuple: ...
def count_per_brick(hierarchy: Hierarchy, position: NDArray[numpy.float64]) -> tuple:
    """Places on the curve, ascending, and numbers of particles."""

class Shape(enum.Enum):
    nearest_grid_point = 0

    cloud_in_cell = 1

    triangular = 2

class Deposition:
    def __init__(
        self,
        mesh: ParticleMesh,
        remote: RemoteBricks,
        shape: Shape,
        matched: bool,
        kokkos: bool,
        position: NDArray[numpy.float64],
        momentum: NDArray[numpy.float64],
        weight: NDArray[numpy.float64],
        id: NDArray[numpy.int64],
        starts: NDArray[numpy.int64],
        charge: float,
        density: Field,
    ) -> None: ...
    def begin(self, migration: Migration) -> None:
        """Those that are in their places while others are under way."""

    def finish(self) -> None:
        """Collective."""

    @property
    def left(self) -> int:
        """How many particles of this rank `finish` is to deposit."""

def gather(
    mesh: ParticleMesh,
    remote: RemoteBricks,
    shape: Shape,
    matched: bool,
    kokkos: bool,
    field: ElectricField,
    position: NDArray[numpy.float64],
    momentum: NDArray[numpy.float64],
    weight: NDArray[numpy.float64],
    id: NDArray[numpy.int64],
    starts: NDArray[numpy.int64],
    out: NDArray[numpy.float64],
) -> None: ...
def take_column(
    column: NDArray[numpy.float64],
    places: NDArray[numpy.int64] | None,
    shift: float,
    scale: float,
    out: NDArray[numpy.float64] | None,
) -> tuple:
    """
    Values at places, or all, less `shift` times `scale` into `out`; Σ v, Σ |v|, the least and the greatest v.
    """

def put_into_places(
    values: NDArray[numpy.float64], places: NDArray[numpy.int64], factors: Sequence[float], out: NDArray[numpy.float64]
) -> None:
    """Each vector times three factors to places[n]."""

def gather_into_places(
    mesh: ParticleMesh,
    remote: RemoteBricks,
    shape: Shape,
    matched: bool,
    kokkos: bool,
    field: ElectricField,
    position: NDArray[numpy.float64],
    momentum: NDArray[numpy.float64],
    weight: NDArray[numpy.float64],
    id: NDArray[numpy.int64],
    starts: NDArray[numpy.int64],
    places: NDArray[numpy.int64],
    factors: Sequence[float],
    out: NDArray[numpy.float64],
) -> None:
    """What `gather` finds, times three factors, to places[n]."""

class Pusher(enum.Enum):
    boris = 0

    higuera_cary = 1

def push(
    mesh: ParticleMesh,
    remote: RemoteBricks,
    shape: Shape,
    matched: bool,
    kokkos: bool,
    field: ElectricField,
    position: NDArray[numpy.float64],
    momentum: NDArray[numpy.float64],
    weight: NDArray[numpy.float64],
    id: NDArray[numpy.int64],
    starts: NDArray[numpy.int64],
    charge: NDArray[numpy.float64],
    inverse_mass: NDArray[numpy.float64],
    before: float,
    after: float,
    flight: float,
    pusher: Pusher,
    beta: Sequence[float],
    electric: NDArray[numpy.float64] | None,
    magnetic: NDArray[numpy.float64] | None,
    momentum_out: NDArray[numpy.float64],
    position_out: NDArray[numpy.float64],
    between: NDArray[numpy.float64] | None,
    external: ExternalFields | None,
    time: float,
    shift: Sequence[float],
) -> None: ...
def push_one(
    position: Sequence[float],
    momentum: Sequence[float],
    charge: float,
    mass: float,
    before: float,
    after: float,
    flight: float,
    pusher: Pusher,
    external: ExternalFields,
    time: float,
) -> tuple[list[float], list[float]]:
    """
    Place (m) and momentum (kg m/s) of one particle in the fields of elements alone.
    """

class BeamSums:
    @property
    def weight(self) -> float: ...
    @property
    def kinetic_energy(self) -> float: ...
    @property
    def momentum(self) -> list[float]: ...
    @property
    def mean_x(self) -> list[float]: ...
    @property
    def xx(self) -> list[float]: ...
    @property
    def uu(self) -> list[float]: ...
    @property
    def xu(self) -> list[float]: ...

def beam_sums(
    comm: int | Sequence[int],
    position: NDArray[numpy.float64],
    momentum: NDArray[numpy.float64],
    weight: NDArray[numpy.float64],
    id: NDArray[numpy.int64],
    mass: NDArray[numpy.float64],
    later: NDArray[numpy.float64],
    share: float,
    centre: Sequence[float],
    period: Sequence[float],
) -> BeamSums: ...

class BeamParts:
    def __init__(
        self,
        starts: Sequence[int],
        groups: Sequence[int],
        lower: Sequence[float],
        per_length: Sequence[float],
        slices: int = 1,
        centres: Sequence[Sequence[float]] = [],
        periods: Sequence[Sequence[float]] = [],
    ) -> None:
        """
        Images nearest to the centres (groups, 3) stand for particles where periods (groups, 3) are not 0; m.
        """

def circular_sums(
    comm: int | Sequence[int],
    position: NDArray[numpy.float64],
    momentum: NDArray[numpy.float64],
    weight: NDArray[numpy.float64],
    id: NDArray[numpy.int64],
    mass: NDArray[numpy.float64],
    later: NDArray[numpy.float64],
    share: float,
    parts: BeamParts,
    lower: Sequence[float],
    period: Sequence[float],
) -> list[list[float]]: ...

class BeamMoments:
    @property
    def count(self) -> float: ...
    @property
    def weight(self) -> float: ...
    @property
    def mean(self) -> list[float]: ...
    @property
    def second(self) -> list[list[float]]: ...
    @property
    def planes(self) -> list[list[list[float]]]: ...
    @property
    def lowest(self) -> list[float]: ...
    @property
    def highest(self) -> list[float]: ...

def beam_moments(
    comm: int | Sequence[int],
    position: NDArray[numpy.float64],
    momentum: NDArray[numpy.float64],
    weight: NDArray[numpy.float64],
    id: NDArray[numpy.int64],
    mass: NDArray[numpy.float64],
    later: NDArray[numpy.float64],
    share: float,
    parts: BeamParts,
) -> list[BeamMoments]: ...
def joined_moments(parts: Sequence[BeamMoments]) -> BeamMoments: ...
def amplitude_quantiles(
    comm: int | Sequence[int],
    position: NDArray[numpy.float64],
    momentum: NDArray[numpy.float64],
    weight: NDArray[numpy.float64],
    id: NDArray[numpy.int64],
    mass: NDArray[numpy.float64],
    later: NDArray[numpy.float64],
    share: float,
    layers: Sequence[BeamParts],
    centres: Sequence[Sequence[float]],
    forms: Sequence[Sequence[Sequence[float]]],
    typical: Sequence[Sequence[float]],
    fractions: Sequence[float],
) -> list[float]: ...
def uniforms(seed: int, stream: int, step: int, id: NDArray[numpy.int64], out: NDArray[numpy.float64]) -> None:
    """
    Fill out (4, n) with numbers in (0, 1) that depend on the arguments alone.
    """

def solve_points(
    comm: int,
    row_start: NDArray[numpy.int64],
    column: NDArray[numpy.int64],
    value: NDArray[numpy.float64],
    right_hand_sides: NDArray[numpy.float64],
    tolerance: float,
    most_iterations: int,
) -> tuple:
    """
    This rank's rows of the solutions (vectors, rows), iterations and relative residual. Collective.
    """
