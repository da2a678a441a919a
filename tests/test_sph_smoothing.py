"""Smoothing kernels: each integrates to one and its gradient to nothing, in two and three dimensions."""

import math

import numpy as np
import pytest
import warp as wp

from fluidgym.layout import CORE_RADIUS, lattice_laplacian
from fluidgym.scheme import DEFAULT_SCHEME
from fluidgym.sph import smoothing
from fluidgym.sph.constants import Constants

KERNELS = [kernel for kernel in vars(smoothing).values() if isinstance(kernel, smoothing.SmoothingKernel)]
H, DX = 0.7, 0.35

each_kernel = pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)
each_dim = pytest.mark.parametrize("dim", [2, 3])


def make_constants(kernel, dim, h=H, core=0.0):
    """The constants that a smoothing kernel reads."""
    c = Constants()
    c.core, c.inv_core_radius = core, 1.0 / (CORE_RADIUS * DX)
    c.h, c.support = h, kernel.support * h
    c.inv_h, c.inv_h_volume, c.inv_h_slope = 1.0 / h, 1.0 / h**dim, 1.0 / h ** (dim + 2)
    return c


def evaluate(kernel, r, dim, h=H, core=None):
    """W(r) and W'(r)/r as the device computes them, each of the shape of r, in double precision; cored if so given."""
    value, slope = kernel.value(dim), kernel.slope(dim, cored=core is not None)

    @wp.kernel(module="unique", enable_backward=False)
    def both(r: wp.array[float], c: Constants, W: wp.array[float], dW: wp.array[float]):
        i = wp.tid()
        W[i] = value(r[i], c)
        dW[i] = slope(r[i], c)

    flat = np.asarray(r, np.float32).ravel()
    W, dW = (wp.zeros(flat.size, dtype=float, device="cpu") for _ in range(2))
    c = make_constants(kernel, dim, h, core or 0.0)
    wp.launch(both, flat.size, [wp.array(flat, device="cpu"), c], [W, dW], device="cpu")
    return W.numpy().astype(float).reshape(np.shape(r)), dW.numpy().astype(float).reshape(np.shape(r))


def test_there_is_a_kernel():
    assert KERNELS
    assert all(DEFAULT_SCHEME.kernel_in(dim) in KERNELS for dim in (2, 3))


@each_dim
@each_kernel
def test_kernel_integrates_to_one(kernel, dim):
    # In shells: the midpoint rule is as good as float32; the cut at the centre of the viscosity kernel costs 1e-6.
    n = 20_000
    r = (np.arange(n) + 0.5) / n * kernel.support * H
    shell = {2: 2 * math.pi * r, 3: 4 * math.pi * r**2}[dim]
    W, _ = evaluate(kernel, r, dim)
    assert (W * shell).sum() * kernel.support * H / n == pytest.approx(1.0, abs=5e-6)


@each_dim
@each_kernel
def test_gradient_integrates_to_nothing_and_moves_a_linear_field_by_its_slope(kernel, dim):
    # On a grid of points: sum grad W = 0 and, by parts, sum x_a dW/dx_b = -1 where a = b and 0 elsewhere.
    n = {2: 400, 3: 80}[dim]
    line = ((np.arange(n) + 0.5) / n * 2.0 - 1.0) * kernel.support * H
    x = np.stack(np.meshgrid(*[line] * dim, indexing="ij")).reshape(dim, -1)
    volume = (2.0 * kernel.support * H / n) ** dim
    _, slope = evaluate(kernel, np.sqrt((x**2).sum(axis=0)), dim)
    gradient = slope * x
    scale = np.abs(gradient).sum() * volume
    np.testing.assert_allclose(gradient.sum(axis=1) * volume / scale, 0.0, atol=1e-7)
    np.testing.assert_allclose(x @ gradient.T * volume, -np.eye(dim), atol=2e-4)


@each_dim
@each_kernel
def test_slope_is_the_derivative_of_the_value_over_the_distance(kernel, dim):
    r = np.linspace(0.1, 0.95, 18) * kernel.support * H
    step = 0.002 * kernel.support * H
    (low, _), (high, _) = (evaluate(kernel, r + side * step, dim) for side in (-1, 1))
    _, slope = evaluate(kernel, r, dim)
    peak = np.abs(slope * r).max()
    np.testing.assert_allclose((high - low) / (2 * step) / peak, slope * r / peak, atol=5e-4)


@each_dim
@each_kernel
def test_kernel_is_nothing_beyond_its_support_and_finite_at_its_centre(kernel, dim):
    r = np.array([0.0, 0.5, 0.99, 1.0, 1.01, 50.0]) * kernel.support * H
    W, slope = evaluate(kernel, r, dim)
    assert np.isfinite(W).all()
    assert np.isfinite(slope).all()
    assert (W[:3] > 0.0).all()
    assert (slope[1:3] < 0.0).all()
    scale = W[0]
    np.testing.assert_allclose(W[3:] / scale, 0.0, atol=1e-12)
    np.testing.assert_allclose(slope[3:] * H**2 / scale, 0.0, atol=1e-12)


@each_dim
@each_kernel
def test_core_steepens_the_slope_of_close_pairs_and_of_no_others(kernel, dim):
    close, beyond = np.linspace(0.0, 0.75, 21) * DX, np.linspace(0.75 * DX, 2.0 * H, 40)
    (W, near), (_, far) = (evaluate(kernel, r, dim) for r in (close, beyond))
    for core in (0.5, 1.0, 4.0):
        cored_W, cored = evaluate(kernel, close, dim, core=core)
        np.testing.assert_array_equal(cored_W, W)
        np.testing.assert_allclose(cored / near, 1.0 + core * np.linspace(1.0, 0.0, 21), rtol=1e-6)
        np.testing.assert_allclose(evaluate(kernel, beyond, dim, core=core)[1], far, rtol=1e-6)


@each_dim
@pytest.mark.parametrize("ratio", [1.3, 1.5, 2.0])
def test_lattice_constant_makes_the_laplacian_of_a_parabola_exact(dim, ratio):
    # sum 2 V (f_i - f_j) W'/r of f = x^2 on a lattice is k times its Laplacian, 2.
    for kernel in (smoothing.WENDLAND_C2, smoothing.WENDLAND_C4, smoothing.CUBIC_SPLINE):
        dx = 0.1
        line = np.arange(-7, 8) * dx
        x = np.stack([axis.ravel() for axis in np.meshgrid(*[line] * dim)])
        _, slope = evaluate(kernel, np.sqrt((x**2).sum(axis=0)), dim, ratio * dx)
        laplacian = (2.0 * dx**dim * (0.0 - x[0] ** 2) * slope).sum()
        assert laplacian / lattice_laplacian(kernel, ratio, dim) == pytest.approx(2.0, rel=1e-5)


@each_dim
def test_volumes_of_a_lattice_add_up_to_one_within_a_percent(dim):
    kernel = DEFAULT_SCHEME.kernel_in(dim)
    dx = 0.1
    h = DEFAULT_SCHEME.smoothing_length(dx, dim)
    line = np.arange(-4, 5) * dx
    x = np.stack(np.meshgrid(*[line] * dim)).reshape(dim, -1)
    for shift in (0.0, 0.25, 0.5):  # seen from a particle, and from places between particles
        W, _ = evaluate(kernel, np.sqrt(((x - shift * dx) ** 2).sum(axis=0)), dim, h)
        assert W.sum() * dx**dim == pytest.approx(1.0, abs=0.01)
