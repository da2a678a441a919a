"""A dam break, watched and measured: python examples/dam_break.py

A column of water collapses in a tank and runs along the floor, as in the experiments everybody compares with. Once its
front has been held against the published curve, the right wall closes in and keeps the water together. All of it goes
through gymnasium.make; a table, a picture and a film are what is left.
"""

import argparse
import math
import os
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from fluidgym.diagnostics import Measurement, measure
from fluidgym.envs.fluid_env import FluidEnv
from fluidgym.envs.tasks.dam_break_contain import close_in
from fluidgym.render import write_gif, write_mp4, write_png
from fluidgym.solver import Solver
from fluidgym.validation.dam_break import FRONT, FRONT_TIMES, HEIGHT, TIME_UNIT, front_errors

STEPS_PER_UNIT = 12  # actions in a time sqrt(H/g), so that every instant of the published curve is met
RESOLUTION = {2: 40, 3: 16}
STILL = round(FRONT_TIMES[-1] * STEPS_PER_UNIT)  # actions before the wall moves: while the front is on the curve
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
    if arguments.film == "mp4" and find_spec("imageio_ffmpeg") is None:
        refuse('--film mp4 needs the extra "render": pip install "fluidgym-sph[render]", or use --film gif')
    arguments.output = arguments.output or Path("outputs") / f"dam_break_{arguments.dim}d"
    return arguments


def refuse(reason: str) -> NoReturn:
    """Say in one line why there is nothing to run."""
    print(f"dam_break.py: {reason}", file=sys.stderr)
    sys.exit(2)


def make_world(arguments: argparse.Namespace) -> gym.Env:
    """The environment; one that cannot be, or a folder that cannot be written to, is refused."""
    dim, resolution = arguments.dim, arguments.resolution
    if not (math.isfinite(arguments.seconds) and arguments.seconds > 0.0):
        refuse(f"--seconds = {arguments.seconds:g} must be above 0 and finite; use 2.5")
    try:
        env = gym.make(
            f"fluidgym:fluidgym/DamBreakContain{dim}D-v0",
            resolution=RESOLUTION[dim] if resolution is None else resolution,
            control_interval=TIME_UNIT / STEPS_PER_UNIT,
            episode=arguments.seconds,
            variation=0.0,
            jitter=0.0,
            depth=1.0 if dim == 3 else None,
            render_mode="rgb_array",
            device=arguments.device,
        )
        arguments.output.mkdir(parents=True, exist_ok=True)
    except ValueError as error:  # one line that names the option and the remedy
        refuse(str(error))
    except OSError as error:
        refuse(f"--output {arguments.output} cannot be made: {error.strerror}; name another folder")
    if not os.access(arguments.output, os.W_OK):
        refuse(f"--output {arguments.output} cannot be written to; name another folder")
    return env


def main() -> int:
    """Run the dam break; 0 if its front keeps to the published curve."""
    arguments = parse_arguments()
    begin = time.perf_counter()
    env = make_world(arguments)
    env.reset(seed=0)
    assert isinstance(env.unwrapped, FluidEnv)
    task, solver = env.unwrapped.task, env.unwrapped.solver
    solver.step(1)  # compiles what is left to compile
    _, info = env.reset(seed=0)
    setup_time = time.perf_counter() - begin
    measured = [measure(solver)]

    frames, solving, total_reward = [look(env)], 0.0, 0.0
    splash, picture = 0.0, frames[0]
    for step in tqdm(range(1, task.max_episode_steps + 1), desc=f"dam break {arguments.dim}D", unit="action"):
        # Hold the wall still while the front is on the published curve, then close in.
        action = np.zeros(1, np.float32) if step <= STILL else close_in(info)
        begin = time.perf_counter()
        _, reward, terminated, truncated, info = env.step(action)
        solving += time.perf_counter() - begin
        total_reward += float(reward)
        measured.append(measure(solver))
        if step % 2 == 0:
            frames.append(look(env))
        if info["splash"] > splash:
            splash, picture = info["splash"], look(env)
        if terminated or truncated:
            break

    actions = len(measured) - 1
    steps = actions * solver.steps_for(task.control_interval)
    errors = front_errors(np.array([m.time for m in measured]), np.array([m.front for m in measured]) / HEIGHT)
    print_summary(solver, measured, steps, solving, setup_time, total_reward / actions, errors)
    save(arguments.output, picture, frames, 0.5 / task.control_interval, arguments.film)
    env.close()
    worst = max((abs(error) for t, error in errors.items() if t >= 1.0), default=0.0)
    if worst > FRONT_ERROR_LIMIT[arguments.dim]:
        print(f"The front is {worst:.1%} off the published curve; use a finer --resolution.", file=sys.stderr)
        return 1
    return 0


def look(env: gym.Env) -> np.ndarray:
    """A picture of the world (height, width, 3)."""
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    return frame


def print_summary(
    solver: Solver,
    measured: list[Measurement],
    steps: int,
    solving: float,
    setup_time: float,
    reward: float,
    errors: dict[float, float],
) -> None:
    """The table at the end of a run."""
    per_depth = "/m" if solver.scene.dim == 2 else ""
    start, end = measured[0], measured[-1]
    still = measured[min(STILL, len(measured) - 1)]  # the last instant at which no wall has done work
    parts = f"{end.kinetic_energy:.1f} kinetic, {end.potential_energy:.1f} potential, {end.elastic_energy:.1f} elastic"
    rows = [
        ("particles", f"{start.particles}"),
        ("device", f"{solver.device}"),
        ("set-up, compiling included", f"{setup_time:.1f} s"),
        ("simulated", f"{end.time:.2f} s in {steps} steps"),
        ("time per step", f"{1e3 * solving / steps:.2f} ms"),
        ("particle-steps per second", f"{1e-6 * steps * start.particles / solving:.2f} million"),
        ("mass", f"{end.mass:.3f} kg{per_depth} (change {end.mass - start.mass:+.1e})"),
        (
            f"energy, wall still to {still.time:.2f} s",
            f"{start.energy:.1f} to {still.energy:.1f} J{per_depth} ({still.energy / start.energy - 1.0:+.1%})",
        ),
        (
            "energy at the end" if still is end else "energy, with the wall's work",
            f"{end.energy:.1f} J{per_depth}: {parts}",
        ),
        ("largest density error", f"{end.largest_density_error:.2%} (rms {end.rms_density_error:.2%})"),
        ("mean reward", f"{reward:.3f}"),
    ]
    width = max(len(name) for name, _ in rows)
    print()
    for name, value in rows:
        print(f"  {name:<{width}}  {value}")
    print(f"\n  {'front, t sqrt(g/H)':<{width}}  x/H      published  error of travel")
    for (t, error), published in zip(errors.items(), FRONT, strict=False):
        print(f"  {t:<{width}}  {published + error * (published - 2.0):.4f}   {published:.4f}     {error:+.2%}")
    if not any(t >= 1.0 for t in errors):
        print(f"  not checked: that starts at t sqrt(g/H) = 1, which takes --seconds {TIME_UNIT:.2f} or more")


def save(output: Path, picture: np.ndarray, frames: list[np.ndarray], fps: float, film: str) -> None:
    """Write the picture and the film."""
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
