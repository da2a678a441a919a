"""Solids in the box: they hold fluid, push it, part it, and bear its force."""

import numpy as np
import pytest

from fluidgym.diagnostics import front, measure, rms_speed
from fluidgym.scene import PERIODIC, Ball, Body, Box, Face, Fluid, Material, Scene
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver

G, RHO = 9.81, 1000.0

each_dim = pytest.mark.parametrize("dim", [2, 3], ids=["2D", "3D"])
each_shape = pytest.mark.parametrize("kind", ["box", "ball"])


def place(x, z, dim, y=0.0):
    """A point from x and height, and y where there is one."""
    return (x, z) if dim == 2 else (x, y, z)


def gated(dim, thickness, spacing, right=0.0, **changes):
    """Water 0.5 m high to the left of a gate at x = 0.5, and so high to its right."""
    width = 0.2
    fluid = [Fluid(Box(place(0.0, 0.0, dim), place(0.5, 0.5, dim, width)), pressure="hydrostatic")]
    if right:
        fluid.append(
            Fluid(
                Box(place(0.5 + thickness, 0.0, dim), place(1.1 + thickness, right, dim, width)), pressure="hydrostatic"
            )
        )
    gate = Box(place(0.5, 0.0, dim), place(0.5 + thickness, 0.6, dim, width))
    return Scene(
        lower=place(0.0, 0.0, dim),
        upper=place(1.1 + thickness, 0.8, dim, width),
        particle_spacing=spacing,
        fluid=fluid,
        bodies={"gate": Body(gate, moving=True)},
        jitter=0.02,
        **changes,
    )


@each_dim
@pytest.mark.parametrize("thickness", [0.05, 0.002], ids=["plate", "sheet"])
def test_closed_gate_holds_still_water_and_bears_its_push(dim, thickness, device):
    scene = gated(dim, thickness, 0.025)
    solver = Solver(scene, device=device, report_forces=True)
    solver.advance(0.5)
    solver.advance(0.5)
    particles = solver.particles()
    assert len(particles) == solver.started[0]
    assert particles.position[:, 0].max() < 0.5
    assert rms_speed(particles) < 0.02 * np.sqrt(G * 0.5)
    depth = 1.0 if dim == 2 else 0.2
    push = 0.5 * RHO * G * 0.5**2 * depth
    assert solver.body_force[0, 0, 0] == pytest.approx(push, rel=0.03)
    # What the gate bears, the wall on the other side bears too: nothing else holds the water.
    assert solver.face_force[0, 0, 0] == pytest.approx(-solver.body_force[0, 0, 0], rel=0.02)


@pytest.mark.slow
@each_dim
def test_closed_gate_holds_still_water_for_ten_seconds(dim, device):
    scene = gated(dim, 0.01, 0.02 if dim == 2 else 0.025)
    solver = Solver(scene, device=device)
    speeds = []
    for _ in range(10):
        solver.advance(1.0)
        particles = solver.particles()
        assert len(particles) == solver.started[0]
        assert particles.position[:, 0].max() < 0.5
        speeds.append(rms_speed(particles))
    assert solver.state.clamped.numpy()[0] == 0
    assert speeds[-1] < 0.004 * np.sqrt(G * 0.5)
    assert np.mean(speeds[5:]) < np.mean(speeds[:5])


@each_dim
def test_a_sheet_lets_no_influence_across(dim, device):
    # The water on the right moves the same whether there is water to the left of the sheet or not.
    spacing = 0.025
    both = gated(dim, 0.002, spacing, right=0.25)
    one = Scene(**{**vars_of(both), "fluid": both.fluid[1:], "reference_speed": both.speed_scale})
    both = Scene(**{**vars_of(both), "reference_speed": both.speed_scale})
    finals = []
    for scene in (both, one):
        solver = Solver(scene, device=device)
        start = solver.particles()
        right = start.chosen(start.position[:, 0] > 0.5)
        rng = np.random.default_rng(3)
        right = right.chosen(np.lexsort(right.position.T))
        velocity = 0.1 * rng.standard_normal(right.position.shape)
        left = start.chosen(start.position[:, 0] < 0.5)
        # Put the same right half into both, jitter and all.
        if scene is both:
            kept = right
        joined = [part for part in (left, kept) if len(part)]
        solver.set_start(
            [0],
            [
                type(start)(
                    position=np.concatenate([part.position for part in joined]),
                    velocity=np.concatenate([np.zeros_like(left.velocity), velocity]),
                    density=np.concatenate([part.density for part in joined]),
                    pressure=np.concatenate([part.pressure for part in joined]),
                    identity=np.arange(len(left) + len(kept)),
                )
            ],
        )
        solver.reset()
        solver.step(20, 0.5 * solver.max_step)
        particles = solver.particles()
        finals.append(particles.chosen(slice(len(left), None)))
    np.testing.assert_allclose(finals[0].velocity, finals[1].velocity, atol=2e-4)
    np.testing.assert_allclose(finals[0].pressure, finals[1].pressure, atol=1.0)
    assert np.abs(finals[0].velocity).max() > 0.05


