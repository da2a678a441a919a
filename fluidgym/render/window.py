"""A window that shows frames as they are drawn."""

from __future__ import annotations

import os
from types import TracebackType
from typing import Any

from fluidgym.render.film import check_frame


class Window:
    """A window on the screen, opened with its first frame.

    Args:
        title: What its title bar says.
        fps: Most frames per second [1/s]; ``show`` waits to keep to it. None does not wait.

    Raises:
        ImportError: pygame is not installed.
        ValueError: fps is not above 0.
    """

    def __init__(self, title: str = "FluidGym", fps: float | None = None) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            import pygame
        except ImportError as error:
            raise ImportError('Window needs pygame: pip install "fluidgym-sph[render]"') from error
        if fps is not None and not fps > 0.0:
            raise ValueError(f"fps: {fps!r} must be above 0; give frames a second, or None")
        self._pygame = pygame
        self._title = title
        self._fps = fps
        self._clock = pygame.time.Clock()
        self._screen: Any = None
        self._closed = False

    @property
    def closed(self) -> bool:
        """Whether the window was closed, by ``close`` or by its user."""
        return self._closed

    def show(self, frame: Any) -> bool:
        """Show a frame, and answer what the user did to the window.

        Args:
            frame: Pixels (height, width, 3), uint8; a frame of another size resizes the window.

        Returns:
            Whether the window is still open; once it is closed, frames are ignored.

        Raises:
            ValueError: The frame has another shape or type.
        """
        pixels = check_frame(frame, "frame")
        if self._closed:
            return False
        self._open((pixels.shape[1], pixels.shape[0]))
        self._pygame.surfarray.blit_array(self._screen, pixels.swapaxes(0, 1))
        self._pygame.display.flip()
        if any(event.type == self._pygame.QUIT for event in self._pygame.event.get()):
            self.close()
        elif self._fps is not None:
            self._clock.tick(self._fps)
        return not self._closed

    def close(self) -> None:
        """Close the window; closing it again does nothing."""
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None
        self._closed = True

    def _open(self, size: tuple[int, int]) -> None:
        if self._screen is None:
            self._pygame.display.init()
            self._pygame.display.set_caption(self._title)
        if self._screen is None or self._screen.get_size() != size:
            self._screen = self._pygame.display.set_mode(size)

    def __enter__(self) -> Window:
        """Return the window itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the window."""
        self.close()
