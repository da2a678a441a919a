"""The lid-driven cavity: its tables against another method, the fit, and a coarse run; longer ones are marked slow."""

import math

import numpy as np
import pytest

from fluidgym.scene import Particles
from fluidgym.solver import Solver
from fluidgym.validation import lid_cavity, run
from fluidgym.validation.lid_cavity import CASE, CASE_1000, HEIGHTS, PLACES, U, V

# -- reference -------------------------------------------------------------------------------------------------------


def finite_differences(reynolds: int, n: int, duration: float) -> np.ndarray:
    """u and v at the places of the tables, over U: vorticity and stream function on a grid of n x n squares.

    Central differences of second order; Poisson's equation by sine transforms; Thom's vorticity at the walls; Adams and
    Bashforth's second order in time.
    """
    h, order = 1.0 / n, np.arange(1, n)
    waves = math.sqrt(2.0 / n) * np.sin(np.pi / n * np.outer(order, order))
    value = (2.0 - 2.0 * np.cos(np.pi / n * order)) / h**2
    curl, stream = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    dt = min(0.08 * h * h * reynolds, 0.25 * h)
    before = u = v = np.zeros((n - 1, n - 1))
    for step in range(round(duration / dt)):
        stream[1:-1, 1:-1] = waves @ (waves @ curl[1:-1, 1:-1] @ waves / (value[:, None] + value)) @ waves
        curl[0], curl[-1], curl[:, 0] = -2.0 / h**2 * np.stack([stream[1], stream[-2], stream[:, 1]])
        curl[:, -1] = -2.0 / h**2 * stream[:, -2] - 2.0 / h
        u = (stream[1:-1, 2:] - stream[1:-1, :-2]) / (2.0 * h)
        v = (stream[:-2, 1:-1] - stream[2:, 1:-1]) / (2.0 * h)
        east, west, north, south = curl[2:, 1:-1], curl[:-2, 1:-1], curl[1:-1, 2:], curl[1:-1, :-2]
        rate = -(u * (east - west) + v * (north - south)) / (2.0 * h)
        rate += (east + west + north + south - 4.0 * curl[1:-1, 1:-1]) / (reynolds * h**2)
        curl[1:-1, 1:-1] += dt * (1.5 * rate - 0.5 * before if step else rate)
        before = rate
    middle = n // 2 - 1
    along = np.concatenate([[0.0], u[middle], [1.0]])
    across = np.concatenate([[0.0], v[:, middle], [0.0]])
    return np.concatenate([_cubic(along, HEIGHTS[reynolds]), _cubic(across, PLACES[reynolds])])


