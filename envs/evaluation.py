"""What a controller earns on episodes that it was not trained on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluidgym.envs import make_task
from fluidgym.envs.policy import Policy
from fluidgym.envs.runner import Runner
from fluidgym.envs.task import Task

# Seeds of episodes to train on, to choose between controllers by, and to report. They have none in common.
TRAIN = range(1_000_000_000)
VALIDATION = range(1_000_000_000, 1_500_000_000)
TEST = range(1_500_000_000, 2_000_000_000)

# Sees observations (world, ...) and gives actions (world, action).
Controller = Callable[[np.ndarray], np.ndarray]


BUILT_IN = ("null", "scripted")  # controllers that every task has


def act(controller: str | Controller, task: Task, observations: np.ndarray) -> np.ndarray:
    """Actions (world, action) of a controller: one of BUILT_IN, or what sees observations (world, ...)."""
    if isinstance(controller, str):
        return task.null() if controller == "null" else task.scripted()
    return controller(observations)


@dataclass(frozen=True)
class Score:
    """What a controller earned.

    Attributes:
        returns: Sum of the rewards of each episode, (episode,).
        lengths: Steps of each, (episode,).
        diverged: How many episodes ended as their world diverged.
        parts: Mean of each part of the reward over all steps.
    """

    returns: np.ndarray
    lengths: np.ndarray
    diverged: int
    parts: dict[str, float]

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(self.returns.mean())

    @property
    def margin(self) -> float:
        """Half of the 95 % interval of the mean: 1.96 standard errors."""
        n = len(self.returns)
        return 1.96 * float(self.returns.std(ddof=1)) / math.sqrt(n) if n > 1 else math.inf

    def __str__(self) -> str:
        parts = ", ".join(f"{name} {value:.2f}" for name, value in self.parts.items())
        return f"{self.mean:.1f} +- {self.margin:.1f} in {len(self.returns)} episodes ({parts})"


def evaluate(
    controller: str | Controller,
    task: str,
    episodes: int = 32,
    seeds: range = TEST,
    device: str | None = None,
    threads: int | None = None,
    progress: Callable[[int], object] = lambda steps: None,
    **options: Any,
) -> Score:
    """Let a controller play one episode with each of the first seeds of a band.

    Args:
        controller: "null" does nothing, "scripted" is the task's own; or what sees observations and gives actions.
        task: Name of the task.
        episodes: How many, all at once.
        seeds: Of the episodes: TRAIN, VALIDATION or TEST.
        device: "cpu", "cuda", ...; None takes a GPU where there is one.
        threads: Of a CPU, at most; None is as many as there are processors.
        progress: Called with 1 after each step.
        options: Of the task.

    Raises:
        ValueError: The controller is unknown or does not fit, or an argument is out of its limits.
    """
    if isinstance(controller, str) and controller not in BUILT_IN:
        raise ValueError(f"controller = {controller!r} is unknown; use 'null', 'scripted' or a Policy")
    if not 1 <= episodes <= len(seeds):
        raise ValueError(f"episodes = {episodes} is outside 1 to {len(seeds)}; use 32")
    posed = make_task(task, **options)
    if isinstance(controller, Policy):
        controller.check(posed)
    runner = Runner(posed, episodes, device, None, threads)
    outcome = runner.reset(np.ones(episodes, bool), list(seeds[:episodes]))
    on = np.ones(episodes, bool)
    returns, lengths, sums = np.zeros(episodes), np.zeros(episodes, int), dict.fromkeys(posed.parts(), 0.0)
    diverged = 0
    while on.any():
        actions = act(controller, posed, outcome.observation)
        outcome = runner.step(runner.check_actions(actions, "actions", (episodes, *posed.action_space.shape)))
        returns[on] += outcome.reward[on]
        lengths[on] += 1
        for name in sums:
            sums[name] += float(outcome.info[name][on].sum())
        diverged += int((outcome.info["diverged"] & on).sum())
        on = on & ~(outcome.terminated | outcome.truncated)
        progress(1)
    return Score(returns, lengths, diverged, {name: value / lengths.sum() for name, value in sums.items()})
