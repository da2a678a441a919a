"""Three-dimensional drawings: a body of water in a glass box."""

from __future__ import annotations

import itertools

import numpy as np

from fluidgym.render.camera import Camera, aim
from fluidgym.render.canvas import Canvas, hatch, outline
from fluidgym.render.colour import BACKGROUND, DRAIN, EDGE, FLOOR, INK, PLATE, TANK, WALL, ZONE
from fluidgym.render.fittings import Nozzle
from fluidgym.render.legend import Layout
from fluidgym.render.shot import Shot, Side
from fluidgym.render.solids import show_solids
from fluidgym.render.surface import show_surface

_ROD = 0.05  # How far a piston rod sticks out of the box, in box diagonals.


def draw_space(canvas: Canvas, shot: Shot, layout: Layout) -> None:
    """Draw a three-dimensional picture.

    Args:
        canvas: The picture to paint on.
        shot: What is drawn.
        layout: Which part of the picture is the view.
    """
    camera = aim(shot.lower, shot.upper, layout, margin=1.2 * layout.type_size, angles=shot.camera)
    _draw_back(canvas, shot, camera)
    water = solid = borders = None
    if len(shot.positions):
        wet, colours, borders, water = show_surface(shot, camera)
        canvas.shade(wet, colours, np.ones(len(wet)))
    if shot.bodies or shot.inflows:
        where, colours, share, solid = show_solids(shot, camera, water)
        canvas.shade(where, colours, share)
    if borders is not None:
        canvas.soften(borders)
    for nozzle in shot.inflows:
        _draw_flow(canvas, nozzle, camera)
    for region in shot.outflows:
        _draw_outflow(canvas, shot, region, camera)
    if shot.zone is not None:
        _draw_zone(canvas, shot.zone, camera)
    _draw_front(canvas, shot, camera, solid)


def _draw_back(canvas: Canvas, shot: Shot, camera: Camera) -> None:
    """Draw what the water can hide: the floor, the far walls and their edges."""
    for face in shot.faces.values():
        if face.kind == "wall" and not face.moving and not _in_front(face, camera):
            floor = face.axis == 2 and face.outward < 0
            canvas.fill([_project(camera, _quad(shot, face))], FLOOR if floor else TANK)
    _draw_edges(canvas, shot, camera, front=False)
    _draw_plates(canvas, shot, camera, front=False)


def _draw_front(canvas: Canvas, shot: Shot, camera: Camera, solid: np.ndarray | None) -> None:
    """Draw what the water lies behind: plates towards the viewer and the near edges."""
    _draw_plates(canvas, shot, camera, front=True)
    _draw_edges(canvas, shot, camera, front=True, solid=solid)


def _in_front(face: Side, camera: Camera) -> bool:
    """Tell whether a face lies between the camera and the water."""
    return bool((camera.eye[face.axis] - face.position) * face.outward > 0.0)


def _project(camera: Camera, points: np.ndarray) -> np.ndarray:
    return camera.to_pixels(points)[0]


def _quad(shot: Shot, face: Side) -> np.ndarray:
    """Return the corners of a face, in order (4, 3) [m].

    A fixed face spans the box; a moving one fits between its neighbours.
    """
    low, high = shot.lower.copy(), shot.upper.copy()
    if face.moving:
        for other in shot.faces.values():
            (low if other.outward < 0 else high)[other.axis] = other.position
    first, second = (axis for axis in range(3) if axis != face.axis)
    corners = np.empty((4, 3))
    corners[:, face.axis] = face.position
    corners[:, first] = low[first], high[first], high[first], low[first]
    corners[:, second] = low[second], low[second], high[second], high[second]
    return corners


def _box_edges(lower: np.ndarray, upper: np.ndarray) -> list[tuple[np.ndarray, list[tuple[int, int]]]]:
    """List the 12 edges of a box: end points (2, 3) [m], and (axis, side) of the faces there."""
    edges = []
    for axis in range(3):
        others = [other for other in range(3) if other != axis]
        for sides in itertools.product((-1, 1), repeat=2):
            ends = np.stack([lower, upper])
            for other, side in zip(others, sides, strict=True):
                ends[:, other] = (lower if side < 0 else upper)[other]
            edges.append((ends, list(zip(others, sides, strict=True))))
    return edges


