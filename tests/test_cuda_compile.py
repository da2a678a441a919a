"""Every kernel of the package compiles for CUDA; that takes no GPU, since the compiler comes with Warp.

Run as a script, in an interpreter of its own, this file builds solvers and environments, gathers all the kernels that
this brought to life, and compiles them into the folder it is given. The tests hold the outcome to the source: a kernel
that nothing builds here is named. A kernel has a variant for every structure of a solver: all are compiled for sm_90,
two of each for sm_80, and all of them for that, too, where slow tests run.
"""

import ast
import gc
import importlib
import json
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

ARCHITECTURES = [80, 90]


def build():
    """Build all that has kernels: solvers of every structure that matters, and the environments."""
    import gymnasium
    import warp as wp

    import fluidgym
    from fluidgym import solver
    from fluidgym.scene import (
        OPEN,
        PERIODIC,
        Ball,
        Body,
        Box,
        Face,
        Fluid,
        Inflow,
        Material,
        Outflow,
        Scene,
        face_names,
    )
    from fluidgym.scheme import MUELLER, Scheme
    from fluidgym.solver import Solver
    from fluidgym.speed import count_neighbours
    from fluidgym.sph.integrators import EXPLICIT_EULER
    from fluidgym.sph.state_equation import TAIT
    from fluidgym.sph.wall_models import ClampWalls, FrozenWalls

    # Kernels are to come to life; what they would do, and native code for it, is not wanted.
    wp.launch = lambda *rest, **named: None
    # As a GPU has them: threads of a GPU do not come one after another, so a pair is met twice.
    make_structure = solver.make_structure
    solver.make_structure = lambda *rest, **flags: make_structure(*rest, **flags | {"half": False})
    for package in pkgutil.walk_packages(fluidgym.__path__, "fluidgym."):
        if package.name.startswith(("fluidgym.sph", "fluidgym.state")):
            importlib.import_module(package.name)
    for dim in (2, 3):
        block = Fluid(Box((0.0,) * dim, (0.5,) * dim))
        faces = {"x_min": Face(slip="no", moving=True), "x_max": OPEN}
        if dim == 3:
            faces |= {"y_min": PERIODIC, "y_max": PERIODIC}
        rich = Scene((0.0,) * dim, (1.0,) * dim, 0.1, block, faces, material=Material(viscosity=1e-3))
        still = dict.fromkeys(face_names(dim), OPEN)
        bare = Scene((0.0,) * dim, (1.0,) * dim, 0.1, block, still, gravity=0.0, reference_speed=1.0)
        count_neighbours(Solver(rich, Scheme(state_equation=TAIT), device="cpu"))
        Solver(bare, Scheme(density_diffusion=0.0, artificial_viscosity=0.0, acoustic_damping=0.0), device="cpu")
        Solver(bare, Scheme(acoustic_damping=0.0), device="cpu")
        later = Solver(rich, Scheme(density_diffusion=0.0), device="cpu")
        later.set_parameters(density_diffusion=0.1)
        later.step()
        middle = (0.7,) * dim
        full = Scene(
            (0.0,) * dim,
            (1.0,) * dim,
            0.1,
            block,
            {"x_min": Face(slip="no", temperature=1.0)},
            material=Material(viscosity=1e-3, thermal_diffusivity=1e-3),
            bodies={
                "gate": Body(Box((0.55,) + (0.0,) * (dim - 1), (0.6,) + (0.5,) * (dim - 1)), "no", True, None, 2.0),
                "ball": Body(Ball(middle, 0.1)),
            },
            inflows={"jet": Inflow((0.1,) * (dim - 1) + (0.8,), (1.0,) + (0.0,) * (dim - 1), 0.2, 1.0)},
            outflows={
                "drain": Outflow(Box((0.9,) + (0.0,) * (dim - 1), (1.0,) * dim)),
                "end": Outflow(
                    Box((0.0,) * (dim - 1) + (0.9,), (0.5,) * (dim - 1) + (1.0,)), "+y" if dim == 2 else "+z"
                ),
            },
            central_force=1.0,
        )
        filled = Solver(full, device="cpu", report_forces=True)
        filled.body_velocity[0, 0, 0] = 0.1
        filled.gravity = 0.0
        filled.set_parameters(sound_speed=2.0 * filled.parameter("sound_speed"))
        filled.step()
        Solver(full, Scheme(surface_shifting=1.0), device="cpu")
        if dim == 2:
            Solver(full, device="cpu", plain_loops=True)
        Solver(bare, Scheme(walls=FrozenWalls(), integrator=EXPLICIT_EULER), device="cpu")
        sides = {"x_min": PERIODIC, "x_max": PERIODIC, "y_min": Face(slip="no")}
        sealed = Scene((0.0,) * dim, (1.0,) * dim, 0.1, Fluid(Box((0.0,) * dim, (1.0,) * dim)), sides)
        Solver(sealed, device="cpu").step()  # it is full, and shifted
        tank = Scene((0.0,) * dim, (1.0,) * dim, 0.1, block, material=Material(viscosity=1e-3))
        for scheme in (MUELLER, Scheme(walls=ClampWalls()), Scheme(walls=FrozenWalls())):
            Solver(tank, scheme, device="cpu", report_forces=True)
    for name in list(gymnasium.registry):
        if name.startswith("fluidgym/"):
            environment = gymnasium.make(name, device="cpu")
            environment.reset(seed=0)
            environment.step(environment.action_space.sample())
            environment.close()


