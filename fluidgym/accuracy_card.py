"""Accuracy cards: how far the fluid of an environment is from the truth, and what it costs, at each fidelity.

The error is that of the validation case that the task names as its gate (`Task.gates`), under the scheme of the
fidelity: at the resolution that the environment has, and at twice that. Cases run to their last instant, so that all
their errors are there. The ratios of errors and of run times between the two say what doubling the resolution buys,
and at what price; the order is the exponent of the spacing that an error follows.

The cost is that of one world: the first steps of an episode with random actions, always the same, the median of some
repeats. Making the solver, compiling, the reset and the first step are timed apart. A step of the solver is timed alone
on the same start, its controls at rest; what a step of the environment takes beyond that is observing and rewarding.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from fluidgym.envs import Task
from fluidgym.envs.fluid_env import FluidEnv
from fluidgym.validation import CASES, Result, observed_order, run
from fluidgym.validation.report import finite, known, markdown_table, told, write_page

REPEATS = 3
STEPS = 40  # of the environment in a repeat, unless its episode is shorter
SEED = 0

Progress = Callable[[str, float], Callable[[float], object]]


@dataclass(frozen=True)
class Cost:
    """What one world costs.

    Attributes:
        particles: Number of particles.
        steps_per_env_step: Solver steps in a step of the environment.
        ms_per_step: Median time of a solver step [ms].
        env_steps_per_s: Steps of the environment a second, from the median time.
        spread: The slowest repeat of these over the fastest.
        setup_s: Time to make the environment, compile, reset and take the first step [s].
    """

    particles: int
    steps_per_env_step: int
    ms_per_step: float
    env_steps_per_s: float
    spread: float
    setup_s: float


@dataclass(frozen=True)
class Card:
    """An environment at a fidelity.

    Attributes:
        env_id: Its registered name.
        fidelity: Name of the trade-off.
        dim: Number of dimensions.
        resolution: As the task counts it.
        control_interval: Simulated time of a step of the environment [s].
        device: Name of the Warp device.
        cost: What a world costs.
        case: Name of the validation case that stands for it; "" where the task names none.
        coarse: The case at the resolution of the environment; None where it cannot be run.
        fine: The case at twice that, likewise.
        refused: Why one of them is None; "" where none is.
    """

    env_id: str
    fidelity: str
    dim: int
    resolution: int
    control_interval: float
    device: str
    cost: Cost
    case: str
    coarse: Result | None
    fine: Result | None
    refused: str = ""

    @property
    def order(self) -> dict[str, float]:
        """Observed order of convergence by name of the error; nan where an error is 0 or not finite."""
        return observed_order(self.coarse, self.fine) if self.coarse and self.fine else {}

    @property
    def error_ratio(self) -> dict[str, float]:
        """Size of each error at twice the resolution over that at the resolution; nan where that is 0."""
        if not (self.coarse and self.fine):
            return {}
        pairs = {name: (self.coarse.errors[name], error) for name, error in self.fine.errors.items()}
        return {name: abs(fine / coarse) if coarse else math.nan for name, (coarse, fine) in pairs.items()}

    @property
    def time_ratio(self) -> float:
        """Run time of the case at twice the resolution over that at the resolution; nan where it was not run."""
        return self.fine.wall_s / self.coarse.wall_s if self.coarse and self.fine else math.nan

    def as_json(self) -> dict[str, Any]:
        """Plain values; a number that is not finite is None."""
        names = ("env_id", "fidelity", "dim", "resolution", "control_interval", "device", "case", "refused")
        found: dict[str, Any] = {name: getattr(self, name) for name in names}
        found["cost"] = asdict(self.cost)
        of_run = ("resolution", "particles", "steps", "wall_s", "setup_s", "errors", "target", "goal", "passed")
        runs = [{name: getattr(result, name) for name in of_run} for result in (self.coarse, self.fine) if result]
        found |= {"runs": runs, "order": self.order, "error_ratio": self.error_ratio, "time_ratio": self.time_ratio}
        return finite(found)

    def lines(self) -> list[str]:
        """Rows under TABLE_HEAD: one for each error, and one for the run time of the case."""
        cost = self.cost
        left = (
            self.env_id.rpartition("/")[2],
            self.fidelity,
            f"1/{self.resolution}",
            f"{cost.particles}",
            f"{cost.steps_per_env_step}",
            f"{cost.ms_per_step:.3f}",
            f"{cost.env_steps_per_s:.3g}",
            f"{cost.spread:.2f}",
            f"{cost.setup_s:.1f} s",
            self.case,
        )
        rows = self.rows() or [("",) * 6]
        told = [_COLUMNS.format(*(left if row is rows[0] else ("",) * len(left)), *row) for row in rows]
        told += [f"  {self.refused}"] if self.refused else []
        return [line.rstrip() for line in told]

    def rows(self) -> list[tuple[str, ...]]:
        """The errors and the run time as text: name, value at the resolution, at twice that, ratio, order, target."""
        coarse, fine = self.coarse, self.fine
        if coarse is None:
            return []
        rows = []
        for name, error in coarse.errors.items():
            finer = _number(fine.errors.get(name, math.nan)) if fine else ""
            ratio, order = self.error_ratio.get(name, math.nan), self.order.get(name, math.nan)
            kept = coarse.keeps(name, coarse.target)
            target = "" if kept is None else f"{coarse.target[name]:g} {'pass' if kept else 'MISS'}"
            rows.append((name, _number(error), finer, known(ratio, ".2f"), known(order, ".1f"), target))
        times = f"{coarse.wall_s:.3g} s", f"{fine.wall_s:.3g} s" if fine else ""
        return [*rows, ("run time", *times, known(self.time_ratio, ".2f"), "", "")]


_COLUMNS = "{:<22}{:<10}{:>6}{:>11}{:>7}{:>11}{:>13}{:>8}{:>9}   {:<14}{:<16}{:>10}{:>11}{:>7}{:>7}   {}"
TABLE_HEAD = _COLUMNS.format(
    "environment",
    "fidelity",
    "dx",
    "particles",
    "steps",
    "ms a step",
    "env steps/s",
    "spread",
    "set-up",
    "case",
    "error",
    "at dx",
    "at dx/2",
    "ratio",
    "order",
    "target",
)


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "broke down"


# -- measuring -------------------------------------------------------------------------------------------------------


def make_card(
    env_id: str,
    options: Mapping[str, Any],
    fidelity: str,
    device: str | None = None,
    progress: Progress = lambda label, duration: lambda seconds: None,
) -> Card:
    """Measure an environment at a fidelity.

    Args:
        env_id: Its registered name.
        options: What it is registered with: the task and its options.
        fidelity: A key of `FIDELITIES`.
        device: Name of the Warp device; None takes a GPU where there is one.
        progress: (what is run, its duration [s]) -> what is called with every further piece of simulated time.

    Raises:
        ValueError: The environment cannot be made.
    """
    label = f"{env_id.rpartition('/')[2]} {fidelity}"
    task, cost, where = _measure_cost({**options, "fidelity": fidelity}, device, label, progress)
    dim = task.scene.dim
    gate = task.gates.get(dim)
    about = (env_id, fidelity, dim, task.resolution, task.control_interval, where, cost)
    if gate is None:
        return Card(*about, "", None, None, "the task names no validation case")
    case, refused = CASES[gate.case], ""
    end = float(case.times[-1])
    found: list[Result | None] = []
    for factor in (1, 2):
        resolution = round(factor * gate.scale * task.resolution)
        tell = progress(f"{label}, {case.name} {dim}D 1/{resolution}", end)
        try:
            found.append(run(case, resolution, dim, where, end, task.scheme, tell))
        except ValueError as error:  # too few particles for the scene
            found.append(None)
            refused = refused or f"{case.name} 1/{resolution} cannot be run: {error}"
    return Card(*about, case.name, found[0], found[1], refused)


def _measure_cost(
    options: Mapping[str, Any], device: str | None, label: str, progress: Progress
) -> tuple[Task, Cost, str]:
    """Time one world; return its task, the cost and the name of the device."""
    begin = time.perf_counter()
    env = FluidEnv(**options, device=device)
    task, solver = env.task, env.solver
    low, high = task.action_space.low, task.action_space.high
    count = min(STEPS, task.max_episode_steps)
    actions = np.random.default_rng(SEED).uniform(low, high, (count, *low.shape))
    env.reset(seed=SEED)
    env.step(actions[0])
    wp.synchronize_device(solver.device)
    setup_s = time.perf_counter() - begin
    steps = solver.steps_for(task.control_interval)
    advanced = progress(f"{label}, cost", 2.0 * REPEATS * count * task.control_interval)

    def timed(go_on: Callable[[np.ndarray], object]) -> float:
        """Time of a step of the environment or of the solver in its place [s]."""
        env.reset(seed=SEED)
        wp.synchronize_device(solver.device)
        spent = 0.0
        for action in actions:
            begin = time.perf_counter()
            go_on(action)
            wp.synchronize_device(solver.device)
            spent += time.perf_counter() - begin
            advanced(task.control_interval)
        return spent / count

    pairs = [(timed(env.step), timed(lambda _: solver.advance(task.control_interval))) for _ in range(REPEATS)]
    env.reset(seed=SEED)
    whole = [env_step for env_step, _ in pairs]
    cost = Cost(
        particles=solver.account().live,
        steps_per_env_step=steps,
        ms_per_step=1e3 * statistics.median(alone for _, alone in pairs) / steps,
        env_steps_per_s=1.0 / statistics.median(whole),
        spread=max(whole) / min(whole),
        setup_s=setup_s,
    )
    where = str(solver.device)
    env.close()
    return task, cost, where


# -- as a page -------------------------------------------------------------------------------------------------------

_INTRO = """\
# Accuracy cards

