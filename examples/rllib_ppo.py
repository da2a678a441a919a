"""Train with RLlib on one machine or many: python examples/rllib_ppo.py fluidgym/SloshDamp2D-v0 --runners 2

Wants pip install "fluidgym-sph[rllib]" in an environment of its own, as Ray holds Gymnasium at an older release. Each
runner is a process with a batch of worlds of its own, made through the registered vector entry point. On many machines,
start Ray on each (`ray start --head`, then `ray start --address HEAD:6379` on the others, FluidGym installed on all),
and run this on the head with `--address auto --runners N`.
"""
# pyright: reportMissingImports=false

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
import ray
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from tqdm import trange

from fluidgym.envs.evaluation import VALIDATION, evaluate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("id", nargs="?", default="fluidgym/SloshDamp2D-v0", help="(default: fluidgym/SloshDamp2D-v0)")
    parser.add_argument("--difficulty", default="easy", help="easy, medium or hard (default: easy)")
    parser.add_argument("--runners", type=int, default=2, help="processes that play (default: 2)")
    parser.add_argument("--worlds", type=int, default=16, help="of each runner (default: 16)")
    parser.add_argument("--updates", type=int, default=100, help="(default: 100)")
    parser.add_argument("--horizon", type=int, default=64, help="steps of each world between updates (default: 64)")
    parser.add_argument("--address", help="of a Ray cluster, such as auto; one is started here if not given")
    parser.add_argument("--device", default="cpu", help="of the fluid (default: cpu)")
    parser.add_argument("--out", type=Path, default=Path("outputs"), help="folder (default: outputs)")
    parser.add_argument("--episodes", type=int, default=32, help="to validate with (default: 32)")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    ray.init(address=chosen.address, num_cpus=None if chosen.address else chosen.runners + 1, include_dashboard=False)
    batch = chosen.runners * chosen.worlds * chosen.horizon
    config = (
        PPOConfig()
        .environment(
            f"fluidgym:{chosen.id}",
            env_config={"difficulty": chosen.difficulty, "device": chosen.device, "threads": 1},
        )
        .env_runners(
            num_env_runners=chosen.runners,
            num_envs_per_env_runner=chosen.worlds,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=chosen.horizon,
        )
        .training(
            train_batch_size_per_learner=batch,
            minibatch_size=max(batch // 8, 1),
            num_epochs=8,
            lr=3e-4,
            gamma=0.99,
            lambda_=0.95,
            grad_clip=0.5,
            vf_clip_param=float("inf"),
        )
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[64, 64], fcnet_activation="tanh"))
    )
    algorithm = config.build_algo()
    with trange(chosen.updates, desc=chosen.id, unit="update", disable=None) as bar:
        for _ in bar:
            found = algorithm.train()["env_runners"]
            bar.set_postfix_str(f"return {found.get('episode_return_mean', float('nan')):.1f}")
    path = algorithm.save_to_path(str((chosen.out / f"rllib-{chosen.id.split('/')[-1]}").absolute()))

    # The mean action, on seeds that nobody trains on.
    module = algorithm.get_module()
    acts = gym.spaces.flatdim(gym.make(chosen.id, difficulty=chosen.difficulty).action_space)

    def act(observations: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            out = module.forward_inference({Columns.OBS: torch.as_tensor(observations)})
        return out[Columns.ACTION_DIST_INPUTS][:, :acts].clamp(-1.0, 1.0).numpy()

    options = {**gym.spec(chosen.id).kwargs, "difficulty": chosen.difficulty, "device": chosen.device}
    for name, controller in {"null": "null", "scripted": "scripted", "RLlib": act}.items():
        print(f"{name}: {evaluate(controller, episodes=chosen.episodes, seeds=VALIDATION, **options)}")
    print(path)
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
