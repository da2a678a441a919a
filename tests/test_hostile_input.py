"""Whatever comes in either works or is refused in one line that names the field: nothing else may happen.

Hypothesis makes the input. A hundred examples of each property in the default run, two thousand under the marker slow.
"""

import dataclasses
import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fluidgym import snapshot
from fluidgym.envs import TASKS, FluidEnv, FluidVectorEnv, make_task
from fluidgym.envs.policy import Policy
from fluidgym.parts import Body, Face, Fluid, Inflow, Material, Outflow
from fluidgym.scene import Scene
from fluidgym.scene_file import loads
from fluidgym.scheme import Scheme
from fluidgym.shapes import Ball, Box
from fluidgym.solver import Solver

SCENES = sorted((Path(__file__).parents[1] / "examples" / "scenes").glob("*.toml"))

# Asked for by the tests of a property that are run under the marker slow.
MANY = 2000

numbers = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(-10.0, 10.0),
    st.integers(-(10**20), 10**20),
    st.sampled_from([0, 0.0, -1, 1, 1e-30, 1e30, math.nan, math.inf, True, False]),
)
points = st.lists(numbers, max_size=4).flatmap(lambda values: st.sampled_from([values, tuple(values)]))
anything = st.one_of(
    st.none(), numbers, points, st.text(max_size=8), st.lists(points, max_size=3),
    st.dictionaries(st.text(max_size=6), numbers, max_size=2), st.binary(max_size=4), st.just(np.array([1.0, np.nan])),
    st.just(object()), st.just(lambda points: points),
)  # fmt: skip

WHOLE = {
    Box: {"lower": (0.0, 0.0), "upper": (0.5, 0.5)},
    Ball: {"center": (0.3, 0.3), "radius": 0.2},
    Material: {},
    Face: {},
    Fluid: {"shape": Box((0.0, 0.0), (0.5, 0.5))},
    Body: {"shape": Box((0.6, 0.0), (0.7, 0.5))},
    Inflow: {"center": (0.5, 0.5), "direction": (1.0, 0.0), "width": 0.2},
    Outflow: {"region": Box((0.8, 0.0), (1.0, 0.2))},
    Scheme: {},
    Scene: {
        "lower": (0.0, 0.0), "upper": (1.0, 1.0), "particle_spacing": 0.05,
        "fluid": [Fluid(Box((0.0, 0.0), (0.5, 0.5)))],
    },
}  # fmt: skip


def changed(kind):
    """Arguments of a class, some of them replaced by anything."""
    names = [field.name for field in dataclasses.fields(kind)]
    changes = st.dictionaries(st.sampled_from(names), anything, min_size=1, max_size=3)
    return changes.map(lambda change: WHOLE[kind] | change)


def works_or_is_refused(call, kinds=(ValueError,)):
    """What a call gives, or None if it is refused as it should be."""
    try:
        return call()
    except kinds as error:
        message = str(error)
        assert message.strip(), "refused without a word"
        assert len(message.splitlines()) == 1, message
        return None


def twice(property_, **strategies):
    """A quick test of a property, and a long one."""

    def quick(**drawn):
        property_(**drawn)

    def long(**drawn):
        property_(**drawn)

    health = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.function_scoped_fixture]
    common = {"deadline": None, "suppress_health_check": health, "print_blob": True}
    quick = settings(max_examples=100, derandomize=True, **common)(given(**strategies)(quick))
    long = settings(max_examples=MANY, **common)(given(**strategies)(long))
    return quick, pytest.mark.slow(long)


# -- scenes and schemes -------------------------------------------------------------------------------------------


def part_is_made_or_refused(made):
    kind, arguments = made
    works_or_is_refused(lambda: kind(**arguments))


some_part = st.sampled_from(list(WHOLE)).flatmap(lambda kind: st.tuples(st.just(kind), changed(kind)))
test_part_is_made_or_refused, test_part_is_made_or_refused_long = twice(part_is_made_or_refused, made=some_part)


