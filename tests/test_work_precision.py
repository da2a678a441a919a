"""Run time against error: fronts and ratios by hand, schemes by name, peers by a stand-in for their program."""

import dataclasses
import json
import math
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from fluidgym import peers, work_precision
from fluidgym.diagnostics import front as fluid_front
from fluidgym.diagnostics import kinetic_energy
from fluidgym.peers import PEERS, Peer, Snapshot, hand_over, run_pysph
from fluidgym.scene import NO_SLIP_WALL, OPEN, PERIODIC, Box, Fluid, Material, Scene
from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.solver import Solver
from fluidgym.validation import CASES, Result, dam_break, elliptic_drop, run
from fluidgym.work_precision import (
    SCHEMES,
    Comparison,
    NamedScheme,
    Point,
    SchemeCurve,
    adapted,
    compare,
    draw,
    find_scheme,
    front,
    front_line,
    headline,
    objects,
    pareto,
    ratios,
    time_at,
)

NAN = math.nan


# -- fronts and ratios -----------------------------------------------------------------------------------------------


def test_the_front_is_what_no_other_beats_in_both():
    places = [(1.0, 0.1), (2.0, 0.05), (2.0, 0.2), (3.0, 0.05), (4.0, 0.01), (0.5, NAN), (NAN, 0.001), (5.0, 0.3)]
    assert pareto(places) == [True, True, False, False, True, False, False, False]
    assert front(places) == [(1.0, 0.1), (2.0, 0.05), (4.0, 0.01)]


def test_equals_do_not_beat_each_other():
    assert pareto([(1.0, 0.1), (1.0, 0.1), (1.0, 0.2)]) == [True, True, False]
    assert front([(1.0, 0.1), (1.0, 0.1)]) == [(1.0, 0.1)]


def test_what_has_no_logarithm_is_on_no_front():
    assert front([(1.0, 0.0), (2.0, 0.1), (0.0, 0.01)]) == [(2.0, 0.1)]
    assert front([]) == []


def power_law(errors, factor=1.0, power=-1.5):
    """Times that follow the errors as a power law."""
    return [(factor * error**power, error) for error in errors]


def test_between_points_time_follows_error_as_a_power_law():
    curve = power_law([0.08, 0.04, 0.01])
    for error in (0.08, 0.06, 0.02, 0.01):
        assert time_at(curve, error) == pytest.approx(error**-1.5, rel=1e-12)
    assert math.isnan(time_at(curve, 0.09))
    assert math.isnan(time_at(curve, 0.009))


def test_the_ratio_of_two_power_laws_is_that_of_their_factors():
    ours, theirs = power_law([0.08, 0.04, 0.02]), power_law([0.06, 0.03, 0.015], factor=7.0)
    found = ratios(ours, theirs)
    assert [error for error, _ in found] == [0.06, 0.03]  # the third is beyond our best
    assert [ratio for _, ratio in found] == pytest.approx([7.0, 7.0], rel=1e-12)
    # From their side it is the inverse.
    assert [ratio for _, ratio in ratios(theirs, ours)] == pytest.approx([1.0 / 7.0] * 2, rel=1e-12)


def test_where_theirs_reach_over_ours_the_ratio_is_taken_at_our_errors():
    ours, theirs = power_law([0.04, 0.02]), power_law([0.1, 0.01], factor=3.0)
    assert [error for error, _ in ratios(ours, theirs)] == [0.04, 0.02]
    assert [ratio for _, ratio in ratios(ours, theirs)] == pytest.approx([3.0, 3.0], rel=1e-12)


def test_a_single_point_is_compared_where_the_other_curve_has_its_error():
    assert ratios(power_law([0.04, 0.02]), [(1000.0, 0.03)]) == [(0.03, pytest.approx(1000.0 * 0.03**1.5))]
    assert ratios([(2.0, 0.03)], [(5.0, 0.03)]) == [(0.03, pytest.approx(2.5))]


