"""What may be changed between steps, in each world: gravity, motion of faces and bodies, nozzles. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, overload

import numpy as np

from fluidgym.scene import AXES, Inflow, Scene, face_names


@dataclass(frozen=True)
class Limits:
    """What a control may be: from `lowest` to `highest`, in `unit`."""

    lowest: float
    highest: float
    unit: str


class Control:
    """A control of a solver: an attribute, read, written in part or replaced; one given for one world is for all."""

    def __init__(self, text: str):
        """Keep what the control is."""
        self.__doc__ = text

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, solver: None, owner: type) -> Control: ...

    @overload
    def __get__(self, solver: object, owner: type) -> np.ndarray: ...

    def __get__(self, solver: Any, owner: type) -> Any:
        return self if solver is None else solver.controls[self._name]

    def __set__(self, solver: Any, value: Any) -> None:
        solver.controls.set(self._name, value)


class Controls:
    """The controls of all worlds, by name."""

    def __init__(self, scene: Scene, num_worlds: int):
        """At rest, under the gravity of the scene, the nozzles as the scene has them."""
        self._scene, self._faces = scene, face_names(scene.dim)
        dim, inflows = scene.dim, list(scene.inflows.values())
        n = len(inflows)
        self._start = {
            "gravity": scene.gravity_vector,
            "face_velocity": np.zeros(2 * dim),
            "body_velocity": np.zeros((len(scene.bodies), dim)),
            "inflow_speed": np.array([inflow.speed for inflow in inflows]),
            "inflow_center": np.array([inflow.center for inflow in inflows]).reshape(n, dim),
            "inflow_direction": np.array([inflow.direction for inflow in inflows]).reshape(n, dim),
            "inflow_width": np.array([inflow.width for inflow in inflows]),
        }
        self._now = {name: np.tile(start, (num_worlds, *[1] * start.ndim)) for name, start in self._start.items()}

    def __getitem__(self, name: str) -> np.ndarray:
        return self._now[name]

    def names(self) -> tuple[str, ...]:
        """Names of the controls that the scene has a use for."""
        return tuple(name for name, values in self._now.items() if values.size)

    def set(self, name: str, value: Any) -> None:
        """Replace a control.

        Raises:
            ValueError: It has another shape.
        """
        self._now[name][...] = _fit(name, value, self._now[name].shape)

    def reset(self, mask: np.ndarray) -> None:
        """Put the worlds of a mask (world,) back to the start."""
        for name, start in self._start.items():
            self._now[name][mask] = start

    def check(self, strongest: float, fastest: float) -> None:
        """Refuse controls that a step could not follow.

        Args:
            strongest: Limit of gravity [m/s2].
            fastest: Limit of the speed of a face or body [m/s].

        Raises:
            ValueError: A control is not finite, beyond its limit, or moves a face or body that cannot.
        """
        self._check_limits("gravity", Limits(-strongest, strongest, "m/s2"))
        for name in ("face_velocity", "body_velocity"):
            self._check_limits(name, Limits(-fastest, fastest, "m/s"))
        for name, pushed in zip(self._faces, np.asarray(self._now["face_velocity"].any(axis=0)), strict=True):
            if pushed and not self._scene.faces[name].moving:
                raise ValueError(
                    f"Solver.face_velocity of {name!r} is not 0, but that face does not move;"
                    " make it Face(moving=True) in the scene"
                )
        for name, pushed in zip(
            self._scene.bodies, np.asarray(self._now["body_velocity"].any(axis=(0, 2))), strict=True
        ):
            if pushed and not self._scene.bodies[name].moving:
                raise ValueError(
                    f"Solver.body_velocity of {name!r} is not 0, but that body does not move;"
                    " make it Body(moving=True) in the scene"
                )
        for index, (name, inflow) in enumerate(self._scene.inflows.items()):
            label, place = f"of {name!r}", (slice(None), index)
            self._check_limits("inflow_speed", Limits(0.0, inflow.top_speed, "m/s"), place, label)
            widths = Limits(self._scene.particle_spacing * (1.0 - 1e-9), inflow.width, "m")
            self._check_limits("inflow_width", widths, place, label)
            for axis, (low, high) in enumerate(zip(self._scene.lower, self._scene.upper, strict=True)):
                self._check_limits("inflow_center", Limits(low, high, "m"), (*place, axis), label)
            self._check_limits("inflow_direction", Limits(-1e6, 1e6, "1"), place, label)
            if not self._now["inflow_direction"][:, index].any(axis=1).all():
                raise ValueError(f"Solver.inflow_direction {label} has no length in some world; give the way out")
            self._check_pipe(name, inflow, index)

    def _check_pipe(self, name: str, inflow: Inflow, index: int) -> None:
        """Refuse a pipe whose end is outside the box."""
        way = self._now["inflow_direction"][:, index]
        length = inflow.pipe_length(self._scene.particle_spacing)
        end = self._now["inflow_center"][:, index] + length * way / np.linalg.norm(way, axis=1, keepdims=True)
        slack = 1e-6 * np.subtract(self._scene.upper, self._scene.lower)
        wrong = np.argwhere((end < self._scene.lower - slack) | (end > self._scene.upper + slack))
        if len(wrong):
            world, axis = wrong[0]
            raise ValueError(
                f"Solver.inflow_center and inflow_direction put the end of {name!r} at {AXES[axis]} ="
                f" {end[world, axis]:g} m in world {world}, outside {self._scene.lower[axis]:g} to"
                f" {self._scene.upper[axis]:g} m; keep the pipe inside the box"
            )

    def _check_limits(self, name: str, limits: Limits, place: Any = (), label: str = "") -> None:
        values = self._now[name][place]
        right = (values >= limits.lowest) & (values <= limits.highest)
        if not right.all():
            wrong = np.argwhere(~right)
            at = tuple(wrong[0].tolist())
            where = label or f"[{', '.join(map(str, at))}]"
            raise ValueError(
                f"Solver.{name}{' ' if label else ''}{where} = {values[at]:g} {limits.unit} is outside"
                f" {limits.lowest:g} to {limits.highest:g} {limits.unit};"
                f" use a {_remedy(float(values[at]), limits)} value"
            )


def _remedy(value: float, limits: Limits) -> str:
    """Which way a value that is out of its limits should go."""
    return "larger" if limits.lowest >= 0.0 and value < limits.lowest else "smaller"


def _fit(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A control as it is given, broadcast over the worlds."""
    try:
        return np.broadcast_to(np.asarray(value, float), shape)
    except (TypeError, ValueError):
        raise ValueError(
            f"Solver.{name} has shape {np.shape(value)}, limit {shape}; give one row, or one for each world"
        ) from None
