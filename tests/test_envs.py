"""The environments: Gymnasium's rules, single against vector, seeds, limits, bad input."""

import gc
import itertools
import os
import subprocess
import sys
import warnings
import weakref
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import RecordVideo
from gymnasium.wrappers.vector import NormalizeObservation, RecordEpisodeStatistics

import fluidgym
from fluidgym.envs import TASKS, FluidEnv, FluidVectorEnv, make_task, rewards
from fluidgym.envs.actuators import Drive
from fluidgym.envs.tasks import dam_break_contain
from fluidgym.envs.tasks.dam_break_contain import close_in
from fluidgym.scheme import DEFAULT_SCHEME, FIDELITIES, Scheme
from fluidgym.validation import CASES

IDS = ["fluidgym/DamBreakContain2D-v0", "fluidgym/DamBreakContain3D-v0"]
ID = IDS[0]
SMALL = {"resolution": 8, "device": "cpu"}


def same(a, b) -> bool:
    """Whether two infos or arrays are equal to the last bit, with the same keys and types."""
    if isinstance(a, tuple):
        return isinstance(b, tuple) and all(map(same, a, b))
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, np.ndarray):
        if a.dtype != b.dtype or a.shape != b.shape:
            return False
        return all(map(same, a, b)) if a.dtype == object else bool((a == b).all())
    return type(a) is type(b) and a == b


def roll_out(env, actions, seed):
    """Observations, rewards and infos of an episode."""
    trajectory = [env.reset(seed=seed)]
    for action in actions:
        trajectory.append(env.step(action))
    return trajectory


def actions_for(shape, steps=30, seed=5):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, *shape)).astype(np.float32)


def poison(solver, world):
    """Give one particle of a world a velocity that is not a number."""
    velocity = solver.state.now.velocity.numpy().copy()
    velocity[0, world * solver.capacity + 3] = np.nan
    solver.state.now.velocity.assign(velocity)


