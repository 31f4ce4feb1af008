"""Arms that metal cuts: against a search along each arm, for any boxes, and at ties."""

import numpy as np
import pytest

import bodies
from amrpic import Electrode, shapes
from amrpic.conductors.arms import SIDES, arms_of_boxes
from amrpic.conductors.contacts import sentence
from amrpic.conductors.metal import refuse_contacts
from amrpic.errors import InputError
from amrpic.pic.driven_electrodes import Wall
from arms_of_one_box import cut_arms, of_box

CELLS = np.array([20, 18, 22])
ORIGIN, SPACING = np.array([-0.9, -0.85, -0.95]), np.array([0.09, 0.094, 0.086])
STEPS = np.array([(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)])


def centres(lower=(0, 0, 0), shape=CELLS):
    """Return the centres (n, 3) of a box of cells, x fastest."""
    k, j, i = np.indices(tuple(shape)[::-1])
    return ORIGIN + (np.stack([i, j, k], axis=-1).reshape(-1, 3) + np.array(lower) + 0.5) * SPACING


def metal(*shapes_of_them):
    return [Electrode(f"e{n}", shape, voltage=float(n)) for n, shape in enumerate(shapes_of_them)]


def by_search(contains, points):
    """Return which points are in metal, and the share of each arm (n, 6) until metal, inf where there is none: by bisection."""
    solid = contains(points)
    shares = np.linspace(0, 1, 401)
    theta = np.full((len(points), 6), np.inf)
    for side, step in enumerate(STEPS):
        way = step * SPACING
        inside = contains((points[:, None] + shares[:, None] * way).reshape(-1, 3)).reshape(len(points), -1)
        hit = np.flatnonzero(inside.any(axis=1) & ~solid)
        high = shares[inside[hit].argmax(axis=1)]
        low = high - shares[1]
        for _ in range(45):
            middle = (low + high) / 2
            within = contains(points[hit] + middle[:, None] * way)
            low, high = np.where(within, low, middle), np.where(within, middle, high)
        theta[hit, side] = high
    return solid, theta


def dense(arms, cells):
    """Return solid flags and shares (n, 6) over all cells of a box."""
    solid, theta = np.zeros(cells, bool), np.full((cells, 6), np.inf)
    solid[arms.solid], theta[arms.cell] = True, arms.theta
    return solid, theta


@pytest.mark.parametrize("name", [name for name in bodies.BODIES if name != "thin torus"])
def test_arms_are_those_of_a_search_along_each_of_them(name):
    body, contains = bodies.BODIES[name]
    points = centres()
    arms = cut_arms(metal(body), (0, 0, 0), CELLS, ORIGIN, SPACING)
    solid, theta = dense(arms, len(points))
    expected_solid, expected = by_search(contains, points)
    assert np.array_equal(solid, expected_solid)
    # The search misses metal that is thinner than its steps.
    seen = np.isfinite(expected)
    assert theta[seen] == pytest.approx(expected[seen], abs=1e-10)
    assert np.count_nonzero(np.isfinite(theta) & ~seen) <= 6
    assert np.array_equal(arms.electrode >= 0, np.isfinite(arms.theta))
    assert set(arms.cell).isdisjoint(arms.solid)


SCENE = metal(
    shapes.Sphere((0.1, 0.2, -0.1), 0.31),
    shapes.Disk((0, 0, 0.6), (1, 2, 9), 0.5),
    shapes.Torus((0, 0.1, -0.6), (0, 1, 6), 0.5, 0.03),
    shapes.Box((-0.7, -0.7, -0.3), (-0.5, 0.4, 0.2)) - shapes.Cylinder((-0.8, 0, 0), (0.2, 0, 0), 0.07),
    shapes.LevelSet(bodies.ellipsoid, (-0.7,) * 3, (0.7,) * 3).scaled(0.2).moved((0.6, -0.5, 0.1)),
)


