"""A camera that looks at a box, from the front, the right and above unless it is put elsewhere."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from fluidgym.render.legend import Layout
from fluidgym.render.shot import USUAL_CAMERA

_DISTANCE = 1.9  # From the middle of the box to the eye, in box diagonals.


@dataclass(frozen=True)
class Camera:
    """A perspective view.

    Attributes:
        eye: Where the camera stands (3,) [m].
        axes: Unit vectors to the right, up and backwards to the camera, one a row (3, 3).
        distance: Depth of the middle of the box [m].
        zoom: Pixels per metre at a depth of 1 m [px].
        middle: Pixel that the optical axis meets (2,) [px].
    """

    eye: np.ndarray
    axes: np.ndarray
    distance: float
    zoom: float
    middle: np.ndarray

    def to_pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project positions (..., 3) [m].

        Args:
            points: Positions (..., 3) [m].

        Returns:
            Pixel coordinates (..., 2) [px], y down, and depths along the optical axis (...) [m].
        """
        seen = (np.asarray(points) - self.eye) @ self.axes.T
        depth = -seen[..., 2]
        flat = seen[..., :2] * (self.zoom, -self.zoom)
        return self.middle + flat / np.maximum(depth, 1e-9)[..., None], depth

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Return the directions (m, 3) in which pixel coordinates (m, 2) [px] see, each 1 m in depth long."""
        flat = (pixels - self.middle) / (self.zoom, -self.zoom)
        return flat @ self.axes[:2] - self.axes[2]

    def scale(self, depth: np.ndarray) -> np.ndarray:
        """Return the pixels per metre [px/m] at depths (...) [m]."""
        return self.zoom / np.maximum(depth, 1e-9)


def aim(
    lower: np.ndarray, upper: np.ndarray, layout: Layout, margin: float, angles: tuple[float, float] = USUAL_CAMERA
) -> Camera:
    """Set up the camera so that the box just fits the view.

    Args:
        lower: Lower box corner (3,) [m].
        upper: Upper box corner (3,) [m].
        layout: Which part of the picture is the view.
        margin: Free space inside the view on every side [px].
        angles: Around the box from the front to the right, and up from the floor [degrees].

    Returns:
        The camera.
    """
    around, up = np.radians(angles)
    back = np.array([np.sin(around) * np.cos(up), -np.cos(around) * np.cos(up), np.sin(up)])
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back])
    distance = _DISTANCE * float(np.linalg.norm(upper - lower))
    eye = 0.5 * (lower + upper) + distance * back

    plain = Camera(eye, axes, distance, 1.0, np.zeros(2))
    corners = np.array(list(itertools.product(*zip(lower, upper, strict=True))))
    pixels, _ = plain.to_pixels(corners)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    room = np.array([layout.right - layout.left, layout.bottom - layout.top]) - 2.0 * margin
    zoom = float((np.maximum(room, 8.0) / (high - low)).min())
    view = 0.5 * np.array([layout.left + layout.right, layout.top + layout.bottom])
    return Camera(eye, axes, distance, zoom, view - 0.5 * (low + high) * zoom)
