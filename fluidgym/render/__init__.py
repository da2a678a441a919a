"""Pictures, films and a window: what a person sees of the water.

The functions here take plain arrays and give plain arrays; they know nothing of the solver. Only
NumPy and Pillow are needed, besides pygame for ``Window`` and imageio-ffmpeg for ``write_mp4``,
which are asked for when used.
"""

from fluidgym.render.film import write_gif, write_mp4, write_png
from fluidgym.render.frame import draw_frame
from fluidgym.render.window import Window

__all__ = ["Window", "draw_frame", "write_gif", "write_mp4", "write_png"]
