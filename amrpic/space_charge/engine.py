"""Arrays in, field or kick out: the space charge of particles that another code tracks."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from ..errors import AmrpicError, HierarchyError, InputError
from ..mesh.domain import Domain
from ..mesh.field import VectorField
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..parallel import Communicator, own, together
from ..particles.clouds import SHAPES, Clouds, Shape, are_cubes, compensation_pays, matched_pays
from ..particles.particles import Particles
from ..scene.complaints import settings
from ..scene.refinement import Refinement
from ..scene.refinement_rules import CallableRule, MomentumRule, RuleKind, RuleOfElectrodes, every_rule
from ..scene.solver_options import SolverSection
from ..units import SPEED_OF_LIGHT
from . import callers_arrays
from .callers_arrays import ColumnSums
from .callers_order import Buffers, CallersOrder, Taken
from .charge_on_mesh import ChargeOnMesh, Memory
from .placing import Coordinates, Extent, Placing, extent_of, levels_for, sizes_of

NOWHERE = (ColumnSums(),) * 3
LARGEST_DENSITY = 1e270  # C/m³; potential and field need some powers of ten above it


class SpaceCharge:
    """Finds the field of a bunch whose particles are arrays of another code, and the kick that it gives them.

    The bunch moves along z with the Lorentz factor γ, and its field is solved for where it is at rest. Mesh, solver and
    potential serve the next call as well: particles that drift cost no new mesh, which moves along with their mean.

    `domain`: "open" for a box that follows the bunch in free space, or an `amrpic.Domain` that stays where it is, with walls
    and periods (lower and upper in m, as x, y and z are). Particles outside such a domain feel nothing and have no charge.
    `cells`: base cells of an open domain, one number or three for x, y and z; by default 32, and 64 along axes in which the
    bunch, where it is at rest, is more than twice as long as in the shortest.
    `levels`: refined levels, each of half the cell width; "auto": as many as give the bunch 8 cells per rms size, and no more
    than its particles fill.
    `rule`: what is refined, as in scenes: a rule of `amrpic`, a dictionary, or a function of x, y, z, rho, …; by default where
    |ρ| exceeds a thousandth of its largest value.
    `regrid_every`: calls of `field` and `kick` after which the refined levels follow the bunch; 0: never. Particles that leave
    an open domain, and a bunch that has become half as long at a regrid, or a quarter at once, bring about a new one.
    `tolerance`: of the solve: "discretization" stops at a tenth of the error that the mesh makes; a number bounds the residual.
    `form`: "3d"; nothing else yet.
    `shape`, `compensation`: of the particles' clouds, as in scenes: [particles]. With "clouds-and-mesh" the solver is of fourth
    order where cells are no cubes.
    `reproducible`: whoever holds which particle and in which order, results of the same calls are the same to the last bit on
    the same number of ranks; it costs two sorts of the particles.
    `comm`: communicator of all ranks that call, COMM_WORLD by default.

    Calls are collective: each rank brings particles of its own, or none, and its results come back in its order. Errors are
    one sentence and raised on all ranks: InputError for arrays, SolverError for a solve. Copies and pickles hold settings,
    and make a mesh of their own.
    """

    def __init__(
        self,
        domain: Literal["open"] | Domain = "open",
        cells: int | Sequence[int] | None = None,
        levels: int | Literal["auto"] = "auto",
        rule: RuleKind | dict[str, Any] | Callable[..., Any] | None = None,
        regrid_every: int = 10,
        tolerance: float | Literal["discretization"] = "discretization",
        *,
        form: Literal["3d"] = "3d",
        shape: Shape = "cloud-in-cell",
        compensation: Literal["auto", "none", "clouds", "clouds-and-mesh"] = "auto",
        reproducible: bool = False,
        comm: MPI.Comm | None = None,
    ) -> None:
        self.settings = {name: value for name, value in locals().items() if name not in ("self", "__class__")}
        if form != "3d":
            raise InputError(f'form is {form!r}; use "3d"')
        if compensation not in ("auto", "none", "clouds", "clouds-and-mesh"):
            raise InputError(f'compensation is {compensation!r}; use "auto", "none", "clouds" or "clouds-and-mesh"')
        if shape not in SHAPES:
            raise InputError(f"shape is {shape!r}; use one of {', '.join(SHAPES)}")
        self._shape, self._compensation = shape, compensation
        self._placing = Placing(*_domain(domain, cells))
        self._auto_levels = levels == "auto"
        refinement = _refinement(rule, levels=1 if self._auto_levels else levels, regrid_every=regrid_every)
        options = settings(SolverSection, {"tolerance": tolerance}, InputError)
        self._levels = refinement.levels
        self._memory = Memory(refinement, options)
        self._order, self._order_of_places = CallersOrder(reproducible), CallersOrder()
        self._comm: Communicator | None = None
        self._hierarchy: Hierarchy | None = None
        self._servers: np.ndarray | None = None
        self._calls = 0  # since the domain is what it is
        self._buffers = Buffers()
        self.outside = 0  # living particles that lay outside the domain in the latest call

    def field(
        self,
        x: Any,
        y: Any,
        z: Any,
        charge: Any,
        gamma: float = 1.0,
        at: Any = None,
        *,
        alive: Any = None,
        magnetic: bool = False,
    ) -> Any:
        """Return the electric field in V/m in the laboratory, (n, 3): at the particles, or (m, 3) at other places. Collective.

        `x`, `y`, `z` (n,): where the particles are at one time, m. `charge`: of each macroparticle, signed, C; one number for
        all, or (n,). `gamma`: Lorentz factor of the bunch along z, the same on all ranks; 1: at rest. `at`: other places at
        the same time, three arrays (m,) or one (m, 3), m. `alive` (n,) bool: the others, whose values may be anything, have no
        charge and get 0. With `magnetic`, the magnetic field in T, (n, 3) or (m, 3), as well: β × E / c.

        Arrays are read where they are, in any stride; other types than float64 are converted, complex ones refused.
        """
        out, gamma = self._times(lambda _, gamma: (gamma, gamma, 1.0), x, y, z, charge, gamma, at, alive)
        if not magnetic:
            return out
        bfield, beta = np.zeros_like(out), np.sqrt(1 - gamma**-2)
        bfield[:, 0], bfield[:, 1] = out[:, 1] * (-beta / SPEED_OF_LIGHT), out[:, 0] * (beta / SPEED_OF_LIGHT)
        return out, bfield

    def kick(
        self,
        x: Any,
        y: Any,
        z: Any,
        charge: Any,
        length: float,
        beta0: float,
        gamma0: float,
        charge_to_mass: Any,
        *,
        alive: Any = None,
    ) -> np.ndarray:
        """Return the change of momentum over the reference momentum, (n, 3), along a path of a length. Collective.

        It is q/m · L/(β₀² γ₀ c²) · (E_x/γ₀², E_y/γ₀², E_z): with the magnetic field of the bunch, to be added to px/p₀, py/p₀
        and the longitudinal p_z/p₀.

        `x`, `y`, `z`, `charge`, `alive`: as in `field`. `length`: of the path, m, of any sign. `beta0`, `gamma0`: velocity over
        c and Lorentz factor of the reference particle, with which the bunch moves. `charge_to_mass`: of a real particle,
        signed, C/kg; one number for all, or (n,).
        """

        ratios: list[np.ndarray | float] = []

        def factors(count: int, gamma: float) -> tuple[float, float, float]:
            path, beta = callers_arrays.number(length, "length"), callers_arrays.number(beta0, "beta0", above=0)
            ratios.append(callers_arrays.finite_or_column(charge_to_mass, "charge_to_mass", count, alive))
            if abs(beta - np.sqrt(1 - gamma**-2)) > 1e-6:
                raise InputError(f"beta0 is {beta}, but gamma0 = {gamma} means {np.sqrt(1 - gamma**-2)}; correct one")
            along = path / (beta**2 * SPEED_OF_LIGHT**2 * gamma)
            return along / gamma, along / gamma, along

        out, _ = self._times(factors, x, y, z, charge, gamma0, None, alive, "gamma0")
        for column in out.T:
            np.multiply(
                column, ratios[0], out=column, where=True if alive is None else np.asarray(alive)
            )  # the others have 0
        return out

    @property
    def hierarchy(self) -> Hierarchy | None:
        """The mesh of the latest call, in its own coordinates: x, y and γz from `centre`; None before the first."""
        return self._hierarchy

    @property
    def centre(self) -> np.ndarray:
        """Where the origin of the mesh's coordinates was in the latest call, (3,) m."""
        return self._placing.centre.copy()

    @property
    def cycles(self) -> int:
        """Cycles that the latest solve took."""
        return 0 if self._memory.report is None else self._memory.report.cycles

    # ---- a call ----
    def _times(
        self,
        factors: Callable[[int, float], tuple[float, float, float]],
        x: Any,
        y: Any,
        z: Any,
        charge: Any,
        gamma: Any,
        at: Any,
        alive: Any,
        name: str = "gamma",
    ) -> tuple[np.ndarray, float]:
        """Return the field (n, 3) in V/m where the bunch is at rest, times factors, and γ, which has a name. Collective.

        `factors`: of how many particles this rank brings, and γ.
        """
        comm = self._comm = own(MPI.COMM_WORLD if self.settings["comm"] is None else self.settings["comm"])
        order, others, placing = self._order, self._order_of_places, self._placing
        with together(comm, InputError):
            arrays = callers_arrays.particles(x, y, z, charge, alive)
            lorentz = callers_arrays.lorentz_factor(gamma, name)
            places = None if at is None else callers_arrays.other_places(at)
            times = factors(len(arrays), lorentz)
            before = Coordinates(placing.centre, lorentz)
            self._buffers.serve(len(arrays) + (0 if places is None else len(places)))
            taken, points = order.take(arrays, before), None if places is None else others.take(places, before)
        counts = self._counts(comm, len(arrays), -1 if places is None else len(places), lorentz)
        extent = extent_of(
            comm, len(taken), taken.magnitude, taken.places, NOWHERE if points is None else points.places
        )
        if extent.count == 0 or extent.magnitude == 0 or (extent.count == 1 and places is None and placing.free):
            self.outside = 0
            return np.zeros((len(arrays if places is None else places), 3)), lorentz
        with together(comm, InputError):
            anew = placing.follow(extent, lorentz, self._regrids)
        taken = order.moved(taken, arrays, before, placing.coordinates)
        particles, efield = self._solved(comm, extent, taken, counts[:, 0], anew)
        self._calls += 1
        if places is not None and points is not None:
            points = others.moved(points, places, before, placing.coordinates)
            where_asked = others.particles(points, int(counts[: comm.rank, 1].sum()))
            particles = others.sort(efield.hierarchy, where_asked, None)
            order, counts = others, counts[:, 1:]
        return order.back(efield, particles, self._memory.clouds, counts[:, 0], times), lorentz

    def _solved(
        self, comm: Communicator, extent: Extent, taken: Taken, counts: np.ndarray, anew: bool
    ) -> tuple[Particles, VectorField]:
        """Return the particles sorted on the mesh, and their field there. Collective."""
        memory, order, due = self._memory, self._order, anew or self._regrids
        if anew:
            self._begin(comm, extent, taken)
        assert self._hierarchy is not None
        given = order.particles(taken, int(counts[: comm.rank].sum()))
        charge = ChargeOnMesh(memory, order.sort(self._hierarchy, given, self._servers), extent.magnitude)
        self.outside = order.outside
        if due and memory.refinement.follows:
            charge = charge.followed(1.0 if anew else memory.refinement.hysteresis, order.sort)
        particles = charge.particles
        assert particles.sorting is not None
        self._hierarchy, self._servers = particles.sorting.hierarchy, particles.sorting.servers
        return particles, charge["efield"]

    def _begin(self, comm: Communicator, extent: Extent, taken: Taken) -> None:
        """Make a mesh of the base alone on a new domain, and choose its levels and the clouds. Collective."""
        domain, memory = self._placing.domain, self._memory
        assert domain is not None
        count, number, rms = sizes_of(comm, taken.position, taken.charge, extent.magnitude, domain)
        domain = self._placing.suited(rms)
        levels = levels_for(domain, rms, count) if self._auto_levels else self._levels
        memory.refinement = memory.refinement.model_copy(update={"levels": levels})
        widths = domain.spacing / 2**levels
        _require_density(extent, widths)
        pays = compensation_pays(number, rms / widths, self._shape)
        compensation = ("clouds-and-mesh" if pays else "none") if self._compensation == "auto" else self._compensation
        matched = levels > 0 and matched_pays(number, rms / widths)
        memory.clouds = Clouds(self._shape, matched, compensation)
        of_mesh = compensation == "clouds-and-mesh" and not are_cubes(widths)  # in cubes κ sees to it
        memory.options = memory.options.model_copy(update={"order": 4 if of_mesh else 2})
        memory.start_anew()
        sizes = memory.refinement.max_grid_size, memory.refinement.blocking_factor
        self._hierarchy, self._servers, self._calls = Hierarchy(comm, domain, (), *sizes), None, 0

    @property
    def _regrids(self) -> bool:
        period = self._memory.refinement.regrid_every
        return period > 0 and self._calls > 0 and self._calls % period == 0

    def _counts(self, comm: Communicator, particles: int, places: int, gamma: float) -> np.ndarray:
        """Return how many particles and places each rank brings, (ranks, 2). Collective; InputError on all ranks where they
        ask for different things."""
        own_values = np.array([particles, places, gamma])
        values = np.empty((comm.size, 3))
        if comm.size == 1:
            values[0] = own_values
        else:
            comm.Allgather(own_values, values)
        if (values[:, 2] != gamma).any() or ((values[:, 1] < 0) != (places < 0)).any():
            raise InputError(
                "ranks differ in gamma, or some give other places (at) and some none; let all ask for the same"
            )
        return np.maximum(values[:, :2], 0).astype(np.int64)

    # ---- copies ----
    def __copy__(self) -> SpaceCharge:
        return SpaceCharge(**self.settings)

    def __deepcopy__(self, memo: dict[int, Any]) -> SpaceCharge:
        settings = {
            name: value if name == "comm" else copy.deepcopy(value, memo) for name, value in self.settings.items()
        }
        return SpaceCharge(**settings)

    def __reduce__(self) -> tuple[Any, ...]:
        if self.settings["comm"] not in (None, MPI.COMM_WORLD, MPI.COMM_SELF):
            raise AmrpicError("a SpaceCharge on a communicator of its own cannot be pickled; leave comm out")
        alone = self.settings["comm"] == MPI.COMM_SELF
        return _unpickled, ({**self.settings, "comm": None}, alone)

    def __repr__(self) -> str:
        mesh = "no mesh yet" if self._hierarchy is None else repr(self._hierarchy)
        return f"SpaceCharge({mesh})"


