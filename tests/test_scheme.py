"""Schemes: their limits, the terms they imply, and the step they allow."""

import dataclasses
import math

import numpy as np
import pytest
import warp as wp

from fluidgym.scene import Box, Fluid, Material, Scene
from fluidgym.scheme import DEFAULT_SCHEME, FIDELITIES, MUELLER, Scheme
from fluidgym.solver import Solver
from fluidgym.sph.constants import Constants
from fluidgym.sph.continuity import DENSITY_DIFFUSION, DIVERGENCE
from fluidgym.sph.pressure import PRESSURE_GRADIENT
from fluidgym.sph.smoothing import CUBIC_SPLINE, POLY6, WENDLAND_C2, WENDLAND_C4
from fluidgym.sph.terms import DensityRate, Force
from fluidgym.sph.viscosity import ARTIFICIAL_VISCOSITY, VISCOSITY_MORRIS
from fluidgym.sph.wall_models import ClampWalls


@wp.func
def nothing(r: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
    return 0.0


def test_schemes_with_the_same_fields_are_equal_and_hash_alike():
    assert Scheme(courant=0.5) == Scheme(courant=0.5) != Scheme()
    assert len({Scheme(), Scheme(gamma=7.0), Scheme(courant=0.5)}) == 2


def test_the_default_is_one_of_three_named_trade_offs():
    assert list(FIDELITIES) == ["fast", "balanced", "accurate"]
    assert FIDELITIES["balanced"] is DEFAULT_SCHEME
    assert all(isinstance(scheme, Scheme) for scheme in FIDELITIES.values())


def test_smoothing_length_is_its_ratio_times_the_spacing():
    assert DEFAULT_SCHEME.smoothing_length(0.1, 2) == pytest.approx(0.22)
    assert DEFAULT_SCHEME.smoothing_length(0.1, 3) == pytest.approx(0.15)
    assert Scheme(smoothing_ratio=2.5).smoothing_length(0.1, 3) == pytest.approx(0.25)
    assert Scheme(kernel=WENDLAND_C2).smoothing_length(0.1, 2) == pytest.approx(0.2)  # it falls off later
    assert Scheme(kernel=WENDLAND_C4).smoothing_length(0.1, 3) == pytest.approx(0.165)


def test_kernel_is_the_one_named_or_that_of_the_dimension_or_of_mueller():
    assert DEFAULT_SCHEME.kernel is None
    assert [DEFAULT_SCHEME.kernel_in(dim) for dim in (2, 3)] == [WENDLAND_C4, WENDLAND_C2]
    assert [Scheme(kernel=CUBIC_SPLINE).kernel_in(dim) for dim in (2, 3)] == [CUBIC_SPLINE] * 2
    assert MUELLER.kernel is None
    assert [MUELLER.kernel_in(dim) for dim in (2, 3)] == [POLY6] * 2


def test_core_is_the_one_named_or_that_of_the_dimension_and_mueller_has_none():
    assert DEFAULT_SCHEME.core is None
    assert [DEFAULT_SCHEME.core_in(dim) for dim in (2, 3)] == [1.0, 0.0]
    for core in (0.0, 0.5):
        assert [Scheme(core=core).core_in(dim) for dim in (2, 3)] == [core] * 2
    assert [MUELLER.core_in(dim) for dim in (2, 3)] == [0.0] * 2


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


@pytest.mark.parametrize("damping", [0.0, 0.1, 0.5, 2.0])
def test_damped_sound_allows_a_step_where_its_quadratic_says(damping):
    # (c_0 dt/h)^2 + 2 b c_0 dt/h = 1.5^2 takes the place of c_0 dt/h = 1.5.
    root = max(np.roots([1.0, 2.0 * damping, -(1.5**2)]).real)
    found = Scheme(courant=0.8).time_step(0.1, 90.0, 0.0, 0.0, 0.0, damping=damping)
    assert found == pytest.approx(0.8 * 0.1 / 90.0 * root / 1.5)
    moving = Scheme(courant=0.8).time_step(0.1, 90.0, 10.0, 0.0, 0.0, damping=damping)
    assert 1.0 / moving == pytest.approx(1.0 / found + 10.0 / (0.8 * 0.1))


def test_diffusion_of_density_limits_the_step_whatever_the_courant_number():
    for courant in (0.5, 1.0):
        step = Scheme(courant=courant).time_step
        assert step(0.1, 90.0, 10.0, 0.0, 0.0, diffusion=0.5) == pytest.approx(0.1 / (6.0 * 0.5 * 90.0))
        assert step(0.1, 90.0, 10.0, 0.0, 0.0, diffusion=0.01) == step(0.1, 90.0, 10.0, 0.0, 0.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_solver_takes_the_step_of_its_diffusion_and_damping(dim):
    fluid = Fluid(Box((0.0,) * dim, (0.5,) * dim))
    scene = Scene((0.0,) * dim, (1.0,) * dim, 0.05, fluid, gravity=0.0, reference_speed=1.0)
    h = {2: 0.11, 3: 0.075}[dim]
    for diffusion, damping in ((0.0, 0.0), (0.5, 0.0), (0.01, 1.0)):
        scheme = Scheme(density_diffusion=diffusion, acoustic_damping=damping, artificial_viscosity=0.0)
        expected = scheme.time_step(h, 10.0, 1.0, 0.0, 0.0, diffusion, damping)
        assert Solver(scene, scheme, device="cpu").max_step == pytest.approx(expected)
    solver = Solver(scene, Scheme(artificial_viscosity=0.0), num_worlds=2, device="cpu")
    solver.set_parameters(density_diffusion=[0.1, 0.0], acoustic_damping=[0.5, 2.0])
    assert solver.max_step == pytest.approx(Scheme().time_step(h, 10.0, 1.0, 0.0, 0.0, 0.0, 2.0))


def test_sound_speed_is_its_ratio_times_the_largest_speed_unless_the_material_has_its_own():
    tank = Scene((0.0, 0.0), (1.0, 1.0), 0.1, Fluid(Box((0.0, 0.0), (0.5, 0.5))), reference_speed=3.0)
    for ratio in (5.0, 7.0, 10.0, 20.0):
        solver = Solver(tank, Scheme(sound_speed_ratio=ratio), device="cpu")
        assert solver.scene.sound_speed == pytest.approx(3.0 * ratio)
        assert solver.parameter("sound_speed")[0] == pytest.approx(3.0 * ratio)
    assert Solver(tank, device="cpu").scene is tank
    assert tank.sound_speed == pytest.approx(30.0)
    own = dataclasses.replace(tank, material=Material(sound_speed=33.0))
    assert Solver(own, Scheme(sound_speed_ratio=7.0), device="cpu").scene.sound_speed == 33.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"smoothing_ratio": 0.9}, "Scheme.smoothing_ratio = 0.9 is outside 1 to 3; use 1.5 to 2.2"),
        ({"gamma": 11.0}, "Scheme.gamma = 11 is outside 1 to 10; use 7"),
        ({"density_diffusion": -0.1}, "Scheme.density_diffusion = -0.1 is outside 0 to 0.5; use 0.1"),
        ({"artificial_viscosity": 2.0}, "Scheme.artificial_viscosity = 2 is outside 0 to 1; use 0.0003 to 0.01"),
        ({"acoustic_damping": 2.5}, "Scheme.acoustic_damping = 2.5 is outside 0 to 2; use 0.7"),
        ({"acoustic_damping": -0.1}, "Scheme.acoustic_damping = -0.1 is outside 0 to 2; use 0.7"),
        ({"core": 4.5}, "Scheme.core = 4.5 is outside 0 to 4; use 1.0"),
        ({"core": -0.5}, "Scheme.core = -0.5 is outside 0 to 4; use 1.0"),
        ({"sound_speed_ratio": 4.9}, "Scheme.sound_speed_ratio = 4.9 is outside 5 to 1000; use 10"),
        ({"sound_speed_ratio": 1001.0}, "Scheme.sound_speed_ratio = 1001 is outside 5 to 1000; use 10"),
        ({"sound_speed_ratio": None}, "Scheme.sound_speed_ratio = None is not a number; use 10"),
        ({"courant": 0.0}, "Scheme.courant = 0 is outside 1e-06 to 2; use 1.0"),
        ({"courant": float("nan")}, "Scheme.courant = nan is outside 1e-06 to 2; use 1.0"),
        ({"courant": "fast"}, "Scheme.courant = 'fast' is not a number; use 1.0"),
        ({"gamma": None}, "Scheme.gamma = None is not a number; use 7"),
        ({"smoothing_ratio": "1.5"}, "Scheme.smoothing_ratio = '1.5' is not a number; use 1.5 to 2.2"),
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
        (
            {"surface_shifting": 1.0, "walls": ClampWalls()},
            "Scheme.surface_shifting = 1 is of no effect but with the preset 'delta' and walls = MirrorWalls();"
            " leave it out",
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
