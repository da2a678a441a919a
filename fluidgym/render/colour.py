"""The colours of a drawing: the water colour map and the fixed tints around it."""

from __future__ import annotations

import functools

import numpy as np

BACKGROUND = (12, 18, 28)
TANK = (19, 28, 42)
FLOOR = (30, 42, 60)
WALL = (98, 112, 132)
EDGE = (150, 166, 188)
PLATE = (243, 164, 66)
PLATE_EDGE = (255, 206, 140)
ZONE = (132, 236, 172)
DRAIN = (240, 108, 146)
INK = (222, 231, 242)
FAINT_INK = (146, 161, 182)
SKY = (206, 232, 250)

# From still to fast: deep blue, blue, azure, pale cyan, foam.
_ANCHORS = ((30, 82, 168), (28, 122, 206), (48, 168, 226), (128, 216, 238), (240, 252, 255))
_STEPS = 1024

# sRGB (linear) -> cone response -> OKLab, the perceptual space of Ottosson (2020).
_TO_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_TO_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


def to_oklab(rgb: np.ndarray) -> np.ndarray:
    """Convert sRGB colours to OKLab.

    Args:
        rgb: Colours in 0 to 255 (..., 3).

    Returns:
        Lightness and the two opponent axes (..., 3).
    """
    share = np.asarray(rgb, dtype=np.float64) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.cbrt(linear @ _TO_CONES.T) @ _TO_LAB.T


def from_oklab(lab: np.ndarray) -> np.ndarray:
    """Convert OKLab colours to sRGB, clipped to what a screen can show.

    Args:
        lab: Lightness and the two opponent axes (..., 3).

    Returns:
        Colours in 0 to 255 (..., 3), not rounded.
    """
    cones = (np.asarray(lab, dtype=np.float64) @ np.linalg.inv(_TO_LAB).T) ** 3
    linear = np.clip(cones @ np.linalg.inv(_TO_CONES).T, 0.0, 1.0)
    share = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return share * 255.0


@functools.cache
def water_map() -> np.ndarray:
    """Return the water colour map, from the lowest value to the highest.

    The anchors are joined in OKLab and then spaced by arc length, so that equal steps in the
    value look like equal steps in the colour.

    Returns:
        Colours in 0 to 255 (1024, 3), float32, read-only.
    """
    anchors = to_oklab(np.array(_ANCHORS))
    at = np.linspace(0.0, len(anchors) - 1.0, 4 * _STEPS)
    path = np.stack([np.interp(at, range(len(anchors)), axis) for axis in anchors.T], axis=1)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    even = np.linspace(0.0, length[-1], _STEPS)
    colours = from_oklab(np.stack([np.interp(even, length, axis) for axis in path.T], axis=1))
    colours = colours.astype(np.float32)
    colours.setflags(write=False)
    return colours


def colour_values(values: np.ndarray, value_range: tuple[float, float]) -> np.ndarray:
    """Look values up in the water colour map.

    Args:
        values: Finite values (...,), in the unit of ``value_range``.
        value_range: The values at the two ends of the map; values beyond them take the end colour.

    Returns:
        Colours in 0 to 255 (..., 3), float32.
    """
    low, high = value_range
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    return water_map()[np.rint(share * (_STEPS - 1)).astype(np.intp)]
