"""What may be changed between steps, in each world: gravity and the velocities of the faces. NumPy only."""

from __future__ import annotations

from typing import Any

import numpy as np

from fluidgym.scene import Scene, face_names


class Controls:
    """The controls of all worlds.

    Both arrays may be written in part or replaced; what is given for one world holds for all.
    """

    def __init__(self, scene: Scene, num_worlds: int):
        """At rest, under the gravity of the scene."""
        self._scene = scene
        self._still = np.array([not scene.faces[name].moving for name in face_names(scene.dim)])
        self._gravity = np.tile(scene.gravity_vector, (num_worlds, 1))
        self._face_velocity = np.zeros((num_worlds, 2 * scene.dim))

    @property
    def gravity(self) -> np.ndarray:
        """Acceleration [m/s2], (world, dim)."""
        return self._gravity

    @gravity.setter
    def gravity(self, value: Any) -> None:
        self._gravity[...] = _fit("gravity", value, self._gravity.shape)

    @property
    def face_velocity(self) -> np.ndarray:
        """Velocity of each face along its normal axis at the end of the next call [m/s], (world, face)."""
        return self._face_velocity

    @face_velocity.setter
    def face_velocity(self, value: Any) -> None:
        self._face_velocity[...] = _fit("face_velocity", value, self._face_velocity.shape)

    def reset(self, mask: np.ndarray) -> None:
        """Put the worlds of a mask (world,) back to rest and the scene's gravity."""
        self._gravity[mask] = self._scene.gravity_vector
        self._face_velocity[mask] = 0.0

    def check(self, strongest: float, fastest: float) -> None:
        """Refuse controls that a step could not follow.

        Args:
            strongest: Limit of gravity [m/s2].
            fastest: Limit of the speed of a face [m/s].

        Raises:
            ValueError: A control is not finite, beyond its limit, or moves a face that cannot.
        """
        for name, values, limit, unit in (
            ("gravity", self._gravity, strongest, "m/s2"),
            ("face_velocity", self._face_velocity, fastest, "m/s"),
        ):
            wrong = np.argwhere(~(np.abs(values) <= limit))
            if len(wrong):
                place = tuple(wrong[0].tolist())
                raise ValueError(
                    f"Solver.{name}[{place[0]}, {place[1]}] = {values[place]:g} {unit} is outside"
                    f" -{limit:g} to {limit:g} {unit}; use a smaller value"
                )
        pushed = np.flatnonzero(self._face_velocity.any(axis=0) & self._still)
        if len(pushed):
            name = face_names(self._scene.dim)[pushed[0]]
            raise ValueError(
                f"Solver.face_velocity of {name!r} is not 0, but that face does not move;"
                " make it Face(moving=True) in the scene"
            )


def _fit(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """A control as it is given, broadcast over the worlds."""
    try:
        return np.broadcast_to(np.asarray(value, float), shape)
    except (TypeError, ValueError):
        raise ValueError(
            f"Solver.{name} has shape {np.shape(value)}, limit {shape}; give one row, or one for each world"
        ) from None
