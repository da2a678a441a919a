"""The native pair loop against its twin in plain Warp, directly and over a whole step."""

from functools import partial

import numpy as np
import pytest
import warp as wp

from fluidgym.compilation import OPTIONS
from fluidgym.records import SUMS, fetch, make_records, pack
from fluidgym.scene import OPEN, PERIODIC, Box, Face, Fluid, Material, Particles, Scene
from fluidgym.scheme import DEFAULT_SCHEME
from fluidgym.solver import Solver
from fluidgym.sph.constants import Constants
from fluidgym.sph.continuity import CENTRAL_DIFFUSION, DIVERGENCE
from fluidgym.sph.neighbors import Grid
from fluidgym.sph.pair_loop import make_pair_loop
from fluidgym.sph.terms import DensityRate

# Two steps' kernels each: periodic along x, a wall that holds the fluid, one that moves, and an opening.
FACES = {
    2: {"x_min": PERIODIC, "x_max": PERIODIC, "y_min": Face(slip="no", moving=True)},
    3: {
        "x_min": PERIODIC,
        "x_max": PERIODIC,
        "y_min": Face(slip="no", sliding=(0.3, 0.0, 0.1)),
        "z_min": Face(moving=True),
        "z_max": OPEN,
    },
}


def make_solver(dim, plain_loops=False, device="cpu"):
    """Two worlds of stirred, jittered fluid."""
    upper = (1.0, 1.0, 0.8)[-dim:]
    scene = Scene(
        (0.0,) * dim,
        upper,
        0.1,
        Fluid(Box((0.0,) * dim, upper)),
        faces=FACES[dim],
        material=Material(viscosity=0.02, sound_speed=25.0),
        reference_speed=2.0,
        jitter=0.3,
    )
    solver = Solver(scene, num_worlds=2, plain_loops=plain_loops, device=device)
    random, starts = np.random.default_rng(9), []
    for _ in range(2):
        start = scene.sample()
        pressure = 1000.0 * 25.0**2 * random.uniform(-0.01, 0.02, len(start))
        velocity = random.uniform(-1.0, 1.0, start.position.shape)
        starts.append(Particles(start.position, velocity, start.density, pressure, start.identity))
    solver.set_start([0, 1], starts)
    solver.reset()
    return solver


def sum_all(solver, terms, force, tilted, signed, leaning, device, central=False):
    """Sums of the native, the plain and, without signs, of half a loop: with a tilt and accelerations of a hundred g.

    There is an offset where there are signs. (loop, slot, component)
    """
    dim, slots = solver.scene.dim, 2 * solver.capacity
    slope = DEFAULT_SCHEME.kernel_in(dim).slope(dim, cored=DEFAULT_SCHEME.core_in(dim) > 0.0)
    width = 2 * dim + 1 + dim * leaning
    make = partial(make_pair_loop, dim, terms, slope, force, width, tilted, leaning=leaning, weight=slope)
    native, emit_terms = make(signed)
    plain, _ = make(signed, plain=True)
    half, _ = make(half=not signed and device == "cpu", central=central)
    vec = wp.types.vector(dim, wp.float32)
    parts = dim if force else 3

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def all_three(
        capacity: int,
        constants: wp.array[Constants],
        grid: Grid,
        bounds: wp.array[int],
        records: wp.array[float],
        offset: float,
        tilt: vec,
        bend: float,
        sign: vec,
        given: wp.array[float],
        spans: wp.array[int],
        sums: wp.array3d[float],
    ):
        i = wp.tid()
        c = constants[0]
        c.central_force = bend
        if capacity < 0:
            sums[0, i, 0] = emit_terms(c)
        world = i // capacity
        slot = i + world * grid.slack
        x = vec()
        u = vec()
        for k in range(wp.static(dim)):
            x[k] = fetch(records, slot, k, wp.static(width))
            u[k] = fetch(records, slot, wp.static(dim) + k, wp.static(width))
        lean = tilt
        for k in range(wp.static(dim)):
            if wp.static(leaning and not signed):  # of a pair that is met once, the tilt is a mean of both
                lean[k] -= 0.5 * c.inv_c_0_squared * fetch(records, slot, wp.static(2 * dim + 1) + k, wp.static(width))
            if wp.static(central):
                lean[k] -= bend * c.inv_c_0_squared * x[k]
        a = fetch(records, slot, wp.static(2 * dim), wp.static(width))
        p = native(i, x, u, a, offset, lean, sign, world, c.support, records, bounds, grid, c, given, spans)
        q = plain(i, x, u, a, offset, lean, sign, world, c.support, records, bounds, grid, c, given, spans)
        h = half(i, x, u, a, 0.0, lean, sign, world, c.support, records, bounds, grid, c, given, spans)
        for k in range(wp.static(parts)):
            sums[0, i, k] = p[k]
            sums[1, i, k] = q[k]
            sums[2, i, k] = h[k]

    start = solver.state.start
    pulls = np.random.default_rng(2).uniform(-1000.0, 1000.0, start.velocity.shape)
    rows = [start.position.numpy(), start.velocity.numpy(), start.density_error.numpy()[None]] + [pulls] * leaning
    records = pack(np.concatenate(rows), solver.device, solver.capacity)
    given = make_records(solver.state.places, SUMS, solver.device)
    sums = wp.zeros((3, slots, parts), dtype=float, device=device)
    inputs = [solver.capacity, solver._constants, solver._grid, solver._bounds, records, 0.004 * signed]
    tilt, sign = vec(*[0.03, -0.02, 0.01][:dim]), vec(*[-1.0, 1.0, -1.0][:dim])
    wp.launch(all_three, slots, [*inputs, tilt, 40.0 * central, sign, given, solver.state.spans, sums], device=device)
    assert not given.numpy().any()
    return sums.numpy().astype(float)


