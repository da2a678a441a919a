"""Numbers that change between steps: no world starts anew, and only what was left out is compiled."""

import numpy as np
import pytest

from fluidgym.diagnostics import measure, pressure_at
from fluidgym.scene import NO_SLIP_WALL, PERIODIC, Body, Box, Fluid, Material, Scene
from fluidgym.scheme import MUELLER, Scheme
from fluidgym.solver import Solver
from fluidgym.sph.state_equation import LINEAR, TAIT

BOX = dict(lower=(0.0, 0.0), upper=(1.0, 1.0), particle_spacing=0.05)
SIDES = dict.fromkeys(("x_min", "x_max", "y_min", "y_max"), PERIODIC)


def shear(viscosity):
    """A periodic box of sheared fluid; the shear decays at nu (2 pi)^2."""
    wave = Fluid(
        Box((0.0, 0.0), (1.0, 1.0)), velocity=lambda x: np.stack([np.sin(2 * np.pi * x[:, 1]), 0 * x[:, 1]], 1)
    )
    material = Material(viscosity=viscosity)
    return Scene(**BOX, fluid=[wave], faces=SIDES, gravity=0.0, material=material, reference_speed=1.0)


def decay_rate(solver, world):
    """Rate at which the shear of a world decays over the next 0.1 s [1/s]."""
    before = measure(solver, world).kinetic_energy
    solver.advance(0.1)
    return -0.5 * np.log(measure(solver, world).kinetic_energy / before) / 0.1


def test_each_world_has_the_viscosity_it_is_given(device):
    solver = Solver(shear(0.01), Scheme(artificial_viscosity=0.0), num_worlds=2, device=device)
    assert decay_rate(solver, 0) == pytest.approx(0.01 * (2 * np.pi) ** 2, rel=0.1)
    solver.set_parameters(viscosity=[0.01, 0.04])
    assert decay_rate(solver, 0) == pytest.approx(0.01 * (2 * np.pi) ** 2, rel=0.1)
    solver.reset()
    solver.advance(0.1)
    assert decay_rate(solver, 1) == pytest.approx(0.04 * (2 * np.pi) ** 2, rel=0.1)
    np.testing.assert_array_equal(solver.parameter("viscosity"), [0.01, 0.04])


def test_viscosity_that_was_left_out_is_compiled_in_when_it_is_wanted(device):
    solver = Solver(shear(0.0), Scheme(artificial_viscosity=0.0), device=device)
    without = solver._kernels.kick
    solver.advance(0.1)
    solver.set_parameters(viscosity=0.02)
    assert solver._kernels.kick is not without
    assert solver.time[0] == pytest.approx(0.1)
    assert decay_rate(solver, 0) == pytest.approx(0.02 * (2 * np.pi) ** 2, rel=0.1)
    with_it = solver._kernels.kick
    solver.set_parameters(viscosity=0.03)
    assert solver._kernels.kick is with_it  # a value, not a structure
    solver.set_parameters(viscosity=0.0)
    assert solver._kernels.kick is without  # kept from before


def splash(jitter=0.25):
    """Uneven water with a free surface, so that neither diffusion nor damping has nothing to do."""
    water = [Fluid(Box((0.0, 0.0), (0.5, 0.6)), pressure="hydrostatic")]
    return Scene(**BOX, fluid=water, jitter=jitter, reference_speed=3.5)


@pytest.mark.parametrize("name", ["density_diffusion", "acoustic_damping"])
def test_diffusion_and_damping_that_were_left_out_work_when_they_are_wanted(name, device):
    value = {"density_diffusion": 0.1, "acoustic_damping": 0.5}[name]
    without, with_it = Scheme(**{name: 0.0}), Scheme(**{name: value})
    solver, never = (Solver(splash(), without, num_worlds=2, device=device) for _ in range(2))
    for each in (solver, never):
        each.step(20, 0.001)
    solver.set_parameters(**{name: value})
    saved, other = solver.save(), Solver(splash(), with_it, num_worlds=2, device=device)
    assert solver.max_step == other.max_step
    assert solver._structure == other._structure
    other.restore(saved)
    late = Solver(splash(), without, num_worlds=2, device=device)
    late.restore(saved)  # takes the parameter with it
    for each in (solver, never, other, late):
        each.step(20, 0.001)
    expected, found = solver.save(), [each.save() for each in (never, other, late)]
    n = 2 * solver.capacity
    for key in ("position", "velocity", "density_error", "acceleration", "identity"):
        for same in found[1:]:
            np.testing.assert_array_equal(same[key][..., :n], expected[key][..., :n], err_msg=key)
    assert np.abs(found[0]["density_error"][:n] - expected["density_error"][:n]).max() > 1e-5
    solver.set_parameters(**{name: 0.0})
    assert solver._structure == never._structure
    assert solver.max_step == never.max_step
    solver.step(5)


