"""What a particle makes of its surroundings: the rules by themselves, and what comes of them in sheets and clumps."""

import dataclasses
import math

import numpy as np
import pytest

from fluidgym.diagnostics import measure
from fluidgym.records import unpack
from fluidgym.scene import OPEN, Box, Fluid, Material, Particles, Scene, face_names
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.sph.surroundings import SPRAY_COMPANY, packing_pressure, spray_share

DX = 0.125
C_0 = 20.0
H = {2: 2.2 * DX, 3: 1.5 * DX}  # by dimension
PRESSURE_ONLY = Scheme(density_diffusion=0.0, artificial_viscosity=0.0, acoustic_damping=0.0)


# -- the rules -------------------------------------------------------------------------------------------------------


def values(function, *arguments):
    """What a Warp function gives for arrays of arguments."""
    arguments = np.broadcast_arrays(*arguments)
    return np.array([function(*map(float, one)) for one in zip(*arguments, strict=True)])


def test_spray_has_the_share_of_its_company():
    company = np.linspace(-0.01, 0.2, 50)
    found = values(spray_share, company)
    np.testing.assert_allclose(found, np.interp(company, [0.0, SPRAY_COMPANY], [0.0, 1.0]), atol=1e-6)
    assert found.min() == 0.0 and found.max() == 1.0


def test_packed_particles_have_pressure_and_others_none():
    crowd = np.linspace(0.0, 3.0, 121)
    found = values(packing_pressure, crowd)
    np.testing.assert_allclose(found, 0.1 * np.maximum(crowd - 1.25, 0.0), atol=1e-7)
    assert not found[crowd <= 1.25].any()


# -- what comes of them ----------------------------------------------------------------------------------------------


def loose(places, velocities=0.0, error=0.0, scheme=PRESSURE_ONLY, device="cpu"):
    """A solver of particles at places (n, dim) in free space, with density errors."""
    dim, room = places.shape[1], 3.0
    fluid = Fluid(Box((-0.5 * room,) * dim, (0.5 * room,) * dim))
    scene = Scene(
        (-room,) * dim,
        (room,) * dim,
        DX,
        fluid,
        faces=dict.fromkeys(face_names(dim), OPEN),
        gravity=0.0,
        material=Material(sound_speed=C_0),
        reference_speed=1.0,
    )
    solver, n = Solver(scene, scheme, device=device), len(places)
    pressure = np.broadcast_to(1000.0 * C_0**2 * np.asarray(error), n)
    moves = np.broadcast_to(velocities, places.shape)
    solver.set_start([0], [Particles(places, moves, np.full(n, 1000.0), pressure, np.arange(n))])
    solver.reset()
    return solver


def block(counts, spacing=DX):
    """A lattice of so many particles along each axis, about the origin (n, dim)."""
    lines = [(np.arange(n) - 0.5 * (n - 1)) * spacing for n in counts]
    return np.stack([axis.ravel() for axis in np.meshgrid(*lines, indexing="ij")], axis=1)


def field_in_order(solver):
    """What the force terms read, in order of identity."""
    width = solver._structure.end_width
    return in_order(solver, unpack(solver.state.end, width, solver.capacity)[2 * solver.scene.dim])


def in_order(solver, array):
    """Values of the particles, as they are at hand, in order of identity."""
    array = array if isinstance(array, np.ndarray) else array.numpy()
    identity = solver.state.now.identity.numpy()[: solver.capacity]
    order = np.argsort(identity)[np.count_nonzero(identity < 0) :]
    return array[..., : solver.capacity][..., order].T.astype(float)


def slope(r, dim, core=None):
    """W'(r)/r of the default kernel, Wendland C4 in two dimensions and C2 in three, with its core or another."""
    core = {2: 1.0, 3: 0.0}[dim] if core is None else core
    h, sigma = H[dim], {2: 9 / (4 * math.pi), 3: 21 / (16 * math.pi)}[dim] / H[dim] ** dim
    q, t = r / h, np.maximum(1 - r / (2 * h), 0)
    steeper = 1 + core * np.maximum(1 - r / (0.75 * DX), 0)
    return sigma / h**2 * {2: -(t**5) * (14 / 3 + 35 / 3 * q), 3: -5 * t**3}[dim] * steeper


def crowd_of(places):
    """Company over that of a lattice, by brute force and without the core, (n,)."""
    dim = places.shape[1]
    r = np.linalg.norm(places[:, None] - places[None], axis=2)
    lattice = np.linalg.norm(block((9,) * dim), axis=1)
    return (slope(r, dim, 0.0) * (r > 0)).sum(axis=1) / (slope(lattice, dim, 0.0) * (lattice > 1e-9)).sum()


