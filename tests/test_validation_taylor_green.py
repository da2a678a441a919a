"""The Taylor-Green vortices in two and three dimensions: their references, and coarse runs; finer ones are slow."""

import numpy as np
import pytest

from fluidgym.scene import Scene
from fluidgym.solver import Solver
from fluidgym.validation import observed_order, run, taylor_green, taylor_green_3d

NU = 0.01  # of both flows [m2/s]


def acceleration_and_force(velocity, pressure, place, rate=0.0):
    """Du/Dt and -grad p/rho + nu Laplacian u (n, dim), and div u (n,), by differences; given du/dt (n, dim)."""
    step, dim = 1e-3, place.shape[1]
    u, left, force, divergence = velocity(place), rate, 0.0, 0.0
    for axis, shift in enumerate(step * np.eye(dim)):
        ahead, behind = velocity(place + shift), velocity(place - shift)
        slope = (ahead - behind) / (2.0 * step)
        left = left + u[:, [axis]] * slope
        force = force + NU * (ahead - 2.0 * u + behind) / step**2
        push = (pressure(place + shift) - pressure(place - shift)) / (2.0 * step) / 1000.0
        force = force - push[:, None] * np.eye(dim)[axis]
        divergence = divergence + slope[:, axis]
    return left, force, divergence


def assert_starts_in_place(scene: Scene, velocity, pressure):
    """Particles start at most a fifth of the spacing from the lattice, as the exact flow is at their places."""
    start, dx = scene.sample(), scene.particle_spacing
    off = start.position / dx - np.floor(start.position / dx) - 0.5
    assert 0.15 < np.abs(off).max() <= 0.2 + 1e-9
    solver = Solver(scene, device="cpu")
    for particles, tolerance in ((start, 1e-12), (solver.particles(), 1e-5)):
        assert particles.velocity == pytest.approx(velocity(particles.position), abs=tolerance)
        assert particles.pressure / 1000.0 == pytest.approx(pressure(particles.position) / 1000.0, abs=10 * tolerance)


# -- two dimensions: reference ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", [0.0, 0.7])
def test_the_exact_flow_solves_the_equations_of_motion(time):
    place, step = np.random.default_rng(1).uniform(0.0, 1.0, (20, 2)), 1e-4
    rate = (taylor_green.velocity(place, time + step) - taylor_green.velocity(place, time - step)) / (2.0 * step)
    inertia, force, divergence = acceleration_and_force(
        lambda x: taylor_green.velocity(x, time), lambda x: taylor_green.pressure(x, time), place, rate
    )
    assert divergence == pytest.approx(0.0, abs=1e-4)
    assert inertia == pytest.approx(force, abs=1e-3)
    assert np.abs(inertia).max() > 0.5


def test_the_exact_flow_has_the_speed_and_energy_of_the_literature():
    grid = (np.arange(40) + 0.5) / 40
    place = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    assert float(taylor_green.decay(2.0)) == pytest.approx(0.20615, abs=6e-6)
    assert float(taylor_green.decay(2.0)) == pytest.approx(np.exp(-8.0 * np.pi**2 * NU * 2.0))
    speed = np.linalg.norm(taylor_green.velocity(np.array([[0.0, 0.25]]), 2.0))
    assert speed == pytest.approx(0.20615, abs=6e-6)
    energy = 0.5 * (taylor_green.velocity(place, 0.5) ** 2).sum(axis=1).mean()
    assert energy == pytest.approx(0.25 * np.exp(-16.0 * np.pi**2 * NU * 0.5))


def test_the_vortices_start_as_the_exact_flow():
    assert_starts_in_place(taylor_green.scene(10, 2), taylor_green.velocity, taylor_green.pressure)