def test_a_point_that_is_beaten_by_its_own_curve_does_not_count():
    ours = power_law([0.04, 0.02])
    assert ratios(ours, [*power_law([0.03], factor=2.0), (1e6, 0.035)]) == ratios(ours, power_law([0.03], factor=2.0))


def test_curves_whose_errors_do_not_overlap_have_no_ratio():
    assert ratios(power_law([0.04, 0.02]), power_law([0.2, 0.1])) == []
    assert ratios(power_law([0.04, 0.02]), [(1.0, NAN)]) == []
    assert ratios([], power_law([0.2, 0.1])) == []


def points(places, curve="default", **others):
    """Points of a curve on a case, with the error `e`."""
    return [
        Point("toy", 2, 10 * 2**n, curve, 1.0, 100, 10, [time], 0.5, "e", {"e": error}, **others)
        for n, (time, error) in enumerate(places)
    ]


@pytest.mark.parametrize(
    ("ours", "theirs", "said"),
    [
        (
            power_law([0.08, 0.02]),
            power_law([0.06, 0.03], 723.0),
            "default is 720 times as fast as other at an equal error of 0.06 to 0.03",
        ),
        (
            power_law([0.06, 0.03], 4.0),
            power_law([0.08, 0.02]),
            "other is 4 times as fast as default at an equal error of 0.06 to 0.03",
        ),
        (
            [(1.0, 0.02), (0.1, 0.1)],
            [(3.0, 0.3), (9.0, 0.2)],
            "other never reaches the errors of default: its best is 0.2 in 9 s, default has 0.1 in 0.1 s,"
            " at least 90 times as fast",
        ),
        (
            [(3.0, 0.3), (9.0, 0.2)],
            [(20.0, 0.02), (10.0, 0.1)],
            "default never reaches the errors of other: its best is 0.2 in 9 s, other has 0.1 in 10 s",
        ),
        (power_law([0.08, 0.02]), [(1.0, NAN)], "other broke down"),
        ([(1.0, NAN)], power_law([0.08, 0.02]), "default broke down"),
    ],
)
def test_a_line_says_how_two_curves_compare(ours, theirs, said):
    assert compare("default", points(ours), "other", points(theirs, "other"))["said"] == said


def test_a_curve_that_cannot_run_a_case_is_said_to():
    refused = [Point("toy", 2, 10, "other", 1.0, refused="no walls")]
    assert compare("default", points(power_law([0.1])), "other", refused)["said"] == "other cannot run it"


def test_a_row_tells_time_spread_and_error():
    point = Point("toy", 3, 20, "default", 0.5, 100, 10, [1.0, 4.0, 2.0], 0.5, "e", {"d": 9.0, "e": -0.125})
    assert (point.wall_s, point.spread, point.error) == (2.0, 4.0, 0.125)
    row = point.line().split()
    assert row == "toy 3D 1/20 default 0.5 100 10 2.00 s 4.00 0.5 s e 0.125".split()
    assert "broke down" in dataclasses.replace(point, errors={"e": NAN}).line()
    assert dataclasses.replace(point, refused="no walls").line().endswith("cannot run: no walls")
    assert front_line([point, *points([(1.0, 0.3), (9.0, 0.2)])]) == (
        "no other beats in both: default 1/10 (0.3 in 1 s), default 1/20 step 0.5 (0.12 in 2 s)"
    )


# -- schemes by name -------------------------------------------------------------------------------------------------


def test_a_name_that_is_unknown_is_told_with_those_that_are():
    with pytest.raises(ValueError, match=r"unknown scheme nope; known are default, .*mueller"):
        find_scheme("nope")


