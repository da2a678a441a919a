"""Nozzles and outflows: every particle is accounted for, and the jet is as it was ordered."""

import warnings

import numpy as np
import pytest

from fluidgym.scene import OPEN, Box, Fluid, Inflow, Material, Outflow, Scene, face_names
from fluidgym.solver import Solver

DX = 0.025


def jet(dim, speed=2.0, reserve=None, width=0.2, **nozzle):
    """A horizontal jet that falls out of an open box."""
    center = (0.2, 1.0) if dim == 2 else (0.2, 0.5, 1.0)
    direction = (1.0,) + (0.0,) * (dim - 1)
    upper = (1.5, 1.5) if dim == 2 else (1.5, 1.0, 1.5)
    return Scene(
        (0.0,) * dim,
        upper,
        DX if dim == 2 else 0.05,
        [],
        dict.fromkeys(face_names(dim), OPEN),
        reference_speed=5.0,
        inflows={"jet": Inflow(center, direction, width, speed=speed, max_speed=3.0, **nozzle)},
        reserve=reserve,
    )


def check_ledger(solver, world=0):
    """The account holds, and no two particles share a number."""
    account, particles = solver.account(world), solver.particles(world)
    assert account.live == account.started + account.emitted - account.retired == len(particles)
    assert len(np.unique(particles.identity)) == len(particles)
    assert particles.identity.max(initial=-1) < account.started + account.emitted
    return account


@pytest.mark.parametrize("dim", [2, 3], ids=["2D", "3D"])
def test_nozzle_emits_what_its_speed_asks_for(dim, device):
    scene = jet(dim)
    solver = Solver(scene, device=device)
    rows = len(scene.inflows["jet"].rows(scene.particle_spacing)[0])
    assert solver.account().started == 5 * rows  # the pipe is full
    solver.advance(0.5)
    account = check_ledger(solver)
    # Each row has moved 1 m, from half a spacing on.
    assert account.emitted == rows * int(1.0 / scene.particle_spacing + 0.5 + 1e-4)
    assert account.refused == 0
    particles = solver.particles()
    fresh = particles.position[:, 0] < 0.2 + 7 * scene.particle_spacing
    np.testing.assert_allclose(particles.velocity[fresh, 0], 2.0, rtol=0.05)
    # Free flight: the front of the jet has fallen as a stone does.
    flown = particles.position[:, 0].max() - 0.2 - 5 * scene.particle_spacing
    lowest = particles.position[particles.position[:, 0] > particles.position[:, 0].max() - DX, -1].mean()
    assert 1.0 - lowest == pytest.approx(0.5 * 9.81 * (flown / 2.0) ** 2, abs=0.1)


def test_worlds_have_nozzles_of_their_own(device):
    solver = Solver(jet(2), num_worlds=3, device=device)
    solver.inflow_speed[:, solver.inflow_index("jet")] = [0.0, 1.0, 3.0]
    solver.advance(0.2)
    emitted = [check_ledger(solver, world).emitted for world in range(3)]
    assert emitted == [0, 8 * 8, 8 * 24]
    solver.inflow_direction[2] = (0.0, 1.0)
    solver.inflow_center[2] = (0.75, 0.1)
    solver.inflow_width[2] = 0.1
    solver.advance(0.2)
    account = check_ledger(solver, 2)
    assert account.emitted == pytest.approx(8 * 24 + 4 * 24, abs=4)
    particles = solver.particles(2)
    upwards = particles.velocity[:, 1] > 2.0
    assert upwards.sum() > 50
    np.testing.assert_allclose(particles.position[upwards, 0], 0.75, atol=0.1)
    # A reset puts the nozzle back.
    solver.reset(np.array([False, False, True]))
    assert solver.inflow_speed[2, 0] == 2.0
    assert check_ledger(solver, 2).emitted == 0
    np.testing.assert_allclose(solver.inflow_center[2, 0], [0.2, 1.0])


def test_on_and_off_a_hundred_times_keeps_the_ledger(device):
    switch(Solver(jet(2), num_worlds=2, device=device), 100)


