"""The standing wave: its references, how it is measured, its start, and coarse runs; finer ones are marked slow."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from fluidgym.solver import Solver
from fluidgym.validation import run
from fluidgym.validation.case import rms
from fluidgym.validation.standing_wave import (
    AMPLITUDE,
    CASE,
    DENSITY,
    DEPTH,
    GRAVITY,
    HARMONICS,
    PERIOD,
    REYNOLDS,
    SPEED,
    VISCOUS,
    VISCOUS_AMPLITUDE,
    VISCOUS_PERIODS,
    frequency_ratio,
    lamb_root,
    linear_omega,
    observe,
    oscillation,
    viscous_wave,
)

# -- reference -------------------------------------------------------------------------------------------------------


def test_linear_theory_has_the_numbers_of_the_literature():
    assert pytest.approx(1.13392, abs=5e-6) == PERIOD
    k = 2.0 * math.pi  # wavelength and depth of 1 m
    assert linear_omega(k) == pytest.approx(7.85096, abs=5e-6)
    factors = [math.exp(-2.0 * SPEED / re * k**2 * 2.0 * math.pi / linear_omega(k)) for re in REYNOLDS]
    assert factors == pytest.approx([0.4531, 0.6731, 0.9239], abs=6e-5)


def test_finite_height_slows_deep_waves_and_hastens_shallow_ones():
    k, square = 10.0 * math.pi, 1e-4
    assert frequency_ratio(k, square) == pytest.approx(1.0 - k**2 * square / 8.0, rel=1e-9)  # Rayleigh's
    # The depth at which the correction changes its sign, of Tadjbakhsh & Keller: kH = 1.058.
    assert frequency_ratio(1.04, square) > 1.0 > frequency_ratio(1.08, square)


def potential_flow(times: np.ndarray, k: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Waves of any height from level water: harmonics of the surface [m] (n, harmonic) and kinetic energy [J/m] (n,).

    The potential is a sum of b_m cosh(mkz)/cosh(mkH) cos(mkx), fitted to its values at points of the surface; surface
    and potential there advance by the conditions at a free surface. Classical Runge-Kutta method.
    """
    points, modes, dt = 40, 10, 0.008
    x = (np.arange(points) + 0.5) * math.pi / k / points
    m = k * np.arange(modes)[:, None]
    cosine, sine = np.cos(m * x), np.sin(m * x)

    def harmonics(values: np.ndarray) -> np.ndarray:
        found = 2.0 * (values * cosine).mean(axis=1)
        found[0] *= 0.5
        return found

    def rate(state: np.ndarray) -> np.ndarray:
        surface, potential = state
        slope = -(harmonics(surface) * m[:, 0]) @ sine
        up, down, whole = np.exp(m * surface), np.exp(-m * (2.0 * DEPTH + surface)), 1.0 + np.exp(-2.0 * m * DEPTH)
        wave = (up + down) / whole * cosine
        b = np.linalg.lstsq(wave.T, potential, rcond=None)[0]
        u, w = -(b * m[:, 0]) @ ((up + down) / whole * sine), (b * m[:, 0]) @ ((up - down) / whole * cosine)
        rise = w - u * slope
        return np.stack([rise, -GRAVITY * surface - 0.5 * (u**2 + w**2) + w * rise])

    def observed(state: np.ndarray) -> tuple[np.ndarray, float]:
        work = float(np.mean(state[1] * rate(state)[0]))  # int phi dphi/dn along the surface
        return harmonics(state[0])[1 : HARMONICS + 1], 0.5 * DENSITY * math.pi / k * work

    state = np.stack([np.zeros(points), height * GRAVITY / linear_omega(k) * np.cos(k * x)])
    found = [observed(state)]
    for start, end in itertools.pairwise(times):
        steps = math.ceil((end - start) / dt)
        h = (end - start) / steps
        for _ in range(steps):
            k1 = rate(state)
            k2 = rate(state + 0.5 * h * k1)
            k3 = rate(state + 0.5 * h * k2)
            k4 = rate(state + h * k3)
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            state = np.stack([harmonics(values) @ cosine for values in state])
        found.append(observed(state))
    surface, kinetic = zip(*found, strict=True)
    return np.array(surface), np.array(kinetic)


