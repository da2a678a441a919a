"""Martin & Moyce, and the dam breaks in three dimensions: what was measured, how runs are measured, and short runs."""

import math

import numpy as np
import pytest

from fluidgym.scene import Box, Fluid, Scene
from fluidgym.solver import Solver
from fluidgym.validation import dam_break, martin_moyce, run
from fluidgym.validation.dam_break_3d import (
    BOX,
    BOX_SIZE,
    CASES,
    GAUGES,
    HEIGHT_TIMES,
    HEIGHTS,
    IDEAL,
    REACHED,
    WALL,
    Experiment,
    Sensor,
    arrival,
    means_after,
    observe_box,
    sensor_pressures,
)

WALL_CASE, BOX_CASE = CASES

# -- Martin & Moyce --------------------------------------------------------------------------------------------------


def test_the_table_is_that_of_others():
    # The same readings as Lobovsky et al. (2014, figure 12) show them: (x - a)/h0 at t sqrt(g/h0), with h0 = 2 a.
    times, travel = np.array([0.58, 0.8, 1.19, 1.66]), np.array([0.22, 0.44, 0.89, 1.56])
    expected = np.interp(2.0 * times, martin_moyce.FRONT_TIMES, martin_moyce.FRONT)
    assert 1.0 + 2.0 * travel == pytest.approx(expected, rel=0.03)
    assert martin_moyce.HEIGHT_TIME_UNIT == pytest.approx(math.sqrt(2.0) * martin_moyce.TIME_UNIT)
    assert (np.diff(martin_moyce.FRONT) > 0).all()
    assert (np.diff(martin_moyce.FRONT_TIMES) > 0).all()
    # No front is faster than Ritter's, 2 sqrt(g h0), which is 2 a in a unit of T.
    assert np.max((martin_moyce.FRONT[2:] - 1.44)[1:] / (martin_moyce.FRONT_TIMES[2:] - 1.19)[1:]) < 2.0


