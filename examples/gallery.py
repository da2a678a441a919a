"""A film of each task, of who does nothing, of the scripted controller and of a trained one: python examples/gallery.py

Leaves docs/gallery/ID.gif, small ones; a task without a policy in examples/policies/ has two parts.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
from tqdm import tqdm

import fluidgym  # noqa: F401 - registers the environments
from fluidgym.envs import FluidEnv
from fluidgym.envs.evaluation import act
from fluidgym.envs.policy import Policy
from fluidgym.render import write_gif

HERE = Path(__file__).resolve().parent
SIZE = (320, 200)


def film(env_id: str, controller, seed: int, seconds: float) -> tuple[list[np.ndarray], float]:
    """The frames of an episode, as many as those seconds have, and the time between two [s]."""
    options = {**gym.spec(env_id).kwargs, "difficulty": "easy"}
    env = FluidEnv(render_mode="rgb_array", frame_size=SIZE, **options)
    if isinstance(controller, Policy):
        controller.check(env.task)
    observation, _ = env.reset(seed=seed)
    interval = env.task.control_interval
    frames, ended = [env.render()], False
    while not ended and len(frames) * interval <= seconds:
        observation, _, terminated, truncated, _ = env.step(act(controller, env.task, observation[None])[0])
        frames.append(env.render())
        ended = terminated or truncated
    env.close()
    return [np.asarray(frame) for frame in frames], interval


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ids", nargs="*", metavar="ID", help="environments (default: all in 2D)")
    parser.add_argument("--seed", type=int, default=1_500_000_000, help="of the episode (default: of the test band)")
    parser.add_argument("--seconds", type=float, default=4.0, help="of each at most (default: 4)")
    parser.add_argument("--out", type=Path, default=HERE.parent / "docs" / "gallery", help="(default: docs/gallery)")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    every = [name for name in gym.registry if name.startswith("fluidgym/") and "2D" in name]
    for env_id in tqdm(chosen.ids or every, unit="film", disable=None):
        name = env_id.rpartition("/")[2]
        path = HERE / "policies" / f"{name}.npz"
        controllers = ["null", "scripted", *([Policy.load(path)] if path.exists() else [])]
        played = [film(env_id, controller, chosen.seed, chosen.seconds) for controller in controllers]
        films, (interval, *_) = zip(*played, strict=True)
        length = max(map(len, films))  # who ended early stands still
        films = [frames + [frames[-1]] * (length - len(frames)) for frames in films]
        rows = [np.concatenate(frames, axis=1) for frames in zip(*films, strict=True)]
        write_gif(chosen.out / f"{name}.gif", rows, 1.0 / interval)
        print(chosen.out / f"{name}.gif")


if __name__ == "__main__":
    main()
