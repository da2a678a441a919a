"""The surface of the water in three dimensions: where it is, and how it looks from a camera.

The surface is where the smooth water fraction is one half, or where the water meets a wall. It is
found as a set of small discs, one for each grid edge that pierces it, each with its normal. The
discs that face the camera, and a ball for every splash particle, are cut into one fragment per
pixel; the nearest fragments of a pixel are averaged and shaded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluidgym.render import field
from fluidgym.render.camera import Camera
from fluidgym.render.colour import BACKGROUND, SKY, colour_values
from fluidgym.render.shot import Shot

_BALL = 0.45  # Radius of a splash particle, in particle spacings.
_DISC = 0.93  # Radius of a surface disc, in grid cells.
_SUNK = 0.2  # Depth at which a particle shows no ball of its own, in particle spacings.
_CELL_PIXELS = 4.5  # Wished size of a grid cell in the picture.
_MOST_CELLS = 6_000_000
_STEEPEST = np.float32(0.12)  # A disc seen edge-on is cut as if it were tilted this much.
_HAZE = 0.3  # Share of the background in the colour of the farthest water.
LIGHT = np.array([-0.35, -0.45, 0.82]) / np.linalg.norm([-0.35, -0.45, 0.82])


@dataclass(frozen=True)
class Patches:
    """Small pieces of surface.

    Attributes:
        places: Their middles (m, 3) [m].
        normals: Unit vectors out of the water (m, 3); for balls not used.
        values: What they are coloured by (m,).
        radius: Their radii (m,) [m].
        round: Whether they are balls, not discs.
    """

    places: np.ndarray
    normals: np.ndarray
    values: np.ndarray
    radius: np.ndarray
    round: bool


def find_surface(shot: Shot, camera: Camera) -> tuple[Patches, Patches]:
    """Find the surface of the water.

    Args:
        shot: What is drawn, with at least one particle.
        camera: The view; the more pixels, the finer the search.

    Returns:
        Discs on the surface, and balls for the particles that are not inside the body.
    """
    if shot.spheres:
        radius, nothing = np.full(len(shot.positions), 0.5 * shot.spacing), np.zeros((0, 3))
        balls = Patches(shot.positions, np.zeros_like(shot.positions), shot.values, radius, True)
        return Patches(nothing, nothing, np.zeros(0), np.zeros(0), False), balls
    origin, cell, shape = _grid(shot, camera)
    points, values = field.with_images(shot)
    fraction, value = field.spread(points - origin, values, shot.spacing, cell, shape)
    depth = (fraction - 0.5) * (shot.spacing / field.SLOPE)
    room = field.room(shot, origin, cell, shape)
    lost = _rounding(depth, room, shot.spacing)
    balls = _loose_balls(shot, np.where(room < 0.0, room, depth - lost), origin, cell)
    places, normals, at_places = _pierced_edges(np.minimum(depth, room) - lost, value)
    radius = np.full(len(places), _DISC * cell)
    discs = Patches(origin + cell * (places + 0.5), normals, at_places, radius, False)
    return discs, balls


def _rounding(depth: np.ndarray, room: np.ndarray, width: float) -> np.ndarray:
    """Return how much depth the water loses where its surface meets a wall, so that the rim there is round.

    Args:
        depth: Depth below the free surface (nx, ny, nz) [m].
        room: Distance inside the walls (nx, ny, nz) [m].
        width: Width of the rim [m].

    Returns:
        What to take off the smaller of the two (nx, ny, nz) [m].
    """
    return (0.25 * width) * np.maximum(1.0 - np.abs(depth - room) / width, 0.0) ** 2


def _loose_balls(shot: Shot, depth: np.ndarray, origin: np.ndarray, cell: float) -> Patches:
    """Make balls for the particles outside the body; they shrink to nothing below its surface."""
    places = np.clip((shot.positions - origin) / cell, 0, np.array(depth.shape) - 1)
    below = depth[tuple(places.astype(np.intp).T)]
    size = np.clip(1.0 - below / (_SUNK * shot.spacing), 0.0, 1.0)
    loose = size > 0.05
    places, radius = shot.positions[loose], _BALL * shot.spacing * size[loose]
    return Patches(places, np.zeros_like(places), shot.values[loose], radius, True)


def _grid(shot: Shot, camera: Camera) -> tuple[np.ndarray, float, tuple[int, int, int]]:
    """Lay a grid over the water in the box: corner (3,) [m], cell [m] and cells along each axis."""
    pad = 2.0 * shot.spacing
    low = np.clip(shot.positions.min(axis=0), shot.lower, shot.upper) - pad
    high = np.clip(shot.positions.max(axis=0), shot.lower, shot.upper) + pad
    wish = _CELL_PIXELS * camera.distance / camera.zoom
    cell = min(max(wish, shot.spacing / 3.5), shot.spacing / 1.7)
    cell = max(cell, float(np.cbrt(np.prod(high - low) / _MOST_CELLS)))
    shape = np.ceil((high - low) / cell).astype(int)
    return low, cell, tuple(shape.tolist())


def _pierced_edges(depth: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find where the edges between neighbouring grid points pierce the surface.

    Args:
        depth: Depth below the surface at the grid points (nx, ny, nz), negative outside.
        value: What to colour by at the grid points (nx, ny, nz).

    Returns:
        Places in grid steps (m, 3), unit normals out of the water (m, 3), values (m,).
    """
    core = depth[1:-1, 1:-1, 1:-1]
    wet = core > 0.0
    places, normals, values = [], [], []
    for axis in range(3):
        here = np.argwhere(np.diff(wet, axis=axis)) + 1
        step = np.eye(3, dtype=int)[axis]
        there = here + step
        inner, outer = depth[tuple(here.T)], depth[tuple(there.T)]
        share = (inner / (inner - outer))[:, None]
        places.append(here + share * step)
        slope = (1.0 - share) * _slope(depth, here) + share * _slope(depth, there)
        normals.append(-slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12))
        ends = np.stack([value[tuple(here.T)], value[tuple(there.T)]], axis=1)
        values.append(np.where(inner > 0.0, ends[:, 0], ends[:, 1]))
    return np.concatenate(places), np.concatenate(normals), np.concatenate(values)


