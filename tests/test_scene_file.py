"""Scene files: what is read from them and written to them, and what is refused."""

import dataclasses
import math
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from fluidgym import scene_file
from fluidgym.experiment import Experiment, Keyframes, Sine, Steps, View
from fluidgym.parts import Body, Face, Fluid, Inflow, Material, Outflow
from fluidgym.scene import OPEN, Ball, Box, Region, Scene
from fluidgym.scene_file import dumps, load, load_scheme, loads, save
from fluidgym.scheme import DEFAULT_SCHEME, FIDELITIES, MUELLER, Scheme
from fluidgym.sph.constants import Constants
from fluidgym.sph.integrators import EXPLICIT_EULER, LEAPFROG
from fluidgym.sph.smoothing import CUBIC_SPLINE, WENDLAND_C4
from fluidgym.sph.state_equation import TAIT
from fluidgym.sph.terms import Drag, Force
from fluidgym.sph.viscosity import VISCOSITY_MONAGHAN
from fluidgym.sph.wall_models import ClampWalls, FrozenWalls, PenaltyWalls

SCENES = sorted((Path(__file__).resolve().parents[1] / "examples" / "scenes").glob("*.toml"))

SMALLEST = """
duration = 1
lower = [0, 0]
upper = [2, 1]
particle_spacing = 0.1

[[fluid]]
shape = {box = [[0, 0], [1, 0.5]]}
"""

FULL = """
title = "All there is"
duration = 1.5
lower = [0, 0, 0]
upper = [2.0, 1.0, 1.0]
particle_spacing = 0.1
gravity = [0.0, 0.0, -3.7]
reference_speed = 4.0
jitter = 0.1
seed = 7
reserve = 1234
central_force = 0.5

[[fluid]]
shape = {box = [[0, 0, 0], [1, 1, 0.4]]}
pressure = "hydrostatic"
temperature = 20.0

[[fluid]]
shape.ball = {center = [1.5, 0.5, 0.5], radius = 0.2}
velocity = [-1, 0, 0]

[material]
density = 900.0
viscosity = 1e-3
sound_speed = 60.0
thermal_diffusivity = 1e-4

[faces]
x_min = {slip = "no", sliding = [0, 0.5, 0], temperature = 30}
x_max = {moving = true, travel = [1.8, 2], start = 1.9}
y_min = {kind = "periodic"}
y_max = {kind = "periodic"}
z_max = {kind = "open"}

[bodies.gate]
shape = {box = {lower = [1.2, 0, 0], upper = [1.21, 1, 1]}}
slip = "no"
moving = true
travel = [[0, 0, 0], [0, 0, 0.5]]
temperature = 25.0

[bodies.stone]
shape = {ball = [[1.4, 0.5, 0.2], 0.1]}

[inflows.jet]
center = [0.2, 0.5, 0.8]
direction = [1, 0, 0]
width = 0.2
height = 0.1
speed = 1.0
max_speed = 2.0
profile = "parabolic"
length = 0.4
temperature = 50.0

[outflows.drain]
region = {box = [[1.8, 0, 0], [2, 1, 0.1]]}
direction = "+x"
pressure = 100.0

[scheme]
fidelity = "accurate"
kernel = "wendland-c4"
smoothing_ratio = 1.4
state_equation = "tait"
gamma = 5
tension = false
tear = 0.02
density_diffusion = 0.2
artificial_viscosity = 0.02
acoustic_damping = 0.4
sound_speed_ratio = 12.0
shifting = 0.5
surface_shifting = 0.0
core = 0.75
viscosity = "monaghan"
integrator = "leapfrog"
walls = {kind = "penalty", stiffness = 0.4, margin = 0.9}
courant = 0.5

[[motion]]
target = "gravity"
kind = "sine"
axis = "x"
amplitude = 0.3
period = 1.2
phase = 0.1
ramp = 2

[[motion]]
target = "faces.x_max"
kind = "keyframes"
times = [0, 1]
values = [0, -0.1]
displacement = true

[[motion]]
target = "bodies.gate"
kind = "keyframes"
times = [0, 1]
values = [[0, 0, 0], [0, 0, 0.5]]

[[motion]]
target = "inflows.jet"
kind = "steps"
times = [0.5]
values = [2]
rise = 0.1

[view]
colour = "temperature"
value_range = [20, 50]
frames_per_second = 20
slow_motion = 2
size = [320, 200]
"""

