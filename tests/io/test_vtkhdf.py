"""Field dumps, judged by VTK's own reader."""

from __future__ import annotations

import json

import numpy as np
import pytest

from amrpic.errors import InputError, OutputError
from amrpic.io import vtkhdf_writer, writer_ranks
from amrpic.io.field_reader import Dump
from amrpic.io.provenance import Moment
from amrpic.io.shared_file import part_of
from amrpic.io.writer_ranks import Writers
from full_disk import file_size_limit
from linear_dump import ABOUT, DOMAIN, dumped, phi_at, write
from vtk_files import vtk_read


def vtk_cells(image):
    """Cell centres (n, 3) of an image as VTK understands them, and whether each is shown."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    counts = [max(n - 1, 1) for n in image.GetDimensions()]
    lower, spacing = np.array(image.GetBounds()[::2]), np.array(image.GetSpacing())
    k, j, i = np.meshgrid(*(np.arange(n) for n in reversed(counts)), indexing="ij")
    centres = lower + (np.stack([i, j, k], axis=-1).reshape(-1, 3) + 0.5) * spacing
    ghost = image.GetCellData().GetArray("vtkGhostType")
    shown = np.ones(len(centres), bool) if ghost is None else vtk_to_numpy(ghost) == 0
    return centres, shown


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("writers", [1, 0])
def test_vtk_reads_the_right_values_at_the_right_places(comm, tmp_path, monkeypatch, writers):
    from vtkmodules.util.numpy_support import vtk_to_numpy

    monkeypatch.setattr(writer_ranks, "PIECE_BYTES", 10_000)
    path = vtkhdf_writer.path_of(tmp_path, 7)
    hierarchy = write(comm, path, writers)
    amr = vtk_read(path)
    assert amr.GetNumberOfLevels() == hierarchy.levels
    volume = 0.0
    for level in range(hierarchy.levels):
        assert amr.GetNumberOfBlocks(level) == len(hierarchy.boxes(level))
        corners = set()
        for block in range(amr.GetNumberOfBlocks(level)):
            image = amr.GetDataSetAsImageData(level, block)
            centres, shown = vtk_cells(image)
            data = image.GetCellData()
            np.testing.assert_allclose(vtk_to_numpy(data.GetArray("E")), 1e6 * centres, rtol=1e-12, atol=1e-6)
            np.testing.assert_allclose(vtk_to_numpy(data.GetArray("phi")), phi_at(*centres.T), rtol=1e-12)
            np.testing.assert_allclose(image.GetSpacing(), hierarchy.spacing(level), rtol=1e-14)
            volume += shown.sum() * np.prod(image.GetSpacing())
            corners.add(tuple(np.round((centres[0] - DOMAIN.lower) / hierarchy.spacing(level) - 0.5).astype(int)))
        assert corners == {tuple(box[:3]) for box in hierarchy.boxes(level)}
    # What VTK shows covers the domain once: cells under a finer level are blanked.
    assert volume == pytest.approx(0.24 * 0.48 * 0.64, rel=1e-12)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("writers", [1, 0])
def test_our_reader_gives_back_every_box(comm, tmp_path, writers):
    path = vtkhdf_writer.path_of(tmp_path, 7)
    hierarchy = write(comm, path, writers)
    with Dump(path) as dump:
        assert (dump.step, dump.time, dump.version, dump.seed) == (7, 1.25e-9, "0.1.0", 42)
        assert json.loads(dump.scene_text) == ABOUT.scene
        assert dump.units == {"phi": "V", "E": "V/m"}
        np.testing.assert_array_equal(dump.lower, DOMAIN.lower)
        np.testing.assert_array_equal(dump.upper, DOMAIN.upper)
        assert len(dump.levels) == hierarchy.levels
        _, values = dumped(comm)
        for patch in values["phi"].patches:
            boxes = dump.levels[patch.level].boxes
            box = int(np.flatnonzero(np.all(boxes == [*patch.lower, *patch.upper], axis=1))[0])
            np.testing.assert_array_equal(dump.values("phi", patch.level, box), patch.data)
            np.testing.assert_array_equal(
                dump.values("E", patch.level, box)[..., 2][0, 0], 1e6 * patch.centres()[2][0, 0]
            )
            np.testing.assert_array_equal(dump.covered(patch.level, box), patch.covered)


@pytest.mark.mpi(ranks=(2,))
def test_a_dump_replaces_an_earlier_one_and_its_parts(comm, tmp_path):
    path = vtkhdf_writer.path_of(tmp_path, 0)
    if comm.rank == 0:
        (tmp_path / "fields_00000000.part0007.tmp").write_bytes(b"half")  # of a run that was killed
    write(comm, path, writers=2)
    assert len(list(tmp_path.iterdir())) == 3
    comm.barrier()
    write(comm, path, writers=1)
    assert list(tmp_path.iterdir()) == [path]
    with Dump(path) as dump:
        assert np.isfinite(dump.values("phi", 2, 0)).all()


@pytest.mark.mpi(ranks=(2,))
@pytest.mark.parametrize("writers", [1, 2])
def test_a_dump_that_cannot_be_written_is_one_error_and_leaves_nothing(comm, tmp_path, writers):
    hierarchy, values = dumped(comm)
    missing = tmp_path / "nowhere"
    with pytest.raises(OutputError, match=r"cannot write fields .*: No such file or directory; .*folder") as caught:
        vtkhdf_writer.write(
            vtkhdf_writer.path_of(missing, 7), hierarchy, values, Moment(7, 0.0), ABOUT, Writers(writers)
        )
    assert len(set(comm.allgather(str(caught.value)))) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.mpi(ranks=(2,))
@pytest.mark.parametrize("room", [0, 1_000, 4_097, 9_000, 20_000, 33_333])
@pytest.mark.parametrize("writers", [1, 2])
def test_a_disk_that_fills_up_keeps_the_old_dump(comm, tmp_path, writers, room):
    path = vtkhdf_writer.path_of(tmp_path, 7)
    write(comm, path, writers)
    before = sorted(p.name for p in tmp_path.iterdir())
    comm.barrier()  # before the other rank writes again
    hierarchy, values = dumped(comm)
    full = file_size_limit(room if comm.rank == 0 else None)
    with full, pytest.raises(OutputError, match=r"cannot write fields .*: File too large; .*folder"):
        vtkhdf_writer.write(path, hierarchy, values, Moment(7, 0.0), ABOUT, Writers(writers))
    comm.barrier()
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    with Dump(path) as dump:
        assert dump.time == 1.25e-9


def test_what_is_no_dump_is_named(comm, tmp_path):
    import h5py

    path = tmp_path / "x.vtkhdf"
    with pytest.raises(InputError, match="No such file or directory"):
        Dump(path)
    path.write_text("plain text")
    with pytest.raises(InputError, match=r"x\.vtkhdf cannot be read: .*signature not found"):
        Dump(path)
    with h5py.File(path, "w") as h5:
        h5["beam"] = [1.0]
    with pytest.raises(InputError, match="no field dump"):
        Dump(path)
    path.unlink()
    write(comm, path)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(InputError, match="truncated"):
        Dump(path)


@pytest.mark.mpi(ranks=(2,))
def test_a_lost_part_is_named(comm, tmp_path):
    path = vtkhdf_writer.path_of(tmp_path, 7)
    write(comm, path, writers=2)
    if comm.rank == 0:
        part_of(path, 1).unlink()
    comm.barrier()
    with pytest.raises(InputError, match=r"its part fields_00000007\.part0001 is not beside it"):
        Dump(path)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_run_lists_the_times_of_its_dumps(comm, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    for step, time in ((0, 0.0), (20, 2.5e-9), (10, 1.25e-9)):
        comm.Barrier()
        vtkhdf_writer.path_of(tmp_path, step).touch()
        vtkhdf_writer.list_time(comm, tmp_path, Moment(step, time))
    comm.Barrier()
    vtkhdf_writer.path_of(tmp_path, 20).unlink(missing_ok=True)
    comm.Barrier()
    vtkhdf_writer.list_time(comm, tmp_path, Moment(10, 1.5e-9))  # again, after a restart
    if comm.rank == 0:
        reader = pyvista.get_reader(tmp_path / "fields.vtkhdf.series")  # as ParaView's reader of series
        assert reader.time_values == [0.0, 1.5e-9]
        assert list(vtkhdf_writer.listed_times(tmp_path / vtkhdf_writer.SERIES)) == [
            f"fields_{step:08d}.vtkhdf" for step in (0, 10)
        ]
    comm.Barrier()
    (tmp_path / vtkhdf_writer.SERIES).write_text("[]")
    comm.Barrier()
    vtkhdf_writer.list_time(comm, tmp_path, Moment(10, 1.5e-9))
    assert vtkhdf_writer.listed_times(tmp_path / vtkhdf_writer.SERIES) == {"fields_00000010.vtkhdf": 1.5e-9}


@pytest.mark.mpi(ranks=(1, 2))
def test_yt_shows_values_units_and_axes_of_a_dump(comm, tmp_path):
    yt = pytest.importorskip("yt")
    path = vtkhdf_writer.path_of(tmp_path, 7)
    hierarchy = write(comm, path, writers=0)  # one file, and one of two parts
    dataset = yt.load(str(path))
    assert float(dataset.current_time.to_value("s")) == 1.25e-9
    assert dataset.domain_left_edge.to_value("m") == pytest.approx(DOMAIN.lower, rel=1e-15)
    assert dataset.domain_right_edge.to_value("m") == pytest.approx(DOMAIN.upper, rel=1e-15)
    assert dataset.index.max_level == 2 and not any(dataset.periodicity)
    assert len(dataset.index.grids) == sum(len(hierarchy.boxes(level)) for level in range(3))
    data = dataset.all_data()
    centres = [data["index", axis].to_value("m") for axis in "xyz"]
    assert str(data["gdf", "phi"].units) == "V" and str(data["gdf", "Ez"].units) == "V/m"
    np.testing.assert_allclose(data["gdf", "phi"].to_value("V"), phi_at(*centres), rtol=1e-12)
    for axis, centre in zip("xyz", centres, strict=True):
        np.testing.assert_allclose(data["gdf", f"E{axis}"].to_value("V/m"), 1e6 * centre, rtol=1e-12, atol=1e-6)
    # What yt shows covers the domain once: cells under a finer level are left out.
    assert float(data["index", "cell_volume"].sum().to_value("m**3")) == pytest.approx(0.24 * 0.48 * 0.64, rel=1e-12)
    cut = dataset.slice("z", dataset.quan(0.303, "m"))  # between faces of cells of all levels
    assert np.abs(cut["index", "z"].to_value("m") - 0.303).max() <= 0.01  # half a base cell
    picture = cut.to_frb((0.24, "m"), 48, height=(0.48, "m"), center=dataset.domain_center)["gdf", "Ex"]
    assert picture.to_value("V/m")[:, ::2] == pytest.approx(
        np.tile(1e6 * (-0.15 + 0.01 * (np.arange(24) + 0.5)), (48, 1)),
        abs=2.6e3,  # a quarter of a base cell
    )
    along = dataset.proj(("gdf", "phi"), "x")  # the integral of φ along x
    y, z = (along[name].to_value("m") for name in ("px", "py"))
    assert str(along["gdf", "phi"].to("V*m").units) == "V*m"
    integral, areas = along["gdf", "phi"].to_value("V*m"), (4 * along["pdx"] * along["pdy"]).to_value("m**2")
    # Where some of the cells on the way are coarse, their centres lie up to a quarter of a base cell beside the line.
    np.testing.assert_allclose(integral, 0.24 * phi_at(-0.03, y, z), atol=0.24 * 0.02)
    assert (integral * areas).sum() == pytest.approx(0.24 * 0.48 * 0.64 * phi_at(-0.03, -0.06, 0.42), rel=1e-12)


def test_the_view_takes_no_room_for_values(comm, tmp_path, monkeypatch):
    from amrpic.io import yt_view

    with_view, without = tmp_path / "with.vtkhdf", tmp_path / "without.vtkhdf"
    hierarchy = write(comm, with_view)
    monkeypatch.setattr(yt_view, "LARGEST", 0)
    write(comm, without)
    boxes = sum(len(hierarchy.boxes(level)) for level in range(hierarchy.levels))
    assert with_view.stat().st_size - without.stat().st_size < 10_000 + 4_000 * boxes
    with Dump(without) as dump:
        assert "data" not in dump._h5