@pytest.fixture(scope="module")
def exact():
    """Potential flow from the start of the case, three periods of it: instants [s] and records."""
    times = np.concatenate([[0.0], CASE.times[CASE.times <= 3.001 * PERIOD]])
    surface, kinetic = potential_flow(times, math.pi, AMPLITUDE)
    return times, {"elevation": surface, "kinetic": kinetic}


def test_potential_flow_has_hardly_an_error(exact):
    times, records = exact
    errors = CASE.errors(times, records, CASE.scene(25, 2))
    assert errors["period"] == pytest.approx(0.0, abs=5e-4)
    assert errors["linear"] == pytest.approx(0.0124, abs=5e-4)
    assert errors["loss"] == pytest.approx(0.0, abs=5e-4)


def test_errors_are_what_they_are_said_to_be(exact):
    times, records = exact
    scene = CASE.scene(25, 2)
    before = CASE.errors(times, records, scene)
    slow = CASE.errors(1.004 * times, records, scene)
    assert (1.0 + slow["period"]) / (1.0 + before["period"]) == pytest.approx(1.004, abs=1e-5)
    fade = np.exp(-0.5 * 0.03 * times / PERIOD)  # of its height; of its energy 3 % a period
    faded = {"elevation": records["elevation"] * fade[:, None], "kinetic": records["kinetic"] * fade**2}
    after = CASE.errors(times, faded, scene)
    assert after["loss"] - before["loss"] == pytest.approx(1.0 - math.exp(-0.03), abs=1e-4)
    assert after["period"] == pytest.approx(
        before["period"], abs=6e-4
    )  # shorter waves go faster, less than a thousandth


def test_a_run_that_breaks_down_or_ends_too_soon_has_no_errors(exact):
    times, records = exact
    scene = CASE.scene(25, 2)
    early = {name: values[:30] for name, values in records.items()}
    assert all(math.isnan(error) for error in CASE.errors(times[:30], early, scene).values())
    broken = {name: values.copy() for name, values in records.items()}
    broken["elevation"][-1] = broken["kinetic"][-1] = math.nan
    assert all(math.isnan(error) for error in CASE.errors(times, broken, scene).values())


def test_the_fit_finds_a_sine_that_decays():
    times = np.linspace(0.0, 6.0, 200)
    values = 0.3 * np.exp(-0.2 * times) * np.sin(5.6 * times + 0.4)
    assert oscillation(times, values, 5.5) == pytest.approx((5.6, 0.2), rel=1e-9)
    noise = np.random.default_rng(1).normal(size=200)
    assert np.isfinite(oscillation(times, noise, 5.5)).all()  # it finds nothing, and says so with numbers


def linear_navier_stokes(times: np.ndarray, k: float, viscosity: float) -> np.ndarray:
    """First harmonic of the surface of deep water, of unit rate at the start, by finite differences in the depth.

    Potential Phi exp(kz) cos(kx) and stream function Psi(z, t) sin(kx). With m = d/dz of Psi at the surface,

        dPsi/dt = nu (Psi'' - k^2 Psi)    Psi(0) = 2 nu k a           (no shear stress at the surface)
        dPhi/dt = -g a - 2 nu k^2 Phi + 2 nu k m                      (no normal stress)
        da/dt = k Phi - k Psi(0)
    """
    depth = 6.0 * math.sqrt(viscosity * times[-1])  # as far as vorticity comes
    n = 240
    # Steps in the depth grow with it from a two hundredth of their mean, for the vorticity starts in a thin layer.
    share = np.linspace(0.0, 1.0, n + 1)
    z = -depth * (0.02 * share + 0.98 * share**2)
    gap = z[:-1] - z[1:]
    inner = 2.0 / (gap[:-1] + gap[1:])
    upper, lower = inner / gap[:-1], inner / gap[1:]
    a, phi, psi = 0.0, 1.0 / k, np.zeros(n + 1)
    found, steps = [0.0], 800
    for start, end in itertools.pairwise(times):
        dt = (end - start) / steps
        diagonal = 1.0 + dt * viscosity * (upper + lower + k**2)
        matrix = np.diag(diagonal) - dt * viscosity * (np.diag(upper[1:], -1) + np.diag(lower[:-1], 1))
        inverse = np.linalg.inv(matrix)
        for _ in range(steps):
            slope = (psi[0] - psi[1]) / gap[0] + 0.5 * gap[0] * (psi[0] * k**2 + 2.0 * k * (phi * k - k * psi[0]))
            phi += dt * (-GRAVITY * a - 2.0 * viscosity * k**2 * phi + 2.0 * viscosity * k * slope)
            a += dt * k * (phi - psi[0])
            psi[0] = 2.0 * viscosity * k * a
            known = psi[1:-1].copy()
            known[0] += dt * viscosity * upper[0] * psi[0]
            psi[1:-1] = inverse @ known
        found.append(a)
    return np.array(found)


