"""Driving the tasks with the worst that a policy can find, for as long as you like; and again, exactly, what broke.

Every episode of every world has a plan of actions of its own, drawn up before it begins: a random walk, one bang after
another, an extreme held, a beat near the sloshing frequencies, white noise; or a plan that did badly before, changed a
little, which is a search for what breaks. How badly is the largest compression, for that is what grows before a world
blows up. A world does not depend on its neighbours, so task, options, seed and plan are all it takes to see it again.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np

from fluidgym import snapshot
from fluidgym.envs import FluidEnv, make_task
from fluidgym.envs.fluid_task import FluidTask
from fluidgym.envs.runner import Runner
from fluidgym.scene import face_names
from fluidgym.solver import Solver

KINDS = ("walk", "bang", "hold", "beat", "noise", "search")
ELITE = 16  # plans that the search goes on from
LOOK = 10  # steps between looks at every particle


@dataclass
class Report:
    """What a soak has met in one task.

    Attributes:
        task: Its name.
        steps: Environment steps, of all worlds together.
        episodes: That were begun.
        seconds: That it took.
        diverged: Episodes that ended so.
        reasons: How often each reason was given.
        compression: The largest rho / rho_0 - 1 but those of worlds that diverged.
        void: The largest 1 - rho / rho_0, likewise: of fluid that has torn.
        speed: The largest over that of sound, likewise.
        clamped: The most particles that a wall or body had to put right in one step of one world.
        penetration: The farthest that a particle was found beyond a wall, over the spacing.
        mass_error: Particles that were neither there nor accounted for.
        worst: Of each kind of plan the largest compression.
        files: What replays the failures.
    """

    task: str
    steps: int = 0
    episodes: int = 0
    seconds: float = 0.0
    diverged: int = 0
    reasons: dict[str, int] = field(default_factory=dict)
    compression: float = 0.0
    void: float = 0.0
    speed: float = 0.0
    clamped: int = 0
    penetration: float = 0.0
    mass_error: int = 0
    worst: dict[str, float] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)

    @property
    def per_million(self) -> float:
        """Divergences per million environment steps."""
        return 1e6 * self.diverged / max(self.steps, 1)

    @property
    def sound(self) -> bool:
        """Whether nothing diverged, was beyond a wall, missing or twice."""
        return not self.diverged and not self.mass_error and self.penetration <= 0.0

    def __str__(self) -> str:
        reasons = f" ({', '.join(f'{name} {n}' for name, n in self.reasons.items())})" if self.reasons else ""
        return (
            f"{self.steps} steps, {self.diverged} diverged{reasons}, {self.per_million:.0f} per million, compression"
            f" to {self.compression:.2f}, void to {self.void:.2f}, speed to {self.speed:.2f} c_0,"
            f" {self.penetration:.2g} spacings beyond a wall, {self.mass_error} particles missing or twice"
        )


class Plans:
    """Sequences of actions, each in -1 to 1, (step, action)."""

    def __init__(self, steps: int, actions: int, interval: float, rng: np.random.Generator):
        """Plan for episodes of so many steps [s] of so many actions."""
        self._steps, self._actions, self._interval, self._rng = steps, actions, interval, rng
        self._elite: list[tuple[float, np.ndarray]] = []

    def draw(self) -> tuple[str, np.ndarray]:
        """A kind, and a plan of it."""
        kinds = KINDS if self._elite else KINDS[:-1]
        kind, plan = self._plan(kinds)
        return kind, plan.clip(-1.0, 1.0).astype(np.float32)

    def _plan(self, kinds: Sequence[str]) -> tuple[str, np.ndarray]:
        kind = kinds[int(self._rng.integers(len(kinds)))]
        return kind, getattr(self, f"_{kind}")()

    def learn(self, badness: float, plan: np.ndarray) -> None:
        """Remember a plan if it was among the worst."""
        self._elite.append((badness, plan))
        self._elite.sort(key=lambda kept: -kept[0])
        del self._elite[ELITE:]

    def _walk(self) -> np.ndarray:
        size = self._rng.uniform(0.05, 0.8)
        walk = np.cumsum(size * self._rng.standard_normal((self._steps, self._actions)), axis=0)
        return 1.0 - np.abs((walk + 1.0) % 4.0 - 2.0)  # turned back at the ends

    def _bang(self) -> np.ndarray:
        flips = self._rng.random((self._steps, self._actions)) < self._rng.choice([1.0, 0.5, 0.2, 0.05])
        return np.where(np.cumsum(flips, axis=0) % 2 == 0, 1.0, -1.0) * self._rng.choice([-1.0, 1.0], self._actions)

    def _hold(self) -> np.ndarray:
        return np.tile(self._rng.choice([-1.0, 1.0], self._actions), (self._steps, 1))

    def _beat(self) -> np.ndarray:
        times = self._interval * np.arange(self._steps)[:, None]
        frequency, phase = self._rng.uniform(0.1, 4.0, self._actions), self._rng.uniform(0.0, 1.0, self._actions)
        wave = np.sin(2.0 * np.pi * (frequency * times + phase))
        return np.sign(wave) if self._rng.random() < 0.5 else wave

    def _noise(self) -> np.ndarray:
        return self._rng.uniform(-1.0, 1.0, (self._steps, self._actions))

    def _search(self) -> np.ndarray:
        plan = self._elite[self._rng.integers(len(self._elite))][1].astype(float)
        way = self._rng.integers(3)
        if way == 0:  # another stretch of something else
            first, length = self._rng.integers(self._steps), self._rng.integers(1, 1 + self._steps // 2)
            plan[first : first + length] = self._plan(KINDS[:-1])[1][first : first + length]
        elif way == 1:
            plan = plan + self._rng.uniform(0.05, 0.5) * self._rng.standard_normal(plan.shape)
        else:  # a little earlier or later
            plan = np.roll(plan, self._rng.integers(-5, 6), axis=0)
        return plan


def soak(
    task: str,
    options: Mapping[str, Any],
    worlds: int = 32,
    seed: int = 0,
    seconds: float | None = None,
    steps: int | None = None,
    folder: Path | None = None,
    device: str | None = None,
    progress: Callable[[Report], object] = lambda report: None,
    threads: int | None = None,
) -> Report:
    """Drive a task.

    Args:
        task: Its name.
        options: Of the task; JSON.
        worlds: How many at a time.
        seed: Of everything that is drawn.
        seconds: Go on for so long [s].
        steps: Or for so many environment steps, of all worlds together.
        folder: Where files go that replay failures; None keeps none.
        device: "cpu", "cuda", ...; None takes a GPU where there is one.
        progress: Called after each step.
        threads: Of a CPU, that share the worlds at most; None is as many as there are processors.

    Raises:
        ValueError: An argument is out of its limits, or neither seconds nor steps are given.
    """
    if seconds is None and steps is None:
        raise ValueError("soak wants seconds or steps; give one of them")
    rng = np.random.default_rng(seed)
    posed = make_task(task, **options)
    assert isinstance(posed, FluidTask)
    runner = Runner(posed, worlds, device, threads=threads)
    limit, acts = posed.max_episode_steps, len(posed.action_names())
    plans = Plans(limit, acts, posed.control_interval, rng)
    report, begin = Report(task), time.monotonic()
    kinds, drawn, seeds = [""] * worlds, np.zeros((worlds, limit, acts), np.float32), np.zeros(worlds, int)
    at, bad = np.zeros(worlds, int), np.zeros(worlds)

    def start(mask: np.ndarray) -> None:
        for world in np.flatnonzero(mask):
            kinds[world], drawn[world] = plans.draw()
            seeds[world] = int(rng.integers(2**31))
        at[mask], bad[mask] = 0, 0.0
        runner.reset(mask, [int(one) for one in seeds])
        report.episodes += int(mask.sum())

    start(np.ones(worlds, bool))
    while (seconds is None or time.monotonic() - begin < seconds) and (steps is None or report.steps < steps):
        actions = drawn[np.arange(worlds), at]
        outcome = runner.step(runner.check_actions(actions, "actions", actions.shape))
        at += 1
        report.steps += worlds
        fluid, broke = posed.fluid, outcome.terminated & outcome.info["diverged"]
        bad = np.maximum(bad, np.where(broke, 1.0, np.nan_to_num(fluid["compression"], nan=1.0)))
        sound = ~broke
        if sound.any():
            report.compression = max(report.compression, float(fluid["compression"][sound].max()))
            report.void = max(report.void, float(fluid["void"][sound].max()))
            report.speed = max(report.speed, float(fluid["speed"][sound].max()) / posed.scene.sound_speed)
        report.clamped = max(report.clamped, int(outcome.info["clamped"].max()))
        if report.steps // worlds % LOOK == 0:
            missing, beyond = amiss(runner.solver, np.flatnonzero(sound))
            report.mass_error, report.penetration = report.mass_error + missing, max(report.penetration, beyond)
        for world in np.flatnonzero(broke):
            reason = str(outcome.info["reason"][world])
            report.diverged += 1
            report.reasons[reason] = report.reasons.get(reason, 0) + 1
            if folder is not None:
                path = folder / f"{task}-{seeds[world]}.npz"
                keep(path, task, options, int(seeds[world]), drawn[world, : at[world]], reason)
                report.files.append(os.fspath(path))
        ended = outcome.terminated | outcome.truncated
        for world in np.flatnonzero(ended):
            plans.learn(float(bad[world]), drawn[world].copy())
            report.worst[kinds[world]] = max(report.worst.get(kinds[world], 0.0), float(bad[world]))
        if ended.any():
            start(ended)
        report.seconds = time.monotonic() - begin
        progress(report)
    return report


def soak_all(tasks: Mapping[str, Mapping[str, Any]], jobs: int, **how: Any) -> Iterator[tuple[str, Report]]:
    """Drive several tasks, so many at a time, each in a process and with a thread of its own.

    Args:
        tasks: Options by a name of your own; "task" among them is the task's name.
        jobs: How many at a time.
        how: Arguments of `soak`, for all alike.

    Yields:
        Name and report, in order. What goes on is stopped when the caller stops.

    Raises:
        BrokenProcessPool: A process was killed.
    """
    before = set(active_children())
    heed = (signal.SIGINT, signal.SIG_IGN)  # an interrupt is the caller's, who stops them
    pool = ProcessPoolExecutor(min(jobs, len(tasks)), get_context("spawn"), signal.signal, heed)
    try:
        begun = {name: pool.submit(_soak_alone, dict(options), how) for name, options in tasks.items()}
        for name, report in begun.items():
            yield name, report.result()
    finally:
        for process in set(active_children()) - before:
            process.terminate()
        pool.shutdown(cancel_futures=True)


def _soak_alone(options: dict[str, Any], how: dict[str, Any]) -> Report:
    return soak(options.pop("task"), options, threads=1, **how)


def amiss(solver: Solver, worlds: Iterable[int]) -> tuple[int, float]:
    """How many particles of some worlds are missing or twice, and how far the farthest is beyond a wall [spacings]."""
    scene, dim, missing, farthest = solver.scene, solver.scene.dim, 0, 0.0
    identity = solver.state.now.identity.numpy().reshape(solver.num_worlds, -1)
    position = solver.state.now.position.numpy().reshape(dim, solver.num_worlds, -1)
    walls = solver.state.faces.position.numpy()
    for world in worlds:
        missing += _astray(identity[world], bool(scene.inflows))
        live = identity[world] >= 0
        for face, name in enumerate(face_names(dim) if live.any() else ()):
            if scene.faces[name].kind == "wall":
                beyond = (1 - 2 * (face % 2)) * (walls[world, face] - position[face // 2, world, live])
                farthest = max(farthest, float(beyond.max()) / scene.particle_spacing)
    return missing, farthest


def _astray(identity: np.ndarray, renewed: bool) -> int:
    """Particles of a world that are twice, or neither there nor retired.

    Args:
        identity: Of all slots; negative for those retired, (slot,).
        renewed: Whether there are inflows, which take the slots of retired particles for new ones.
    """
    numbers = np.sort(identity[identity >= 0] if renewed else np.where(identity < 0, -1 - identity, identity))
    twice = int((np.diff(numbers) == 0).sum())
    return twice if renewed else max(twice, len(np.setdiff1d(np.arange(len(numbers)), numbers)))


def keep(path: Path, task: str, options: Mapping[str, Any], seed: int, plan: np.ndarray, reason: str) -> None:
    """Write a file that replays an episode."""
    path.parent.mkdir(parents=True, exist_ok=True)
    about = json.dumps({"task": task, "options": dict(options), "seed": seed, "reason": reason})
    snapshot.save({"about": np.frombuffer(about.encode(), np.uint8), "plan": plan}, path)


def replay(path: str | os.PathLike[str], device: str | None = None) -> tuple[str, int]:
    """Play an episode of a file again, alone.

    Returns:
        Why it diverged ("" if it did not), and after how many steps.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is no file of a soak, or of a task that is no longer there.
    """
    kept = snapshot.load(path)
    if set(kept) != {"about", "plan"}:
        raise ValueError(f"path = {os.fspath(path)!r} is a snapshot, not of a soak; give a file that a soak wrote")
    about = json.loads(kept["about"].tobytes().decode())
    env = FluidEnv(about["task"], device=device, **about["options"])
    try:
        env.reset(seed=about["seed"])
        for n, action in enumerate(kept["plan"], start=1):
            info = env.step(action)[-1]
            if info["diverged"]:
                return str(info["reason"]), n
        return "", len(kept["plan"])
    finally:
        env.close()
