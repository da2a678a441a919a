"""What a controller sees: a coarse grid of the fluid, and a few numbers beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from gymnasium import spaces

from fluidgym.solver import Solver
from fluidgym.sph.deposit import Deposit

Kind = Literal["flat", "grid"]

# Water compressed or splashed together can fill a cell a little more than full.
FRACTION_LIMIT = 2.0
MOMENTUM_LIMIT = 1.0


def check_kind(kind: str) -> None:
    """Refuse a kind of observation that does not exist.

    Raises:
        ValueError: The kind is unknown.
    """
    if kind not in get_args(Kind):
        raise ValueError(f"obs = {kind!r} is unknown; use {' or '.join(map(repr, get_args(Kind)))}")


def check_grid(grid: Sequence[int], dim: int) -> tuple[int, ...]:
    """The shape of a coarse grid, checked.

    Raises:
        ValueError: It is not dim whole numbers above 0.
    """
    shape = tuple(grid) if isinstance(grid, Sequence | np.ndarray) else (grid,)
    whole = all(isinstance(count, int | np.integer) and count > 0 for count in shape)
    if len(shape) != dim or not whole:
        axes = {2: "(ny, nx)", 3: "(nz, ny, nx)"}[dim]
        raise ValueError(f"grid = {grid!r} must be {dim} whole numbers above 0; give {axes}, such as {(8,) * dim}")
    return tuple(int(count) for count in shape)


def deposit(solver: Solver, grid: Sequence[int], reference_speed: float) -> Deposit:
    """The coarse grid of a solver's worlds, its values clipped into the observation space.

    Args:
        solver: Whose particles.
        grid: Cells along each axis, (ny, nx) or (nz, ny, nx).
        reference_speed: Speed that counts as 1 [m/s].
    """
    scene = solver.scene
    return Deposit(
        scene.lower,
        scene.upper,
        grid,
        scene.particle_spacing,
        reference_speed,
        solver.num_worlds,
        solver.capacity,
        solver.device,
        FRACTION_LIMIT,
        MOMENTUM_LIMIT,
    )


def space(kind: str, grid: Sequence[int], numbers: Sequence[tuple[float, float]]) -> spaces.Box:
    """The space of the observations of one world.

    Args:
        kind: "flat" is one vector; "grid" is (channels, *grid), where each number fills a channel of its own.
        grid: Cells along each axis.
        numbers: Lowest and highest value of each number beside the grid.
    """
    dim, cells = len(grid), int(np.prod(grid))
    limits = [(0.0, FRACTION_LIMIT), *[(-MOMENTUM_LIMIT, MOMENTUM_LIMIT)] * dim]
    if kind == "flat":
        columns = np.concatenate([np.repeat(limits, cells, axis=0), np.reshape(numbers, (-1, 2))]).astype(np.float32)
        return spaces.Box(columns[:, 0], columns[:, 1], dtype=np.float32)
    channels = np.asarray([*limits, *numbers], np.float32)
    shape = (len(channels), *grid)
    low, high = (np.broadcast_to(channels[:, side].reshape(-1, *[1] * dim), shape) for side in (0, 1))
    return spaces.Box(low, high, shape, np.float32)


def assemble(kind: str, grid: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """The observations of all worlds, float32.

    Args:
        kind: As in `space`.
        grid: (world, channel, *grid).
        numbers: (world, number).
    """
    numbers = numbers.astype(np.float32)
    if kind == "flat":
        return np.concatenate([grid.reshape(len(grid), -1), numbers], axis=1, dtype=np.float32)
    filled = np.broadcast_to(numbers.reshape(*numbers.shape, *[1] * (grid.ndim - 2)), (*numbers.shape, *grid.shape[2:]))
    return np.concatenate([grid, filled], axis=1, dtype=np.float32)
