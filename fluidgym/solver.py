"""The solver: one scene, one scheme, any number of worlds; compiles just what they need."""

from __future__ import annotations

import math
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from fluidgym.compilation import Replay
from fluidgym.controls import Control, Controls
from fluidgym.layout import (
    Parameters,
    body_halves,
    body_middles,
    body_travel,
    check_box,
    equip_bodies,
    held_density,
    make_drains,
    make_frozen,
    make_nozzles,
    make_structure,
    with_sound_speed,
)
from fluidgym.scene import AXES, Particles, Scene, face_names, pipe_frame
from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.sph.constants import Constants
from fluidgym.sph.integrate import aim, make_step, shift_acceleration
from fluidgym.sph.neighbors import make_grid, span_numbers
from fluidgym.state import Frozen, ParticleArrays, State, driven_arrays
from fluidgym.stepping import Group, Plan, Stepper, processors

_CONSTANTS: Any = Constants  # Warp structs: to a type checker no classes
_FROZEN: Any = Frozen


@dataclass(frozen=True)
class Account:
    """Where the particles of a world have come from and gone to since its reset.

    Attributes:
        started: At the reset.
        emitted: By nozzles.
        retired: Through open faces and outflows.
        live: Now; always started + emitted - retired.
        refused: How often a row of a nozzle had to wait, in steps, because the reserve was used up.
    """

    started: int
    emitted: int
    retired: int
    live: int
    refused: int


def find_device(name: str | None) -> wp.Device:
    """The Warp device of that name; None takes the first CUDA device, or the CPU where there is none.

    Raises:
        ValueError: There is no such device on this machine.
    """
    _quieten_warp()
    wp.init()
    if name is None:
        return wp.get_preferred_device()
    known = [str(device) for device in wp.get_devices()]
    if name == "cuda" and wp.is_cuda_available():
        return wp.get_device("cuda")
    if name not in known:
        raise ValueError(f"Solver.device = {name!r} is not on this machine; use {' or '.join(map(repr, known))}")
    return wp.get_device(name)


def memory_of(device: wp.Device) -> int:
    """What a device has in all [bytes]; of a CPU, the machine's, where the system says."""
    if not device.is_cpu:
        return int(device.total_memory)
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return sys.maxsize


def _quieten_warp() -> None:
    """Keep Warp's banner and its notes on modules loaded from the terminal, unless the user chose a log level."""
    if wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_WARNING


def _check_count(name: str, value: object) -> None:
    if not isinstance(value, (int, np.integer)):
        raise ValueError(f"Solver.{name} = {value!r} must be a whole number; use 1 or more")
    if value < 1:
        raise ValueError(f"Solver.{name} = {value} is below the limit 1; use 1 or more")


# Speed that a face or body may have, over that of sound: to and fro at 0.7 is still borne, at 0.8 not.
FASTEST_WALL = 0.5

# A particle takes at least so much of the device [bytes], by dimension.
BYTES = {2: 170, 3: 230}


