"""Heat: its references, short runs, and that no heat is lost; longer runs are marked slow."""

import math

import numpy as np
import pytest

from fluidgym.scene import Box, Fluid, Material, Scene
from fluidgym.solver import Solver
from fluidgym.validation import heat, run
from fluidgym.validation.heat import ARCH, CASE, DIFFUSIVITY, SPEED, STEP, TIME_UNIT, TIMES, arch, step

# -- references ------------------------------------------------------------------------------------------------------


def test_the_step_spreads_as_in_the_literature():
    found = [float(step(np.array([0.75]), time)[0]) for time in TIMES]
    assert found == pytest.approx([0.21130, 0.42920, 0.57606, 0.68735, 0.74676], abs=6e-6)


def test_the_arch_solves_the_heat_equation():
    z, tiny = np.linspace(0.1, 0.9, 9), 1e-4
    rate = (arch(z, 0.1 + tiny) - arch(z, 0.1 - tiny)) / (2 * tiny)
    bend = (arch(z + 0.01, 0.1) - 2 * arch(z, 0.1) + arch(z - 0.01, 0.1)) / 0.01**2
    assert rate == pytest.approx(bend, rel=1e-4)
    assert arch(np.array([0.0, 0.5, 1.0]), 0.1) == pytest.approx([0.0, math.exp(-0.1 * math.pi**2), 0.0], abs=1e-15)


def test_the_references_themselves_have_no_error():
    place = np.tile(np.linspace(0.05, 0.95, 10), (len(TIMES) + 1, 1))
    times = TIME_UNIT * np.concatenate([[0.0], TIMES])
    for case, reference in ((ARCH, arch), (STEP, step)):
        temperature = np.array([reference(place[0], max(time, 0.01)) for time in times / TIME_UNIT])
        records = {"place": place, "temperature": temperature}
        (error,) = case.errors(times, records, case.scene(10, 2)).values()
        assert error == pytest.approx(0.0, abs=1e-12)
        (error,) = case.errors(times, records | {"temperature": temperature + 0.02}, case.scene(10, 2)).values()
        assert error == pytest.approx(0.02)


# -- runs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dim", "resolution", "particles"), [(2, 20, 100), (3, 10, 160)])
def test_heat_spreads_at_its_rate(dim, resolution, particles):
    result = run(CASE, resolution, dim, device="cpu")
    assert result.particles == particles
    assert result.errors["arch"] < {2: 0.002, 3: 0.01}[dim]
    assert result.errors["step"] < {2: 0.004, 3: 0.015}[dim]


@pytest.mark.parametrize("dim", [2, 3])
def test_a_fluid_that_only_conducts_stays_a_lattice(dim):
    solver = Solver(heat.step_scene(10, dim), device="cpu")
    start = solver.particles().position
    solver.advance(0.2 * TIME_UNIT)
    after = solver.particles()
    assert after.position == pytest.approx(start, abs=1e-6)
    assert after.velocity == pytest.approx(0.0, abs=1e-8)
    assert after.temperature is not None
    assert (np.diff(np.sort(after.temperature)) >= 0.0).all()
    assert 0.0 < after.temperature.min() < after.temperature.max() < 1.0


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_no_heat_passes_insulated_walls(jitter):
    scene = Scene(
        lower=(0.0, 0.0),
        upper=(1.0, 1.0),
        particle_spacing=0.05,
        fluid=[Fluid(Box((0.0, 0.0), (1.0, 1.0)), temperature=lambda points: 1.0 + np.cos(np.pi * points[:, 0]))],
        gravity=0.0,
        material=Material(thermal_diffusivity=DIFFUSIVITY),
        reference_speed=SPEED,
        jitter=jitter,
        seed=1,
    )
    solver = Solver(scene, device="cpu")
    before = solver.particles().temperature
    solver.advance(0.1 * TIME_UNIT)
    after = solver.particles()
    assert before is not None
    assert after.temperature is not None
    assert after.temperature.astype(float).sum() == pytest.approx(before.astype(float).sum(), rel=1e-5)
    exact = 1.0 + np.cos(np.pi * after.position[:, 0]) * math.exp(-0.1 * math.pi**2)
    assert after.temperature == pytest.approx(exact, abs=0.005 if jitter == 0.0 else 0.05)


@pytest.mark.slow
def test_the_arch_and_the_step_hold_at_eighty():
    result = run(CASE, 80, device="cpu")
    assert result.errors["arch"] < 0.0015
    assert result.errors["step"] < 0.0015
