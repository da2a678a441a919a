"""Scenes: where the particles start, how they move, and what a bad input is told."""

import dataclasses
import math

import numpy as np
import pytest

from fluidgym.scene import (
    NO_SLIP_WALL,
    OPEN,
    PERIODIC,
    WALL,
    Ball,
    Box,
    Face,
    Fluid,
    Material,
    Region,
    Scene,
    face_names,
    released_head,
)

UNIT = Fluid(Box((0.0, 0.0), (1.0, 0.5)))


def make_scene(**changes):
    """A tank 2 m wide and 1 m high with a block of water in its left half, but for the changes."""
    given = {"lower": (0.0, 0.0), "upper": (2.0, 1.0), "particle_spacing": 0.1, "fluid": UNIT}
    return Scene(**(given | changes))


# -- the lattice ---------------------------------------------------------------------------------------------------


def test_lattice_fills_a_box_with_cell_centres():
    particles = make_scene().sample()
    x, y = np.meshgrid(0.05 + 0.1 * np.arange(10), 0.05 + 0.1 * np.arange(5))
    np.testing.assert_allclose(particles.position, np.stack([x.ravel(), y.ravel()], axis=1), atol=1e-12)
    np.testing.assert_array_equal(particles.identity, np.arange(50))
    assert not particles.velocity.any()
    assert not particles.pressure.any()
    assert (particles.density == 1000.0).all()


def test_lattice_in_three_dimensions_runs_along_x_first():
    block = Fluid(Box((0.0, 0.0, 0.0), (0.3, 0.2, 0.2)))
    scene = make_scene(lower=(0.0, 0.0, 0.0), upper=(1.0, 1.0, 1.0), fluid=block)
    grid = [(0.05 + 0.1 * i, 0.05 + 0.1 * j, 0.05 + 0.1 * k) for k in range(2) for j in range(2) for i in range(3)]
    np.testing.assert_allclose(scene.sample().position, grid, atol=1e-12)


def test_lattice_is_that_of_the_box_not_of_the_fluid():
    scene = make_scene(lower=(-0.33, -0.07), fluid=Fluid(Box((0.2, 0.2), (0.9, 0.7))))
    steps = (scene.sample().position - scene.lower) / 0.1 - 0.5
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert len(scene.sample()) == 35


def test_particles_together_weigh_what_the_fluid_weighs():
    for spacing in (0.1, 0.05, 0.025):
        scene = make_scene(particle_spacing=spacing, material=Material(density=870.0))
        assert len(scene.sample()) * scene.particle_mass == pytest.approx(0.5 * 870.0, rel=1e-12)


def test_ball_holds_the_lattice_points_within_its_radius():
    ball = Ball((0.9, 0.5), 0.37)
    x, y = np.meshgrid(0.05 + 0.1 * np.arange(20), 0.05 + 0.1 * np.arange(10))
    inside = np.hypot(x - 0.9, y - 0.5) < 0.37
    expected = np.stack([x[inside], y[inside]], axis=1)
    np.testing.assert_allclose(make_scene(fluid=Fluid(ball)).sample().position, expected, atol=1e-12)


def test_region_holds_the_lattice_points_of_its_predicate():
    wedge = Region(lambda points: points[:, 1] < points[:, 0], (0.0, 0.0), (0.4, 0.4))
    position = make_scene(fluid=Fluid(wedge)).sample().position
    cells = {(round(x / 0.1 - 0.5), round(y / 0.1 - 0.5)) for x, y in position}
    assert cells == {(i, j) for i in range(4) for j in range(i)}


def test_overlap_counts_once_and_for_the_first():
    first = Fluid(Box((0.0, 0.0), (1.0, 0.5)), velocity=(1.0, 0.0))
    second = Fluid(Box((0.5, 0.0), (1.5, 0.5)), velocity=(2.0, 0.0))
    particles = make_scene(fluid=[first, second]).sample()
    assert len(particles) == 75
    assert len(np.unique(np.round(particles.position, 6), axis=0)) == 75
    np.testing.assert_array_equal(particles.velocity[:, 0], np.where(particles.position[:, 0] < 1.0, 1.0, 2.0))


def test_one_body_needs_no_list():
    assert make_scene(fluid=UNIT).fluid == make_scene(fluid=[UNIT]).fluid == (UNIT,)


