"""Environments come and go: memory is given back, other processes may have them, an interrupt leaves all in order."""

import gc
import json
import os
import signal
import subprocess
import sys
import time

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv
from PIL import Image
from stable_baselines3.common.vec_env import SubprocVecEnv

from fluidgym import solver
from fluidgym.__main__ import main
from fluidgym.envs import FluidEnv, FluidVectorEnv

SMALL = {"difficulty": "easy", "device": "cpu"}
ID = "fluidgym/SloshDamp2D-v0"


def resident():
    """Memory that this process holds [MB]."""
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE") / 2.0**20


def make_and_close(times):
    for n in range(times):
        env = FluidVectorEnv(4, "SloshDamp", **SMALL)
        env.reset(seed=n)
        env.step(np.zeros((4, 1)))
        env.close()


# Every Linux has it, and no other system is supported: it runs wherever these tests are meant to.
needs_proc = pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="memory is read from /proc")


@needs_proc
def test_making_and_closing_does_not_grow():
    make_and_close(10)
    before = resident()
    make_and_close(40)
    assert resident() - before < 4.0


@needs_proc
@pytest.mark.slow
def test_making_and_closing_a_thousand_times_does_not_grow(record_property):
    make_and_close(20)
    before = resident()
    make_and_close(1000)
    grown = resident() - before
    record_property("grown_mb", grown)
    assert grown < 8.0


def make():
    return gym.make(ID, **SMALL)


def alone(seed, actions):
    env = make()
    seen = [env.reset(seed=seed)[0]]
    seen += [env.step(action)[0] for action in actions]
    env.close()
    return np.array(seen)


ACTIONS = np.linspace(-1.0, 1.0, 3, dtype=np.float32)[:, None]


@pytest.mark.parametrize("context", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_environments_work_in_workers_of_gymnasium(context):
    expected = [alone(seed, ACTIONS) for seed in (5, 6)]
    envs = AsyncVectorEnv([make, make], context=context)
    try:
        seen = [envs.reset(seed=5)[0]]
        seen += [envs.step(np.stack([action, action]))[0] for action in ACTIONS]
    finally:
        envs.close()
    np.testing.assert_array_equal(np.array(seen).swapaxes(0, 1), expected)


@pytest.mark.parametrize("start", ["forkserver", "spawn"])
def test_environments_work_in_workers_of_stable_baselines(start):
    expected = [alone(seed, ACTIONS) for seed in (5, 6)]
    envs = SubprocVecEnv([make, make], start_method=start)
    try:
        envs.seed(5)
        seen = [envs.reset()]
        seen += [envs.step(np.stack([action, action]))[0] for action in ACTIONS]
    finally:
        envs.close()
    np.testing.assert_array_equal(np.array(seen).swapaxes(0, 1), expected)


def test_an_environment_may_be_closed_twice_and_collected_unclosed():
    env = FluidEnv("SloshDamp", **SMALL)
    env.reset(seed=0)
    env.close()
    env.close()
    FluidEnv("SloshDamp", **SMALL).reset(seed=0)
    gc.collect()


def test_worlds_that_do_not_fit_are_refused_before_memory_is_used_up(monkeypatch, capsys):
    with pytest.raises(MemoryError) as error:
        FluidVectorEnv(10**9, "SloshDamp", **SMALL)
    assert str(error.value).startswith("Solver.num_worlds = 1000000000: 1.6e+11 particles in all need 2.72e+04 GB")
    assert str(error.value).endswith("use fewer worlds or a larger particle_spacing")

    def full(*given, **named):
        raise RuntimeError("Failed to allocate 640000000 bytes on device 'cpu'")

    monkeypatch.setattr(solver, "State", full)
    with pytest.raises(MemoryError, match="use fewer worlds or a larger particle_spacing"):
        FluidVectorEnv(2, "SloshDamp", **SMALL)
    assert main(["evaluate", "SloshDamp2D-v0", "--device", "cpu"]) == 2
    said = capsys.readouterr().err
    assert "use fewer worlds" in said and len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("command", "files"),
    [
        (["stress", "12", "--hours", "1", "--json", "found.json"], {"found.json"}),
        (["stress", "4", "--hours", "1", "--jobs", "2", "--json", "soaked.json"], {"soaked.json"}),
        (["evaluate", "CarryTank2D-v0", "--episodes", "64", "--json", "scores.json"], {"scores.json"}),
        (["play", "CarryTank3D-v0", "--difficulty", "hard", "--film", "film.gif"], {"film.gif"}),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_an_interrupt_is_told_in_a_line_and_leaves_no_half_file(command, files, tmp_path):
    # An interrupt may be ignored where tests run in the background, and what they start inherits that.
    heeding = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
        " from fluidgym.__main__ import main; sys.exit(main(sys.argv[1:]))"
    )
    arguments = [sys.executable, "-c", heeding, *command, "--device", "cpu"]
    with subprocess.Popen(
        arguments, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        time.sleep(8.0)
        assert process.poll() is None, "over before it was interrupted"
        process.send_signal(signal.SIGINT)
        try:
            _, said = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert process.returncode == 130, said
    assert "Traceback" not in said
    left = {path.name for path in tmp_path.iterdir()} - {"outputs"}
    assert left <= files
    for name in left:
        if name.endswith(".json"):
            json.loads((tmp_path / name).read_text())
        if name == "film.gif":  # what was seen until then
            assert Image.open(tmp_path / name).n_frames >= 1
