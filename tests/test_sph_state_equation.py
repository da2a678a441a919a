"""State equations: the device and NumPy agree, and density gives back the pressure it was made from."""

import numpy as np
import pytest
import warp as wp

from fluidgym.sph import state_equation
from fluidgym.sph.constants import Constants
from fluidgym.sph.state_equation import LINEAR, TAIT, StateEquation

EQUATIONS = [equation for equation in vars(state_equation).values() if isinstance(equation, StateEquation)]
GAMMA = 7.0

each_equation = pytest.mark.parametrize("equation", EQUATIONS, ids=lambda equation: equation.name)


@each_equation
def test_device_and_numpy_give_the_same_pressure(equation):
    pressure = equation.pressure

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(s: wp.array[float], c: Constants, p: wp.array[float]):
        i = wp.tid()
        p[i] = pressure(s[i], c)

    c = Constants()
    c.gamma = GAMMA
    s = np.linspace(-0.05, 0.1, 31).astype(np.float32)
    p = wp.zeros(31, dtype=float, device="cpu")
    wp.launch(evaluate, 31, [wp.array(s, device="cpu"), c], [p], device="cpu")
    np.testing.assert_allclose(p.numpy(), equation.pressure_of(s.astype(float), GAMMA), atol=2e-7)


@each_equation
def test_density_gives_back_its_pressure(equation):
    p = np.linspace(-0.05, 0.2, 26)
    np.testing.assert_allclose(equation.pressure_of(equation.density_of(p, GAMMA), GAMMA), p, atol=1e-14)


@each_equation
def test_sound_has_its_speed_at_rest(equation):
    step = 1e-6
    slope = (equation.pressure_of(step, GAMMA) - equation.pressure_of(-step, GAMMA)) / (2 * step)
    assert slope == pytest.approx(1.0, rel=1e-9)
    assert equation.pressure_of(0.0, GAMMA) == 0.0


def test_tait_stiffens_with_density():
    assert TAIT.pressure_of(0.05, GAMMA) > LINEAR.pressure_of(0.05, GAMMA)
    assert TAIT.pressure_of(0.05, GAMMA) == pytest.approx((1.05**7 - 1.0) / 7.0)
