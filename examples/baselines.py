"""What controllers earn in every task: python examples/baselines.py [ID ...]

For each task one that does nothing, the scripted one, and PPO (examples/ppo.py), trained anew with several seeds and
scored on the held-out seeds of the test band. Leaves docs/baselines.json, the learning curves, the table in
docs/tasks.md, and the best policy of each task by the validation band in examples/policies/. Tasks that are not named
keep what they have. Wants PyTorch and matplotlib (pip install "fluidgym-sph[plot,ppo]"). --jobs runs go on at a time, a
thread each; with as many as there are cores, all tasks take two hours and a half on two. Runs that are done are kept in
--runs, so that after an interruption the same command goes on. After a change of the fluid, --rescore plays what was
learnt before once more, and tells what it earns now; after a change of the tasks empty that folder. --levels scores
those that learn nothing at every difficulty, in 2D and 3D, and puts that into docs/tasks.md; it takes half an hour.
"""

import argparse
import json
import math
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import gymnasium as gym
import matplotlib
import numpy as np
from PIL import Image
from ppo import train
from tqdm import tqdm

from fluidgym.envs import FluidEnv, FluidVectorEnv
from fluidgym.envs.evaluation import BUILT_IN, TEST, VALIDATION, evaluate
from fluidgym.envs.policy import Policy

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).resolve().parent
TABLE = "<!-- baselines -->"
LEVELS = "<!-- levels -->"
WORLDS = (1, 8, 64)
TILE = (480, 300)  # of the picture of the tasks [pixels]


def interval(values: list[float]) -> list[float]:
    """Mean and half of the 95 % interval of a few values, by Student's t."""
    factors = {2: 12.71, 3: 4.303, 4: 3.182, 5: 2.776}
    n = len(values)
    margin = factors.get(n, 1.96) * float(np.std(values, ddof=1)) / math.sqrt(n) if n > 1 else math.nan
    return [float(np.mean(values)), margin]


def task_options(env_id: str, chosen: argparse.Namespace) -> dict:
    """What the environments are made with."""
    return {**gym.spec(env_id).kwargs, "difficulty": chosen.difficulty, "device": chosen.device}


def rates(env_id: str, chosen: argparse.Namespace, steps: int = 20) -> dict[str, float]:
    """Environment steps a second in batches of several sizes, random actions."""
    options = task_options(env_id, chosen)
    found = {}
    for worlds in WORLDS:
        envs = FluidVectorEnv(worlds, **options)
        envs.reset(seed=0)
        envs.action_space.seed(0)
        actions = [envs.action_space.sample() for _ in range(steps + 5)]
        for action in actions[:5]:
            envs.step(action)
        begin = time.perf_counter()
        for action in actions[5:]:
            envs.step(action)
        found[str(worlds)] = steps * worlds / (time.perf_counter() - begin)
        envs.close()
    return found


def learn(env_id: str, seed: int, chosen: argparse.Namespace) -> Policy:
    """Train a controller and score it, or read what an earlier call left; the run is told in its `about`."""
    options = task_options(env_id, chosen)
    budget = f"{chosen.difficulty}-{chosen.worlds}x{chosen.steps}-{chosen.minutes:g}min"
    path = chosen.runs / f"{env_id.rpartition('/')[2]}-{budget}-{seed}.npz"
    threads = 1 if chosen.jobs > 1 else None
    if path.exists():
        policy = Policy.load(path)
        if not chosen.rescore:
            return policy
        run = dict(policy.about["run"])
    else:
        begin = time.monotonic()
        policy, curve = train(
            env_id, chosen.difficulty, chosen.worlds, chosen.steps, chosen.minutes, seed, chosen.device, None, threads
        )
        run = {"minutes": (time.monotonic() - begin) / 60.0, "curve": thinned(curve)}
    for name, band in (("validated", VALIDATION), ("tested", TEST)):
        run[name] = evaluate(policy, episodes=chosen.episodes, seeds=band, threads=threads, **options).mean
    policy = replace(policy, about={**policy.about, "run": run})
    policy.save(path)
    return policy