def compile_all(folder, everything):
    """Compile the kernels that are alive, and tell of which there are, what was made of them, and what failed."""
    import warp as wp

    kernels = [
        kernel
        for kernel in gc.get_objects()
        if isinstance(kernel, wp.Kernel) and kernel.func.__module__.startswith("fluidgym")
    ]
    found = sorted({f"{kernel.func.__module__}:{kernel.func.__qualname__}" for kernel in kernels})
    modules = {kernel.module.name: kernel.module for kernel in kernels}
    variants = {}  # of each kernel, the modules it is in
    for kernel in kernels:
        variants.setdefault(f"{kernel.func.__module__}:{kernel.func.__qualname__}", []).append(kernel.module.name)
    few = {name for names in variants.values() for name in (min(names), max(names))}
    made, failed = {}, {}
    for name, module in modules.items():
        for architecture in ARCHITECTURES if everything or name in few else ARCHITECTURES[1:]:
            try:
                paths = wp.compile_aot_module(module, arch=architecture, module_dir=folder, use_ptx=False)
                made[f"{name} sm_{architecture}"] = [str(path) for path in paths]
            except Exception as error:
                failed[f"{name} sm_{architecture}"] = str(error)
    return {"found": found, "made": made, "failed": failed}


if __name__ == "__main__":
    build()
    outcome = compile_all(sys.argv[1], "--all" in sys.argv)
    Path(sys.argv[1], "outcome.json").write_text(json.dumps(outcome))
    sys.exit()


@pytest.fixture(scope="module", params=["few", pytest.param("all", marks=pytest.mark.slow)])
def outcome(request, tmp_path_factory):
    """What came of building and compiling, for sm_80 a few variants of each kernel or all."""
    folder = tmp_path_factory.mktemp("cuda")
    command = [sys.executable, __file__, str(folder), f"--{request.param}"]
    result = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=1800)
    assert result.returncode == 0, result.stderr
    told = json.loads((folder / "outcome.json").read_text())
    return told | {"output": result.stdout + result.stderr}


def kernels_of_the_source():
    """module:name of every function of the package that is decorated as a Warp kernel."""
    import fluidgym

    root = Path(fluidgym.__file__).parent
    names = set()

    def visit(node, module, scope):
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, (ast.FunctionDef, ast.ClassDef)):
                visit(child, module, scope)
                continue
            for decorator in child.decorator_list:
                target = decorator.func if isinstance(decorator, ast.Call) else decorator
                if ast.unparse(target) in ("wp.kernel", "warp.kernel"):
                    names.add(f"{module}:{scope}{child.name}")
            inside = "<locals>." if isinstance(child, ast.FunctionDef) else ""
            visit(child, module, f"{scope}{child.name}.{inside}")

    for folder, _, files in os.walk(root, followlinks=True):  # envs is a link in a checkout
        for file in files:
            if file.endswith(".py"):
                path = Path(folder, file)
                parts = path.relative_to(root).with_suffix("").parts
                module = ".".join(["fluidgym", *(part for part in parts if part != "__init__")])
                visit(ast.parse(path.read_text(encoding="utf-8")), module, "")
    return sorted(names)


def test_every_kernel_of_the_source_is_built(outcome):
    written = kernels_of_the_source()
    assert "fluidgym.sph.neighbors:settle_order" in written
    assert "fluidgym.sph.integrate:make_kick.<locals>.kick" in written
    missing = [name for name in written if name not in outcome["found"]]
    assert not missing, f"build() in {Path(__file__).name} makes no {', '.join(missing)}"


def test_every_kernel_compiles_for_cuda(outcome):
    assert not outcome["failed"], outcome["output"]
    for architecture in ARCHITECTURES:
        assert sum(name.endswith(f" sm_{architecture}") for name in outcome["made"]) >= 20
    for name, paths in outcome["made"].items():
        assert len(paths) == 1, name
        program = Path(paths[0])
        assert name.split()[-1].replace("_", "") in program.name
        assert program.suffix == ".cubin"
        assert program.read_bytes()[:4] == b"\x7fELF", name
