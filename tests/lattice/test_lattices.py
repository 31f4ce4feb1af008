"""Lattices of PALS and MAD-X as elements of a scene."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import amrpic
from amrpic.errors import InputError
from amrpic.lattice import pals
from amrpic.lattice.pieces import START, exit_of
from amrpic.scene.lattice_file import LatticeSection
from exact.lattices import MADX, PALS, matrix, starts, tracked

HEAD = "PALS:\n  facility:\n    - begin: {kind: BeginningEle, ReferenceP: {species_ref: proton, pc_ref: 3.0e8}}\n"


def written(folder: Path, text: str, name: str = "line.pals.yaml") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def line_of(folder: Path, text: str, name: str | None = None) -> list[str]:
    return [piece.name for piece in pals.read(str(written(folder, HEAD + text)), name).pieces]


# ---- lines of PALS ----
def test_lines_repeat_reverse_and_inherit(tmp_path):
    text = """
    - a: {kind: Drift, length: 0.1}
    - b: {kind: Quadrupole, length: 0.2, MagneticMultipoleP: {Kn1: 1.0}}
    - cell: {kind: BeamLine, line: [a, b, c: {inherit: b, MagneticMultipoleP: {Kn1: -2.0}}]}
    - all: {kind: BeamLine, line: [begin, cell: {repeat: 2}, cell: {repeat: -1}, a: {repeat: 2}]}
    - ring: {kind: Lattice, branches: [x: {inherit: all}]}
    - use: ring
"""
    assert line_of(tmp_path, text) == ["begin", *"abcabccbaaa"]
    pieces = pals.read(str(tmp_path / "line.pals.yaml")).pieces
    assert (pieces[3].length, pieces[3].normal) == (0.2, {1: -2.0})
    assert line_of(tmp_path, text, "cell") == list("abc")


def test_a_line_that_is_passed_backwards_has_its_faces_exchanged(tmp_path):
    text = """
    - m: {kind: Bend, length: 0.5, BendP: {angle_ref: 0.2, e1: 0.05, e2: -0.03}}
    - a: {kind: Drift, length: 0.1}
    - cell: {kind: BeamLine, line: [a, m]}
    - all: {kind: BeamLine, line: [begin, cell: {direction: -1}]}
"""
    assert line_of(tmp_path, text) == ["begin", "m", "a"]
    assert pals.read(str(tmp_path / "line.pals.yaml")).pieces[1].faces == (-0.03, 0.05)


def test_numbers_may_be_expressions(tmp_path):
    text = """
    - constants: {one: 1 + 2*3, two: one^2 / 7}
    - a: {kind: Drift, length: two + sin(0)}
    - all: {kind: BeamLine, line: [begin, a]}
"""
    line_of(tmp_path, text)
    assert pals.read(str(tmp_path / "line.pals.yaml")).length == pytest.approx(7)


@pytest.mark.parametrize(
    "line, what",
    [
        ("- q: {kind: Quadrupole, length: 0.1, gradient: 3}", "unknown key 'gradient'"),
        ("- q: {kind: Quadrupole, length: 0.1, MagneticMultipoleP: {k1: 3}}", "unknown key 'k1'"),
        ("- q: {kind: Quadrupole, MagneticMultipoleP: {Kn1: 3}}", "no length"),
        ("- q: {kind: Bend, length: 0.1, BendP: {angel_ref: 3}}", "unknown key 'angel_ref'"),
        ("- q: {kind: Bend, length: 0.1, BendP: {angle_ref: 0.1, g_ref: 3}}", "by its curvature"),
        ("- q: {kind: Drift, length: os.system(1)}", "no expression"),
        ("- q: {kind: Drift, length: unknown}", "unknown"),
        ("- q: {kind: Drift, length: 1 < 2}", "no expression"),
        ("- q: {inherit: nothing}", "not defined"),
        ("- q", "no definition"),
        ("- load: {file: other}", "not understood"),
    ],
)
def test_what_is_not_understood_is_refused(tmp_path, line, what):
    text = f"\n    {line}\n    - all: {{kind: BeamLine, line: [begin, q]}}\n"
    with pytest.raises(InputError, match=what) as refused:
        line_of(tmp_path, text)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("repeat, what", [("2.5", "whole number"), ("10000", "more than 1000000 elements")])
def test_a_line_repeats_so_often_as_can_be(tmp_path, repeat, what):
    text = f"""
    - a: {{kind: Drift, length: 0.1}}
    - cell: {{kind: BeamLine, line: [a: {{repeat: {repeat}}}]}}
    - all: {{kind: BeamLine, line: [begin, cell: {{repeat: 10000}}]}}
