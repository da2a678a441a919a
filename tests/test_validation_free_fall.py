"""Free fall: its reference, coarse runs, and worlds with next to nothing in them."""

import dataclasses

import numpy as np
import pytest

from fluidgym.diagnostics import measure
from fluidgym.scene import Ball, Box, Fluid, Scene
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.validation import run
from fluidgym.validation.free_fall import CASE, DRIFT, FALL, GRAVITY, SHIFT, SPEED, TIMES

# -- reference -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(("case", "prefix"), [(FALL, ""), (DRIFT, "drift_")])
def test_a_block_that_moves_as_it_should_has_no_error(case, prefix, dim):
    scene, times = case.scene(4, dim), np.concatenate([[0.0], TIMES])
    start = scene.sample()
    assert len(start) == 4**dim
    assert start.position.mean(axis=0) == pytest.approx([0.0] * dim, abs=1e-12)
    speed = 0.0 if case is FALL else SPEED
    assert np.linalg.norm(start.velocity, axis=1) == pytest.approx(speed)
    # Step by step, and not by the formula that the case holds it against.
    g = np.array([*[0.0] * (dim - 1), -GRAVITY if case is FALL else 0.0])
    place, velocity, places = start.position.copy(), start.velocity.copy(), [start.position]
    for _ in TIMES:
        for _ in range(100):
            velocity += 0.5 * 0.001 * g
            place = place + 0.001 * velocity
            velocity += 0.5 * 0.001 * g
        places.append(place)
    records = {"place": np.array(places), "pressure": np.zeros((len(times), len(start)))}
    errors = case.errors(times, records, scene)
    assert errors == pytest.approx({f"{prefix}{name}": 0.0 for name in ("distortion", "path", "pressure")}, abs=1e-10)
    # One particle a fifth of a spacing off, all a hundredth of L too low at one instant, and a hundredth of the unit
    # of pressure, with the wrong sign.
    records["place"][2, 3, 0] += 0.2 * scene.particle_spacing
    records["place"][4, :, -1] -= 0.01
    records["pressure"][3, 1] = -0.01 * 1000.0 * (GRAVITY if case is FALL else SPEED**2)
    errors = case.errors(times, records, scene)
    assert errors[f"{prefix}distortion"] == pytest.approx(0.2 * (1.0 - 1.0 / len(start)))
    assert errors[f"{prefix}path"] == pytest.approx(0.01)
    assert errors[f"{prefix}pressure"] == pytest.approx(0.01)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_drops_stand_alike(dim):
    scene = SHIFT.scene(8, dim)
    start = scene.sample()
    first, second, third = np.split(start.position, 3)
    aside = np.array([2.0, *[0.0] * (dim - 1)])
    assert second - first == pytest.approx(np.tile(aside, (len(first), 1)))
    assert third - first == pytest.approx(np.tile(-aside, (len(first), 1)))
    assert (np.linalg.norm(first, axis=1) < 0.5).all()
    strain, same, carried = np.split(start.velocity, 3)
    assert strain == pytest.approx(first * ([0.75] + [0.0] * (dim - 2) + [-0.75]))
    assert same == pytest.approx(strain)
    assert carried - strain == pytest.approx(np.tile([*[0.0] * (dim - 1), -3.0], (len(first), 1)))


def test_drops_that_do_alike_have_no_error():
    scene, times = SHIFT.scene(8, 2), np.concatenate([[0.0], TIMES])
    first = np.split(scene.sample().position, 3)[0]
    drop = np.array([first * [1.0 + t, 1.0 - t] for t in times])
    fall = np.stack([0.0 * times, -times], axis=1)[:, None]
    aside = np.array([2.0, 0.0])
    records = {"place": np.concatenate([drop, drop + aside, drop + fall - aside], axis=1)}
    assert SHIFT.errors(times, records, scene) == pytest.approx({"shift": 0.0, "carried": 0.0}, abs=1e-12)
    records["place"][3, len(first) + 1, 1] += 0.1 * scene.particle_spacing
    records["place"][5, 2 * len(first), 1] -= 0.3 * scene.particle_spacing
    share = 1.0 - 1.0 / len(first)
    assert SHIFT.errors(times, records, scene) == pytest.approx({"shift": 0.1 * share, "carried": 0.3 * share})


# -- runs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [2, 3])
def test_blocks_fall_and_drift_and_drops_flow_alike(dim):
    result = run(CASE, 10, dim, device="cpu", end=0.3)
    assert set(result.errors) == set(CASE.goal[10])
    assert result.passed, result.errors


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("delta", [0.0, 0.1])
def test_a_block_falls_without_pressure_whether_density_diffuses_or_not(delta, dim):
    result = run(FALL, 10, dim, device="cpu", scheme=Scheme(density_diffusion=delta), end=0.3)
    assert result.errors["distortion"] < 2e-4
    assert result.errors["pressure"] < 1e-6


def test_water_in_a_tank_flows_alike_wherever_the_tank_stands():
    # All places are whole multiples of 1/32 m, and the shift of 1/4 m: no rounding at the start. Its weight is given to
    # the water as a function, which leaves it on the lattice.
    def weight(top):
        return lambda points: 9810.0 * (top - points[:, 1])

    tank = Scene(
        (0.0, 0.0),
        (1.0, 1.0),
        1.0 / 16.0,
        [Fluid(Box((0.0, 0.0), (0.5, 0.5)), pressure=weight(0.5)), Fluid(Ball((0.75, 0.75), 0.125))],
    )
    aside = np.array([0.25, -0.25])
    moved = dataclasses.replace(
        tank,
        lower=tuple(tank.lower + aside),
        upper=tuple(tank.upper + aside),
        fluid=[
            Fluid(Box((0.25, -0.25), (0.75, 0.25)), pressure=weight(0.25)),
            Fluid(Ball((1.0, 0.5), 0.125)),
        ],
        reference_speed=tank.speed_scale,
    )
    here, there = Solver(tank, device="cpu"), Solver(moved, device="cpu")
    assert (there.particles().position - here.particles().position == aside).all()
    for solver in (here, there):
        solver.step(100, here.max_step)
    flow, other = here.particles(), there.particles()
    assert here.time[0] > 0.15
    assert measure(here).front > 0.55
    assert other.position - aside == pytest.approx(flow.position, abs=1e-3 / 16.0)
    assert other.velocity == pytest.approx(flow.velocity, abs=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_an_empty_world_goes_on(dim):
    scene = Scene((0.0,) * dim, (1.0,) * dim, 0.1, [], reference_speed=1.0)
    solver = Solver(scene, num_worlds=2, device="cpu")
    solver.advance(0.1)
    assert solver.time == pytest.approx([0.1, 0.1])
    assert len(solver.particles(1)) == 0
    assert measure(solver).energy == 0.0
    solver.reset()
    solver.step(3)
    assert len(solver.particles()) == 0


def test_a_world_without_fluid_stands_beside_one_with_some():
    scene = FALL.scene(6, 2)
    solver, alone = Solver(scene, num_worlds=2, device="cpu"), Solver(scene, device="cpu")
    solver.set_start([0], [scene.sample().chosen(slice(0))])
    solver.reset()
    for each in (solver, alone):
        each.step(20, alone.max_step)
    assert len(solver.particles(0)) == 0
    assert (solver.particles(1).position == alone.particles().position).all()
