"""What must not break: impacts, pistons, jets, traps, long runs, many particles."""

from pathlib import Path

import numpy as np
import pytest

import fluidgym.envs.fluid_task
from fluidgym import soak as soaking
from fluidgym.__main__ import main
from fluidgym.diagnostics import measure
from fluidgym.envs import FluidVectorEnv
from fluidgym.envs.fluid_task import FluidTask
from fluidgym.scene import Box, Fluid, Scene
from fluidgym.soak import KINDS, Plans, replay, soak, soak_all
from fluidgym.solver import Solver
from fluidgym.stress import MISSES, STRESSES, Finding, Sound

G = 9.81

# What is known to miss its mark is run all the same, and strictly: the test fails once the mark is kept.
each_stress = pytest.mark.parametrize(
    "stress",
    [
        pytest.param(
            one,
            marks=pytest.mark.xfail(strict=True, reason=MISSES[one.number]) if one.number in MISSES else (),
            id=str(one.number),
        )
        for one in STRESSES
    ],
)


def assert_sound(solver):
    """Every number is finite, every particle inside the walls, and every particle still itself."""
    sound = Sound()
    water = sound.look(solver)
    assert all(finding.passed for finding in sound.findings()), list(map(str, sound.findings()))
    np.testing.assert_array_equal(water.identity, np.arange(solver.capacity))
    return water


def dam_break(dim, **changes):
    """A column 1 m high in a closed tank of four times its width."""
    middle = () if dim == 2 else (0.5,)
    given = {
        "lower": (0.0,) * dim,
        "upper": (4.0, *middle, 2.0),
        "particle_spacing": {2: 0.05, 3: 1.0 / 16}[dim],
        "fluid": Fluid(Box((0.0,) * dim, (1.0, *middle, 1.0)), pressure="hydrostatic"),
    }
    return Scene(**(given | changes))


@pytest.mark.parametrize("dim", [2, 3], ids=["2D", "3D"])
def test_dam_break_loses_nothing_through_its_impact(dim, record_property):
    solver = Solver(dam_break(dim), device="cpu")
    before_impact = None
    for k in range(1, 26):
        solver.advance(0.25 / np.sqrt(G))
        water = assert_sound(solver)
        if k * 0.25 <= 2.0:  # the front is at x = 3.7 m
            before_impact = water
            assert solver.state.clamped.numpy()[0] == 0
            assert np.abs(water.density / 1000.0 - 1.0).max() < 0.03
    assert before_impact.position[:, 0].max() < 3.9
    assert np.mean(water.position[:, 0] > 2.0) > 0.3
    record_property("clamped", int(solver.state.clamped.numpy()[0]))


def block(size, spacing):
    """A block of still water that fills a tank but for ten spacings of air."""
    length = np.asarray(size) * spacing
    return Scene(
        (0.0, 0.0, 0.0),
        (length[0], length[1], length[2] + 10 * spacing),
        spacing,
        Fluid(Box((0.0, 0.0, 0.0), tuple(length)), pressure="hydrostatic"),
    )


def assert_uniform(solver, size):
    """Away from walls and surface the density is within a percent of rest, as the solver has it."""
    water, scene = assert_sound(solver), solver.scene
    support = 2.0 * 1.5 * scene.particle_spacing
    top = np.asarray(size) * scene.particle_spacing
    inside = ((water.position > support) & (water.position < top - support)).all(axis=1)
    assert inside.sum() > 200
    np.testing.assert_allclose(water.density[inside], 1000.0, rtol=0.01)
    return water, inside


def test_block_keeps_its_density():
    size, spacing = (14, 12, 12), 0.05
    solver = Solver(block(size, spacing), device="cpu")
    solver.step(300)
    water, inside = assert_uniform(solver, size)
    # The same from the places of the particles alone: sum of V W, Wendland C2.
    x, h = water.position.astype(float), 1.5 * spacing
    q = np.linalg.norm(x[inside][:, None] - x[None], axis=2) / h
    W = 21.0 / (16.0 * np.pi * h**3) * np.maximum(1.0 - q / 2.0, 0.0) ** 4 * (2.0 * q + 1.0)
    np.testing.assert_allclose(spacing**3 * W.sum(axis=1), 1.0, rtol=0.01)