def _draw_edges(canvas: Canvas, shot: Shot, camera: Camera, *, front: bool, solid: np.ndarray | None = None) -> None:
    """Draw the box edges on one side of the water; an edge without a wall beside it is dashed.

    Solids whose depths are given hide what lies behind them.
    """
    faces = {(face.axis, face.outward): face for face in shot.faces.values()}
    full, dashed = [], []
    for ends, beside in _box_edges(shot.lower, shot.upper):
        if any(_in_front(faces[key], camera) for key in beside) != front:
            continue
        walled = any(faces[key].kind == "wall" for key in beside)
        (full if walled else dashed).extend(_in_sight(camera, ends, solid, shot.size))
    opacity = 0.6 if front else 0.35
    canvas.stroke(full, EDGE, width=1.2, opacity=opacity)
    canvas.stroke(dashed, EDGE, width=1.0, opacity=opacity, dash=(5.0, 5.0))


def _in_sight(camera: Camera, ends: np.ndarray, solid: np.ndarray | None, size: tuple[int, int]) -> list[np.ndarray]:
    """Project a line (2, 3) [m] and return its pieces (2, 2) [px] that no solid hides."""
    line = _project(camera, ends)
    if solid is None:
        return [line]
    count = int(np.clip(np.linalg.norm(line[1] - line[0]) / 2.0, 1, 2000))
    points = ends[0] + np.linspace(0.0, 1.0, count + 1)[:, None] * (ends[1] - ends[0])
    pixels, depth = camera.to_pixels(0.5 * (points[1:] + points[:-1]))
    column, row = np.clip(np.floor(pixels), 0, np.array(size) - 1).astype(int).T
    outside = (pixels < 0).any(axis=1) | (pixels >= size).any(axis=1)
    seen = np.concatenate(
        [[False], outside | (depth < solid[row * size[0] + column] + 1e-3 * camera.distance), [False]]
    )
    turns = np.flatnonzero(np.diff(seen))
    return [_project(camera, points[turns[turn : turn + 2]]) for turn in range(0, len(turns), 2)]


def _draw_flow(canvas: Canvas, nozzle: Nozzle, camera: Camera) -> None:
    """Draw an arrow on a nozzle that is on."""
    ends = nozzle.center + np.outer([0.0, nozzle.length], nozzle.axes[0])
    line, depth = camera.to_pixels(ends)
    if nozzle.on and depth.min() > 0.0:
        canvas.arrow(line, INK, BACKGROUND)


def _draw_outflow(canvas: Canvas, shot: Shot, region: tuple[np.ndarray, np.ndarray], camera: Camera) -> None:
    reach = 0.8 * float(np.linalg.norm(shot.upper - shot.lower))  # Short of the camera.
    middle = 0.5 * (shot.lower + shot.upper)
    low, high = (np.clip(corner, middle - reach, middle + reach) for corner in region)
    if not (low < high).all():
        return
    sides = _sides(low, high, camera)
    canvas.fill(sides, DRAIN, opacity=0.1)
    canvas.stroke([line for side in sides[::2] for line in hatch(side, 9.0)], DRAIN, width=1.1, opacity=0.5)
    edges = [_project(camera, ends) for ends, _ in _box_edges(low, high)]
    canvas.stroke(edges, DRAIN, width=1.3, opacity=0.9, dash=(3.0, 3.0))


def _sides(lower: np.ndarray, upper: np.ndarray, camera: Camera) -> list[np.ndarray]:
    """Project the sides of a box, two for each axis (4, 2) [px]."""
    corners = np.array(list(itertools.product(*zip(lower, upper, strict=True))))
    return [
        _project(camera, corners[corners[:, axis] == bound[axis]][[0, 1, 3, 2]])
        for axis in range(3)
        for bound in (lower, upper)
    ]


def _draw_plates(canvas: Canvas, shot: Shot, camera: Camera, *, front: bool) -> None:
    for face in shot.faces.values():
        if face.kind != "wall" or not face.moving or _in_front(face, camera) != front:
            continue
        quad = _quad(shot, face)
        rod = np.stack([quad.mean(axis=0)] * 2)
        side = (shot.lower if face.outward < 0 else shot.upper)[face.axis]
        diagonal = float(np.linalg.norm(shot.upper - shot.lower))
        rod[1, face.axis] = side + face.outward * _ROD * diagonal
        plate = _project(camera, quad)
        if not front:
            canvas.stroke([_project(camera, rod)], WALL, width=4.0)
        canvas.fill([plate], PLATE, opacity=0.28 if front else 0.5)
        canvas.stroke(outline(plate), PLATE, width=1.8, opacity=0.95)
        if front:
            canvas.stroke([_project(camera, rod)], WALL, width=4.0)


def _draw_zone(canvas: Canvas, zone: tuple[np.ndarray, np.ndarray], camera: Camera) -> None:
    edges = [_project(camera, ends) for ends, _ in _box_edges(*zone)]
    canvas.fill(_sides(*zone, camera), ZONE, opacity=0.12)
    canvas.stroke(edges, ZONE, width=1.3, opacity=0.85, dash=(6.0, 4.0))
