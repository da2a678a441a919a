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
    bodies: Sequence[Mapping[str, Any]] = (),
    inflows: Sequence[Mapping[str, Any]] = (),
    outflows: Sequence[Mapping[str, Any]] = (),
    grid: Any = None,
    size: tuple[int, int] = (640, 400),
    spheres: bool = False,
    camera: tuple[float, float] | None = None,
) -> np.ndarray:
    """Draw particles as water in their box.

    In two dimensions x runs to the right and y up. In three dimensions x runs to the right, z up
    and y into the picture, seen from the front, the right and above. The view depends on the box,
    the picture size and the number of heading lines only, so it stands still while water and walls
    move, and bodies too. Particles with a position or value that is not finite are left out, and so are those far away.

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
        bodies: Solids, in or out of the box: each a dict with "shape" "box", "lower" and "upper" (dim,) [m],
            or with "shape" "ball", "center" (dim,) [m] and "radius" [m]. "moving" (bool) gives it the
            colour of a moving wall; "name", here and below, stands in messages only. In three dimensions water in front
            of it hides it all but for a shimmer.
        inflows: Nozzles: each a dict with "center", the middle of the closed back of a short pipe (dim,)
            [m], "direction" in which the pipe runs from there and the water leaves (dim,), "width" of the
            opening [m] (in three dimensions its diameter or, with a height, its horizontal side),
            "height" [m] (only in three dimensions; None is round), "length" of the pipe [m] and "on" (bool,
            True if left out), which shows an arrow.
        outflows: Regions that remove water: each a dict with "lower" and "upper" (dim,) [m].
        grid: Shares in 0 to 1 of the cells of a grid over the box, from its lower corner (ny, nx), laid over a picture
            in two dimensions; None is none.
        size: Width and height of the picture [px], each from 64 to 8192.
        spheres: Whether each particle is drawn by itself, a ball or disc as wide as the spacing, not the body of water
            that they make.
        camera: In three dimensions, how far around the box from the front to the right, and how far up, the eye is
            [degrees]; None is (24.7, 25.3).

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
        bodies=bodies,
        inflows=inflows,
        outflows=outflows,
        grid=grid,
        size=size,
        spheres=spheres,
        camera=camera,
    )
    layout = lay_out(shot)
    canvas = Canvas(shot.size, BACKGROUND)
    draw = draw_plane if shot.dim == 2 else draw_space
    draw(canvas, shot, layout)
    draw_legend(canvas, shot, layout)
    return canvas.pixels()
