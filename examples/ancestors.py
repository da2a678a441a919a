"""The methods this field began with, beside the default: python examples/ancestors.py

One dam break, run with the density sums and forces of Mueller, Charypar & Gross (2003), with springs, clamps or frozen
particles for walls, and with the default scheme; a table of run time against error, and a picture. Then still water
under three integrators, to show which of them hold.

Settings under which the old methods hold up: kernels that reach h = 2 spacings, Tait's equation with gamma 7 and no
tension, steps of 0.4 h/c, leapfrog or symplectic Euler, and a viscosity of at least c h / 160. Their density is summed
with one kernel and their pressure pushes with another, so there is no energy that both belong to: on its way round a
loop of states the fluid can gain some, whatever the time step, and most where it lies on a wall with nothing behind it
to complete its sums. Viscosity has to take that out again: with a third of it still water boils, and walls that clamp
want twice as much.
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np
from tqdm import tqdm

from fluidgym import Box, Fluid, Material, Particles, Scene, Solver
from fluidgym.diagnostics import measure
from fluidgym.render import draw_frame, write_png
from fluidgym.scheme import DEFAULT_SCHEME, MUELLER, Scheme
from fluidgym.solver import find_device
from fluidgym.sph.integrators import EXPLICIT_EULER, LEAPFROG, SYMPLECTIC_EULER
from fluidgym.sph.state_equation import LINEAR, TAIT
from fluidgym.sph.wall_models import ClampWalls, FrozenWalls, MirrorWalls, PenaltyWalls
from fluidgym.validation.dam_break import FRONT_TIMES, HEIGHT, TIME_UNIT, front_errors
from fluidgym.validation.dam_break import scene as dam_break

RESOLUTION, QUICK_RESOLUTION = 40, 20  # particles over the column's height
VISCOSITY = 1.0 / 160.0  # over c h, what the old methods need
ANCESTOR = replace(MUELLER, state_equation=TAIT, integrator=LEAPFROG)

# What is compared: a name, a scheme, and the viscosity it is given, over c h.
METHODS = (
    ("default: delta-SPH, mirror walls", DEFAULT_SCHEME, 0.0),
    ("default, frozen walls", Scheme(walls=FrozenWalls()), 0.0),
    ("Mueller, mirror walls", replace(ANCESTOR, walls=MirrorWalls()), VISCOSITY),
    ("Mueller, penalty walls", replace(ANCESTOR, walls=PenaltyWalls()), VISCOSITY),
    ("Mueller, penalty, linear", replace(ANCESTOR, state_equation=LINEAR), VISCOSITY),
    ("Mueller, penalty, symplectic Euler", replace(ANCESTOR, integrator=SYMPLECTIC_EULER), VISCOSITY),
    ("Mueller, clamp walls", replace(ANCESTOR, walls=ClampWalls()), 2.0 * VISCOSITY),
    ("Mueller, frozen walls", replace(ANCESTOR, walls=FrozenWalls()), VISCOSITY),
    ("Mueller, penalty, no viscosity", ANCESTOR, 0.0),
)
SHOWN = (0, 2, 3, 8)  # in the picture, and all that is run if quick

STILL_STEP = 0.0005  # [s]
STILL_TIMES = (0.05, 0.1, 0.2, 0.5, 1.0)  # [s]
STILL = Scene(
    lower=(0.0, 0.0),
    upper=(1.0, 1.0),
    particle_spacing=0.05,
    fluid=[Fluid(Box((0.0, 0.0), (1.0, 0.5)))],
    material=Material(viscosity=0.05, sound_speed=80.0),  # c h / 160 for a reach h of 0.1 m
    reference_speed=16.0,
)
INTEGRATORS = (LEAPFROG, SYMPLECTIC_EULER, EXPLICIT_EULER)


@dataclass
class Run:
    """What a method made of the dam break.

    Attributes:
        name: Of the method.
        scene: What was simulated.
        particles: At the end.
        steps: Number of steps.
        seconds: That they took [s].
        errors: Of the front at the instants of the published curve, over its travel.
        energy: At the end over that at the start, less 1.
        lost: Particles that are no longer in the box.
    """

    name: str
    scene: Scene
    particles: Particles
    steps: int
    seconds: float
    errors: dict[float, float]
    energy: float
    lost: int

    @property
    def worst(self) -> float:
        """Largest error of the front from t sqrt(g/H) = 1 on."""
        return max(abs(error) for t, error in self.errors.items() if t >= 1.0)


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resolution", type=int, help="particles over the column's height (default: 40; 20 if quick)")
    parser.add_argument("--quick", action="store_true", help="fewer methods, and coarser: a few seconds")
    parser.add_argument("--device", default=None, help="cpu, cuda, ... (default: a GPU where there is one)")
    parser.add_argument("--output", type=Path, default=Path("outputs/ancestors"), help="folder (outputs/ancestors)")
    arguments = parser.parse_args()
    if arguments.resolution is None:
        arguments.resolution = QUICK_RESOLUTION if arguments.quick else RESOLUTION
    return arguments


def refuse(reason: str) -> NoReturn:
    """Say in one line why there is nothing to run."""
    print(f"ancestors.py: {reason}", file=sys.stderr)
    sys.exit(2)


def make_ready(arguments: argparse.Namespace) -> None:
    """Refuse what cannot be run or written, before anything is."""
    if not 10 <= arguments.resolution <= 200:
        refuse(f"--resolution = {arguments.resolution} is outside 10 to 200; use {RESOLUTION}")
    try:
        find_device(arguments.device)
        arguments.output.mkdir(parents=True, exist_ok=True)
    except ValueError as error:  # one line that names the option and the remedy
        refuse(str(error))
    except OSError as error:
        refuse(f"--output {arguments.output} cannot be made: {error.strerror}; name another folder")
    if not os.access(arguments.output, os.W_OK):
        refuse(f"--output {arguments.output} cannot be written to; name another folder")


def main() -> int:
    """Run all of it; 0 if every method does what it is known to do."""
    arguments = parse_arguments()
    make_ready(arguments)
    methods = [METHODS[index] for index in SHOWN] if arguments.quick else METHODS
    with tqdm(total=len(methods) * len(FRONT_TIMES) + len(INTEGRATORS), unit="piece") as bar:
        runs = [run_dam_break(*method, arguments, bar) for method in methods]
        energies = {
            steps.name: hold_still(replace(ANCESTOR, integrator=steps), arguments, bar) for steps in INTEGRATORS
        }
    print_runs(runs)
    print_energies(energies)
    picture = arguments.output / "ancestors.png"
    write_png(picture, draw(runs))
    print(f"\n  wrote {picture}")
    complaints = check(runs, energies)
    for complaint in complaints:
        print(complaint, file=sys.stderr)
    return 1 if complaints else 0


def run_dam_break(name: str, scheme: Scheme, share: float, arguments: argparse.Namespace, bar: tqdm) -> Run:
    """The dam break under a scheme, with a viscosity that is a share of c h."""
    bar.set_description(name)
    scene = dam_break(arguments.resolution, 2)
    sound_speed, reach = scene.sound_speed, 2.0 * scene.particle_spacing
    scene = replace(scene, material=Material(viscosity=share * sound_speed * reach, sound_speed=sound_speed))
    solver = Solver(scene, scheme, device=arguments.device)
    solver.step(1)  # compiles what is left to compile
    solver.reset()
    start, fronts, steps, seconds = measure(solver), [], 0, 0.0
    for duration in TIME_UNIT * np.diff(FRONT_TIMES, prepend=0.0):
        steps += solver.steps_for(duration)
        begin = time.perf_counter()
        solver.advance(duration)
        end = measure(solver)
        seconds += time.perf_counter() - begin
        fronts.append(end.front / HEIGHT)
        bar.update()
    return Run(
        name=name,
        scene=scene,
        particles=solver.particles(),
        steps=steps,
        seconds=seconds,
        errors=front_errors(TIME_UNIT * FRONT_TIMES, np.array(fronts)),
        energy=end.energy / start.energy - 1.0,
        lost=start.particles - end.particles,
    )


def hold_still(scheme: Scheme, arguments: argparse.Namespace, bar: tqdm) -> list[float]:
    """Energy of still water at some instants, over that at the start."""
    bar.set_description(f"still water, {scheme.steps.name}")
    solver = Solver(STILL, scheme, device=arguments.device)
    start, energies = measure(solver).energy, []
    for duration in np.diff(STILL_TIMES, prepend=0.0):
        solver.step(round(duration / STILL_STEP), STILL_STEP)
        energies.append(measure(solver).energy / start)
    bar.update()
    return energies


def print_runs(runs: list[Run]) -> None:
    """The table of run time against error."""
    particles = len(runs[0].particles)
    print(f"\n  dam break in 2D, {particles} particles, to t sqrt(g/H) = {FRONT_TIMES[-1]:g}")
    print(f"\n  {'method':<36} {'front error':>11} {'at the end':>10} {'energy':>9} {'steps':>6} {'time':>8}")
    for run in runs:
        *_, last = run.errors.values()
        print(
            f"  {run.name:<36} {run.worst:>11.2%} {last:>+10.2%} {run.energy:>+9.1%} {run.steps:>6}"
            f" {run.seconds:>6.2f} s"
        )
    print("\n  front error: the largest over its travel for t sqrt(g/H) >= 1, against the published curve")


def print_energies(energies: dict[str, list[float]]) -> None:
    """The table of integrators."""
    print(f"\n  still water, {STILL_STEP * 1e3:g} ms a step: energy over that at the start")
    print(f"\n  {'integrator':<36}" + "".join(f"{t:>8g} s" for t in STILL_TIMES))
    for name, values in energies.items():
        print(f"  {name:<36}" + "".join(f"{value:>10.3g}" for value in values))


def draw(runs: list[Run]) -> np.ndarray:
    """The end of some of the runs, side by side."""
    tiles = []
    shown = [METHODS[index][0] for index in SHOWN]
    for run in (run for run in runs if run.name in shown):
        speed = np.linalg.norm(run.particles.velocity, axis=1)
        tiles.append(
            draw_frame(
                run.particles.position,
                speed,
                lower=run.scene.lower,
                upper=run.scene.upper,
                spacing=run.scene.particle_spacing,
                value_range=(0.0, 5.0),
                time=TIME_UNIT * FRONT_TIMES[-1],
                title=run.name,
                text=f"front {run.worst:.1%} off at most, {run.seconds:.1f} s",
                size=(640, 480),
            )
        )
    return np.concatenate([np.concatenate(tiles[row : row + 2], axis=1) for row in range(0, len(tiles), 2)])


def check(runs: list[Run], energies: dict[str, list[float]]) -> list[str]:
    """What is not as it is known to be."""
    default, *others = runs
    complaints = [f"{run.name} has lost {run.lost} particles" for run in runs if run.lost]
    if not default.worst <= 0.05:  # so that no number counts as a bad one
        complaints.append(f"The front of the default scheme is {default.worst:.1%} off; use a finer --resolution.")
    complaints += [f"{run.name} has a better front than the default" for run in others if run.worst < default.worst]
    # Without viscosity they gain energy, and with it they lose some.
    complaints += [
        f"{run.name} has gained {run.energy:.1%} of its energy"
        for run in runs
        if not run.energy <= 0.01 and run.name != "Mueller, penalty, no viscosity"
    ]
    for name in (LEAPFROG.name, SYMPLECTIC_EULER.name):
        if not max(energies[name]) < 1.01:
            complaints.append(f"Still water has gained energy under {name}")
    if energies[EXPLICIT_EULER.name][-1] < 100.0:
        complaints.append("Still water has not exploded under explicit Euler")
    return complaints


if __name__ == "__main__":
    sys.exit(main())
