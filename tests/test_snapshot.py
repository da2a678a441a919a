"""States in files: bit for bit, whole or not at all, and nothing else taken for one."""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from fluidgym import snapshot
from fluidgym.envs import FluidEnv, FluidVectorEnv
from fluidgym.scene import Box, Fluid, Scene
from fluidgym.solver import Solver

SMALL = {"task": "SloshDamp", "difficulty": "easy", "device": "cpu"}


def test_a_state_comes_back_bit_for_bit(tmp_path):
    env = FluidEnv(**SMALL)
    env.reset(seed=4)
    for _ in range(3):
        env.step(env.action_space.sample())
    state = env.get_state()
    snapshot.save(state, tmp_path / "state.npz")
    read = snapshot.load(tmp_path / "state.npz")
    assert read.keys() == state.keys()
    for name, array in state.items():
        assert read[name].dtype == array.dtype and (read[name] == array).all(), name
    ahead = [env.step([0.5])[:2] for _ in range(3)]
    envs = FluidVectorEnv(3, **SMALL)
    envs.reset(seed=9)
    envs.set_state(1, read)
    for observation, reward in ahead:
        step = envs.step(np.full((3, 1), 0.5))
        assert (step[0][1] == observation).all()
        assert step[1][1] == reward


def test_a_solver_goes_on_from_a_file(tmp_path):
    def solver():
        return Solver(Scene((0.0, 0.0), (1.0, 1.0), 0.1, [Fluid(Box((0.0, 0.0), (0.5, 0.5)))]), device="cpu")

    one, other = solver(), solver()
    one.step(5)
    snapshot.save(one.save(), tmp_path / "solver.npz")
    other.restore(snapshot.load(tmp_path / "solver.npz"))
    for each in (one, other):
        each.step(5)
    assert (one.particles().position == other.particles().position).all()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "state.npz"
    snapshot.save({"a": np.arange(1000.0), "b": np.zeros((2, 3), np.int32)}, path)
    return path


def test_a_file_cut_short_is_refused_wherever_it_is_cut(file):
    whole = file.read_bytes()
    for length in [*range(0, len(whole), 97), len(whole) - 1]:
        file.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="no snapshot or cut short") as error:
            snapshot.load(file)
        assert len(str(error.value).splitlines()) == 1


def test_an_altered_byte_is_noticed(file):
    whole = file.read_bytes()
    numbers = np.arange(1000.0).tobytes()
    at = whole.index(numbers[800:1600])
    file.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with pytest.raises(ValueError, match=r"cut short|damaged"):
        snapshot.load(file)


def test_what_another_program_wrote_is_refused(file, tmp_path, monkeypatch):
    np.savez(file, a=np.zeros(3))
    with pytest.raises(ValueError, match="no snapshot"):
        snapshot.load(file)
    np.savez(file, a=np.array([{"an": "object"}], dtype=object))
    with pytest.raises(ValueError, match="no snapshot"):
        snapshot.load(file)
    monkeypatch.setattr(snapshot, "VERSION", 2)
    snapshot.save({"a": np.zeros(3)}, file)
    monkeypatch.undo()
    with pytest.raises(ValueError, match=r"has version 2, limit 1; write it anew"):
        snapshot.load(file)


def test_a_changed_array_fails_the_checksum(file, monkeypatch):
    monkeypatch.setattr(snapshot, "_checksum", lambda arrays: "another")
    snapshot.save({"a": np.zeros(3)}, file)
    monkeypatch.undo()
    with pytest.raises(ValueError, match="its checksum differs"):
        snapshot.load(file)


def test_bad_calls_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"does not end with \.npz"):
        snapshot.save({}, tmp_path / "state.pickle")
    with pytest.raises(FileNotFoundError, match="does not exist; make it first"):
        snapshot.save({}, tmp_path / "gone" / "state.npz")
    with pytest.raises(FileNotFoundError, match="does not exist"):
        snapshot.load(tmp_path / "gone.npz")
    with pytest.raises(ValueError, match="holds objects"):
        snapshot.save({"a": np.array([object()])}, tmp_path / "state.npz")
    assert list(tmp_path.iterdir()) == []


# Writes a large state over and over, each time a whole one with a number of its own.
WRITER = """
import sys
import numpy as np
from fluidgym import snapshot
n = 0
while True:
    n += 1
    snapshot.save({"number": np.array(n), "much": np.full(2_000_000, n)}, sys.argv[1])
    print(n, flush=True)
"""


def test_a_killed_writer_leaves_the_old_file_whole(tmp_path):
    path, random = tmp_path / "state.npz", np.random.default_rng(0)
    for _ in range(5):
        with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True) as writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            time.sleep(random.uniform(0.0, 0.1))
            writer.send_signal(signal.SIGKILL)
        found = snapshot.load(path)
        assert (found["much"] == found["number"]).all()
