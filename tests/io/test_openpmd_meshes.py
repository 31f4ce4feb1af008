"""What a run writes as openPMD, judged by its validator, its API, its viewer, and BeamPhysics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import whole_run
from amrpic.errors import InputError
from amrpic.io import openpmd_files, openpmd_meshes, openpmd_writer, vtkhdf_writer
from amrpic.io.provenance import Moment
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from linear_dump import ABOUT, DOMAIN, STEP, TIME, dumped, phi_at, write

COUNT = 60
RANDOM = np.random.default_rng(5)
PARTICLES = Particles(
    RANDOM.normal(0, 1e-3, (COUNT, 3)),
    RANDOM.normal(0, 1e-24, (COUNT, 3)),
    RANDOM.random(COUNT) + 1,
    np.arange(COUNT),
    SpeciesTable((SPECIES["electron"],)),
)


def written(comm, folder: Path, particles: bool = True) -> Path:
    """The view of a dump, in as many parts as there are ranks, and of particles. Collective."""
    fields, beam = vtkhdf_writer.path_of(folder, STEP), openpmd_writer.path_of(folder, STEP)
    write(comm, fields, writers=0)
    if particles:
        openpmd_writer.write(comm, beam, PARTICLES.select(slice(comm.rank, None, comm.size)), Moment(STEP, TIME), ABOUT)
    path = openpmd_meshes.path_of(folder, STEP)
    hierarchy, values = dumped(comm)
    openpmd_meshes.write(path, hierarchy, values, fields, beam if particles else None, Moment(STEP, TIME), ABOUT)
    return path


def errors_of(path: Path) -> int:
    """The errors that the validator of openPMD finds in a file."""
    validator = pytest.importorskip("openpmd_validator.check_h5")
    return int(validator.check_file(str(path))[0])


def check_mesh(values: np.ndarray, axes: list[np.ndarray], name: str, level: int) -> None:
    """Compare a mesh, on (z, y, x), with what was written: all cells of boxes, and nothing else."""
    z, y, x = np.meshgrid(*axes, indexing="ij")
    expected = phi_at(x, y, z) if name == "phi" else 1e6 * {"Ex": x, "Ey": y, "Ez": z}[name]
    there = np.isfinite(values)
    np.testing.assert_allclose(values[there], expected[there], rtol=1e-12, atol=1e-6)
    cells = {0: 24 * 16 * 32, 1: 32 * 16 * 24 + 8 * 8 * 16, 2: 16 * 8 * 24}[level]
    assert there.sum() == cells


@pytest.mark.mpi(ranks=(1, 2))
def test_the_viewer_shows_meshes_and_particles(comm, tmp_path):
    viewer = pytest.importorskip("openpmd_viewer")
    path = written(comm, tmp_path)
    for backend in ("h5py", "openpmd-api"):
        series = viewer.OpenPMDTimeSeries(str(path.parent), backend=backend, check_all_files=False)
        assert series.iterations.tolist() == [STEP] and series.t.tolist() == [TIME]
        assert sorted(series.avail_fields) == ["E", "E_lvl1", "E_lvl2", "phi", "phi_lvl1", "phi_lvl2"]
        for level in range(3):
            suffix = f"_lvl{level}" if level else ""
            for name, record, axis in (("phi", "phi", None), *((f"E{axis}", "E", axis) for axis in "xyz")):
                values, info = series.get_field(record + suffix, coord=axis, iteration=STEP)
                check_mesh(values, [info.z, info.y, info.x], name, level)
        x, weight = series.get_particle(["x", "w"], species="electron", iteration=STEP)
        np.testing.assert_array_equal(x, PARTICLES.position[:, 0])
        np.testing.assert_array_equal(weight, PARTICLES.weight)


def test_the_api_knows_units_axes_and_levels(comm, tmp_path):
    api = pytest.importorskip("openpmd_api")
    path = written(comm, tmp_path)
    series = api.Series(str(path.with_name("openpmd_%T.h5")), api.Access.read_only)
    assert list(series.iterations) == [STEP]
    iteration = series.iterations[STEP]
    assert (iteration.time, iteration.time_unit_SI) == (TIME, 1.0)
    for level in range(3):
        mesh = iteration.meshes["E" + (f"_lvl{level}" if level else "")]
        assert mesh.axis_labels == ["z", "y", "x"]
        assert mesh.grid_spacing == pytest.approx((DOMAIN.spacing / 2**level)[::-1].tolist(), rel=1e-14)
        assert mesh.unit_dimension == [1.0, 1.0, -3.0, -1.0, 0.0, 0.0, 0.0]  # V/m
        values = {axis: mesh[axis].load_chunk() for axis in "xyz"}
        series.flush()
        offset, shape = mesh.grid_global_offset, values["x"].shape
        axes = [o + h * (np.arange(n) + 0.5) for o, h, n in zip(offset, mesh.grid_spacing, shape, strict=True)]
        for axis in "xyz":
            assert mesh[axis].unit_SI == 1.0
            check_mesh(values[axis], axes, f"E{axis}", level)
    momentum = iteration.particles["electron"]["momentum"]["z"]
    pz = momentum.load_chunk()
    series.flush()
    np.testing.assert_array_equal(pz * momentum.unit_SI, PARTICLES.momentum[:, 2])


def test_beamphysics_finds_the_particles_through_the_view(comm, tmp_path):
    beamphysics = pytest.importorskip("beamphysics")
    group = beamphysics.ParticleGroup(str(written(comm, tmp_path)))
    np.testing.assert_array_equal(group.y, PARTICLES.position[:, 1])
    assert group.charge == pytest.approx(PARTICLES.weight.sum() * -SPECIES["electron"].charge, rel=1e-13)


def test_the_view_holds_no_values(comm, tmp_path):
    path = written(comm, tmp_path, particles=False)
    assert path.stat().st_size < 60_000 < vtkhdf_writer.path_of(tmp_path, STEP).stat().st_size
    vtkhdf_writer.path_of(tmp_path, STEP).unlink()
    with (
        pytest.raises(InputError, match=r"its part \.\./fields_00000007\.vtkhdf is not beside it"),
        openpmd_files.opened(path, "file", "write it anew"),
    ):
        pass


@pytest.mark.mpi(ranks=(1, 2))
def test_the_validator_accepts_all_that_a_run_writes(comm, tmp_path):
    whole_run.run(comm, tmp_path, write=["fields", "particles", "losses"])
    found = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.h5"))
    views = [f"openpmd/openpmd_{step:08d}.h5" for step in (0, 2, 4)]
    assert found == ["losses.h5", *views, "particles_00000000.h5", "particles_00000004.h5", "screen_end.h5"]
    for name in found:
        assert errors_of(tmp_path / name) == 0, name
