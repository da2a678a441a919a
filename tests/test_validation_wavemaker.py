"""The wavemaker: its reference, how waves are measured, and a short run; longer ones are marked slow."""

import math

import numpy as np
import pytest

from fluidgym.scene import Particles, Scene
from fluidgym.solver import Solver
from fluidgym.validation import run, wavemaker
from fluidgym.validation.wavemaker import (
    CASE,
    CASES,
    DEPTH,
    FAR,
    GRAVITY,
    LENGTH,
    NEAR,
    PERIODS,
    SAMPLES,
    STROKE,
    amplitude,
    elevation,
    gauge_places,
    height_over_stroke,
    piston_velocity,
    wave_number,
)

# -- reference -------------------------------------------------------------------------------------------------------


def test_linear_theory_is_that_of_the_literature():
    periods = [1.0, 1.5, 2.0]
    assert [wave_number(period) for period in periods] == pytest.approx([4.15285, 2.22298, 1.54895], abs=6e-6)
    assert [height_over_stroke(period) for period in periods] == pytest.approx([1.71423, 1.08205, 0.76897], abs=6e-6)


def test_the_piston_keeps_to_its_stroke():
    times = np.linspace(0.0, 10.0, 20001)
    velocity = [piston_velocity(time, 1.0) for time in times]
    place = np.concatenate([[0.0], np.cumsum(np.diff(times) * 0.5 * np.add(velocity[1:], velocity[:-1]))])
    assert np.abs(place[:2000]).max() < 0.1 * STROKE  # it starts gently
    assert place[times > 3.0].max() == pytest.approx(0.5 * STROKE, rel=1e-4)
    assert place[times > 3.0].min() == pytest.approx(-0.5 * STROKE, rel=1e-4)


def linear_waves(times: np.ndarray, period: float) -> np.ndarray:
    """Elevation at the gauges by the linear theory of the tank itself, its waves as a sum over cosines (n, gauge).

    Green's identity of the potential with cosh(k (z + d)) cos(k x) gives for each, with the piston's velocity U,

        d eta/dt = k tanh(kd) phi + tanh(kd)/k U        d phi/dt = -g eta        at the surface.
    """
    gauges = gauge_places(period)
    k = math.pi * np.arange(1, 300) / gauges[-1]
    surface = np.tanh(k * DEPTH)
    blur = np.sinc(k * gauges[1] / (2.0 * math.pi)) ** 2  # a gauge is a hat as wide as two of its neighbours' distances
    shapes = 2.0 / gauges[-1] * blur[:, None] * np.cos(np.outer(k, gauges))
    eta, phi, level, found, now = np.zeros(len(k)), np.zeros(len(k)), 0.0, [], 0.0
    for time in times:
        n = 25
        dt = (time - now) / n
        for step in range(n):
            velocity = piston_velocity(now + (step + 0.5) * dt, period)
            phi -= 0.5 * dt * GRAVITY * eta
            eta += dt * (k * surface * phi + surface / k * velocity)
            phi -= 0.5 * dt * GRAVITY * eta
            level += dt * velocity * DEPTH / gauges[-1]
        now = time
        found.append(level + eta @ shapes)
    return np.array(found)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_waves_of_linear_theory_have_hardly_an_error(case):
    period = float(case.times[0]) * SAMPLES
    waves = linear_waves(case.times, period)
    found = case.errors(case.times, {"elevation": waves}, case.scene(25, 2))
    assert found["height"] == pytest.approx(0.0, abs=0.003)
    assert found["decay"] == pytest.approx(0.0, abs=0.003)
    assert found["wavelength"] == pytest.approx(0.0, abs=0.003)


# -- measuring -------------------------------------------------------------------------------------------------------


def water(scene: Scene, shift: float = 0.0) -> Particles:
    """The start of a scene, moved along x by a share of the spacing, at rest density."""
    start = scene.sample()
    position = start.position + np.array([shift * scene.particle_spacing, 0.0])
    return Particles(position, start.velocity, start.density, start.pressure, start.identity)