def test_the_viscous_wave_solves_the_linear_equations_of_navier_and_stokes():
    k, times = 2.0 * math.pi, np.linspace(0.0, 1.6, 9)
    viscosity = SPEED / 250.0
    waves = viscous_wave(times, k, viscosity, 1.0)
    by_steps = linear_navier_stokes(times, k, viscosity)
    assert waves == pytest.approx(by_steps, abs=0.005 * float(np.abs(waves).max()))


def test_the_viscous_wave_starts_irrotational_and_ends_as_lamb_says():
    k = 2.0 * math.pi
    omega = linear_omega(k)
    viscosity = SPEED / 500.0
    start = np.array([0.0, 1e-3, 2e-3])
    assert viscous_wave(start, k, viscosity, 3.0) == pytest.approx(3.0 * start, rel=2e-3, abs=1e-9)
    n, friction = lamb_root(k, viscosity), 2.0 * viscosity * k**2
    relation = (n + friction) ** 2 + omega**2 - 4.0 * viscosity**2 * k**3 * np.sqrt(k**2 + n / viscosity)
    assert abs(relation) < 1e-9 * omega**2
    assert -n.real == pytest.approx(0.8725 * friction, rel=1e-4)
    times = np.linspace(2.0, 6.0, 150)
    found = oscillation(times, viscous_wave(times, k, viscosity, 1.0), omega)
    assert found == pytest.approx((n.imag, -n.real), rel=1e-3)


@pytest.mark.parametrize("reynolds", REYNOLDS)
def test_the_viscous_reference_itself_has_no_error(reynolds):
    case = VISCOUS.parts[str(reynolds)]
    scene, times = case.scene(50, 2), np.concatenate([[0.0], case.times])
    k = 2.0 * math.pi
    wave = viscous_wave(times, k, scene.material.viscosity, 7.0)  # of any height
    errors = case.errors(times, {"elevation": wave[:, None]}, scene)
    assert errors[f"damping_{reynolds}"] == pytest.approx(0.0, abs=1e-6)
    assert errors[f"omega_{reynolds}"] == pytest.approx(0.0, abs=0.002)  # the finite amplitude, which this wave lacks
    more = case.errors(times, {"elevation": (wave * np.exp(-0.1 * times))[:, None]}, scene)
    rate = oscillation(times, wave, linear_omega(k))[1]
    assert more[f"damping_{reynolds}"] == pytest.approx(0.1 / rate, rel=0.01)


