"""Walls by images: against a sum over explicit mirror particles, in double precision and by brute force."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest

from fluidgym.layout import lattice_laplacian
from fluidgym.scene import NO_SLIP_WALL, OPEN, PERIODIC, Box, Face, Fluid, Material, Particles, Scene, face_names
from fluidgym.solver import Solver
from fluidgym.sph.smoothing import WENDLAND_C2

DX = 0.1
DELTA, ALPHA = 0.1, 0.01  # of the default scheme


def make_scene(faces, dim=2, size=None, gravity=(0.0, -9.81), viscosity=0.0):
    """A box full of jittered fluid; the corner is not the origin."""
    size = size or (0.8,) * dim
    lower = (0.3, -0.2, 0.1)[:dim]
    upper = tuple(low + length for low, length in zip(lower, size, strict=True))
    return Scene(
        lower,
        upper,
        DX,
        Fluid(Box(lower, upper)),
        faces=faces,
        gravity=gravity,
        material=Material(viscosity=viscosity, sound_speed=25.0),
        reference_speed=2.0,
        jitter=0.3,
        seed=5,
    )


MOVING = Face(moving=True)
PERIODIC_X = {"x_min": PERIODIC, "x_max": PERIODIC}
SCENES = {
    "free walls, one moving": make_scene({"x_min": MOVING}),
    "periodic between no-slip walls that slide": make_scene(
        {**PERIODIC_X, "y_min": Face(slip="no", sliding=(0.7, 0.0)), "y_max": Face(slip="no", sliding=(-0.4, 0.0))},
        viscosity=0.05,
    ),
    "corner of two no-slip walls": make_scene(
        {"x_min": NO_SLIP_WALL, "x_max": OPEN, "y_min": NO_SLIP_WALL, "y_max": OPEN}, viscosity=0.05
    ),
    "periodic, no gravity": make_scene({**PERIODIC_X, "y_min": PERIODIC, "y_max": PERIODIC}, gravity=0.0),
    "open, no gravity": make_scene(dict.fromkeys(face_names(2), OPEN), gravity=0.0),
    "3D, free walls, one moving": make_scene(
        {"z_min": MOVING}, dim=3, size=(0.6, 0.5, 0.6), gravity=(3.0, -2.0, -9.81)
    ),
    "3D, all kinds": make_scene(
        {**PERIODIC_X, "y_min": NO_SLIP_WALL, "y_max": OPEN, "z_min": Face(slip="no", moving=True), "z_max": OPEN},
        dim=3,
        size=(0.5, 0.5, 0.5),
        gravity=(0.0, 1.0, -9.81),
        viscosity=0.02,
    ),
}


# -- the reference ---------------------------------------------------------------------------------------------------


@dataclass
class Instant:
    """Particles and faces at one instant, in order of identity."""

    x: np.ndarray
    u: np.ndarray
    s: np.ndarray
    a: np.ndarray
    wall: np.ndarray  # position of each face
    wall_u: np.ndarray
    wall_a: np.ndarray


def read(solver):
    """The present of world 0."""
    saved, n = solver.save(), solver.capacity
    order = np.argsort(saved["identity"][:n])
    faces = [saved[f"face_{name}"][0].astype(float) for name in ("position", "velocity", "acceleration")]
    columns = [saved[name][..., :n][..., order].T.astype(float) for name in ("position", "velocity")]
    s, a = (saved[name][..., :n][..., order].T.astype(float) for name in ("density_error", "acceleration"))
    return Instant(*columns, s, a, *faces)


class Reference:
    """The equations of the default scheme, summed over every pair and every mirror particle."""

    def __init__(self, scene):
        self.scene, self.dim = scene, scene.dim
        self.h = {2: 1.5, 3: 1.3}[scene.dim] * scene.particle_spacing
        self.c_0, self.g = scene.sound_speed, np.asarray(scene.gravity)
        self.V = scene.particle_spacing**scene.dim
        self.nu = scene.material.viscosity
        self.nu_lattice = self.nu / lattice_laplacian(WENDLAND_C2, self.h / scene.particle_spacing, self.dim)
        self.K = max(0.0, ALPHA * self.h * self.c_0 - 2 * (self.dim + 2) * self.nu)

    def slope(self, r):
        """W'(r)/r of Wendland C2."""
        sigma = {2: 7 / (4 * math.pi), 3: 21 / (16 * math.pi)}[self.dim] / self.h**self.dim
        return -5 * sigma / self.h**2 * np.maximum(1 - r / (2 * self.h), 0) ** 3

    def mirrors(self, now):
        """All particles and their images: place, velocity, velocity for viscosity, what gravity adds to p/(rho c^2).

        Where a wall that moves meets one that holds the fluid, the image of the edge depends on the order of the
        reflections, and physics leaves it open: here the last axis is reflected first.
        """
        names = face_names(self.dim)
        everything = []
        for choice in itertools.product((None, 0, 1), repeat=self.dim):
            x, u, v, lift = now.x.copy(), now.u.copy(), now.u.copy(), np.zeros(len(now.x))
            possible = True
            for k, side in reversed(list(enumerate(choice))):
                if side is None:
                    continue
                face, number = self.scene.faces[names[2 * k + side]], 2 * k + side
                if face.kind == "open":
                    possible = False
                elif face.kind == "periodic":
                    x[:, k] += (1 - 2 * side) * (now.wall[2 * k] - now.wall[2 * k + 1])
                else:
                    x[:, k] = 2 * now.wall[number] - x[:, k]
                    u[:, k] = 2 * now.wall_u[number] - u[:, k]
                    lift += (self.g[k] - now.wall_a[number]) * (x[:, k] - now.x[:, k]) / self.c_0**2
                    if face.slip == "no":
                        wall_u = np.array(face.sliding or (0.0,) * self.dim)
                        wall_u[k] += now.wall_u[number]
                        v = 2 * wall_u - v
                    else:
                        v[:, k] = 2 * now.wall_u[number] - v[:, k]
            if possible:
                everything.append((x, u, v, lift))
        return everything

    def density_rate(self, now):
        """ds/dt, and the weight of the company each particle keeps."""
        rate, company = np.zeros(len(now.x)), np.full(len(now.x), self.slope(0.0))
        for x, u, _, lift in self.mirrors(now):
            d = now.x[:, None] - x[None]
            r = np.linalg.norm(d, axis=2)
            slope = self.slope(r)
            xu = (d * (now.u[:, None] - u[None])).sum(axis=2)
            s_m = now.s + lift + d @ self.g / self.c_0**2  # less what gravity makes of it at the place of i
            rate += self.V * (slope * (xu + 2 * DELTA * self.h * self.c_0 * (now.s[:, None] - s_m))).sum(axis=1)
            company -= slope.sum(axis=1)
        return rate, company * self.V * self.h**2

    def acceleration(self, now):
        """du/dt."""
        P = now.s
        a = np.tile(self.g, (len(now.x), 1))
        for x, _, v, lift in self.mirrors(now):
            d = now.x[:, None] - x[None]
            r = np.linalg.norm(d, axis=2)
            u = now.u[:, None] - v[None]
            xu = (d * u).sum(axis=2)
            P_m = np.maximum(P + lift, np.minimum(P, 0))  # gravity does not make a wall pull
            f = -(self.c_0**2) * (P[:, None] + P_m) + self.K * xu / (r**2 + 0.01 * self.h**2)
            a += self.V * (self.slope(r)[:, :, None] * (f[:, :, None] * d + 2 * self.nu_lattice * u)).sum(axis=1)
        return a

    def step(self, now, dt, wall_a):
        """One step: the instant at its end."""
        wall_u = now.wall_u + 0.5 * dt * wall_a
        walls = [now.wall + 0.5 * dt * wall_u, wall_u, wall_a]
        u = now.u + 0.5 * dt * now.a
        middle = Instant(now.x + 0.5 * dt * u, u, now.s, now.a, *walls)
        s = now.s + dt * self.density_rate(middle)[0]
        end = Instant(middle.x + 0.5 * dt * u, u, s, now.a, now.wall + dt * wall_u, now.wall_u + dt * wall_a, wall_a)
        end.a = self.acceleration(end)
        end.u = u + 0.5 * dt * end.a
        return end