def column(late: float = 0.0) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Instants [s] and records of a run that is the table, but its front later by some T."""
    fronts = np.concatenate([[0.0], martin_moyce.FRONT_TIMES + late])
    heights = martin_moyce.HEIGHT_TIMES * math.sqrt(2.0)
    t = np.unique(np.concatenate([fronts, heights, [0.0]]))
    front = np.interp(t, fronts, [1.0, *martin_moyce.FRONT])
    height = np.interp(t, [0.0, *heights], [1.0, *martin_moyce.HEIGHTS])
    return t * martin_moyce.TIME_UNIT, {"front": front, "height": height}


def test_the_table_itself_has_no_error():
    scene = martin_moyce.scene(10, 2)
    times, records = column()
    errors = martin_moyce.errors(times, records, scene)
    assert set(errors) == {"front", "travel", "height", "clock"}
    assert list(errors.values()) == pytest.approx([0.0] * 4, abs=1e-12)
    times, records = column(late=0.2)
    errors = martin_moyce.errors(times, records, scene)
    assert errors["clock"] == pytest.approx(0.2)
    assert errors["front"] == pytest.approx(0.0, abs=1e-12)
    assert errors["height"] == pytest.approx(0.0, abs=1e-12)


def test_errors_of_front_and_height_are_relative_to_x_to_its_travel_and_to_h0():
    scene = martin_moyce.scene(10, 2)
    times, records = column()
    beyond = records["front"] > martin_moyce.SET
    ahead = np.where(beyond, 1.01 * records["front"], records["front"])
    errors = martin_moyce.errors(times, records | {"front": ahead, "height": records["height"] - 0.02}, scene)
    assert errors["front"] == pytest.approx(0.01 * math.sqrt(12 / 13))  # of 13 entries one sets the clock
    assert errors["height"] == pytest.approx(0.02)
    z = martin_moyce.FRONT[3:]
    assert errors["travel"] == pytest.approx(0.01 * math.sqrt(np.sum((z / (z - 1.0)) ** 2) / 13))


def test_a_column_that_stays_has_no_clock():
    errors = martin_moyce.errors(np.arange(3.0), {"front": np.ones(3), "height": np.ones(3)}, martin_moyce.scene(10, 2))
    assert all(math.isnan(error) for error in errors.values())


def test_a_column_of_twenty_particles_falls_as_martin_and_moyce_saw():
    result = run(martin_moyce.CASE, 20, device="cpu")
    assert result.particles == 20 * 40
    assert result.passed, result.errors
    assert -0.4 < result.errors["clock"] < -0.2  # nothing holds it back
    assert result.records["front"][0] == pytest.approx(1.0)
    assert result.records["height"][0] == pytest.approx(1.0)
    assert result.records["front"].max() < martin_moyce.LENGTH - 1.0


# -- three dimensions: what was measured -----------------------------------------------------------------------------


def test_the_wall_is_that_of_the_flow_without_friction():
    height = WALL.size[2]
    assert WALL.size[0] == 2.0 * height
    assert WALL.length / height == pytest.approx(dam_break.LENGTH, rel=1e-3)
    assert WALL.width / height == pytest.approx(dam_break.SENSOR_SIZE)
    for name, place in dam_break.SENSORS.items():
        assert WALL.sensors[name].height / height == pytest.approx(place)


def test_the_flow_without_friction_is_not_what_was_measured():
    after = means_after(dam_break.PRESSURE_TIMES, IDEAL, WALL)
    off = [after[name] / sensor.after - 1.0 for name, sensor in WALL.sensors.items()]
    assert off == pytest.approx([0.36, 0.53, 0.40, -0.46], abs=0.01)  # as the head of the file says


def test_the_box_is_where_it_was():
    # SPHERIC counts from the far wall: the middle of the box at 0.744 m, H2 at 0.992 m, H4 at 2.638 m.
    assert BOX.length - BOX.target - 0.5 * BOX_SIZE[0] == pytest.approx(0.744, abs=0.001)
    assert BOX.length - GAUGES["H2"] == pytest.approx(0.992)
    assert BOX.length - GAUGES["H4"] == pytest.approx(2.638)
    scene = BOX_CASE.scene(22, 3)
    low, high = scene.bodies["box"].shape.bounds()
    assert high - low == pytest.approx(BOX_SIZE)
    assert 0.5 * (low + high)[1] == pytest.approx(0.5 * scene.upper[1])
    assert scene.upper[1] == pytest.approx(1.0, rel=0.02)
    for sensor in BOX.sensors.values():
        assert abs(sensor.off) < 0.5 * BOX_SIZE[1]
        assert sensor.height < BOX_SIZE[2]


@pytest.mark.parametrize("experiment", [WALL, BOX], ids=["wall", "box"])
def test_sensors_are_struck_from_the_floor_up(experiment):
    struck = [sensor.arrival for sensor in experiment.sensors.values() if sensor.arrival]
    assert struck == sorted(struck)
    for sensor in experiment.sensors.values():
        assert 0.0 < sensor.after < sensor.peak
        assert (experiment.end - experiment.settled) * sensor.after < sensor.impulse


# -- three dimensions: errors ----------------------------------------------------------------------------------------


def measured(experiment: Experiment) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """t* and pressures with the arrivals, means and integrals of an experiment."""
    knots = {}
    for name, sensor in experiment.sensors.items():
        start = sensor.arrival or 2.8
        after = sensor.after * (experiment.end - experiment.settled)
        level = (sensor.impulse - after) / (experiment.settled - start)
        p = [0.0, 0.0, REACHED * sensor.peak, level, level, sensor.after, sensor.after]
        t = [0.0, start - 1e-7, start, start + 1e-7, experiment.settled - 2e-6, experiment.settled, experiment.end]
        knots[name] = (t, p)
    t = np.unique(np.concatenate([t for t, _ in knots.values()]))
    return t, {name: np.interp(t, *knot) for name, knot in knots.items()}


def test_what_was_measured_at_the_wall_has_no_error():
    t, records = measured(WALL)
    errors = WALL_CASE.errors(t * WALL.time_unit, records, WALL_CASE.scene(15, 3))
    assert set(errors) == {"arrival", "after", "impulse", "ideal"}
    assert errors["ideal"] == pytest.approx(0.642 / 0.348 - 1.0, abs=0.01)  # P4
    assert [errors[name] for name in ("arrival", "after", "impulse")] == pytest.approx([0.0] * 3, abs=2e-5)

    records |= {"P2": 1.2 * records["P2"]}
    errors = WALL_CASE.errors(t * WALL.time_unit, records, WALL_CASE.scene(15, 3))
    assert errors["after"] == pytest.approx(0.2, abs=1e-4)
    share = WALL.sensors["P2"].impulse / sum(sensor.impulse for sensor in WALL.sensors.values())
    assert errors["impulse"] == pytest.approx(0.2 * share, abs=1e-4)


def test_the_flow_without_friction_has_no_ideal_error():
    t = np.concatenate([[0.0, 2.4], np.linspace(2.5, WALL.end, 121)])
    records = {name: np.interp(t, dam_break.PRESSURE_TIMES, values) * (t > 2.4) for name, values in IDEAL.items()}
    errors = WALL_CASE.errors(t * WALL.time_unit, records, WALL_CASE.scene(15, 3))
    assert errors["ideal"] == pytest.approx(0.0, abs=1e-9)
    records["P4"] = 0.9 * records["P4"]
    assert WALL_CASE.errors(t * WALL.time_unit, records, WALL_CASE.scene(15, 3))["ideal"] == pytest.approx(0.1)


def test_what_was_measured_at_the_box_has_no_error():
    t, pressures = measured(BOX)
    t_all = np.unique(np.concatenate([t, HEIGHT_TIMES]))
    records = {name: np.interp(t_all, t, values) for name, values in pressures.items()}
    records |= {name: np.interp(t_all, HEIGHT_TIMES, values) for name, values in HEIGHTS.items()}
    errors = BOX_CASE.errors(t_all * BOX.time_unit, records, BOX_CASE.scene(14, 3))
    assert set(errors) == {"arrival", "after", "impulse", "height"}
    assert list(errors.values()) == pytest.approx([0.0] * 4, abs=2e-5)

    late = 1.05 * t_all  # everything takes so much longer
    errors = BOX_CASE.errors(late * BOX.time_unit, records, BOX_CASE.scene(14, 3))
    assert errors["arrival"] == pytest.approx(0.05, abs=1e-5)
    short = {name: values[t_all < 4.0] for name, values in records.items()}
    short["H4"] = short["H4"] + 0.1
    errors = BOX_CASE.errors(t_all[t_all < 4.0] * BOX.time_unit, short, BOX_CASE.scene(14, 3))
    assert set(errors) == {"arrival", "height"}  # the rest takes a whole run
    assert errors["height"] == pytest.approx(0.1 / math.sqrt(2.0))


def test_a_sensor_is_reached_between_two_instants_or_never():
    t, p = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 0.1, 0.5, 0.2])
    assert arrival(t, p, 0.3) == pytest.approx(1.5)
    assert math.isnan(arrival(t, p, 0.6))
    assert math.isnan(arrival(t, np.full(4, np.nan), 0.3))


# -- three dimensions: measuring -------------------------------------------------------------------------------------


def test_sensors_in_still_water_show_its_weight():
    small = Experiment(
        size=(0.5, 0.2, 0.4),
        length=0.5,
        target=0.5,
        width=0.02,
        sensors={"low": Sensor(0.0, 0.05, 1.0, 1.0, 0.0, 0.0), "high": Sensor(0.03, 0.3, 1.0, 1.0, 0.0, 0.0)},
        settled=0.0,
        end=1.0,
    )
    water = Fluid(Box((0.0, 0.0, 0.0), small.size), pressure="hydrostatic")
    scene = Scene((0.0, 0.0, 0.0), (0.5, 0.2, 0.5), 0.02, water)
    pressures = sensor_pressures(Solver(scene, device="cpu"), small)
    assert pressures == pytest.approx({"low": 1.0 - 0.05 / 0.4, "high": 1.0 - 0.3 / 0.4}, abs=0.01)


@pytest.mark.parametrize("resolution", [11, 14])
def test_gauges_show_the_height_of_the_column(resolution):
    found = observe_box(Solver(BOX_CASE.scene(resolution, 3), device="cpu"))
    assert found["H4"] == pytest.approx(1.0, rel=1e-6)
    assert found["H2"] == 0.0
    assert [found[name] for name in BOX.sensors] == [0.0] * 4  # dry


# -- three dimensions: runs ------------------------------------------------------------------------------------------


def test_a_coarse_dam_break_strikes_the_wall_on_time():
    result = run(WALL_CASE, 10, 3, device="cpu", end=2.7 * WALL.time_unit)
    assert result.particles == 20 * 5 * 10
    assert set(result.errors) == {"arrival"}
    assert result.errors["arrival"] < 0.1
    assert result.records["P1"][result.times < 2.2 * WALL.time_unit].max() == 0.0
    assert result.passed is None  # the target is set from H/15 on


def test_a_coarse_dam_break_strikes_the_box_on_time():
    result = run(BOX_CASE, 8, 3, device="cpu", end=2.1 * BOX.time_unit)
    assert set(result.errors) == {"arrival", "height"}
    assert result.errors["arrival"] < 0.12
    assert result.errors["height"] < 0.03
    assert result.records["H2"].max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_coarse_dam_break_goes_on_through_its_impact(case):
    result = run(case, case.resolutions[3][0], 3, device="cpu")
    assert result.passed, result.errors
    assert all(math.isfinite(error) for error in result.errors.values())