def measure(env_id: str, speeds: dict[str, float], policies: list[Policy], chosen: argparse.Namespace) -> dict:
    """Score a task's controllers, those of PPO among them; the best by the validation band is kept in a file."""
    options = task_options(env_id, chosen)
    env = FluidEnv(**options)
    env.reset(seed=0)
    row: dict = {"particles": env.solver.capacity, "difficulty": chosen.difficulty}
    finer = {**options, "resolution": 2 * env.task.resolution}
    env.close()
    row["env_steps_per_s"] = speeds
    for name in BUILT_IN:
        score = evaluate(name, episodes=chosen.episodes, seeds=TEST, **options)
        row[name] = {"mean": score.mean, "margin": score.margin, "parts": score.parts}
    runs = [policy.about["run"] for policy in policies]
    row["curves"] = [run["curve"] for run in runs]
    scores = [run["tested"] for run in runs]
    mean, margin = interval(scores)
    best = max(policies, key=lambda policy: policy.about["run"]["validated"])
    best = replace(best, about={name: value for name, value in best.about.items() if name != "run"})
    row["ppo"] = {
        "mean": mean,
        "margin": margin,
        "scores": scores,
        "minutes": [run["minutes"] for run in runs],
        "steps": [policy.about["steps"] for policy in policies],
        "twice the resolution": evaluate(best, episodes=chosen.episodes, seeds=TEST, **finer).mean,
    }
    row["scripted"]["twice the resolution"] = evaluate("scripted", episodes=chosen.episodes, seeds=TEST, **finer).mean
    chosen.policies.mkdir(exist_ok=True)
    best.save(chosen.policies / f"{env_id.rpartition('/')[2]}.npz")
    return row


def thinned(curve: list[tuple[int, float]], points: int = 60) -> list[list[float]]:
    """Means of a learning curve over equal stretches: steps and return."""
    pieces = [piece for piece in np.array_split(np.asarray(curve, float), points) if len(piece)]
    return [[float(piece[:, 0].mean()), float(piece[:, 1].mean())] for piece in pieces]