def test_the_reference_itself_has_no_error():
    case = taylor_green.CASE
    times = np.concatenate([[0.0], case.times])
    place = np.random.default_rng(2).uniform(0.0, 1.0, (50, 2))
    decay = np.exp(-8.0 * np.pi**2 * NU * times)

    def records(change):
        return {
            "speed_error": np.array(
                [taylor_green.speed_error(place, change * taylor_green.velocity(place, t), t) for t in times]
            ),
            "largest_speed": change * decay,
            "energy": 0.25 * (change * decay) ** 2,
        }

    errors = case.errors(times, records(1.0), case.scene(10, 2))
    assert errors == {name: pytest.approx(0.0, abs=1e-12) for name in ("speed", "decay", "energy")}
    errors = case.errors(times, records(0.98), case.scene(10, 2))
    assert errors == {
        "speed": pytest.approx(0.02),
        "decay": pytest.approx(0.02),
        "energy": pytest.approx(1.0 - 0.98**2),
    }
    broken = records(1.0)
    broken["energy"][-1] *= 1.5  # at the last instant alone, where there is little of it
    broken["speed_error"][4] = np.nan
    errors = case.errors(times, broken, case.scene(10, 2))
    assert errors["energy"] == pytest.approx(0.5)
    assert not errors["speed"] <= 1.0


# -- two dimensions: runs --------------------------------------------------------------------------------------------


def test_coarse_vortices_decay_as_the_exact_ones():
    result = run(taylor_green.CASE, 25, device="cpu")
    assert result.particles == 625
    assert 0.0 < result.errors["speed"] < 0.05
    assert result.errors["decay"] < 0.08
    assert result.errors["energy"] < 0.08
    assert result.passed is None  # the target is set from 50 on
    assert result.records["speed_error"][0] < 1e-6


@pytest.mark.slow
def test_refined_vortices_meet_the_target_and_converge():
    coarse, middle, fine = (run(taylor_green.CASE, resolution, device="cpu") for resolution in (25, 50, 100))
    assert middle.passed, middle.errors
    assert fine.passed, fine.errors
    assert observed_order(coarse, middle)["speed"] > 1.5
    assert observed_order(middle, fine)["speed"] > 0.7


# -- three dimensions: reference -------------------------------------------------------------------------------------


