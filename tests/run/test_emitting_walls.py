"""Walls that emit: currents of planar diodes against Child, Langmuir, Jory and Trivelpiece; laws of emission; restarts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy
from mpi4py import MPI
from test_births import ordered

from amrpic.errors import SceneError
from amrpic.pic.course import Course
from amrpic.pic.simulation import Simulation
from amrpic.pic.tallies import Tallies
from amrpic.pic.wall_layer import WallLayer
from amrpic.scene.scene import Scene
from amrpic.units import BOLTZMANN, ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from charges_in_motion import Ball, mirrored, total
from particle_cases import assert_same_bits

GAP = 1e-2  # m
PERVEANCE = 2.333952e-6  # A/V^(3/2): of Child and Langmuir's law, times the square of the gap over the area
COLD = 2e-6  # kT over e V, for which Langmuir's current is 1.00372 of Child's
Source = dict[str, Any]


def child(voltage: float) -> float:
    """Current density of Child and Langmuir's law, A/m²."""
    return PERVEANCE * voltage**1.5 / GAP**2


def diode(voltage: float, cells: int, source: Source, transits: float, across: int = 4, **changes: Any) -> Scene:
    """A planar diode, periodic across, with a source at its lower wall, for so many times of flight through it."""
    width, speed = GAP / cells, math.sqrt(2 * ELEMENTARY_CHARGE / ELECTRON_MASS * voltage)
    dt = width / speed / 1.5
    data: dict[str, Any] = {
        "domain": {
            "lower": [0, 0, 0],
            "upper": [across * width, across * width, GAP],
            "cells": [across, across, cells],
            "boundary": {"x": "periodic", "y": "periodic", "z": "dirichlet"},
            "potential": {"z": [0, voltage]},
        },
        "sources": [{"face": "z_lower", "momenta": warm(COLD, voltage), **source}],
        "solver": {"tolerance": 1e-6},
        "motion": {"kind": "leapfrog", "dt": dt, "frame": "lab"},
        "schedule": {"steps": int(transits * 3 * GAP / speed / dt)},
        "output": {"write": []},
    }
    return Scene.from_dict({**data, **changes})


WIDE = {
    "lower": 0,
    "upper": [GAP, GAP / 4, GAP],
    "cells": [16, 4, 16],
    "boundary": {"x": "periodic", "y": "periodic", "z": "dirichlet"},
    "potential": {"z": [0, 100.0]},
}


def warm(share: float, voltage: float) -> dict[str, Any]:
    """Momenta of a temperature kT that is a part of e V."""
    return {"kind": "thermal", "energy": f"{share * voltage} eV"}


def limited(voltage: float, supply: float = 4.0) -> Source:
    return {"process": "space-charge-limited", "supply": supply * child(voltage)}


def hot(voltage: float, share: float, supply: float) -> Source:
    """A thermionic wall that supplies a multiple of Child and Langmuir's current."""
    temperature = share * voltage * ELEMENTARY_CHARGE / BOLTZMANN
    work = BOLTZMANN * temperature * math.log(1.20173e6 * temperature**2 / (supply * child(voltage)))
    return {
        "process": "thermionic",
        "temperature": temperature,
        "work_function": work,
        "schottky": False,
        "per_face": 4,
        "momenta": None,
    }


