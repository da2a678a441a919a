"""What a wall of the box is to the fluid. Frozen, and without numbers of any scene."""

from dataclasses import dataclass

from fluidgym.checks import check_range

# Lowest and highest value of each field of the models.
WALL_LIMITS = {"stiffness": (1e-3, 2.0), "margin": (0.1, 4.0), "damping": (0.0, 1.0)}


@dataclass(frozen=True)
class MirrorWalls:
    """Every wall shows the fluid its own image: no particles, no constants to tune (walls.py)."""


@dataclass(frozen=True)
class PenaltyWalls:
    """A spring pushes particles off: a = k (margin - d) n at a distance d below the margin.

    Attributes:
        stiffness: k over (c_0/h)^2.
        margin: Over the particle spacing.

    Raises:
        ValueError: A field is out of its limits.
    """

    stiffness: float = 0.5
    margin: float = 0.5

    def __post_init__(self) -> None:
        check_range("PenaltyWalls.stiffness", self.stiffness, *WALL_LIMITS["stiffness"], "0.5")
        check_range("PenaltyWalls.margin", self.margin, *WALL_LIMITS["margin"], "0.5")


@dataclass(frozen=True)
class ClampWalls:
    """A particle that would cross a wall is put back on it and thrown back with a share of its normal speed.

    Attributes:
        damping: That share.

    Raises:
        ValueError: A field is out of its limits.
    """

    damping: float = 0.3

    def __post_init__(self) -> None:
        check_range("ClampWalls.damping", self.damping, *WALL_LIMITS["damping"], "0.3")


@dataclass(frozen=True)
class FrozenWalls:
    """Layers of particles behind the wall that never move and always have the rest density."""


MIRROR_WALLS = MirrorWalls()

WallModel = MirrorWalls | PenaltyWalls | ClampWalls | FrozenWalls