def test_a_scheme_may_be_a_file(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('[scheme]\nsmoothing_ratio = 2.0\nwalls = {kind = "frozen"}\n')
    found = find_scheme(str(file)).scheme
    assert found is not None
    assert found.smoothing_ratio == 2.0
    assert type(found.walls).__name__ == "FrozenWalls"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "cannot be read"),
        ("title = 'x'\n", "no table [scheme]"),
        ("[scheme]\nsmoothing = 2.0\n", "did you mean smoothing_ratio"),
        ("[scheme]\ncourant = 9.0\n", "Scheme.courant = 9 is outside"),
        ("[scheme\n", "is not TOML"),
    ],
)
def test_a_file_that_has_no_scheme_is_refused_in_one_line(tmp_path, text, said):
    file = tmp_path / "mine.toml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ValueError) as caught:
        find_scheme(str(file))
    assert str(caught.value).startswith(str(file))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_default_is_the_scheme_of_the_case_and_delta_that_of_all():
    own = Scheme(smoothing_ratio=2.0, courant=0.8)
    case = dataclasses.replace(dam_break.CASE, scheme=own)
    assert adapted(case, SCHEMES["default"]).scheme == own
    assert adapted(case, SCHEMES["delta"]).scheme == DEFAULT_SCHEME
    assert adapted(case, SCHEMES["default"], 0.5).scheme == dataclasses.replace(own, courant=0.4)


def test_the_parts_of_a_case_are_adapted_too():
    case = CASES["shear-start-up"]
    found = adapted(case, SCHEMES["default"], 0.5)
    assert {part.scheme.courant for part in found.parts.values()} == {0.5}
    own = {name: dataclasses.replace(part.scheme, courant=0.5) for name, part in case.parts.items()}
    assert {name: part.scheme for name, part in found.parts.items()} == own
    assert {part.scheme for part in adapted(case, SCHEMES["mueller"]).parts.values()} == {SCHEMES["mueller"].scheme}


def test_a_scheme_that_needs_viscosity_is_given_it():
    plain = dam_break.scene(20, 2)
    found = adapted(dam_break.CASE, SCHEMES["mueller"]).scene(20, 2)
    # A kernel that ends at h = 2 dx.
    assert found.material.viscosity == pytest.approx(plain.sound_speed * 2.0 * plain.particle_spacing / 160.0)
    assert dataclasses.replace(found.material, viscosity=0.0) == plain.material
    thick = dataclasses.replace(
        dam_break.CASE, scene=lambda n, dim: dataclasses.replace(plain, material=Material(viscosity=1.0))
    )
    assert adapted(thick, SCHEMES["mueller"]).scene(20, 2).material.viscosity == 1.0
    assert adapted(dam_break.CASE, SCHEMES["plain"]).scene is dam_break.scene


@pytest.mark.parametrize("name", SCHEMES)
def test_every_named_scheme_runs_a_dam_break(name):
    result = run(adapted(dam_break.CASE, SCHEMES[name]), 5, 2, "cpu", end=1.05 * dam_break.TIME_UNIT)
    assert 0.0 < result.errors["front"] < 1.0


def test_the_headline_is_named_or_the_first_error_with_a_goal():
    assert headline(dam_break.CASE) == "front"
    assert headline(dataclasses.replace(dam_break.CASE, headline="impulse")) == "impulse"
    assert headline(dataclasses.replace(dam_break.CASE, goal={})) == ""
    assert all(headline(case) for case in CASES.values())


# -- comparisons -----------------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Toy:
    """A curve whose time and error are what it is told; it notes when it is run."""

    name: str
    log: list
    time: float = 1.0
    fails: Exception | None = None
    error: float | None = None

    def run(self, case, resolution, dim, courant, progress):
        self.log.append((self.name, resolution, courant))
        if self.fails:
            raise self.fails
        progress(case.end)
        error = 1.0 / resolution if self.error is None else self.error
        seconds = self.time * resolution**2 / courant * (1.0 + 0.1 * len(self.log))
        return Result(
            case=case.name,
            resolution=resolution,
            dim=dim,
            particles=resolution,
            steps=round(resolution / courant),
            wall_s=seconds,
            setup_s=1.0 / len(self.log),
            device="toy",
            errors={"front": error},
            target={},
            goal={},
            times=np.zeros(1),
            records={},
        )


def silent(label, duration):
    return lambda done: None


