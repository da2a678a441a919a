"""The fluid on a coarse grid: what a controller sees.

A particle is a cube of side dx. What each coarse cell overlaps of the cube is deposited there, and border cells take
what sticks out of the box, so the cells together hold every particle whole. The sums are integers (fixed point):
adding them in any order gives the same bits, so atomic additions leave no trace and the mass is conserved exactly.
"""

from collections.abc import Sequence
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import warp as wp

from fluidgym.compilation import OPTIONS, Replay
from fluidgym.sph.neighbors import three

ONE = wp.constant(wp.int64(1 << 24))  # a whole particle, or a particle at the reference speed, in fixed point
TOO_FAST = wp.constant(1.0e4)  # speeds beyond so many reference speeds are cut, as their sum would overflow


@wp.struct
class CoarseCells:
    """The coarse grid of one world; every world has the same."""

    lower: wp.vec3  # corner [m]
    inv_width: wp.vec3  # [1/m]
    count: wp.vec3i  # cells along each axis
    reach: wp.vec3  # side of a particle over width of a cell
    inv_speed: float  # 1 / reference speed [s/m]
    value: float  # what one in fixed point adds to a cell
    fraction_limit: float  # what is handed out is clipped: fluid fraction to 0 .. limit
    momentum_limit: float  # and momentum to -limit .. limit


@lru_cache
def make_deposit(dim: int) -> SimpleNamespace:
    """Kernels of the deposit: add, which sums in fixed point, and finish, which hands out numbers."""
    vec = wp.types.vector(dim, wp.float32)

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def add(
        capacity: int,
        cells: CoarseCells,
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        identity: wp.array[int],
        sums: wp.array3d[wp.int64],
    ):
        i = wp.tid()
        world = i // capacity
        here = vec()
        speed = vec()
        total = float(0.0)
        for k in range(wp.static(dim)):
            here[k] = (position[k, i] - cells.lower[k]) * cells.inv_width[k] - 0.5 * cells.reach[k]
            speed[k] = wp.clamp(velocity[k, i] * cells.inv_speed, -TOO_FAST, TOO_FAST)
            total += position[k, i] + velocity[k, i]
        if identity[i] >= 0 and wp.isfinite(total):
            rest = wp.int64(ONE)
            for corner in range(wp.static(1 << dim)):
                share = float(1.0)
                cell = int(0)
                stride = int(1)
                for k in range(wp.static(dim)):
                    side = (corner >> k) & 1
                    first = wp.floor(here[k])
                    inside = wp.min((first + 1.0 - here[k]) / cells.reach[k], 1.0)
                    if side == 1:
                        inside = 1.0 - inside
                    share *= inside
                    cell += stride * wp.clamp(int(first) + side, 0, cells.count[k] - 1)
                    stride *= cells.count[k]
                part = wp.int64(wp.round(share * float(ONE)))
                if corner == wp.static((1 << dim) - 1):
                    part = rest  # nothing is lost to rounding
                rest -= part
                if part != wp.int64(0):
                    wp.atomic_add(sums, world, 0, cell, part)
                    for k in range(wp.static(dim)):
                        wp.atomic_add(sums, world, 1 + k, cell, wp.int64(wp.round(float(part) * speed[k])))

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def finish(cells: CoarseCells, sums: wp.array3d[wp.int64], values: wp.array3d[float]):
        world, channel, cell = wp.tid()
        value = cells.value * float(sums[world, channel, cell])
        if channel == 0:
            value = wp.clamp(value, 0.0, cells.fraction_limit)
        else:
            value = wp.clamp(value, -cells.momentum_limit, cells.momentum_limit)
        values[world, channel, cell] = value

    return SimpleNamespace(add=add, finish=finish)