"""
    with pytest.raises(InputError, match=what):
        line_of(tmp_path, text)


def test_what_has_no_counterpart_is_refused_by_name_and_place_or_is_a_drift(tmp_path):
    file = written(
        tmp_path,
        HEAD
        + """
    - w: {kind: Wiggler, length: 0.3}
    - m: {kind: Bend, length: 0.5, BendP: {angle_ref: 0.2, h1: 0.1}}
    - all: {kind: BeamLine, line: [begin, a: {kind: Drift, length: 0.5}, w, m]}
""",
    )
    with pytest.raises(InputError, match=r"w at s = 0.5 m is a Wiggler.*and 1 more"):
        LatticeSection(file=str(file)).converted()
    of = LatticeSection(file=str(file), missing="drift").converted()
    assert [element["kind"] for element in of.elements] == ["dipole"]
    assert of.placed[-1].became == ["dipole", "without curved pole faces"]
    assert of.placed[2].became == ["drift"]


def test_a_lattice_without_a_reference_particle_asks_for_one(tmp_path):
    file = written(tmp_path, "PALS:\n  facility:\n    - all: {kind: BeamLine, line: [a: {kind: Drift, length: 1}]}\n")
    with pytest.raises(InputError, match="species and"):
        LatticeSection(file=str(file)).converted()
    assert LatticeSection(file=str(file), species="proton", kinetic_energy="45 MeV").converted().reference.momentum > 0


# ---- scenes ----
def test_the_elements_of_a_lattice_are_those_of_the_scene(tmp_path):
    written(tmp_path, PALS)
    scene = tmp_path / "scene.toml"
    scene.write_text(
        'lattice = "line.pals.yaml"\n[domain]\nlower = -0.05\nupper = 0.05\ncells = 8\nboundary = "open"\n'
        '[motion]\nkind = "leapfrog"\nwindow = "reference"\ndt = "auto"\n',
        encoding="utf-8",
    )
    given = amrpic.Scene.from_toml(scene)
    assert len(given.elements) == 13 and given.lattice is None
    reference = given.motion.reference
    assert reference is not None
    assert math.hypot(*reference.mean_momentum) == pytest.approx(3e8 * 1.602176634e-19 / 299792458)
    again = amrpic.Scene.from_dict(given.to_dict())
    assert again.elements == given.elements


def test_apertures_and_monitors_follow_the_orbit(tmp_path):
    file = written(
        tmp_path,
        HEAD
        + """
    - m: {kind: Bend, length: 1.0, BendP: {angle_ref: 1.5707963267948966}}
    - h: {kind: Mask, length: 0.1, ApertureP: {shape: RECTANGULAR, x_width: 0.02, y_width: 0.04, location: EVERYWHERE}}
    - s: {kind: Instrument}
    - all: {kind: BeamLine, line: [begin, m, h, s]}
