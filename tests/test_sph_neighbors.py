"""Neighbour search against brute force, exactly: cells, ranges, order, and every pair once."""

import math

import numpy as np
import pytest
import warp as wp

from fluidgym.scene import OPEN, Box, Fluid, Particles, Scene
from fluidgym.solver import Solver
from fluidgym.sph.constants import Constants
from fluidgym.sph.neighbors import Grid, order_by_cell, settle_order
from fluidgym.sph.pair_loop import make_pair_loop
from fluidgym.sph.terms import DensityRate

DX = 0.1
BOXES = {2: ((-0.4, 0.3), (1.0, 1.37)), 3: ((-0.4, 0.3, 0.0), (0.35, 0.9, 0.8))}
WORLDS = 3


@wp.func
def neighbour_field(r: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
    return wp.where(slope < 0.0, a_j, 0.0)


@wp.func
def any_slope(r: float, c: Constants) -> float:
    return wp.where(r < c.support, -1.0, 0.0)


def scatter(dim):
    """A solver of three worlds of random particles, some on corners and faces; the last world is not full."""
    lower, upper = BOXES[dim]
    scene = Scene(lower, upper, DX, Fluid(Box(lower, upper)), faces={"x_max": OPEN}, reference_speed=1.0)
    solver = Solver(scene, num_worlds=WORLDS, device="cpu")
    random = np.random.default_rng(3)
    starts = []
    for world in range(WORLDS):
        n = solver.capacity - (40 if world == WORLDS - 1 else 0)
        position = random.uniform(lower, upper, (n, dim))
        corners = np.stack(np.meshgrid(*zip(lower, upper, strict=True)), axis=-1).reshape(-1, dim)
        position[: len(corners)] = corners
        face = len(corners) + np.arange(2 * dim)
        position[face, np.arange(2 * dim) // 2] = np.stack([lower, upper], axis=1).ravel()
        starts.append(Particles(position, np.zeros_like(position), np.zeros(n), np.zeros(n), np.arange(n)))
    solver.set_start(range(WORLDS), starts)
    return solver


@pytest.fixture(scope="module", params=[2, 3], ids=["2D", "3D"])
def scattered(request):
    """The solver, and its particles in the order of the cells: places (slot, dim), identities and bounds."""
    solver = scatter(request.param)
    slots = WORLDS * solver.capacity
    start = solver.state.start
    return solver, start.position.numpy()[:, :slots].T, start.identity.numpy()[:slots], solver._bounds.numpy()


def cells_of(solver, position, identity):
    """The cell of each particle by the definition in neighbors.py, counted over all worlds."""
    grid, dim = solver._grid, solver.scene.dim
    lower, inv_width, count = (np.array(list(values)[:dim]) for values in (grid.lower, grid.inv_width, grid.count))
    index = np.floor((position - lower.astype(np.float32)) * inv_width.astype(np.float32)).astype(int)
    index = np.clip(index, 0, count - 1)
    cell = index @ np.concatenate([[1], np.cumprod(count)[:-1]])
    world = np.arange(len(position)) // solver.capacity
    return world * grid.stride + np.where(identity < 0, grid.stride - 1, cell)


def visits(solver, position, search):
    """How often the pair loop of slot i counts slot j: (i, j)."""
    dim, slots = solver.scene.dim, WORLDS * solver.capacity
    pair_loop, emit_terms = make_pair_loop(dim, (DensityRate(neighbour_field),), any_slope, force=False)
    vec = wp.types.vector(dim, wp.float32)

    @wp.kernel(module="unique", enable_backward=False)
    def visit(
        capacity: int,
        stride: int,
        search: float,
        constants: wp.array[Constants],
        position: wp.array2d[float],
        field: wp.array[float],
        bounds: wp.array[int],
        grid: Grid,
        sums: wp.array[float],
    ):
        i = wp.tid()
        c = constants[0]
        if capacity < 0:
            sums[i] = emit_terms(c)
        x = vec()
        for k in range(wp.static(dim)):
            x[k] = position[k, i]
        found = pair_loop(
            x, vec(), 0.0, 0.0, vec(), vec(1.0), i // capacity * stride, search, position, position, field, position,
            bounds, grid, c,
        )  # fmt: skip
        sums[i] = found[0]

    padded = solver.state.start.position.shape[1]
    place = np.zeros((dim, padded), np.float32)
    place[:, :slots] = position.T
    place, field = wp.array(place, device="cpu"), wp.zeros(padded, dtype=float, device="cpu")
    sums, counted = wp.zeros(slots, dtype=float, device="cpu"), np.zeros((slots, slots))
    for j in range(slots):
        field.fill_(0.0)
        field[j : j + 1].fill_(1.0)
        inputs = [solver.capacity, solver._grid.stride, search, solver._constants, place, field, solver._bounds]
        wp.launch(visit, slots, [*inputs, solver._grid, sums], device="cpu")
        counted[:, j] = sums.numpy()
    return counted


def assert_counts_neighbours(counted, solver, position, identity):
    """Every particle counts those within its support once and nobody else, by brute force.

    A pair so close to the edge of the support that float32 cannot tell is left out; there are next to none.
    """
    support = solver.scheme.support(DX, solver.scene.dim)
    distance = np.linalg.norm(position[:, None].astype(float) - position[None], axis=2)
    world, live = np.arange(len(position)) // solver.capacity, identity >= 0
    near = (world[:, None] == world) & live & (distance < support)
    clear = live[:, None] & (np.abs(distance - support) > 1e-6)
    assert clear.sum() > 0.9999 * live.sum() * len(live)
    assert near.sum() > 10 * len(live)
    np.testing.assert_array_equal(counted[clear], near[clear])


def test_grid_covers_the_box_in_rows_that_reach_the_search(scattered):
    solver = scattered[0]
    grid, scene = solver._grid, solver.scene
    search = solver._numbers["support"] + solver._numbers["skin"]
    for axis in range(scene.dim):
        length = scene.upper[axis] - scene.lower[axis]
        assert grid.count[axis] * grid.width[axis] >= length - 1e-6
        assert grid.inv_width[axis] == pytest.approx(1.0 / grid.width[axis])
        assert grid.width[axis] == pytest.approx(search / (4 if axis == 0 else 1))
    assert grid.stride == math.prod(list(grid.count)[: scene.dim]) + 1


def test_ranges_are_those_of_the_cells(scattered):
    solver, position, identity, bounds = scattered
    expected = np.bincount(cells_of(solver, position, identity), minlength=WORLDS * solver._grid.stride)
    np.testing.assert_array_equal(np.diff(bounds)[: WORLDS * solver._grid.stride], expected)
    assert bounds[0] == 0


def test_particles_lie_in_the_order_of_their_cells_and_keep_theirs_within_one(scattered):
    solver, position, identity, _ = scattered
    cell = cells_of(solver, position, identity)
    assert (np.diff(cell) >= 0).all()
    for world in range(WORLDS):
        slots = slice(world * solver.capacity, (world + 1) * solver.capacity)
        rank = np.where(identity[slots] < 0, -1 - identity[slots], identity[slots])  # the order they came in
        np.testing.assert_array_equal(np.sort(rank), np.arange(solver.capacity))
        same = np.diff(cell[slots]) == 0
        assert same.any()
        assert (np.diff(rank)[same] > 0).all()


def test_every_pair_within_the_support_is_counted_once(scattered):
    solver, position, identity, _ = scattered
    counted = visits(solver, position, solver._numbers["support"])
    assert_counts_neighbours(counted, solver, position, identity)


def test_no_pair_is_missed_after_a_drift_of_half_the_skin_each(scattered):
    solver, position, identity, _ = scattered
    skin, support, dim = solver._numbers["skin"], solver._numbers["support"], solver.scene.dim
    direction = np.random.default_rng(4).normal(size=position.shape)
    moved = position + 0.5 * skin * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    moved = np.clip(moved, *BOXES[dim]).astype(np.float32)
    counted = visits(solver, moved, support + skin)
    assert_counts_neighbours(counted, solver, moved, identity)


def sort_by_key(key, cells):
    """Bounds of the cells and the order of the particles, as a step makes them from the keys."""
    bounds = wp.array(np.bincount(key + 2, minlength=cells + 2), dtype=int, device="cpu")
    wp.utils.array_scan(bounds, bounds, inclusive=True)
    order = wp.zeros(len(key), dtype=int, device="cpu")
    wp.launch(order_by_cell, len(key), [wp.array(key, dtype=int, device="cpu"), bounds, order], device="cpu")
    return bounds, order


def test_order_is_a_stable_sort_by_cell():
    key = np.random.default_rng(1).integers(0, 50, 1000)
    bounds, order = sort_by_key(key, 50)
    np.testing.assert_array_equal(order.numpy(), np.argsort(key, kind="stable"))
    np.testing.assert_array_equal(bounds.numpy()[:51], np.searchsorted(np.sort(key), np.arange(51)))


def test_order_scrambled_by_racing_threads_is_settled():
    random = np.random.default_rng(2)
    key = random.integers(0, 50, 1000)
    key[key == 17] = 16  # an empty cell
    bounds, order = sort_by_key(key, 50)
    settled = order.numpy()
    scrambled = settled[np.lexsort([random.random(1000), key[settled]])]
    assert (scrambled != settled).any()
    np.testing.assert_array_equal(key[scrambled], key[settled])
    order.assign(scrambled)
    wp.launch(settle_order, 50, [51, bounds, order], device="cpu")
    np.testing.assert_array_equal(order.numpy(), settled)
