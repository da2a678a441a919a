"""The ancestors' methods against NumPy: sums over all pairs, recursions of a few lines, walls by hand."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from fluidgym.layout import CORE_RADIUS, lattice_laplacian
from fluidgym.records import unpack
from fluidgym.scene import OPEN, PERIODIC, Box, Face, Fluid, Material, Particles, Scene, face_names
from fluidgym.scheme import DEFAULT_SCHEME, MUELLER, Scheme
from fluidgym.solver import Solver
from fluidgym.sph.integrators import EXPLICIT_EULER, KICK_DRIFT_KICK, LEAPFROG, SYMPLECTIC_EULER
from fluidgym.sph.smoothing import CUBIC_SPLINE, WENDLAND_C4
from fluidgym.sph.state_equation import LINEAR, TAIT
from fluidgym.sph.wall_models import ClampWalls, FrozenWalls, PenaltyWalls

DX = 0.125
GAMMA = 7.0
DELTA, ALPHA, DAMPING, CORE = 0.1, 0.0003, 0.7, {2: 1.0, 3: 0.0}  # of the delta preset


# -- the reference ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RadialKernel:
    """A kernel in pieces of polynomials of q = r/h: (where a piece ends, the piece). It finds its own normalisation."""

    pieces: tuple[tuple[float, Polynomial], ...]

    def sigma(self, dim):
        shell = Polynomial([0.0, 2.0 * math.pi]) if dim == 2 else Polynomial([0.0, 0.0, 4.0 * math.pi])
        total, begin = 0.0, 0.0
        for end, piece in self.pieces:
            whole = (piece * shell).integ()
            total, begin = total + whole(end) - whole(begin), end
        return 1.0 / total

    def __call__(self, r, h, dim, derivative=0):
        q, value, begin = r / h, np.zeros_like(r), 0.0
        for end, piece in self.pieces:
            value = np.where((q >= begin) & (q < end), piece.deriv(derivative)(q) if derivative else piece(q), value)
            begin = end
        return self.sigma(dim) * value / h ** (dim + derivative)


Q = Polynomial([0.0, 1.0])
KERNELS = {
    "poly6": RadialKernel(((1.0, (1 - Q**2) ** 3),)),
    "spiky": RadialKernel(((1.0, (1 - Q) ** 3),)),
    "Wendland C2": RadialKernel(((2.0, (1 - Q / 2) ** 4 * (2 * Q + 1)),)),
    "Wendland C4": RadialKernel(((2.0, (1 - Q / 2) ** 6 * (35 / 12 * Q**2 + 3 * Q + 1)),)),
    "cubic spline": RadialKernel(((1.0, 1 - 1.5 * Q**2 + 0.75 * Q**3), (2.0, (2 - Q) ** 3 / 4))),
}


def viscosity_laplacian(r, h, dim):
    """45 (h - r) / (pi h^6) in three dimensions (Mueller et al. 2003). In two, the same line A (1 - q).

    Twice integrated from q = 1 inwards that is W = A (q^2/4 - q^3/9 - ln(q)/6 - 5/36), whose integral is A pi / 40.
    """
    strength = {2: 40.0 / (math.pi * h**4), 3: 45.0 / (math.pi * h**5)}[dim]
    return strength * np.maximum(1.0 - r / h, 0.0)


@dataclass
class Instant:
    """Particles in order of identity."""

    x: np.ndarray
    u: np.ndarray
    s: np.ndarray
    a: np.ndarray


def read(solver):
    """The present of world 0."""
    saved, n = solver.save(), solver.capacity
    identity = saved["identity"][:n]
    order = np.argsort(identity)[np.count_nonzero(identity < 0) :]  # an empty slot has none
    names = ("position", "velocity", "density_error", "acceleration")
    return Instant(*(saved[name][..., :n][..., order].T.astype(float) for name in names))


def pairs(now, others=None):
    """x_ij, r_ij and u_ij of all pairs, or with others (place, velocity)."""
    places, velocities = (now.x, now.u) if others is None else others
    x, u = now.x[:, None] - places[None], now.u[:, None] - velocities[None]
    return x, np.linalg.norm(x, axis=2), u


class Reference:
    """The equations of a scheme, summed over every pair; around the fluid nothing, or frozen particles at rest.

    With these the fluid shares its pressure and, where they are walls without slip, its own viscosity; nothing else.
    """

    def __init__(self, scene, scheme, frozen=None):
        self.scene, self.scheme, self.dim = scene, scheme, scene.dim
        self.h = scheme.smoothing_length(DX, scene.dim)
        self.c_0, self.V = scene.sound_speed, DX**scene.dim
        self.g, self.nu = scene.gravity_vector, scene.material.viscosity
        self.frozen = np.zeros((0, scene.dim)) if frozen is None else frozen
        self.wall_nu = self.nu if any(face.slip == "no" for face in scene.faces.values()) else 0.0

    def around(self):
        return self.frozen, np.zeros_like(self.frozen)

    def pressure(self, s):
        """p over rho_0 c_0^2."""
        p = s if self.scheme.state_equation is LINEAR else ((1.0 + s) ** GAMMA - 1.0) / GAMMA
        return p if self.scheme.tension else np.maximum(p, 0.0)


class MuellerReference(Reference):
    """Density by summation, and forces with a kernel for each."""

    def density_error(self, now):
        """The sum over what it is on the undisturbed lattice."""
        poly6 = KERNELS["poly6"]
        reach = np.arange(-4, 5) * DX
        lattice = np.stack([axis.ravel() for axis in np.meshgrid(*[reach] * self.dim)], axis=1)
        rest = poly6(np.linalg.norm(lattice, axis=1), self.h, self.dim).sum()
        found = poly6(pairs(now)[1], self.h, self.dim).sum(axis=1)
        found += poly6(pairs(now, self.around())[1], self.h, self.dim).sum(axis=1)
        return found / rest - 1.0

    def acceleration(self, now):
        """du/dt, from the density at hand."""
        a = np.tile(self.g, (len(now.x), 1))
        for (x, r, u), s, nu in (
            (pairs(now), now.s, self.nu),
            (pairs(now, self.around()), np.zeros(len(self.frozen)), self.wall_nu),
        ):
            both = 1.0 / ((1.0 + now.s)[:, None] * (1.0 + s)[None])
            slope = KERNELS["spiky"](r, self.h, self.dim, derivative=1) / np.where(r > 0.0, r, 1.0)
            push = -0.5 * self.c_0**2 * (self.pressure(now.s)[:, None] + self.pressure(s)[None]) * both * slope
            drag = -nu * both * viscosity_laplacian(r, self.h, self.dim)
            a += self.V * (push[:, :, None] * x + drag[:, :, None] * u).sum(axis=1)
        return a

    def step(self, now, dt):
        """One of the leapfrog: half a kick, a drift, density and force there, half a kick."""
        u = now.u + 0.5 * dt * now.a
        end = Instant(now.x + dt * u, u, now.s, now.a)
        end.s = self.density_error(end)
        end.a = self.acceleration(end)
        end.u = u + 0.5 * dt * end.a
        return end


class DeltaReference(Reference):
    """The delta preset with any kernel."""

    def slope(self, r):
        """W'(r)/r, with its limit at 0 and its core."""
        return (1.0 + CORE[self.dim] * np.maximum(1.0 - r / (CORE_RADIUS * DX), 0.0)) * self.bare_slope(r)

    def bare_slope(self, r):
        """W'(r)/r of the kernel alone."""
        kernel, safe = KERNELS[self.scheme.kernel_in(self.dim).name], np.where(r > 0.0, r, 1.0)
        at_zero = kernel(np.zeros(1), self.h, self.dim, derivative=2)[0]
        return np.where(r > 0.0, kernel(r, self.h, self.dim, derivative=1) / safe, at_zero)

    def density_sweep(self, now):
        """ds/dt, and the company of each particle: all of it over that of a lattice, and that of other particles.

        What the fluid's weight and its accelerations make of s between two particles is no reason to diffuse. A box
        full of fluid has the weight alone.
        """
        rate, company = np.zeros(len(now.x)), []
        leans = any(face.kind == "open" for face in self.scene.faces.values())
        for inside, (x, r, u) in ((True, pairs(now)), (False, pairs(now, self.around()))):
            rate += self.V * (self.slope(r) * (x * u).sum(axis=2)).sum(axis=1)
            company.append(-self.V * self.h**2 * (self.bare_slope(r) * (r > 0.0)).sum(axis=1))
            if inside:
                steepness = self.g - (0.5 * (now.a[:, None] + now.a[None]) if leans else 0.0)
                excess = now.s[:, None] - now.s[None] - (x * steepness).sum(axis=2) / self.c_0**2
                rate += self.V * 2.0 * DELTA * self.h * self.c_0 * (self.slope(r) * excess).sum(axis=1)
        reach = np.arange(-8, 9) * DX
        lattice = np.linalg.norm(np.stack(np.meshgrid(*[reach] * self.dim)), axis=0)
        full = -self.V * self.h**2 * (self.bare_slope(lattice) * (lattice > 0.0)).sum()
        return rate, sum(company) / full, company[0]

    def advanced(self, now, dt):
        """The density error at the end of a step, and the field of the force sweep; at dt = 0 without damping."""
        rate, crowd, company = self.density_sweep(now)
        assert company.min() > 0.05  # nobody is spray
        s = now.s + dt * rate
        P = self.pressure(s) + 0.1 * np.maximum(crowd - 1.25, 0.0)
        if dt > 0.0:
            P += DAMPING * self.h / self.c_0 * rate / np.maximum(crowd**2, 1.0)
        return s, P

    def acceleration(self, now, P=None):
        """du/dt, of a field or at a start."""
        if P is None:
            P = self.advanced(replace(now, a=0.0 * now.a), 0.0)[1]
        a = np.tile(self.g, (len(now.x), 1))
        artificial = max(0.0, ALPHA * self.h * self.c_0 - 2 * (self.dim + 2) * self.nu)
        for (x, r, u), P_j, K, nu in (
            (pairs(now), P, artificial, self.nu),
            (pairs(now, self.around()), np.zeros(len(self.frozen)), 0.0, self.wall_nu),
        ):
            force = -(self.c_0**2) * (P[:, None] + P_j[None])
            force += K * (x * u).sum(axis=2) / (r**2 + 0.01 * self.h**2)
            nu = nu / lattice_laplacian(self.scheme.kernel_in(self.dim), self.h / DX, self.dim)
            a += self.V * (self.slope(r)[:, :, None] * (force[:, :, None] * x + 2.0 * nu * u)).sum(axis=1)
        return a

    def step(self, now, dt):
        """Half a kick, half a drift, density there, half a drift, force there, half a kick."""
        u = now.u + 0.5 * dt * now.a
        middle = Instant(now.x + 0.5 * dt * u, u, now.s, now.a)
        s, P = self.advanced(middle, dt)
        end = Instant(middle.x + 0.5 * dt * u, u, s, now.a)
        end.a = self.acceleration(end, P)
        end.u = u + 0.5 * dt * end.a
        return end