""",
    )
    of = LatticeSection(file=str(file)).converted()
    radius = 2 / np.pi
    assert of.apertures[0]["centre"] == pytest.approx([-radius - 0.05, 0, radius])
    assert of.screens[0]["centre"] == pytest.approx([-radius - 0.1, 0, radius])
    assert of.screens[0]["direction"] == pytest.approx([-1, 0, 0])
    assert of.apertures[0]["half_widths"] == [0.01, 0.02] and of.apertures[0]["length"] == 0.1


# ---- rings ----
CELLS, KICKED, KICK = 12, 5, 1e-4  # number, the cell with a kicker in place of its first drift, rad
CELL = """
    - begin: {kind: BeginningEle, ReferenceP: {species_ref: proton, pc_ref: 3.0e8}}
    - d: {kind: Drift, length: 0.2}
    - e: {kind: Drift, length: 0.1}
    - f: {kind: Quadrupole, length: 0.2, MagneticMultipoleP: {Kn1: 2.5}}
    - q: {kind: Quadrupole, length: 0.2, MagneticMultipoleP: {Kn1: -2.5}}
    - m: {kind: Bend, length: 0.5, BendP: {angle_ref: 0.2617993877991494}}
    - k: {kind: Kicker, length: 0.1, MagneticMultipoleP: {Kn0L: -1.0e-4}}
    - cell: {kind: BeamLine, line: [e, m, d, q, d, m, d, f, e]}
    - kicked: {kind: BeamLine, line: [k, m, d, q, d, m, d, f, e]}
