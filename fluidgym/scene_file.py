"""Scene files: an experiment as TOML text, and back.

The tables of a file are the dataclasses of the package, field by field, so that a new field of one needs no line here:
what is at its default may be left out, None is written by leaving it out. The fields of the scene stand at the top of
the file, beside `title`, `duration`, `[[motion]]`, `[scheme]` and `[view]`. Nothing in a file is executed.

`[scheme]` has one key more than the fields of `Scheme`: `fidelity = "fast"`, "balanced" or "accurate" takes a scheme by
its name, and the other keys then stand in for single fields of it. Without it they stand in for those of "balanced". It
says nothing of the resolution, which is `particle_spacing`.
"""

from __future__ import annotations

import json
import os
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import tomli_w

from fluidgym.experiment import Experiment, Motion
from fluidgym.files import replacing
from fluidgym.scene import Scene
from fluidgym.scheme import DEFAULT_SCHEME, FIDELITIES, Scheme
from fluidgym.shapes import Shape
from fluidgym.sph import integrators, smoothing, state_equation
from fluidgym.sph.integrators import Integrator
from fluidgym.sph.mueller import KERNEL_VISCOSITY
from fluidgym.sph.smoothing import SmoothingKernel
from fluidgym.sph.state_equation import StateEquation
from fluidgym.sph.terms import Drag, Force, Term
from fluidgym.sph.viscosity import VISCOSITY_MONAGHAN, VISCOSITY_MORRIS
from fluidgym.sph.wall_models import WallModel

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pyright: ignore[reportMissingImports]


def _by_name(module: types.ModuleType, kind: type) -> dict[str, Any]:
    """The constants of a module that are of one kind, by their names as a file has them."""
    found = [value for value in vars(module).values() if isinstance(value, kind)]
    return {value.name.lower().replace(" ", "-"): value for value in found}


_VISCOSITIES = {"morris": VISCOSITY_MORRIS, "monaghan": VISCOSITY_MONAGHAN, "kernel": KERNEL_VISCOSITY}

# What is a constant in Python is a word in a file.
_WORDS: dict[type, dict[str, Any]] = {
    SmoothingKernel: _by_name(smoothing, SmoothingKernel),
    StateEquation: _by_name(state_equation, StateEquation),
    Integrator: _by_name(integrators, Integrator),
    Force: _VISCOSITIES,
    Drag: _VISCOSITIES,
}

# One of several classes: {kind = "penalty", ...}, or {box = [...]}.
_KINDS = {kind.__name__.removesuffix("Walls").lower(): kind for kind in (*get_args(WallModel), *get_args(Motion))}
_SHAPES = {shape.__name__.lower(): shape for shape in get_args(Shape)}

# Names in a file that differ from the field's.
_FILE_NAMES = {"motions": "motion"}

# Written even where they are at their default: without them a file leaves its reader guessing.
_ALWAYS = {"gravity", "material", "density"}

_EXAMPLES = {
    "shape": "{box = [[0, 0], [1, 2]]} or {ball = {center = [1, 1], radius = 0.5}}",
    "region": "{box = [[0, 0], [1, 2]]}",
}


def load(
    path: str | os.PathLike[str], particle_spacing: float | None = None, fidelity: str | None = None
) -> Experiment:
    """Read a scene file.

    Args:
        path: The file.
        particle_spacing: In the place of the file's [m].
        fidelity: In the place of that of the file's [scheme], whose other keys are kept.

    Raises:
        ValueError: The file cannot be read or says what cannot be; one line that names the file, the field, the value,
            the limit and the remedy.
    """
    return loads(_text(path), str(path), particle_spacing, fidelity)


def load_scheme(path: str | os.PathLike[str]) -> Scheme:
    """Read the [scheme] of a scene file, or of a file that has nothing else.

    Raises:
        ValueError: As of `load`.
    """
    document = _document(_text(path), str(path))
    try:
        if "scheme" not in document:
            raise ValueError("has no table [scheme]; add one, such as [scheme] with a line courant = 0.5")
        return _read(document["scheme"], _hints(Experiment)["scheme"], "scheme")
    except ValueError as error:
        raise ValueError(f"{path}: {_one_line(error)}") from None