def vars_of(scene):
    """The fields of a scene."""
    return {name: getattr(scene, name) for name in scene.__dataclass_fields__}


@each_dim
@each_shape
def test_submerged_body_is_lifted_by_the_weight_it_displaces(dim, kind, device):
    spacing, radius = (0.02, 0.16) if dim == 2 else (0.04, 0.16)
    side = 0.8 if dim == 2 else 0.64
    middle = (0.5 * side,) * dim
    if kind == "ball":
        shape = Ball(middle, radius)
        volume = np.pi * radius**2 if dim == 2 else 4.0 / 3.0 * np.pi * radius**3
    else:
        shape = Box(tuple(x - radius for x in middle), tuple(x + radius for x in middle))
        volume = (2.0 * radius) ** dim
    scene = Scene(
        (0.0,) * dim,
        (side,) * (dim - 1) + (1.2 * side,),
        spacing,
        [Fluid(Box((0.0,) * dim, (side,) * dim), pressure="hydrostatic")],
        bodies={"body": Body(shape)},
    )
    solver = Solver(scene, device=device, report_forces=True)
    solver.advance(0.5)
    lifts = []
    for _ in range(5):
        solver.advance(0.1)
        lifts.append(solver.body_force[0, 0])
    force = np.mean(lifts, axis=0)
    # The body is a few spacings wide, and the water keeps half a spacing off a round one, a little more or less.
    within = {(2, "box"): 0.02, (2, "ball"): 0.05, (3, "box"): 0.04, (3, "ball"): 0.12}[dim, kind]
    assert force[-1] == pytest.approx(RHO * G * volume, rel=within)
    assert np.abs(force[:-1]).max() < 0.02 * RHO * G * volume
    assert measure(solver).rms_speed < 0.03 * np.sqrt(G * side)


@each_dim
def test_force_on_body_and_walls_is_what_the_fluid_loses(dim, device):
    # Water runs against a step: impulse of all forces = change of momentum, to rounding.
    scene = Scene(
        (0.0,) * dim,
        (1.0,) * dim,
        0.05,
        [Fluid(Box((0.0,) * dim, (0.4,) * dim), velocity=(0.3,) + (0.0,) * (dim - 1), pressure="hydrostatic")],
        bodies={"step": Body(Box((0.5,) + (0.0,) * (dim - 1), (1.0,) * (dim - 1) + (0.2,)))},
    )
    scheme = Scheme(courant=0.5)
    solver = Solver(scene, scheme, device=device, report_forces=True)
    compared, largest = 0, 0.0
    for _ in range(30):
        before, acceleration, clamped = measure(solver), mean_acceleration(solver), solver.state.clamped.numpy()[0]
        duration, n = 0.02, solver.steps_for(0.02)
        solver.advance(duration)
        if solver.state.clamped.numpy()[0] > clamped:
            continue  # the safety net at a wall stops a particle without a force
        now = measure(solver)
        impulse = now.mass * np.asarray(scene.gravity) * duration
        impulse -= duration * (solver.face_force[0].sum(axis=0) + solver.body_force[0].sum(axis=0))
        # The forces are those at the ends of the steps; the kicks are half of these and half of the step before.
        impulse += 0.5 * duration / n * now.mass * (acceleration - mean_acceleration(solver))
        np.testing.assert_allclose(now.momentum - before.momentum, impulse, atol=1e-4 * now.mass)
        compared, largest = compared + 1, max(largest, solver.body_force[0, 0, 0])
    assert compared > 12
    assert largest > 0.05 * before.mass * G


def mean_acceleration(solver):
    """Mean acceleration of the particles of the only world [m/s2], (dim,)."""
    live = solver.state.now.identity.numpy()[: solver.capacity] >= 0
    return solver.state.now.acceleration.numpy()[:, : solver.capacity][:, live].astype(float).mean(axis=1)


