"""Every task: Gymnasium's checks, limits, what it is worth, and the physics that its controllers count on."""

import math
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers.vector import DictInfoToList

import fluidgym
from fluidgym.envs import TASKS, FluidEnv, FluidVectorEnv, make_task, rewards
from fluidgym.envs.tasks import carry_tank, jet_fill, level_hold, slosh_damp

NEW = [spec for spec in gym.registry if spec.startswith("fluidgym/") and "Contain" not in spec]
IDS_2D = [spec for spec in NEW if "2D" in spec]


def easy(env_id, worlds, **options):
    """Some worlds of a task at its easy level."""
    return gym.make_vec(env_id, num_envs=worlds, difficulty="easy", device="cpu", **options)


def mean_returns(envs, policy, seed=100, steps=None):
    """Return of one episode in each world."""
    envs.reset(seed=seed)
    task = envs.task
    total = np.zeros(envs.num_envs)
    for _ in range(steps or task.max_episode_steps):
        total += envs.step(np.asarray(policy(task), np.float32))[1]
    return total


def test_ids_are_the_tasks_in_their_dimensions():
    assert {spec.split("/")[1][:-5] for spec in gym.registry if spec.startswith("fluidgym/")} == set(TASKS)
    for spec in NEW:
        assert make_task(spec.split("/")[1][:-5], dim=int(spec[-5])).dim == int(spec[-5])


@pytest.mark.parametrize("env_id", NEW)
def test_check_env_finds_nothing(env_id):
    env = gym.make(env_id, difficulty="easy", episode=0.3, disturbance=0.02, viscosity=1e-3, device="cpu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("env_id", NEW)
def test_a_world_is_the_same_alone_and_among_others(env_id):
    options = {"difficulty": "easy", "episode": 0.4, "disturbance": 0.05, "viscosity": 1e-3, "device": "cpu"}
    single, many = gym.make(env_id, **options), gym.make_vec(env_id, num_envs=3, **options)
    many.reset(seed=3)
    a, _ = single.reset(seed=4)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (9, 3, *single.action_space.shape)).astype(np.float32)
    for action in actions:
        b, b_reward, _, b_truncated, b_info = many.step(action)
        a, a_reward, _, a_truncated, a_info = single.step(action[1])
        np.testing.assert_array_equal(a, b[1])
        assert a_reward == b_reward[1]
        assert a_truncated == b_truncated[1]
        for name, value in a_info.items():
            assert value == b_info[name][1], name
        if a_truncated:
            break
    assert a_truncated


@pytest.mark.parametrize("env_id", IDS_2D)
def test_the_scripted_controller_beats_doing_nothing(env_id):
    envs = easy(env_id, 4)
    idle, scripted = (mean_returns(envs, policy) for policy in (lambda task: task.null(), lambda task: task.scripted()))
    assert scripted.mean() > idle.mean() + 0.5 * (scripted.std() + idle.std()) / math.sqrt(4)
    for values in envs.task.parts().values():
        assert ((values >= 0.0) & (values <= 1.0)).all()


@pytest.mark.parametrize("name", ["CarryTank", "SloshDamp", "SpreadEven", "DamBreakContain", "DamBreakGate"])
def test_the_scripted_controller_may_command_accelerations_as_well(name):
    envs = FluidVectorEnv(2, name, difficulty="easy", command="acceleration", device="cpu")
    idle, scripted = (mean_returns(envs, policy) for policy in (lambda task: task.null(), lambda task: task.scripted()))
    assert (scripted > idle).all()


@pytest.mark.parametrize("env_id", [spec for spec in NEW if "3D" in spec])
def test_the_scripted_controller_beats_doing_nothing_in_3d(env_id):
    envs = easy(env_id, 1)
    idle, scripted = (
        mean_returns(envs, policy, steps=30) for policy in (lambda task: task.null(), lambda task: task.scripted())
    )
    assert scripted.mean() > idle.mean()


