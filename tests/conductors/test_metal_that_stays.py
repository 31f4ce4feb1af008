# mypy: disable-error-code="arg-type"
"""Metal that stays where it is, as the cells see it: neither cut nor solved for anew."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from amrpic import Domain, Electrode, Field, Hierarchy, PoissonSolver, shapes
from amrpic.conductors.refined import Remembered, beside_surfaces

PIPE = shapes.Cylinder((0, 0, -8), (0, 0, 8), 0.7) - shapes.Cylinder((0, 0, -9), (0, 0, 9), 0.55)
BALL = shapes.Sphere((0.1, 0.05, 0), 0.2)


def mesh() -> Hierarchy:
    return Hierarchy(MPI.COMM_SELF, Domain(-1, 1, 16, "dirichlet"), [[((8, 8, 8), (23, 23, 23))]], 16, 4)


def pipe(by=(0, 0, 0), volts=1.0):
    return [Electrode("pipe", PIPE.moved(by), voltage=volts)]


def test_a_solver_takes_a_pipe_that_is_moved_along_itself():
    hierarchy = mesh()
    solver = PoissonSolver(hierarchy, electrodes=pipe())
    units = solver.unit_potential("pipe")
    assert solver.takes(pipe((0, 0, 0.25), 3.0))
    assert np.array_equal(solver.unit_potential("pipe").array(1), units.array(1))
    phi, _ = solver.solve(Field(hierarchy))
    expected, _ = PoissonSolver(hierarchy, electrodes=pipe((0, 0, 0.25), 3.0)).solve(Field(hierarchy))
    for level in range(2):
        assert np.array_equal(phi.array(level), expected.array(level))
    assert not solver.takes(pipe((0.01, 0, 0)))
    assert not solver.takes([*pipe(), Electrode("ball", BALL, voltage=1)])
    assert solver.electrodes[0].voltage == 3


def test_a_solver_takes_no_body_whose_place_its_cells_see():
    solver = PoissonSolver(mesh(), electrodes=[Electrode("ball", BALL, voltage=1)])
    assert solver.takes([Electrode("ball", BALL.moved((0, 0, 0)), voltage=2)])
    assert not solver.takes([Electrode("ball", BALL.moved((0, 0, 0.125)), voltage=1)])


def test_marks_of_boxes_are_found_once_as_long_as_electrodes_stay():
    asked = []

    def mark(electrodes, boxes, origin, spacing):
        asked.append(len(boxes))
        return beside_surfaces(electrodes, boxes, origin, spacing)

    boxes = np.array([[0, 0, 0, 15, 15, 7], [0, 0, 8, 15, 15, 15]])
    others = np.array([[4, 0, 0, 11, 7, 7], [0, 0, 8, 15, 15, 15], [0, 8, 0, 7, 15, 7]])
    remembered = Remembered(mark)
    for level in (boxes, others, others, boxes):
        expected = beside_surfaces(pipe(), level, (-1, -1, -1), 0.125)
        assert np.array_equal(remembered(pipe(volts=2.0), level, (-1, -1, -1), 0.125), expected)
    assert asked == [2, 2, 1]
    moved = pipe((0.02, 0, 0))
    expected = beside_surfaces(moved, boxes, (-1, -1, -1), 0.125)
    assert np.array_equal(remembered(moved, boxes, (-1, -1, -1), 0.125), expected)
    assert asked == [2, 2, 1, 2]
