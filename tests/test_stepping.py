"""Groups of worlds and threads: what a world does depends on neither, and errors come through."""

import dataclasses
import os
import threading
import time

import numpy as np
import pytest

import fluidgym.stepping as stepping
from fluidgym.scene import Body, Box, Face, Fluid, Inflow, Material, Outflow, Scene
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver

WORLDS = 5

DAM = Scene(
    (0.0, 0.0),
    (1.0, 0.6),
    0.05,
    [Fluid(Box((0.0, 0.0), (0.4, 0.4)), pressure="hydrostatic")],
    faces={"x_max": Face(moving=True)},
)
FULL = Scene((0.0, 0.0), (1.0, 1.0), 0.1, [Fluid(Box((0.0, 0.0), (1.0, 1.0)))], reference_speed=1.0)
EVERYTHING = dataclasses.replace(
    DAM,
    material=Material(thermal_diffusivity=1e-3, viscosity=1e-3),
    bodies={"gate": Body(Box((0.45, 0.0), (0.5, 0.4)), moving=True)},
    inflows={"jet": Inflow((0.8, 0.55), (0.0, -1.0), width=0.1, speed=1.0, temperature=1.0)},
    outflows={"drain": Outflow(Box((0.9, 0.0), (1.0, 0.1)))},
    reserve=60,
)


def run(scene, threads, group, monkeypatch, worlds=WORLDS, **options):
    """Everything that five worlds with controls of their own are after some steps, and the forces."""
    monkeypatch.setattr(stepping, "GROUP_PARTICLES", group)
    solver = Solver(scene, num_worlds=worlds, device="cpu", threads=threads, **options)
    each = np.linspace(-0.3, 0.3, worlds)
    for _ in range(3):
        solver.gravity[:, 0] = each
        if scene.bodies:
            solver.body_velocity[:, 0, 1] = np.abs(each)
            solver.inflow_speed[:, 0] = 0.6 + each
        if scene.faces["x_max"].moving:
            solver.face_velocity[:, solver.face_index("x_max")] = each
        solver.step(7)
    return solver.save() | {"forces": solver.state.forces.numpy()}


@pytest.mark.parametrize(
    ("scene", "options"),
    [(DAM, {}), (FULL, {"scheme": Scheme(shifting=1.0)}), (EVERYTHING, {"report_forces": True})],
    ids=["dam", "full", "everything"],
)
def test_what_a_world_does_depends_neither_on_its_group_nor_on_the_threads(scene, options, monkeypatch):
    alone, *others = (
        run(scene, threads, group, monkeypatch, **options) for threads, group in ((1, 10**9), (1, 1), (2, 1), (3, 200))
    )
    for other in others:
        for name, values in alone.items():
            np.testing.assert_array_equal(other[name], values, err_msg=name)
    spread = np.ptp(alone["position"].reshape(scene.dim, WORLDS, -1), axis=1)
    assert spread.max() > 0.0


def test_groups_are_as_large_as_the_cache_and_as_many_as_the_threads_need(monkeypatch):
    monkeypatch.setattr(stepping, "GROUP_PARTICLES", 200)
    solver = Solver(DAM, num_worlds=16, device="cpu", threads=1)
    assert solver.capacity == 64
    solver.step()
    assert [group.state.num_worlds for group in solver._stepper._groups] == [3, 3, 3, 3, 3, 1]
    solver = Solver(DAM, num_worlds=16, device="cpu", threads=4)
    solver.step()
    assert [group.state.num_worlds for group in solver._stepper._groups] == [1] * 16


def test_work_is_shared_and_errors_come_through():
    seen, lock = {}, threading.Lock()

    def work(item):
        with lock:
            seen[item] = threading.get_ident()
        time.sleep(0.02)

    stepping.share(work, range(8), 2)
    assert set(seen) == set(range(8)) and len(set(seen.values())) == 2
    stepping.share(work, range(8), 1)
    assert set(seen.values()) == {threading.get_ident()}
    counted = [0] * 4

    def count(item):
        counted[item] += 1
        return item if counted[item] < 3 else None

    for threads in (1, 2):
        counted[:] = [0] * 4
        stepping.share(count, range(4), threads)
        assert counted == [3] * 4

    def fail(item):
        time.sleep(0.01)
        if item == 5:
            raise RuntimeError("item five")

    for threads in (1, 2):
        with pytest.raises(RuntimeError, match="item five"):
            stepping.share(fail, range(8), threads)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_has_threads_of_its_own():
    stepping.share(lambda item: time.sleep(0.01), range(4), 2)
    pid = os.fork()
    if pid == 0:
        seen = set()

        def work(item):
            seen.add(threading.get_ident())
            time.sleep(0.02)

        stepping.share(work, range(4), 2)
        os._exit(0 if len(seen) == 2 else 1)
    assert os.waitpid(pid, 0)[1] == 0


@pytest.mark.parametrize("threads", [0, -1, 1.5])
def test_a_number_of_threads_below_one_is_refused(threads):
    with pytest.raises(ValueError, match=r"Solver.threads = .*; use 1 or more"):
        Solver(DAM, device="cpu", threads=threads)
