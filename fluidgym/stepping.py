"""The launches of a step, for some worlds side by side, and who makes them: a GPU at once, a CPU group by group.

Worlds know nothing of each other, so any may go ahead. On a CPU a group of them that fits in its cache takes all
its steps before the next one does, and as many groups are under way as there are threads. What a world does depends
neither on its group nor on the threads.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import warp as wp

from fluidgym.sph.integrate import advance_driven
from fluidgym.sph.neighbors import order_by_cell, settle_order
from fluidgym.sph.shifting import CHUNK, add_up_gain
from fluidgym.sph.structure import Structure
from fluidgym.state import Drains, Nozzles, ParticleArrays, State, driven_arrays, part_of, struct_part

# On a GPU this many steps at most are captured at once.
STEPS_PER_GRAPH = 64

# On a CPU a thread lets go of a group after so many, so that no thread is left with much to do alone.
STEPS_PER_TURN = 8

# Of a group on a CPU: more fall out of its cache, fewer make launches count.
GROUP_PARTICLES = 2000


@dataclass(frozen=True)
class Plan:
    """What all worlds share.

    Attributes:
        structure: What is compiled in.
        kernels: Of a step.
        grid: The cells.
        frozen: Wall particles that never move, or none.
        frozen_grid: Their cells.
        face_travel: Where faces may be, on the device.
        body_travel: Where bodies may be, on the device.
        moving_faces: Whether any may move.
        moving_bodies: Whether any may move.
    """

    structure: Structure
    kernels: SimpleNamespace
    grid: Any
    frozen: Any
    frozen_grid: Any
    face_travel: wp.array
    body_travel: wp.array
    moving_faces: bool
    moving_bodies: bool


@dataclass(frozen=True)
class Group:
    """Some worlds side by side.

    Attributes:
        plan: What they share with all others.
        state: Theirs.
        constants: Theirs, (world,).
        gravity: Theirs, (world, dim).
        bounds: Of their cells, (world * cells + 2,).
        nozzles: Theirs.
        drains: Theirs.
    """

    plan: Plan
    state: State
    constants: wp.array
    gravity: wp.array
    bounds: wp.array
    nozzles: Any
    drains: Any

    def part(self, first: int, count: int, bounds: Any = None) -> Group:
        """Some of these worlds: the same arrays, but for the bounds, which are new ones or those given."""
        where = (self.state.num_worlds, first, count)
        if bounds is None:
            bounds = wp.zeros(count * self.plan.grid.stride + 2, dtype=int, device=self.state.device)
        return replace(
            self,
            state=self.state.part(first, count),
            constants=part_of(self.constants, *where),
            gravity=part_of(self.gravity, *where),
            bounds=bounds,
            nozzles=struct_part(Nozzles, self.nozzles, ("center", "frame", "half", "speed"), *where),
            drains=struct_part(Drains, self.drains, ("field",), *where),
        )

    def launch(self, n: int) -> None:
        """Go on by n steps."""
        stages = self.stages()
        for _ in range(n):
            for work in stages.values():
                work()

    def stages(self) -> dict[str, Callable[[], None]]:
        """What a step is made of, by name and in order: "move", "sort", "density", "force", "heat", "shift", "emit".

        What this scene has no use for is left out.
        """
        plan, state = self.plan, self.state
        moves_faces, moves_bodies = plan.moving_faces, plan.moving_bodies
        faces = state.faces_middle if moves_faces else state.faces
        bodies = state.bodies_middle if moves_bodies else state.bodies
        before = state.bodies_before if moves_bodies else state.bodies
        if not plan.structure.integrator.closing_drift:  # all of the drift is done before the first sweep
            faces, bodies = state.faces, state.bodies
        now, end = state.now, (state.faces, state.bodies)
        stages: dict[str, Callable[[], None]] = {
            "sort": partial(self.sort, now, faces, bodies, before),
            "density": partial(self.sweep_density, now, faces, bodies, *end, now.density_error),
            "force": partial(self.sweep_force, now, *end),
        }
        if moves_faces or moves_bodies:
            stages = {"move": self._move, **stages}
        if plan.kernels.conduct is not None:
            stages["heat"] = self._sweep_heat
        if plan.kernels.shift is not None:
            stages["shift"] = self._shift
        if plan.kernels.emit is not None:
            stages["emit"] = self._emit
        return stages

    def _move(self) -> None:
        """Bring faces and bodies to the middle and the end of the step."""
        plan, state = self.plan, self.state
        if plan.moving_bodies:
            wp.copy(state.bodies_before.position, state.bodies.position)
        for moves, travel, middle, end in (
            (plan.moving_faces, plan.face_travel, state.faces_middle, state.faces),
            (plan.moving_bodies, plan.body_travel, state.bodies_middle, state.bodies),
        ):
            if moves:
                outputs = [*driven_arrays(middle).values(), *driven_arrays(end).values()]
                inputs = [self.constants, travel]
                wp.launch(advance_driven, outputs[0].shape, inputs, outputs, device=state.device)

    def sort(self, particles: ParticleArrays, faces: Any, bodies: Any, bodies_before: Any) -> None:
        """Kick and drift to where the first sweep is, then put the particles in cell order."""
        plan, state = self.plan, self.state
        slots, cells = state.num_worlds * state.capacity, state.num_worlds * plan.grid.stride
        bounds: Any = self.bounds
        bounds.zero_()
        around = [faces, bodies_before, bodies, self.nozzles, self.drains]
        wp.launch(
            plan.kernels.drift,
            dim=slots,
            inputs=[state.capacity, self.constants, plan.grid, *around, particles.acceleration],
            outputs=[particles.position, particles.velocity, particles.identity, state.key, bounds, state.clamped],
            device=state.device,
        )
        wp.utils.array_scan(bounds, bounds, inclusive=True)
        wp.launch(order_by_cell, slots, [state.key, bounds, state.order], device=state.device)
        if state.device.is_cuda:
            wp.launch(settle_order, cells, [plan.grid.stride, bounds, state.order], device=state.device)
        names = ("position", "velocity", "density_error", "identity", "temperature", "acceleration")
        wp.launch(
            plan.kernels.gather,
            dim=slots,
            inputs=[
                *(state.capacity, plan.grid, bounds, state.order),
                *(getattr(particles, name) for name in names),
            ],
            outputs=[state.middle, state.density_error, state.identity, state.temperature, state.spans],
            device=state.device,
        )

    def sweep_density(
        self, particles: ParticleArrays, faces: Any, bodies: Any, faces_end: Any, bodies_end: Any, density_out: wp.array
    ) -> None:
        """The first sweep over pairs, and the closing drift."""
        plan, state = self.plan, self.state
        around = [faces, faces_end, bodies, bodies_end, self.nozzles, self.drains, plan.frozen, plan.frozen_grid]
        wp.launch(
            plan.kernels.advance_density,
            dim=state.num_worlds * state.capacity,
            inputs=[
                *(state.capacity, self.constants, self.gravity, plan.grid, self.bounds),
                *around,
                *(state.middle, state.identity, state.temperature),
            ],
            outputs=[
                particles.position,
                density_out,
                particles.identity,
                state.end,
                state.clamped,
                state.sums,
                state.spans,
            ],
            device=state.device,
        )

    def sweep_force(self, particles: ParticleArrays, faces: Any, bodies: Any) -> None:
        """The second sweep over pairs, and the closing kick."""
        plan, state = self.plan, self.state
        around = [faces, bodies, self.nozzles, self.drains, plan.frozen, plan.frozen_grid]
        wp.launch(
            plan.kernels.kick,
            dim=state.num_worlds * state.capacity,
            inputs=[
                *(state.capacity, self.constants, self.gravity, plan.grid, self.bounds),
                *around,
                *(state.end, particles.identity),
            ],
            outputs=[particles.velocity, particles.acceleration, state.forces, state.sums, state.spans],
            device=state.device,
        )

    def _sweep_heat(self) -> None:
        """The sweep that conducts heat."""
        plan, state = self.plan, self.state
        wp.launch(
            plan.kernels.conduct,
            dim=state.num_worlds * state.capacity,
            inputs=[
                *(state.capacity, self.constants, plan.grid, self.bounds),
                *(state.faces, state.bodies, self.nozzles, self.drains, state.end, state.now.identity),
            ],
            outputs=[state.now.temperature, state.sums, state.spans],
            device=state.device,
        )

    def _shift(self) -> None:
        """Shift the particles, and hold the mean of the density errors where the box is full."""
        plan, state, now = self.plan, self.state, self.state.now
        if plan.structure.leveled:
            state.gain.zero_()
            wp.launch(
                add_up_gain,
                dim=(state.num_worlds, -(-state.capacity // CHUNK)),
                inputs=[state.capacity, state.density_error, now.density_error, now.identity],
                outputs=[state.gain],
                device=state.device,
            )
        wp.launch(
            plan.kernels.shift,
            dim=state.num_worlds * state.capacity,
            inputs=[
                *(state.capacity, self.constants, plan.grid, self.bounds),
                *(state.faces, state.bodies, self.nozzles, self.drains),
                *(state.end, now.identity, state.gain),
            ],
            outputs=[now.density_error, now.position, state.sums, state.spans],
            device=state.device,
        )

    def _emit(self) -> None:
        """Let the nozzles add what is due."""
        state, now = self.state, self.state.now
        wp.launch(
            self.plan.kernels.emit,
            dim=state.num_worlds,
            inputs=[
                *(state.capacity, self.plan.grid.stride, self.constants, self.bounds),
                *(self.nozzles, state.ledger),
            ],
            outputs=[
                *(now.position, now.velocity, now.acceleration),
                *(now.density_error, now.temperature, now.identity),
            ],
            device=state.device,
        )


class Stepper:
    """Takes steps of all worlds: captures the launches once and replays them, on a CPU in several threads."""

    def __init__(self, worlds: Group, threads: int):
        """Set up; nothing is captured yet.

        Args:
            worlds: All worlds.
            threads: Of a CPU, at most.
        """
        self._device = worlds.state.device
        self._graphs: dict[tuple[int, int], Any] = {}
        self._groups = [worlds]
        count, capacity = worlds.state.num_worlds, worlds.state.capacity
        if self._device.is_cpu and count > 1:
            # As many worlds as the cache holds, and groups enough for the threads to share them evenly.
            size = max(1, min(GROUP_PARTICLES // capacity, -(-count // (4 * threads))))
            self._groups = [worlds.part(first, min(size, count - first)) for first in range(0, count, size)]
        self._threads = min(threads, len(self._groups))

    def step(self, n: int) -> None:
        """Go on by n steps."""
        if self._device.is_cuda:
            for first in range(0, n, STEPS_PER_GRAPH):
                wp.capture_launch(self._graph(0, min(STEPS_PER_GRAPH, n - first)))
            return

        def advance(task: tuple[Any, int]) -> tuple[Any, int] | None:
            graph, left = task
            now = min(left, STEPS_PER_TURN) if self._threads > 1 else left
            for _ in range(now):
                wp.capture_launch(graph)
            return (graph, left - now) if left > now else None

        share(advance, [(self._graph(index, 1), n) for index in range(len(self._groups))], self._threads)

    def _graph(self, index: int, n: int) -> Any:
        """The captured launches of n steps of a group."""
        if (index, n) not in self._graphs:
            with wp.ScopedDevice(self._device):
                wp.load_module(advance_driven.module, device=self._device)
                wp.load_module(order_by_cell.module, device=self._device)
                with wp.ScopedCapture(device=self._device) as capture:
                    self._groups[index].launch(n)
                self._graphs[index, n] = capture.graph
        return self._graphs[index, n]


_crew: ThreadPoolExecutor | None = None
_lock = threading.Lock()


def _forget_crew() -> None:
    """Threads do not live on in a forked process."""
    global _crew, _lock
    _crew, _lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_crew)


def processors() -> int:
    """How many threads this process may run at a time."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def share(work: Callable[[Any], Any], items: Sequence[Any], threads: int) -> None:
    """Do some work on each item, in several threads, this one among them; the first error is raised here.

    Args:
        work: What is done. If it gives an item back, that is to be done later.
        items: On what.
        threads: How many.
    """
    waiting = deque(items)

    def take() -> None:
        while True:
            try:
                item = waiting.popleft()
            except IndexError:
                return
            rest = work(item)
            if rest is not None:
                waiting.append(rest)

    if threads <= 1:
        take()
        return
    global _crew
    with _lock:
        if _crew is None:
            _crew = ThreadPoolExecutor(max(processors(), 1), thread_name_prefix="fluidgym")
        crew = _crew
    others = [crew.submit(take) for _ in range(threads - 1)]
    try:
        take()
    except BaseException:  # an interrupt, too: what nobody has begun is not begun
        waiting.clear()
        raise
    finally:
        for other in others:
            other.result()
