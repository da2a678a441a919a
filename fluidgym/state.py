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
    """The arrays that are a particle: position, velocity, density error, identity, acceleration."""

    FIELDS = ("position", "velocity", "density_error", "identity", "acceleration")

    def __init__(self, dim: int, slots: int, device: wp.Device):
        self.position = wp.zeros((dim, slots), dtype=float, device=device)
        self.velocity = wp.zeros((dim, slots), dtype=float, device=device)
        self.density_error = wp.zeros(slots, dtype=float, device=device)
        self.identity = wp.zeros(slots, dtype=int, device=device)
        self.acceleration = wp.zeros((dim, slots), dtype=float, device=device)

    def arrays(self) -> dict[str, wp.array]:
        """All arrays by name."""
        return {name: getattr(self, name) for name in self.FIELDS}


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
def copy_rows(mask: wp.array[wp.bool], capacity: int, source: wp.array2d[float], target: wp.array2d[float]):
    """Copy the slots of the worlds in the mask, row by row."""
    row, slot = wp.tid()
    if mask[slot // capacity]:
        target[row, slot] = source[row, slot]


@wp.kernel(module="fluidgym.state", enable_backward=False)
def copy_integers(mask: wp.array[wp.bool], capacity: int, source: wp.array2d[int], target: wp.array2d[int]):
    """Copy the slots of the worlds in the mask."""
    row, slot = wp.tid()
    if mask[slot // capacity]:
        target[row, slot] = source[row, slot]


def copy_worlds(mask: wp.array, capacity: int, source: wp.array, target: wp.array) -> None:
    """Copy what belongs to the worlds in the mask (world,) from one array to another of the same shape.

    The last axis is the slot; capacity is the number of slots of a world.
    """
    rows = source if source.ndim == 2 else source.reshape((1, source.shape[0]))
    target = target if target.ndim == 2 else target.reshape((1, target.shape[0]))
    kernel = copy_integers if source.dtype is wp.int32 else copy_rows
    shape = (rows.shape[0], mask.shape[0] * capacity)
    wp.launch(kernel, dim=shape, inputs=[mask, capacity, rows], outputs=[target], device=source.device)


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
        padded = slots + PADDING
        self.now = ParticleArrays(dim, padded, device)
        self.start = ParticleArrays(dim, padded, device)
        self.sorted = ParticleArrays(dim, padded, device)
        self.reduced_pressure = wp.zeros(padded, dtype=float, device=device)
        self.key = wp.zeros(slots, dtype=int, device=device)
        self.order = wp.zeros(slots, dtype=int, device=device)
        self.faces = make_faces(dim, num_worlds, device)
        self.faces_middle = make_faces(dim, num_worlds, device)
        self.faces_start = make_faces(dim, num_worlds, device)
        self.clamped = wp.zeros(num_worlds, dtype=int, device=device)

    def reset(self, mask: np.ndarray) -> None:
        """Copy the start of the worlds in the mask (world,) over their present."""
        chosen = wp.array(mask, dtype=wp.bool, device=self.device)
        for name, source in self.start.arrays().items():
            copy_worlds(chosen, self.capacity, source, getattr(self.now, name))
        for name, source in face_arrays(self.faces_start).items():
            columns = source.shape[1]
            flat = source.reshape((source.size,))
            copy_worlds(chosen, columns, flat, getattr(self.faces, name).reshape((source.size,)))
            copy_worlds(chosen, columns, flat, getattr(self.faces_middle, name).reshape((source.size,)))
        clamped = self.clamped.numpy()
        self.clamped.assign(np.where(mask, 0, clamped))

    def snapshot(self) -> dict[str, np.ndarray]:
        """The present of all worlds as NumPy arrays: all that a later step depends on."""
        saved = {name: array.numpy().copy() for name, array in self.now.arrays().items()}
        faces = face_arrays(self.faces)
        return saved | {f"face_{name}": array.numpy().copy() for name, array in faces.items()}

    def restore(self, saved: dict[str, np.ndarray]) -> None:
        """Put a snapshot back."""
        for name, array in self.now.arrays().items():
            array.assign(saved[name])
        for name, array in face_arrays(self.faces).items():
            array.assign(saved[f"face_{name}"])
