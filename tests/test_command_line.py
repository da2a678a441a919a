"""The command line: what it prints, writes and returns."""

import csv
import dataclasses
import importlib.util
import json
import math
import re
import struct
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from PIL import Image

import fluidgym.__main__
from fluidgym import accuracy_card, benchmark, paraview, recording, speed
from fluidgym.__main__ import INTERRUPTED, _environments, main
from fluidgym.envs.evaluation import evaluate
from fluidgym.envs.tasks.carry_tank import CarryTank
from fluidgym.envs.tasks.dam_break_contain import DamBreakContain
from fluidgym.layout import Parameters, make_structure
from fluidgym.render import film
from fluidgym.scene_file import load
from fluidgym.scheme import DEFAULT_SCHEME, FIDELITIES, Scheme
from fluidgym.validation import CASES, dam_break
from fluidgym.validation.report import write_json
from fluidgym.work_precision import SCHEMES


@pytest.fixture
def toy_case(monkeypatch):
    """A case as short as can be, in the place of the dam break: its error is 1/resolution, its target 1/8."""
    case = dataclasses.replace(
        dam_break.CASE,
        name="toy",
        resolutions={2: (4, 8)},
        end=float(dam_break.CASE.times[0]),
        errors=lambda times, records, scene: {"front": scene.particle_spacing / dam_break.HEIGHT},
        target={4: {"front": 0.125001}},
        goal={8: {"front": 0.01}},
    )
    monkeypatch.setitem(CASES, "toy", case)
    return case


def test_results_are_written_as_json(toy_case, tmp_path, capsys):
    file = tmp_path / "out.json"
    assert main(["validate", "toy", "--device", "cpu", "--json", str(file)]) == 0
    coarse, fine = json.loads(file.read_text())
    for found, resolution in ((coarse, 4), (fine, 8)):
        assert found["case"] == "toy"
        assert (found["resolution"], found["dim"], found["device"]) == (resolution, 2, "cpu")
        assert found["particles"] == 2 * resolution**2
        assert found["steps"] > 0
        assert found["wall_s"] > 0
        assert found["errors"] == {"front": pytest.approx(1 / resolution)}
        assert found["target"] == {"front": 0.125001}
    assert (coarse["passed"], fine["passed"]) == (False, True)
    assert fine["order"] == {"front": pytest.approx(1.0)}
    assert list(tmp_path.iterdir()) == [file]
    lines = capsys.readouterr().out.splitlines()
    assert any("MISS" in line and "1/4" in line for line in lines)
    assert any("pass" in line and "1.0" in line and "not met" in line for line in lines)
    assert "1 passed, 1 missed" in lines[-1]


def test_a_miss_fails_only_when_strict(toy_case):
    assert main(["validate", "toy", "--device", "cpu"]) == 0
    assert main(["validate", "toy", "--device", "cpu", "--strict"]) == 1
    assert main(["validate", "toy", "--device", "cpu", "--strict", "--resolutions", "8"]) == 0


def test_a_run_that_breaks_down_is_a_miss_and_still_json(toy_case, tmp_path, monkeypatch):
    broken = dataclasses.replace(toy_case, errors=lambda times, records, scene: {"front": float("nan")})
    monkeypatch.setitem(CASES, "toy", broken)
    file = tmp_path / "out.json"
    assert main(["validate", "toy", "--device", "cpu", "--resolutions", "4", "--strict", "--json", str(file)]) == 1
    assert json.loads(file.read_text())[0]["errors"] == {"front": None}


