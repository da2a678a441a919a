"""A dam break, watched and measured: python examples/dam_break.py

A column of water collapses in a tank and runs along the floor, as in the experiments everybody compares with. Once its
front has been held against the published curve, the right wall closes in and keeps the water together. All of it goes
through gymnasium.make; a table, a picture and a film are what is left.
"""

import argparse
import math
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from fluidgym.diagnostics import measure
from fluidgym.envs.fluid_env import FluidEnv
from fluidgym.envs.tasks.dam_break_contain import close_in
from fluidgym.render import write_gif, write_mp4, write_png
from fluidgym.validation.dam_break import FRONT, FRONT_TIMES, HEIGHT, TIME_UNIT

STEPS_PER_UNIT = 12  # actions in a time sqrt(H/g), so that every instant of the published curve is met
RESOLUTION = {2: 40, 3: 16}
FRONT_ERROR_LIMIT = {2: 0.03, 3: 0.10}  # for the check at the end, at the default resolution


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2, help="2D or 3D (default: 2)")
    parser.add_argument("--resolution", type=int, help="particles over the column's height (default: 40; 16 in 3D)")
    parser.add_argument("--device", default=None, help="cpu, cuda, ... (default: a GPU where there is one)")
    parser.add_argument("--seconds", type=float, default=2.5, help="simulated time [s] (default: 2.5)")
    parser.add_argument("--output", type=Path, default=None, help="folder (default: outputs/dam_break_2d or _3d)")
    parser.add_argument("--film", choices=("gif", "mp4", "none"), default="gif", help="mp4 needs the extra 'render'")
    arguments = parser.parse_args()
    if arguments.seconds <= 0.0:
        parser.error(f"--seconds = {arguments.seconds:g} must be above 0; use 2.5")
    if arguments.film == "mp4" and find_spec("imageio_ffmpeg") is None:
        parser.error('--film mp4 needs the extra "render": pip install "fluidgym-sph[render]", or use --film gif')
    return arguments


def main() -> int:
    """Run the dam break; 0 if its front keeps to the published curve."""
    arguments = parse_arguments()
    dim = arguments.dim
    interval = TIME_UNIT / STEPS_PER_UNIT
    actions = math.ceil(arguments.seconds / interval)
    begin = time.perf_counter()
    try:
        env = gym.make(
            f"fluidgym:fluidgym/DamBreakContain{dim}D-v0",
            max_episode_steps=actions,
            resolution=arguments.resolution or RESOLUTION[dim],
            control_interval=interval,
            variation=0.0,
            jitter=0.0,
            depth=1.0,
            render_mode="rgb_array",
            device=arguments.device,
        )
    except ValueError as error:  # one line that names the option and the remedy
        print(f"dam_break.py: {error}", file=sys.stderr)
        return 2
    _, info = env.reset(seed=0)
    assert isinstance(env.unwrapped, FluidEnv)
    solver = env.unwrapped.solver
    solver.step(1)  # compiles what is left to compile
    _, info = env.reset(seed=0)
    setup_time = time.perf_counter() - begin
    start = measure(solver)

    fronts, frames, solving, total_reward = [start.front / HEIGHT], [look(env)], 0.0, 0.0
    splash, picture = 0.0, frames[0]
    for step in tqdm(range(1, actions + 1), desc=f"dam break {dim}D", unit="action"):
        # Hold the wall still while the front is on the published curve, then close in.
        action = np.zeros(1, np.float32) if step <= FRONT_TIMES[-1] * STEPS_PER_UNIT else close_in(info)
        begin = time.perf_counter()
        _, reward, terminated, truncated, info = env.step(action)
        solving += time.perf_counter() - begin
        total_reward += float(reward)
        fronts.append(measure(solver).front / HEIGHT)
        if step % 2 == 0:
            frames.append(look(env))
        if info["splash"] > splash:
            splash, picture = info["splash"], look(env)
        if terminated or truncated:
            break
    end, steps = measure(solver), round(solver.time[0] / interval) * math.ceil(interval / solver.max_step - 1e-9)

    errors = front_errors(np.array(fronts))
    print_summary(dim, solver, start, end, steps, solving, setup_time, total_reward / len(fronts), errors)
    output = arguments.output or Path("outputs") / f"dam_break_{dim}d"
    save(output, picture, frames, 0.5 / interval, arguments.film)
    env.close()
    worst = max((abs(error) for t, _, error in errors if t >= 1.0), default=0.0)
    if worst > FRONT_ERROR_LIMIT[dim]:
        print(f"The front is {worst:.1%} off the published curve; use a finer --resolution.", file=sys.stderr)
        return 1
    return 0


def look(env: gym.Env) -> np.ndarray:
    """A picture of the world (height, width, 3)."""
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    return frame


def front_errors(fronts: np.ndarray) -> list[tuple[float, float, float]]:
    """t*, front x/H and its error over the distance travelled, for each published instant that was reached."""
    found = []
    for t, published in zip(FRONT_TIMES, FRONT, strict=True):
        step = round(t * STEPS_PER_UNIT)
        if step < len(fronts):
            found.append((t, fronts[step], (fronts[step] - published) / (published - 2.0)))
    return found


def print_summary(dim, solver, start, end, steps, solving, setup_time, reward, errors) -> None:
    """The table at the end of a run."""
    unit = "J/m" if dim == 2 else "J"
    rows = [
        ("particles", f"{start.particles}"),
        ("device", f"{solver.device}"),
        ("set-up, compiling included", f"{setup_time:.1f} s"),
        ("simulated", f"{end.time:.2f} s in {steps} steps"),
        ("time per step", f"{1e3 * solving / steps:.2f} ms"),
        ("particle-steps per second", f"{1e-6 * steps * start.particles / solving:.2f} million"),
        ("mass", f"{end.mass:.3f} kg (change {end.mass - start.mass:+.1e})"),
        ("energy", f"{start.energy:.1f} to {end.energy:.1f} {unit}"),
        ("largest density error", f"{end.largest_density_error:.2%} (rms {end.rms_density_error:.2%})"),
        ("mean reward", f"{reward:.3f}"),
    ]
    width = max(len(name) for name, _ in rows)
    print()
    for name, value in rows:
        print(f"  {name:<{width}}  {value}")
    print(f"\n  {'front, t sqrt(g/H)':<{width}}  x/H      published  error of travel")
    for (t, x, error), published in zip(errors, FRONT, strict=False):
        print(f"  {t:<{width}}  {x:.4f}   {published:.4f}     {error:+.2%}")


def save(output: Path, picture: np.ndarray, frames: list[np.ndarray], fps: float, film: str) -> None:
    """Write the picture and the film."""
    output.mkdir(parents=True, exist_ok=True)
    written = [output / "dam_break.png"]
    write_png(written[0], picture)
    if film == "gif":
        written.append(output / "dam_break.gif")
        write_gif(written[1], frames, fps)
    elif film == "mp4":
        written.append(output / "dam_break.mp4")
        write_mp4(written[1], frames, fps)
    print("\n  " + "\n  ".join(f"wrote {path}" for path in written))


if __name__ == "__main__":
    sys.exit(main())
