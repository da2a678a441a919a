"""Particle shifting: its sum by brute force, what it does to particles in disorder, and where it is left out."""

import dataclasses
import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from fluidgym.diagnostics import measure, pressure_at
from fluidgym.scene import (
    NO_SLIP_WALL,
    OPEN,
    PERIODIC,
    Ball,
    Body,
    Box,
    Face,
    Fluid,
    Inflow,
    Material,
    Outflow,
    Scene,
    face_names,
)
from fluidgym.scheme import MUELLER, Scheme
from fluidgym.solver import Solver
from fluidgym.sph.mueller import POLY6_SUMMATION
from fluidgym.sph.shifting import INSIDE, LONGEST, SPRAY
from fluidgym.sph.wall_models import ClampWalls, FrozenWalls, PenaltyWalls

DX = 0.0625
SCHEME = Scheme(smoothing_ratio=1.5, shifting=1.0)
KEPT = ("position", "velocity", "density_error", "acceleration", "identity")


def box(dim=2, faces=None, size=1.0, **changes):
    """A box full of fluid in disorder; its corner is not the origin."""
    lower = (0.25, -0.5, 0.125)[:dim]
    upper = tuple(low + size for low in lower)
    given = dict(gravity=0.0, reference_speed=1.0, jitter=0.3, seed=5) | changes
    return Scene(lower, upper, DX, Fluid(Box(lower, upper)), faces or {}, **given)


def periodic(*axes):
    """Periodic faces along some axes."""
    return {f"{axis}_{side}": PERIODIC for axis in axes for side in ("min", "max")}


def stirred(dim=2, **changes):
    """A periodic box in which a shear wave goes on."""
    scene = box(dim, periodic(*"xyz"[:dim]), **changes)
    places = scene.fluid[0].shape

    def velocity(x):
        u = np.zeros_like(x)
        u[:, 0], u[:, 1] = np.sin(2 * np.pi * x[:, 1]), 0.5 * np.sin(2 * np.pi * x[:, 0])
        return u

    return dataclasses.replace(scene, fluid=[Fluid(places, velocity=velocity)])


# -- the sum ---------------------------------------------------------------------------------------------------------


def one_step(scene, dt_share, shift, plain=False, scheme=SCHEME):
    """Positions at the end of one step with or without the shift, (n, dim), the solver, and the step [s]."""
    solver = Solver(scene, scheme, device="cpu", plain_loops=plain)
    if not shift:
        solver._kernels = SimpleNamespace(**(vars(solver._kernels) | {"shift": None}))
    dt = dt_share * solver.max_step
    solver.step(1, dt)
    saved = solver.save()
    order = np.argsort(saved["identity"][: solver.capacity])
    return saved["position"][:, : solver.capacity].T[order].astype(float), solver, dt


def kernel(r, scene):
    """W and W'(r)/r at the h of SCHEME."""
    h = 1.5 * scene.particle_spacing
    sigma = {2: 9 / (4 * math.pi), 3: 21 / (16 * math.pi)}[scene.dim] / h**scene.dim
    q = np.minimum(r / h, 2.0)
    t = 1 - q / 2
    if scene.dim == 2:
        return sigma * t**6 * (35 / 12 * q**2 + 3 * q + 1), -sigma / h**2 * t**5 * (14 / 3 + 35 / 3 * q)
    return sigma * t**4 * (1 + 2 * q), -5 * sigma / h**2 * t**3


def with_images(scene, x):
    """The particles, and their images in the faces, (image, particle, dim)."""
    images = []
    for choice in itertools.product((None, 0, 1), repeat=scene.dim):
        image = x.copy()
        for k, side in enumerate(choice):
            if side is None:
                continue
            ends = scene.lower[k], scene.upper[k]
            kind = scene.faces["xyz"[k] + ("_min", "_max")[side]].kind
            if kind == "periodic":
                image[:, k] += (1 - 2 * side) * (ends[0] - ends[1])
            elif kind == "open":
                image[:] = np.inf
            else:
                image[:, k] = 2 * ends[side] - image[:, k]
        if np.isfinite(image).all():
            images.append(image)
    return np.array(images)


def crowds(scene, x):
    """How crowded each particle is, over a lattice, (n,)."""
    total = np.zeros(len(x))
    for n, image in enumerate(with_images(scene, x)):
        slope = kernel(np.linalg.norm(x[:, None] - image[None], axis=2), scene)[1]
        total += (slope * (1 - np.eye(len(x)) * (n == 0))).sum(axis=1)
    steps = np.stack(np.meshgrid(*[np.arange(-4, 5)] * scene.dim), axis=-1).reshape(-1, scene.dim)
    far = np.linalg.norm(steps, axis=1)
    return total / kernel(scene.particle_spacing * far[far > 0], scene)[1].sum()