def test_body_of_one_particle_fits_its_spacing_though_its_width_is_rounded():
    box = Box((0.9, 0.1), (0.95, 0.15))
    assert box.upper[0] - box.lower[0] < 0.05
    particles = make_scene(fluid=Fluid(box), particle_spacing=0.05).sample()
    np.testing.assert_allclose(particles.position, [(0.925, 0.125)], atol=1e-12)


def test_scene_without_fluid_has_no_particles():
    particles = make_scene(fluid=[]).sample()
    assert len(particles) == 0
    assert particles.position.shape == particles.velocity.shape == (0, 2)
    assert particles.pressure.shape == particles.density.shape == (0,)


# -- motion, pressure, jitter --------------------------------------------------------------------------------------


def test_velocity_is_a_constant_or_a_function_of_place():
    constant = make_scene(fluid=Fluid(UNIT.shape, velocity=(0.3, -0.2))).sample()
    np.testing.assert_array_equal(constant.velocity, np.tile([0.3, -0.2], (50, 1)))
    swirl = make_scene(fluid=Fluid(UNIT.shape, velocity=lambda x: np.stack([-x[:, 1], x[:, 0]], axis=1))).sample()
    np.testing.assert_array_equal(swirl.velocity[:, 0], -swirl.position[:, 1])
    np.testing.assert_array_equal(swirl.velocity[:, 1], swirl.position[:, 0])


def test_hydrostatic_pressure_starts_at_zero_on_the_surface():
    fluid = Fluid(UNIT.shape, pressure="hydrostatic")
    scene = make_scene(fluid=fluid, material=Material(density=900.0))
    lattice, _ = scene.sample_motion()  # the weight of what lies above a particle is that on the lattice
    np.testing.assert_allclose(scene.sample().pressure, 900.0 * 9.81 * (0.5 - lattice[:, 1]), rtol=1e-12)


def test_hydrostatic_pressure_follows_gravity_to_the_side():
    scene = make_scene(fluid=Fluid(UNIT.shape, pressure="hydrostatic"), gravity=(4.0, 0.0))
    lattice, _ = scene.sample_motion()
    np.testing.assert_allclose(scene.sample().pressure, 1000.0 * 4.0 * lattice[:, 0], rtol=1e-12)


def test_hydrostatic_pressure_is_nothing_without_gravity():
    assert not make_scene(fluid=Fluid(UNIT.shape, pressure="hydrostatic"), gravity=0.0).sample().pressure.any()


@pytest.mark.parametrize("gravity", [(0.0, -9.81), (0.0, 6.0), (4.0, 0.0)], ids=["down", "up", "to the side"])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_rows_of_a_hydrostatic_start_are_as_close_as_their_density(gravity, jitter):
    fluid = Fluid(UNIT.shape, pressure="hydrostatic")
    scene = make_scene(fluid=fluid, gravity=gravity, jitter=jitter, particle_spacing=0.025, reference_speed=2.5)
    axis = int(np.flatnonzero(gravity)[0])
    start, (lattice, velocity) = scene.sample(), scene.sample_motion()
    shift = start.position - lattice
    np.testing.assert_array_equal(shift[:, 1 - axis], 0.0)
    np.testing.assert_array_equal(start.velocity, velocity)
    # On the lattice, a particle to a row.
    regular, _ = make_scene(fluid=fluid, particle_spacing=0.025).sample_motion()
    rows, first = np.unique(regular[:, axis].round(9), return_index=True)
    place, s = rows + shift[first, axis], start.pressure[first] / (1000.0 * scene.sound_speed**2)
    assert np.ptp(s) > 0.003
    share = 0.025 / np.diff(place) / (1.0 + 0.5 * (s[1:] + s[:-1]))
    np.testing.assert_allclose(share / share.mean(), 1.0, atol=0.01 * np.ptp(s))
    # Between the same ends.
    height = (1.0, 0.5)[axis]
    settled = np.polynomial.Polynomial.fit(rows, place, 2)
    np.testing.assert_allclose(settled(rows), place, atol=1e-12)
    np.testing.assert_allclose(settled(np.array([0.0, height])), [0.0, height], atol=1e-12)