# -- Gymnasium's rules -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", IDS)
def test_check_env_finds_nothing(env_id, monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(env_id)
        check_env(env.unwrapped)
        env.close()


def test_make_needs_no_import():
    code = f"import gymnasium; env = gymnasium.make('fluidgym:{ID}', resolution=8); print(env.reset(seed=1)[0].shape)"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    assert "(603,)" in result.stdout


def test_make_vec_gives_the_vector_env():
    envs = gym.make_vec(ID, num_envs=8, **SMALL)
    assert isinstance(envs, FluidVectorEnv)
    assert VectorEnv in FluidVectorEnv.__bases__  # skrl looks only there
    assert envs.num_envs == 8
    assert envs.observation_space.shape == (8, 603)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observation, info = envs.reset(seed=1)
    assert observation in envs.observation_space
    assert info["containment"].shape == (8,)
    assert info["_containment"].all()
    envs.close()
    envs.close()


def test_autoreset_mode_belongs_to_the_instance():
    same_step = FluidVectorEnv(2, autoreset_mode="SameStep", **SMALL)
    next_step = FluidVectorEnv(2, **SMALL)
    assert same_step.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert next_step.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert FluidVectorEnv.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


@pytest.mark.parametrize(
    ("options", "steps"),
    [
        ({"control_interval": 0.5}, 8),
        ({"control_interval": 0.3}, 14),
        ({"episode": 0.3}, 6),
        ({"episode": 0.3, "control_interval": 0.1}, 3),
    ],
)
def test_an_episode_lasts_as_long_whatever_the_control_interval(options, steps):
    single, many = gym.make(ID, **SMALL, **options), gym.make_vec(ID, num_envs=2, **SMALL, **options)
    assert gym.spec(ID).max_episode_steps is None
    single.reset(seed=0)
    many.reset(seed=0)
    for step in range(1, steps + 1):
        observation, _, _, truncated, info = single.step(np.zeros(1, np.float32))
        assert truncated == (step == steps)
        assert (many.step(np.zeros((2, 1), np.float32))[3] == truncated).all()
        assert (observation[-1] == 1.0) == truncated  # the time that is observed ends with the episode, not before
    length = options.get("episode", 4.0)
    assert length - 1e-9 <= info["time"] < length + single.unwrapped.task.control_interval


def test_the_default_episode_has_80_steps():
    for env_id in IDS:
        assert gym.make(env_id, **SMALL).unwrapped.task.max_episode_steps == 80


def test_no_episode_goes_on_past_that_of_the_task():
    single = gym.make(ID, max_episode_steps=9, episode=0.2, **SMALL)
    many = gym.make_vec(ID, num_envs=2, max_episode_steps=9, episode=0.2, **SMALL)
    single.reset(seed=0)
    many.reset(seed=0)
    for step in range(4):
        assert single.step(np.zeros(1, np.float32))[3] == (step == 3)
        assert (many.step(np.zeros((2, 1), np.float32))[3] == (step == 3)).all()


@pytest.mark.parametrize("kind", ["flat", "grid"])
@pytest.mark.parametrize("dim", [2, 3])
def test_observations_are_in_their_space(dim, kind):
    env = FluidEnv(dim=dim, obs=kind, **SMALL)
    grid = env.task.grid
    assert env.observation_space.is_bounded()
    assert env.observation_space.shape == (
        ((1 + dim) * int(np.prod(grid)) + 3,) if kind == "flat" else (1 + dim + 3, *grid)
    )
    for step in roll_out(env, actions_for((1,), steps=12), seed=4):
        assert step[0].dtype == np.float32
        assert step[0] in env.observation_space


def test_both_kinds_of_observation_say_the_same():
    actions = actions_for((1,), steps=3)
    flat = roll_out(FluidEnv(obs="flat", **SMALL), actions, seed=4)
    grid = roll_out(FluidEnv(obs="grid", **SMALL), actions, seed=4)
    for (a, *_), (b, *_) in zip(flat, grid, strict=True):
        assert (a[:-3] == b[:3].ravel()).all()
        assert (a[-3:] == b[3:, 0, 0]).all()
        assert (b[3:] == b[3:, :1, :1]).all()


# -- one world against many --------------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [{"max_episode_steps": 12}, {"episode": 0.6}])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_vector_env_equals_eight_single_envs_bit_for_bit(mode, limit):
    # Twelve steps an episode, so that every world is reset two or three times, two of them out of turn.
    many = gym.make_vec(ID, num_envs=8, autoreset_mode=mode, **limit, **SMALL)
    singles = gym.vector.SyncVectorEnv(
        [lambda: gym.make(ID, disable_env_checker=True, **limit, **SMALL)] * 8, autoreset_mode=mode
    )
    a, b = many.reset(seed=7), singles.reset(seed=7)
    assert same(a[0], b[0])
    assert same(a[1], b[1])
    ended = np.zeros(8, bool)
    for step, actions in enumerate(actions_for((8, 1), steps=34)):
        mask = ended.copy() if mode is AutoresetMode.DISABLED else np.zeros(8, bool)
        if step == 5:
            mask[[1, 6]] = True
        if mask.any():
            options = {"reset_mask": mask}
            a, b = many.reset(options=options), singles.reset(options=dict(options))
            assert same(a[0], b[0])
            assert same({k: v[mask] for k, v in a[1].items()}, {k: v[mask] for k, v in b[1].items()})
            assert "reset_mask" in options
        a, b = many.step(actions), singles.step(actions)
        for mine, theirs in zip(a, b, strict=True):
            assert same(mine, theirs)
        ended = a[2] | a[3]
    many.close()
    singles.close()


def test_vector_env_equals_a_single_env_in_3d():
    actions = actions_for((2, 1), steps=8)
    many = roll_out(FluidVectorEnv(2, dim=3, **SMALL), actions, seed=3)
    single = roll_out(FluidEnv(dim=3, **SMALL), actions[:, 1], seed=4)
    for a, b in zip(many, single, strict=True):
        assert (a[0][1] == b[0]).all()


def test_a_world_does_not_depend_on_how_many_there_are():
    actions = actions_for((5, 1))
    few = roll_out(FluidVectorEnv(2, max_episode_steps=11, **SMALL), actions[:, :2], seed=20)
    many = roll_out(FluidVectorEnv(5, max_episode_steps=11, **SMALL), actions, seed=20)
    for a, b in zip(few, many, strict=True):
        assert (a[0] == b[0][:2]).all()
    assert (many[0][0][0] != many[0][0][2]).any()


def test_threads_change_nothing_but_the_time():
    actions = actions_for((6, 1), steps=6)
    runs = [roll_out(gym.make_vec(ID, num_envs=6, threads=threads, **SMALL), actions, 3) for threads in (1, 2, None)]
    assert all(same(a, b) for other in runs[1:] for a, b in zip(runs[0], other, strict=True))
    env = FluidEnv(threads=1, **SMALL)
    assert env.solver.threads == 1
    with pytest.raises(ValueError, match=r"Solver.threads = 0 .*; use 1 or more"):
        FluidVectorEnv(2, threads=0, **SMALL)


def test_truncation_is_at_the_same_step():
    single = gym.make(ID, max_episode_steps=6, **SMALL)
    many = gym.make_vec(ID, num_envs=2, max_episode_steps=6, **SMALL)
    single.reset(seed=0)
    many.reset(seed=0)
    for step in range(6):
        truncated = single.step(np.zeros(1, np.float32))[3]
        assert truncated == (step == 5)
        assert (many.step(np.zeros((2, 1), np.float32))[3] == truncated).all()


def test_next_step_mode_does_not_use_the_action_of_a_reset():
    envs = FluidVectorEnv(1, max_episode_steps=2, **SMALL)
    envs.reset(seed=0)
    for _ in range(2):
        envs.step(np.ones((1, 1)))
    _, reward, terminated, truncated, info = envs.step(-np.ones((1, 1)))
    assert (reward[0], terminated[0], truncated[0]) == (0.0, False, False)
    assert info["time"][0] == 0.0
    assert info["wall_position"][0] == pytest.approx(dam_break_contain.LENGTH)
    assert info["effort"][0] == 0.0


def test_same_step_mode_hands_on_the_end():
    envs = FluidVectorEnv(3, max_episode_steps=4, autoreset_mode="SameStep", **SMALL)
    envs.reset(seed=0)
    for _ in range(4):
        observation, _, _, truncated, info = envs.step(-np.ones((3, 1)))
    assert truncated.all()
    assert info["_final_obs"].all()
    assert info["final_info"]["time"] == pytest.approx(0.2)
    assert (info["time"] == 0.0).all()
    for world in range(3):
        assert info["final_obs"][world] in envs.single_observation_space
        assert (info["final_obs"][world] != observation[world]).any()
    assert "final_obs" not in envs.step(-np.ones((3, 1)))[4]


def test_disabled_mode_waits_for_a_reset():
    envs = FluidVectorEnv(2, max_episode_steps=2, autoreset_mode="Disabled", **SMALL)
    envs.reset(seed=0)
    for _ in range(2):
        envs.step(np.zeros((2, 1)))
    with pytest.raises(ResetNeeded, match="reset_mask"):
        envs.step(np.zeros((2, 1)))
    envs.reset(options={"reset_mask": np.array([True, True])})
    envs.step(np.zeros((2, 1)))


@pytest.mark.parametrize("make", [FluidEnv, FluidVectorEnv])
def test_nothing_happens_before_the_first_reset(make):
    env = make(render_mode="rgb_array", **SMALL)
    with pytest.raises(ResetNeeded, match=r"step was called before reset; call reset\(\) first"):
        env.step(np.zeros(env.action_space.shape))
    with pytest.raises(ResetNeeded, match=r"render was called before reset; call reset\(\) first"):
        env.render()


@pytest.mark.parametrize("make", [FluidEnv, FluidVectorEnv])
def test_close_frees_the_worlds_and_is_final(make):
    env = make(render_mode="rgb_array", **SMALL)
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape)
    env.step(action)
    left = [weakref.ref(env.solver), weakref.ref(env.solver.state), weakref.ref(env.task)]
    env.close()
    env.close()
    gc.collect()
    assert [one() for one in left] == [None] * 3
    for call in (lambda: env.reset(seed=0), lambda: env.step(action), env.render, lambda: env.solver):
        with pytest.raises(ClosedEnvironmentError, match="was used after close; make a new environment"):
            call()