"""
ELEMENTS_OF_MADX = """
beam, particle=proton, pc=0.3;
f: quadrupole, l=0.2, k1=2.5;
q: quadrupole, l=0.2, k1=-2.5;
m: sbend, l=0.5, angle=0.2617993877991494;
k: hkicker, l=0.1, kick=1e-4;
sq: sequence, l=26.4, refer=entry;
"""
CELL_OF_MADX = ("m", 0.1), ("q", 0.8), ("m", 1.2), ("f", 1.9)  # where each begins, m


def kicked_ring_of_madx() -> str:
    placed = [(name, 2.2 * n + at) for n in range(CELLS) for name, at in (*[("k", 0.0)] * (n == KICKED), *CELL_OF_MADX)]
    return ELEMENTS_OF_MADX + "".join(f"{name}, at={at:.1f};\n" for name, at in placed) + "endsequence;\n"


def transverse() -> np.ndarray:
    """x and y (2, 2, 2) of a cell: drifts, quadrupoles, sectors (K. L. Brown, SLAC-75)."""
    h = 0.2617993877991494 / 0.5
    out = []
    for sign, weak in ((1, h**2), (-1, 0.0)):
        cell = (
            (0.1, 0),
            (0.5, weak),
            (0.2, 0),
            (0.2, -2.5 * sign),
            (0.2, 0),
            (0.5, weak),
            (0.2, 0),
            (0.2, 2.5 * sign),
            (0.1, 0),
        )
        out.append(functools.reduce(lambda before, part: thick(*part) @ before, cell, np.eye(2)))
    return np.array(out)


def tunes(turn: np.ndarray) -> list[float]:
    """Fractional tunes of x and y, below 0.5, of a matrix (4, 4) or more."""
    return [np.arccos(np.trace(turn[rows, rows]) / 2) / (2 * np.pi) for rows in (slice(0, 2), slice(2, 4))]


@pytest.fixture(scope="module")
def turn_of_kicked_ring(tmp_path_factory) -> np.ndarray:
    """Where the particles of `starts` are after a turn."""
    line = f"all: {{kind: BeamLine, line: [begin, cell: {{repeat: {KICKED}}}, kicked, cell: {{repeat: {CELLS - KICKED - 1}}}]}}"
    file = written(tmp_path_factory.mktemp("ring"), f"PALS:\n  facility:{CELL}    - {line}\n")
    return tracked(file, from_end=0.05)


def test_a_ring_closes(tmp_path):
    file = written(
        tmp_path, f"PALS:\n  facility:{CELL}    - all: {{kind: BeamLine, line: [begin, cell: {{repeat: 12}}]}}\n"
    )
    end = LatticeSection(file=str(file)).converted().end
    assert np.abs(end.origin).max() < 1e-12 and np.abs(end.axes - np.eye(3)).max() < 1e-12


@pytest.mark.long
def test_a_ring_has_orbit_and_tunes_of_its_matrix(turn_of_kicked_ring):
    """A turn through all cells, each of which meets its own magnets alone."""
    horizontal, vertical = (np.linalg.matrix_power(cell, CELLS) for cell in transverse())
    kick = [-0.1 / 2 * KICK, KICK]  # from the middle of the kicker, seen where it begins
    orbit = np.linalg.matrix_power(transverse()[0], CELLS - KICKED) @ kick
    assert turn_of_kicked_ring[0, :4] == pytest.approx([*orbit, 0, 0], abs=1e-6)
    expected = tunes(np.block([[horizontal, np.zeros((2, 2))], [np.zeros((2, 2)), vertical]]))
    assert tunes(matrix(turn_of_kicked_ring)) == pytest.approx(expected, abs=1e-4)


# ---- beside xtrack ----
def test_sequences_of_madx_give_the_same_elements(tmp_path):
    pytest.importorskip("xtrack")
    ours, theirs = (
        LatticeSection(file=str(written(tmp_path, text, name))).converted()
        for text, name in ((PALS, "line.pals.yaml"), (MADX, "line.madx"))
    )
    assert len(ours.elements) == len(theirs.elements) == 13
    for one, other in zip(ours.elements, theirs.elements, strict=True):
        assert one["name"] == other["name"] and set(one) == set(other)
        for key in set(one) - {"name", "kind"}:
            assert np.asarray(one[key], dtype=float) == pytest.approx(np.asarray(other[key], dtype=float), abs=1e-9), (
                key
            )


@pytest.fixture
def line_of_xtrack(tmp_path, monkeypatch) -> Iterator[Callable[[str], Any]]:
    """What makes a line of a sequence of MAD-X; the test is skipped where xtrack is missing."""
    xtrack = pytest.importorskip("xtrack")
    monkeypatch.chdir(tmp_path)  # where setuptools finds no settings of ours

    def made(text: str) -> Any:
        line = xtrack.load(str(written(tmp_path, text, "line.madx")), format="madx")["sq"]
        line.build_tracker()
        return line

    with xtrack.settings.override(allow_kernel_compilation=True):
        yield made


@pytest.mark.long
def test_transfer_matrices_are_those_of_xtrack(tmp_path, line_of_xtrack):
    line = line_of_xtrack(MADX)
    names = ("x", "px", "y", "py", "zeta", "delta")
    particles = line.build_particles(**dict(zip(names, starts().T, strict=True)))
    line.track(particles)
    order = np.argsort(particles.particle_id)
    expected = matrix(np.stack([getattr(particles, name) for name in names], axis=1)[order])
    found = matrix(tracked(written(tmp_path, PALS)))
    # of the cavity, which here focuses across as well: 1.5e-5 for each m of its arms
    assert np.abs(found - expected).max() < 1e-4
    assert found[5, 4] == pytest.approx(expected[5, 4], rel=0.02)


@pytest.mark.long
def test_a_ring_has_orbit_and_tunes_of_xtrack(turn_of_kicked_ring, line_of_xtrack):
    twiss = line_of_xtrack(kicked_ring_of_madx()).twiss(method="4d")
    turn = matrix(turn_of_kicked_ring)
    assert tunes(turn) == pytest.approx([abs(tune - round(tune)) for tune in (twiss.qx, twiss.qy)], abs=1e-4)
    orbit = np.linalg.solve(np.eye(4) - turn[:4, :4], turn_of_kicked_ring[0, :4])
    theirs = [getattr(twiss, name)[0] for name in ("x", "px", "y", "py")]
    assert np.abs(theirs).max() > 1e-4 and orbit == pytest.approx(theirs, abs=1e-6)


def thick(length: float, k: float) -> np.ndarray:
    """The matrix (2, 2) of a length with a focusing strength, 1/m² (K. L. Brown, SLAC-75)."""
    w = np.sqrt(complex(k))
    c, s = np.cos(w * length), np.sin(w * length) / w if k else length
    return np.array([[c, s], [-k * s, c]]).real


@pytest.mark.parametrize("angle", [0.2, -0.2])
def test_bends_have_gradients_and_fringes(tmp_path, angle):
    """Of their matrices (K. L. Brown, SLAC-75): h² + k in the plane of the bend and -k across it, tan(e - ψ) at the faces."""
    k, faces, integral = 0.8, (0.15, 0.1), 0.03
    of = f"angle_ref: {angle}, e1: {faces[0]}, e2: {faces[1]}, edge1_int: {integral / 2}, edge2_int: {integral / 2}"
    text = (
        HEAD
        + f"""
    - m: {{kind: Bend, length: 0.5, BendP: {{{of}}}, MagneticMultipoleP: {{Kn1: {k}}}}}
    - all: {{kind: BeamLine, line: [begin, a: {{kind: Drift, length: 0.2}}, m, b: {{kind: Drift, length: 0.4}}]}}
