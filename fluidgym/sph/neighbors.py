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

CELLS_ALONG_X = 4  # cells to a search radius along x: narrower wastes scans, wider wastes candidates


@wp.struct
class Grid:
    """The cells of one world; every world has the same."""

    lower: wp.vec3  # corner [m]
    width: wp.vec3  # cell size [m]
    inv_width: wp.vec3  # [1/m]
    count: wp.vec3i  # cells along each axis
    stride: int  # cells of a world, the one for retired particles included


def three(values: Sequence[float] | np.ndarray, rest: float) -> list[float]:
    """Three components, those that two dimensions lack filled in."""
    return [*values, *[rest] * (3 - len(values))]


def make_grid(lower: np.ndarray, upper: np.ndarray, search: float) -> Grid:
    """The grid that covers a box (dim,) [m] for a search radius [m]."""
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
            index = int(wp.floor((x[k] - grid.lower[k]) * grid.inv_width[k]))
            cell += stride * wp.clamp(index, 0, grid.count[k] - 1)
            stride *= grid.count[k]
        return cell

    return cell_of


@wp.kernel(module="fluidgym.neighbors", enable_backward=False)
def order_by_cell(key: wp.array[int], bounds: wp.array[int], order: wp.array[int]):
    """Give every particle its slot; afterwards bounds[k] to bounds[k + 1] is the range of cell k."""
    i = wp.tid()
    order[wp.atomic_add(bounds, key[i] + 1, 1)] = i


@wp.kernel(module="fluidgym.neighbors", enable_backward=False)
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
def make_gather(dim: int, heat: bool = False, leaning: bool = False) -> wp.Kernel:
    """Kernel that copies the particles into their new order."""

    @wp.kernel(module="unique", enable_backward=False)
    def gather(
        order: wp.array[int],
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        density_error: wp.array[float],
        identity: wp.array[int],
        temperature: wp.array[float],
        acceleration: wp.array2d[float],
        position_out: wp.array2d[float],
        velocity_out: wp.array2d[float],
        density_error_out: wp.array[float],
        identity_out: wp.array[int],
        temperature_out: wp.array[float],
        acceleration_out: wp.array2d[float],
    ):
        i = wp.tid()
        j = order[i]
        for k in range(wp.static(dim)):
            position_out[k, i] = position[k, j]
            velocity_out[k, i] = velocity[k, j]
            if wp.static(leaning):
                acceleration_out[k, i] = acceleration[k, j]
        density_error_out[i] = density_error[j]
        identity_out[i] = identity[j]
        if wp.static(heat):
            temperature_out[i] = temperature[j]

    return gather
