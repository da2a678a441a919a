"""Other SPH programs on the same scenes, each in an interpreter of its own, for comparison.

A scene is handed over as a file of arrays, and the peer's program (`run_pysph.py`) hands back the particles of each
instant at which the case looks; the errors are then computed here, by the case's own functions, as they are of our own
runs. Only the particles and their neighbourhood can be looked at so: a `Snapshot` has what cases ask of a solver.

The file handed over is an .npz with

    position (n, dim) [m], velocity (n, dim) [m/s], pressure (n,) [Pa]   at the start
    times (m,) [s]     at which the particles are wanted
    facts              JSON: method, courant (over that of the peer's own examples), ratio (h over the spacing beside
                       walls; null is the peer's own), dim, spacing [m], density
                       [kg/m3], sound_speed [m/s], reference_speed [m/s], viscosity [m2/s], gravity [m/s2], lower and
                       upper corner [m], faces (the kind of each, in order)

and the file handed back one with position, velocity, density, pressure, each with m + 1 instants before its other
axes, and facts: wall_s, setup_s [s], steps, gamma (the exponent of the state equation; 1 is linear). While it runs, the
program prints lines "time SECONDS" as far as it has come.

The time that counts is that of the peer's time loop, in one thread; its start, its compilation and the files do not.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any, cast

import numpy as np

from fluidgym.scene import Particles, Scene, face_names
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.sph.state_equation import TAIT
from fluidgym.validation.case import Case, Result, limits_at

INTERPRETER = "FLUIDGYM_PEER_PYTHON"  # in the environment: what runs a peer unless one is named
BROKEN = 3  # exit status of a peer whose run breaks down
ARRAYS = ("position", "velocity", "density", "pressure")  # of the particles, handed back


@dataclass(frozen=True)
class Peer:
    """A program to compare with.

    Attributes:
        name: On the command line.
        title: One line for people.
        package: On the package index.
        script: What runs a scene in it.
        method: Which of its schemes, in the script's words.
    """

    name: str
    title: str
    package: str
    script: Path
    method: str


_PYSPH = ("pysph", Path(__file__).with_name("run_pysph.py"))
PEERS = {
    peer.name: peer
    for peer in (
        Peer("pysph", "PySPH, WCSPH as in its dam break and drop; periodic flows: TVF", *_PYSPH, "auto"),
        Peer("pysph-thin", "the same with a tenth of the artificial viscosity, alpha = 0.01", *_PYSPH, "thin"),
        Peer("pysph-edac", "PySPH, EDAC as in its dam break and Taylor-Green vortices", *_PYSPH, "edac"),
    )
}


def find_peer(name: str) -> Peer:
    """A peer by its name.

    Raises:
        ValueError: There is none of that name.
    """
    if name not in PEERS:
        raise ValueError(f"unknown peer {name}; known are {', '.join(PEERS)}")
    return PEERS[name]


def find_interpreter(given: str | os.PathLike[str] | None = None) -> str:
    """The interpreter that runs peers: the one named, or that of the environment, or our own."""
    return os.fspath(given or os.environ.get(INTERPRETER) or sys.executable)


def version(peer: Peer, interpreter: str) -> str:
    """The version of a peer, as its interpreter has it.

    Raises:
        ValueError: The interpreter does not run, or has no such peer.
    """
    try:
        asked = _start([interpreter, str(peer.script), "--version"], subprocess.PIPE)
        said, complaint = asked.communicate(timeout=120)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ValueError(f"--peers {peer.name}: {interpreter} does not run: {error}; name a Python") from None
    if asked.returncode:
        raise ValueError(
            f"--peers {peer.name}: {interpreter} has no {peer.package} ({_last_line(complaint)}); pip install"
            f" 'fluidgym-sph[peers]', or name by --peer-python one that has it"
        )
    return said.strip()


def check_scene(scene: Scene) -> None:
    """Refuse what the hand-over has no words for.

    Raises:
        ValueError: The scene has such things.
    """
    missing = {
        "bodies": scene.bodies,
        "inflows": scene.inflows,
        "outflows": scene.outflows,
        "a central force": scene.central_force,
        "heat": scene.material.thermal_diffusivity,
        "walls that move": any(face.moving for face in scene.faces.values()),
        "walls of no slip": any(face.slip == "no" for face in scene.faces.values()),
        "viscosity beside walls": scene.material.viscosity and any(f.kind == "wall" for f in scene.faces.values()),
    }
    for what, there in missing.items():
        if there:
            raise ValueError(f"a peer is handed no scene with {what}; choose another case")


def run(
    peer: Peer,
    case: Case,
    resolution: int,
    dim: int = 2,
    end: float | None = None,
    courant: float = 1.0,
    interpreter: str | None = None,
    progress: Callable[[float], object] = lambda duration: None,
) -> Result:
    """Run a case in a peer.

    Args:
        peer: The peer.
        case: The case.
        resolution: As the case counts it.
        dim: 2 or 3.
        end: Latest instant to observe [s]; None is the case's own end.
        courant: Length of the peer's steps over that in its own examples.
        interpreter: What runs it; None is that of `find_interpreter`.
        progress: Called with every further piece of simulated time [s].

    Returns:
        As of `fluidgym.validation.run`. What a peer's snapshot cannot show is left out of the errors; a run that breaks
        down has no records, and the error nan.

    Raises:
        ValueError: The case is more than a peer can be handed, or the peer's program fails.
    """
    if case.parts or case.drive or dim not in case.resolutions:
        what = "parts" if case.parts else "controls that move" if case.drive else f"no {dim}D variant"
        raise ValueError(f"{case.name} has {what}, which a peer is not handed; choose another case")
    scene = case.scene(resolution, dim)
    check_scene(scene)
    end = case.end if end is None else end
    times = case.times[case.times <= end * (1 + 1e-9)]
    n = len(scene.sample())
    begin = time.perf_counter()
    facts, flow = _exchange(peer, scene, times, interpreter, courant, progress=progress)
    spent = time.perf_counter() - begin
    whole = bool(facts)
    result = Result(
        case=case.name,
        resolution=resolution,
        dim=dim,
        particles=n,
        steps=facts.get("steps", 0),
        wall_s=facts.get("wall_s", spent),
        setup_s=facts.get("setup_s", 0.0),
        device=f"{peer.name}, one thread",
        errors={},
        target=limits_at(resolution, case.target),
        goal=limits_at(resolution, case.goal),
        times=np.concatenate([[0.0], times]),
        records={},
    )
    if not whole:
        return result
    scheme = Scheme(state_equation=TAIT, gamma=facts["gamma"]) if facts["gamma"] > 1.0 else Scheme()
    seen = [
        case.observe(cast(Solver, Snapshot(scene, scheme, now, **{name: flow[name][k] for name in ARRAYS})))
        for k, now in enumerate(result.times)
    ]
    records = {name: np.array([instant[name] for instant in seen]) for name in seen[0]}
    return replace(result, errors=case.errors(result.times, records, scene), records=records)


def pace(
    peer: Peer, scene: Scene, duration: float, ratio: float | None = None, interpreter: str | None = None
) -> tuple[int, float]:
    """How many steps a peer takes for a scene, and in what time.

    Args:
        peer: The peer.
        scene: What is simulated.
        duration: How much of it [s].
        ratio: Smoothing length over the spacing; None is the peer's own.
        interpreter: What runs it; None is that of `find_interpreter`.

    Returns:
        The steps, and the time of the peer's loop [s].

    Raises:
        ValueError: The scene is more than a peer can be handed, or the peer's program fails.
    """
    check_scene(scene)
    facts, _ = _exchange(peer, scene, np.array([duration]), interpreter, ratio=ratio)
    if not facts:
        raise ValueError(f"{peer.name} broke down")
    return facts["steps"], facts["wall_s"]


def _exchange(
    peer: Peer,
    scene: Scene,
    times: np.ndarray,
    interpreter: str | None,
    courant: float = 1.0,
    ratio: float | None = None,
    progress: Callable[[float], object] = lambda duration: None,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Hand a scene over, run the peer, and take back facts and arrays; none of either where the run breaks down."""
    with tempfile.TemporaryDirectory(prefix="fluidgym-peer-") as folder:
        source, target = Path(folder) / "scene.npz", Path(folder) / "flow.npz"
        hand_over(scene, times, source, peer.method, courant, ratio)
        if not _run_script(peer, interpreter or find_interpreter(), source, target, progress):
            return {}, {}
        return _take_back(peer, target, len(times) + 1, len(scene.sample()), scene.dim)


