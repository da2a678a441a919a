"""Particles for ParaView: a .vtu file for each instant, and a .pvd file that tells their times."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from fluidgym.scene import Particles

REMEDY = 'pip install "fluidgym-sph[vtk]"'


def check_library() -> None:
    """Refuse to go on without the library that writes the files.

    Raises:
        ValueError: It is not installed.
    """
    if find_spec("pyevtk") is None:
        raise ValueError(f"files for ParaView need pyevtk: {REMEDY}")


class ParticleFiles:
    """The files of one run: FOLDER/particles_0000.vtu and so on, and beside the folder FOLDER.pvd, to be opened.

    Attributes:
        collection: The .pvd file; whole after every `write`.
    """

    def __init__(self, folder: Path):
        """Make the folder, and take files of an earlier run out of it.

        Raises:
            ValueError: The library is not installed.
            OSError: The folder cannot be made.
        """
        check_library()
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("particles_*.vtu"):
            old.unlink()
        self._folder = folder
        self._written: list[tuple[Path, float]] = []
        self.collection = folder.with_suffix(".pvd")

    def write(self, particles: Particles, time: float) -> None:
        """Add an instant; one without any particles is left out, as the library has no empty files.

        Args:
            particles: The particles; in two dimensions they are put at z = 0.
            time: Simulated time [s].
        """
        from pyevtk.hl import pointsToVTK

        if not len(particles):
            return
        stem = self._folder / f"particles_{len(self._written):04d}"
        data = {
            "velocity": _vectors(particles.velocity),
            "pressure": particles.pressure,
            "density": particles.density,
            "identity": particles.identity,
            "temperature": particles.temperature,
        }
        known = {
            name: tuple(map(np.ascontiguousarray, values))
            if isinstance(values, tuple)
            else np.ascontiguousarray(values)
            for name, values in data.items()
            if values is not None
        }
        x, y, z = map(np.ascontiguousarray, _vectors(particles.position))
        pointsToVTK(str(stem), x, y, z, data=known)
        self._written.append((stem.with_suffix(".vtu"), time))
        self._write_collection()

    def _write_collection(self) -> None:
        from pyevtk.vtk import VtkGroup

        group = VtkGroup(str(self.collection.with_suffix("").absolute()))
        for file, time in self._written:
            group.addFile(filepath=str(file.absolute()), sim_time=time)
        group.save()


def _vectors(values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Components x, y, z (n,) of vectors (n, dim)."""
    columns = list(np.asarray(values, float).T)
    return (*columns, *[np.zeros(len(values))] * (3 - len(columns)))