@pytest.mark.slow
def test_block_of_fifty_thousand_particles_keeps_its_density_for_a_thousand_steps():
    size = (50, 25, 40)
    solver = Solver(block(size, 0.02), device="cpu")
    assert solver.capacity == 50_000
    solver.step(1000)
    assert_uniform(solver, size)


# -- the twelve ------------------------------------------------------------------------------------------------------


@each_stress
def test_stress_holds(stress):
    missed = [str(finding) for finding in stress.run(False, "cpu") if not finding.passed]
    assert not missed


@pytest.mark.slow
@each_stress
def test_stress_holds_for_long(stress):
    missed = [str(finding) for finding in stress.run(True, "cpu") if not finding.passed]
    assert not missed


def test_the_list_is_whole():
    assert [stress.number for stress in STRESSES] == list(range(1, 13))


def test_what_is_not_a_number_misses_its_mark():
    assert Finding("a", 1.0, 1.0).passed and Finding("a", 1.0, 1.0, least=True).passed
    assert not Finding("a", np.nan, 1.0).passed and not Finding("a", np.nan, 1.0, least=True).passed
    assert not Finding("a", 2.0, 1.0).passed and not Finding("a", 0.5, 1.0, least=True).passed


def test_what_is_amiss_is_seen():
    solver = Solver(dam_break(2), device="cpu")
    saved = solver.save()
    saved["position"][0, 0] = -0.1
    saved["velocity"][1, 5] = np.nan
    saved["identity"][3] = 4
    solver.restore(saved)
    sound = Sound()
    sound.look(solver)
    assert [finding.value for finding in sound.findings()] == [1, 1, pytest.approx(2.0, abs=1e-4)]


# -- one world among many --------------------------------------------------------------------------------------------


def test_of_256_worlds_one_is_destroyed_and_255_do_not_notice():
    envs, twins = (FluidVectorEnv(256, "SloshDamp", difficulty="easy", device="cpu") for _ in range(2))
    for one in (envs, twins):
        one.action_space.seed(1)
        one.reset(seed=1)
    others = np.arange(256) != 100
    for step in range(8):
        actions = twins.action_space.sample()
        if step in (2, 5):  # while it lasts: much too fast, and then nowhere
            saved = envs.solver.save()
            slots = slice(100 * envs.solver.capacity, 101 * envs.solver.capacity)
            saved["velocity"][:, slots] *= np.float32(1e4) if step == 2 else np.float32(np.nan)
            saved["velocity"][:, slots] += np.float32(1e3)
            envs.solver.restore(saved)
        found, expected = envs.step(actions), twins.step(actions)
        for mine, theirs in zip(found[:4], expected[:4], strict=True):
            np.testing.assert_array_equal(mine[others], theirs[others])
        if step in (2, 5):
            assert found[2].tolist() == (~others).tolist()
            assert found[4]["reason"][100] in ("not finite", "density", "speed")
            assert (found[4]["reason"][others] == "").all()
    # The world that was destroyed has begun anew, and is like any other.
    assert not found[2].any()
    assert found[0] in envs.observation_space


@pytest.mark.parametrize(("s", "broken"), [(0.4, False), (0.6, True), (-0.7, False), (-0.9, True)])
def test_fluid_that_has_torn_is_thin_and_not_broken(s, broken):
    envs = FluidVectorEnv(2, "SloshDamp", difficulty="easy", device="cpu")
    envs.reset(seed=1)
    assert isinstance(envs.task, FluidTask)
    saved = envs.solver.save()
    saved["density_error"][3] = s  # of the first world
    envs.solver.restore(saved)
    assert measure(envs.solver, 0).credible is not broken
    assert measure(envs.solver, 1).credible
    envs.task.measure()
    assert envs.task.diverged().tolist() == [broken, False]
    assert envs.task.reasons().tolist() == ["density" if broken else "", ""]


# -- soaks ----------------------------------------------------------------------------------------------------------