@pytest.mark.slow
def test_on_and_off_a_thousand_times_keeps_the_ledger(device):
    switch(Solver(jet(2), num_worlds=2, device=device), 1000)


def switch(solver, times):
    """Turn the nozzles on and off, differently in each world, and check the books each time."""
    for n in range(times):
        solver.inflow_speed[:, 0] = [2.0 * (n % 2), 3.0 * ((n + 1) % 2)]
        solver.advance(0.01)
        accounts = [check_ledger(solver, world) for world in range(2)]
    rows = 8
    for account, speed in zip(accounts, (2.0, 3.0), strict=True):
        assert account.emitted == pytest.approx(rows * speed * 0.005 * times / DX, abs=rows)
        assert account.retired > 0.5 * account.emitted
        assert account.refused == 0


def test_nozzle_without_reserve_waits_and_says_so(device):
    solver = Solver(jet(2, reserve=50), device=device)
    with pytest.warns(RuntimeWarning, match=r"Scene.reserve = 50 particles are used up in world 0"):
        solver.advance(0.2)
    account = check_ledger(solver)
    assert account.emitted == 50
    assert account.refused > 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # it is said once
        solver.advance(0.1)
    # When particles have left, it goes on with theirs.
    solver.advance(0.9)
    account = check_ledger(solver)
    assert account.emitted > 50
    assert account.live <= solver.capacity == account.started + 50


def test_drain_takes_what_enters_it(device):
    scene = Scene(
        (0.0, 0.0),
        (1.0, 1.0),
        DX,
        [Fluid(Box((0.3, 0.5), (0.5, 0.9))), Fluid(Box((0.0, 0.0), (0.2, 0.2)))],
        outflows={"drain": Outflow(Box((0.25, 0.0), (1.0, 0.2)))},
    )
    solver = Solver(scene, device=device)
    for _ in range(8):
        solver.advance(0.1)
        account = check_ledger(solver)
        water = solver.particles()
        # A step first moves, then takes, then moves on.
        way = np.linalg.norm(water.velocity, axis=1).max() * solver.max_step
        assert not Box((0.25 + way, 0.0), (1.0 - way, 0.2 - way)).contains(water.position).any()
    assert account.retired > 120


def test_pipes_and_drains_leave_out_other_fluid():
    fluid = [Fluid(Box((0.0, 0.0), (1.0, 0.5)), velocity=(1.0, 0.0))]
    whole = Scene((0.0, 0.0), (1.0, 1.0), DX, fluid)
    inflows = {"jet": Inflow((0.0, 0.25), (1.0, 0.0), 0.2, speed=1.0)}
    scene = Scene((0.0, 0.0), (1.0, 1.0), DX, fluid, inflows=inflows)
    position = scene.sample().position
    assert len(position) == len(whole.sample().position)  # the pipe lies on the lattice: one for one
    assert len(np.unique(position.round(6), axis=0)) == len(position)
    outlet = {"end": Outflow(Box((0.8, 0.0), (1.0, 0.5)), "+x")}
    assert len(Scene((0.0, 0.0), (1.0, 1.0), DX, fluid, outflows=outlet).sample()) == len(whole.sample())
    still = [Fluid(Box((0.0, 0.0), (1.0, 0.5)))]
    assert Scene((0.0, 0.0), (1.0, 1.0), DX, still, outflows=outlet).sample().position[:, 0].max() < 0.8


def test_saved_present_of_a_nozzle_goes_on_as_it_would_have(device):
    solver = Solver(jet(2), device=device)
    solver.advance(0.107)
    saved = solver.save()
    solver.advance(0.1)
    expected, account = solver.particles(), solver.account()
    solver.restore(saved)
    solver.advance(0.1)
    np.testing.assert_array_equal(solver.particles().position, expected.position)
    assert solver.account() == account


