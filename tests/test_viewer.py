"""The viewer: what it shows, what a person may do with it, and the page in a browser."""

import io
import re
import shutil
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fluidgym.__main__ import main
from fluidgym.envs import FluidEnv
from fluidgym.picture import shot_of
from fluidgym.render.mesh import mesh_surface
from fluidgym.scene import Box, Fluid, Scene
from fluidgym.scene_file import load
from fluidgym.solver import Solver
from fluidgym.viewer import page as pages
from fluidgym.viewer.flows import EnvFlow, SceneFlow
from fluidgym.viewer.page import Page, lifted, tile

SCENES = Path(__file__).parents[1] / "examples" / "scenes"


def env_flow(task="DamBreakContain", controller="scripted", by_hand=True):
    return EnvFlow(FluidEnv(task, difficulty="easy", device="cpu"), controller, by_hand)


# -- flows -----------------------------------------------------------------------------------------------------------


def test_a_person_moves_the_wall():
    flow = env_flow()
    assert [knob.name for knob in flow.knobs] == ["wall"]
    start = flow.solver.face_position("x_max")[0]
    flow.knobs[0].value = -1.0
    for _ in range(5):
        flow.step()
    assert flow.solver.face_position("x_max")[0] < start - 0.2
    assert float(flow.readouts()["return"]) != 0.0
    flow.reset(1)
    assert flow.solver.face_position("x_max")[0] == start
    assert flow.readouts()["time"] == "0.00 s"


def test_enter_lifts_the_gate_even_if_a_controller_drives():
    flow = env_flow("DamBreakGate", by_hand=False)
    assert flow.enter == "lifts the gate"
    for _ in range(6):
        flow.step()
    low = flow.solver.body_position("gate")[0, 1]
    flow.press_enter()
    assert flow.by_hand
    for _ in range(3):
        flow.step()
    assert flow.solver.body_position("gate")[0, 1] > low + 0.1


def test_a_controller_turns_the_knobs_and_the_end_is_told():
    flow = env_flow("SloshDamp", by_hand=False)
    turned = set()
    for _ in range(70):
        flow.step()
        turned.add(flow.knobs[0].value)
    assert len(turned) > 10
    assert flow.ended
    assert "episode" in flow.readouts()
    steps = flow.readouts()["time"]
    flow.step()
    assert flow.readouts()["time"] == steps
    grid = flow.grid()
    assert grid is not None and grid.shape == (8, 12)
    assert grid[-1].mean() > 0.8 > 0.2 > grid[0].mean()  # water is below


def test_a_scene_file_goes_as_it_says_and_by_hand():
    flow = SceneFlow(load(SCENES / "dam_break_gate.toml", particle_spacing=0.05), "cpu", by_hand=False)
    assert [knob.name for knob in flow.knobs] == ["gate x", "gate y"]
    gate = flow.solver.body_position("gate")[0, 1]
    while flow.solver.time[0] < 0.15:
        flow.step()
    assert flow.solver.body_position("gate")[0, 1] == gate
    flow.press_enter()
    assert flow.by_hand and "lifts gate" in flow.enter
    for _ in range(10):
        flow.step()
    assert flow.solver.body_position("gate")[0, 1] > gate + 0.1
    flow.reset(0)
    assert flow.solver.time[0] == 0.0


# -- what is shown ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spacing", [0.1, 0.05])
def test_the_surface_of_still_water_holds_its_volume(spacing):
    water = Fluid(Box((0.0, 0.0, 0.0), (1.0, 0.6, 0.5)), pressure="hydrostatic")
    mesh = mesh_surface(shot_of(Solver(Scene((0.0, 0.0, 0.0), (1.0, 0.6, 1.0), spacing, [water]), device="cpu")))
    assert mesh.volume == pytest.approx(0.3, rel=0.03)
    # Closed: every edge belongs to two triangles, in opposite directions.
    edges = np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    assert {tuple(edge) for edge in edges.tolist()} == {tuple(edge[::-1]) for edge in edges.tolist()}
    assert np.abs(mesh.vertices[:, 2].max() - 0.5) < 0.5 * spacing


def test_the_surface_of_a_world_of_two_dimensions_is_a_slab():
    water = Fluid(Box((0.0, 0.0), (1.0, 0.5)), pressure="hydrostatic")
    solver = Solver(Scene((0.0, 0.0), (1.0, 1.0), 0.05, [water]), device="cpu")
    assert mesh_surface(shot_of(solver, layers=4)).volume == pytest.approx(0.5 * 4 * 0.05, rel=0.03)


def test_nothing_has_no_surface():
    solver = Solver(Scene((0.0,) * 3, (1.0,) * 3, 0.1, [], reference_speed=1.0), device="cpu")
    assert mesh_surface(shot_of(solver)).volume == 0.0


def test_places_and_tiles():
    np.testing.assert_array_equal(lifted(np.array([[1.0, 2.0]]), 0.1), [[1.0, 0.0, 2.0]])
    picture = tile(np.array([[0.0, 0.5], [1.0, 2.0]]))
    assert picture.dtype == np.uint8 and picture.shape[0] >= 160
    assert (picture[-1, 0] == picture[-1, -1]).all()  # more than full is full


