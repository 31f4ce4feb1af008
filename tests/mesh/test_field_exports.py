"""Fields in xarray, yt and PyVista: the same values at the same places."""

from __future__ import annotations

import numpy as np
import pytest

import amrpic


def field() -> amrpic.Field:
    domain = amrpic.Domain((-1, -2, 0), (1, 2, 6), (8, 12, 16))
    hierarchy = amrpic.Hierarchy(domain, [[((4, 4, 8), (11, 15, 19))]], max_grid_size=8, blocking_factor=4)
    return amrpic.Field(hierarchy, "V").fill(lambda x, y, z: x + 10 * y + 100 * z).average_down()


@pytest.mark.mpi(ranks=(1, 2))
def test_xarray_has_coordinates_and_nan_where_a_level_has_no_cells(comm):
    xarray = pytest.importorskip("xarray")
    one = field()
    base = one.to_xarray(0, "phi")
    assert isinstance(base, xarray.DataArray) and base.dims == ("x", "y", "z") and base.shape == (8, 12, 16)
    np.testing.assert_allclose(base, base.x + 10 * base.y + 100 * base.z, rtol=1e-13)
    fine = one.to_xarray(1)
    assert fine.shape == (8, 12, 12) and fine.attrs == {"units": "V", "level": 1} and not np.isnan(fine).any()
    assert float(fine.sel(x=0.3, y=-0.2, z=3.1, method="nearest")) == pytest.approx(0.3125 - 2.5 + 309.375)
    with pytest.raises(amrpic.HierarchyError, match="level 2 does not exist"):
        one.to_xarray(2)


def test_yt_integrates_to_the_same(comm):
    pytest.importorskip("yt")
    one = field()
    data = one.to_yt("phi").all_data()
    volumes = data["index", "cell_volume"].to("m**3")
    assert float(volumes.sum()) == pytest.approx(48.0)
    assert float((data["stream", "phi"] * volumes).sum()) == pytest.approx(one.integral(), rel=1e-12)
    assert str(data["stream", "phi"].units) == "V"


def test_pyvista_hides_covered_cells(comm):
    pytest.importorskip("pyvista")
    one = field()
    blocks = one.to_pyvista("phi")
    shown = [(b.cell_data["vtkGhostType"] == 0, b) for b in blocks]
    assert sum(int(seen.sum()) for seen, _ in shown) == 8 * 12 * 16 - 4 * 6 * 6 + 8 * 12 * 12
    total = sum(float(b.cell_data["phi"][seen].sum()) * np.prod(b.spacing) for seen, b in shown)
    assert total == pytest.approx(one.integral(), rel=1e-12)
    assert blocks.bounds == pytest.approx((-1, 1, -2, 2, 0, 6))


def test_a_vector_field_has_a_magnitude_and_goes_along(comm):
    one = field()
    vector = amrpic.VectorField(one, 2 * one, -one)
    assert vector.magnitude().max() == pytest.approx(np.sqrt(6) * one.max(), rel=1e-14)
    assert vector.magnitude().unit == "V"
    pytest.importorskip("pyvista")
    first = vector.to_pyvista()[0]
    assert first is not None and set(first.cell_data.keys()) == {"E_x", "E_y", "E_z", "vtkGhostType"}
