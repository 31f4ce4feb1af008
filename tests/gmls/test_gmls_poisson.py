"""Poisson's equation on points, against a manufactured solution and a dense one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import gmls
from amrpic.errors import InputError, SolverError
from amrpic.units import VACUUM_PERMITTIVITY
from verify.least_squares import ball, cube


@pytest.mark.mpi(ranks=(2, 3))
@pytest.mark.parametrize("sloped", ["on a part", "everywhere"])
def test_ranks_find_the_same_potential(comm, sloped):
    cloud = cube(10)
    alone, together = (gmls.poisson(c, cloud.sites, cloud.rho, **cloud.walls(sloped)) for c in (MPI.COMM_SELF, comm))
    assert np.abs(alone.phi - together.phi).max() < 1e-9 * np.abs(alone.phi).max()
    assert alone.imbalance == pytest.approx(together.imbalance, rel=1e-6, abs=1e-12 * VACUUM_PERMITTIVITY)


@pytest.mark.parametrize("dimension", [1, 2])
def test_a_quadratic_potential_is_exact_in_fewer_dimensions(dimension):
    rng = np.random.default_rng(1)
    x = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    wall = ((x == 0) | (x == 1)).any(axis=1)
    x[~wall] += rng.uniform(-0.02, 0.02, (int((~wall).sum()), dimension))
    phi = 1 + x.sum(axis=1) - (x**2).sum(axis=1)
    rho = np.full(len(x), 2.0 * dimension * VACUUM_PERMITTIVITY)
    found = gmls.poisson(MPI.COMM_SELF, x, rho, dirichlet=(np.flatnonzero(wall), phi[wall]), order=2)
    assert np.abs(found.phi - phi).max() < 1e-8


def test_the_potential_solves_the_equations_of_its_stencils():
    """By a dense solve of rows that are put together anew."""
    cloud = cube(6)
    walls = cloud.walls("on a part")
    (fixed, potential), (sloped, normals, slopes) = walls["dirichlet"], walls["neumann"]
    direction, slope = np.full(cloud.sites.shape, np.nan), np.zeros(len(cloud.sites))
    direction[sloped], slope[sloped] = normals, slopes
    stencils = gmls.stencils(
        cloud.sites, gmls.nearby(cloud.sites, cloud.sites, order=3), space=gmls.Scalar(3),
        samples=gmls.Points(cloud.sites), wanted=[gmls.LAPLACIAN], exact=[gmls.Neumann(direction)],
    )  # fmt: skip
    rows = stencils.matrix("laplacian").toarray()
    right = -cloud.rho / VACUUM_PERMITTIVITY - stencils.exact_weights[:, 0, 0] * slope
    rows[fixed], right[fixed] = np.eye(len(rows))[fixed], potential
    found = gmls.poisson(MPI.COMM_SELF, cloud.sites, cloud.rho, **walls)
    assert np.abs(found.phi - np.linalg.solve(rows, right)).max() < 1e-8


def test_no_site_is_a_sink_where_nothing_holds_the_potential():
    """Else rounding of the steep potential about it leaves 6e-12 here, and more on larger clouds."""
    cloud = ball(10)
    found = gmls.poisson(MPI.COMM_SELF, cloud.sites, cloud.rho, order=4, tolerance=1e-12, **cloud.walls("everywhere"))
    assert found.residual <= 1e-12


def test_the_page_finds_the_potential_of_a_sphere():
    page = (Path(__file__).parents[2] / "docs" / "gmls.md").read_text(encoding="utf-8")
    (block,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "gmls.poisson" in block)
    seen: dict[str, Any] = {}
    exec(block, seen)
    assert seen["found"].phi.max() == pytest.approx(1e-12 / (6 * VACUUM_PERMITTIVITY), rel=0.05)


def test_charge_that_slopes_do_not_balance_by_little_is_made_up_for():
    cloud = cube(8)
    walls = cloud.walls("everywhere")
    more = 0.01 * np.abs(cloud.rho).mean()
    plain, shifted = (gmls.poisson(MPI.COMM_SELF, cloud.sites, cloud.rho + d, **walls) for d in (0.0, more))
    assert plain.imbalance - shifted.imbalance == pytest.approx(more, rel=1e-6)
    assert np.abs(plain.phi - shifted.phi).max() < 1e-8
    assert abs(plain.phi.mean()) < 1e-12


CLOUD = cube(4)
WALLS = CLOUD.walls("on a part")
FIXED, POTENTIAL = WALLS["dirichlet"]
SLOPED, NORMALS, SLOPES = WALLS["neumann"]
ALL = np.arange(len(CLOUD.sites))
EVERYWHERE = CLOUD.walls("everywhere")["neumann"][:2]
NAN = np.full_like(CLOUD.sites, np.nan)
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "a site that is not finite": ({"sites": NAN}, r"the sites hold nan at \[0, 0\]"),
    "too few densities": ({"rho": CLOUD.rho[:5]}, "rho has 5 values for 64 sites"),
    "nothing given at the boundary": ({"dirichlet": None, "neumann": None}, "no site has a potential or a slope"),
    "a site that is not there": ({"dirichlet": ([64], 0.0)}, "dirichlet names site 64, but there are 64"),
    "a site twice": ({"dirichlet": ([1, 1], 0.0)}, "dirichlet names a site twice"),
    "sites that are no numbers": ({"dirichlet": ([0.5], 0.0)}, "the sites of dirichlet are not a list of whole numbers"),
    "too few potentials": ({"dirichlet": (FIXED, [1.0, 2.0])}, r"the potentials of dirichlet have shape \(2,\)"),
    "both at one site": ({"dirichlet": (SLOPED[:1], 0.0)}, "has a potential and a slope"),
    "a normal of length zero": ({"neumann": (SLOPED, 0 * NORMALS, SLOPES)}, "the normal of site .* is zero"),
    "too few normals": ({"neumann": (SLOPED, NORMALS[:2], SLOPES)}, r"the normals have shape \(2, 3\)"),
    "nothing to be found": ({"dirichlet": (ALL, 0.0), "neumann": None}, "all sites have a potential"),
    "an order that is not there": ({"order": 5}, "order"),
    "no tolerance": ({"tolerance": 0.0}, "tolerance is 0"),
    "slopes that do not balance": ({"dirichlet": None, "neumann": (*EVERYWHERE, 1e3)}, "do not balance"),
}  # fmt: skip


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_on_all_ranks(comm, name):
    changed, sentence = BAD[name]
    given: dict[str, Any] = {"sites": CLOUD.sites, "rho": CLOUD.rho, **WALLS, "order": 2, **changed}
    with pytest.raises(InputError, match=sentence):
        gmls.poisson(comm, **given)


@pytest.mark.mpi(ranks=(1, 2))
def test_sites_in_a_plane_are_reported(comm):
    flat = CLOUD.sites * [1, 1, 0]
    with pytest.raises((SolverError, InputError), match=r"plane|one place"):
        gmls.poisson(comm, flat + 1e-15 * CLOUD.sites, CLOUD.rho, **WALLS)


def test_a_cloud_says_what_its_potential_is():
    laplacian = sum((CLOUD.potential(CLOUD.sites + d) + CLOUD.potential(CLOUD.sites - d)) for d in 1e-4 * np.eye(3))
    rho = -VACUUM_PERMITTIVITY * (laplacian - 6 * CLOUD.potential(CLOUD.sites)) / 1e-8
    assert np.abs(rho - CLOUD.rho).max() < 1e-5 * np.abs(rho).max()
