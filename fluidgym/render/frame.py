"""One picture of the water: an array of pixels from arrays of particles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fluidgym.render.canvas import Canvas
from fluidgym.render.colour import BACKGROUND
from fluidgym.render.legend import draw_legend, lay_out
from fluidgym.render.plane import draw_plane
from fluidgym.render.shot import check_shot
from fluidgym.render.space import draw_space


def draw_frame(
    positions: Any,
    values: Any,
    *,
    lower: Any,
    upper: Any,
    spacing: float,
    faces: Mapping[str, Mapping[str, Any]] | None = None,
    value_range: tuple[float, float] | None = None,
    label: str = "speed [m/s]",
    time: float | None = None,
    title: str | None = None,
    text: str | Sequence[str] = (),
    zone: tuple[Any, Any] | None = None,
    size: tuple[int, int] = (640, 400),
) -> np.ndarray:
    """Draw particles as water in their box.

    In two dimensions x runs to the right and y up. In three dimensions x runs to the right, z up
    and y into the picture, seen from the front, the right and above. The view depends on the box,
    the picture size and the number of heading lines only, so it stands still while water and walls
    move. Particles with a position or value that is not finite are left out, and so are those far away.

    Args:
        positions: Particle positions (n, dim) [m], dim 2 or 3; n may be 0.
        values: What to colour by (n,), in the unit that the label names.
        lower: Lower box corner (dim,) [m].
        upper: Upper box corner (dim,) [m].
        spacing: Particle spacing [m].
        faces: For each of "x_min", "x_max", "y_min", "y_max" (and "z_min", "z_max") a dict with
            "kind" ("wall", "open" or "periodic"), "position" [m] and "moving" (bool). What is
            left out is a fixed wall at the box side.
        value_range: Values at the two ends of the colour bar. None takes the extremes of this
            frame, which then differ from frame to frame.
        label: Name and unit beside the colour bar.
        time: Simulated time [s], or None to leave it out.
        title: Heading, or None to leave it out.
        text: Further lines under the heading.
        zone: Lower and upper corner (dim,) [m] of a region to mark, or None.
        size: Width and height of the picture [px], each from 64 to 8192.

    Returns:
        The picture (height, width, 3), uint8, a new array.

    Raises:
        ValueError: An argument is out of its limits; the message names it, and the limit.
    """
    shot = check_shot(
        positions,
        values,
        lower=lower,
        upper=upper,
        spacing=spacing,
        faces=faces,
        value_range=value_range,
        label=label,
        time=time,
        title=title,
        text=text,
        zone=zone,
        size=size,
    )
    layout = lay_out(shot)
    canvas = Canvas(shot.size, BACKGROUND)
    draw = draw_plane if shot.dim == 2 else draw_space
    draw(canvas, shot, layout)
    draw_legend(canvas, shot, layout)
    return canvas.pixels()
