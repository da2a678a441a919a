"""What is compiled in: the shape of a scene and a scheme, without their numbers."""

from dataclasses import dataclass

import warp as wp

from fluidgym.sph.integrators import KICK_DRIFT_KICK, Integrator
from fluidgym.sph.terms import DensityRate, DensitySum, Drag, Force


@dataclass(frozen=True)
class Structure:
    """What a kernel is made for. Two scenes of one structure share their kernels; what is absent leaves no code behind.

    Attributes:
        dim: Number of dimensions.
        kinds: Of each face: "mirror" shows the fluid its image, "bare" only keeps it in, "open", or "periodic",
            (2 * dim,).
        no_slip: Whether viscosity holds the fluid at each face, (2 * dim,).
        warm_faces: Whether each face has a temperature of its own, (2 * dim,).
        density_terms: What makes the density.
        force_terms: What makes the acceleration.
        slope: Warp function (r, Constants) -> W'(r)/r, with the core of the kernel if it has one.
        weight: The same without its core, which weighs a particle's company.
        field: Warp function (s, Constants) -> what the force terms read.
        integrator: How the step is put together.
        gravity: Whether there is gravity, or could be: it tilts the fields that images and diffusion see.
        damped: Whether sound is damped.
        leaning: Whether the diffusion of density knows the accelerations.
        central: Whether the origin pulls.
        wall: What a bare face does: "penalty", "clamp" or "frozen".
        balls: Whether each body is a ball; the others are boxes, (body,).
        hiding: Whether a body is so thin that it may come between two particles that would else meet.
        no_slip_bodies: Whether viscosity holds the fluid at each body, (body,).
        warm_bodies: Whether each body has a temperature of its own, (body,).
        round_pipes: Whether each nozzle's pipe is round, (inflow,).
        drains: Number of outflows.
        heat: Whether heat is conducted.
        shift: The term of the particle shifting, or None without.
        surface: Whether what is shifted has a surface: the term then reads how crowded particles are.
        forces: Whether forces on faces and bodies are added up.
        plain: Whether the pair loop is its twin in plain Warp.
        half: Whether each pair of particles is met once and serves both, which wants their threads one after another.
    """

    dim: int
    kinds: tuple[str, ...]
    no_slip: tuple[bool, ...]
    density_terms: tuple[DensityRate | DensitySum, ...]
    force_terms: tuple[Force | Drag, ...]
    slope: wp.Function
    weight: wp.Function
    field: wp.Function
    warm_faces: tuple[bool, ...] = ()
    integrator: Integrator = KICK_DRIFT_KICK
    gravity: bool = True
    central: bool = False
    damped: bool = False
    leaning: bool = False
    wall: str = "mirror"
    balls: tuple[bool, ...] = ()
    hiding: bool = False
    no_slip_bodies: tuple[bool, ...] = ()
    warm_bodies: tuple[bool, ...] = ()
    round_pipes: tuple[bool, ...] = ()
    drains: int = 0
    heat: bool = False
    shift: Force | None = None
    surface: bool = False
    forces: bool = False
    plain: bool = False
    half: bool = False

    @property
    def half_images(self) -> bool:
        """Whether a pair serves both in what they see of each other's images, too.

        Then the images are mirror images all, of one pull, without signs; none is hidden by a body from one of the two,
        and nobody asks what each wall does.
        """
        odd = "periodic" in self.kinds or any(self.no_slip) or self.central or self.hiding or self.forces
        return self.half and not odd

    @property
    def bare_width(self) -> int:
        """Parts of a record that is place, velocity and field."""
        return 2 * self.dim + 1

    @property
    def middle_width(self) -> int:
        """Parts of a record at the middle of a step: density error for a field, and the acceleration where it leans."""
        return self.bare_width + self.dim * self.leaning

    @property
    def end_width(self) -> int:
        """Parts of a record at the end of a step: what the force terms read for a field, temperature, and crowd.

        The last two where they are of use.
        """
        return self.bare_width + self.heat + self.surface

    @property
    def has_images(self) -> bool:
        """Whether a particle may have images."""
        return "mirror" in self.kinds or "periodic" in self.kinds

    @property
    def has_walls(self) -> bool:
        """Whether there are walls of any kind."""
        return "mirror" in self.kinds or "bare" in self.kinds

    @property
    def frozen(self) -> bool:
        """Whether there are frozen wall particles."""
        return self.wall == "frozen" and "bare" in self.kinds

    @property
    def summed(self) -> bool:
        """Whether density is a sum, not advanced."""
        return any(isinstance(term, DensitySum) for term in self.density_terms)

    @property
    def leveled(self) -> bool:
        """Whether particles are shifted in a full box, where the pressure has a level of its own (shifting.py)."""
        return self.shift is not None and not self.surface

    @property
    def carried(self) -> bool:
        """Whether there are places where particles are carried, not pushed: pipes and outflows."""
        return bool(self.round_pipes) or self.drains > 0
