"""What a controller sees: a coarse grid of the fluid, and a few numbers beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces

from fluidgym.scene import Ball
from fluidgym.solver import Solver
from fluidgym.sph.deposit import Deposit

Kind = Literal["flat", "grid", "image"]

# Water compressed or splashed together can fill a cell a little more than full.
FRACTION_LIMIT = 2.0
MOMENTUM_LIMIT = 1.0

PIXELS = 40  # of an image each way, at least: the usual networks want 36


def check_kind(kind: str) -> None:
    """Refuse a kind of observation that does not exist.

    Raises:
        ValueError: The kind is unknown.
    """
    if kind not in get_args(Kind):
        raise ValueError(f"obs = {kind!r} is unknown; use {', '.join(map(repr, get_args(Kind)))}")


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


class View:
    """What one observation is made of, and its space.

    Attributes:
        kind: "flat" is one vector; "grid" is (channel, *grid), where each number fills a channel of its own; "image" is
            the same as uint8 (row, column, channel), the top row first and each cell enlarged to as many pixels as make
            at least 40 each way.
        grid: Cells along each axis.
        numbers: Lowest and highest value of each number beside the grid.
        solid: Whether the share of each cell that is solid is a channel, after the momentum.
        stack: How many frames an observation has, the latest last.
        space: Of the observations of one world.
    """

    def __init__(
        self,
        kind: str,
        grid: Sequence[int],
        numbers: Sequence[tuple[float, float]],
        solid: bool = False,
        stack: int = 1,
    ):
        """Lay it out.

        Raises:
            ValueError: An image is asked for of a world that has three dimensions, or the stack has no frame.
        """
        if kind == "image" and len(grid) != 2:
            raise ValueError("obs = 'image' is for 2D only; use 'grid' in 3D")
        if not isinstance(stack, int | np.integer) or not 1 <= stack <= 16:
            raise ValueError(f"stack = {stack!r} is outside 1 to 16; use 1, or 4 where a policy has no memory")
        dim = len(grid)
        self.kind, self.grid, self.numbers, self.solid, self.stack = kind, tuple(grid), numbers, solid, int(stack)
        limits = [(0.0, FRACTION_LIMIT), *[(-MOMENTUM_LIMIT, MOMENTUM_LIMIT)] * dim, *[(0.0, 1.0)] * solid]
        self._low, self._high = np.asarray([*limits, *numbers], np.float32).T
        self._zoom = -(-PIXELS // min(grid))
        if kind == "image":
            shape = (grid[0] * self._zoom, grid[1] * self._zoom, len(self._low) * stack)
            self.space = spaces.Box(0, 255, shape, np.uint8)
            return
        if kind == "flat":
            cells, own = int(np.prod(grid)), len(limits)
            sides = [np.concatenate([np.repeat(side[:own], cells), side[own:]]) for side in (self._low, self._high)]
        else:
            shape = (len(self._low), *grid)
            sides = [np.broadcast_to(side.reshape(-1, *[1] * dim), shape) for side in (self._low, self._high)]
        low, high = (np.concatenate([side] * stack) for side in sides)
        self.space = spaces.Box(low, high, dtype=np.float32)

    def frame(self, channels: Sequence[Any], numbers: Any) -> Any:
        """One frame of each world, an array of NumPy's or, but for images, a tensor of PyTorch's, as the parts are.

        Args:
            channels: Parts of the grid, each (world, channel, *grid), float32.
            numbers: (world, number), float32.
        """
        if self.kind == "flat":
            return joined([*(channel.reshape(len(channel), -1) for channel in channels), numbers], 1)
        shape = (*numbers.shape, *self.grid)
        filled = library(numbers).broadcast_to(numbers.reshape(*numbers.shape, *[1] * len(self.grid)), shape)
        grid = joined([*channels, filled], 1)
        if self.kind == "grid":
            return grid
        # A cell that is just full is white; a little more than full does not show.
        high = np.where(self._high == FRACTION_LIMIT, 1.0, self._high)[:, None, None]
        low = self._low[:, None, None]
        shades = (255.0 * ((grid - low) / (high - low)).clip(0.0, 1.0)).round().astype(np.uint8)
        pixels = shades[:, :, ::-1].repeat(self._zoom, axis=2).repeat(self._zoom, axis=3)
        return np.ascontiguousarray(pixels.transpose(0, 2, 3, 1))

    @property
    def axis(self) -> int:
        """The axis of a batch of frames along which they are stacked."""
        return -1 if self.kind == "image" else 1


def library(values: Any) -> Any:
    """NumPy or PyTorch: whose the values are."""
    if isinstance(values, np.ndarray):
        return np
    import torch

    return torch


def on_host(values: Any) -> np.ndarray:
    """A copy as an array of NumPy's."""
    return (values if isinstance(values, np.ndarray) else values.cpu().numpy()).copy()


def joined(parts: Sequence[Any], axis: int) -> Any:
    """Arrays or tensors one after another."""
    of = library(parts[0])
    return (np.concatenate if of is np else of.cat)(list(parts), axis)


def solid_fraction(solver: Solver, grid: Sequence[int]) -> np.ndarray:
    """Share of each coarse cell that is in a body or beyond a wall, (world, 1, *grid), float32.

    Exact for walls and boxes apart; of a ball it is counted on four points each way.
    """
    scene, dim = solver.scene, solver.scene.dim
    faces = solver.state.faces.position.numpy().astype(float).reshape(solver.num_worlds, dim, 2)
    counts = tuple(grid)[::-1]  # cells along x, y, z
    edges = [np.linspace(scene.lower[k], scene.upper[k], counts[k] + 1) for k in range(dim)]

    def inside(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Share of each cell between two corners (world, dim) each."""
        share = np.ones((solver.num_worlds, *[1] * dim))
        for k in range(dim):
            overlap = np.minimum(edges[k][1:], high[:, k, None]) - np.maximum(edges[k][:-1], low[:, k, None])
            along = overlap.clip(0.0) / (edges[k][1] - edges[k][0])
            share = share * along.reshape(-1, *[1] * (dim - 1 - k), counts[k], *[1] * k)
        return share

    solid = 1.0 - inside(faces[:, :, 0], faces[:, :, 1])
    if scene.bodies:
        middles = solver.state.bodies.position.numpy().astype(float)
        halves = solver.state.bodies.half.numpy().astype(float)
    for body, item in enumerate(scene.bodies.values()):
        middle, half = middles[:, body], halves[body]
        if isinstance(item.shape, Ball):
            fine = [np.linspace(edge[0], edge[-1], 8 * (len(edge) - 1) + 1)[1::2] for edge in edges]
            squares = np.zeros((solver.num_worlds, *[1] * dim))
            for k in range(dim):
                off = (fine[k] - middle[:, k, None]) ** 2
                squares = squares + off.reshape(-1, *[1] * (dim - 1 - k), len(fine[k]), *[1] * k)
            parts = (squares < half[0] ** 2).reshape(solver.num_worlds, *(n for count in grid for n in (count, 4)))
            solid = solid + parts.mean(axis=tuple(range(2, 2 * dim + 1, 2)))
        else:
            solid = solid + inside(middle - half, middle + half)
    solid[solid < 1e-6] = 0.0  # what places are rounded off by
    return solid.clip(0.0, 1.0).astype(np.float32)[:, None]
