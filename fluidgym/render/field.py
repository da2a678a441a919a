"""From particles to smooth fields on a grid: how much of a place is water, and which value it has.

Each particle stands for one cell of the particle lattice, spread by a Gaussian bell. On a lattice
the bells add up to 1, half-way through a flat surface they add up to 0.5, so the surface lies where
the fraction is 0.5.
"""

from __future__ import annotations

import itertools

import numpy as np

from fluidgym.render.shot import Shot, Side

BELL = 0.62  # Standard deviation of the bell, in particle spacings: a lattice shows no ripple.
SLOPE = 1.0 / (BELL * np.sqrt(2.0 * np.pi))  # Slope of the fraction at a flat surface [1/spacing].


def with_images(shot: Shot) -> tuple[np.ndarray, np.ndarray]:
    """Add the images of particles near walls and periodic faces.

    A wall mirrors, so that water reaches into corners; a periodic face repeats the far side.

    Args:
        shot: What is drawn.

    Returns:
        Positions (m, dim) [m] and values (m,), the real particles first.
    """
    positions, values = shot.positions, shot.values
    reach = 3.0 * BELL * shot.spacing
    for face in shot.faces.values():
        if face.kind == "open":
            continue
        inside = (face.position - positions[:, face.axis]) * face.outward
        near = (inside >= 0.0) & (inside < reach)
        images = positions[near].copy()
        if face.kind == "wall":
            images[:, face.axis] = 2.0 * face.position - images[:, face.axis]
        else:
            images[:, face.axis] -= face.outward * _period(shot, face)
        positions = np.concatenate([positions, images])
        values = np.concatenate([values, values[near]])
    return positions, values


def _period(shot: Shot, face: Side) -> float:
    return float(shot.upper[face.axis] - shot.lower[face.axis])


def room(shot: Shot, origin: np.ndarray, cell: float, shape: tuple[int, int, int]) -> np.ndarray:
    """How far each point of a grid in three dimensions lies inside walls and periodic faces (nx, ny, nz) [m]."""
    along = [np.full(count, np.inf, dtype=np.float32) for count in shape]
    for face in shot.faces.values():
        if face.kind != "open":
            at = origin[face.axis] + cell * (np.arange(shape[face.axis]) + 0.5)
            inside = ((face.position - at) * face.outward).astype(np.float32)
            along[face.axis] = np.minimum(along[face.axis], inside)
    x, y, z = along
    return np.minimum(x[:, None, None], np.minimum(y[:, None], z))


def spread(
    points: np.ndarray, values: np.ndarray, spacing: float, cell: float, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Spread particles over a grid whose corner is the origin.

    Args:
        points: Positions (n, dim), any unit; particles off the grid are left out.
        values: Values (n,).
        spacing: Particle spacing, same unit.
        cell: Side of a grid cell, same unit.
        shape: Cells along each axis (dim).

    Returns:
        The fraction of each cell that is water, about 0 to 1, and the weighted mean value there
        (0 far from all particles); both of the given shape, float32.
    """
    sigma = max(BELL * spacing / cell, 0.8)
    index, share, owner = _deposit_shares(points / cell - 0.5, shape)
    volume = share * (spacing / cell) ** len(shape)
    amount = _collect(index, volume, sigma, shape)
    loaded = _collect(index, volume * values[owner], sigma, shape)
    return amount, np.divide(loaded, amount, out=np.zeros_like(loaded), where=amount > 1e-6)


def _deposit_shares(places: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split each particle between the 2^dim grid cells around it, by nearness.

    Returns flat cell numbers, shares that sum to 1 for a particle, and particle numbers.
    """
    size = np.array(shape)
    owner = np.flatnonzero(((places >= 0.0) & (places < size - 1)).all(axis=1))
    base = places[owner].astype(np.intp)
    part = places[owner] - base
    index, share = [], []
    for corner in itertools.product((0, 1), repeat=len(shape)):
        index.append(np.ravel_multi_index(tuple((base + corner).T), shape))
        share.append(np.where(corner, part, 1.0 - part).prod(axis=1))
    return np.concatenate(index), np.concatenate(share), np.tile(owner, 2 ** len(shape))


def _collect(index: np.ndarray, weights: np.ndarray, sigma: float, shape: tuple[int, ...]) -> np.ndarray:
    total = np.bincount(index, weights, minlength=int(np.prod(shape)))
    return blur(total.astype(np.float32).reshape(shape), sigma)


def blur(field: np.ndarray, sigma: float) -> np.ndarray:
    """Blur a field with a Gaussian bell along every axis; beyond its edges it counts as 0.

    Args:
        field: Any number of axes, float32.
        sigma: Standard deviation of the bell [cells].

    Returns:
        The blurred field, same shape, float32.
    """
    bell = np.exp(-0.5 * (np.arange(int(np.ceil(3.0 * sigma)) + 1) / sigma) ** 2)
    bell = (bell / (2.0 * bell.sum() - bell[0])).astype(np.float32)
    for axis in range(field.ndim):
        source = np.moveaxis(field, axis, 0)
        blurred = bell[0] * source
        for step, weight in enumerate(bell[1:], start=1):
            part = weight * source
            blurred[step:] += part[:-step]
            blurred[:-step] += part[step:]
        field = np.moveaxis(blurred, 0, axis)
    return field