# Numbers of a scene that is small enough to run, wild as it may be; its structure is one of two, so that little is
# compiled.
wild = st.fixed_dictionaries(
    {
        "width": st.floats(0.02, 1.5),
        "height": st.floats(0.02, 1.5),
        "x": st.floats(-0.2, 1.0),
        "y": st.floats(-0.2, 1.0),
        "speed": st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0)),
        "gravity": st.floats(0.01, 100.0),
        "jitter": st.floats(0.0, 0.5),
        "spacing": st.floats(0.04, 0.2),
        "pressure": st.sampled_from(["none", "hydrostatic"]),
        "open": st.booleans(),
        "density": st.floats(1e-3, 2e4),
        "wall": st.floats(-20.0, 20.0),
    }
)


def scene_runs_or_is_refused(drawn):
    def run():
        fluid = Fluid(
            Box((drawn["x"], drawn["y"]), (drawn["x"] + drawn["width"], drawn["y"] + drawn["height"])),
            velocity=drawn["speed"],
            pressure=drawn["pressure"],
        )
        scene = Scene(
            (0.0, 0.0),
            (1.0, 1.0),
            drawn["spacing"],
            [fluid],
            {"x_min": Face(moving=True, travel=(0.0, 0.5)), **({"y_max": Face("open")} if drawn["open"] else {})},
            gravity=drawn["gravity"],
            jitter=drawn["jitter"],
            material=Material(density=drawn["density"]),
            reference_speed=30.0,
        )
        solver = Solver(scene, device="cpu")
        solver.face_velocity[0, 0] = drawn["wall"]
        solver.step(5)
        return solver

    solver = works_or_is_refused(run)
    if solver is not None:
        water = solver.particles()
        assert np.isfinite(water.position).all() and np.isfinite(water.velocity).all()
        assert (water.position[:, 0] >= solver.face_position("x_min")[0]).all()
        assert (water.position[:, 0] <= 1.0).all() and (water.position[:, 1] >= 0.0).all()


test_scene_runs_or_is_refused, test_scene_runs_or_is_refused_long = twice(scene_runs_or_is_refused, drawn=wild)


# -- scene files ------------------------------------------------------------------------------------------------------


@st.composite
def damaged(draw, texts):
    """A text with a few places altered, cut out, doubled or swapped."""
    text = draw(st.sampled_from(texts))
    for _ in range(draw(st.integers(1, 4))):
        at, to = sorted(draw(st.tuples(st.integers(0, len(text)), st.integers(0, len(text)))))
        to = min(to, at + 30)
        way = draw(st.sampled_from(["cut", "double", "put", "number"]))
        if way == "cut":
            text = text[:at] + text[to:]
        elif way == "double":
            text = text[:to] + text[at:to] + text[to:]
        elif way == "put":
            text = text[:at] + draw(st.text(max_size=6)) + text[to:]
        else:
            text = text[:at] + str(draw(numbers)) + text[at:]
    return text


def scene_file_is_read_or_refused(text):
    works_or_is_refused(lambda: loads(text))


SCENE_TEXTS = [path.read_text() for path in SCENES]
test_scene_file_is_read_or_refused, test_scene_file_is_read_or_refused_long = twice(
    scene_file_is_read_or_refused, text=st.one_of(damaged(SCENE_TEXTS), st.text(max_size=40))
)


# -- tasks and actions ------------------------------------------------------------------------------------------------

OPTIONS = [
    "dim", "difficulty", "resolution", "obs", "grid", "solid", "stack", "control_interval", "episode", "variation",
    "disturbance", "viscosity", "jitter", "weights", "scheme", "fidelity", "command", "goal", "colour",
]  # fmt: skip


def task_is_posed_or_refused(name, options):
    works_or_is_refused(lambda: make_task(name, **options))


test_task_is_posed_or_refused, test_task_is_posed_or_refused_long = twice(
    task_is_posed_or_refused,
    name=st.sampled_from(sorted(TASKS)),
    options=st.dictionaries(st.sampled_from(OPTIONS), anything, min_size=1, max_size=3),
)