def _slope(grid: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the central differences (m, 3) of a grid at inner grid points (m, 3)."""
    flat, at = grid.ravel(), np.ravel_multi_index(tuple(index.T), grid.shape)
    steps = np.array(grid.strides) // grid.itemsize
    return np.stack([flat[at + step] - flat[at - step] for step in steps], axis=1)


def show_surface(shot: Shot, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Render the water.

    Args:
        shot: What is drawn, with at least one particle.
        camera: The view.

    Returns:
        Flat numbers of the pixels that show water (m,), their colours (m, 3), flat numbers of the
        pixels along its outlines (k,), and the depth of the water in every pixel, infinite where
        there is none (height * width,) [m].
    """
    cuts = [_cut(patches, camera, shot.size) for patches in find_surface(shot, camera)]
    pixel, depth, weight, normals, values = map(np.concatenate, zip(*cuts, strict=True))
    count = shot.size[0] * shot.size[1]
    nearest = np.full(count, np.inf, dtype=np.float32)
    np.minimum.at(nearest, pixel, depth)
    together = (0.05 if shot.spheres else 0.5) * shot.spacing  # what is so near in depth is one surface
    weight = weight * (depth < nearest[pixel] + together)
    total = np.bincount(pixel, weight, minlength=count)
    wet = np.flatnonzero(total > 0.0)

    def mean(amount: np.ndarray) -> np.ndarray:
        return np.bincount(pixel, weight * amount, minlength=count)[wet] / total[wet]

    normal = np.stack([mean(part) for part in normals.T], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    colours = _shade(colour_values(mean(values), shot.value_range), normal, camera)
    colours = add_haze(colours, nearest[wet], shot, camera)
    return wet, colours, _borders(nearest.reshape(shot.size[::-1]), shot.spacing), nearest


def add_haze(colours: np.ndarray, depth: np.ndarray, shot: Shot, camera: Camera) -> np.ndarray:
    """Let colours (m, 3) at depths (m,) [m] fade into the background with the distance."""
    reach = float(np.linalg.norm(shot.upper - shot.lower))
    far = np.clip((depth - camera.distance) / reach + 0.5, 0.0, 1.0)[:, None]
    return colours + _HAZE * far * (np.array(BACKGROUND) - colours)


def _borders(depth: np.ndarray, jump: float) -> np.ndarray:
    """Return the flat numbers of pixels beside a jump in depth (rows, columns) [m]."""
    with np.errstate(invalid="ignore"):
        down = np.abs(np.diff(depth, axis=0)) > jump
        right = np.abs(np.diff(depth, axis=1)) > jump
    beside = np.zeros(depth.shape, dtype=bool)
    beside[1:] |= down
    beside[:-1] |= down
    beside[:, 1:] |= right
    beside[:, :-1] |= right
    return np.flatnonzero(beside)


def _cut(
    patches: Patches, camera: Camera, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cut patches into fragments, one for each pixel whose middle they cover.

    Returns:
        Flat pixel numbers (k,), depths (k,) [m], weights from 1 in the middle of a patch to 0 at
        its rim (k,), normals in camera axes (k, 3) and values (k,).
    """
    width, height = size
    pixels, depth = camera.to_pixels(patches.places)
    seen = _in_view(patches, pixels, depth, camera, size)
    base = np.floor(pixels[seen]).astype(np.intp)
    offset = (base + 0.5 - pixels[seen]).astype(np.float32)
    normals = (patches.normals[seen] @ camera.axes.T).astype(np.float32)
    depth, values, radius = (part[seen].astype(np.float32) for part in (depth, patches.values, patches.radius))
    extent = (radius * camera.scale(depth)).astype(np.float32)

    # How far the middles of the pixels around lie from the middle of the patch, in patch radii.
    reach = int(extent.max(initial=0.0) + 0.5)
    steps = np.arange(-reach, reach + 1)
    nearby = steps.astype(np.float32)
    right = ((offset[:, 0, None] + nearby) / extent[:, None])[:, None, :]
    up = -((offset[:, 1, None] + nearby) / extent[:, None])[:, :, None]
    if patches.round:
        apart = right**2 + up**2
    else:
        tilt = normals[:, :2] / np.maximum(normals[:, 2:], _STEEPEST)
        back = -(tilt[:, 0, None, None] * right + tilt[:, 1, None, None] * up)
        apart = right**2 + up**2 + back**2
    who, i, j = np.nonzero(apart < 1.0)
    row, column = base[who, 1] + steps[i], base[who, 0] + steps[j]
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    who, i, j, row, column = (part[inside] for part in (who, i, j, row, column))
    apart = apart[who, i, j]
    if patches.round:
        back = np.sqrt(1.0 - apart)
        normal = np.stack([right[who, 0, j], up[who, i, 0], back], axis=1)
        weight = np.ones_like(back)
    else:
        back, normal, weight = back[who, i, j], normals[who], (1.0 - apart) ** 2
    return row * width + column, depth[who] - back * radius[who], weight, normal, values[who]


def _in_view(
    patches: Patches, pixels: np.ndarray, depth: np.ndarray, camera: Camera, size: tuple[int, int]
) -> np.ndarray:
    """Tell which patches can show in the picture: those about inside it, and of discs those that face the camera."""
    seen = (depth > 0.0) & (pixels > -50.0).all(axis=1) & (pixels < np.array(size) + 50.0).all(axis=1)
    if not patches.round:
        seen &= np.einsum("ij,ij->i", patches.normals, camera.eye - patches.places) > 0.0
    return seen


def _shade(colours: np.ndarray, normal: np.ndarray, camera: Camera) -> np.ndarray:
    """Light the water.

    Args:
        colours: Colours of the pixels (m, 3).
        normal: Unit normals in camera axes (m, 3).
        camera: The view.

    Returns:
        The lit colours (m, 3).
    """
    light = camera.axes @ LIGHT
    lit = 0.5 + 0.5 * (normal @ light)
    half = light + np.array([0.0, 0.0, 1.0])
    gleam = np.maximum(normal @ (half / np.linalg.norm(half)), 0.0) ** 30
    grazing = (1.0 - np.clip(normal[:, 2], 0.0, 1.0)) ** 4
    colours = colours * (0.5 + 0.6 * lit)[:, None]
    share = np.clip(0.45 * grazing + 0.4 * gleam, 0.0, 1.0)[:, None]
    return colours + share * (np.array(SKY) - colours)
