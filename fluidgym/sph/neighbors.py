"""Who is near: a grid of cells, and the particles re-ordered by cell.

Cells are as wide as the search along y and z and an eighth of that along x. The cells of one row along x are one
contiguous range of particles, so a neighbourhood is at most three rows (nine in 3D), each cut to the x it needs.
Particle ranges of cell k, counted over all worlds, are bounds[k] to bounds[k + 1]. The last cell of each world holds
the retired particles; nobody looks there.

Where pairs are met once, a particle meets what comes after it in the order: the rest of its own row, and the rows after
that. These spans are found once a step, for all of its sweeps.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import warp as wp

from fluidgym.compilation import OPTIONS, shared_module
from fluidgym.records import get, put, slack
from fluidgym.sph.structure import Structure

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


def rows_after(dim: int) -> list[tuple[int, int]]:
    """Rows that half of a neighbourhood is in, by their (y, z) from the particle's own, which is the first."""
    return [(0, 0), (1, 0)] if dim == 2 else [(0, 0), (1, 0), (-1, 1), (0, 1), (1, 1)]


def span_numbers(dim: int) -> int:
    """Numbers that are kept of a particle: first and end of each span, then y and z of its own row."""
    return 2 * len(rows_after(dim)) + 2


def _find_lines(dim: int) -> str:
    """Native lines that find the spans of a particle, its own row first; they count the slack of worlds before it."""
    lines = ["const int shift = world * grid.slack, first_cell = world * grid.stride, nx = grid.count[0];"]
    lines.append("const float reach = grid.width[1];")
    for k, name in ((1, "y"), (2, "z")):
        cell = f"wp::clamp((int)((X[{k}] - grid.lower[{k}]) * grid.inv_width[{k}]), 0, grid.count[{k}] - 1)"
        lines.append(f"const int {name} = {cell if k < dim else 0};")
        if k < dim:  # how far the rows before and after the particle's own are
            lines.append(f"const float past_{name} = X[{k}] - grid.lower[{k}] - {name} * grid.width[{k}];")
            lines.append(f"const float gap_{name}[3] = {{wp::max(past_{name}, 0.0f), 0.0f,")
            lines.append(f"wp::max(grid.width[{k}] - past_{name}, 0.0f)}};")
    # What is nowhere, not being a number, has nobody to spoil.
    lines.append(f"const bool somewhere = fabsf({' + '.join(f'X[{k}]' for k in range(dim))}) < 1e30f;")
    rows = rows_after(dim)
    lines.append(f"int* __restrict__ span = spans.data + i * {span_numbers(dim)};")
    lines.append(f"span[{2 * len(rows)}] = y; span[{2 * len(rows) + 1}] = z;")
    for n, (y, z) in enumerate(rows):
        steps = [(k, name, step) for k, name, step in ((1, "y", y), (2, "z", z)) if step]
        exists = [f"({name} + 1 < grid.count[{k}])" if step > 0 else f"({name} > 0)" for k, name, step in steps]
        squares = "".join(f" - gap_{name}[{1 + step}] * gap_{name}[{1 + step}]" for _, name, step in steps)
        lines.append(f"{{\nconst float rest = reach * reach{squares}, chord = sqrtf(wp::max(rest, 0.0f));")
        for side, sign in (("low", "-"), ("high", "+")):
            cell = f"(int)((X[0] {sign} chord - grid.lower[0]) * grid.inv_width[0])"
            lines.append(f"const int {side} = wp::clamp({cell}, 0, nx - 1);")
        lines.append(f"const bool there = {' & '.join(['somewhere', '(rest > 0.0f)', *exists])};")
        lines.append(f"const int row = first_cell + (there ? ((z + {z}) * grid.count[1] + y + {y}) * nx : 0);")
        lines.append(f"const int first = {'i' if n == 0 else 'bounds.data[row + low]'} + shift;")
        lines.append(f"span[{2 * n}] = first; span[{2 * n + 1}] = there ? bounds.data[row + high + 1] + shift : first;")
        lines.append("}")
    return "\n".join(lines)


@lru_cache
def make_find_spans(dim: int) -> wp.Function:
    """Warp function (i, X, world, bounds, grid, spans) that notes where half a loop finds neighbours.

    Of the particle in slot i at X: in each row of `rows_after` from which record to which.
    """
    vec = wp.types.vector(dim, wp.float32)

    @wp.func_native(_find_lines(dim))
    def find_spans(
        i: int,
        X: vec,
        world: int,
        bounds: wp.array[int],
        grid: Grid,
        spans: wp.array[int],
    ): ...

    return find_spans


@lru_cache
def make_gather(s: Structure) -> wp.Kernel:
    """Kernel that puts the particles into their new order: records of so many parts, and what is not in them.

    And, if pairs are to be met once, the spans.
    """
    dim, width = s.dim, s.middle_width
    find_spans = make_find_spans(dim)
    vec = wp.types.vector(dim, wp.float32)

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def gather(
        capacity: int,
        grid: Grid,
        bounds: wp.array[int],
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
        spans: wp.array[int],
    ):
        i = wp.tid()
        j = order[i]
        world = i // capacity
        slot = i + world * grid.slack
        if wp.static(s.half):
            x = vec()
            for k in range(wp.static(dim)):
                x[k] = get(position, k, j)
            find_spans(i, x, world, bounds, grid, spans)
        for k in range(wp.static(dim)):
            put(records, slot, k, wp.static(width), get(position, k, j))
            put(records, slot, wp.static(dim) + k, wp.static(width), get(velocity, k, j))
            if wp.static(s.leaning):
                put(records, slot, wp.static(2 * dim + 1) + k, wp.static(width), get(acceleration, k, j))
        put(records, slot, wp.static(2 * dim), wp.static(width), density_error[j])
        density_error_out[i] = density_error[j]
        identity_out[i] = identity[j]
        if wp.static(s.heat):
            temperature_out[i] = temperature[j]

    return gather