_ENVS = {}


def shared_env():
    """One environment for all examples: a refused action must leave it as it was."""
    if "env" not in _ENVS:
        _ENVS["env"] = FluidEnv("SloshDamp", difficulty="easy", device="cpu")
        _ENVS["env"].reset(seed=0)
        _ENVS["envs"] = FluidVectorEnv(2, "SloshDamp", difficulty="easy", device="cpu")
        _ENVS["envs"].reset(seed=0)
    return _ENVS["env"], _ENVS["envs"]


def action_is_taken_or_refused(action):
    env, envs = shared_env()
    for one in (env, envs):
        taken = works_or_is_refused(lambda one=one: one.step(action))
        if taken is not None:
            assert one.observation_space.contains(taken[0])
            assert np.isfinite(taken[1]).all() and not np.any(taken[2])
            if np.any(taken[3]):
                one.reset()


actions = st.one_of(
    anything,
    st.lists(numbers, min_size=1, max_size=1),
    st.lists(st.lists(numbers, min_size=1, max_size=1), min_size=2, max_size=2),
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=1).map(np.array),
)
test_action_is_taken_or_refused, test_action_is_taken_or_refused_long = twice(
    action_is_taken_or_refused, action=actions
)


def reset_is_made_or_refused(seed, options):
    env, _ = shared_env()
    made = works_or_is_refused(lambda: env.reset(seed=seed, options=options))
    if made is None:
        env.step(np.zeros(1, np.float32))  # it goes on as it was
        env.reset(seed=0)


test_reset_is_made_or_refused, test_reset_is_made_or_refused_long = twice(
    reset_is_made_or_refused,
    seed=anything,
    options=st.one_of(st.none(), st.dictionaries(st.text(max_size=5), anything, max_size=2)),
)


# -- files ------------------------------------------------------------------------------------------------------------


def whole_files(folder):
    """A snapshot and a policy as bytes."""
    state, policy = folder / "state.npz", folder / "policy.npz"
    snapshot.save({"a": np.arange(6.0).reshape(2, 3), "b": np.array([1, 2])}, state)
    layers = [np.ones((2, 3)), np.ones((3, 1))], [np.ones(3), np.ones(1)]
    Policy(*layers, np.zeros(2), np.ones(2), {"task": "x"}).save(policy)
    return {"snapshot": state.read_bytes(), "policy": policy.read_bytes()}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    return folder, whole_files(folder)


places = st.lists(st.tuples(st.integers(0, 10**4), st.integers(0, 255)), min_size=1, max_size=4)


def read_damaged(files, which, cut, changes, foreign):
    folder, whole = files
    raw = bytearray(whole[which] if foreign is None else foreign)
    raw = raw[: max(0, len(raw) - cut)]
    for at, value in changes if raw else ():
        raw[at % len(raw)] = value
    path = folder / f"damaged-{os.getpid()}.npz"
    path.write_bytes(raw)
    if bytes(raw) == whole[which]:
        return
    if which == "snapshot":
        found = works_or_is_refused(lambda: snapshot.load(path))
        # What is read is what was written: bytes that do not matter, such as a date, may differ.
        assert found is None or (found["a"] == np.arange(6.0).reshape(2, 3)).all()
    else:
        works_or_is_refused(lambda: Policy.load(path))


damage = {
    "which": st.sampled_from(["snapshot", "policy"]),
    "cut": st.one_of(st.just(0), st.integers(0, 10**4)),
    "changes": places,
    "foreign": st.one_of(st.none(), st.binary(max_size=64)),
}


@settings(max_examples=100, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(**damage)
def test_damaged_file_is_refused(files, which, cut, changes, foreign):
    read_damaged(files, which, cut, changes, foreign)


@pytest.mark.slow
@settings(max_examples=MANY, deadline=None, suppress_health_check=list(HealthCheck))
@given(**damage)
def test_damaged_file_is_refused_long(files, which, cut, changes, foreign):
    read_damaged(files, which, cut, changes, foreign)
