"""What the speed benchmark measures: neighbours against brute force, rates that fit together, every table's rows."""

import numpy as np
import pytest

from fluidgym import speed
from fluidgym.benchmark import column_scene
from fluidgym.scheme import DEFAULT_SCHEME
from fluidgym.solver import Solver
from fluidgym.stepping import processors

ENVIRONMENTS = {"fluidgym/DamBreakContain2D-v0": {"task": "DamBreakContain", "dim": 2}}


def neighbours_by_brute_force(solver):
    """Mean number of neighbours, each particle's mirror images in the floor and at x = 0 among them."""
    support = solver.scheme.support(solver.scene.particle_spacing, solver.scene.dim)
    x = solver.particles().position
    images = [x]
    for axis, low in enumerate(solver.scene.lower):
        turned = [place.copy() for place in images]
        for place in turned:
            place[:, axis] = 2.0 * low - place[:, axis]
        images += turned
    others = np.concatenate(images)
    count = (np.linalg.norm(x[:, None] - others[None], axis=2) < support).sum()
    return count / len(x) - 1.0


def test_neighbours_are_counted_with_their_images():
    solver = Solver(column_scene(2, 200), device="cpu")
    before = solver.save()
    assert solver.particles().position[:, 1].max() < solver.scene.upper[1] - 1.0  # no other wall is near
    found = speed.count_neighbours(solver)
    # The sort drifts half a step first, which is next to nothing of the spacing.
    assert found == pytest.approx(neighbours_by_brute_force(solver), rel=0.01)
    assert 30 < found < 61
    for name, values in solver.save().items():
        np.testing.assert_array_equal(values, before[name], err_msg=name)


@pytest.mark.parametrize(("dim", "worlds", "threads"), [(2, 1, 1), (3, 3, 2)])
def test_a_speed_is_told_in_rates_that_fit_together(dim, worlds, threads):
    told = []
    row = speed.measure_speed(dim, 200, worlds, "cpu", threads=threads, stretch_s=0.01, progress=told.append)
    assert sum(told) == speed.STRETCHES + 1
    assert (row.dim, row.worlds, row.threads, row.device) == (dim, worlds, threads, "cpu")
    total, step = worlds * row.particles, 1e-3 * row.ms_per_step
    assert row.particle_steps_per_s == pytest.approx(total / step)
    assert row.pairs_per_s == pytest.approx(row.particle_steps_per_s * row.neighbours)
    assert row.ns_per_pair == pytest.approx(1e9 / row.pairs_per_s)
    assert row.wall_s_per_simulated_s == pytest.approx(step * row.steps_per_simulated_s)
    assert sum(row.shares.values()) == pytest.approx(1.0)
    assert list(row.shares) == ["sort", "density", "force"]
    assert row.launches == 5
    assert row.bytes_per_particle < 400
    assert row.spread >= 1.0
    assert len(row.HEAD.split("  ")) > 10 and f"{worlds} x {row.particles}" in row.line()


def test_an_environment_is_timed_beside_its_solver():
    ((name, options),) = ENVIRONMENTS.items()
    row = speed.measure_environment(name, {**options, "fidelity": "fast"}, 2, "cpu", 1, seconds=0.1)
    assert (row.id, row.worlds, row.fidelity, row.threads) == (name, 2, "fast", 1)
    assert row.env_steps_per_s > 0.0
    assert row.substeps >= 1
    assert 0.0 < row.overhead < 1.0
    assert name in row.line()


@pytest.mark.parametrize("dim", [2, 3])
def test_frames_are_timed(dim):
    row = speed.measure_frame(dim, 500, "cpu")
    assert row.dim == dim and row.particles > 300 and row.triangles > 100
    assert min(row.surface_s, row.spheres_s, row.mesh_s) > 0.0
    assert len(row.line()) >= len(row.HEAD) - 2


def test_all_tables_have_rows_and_heads():
    tables = speed.sections("cpu", ENVIRONMENTS, peer="pysph")
    titles = [table.title for table in tables]
    assert len(titles) == len(set(titles)) == 8
    several = 2 if processors() > 1 else 1
    expected = [
        2 * len(speed.SIZES),
        2 * several * len(speed.BATCHES),
        4,
        6,
        2 * (1 + several * (len(speed.ENV_BATCHES) - 1)),
        2 * len(speed.FRAMES),
        len(ENVIRONMENTS) + 2,
        8,
    ]
    assert [len(table.rows) for table in tables] == expected
    (only,) = speed.sections("cpu", ENVIRONMENTS, dims=(3,), sizes=(100, 200), threads=(1, 2))
    assert len(only.rows) == 4


def test_what_peers_have_for_a_support_is_what_we_are_given():
    scheme = speed.like_a_peer(2.6)
    assert scheme.support(0.1, 2) == pytest.approx(0.26)
    assert scheme.core_in(2) == 0.0
    assert scheme.density_diffusion == DEFAULT_SCHEME.density_diffusion


def test_memory_of_a_process_is_read():
    row = speed.measure_memory(2, 500)
    assert 450 < row.particles < 550
    assert 100 < row.bytes_per_particle < 400
    assert 50 < row.resident_mb < 2000
    assert f"{row.particles} particles" in row.line()


@pytest.mark.slow
def test_a_start_is_timed_with_an_empty_cache_and_with_a_full_one():
    row = speed.measure_start("fluidgym/DamBreakContain2D-v0", "cpu")
    assert 0.1 < row.warm_s < row.cold_s
