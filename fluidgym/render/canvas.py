"""A picture that is painted on: smooth-edged polygons and lines, text, and shaded pixels."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

Colour = tuple[int, int, int]
_FINE = 4  # Sub-pixels along a pixel edge, for the smooth edges of polygons.


@functools.cache
def _font(size: int) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    return ImageFont.load_default(size=size)


class Canvas:
    """An RGB picture; pixel coordinates run right and down from its upper left corner.

    Args:
        size: Width and height [px].
        background: The colour it starts with.
    """

    def __init__(self, size: tuple[int, int], background: Colour) -> None:
        self._image = Image.new("RGB", size, background)

    def fill(self, polygons: Iterable[np.ndarray], colour: Colour, opacity: float = 1.0) -> None:
        """Paint polygons with smooth edges; where they overlap they do not add up.

        Args:
            polygons: Corner coordinates [px], one array (corners, 2) per polygon.
            colour: The paint.
            opacity: 0 leaves the picture as it is, 1 covers it.
        """
        shapes = [np.asarray(polygon, dtype=np.float64) for polygon in polygons]
        if not shapes:
            return
        corners = np.concatenate(shapes)
        low = np.maximum(np.floor(corners.min(axis=0)), 0).astype(int)
        high = np.minimum(np.ceil(corners.max(axis=0)), self._image.size).astype(int)
        if (high <= low).any():
            return
        mask = Image.new("L", tuple((high - low) * _FINE))
        brush = ImageDraw.Draw(mask)
        for shape in shapes:
            brush.polygon([tuple(c) for c in (shape - low) * _FINE - 0.5], fill=round(255 * opacity))
        self._image.paste(colour, (*low.tolist(), *high.tolist()), mask.reduce(_FINE))

    def stroke(
        self,
        lines: Iterable[np.ndarray],
        colour: Colour,
        *,
        width: float = 1.0,
        opacity: float = 1.0,
        dash: tuple[float, float] | None = None,
    ) -> None:
        """Paint straight lines.

        Args:
            lines: End points [px], one array (2, 2) per line.
            colour: The paint.
            width: Line width [px].
            opacity: 0 leaves the picture as it is, 1 covers it.
            dash: Lengths of a dash and of a gap [px]; None draws a full line.
        """
        pieces = [piece for line in lines for piece in _dashes(np.asarray(line, float), dash)]
        self.fill([_thicken(piece, width) for piece in pieces], colour, opacity)

    def arrow(self, line: np.ndarray, colour: Colour, halo: Colour) -> None:
        """Paint a small arrow in the middle of a line, along it.

        Args:
            line: End points [px] (2, 2).
            colour: The paint.
            halo: The paint around it, so that it stands out on any ground.
        """
        length = float(np.linalg.norm(line[1] - line[0]))
        if length < 1e-6:
            return
        along = (line[1] - line[0]) / length
        side = np.array([-along[1], along[0]])
        middle, reach = line.mean(axis=0), 0.5 * float(np.clip(0.7 * length, 6.0, 32.0))
        size = min(1.0, reach / 6.0)
        for paint, more in ((halo, 1.3 * size), (colour, 0.0)):
            tail, neck = middle - (reach + more) * along, middle + (reach - 6.5 * size - 0.7 * more) * along
            tip, wide = middle + (reach + 1.8 * more) * along, (3.8 * size + 1.7 * more) * side
            shaft = _thicken(np.stack([tail, neck]), 2.0 * size + 2.0 * more)
            self.fill([shaft, np.stack([tip, neck + wide, neck - wide])], paint)

    def text(self, at: tuple[float, float], words: str, size: int, colour: Colour, anchor: str = "ls") -> None:
        """Write one line of text.

        Args:
            at: Where the anchor lies [px].
            words: The text.
            size: Type size [px].
            colour: The ink.
            anchor: Pillow's two-letter anchor; "ls" is the left end of the baseline.
        """
        ImageDraw.Draw(self._image).text(at, words, fill=colour, font=_font(size), anchor=anchor)

    def text_width(self, words: str, size: int) -> float:
        """Return the width of a line of text [px] at a type size [px]."""
        return _font(size).getlength(words)

    def picture(self, pixels: np.ndarray, at: tuple[int, int]) -> None:
        """Lay a small picture (rows, columns, 3) with its upper left corner at a pixel."""
        self._image.paste(Image.fromarray(np.ascontiguousarray(pixels, dtype=np.uint8)), at)

    def stamp(self, cover: np.ndarray, at: tuple[int, int], colour: Colour) -> None:
        """Paint through a stencil.

        Args:
            cover: Shares in 0 to 1 that the paint takes (rows, columns); they must lie inside the picture.
            at: Where its upper left corner lies [px].
            colour: The paint.
        """
        stencil = Image.fromarray((cover * 255.0 + 0.5).astype(np.uint8))
        self._image.paste(colour, (*at, at[0] + stencil.width, at[1] + stencil.height), stencil)

    def shade(self, where: np.ndarray, colours: np.ndarray, alpha: np.ndarray) -> None:
        """Blend single pixels.

        Args:
            where: Flat pixel numbers, row by row (m,), each at most once.
            colours: Colours in 0 to 255 (m, 3).
            alpha: Shares in 0 to 1 that the colours take (m,).
        """
        pixels = self.pixels()
        flat = pixels.reshape(-1, 3)
        under = flat[where].astype(np.float32)
        flat[where] = np.clip(under + alpha[:, None] * (colours - under) + 0.5, 0.0, 255.0)
        self._image = Image.fromarray(pixels)

    def soften(self, where: np.ndarray) -> None:
        """Average single pixels with their eight neighbours, to smooth a jagged border.

        Args:
            where: Flat pixel numbers, row by row (m,), each at most once.
        """
        pixels = self.pixels()
        height, width, _ = pixels.shape
        rows, columns = np.divmod(where, width)
        total = np.zeros((len(where), 3), dtype=np.uint16)
        for down, right in itertools.product((-1, 0, 1), repeat=2):
            near = pixels[np.clip(rows + down, 0, height - 1), np.clip(columns + right, 0, width - 1)]
            total += near.astype(np.uint16) * ((2 - abs(down)) * (2 - abs(right)))
        pixels[rows, columns] = (total + 8) // 16
        self._image = Image.fromarray(pixels)

    def pixels(self) -> np.ndarray:
        """Return a copy of the picture (height, width, 3), uint8."""
        return np.array(self._image)


def rectangle(low: Sequence[float] | np.ndarray, high: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the corners (4, 2) of an upright rectangle given by two opposite corners."""
    (x0, y0), (x1, y1) = low, high
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], dtype=np.float64)


