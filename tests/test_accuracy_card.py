"""Accuracy cards: what is measured of an environment, and how it is told."""

import dataclasses
import json
import math

import gymnasium as gym
import pytest

from fluidgym import accuracy_card
from fluidgym.accuracy_card import TABLE_HEAD, make_card, markdown, write_markdown
from fluidgym.envs.task import Gate
from fluidgym.envs.tasks.dam_break_contain import DamBreakContain
from fluidgym.scheme import FIDELITIES
from fluidgym.validation import CASES

IDS = {"2D": "fluidgym/DamBreakContain2D-v0", "3D": "fluidgym/DamBreakContain3D-v0"}
COARSE = {"resolution": 8}


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Few steps to time."""
    monkeypatch.setattr(accuracy_card, "STEPS", 2)
    monkeypatch.setattr(accuracy_card, "REPEATS", 2)


def spacing_over_height(times, records, scene):
    return {"front": -scene.particle_spacing / scene.fluid[0].shape.upper[-1], "still": 0.0}


@pytest.fixture
def toy(monkeypatch):
    """The cases that stand for the tasks, as short as can be; their error is one over the resolution, below 0."""
    for name in ("dam-break", "dam-break-3d"):
        case = CASES[name]
        replaced = dataclasses.replace(
            case, times=case.times[:2], errors=spacing_over_height, target={16: {"front": 0.07}}, goal={}
        )
        monkeypatch.setitem(CASES, name, replaced)
    return CASES


def options_of(dim, **more):
    return {**gym.spec(IDS[dim]).kwargs, **more}


def card_of(dim="2D", fidelity="balanced", **more):
    return make_card(IDS[dim], options_of(dim, **COARSE, **more), fidelity, "cpu")


@pytest.mark.parametrize("dim", IDS)
def test_a_card_has_the_errors_and_the_cost_of_an_environment(dim, toy):
    card = card_of(dim, control_interval=0.1)
    assert (card.env_id, card.fidelity, card.dim) == (IDS[dim], "balanced", int(dim[0]))
    assert (card.resolution, card.control_interval, card.device) == (8, 0.1, "cpu")
    assert card.case == {"2D": "dam-break", "3D": "dam-break-3d"}[dim]
    assert (card.coarse.resolution, card.fine.resolution) == (8, 16)
    assert card.coarse.errors["front"] == pytest.approx(-1 / 8)
    assert card.fine.errors["front"] == pytest.approx(-1 / 16)
    assert card.order["front"] == pytest.approx(1.0)
    assert card.error_ratio["front"] == pytest.approx(0.5)
    assert math.isnan(card.order["still"])
    assert math.isnan(card.error_ratio["still"])
    assert card.time_ratio == card.fine.wall_s / card.coarse.wall_s
    cost, env = card.cost, gym.make(IDS[dim], **COARSE, control_interval=0.1, device="cpu").unwrapped
    env.reset(seed=accuracy_card.SEED)
    assert cost.particles == env.solver.account().live
    assert cost.steps_per_env_step == env.solver.steps_for(0.1)
    assert cost.ms_per_step > 0.0
    assert cost.env_steps_per_s > 0.0
    assert cost.spread >= 1.0
    assert cost.setup_s > 0.0


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_case_and_environment_have_the_scheme_of_the_fidelity(fidelity, toy, monkeypatch):
    seen = []
    case = CASES["dam-break"]

    def observe(solver):
        seen.append(solver.scheme)
        return case.observe(solver)

    monkeypatch.setitem(CASES, "dam-break", dataclasses.replace(case, observe=observe))
    assert card_of(fidelity=fidelity).fidelity == fidelity
    assert set(seen) == {FIDELITIES[fidelity]}


def test_a_card_of_the_dam_break_has_all_errors_of_the_case():
    card = card_of()
    assert set(card.coarse.errors) == set(card.fine.errors) == {"front", "P1", "P2", "P3", "impulse"}
    assert 0.0 < card.fine.errors["front"] < card.coarse.errors["front"] < 0.3
    assert card.order["front"] > 0.5
    assert (card.coarse.particles, card.fine.particles) == (128, 512)
    assert len(card.lines()) == 6


def test_a_case_may_count_along_another_length(toy, monkeypatch):
    monkeypatch.setattr(DamBreakContain, "gates", {2: Gate("dam-break", 1.5)})
    card = card_of()
    assert (card.resolution, card.coarse.resolution, card.fine.resolution) == (8, 12, 24)


def test_progress_is_told_in_simulated_time(toy):
    told = {}

    def progress(label, duration):
        told[label] = [duration, 0.0]

        def advance(seconds):
            told[label][1] += seconds

        return advance

    make_card(IDS["2D"], options_of("2D", **COARSE), "fast", "cpu", progress)
    assert list(told) == [
        f"DamBreakContain2D-v0 fast, {what}" for what in ("cost", "dam-break 2D 1/8", "dam-break 2D 1/16")
    ]
    assert all(passed == pytest.approx(duration) for duration, passed in told.values())


# -- telling ----------------------------------------------------------------------------------------------------------


def test_a_row_for_each_error_and_one_for_the_run_time(toy):
    card = card_of()
    front, still, run_time = map(str.split, card.lines())
    assert front[:3] == ["DamBreakContain2D-v0", "balanced", "1/8"]
    assert front[3:5] == [str(card.cost.particles), str(card.cost.steps_per_env_step)]
    assert front[-6:] == ["dam-break", "front", "-0.125", "-0.0625", "0.50", "1.0"]
    assert still == ["still", "0", "0"]
    assert run_time[:2] == ["run", "time"]
    assert run_time[-1] == f"{card.time_ratio:.2f}"
    for line in (TABLE_HEAD, *card.lines()):
        assert "\n" not in line
        assert line == line.rstrip()
    assert TABLE_HEAD.index("order") + len("order") == card.lines()[0].rindex("1.0") + 3


def test_a_target_is_told_where_there_is_one(toy, monkeypatch):
    assert [row[-1] for row in card_of().rows()] == ["", "", ""]
    case = CASES["dam-break"]
    for limit, said in ((0.2, "0.2 pass"), (0.1, "0.1 MISS")):
        monkeypatch.setitem(CASES, "dam-break", dataclasses.replace(case, target={8: {"front": limit}}))
        assert [row[-1] for row in card_of().rows()] == [said, "", ""]


def test_a_run_that_breaks_down_is_told_and_still_json(toy, monkeypatch):
    broken = dataclasses.replace(CASES["dam-break"], errors=lambda *_: {"front": math.nan})
    monkeypatch.setitem(CASES, "dam-break", broken)
    card = card_of()
    assert "broke down" in card.lines()[0]
    found = json.loads(json.dumps(card.as_json(), allow_nan=False))
    assert [run["errors"] for run in found["runs"]] == [{"front": None}] * 2
    assert found["order"] == found["error_ratio"] == {"front": None}


def test_a_case_that_cannot_be_run_is_told(toy, monkeypatch):
    case = CASES["dam-break"]

    def scene(resolution, dim):
        if resolution > 8:
            raise ValueError("too fine")
        return case.scene(resolution, dim)

    monkeypatch.setitem(CASES, "dam-break", dataclasses.replace(case, scene=scene))
    card = card_of()
    assert card.fine is None
    assert card.coarse.errors["front"] == pytest.approx(-1 / 8)
    assert card.lines()[-1] == "  dam-break 1/16 cannot be run: too fine"
    assert len(card.as_json()["runs"]) == 1
    assert card.as_json()["time_ratio"] is None
    page = markdown([card], {}, "card")
    assert "- balanced: dam-break 1/16 cannot be run: too fine" in page
    assert "| front | -0.125 |  |" in page


def test_a_task_that_names_no_case_has_only_its_cost(monkeypatch):
    monkeypatch.setattr(DamBreakContain, "gates", {})
    card = card_of()
    assert (card.case, card.coarse, card.fine) == ("", None, None)
    assert card.cost.env_steps_per_s > 0.0
    assert card.lines()[-1] == "  the task names no validation case"
    assert "Held against" not in markdown([card], {}, "card")


def test_json_has_what_was_measured(toy):
    card = card_of(fidelity="fast")
    found = json.loads(json.dumps(card.as_json(), allow_nan=False))
    assert found["env_id"] == IDS["2D"]
    assert (found["fidelity"], found["dim"], found["resolution"], found["case"]) == ("fast", 2, 8, "dam-break")
    assert [run["resolution"] for run in found["runs"]] == [8, 16]
    assert [run["passed"] for run in found["runs"]] == [None, True]
    assert found["order"] == {"front": pytest.approx(1.0), "still": None}
    assert found["error_ratio"]["front"] == pytest.approx(0.5)
    assert found["time_ratio"] > 0.0
    assert found["cost"] == dataclasses.asdict(card.cost)
    assert "records" not in found["runs"][0]


def test_the_page_says_how_it_was_made_and_has_a_table_for_each_environment(toy, tmp_path):
    cards = [card_of("2D", "fast"), card_of("2D", "accurate"), card_of("3D", "fast")]
    facts, command = {"device": "CPU", "warp": "9.9"}, "python -m fluidgym card --markdown page.md"
    page = tmp_path / "page.md"
    write_markdown(page, cards, facts, command)
    text = page.read_text()
    assert list(tmp_path.iterdir()) == [page]
    assert text.startswith("# Accuracy cards\n")
    assert f"```bash\n{command}\n```" in text
    assert "device CPU, warp 9.9" in text
    assert str(tmp_path) not in text
    assert [line for line in text.splitlines() if line.startswith("## ")] == [f"## {env_id}" for env_id in IDS.values()]
    assert "`dam-break-3d` (Dam break in three dimensions" in text
    assert max(map(len, text.splitlines())) <= 120
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")]
    for index, row in enumerate(rows):
        if row[1:] == ["---"] * (len(row) - 2) + ["--- |"]:  # as many cells in the head and in what follows
            assert len(rows[index - 1]) == len(row) == len(rows[index + 1])
    assert sum(row[0] == "| fast, 1/8 and 1/16" for row in rows) == 2
    assert sum(row[:2] == ["| accurate", "1/8"] for row in rows) == 1
