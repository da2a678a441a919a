"""The validation cases: their references, and short runs of each; the runs at full length are marked slow."""

import dataclasses
import math

import numpy as np
import pytest

from fluidgym.__main__ import main
from fluidgym.scene import released_head
from fluidgym.validation import (
    CASES,
    Result,
    dam_break,
    elliptic_drop,
    limits_at,
    observed_order,
    run,
    still_tank,
)
from fluidgym.validation.case import shaken
from fluidgym.validation.report import as_json, markdown


@pytest.fixture(scope="module")
def dam_break_20() -> Result:
    """The dam break at H/20 up to t* = 1.5."""
    return run(dam_break.CASE, 20, device="cpu", end=1.5 * dam_break.TIME_UNIT)


# -- references ------------------------------------------------------------------------------------------------------


def test_the_exact_drop_is_that_of_the_literature():
    b, center = elliptic_drop.reference(elliptic_drop.TIMES)
    assert b == pytest.approx([1.08310, 1.20659, 1.43922, 1.68755, 1.94452], abs=6e-6)
    assert center == pytest.approx([4874.7, 4356.0, 3065.8, 1954.4, 1222.0], abs=0.06)


def test_the_exact_drop_keeps_its_energy():
    # Kinetic energy of u = (-A x, A y) in the ellipse: proportional to A^2 (a^2 + b^2), and C = A^2 / (a^2 + b^2).
    b, center = elliptic_drop.reference(np.linspace(0.0, 0.02, 5))
    energy = center * (b**2 + b**-2) ** 2
    assert energy == pytest.approx(energy[0], rel=1e-8)


def test_the_column_starts_with_the_pressure_of_its_release():
    along = np.linspace(0.1, 0.9, 5)

    def pressure(x, y):
        return released_head(np.stack(np.broadcast_arrays(x, y), axis=1), width=2.0, height=1.0)

    assert pressure(2.0, along) == pytest.approx(0.0, abs=1e-3)  # where the gate was
    assert pressure(2 * along, 1.0) == pytest.approx(0.0, abs=1e-3)  # on top
    step = 0.02
    at_gate = pressure(2.0 - step, along) / step
    assert (at_gate > 0.05).all()  # it pushes forward from the first instant
    assert pressure(step, along) == pytest.approx(pressure(0.0, along), abs=1e-3)  # the wall holds it
    slope = (pressure(along, 2 * step) - pressure(along, 0.5 * step)) / (1.5 * step)
    assert slope == pytest.approx(-1.0, abs=0.05)  # the floor bears its weight
    x, y = np.array([0.6, 1.2, 1.5]), np.array([0.5, 0.3, 0.7])
    around = pressure(x + step, y) + pressure(x - step, y) + pressure(x, y + step) + pressure(x, y - step)
    assert around / 4 == pytest.approx(pressure(x, y), abs=1e-5)  # Laplace


def test_the_reference_itself_has_no_error():
    times = dam_break.TIME_UNIT * dam_break.FRONT_TIMES
    errors = dam_break.errors(times, {"front": dam_break.FRONT}, dam_break.scene(20, 2))
    assert errors == {"front": 0.0}
    ahead = dam_break.FRONT + 0.02 * (dam_break.FRONT - 2.0)
    assert dam_break.errors(times, {"front": ahead}, dam_break.scene(20, 2))["front"] == pytest.approx(0.02)


def test_wall_pressures_equal_to_the_reference_have_no_error():
    t = np.concatenate([dam_break.FRONT_TIMES, np.arange(2.55, 5.5501, 0.025)])
    nearest = np.abs(t[:, None] - dam_break.PRESSURE_TIMES).argmin(axis=1)
    records = {name: values[nearest] for name, values in dam_break.PRESSURE.items()}
    records["front"] = np.interp(t, dam_break.FRONT_TIMES, dam_break.FRONT)
    errors = dam_break.errors(t * dam_break.TIME_UNIT, records, dam_break.scene(20, 2))
    assert set(errors) == {"front", "P1", "P2", "P3", "impulse"}
    assert list(errors.values()) == pytest.approx([0.0] * 5, abs=1e-12)
    records["P2"] = records["P2"] + 0.1
    assert dam_break.errors(t * dam_break.TIME_UNIT, records, dam_break.scene(20, 2))["P2"] == pytest.approx(0.1)
    records |= {name: 1.1 * values[nearest] for name, values in dam_break.PRESSURE.items()}
    assert dam_break.errors(t * dam_break.TIME_UNIT, records, dam_break.scene(20, 2))["impulse"] == pytest.approx(0.1)