FULL_EXPERIMENT = Experiment(
    Scene(
        lower=(0.0, 0.0, 0.0),
        upper=(2.0, 1.0, 1.0),
        particle_spacing=0.1,
        fluid=[
            Fluid(Box((0.0, 0.0, 0.0), (1.0, 1.0, 0.4)), pressure="hydrostatic", temperature=20.0),
            Fluid(Ball((1.5, 0.5, 0.5), 0.2), velocity=(-1.0, 0.0, 0.0)),
        ],
        faces={
            "x_min": Face(slip="no", sliding=(0.0, 0.5, 0.0), temperature=30.0),
            "x_max": Face(moving=True, travel=(1.8, 2.0), start=1.9),
            "y_min": Face("periodic"),
            "y_max": Face("periodic"),
            "z_max": OPEN,
        },
        gravity=(0.0, 0.0, -3.7),
        material=Material(900.0, 1e-3, 60.0, 1e-4),
        reference_speed=4.0,
        jitter=0.1,
        seed=7,
        bodies={
            "gate": Body(
                Box((1.2, 0.0, 0.0), (1.21, 1.0, 1.0)), "no", True, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.5)), temperature=25.0
            ),
            "stone": Body(Ball((1.4, 0.5, 0.2), 0.1)),
        },
        inflows={
            "jet": Inflow((0.2, 0.5, 0.8), (1.0, 0.0, 0.0), 0.2, 1.0, 0.1, 2.0, "parabolic", 0.4, temperature=50.0)
        },
        outflows={"drain": Outflow(Box((1.8, 0.0, 0.0), (2.0, 1.0, 0.1)), "+x", 100.0)},
        reserve=1234,
        central_force=0.5,
    ),
    duration=1.5,
    scheme=Scheme(
        kernel=WENDLAND_C4,
        smoothing_ratio=1.4,
        state_equation=TAIT,
        gamma=5.0,
        tension=False,
        tear=0.02,
        density_diffusion=0.2,
        artificial_viscosity=0.02,
        acoustic_damping=0.4,
        sound_speed_ratio=12.0,
        shifting=0.5,
        core=0.75,
        viscosity=VISCOSITY_MONAGHAN,
        integrator=LEAPFROG,
        walls=PenaltyWalls(0.4, 0.9),
        courant=0.5,
    ),
    motions=[
        Sine("gravity", 0.3, 1.2, 0.1, 2.0, "x"),
        Keyframes("faces.x_max", (0.0, 1.0), (0.0, -0.1), displacement=True),
        Keyframes("bodies.gate", (0.0, 1.0), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.5))),
        Steps("inflows.jet", (0.5,), (2.0,), 0.1),
    ],
    title="All there is",
    view=View("temperature", (20.0, 50.0), 20.0, 2.0, (320, 200)),
)


# -- reading and writing -------------------------------------------------------------------------------------------


def test_a_file_can_say_everything():
    assert loads(FULL) == FULL_EXPERIMENT


def test_everything_a_file_can_say_is_in_the_test_above():
    """A new field must be read and written without a line of code; this makes the test use it."""
    texts = FULL.replace("shape.ball", "shape")
    for kind in (Scene, Experiment, Face, Fluid, Material, Body, Inflow, Outflow, Scheme, Sine, Keyframes, Steps, View):
        for field in fields(kind):
            if (kind, field.name) in ((Experiment, "scene"), (Scheme, "terms"), (Scheme, "preset")):
                continue
            name = {"motions": "motion"}.get(field.name, field.name)
            assert f"{name} =" in texts or f"[{name}]" in texts or f"[{name}." in texts, (kind, name)


def test_what_is_left_out_has_its_default():
    experiment = loads(SMALLEST)
    scene = Scene((0.0, 0.0), (2.0, 1.0), 0.1, [Fluid(Box((0.0, 0.0), (1.0, 0.5)))])
    assert experiment == Experiment(scene, 1.0)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_an_example_is_the_same_after_writing_and_reading(path):
    experiment = load(path)
    assert experiment.title
    assert loads(dumps(experiment)) == experiment


