"""The command line: `fluidgym`, or `python -m fluidgym`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

from tqdm import tqdm

from fluidgym import precision

MISSED, REFUSED, INTERRUPTED = 1, 2, 130  # exit statuses
BAR = "{desc} {percentage:3.0f}%|{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}]"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; None reads the arguments of the process.

    Returns:
        The exit status.
    """
    parser = argparse.ArgumentParser(prog="fluidgym", description="A fluid simulator that trains controllers.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_run(commands)
    _add_validate(commands)
    _add_benchmark(commands)
    _add_card(commands)
    _add_evaluate(commands)
    _add_play(commands)
    _add_stress(commands)
    _add_view(commands)
    chosen = parser.parse_args(arguments)
    try:
        if getattr(chosen, "precision", None):
            precision.choose(chosen.precision)
        precision.chosen()  # what the environment says may be wrong
    except ValueError as error:
        return _refuse(str(error))
    try:
        return chosen.run(chosen)
    except KeyboardInterrupt:  # while something was being set up: later, each command says how far it came
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except MemoryError as error:
        return _refuse(" ".join(str(error).split()) or "out of memory; use fewer worlds or a larger particle spacing")


def _add_run(commands: argparse._SubParsersAction) -> None:
    parser = commands.add_parser(
        "run",
        help="run a scene file",
        description="Run a scene file, and leave a table of measurements, a picture and a film.",
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="a scene file, such as examples/scenes/dam_break.toml")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="where to (default: outputs/NAME of the file)")
    parser.add_argument("--duration", type=float, metavar="S", help="simulated time [s], in place of the file's")
    parser.add_argument("--spacing", type=float, metavar="DX", help="particle spacing [m], in place of the file's")
    parser.add_argument(
        "--fidelity",
        metavar="NAME",
        help="fast, balanced or accurate: the scheme, in place of the file's; other keys of its [scheme] are kept",
    )
    parser.add_argument("--device", help="cpu, cuda, cuda:1, ...; a GPU where there is one if not given")
    parser.add_argument("--fps", type=float, metavar="N", help="frames a second of the film, in place of the file's")
    parser.add_argument("--film", choices=("gif", "mp4", "none"), default="gif", help="mp4 needs the extra 'render'")
    parser.add_argument("--frames", action="store_true", help="write every frame of the film as a picture as well")
    parser.add_argument("--vtk", action="store_true", help="write the particles for ParaView; needs the extra 'vtk'")
    parser.add_argument("--usd", action="store_true", help="write particles and surface as USD; needs the extra 'usd'")
    parser.add_argument(
        "--save-every",
        type=float,
        metavar="S",
        help="simulated time between rows of the table, and between files for other tools (default: that of frames)",
    )
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """Run a scene file: everything is checked first, and an interrupt keeps what there is."""
    from fluidgym.recording import Output, record, summary, written
    from fluidgym.scene_file import load
    from fluidgym.solver import find_device

    folder = chosen.out or Path("outputs") / chosen.file.stem
    try:
        _check_fidelities([] if chosen.fidelity is None else [chosen.fidelity])
        experiment = load(chosen.file, chosen.spacing, chosen.fidelity)
        if chosen.duration is not None:
            experiment = replace(experiment, duration=chosen.duration)
        if chosen.fps is not None:
            experiment = replace(experiment, view=replace(experiment.view, frames_per_second=chosen.fps))
        output = Output(folder, chosen.film, chosen.frames, chosen.vtk, chosen.usd, chosen.save_every)
        output.check(experiment)
        device = str(find_device(chosen.device))
        _make_folder(folder)
        with tqdm(total=experiment.duration, desc=chosen.file.stem, bar_format=BAR, leave=False, disable=None) as bar:
            found = record(experiment, output, device, progress=bar.update)
    except ValueError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:  # while the solver was being made
        print("interrupted before the first step", file=sys.stderr)
        return INTERRUPTED
    print(f"{chosen.file}: {experiment.title or chosen.file.stem}\n")
    print("\n".join([*summary(found), "", *written(found.files)]), flush=True)
    if found.failure:
        print(f"fluidgym: {found.failure}", file=sys.stderr)
        return MISSED
    if found.interrupted:
        ended = found.measured[-1].time if found.measured else 0.0
        print(
            f"interrupted at {ended:.3g} of {experiment.duration:.3g} s; what there was by then is kept",
            file=sys.stderr,
        )
        return INTERRUPTED
    return 0


def _check_fidelities(names: Sequence[str]) -> None:
    """Refuse what is no fidelity.

    Raises:
        ValueError: A name is unknown.
    """
    from fluidgym.scheme import FIDELITIES

    for name in names:
        if name not in FIDELITIES:
            raise ValueError(f"--fidelity {name}: this is none; use {', '.join(FIDELITIES)}")