def test_rows_of_a_hydrostatic_start_in_three_dimensions_are_closer_at_the_bottom():
    block = Fluid(Box((0.0, 0.0, 0.2), (0.4, 0.3, 0.8)), pressure="hydrostatic")
    scene = make_scene(lower=(0.0, 0.0, 0.0), upper=(1.0, 1.0, 1.0), fluid=block)
    shift = scene.sample().position - scene.sample_motion()[0]
    assert not shift[:, :2].any()
    z = scene.sample_motion()[0][:, 2]
    expected = -0.5 * 9.81 / scene.sound_speed**2 * (z - 0.2) * (0.8 - z)
    np.testing.assert_allclose(shift[:, 2], expected, atol=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {"fluid": UNIT},
        {"fluid": Fluid(UNIT.shape, pressure="released")},
        {"fluid": Fluid(UNIT.shape, pressure=lambda x: 9810.0 * (0.5 - x[:, 1]))},
        {"fluid": Fluid(UNIT.shape, pressure="hydrostatic"), "gravity": (1.0, -9.81)},
        {"fluid": Fluid(UNIT.shape, pressure="hydrostatic"), "gravity": 0.0},
    ],
    ids=["none", "released", "a function", "tilted gravity", "no gravity"],
)
def test_any_other_start_is_on_the_lattice(changes):
    scene = make_scene(**changes)
    np.testing.assert_array_equal(scene.sample().position, scene.sample_motion()[0])


def test_pressure_of_a_released_dam_solves_its_equation():
    # Laplace's equation, nothing on top and at the dam, no slope at the wall, weight on the floor.
    width, height, step = 1.5, 0.8, 1e-3
    x, y = np.meshgrid(np.linspace(0.1, 1.4, 14), np.linspace(0.1, 0.7, 7))

    def head(x, y):
        points = np.stack(np.broadcast_arrays(x, y), axis=-1).reshape(-1, 2)
        return released_head(points, width, height)

    middle = head(x, y)
    across = head(x + step, y) + head(x - step, y) - 2.0 * middle
    upwards = head(x, y + step) + head(x, y - step) - 2.0 * middle
    np.testing.assert_allclose((across + upwards) / step**2, 0.0, atol=1e-4)
    assert (middle > 0.0).all()
    assert (middle < height - y.ravel()).all()
    line = np.linspace(0.0, 1.0, 9)[1:-1]
    np.testing.assert_allclose(head(line * width, height), 0.0, atol=1e-12)
    np.testing.assert_allclose(head(width, line * height), 0.0, atol=1e-12)
    np.testing.assert_allclose(head(step, line * height), head(-step, line * height), rtol=1e-12)
    # At the floor the series converges slowly: the slope is extrapolated from above, short of the dam's corner.
    low, mid, high = (head(line[:5] * width, lift) for lift in (0.05, 0.1, 0.15))
    below, above = (mid - low) / 0.05, (high - mid) / 0.05
    np.testing.assert_allclose(below + 1.5 * (below - above), -1.0, atol=5e-3)


def test_released_dam_starts_with_that_pressure():
    dam = Fluid(UNIT.shape, pressure="released")
    particles = make_scene(fluid=dam, material=Material(density=900.0)).sample()
    np.testing.assert_allclose(
        particles.pressure, 900.0 * 9.81 * released_head(particles.position, 1.0, 0.5), rtol=1e-12
    )


def test_pressure_may_be_a_function_of_place():
    particles = make_scene(fluid=Fluid(UNIT.shape, pressure=lambda x: 3.0 * x[:, 0])).sample()
    np.testing.assert_array_equal(particles.pressure, 3.0 * particles.position[:, 0])


def test_jitter_is_bounded_by_its_share_of_the_spacing_and_fills_it():
    lattice = make_scene().sample().position
    shift = (make_scene(jitter=0.25).sample().position - lattice) / 0.1
    assert np.abs(shift).max() <= 0.25
    assert np.abs(shift).max() > 0.2
    assert shift.min() < -0.2