def everywhere(boxes):
    """Return what is known of each cell of the level, from several boxes."""
    arms, contacts = arms_of_boxes(SCENE, boxes, ORIGIN, SPACING)
    assert not contacts
    known: dict[tuple[int, ...], bytes] = {}
    for number, box in enumerate(np.array(boxes)):
        own, size = of_box(arms, number), box[3:] - box[:3] + 1
        rows = np.column_stack([own.theta, own.electrode, own.surface])
        for cells, values in ((own.cell, rows), (own.solid, own.solid_electrode)):
            index = np.column_stack(np.unravel_index(cells, size[::-1]))[:, ::-1] + box[:3]
            known |= {tuple(at): np.array(value).tobytes() for at, value in zip(index.tolist(), values, strict=True)}
    return known


@pytest.mark.parametrize("size", [(5, 18, 7), (20, 1, 22), (4, 4, 4)])
def test_digits_do_not_depend_on_boxes(size):
    whole = everywhere([[0, 0, 0, *(CELLS - 1)]])
    starts = [np.arange(0, n, step) for n, step in zip(CELLS, size, strict=True)]
    boxes = [
        [i, j, k, *np.minimum(np.add((i, j, k), size), CELLS) - 1]
        for k in starts[2]
        for j in starts[1]
        for i in starts[0]
    ]
    assert everywhere(boxes) == whole and len(whole) > 500
    alone: dict[tuple[int, ...], bytes] = {}
    for box in boxes[::-1]:
        alone |= everywhere([box])
    assert alone == whole


def test_both_sides_of_an_arm_meet_the_same_surface():
    """A foil: shares from both sides add up to an arm."""
    arms = cut_arms(metal(shapes.Disk((0, 0, 0.011), (1, 2, 9), 0.5)), (0, 0, 0), CELLS, ORIGIN, SPACING)
    _, theta = dense(arms, CELLS.prod())
    theta = theta.reshape(*CELLS[::-1], 6)
    assert len(arms.solid) == 0 and len(arms.cell) > 100
    for axis in range(3):
        up = np.take(theta[..., 2 * axis + 1], range(CELLS[axis] - 1), axis=2 - axis)
        down = np.take(theta[..., 2 * axis], range(1, CELLS[axis]), axis=2 - axis)
        cut = np.isfinite(up)
        assert cut.any() and np.array_equal(cut, np.isfinite(down))
        assert up[cut] + down[cut] == pytest.approx(1, abs=1e-12)


def test_centres_on_the_surface_are_in_metal_and_arms_to_metal_are_cut():
    box = shapes.Box((2.5, 3.5, 4.5), (5.5, 5.5, 6.5))  # its faces are planes of centres
    arms = cut_arms(metal(box), (0, 0, 0), (10, 10, 10), 0.0, 1.0)
    index = np.column_stack(np.unravel_index(arms.solid, (10, 10, 10)))[:, ::-1]
    assert index.min(axis=0).tolist() == [2, 3, 4] and index.max(axis=0).tolist() == [5, 5, 6]
    assert len(arms.solid) == 4 * 3 * 3
    assert set(arms.theta[np.isfinite(arms.theta)]) == {1.0}
    assert len(arms.cell) == 2 * (4 * 3 + 4 * 3 + 3 * 3)


def test_surfaces_within_rounding_of_centres_are_on_them():
    shifted = [
        cut_arms(metal(shapes.Box((2.5 + d, 3.5 + d, 4.5), (5.5, 5.5 - d, 6.5))), (0,) * 3, (10,) * 3, 0.0, 1.0)
        for d in (0.0, 1e-15, -1e-15, 1e-12)
    ]
    for arms in shifted[1:]:
        assert np.array_equal(arms.solid, shifted[0].solid)
        assert arms.theta == pytest.approx(shifted[0].theta, abs=1e-9)


