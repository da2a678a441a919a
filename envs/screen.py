"""Pictures and the window of an environment."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluidgym.checks import check_choice, check_type

COLOURS = ("speed", "pressure", "density")
RENDER_MODES = ["human", "rgb_array"]
MOST_TILES = 16  # worlds shown at once in a window


@dataclass(frozen=True)
class Look:
    """How frames look.

    Attributes:
        colour: What the fluid is coloured by: "speed", "pressure" or "density".
        overlay: Whether the observed grid is laid over a frame, in 2D.
        frame_size: Width and height of a frame [pixels].
        spheres: Whether each particle is drawn by itself, not the body of water that they make.
        camera: In 3D, how far around the box from the front to the right, and how far up, the eye is [degrees].

    Raises:
        ValueError: A field is unknown or out of its limits.
    """

    colour: str = "speed"
    overlay: bool = False
    frame_size: tuple[int, int] = (640, 400)
    spheres: bool = False
    camera: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_choice("colour", self.colour, COLOURS, ", ".join(map(repr, COLOURS)))
        check_type("overlay", self.overlay, bool, "a bool", "True or False")
        check_type("spheres", self.spheres, bool, "a bool", "True or False")
        size = self.frame_size
        check_type("frame_size", size, Sequence, "a pair of numbers", "(640, 400)")
        if len(size) != 2 or not all(isinstance(side, int) and 64 <= side <= 8192 for side in size):
            raise ValueError(f"frame_size = {size!r} is not two whole numbers of 64 to 8192; use (640, 400)")
        if self.camera is not None:
            good = np.shape(self.camera) == (2,) and all(isinstance(angle, int | float) for angle in self.camera)
            if not good or not -89.0 <= self.camera[1] <= 89.0:
                raise ValueError(
                    f"camera = {self.camera!r} is not two angles, the second of -89 to 89 degrees; use (25, 25)"
                )


class Screen:
    """Where the frames of an environment go."""

    def __init__(self, render_mode: str | None, interval: float):
        """Remember the mode; no window is opened before the first frame.

        Args:
            render_mode: One of RENDER_MODES, or None.
            interval: Time between frames [s].

        Raises:
            ValueError: There is no such mode.
        """
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(
                f"render_mode = {render_mode!r} is unknown; use {', '.join(map(repr, RENDER_MODES))} or None"
            )
        self._frames_per_second = max(1, round(1.0 / interval))
        self._window: Any = None

    def metadata(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """A copy of an environment's metadata with the frame rate of its own."""
        return {**given, "render_fps": self._frames_per_second}

    def show(self, frames: Sequence[np.ndarray]) -> None:
        """Show frames side by side in the window."""
        if self._window is None:
            from fluidgym.render import Window

            self._window = Window("FluidGym", fps=self._frames_per_second)
        self._window.show(tile(frames))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None


def tile(frames: Sequence[np.ndarray]) -> np.ndarray:
    """Frames of one size as one picture, row by row in a square."""
    columns = math.ceil(math.sqrt(len(frames)))
    rows = math.ceil(len(frames) / columns)
    height, width, _ = frames[0].shape
    picture = np.zeros((rows * height, columns * width, 3), np.uint8)
    for index, frame in enumerate(frames):
        row, column = divmod(index, columns)
        picture[row * height : (row + 1) * height, column * width : (column + 1) * width] = frame
    return picture
