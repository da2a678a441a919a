"""Walls by images: against a sum over explicit mirror particles, in double precision and by brute force."""

import itertools
import math
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from fluidgym import precision
from fluidgym.layout import CORE_RADIUS, lattice_laplacian
from fluidgym.scene import NO_SLIP_WALL, OPEN, PERIODIC, Box, Face, Fluid, Material, Particles, Scene, face_names
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.sph.smoothing import WENDLAND_C2, WENDLAND_C4

ROOT = Path(__file__).parents[1]
DX = 0.1
DELTA, ALPHA, DAMPING, CORE = 0.1, 0.0003, 0.7, {2: 1.0, 3: 0.0}  # of the default scheme
UNSHIFTED = Scheme(shifting=0.0)  # test_sph_shifting.py has the sum of the shift


def make_scene(faces, dim=2, size=None, gravity=(0.0, -9.81), viscosity=0.0, central_force=0.0):
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
        central_force=central_force,
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
    "open, central force": make_scene(dict.fromkeys(face_names(2), OPEN), central_force=40.0),
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
    identity = saved["identity"][:n]
    order = np.argsort(identity)[np.count_nonzero(identity < 0) :]  # an empty slot has none
    faces = [saved[f"face_{name}"][0].astype(float) for name in ("position", "velocity", "acceleration")]
    columns = [saved[name][..., :n][..., order].T.astype(float) for name in ("position", "velocity")]
    s, a = (saved[name][..., :n][..., order].T.astype(float) for name in ("density_error", "acceleration"))
    return Instant(*columns, s, a, *faces)


@dataclass
class Sweep:
    """What the density sweep finds of each particle."""

    rate: np.ndarray  # ds/dt
    company: np.ndarray  # sum of V h^2 |W'|/r over all others, images included
    in_sight: np.ndarray  # over particles alone