@pytest.mark.parametrize(
    "scheme",
    [
        Scheme(),
        MUELLER,
        Scheme(preset="mueller", integrator=EXPLICIT_EULER, tension=True, walls=ClampWalls(0.1)),
        Scheme(kernel=CUBIC_SPLINE, walls=FrozenWalls(), courant=0.4),
        Scheme(state_equation=TAIT, viscosity=VISCOSITY_MONAGHAN, tension=False),
        Scheme(surface_shifting=4.0),
    ],
)
def test_any_scheme_of_named_parts_is_the_same_after_writing_and_reading(scheme):
    experiment = replace(loads(SMALLEST), scheme=scheme)
    assert loads(dumps(experiment)).scheme == scheme


@pytest.mark.parametrize("name", FIDELITIES)
def test_a_fidelity_is_a_scheme_by_its_name_and_stays_one_after_writing(name, tmp_path):
    experiment = loads(SMALLEST + f"[scheme]\nfidelity = '{name}'")
    assert experiment.scheme == FIDELITIES[name]
    assert experiment == loads(f"scheme.fidelity = '{name}'" + SMALLEST)
    save(experiment, tmp_path / "saved.toml")
    assert load(tmp_path / "saved.toml") == experiment
    written = (tmp_path / "saved.toml").read_text()
    if experiment.scheme == DEFAULT_SCHEME:
        assert "scheme" not in written
    else:
        assert f'[scheme]\nfidelity = "{name}"\n' in written
        assert load_scheme(tmp_path / "saved.toml") == FIDELITIES[name]


def test_keys_beside_a_fidelity_stand_in_for_single_fields_of_it(monkeypatch):
    monkeypatch.setitem(FIDELITIES, "fast", Scheme(courant=0.9, gamma=5.0))
    text = SMALLEST + "[scheme]\nfidelity = 'fast'\ngamma = 3\nkernel = 'wendland-c4'"
    experiment = loads(text)
    assert experiment.scheme == Scheme(courant=0.9, gamma=3.0, kernel=WENDLAND_C4)
    assert loads(dumps(experiment)) == experiment
    # What a preset takes for itself is not that of the fidelity.
    experiment = loads(SMALLEST + "[scheme]\nfidelity = 'fast'\npreset = 'mueller'")
    assert experiment.scheme == Scheme(courant=0.9, gamma=5.0, preset="mueller")


def test_a_fidelity_can_stand_in_for_that_of_the_file(monkeypatch):
    monkeypatch.setitem(FIDELITIES, "accurate", Scheme(courant=0.8, gamma=5.0))
    assert loads(SMALLEST, fidelity="accurate").scheme == FIDELITIES["accurate"]
    text = SMALLEST + "[scheme]\nfidelity = 'fast'\ngamma = 3"
    assert loads(text, fidelity="accurate").scheme == Scheme(courant=0.8, gamma=3.0)
    with pytest.raises(ValueError, match=r'^scene file: scheme\.fidelity = "best" is unknown; .*"accurate"$'):
        loads(text, fidelity="best")
    with pytest.raises(ValueError, match=r"^scene file: scheme = 3 is not a table"):
        loads("scheme = 3" + SMALLEST, fidelity="fast")


def test_everything_is_the_same_after_writing_and_reading(tmp_path):
    assert loads(dumps(FULL_EXPERIMENT)) == FULL_EXPERIMENT
    save(FULL_EXPERIMENT, tmp_path / "full.toml")
    assert load(tmp_path / "full.toml") == FULL_EXPERIMENT
    assert [path.name for path in tmp_path.iterdir()] == ["full.toml"]


def test_only_what_a_reader_needs_is_written():
    text = dumps(loads(SMALLEST))
    tables = {line for line in text.splitlines() if line.startswith("[")}
    assert tables == {"[material]", "[[fluid]]", "[fluid.shape]"}
    keys = {line.partition(" = ")[0] for line in text.splitlines() if " = " in line}
    assert keys == {"duration", "lower", "upper", "particle_spacing", "gravity", "box", "density"}


def test_numbers_of_numpy_are_written_as_numbers():
    scene = replace(loads(SMALLEST).scene, particle_spacing=np.float32(0.125), seed=np.int64(3))
    assert loads(dumps(Experiment(scene, np.float64(2.0)))) == Experiment(scene, 2.0)


