"""Train a controller by proximal policy optimisation: python examples/ppo.py fluidgym/CarryTank2D-v0

Wants PyTorch (pip install "fluidgym-sph[ppo]"). Leaves a policy that `python -m fluidgym play ID --policy FILE` shows
and `evaluate ID --policy FILE` scores, at the difficulty that it was trained at, and its learning curve. Schulman et
al. 2017; observations and returns are scaled by running estimates, as Gymnasium's wrappers do.
"""

import argparse
import json
import time
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from fluidgym.envs.evaluation import VALIDATION, evaluate
from fluidgym.envs.policy import Policy

HORIZON = 40  # steps of each world between updates
EPOCHS, BATCHES = 8, 4
RATE = 5e-4
GAMMA, LAMBDA = 0.99, 0.95
CLIP = 0.2
HIDDEN = 64
BOUND = 1.0  # on means of actions past their bounds: beyond, nothing would lead them back, and all control is jerks
WIDTHS = 1.0, 0.12  # of the noise, at first and in the end: what learns in much noise comes to jerk
KEPT = 0.7  # of it from step to step, at first: to move water is to go on for a while (Hollenstein et al. 2024)
# Share of the training after which the noise has died down, and nothing of it is kept: what learns beside noise that
# is kept sees in the speeds what noise to expect, leans against that, and where there is none sways.
FINE = 0.6


class Running:
    """Mean and variance of all that was seen (Chan, Golub & LeVeque 1983)."""

    def __init__(self, shape: tuple[int, ...]):
        self.mean, self.variance, self.count = np.zeros(shape), np.ones(shape), 1e-4

    def add(self, values: np.ndarray) -> None:
        n, mean, variance = len(values), values.mean(axis=0), values.var(axis=0)
        total, off = self.count + n, mean - self.mean
        both = self.variance * self.count + variance * n + off * off * self.count * n / total
        self.mean, self.variance, self.count = self.mean + off * n / total, both / total, total

    @property
    def scale(self) -> np.ndarray:
        return np.sqrt(self.variance + 1e-8)


def perceptron(sizes: tuple[int, ...], last: float) -> nn.Sequential:
    """Orthogonal tanh layers; the last one is linear and small."""
    layers: list[nn.Module] = []
    for n, (inputs, outputs) in enumerate(pairwise(sizes)):
        layer = nn.Linear(inputs, outputs)
        nn.init.orthogonal_(layer.weight, last if n == len(sizes) - 2 else 2.0**0.5)
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


class Agent(nn.Module):
    """Actor with a Gaussian around it, and critic."""

    def __init__(self, seen: int, acts: int):
        super().__init__()
        self.actor = perceptron((seen, HIDDEN, HIDDEN, acts), 0.01)
        self.critic = perceptron((seen, HIDDEN, HIDDEN, 1), 1.0)
        self.width = WIDTHS[0]

    def look(self, seen: torch.Tensor) -> tuple[torch.distributions.Normal, torch.Tensor]:
        mean = self.actor(seen)
        return torch.distributions.Normal(mean, self.width), self.critic(seen)[:, 0]

    def policy(self, running: Running, about: dict) -> Policy:
        """The actor without its noise, for NumPy."""
        layers = [layer for layer in self.actor if isinstance(layer, nn.Linear)]
        arrays = [(layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy().copy()) for layer in layers]
        weights, biases = zip(*arrays, strict=True)
        return Policy(weights, biases, running.mean.astype(np.float32), running.scale.astype(np.float32), about)


def advantages(rewards, values, ended, after):
    """Generalised advantage estimates (Schulman et al. 2016), (step, world)."""
    found, carried = torch.zeros_like(rewards), torch.zeros_like(after)
    for step in reversed(range(len(rewards))):
        follows = after if step == len(rewards) - 1 else values[step + 1]
        goes_on = 1.0 - ended[step]
        error = rewards[step] + GAMMA * follows * goes_on - values[step]
        carried = error + GAMMA * LAMBDA * goes_on * carried
        found[step] = carried
    return found