# -- seeds -------------------------------------------------------------------------------------------------------


def test_same_seed_same_trajectory():
    env, actions = FluidEnv(**SMALL), actions_for((1,), steps=15)
    first, again = roll_out(env, actions, seed=9), roll_out(env, actions, seed=9)
    for a, b in zip(first, again, strict=True):
        assert same(a[0], b[0])
        assert same(a[-1], b[-1])
    assert (roll_out(env, actions, seed=10)[0][0] != first[0][0]).any()


def test_episodes_differ_and_are_keyed_by_seed_and_number():
    a, b = FluidEnv(**SMALL), FluidEnv(**SMALL)
    episodes = [a.reset(seed=1)[0], a.reset()[0], a.reset()[0]]
    assert all((one != other).any() for one, other in itertools.pairwise(episodes))
    b.reset(seed=1)
    b.step(np.ones(1))  # what happens in an episode does not change the next one
    assert (b.reset()[0] == episodes[1]).all()


def test_a_list_of_seeds_gives_each_world_its_own():
    envs = FluidVectorEnv(3, **SMALL)
    listed = envs.reset(seed=[30, 31, 30])[0]
    counted = envs.reset(seed=30)[0]
    assert (listed[:2] == counted[:2]).all()
    assert (listed[2] == listed[0]).all()
    assert (counted[2] != counted[0]).any()
    with pytest.raises(ValueError, match="must be 3 numbers"):
        envs.reset(seed=[1, 2])


