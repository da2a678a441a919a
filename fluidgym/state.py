"""The device arrays of all worlds, flat: world w owns the slots w * capacity to (w + 1) * capacity.

Vectors are stored one component a row, (dim, slot), so that the pair loop reads contiguous numbers. Slots are in the
order of the cells and change at every step; identity says who is in a slot, and is negative once a particle is retired.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from fluidgym.compilation import shared_module
from fluidgym.records import SUMS, make_records, slack


@wp.struct
class Faces:
    """The faces of all worlds at one instant; faces in the order x_min, x_max, y_min, ..."""

    position: wp.array2d[float]  # along the face's normal, (world, face) [m]
    velocity: wp.array2d[float]  # along the face's normal, (world, face) [m/s]
    acceleration: wp.array2d[float]  # along the face's normal, (world, face) [m/s2]
    sliding: wp.array3d[float]  # within the face's plane, (world, face, dim) [m/s]
    temperature: wp.array[float]  # (face,)


@wp.struct
class Bodies:
    """The solids of all worlds at one instant."""

    position: wp.array3d[float]  # of the middle, (world, body, dim) [m]
    velocity: wp.array3d[float]  # (world, body, dim) [m/s]
    acceleration: wp.array3d[float]  # (world, body, dim) [m/s2]
    half: wp.array2d[float]  # half of each side, or the radius, (body, dim) [m]
    temperature: wp.array[float]  # (body,)
    patches: int  # sides of bodies and of their images that a particle may see
    rays: int  # to each of them
    others: int  # bodies and images


@wp.struct
class Nozzles:
    """The pipes of all worlds. A row is a line of particles along a pipe."""

    center: wp.array3d[float]  # middle of the back, (world, inflow, dim) [m]
    frame: wp.array4d[float]  # axes: along, then across, (world, inflow, axis, dim)
    half: wp.array3d[float]  # half of each side across, (world, inflow, dim - 1) [m]
    speed: wp.array2d[float]  # mean, (world, inflow) [m/s]
    length: wp.array[float]  # (inflow,) [m]
    bulge: wp.array[float]  # of a parabolic profile: its peak over the mean of the rows; 0 is uniform, (inflow,)
    temperature: wp.array[float]  # (inflow,)
    row_inflow: wp.array[int]  # whose row it is, (row,)
    row_across: wp.array2d[float]  # where it is across the pipe, (row, dim - 1) [m]


@wp.struct
class Drains:
    """The outflows; every world has the same."""

    lower: wp.array2d[float]  # (outflow, dim) [m]
    upper: wp.array2d[float]  # (outflow, dim) [m]
    axis: wp.array[int]  # along which fluid is carried; -1 retires it at once, (outflow,)
    sign: wp.array[float]  # of the direction, (outflow,)
    field: wp.array2d[float]  # density error held, (world, outflow)


@wp.struct
class Frozen:
    """Wall particles that never move, in cells of their own; every world has the same."""

    records: wp.array[float]  # place; velocity and field are zero
    bounds: wp.array[int]  # of the cells, (cell + 1,)


@wp.struct
class Ledger:
    """What the nozzles of all worlds have done since the reset."""

    emitted: wp.array[int]  # particles, (world,)
    refused: wp.array[int]  # steps in which a row waited for the reserve, (world,)
    first: wp.array[int]  # identity of the first particle that is emitted, (world,)
    phase: wp.array2d[float]  # way gone since the newest particle of a row was at the back, (world, row) [m]


class ParticleArrays:
    """The arrays that are particles: position, velocity, density error, identity, acceleration, temperature.

    An array that is not kept has no columns.
    """

    def __init__(self, dim: int, slots: int, device: wp.Device, heat: bool = False):
        """Room for so many slots."""
        self.position = wp.zeros((dim, slots), dtype=float, device=device)
        self.velocity = wp.zeros((dim, slots), dtype=float, device=device)
        self.density_error = wp.zeros(slots, dtype=float, device=device)
        self.density_error = wp.zeros(slots, dtype=float, device=device)
        self.identity = wp.zeros(slots, dtype=int, device=device)
        self.acceleration = wp.zeros((dim, slots), dtype=float, device=device)
        self.temperature = wp.zeros(slots if heat else 0, dtype=float, device=device)

    def part(self, slots: slice) -> ParticleArrays:
        """Some slots: views."""
        part = copy.copy(self)
        for name, array in self.arrays().items():
            setattr(part, name, array[:, slots] if array.ndim == 2 else array[slots])
        return part

    def arrays(self) -> dict[str, wp.array]:
        """All arrays that are kept, by name."""
        return {name: array for name, array in vars(self).items() if array.size}


def make_faces(dim: int, num_worlds: int, device: wp.Device) -> Faces:
    """Face arrays, zero."""
    faces = Faces()
    shape = (num_worlds, 2 * dim)
    faces.position = wp.zeros(shape, dtype=float, device=device)
    faces.velocity = wp.zeros(shape, dtype=float, device=device)
    faces.acceleration = wp.zeros(shape, dtype=float, device=device)
    faces.sliding = wp.zeros((*shape, dim), dtype=float, device=device)
    return faces


def make_bodies_arrays(dim: int, num_worlds: int, half: np.ndarray, device: wp.Device) -> Bodies:
    """Body arrays at the origin, for the half sides of each (body, dim)."""
    bodies = Bodies()
    shape = (num_worlds, len(half), dim)
    bodies.position = wp.zeros(shape, dtype=float, device=device)
    bodies.velocity = wp.zeros(shape, dtype=float, device=device)
    bodies.acceleration = wp.zeros(shape, dtype=float, device=device)
    bodies.half = wp.array(half, dtype=float, device=device)
    return bodies


_DRIVEN = ("position", "velocity", "acceleration")

# Arrays of a state that a step works on, by world.
_BY_WORLD = (
    *("middle", "end", "sums", "spans", "density_error", "identity", "temperature", "key", "order"),
    *("forces", "gain", "clamped"),
)


def driven_arrays(driven: Faces | Bodies) -> dict[str, wp.array]:
    """The arrays of faces or bodies that change with time, by name, each (world, item)."""
    arrays = {name: getattr(driven, name) for name in _DRIVEN}
    return {name: array.reshape((array.shape[0], array.size // array.shape[0])) for name, array in arrays.items()}


@wp.kernel(module=shared_module("state"), enable_backward=False)
def copy_numbers(
    sources: wp.array[int], targets: wp.array[int], size: int, source: wp.array2d[float], target: wp.array2d[float]
):
    """Copy worlds of `size` columns each to worlds, row by row."""
    row, i = wp.tid()
    n = i // size
    target[row, targets[n] * size + i % size] = source[row, sources[n] * size + i % size]


@wp.kernel(module=shared_module("state"), enable_backward=False)
def copy_integers(
    sources: wp.array[int], targets: wp.array[int], size: int, source: wp.array2d[int], target: wp.array2d[int]
):
    """Copy worlds of `size` columns each to worlds, row by row."""
    row, i = wp.tid()
    n = i // size
    target[row, targets[n] * size + i % size] = source[row, sources[n] * size + i % size]


def copy_worlds(sources: wp.array, targets: wp.array, size: int, source: wp.array, target: wp.array) -> None:
    """Copy worlds from one array to another.

    Args:
        sources: Numbers of the worlds to read, on the device, (n,).
        targets: Numbers of the worlds to write, on the device, (n,).
        size: Columns of a world: the last axis of both arrays is world * size + column.
        source: Read.
        target: Written.
    """
    rows = source if source.ndim == 2 else source.reshape((1, source.shape[0]))
    target = target if target.ndim == 2 else target.reshape((1, target.shape[0]))
    kernel = copy_integers if source.dtype is wp.int32 else copy_numbers
    shape = (rows.shape[0], sources.shape[0] * size)
    wp.launch(kernel, dim=shape, inputs=[sources, targets, size, rows], outputs=[target], device=source.device)


def part_of(array: wp.array, worlds: int, first: int, count: int) -> wp.array:
    """Some worlds of an array of so many, which lie one after another along its first axis: a view."""
    if array is None or not array.size:
        return array
    each = array.shape[0] // worlds
    return array[first * each : (first + count) * each]


def struct_part(kind: Any, struct: Any, names: Sequence[str], worlds: int, first: int, count: int) -> Any:
    """A struct of some worlds: of its arrays of these names a part, the others whole."""
    part = kind()
    for name in kind.vars:
        value = getattr(struct, name)
        if value is not None:
            setattr(part, name, part_of(value, worlds, first, count) if name in names else value)
    return part


class State:
    """Particles, faces, bodies, nozzles and scratch arrays of all worlds.

    Attributes:
        now: The particles.
        start: What a reset copies back.
        middle: Records of the particles at the middle of a step, in cell order: scratch between steps, like what
            follows.
        end: Records of them at its end, with what the force sweep reads.
        density_error: In cell order, as it was before the first sweep.
        identity: In cell order.
        temperature: In cell order.
        faces: The faces at the end of a step; faces_middle at its middle, faces_start what a reset copies back.
        bodies: The bodies, likewise.
        ledger: What the nozzles have done.
        forces: What faces and bodies have done to the particles, in fixed point, (world, face and body, dim).
        gain: What the density errors gain in a step of a shifted box, in fixed point, (world,): scratch.
        sums: What particles have been given by those before them in the order: scratch, zero between sweeps.
        spans: Where in the order each particle meets others, if pairs are met once: scratch.
        clamped: How often the safety net at walls and bodies was used since the reset, (world,).
    """

    def __init__(
        self,
        dim: int,
        num_worlds: int,
        capacity: int,
        device: wp.Device,
        half: np.ndarray,
        rows: int = 0,
        heat: bool = False,
        forces: bool = False,
        leveled: bool = False,
        spans: int = 0,
    ):
        """Allocate.

        Args:
            dim: Number of dimensions.
            num_worlds: Number of worlds.
            capacity: Slots of a world.
            device: Where.
            half: Half sides of the bodies [m], (body, dim).
            rows: Rows of the nozzles of a world.
            heat: Whether temperatures are kept.
            forces: Whether forces are added up.
            leveled: Whether particles are shifted in full boxes.
            spans: Numbers to keep of where each particle meets others, if pairs are met once; else 0.
        """
        self.dim, self.num_worlds, self.capacity, self.device = dim, num_worlds, capacity, device
        slots = num_worlds * capacity
        self.now = ParticleArrays(dim, slots, device, heat=heat)
        self.start = ParticleArrays(dim, slots, device, heat=heat)
        self.density_error = wp.zeros(slots, dtype=float, device=device)
        self.identity = wp.zeros(slots, dtype=int, device=device)
        self.temperature = wp.zeros(slots if heat else 0, dtype=float, device=device)
        self.key = wp.zeros(slots, dtype=int, device=device)
        self.order = wp.zeros(slots, dtype=int, device=device)
        self.faces, self.faces_middle, self.faces_start = (make_faces(dim, num_worlds, device) for _ in range(3))
        self.bodies, self.bodies_middle, self.bodies_before, self.bodies_start = (
            make_bodies_arrays(dim, num_worlds, half, device) for _ in range(4)
        )
        self.ledger = Ledger()
        worlds_with_rows = num_worlds if rows else 0
        for name in ("emitted", "refused", "first"):
            setattr(self.ledger, name, wp.zeros(worlds_with_rows, dtype=int, device=device))
        self.ledger.phase = wp.zeros((worlds_with_rows, rows), dtype=float, device=device)
        shape = (num_worlds, 2 * dim + len(half), dim) if forces else (0, 0, 0)
        self.forces = wp.zeros(shape, dtype=wp.int64, device=device)
        self.gain = wp.zeros(num_worlds if leveled else 0, dtype=wp.int64, device=device)
        self.clamped = wp.zeros(num_worlds, dtype=int, device=device)
        self.sums = make_records(self.places if spans else 0, SUMS, device)
        self.spans = wp.zeros(spans * slots, dtype=int, device=device)

    @property
    def places(self) -> int:
        """Records of all worlds."""
        return self.num_worlds * (self.capacity + slack(self.capacity))

    def set_widths(self, middle: int, end: int) -> None:
        """Have room for records of so many parts."""
        self.middle = make_records(self.places, middle, self.device)
        self.end = make_records(self.places, end, self.device)

    def part(self, first: int, count: int) -> State:
        """The present of some worlds: views of it."""
        part = copy.copy(self)
        part.num_worlds = count
        part.now = self.now.part(slice(first * self.capacity, (first + count) * self.capacity))
        where = (self.num_worlds, first, count)
        for name in _BY_WORLD:
            setattr(part, name, part_of(getattr(self, name), *where))
        for name in ("faces", "faces_middle"):
            setattr(part, name, struct_part(Faces, getattr(self, name), (*_DRIVEN, "sliding"), *where))
        for name in ("bodies", "bodies_middle", "bodies_before"):
            setattr(part, name, struct_part(Bodies, getattr(self, name), _DRIVEN, *where))
        part.ledger = struct_part(Ledger, self.ledger, tuple(Ledger.vars), *where)
        return part

    def set_start(self, worlds: np.ndarray, batch: ParticleArrays) -> None:
        """Make the worlds of a batch the start of the worlds of these numbers (n,)."""
        sources, targets = self._numbers(np.arange(len(worlds))), self._numbers(worlds)
        for name, source in batch.arrays().items():
            copy_worlds(sources, targets, self.capacity, source, getattr(self.start, name))

    def reset(self, worlds: np.ndarray, counts: np.ndarray, phase: float) -> None:
        """Copy the start of some worlds over their present.

        Args:
            worlds: Their numbers (n,).
            counts: Particles at the start of each world of all (world,).
            phase: Of every row of the nozzles [m].
        """
        self.sums.zero_()  # a world that has diverged may have left there what is not a number
        chosen = self._numbers(worlds)
        for name, source in self.start.arrays().items():
            copy_worlds(chosen, chosen, self.capacity, source, getattr(self.now, name))
        pairs = [(self.faces_start, moved) for moved in (self.faces, self.faces_middle)]
        pairs += [(self.bodies_start, moved) for moved in (self.bodies, self.bodies_middle, self.bodies_before)]
        for start, moved in pairs:
            targets = driven_arrays(moved)
            for name, source in driven_arrays(start).items():
                if source.size:
                    flat = (source.size,)
                    copy_worlds(chosen, chosen, source.shape[1], source.reshape(flat), targets[name].reshape(flat))
        nothing = wp.zeros(self.num_worlds, dtype=int, device=self.device)
        copy_worlds(chosen, chosen, 1, nothing, self.clamped)
        if self.ledger.phase.size:
            rows = self.ledger.phase.size // self.num_worlds
            start = wp.full(self.ledger.phase.size, phase, dtype=float, device=self.device)
            copy_worlds(chosen, chosen, rows, start, self.ledger.phase.reshape((self.ledger.phase.size,)))
            first = wp.array(counts, dtype=int, device=self.device)
            for source, target in ((nothing, "emitted"), (nothing, "refused"), (first, "first")):
                copy_worlds(chosen, chosen, 1, source, getattr(self.ledger, target))

    def _numbers(self, worlds: np.ndarray) -> wp.array:
        """Numbers of worlds (n,), on the device."""
        return wp.array(np.asarray(worlds, np.int32), dtype=int, device=self.device)

    def _kept(self) -> dict[str, wp.array]:
        """All arrays that the future depends on, by name."""
        kept = self.now.arrays()
        kept |= {f"face_{name}": array for name, array in driven_arrays(self.faces).items()}
        kept |= {f"body_{name}": array for name, array in driven_arrays(self.bodies).items() if array.size}
        if self.ledger.phase.size:
            kept |= {f"ledger_{name}": getattr(self.ledger, name) for name in ("emitted", "refused", "first", "phase")}
        return kept

    def snapshot(self) -> dict[str, np.ndarray]:
        """The present of all worlds as NumPy arrays."""
        return {name: array.numpy().copy() for name, array in self._kept().items()}

    def restore(self, saved: dict[str, np.ndarray]) -> None:
        """Put a snapshot back, as it came."""
        self.sums.zero_()
        for name, array in self._kept().items():
            array.assign(saved[name])
