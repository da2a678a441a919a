"""Solid bodies and nozzles in three dimensions, seen from a camera, in front of the water or behind it.

A ray through the middle of each pixel meets boxes, balls and pipes; pixels on outlines and creases are
sampled again, several times each. Where water lies in front of a solid, it shimmers through a little.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fluidgym.render.camera import Camera
from fluidgym.render.canvas import Colour
from fluidgym.render.colour import EDGE, PLATE, PLATE_EDGE, SKY, WALL
from fluidgym.render.shot import Shot
from fluidgym.render.surface import LIGHT, add_haze

_FINE = 4  # Samples along a pixel edge, on outlines.
_THINNEST = 1.6  # Least thickness of a solid in the picture [px].
_CREASE = 1.2  # Width of the light line along a crease [px].
_MOST_RAYS = 1 << 19  # At a time.
_SHIMMER = 0.4  # Share of a solid that is seen through water just in front of it.
_CLEAR = 0.12  # Depth of water in which that share falls to a third, in box diagonals.
_PIPE_WALL = 0.6  # Thickness of the wall of a pipe, in particle spacings: it hides the water in it.
_CREASE_SHARE = 0.6  # Share of the light colour along a crease.
_INSIDE = 0.5  # Brightness of the inside of a pipe.
_FACES = 16  # Numbers kept for the faces of a piece.

_Window = tuple[int, int, int, int]


@dataclass(frozen=True)
class _Piece:
    """A solid in axes of its own.

    Attributes:
        middle: Where its middle lies (3,) [m].
        axes: Its axes as rows (3, 3).
        form: "box", "ball" or "tube", which is round about its first axis.
        half: Half its extent along its axes (3,) [m].
        bore: The same of a hole that is open at the upper end of its first axis, or None.
        colour: Of its faces.
        edge: Of its creases.
    """

    middle: np.ndarray
    axes: np.ndarray
    form: str
    half: np.ndarray
    bore: np.ndarray | None
    colour: Colour
    edge: Colour


@dataclass(frozen=True)
class _Hits:
    """What rays meet.

    Attributes:
        depth: Of the places (m,) [m], infinite where there is nothing.
        face: Numbers of the faces there (m,), -1 where there is none.
        colours: Lit colours (m, 3).
        clear: Whether water in front lets them shimmer through (m,).
    """

    depth: np.ndarray
    face: np.ndarray
    colours: np.ndarray
    clear: np.ndarray


def show_solids(
    shot: Shot, camera: Camera, water: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Render the bodies and nozzles.

    Args:
        shot: What is drawn.
        camera: The view.
        water: Depth of the water in every pixel, infinite where there is none (height * width,) [m];
            None is no water.

    Returns:
        Flat numbers of the pixels that show a solid (m,), its colours (m, 3), the shares that these take
        (m,), and the depth of the solids in every pixel, infinite where there is none (height * width,) [m].
    """
    width, height = shot.size
    solid = np.full(width * height, np.inf)
    pieces = [(piece, window) for piece in _pieces(shot, camera) if (window := _window(piece, camera, shot.size))]
    if not pieces:
        return np.empty(0, np.intp), np.empty((0, 3)), np.empty(0), solid
    left, top = np.min([window[:2] for _, window in pieces], axis=0)
    right, bottom = np.max([window[2:] for _, window in pieces], axis=0)
    rows, columns = (part.ravel() for part in np.mgrid[top:bottom, left:right])
    where = rows * width + columns
    front = np.full(len(where), np.inf) if water is None else water[where]

    hits = _cast(pieces, shot, camera, np.stack([columns, rows], axis=1) + 0.5)
    solid[where] = hits.depth
    share = _share(hits, front, shot)
    kind = (2 * hits.face + (hits.depth < front)).reshape(bottom - top, right - left)
    ragged = np.flatnonzero(_beside_change(kind))
    steps = (np.arange(_FINE) + 0.5) / _FINE
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    samples = np.stack([columns[ragged], rows[ragged]], axis=1)[:, None] + offsets
    fine = _cast(pieces, shot, camera, samples.reshape(-1, 2))
    parts = _share(fine, np.repeat(front[ragged], len(offsets)), shot)
    weighed = (parts[:, None] * fine.colours).reshape(len(ragged), len(offsets), 3).sum(axis=1)
    total = parts.reshape(len(ragged), len(offsets)).sum(axis=1)
    hits.colours[ragged] = weighed / np.maximum(total, 1e-9)[:, None]
    share[ragged] = total / len(offsets)
    shown = share > 0.0
    return where[shown], hits.colours[shown], share[shown], solid