def test_a_foil_in_a_plane_of_centres_is_a_layer_of_metal():
    arms = cut_arms(metal(shapes.Disk((5, 5, 4.5), (0, 0, 1), 3.01)), (0,) * 3, (10,) * 3, 0.0, 1.0)
    assert set(arms.solid // 100) == {4} and 20 < len(arms.solid) < 40


def test_the_nearest_of_several_electrodes_is_met():
    one, other = shapes.Box((3.2, 0, 0), (3.3, 9, 9)), shapes.Box((2.7, 0, 0), (2.8, 9, 9))
    arms = cut_arms(metal(one, other), (0,) * 3, (9,) * 3, 0.0, 1.0)
    at = arms.cell == 2 + 9 * (4 + 9 * 4)
    assert arms.theta[at, SIDES.index("x+")] == pytest.approx(0.2) and arms.electrode[at, 1] == 1
    at = arms.cell == 3 + 9 * (4 + 9 * 4)
    assert arms.theta[at, SIDES.index("x-")] == pytest.approx(0.2) and arms.electrode[at, 0] == 0


def test_of_electrodes_at_one_voltage_that_overlap_the_first_counts():
    parts = [Electrode(name, shapes.Sphere((x, 5, 5), 2), voltage="2 kV") for name, x in (("a", 4.2), ("b", 5.8))]
    arms = cut_arms(parts, (0,) * 3, (10,) * 3, 0.0, 1.0)
    union = cut_arms(metal(parts[0].shape | parts[1].shape), (0,) * 3, (10,) * 3, 0.0, 1.0)
    assert np.array_equal(arms.solid, union.solid) and np.array_equal(arms.theta, union.theta)
    middle = arms.solid == 4 + 10 * (4 + 10 * 4)
    assert arms.solid_electrode[middle] == 0 and 1 in arms.solid_electrode


TOUCHING = {
    "face to face": (shapes.Box((1, 1, 1), (4, 4, 4)), shapes.Box((4, 1, 1), (6, 4, 4))),
    "overlapping": (shapes.Sphere((4, 5, 5), 2), shapes.Sphere((7, 5, 5), 2)),
    "one in the other": (shapes.Sphere((5, 5, 5), 3), shapes.Sphere((5, 5, 5), 1)),
    "a foil on a box": (shapes.Box((1, 1, 1), (4, 4, 4)), shapes.Disk((2, 2, 4), (0, 0, 1), 1)),
    "less than a cell": (shapes.Box((1, 1, 1), (4.02, 4, 4)), shapes.Box((4.01, 1, 1), (6, 4, 4))),
}


@pytest.mark.parametrize("name", TOUCHING)
def test_electrodes_at_different_voltages_that_touch_are_refused_with_the_place(name):
    pair = metal(*TOUCHING[name])
    with pytest.raises(InputError, match=r"electrodes e0 and e1 touch at \(.*\) m and have different voltages; move"):
        cut_arms(pair, (0,) * 3, (10,) * 3, 0.0, 1.0)
    _, contacts = arms_of_boxes(pair, [[0, 0, 0, 9, 9, 9]], 0.0, 1.0)
    around = contacts[0].place + 1e-6 * (np.indices((3, 3, 3)).reshape(3, -1).T - 1)
    assert pair[0].shape.inside(around).any()
    assert pair[1].shape.inside(around).any() or len(pair[1].shape.spans(around, 2))
    assert sentence(pair, contacts[0]).count(";") == 1
    floating = [Electrode("a", pair[0].shape, charge=0), Electrode("b", pair[1].shape, charge=0)]
    assert arms_of_boxes(floating, [[0, 0, 0, 9, 9, 9]], 0.0, 1.0)[1]
    same = [Electrode("a", pair[0].shape, voltage=1), Electrode("b", pair[1].shape, voltage=1)]
    assert not arms_of_boxes(same, [[0, 0, 0, 9, 9, 9]], 0.0, 1.0)[1]
    refuse_contacts(same, (0, 0, 0), (1, 1, 1))
    for refused in (pair, floating):
        with pytest.raises(InputError, match="touch at"):
            refuse_contacts(refused, (0, 0, 0), (1, 1, 1))


def test_electrodes_a_thin_gap_apart_do_not_touch():
    apart = metal(shapes.Box((1, 1, 1), (4.01, 4, 4)), shapes.Box((4.02, 1, 1), (6, 4, 4)))
    assert len(cut_arms(apart, (0,) * 3, (10,) * 3, 0.0, 1.0).cell)
    inside = metal(shapes.Sphere((5, 5, 5), 4) - shapes.Sphere((5, 5, 5), 3), shapes.Sphere((5, 5, 5), 2.9))
    assert len(cut_arms(inside, (0,) * 3, (10,) * 3, 0.0, 1.0).cell)
    for pair in (apart, inside):
        refuse_contacts(pair, (0, 0, 0), (1, 1, 1))


def test_gaps_without_a_centre_of_a_cell_are_said():
    """Cells of width 1 have their centres at 0.5, 1.5, ..."""
    below = shapes.Box((1, 1, 1), (4, 4, 4))
    for upper, width in ((4.4, 0.4), (4.5, 0.5), (4.6, None), (6, None)):
        said = refuse_contacts(metal(below, shapes.Box((1, 1, upper), (4, 4, 8))), (0, 0, 0), (1, 1, 1))
        assert [f"{width:.3g} m apart" in sentence for sentence in said] == ([True] if width else [])
    for pair in ((below, shapes.Box((5.2, 1, 1), (8, 4, 4))), (below, shapes.Box((4.2, 5, 1), (8, 8, 4)))):
        assert refuse_contacts(metal(*pair), (0, 0, 0), (1, 1, 1)) == []  # a centre lies between; no line meets both
    same = [
        Electrode(name, shape, voltage=1) for name, shape in (("a", below), ("b", shapes.Box((1, 1, 4.1), (4, 4, 8))))
    ]
    assert refuse_contacts(same, (0, 0, 0), (1, 1, 1)) == []


def test_electrodes_at_walls_of_another_potential_are_said():
    """The face z = 0 is at 0 V."""
    face = Wall("the face z_lower", shapes.Box((0, 0, -9), (9, 9, 0)), 0.0)
    for lower, voltage, said in (
        (-1, 5, "meets the face z_lower at"),
        (0.4, 5, "and the face z_lower are 0.4 m"),
        (0.6, 5, ""),
    ):
        peg = Electrode("peg", shapes.Box((2, 2, lower), (4, 4, 4)), voltage=voltage)
        sentences = refuse_contacts([peg], (0, 0, 0), (1, 1, 1), [face])
        assert len(sentences) == bool(said) and all(said in sentence for sentence in sentences)
    grounded = Electrode("peg", shapes.Box((2, 2, -1), (4, 4, 4)), voltage=0)
    assert refuse_contacts([grounded], (0, 0, 0), (1, 1, 1), [face]) == []


def test_half_spaces_and_far_electrodes_are_compared():
    plane, ball = shapes.Plane((0, 0, 1), (0, 0, 1)), shapes.Sphere((0, 0, 3), 1.9)
    refuse_contacts(
        metal(plane, ball, shapes.Sphere((9, 9, 9), 1), shapes.Plane((0, 0, 20), (0, 0, -1))), (0, 0, 0), (1, 1, 1)
    )
    for other in (shapes.Sphere((0, 0, 3), 2.01), shapes.Plane((3, 0, 0), (1, 0, 0)), shapes.Sphere((0, 0, -9), 1)):
        with pytest.raises(InputError, match="electrodes e0 and e1 touch"):
            refuse_contacts(metal(plane, other), (0, 0, 0), (1, 1, 1))


def test_crossings_lie_on_the_surface_with_its_normal():
    box = [[0, 0, 0, *(CELLS - 1)]]
    centre = np.array((0.1, 0.2, -0.1))
    ball = metal(shapes.Sphere(tuple(centre), 0.5))
    arms, _ = arms_of_boxes(ball, box, ORIGIN, SPACING)
    walls = arms.crossings(ball, box, ORIGIN, SPACING)
    assert len(walls.cut) == np.isfinite(arms.theta).sum()
    assert np.linalg.norm(walls.place - centre, axis=1) == pytest.approx(0.5)
    assert walls.normal == pytest.approx((walls.place - centre) / 0.5)


def test_no_electrodes_cut_nothing():
    arms = cut_arms([], (0, 0, 0), (4, 4, 4), 0.0, 1.0)
    assert len(arms.cell) == len(arms.solid) == 0 and arms.theta.shape == (0, 6)
    far = cut_arms(metal(shapes.Sphere((99, 0, 0), 1)), (0, 0, 0), (4, 4, 4), 0.0, 1.0)
    assert len(far.cell) == len(far.solid) == 0


def test_metal_just_outside_a_box_cuts_its_arms():
    arms = cut_arms(metal(shapes.Plane((0, 0, -0.25), (0, 0, 1))), (0, 0, 0), (4, 4, 4), 0.0, 1.0)
    assert arms.cell.tolist() == list(range(16)) and len(arms.solid) == 0
    assert arms.theta[:, 4] == pytest.approx(0.75) and np.isinf(arms.theta[:, :4]).all()


def test_coarse_spacings_see_the_same_surface():
    """A fine arm and a coarse one along the same line meet a sphere at the same place."""
    ball = metal(shapes.Sphere((0.11, 0.2, -0.1), 0.5))
    places = []
    for factor, cells in ((1, 27), (3, 9)):
        box = [[0, 0, 0, cells - 1, cells - 1, cells - 1]]
        arms, _ = arms_of_boxes(ball, box, -0.9, 1.8 / 27 * factor)
        places.append(arms.crossings(ball, box, -0.9, 1.8 / 27 * factor).place)
    gaps = np.linalg.norm(places[1][:, None] - places[0], axis=2).min(axis=1)
    assert gaps.max() < 1e-12


def rough_box(rng):
    """Return a body on planes of centres, but for rounding, and without the slack of `Box`."""
    low = rng.integers(1, 6, 3) + 0.5
    high = low + rng.integers(1, 4, 3)
    middle, half = (low + high) / 2, (high - low) / 2 * (1 + rng.integers(-2, 3, 3) * 1e-16)

    def outside(x, y, z):
        return np.maximum.reduce([abs(v - m) - h for v, m, h in zip((x, y, z), middle, half, strict=True)])

    return shapes.LevelSet(outside, (0.0,) * 3, (10.0,) * 3)


@pytest.mark.parametrize("seed", range(12))
def test_arms_that_end_in_metal_are_cut_whatever_rounding_says(seed):
    rng = np.random.default_rng(seed)
    body = rough_box(rng) | (rough_box(rng) - rough_box(rng))
    arms = cut_arms(metal(body), (0, 0, 0), (10, 10, 10), 0.0, 1.0)
    solid, theta = dense(arms, 1000)
    solid, theta = solid.reshape(10, 10, 10), theta.reshape(10, 10, 10, 6)
    assert solid.any() and ((theta > 0) & (theta <= 1) | np.isinf(theta)).all()
    for side, (i, j, k) in enumerate(STEPS):
        ends_in_metal = np.roll(solid, (-k, -j, -i), axis=(0, 1, 2))
        assert np.array_equal(np.isfinite(theta[..., side]), ends_in_metal & ~solid)
    parts = [[i, j, k, i + 4, j + 1, k + 9] for k in (0,) for j in range(0, 10, 2) for i in (0, 5)]
    split, _ = arms_of_boxes(metal(body), parts, 0.0, 1.0)
    assert len(split.solid) == len(arms.solid) and len(split.cell) == len(arms.cell)
    assert np.array_equal(np.sort(split.theta, axis=None), np.sort(arms.theta, axis=None))
