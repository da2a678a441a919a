"""The command line: what it prints, writes and returns."""

import dataclasses
import json
import subprocess
import sys

import pytest

from fluidgym.__main__ import main
from fluidgym.validation import CASES, dam_break
from fluidgym.validation.report import write_json


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
    written = []
    monkeypatch.setattr("fluidgym.validation.report.write_json", lambda path, rows: written.append(len(rows)))

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("fluidgym.validation.run", interrupt)
    arguments = ["--dim", "2", "--particles", "200", "400", "--device", "cpu", "--json", str(tmp_path / "out.json")]
    with pytest.raises(KeyboardInterrupt):
        main(["benchmark", *arguments])
    assert written == [2, 3]  # the machine, and one row more each time


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
