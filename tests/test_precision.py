"""Double precision: the same kernels at 64 bits, beside those at 32.

Run as a script, in an interpreter of its own whose precision the environment chooses, this file runs a few scenes and
leaves what came out in the file it is given.
"""

import ast
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fluidgym import precision
from fluidgym.__main__ import REFUSED, main

# A module whose kernel reads what it captures: a number that a loop goes on from, a vector, an integer, a function.
CAPTURES = """
import warp as wp

FAR = wp.constant(1.0 / 3.0)
STEPS = wp.constant(3)
WEIGHTS = wp.constant(wp.vec2(1.0 / 3.0, 1.0 / 7.0))

def make(third, keys):
    @wp.func
    def half(x: float) -> float:
        return 0.5 * x

    @wp.kernel(module="unique", enable_backward=False)
    def add_up(found: wp.array[float]):
        best = FAR
        n = STEPS
        for k in range(STEPS):
            best += half(WEIGHTS[1]) + third + wp.static(keys["seventh"]) + 1.0 / 7.0
            n += 1
        found[0] = best + float(n) + wp.pi

    return add_up

def run():
    found = wp.zeros(1, dtype=float, device="cpu")
    wp.launch(make(1.0 / 3.0, {"seventh": 1.0 / 7.0}), 1, [found], device="cpu")
    return float(found.numpy()[0])
"""
CAPTURED = 1.0 / 3.0 + 3.0 * (0.5 / 7.0 + 1.0 / 3.0 + 2.0 / 7.0) + 6.0 + np.pi


def dam_break():
    """Front and arrays of a dam break at H/10, t* = 2."""
    from fluidgym.diagnostics import front
    from fluidgym.solver import Solver
    from fluidgym.validation import dam_break as case

    scene = case.scene(10, 2)
    solver = Solver(scene, device="cpu")
    solver.advance(2.0 * case.TIME_UNIT)
    saved = solver.save()
    return front(solver.particles(), scene) / case.HEIGHT, saved


def twins():
    """Largest difference of the native and the plain pair loop after two steps of stirred fluid, over the value."""
    from fluidgym.scene import PERIODIC, Ball, Body, Box, Face, Fluid, Material, Particles, Scene
    from fluidgym.solver import Solver

    faces = {"x_min": PERIODIC, "x_max": PERIODIC, "y_min": Face(slip="no", moving=True)}
    scene = Scene(
        (0.0, 0.0),
        (1.0, 1.0),
        0.1,
        Fluid(Box((0.0, 0.0), (1.0, 1.0))),
        faces=faces,
        bodies={"sheet": Body(Box((0.45, 0.4), (0.47, 0.6))), "ball": Body(Ball((0.5, 0.8), 0.03))},
        material=Material(viscosity=0.02, sound_speed=25.0),
        reference_speed=2.0,
        jitter=0.3,
    )
    random, start = np.random.default_rng(9), scene.sample()
    pressure = 1000.0 * 25.0**2 * random.uniform(-0.01, 0.02, len(start))
    velocity = random.uniform(-1.0, 1.0, start.position.shape)
    start = Particles(start.position, velocity, start.density, pressure, start.identity)
    saved = []
    for plain_loops in (False, True):
        solver = Solver(scene, plain_loops=plain_loops, device="cpu")
        solver.set_start([0], [start])
        solver.reset()
        solver.step(2)
        saved.append(solver.save())
    names = ("position", "velocity", "density_error", "acceleration")
    return {name: float(np.abs(saved[0][name] - saved[1][name]).max() / np.abs(saved[1][name]).max()) for name in names}