@pytest.mark.parametrize("make", [FluidEnv, FluidVectorEnv])
@pytest.mark.parametrize("seed", [1.5, -1, "1", [2.5]])
def test_a_bad_seed_is_refused(make, seed):
    env = make(**SMALL)
    with pytest.raises(ValueError, match=r"^seed = .* must be a whole number of 0 or more"):
        env.reset(seed=seed)


def test_envs_without_a_seed_differ():
    assert (FluidEnv(**SMALL).reset()[0] != FluidEnv(**SMALL).reset()[0]).any()


def test_a_task_keeps_only_so_many_columns():
    task = make_task("DamBreakContain", resolution=30, variation=1.0)
    for seed in range(2 * dam_break_contain.COLUMNS_KEPT):
        task.start(0, np.random.default_rng(seed))
    assert task._column.cache_info().currsize == dam_break_contain.COLUMNS_KEPT


def test_starts_vary_as_much_as_asked():
    task = make_task("DamBreakContain", resolution=20, variation=0.5, jitter=0.05)
    counts = {len(task.start(0, np.random.default_rng(seed))) for seed in range(40)}
    assert min(counts) >= 36 * 18
    assert max(counts) <= 44 * 22
    assert len(counts) > 5
    plain = make_task("DamBreakContain", resolution=20, variation=0.0, jitter=0.0)
    lattice = (plain.start(0, np.random.default_rng(1)).position / plain.spacing - 0.5) % 1.0
    assert np.abs(lattice - np.round(lattice)).max() < 1e-9


# -- fidelity ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("env_id", IDS)
def test_a_fidelity_is_a_scheme_and_a_resolution(env_id, fidelity):
    env = gym.make(env_id, fidelity=fidelity, device="cpu").unwrapped
    dim, task = env.task.scene.dim, env.task
    assert (task.fidelity, task.scheme) == (fidelity, FIDELITIES[fidelity])
    assert task.resolution == task.resolutions[dim][fidelity]
    assert task.spacing == dam_break_contain.HEIGHT / task.resolution
    assert env.solver.scheme == FIDELITIES[fidelity]
    assert env.solver.scene.particle_spacing == task.spacing
    env.close()


@pytest.mark.parametrize("name", TASKS)
def test_every_task_has_a_resolution_for_each_fidelity_and_a_case_that_stands_for_it(name):
    for dim, resolutions in type(make_task(name)).resolutions.items():
        task = make_task(name, dim=dim)
        assert (task.fidelity, task.scheme) == ("balanced", DEFAULT_SCHEME)
        assert list(resolutions) == list(FIDELITIES)
        assert sorted(resolutions.values()) == list(resolutions.values())
        assert dim in CASES[task.gates[dim].case].resolutions


def test_the_gates_of_the_dam_break_have_its_column_and_its_tank():
    """They count particles over the same length, so the scale is 1."""
    for dim in (2, 3):
        task = make_task("DamBreakContain", dim=dim, variation=0.0)
        gate = task.gates[dim]
        case = CASES[gate.case].scene(round(gate.scale * task.resolution), dim)
        over = [scene.particle_spacing for scene in (task.scene, case)]
        columns = [np.ptp(scene.sample().position, axis=0) for scene in (task.scene, case)]
        assert columns[0] / over[0] == pytest.approx(columns[1] / over[1])
        assert task.scene.upper[0] / over[0] == pytest.approx(case.upper[0] / over[1], rel=1e-3)


def test_without_a_fidelity_an_env_is_the_balanced_one_bit_for_bit():
    actions = actions_for((1,), steps=5)
    left_out = roll_out(gym.make(ID, device="cpu"), actions, seed=3)
    usual = dam_break_contain.DamBreakContain.resolutions[2]["balanced"]
    for options in ({"fidelity": "balanced"}, {"scheme": DEFAULT_SCHEME, "resolution": usual}):
        for a, b in zip(left_out, roll_out(gym.make(ID, device="cpu", **options), actions, seed=3), strict=True):
            assert same(a[0], b[0])
            assert same(a[-1], b[-1])


