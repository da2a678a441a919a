"""A scene pays for what it has: without a feature there is no code for it, no launch and no array."""

import dataclasses
from functools import lru_cache

import pytest
import warp as wp

from fluidgym.scene import NO_SLIP_WALL, OPEN, PERIODIC, Ball, Body, Box, Face, Fluid, Inflow, Material, Outflow, Scene
from fluidgym.scheme import MUELLER, Scheme
from fluidgym.solver import Solver
from fluidgym.sph.integrators import EXPLICIT_EULER
from fluidgym.sph.wall_models import ClampWalls, FrozenWalls

BASE = Scene(
    (0.0, 0.0),
    (1.0, 1.0),
    0.05,
    [Fluid(Box((0.0, 0.0), (0.4, 0.4)))],
    {"x_max": OPEN},
    reference_speed=3.0,
)
FULL = Scene((0.0, 0.0), (1.0, 1.0), 0.05, [Fluid(Box((0.0, 0.0), (1.0, 1.0)))], reference_speed=3.0)
BARE = Scheme(artificial_viscosity=0.0, density_diffusion=0.0, acoustic_damping=0.0, core=0.0)
DIFFUSIVE = dataclasses.replace(BARE, density_diffusion=0.1)


def scene(**changes):
    """The base scene with something in it."""
    return dataclasses.replace(BASE, **changes)


def warm(**changes):
    """The base scene with heat in it."""
    return scene(material=Material(thermal_diffusivity=1e-3), **changes)


SHEET = {"sheet": Body(Box((0.5, 0.0), (0.51, 0.5)))}
JET = {"jet": Inflow((0.0, 0.8), (1.0, 0.0), 0.1, 1.0)}

# What is on, and words of the generated source that only it brings: {kernel: words}.
FEATURES = {
    "viscosity": (scene(material=Material(viscosity=1e-3)), BARE, {"kick": ["viscosity_morris", "float d ="]}),
    "artificial viscosity": (
        BASE,
        dataclasses.replace(BARE, artificial_viscosity=0.1),
        {"kick": ["artificial_viscosity_"]},
    ),
    "density diffusion": (
        BASE,
        DIFFUSIVE,
        {
            "advance_density": ["density_diffusion_", "halved"],
            "gather": ["(var_acceleration, "],
        },
    ),
    "density diffusion of a full box": (FULL, DIFFUSIVE, {"advance_density": ["density_diffusion_"]}),
    "acoustic damping": (
        BASE,
        dataclasses.replace(BARE, acoustic_damping=0.5),
        {"advance_density": [").damping"]},
    ),
    "core": (
        BASE,
        dataclasses.replace(BARE, core=1.0),
        {"advance_density": ["cored_slope", ").core"], "kick": ["cored_slope", ").core"]},
    ),
    "no-slip wall": (scene(faces={"y_min": NO_SLIP_WALL, "x_max": OPEN}), BARE, {"kick": ["S1 * x1"]}),
    "body": (
        scene(bodies=SHEET),
        BARE,
        {"drift": ["keep_out"], "advance_density": ["shadow", "hidden", "keep_out"], "kick": ["shadow", "hidden"]},
    ),
    "nozzle": (scene(inflows=JET), BARE, {"drift": ["carried"], "advance_density": ["weighed"], "kick": ["carried"]}),
    "drain": (
        scene(outflows={"drain": Outflow(Box((0.8, 0.0), (1.0, 0.2)))}),
        BARE,
        {"drift": ["carried"], "kick": ["carried"]},
    ),
    "central force": (
        scene(central_force=1.0),
        BARE,
        {"kick": [").central_force"], "advance_density": [").central_force"]},
    ),
    "penalty walls": (BASE, dataclasses.replace(BARE, walls=MUELLER.walls), {"kick": [").wall_stiffness"]}),
    "clamping walls": (BASE, dataclasses.replace(BARE, walls=ClampWalls()), {"drift": [").wall_damping"]}),
    "frozen walls": (BASE, dataclasses.replace(BARE, walls=FrozenWalls()), {"kick": ["near_bare"]}),
    "shifting": (FULL, BARE, {"advance_density": [").level"]}),
    "mueller": (BASE, MUELLER, {"advance_density": ["poly6"], "kick": ["spiky"]}),
    "explicit Euler": (BASE, dataclasses.replace(BARE, integrator=EXPLICIT_EULER), {}),
    "periodic faces": (
        scene(faces={"x_min": PERIODIC, "x_max": PERIODIC}),
        BARE,
        {"drift": ["wrap"]},
    ),
}


