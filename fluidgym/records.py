"""What the pair loops read of a particle, one record of it: place, velocity, field, and whatever a sweep wants besides.

On a CPU the records of eight particles in a row are a block, one component after the other, eight numbers each: the
eight lanes of the pair loop read a component with one load, all of a block with one address. On a GPU, where each
thread has an eye on one neighbour at a time, a record is contiguous and filled up to a multiple of four numbers, which
is what a thread loads at once. The records of a world begin with a block of their own, so that its sums do not depend
on where among other worlds it is.
"""

from typing import Any

import numpy as np
import warp as wp

LANES = 8  # particles in a block, as many as a vector register of a CPU holds single-precision numbers
QUAD = 4  # numbers that a thread of a GPU loads at once
SUMS = 3  # numbers that a pair loop may give to a particle


def slack(capacity: int) -> int:
    """Records of a world beyond its slots, which fill its last block."""
    return -capacity % LANES


def place_on_cpu(slot: str, part: int | str, width: int | str) -> str:
    """Where a component of a record is on a CPU, in C++."""
    return f"(((({slot}) / {LANES}u) * {width} + {part}) * {LANES} + ({slot}) % {LANES}u)"


_PLACE = f"""
#if defined(__CUDA_ARCH__)
const int at = slot * ((width + {QUAD - 1}) / {QUAD} * {QUAD}) + part;
#else
const int at = {place_on_cpu("slot", "part", "width")};
#endif
"""


@wp.func_native(_PLACE + "return records.data[at];")
def fetch(records: wp.array[float], slot: int, part: int, width: int) -> float:
    """A component of a record; slot counts the slack of the worlds before it."""
    ...


@wp.func_native(_PLACE + "records.data[at] = value;")
def put(records: wp.array[float], slot: int, part: int, width: int, value: float):
    """Write a component of a record."""
    ...


_ROW = "reinterpret_cast<{0}float*>(reinterpret_cast<{0}char*>(field.data) + row * field.strides[0])"


@wp.func_native(f"return {_ROW.format('const ')}[column];")
def get(field: wp.array2d[float], row: int, column: int) -> float:
    """A number of an array whose rows are contiguous: Warp's own index may be negative, which costs 6 % of a step."""
    ...


@wp.func_native(
    "return *reinterpret_cast<const float*>(reinterpret_cast<const char*>(field.data) + row * field.strides[0]"
    " + column * field.strides[1] + k * field.strides[2]);"
)
def get_of(field: wp.array3d[float], row: int, column: int, k: int) -> float:
    """A number of an array of three axes, likewise."""
    ...


@wp.func_native(f"{_ROW.format('')}[column] = value;")
def set_to(field: wp.array2d[float], row: int, column: int, value: float):
    """Write a number of an array whose rows are contiguous."""
    ...


def pitch(width: int, device: wp.Device) -> int:
    """Numbers from one record to the next, on average."""
    return -(-width // QUAD) * QUAD if device.is_cuda else width


def make_records(slots: int, width: int, device: wp.Device) -> wp.array:
    """Room for records, zero."""
    return wp.zeros((slots + slack(slots)) * pitch(width, device), dtype=float, device=device)


def pack(parts: np.ndarray, device: wp.Device, capacity: int | None = None) -> wp.array:
    """Records of parts (width, slot), on the device, of worlds of that many slots; None is a single world."""
    width, slots = parts.shape
    each: int = capacity or slots
    worlds = np.asarray(parts).reshape(width, -1, each)
    padded = np.pad(worlds, ((0, 0), (0, 0), (0, slack(each)))).reshape(width, -1)
    filled = np.pad(padded, ((0, pitch(width, device) - width), (0, 0)))
    in_order = filled.T if device.is_cuda else padded.reshape(width, -1, LANES).transpose(1, 0, 2)
    return wp.array(np.ascontiguousarray(in_order).ravel(), dtype=float, device=device)


def unpack(records: Any, width: int, capacity: int) -> np.ndarray:
    """The parts (width, slot) of records of worlds of that many slots."""
    flat = records.numpy()
    in_order = flat.reshape(-1, pitch(width, records.device)).T[:width] if records.device.is_cuda else flat
    if not records.device.is_cuda:
        in_order = flat.reshape(-1, width, LANES).transpose(1, 0, 2).reshape(width, -1)
    return in_order.reshape(width, -1, capacity + slack(capacity))[..., :capacity].reshape(width, -1)