def loads(
    text: str, name: str = "scene file", particle_spacing: float | None = None, fidelity: str | None = None
) -> Experiment:
    """Read a scene file's text.

    Args:
        text: The text.
        name: What messages call it.
        particle_spacing: In the place of the text's [m].
        fidelity: In the place of that of the text's [scheme], whose other keys are kept.

    Raises:
        ValueError: As of `load`.
    """
    document = _document(text, name)
    if particle_spacing is not None:
        document["particle_spacing"] = particle_spacing
    if fidelity is not None and isinstance(document.setdefault("scheme", {}), dict):
        document["scheme"]["fidelity"] = fidelity
    try:
        return _read_experiment(document)
    except ValueError as error:
        raise ValueError(f"{name}: {_one_line(error)}") from None
    except MemoryError:
        raise ValueError(
            f"{name}: has more particles than this machine can hold; use a larger particle_spacing"
        ) from None


def save(experiment: Experiment, path: str | os.PathLike[str]) -> None:
    """Write a scene file: all of it, or none and a file of that name stays as it was.

    Raises:
        ValueError: As of `dumps`.
        OSError: The file cannot be written.
    """
    text = dumps(experiment)
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def dumps(experiment: Experiment) -> str:
    """An experiment as the text of a scene file; `loads` makes an equal one of it.

    Raises:
        ValueError: The experiment has a function in it, which no file can hold; the message names the field.
    """
    written = _write_table(experiment, "")
    scene = written.pop("scene")
    # Title and duration first; the larger tables last.
    first = {key: written.pop(key) for key in ("title", "duration") if key in written}
    return tomli_w.dumps(first | scene | written)


# -- reading ---------------------------------------------------------------------------------------------------------


def _text(path: str | os.PathLike[str]) -> str:
    """The text of a file."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}; name a scene file") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is not UTF-8 text; name a scene file") from None


def _document(text: str, name: str) -> dict[str, Any]:
    """A scene file's text as TOML has it."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError(f"{name}: is nested too deeply; use fewer brackets") from None
    except ValueError as error:  # the syntax, or a number of more digits than Python reads
        raise ValueError(f"{name}: is not TOML: {_one_line(error)}; mend it there") from None


def _read_experiment(document: dict[str, Any]) -> Experiment:
    hints, scene_hints, named = _hints(Experiment), _hints(Scene), _top_names()
    _check_keys(document, "", list(named), [key for key in (*_required(Experiment), *_required(Scene)) if key in named])
    given = {named[key]: _read(value, (scene_hints | hints)[named[key]], key) for key, value in document.items()}
    scene = _make(Scene, {name: value for name, value in given.items() if name in scene_hints}, "")
    return _make(Experiment, {"scene": scene} | {name: value for name, value in given.items() if name in hints}, "")


@cache
def _top_names() -> dict[str, str]:
    """What may stand at the top of a file, and the field that it is: one of the experiment's or of the scene's."""
    names = [name for name in (*_hints(Experiment), *_hints(Scene)) if name != "scene"]
    return {_FILE_NAMES.get(name, name): name for name in names}


def _read(value: Any, hint: Any, path: str) -> Any:
    """A value of a file as what a field is to hold."""
    choices = [choice for choice in _choices(hint) if _fits(value, choice)]
    if not choices:
        raise ValueError(_mismatch(value, hint, path))
    hint = choices[0]
    origin, inner = get_origin(hint), get_args(hint)
    if hint in _WORDS:
        return _WORDS[hint][_known(value, _WORDS[hint], path)]
    if hint in _SHAPES.values():
        return _read_shape(value, tuple(choices), path)
    if hint in _KINDS.values():
        return _read_kind(value, tuple(choices), path)
    if hint is Scheme:
        return _read_scheme(value, path)
    if is_dataclass(hint) and isinstance(hint, type):
        return _read_table(value, hint, path)
    if origin is Literal:
        return _known(value, inner, path)
    if hint is float:
        return _number(value, path)
    if origin is tuple:
        return _read_tuple(value, inner, path)
    if hint in (Sequence, list) or origin in (Sequence, list):
        return [_read(item, inner[0], f"{path}[{index}]") for index, item in enumerate(value)]
    if origin in (Mapping, dict):
        return {key: _read(item, inner[1], f"{path}.{key}") for key, item in value.items()}
    return value


