"""Every example runs, and passes the check at its end."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fluidgym.envs.policy import Policy

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

RUNS = {
    "ancestors.py": ["--device", "cpu", "--quick"],
    "dam_break.py": ["--device", "cpu", "--resolution", "24", "--seconds", "0.8"],
    "baselines.py": [
        *("fluidgym/SpreadEven2D-v0", "--seeds", "2", "--worlds", "8", "--steps", "1100", "--episodes", "2"),
        *("--docs", ".", "--policies", "policies", "--runs", "runs", "--device", "cpu"),
    ],
    "cross_entropy.py": ["fluidgym/SpreadEven2D-v0", "--worlds", "8", "--rounds", "2", "--episodes", "2"],
    "gallery.py": ["fluidgym/SpreadEven2D-v0", "--seconds", "0.5", "--out", "gallery"],
    "many_worlds.py": ["--device", "cpu", "--worlds", "4", "--steps", "10", "--resolution", "12"],
    "ppo.py": ["--worlds", "8", "--steps", "1100", "--episodes", "2", "--device", "cpu"],
    "sb3_ppo.py": ["--worlds", "8", "--steps", "600"],
    "skrl_ppo.py": ["--worlds", "8", "--steps", "1100", "--episodes", "2", "--fluid", "cpu"],
    "script_the_solver.py": ["--device", "cpu", "--resolution", "12"],
}

# Ray holds Gymnasium at an older release, so these want an environment of their own.
IN_AN_ENVIRONMENT_OF_THEIR_OWN = {
    "rllib_ppo.py": ("ray", ["--runners", "2", "--worlds", "4", "--updates", "2", "--episodes", "2"]),
}


def run_example(name: str, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, stdin=subprocess.DEVNULL)


def test_no_example_is_forgotten():
    assert sorted([*RUNS, *IN_AN_ENVIRONMENT_OF_THEIR_OWN]) == sorted(path.name for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("name", IN_AN_ENVIRONMENT_OF_THEIR_OWN)
def test_example_runs_where_its_library_is(name, tmp_path):
    library, arguments = IN_AN_ENVIRONMENT_OF_THEIR_OWN[name]
    pytest.importorskip(library)
    result = run_example(name, *arguments, folder=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize("name", RUNS)
def test_example_runs(name, tmp_path):
    result = run_example(name, *RUNS[name], folder=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.slow
def test_baselines_score_what_was_learnt_before_once_more(tmp_path):
    arguments = ["fluidgym/SpreadEven2D-v0", "--seeds", "1", "--worlds", "4", "--steps", "400", "--episodes", "2"]
    arguments += ["--docs", ".", "--policies", "policies", "--runs", "runs", "--device", "cpu", "--jobs", "1"]
    assert run_example("baselines.py", *arguments, folder=tmp_path).returncode == 0
    (path,) = (tmp_path / "runs").glob("*.npz")
    policy = Policy.load(path)
    run = policy.about["run"]
    replace(policy, about={**policy.about, "run": run | {"tested": -1.0, "validated": -1.0}}).save(path)
    result = run_example("baselines.py", *arguments, "--rescore", folder=tmp_path)
    assert result.returncode == 0, result.stderr
    assert Policy.load(path).about["run"] == run  # the minutes and the curve of the training too


@pytest.mark.slow
def test_baselines_score_every_difficulty(tmp_path):
    arguments = ["fluidgym/SpreadEven2D-v0", "--levels", "--episodes", "1", "--device", "cpu"]
    result = run_example("baselines.py", *arguments, folder=tmp_path)
    assert result.returncode == 0, result.stderr
    row = next(line for line in result.stdout.splitlines() if "SpreadEven2D" in line)
    assert len(re.findall(r"-?\d+\.\d ± ", row)) == 6


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


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("dam_break.py", "--seconds -1", "--seconds = -1 must be above 0 and finite"),
        ("dam_break.py", "--seconds nan", "--seconds = nan must be above 0 and finite"),
        ("dam_break.py", "--seconds inf", "--seconds = inf must be above 0 and finite"),
        ("dam_break.py", "--resolution 0 --device cpu", "resolution = 0 particles over the column's height is outside"),
        ("dam_break.py", "--device abacus", "'abacus' is not on this machine"),
        ("dam_break.py", "--output /dev/null/here --device cpu", "--output /dev/null/here cannot be made"),
        ("ancestors.py", "--resolution 2", "--resolution = 2 is outside 10 to 200; use 40"),
        ("ancestors.py", "--device abacus", "'abacus' is not on this machine"),
        ("ancestors.py", "--output /dev/null/here --device cpu", "--output /dev/null/here cannot be made"),
        ("many_worlds.py", "--worlds 0", "--worlds and --steps must be 1 or more"),
        ("many_worlds.py", "--steps 0", "--worlds and --steps must be 1 or more"),
        ("many_worlds.py", "--device abacus", "'abacus' is not on this machine"),
        ("script_the_solver.py", "--resolution 0", "--resolution = 0 must be 4 or more"),
        ("script_the_solver.py", "--device abacus", "'abacus' is not on this machine"),
    ],
)
def test_an_example_refuses_what_it_cannot_do_in_one_line(name, arguments, said, tmp_path):
    result = run_example(name, *arguments.split(), folder=tmp_path)
    lines = [line for line in result.stderr.splitlines() if not line.startswith("Warp ")]
    assert result.returncode == 2
    assert len(lines) == 1
    assert lines[0].startswith(f"{name}: ")
    assert said in lines[0]
    assert result.stdout == ""
    assert not list(tmp_path.iterdir())


def test_one_world_is_many_enough(tmp_path):
    result = run_example("many_worlds.py", "--worlds", "1", "--steps", "1", "--device", "cpu", folder=tmp_path)
    assert result.returncode == 0, result.stderr


def run_coarse(seconds: str, folder: Path) -> tuple[int, dict[str, str], str]:
    """Exit status, rows of the table by name, and all that a small dam break prints."""
    options = ["--resolution", "8", "--film", "none", "--device", "cpu", "--seconds", seconds]
    result = run_example("dam_break.py", *options, folder=folder)
    rows = dict(line.strip().split("  ", 1) for line in result.stdout.splitlines() if "  " in line.strip())
    return result.returncode, rows, result.stdout


def test_a_dam_break_goes_on_for_as_long_as_asked(tmp_path):
    _, rows, printed = run_coarse("4.1", tmp_path)  # an episode of the task is 4 s unless it is told otherwise
    assert float(rows["simulated"].split()[0]) >= 4.1
    assert "not checked" not in printed
    assert "kg/m" in rows["mass"]
    # Energy falls as long as no wall does work; from then on the table says what it is made of.
    (still,) = (value for name, value in rows.items() if name.startswith("energy, wall still"))
    assert -5.0 < float(still.partition("(")[2].partition("%")[0]) < 0.0
    for part in ("kinetic", "potential", "elastic"):
        assert part in rows["energy, with the wall's work"]


def test_a_front_that_was_not_checked_is_said_to_be(tmp_path):
    status, rows, printed = run_coarse("0.1", tmp_path)
    assert status == 0
    assert "not checked" in printed
    assert "energy at the end" in rows


def test_dam_break_reports_a_front_that_is_off(tmp_path):
    coarse = run_example("dam_break.py", "--resolution", "8", "--seconds", "0.5", "--device", "cpu", folder=tmp_path)
    assert coarse.returncode == 1
    assert "off the published curve; use a finer --resolution" in coarse.stderr


def test_readme_snippets_run(tmp_path):
    readme = (EXAMPLES.parent / "README.md").read_text(encoding="utf-8")
    snippets = re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    assert len(snippets) == 2
    for snippet in snippets:
        command = [sys.executable, "-c", snippet]
        result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
        assert result.returncode == 0, result.stderr
