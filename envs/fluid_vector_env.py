"""Many worlds as a gymnasium.vector.VectorEnv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fluidgym.checks import check_choice
from fluidgym.envs import make_task
from fluidgym.envs.runner import Outcome, Runner, check_seed, opened
from fluidgym.envs.screen import MOST_TILES, RENDER_MODES, Look, Screen, tile
from fluidgym.envs.task import Task
from fluidgym.solver import Solver


class FluidVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """A task in many worlds, stepped as one.

    World k is, bit for bit, what a FluidEnv with the same seed and actions is. An action outside the action space is
    clipped into it.
    """

    # Each instance has a copy of its own.
    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": RENDER_MODES,
        "render_fps": 20,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        task: str = "DamBreakContain",
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        colour: str = "speed",
        overlay: bool = False,
        frame_size: tuple[int, int] = (640, 400),
        spheres: bool = False,
        camera: tuple[float, float] | None = None,
        device: str | None = None,
        threads: int | None = None,
        output: str = "numpy",
        **options: Any,
    ):
        """Make the worlds.

        Args:
            num_envs: Number of worlds.
            task: Name of the task.
            max_episode_steps: Episodes are truncated after so many steps, or where the task ends if that is earlier;
                None is where the task ends.
            autoreset_mode: What follows the end of an episode: "NextStep" resets in the next step, whose action is
                not used; "SameStep" resets at once and puts the end into info as final_obs and final_info; "Disabled"
                waits for reset with options={"reset_mask": mask}.
            render_mode: "rgb_array", "human" (up to 16 worlds side by side), or None.
            colour: What frames are coloured by: "speed", "pressure" or "density".
            overlay: Whether the observed grid is laid over frames, in 2D.
            frame_size: Width and height of a frame [pixels].
            spheres: Whether frames show each particle by itself, not the body of water that they make.
            camera: In 3D, how far around the box from the front to the right, and how far up, the eye is [degrees].
            device: "cpu", "cuda", ...; None takes a GPU where there is one.
            threads: How many threads of a CPU share the worlds, at most; None is as many as there are processors.
            output: "numpy", or "torch": observations, rewards and ends are tensors on the device of the fluid, which
                observations never leave; actions may be tensors, too. Infos are arrays of NumPy's either way.
            options: What the task takes; see its class.

        Raises:
            ValueError: An argument is out of its limits.
            MemoryError: So many worlds need more memory than the device has.
        """
        check_choice("output", output, ("numpy", "torch"), "'numpy' or 'torch'")
        if output == "torch" and options.get("obs") == "image":
            raise ValueError("output = 'torch' has no images; use obs='grid', or output='numpy'")
        self._torch = _find_torch() if output == "torch" else None
        posed = make_task(task, **options)
        look = Look(colour, overlay, frame_size, spheres, camera)
        self._screen = Screen(render_mode, posed.control_interval)
        self._mode = _autoreset_mode(autoreset_mode)
        _check_count("num_envs", num_envs)
        if max_episode_steps is not None:
            _check_count("max_episode_steps", max_episode_steps)
        self._runner: Runner | None = Runner(posed, num_envs, device, max_episode_steps, threads, output, look)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.metadata = {**self._screen.metadata(self.metadata), "autoreset_mode": self._mode}
        self.single_observation_space, self.single_action_space = posed.observation_space, posed.action_space
        self.observation_space = batch_space(posed.observation_space, num_envs)
        self.action_space = batch_space(posed.action_space, num_envs)
        self._action_shape = posed.action_space.shape
        self._ended = np.zeros(num_envs, bool)

    @property
    def task(self) -> Task:
        """The task."""
        return opened(self._runner, "task").task

    @property
    def solver(self) -> Solver:
        """The simulated worlds."""
        return opened(self._runner, "solver").solver

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in all worlds, or in some.

        Args:
            seed: Keys of this and the following episodes: s makes world k what a FluidEnv seeded s + k is; a sequence
                has one seed for each world; None goes on with those before.
            options: "reset_mask", bool (world,): the worlds that begin an episode; the others stay as they are.

        Raises:
            ValueError: The seeds or the mask have the wrong shape or type.
            ClosedEnvironmentError: The environment is closed.
        """
        opened(self._runner, "reset")
        worlds = self._reset_mask(options)
        seeds = self._world_seeds(seed)
        outcome = self._begin(worlds, seeds)
        self._show()
        return outcome.observation, _with_masks(outcome.info, worlds)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Go on by one control interval in all worlds.

        Raises:
            ValueError: The actions have the wrong shape or one is not finite; the worlds are as they were.
            ResetNeeded: There was no reset yet, or autoreset is disabled and an ended world was not reset.
            ClosedEnvironmentError: The environment is closed.
        """
        runner = opened(self._runner, "step", begun=True)
        if self._torch is not None and isinstance(actions, self._torch.Tensor):
            actions = actions.detach().cpu().numpy()
        checked = runner.check_actions(actions, "actions", (self.num_envs, *self._action_shape))
        renewed = self._ended
        if self._mode == AutoresetMode.DISABLED and renewed.any():
            ended = np.flatnonzero(renewed).tolist()
            raise ResetNeeded(f"worlds {ended} have ended; call reset(options={{'reset_mask': mask}}) first")
        if renewed.all():
            outcome = self._begin(renewed)
        else:
            outcome = runner.step(checked)
            if renewed.any():
                _merge(outcome, self._begin(renewed), renewed)
        outcome.reward[renewed], outcome.terminated[renewed], outcome.truncated[renewed] = 0.0, False, False
        self._ended = outcome.terminated | outcome.truncated
        final: dict[str, Any] = {}
        ended = self._ended
        if self._mode == AutoresetMode.SAME_STEP and ended.any():
            final = self._final(outcome)
            _merge(outcome, self._begin(ended), ended)
        self._show()
        info = {**final, **_with_masks(outcome.info, np.ones(self.num_envs, bool))}
        reward: Any = outcome.reward
        terminated: Any = outcome.terminated
        truncated: Any = outcome.truncated
        if self._torch is not None:
            to = partial(self._torch.as_tensor, device=outcome.observation.device)
            reward, terminated, truncated = to(reward.astype(np.float32)), to(terminated), to(truncated)
        return outcome.observation, reward, terminated, truncated, info

    def get_state(self, world: int) -> dict[str, np.ndarray]:
        """All that the future of a world depends on, as arrays by name: for planning, and to go on from later.

        Raises:
            IndexError: There is no such world.
            ResetNeeded: There was no reset yet.
            ClosedEnvironmentError: The environment is closed.
        """
        return opened(self._runner, "get_state", begun=True).get_state(world)

    def set_state(self, world: int, state: Mapping[str, np.ndarray]) -> None:
        """Let a world go on from what `get_state` gave, of any world of the same task, bit for bit.

        Raises:
            IndexError: There is no such world.
            ValueError: It is of another task; nothing has happened then.
            ResetNeeded: There was no reset yet.
            ClosedEnvironmentError: The environment is closed.
        """
        opened(self._runner, "set_state", begun=True).set_state(world, state)
        self._ended[world] = False

    def mosaic(self, worlds: Sequence[int] | None = None) -> np.ndarray:
        """Some worlds in one picture (height, width, 3) uint8, row by row in a square, whatever the render mode.

        Args:
            worlds: Which; None is the first sixteen, or all if there are fewer.

        Raises:
            IndexError: There is no such world.
            ValueError: None is named.
            ResetNeeded: There was no reset yet.
            ClosedEnvironmentError: The environment is closed.
        """
        runner = opened(self._runner, "mosaic", begun=True)
        chosen = range(min(self.num_envs, MOST_TILES)) if worlds is None else worlds
        if not len(chosen):
            raise ValueError("worlds is empty; name one or more")
        for world in chosen:
            if not 0 <= world < self.num_envs:
                raise IndexError(f"worlds has {world}, which is outside 0 to {self.num_envs - 1}")
        return tile([runner.frame(world) for world in chosen])

    def render(self) -> tuple[np.ndarray, ...] | None:
        """One picture (height, width, 3) uint8 of each world, or None where the window shows them already.

        Raises:
            ResetNeeded: There was no reset yet.
            ClosedEnvironmentError: The environment is closed.
        """
        runner = opened(self._runner, "render", begun=True)
        if self.render_mode != "rgb_array":
            return None
        return tuple(runner.frame(world) for world in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one, and free the worlds' memory."""
        self._screen.close()
        self._runner = None

    def _begin(self, worlds: np.ndarray, seeds: Sequence[int | None] | None = None) -> Outcome:
        """Begin an episode in the worlds of a mask."""
        outcome = opened(self._runner, "reset").reset(worlds, seeds or [None] * self.num_envs)
        self._ended = self._ended & ~worlds
        return outcome

    def _final(self, outcome: Outcome) -> dict[str, Any]:
        """The end of episodes, as Gymnasium's same-step mode hands it on."""
        ended = self._ended
        observations = np.full(self.num_envs, None, dtype=object)
        for world in np.flatnonzero(ended):
            one = outcome.observation[world]
            observations[world] = one.copy() if self._torch is None else one.clone()
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": _with_masks(outcome.info, ended),
            "_final_info": ended.copy(),
        }

    def _reset_mask(self, options: dict[str, Any] | None) -> np.ndarray:
        if options is None or "reset_mask" not in options:
            return np.ones(self.num_envs, bool)
        mask = options["reset_mask"]
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"options['reset_mask'] = {mask!r} must be a bool array ({self.num_envs},) with a True in it;"
                " give one bool a world"
            )
        if not mask.all():
            opened(self._runner, "reset with a mask", begun=True)
        return mask.copy()

    def _world_seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        """A seed for each world, or None to go on with the one it has."""
        seeds: list[int | None] = [None] * self.num_envs
        if isinstance(seed, Sequence | np.ndarray):
            seeds = [check_seed(one) for one in seed]
            if len(seeds) != self.num_envs:
                raise ValueError(f"seed = {seed!r} must be {self.num_envs} numbers; give one for each world")
        elif (first := check_seed(seed)) is not None:
            super().reset(seed=first)
            return [first + world for world in range(self.num_envs)]
        if opened(self._runner, "reset").needs_seed():
            first = int(self.np_random.integers(2**31))
            seeds = [first + world if one is None else one for world, one in enumerate(seeds)]
        return seeds

    def _show(self) -> None:
        if self.render_mode == "human":
            runner = opened(self._runner, "render")
            self._screen.show([runner.frame(world) for world in range(min(self.num_envs, MOST_TILES))])