What this command measured on {day}; {facts}:

```bash
{command}
```

`fidelity` is an option of `gym.make` and `gym.make_vec`. For each, an environment is held against a flow with a known
answer that stands for its own: a case of `python -m fluidgym validate`, which says at the head of its file in
`fluidgym/validation/` what its errors are and what the reference is. It runs under the scheme of the fidelity, at the
resolution that the environment has, 1/n counting n particles along the length of the case, and at twice that. "Ratio"
is what the doubling does to an error, and to the run time of the case, a single run; "order" is the exponent of the
particle spacing that the error follows; "target" is what the suite asks for at the coarser of the two.

The cost is that of one world on that device, the median of {repeats} runs of up to {steps} steps with random actions;
compiling is not counted. "Spread" is the slowest run over the fastest.
"""


def markdown(cards: Sequence[Card], facts: Mapping[str, str], command: str) -> str:
    """The cards as a page of documentation.

    Args:
        cards: The cards; those of an environment stand together.
        facts: What times belong to, by name.
        command: What makes the page anew.
    """
    today = date.today()
    day = f"{today.day} {today:%B %Y}"
    text = [_INTRO.format(command=command, day=day, facts=told(facts), repeats=REPEATS, steps=STEPS)]
    for env_id in dict.fromkeys(card.env_id for card in cards):
        text.append("\n".join(_section(env_id, [card for card in cards if card.env_id == env_id])))
    return "\n".join(text)


def _section(env_id: str, cards: Sequence[Card]) -> list[str]:
    """The lines of one environment."""
    cases = [f"`{name}` ({CASES[name].title})" for name in dict.fromkeys(card.case for card in cards) if name]
    lines = [f"## {env_id}", ""]
    lines += [f"Held against {', '.join(cases)}.", ""] if cases else []
    costs = [
        (
            card.fidelity,
            f"1/{card.resolution}",
            f"{card.cost.particles}",
            f"{card.cost.steps_per_env_step}",
            f"{card.cost.ms_per_step:.3g}",
            f"{card.cost.env_steps_per_s:.3g}",
            f"{card.cost.spread:.2f}",
        )
        for card in cards
    ]
    head = "fidelity", "dx", "particles", "solver steps an env step", "ms a solver step", "env steps/s", "spread"
    lines += [*markdown_table(head, costs), ""]
    errors = []
    for card in cards:
        if card.coarse:
            spacings = f"{card.fidelity}, 1/{card.coarse.resolution} and 1/{2 * card.coarse.resolution}"
            rows = card.rows()
            errors += [(spacings if index == 0 else "", *row) for index, row in enumerate(rows)]
    head = "fidelity, dx and dx/2", "error", "at dx", "at dx/2", "ratio", "order", "target"
    lines += [*markdown_table(head, errors), ""] if errors else []
    refused = [f"- {card.fidelity}: {card.refused}" for card in cards if card.refused]
    return lines + ([*refused, ""] if refused else [])


def write_markdown(path: Path, cards: Sequence[Card], facts: Mapping[str, str], command: str) -> None:
    """Write the page: all of it, or none of it and the file stays as it was."""
    write_page(path, markdown(cards, facts, command))
