"""The channel: its reference and coarse runs; longer ones are marked slow."""

import numpy as np
import pytest

from fluidgym.solver import Solver
from fluidgym.validation import channel, run
from fluidgym.validation.channel import CASE, GRADIENT, START, TIME_UNIT, profile

# -- reference -------------------------------------------------------------------------------------------------------


def test_the_profile_is_that_of_laminar_flow():
    y = (np.arange(1000) + 0.5) / 1000
    assert profile(y).mean() == pytest.approx(1.0, abs=1e-5)  # U
    assert profile(np.array([0.0, 0.5, 1.0])) == pytest.approx([0.0, 1.5, 0.0])
    bend = profile(y + 0.01) - 2.0 * profile(y) + profile(y - 0.01)
    assert 1000.0 * channel.VISCOSITY * bend / 0.01**2 == pytest.approx(GRADIENT)  # the pressure bears the friction


def test_a_channel_starts_with_the_exact_flow():
    solver = Solver(CASE.scene(10, 2), device="cpu")
    found = channel.observe(solver)
    assert found["profile"] == pytest.approx(0.0, abs=1e-6)
    assert found["gradient"] == pytest.approx(0.0, abs=1e-4)
    assert found["flux"] == pytest.approx(0.005, abs=1e-4)  # midpoint rule of the parabola: 1/(2 n^2)
    assert found["ledger"] == 0.0
    assert found["gone"] == 0.0


def test_records_of_the_reference_have_no_error():
    times = np.concatenate([[0.0], CASE.times[:80]])
    records = {name: np.zeros(81) for name in ("profile", "worst", "flux", "gradient", "ledger")}
    records["gone"] = 1000.0 * times
    errors = CASE.errors(times, records, CASE.scene(10, 2))
    assert list(errors.values()) == pytest.approx([0.0] * 6, abs=1e-12)
    records["ledger"][3] = 1.0  # at any instant
    records["profile"][40] = 1.0  # the window begins after this
    records["worst"][41] = 0.3
    records["gone"] = 1010.0 * times
    errors = CASE.errors(times, records, CASE.scene(10, 2))
    assert errors == pytest.approx(
        {"profile": 0.0, "worst": 0.3, "flux": 0.0, "outflow": 0.01, "gradient": 0.0, "ledger": 1.0}
    )


# -- runs ------------------------------------------------------------------------------------------------------------


def test_a_coarse_channel_keeps_its_flow():
    result = run(CASE, 10, device="cpu")
    assert result.particles == 310
    assert result.errors["profile"] < 0.015
    assert abs(result.errors["flux"]) < 0.005
    assert abs(result.errors["outflow"]) < 0.03
    assert abs(result.errors["gradient"]) < 0.15
    assert result.errors["ledger"] == 0.0


def test_a_coarse_channel_starts_to_flow():
    result = run(START, 10, device="cpu", end=10.0 * TIME_UNIT)
    assert result.particles == 250  # and none in the outflow
    assert result.records["profile"][0] > 0.5  # at rest
    assert result.errors["profile"] < 0.03
    assert abs(result.errors["flux"]) < 0.02
    assert result.errors["ledger"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("case", [CASE, START], ids=lambda case: case.name)
def test_a_channel_flows_on(case):
    result = run(case, 20, device="cpu", end=20.0 * TIME_UNIT)
    assert result.errors["profile"] < 0.006
    assert abs(result.errors["flux"]) < 0.002
    assert abs(result.errors["outflow"]) < 0.005
    assert result.errors["ledger"] == 0.0
