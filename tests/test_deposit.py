"""The coarse grid and the sums of the fluid, against what NumPy makes of the same particles."""

import numpy as np
import pytest

from fluidgym.scene import Box, Fluid, Scene
from fluidgym.solver import Solver
from fluidgym.sph.deposit import Deposit
from fluidgym.sph.measure import Measure

UPPER = {2: (2.0, 1.5), 3: (2.0, 1.0, 1.5)}
GRID = {2: (6, 8), 3: (6, 4, 8)}
SPACING = 0.1
SPEED = 4.0


def put(array, values):
    """Write values (..., slot) into a device array that may have room for more behind."""
    whole = array.numpy().copy()
    whole[..., : values.shape[-1]] = values
    array.assign(whole)


def scatter(dim, num_worlds=1, seed=0, lost=0):
    """A solver whose particles are anywhere in the box and move anyhow; the first ones of each world are retired."""
    solver = Solver(
        Scene((0.0,) * dim, UPPER[dim], SPACING, [Fluid(Box((0.0,) * dim, (0.8,) * dim))]),
        num_worlds=num_worlds,
        device="cpu",
    )
    rng, now, slots = np.random.default_rng(seed), solver.state.now, num_worlds * solver.capacity
    position = rng.uniform(0.0, 1.0, (slots, dim)) * UPPER[dim]
    velocity = rng.normal(0.0, 2.0, (slots, dim))
    identity = np.tile(np.arange(solver.capacity), num_worlds)
    identity[identity < lost] = -1 - identity[identity < lost]
    put(now.position, position.T)
    put(now.velocity, velocity.T)
    put(now.identity, identity)
    put(now.density_error, rng.normal(0.0, 0.01, slots))
    shape = (num_worlds, solver.capacity)
    return solver, position.reshape(*shape, dim), velocity.reshape(*shape, dim), identity.reshape(shape) >= 0


def deposit_of(solver, grid=None, **limits):
    dim, now = solver.scene.dim, solver.state.now
    made = Deposit(
        (0.0,) * dim, UPPER[dim], grid or GRID[dim], SPACING, SPEED, solver.num_worlds, solver.capacity, solver.device,
        **limits,
    )  # fmt: skip
    return made.run(now.position, now.velocity, now.identity).astype(float)


def cell_volume(dim, grid=None):
    return np.prod(UPPER[dim]) / np.prod(grid or GRID[dim])


@pytest.mark.parametrize("dim", [2, 3])
def test_the_cells_hold_the_whole_fluid(dim):
    solver, _, _, live = scatter(dim, num_worlds=3, lost=4)
    held = deposit_of(solver)[:, 0].reshape(3, -1).sum(axis=1) * cell_volume(dim)
    assert held == pytest.approx(live.sum(axis=1) * SPACING**dim, rel=1e-6)


def test_not_even_rounding_loses_mass():
    solver, _, _, live = scatter(3, num_worlds=2, lost=4)
    now = solver.state.now
    made = Deposit((0.0,) * 3, UPPER[3], GRID[3], SPACING, SPEED, 2, solver.capacity, solver.device)
    made.run(now.position, now.velocity, now.identity)
    assert (made._sums.numpy()[:, 0].sum(axis=1) == live.sum(axis=1) << 24).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_the_cells_hold_the_whole_momentum(dim):
    solver, _, velocity, live = scatter(dim, num_worlds=2, lost=4)
    held = deposit_of(solver)[:, 1:].reshape(2, dim, -1).sum(axis=2) * cell_volume(dim) * SPEED
    expected = (velocity * live[..., None]).sum(axis=1) * SPACING**dim
    assert held == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_each_cell_gets_what_it_overlaps(dim):
    solver, position, _, live = scatter(dim)
    width = np.asarray(UPPER[dim]) / GRID[dim][::-1]
    expected = np.zeros(GRID[dim])
    for x in position[0][live[0]]:
        share = np.ones(1)
        for axis in reversed(range(dim)):  # the last axis of space is the first of the grid
            edges = np.arange(GRID[dim][::-1][axis] + 1) * width[axis]
            edges[[0, -1]] = -np.inf, np.inf  # border cells take what sticks out
            low, high = x[axis] - SPACING / 2, x[axis] + SPACING / 2
            overlap = np.maximum(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0.0) / SPACING
            share = np.multiply.outer(share, overlap)
        expected += share.reshape(GRID[dim])
    expected *= SPACING**dim / np.prod(width)
    assert deposit_of(solver)[0, 0] == pytest.approx(expected, abs=1e-5)


def test_a_full_box_is_full_everywhere():
    scene = Scene((0.0, 0.0), UPPER[2], SPACING, [Fluid(Box((0.0, 0.0), UPPER[2]), velocity=(2.0, -1.0))])
    fraction, along_x, along_y = deposit_of(Solver(scene, device="cpu"))[0]
    assert fraction == pytest.approx(1.0, abs=1e-5)
    assert along_x == pytest.approx(2.0 / SPEED, abs=1e-5)
    assert along_y == pytest.approx(-1.0 / SPEED, abs=1e-5)


