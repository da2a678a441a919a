"""A scene under a scheme as the device has it: its structure and numbers, bodies, nozzles, drains, frozen walls."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from fluidgym.records import pack
from fluidgym.scene import AXES, LEAST_MACH_MARGIN, MACH_MARGIN, Ball, Face, Scene, face_names
from fluidgym.scheme import LIMITS, Scheme
from fluidgym.sph.bodies import make_bodies
from fluidgym.sph.neighbors import make_grid
from fluidgym.sph.shifting import shift_term
from fluidgym.sph.smoothing import POLY6, SmoothingKernel
from fluidgym.sph.state_equation import LINEAR
from fluidgym.sph.structure import Structure
from fluidgym.sph.terms import DensitySum
from fluidgym.sph.wall_models import WALL_LIMITS, ClampWalls, FrozenWalls, MirrorWalls, PenaltyWalls
from fluidgym.state import Drains, Frozen, Nozzles

_DRAINS: Any = Drains  # Warp structs: to a type checker no classes
_FROZEN: Any = Frozen
_NOZZLES: Any = Nozzles

# How far a pair may approach in half a step, over h, and still be seen in the second sweep.
SKIN = 0.1

# Distance below which a kernel has a core, over the spacing: neighbours on a lattice are further off.
CORE_RADIUS = 0.75

# Accelerations are added up in fixed point, in units of c_0^2/h over this.
FORCE_STEPS = float(1 << 20)

# Density error of the pressure that is added in a shifted box, over (U/c_0)^2.
LEVEL = 0.1

_WALLS = {MirrorWalls: "mirror", PenaltyWalls: "penalty", ClampWalls: "clamp", FrozenWalls: "frozen"}


class Parameters:
    """The numbers of a scene and a scheme that may change while worlds run, for each world.

    Attributes:
        values: By name, each (world,).
    """

    def __init__(self, scene: Scene, scheme: Scheme, num_worlds: int):
        material, walls = scene.material, scheme.walls
        start = {
            "viscosity": material.viscosity,
            "sound_speed": scene.sound_speed,
            "thermal_diffusivity": material.thermal_diffusivity,
            "central_force": scene.central_force,
            "gamma": scheme.gamma,
            "density_diffusion": 0.0 if scheme.preset == "mueller" else scheme.density_diffusion,
            "artificial_viscosity": scheme.artificial_viscosity,
            "acoustic_damping": 0.0 if scheme.preset == "mueller" else scheme.acoustic_damping,
            "wall_stiffness": walls.stiffness if isinstance(walls, PenaltyWalls) else 0.0,
            "wall_margin": walls.margin if isinstance(walls, PenaltyWalls) else 0.0,
            "wall_damping": walls.damping if isinstance(walls, ClampWalls) else 0.0,
        }
        self._scene, self._scheme = scene, scheme
        self.values = {name: np.full(num_worlds, float(value)) for name, value in start.items()}

    def change(self, changes: Mapping[str, Any]) -> None:
        """Give parameters other values, one for all worlds or one for each.

        Raises:
            ValueError: One is unknown, of a wrong shape, or out of its limits; nothing has happened then.
        """
        new = {}
        for name, value in changes.items():
            if name not in self.values:
                raise ValueError(f"Solver.set_parameters {name!r} is unknown; use {', '.join(self.values)}")
            shape = self.values[name].shape
            try:
                array = np.broadcast_to(np.asarray(value, float), shape).copy()
            except (TypeError, ValueError):
                raise ValueError(
                    f"Solver.set_parameters {name} has shape {np.shape(value)}, limit {shape}; give one number, or one"
                    " for each world"
                ) from None
            least, most = self._limits(name)
            wrong = np.flatnonzero(~(np.isfinite(array) & (array >= least) & (array <= most)))
            if len(wrong):
                raise ValueError(
                    f"Solver.set_parameters {name}[{wrong[0]}] = {array[wrong[0]]:g} is outside {least:g} to {most:g};"
                    f" use a {'smaller' if array[wrong[0]] > most else 'larger'} number"
                )
            new[name] = array
        self.values |= new

    def _limits(self, name: str) -> tuple[float, float]:
        """What a parameter may be: as where it is first given.

        Raises:
            ValueError: It is of no effect under the scheme.
        """
        of_walls = {"wall_stiffness": PenaltyWalls, "wall_margin": PenaltyWalls, "wall_damping": ClampWalls}
        if name in of_walls:
            if not isinstance(self._scheme.walls, of_walls[name]):
                raise ValueError(
                    f"Solver.set_parameters {name} is of no effect under {type(self._scheme.walls).__name__}; use"
                    f" Scheme(walls={of_walls[name].__name__}())"
                )
            return WALL_LIMITS[name.removeprefix("wall_")]
        if name == "gamma" and self._scheme.state_equation is LINEAR:
            raise ValueError(
                "Solver.set_parameters gamma is of no effect under LINEAR; use Scheme(state_equation=TAIT)"
            )
        if name in LIMITS:
            return LIMITS[name][:2]
        if name == "sound_speed":
            return LEAST_MACH_MARGIN * self._scene.speed_scale, math.inf
        return (-math.inf if name == "central_force" else 0.0), math.inf

    def constants(self) -> dict[str, Any]:
        """The constants of a step but its length, by name, each a number or (world,)."""
        scene, scheme, p = self._scene, self._scheme, self.values
        dx, dim = scene.particle_spacing, scene.dim
        h = scheme.smoothing_length(dx, dim)
        kernel = scheme.kernel_in(dim)
        support, c_0 = scheme.support(dx, dim), p["sound_speed"]
        # The fluid's own viscosity counts towards alpha; the artificial one makes up what is missing.
        own = 2 * (dim + 2) * p["viscosity"]
        # On a lattice the Laplacian of Morris is this much of the true one, which no refinement mends.
        unit = 1.0 if scheme.preset == "mueller" else lattice_laplacian(kernel, h / dx, dim)
        return {
            "spacing": dx,
            "h": h,
            "support": support,
            "skin": SKIN * h,
            "inv_h": 1.0 / h,
            "inv_h_volume": 1.0 / h**dim,
            "inv_h_slope": 1.0 / h ** (dim + 2),
            "core": scheme.core_in(dim),
            "inv_core_radius": 1.0 / (CORE_RADIUS * dx),
            "volume": dx**dim,
            "c_0": c_0,
            "inv_c_0_squared": 1.0 / c_0**2,
            "gamma": p["gamma"],
            "diffusion": 2.0 * p["density_diffusion"] * h * c_0,
            "damping": p["acoustic_damping"] * h / c_0,
            "full_company": lattice_company(kernel, h / dx, dim),
            "artificial_viscosity": np.maximum(0.0, p["artificial_viscosity"] * h * c_0 - own),
            "viscosity": p["viscosity"] / unit,
            "viscosity_monaghan": own,
            "density_unit": 1.0 / lattice_sum(h / dx, dim) if scheme.preset == "mueller" else 1.0,
            "thermal_diffusivity": p["thermal_diffusivity"] / unit,
            "central_force": p["central_force"],
            "shifting": _shifting(scene, scheme) * scene.speed_scale * h,
            "level": LEVEL * (scene.speed_scale / c_0) ** 2,
            "wall_stiffness": p["wall_stiffness"] * (c_0 / h) ** 2,
            "wall_margin": p["wall_margin"] * dx,
            "wall_damping": p["wall_damping"],
            "force_unit": FORCE_STEPS * h / c_0**2,
            "eta_squared": 0.01 * h * h,
        }

    def max_step(self) -> float:
        """Longest stable time step [s], that of the most demanding world."""
        scene, scheme, c = self._scene, self._scheme, self.constants()
        gravity = float(np.linalg.norm(scene.gravity_vector))
        spread = (c["viscosity_monaghan"] + c["artificial_viscosity"]) / (2 * (scene.dim + 2))
        spread = np.maximum(spread, c["thermal_diffusivity"])
        speed = scene.speed_scale
        each = (c["c_0"], spread, self.values["density_diffusion"], self.values["acoustic_damping"])
        return min(
            scheme.time_step(c["h"], c_0, speed, nu, gravity, diffusion, damping)
            for c_0, nu, diffusion, damping in zip(*each, strict=True)
        )


def with_sound_speed(scene: Scene, scheme: Scheme) -> Scene:
    """The scene with the speed of sound that the scheme wants, where its material names none."""
    if scene.material.sound_speed is not None or scheme.sound_speed_ratio == MACH_MARGIN:
        return scene
    sound_speed = scheme.sound_speed_ratio * scene.speed_scale
    return replace(scene, material=replace(scene.material, sound_speed=sound_speed))


def lattice_sum(ratio: float, dim: int) -> float:
    """Sum of V W of Poly6 over a square or cubic lattice, for h/dx: what density by summation calls rest."""
    steps = np.arange(-math.ceil(ratio), math.ceil(ratio) + 1)
    q_squared = sum(axis**2 for axis in np.meshgrid(*[steps] * dim)) / ratio**2
    return float(POLY6.sigma(dim) / ratio**dim * (np.maximum(1.0 - q_squared, 0.0) ** 3).sum())


@lru_cache
def lattice_company(kernel: SmoothingKernel, ratio: float, dim: int) -> float:
    """Sum of V h^2 |W'/r| over the neighbours on a square or cubic lattice, for h/dx."""
    _, slope = _lattice_slopes(kernel, ratio, dim)
    return float(-kernel.sigma(dim) / ratio**dim * slope.sum())