def test_between_the_instants_of_the_reference_a_pressure_is_not_judged():
    t = np.arange(2.55, 5.5501, 0.025)
    nearest = np.abs(t[:, None] - dam_break.PRESSURE_TIMES).argmin(axis=1)
    away = np.abs(t - dam_break.PRESSURE_TIMES[nearest]) > 0.07
    records = {name: values[nearest] + 5.0 * away for name, values in dam_break.PRESSURE.items()}
    records["front"] = np.ones(len(t))
    errors = dam_break.errors(t * dam_break.TIME_UNIT, records, dam_break.scene(20, 2))
    assert away.sum() > 50
    assert [errors[name] for name in ("P1", "P2", "P3", "impulse")] == pytest.approx([0.0] * 4, abs=1e-12)


# -- several runs ----------------------------------------------------------------------------------------------------


def test_several_runs_differ_by_chance_and_give_their_mean_and_spread():
    case = dataclasses.replace(dam_break.CASE, times=dam_break.CASE.times[:24], end=dam_break.CASE.times[23])
    both = run(case, 10, device="cpu", seeds=2)
    each = [run(shaken(case, seed), 10, device="cpu").errors["front"] for seed in range(2)]
    assert each[0] != each[1]
    assert both.errors["front"] == pytest.approx(np.mean(each), rel=1e-12)
    assert both.spread["front"] == pytest.approx(np.std(each, ddof=1), rel=1e-12)
    assert both.seeds == 2 and both.particles == 200
    assert as_json(both, {})["spread"] == both.spread


def test_a_shaken_start_is_off_by_a_hundredth_of_the_spacing():
    case = CASES["dam-break"]
    still, moved = case.scene(10, 2), shaken(case, 3).scene(10, 2)
    off = np.abs(moved.sample().position - still.sample().position) / still.particle_spacing
    assert 0.009 < off.max() <= 0.01
    jittered = CASES["taylor-green"].scene(25, 2)  # it is off its lattice by more
    assert shaken(CASES["taylor-green"], 3).scene(25, 2).jitter == jittered.jitter > 0.01


# -- short runs ------------------------------------------------------------------------------------------------------


def test_the_front_of_a_coarse_dam_break_is_near_the_reference(dam_break_20):
    result = run(dam_break.CASE, 25, device="cpu", end=1.5 * dam_break.TIME_UNIT)
    assert result.errors["front"] < 0.021  # half a spacing at t* = 1 is 2.1 % of the travel
    assert dam_break_20.particles == 800
    assert (np.diff(dam_break_20.records["front"]) > 0).all()
    assert dam_break_20.passed is None  # the target is set from H/40 on


def test_the_front_at_forty_particles_meets_its_target():
    result = run(dam_break.CASE, 40, device="cpu")
    assert result.target == {"front": 0.007}
    assert result.passed, result.errors


@pytest.mark.parametrize("dim", [2, 3])
def test_still_water_stays_still(dim):
    result = run(still_tank.CASE, 10, dim, device="cpu", end=5 * still_tank.TIME_UNIT)
    assert result.errors["pressure"] < 0.04
    assert result.errors["early_speed"] < {2: 0.01, 3: 0.02}[dim]  # while the lattice gives way, of sqrt(gH)
    assert abs(result.errors["depth"]) < 0.005
    assert result.particles == {2: 110, 3: 250}[dim]


def test_a_coarse_drop_is_drawn_out_as_the_exact_one():
    result = run(elliptic_drop.CASE, 10, device="cpu")
    assert result.errors["b"] < 0.03
    assert -0.06 < result.errors["energy"] < 0.001  # viscosity takes, nothing gives
    assert result.records["center"][0] == pytest.approx(5000.0, rel=0.05)


# -- full length -----------------------------------------------------------------------------------------------------

TARGETS = [
    (name, resolution, dim)
    for name, case in CASES.items()
    for dim, resolutions in case.resolutions.items()
    for resolution in resolutions
    if resolution <= 40
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "resolution", "dim"), TARGETS)
def test_targets_are_met(name, resolution, dim):
    result = run(CASES[name], resolution, dim, device="cpu")
    assert result.passed is not False, (result.errors, result.target)
    assert all(math.isfinite(error) for error in result.errors.values())


@pytest.mark.slow
def test_a_dam_break_goes_on_through_its_impact():
    result = run(dam_break.CASE, 40, device="cpu", end=float(dam_break.CASE.times[-1]))
    assert result.errors["P1"] < 0.5
    assert abs(result.errors["impulse"]) < 0.1
    assert result.records["P1"].max() > 1.5  # it did strike