# -- start -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", [CASE, VISCOUS], ids=lambda case: case.name)
def test_the_start_is_an_incompressible_flow_with_the_pressure_it_needs(case):
    scene = case.scene(50, 2)
    (fluid,) = scene.fluid
    assert callable(fluid.velocity)
    assert callable(fluid.pressure)
    width, step = scene.upper[0], 1e-3
    inside = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 7) * width, np.linspace(0.1, 0.9, 7)), axis=-1).reshape(-1, 2)
    east, north = np.array([step, 0.0]), np.array([0.0, step])
    gradient = np.stack([fluid.velocity(inside + e) - fluid.velocity(inside - e) for e in (east, north)]) / (2.0 * step)
    assert gradient[0, :, 0] + gradient[1, :, 1] == pytest.approx(0.0, abs=1e-5)
    assert gradient[0, :, 1] == pytest.approx(gradient[1, :, 0], abs=1e-5)
    around = sum(fluid.pressure(inside + e) for e in (east, -east, north, -north))
    curvature = (around - 4.0 * fluid.pressure(inside)) / step**2 / DENSITY
    strain = -(gradient[0, :, 0] ** 2 + gradient[1, :, 1] ** 2 + 2.0 * gradient[0, :, 1] * gradient[1, :, 0])
    assert curvature == pytest.approx(strain, abs=1e-3 * float(np.abs(strain).max()))

    x = np.linspace(0.0, width, 9)
    top = np.stack([x, np.full(9, DEPTH)], axis=1)
    assert fluid.pressure(top) == pytest.approx(0.0, abs=1e-6)
    floor = np.stack([x, np.zeros(9)], axis=1)
    assert fluid.velocity(floor)[:, 1] == pytest.approx(0.0, abs=1e-12)
    pull = (fluid.pressure(floor + north) - fluid.pressure(floor - north)) / (2.0 * step)
    assert pull == pytest.approx(-DENSITY * GRAVITY)
    for at in (0.0, width):
        wall = np.stack([np.full(9, at), np.linspace(0.0, DEPTH, 9)], axis=1)
        assert fluid.velocity(wall)[:, 0] == pytest.approx(0.0, abs=1e-12)
        assert fluid.pressure(wall + east) == pytest.approx(fluid.pressure(wall - east), rel=1e-9, abs=1e-6)


def test_the_surface_rises_as_linear_theory_says_and_hardly_with_a_sound():
    solver = Solver(CASE.scene(20, 2), CASE.scheme, device="cpu")
    before = observe(solver)
    density = solver.particles().density
    assert np.abs(before["elevation"]).max() < 1e-6
    omega = linear_omega(math.pi)
    assert before["kinetic"] == pytest.approx(0.25 * DENSITY * GRAVITY * AMPLITUDE**2, rel=0.01)
    solver.advance(0.02 * PERIOD)
    rise = AMPLITUDE * math.sin(omega * 0.02 * PERIOD)
    assert observe(solver)["elevation"][0] == pytest.approx(rise, rel=0.02)
    change = rms(solver.particles().density / density - 1.0)
    assert change < 0.05 * GRAVITY * DEPTH / solver.scene.sound_speed**2


# -- runs ------------------------------------------------------------------------------------------------------------


def test_a_coarse_wave_swings_at_about_the_right_pace():
    result = run(CASE, 12, device="cpu", end=3.0 * PERIOD * 1.001)
    assert result.particles == 144
    assert result.steps > 0
    assert abs(result.errors["period"]) < 0.05
    assert 0.0 < result.errors["loss"] < 0.15
    assert result.records["elevation"].shape == (121, HARMONICS)
    assert np.abs(result.records["elevation"][:, 0]).max() == pytest.approx(AMPLITUDE, rel=0.1)


def test_coarse_viscous_waves_decay_the_faster_the_more_viscous_they_are():
    result = run(VISCOUS, 20, device="cpu")
    assert set(result.errors) == {f"{name}_{re}" for name in ("damping", "omega") for re in REYNOLDS}
    assert abs(result.errors["damping_250"]) < 0.15
    assert abs(result.errors["omega_250"]) < 0.05
    assert result.passed is None  # the target is set from H/50 on
    last = [np.abs(result.records[f"{re}_elevation"][-40:, 0]).max() / VISCOUS_AMPLITUDE for re in REYNOLDS]
    assert 0.0 < last[0] < last[1] < last[2] < 1.0
    assert len(result.times) == VISCOUS_PERIODS * 40 + 1


def test_artificial_viscosity_takes_energy_from_the_wave():
    losses = [
        run(CASE, 12, device="cpu", end=2.001 * PERIOD, scheme=scheme).errors["loss"]
        for scheme in (CASE.scheme, dataclasses.replace(CASE.scheme, artificial_viscosity=0.01))
    ]
    assert losses[1] > losses[0] + 0.03


@pytest.mark.slow
@pytest.mark.parametrize("resolution", [25, 50])
def test_the_wave_keeps_its_period_and_its_energy(resolution):
    result = run(CASE, resolution, device="cpu", end=float(CASE.times[-1]))
    assert result.passed, result.errors


@pytest.mark.slow
def test_viscous_waves_decay_as_the_reference():
    result = run(VISCOUS, 50, device="cpu")
    assert result.passed, result.errors