class Reference:
    """The equations of the default scheme, summed over every pair and every mirror particle."""

    def __init__(self, scene):
        self.scene, self.dim = scene, scene.dim
        self.h = {2: 2.2, 3: 1.5}[scene.dim] * scene.particle_spacing
        self.c_0, self.g = scene.sound_speed, np.asarray(scene.gravity)
        self.V = scene.particle_spacing**scene.dim
        self.nu = scene.material.viscosity
        kernel = {2: WENDLAND_C4, 3: WENDLAND_C2}[self.dim]
        self.nu_lattice = self.nu / lattice_laplacian(kernel, self.h / scene.particle_spacing, self.dim)
        self.K = max(0.0, ALPHA * self.h * self.c_0 - 2 * (self.dim + 2) * self.nu)
        # A box that is full for good leans on no accelerations.
        self.leans = any(face.kind == "open" or face.moving for face in scene.faces.values())
        lattice = np.stack(np.meshgrid(*[np.arange(-5, 6) * scene.particle_spacing] * self.dim), axis=-1)
        r = np.linalg.norm(lattice, axis=-1)
        self.full_company = self.weight(r[r > 0]).sum()

    def slope(self, r):
        """W'(r)/r of Wendland C4 in two dimensions and C2 in three, with the core that the first has."""
        core = CORE[self.dim] * np.maximum(1 - r / (CORE_RADIUS * self.scene.particle_spacing), 0)
        return self.bare_slope(r) * (1 + core)

    def weight(self, r):
        """V h^2 |W'|/r, which knows no core."""
        return -self.V * self.h**2 * self.bare_slope(r)

    def bare_slope(self, r):
        """W'(r)/r of the kernel alone."""
        q, sigma = r / self.h, {2: 9 / (4 * math.pi), 3: 21 / (16 * math.pi)}[self.dim] / self.h**self.dim
        t = np.maximum(1 - q / 2, 0)
        slope = {2: -(t**5) * (14 / 3 + 35 / 3 * q), 3: -5 * t**3}[self.dim]
        return sigma / self.h**2 * slope

    def pull(self, x):
        """Body force [m/s2]."""
        return self.g - self.scene.central_force * x

    def mirrors(self, now):
        """All particles and their images: place, velocity, that for viscosity, acceleration, what gravity adds to s.

        Where a wall that moves meets one that holds the fluid, the image of the edge depends on the order of the
        reflections, and physics leaves it open: here the last axis is reflected first.
        """
        names = face_names(self.dim)
        everything = []
        for choice in itertools.product((None, 0, 1), repeat=self.dim):
            x, u, v, a, lift = now.x.copy(), now.u.copy(), now.u.copy(), now.a.copy(), np.zeros(len(now.x))
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
                    a[:, k] = 2 * now.wall_a[number] - a[:, k]
                    lift += (self.g[k] - now.wall_a[number]) * (x[:, k] - now.x[:, k]) / self.c_0**2
                    if face.slip == "no":
                        wall_u = np.array(face.sliding or (0.0,) * self.dim)
                        wall_u[k] += now.wall_u[number]
                        v = 2 * wall_u - v
                    else:
                        v[:, k] = 2 * now.wall_u[number] - v[:, k]
            if possible:
                everything.append((x, u, v, a, lift, all(side is None for side in choice)))
        return everything

    def density_sweep(self, now):
        """ds/dt and the company of each particle."""
        rate, company, in_sight = np.zeros((3, len(now.x)))
        for x, u, _, a, lift, real in self.mirrors(now):
            d = now.x[:, None] - x[None]
            r = np.linalg.norm(d, axis=2)
            slope = self.slope(r)
            xu = (d * (now.u[:, None] - u[None])).sum(axis=2)
            # grad s = (pull - a) / c_0^2, halfway between the two, is no reason to diffuse.
            steepness = 0.5 * (self.pull(now.x)[:, None] + self.pull(x)[None])
            if self.leans:
                steepness -= 0.5 * (now.a[:, None] + a[None])
            excess = now.s[:, None] - (now.s + lift)[None] - (steepness * d).sum(axis=2) / self.c_0**2
            rate += self.V * (slope * (xu + 2 * DELTA * self.h * self.c_0 * excess)).sum(axis=1)
            weight = self.weight(r)
            if real:
                np.fill_diagonal(weight, 0.0)
                in_sight += weight.sum(axis=1)
            company += weight.sum(axis=1)
        return Sweep(rate, company, in_sight)

    def density(self, s, sweep, dt):
        """s at the end of a step, where that of spray fades, and its share."""
        s = s + dt * sweep.rate
        share = np.minimum(np.where(s < 0, sweep.in_sight, sweep.company) / 0.05, 1.0)
        return share * s, share

    def pressure(self, s, share, sweep, dt):
        """P of the force sweep: with packing and, where time passes, damping."""
        crowd = sweep.company / self.full_company
        P = np.maximum(s, -UNSHIFTED.tear) + 0.1 * np.maximum(crowd - 1.25, 0.0)
        return P + (dt > 0) * share * DAMPING * self.h / self.c_0 * sweep.rate / np.maximum(crowd**2, 1.0)

    def acceleration(self, now, P):
        """du/dt."""
        a = self.pull(now.x)
        for x, _, v, _, lift, _ in self.mirrors(now):
            d = now.x[:, None] - x[None]
            r = np.linalg.norm(d, axis=2)
            u = now.u[:, None] - v[None]
            xu = (d * u).sum(axis=2)
            P_m = np.maximum(P + lift, np.minimum(P, 0))  # gravity does not make a wall pull
            f = -(self.c_0**2) * (P[:, None] + P_m) + self.K * xu / (r**2 + 0.01 * self.h**2)
            a += self.V * (self.slope(r)[:, :, None] * (f[:, :, None] * d + 2 * self.nu_lattice * u)).sum(axis=1)
        return a

    def at_rest(self, now):
        """Accelerations of a start."""
        sweep = self.density_sweep(replace(now, a=np.zeros_like(now.a)))
        return self.acceleration(now, self.pressure(*self.density(now.s, sweep, 0.0), sweep, 0.0))

    def step(self, now, dt, wall_a):
        """One step: the instant at its end, and what the density sweep found."""
        wall_u = now.wall_u + 0.5 * dt * wall_a
        walls = [now.wall + 0.5 * dt * wall_u, wall_u, wall_a]
        u = now.u + 0.5 * dt * now.a
        middle = Instant(now.x + 0.5 * dt * u, u, now.s, now.a, *walls)
        sweep = self.density_sweep(middle)
        s, share = self.density(now.s, sweep, dt)
        end = Instant(middle.x + 0.5 * dt * u, u, s, now.a, now.wall + dt * wall_u, now.wall_u + dt * wall_a, wall_a)
        end.a = self.acceleration(end, self.pressure(s, share, sweep, dt))
        end.u = u + 0.5 * dt * end.a
        return end, sweep


