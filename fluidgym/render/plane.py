"""Two-dimensional drawings: a filled body of water in a tank seen from the front."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image

from fluidgym.render import field
from fluidgym.render.canvas import Canvas, hatch, outline, rectangle
from fluidgym.render.colour import BACKGROUND, DRAIN, EDGE, INK, PLATE, PLATE_EDGE, SKY, TANK, WALL, ZONE, colour_values
from fluidgym.render.fittings import Nozzle, Solid
from fluidgym.render.legend import Layout
from fluidgym.render.shot import Shot, Side

_DROP = 0.5  # Radius of a lone particle, in particle spacings.
_RIM = 1.4  # Width of the outline of a body [px].
_WETTED = 0.4  # Widest gap between water and a body that is drawn closed, about, in particle spacings.
_FOAM = (244, 252, 255)
_DEEP = (8, 24, 58)


@dataclass(frozen=True)
class Plan:
    """Where the box lies in the picture.

    Attributes:
        corner: Pixel coordinates of the point (0, 0) m (2,) [px].
        scale: Pixels per metre [px/m].
        thickness: Thickness of a drawn wall [px].
        window: Left, top, right and bottom pixel of the part that can show water.
    """

    corner: np.ndarray
    scale: float
    thickness: float
    window: tuple[int, int, int, int]

    def to_pixels(self, points: np.ndarray) -> np.ndarray:
        """Turn positions (..., 2) [m] into pixel coordinates (..., 2) [px], y down."""
        return self.corner + np.asarray(points) * (self.scale, -self.scale)


def draw_plane(canvas: Canvas, shot: Shot, layout: Layout) -> None:
    """Draw a two-dimensional picture.

    Args:
        canvas: The picture to paint on.
        shot: What is drawn.
        layout: Which part of the picture is the view.
    """
    plan = _fit(shot, layout)
    low, high = _inner_corners(shot)
    canvas.fill([rectangle(plan.to_pixels(low), plan.to_pixels(high))], TANK)
    _draw_water(canvas, shot, plan)
    for face in shot.faces.values():
        _draw_face(canvas, shot, plan, face)
    for nozzle in shot.inflows:
        _draw_nozzle(canvas, nozzle, plan)
    for solid in shot.bodies:
        _draw_body(canvas, shot, solid, plan)
    for region in shot.outflows:
        _draw_outflow(canvas, shot, region, plan)
    if shot.zone is not None:
        _draw_zone(canvas, shot.zone, plan)
    if shot.grid is not None:
        _draw_grid(canvas, shot, shot.grid, plan)


def _draw_grid(canvas: Canvas, shot: Shot, grid: np.ndarray, plan: Plan) -> None:
    """Lay the coarse grid over the picture: its lines, and in each cell a square as large as its share."""
    rows, columns = grid.shape
    cell = (shot.upper - shot.lower) / (columns, rows)
    x, y = (shot.lower[k] + cell[k] * np.arange((columns, rows)[k] + 1) for k in range(2))
    lines = [np.array([[at, y[0]], [at, y[-1]]]) for at in x] + [np.array([[x[0], at], [x[-1], at]]) for at in y]
    canvas.stroke(map(plan.to_pixels, lines), INK, opacity=0.35)
    squares = []
    for row, column in np.argwhere(grid > 0.01):
        middle = shot.lower + cell * (column + 0.5, row + 0.5)
        half = 0.42 * cell * np.sqrt(grid[row, column])
        squares.append(rectangle(plan.to_pixels(middle - half), plan.to_pixels(middle + half)))
    canvas.fill(squares, ZONE, 0.45)


def _fit(shot: Shot, layout: Layout) -> Plan:
    thickness = max(3.0, 0.45 * layout.type_size)
    margin = 2.6 * thickness
    room = np.array([layout.right - layout.left, layout.bottom - layout.top]) - 2.0 * margin
    scale = float(max((np.maximum(room, 8.0) / (shot.upper - shot.lower)).min(), 1e-30))
    middle = 0.5 * np.array([layout.left + layout.right, layout.top + layout.bottom])
    corner = middle - 0.5 * (shot.upper + shot.lower) * (scale, -scale)
    half = 0.5 * (shot.upper - shot.lower) * scale + margin
    left, top = np.floor(middle - half).astype(int)
    right, bottom = np.ceil(middle + half).astype(int)
    width, height = shot.size
    window = (max(left, 0), max(top, 0), min(right, width), min(bottom, height))
    return Plan(corner, scale, thickness, window)


def _inner_corners(shot: Shot) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners between which the faces leave room now (2,), (2,) [m]."""
    faces = shot.faces
    low = np.array([faces["x_min"].position, faces["y_min"].position])
    high = np.array([faces["x_max"].position, faces["y_max"].position])
    return low, np.maximum(low, high)


