"""The solver without any environment: python examples/script_the_solver.py

A tank of still water is pushed by its right wall, and the pressure on the left wall is read as it goes: first that of
still water, then the blow of the wave, then that of the deeper water.
"""

import argparse

import numpy as np

from fluidgym import Box, Face, Fluid, Scene, Solver
from fluidgym.diagnostics import measure, pressure_at

DEPTH, LENGTH, STROKE = 0.5, 1.0, 0.2  # [m]
GRAVITY, DENSITY = 9.81, 1000.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resolution", type=int, default=20, help="particles over the depth (default: 20)")
    parser.add_argument("--device", default=None, help="cpu, cuda, ... (default: a GPU where there is one)")
    arguments = parser.parse_args()
    if arguments.resolution < 4:
        parser.exit(2, f"script_the_solver.py: --resolution = {arguments.resolution} must be 4 or more; use 20\n")
    scene = Scene(
        lower=(0.0, 0.0),
        upper=(LENGTH, 1.0),
        particle_spacing=DEPTH / arguments.resolution,
        fluid=[Fluid(Box((0.0, 0.0), (LENGTH, DEPTH)), pressure="hydrostatic")],
        faces={"x_max": Face(moving=True, travel=(LENGTH - STROKE, LENGTH))},
        gravity=GRAVITY,
    )
    try:
        solver = Solver(scene, device=arguments.device)
    except ValueError as error:  # one line that names the argument and the remedy
        parser.exit(2, f"script_the_solver.py: {error}\n")
    wall = solver.face_index("x_max")
    probe = np.array([[0.0, 0.1]])
    expected = DENSITY * GRAVITY * (DEPTH - 0.1)
    still = pressure_at(solver, probe)[0]
    print(f"still water:   {still:6.0f} Pa at the probe, rho g depth {expected:.0f} Pa ({still / expected - 1:+.1%})")

    peak = 0.0
    for _ in range(150):  # 3 s
        t = solver.time[0]
        # The velocity the wall is to have at the end of the interval, reached at constant acceleration.
        solver.face_velocity[:, wall] = -0.5 if 0.19 < t < 0.59 else 0.0
        solver.advance(0.02)
        peak = max(peak, pressure_at(solver, probe)[0])
    print(f"largest:       {peak:6.0f} Pa")

    pressures = []
    for _ in range(100):  # 2 s more, over which the waves are averaged out
        solver.advance(0.02)
        pressures.append(pressure_at(solver, probe)[0])
    deeper = DEPTH * LENGTH / solver.face_position("x_max")[0]
    expected, mean = DENSITY * GRAVITY * (deeper - 0.1), float(np.mean(pressures))
    print(f"deeper water:  {mean:6.0f} Pa, rho g depth {expected:.0f} Pa ({mean / expected - 1:+.1%})")
    now = measure(solver)
    print(
        f"wall at {solver.face_position('x_max')[0]:.3f} m, mass {now.mass:.1f} kg, rms speed {now.rms_speed:.3f} m/s"
    )
    assert abs(mean / expected - 1.0) < 0.05


if __name__ == "__main__":
    main()