# -- the framework ---------------------------------------------------------------------------------------------------


def test_every_case_is_complete():
    for name, case in CASES.items():
        assert name == case.name
        assert case.title
        assert (np.diff(case.times) > 0).all()
        assert case.times[0] <= case.end <= case.times[-1]
        for dim, resolutions in case.resolutions.items():
            assert case.scene(resolutions[0], dim).dim == dim


def test_limits_hold_from_their_resolution_on():
    limits = {40: {"front": 0.015, "P1": 0.1}, 80: {"front": 0.01}}
    assert limits_at(20, limits) == {}
    assert limits_at(60, limits) == {"front": 0.015, "P1": 0.1}
    assert limits_at(80, limits) == {"front": 0.01, "P1": 0.1}


def test_a_result_passes_only_within_every_target(dam_break_20):
    def passed(errors, target):
        return dataclasses.replace(dam_break_20, errors=errors, target=target).passed

    assert passed({"a": 1.0}, {}) is None
    assert passed({"a": 1.0, "b": -2.0}, {"a": 1.0}) is True
    assert passed({"a": 1.0, "b": -2.0}, {"a": 1.0, "b": 1.9}) is False
    assert passed({"a": math.nan}, {"a": 1.0}) is False  # a run that broke down
    assert passed({}, {"a": 1.0}) is False


def test_order_of_convergence_is_the_slope_of_the_errors(dam_break_20):
    coarse = dataclasses.replace(dam_break_20, resolution=20, errors={"a": 0.08, "b": -0.3, "c": 0.1})
    fine = dataclasses.replace(dam_break_20, resolution=80, errors={"a": 0.005, "b": 0.3, "c": 0.0})
    order = observed_order(coarse, fine)
    assert order["a"] == pytest.approx(2.0)
    assert order["b"] == pytest.approx(0.0)
    assert math.isnan(order["c"])


def test_progress_adds_up_to_the_simulated_time():
    pieces = []
    end = 0.5 * dam_break.TIME_UNIT
    result = run(dam_break.CASE, 10, device="cpu", end=end, progress=pieces.append)
    assert sum(pieces) == pytest.approx(end)
    assert result.times[-1] == pytest.approx(end)
    assert result.wall_s > 0


def test_a_case_is_the_same_every_time():
    first, second = (run(dam_break.CASE, 10, device="cpu", end=dam_break.TIME_UNIT) for _ in range(2))
    assert first.records["front"].tolist() == second.records["front"].tolist()


def test_a_run_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="has no 3D variant; use dim = 2"):
        run(dam_break.CASE, 10, 3, device="cpu")
    with pytest.raises(ValueError, match="before the first instant"):
        run(dam_break.CASE, 10, device="cpu", end=1e-6)


# -- the page --------------------------------------------------------------------------------------------------------


def test_a_page_holds_what_was_run_and_names_what_was_left_out(tmp_path):
    page = tmp_path / "page.md"
    arguments = ["martin-moyce", "--resolutions", "4", "8", "16", "--device", "cpu", "--limit", "1e-9"]
    assert main(["validate", *arguments, "--markdown", str(page)]) == 0
    text = page.read_text()
    assert "python -m fluidgym validate martin-moyce --resolutions 4 8 16 --device cpu --limit 1e-09" in text
    assert "--markdown page.md" in text
    assert str(tmp_path) not in text
    assert "limit: martin-moyce 2D 1/8, martin-moyce 2D 1/16." in text
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")]
    assert [row[5] for row in rows] == ["error", "---", "front", "travel", "height", "clock"]


def test_a_page_says_which_limits_are_kept(dam_break_20):
    def found(resolution, front):
        result = dataclasses.replace(
            dam_break_20, resolution=resolution, errors={"front": front}, target={"front": 0.02}, goal={"front": 0.01}
        )
        return as_json(result, {"front": 1.5})

    runs = [found(20, 0.015), found(40, math.nan)]
    text = markdown(runs, CASES, {"device": "cpu"}, "make it")
    assert "| 1.5 | 0.02 pass | 0.01 not met |" in text
    assert "| front | nan |  | 1.5 | 0.02 MISS | 0.01 not met |" in text
    assert text.count("## dam-break\n") == 1
    assert "The default scheme." in text
    assert "Left out" not in text
    assert "The scheme `fast`." in markdown([runs[0] | {"scheme": "fast"}], CASES, {}, "make it")
