"""What a world amounts to, against hand counts, exact integrals and conservation laws."""

import dataclasses

import numpy as np
import pytest

from fluidgym import diagnostics
from fluidgym.scene import OPEN, PERIODIC, Ball, Box, Fluid, Material, Particles, Scene
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.sph.state_equation import TAIT

PAIR_SCENE = Scene(
    (0.0, 0.0), (4.0, 4.0), 0.5, Fluid(Box((0.0, 0.0), (1.0, 1.0))), material=Material(800.0, sound_speed=20.0)
)
PAIR_MASS = 800.0 * 0.5**2


def make_pair(s=(0.0, 0.0)) -> Particles:
    """Two particles of PAIR_SCENE with density errors s."""
    return Particles(
        position=np.array([[1.0, 0.5], [3.0, 1.5]], np.float32),
        velocity=np.array([[3.0, 4.0], [-1.0, 0.0]], np.float32),
        density=800.0 * (1.0 + np.array(s)),
        pressure=800.0 * 20.0**2 * np.array(s),
        identity=np.arange(2),
    )


def still_water(gravity=9.81) -> Scene:
    """A full tank of 0.5 m, hydrostatic."""
    body = Fluid(Box((0.0, 0.0), (0.5, 0.5)), pressure="hydrostatic")
    return Scene((0.0, 0.0), (0.5, 1.0), 0.025, body, gravity=gravity, reference_speed=2.2)


def test_two_particles_are_measured_as_by_hand():
    pair = make_pair()
    assert diagnostics.mass(pair, PAIR_SCENE) == pytest.approx(2 * PAIR_MASS)
    assert diagnostics.kinetic_energy(pair, PAIR_SCENE) == pytest.approx(0.5 * PAIR_MASS * 26.0)
    assert diagnostics.potential_energy(pair, PAIR_SCENE) == pytest.approx(PAIR_MASS * 9.81 * 2.0)
    assert diagnostics.potential_energy(pair, PAIR_SCENE, (-2.0, 0.0)) == pytest.approx(PAIR_MASS * 2.0 * 4.0)
    assert diagnostics.momentum(pair, PAIR_SCENE) == pytest.approx(PAIR_MASS * np.array([2.0, 4.0]))
    assert diagnostics.center_of_mass(pair) == pytest.approx([2.0, 1.0])
    assert diagnostics.second_moments(pair) == pytest.approx(np.array([[1.0, 0.5], [0.5, 0.25]]))
    assert diagnostics.front(pair, PAIR_SCENE) == pytest.approx(3.25)
    assert diagnostics.rms_speed(pair) == pytest.approx(np.sqrt(13.0))
    assert diagnostics.largest_speed(pair) == pytest.approx(5.0)


@pytest.mark.parametrize("s", [(0.02, -0.01), (1e-5, 3e-6)])
def test_elastic_energy_is_the_work_of_compression(s):
    s = np.array(s)
    linear = PAIR_MASS * 20.0**2 * np.sum(0.5 * s**2)
    assert diagnostics.elastic_energy(make_pair(s), PAIR_SCENE) == pytest.approx(linear, rel=1e-5)
    tait = PAIR_MASS * 20.0**2 / 7.0 * np.sum(((1 + s) ** 8 - 1) / 8 - s)
    scheme = Scheme(state_equation=TAIT)
    assert diagnostics.elastic_energy(make_pair(s), PAIR_SCENE, scheme) == pytest.approx(tait, rel=1e-5)


