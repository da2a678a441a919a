"""Train with skrl: python examples/skrl_ppo.py fluidgym/SpreadEven2D-v0

Wants pip install "fluidgym-sph[skrl]". skrl takes the vector environment as it is; the networks and what they learn
from live on the device that --device names, the fluid on --fluid. Leaves TensorBoard logs and checkpoints.
"""

import argparse
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed
from torch import nn

from fluidgym.envs.evaluation import VALIDATION, evaluate


def layers(inputs: int, outputs: int) -> nn.Sequential:
    """Two hidden tanh layers."""
    return nn.Sequential(
        nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)
    )  # fmt: skip


class Actor(GaussianMixin, Model):
    """A Gaussian around what a perceptron says."""

    def __init__(self, seen: Any, acts: Any, device: str):
        Model.__init__(self, observation_space=seen, action_space=acts, device=device)
        GaussianMixin.__init__(self, clip_actions=True)
        self.net = layers(gym.spaces.flatdim(seen), gym.spaces.flatdim(acts))
        self.log_std = nn.Parameter(torch.full((gym.spaces.flatdim(acts),), -0.5))

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    """A perceptron that says what a state is worth."""

    def __init__(self, seen: Any, acts: Any, device: str):
        Model.__init__(self, observation_space=seen, action_space=acts, device=device)
        DeterministicMixin.__init__(self)
        self.net = layers(gym.spaces.flatdim(seen), 1)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[torch.Tensor, dict[str, Any]]:
        return self.net(inputs["observations"]), {}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("id", nargs="?", default="fluidgym/SpreadEven2D-v0", help="(default: fluidgym/SpreadEven2D-v0)")
    parser.add_argument("--difficulty", default="easy", help="easy, medium or hard (default: easy)")
    parser.add_argument("--worlds", type=int, default=32, help="(default: 32)")
    parser.add_argument("--steps", type=int, default=300_000, help="of all worlds together (default: 300000)")
    parser.add_argument("--horizon", type=int, default=64, help="steps of each world between updates (default: 64)")
    parser.add_argument("--seed", type=int, default=0, help="(default: 0)")
    parser.add_argument("--device", default="cpu", help="of the networks (default: cpu)")
    parser.add_argument("--fluid", default=None, help="device of the fluid (default: a GPU where there is one)")
    parser.add_argument("--out", type=Path, default=Path("outputs"), help="folder (default: outputs)")
    parser.add_argument("--episodes", type=int, default=32, help="to validate with (default: 32)")
    chosen = parser.parse_args()
    set_seed(chosen.seed)
    torch.set_num_threads(1)  # the fluid wants the processors
    made = gym.make_vec(
        chosen.id,
        num_envs=chosen.worlds,
        difficulty=chosen.difficulty,
        device=chosen.fluid,
        autoreset_mode="SameStep",
    )
    env = wrap_env(made, wrapper="gymnasium", verbose=False)
    spaces: Any = env.observation_space, env.action_space
    seen, acts = spaces
    models: dict[str, Any] = {"policy": Actor(seen, acts, chosen.device), "value": Critic(seen, acts, chosen.device)}
    cfg = PPO_CFG(
        rollouts=chosen.horizon,
        learning_epochs=8,
        mini_batches=8,
        learning_rate=5e-4,
        observation_preprocessor=RunningStandardScaler,
        observation_preprocessor_kwargs={"size": seen, "device": chosen.device},
        value_preprocessor=RunningStandardScaler,
        value_preprocessor_kwargs={"size": 1, "device": chosen.device},
    )
    cfg.experiment.directory = str(chosen.out)
    cfg.experiment.experiment_name = f"skrl-{chosen.id.split('/')[-1]}"
    memory = RandomMemory(memory_size=chosen.horizon, num_envs=chosen.worlds, device=chosen.device)
    agent = PPO(
        models=models, memory=memory, cfg=cfg, observation_space=seen, action_space=acts, device=chosen.device
    )  # fmt: skip
    trainer = SequentialTrainer(
        env=env, agents=agent, cfg={"timesteps": chosen.steps // chosen.worlds, "headless": True}
    )  # fmt: skip
    trainer.train()

    scaler = agent._observation_preprocessor

    def act(observations: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            scaled = scaler(torch.as_tensor(observations, device=chosen.device).flatten(1))
            return models["policy"].net(scaled).clamp(-1.0, 1.0).cpu().numpy()

    options = {**gym.spec(chosen.id).kwargs, "difficulty": chosen.difficulty, "device": chosen.fluid}
    for name, controller in {"null": "null", "scripted": "scripted", "skrl": act}.items():
        print(f"{name}: {evaluate(controller, episodes=chosen.episodes, seeds=VALIDATION, **options)}")
    print(chosen.out / cfg.experiment.experiment_name)


if __name__ == "__main__":
    main()
