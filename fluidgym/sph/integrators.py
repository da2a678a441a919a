"""How a step is put together: which shares of it are kicked and drifted before and after the sweeps over pairs.

opening kick   u += share dt a(before)          the two in this order, or drift first
opening drift  x += share dt u
first sweep    density, with these x and u
closing drift  x += share dt u
second sweep   a(x, u)
closing kick   u += share dt a
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Integrator:
    """Shares of a step.

    Attributes:
        name: As in reports.
        opening_kick: Of the velocity, with the acceleration of the step before.
        opening_drift: Of the position.
        closing_drift: Of the position, between the sweeps.
        closing_kick: Of the velocity, with the new acceleration.
        drift_first: Whether the opening drift comes before the opening kick.
    """

    name: str
    opening_kick: float
    opening_drift: float
    closing_drift: float = 0.0
    closing_kick: float = 0.0
    drift_first: bool = False


# Second order; density is advanced with positions and velocities both known at the middle of the step.
KICK_DRIFT_KICK = Integrator("kick-drift-kick", 0.5, 0.5, 0.5, 0.5)
# The same for density by summation, which belongs to the end of the drift. Between steps the velocity is that of the
# leapfrog's half step plus half a kick, so the first step is the half-step kick-off, and what is read is in step.
LEAPFROG = Integrator("leapfrog", 0.5, 1.0, 0.0, 0.5)
SYMPLECTIC_EULER = Integrator("symplectic Euler", 1.0, 1.0)
EXPLICIT_EULER = Integrator("explicit Euler", 1.0, 1.0, drift_first=True)