@pytest.mark.parametrize("tear", [0.0, 0.03, 1.0])
def test_torn_fluid_holds_the_work_of_its_largest_tension(tear):
    s, unit = -0.4, PAIR_MASS * 20.0**2
    ends = {"tear": tear} if tear else {"tension": False}
    end = max(s, -tear)
    linear = 0.5 * end**2 - tear * (s - end)
    assert diagnostics.elastic_energy(make_pair((s, 0.0)), PAIR_SCENE, Scheme(**ends)) == pytest.approx(
        unit * linear, rel=1e-5
    )
    end = max(s, max(0.0, 1.0 - 7.0 * tear) ** (1.0 / 7.0) - 1.0)  # where Tait's pressure is -tear, if it is anywhere
    tait = ((1.0 + end) ** 8 - 1.0) / 56.0 - end / 7.0 - tear * (s - end)
    scheme = Scheme(state_equation=TAIT, **ends)
    assert diagnostics.elastic_energy(make_pair((s, 0.0)), PAIR_SCENE, scheme) == pytest.approx(unit * tait, rel=1e-5)


def test_no_fluid_has_no_energy_and_no_place():
    nothing = Particles(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, int))
    for energy in (diagnostics.kinetic_energy, diagnostics.potential_energy, diagnostics.elastic_energy):
        assert energy(nothing, PAIR_SCENE) == 0.0
    assert diagnostics.rms_speed(nothing) == diagnostics.largest_speed(nothing) == 0.0
    assert np.isnan(diagnostics.front(nothing, PAIR_SCENE))
    assert np.isnan(diagnostics.center_of_mass(nothing)).all()


def test_second_moments_of_a_disc_are_a_quarter_of_its_radius_squared():
    disc = Scene((-2.0, -2.0), (2.0, 2.0), 0.02, Fluid(Ball((0.0, 0.0), 1.0)), gravity=0.0, reference_speed=1.0)
    moments = diagnostics.second_moments(disc.sample())
    assert moments == pytest.approx(0.25 * np.eye(2), abs=1e-3)


def test_an_elastic_drop_keeps_its_energy_and_momentum():
    # Neither viscosity, nor diffusion, nor damping: what the kinetic energy gives up must lie in compression.
    drop = Scene(
        (-2.0, -3.0),
        (2.0, 3.0),
        0.1,
        Fluid(Ball((0.0, 0.0), 1.0), velocity=lambda points: points * [-1.0, 1.0] + [0.3, 0.0]),
        faces=dict.fromkeys(("x_min", "x_max", "y_min", "y_max"), OPEN),
        gravity=0.0,
        material=Material(sound_speed=10.0),
    )
    solver = Solver(drop, Scheme(artificial_viscosity=0.0, density_diffusion=0.0, acoustic_damping=0.0), device="cpu")
    start = diagnostics.measure(solver)
    least = start.kinetic_energy
    for _ in range(20):
        solver.advance(0.04)
        now = diagnostics.measure(solver)
        least = min(least, now.kinetic_energy)
        assert now.energy == pytest.approx(start.energy, rel=2e-3)
        assert now.momentum == pytest.approx(start.momentum, rel=1e-4, abs=1e-4 * start.momentum[0])
    assert least < start.kinetic_energy * 0.998 - 1e-3 * start.energy  # energy did go to and fro


def test_measure_reads_one_world_and_its_own_gravity():
    solver = Solver(still_water(), num_worlds=2, device="cpu")
    solver.gravity[1] = (0.0, -5.0)
    first, second = diagnostics.measure(solver, 0), diagnostics.measure(solver, 1)
    assert first.mass == second.mass == pytest.approx(250.0)
    # Its density grows by g H/c_0^2 from top to bottom: the middle is lower by H/12 of that.
    lower = 9.81 * 0.5**2 / (12.0 * 22.0**2)
    assert first.center_of_mass == pytest.approx([0.25, 0.25 - lower], abs=1e-6)
    assert second.potential_energy / first.potential_energy == pytest.approx(5.0 / 9.81, rel=1e-6)
    # Under less gravity the compressed column of world 1 springs up, that of world 0 stays.
    solver.advance(0.02)
    first, second = diagnostics.measure(solver, 0), diagnostics.measure(solver, 1)
    assert second.momentum[1] > 20 * abs(first.momentum[1])
    assert first.time == second.time == pytest.approx(0.02)