def _read_table(table: Mapping[str, Any], kind: type, path: str, label: str | None = None) -> Any:
    """A table as a dataclass."""
    label = path if label is None else label
    hints = _hints(kind)
    _check_keys(table, path, list(hints), _required(kind))
    return _make(kind, {key: _read(value, hints[key], f"{path}.{key}") for key, value in table.items()}, label)


def _read_scheme(table: Mapping[str, Any], path: str) -> Scheme:
    """The scheme of a fidelity, with the other keys in the place of single fields of it."""
    hints = _hints(Scheme)
    _check_keys(table, path, ["fidelity", *hints], ())
    named = FIDELITIES[_known(table.get("fidelity", "balanced"), FIDELITIES, f"{path}.fidelity")]
    # Without what it takes for itself, as that depends on the preset.
    base = _spare(named, {name: getattr(named, name) for name in hints})
    own = {key: _read(value, hints[key], f"{path}.{key}") for key, value in table.items() if key != "fidelity"}
    return _make(Scheme, base | own, path)


def _read_kind(table: Mapping[str, Any], kinds: tuple[type, ...], path: str) -> Any:
    """A table that says by its `kind` of which class it is."""
    known = {word: kind for word, kind in _KINDS.items() if kind in kinds}
    if "kind" not in table:
        raise ValueError(f"{path}.kind is missing; use {_listed(known)}")
    kind = known[_known(table["kind"], known, f"{path}.kind")]
    table = {key: value for key, value in table.items() if key != "kind"}
    return _read_table(table, kind, path)


def _read_shape(table: Mapping[str, Any], shapes: tuple[type, ...], path: str) -> Any:
    """A table with one key, which is the shape's name; its value is the fields, in order or by name."""
    known = {word: shape for word, shape in _SHAPES.items() if shape in shapes and _writable(shape)}
    if len(table) != 1:
        raise ValueError(f"{path} has {len(table)} keys where a shape has one; use {_EXAMPLES['shape']}")
    ((word, value),) = table.items()
    shape = known[_known(word, known, path)]
    path = f"{path}.{word}"
    if isinstance(value, list):
        names = list(_hints(shape))
        if len(value) != len(names):
            raise ValueError(f"{path} has {len(value)} entries, limit {len(names)}; give {' and '.join(names)}")
        value = dict(zip(names, value, strict=True))
    elif not isinstance(value, dict):
        raise ValueError(f"{path} = {_shown(value)} is no shape; use {_EXAMPLES['shape']}")
    return _read_table(value, shape, path)


def _read_tuple(value: list[Any], inner: tuple[Any, ...], path: str) -> tuple[Any, ...]:
    if inner[-1] is Ellipsis:
        hints = [inner[0]] * len(value)
    elif len(value) != len(inner):
        raise ValueError(f"{path} has {len(value)} entries, limit {len(inner)}; give {len(inner)}")
    else:
        hints = list(inner)
    return tuple(
        _read(item, hint, f"{path}[{index}]") for index, (item, hint) in enumerate(zip(value, hints, strict=True))
    )


def _make(kind: type, given: dict[str, Any], path: str) -> Any:
    """An object of its fields; what it refuses is told with the table in front."""
    try:
        return kind(**given)
    except ValueError as error:
        raise ValueError(f"{path}: {error}" if path else str(error)) from None


def _number(value: float, path: str) -> float:
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"{path} = {_shown(value)} is larger than any number here; use a smaller one") from None


