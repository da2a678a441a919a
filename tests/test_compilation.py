"""Launches that are captured the second time they come, and not when what they depend on is another."""

import numpy as np
import pytest
import warp as wp

from fluidgym.compilation import OPTIONS, Replay, shared_module


@wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
def add(step: float, source: wp.array[float], target: wp.array[float]):
    i = wp.tid()
    target[i] += source[i] + step


def test_launches_are_replayed_as_long_as_they_are_the_same(device):
    replay, made = Replay(wp.get_device(device)), []
    sources = [wp.full(3, value, dtype=float, device=device) for value in (1.0, 10.0)]
    target = wp.zeros(3, dtype=float, device=device)

    def go(source, step):
        def launch():
            made.append(step)
            wp.launch(add, 3, [step, source], [target], device=device)

        replay(launch, source, step)

    expected = 0.0
    for source, step, launched in [(0, 0.5, 1), (0, 0.5, 2), (0, 0.5, 2), (1, 0.5, 3), (1, 0.25, 4), (1, 0.25, 5)]:
        go(sources[source], step)
        expected += sources[source].numpy()[0] + step
        np.testing.assert_allclose(target.numpy(), expected)
        assert len(made) == launched
    sources[1].fill_(0.0)  # what an array holds is read anew
    go(sources[1], 0.25)
    np.testing.assert_allclose(target.numpy(), expected + 0.25)
    assert len(made) == 5


@pytest.mark.parametrize("name", ["neighbors", "state", "measure", "integrate", "shifting"])
def test_all_modules_are_compiled_alike(name):
    assert OPTIONS.items() <= shared_module(name).options.items()
