"""What trainers are handed: the adapter for Stable-Baselines3, policies in files, evaluation on held-out seeds."""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from fluidgym.envs import FluidEnv, FluidVectorEnv
from fluidgym.envs.evaluation import TEST, TRAIN, VALIDATION, evaluate
from fluidgym.envs.policy import Policy
from fluidgym.envs.sb3 import SB3VecEnv

POLICIES = Path(__file__).resolve().parents[1] / "examples" / "policies"
SHORT = {"difficulty": "easy", "episode": 0.6, "device": "cpu"}


def make_policy(seen, acts, seed=0):
    rng = np.random.default_rng(seed)
    sizes = [(seen, 8), (8, acts)]
    weights = [rng.normal(size=size).astype(np.float32) for size in sizes]
    biases = [rng.normal(size=size[1]).astype(np.float32) for size in sizes]
    return Policy(weights, biases, np.zeros(seen, np.float32), np.ones(seen, np.float32), {"task": "fluidgym/Any2D-v0"})


# -- Stable-Baselines3 -------------------------------------------------------------------------------------------


def test_sb3_sees_what_the_vector_env_shows():
    ours = FluidVectorEnv(3, "CarryTank", autoreset_mode="SameStep", **SHORT)
    theirs = SB3VecEnv("fluidgym/CarryTank2D-v0", 3, seed=5, **SHORT)
    np.testing.assert_array_equal(theirs.reset(), ours.reset(seed=5)[0])
    assert theirs.reset_infos[1]["time"] == 0.0
    rng = np.random.default_rng(0)
    for step in range(14):
        action = rng.uniform(-1.0, 1.0, (3, 1)).astype(np.float32)
        observation, reward, terminated, truncated, info = ours.step(action)
        seen, paid, ended, infos = theirs.step(action)
        np.testing.assert_array_equal(seen, observation)
        np.testing.assert_array_equal(paid, reward.astype(np.float32))
        assert (ended == (terminated | truncated)).all()
        assert ended.all() == (step % 6 == 5)
        for world in range(3):
            if ended[world]:
                np.testing.assert_array_equal(infos[world]["terminal_observation"], info["final_obs"][world])
                assert infos[world]["TimeLimit.truncated"] is True
                assert infos[world]["time"] == info["final_info"]["time"][world] == pytest.approx(0.6)
                assert theirs.reset_infos[world]["time"] == 0.0
            else:
                assert infos[world]["distance"] == info["distance"][world]
                assert "terminal_observation" not in infos[world]
    assert theirs.get_attr("num_envs", [0, 2]) == [3, 3]
    assert theirs.env_is_wrapped(VecMonitor) == [False] * 3
    with pytest.raises(ValueError, match="of some worlds is not possible"):
        theirs.set_attr("render_mode", None, [0])
    theirs.close()
    with pytest.raises(ValueError, match="'CartPole-v1' is not of FluidGym"):
        SB3VecEnv("CartPole-v1", 2)


@pytest.mark.parametrize("kind", ["flat", "image"])
def test_sb3_trains(kind):
    envs = VecMonitor(SB3VecEnv("fluidgym/SpreadEven2D-v0", 4, obs=kind, **SHORT))
    if kind == "flat":
        envs = VecNormalize(envs)
    policy = "CnnPolicy" if kind == "image" else "MlpPolicy"
    model = PPO(policy, envs, n_steps=8, batch_size=16, n_epochs=2, device="cpu", seed=0)
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(64)
    assert any((now != was).any() for now, was in zip(model.policy.parameters(), before, strict=True))
    assert model.ep_info_buffer[0]["l"] == 6
    envs.close()


# -- policies in files -------------------------------------------------------------------------------------------


def test_a_policy_comes_back_as_it_was(tmp_path):
    policy = make_policy(5, 2)
    seen = np.random.default_rng(1).normal(size=(7, 5))
    path = tmp_path / "policy.npz"
    policy.save(path)
    again = Policy.load(path)
    np.testing.assert_array_equal(again(seen), policy(seen))
    assert again.about == policy.about
    by_hand = np.tanh(seen @ policy.weights[0] + policy.biases[0]) @ policy.weights[1] + policy.biases[1]
    np.testing.assert_allclose(policy(seen), by_hand.clip(-1.0, 1.0), rtol=1e-5)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "other"])