def test_make_vec_takes_a_fidelity_and_is_the_single_env_bit_for_bit():
    actions = actions_for((2, 1), steps=4)
    many = roll_out(gym.make_vec(ID, num_envs=2, fidelity="accurate", **SMALL), actions, seed=3)
    single = roll_out(gym.make(ID, fidelity="accurate", **SMALL), actions[:, 1], seed=4)
    for a, b in zip(many, single, strict=True):
        assert (a[0][1] == b[0]).all()


def test_resolution_and_scheme_stand_in_for_those_of_a_fidelity():
    task = make_task("DamBreakContain", fidelity="fast", resolution=9)
    assert (task.fidelity, task.scheme, task.resolution) == ("fast", FIDELITIES["fast"], 9)
    own = Scheme(courant=0.5)
    task = make_task("DamBreakContain", scheme=own)
    assert (task.fidelity, task.scheme, task.resolution) == (None, own, task.resolutions[2]["balanced"])


# -- the wall ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["velocity", "acceleration"])
def test_wall_stays_within_its_limits_under_bang_bang_actions(command):
    env = FluidEnv(command=command, **SMALL)
    _, info = env.reset(seed=2)
    change = 8.0 * 0.05
    low, high = dam_break_contain.TRAVEL
    stretches = np.concatenate([-np.ones(45), np.ones(38), *[np.full(n, (-1.0) ** n) for n in range(2, 9)]])
    nearest = high
    for action in stretches:
        before = info["wall_velocity"]
        info = env.step([action])[-1]
        position, velocity = info["wall_position"], info["wall_velocity"]
        assert low - 1e-6 <= position <= high + 1e-6  # the device counts in float32
        assert abs(velocity) <= 1.5 + 1e-6
        assert abs(velocity - before) <= change + 1e-5
        room = high - position if velocity > 0 else position - low
        assert velocity**2 / (2 * 8.0) <= room + 1e-5  # it can still stop
        nearest = min(nearest, position - low)
    assert nearest < 1e-3  # and it does get there