def test_an_interrupt_keeps_what_is_finished(toy_case, tmp_path, monkeypatch, capsys):
    def observe(solver):
        if solver.capacity > 32 and solver.time[0] > 0:
            raise KeyboardInterrupt
        return toy_case.observe(solver)

    monkeypatch.setitem(CASES, "toy", dataclasses.replace(toy_case, observe=observe))
    file = tmp_path / "out.json"
    assert main(["validate", "toy", "--device", "cpu", "--json", str(file)]) == 130
    assert [found["resolution"] for found in json.loads(file.read_text())] == [4]
    assert "interrupted after 1 of 2 runs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nope"], ["nope", *CASES]),
        (["dam-break", "--dim", "3"], ["3D", "dam-break"]),
        (["dam-break", "--resolutions", "2"], ["--resolutions", "4"]),
        (["dam-break", "--device", "abacus"], ["abacus", "cpu"]),
        (["dam-break", "--json", "no/such/folder/out.json"], ["--json", "no such folder"]),
        (["dam-break", "--json", "."], ["--json", "is a folder"]),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line(arguments, said, capsys):
    assert main(["validate", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert all(word in printed.err for word in said)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["validate", "still-tank", "--dim", "3", "--resolutions", "4"], ["still-tank 3D 1/4", "Scene box", "use a"]),
        (["benchmark", "--dim", "3", "--particles", "5"], ["3D, 1 x 5", "Scene box", "use a"]),
    ],
)
def test_too_few_particles_for_a_scene_are_refused_in_one_line(arguments, said, capsys):
    assert main([*arguments, "--device", "cpu"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert all(word in line for word in said)


@pytest.mark.parametrize("path", ["no/such/folder/out.json", "."])
def test_a_benchmark_looks_for_the_folder_of_its_results_first(path, capsys):
    assert main(["benchmark", "--json", path]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1


def test_a_benchmark_keeps_every_row_it_has(tmp_path, monkeypatch):
    written, measure = [], speed.measure_speed
    monkeypatch.setattr("fluidgym.validation.report.write_json", lambda path, rows: written.append(len(rows)))

    def interrupt(dim, size, *rest, **options):
        if len(written) == 2:
            raise KeyboardInterrupt
        return measure(dim, size, *rest, **options, stretch_s=1e-3)

    monkeypatch.setattr(speed, "measure_speed", interrupt)
    arguments = [
        "--dim",
        "2",
        "--particles",
        "200",
        "300",
        "400",
        "--device",
        "cpu",
        "--json",
        str(tmp_path / "o.json"),
    ]
    assert main(["benchmark", *arguments]) == INTERRUPTED
    assert written == [2, 3]  # the machine, and one row more each time


def test_a_benchmark_of_features_has_a_row_for_each(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(benchmark, "PAIRS", 2)
    file = tmp_path / "out.json"
    arguments = ["--features", "--dim", "2", "--particles", "100", "--device", "cpu", "--json", str(file)]
    assert main(["benchmark", *arguments]) == 0
    machine, *rows = json.loads(file.read_text())
    assert machine["machine"]["device"]
    assert [row["feature"] for row in rows] == list(benchmark.featured(benchmark.still_scene(2, 100)))
    assert len(rows) > 10
    for row in rows:
        assert 50 < row["particles"] < 150
        assert row["ms_per_step"] > 0.0
        assert row["ms_per_step_without"] > 0.0
        assert 0.0 < row["lowest"] <= row["ratio"] <= row["highest"]
    printed = capsys.readouterr().out.splitlines()
    assert all(row["feature"] in line for row, line in zip(rows, printed[2:], strict=True))


@pytest.mark.parametrize("dim", [2, 3])
def test_a_feature_that_is_named_and_off_is_as_if_it_were_not_named(dim):
    still = benchmark.still_scene(dim, 6**dim)
    structures = [
        make_structure(scene, scheme, Parameters(scene, scheme, 1), forces, plain=False)
        for scene, scheme, forces in [(still, DEFAULT_SCHEME, False), *benchmark.featured(still).values()]
    ]
    assert structures[1] == structures[0]
    # A face that moves differs by numbers only.
    assert sum(structure == structures[0] for structure in structures) == 3


# -- schemes by name, and run time against error ----------------------------------------------------------------------

COMPARE = ["benchmark", "--device", "cpu", "--repeats", "2", "--cases"]


def test_cases_may_be_run_under_another_scheme(toy_case, tmp_path, monkeypatch, capsys):
    seen = []
    watched = dataclasses.replace(toy_case, observe=lambda solver: seen.append(solver.scheme) or {"front": 1.0})
    monkeypatch.setitem(CASES, "toy", watched)
    mine, out = tmp_path / "mine.toml", tmp_path / "out.json"
    mine.write_text("[scheme]\ncourant = 0.25\n")
    expected = {"mueller": SCHEMES["mueller"].scheme, str(mine): Scheme(courant=0.25), **FIDELITIES}
    for name, scheme in expected.items():
        seen.clear()
        arguments = ["validate", "toy", "--device", "cpu", "--resolutions", "8", "--scheme", name, "--json", str(out)]
        assert main(arguments) == 0
        assert json.loads(out.read_text())[0]["scheme"] == name
        assert set(seen) == {scheme}


def test_a_case_that_a_scheme_cannot_run_is_told_and_left_out(toy_case, capsys):
    arguments = ["validate", "shear-start-up", "toy", "--dim", "2", "--resolutions", "8", "--device", "cpu"]
    assert main([*arguments, "--scheme", "mueller"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (told,) = [line for line in lines if "cannot run it" in line]
    assert told.startswith("shear-start-up 2D 1/8: mueller cannot run it: Scene.faces['y_min'].slip")
    assert any(line.startswith("toy") for line in lines)


def test_run_time_against_error_is_a_table_a_file_and_a_plot(toy_case, tmp_path, capsys):
    out, plot = tmp_path / "out.json", tmp_path / "out.png"
    arguments = ["toy", "--schemes", "default", "mueller", "--courants", "1", "0.5"]
    assert main([*COMPARE, *arguments, "--json", str(out), "--plot", str(plot)]) == 0
    machine, *rows, last = json.loads(out.read_text())
    assert machine["machine"]["threads"] == "1"
    found = {(row["curve"], row["resolution"], row["courant"]): row for row in rows}
    assert set(found) == {(name, n, c) for name in ("default", "mueller") for n in (4, 8) for c in (1.0, 0.5)}
    for (_, resolution, courant), row in found.items():
        assert (row["case"], row["dim"], row["headline"]) == ("toy", 2, "front")
        assert row["error"] == row["errors"]["front"] == pytest.approx(1 / resolution)
        assert len(row["seconds"]) == 2
        assert row["wall_s"] == pytest.approx(sum(row["seconds"]) / 2)
        assert row["setup_s"] > 0
        assert row["steps"] == pytest.approx(found[row["curve"], resolution, 1.0]["steps"] / courant, abs=1.1)
    assert any(row["on_front"] for row in rows)
    (summary,) = last["summary"]
    assert (summary["curve"], summary["against"]) == ("default", "mueller")
    assert summary["ratios"]
    printed = capsys.readouterr().out
    assert sum(line.startswith("toy 2D") for line in printed.splitlines()) == 8
    assert summary["said"] in printed
    assert Image.open(plot).width > 400
    assert sorted(tmp_path.iterdir()) == [out, plot]


def test_an_interrupted_comparison_keeps_what_it_has(toy_case, tmp_path, monkeypatch, capsys):
    def observe(solver):
        if solver.scheme.preset == "mueller":
            raise KeyboardInterrupt
        return toy_case.observe(solver)

    monkeypatch.setitem(CASES, "toy", dataclasses.replace(toy_case, observe=observe))
    out, plot = tmp_path / "out.json", tmp_path / "out.png"
    assert main([*COMPARE, "toy", "--json", str(out), "--plot", str(plot)]) == 130
    _, row, _ = json.loads(out.read_text())
    assert (row["curve"], row["resolution"], len(row["seconds"])) == ("default", 4, 1)
    printed = capsys.readouterr()
    assert "toy 2D" in printed.out
    assert "interrupted" in printed.err
    assert plot.stat().st_size > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["validate", "dam-break", "--scheme", "nope"], ["nope", "default", "mueller"]),
        (["validate", "dam-break", "--scheme", "no.toml"], ["no.toml", "cannot be read"]),
        ([*COMPARE, "nope"], ["nope", *CASES]),
        ([*COMPARE, "dam-break", "--schemes", "nope"], ["nope", "default", "mueller"]),
        ([*COMPARE, "dam-break", "--peers", "nope"], ["nope", "pysph"]),
        ([*COMPARE, "dam-break", "--peers", "pysph", "--peer-python", "no/python"], ["no/python", "name a Python"]),
        ([*COMPARE, "dam-break", "--repeats", "0"], ["--repeats", "1"]),
        ([*COMPARE, "dam-break", "--courants", "1", "0"], ["--courants", "above 0"]),
        ([*COMPARE, "dam-break", "--resolutions", "2"], ["--resolutions", "4"]),
        ([*COMPARE, "dam-break", "--plot", "no/such/folder/out.png"], ["--plot", "no such folder"]),
        ([*COMPARE, "dam-break", "--plot", "out.txt"], ["--plot", ".png"]),
        ([*COMPARE, "dam-break", "--json", "."], ["--json", "is a folder"]),
        ([*COMPARE, "dam-break", "--features"], ["--features", "with --cases"]),
        ([*COMPARE, "dam-break", "--particles", "100"], ["--particles", "with --cases"]),
        (["benchmark", "--schemes", "default"], ["--schemes", "without --cases"]),
        (["benchmark", "--peers", "pysph", "--peer-python", "no/python"], ["no/python", "name a Python"]),
        (["benchmark", "--peers", "pysph", "pysph-edac"], ["--peers", "name one"]),
        (["benchmark", "--threads", "0"], ["--threads", "1 or more"]),
        (["benchmark", "--features", "--plot", "x.png"], ["--plot", "with --features"]),
        ([*COMPARE, "dam-break", "--threads", "2"], ["--threads", "with --cases"]),
    ],
)
def test_what_cannot_be_compared_is_refused_in_one_line(arguments, said, capsys):
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert all(word in printed.err for word in said)


@pytest.mark.parametrize("missing", ["matplotlib", "pysph"])
def test_a_missing_library_is_told_before_anything_is_run(missing, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("fluidgym.work_precision.find_spec", lambda name: None)
    none = tmp_path / "python"  # one that has no PySPH, wherever the tests run
    none.write_text(f'#!/bin/sh\nexec {sys.executable} -c "import no_such_pysph"\n')
    none.chmod(0o755)
    option = ["--plot", "out.png"] if missing == "matplotlib" else ["--peers", "pysph", "--peer-python", str(none)]
    assert main([*COMPARE, "dam-break", *option]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    assert f"fluidgym-sph[{'plot' if missing == 'matplotlib' else 'peers'}]" in line


# -- accuracy cards ----------------------------------------------------------------------------------------------------

CARD_IDS = ["fluidgym/DamBreakContain2D-v0", "fluidgym/DamBreakContain3D-v0"]


@pytest.fixture
def coarse_envs(monkeypatch):
    """Environments as coarse as can be, and the cases that stand for them as short."""
    monkeypatch.setattr(accuracy_card, "STEPS", 1)
    monkeypatch.setattr(accuracy_card, "REPEATS", 1)
    # In 3D as wide as the widest kernel there may be.
    coarse = {2: dict.fromkeys(FIDELITIES, 8), 3: dict.fromkeys(FIDELITIES, 12)}
    monkeypatch.setattr(DamBreakContain, "resolutions", coarse)
    for name in ("dam-break", "dam-break-3d"):
        case = CASES[name]
        changes = {"times": case.times[:1], "errors": lambda times, records, scene: {"front": scene.particle_spacing}}
        monkeypatch.setitem(CASES, name, dataclasses.replace(case, **changes))


def test_cards_are_of_all_environments_if_none_is_named():
    assert list(_environments([])) == [env_id for env_id in gymnasium.registry if env_id.startswith("fluidgym/")]


def test_cards_of_environments_are_a_table_a_file_and_a_page(coarse_envs, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["card", *CARD_IDS, "--device", "cpu", "--json", "out.json", "--markdown", "page.md"]) == 0
    machine, *cards = json.loads(Path("out.json").read_text())
    assert machine["machine"]["threads"] == "1"
    assert [(card["env_id"], card["fidelity"]) for card in cards] == [
        (i, name) for i in CARD_IDS for name in FIDELITIES
    ]
    assert all(card["order"]["front"] == pytest.approx(1.0) for card in cards)
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("device CPU")
    assert sum(line.startswith("DamBreakContain") for line in printed) == 6
    page = Path("page.md").read_text()
    assert f"```bash\npython -m fluidgym card {' '.join(CARD_IDS)} --device cpu --markdown page.md\n```" in page
    assert all(f"## {env_id}" in page for env_id in CARD_IDS)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.json", "page.md"]


@pytest.mark.parametrize("name", [CARD_IDS[0], f"fluidgym:{CARD_IDS[0]}", "DamBreakContain2D-v0"])
def test_a_card_may_be_of_one_environment_at_one_fidelity(name, coarse_envs, tmp_path, capsys):
    page = tmp_path / "page.md"
    assert main(["card", name, "--fidelity", "fast", "--device", "cpu", "--markdown", str(page)]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("DamBreakContain")]
    assert row.split()[:2] == ["DamBreakContain2D-v0", "fast"]
    # The folder is no one else's.
    assert f"python -m fluidgym card {name} --fidelity fast --device cpu --markdown page.md\n" in page.read_text()


def test_an_interrupt_keeps_the_cards_that_are_finished(coarse_envs, tmp_path, monkeypatch, capsys):
    case = CASES["dam-break-3d"]

    def observe(solver):
        raise KeyboardInterrupt

    monkeypatch.setitem(CASES, "dam-break-3d", dataclasses.replace(case, observe=observe))
    out, page = tmp_path / "out.json", tmp_path / "page.md"
    options = [*CARD_IDS, "--fidelity", "fast", "--device", "cpu", "--json", str(out), "--markdown", str(page)]
    assert main(["card", *options]) == 130
    assert [card["env_id"] for card in json.loads(out.read_text())[1:]] == CARD_IDS[:1]
    assert f"## {CARD_IDS[0]}" in page.read_text()
    assert "interrupted after 1 of 2 cards" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["Tsunami-v0"], ["unknown environment Tsunami-v0", *CARD_IDS]),
        (["CartPole-v1"], ["unknown environment CartPole-v1"]),
        (["--fidelity", "fast", "best"], ["--fidelity best", "fast, balanced, accurate"]),
        (["--device", "abacus"], ["abacus", "cpu"]),
        (["--json", "no/such/folder/out.json"], ["--json", "no such folder"]),
        (["--markdown", "no/such/folder/page.md"], ["--markdown", "no such folder"]),
        (["--markdown", "."], ["--markdown", "is a folder"]),
    ],
)
def test_cards_that_cannot_be_made_are_refused_in_one_line(arguments, said, capsys):
    assert main(["card", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert all(word in printed.err for word in said)


def test_an_environment_that_cannot_be_made_is_refused_in_one_line(coarse_envs, monkeypatch, capsys):
    monkeypatch.setattr(DamBreakContain, "resolutions", {2: dict.fromkeys(FIDELITIES, 7)})
    assert main(["card", CARD_IDS[0], "--fidelity", "fast", "--device", "cpu"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"fluidgym: {CARD_IDS[0]} fast: resolution = 7")


def test_json_is_written_whole_or_not_at_all(tmp_path):
    file = tmp_path / "out.json"
    write_json(file, [{"case": "first"}])
    with pytest.raises(TypeError):
        write_json(file, [{"case": object()}])
    assert json.loads(file.read_text()) == [{"case": "first"}]
    assert list(tmp_path.iterdir()) == [file]


def test_the_module_runs_as_a_program():
    command = [sys.executable, "-m", "fluidgym", "validate", "--help"]
    found = subprocess.run(command, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL)
    assert found.returncode == 0
    assert "--strict" in found.stdout


# -- run --------------------------------------------------------------------------------------------------------------

SCENES = Path(__file__).resolve().parents[1] / "examples" / "scenes"

SMALL = """
duration = 0.2
lower = [0, 0]
upper = [2, 1]
particle_spacing = 0.05
view.frames_per_second = 20
view.size = [160, 100]

[[fluid]]
shape = {box = [[0, 0], [0.5, 0.5]]}
pressure = "released"
"""


@pytest.fixture
def small(tmp_path):
    """A small dam break as a scene file."""
    file = tmp_path / "small.toml"
    file.write_text(SMALL)
    return file


def read_series(folder):
    """The table of a run: each column by its name."""
    with (folder / "series.csv").open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def dam_break_front(series):
    errors = dam_break.front_errors(series["time"], series["front"] / dam_break.HEIGHT)
    late = [error for t, error in errors.items() if t >= 1.0]
    assert len(late) > 3
    assert np.abs(late).max() < 0.08
    assert series["energy"][-1] < series["energy"][0]


def held_by_the_gate(series):
    t, gate = series["time"], series["bodies.gate.y"] - 0.4
    before = t < 0.2
    assert series["largest_speed"][before].max() < 0.3
    assert series["potential_energy"][before] == pytest.approx(series["potential_energy"][0], rel=2e-3)
    expected = np.clip(2.0 * (t - 0.225), 0.0, 0.65)  # a quarter of the 0.1 m that it rises at 2 m/s in 0.05 s
    away = (t < 0.19) | (t > 0.26)
    assert gate[away] == pytest.approx(expected[away], abs=2e-3)
    assert series["rms_speed"][-1] > 0.5


def sloshes_as_linear_theory_says(series):
    """The middle of the water against the first standing waves of a tank that is shaken (modal analysis, by steps)."""
    length, depth, g, amplitude, period = 1.0, 0.3, 9.81, 0.4, 1.32
    fine = np.linspace(0.0, series["time"][-1], 20001)
    push = amplitude * np.sin(2 * math.pi * fine / period) * np.sin(0.5 * math.pi * np.clip(fine / period, 0, 1)) ** 2
    middle = np.full(len(fine), 0.5 * length)
    for mode in (1, 3):
        k = mode * math.pi / length
        share = -4.0 * length / (mode * math.pi) ** 2  # of the wave in x
        a = rate = 0.0
        for n in range(len(fine) - 1):
            rate += (fine[1] - fine[0]) * k * math.tanh(k * depth) * (share * push[n] - g * a)
            a += (fine[1] - fine[0]) * rate
            middle[n + 1] += 0.5 * share * a / depth
    found = series["center_of_mass_x"] - np.interp(series["time"], fine, middle)
    assert np.ptp(middle) > 0.02
    assert np.abs(found).max() < 0.1 * np.ptp(middle)
    assert series["gravity.x"] == pytest.approx(np.interp(series["time"], fine, push), abs=0.03)


def driven_by_the_piston(series):
    t = series["time"]
    grown = np.sin(0.5 * math.pi * np.clip(t / 1.6, 0.0, 1.0)) ** 2
    assert series["faces.x_min"] - 0.2 == pytest.approx(0.1 * grown * np.sin(2 * math.pi * t / 1.6), abs=2e-3)
    assert series["energy"][-1] - series["energy"][0] > 20.0  # the work of the wall [J/m]
    # With its left end the water's middle moves half as far.
    pushed = series["center_of_mass_x"] - series["center_of_mass_x"][0]
    assert np.abs(pushed).max() > 1e-3


def fed_by_the_jet(series):
    spacing, width, speed, rows = 0.025, 0.15, 1.2, 6
    t = series["time"]
    before = t < 0.1
    assert (series["emitted"][before] == 0).all()
    assert series["largest_speed"][before].max() < 0.3
    since = np.maximum(t - 0.1, 0.0)
    ramp = np.minimum(since, 0.1)
    made = width * speed * (5.0 * ramp**2 + since - ramp)  # [m2]
    assert series["emitted"] * spacing**2 == pytest.approx(made, abs=1.01 * width * spacing)
    assert (series["particles"] == 5 * rows + series["emitted"] - series["retired"]).all()
    # Until it meets the bucket each part keeps the speed with which it left the pipe, and falls.
    at = np.searchsorted(t, 0.36)
    squares = speed**2 * (100.0 * ramp**3 / 3.0 + since - ramp)
    assert series["momentum_x"][at] == pytest.approx(1000.0 * width * (squares[at] + 5 * spacing * speed), rel=0.05)
    assert 1.0 < series["center_of_mass_x"][-1] < 1.4  # most of it is over or in the bucket


def strikes_the_pool(series):
    assert series["center_of_mass_x"] == pytest.approx(0.8, abs=2e-3)
    flying = series["time"] < 0.012
    assert series["momentum_y"][flying] == pytest.approx(series["momentum_y"][0], rel=0.05)
    assert series["kinetic_energy"][-1] < 0.7 * series["kinetic_energy"][0]
    assert (np.diff(series["energy"]) < 0.01 * series["kinetic_energy"][0]).all()


def flows_through_the_channel(series):
    late = series["time"] > 2.5
    mean = series["momentum_x"] / series["mass"]
    assert mean[late].mean() == pytest.approx(0.5, rel=0.02)
    # A parabola has 6/5 of the square of its mean.
    assert (series["rms_speed"] / mean)[late].mean() == pytest.approx(math.sqrt(1.2), rel=0.02)
    assert series["emitted"][-1] * 0.02**2 == pytest.approx(0.5 * 0.2 * series["time"][-1], rel=0.02)
    assert series["particles"] == pytest.approx(series["particles"][0], rel=0.03)


def strikes_the_box(series):
    # From SPHERIC's benchmark 2: the water is at the box, 1.17 m away, after some 0.4 s.
    assert 0.34 < np.interp(2.3955, series["front"], series["time"]) < 0.5
    assert series["center_of_mass_y"] == pytest.approx(0.5, abs=0.01)
    assert series["energy"][-1] < series["energy"][0]


CHECKS = {
    "dam_break": (0.03, 0.7, dam_break_front),
    "dam_break_gate": (0.04, 0.7, held_by_the_gate),
    "sloshing": (0.025, 2.0, sloshes_as_linear_theory_says),
    "wavemaker": (0.075, 2.0, driven_by_the_piston),
    "jet_into_bucket": (0.025, 1.0, fed_by_the_jet),
    "drop_impact": (0.04, 0.3, strikes_the_pool),
    "channel": (0.02, 4.0, flows_through_the_channel),
    "dam_break_obstacle_3d": (0.1, 0.6, strikes_the_box),
}


def test_no_scene_is_forgotten():
    assert sorted(CHECKS) == sorted(path.stem for path in SCENES.glob("*.toml"))


@pytest.mark.parametrize("name", CHECKS)
def test_a_scene_runs_and_does_what_its_physics_says(name, tmp_path, capsys):
    spacing, duration, check = CHECKS[name]
    options = ["--spacing", str(spacing), "--duration", str(duration), "--film", "none", "--device", "cpu"]
    out = tmp_path / "out"
    assert main(["run", str(SCENES / f"{name}.toml"), "--out", str(out), *options]) == 0
    series = read_series(out)
    assert series["time"][-1] == pytest.approx(duration)
    assert all(np.isfinite(values).all() for values in series.values())
    assert series["largest_density_error"].max() < 0.2
    area = load(SCENES / f"{name}.toml", spacing).scene.particle_mass
    assert series["mass"] == pytest.approx(area * series["particles"])
    assert np.asarray(Image.open(out / "last.png")).std() > 5.0
    check(series)
    assert load(out / "as_run.toml").duration == duration
    printed = capsys.readouterr().out
    for word in ("simulated", "particles", "wall time", "mass", "density error", "trust", "wrote"):
        assert word in printed


def test_a_run_leaves_a_table_pictures_a_film_and_files_for_paraview(small, tmp_path, capsys):
    out = tmp_path / "out"
    options = ["--out", str(out), "--frames", "--vtk", "--save-every", "0.08", "--device", "cpu"]
    assert main(["run", str(small), *options]) == 0
    assert Image.open(out / "film.gif").n_frames == 5
    assert Image.open(out / "film.gif").size == (160, 100)
    assert len(list((out / "frames").glob("frame_*.png"))) == 5
    series = read_series(out)
    assert series["time"] == pytest.approx([0.0, 0.08, 0.16, 0.2])
    steps = re.findall(r'timestep="([0-9.]+)".*file="(.*?)"', (out / "particles.pvd").read_text())
    assert [float(time) for time, _ in steps] == pytest.approx([0.0, 0.08, 0.16, 0.2])
    points = read_vtu(out / steps[-1][1])
    assert points["points"].shape == points["velocity"].shape == (100, 3)
    assert points["points"][:, 0].max() + 0.025 == pytest.approx(series["front"][-1])
    assert (points["points"][:, 2] == 0.0).all()
    assert 1000.0 * 0.05**2 * points["velocity"][:, 0].sum() == pytest.approx(series["momentum_x"][-1])
    assert points["identity"][:, 0].tolist() == list(range(100))
    assert points["density"] == pytest.approx(1000.0, rel=0.05)
    printed = capsys.readouterr().out
    for name in ("as_run.toml", "series.csv", "last.png", "film.gif", "frames", "particles.pvd"):
        assert f"wrote {out / name}" in printed
        assert (out / name).exists()


def read_vtu(path):
    """The arrays of a .vtu file with raw data at its end, each (n, component)."""
    raw = path.read_bytes()
    head, _, rest = raw.partition(b'<AppendedData encoding="raw">')
    data = rest[rest.index(b"_") + 1 :]
    arrays = {}
    for name, components, kind, offset in re.findall(
        r'Name="(\w+)" NumberOfComponents="(\d)" type="(\w+)" format="appended" offset="(\d+)"', head.decode()
    ):
        (size,) = struct.unpack_from("<Q", data, int(offset))
        values = np.frombuffer(
            data, dtype=kind.lower(), count=size // np.dtype(kind.lower()).itemsize, offset=int(offset) + 8
        )
        arrays[name] = values.reshape(-1, int(components))
    return arrays


@pytest.mark.parametrize("name", FIDELITIES)
def test_a_fidelity_stands_in_for_that_of_the_file(name, small, tmp_path):
    small.write_text(SMALL + "[scheme]\nfidelity = 'fast'\n")
    out = tmp_path / "out"
    options = ["--out", str(out), "--film", "none", "--duration", "0.01", "--device", "cpu"]
    assert main(["run", str(small), *options, "--fidelity", name]) == 0
    assert load(out / "as_run.toml").scheme == FIDELITIES[name]


def test_an_earlier_run_leaves_nothing_in_the_next(small, tmp_path):
    out = tmp_path / "out"
    options = ["--out", str(out), "--film", "none", "--frames", "--vtk", "--device", "cpu"]
    assert main(["run", str(small), *options]) == 0
    assert main(["run", str(small), *options, "--duration", "0.05"]) == 0
    assert len(list((out / "frames").iterdir())) == 2
    assert len(list((out / "particles").iterdir())) == 2


def test_an_mp4_has_as_many_frames_a_second_as_asked(small, tmp_path):
    out = tmp_path / "out"
    assert main(["run", str(small), "--out", str(out), "--film", "mp4", "--fps", "50", "--device", "cpu"]) == 0
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    frames, _ = imageio_ffmpeg.count_frames_and_secs(str(out / "film.mp4"))
    assert frames == 11


def interrupt_after(monkeypatch, calls):
    """Let the measuring of a run be interrupted after so many calls."""
    count = iter(range(calls))

    def measure(solver):
        if next(count, None) is None:
            raise KeyboardInterrupt
        return original(solver)

    original = recording.measure
    monkeypatch.setattr(recording, "measure", measure)


def test_an_interrupted_run_keeps_what_there_is(small, tmp_path, monkeypatch, capsys):
    interrupt_after(monkeypatch, 3)
    out = tmp_path / "out"
    assert main(["run", str(small), "--out", str(out), "--device", "cpu"]) == 130
    assert read_series(out)["time"] == pytest.approx([0.0, 0.05, 0.1])
    assert Image.open(out / "film.gif").n_frames == 3
    assert (out / "last.png").exists()
    printed = capsys.readouterr()
    assert "interrupted at 0.1 of 0.2 s" in printed.err
    assert "wrote" in printed.out


def test_a_run_interrupted_at_once_says_so(small, tmp_path, monkeypatch, capsys):
    interrupt_after(monkeypatch, 0)
    assert main(["run", str(small), "--out", str(tmp_path / "out"), "--device", "cpu"]) == 130
    assert "before the first measurement" in capsys.readouterr().out


def test_a_run_that_breaks_down_ends_with_what_there_is(small, tmp_path, capsys):
    small.write_text(
        SMALL.replace("duration = 0.2", "duration = 20")
        + "[scheme]\nintegrator = 'explicit-euler'\ndensity_diffusion = 0\nartificial_viscosity = 0\n"
        + "acoustic_damping = 0"
    )
    out = tmp_path / "out"
    assert main(["run", str(small), "--out", str(out), "--film", "none", "--device", "cpu"]) == 1
    printed = capsys.readouterr()
    (line,) = [line for line in printed.err.splitlines() if line.startswith("fluidgym: ")]
    assert "broken down" in line
    assert "courant" in line
    assert 0.0 < read_series(out)["time"][-1] < 20.0
    assert "none: it broke down" in printed.out


def test_a_control_beyond_the_solver_ends_a_run_with_what_there_is(small, tmp_path, capsys):
    motion = '[[motion]]\ntarget = "gravity"\nkind = "steps"\ntimes = [0.1]\nvalues = [1e7]\naxis = "x"\n'
    small.write_text(SMALL + motion)
    out = tmp_path / "out"
    assert main(["run", str(small), "--out", str(out), "--device", "cpu"]) == 1
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("fluidgym: ")]
    assert "gravity" in line
    assert read_series(out)["time"][-1] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["none.toml"], ["none.toml", "No such file"]),
        (["wrong.toml"], ["wrong.toml: lower is missing"]),
        (["small.toml", "--duration", "-1"], ["duration = -1 s"]),
        (["small.toml", "--duration", "inf"], ["duration = inf"]),
        (["small.toml", "--spacing", "7"], ["small.toml", "particle_spacing = 7 m"]),
        (["small.toml", "--fidelity", "best"], ["--fidelity best", "fast, balanced, accurate"]),
        (["small.toml", "--fps", "500"], ["frames_per_second = 500", "1 to 50"]),
        (["small.toml", "--save-every", "0"], ["0 s", "above 0"]),
        (["small.toml", "--save-every", "1e-9"], ["1e-09 s", "limit 100000", "or more"]),
        (["small.toml", "--device", "abacus"], ["abacus", "cpu"]),
        (["small.toml", "--duration", "10000"], ["film", "GB", "no film"]),
        (["small.toml", "--out", "/dev/null/here"], ["--out /dev/null/here", "another folder"]),
    ],
)
def test_a_run_that_cannot_be_is_refused_in_one_line_before_it_starts(arguments, said, small, monkeypatch, capsys):
    (small.parent / "wrong.toml").write_text("duration = 1\nupper = [1, 1]\nparticle_spacing = 0.1\nfluid = []")
    monkeypatch.chdir(small.parent)
    assert main(["run", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert printed.err.startswith("fluidgym: ")
    assert all(word in printed.err for word in said), printed.err
    assert not (small.parent / "outputs").exists()


@pytest.mark.parametrize(
    ("option", "module", "remedy"),
    [
        (["--vtk"], paraview, 'pip install "fluidgym-sph[vtk]"'),
        (["--film", "mp4"], film, 'pip install "fluidgym-sph[render]"'),
    ],
)
def test_a_library_that_is_missing_is_named_before_the_run(option, module, remedy, small, monkeypatch, capsys):
    monkeypatch.chdir(small.parent)
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    assert main(["run", "small.toml", *option]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert remedy in line
    assert not (small.parent / "outputs").exists()


def test_a_run_goes_to_a_folder_named_after_its_file(small, monkeypatch):
    monkeypatch.chdir(small.parent)
    assert main(["run", "small.toml", "--film", "none", "--duration", "0.01", "--device", "cpu"]) == 0
    assert (small.parent / "outputs" / "small" / "series.csv").exists()


# -- controllers -------------------------------------------------------------------------------------------------


@pytest.fixture
def short_carry(monkeypatch):
    monkeypatch.setattr(CarryTank, "duration", 0.4)


def test_controllers_are_scored_on_held_out_seeds(short_carry, tmp_path, capsys):
    out = tmp_path / "scores.json"
    options = ["--difficulty", "easy", "--episodes", "3", "--device", "cpu", "--json", str(out)]
    assert main(["evaluate", "CarryTank2D-v0", *options]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in printed] == [
        "fluidgym/CarryTank2D-v0 easy null",
        "fluidgym/CarryTank2D-v0 easy scripted",
    ]
    rows = json.loads(out.read_text())
    expected = evaluate("scripted", "CarryTank", episodes=3, difficulty="easy", device="cpu")
    assert rows[1]["mean"] == pytest.approx(expected.mean)
    assert (rows[1]["policy"], rows[1]["episodes"], rows[1]["diverged"]) == ("scripted", 3, 0)
    assert set(rows[1]["parts"]) == {"arrival", "spill", "unrest", "effort"}


def test_a_controller_is_shown_in_a_film(short_carry, tmp_path, capsys):
    film = tmp_path / "film.gif"
    options = ["--difficulty", "easy", "--device", "cpu", "--film", str(film)]
    assert main(["play", "fluidgym/CarryTank2D-v0", *options]) == 0
    assert Image.open(film).n_frames == 4
    assert "fluidgym/CarryTank2D-v0 easy scripted: return" in capsys.readouterr().out


def test_a_trained_controller_plays_at_the_difficulty_it_was_trained_at(short_carry, tmp_path, capsys):
    policy = str(Path(__file__).resolve().parents[1] / "examples" / "policies" / "CarryTank2D-v0.npz")
    options = ["CarryTank2D-v0", "--policy", policy, "--device", "cpu"]
    assert main(["play", *options, "--film", str(tmp_path / "film.gif")]) == 0
    assert "CarryTank2D-v0 easy" in capsys.readouterr().out
    assert main(["evaluate", *options, "--episodes", "1"]) == 0
    assert "CarryTank2D-v0 easy" in capsys.readouterr().out
    assert main(["evaluate", *options, "--difficulty", "medium"]) == 2
    assert "use it on fluidgym/CarryTank2D-v0, difficulty easy, as it was trained" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "without", "said"),
    [
        ("", "pygame", 'a window needs pygame: pip install "fluidgym-sph[render]", or give --film FILE.gif'),
        ("", "", "there is no screen for a window (DISPLAY is not set); give --film FILE.gif"),
        ("--film a.mp4", "imageio_ffmpeg", 'an MP4 film needs imageio-ffmpeg: pip install "fluidgym-sph[render]", or'),
    ],
)
def test_what_cannot_be_shown_is_told_before_it_is_played(arguments, without, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    found = importlib.util.find_spec
    for module in (fluidgym.__main__, film):
        monkeypatch.setattr(module, "find_spec", lambda name: None if name == without else found(name))
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    assert main(["play", "CarryTank2D-v0", "--device", "cpu", *arguments.split()]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("evaluate Tsunami2D-v0", "unknown environment Tsunami2D-v0; known are fluidgym/DamBreakContain2D-v0"),
        ("evaluate CarryTank2D-v0 --policy gone.npz", "policy = 'gone.npz' does not exist"),
        ("evaluate CarryTank2D-v0 --difficulty mean", "difficulty = 'mean' is unknown; use 'easy', 'medium', 'hard'"),
        ("evaluate CarryTank2D-v0 --episodes 0 --difficulty easy", "episodes = 0 is outside 1 to"),
        ("play CarryTank2D-v0 --policy gone.npz --film a.gif", "policy = 'gone.npz' does not exist"),
        ("play CarryTank2D-v0 --film here/there.gif", "--film here/there.gif: there is no such folder"),
        (
            "play CarryTank2D-v0 --film film.avi",
            "--film film.avi is of no kind that can be written; let it end in .gif",
        ),
        ("play CarryTank2D-v0 --policy null --film a.gif --difficulty mean", "difficulty = 'mean' is unknown"),
        ("play CarryTank2D-v0 --seed -1 --film a.gif --difficulty easy", "seed = -1 must be a whole number"),
    ],
)
def test_controllers_that_cannot_play_are_refused_in_one_line(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments.split()) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len([line for line in error.splitlines() if not line.startswith("Warp")]) == 1
