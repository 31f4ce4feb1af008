"""Refinement at conductors: the cells that plain NumPy asks for, alone and with other rules, on any number of ranks."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI
from scipy.constants import epsilon_0

import amrpic
from amrpic import shapes
from amrpic.conductors.edges import edge_cells
from amrpic.conductors.refined import beside_edges, beside_surfaces
from amrpic.errors import HierarchyError, InputError, SceneError
from amrpic.mesh.field import Field
from amrpic.pic.adapt import follow, make_base
from amrpic.pic.frames import first_frames
from amrpic.pic.initial_particles import make_particles
from amrpic.pic.meshed import MeshedParticles
from amrpic.pic.rule_quantities import Quantities
from amrpic.pic.setup import set_up
from amrpic.space_charge.drive import Drive
from amrpic.space_charge.tagging_rules import tags_of
from amrpic.stages.migrate import migrate
from particle_cases import dense
from regions import coarser, mask, same_region

N, H = 16, 2 / 16
BALL = ((-0.41, 0.03, 0.02), 0.3)
BOX = ((0.21, -0.52, -0.33), (0.63, 0.47, 0.41))
FOIL = ((0.0, 0.0, -0.71), 0.5)
BODIES = [
    amrpic.Electrode("ball", shapes.Sphere(*BALL), voltage=1),
    amrpic.Electrode("box", shapes.Box(*BOX), voltage=2),
    amrpic.Electrode("foil", shapes.Disk(FOIL[0], (0, 0, 1), FOIL[1]), voltage=3),
]


# ---- what NumPy asks for ----


def ball_meets(start, end):
    way = end - start
    share = np.clip(((BALL[0] - start) * way).sum(axis=-1) / (way**2).sum(axis=-1), 0, 1)
    return np.linalg.norm(start + share[..., None] * way - BALL[0], axis=-1) <= BALL[1]


def box_meets(start, end):
    """Along an axis."""
    return np.all((np.minimum(start, end) <= BOX[1]) & (np.maximum(start, end) >= BOX[0]), axis=-1)


def foil_meets(start, end):
    below, above = start[..., 2] - FOIL[0][2], end[..., 2] - FOIL[0][2]
    return (below * above <= 0) & (np.linalg.norm((start - FOIL[0])[..., :2], axis=-1) <= FOIL[1])


MEETS = {"ball": ball_meets, "box": box_meets, "foil": foil_meets}


def cut(names, cells):
    """Which of `cells`³ cells between -1 and 1 lie outside these bodies and see one before a neighbour."""
    axis = -1 + 2 / cells * (np.arange(cells) + 0.5)
    centre = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    out, solid = np.zeros((cells,) * 3, bool), np.zeros((cells,) * 3, bool)
    for name in names:
        solid |= MEETS[name](centre, centre + 1e-12 * np.array([0.0, 0.0, 1.0]))
        for side in 2 / cells * np.concatenate([np.eye(3), -np.eye(3)]):
            out |= MEETS[name](centre, centre + side)
    return out & ~solid


@pytest.mark.parametrize("name", MEETS)
def test_cells_at_a_surface_are_those_that_see_metal_before_a_neighbour(name):
    bodies = [body for body in BODIES if body.name == name]
    boxes = [[i, j, k, i + 7, j + 7, k + 7] for k in (0, 8) for j in (0, 8) for i in (0, 8)]
    tags = beside_surfaces(bodies, boxes, -1.0, H)
    found = np.zeros((N,) * 3, bool)
    for (i, j, k, *_), part in zip(boxes, np.split(tags, 8), strict=True):
        found[i : i + 8, j : j + 8, k : k + 8] = part.reshape(8, 8, 8).transpose()
    assert np.array_equal(found, cut([name], N))


def test_balls_and_wires_between_the_centres_of_cells_are_not_missed():
    speck = amrpic.Electrode("speck", shapes.Sphere((0.1, 0.1, 0.1), 0.01), voltage=1)
    wire = amrpic.Electrode("wire", shapes.Cylinder((-0.3, 0.1, 0.1), (0.3, 0.1, 0.1), 0.01), voltage=1)
    whole = [[0, 0, 0, N - 1, N - 1, N - 1]]
    for mark in beside_surfaces, beside_edges:
        assert np.argwhere(mark([speck], whole, -1.0, H).reshape(N, N, N).T).tolist() == [[8, 8, 8]]
        assert mark([wire], whole, -1.0, H).reshape(N, N, N).T[5:11, 8, 8].all()
    assert beside_surfaces([wire], whole, -1.0, H).sum() == 6


# ---- rules of scenes ----


def scene(rule, **refinement):
    sizes = {"levels": 2, "blocking_factor": 4, "max_grid_size": 8, "efficiency": 1.0, "buffer": 0, **refinement}
    shapes_of = {
        "ball": {"kind": "sphere", "centre": BALL[0], "radius": BALL[1]},
        "box": {"kind": "box", "lower": BOX[0], "upper": BOX[1]},
        "foil": {"kind": "disk", "centre": FOIL[0], "normal": [0, 0, 1], "radius": FOIL[1]},
    }
    electrodes = [{"name": name, "shape": shape, "voltage": 1} for name, shape in shapes_of.items()]
    bunch = {"distribution": "gaussian", "centre": [0, 0, 0.7], "sigma": 0.05, "charge": 1e-12, "particles": 2000}
    return amrpic.Scene.from_dict(
        {
            "domain": {"lower": -1, "upper": 1, "cells": N, "boundary": "dirichlet"},
            "bunches": [bunch],
            "electrodes": electrodes,
            "refinement": {"rule": rule, **sizes},
            "output": {"write": []},
        }
    )


def meshes(comm, given):
    """What rules see on the base, and on the mesh that they lead to."""
    setup = set_up(comm, given)
    base = make_base(setup.comm, given)
    particles, _ = migrate(make_particles(comm, given), base)
    beam = MeshedParticles(particles, base, first_frames(particles, setup), drive=Drive(setup.electrodes))
    return [Quantities(beam, None, setup), Quantities(follow(beam, None, setup), None, setup)]


def tagged(seen, rule):
    """Tags over all cells of each level, on every rank."""
    field = Field(seen.hierarchy)
    for level, values in enumerate(tags_of(rule, seen)):
        field.array(level)[:] = values
    return [dense(field, level) == 1 for level in range(seen.hierarchy.levels)]


SURFACE = {"kind": "conductors"}
CHARGE = {"kind": "charge-density", "relative": 0.1}


def charged(seen, level):
    rho = [np.abs(dense(seen["rho"], l)) for l in range(seen.hierarchy.levels)]
    return rho[level] > 0.1 * max(np.nanmax(r) for r in rho)


RULES = {
    "all electrodes": (SURFACE, lambda seen, l: cut(MEETS, N * 2**l)),
    "one of them": ({**SURFACE, "electrodes": ["box"]}, lambda seen, l: cut(["box"], N * 2**l)),
    "to a level": (
        {**SURFACE, "electrodes": ["ball", "foil"], "levels": [0]},
        lambda seen, l: cut(["ball", "foil"], N * 2**l) & (l == 0),
    ),
    "or charge": (
        {"kind": "any", "of": [{**SURFACE, "electrodes": ["foil"]}, CHARGE]},
        lambda seen, l: cut(["foil"], N * 2**l) | charged(seen, l),
    ),
    "both": (
        {"kind": "all", "of": [SURFACE, {**SURFACE, "electrodes": ["ball"]}]},
        lambda seen, l: cut(["ball"], N * 2**l) & cut(MEETS, N * 2**l),
    ),
}


@pytest.mark.mpi(ranks=(1, 2, 3), timeout=120)
@pytest.mark.parametrize("name", RULES)
def test_rule_tags_the_cells_that_numpy_asks_for(comm, name):
    rule, oracle = RULES[name]
    given = scene(rule)
    for seen in meshes(comm, given):
        for level, tags in enumerate(tagged(seen, given.refinement.rule)):
            exists = mask(seen.hierarchy, level) == 1
            assert np.array_equal(tags, oracle(seen, level) & exists)
    finest = seen.hierarchy.levels - 1
    assert finest == (1 if name == "to a level" else 2)
    tags = oracle(seen, 0)
    assert coarser(mask(seen.hierarchy, 1) == 1, 2)[tags].all()


@pytest.mark.mpi(ranks=(1, 2, 3), timeout=120)
def test_rule_of_edges_tags_the_edges_of_its_electrodes(comm):
    rule = {"kind": "conductor-edges", "electrodes": ["box", "foil"], "angle": "30 deg"}
    given = scene(rule)
    seen = meshes(comm, given)[-1]
    assert seen.hierarchy.levels == 3
    for level, tags in enumerate(tagged(seen, given.refinement.rule)):
        cells = N * 2**level
        wanted = np.zeros(cells**3, bool)
        wanted[edge_cells(BODIES[1:], [[0, 0, 0, *[cells - 1] * 3]], -1.0, 2 / cells, np.radians(30))[0]] = True
        exists = mask(seen.hierarchy, level) == 1
        assert np.array_equal(tags, wanted.reshape((cells,) * 3).T & exists)
        assert tags.any()


@pytest.mark.mpi(ranks=(2, 3))
@pytest.mark.parametrize("rule", [SURFACE, {"kind": "conductor-edges"}], ids=["surface", "edges"])
def test_mesh_is_that_of_one_rank(comm, rule):
    together, alone = (meshes(c, scene(rule, buffer=2))[-1].hierarchy for c in (comm, MPI.COMM_SELF))
    assert same_region(together, alone)


REFUSED = {
    "unknown": ({**SURFACE, "electrodes": ["bal"]}, 'electrodes.0.*did you mean "ball"'),
    "no names": ({**SURFACE, "electrodes": []}, "electrodes"),
    "angle": ({"kind": "conductor-edges", "angle": 0}, "angle"),
    "too deep": ({**SURFACE, "levels": [2]}, "levels"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_rules_that_make_no_sense_are_refused(name):
    rule, message = REFUSED[name]
    with pytest.raises(SceneError, match=message):
        scene(rule)


def test_rules_of_electrodes_want_some():
    data = {"domain": {"lower": -1, "upper": 1, "cells": N}, "refinement": {"levels": 1, "rule": SURFACE}}
    with pytest.raises(SceneError, match="of which the scene has none"):
        amrpic.Scene.from_dict(data)
    with pytest.raises(InputError, match="electrodes, of which there are none"):
        amrpic.SpaceCharge(cells=N, levels=1, rule=SURFACE)


def test_a_run_whose_mesh_is_refined_at_a_sphere_has_a_fifth_of_the_error_of_its_charge():
    """Between open faces; 3.2 and 6.4 cells a radius."""
    errors = []
    for levels in (0, 1):
        given = {
            "domain": {"lower": -1, "upper": 1, "cells": N},
            "electrodes": [
                {"name": "ball", "shape": {"kind": "sphere", "centre": [0.02, 0.01, 0], "radius": 0.4}, "voltage": 1}
            ],
            "refinement": {"levels": levels, "rule": SURFACE},
            "output": {"write": []},
        }
        state = amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict(given)).state
        assert state.hierarchy.levels == levels + 1
        errors.append(abs(state.solution.charges["ball"] / (4 * np.pi * epsilon_0 * 0.4) - 1))
    assert errors[0] < 1.5e-3 and errors[1] < errors[0] / 5


# ---- from Python ----


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_hierarchy_around_electrodes_has_its_levels_at_surfaces_and_at_edges(comm):
    domain = amrpic.Domain(-1, 1, N, boundary="dirichlet")
    hierarchy = amrpic.Hierarchy.around(comm, domain, BODIES[1:], levels=1, edges=3, blocking_factor=4)
    assert same_region(hierarchy, amrpic.Hierarchy.around(MPI.COMM_SELF, domain, BODIES[1:], 1, 3, blocking_factor=4))
    assert hierarchy.levels == 4
    assert coarser(mask(hierarchy, 1) == 1, 2)[cut(["box", "foil"], N)].all()
    for level in range(3):
        cells = N * 2**level
        edges = np.zeros(cells**3, bool)
        edges[edge_cells(BODIES[1:], [[0, 0, 0, *[cells - 1] * 3]], -1.0, 2 / cells)[0]] = True
        edges = edges.reshape((cells,) * 3).T
        assert edges.any() and coarser(mask(hierarchy, level + 1) == 1, 2)[edges].all()
    # Faces far from edges are not refined beyond the first level.
    assert hierarchy.cells(2) < 0.5 * 8 * hierarchy.cells(1)


def test_a_cube_with_levels_at_its_edges_has_its_capacitance_within_a_thousandth():
    """Each level takes off more than half of the error, for less than 3 times the cells in place of 8."""
    cube = amrpic.Electrode("cube", shapes.Box((-0.5,) * 3, (0.5,) * 3), voltage=1)
    domain, errors, cells = amrpic.Domain(-2, 2, 32), [], []
    for levels in range(4):
        hierarchy = amrpic.Hierarchy.around(MPI.COMM_SELF, domain, [cube], levels=0, edges=levels)
        _, report = amrpic.PoissonSolver(hierarchy, electrodes=[cube]).solve(amrpic.Field(hierarchy))
        errors.append(1 - report.charges["cube"] / 73.51036e-12)
        cells.append(hierarchy.cells())
    assert all(fine < coarse / 2.2 for coarse, fine in itertools.pairwise(errors))
    assert all(fine < coarse * 3 for coarse, fine in itertools.pairwise(cells))
    assert 0 < errors[3] < 1e-3


def test_hierarchy_around_nothing_is_the_base_and_numbers_below_0_are_refused():
    domain = amrpic.Domain(-1, 1, N)
    assert amrpic.Hierarchy.around(domain, []).levels == 1
    with pytest.raises(HierarchyError, match="negative"):
        amrpic.Hierarchy.around(domain, BODIES, levels=-1)
