"""What a viewer shows: an environment or a scene file, stepped, driven and read out. Nothing here knows of pages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fluidgym.diagnostics import kinetic_energy, mass
from fluidgym.envs import FluidEnv
from fluidgym.envs.evaluation import Controller, act
from fluidgym.envs.fluid_task import FluidTask
from fluidgym.experiment import LEAST_MACH_MARGIN, Experiment, drive
from fluidgym.scene import AXES
from fluidgym.solver import Solver

LIFT = 2.0  # speed at which a gate is lifted [m/s]


@dataclass
class Knob:
    """Something that a person may turn.

    Attributes:
        name: What it is.
        low: Its lowest value.
        high: Its highest value.
        unit: Of the values.
        value: As it is.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    value: float = 0.0


class Flow(ABC):
    """One world that is shown.

    Attributes:
        title: In words.
        solver: Its solver.
        interval: Simulated time from frame to frame [s].
        knobs: What a person may turn.
        by_hand: Whether the knobs count; else a controller or the scene file drives.
        enter: What the key Enter does, in words; "" is nothing.
        ended: Whether there is nothing more to come before a reset.
    """

    title: str
    solver: Solver
    interval: float
    knobs: list[Knob]
    by_hand: bool
    enter: str
    ended: bool

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Begin anew."""

    @abstractmethod
    def step(self) -> None:
        """Go on by a frame."""

    @abstractmethod
    def press_enter(self) -> None:
        """Do what Enter does."""

    @abstractmethod
    def close(self) -> None:
        """Free what is held."""

    def grid(self) -> np.ndarray | None:
        """What an observation is made of, the fluid fraction of each cell, upper row first (ny, nx); None for none."""
        return None

    def readouts(self) -> dict[str, str]:
        """What is worth knowing now, by name."""
        particles, scene = self.solver.particles(), self.solver.scene
        unit = "kg" if scene.dim == 3 else "kg/m"
        energy = "J" if scene.dim == 3 else "J/m"
        found = {
            "time": f"{float(self.solver.time[0]):.2f} s",
            "particles": f"{len(particles)}",
            "mass": f"{mass(particles, scene):.4g} {unit}",
            "kinetic energy": f"{kinetic_energy(particles, scene):.3g} {energy}",
        }
        return found if np.isfinite(particles.position).all() else found | {"diverged": "not finite"}


class EnvFlow(Flow):
    """An environment, driven by a controller or by hand."""

    def __init__(self, env: FluidEnv, controller: str | Controller, by_hand: bool):
        """Show it.

        Args:
            env: The environment.
            controller: "null", "scripted" or what sees observations and gives actions.
            by_hand: Whether a person drives at first.
        """
        task = env.task
        assert isinstance(task, FluidTask)
        self._env, self._task, self._controller = env, task, controller
        self.title, self.solver, self.interval = f"{task.title}{task.dim}D", env.solver, task.control_interval
        low, high = task.action_space.low, task.action_space.high
        self.knobs = [Knob(name, float(low[k]), float(high[k])) for k, name in enumerate(task.action_names())]
        self.by_hand, self.enter, self.ended = by_hand, f"{self.knobs[0].name} to its highest, by hand", False
        if self.knobs[0].name == "gate":
            self.enter = "lifts the gate"
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin an episode."""
        self._observation, self._info = self._env.reset(seed=seed)
        self._reward, self._return, self.ended = 0.0, 0.0, False

    def step(self) -> None:
        """Act once, as far as the episode goes."""
        if self.ended:
            return
        if not self.by_hand:
            for knob, value in zip(self.knobs, self._chosen(), strict=True):
                knob.value = float(value)
        action = np.array([knob.value for knob in self.knobs], np.float32)
        self._observation, reward, terminated, truncated, self._info = self._env.step(action)
        self._reward, self._return = float(reward), self._return + float(reward)
        self.ended = bool(terminated or truncated)

    def _chosen(self) -> np.ndarray:
        space = self._task.action_space
        return act(self._controller, self._task, self._observation[None])[0].clip(space.low, space.high)

    def press_enter(self) -> None:
        """Take over, and turn the first knob up."""
        self.by_hand, self.knobs[0].value = True, self.knobs[0].high

    def close(self) -> None:
        """Close the environment."""
        self._env.close()

    def grid(self) -> np.ndarray | None:
        """The fluid fraction that is observed; in 3D its mean along y."""
        fraction = self._task.coarse()[0, 0]
        return (fraction if fraction.ndim == 2 else fraction.mean(axis=1))[::-1]

    def readouts(self) -> dict[str, str]:
        """What is worth knowing, and how well it goes."""
        parts = {name: f"{values[0]:.3f}" for name, values in self._task.parts().items()}
        found = super().readouts() | {"reward": f"{self._reward:.3f}", "return": f"{self._return:.2f}", **parts}
        if self._info["diverged"]:
            found["diverged"] = str(self._info["reason"])
        return found | ({"episode": "over; reset begins another"} if self.ended else {})