class Deposit:
    """Fluid fraction and momentum on a coarse grid over the box, in every world.

    The fluid fraction of a cell is the rest volume of the fluid in it over the volume of the cell; the momentum is
    that of the cell over what it would be, full and at the reference speed.
    """

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        shape: Sequence[int],
        spacing: float,
        reference_speed: float,
        num_worlds: int,
        capacity: int,
        device: wp.Device,
        fraction_limit: float = np.inf,
        momentum_limit: float = np.inf,
    ):
        """Lay out the grid.

        Args:
            lower: Lower corner of the box [m], (dim,).
            upper: Upper corner of the box [m], (dim,).
            shape: Cells along each axis, the last axis of space first: (ny, nx) or (nz, ny, nx).
            spacing: Particle spacing dx [m].
            reference_speed: Speed that counts as 1 [m/s].
            num_worlds: Number of worlds.
            capacity: Slots of each world.
            device: Where the particles are.
            fraction_limit: The fluid fraction is clipped to 0 .. this.
            momentum_limit: The momentum is clipped to -this .. this.

        Raises:
            ValueError: A cell is smaller than a particle.
        """
        dim, count = len(lower), np.asarray(shape, int)[::-1]
        width = (np.asarray(upper, float) - lower) / count
        if (width < spacing * (1 - 1e-6)).any():
            most = np.floor((np.asarray(upper, float) - lower) / spacing + 1e-6).astype(int)[::-1]
            raise ValueError(
                f"grid shape = {tuple(map(int, shape))} has cells of {width.min():.3g} m, finer than the particle"
                f" spacing {spacing:.3g} m; use at most {tuple(map(int, most))}"
            )
        self._kernels = make_deposit(dim)
        self._num_worlds, self._capacity, self._device = num_worlds, capacity, device
        cells = CoarseCells()
        cells.lower = wp.vec3(*three(lower, 0.0))
        cells.inv_width = wp.vec3(*three(1.0 / width, 1.0))
        cells.count = wp.vec3i(*(int(n) for n in three(count, 1)))
        cells.reach = wp.vec3(*three(spacing / width, 1.0))
        cells.inv_speed = 1.0 / reference_speed
        cells.value = spacing**dim / float(np.prod(width)) / float(1 << 24)
        cells.fraction_limit, cells.momentum_limit = fraction_limit, momentum_limit
        self._cells = cells
        sizes = (num_worlds, 1 + dim, int(count.prod()))
        self._sums = wp.zeros(sizes, dtype=wp.int64, device=device)
        self._values = wp.zeros(sizes, dtype=float, device=device)
        self._replay = Replay(device)
        self.shape = (num_worlds, 1 + dim, *map(int, shape))

    def run(self, position: wp.array, velocity: wp.array, identity: wp.array) -> np.ndarray:
        """Deposit the particles.

        Args:
            position: [m], (dim, slot).
            velocity: [m/s], (dim, slot).
            identity: Negative for retired particles, (slot,).

        Returns:
            Fluid fraction and the components of momentum, (world, 1 + dim, ny, nx) or (world, 1 + dim, nz, ny, nx).
        """
        return self.run_on_device(position, velocity, identity).numpy().reshape(self.shape).copy()

    def run_on_device(self, position: wp.array, velocity: wp.array, identity: wp.array) -> wp.array:
        """Deposit the particles, and leave it on the device.

        Args:
            position: [m], (dim, slot).
            velocity: [m/s], (dim, slot).
            identity: Negative for retired particles, (slot,).

        Returns:
            As of `run`, (world, 1 + dim, cell); the next call overwrites it.
        """

        def launch() -> None:
            slots = self._num_worlds * self._capacity
            inputs = [self._capacity, self._cells, position, velocity, identity]
            values, device = self._values, self._device
            self._sums.zero_()
            wp.launch(self._kernels.add, slots, inputs, [self._sums], device=device)
            wp.launch(self._kernels.finish, self._sums.shape, [self._cells, self._sums], [values], device=device)

        self._replay(launch, position, velocity, identity)
        return self._values
