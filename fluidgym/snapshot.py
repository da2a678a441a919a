"""States in files: the arrays of `Solver.save` or of an environment's `get_state`, to go on from later.

A file is NumPy's .npz without pickled objects, and a header: what it is, the version of the format, and a checksum over
the names, types, shapes and bytes of all arrays, so that what was cut short or altered is told apart from what was
written.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from fluidgym.files import replacing

KIND, VERSION = "fluidgym snapshot", 1
_HEADER = "header"


def save(state: Mapping[str, np.ndarray], path: str | os.PathLike[str]) -> None:
    """Write a state; what was there is replaced at once or not at all.

    Args:
        state: Arrays by name, as `Solver.save`, `save_world` and an environment's `get_state` give them.
        path: Ends with .npz.

    Raises:
        FileNotFoundError: The folder does not exist.
        ValueError: The path has another ending, or an array holds objects.
    """
    _check_ending(path)
    arrays = {name: np.asarray(array) for name, array in state.items()}
    for name, array in arrays.items():
        if array.dtype.hasobject:
            raise ValueError(f"state {name!r} holds objects, limit numbers; give what Solver.save or get_state gave")
    header = json.dumps({"kind": KIND, "version": VERSION, "checksum": _checksum(arrays)})
    every: dict[str, Any] = {f"state.{name}": array for name, array in arrays.items()}
    every[_HEADER] = np.frombuffer(header.encode(), np.uint8)
    with replacing(path) as unfinished, unfinished.open("wb") as file:
        np.savez(file, **every)
        file.flush()
        os.fsync(file.fileno())


def load(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Read a state.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no snapshot, of another version, or damaged.
    """
    _check_ending(path)
    remedy = "give a whole file that fluidgym.snapshot.save wrote"
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(file[_HEADER].tobytes().decode())
            arrays = {name.removeprefix("state."): file[name] for name in file.files if name != _HEADER}
    except FileNotFoundError:
        raise FileNotFoundError(f"path = {os.fspath(path)!r} does not exist; {remedy}") from None
    except Exception as error:  # whatever a foreign or damaged file makes of it
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ValueError(f"path = {os.fspath(path)!r} is no snapshot or cut short ({reason}); {remedy}") from None
    if not isinstance(header, dict) or header.get("kind") != KIND:
        raise ValueError(f"path = {os.fspath(path)!r} is no snapshot; {remedy}")
    if header.get("version") != VERSION:
        raise ValueError(
            f"path = {os.fspath(path)!r} has version {header.get('version')!r}, limit {VERSION}; write it anew"
        )
    if header.get("checksum") != _checksum(arrays):
        raise ValueError(f"path = {os.fspath(path)!r} is damaged: its checksum differs; {remedy}")
    return arrays


def _check_ending(path: str | os.PathLike[str]) -> None:
    if not os.fspath(path).endswith(".npz"):
        raise ValueError(f"path = {os.fspath(path)!r} does not end with .npz; give one that does")


def _checksum(arrays: Mapping[str, np.ndarray]) -> str:
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = arrays[name]
        found.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()