def expected_shift(scene, x, dt, crowd=None):
    """The formula, over all pairs of particles and images, in double precision; with a surface, crowds (n,)."""
    dim, h = scene.dim, 1.5 * scene.particle_spacing
    total = np.zeros_like(x)
    for image in with_images(scene, x):
        d = x[:, None] - image[None]
        w, slope = kernel(np.linalg.norm(d, axis=2), scene)
        close = (w / kernel(np.array(scene.particle_spacing), scene)[0]) ** 4
        share = 1 + 0.2 * close
        if crowd is not None:
            share = np.where(crowd[:, None] < INSIDE, 0.5 * np.maximum(close - 1, 0), 1 + 0.5 * close)
        total += ((share * slope)[..., None] * d).sum(axis=1)
    if crowd is not None:
        total[crowd < SPRAY] = 0.0
    shift = -scene.speed_scale * h * dt * scene.particle_spacing**dim * total
    length, longest = np.linalg.norm(shift, axis=1, keepdims=True), LONGEST * scene.particle_spacing
    shift *= np.minimum(1.0, longest / np.maximum(length, 1e-30))
    end = x + shift
    for k in range(dim):
        for side, face in enumerate(("_min", "_max")):
            if scene.faces["xyz"[k] + face].kind == "wall":
                end[:, k] = (np.maximum, np.minimum)[side](end[:, k], (scene.lower, scene.upper)[side][k])
    return end - x


SUMS = {
    "2D periodic": box(2, periodic(*"xy")),
    "2D walls": box(2, {"x_min": NO_SLIP_WALL, "y_max": Face(slip="no", sliding=(1.0, 0.0))}),
    "2D mixed": box(2, periodic("x")),
    "3D periodic": box(3, periodic(*"xyz"), size=0.5),
    "3D mixed": box(3, periodic("y"), size=0.5),
}


@pytest.mark.parametrize("plain", [False, True], ids=["native", "plain"])
@pytest.mark.parametrize("name", SUMS)
@pytest.mark.parametrize("dt_share", [0.25, 0.75])
def test_particles_are_shifted_by_the_formula(name, plain, dt_share):
    scene = SUMS[name]
    before, _, dt = one_step(scene, dt_share, shift=False)
    after, solver, _ = one_step(scene, dt_share, shift=True, plain=plain)
    assert solver._kernels.shift is not None
    expected = expected_shift(scene, before, dt)
    longest = LONGEST * DX
    np.testing.assert_allclose(after - before, expected, atol=2e-3 * longest)
    length = np.linalg.norm(expected, axis=1)
    assert length.max() > 0.2 * longest
    assert length.max() < 1.0001 * longest
    assert (length < 0.99 * longest).sum() > 0.5 * len(length)