def _cubic(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values given at even distances over 0 to 1, interpolated by polynomials of third degree."""
    n = len(values) - 1
    first = np.clip((places * n).astype(int) - 1, 0, n - 3)
    found = np.zeros(len(places))
    for one in range(4):
        share = np.ones(len(places))
        for other in set(range(4)) - {one}:
            share *= (places * n - first - other) / (one - other)
        found += share * values[first + one]
    return found


@pytest.mark.parametrize(
    ("reynolds", "grids", "duration", "limit"),
    [(100, (24, 36), 15.0, 0.01), pytest.param(1000, (64, 96), 50.0, 0.015, marks=pytest.mark.slow)],
)
def test_the_tables_are_those_of_the_equations(reynolds, grids, duration, limit):
    coarse, fine = (finite_differences(reynolds, n, duration) for n in grids)
    share = grids[1] ** 2 / (grids[1] ** 2 - grids[0] ** 2)
    expected = fine * share + coarse * (1.0 - share)  # without the error of second order
    assert np.concatenate([U[reynolds], V[reynolds]]) == pytest.approx(expected, abs=limit)


@pytest.mark.parametrize(("case", "reynolds"), [(CASE, 100), (CASE_1000, 1000)])
def test_the_reference_itself_has_no_error(case, reynolds):
    scene, times = case.scene(10, 2), np.concatenate([[0.0], case.times])
    assert scene.material.viscosity == pytest.approx(1.0 / reynolds)
    profile = np.tile(np.concatenate([U[reynolds], V[reynolds]]), (len(times), 1))
    records = {"profile": profile.copy(), "void": np.zeros(len(times))}
    records["profile"][: 3 * len(times) // 4] = 7.0  # the last quarter counts
    nothing = dict.fromkeys(("largest", "rms", "restless", "void"), 0.0)
    assert case.errors(times, records, scene) == pytest.approx(nothing, abs=1e-12)
    # One place off for all of the time averaged, and all places for half of it.
    places, last = profile.shape[1], len(times) // 4
    records["profile"][-last:, 2] -= 0.1
    errors = case.errors(times, records, scene)
    assert errors == pytest.approx(nothing | {"largest": 0.1, "rms": 0.1 / math.sqrt(places)})
    records["profile"][-last:] = profile[-last:]
    records["profile"][-last // 2 :] += 0.02
    records["void"][-last // 2 :] = 0.01
    errors = case.errors(times, records, scene)
    assert errors == pytest.approx({"largest": 0.01, "rms": 0.01, "restless": 0.02, "void": 0.005})
    records["profile"][-1, 0] = np.nan
    assert math.isnan(case.errors(times, records, scene)["largest"])


# -- measuring -------------------------------------------------------------------------------------------------------


def scattered(velocity) -> Particles:
    """Particles of a 20 x 20 lattice, each up to a quarter of a spacing off, with a velocity of the place."""
    axis = (np.arange(20) + 0.5) / 20
    position = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    position += np.random.default_rng(1).uniform(-0.0125, 0.0125, position.shape)
    n = len(position)
    return Particles(position, velocity(*position.T), np.full(n, 1000.0), np.zeros(n), np.arange(n))


def test_the_velocity_is_exact_where_it_is_a_polynomial():
    def bowl(x, y):
        return np.stack([1.0 + 2.0 * x - y + 3.0 * x * x - 4.0 * x * y + 5.0 * y * y, y * y - x], axis=-1)

    places = np.array([[0.5, 0.5], [0.5, 1.0], [0.0, 0.0], [0.97, 0.5]])
    assert lid_cavity.velocity_at(scattered(bowl), places, 0.15) == pytest.approx(bowl(*places.T), abs=1e-10)


def test_the_velocity_of_a_flow_is_found_within_a_spacing_of_a_wall():
    def swirl(x, y):
        return np.stack([np.sin(3.0 * x) * np.cos(3.0 * y), -np.cos(3.0 * x) * np.sin(3.0 * y)], axis=-1)

    places = lid_cavity.profile_places(100)
    assert len(places) == 21
    found = lid_cavity.velocity_at(scattered(swirl), places, 0.15)
    assert found == pytest.approx(swirl(*places.T), abs=0.005)


def test_there_is_no_velocity_where_there_is_no_fluid():
    flow = scattered(lambda x, y: np.stack([x, y], axis=-1))
    few = flow.chosen(slice(5))
    assert np.isnan(lid_cavity.velocity_at(few, np.array([[0.1, 0.0], [0.5, 0.5]]), 0.3)).all()
    flow.velocity[:] = np.nan  # a run that broke down
    assert np.isnan(lid_cavity.velocity_at(flow, np.array([[0.5, 0.5]]), 0.3)).all()


def test_a_hole_in_the_fluid_is_seen():
    flow = scattered(lambda x, y: np.stack([x, y], axis=-1))
    assert lid_cavity.empty_squares(flow.position, 0.05) == 0.0
    outside = (np.abs(flow.position - 0.5) > 0.1).any(axis=1)
    assert lid_cavity.empty_squares(flow.position[outside], 0.05) == pytest.approx(4 / 100)


# -- runs ------------------------------------------------------------------------------------------------------------


def test_the_cavity_starts_full_and_at_rest():
    solver = Solver(CASE.scene(10, 2), device="cpu")
    found = lid_cavity.observe(solver, 100)
    assert not found["profile"].any()
    assert found["void"] == 0.0
    assert len(solver.particles()) == 100


def test_a_coarse_cavity_is_stirred_as_the_table_says():
    result = run(CASE, 20, device="cpu")
    assert result.particles == 400
    assert result.errors["largest"] < 0.06
    assert result.errors["rms"] < 0.02
    assert result.errors["restless"] < 0.01
    assert result.errors["void"] < 0.002
    assert result.passed is None  # the target is set from L/25 on


@pytest.mark.slow
def test_the_cavity_meets_its_goal_at_fifty():
    result = run(CASE, 50, device="cpu")
    assert result.passed, result.errors
    assert all(result.keeps(name, result.goal) for name in result.goal), result.errors


@pytest.mark.slow
def test_the_cavity_at_a_thousand_turns_faster():
    result = run(CASE_1000, 50, device="cpu")
    assert result.passed, result.errors