def _unpickled(settings: dict[str, Any], alone: bool) -> SpaceCharge:
    return SpaceCharge(**{**settings, "comm": MPI.COMM_SELF if alone else None})


def _require_density(extent: Extent, widths: np.ndarray) -> None:
    """Raise InputError where all charge in one cell has a density that double precision does not hold with its field."""
    if extent.magnitude > 0 and np.log10(extent.magnitude) - np.log10(widths).sum() > np.log10(LARGEST_DENSITY):
        size = float((extent.upper - extent.lower).max())
        raise InputError(
            f"the particles, of {extent.magnitude:.3g} C in all, lie within {size:.3g} m, where double precision does not hold "
            "their density; give places in m and charges in C"
        )


def _domain(domain: Any, cells: Any) -> tuple[Domain | None, tuple[int, int, int] | None]:
    """Return the domain that is given, None for one that follows the bunch, and the base cells, None if left open."""
    if isinstance(domain, Domain):
        if cells is not None:
            raise InputError(
                f"cells are given ({cells}) as well as a domain, which has {domain.cells}; leave cells out"
            )
        return domain, domain.cells
    if domain != "open":
        raise InputError(f'domain is {domain!r:.60}; give "open", or an amrpic.Domain')
    try:
        return None, None if cells is None else Domain(0.0, 1.0, cells).cells
    except HierarchyError as refused:
        raise InputError(str(refused).replace("domain.cells", "cells")) from None


def _rule(rule: Any) -> dict[str, Any]:
    """Return the rule as a value of the section of refinement, nothing for the default."""
    if rule is None:
        return {}
    if callable(rule):
        rule = CallableRule(function=rule)
    return {"rule": rule}


def _refinement(rule: Any, **values: Any) -> Refinement:
    """Return the section that says what is refined. InputError for a wrong one, or a rule that looks at what is not there."""
    refinement = settings(Refinement, {**values, **_rule(rule)}, InputError)
    for _, part in every_rule(refinement.rule):
        if isinstance(part, MomentumRule):
            raise InputError("rule looks at momenta, which no one gives; use another rule, such as charge-density")
        if isinstance(part, RuleOfElectrodes):
            raise InputError(
                "rule looks at electrodes, of which there are none; use another rule, such as charge-density"
            )
    return refinement