def test_cells_as_small_as_particles_will_do_and_smaller_ones_will_not():
    solver, *_ = scatter(2)
    held = deposit_of(solver, grid=(15, 20))[0, 0].sum() * cell_volume(2, (15, 20))
    assert held == pytest.approx(solver.capacity * SPACING**2, rel=1e-6)
    with pytest.raises(ValueError, match=r"finer than the particle spacing 0.1 m; use at most \(15, 20\)"):
        deposit_of(solver, grid=(16, 20))


def test_order_of_the_particles_leaves_no_trace():
    solver, position, velocity, _ = scatter(2)
    before = deposit_of(solver)
    put(solver.state.now.position, position[0, ::-1].T)
    put(solver.state.now.velocity, velocity[0, ::-1].T)
    assert (deposit_of(solver) == before).all()


def test_particles_that_are_not_numbers_are_passed_over():
    solver, position, velocity, _ = scatter(2)
    position[0, 3, 0], velocity[0, 7, 1] = np.nan, np.inf
    put(solver.state.now.position, position[0].T)
    put(solver.state.now.velocity, velocity[0].T)
    cells = deposit_of(solver)
    assert np.isfinite(cells).all()
    assert cells[0, 0].sum() * cell_volume(2) == pytest.approx((solver.capacity - 2) * SPACING**2, rel=1e-6)


def test_values_are_clipped_to_the_limits():
    solver, *_ = scatter(2)
    free, cut = deposit_of(solver), deposit_of(solver, fraction_limit=0.2, momentum_limit=0.05)
    assert free[0, 0].max() > 0.2
    assert cut[0, 0] == pytest.approx(np.clip(free[0, 0], 0.0, 0.2), abs=1e-7)
    assert cut[0, 1:] == pytest.approx(np.clip(free[0, 1:], -0.05, 0.05), abs=1e-7)


# -- the sums ----------------------------------------------------------------------------------------------------


def measure_of(solver, zone, height):
    dim, now = solver.scene.dim, solver.state.now
    made = Measure((0.0,) * dim, UPPER[dim], zone, height, SPACING, solver.num_worlds, solver.capacity, solver.device)
    return made.run(now.position, now.velocity, now.density_error, now.identity)


@pytest.mark.parametrize("dim", [2, 3])
def test_sums_are_those_of_the_particles(dim):
    solver, position, _, live = scatter(dim, num_worlds=2, lost=3)
    found = measure_of(solver, ((0.0,) * dim, UPPER[dim]), 0.75)
    assert found["live"].tolist() == live.sum(axis=1).tolist()
    assert found["broken"].tolist() == [0, 0]
    s = solver.state.now.density_error.numpy()[: live.size].reshape(live.shape)
    for world in range(2):
        x = position[world][live[world]]
        assert found["spread"][world] == pytest.approx(x[:, 0].std(), abs=1e-5)
        assert found["compression"][world] == s[world][live[world]].max()
        assert found["void"][world] == -s[world][live[world]].min()
        above = np.clip((x[:, -1] - 0.75) / SPACING + 0.5, 0.0, 1.0).mean()
        assert found["above"][world] == pytest.approx(above, abs=1e-5)
        assert found["in_zone"][world] == pytest.approx(1.0, abs=1e-6)  # a zone has no edge where the box ends


def test_share_in_a_zone_is_the_overlap_of_the_particles():
    solver, position, *_ = scatter(2)
    found = measure_of(solver, ((0.0, 0.3), (1.3, 1.1)), 0.75)["in_zone"][0]
    x, y = position[0].T
    inside = np.clip((1.3 - x) / SPACING + 0.5, 0, 1)
    inside = inside * np.clip((y - 0.3) / SPACING + 0.5, 0, 1) * np.clip((1.1 - y) / SPACING + 0.5, 0, 1)
    assert 0.1 < found < 0.9
    assert found == pytest.approx(inside.mean(), abs=1e-5)


def test_particles_that_are_not_numbers_are_counted_and_spoil_nothing():
    solver, position, velocity, _ = scatter(2, num_worlds=2)
    velocity[1, 5, 0] = np.nan
    put(solver.state.now.velocity, velocity.reshape(-1, 2).T)
    found = measure_of(solver, ((0.0, 0.0), (1.0, 0.6)), 0.75)
    assert found["broken"].tolist() == [0, 1]
    assert found["live"].tolist() == [solver.capacity] * 2
    rest = np.delete(position[1], 5, axis=0)
    assert found["spread"][1] == pytest.approx(rest[:, 0].std(), abs=1e-5)
    assert all(np.isfinite(values).all() for values in found.values())