def test_wall_keeps_its_limits_from_any_state_it_can_reach():
    wall = Drive((0.0, 1.0), 2.0, 5.0, "acceleration", 0.1)
    rng = np.random.default_rng(0)
    position, velocity = np.full(200, 0.5), np.zeros(200)
    for step in range(300):
        command = np.where(np.arange(200) < 100, rng.uniform(-1, 1, 200), (-1.0) ** (step // 20))
        after = wall.next_velocity(command, position, velocity)
        assert (np.abs(after - velocity) <= 0.5 + 1e-9).all()
        position = position + 0.05 * (velocity + after)
        velocity = after
        assert (position >= -1e-9).all()
        assert (position <= 1.0 + 1e-9).all()


def test_action_outside_its_space_is_clipped():
    actions = actions_for((1,), steps=6)
    wide = roll_out(FluidEnv(**SMALL), 50.0 * np.sign(actions), seed=1)
    unit = roll_out(FluidEnv(**SMALL), np.sign(actions), seed=1)
    assert all((a[0] == b[0]).all() for a, b in zip(wide, unit, strict=True))


# -- the reward --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [2, 3])
def test_closing_in_beats_doing_nothing(dim):
    envs = FluidVectorEnv(2, dim=dim, resolution=12 if dim == 2 else 8, device="cpu")

    def mean_reward(policy):
        _, info = envs.reset(seed=1)
        collected = 0.0
        for _ in range(60):
            _, reward, _, _, info = envs.step(policy(info))
            collected += reward.mean() / 60
        return collected

    idle = mean_reward(lambda info: np.zeros((2, 1), np.float32))
    closed = mean_reward(close_in)
    assert closed > idle + 0.2


def test_reward_is_the_weighted_sum_of_its_parts():
    env = FluidEnv(weights={"effort": 0.5, "spread": 0.0}, **SMALL)
    env.reset(seed=1)
    for action in actions_for((1,), steps=12):
        _, reward, _, _, info = env.step(action)
        assert all(0.0 <= info[name] <= 1.0 for name in ("containment", "effort", "splash", "spread"))
        assert reward == pytest.approx(info["containment"] - 0.5 * info["effort"] - 0.2 * info["splash"])


def test_parts_of_the_reward_reach_both_ends():
    ends = np.array([0.0, 1.0])
    assert (rewards.containment(ends) == ends).all()
    assert (rewards.splash(ends) == ends).all()
    assert (rewards.effort(ends, ends) == ends).all()
    assert (rewards.spread(ends, 2.0) == ends).all()
    weights = {"effort": 0.25, "splash": 0.5}
    assert rewards.total(np.zeros(1), {"effort": np.ones(1), "splash": np.ones(1)}, weights) == rewards.lowest(weights)


def test_info_tells_mass_time_and_wall():
    env = FluidEnv(variation=0.0, **SMALL)
    _, info = env.reset(seed=1)
    assert info["mass"] == pytest.approx(1000.0 * dam_break_contain.WIDTH * dam_break_contain.HEIGHT)
    assert (info["time"], info["wall_velocity"]) == (0.0, 0.0)
    start = info["wall_position"]
    assert start == pytest.approx(dam_break_contain.LENGTH)
    info = env.step([-1.0])[-1]
    assert info["time"] == pytest.approx(0.05)
    assert info["wall_velocity"] == pytest.approx(-0.4)
    assert info["wall_position"] == pytest.approx(start - 0.5 * 0.4 * 0.05, abs=1e-5)
    assert info["diverged"] is False


# -- what goes wrong ---------------------------------------------------------------------------------------------


def test_diverged_world_ends_alone_and_starts_anew():
    envs = FluidVectorEnv(3, **SMALL)
    actions = actions_for((3, 1), steps=6)
    reference = roll_out(FluidVectorEnv(3, **SMALL), actions, seed=1)
    envs.reset(seed=1)
    envs.step(actions[0])
    poison(envs.solver, 1)
    observation, reward, terminated, _, info = envs.step(actions[1])
    assert terminated.tolist() == [False, True, False]
    assert info["diverged"].tolist() == [False, True, False]
    assert observation in envs.observation_space
    assert reward[1] == pytest.approx(-0.35)
    for action, expected in zip(actions[2:], reference[3:], strict=True):
        step = envs.step(action)
        assert (step[0][[0, 2]] == expected[0][[0, 2]]).all()
        assert not step[2].any()


@pytest.mark.parametrize(
    "action", [np.array([np.nan]), np.array([np.inf]), np.zeros(2), 0.5, "left", None, np.zeros((1, 1))]
)
def test_bad_action_is_refused_and_nothing_is_lost(action):
    env, twin = FluidEnv(**SMALL), FluidEnv(**SMALL)
    for one in (env, twin):
        one.reset(seed=1)
        one.step([0.3])
    with pytest.raises(ValueError, match=r"^action\b.*(limit|numbers)") as caught:
        env.step(action)
    assert "\n" not in str(caught.value)
    assert "-1 to 1" in str(caught.value)
    a, b = env.step([-0.3]), twin.step([-0.3])
    assert same(a[0], b[0])
    assert same(a[-1], b[-1])


def test_bad_actions_of_a_vector_env_are_refused_and_named():
    envs = FluidVectorEnv(3, **SMALL)
    before = envs.reset(seed=1)[0]
    with pytest.raises(ValueError, match=r"actions\[1, 0\] = nan is not finite, limit -1 to 1"):
        envs.step(np.array([[0.0], [np.nan], [0.0]]))
    with pytest.raises(ValueError, match=r"actions has shape \(3,\), limit \(3, 1\)"):
        envs.step(np.zeros(3))
    assert (envs.reset(options={"reset_mask": np.array([True, False, False])})[0][1:] == before[1:]).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "Tsunami"}, "task = 'Tsunami' is unknown; use 'DamBreakContain'"),
        ({"taste": 1}, "DamBreakContain has no option 'taste'; use command, max_wall_speed"),
        ({"dim": 4}, "dim = 4 is unknown; use 2 or 3"),
        ({"resolution": 4}, "resolution = 4 particles over the column's height is outside 8 to 512; use 16"),
        ({"obs": "pixels"}, "obs = 'pixels' is unknown; use 'flat', 'grid', 'image'"),
        ({"obs": "image", "dim": 3}, "obs = 'image' is for 2D only; use 'grid' in 3D"),
        ({"stack": 0}, "stack = 0 is outside 1 to 16; use 1"),
        ({"command": "force"}, "command = 'force' is unknown; use 'velocity' or 'acceleration'"),
        ({"grid": (12, 16, 3)}, "must be 2 whole numbers above 0"),
        ({"grid": (48, 64)}, "finer than the particle spacing 0.075 m; use at most"),
        ({"control_interval": -1.0}, "control_interval = -1.0 s is outside 0.005 to 0.5; use 0.05"),
        ({"control_interval": "a"}, "control_interval = 'a' s is outside 0.005 to 0.5; use 0.05"),
        ({"difficulty": "brutal"}, "difficulty = 'brutal' is unknown; use 'easy', 'medium', 'hard'"),
        ({"variation": 1.5}, "variation = 1.5 is outside 0 to 1; use 0.5"),
        ({"viscosity": -1.0}, "viscosity = -1.0 m2/s is outside 0 to 0.1; use 0"),
        ({"disturbance": 2}, "disturbance = 2 is outside 0 to 0.5; use 0"),
        ({"episode": 0.0}, "episode = 0.0 s is outside 0.005 to 3600; use 4"),
        ({"dim": [2]}, "dim = [2] is unknown; use 2 or 3"),
        ({"depth": 1.0}, "depth = 1.0 is for 3D only; leave it out in 2D"),
        ({"dim": 3, "depth": 2.0}, "depth = 2.0 is outside 0.1 to 1; use 0.5"),
        ({"scheme": "fast"}, "scheme = 'fast' is not a Scheme; give fluidgym.Scheme(...)"),
        ({"fidelity": "best"}, "fidelity = 'best' is unknown; use 'fast', 'balanced' or 'accurate'"),
        ({"fidelity": 2}, "fidelity = 2 is unknown; use 'fast', 'balanced' or 'accurate'"),
        ({"fidelity": ["fast"]}, "fidelity = ['fast'] is unknown; use 'fast', 'balanced' or 'accurate'"),
        (
            {"fidelity": "balanced", "scheme": Scheme()},
            "fidelity = 'balanced' has a scheme, and another is given, limit one; leave one out",
        ),
        ({"weights": [0.1]}, "weights = [0.1] is not a mapping; give one, such as {'effort': 0.05"),
        ({"max_wall_speed": 0.0}, "max_wall_speed = 0.0 m/s must be finite and above 0"),
        ({"max_wall_speed": "a"}, "max_wall_speed = 'a' m/s must be finite and above 0"),
        ({"max_wall_acceleration": None}, "max_wall_acceleration = None m/s2 must be finite and above 0"),
        ({"task": "CarryTank", "max_speed": 0.0}, "max_speed = 0.0 m/s must be finite and above 0"),
        ({"task": "DamBreakGate", "max_gate_speed": -1}, "max_gate_speed = -1 m/s must be finite and above 0"),
        ({"task": "SpreadEven", "max_rate": 0.0}, "max_rate = 0 1/s must be greater than 0; give a positive value"),
        ({"task": "SpreadEven", "max_slope": -0.1}, "max_slope = -0.1 is outside 0.01 to 1; use 0.1 to 0.3"),
        ({"weights": {"mess": 1.0}}, "weights has no 'mess'; use effort, splash, spread"),
        ({"device": "tpu"}, "device = 'tpu' is not on this machine"),
        ({"render_mode": "ascii"}, "render_mode = 'ascii' is unknown; use 'human', 'rgb_array' or None"),
    ],
)
@pytest.mark.parametrize("env_class", [FluidEnv, FluidVectorEnv])
def test_bad_options_are_refused_by_name(env_class, options, message):
    with pytest.raises(ValueError) as caught:
        env_class(**{**SMALL, **options})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs = 0 is not a whole number of 1 or more"),
        ({"num_envs": 1.5}, "num_envs = 1.5 is not a whole number of 1 or more"),
        ({"max_episode_steps": 0}, "max_episode_steps = 0 is not a whole number of 1 or more"),
        ({"autoreset_mode": "Sometimes"}, "autoreset_mode = 'Sometimes' is unknown; use 'NextStep'"),
    ],
)
def test_bad_options_of_the_vector_env_are_refused_by_name(options, message):
    with pytest.raises(ValueError) as caught:
        FluidVectorEnv(**{**SMALL, **options})
    assert message in str(caught.value)


