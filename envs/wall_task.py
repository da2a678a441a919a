"""A task whose action drives one thing along its way, the right wall of the box unless a task says otherwise."""

from __future__ import annotations

import numpy as np

from fluidgym.envs.actuators import Drive
from fluidgym.envs.fluid_task import FluidTask

WALL = "x_max"


class WallTask(FluidTask):
    """A wall that is driven.

    Attributes:
        wall: How it moves.
        position: Of the wall, as it is [m], (world,).
        velocity: Likewise [m/s], (world,).
    """

    wall: Drive

    def drive(self, actions: np.ndarray) -> None:
        """Move the wall as far as its limits let it."""
        before = self.velocity
        after = self.wall.next_velocity(actions[:, 0], self.position, before)
        self.push(after)
        self._effort = self.wall.effort(after, before)

    def push(self, velocity: np.ndarray) -> None:
        """Give what is driven its velocities [m/s], (world,)."""
        self.solver.face_velocity[:, self.solver.face_index(WALL)] = velocity

    def measure(self) -> None:
        """Look at the fluid and at the wall."""
        super().measure()
        self.position, self.velocity = self.look()

    def look(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] and velocity [m/s] of what is driven, each (world,)."""
        faces, face = self.solver.state.faces, self.solver.face_index(WALL)
        return faces.position.numpy()[:, face].astype(float), faces.velocity.numpy()[:, face].astype(float)

    def info(self) -> dict[str, np.ndarray]:
        """What every task tells, and the wall [m, m/s]."""
        return super().info() | {"wall_position": self.position.copy(), "wall_velocity": self.velocity.copy()}
