"""Schemes: their limits, the terms they imply, and the step they allow."""

import math

import pytest
import warp as wp

from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.sph.constants import Constants
from fluidgym.sph.continuity import DENSITY_DIFFUSION, DIVERGENCE
from fluidgym.sph.pressure import PRESSURE_GRADIENT
from fluidgym.sph.terms import DensityRate, Force
from fluidgym.sph.viscosity import ARTIFICIAL_VISCOSITY, VISCOSITY_MORRIS


@wp.func
def nothing(r: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
    return 0.0


def test_schemes_with_the_same_fields_are_equal_and_hash_alike():
    assert Scheme(courant=0.5) == Scheme(courant=0.5) != Scheme()
    assert len({Scheme(), Scheme(gamma=7.0), Scheme(courant=0.5)}) == 2


def test_smoothing_length_is_its_ratio_times_the_spacing():
    assert DEFAULT_SCHEME.smoothing_length(0.1, 2) == pytest.approx(0.15)
    assert DEFAULT_SCHEME.smoothing_length(0.1, 3) == pytest.approx(0.13)
    assert Scheme(smoothing_ratio=2.0).smoothing_length(0.1, 3) == pytest.approx(0.2)


def test_terms_are_those_that_the_fields_imply():
    assert DEFAULT_SCHEME.density_terms() == (DIVERGENCE, DENSITY_DIFFUSION)
    assert DEFAULT_SCHEME.force_terms(viscous=False) == (PRESSURE_GRADIENT, ARTIFICIAL_VISCOSITY)


def test_term_of_no_effect_is_left_out():
    bare = Scheme(density_diffusion=0.0, artificial_viscosity=0.0)
    assert bare.density_terms() == (DIVERGENCE,)
    assert bare.force_terms(viscous=False) == (PRESSURE_GRADIENT,)
    assert bare.force_terms(viscous=True) == (PRESSURE_GRADIENT, VISCOSITY_MORRIS)


def test_further_terms_go_to_the_sweep_of_their_kind():
    rate, force = DensityRate(nothing), Force(nothing)
    scheme = Scheme(terms=(force, rate))
    assert scheme.density_terms()[-1] is rate
    assert scheme.force_terms(viscous=False)[-1] is force
    assert len(scheme.density_terms()) == len(scheme.force_terms(viscous=False)) == 3


def test_time_step_is_the_shortest_that_sound_viscosity_or_gravity_allow():
    step = Scheme(courant=0.8).time_step
    assert step(0.1, 90.0, 10.0, 0.0, 0.0) == pytest.approx(0.8 * 0.1 / 100.0)
    assert step(0.1, 90.0, 10.0, 10.0, 0.0) == pytest.approx(0.125 * 0.1**2 / 10.0)
    assert step(0.1, 90.0, 10.0, 0.0, 1e6) == pytest.approx(0.5 * math.sqrt(0.1 / 1e6))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"smoothing_ratio": 0.9}, "Scheme.smoothing_ratio = 0.9 is outside 1 to 3; use 1.3 to 2"),
        ({"gamma": 11.0}, "Scheme.gamma = 11 is outside 1 to 10; use 7"),
        ({"density_diffusion": -0.1}, "Scheme.density_diffusion = -0.1 is outside 0 to 0.5; use 0.1"),
        ({"artificial_viscosity": 2.0}, "Scheme.artificial_viscosity = 2 is outside 0 to 1; use 0.01"),
        ({"courant": 0.0}, "Scheme.courant = 0 is outside 1e-06 to 2; use 1.0"),
        ({"courant": float("nan")}, "Scheme.courant = nan is outside 1e-06 to 2; use 1.0"),
        ({"courant": "fast"}, "Scheme.courant = 'fast' is not a number; use 1.0"),
        ({"gamma": None}, "Scheme.gamma = None is not a number; use 7"),
        ({"smoothing_ratio": "1.5"}, "Scheme.smoothing_ratio = '1.5' is not a number; use 1.3 to 2"),
        ({"kernel": "Wendland"}, "Scheme.kernel = 'Wendland' is not a SmoothingKernel; use WENDLAND_C2"),
        ({"state_equation": 7.0}, "Scheme.state_equation = 7.0 is not a StateEquation; use LINEAR or TAIT"),
        (
            {"viscosity": 1e-6},
            "Scheme.viscosity = 1e-06 is not a Force or Drag; use VISCOSITY_MORRIS or VISCOSITY_MONAGHAN",
        ),
        ({"terms": None}, "Scheme.terms = None is not a tuple; use (Force(function),)"),
        (
            {"terms": (PRESSURE_GRADIENT, print)},
            "Scheme.terms[1] = <built-in function print> is not a DensityRate, Force or Drag; use Force(function)",
        ),
    ],
)
def test_bad_scheme_is_refused_in_one_line(changes, message):
    with pytest.raises(ValueError) as error:
        Scheme(**changes)
    assert str(error.value) == message


def test_fields_are_given_by_name():
    with pytest.raises(TypeError, match="positional"):
        Scheme(1.5)


def test_term_must_be_a_warp_function():
    with pytest.raises(ValueError, match=r"Force\(<built-in function print>\) is not of a Warp function; use @wp.func"):
        Force(print)  # pyright: ignore[reportArgumentType]