def test_a_file_that_is_no_policy_is_refused_in_one_line(damage, tmp_path):
    path = tmp_path / "policy.npz"
    make_policy(5, 2).save(path)
    whole = path.read_bytes()
    if damage == "missing":
        path.unlink()
    elif damage == "other":
        np.savez(path, a=np.zeros(3))
    else:
        path.write_bytes(b"" if damage == "empty" else whole[: len(whole) // 2])
    with pytest.raises(ValueError) as caught:
        Policy.load(path)
    assert "give a file that Policy.save wrote" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", sorted(POLICIES.glob("*.npz")), ids=lambda path: path.stem)
def test_policies_that_are_shipped_fit_their_tasks_and_beat_doing_nothing(path):
    policy = Policy.load(path)
    name, dim = path.stem[:-5], int(path.stem[-5])
    options = {"dim": dim, "difficulty": policy.about["difficulty"], "device": "cpu"}
    assert policy.about["task"] == f"fluidgym/{path.stem}"
    scores = [
        evaluate(controller, name, episodes=4, seeds=VALIDATION, **options).mean for controller in ("null", policy)
    ]
    assert scores[1] > scores[0]


def test_layers_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="do not fit layers of"):
        Policy([np.zeros((4, 2))], [np.zeros(2)], np.zeros(5), np.ones(5))


# -- evaluation --------------------------------------------------------------------------------------------------


def test_bands_of_seeds_have_none_in_common():
    bands = sorted((TRAIN, VALIDATION, TEST), key=lambda band: band[0])
    assert all(band.step == 1 and len(band) >= 10_000_000 for band in bands)
    assert all(a[-1] < b[0] for a, b in pairwise(bands))


def test_a_score_is_the_return_of_episodes_played_one_by_one():
    env = FluidEnv("SloshDamp", **SHORT)
    policy = make_policy(int(np.prod(env.observation_space.shape)), 1)
    score = evaluate(policy, "SloshDamp", episodes=3, seeds=TEST, **SHORT)
    returns = []
    for seed in TEST[:3]:
        observation, _ = env.reset(seed=seed)
        total, ended = 0.0, False
        while not ended:
            observation, reward, terminated, truncated, _ = env.step(policy(observation[None])[0])
            total, ended = total + reward, terminated or truncated
        returns.append(total)
    np.testing.assert_allclose(score.returns, returns, rtol=1e-5)
    assert score.lengths.tolist() == [6] * 3
    assert score.diverged == 0
    assert score.mean == pytest.approx(np.mean(returns), rel=1e-5)
    assert set(score.parts) == {"calm", "effort"}


def test_evaluation_refuses_what_does_not_fit():
    with pytest.raises(ValueError, match="controller = 'best' is unknown; use 'null', 'scripted' or a Policy"):
        evaluate("best", "SloshDamp", **SHORT)
    with pytest.raises(ValueError, match=r"Policy sees 5 numbers and gives 2, the task has .* and"):
        evaluate(make_policy(5, 2), "SloshDamp", **SHORT)
    with pytest.raises(ValueError, match="episodes = 0 is outside 1 to"):
        evaluate("null", "SloshDamp", episodes=0, **SHORT)


# -- tensors -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("options", [{}, {"obs": "grid", "solid": True, "stack": 2}])
def test_tensors_are_what_the_arrays_are(mode, options):
    both = [
        FluidVectorEnv(3, "DamBreakGate", autoreset_mode=mode, output=output, **options, **SHORT)
        for output in ("numpy", "torch")
    ]
    arrays, tensors = both
    (a, _), (b, _) = (envs.reset(seed=5) for envs in both)
    kept, first = b.clone(), b
    np.testing.assert_array_equal(b.numpy(), a)
    rng = np.random.default_rng(0)
    for step in range(14):
        action = rng.uniform(-1.0, 1.0, (3, 1)).astype(np.float32)
        mine, theirs = arrays.step(action), tensors.step(torch.as_tensor(action))
        for array, tensor in zip(mine[:4], theirs[:4], strict=True):
            assert isinstance(tensor, torch.Tensor)
            np.testing.assert_array_equal(tensor.numpy(), array.astype(tensor.numpy().dtype))
        if mode == "SameStep" and step % 6 == 5:
            np.testing.assert_array_equal(theirs[4]["final_obs"][1].numpy(), mine[4]["final_obs"][1])
    assert torch.equal(first, kept)  # no buffer that is written again
    state = tensors.get_state(0)
    arrays.set_state(2, state)
    tensors.set_state(1, state)
    action = np.full((3, 1), -0.5, np.float32)
    np.testing.assert_array_equal(tensors.step(action)[0][1].numpy(), arrays.step(action)[0][2])


def test_tensors_that_cannot_be_are_refused(monkeypatch):
    with pytest.raises(ValueError, match="output = 'jax' is unknown; use 'numpy' or 'torch'"):
        FluidVectorEnv(2, output="jax")
    with pytest.raises(ValueError, match="output = 'torch' has no images"):
        FluidVectorEnv(2, output="torch", obs="image")
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ValueError, match="output = 'torch' wants PyTorch, which is not installed"):
        FluidVectorEnv(2, output="torch")
