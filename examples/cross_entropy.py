"""Train with nothing but NumPy, by the cross-entropy method: python examples/cross_entropy.py fluidgym/LevelHold2D-v0

Each world plays with a linear policy of its own, drawn around the mean of the best of the last round (Rubinstein 1999;
noise is added to the spread as by Szita & Lorincz 2006). What a policy sees are the numbers beside the grid, and, for
each column of the grid, how much water is in it and how that moves.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
from tqdm import trange

from fluidgym.envs import FluidVectorEnv
from fluidgym.envs.evaluation import VALIDATION, evaluate
from fluidgym.envs.policy import Policy

BEST = 0.2  # share of a round that the next one is drawn around
NOISE = 0.1  # added to the spread in the first round, none in the last


def pooling(envs: FluidVectorEnv) -> np.ndarray:
    """What turns a flat observation into what a policy sees, (observation, seen): sums over all but x."""
    grid, channels = envs.task.grid, 1 + envs.task.dim
    columns, cells = grid[-1], int(np.prod(grid))
    beside = gym.spaces.flatdim(envs.single_observation_space) - channels * cells
    pool = np.zeros((channels * cells + beside, channels * columns + beside))
    for channel in range(channels):
        for cell in range(cells):
            pool[channel * cells + cell, channel * columns + cell % columns] = columns / cells
    pool[channels * cells :, channels * columns :] = np.eye(beside)
    return pool


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("id", nargs="?", default="fluidgym/LevelHold2D-v0", help="(default: fluidgym/LevelHold2D-v0)")
    parser.add_argument("--difficulty", default="easy", help="easy, medium or hard (default: easy)")
    parser.add_argument("--worlds", type=int, default=64, help="policies of a round (default: 64)")
    parser.add_argument("--rounds", type=int, default=30, help="(default: 30)")
    parser.add_argument("--seed", type=int, default=0, help="(default: 0)")
    parser.add_argument("--out", type=Path, default=Path("outputs"), help="folder (default: outputs)")
    parser.add_argument("--episodes", type=int, default=32, help="to validate with (default: 32)")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(chosen.seed)
    options = {**gym.spec(chosen.id).kwargs, "difficulty": chosen.difficulty}
    envs = FluidVectorEnv(chosen.worlds, **options)
    pool, acts = pooling(envs), gym.spaces.flatdim(envs.single_action_space)
    size = (pool.shape[1] + 1) * acts
    mean, spread = np.zeros(size), np.full(size, 0.5)
    with trange(chosen.rounds, desc=chosen.id, unit="round", disable=None) as bar:
        for round_ in bar:
            drawn = mean + spread * rng.standard_normal((chosen.worlds, size))
            drawn[0] = mean
            weights = drawn.reshape(chosen.worlds, pool.shape[1] + 1, acts)
            # Every policy of a round plays the same episode, so that luck does not choose.
            observation, _ = envs.reset(seed=[round_] * chosen.worlds)
            returns = np.zeros(chosen.worlds)
            for _ in range(envs.task.max_episode_steps):
                seen = observation @ pool
                action = np.einsum("ws,wsa->wa", seen, weights[:, :-1]) + weights[:, -1]
                observation, reward, *_ = envs.step(action.astype(np.float32).clip(-1.0, 1.0))
                returns += reward
            best = drawn[np.argsort(returns)[-max(2, round(BEST * chosen.worlds)) :]]
            mean = best.mean(axis=0)
            spread = best.std(axis=0) + NOISE * (1.0 - round_ / chosen.rounds)
            bar.set_postfix_str(f"best {returns.max():.1f}, mean of them all {returns.mean():.1f}")
    envs.close()
    weights = mean.reshape(pool.shape[1] + 1, acts)
    seen = pool.shape[0]
    about = {"task": chosen.id, "difficulty": chosen.difficulty, "seed": chosen.seed, "method": "cross-entropy"}
    policy = Policy([pool @ weights[:-1]], [weights[-1]], np.zeros(seen), np.ones(seen), about)
    path = chosen.out / f"cross-entropy-{chosen.id.split('/')[-1]}.npz"
    policy.save(path)
    for name, controller in {"null": "null", "scripted": "scripted", "cross-entropy": policy}.items():
        print(f"{name}: {evaluate(controller, episodes=chosen.episodes, seeds=VALIDATION, **options)}")
    print(path)


if __name__ == "__main__":
    main()