@lru_cache
def lattice_laplacian(kernel: SmoothingKernel, ratio: float, dim: int) -> float:
    """Sum of V x^2 (-W'/r) over a square or cubic lattice, for h/dx: 1 were it an integral."""
    x, slope = _lattice_slopes(kernel, ratio, dim)
    return float(-kernel.sigma(dim) / ratio ** (dim + 2) * (x**2 * slope).sum())


def _lattice_slopes(kernel: SmoothingKernel, ratio: float, dim: int) -> tuple[np.ndarray, np.ndarray]:
    """Places along x, over the spacing, and W'/r, over sigma / h^(dim + 2), of neighbours on a lattice, each (n,)."""
    steps = np.arange(-math.ceil(kernel.support * ratio), math.ceil(kernel.support * ratio) + 1)
    places = [axis.ravel() for axis in np.meshgrid(*[steps] * dim)]
    r_squared = np.sum(np.square(places), axis=0)
    others = r_squared > 0
    slope = np.array([kernel.slope_of(q) for q in np.sqrt(r_squared[others]) / ratio])
    return places[0][others], slope


def make_structure(
    scene: Scene, scheme: Scheme, parameters: Parameters, forces: bool, plain: bool, half: bool = False
) -> Structure:
    """What a solver of this scene and scheme compiles.

    Raises:
        ValueError: The walls of the scheme cannot be what the scene asks of them.
    """
    _check_walls(scene, scheme)
    dim, p = scene.dim, parameters.values
    faces = [scene.faces[name] for name in face_names(dim)]
    wall = _WALLS[type(scheme.walls)]
    heat = scene.material.thermal_diffusivity > 0.0
    terms = scheme.terms_in_use(
        viscous=bool((p["viscosity"] > 0.0).any()),
        diffusive=bool((p["density_diffusion"] > 0.0).any()),
        artificial=bool((p["artificial_viscosity"] > 0.0).any()),
        central=bool(p["central_force"].any()),
    )
    bodies = list(scene.bodies.values())
    shifted = _is_shifted(scene, scheme)
    return Structure(
        dim=dim,
        kinds=tuple(_kind(face, wall) for face in faces),
        no_slip=tuple(face.slip == "no" for face in faces),
        warm_faces=tuple(heat and face.temperature is not None for face in faces),
        density_terms=terms[0],
        force_terms=terms[1],
        slope=scheme.kernel_in(dim).slope(dim, cored=scheme.core_in(dim) > 0.0),
        weight=scheme.kernel_in(dim).slope(dim),
        field=scheme.force_field(),
        integrator=scheme.steps,
        gravity=bool(np.any(scene.gravity_vector)) or bool(p["central_force"].any()),
        central=bool(p["central_force"].any()),
        damped=bool((p["acoustic_damping"] > 0.0).any()),
        leaning=scheme.preset == "delta" and bool((p["density_diffusion"] > 0.0).any()) and not scene.is_full,
        wall=wall,
        balls=tuple(isinstance(body.shape, Ball) for body in bodies),
        hiding=any(
            min(np.subtract(*reversed(body.shape.bounds()))) < scheme.support(scene.particle_spacing, dim)
            for body in bodies
        ),
        no_slip_bodies=tuple(body.slip == "no" for body in bodies),
        warm_bodies=tuple(heat and body.temperature is not None for body in bodies),
        round_pipes=tuple(dim == 3 and inflow.height is None for inflow in scene.inflows.values()),
        drains=len(scene.outflows),
        heat=heat,
        shift=shift_term(scheme.kernel_in(dim), dim, not scene.is_full) if shifted else None,
        surface=shifted and not scene.is_full,
        forces=forces,
        plain=plain,
        half=half,
    )


