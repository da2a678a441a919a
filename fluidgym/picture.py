"""A picture of a world of a solver: what its scene and its present state are to `draw_frame`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fluidgym.render import draw_frame
from fluidgym.render.shot import Shot, check_shot
from fluidgym.scene import Particles, Scene, face_names
from fluidgym.shapes import Ball
from fluidgym.solver import Solver

LABELS = {
    "speed": "speed [m/s]",
    "pressure": "pressure [Pa]",
    "density": "density [kg/m3]",
    "temperature": "temperature",
}


def picture(
    solver: Solver,
    world: int = 0,
    *,
    colour: str = "speed",
    value_range: tuple[float, float] | None = None,
    **annotations: Any,
) -> np.ndarray:
    """Draw a world: its fluid, walls, bodies, nozzles and drains where they are now.

    Args:
        solver: The solver.
        world: Number of the world.
        colour: By what: "speed", "pressure", "density" or "temperature".
        value_range: Values at the two ends of the colour bar; None is `usual_range`.
        annotations: What else `draw_frame` takes: time, title, text, zone, grid, size, spheres, camera.

    Returns:
        The picture (height, width, 3), uint8.

    Raises:
        IndexError: There is no such world.
    """
    scene, particles = solver.scene, solver.particles(world)
    low, high = value_range or usual_range(scene, colour)
    label, unit = LABELS[colour], 1.0
    if colour == "pressure" and max(-low, high) >= 1000.0:
        label, unit = "pressure [kPa]", 1000.0
    return draw_frame(
        particles.position,
        values_of(particles, colour) / unit,
        lower=scene.lower,
        upper=scene.upper,
        spacing=scene.particle_spacing,
        faces=face_shapes(solver, world),
        bodies=body_shapes(solver, world),
        inflows=_inflows(solver, world),
        outflows=_outflows(scene),
        value_range=(low / unit, high / unit),
        label=label,
        **annotations,
    )


def shot_of(solver: Solver, world: int = 0, layers: int = 1) -> Shot:
    """What is drawn of a world in three dimensions; one of two is made a slab of so many layers along y."""
    scene, particles = solver.scene, solver.particles(world)
    faces, dx = face_shapes(solver, world), scene.particle_spacing
    places, lower, upper = particles.position.astype(float), np.array(scene.lower), np.array(scene.upper)
    if scene.dim == 2:
        across = dx * (np.arange(layers) + 0.5 - 0.5 * layers)
        places = np.concatenate([np.insert(places, 1, y, axis=1) for y in across])
        lower, upper = np.insert(lower, 1, -0.5 * layers * dx), np.insert(upper, 1, 0.5 * layers * dx)
        still = {"kind": "wall", "moving": False}
        ends = {f"y_{end}": {**still, "position": float(at[1])} for end, at in (("min", lower), ("max", upper))}
        faces = {name.replace("y", "z"): face for name, face in faces.items()} | ends
    return check_shot(
        places, np.zeros(len(places)), lower=lower, upper=upper, spacing=dx, faces=faces, value_range=(0.0, 1.0),
        label="", time=None, title=None, text=(), zone=None, bodies=(), inflows=(), outflows=(),
        size=(640, 400),
    )  # fmt: skip


def values_of(particles: Particles, colour: str) -> np.ndarray:
    """What the particles are coloured by (particle,), in SI units."""
    if colour == "speed":
        return np.linalg.norm(particles.velocity, axis=1)
    values = getattr(particles, colour)
    return np.zeros(len(particles)) if values is None else values


def usual_range(scene: Scene, colour: str) -> tuple[float, float]:
    """Ends of a colour bar that suit a scene and stay the same through its film."""
    speed, density = scene.speed_scale, scene.material.density
    if colour == "speed":
        return 0.0, speed
    if colour == "pressure":
        return 0.0, density * speed**2
    if colour == "density":
        share = (speed / scene.sound_speed) ** 2
        return density * (1.0 - share), density * (1.0 + share)
    start = scene.sample().temperature
    parts: Sequence[Any] = (*scene.faces.values(), *scene.bodies.values(), *scene.inflows.values())
    given = [part.temperature for part in parts if part.temperature is not None]
    every = np.concatenate([np.empty(0) if start is None else start, given])
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
    return (low, high) if high > low else (low, low + 1.0)


def face_shapes(solver: Solver, world: int) -> dict[str, dict[str, Any]]:
    """The faces of a world where they are now, as `draw_frame` takes them."""
    scene, positions = solver.scene, solver.state.faces.position.numpy()[world]
    return {
        name: {"kind": scene.faces[name].kind, "position": float(position), "moving": scene.faces[name].moving}
        for name, position in zip(face_names(scene.dim), positions, strict=True)
    }


def body_shapes(solver: Solver, world: int) -> list[dict[str, Any]]:
    """The bodies of a world where they are now, as `draw_frame` takes them."""
    solids = []
    for name, body in solver.scene.bodies.items():
        middle = solver.body_position(name)[world].astype(float)
        solid: dict[str, Any] = {"name": name, "moving": body.moving}
        if isinstance(body.shape, Ball):
            solid |= {"shape": "ball", "center": middle, "radius": body.shape.radius}
        else:
            low, high = body.shape.bounds()
            solid |= {"shape": "box", "lower": middle - 0.5 * (high - low), "upper": middle + 0.5 * (high - low)}
        solids.append(solid)
    return solids


def _inflows(solver: Solver, world: int) -> list[Mapping[str, Any]]:
    return [
        {
            "name": name,
            "center": solver.inflow_center[world, index],
            "direction": solver.inflow_direction[world, index],
            "width": float(solver.inflow_width[world, index]),
            "height": inflow.height,
            "length": inflow.pipe_length(solver.scene.particle_spacing),
            "on": bool(solver.inflow_speed[world, index] > 0.0),
        }
        for index, (name, inflow) in enumerate(solver.scene.inflows.items())
    ]


def _outflows(scene: Scene) -> list[Mapping[str, Any]]:
    return [
        {"name": name, "lower": outflow.region.lower, "upper": outflow.region.upper}
        for name, outflow in scene.outflows.items()
    ]