def _share(hits: _Hits, water: np.ndarray, shot: Shot) -> np.ndarray:
    """Return the share that a solid takes of its pixel: all of it, less behind water, none where there is no solid."""
    share = (hits.depth < water).astype(np.float64)
    hidden = (hits.depth >= water) & hits.clear
    fade = _CLEAR * float(np.linalg.norm(shot.upper - shot.lower))
    share[hidden] = _SHIMMER * np.exp((water[hidden] - hits.depth[hidden]) / fade)
    return share


def _beside_change(kind: np.ndarray) -> np.ndarray:
    """Tell which cells of a picture (rows, columns) differ from one of their four neighbours."""
    beside = np.zeros(kind.shape, dtype=bool)
    for axis in range(2):
        here, there = (np.moveaxis(part, axis, 0) for part in (beside, kind))
        change = there[1:] != there[:-1]
        here[1:] |= change
        here[:-1] |= change
    return beside


def _pieces(shot: Shot, camera: Camera) -> Iterator[_Piece]:
    """Make the pieces of all bodies and nozzles, none thinner in the picture than can be seen."""

    def least(middle: np.ndarray) -> float:
        _, depth = camera.to_pixels(middle)
        return 0.5 * _THINNEST / float(camera.scale(np.maximum(depth, 0.05 * camera.distance)))

    for body in shot.bodies:
        middle = 0.5 * (body.lower + body.upper)
        half = np.maximum(0.5 * (body.upper - body.lower), least(middle))
        colours = (PLATE, PLATE_EDGE) if body.moving else (WALL, EDGE)
        yield _Piece(middle, np.eye(3), "ball" if body.round else "box", half, None, *colours)
    for nozzle in shot.inflows:
        middle = nozzle.center + 0.5 * nozzle.length * nozzle.axes[0]
        bore = np.array([0.5 * nozzle.length, *nozzle.half])
        wall = max(_PIPE_WALL * shot.spacing, 2.0 * least(middle))
        half = bore + np.array([0.0, wall, wall])
        yield _Piece(middle, nozzle.axes, "tube" if nozzle.round else "box", half, bore, WALL, EDGE)


def _window(piece: _Piece, camera: Camera, size: tuple[int, int]) -> _Window | None:
    """Return the left, top, right and bottom pixel between which a piece can show, or None."""
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * piece.half
    pixels, depth = camera.to_pixels(piece.middle + corners @ piece.axes)
    if depth.max() <= 0.0:
        return None
    if depth.min() < 0.01 * camera.distance:  # It reaches past the camera.
        return (0, 0, *size)
    left, top = np.clip(np.floor(pixels.min(axis=0)) - 1.0, 0, size).astype(int).tolist()
    right, bottom = np.clip(np.ceil(pixels.max(axis=0)) + 1.0, 0, size).astype(int).tolist()
    return (left, top, right, bottom) if left < right and top < bottom else None


def _cast(pieces: list[tuple[_Piece, _Window]], shot: Shot, camera: Camera, pixels: np.ndarray) -> _Hits:
    """Follow the rays through pixel coordinates (m, 2) [px] to the nearest pieces."""
    found = _no_hits(len(pixels))
    for start in range(0, len(pixels), _MOST_RAYS):
        part = slice(start, start + _MOST_RAYS)
        across, along = pixels[part].T
        for number, (piece, (left, top, right, bottom)) in enumerate(pieces):
            which = np.flatnonzero((across >= left) & (across <= right) & (along >= top) & (along <= bottom)) + start
            new = _meet(piece, camera, camera.rays(pixels[which]))
            nearer = np.flatnonzero(new.depth < found.depth[which])
            which = which[nearer]
            found.depth[which] = new.depth[nearer]
            found.face[which] = new.face[nearer] + _FACES * number
            found.colours[which] = add_haze(new.colours[nearer], new.depth[nearer], shot, camera)
            found.clear[which] = new.clear[nearer]
    return found


def _no_hits(count: int) -> _Hits:
    return _Hits(np.full(count, np.inf), np.full(count, -1), np.zeros((count, 3)), np.zeros(count, dtype=bool))