class Solver:
    """Weakly compressible SPH of a scene, in many worlds at once.

    Attributes:
        scene: What is simulated, with the speed of sound of the scheme where its material names none.
        scheme: How.
        num_worlds: Number of worlds.
        capacity: Particles that a world has room for.
        device: The Warp device.
        threads: Threads of a CPU that share the worlds, at most.
        max_step: Time step of the scheme's courant number [s], that of the most demanding world.
        time: Simulated time of each world since its reset [s], (world,).
        started: Number of particles of each world at its reset, (world,).

    Example:
        >>> solver = Solver(scene)
        >>> solver.advance(0.5)
        >>> solver.particles().position  # (particle, dim) [m]
    """

    gravity = Control("Acceleration [m/s2], (world, dim).")
    face_velocity = Control(
        "Velocity of each face along its normal axis at the end of the next call of step or advance [m/s], (world,"
        " face). A face gets there at a constant acceleration."
    )
    body_velocity = Control("Velocity of each body at the end of the next call [m/s], (world, body, dim); likewise.")
    inflow_speed = Control("Mean speed of each nozzle [m/s], (world, inflow).")
    inflow_center = Control("Middle of the back of each nozzle's pipe [m], (world, inflow, dim).")
    inflow_direction = Control("Along which the fluid leaves, of any length above 0, (world, inflow, dim).")
    inflow_width = Control("Width of each nozzle [m], from a particle spacing to the scene's, (world, inflow).")

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme = DEFAULT_SCHEME,
        num_worlds: int = 1,
        device: str | None = None,
        plain_loops: bool = False,
        report_forces: bool = False,
        threads: int | None = None,
    ):
        """Set up the worlds and put them at their start.

        Args:
            scene: What is simulated; every world starts as this.
            scheme: How it is simulated.
            num_worlds: Number of worlds.
            device: "cpu", "cuda", "cuda:1", ...; None takes a GPU where there is one.
            plain_loops: Run the plain-Warp twin of the pair loop: slow, for tests.
            report_forces: Add up the forces on faces and bodies, for `face_force` and `body_force`.
            threads: How many threads of a CPU share the worlds, at most; None is as many as there are processors. What
                a world does does not depend on it. A GPU needs none.

        Raises:
            ValueError: The device or a count is out of its limits, or the scheme cannot do what the scene asks.
            MemoryError: The worlds need more memory than the device has.
        """
        if not isinstance(scene, Scene):
            raise ValueError(f"Solver.scene = {scene!r} is not a Scene; make one with Scene(...)")
        if not isinstance(scheme, Scheme):
            raise ValueError(f"Solver.scheme = {scheme!r} is not a Scheme; make one with Scheme(...) or leave it out")
        _check_count("num_worlds", num_worlds)
        _check_count("threads", processors() if threads is None else threads)
        self.threads = processors() if threads is None else int(threads)
        scene = with_sound_speed(scene, scheme)
        self.scene, self.scheme, self.num_worlds = scene, scheme, num_worlds
        self.device = find_device(device)
        half = self.device.is_cpu and not plain_loops
        self._flags = {"forces": report_forces, "plain": plain_loops, "half": half}
        self._check_room(int(sum(map(scene.lattice_count, scene.fluid))))
        start = scene.sample()
        self.capacity = max(len(start) + (scene.reserve or 0), 1)
        self._check_room(num_worlds * self.capacity)
        self._parameters = Parameters(scene, scheme, num_worlds)
        check_box(scene, scheme)
        self._numbers = self._parameters.constants()
        self.max_step = self._parameters.max_step()
        self._stepper: Stepper | None = None
        self._replay_aim = Replay(self.device)
        self._build_kernels()
        try:
            self._make_arrays()
        except (MemoryError, RuntimeError) as error:
            if isinstance(error, RuntimeError) and "allocate" not in str(error):
                raise
            raise self._no_room(num_worlds * self.capacity) from None
        self._step_size = self.max_step
        self._write_constants()
        self.controls = Controls(scene, num_worlds)
        self._given_gravity: np.ndarray | None = None  # what the device has, if it is known
        self._felt_gravity = self.gravity.copy()  # what the accelerations at hand were found with
        self.time = np.zeros(num_worlds)
        self.started = np.zeros(num_worlds, int)
        self._start_counts = np.zeros(num_worlds, int)
        self._force_steps = 0  # over which the forces at hand were added up
        self._warned_of_reserve = False
        self._face_starts = scene.face_start_positions()
        self._place_driven()
        self.set_start(range(num_worlds), [start] * num_worlds)
        self.reset()

    def _check_room(self, particles: int) -> None:
        """Refuse particles that memory cannot hold, before a system that runs out of it ends the process.

        Raises:
            MemoryError: It cannot.
        """
        if particles * BYTES[self.scene.dim] > memory_of(self.device):
            raise self._no_room(particles)

    def _no_room(self, particles: int) -> MemoryError:
        need, has = (size / 1e9 for size in (particles * BYTES[self.scene.dim], memory_of(self.device)))
        return MemoryError(
            f"Solver.num_worlds = {self.num_worlds}: {particles:.4g} particles in all need {need:.3g} GB or more, limit"
            f" {has:.3g} GB on {self.device}, less what others use; use fewer worlds or a larger particle_spacing"
        )

    def _build_kernels(self) -> None:
        """Compile what the scene, the scheme and the parameters of now need."""
        scene = self.scene
        self._structure = make_structure(scene, self.scheme, self._parameters, **self._flags)
        self._kernels = make_step(self._structure)
        self._moving_faces = any(face.moving for face in scene.faces.values())
        self._moving_bodies = any(body.moving for body in scene.bodies.values())
        self._stepper = None

    def _make_arrays(self) -> None:
        """Allocate the device arrays."""
        scene, dim, device, worlds = self.scene, self.scene.dim, self.device, self.num_worlds
        numbers, structure = self._numbers, self._structure
        search = numbers["support"] + numbers["skin"]
        self._grid: Any = make_grid(np.asarray(scene.lower), np.asarray(scene.upper), search, self.capacity)
        self._nozzles = make_nozzles(scene, worlds, device)
        self._drains = make_drains(scene, self.scheme, self._parameters, device)
        self._frozen, self._frozen_grid = _FROZEN(), self._grid
        if structure.frozen:
            self._frozen, self._frozen_grid = make_frozen(scene, self.scheme, device)
        self.state = State(
            dim,
            worlds,
            self.capacity,
            device,
            half=body_halves(scene),
            rows=self._nozzles.row_inflow.shape[0] if scene.inflows else 0,
            heat=structure.heat,
            forces=structure.forces,
            leveled=structure.leveled,
            spans=span_numbers(dim) if structure.half else 0,
        )
        self.state.set_widths(structure.middle_width, structure.end_width)
        self._bounds = wp.zeros(worlds * self._grid.stride + 2, dtype=int, device=device)
        self._face_travel = wp.array(scene.face_travel(), dtype=float, device=device)
        self._body_travel = wp.array(body_travel(scene), dtype=float, device=device)
        self._constants = wp.zeros(worlds, dtype=_CONSTANTS, device=device)
        self._constants_at_rest = wp.zeros(worlds, dtype=_CONSTANTS, device=device)
        self._gravity = wp.zeros((worlds, dim), dtype=float, device=device)
        self._gravity_change = wp.zeros((worlds, dim), dtype=float, device=device)
        self._face_target = wp.zeros((worlds, 2 * dim), dtype=float, device=device)
        self._body_target = wp.zeros((worlds, len(scene.bodies) * dim), dtype=float, device=device)

    def _place_driven(self) -> None:
        """Put faces and bodies at their start."""
        scene, state, worlds = self.scene, self.state, self.num_worlds
        names = face_names(scene.dim)
        sliding = [scene.faces[name].sliding or (0.0,) * scene.dim for name in names]
        warmth = [scene.faces[name].temperature or 0.0 for name in names]
        for faces in (state.faces, state.faces_middle, state.faces_start):
            faces.position.assign(np.tile(self._face_starts, (worlds, 1)))
            faces.sliding.assign(np.tile(np.asarray(sliding), (worlds, 1, 1)))
            faces.temperature = wp.array(warmth, dtype=float, device=self.device)
        for bodies in (state.bodies, state.bodies_middle, state.bodies_before, state.bodies_start):
            equip_bodies(bodies, scene, self._structure, self.device)
            if scene.bodies:
                bodies.position.assign(np.tile(body_middles(scene), (worlds, 1, 1)))

    def _write_constants(self) -> None:
        """Hand the constants to the device."""
        for array, dt in ((self._constants, self._step_size), (self._constants_at_rest, 0.0)):
            record: Any = np.zeros(self.num_worlds, dtype=_CONSTANTS.numpy_dtype())
            for name, value in self._numbers.items():
                record[name] = value
            record["dt"] = dt
            if not dt:
                record["damping"] = 0.0  # the accelerations that the rate of the density leans on are not known yet
            array.assign(record)

    def set_parameters(self, **changes: Any) -> None:
        """Change numbers of the scene or the scheme from the next step on, in all worlds or in each.

        What is on goes on; what was left out of the kernels because it was 0 everywhere, and now is not, is compiled
        once. Pressure stays as it is under another speed of sound. `max_step` follows.

        Args:
            changes: viscosity [m2/s], sound_speed [m/s], thermal_diffusivity [m2/s], central_force [1/s2], gamma,
                density_diffusion, artificial_viscosity, acoustic_damping, and of the walls of the scheme wall_stiffness
                [(c_0/h)^2], wall_margin [spacings] and wall_damping: one number, or one for each world (world,).

        Raises:
            ValueError: A name is unknown or a value out of its limits; nothing has happened then.
        """
        if "thermal_diffusivity" in changes and not self._structure.heat:
            raise ValueError(
                "Solver.set_parameters thermal_diffusivity is of no effect in a scene that keeps no temperatures;"
                " set Material.thermal_diffusivity above 0"
            )
        before = self.parameter("sound_speed"), self.parameter("gamma")
        self._parameters.change(changes)
        self._numbers, self.max_step = self._parameters.constants(), self._parameters.max_step()
        self._step_size = min(self._step_size, self.max_step)
        self._write_constants()
        if self.scene.outflows:
            self._drains.field.assign(held_density(self.scene, self.scheme, self._parameters))
        if make_structure(self.scene, self.scheme, self._parameters, **self._flags) != self._structure:
            self._build_kernels()
            self.state.set_widths(self._structure.middle_width, self._structure.end_width)
        self._keep_pressure(*before)

    def _keep_pressure(self, c_0: np.ndarray, gamma: np.ndarray) -> None:
        """Turn density errors, now and at the start, into those of the same pressure; given the values before."""
        now, exponent = self._parameters.values["sound_speed"], self._parameters.values["gamma"]
        if self._structure.summed or ((c_0 == now) & (gamma == exponent)).all():
            return
        law, slots = self.scheme.state_equation, self.num_worlds * self.capacity
        for particles in (self.state.now, self.state.start):
            s = particles.density_error.numpy()
            rows = s[:slots].reshape(self.num_worlds, -1).astype(float)
            reduced = law.pressure_of(rows, gamma[:, None]) * ((c_0 / now) ** 2)[:, None]
            s[:slots] = law.density_of(reduced, exponent[:, None]).ravel()
            particles.density_error.assign(s)

    def parameter(self, name: str) -> np.ndarray:
        """A number that `set_parameters` can change, as it is in each world, (world,).

        Raises:
            ValueError: There is none of that name.
        """
        values = self._parameters.values
        if name not in values:
            raise ValueError(f"Solver.parameter {name!r} is unknown; use {', '.join(values)}")
        return values[name].copy()

    # -- the start -----------------------------------------------------------------------------------------------

    def set_start(self, worlds: Sequence[int], starts: Sequence[Particles]) -> None:
        """Give worlds another start; it is used from their next reset on.

        Args:
            worlds: Numbers of the worlds.
            starts: The particles of each: at most `capacity`; position, velocity, pressure and temperature count.

        Raises:
            ValueError: A start is not finite, has too many particles, or one outside the box.
        """
        numbers = np.asarray(worlds, int).reshape(-1)
        wrong = numbers[(numbers < 0) | (numbers >= self.num_worlds)]
        if len(wrong) or len(numbers) != len(starts):
            raise ValueError(
                f"Solver.set_start worlds = {numbers.tolist()} for {len(starts)} starts; give each start"
                f" one world of 0 to {self.num_worlds - 1}"
            )
        if not len(numbers):
            return
        batch = ParticleArrays(self.scene.dim, len(numbers) * self.capacity, self.device, heat=self._structure.heat)
        host = {name: np.zeros(array.shape, array.numpy().dtype) for name, array in batch.arrays().items()}
        for index, start in enumerate(starts):
            s = self._start_density_error(start, numbers[index])
            slots = slice(index * self.capacity, index * self.capacity + len(start))
            host["position"][:, slots], host["velocity"][:, slots] = start.position.T, start.velocity.T
            host["density_error"][slots] = s
            if start.temperature is not None and self._structure.heat:
                host["temperature"][slots] = start.temperature
            places = np.arange(self.capacity)
            identity = np.where(places < len(start), places, -1 - places)
            host["identity"][index * self.capacity : (index + 1) * self.capacity] = identity
        for name, array in batch.arrays().items():
            array.assign(host[name])
        self._prime(batch, numbers)
        self.state.set_start(numbers, batch)
        self._start_counts[numbers] = [len(start) for start in starts]

    def _start_density_error(self, start: Particles, world: int) -> np.ndarray:
        """rho/rho_0 - 1 of the particles of a start (n,), all of it checked."""
        n, scene = len(start), self.scene
        if n > self.capacity:
            raise ValueError(f"start has {n} particles, limit {self.capacity}; make the solver with a larger scene")
        checked = [
            ("position", start.position, (n, scene.dim)),
            ("velocity", start.velocity, (n, scene.dim)),
            ("pressure", start.pressure, (n,)),
        ]
        if start.temperature is not None:
            checked.append(("temperature", start.temperature, (n,)))
        for name, values, shape in checked:
            if values.shape != shape:
                raise ValueError(f"start of world {world}: {name} has shape {values.shape}, limit {shape}; mend it")
            if not np.isfinite(values).all():
                raise ValueError(f"start of world {world}: {name} is not finite; give numbers")
        faces = self._face_starts.reshape(-1, 2)
        outside = (start.position < faces[:, 0]) | (start.position > faces[:, 1])
        if outside.any():
            particle, axis = np.argwhere(outside)[0]
            raise ValueError(
                f"start of world {world}: particle {particle} at {AXES[axis]} = {start.position[particle, axis]:g} m is"
                f" outside the box {faces[axis, 0]:g} to {faces[axis, 1]:g} m; move it inside"
            )
        c_0, gamma = self._parameters.values["sound_speed"][world], self._parameters.values["gamma"][world]
        with np.errstate(invalid="ignore"):
            s = self.scheme.state_equation.density_of(start.pressure / (scene.material.density * c_0**2), gamma)
        if not (np.isfinite(s) & (s > -1.0)).all():
            raise ValueError(
                f"start of world {world}: pressure {start.pressure.min():g} Pa is below what"
                f" {self.scheme.state_equation.name} can hold at a sound speed of {c_0:g} m/s; raise it"
            )
        return s

    def _prime(self, batch: ParticleArrays, numbers: np.ndarray) -> None:
        """Put starts in cell order and find their accelerations, as a step of no time does.

        Every world has the same faces, bodies, nozzles and gravity at its start, so the first ones stand for any.
        """
        count = len(numbers)
        at_rest = wp.array(self._constants_at_rest.numpy()[numbers], dtype=_CONSTANTS, device=self.device)
        state = self.state
        self._gravity.assign(np.tile(self.scene.gravity_vector, (self.num_worlds, 1)))
        self._given_gravity = None
        self._write_nozzles(Controls(self.scene, self.num_worlds))
        moving = (state.faces_start, state.bodies_start, state.faces_start, state.bodies_start)
        few = self._worlds().part(0, count, self._bounds[: count * self._grid.stride + 2])
        few = replace(few, constants=at_rest)
        few.state.clamped = wp.zeros_like(few.state.clamped)  # that of these worlds counts on
        few.sort(batch, *moving[:2], state.bodies_start)
        # The spray rule must not touch the density of a start, so what the sweep makes of it goes to scratch; unless
        # density is a sum, which is what the start should have.
        scratch = batch.density_error if self._structure.summed else wp.zeros_like(batch.density_error)
        forces = wp.clone(state.forces)  # those of the last call stay to be read
        few.sweep_density(batch, *moving, density_out=scratch)
        few.sweep_force(batch, *moving[2:])
        wp.copy(state.forces, forces)
        slots = count * self.capacity
        if not self._structure.summed:
            wp.copy(batch.density_error, state.density_error, count=slots)
        if self._structure.heat:
            wp.copy(batch.temperature, state.temperature, count=slots)

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Put worlds back to their start, faces and bodies at rest, the scene's gravity on, nozzles as in the scene.

        Args:
            mask: Which worlds, bool (world,); None is all.

        Raises:
            ValueError: The mask has another shape.
        """
        mask = np.ones(self.num_worlds, bool) if mask is None else np.asarray(mask)
        if mask.dtype != bool:
            raise ValueError(f"Solver.reset mask has type {mask.dtype}, limit bool; give one bool a world")
        if mask.shape != (self.num_worlds,):
            raise ValueError(f"Solver.reset mask has shape {mask.shape}, limit ({self.num_worlds},); one bool a world")
        if mask.any():
            self.state.reset(np.flatnonzero(mask), self._start_counts, 0.5 * self.scene.particle_spacing)
        self.time[mask] = 0.0
        self.started[mask] = self._start_counts[mask]
        self.controls.reset(mask)
        self._felt_gravity[mask] = self.scene.gravity_vector

    # -- stepping ------------------------------------------------------------------------------------------------

    def advance(self, duration: float) -> None:
        """Go on by a duration [s], in equal steps no longer than `max_step`."""
        n = self.steps_for(duration)
        self.step(n, duration / n)

    def steps_for(self, duration: float) -> int:
        """Number of equal steps in which `advance` goes on by a duration [s].

        Raises:
            ValueError: The duration is not a positive number.
        """
        if not (isinstance(duration, (int, float, np.number)) and math.isfinite(duration) and duration > 0.0):
            raise ValueError(f"Solver.advance duration = {duration!r} s must be positive and finite; use 0.01 or so")
        return max(1, math.ceil(duration / self.max_step - 1e-9))

    def step(self, n: int = 1, dt: float | None = None) -> None:
        """Go on by n steps of dt [s]; None is `max_step`.

        Raises:
            ValueError: n is below one, dt longer than 1.5 times `max_step`, where the scheme is no longer stable, or a
                control is out of its limits; nothing has happened then.
        """
        _check_count("step n", n)
        dt = self.max_step if dt is None else dt
        if not 0.0 < dt <= 1.5 * self.max_step:
            raise ValueError(f"Solver.step dt = {dt:g} s is outside 0 to {1.5 * self.max_step:g} s; use max_step")
        # A body force sets a limit to the step, and so the step one to the force: 0.5 sqrt(h/g).
        self.controls.check(
            strongest=0.25 * self._numbers["h"] / dt**2, fastest=FASTEST_WALL * float(self._numbers["c_0"].min())
        )
        if dt != self._step_size:
            self._step_size = dt
            self._write_constants()
        self._apply_gravity()
        self._aim(n * dt)
        self._write_nozzles(self.controls)
        if self._structure.forces:
            self.state.forces.zero_()
        self._force_steps = n
        if self._stepper is None:
            self._stepper = Stepper(self._worlds(), self.threads)
        self._stepper.step(n)
        self.time += n * dt
        self._watch_reserve()

    @property
    def memory(self) -> int:
        """What the arrays of all worlds take on the device [bytes]."""
        return sum(a.size * wp.types.type_size_in_bytes(a.dtype) for a in self.arrays().values() if a is not None)

    def arrays(self) -> dict[str, wp.array | None]:
        """All arrays on the device, by name; None is one that the scene has no use for and that was never made."""
        found: dict[str, wp.array | None] = {}

        def look(name: str, value: Any, inside: bool = False) -> None:
            if isinstance(value, wp.array) or (inside and value is None):
                found[name] = value
            elif isinstance(value, State | ParticleArrays) or type(value).__name__ == "NewStructInstance":
                for field, part in vars(value).items():
                    if not field.startswith("_"):
                        look(f"{name}.{field}", part, inside=True)

        for name, value in vars(self).items():
            look(name, value)
        return found

    def _worlds(self) -> Group:
        """All worlds, as a step sees them."""
        plan = Plan(
            self._structure,
            self._kernels,
            self._grid,
            self._frozen,
            self._frozen_grid,
            self._face_travel,
            self._body_travel,
            self._moving_faces,
            self._moving_bodies,
        )
        return Group(plan, self.state, self._constants, self._gravity, self._bounds, self._nozzles, self._drains)

    def _aim(self, duration: float) -> None:
        """Give the moving faces and bodies the accelerations that bring them to their velocities in a duration [s]."""
        driven = [
            (target, velocity, moved)
            for moves, target, velocity, moved in (
                (self._moving_faces, self._face_target, self.face_velocity, self.state.faces),
                (self._moving_bodies, self._body_target, self.body_velocity, self.state.bodies),
            )
            if moves
        ]

        def launch() -> None:
            for target, _, moved in driven:
                arrays = driven_arrays(moved)
                inputs = [duration, target, arrays["velocity"]]
                wp.launch(aim, target.shape, inputs, [arrays["acceleration"]], device=self.device)

        for target, velocity, _ in driven:
            if self.device.is_cpu:
                target.numpy()[...] = velocity.reshape(target.shape)  # what assign does takes 40 us
            else:
                target.assign(velocity.reshape(target.shape))
        if driven:
            self._replay_aim(launch, duration)

    def _write_nozzles(self, controls: Controls) -> None:
        """Hand place, direction, width and speed of the nozzles to the device."""
        if not self.scene.inflows:
            return
        nozzles = self._nozzles
        nozzles.center.assign(controls["inflow_center"])
        nozzles.speed.assign(controls["inflow_speed"])
        directions = controls["inflow_direction"]
        frames = [[pipe_frame(direction) for direction in world] for world in directions]
        nozzles.frame.assign(np.array(frames))
        half = np.zeros(nozzles.half.shape)
        for index, inflow in enumerate(self.scene.inflows.values()):
            half[:, index] = 0.5 * (inflow.height or inflow.width)
            # A round pipe is as high as it is wide.
            wide = slice(None) if inflow.height is None else slice(1)
            half[:, index, wide] = 0.5 * controls["inflow_width"][:, index, None]
        nozzles.half.assign(half)

    def _watch_reserve(self) -> None:
        """Say once that a nozzle has stopped for want of particles."""
        if not self.scene.inflows or self._warned_of_reserve:
            return
        refused = np.flatnonzero(self.state.ledger.refused.numpy())
        if len(refused):
            self._warned_of_reserve = True
            warnings.warn(
                f"Scene.reserve = {self.scene.reserve} particles are used up in world {refused[0]}: its nozzles wait"
                " until particles are retired; raise Scene.reserve, or let fluid out",
                RuntimeWarning,
                stacklevel=3,
            )

    def _apply_gravity(self) -> None:
        """Hand the gravity to the device, and mend the accelerations at hand, which begin the next step."""
        if self._given_gravity is None or (self.gravity != self._given_gravity).any():
            self._given_gravity = self.gravity.copy()
            self._gravity.assign(self.gravity)
        change = self.gravity - self._felt_gravity
        if not change.any():
            return
        self._gravity_change.assign(change)
        inputs = [self.capacity, self._gravity_change]
        wp.launch(
            shift_acceleration,
            self.num_worlds * self.capacity,
            inputs,
            [self.state.now.acceleration],
            device=self.device,
        )
        self._felt_gravity[...] = self.gravity

    # -- what there is to read -----------------------------------------------------------------------------------

    def particles(self, world: int = 0) -> Particles:
        """The particles of a world that are still in the box, in order of identity.

        Raises:
            IndexError: There is no such world.
        """
        if not 0 <= world < self.num_worlds:
            raise IndexError(f"Solver.particles world = {world} is outside 0 to {self.num_worlds - 1}")
        slots = slice(world * self.capacity, (world + 1) * self.capacity)
        now = self.state.now
        identity = now.identity.numpy()[slots]
        order = np.argsort(identity, kind="stable")
        order = order[identity[order] >= 0]
        s = now.density_error.numpy()[slots][order].astype(float)
        material, law = self.scene.material, self.scheme.pressure_law
        c_0, gamma = self._parameters.values["sound_speed"][world], self._parameters.values["gamma"][world]
        pressure = material.density * c_0**2 * law.pressure_of(s, gamma)
        heat = self._structure.heat
        return Particles(
            position=now.position.numpy()[:, slots].T[order],
            velocity=now.velocity.numpy()[:, slots].T[order],
            density=material.density * (1.0 + s),
            pressure=pressure,
            identity=identity[order],
            temperature=now.temperature.numpy()[slots][order] if heat else None,
        )

    def face_position(self, name: str) -> np.ndarray:
        """Where a face is along its normal [m], (world,)."""
        return self.state.faces.position.numpy()[:, self.face_index(name)].copy()

    def face_index(self, name: str) -> int:
        """Number of a face in the control arrays.

        Raises:
            ValueError: There is no such face.
        """
        names = face_names(self.scene.dim)
        if name not in names:
            raise ValueError(f"face {name!r} is unknown; use {', '.join(names)}")
        return names.index(name)

    def body_position(self, name: str) -> np.ndarray:
        """Where the middle of a body is [m], (world, dim)."""
        return self.state.bodies.position.numpy()[:, self.body_index(name)].copy()

    def body_index(self, name: str) -> int:
        """Number of a body in the control arrays.

        Raises:
            ValueError: There is no such body.
        """
        return _index("body", name, tuple(self.scene.bodies))

    def inflow_index(self, name: str) -> int:
        """Number of a nozzle in the control arrays.

        Raises:
            ValueError: There is no such nozzle.
        """
        return _index("inflow", name, tuple(self.scene.inflows))

    @property
    def face_force(self) -> np.ndarray:
        """Mean force of the fluid on each face over the last call of step or advance [N], (world, face, dim).

        In two dimensions per metre of depth. Only faces that show the fluid its image bear any.

        Raises:
            RuntimeError: The solver was made without report_forces.
        """
        return self._mean_forces()[:, : 2 * self.scene.dim]

    @property
    def body_force(self) -> np.ndarray:
        """Mean force of the fluid on each body over the last call of step or advance [N], (world, body, dim).

        Raises:
            RuntimeError: The solver was made without report_forces.
        """
        return self._mean_forces()[:, 2 * self.scene.dim :]

    def _mean_forces(self) -> np.ndarray:
        if not self._structure.forces:
            raise RuntimeError("Solver.face_force and body_force are not added up; make the Solver(report_forces=True)")
        unit = np.broadcast_to(self._numbers["force_unit"], (self.num_worlds,))[:, None, None]
        mean = -self.scene.particle_mass / max(self._force_steps, 1) * self.state.forces.numpy() / unit
        return mean - self._level_forces() if self._structure.leveled else mean

    def _level_forces(self) -> np.ndarray:
        """Force on each face of the pressure that shifting adds [N], (world, face, dim); none on periodic ones."""
        scene, dim = self.scene, self.scene.dim
        level, c_0 = (np.broadcast_to(self._numbers[name], (self.num_worlds,)) for name in ("level", "c_0"))
        sides = np.subtract(scene.upper, scene.lower)
        forces = np.zeros((self.num_worlds, 2 * dim, dim))
        for index, face in enumerate(scene.faces.values()):
            if face.kind == "wall":
                axis, side = divmod(index, 2)
                area = float(np.prod(np.delete(sides, axis)))
                forces[:, index, axis] = (2 * side - 1) * scene.material.density * c_0**2 * level * area
        return forces

    def account(self, world: int = 0) -> Account:
        """The particles of a world, as a ledger that is always exact.

        Raises:
            IndexError: There is no such world.
        """
        if not 0 <= world < self.num_worlds:
            raise IndexError(f"Solver.account world = {world} is outside 0 to {self.num_worlds - 1}")
        slots = slice(world * self.capacity, (world + 1) * self.capacity)
        live = int((self.state.now.identity.numpy()[slots] >= 0).sum())
        emitted = refused = 0
        if self.scene.inflows:
            emitted = int(self.state.ledger.emitted.numpy()[world])
            refused = int(self.state.ledger.refused.numpy()[world])
        started = int(self.started[world])
        return Account(started, emitted, started + emitted - live, live, refused)

    def save(self) -> dict[str, np.ndarray]:
        """All that the future of the worlds depends on until they are reset, controls included, as NumPy arrays."""
        return self.state.snapshot() | {
            "time": self.time.copy(),
            "started": self.started.copy(),
            "gravity_felt": self._felt_gravity.copy(),
            **{f"{name}_control": self.controls[name].copy() for name in self.controls.names()},
            **{f"parameter_{name}": values.copy() for name, values in self._parameters.values.items()},
        }

    def restore(self, saved: Mapping[str, np.ndarray]) -> None:
        """Put back what `save` gave, of a solver with the same scene, scheme and number of worlds.

        Raises:
            ValueError: Something is missing or has another shape; nothing has happened then.
        """
        for name, array in self.save().items():
            shape = np.shape(saved[name]) if name in saved else None
            if shape != array.shape:
                raise ValueError(
                    f"Solver.restore {name} has shape {shape}, limit {array.shape};"
                    " restore into a solver of the same scene and number of worlds"
                )
        self.set_parameters(**self._changed_parameters(saved))
        self.state.restore(dict(saved))
        self.time, self.started = saved["time"].copy(), saved["started"].copy()
        for name in self.controls.names():
            self.controls.set(name, saved[f"{name}_control"])
        self._felt_gravity = saved["gravity_felt"].copy()

    def save_world(self, world: int) -> dict[str, np.ndarray]:
        """What `save` gives, of one world.

        Raises:
            IndexError: There is no such world.
        """
        self._check_world("save_world", world)
        return {name: self._by_world(name, array)[world].copy() for name, array in self.save().items()}

    def restore_world(self, world: int, saved: Mapping[str, np.ndarray]) -> None:
        """Put one world back to what `save_world` gave, of any world of a solver with the same scene and scheme.

        Raises:
            IndexError: There is no such world.
            ValueError: Something is missing or has another shape; nothing has happened then.
        """
        self._check_world("restore_world", world)
        every = self.save()
        for name, array in every.items():
            worlds = self._by_world(name, array)
            shape = np.shape(saved[name]) if name in saved else None
            if shape != worlds.shape[1:]:
                raise ValueError(
                    f"Solver.restore_world {name} has shape {shape}, limit {worlds.shape[1:]};"
                    " restore into a solver of the same scene"
                )
            worlds[world] = saved[name]
        self.restore(every)

    def _check_world(self, call: str, world: int) -> None:
        if not 0 <= world < self.num_worlds:
            raise IndexError(f"Solver.{call} world = {world} is outside 0 to {self.num_worlds - 1}")

    def _by_world(self, name: str, array: np.ndarray) -> np.ndarray:
        """A view of what `save` gives with the world first: particles are (dim, slot) or (slot,) there."""
        if name not in self.state.now.arrays():
            return array
        return np.moveaxis(array.reshape(*array.shape[:-1], self.num_worlds, -1), -2, 0)

    def _changed_parameters(self, saved: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The parameters of `save` that differ from those of now."""
        pairs = {name: saved[f"parameter_{name}"] for name in self._parameters.values}
        return {name: value for name, value in pairs.items() if (value != self._parameters.values[name]).any()}


def _index(kind: str, name: str, names: tuple[str, ...]) -> int:
    if name not in names:
        raise ValueError(f"{kind} {name!r} is unknown; use {', '.join(names) or 'a scene that has one'}")
    return names.index(name)
