"""Scripts of PICMI: electrostatic runs by exchanging the import; skipped where picmistandard is missing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from amrpic.errors import InputError
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, VACUUM_PERMITTIVITY

RADIUS, DENSITY = 0.1, 6e11  # m, 1/m³


@pytest.fixture
def picmi(tmp_path, monkeypatch) -> Any:
    pytest.importorskip("picmistandard")
    monkeypatch.chdir(tmp_path)
    from amrpic import picmi

    return picmi


def sphere(picmi: Any, steps: int, cells: int = 32, number: int = 2**16) -> Any:
    """Electrons that fill a ball evenly and are at rest, as in WarpX's example of an electrostatic sphere."""
    grid = picmi.Cartesian3DGrid(
        number_of_cells=[cells] * 3,
        lower_bound=[-0.5] * 3,
        upper_bound=[0.5] * 3,
        lower_boundary_conditions=["open"] * 3,
        upper_boundary_conditions=["open"] * 3,
        lower_boundary_conditions_particles=["absorbing"] * 3,
        upper_boundary_conditions_particles=["absorbing"] * 3,
        warpx_max_grid_size=64,
    )
    distribution = picmi.AnalyticDistribution(
        density_expression="n0 * (x*x + y*y + z*z < R0*R0)",
        n0=DENSITY,
        R0=RADIUS,
        lower_bound=[-RADIUS] * 3,
        upper_bound=[RADIUS] * 3,
    )
    electrons = picmi.Species(particle_type="electron", name="electrons", initial_distribution=distribution)
    simulation = picmi.Simulation(
        solver=picmi.ElectrostaticSolver(grid=grid, method="Multigrid", required_precision=1e-8),
        time_step_size=1e-9,
        max_steps=steps,
        verbose=0,
        particle_shape="linear",
        amrpic_levels=2,
        warpx_serialize_initial_conditions=True,
    )
    simulation.add_species(electrons, layout=picmi.PseudoRandomLayout(n_macroparticles=number))
    simulation.add_diagnostic(picmi.ParticleDiagnostic(name="end", period=steps, species=[electrons]))
    return simulation


def test_a_sphere_of_electrons_expands_as_it_should(picmi):
    """R'' = Q q / (4πε₀ m R²)."""
    steps = 60
    simulation = sphere(picmi, steps)
    start = simulation.run_of_scene().particles.position
    before = np.sqrt((start**2).sum(axis=1).mean())
    simulation.step(steps)
    run = simulation.run_of_scene()
    assert run.step == steps
    charge = DENSITY * ELEMENTARY_CHARGE * 4 / 3 * np.pi * RADIUS**3
    strength = charge * ELEMENTARY_CHARGE / (4 * np.pi * VACUUM_PERMITTIVITY * ELECTRON_MASS)
    radius = solve_ivp(lambda _, r: [r[1], strength / r[0] ** 2], (0, run.time), [RADIUS, 0], rtol=1e-10, atol=1e-15).y[
        0, -1
    ]
    after = np.sqrt((run.particles.position**2).sum(axis=1).mean())
    assert radius > 1.5 * RADIUS
    assert after / before == pytest.approx(radius / RADIUS, rel=5e-3)


def test_a_script_writes_its_scene(picmi, tmp_path):
    sphere(picmi, 2, number=2**8).write_input_file("sphere.toml")
    assert "leapfrog" in (tmp_path / "sphere.toml").read_text(encoding="utf-8")


def test_distributions_of_picmi_have_their_charge(picmi):
    grid = sphere(picmi, 1).solver.grid
    number = 1000
    for distribution, expected in (
        (picmi.GaussianBunchDistribution(n_physical_particles=1e9, rms_bunch_size=[0.01] * 3), 1e9),
        (picmi.UniformDistribution(density=1e9, lower_bound=[-0.1] * 3, upper_bound=[0.1, 0.1, 0.3]), 1.6e7),
        (picmi.ParticleListDistribution(x=[0.0, 0.1], y=[0.0, 0.0], z=[0.0, 0.0], weight=[2.0, 3.0]), 5.0),
    ):
        species = picmi.Species(particle_type="proton", name="p", initial_distribution=distribution)
        simulation = picmi.Simulation(solver=picmi.ElectrostaticSolver(grid=grid), time_step_size=1e-9, max_steps=1)
        simulation.add_species(species, layout=picmi.PseudoRandomLayout(n_macroparticles=number))
        (bunch,) = simulation.scene().bunches
        assert bunch.weight.sum() == pytest.approx(expected)


def test_what_is_not_there_is_refused(picmi):
    simulation = sphere(picmi, 1)
    simulation.time_step_size = None
    with pytest.raises(InputError, match="time_step_size"):
        simulation.scene()
    grid = picmi.Cartesian3DGrid(
        number_of_cells=[8] * 3,
        lower_bound=[0] * 3,
        upper_bound=[1] * 3,
        lower_boundary_conditions=["absorbing"] * 3,
        upper_boundary_conditions=["open"] * 3,
    )
    other = picmi.Simulation(solver=picmi.ElectrostaticSolver(grid=grid), time_step_size=1e-9, max_steps=1)
    with pytest.raises(InputError, match="boundary along x"):
        other.scene()


@pytest.mark.parametrize(
    "expression, expected",
    [
        ("n0 * (x*x + y^2 < 1)", [2.0, 0.0]),
        ("n0 * (-1 < x <= 1) * z", [6.0, 0.0]),
        ("where(x > 1 and y == 3, 5, pi)", [np.pi, 5.0]),
        ("n0", [2.0, 2.0]),
    ],
)
def test_expressions_compare_and_choose(picmi, expression, expected):
    places = np.array([[0.0, 0.5, 3.0], [2.0, 3.0, 4.0]])
    assert picmi._values(expression, places, {"n0": 2.0}) == pytest.approx(expected)


@pytest.mark.parametrize(
    "expression, what",
    [("__import__('os')", "no value"), ("n1 * x", "'n1' is unknown"), ("x.T", "no value"), ("x +", "no value")],
)
def test_what_is_no_expression_is_refused(picmi, expression, what):
    with pytest.raises(InputError, match=what):
        picmi._values(expression, np.zeros((2, 3)), {})