@pytest.mark.parametrize("mask", [np.zeros(2, bool), np.ones(3, bool), np.ones(2), [True, False]])
def test_bad_reset_mask_is_refused(mask):
    envs = FluidVectorEnv(2, **SMALL)
    envs.reset(seed=1)
    with pytest.raises(ValueError, match="reset_mask"):
        envs.reset(options={"reset_mask": mask})


def test_packages_have_only_what_they_list():
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        fluidgym.envs.Nothing  # noqa: B018


# -- pictures ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [2, 3])
def test_vector_env_draws_a_frame_of_each_world(dim):
    envs = FluidVectorEnv(2, dim=dim, render_mode="rgb_array", **SMALL)
    envs.reset(seed=1)
    frames = envs.render()
    assert isinstance(frames, tuple)
    assert [(frame.dtype, frame.ndim) for frame in frames] == [(np.dtype(np.uint8), 3)] * 2
    assert (frames[0] != frames[1]).any()
    envs.step(-np.ones((2, 1)))
    assert (envs.render()[0] != frames[0]).any()


def test_a_mosaic_has_a_tile_for_each_world():
    envs = FluidVectorEnv(5, frame_size=(128, 96), render_mode="rgb_array", **SMALL)
    envs.reset(seed=1)
    frames, mosaic = envs.render(), envs.mosaic()
    assert mosaic.shape == (2 * 96, 3 * 128, 3)
    assert (mosaic[96:, 128:256] == frames[4]).all()
    assert (envs.mosaic([4, 0])[:, 128:] == frames[0]).all()
    with pytest.raises(IndexError, match="worlds has 5, which is outside 0 to 4"):
        envs.mosaic([5])
    with pytest.raises(ValueError, match="worlds is empty"):
        envs.mosaic([])