def _make_folder(folder: Path) -> None:
    """Make the folder of a run's files.

    Raises:
        ValueError: It cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"--out {folder}: cannot be made: {error.strerror}; name another folder") from None
    if not os.access(folder, os.W_OK):
        raise ValueError(f"--out {folder}: cannot be written to; name another folder")


def _add_validate(commands: argparse._SubParsersAction) -> None:
    parser = commands.add_parser(
        "validate",
        help="measure the simulator against flows with a known answer",
        description="Run validation cases and print their errors. Without a name, all of them.",
    )
    parser.add_argument("cases", nargs="*", metavar="CASE", help="name of a case, such as dam-break")
    parser.add_argument("--resolutions", nargs="+", type=int, metavar="N", help="particles along the case's length")
    parser.add_argument("--dim", type=int, choices=(2, 3), help="only the variants of this dimension")
    parser.add_argument(
        "--scheme",
        metavar="NAME|FILE",
        help="in place of the cases' own: fast, balanced, accurate or another name, or a TOML file with a [scheme]",
    )
    parser.add_argument("--device", help="cpu, cuda, cuda:1, ...; a GPU where there is one if not given")
    parser.add_argument(
        "--precision",
        choices=precision.PRECISIONS,
        help=f"double tells how much of an error is rounding (default: ${precision.VARIABLE}, or single)",
    )
    parser.add_argument("--full", action="store_true", help="run each case for as long as it has something to measure")
    parser.add_argument(
        "--limit", type=float, metavar="S", help="leave out runs that would take longer [s], by the coarser run before"
    )
    parser.add_argument(
        "--seeds", type=int, metavar="N", help="runs of each, from starts a little off, of which the mean counts"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to this file as well")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write them as a page, docs/validation.md")
    parser.add_argument("--strict", action="store_true", help="exit with status 1 when a target is missed")
    parser.set_defaults(run=validate)


def validate(chosen: argparse.Namespace) -> int:
    """Run validation cases: a line of the table for each error as it is known, and the files kept up with it."""
    # Imported here so that help and other commands do not wait for it.
    from fluidgym.benchmark import machine
    from fluidgym.solver import find_device
    from fluidgym.validation import CASES, observed_order, run
    from fluidgym.validation.report import TABLE_HEAD, as_json, markdown, table_lines, write_json, write_page
    from fluidgym.work_precision import adapted, find_scheme

    try:
        plan = _plan(chosen, chosen.cases or list(CASES))
        named = find_scheme(chosen.scheme) if chosen.scheme else None
        if chosen.seeds is not None and chosen.seeds < 1:
            raise ValueError(f"--seeds {chosen.seeds} is below the limit 1; use 5, or leave it out")
        _check_file("--json", chosen.json)
        _check_file("--markdown", chosen.markdown)
        device = str(find_device(chosen.device))
    except ValueError as error:
        return _refuse(str(error))

    def keep() -> None:
        if chosen.json:
            write_json(chosen.json, objects)
        if chosen.markdown:
            write_page(chosen.markdown, markdown(objects, CASES, machine(device), _validate_command(chosen), left_out))

    wide = {"precision": "double"} if precision.chosen() == "double" else {}
    print(*(["in double precision"] if wide else []), TABLE_HEAD, sep="\n", flush=True)
    results, objects, left_out, interrupted = [], [], [], False
    try:
        for case, resolution, dim in plan:
            case = adapted(case, named) if named else case
            end = float(case.times[-1]) if chosen.full else case.end
            label = f"{case.name} {dim}D 1/{resolution}"
            coarser = [other for other in results if (other.case, other.dim) == (case.name, dim)]
            if chosen.limit and coarser:
                expected = coarser[-1].wall_s * (resolution / coarser[-1].resolution) ** (dim + 1)
                if expected > chosen.limit:
                    print(f"{label}: left out, it would take about {expected:.0f} s", flush=True)
                    left_out.append(label)
                    continue
            try:
                with tqdm(total=end, desc=label, bar_format=BAR, leave=False, disable=None) as bar:
                    result = run(case, resolution, dim, device, end=end, progress=bar.update, seeds=chosen.seeds)
            except ValueError as error:
                if not named:  # too few particles for the scene
                    return _refuse(f"{label}: {error}")
                print(f"{label}: {chosen.scheme} cannot run it: {error}", flush=True)
                continue
            order = observed_order(coarser[-1], result) if coarser else {}
            results.append(result)
            objects.append(as_json(result, order) | ({"scheme": chosen.scheme} if named else {}) | wide)
            keep()
            print("\n".join(table_lines(result, order)), flush=True)
    except KeyboardInterrupt:
        interrupted = True
    keep()
    verdicts = [result.passed for result in results]
    summary = f"{verdicts.count(True)} passed, {verdicts.count(False)} missed, {verdicts.count(None)} without a target"
    spent = sum(result.setup_s for result in results)
    print(f"\n{summary}; compiling and setting up took {spent:.1f} s, not counted above")
    if interrupted:
        print(f"interrupted after {len(results)} of {len(plan)} runs", file=sys.stderr)
        return INTERRUPTED
    return MISSED if chosen.strict and False in verdicts else 0


def _validate_command(chosen: argparse.Namespace) -> str:
    """The command that makes the page of `validate` anew."""
    words = list(chosen.cases)
    words += ["--resolutions", *map(str, chosen.resolutions)] if chosen.resolutions else []
    words += ["--dim", str(chosen.dim)] if chosen.dim else []
    words += ["--scheme", chosen.scheme] if chosen.scheme else []
    words += ["--precision", "double"] if precision.chosen() == "double" else []
    words += ["--device", chosen.device] if chosen.device else []
    words += ["--full"] if chosen.full else []
    words += ["--limit", f"{chosen.limit:g}"] if chosen.limit else []
    words += ["--seeds", str(chosen.seeds)] if chosen.seeds else []
    return _page_command(["validate", *words], chosen.markdown)


def _page_command(words: Sequence[str], page: Path) -> str:
    """The command that makes a page anew; a folder that only this machine has is left out."""
    name = page.name if page.is_absolute() else page.as_posix()
    return " ".join(["python -m fluidgym", *words, "--markdown", name])


def _plan(chosen: argparse.Namespace, names: Sequence[str]) -> list[tuple[Any, int, int]]:
    """The cases, resolutions and dimensions to run, the coarsest resolution of each case first.

    Raises:
        ValueError: There is no such case, no such variant of one, or a resolution is too coarse for any.
    """
    from fluidgym.validation import CASES

    unknown = [name for name in names if name not in CASES]
    if unknown:
        raise ValueError(f"unknown case {', '.join(unknown)}; known are {', '.join(CASES)}")
    cases = [CASES[name] for name in dict.fromkeys(names)]
    plan = [
        (case, resolution, dim)
        for case in cases
        for dim in ((chosen.dim,) if chosen.dim else case.resolutions)
        if dim in case.resolutions
        for resolution in sorted(set(chosen.resolutions or case.resolutions[dim]))
    ]
    if not plan:
        raise ValueError(f"none of these cases has a {chosen.dim}D variant: {', '.join(case.name for case in cases)}")
    if min(resolution for _, resolution, _ in plan) < 4:
        raise ValueError("--resolutions must be 4 or more particles along the case's length")
    return plan


def _add_benchmark(commands: argparse._SubParsersAction) -> None:
    parser = commands.add_parser(
        "benchmark",
        help="time the simulator, its error beside it",
        description="Time a falling column of water at several sizes and in many worlds, the environments, start-up and"
        " memory, errors of the same schemes beside them. With --cases: run time against error on cases of the"
        " validation suite, for schemes, resolutions and step sizes.",
    )
    parser.add_argument("--speed", action="store_true", help="how fast everything is; what is done if nothing is named")
    parser.add_argument("--features", action="store_true", help="what each feature adds to a step, on still water")
    parser.add_argument("--dim", type=int, choices=(2, 3), help="only this dimension")
    parser.add_argument("--particles", nargs="+", type=int, metavar="N", help="about so many in a world, each in turn")
    parser.add_argument("--worlds", nargs="+", type=int, metavar="N", help="worlds in a batch, each in turn")
    parser.add_argument("--threads", nargs="+", type=int, metavar="N", help="threads of a CPU that share the worlds")
    parser.add_argument("--device", help="cpu, cuda, cuda:1, ...; a GPU where there is one if not given")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to this file as well")
    group = parser.add_argument_group("run time against error")
    group.add_argument("--cases", nargs="+", metavar="CASE", help="names of cases, such as dam-break")
    group.add_argument(
        "--schemes",
        nargs="+",
        metavar="NAME|FILE",
        help="names, such as fast balanced accurate, or TOML files with a [scheme]; the others are compared with the"
        " first (default: default mueller)",
    )
    group.add_argument("--resolutions", nargs="+", type=int, metavar="N", help="in place of the cases' own")
    group.add_argument(
        "--courants",
        nargs="+",
        type=float,
        metavar="C",
        help="lengths of the time steps, over the usual ones of each scheme (default: 1)",
    )
    group.add_argument("--repeats", type=int, metavar="N", help="runs of each, of which the median counts (default: 3)")
    group.add_argument("--peers", nargs="+", metavar="NAME", help="other programs on the same scenes: pysph, ...")
    group.add_argument(
        "--peer-python",
        metavar="PYTHON",
        help="interpreter that has them (default: $FLUIDGYM_PEER_PYTHON, or the one that runs this)",
    )
    group.add_argument("--plot", type=Path, metavar="FILE", help="draw it: .png, .pdf or .svg; needs the extra 'plot'")
    parser.set_defaults(run=benchmark)


# Options of `benchmark` that mean something only with --cases, and without.
_OF_CASES = ("schemes", "resolutions", "courants", "repeats")
_OF_SPEED = ("speed", "features", "particles", "worlds", "threads")


def benchmark(chosen: argparse.Namespace) -> int:
    """Time everything, or features, or cases."""
    astray = [name for name in (_OF_SPEED if chosen.cases else _OF_CASES) if getattr(chosen, name)]
    if astray:
        option = f"--{astray[0].replace('_', '-')}"
        return _refuse(f"{option} is of no effect {'with' if chosen.cases else 'without'} --cases; leave one out")
    if chosen.cases:
        return _compare(chosen)
    if min(*(chosen.particles or ()), *(chosen.worlds or ()), *(chosen.threads or ()), 1, 1) < 1:
        return _refuse("--particles, --worlds and --threads must be 1 or more")
    for name in ("peers", "plot", "speed", "threads") if chosen.features else ():
        if getattr(chosen, name):
            return _refuse(f"--{name} is of no effect with --features; leave one out")
    return _features(chosen) if chosen.features else _speed(chosen)


def _features(chosen: argparse.Namespace) -> int:
    """What each feature adds to a step."""
    from fluidgym.benchmark import COST_HEAD, machine, measure_costs
    from fluidgym.solver import find_device
    from fluidgym.validation.report import told

    try:
        _check_file("--json", chosen.json)
        device = str(find_device(chosen.device))
    except ValueError as error:
        return _refuse(str(error))
    facts = machine(device)
    keep = _keeper(chosen.json, facts)
    print(told(facts), COST_HEAD, sep="\n", flush=True)
    sizes = (chosen.dim,) if chosen.dim else (2, 3), chosen.worlds or [1], chosen.particles or [10000]
    for dim, worlds, particles in product(*sizes):
        try:
            for row in measure_costs(dim, particles, worlds, device):
                keep(asdict(row))
                print(row.line(), flush=True)
        except ValueError as error:  # too few particles for the scene
            return _refuse(f"{dim}D, {worlds} x {particles}: {error}")
    return 0


def _keeper(path: Path | None, facts: dict[str, str]) -> Any:
    """A function that adds an object to a JSON file, which is written anew each time."""
    from fluidgym.validation.report import write_json

    objects: list[dict[str, Any]] = [{"machine": facts}]

    def keep(found: dict[str, Any]) -> None:
        objects.append(found)
        if path:
            write_json(path, objects)

    return keep


def _speed(chosen: argparse.Namespace) -> int:
    """How fast everything is, a table at a time, with a bar on the terminal."""
    from gymnasium import registry

    from fluidgym.benchmark import machine
    from fluidgym.peers import find_interpreter, find_peer, version
    from fluidgym.solver import find_device
    from fluidgym.speed import draw, sections
    from fluidgym.stepping import processors
    from fluidgym.validation.report import finite, told
    from fluidgym.work_precision import check_plot

    try:
        _check_file("--json", chosen.json)
        if chosen.plot:
            check_plot(chosen.plot)
        device = str(find_device(chosen.device))
        facts = machine(device) | {"threads": str(processors())}
        peer, interpreter = None, find_interpreter(chosen.peer_python)
        if chosen.peers:
            peer, *more = chosen.peers
            if more:
                raise ValueError(f"--peers {' '.join(chosen.peers)}: one is compared with; name one")
            facts[peer] = version(find_peer(peer), interpreter)
    except ValueError as error:
        return _refuse(str(error))
    keep, rows = _keeper(chosen.json, facts), []
    about = told(facts)
    dims = (chosen.dim,) if chosen.dim else (2, 3)
    print(about, flush=True)
    environments = {name: spec.kwargs for name, spec in registry.items() if name.startswith("fluidgym/")}
    tables = sections(device, environments, dims, chosen.particles, chosen.worlds, chosen.threads, peer, interpreter)
    with tqdm(total=sum(len(table.rows) for table in tables), leave=False, disable=None) as bar:
        for table in tables:
            with tqdm.external_write_mode():
                print("", table.title, "", *filter(None, [table.head]), sep="\n", flush=True)
            for measure in table.rows:
                try:
                    row = measure()
                except ValueError as error:  # too few particles for the scene, a peer that fails
                    return _refuse(str(error))
                rows.append(row)
                keep(finite({"table": table.title, **asdict(row)}))
                with tqdm.external_write_mode():
                    print(row.line(), flush=True)
                bar.update()
    if chosen.plot:
        draw(rows, about, chosen.plot)
        print(f"wrote {chosen.plot}")
    return 0


def _compare(chosen: argparse.Namespace) -> int:
    """Run time against error: a row of the table for each point, then how the curves compare, and a plot."""
    from fluidgym.validation.report import told, write_json
    from fluidgym.work_precision import TABLE_HEAD, draw, objects

    try:
        comparison, facts = _comparison(chosen)
    except ValueError as error:
        return _refuse(str(error))
    about = told(facts) + f", median of {comparison.repeats}"
    interrupted = False

    def keep() -> None:
        if chosen.json:
            write_json(chosen.json, objects({"machine": facts}, comparison.points))

    print(about, TABLE_HEAD, sep="\n", flush=True)
    with tqdm(total=1.0, bar_format=BAR, leave=False, disable=None) as bar:

        def progress(label: str, duration: float) -> Any:
            bar.reset(duration)
            bar.set_description(label)
            return bar.update

        def tell(lines: list[str]) -> None:
            with tqdm.external_write_mode():
                print(*lines, sep="\n", end="\n" if lines else "", flush=True)

        try:
            for lines in comparison.run(progress):
                tell(lines)
                keep()
        except KeyboardInterrupt:
            interrupted = True
            tell(comparison.rest())
            keep()
    if chosen.plot and comparison.points:
        draw(comparison.points, about, chosen.plot)
        print(f"wrote {chosen.plot}")
    if interrupted:
        print("interrupted; what there was by then is kept", file=sys.stderr)
        return INTERRUPTED
    return 0


def _comparison(chosen: argparse.Namespace) -> tuple[Any, dict[str, str]]:
    """What `benchmark --cases` is to run, all of it checked, and what its times belong to.

    Raises:
        ValueError: Some of it cannot be run or written.
    """
    from fluidgym.benchmark import machine
    from fluidgym.peers import find_interpreter, find_peer, version
    from fluidgym.solver import find_device
    from fluidgym.work_precision import USUAL, Comparison, PeerCurve, SchemeCurve, check_plot, find_scheme

    plan = _plan(chosen, chosen.cases)
    repeats = 3 if chosen.repeats is None else chosen.repeats
    if repeats < 1:
        raise ValueError("--repeats must be 1 or more")
    courants = list(dict.fromkeys(chosen.courants or [1.0]))
    if not all(0.0 < courant <= 2.0 for courant in courants):
        raise ValueError("--courants must be above 0 and at most 2; 1 is the usual step of a scheme")
    _check_file("--json", chosen.json)
    _check_file("--plot", chosen.plot)
    if chosen.plot:
        check_plot(chosen.plot)
    device = str(find_device(chosen.device or ("cpu" if chosen.peers else None)))
    if chosen.peers and device != "cpu":
        raise ValueError(f"--peers run in one thread of a processor, --device {device} does not; use cpu")
    schemes = {name: find_scheme(name) for name in chosen.schemes or USUAL}
    peers = {name: find_peer(name) for name in chosen.peers or ()}
    python = find_interpreter(chosen.peer_python)
    facts = machine(device) | {name: version(peer, python) for name, peer in peers.items()}
    curves = [SchemeCurve(name, named, device) for name, named in schemes.items()]
    curves += [PeerCurve(name, peer, python) for name, peer in peers.items()]
    return Comparison(plan, curves, courants, repeats), facts


def _add_card(commands: argparse._SubParsersAction) -> None:
    parser = commands.add_parser(
        "card",
        help="measure the error and the cost of the environments",
        description="Hold each environment, at each fidelity, against the validation case that stands for it, at its"
        " resolution and at twice that, and time it. Without an id, all environments.",
    )
    parser.add_argument("ids", nargs="*", metavar="ID", help="an environment, such as fluidgym/DamBreakContain2D-v0")
    parser.add_argument(
        "--fidelity", nargs="+", metavar="NAME", help="fast, balanced or accurate, one or several (default: all)"
    )
    parser.add_argument("--device", help="cpu, cuda, cuda:1, ...; a GPU where there is one if not given")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to this file as well")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write them as a page, docs/accuracy_cards.md")
    parser.set_defaults(run=card)


def card(chosen: argparse.Namespace) -> int:
    """Measure environments: rows of the table for each at each fidelity, and the files kept up with them."""
    from fluidgym.accuracy_card import TABLE_HEAD, make_card, write_markdown
    from fluidgym.benchmark import machine
    from fluidgym.scheme import FIDELITIES
    from fluidgym.solver import find_device
    from fluidgym.validation.report import told, write_json

    try:
        environments = _environments(chosen.ids)
        fidelities = list(dict.fromkeys(chosen.fidelity or FIDELITIES))
        _check_fidelities(fidelities)
        _check_file("--json", chosen.json)
        _check_file("--markdown", chosen.markdown)
        device = str(find_device(chosen.device))
    except ValueError as error:
        return _refuse(str(error))
    facts, cards, interrupted = machine(device), [], False
    print(told(facts), TABLE_HEAD, sep="\n", flush=True)
    with tqdm(total=1.0, bar_format=BAR, leave=False, disable=None) as bar:

        def progress(label: str, duration: float) -> Any:
            bar.reset(duration)
            bar.set_description(label)
            return bar.update

        try:
            for (env_id, options), fidelity in product(environments.items(), fidelities):
                cards.append(make_card(env_id, options, fidelity, device, progress))
                with tqdm.external_write_mode():
                    print(*cards[-1].lines(), sep="\n", flush=True)
                if chosen.json:
                    write_json(chosen.json, [{"machine": facts}, *(found.as_json() for found in cards)])
                if chosen.markdown:
                    write_markdown(chosen.markdown, cards, facts, _card_command(chosen))
        except KeyboardInterrupt:
            interrupted = True
        except ValueError as error:  # too few particles for the scene
            return _refuse(f"{env_id} {fidelity}: {error}")
    if interrupted:
        print(f"interrupted after {len(cards)} of {len(environments) * len(fidelities)} cards", file=sys.stderr)
        return INTERRUPTED
    return 0


def _add_evaluate(commands: argparse._SubParsersAction) -> None:
    parser = commands.add_parser(
        "evaluate",
        help="what a controller earns",
        description="Let controllers play episodes of a band of seeds that nobody trains on: one that does nothing, the"
        " task's own, and trained ones.",
    )
    parser.add_argument("ids", nargs="+", metavar="ID", help="an environment, such as fluidgym/CarryTank2D-v0")
    parser.add_argument(
        "--policy", nargs="+", default=["null", "scripted"], metavar="NAME|FILE", help="(default: null scripted)"
    )
    _add_difficulty(parser)
    parser.add_argument("--resolution", type=int, metavar="N", help="particles over the length the task counts along")
    parser.add_argument("--episodes", type=int, default=32, metavar="N", help="of each (default: 32)")
    parser.add_argument("--device", help="cpu, cuda, cuda:1, ...; a GPU where there is one if not given")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to this file as well")
    parser.set_defaults(run=evaluate)


def evaluate(chosen: argparse.Namespace) -> int:
    """Score controllers: a line for each in each environment."""
    from fluidgym.envs import evaluation, make_task
    from fluidgym.validation.report import write_json

    rows = []
    try:
        environments = _environments(chosen.ids)
        controllers = {name: _controller(name) for name in chosen.policy}
        _check_file("--json", chosen.json)
        difficulty = _difficulty(chosen.difficulty, controllers.values())
        options = {"difficulty": difficulty, "resolution": chosen.resolution}
        for env_id, given in environments.items():
            posed = {**given, **options}
            steps = make_task(posed.pop("task"), **posed).max_episode_steps
            for name, controller in controllers.items():
                with tqdm(total=steps, desc=f"{env_id} {name}", unit="step", leave=False, disable=None) as bar:
                    score = evaluation.evaluate(
                        controller, **given, **options, episodes=chosen.episodes, device=chosen.device,
                        progress=bar.update,
                    )  # fmt: skip
                print(f"{env_id} {difficulty} {name}: {score}", flush=True)
                row = {"id": env_id, **options, "policy": name, "mean": score.mean, "margin": score.margin}
                rows.append({**row, "episodes": chosen.episodes, "diverged": score.diverged, "parts": score.parts})
                if chosen.json:
                    write_json(chosen.json, rows)
    except ValueError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        print(f"interrupted after {len(rows)} scores", file=sys.stderr)
        return INTERRUPTED
    return 0


def _controller(name: str) -> Any:
    """A controller by its name, or from a file."""
    from fluidgym.envs.evaluation import BUILT_IN
    from fluidgym.envs.policy import Policy

    return name if name in BUILT_IN else Policy.load(Path(name))


def _add_difficulty(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--difficulty", help="easy, medium or hard (default: what the policy was trained at, if it is a file; medium)"
    )


def _difficulty(asked: str | None, controllers: Iterable[Any]) -> str:
    """What was asked for, or what the first of the trained controllers was trained at, or medium."""
    trained = (one.about.get("difficulty") for one in controllers if not isinstance(one, str))
    return asked or next(filter(None, trained), "medium")


def _posed(name: str, policy: str, chosen: argparse.Namespace, mode: str | None = None) -> tuple[Any, Any]:
    """An environment, and a controller that fits it.

    Raises:
        ValueError: There is none of such a name, or the controller does not fit.
    """
    from fluidgym.envs import FluidEnv

    ((_, given),) = _environments([name]).items()
    controller = _controller(policy)
    difficulty = _difficulty(chosen.difficulty, [controller])
    env = FluidEnv(**given, difficulty=difficulty, device=chosen.device, render_mode=mode)
    if not isinstance(controller, str):
        controller.check(env.task)
    return env, controller


def _add_play(commands: argparse._SubParsersAction) -> None:
    parser = commands.add_parser(
        "play",
        help="watch a controller",
        description="Let a controller play an episode, in a window or into a film.",
    )
    parser.add_argument("id", metavar="ID", help="an environment, such as fluidgym/CarryTank2D-v0")
    parser.add_argument(
        "--policy", default="scripted", metavar="NAME|FILE", help="null, scripted, or a file (scripted)"
    )
    _add_difficulty(parser)
    parser.add_argument("--seed", type=int, default=0, help="of the episode (default: 0)")
    parser.add_argument("--film", type=Path, metavar="FILE", help="a .gif or .mp4; a window if not given")
    parser.add_argument("--device", help="cpu, cuda, cuda:1, ...; a GPU where there is one if not given")
    parser.set_defaults(run=play)


def play(chosen: argparse.Namespace) -> int:
    """Play an episode."""
    from fluidgym.envs import evaluation
    from fluidgym.render.film import write_gif, write_mp4

    try:
        _check_screen(chosen.film)
        mode = "rgb_array" if chosen.film else "human"
        env, controller = _posed(chosen.id, chosen.policy, chosen, mode)
        observation, _ = env.reset(seed=chosen.seed)
    except ValueError as error:
        return _refuse(str(error))
    task, frames, total, ended, interrupted = env.task, [], 0.0, False, False
    try:
        with tqdm(total=task.max_episode_steps, desc=chosen.id, unit="step", leave=False, disable=None) as bar:
            while not ended:
                action = evaluation.act(controller, task, observation[None])[0]
                observation, reward, terminated, truncated, info = env.step(action)
                total, ended = total + reward, terminated or truncated
                if chosen.film:
                    frames.append(env.render())
                bar.update(1)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        env.close()
    if frames:  # those of half an episode, too
        write = write_mp4 if chosen.film.suffix == ".mp4" else write_gif
        write(chosen.film, frames, 1.0 / task.control_interval)
        print(chosen.film)
    if interrupted:
        print(f"interrupted: return {total:.1f} until then", file=sys.stderr)
        return INTERRUPTED
    print(f"{chosen.id} {task.difficulty} {chosen.policy}: return {total:.1f} in {info['time']:.1f} s")
    return 0


def _check_screen(film: Path | None) -> None:
    """Refuse a film, or a window, that could not be shown in the end."""
    from fluidgym.render.film import check_mp4

    if film is None:
        if find_spec("pygame") is None:
            raise ValueError('a window needs pygame: pip install "fluidgym-sph[render]", or give --film FILE.gif')
        if not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")):
            raise ValueError("there is no screen for a window (DISPLAY is not set); give --film FILE.gif")
        return
    _check_file("--film", film)
    if film.suffix not in (".gif", ".mp4"):
        raise ValueError(f"--film {film} is of no kind that can be written; let it end in .gif or .mp4")
    if film.suffix == ".mp4":
        check_mp4()


def _add_stress(commands: argparse._SubParsersAction) -> None:
    parser = commands.add_parser(
        "stress",
        help="try to break the simulator",
        description="Run the flows that numbers like to break on, and, with --hours, drive every task with the worst"
        " actions there are; what breaks leaves a file that replays it.",
    )
    parser.add_argument(
        "numbers", nargs="*", type=int, metavar="NUMBER", help="of the stresses, 1 to 12 (default: all)"
    )
    parser.add_argument("--long", action="store_true", help="as long as the marks were meant: an hour in all")
    parser.add_argument(
        "--hours", type=float, metavar="H", help="drive the tasks for so long in all, after the stresses"
    )
    parser.add_argument("--ids", nargs="+", default=[], metavar="ID", help="environments to drive (default: all in 2D)")
    parser.add_argument("--difficulty", default="medium", help="of these: easy, medium or hard (default: medium)")
    parser.add_argument("--worlds", type=int, default=32, metavar="N", help="of each at a time (default: 32)")
    parser.add_argument(
        "--jobs", type=int, default=1, metavar="N", help="tasks at a time, each with a thread of its own (default: 1)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn (default: 0)")
    parser.add_argument(
        "--out", type=Path, default=Path("outputs/stress"), metavar="FOLDER", help="for replays of failures"
    )
    parser.add_argument("--replay", type=Path, metavar="FILE", help="play a failure again, and nothing else")
    parser.add_argument("--device", help="cpu, cuda, cuda:1, ...; a GPU where there is one if not given")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results to this file as well")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the results as a page")
    parser.set_defaults(run=stress)


def stress(chosen: argparse.Namespace) -> int:
    """Try to break the simulator: a line for each stress and each task."""
    from fluidgym.benchmark import machine
    from fluidgym.soak import replay
    from fluidgym.solver import find_device
    from fluidgym.stress import Found, choose, markdown
    from fluidgym.validation.report import write_json, write_page

    found = Found()
    try:
        if chosen.replay:
            reason, steps = replay(chosen.replay, chosen.device)
            print(f"{chosen.replay}: {f'diverged ({reason})' if reason else 'sound'} after {steps} steps")
            return MISSED if reason else 0
        stresses = choose(chosen.numbers, chosen.hours)
        if chosen.jobs < 1:
            raise ValueError(f"--jobs {chosen.jobs} is less than 1; give how many tasks are driven at a time")
        environments = _environments(chosen.ids or [name for name in _environments([]) if "2D" in name])
        _check_file("--json", chosen.json)
        _check_file("--markdown", chosen.markdown)
        device = str(find_device(chosen.device))
        facts = machine(device)

        def keep() -> None:
            if chosen.json:
                write_json(chosen.json, [facts, *found.as_json()])
            if chosen.markdown:
                write_page(chosen.markdown, markdown(found, facts, _stress_command(chosen)))

        for one in tqdm(stresses, unit="stress", leave=False, disable=None):
            print(found.add(one, chosen.long, device), flush=True)
            keep()
        if chosen.hours:
            tasks = {name: {**given, "difficulty": chosen.difficulty} for name, given in environments.items()}
            how: dict[str, Any] = {"worlds": chosen.worlds, "seed": chosen.seed, "folder": chosen.out, "device": device}
            for env_id, report in _soaks(tasks, chosen, how):
                found.soaked[env_id] = report
                print(f"{env_id} {chosen.difficulty}: {report}", flush=True)
                keep()
    except (ValueError, FileNotFoundError) as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        print("interrupted; what there was by then is kept", file=sys.stderr)
        return INTERRUPTED
    return 0 if found.passed else MISSED


def _soaks(tasks: dict[str, dict[str, Any]], chosen: argparse.Namespace, how: dict[str, Any]) -> Iterator[tuple]:
    """Name and report of each task, as it is done, and a bar until then."""
    from fluidgym.soak import Report, soak, soak_all

    jobs = min(chosen.jobs, len(tasks))
    how = how | {"seconds": 3600.0 * chosen.hours * jobs / len(tasks)}
    if jobs > 1:
        yield from tqdm(soak_all(tasks, jobs, **how), total=len(tasks), unit="task", leave=False, disable=None)
        return
    each = how["seconds"]
    for env_id, options in tasks.items():
        with tqdm(total=each, bar_format=BAR.replace(" simulated", ""), desc=env_id, leave=False, disable=None) as bar:

            def tell(so_far: Report, bar: tqdm = bar) -> None:
                bar.update(min(so_far.seconds, each) - bar.n)

            yield env_id, soak(options.pop("task"), options, progress=tell, **how)


def _stress_command(chosen: argparse.Namespace) -> str:
    """The command that makes the page of `stress` anew."""
    words = ["stress", *map(str, chosen.numbers)]
    words += ["--long"] if chosen.long else []
    words += ["--hours", f"{chosen.hours:g}"] if chosen.hours else []
    words += ["--ids", *chosen.ids] if chosen.hours and chosen.ids else []
    words += ["--difficulty", chosen.difficulty] if chosen.hours else []
    words += ["--jobs", f"{chosen.jobs}"] if chosen.hours and chosen.jobs > 1 else []
    return _page_command(words, chosen.markdown)


def _add_view(commands: argparse._SubParsersAction) -> None:
    parser = commands.add_parser(
        "view",
        help="watch and drive in the browser",
        description="Serve a page with the fluid live in it: an environment or a scene file, driven by a controller, by"
        " the file, or by hand. It ends when the page is closed.",
    )
    parser.add_argument("what", metavar="ID|FILE", help="an environment, such as CarryTank3D-v0, or a scene file")
    parser.add_argument(
        "--policy", metavar="NAME|FILE", help="null, scripted, or a file; by hand if not given (environments only)"
    )
    _add_difficulty(parser)
    parser.add_argument("--seed", type=int, default=0, help="of the first episode (default: 0)")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1, this machine)")
    parser.add_argument("--port", type=int, default=8080, help="or the next that is free (default: 8080)")
    parser.add_argument("--stay", action="store_true", help="go on when the page is closed")
    parser.add_argument("--device", help="cpu, cuda, cuda:1, ...; a GPU where there is one if not given")
    parser.set_defaults(run=view)


def view(chosen: argparse.Namespace) -> int:
    """Serve the page until it is closed."""
    from fluidgym.scene_file import load
    from fluidgym.viewer.flows import EnvFlow, SceneFlow
    from fluidgym.viewer.page import Page, import_viser

    try:
        import_viser()
        if chosen.what.endswith(".toml"):
            if chosen.policy:
                raise ValueError(f"--policy {chosen.policy} is for environments; leave it out with a scene file")
            flow = SceneFlow(load(chosen.what), chosen.device, by_hand=False)
        else:
            env, controller = _posed(chosen.what, chosen.policy or "scripted", chosen)
            flow = EnvFlow(env, controller, by_hand=chosen.policy is None)
        page = Page(flow, chosen.host, chosen.port, chosen.seed, chosen.stay)
    except ValueError as error:
        return _refuse(str(error))
    print(f"{page.url} (Ctrl-C or closing the page ends it)", flush=True)
    try:
        page.run()
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        page.close()
    return 0


def _environments(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """What environments are registered with, by id; of no names, all of the package.

    Raises:
        ValueError: There is no such environment.
    """
    import gymnasium

    known = {env_id: spec.kwargs for env_id, spec in gymnasium.registry.items() if spec.namespace == "fluidgym"}
    wanted = list(
        dict.fromkeys(f"fluidgym/{name.removeprefix('fluidgym:').removeprefix('fluidgym/')}" for name in names)
    )
    unknown = [name for name, env_id in zip(names, wanted, strict=False) if env_id not in known]
    if unknown:
        raise ValueError(f"unknown environment {', '.join(unknown)}; known are {', '.join(known)}")
    return {env_id: known[env_id] for env_id in wanted or known}


def _card_command(chosen: argparse.Namespace) -> str:
    """The command that makes the page of `card` anew."""
    words = ["card", *chosen.ids]
    words += ["--fidelity", *chosen.fidelity] if chosen.fidelity else []
    words += ["--device", chosen.device] if chosen.device else []
    return _page_command(words, chosen.markdown)


def _check_file(option: str, path: Path | None) -> None:
    """Refuse a file that cannot be written, before anything is run.

    Raises:
        ValueError: It is a folder, or its folder is not there or cannot be written to.
    """
    if path is None:
        return
    folder = path.absolute().parent
    if path.is_dir():
        raise ValueError(f"{option} {path}: this is a folder; name a file in it")
    if not folder.is_dir():
        raise ValueError(f"{option} {path}: there is no such folder; make it, or name a file in another")
    if not os.access(folder, os.W_OK):
        raise ValueError(f"{option} {path}: the folder cannot be written to; name a file in another")


def _refuse(reason: str) -> int:
    print(f"fluidgym: {reason}", file=sys.stderr)
    return REFUSED


if __name__ == "__main__":
    sys.exit(main())