def outline(corners: np.ndarray) -> list[np.ndarray]:
    """Return the sides (2, 2) of a polygon given by its corners (corners, 2)."""
    return [np.stack(side) for side in zip(corners, np.roll(corners, -1, axis=0), strict=True)]


def hatch(corners: np.ndarray, gap: float) -> list[np.ndarray]:
    """Return slanted lines (2, 2) across a four-sided area.

    Args:
        corners: Its corners in order (4, 2) [px].
        gap: Between the lines, along a side [px].
    """
    _, across, _, along = corners - corners[0]
    wide, high = float(np.linalg.norm(across)), float(np.linalg.norm(along))
    if min(wide, high) < 1.0:
        return []
    skew = corners[2] - corners[1] - along
    lines = []
    for cut in np.arange(0.5 * gap, wide + high, gap):
        ends = np.array([(min(cut, wide), max(cut - wide, 0.0)), (max(cut - high, 0.0), min(cut, high))])
        u, v = (ends / (wide, high)).T[:, :, None]
        lines.append(corners[0] + u * across + v * along + u * v * skew)
    return lines


def _dashes(line: np.ndarray, dash: tuple[float, float] | None) -> list[np.ndarray]:
    """Cut a line (2, 2) into its dashes, with a dash at both ends."""
    length = float(np.linalg.norm(line[1] - line[0]))
    if length == 0.0:
        return []
    if dash is None or length <= dash[0]:
        return [line]
    gaps = max(1, round((length - dash[0]) / sum(dash)))
    starts = np.linspace(0.0, length - dash[0], gaps + 1)
    along = (line[1] - line[0]) / length
    return [line[0] + np.outer([start, start + dash[0]], along) for start in starts]


def _thicken(line: np.ndarray, width: float) -> np.ndarray:
    """Turn a line (2, 2) into a thin rectangle (4, 2)."""
    along = line[1] - line[0]
    side = np.array([-along[1], along[0]]) * (0.5 * width / np.linalg.norm(along))
    return np.stack([line[0] + side, line[1] + side, line[1] - side, line[0] - side])