def test_frames_look_as_asked_for():
    frames = {}
    for name, look in {
        "speed": {},
        "pressure": {"colour": "pressure"},
        "overlay": {"overlay": True},
        "small": {"frame_size": (320, 200)},
        "spheres": {"spheres": True},
    }.items():
        env = FluidEnv(render_mode="rgb_array", **SMALL, **look)
        env.reset(seed=1)
        env.step([0.5])
        frames[name] = env.render()
        env.close()
    assert frames["small"].shape == (200, 320, 3)
    assert (frames["speed"] != frames["pressure"]).any()
    assert (frames["speed"] != frames["spheres"]).any()
    assert 0.01 < (frames["speed"] != frames["overlay"]).any(axis=2).mean() < 0.5


@pytest.mark.parametrize("env_class", [FluidEnv, partial(FluidVectorEnv, 2)])
@pytest.mark.parametrize(
    ("look", "message"),
    [
        ({"colour": "taste"}, "colour = 'taste' is unknown; use 'speed', 'pressure', 'density'"),
        ({"camera": (10, 90)}, r"camera = \(10, 90\) is not two angles, .* use \(25, 25\)"),
        ({"spheres": None}, "spheres = None is not a bool; use True or False"),
        ({"overlay": 1}, "overlay = 1 is not a bool; use True or False"),
        ({"frame_size": (640,)}, r"frame_size = \(640,\) is not two whole numbers of 64 to 8192; use \(640, 400\)"),
    ],
)
def test_a_bad_look_is_refused(env_class, look, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        env_class(**SMALL, **look)


def test_nothing_is_drawn_unless_asked_for(monkeypatch):
    import fluidgym.render

    monkeypatch.setattr(fluidgym.render, "draw_frame", lambda *_, **__: pytest.fail("drew"))
    env = FluidEnv(**SMALL)
    env.reset(seed=1)
    env.step([0.0])
    assert env.render() is None
    env.close()
    env.close()


def test_window_shows_the_worlds_side_by_side(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    for env, action in ((FluidEnv, np.zeros(1)), (FluidVectorEnv, np.zeros((1, 1)))):
        env = env(render_mode="human", **SMALL)
        env.reset(seed=1)
        env.step(action)
        assert env.render() is None
        env.close()
        env.close()


def test_record_video_writes_a_film(tmp_path):
    pytest.importorskip("moviepy")
    env = RecordVideo(gym.make(ID, render_mode="rgb_array", max_episode_steps=3, **SMALL), str(tmp_path / "films"))
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.zeros(1, np.float32))
    env.close()
    (film,) = (tmp_path / "films").glob("*.mp4")
    assert film.stat().st_size > 1000


# -- wrappers ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_vector_wrappers_work(mode):
    envs = gym.make_vec(ID, num_envs=2, max_episode_steps=5, autoreset_mode=mode, **SMALL)
    envs = RecordEpisodeStatistics(envs)
    if mode is AutoresetMode.NEXT_STEP:
        envs = NormalizeObservation(envs)
    envs.reset(seed=1)
    lengths = []
    for _ in range(14):
        *_, info = envs.step(np.zeros((2, 1), np.float32))
        if "episode" in info:
            lengths += info["episode"]["l"].tolist()
    assert lengths[:2] == [5] * 2  # Gymnasium 1.2 counts later episodes of the same-step mode one step short
    assert len(lengths) == 4
    envs.close()
