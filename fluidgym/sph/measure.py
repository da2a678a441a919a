"""A few numbers of each world's fluid, summed on the device: what a reward needs.

Two stages, so that the order of the sums is fixed: chunks of slots first, then the chunks of a world.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import warp as wp

from fluidgym.compilation import OPTIONS, Replay, shared_module
from fluidgym.sph.neighbors import three

CHUNK = 32  # slots that one thread adds up

Sums = wp.types.vector(15, wp.float32)
LIVE = wp.constant(0)  # particles in the box
IN_ZONE = wp.constant(1)  # of these in the zone
ABOVE = wp.constant(2)  # of these above the height
PLACE = wp.constant(3)  # sum of places along x from the middle of the box [m]
SPREAD = wp.constant(4)  # sum of their squares [m2]
BROKEN = wp.constant(5)  # particles with a number that is not finite
COMPRESSION = wp.constant(6)  # largest s; it, VOID and SPEED are the largest there are, all the others are sums
KINETIC = wp.constant(7)  # sum of u^2 / 2 [m2/s2]
VELOCITY = wp.constant(8)  # first of the sums of the velocities, one for each axis [m/s]
HEIGHT = wp.constant(11)  # first of the sums of the places along the other axes from the middle of the box [m]
SPEED = wp.constant(13)  # square of the largest speed [m2/s2]
VOID = wp.constant(14)  # largest -s


@wp.struct
class Marks:
    """What the fluid of a world is held against."""

    middle: wp.vec3  # of the box [m]
    zone_lower: wp.vec3  # [m]
    zone_upper: wp.vec3  # [m]
    height: float  # [m]
    inv_spacing: float  # of the particles [1/m]


@wp.func
def join(a: Sums, b: Sums) -> Sums:
    """The numbers of two sets of particles together."""
    both = a + b
    both[COMPRESSION] = wp.max(a[COMPRESSION], b[COMPRESSION])
    both[VOID] = wp.max(a[VOID], b[VOID])
    both[SPEED] = wp.max(a[SPEED], b[SPEED])
    return both


@lru_cache
def make_measure(dim: int) -> wp.Kernel:
    """Kernel that adds up the particles of one chunk."""

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def measure_chunk(
        capacity: int,
        marks: Marks,
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        density_error: wp.array[float],
        identity: wp.array[int],
        partial: wp.array2d[Sums],
    ):
        world, chunk = wp.tid()
        sums = Sums()
        for slot in range(chunk * CHUNK, wp.min((chunk + 1) * CHUNK, capacity)):
            i = world * capacity + slot
            if identity[i] >= 0:
                one = Sums()
                one[LIVE] = 1.0
                inside = float(1.0)
                total = density_error[i]
                for k in range(wp.static(dim)):
                    x = position[k, i]
                    # Edges one spacing wide: the share of the particle's cube that is inside.
                    inside *= wp.clamp((x - marks.zone_lower[k]) * marks.inv_spacing + 0.5, 0.0, 1.0)
                    inside *= wp.clamp((marks.zone_upper[k] - x) * marks.inv_spacing + 0.5, 0.0, 1.0)
                    total += x + velocity[k, i]
                top = position[wp.static(dim - 1), i]
                one[IN_ZONE] = inside
                one[ABOVE] = wp.clamp((top - marks.height) * marks.inv_spacing + 0.5, 0.0, 1.0)
                one[PLACE] = position[0, i] - marks.middle[0]
                for k in range(wp.static(dim)):
                    u = velocity[k, i]
                    one[VELOCITY + k] = u
                    one[KINETIC] += 0.5 * u * u
                    if wp.static(k > 0):
                        one[HEIGHT + k - 1] = position[k, i] - marks.middle[k]
                one[SPEED] = 2.0 * one[KINETIC]
                one[SPREAD] = one[PLACE] * one[PLACE]
                one[COMPRESSION] = wp.max(density_error[i], 0.0)
                one[VOID] = wp.max(-density_error[i], 0.0)
                if not wp.isfinite(total):
                    one = Sums()
                    one[LIVE] = 1.0
                    one[BROKEN] = 1.0
                sums = join(sums, one)
        partial[world, chunk] = sums

    return measure_chunk


@wp.kernel(module=shared_module("measure"), enable_backward=False)
def join_chunks(partial: wp.array2d[Sums], totals: wp.array[Sums]):
    """Add up the chunks of each world."""
    world = wp.tid()
    sums = Sums()
    for chunk in range(partial.shape[1]):
        sums = join(sums, partial[world, chunk])
    totals[world] = sums


class Measure:
    """Sums over the particles of every world, held against a zone and a height."""

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        zone: tuple[Sequence[float], Sequence[float]],
        height: float,
        spacing: float,
        num_worlds: int,
        capacity: int,
        device: wp.Device,
    ):
        """Set the marks.

        Args:
            lower: Lower corner of the box [m], (dim,).
            upper: Upper corner of the box [m], (dim,).
            zone: Corners of the zone [m], each (dim,); where it reaches the box it has no edge.
            height: What counts as above [m].
            spacing: Particle spacing dx [m].
            num_worlds: Number of worlds.
            capacity: Slots of each world.
            device: Where the particles are.
        """
        low, high = np.asarray(lower, float), np.asarray(upper, float)
        zone_low, zone_high = np.asarray(zone[0], float), np.asarray(zone[1], float)
        far = 1.0e6 * (high - low).max()
        marks = Marks()
        marks.middle = wp.vec3(*three(0.5 * (low + high), 0.0))
        marks.zone_lower = wp.vec3(*three(np.where(zone_low <= low, -far, zone_low), 0.0))
        marks.zone_upper = wp.vec3(*three(np.where(zone_high >= high, far, zone_high), 0.0))
        marks.height, marks.inv_spacing = height, 1.0 / spacing
        self._marks, self._capacity, self._device = marks, capacity, device
        self._middle = 0.5 * (low + high)
        self._kernel = make_measure(len(lower))
        self._replay = Replay(device)
        self._partial = wp.zeros((num_worlds, -(-capacity // CHUNK)), dtype=Sums, device=device)
        self._totals = wp.zeros(num_worlds, dtype=Sums, device=device)

    def run(
        self, position: wp.array, velocity: wp.array, density_error: wp.array, identity: wp.array
    ) -> dict[str, np.ndarray]:
        """Measure the particles.

        Args:
            position: [m], (dim, slot).
            velocity: [m/s], (dim, slot).
            density_error: s = rho/rho_0 - 1, (slot,).
            identity: Negative for retired particles, (slot,).

        Returns:
            Arrays (world,): live, the number of particles in the box; broken, of these with a number that is not
            finite, which count nowhere else; in_zone and above, shares of the rest; spread, their rms distance along x
            from the centre of mass [m]; compression, the largest s, and void, the largest -s, 0 or more; speed, the
            largest [m/s]; kinetic, the mean of u^2 / 2 [m2/s2]. And arrays (world, dim): middle, the centre of mass
            [m], and velocity, its velocity [m/s].
        """

        def launch() -> None:
            inputs = [self._capacity, self._marks, position, velocity, density_error, identity]
            wp.launch(self._kernel, self._partial.shape, inputs, [self._partial], device=self._device)
            wp.launch(join_chunks, self._totals.shape, [self._partial], [self._totals], device=self._device)

        self._replay(launch, position, velocity, density_error, identity)
        sums = self._totals.numpy().astype(float)
        dim, live, broken = len(self._middle), sums[:, LIVE], sums[:, BROKEN]
        mean = sums / np.maximum(live - broken, 1.0)[:, None]
        return {
            "live": live.astype(int),
            "broken": broken.astype(int),
            "in_zone": mean[:, IN_ZONE],
            "above": mean[:, ABOVE],
            "spread": np.sqrt(np.maximum(mean[:, SPREAD] - mean[:, PLACE] * mean[:, PLACE], 0.0)),
            "compression": sums[:, COMPRESSION],
            "void": sums[:, VOID],
            "speed": np.sqrt(sums[:, SPEED]),
            "kinetic": mean[:, KINETIC],
            "middle": self._middle + np.concatenate([mean[:, [PLACE]], mean[:, HEIGHT : HEIGHT + dim - 1]], axis=1),
            "velocity": mean[:, VELOCITY : VELOCITY + dim],
        }
