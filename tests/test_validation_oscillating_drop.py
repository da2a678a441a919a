"""The oscillating drop: its reference and a coarse run; longer ones are marked slow."""

import math

import numpy as np
import pytest

from fluidgym.scheme import DEFAULT_SCHEME
from fluidgym.validation import oscillating_drop, run
from fluidgym.validation.oscillating_drop import CASE, PERIOD, center_pressure, reference

# -- reference -------------------------------------------------------------------------------------------------------


def test_the_exact_drop_has_the_period_of_the_literature():
    after = reference(np.array([0.5, 1.0]) * 4.56737)
    assert after == pytest.approx(np.array([[1.0, -0.5], [1.0, 0.5]]), abs=1e-5)


def test_the_exact_drop_swings_between_two_ellipses():
    (long, still), (short, still_again) = reference(np.array([0.25, 0.75]) * 4.56737)
    assert long == pytest.approx(math.sqrt(2.0), abs=1e-6)
    assert short == pytest.approx(1.0 / math.sqrt(2.0), abs=1e-6)
    assert still == pytest.approx(0.0, abs=1e-5)
    assert still_again == pytest.approx(0.0, abs=1e-5)


def test_the_exact_drop_keeps_its_energy():
    # Of the mass M: M/8 (sigma^2 + Omega^2) (a^2 + b^2).
    a, sigma = reference(np.linspace(0.0, 10.0, 11)).T
    energy = (sigma**2 + 1.0) * (a**2 + a**-2)
    assert energy == pytest.approx(energy[0], rel=1e-8)


def test_the_pressure_at_the_center_drives_the_exact_drop():
    times = np.array([0.3, 1.1, 2.0])
    a, sigma = reference(times).T
    rate = (reference(times + 1e-4)[:, 1] - reference(times - 1e-4)[:, 1]) / 2e-4
    assert rate + sigma**2 + 1.0 == pytest.approx(2.0 * center_pressure(reference(times)) / a**2, rel=1e-6)


def test_the_reference_itself_has_no_error():
    times = np.concatenate([[0.0], CASE.times[CASE.times <= 2.0 * PERIOD * 1.000001]])
    exact = reference(times)
    records = {
        "a": 1.003 * exact[:, 0],  # a drop of another size
        "b": 1.003 / exact[:, 0],
        "center": center_pressure(exact),
        "kinetic": np.full(len(times), 2.0),
        "energy": np.full(len(times), 7.0),
    }
    errors = CASE.errors(times, records, CASE.scene(10, 2))
    assert set(errors) == {"axis", "return", "period", "energy", "pressure"}
    assert list(errors.values()) == pytest.approx([0.0] * 5, abs=1e-6)
    slow = reference(times / 1.001)  # a period longer by a thousandth
    records |= {"a": slow[:, 0], "b": 1.0 / slow[:, 0], "energy": 7.0 - 0.02 * times / PERIOD}
    errors = CASE.errors(times, records, CASE.scene(10, 2))
    assert errors["period"] == pytest.approx(0.001, rel=0.01)
    assert errors["energy"] == pytest.approx(-0.01)
    assert errors["return"] == pytest.approx(-0.5 * PERIOD * 0.001, rel=0.01)
    early = CASE.errors(times[:20], {name: values[:20] for name, values in records.items()}, CASE.scene(10, 2))
    assert set(early) == {"axis", "pressure"}


# -- runs ------------------------------------------------------------------------------------------------------------


def test_a_coarse_drop_swings_as_the_exact_one():
    result = run(CASE, 10, device="cpu")
    assert result.particles == 316
    assert result.errors["axis"] < 0.04
    assert abs(result.errors["period"]) < 0.02
    assert -0.08 < result.errors["energy"] < 0.0  # diffusion takes, nothing gives
    assert result.errors["pressure"] < 0.15
    assert result.records["a"].max() == pytest.approx(math.sqrt(2.0), rel=0.02)


@pytest.mark.slow
def test_the_drop_keeps_swinging():
    result = run(CASE, 20, device="cpu", end=5.0 * PERIOD)
    assert abs(result.errors["period"]) < 0.01
    assert -0.04 < result.errors["energy"] < 0.0
    assert np.isfinite(result.records["a"]).all()


@pytest.mark.slow
def test_the_default_scheme_holds_the_drop_within_two_percent():
    result = run(oscillating_drop.CASE, 40, device="cpu", scheme=DEFAULT_SCHEME)
    assert result.errors["axis"] < 0.02