def block(dim, faces=OPEN, jitter=0.3, **changes):
    """A jittered block with room around it unless the faces are walls; the corner is not the origin."""
    lower = (0.3, -0.2, 0.1)[:dim]
    upper = tuple(low + n * DX for low, n in zip(lower, (8, 7, 6), strict=False))
    air = 0.0 if faces.kind == "wall" else 3 * DX
    given = {
        "lower": tuple(low - air for low in lower),
        "upper": tuple(high + air for high in upper),
        "particle_spacing": DX,
        "fluid": Fluid(Box(lower, upper)),
        "faces": dict.fromkeys(face_names(dim), faces),
        "gravity": (1.0, 2.0, -9.81)[-dim:],
        "material": Material(viscosity=0.05, sound_speed=25.0),
        "reference_speed": 2.0,
        "jitter": jitter,
        "seed": 5,
    }
    return Scene(**(given | changes))


def stirred(scene, scheme, device):
    """A solver of a scene whose particles have velocities and pressures of their own."""
    solver, start = Solver(scene, scheme, device=device), scene.sample()
    random = np.random.default_rng(11)
    velocity = random.uniform(-1.0, 1.0, start.position.shape)
    pressure = scene.material.density * scene.sound_speed**2 * random.uniform(0.0, 0.03, len(start))
    solver.set_start([0], [Particles(start.position, velocity, start.density, pressure, start.identity)])
    solver.reset()
    return solver