@pytest.mark.parametrize("env_id", NEW)
def test_the_wildest_actions_stay_in_the_spaces_and_break_nothing(env_id):
    envs = easy(env_id, 2, disturbance=0.1)
    envs.reset(seed=1)
    rng = np.random.default_rng(2)
    for step in range(40 if "2D" in env_id else 12):
        action = np.sign(rng.uniform(-1.0, 1.0, envs.action_space.shape)) if step % 2 else (-1.0) ** (step // 6)
        action = np.broadcast_to(action, envs.action_space.shape).astype(np.float32)
        observation, reward, terminated, _, info = envs.step(action)
        assert observation in envs.observation_space
        assert np.isfinite(reward).all()
        assert (reward <= 1.0).all()
        assert (reward >= rewards.lowest(envs.task.weights)).all()
        assert not terminated.any()
        assert not info["diverged"].any()


@pytest.mark.parametrize("name", TASKS)
def test_difficulties_differ_in_what_they_say(name):
    levels = [make_task(name, difficulty=difficulty) for difficulty in ("easy", "medium", "hard")]
    spacings = [task.spacing for task in levels]
    assert spacings == sorted(spacings, reverse=True)
    assert spacings[0] > spacings[2]
    assert levels[0].variation < levels[1].variation < levels[2].variation
    assert levels[0].disturbance <= levels[1].disturbance <= levels[2].disturbance
    assert levels[2].disturbance > 0.0
    assert (levels[0].viscosity, levels[2].viscosity > 0.0) == (0.0, True)
    own = make_task(name, difficulty="hard", resolution=12, variation=0.0, disturbance=0.0, viscosity=0.0)
    assert (own.resolution, own.variation, own.disturbance, own.viscosity) == (12, 0.0, 0.0, 0.0)


def test_every_episode_has_a_ground_and_a_viscosity_of_its_own():
    envs = easy("fluidgym/CarryTank2D-v0", 3, disturbance=0.1, viscosity=1e-2)
    envs.reset(seed=1)
    task = envs.task
    shaking, viscosity = task._shaking.copy(), task._viscosities.copy()
    assert len({*viscosity}) == 3
    assert (viscosity <= 1e-2).all()
    np.testing.assert_array_equal(envs.solver.parameter("viscosity"), viscosity)
    assert np.abs(shaking).max() <= 0.1 * 9.81
    assert len({*np.abs(shaking).max(axis=1)}) == 3
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    assert (task._viscosities != viscosity).tolist() == [False, True, False]
    envs.step(np.zeros((3, 1), np.float32))
    np.testing.assert_allclose(envs.solver.gravity[:, 0], -task._shaking[:, 0])


# -- what is seen ------------------------------------------------------------------------------------------------


def test_an_image_shows_the_grid():
    options = {"difficulty": "easy", "jitter": 0.0, "device": "cpu"}
    image, grid = (FluidEnv("CarryTank", obs=kind, **options) for kind in ("image", "grid"))
    pixels, channels = image.reset(seed=1)[0], grid.reset(seed=1)[0]
    assert pixels.dtype == np.uint8
    assert min(pixels.shape[:2]) >= 40
    assert pixels.shape[2] == len(channels) == 3 + 4
    zoom = pixels.shape[0] // channels.shape[1]
    assert pixels.shape[:2] == (zoom * channels.shape[1], zoom * channels.shape[2])
    np.testing.assert_array_equal(pixels[::-zoom, ::zoom, 0], np.round(255.0 * channels[0].clip(0.0, 1.0)))
    assert (pixels[..., 1] == 128).all()  # at rest
    assert pixels[-1, 0, 0] == 255  # water below
    assert pixels[0, 0, 0] == 0  # none above


def test_solids_are_seen_where_they_are():
    env = FluidEnv("DamBreakGate", difficulty="easy", obs="grid", solid=True, device="cpu")
    observation, _ = env.reset(seed=1)
    assert observation in env.observation_space
    ny, nx = env.task.grid
    gate = observation[3]
    size = np.divide(env.solver.scene.upper, (nx, ny))
    assert gate.sum() * size.prod() == pytest.approx(0.05 * (1.5 - 0.3), rel=1e-5)
    assert set(np.flatnonzero(gate.any(axis=0))) == {int(1.8 / size[0])}
    for _ in range(20):
        observation = env.step([-1.0])[0]
    assert observation[3].sum() * size.prod() == pytest.approx(0.05 * 1.5, rel=1e-4)
    wall = FluidEnv("DamBreakContain", difficulty="easy", obs="grid", solid=True, device="cpu")
    assert not wall.reset(seed=1)[0][3].any()
    for _ in range(20):
        observation, _, _, _, info = wall.step([-1.0])
    beyond = (wall.solver.scene.upper[0] - info["wall_position"]) * wall.solver.scene.upper[1]
    size = np.divide(wall.solver.scene.upper, wall.task.grid[::-1])
    assert observation[3].sum() * size.prod() == pytest.approx(beyond, rel=1e-4)


@pytest.mark.parametrize("kind", ["flat", "grid", "image"])
def test_frames_are_stacked_and_begin_anew(kind):
    options = {"difficulty": "easy", "episode": 0.2, "obs": kind, "device": "cpu"}
    plain, stacked = (FluidVectorEnv(2, "SpreadEven", **options, stack=stack) for stack in (1, 3))
    axis = -1 if kind == "image" else 1
    seen = [plain.reset(seed=1)[0]] * 3
    np.testing.assert_array_equal(stacked.reset(seed=1)[0], np.concatenate(seen, axis=axis))
    for step in range(7):
        if step == 2:
            mask = {"reset_mask": np.array([True, False])}
            first = plain.reset(options=mask)[0]
            seen = [np.where(np.array([True, False]).reshape(2, *[1] * (first.ndim - 1)), first, one) for one in seen]
            np.testing.assert_array_equal(stacked.reset(options=mask)[0], np.concatenate(seen, axis=axis))
        action = np.full((2, 1), (-1.0) ** step, np.float32)
        was_over = plain._ended.copy()
        frame, other = plain.step(action)[0], stacked.step(action)[0]
        seen = [*seen[1:], frame]
        over = was_over.reshape(2, *[1] * (frame.ndim - 1))
        seen = [np.where(over, frame, one) for one in seen]
        np.testing.assert_array_equal(other, np.concatenate(seen, axis=axis))
        assert other in stacked.observation_space


# -- states ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", NEW)
def test_a_world_goes_on_from_its_state_bit_for_bit(env_id):
    options = {"disturbance": 0.05, "viscosity": 1e-3, "stack": 2, "episode": 1.0}
    envs = easy(env_id, 3, **options)
    envs.reset(seed=3)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (9, 3, *envs.single_action_space.shape)).astype(np.float32)
    for action in actions[:5]:
        envs.step(action)
    state = envs.get_state(1)
    first = [envs.step(action) for action in actions[5:]]
    other = gym.make(env_id, difficulty="easy", device="cpu", **options).unwrapped
    other.reset(seed=77)
    other.step(actions[0][0])
    other.set_state(state)
    envs.reset(seed=50)
    envs.step(actions[0])
    envs.set_state(2, state)
    for action, step in zip(actions[5:], first, strict=True):
        again, alone = envs.step(np.broadcast_to(action[1], action.shape)), other.step(action[1])
        np.testing.assert_array_equal(again[0][2], step[0][1])
        np.testing.assert_array_equal(alone[0], step[0][1])
        assert again[1][2] == alone[1] == step[1][1]
        for name, value in alone[4].items():
            assert value == step[4][name][1] == again[4][name][2], name


