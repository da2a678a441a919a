"""Martin & Moyce: a column twice as high as wide falls and runs along a dry floor without end.

The resolution counts particles along the width a = 57.15 mm (2.25 in); the column is h0 = n^2 a high, n^2 = 2. It is
released from rest, starts with the pressure of the instant after (`scene.released_head`) and slides freely on the
floor; the tank is 8 a long, and the water does not reach its end.

Reference: the tables of Martin & Moyce (1952), Phil. Trans. R. Soc. A 244, for n^2 = 2: front Z = x/a against
T = t sqrt(2g/a), which is n t sqrt(g/a), and height h/h0 of the column that is left against t sqrt(g/a). Their readings
scatter by 5 %. When the column was let go is uncertain by the time that took: their clock is set to that of the run
where the front passes Z = 1.44. The heights need no such shift.

Errors:
    front: root mean square of x/x_ref - 1 over the entries of the table from Z = 1.44 on, the clocks set.
    travel: likewise of (x - x_ref) / (x_ref - a): without the length that was there from the start, it is the harder
        one; the scatter is one of x.
    height: root mean square of (h - h_ref) / h0 over the entries of the table.
    clock: by how much T the run passes Z = 1.44 later than the table has it.

Without friction, and with a dam that is gone at once, the front passes Z = 1.44 at a T that is 0.33 less than the
table's and is then 2.2 % of x off: a/40 and a/80 agree on both within a tenth.
"""

import math

import numpy as np

from fluidgym.diagnostics import front
from fluidgym.scene import Box, Fluid, Scene
from fluidgym.solver import Solver
from fluidgym.validation.case import Case, Records, rms

WIDTH = 0.05715  # a [m]
HEIGHT = 2.0 * WIDTH  # h0 [m]
GRAVITY = 9.81  # [m/s2]
LENGTH = 8.0  # of the tank, over a
TIME_UNIT = math.sqrt(WIDTH / (2.0 * GRAVITY))  # of T [s]
HEIGHT_TIME_UNIT = math.sqrt(WIDTH / GRAVITY)  # [s]

FRONT = np.array([1.11, 1.22, 1.44, 1.67, 1.89, 2.11, 2.33, 2.56, 2.78, 3.00, 3.22, 3.44, 3.67, 3.89, 4.11])  # Z
FRONT_TIMES = np.array([0.41, 0.84, 1.19, 1.43, 1.63, 1.83, 1.98, 2.20, 2.32, 2.51, 2.65, 2.83, 2.98, 3.11, 3.33])  # T
HEIGHTS = np.array([0.94, 0.83, 0.72, 0.61, 0.50, 0.39, 0.28])  # h/h0
HEIGHT_TIMES = np.array([0.56, 0.93, 1.28, 1.66, 2.00, 2.45, 3.06])  # t sqrt(g/a)

SET = 1.44  # Z at which the clocks are set
STRIP = 0.2  # width of the water at the wall whose height is measured, over a


def scene(resolution: int, dim: int) -> Scene:
    """The column at the end of its tank."""
    return Scene(
        lower=(0.0, 0.0),
        upper=(LENGTH * WIDTH, 1.5 * HEIGHT),
        particle_spacing=WIDTH / resolution,
        fluid=[Fluid(Box((0.0, 0.0), (WIDTH, HEIGHT)), pressure="released")],
        gravity=GRAVITY,
    )


def observe(solver: Solver) -> dict[str, float]:
    """Front Z, and height h/h0 of the water at the wall: its volume over the width of the strip."""
    particles, scene = solver.particles(), solver.scene
    strip = STRIP * WIDTH
    volume = scene.particle_spacing**2 * np.count_nonzero(particles.position[:, 0] < strip)
    return {"front": front(particles, scene) / WIDTH, "height": volume / (strip * HEIGHT)}


def errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """The errors that the head of this file defines; those of the entries that were reached."""
    time = times / TIME_UNIT
    found: dict[str, float] = {name: math.nan for name in ("front", "travel", "height", "clock")}
    passed = np.flatnonzero(records["front"] >= SET)
    if not len(passed):
        return found
    last = passed[0]
    clock = float(np.interp(SET, records["front"][last - 1 : last + 1], time[last - 1 : last + 1]))
    found["clock"] = clock - float(FRONT_TIMES[FRONT == SET][0])

    which = (FRONT >= SET) & (FRONT_TIMES + found["clock"] <= time[-1] * (1.0 + 1e-9))
    off = np.interp(FRONT_TIMES[which] + found["clock"], time, records["front"]) - FRONT[which]
    found["front"] = rms(off / FRONT[which])
    found["travel"] = rms(off / (FRONT[which] - 1.0))

    height_time = times / HEIGHT_TIME_UNIT
    which = HEIGHT_TIMES <= height_time[-1] * (1.0 + 1e-9)
    if which.any():
        found["height"] = rms(np.interp(HEIGHT_TIMES[which], height_time, records["height"]) - HEIGHTS[which])
    return found


CASE = Case(
    name="martin-moyce",
    title="Column falling on a long dry floor, front and height against Martin & Moyce",
    resolutions={2: (20, 40, 80)},
    scene=scene,
    times=TIME_UNIT * 0.05 * np.arange(1, 89),
    end=TIME_UNIT * 4.4,
    observe=observe,
    errors=errors,
    target={20: {"front": 0.025, "travel": 0.04, "height": 0.025, "clock": 0.35}, 40: {"height": 0.015}},
    goal={20: {"front": 0.04}},
)