def train(env_id, difficulty, worlds, steps, minutes, seed, device, out, threads=None):
    """Train until so many environment steps or minutes are over; the policy and the returns of the episodes."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # the perceptron is small, and the fluid wants the processors
    options = {"difficulty": difficulty, "device": device, "threads": threads}
    envs = gym.make_vec(env_id, num_envs=worlds, autoreset_mode="SameStep", **options)
    sees, acts = gym.spaces.flatdim(envs.single_observation_space), gym.spaces.flatdim(envs.single_action_space)
    agent, seen = Agent(sees, acts), Running((sees,))
    optimiser = torch.optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    about = {"task": env_id, "difficulty": difficulty, "seed": seed}
    returned, discounted = Running(()), np.zeros(worlds)
    curve, earned = [], np.zeros(worlds)
    noise = torch.randn(worlds, acts)
    updates = max(1, steps // (worlds * HORIZON))
    observation = envs.reset(seed=1000 * seed)[0].reshape(worlds, -1)
    begin = time.monotonic()

    def scaled(values):
        return torch.as_tensor(((values - seen.mean) / seen.scale).clip(-10.0, 10.0), dtype=torch.float32)

    with tqdm(total=updates, desc=env_id, unit="update", disable=None) as bar:
        for update in range(updates):
            used = max(update / updates, (time.monotonic() - begin) / (60.0 * minutes))
            if used >= 1.0:
                break
            optimiser.param_groups[0]["lr"] = RATE * (1.0 - used)
            left = max(0.0, 1.0 - used / FINE)
            agent.width, keep = WIDTHS[1] + (WIDTHS[0] - WIDTHS[1]) * left, KEPT * left
            kept = {name: [] for name in ("seen", "action", "chance", "value", "reward", "ended")}
            for _ in range(HORIZON):
                seen.add(observation)
                looked = scaled(observation)
                with torch.no_grad():
                    gauss, value = agent.look(looked)
                    action = gauss.mean + gauss.stddev * noise
                    noise = keep * noise + (1.0 - keep * keep) ** 0.5 * torch.randn(worlds, acts)
                observation, reward, terminated, truncated, _ = envs.step(action.numpy())
                observation = observation.reshape(worlds, -1)
                ended = terminated | truncated
                earned += reward
                curve += [(update, float(total)) for total in earned[ended]]
                earned[ended] = 0.0
                discounted = GAMMA * discounted + reward
                returned.add(discounted)
                discounted[ended] = 0.0
                step = (looked, action, gauss.log_prob(action).sum(1), value, reward / returned.scale, ended)
                for name, tensor in zip(kept, step, strict=True):
                    kept[name].append(torch.as_tensor(tensor, dtype=torch.float32))
            data = {name: torch.stack(tensors) for name, tensors in kept.items()}
            with torch.no_grad():
                after = agent.look(scaled(observation))[1]
            # The time is seen, so that an episode that is over is worth nothing more, truncated or not.
            gain = advantages(data["reward"], data["value"], data["ended"], after)
            learn(agent, optimiser, data, gain)
            bar.update(1)
            if curve:
                recent = np.mean([total for _, total in curve[-50:]])
                bar.set_postfix_str(f"{(update + 1) * worlds * HORIZON} steps, return {recent:.1f}")
            if out and update % 50 == 49:
                agent.policy(seen, about).save(out)  # what there is, if it is interrupted
    envs.close()
    about |= {"steps": (update + 1) * worlds * HORIZON, "seconds": round(time.monotonic() - begin)}
    return agent.policy(seen, about), [((update + 1) * worlds * HORIZON, total) for update, total in curve]


def learn(agent, optimiser, data, gain):
    """A few passes over what was kept."""
    flat = {name: tensor.flatten(0, 1) for name, tensor in data.items()}
    target, gain = (gain + data["value"]).flatten(), gain.flatten()
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(gain)).chunk(BATCHES):
            gauss, value = agent.look(flat["seen"][batch])
            ratio = (gauss.log_prob(flat["action"][batch]).sum(1) - flat["chance"][batch]).exp()
            a = gain[batch]
            a = (a - a.mean()) / (a.std() + 1e-8)
            surrogate = torch.min(ratio * a, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * a).mean()
            loss = -surrogate + 0.5 * (value - target[batch]).square().mean()
            # Past its bounds an action is clipped, and nothing would lead the mean back.
            loss = loss + BOUND * (gauss.mean.abs() - 1.0).clamp(min=0.0).square().mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("id", nargs="?", default="fluidgym/CarryTank2D-v0", help="(default: fluidgym/CarryTank2D-v0)")
    parser.add_argument("--difficulty", default="easy", help="easy, medium or hard (default: easy)")
    parser.add_argument("--worlds", type=int, default=32, help="(default: 32)")
    parser.add_argument("--steps", type=int, default=400_000, help="of all worlds together (default: 400000)")
    parser.add_argument("--minutes", type=float, default=10.0, help="at most (default: 10)")
    parser.add_argument("--seed", type=int, default=0, help="(default: 0)")
    parser.add_argument("--device", default=None, help="of the fluid (default: a GPU where there is one)")
    parser.add_argument("--out", type=Path, default=Path("outputs"), help="folder (default: outputs)")
    parser.add_argument("--episodes", type=int, default=32, help="to validate with (default: 32)")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    path = chosen.out / f"{chosen.id.split('/')[-1]}-{chosen.difficulty}-{chosen.seed}.npz"
    policy, curve = train(
        chosen.id, chosen.difficulty, chosen.worlds, chosen.steps, chosen.minutes, chosen.seed, chosen.device, path
    )
    policy.save(path)
    path.with_suffix(".json").write_text(json.dumps({"about": dict(policy.about), "curve": curve}))
    options = {**gym.spec(chosen.id).kwargs, "difficulty": chosen.difficulty, "device": chosen.device}
    for name, controller in {"null": "null", "scripted": "scripted", "PPO": policy}.items():
        print(f"{name}: {evaluate(controller, episodes=chosen.episodes, seeds=VALIDATION, **options)}")
    print(path)


if __name__ == "__main__":
    main()
