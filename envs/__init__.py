"""The Gymnasium layer: tasks, the runner that steps them, and the environments.

A new task is one file in `envs/tasks/`, its line here, and its ids in `fluidgym/__init__.py`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fluidgym.envs.fluid_env import FluidEnv
    from fluidgym.envs.fluid_vector_env import FluidVectorEnv
    from fluidgym.envs.task import Task

__all__ = ["TASKS", "FluidEnv", "FluidVectorEnv", "Task", "make_task"]

# Where the class of each task is. It is loaded when it is first used, as the simulator comes with it.
TASKS = {
    "DamBreakContain": "fluidgym.envs.tasks.dam_break_contain:DamBreakContain",
    "DamBreakGate": "fluidgym.envs.tasks.dam_break_contain:DamBreakGate",
    "CarryTank": "fluidgym.envs.tasks.carry_tank:CarryTank",
    "SloshDamp": "fluidgym.envs.tasks.slosh_damp:SloshDamp",
    "SpreadEven": "fluidgym.envs.tasks.spread_even:SpreadEven",
    "JetFill": "fluidgym.envs.tasks.jet_fill:JetFill",
    "LevelHold": "fluidgym.envs.tasks.level_hold:LevelHold",
    "WaveAbsorb": "fluidgym.envs.tasks.wave_absorb:WaveAbsorb",
}

_HOMES = {
    "FluidEnv": "fluidgym.envs.fluid_env",
    "FluidVectorEnv": "fluidgym.envs.fluid_vector_env",
    "Task": "fluidgym.envs.task",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'fluidgym.envs' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(_HOMES[name]), name)


def make_task(name: str, **options: Any) -> "Task":
    """The task of that name.

    Args:
        name: A key of TASKS.
        options: What the task takes; see its class.

    Raises:
        ValueError: There is no such task or option, or an option is out of its limits.
    """
    if name not in TASKS:
        raise ValueError(f"task = {name!r} is unknown; use {', '.join(map(repr, TASKS))}")
    module, _, attribute = TASKS[name].partition(":")
    task_class = getattr(import_module(module), attribute)
    task_class.check_options(options)
    return task_class(**options)
