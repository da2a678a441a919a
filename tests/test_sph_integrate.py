"""The step in time: its order, free flight, the motion of faces, and spray."""

import numpy as np
import pytest

from fluidgym.scene import PERIODIC, Box, Face, Fluid, Material, Particles, Scene, face_names
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver

ROUNDING = 1e-5  # what two hundred steps make of float32 where numbers are near one


def lone_solver(position, velocity=(0.0, 0.0), pressure=0.0, faces=None, device="cpu"):
    """A solver of one particle."""
    scene = Scene((0.0, 0.0), (1.0, 1.0), 0.05, Fluid(Box((0.5, 0.5), (0.55, 0.55))), faces or {}, reference_speed=4.0)
    solver = Solver(scene, device=device)
    start = Particles(
        np.array([position]), np.array([velocity]), np.array([1000.0]), np.array([pressure]), np.array([0])
    )
    solver.set_start([0], [start])
    solver.reset()
    return solver


def test_free_flight_is_a_parabola(device):
    solver = lone_solver((0.5, 0.5), (0.3, 1.2), device=device)
    for _ in range(4):
        solver.advance(0.05)
        t = solver.time[0]
        found = solver.particles()
        np.testing.assert_allclose(found.position[0], [0.5 + 0.3 * t, 0.5 + 1.2 * t - 9.81 * t * t / 2], atol=ROUNDING)
        np.testing.assert_allclose(found.velocity[0], [0.3, 1.2 - 9.81 * t], atol=ROUNDING)


def test_particle_alone_carries_no_pressure(device):
    solver = lone_solver((0.5, 0.5), pressure=5000.0, device=device)
    assert solver.particles().pressure[0] == pytest.approx(5000.0, rel=1e-6)
    solver.step()
    assert solver.particles().pressure[0] == 0.0
    assert solver.particles().density[0] == 1000.0


def sound_wave(dt_share):
    """Positions in a periodic box after a sound wave of no dissipation has run for a while."""
    scene = Scene(
        (0.0, 0.0),
        (1.0, 0.5),
        0.05,
        Fluid(Box((0.0, 0.0), (1.0, 0.5)), velocity=lambda x: 0.5 * np.sin(2 * np.pi * x) * [[1.0, 0.0]]),
        faces=dict.fromkeys(face_names(2), PERIODIC),
        gravity=0.0,
        material=Material(sound_speed=5.0),
    )
    dissipation = dict.fromkeys(("density_diffusion", "artificial_viscosity", "acoustic_damping", "shifting"), 0.0)
    solver = Solver(scene, Scheme(smoothing_ratio=1.5, **dissipation), device="cpu")
    solver.step(round(20 / dt_share), dt_share * 0.8 * solver.max_step)
    return solver.particles().position.astype(float)


def test_step_is_of_second_order():
    coarse, middle, fine, reference = (sound_wave(share) for share in (1.0, 0.5, 0.25, 0.0625))
    errors = [np.abs(found - reference).max() for found in (coarse, middle, fine)]
    assert errors[2] > 1e-5  # far above rounding
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.2)


# -- faces -----------------------------------------------------------------------------------------------------------

TRAVEL = (0.0, 0.3)


@pytest.fixture
def walled(device):
    """Two worlds whose left wall moves, and a particle out of its way."""
    scene = Scene(
        (0.0, 0.0),
        (1.0, 1.0),
        0.05,
        Fluid(Box((0.9, 0.5), (0.95, 0.55))),
        faces={"x_min": Face(moving=True, travel=TRAVEL)},
        reference_speed=4.0,
    )
    return Solver(scene, num_worlds=2, device=device)


def face_motion(solver, world=0, face=0):
    """Position, velocity, acceleration of a face."""
    saved = solver.save()
    return tuple(float(saved[f"face_{name}"][world, face]) for name in ("position", "velocity", "acceleration"))


def test_face_reaches_its_velocity_at_constant_acceleration(walled):
    walled.face_velocity[0, 0] = 1.5
    dt = 0.6 * walled.max_step
    walled.step(10, dt)
    T = 10 * dt
    assert face_motion(walled) == pytest.approx((0.5 * 1.5 * T, 1.5, 1.5 / T), rel=1e-5)
    walled.face_velocity[0, 0] = -0.5
    walled.step(10, dt)
    assert face_motion(walled) == pytest.approx((0.5 * 1.5 * T + 0.5 * T, -0.5, -2.0 / T), rel=1e-5)
    assert face_motion(walled, world=1) == (0.0, 0.0, 0.0)


def test_face_at_the_target_velocity_goes_on_evenly(walled):
    walled.face_velocity[0, 0] = 0.8
    walled.step(5)
    start, velocity, _ = face_motion(walled)
    walled.step(10)
    end, still, acceleration = face_motion(walled)
    assert end - start == pytest.approx(0.8 * 10 * walled.max_step, rel=1e-5)
    assert (velocity, still, acceleration) == pytest.approx((0.8, 0.8, 0.0), abs=ROUNDING)


def test_face_stops_at_the_ends_of_its_travel_and_comes_back(walled):
    walled.face_velocity[:, 0] = 2.0
    walled.advance(0.05)
    for _ in range(5):
        walled.advance(0.05)
        assert face_motion(walled)[0] <= np.float32(TRAVEL[1])
    assert face_motion(walled) == pytest.approx((TRAVEL[1], 0.0, 0.0), abs=1e-7)
    walled.face_velocity[:, 0] = -1.0
    walled.advance(0.05)
    position, velocity, _ = face_motion(walled)
    assert position == pytest.approx(TRAVEL[1] - 0.5 * 0.05, rel=1e-5)
    assert velocity == pytest.approx(-1.0, rel=1e-5)
    for _ in range(10):
        walled.advance(0.05)
    assert face_motion(walled) == pytest.approx((TRAVEL[0], 0.0, 0.0), abs=1e-7)


def test_face_that_does_not_move_refuses_a_velocity(walled):
    walled.reset()
    before = walled.save()
    walled.face_velocity[:, 1] = 1.0
    with pytest.raises(ValueError) as error:
        walled.advance(0.05)
    assert str(error.value) == (
        "Solver.face_velocity of 'x_max' is not 0, but that face does not move; make it Face(moving=True) in the scene"
    )
    walled.face_velocity[:] = 0.0
    after = walled.save()
    assert all((after[name] == before[name]).all() for name in before)


def test_particle_that_falls_on_a_floor_bounces_and_keeps_its_course():
    fallen = lone_solver((0.5, 0.3), (0.5, 0.0))
    heights = []
    for _ in range(20):
        fallen.advance(0.02)
        heights.append(float(fallen.particles().position[0, 1]))
        assert fallen.particles().velocity[0, 0] == 0.5
    lowest = int(np.argmin(heights))
    assert 0.0 < heights[lowest] < 0.05
    assert max(heights[lowest:]) > 0.15