def assert_close(found, expected, atol=3e-6):
    """Equal to float32 accuracy of sums of some tens of terms, over the largest of them."""
    scale = np.abs(expected).max()
    assert scale > 0.0
    np.testing.assert_allclose(found / scale, expected / scale, atol=atol)


def assert_step_is(reference, solver, summed):
    """The density and the accelerations at the start, and a step from there, are the reference's."""
    dt = 0.5 * solver.max_step
    start = read(solver)
    if summed:
        assert_close(1.0 + start.s, 1.0 + reference.density_error(start))
    assert_close(start.a, reference.acceleration(start))
    solver.step(1, dt)
    after, expected = read(solver), reference.step(start, dt)
    np.testing.assert_allclose((after.x - expected.x) / DX, 0.0, atol=5e-6)
    assert_close(after.u, expected.u)
    assert_close(1.0 + after.s, 1.0 + expected.s)
    assert_close(after.a, expected.a, atol=1e-5)
    assert solver.state.clamped.numpy()[0] == 0


# -- terms -----------------------------------------------------------------------------------------------------------

MUELLER_SCHEMES = {
    "linear": replace(MUELLER, state_equation=LINEAR),
    "Tait": replace(MUELLER, state_equation=TAIT),
    "Tait with tension": replace(MUELLER, state_equation=TAIT, tension=True),
}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("scheme", MUELLER_SCHEMES.values(), ids=MUELLER_SCHEMES)
def test_mueller_step_is_that_of_the_sums_over_all_pairs(scheme, dim, device):
    scene = block(dim)
    solver = stirred(scene, scheme, device)
    s = read(solver).s
    assert s.min() < -0.1  # at the surface
    assert s.max() > 0.02  # where jitter has pressed particles together
    assert_step_is(MuellerReference(scene, scheme), solver, summed=True)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kernel", [CUBIC_SPLINE, WENDLAND_C4], ids=lambda kernel: kernel.name)