def test_a_state_of_another_task_is_refused_and_nothing_is_lost():
    carry, slosh = (FluidEnv(name, difficulty="easy", device="cpu") for name in ("CarryTank", "SloshDamp"))
    carry.reset(seed=1)
    slosh.reset(seed=1)
    before = carry.get_state()
    with pytest.raises(ValueError, match=r"state '.*' has shape .*; give what get_state gave, of the same task"):
        carry.set_state(slosh.get_state())
    with pytest.raises(ValueError, match=r"state 'task.place' has shape None"):
        carry.set_state({name: value for name, value in before.items() if name != "task.place"})
    for name, value in carry.get_state().items():
        np.testing.assert_array_equal(value, before[name])
    with pytest.raises(IndexError, match="world = 3 is outside 0 to 0"):
        carry.solver.save_world(3)


# -- what the tasks are about ------------------------------------------------------------------------------------


def test_parts_reach_both_ends():
    assert rewards.spill(np.array([0.0, 0.1, 0.5])).tolist() == [0.0, 1.0, 1.0]
    assert rewards.unrest(np.array([0.0, 0.125, 9.0]), 1.0).tolist() == [0.0, 1.0, 1.0]
    assert rewards.unrest(np.array([0.125]), 2.0)[0] == pytest.approx(0.5)
    assert rewards.evenness(np.array([[1.0, 1.0, 1.0, 1.0], [4.0, 0.0, 0.0, 0.0]])).tolist() == [1.0, 0.0]
    assert rewards.evenness(np.array([[2.0, 2.0, 0.0, 0.0]]))[0] == pytest.approx(1.0 / 3.0)