def hand_over(
    scene: Scene, times: np.ndarray, path: Path, method: str, courant: float = 1.0, ratio: float | None = None
) -> None:
    """Write a scene for a peer."""
    start = scene.sample()
    facts = {
        "method": method,
        "courant": courant,
        "ratio": ratio,
        "dim": scene.dim,
        "spacing": scene.particle_spacing,
        "density": scene.material.density,
        "sound_speed": scene.sound_speed,
        "reference_speed": scene.speed_scale,
        "viscosity": scene.material.viscosity,
        "gravity": scene.gravity_vector.tolist(),
        "lower": list(scene.lower),
        "upper": list(scene.upper),
        "faces": [scene.faces[name].kind for name in face_names(scene.dim)],
    }
    np.savez(
        path,
        facts=json.dumps(facts),
        position=start.position,
        velocity=start.velocity,
        pressure=start.pressure,
        times=times,
    )


class Snapshot:
    """A peer's particles at an instant, as cases ask a solver for them: what can be known without the solver itself.

    Attributes:
        scene: What is simulated.
        scheme: Whose state equation is the peer's; nothing else of it is.
        time: Since the start [s], (1,).
        gravity: [m/s2], (1, dim).
        capacity: Number of particles.
        state: Where the faces are, which `pressure_at` asks for.
    """

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme,
        time: float,
        position: np.ndarray,
        velocity: np.ndarray,
        density: np.ndarray,
        pressure: np.ndarray,
    ):
        self.scene, self.scheme, self.time = scene, scheme, np.array([time])
        self.gravity = scene.gravity_vector[None]
        self.capacity = len(position)
        self._particles = Particles(position, velocity, density, pressure, np.arange(len(position)))
        at = scene.face_start_positions()[None]
        faces = {"position": at, "acceleration": np.zeros_like(at)}
        self.state = SimpleNamespace(faces=SimpleNamespace(**{name: _Known(values) for name, values in faces.items()}))

    def particles(self, world: int = 0) -> Particles:
        """The particles, in the order in which they were handed over."""
        return self._particles

    def parameter(self, name: str) -> np.ndarray:
        """Sound speed [m/s], viscosity [m2/s] or gamma, (1,)."""
        known = {
            "sound_speed": self.scene.sound_speed,
            "viscosity": self.scene.material.viscosity,
            "gamma": self.scheme.gamma,
        }
        return np.array([known[name]])


