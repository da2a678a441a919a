"""The surface of the water in three dimensions as triangles, for viewers and other tools."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from warp.geometry import IsoSurfaceMarchingCubes

from fluidgym.render import field
from fluidgym.render.shot import Shot

_MARGIN = 2  # cells around the box
_MOST_NODES = 4_000_000


@dataclass(frozen=True)
class Mesh:
    """A closed surface.

    Attributes:
        vertices: Corners [m], (n, 3), float32.
        triangles: Numbers of their corners, anticlockwise from outside, (m, 3), int32.
    """

    vertices: np.ndarray
    triangles: np.ndarray

    @property
    def volume(self) -> float:
        """What it encloses [m3], by Gauss' theorem."""
        if not len(self.triangles):
            return 0.0
        a, b, c = (self.vertices[self.triangles[:, k]].astype(float) for k in range(3))
        return float((a * np.cross(b, c)).sum() / 6.0)


def mesh_surface(shot: Shot, cell: float | None = None) -> Mesh:
    """Find the surface: where the smooth water fraction is one half, or where the water meets a wall.

    Lone drops, which fill nowhere half of the space, have none; draw them as balls.

    Args:
        shot: What is drawn, in three dimensions.
        cell: Side of the cells of the grid that is looked at [m]; None is half of a particle spacing, or more where
            that would be more than four million.

    Raises:
        ValueError: The shot has two dimensions.
    """
    if shot.dim != 3:
        raise ValueError("mesh_surface wants a world of 3 dimensions; draw one of 2 as particles")
    size = shot.upper - shot.lower
    cell = cell or max(0.5 * shot.spacing, float(np.prod(size) / _MOST_NODES) ** (1.0 / 3.0))
    shape = tuple((np.ceil(size / cell).astype(int) + 2 * _MARGIN).tolist())
    origin = shot.lower - _MARGIN * cell
    if not len(shot.positions):
        return Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    points, values = field.with_images(shot)
    fraction, _ = field.spread(points - origin, values, shot.spacing, cell, shape)
    # Depths below the surface and behind the walls, as far as they are near.
    depth = np.minimum((fraction - 0.5) * (shot.spacing / field.SLOPE), field.room(shot, origin, cell, shape))
    depth[[0, -1]] = depth[:, [0, -1]] = depth[:, :, [0, -1]] = -cell  # closed whatever comes
    nodes: Any = wp.array(depth, dtype=float, device="cpu")
    first, last = origin + 0.5 * cell, origin + (np.array(shape) - 0.5) * cell
    vertices, indices = IsoSurfaceMarchingCubes.extract(nodes, 0.0, lower=wp.vec3(*first), upper=wp.vec3(*last))
    mesh = Mesh(vertices.numpy().reshape(-1, 3), indices.numpy().reshape(-1, 3))
    return mesh if mesh.volume >= 0.0 else Mesh(mesh.vertices, mesh.triangles[:, ::-1].copy())