def test_the_reserve_that_a_scene_finds_for_itself_follows_its_spacing():
    text = SMALLEST + "[inflows.jet]\ncenter = [0.2, 0.8]\ndirection = [1, 0]\nwidth = 0.2\nspeed = 1\n"
    coarse, fine = loads(text), loads(dumps(loads(text)), particle_spacing=0.05)
    assert "reserve" not in dumps(coarse)
    assert fine.scene.reserve > 3 * coarse.scene.reserve


def test_a_spacing_can_stand_in_for_that_of_the_file():
    assert loads(SMALLEST, particle_spacing=0.05).scene.particle_spacing == 0.05
    with pytest.raises(ValueError, match="particle_spacing"):
        loads(SMALLEST, particle_spacing=math.nan)


def test_a_new_field_of_a_part_needs_no_code(monkeypatch):
    """What a file may say follows the dataclass."""

    @dataclasses.dataclass(frozen=True)
    class Wetter(Material):
        surface_tension: float = 0.0
        wet: bool = False

    Wetter.__name__ = "Material"
    monkeypatch.setitem(scene_file._hints(Scene), "material", Wetter)
    scene = loads(SMALLEST + "[material]\nsurface_tension = 0.07\nwet = true").scene
    assert scene.material == Wetter(surface_tension=0.07, wet=True)
    assert loads(dumps(Experiment(scene, 1.0))).scene == scene