def test_delta_step_with_another_kernel_is_that_of_the_sums_over_all_pairs(kernel, dim, device):
    scene, scheme = block(dim), Scheme(kernel=kernel)
    assert_step_is(DeltaReference(scene, scheme), stirred(scene, scheme, device), summed=False)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("ratio", [1.6, 2.0, 2.5])
def test_lattice_at_rest_has_the_rest_density_whatever_the_smoothing_length(ratio, dim, device):
    faces, length = dict.fromkeys(face_names(dim), PERIODIC), (8 * DX,) * dim
    fluid = Fluid(Box((0.0,) * dim, length))
    scene = Scene((0.0,) * dim, length, DX, fluid, faces, gravity=0.0, reference_speed=1.0)
    solver = Solver(scene, replace(MUELLER, smoothing_ratio=ratio), device=device)
    np.testing.assert_allclose(read(solver).s, 0.0, atol=2e-6)


@pytest.mark.parametrize("dim", [2, 3])
def test_mueller_keeps_the_momentum(dim, device):
    # The forces of a pair are equal and opposite although the Spiky gradient is not that of the density.
    scene = block(dim, gravity=0.0)
    solver = stirred(scene, MUELLER_SCHEMES["Tait"], device)
    before = read(solver)
    assert np.abs(before.a).max() > 100.0
    solver.step(50)
    after = read(solver)
    assert np.abs(after.u - before.u).max() > 0.3
    np.testing.assert_allclose(after.u.mean(axis=0), before.u.mean(axis=0), atol=1e-5)


# -- integrators -----------------------------------------------------------------------------------------------------

PULL = 4.0  # of the central force [1/s2]


def explicit_euler(x, u, a, dt):
    return x + dt * u, u + dt * a(x)


def symplectic_euler(x, u, a, dt):
    u = u + dt * a(x)
    return x + dt * u, u


def velocity_verlet(x, u, a, dt):
    u = u + 0.5 * dt * a(x)
    x = x + dt * u
    return x, u + 0.5 * dt * a(x)


def staggered_leapfrog(x, u, a, dt, n):
    """Leapfrog as it was written first: a kick of half a step, then whole drifts and whole kicks in turn.

    The velocity in step with the position is the mean of those half a step before and after.
    """
    half, trail = u + 0.5 * dt * a(x), []
    for _ in range(n):
        x = x + dt * half
        before, half = half, half + dt * a(x)
        trail.append((x, 0.5 * (before + half)))
    return trail