def _find_torch() -> Any:
    """PyTorch.

    Raises:
        ValueError: It is not installed.
    """
    try:
        import torch
    except ImportError:
        raise ValueError("output = 'torch' wants PyTorch, which is not installed; pip install torch") from None
    return torch


def _check_count(name: str, count: Any) -> None:
    if not isinstance(count, int | np.integer) or count < 1:
        raise ValueError(f"{name} = {count!r} is not a whole number of 1 or more; give one")


def _autoreset_mode(given: str | AutoresetMode) -> AutoresetMode:
    try:
        return AutoresetMode(given)
    except ValueError:
        known = ", ".join(repr(mode.value) for mode in AutoresetMode)
        raise ValueError(f"autoreset_mode = {given!r} is unknown; use {known}") from None


def _merge(outcome: Outcome, fresh: Outcome, worlds: np.ndarray) -> None:
    """Put what is observed at the start of the worlds of a mask over what was observed before."""
    outcome.observation[worlds] = fresh.observation[worlds]
    for name, values in outcome.info.items():
        values[worlds] = fresh.info[name][worlds]


def _with_masks(info: dict[str, np.ndarray], worlds: np.ndarray) -> dict[str, np.ndarray]:
    """Each array of an info, zero outside the worlds of the mask, and the mask beside it."""
    masked: dict[str, np.ndarray] = {}
    everywhere = worlds.all()
    for name, values in info.items():
        nothing = np.full(len(values), None) if values.dtype == object else np.zeros_like(values)
        masked[name] = values.copy() if everywhere else np.where(worlds, values, nothing)
        masked[f"_{name}"] = worlds.copy()
    return masked
