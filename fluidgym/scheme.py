"""How it is simulated: smoothing, terms, state equation, step limits. Frozen, hashable, and no numbers of any scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from fluidgym.scene import check_type
from fluidgym.sph.continuity import DENSITY_DIFFUSION, DIVERGENCE
from fluidgym.sph.pressure import PRESSURE_GRADIENT
from fluidgym.sph.smoothing import WENDLAND_C2, SmoothingKernel
from fluidgym.sph.state_equation import LINEAR, StateEquation
from fluidgym.sph.terms import DensityRate, Drag, Force, Term
from fluidgym.sph.viscosity import ARTIFICIAL_VISCOSITY, VISCOSITY_MORRIS


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """Weakly compressible delta-SPH with mirror-image walls. Its fields are given by name.

    Attributes:
        kernel: Smoothing kernel.
        smoothing_ratio: Smoothing length over particle spacing, h/dx; None is 1.5 in 2D and 1.3 in 3D.
        state_equation: Pressure from density, LINEAR or TAIT.
        gamma: Exponent of TAIT.
        density_diffusion: delta of the density diffusion (Marrone et al. 2011); 0 leaves the term out.
        artificial_viscosity: alpha of the artificial viscosity, which makes up what the fluid's own lacks of it; 0
            leaves it out.
        viscosity: Form of the fluid's own viscosity, VISCOSITY_MORRIS or VISCOSITY_MONAGHAN; left out where there is
            none.
        courant: Time step over h / (c_0 + largest expected speed).
        terms: Further terms, added to those the fields above imply.

    Raises:
        ValueError: A field is of a wrong type or out of its limits.
    """

    kernel: SmoothingKernel = WENDLAND_C2
    smoothing_ratio: float | None = None
    state_equation: StateEquation = LINEAR
    gamma: float = 7.0
    density_diffusion: float = 0.1
    artificial_viscosity: float = 0.01
    viscosity: Force | Drag = VISCOSITY_MORRIS
    courant: float = 1.0
    terms: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        limits = {
            "smoothing_ratio": (1.0, 3.0, "1.3 to 2"),
            "gamma": (1.0, 10.0, "7"),
            "density_diffusion": (0.0, 0.5, "0.1"),
            "artificial_viscosity": (0.0, 1.0, "0.01"),
            "courant": (1e-6, 2.0, "1.0"),
        }
        for name, (low, high, advice) in limits.items():
            if name == "smoothing_ratio" and self.smoothing_ratio is None:
                continue
            value = getattr(self, name)
            check_type(f"Scheme.{name}", value, Real, "a number", advice)
            if not low <= value <= high:
                raise ValueError(f"Scheme.{name} = {value:g} is outside {low:g} to {high:g}; use {advice}")
        kinds = {
            "kernel": (SmoothingKernel, "a SmoothingKernel", "WENDLAND_C2"),
            "state_equation": (StateEquation, "a StateEquation", "LINEAR or TAIT"),
            "viscosity": ((Force, Drag), "a Force or Drag", "VISCOSITY_MORRIS or VISCOSITY_MONAGHAN"),
            "terms": (tuple, "a tuple", "(Force(function),)"),
        }
        for name, kind in kinds.items():
            check_type(f"Scheme.{name}", getattr(self, name), *kind)
        for index, term in enumerate(self.terms):
            check_type(f"Scheme.terms[{index}]", term, Term, "a DensityRate, Force or Drag", "Force(function)")

    def smoothing_length(self, spacing: float, dim: int) -> float:
        """Smoothing length h [m] for a particle spacing [m]."""
        return spacing * (self.smoothing_ratio or {2: 1.5, 3: 1.3}[dim])

    def density_terms(self) -> tuple[DensityRate, ...]:
        """The terms of ds/dt."""
        diffusion = (DENSITY_DIFFUSION,) if self.density_diffusion else ()
        return (DIVERGENCE, *diffusion, *(t for t in self.terms if isinstance(t, DensityRate)))

    def force_terms(self, viscous: bool) -> tuple[Force | Drag, ...]:
        """The terms of du/dt, for a fluid with viscosity of its own or without."""
        artificial = (ARTIFICIAL_VISCOSITY,) if self.artificial_viscosity else ()
        laminar = (self.viscosity,) if viscous else ()
        return (PRESSURE_GRADIENT, *artificial, *laminar, *(t for t in self.terms if not isinstance(t, DensityRate)))

    def time_step(self, h: float, sound_speed: float, speed: float, viscosity: float, gravity: float) -> float:
        """Largest stable time step [s]: sound, viscosity and body force each set a limit.

        Monaghan (1992) eq. 10; the factors are measured ones of this integrator.
        """
        step = self.courant * h / (sound_speed + speed)
        if viscosity:
            step = min(step, 0.125 * h * h / viscosity)
        if gravity:
            step = min(step, 0.5 * math.sqrt(h / gravity))
        return step


DEFAULT_SCHEME = Scheme()