def test_jitter_depends_on_the_seed_alone():
    first, again, other = (make_scene(jitter=0.2, seed=seed).sample().position for seed in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()


# -- numbers that follow from others -------------------------------------------------------------------------------


def test_last_axis_is_up():
    assert make_scene().gravity == (0.0, -9.81)
    assert make_scene(gravity=2.0).gravity == (0.0, -2.0)
    assert make_scene(gravity=(1.0, 2.0)).gravity == (1.0, 2.0)
    cube = make_scene(lower=(0, 0, 0), upper=(1, 1, 1), fluid=Fluid(Box((0, 0, 0), (1, 1, 0.5))))
    assert cube.gravity == (0.0, 0.0, -9.81)
    assert (cube.dim, make_scene().dim) == (3, 2)


def test_speed_expected_is_the_larger_of_the_waves_and_the_start():
    assert make_scene().speed_scale == pytest.approx(math.sqrt(9.81 * 0.5))
    raised = Fluid(Box((0.0, 0.3), (1.0, 0.8)))
    assert make_scene(fluid=raised).speed_scale == pytest.approx(math.sqrt(9.81 * 0.8))
    assert make_scene(fluid=Fluid(UNIT.shape, velocity=(6.0, 8.0))).speed_scale == pytest.approx(10.0)
    sideways = make_scene(gravity=(4.0, 0.0))  # the floor is x_max, the top of the fluid x = 0
    assert sideways.speed_scale == pytest.approx(math.sqrt(4.0 * 2.0))
    assert make_scene(reference_speed=3.0).speed_scale == 3.0


def test_sound_is_ten_times_faster_than_the_fluid():
    assert make_scene(reference_speed=3.0).sound_speed == pytest.approx(30.0)
    assert make_scene(reference_speed=3.0, material=Material(sound_speed=77.0)).sound_speed == 77.0


def test_face_not_named_is_a_free_slip_wall():
    faces = make_scene(faces={"y_max": OPEN, "x_min": NO_SLIP_WALL}).faces
    assert faces == {"x_min": NO_SLIP_WALL, "x_max": WALL, "y_min": WALL, "y_max": OPEN}
    assert tuple(faces) == face_names(2) == ("x_min", "x_max", "y_min", "y_max")
    assert face_names(3)[4:] == ("z_min", "z_max")


def test_moving_wall_starts_at_the_end_of_its_travel_on_its_own_side():
    apart = {"x_min": Face(moving=True, travel=(0.0, 0.4)), "x_max": Face(moving=True, travel=(1.2, 1.7))}
    scene = make_scene(faces=apart | {"y_max": Face(moving=True)})
    np.testing.assert_array_equal(scene.face_travel(), [(0.0, 0.4), (1.2, 1.7), (0.0, 0.0), (0.0, 1.0)])
    np.testing.assert_array_equal(scene.face_start_positions(), [0.0, 1.7, 0.0, 1.0])


def test_moving_wall_starts_where_it_is_told():
    dam = Fluid(Box((0.4, 0.0), (1.0, 0.5)), pressure="released")
    faces = {"x_min": Face(moving=True, travel=(0.0, 0.5), start=0.4), "y_max": Face(moving=True, start=0.6)}
    scene = make_scene(faces=faces, fluid=dam)
    np.testing.assert_array_equal(scene.face_start_positions(), [0.4, 2.0, 0.0, 0.6])
    assert scene.sample().pressure.any()


def test_scene_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        make_scene().particle_spacing = 0.2


# -- bad input: one line that names the field, the value, the limit and the remedy -----------------------------------

NAN = float("nan")

BAD_SCENES = {
    "spacing larger than the fluid": (
        {"particle_spacing": 0.6},
        "Scene.particle_spacing = 0.6 m exceeds the fluid height 0.5 m; use 0.12 m or less",
    ),
    "spacing of zero": (
        {"particle_spacing": 0.0},
        "Scene.particle_spacing = 0 m must be greater than 0; give a positive value",
    ),
    "spacing not a number": ({"particle_spacing": NAN}, "Scene.particle_spacing = nan m must be finite; give a number"),
    "fluid outside the box": (
        {"fluid": Fluid(Box((1.5, 0.0), (2.5, 0.5)))},
        "Scene.fluid spans x = 1.5 to 2.5 m, outside the box 0 to 2 m; move the fluid or enlarge the box",
    ),
    "fluid below the floor": (
        {"fluid": Fluid(Ball((1.0, 0.2), 0.3))},
        "Scene.fluid spans y = -0.1 to 0.5 m, outside the box 0 to 1 m; move the fluid or enlarge the box",
    ),
    "fluid of another dimension": (
        {"fluid": Fluid(Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))},
        "Scene.fluid shape has 3 and 3 components, limit 2; match Scene.lower",
    ),
    "fluid inside out": (
        {"fluid": Fluid(Box((1.0, 0.0), (0.5, 0.5)))},
        "Scene.fluid spans (1.0, 0.0) to (0.5, 0.5) m; give finite corners that rise, or a positive radius",
    ),
    "fluid of no number": (
        {"fluid": Fluid(Ball((1.0, 0.5), NAN))},
        "Scene.fluid spans (nan, nan) to (nan, nan) m; give finite corners that rise, or a positive radius",
    ),
    "fluid between the lattice points": (
        {"fluid": Fluid(Region(lambda points: points[:, 0] < 0.0, (0.0, 0.0), (1.0, 0.5)))},
        "Scene.fluid has a body with no lattice point at Scene.particle_spacing = 0.1 m;"
        " use a smaller spacing or a larger body",
    ),
    "predicate of the wrong shape": (
        {"fluid": Fluid(Region(lambda points: points > 0.0, (0.0, 0.0), (0.2, 0.2)))},
        "Region.predicate returned shape (16, 2), limit (16,); return one bool a point",
    ),
    "box inside out": (
        {"upper": (2.0, -1.0)},
        "Scene.upper y = -1 m must exceed Scene.lower y = 0 m",
    ),
    "corner not a number": ({"lower": (NAN, 0.0)}, "Scene.lower = (nan, 0.0) must be finite; give numbers"),
    "corners of different dimensions": (
        {"upper": (2.0, 1.0, 1.0)},
        "Scene.lower and Scene.upper have 2 and 3 components; give two each for a 2D scene, three for a 3D one",
    ),
    "one dimension": (
        {"lower": (0.0,), "upper": (1.0,)},
        "Scene.lower and Scene.upper have 1 and 1 components; give two each for a 2D scene, three for a 3D one",
    ),
    "gravity of another dimension": (
        {"gravity": (0.0, 0.0, -9.81)},
        "Scene.gravity = (0.0, 0.0, -9.81) m/s2 has 3 components; give 2",
    ),
    "gravity not finite": ({"gravity": math.inf}, "Scene.gravity = (0.0, -inf) must be finite; give numbers"),
    "no such face": (
        {"faces": {"left": OPEN}},
        "Scene.faces has no face 'left'; use x_min, x_max, y_min, y_max",
    ),
    "face of the third dimension": (
        {"faces": {"z_max": OPEN}},
        "Scene.faces has no face 'z_max'; use x_min, x_max, y_min, y_max",
    ),
    "half a periodic axis": (
        {"faces": {"x_min": PERIODIC}},
        "Scene.faces 'x_min' and 'x_max' must both be periodic, or neither",
    ),
    "travel beyond the box": (
        {"faces": {"x_max": Face(moving=True, travel=(1.0, 2.5))}},
        "Scene.faces['x_max'].travel = (1, 2.5) m leaves the box 0 to 2 m; enlarge the box or shorten the travel",
    ),
    "sliding along the normal": (
        {"faces": {"x_max": Face(slip="no", sliding=(1.0, 0.0))}},
        "Scene.faces['x_max'].sliding = (1.0, 0.0) m/s must have 2 components and none along x;"
        " a wall moves along its normal by moving=True",
    ),
    "jitter too large": ({"jitter": 0.7}, "Scene.jitter = 0.7 is outside 0 to 0.5 spacings; use 0.25 or less"),
    "jitter not a number": ({"jitter": NAN}, "Scene.jitter = nan is outside 0 to 0.5 spacings; use 0.25 or less"),
    "reference speed of zero": (
        {"reference_speed": 0.0},
        "Scene.reference_speed = 0 m/s must be greater than 0; give a positive value",
    ),
    "corner of one number": (
        {"lower": 0.0},
        "Scene.lower = 0.0 is not a sequence of numbers [m]; give one for each axis",
    ),
    "corner of words": (
        {"upper": ("2", "1")},
        "Scene.upper = ('2', '1') is not a sequence of numbers [m]; give one for each axis",
    ),
    "spacing in words": (
        {"particle_spacing": "0.05"},
        "Scene.particle_spacing = '0.05' is not a number; use one in m",
    ),
    "gravity in words": (
        {"gravity": "9.81"},
        "Scene.gravity = '9.81' is not a sequence of numbers [m/s2];"
        " give one for each axis, or one number for downwards",
    ),
    "density for a material": (
        {"material": 1000.0},
        "Scene.material = 1000.0 is not a Material; use Material(density=1000.0)",
    ),
    "no fluid": (
        {"fluid": None},
        "Scene.fluid = None is not a Fluid or a list of them; use [Fluid(shape)], or [] for none",
    ),
    "shape for a fluid": (
        {"fluid": [UNIT, Box((0.0, 0.0), (1.0, 0.5))]},
        "Scene.fluid[1] = Box(lower=(0.0, 0.0), upper=(1.0, 0.5)) is not a Fluid; use Fluid(shape)",
    ),
    "faces without names": (
        {"faces": [WALL]},
        "Scene.faces = [Face(kind='wall', slip='free', moving=False, travel=None, start=None, sliding=None,"
        " temperature=None)] is not a mapping; use {'x_min': Face('wall')}",
    ),
    "jitter in words": ({"jitter": "0.1"}, "Scene.jitter = '0.1' is not a number; use 0 to 0.25"),
    "seed of a fraction": ({"seed": 0.5}, "Scene.seed = 0.5 is not a whole number; use 0 or more"),
    "seed below zero": ({"seed": -1}, "Scene.seed = -1 is below the limit 0; use 0 or more"),
    "sound too slow for the waves": (
        {"material": Material(sound_speed=11.0)},
        "Material.sound_speed = 11 m/s is below the limit 11.1 m/s, 5 times the largest speed expected;"
        " use 22.1 m/s (10 times), or None for that",
    ),
    "sound too slow for the speed given": (
        {"material": Material(sound_speed=14.9), "reference_speed": 3.0},
        "Material.sound_speed = 14.9 m/s is below the limit 15 m/s, 5 times the largest speed expected;"
        " use 30 m/s (10 times), or None for that",
    ),
    "fluid behind a moving wall": (
        {"faces": {"x_min": Face(moving=True, travel=(0.2, 0.8))}},
        "Scene.fluid spans x = 0 to 1 m, beyond the walls, which start at 0.2 and 2 m;"
        " move the fluid, or a wall by Face.start",
    ),
    "fluid behind a lid": (
        {"faces": {"y_max": Face(moving=True, start=0.3)}},
        "Scene.fluid spans y = 0 to 0.5 m, beyond the walls, which start at 0 and 0.3 m;"
        " move the fluid, or a wall by Face.start",
    ),
    "start outside the travel": (
        {"faces": {"x_max": Face(moving=True, travel=(1.0, 1.8), start=2.0)}},
        "Scene.faces['x_max'].start = 2 m is outside its travel 1 to 1.8 m; start inside, or widen the travel",
    ),
    "walls that can meet": (
        {"faces": dict.fromkeys(("x_min", "x_max"), Face(moving=True))},
        "Scene.faces 'x_min' travels up to 2 m and 'x_max' down to 0 m, so they can meet;"
        " give both a Face.travel that keeps them apart",
    ),
    "walls that can touch": (
        {
            "faces": {
                "x_min": Face(moving=True, travel=(0.0, 1.2)),
                "x_max": Face(moving=True, travel=(1.2, 2.0)),
            }
        },
        "Scene.faces 'x_min' travels up to 1.2 m and 'x_max' down to 1.2 m, so they can meet;"
        " give both a Face.travel that keeps them apart",
    ),
    "dam away from the wall": (
        {"fluid": Fluid(Box((0.2, 0.0), (1.0, 0.5)), pressure="released")},
        "Fluid.pressure = 'released' needs a Box held by a wall 'x_min': its x starts at 0.2 m,"
        " the face is 'wall' at 0 m; move the Box or use 'hydrostatic'",
    ),
    "dam above the floor": (
        {"fluid": Fluid(Box((0.0, 0.1), (1.0, 0.5)), pressure="released")},
        "Fluid.pressure = 'released' needs a Box held by a wall 'y_min': its y starts at 0.1 m,"
        " the face is 'wall' at 0 m; move the Box or use 'hydrostatic'",
    ),
    "dam at an open face": (
        {"fluid": Fluid(UNIT.shape, pressure="released"), "faces": {"x_min": OPEN}},
        "Fluid.pressure = 'released' needs a Box held by a wall 'x_min': its x starts at 0 m,"
        " the face is 'open' at 0 m; move the Box or use 'hydrostatic'",
    ),
    "dam under slanting gravity": (
        {"fluid": Fluid(UNIT.shape, pressure="released"), "gravity": (1.0, -9.81)},
        "Fluid.pressure = 'released' needs gravity straight down, not Scene.gravity = (1.0, -9.81) m/s2;"
        " use 'hydrostatic'",
    ),
}