def test_curves_are_run_in_turn_and_the_median_counts():
    log: list = []
    curves = [Toy("default", log), Toy("other", log, time=3.0)]
    plan = [(dam_break.CASE, 10, 2), (dam_break.CASE, 20, 2)]
    comparison = Comparison(plan, curves, [1.0, 0.5], 3)
    told = [line for lines in comparison.run(silent) for line in lines]
    once = [("default", 10, 1.0), ("default", 10, 0.5), ("other", 10, 1.0), ("other", 10, 0.5)]
    assert log == once * 3 + [(name, 20, courant) for name, _, courant in once] * 3
    assert [len(point.seconds) for point in comparison.points] == [3] * 8
    first = comparison.points[0]
    assert first.wall_s == pytest.approx(100.0 * 1.5)  # the first, fifth and ninth run
    assert first.setup_s == 1.0
    assert sum(line.startswith("dam-break 2D") for line in told) == 8
    assert any("times as fast as other at an equal error" in line for line in told)
    assert comparison.rest() == []


def test_what_is_refused_or_broke_down_is_not_tried_again():
    log: list = []
    curves = [
        Toy("default", log),
        Toy("walled", log, fails=ValueError("needs walls")),
        Toy("shaky", log, error=NAN),
        Toy("unfit", log, fails=np.linalg.LinAlgError("did not converge")),
    ]
    comparison = Comparison([(dam_break.CASE, 10, 2), (dam_break.CASE, 20, 2)], curves, [1.0], 2)
    told = [line for lines in comparison.run(silent) for line in lines]
    assert [name for name, resolution, _ in log if resolution == 10] == [c.name for c in curves] + ["default"]
    assert sum("needs walls" in line for line in told) == 1  # once for a case
    assert sum("broke down" in line for line in told) == 4 + 2  # a row each, and a line each
    found = json.loads(json.dumps(objects({"machine": {}}, comparison.points), allow_nan=False))
    assert found[0] == {"machine": {}}
    rows = {(row["curve"], row["resolution"]): row for row in found[1:-1]}
    assert rows["walled", 10]["refused"] == "needs walls"
    assert rows["shaky", 10] | {"error": None, "broke_down": True, "on_front": False} == rows["shaky", 10]
    assert rows["unfit", 20]["broke_down"]
    assert rows["default", 20] | {"error": 0.05, "on_front": True, "broke_down": False} == rows["default", 20]
    said = {row["against"]: row["said"] for row in found[-1]["summary"]}
    assert said == {"walled": "walled cannot run it", "shaky": "shaky broke down", "unfit": "unfit broke down"}


def test_an_interrupted_comparison_still_tells_what_it_has():
    log: list = []
    curves = [Toy("default", log), Toy("late", log, fails=KeyboardInterrupt())]
    comparison = Comparison([(dam_break.CASE, 10, 2), (dam_break.CASE, 20, 2)], curves, [1.0], 3)
    with pytest.raises(KeyboardInterrupt):
        for _ in comparison.run(silent):
            pass
    row, best, empty = comparison.rest()
    assert row.startswith("dam-break 2D")
    assert "default 1/10" in best
    assert empty == ""


def test_a_curve_of_ours_is_a_run_of_the_suite():
    case = dataclasses.replace(dam_break.CASE, end=1.05 * dam_break.TIME_UNIT)
    done: list = []
    result = SchemeCurve("x", NamedScheme("", Scheme(courant=0.5)), "cpu").run(case, 5, 2, 2.0, done.append)
    assert result.errors == run(case, 5, 2, "cpu").errors
    assert sum(done) == pytest.approx(case.end, rel=0.06)


# -- plots -----------------------------------------------------------------------------------------------------------