@lru_cache
def sources(index, folder):
    """Generated source of the kernels of the base scene (None) or of one with a feature, by name, without comments."""
    what, scheme = (BASE, BARE) if index is None else FEATURES[index][:2]
    solver = Solver(what, scheme, device="cpu")
    found = {}
    for name, kernel in vars(solver._kernels).items():
        if kernel is None:
            continue
        place = folder / f"{index}" / name
        wp.compile_aot_module(kernel.module, arch=80, use_ptx=True, module_dir=place)
        (path,) = place.glob("*.cu")
        # Warp quotes the Python lines in comments, those it left out as well.
        lines = [line for line in path.read_text().splitlines() if not line.lstrip().startswith("//")]
        found[name] = "\n".join(lines)
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the sources go."""
    return tmp_path_factory.mktemp("sources")


@pytest.mark.parametrize("feature", FEATURES)
def test_only_a_scene_with_a_feature_has_code_for_it(feature, folder):
    base, with_it = sources(None, folder), sources(feature, folder)
    for kernel, words in FEATURES[feature][2].items():
        for word in words:
            assert word in with_it[kernel], f"{word} in {kernel}"
            assert word not in base[kernel], f"{word} in {kernel} of the base scene"


def test_mueller_has_no_core(folder):
    assert Scheme().core_in(2) > MUELLER.core_in(2) == 0.0
    for kernel, words in FEATURES["core"][2].items():
        assert not any(word in sources("mueller", folder)[kernel] for word in words)


def test_a_full_box_leans_on_no_accelerations(folder):
    full, words = sources("density diffusion of a full box", folder), FEATURES["density diffusion"][2]
    for kernel in words:
        for word in words[kernel]:
            assert (word in full[kernel]) == (word == "density_diffusion_"), f"{word} in {kernel}"


def test_two_dimensions_pay_nothing_for_the_third_and_walls_nothing_for_openings(folder):
    base, closed = sources(None, folder), sources("artificial viscosity", folder)
    assert all("z_low" not in source for source in (*base.values(), *closed.values()))
    assert "has_left" in base["drift"]
    assert "has_left" not in sources("periodic faces", folder)["drift"]
    assert "keep_inside" in base["drift"]


def launches(what, scheme=BARE, **options):
    """Names of the kernels that one step launches, in order."""
    solver = Solver(what, scheme, device="cpu", **options)
    names, launch = [], wp.launch
    try:
        wp.launch = lambda kernel, *rest, **more: (names.append(kernel.func.__name__), launch(kernel, *rest, **more))
        solver._worlds().launch(1)
    finally:
        wp.launch = launch
    return names


def test_a_step_launches_what_the_scene_has():
    base = ["drift", "order_by_cell", "gather", "advance_density", "kick"]
    assert launches(BASE) == base
    assert launches(scene(inflows=JET)) == [*base, "emit"]
    assert launches(warm()) == [*base, "conduct"]
    assert launches(scene(bodies=SHEET)) == base  # it stands still
    assert launches(FULL) == [*base, "add_up_gain", "shift"]
    assert launches(FULL, dataclasses.replace(BARE, shifting=0.0)) == base
    moving = {"sheet": dataclasses.replace(SHEET["sheet"], moving=True)}
    assert launches(scene(bodies=moving)) == ["advance_driven", *base]
    assert launches(scene(faces={"x_min": Face(moving=True), "x_max": OPEN})) == ["advance_driven", *base]


def arrays(solver):
    """Sizes of the device arrays of a solver, by name."""
    return {name: 0 if array is None else array.size for name, array in solver.arrays().items()}


def test_what_a_scene_lacks_has_no_array():
    base = arrays(Solver(BASE, BARE, device="cpu"))
    absent = [name for name, size in base.items() if size == 0]
    for word in ("bodies", "_nozzles", "_drains", "_frozen", "ledger", "temperature", "forces", "gain"):
        of_it = [name for name in base if word in name]
        assert of_it, word
        assert all(name in absent or name.startswith(("state.faces",)) for name in of_it), word
    full = arrays(
        Solver(
            warm(
                bodies={"ball": Body(Ball((0.7, 0.2), 0.1))},
                inflows=JET,
                outflows={"end": Outflow(Box((0.9, 0.0), (1.0, 0.1)))},
            ),
            dataclasses.replace(BARE, walls=FrozenWalls()),
            device="cpu",
            report_forces=True,
        )
    )
    nowhere = ("state.gain",)
    missing = [name for name, size in full.items() if size == 0 and not name.startswith(nowhere)]
    assert not missing
    # Records have the accelerations where the diffusion of density leans on them, and nowhere else.
    leaning = {name: size - base[name] for name, size in arrays(Solver(BASE, DIFFUSIVE, device="cpu")).items()}
    size = 2 * base["state.middle"] // 5
    assert {name: more for name, more in leaning.items() if more} == {"state.middle": size}
    damped = arrays(Solver(BASE, dataclasses.replace(BARE, acoustic_damping=0.5), device="cpu"))
    assert damped == base
    full_box = arrays(Solver(FULL, DIFFUSIVE, device="cpu"))
    assert full_box["state.middle"] == full_box["state.end"]
    shifted, plain = (
        arrays(Solver(FULL, dataclasses.replace(BARE, shifting=shifting), device="cpu")) for shifting in (1.0, 0.0)
    )
    assert {name: size - plain[name] for name, size in shifted.items() if size != plain[name]} == {"state.gain": 1}
