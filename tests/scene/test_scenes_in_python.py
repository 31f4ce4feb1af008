"""Scenes made of classes: the same as from TOML, with the same sentences about mistakes."""

from __future__ import annotations

import pytest

import amrpic

IN_TOML = {
    "name": "one",
    "domain": {"lower": -0.1, "upper": 0.1, "cells": [16, 16, 32], "boundary": {"x": "dirichlet"}},
    "bunches": [
        {"distribution": "gaussian", "species": "electron", "sigma": "1 mm", "charge": "-1 pC", "particles": 10}
    ],
    "elements": [{"kind": "quadrupole", "centre": [0, 0, 0.05], "length": 0.02, "gradient": "12 T/m"}],
    "apertures": [{"kind": "round", "name": "hole", "centre": [0, 0, 0.02], "length": 0.01, "radius": 0.01}],
    "refinement": {"levels": 2, "rule": {"kind": "any", "of": [{"kind": "potential", "relative": 0.5}]}},
    "motion": {"kind": "leapfrog", "dt": "1 ps"},
}


def in_python() -> amrpic.Scene:
    return amrpic.Scene(
        name="one",
        domain=amrpic.Domain(-0.1, 0.1, (16, 16, 32), boundary={"x": "dirichlet"}),
        bunches=[amrpic.GaussianBunch(species=amrpic.Species("electron"), sigma="1 mm", charge="-1 pC", particles=10)],
        elements=[amrpic.QuadrupoleElement(centre=(0, 0, 0.05), length=0.02, gradient="12 T/m")],
        apertures=[amrpic.RoundAperture(name="hole", centre=(0, 0, 0.02), length=0.01, radius=0.01)],
        refinement=amrpic.Refinement(levels=2, rule=amrpic.AnyRule(of=[amrpic.PotentialRule(relative=0.5)])),
        motion=amrpic.Leapfrog(dt="1 ps"),
    )


def test_a_scene_of_classes_is_that_of_toml():
    assert in_python() == amrpic.Scene.from_dict(IN_TOML)


def test_a_key_that_chooses_a_class_is_still_needed_in_a_file():
    with pytest.raises(amrpic.SceneError, match=r"scene: bunches.0 has no distribution; add distribution"):
        amrpic.Scene.from_dict({**IN_TOML, "bunches": [{"sigma": 1.0}]})


@pytest.mark.parametrize(
    ("mistake", "sentence"),
    [
        (lambda: amrpic.GaussianBunch(sigma=-1.0, charge=1.0, particles=3), r"GaussianBunch: sigma.* \(-1.0\) is"),
        (lambda: amrpic.Leapfrog(dt="1 V"), "Leapfrog: dt"),
        (
            lambda: amrpic.Leapfrog(step="1 ps"),
            r'Leapfrog: step \(.1 ps.\) is an unknown key; did you mean "form"|use one of',
        ),
        (lambda: amrpic.Scene(domain={"lower": -1, "upper": 1, "cells": 1}), "Scene: domain"),
        (lambda: in_python().replace(seed=-4), r"Scene: seed \(-4\) is"),
        (lambda: in_python().replace(domain=amrpic.Domain(0.2, 0.3, 8)), "Scene: bunches.0.centre"),
    ],
)
def test_a_mistake_is_one_sentence(mistake, sentence):
    with pytest.raises(amrpic.SceneError, match=sentence) as refused:
        mistake()
    assert "\n" not in str(refused.value)


def test_replace_keeps_the_rest():
    scene = in_python()
    other = scene.replace(refinement=scene.refinement.replace(levels=1), seed=7)
    assert (other.seed, other.refinement.levels, other.refinement.rule) == (7, 1, scene.refinement.rule)
    assert other.replace(seed=scene.seed, refinement=scene.refinement) == scene


def test_species_are_known_by_name_or_given():
    electron = amrpic.Species("electron")
    assert electron == amrpic.Species(name="electron", charge=electron.charge, mass=electron.mass)
    with pytest.raises(
        amrpic.ParticleError, match='species "muon" has neither charge nor mass; give both, or one of the names'
    ):
        amrpic.Species("muon")
    with pytest.raises(amrpic.ParticleError, match="the mass of a species is nan kg; give a positive number"):
        amrpic.Species("muon", charge=1.0)
