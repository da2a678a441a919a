"""The solver: one scene, one scheme, any number of worlds; compiles just what they need."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp

from fluidgym.controls import Controls
from fluidgym.scene import AXES, Particles, Scene, face_names
from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.sph.constants import Constants
from fluidgym.sph.integrate import advance_faces, aim_faces, make_step, shift_acceleration
from fluidgym.sph.neighbors import make_gather, make_grid, order_by_cell, settle_order
from fluidgym.state import ParticleArrays, State

_CONSTANTS: Any = Constants  # a Warp struct: to a type checker no class

# How far a pair may approach in half a step, over h, and still be seen in the second sweep.
SKIN = 0.1

# Launches are captured once and replayed, for this many steps at most.
STEPS_PER_GRAPH = 64


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


def _quieten_warp() -> None:
    """Keep Warp's banner and its notes on modules loaded from the terminal, unless the user chose a log level."""
    if wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_WARNING


def _check_count(name: str, value: object) -> None:
    if not isinstance(value, (int, np.integer)):
        raise ValueError(f"Solver.{name} = {value!r} must be a whole number; use 1 or more")
    if value < 1:
        raise ValueError(f"Solver.{name} = {value} is below the limit 1; use 1 or more")


class Solver:
    """Weakly compressible SPH of a scene, in many worlds at once.

    Attributes:
        scene: What is simulated.
        scheme: How.
        num_worlds: Number of worlds.
        capacity: Particles of each world.
        device: The Warp device.
        max_step: Time step of the scheme's courant number [s].
        time: Simulated time of each world since its reset [s], (world,).
        started: Number of particles of each world at its reset, (world,).

    Example:
        >>> solver = Solver(scene)
        >>> solver.advance(0.5)
        >>> solver.particles().position  # (particle, dim) [m]
    """

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme = DEFAULT_SCHEME,
        num_worlds: int = 1,
        device: str | None = None,
        plain_loops: bool = False,
    ):
        """Set up the worlds and put them at their start.

        Args:
            scene: What is simulated; every world starts as this.
            scheme: How it is simulated.
            num_worlds: Number of worlds.
            device: "cpu", "cuda", "cuda:1", ...; None takes a GPU where there is one.
            plain_loops: Run the plain-Warp twin of the pair loop: slow, for tests.

        Raises:
            ValueError: The device or a count is out of its limits.
        """
        if not isinstance(scene, Scene):
            raise ValueError(f"Solver.scene = {scene!r} is not a Scene; make one with Scene(...)")
        if not isinstance(scheme, Scheme):
            raise ValueError(f"Solver.scheme = {scheme!r} is not a Scheme; make one with Scheme(...) or leave it out")
        _check_count("num_worlds", num_worlds)
        self.scene, self.scheme, self.num_worlds = scene, scheme, num_worlds
        self.device = find_device(device)
        start = scene.sample()
        self.capacity = max(len(start), 1)
        self._set_numbers()
        self._check_box()
        self._build_kernels(plain_loops)
        dim = scene.dim
        self.state = State(dim, num_worlds, self.capacity, self.device)
        self._bounds = wp.zeros(num_worlds * self._grid.stride + 2, dtype=int, device=self.device)
        self._travel = wp.array(scene.face_travel(), dtype=float, device=self.device)
        self._constants = wp.zeros(num_worlds, dtype=_CONSTANTS, device=self.device)
        self._constants_at_rest = wp.zeros(num_worlds, dtype=_CONSTANTS, device=self.device)
        self._controls = Controls(scene, num_worlds)
        self._gravity = wp.array(self.gravity, dtype=float, device=self.device)
        self._felt_gravity = self.gravity.copy()  # what the accelerations at hand were found with
        self._gravity_change = wp.zeros((num_worlds, dim), dtype=float, device=self.device)
        self._face_target = wp.zeros((num_worlds, 2 * dim), dtype=float, device=self.device)
        self._step_size = self.max_step
        self._write_constants()
        self.time = np.zeros(num_worlds)
        self.started = np.zeros(num_worlds, int)
        self._start_counts = np.zeros(num_worlds, int)
        self._graphs: dict[int, Any] = {}
        self._face_starts = scene.face_start_positions()
        self._place_faces()
        self.set_start(range(num_worlds), [start] * num_worlds)
        self.reset()

    def _set_numbers(self) -> None:
        """Step limit and the constants of the scene under the scheme."""
        scene, scheme = self.scene, self.scheme
        material = scene.material
        h = scheme.smoothing_length(scene.particle_spacing, scene.dim)
        c_0 = scene.sound_speed
        # The fluid's own viscosity counts towards alpha; the artificial one makes up what is missing.
        own = 2 * (scene.dim + 2) * material.viscosity
        artificial = max(0.0, scheme.artificial_viscosity * h * c_0 - own)
        viscosity = (own + artificial) / (2 * (scene.dim + 2))
        gravity = float(np.linalg.norm(scene.gravity_vector))
        self.max_step = scheme.time_step(h, c_0, scene.speed_scale, viscosity, gravity)
        self._values = {
            "dt": self.max_step,
            "spacing": scene.particle_spacing,
            "h": h,
            "support": scheme.kernel.support * h,
            "inv_h": 1.0 / h,
            "inv_h_volume": 1.0 / h**scene.dim,
            "inv_h_slope": 1.0 / h ** (scene.dim + 2),
            "skin": SKIN * h,
            "volume": scene.particle_spacing**scene.dim,
            "c_0": c_0,
            "inv_c_0_squared": 1.0 / c_0**2,
            "gamma": scheme.gamma,
            "diffusion": 2.0 * scheme.density_diffusion * h * c_0,
            "artificial_viscosity": artificial,
            "viscosity": material.viscosity,
            "viscosity_monaghan": own,
            "eta_squared": 0.01 * h * h,
        }

    def _check_box(self) -> None:
        """Refuse a box in which a particle would need the images of images."""
        support = self._values["support"]
        for axis, (low, high) in enumerate(zip(self.scene.lower, self.scene.upper, strict=True)):
            kinds = {self.scene.faces[name].kind for name in face_names(self.scene.dim)[2 * axis : 2 * axis + 2]}
            if kinds != {"open"} and high - low < support * (1.0 - 1e-6):
                raise ValueError(
                    f"Scene box is {high - low:g} m along {AXES[axis]}, below the smoothing support {support:g} m;"
                    " use a wider box or a smaller Scene.particle_spacing"
                )

    def _build_kernels(self, plain_loops: bool) -> None:
        scene, scheme, dim = self.scene, self.scheme, self.scene.dim
        faces = [scene.faces[name] for name in face_names(dim)]
        self._moving = any(face.moving for face in faces)
        self._kernels = make_step(
            dim=dim,
            kinds=tuple(face.kind for face in faces),
            no_slip=tuple(face.slip == "no" for face in faces),
            density_terms=scheme.density_terms(),
            force_terms=scheme.force_terms(scene.material.viscosity > 0),
            slope=scheme.kernel.slope(dim),
            pressure=scheme.pressure_law.pressure,
            gravity=bool(np.any(scene.gravity_vector)),
            plain=plain_loops,
        )
        self._gather = make_gather(dim)
        search = self._values["support"] + self._values["skin"]
        self._grid = make_grid(np.asarray(scene.lower), np.asarray(scene.upper), search)

    def _place_faces(self) -> None:
        """Put the faces at their start."""
        dim = self.scene.dim
        sliding = [self.scene.faces[name].sliding or (0.0,) * dim for name in face_names(dim)]
        for faces in (self.state.faces, self.state.faces_middle, self.state.faces_start):
            faces.position.assign(np.tile(self._face_starts, (self.num_worlds, 1)))
            faces.sliding.assign(np.tile(np.asarray(sliding), (self.num_worlds, 1, 1)))

    def _write_constants(self) -> None:
        """Hand the constants to the device."""
        for array, dt in ((self._constants, self._step_size), (self._constants_at_rest, 0.0)):
            record: Any = np.zeros(self.num_worlds, dtype=_CONSTANTS.numpy_dtype())
            for name, value in self._values.items():
                record[name] = value
            record["dt"] = dt
            array.assign(record)

    # -- the start -----------------------------------------------------------------------------------------------

    def set_start(self, worlds: Sequence[int], starts: Sequence[Particles]) -> None:
        """Give worlds another start; it is used from their next reset on.

        Args:
            worlds: Numbers of the worlds.
            starts: The particles of each: at most `capacity`; position, velocity and pressure count.

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
        batch = ParticleArrays(self.scene.dim, len(numbers) * self.capacity, self.device)
        host = {name: np.zeros(array.shape, array.numpy().dtype) for name, array in batch.arrays().items()}
        for index, start in enumerate(starts):
            s = self._start_density_error(start, numbers[index])
            slots = slice(index * self.capacity, index * self.capacity + len(start))
            host["position"][:, slots], host["velocity"][:, slots] = start.position.T, start.velocity.T
            host["density_error"][slots] = s
            places = np.arange(self.capacity)
            identity = np.where(places < len(start), places, -1 - places)
            host["identity"][index * self.capacity : (index + 1) * self.capacity] = identity
        for name, array in batch.arrays().items():
            array.assign(host[name])
        self._prime(batch, len(numbers))
        self.state.set_start(numbers, batch)
        self._start_counts[numbers] = [len(start) for start in starts]

    def _start_density_error(self, start: Particles, world: int) -> np.ndarray:
        """rho/rho_0 - 1 of the particles of a start (n,), all of it checked."""
        n, scene = len(start), self.scene
        if n > self.capacity:
            raise ValueError(f"start has {n} particles, limit {self.capacity}; make the solver with a larger scene")
        for name, values, shape in (
            ("position", start.position, (n, scene.dim)),
            ("velocity", start.velocity, (n, scene.dim)),
            ("pressure", start.pressure, (n,)),
        ):
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
        unit = scene.material.density * scene.sound_speed**2
        with np.errstate(invalid="ignore"):
            s = self.scheme.state_equation.density_of(start.pressure / unit, self.scheme.gamma)
        if not (np.isfinite(s) & (s > -1.0)).all():
            raise ValueError(
                f"start of world {world}: pressure {start.pressure.min():g} Pa is below what"
                f" {self.scheme.state_equation.name} can hold at a sound speed of {scene.sound_speed:g} m/s; raise it"
            )
        return s

    def _prime(self, batch: ParticleArrays, count: int) -> None:
        """Put starts in cell order and find their accelerations, as a step of no time does.

        Every world has the same faces, gravity and constants at its start, so the first `count` stand for any.
        """
        faces, unused = self.state.faces_start, wp.zeros(self.num_worlds, dtype=int, device=self.device)
        self._gravity.assign(np.tile(self.scene.gravity_vector, (self.num_worlds, 1)))
        self._sort(batch, faces, self._constants_at_rest, unused, count)
        # The spray rule must not touch the density of a start, so what the sweep makes of it goes to scratch.
        scratch = self.state.reduced_pressure
        self._sweep(batch, faces, faces, self._constants_at_rest, unused, count, density_out=scratch)
        slots = count * self.capacity
        wp.copy(batch.density_error, self.state.sorted.density_error, count=slots)

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Put worlds back to their start, their faces at rest and the scene's gravity on.

        Args:
            mask: Which worlds, bool (world,); None is all.

        Raises:
            ValueError: The mask has another shape.
        """
        mask = np.ones(self.num_worlds, bool) if mask is None else np.asarray(mask, bool)
        if mask.shape != (self.num_worlds,):
            raise ValueError(f"Solver.reset mask has shape {mask.shape}, limit ({self.num_worlds},); one bool a world")
        if mask.any():
            self.state.reset(np.flatnonzero(mask))
        self.time[mask] = 0.0
        self.started[mask] = self._start_counts[mask]
        self._controls.reset(mask)
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
        self._controls.check(strongest=0.25 * self._values["h"] / dt**2, fastest=self.scene.sound_speed)
        if dt != self._step_size:
            self._step_size = dt
            self._write_constants()
        self._apply_gravity()
        if self._moving:
            self._face_target.assign(self.face_velocity)
            faces = self.state.faces
            wp.launch(aim_faces, faces.position.shape, [n * dt, self._face_target, faces], device=self.device)
        with wp.ScopedDevice(self.device):
            for first in range(0, n, STEPS_PER_GRAPH):
                wp.capture_launch(self._graph(min(STEPS_PER_GRAPH, n - first)))
        self.time += n * dt

    def _apply_gravity(self) -> None:
        """Hand the gravity to the device, and mend the accelerations at hand, which begin the next step."""
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

    def _graph(self, n: int) -> Any:
        """The captured launches of n steps."""
        if n not in self._graphs:
            with wp.ScopedDevice(self.device):
                wp.load_module(advance_faces.module, device=self.device)
                wp.load_module(order_by_cell.module, device=self.device)
                with wp.ScopedCapture(device=self.device) as capture:
                    self._launch(n)
                self._graphs[n] = capture.graph
        return self._graphs[n]

    def _launch(self, n: int) -> None:
        state = self.state
        middle = state.faces_middle if self._moving else state.faces
        for _ in range(n):
            if self._moving:
                inputs = [self._constants, self._travel, middle, state.faces]
                wp.launch(advance_faces, state.faces.position.shape, inputs, device=self.device)
            self._sort(state.now, middle, self._constants, state.clamped, self.num_worlds)
            self._sweep(
                state.now,
                middle,
                state.faces,
                self._constants,
                state.clamped,
                self.num_worlds,
                density_out=state.now.density_error,
            )

    def _sort(
        self, particles: ParticleArrays, faces: Any, constants: wp.array, clamped: wp.array, num_worlds: int
    ) -> None:
        """Kick and drift to the middle of the step, then put the particles in cell order."""
        state, slots, cells = self.state, num_worlds * self.capacity, num_worlds * self._grid.stride
        bounds: Any = self._bounds if num_worlds == self.num_worlds else self._bounds[: cells + 2]
        bounds.zero_()
        wp.launch(
            self._kernels.drift,
            dim=slots,
            inputs=[self.capacity, constants, self._grid, faces, particles.acceleration],
            outputs=[particles.position, particles.velocity, particles.identity, state.key, bounds, clamped],
            device=self.device,
        )
        wp.utils.array_scan(bounds, bounds, inclusive=True)
        wp.launch(order_by_cell, slots, [state.key, bounds, state.order], device=self.device)
        if self.device.is_cuda:
            wp.launch(settle_order, cells, [self._grid.stride, bounds, state.order], device=self.device)
        source, target = particles, state.sorted
        wp.launch(
            self._gather,
            dim=slots,
            inputs=[state.order, source.position, source.velocity, source.density_error, source.identity],
            outputs=[target.position, target.velocity, target.density_error, target.identity],
            device=self.device,
        )

    def _sweep(
        self,
        particles: ParticleArrays,
        middle: Any,
        end: Any,
        constants: wp.array,
        clamped: wp.array,
        num_worlds: int,
        density_out: wp.array,
    ) -> None:
        """The two sweeps over pairs, from the sorted arrays back into the particles'."""
        state, half, slots = self.state, self.state.sorted, num_worlds * self.capacity
        shared = [self.capacity, constants, self._gravity, self._grid, self._bounds]
        wp.launch(
            self._kernels.advance_density,
            dim=slots,
            inputs=[*shared, middle, end, half.position, half.velocity, half.density_error, half.identity],
            outputs=[particles.position, density_out, particles.identity, state.reduced_pressure, clamped],
            device=self.device,
        )
        wp.launch(
            self._kernels.kick,
            dim=slots,
            inputs=[*shared, end, particles.position, half.velocity, state.reduced_pressure, particles.identity],
            outputs=[particles.velocity, particles.acceleration],
            device=self.device,
        )

    # -- what there is to read -----------------------------------------------------------------------------------

    @property
    def gravity(self) -> np.ndarray:
        """Control: acceleration [m/s2], (world, dim)."""
        return self._controls.gravity

    @gravity.setter
    def gravity(self, value: Any) -> None:
        self._controls.gravity = value

    @property
    def face_velocity(self) -> np.ndarray:
        """Control: velocity of each moving face at the end of the next call of step or advance [m/s], (world, face).

        A face gets there at a constant acceleration.
        """
        return self._controls.face_velocity

    @face_velocity.setter
    def face_velocity(self, value: Any) -> None:
        self._controls.face_velocity = value

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
        material, scheme = self.scene.material, self.scheme
        pressure = material.density * self.scene.sound_speed**2 * scheme.state_equation.pressure_of(s, scheme.gamma)
        return Particles(
            position=now.position.numpy()[:, slots].T[order],
            velocity=now.velocity.numpy()[:, slots].T[order],
            density=material.density * (1.0 + s),
            pressure=pressure,
            identity=identity[order],
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

    def save(self) -> dict[str, np.ndarray]:
        """All that the future of the worlds depends on, controls included, as NumPy arrays."""
        return self.state.snapshot() | {
            "time": self.time.copy(),
            "started": self.started.copy(),
            "gravity_control": self.gravity.copy(),
            "gravity_felt": self._felt_gravity.copy(),
            "face_velocity_control": self.face_velocity.copy(),
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
        self.state.restore(dict(saved))
        self.time, self.started = saved["time"].copy(), saved["started"].copy()
        self.gravity, self.face_velocity = saved["gravity_control"], saved["face_velocity_control"]
        self._felt_gravity = saved["gravity_felt"].copy()
