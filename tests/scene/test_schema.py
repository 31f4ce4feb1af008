"""The JSON schema of scenes accepts and refuses what scenes do, and the reference names every key."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from amrpic.commands import main
from amrpic.commands.methods import scene_from
from amrpic.errors import OutputError, SceneError
from amrpic.scene.any_scene import read_data
from amrpic.scene.json_schema import scene_reference, scene_schema
from amrpic.scene.scene import Scene

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.toml"))
VALIDATOR = jsonschema.Draft202012Validator(scene_schema())


def scene(text: str) -> dict[str, Any]:
    """A scene from lines of TOML, in the smallest domain unless they give one."""
    domain = "" if "[domain]" in text else "[domain]\nlower = -0.1\nupper = 0.1\ncells = 32\n"
    return tomllib.loads(text + "\n" + domain)


def accepted(data: dict[str, Any]) -> bool:
    try:
        Scene.from_dict(data)
    except SceneError:
        return False
    return True


GAUSSIAN = '[[bunches]]\ndistribution = "gaussian"\nsigma = "2 mm"\ncharge = "1 pC"\nparticles = 10\n'

RIGHT = [
    "",
    '[domain]\nlower = "-10 cm"\nupper = ["1 m", 2, ".5e3 mm"]\ncells = [8, 16, 8]\nboundary = "dirichlet"',
    '[domain]\nlower = 0\nupper = 1\ncells = 8\nboundary = { x = "periodic", y = ["dirichlet", "neumann"], z = "neumann" }',
    GAUSSIAN,
    GAUSSIAN.replace("10\n", "1e6\n").replace('"1 pC"', '"-1 pC"') + 'species = "H-"',
    GAUSSIAN
    + 'species = { charge = "1 e", mass = "2 GeV/c^2" }\nmomentum = [0, 0, "1 MeV/c"]\ncount = 2\nspacing = "3 cm"',
    GAUSSIAN.replace("gaussian", "sphere").replace("sigma", "radius"),
    '[refinement]\nlevels = 1\nrule = { kind = "charge-density", absolute = "2 nC/mm^3" }',
    '[refinement]\nlevels = 1\nrule = { kind = "any", of = [{ kind = "momentum", absolute = "1 MeV/c" }] }',
    '[[refinement.rule.boxes]]\nlevel = 1\nlower = "-1 cm"\nupper = "1 cm"\n[refinement]\nlevels = 1\nrule.kind = "static"',
    '[motion]\nkind = "leapfrog"\ndt = "2 ps"\n[schedule]\nsteps = 3\n[output]\nwrite = ["series"]',
    '[solver]\ntolerance = 1e-8\nnorm = "l2"\nstretch = [1, 1, 30]',
    "[solver]\nsweeps = 3",
    '[solver]\ntolerance = "discretization"',
    "[solver]\nsweeps = [1, 2]",
]

WRONG = [
    'nme = "unknown key"',
    "[refinement]\nlevel = 2",
    "[refinement]\nlevels = -1",
    '[refinement]\nlevels = "2"',
    "[refinement]\nlevels = true",
    "[refinement]\nlevels = 1.5",
    "[refinement]\nrule = { relative = 1e-3 }",
    '[refinement]\nrule = { kind = "charge", relative = 1e-3 }',
    '[refinement]\nrule = { kind = "charge-density", relative = -1e-3 }',
    '[refinement]\nrule = { kind = "static", boxes = [] }',
    '[refinement]\nrule = { kind = "any", of = [{ kind = "potential", absolute = "1 C" }] }',
    '[solver]\nnorm = "l3"',
    "[solver]\ntolerance = 0",
    '[solver]\ntolerance = "1e-8"',
    '[solver]\ntolerance = "discretisation"',
    "[solver]\ntolerance = 2",
    "[solver]\nstretch = [1, 2]",
    '[solver]\nsweeps = "2"',
    "[domain]\nlower = 0\ncells = 8",
    '[domain]\nlower = 0\nupper = "1 furlong"\ncells = 8',
    '[domain]\nlower = 0\nupper = "1"\ncells = 8',
    "[domain]\nlower = [0, 0]\nupper = 1\ncells = 8",
    '[domain]\nlower = 0\nupper = 1\ncells = "8"',
    '[domain]\nlower = 0\nupper = 1\ncells = 8\nboundary = "closed"',
    '[domain]\nlower = 0\nupper = 1\ncells = 8\nboundary = { w = "open" }',
    '[domain]\nlower = 0\nupper = 1\ncells = 8\nboundary = { x = ["open"] }',
    "[domain]\nlower = 0\nupper = 1\ncells = 8\nboundary = { x = true }",
    GAUSSIAN.replace("2 mm", "2 pC"),
    GAUSSIAN.replace("gaussian", "gausian"),
    GAUSSIAN.replace('sigma = "2 mm"', ""),
    GAUSSIAN + "radius = 1",
    GAUSSIAN + 'species = "elektron"',
    GAUSSIAN + "name = 3",
    '[motion]\nkind = "leapfrog"',
    '[motion]\nkind = "leapfrog"\ndt = 0',
    "[motion]",
    '[output]\nwrite = ["everything"]',
    'bunches = { distribution = "gaussian" }',
]


def test_the_schema_is_one_of_its_dialect():
    VALIDATOR.check_schema(VALIDATOR.schema)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_pass_as_written_and_as_resolved(path):
    given = scene_from(read_data(path), path)
    validator = VALIDATOR if isinstance(given, Scene) else jsonschema.Draft202012Validator(scene_schema(type(given)))
    validator.validate(tomllib.loads(path.read_text()))
    validator.validate(tomllib.loads(given.to_toml()))


@pytest.mark.parametrize("text", RIGHT)
def test_what_a_scene_accepts_the_schema_accepts(text):
    assert accepted(scene(text))
    VALIDATOR.validate(scene(text))


@pytest.mark.parametrize("text", WRONG)
def test_what_is_wrong_in_form_both_refuse(text):
    assert not accepted(scene(text))
    assert not VALIDATOR.is_valid(scene(text))


def test_every_key_says_what_it_means_and_is_in_the_reference():
    schema, reference = scene_schema(), scene_reference()
    parts = [schema, *schema["$defs"].values()]
    sections = [one for part in parts for one in part.get("anyOf", [part]) if "properties" in one]
    assert len(sections) > 12
    for section in sections:
        assert section["description"]
        for key, part in section["properties"].items():
            assert f"`{key}`" in reference or "const" in part
            assert "const" in part or "$ref" in part or part.get("description") or "discriminator" in part, key


def test_the_command_writes_into_a_file_or_says_why_not(tmp_path, capsys):
    chosen = main.parser().parse_args(["schema"])
    assert chosen.command(chosen) == 0
    printed = capsys.readouterr().out
    chosen.output = tmp_path / "scene.schema.json"
    assert chosen.command(chosen) == 0
    assert chosen.output.read_text() == printed
    chosen.output = tmp_path / "nowhere" / "x"
    with pytest.raises(OutputError, match=r"cannot write .*: No such file or directory; choose another"):
        chosen.command(chosen)
