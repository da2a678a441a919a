"""What rewards are made of: parts in known ranges, and their sum.

Every part lies in 0 to 1 for any world. Only exact arithmetic is used (no powers, no exponentials), so that a world's
reward has the same bits alone and among others.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def containment(in_zone: np.ndarray) -> np.ndarray:
    """Share of the fluid that is inside the target zone: 0 none of it, 1 all; (world,)."""
    return in_zone.clip(0.0, 1.0)


def splash(above: np.ndarray) -> np.ndarray:
    """Share of the fluid that is above the splash height: 0 none of it, 1 all; (world,)."""
    return above.clip(0.0, 1.0)


def spread(distance: np.ndarray, width: float) -> np.ndarray:
    """How far apart the fluid is along x: 0 all in one place, 1 one half at each end of the box.

    Fluid that lies evenly over the whole box has 0.58, over half of it 0.29.

    Args:
        distance: Root mean square distance from the centre of mass [m], (world,).
        width: Width of the box [m].
    """
    return (2.0 * distance / width).clip(0.0, 1.0)


def spill(lost: np.ndarray) -> np.ndarray:
    """How much of the fluid is lost: 0 nothing, 1 a tenth of it or more.

    Args:
        lost: Share of the fluid that is gone, (world,).
    """
    return (10.0 * lost).clip(0.0, 1.0)


def unrest(kinetic: np.ndarray, speed: float) -> np.ndarray:
    """How fast the fluid moves: 0 at rest, 1 at half of a speed or more.

    Args:
        kinetic: Mean of u^2 / 2 over the fluid [m2/s2], (world,).
        speed: [m/s].
    """
    return (2.0 * np.sqrt(2.0 * kinetic) / speed).clip(0.0, 1.0)


def evenness(depths: np.ndarray) -> np.ndarray:
    """How evenly the fluid covers the floor: 1 equally deep everywhere, 0 all of it in one column.

    Args:
        depths: Of the fluid in columns of equal width [m], (world, column).
    """
    n = depths.shape[1]
    mean = np.maximum(depths.mean(axis=1), 1e-12)
    off = np.abs(depths - mean[:, None]).mean(axis=1)
    return (1.0 - off / (2.0 * mean * (1.0 - 1.0 / n))).clip(0.0, 1.0)


def effort(speed: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """How hard an actuator works: 0 at rest, 1 at its largest speed and acceleration at once; (world,).

    Args:
        speed: Speed over the largest, -1 to 1, (world,).
        acceleration: Acceleration over the largest, -1 to 1, (world,).
    """
    return (0.5 * (speed * speed + acceleration * acceleration)).clip(0.0, 1.0)


def total(gain: np.ndarray, costs: Mapping[str, np.ndarray], weights: Mapping[str, float]) -> np.ndarray:
    """The gain less the weighted costs: between lowest(weights) and 1; (world,)."""
    reward = gain.astype(float)
    for name, weight in weights.items():
        reward = reward - weight * costs[name]
    return reward


def lowest(weights: Mapping[str, float]) -> float:
    """The lowest total there can be."""
    return -float(sum(weights.values()))