def test_what_is_a_function_is_not_written():
    scene = loads(SMALLEST).scene
    box = Box((0.0, 0.0), (1.0, 0.5))
    region = Region(lambda points: points[:, 0] < 0.5, (0.0, 0.0), (1.0, 0.5))

    @wp.func
    def own(r: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
        return 0.0 * slope

    for experiment, field in (
        (Experiment(replace(scene, fluid=[Fluid(region)]), 1.0), "fluid[0].shape"),
        (
            Experiment(replace(scene, fluid=[Fluid(box, velocity=lambda points: 0.0 * points)]), 1.0),
            "fluid[0].velocity",
        ),
        (
            Experiment(replace(scene, fluid=[Fluid(box, pressure=lambda points: points[:, 0])]), 1.0),
            "fluid[0].pressure",
        ),
        (Experiment(scene, 1.0, Scheme(terms=(Force(own),))), "scheme.terms[0]"),
        (Experiment(scene, 1.0, Scheme(viscosity=Drag(own))), "scheme.viscosity"),
        (Experiment(scene, 1.0, Scheme(kernel=replace(WENDLAND_C4, name="mine"))), "scheme.kernel"),
    ):
        with pytest.raises(ValueError) as refused:
            dumps(experiment)
        message = str(refused.value)
        assert field in message
        assert "a file cannot hold" in message
        assert len(message.splitlines()) == 1


# -- what is refused --------------------------------------------------------------------------------------------------

GATE = "[bodies.gate]\nshape = {ball = {center = [1.5, 0.5], radius = 0.2}}\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        # The syntax, with its line.
        (SMALLEST + "[faces\n", ["not TOML", "line 9"]),
        ("lower = [0, 0]" + SMALLEST, ["not TOML", "line 3"]),
        ("a = " + "[" * 100_000, ["nested too deeply"]),
        ("seed = " + "9" * 5000, ["not TOML", "digits"]),
        # Keys.
        (SMALLEST.replace("upper", "uper"), ["uper is unknown", "did you mean upper?"]),
        (SMALLEST + GATE + "colour = 1", ["bodies.gate.colour is unknown", "moving, shape, slip, temperature, travel"]),
        (
            SMALLEST + GATE.replace("radius", "radus"),
            ["bodies.gate.shape.ball.radus is unknown", "did you mean radius?"],
        ),
        (SMALLEST + "[scheme]\nkernal = 'poly6'", ["scheme.kernal is unknown", "did you mean kernel?"]),
        (SMALLEST + "[views]\nfps = 3", ["views is unknown", "did you mean view?"]),
        (SMALLEST + "gravity = 1", ["fluid[0].gravity is unknown", "top of the file"]),
        (SMALLEST.replace("duration = 1", ""), ["duration is missing"]),
        (SMALLEST.replace("lower = [0, 0]", ""), ["lower is missing"]),
        (SMALLEST + "[[fluid]]\npressure = 'none'", ["fluid[1].shape is missing", "{box = "]),
        # Types.
        (SMALLEST.replace("= 0.1", "= '0.1'"), ['particle_spacing = "0.1"', "is not a number"]),
        (SMALLEST.replace("= 0.1", "= true"), ["particle_spacing = true", "is not a number"]),
        (SMALLEST.replace("= 0.1", "= 1979-05-27"), ["particle_spacing", "1979-05-27", "is not a number"]),
        (SMALLEST.replace("[2, 1]", "[2, 'a']"), ['upper[1] = "a"', "is not a number"]),
        (SMALLEST.replace("[2, 1]", "2"), ["upper = 2 is not a list of numbers"]),
        (SMALLEST.replace("duration = 1", "duration = 1\nseed = 1.5"), ["seed = 1.5 is not a whole number"]),
        (
            SMALLEST.replace("duration = 1", "duration = 1\ngravity = 'down'"),
            ["gravity", "a list of numbers or a number"],
        ),
        (SMALLEST.replace("[[fluid]]", "[fluid]"), ["fluid is one table", "[[fluid]]"]),
        (SMALLEST + "[faces.x_max]\nmoving = 1", ["faces.x_max.moving = 1", "true or false"]),
        (SMALLEST + "[faces]\nx_max = 'open'", ['faces.x_max = "open"', "a table"]),
        (SMALLEST.replace("= 0.1", f"= 1{400 * '0'}"), ["particle_spacing", "smaller"]),
        (SMALLEST + "[[bodies]]\nname = 'gate'", ["bodies = ", "a table"]),
        # Words.
        (SMALLEST + "[faces.x_max]\nkind = 'opne'", ['faces.x_max.kind = "opne"', 'did you mean "open"?']),
        (SMALLEST + "[scheme]\nkernel = 'wendland'", ["scheme.kernel", "did you mean", '"cubic-spline"']),
        (SMALLEST + "[scheme]\nintegrator = 4", ["scheme.integrator = 4", "leapfrog"]),
        (SMALLEST + "[scheme]\nwalls = {stiffness = 1}", ["scheme.walls.kind is missing", '"penalty"']),
        (SMALLEST + "[scheme]\nwalls = {kind = 'penality'}", ["scheme.walls.kind", 'did you mean "penalty"?']),
        (
            SMALLEST + "[scheme]\nwalls = {kind = 'clamp', stiffness = 1}",
            ["scheme.walls.stiffness is unknown", "damping"],
        ),
        (
            SMALLEST + "[scheme]\nfidelity = 'acurate'",
            ["scheme.fidelity", 'did you mean "accurate"?', '"fast", "balanced"'],
        ),
        (SMALLEST + "[scheme]\nfidelity = 3", ["scheme.fidelity = 3", '"fast", "balanced", "accurate"']),
        (SMALLEST + "[scheme]\nfidelty = 'fast'", ["scheme.fidelty is unknown", "did you mean fidelity?"]),
        ("fidelity = 'fast'" + SMALLEST, ["fidelity is unknown", "belongs to the table [scheme]"]),
        (SMALLEST + "[[motion]]\ntarget = 'gravity'\nkind = 'sin'", ["motion[0].kind", 'did you mean "sine"?']),
        # Shapes.
        (SMALLEST + "[bodies.gate]\nshape = {bal = [[1, 1], 0.1]}", ["bodies.gate.shape", 'did you mean "ball"?']),
        (
            SMALLEST + "[bodies.gate]\nshape = {box = [[1, 1]]}",
            ["bodies.gate.shape.box has 1 entries", "lower and upper"],
        ),
        (SMALLEST + "[bodies.gate]\nshape = {box = 3}", ["bodies.gate.shape.box = 3"]),
        (SMALLEST + "[bodies.gate]\nshape = [[1, 1], [2, 2]]", ["bodies.gate.shape = [[1, 1], [2, 2]]", "{box = "]),
        (SMALLEST + "[bodies.gate]\nshape = {}", ["bodies.gate.shape has 0 keys"]),
        (SMALLEST + "[outflows.drain]\nregion = {ball = [[1, 1], 1]}", ["outflows.drain.region", '"box"']),
        (SMALLEST.replace("{box = [[0, 0], [1, 0.5]]}", "{region = 'x < 1'}"), ["fluid[0].shape", '"box", "ball"']),
        # What only Python can say.
        (SMALLEST + "[scheme]\nterms = ['mine']", ["scheme.terms", "a file cannot hold"]),
        # What the parts themselves refuse, with the table in front.
        (SMALLEST + GATE.replace("0.2", "-0.2"), ["bodies.gate: Body.shape", "positive radius"]),
        (SMALLEST + "[faces.x_max]\ntravel = [0, 1]", ["faces.x_max: Face.travel", "moving=True"]),
        (SMALLEST + "[material]\ndensity = -5", ["material: Material.density = -5", "greater than 0"]),
        (SMALLEST + "[scheme.walls]\nkind = 'clamp'\ndamping = 2", ["scheme.walls: ClampWalls.damping = 2"]),
        (SMALLEST + "[faces.w_max]\nkind = 'open'", ["Scene.faces has no face 'w_max'", "x_min"]),
        (SMALLEST.replace("= 0.1", "= 5"), ["Scene.particle_spacing = 5 m"]),
        (SMALLEST.replace("= 0.1", "= inf"), ["Scene.particle_spacing = inf"]),
        (
            SMALLEST + "[[motion]]\nkind='sine'\ntarget='gravity'\namplitude=1\nperiod=0\naxis='x'",
            ["motion[0]: Sine.period"],
        ),
        (
            SMALLEST + "[[motion]]\nkind='steps'\ntarget='bodies.gate'\ntimes=[0]\nvalues=[1]",
            ["'bodies.gate' is unknown"],
        ),
        (SMALLEST + "[view]\ncolour = 'sped'", ["view.colour", 'did you mean "speed"?']),
        (SMALLEST + "[view]\nsize = [640]", ["view.size has 1 entries"]),
    ],
)
def test_a_mistake_is_told_in_one_line_with_the_file_and_the_field(text, said, tmp_path):
    file = tmp_path / "gate.toml"
    file.write_text(text)
    with pytest.raises(ValueError) as refused:
        load(file)
    message = str(refused.value)
    assert message.startswith(f"{file}: ")
    assert len(message.splitlines()) == 1
    assert len(message) < 500
    assert all(word in message for word in said), message