def _shifting(scene: Scene, scheme: Scheme) -> float:
    """A of the particle shifting that such a scene has."""
    return scheme.shifting if scene.is_full else scheme.surface_shifting


def _is_shifted(scene: Scene, scheme: Scheme) -> bool:
    """Whether particles are shifted: where walls all show images, and density is advanced."""
    summed = any(isinstance(term, DensitySum) for term in scheme.density_terms())
    return _shifting(scene, scheme) > 0.0 and isinstance(scheme.walls, MirrorWalls) and not summed


def _kind(face: Face, wall: str) -> str:
    """What a face is to a kernel."""
    if face.kind != "wall":
        return face.kind
    return "mirror" if wall == "mirror" else "bare"


def _check_walls(scene: Scene, scheme: Scheme) -> None:
    walls = scheme.walls
    if isinstance(walls, MirrorWalls):
        return
    name = type(walls).__name__
    for face_name, face in scene.faces.items():
        if face.slip == "no" and not isinstance(walls, FrozenWalls):
            raise ValueError(
                f"Scene.faces[{face_name!r}].slip = 'no' cannot be kept by Scheme.walls = {name}; use MirrorWalls()"
            )
        if face.temperature is not None:
            raise ValueError(
                f"Scene.faces[{face_name!r}].temperature cannot be kept by Scheme.walls = {name}; use MirrorWalls()"
            )
        if isinstance(walls, FrozenWalls) and (face.moving or face.kind == "periodic"):
            raise ValueError(
                f"Scene.faces[{face_name!r}] is moving or periodic, which Scheme.walls = {name} cannot be;"
                " use MirrorWalls()"
            )