def test_a_plot_has_a_panel_for_each_case_and_a_line_for_each_curve(tmp_path):
    found = points(power_law([0.08, 0.04, 0.02])) + points(power_law([0.2, 0.1], 5.0), "other")
    found += [*points([(1.0, NAN)], "shaky"), Point("toy", 2, 10, "refused", 1.0, refused="no walls")]
    one, two = tmp_path / "one.png", tmp_path / "two.png"
    draw(found, "a machine, " * 40, one)
    draw(found + [dataclasses.replace(point, case="second") for point in found], "a machine", two)
    assert sorted(tmp_path.iterdir()) == [one, two]
    narrow, wide = Image.open(one).convert("RGB"), Image.open(two).convert("RGB")
    assert wide.width > narrow.width
    colours = {colour for _, colour in narrow.getcolors(1 << 24) or ()}
    drawn = [tuple(int(text[k : k + 2], 16) for k in (1, 3, 5)) for text in work_precision.COLOURS[:3]]
    assert [colour in colours for colour in drawn] == [True, True, False]


def test_a_plot_of_nothing_is_still_a_file(tmp_path):
    draw(points([(1.0, NAN)]), "a machine", tmp_path / "empty.svg")
    assert "<svg" in (tmp_path / "empty.svg").read_text()


# -- peers -----------------------------------------------------------------------------------------------------------

FAKE = """
import json, sys
import numpy as np
if sys.argv[1:] == ["--version"]:
    print("1.2.3")
    sys.exit(0)
handed = np.load(sys.argv[1])
facts = json.loads(str(handed["facts"]))
flow = dict(np.load({flow!r}))
assert facts["method"] == "fake", facts
assert handed["position"].shape == handed["velocity"].shape == flow["position"][0].shape
assert np.allclose(handed["position"], flow["position"][0]) and np.allclose(handed["velocity"], flow["velocity"][0])
assert handed["pressure"].shape == flow["pressure"][0].shape
for now in handed["times"]:
    print("time", now, flush=True)
{ending}
said = {{"wall_s": 2.5, "setup_s": 9.0, "steps": 77, "gamma": {gamma}}}
np.savez(sys.argv[2], facts=json.dumps(said), **flow)
"""


def fake_peer(folder, flow, ending="", gamma=1.0):
    """A peer whose program hands back a flow that is already known."""
    np.savez(folder / "known.npz", **flow)
    script = folder / "fake.py"
    script.write_text(FAKE.format(flow=str(folder / "known.npz"), ending=ending, gamma=gamma))
    return Peer("fake", "a stand-in", "fake-package", script, "fake")


def exact_drop(resolution):
    """The elliptic drop as its equations have it: each particle keeps its place in the ellipse."""
    scene = elliptic_drop.scene(resolution, 2)
    start, times = scene.sample(), np.concatenate([[0.0], elliptic_drop.TIMES])
    b, center = elliptic_drop.reference(times)
    a = 1.0 / b
    rate = np.sqrt(center * (a**2 + b**2))  # C = A^2 / (a^2 + b^2) where R = 1
    position = start.position * np.stack([a, b], axis=1)[:, None]
    velocity = position * np.stack([-rate, rate], axis=1)[:, None]
    pressure = 1000.0 * center[:, None] * (1.0 - (start.position**2).sum(axis=1))
    density = 1000.0 + pressure / 1400.0**2
    return {"position": position, "velocity": velocity, "density": density, "pressure": pressure}


def test_a_peer_that_is_exact_has_next_to_no_error(tmp_path):
    flow, done = exact_drop(20), []
    result = peers.run(
        fake_peer(tmp_path, flow), elliptic_drop.CASE, 20, interpreter=sys.executable, progress=done.append
    )
    assert result.errors["b"] < 1e-12
    assert result.errors["center_pressure"] < 0.02  # a mean over some spacings
    assert abs(result.errors["energy"]) < 3e-3
    assert (result.wall_s, result.setup_s, result.steps, result.particles) == (2.5, 9.0, 77, 1264)
    assert sum(done) == pytest.approx(elliptic_drop.CASE.end)


def test_a_peer_that_is_wrong_has_just_that_error(tmp_path):
    flow = exact_drop(20)
    flow["position"][1:, :, 1] *= 1.03
    result = peers.run(fake_peer(tmp_path, flow), elliptic_drop.CASE, 20, interpreter=sys.executable)
    assert result.errors["b"] == pytest.approx(0.03, rel=1e-9)