INTEGRATORS = {
    "leapfrog": (MUELLER, LEAPFROG, velocity_verlet),
    "symplectic Euler": (MUELLER, SYMPLECTIC_EULER, symplectic_euler),
    "explicit Euler": (MUELLER, EXPLICIT_EULER, explicit_euler),
    "kick-drift-kick": (DEFAULT_SCHEME, KICK_DRIFT_KICK, velocity_verlet),
    "leapfrog, density advanced": (DEFAULT_SCHEME, LEAPFROG, velocity_verlet),
    "symplectic Euler, density advanced": (DEFAULT_SCHEME, SYMPLECTIC_EULER, symplectic_euler),
}


@pytest.fixture(params=INTEGRATORS.values(), ids=INTEGRATORS.keys())
def integrated(request):
    """A scheme with an integrator, and the recursion it should be."""
    scheme, integrator, recursion = request.param
    walls = PenaltyWalls() if scheme is MUELLER else scheme.walls
    return replace(scheme, integrator=integrator, walls=walls), recursion


def few(scheme, positions, velocities, device, **changes):
    """A solver of particles that never meet, in a wide box."""
    dim = len(positions[0])
    given = {
        "lower": (-4.0,) * dim,
        "upper": (4.0,) * dim,
        "particle_spacing": 0.5,
        "fluid": Fluid(Box((-4.0,) * dim, (4.0,) * dim)),
        "faces": dict.fromkeys(face_names(dim), OPEN),
        "gravity": 0.0,
        "material": Material(sound_speed=5.0),
        "reference_speed": 1.0,
    }
    solver, n = Solver(Scene(**(given | changes)), scheme, device=device), len(positions)
    # A particle without neighbours bears no pressure, which the preset that advances density takes a step to see.
    start = Particles(np.array(positions), np.array(velocities), np.full(n, 1000.0), np.zeros(n), np.arange(n))
    solver.set_start([0], [start])
    solver.reset()
    return solver


@pytest.mark.parametrize("dim", [2, 3])
def test_orbits_are_those_of_the_recursion(integrated, dim, device):
    scheme, recursion = integrated
    positions = np.array([(1.5, 0.0, 0.3), (-1.5, 0.2, 0.0)])[:, :dim]
    velocities = np.array([(0.0, 2.0, 0.4), (0.5, -2.5, 0.3)])[:, :dim]
    solver = few(scheme, positions, velocities, device, central_force=PULL)
    x, u, dt = positions, velocities, 0.04
    staggered = staggered_leapfrog(x, u, lambda x: -PULL * x, dt, 60)
    for k in range(60):
        solver.step(1, dt)
        x, u = recursion(x, u, lambda x: -PULL * x, dt)
        np.testing.assert_allclose(solver.particles().position, x, atol=1e-5)
        np.testing.assert_allclose(solver.particles().velocity, u, atol=2e-5)
        if recursion is velocity_verlet:
            np.testing.assert_allclose(solver.particles().position, staggered[k][0], atol=1e-5)
            np.testing.assert_allclose(solver.particles().velocity, staggered[k][1], atol=2e-5)


def test_energy_of_an_orbit_grows_explodes_or_stays_as_the_integrator_has_it(integrated, device):
    # Of the harmonic oscillator explicit Euler multiplies the energy by 1 + (omega dt)^2 each step; the others have an
    # invariant close to it: omega dt x u beside it for symplectic Euler, a bit less of x^2 for the leapfrog.
    scheme, recursion = integrated
    solver = few(scheme, [(0.5, 0.0)], [(0.0, 0.6)], device, central_force=PULL)
    dt, n = 0.03, 300
    shadow = {
        explicit_euler: lambda x, u: (u**2 + PULL * x**2).sum(),
        symplectic_euler: lambda x, u: (u**2 + PULL * x**2 - PULL * dt * x * u).sum(),
        velocity_verlet: lambda x, u: (u**2 + PULL * (1.0 - PULL * dt**2 / 4.0) * x**2).sum(),
    }[recursion]
    values = []
    for _ in range(n):
        now = read(solver)
        values.append(shadow(now.x, now.u))
        solver.step(1, dt)
    growth = 1.0 + PULL * dt**2 if recursion is explicit_euler else 1.0
    np.testing.assert_allclose(values / growth ** np.arange(n), values[0], rtol=2e-5)
    assert growth ** (n - 1) == pytest.approx(2.93 if recursion is explicit_euler else 1.0, rel=0.01)