def check_box(scene: Scene, scheme: Scheme) -> None:
    """Refuse a box in which a particle would need the images of images, and a pipe shorter than the kernel's reach.

    Raises:
        ValueError: So it is.
    """
    support = scheme.support(scene.particle_spacing, scene.dim)
    for axis, (low, high) in enumerate(zip(scene.lower, scene.upper, strict=True)):
        kinds = {scene.faces[name].kind for name in face_names(scene.dim)[2 * axis : 2 * axis + 2]}
        if kinds != {"open"} and high - low < support * (1.0 - 1e-6):
            raise ValueError(
                f"Scene box is {high - low:g} m along {AXES[axis]}, below the smoothing support {support:g} m;"
                " use a wider box or a smaller Scene.particle_spacing"
            )
    _check_seams(scene, support)
    for name, inflow in scene.inflows.items():
        length = inflow.pipe_length(scene.particle_spacing)
        if length < support * (1.0 - 1e-6):
            raise ValueError(
                f"Scene.inflows[{name!r}].length = {length:g} m is below the smoothing support {support:g} m;"
                " use a longer pipe, or None"
            )


def _check_seams(scene: Scene, support: float) -> None:
    """Refuse a body that ends near a periodic face: it has no image on the other side."""
    travel = body_travel(scene).reshape(-1, scene.dim, 2)
    for (name, body), reach in zip(scene.bodies.items(), travel, strict=True):
        half = 0.5 * np.subtract(*reversed(body.shape.bounds()))
        for axis, (low, high) in enumerate(zip(scene.lower, scene.upper, strict=True)):
            face = face_names(scene.dim)[2 * axis]
            if scene.faces[face].kind != "periodic":
                continue
            first, last = reach[axis, 0] - half[axis], reach[axis, 1] + half[axis]
            inside = first >= low + support and last <= high - support
            through = reach[axis, 1] - half[axis] <= low - support and reach[axis, 0] + half[axis] >= high + support
            if not inside and not through:
                raise ValueError(
                    f"Scene.bodies[{name!r}] spans {AXES[axis]} = {first:g} to {last:g} m with its travel, less than"
                    f" the smoothing support {support:g} m from a periodic face; keep it further in, or let it reach"
                    " so far beyond both"
                )


