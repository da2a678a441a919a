"""Many worlds in one batch, each with a start and actions of its own: python examples/many_worlds.py"""

import argparse
import time

import gymnasium as gym
import numpy as np
from tqdm import trange


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=16, help="worlds in the batch (default: 16)")
    parser.add_argument("--steps", type=int, default=40, help="actions in each world (default: 40)")
    parser.add_argument("--device", default=None, help="cpu, cuda, ... (default: a GPU where there is one)")
    arguments = parser.parse_args()
    if arguments.worlds < 1 or arguments.steps < 1:
        parser.exit(2, "many_worlds.py: --worlds and --steps must be 1 or more\n")
    try:
        envs = gym.make_vec(
            "fluidgym:fluidgym/DamBreakContain2D-v0", num_envs=arguments.worlds, resolution=12, device=arguments.device
        )
    except ValueError as error:  # one line that names the option and the remedy
        parser.exit(2, f"many_worlds.py: {error}\n")
    envs.reset(seed=0)
    envs.action_space.seed(0)
    envs.step(envs.action_space.sample())  # compiles what is left to compile

    observation, _ = envs.reset(seed=0)
    returns = np.zeros(arguments.worlds)
    begin = time.perf_counter()
    for _ in trange(arguments.steps, desc="many worlds", unit="step"):
        observation, reward, _, _, _ = envs.step(envs.action_space.sample())
        returns += reward
    elapsed = time.perf_counter() - begin
    print(f"observations {observation.shape}, {arguments.worlds * arguments.steps / elapsed:.0f} env steps/s")
    print(f"return of a random controller: {returns.mean():.2f} +- {returns.std():.2f} over {arguments.worlds} worlds")
    assert np.isfinite(observation).all()
    assert len(set(returns)) == arguments.worlds  # no two worlds are the same
    envs.close()


if __name__ == "__main__":
    main()