def test_density_errors_of_a_still_column_are_those_of_its_weight():
    solver = Solver(still_water(), device="cpu")
    found = diagnostics.measure(solver)
    at_bottom = 9.81 * 0.5 / 22.0**2
    assert found.largest_density_error == pytest.approx(at_bottom * (1 - 0.025), rel=1e-4)
    assert found.rms_density_error == pytest.approx(at_bottom / np.sqrt(3), rel=2e-3)


def test_particles_that_leave_are_counted():
    flying = Scene(
        (0.0, 0.0),
        (1.0, 1.0),
        0.1,
        Fluid(Box((0.0, 0.0), (1.0, 1.0)), velocity=(1.0, 0.0)),
        faces={"x_min": OPEN, "x_max": OPEN},  # nothing holds it back
        gravity=0.0,
    )
    solver = Solver(flying, num_worlds=2, device="cpu")
    assert diagnostics.retired_particles(solver) == 0
    solver.advance(0.4)
    found = diagnostics.measure(solver)
    assert found.retired == 40
    assert found.particles == 100 - found.retired
    assert found.mass == pytest.approx(10.0 * found.particles)
    solver.reset(np.array([True, False]))
    assert diagnostics.retired_particles(solver, 0) == 0
    assert diagnostics.retired_particles(solver, 1) == found.retired
    # Another start counts from its reset on.
    whole = flying.sample()
    half = whole.chosen(slice(50))
    solver.set_start([1], [half])
    assert diagnostics.retired_particles(solver, 1) == found.retired
    solver.reset(np.array([False, True]))
    assert diagnostics.retired_particles(solver, 1) == 0


@pytest.mark.parametrize("height", [0.0, 0.01, 0.2, 0.4])
def test_pressure_at_a_place_is_hydrostatic_up_to_the_walls(height):
    solver = Solver(still_water(), device="cpu")
    places = np.array([[0.0, height], [0.25, height], [0.5, height]])
    expected = 1000 * 9.81 * (0.5 - height)
    assert diagnostics.pressure_at(solver, places) == pytest.approx(expected, rel=5e-3)


def test_there_is_no_pressure_in_the_air():
    solver = Solver(still_water(), device="cpu")
    assert diagnostics.pressure_at(solver, np.array([[0.25, 0.9]])) == 0.0


def test_a_wall_does_not_pull_on_drops_below_it():
    # A layer without pressure hangs under the ceiling: gravity would make that of its images above negative.
    ceiling = Scene((0.0, 0.0), (0.5, 0.5), 0.025, Fluid(Box((0.0, 0.4), (0.5, 0.5))), reference_speed=2.2)
    solver = Solver(ceiling, device="cpu")
    assert diagnostics.pressure_at(solver, np.array([[0.25, 0.5]])) == 0.0
    # Under a floor it still makes them positive.
    floor = dataclasses.replace(ceiling, fluid=Fluid(Box((0.0, 0.0), (0.5, 0.1))))
    assert diagnostics.pressure_at(Solver(floor, device="cpu"), np.array([[0.25, 0.0]])) > 50.0


def test_a_periodic_face_has_the_pressure_of_the_other_side():
    wave = Fluid(Box((0.0, 0.0), (0.5, 0.5)), pressure=lambda x: 1000.0 + 900.0 * np.sin(8.0 * np.pi * x[:, 0]))
    ring = Scene(
        (0.0, 0.0), (0.5, 0.5), 0.025, wave, dict.fromkeys(("x_min", "x_max"), PERIODIC), 0.0, reference_speed=2.2
    )
    solver = Solver(ring, device="cpu")
    places = np.array([[0.0, 0.25], [0.5, 0.25], [0.25, 0.25], [0.01, 0.25], [0.26, 0.25]])
    left, right, middle, near, inside = diagnostics.pressure_at(solver, places)
    assert left == pytest.approx(right, rel=1e-6)
    assert left == pytest.approx(1000.0, rel=1e-3)
    assert middle == pytest.approx(1000.0, rel=1e-3)
    assert near == pytest.approx(inside, rel=1e-3)  # half a box on, the wave is the same