def test_a_body_across_the_box_is_a_wall(device):
    """A piston that is a body and one that is a face send the same wave."""
    tank = dict(particle_spacing=0.025, reference_speed=3.0)
    water = Fluid(Box((0.25, 0.0), (1.25, 0.5)), pressure="hydrostatic")
    as_face = Scene((0.0, 0.0), (1.25, 0.8), fluid=[water], faces={"x_min": Face(moving=True, start=0.25)}, **tank)
    piston = {"piston": Body(Box((0.0, 0.0), (0.25, 0.8)), moving=True)}
    as_body = Scene((-0.5, 0.0), (1.25, 0.8), fluid=[water], bodies=piston, **tank)
    results = []
    for scene in (as_face, as_body):
        solver = Solver(scene, device=device, report_forces=True)
        if scene.bodies:
            solver.body_velocity[0, 0, 0] = 0.5
        else:
            solver.face_velocity[0, 0] = 0.5
        pushes = []
        for _ in range(6):
            solver.advance(0.05)
            pushes.append(-(solver.body_force[0, 0, 0] if scene.bodies else solver.face_force[0, 0, 0]))
        results.append((np.array(pushes), solver.particles().position))
    pushes, positions = zip(*results, strict=True)
    assert pushes[0].max() > 1.2 * 0.5 * RHO * G * 0.5**2
    np.testing.assert_allclose(pushes[1], pushes[0], rtol=0.05)
    assert positions[1][:, 1].max() == pytest.approx(positions[0][:, 1].max(), abs=0.0125)
    assert positions[1].mean(axis=0) == pytest.approx(positions[0].mean(axis=0), abs=2e-3)


def test_nothing_is_shot_through_a_sheet(device):
    # A sheet of a hundredth of the spacing moves against a stream of water.
    scene = Scene(
        (0.0, 0.0),
        (1.0, 1.0),
        0.05,
        [Fluid(Box((0.2, 0.3), (0.4, 0.7)), velocity=(4.0, 0.0))],
        bodies={"sheet": Body(Box((0.5, 0.0), (0.5005, 1.0)), moving=True)},
        reference_speed=8.0,
        gravity=0.0,
    )
    solver = Solver(scene, device=device)
    solver.body_velocity[0, 0, 0] = -3.0
    solver.step(1)
    for _ in range(40):
        solver.step(8)
        sheet = solver.body_position("sheet")[0, 0]
        assert solver.particles().position[:, 0].max() < sheet
        if sheet < 0.35:
            solver.body_velocity[0, 0, 0] = 0.0
    assert np.isfinite(solver.particles().velocity).all()


@each_dim
@pytest.mark.parametrize("kind", ["box", "ball", "company"])
def test_native_and_plain_loops_hide_the_same_neighbours(dim, kind, device):
    def block(low, high):
        return Box(place(low[0], low[1], dim), place(high[0], high[1], dim, 0.3))

    shapes = {
        "box": [block((0.45, 0.1), (0.47, 0.4))],
        "ball": [Ball(place(0.5, 0.3, dim, 0.15), 0.06)],
        # Thick and thin, one upon another, on the floor and off it.
        "company": [block((0.3, 0.0), (0.55, 0.2)), block((0.3, 0.2), (0.4, 0.4)), block((0.57, 0.05), (0.6, 0.3))],
    }[kind]
    scene = Scene(
        place(0.0, 0.0, dim),
        place(0.8, 0.6, dim, 0.3),
        0.05,
        [Fluid(Box(place(0.0, 0.0, dim), place(0.8, 0.5, dim, 0.3)), pressure="hydrostatic")],
        bodies={f"body {n}": Body(shape, slip="no", moving=True) for n, shape in enumerate(shapes)},
        jitter=0.2,
    )
    found = []
    for plain in (False, True):
        solver = Solver(scene, device=device, plain_loops=plain)
        solver.body_velocity[0, 0, 0] = 0.2
        solver.step(4)
        found.append(solver.particles())
    np.testing.assert_allclose(found[0].velocity, found[1].velocity, atol=2e-4)
    np.testing.assert_allclose(found[0].density, found[1].density, atol=2e-3)