@dataclass(frozen=True)
class _Known:
    """Values that are read as those on a device are."""

    values: np.ndarray

    def numpy(self) -> np.ndarray:
        return self.values


def _start(command: list[str], complaints: int | IO[str]) -> subprocess.Popen[str]:
    """A peer's program: one thread, and nothing of our own on its path."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    environment |= {"OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}
    return subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=complaints,
        text=True,
    )


def _run_script(peer: Peer, interpreter: str, source: Path, target: Path, progress: Callable[[float], object]) -> bool:
    """Run a peer's program; whether it came to the end.

    Raises:
        ValueError: It failed, other than by breaking down.
    """
    reached = 0.0
    with tempfile.TemporaryFile("w+") as complaints:
        running = _start([interpreter, str(peer.script), str(source), str(target)], complaints)
        try:
            assert running.stdout is not None
            with running.stdout as lines:
                for line in lines:
                    if line.startswith("time "):
                        now = float(line.split()[1])
                        progress(now - reached)
                        reached = now
            status = running.wait()
        finally:
            if running.poll() is None:  # interrupted
                running.kill()
                running.wait()
        complaints.seek(0)
        said = complaints.read()
    if status not in (0, BROKEN):
        raise ValueError(f"{peer.name} failed: {_last_line(said) or f'exit status {status}'}")
    return status == 0


def _take_back(peer: Peer, path: Path, instants: int, n: int, dim: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a peer handed back: facts and arrays.

    Raises:
        ValueError: The file is not there or holds something else.
    """
    try:
        with np.load(path) as file:
            flow = {name: file[name] for name in ARRAYS}
            facts = json.loads(str(file["facts"]))
    except (OSError, KeyError, ValueError) as error:
        raise ValueError(f"{peer.name} handed back no flow: {error}") from None
    for name in ARRAYS:
        expected = (instants, n, dim) if name in ("position", "velocity") else (instants, n)
        if flow[name].shape != expected:
            raise ValueError(f"{peer.name} handed back {name} of shape {flow[name].shape}, not {expected}")
    return facts, flow


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""