def test_a_world_without_diffusion_or_damping_beside_one_with_them_has_none(device):
    off = {"density_diffusion": 0.0, "acoustic_damping": 0.0}
    solver = Solver(splash(), num_worlds=2, device=device)
    solver.set_parameters(
        **{name: [0.0, value] for name, value in (("density_diffusion", 0.1), ("acoustic_damping", 0.5))}
    )
    alone = Solver(splash(), Scheme(**off), device=device)
    for each in (solver, alone):
        each.step(20, 0.001)
    scale = np.abs(alone.particles().density / 1000.0 - 1.0).max()
    difference = [
        np.abs(solver.particles(world).density - alone.particles().density).max() / 1000.0 for world in (0, 1)
    ]
    assert difference[0] < 1e-4 * scale < 0.01 * difference[1]


def test_pressure_outlives_a_change_of_the_sound_speed(device):
    tank = Scene(**BOX, fluid=[Fluid(Box((0.0, 0.0), (1.0, 0.5)), pressure="hydrostatic")])
    solver = Solver(tank, num_worlds=2, device=device)
    solver.advance(0.5)
    before, step = solver.particles(1).pressure, solver.max_step
    c_0 = solver.parameter("sound_speed")[0]
    solver.set_parameters(sound_speed=[c_0, 2.0 * c_0])
    np.testing.assert_allclose(solver.particles(1).pressure, before, rtol=1e-4, atol=1.0)
    assert 0.5 * step < solver.max_step < 0.6 * step
    solver.advance(0.3)
    for world in range(2):
        depth = pressure_at(solver, np.array([[0.5, 0.1]]), world)[0]
        assert depth == pytest.approx(1000.0 * 9.81 * 0.4, rel=0.1)
    errors = [measure(solver, world).largest_density_error for world in range(2)]
    assert errors[1] == pytest.approx(0.25 * errors[0], rel=0.3)


def test_stiffness_of_penalty_walls_changes_live(device):
    water = [Fluid(Box((0.0, 0.0), (1.0, 0.5)))]
    scene = Scene(**BOX, fluid=water, material=Material(viscosity=0.05, sound_speed=30.0), reference_speed=3.0)
    solver = Solver(scene, MUELLER, num_worlds=2, device=device)
    solver.set_parameters(wall_stiffness=[0.5, 0.05])
    solver.advance(0.3)
    lowest = [solver.particles(world).position[:, 1].min() for world in range(2)]
    assert lowest[1] < lowest[0] - 0.002


def test_changes_are_saved_and_restored(device):
    solver = Solver(shear(0.01), device=device)
    saved = solver.save()
    solver.set_parameters(viscosity=0.05, sound_speed=20.0)
    solver.restore(saved)
    assert solver.parameter("viscosity")[0] == 0.01
    assert solver.parameter("sound_speed")[0] == pytest.approx(10.0)
    fresh = Solver(shear(0.01), device=device)
    for each in (solver, fresh):
        each.advance(0.1)
    np.testing.assert_array_equal(solver.particles().velocity, fresh.particles().velocity)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colour": 1.0}, "Solver.set_parameters 'colour' is unknown; use viscosity, sound_speed, thermal_diffusivity"),
        ({"viscosity": -1.0}, "Solver.set_parameters viscosity[0] = -1 is outside 0 to inf; use a larger number"),
        ({"viscosity": [1.0, 2.0, 3.0]}, "Solver.set_parameters viscosity has shape (3,), limit (1,); give one number"),
        ({"sound_speed": 1.0}, "Solver.set_parameters sound_speed[0] = 1 is outside 5 to inf"),
        ({"artificial_viscosity": 30.0}, "Solver.set_parameters artificial_viscosity[0] = 30 is outside 0 to 1; use a"),
        ({"gamma": 5.0}, "Solver.set_parameters gamma is of no effect under LINEAR; use Scheme(state_equation=TAIT)"),
        ({"wall_damping": 0.5}, "Solver.set_parameters wall_damping is of no effect under MirrorWalls; use Scheme("),
        (
            {"thermal_diffusivity": 1.0},
            "Solver.set_parameters thermal_diffusivity is of no effect in a scene that keeps",
        ),
    ],
)
def test_bad_parameter_is_refused_in_one_line_and_changes_nothing(changes, message):
    solver = Solver(shear(0.01), device="cpu")
    with pytest.raises(ValueError) as error:
        solver.set_parameters(density_diffusion=0.2, **changes)
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)
    assert solver.parameter("density_diffusion")[0] == 0.1


