"""The page: what a flow is, as shapes and knobs of viser, and a loop that keeps it going.

viser calls back from threads of its own; what they want is done by the loop, between two frames.
"""

from __future__ import annotations

import contextlib
import io
import queue
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

from fluidgym.picture import LABELS, body_shapes, face_shapes, shot_of, usual_range, values_of
from fluidgym.render.colour import PLATE, WALL, ZONE, colour_values
from fluidgym.render.mesh import mesh_surface
from fluidgym.viewer.flows import Flow

GRACE = 4.0  # after the last page was closed, before the viewer ends [s]
LAYERS = 4  # of a world of two dimensions, where its surface is wanted as triangles
_TILE = 160  # least height of the picture of the grid [pixels]
_WATER = (64, 148, 214)
_EDGES = ((0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7))


def import_viser() -> ModuleType:
    """The library of the page.

    Raises:
        ValueError: It is not there.
    """
    try:
        import viser
    except ImportError:
        raise ValueError('the viewer needs viser; install it: pip install "fluidgym-sph[viewer]"') from None
    return viser


class Page:
    """A flow on a page, until the page is closed.

    Attributes:
        flow: What is shown.
        url: Where.
        playing: Whether it goes on by itself.
    """

    def __init__(self, flow: Flow, host: str = "127.0.0.1", port: int = 8080, seed: int = 0, stay: bool = False):
        """Serve the page.

        Args:
            flow: What is shown.
            host: Address that is listened on; only this machine reaches 127.0.0.1.
            port: Or the next that is free.
            seed: Of the first episode.
            stay: Whether to go on once the last page is closed.
        """
        viser = import_viser()
        self.flow, self.playing, self._stay = flow, False, stay
        self._wishes: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        with contextlib.redirect_stdout(io.StringIO()):  # it says where it is; so do we
            self._server = viser.ViserServer(host=host, port=port, label=f"FluidGym: {flow.title}", verbose=False)
        self.url = f"http://{host}:{self._server.get_port()}"
        self._seen, self._left, self._open = False, 0.0, 0
        self._server.on_client_connect(lambda client: self._wishes.put(self._arrived))
        self._server.on_client_disconnect(lambda client: self._wishes.put(self._gone))
        self._field, self._surface, self._closing = "speed", False, False
        scene = flow.solver.scene
        self._lower, self._upper = lifted(np.array([scene.lower, scene.upper]), scene.particle_spacing)
        self._upper[1] = max(self._upper[1], self._lower[1] + scene.particle_spacing)
        self._shapes: dict[str, Any] = {}
        self._set_scene()
        self._set_knobs(seed)
        flow.reset(seed)
        self.show()

    # -- what is there from the start ----------------------------------------------------------------------------------

    def _set_scene(self) -> None:
        server, middle = self._server, 0.5 * (self._lower + self._upper)
        server.scene.set_up_direction("+z")
        size = float(np.linalg.norm(self._upper - self._lower))
        way = np.array([0.0, -0.95, 0.08]) if self.flow.solver.scene.dim == 2 else np.array([0.35, -0.85, 0.45])
        server.initial_camera.position = tuple(middle + way * size)
        server.initial_camera.look_at = tuple(middle)
        corners = np.array(
            [[(self._lower, self._upper)[bit][k] for k, bit in enumerate(map(int, f"{n:03b}"))] for n in range(8)]
        )
        edges = corners[np.array(_EDGES)].astype(np.float32)
        server.scene.add_line_segments("/box", points=edges, colors=WALL, thickness=1.5, thickness_units="screen")

    def _set_knobs(self, seed: int) -> None:
        gui, flow = self._server.gui, self.flow
        gui.configure_theme(dark_mode=True)
        gui.main_panel.dock_right()
        gui.set_panel_label(flow.title)
        self._play = gui.add_button("Play")
        self._play.on_click(lambda _: self._wish(self._toggle_play))
        gui.add_button("Step").on_click(lambda _: self._wish(self._step_once))
        gui.add_button("Reset").on_click(lambda _: self._wish(self._reset))
        self._seed = gui.add_number("Seed", seed, min=0, step=1)
        self._by_hand = gui.add_checkbox("Drive by hand", flow.by_hand)
        self._by_hand.on_update(lambda _: self._wish(self._take_or_give))
        self._sliders = []
        for index, knob in enumerate(flow.knobs):
            label = f"{knob.name} [{knob.unit}]" if knob.unit else knob.name
            slider = gui.add_slider(
                label, min=knob.low, max=knob.high, step=(knob.high - knob.low) / 200.0, initial_value=knob.value
            )
            slider.on_update(lambda event, index=index: self._turned(event, index))
            self._sliders.append(slider)
        if flow.enter:
            gui.add_markdown(f"Enter {flow.enter}; space plays and pauses.")
            gui.add_command("Enter", hotkey="enter", description=flow.enter).on_trigger(
                lambda _: self._wish(self._press_enter)
            )
        gui.add_command("Play or pause", hotkey="space").on_trigger(lambda _: self._wish(self._toggle_play))
        fields = [name for name in LABELS if name != "temperature" or flow.solver.scene.material.thermal_diffusivity]
        self._colour = gui.add_dropdown("Colour", fields, initial_value=self._field)
        self._colour.on_update(lambda _: self._wish(self._choose))
        self._legend = gui.add_image(legend())
        self._range = gui.add_markdown("")
        self._as_surface = gui.add_checkbox("Surface", False)
        self._as_surface.on_update(lambda _: self._wish(self._choose))
        self._readouts = gui.add_markdown("")
        grid = flow.grid()
        self._grid = None if grid is None else gui.add_image(tile(grid), label="What is observed")

    # -- what a person wants -------------------------------------------------------------------------------------------

    def _wish(self, call: Callable[[], None]) -> None:
        self._wishes.put(call)

    def _arrived(self) -> None:
        self._seen, self._open = True, self._open + 1

    def _gone(self) -> None:
        self._open, self._left = self._open - 1, time.monotonic()

    def _toggle_play(self) -> None:
        self.playing = not self.playing
        self._play.label = "Pause" if self.playing else "Play"

    def _step_once(self) -> None:
        self.flow.step()
        self.show()

    def _reset(self) -> None:
        self.flow.reset(int(self._seed.value))
        self.show()

    def _take_or_give(self) -> None:
        self.flow.by_hand = bool(self._by_hand.value)

    def _turned(self, event: Any, index: int) -> None:
        """A slider was moved: by a person if there is a client to the event."""
        if event.client is not None:
            self._wish(lambda: self._take(index, float(event.target.value)))

    def _take(self, index: int, value: float) -> None:
        self.flow.by_hand, self.flow.knobs[index].value = True, value
        self._by_hand.value = True

    def _press_enter(self) -> None:
        self.flow.press_enter()
        self._by_hand.value = self.flow.by_hand
        self._move_sliders(also_by_hand=True)

    def _choose(self) -> None:
        self._field, self._surface = str(self._colour.value), bool(self._as_surface.value)
        self.show()

    # -- what is shown -------------------------------------------------------------------------------------------------

    def show(self) -> None:
        """Bring the page to the state of the flow."""
        solver = self.flow.solver
        with self._server.atomic():
            if self._surface:
                self._show_surface()
            else:
                self._show_particles()
            self._show_solids()
            low, high = usual_range(solver.scene, self._field)
            self._range.content = f"{low:.3g} to {high:.3g}: {LABELS[self._field]}"
            self._readouts.content = "\n".join(
                ["| | |", "| --- | --- |", *(f"| {name} | {value} |" for name, value in self.flow.readouts().items())]
            )
            grid = self.flow.grid()
            if self._grid is not None and grid is not None:
                self._grid.image = tile(grid)
            self._move_sliders()

    def _move_sliders(self, also_by_hand: bool = False) -> None:
        if also_by_hand or not self.flow.by_hand:
            for slider, knob in zip(self._sliders, self.flow.knobs, strict=True):
                if abs(slider.value - knob.value) > 1e-6:
                    slider.value = knob.value

    def _show_particles(self) -> None:
        scene, particles = self.flow.solver.scene, self.flow.solver.particles()
        points = lifted(particles.position, scene.particle_spacing).astype(np.float32)
        values = values_of(particles, self._field)
        colours = colour_values(values, usual_range(scene, self._field)).astype(np.uint8)
        self._take_away("/surface")
        cloud = self._shapes.get("/particles")
        if cloud is None or not len(points):
            self._shapes["/particles"] = self._server.scene.add_point_cloud(
                "/particles", points, colours, point_size=0.6 * scene.particle_spacing, point_shape="circle",
                precision="float32",
            )  # fmt: skip
        else:
            cloud.points, cloud.colors = points, colours

    def _show_surface(self) -> None:
        scene = self.flow.solver.scene
        mesh = mesh_surface(
            shot_of(self.flow.solver, layers=LAYERS), scene.particle_spacing * (0.5, 1.0)[scene.dim == 2]
        )
        self._take_away("/particles")
        self._shapes["/surface"] = self._server.scene.add_mesh_simple(
            "/surface", mesh.vertices, mesh.triangles, color=_WATER, opacity=0.85, side="double"
        )

    def _take_away(self, name: str) -> None:
        shape = self._shapes.pop(name, None)
        if shape is not None:
            shape.remove()

    def _show_solids(self) -> None:
        """Put bodies and moving walls where they are."""
        for name, (low, high), ball in self._solids():
            middle, size = 0.5 * (low + high), np.maximum(high - low, 1e-4)
            shape = self._shapes.get(name)
            if shape is None:
                scene = self._server.scene
                colour = PLATE if name.startswith("/wall") or "gate" in name else ZONE
                self._shapes[name] = (
                    scene.add_icosphere(name, radius=0.5 * float(size[0]), color=colour, position=tuple(middle))
                    if ball
                    else scene.add_box(name, color=colour, dimensions=tuple(size), opacity=0.6, position=tuple(middle))
                )
            else:
                shape.position = tuple(middle)

    def _solids(self) -> list[tuple[str, tuple[np.ndarray, np.ndarray], bool]]:
        solver, found = self.flow.solver, []
        spacing = solver.scene.particle_spacing
        for name, face in face_shapes(solver, 0).items():
            if face["moving"]:
                axis = {"x": 0, "y": 1, "z": 2}[name[0]]
                axis = 2 if axis == solver.scene.dim - 1 else axis
                low, high = self._lower.copy(), self._upper.copy()
                side = -1.0 if name.endswith("min") else 1.0
                low[axis], high[axis] = sorted((face["position"], face["position"] + 0.5 * side * spacing))
                found.append((f"/wall {name}", (low, high), False))
        for body in body_shapes(solver, 0):
            ball = body["shape"] == "ball"
            if ball:
                ends = np.array([body["center"] - body["radius"], body["center"] + body["radius"]])
            else:
                ends = np.array([body["lower"], body["upper"]])
            low, high = lifted(ends, spacing)
            if solver.scene.dim == 2:
                low[1], high[1] = self._lower[1], self._upper[1]
            found.append((f"/body {body['name']}", (low, high), ball))
        return found

    # -- the loop ------------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Go on until the last page has been closed for a while, or for ever if the viewer is to stay."""
        due = time.monotonic()
        while not self._closing:
            self._listen(0.0 if self.playing else 0.05)
            if self.playing and time.monotonic() >= due:
                due = max(due + self.flow.interval, time.monotonic() - self.flow.interval)
                self.flow.step()
                self.show()
                if self.flow.ended:
                    self._toggle_play()
            elif self.playing:
                self._listen(min(0.05, due - time.monotonic()))
            if self._seen and not self._open and not self._stay and time.monotonic() - self._left > GRACE:
                break

    def _listen(self, wait: float) -> None:
        """Do what was wished for meanwhile."""
        try:
            self._wishes.get(timeout=max(wait, 1e-3))()
            while True:
                self._wishes.get_nowait()()
        except queue.Empty:
            pass

    def close(self) -> None:
        """End the page."""
        self._closing = True
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
        self.flow.close()


def lifted(points: np.ndarray, spacing: float) -> np.ndarray:
    """Places in three dimensions (n, 3) [m]; those of two lie in the plane y = 0."""
    if points.shape[1] == 3:
        return np.array(points, float)
    return np.stack([points[:, 0], np.zeros(len(points)), points[:, 1]], axis=1)


def legend() -> np.ndarray:
    """The colour map from low to high, a picture."""
    steps = np.linspace(0.0, 1.0, 256)
    return np.broadcast_to(colour_values(steps, (0.0, 1.0))[None], (14, 256, 3)).astype(np.uint8)


def tile(grid: np.ndarray) -> np.ndarray:
    """A grid of fluid fractions (ny, nx) as a picture, a cell as a square."""
    zoom = -(-_TILE // grid.shape[0])
    return np.repeat(np.repeat(colour_values(grid, (0.0, 1.0)).astype(np.uint8), zoom, axis=0), zoom, axis=1)