@pytest.mark.parametrize("plain", [False, True], ids=["native", "plain"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("what", ["drop", "puddle"])
def test_particles_with_a_surface_are_shifted_by_the_formula(what, dim, plain):
    lower, upper = (-0.4,) * dim, (0.4,) * dim
    if what == "drop":
        fluid, faces = Fluid(Ball((0.0,) * dim, 0.3)), dict.fromkeys(face_names(dim), OPEN)
    else:
        fluid, faces = Fluid(Box(lower, (*upper[:-1], 0.0))), {"xyz"[dim - 1] + "_max": OPEN}
    scene = Scene(lower, upper, DX, fluid, faces, gravity=0.0, reference_speed=1.0, jitter=0.3, seed=3)
    scheme = dataclasses.replace(SCHEME, surface_shifting=1.0)
    before, _, dt = one_step(scene, 0.25, shift=False, scheme=scheme)
    after, solver, _ = one_step(scene, 0.25, shift=True, plain=plain, scheme=scheme)
    assert solver._structure.surface
    crowd = crowds(scene, before)
    sure = np.minimum(abs(crowd - INSIDE), abs(crowd - SPRAY)) > 0.01  # the solver looks in the middle of the step
    assert sure.mean() > 0.9
    assert 0.1 < (crowd < INSIDE).mean() < 0.9
    expected = expected_shift(scene, before, dt, crowd)
    np.testing.assert_allclose((after - before)[sure], expected[sure], atol=2e-3 * LONGEST * DX)
    assert np.linalg.norm(expected[sure & (crowd < INSIDE)], axis=1).max() > 0.2 * LONGEST * DX


def test_what_is_near_a_body_is_not_shifted():
    scene = free_surface(gravity=0.0, jitter=0.3, seed=3, bodies={"post": Body(Ball((0.5, 0.25), 0.1))})
    scheme = dataclasses.replace(SCHEME, surface_shifting=1.0)
    before, after = (one_step(scene, 0.25, shift, scheme=scheme)[0] for shift in (False, True))
    moved = np.linalg.norm(after - before, axis=1)
    near = np.hypot(*(before - [0.5, 0.25]).T) < 0.2
    assert near.sum() >= 10
    assert moved[near].max() == 0.0
    assert moved.max() > 0.1 * LONGEST * DX


# -- what it does ----------------------------------------------------------------------------------------------------


def nearest(scene, position):
    """Distance of each particle to the nearest other through periodic faces [m], (n,)."""
    side = np.subtract(scene.upper, scene.lower)
    d = position[:, None] - position[None]
    d -= side * np.round(d / side)
    r = np.linalg.norm(d, axis=2) + 1e3 * np.eye(len(position))
    return r.min(axis=1)


@pytest.mark.parametrize("dim", [2, 3])
def test_disorder_at_rest_becomes_regular_and_gains_no_energy(dim, device):
    scene = box(dim, periodic(*"xyz"[:dim]), size=1.0 if dim == 2 else 0.5)
    solver = Solver(scene, SCHEME, device=device)
    before = nearest(scene, solver.particles().position)
    solver.advance(1.0)
    after = nearest(scene, solver.particles().position)
    assert after.min() > 0.7 * DX > before.min()
    assert after.mean() > 1.1 * before.mean()
    # What uniform pressure gives to particles in disorder is a few thousandths of what the flow may have.
    assert measure(solver).energy < 3e-3 * 0.5 * measure(solver).mass * scene.speed_scale**2


def test_a_flow_gains_no_energy(device):
    solver = Solver(stirred(), SCHEME, device=device)
    energies = [measure(solver).energy]
    for _ in range(10):
        solver.advance(0.1)
        energies.append(measure(solver).energy)
    assert (np.diff(energies) < 0.0).all()


def test_the_mean_density_is_held_and_reads_know_no_level(device):
    start = stirred()
    lifted = dataclasses.replace(
        start, fluid=[dataclasses.replace(start.fluid[0], pressure=lambda x: 50.0 + 20.0 * np.sin(2 * np.pi * x[:, 0]))]
    )
    solver = Solver(lifted, SCHEME, num_worlds=3, device=device)
    np.testing.assert_allclose(solver.particles().pressure, lifted.sample().pressure, atol=0.01)
    means = [solver.particles(world).pressure.mean() for world in range(3)]
    assert means == pytest.approx([lifted.sample().pressure.mean()] * 3, abs=0.01)
    solver.advance(0.3)
    solver.set_parameters(sound_speed=[10.0, 15.0, 20.0])
    solver.advance(0.3)
    solver.reset(np.array([False, True, False]))
    solver.advance(0.3)
    # A thousandth of rho U^2.
    assert [solver.particles(world).pressure.mean() for world in range(3)] == pytest.approx(means, abs=1.0)
    places = np.random.default_rng(0).uniform(lifted.lower, lifted.upper, (400, 2))
    assert pressure_at(solver, places, 2).mean() == pytest.approx(means[2], abs=20.0)


def test_without_shifting_the_mean_is_not_touched(device):
    solver = Solver(stirred(), dataclasses.replace(SCHEME, shifting=0.0), device=device)
    solver.advance(0.5)
    assert abs(solver.particles().pressure.mean()) > 5.0


def test_walls_keep_shifted_particles_in(device):
    scene = box(2, {"y_max": Face(slip="no", sliding=(1.0, 0.0))}, jitter=0.5, material=Material(viscosity=0.01))
    solver = Solver(scene, Scheme(smoothing_ratio=1.5, shifting=4.0), device=device)
    for _ in range(20):
        solver.advance(0.05)
        position = solver.particles().position.astype(float)
        assert (position >= np.float32(scene.lower)).all()
        assert (position <= np.float32(scene.upper)).all()
    assert len(position) == 256
    assert not solver.state.clamped.numpy().any()


def test_forces_on_walls_know_no_level(device):
    given = dict(gravity=0.0, jitter=0.0)
    for pressure in (0.0, 200.0):
        scene = box(2, **given)
        scene = dataclasses.replace(scene, fluid=[Fluid(scene.fluid[0].shape, pressure=lambda x, p=pressure: p)])
        solver = Solver(scene, SCHEME, device=device, report_forces=True)
        solver.step(10)
        # The level is 0.1 rho U^2 = 100 Pa, on a face of 1 m.
        expected = pressure * np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])
        np.testing.assert_allclose(solver.face_force[0], expected, atol=4.0)