def test_body_follows_its_velocity_and_stops_at_the_end_of_its_travel(device):
    gate = Body(Box((0.5, 0.0), (0.55, 0.5)), moving=True, travel=((0.0, 0.0), (0.0, 0.3)))
    scene = Scene((0.0, 0.0), (1.0, 1.0), 0.05, [Fluid(Box((0.0, 0.0), (0.5, 0.3)))], bodies={"gate": gate})
    solver = Solver(scene, num_worlds=2, device=device)
    solver.body_velocity[1, solver.body_index("gate")] = (0.0, 2.0)
    solver.advance(0.1)
    np.testing.assert_allclose(solver.body_position("gate"), [[0.525, 0.25], [0.525, 0.35]], atol=1e-4)
    solver.advance(0.3)
    np.testing.assert_allclose(solver.body_position("gate"), [[0.525, 0.25], [0.525, 0.55]], atol=1e-4)
    solver.reset(np.array([False, True]))
    np.testing.assert_allclose(solver.body_position("gate"), [[0.525, 0.25]] * 2, atol=1e-6)
    saved = solver.save()
    solver.body_velocity = (0.0, 1.0)
    solver.advance(0.1)
    assert solver.body_position("gate")[0, 1] == pytest.approx(0.30, abs=1e-4)
    solver.restore(saved)
    assert solver.body_position("gate")[0, 1] == pytest.approx(0.25, abs=1e-6)


def front_of(scene, device, lift=None, until=0.75):
    """Times over sqrt(H/g), H = 1 m, and fronts [m] of a dam break, its gate lifted at a speed [m/s] if given."""
    solver = Solver(scene, device=device)
    if lift is not None:
        solver.body_velocity = (0.0, lift)
        solver.step(1)
    times, fronts = [], []
    while solver.time[0] < until:
        solver.advance(0.01)
        times.append(solver.time[0] * np.sqrt(G))
        fronts.append(front(solver.particles(), scene))
    return np.array(times), np.array(fronts)


def test_lifted_gate_lets_the_dam_break(device):
    """Within 3 % of the travel of the dam without a gate, after a delay shorter than the gate takes."""
    spacing, speed = 1.0 / 80, 5.0
    tank = dict(lower=(0.0, 0.0), upper=(5.366, 2.0), particle_spacing=spacing)
    water = Box((0.0, 0.0), (2.0, 1.0))
    free = Scene(fluid=[Fluid(water, pressure="released")], **tank)
    gate = {"gate": Body(Box((2.0, 0.0), (2.0 + spacing, 1.2)), moving=True)}
    held = Scene(fluid=[Fluid(water, pressure="hydrostatic")], bodies=gate, **tank)
    times, fronts = front_of(free, device)
    gate_times, gate_fronts = front_of(held, device, lift=speed)
    own_time = 1.0 / speed * np.sqrt(G)
    instants = np.linspace(1.0, 2.25, 26)
    expected = np.interp(instants, times, fronts)
    delays = np.linspace(0.0, own_time, 51)
    misses = [
        np.abs((np.interp(instants + delay, gate_times, gate_fronts) - expected) / (expected - 2.0)).max()
        for delay in delays[delays < gate_times[-1] - 2.25]
    ]
    assert min(misses) < 0.03
    assert delays[int(np.argmin(misses))] < 0.2 * own_time


@pytest.mark.parametrize(
    "shape",
    [
        Box((1.0, 0.1), (1.2, 0.3)),
        Box((1.01, 0.1), (1.2, 0.3)),
        Box((0.4, -0.2), (0.6, 0.0)),
        Box((0.4, -0.5), (0.6, 0.1)),
        Box((0.9, -0.1), (1.1, 0.1)),
        Ball((0.5, -0.2), 0.15),
    ],
    ids=["flush outside", "beside", "under the floor", "through the floor", "through a corner", "ball below"],
)
def test_what_is_beyond_a_wall_is_not_there(shape, device):
    tank = dict(lower=(0.0, 0.0), upper=(1.0, 1.0), particle_spacing=0.05)
    water = [Fluid(Box((0.0, 0.0), (1.0, 0.5)), pressure="hydrostatic")]
    solver = Solver(Scene(fluid=water, bodies={"body": Body(shape)}, **tank), device=device)
    solver.advance(0.5)
    assert measure(solver).rms_speed < 0.004
    assert solver.state.clamped.numpy()[0] == 0


