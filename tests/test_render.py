"""What the pictures of the water must show, and what the files and the window must keep."""

import itertools
import os
import sys

import numpy as np
import pytest
from PIL import Image, ImageDraw

from fluidgym.render import Window, draw_frame, write_gif, write_mp4, write_png
from fluidgym.render.camera import aim
from fluidgym.render.colour import PLATE, WALL, to_oklab, water_map
from fluidgym.render.legend import lay_out
from fluidgym.render.shot import check_shot

FLAT = {"lower": (0.0, 0.0), "upper": (4.0, 2.0), "spacing": 0.04, "value_range": (0.0, 3.0)}
DEEP = {"lower": (0.0, 0.0, 0.0), "upper": (2.0, 0.8, 1.0), "spacing": 0.05, "value_range": (0.0, 3.0)}


def lattice(low, high, spacing):
    """Fill a block with particles (n, dim), half a spacing away from its sides."""
    axes = [np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def draw_block(low, high, world, value=0.0, **more):
    block = lattice(low, high, world["spacing"])
    return draw_frame(block, np.full(len(block), value), **{**world, **more})


def changed(frame, world, **more):
    """Tell which pixels differ from the same picture without particles."""
    empty = draw_frame(np.zeros((0, len(world["lower"]))), np.zeros(0), **{**world, **more})
    return (np.abs(frame.astype(int) - empty) > 12).any(axis=2)


def extent(mask):
    """Return the left, top, right and bottom of the marked pixels."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])


@pytest.fixture(scope="module")
def full_box():
    """Where the inside of the flat box lies: left, top, right and bottom pixel."""
    return extent(changed(draw_block((0, 0), (4, 2), FLAT), FLAT))


def plate_column(frame):
    red, green, blue = (frame[..., part].astype(int) for part in range(3))
    return np.nonzero((red > 220) & (abs(green - 164) < 25) & (blue < 100))[1].mean()


@pytest.mark.parametrize(("dim", "size"), [(2, (640, 400)), (3, (640, 400)), (2, (97, 211)), (3, (300, 80))])
def test_frame_is_a_fresh_picture_of_the_asked_size(dim, size):
    world = FLAT if dim == 2 else DEEP
    one, two = (draw_block((0,) * dim, (0.5,) * dim, world, size=size) for _ in range(2))
    assert one.shape == (size[1], size[0], 3) and one.dtype == np.uint8
    assert one.flags.writeable and not np.shares_memory(one, two)
    assert one.tobytes() == two.tobytes()


@pytest.mark.parametrize("low_high", [((0, 0), (1, 0.8)), ((1, 0.6), (3, 1.6)), ((3.2, 1.2), (4, 2))])
@pytest.mark.parametrize("spacing", [0.015, 0.04, 0.1])
def test_block_covers_its_own_area_and_place(full_box, low_high, spacing):
    low, high = low_high
    world = {**FLAT, "spacing": spacing}
    block = lattice(low, high, spacing)
    mask = changed(draw_frame(block, np.full(len(block), 2.0), **world), world)
    left, _, right, bottom = full_box
    scale = (right - left) / 4.0
    area = len(block) * spacing**2
    assert mask.sum() / scale**2 == pytest.approx(area, rel=0.04)
    rows, columns = np.nonzero(mask)
    x, y = (columns.mean() + 0.5 - left) / scale, (bottom - rows.mean() - 0.5) / scale
    assert (x, y) == pytest.approx(block.mean(axis=0), abs=0.02)


def test_box_keeps_its_shape(full_box):
    left, top, right, bottom = full_box
    assert (right - left) / (bottom - top) == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("spacing", [0.012, 0.0166, 0.03, 0.07, 0.15])
def test_still_water_has_no_holes_and_no_lattice_pattern(spacing):
    world = {**FLAT, "spacing": spacing}
    frame = draw_block((0, 0), (1.2, 0.9), world, value=1.5)
    left, top, right, bottom = extent(changed(frame, world))
    rim = 3 + int(spacing * (right - left) / 1.2)
    inside = frame[top + rim : bottom - 2, left + 2 : right - rim].astype(int)
    assert inside.size > 40_000
    assert np.ptp(inside, axis=1).max() <= 3
    assert np.abs(np.diff(inside, axis=0)).max() <= 3


def test_lone_particles_are_small_drops():
    drops = np.array([[1.0, 1.0], [2.0, 1.5], [3.0, 0.5]])
    mask = changed(draw_frame(drops, np.full(3, 2.0), **FLAT), FLAT)
    assert 3 * 4 <= mask.sum() <= 3 * 60


def test_higher_values_are_lighter():
    shades = [draw_block((0, 0), (4, 1), FLAT, value=value)[300:310, 300:340].mean() for value in (0, 1, 2, 3)]
    assert (np.diff(shades) > 10).all()
    beyond, highest = (draw_block((0, 0), (4, 1), FLAT, value=value) for value in (9.0, 3.0))
    assert np.array_equal(beyond, highest)


def test_colour_map_has_even_steps():
    steps = np.linalg.norm(np.diff(to_oklab(water_map()[::16]), axis=0), axis=1)
    assert steps.std() / steps.mean() < 0.05
    assert (np.diff(to_oklab(water_map()[::16])[:, 0]) > 0).all()


@pytest.mark.parametrize("at", [0.0, 0.7, 1.3])
def test_moving_wall_is_drawn_where_it_is(full_box, at):
    faces = {"x_min": {"kind": "wall", "position": at, "moving": True}}
    frame = draw_block((at, 0), (at + 1, 1), FLAT, faces=faces)
    left, _, right, _ = full_box
    wall = left + at * (right - left) / 4.0
    thickness = 10
    assert wall - thickness < plate_column(frame) < wall


def test_camera_stands_still_while_a_wall_moves():
    first, second = (
        draw_frame(np.zeros((0, 2)), [], **FLAT, faces={"x_min": {"position": at, "moving": True}}) for at in (0.2, 1.4)
    )
    assert np.array_equal(first[:, 400:], second[:, 400:])


def test_moving_wall_moves_in_three_dimensions():
    columns = [
        plate_column(draw_frame(np.zeros((0, 3)), [], **DEEP, faces={"x_min": {"position": at, "moving": True}}))
        for at in (0.0, 0.5)
    ]
    assert columns[1] - columns[0] > 30


def test_particle_behind_a_wall_stays_visible():
    more = {"faces": {"x_min": {"kind": "wall", "position": 1.0, "moving": True}}}
    assert changed(draw_frame([[0.5, 0.5]], [3.0], **FLAT, **more), FLAT, **more).any()
    assert changed(draw_frame([[0.5, 0.4, 0.5]], [3.0], **DEEP, **more), DEEP, **more).any()


@pytest.mark.parametrize("count", [1, 40])
def test_crowd_behind_a_wall_stays_visible_too(count):
    more = {"faces": {"x_min": {"kind": "wall", "position": 2.0, "moving": True}}}
    crowd = np.full((count, 2), (1.0, 0.5)) + np.linspace(0, 0.01, count)[:, None]
    assert changed(draw_frame(crowd, np.full(count, 3.0), **FLAT, **more), FLAT, **more).any()


@pytest.mark.parametrize("world", [FLAT, DEEP])
def test_particles_that_are_not_finite_are_left_out(world):
    dim = len(world["lower"])
    good = lattice((0,) * dim, (0.4,) * dim, world["spacing"])
    bad = np.array([[np.nan] * dim, [np.inf] * dim, [0.5] * dim])
    values = np.concatenate([np.ones(len(good)), [1.0, 1.0, np.nan]])
    frame = draw_frame(np.concatenate([good, bad]), values, **world)
    assert frame.tobytes() == draw_frame(good, np.ones(len(good)), **world).tobytes()


@pytest.mark.parametrize("world", [FLAT, DEEP])
def test_particles_far_away_do_no_harm(world):
    dim = len(world["lower"])
    far = np.array([[1e300] * dim, [-1e300] * dim, [1e9] * dim])
    assert not changed(draw_frame(far, np.ones(3), **world), world).any()


def test_time_is_written_below_the_view():
    early, late = (draw_block((0, 0), (1, 1), FLAT, time=time) for time in (0.0, 1.0))
    assert np.nonzero((early != late).any(axis=(1, 2)))[0].min() > 350


def test_zone_is_tinted():
    zone = ((2.0, 0.5), (3.0, 1.0))
    plain, marked = draw_block((0, 0), (1, 1), FLAT), draw_block((0, 0), (1, 1), FLAT, zone=zone)
    more = (marked.astype(int) - plain)[(marked != plain).any(axis=2)]
    assert (more[:, 1] > more[:, 0]).mean() > 0.9 and len(more) > 1000


def deep_camera():
    nothing = {"faces": None, "label": "", "time": None, "title": None, "text": (), "zone": None, "size": (640, 400)}
    empty = {"bodies": (), "inflows": (), "outflows": ()}
    layout = lay_out(check_shot(np.zeros((0, 3)), [], **DEEP, **nothing, **empty))
    return aim(np.array(DEEP["lower"]), np.array(DEEP["upper"]), layout, 1.2 * layout.type_size)


def silhouette(low, high):
    """Count the pixels that a solid block covers."""
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    picture = Image.new("1", (640, 400))
    for axis, side in itertools.product(range(3), (low, high)):
        quad = corners[corners[:, axis] == side[axis]][[0, 1, 3, 2]]
        pixels, _ = deep_camera().to_pixels(quad)
        ImageDraw.Draw(picture).polygon([tuple(pixel) for pixel in pixels], fill=1)
    return np.asarray(picture).sum()


@pytest.mark.parametrize("low_high", [((0, 0, 0), (0.8, 0.8, 0.8)), ((1.0, 0.2, 0.3), (1.6, 0.6, 0.7))])
def test_deep_block_covers_its_silhouette(low_high):
    low, high = (np.array(corner, float) for corner in low_high)
    world = {**DEEP, "spacing": 0.025}
    mask = changed(draw_block(low, high, world, value=2.0), world)
    assert mask.sum() == pytest.approx(silhouette(low, high), rel=0.06)


def test_nearer_particles_hide_farther_ones():
    camera = deep_camera()
    far = np.array([1.0, 0.7, 0.3])
    near = far + 0.3 * (camera.eye - far) / np.linalg.norm(camera.eye - far)
    (column, row), _ = camera.to_pixels(far)

    def pixel(places, values):
        return draw_frame(np.array(places), values, **DEEP)[int(row), int(column)].astype(int)

    slow, fast = pixel([far], [0.0]), pixel([far], [3.0])
    assert (fast - slow).sum() > 200
    for order in (1, -1):
        assert np.abs(pixel([far, near][::order], [0.0, 3.0][::order]) - fast).max() < 25
        assert np.abs(pixel([far, near][::order], [3.0, 0.0][::order]) - slow).max() < 25


def test_deep_still_water_has_no_holes():
    frame = draw_block((0, 0, 0), (2, 0.8, 0.6), DEEP, value=1.5)
    front, _ = deep_camera().to_pixels(np.array([[0.1, 0, 0.1], [1.9, 0, 0.1], [1.9, 0, 0.45], [0.1, 0, 0.45]]))
    picture = Image.new("1", (640, 400))
    ImageDraw.Draw(picture).polygon([tuple(pixel) for pixel in front], fill=1)
    face = frame[np.asarray(picture)].astype(int)
    assert len(face) > 5000
    assert np.ptp(face, axis=0).max() < 40


def colour_at(frame, full_box, point):
    """Return the mean colour around a point [m] of the flat picture."""
    left, _, right, bottom = full_box
    scale = (right - left) / 4.0
    column, row = round(left + point[0] * scale), round(bottom - point[1] * scale)
    return frame[row - 2 : row + 3, column - 2 : column + 3].reshape(-1, 3).mean(axis=0)


def box(low, high, **more):
    return {"shape": "box", "lower": low, "upper": high, **more}


def ball(center, radius, **more):
    return {"shape": "ball", "center": center, "radius": radius, **more}


def pipe(center, direction, width, length, **more):
    return {"center": center, "direction": direction, "width": width, "length": length, **more}


def is_like(colour, paint, limit=14):
    return np.abs(colour - np.array(paint)).max() < limit


@pytest.mark.parametrize("world", [FLAT, DEEP])
def test_no_fittings_leave_the_picture_as_it_is(world):
    dim = len(world["lower"])
    faces = {"x_min": {"position": 0.3, "moving": True}, "x_max": {"kind": "open"}}
    plain, empty = (
        draw_block((0.4,) * dim, (0.8,) * dim, world, faces=faces, **more)
        for more in ({}, {"bodies": (), "inflows": [], "outflows": ()})
    )
    assert plain.tobytes() == empty.tobytes()


@pytest.mark.parametrize(("moving", "paint"), [(False, WALL), (True, PLATE)])
@pytest.mark.parametrize("body", [box((1, 0.5), (2, 1)), ball((1.5, 0.75), 0.25)])
def test_body_covers_the_water_and_only_its_place(full_box, body, moving, paint):
    full = draw_block((0, 0), (4, 2), FLAT)
    frame = draw_block((0, 0), (4, 2), FLAT, bodies=[{**body, "moving": moving}])
    assert is_like(colour_at(frame, full_box, (1.5, 0.75)), paint, 3)
    assert is_like(colour_at(frame, full_box, (0.5, 0.75)), colour_at(full, full_box, (0.5, 0.75)), 10)
    mask = (np.abs(frame.astype(int) - full) > 40).any(axis=2)
    scale = (full_box[2] - full_box[0]) / 4.0
    area = 0.5 if body["shape"] == "box" else np.pi * 0.25**2
    assert mask.sum() / scale**2 == pytest.approx(area, rel=0.05)


@pytest.mark.parametrize("thick", [1e-6, 0.002, 0.02])
def test_thin_plate_is_seen_and_keeps_its_far_side_dry(full_box, thick):
    plate = box((1.0, 0.0), (1.0 + thick, 1.2), moving=True)
    left, top, right, bottom = full_box
    frame = draw_block((0, 0), (1, 1), FLAT, bodies=[plate])
    scale = (right - left) / 4.0
    assert plate_column(frame) == pytest.approx(left + scale * (1.0 + thick / 2) - 0.5, abs=1.0)
    seen = (np.abs(frame.astype(int) - PLATE).max(axis=2) < 90).any(axis=1)
    assert seen.sum() == pytest.approx(1.2 * scale, abs=3)
    dry = round(left + scale * (1.0 + thick)) + 3
    empty = draw_frame(np.zeros((0, 2)), [], **FLAT)
    assert np.array_equal(frame[top + 5 : bottom - 2, dry : dry + 40], empty[top + 5 : bottom - 2, dry : dry + 40])


def test_water_reaches_a_body_without_a_rim(full_box):
    water = lattice((0, 0), (4, 2), FLAT["spacing"])
    obstacle = ((water > (1.47, 0.67)) & (water < (2.53, 1.33))).all(axis=1)
    frame = draw_frame(water[~obstacle], np.ones((~obstacle).sum()), **FLAT, bodies=[box((1.5, 0.7), (2.5, 1.3))])
    beside, away = (colour_at(frame, full_box, (x, 0.9)) for x in (1.46, 1.0))
    assert is_like(beside, away, 8)


@pytest.mark.parametrize("world", [FLAT, DEEP])
@pytest.mark.parametrize("size", [(640, 400), (97, 211)])
def test_body_in_part_or_wholly_outside_leaves_the_view_still(world, size):
    dim = len(world["lower"])
    plain = draw_block((0,) * dim, (0.6,) * dim, world, size=size)
    for low, high in ((0.7, 9.0), (2.0, 3.0), (40.0, 41.0), (-60.0, -50.0)):
        gate = box((1.6,) * (dim - 1) + (low,), (1.65,) * (dim - 1) + (high,), moving=True)
        lifted = draw_block((0,) * dim, (0.6,) * dim, world, size=size, bodies=[gate])
        same = (lifted == plain).all(axis=2)
        assert same.mean() > 0.8
        assert same[:, : size[0] // 3].all()
        if abs(low) > 10:
            assert same.all()


@pytest.mark.parametrize("world", [FLAT, DEEP])
def test_bodies_beyond_all_bounds_do_no_harm(world):
    dim = len(world["lower"])
    huge = [box((-1e300,) * dim, (-1e9,) * dim), ball((1e300,) * dim, 1e3), ball((0.5,) * dim, 1e-300)]
    around = [box((-1e300,) * dim, (1e300,) * dim), ball((0.5,) * dim, 1e300)]
    nozzle = pipe((1e300,) * dim, (1e-300,) + (0,) * (dim - 1), 1e300, 1e300)
    region = {"lower": (-1e300,) * dim, "upper": (1e300,) * dim}
    for bodies in (huge, around):
        draw_block((0,) * dim, (0.6,) * dim, world, bodies=bodies, inflows=[nozzle], outflows=[region])


@pytest.mark.parametrize("on", [True, False])
def test_nozzle_has_walls_on_both_sides_and_an_arrow_when_on(full_box, on):
    world = {**FLAT, "inflows": [pipe((1, 1), (2, 0), 0.4, 0.5, on=on)]}
    frame = draw_frame(np.zeros((0, 2)), [], **world)
    for side in (-0.23, 0.23):
        assert is_like(colour_at(frame, full_box, (1.25, 1 + side)), WALL, 40)
        assert not is_like(colour_at(frame, full_box, (1.6, 1 + side)), WALL, 40)
    inside = colour_at(frame, full_box, (1.25, 1))
    assert (inside.mean() > 100) == on
    assert colour_at(frame, full_box, (1.6, 1)).mean() < 60


def test_outflow_is_marked_otherwise_than_a_zone():
    low, high = (2.0, 0.5), (3.0, 1.0)
    plain, zone, outflow = (
        draw_frame(np.zeros((0, 2)), [], **FLAT, **more)
        for more in ({}, {"zone": (low, high)}, {"outflows": [{"lower": low, "upper": high}]})
    )
    marked = (outflow != plain).any(axis=2)
    assert np.abs(extent(marked) - extent((zone != plain).any(axis=2))).max() <= 1
    more = (outflow.astype(int) - plain)[marked]
    assert (more[:, 0] > more[:, 1]).mean() > 0.9


def deep_pixel(frame, point):
    (column, row), _ = deep_camera().to_pixels(np.array(point))
    return frame[int(row), int(column)].astype(int)


@pytest.mark.parametrize("shape", ["box", "ball"])
def test_deep_body_hides_water_behind_it_and_is_hidden_by_water_before_it(shape):
    eye, place = deep_camera().eye, np.array([1.0, 0.4, 0.5])
    back = (eye - place) / np.linalg.norm(eye - place)
    body = ball(place, 0.1, moving=True) if shape == "ball" else box(place - 0.08, place + 0.08, moving=True)
    alone = draw_frame(np.zeros((0, 3)), [], **DEEP, bodies=[body])
    paint = deep_pixel(alone, place)
    assert paint[0] > 130 and paint[0] > 1.3 * paint[2]
    behind, before = (
        draw_frame([place + way * back], [0.0], **{**DEEP, "spacing": 0.1}, bodies=[body]) for way in (-0.3, 0.3)
    )
    assert np.abs(deep_pixel(behind, place) - paint).max() <= 2
    water = deep_pixel(before, place)
    assert water[2] > water[0] and np.abs(water - paint).max() > 60


def test_deep_body_under_water_only_shimmers():
    still = draw_block((0, 0, 0), (2, 0.8, 0.6), DEEP)
    sunk = draw_block((0, 0, 0), (2, 0.8, 0.6), DEEP, bodies=[box((0.8, 0.2, 0.1), (1.2, 0.5, 0.4))])
    difference = np.abs(sunk.astype(int) - still).max(axis=2)
    assert 2 < difference.max() < 60


@pytest.mark.parametrize("thick", [1e-9, 0.001])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_deep_thin_plate_is_seen(axis, thick):
    low, high = np.array([0.8, 0.2, 0.3]), np.array([1.2, 0.6, 0.7])
    high[axis] = low[axis] + thick
    frame = draw_frame(np.zeros((0, 3)), [], **DEEP, bodies=[box(low, high, moving=True)])
    assert deep_pixel(frame, 0.5 * (low + high))[0] > 130


def test_deep_body_covers_its_silhouette():
    low, high = (1.0, 0.2, 0.3), (1.6, 0.6, 0.7)
    mask = changed(draw_frame(np.zeros((0, 3)), [], **DEEP, bodies=[box(low, high, moving=True)]), DEEP)
    assert mask.sum() == pytest.approx(silhouette(low, high), rel=0.03)


@pytest.mark.parametrize("more", [{}, {"height": 0.2}, {"height": None}])
def test_deep_nozzle_shows_its_water_at_the_mouth_only(more):
    water = lattice((0.5, 0.3, 0.4), (1.2, 0.5, 0.6), DEEP["spacing"])
    water = water[np.hypot(water[:, 1] - 0.4, water[:, 2] - 0.5) < 0.1]
    nozzle = pipe((0.5, 0.4, 0.5), (1, 0, 0), 0.2, 0.4, on=False, **more)
    bare, fitted = (draw_frame(water, np.zeros(len(water)), **DEEP, **given) for given in ({}, {"inflows": [nozzle]}))
    grey, blue = deep_pixel(fitted, (0.6, 0.3, 0.5)), deep_pixel(bare, (0.6, 0.3, 0.5))
    assert blue[2] - blue[0] > 60 and grey[2] - grey[0] < 50
    assert np.abs(deep_pixel(fitted, (1.1, 0.3, 0.5)) - deep_pixel(bare, (1.1, 0.3, 0.5))).max() < 10
    on = draw_frame(water, np.zeros(len(water)), **DEEP, inflows=[{**nozzle, "on": True}])
    assert on.max() > fitted.max() or (on != fitted).any(axis=2).sum() > 30


@pytest.mark.parametrize("world", [FLAT, DEEP])
@pytest.mark.parametrize("value_range", [(273.0, 373.0), (-5e4, 1.5e5), (1e8, 1.001e8)])
def test_colours_follow_any_range_of_values(world, value_range):
    low, high = value_range
    dim = len(world["lower"])
    points = np.concatenate([lattice((0,) * dim, (0.5,) * dim, world["spacing"]), [[0.7] * dim]])
    share = np.linspace(0.0, 1.0, len(points))
    unit, scaled = (
        draw_frame(points, values, **{**world, "value_range": ends})[:350].astype(int)
        for values, ends in ((share, (0.0, 1.0)), (low + share * (high - low), value_range))
    )
    assert np.abs(unit - scaled).max() <= 3


def test_close_ends_of_the_colour_bar_are_told_apart():
    first, second = (draw_block((0, 0), (1, 1), FLAT, value_range=(300.0, end))[350:] for end in (300.1, 300.2))
    assert (first != second).any()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bodies": {"gate": {}}}, "bodies: .* must be a sequence of dicts; give"),
        ({"bodies": [3]}, r"bodies\[0\]: 3 must be a dict; give"),
        ({"bodies": [{}]}, r"bodies\[0\] shape: missing; use 'box' or 'ball'"),
        ({"bodies": [{"shape": "cone", "name": "top"}]}, r"bodies\[0\] \('top'\) shape: 'cone' unknown; use"),
        ({"bodies": [{"shape": "box", "lower": (0, 0)}]}, r"bodies\[0\] upper: missing; give lower, upper"),
        ({"bodies": [box((0, 0), (1, 1), radius=2)]}, r"bodies\[0\]: 'radius' unknown; use shape, lower"),
        ({"bodies": [box((0, 0, 0), (1, 1, 1))]}, r"bodies\[0\] lower: .* must be 2 numbers"),
        ({"bodies": [box((0, 0), (1, 0))]}, r"bodies\[0\] upper: .*not above bodies\[0\] lower"),
        ({"bodies": [box((0, 0), (1, np.nan))]}, r"bodies\[0\] upper: nan is not a finite number"),
        ({"bodies": [box((0, 0), (1, 1)), ball((0, 0), 0)]}, r"bodies\[1\] radius: 0 m is not above 0; give"),
        ({"bodies": [ball(5, 1)]}, r"bodies\[0\] center: 5 must be 2 numbers"),
        ({"bodies": [ball([(1, 2), 3], 1)]}, r"bodies\[0\] center: \(1, 2\) is not a finite number"),
        ({"inflows": 1}, "inflows: 1 must be a sequence"),
        ({"inflows": [pipe((0, 0), (0, 0), 1, 1)]}, r"inflows\[0\] direction: .*no length; give"),
        ({"inflows": [pipe((0, 0), (1, 0), -1, 1)]}, r"inflows\[0\] width: -1 m is not above 0"),
        ({"inflows": [pipe((0, 0), (1, 0), 1, 0)]}, r"inflows\[0\] length: 0 m is not above 0"),
        ({"inflows": [pipe((0, 0), (1, 0), 1, 1, height=1)]}, r"inflows\[0\] height: 1 is for three dimensions"),
        ({"inflows": [{"center": (0, 0)}]}, r"inflows\[0\] direction: missing; give"),
        ({"outflows": [{"lower": (0, 0), "upper": (1, -1)}]}, r"outflows\[0\] upper: .*not above"),
        ({"outflows": [{"lower": (0, 0), "upper": (1, 1), "on": 1}]}, r"outflows\[0\]: 'on' unknown; use"),
        ({"lower": "corner"}, "lower: 'corner' is not 2 or 3 finite numbers"),
        ({"positions": np.zeros((5, 3))}, r"positions: .*\(5, 3\)"),
        ({"values": np.zeros(4)}, r"values: .*\(4,\)"),
        ({"spacing": 0.0}, "spacing: 0 m"),
        ({"spacing": np.nan}, "spacing: nan"),
        ({"upper": (4.0, 0.0)}, "upper: .*not above lower"),
        ({"value_range": (1.0, 1.0)}, r"value_range: \(1, 1\)"),
        ({"value_range": 3.0}, "value_range: 3.0"),
        ({"size": (640, np.inf)}, "size: .*64 to 8192"),
        ({"size": (640, 10)}, "size: .*64 to 8192"),
        ({"size": 640}, "size: 640"),
        ({"time": np.inf}, "time: inf"),
        ({"faces": {"left": {}}}, "faces: 'left' unknown"),
        ({"faces": {"x_min": {"kind": "door"}}}, "kind 'door'"),
        ({"faces": {"x_min": {"position": None}}}, r"faces\['x_min'\] position"),
        ({"zone": ((0, 0, 0), (1, 1, 1))}, "zone: 3 axes"),
    ],
)
def test_bad_input_is_named_in_one_line(change, words):
    given = {"positions": np.zeros((5, 2)), "values": np.zeros(5), **FLAT, **change}
    with pytest.raises(ValueError, match=words) as caught:
        draw_frame(given.pop("positions"), given.pop("values"), **given)
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def film():
    return [draw_block((step / 8, 0), (1 + step / 8, 1), FLAT, size=(160, 100), time=step / 10) for step in range(11)]


def test_png_comes_back_exactly(tmp_path, film):
    write_png(tmp_path / "frame.png", film[3])
    with Image.open(tmp_path / "frame.png") as picture:
        assert np.array_equal(np.asarray(picture), film[3])
    assert os.listdir(tmp_path) == ["frame.png"]


def test_gif_keeps_frames_time_and_colours(tmp_path, film):
    write_gif(tmp_path / "film.gif", iter(film), fps=30)
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.n_frames == len(film) and gif.info["loop"] == 0
        lasted = 0
        for number, frame in enumerate(film):
            gif.seek(number)
            lasted += gif.info["duration"]
            assert np.abs(np.asarray(gif.convert("RGB")).astype(int) - frame).mean() < 3
    assert lasted == pytest.approx(len(film) / 30 * 1000, abs=10)


def test_gif_of_one_frame_and_of_equal_frames(tmp_path, film):
    for count in (1, 5):
        write_gif(tmp_path / "film.gif", film[:1] * count, fps=10)
        with Image.open(tmp_path / "film.gif") as gif:
            assert gif.info["duration"] == 100 * count


def test_mp4_keeps_frames_and_makes_sides_even(tmp_path, film):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    write_mp4(tmp_path / "film.mp4", [frame[:-1, :-1] for frame in film], fps=20)
    frames, seconds = ffmpeg.count_frames_and_secs(str(tmp_path / "film.mp4"))
    assert frames == len(film) and seconds == pytest.approx(len(film) / 20, abs=0.05)
    reader = ffmpeg.read_frames(str(tmp_path / "film.mp4"))
    assert next(reader)["size"] == (160, 100)
    picture = np.frombuffer(next(reader), np.uint8).reshape(100, 160, 3)
    reader.close()
    assert np.abs(picture[:-1, :-1].astype(int) - film[0][:-1, :-1]).mean() < 6


@pytest.mark.parametrize("write", [write_gif, write_mp4])
def test_broken_film_leaves_the_old_file(tmp_path, film, write):
    if write is write_mp4:
        pytest.importorskip("imageio_ffmpeg")
    target = tmp_path / "film.xyz"
    target.write_text("old")

    def breaks():
        yield from film[:3]
        raise RuntimeError("solver stopped")

    with pytest.raises(RuntimeError, match="solver stopped"):
        write(target, breaks(), fps=10)
    with pytest.raises(ValueError, match=r"frames\[1\]: shape"):
        write(target, [film[0], film[1][1:]], fps=10)
    with pytest.raises(ValueError, match="frames: 0 frames"):
        write(target, [], fps=10)
    with pytest.raises(ValueError, match="fps: 0"):
        write(target, film, fps=0)
    assert target.read_text() == "old" and os.listdir(tmp_path) == ["film.xyz"]


def test_bad_frame_and_missing_folder_are_named(tmp_path, film):
    with pytest.raises(ValueError, match="frame: float64"):
        write_png(tmp_path / "frame.png", film[0] / 255.0)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        write_png(tmp_path / "nowhere" / "frame.png", film[0])


def test_window_shows_frames_until_it_is_closed(monkeypatch, film):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame = pytest.importorskip("pygame")
    with Window(fps=500) as window:
        assert window.show(film[0]) and not window.closed
        assert window.show(film[1])
        shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
        assert np.array_equal(shown, film[1])
        assert window.show(film[1][:50])
        assert pygame.display.get_surface().get_size() == (160, 50)
        with pytest.raises(ValueError, match="frame: "):
            window.show(film[0][..., 0])
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        assert not window.show(film[2]) and window.closed
        assert not window.show(film[3])
        window.close()


@pytest.mark.parametrize(
    ("module", "use"),
    [("pygame", lambda: Window()), ("imageio_ffmpeg", lambda: write_mp4("film.mp4", [], 10))],
)
def test_missing_extra_is_named(monkeypatch, module, use):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=r'pip install "fluidgym-sph\[render\]"'):
        use()