def test_forces_not_asked_for_are_refused():
    solver = Solver(shear(0.01), device="cpu")
    with pytest.raises(RuntimeError, match=r"make the Solver\(report_forces=True\)"):
        _ = solver.face_force


def test_scheme_and_scene_that_do_not_go_together_are_refused():
    tank = dict(**BOX, fluid=[Fluid(Box((0.0, 0.0), (1.0, 0.5)))])
    sticky = Scene(**tank, faces={"y_min": NO_SLIP_WALL})
    with pytest.raises(ValueError, match="cannot be kept by Scheme"):
        Solver(sticky, MUELLER, device="cpu")


def test_pressure_at_a_thin_gate_is_that_of_its_side(device):
    water = [
        Fluid(Box((0.0, 0.0), (0.5, 0.8)), pressure="hydrostatic"),
        Fluid(Box((0.51, 0.0), (1.0, 0.4)), pressure="hydrostatic"),
    ]
    gate = {"gate": Body(Box((0.5, 0.0), (0.51, 1.0)))}
    solver = Solver(
        Scene(**{**BOX, "particle_spacing": 0.025}, fluid=water, bodies=gate),
        Scheme(state_equation=TAIT),
        device=device,
    )
    left, right = pressure_at(solver, np.array([[0.49, 0.2], [0.52, 0.2]]))
    assert left == pytest.approx(1000.0 * 9.81 * 0.6, rel=0.05)
    assert right == pytest.approx(1000.0 * 9.81 * 0.2, rel=0.1)


@pytest.mark.parametrize("equation", [LINEAR, TAIT], ids=["linear", "Tait"])
def test_pressure_outlives_a_reset_under_another_sound_speed(equation, device):
    tank = Scene(**BOX, fluid=[Fluid(Box((0.0, 0.0), (1.0, 0.5)), pressure="hydrostatic")])
    solver = Solver(tank, Scheme(state_equation=equation), num_worlds=2, device=device)
    start = solver.particles().pressure
    solver.set_parameters(sound_speed=[2.0 * tank.sound_speed, tank.sound_speed])
    np.testing.assert_allclose(solver.particles(0).pressure, start, rtol=1e-4, atol=0.5)
    solver.reset()
    for world in range(2):
        np.testing.assert_allclose(solver.particles(world).pressure, start, rtol=1e-4, atol=0.5)
    solver.set_start([0], [tank.sample()])
    solver.reset()
    np.testing.assert_allclose(solver.particles(0).pressure, start, rtol=1e-4, atol=0.5)
    energies = [measure(solver, world).elastic_energy for world in range(2)]
    assert energies[0] == pytest.approx(energies[1] / 4.0, rel=0.04)  # p^2 / (2 rho c_0^2), Tait to first order


def test_heat_goes_off_and_on_again(device):
    fluid = [Fluid(Box((0.0, 0.0), (1.0, 0.5)), temperature=lambda x: x[:, 0])]
    solver = Solver(Scene(**BOX, fluid=fluid, material=Material(thermal_diffusivity=0.01)), device=device)
    saved, before = solver.save(), solver.particles().temperature
    solver.set_parameters(thermal_diffusivity=0.0)
    solver.advance(0.1)
    particles = solver.particles()
    assert particles.temperature is not None
    np.testing.assert_array_equal(particles.temperature, before)
    solver.restore(saved)
    solver.advance(0.1)
    assert np.ptp(solver.particles().temperature) < np.ptp(particles.temperature) - 0.01
