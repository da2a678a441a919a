"""How kernels are compiled and launched.

All are compiled with the same flags, as each set of them wants a precompiled header of its own. What is launched again
and again is captured and replayed.
"""

from collections.abc import Callable
from typing import Any

import warp as wp

_FLAGS = "-march=native" if wp.config.cpu_compiler_flags is None else wp.config.cpu_compiler_flags

# Multiply-adds are fused and sums put in any order, which saves 15 % of a step; what is not a number stays so. On CUDA:
# fast division and square roots.
OPTIONS = {
    "cpu_compiler_flags": f"{_FLAGS} -ffp-contract=fast -mreassociate -fno-signed-zeros",
    "fast_math": True,
}


def shared_module(name: str) -> wp.Module:
    """The module of that name, for kernels that are the same in every structure."""
    module = wp.get_module(f"fluidgym.{name}")
    module.options.update(OPTIONS)
    return module


class Replay:
    """Launches that come again and again: a launch takes a CPU 12 to 60 us, a replay two.

    They are captured the second time they come with the same arrays and numbers.
    """

    def __init__(self, device: wp.Device):
        """Nothing is captured yet."""
        self._device = device
        self._given: tuple[Any, ...] = ()
        self._marks: tuple[Any, ...] = ()
        self._graph: Any = None

    def __call__(self, launch: Callable[[], None], *given: Any) -> None:
        """Launch.

        Args:
            launch: Makes the launches, and nothing but launches, copies and fills on the device.
            given: The arrays and numbers that they depend on and that may be others next time.
        """
        marks = tuple(one.ptr if isinstance(one, wp.array) else one for one in given)
        if marks != self._marks:
            self._given, self._marks, self._graph = given, marks, None
            launch()
            return
        if self._graph is None:
            with wp.ScopedCapture(device=self._device) as capture:
                launch()
            self._graph = capture.graph
        wp.capture_launch(self._graph)
