"""Motions: what they set the controls to, and where they take walls and fluid."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fluidgym.experiment import Experiment, Keyframes, Sine, Steps, View, drive
from fluidgym.scene import OPEN, Ball, Body, Box, Face, Fluid, Inflow, Material, Scene
from fluidgym.solver import Solver

TANK = Scene(
    lower=(0.0, 0.0),
    upper=(1.2, 1.0),
    particle_spacing=0.05,
    fluid=[Fluid(Box((0.2, 0.0), (1.0, 0.3)), pressure="hydrostatic")],
    faces={
        "x_min": Face(moving=True, travel=(0.0, 0.4), start=0.2),
        "x_max": Face(moving=True, travel=(0.9, 1.2)),
    },
    bodies={
        "gate": Body(Box((0.6, 0.0), (0.61, 0.8)), moving=True, travel=((0.0, 0.0), (0.0, 0.5))),
        "post": Body(Ball((0.4, 0.6), 0.1)),
    },
    inflows={"jet": Inflow((0.3, 0.9), (1.0, 0.0), width=0.1, speed=0.5, max_speed=1.0)},
)
PISTON = Scene(
    lower=(0.0, 0.0),
    upper=(1.0, 0.5),
    particle_spacing=0.05,
    fluid=[Fluid(Box((0.2, 0.0), (1.0, 0.2)), pressure="hydrostatic")],
    faces={"x_min": Face(moving=True, travel=(0.0, 0.4), start=0.2)},
)


def controls(*motions, scene=TANK, at=None):
    """What the targets are set to at times [s], each the end of a short piece."""
    experiment = Experiment(scene, 2.0, motions=motions)
    if at is None:
        at = np.linspace(0.0, 2.0, 201)
    return experiment.controls(np.asarray(at))


def test_a_sine_swings_about_the_value_in_the_scene():
    found = controls(Sine("inflows.jet", 0.4, 1.0), at=[0.0, 0.5, 1.0])["inflows.jet"]
    assert found == pytest.approx([0.9, 0.1])
    gravity = controls(Sine("gravity", 2.0, 1.0, phase=math.pi / 2, axis="x"), at=[0.0, 1e-9])["gravity"]
    assert gravity[0] == pytest.approx([2.0, -9.81])


def test_a_control_that_is_held_is_that_of_the_middle_of_a_piece():
    found = controls(Sine("gravity", 2.0, 1.0, axis="x"), at=[0.0, 0.5])["gravity"]
    assert found[0, 0] == pytest.approx(2.0)


def test_sines_add_up_on_top_of_what_sets_the_value():
    one, other = Sine("faces.x_max", 0.1, 1.0), Sine("faces.x_max", 0.2, 0.5, phase=0.3)
    steps = Steps("faces.x_max", times=[0.5], values=[-0.4])
    together = controls(one, steps, other)["faces.x_max"]
    apart = [controls(motion)["faces.x_max"] for motion in (one, steps, other)]
    assert together == pytest.approx(sum(apart))


def test_an_amplitude_grows_over_its_ramp():
    t = np.linspace(0.0, 2.0, 2001)
    found = controls(Sine("faces.x_max", 0.3, 0.1, ramp=1.0), at=t)["faces.x_max"]
    peaks = np.abs(found).reshape(20, 100).max(axis=1)
    assert (np.diff(peaks[:10]) > 0.0).all()
    assert peaks[10:] == pytest.approx(0.3, rel=1e-3)
    assert peaks[0] < 0.02


def test_a_displacement_is_the_integral_of_its_velocity():
    t = np.linspace(0.0, 2.0, 20001)
    sine = Sine("faces.x_min", 0.1, 0.7, phase=0.4, ramp=0.9, displacement=True)
    velocity = controls(sine, scene=PISTON, at=t)["faces.x_min"]
    place = np.cumsum(velocity) * (t[1] - t[0])
    grown = np.sin(0.5 * np.pi * np.clip(t[1:] / 0.9, 0.0, 1.0)) ** 2
    assert place == pytest.approx(0.1 * grown * np.sin(2 * np.pi * t[1:] / 0.7 + 0.4), abs=1e-4)


def test_keyframes_are_joined_by_straight_lines():
    motion = Keyframes("bodies.gate", times=[0.5, 1.0], values=[[0.0, 0.0], [0.4, 0.8]])
    found = controls(motion, at=[0.0, 0.25, 0.5, 0.75, 1.0, 2.0])["bodies.gate"]
    assert found == pytest.approx(np.array([[0, 0], [0, 0], [0.2, 0.4], [0.4, 0.8], [0.4, 0.8]]))
    motion = Keyframes("gravity", times=[0.0, 1.0], values=[-9.81, 0.0], axis="y")
    found = controls(motion, at=[0.0, 1.0, 2.0])["gravity"]
    assert found == pytest.approx(np.array([[0.0, -4.905], [0.0, 0.0]]))


def test_steps_start_from_the_value_in_the_scene():
    motion = Steps("inflows.jet", times=[0.5, 1.0], values=[1.0, 0.0], rise=0.2)
    found = controls(motion, at=[0.0, 0.5, 0.7, 1.0, 1.2, 2.0])["inflows.jet"]
    assert found == pytest.approx([0.5, 0.75, 1.0, 0.5, 0.0])
    instants = Experiment(TANK, 2.0, motions=[motion]).instants(0.0, 2.0)
    assert ((instants > 0.5 - 1e-9) & (instants < 0.7 + 1e-9)).sum() > 10  # a slope of what is held is cut small


def test_controls_are_set_anew_where_a_motion_bends_and_often_enough():
    sine = Sine("faces.x_max", 0.1, 0.4)
    steps = Steps("faces.x_min", times=[0.333], values=[0.1], rise=0.05)
    instants = Experiment(TANK, 1.0, motions=[sine, steps]).instants(0.1, 0.5)
    for bend in (0.1, 0.333, 0.383, 0.5):
        assert np.abs(instants - bend).min() < 1e-12
    assert 0.0 < np.diff(instants).min()
    assert np.diff(instants).max() < 0.4 / 99
    assert Experiment(TANK, 1.0).instants(0.1, 0.5).tolist() == [0.1, 0.5]


def test_a_wall_goes_where_a_displacement_takes_it():
    sine = Sine("faces.x_min", 0.1, 0.5, ramp=0.5, displacement=True)
    experiment = Experiment(PISTON, 1.0, motions=[sine])
    solver = Solver(PISTON, num_worlds=2, device="cpu")
    # A quarter, three quarters, one and a quarter periods.
    for t, place in (
        (0.125, 0.1 * math.sin(math.pi / 8) ** 2),
        (0.375, -0.1 * math.sin(3 * math.pi / 8) ** 2),
        (0.625, 0.1),
    ):
        drive(experiment, solver, t)
        assert solver.time == pytest.approx([t, t])
        assert solver.face_position("x_min") == pytest.approx([0.2 + place] * 2, abs=5e-4)
    frames = Keyframes("faces.x_min", times=[0.1, 0.3, 0.5], values=[0.0, 0.1, -0.05], displacement=True)
    solver.reset()
    experiment = Experiment(PISTON, 1.0, motions=[frames])
    for t in np.linspace(0.05, 0.6, 12):
        drive(experiment, solver, float(t))
    assert solver.face_position("x_min") == pytest.approx([0.15] * 2, abs=1e-6)


def test_a_wall_keeps_the_velocity_of_a_step_until_its_travel_ends():
    experiment = Experiment(PISTON, 1.0, motions=[Steps("faces.x_min", times=[0.1], values=[0.5], rise=0.1)])
    solver = Solver(PISTON, device="cpu")
    assert drive(experiment, solver, 0.3) == pytest.approx(0.3 / solver.max_step, abs=3)
    assert solver.face_position("x_min") == pytest.approx([0.2 + 0.5 * 0.05 + 0.5 * 0.1], abs=1e-6)
    drive(experiment, solver, 1.0)
    assert solver.face_position("x_min") == pytest.approx([0.4])


def test_fluid_in_the_open_follows_a_gravity_that_swings():
    faces = dict.fromkeys(("x_min", "x_max", "y_min", "y_max"), OPEN)
    block = Fluid(Box((-0.2, -0.2), (0.2, 0.2)))
    scene = Scene((-2.0, -2.0), (2.0, 2.0), 0.05, [block], faces, gravity=0.0, reference_speed=1.0)
    experiment = Experiment(scene, 1.0, motions=[Sine("gravity", 3.0, 1.0, axis="x")])
    solver = Solver(scene, device="cpu")
    drive(experiment, solver, 0.25)
    drive(experiment, solver, 0.5)
    velocity = solver.particles().velocity.mean(axis=0)
    assert velocity == pytest.approx([3.0 / math.pi, 0.0], abs=2e-3)  # the integral of half a sine


def test_a_step_back_in_time_is_refused():
    experiment, solver = Experiment(PISTON, 1.0), Solver(PISTON, device="cpu")
    drive(experiment, solver, 0.1)
    with pytest.raises(ValueError, match=r"until = 0\.1 s is not after"):
        drive(experiment, solver, 0.1)


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        (Sine("bodies.post", 0.1, 1.0, axis="y"), ["bodies.post", "moving=True"]),
        (Sine("faces.y_max", 0.1, 1.0), ["faces.y_max", "moving=True"]),
        (Sine("bodies.gat", 0.1, 1.0, axis="y"), ["bodies.gat", "unknown", "bodies.gate"]),
        (Sine("wind", 0.1, 1.0), ["wind", "unknown", "gravity", "inflows.jet"]),
        (Sine("bodies.gate", 0.1, 1.0), ["axis is missing", "bodies.gate"]),
        (Sine("bodies.gate", 0.1, 1.0, axis="z"), ["axis = 'z'", "'x' or 'y'"]),
        (Sine("faces.x_max", 0.1, 1.0, axis="x"), ["one number"]),
        (Steps("inflows.jet", [0.1], [[0.1, 0.2]]), ["one number"]),
        (Steps("gravity", [0.1], [[0.1, 0.2, 0.3]]), ["3 components", "give 2"]),
        (Steps("inflows.jet", [0.1], [1.1]), ["inflows.jet", "1.1 m/s", "largest speed 1"]),
        (Steps("inflows.jet", [0.1], [-0.2]), ["inflows.jet", "-0.2 m/s"]),
        (Steps("faces.x_max", [0.1], [-90.0]), ["faces.x_max", "90 m/s", "reference_speed"]),
        (Sine("faces.x_min", 0.3, 1.0, displacement=True), ["faces.x_min", "travel", "widen"]),
        (Keyframes("bodies.gate", [0, 1], [0.0, 0.7], axis="y", displacement=True), ["bodies.gate", "travel"]),
        (Sine("faces.x_max", 0.1, 1e-7), ["period", "longer"]),
    ],
)
def test_a_motion_that_does_not_fit_the_scene_is_refused(motion, said):
    with pytest.raises(ValueError) as refused:
        Experiment(TANK, 2.0, motions=[motion])
    message = str(refused.value)
    assert len(message.splitlines()) == 1
    assert all(word in message for word in said), message


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Sine("gravity", 1.0, 0.0), "Sine.period = 0 s"),
        (lambda: Sine("gravity", math.nan, 1.0), "Sine.amplitude"),
        (lambda: Sine("gravity", 1.0, 1.0, ramp=-1.0), "Sine.ramp = -1 s"),
        (lambda: Sine("gravity", 1.0, 1.0, axis="w"), "Sine.axis = 'w'"),
        (lambda: Sine("inflows.jet", 1.0, 1.0, displacement=True), "Sine.displacement is of no effect"),
        (lambda: Keyframes("gravity", [0.0], [1.0]), "1 times and 1 values"),
        (lambda: Keyframes("gravity", [0.0, 1.0], [1.0]), "2 times and 1 values"),
        (lambda: Keyframes("gravity", [1.0, 1.0], [1.0, 2.0]), "Keyframes.times = 1 s"),
        (lambda: Steps("gravity", [-1.0], [1.0]), "Steps.times = -1 s"),
        (lambda: Steps("gravity", [0.0, 0.1], [1.0, 2.0], rise=0.2), "Steps.rise = 0.2 s"),
        (lambda: Steps("gravity", [0.0, 1.0], [[1.0, 2.0], [1.0]]), "different lengths"),
        (lambda: Steps("gravity", [0.0, 1.0], [[1.0, 2.0], 1.0]), "only numbers or only vectors"),
        (lambda: Steps("gravity", [0.0], [[1.0, 2.0]], axis="x"), "Steps.axis = 'x'"),
        (lambda: View(colour="red"), "View.colour = 'red'"),
        (lambda: View(value_range=(1.0, 1.0)), "View.value_range"),
        (lambda: View(frames_per_second=100.0), "View.frames_per_second = 100"),
        (lambda: View(size=(640, 4)), "View.size"),
        (lambda: Experiment(TANK, 0.0), "Experiment.duration = 0 s"),
        (lambda: Experiment(TANK, 1.0, title="a\nb"), "Experiment.title"),
        (lambda: Experiment(TANK, 1.0, view=View(colour="temperature")), "thermal_diffusivity"),
        (lambda: Experiment(TANK, 1.0, motions=[Steps("faces.x_max", [0.1], [-0.1])] * 2), "put them into one"),
    ],
)
def test_what_is_out_of_its_limits_is_refused_in_one_line(make, said):
    with pytest.raises(ValueError) as refused:
        make()
    assert len(str(refused.value).splitlines()) == 1
    assert said in str(refused.value)


def test_two_motions_may_set_two_components():
    both = [Steps("gravity", [0.1], [1.0], axis="x"), Steps("gravity", [0.1], [-5.0], axis="y")]
    assert controls(*both, at=[0.0, 2.0])["gravity"][0] == pytest.approx([1.0, -5.0])


def test_temperature_can_be_drawn_where_heat_is_conducted():
    scene = replace(PISTON, material=Material(thermal_diffusivity=1e-6))
    assert Experiment(scene, 1.0, view=View(colour="temperature")).view.colour == "temperature"