def _draw_water(canvas: Canvas, shot: Shot, plan: Plan) -> None:
    left, top, right, bottom = plan.window
    shape = (bottom - top, right - left)
    origin = np.array([left, top])
    spacing = shot.spacing * plan.scale
    points, values = field.with_images(shot)
    places = (plan.to_pixels(points) - origin)[:, ::-1]
    fraction, value = _pixel_fields(places, values, spacing, shape)

    if shot.bodies:
        fraction = fraction + _stand_in(shot, plan, fraction, spacing)
    room = _room(shot, plan, origin, shape)
    body = np.full(shape, -1.0, np.float32) if shot.spheres else _depth_of_body(fraction, spacing)
    hidden = np.zeros_like(fraction) if shot.spheres else fraction * room
    drops = _depth_of_drops(places[: len(shot.positions)], hidden, spacing)
    depth = np.maximum(body, drops)
    cover = np.clip(body + 0.5, 0.0, 1.0) * room
    cover = np.maximum(cover, np.clip(drops + 0.5, 0.0, 1.0))

    wet = np.flatnonzero(cover > 0.0)
    colours = colour_values(value.ravel()[wet], shot.value_range)
    colours = _light(colours, depth, fraction, wet, spacing)
    rows, columns = np.divmod(wet, shape[1])
    canvas.shade((rows + top) * shot.size[0] + columns + left, colours, cover.ravel()[wet])