def test_free_fall_is_that_of_the_recursion(integrated, device):
    scheme, recursion = integrated
    solver, g, dt, n = few(scheme, [(0.0, 3.0)], [(0.5, 1.0)], device, gravity=9.81), 9.81, 0.02, 40
    solver.step(n, dt)
    found = solver.particles()
    # Of the sum over the velocities the first is missing, or the last counts once too often, or both do by half.
    steps = {explicit_euler: n * (n - 1), symplectic_euler: n * (n + 1), velocity_verlet: n * n}[recursion] / 2
    expected = [0.5 * n * dt, 3.0 + n * dt - g * dt**2 * steps]
    np.testing.assert_allclose(found.position[0], expected, atol=1e-5)
    np.testing.assert_allclose(found.velocity[0], [0.5, 1.0 - g * n * dt], atol=1e-5)


# -- walls -----------------------------------------------------------------------------------------------------------

WALLED = {"faces": {}, "lower": (-4.0, -3.0), "upper": (4.0, 3.0), "fluid": Fluid(Box((-4.0, -3.0), (4.0, 3.0)))}


def test_penalty_wall_is_a_spring_below_its_margin(device):
    walls = PenaltyWalls(stiffness=0.3, margin=1.2)
    scheme = replace(MUELLER, walls=walls)
    h, margin = 1.0, 1.2 * 0.5
    k = 0.3 * (5.0 / h) ** 2
    # Two that fly into a wall and a corner, one at rest at the margin, and one too far away.
    positions = np.array([(-3.2, 0.0), (3.0, 2.2), (0.0, -3.0 + margin), (-0.5, 1.5)])
    velocities = np.array([(-1.0, 0.1), (0.9, 0.8), (0.0, 0.0), (0.0, 0.0)])
    solver = few(scheme, positions, velocities, device, **WALLED)
    lower, upper = np.array(WALLED["lower"]), np.array(WALLED["upper"])

    def push(x):
        return k * (np.maximum(margin - (x - lower), 0.0) - np.maximum(margin - (upper - x), 0.0))

    x, u, dt, deepest = positions, velocities, 0.05, 0.0
    for _ in range(40):
        solver.step(1, dt)
        x, u = velocity_verlet(x, u, push, dt)
        deepest = max(deepest, np.abs(push(x)).max())
        now = read(solver)
        np.testing.assert_allclose(now.x, x, atol=1e-5)
        np.testing.assert_allclose(now.u, u, atol=3e-5)
        np.testing.assert_allclose(now.a, push(x), atol=1e-4)
    assert deepest > 1.0  # they have been in the springs
    assert (u[0, 0] > 0.9) and (u[1] < -0.7).all()  # and are thrown back
    assert (now.x[2:] == positions[2:].astype(np.float32)).all()
    assert solver.state.clamped.numpy()[0] == 0


def test_penalty_wall_in_three_dimensions_and_its_reaction(device):
    scheme, positions = replace(MUELLER, walls=PenaltyWalls()), [(0.0, 0.0, 3.9), (-3.9, 0.0, 0.0)]
    scene = few(scheme, positions, np.zeros((2, 3)), device, faces={}).scene
    solver = Solver(scene, scheme, device=device, report_forces=True)
    start = Particles(np.array(positions), np.zeros((2, 3)), np.full(2, 1000.0), np.zeros(2), np.arange(2))
    solver.set_start([0], [start])
    solver.reset()
    pushed = 0.5 * 5.0**2 * (0.25 - 0.1)  # 0.1 m from walls with a margin of 0.25 m
    np.testing.assert_allclose(read(solver).a, [(0.0, 0.0, -pushed), (pushed, 0.0, 0.0)], atol=1e-4)
    solver.step(1, 1e-6)
    found = solver.face_force[0]
    mass = scene.particle_mass
    expected = np.zeros((6, 3))
    expected[5, 2], expected[0, 0] = mass * pushed, -mass * pushed
    np.testing.assert_allclose(found, expected, atol=1e-4 * mass * pushed)