def test_plans_are_actions_of_every_kind():
    plans = Plans(50, 2, 0.05, np.random.default_rng(0))
    kinds = set()
    for n in range(200):
        kind, plan = plans.draw()
        kinds.add(kind)
        assert plan.shape == (50, 2)
        assert np.abs(plan).max() <= 1.0
        plans.learn(n % 7, plan)
    assert kinds == set(KINDS)


def test_a_soak_is_the_same_again():
    reports = [soak("SloshDamp", {"difficulty": "easy"}, worlds=4, steps=200, seed=3, device="cpu") for _ in range(2)]
    for report in reports:
        report.seconds = 0.0
    assert reports[0] == reports[1]
    assert reports[0].steps == 200 and reports[0].sound
    assert soak("SloshDamp", {"difficulty": "easy"}, worlds=4, steps=200, seed=4, device="cpu") != reports[0]


def test_what_breaks_in_a_soak_breaks_again_in_its_replay(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(fluidgym.envs.fluid_task, "LARGEST_COMPRESSION", 0.02)
    kept = []
    monkeypatch.setattr(
        soaking,
        "keep",
        lambda *given, old=soaking.keep: (kept.append((given[0], len(given[4]), given[5])), old(*given)),
    )
    report = soak(
        "CarryTank", {"difficulty": "easy"}, worlds=4, steps=600, seed=1, folder=tmp_path / "new", device="cpu"
    )
    assert report.diverged == len(kept) == len(report.files) > 0
    assert report.reasons == {"density": report.diverged}
    for path, steps, reason in kept[:3]:
        assert replay(path, "cpu") == (reason, steps)
    assert main(["stress", "--replay", str(kept[0][0]), "--device", "cpu"]) == 1
    assert f"diverged (density) after {kept[0][1]} steps" in capsys.readouterr().out
    monkeypatch.setattr(fluidgym.envs.fluid_task, "LARGEST_COMPRESSION", 0.5)
    assert main(["stress", "--replay", str(kept[0][0]), "--device", "cpu"]) == 0
    assert "sound after" in capsys.readouterr().out


@pytest.mark.parametrize("path", sorted((Path(__file__).parent / "replays").glob("*.npz")), ids=lambda path: path.stem)
def test_what_broke_in_a_soak_breaks_no_more(path):
    assert replay(path, "cpu")[0] == ""


def test_the_command_keeps_what_it_finds(tmp_path, capsys):
    page, table = tmp_path / "stress.md", tmp_path / "stress.json"
    options = ["--hours", "0.0005", "--ids", "SloshDamp2D-v0", "--difficulty", "easy", "--worlds", "4"]
    files = ["--json", str(table), "--markdown", str(page), "--out", str(tmp_path / "failures"), "--device", "cpu"]
    assert main(["stress", "4", *options, *files]) == 0
    said = capsys.readouterr().out
    assert "momentum drift" in said and "fluidgym/SloshDamp2D-v0 easy:" in said
    assert "| `SloshDamp2D-v0` |" in page.read_text() and "| 4 |" in page.read_text()
    assert '"per_million": 0.0' in table.read_text()


def test_tasks_side_by_side_are_driven_as_one_after_another():
    tasks = {name: {"task": name, "difficulty": "easy"} for name in ("SloshDamp", "CarryTank")}
    how = {"worlds": 2, "steps": 60, "seed": 1, "device": "cpu"}
    beside = dict(soak_all(tasks, 2, **how))
    assert list(beside) == list(tasks)
    for name, report in beside.items():
        report.seconds = 0.0
        alone = soak(name, {"difficulty": "easy"}, **how)
        alone.seconds = 0.0
        assert report == alone


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("13", "stress 13 is outside 1 to 12; name one of them"),
        ("--hours -1", "--hours -1 is outside 0 to 10000"),
        ("--hours 1 --jobs 0", "--jobs 0 is less than 1"),
        ("--hours 1 --ids Tsunami2D-v0", "unknown environment Tsunami2D-v0"),
        ("--replay gone.npz", "path = 'gone.npz' does not exist"),
    ],
)
def test_bad_arguments_of_the_command_are_refused(arguments, message, capsys):
    assert main(["stress", *arguments.split()]) == 2
    assert message in capsys.readouterr().err