def draw(rows: dict, path: Path) -> None:
    """The learning curves beside what the others earn."""
    names = list(rows)
    columns = min(4, len(names))
    figure, axes = plt.subplots(
        -(-len(names) // columns), columns, figsize=(3.4 * columns, 2.6 * -(-len(names) // columns)), squeeze=False
    )
    for axis in axes.flat[len(names) :]:
        axis.set_axis_off()
    for axis, name in zip(axes.flat, names, strict=False):
        row = rows[name]
        for curve in filter(None, row["curves"]):  # none where no episode has ended
            steps, returns = np.transpose(curve)
            axis.plot(steps / 1000.0, returns, color="tab:blue", linewidth=1.0)
        for who, colour in (("null", "tab:gray"), ("scripted", "tab:orange")):
            axis.axhline(row[who]["mean"], color=colour, linewidth=1.0, linestyle="--", label=who)
        axis.set_title(name.rpartition("/")[2], fontsize=9)
        axis.tick_params(labelsize=7)
        axis.set_xlabel("thousand environment steps", fontsize=7)
        axis.set_ylabel("return", fontsize=7)
    axes[0][0].plot([], [], color="tab:blue", label="PPO, with its noise")
    axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def picture(path: Path) -> None:
    """A moment of each task in 2D."""
    moments = {"DamBreakContain": 26, "DamBreakGate": 14, "CarryTank": 8, "SloshDamp": 50}  # steps
    moments |= {"SpreadEven": 12, "JetFill": 22, "LevelHold": 60, "WaveAbsorb": 60}
    showy = {"CarryTank": [1.0], "SloshDamp": [0.0]}  # where the scripted controller has nothing to show
    whole = Image.new("RGB", (2 * TILE[0], 4 * TILE[1]))
    for n, (name, steps) in enumerate(moments.items()):
        env = FluidEnv(name, render_mode="rgb_array")
        env.reset(seed=3)
        for _ in range(steps):
            env.step(np.asarray(showy.get(name, env.task.scripted()[0])))
        tile = Image.fromarray(np.asarray(env.render())).resize(TILE, Image.Resampling.LANCZOS)
        whole.paste(tile, (n % 2 * TILE[0], n // 2 * TILE[1]))
        env.close()
    whole.save(path, optimize=True)


def table(rows: dict) -> str:
    """The rows as Markdown."""
    lines = [
        "| id | particles, at most | env steps/s with 1, 8, 64 worlds | null | scripted | PPO |"
        " twice the resolution: scripted, PPO |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, row in rows.items():
        speeds = ", ".join(f"{row['env_steps_per_s'][str(worlds)]:.0f}" for worlds in WORLDS)
        plain = [f"{row[who]['mean']:.1f} ± {row[who]['margin']:.1f}" for who in ("null", "scripted")]
        ppo = row["ppo"]
        runs = f"{ppo['mean']:.1f}" + (f" ± {ppo['margin']:.1f}" if len(ppo["scores"]) > 1 else " (one run)")
        finer = [row[who].get("twice the resolution", math.nan) for who in ("scripted", "ppo")]
        cells = [f"`{name.rpartition('/')[2]}`", str(row["particles"]), speeds, *plain, runs]
        lines.append(f"| {' | '.join(cells)} | {finer[0]:.1f}, {finer[1]:.1f} |")
    return "\n".join(lines)


def levels(ids: list[str], chosen: argparse.Namespace) -> str:
    """What doing nothing and the scripted controller earn at each difficulty, as Markdown."""
    lines = ["| id | easy: null, scripted | medium | hard |", "| --- | --- | --- | --- |"]
    for env_id in tqdm(ids, unit="task", disable=None):
        cells = [f"`{env_id.rpartition('/')[2]}`"]
        for difficulty in ("easy", "medium", "hard"):
            options = {**task_options(env_id, chosen), "difficulty": difficulty}
            scores = [evaluate(name, episodes=chosen.episodes, seeds=TEST, **options) for name in BUILT_IN]
            cells.append(", ".join(f"{score.mean:.1f} ± {score.margin:.1f}" for score in scores))
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def put(text: str, between: str, page: Path) -> None:
    """Put a text between two marks of a page, where there is one."""
    if page.exists():
        before, _, rest = page.read_text().partition(between)
        _, _, after = rest.partition(between)
        page.write_text(f"{before}{between}\n\n{text}\n\n{between}{after}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ids", nargs="*", metavar="ID", help="environments (default: all in 2D)")
    parser.add_argument("--difficulty", default="easy", help="easy, medium or hard (default: easy)")
    parser.add_argument("--seeds", type=int, default=3, help="runs of each (default: 3)")
    parser.add_argument("--worlds", type=int, default=32, help="(default: 32)")
    parser.add_argument("--steps", type=int, default=400_000, help="of a run at most (default: 400000)")
    parser.add_argument("--minutes", type=float, default=10.0, help="of a run at most (default: 10)")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, help="runs at a time (default: as many as cores)"
    )
    parser.add_argument("--episodes", type=int, default=32, help="to score with (default: 32)")
    parser.add_argument("--device", default=None, help="of the fluid (default: a GPU where there is one)")
    parser.add_argument("--docs", type=Path, default=HERE.parent / "docs", help="folder (default: docs)")
    parser.add_argument("--policies", type=Path, default=HERE / "policies", help="folder (default: examples/policies)")
    parser.add_argument(
        "--runs",
        type=Path,
        default=Path("outputs/baselines"),
        help="folder of finished runs (default: outputs/baselines)",
    )
    parser.add_argument("--rescore", action="store_true", help="score finished runs again, in the fluid as it is now")
    parser.add_argument("--levels", action="store_true", help="score those that learn nothing at every difficulty")
    parser.add_argument("--picture", action="store_true", help="draw a moment of each task, and nothing else")
    chosen = parser.parse_args()
    if chosen.picture:
        picture(chosen.docs / "tasks.png")
        return
    page = chosen.docs / "tasks.md"
    every = [name for name in gym.registry if name.startswith("fluidgym/")]
    if chosen.levels:
        found = levels(chosen.ids or every, chosen)
        if not chosen.ids:
            put(found, LEVELS, page)
        return
    every = [name for name in every if "2D" in name]
    kept = chosen.docs / "baselines.json"
    rows = json.loads(kept.read_text()) if kept.exists() else {}
    ids = chosen.ids or every
    chosen.docs.mkdir(exist_ok=True)
    chosen.runs.mkdir(parents=True, exist_ok=True)
    timed = chosen.runs / f"rates-{chosen.difficulty}.json"
    speeds = json.loads(timed.read_text()) if timed.exists() else {}
    speeds |= {env_id: rates(env_id, chosen) for env_id in ids if env_id not in speeds}  # while nothing else goes on
    timed.write_text(json.dumps(speeds))
    runs = [(env_id, seed) for seed in range(chosen.seeds) for env_id in ids]
    with ProcessPoolExecutor(chosen.jobs, get_context("spawn")) as pool:
        begun = {run: pool.submit(learn, *run, chosen) for run in runs}
        for run in tqdm(runs, unit="run", disable=None):
            about = begun[run].result().about
            print(f"{run[0]}, seed {run[1]}: {about['run']['tested']:.1f} after {about['steps']} steps", flush=True)
    for env_id in tqdm(ids, unit="task", disable=None):
        policies = [begun[env_id, seed].result() for seed in range(chosen.seeds)]
        rows[env_id] = measure(env_id, speeds[env_id], policies, chosen)
        rows = {name: rows[name] for name in gym.registry if name in rows}
        kept.write_text(json.dumps(rows))
        draw(rows, chosen.docs / "learning_curves.png")
        put(table(rows), TABLE, page)
        print(table({env_id: rows[env_id]}), flush=True)


if __name__ == "__main__":
    main()