@pytest.mark.parametrize("damping", [0.0, 0.3, 1.0])
def test_clamping_wall_throws_back_a_share_of_the_normal_speed(damping, device):
    scheme = replace(MUELLER, walls=ClampWalls(damping=damping))
    positions = np.array([(-3.9, 0.0), (3.9, 2.95), (0.0, 0.0)])
    velocities = np.array([(-2.0, 0.5), (1.5, 1.0), (0.0, -1.0)])
    solver = few(scheme, positions, velocities, device, **WALLED)
    lower, upper = np.array(WALLED["lower"]), np.array(WALLED["upper"])
    x, u, dt = positions, velocities, 0.08
    for _ in range(10):
        solver.step(1, dt)
        x = x + dt * u
        u = np.where((x < lower) | (x > upper), -damping * u, u)
        x = np.clip(x, lower, upper)
        np.testing.assert_allclose(solver.particles().position, x, atol=1e-5)
        np.testing.assert_allclose(solver.particles().velocity, u, atol=1e-6)
    np.testing.assert_allclose(u, [(2.0 * damping, 0.5), (-1.5 * damping, -damping), (0.0, -1.0)])
    assert solver.state.clamped.numpy()[0] == 0  # it does so for a living


def test_clamping_wall_that_moves_throws_back_in_its_own_frame(device):
    walls, changes = ClampWalls(damping=0.3), dict(WALLED)
    changes["faces"] = {"x_min": Face(moving=True, travel=(-4.0, 0.0))}
    solver = few(replace(MUELLER, walls=walls), [(-3.98, 0.0)], [(-0.4, 0.0)], device, **changes)
    saved = solver.save()
    saved["face_velocity"][0, 0] = 0.6
    solver.restore(saved)
    solver.face_velocity[0, 0] = 0.6
    solver.step(1, 0.05)
    assert solver.face_position("x_min")[0] == pytest.approx(-3.97)
    np.testing.assert_allclose(solver.particles().position[0], [-3.97, 0.0], atol=1e-6)
    np.testing.assert_allclose(solver.particles().velocity[0], [0.6 + 0.3 * 1.0, 0.0], atol=1e-6)


def frozen_lattice(scene, layers):
    """What continues the lattice of a box by so many layers beyond its walls."""
    counts = np.round(np.subtract(scene.upper, scene.lower) / DX).astype(int)
    lines = [range(-layers, n + layers) for n in counts]
    places = [
        cell for cell in itertools.product(*lines) if any(not 0 <= c < n for c, n in zip(cell, counts, strict=True))
    ]
    return np.asarray(scene.lower) + (np.array(places) + 0.5) * DX


FROZEN = {
    "mueller": (replace(MUELLER, walls=FrozenWalls()), MuellerReference, {2: 2, 3: 2}),
    "delta": (Scheme(walls=FrozenWalls()), DeltaReference, {2: 5, 3: 3}),
}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("preset", FROZEN)
def test_frozen_walls_are_layers_that_cover_the_support(preset, dim, device):
    scheme, _, layers = FROZEN[preset]
    scene = block(dim, Face(), jitter=0.0)
    solver, expected = Solver(scene, scheme, device=device), frozen_lattice(scene, layers[dim])
    parts = unpack(solver._frozen.records, 2 * dim + 1, len(expected))
    found = parts[:dim].T.astype(float)
    assert solver._frozen.bounds.numpy()[-1] == len(expected)
    found, expected = (places[np.lexsort(np.round(places, 3).T)] for places in (found, expected))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert not parts[dim:].any()


@pytest.mark.parametrize(("dim", "slip"), [(2, "free"), (2, "no"), (3, "free")])
@pytest.mark.parametrize("preset", FROZEN)
def test_step_between_frozen_walls_is_that_of_the_sums_over_fluid_and_wall(preset, dim, slip, device):
    scheme, reference, layers = FROZEN[preset]
    scene = block(dim, Face(slip=slip))
    solver = stirred(scene, scheme, device)
    wall = frozen_lattice(scene, layers[dim])
    with_wall, without = reference(scene, scheme, wall), reference(scene, scheme)
    assert np.abs(with_wall.acceleration(read(solver)) - without.acceleration(read(solver))).max() > 10.0
    assert_step_is(with_wall, solver, summed=preset == "mueller")


def test_open_faces_have_no_frozen_particles(device):
    scene = replace(block(2), faces={"x_min": Face()} | dict.fromkeys(("x_max", "y_min", "y_max"), OPEN))
    solver = Solver(scene, replace(MUELLER, walls=FrozenWalls()), device=device)
    count = solver._frozen.bounds.numpy()[-1]
    found = unpack(solver._frozen.records, 5, count)[:2].T
    assert count == 2 * round((scene.upper[1] - scene.lower[1]) / DX)
    assert (found[:, 0] < scene.lower[0]).all()
