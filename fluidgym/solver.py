"""The solver: one scene, one scheme, any number of worlds; compiles just what they need."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp

from fluidgym.scene import AXES, Particles, Scene, face_names
from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.sph.constants import Constants
from fluidgym.sph.integrate import advance_faces, aim_faces, make_step
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


class Solver:
    """Weakly compressible SPH of a scene, in many worlds at once.

    Attributes:
        scene: What is simulated.
        scheme: How.
        num_worlds: Number of worlds.
        capacity: Particles of each world.
        device: The Warp device.
        max_step: Largest stable time step [s].
        time: Simulated time of each world since its reset [s], (world,).
        face_velocity: Control. Velocity that each moving face is to have at the end of the next call of step or
            advance [m/s], (world, face); it gets there at a constant acceleration.
        gravity: Control. Acceleration [m/s2], (world, dim).

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
        if num_worlds < 1:
            raise ValueError(f"Solver.num_worlds = {num_worlds} is below the limit 1; use 1 or more")
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
        self._travel = wp.array(self._face_travel(), dtype=float, device=self.device)
        self._constants = wp.zeros(num_worlds, dtype=_CONSTANTS, device=self.device)
        self._constants_at_rest = wp.zeros(num_worlds, dtype=_CONSTANTS, device=self.device)
        self.gravity = np.tile(scene.gravity_vector.astype(np.float32), (num_worlds, 1))
        self.face_velocity = np.zeros((num_worlds, 2 * dim), np.float32)
        self._gravity = wp.array(self.gravity, dtype=float, device=self.device)
        self._face_target = wp.zeros((num_worlds, 2 * dim), dtype=float, device=self.device)
        self._step_size = self.max_step
        self._write_constants()
        self.time = np.zeros(num_worlds)
        self._graphs: dict[int, Any] = {}
        self._set_face_starts()
        self.set_start(range(num_worlds), [start] * num_worlds)
        self.reset()

    def _set_numbers(self) -> None:
        """Step limit and the constants of the scene under the scheme."""
        scene, scheme = self.scene, self.scheme
        material = scene.material
        h = scheme.smoothing_length(scene.particle_spacing, scene.dim)
        c_0 = scene.sound_speed
        viscosity = material.viscosity + scheme.artificial_viscosity * h * c_0 / (2 * (scene.dim + 2))
        gravity = float(np.linalg.norm(scene.gravity_vector))
        sigma = scheme.kernel.sigma(scene.dim) / h**scene.dim
        self.max_step = scheme.time_step(h, c_0, scene.speed_scale, viscosity, gravity)
        self._values = {
            "dt": self.max_step,
            "spacing": scene.particle_spacing,
            "h": h,
            "support": scheme.kernel.support * h,
            "inv_support": 1.0 / (scheme.kernel.support * h),
            "skin": SKIN * h,
            "kernel_value": sigma,
            "kernel_slope": sigma / h**2,
            "volume": scene.particle_spacing**scene.dim,
            "rho_0": material.density,
            "c_0": c_0,
            "inv_c_0_squared": 1.0 / c_0**2,
            "gamma": scheme.gamma,
            "diffusion": 2.0 * scheme.density_diffusion * h * c_0,
            "artificial_viscosity": scheme.artificial_viscosity * h * c_0,
            "viscosity": material.viscosity,
            "viscosity_monaghan": 2 * (scene.dim + 2) * material.viscosity,
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
            slope=scheme.kernel.slope,
            pressure=scheme.state_equation.pressure,
            gravity=bool(np.any(scene.gravity_vector)),
            plain=plain_loops,
        )
        self._gather = make_gather(dim)
        search = self._values["support"] + self._values["skin"]
        self._grid = make_grid(np.asarray(scene.lower), np.asarray(scene.upper), search)

    def _face_travel(self) -> np.ndarray:
        """Lowest and highest position of each face [m], (face, 2)."""
        travel = []
        for index, name in enumerate(face_names(self.scene.dim)):
            face, axis = self.scene.faces[name], index // 2
            at = (self.scene.lower, self.scene.upper)[index % 2][axis]
            inside = (self.scene.lower[axis], self.scene.upper[axis])
            travel.append((face.travel or inside) if face.moving else (at, at))
        return np.asarray(travel)

    def _set_face_starts(self) -> None:
        dim, travel = self.scene.dim, self._face_travel()
        corners = np.stack([self.scene.lower, self.scene.upper], axis=1).ravel()
        position = np.clip(corners, travel[:, 0], travel[:, 1])
        sliding = [self.scene.faces[name].sliding or (0.0,) * dim for name in face_names(dim)]
        for faces in (self.state.faces, self.state.faces_middle, self.state.faces_start):
            faces.position.assign(np.tile(position, (self.num_worlds, 1)))
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
            ValueError: A start has too many particles.
        """
        start_arrays = self.state.start.arrays()
        host = {name: array.numpy().copy() for name, array in start_arrays.items()}
        rest_pressure = self.scene.material.density * self.scene.sound_speed**2
        for world, start in zip(worlds, starts, strict=True):
            n, first = len(start), world * self.capacity
            if n > self.capacity:
                raise ValueError(f"start has {n} particles, limit {self.capacity}; make the solver with a larger scene")
            if not (np.isfinite(start.position).all() and np.isfinite(start.velocity).all()):
                raise ValueError(f"start of world {world} has a position or velocity that is not finite; give numbers")
            host["position"][:, first : first + n] = start.position.T
            host["velocity"][:, first : first + n] = start.velocity.T
            host["density_error"][first : first + n] = self.scheme.state_equation.density_of(
                start.pressure / rest_pressure, self.scheme.gamma
            )
            host["identity"][first : first + n] = np.arange(n)
            host["identity"][first + n : first + self.capacity] = -1 - np.arange(n, self.capacity)
        for name, array in start_arrays.items():
            array.assign(host[name])
        self._prime()

    def _prime(self) -> None:
        """Put every start in cell order and find its accelerations, as a step of no time does."""
        start, faces = self.state.start, self.state.faces_start
        start.acceleration.zero_()
        self._gravity.assign(np.tile(self.scene.gravity_vector, (self.num_worlds, 1)))
        self._sort(start, faces, self._constants_at_rest)
        # The density goes to scratch: a start is primed again whenever another world gets a new one.
        self._sweep(start, faces, faces, self._constants_at_rest, density_out=self.state.reduced_pressure)
        start.density_error.assign(self.state.sorted.density_error)

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Put worlds back to their start.

        Args:
            mask: Which worlds, bool (world,); None is all.

        Raises:
            ValueError: The mask has another shape.
        """
        mask = np.ones(self.num_worlds, bool) if mask is None else np.asarray(mask, bool)
        if mask.shape != (self.num_worlds,):
            raise ValueError(f"Solver.reset mask has shape {mask.shape}, limit ({self.num_worlds},); one bool a world")
        self.state.reset(mask)
        self.time[mask] = 0.0
        self.face_velocity[mask] = 0.0

    # -- stepping ------------------------------------------------------------------------------------------------

    def advance(self, duration: float) -> None:
        """Go on by a duration [s], in equal steps no longer than `max_step`."""
        if not (math.isfinite(duration) and duration > 0.0):
            raise ValueError(f"Solver.advance duration = {duration} s must be positive and finite")
        n = max(1, math.ceil(duration / self.max_step - 1e-9))
        self.step(n, duration / n)

    def step(self, n: int = 1, dt: float | None = None) -> None:
        """Go on by n steps of dt [s]; None is `max_step`.

        Raises:
            ValueError: n is below one, or dt longer than 1.5 times `max_step`, where the scheme is no longer stable.
        """
        if n < 1:
            raise ValueError(f"Solver.step n = {n} is below the limit 1; use 1 or more")
        dt = self.max_step if dt is None else dt
        if not 0.0 < dt <= 1.5 * self.max_step:
            raise ValueError(f"Solver.step dt = {dt:g} s is outside 0 to {1.5 * self.max_step:g} s; use max_step")
        if dt != self._step_size:
            self._step_size = dt
            self._write_constants()
        self._gravity.assign(self.gravity)
        if self._moving:
            self._face_target.assign(self.face_velocity)
            faces = self.state.faces
            wp.launch(aim_faces, faces.position.shape, [n * dt, self._face_target, faces], device=self.device)
        with wp.ScopedDevice(self.device):
            for first in range(0, n, STEPS_PER_GRAPH):
                wp.capture_launch(self._graph(min(STEPS_PER_GRAPH, n - first)))
        self.time += n * dt

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
            self._sort(state.now, middle, self._constants)
            self._sweep(state.now, middle, state.faces, self._constants, density_out=state.now.density_error)

    def _sort(self, particles: ParticleArrays, faces: Any, constants: wp.array) -> None:
        """Kick and drift to the middle of the step, then put the particles in cell order."""
        state, slots = self.state, self.num_worlds * self.capacity
        self._bounds.zero_()
        wp.launch(
            self._kernels.drift,
            dim=slots,
            inputs=[self.capacity, constants, self._grid, faces, particles.acceleration],
            outputs=[
                particles.position, particles.velocity, particles.identity, state.key, self._bounds, state.clamped,
            ],
            device=self.device,
        )  # fmt: skip
        wp.utils.array_scan(self._bounds, self._bounds, inclusive=True)
        wp.launch(order_by_cell, slots, [state.key, self._bounds, state.order], device=self.device)
        if self.device.is_cuda:
            cells = self.num_worlds * self._grid.stride
            wp.launch(settle_order, cells, [self._bounds, state.order], device=self.device)
        source, target = particles, state.sorted
        wp.launch(
            self._gather,
            dim=slots,
            inputs=[state.order, source.position, source.velocity, source.density_error, source.identity],
            outputs=[target.position, target.velocity, target.density_error, target.identity],
            device=self.device,
        )

    def _sweep(
        self, particles: ParticleArrays, middle: Any, end: Any, constants: wp.array, density_out: wp.array
    ) -> None:
        """The two sweeps over pairs, from the sorted arrays back into the particles'."""
        state, half, slots = self.state, self.state.sorted, self.num_worlds * self.capacity
        shared = [self.capacity, constants, self._gravity, self._grid, self._bounds]
        wp.launch(
            self._kernels.advance_density,
            dim=slots,
            inputs=[*shared, middle, end, half.position, half.velocity, half.density_error, half.identity],
            outputs=[particles.position, density_out, particles.identity, state.reduced_pressure, state.clamped],
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
        """All that the future of the worlds depends on, as NumPy arrays."""
        return self.state.snapshot() | {"time": self.time.copy()}

    def restore(self, saved: Mapping[str, np.ndarray]) -> None:
        """Put back what `save` gave."""
        self.state.restore(dict(saved))
        self.time = saved["time"].copy()