def _pixel_fields(
    places: np.ndarray, values: np.ndarray, spacing: float, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return water fraction and value at every pixel, by way of a coarser grid if that does."""
    cell = max(1.0, spacing / 3.0)
    rows, columns = (int(np.ceil(side / cell)) for side in shape)
    fields = field.spread(places, values, spacing, cell, (rows, columns))
    if cell == 1.0:
        return fields
    size = (shape[1], shape[0])
    box = (0.0, 0.0, shape[1] / cell, shape[0] / cell)
    fraction, value = (
        np.asarray(Image.fromarray(coarse).resize(size, Image.Resampling.BICUBIC, box=box)) for coarse in fields
    )
    return fraction, value


def _stand_in(shot: Shot, plan: Plan, fraction: np.ndarray, spacing: float) -> np.ndarray:
    """Return the fraction of water to add in bodies, so that water beside a body reaches it and has no rim there."""
    left, top, right, bottom = plan.window
    solid = np.zeros_like(fraction)
    for body in shot.bodies:
        thick = min(float((body.upper - body.lower).min()) / shot.spacing, 1.0)  # A thin one must not wet its far side.
        away = _distance(body, plan, (left, top, right, bottom)) - _WETTED * thick * spacing
        share = 0.5 - 0.5 * np.tanh(away * (0.85 / max(field.BELL * spacing, 0.8)))
        solid = np.maximum(solid, thick * share)
    return solid * np.minimum(4.0 * fraction, 1.0)


def _distance(body: Solid, plan: Plan, window: tuple[int, int, int, int]) -> np.ndarray:
    """Return how far the pixels of a window lie outside a body (rows, columns) [px]; negative inside.

    A body thinner than two pixels counts as two pixels thick.
    """
    left, top, right, bottom = window
    middle = plan.to_pixels(0.5 * (body.lower + body.upper))
    half = np.maximum(0.5 * (body.upper - body.lower) * plan.scale, 1.0)
    across = np.abs(np.arange(left, right) + 0.5 - middle[0])
    along = np.abs(np.arange(top, bottom) + 0.5 - middle[1])[:, None]
    if body.round:
        return np.hypot(across, along) - half[0]
    beyond = across - half[0], along - half[1]
    outside = np.hypot(np.maximum(beyond[0], 0.0), np.maximum(beyond[1], 0.0))
    return outside + np.minimum(np.maximum(*beyond), 0.0)


def _depth_of_body(fraction: np.ndarray, spacing: float) -> np.ndarray:
    """Estimate how deep each pixel lies below the surface [px]; negative outside the water."""
    down, right = _slopes(fraction)
    steepness = np.hypot(down, right)
    return (fraction - 0.5) / np.maximum(steepness, 0.3 * field.SLOPE / max(spacing, 1.0))


def _slopes(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the change per pixel downwards and to the right, 0 at the picture's edge."""
    down, right = np.zeros_like(picture), np.zeros_like(picture)
    down[1:-1] = 0.5 * (picture[2:] - picture[:-2])
    right[:, 1:-1] = 0.5 * (picture[:, 2:] - picture[:, :-2])
    return down, right


def _depth_of_drops(places: np.ndarray, fraction: np.ndarray, spacing: float) -> np.ndarray:
    """Tell how deep each pixel lies in round drops, one for each particle that is not well inside the body.

    Args:
        places: Rows and columns of the particles (n, 2) [px].
        fraction: Water fraction inside the walls (rows, columns).
        spacing: Particle spacing [px].

    Returns:
        Depths (rows, columns) [px], -1 outside all drops.
    """
    rows, columns = fraction.shape
    radius = max(_DROP * spacing, 1.2)
    base = np.floor(places).astype(np.intp)
    seen = ((base >= 0) & (base < fraction.shape)).all(axis=1)
    base, places = base[seen], places[seen]
    outer = fraction[base[:, 0], base[:, 1]] < 0.9
    base, places = base[outer], places[outer]

    reach = int(np.ceil(radius + 0.5))
    steps = np.arange(-reach, reach + 1)
    row = base[:, 0, None] + steps
    column = base[:, 1, None] + steps
    from_row = (row + 0.5 - places[:, 0, None]) ** 2
    from_column = (column + 0.5 - places[:, 1, None]) ** 2
    inward = radius - np.sqrt(from_row[:, :, None] + from_column[:, None, :])
    inside = ((row >= 0) & (row < rows))[:, :, None] & ((column >= 0) & (column < columns))[:, None]
    hit = inside & (inward > -0.5)
    deepest = np.full(rows * columns, -1.0, dtype=np.float32)
    index = row[:, :, None] * columns + column[:, None, :]
    np.maximum.at(deepest, index[hit], inward[hit].astype(np.float32))
    return deepest.reshape(rows, columns)


def _room(shot: Shot, plan: Plan, origin: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the share of each pixel that lies on the wet side of walls and periodic faces."""
    low, high = _inner_corners(shot)
    for face in shot.faces.values():
        if face.kind == "open":
            (low if face.outward < 0 else high)[face.axis] = face.outward * np.inf
    (left, bottom), (right, top) = plan.to_pixels(low) - origin, plan.to_pixels(high) - origin
    rows, columns = np.arange(shape[0]) + 0.5, np.arange(shape[1]) + 0.5
    across = np.clip(np.minimum(columns - left, right - columns) + 0.5, 0.0, 1.0)
    along = np.clip(np.minimum(rows - top, bottom - rows) + 0.5, 0.0, 1.0)
    return np.outer(along, across).astype(np.float32)


def _light(
    colours: np.ndarray,
    depth: np.ndarray,
    fraction: np.ndarray,
    wet: np.ndarray,
    spacing: float,
) -> np.ndarray:
    """Light the water from above: dimmer with the water overhead, bright on an upper rim.

    Args:
        colours: Colours of the wet pixels (m, 3).
        depth: How deep each pixel lies below the surface (rows, columns) [px].
        fraction: Water fraction (rows, columns).
        wet: Flat numbers of the wet pixels (m,).
        spacing: Particle spacing [px].

    Returns:
        The lit colours (m, 3).
    """
    overhead = np.cumsum(np.minimum(fraction, 1.0), axis=0).ravel()[wet]
    dim = 0.26 * (1.0 - np.exp(-overhead / (0.4 * len(depth))))

    down, right = (slope.ravel()[wet] for slope in _slopes(np.clip(depth, -2.0, 4.0 + spacing)))
    facing = (0.94 * down + 0.34 * right) / np.maximum(np.hypot(down, right), 0.2)
    rim = np.exp(-((depth.ravel()[wet] / max(1.6, 0.35 * spacing)) ** 2))
    rim *= np.clip(5.0 * (0.85 - fraction.ravel()[wet]), 0.0, 1.0)
    bright = rim * (0.10 + 0.55 * np.maximum(facing, 0.0))
    dark = np.maximum(dim, rim * 0.35 * np.maximum(-facing, 0.0))
    colours = colours + dark[:, None] * (np.array(_DEEP, np.float32) - colours)
    return colours + bright[:, None] * (np.array(_FOAM, np.float32) - colours)


def _draw_face(canvas: Canvas, shot: Shot, plan: Plan, face: Side) -> None:
    low, high = _inner_corners(shot)
    if face.kind != "wall":
        low[face.axis] = high[face.axis] = face.position
        dash = (7.0, 6.0) if face.kind == "open" else (2.0, 4.0)
        line = plan.to_pixels(np.stack([low, high]))
        canvas.stroke([line], EDGE, width=1.0, opacity=0.55, dash=dash)
    elif face.moving:
        _draw_piston(canvas, shot, plan, face)
    else:
        canvas.fill([_slab(shot, plan, face)], WALL)


def _slab(shot: Shot, plan: Plan, face: Side) -> np.ndarray:
    """Return the corners of a wall, drawn outside its face (4, 2) [px].

    A fixed wall runs along the whole box and around the corner to the next fixed wall; a moving
    one fits between its neighbours.
    """
    thick = plan.thickness / plan.scale
    across, along = face.axis, 1 - face.axis
    ends = np.zeros((2, 2))
    ends[:, across] = sorted([face.position, face.position + face.outward * thick])
    for row, side in enumerate("min max".split()):
        neighbour = shot.faces[f"{'xy'[along]}_{side}"]
        box = (shot.lower, shot.upper)[row][along]
        fixed = neighbour.kind == "wall" and not neighbour.moving
        beyond = thick * neighbour.outward * fixed
        ends[row, along] = neighbour.position if face.moving else box + beyond
    return rectangle(*plan.to_pixels(ends))


def _draw_piston(canvas: Canvas, shot: Shot, plan: Plan, face: Side) -> None:
    plate = _slab(shot, plan, face)
    side = (shot.lower if face.outward < 0 else shot.upper)[face.axis]
    reach = 2.4 * plan.thickness / plan.scale
    rod = np.zeros((2, 2))
    rod[:, face.axis] = face.position, side + face.outward * reach
    low, high = _inner_corners(shot)
    rod[:, 1 - face.axis] = 0.5 * (low + high)[1 - face.axis]
    canvas.stroke([plan.to_pixels(rod)], WALL, width=0.8 * plan.thickness)
    canvas.stroke([plan.to_pixels(rod)], SKY, width=0.2 * plan.thickness, opacity=0.5)
    canvas.fill([plate], PLATE)


def _draw_body(canvas: Canvas, shot: Shot, body: Solid, plan: Plan) -> None:
    ends = np.sort(plan.to_pixels(np.stack([body.lower, body.upper])), axis=0)
    left, top = np.clip(np.floor(ends[0] - 2.0), 0, shot.size).astype(int).tolist()
    right, bottom = np.clip(np.ceil(ends[1] + 2.0), 0, shot.size).astype(int).tolist()
    if left >= right or top >= bottom:
        return
    inward = -_distance(body, plan, (left, top, right, bottom))
    cover = np.clip(inward + 0.5, 0.0, 1.0)
    canvas.stamp(cover, (left, top), PLATE if body.moving else WALL)
    if (ends[1] - ends[0]).min() > 6.0:  # A thin plate shows its own colour only.
        rim = cover * np.clip(_RIM + 0.5 - inward, 0.0, 1.0)
        canvas.stamp(rim, (left, top), PLATE_EDGE if body.moving else EDGE)


def _draw_nozzle(canvas: Canvas, nozzle: Nozzle, plan: Plan) -> None:
    """Draw the two walls and the back of a pipe, and an arrow in it while it is on."""
    along, across = nozzle.axes
    thick = 0.6 * plan.thickness / plan.scale
    end, side = nozzle.length * along, (nozzle.half[0] + 0.5 * thick) * across
    back = nozzle.center - 0.5 * thick * along
    lines = [np.stack([back + sign * side, nozzle.center + end + sign * side]) for sign in (-1.0, 1.0)]
    lines.append(np.stack([back - side - 0.5 * thick * across, back + side + 0.5 * thick * across]))
    canvas.stroke([plan.to_pixels(line) for line in lines], WALL, width=0.6 * plan.thickness)
    if nozzle.on:
        canvas.arrow(plan.to_pixels(np.stack([nozzle.center, nozzle.center + end])), INK, BACKGROUND)


def _draw_outflow(canvas: Canvas, shot: Shot, region: tuple[np.ndarray, np.ndarray], plan: Plan) -> None:
    ends = np.clip(plan.to_pixels(np.stack(region)), -20.0, np.array(shot.size) + 20.0)
    corners = rectangle(*ends)
    canvas.fill([corners], DRAIN, opacity=0.1)
    canvas.stroke(hatch(corners, 9.0), DRAIN, width=1.2, opacity=0.6)
    canvas.stroke(outline(corners), DRAIN, width=1.4, opacity=0.9, dash=(3.0, 3.0))


def _draw_zone(canvas: Canvas, zone: tuple[np.ndarray, np.ndarray], plan: Plan) -> None:
    corners = rectangle(plan.to_pixels(zone[0]), plan.to_pixels(zone[1]))
    canvas.fill([corners], ZONE, opacity=0.12)
    canvas.stroke(outline(corners), ZONE, width=1.4, opacity=0.85, dash=(6.0, 4.0))
