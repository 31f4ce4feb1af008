"""The scene model: one meaning in TOML and Python, units, overrides, defaults, and mistakes reported in one sentence."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from pydantic_core import PydanticCustomError

from amrpic.commands.methods import scene_from
from amrpic.errors import HierarchyError, InputError, SceneError
from amrpic.mesh.domain import Domain
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.pic.limits import check_scene, memory_error, rank_cells_error
from amrpic.pic.memory import base_boxes
from amrpic.scene.any_scene import read_data
from amrpic.scene.complaints import RefusedScene
from amrpic.scene.scene import Scene
from amrpic.scene.units import to_si
from amrpic.units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT, UNITS

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.toml"))

TWISS = {
    "x": {"emittance": "1 um rad", "beta": "2 m"},
    "y": {"emittance": "1 um rad", "sigma": "1 mm"},
    "z": {"emittance": 0, "sigma": "1 mm"},
}
BUNCH = {"distribution": "gaussian", "sigma": "2.5 mm", "charge": "10 pC", "particles": 1000}


def scene(**changes: Any) -> Scene:
    """A small scene, with sections replaced."""
    data: dict[str, Any] = {"domain": {"lower": -0.1, "upper": 0.1, "cells": 32}, "bunches": [BUNCH]}
    return Scene.from_dict({**data, **changes})


def first_bunch(given: Scene) -> Any:
    return given.bunches[0]


def refusal(**changes: Any) -> str:
    with pytest.raises(SceneError) as refused:
        scene(**changes)
    message = str(refused.value)
    assert "\n" not in message and "; " in message
    return message


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_resolved_scene_reads_back_equal(path):
    given = scene_from(read_data(path), path)
    assert given.name == path.stem
    assert type(given).from_dict(given.to_dict()) == given
    assert type(given).from_dict(tomllib.loads(given.to_toml())) == given


def test_ten_bunches_lie_where_the_scene_says():
    places = np.array(Scene.from_toml(EXAMPLES[0].with_name("ten_bunches.toml")).bunches[0].places())
    b = np.arange(10) - 4.5
    assert places == pytest.approx(0.02828 * b[:, None] * [1, 1, 0], abs=1e-15)


def test_toml_and_python_are_the_same(tmp_path):
    file = tmp_path / "small.toml"
    file.write_text(
        '[domain]\nlower = "-10 cm"\nupper = 0.1\ncells = [32, 32, 32]\n'
        '[[bunches]]\ndistribution = "gaussian"\nsigma = 2.5e-3\ncharge = 1e-11\nparticles = 1000\n'
    )
    assert Scene.from_toml(file) == scene(name="small")


@pytest.mark.parametrize(
    "text, kind, value",
    [
        ("2.5 mm", "length", 2.5e-3),
        ("28.28mm", "length", 0.02828),
        ("1e2 um", "length", 1e-4),
        ("-100 pC", "charge", -1e-10),
        ("0.9 MeV", "energy", 0.9e6 * ELEMENTARY_CHARGE),
        ("1 MeV/c", "momentum", 1e6 * ELEMENTARY_CHARGE / SPEED_OF_LIGHT),
        ("0.5 c", "velocity", SPEED_OF_LIGHT / 2),
        ("20 ps", "time", 2e-11),
        (3, "length", 3.0),
    ],
)
def test_units(text, kind, value):
    assert to_si(text, kind) == pytest.approx(value, rel=1e-15)


def test_wrong_unit_lists_the_allowed_ones():
    message = refusal(bunches=[{**BUNCH, "sigma": "2.5 pC"}])
    assert "bunches.0.sigma" in message and "pC" in message
    assert all(unit in message for unit in UNITS["length"])


def test_one_value_stands_for_all_axes():
    given = scene()
    assert given.domain.cells == (32, 32, 32)
    assert first_bunch(given).sigma == (2.5e-3, 2.5e-3, 2.5e-3)


def test_boundary_per_axis_and_face():
    boundary = {"x": "periodic", "y": ("dirichlet", "neumann"), "z": "dirichlet"}
    given = scene(domain={"lower": -0.1, "upper": 0.1, "cells": 32, "boundary": boundary})
    expected = (("periodic", "periodic"), ("dirichlet", "neumann"), ("dirichlet", "dirichlet"))
    assert given.domain.value.boundary == expected


def test_overrides_reach_into_sections_and_lists():
    overrides = ["solver.tolerance=1e-8", "bunches.0.sigma=3 mm", "schedule.solves=2", "domain.cells=[48,48,48]"]
    given = Scene.from_toml(EXAMPLES[0].with_name("three_bunches.toml"), overrides)
    assert given.solver.tolerance == 1e-8
    assert first_bunch(given).sigma == (3e-3, 3e-3, 3e-3)
    assert given.schedule.last_step == 1
    assert given.domain.cells == (48, 48, 48)


@pytest.mark.parametrize("assignment", ["nonsense", "bunches.7.sigma=1", "bunches.x.sigma=1", "background.a.b=1"])
def test_bad_override_names_itself(assignment):
    with pytest.raises(SceneError, match="--set"):
        Scene.from_toml(EXAMPLES[0].with_name("periodic.toml"), [assignment])


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"solvr": {}}, ["solvr", 'did you mean "solver"']),
        ({"refinement": {"levles": 2}}, ["refinement.levles", 'did you mean "levels"']),
        ({"refinement": {"max_grid_size": 20}}, ["refinement.max_grid_size", "20", "16 or 24"]),
        ({"refinement": {"blocking_factor": 12, "max_grid_size": 24}}, ["blocking_factor", "12", "8 or 16"]),
        ({"refinement": {"rule": {"kind": "charge-density"}}}, ["refinement.rule.relative", "absolute"]),
        ({"domain": {"lower": -0.1, "upper": 0.1, "cells": 1}}, ["domain.cells", "is 1", "at least 2"]),
        ({"domain": {"lower": 0.1, "upper": -0.1, "cells": 32}}, ["domain", "upper end"]),
        ({"domain": {"lower": 0, "upper": 0, "cells": 32}}, ["domain", "upper end"]),
        ({"domain": {"lower": float("nan"), "upper": 1, "cells": 32}}, ["domain.lower", "finite"]),
        ({"domain": {"lower": 0, "upper": 1, "cells": 2**22}}, ["domain.cells", str(2**66), "64-bit"]),
        ({"domain": {"lower": -1, "upper": 1, "cells": 2**31}}, ["domain.cells.0", "32 bits"]),
        ({"domain": {"lower": -1, "upper": 1, "cells": 32, "boundary": "opne"}}, ["boundary.x", 'did you mean "open"']),
        (
            {"refinement": {"levels": 1, "rule": {"kind": "static", "boxes": [{"level": 1, "first": 8, "last": 64}]}}},
            ["refinement.rule.boxes.0", "leaves the domain", "63 along x"],
        ),
        ({"bunches": [{**BUNCH, "centre": [1, 0, 0]}]}, ["bunches.0.centre", "outside the domain", "x = 1"]),
        ({"bunches": [{**BUNCH, "sigma": -1e-3}]}, ["bunches.0.sigma.0", "negative"]),
        ({"bunches": [{**BUNCH, "charge": 0}]}, ["bunches.0.charge", "zero"]),
        ({"bunches": [{**BUNCH, "charge": None}]}, ["bunches.0.charge", "missing"]),
        ({"bunches": [{**BUNCH, "species": "elektron"}]}, ["species", 'did you mean "electron"']),
        ({"bunches": [{**BUNCH, "species": "electron"}]}, ["bunches.0.charge", "sign"]),
        ({"bunches": [{**BUNCH, "count": 3}]}, ["bunches.0.spacing", "missing"]),
        ({"bunches": [{**BUNCH, "distribution": "gauss"}]}, ["distribution", 'did you mean "gaussian"']),
        ({"bunches": [{**BUNCH, "sigma": None}]}, ["bunches.0.sigma", "missing", "twiss"]),
        (
            {"bunches": [{**BUNCH, "sampling": "sobol", "particles": 2**33}]},
            ["bunches.0.particles", str(2**32), "halton"],
        ),
        ({"bunches": [{**BUNCH, "sampling": "sobel"}]}, ["bunches.0.sampling", 'did you mean "sobol"']),
        ({"bunches": [{**BUNCH, "twiss": TWISS}]}, ["bunches.0.sigma", "as well as twiss"]),
        ({"bunches": [{**BUNCH, "sigma": None, "twiss": TWISS}]}, ["twiss.x.beta", "needs a mean momentum"]),
        ({"bunches": [{**BUNCH, "velocity": [0, 0, "2 c"]}]}, ["bunches.0.velocity", "is 2 c", "below c"]),
        ({"name": "../elsewhere"}, ["name", "is a path", "plain name"]),
        (
            {"bunches": [{**BUNCH, "sigma": None, "twiss": TWISS, "velocity": 1, "momentum_spread": 1}]},
            ["bunches.0.momentum_spread", "as well as twiss"],
        ),
        (
            {"bunches": [{**BUNCH, "sigma": None, "twiss": {**TWISS, "y": {"emittance": 1e-6}}}]},
            ["twiss.y.beta is missing, as is sigma"],
        ),
        ({"bunches": [{**BUNCH, "distribution": "hollow", "inner": 1}]}, ["bunches.0.inner", "less than 1"]),
        ({"bunches": [{"distribution": "openpmd"}]}, ["bunches.0.file", "missing"]),
        ({"motion": {"kind": "leapfrog"}}, ["motion.dt", "missing"]),
        ({"schedule": {"steps": 3, "solves": 3}}, ["schedule.solves", "keep one"]),
        ({"solver": {"tolerance": 0}}, ["solver.tolerance", "between 0 and 1"]),
        ({"background": "neutralizing"}, ["background", "periodic or neumann"]),
        ({"domain": {"lower": -1, "upper": 1, "cells": 32, "boundary": "periodic"}}, ["1e-11 C", "neutralizing"]),
    ],
)
def test_mistake_is_reported_in_one_sentence(changes, words):
    message = refusal(**changes)
    for word in words:
        assert word in message


def test_all_mistakes_are_kept():
    with pytest.raises(RefusedScene) as refused:
        scene(solver={"tolerance": 0, "max_cycles": 0})
    assert len(refused.value.problems) == 2
    assert "and 1 more" in str(refused.value)


def test_legal_oddities_get_one_remark_each():
    assert len(scene(bunches=[]).remarks()) == 1
    assert len(scene(bunches=[{**BUNCH, "particles": 0}]).remarks()) == 1
    assert len(scene(bunches=[{**BUNCH, "sigma": 0}, {**BUNCH, "sigma": [0, 1e-3, 1e-3]}]).remarks()) == 1
    assert scene().remarks() == []


def test_arrays_stay_out_of_the_resolved_scene(tmp_path):
    arrays = {"distribution": "arrays", "position": np.zeros((5, 3)), "weight": np.ones(5)}
    given = scene(bunches=[arrays])
    back = Scene.from_dict(given.to_dict())
    assert back == given
    assert given.particle_count() == 5
    with pytest.raises(InputError, match="5 particles"):
        first_bunch(back).arrays()


def test_particles_are_read_from_a_file_beside_the_scene(tmp_path):
    np.savez(tmp_path / "beam.npz", position=np.ones((4, 3)) * 0.01, weight=np.full(4, 2.0))
    (tmp_path / "s.toml").write_text(
        '[domain]\nlower=-1\nupper=1\ncells=32\n[[bunches]]\ndistribution="arrays"\nfile="beam.npz"\n'
    )
    arrays = first_bunch(Scene.from_toml(tmp_path / "s.toml")).arrays()
    assert arrays["position"].shape == (4, 3) and arrays["momenta"] is None
    np.savez(tmp_path / "beam.npz", position=np.full((4, 3), np.nan), weight=np.ones(4))
    with pytest.raises(InputError, match=r"4 particles.*NaN"):
        first_bunch(Scene.from_toml(tmp_path / "s.toml")).arrays()
    np.savez(tmp_path / "beam.npz", position=np.ones((4, 3)) * 0.01, weight=np.array([1.0, 0.0, -2.0, 3.0]))
    with pytest.raises(InputError, match=r"weight of 1 particles in .* is negative"):
        first_bunch(Scene.from_toml(tmp_path / "s.toml")).arrays()


def test_memory_and_index_limits_state_both_numbers():
    small, large = (scene(domain={"lower": -1, "upper": 1, "cells": n}) for n in (96, 1024))
    message = memory_error(large, base_boxes(large), 10**6, 1, available=8 * 2**30)
    assert message is not None and "8 GiB are free" in message and "GiB of memory" in message
    assert memory_error(small, base_boxes(small), 10**6, 1, available=8 * 2**30) is None
    message = rank_cells_error(2**33, 2)
    assert message is not None and str(2**31 - 1) in message and "at least 5 ranks" in message
    with pytest.raises(SceneError, match="32 bits"):
        check_scene(scene(domain={"lower": -1, "upper": 1, "cells": 2**13}), ranks=1, available=10**18)


def test_missing_particle_file_is_reported_by_the_check():
    with pytest.raises(SceneError, match=r"bunches\.1\.file \(nowhere\.h5\) does not exist"):
        check_scene(scene(bunches=[BUNCH, {"distribution": "openpmd", "file": "nowhere.h5"}]), ranks=1)


@pytest.mark.parametrize(
    "cells, block, most", [(32, 8, 18), (100, 8, 16), ([2, 2, 200], 8, 15), (16, 2, 17), (8, 32, 20)]
)
def test_a_scene_has_the_levels_that_the_mesh_takes(cells, block, most):
    """As many as a hierarchy of one block on each level, in the corner of the domain."""
    domain = {"lower": -1, "upper": 1, "cells": cells, "boundary": "dirichlet"}

    def levels(number: int) -> dict[str, Any]:
        return {"levels": number, "blocking_factor": block, "max_grid_size": block}

    assert scene(domain=domain, refinement=levels(most)).refinement.levels == most
    corner = np.broadcast_to(cells, 3)[None] << np.arange(1, most + 2)[:, None]
    boxes = [[((0, 0, 0), tuple((np.minimum(2 * block, last) - 1).tolist()))] for last in corner]
    if most < 20:
        text = refusal(domain=domain, refinement=levels(most + 1))
        assert f"refinement.levels ({most + 1}) makes more than 2^20 blocks of {block} cells" in text
        assert f"use {most} levels at most" in text
        with pytest.raises(HierarchyError, match=f"level {most + 1} would have more than 2"):
            Hierarchy(MPI.COMM_SELF, Domain(-1, 1, cells, "dirichlet"), boxes, 4 * block, block)
    made = Hierarchy(MPI.COMM_SELF, Domain(-1, 1, cells, "dirichlet"), boxes[:most], 4 * block, block)
    assert made.levels == most + 1


def test_cells_below_the_rounding_of_their_places_are_refused():
    domain = {"lower": 1, "upper": 1 + 1e-8, "cells": 32}  # cells of 3.1e-10 m, and of 1.2e-15 m on level 18
    text = refusal(domain=domain, refinement={"levels": 18}, bunches=[])
    assert "refinement.levels (18)" in text and "too fine for places of 64 bits" in text
    assert scene(domain=domain, refinement={"levels": 1}, bunches=[]).refinement.levels == 1


def test_kinds_of_quantities_have_their_article():
    for kind in UNITS:
        with pytest.raises(PydanticCustomError) as refused:
            to_si("much", kind)
        assert f"is not a{'n' if kind[0] in 'aeiou' else ''} {kind} with a unit" in str(refused.value)
    twiss = {axis: {"emittance": "much", "sigma": "1 mm"} for axis in "xyz"}
    text = refusal(bunches=[{"distribution": "gaussian", "twiss": twiss, "charge": "1 pC", "particles": 1}])
    assert "is not an emittance with a unit" in text


def test_test_particles_need_no_charge():
    plain = {key: value for key, value in BUNCH.items() if key != "charge"}
    assert "charge ('nothing') is missing" in refusal(bunches=[plain])
    assert not scene(bunches=[{**plain, "self_field": False}]).remarks()
    given = scene(bunches=[{**BUNCH, "self_field": False}])
    assert given.bunches[0].bunch_charge == 0
    assert given.remarks() == ["bunches.0 makes no field (self_field = false), and its charge counts as 0"]