def _check_keys(table: Mapping[str, Any], path: str, known: list[str], needed: Sequence[str]) -> None:
    """Refuse keys that mean nothing, and the lack of those that must be there."""
    prefix = f"{path}." if path else ""
    for key in table:
        if key in known:
            continue
        near = get_close_matches(key, known, n=1, cutoff=0.5)
        if path and key in _top_names():
            remedy = f"{key} belongs to the top of the file, before the first [table];"
        elif not path and (key == "fidelity" or key in _hints(Scheme)):
            remedy = f"{key} belongs to the table [scheme];"
        elif near:
            remedy = f"did you mean {near[0]}?"
        else:
            remedy = "choose another:"
        raise ValueError(f"{prefix}{key} is unknown; {remedy} known here are {', '.join(sorted(known))}")
    for key in needed:
        if key not in table:
            example = f", such as {_EXAMPLES[key]}" if key in _EXAMPLES else ""
            raise ValueError(f"{prefix}{key} is missing; give one{example}")


def _known(word: Any, known: Mapping[str, Any] | Sequence[str], path: str) -> str:
    """A word that is one of those known; any other is refused, with the nearest."""
    if isinstance(word, str) and word in known:
        return word
    near = get_close_matches(str(word), list(known), n=1, cutoff=0.5)
    guess = f"did you mean {_shown(near[0])}? Use" if near else "use"
    raise ValueError(f"{path} = {_shown(word)} is unknown; {guess} {_listed(known)}")


# -- what a field may hold -------------------------------------------------------------------------------------------


@cache
def _hints(kind: type) -> dict[str, Any]:
    """Types of the fields of a dataclass, by name."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


@cache
def _required(kind: type) -> tuple[str, ...]:
    """Names of the fields that must be given."""
    return tuple(f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING)


def _choices(hint: Any) -> list[Any]:
    """The types of a union that a file can hold; functions and None are not among them."""
    parts = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    return [part for part in parts if part is not type(None) and _writable(part)]


def _writable(hint: Any) -> bool:
    """Whether a file can hold what a type describes: not a function, nor what needs one."""
    origin = get_origin(hint)
    if hint in _WORDS or origin is Literal:
        return True
    if origin is Callable or hint is Callable or Term in get_args(hint):
        return False
    if origin is not None:
        return all(bool(_choices(part)) for part in get_args(hint) if part is not Ellipsis)
    if is_dataclass(hint) and isinstance(hint, type):
        return all(bool(_choices(_hints(hint)[name])) for name in _required(hint))
    return hint in (str, bool, int, float)


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is at first sight of a type: what is in a list or table is looked at later."""
    origin = get_origin(hint)
    if hint in _WORDS or origin is Literal or hint is str:
        return isinstance(value, str)
    if hint is bool:
        return isinstance(value, bool)
    if hint in (int, float):
        return isinstance(value, int if hint is int else (int, float)) and not isinstance(value, bool)
    if origin in (Mapping, dict) or is_dataclass(hint):
        return isinstance(value, dict)
    if origin is tuple and isinstance(value, list) and value:
        # Numbers and vectors are told apart by the first.
        return any(_fits(value[0], choice) for choice in _choices(get_args(hint)[0]))
    return isinstance(value, list)


def _mismatch(value: Any, hint: Any, path: str) -> str:
    """What is wrong with a value that is of none of the types."""
    choices = _choices(hint)
    name = path.rpartition(".")[2]
    if not choices:
        return f"{path} takes a Python function, which a file cannot hold; leave it out, or write a script"
    if isinstance(value, dict) and any(get_origin(choice) in (Sequence, list) for choice in choices):
        return f"{path} is one table where a list of tables is needed; write [[{path}]] with two brackets"
    listed = " or ".join(dict.fromkeys(_what(choice) for choice in choices))
    words = [word for choice in choices if choice in _WORDS for word in _WORDS[choice]]
    words += [word for choice in choices if get_origin(choice) is Literal for word in get_args(choice)]
    remedy = _EXAMPLES.get(name) or (_listed(words) if words else f"{listed}")
    return f"{path} = {_shown(value)} is not {listed}; use {remedy}"


def _what(hint: Any) -> str:
    """A type in words."""
    if hint in _WORDS or get_origin(hint) is Literal:
        return "a word in quotes"
    simple = {str: "a string in quotes", bool: "true or false", int: "a whole number", float: "a number"}
    if hint in simple:
        return simple[hint]
    if get_origin(hint) is tuple:
        first = _choices(get_args(hint)[0])
        return "a list of numbers" if first and first[0] in (int, float) else "a list of lists"
    return "a list" if get_origin(hint) in (Sequence, list) else "a table"


