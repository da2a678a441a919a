"""A picture of a solver's world: everything where it is now."""

import numpy as np
import pytest

from fluidgym import picture as module
from fluidgym.parts import Body, Face, Fluid, Inflow, Material, Outflow
from fluidgym.picture import picture, usual_range
from fluidgym.scene import Ball, Box, Scene
from fluidgym.solver import Solver

SCENE = Scene(
    lower=(0.0, 0.0),
    upper=(2.0, 1.0),
    particle_spacing=0.1,
    fluid=[Fluid(Box((0.2, 0.0), (1.0, 0.5)), pressure="hydrostatic", temperature=20.0)],
    faces={"x_max": Face(moving=True, travel=(1.5, 2.0)), "y_max": Face("open")},
    material=Material(thermal_diffusivity=1e-6),
    bodies={
        "gate": Body(Box((1.2, 0.1), (1.21, 0.6)), moving=True),
        "ball": Body(Ball((1.6, 0.5), 0.1), temperature=80.0),
    },
    inflows={
        "jet": Inflow((0.1, 0.8), (1.0, 0.0), width=0.2, speed=1.0),
        "shut": Inflow((0.1, 0.5), (1.0, 0.0), width=0.1, max_speed=1.0),
    },
    outflows={"drain": Outflow(Box((1.0, 0.0), (1.4, 0.1)))},
)


@pytest.fixture(scope="module")
def solver():
    """Two worlds, the gate raised and the wall moved in the second."""
    solver = Solver(SCENE, num_worlds=2, device="cpu")
    for _ in range(2):
        solver.body_velocity[1, solver.body_index("gate")] = (0.0, 1.0)
        solver.face_velocity[1, solver.face_index("x_max")] = -0.5
        solver.advance(0.1)
    return solver


@pytest.fixture
def drawn(monkeypatch):
    """What draw_frame was asked for."""
    calls = []

    def draw_frame(positions, values, **arguments):
        calls.append({"positions": positions, "values": values, **arguments})
        return original(positions, values, **arguments)

    original = module.draw_frame
    monkeypatch.setattr(module, "draw_frame", draw_frame)
    return calls


def test_everything_is_drawn_where_it_is_now(solver, drawn):
    frame = picture(solver, 1, time=0.2, title="here")
    assert frame.shape == (400, 640, 3)
    (asked,) = drawn
    assert asked["positions"] == pytest.approx(solver.particles(1).position)
    gate, ball = asked["bodies"]
    assert gate["lower"] == pytest.approx([1.2, 0.25], abs=1e-6)  # up by half of 0.1 m, then by 0.1 m
    assert gate["upper"] == pytest.approx([1.21, 0.75], abs=1e-6)
    assert (gate["moving"], ball["moving"]) == (True, False)
    assert ball["center"] == pytest.approx([1.6, 0.5])
    assert ball["radius"] == 0.1
    assert asked["faces"]["x_max"]["position"] == pytest.approx(2.0 - 0.025 - 0.05)
    assert asked["faces"]["y_max"]["kind"] == "open"
    jet, shut = asked["inflows"]
    assert jet["center"] == pytest.approx([0.1, 0.8])
    assert jet["length"] == pytest.approx(0.5)
    assert (jet["on"], shut["on"]) == (True, False)
    assert asked["outflows"] == [{"name": "drain", "lower": (1.0, 0.0), "upper": (1.4, 0.1)}]
    assert (asked["time"], asked["title"]) == (0.2, "here")


def test_worlds_are_drawn_each_for_itself(solver, drawn):
    one, other = picture(solver, 0), picture(solver, 1)
    assert (one != other).any()
    assert drawn[0]["bodies"][0]["lower"] == pytest.approx([1.2, 0.1])


@pytest.mark.parametrize(
    ("colour", "label", "unit"),
    [
        ("speed", "speed [m/s]", 1.0),
        ("pressure", "pressure [kPa]", 1000.0),
        ("density", "density [kg/m3]", 1.0),
        ("temperature", "temperature", 1.0),
    ],
)
def test_fluid_is_coloured_by_what_is_asked_for(colour, label, unit, solver, drawn):
    picture(solver, colour=colour)
    picture(solver, colour=colour, value_range=(0.0, 2000.0))
    particles = solver.particles()
    values = np.linalg.norm(particles.velocity, axis=1) if colour == "speed" else getattr(particles, colour)
    assert drawn[0]["values"] == pytest.approx(values / unit)
    assert drawn[0]["label"] == label
    low, high = usual_range(SCENE, colour)
    assert drawn[0]["value_range"] == pytest.approx((low / unit, high / unit))
    assert drawn[1]["value_range"] == pytest.approx((0.0, 2000.0 / unit))


def test_usual_ranges_suit_the_scene():
    head = 0.85  # the top of the pipe of the jet [m]
    assert usual_range(SCENE, "speed")[1] == pytest.approx(np.sqrt(9.81 * head), rel=0.05)
    assert usual_range(SCENE, "pressure")[1] == pytest.approx(1000.0 * 9.81 * head, rel=0.1)
    low, high = usual_range(SCENE, "density")
    assert low < 1000.0 < high < 1011.0
    assert usual_range(SCENE, "temperature") == (0.0, 80.0)


def test_a_low_pressure_is_not_drawn_in_kilopascals(solver, drawn):
    picture(solver, colour="pressure", value_range=(0.0, 500.0))
    assert drawn[0]["label"] == "pressure [Pa]"