class SceneFlow(Flow):
    """A scene file, driven as it says or by hand."""

    def __init__(self, experiment: Experiment, device: str | None, by_hand: bool):
        """Show it.

        Args:
            experiment: The scene and its motions.
            device: "cpu", "cuda", ...; None takes a GPU where there is one.
            by_hand: Whether a person drives at first.
        """
        self._experiment = experiment
        self.solver = Solver(experiment.scene, experiment.scheme, device=device)
        self.title = experiment.title or "scene"
        self.interval = experiment.view.frame_interval
        self.knobs, self._turn = [], []
        scene, fastest = self.solver.scene, self.solver.scene.sound_speed / LEAST_MACH_MARGIN
        calm = min(fastest, 2.0 * scene.speed_scale)
        self._lifted: int | None = None
        for name, face in scene.faces.items():
            if face.moving:
                index = self.solver.face_index(name)
                self._add(f"wall {name}", -calm, calm, "m/s", lambda v, i=index: self._put("face_velocity", (0, i), v))
        for name, body in scene.bodies.items():
            for axis in range(scene.dim) if body.moving else ():
                place = (0, self.solver.body_index(name), axis)
                self._add(
                    f"{name} {AXES[axis]}", -calm, calm, "m/s", lambda v, p=place: self._put("body_velocity", p, v)
                )
            if body.moving and self._lifted is None:
                self._lifted, self._gate = len(self.knobs) - 1, name
        for name, inflow in scene.inflows.items():
            place = (0, self.solver.inflow_index(name))
            self._add(name, 0.0, inflow.top_speed, "m/s", lambda v, p=place: self._put("inflow_speed", p, v))
            self.knobs[-1].value = inflow.speed
        self.by_hand = by_hand
        self.enter = f"lifts {self._gate}" if self._lifted is not None else ""
        self.ended = False

    def _add(self, name: str, low: float, high: float, unit: str, turn: Callable[[float], None]) -> None:
        self.knobs.append(Knob(name, low, high, unit))
        self._turn.append(turn)

    def _put(self, control: str, place: tuple[int, ...], value: float) -> None:
        getattr(self.solver, control)[place] = value

    def reset(self, seed: int) -> None:
        """Put it back to its start; there is nothing to draw a seed for."""
        self.solver.reset()
        self.ended = False

    def step(self) -> None:
        """Go on, as the file says while it says something, or as the knobs are."""
        if self.by_hand:
            for knob, turn in zip(self.knobs, self._turn, strict=True):
                turn(knob.value)
            self.solver.advance(self.interval)
            return
        now, end = float(self.solver.time[0]), self._experiment.duration
        until = min(now + self.interval, end)
        if until - now > 1e-9:
            drive(self._experiment, self.solver, until)
        self.ended = end - until < 1e-9

    def press_enter(self) -> None:
        """Take over, and lift the first body that moves."""
        if self._lifted is not None:
            self.by_hand, knob = True, self.knobs[self._lifted]
            knob.value, self.ended = min(LIFT, knob.high), False

    def close(self) -> None:
        """Nothing is held."""

    def readouts(self) -> dict[str, str]:
        """What is worth knowing."""
        return super().readouts() | ({"scene": "over; drive by hand, or reset"} if self.ended else {})