@pytest.mark.parametrize(("changes", "message"), BAD_SCENES.values(), ids=BAD_SCENES.keys())
def test_bad_scene_is_refused_in_one_line(changes, message):
    with pytest.raises(ValueError) as error:
        make_scene(**changes)
    assert str(error.value) == message
    assert "\n" not in message


BAD_PARTS = {
    "negative viscosity": (
        lambda: Material(viscosity=-1e-6),
        "Material.viscosity = -1e-06 m2/s is below the limit 0; use 0 or more",
    ),
    "no density": (
        lambda: Material(density=0.0),
        "Material.density = 0 kg/m3 must be greater than 0; give a positive value",
    ),
    "sound speed not a number": (
        lambda: Material(sound_speed=NAN),
        "Material.sound_speed = nan m/s must be finite; give a number",
    ),
    "unknown kind of face": (lambda: Face("door"), "Face.kind = 'door' is unknown; use 'wall', 'open' or 'periodic'"),
    "unknown slip": (lambda: Face(slip="some"), "Face.slip = 'some' is unknown; use 'free' or 'no'"),
    "opening that moves": (
        lambda: Face("open", moving=True),
        "Face.kind = 'open' takes no motion, no slip and no temperature; only a 'wall' moves, holds or heats the fluid",
    ),
    "travel downwards": (
        lambda: Face(moving=True, travel=(1.0, 0.5)),
        "Face.travel = (1.0, 0.5) m must rise; give (lowest, highest)",
    ),
    "unknown pressure": (
        lambda: Fluid(UNIT.shape, pressure="high"),
        "Fluid.pressure = 'high' is unknown; use 'hydrostatic', 'released', 'none' or a function of points",
    ),
    "released ball": (
        lambda: Fluid(Ball((1.0, 0.5), 0.3), pressure="released"),
        "Fluid.pressure = 'released' is for a Box, not a Ball; use 'hydrostatic'",
    ),
    "pressure of an array": (
        lambda: Fluid(UNIT.shape, pressure=np.zeros(2)),
        "Fluid.pressure = array([0., 0.]) is unknown; use 'hydrostatic', 'released', 'none' or a function of points",
    ),
    "fluid without a shape": (
        lambda: Fluid(((0.0, 0.0), (1.0, 0.5))),
        "Fluid.shape = ((0.0, 0.0), (1.0, 0.5)) is not a shape; use a Box, a Ball or a Region",
    ),
    "velocity of one number": (
        lambda: Fluid(UNIT.shape, velocity=1.0),
        "Fluid.velocity = 1.0 is not a sequence of numbers [m/s]; give one for each axis, or a function of points",
    ),
    "velocity in words": (
        lambda: Fluid(UNIT.shape, velocity="1"),
        "Fluid.velocity = '1' is not a sequence of numbers [m/s]; give one for each axis, or a function of points",
    ),
    "box of two numbers": (
        lambda: Box(1.0, 0.5),
        "Box.lower = 1.0 is not a sequence of numbers [m]; give one for each axis",
    ),
    "ball without a radius": (
        lambda: Ball((1.0, 0.5), None),
        "Ball.radius = None is not a number; use a positive one [m]",
    ),
    "region of a mask": (
        lambda: Region(np.zeros((2, 2)), (0.0, 0.0), (1.0, 1.0)),
        "Region.predicate = array([[0., 0.], [0., 0.]]) is not a function; use one of points (n, dim) [m] -> bool (n,)",
    ),
    "travel of one number": (
        lambda: Face(moving=True, travel=1.0),
        "Face.travel = 1.0 is not a sequence of numbers [m]; give (lowest, highest)",
    ),
    "travel of three numbers": (
        lambda: Face(moving=True, travel=(0.0, 1.0, 2.0)),
        "Face.travel = (0.0, 1.0, 2.0) m must rise; give (lowest, highest)",
    ),
    "travel not a number": (
        lambda: Face(moving=True, travel=(0.0, NAN)),
        "Face.travel = (0.0, nan) must be finite; give numbers",
    ),
    "travel of a wall at rest": (
        lambda: Face(travel=(0.0, 1.0)),
        "Face.travel = (0.0, 1.0) m is of no effect on a wall at rest; set moving=True",
    ),
    "start of a wall at rest": (
        lambda: Face(start=0.5),
        "Face.start = 0.5 m is of no effect on a wall at rest; set moving=True",
    ),
    "start not a number": (lambda: Face(moving=True, start=NAN), "Face.start = nan m must be finite; give a number"),
    "moving in words": (lambda: Face(moving="yes"), "Face.moving = 'yes' is not a bool; use True or False"),
    "sliding where nothing sticks": (
        lambda: Face(sliding=(0.0, 1.0)),
        "Face.sliding = (0.0, 1.0) m/s is of no effect on a wall of free slip; set slip='no'",
    ),
    "sliding not a number": (
        lambda: Face(slip="no", sliding=(0.0, NAN)),
        "Face.sliding = (0.0, nan) must be finite; give numbers",
    ),
    "opening that slides": (
        lambda: Face("open", sliding=(0.0, 1.0)),
        "Face.kind = 'open' takes no motion, no slip and no temperature; only a 'wall' moves, holds or heats the fluid",
    ),
    "density in words": (
        lambda: Material(density="1000"),
        "Material.density = '1000' is not a number; use one in kg/m3",
    ),
}


