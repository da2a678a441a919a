"""Words and numbers around the view: heading, time and colour bar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluidgym.render.canvas import Canvas, outline, rectangle
from fluidgym.render.colour import EDGE, FAINT_INK, INK, water_map
from fluidgym.render.shot import Shot


@dataclass(frozen=True)
class Layout:
    """How the picture is shared out.

    Attributes:
        type_size: Size of ordinary text [px].
        left: Left edge of the view [px].
        top: Upper edge of the view [px].
        right: Right edge of the view [px].
        bottom: Lower edge of the view [px].
    """

    type_size: int
    left: float
    top: float
    right: float
    bottom: float


def lay_out(shot: Shot) -> Layout:
    """Share the picture out between heading, view and the bar below.

    Args:
        shot: What is drawn; only its size and its number of heading lines matter.

    Returns:
        The layout, the same for every frame with as many heading lines.
    """
    width, height = shot.size
    type_size = int(np.clip(round(0.034 * min(width, height * 1.4)), 9, 26))
    lines = (shot.title is not None) * 1.5 + 1.35 * len(shot.text)
    margin = 0.7 * type_size
    return Layout(
        type_size=type_size,
        left=margin,
        top=margin + lines * type_size,
        right=width - margin,
        bottom=height - 2.3 * type_size,
    )


def draw_legend(canvas: Canvas, shot: Shot, layout: Layout) -> None:
    """Write heading, time and colour bar.

    Args:
        canvas: The picture to write on.
        shot: What is drawn.
        layout: Where things go.
    """
    _draw_heading(canvas, shot, layout)
    baseline = shot.size[1] - 0.9 * layout.type_size
    taken = layout.left + 0.3 * layout.type_size
    if shot.time is not None:
        words = f"t = {shot.time:.2f} s"
        canvas.text((taken, baseline), words, layout.type_size, INK)
        taken += canvas.text_width(words, layout.type_size)
    _draw_bar(canvas, shot, layout, baseline, taken)


def _draw_heading(canvas: Canvas, shot: Shot, layout: Layout) -> None:
    left, baseline = layout.left + 0.3 * layout.type_size, 0.3 * layout.type_size
    if shot.title is not None:
        baseline += 1.5 * layout.type_size
        canvas.text((left, baseline), shot.title, round(1.2 * layout.type_size), INK)
    for line in shot.text:
        baseline += 1.35 * layout.type_size
        canvas.text((left, baseline), line, layout.type_size, FAINT_INK)


def _draw_bar(canvas: Canvas, shot: Shot, layout: Layout, baseline: float, taken: float) -> None:
    """Draw, from right to left: highest value, bar, lowest value, and the label if there is room for it."""
    low, high = _end_numbers(*shot.value_range)
    size, gap = layout.type_size, 0.6 * layout.type_size
    thick, length = max(4, round(0.55 * size)), int(np.clip(0.24 * shot.size[0], 24, 220))
    right = layout.right - 0.3 * size
    canvas.text((right, baseline), high, size, INK, anchor="rs")
    end = round(right - canvas.text_width(high, size) - gap)
    top = round(baseline - 0.36 * size - 0.5 * thick)
    shades = water_map()[np.linspace(0, len(water_map()) - 1, length).astype(int)]
    canvas.picture(np.broadcast_to(shades, (thick, length, 3)) + 0.5, (end - length, top))
    frame = rectangle((end - length, top), (end, top + thick))
    canvas.stroke(outline(frame), EDGE, opacity=0.5)
    start = end - length - gap
    canvas.text((start, baseline), low, size, INK, anchor="rs")
    start -= canvas.text_width(low, size) + 1.5 * gap
    if start - canvas.text_width(shot.label, size) > taken:
        canvas.text((start, baseline), shot.label, size, FAINT_INK, anchor="rs")


def _end_numbers(low: float, high: float) -> tuple[str, str]:
    """Write the ends of the colour bar with three digits, or as many as tell them apart."""
    words = "", ""
    for digits in range(3, 12):
        words = f"{low:.{digits}g}", f"{high:.{digits}g}"
        if words[0] != words[1]:
            break
    return words
