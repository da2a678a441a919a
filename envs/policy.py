"""A small trained controller: a perceptron in NumPy, kept in a file, so that whoever plays it needs no trainer."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fluidgym.envs.task import Task

VERSION = 1


@dataclass(frozen=True)
class Policy:
    """A perceptron with tanh layers: observations are shifted and scaled, clipped to 10, and the last layer is linear.

    Attributes:
        weights: Of each layer, (inputs, outputs).
        biases: Of each layer, (outputs,).
        mean: Of the observations, (observation,).
        scale: Of the observations, what they are divided by, (observation,).
        about: What it was trained on: task, options, and whatever there is to know; JSON.
    """

    weights: Sequence[np.ndarray]
    biases: Sequence[np.ndarray]
    mean: np.ndarray
    scale: np.ndarray
    about: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        sizes = [len(self.mean), *(len(bias) for bias in self.biases)]
        shapes = [weight.shape for weight in self.weights]
        if shapes != list(pairwise(sizes)) or self.scale.shape != self.mean.shape:
            raise ValueError(f"Policy.weights have shapes {shapes}, which do not fit layers of {sizes}; mend them")

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Actions (world, action) in -1 to 1, from observations (world, ...)."""
        seen = observations.reshape(len(observations), -1)
        values = ((seen - self.mean) / self.scale).clip(-10.0, 10.0)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = np.tanh(values @ weight + bias)
        return (values @ self.weights[-1] + self.biases[-1]).clip(-1.0, 1.0)

    def check(self, task: Task) -> None:
        """Refuse a task whose observations or actions are others.

        Raises:
            ValueError: They are.
        """
        seen, acts = int(np.prod(task.observation_space.shape)), int(np.prod(task.action_space.shape))
        if (seen, acts) != (len(self.mean), len(self.biases[-1])):
            raise ValueError(
                f"Policy sees {len(self.mean)} numbers and gives {len(self.biases[-1])}, the task has {seen} and"
                f" {acts}; use it on {self.about.get('task', 'the task it was trained on')}, difficulty"
                f" {self.about.get('difficulty', 'and options')}, as it was trained"
            )

    def save(self, path: Path) -> None:
        """Write it as an .npz file; what was there is replaced at once or not at all."""
        arrays: dict[str, Any] = {"mean": self.mean, "scale": self.scale}
        arrays |= {f"weight_{n}": weight for n, weight in enumerate(self.weights)}
        arrays |= {f"bias_{n}": bias for n, bias in enumerate(self.biases)}
        about = json.dumps({"version": VERSION, **self.about})
        unfinished = path.with_name(path.name + ".part")
        with unfinished.open("wb") as file:
            kept: dict[str, Any] = {name: np.asarray(array, np.float32) for name, array in arrays.items()}
            np.savez_compressed(file, about=np.frombuffer(about.encode(), np.uint8), **kept)
        unfinished.replace(path)

    @classmethod
    def load(cls, path: Path) -> Policy:
        """Read what `save` wrote.

        Raises:
            ValueError: There is no such file, or it is something else.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                about = json.loads(file["about"].tobytes().decode())
                layers = sum(name.startswith("bias_") for name in file.files)
                weights = [file[f"weight_{n}"] for n in range(layers)]
                biases = [file[f"bias_{n}"] for n in range(layers)]
                mean, scale = file["mean"], file["scale"]
        except FileNotFoundError:
            raise ValueError(f"policy = {str(path)!r} does not exist; give a file that Policy.save wrote") from None
        except Exception as error:  # whatever a foreign or damaged file makes of it
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise ValueError(
                f"policy = {str(path)!r} is not one ({reason}); give a file that Policy.save wrote"
            ) from None
        if about.pop("version", None) != VERSION:
            raise ValueError(f"policy = {str(path)!r} is of another version, limit {VERSION}; train it anew")
        return cls(weights, biases, mean, scale, about)