@pytest.mark.parametrize("force", [False, True], ids=["density", "force"])
@pytest.mark.parametrize(
    ("dim", "tilted", "signed", "leaning"),
    [
        (2, False, False, False),
        (2, True, True, False),
        (2, True, False, True),
        (3, True, True, False),
        (3, True, True, True),
    ],
    ids=["2D bare", "2D", "2D leaning", "3D", "3D leaning"],
)
def test_native_and_plain_loop_give_the_same_sums(dim, force, tilted, signed, leaning, device):
    scheme = DEFAULT_SCHEME
    terms = scheme.force_terms(viscous=True) if force else scheme.density_terms()
    native, plain, _ = sum_all(make_solver(dim, device=device), terms, force, tilted, signed, leaning, device)
    scale = np.abs(plain).max(axis=0)
    scale = scale[scale > 0.0]
    assert len(scale) == (dim if force else 2)
    np.testing.assert_allclose(native[:, : len(scale)] / scale, plain[:, : len(scale)] / scale, atol=1e-6)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("sweep", ["density", "central density", "force"])
def test_half_a_loop_gives_the_same_sums(dim, sweep):
    # Where threads come one after another, which is on a CPU.
    scheme, force = DEFAULT_SCHEME, sweep == "force"
    terms = scheme.force_terms(viscous=True) if force else scheme.density_terms()
    if sweep == "central density":
        terms = (DIVERGENCE, CENTRAL_DIFFUSION)
    _, plain, half = sum_all(
        make_solver(dim), terms, force, not force, False, not force, "cpu", central=sweep == "central density"
    )
    scale = np.abs(plain).max(axis=0)
    scale = scale[scale > 0.0]
    assert len(scale) == (dim if force else 2)
    np.testing.assert_allclose(half[:, : len(scale)] / scale, plain[:, : len(scale)] / scale, atol=2e-6)


@wp.func
def field_of_neighbour(r: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
    return wp.where(slope < 0.0, a_j, 0.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_loop_that_leans_takes_half_of_what_accelerations_make_of_density(dim, device):
    # Against all pairs: the two sums differ by that of a_j.(X - x_j) / (2 c_0^2).
    solver, terms = make_solver(dim, device=device), (DensityRate(field_of_neighbour),)
    (upright, _), (leaning, plain) = (
        sum_all(solver, terms, False, True, True, leans, device)[:2, :, 0] for leans in (False, True)
    )
    slots, start = 2 * solver.capacity, solver.state.start
    x = start.position.numpy()[:, :slots].T.astype(float)
    lean = np.random.default_rng(2).uniform(-1000.0, 1000.0, start.velocity.shape)[:, :slots].T
    d = x[:, None] - x[None]
    world = np.arange(slots) // solver.capacity
    near = (np.linalg.norm(d, axis=2) < solver._numbers["support"]) & (world[:, None] == world)
    expected = -(near * (d * lean).sum(axis=2)).sum(axis=1) / (2.0 * 25.0**2)
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(leaning - upright, expected, atol=2e-5)
    np.testing.assert_allclose(plain - upright, expected, atol=2e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_native_and_plain_loop_make_the_same_step(dim, device):
    saved = []
    for plain_loops in (False, True):
        solver = make_solver(dim, plain_loops, device)
        before = solver.save()
        solver.face_velocity[:, solver.face_index("xyz"[dim - 1] + "_min")] = [0.5, -0.5]
        solver.step()
        saved.append(solver.save())
    native, plain = saved
    assert (native["position"] != before["position"]).any()
    np.testing.assert_array_equal(native["identity"], plain["identity"])
    for name in ("position", "velocity", "density_error", "acceleration"):
        scale = np.abs(plain[name]).max()
        np.testing.assert_allclose(native[name] / scale, plain[name] / scale, atol=1e-6, err_msg=name)


def test_what_lies_past_the_last_row_does_not_count():
    # The native loop reads whole blocks of slots, into other worlds and past the end: whatever is there, even nan.
    solver = make_solver(2)
    solver.step(3)
    clean = solver.save()
    solver.reset()
    n = solver.capacity
    saved = solver.save()
    for name in ("position", "velocity", "density_error", "acceleration"):
        saved[name][..., n:] = np.nan
    solver.restore(saved)
    solver.step(3)
    broken = solver.save()
    for name in ("position", "velocity", "density_error", "acceleration", "identity"):
        np.testing.assert_array_equal(broken[name][..., :n], clean[name][..., :n])
    assert np.isnan(broken["position"][..., n : 2 * n]).any()