def body_halves(scene: Scene) -> np.ndarray:
    """Half sides of the bodies, or their radius [m], (body, dim)."""
    halves = [0.5 * np.subtract(*reversed(body.shape.bounds())) for body in scene.bodies.values()]
    return np.array(halves).reshape(-1, scene.dim)


def body_middles(scene: Scene) -> np.ndarray:
    """Middles of the bodies at the start [m], (body, dim)."""
    middles = [0.5 * np.add(*body.shape.bounds()) for body in scene.bodies.values()]
    return np.array(middles).reshape(-1, scene.dim)


def body_travel(scene: Scene) -> np.ndarray:
    """Lowest and highest place of the middle of each body along each axis [m], (body * dim, 2)."""
    reach = []
    for body, middle in zip(scene.bodies.values(), body_middles(scene), strict=True):
        if not body.moving:
            reach.append(np.stack([middle, middle], axis=1))
        elif body.travel is None:
            reach.append(np.tile([-np.inf, np.inf], (scene.dim, 1)))
        else:
            reach.append(np.stack([middle + end for end in body.travel], axis=1))
    return np.array(reach).reshape(-1, 2)


def equip_bodies(bodies: Any, scene: Scene, structure: Structure, device: wp.Device) -> None:
    """Give body arrays what does not change: their temperatures, and how many rays see them."""
    if not scene.bodies:
        return
    solids = make_bodies(structure)
    bodies.patches, bodies.rays, bodies.others = solids.patches, solids.rays, solids.others
    temperatures = [body.temperature or 0.0 for body in scene.bodies.values()]
    bodies.temperature = wp.array(temperatures, dtype=float, device=device)


def make_nozzles(scene: Scene, num_worlds: int, device: wp.Device) -> Any:
    """The nozzles of a scene; their places, directions and speeds are written by the controls."""
    nozzles: Any = _NOZZLES()
    dim, n, dx = scene.dim, len(scene.inflows), scene.particle_spacing
    if not n:
        return nozzles
    inflows = list(scene.inflows.values())
    rows = [inflow.rows(dx) for inflow in inflows]
    sides = [np.array([inflow.width, inflow.height or inflow.width])[: dim - 1] for inflow in inflows]
    across = [0.5 * side * places for side, (places, _) in zip(sides, rows, strict=True)]
    # The profile is 1 - q^2 over its mean on the rows, so its flux is exact for the particles there are.
    bulge = [0.0] * n
    for index, (inflow, (places, share)) in enumerate(zip(inflows, rows, strict=True)):
        if inflow.profile == "parabolic":
            q = (places**2).sum(axis=1) if dim == 3 and inflow.height is None else places[:, -1] ** 2
            bulge[index] = float(share[0] / (1.0 - q[0]))
    for name, shape in (
        ("center", (num_worlds, n, dim)),
        ("frame", (num_worlds, n, dim, dim)),
        ("half", (num_worlds, n, dim - 1)),
        ("speed", (num_worlds, n)),
    ):
        setattr(nozzles, name, wp.zeros(shape, dtype=float, device=device))
    nozzles.length = wp.array([inflow.pipe_length(dx) for inflow in inflows], dtype=float, device=device)
    nozzles.bulge = wp.array(bulge, dtype=float, device=device)
    nozzles.temperature = wp.array([inflow.temperature for inflow in inflows], dtype=float, device=device)
    owners = np.concatenate([np.full(len(places), index) for index, (places, _) in enumerate(rows)])
    nozzles.row_inflow = wp.array(owners, dtype=int, device=device)
    nozzles.row_across = wp.array(np.concatenate(across), dtype=float, device=device)
    return nozzles