def spectral_energy(points: int, end: float, step: float = 0.1) -> np.ndarray:
    """Kinetic energy per mass of the flow at t = 0, step, ... end, by Fourier modes."""
    wave = np.fft.fftfreq(points, 1.0 / points)
    k = np.stack(np.meshgrid(wave, wave, np.arange(points // 2 + 1.0), indexing="ij"))
    k_squared = (k**2).sum(axis=0)
    kept = (np.abs(k) < points / 3.0).all(axis=0)

    def modes(field):
        return np.fft.rfftn(field, axes=(1, 2, 3))

    def values(field):
        return np.fft.irfftn(field, s=(points,) * 3, axes=(1, 2, 3))

    def rate(u):
        turning = kept * modes(np.cross(values(u), values(1j * np.cross(k, u, axis=0)), axis=0))
        return turning - k * ((k * turning).sum(axis=0) / np.maximum(k_squared, 1.0)) - NU * k_squared * u

    line = 2.0 * np.pi * np.arange(points) / points
    place = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    u = modes(taylor_green_3d.velocity(place).T.reshape(3, points, points, points))
    energy = [0.5 * (values(u) ** 2).sum(axis=0).mean()]
    for _ in range(round(end / step)):
        k1 = rate(u)
        k2 = rate(u + 0.5 * step * k1)
        k3 = rate(u + 0.5 * step * k2)
        u = u + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(u + step * k3))
        energy.append(0.5 * (values(u) ** 2).sum(axis=0).mean())
    return np.array(energy)


def test_the_energies_are_those_of_the_equations_of_motion():
    energy = spectral_energy(20, 3.0)
    assert energy[0] == pytest.approx(0.125)
    assert energy[10:21:10] == pytest.approx(taylor_green_3d.ENERGY[:2], rel=1e-4)
    assert energy[30] == pytest.approx(taylor_green_3d.ENERGY[2], rel=1e-3)


@pytest.mark.slow
def test_the_late_energies_are_those_of_the_equations_of_motion():
    energy = spectral_energy(32, 10.0)
    assert energy[10::10] == pytest.approx(taylor_green_3d.ENERGY, rel=0.007)
    assert energy[10:61:10] == pytest.approx(taylor_green_3d.ENERGY[:6], rel=0.0015)
    falls = (energy[:-5] - energy[5:]) / 0.5
    assert falls.max() == pytest.approx(taylor_green_3d.DISSIPATION, rel=0.005)


def test_the_energies_are_near_those_of_a_finite_volume_run():
    table = {1: 0.117534, 2: 0.109089, 4: 0.086831, 5: 0.074030, 6: 0.061393, 8: 0.040236, 10: 0.026422}
    for time, energy in table.items():
        assert taylor_green_3d.ENERGY[time - 1] == pytest.approx(energy, rel=0.001 if time <= 5 else 0.009)
    assert pytest.approx(0.012904, rel=0.005) == taylor_green_3d.DISSIPATION


def test_the_pressure_at_the_start_keeps_the_volume_of_the_fluid():
    # The divergence of du/dt must vanish: that of (u.grad) u + grad p/rho, the viscous part having none of its own.
    place, step = np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, (20, 3)), 1e-2

    def rate(x):
        inertia, force, divergence = acceleration_and_force(taylor_green_3d.velocity, taylor_green_3d.pressure, x)
        assert divergence == pytest.approx(0.0, abs=1e-6)
        return inertia - force

    shifts = step * np.eye(3)
    slopes = [(rate(place + s) - rate(place - s))[:, axis] / (2.0 * step) for axis, s in enumerate(shifts)]
    assert np.sum(slopes, axis=0) == pytest.approx(0.0, abs=1e-3)
    assert np.abs(slopes).max() > 0.3


def test_the_vortex_in_three_dimensions_starts_as_the_exact_flow():
    assert_starts_in_place(taylor_green_3d.scene(8, 3), taylor_green_3d.velocity, taylor_green_3d.pressure)


def test_the_reference_in_three_dimensions_has_no_error():
    case = taylor_green_3d.CASE
    times = np.concatenate([[0.0], case.times])
    energy = np.interp(times, np.arange(11.0), [0.125, *taylor_green_3d.ENERGY])
    scene = case.scene(8, 3)
    errors = case.errors(times, {"energy": energy}, scene)
    assert set(errors) == {"energy", "late_energy", "dissipation"}
    assert errors["energy"] == pytest.approx(0.0, abs=1e-12)
    assert errors["late_energy"] == pytest.approx(0.0, abs=1e-12)
    falls = float(np.max(taylor_green_3d.ENERGY[:-1] - taylor_green_3d.ENERGY[1:]))  # energies on straight lines
    assert errors["dissipation"] == pytest.approx(falls / taylor_green_3d.DISSIPATION - 1.0)
    energy[times == 3.0] *= 0.9
    energy[times == 9.0] *= 1.2
    errors = case.errors(times, {"energy": energy}, scene)
    assert errors["energy"] == pytest.approx(0.1)
    assert errors["late_energy"] == pytest.approx(0.2)
    early = times <= 2.5
    assert case.errors(times[early], {"energy": energy[early]}, scene) == {"energy": pytest.approx(0.0, abs=1e-12)}
    at_once = case.errors(times[:2], {"energy": energy[:2]}, scene)  # no instant of the table was reached
    assert list(at_once) == ["energy"]
    assert np.isnan(at_once["energy"])
    energy[4] = np.nan
    assert not case.errors(times, {"energy": energy}, scene)["energy"] <= 1.0


def test_the_flow_in_two_dimensions_is_a_slice_of_that_in_three():
    place = np.random.default_rng(4).uniform(0.0, 1.0, (10, 2))
    slice_ = np.concatenate([2.0 * np.pi * (place + 0.25), np.zeros((10, 1))], axis=1)  # z = 0, a quarter wave off
    assert taylor_green_3d.velocity(slice_)[:, :2] == pytest.approx(taylor_green.velocity(place))


# -- three dimensions: runs ------------------------------------------------------------------------------------------


def test_a_coarse_vortex_in_three_dimensions_loses_its_energy_in_time():
    result = run(taylor_green_3d.CASE, 12, 3, device="cpu")
    assert result.particles == 12**3
    assert result.errors.keys() == {"energy"}
    assert result.errors["energy"] < 0.1
    assert (np.diff(result.records["energy"]) < 0.0).all()  # diffusion and viscosity take, nothing gives


@pytest.mark.slow
@pytest.mark.parametrize("resolution", [16, 32])
def test_the_vortex_in_three_dimensions_meets_its_target(resolution):
    result = run(taylor_green_3d.CASE, resolution, 3, device="cpu")
    assert result.passed, result.errors


@pytest.mark.slow
def test_the_vortex_in_three_dimensions_decays_to_the_end():
    result = run(taylor_green_3d.CASE, 16, 3, device="cpu", end=10.0)
    assert result.errors["late_energy"] < 0.2
    assert abs(result.errors["dissipation"]) < 0.1
