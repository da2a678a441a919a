"""How it is simulated: smoothing, terms, state equation, step limits. Frozen, hashable, and no numbers of any scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import NoneType
from typing import Any, Literal

from fluidgym.checks import check_choice, check_range, check_type
from fluidgym.scene import LEAST_MACH_MARGIN, MACH_MARGIN
from fluidgym.sph.continuity import CENTRAL_DIFFUSION, DENSITY_DIFFUSION, DIVERGENCE
from fluidgym.sph.integrators import KICK_DRIFT_KICK, LEAPFROG, Integrator
from fluidgym.sph.mueller import KERNEL_VISCOSITY, POLY6_SUMMATION, spiky_pressure
from fluidgym.sph.pressure import PRESSURE_GRADIENT
from fluidgym.sph.smoothing import POLY6, WENDLAND_C2, WENDLAND_C4, SmoothingKernel
from fluidgym.sph.state_equation import LINEAR, StateEquation, itself, torn_at
from fluidgym.sph.terms import DensityRate, DensitySum, Drag, Force, Term
from fluidgym.sph.viscosity import ARTIFICIAL_VISCOSITY, VISCOSITY_MORRIS
from fluidgym.sph.wall_models import MIRROR_WALLS, MirrorWalls, PenaltyWalls, WallModel

# Lowest and highest value of each number, and what to use.
LIMITS = {
    "smoothing_ratio": (1.0, 3.0, "1.5 to 2.2"),
    "gamma": (1.0, 10.0, "7"),
    "density_diffusion": (0.0, 0.5, "0.1"),
    "artificial_viscosity": (0.0, 1.0, "0.0003 to 0.01"),
    "acoustic_damping": (0.0, 2.0, "0.7"),
    "tear": (1e-3, 1.0, "0.03"),
    "shifting": (0.0, 4.0, "2.0"),
    "surface_shifting": (0.0, 8.0, "4.0"),
    "core": (0.0, 4.0, "1.0"),
    "sound_speed_ratio": (LEAST_MACH_MARGIN, 1000.0, "10"),
    "courant": (1e-6, 2.0, "1.0"),
}

PRESETS = ("delta", "mueller")


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """How a scene is simulated. Its fields are given by name; left out, they are weakly compressible delta-SPH.

    Attributes:
        preset: "delta" advances the density by the continuity equation and has mirror-image walls; "mueller" sums it up
            with Poly6 and takes the forces of Mueller, Charypar & Gross (2003).
        kernel: Smoothing kernel of the delta preset's terms and of `terms`; None is WENDLAND_C4 in 2D and WENDLAND_C2
            in 3D. Mueller has its own.
        smoothing_ratio: Smoothing length over particle spacing, h/dx; None is 2 in 2D and 1.5 in 3D, times the kernel's
            breadth, and 2 for mueller, whose kernels end at h.
        state_equation: Pressure from density, LINEAR or TAIT.
        gamma: Exponent of TAIT.
        tension: Whether pressure may be negative; None is yes, and no for mueller.
        tear: Largest tension, over rho_0 c_0^2: beyond it fluid tears. The last drops of a splash are few and far
            apart, where sums know little; tension without end flings them together, and off at half the speed of sound.
            The default is six times the suction of the reference speed at Mach 0.1. Not of mueller.
        density_diffusion: delta of the density diffusion (Marrone et al. 2011); 0 leaves the term out. Not of mueller.
        artificial_viscosity: alpha of the artificial viscosity, which makes up what the fluid's own lacks of it; 0
            leaves it out.
        acoustic_damping: b of a pressure b rho_0 c_0 h div u that opposes compression and so damps sound (Sun et al.
            2023); 0 leaves it out. Not of mueller.
        shifting: A of the particle shifting (shifting.py), which keeps particles from disorder in scenes that are and
            stay full of fluid (Scene.is_full) between mirror-image walls and periodic faces; 0 leaves it out. Not of
            mueller.
        surface_shifting: A of the shifting of all other fluid between such walls, where what is near a surface is only
            kept from clumping: for fluid that flies, spins or is torn; not for what lies under gravity, whose surface
            it lifts (shifting.py). 0 leaves it out. Not of mueller.
        core: How much steeper than the kernel the slope W' is where a pair comes close, at r = 0 and over the kernel's
            own (smoothing.with_core); it keeps particles from merging where they have few neighbours. None is 1 in 2D,
            and 0 in 3D, whose narrower kernel needs none; 0 leaves it out. Not of mueller.
        viscosity: Form of the fluid's own viscosity, VISCOSITY_MORRIS, VISCOSITY_MONAGHAN or KERNEL_VISCOSITY; None is
            the preset's. Left out where the fluid has none.
        integrator: KICK_DRIFT_KICK, LEAPFROG, SYMPLECTIC_EULER or EXPLICIT_EULER; None is KICK_DRIFT_KICK, and LEAPFROG
            for mueller.
        walls: MirrorWalls(), PenaltyWalls(), ClampWalls() or FrozenWalls().
        sound_speed_ratio: Speed of sound over the largest expected speed, where the material does not name it.
        courant: Time step over h / (c_0 + largest expected speed), where sound is not damped; None is 1, and 0.4 for
            mueller.
        terms: Further terms, added to those the fields above imply.

    Raises:
        ValueError: A field is of a wrong type, out of its limits, or goes with no other.
    """

    preset: Literal["delta", "mueller"] = "delta"
    kernel: SmoothingKernel | None = None
    smoothing_ratio: float | None = None
    state_equation: StateEquation = LINEAR
    gamma: float = 7.0
    tension: bool | None = None
    tear: float = 0.03
    density_diffusion: float = 0.1
    artificial_viscosity: float = 0.0003
    acoustic_damping: float = 0.7
    shifting: float = 2.0
    surface_shifting: float = 0.0
    core: float | None = None
    viscosity: Force | Drag | None = None
    integrator: Integrator | None = None
    walls: WallModel = MIRROR_WALLS
    sound_speed_ratio: float = MACH_MARGIN
    courant: float | None = None
    terms: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        check_choice("Scheme.preset", self.preset, PRESETS, " or ".join(map(repr, PRESETS)))
        mueller = self.preset == "mueller"
        kinds = {
            "kernel": ((SmoothingKernel, NoneType), "a SmoothingKernel", "WENDLAND_C2"),
            "state_equation": (StateEquation, "a StateEquation", "LINEAR or TAIT"),
            "viscosity": ((Force, Drag, NoneType), "a Force or Drag", "VISCOSITY_MORRIS or VISCOSITY_MONAGHAN"),
            "integrator": ((Integrator, NoneType), "an Integrator", "KICK_DRIFT_KICK or LEAPFROG"),
            "walls": (WallModel, "a wall model", "MirrorWalls(), PenaltyWalls(), ClampWalls() or FrozenWalls()"),
            "tension": ((bool, NoneType), "a bool", "True or False"),
            "terms": (tuple, "a tuple", "(Force(function),)"),
        }
        for name, kind in kinds.items():
            check_type(f"Scheme.{name}", getattr(self, name), *kind)
        defaults = {
            "tension": not mueller,
            "viscosity": KERNEL_VISCOSITY if mueller else VISCOSITY_MORRIS,
            "integrator": LEAPFROG if mueller else KICK_DRIFT_KICK,
            "courant": 0.4 if mueller else 1.0,
        }
        for name, value in defaults.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        for name, (low, high, advice) in LIMITS.items():
            if name in ("smoothing_ratio", "core") and getattr(self, name) is None:
                continue
            check_range(f"Scheme.{name}", getattr(self, name), low, high, advice)
        for index, term in enumerate(self.terms):
            check_type(f"Scheme.terms[{index}]", term, Term, "a DensityRate, Force or Drag", "Force(function)")
        self._check_together()

    def _check_together(self) -> None:
        """Refuse fields that do not go together."""
        assert self.integrator is not None
        if self.preset == "mueller" and self.integrator.closing_drift:
            raise ValueError(
                f"Scheme.integrator = {self.integrator.name} moves particles after their density is summed up; use"
                " LEAPFROG, SYMPLECTIC_EULER or EXPLICIT_EULER with the preset 'mueller'"
            )
        if self.preset == "mueller" and self.kernel is not None and self.kernel is not POLY6:
            raise ValueError(
                f"Scheme.kernel = {self.kernel.name} is of no effect on the preset 'mueller'; leave it out"
            )
        forces = self.force_terms(viscous=True)
        if self.preset == "mueller" and any(isinstance(term, DensityRate | DensitySum) for term in self.terms):
            raise ValueError("Scheme.terms has a DensityRate, for which preset 'mueller' has no place; leave it out")
        if self.surface_shifting and (self.preset == "mueller" or not isinstance(self.walls, MirrorWalls)):
            raise ValueError(
                f"Scheme.surface_shifting = {self.surface_shifting:g} is of no effect but with the preset 'delta' and"
                " walls = MirrorWalls(); leave it out"
            )
        if self.preset == "delta" and any(term.reads_density for term in forces):
            raise ValueError("Scheme.viscosity = KERNEL_VISCOSITY needs the preset 'mueller'; use VISCOSITY_MORRIS")

    def kernel_in(self, dim: int) -> SmoothingKernel:
        """The smoothing kernel in a number of dimensions."""
        if self.preset == "mueller":
            return POLY6
        return self.kernel or {2: WENDLAND_C4, 3: WENDLAND_C2}[dim]

    def core_in(self, dim: int) -> float:
        """The core of the smoothing kernel in a number of dimensions; 0 is none."""
        if self.preset == "mueller":
            return 0.0
        return {2: 1.0, 3: 0.0}[dim] if self.core is None else self.core

    def smoothing_length(self, spacing: float, dim: int) -> float:
        """Smoothing length h [m] for a particle spacing [m]."""
        usual = 2.0 if self.preset == "mueller" else {2: 2.0, 3: 1.5}[dim] * self.kernel_in(dim).breadth
        return spacing * (self.smoothing_ratio or usual)

    def support(self, spacing: float, dim: int) -> float:
        """Distance beyond which the smoothing kernel is zero [m], for a particle spacing [m]."""
        return self.kernel_in(dim).support * self.smoothing_length(spacing, dim)

    @property
    def pressure_law(self) -> StateEquation:
        """The state equation, with no more tension than there may be."""
        if self.tension and self.preset == "mueller":
            return self.state_equation
        return torn_at(self.state_equation, self.tear if self.tension else 0.0)

    @property
    def steps(self) -> Integrator:
        """The integrator."""
        assert self.integrator is not None
        return self.integrator

    def force_field(self) -> Any:
        """Warp function (s, Constants) -> what the force terms read: P, or s where the preset's do."""
        return itself if self.preset == "mueller" else self.pressure_law.pressure

    def terms_in_use(
        self, viscous: bool, diffusive: bool, artificial: bool, central: bool = False
    ) -> tuple[tuple[DensityRate | DensitySum, ...], tuple[Force | Drag, ...]]:
        """What makes the density and the terms of du/dt, where the fluid and the scheme have these or have not.

        Args:
            viscous: Whether the fluid has viscosity of its own.
            diffusive: Whether there is density diffusion.
            artificial: Whether there is artificial viscosity.
            central: Whether there is a central force.
        """
        rates = tuple(term for term in self.terms if isinstance(term, DensityRate | DensitySum))
        forces = tuple(term for term in self.terms if isinstance(term, Force | Drag))
        diffusion = CENTRAL_DIFFUSION if central else DENSITY_DIFFUSION
        density = (DIVERGENCE, *((diffusion,) if diffusive else ()), *rates)
        pressure = PRESSURE_GRADIENT
        if self.preset == "mueller":
            density, pressure = (POLY6_SUMMATION,), spiky_pressure(self.pressure_law)
        laminar = (self.viscosity,) if viscous and self.viscosity else ()
        return density, (pressure, *((ARTIFICIAL_VISCOSITY,) if artificial else ()), *laminar, *forces)

    def density_terms(self) -> tuple[DensityRate | DensitySum, ...]:
        """What makes the density: a sum, or the terms of ds/dt."""
        return self.terms_in_use(False, self.density_diffusion > 0.0, False)[0]

    def force_terms(self, viscous: bool) -> tuple[Force | Drag, ...]:
        """The terms of du/dt, for a fluid with viscosity of its own or without."""
        return self.terms_in_use(viscous, False, self.artificial_viscosity > 0.0)[1]

    def time_step(
        self,
        h: float,
        sound_speed: float,
        speed: float,
        viscosity: float,
        gravity: float,
        diffusion: float = 0.0,
        damping: float = 0.0,
    ) -> float:
        """Largest stable time step [s]: sound, diffusion of density, viscosity and body force each set a limit.

        Monaghan (1992) eq. 10; the factors are measured ones of the default integrator.

        Args:
            h: Smoothing length [m].
            sound_speed: c_0 [m/s].
            speed: Largest expected speed [m/s].
            viscosity: Of momentum, or the thermal diffusivity if that is larger [m2/s].
            gravity: Size of the body force [m/s2].
            diffusion: delta.
            damping: b.
        """
        assert self.courant is not None
        # The shortest wave that a lattice carries at speed c_0 is stable to the step 1.5 h/c_0; damped by b h c_0 in an
        # explicit step, to where (c_0 dt/h)^2 + 2 b c_0 dt/h is 1.5^2.
        slower = (math.sqrt(damping**2 + 2.25) - damping) / 1.5
        step = self.courant * h / (sound_speed / slower + speed)
        if diffusion:
            # An explicit step ends at h / (2 delta c_0 sum V h^2 |W'/r|), a sum of 3 to 4 on a lattice.
            step = min(step, h / (6.0 * diffusion * sound_speed))
        if viscosity:
            # Along the line of a pair, as Monaghan has it, viscosity is stiffer between walls that stick.
            step = min(step, (0.125 if isinstance(self.viscosity, Drag) else 0.06) * h * h / viscosity)
        if gravity:
            step = min(step, 0.5 * math.sqrt(h / gravity))
        return step


DEFAULT_SCHEME = Scheme()

# The method this field began with: all springs and no mirrors. Its walls may be any of the others.
MUELLER = Scheme(preset="mueller", walls=PenaltyWalls(), artificial_viscosity=0.0)

# Named trade-offs between run time and error; environments, scene files and the command line take them by these names.
FIDELITIES: dict[str, Scheme] = {
    "fast": Scheme(sound_speed_ratio=7.0, acoustic_damping=0.5),
    "balanced": DEFAULT_SCHEME,
    "accurate": Scheme(acoustic_damping=1.0),
}