def stir(scene, how):
    """The scene's particles, each with a velocity and a density of its own.

    How: "even"; "uneven" has clumps, and tension in a part of the box; "sparse" leaves those three spacings apart.
    """
    start, random = scene.sample(), np.random.default_rng(11)
    if how == "sparse":
        start = start.chosen((np.floor((start.position - scene.lower) / DX) % 3 == 1).all(axis=1))
    x, n = start.position.copy(), len(start)
    if how == "uneven":
        some, others = random.permutation(n)[: 2 * (n // 12)].reshape(2, -1)
        x[some] = x[others] + 0.3 * DX * random.uniform(-1.0, 1.0, (n // 12, scene.dim))
        x = np.clip(x, np.add(scene.lower, 0.2 * DX), np.subtract(scene.upper, 0.2 * DX))
    s = random.uniform(-0.01, 0.02, n)
    if how != "even":
        s[x[:, 0] > 0.6 * scene.upper[0] + 0.4 * scene.lower[0]] -= 0.15
    pressure = scene.material.density * scene.sound_speed**2 * s
    return replace(start, position=x, velocity=random.uniform(-1.0, 1.0, x.shape), pressure=pressure)


@pytest.fixture(scope="module", params=SCENES.values(), ids=SCENES.keys())
def scene(request):
    """One of the scenes."""
    return request.param


@pytest.fixture(scope="module", params=["even", "uneven", "sparse"])
def how(request):
    """How it is stirred."""
    return request.param


@pytest.fixture(scope="module")
def stirred(scene, how, device):
    """A solver at the start of a stirred scene."""
    solver = Solver(scene, UNSHIFTED, device=device)
    solver.set_start([0], [stir(scene, how)])
    return solver


def assert_close(found, expected, how):
    """Equal to the accuracy of sums of fifty to a hundred terms.

    Near the edge of the support, where sparse particles meet, (1 - q/2)^3 makes several times as much of rounding in q.
    """
    atol = 1e-13 if precision.chosen() == "double" else 5e-6 if how == "sparse" else 2e-6
    np.testing.assert_allclose(found / np.abs(expected).max(), expected / np.abs(expected).max(), rtol=0.0, atol=atol)


def step_twice(solver):
    """A step that sets the walls going and one that slows them: the instants around the second, its dt and its end."""
    solver.reset()
    scene, dt = solver.scene, 0.6 * solver.max_step
    moving = np.array([scene.faces[name].moving for name in face_names(scene.dim)])
    solver.face_velocity[0] = 1.5 * moving
    solver.step(1, dt)
    before = read(solver)
    solver.face_velocity[0] = -0.5 * moving
    solver.step(1, dt)
    return before, read(solver), dt, Reference(scene).step(before, dt, wall_a=-2.0 * moving / dt)


def test_accelerations_at_the_start_are_the_sums_over_mirror_particles(stirred, how):
    stirred.reset()
    now = read(stirred)
    assert_close(now.a, Reference(stirred.scene).at_rest(now), how)


def test_a_step_is_that_of_the_sums_over_mirror_particles(stirred, how):
    before, after, dt, (expected, _) = step_twice(stirred)
    scene = stirred.scene
    np.testing.assert_allclose(after.wall, expected.wall, atol=1e-7)
    np.testing.assert_allclose(after.wall_u, expected.wall_u, atol=1e-6)
    box = np.asarray(scene.upper) - scene.lower
    periodic = np.array([scene.faces[name].kind == "periodic" for name in face_names(scene.dim)[::2]])
    shift = after.x - expected.x
    shift -= np.where(periodic, np.round(shift / box) * box, 0.0)
    np.testing.assert_allclose(shift / DX, 0.0, atol=2e-6)
    assert_close((after.s - before.s) / dt, (expected.s - before.s) / dt, how)
    assert_close(after.a, expected.a, how)
    assert_close(after.u, expected.u, how)
    assert stirred.state.clamped.numpy()[0] == 0


def test_the_stirred_scenes_bring_every_rule_into_play(stirred, how):
    before, _, dt, (expected, sweep) = step_twice(stirred)
    reference = Reference(stirred.scene)
    crowd, (s, share) = sweep.company / reference.full_company, reference.density(before.s, sweep, dt)
    damping = DAMPING * reference.h / reference.c_0 * np.abs(sweep.rate)
    if how == "sparse":
        assert ((share > 0.0) & (share < 0.9)).any()
    else:
        assert (share == 1.0).all()
        assert damping.max() > 0.005
        assert np.abs(expected.a - before.a).max() > 0.05 * np.abs(before.a).max() > 0.5
    if how == "uneven":
        assert crowd.max() > 1.3
        apart = np.linalg.norm(before.x[:, None] - before.x[None], axis=2)[np.triu_indices(len(before.x), 1)]
        assert apart.min() < 0.5 * CORE_RADIUS * DX
        assert s.min() < -0.05


@pytest.mark.skipif(precision.chosen() == "double", reason="this is it")
def test_in_double_precision_the_sums_are_the_same_to_its_rounding():
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        __file__,
        "-k",
        "mirror_particles and cpu",
    ]
    environment = os.environ | {precision.VARIABLE: "double"}
    result = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300, cwd=ROOT)
    assert result.returncode == 0, result.stdout
    assert "48 passed" in result.stdout


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