@pytest.mark.parametrize(("make", "message"), BAD_PARTS.values(), ids=BAD_PARTS.keys())
def test_bad_part_is_refused_in_one_line(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert str(error.value) == message


BAD_FUNCTIONS = {
    "velocity of another dimension": (
        {"velocity": (1.0, 0.0, 0.0)},
        "Fluid.velocity = (1.0, 0.0, 0.0) m/s has 3 components; give 2",
    ),
    "velocity of the wrong shape": (
        {"velocity": lambda points: points[:7]},
        "Fluid.velocity has shape (7, 2), limit (50, 2); return one row for each point",
    ),
    "velocity not a number": (
        {"velocity": lambda points: np.where(points > 0.9, NAN, 0.0)},
        "Fluid.velocity is not finite at 5 places; return numbers",
    ),
    "pressure not a number": (
        {"pressure": lambda points: np.full(len(points), NAN)},
        "Fluid.pressure is not finite at 50 places; return numbers",
    ),
}


@pytest.mark.parametrize(("changes", "message"), BAD_FUNCTIONS.values(), ids=BAD_FUNCTIONS.keys())
def test_bad_start_is_refused_in_one_line(changes, message):
    with pytest.raises(ValueError) as error:
        make_scene(fluid=Fluid(UNIT.shape, **changes)).sample()
    assert str(error.value) == message


def test_speed_that_cannot_be_estimated_must_be_given():
    scene = make_scene(gravity=0.0)
    with pytest.raises(ValueError) as error:
        _ = scene.speed_scale
    assert str(error.value) == (
        "Scene.reference_speed = None cannot be estimated without fluid that moves or weighs;"
        " give the largest speed expected [m/s]"
    )


def test_face_must_be_a_face():
    with pytest.raises(ValueError) as error:
        make_scene(faces={"x_min": "wall"})
    assert str(error.value) == "Scene.faces['x_min'] = 'wall' is not a Face; use Face('wall')"


def test_sound_speed_is_taken_as_it_is_where_no_speed_can_be_estimated():
    assert make_scene(gravity=0.0, material=Material(sound_speed=1e-3)).sound_speed == 1e-3


def test_constant_velocity_must_be_finite():
    with pytest.raises(ValueError, match=r"Fluid.velocity = \(nan, 0.0\) must be finite; give numbers"):
        Fluid(UNIT.shape, velocity=(np.nan, 0.0))


def test_magnitude_of_gravity_may_be_any_number():
    assert make_scene(gravity=np.float32(9.5)).gravity == (0.0, -9.5)
