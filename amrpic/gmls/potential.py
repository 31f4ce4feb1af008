"""Poisson's equation on points: electrodes of any shape are points with a potential or a normal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError, SolverError
from ..mpi import MPI
from ..parallel import Communicator, own, share, together
from ..units import VACUUM_PERMITTIVITY
from .inputs import finite, points
from .neighbours import nearby
from .samples import Points
from .spaces import Scalar
from .stencils import Quality, stencils
from .targets import LAPLACIAN, Neumann

MOST_ITERATIONS = 200
MOST_IMBALANCE = 0.1  # of the rms of ρ/ε₀ and of what slopes add to it: more is not an error of the stencils

Dirichlet = tuple[ArrayLike, ArrayLike]  # numbers of sites, and their potentials in V
Slopes = tuple[ArrayLike, ArrayLike, ArrayLike]  # numbers of sites, outward normals, and ∂φ/∂n in V/m


@dataclass(frozen=True, eq=False)
class PointPotential:
    """The potential on points, and how it was found; the same on all ranks except `quality`."""

    phi: np.ndarray  # (m,) V
    iterations: int  # of GMRES
    residual: float  # of the rows, each over its diagonal entry, over that of φ = 0
    imbalance: float  # C/m³: the uniform density added where no site has a potential; else 0
    quality: Quality  # of the stencils of this rank's rows


def poisson(
    comm: MPI.Comm,
    sites: ArrayLike,
    rho: ArrayLike,
    *,
    dirichlet: Dirichlet | None = None,
    neumann: Slopes | None = None,
    order: int = 3,
    reach: float = 1.6,
    tolerance: float = 1e-10,
) -> PointPotential:
    """Return φ on points with -Δφ = ρ/ε₀ there, in 1 to 3 dimensions. Collective; all ranks give all points.

    sites (m, dimension) in m, in the domain and on its boundary, about evenly spaced; rho (m,) in C/m³. `dirichlet`: numbers
    of the sites whose φ is given, and φ in V. `neumann`: numbers of those whose slope is given, outward normals, and ∂φ/∂n in
    V/m; the equation holds there too. Every site of the boundary should be in one of them. Without `dirichlet` the mean of φ
    is zero, and a uniform density makes up for what charge and slopes lack to balance.

    Each row is the Laplacian of a fit of this order to the sites within `reach`, as for `nearby`; a slope is an exact row of
    the fit. Rows are shared out over ranks along a tree of the sites, and solved by GMRES with aggregates. Errors go with
    h^order at orders 2 and 4, with h² at 3; so does the balance of charge and slopes, which least squares do not keep exactly.

    Raises InputError for what does not fit together, and SolverError for a site whose fit is not determined, or if GMRES does
    not come down to the tolerance; the same on all ranks.
    """
    own_comm = own(comm)
    with together(own_comm, InputError):
        data = _Given.checked(sites, rho, dirichlet, neumann)
        if not 0 < tolerance < 1:
            raise InputError(f"tolerance is {tolerance}; give a number between 0 and 1, for instance 1e-10")
        rows = _Rows(own_comm, data, order, reach)
    if data.bounded:
        (phi,), reached = _solved(own_comm, rows, [rows.given], tolerance)
        phi[data.fixed], missing = data.potential, 0.0
    else:
        # Charge that the slopes do not balance leaves through one site, where its potential is steep. So both are found
        # roughly, and anew, to the tolerance, with what makes up for the charge.
        (of_given, of_one), roughly = _solved(own_comm, rows, [rows.given, rows.of_one], tolerance**0.5)
        missing = rows.missing(own_comm, of_given, of_one)
        (phi,), reached = _solved(own_comm, rows, [rows.given + missing * rows.of_one], tolerance)
        added = rows.missing(own_comm, phi, of_one, missing) - missing
        phi += added * of_one
        phi -= phi.mean()
        missing += added
        reached = max(roughly[0], reached[0]), reached[1]
    return PointPotential(phi, *reached, -missing * VACUUM_PERMITTIVITY, rows.quality)


def _solved(
    comm: Communicator, rows: _Rows, vectors: list[np.ndarray], tolerance: float
) -> tuple[np.ndarray, tuple[int, float]]:
    """Return solutions (vectors, m) on all sites, the iterations and the residual of the worst. Collective; SolverError."""
    right = np.array(vectors)
    phi, iterations, residual = _native.solve_points(comm.py2f(), *rows.matrix, right, tolerance, MOST_ITERATIONS)
    if not residual <= tolerance:
        raise SolverError(
            f"GMRES stopped after {iterations} iterations at a residual of {residual:.1e}, not {tolerance:.0e}; take a longer "
            "reach, another order, or more evenly spaced sites"
        )
    values = np.zeros((len(right), rows.count))
    values[:, rows.sites] = phi
    return comm.allreduce(values), (iterations, residual)


@dataclass(frozen=True, eq=False)
class _Given:
    """What `poisson` is given, checked."""

    sites: np.ndarray
    rho: np.ndarray
    fixed: np.ndarray  # numbers of sites
    potential: np.ndarray
    normals: np.ndarray  # (m, dimension), NaN where no slope is given
    slopes: np.ndarray  # (m,)

    @property
    def bounded(self) -> bool:
        """Whether any site has a potential."""
        return len(self.fixed) > 0

    @classmethod
    def checked(cls, sites: ArrayLike, rho: ArrayLike, dirichlet: Dirichlet | None, neumann: Slopes | None) -> _Given:
        where, charge = points(sites, "the sites"), finite(rho, "rho", 1)
        if len(charge) != len(where):
            raise InputError(f"rho has {len(charge)} values for {len(where)} sites; give one for each")
        if dirichlet is None and neumann is None:
            raise InputError("no site has a potential or a slope; give dirichlet, neumann, or both")
        fixed, potential = np.empty(0, dtype=np.int64), np.empty(0)
        normals, slopes = np.full(where.shape, np.nan), np.zeros(len(where))
        if dirichlet is not None:
            fixed = _numbers(dirichlet[0], len(where), "dirichlet")
            potential = _each(dirichlet[1], len(fixed), "the potentials of dirichlet")
        if neumann is not None:
            sloped = _numbers(neumann[0], len(where), "neumann")
            if twice := sorted(set(sloped.tolist()) & set(fixed.tolist())):
                raise InputError(f"site {twice[0]} has a potential and a slope; give one of them")
            directions = finite(neumann[1], "the normals", 2)
            if directions.shape != (len(sloped), where.shape[1]):
                raise InputError(f"the normals have shape {directions.shape}; give {(len(sloped), where.shape[1])}")
            if not (has_normal := directions.any(axis=1)).all():
                raise InputError(f"the normal of site {sloped[int(np.argmin(has_normal))]} is zero; give a direction")
            normals[sloped], slopes[sloped] = directions, _each(neumann[2], len(sloped), "the slopes of neumann")
        if len(fixed) == len(where):
            raise InputError("all sites have a potential, so that none is to be found; leave some out of dirichlet")
        return cls(where, charge, fixed, potential, normals, slopes)


def _numbers(values: ArrayLike, count: int, name: str) -> np.ndarray:
    numbers = np.asarray(values)
    if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
        raise InputError(f"the sites of {name} are not a list of whole numbers; give those of sites, 0 and up")
    if numbers.size and not ((numbers >= 0) & (numbers < count)).all():
        wrong = numbers[(numbers < 0) | (numbers >= count)][0]
        raise InputError(f"{name} names site {wrong}, but there are {count}; use 0 to {count - 1}")
    if len(np.unique(numbers)) < len(numbers):
        raise InputError(f"{name} names a site twice; leave one out")
    return numbers.astype(np.int64)


def _each(number_or_array: ArrayLike, count: int, name: str) -> np.ndarray:
    values = finite(number_or_array, name)
    if values.shape not in ((1,), (count,)):
        raise InputError(f"{name} have shape {values.shape} for {count} sites; give one number or one for each")
    return np.broadcast_to(values, count)


class _Rows:
    """This rank's equations Δφ = f, each over its diagonal entry.

    `matrix` is what `_native.solve_points` takes; right-hand sides are `given`, and `of_one` for Δφ = 1. Without potentials
    φ = 0 takes the place of one equation, which `missing` looks at then: that of the site nearest to the centre, which others
    depend on more than on one of the boundary.
    """

    def __init__(self, comm: Communicator, data: _Given, order: int, reach: float) -> None:
        free = np.ones(len(data.sites), dtype=bool)
        free[data.fixed] = False
        along = scipy.spatial.cKDTree(
            data.sites
        ).indices  # leaf by leaf: places near each other have numbers near each other
        unknown = along[free[along]]
        first, last = share(comm, len(unknown))
        self.sites, self.count = unknown[first:last], len(data.sites)
        targets = data.sites[self.sites]
        exact = [Neumann(data.normals[self.sites])] if np.isfinite(data.normals).any() else []
        weights = stencils(
            targets,
            nearby(data.sites, targets, order=order, reach=reach),
            space=Scalar(order),
            samples=Points(data.sites),
            wanted=[LAPLACIAN],
            exact=exact,
        )
        self.quality = weights.quality
        laplacian = weights.matrix("laplacian")
        f = -data.rho[self.sites] / VACUUM_PERMITTIVITY
        if exact:
            f = f - weights.exact_weights[:, 0, 0] * data.slopes[self.sites]
        self._f = f = f - laplacian[:, data.fixed] @ data.potential
        among = scipy.sparse.csr_array(laplacian[:, unknown])
        diagonal = among[np.arange(last - first), np.arange(first, last)]
        self._replaced = None
        if not data.bounded:
            distances = ((data.sites[unknown] - data.sites.mean(axis=0)) ** 2).sum(axis=1)
            row = int(np.argmin(distances)) - first
            if 0 <= row < last - first:
                self._replaced = f[row], laplacian[[row]]
                entries = slice(among.indptr[row], among.indptr[row + 1])
                among.data[entries] = np.where(among.indices[entries] == first + row, diagonal[row], 0.0)
        scaled = among.data / np.repeat(diagonal, np.diff(among.indptr))
        self.matrix = among.indptr.astype(np.int64), among.indices.astype(np.int64), scaled
        self.given, self.of_one = f / diagonal, 1 / diagonal
        if self._replaced is not None:
            self.given[row] = self.of_one[row] = 0.0

    def missing(self, comm: Communicator, of_given: np.ndarray, of_one: np.ndarray, added: float = 0.0) -> float:
        """Return the constant that all equations lack, from their solutions (m,), the first one of those with `added` on the
        right. Collective; InputError on all ranks."""
        lacks = 0.0
        if self._replaced is not None:
            f, laplacian = self._replaced
            lacks = added + (f + added - (laplacian @ of_given)[0]) / ((laplacian @ of_one)[0] - 1)
        lacks, size, count = comm.allreduce(np.array([lacks, np.abs(self._f).sum(), len(self._f)]))
        if abs(lacks) > MOST_IMBALANCE * size / count:
            raise InputError(
                f"charge and slopes do not balance: {abs(lacks) / (size / count):.0%} of them is left over; where no site has "
                "a potential, slopes must add up to -charge/ε₀ over the boundary"
            )
        return float(lacks)