def test_what_is_no_file_is_refused_in_one_line(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b"title = 'caf\xe9'")
    for name, said in (("none.toml", "No such file"), (".", "Is a directory"), ("latin.toml", "not UTF-8")):
        with pytest.raises(ValueError, match=said) as refused:
            load(tmp_path / name)
        assert len(str(refused.value).splitlines()) == 1


def test_a_scene_too_large_for_the_machine_is_refused(monkeypatch):
    def make(*_):
        raise MemoryError

    monkeypatch.setattr(scene_file, "_make", make)
    with pytest.raises(ValueError, match="more particles than this machine can hold"):
        loads(SMALLEST)


def test_a_file_that_cannot_be_written_stays_as_it_was(tmp_path):
    file = tmp_path / "scene.toml"
    save(loads(SMALLEST), file)
    before = file.read_text()
    scene = replace(loads(SMALLEST).scene, fluid=[Fluid(Box((0.0, 0.0), (1.0, 0.5)), pressure=lambda p: p[:, 0])])
    with pytest.raises(ValueError, match="pressure"):
        save(Experiment(scene, 1.0), file)
    assert file.read_text() == before
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("seed", range(20))
def test_whatever_is_changed_in_a_file_is_read_or_refused_in_one_line(seed):
    """Lines of the full file taken out, and values put in the place of others: never any other error."""
    rng = np.random.default_rng(seed)
    values = [
        "-1",
        "0",
        "nan",
        "1e30",
        "'x'",
        "true",
        "[]",
        "{}",
        "[[1]]",
        "[1, 2]",
        "{box = []}",
        "[true]",
        "1979-05-27",
    ]
    for _ in range(25):
        lines = FULL.splitlines()
        for number in rng.integers(len(lines), size=2):
            key, equals, _ = lines[number].partition(" = ")
            lines[number] = f"{key} = {rng.choice(values)}" if equals and rng.random() < 0.8 else ""
        try:
            experiment = loads("\n".join(lines))
        except ValueError as error:
            assert len(str(error).splitlines()) == 1
        else:
            assert loads(dumps(experiment)) == experiment


def test_the_scene_in_the_readme_is_one():
    readme = (SCENES[0].parents[2] / "README.md").read_text(encoding="utf-8")
    (snippet,) = re.findall(r"^```toml\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    experiment = loads(snippet)
    assert experiment.motions[0].target == "bodies.gate"
