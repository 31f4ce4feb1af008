"""Field dumps, judged by VTK's own reader."""

from __future__ import annotations

import json

import numpy as np
import pytest

from amrpic import Domain, Field, Hierarchy, VectorField
from amrpic.errors import InputError, OutputError
from amrpic.io import vtkhdf_writer, writer_ranks
from amrpic.io.field_reader import Dump
from amrpic.io.provenance import Provenance
from amrpic.io.shared_file import part_of
from amrpic.io.writer_ranks import Writers
from full_disk import file_size_limit

DOMAIN = Domain(lower=(-0.15, -0.3, 0.1), upper=(0.09, 0.18, 0.74), cells=(24, 16, 32), boundary="dirichlet")
LEVELS = [[((8, 8, 8), (39, 23, 31)), ((8, 8, 40), (15, 15, 55))], [((24, 24, 24), (39, 31, 47))]]
ABOUT = Provenance({"name": "test", "unit": "µm"}, "0.1.0", 42)


def phi_at(x, y, z):
    return 3 * x - 2 * y + 0.5 * z + 1


def dumped(comm):
    """A hierarchy of three levels with φ linear in space and E = 10⁶ (x, y, z)."""
    hierarchy = Hierarchy(comm, DOMAIN, LEVELS, max_grid_size=16, blocking_factor=8)
    phi = Field(hierarchy, unit="V").fill(phi_at)
    x = Field(hierarchy, unit="V/m").fill(lambda x, y, z: 1e6 * x)
    y = Field(hierarchy, unit="V/m").fill(lambda x, y, z: 1e6 * y)
    z = Field(hierarchy, unit="V/m").fill(lambda x, y, z: 1e6 * z)
    return hierarchy, {"phi": phi, "E": VectorField(x, y, z)}


def write(comm, path, writers=1):
    hierarchy, values = dumped(comm)
    vtkhdf_writer.write(path, hierarchy, values, 7, 1.25e-9, ABOUT, Writers(writers))
    return hierarchy


def vtk_read(path):
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.SetMaximumLevelsToReadByDefaultForAMR(0)  # all
    reader.Update()
    return reader.GetOutput()


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
        vtkhdf_writer.write(vtkhdf_writer.path_of(missing, 7), hierarchy, values, 7, 0.0, ABOUT, Writers(writers))
    assert len(set(comm.allgather(str(caught.value)))) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.mpi(ranks=(2,))
@pytest.mark.parametrize("writers", [1, 2])
def test_a_disk_that_fills_up_keeps_the_old_dump(comm, tmp_path, writers):
    path = vtkhdf_writer.path_of(tmp_path, 7)
    write(comm, path, writers)
    before = sorted(p.name for p in tmp_path.iterdir())
    comm.barrier()  # before the other rank writes again
    hierarchy, values = dumped(comm)
    full = file_size_limit(20_000 if comm.rank == 0 else None)
    with full, pytest.raises(OutputError, match=r"cannot write fields .*: File too large; .*folder"):
        vtkhdf_writer.write(path, hierarchy, values, 7, 0.0, ABOUT, Writers(writers))
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
