"""Many worlds for Stable-Baselines3, which takes no Gymnasium vector environment: pip install "fluidgym-sph[sb3]"."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from fluidgym.envs.fluid_vector_env import FluidVectorEnv

_OF_THE_END = ("final_obs", "final_info")


class SB3VecEnv(VecEnv):
    """A FluidVectorEnv as Stable-Baselines3 wants it: worlds are reset at once, and infos are a list of dicts.

    Wrap it in VecMonitor or VecNormalize like any other.
    """

    def __init__(self, env_id: str, num_envs: int = 8, seed: int | None = None, **options: Any):
        """Make the worlds.

        Args:
            env_id: Such as "fluidgym/CarryTank2D-v0".
            num_envs: Number of worlds.
            seed: Of the first reset; world k has seed + k. None draws one.
            options: What `gymnasium.make_vec` takes besides.

        Raises:
            ValueError: An argument is out of its limits, or the environment is none of this package.
        """
        if not env_id.startswith("fluidgym/"):
            raise ValueError(f"env_id = {env_id!r} is not of FluidGym; use one that begins with fluidgym/")
        made: Any = gymnasium.make_vec(env_id, num_envs=num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **options)
        self.envs: FluidVectorEnv = made
        super().__init__(num_envs, made.single_observation_space, made.single_action_space)
        self._actions = np.zeros((num_envs, *made.single_action_space.shape), np.float32)
        if seed is not None:
            self.seed(seed)

    def reset(self) -> np.ndarray:
        """Begin an episode in every world."""
        given: Any = self._seeds
        seeds = None if None in given else [int(seed) for seed in given]
        observation, info = self.envs.reset(seed=seeds)
        self.reset_infos = _listed(info, self.num_envs)
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take the step."""
        observation, reward, terminated, truncated, info = self.envs.step(self._actions)
        ended = terminated | truncated
        infos = _listed({name: values for name, values in info.items() if name not in _OF_THE_END}, self.num_envs)
        for world in np.flatnonzero(ended).tolist():
            self.reset_infos[world] = infos[world]
            infos[world] = {
                **{name: values[world] for name, values in info["final_info"].items() if not name.startswith("_")},
                "terminal_observation": info["final_obs"][world],
                "TimeLimit.truncated": bool(truncated[world] and not terminated[world]),
            }
        return observation, reward.astype(np.float32), ended, infos

    def close(self) -> None:
        """Free the worlds."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """A picture of each world."""
        return self.envs.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute, the same for every world."""
        return [getattr(self.envs, attr_name)] * len(self._indices(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of all worlds.

        Raises:
            ValueError: It is asked for some of them only.
        """
        if len(self._indices(indices)) != self.num_envs:
            raise ValueError(f"SB3VecEnv.set_attr {attr_name!r} of some worlds is not possible; set it for all")
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> Any:
        """Call a method of the vector environment: the same for every world."""
        found = getattr(self.envs, method_name)(*method_args, **method_kwargs)
        return [found] * len(self._indices(indices))

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Worlds of a batch have no wrappers of their own."""
        return [False] * len(self._indices(indices))

    def _indices(self, indices: VecEnvIndices) -> Sequence[int]:
        return list(self._get_indices(indices))


def _listed(info: dict[str, Any], worlds: int) -> list[dict[str, Any]]:
    """A dict of arrays as a dict for each world."""
    names = [name for name in info if not name.startswith("_")]
    return [{name: info[name][world] for name in names} for world in range(worlds)]
