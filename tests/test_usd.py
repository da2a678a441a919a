"""The file for other tools, read with the library that they read it with."""

import sys

import numpy as np
import pytest

from fluidgym.__main__ import main
from fluidgym.scene import Box, Fluid, Scene
from fluidgym.solver import Solver
from fluidgym.usd import TICKS, UsdFile

Usd, UsdGeom = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdGeom")


@pytest.mark.parametrize("dim", [2, 3], ids=["2D", "3D"])
def test_the_file_has_every_instant(dim, tmp_path):
    water = Fluid(Box((0.0,) * dim, (0.6, 0.5, 0.5)[:dim] if dim == 2 else (0.6, 0.4, 0.5)), pressure="hydrostatic")
    solver = Solver(Scene((0.0,) * dim, (1.0, 0.4, 1.0) if dim == 3 else (1.0, 1.0), 0.1, [water]), device="cpu")
    file, places = UsdFile(tmp_path / "fluid.usda", solver), []
    for _ in range(3):
        solver.advance(0.1)
        file.write()
        places.append(solver.particles().position)
    assert not file.path.exists()
    file.close()
    stage = Usd.Stage.Open(str(file.path))
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    assert stage.GetTimeCodesPerSecond() == TICKS
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == pytest.approx((100.0, 300.0), rel=1e-6)
    points = UsdGeom.Points(stage.GetPrimAtPath("/fluid/particles"))
    codes = points.GetPointsAttr().GetTimeSamples()
    assert len(codes) == 3
    for code, place in zip(codes, places, strict=True):
        found = np.array(points.GetPointsAttr().Get(code))
        np.testing.assert_array_equal(found if dim == 3 else found[:, [0, 2]], place)
        assert len(points.GetVelocitiesAttr().Get(code)) == len(place)
        assert len(UsdGeom.PrimvarsAPI(points).GetPrimvar("displayColor").Get(code)) == len(place)
    surface = UsdGeom.Mesh(stage.GetPrimAtPath("/fluid/surface"))
    assert bool(surface) == (dim == 3)
    if dim == 3:
        assert max(surface.GetFaceVertexIndicesAttr().Get(codes[1])) < len(surface.GetPointsAttr().Get(codes[1]))
        assert set(surface.GetFaceVertexCountsAttr().Get(codes[1])) == {3}


def test_the_command_writes_it(tmp_path, capsys):
    scene = tmp_path / "pool.toml"
    scene.write_text(
        "duration = 0.2\nlower = [0.0, 0.0]\nupper = [1.0, 1.0]\nparticle_spacing = 0.1\n"
        "[[fluid]]\nshape = {box = [[0.0, 0.0], [0.5, 0.5]]}\n"
    )
    options = ["--out", str(tmp_path / "out"), "--film", "none", "--usd", "--save-every", "0.1", "--device", "cpu"]
    assert main(["run", str(scene), *options]) == 0
    assert "fluid.usdc" in capsys.readouterr().out
    stage = Usd.Stage.Open(str(tmp_path / "out" / "fluid.usdc"))
    points = UsdGeom.Points(stage.GetPrimAtPath("/fluid/particles"))
    assert points.GetPointsAttr().GetTimeSamples() == pytest.approx([0.0, 100.0, 200.0], rel=1e-6)


def test_without_the_library_the_remedy_is_told(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "pxr", None)
    monkeypatch.setattr("fluidgym.usd.find_spec", lambda name: None)
    scene = "examples/scenes/sloshing.toml"
    assert main(["run", scene, "--usd", "--out", str(tmp_path)]) == 2
    assert 'pip install "fluidgym-sph[usd]"' in capsys.readouterr().err