def test_warm_jet_brings_its_warmth(device):
    scene = Scene(
        (0.0, 0.0),
        (1.0, 0.5),
        DX,
        [Fluid(Box((0.0, 0.0), (1.0, 0.1)), temperature=10.0)],
        inflows={"jet": Inflow((0.2, 0.4), (1.0, 0.0), 0.1, speed=1.0, temperature=40.0)},
        material=Material(thermal_diffusivity=1e-4),
    )
    solver = Solver(scene, device=device)
    solver.advance(0.3)
    particles = solver.particles()
    emitted = particles.identity >= solver.account().started
    assert particles.temperature is not None
    assert emitted.sum() > 30
    assert particles.temperature[emitted].mean() > 39.0
    assert particles.temperature.min() > 9.99
    assert particles.temperature.max() < 40.01


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Inflow((0.0, 0.0), (0.0, 0.0), 1.0),
            "Inflow.direction = (0.0, 0.0) has no length; give the way the fluid leaves",
        ),
        (
            lambda: Inflow((0.0, 0.0), (1.0, 0.0), 0.0),
            "Inflow.width = 0 m must be greater than 0; give a positive value",
        ),
        (
            lambda: Inflow((0.0, 0.0), (1.0, 0.0), 1.0, -1.0),
            "Inflow.speed = -1 m/s is below the limit 0; use 0 or more",
        ),
        (
            lambda: Inflow((0.0, 0.0), (1.0, 0.0), 1.0, 2.0, max_speed=1.0),
            "Inflow.speed = 2 m/s exceeds Inflow.max_speed = 1 m/s; raise that",
        ),
        (
            lambda: Inflow((0.0, 0.0), (1.0, 0.0), 1.0),
            "Inflow.max_speed = None with Inflow.speed = 0 m/s lets nothing out, ever; give the largest speed that the"
            " control may ask for",
        ),
        (
            lambda: Inflow((0.0, 0.0), (1.0, 0.0), 1.0, height=1.0),
            "Inflow.height = 1 m is for three dimensions; leave it out",
        ),
        (
            lambda: Outflow(Box((0.0, 0.0), (1.0, 1.0)), "+z"),
            "Outflow.direction = '+z' is unknown; use +x, -x, +y, -y or None",
        ),
        (
            lambda: Outflow(Box((0.0, 0.0), (1.0, 1.0)), pressure=5.0),
            "Outflow.pressure = 5 Pa is of no effect in a drain; give a direction",
        ),
        (
            lambda: Scene((0.0, 0.0), (1.0, 1.0), DX, [], inflows={"jet": Inflow((0.95, 0.5), (1.0, 0.0), 0.2, 1.0)}),
            "Scene.inflows['jet'] pipe spans x = 0.9625 to 1.0625 m, outside the box 0 to 1 m;"
            " move it or enlarge the box",
        ),
        (
            lambda: Scene((0.0, 0.0), (1.0, 1.0), DX, [], reserve=10),
            "Scene.reserve = 10 is of no effect without inflows; leave it out",
        ),
        (
            lambda: Solver(jet(2, length=0.03), device="cpu"),
            "Scene.inflows['jet'].length = 0.05 m is below the smoothing support 0.11 m; use a longer pipe, or None",
        ),
    ],
)
def test_bad_inflow_or_outflow_is_refused_in_one_line(make, message):
    with pytest.raises(ValueError) as error:
        make()
    assert str(error.value) == message


def test_control_out_of_its_limits_is_refused(device):
    solver = Solver(jet(2), device=device)
    before = solver.particles().position
    for name, value, message in (
        ("inflow_speed", 4.0, "Solver.inflow_speed of 'jet' = 4 m/s is outside 0 to 3 m/s; use a smaller value"),
        ("inflow_speed", -1.0, "Solver.inflow_speed of 'jet' = -1 m/s is outside 0 to 3 m/s; use a larger value"),
        (
            "inflow_direction",
            (0.0, 0.0),
            "Solver.inflow_direction of 'jet' has no length in some world; give the way out",
        ),
    ):
        setattr(solver, name, value)
        with pytest.raises(ValueError) as error:
            solver.step()
        assert str(error.value) == message
        solver.reset()
    np.testing.assert_array_equal(solver.particles().position, before)