def stir(scene):
    """The scene's particles, each with a velocity and a density of its own."""
    start = scene.sample()
    random = np.random.default_rng(11)
    pressure = scene.material.density * scene.sound_speed**2 * random.uniform(-0.01, 0.02, len(start))
    return Particles(
        start.position, random.uniform(-1.0, 1.0, start.position.shape), start.density, pressure, start.identity
    )


@pytest.fixture(scope="module", params=SCENES.values(), ids=SCENES.keys())
def stirred(request, device):
    """A solver at the start of a stirred scene."""
    solver = Solver(request.param, device=device)
    solver.set_start([0], [stir(request.param)])
    return solver


def assert_close(found, expected):
    """Equal to float32 accuracy of sums of some thirty terms."""
    np.testing.assert_allclose(found / np.abs(expected).max(), expected / np.abs(expected).max(), atol=2e-6)


def test_accelerations_at_the_start_are_the_sums_over_mirror_particles(stirred):
    stirred.reset()
    now = read(stirred)
    assert_close(now.a, Reference(stirred.scene).acceleration(now))


def test_a_step_is_that_of_the_sums_over_mirror_particles(stirred):
    stirred.reset()
    scene, dt = stirred.scene, 0.5 * stirred.max_step
    moving = np.array([scene.faces[name].moving for name in face_names(scene.dim)])
    stirred.face_velocity[0] = 1.5 * moving
    stirred.step(1, dt)  # now the wall is on its way
    before = read(stirred)
    stirred.face_velocity[0] = -0.5 * moving
    stirred.step(1, dt)
    after = read(stirred)
    reference = Reference(scene)
    assert reference.density_rate(before)[1].min() > 0.05  # nobody is spray
    expected = reference.step(before, dt, wall_a=-2.0 * moving / dt)
    np.testing.assert_allclose(after.wall, expected.wall, atol=1e-7)
    np.testing.assert_allclose(after.wall_u, expected.wall_u, atol=1e-6)
    box = np.asarray(scene.upper) - scene.lower
    periodic = np.array([scene.faces[name].kind == "periodic" for name in face_names(scene.dim)[::2]])
    shift = after.x - expected.x
    shift -= np.where(periodic, np.round(shift / box) * box, 0.0)
    np.testing.assert_allclose(shift / DX, 0.0, atol=2e-6)
    assert_close((after.s - before.s) / dt, (expected.s - before.s) / dt)
    assert_close(after.a, expected.a)
    assert_close(after.u, expected.u)
    assert stirred.state.clamped.numpy()[0] == 0


