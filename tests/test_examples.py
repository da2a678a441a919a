"""Every example runs, and passes the check at its end."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

RUNS = {
    "dam_break.py": ["--device", "cpu", "--resolution", "20", "--seconds", "0.8"],
    "many_worlds.py": ["--device", "cpu", "--worlds", "4", "--steps", "10"],
    "script_the_solver.py": ["--device", "cpu", "--resolution", "12"],
}


def run_example(name: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, stdin=subprocess.DEVNULL)


def test_no_example_is_forgotten():
    assert sorted(RUNS) == sorted(path.name for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("name", RUNS)
def test_example_runs(name, tmp_path):
    result = run_example(name, *RUNS[name], folder=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize(("dim", "resolution"), [(2, 16), (3, 8)])
def test_dam_break_leaves_a_table_a_picture_and_a_film(dim, resolution, tmp_path):
    options = ["--dim", str(dim), "--resolution", str(resolution), "--seconds", "0.5", "--device", "cpu"]
    result = run_example("dam_break.py", *options, "--output", "here", folder=tmp_path)
    for word in ("particles", "time per step", "mass", "energy", "density error", "published", "wrote"):
        assert word in result.stdout
    picture = np.asarray(Image.open(tmp_path / "here" / "dam_break.png"))
    assert picture.std() > 10.0
    film = Image.open(tmp_path / "here" / "dam_break.gif")
    assert film.n_frames > 8


def test_dam_break_refuses_what_it_cannot_do(tmp_path):
    late = run_example("dam_break.py", "--seconds", "-1", folder=tmp_path)
    assert late.returncode == 2
    assert "--seconds = -1 must be above 0" in late.stderr
    nowhere = run_example("dam_break.py", "--device", "abacus", folder=tmp_path)
    assert nowhere.returncode == 2
    assert "'abacus' is not on this machine" in nowhere.stderr
    assert "Traceback" not in nowhere.stderr
    assert not list(tmp_path.iterdir())


def test_dam_break_reports_a_front_that_is_off(tmp_path):
    coarse = run_example("dam_break.py", "--resolution", "8", "--seconds", "0.5", "--device", "cpu", folder=tmp_path)
    assert coarse.returncode == 1
    assert "off the published curve; use a finer --resolution" in coarse.stderr
