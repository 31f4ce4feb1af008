"""Pictures that ranks make together of the fields they hold are those of the dump."""

from __future__ import annotations

import numpy as np
import pytest

from amrpic import Domain, Field, Hierarchy, VectorField
from amrpic.io import vtkhdf_writer
from amrpic.io.field_reader import Dump, LiveDump
from amrpic.io.provenance import Moment, Provenance
from amrpic.mesh import raster
from amrpic.view import draw, views

DOMAIN = Domain(lower=(-0.02, -0.03, 0.01), upper=(0.02, 0.01, 0.17), cells=(16, 16, 32), boundary="dirichlet")
LEVELS = [[((8, 8, 8), (23, 23, 47))], [((24, 24, 40), (39, 39, 55))]]


@pytest.mark.mpi(ranks=(1, 2, 4))
def test_ranks_together_show_what_the_dump_shows(comm, tmp_path):
    hierarchy = Hierarchy(comm, DOMAIN, LEVELS, max_grid_size=8, blocking_factor=8)
    phi = Field(hierarchy, "V").fill(lambda x, y, z: x + 10 * y + 100 * z)
    rho = Field(hierarchy, "C/m^3").fill(lambda x, y, z: np.exp(-((x / 4e-3) ** 2) - ((z - 0.09) / 3e-2) ** 2) + 0 * y)
    efield = VectorField(*(Field(hierarchy, "V/m").fill(lambda *at, i=i: at[i]) for i in range(3)))
    fields: dict[str, Field | VectorField] = {"phi": phi, "rho": rho.average_down(), "E": efield}
    path = vtkhdf_writer.path_of(tmp_path, 3)
    vtkhdf_writer.write(path, hierarchy, fields, Moment(3, 2e-9), Provenance())
    live = LiveDump(path, hierarchy, fields, Moment(3, 2e-9))
    with Dump(path) as dump:
        spread, expected = raster.spread_of(live), raster.spread_of(dump)
        assert spread.charge == pytest.approx(expected.charge, rel=1e-13, abs=0)
        np.testing.assert_allclose(spread.centre, expected.centre, rtol=1e-12, atol=1e-15)
        for level in (None, 0, 1, 2):
            for axis in range(3):
                one, other = (
                    raster.slice_through(d, "|E|", axis, float(expected.centre[axis]), level) for d in (live, dump)
                )
                np.testing.assert_array_equal(one.values, other.values)
            one, other = (raster.projection(d, "rho", 1, level) for d in (live, dump))
            np.testing.assert_allclose(one.values, other.values, rtol=1e-13)
            line = raster.line_through(dump, expected)
            for name in ("phi", "E"):
                mine, theirs = (raster.line_values(d, name, line, level) for d in (live, dump))
                np.testing.assert_array_equal(mine, theirs)
                view = views.View(name, "line", level=level)
                fitted, expected_fit = (np.asarray(views.numbers(d, expected, view))[0] for d in (live, dump))
                np.testing.assert_array_equal(fitted, expected_fit)
                held = np.isfinite(fitted)
                assert held.any() and np.array_equal(held, np.isfinite(mine))
                exact = line.points @ [1, 10, 100] if name == "phi" else line.points
                np.testing.assert_allclose(fitted[held], exact[held], atol=1e-12)
    drawn = draw.draw(live, tmp_path / "pictures")
    assert [path.name for path in drawn] == [f"fields_00000003_{view.name}.png" for view in views.OVERVIEW]
    comm.Barrier()
    assert all(path.exists() for path in drawn)