# -- the safety net, open and periodic faces -------------------------------------------------------------------------


def lone_particles(scene, positions, velocities, device="cpu"):
    """A solver of a few particles, no two of them within each other's support."""
    solver = Solver(scene, device=device)
    n = len(positions)
    start = Particles(np.array(positions), np.array(velocities), np.zeros(n), np.zeros(n), np.arange(n))
    solver.set_start([0], [start])
    solver.reset()
    return solver


def test_particle_shot_at_a_wall_stays_inside_and_is_counted(device):
    scene = SCENES["free walls, one moving"]
    solver = lone_particles(scene, [(0.35, 0.2)], [(-3.0 * scene.sound_speed, 0.0)], device)
    for _ in range(30):
        solver.step()
        assert (solver.particles().position >= np.float32(scene.lower)).all()
        assert (solver.particles().position <= np.float32(scene.upper)).all()
    assert solver.state.clamped.numpy()[0] > 0


def test_particle_pressed_on_a_wall_does_not_come_to_lie_on_it(device):
    scene = SCENES["free walls, one moving"]
    solver = lone_particles(scene, [(0.7, scene.lower[1] + 0.2 * DX)], [(0.0, 0.0)], device)
    heights = []
    for _ in range(200):
        solver.step()
        heights.append(float(solver.particles().position[0, 1]) - scene.lower[1])
    assert min(heights) > 0.0
    assert solver.state.clamped.numpy()[0] == 0


def test_particle_beyond_an_open_face_is_retired_until_the_reset(device):
    scene = SCENES["open, no gravity"]
    positions = [(0.4, -0.1), (0.9, -0.1), (0.4, 0.5), (0.9, 0.5)]
    velocities = [(-1.0, 0.0), (0.0, 0.0), (0.0, 1.0), (0.0, -0.5)]
    solver = lone_particles(scene, positions, velocities, device)
    for duration, left in ((0.05, [0, 1, 2, 3]), (0.1, [1, 3]), (0.1, [1, 3])):
        solver.advance(duration)
        np.testing.assert_array_equal(solver.particles().identity, left)
    expected = [(0.9, -0.1), (0.9, 0.5 - 0.5 * 0.25)]
    np.testing.assert_allclose(solver.particles().position, expected, atol=1e-6)
    solver.reset()
    np.testing.assert_array_equal(solver.particles().identity, [0, 1, 2, 3])
    np.testing.assert_allclose(solver.particles().position, positions, atol=1e-7)


def test_particle_leaving_through_a_periodic_face_comes_in_at_the_other(device):
    scene = SCENES["periodic, no gravity"]
    box = np.subtract(scene.upper, scene.lower)
    velocity = np.array([4.0, -3.0])
    solver = lone_particles(scene, [(1.05, -0.15)], [velocity], device)
    for k in range(1, 6):
        solver.advance(0.1)
        place = solver.particles().position[0]
        expected = scene.lower + (np.array([1.05, -0.15]) + 0.1 * k * velocity - scene.lower) % box
        np.testing.assert_allclose(place, expected, atol=1e-5)
        np.testing.assert_array_equal(solver.particles().velocity[0], velocity.astype(np.float32))


def test_no_particle_is_behind_a_moving_wall():
    scene = make_scene({"x_min": MOVING, "x_max": OPEN}, gravity=0.0)
    solver = Solver(scene, device="cpu")
    solver.face_velocity[0, 0] = 0.1 * scene.sound_speed
    for _ in range(20):
        solver.step()
        assert solver.particles().position[:, 0].min() >= solver.face_position("x_min")[0]


def test_particle_that_goes_along_with_a_receding_wall_is_left_alone():
    scene = make_scene({"x_min": MOVING, "x_max": OPEN}, gravity=0.0)
    solver = lone_particles(scene, [(0.7 + 0.06 * DX, 0.2)], [(-4.0, 0.0)])
    saved = solver.save()
    saved["face_position"][0, 0], saved["face_velocity"][0, 0] = 0.7, -4.0
    solver.restore(saved)
    solver.face_velocity[0, 0] = -4.0
    for _ in range(5):
        solver.step()
        distance = solver.particles().position[0, 0] - solver.face_position("x_min")[0]
        assert distance == pytest.approx(0.06 * DX, abs=1e-6)
    assert solver.state.clamped.numpy()[0] == 0