def held_density(scene: Scene, scheme: Scheme, parameters: Parameters) -> np.ndarray:
    """Density error that each outflow holds, (world, outflow).

    Raises:
        ValueError: No density has the pressure of an outflow.
    """
    p = parameters.values
    unit, gamma = scene.material.density * p["sound_speed"][:, None] ** 2, p["gamma"][:, None]
    pressure = np.array([outflow.pressure for outflow in scene.outflows.values()])
    with np.errstate(invalid="ignore"):
        held = scheme.state_equation.density_of(pressure / unit, gamma)
    for name, values in zip(scene.outflows, held.T, strict=True):
        if not (np.isfinite(values) & (np.abs(values) < 0.5)).all():
            raise ValueError(
                f"Scene.outflows[{name!r}].pressure = {scene.outflows[name].pressure:g} Pa would take a density error"
                f" of {values[0]:.2g}, limit 0.5, at a sound speed of {p['sound_speed'][0]:g} m/s; use a smaller"
                " pressure or a larger sound speed"
            )
    return held


def make_drains(scene: Scene, scheme: Scheme, parameters: Parameters, device: wp.Device) -> Any:
    """The outflows of a scene."""
    drains: Any = _DRAINS()
    outflows = list(scene.outflows.values())
    if not outflows:
        return drains
    held = held_density(scene, scheme, parameters)
    directions = [outflow.direction for outflow in outflows]
    drains.lower = wp.array(np.array([outflow.region.lower for outflow in outflows]), dtype=float, device=device)
    drains.upper = wp.array(np.array([outflow.region.upper for outflow in outflows]), dtype=float, device=device)
    drains.axis = wp.array([AXES.index(way[1]) if way else -1 for way in directions], dtype=int, device=device)
    drains.sign = wp.array([-1.0 if way and way[0] == "-" else 1.0 for way in directions], dtype=float, device=device)
    drains.field = wp.array(held, dtype=float, device=device)
    return drains


def make_frozen(scene: Scene, scheme: Scheme, device: wp.Device) -> tuple[Any, Any]:
    """Layers of wall particles behind the walls of the box, in cells, and their grid."""
    dim, dx = scene.dim, scene.particle_spacing
    support = scheme.support(dx, dim)
    layers = math.ceil(support / dx - 1e-6)
    frozen: Any = _FROZEN()
    names = face_names(dim)
    lines, inside = [], []
    for axis in range(dim):
        low, high = scene.lower[axis], scene.upper[axis]
        n = round((high - low) / dx)
        before, after = (layers * (scene.faces[name].kind == "wall") for name in names[2 * axis : 2 * axis + 2])
        steps = (np.arange(-before, n + after) + 0.5) / n
        lines.append(low + steps * (high - low))
        inside.append((steps > 0.0) & (steps < 1.0))
    points = np.stack([axis.ravel() for axis in np.meshgrid(*lines, indexing="ij")], axis=1)
    free = np.logical_and.reduce([axis.ravel() for axis in np.meshgrid(*inside, indexing="ij")])
    points = points[~free]
    grid: Any = make_grid(np.asarray(scene.lower) - support, np.asarray(scene.upper) + support, support)
    count = np.array([grid.count[k] for k in range(dim)])
    lower, inv_width = ([float(at[k]) for k in range(dim)] for at in (grid.lower, grid.inv_width))
    place = (points - lower) * inv_width
    cell = np.clip(np.floor(place).astype(int), 0, count - 1) @ np.cumprod([1, *count[:-1]])
    order = np.argsort(cell, kind="stable")
    parts = np.zeros((2 * dim + 1, len(points)))
    parts[:dim] = points[order].T
    frozen.records = pack(parts, device)
    bounds = np.searchsorted(cell[order], np.arange(grid.stride + 1))
    frozen.bounds = wp.array(bounds, dtype=int, device=device)
    return frozen, grid