# -- the page --------------------------------------------------------------------------------------------------------


def test_the_page_is_served_and_does_what_is_wished(monkeypatch):
    page = Page(env_flow(), port=8231)
    try:
        with urllib.request.urlopen(page.url, timeout=10) as answer:
            assert answer.status == 200
        assert page.url.startswith("http://127.0.0.1:")
        start = page.flow.solver.face_position("x_max")[0]
        page._take(0, -1.0)
        for _ in range(3):
            page._step_once()
        assert page.flow.solver.face_position("x_max")[0] < start
        page._as_surface.value = True
        page._choose()
        assert "/surface" in page._shapes and "/particles" not in page._shapes
        page._as_surface.value = False
        page._choose()
        assert "/particles" in page._shapes and "/surface" not in page._shapes
        page._reset()
        assert page.flow.solver.face_position("x_max")[0] == start
        # It plays at the pace of time, and ends when the last page has been closed for a while.
        monkeypatch.setattr(pages, "GRACE", 0.5)
        page._toggle_play()
        page._arrived()
        loop = threading.Thread(target=page.run)
        loop.start()
        time.sleep(1.0)
        page._wish(page._gone)
        loop.join(timeout=20)
        assert not loop.is_alive()
        assert page.flow.readouts()["time"] != "0.00 s"
    finally:
        page.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("Tsunami2D-v0", "unknown environment Tsunami2D-v0"),
        ("gone.toml", "gone.toml: cannot be read"),
        ("CarryTank2D-v0 --policy gone.npz", "policy = 'gone.npz' does not exist"),
        (f"{SCENES / 'sloshing.toml'} --policy scripted", "--policy scripted is for environments"),
    ],
)
def test_bad_arguments_are_refused(arguments, message, capsys):
    assert main(["view", *arguments.split(), "--device", "cpu"]) == 2
    assert message in capsys.readouterr().err


def test_without_the_library_the_remedy_is_told(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", "CarryTank2D-v0"]) == 2
    assert 'pip install "fluidgym-sph[viewer]"' in capsys.readouterr().err


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def changed(before: bytes, after: bytes) -> float:
    """The share of two pictures that is not alike."""
    a, b = (np.asarray(Image.open(io.BytesIO(one)).convert("RGB"), int) for one in (before, after))
    return float((np.abs(a - b).max(axis=2) > 24).mean())


# No package index has a browser; where there is none, what the page does is tested above, by its own calls.
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_the_page_in_a_browser(tmp_path):
    playwright = pytest.importorskip("playwright.sync_api")
    command = [sys.executable, "-m", "fluidgym", "view", "DamBreakGate2D-v0", "--difficulty", "easy", "--port", "8251"]
    with subprocess.Popen([*command, "--device", "cpu"], stdout=subprocess.PIPE, text=True) as viewer:
        assert viewer.stdout is not None
        address = re.search(r"http://127\.0\.0\.1:\d+", viewer.stdout.readline())
        assert address
        with playwright.sync_playwright() as library:
            browser = library.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
            page = browser.new_page(viewport={"width": 1000, "height": 1000})
            page.goto(address.group(0))

            def readout(name):
                row = page.locator("tr", has_text=name).first
                row.wait_for(timeout=30_000)
                return row.inner_text().split("\t")[-1].strip()

            def until(condition):
                end = time.monotonic() + 30.0
                while not condition():
                    assert time.monotonic() < end, page.inner_text("body")
                    page.wait_for_timeout(100)

            assert readout("time") == "0.00 s"
            page.get_by_role("button", name="Step").click()
            until(lambda: readout("time") == "0.10 s")
            # The slider moves the gate.
            slider = page.get_by_role("slider").first
            before = readout("effort")
            slider.focus()
            for _ in range(40):
                page.keyboard.press("ArrowLeft")
            page.get_by_role("button", name="Step").click()
            until(lambda: readout("effort") != before)
            # Enter lifts the gate; space plays.
            page.mouse.click(300, 700)
            page.keyboard.press("Enter")
            until(lambda: slider.get_attribute("aria-valuenow") == "1")
            page.keyboard.press(" ")
            until(lambda: float(readout("time").split()[0]) > 0.6)
            page.keyboard.press(" ")
            water = {"x": 200, "y": 450, "width": 300, "height": 550}
            page.wait_for_timeout(1500)
            particles = page.screenshot(path=tmp_path / "particles.png", clip=water)
            page.get_by_label("Surface").first.click()
            page.wait_for_timeout(1500)
            surface = page.screenshot(path=tmp_path / "surface.png", clip=water)
            assert changed(particles, surface) > 0.01  # of the picture
            page.get_by_role("button", name="Reset").click()
            until(lambda: readout("time") == "0.00 s")
            browser.close()
        try:
            assert viewer.wait(timeout=30) == 0  # closing the page leaves no process
        finally:
            viewer.kill()
