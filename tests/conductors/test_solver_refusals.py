# mypy: disable-error-code="arg-type, call-overload"
"""What a solver does not take of electrodes: one sentence with a remedy, the same on all ranks."""

from __future__ import annotations

import pytest

from amrpic import Domain, Electrode, Field, Hierarchy, PoissonSolver, SolverError, shapes
from amrpic.mesh.mirror import Mirror, MirrorPlane

CLOSED = "dirichlet"
BALL = shapes.Sphere((0.01, 0.02, 0.03), 0.3)


def mesh(comm, boundary=CLOSED, levels=()):
    return Hierarchy(comm, Domain(-1, 1, 16, boundary), levels, 8, 4)


def at(shape, voltage=1.0, name="e"):
    return Electrode(name, shape, voltage=voltage)


def patch(lower, upper):
    return [[((lower,) * 3, (upper,) * 3)]]


# What is refused: boundary, levels, electrodes, options, and what the sentence says.
REFUSED = {
    "electrodes that touch": (
        CLOSED,
        (),
        [at(BALL), at(shapes.Box((0.1, -0.1, -0.1), (0.9, 0.1, 0.1)), 2.0, "f")],
        {},
        "electrodes e and f touch at",
    ),
    "electrodes that touch on the last rank's cells": (
        CLOSED,
        (),
        [at(shapes.Box((0.5, 0.5, 0.5), (0.7, 0.7, 0.7))), at(shapes.Box((0.6, 0.6, 0.6), (0.9, 0.9, 0.9)), 2.0, "f")],
        {},
        "electrodes e and f touch at",
    ),
    "metal at an open face": ("open", (), [at(shapes.Sphere((0, 0, 0.9), 0.3))], {}, "meets an open face"),
    "metal at one open face of many": (
        {"x": "dirichlet", "y": "neumann", "z": ("dirichlet", "open")},
        (),
        [at(shapes.Plane((0, 0, 0.95), (0, 0, -1)))],
        {},
        "meets an open face",
    ),
    "a wire through one periodic face, between the lines of the base": (
        {"x": CLOSED, "y": "periodic", "z": CLOSED},
        [[((8, 0, 8), (23, 7, 23))]],
        [at(shapes.Cylinder((0.03125, 0.9, 0.03125), (0.03125, 1.5, 0.03125), 0.02))],
        {},
        "meets a periodic face across y",
    ),
    "an electrode that floats and leaves no cell": (
        CLOSED,
        (),
        [Electrode("free", shapes.Box((-9,) * 3, (9,) * 3), charge=0)],
        {},
        "electrode free floats where no cell",
    ),
    "metal that ends at a periodic face": (
        {"x": "periodic", "y": CLOSED, "z": CLOSED},
        (),
        [at(shapes.Sphere((0.9, 0, 0), 0.3))],
        {},
        "meets a periodic face across x",
    ),
    "a cone through periodic faces": (
        {"x": CLOSED, "y": CLOSED, "z": "periodic"},
        (),
        [at(shapes.Cone((0, 0, -2), (0, 0, 2), 0.2, 0.5))],
        {},
        "meets a periodic face across z",
    ),
    "two of a name": (CLOSED, (), [at(BALL), at(shapes.Sphere((0.7, 0, 0), 0.1))], {}, "two electrodes are named e"),
    "the fourth order": (CLOSED, (), [at(BALL)], {"order": 4}, "order is 4 with electrodes"),
    "a mirror": (
        {"x": CLOSED, "y": CLOSED, "z": CLOSED},
        (),
        [at(BALL)],
        {"mirror": Mirror(2, MirrorPlane(-1.0, "dirichlet"))},
        "beside a mirror",
    ),
    "nothing that fixes the potential": (
        "neumann",
        (),
        [Electrode("e", BALL, charge=1e-12)],
        {},
        "all electrodes float",
    ),
    "metal that no cell sees": (
        CLOSED,
        (),
        [at(shapes.Sphere((0, 0, 0), 0.02), 1.0), at(BALL, 1.0, "f")],
        {},
        "electrode e meets no line",
    ),
    "metal outside the domain": (CLOSED, (), [at(shapes.Sphere((5, 0, 0), 1))], {}, "electrode e meets no line"),
}


def check(text: str, part: str) -> None:
    assert part in text
    assert "; " in text and "\n" not in text and ". " not in text and not text.endswith(".")


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("what", REFUSED)
def test_what_is_refused_is_said_in_one_sentence_by_all_ranks(comm, what):
    boundary, levels, electrodes, options, part = REFUSED[what]
    with pytest.raises(SolverError) as refused:
        PoissonSolver(mesh(comm, boundary, levels), electrodes=electrodes, **dict(options))
    text = str(refused.value)
    check(text, part)
    assert comm.allgather(text) == [text] * comm.size


@pytest.mark.mpi(ranks=(1, 2))
def test_electrodes_that_are_not_there_are_refused(comm):
    solver = PoissonSolver(mesh(comm), electrodes=[at(BALL)])
    with pytest.raises(SolverError, match="no electrode 'f'; there are e"):
        solver.unit_potential("f")
    with pytest.raises(SolverError, match="without electrodes; give it some"):
        PoissonSolver(mesh(comm)).capacitance()


@pytest.mark.mpi(ranks=(1, 2))
def test_neighbours_of_what_is_refused_are_taken(comm):
    """Metal that ends a cell before an open face; in a refined box, through its faces and beside it; through periodic faces
    alike; one voltage where electrodes overlap; one of two that float held in a closed box; one that floats where all arms that
    end on it are short."""
    taken = [
        ("open", (), [at(shapes.Box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.8)))]),
        (CLOSED, patch(8, 23), [at(BALL)]),
        (CLOSED, patch(8, 15), [at(BALL)]),
        (CLOSED, patch(20, 27), [at(shapes.Box((-0.5, -0.5, -0.5), (0.2, 0.2, 0.2)))]),
        ({"x": CLOSED, "y": CLOSED, "z": "periodic"}, (), [at(shapes.Cylinder((0, 0, -5), (0, 0, 5), 0.3))]),
        (CLOSED, (), [at(BALL), at(shapes.Box((0.1, -0.1, -0.1), (0.9, 0.1, 0.1)), 1.0, "f")]),
        ("neumann", (), [at(BALL), Electrode("f", shapes.Sphere((0.7, 0, 0), 0.2), charge=0)]),
        (CLOSED, (), [Electrode("e", shapes.Sphere((0, 0, 0), 0.1875), charge=1e-12)]),
    ]
    for boundary, levels, electrodes in taken:
        domain = mesh(comm, boundary, levels)
        _, report = PoissonSolver(domain, electrodes=electrodes).solve(Field(domain))
        assert report.converged
