"""The start of a shear flow: its reference, and short runs; the finer ones are marked slow."""

import numpy as np
import pytest

from fluidgym.validation import CASES, observed_order, run
from fluidgym.validation.shear_start_up import CASE, COUETTE, POISEUILLE, TIME_UNIT, TIMES, couette, poiseuille


def test_the_series_are_those_of_the_literature():
    middle = [float(poiseuille(np.array([0.5]), time)[0]) for time in TIMES]
    assert middle == pytest.approx([0.15923, 0.37039, 0.61535, 0.85664, 0.99258], abs=6e-6)
    upper = [float(couette(np.array([0.75]), time)[0]) for time in TIMES]
    assert upper == pytest.approx([0.21130, 0.42920, 0.57606, 0.68735, 0.74676], abs=6e-6)


@pytest.mark.parametrize(("flow", "force"), [(poiseuille, 8.0), (couette, 0.0)])
def test_the_series_solve_the_equation_of_diffusion(flow, force):
    y, time, step = np.linspace(0.05, 0.95, 10), 0.07, 1e-3
    rate = (flow(y, time + step) - flow(y, time - step)) / (2.0 * step)
    curvature = (flow(y + step, time) - 2.0 * flow(y, time) + flow(y - step, time)) / step**2
    assert rate == pytest.approx(curvature + force, abs=2e-3)
    walls = flow(np.array([0.0, 1.0]), time)
    assert walls == pytest.approx([0.0, 0.0 if force else 1.0], abs=1e-12)


@pytest.mark.parametrize(
    ("case", "name", "flow"), [(POISEUILLE, "poiseuille", poiseuille), (COUETTE, "couette", couette)]
)
def test_the_reference_itself_has_no_error(case, name, flow):
    times = TIME_UNIT * np.array([0.0, *TIMES])
    place = np.tile(np.linspace(0.01, 0.99, 50), (6, 1))
    speed = np.stack([np.zeros(50), *(flow(place[0], time) for time in TIMES)])
    assert case.errors(times, {"place": place, "speed": speed}, case.scene(15, 2)) == {name: pytest.approx(0.0)}
    speed[3, 7] += 0.02
    assert case.errors(times, {"place": place, "speed": speed}, case.scene(15, 2)) == {name: pytest.approx(0.02)}
    speed[3, 7] = np.nan
    assert not case.errors(times, {"place": place, "speed": speed}, case.scene(15, 2))[name] <= 1.0


@pytest.mark.parametrize("dim", [2, 3])
def test_both_flows_start_as_the_series_say(dim):
    pieces = []
    result = run(CASES["shear-start-up"], 12, dim, device="cpu", progress=pieces.append)
    assert set(result.errors) == {"poiseuille", "couette"}
    assert 0.0 < max(result.errors.values()) < 0.03
    assert result.case == "shear-start-up"
    assert result.particles == {2: 12 * 12, 3: 12 * 4 * 4}[dim]
    assert sum(pieces) == pytest.approx(CASE.end)
    assert result.records["couette_speed"].shape == (6, result.particles)
    assert result.passed is None  # the target is set from L/30 on


def test_a_run_may_end_early():
    result = run(CASE, 12, device="cpu", end=0.05 * TIME_UNIT)
    assert result.times.tolist() == pytest.approx([0.0, 0.02 * TIME_UNIT, 0.05 * TIME_UNIT])


@pytest.mark.slow
def test_refined_runs_meet_the_target_and_converge():
    coarse, fine = (run(CASE, resolution, device="cpu") for resolution in (15, 30))
    assert fine.passed, fine.errors
    assert min(observed_order(coarse, fine).values()) > 1.5
