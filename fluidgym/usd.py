"""Particles and their surface for Omniverse, Blender, Houdini: one USD file with a sample for each instant."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from fluidgym.picture import shot_of, usual_range, values_of
from fluidgym.render.colour import colour_values
from fluidgym.render.mesh import mesh_surface
from fluidgym.solver import Solver

REMEDY = 'pip install "fluidgym-sph[usd]"'
TICKS = 1000.0  # time codes of USD a second


def check_library() -> None:
    """Refuse to go on without the library that writes the file.

    Raises:
        ValueError: It is not installed.
    """
    if find_spec("pxr") is None:
        raise ValueError(f"files for USD need usd-core: {REMEDY}")


class UsdFile:
    """The file of one run: /fluid/particles, and in three dimensions /fluid/surface; z is up, lengths are in metres.

    Particles are coloured by their speed; displayColor holds what other tools show, velocities what they blur.

    Attributes:
        path: The file; whole after `close`.
    """

    def __init__(self, path: Path, solver: Solver):
        """Begin a file; what was there is replaced at the end.

        Args:
            path: Ends with .usdc, .usda or .usd.
            solver: What is shown; its first world.

        Raises:
            ValueError: The library is not installed.
        """
        check_library()
        Usd, UsdGeom = _pxr("Usd"), _pxr("UsdGeom")
        self.path, self._solver = path, solver
        stage: Any = Usd.Stage.CreateInMemory()
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(TICKS)
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/fluid").GetPrim())
        self._stage = stage
        self._points: Any = UsdGeom.Points.Define(stage, "/fluid/particles")
        self._points.CreateWidthsAttr([solver.scene.particle_spacing])
        self._points.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        self._colours: Any = self._points.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        self._mesh: Any = None
        if solver.scene.dim == 3:
            self._mesh = UsdGeom.Mesh.Define(stage, "/fluid/surface")
            self._mesh.CreateSubdivisionSchemeAttr("none")
            self._mesh.CreateDisplayColorAttr([(0.25, 0.58, 0.84)])
            self._mesh.CreatePurposeAttr(UsdGeom.Tokens.render)

    def write(self) -> None:
        """Add the present instant."""
        Vt = _pxr("Vt")
        solver, code = self._solver, TICKS * float(self._solver.time[0])
        particles, scene = solver.particles(), solver.scene
        places, moving = (_in_space(vectors) for vectors in (particles.position, particles.velocity))
        colours = colour_values(values_of(particles, "speed"), usual_range(scene, "speed")) / np.float32(255.0)
        self._points.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(places), code)
        self._points.GetVelocitiesAttr().Set(Vt.Vec3fArray.FromNumpy(moving), code)
        self._points.GetIdsAttr().Set(Vt.Int64Array.FromNumpy(particles.identity.astype(np.int64)), code)
        self._colours.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(colours, np.float32)), code)
        if self._mesh is not None:
            mesh = mesh_surface(shot_of(solver))
            self._mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.vertices)), code)
            corners = np.ascontiguousarray(mesh.triangles, np.int32).ravel()
            self._mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(corners), code)
            counts = np.full(len(mesh.triangles), 3, np.int32)
            self._mesh.GetFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts), code)
        if not self._stage.HasAuthoredTimeCodeRange():
            self._stage.SetStartTimeCode(code)
        self._stage.SetEndTimeCode(code)

    def close(self) -> None:
        """Write the file."""
        self._stage.GetRootLayer().Export(str(self.path))


def _pxr(name: str) -> Any:
    """A module of the library, whose names no type checker knows."""
    return import_module(f"pxr.{name}")


def _in_space(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 3), float32; those of two dimensions lie in the plane y = 0."""
    three = vectors if vectors.shape[1] == 3 else np.insert(vectors, 1, 0.0, axis=1)
    return np.ascontiguousarray(three, np.float32)
