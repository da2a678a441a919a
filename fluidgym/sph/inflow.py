"""Where fluid comes from and where it goes: pipes, in which it is carried to a nozzle, and outflows.

A particle in a pipe is not pushed but carried, at the speed of the pipe's profile; which particles those are is told by
their place alone. Each row of a pipe keeps count of the way it has gone since its newest particle was at the back, and
adds one each time that is a spacing, from the world's retired particles. Its density is that of the fluid beyond the
nozzle, mirrored at the end of the pipe, so a jet leaves without pressure and a channel has what its flow needs.

An outflow with a direction carries a particle through at the velocity it entered with and a given density. An outflow
without retires it at once.
"""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp

from fluidgym.compilation import OPTIONS
from fluidgym.sph.constants import Constants
from fluidgym.sph.structure import Structure
from fluidgym.sph.terms import DensityRate
from fluidgym.state import Drains, Ledger, Nozzles

FREE = wp.constant(0)
IN_PIPE = wp.constant(1)
IN_OUTFLOW = wp.constant(2)
GONE = wp.constant(3)


@wp.func
def weighed(r: float, xu: float, slope: float, s_i: float, s_j: float, c: Constants) -> float:
    """-W'/r s_j: over the sum of -W'/r, a mean (Shepard 1968)."""
    return -slope * s_j


WEIGHED = DensityRate(weighed)


@lru_cache
def make_carriers(s: Structure) -> SimpleNamespace:
    """Warp functions about pipes and outflows: Carried, a struct, and carried: how a place carries fluid."""
    dim, pipes, drains = s.dim, len(s.round_pipes), s.drains
    vec = wp.types.vector(dim, wp.float32)
    round_pipes = wp.int32(sum(bool(is_round) << n for n, is_round in enumerate(s.round_pipes)))

    @wp.struct
    class Carried:
        """How a place carries fluid."""

        how: int  # FREE, IN_PIPE, IN_OUTFLOW or GONE
        velocity: vec  # of a pipe's fluid
        mirror: vec  # where a pipe's density is taken from
        held: float  # density error of an outflow
        number: int

    @wp.func
    def carried(x: vec, world: int, nozzles: Nozzles, outflows: Drains, c: Constants) -> Carried:
        """How the place x carries fluid."""
        found = Carried()
        found.mirror = x
        if wp.static(pipes > 0):
            for n in range(wp.static(pipes)):
                place = vec()
                for m in range(wp.static(dim)):
                    for k in range(wp.static(dim)):
                        place[m] += (x[k] - nozzles.center[world, n, k]) * nozzles.frame[world, n, m, k]
                inside = bool(place[0] >= -0.5 * c.spacing and place[0] < nozzles.length[n])
                off = float(0.0)  # from the middle line, over the half side, squared
                for m in range(1, wp.static(dim)):
                    q = place[m] / nozzles.half[world, n, m - 1]
                    if (round_pipes >> n) & 1 != 0:
                        off += q * q
                    else:
                        off = q * q  # of the last side: the profile is between the sides of the height
                        if wp.abs(place[m]) > nozzles.half[world, n, m - 1]:
                            inside = False
                if (round_pipes >> n) & 1 != 0 and off > 1.0:
                    inside = False
                if inside:
                    found.how = IN_PIPE
                    found.number = n
                    speed = nozzles.speed[world, n]
                    if nozzles.bulge[n] > 0.0:
                        speed *= nozzles.bulge[n] * (1.0 - off)
                    for k in range(wp.static(dim)):
                        along = nozzles.frame[world, n, 0, k]
                        found.velocity[k] = speed * along
                        found.mirror[k] = x[k] + 2.0 * (nozzles.length[n] - place[0]) * along
        if wp.static(drains > 0):
            for n in range(wp.static(drains)):
                inside = bool(True)
                for k in range(wp.static(dim)):
                    if x[k] < outflows.lower[n, k] or x[k] > outflows.upper[n, k]:
                        inside = False
                if inside:
                    found.number = n
                    found.how = GONE
                    axis = outflows.axis[n]
                    if axis >= 0:
                        end = wp.where(outflows.sign[n] > 0.0, outflows.upper[n, axis], outflows.lower[n, axis])
                        if wp.abs(end - x[axis]) > 0.25 * c.spacing:
                            found.how = IN_OUTFLOW
                            found.held = outflows.field[world, n]
        return found

    return SimpleNamespace(Carried=Carried, carried=carried)


@lru_cache
def make_emit(s: Structure) -> wp.Kernel:
    """Kernel that adds the particles whose time has come to the pipes: one thread a world, in a fixed order."""
    dim = s.dim
    round_pipes = wp.int32(sum(bool(is_round) << n for n, is_round in enumerate(s.round_pipes)))

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def emit(
        capacity: int,
        cells: int,
        constants: wp.array[Constants],
        bounds: wp.array[int],
        nozzles: Nozzles,
        ledger: Ledger,
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        acceleration: wp.array2d[float],
        density_error: wp.array[float],
        temperature: wp.array[float],
        identity: wp.array[int],
    ):
        world = wp.tid()
        c = constants[world]
        # The step has put the retired particles last.
        slot = bounds[(world + 1) * cells - 1]
        end = (world + 1) * capacity
        for row in range(nozzles.row_inflow.shape[0]):
            n = nozzles.row_inflow[row]
            off = float(0.0)
            active = bool(True)
            for m in range(wp.static(dim - 1)):
                q = nozzles.row_across[row, m] / nozzles.half[world, n, m]
                if wp.abs(q) > 1.0:
                    active = False
                off = q * q + wp.where((round_pipes >> n) & 1 != 0, off, 0.0)
            if off > 1.0:
                active = False
            speed = nozzles.speed[world, n]
            if nozzles.bulge[n] > 0.0:
                speed *= nozzles.bulge[n] * (1.0 - off)
            if active:
                way = ledger.phase[world, row] + speed * c.dt
                if way >= c.spacing:
                    if slot < end:
                        way -= c.spacing
                        for k in range(wp.static(dim)):
                            x = nozzles.center[world, n, k] + way * nozzles.frame[world, n, 0, k]
                            for m in range(wp.static(dim - 1)):
                                x += nozzles.row_across[row, m] * nozzles.frame[world, n, m + 1, k]
                            position[k, slot] = x
                            velocity[k, slot] = speed * nozzles.frame[world, n, 0, k]
                            acceleration[k, slot] = 0.0
                        density_error[slot] = 0.0
                        if wp.static(s.heat):
                            temperature[slot] = nozzles.temperature[n]
                        identity[slot] = ledger.first[world] + ledger.emitted[world]
                        ledger.emitted[world] += 1
                        slot += 1
                    else:
                        way = c.spacing
                        ledger.refused[world] += 1
                ledger.phase[world, row] = way

    return emit