def test_a_tank_that_is_carried_sloshes_at_its_first_frequency():
    env = FluidEnv(
        "CarryTank", resolution=16, jitter=0.0, variation=0.0, episode=4.0, max_acceleration=1.0, device="cpu"
    )
    env.reset(seed=0)
    env.step([1.0])
    off, times = [], []
    for _ in range(70):
        info = env.step([1.0 if env.task.velocity[0, 0] < 0.05 else 0.0])[-1]
        off.append(env.task.fluid["middle"][0, 0])
        times.append(info["time"])
    off = np.asarray(off)[15:] - np.mean(off[15:])
    crossings = np.asarray(times)[15:][1:][(off[1:] > 0) != (off[:-1] > 0)]
    assert 2.0 * np.diff(crossings).mean() == pytest.approx(carry_tank.PERIOD, rel=0.08)


def test_a_tank_that_is_carried_feels_what_it_is_told_and_arrives():
    env = FluidEnv("CarryTank", difficulty="easy", variation=0.0, device="cpu")
    env.reset(seed=0)
    task = env.task
    place = speed = 0.0
    for _ in range(task.max_episode_steps):
        info = env.step(task.scripted()[0])[-1]
        before, speed = speed, float(task.velocity[0, 0])
        place += 0.5 * (before + speed) * task.control_interval
        assert env.solver.gravity[0, 0] == pytest.approx(-(speed - before) / task.control_interval)
    assert place == pytest.approx(2.0, abs=0.02)
    assert info["distance"] == pytest.approx(2.0 - place, abs=1e-9)
    assert info["lost"] == 0.0
    assert info["unrest"] < 0.1


def test_water_over_the_rim_is_lost_and_costs():
    env = FluidEnv("CarryTank", difficulty="easy", max_acceleration=20.0, device="cpu")
    env.reset(seed=0)
    mass = env.task.fluid["live"][0]
    for step in range(40):
        info = env.step([1.0 if step % 10 < 5 else -1.0])[-1]
    assert info["lost"] == pytest.approx(1.0 - env.task.fluid["live"][0] / mass)
    assert info["lost"] > 0.05
    assert info["spill"] == pytest.approx(min(10.0 * info["lost"], 1.0))


def test_a_shaken_tank_sloshes_most_near_its_first_frequency():
    reached = []
    for factor in (0.5, 1.0, 1.6):
        env = FluidEnv("SloshDamp", difficulty="easy", variation=0.0, device="cpu")
        env.reset(seed=0)
        times = env.task.control_interval * np.arange(env.task.max_episode_steps)
        env.task._shaking[0] = 0.03 * 9.81 * np.sin(2.0 * math.pi * factor * slosh_damp.FREQUENCY * times)
        kinetic = []
        for _ in range(80):
            env.step([0.0])
            kinetic.append(env.task.fluid["kinetic"][0])
        reached.append(max(kinetic))
    assert reached[1] > 4.0 * max(reached[0], reached[2])


