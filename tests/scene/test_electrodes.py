"""Electrodes are values: voltages in units and as formulas of time, and what they refuse."""

import pickle

import pytest

from amrpic import Electrode, shapes
from amrpic.errors import InputError

BALL = shapes.Sphere((0, 0, 0), 1)


@pytest.mark.parametrize(
    "text, at, volts",
    [
        (3, 0, 3),
        ("5 kV", 1, 5000),
        ("5 kV*cos(2*pi*1e6*t)", 0.5e-6, -5000),
        ("5 kV*cos(2*pi*1 MHz*t) - 2 V", 1e-6, 4998),
        ("min(t/2 ns, 1)*1e3", 1e-9, 500),
        ("2*300", 7, 600),
    ],
)
def test_voltages_are_numbers_quantities_or_formulas_of_time(text, at, volts):
    electrode = Electrode("a", BALL, text)
    assert electrode.voltage_at(at) == pytest.approx(volts)
    assert electrode.varies == ("t" in str(text)) and not electrode.floats


def test_an_electrode_with_a_charge_floats():
    electrode = Electrode("a", BALL, charge="3 pC")
    assert electrode.floats and electrode.charge == 3e-12 and not electrode.varies
    with pytest.raises(InputError, match="electrode a floats"):
        electrode.voltage_at(0)


def test_electrodes_are_values():
    electrode = Electrode("a", BALL, "5 kV*cos(1e6*t)")
    assert pickle.loads(pickle.dumps(electrode)) == electrode != Electrode("a", BALL, 5)
    assert len({electrode, Electrode("a", BALL, "5 kV*cos(1e6*t)")}) == 1


@pytest.mark.parametrize(
    "name, shape, drive, sentence",
    [
        ("a b", BALL, {"voltage": 1}, "named 'a b'"),
        (3, BALL, {"voltage": 1}, "named 3"),
        ("a", (0, 0, 0), {"voltage": 1}, r"its shape is \(0, 0, 0\); give one of amrpic.shapes"),
        ("a", BALL, {}, "neither a voltage nor a charge"),
        ("a", BALL, {"voltage": 1, "charge": 1}, "both a voltage and a charge"),
        ("a", BALL, {"voltage": "5 kA"}, 'has the unit "kA"'),
        ("a", BALL, {"voltage": float("nan")}, "is not a finite potential"),
        ("a", BALL, {"voltage": "5*x"}, 'holds "x"'),
        ("a", BALL, {"voltage": "1/t"}, "is inf at t = 0 s"),
        ("a", BALL, {"voltage": "cos("}, "is no formula"),
        ("a", BALL, {"charge": "much"}, "is not a charge"),
        ("a", BALL, {"voltage": [1]}, "is not a potential"),
    ],
)
def test_mistakes_get_one_sentence(name, shape, drive, sentence):
    with pytest.raises(InputError, match=sentence) as refused:
        Electrode(name, shape, **drive)
    assert "\n" not in str(refused.value) and "; " in str(refused.value)
