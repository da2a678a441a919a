"""What the pictures of the water must show, and what the files and the window must keep."""

import itertools
import os
import sys

import numpy as np
import pytest
from PIL import Image, ImageDraw

from fluidgym.render import Window, draw_frame, write_gif, write_mp4, write_png
from fluidgym.render.camera import aim
from fluidgym.render.colour import to_oklab, water_map
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
    layout = lay_out(check_shot(np.zeros((0, 3)), [], **DEEP, **nothing))
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


@pytest.mark.parametrize(
    ("change", "words"),
    [
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
