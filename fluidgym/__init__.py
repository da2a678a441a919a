"""FluidGym: reinforcement learning on real fluids.

Importing this registers the environments and nothing heavier; the names below load when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register

from fluidgym import precision
from fluidgym._names import check_import_name

if TYPE_CHECKING:
    from fluidgym.scene import (
        Ball,
        Body,
        Box,
        Face,
        Fluid,
        Inflow,
        Material,
        Outflow,
        Particles,
        Region,
        Scene,
    )
    from fluidgym.scheme import Scheme
    from fluidgym.solver import Solver

check_import_name()
precision.install()

__version__ = "0.1.0"

__all__ = [
    "Ball",
    "Body",
    "Box",
    "Face",
    "Fluid",
    "Inflow",
    "Material",
    "Outflow",
    "Particles",
    "Region",
    "Scene",
    "Scheme",
    "Solver",
]

_HOMES = {"Scheme": "fluidgym.scheme", "Solver": "fluidgym.solver"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'fluidgym' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(_HOMES.get(name, "fluidgym.scene")), name)


# A task's name and the dimensions that it comes in; the classes are in fluidgym.envs.TASKS.
_TASKS = {
    "DamBreakContain": (2, 3),
    "DamBreakGate": (2, 3),
    "CarryTank": (2, 3),
    "SloshDamp": (2,),
    "SpreadEven": (2,),
    "JetFill": (2,),
    "LevelHold": (2,),
    "WaveAbsorb": (2,),
}

for _task, _dims in _TASKS.items():
    for _dim in _dims:
        register(
            id=f"fluidgym/{_task}{_dim}D-v0",
            entry_point="fluidgym.envs.fluid_env:FluidEnv",
            vector_entry_point="fluidgym.envs.fluid_vector_env:FluidVectorEnv",
            kwargs={"task": _task, "dim": _dim},
        )