@pytest.mark.parametrize("dim", [2, 3])
def test_a_particle_in_full_surroundings_feels_full_tension(dim, device):
    places = block({2: (19, 19), 3: (13, 13, 13)}[dim])
    steep = 0.04  # [1/m]
    error = -0.05 - steep * places[:, 0]
    solver = loose(places, error=error, scheme=Scheme(tear=1.0), device=device)
    inside = np.abs(places).max(axis=1) < 0.6 * DX  # their neighbours' neighbours are all there
    lattice = block((9,) * dim)
    unit = -((DX**dim) * slope(np.linalg.norm(lattice, axis=1), dim) * lattice[:, 0] ** 2).sum()
    expected = np.zeros(dim)
    expected[0] = steep * C_0**2 * unit  # -c_0^2 grad s; on a lattice the constant part cancels
    found = in_order(solver, solver.state.now.acceleration)[inside]
    assert len(found) >= 1
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=2e-3 * abs(expected[0]))
    field = field_in_order(solver)
    np.testing.assert_allclose(field[inside], error[inside], rtol=1e-4)


@pytest.mark.parametrize("dim", [2, 3])
def test_tension_ends_where_fluid_tears_and_the_void_is_remembered(dim, device):
    places = block({2: (19, 19), 3: (13, 13, 13)}[dim])
    solver = loose(places, error=-0.2, scheme=Scheme(tear=0.05), device=device)
    inside = np.abs(places).max(axis=1) < 0.6 * DX
    np.testing.assert_allclose(field_in_order(solver)[inside], -0.05, rtol=1e-6)
    np.testing.assert_allclose(in_order(solver, solver.state.now.density_error)[inside], -0.2, rtol=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_sheet_that_is_all_surface_is_held_together_by_tension_and_without_it_flies_apart(dim, device):
    # Two layers that are drawn out along themselves.
    places = block((13,) * (dim - 1) + (2,))
    assert crowd_of(places).max() < 0.9
    velocity = 0.5 * places * np.array([1.0] * (dim - 1) + [0.0])
    solver = loose(places, velocity, error=-0.02, device=device)
    np.testing.assert_allclose(field_in_order(solver), -0.02, rtol=1e-5)
    a = in_order(solver, solver.state.now.acceleration)
    rim = np.abs(places[:, 0]) > 5.5 * DX
    assert (a[rim, 0] * places[rim, 0] < 0.0).all()
    scheme = Scheme(density_diffusion=0.0, artificial_viscosity=0.0, acoustic_damping=0.0, tension=False)
    solver = loose(places, velocity, error=-0.02, scheme=scheme, device=device)
    solver.advance(0.5)
    now = solver.particles()
    np.testing.assert_allclose(now.velocity, velocity, atol=1e-6)
    np.testing.assert_allclose(now.position, places + 0.5 * velocity, atol=1e-4 * DX)


def test_spray_loses_its_density_error_and_company_keeps_it(device):
    # Pairs in free space at growing distances: one neighbour weighs V h^2 |W'/r|.
    gaps = DX * np.array([1.0, 2.0, 2.5, 3.0, 3.5, 3.9, 4.5])
    left = np.stack([np.full(7, -2.0), np.linspace(-2.4, 2.4, 7)], axis=1)
    places = np.concatenate([left, left + np.stack([gaps, 0.0 * gaps], axis=1)])
    solver = loose(places, error=-0.01, device=device)
    share = np.minimum(-(DX**2) * H[2] ** 2 * slope(gaps, 2, 0.0) / 0.05, 1.0)
    assert share[:2].min() == 1.0 and share[-1] == 0.0 and ((share > 0.0) & (share < 1.0)).sum() >= 3
    expected = -0.01 * np.tile(share, 2)
    np.testing.assert_allclose(field_in_order(solver), expected, atol=1e-7)
    np.testing.assert_allclose(in_order(solver, solver.state.now.density_error), -0.01, rtol=1e-6)  # a start is kept
    solver.step(1, 1e-7)
    np.testing.assert_allclose(in_order(solver, solver.state.now.density_error), expected, atol=1e-7)


@pytest.mark.parametrize("core", [0.0, 1.0, 4.0])
def test_the_pressure_of_packed_particles_is_that_of_their_crowd_whatever_the_core(core, device):
    places = block((11, 11), spacing=0.7 * DX)
    crowd = crowd_of(places)
    assert crowd.max() > 1.4 and crowd.min() < 1.0
    solver = loose(places, scheme=Scheme(core=core), device=device)
    expected = 0.1 * np.maximum(crowd - 1.25, 0.0)
    np.testing.assert_allclose(field_in_order(solver), expected, atol=1e-6)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_core_pushes_pairs_that_are_close_and_no_others(dim, device):
    # Pairs under pressure, out of each other's sight.
    gaps = DX * np.array([0.05, 0.3, 0.6, 0.74, 0.76, 1.0, 1.5])
    left = np.zeros((7, dim))
    left[:, 0], left[:, 1] = -2.0, np.linspace(-2.4, 2.4, 7)
    places = np.concatenate([left, left + gaps[:, None] * np.eye(dim)[0]])
    bare, usual, strong = (
        in_order(solver, solver.state.now.acceleration)
        for solver in (
            loose(places, error=0.02, scheme=dataclasses.replace(PRESSURE_ONLY, core=core), device=device)
            for core in (0.0, 1.0, 3.0)
        )
    )
    assert (bare[:7, 0] < -0.1).all() and (bare[7:, 0] > 0.1).all()
    share = np.maximum(1.0 - gaps / (0.75 * DX), 0.0)
    for cored, core in ((usual, 1.0), (strong, 3.0)):
        np.testing.assert_allclose(cored[:7, 0] / bare[:7, 0], 1.0 + core * share, rtol=1e-4)
        np.testing.assert_array_equal(cored[7:], -cored[:7])


@pytest.mark.parametrize("core", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_pairs_within_the_core_keep_momentum_and_energy(dim, core, device):
    # A loose cluster, so that packing makes no pressure, with close pairs that are driven through each other.
    random = np.random.default_rng(4)
    places = block({2: (6, 5), 3: (4, 4, 4)}[dim], spacing=1.25 * DX)
    places = np.concatenate([places, places[::4] + 0.4 * DX * random.uniform(-1.0, 1.0, places[::4].shape)])
    velocity = np.array([0.5, -0.25, 0.125])[:dim] + 0.5 * random.uniform(-1.0, 1.0, places.shape)
    scheme = dataclasses.replace(PRESSURE_ONLY, core=core)
    solver = loose(places, velocity, error=0.01, scheme=scheme, device=device)
    start = measure(solver)
    exchanged, closest = 0.0, np.inf
    for _ in range(30):
        solver.step(10, 0.1 * solver.max_step)
        now, x = measure(solver), solver.particles().position.astype(float)
        assert now.energy == pytest.approx(start.energy, rel=2e-4)
        np.testing.assert_allclose(now.momentum, start.momentum, atol=1e-6 * np.abs(start.momentum).max())
        assert crowd_of(x).max() < 1.25
        closest = min(closest, np.linalg.norm(x[:, None] - x[None], axis=2)[np.triu_indices(len(x), 1)].min())
        exchanged = max(exchanged, abs(now.kinetic_energy - start.kinetic_energy))
    assert closest < 0.1 * DX
    assert exchanged > 0.03 * start.energy


@pytest.mark.parametrize("tension", [False, True], ids=["without tension", "with tension"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_crowded_clump_is_pushed_apart_and_keeps_its_momentum(dim, tension, device):
    random = np.random.default_rng(1)
    places = block({2: (10, 10), 3: (8, 8, 8)}[dim], spacing=0.85 * DX)
    places += 0.05 * DX * random.uniform(-1.0, 1.0, places.shape)
    crowd, drift = crowd_of(places), np.array([0.5, -0.25, 0.125])[:dim]
    assert crowd.max() > 1.4
    # No density error: of the clump it knows nothing.
    solver = loose(places, drift, scheme=Scheme(tension=tension), device=device)
    a = in_order(solver, solver.state.now.acceleration)
    outward, scale = ((places - places.mean(axis=0)) * a).sum(), np.abs(a).sum()
    assert outward > 100.0
    np.testing.assert_allclose(a.sum(axis=0), 0.0, atol=1e-7 * scale)
    solver.advance(0.02 if tension else 0.13)
    now = solver.particles()
    np.testing.assert_allclose(now.velocity.mean(axis=0), drift, atol=1e-6)
    later, size = (np.linalg.norm(x - x.mean(axis=0), axis=1).mean() for x in (now.position.astype(float), places))
    # Where it may, what opens pulls back: the density knows of that.
    assert later / size > (1.003 if tension else 1.05)
    assert crowd_of(now.position.astype(float)).max() < (crowd.max() - 0.02 if tension else 1.3)