# -- worlds, and going on --------------------------------------------------------------------------------------------


def assert_same(one, other, slots_of_one=slice(None), slots_of_other=slice(None)):
    """The same bits."""
    for name in KEPT:
        np.testing.assert_array_equal(one[name][..., slots_of_one], other[name][..., slots_of_other], err_msg=name)


def test_restored_worlds_go_on_bit_for_bit(device):
    solver = Solver(stirred(), SCHEME, num_worlds=2, device=device)
    solver.set_parameters(sound_speed=[10.0, 14.0])
    solver.step(20)
    saved = solver.save()
    solver.step(20)
    expected = solver.save()
    fresh = Solver(stirred(), SCHEME, num_worlds=2, device=device)
    fresh.step(3)
    fresh.restore(saved)
    fresh.step(20, solver._step_size)
    assert_same(fresh.save(), expected)


def test_worlds_do_not_interact(device):
    scene, other = stirred(), stirred(seed=9)
    alone = Solver(scene, SCHEME, device=device)
    batch = Solver(scene, SCHEME, num_worlds=3, device=device)
    fewer = other.sample()
    keep = slice(0, len(fewer) - 20)
    fewer = dataclasses.replace(
        fewer, **{field.name: value[keep] for field in dataclasses.fields(fewer)
                  if (value := getattr(fewer, field.name)) is not None}
    )  # fmt: skip
    batch.set_start([0, 2], [other.sample(), fewer])
    batch.reset()
    for solver in (alone, batch):
        solver.step(40)
    n = alone.capacity
    assert_same(alone.save(), batch.save(), slice(0, n), slice(n, 2 * n))
    assert len(batch.particles(2)) == n - 20
    assert abs(batch.particles(2).pressure.mean()) < 1.0


# -- where it is left out --------------------------------------------------------------------------------------------


def free_surface(**changes):
    """A box half full."""
    fluid = Fluid(Box((0.0, 0.0), (1.0, 0.5)))
    return Scene((0.0, 0.0), (1.0, 1.0), DX, fluid, reference_speed=1.0, **changes)


def full(**changes):
    """A box that is full at the start."""
    return Scene((0.0, 0.0), (1.0, 1.0), DX, Fluid(Box((0.0, 0.0), (1.0, 1.0))), reference_speed=1.0, **changes)


ELSEWHERE = {
    "free surface": (free_surface(), Scheme()),
    "open face": (full(faces={"y_max": OPEN}), Scheme()),
    "moving face": (full(faces={"x_max": Face(moving=True)}), Scheme()),
    "body": (full(bodies={"post": Body(Box((0.5, 0.5), (0.502, 0.502)))}), Scheme()),
    "inflow": (full(inflows={"jet": Inflow((0.0, 0.5), (1.0, 0.0), 0.125, 1.0)}), Scheme()),
    "outflow": (full(outflows={"end": Outflow(Box((0.9, 0.0), (0.9001, 0.0001)))}), Scheme()),
    "mueller": (full(), MUELLER),
    "penalty walls": (full(), Scheme(walls=PenaltyWalls())),
    "clamping walls": (full(), Scheme(walls=ClampWalls())),
    "frozen walls": (full(), Scheme(walls=FrozenWalls())),
    "summed density": (full(), Scheme(terms=(POLY6_SUMMATION,))),
    "switched off": (full(), Scheme(shifting=0.0)),
}


@pytest.mark.parametrize("name", ELSEWHERE)
def test_elsewhere_there_is_no_shifting(name):
    scene, scheme = ELSEWHERE[name]
    solver = Solver(scene, scheme, device="cpu")
    assert solver._kernels.shift is None
    assert solver.state.gain.size == 0


def test_a_full_box_is_shifted_by_default():
    for scene in (full(), full(faces=periodic("x")), stirred(), stirred(3, size=0.5)):
        assert scene.is_full
        assert Solver(scene, device="cpu")._kernels.shift is not None
    assert not free_surface().is_full


def test_shifting_out_of_its_limits_is_refused():
    with pytest.raises(ValueError, match=r"Scheme.shifting = 5 is outside 0 to 4; use 2"):
        Scheme(shifting=5.0)
