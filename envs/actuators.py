"""What an action drives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from fluidgym.envs import rewards

Command = Literal["velocity", "acceleration"]


@dataclass(frozen=True)
class Drive:
    """Something that follows commands at a limited speed and acceleration and never runs into the end of its travel.

    Attributes:
        travel: Lowest and highest position [m].
        max_speed: [m/s].
        max_acceleration: [m/s2].
        command: What a command in -1 to 1 is a share of: "velocity" of max_speed, "acceleration" of max_acceleration.
        interval: Time between commands [s].
        names: What options call the largest speed and the largest acceleration.

    Raises:
        ValueError: A field is out of its limits.
    """

    travel: tuple[float, float]
    max_speed: float
    max_acceleration: float
    command: Command | str
    interval: float
    names: tuple[str, str] = ("max_speed", "max_acceleration")

    def __post_init__(self) -> None:
        if self.command not in get_args(Command):
            raise ValueError(f"command = {self.command!r} is unknown; use {' or '.join(map(repr, get_args(Command)))}")
        values = (self.max_speed, "m/s"), (self.max_acceleration, "m/s2")
        for name, (value, unit) in zip(self.names, values, strict=True):
            if not (isinstance(value, int | float | np.number) and math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} = {value!r} {unit} must be finite and above 0; give a positive number")

    def next_velocity(self, command: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """The velocity at the end of the next interval, reached at constant acceleration.

        It keeps enough room to stop: with D left to the end of its travel it holds
        D >= v^2 / (2 a) + v T / 2. From there braking at a for an interval T gives the same again, so the law can
        always be kept; the last bit is approached ever more slowly.

        Args:
            command: -1 to 1, (world,).
            position: [m], (world,).
            velocity: [m/s], (world,).

        Returns:
            Velocity [m/s], (world,).
        """
        change = self.max_acceleration * self.interval
        wanted = self.max_speed * command if self.command == "velocity" else velocity + change * command
        wanted = wanted.clip(-self.max_speed, self.max_speed).clip(velocity - change, velocity + change)
        upward = self._fastest_stop(self.travel[1] - position, velocity)
        downward = self._fastest_stop(position - self.travel[0], -velocity)
        return wanted.clip(-downward, upward)

    def effort(self, after: np.ndarray, before: np.ndarray) -> np.ndarray:
        """How hard it works for an interval that ends at one velocity [m/s] and began at another: 0 to 1."""
        change = (after - before) / (self.max_acceleration * self.interval)
        return rewards.effort(after / self.max_speed, change)

    def towards(self, wanted: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """The command that brings it from one velocity [m/s] to another, or as near as it may come; -1 to 1."""
        if self.command == "velocity":
            return (wanted / self.max_speed).clip(-1.0, 1.0)
        return ((wanted - velocity) / (self.max_acceleration * self.interval)).clip(-1.0, 1.0)

    def _fastest_stop(self, room: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Largest velocity towards the end of the travel that still lets it stop in the room [m] left."""
        change = self.max_acceleration * self.interval
        left = np.maximum(room - 0.5 * self.interval * velocity, 0.0)
        return np.sqrt(change * change + 2.0 * self.max_acceleration * left) - change
