"""What a world amounts to: mass, energy, momentum, front, density error, pressure at a place. NumPy, on demand.

The functions take a start of the fluid or a present one, as `Particles`, and the scene they belong to. `measure` reads
one world of a solver and returns all of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluidgym.scene import Particles, Scene, face_names
from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.shapes import Ball
from fluidgym.solver import Solver

# Past these fluid has blown up, though its numbers may still be finite. The worst actions compress it by 0.1 to 0.3.
# Where it has torn, 1 - rho/rho_0 is the share that is void, which has no pressure; they bring that to 0.5.
LARGEST_COMPRESSION = 0.5
LARGEST_VOID = 0.8

# Nodes and weights on [-1, 1] of the quadrature for elastic energy; exact to rounding for any smooth state equation.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True)
class Measurement:
    """One world at one instant. In two dimensions everything extensive is per metre of depth.

    Attributes:
        time: Since the reset [s].
        particles: Number of particles in the box.
        emitted: Number of particles that nozzles have added.
        retired: Number of particles that left through open faces and outflows.
        mass: [kg].
        kinetic_energy: [J].
        potential_energy: Zero at the origin [J].
        elastic_energy: Of compression [J].
        momentum: [kg m/s], (dim,).
        center_of_mass: [m], (dim,).
        second_moments: Mean of (x - center)(x - center)^T [m2], (dim, dim).
        front: Largest x plus half a spacing [m].
        rms_speed: [m/s].
        largest_speed: [m/s].
        largest_density_error: Largest |rho/rho_0 - 1|.
        rms_density_error: Root mean square of rho/rho_0 - 1.
        largest_compression: Largest rho/rho_0 - 1; 0 where all are thinner.
    """

    time: float
    particles: int
    emitted: int
    retired: int
    mass: float
    kinetic_energy: float
    potential_energy: float
    elastic_energy: float
    momentum: np.ndarray
    center_of_mass: np.ndarray
    second_moments: np.ndarray
    front: float
    rms_speed: float
    largest_speed: float
    largest_density_error: float
    rms_density_error: float
    largest_compression: float

    @property
    def credible(self) -> bool:
        """Whether nothing has blown up."""
        dense, thin = self.largest_compression, self.largest_density_error
        return math.isfinite(self.energy) and dense < LARGEST_COMPRESSION and thin < LARGEST_VOID

    @property
    def energy(self) -> float:
        """Kinetic, potential and elastic energy together [J]."""
        return self.kinetic_energy + self.potential_energy + self.elastic_energy


def measure(solver: Solver, world: int = 0) -> Measurement:
    """Read one world of a solver.

    Raises:
        IndexError: There is no such world.
    """
    particles, scene, account = solver.particles(world), solver.scene, solver.account(world)
    s = density_error(particles, scene)
    return Measurement(
        time=float(solver.time[world]),
        particles=len(particles),
        emitted=account.emitted,
        retired=account.retired,
        mass=mass(particles, scene),
        kinetic_energy=kinetic_energy(particles, scene),
        potential_energy=potential_energy(particles, scene, solver.gravity[world]),
        elastic_energy=elastic_energy(
            particles,
            scene,
            solver.scheme,
            sound_speed=solver.parameter("sound_speed")[world],
            gamma=solver.parameter("gamma")[world],
        ),
        momentum=momentum(particles, scene),
        center_of_mass=center_of_mass(particles),
        second_moments=second_moments(particles),
        front=front(particles, scene),
        rms_speed=rms_speed(particles),
        largest_speed=largest_speed(particles),
        largest_density_error=float(np.abs(s).max(initial=0.0)),
        rms_density_error=_rms(s),
        largest_compression=float(s.max(initial=0.0)),
    )


def mass(particles: Particles, scene: Scene) -> float:
    """Mass of the fluid [kg]."""
    return len(particles) * scene.particle_mass


def kinetic_energy(particles: Particles, scene: Scene) -> float:
    """Kinetic energy [J]."""
    return 0.5 * scene.particle_mass * float((particles.velocity.astype(float) ** 2).sum())


def potential_energy(particles: Particles, scene: Scene, gravity: Sequence[float] | np.ndarray | None = None) -> float:
    """Energy in gravity and the central force [J], zero at the origin; gravity [m/s2] (dim,), None is the scene's."""
    g = scene.gravity_vector if gravity is None else np.asarray(gravity, float)
    position = particles.position.astype(float)
    pull = 0.5 * scene.central_force * (position**2).sum()
    return scene.particle_mass * float(pull - (position @ g).sum())


def elastic_energy(
    particles: Particles,
    scene: Scene,
    scheme: Scheme = DEFAULT_SCHEME,
    sound_speed: float | None = None,
    gamma: float | None = None,
) -> float:
    """Energy of compression [J]: the integral of p over s, from rest, for each rest volume.

    It is just what the pressure force of the scheme takes from the kinetic energy, for any state equation; for the
    linear one it is m c_0^2 s^2 / 2. Speed of sound [m/s] and gamma are those of the scene and the scheme unless given.
    """
    law, gamma = scheme.pressure_law, scheme.gamma if gamma is None else gamma
    s = density_error(particles, scene)
    pressure = law.pressure_of(s, gamma)
    whole = law.density_of(pressure, gamma)  # s up to where fluid tears; the law has a kink there, and is flat beyond
    share = 0.5 * whole[:, None] * (1.0 + _NODES)
    integral = 0.5 * whole * (law.pressure_of(share, gamma) @ _WEIGHTS) + pressure * (s - whole)
    return scene.particle_mass * (sound_speed or scene.sound_speed) ** 2 * float(integral.sum())


def momentum(particles: Particles, scene: Scene) -> np.ndarray:
    """Momentum [kg m/s], (dim,)."""
    return scene.particle_mass * particles.velocity.astype(float).sum(axis=0)