def test_still_water_has_no_waves():
    scene, gauges = CASE.scene(25, 2), gauge_places(1.0)
    times = np.arange(2 * SAMPLES) / SAMPLES
    # It drifts by a spacing a period, so that its lattice passes under the gauges in time with the waves looked for.
    still = np.array([elevation(water(scene, time), scene, gauges) for time in times])
    assert np.abs(still[:, 2:-2]).max() < 0.3 * scene.particle_spacing  # one gauge; the lattice beats with it
    for place in (NEAR, FAR):
        assert abs(amplitude(times, still, 1.0, place)) < 1e-3 * scene.particle_spacing


def test_a_wave_far_below_the_spacing_is_found():
    scene, gauges, k = CASE.scene(25, 2), gauge_places(1.0), wave_number(1.0)
    times = np.arange(2 * SAMPLES) / SAMPLES
    a, phase = 0.1 * scene.particle_spacing, 0.7
    rows = []
    for time in times:
        start = water(scene)
        x, z = start.position.T
        moved = -a * np.cosh(k * z) / np.sinh(k * DEPTH) * np.sin(k * x - 2.0 * np.pi * time + phase)
        position = np.stack([x + moved, z], axis=1)  # what a gauge measures is in the horizontal shift alone
        rows.append(elevation(Particles(position, start.velocity, start.density, start.pressure, start.identity),
                              scene, gauges))  # fmt: skip
    for place in (NEAR, FAR):
        assert abs(amplitude(times, np.array(rows), 1.0, place)) == pytest.approx(a, rel=0.01)


def test_a_run_that_breaks_down_has_no_surface():
    scene = CASE.scene(10, 2)
    start = water(scene)
    start.position[5, 0] = np.nan
    assert np.isnan(elevation(start, scene, gauge_places(1.0))).all()


def test_only_waves_that_run_away_from_the_piston_count():
    k, gauges, times = wave_number(1.0), gauge_places(1.0), np.arange(2 * SAMPLES) / SAMPLES
    blur = np.sinc(1.0 / wavemaker.GAUGES) ** 2
    angle = 2.0 * np.pi * times[:, None]
    waves = blur * (0.02 * np.cos(k * gauges - angle) + 0.015 * np.cos(k * gauges + angle + 1.0)) + 0.003
    waves += 0.004 * np.cos(2.0 * (k * gauges - angle))  # its second harmonic
    for place in (NEAR, FAR):
        assert amplitude(times, waves, 1.0, place) == pytest.approx(0.02, rel=1e-9)


# -- runs ------------------------------------------------------------------------------------------------------------


def test_a_coarse_piston_makes_waves_of_about_the_right_height():
    result = run(CASE, 12, device="cpu", end=10.0)
    assert set(result.errors) == {"height"}  # the rest takes a full run
    assert abs(result.errors["height"]) < 0.08
    waves = result.records["elevation"]
    assert waves.shape == (10 * SAMPLES + 1, round(LENGTH * wavemaker.GAUGES) + 1)
    steepest = np.abs(waves[-1] - waves[0]).max()
    assert 0.3 * 1.7 * STROKE < 2.0 * steepest < 2.0 * 1.7 * STROKE


def test_the_piston_follows_its_velocity():
    period = 1.0
    solver = Solver(CASE.scene(8, 2), CASE.scheme, device="cpu")
    assert CASE.drive is not None
    while solver.time[0] < 3.25 * period - 1e-9:
        CASE.drive(solver, float(solver.time[0]) + 0.025 * period)
        solver.advance(0.025 * period)
    assert solver.face_position("x_min")[0] == pytest.approx(0.5 * STROKE, rel=0.01)  # a quarter period on


def test_a_run_that_ends_too_soon_has_no_height():
    result = run(CASE, 8, device="cpu", end=0.5)
    assert math.isnan(result.errors["height"])


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_waves_keep_their_height(case):
    result = run(case, 25, device="cpu")
    period = SAMPLES * float(case.times[0])
    assert case.end == pytest.approx(PERIODS[period] * period)
    assert result.passed, result.errors
    assert abs(result.errors["wavelength"]) < 0.02