def test_of_two_bodies_in_one_place_one_counts(device):
    block = Body(Box((0.4, 0.0), (0.6, 0.2)))
    water = [Fluid(Box((0.0, 0.0), (1.0, 0.5)), pressure="hydrostatic")]
    runs = []
    for bodies in ({"one": block}, {"one": block, "other": block}):
        solver = Solver(Scene((0.0, 0.0), (1.0, 1.0), 0.05, water, bodies=bodies, jitter=0.02), device=device)
        solver.advance(0.5)
        runs.append(solver.particles().position)
    np.testing.assert_allclose(runs[0], runs[1], atol=2e-3)


def test_body_near_a_periodic_face_is_refused():
    faces = {"x_min": PERIODIC, "x_max": PERIODIC}
    with pytest.raises(ValueError, match=r"Scene.bodies\['slab'\] spans x = 0 to 1 m with its travel, less than"):
        slab = {"slab": Body(Box((0.0, 0.0), (1.0, 0.2)))}
        Solver(Scene((0.0, 0.0), (1.0, 1.0), 0.05, [], faces, bodies=slab, reference_speed=1.0), device="cpu")
    through = {"slab": Body(Box((-0.5, 0.0), (1.5, 0.2)))}
    water = [Fluid(Box((0.0, 0.2), (1.0, 0.6)), pressure="hydrostatic")]
    solver = Solver(Scene((0.0, 0.0), (1.0, 1.0), 0.05, water, faces, bodies=through), device="cpu")
    solver.advance(0.3)
    assert measure(solver).rms_speed < 0.004


def test_body_holds_its_temperature_as_a_face_does(device):
    """Conduction between two walls, one of them a body: the profile is that between two faces."""
    material = Material(thermal_diffusivity=0.05)
    tank = dict(particle_spacing=0.05, gravity=0.0, reference_speed=0.1, material=material)
    sides = {"x_min": PERIODIC, "x_max": PERIODIC}
    fluid = [Fluid(Box((0.0, 0.0), (0.4, 1.0)))]
    faces = sides | {"y_min": Face(temperature=0.0), "y_max": Face(temperature=1.0)}
    one = Scene((0.0, 0.0), (0.4, 1.0), fluid=fluid, faces=faces, **tank)
    lid = {"lid": Body(Box((-1.0, 1.0), (1.4, 1.3)), temperature=1.0)}
    other = Scene(
        (0.0, 0.0), (0.4, 1.3), fluid=fluid, faces=sides | {"y_min": Face(temperature=0.0)}, bodies=lid, **tank
    )
    found = []
    for scene in (one, other):
        solver = Solver(scene, device=device)
        solver.advance(3.0)
        found.append(solver.particles().temperature)
    assert 0.2 < found[0].mean() < 0.5
    np.testing.assert_allclose(found[1], found[0], atol=0.02)


def test_sticky_body_drags_the_fluid_as_a_face_does(device):
    """Couette flow under a lid that is a body, and under a face."""
    tank = dict(particle_spacing=0.05, gravity=0.0, reference_speed=1.0, material=Material(viscosity=0.05))
    sides = {"x_min": PERIODIC, "x_max": PERIODIC, "y_min": Face(slip="no")}
    fluid = [Fluid(Box((0.0, 0.0), (0.4, 1.0)))]
    face = Face(slip="no", sliding=(1.0, 0.0))
    one = Scene((0.0, 0.0), (0.4, 1.0), fluid=fluid, faces=sides | {"y_max": face}, **tank)
    lid = {"lid": Body(Box((-20.0, 1.0), (20.4, 1.3)), slip="no", moving=True, travel=((0.0, 0.0), (10.0, 0.0)))}
    other = Scene((0.0, 0.0), (0.4, 1.3), fluid=fluid, faces=sides, bodies=lid, **tank)
    speeds, drags = [], []
    for scene in (one, other):
        solver = Solver(scene, Scheme(artificial_viscosity=0.0), device=device, report_forces=True)
        if scene.bodies:
            solver.body_velocity = (1.0, 0.0)
            solver.step()
        solver.advance(3.0)
        speeds.append(solver.particles().velocity[:, 0])
        solver.advance(0.2)
        drags.append(solver.body_force[0, 0, 0] if scene.bodies else solver.face_force[0, 3, 0])
    assert 0.2 < speeds[0].mean() < 0.5
    np.testing.assert_allclose(speeds[1], speeds[0], atol=0.03)
    assert drags[1] == pytest.approx(drags[0], rel=0.05)
