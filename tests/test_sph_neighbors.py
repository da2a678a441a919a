"""Neighbour search against brute force, exactly: cells, ranges, order, and every pair once."""

import math

import numpy as np
import pytest
import warp as wp

from fluidgym.compilation import OPTIONS
from fluidgym.records import SUMS, fetch, make_records, pack
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


def visits(solver, position, search, half=False):
    """How often the pair loop of slot i counts slot j, or half a loop either the other: (i, j)."""
    dim, capacity, slots = solver.scene.dim, solver.capacity, WORLDS * solver.capacity
    width = 2 * dim + 1
    pair_loop, emit_terms = make_pair_loop(dim, (DensityRate(neighbour_field),), any_slope, False, width, half=half)
    vec = wp.types.vector(dim, wp.float32)

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def visit(
        capacity: int,
        search: float,
        constants: wp.array[Constants],
        records: wp.array[float],
        bounds: wp.array[int],
        grid: Grid,
        live: wp.array[int],
        given: wp.array[float],
        spans: wp.array[int],
        sums: wp.array[float],
    ):
        i = wp.tid()
        c = constants[0]
        if capacity < 0:
            sums[i] = emit_terms(c)
        world = i // capacity
        x = vec()
        for k in range(wp.static(dim)):
            x[k] = fetch(records, i + world * grid.slack, k, wp.static(width))
        a = fetch(records, i + world * grid.slack, wp.static(2 * dim), wp.static(width))
        sums[i] = 0.0
        if live[i] >= 0:
            found = pair_loop(
                i, x, vec(), a, 0.0, vec(), vec(1.0), world, search, records, bounds, grid, c, given, spans
            )  # fmt: skip
            sums[i] = found[0]

    identity = wp.array(solver.state.start.identity.numpy()[:slots], dtype=int, device="cpu")
    given = make_records(solver.state.places, SUMS, solver.device)
    sums, counted = wp.zeros(slots, dtype=float, device="cpu"), np.zeros((slots, slots))
    parts = np.zeros((width, slots), np.float32)
    parts[:dim] = position.T
    for j in range(slots):
        parts[-1] = np.arange(slots) == j
        records = pack(parts, solver.device, capacity)
        inputs = [capacity, search, solver._constants, records, solver._bounds, solver._grid, identity, given]
        wp.launch(visit, slots, [*inputs, solver.state.spans, sums], device="cpu")
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
        assert grid.width[axis] == pytest.approx(search / (8 if axis == 0 else 1))
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


@pytest.mark.parametrize("half", [False, True], ids=["whole", "half"])
def test_every_pair_within_the_support_is_counted_once(scattered, half):
    solver, position, identity, _ = scattered
    counted = visits(solver, position, solver._numbers["support"], half)
    assert_counts_neighbours(counted, solver, position, identity)


@pytest.mark.parametrize("half", [False, True], ids=["whole", "half"])
def test_no_pair_is_missed_after_a_drift_of_half_the_skin_each(scattered, half):
    solver, position, identity, _ = scattered
    skin, support, dim = solver._numbers["skin"], solver._numbers["support"], solver.scene.dim
    direction = np.random.default_rng(4).normal(size=position.shape)
    moved = position + 0.5 * skin * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    moved = np.clip(moved, *BOXES[dim]).astype(np.float32)
    counted = visits(solver, moved, support + skin, half)
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


@pytest.mark.parametrize("dim", [2, 3])
def test_what_is_not_a_number_does_not_outlive_a_reset(dim):
    # It may be handed to particles that have been met before, and lie in wait for whoever comes to their slots.
    solver = scatter(dim)
    solver.reset()
    solver.step(4)
    clean = solver.save()
    solver.reset()
    position = solver.state.now.position.numpy().copy()
    position[:, solver.capacity + np.arange(0, solver.capacity, 7)] = np.nan
    solver.state.now.position.assign(position)
    solver.step(2)
    spoiled = solver.particles(1).position
    assert np.isnan(spoiled).any()
    for world in (0, 2):
        assert np.isfinite(solver.particles(world).position).all()
    solver.reset()
    solver.step(4)
    for name, values in solver.save().items():
        np.testing.assert_array_equal(values, clean[name], err_msg=name)