@pytest.mark.parametrize(
    ("ending", "said"),
    [
        ("sys.exit('the peer is not well')", "fake failed: the peer is not well"),
        ("flow['pressure'] = flow['pressure'][:2]", "fake handed back pressure of shape"),
        ("del flow['density']", "fake handed back no flow"),
    ],
)
def test_a_peer_that_fails_says_so(tmp_path, ending, said):
    peer = fake_peer(tmp_path, exact_drop(10), ending)
    with pytest.raises(ValueError, match=said):
        peers.run(peer, elliptic_drop.CASE, 10, interpreter=sys.executable)


def test_a_peer_that_breaks_down_has_no_error(tmp_path):
    peer = fake_peer(tmp_path, exact_drop(10), f"sys.exit({peers.BROKEN})")
    assert run_pysph.BROKEN == peers.BROKEN
    result = peers.run(peer, elliptic_drop.CASE, 10, interpreter=sys.executable)
    point = Point("elliptic-drop", 2, 10, "fake", 1.0, headline="b")
    point.add(result)
    assert point.broke_down


def test_the_version_of_a_peer_is_asked_of_its_interpreter(tmp_path):
    peer = fake_peer(tmp_path, {})
    assert peers.version(peer, sys.executable) == "1.2.3"
    with pytest.raises(ValueError, match=r"no/such/python does not run"):
        peers.version(peer, "no/such/python")
    peer.script.write_text("import no_such_peer")
    with pytest.raises(ValueError, match=r"has no fake-package \(ModuleNotFoundError.*--peer-python"):
        peers.version(peer, sys.executable)


def test_the_interpreter_is_named_or_in_the_environment_or_our_own(monkeypatch):
    monkeypatch.delenv(peers.INTERPRETER, raising=False)
    assert peers.find_interpreter() == sys.executable
    monkeypatch.setenv(peers.INTERPRETER, "/there/python")
    assert peers.find_interpreter() == "/there/python"
    assert peers.find_interpreter("/here/python") == "/here/python"


def test_what_is_handed_over_is_the_scene(tmp_path):
    scene = dam_break.scene(10, 2)
    hand_over(scene, np.array([0.1, 0.2]), tmp_path / "scene.npz", "auto", 0.5)
    handed = np.load(tmp_path / "scene.npz")
    facts, start = json.loads(str(handed["facts"])), scene.sample()
    assert facts == {
        "method": "auto",
        "courant": 0.5,
        "ratio": None,
        "dim": 2,
        "spacing": 0.06,
        "density": 1000.0,
        "sound_speed": pytest.approx(10.0 * math.sqrt(9.81 * 0.6)),
        "reference_speed": pytest.approx(math.sqrt(9.81 * 0.6)),
        "viscosity": 0.0,
        "gravity": [0.0, -9.81],
        "lower": [0.0, 0.0],
        "upper": [pytest.approx(3.2196), pytest.approx(2.4)],
        "faces": ["wall"] * 4,
    }
    for name in ("position", "velocity", "pressure"):
        assert np.array_equal(handed[name], getattr(start, name))
    assert handed["times"].tolist() == [0.1, 0.2]


def test_a_snapshot_is_looked_at_as_a_solver_is():
    solver = Solver(dam_break.scene(16, 2), device="cpu")
    solver.advance(2.7 * dam_break.TIME_UNIT)  # against the far wall
    now = solver.particles()
    snapshot = Snapshot(solver.scene, solver.scheme, 0.0, now.position, now.velocity, now.density, now.pressure)
    seen, expected = dam_break.observe(snapshot), dam_break.observe(solver)  # pyright: ignore[reportArgumentType]
    assert expected["P1"] > 0.5
    assert seen == pytest.approx(expected, rel=1e-6)
    assert fluid_front(snapshot.particles(), snapshot.scene) == fluid_front(now, solver.scene)
    assert kinetic_energy(snapshot.particles(), snapshot.scene) == kinetic_energy(now, solver.scene)


