"""Many worlds in one batch, each with a start of its own: python examples/many_worlds.py

Reports how many environment steps a second it makes, and what a controller earns: one that acts at random, one that
leaves the wall still, or the scripted one that closes in.
"""

import argparse
import time

import gymnasium as gym
import numpy as np
from tqdm import trange

from fluidgym.envs.tasks.dam_break_contain import close_in


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2, help="2D or 3D (default: 2)")
    parser.add_argument("--resolution", type=int, help="particles over the column's height (default: the task's own)")
    parser.add_argument("--worlds", type=int, default=8, help="worlds in the batch (default: 8)")
    parser.add_argument("--steps", type=int, default=80, help="actions in each world (default: 80, an episode)")
    parser.add_argument("--policy", choices=("random", "still", "close-in"), default="random", help="(default: random)")
    parser.add_argument("--device", default=None, help="cpu, cuda, ... (default: a GPU where there is one)")
    arguments = parser.parse_args()
    if arguments.worlds < 1 or arguments.steps < 1:
        parser.exit(2, "many_worlds.py: --worlds and --steps must be 1 or more\n")
    try:
        envs = gym.make_vec(
            f"fluidgym:fluidgym/DamBreakContain{arguments.dim}D-v0",
            num_envs=arguments.worlds,
            resolution=arguments.resolution,
            device=arguments.device,
        )
    except ValueError as error:  # one line that names the option and the remedy
        parser.exit(2, f"many_worlds.py: {error}\n")
    policies = {
        "random": lambda info: envs.action_space.sample(),
        "still": lambda info: np.zeros((arguments.worlds, 1), np.float32),
        "close-in": close_in,
    }
    act = policies[arguments.policy]
    envs.action_space.seed(0)
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())  # compiles what is left to compile

    observation, info = envs.reset(seed=0)
    rewards = np.zeros(arguments.worlds)
    begin = time.perf_counter()
    for _ in trange(arguments.steps, desc="many worlds", unit="step"):
        observation, reward, _, _, info = envs.step(act(info))
        rewards += reward / arguments.steps
    elapsed = time.perf_counter() - begin
    print(f"observations {observation.shape}, {arguments.worlds * arguments.steps / elapsed:.0f} env steps/s")
    print(f"mean reward of the controller {arguments.policy!r}: {rewards.mean():.3f} +- {rewards.std():.3f}")
    assert np.isfinite(observation).all()
    assert len(set(rewards)) == arguments.worlds  # no two worlds are the same
    envs.close()


if __name__ == "__main__":
    main()
