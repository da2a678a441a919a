"""Who is near: a grid of cells, and the particles re-ordered by cell.

Cells are as wide as the search along y and z and a quarter of that along x. The cells of one row along x are one
contiguous range of particles, so a neighbourhood is at most three rows (nine in 3D), each cut to the x it needs.
Particle ranges of cell k, counted over all worlds, are bounds[k] to bounds[k + 1]. The last cell of each world holds
the retired particles; nobody looks there.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import warp as wp

from fluidgym.compilation import OPTIONS, shared_module
from fluidgym.records import put, slack

CELLS_ALONG_X = 8  # cells to a search radius along x: narrower wastes scans, wider wastes candidates


@wp.struct
class Grid:
    """The cells of one world; every world has the same."""

    lower: wp.vec3  # corner [m]
    width: wp.vec3  # cell size [m]
    inv_width: wp.vec3  # [1/m]
    count: wp.vec3i  # cells along each axis
    stride: int  # cells of a world, the one for retired particles included
    slack: int  # records of a world beyond its slots


def three(values: Sequence[float] | np.ndarray, rest: float) -> list[float]:
    """Three components, those that two dimensions lack filled in."""
    return [*values, *[rest] * (3 - len(values))]


def make_grid(lower: np.ndarray, upper: np.ndarray, search: float, capacity: int = 0) -> Grid:
    """The grid that covers a box (dim,) [m] for a search radius [m], in worlds of that many slots."""
    dim = len(lower)
    width, count = np.ones(3), np.ones(3, int)
    for axis in range(dim):
        extent = float(upper[axis] - lower[axis])
        size = search / CELLS_ALONG_X if axis == 0 else search
        count[axis] = max(1, math.ceil(extent / size - 1e-9))
        width[axis] = size
    grid = Grid()
    grid.lower = wp.vec3(*three(lower, 0.0))
    grid.width = wp.vec3(*width)
    grid.inv_width = wp.vec3(*(1.0 / width))
    grid.count = wp.vec3i(*(int(n) for n in count))
    grid.stride = int(np.prod(count)) + 1
    grid.slack = slack(capacity)
    return grid


@lru_cache
def make_cell_of(dim: int) -> wp.Function:
    """Warp function (x, grid) -> cell of a place within its world; places outside go to the nearest cell."""
    vec = wp.types.vector(dim, wp.float32)

    @wp.func
    def cell_of(x: vec, grid: Grid) -> int:
        cell = int(0)
        stride = int(1)
        for k in range(wp.static(dim)):
            index = int((x[k] - grid.lower[k]) * grid.inv_width[k])  # what is below 0 is at 0
            cell += stride * wp.clamp(index, 0, grid.count[k] - 1)
            stride *= grid.count[k]
        return cell

    return cell_of


@wp.kernel(module=shared_module("neighbors"), enable_backward=False)
def order_by_cell(key: wp.array[int], bounds: wp.array[int], order: wp.array[int]):
    """Give every particle its slot; afterwards bounds[k] to bounds[k + 1] is the range of cell k."""
    i = wp.tid()
    order[wp.atomic_add(bounds, key[i] + 1, 1)] = i


@wp.kernel(module=shared_module("neighbors"), enable_backward=False)
def settle_order(stride: int, bounds: wp.array[int], order: wp.array[int]):
    """Sort the particles of each cell by their earlier place: threads that race leave no trace.

    The order of the retired ones shows nowhere.
    """
    k = wp.tid()
    if (k + 1) % stride == 0:
        return
    first = bounds[k]
    for a in range(first + 1, bounds[k + 1]):
        moved = order[a]
        b = int(a)
        while b > first:
            if order[b - 1] < moved:
                break
            order[b] = order[b - 1]
            b -= 1
        order[b] = moved


@lru_cache
def make_gather(dim: int, width: int, heat: bool = False) -> wp.Kernel:
    """Kernel that puts the particles into their new order: records of so many parts, and what is not in them."""
    leaning = width > 2 * dim + 1

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def gather(
        capacity: int,
        grid: Grid,
        order: wp.array[int],
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        density_error: wp.array[float],
        identity: wp.array[int],
        temperature: wp.array[float],
        acceleration: wp.array2d[float],
        records: wp.array[float],
        density_error_out: wp.array[float],
        identity_out: wp.array[int],
        temperature_out: wp.array[float],
    ):
        i = wp.tid()
        j = order[i]
        slot = i + i // capacity * grid.slack
        for k in range(wp.static(dim)):
            put(records, slot, k, wp.static(width), position[k, j])
            put(records, slot, wp.static(dim) + k, wp.static(width), velocity[k, j])
            if wp.static(leaning):
                put(records, slot, wp.static(2 * dim + 1) + k, wp.static(width), acceleration[k, j])
        put(records, slot, wp.static(2 * dim), wp.static(width), density_error[j])
        density_error_out[i] = density_error[j]
        identity_out[i] = identity[j]
        if wp.static(heat):
            temperature_out[i] = temperature[j]

    return gather