def everything():
    """Whether a scene with a body, a nozzle, an outflow and heat, and one in 3D at rest, go on with finite numbers."""
    from fluidgym.scene import Ball, Body, Box, Face, Fluid, Inflow, Material, Outflow, Scene
    from fluidgym.scheme import Scheme
    from fluidgym.solver import Solver
    from fluidgym.sph.deposit import Deposit
    from fluidgym.sph.wall_models import FrozenWalls

    full = Scene(
        (0.0, 0.0),
        (1.0, 1.0),
        0.05,
        Fluid(Box((0.0, 0.0), (0.5, 0.5)), temperature=20.0),
        {"y_min": Face(slip="no", temperature=30.0)},
        material=Material(viscosity=1e-3, thermal_diffusivity=1e-3),
        bodies={"gate": Body(Box((0.5, 0.0), (0.51, 0.7)), moving=True), "ball": Body(Ball((0.8, 0.2), 0.1))},
        inflows={"jet": Inflow((0.2, 0.9), (1.0, 0.0), 0.2, 2.0, temperature=60.0)},
        outflows={"drain": Outflow(Box((0.9, 0.0), (1.0, 0.1)))},
    )
    solver = Solver(full, device="cpu", report_forces=True)
    solver.body_velocity[:, 0] = (0.0, 0.5)
    solver.advance(0.05)
    state = solver.state
    deposit = Deposit((0.0, 0.0), (1.0, 1.0), (4, 4), 0.05, 1.0, 1, solver.capacity, solver.device)
    fraction = deposit.run(state.now.position, state.now.velocity, state.now.identity)[0, 0]
    found = {
        "share": float(fraction.sum() / 16.0 / (solver.account().live * 0.05**2)),
        "force": float(np.abs(solver.body_force).max()),
        "emitted": solver.account().emitted,
        "finite": all(bool(np.isfinite(array).all()) for array in solver.save().values()),
        "widths": sorted({str(array.dtype) for array in solver.save().values() if array.dtype.kind == "f"}),
    }
    for dim, scheme in ((3, Scheme()), (2, Scheme(walls=FrozenWalls()))):
        column = Fluid(Box((0.0,) * dim, (0.6, 0.6, 0.4)[-dim:]), pressure="hydrostatic")
        tank = Scene((0.0,) * dim, (0.6,) * dim, 0.1, column)
        still = Solver(tank, scheme, device="cpu")
        still.step(5)
        found[f"speed in {type(scheme.walls).__name__}"] = float(np.abs(still.particles().velocity).max())
    return found