def current(scene: Scene, comm: MPI.Comm = MPI.COMM_SELF) -> tuple[float, Simulation]:
    """Current density at the anode over the second half of a run, A/m², and the run."""
    run, rows = Simulation(comm, scene), []
    for state in run:
        arrived = state.lost.particles.select(np.flatnonzero(state.lost.cause == 5))
        rows.append((state.time, comm.allreduce(arrived.own_charge)))
    time, charge = np.array(rows[len(rows) // 2 :]).T
    area = np.prod(np.subtract(scene.domain.upper, scene.domain.lower)[:2])
    return float(-np.polyfit(time, charge, 1)[0] / area), run


def profile_error(run: Simulation, voltage: float) -> float:
    """Largest error of φ over V against that of a cold relativistic flow, dφ/dz ∝ (γ² - 1)^(1/4), with γ = 1 + s⁴ (γ_V - 1)."""
    s = np.linspace(0, 1, 2001)
    most = voltage * ELEMENTARY_CHARGE / (ELECTRON_MASS * SPEED_OF_LIGHT**2)
    place = scipy.integrate.cumulative_simpson(s**2 / (2 + most * s**4) ** 0.25, x=s, initial=0)
    z = np.linspace(0.02, 0.98, 49)
    middle = np.full(49, run.hierarchy.domain.upper[0] / 2)
    phi = run.phi.sample(np.column_stack([middle, middle, z * GAP]))
    return float(np.abs(phi / voltage - np.interp(z, place / place[-1], s**4)).max())


def test_a_diode_has_the_space_charge_limited_current():
    found, run = current(diode(100.0, 16, limited(100.0), 4.0))
    assert found / child(100.0) == pytest.approx(1.00372, rel=0.003)
    tally, lost = run.state.tallies.of[0], run.lost.particles.own_charge
    assert abs(run.particles.own_charge + lost - tally.charge) < 1e-13 * abs(tally.charge)


# Relativistic: Jory and Trivelpiece, J. Appl. Phys. 40, 3924 (1969), times 1.00372.
@pytest.mark.long
@pytest.mark.parametrize(
    ("voltage", "levels", "error"),
    [
        (100.0, 0, 3e-3),
        (100.0, 1, 1.5e-3),
        (100.0, 2, 8e-4),
        (1e5, 0, 3e-3),
        (1e5, 1, 3e-3),
        (5e5, 0, 3e-3),
        (5e5, 1, 3e-3),
    ],
)
def test_levels_at_the_cathode_make_its_profile_finer(voltage, levels, error):
    refinement = {"levels": levels, "regrid_every": 0, "blocking_factor": 4, "buffer": 0}
    refinement |= {"rule": {"kind": "emission", "depth": 4 * GAP / 32}} if levels else {}
    found, run = current(diode(voltage, 32, limited(voltage), 4.0, refinement=refinement))
    assert run.hierarchy.levels == 1 + levels
    slower = {100.0: 1.0, 1e5: 0.979909, 5e5: 0.913325}[voltage]
    assert found / child(voltage) == pytest.approx(slower * 1.00372, rel=0.003)
    assert profile_error(run, voltage) < error


@pytest.mark.mpi(ranks=(1, 2))
def test_the_field_along_a_wall_that_emits_is_zero_at_it(comm):
    """And linear up to the first centres, as that of a Gaussian ball and its image is; a mesh alone has that of the centres."""
    height, size, across = np.array([0.02, 0.1, 0.25, 0.4, 0.6]) * 1e-4, 3e-4, 4e-4
    kind = {"species": "electron", "charge": "-10 pC"}
    ball = {
        "distribution": "gaussian",
        "sigma": size,
        "centre": [0, 0, 12e-4],
        "cutoff": 3.9,
        "particles": 60_000,
        **kind,
    }
    places = np.column_stack([np.full(5, across), np.zeros(5), height])
    probes = {
        "distribution": "arrays",
        "species": "electron",
        "position": places,
        "momenta": 0 * places,
        "weight": np.ones(5),
    }
    scene = Scene.from_dict(
        {
            "domain": {
                "lower": [-12e-4, -12e-4, 0],
                "upper": [12e-4, 12e-4, 24e-4],
                "cells": 24,
                "boundary": {"x": "open", "y": "open", "z": ["dirichlet", "open"]},
            },
            "bunches": [{**ball, "sampling": "sobol"}, {**probes, "self_field": False}],
            "sources": [{"process": "space-charge-limited", "face": "z_lower", "supply": 1e-9}],
            "motion": {"kind": "leapfrog", "dt": 1e-16},
            "schedule": {"steps": 1},
            "output": {"write": []},
        }
    )
    run = Simulation(comm, scene)
    run.advance(1)
    found = ordered(comm, run)[-5:, 4] / (-ELEMENTARY_CHARGE * 1e-16)
    balls = [Ball(-10e-12, 12e-4, 0.0, size)]
    exact = total([*balls, *mirrored(balls, 0.0)], places)[0][:, 0]
    np.testing.assert_allclose(found, exact, rtol=0.03)


def layer_of(rule: dict[str, Any], **source: Any) -> list[np.ndarray]:
    """Boxes in m (n, 6) of each refined level at the start of a diode of 16³ cells, of 10 mm."""
    refinement = {"levels": 2, "blocking_factor": 2, "max_grid_size": 8, "buffer": 0, "nesting": 1, "rule": rule}
    scene = diode(100.0, 16, {**limited(100.0), **source}, 1.0, across=16, refinement=refinement)
    mesh = Simulation(MPI.COMM_SELF, scene).hierarchy
    return [
        np.concatenate([mesh.boxes(n)[:, :3], mesh.boxes(n)[:, 3:] + 1], axis=1) * GAP / 16 / 2**n
        for n in range(1, mesh.levels)
    ]


@pytest.mark.parametrize(
    ("rule", "depths"), [({"depth": "2.5 mm"}, (2.5e-3, 2.5e-3)), ({"cells": 8}, (2.5e-3, 1.25e-3))]
)
def test_a_layer_at_the_wall_is_refined_within_the_spot(rule, depths):
    spot = {"shape": "rectangle", "half_widths": [2.5e-3, 2.5e-3], "centre": [5e-3, 5e-3]}
    levels = layer_of({"kind": "emission", **rule}, spot=spot)
    for boxes, depth in zip(levels, depths, strict=True):
        assert boxes[:, 2].min() == 0 and boxes[:, 5].max() == pytest.approx(depth, abs=6.3e-4)
        assert boxes[:, :2].min() == pytest.approx(2.5e-3, abs=6.3e-4)
        assert boxes[:, 3:5].max() == pytest.approx(7.5e-3, abs=6.3e-4)


@pytest.mark.parametrize(
    ("rule", "words"), [({}, "is missing"), ({"depth": 1, "cells": 2}, "as well as"), ({"cells": 2}, "none does")]
)
def test_bad_rules_for_emission_are_refused_in_one_sentence(rule, words):
    sources: dict[str, Any] = {"sources": []} if words == "none does" else {}
    with pytest.raises(SceneError) as refused:
        diode(100.0, 8, limited(100.0), 1.0, refinement={"levels": 1, "rule": {"kind": "emission", **rule}}, **sources)
    assert words in str(refused.value) and "refinement.rule" in str(refused.value)


@pytest.mark.long
@pytest.mark.parametrize("share", [2e-4, 1e-3, 5e-3])
def test_a_warm_start_has_the_current_of_langmuir(share):
    exact = {2e-4: 1.0365, 1e-3: 1.0808, 5e-3: 1.1789}[share]
    scene = diode(100.0, 32, {**limited(100.0), "per_face": 4, "momenta": warm(share, 100.0)}, 4.0)
    assert current(scene)[0] / child(100.0) == pytest.approx(exact, rel=0.005)


@pytest.mark.long
@pytest.mark.parametrize(
    ("share", "supply", "exact", "error"),
    [
        (2e-4, 1.5, 1.0395, 0.01),
        (2e-4, 2.0, 1.0404, 0.01),
        (2e-4, 5.0, 1.0421, 0.01),
        (2e-3, 1.5, 1.1298, 0.022),
        (2e-3, 2.0, 1.1360, 0.022),
        (2e-3, 5.0, 1.1478, 0.022),
    ],
)
def test_a_supply_above_the_limit_is_turned_back_as_by_langmuir(share, supply, exact, error):
    """A virtual cathode, much thinner than a cell, holds back what is too much."""
    found, run = current(diode(100.0, 32, hot(100.0, share, supply), 5.0))
    assert found / child(100.0) == pytest.approx(exact, rel=error)
    assert (run.lost.cause == 4).sum() > 0.7 * (supply / exact - 1) * (run.lost.cause == 5).sum()


@pytest.mark.parametrize("per_face", [1, 2, 16])
def test_one_particle_per_face_is_enough_for_a_quiet_current(per_face):
    """The mean of what is born in a step is Langmuir's current, and it varies by less than 0.5 % from step to step."""
    run = Simulation(MPI.COMM_SELF, diode(100.0, 16, {**limited(100.0), "per_face": per_face}, 5.0))
    latest = [state.tallies.of[0].latest for state in run]
    born = np.array(latest[len(latest) * 3 // 4 :])
    area = np.prod(run.hierarchy.domain.upper[:2])
    assert -born.mean() / run._setup.dt / area / child(100.0) == pytest.approx(1.00372, rel=3e-3)
    assert born.std() / abs(born.mean()) < 0.005


def half_of_the_limit(cells: int, finer: int = 1) -> float:
    """Field at the cathode, V/d, late in a diode with half of the limit's current, which is 2/3 in the exact solution."""
    source = {"process": "given", "current": -0.5 * child(100.0) * (4 * GAP / cells) ** 2, "sampling": "sobol"}
    scene: Any = diode(100.0, cells, {**source, "per_step": 256 // finer, "momenta": {"kind": "cold"}}, 4.0)
    motion = {"kind": "leapfrog", "frame": "lab", "dt": scene.motion.dt * 2 / finer}
    run = Simulation(MPI.COMM_SELF, scene.replace(motion=motion, schedule={"steps": scene.schedule.steps * finer // 2}))
    fields = [-state.solution.layers[4].at_wall.mean() * GAP / 100.0 for state in run]
    return float(np.mean(fields[-2 * cells * finer :]))


def test_a_given_current_converges_in_cells():
    errors = [abs(half_of_the_limit(cells, 2) - 2 / 3) for cells in (8, 16, 32)]
    assert np.log2(errors[0] / errors[2]) / 2 > 1.8, errors


@pytest.mark.long
def test_a_given_current_converges_in_steps():
    fields = [half_of_the_limit(16, finer) for finer in (1, 2, 4)]
    assert np.log2((fields[0] - fields[1]) / (fields[1] - fields[2])) > 1.8, fields


def test_schottky_lowers_the_work_function():
    """The logarithm of the current goes with the root of the field: slope √(e³ / 4πε₀) / kT."""
    temperature, work = 1300.0, "1.6 eV"
    fields, charges = np.array([1e6, 4e6, 9e6]), []
    for field in fields:
        source = {"process": "thermionic", "temperature": temperature, "work_function": work, "momenta": None}
        scene = diode(field * GAP, 8, source, 1.0)
        run = Simulation(MPI.COMM_SELF, scene)
        run.advance()
        tally = run.state.tallies.of[0]
        charges.append(-tally.charge / run._setup.dt / np.prod(scene.domain.upper[:2]))
    slope = np.polyfit(np.sqrt(fields), np.log(charges), 1)[0]
    lowering = math.sqrt(ELEMENTARY_CHARGE**3 / (4 * math.pi * VACUUM_PERMITTIVITY))
    assert slope == pytest.approx(lowering / (BOLTZMANN * temperature), rel=1e-5)
    assert np.exp(np.log(charges[0]) - slope * 1e3) == pytest.approx(1.273e6, rel=2e-3)


def test_the_time_step_knows_what_is_not_born_yet():
    """From the passage of a cell at the speed that the voltage between outermost cells gives, and from a short pulse."""
    width, speed = GAP / 16, math.sqrt(2 * ELEMENTARY_CHARGE / ELECTRON_MASS * 100.0)
    auto = {"kind": "leapfrog", "dt": "auto", "frame": "lab"}
    run = Simulation(MPI.COMM_SELF, diode(100.0, 16, limited(100.0), 1.0, motion=auto))
    assert run._setup.dt == pytest.approx(width / speed / 1.5 / math.sqrt(15 / 16), rel=1e-3)
    pulse = {"shape": "flat", "length": "100 ps"}
    short = {"process": "given", "charge": -1e-15, "particles": 100, "pulse": pulse}
    assert Simulation(MPI.COMM_SELF, diode(100.0, 16, short, 1.0, motion=auto))._setup.dt == pytest.approx(2e-12)


def test_only_what_the_field_pulls_is_emitted():
    scene = diode(100.0, 8, {**limited(100.0), "face": "z_upper"}, 1.0)
    run = Simulation(MPI.COMM_SELF, scene)
    run.advance(5)
    assert run.state.tallies.of[0].particles == 0
    positive = Simulation(
        MPI.COMM_SELF, diode(100.0, 8, {**limited(100.0), "face": "z_upper", "species": "positron"}, 1.0)
    )
    positive.advance(5)
    assert positive.state.tallies.of[0].charge > 0


def test_a_spot_bounds_what_emits():
    width = 8 * GAP / 16
    spot = {"shape": "disc", "radius": width / 4, "centre": [width / 2, width / 2]}
    run = Simulation(MPI.COMM_SELF, diode(100.0, 16, {**limited(100.0), "spot": spot, "per_face": 40}, 1.0, across=8))
    run.advance(2)
    assert np.hypot(*(run.particles.position[:, :2] - width / 2).T).max() < width / 4 * 1.01
    area = np.pi * (width / 4) ** 2 / width**2
    whole = Simulation(MPI.COMM_SELF, diode(100.0, 16, limited(100.0), 1.0, across=8))
    whole.advance(1)
    one = Simulation(MPI.COMM_SELF, diode(100.0, 16, {**limited(100.0), "spot": spot, "per_face": 40}, 1.0, across=8))
    one.advance(1)
    assert one.state.tallies.of[0].charge == pytest.approx(area * whole.state.tallies.of[0].charge, rel=0.03)


@pytest.mark.parametrize("cells", [8, pytest.param(16, marks=pytest.mark.long)])
def test_a_pancake_takes_the_charge_that_shields_its_disc(cells):
    """ε₀ E π r², since in a pulse this short the charge stays within a thousandth of the radius in front of it."""
    radius, field = 1e-3, 2e7
    half, width = 1.5 * radius, radius / cells
    source = {
        "process": "photo", "face": "z_lower", "limit": "space-charge", "pulse": {"shape": "flat", "length": "1 ps"},
        "charge": -1.2e-9, "per_step": 9 * cells**2, "sampling": "sobol", "mean_transverse_energy": "0.1 eV",
        "spot": {"shape": "disc", "radius": radius}, "momenta": None,
    }  # fmt: skip
    domain = {
        "lower": [-half, -half, 0], "upper": [half, half, 48 * width], "cells": [3 * cells, 3 * cells, 48],
        "boundary": {"x": "periodic", "y": "periodic", "z": "dirichlet"}, "potential": {"z": [0, 48 * width * field]},
    }  # fmt: skip
    motion = {"kind": "leapfrog", "dt": 1e-13, "frame": "lab"}
    run = Simulation(MPI.COMM_SELF, diode(1.0, 8, source, 1.0, domain=domain, motion=motion))
    run.advance(12)
    assert -run.particles.own_charge == pytest.approx(0.55633e-9, rel=0.015)


@pytest.mark.mpi(ranks=(1, 2))
def test_what_is_given_can_be_limited_by_space_charge(comm):
    """A photo-cathode that is lit too brightly gives what a wall without a bound does."""
    width = (4 * GAP / 16) ** 2
    light = {"laser_energy": "1e-6 J", "photon_energy": "4.65 eV", "quantum_efficiency": 1e-3, "limit": "space-charge"}
    pulse = {"shape": "flat", "length": "100 ns"}
    bright = {"process": "photo", "momenta": warm(COLD, 100.0), "pulse": pulse, "particle_charge": None, **light}
    total = 1e-3 * 1e-6 / 4.65
    assert total / 100e-9 > 4 * child(100.0) * width
    bright["particle_charge"] = -total / 60000
    found, _ = current(diode(100.0, 16, bright, 4.0), comm)
    assert found / child(100.0) == pytest.approx(1.00372, rel=0.01)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("volts", [-30.0, 5.0])
def test_a_grid_that_swings_acts_on_a_wall_as_one_of_the_voltage_of_the_moment(comm, volts):
    """A wire in front of the wall, whose field is solved for apart from that of charge where its voltage depends on time."""
    shape = {"kind": "cylinder", "start": [5e-3, -1, 3e-3], "end": [5e-3, 1, 3e-3], "radius": 1e-3}
    born = []
    for voltage in (volts, f"{volts} V*cos(0*t)"):
        electrodes = [{"name": "grid", "shape": shape, "voltage": voltage}]
        run = Simulation(comm, diode(100.0, 16, limited(100.0), 1.0, electrodes=electrodes, domain=WIDE))
        run.advance(30)
        born.append(run.state.tallies.of[0].charge)
    assert born[1] == pytest.approx(born[0], rel=1e-6)


@pytest.mark.mpi(ranks=(2, 4), timeout=600)
def test_emission_is_the_same_on_any_ranks(comm):
    refinement: dict[str, Any] = {"levels": 1, "blocking_factor": 4, "regrid_every": 5}
    refinement |= {"rule": {"kind": "charge-density", "relative": 0.1}}
    scene = diode(100.0, 16, limited(100.0), 2.0, refinement=refinement, solver={"tolerance": 1e-12})
    together, alone = Simulation(comm, scene), Simulation(MPI.COMM_SELF, scene)
    together.advance(50), alone.advance(50)
    one, many = ordered(MPI.COMM_SELF, alone), ordered(comm, together)
    np.testing.assert_array_equal(many[:, 0], one[:, 0])
    for column in range(1, 8):
        scale = np.abs(one[:, column]).max()
        np.testing.assert_allclose(many[:, column], one[:, column], rtol=0, atol=1e-10 * scale)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("source", [limited(100.0), hot(100.0, 1e-3, 3.0)])
def test_a_restart_goes_on_bit_by_bit(comm, tmp_path, source):
    folder = comm.bcast(tmp_path)
    whole = Simulation(comm, diode(100.0, 16, source, 1.0, solver={"tolerance": "discretization"}))
    whole.advance(20)
    whole.checkpoint(folder / "half")
    rest = Simulation.restart(comm, folder / "half")
    whole.advance(20), rest.advance(20)
    assert_same_bits(rest.particles, whole.particles)
    assert rest.state.tallies == whole.state.tallies


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ({"plane": {}, "face": None, "spot": {"shape": "disc", "radius": 1}}, "no field that decides"),
        ({"face": "x_lower"}, "is periodic"),
        ({"spot": {"shape": "gaussian", "sigma": [1, 1]}}, "unknown shape"),
        ({"per_face": 0}, "per_face"),
        ({"supply": 0}, "supply"),
        ({"start": 1, "stop": 0}, "is not after start"),
        ({"process": "thermionic", "supply": None, "work_function": "2 eV"}, "temperature"),
        ({"process": "field", "supply": None}, "work_function"),
    ],
)
def test_bad_walls_are_refused_in_one_sentence(source, words):
    given = {key: value for key, value in {**limited(100.0), **source}.items() if value is not None or key in source}
    given = {key: value for key, value in given.items() if not (key == "supply" and value is None)}
    with pytest.raises(SceneError) as refused:
        diode(100.0, 8, given, 1.0)
    text = str(refused.value)
    assert words in text and "sources.0" in text and "; " in text and "\n" not in text


def test_walls_emit_in_second_order_alone():
    with pytest.raises(SceneError, match=r"solver\.order"):
        diode(100.0, 8, limited(100.0), 1.0, solver={"order": 4})


@pytest.mark.long
@pytest.mark.parametrize(("part", "exact"), [(0.25, 3.1091), (0.5, 1.7434)])
def test_a_short_pulse_has_the_limit_of_the_sheet_model(part, exact):
    """A uniform pulse of a part of the time of flight, of which the field at the cathode falls to zero at its end."""
    cells, fields, currents = 32, [], exact * np.array([0.93, 0.99])
    speed = math.sqrt(2 * ELEMENTARY_CHARGE / ELECTRON_MASS * 100.0)
    steps = int(part * 3 * cells * 1.5)
    for multiple in currents:
        amount = -multiple * child(100.0) * (4 * GAP / cells) ** 2
        source = {"process": "given", "current": amount, "per_step": 64, "momenta": {"kind": "cold"}}
        motion = {"kind": "leapfrog", "dt": part * 3 * GAP / speed / steps, "frame": "lab"}
        run = Simulation(MPI.COMM_SELF, diode(100.0, cells, source, 1.0, motion=motion))
        run.advance(steps)
        fields.append(run.state.solution.layers[4].at_wall.mean())
    slope = (fields[1] - fields[0]) / (currents[1] - currents[0])
    assert currents[1] - fields[1] / slope == pytest.approx(exact, rel=0.01)


@pytest.mark.long
def test_fast_charge_in_bins_of_its_own_leaves_the_field_at_the_wall_zero(tmp_path):
    """A gun of 50 kV with open sides: slow charge rests in the laboratory, fast charge has images that move against it."""
    scene = Scene.from_dict(
        {
            "domain": {
                "lower": [-8e-3, -8e-3, 0],
                "upper": [8e-3, 8e-3, GAP],
                "cells": [16, 16, 32],
                "boundary": {"x": "open", "y": "open", "z": "dirichlet"},
                "potential": {"z": [0, 5e4]},
            },
            "sources": [
                {
                    "face": "z_lower",
                    **limited(5e4, 10.0),
                    "spot": {"shape": "disc", "radius": "3 mm"},
                    "momenta": warm(COLD, 5e4),
                }
            ],
            "motion": {"kind": "leapfrog", "dt": "2 ps"},
            "schedule": {"steps": 160},
            "output": {"write": []},
        }
    )
    whole = Simulation(MPI.COMM_SELF, scene)
    whole.advance(140)
    assert len(whole.state.solution.frames.members) > 1 and whole.state.solution.images is not None
    layer = whole.state.solution.layers[4]
    assert isinstance(layer, WallLayer)
    inside = np.hypot(*layer.columns.centre[:, :2].T) < 2e-3
    assert np.abs(layer.at_wall[inside]).mean() < 0.03 * 5e4 / GAP
    whole.checkpoint(tmp_path / "late")
    rest = Simulation.restart(MPI.COMM_SELF, tmp_path / "late")
    whole.advance(5), rest.advance(5)
    np.testing.assert_array_equal(rest.particles.position, whole.particles.position)


def gun(**changes: Any) -> Scene:
    """A photo-cathode in 80 MV/m, of which the window leaves with the bunch while it is still emitting."""
    data: dict[str, Any] = {
        "domain": {
            "lower": [-2e-3, -2e-3, 0],
            "upper": [2e-3, 2e-3, 4e-3],
            "cells": [16, 16, 32],
            "boundary": {"x": "open", "y": "open", "z": ["dirichlet", "open"]},
        },
        "sources": [
            {
                "process": "photo",
                "face": "z_lower",
                "spot": {"shape": "disc", "radius": "0.5 mm"},
                "pulse": {"shape": "plateau", "width": "2 ps", "rise": "0.3 ps"},
                "mean_transverse_energy": "0.5 eV",
                "charge": "-20 pC",
                "particles": 4000,
            }
        ],
        "elements": [{"kind": "uniform", "electric_field": [0, 0, "-80 MV/m"]}],
        "refinement": {"levels": 1, "rule": {"kind": "charge-density", "relative": 0.05}},
        "motion": {
            "kind": "leapfrog",
            "dt": "0.25 ps",
            "window": "reference",
            "energy_bins": 4,
            "reference": {"species": "electron", "position": [0, 0, 1e-6], "momentum": [0, 0, "1 keV/c"]},
        },
        "schedule": {"steps": 120},
        "output": {"write": []},
    }
    return Scene.from_dict({**data, **changes})


@pytest.mark.mpi(ranks=1, more=(2,), timeout=600)
def test_window_bins_and_levels_go_together_with_a_source(comm, tmp_path):
    """Restarted amid emission bit by bit, no charge lost from sight, and the wall left behind as a mirror."""
    folder = comm.bcast(tmp_path)
    whole = Simulation(comm, gun())
    whole.advance(12)
    whole.checkpoint(folder / "amid")
    assert not whole.state.solution.frames.leaves  # the wall that still emits is a face of the mesh
    assert 0 < whole.state.tallies.of[0].particles < 4000
    rest = Simulation.restart(comm, folder / "amid")
    whole.advance(38), rest.advance(38)
    assert len(whole.state.solution.frames.members) > 1 and whole.hierarchy.levels == 2
    whole.advance(50), rest.advance(50)
    assert_same_bits(rest.particles, whole.particles)
    tally = whole.state.tallies.of[0]
    kept = whole.particles.total_charge(comm) + whole.lost.particles.total_charge(comm)
    assert tally.particles == 4000 and abs(kept - tally.charge) < 1e-13 * abs(tally.charge)
    assert whole.window.origin[2] > 0 and whole.state.solution.frames.leaves


def test_a_checkpoint_of_an_earlier_version_goes_on_the_same_way(tmp_path, monkeypatch):
    """It has neither maps of sources nor when the window may leave."""
    whole = Simulation(MPI.COMM_SELF, gun())
    whole.advance(8)
    course, tallies = whole.state.course.to_dict(), whole.state.tallies.to_list()
    earlier = {key: value for key, value in course.items() if key not in ("stride", "start", "stays")}
    monkeypatch.setattr(Course, "to_dict", lambda _: earlier)
    without = [{key: value for key, value in tally.items() if key != "map"} for tally in tallies]
    monkeypatch.setattr(Tallies, "to_list", lambda _: without)
    whole.checkpoint(tmp_path / "earlier")
    rest = Simulation.restart(MPI.COMM_SELF, tmp_path / "earlier")
    assert rest.state.course == whole.state.course
    assert any("maps of what sources gave begin at the checkpoint" in remark for remark in rest.remarks)
    whole.advance(4), rest.advance(4)
    np.testing.assert_array_equal(rest.particles.position, whole.particles.position)
    assert rest.state.tallies.of[0].charge == whole.state.tallies.of[0].charge


@pytest.mark.parametrize("late", ["0 s", "15 ps"])
def test_the_window_rests_until_the_last_birth_of_a_file(tmp_path, late):
    """Without a delay until the reference particle is in the middle."""
    file = tmp_path / "births.ini"
    table = np.zeros((50, 10))
    table[:, 5], table[:, 6], table[:, 7], table[:, 9] = 1000.0, np.linspace(0, 8e-3, 50), -1e-9, -1
    table[1:, 5] -= 1000.0
    np.savetxt(file, table)
    source = {"process": "file", "file": str(file), "face": "z_lower", "delay": late}
    motion = {**gun().motion.model_dump(), "dt": "0.5 ps"}
    run = Simulation(MPI.COMM_SELF, gun(sources=[source], motion=motion, refinement={"levels": 0}))
    assert run.state.course.stays == pytest.approx(8e-12 + 1e-12 * float(late.split()[0]))
    run.advance(50)
    assert run.state.tallies.of[0].particles == 50 and not any("outside" in remark for remark in run.remarks)
    assert run.window.origin[2] > 0


@pytest.mark.long
def test_a_window_that_leaves_the_cathode_behind_has_the_bunch_of_a_long_mesh():
    domain = gun().domain.model_dump()
    long = {**domain, "upper": [2e-3, 2e-3, 1.2e-2], "cells": [16, 16, 96]}
    motion = gun().motion.model_dump()
    one = Simulation(MPI.COMM_SELF, gun())
    other = Simulation(MPI.COMM_SELF, gun(domain=long, motion={**motion, "window": "none", "reference": None}))
    one.advance(100), other.advance(100)
    here, there = (run.state.moments() for run in (one, other))
    assert one.window.origin[2] > 5e-4
    np.testing.assert_allclose(here.rms, there.rms, rtol=1e-4)


@pytest.mark.long
def test_charge_is_balanced_to_rounding_over_ten_thousand_steps():
    run = Simulation(MPI.COMM_SELF, diode(100.0, 8, {**limited(100.0), "per_face": 1}, 1.0, schedule={"steps": 10000}))
    run.advance(10000)
    tally, lost = run.state.tallies.of[0], run.lost.particles.own_charge
    assert abs(run.particles.own_charge + lost - tally.charge) < 1e-13 * abs(tally.charge)