# -- writing ---------------------------------------------------------------------------------------------------------


def _write_table(item: Any, path: str) -> dict[str, Any]:
    """The fields of a dataclass that a file needs, written."""
    kind = type(item)
    given = {field.name: getattr(item, field.name) for field in fields(kind)}
    table = {}
    for name, value in _spare(item, given).items():
        if value is not None:
            key = _FILE_NAMES.get(name, name)
            table[key] = _write(value, f"{path}.{key}" if path else key)
    return table


def _spare(item: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """Those of the fields that make the object: left out is what it would take for itself."""
    kept = dict(given)
    for field in fields(type(item)):
        required = field.default is MISSING and field.default_factory is MISSING
        if required or field.name in _ALWAYS:
            continue
        default = field.default_factory() if field.default_factory is not MISSING else field.default
        rest = {name: value for name, value in kept.items() if name != field.name}
        if _same(given[field.name], default) or _makes(type(item), rest, item):
            kept = rest
        elif isinstance(given[field.name], Mapping):
            kept[field.name] = _spare_entries(item, kept, field.name)
    return kept


def _spare_entries(item: Any, kept: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The entries of a mapping without those that say nothing: a face that is just a wall."""
    entries = dict(kept[name])
    for key, entry in kept[name].items():
        if is_dataclass(entry) and not _required(type(entry)) and _same(entry, type(entry)()):
            rest = {other: value for other, value in entries.items() if other != key}
            if _makes(type(item), {**kept, name: rest}, item):
                entries = rest
    return entries


def _same(one: Any, other: Any) -> bool:
    return one is other or (type(one) is type(other) and bool(one == other))


def _makes(kind: type, given: Mapping[str, Any], item: Any) -> bool:
    """Whether these fields make this very object."""
    try:
        return bool(kind(**given) == item)
    except ValueError:
        return False


def _write(value: Any, path: str) -> Any:
    """A value as a file has it."""
    kind = type(value)
    if kind in _WORDS:
        words = [word for word, known in _WORDS[kind].items() if known is value]
        if not words:
            raise ValueError(
                f"{path} is a {kind.__name__} of your own, which a file cannot hold; use {_listed(_WORDS[kind])}"
            )
        return words[0]
    if kind in _SHAPES.values():
        return {kind.__name__.lower(): _write_shape(value, path)}
    if kind in _KINDS.values():
        word = next(word for word, known in _KINDS.items() if known is kind)
        return {"kind": word} | _write_table(value, path)
    if isinstance(value, Scheme) and value != DEFAULT_SCHEME and value in FIDELITIES.values():
        return {"fidelity": next(name for name, scheme in FIDELITIES.items() if scheme == value)}
    if is_dataclass(value):
        return _write_table(value, path)
    if isinstance(value, Mapping):
        return {str(key): _write(item, f"{path}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_write(item, f"{path}[{index}]") for index, item in enumerate(value)]
    if callable(value):
        raise ValueError(f"{path} is a Python function, which a file cannot hold; use a value, or keep your script")
    return _plain(value)


def _write_shape(shape: Any, path: str) -> Any:
    if not _writable(type(shape)):
        raise ValueError(
            f"{path} is a {type(shape).__name__}, a Python function, which a file cannot hold; use boxes and balls"
        )
    if all(isinstance(getattr(shape, name), tuple) for name in _hints(type(shape))):
        return [list(getattr(shape, name)) for name in _hints(type(shape))]  # a box: two corners
    return _write_table(shape, path)


def _plain(value: Any) -> Any:
    """A number of NumPy's as Python's own, which TOML knows."""
    return value.item() if hasattr(value, "item") else value


# -- messages --------------------------------------------------------------------------------------------------------


def _shown(value: Any) -> str:
    """A value as it may stand in a file, shortened."""
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except ValueError:  # a whole number of more digits than Python prints
        text = "a very long number"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _listed(words: Mapping[str, Any] | Sequence[str]) -> str:
    return ", ".join(_shown(word) for word in dict.fromkeys(words))


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