def _meet(piece: _Piece, camera: Camera, rays: np.ndarray) -> _Hits:
    """Find where rays (m, 3) from the camera meet a piece."""
    origin, rays = piece.axes @ (camera.eye - piece.middle), rays @ piece.axes.T
    hits = _no_hits(len(rays))
    enter, axis, leave, _ = _span(piece.form, piece.half, origin, rays)
    hit = np.flatnonzero((enter > 0.0) & (enter < leave))
    depth, axis, rays = enter[hit], axis[hit], rays[hit]
    places = origin + depth[:, None] * rays
    inside = mouth = np.zeros(len(hit), dtype=bool)
    if piece.bore is not None:
        mouth = (axis == 0) & (places[:, 0] > 0.0)
        inside = mouth & _in_profile(piece.form, piece.bore, places)
        _, _, depth[inside], axis[inside] = _span(piece.form, piece.bore, origin, rays[inside])
        places[inside] = origin + depth[inside, None] * rays[inside]
    normals = _normals(places, axis, piece.form)
    upper = (axis < 3) & (normals.sum(axis=1) > 0.0)
    normals[inside] *= -1.0
    line = _creases(piece, places, axis) * camera.scale(depth)
    line = np.where(inside, 0.0, _CREASE_SHARE * np.clip(_CREASE + 0.5 - line, 0.0, 1.0))[:, None]
    paint = np.array(piece.colour) + line * (np.array(piece.edge) - np.array(piece.colour))
    paint[inside] *= _INSIDE
    hits.depth[hit] = depth
    hits.face[hit] = 2 * axis + upper + 8 * inside
    hits.colours[hit] = _lit(paint, normals @ piece.axes, axis == 3, camera)
    hits.clear[hit] = ~mouth
    return hits


def _span(
    form: str, half: np.ndarray, origin: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return how far along a ray it enters and leaves a convex form, and through which faces.

    Args:
        form: "box", "ball" or "tube".
        half: Half its extent along the axes (3,) [m].
        origin: Where all rays start (3,) [m].
        rays: Their directions (m, 3).

    Returns:
        The first way (m,), the axis of the face there, 3 for a curved one (m,), the last way (m,) and
        the axis there (m,); where a ray misses, the last way comes before the first.
    """
    rays = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    flat = {"box": [0, 1, 2], "tube": [0], "ball": []}[form]
    curved = [axis for axis in range(3) if axis not in flat]
    ways = np.stack([(-half - origin) / rays, (half - origin) / rays])
    first, last = list(ways.min(axis=0).T[flat]), list(ways.max(axis=0).T[flat])
    faces = np.array(flat, dtype=int)
    if curved:
        a = (rays[:, curved] ** 2).sum(axis=1)
        b = rays[:, curved] @ origin[curved]
        square = b**2 - a * (origin[curved] @ origin[curved] - half[curved[0]] ** 2)
        root = np.sqrt(np.maximum(square, 0.0))
        first.append(np.where(square > 0.0, (-b - root) / a, np.inf))
        last.append(np.where(square > 0.0, (root - b) / a, -np.inf))
        faces = np.append(faces, 3)
    first, last = np.stack(first), np.stack(last)
    enters, leaves = first.argmax(axis=0), last.argmin(axis=0)
    return first.max(axis=0), faces[enters], last.min(axis=0), faces[leaves]


def _in_profile(form: str, half: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Tell which places (m, 3) lie inside a form as seen along its first axis."""
    if form == "tube":
        return np.hypot(places[:, 1], places[:, 2]) < half[1]
    return (np.abs(places[:, 1]) < half[1]) & (np.abs(places[:, 2]) < half[2])


def _normals(places: np.ndarray, axis: np.ndarray, form: str) -> np.ndarray:
    """Return the outward unit normals (m, 3) at places (m, 3) on faces across an axis, or curved ones."""
    along = np.arange(3) == axis[:, None]
    if form == "tube":
        along |= (axis == 3)[:, None] & (np.arange(3) > 0)
    elif form == "ball":
        along[:] = True
    normals = places * along
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def _creases(piece: _Piece, places: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return how far places (m, 3) on a piece lie from its nearest crease (m,) [m]."""
    if piece.form == "ball":
        return np.full(len(places), np.inf)
    away = piece.half - np.abs(places)
    if piece.form == "tube":
        across = piece.half[1] - np.hypot(places[:, 1], places[:, 2])
        return np.where(axis == 3, away[:, 0], across)
    away[np.arange(len(away)), axis] = np.inf
    return away.min(axis=1)


def _lit(colours: np.ndarray, normals: np.ndarray, curved: np.ndarray, camera: Camera) -> np.ndarray:
    """Light colours (m, 3) by their normals (m, 3); curved faces gleam."""
    lit = 0.5 + 0.5 * (normals @ LIGHT)
    half = LIGHT + camera.axes[2]
    gleam = 0.3 * np.maximum(normals @ (half / np.linalg.norm(half)), 0.0) ** 16 * curved
    colours = colours * (0.62 + 0.5 * lit)[:, None]
    return np.clip(colours + gleam[:, None] * (np.array(SKY) - colours), 0.0, 255.0)
