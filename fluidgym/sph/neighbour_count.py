"""How many neighbours particles have, images in walls included: what a pair costs is a step over these."""

from dataclasses import replace
from functools import lru_cache

import warp as wp

from fluidgym.compilation import OPTIONS
from fluidgym.records import fetch
from fluidgym.sph.constants import Constants
from fluidgym.sph.neighbors import Grid
from fluidgym.sph.structure import Structure
from fluidgym.sph.sums import make_density_sum
from fluidgym.sph.terms import DensityRate
from fluidgym.state import Bodies, Faces, Frozen


@wp.func
def within_support(r: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
    """One for a neighbour that the smoothing kernel reaches."""
    return wp.where(slope < 0.0, 1.0, 0.0)


@lru_cache
def make_counter(s: Structure) -> wp.Kernel:
    """Kernel that counts the neighbours of each particle, the particle itself among them."""
    dim, width = s.dim, s.middle_width
    vec = wp.types.vector(dim, wp.float32)
    neighbours, emit_terms = make_density_sum(replace(s, density_terms=(DensityRate(within_support),), half=False))

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def count(
        capacity: int,
        constants: wp.array[Constants],
        grid: Grid,
        bounds: wp.array[int],
        faces: Faces,
        bodies: Bodies,
        frozen: Frozen,
        frozen_grid: Grid,
        records: wp.array[float],
        identity: wp.array[int],
        found: wp.array[float],
        sums: wp.array[float],
        spans: wp.array[int],
    ):
        i = wp.tid()
        world = i // capacity
        c = constants[world]
        if capacity < 0:
            found[i] = emit_terms(c)
        x = vec()
        for k in range(wp.static(dim)):
            x[k] = fetch(records, i + world * grid.slack, k, wp.static(width))
        if identity[i] >= 0:
            sum = neighbours(
                i, True, x, vec(), 0.0, vec(), vec(), world, c.support, faces, bodies, frozen, frozen_grid, records,
                bounds, grid, c, sums, spans,
            )  # fmt: skip
            found[i] = sum[0] - 1.0

    return count