def captures(folder):
    """What the kernel of CAPTURES adds up."""
    file = Path(folder, "captures.py")
    file.write_text(CAPTURES)
    loader = precision._Loader("fluidgym.captures", str(file))
    spec = importlib.util.spec_from_file_location("fluidgym.captures", file, loader=loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module.run()


if __name__ == "__main__":
    front, saved = dam_break()
    outcome = {
        "front": front,
        "widths": sorted({str(array.dtype) for array in saved.values() if array.dtype.kind == "f"}),
        "twins": twins(),
        "everything": everything(),
        "captures": captures(Path(sys.argv[1]).parent),
    }
    Path(sys.argv[1]).write_text(json.dumps(outcome))
    sys.exit()


def python(*arguments, **environment):
    """Run Python with these arguments and additions to the environment."""
    return subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.fixture(scope="module")
def double(tmp_path_factory):
    file = tmp_path_factory.mktemp("double") / "outcome.json"
    result = python(__file__, str(file), FLUIDGYM_PRECISION="double")
    assert result.returncode == 0, result.stderr
    return json.loads(file.read_text())


def test_front_differs_by_less_than_a_fifth_of_a_percent_of_its_travel(double):
    front, saved = dam_break()
    assert saved["position"].dtype == np.float32
    assert double["widths"] == ["float64"]
    assert 0.0 < abs(double["front"] - front) < 0.002 * (front - 2.0)


def test_twins_of_the_pair_loop_agree_to_double_precision(double):
    assert max(double["twins"].values()) < 1e-12, double["twins"]


def test_all_features_run_in_double_precision(double):
    found, single = double["everything"], everything()
    assert found.pop("widths") == ["float64"] and "float32" in single.pop("widths")
    assert found["finite"] and found["emitted"] > 0 and found["force"] > 0.0
    assert found["share"] == pytest.approx(1.0, abs=1e-6)  # of the fluid is on the coarse grid
    assert found == pytest.approx(single, rel=1e-4)
    assert found["speed in MirrorWalls"] != single["speed in MirrorWalls"]


def test_captured_numbers_keep_all_their_digits(double):
    assert double["captures"] == pytest.approx(CAPTURED, rel=1e-15)


def test_single_precision_rewrites_nothing():
    assert precision.chosen() == "single"
    assert not [finder for finder in sys.meta_path if isinstance(finder, precision._Finder)]
    from fluidgym.sph import sums

    assert sums.point_volume.func.__code__.co_filename == sums.__file__


def test_host_code_changes_only_where_it_meets_warp():
    source = """
import warp as wp
limit: float = float('1.5') + 0.5
numbers = wp.zeros(3, dtype=float)
names = wp.array([1], dtype=int)
vec = wp.types.vector(2, wp.float32)
corner = wp.vec3(0.0, 0.5, 1.0)
count = wp.vec3i(1, 2, 3)
"""
    expected = source.replace("dtype=float", "dtype=wp.float64").replace("wp.float32", "wp.float64")
    expected = expected.replace("wp.vec3(", "wp.vec3d(")
    assert precision.in_double(source) == ast.unparse(ast.parse(expected))


def test_device_code_is_rewritten_whole():
    source = """
@wp.struct
class Pair:
    gap: float
    count: int

@wp.func_native(text)
def native(x: vec, c: Constants) -> float:
    ...

@wp.func
def far(x: float, places: wp.array2d[float]) -> wp.vec2:
    '''A half 0.5.'''
    y = float(x) * 2.0 + TOUCH
    if wp.static(flat):
        y += wp.static(0.5 * share) * float(int(y))
    return wp.vec2(y, -places[0, COLUMN])
"""
    expected = """
@wp.struct
class Pair:
    gap: wp.float64
    count: int

@wp.func_native(_native_in_double(text))
def native(x: vec, c: Constants) -> wp.float64:
    ...

@wp.func
def far(x: wp.float64, places: wp.array2d[wp.float64]) -> wp.vec2d:
    '''A half 0.5.'''
    y = wp.float64(x) * wp.float64(2.0) + wp.static(_to_double(TOUCH))
    if wp.static(_to_double(flat)):
        y += wp.static(_to_double(0.5 * share)) * wp.float64(int(y))
    return wp.vec2d(y, -places[0, wp.static(_to_double(COLUMN))])
"""
    assert precision.in_double(source) == ast.unparse(ast.parse(expected))


def test_native_lines_are_widened():
    single = "const float r = sqrtf(r2) + 1e-20f + 2.0f * x1f(3) + (int)floorf(.5f) + half2f + 1.5e3f;"
    double = "const double r = sqrt(r2) + 1e-20 + 2.0 * x1f(3) + (int)floor(.5) + half2f + 1.5e3;"
    assert precision._native_in_double(single) == double


def test_validate_runs_in_double_precision(tmp_path):
    file = tmp_path / "out.json"
    command = ("-m", "fluidgym", "validate", "dam-break", "--resolutions", "10", "--device", "cpu")
    result = python(*command, "--precision", "double", "--json", str(file))
    assert result.returncode == 0, result.stderr
    assert "in double precision" in result.stdout
    assert [found["precision"] for found in json.loads(file.read_text())] == ["double"]


def test_another_precision_is_refused_in_one_line():
    told = "FLUIDGYM_PRECISION = 'half' is unknown; use single or double, or unset it\n"
    refused = python("-m", "fluidgym", "validate", "dam-break", FLUIDGYM_PRECISION="half")
    assert (refused.returncode, refused.stderr) == (REFUSED, f"fluidgym: {told}")
    refused = python("-c", "import fluidgym; fluidgym.Solver", FLUIDGYM_PRECISION="half")
    assert refused.stderr.endswith(f"\nValueError: {told}")
    with pytest.raises(ValueError, match=r"^precision = 'half' is unknown; use single or double$"):
        precision.choose("half")


def test_a_precision_that_comes_too_late_is_refused(capsys):
    import fluidgym.state  # noqa: F401

    assert main(["validate", "dam-break", "--precision", "double"]) == REFUSED
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "comes too late" in told and "FLUIDGYM_PRECISION=double" in told
    assert precision.chosen() == "single"
