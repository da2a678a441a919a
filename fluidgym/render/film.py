"""Frames on disk: still pictures and films, each written whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np
from PIL import Image

from fluidgym.files import replacing

_PALETTE_PIXELS = 400_000  # How many pixels of a film its palette is chosen from.
_COLOURS = 255  # One place in the palette is left for "as in the frame before".


def write_png(path: str | os.PathLike[str], frame: Any) -> None:
    """Write one frame as a PNG picture.

    Args:
        path: The file; replaced if it exists.
        frame: Pixels (height, width, 3), uint8.

    Raises:
        ValueError: The frame has another shape or type.
        FileNotFoundError: The folder does not exist.
    """
    picture = Image.fromarray(check_frame(frame, "frame"))
    with replacing(path) as unfinished:
        picture.save(unfinished, format="PNG")


def write_gif(path: str | os.PathLike[str], frames: Iterable[Any], fps: float) -> None:
    """Write a film as an endlessly looping GIF.

    All frames share one palette and are not dithered, so that still parts do not flicker. GIF
    keeps time in hundredths of a second; the frames are timed so that the whole film lasts as
    long as it should. A frame equal to the one before it lengthens that one instead.

    Args:
        path: The file; replaced if it exists.
        frames: At least one frame (height, width, 3), uint8, all of one size.
        fps: Frames per second [1/s], above 0 up to 50, the most that GIF players keep up with.

    Raises:
        ValueError: There is no frame, one has another shape or type, or fps is out of its limits.
        FileNotFoundError: The folder does not exist.
    """
    rate = _checked_rate(fps, most=50.0)
    film = list(_same_size(frames))
    if not film:
        raise ValueError("frames: 0 frames, at least 1 needed; give the frames of the film")
    palette = _shared_palette(film)
    pictures, durations = _pictures(film, palette, rate)
    with replacing(path) as unfinished:
        pictures[0].save(
            unfinished,
            format="GIF",
            save_all=True,
            append_images=pictures[1:],
            duration=durations,
            loop=0,
            disposal=1,
            optimize=False,
        )


def check_mp4() -> None:
    """Refuse an MP4 film that could not be written in the end.

    Raises:
        ValueError: imageio-ffmpeg is not installed; one line with the remedy.
    """
    if find_spec("imageio_ffmpeg") is None:
        raise ValueError('an MP4 film needs imageio-ffmpeg: pip install "fluidgym-sph[render]", or make a GIF')


def write_mp4(path: str | os.PathLike[str], frames: Iterable[Any], fps: float) -> None:
    """Write a film as an MP4 video (H.264).

    The codec needs even sides: a frame with an odd side has its last row or column doubled.

    Args:
        path: The file; replaced if it exists.
        frames: At least one frame (height, width, 3), uint8, all of one size.
        fps: Frames per second [1/s], above 0 up to 1000.

    Raises:
        ImportError: imageio-ffmpeg is not installed.
        ValueError: There is no frame, one has another shape or type, or fps is out of its limits.
        FileNotFoundError: The folder does not exist.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise ImportError('write_mp4 needs imageio-ffmpeg: pip install "fluidgym-sph[render]"') from error
    rate = _checked_rate(fps, most=1000.0)
    film = _same_size(frames)
    first = next(film, None)
    if first is None:
        raise ValueError("frames: 0 frames, at least 1 needed; give the frames of the film")
    height, width = _even(first).shape[:2]
    with replacing(path) as unfinished:
        sink = imageio_ffmpeg.write_frames(
            str(unfinished),
            (width, height),
            fps=rate,  # pyright: ignore[reportArgumentType]  (it takes a float, as it says)
            codec="libx264",
            quality=6,
            macro_block_size=1,
            output_params=["-movflags", "+faststart", "-f", "mp4"],
            ffmpeg_log_level="error",
        )
        with contextlib.closing(sink):
            sink.send(None)
            sink.send(_even(first).tobytes())
            for frame in film:
                sink.send(_even(frame).tobytes())


def check_frame(frame: Any, name: str) -> np.ndarray:
    """Check that an array is a frame.

    Args:
        frame: Pixels (height, width, 3), uint8.
        name: What to call it in the error message.

    Returns:
        The pixels (height, width, 3), contiguous.

    Raises:
        ValueError: The frame has another shape or type.
    """
    pixels = np.asarray(frame)
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] != 3 or not pixels.size:
        raise ValueError(
            f"{name}: {pixels.dtype} {pixels.shape} must be uint8 (height, width, 3); "
            "give a frame as draw_frame returns it"
        )
    return np.ascontiguousarray(pixels)


def _same_size(frames: Iterable[Any]) -> Iterator[np.ndarray]:
    size = None
    for number, frame in enumerate(frames):
        pixels = check_frame(frame, f"frames[{number}]")
        size = size or pixels.shape
        if pixels.shape != size:
            raise ValueError(
                f"frames[{number}]: shape {pixels.shape} must be {size} as the first; draw all frames with one size"
            )
        yield pixels


def _checked_rate(fps: Any, most: float) -> float:
    rate = float(fps)
    if not 0.0 < rate <= most:
        raise ValueError(f"fps: {rate:g} must be above 0 and at most {most:g}; give frames a second")
    return rate


def _even(frame: np.ndarray) -> np.ndarray:
    height, width, _ = frame.shape
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _shared_palette(film: list[np.ndarray]) -> Image.Image:
    """Choose the colours that suit the whole film, from evenly spread pixels of all frames.

    A colour counts by the root of its number of pixels, so that small bright drops keep their
    colours beside a large background.
    """
    step = max(1, sum(frame.size for frame in film) // (3 * _PALETTE_PIXELS))
    picked = [frame.reshape(-1, 3)[number % step :: step] for number, frame in enumerate(film)]
    sample = np.concatenate(picked)
    packed = sample @ np.array([1 << 16, 1 << 8, 1])
    _, first, count = np.unique(packed, return_index=True, return_counts=True)
    weighted = np.repeat(sample[first], np.ceil(np.sqrt(count)).astype(int), axis=0)
    return Image.fromarray(weighted[None]).quantize(_COLOURS, Image.Quantize.MEDIANCUT)


def _pictures(film: list[np.ndarray], palette: Image.Image, rate: float) -> tuple[list[Image.Image], list[int]]:
    pictures = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in film]
    ends = np.rint(np.arange(len(film) + 1) * (100.0 / rate)).astype(int) * 10
    return pictures, np.diff(ends).tolist()