def center_of_mass(particles: Particles) -> np.ndarray:
    """Centre of mass [m], (dim,); nan without particles."""
    if not len(particles):
        return np.full(particles.position.shape[1], np.nan)
    return particles.position.astype(float).mean(axis=0)


def second_moments(particles: Particles) -> np.ndarray:
    """Mean of (x - center)(x - center)^T [m2], (dim, dim); nan without particles."""
    dim = particles.position.shape[1]
    if not len(particles):
        return np.full((dim, dim), np.nan)
    offset = particles.position - center_of_mass(particles)
    return offset.T @ offset / len(particles)


def front(particles: Particles, scene: Scene) -> float:
    """How far the fluid reaches along x [m]: the largest x plus half a spacing; nan without particles."""
    if not len(particles):
        return float("nan")
    return float(particles.position[:, 0].max()) + 0.5 * scene.particle_spacing


def rms_speed(particles: Particles) -> float:
    """Root mean square of the speed [m/s]."""
    return _rms(np.linalg.norm(particles.velocity.astype(float), axis=1))


def largest_speed(particles: Particles) -> float:
    """Largest speed [m/s]."""
    return float(np.linalg.norm(particles.velocity.astype(float), axis=1).max(initial=0.0))


def density_error(particles: Particles, scene: Scene) -> np.ndarray:
    """rho/rho_0 - 1 of each particle, (particle,)."""
    return particles.density / scene.material.density - 1.0


def retired_particles(solver: Solver, world: int = 0) -> int:
    """How many particles of a world have left through open faces and outflows since its reset."""
    return solver.account(world).retired


def pressure_at(solver: Solver, points: np.ndarray, world: int = 0) -> np.ndarray:
    """Pressure at places [Pa], (n,): the mean of the particles near by and their images, weighed by the kernel.

    The weights are those of Wendland C2, whatever the scheme's kernel, with its smoothing length, made to add up to one
    (Shepard 1968). The images are those of the solver's pressure force: beyond a periodic face the other side of the
    box, behind a wall its reflection, with the pressure of gravity carried on through the wall, but not below zero (or
    below the particle's own pressure, where that is negative). What a body hides does not count: a place at a thin gate
    has the pressure of its own side. A place that no particle reaches has no pressure.

    Args:
        solver: The solver.
        points: Places [m], (n, dim).
        world: Number of the world.

    Raises:
        ValueError: The places are not finite or have another shape.
    """
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != solver.scene.dim or not np.isfinite(points).all():
        raise ValueError(
            f"pressure_at points of shape {points.shape} must be finite, (n, {solver.scene.dim}); give one row a place"
        )
    reach = 2.0 * solver.scheme.smoothing_length(solver.scene.particle_spacing, solver.scene.dim)
    position, pressure = _with_images(solver, world, reach)
    near = np.all((position > points.min(axis=0) - reach) & (position < points.max(axis=0) + reach), axis=1)
    distance = np.linalg.norm(points[:, None] - position[near], axis=2)
    t = np.maximum(1.0 - distance / reach, 0.0)
    weight = t**4 * (5.0 - 4.0 * t)
    for body in range(len(solver.scene.bodies)):
        weight[_hidden(solver, world, body, points, position[near])] = 0.0
    total = weight.sum(axis=1)
    return weight @ pressure[near] / np.where(total > 0.0, total, 1.0)


def _hidden(solver: Solver, world: int, body: int, points: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Which particles (m, dim) a body hides from which places (n, dim): bool (n, m).

    A box does where the line between the two goes in and out by opposite sides, as in the solver's sums.
    """
    bodies = solver.state.bodies
    if isinstance(list(solver.scene.bodies.values())[body].shape, Ball):
        return np.zeros((len(points), len(position)), bool)  # a ball hides next to nothing
    half = bodies.half.numpy()[body].astype(float)
    start = (points - bodies.position.numpy()[world, body].astype(float))[:, None]
    way = position[None] - points[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-half - start) / way, (half - start) / way
    into, out = np.fmin(one, other), np.fmax(one, other)
    begin, end = into.max(axis=2), out.min(axis=2)
    crosses = (begin < end) & (end > 0.0) & (begin < 1.0)
    return crosses & (into.argmax(axis=2) == out.argmin(axis=2))


def _with_images(solver: Solver, world: int, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] (n, dim) and pressure [Pa] (n,) of the particles and of their images within reach [m] of the box."""
    particles, scene = solver.particles(world), solver.scene
    faces = solver.state.faces
    at, acceleration = faces.position.numpy()[world].astype(float), faces.acceleration.numpy()[world]
    position, pressure = particles.position.astype(float), particles.pressure
    lift = np.zeros(len(position))  # what gravity adds on the way through walls
    for axis in range(scene.dim):
        low, high = 2 * axis, 2 * axis + 1
        images = [(position, pressure, lift)]
        for face, other in ((low, high), (high, low)):
            kind = scene.faces[face_names(scene.dim)[face]].kind
            if kind == "open":
                continue
            close = np.abs(position[:, axis] - at[face]) < reach
            image = position[close].copy()
            if kind == "periodic":
                image[:, axis] += at[other] - at[face]
                change = 0.0
            else:
                image[:, axis] = 2.0 * at[face] - image[:, axis]
                gravity = solver.gravity[world, axis] - scene.central_force * position[close, axis]
                pull = scene.material.density * (gravity - acceleration[face])
                change = pull * (image[:, axis] - position[close, axis])
            images.append((image, pressure[close], lift[close] + change))
        position, pressure, lift = (np.concatenate(parts) for parts in zip(*images, strict=True))
    return position, np.maximum(pressure + lift, np.minimum(pressure, 0.0))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