"""
    )
    found = matrix(tracked(written(tmp_path, text), 1e-10))
    h = angle / 0.5
    for plane, strength in enumerate((h**2 + k, -k)):
        expected = thick(0.2, 0.0)
        for part, e in ((None, faces[0]), (thick(0.5, strength), None), (None, faces[1]), (thick(0.4, 0.0), None)):
            if e is not None:
                psi = h * integral * (1 + np.sin(e) ** 2) / np.cos(e)
                part = np.array([[1, 0], [h * np.tan(e) if plane == 0 else -h * np.tan(e - psi), 1]])
            expected = part @ expected
        rows = slice(2 * plane, 2 * plane + 2)
        assert found[rows, rows] == pytest.approx(expected, abs=1e-4)


def test_a_line_of_steps_of_second_order(tmp_path):
    """Faces at an angle, which cut steps at places that go with x, leave the derivative by x of second order."""
    text = (
        HEAD
        + """
    - m: {kind: Bend, length: 0.5, BendP: {angle_ref: 0.2, e1: 0.3, e2: 0.2}}
    - all: {kind: BeamLine, line: [begin, a: {kind: Drift, length: 0.2}, m, b: {kind: Drift, length: 0.4}]}
"""
    )
    file = written(tmp_path, text)
    steps = 2e-10, 1e-10, 5e-11
    h, drift = 0.4, [np.array([[1.0, length], [0, 1]]) for length in (0.2, 0.4)]
    c, s = np.cos(0.2), np.sin(0.2)
    sectors = np.array([[c, s / h], [-h * s, c]]), np.array([[1, 0.5], [0, 1]])
    expected = []
    for sign, sector in zip((1, -1), sectors, strict=True):
        entrance, exit = (np.array([[1, 0], [sign * h * np.tan(e), 1]]) for e in (0.3, 0.2))
        expected.append(drift[1] @ exit @ sector @ entrance @ drift[0])
    errors = []
    for dt in steps:
        found = matrix(tracked(file, dt))
        errors.append(max(np.abs(found[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] - expected[n]).max() for n in (0, 1)))
    assert errors[1] < 1e-4 and errors[2] < 3e-5, errors


def test_frames_turn_with_the_orbit():
    piece = pals.LatticePiece("m", "bend", length=1.0, angle=0.3, tilt=math.pi / 2)
    end = exit_of(START, piece)
    assert end.direction == pytest.approx((0, -math.sin(0.3), math.cos(0.3)))
    assert end.axes[0] == pytest.approx([1, 0, 0], abs=1e-15)