@pytest.mark.parametrize(
    ("name", "said"),
    [("shear-start-up", "parts"), ("wavemaker", "controls"), ("still-tank", None), ("channel", "inflows")],
)
def test_what_a_peer_cannot_be_handed_is_refused(name, said, tmp_path):
    peer = fake_peer(tmp_path, {}, "sys.exit('not asked')")
    with pytest.raises(ValueError, match=said or "failed"):
        peers.run(peer, CASES[name], 10, interpreter=sys.executable)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"faces": {"y_min": NO_SLIP_WALL}}, "walls of no slip"),
        ({"material": Material(viscosity=1e-3)}, "viscosity beside walls"),
        ({"central_force": 1.0}, "a central force"),
    ],
)
def test_a_scene_that_a_peer_would_get_wrong_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        peers.check_scene(dataclasses.replace(dam_break.scene(10, 2), **changes))


def facts_of(scene, tmp_path):
    hand_over(scene, np.ones(1), tmp_path / "scene.npz", "auto")
    return json.loads(str(np.load(tmp_path / "scene.npz")["facts"]))


def test_wall_particles_carry_the_lattice_on_through_the_walls(tmp_path):
    scene = Scene((0.0, 0.0), (1.0, 0.8), 0.1, [Fluid(Box((0.0, 0.0), (0.5, 0.5)))])
    walls = run_pysph.wall_particles(facts_of(scene, tmp_path))
    inside = ((walls > 0.0) & (walls < (1.0, 0.8))).all(axis=1)
    assert not inside.any()
    # Four layers at both sides and below, corners among them; gravity needs no lid.
    assert len(walls) == (10 + 8) * (8 + 4) - 10 * 8
    cells = np.round(np.concatenate([walls, scene.sample().position]) / 0.1 - 0.5, 9)
    assert np.array_equal(cells, np.round(cells))
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert (walls.min(axis=0), walls.max(axis=0)) == (pytest.approx([-0.35, -0.35]), pytest.approx([1.35, 0.75]))


def test_what_is_open_or_periodic_has_no_wall_particles(tmp_path):
    fluid = [Fluid(Box((0.0, 0.0), (1.0, 1.0)))]
    names = ("x_min", "x_max", "y_min", "y_max")
    for kind in (OPEN, PERIODIC):
        scene = Scene((0.0, 0.0), (1.0, 1.0), 0.1, fluid, dict.fromkeys(names, kind), 0.0, reference_speed=1.0)
        assert run_pysph.wall_particles(facts_of(scene, tmp_path)).shape == (0, 2)
    floor = {"x_min": PERIODIC, "x_max": PERIODIC}
    walls = run_pysph.wall_particles(facts_of(Scene((0.0, 0.0), (1.0, 1.0), 0.1, fluid, floor), tmp_path))
    assert len(walls) == 40
    assert (walls[:, 1] < 0.0).all()
    # Without gravity there is a lid as well, and in three dimensions every axis has its walls.
    box = Scene((0.0,) * 3, (1.0,) * 3, 0.2, [Fluid(Box((0.0,) * 3, (1.0,) * 3))], gravity=0.0, reference_speed=1.0)
    assert len(run_pysph.wall_particles(facts_of(box, tmp_path))) == 13**3 - 5**3


@pytest.mark.slow
@pytest.mark.parametrize("name", PEERS)
def test_pysph_runs_the_same_scenes(name):
    python = peers.find_interpreter()
    if subprocess.run([python, "-c", "import pysph"], capture_output=True).returncode:
        pytest.skip("PySPH is not there; the rest of this file tests what is ours with a peer of its own")
    assert peers.version(PEERS[name], python)
    drop = peers.run(PEERS[name], elliptic_drop.CASE, 10)
    assert 0.0 < drop.errors["b"] < 0.05
    assert drop.wall_s > 0.0
    column = peers.run(PEERS[name], dam_break.CASE, 10)
    assert 0.05 < column.errors["front"] < 0.4
    half = peers.run(PEERS[name], dam_break.CASE, 10, courant=0.5)
    assert half.steps > 1.7 * column.steps
    assert half.errors["front"] == pytest.approx(column.errors["front"], rel=0.1)
