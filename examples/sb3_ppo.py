"""Train with Stable-Baselines3: python examples/sb3_ppo.py fluidgym/SloshDamp2D-v0

Wants pip install "fluidgym-sph[sb3]". With --image the policy is a convolutional network that sees pictures.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from fluidgym.envs.evaluation import VALIDATION, evaluate
from fluidgym.envs.sb3 import SB3VecEnv


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("id", nargs="?", default="fluidgym/SloshDamp2D-v0", help="(default: fluidgym/SloshDamp2D-v0)")
    parser.add_argument("--difficulty", default="easy", help="easy, medium or hard (default: easy)")
    parser.add_argument("--worlds", type=int, default=32, help="(default: 32)")
    parser.add_argument("--steps", type=int, default=300_000, help="of all worlds together (default: 300000)")
    parser.add_argument("--image", action="store_true", help="let a convolutional network see pictures")
    parser.add_argument("--seed", type=int, default=0, help="(default: 0)")
    parser.add_argument("--log", type=Path, help="folder for TensorBoard")
    parser.add_argument("--out", type=Path, default=Path("outputs"), help="folder (default: outputs)")
    parser.add_argument("--horizon", type=int, default=64, help="steps of each world between updates (default: 64)")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # the fluid wants the processors
    options = {"difficulty": chosen.difficulty, "obs": "image" if chosen.image else "flat"}
    envs = VecMonitor(SB3VecEnv(chosen.id, chosen.worlds, seed=1000 * chosen.seed, **options))
    envs = VecNormalize(envs, norm_obs=not chosen.image, gamma=0.99)
    model = PPO(
        "CnnPolicy" if chosen.image else "MlpPolicy",
        envs,
        n_steps=chosen.horizon,
        batch_size=chosen.horizon * chosen.worlds // 8,
        n_epochs=8,
        learning_rate=lambda left: 5e-4 * left,
        gamma=0.99,
        policy_kwargs={"log_std_init": -0.5},
        seed=chosen.seed,
        device="cpu",
        tensorboard_log=str(chosen.log) if chosen.log else None,
    )
    model.learn(chosen.steps, progress_bar=False)
    path = chosen.out / f"sb3-{chosen.id.split('/')[-1]}"
    model.save(path)
    envs.save(f"{path}-normalize.pkl")

    def act(observations: np.ndarray) -> np.ndarray:
        return model.predict(envs.normalize_obs(observations), deterministic=True)[0]

    for name, controller in {"null": "null", "scripted": "scripted", "PPO": act}.items():
        print(f"{name}: {evaluate(controller, episodes=16, seeds=VALIDATION, **gym.spec(chosen.id).kwargs, **options)}")
    print(path.with_suffix(".zip"))


if __name__ == "__main__":
    main()