def test_a_jet_follows_the_path_of_a_bullet():
    env = FluidEnv("JetFill", resolution=20, variation=0.0, device="cpu")
    env.reset(seed=0)
    for _ in range(14):  # what came out while the valve opened has fallen by then
        env.step([0.36, 0.0])
    x = env.solver.particles().position
    front = (x[:, 0] > 0.3) & (x[:, 0] < 0.7)
    end = jet_fill.NOZZLE[0] + 5.0 * env.task.spacing
    u = env.task.speed[0]
    path = jet_fill.NOZZLE[1] - 9.81 * (x[front, 0] - end) ** 2 / (2.0 * u**2)
    assert u == pytest.approx(3.0)
    assert front.sum() > 40
    assert np.abs(x[front, 1] - path).max() < 0.5 * jet_fill.JET + env.task.spacing


def test_a_jet_that_is_off_makes_nothing_and_every_particle_is_accounted_for():
    envs = FluidVectorEnv(2, "JetFill", difficulty="easy", device="cpu")
    envs.reset(seed=0)
    start = envs.task.fluid["live"].copy()
    for step in range(60):
        envs.step(np.array([[jet_fill.SHUT, 0.0], [1.0, 0.3 * (-1.0) ** (step // 7)]], np.float32))
    task = envs.task
    assert task.fluid["live"][0] == start[0]
    emitted = envs.solver.state.ledger.emitted.numpy()
    np.testing.assert_array_equal(task.gone(), start + emitted - task.fluid["live"])
    assert task.gone()[1] > 0


def test_what_a_jet_spills_is_paid_once():
    env = FluidEnv("JetFill", difficulty="easy", device="cpu")
    env.reset(seed=0)
    task, spilt = env.task, 0.0
    for step in range(39):
        spilt += env.step([-0.2, 0.3 * (-1.0) ** (step // 7)])[-1]["spill"]
    fastest = jet_fill.JET * jet_fill.FASTEST * task.control_interval / task.spacing**2
    assert task.gone()[0] > 20
    assert spilt * fastest == pytest.approx(task.gone()[0])


def test_a_leak_drains_at_the_speed_of_torricelli():
    env = FluidEnv("LevelHold", resolution=24, variation=0.0, jitter=0.0, control_interval=0.02, device="cpu")
    env.reset(seed=0)
    task, ratios = env.task, []
    for step in range(20):
        before = task.level()[0]
        env.step([-1.0])
        if step >= 10:  # the jet has formed
            leaving = env.solver.particles()
            below = leaving.position[:, 1] < 0.09
            height = level_hold.FLOOR + task.level()[0] - leaving.position[below, 1]
            ratios.append(np.mean(-leaving.velocity[below, 1] / np.sqrt(2.0 * 9.81 * height)))
            flow = (before - task.level()[0]) * level_hold.LENGTH / 0.02
            assert 0.5 < flow / (task.slot * math.sqrt(2.0 * 9.81 * before)) < 1.0  # contracted
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_the_wavemaker_sends_three_waves_and_rests():
    env = FluidEnv("WaveAbsorb", difficulty="easy", device="cpu")
    env.reset(seed=0)
    making = env.task._making[0]
    assert making[:40].any()
    assert not making[int(4.9 / 0.05) :].any()
    assert abs(making.sum()) < 1e-9  # it ends where it began
    assert np.abs(making).max() <= env.task._top * 1.2


def test_packages_have_what_they_list():
    assert set(TASKS) == set(fluidgym._TASKS)


def test_infos_become_a_dict_for_each_world():
    envs = DictInfoToList(easy("fluidgym/CarryTank2D-v0", 2, episode=0.1, autoreset_mode="SameStep"))
    _, infos = envs.reset(seed=1)
    assert [info["time"] for info in infos] == [0.0, 0.0]
    for _ in range(2):
        *_, infos = envs.step(np.zeros((2, 1), np.float32))
    assert len(infos) == 2
    assert infos[1]["final_info"]["time"] == pytest.approx(0.1)
    assert infos[1]["final_obs"].shape == envs.single_observation_space.shape
