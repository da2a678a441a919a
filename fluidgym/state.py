"""The device arrays of all worlds, flat: world w owns the slots w * capacity to (w + 1) * capacity.

Vectors are stored one component a row, (dim, slot), so that the pair loop reads contiguous numbers. Slots are in the
order of the cells and change at every step; identity says who is in a slot, and is negative once a particle is retired.
"""

from __future__ import annotations

import numpy as np
import warp as wp

# The pair loop reads whole blocks of slots and may look, without counting, this far past the last one.
PADDING = 16


@wp.struct
class Faces:
    """The faces of all worlds at one instant; faces in the order x_min, x_max, y_min, ..."""

    position: wp.array2d[float]  # along the face's normal, (world, face) [m]
    velocity: wp.array2d[float]  # along the face's normal, (world, face) [m/s]
    acceleration: wp.array2d[float]  # along the face's normal, (world, face) [m/s2]
    sliding: wp.array3d[float]  # within the face's plane, (world, face, dim) [m/s]


class ParticleArrays:
    """The arrays that are particles: position, velocity, density error, identity, and acceleration where it is kept."""

    def __init__(self, dim: int, slots: int, device: wp.Device, acceleration: bool = True):
        """Room for so many slots, and the padding behind them."""
        padded = slots + PADDING
        self.position = wp.zeros((dim, padded), dtype=float, device=device)
        self.velocity = wp.zeros((dim, padded), dtype=float, device=device)
        self.density_error = wp.zeros(padded, dtype=float, device=device)
        self.identity = wp.zeros(padded, dtype=int, device=device)
        self.acceleration = wp.zeros((dim, padded if acceleration else 0), dtype=float, device=device)

    def arrays(self) -> dict[str, wp.array]:
        """All arrays by name."""
        return dict(vars(self))


def make_faces(dim: int, num_worlds: int, device: wp.Device) -> Faces:
    """Face arrays, zero."""
    faces = Faces()
    shape = (num_worlds, 2 * dim)
    faces.position = wp.zeros(shape, dtype=float, device=device)
    faces.velocity = wp.zeros(shape, dtype=float, device=device)
    faces.acceleration = wp.zeros(shape, dtype=float, device=device)
    faces.sliding = wp.zeros((*shape, dim), dtype=float, device=device)
    return faces


def face_arrays(faces: Faces) -> dict[str, wp.array]:
    """The arrays of a Faces that change with time, by name."""
    return {name: getattr(faces, name) for name in ("position", "velocity", "acceleration")}


@wp.kernel(module="fluidgym.state", enable_backward=False)
def copy_numbers(
    sources: wp.array[int], targets: wp.array[int], size: int, source: wp.array2d[float], target: wp.array2d[float]
):
    """Copy worlds of `size` columns each to worlds, row by row."""
    row, i = wp.tid()
    n = i // size
    target[row, targets[n] * size + i % size] = source[row, sources[n] * size + i % size]


@wp.kernel(module="fluidgym.state", enable_backward=False)
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


class State:
    """Particles, faces and scratch arrays of all worlds.

    Attributes:
        now: The particles.
        start: What a reset copies back.
        sorted: The particles at the middle of a step, in cell order: scratch between steps.
        faces: The faces at the end of a step.
        faces_middle: The faces at the middle of a step.
        faces_start: What a reset copies back.
        clamped: How often the safety net at walls was used since the reset, (world,).
    """

    def __init__(self, dim: int, num_worlds: int, capacity: int, device: wp.Device):
        self.dim, self.num_worlds, self.capacity, self.device = dim, num_worlds, capacity, device
        slots = num_worlds * capacity
        self.now = ParticleArrays(dim, slots, device)
        self.start = ParticleArrays(dim, slots, device)
        self.sorted = ParticleArrays(dim, slots, device, acceleration=False)
        self.reduced_pressure = wp.zeros(slots + PADDING, dtype=float, device=device)
        self.key = wp.zeros(slots, dtype=int, device=device)
        self.order = wp.zeros(slots, dtype=int, device=device)
        self.faces = make_faces(dim, num_worlds, device)
        self.faces_middle = make_faces(dim, num_worlds, device)
        self.faces_start = make_faces(dim, num_worlds, device)
        self.clamped = wp.zeros(num_worlds, dtype=int, device=device)

    def set_start(self, worlds: np.ndarray, batch: ParticleArrays) -> None:
        """Make the worlds of a batch the start of the worlds of these numbers (n,)."""
        sources, targets = self._numbers(np.arange(len(worlds))), self._numbers(worlds)
        for name, source in batch.arrays().items():
            copy_worlds(sources, targets, self.capacity, source, getattr(self.start, name))

    def reset(self, worlds: np.ndarray) -> None:
        """Copy the start of the worlds of these numbers (n,) over their present."""
        chosen = self._numbers(worlds)
        for name, source in self.start.arrays().items():
            copy_worlds(chosen, chosen, self.capacity, source, getattr(self.now, name))
        for name, source in face_arrays(self.faces_start).items():
            flat = (source.size,)
            for faces in (self.faces, self.faces_middle):
                target = getattr(faces, name).reshape(flat)
                copy_worlds(chosen, chosen, source.shape[1], source.reshape(flat), target)
        nothing = wp.zeros(self.num_worlds, dtype=int, device=self.device)
        copy_worlds(chosen, chosen, 1, nothing, self.clamped)

    def _numbers(self, worlds: np.ndarray) -> wp.array:
        """Numbers of worlds (n,), on the device."""
        return wp.array(np.asarray(worlds, np.int32), dtype=int, device=self.device)

    def snapshot(self) -> dict[str, np.ndarray]:
        """The present of all worlds as NumPy arrays."""
        saved = {name: array.numpy().copy() for name, array in self.now.arrays().items()}
        faces = face_arrays(self.faces)
        return saved | {f"face_{name}": array.numpy().copy() for name, array in faces.items()}

    def restore(self, saved: dict[str, np.ndarray]) -> None:
        """Put a snapshot back, as it came."""
        for name, array in self.now.arrays().items():
            array.assign(saved[name])
        for name, array in face_arrays(self.faces).items():
            array.assign(saved[f"face_{name}"])
