"""Single or double precision of the device code, chosen once a process: before any of that code is imported.

Kernels are written in Warp's `float`, which is 32 bits wide. That is what FluidGym computes with. To tell how much of
an error is rounding, the same kernels can run in 64 bits: then each module that imports Warp is rewritten as it is
imported. In kernels, functions and structs of Warp the type `float` becomes `wp.float64`, and so does every number that
is written out or captured; `wp.float32`, `wp.vec3` and their like become those of 64 bits everywhere, native C++ lines
theirs, and so does the type `float` wherever host code hands it to Warp, as in `wp.zeros(n, dtype=float)`. In single
precision nothing is rewritten.

What a user's own module hands to the solver, such as a term, is not rewritten: there 64 bits are to be written out.
"""

from __future__ import annotations

import ast
import builtins
import linecache
import os
import re
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType, ModuleType
from typing import Any

VARIABLE = "FLUIDGYM_PRECISION"
PRECISIONS = ("single", "double")

_PACKAGE = __name__.partition(".")[0]
_DECORATORS = ("kernel", "func", "func_native", "struct")

# What C++ calls differently at 64 bits: the type, numbers that end in f, functions that do.
_NATIVE_TYPE = re.compile(r"\bfloat\b")
_NATIVE_NUMBER = re.compile(r"(?<![\w.])((?:\d+\.\d*|\.\d+|\d+(?=e))(?:e[+-]?\d+)?)f\b", re.IGNORECASE)
_NATIVE_FUNCTION = re.compile(
    r"\b(sqrt|cbrt|floor|ceil|round|trunc|fabs|fmod|fmin|fmax|fma|pow|exp|exp2|expm1|log|log2|log10|log1p"
    r"|sin|cos|tan|asin|acos|atan|atan2|sinh|cosh|tanh|hypot|copysign)f(?=\s*\()"
)

_state = {"chosen": os.environ.get(VARIABLE, PRECISIONS[0])}


def chosen() -> str:
    """The precision of this process, "single" or "double".

    Raises:
        ValueError: The environment variable names another.
    """
    if _state["chosen"] not in PRECISIONS:
        raise ValueError(f"{VARIABLE} = {_state['chosen']!r} is unknown; use single or double, or unset it")
    return _state["chosen"]


def choose(precision: str) -> None:
    """Choose the precision of this process, over the environment variable.

    Raises:
        ValueError: There is no such precision, or device code was imported in the other one.
    """
    if precision not in PRECISIONS:
        raise ValueError(f"precision = {precision!r} is unknown; use single or double")
    if precision != _state["chosen"] and _loaded():
        raise ValueError(
            f"precision = {precision!r} comes too late, as this process has loaded kernels in {_state['chosen']}"
            f" precision; set {VARIABLE}={precision} before it starts"
        )
    _state["chosen"] = precision
    install()


def install() -> None:
    """Rewrite device code that is imported from now on, unless the precision is single."""
    sys.meta_path[:] = [finder for finder in sys.meta_path if not isinstance(finder, _Finder)]
    if _state["chosen"] != PRECISIONS[0]:
        sys.meta_path.insert(0, _Finder())


def real(value: float) -> Any:
    """A number as a Warp function takes it that is called from Python."""
    return _to_double(float(value)) if chosen() == "double" else float(value)


def _loaded() -> bool:
    """Whether any module of this package has imported Warp."""
    warp = sys.modules.get("warp")
    modules = [module for name, module in list(sys.modules.items()) if name.startswith(f"{_PACKAGE}.")]
    return warp is not None and any(vars(module).get("wp") is warp for module in modules)


# -- the import -----------------------------------------------------------------------------------------------------


class _Finder:
    """Finds the modules of this package, to be rewritten."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not name.startswith(f"{_PACKAGE}."):
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is None or type(spec.loader) is not SourceFileLoader:
            return None
        loader = _Loader(name, spec.loader.path)
        if loader.has_device_code(name):
            chosen()  # refuses what is neither; only here, so that the command line can say it in one line
            spec.loader = loader
        return spec


class _Loader(SourceFileLoader):
    """Loads a module with device code in double precision. What it compiles is not kept between runs."""

    def has_device_code(self, name: str) -> bool:
        return "import warp as wp" in (super().get_source(name) or "")

    def get_source(self, fullname: str) -> str:
        return in_double(super().get_source(fullname) or "")

    def get_code(self, fullname: str) -> CodeType:
        # Warp reads the source of its functions. This is not what the file has, so it goes by a name of its own.
        source, name = self.get_source(fullname), f"{self.get_filename(fullname)} [double]"
        linecache.cache[name] = (len(source), None, source.splitlines(keepends=True), name)
        return compile(source, name, "exec", dont_inherit=True)

    def exec_module(self, module: ModuleType) -> None:
        helpers = (_to_double, _is_single, _native_in_double)
        vars(module).update({helper.__name__: helper for helper in helpers})
        super().exec_module(module)


# What rewritten modules call; their names are there before a module runs.


def _to_double(value: Any) -> Any:
    """A captured number as 64 bits; anything else as it is."""
    import warp as wp

    return wp.float64(value) if isinstance(value, float) else value


def _is_single(value: Any) -> bool:
    """Whether a captured value is a number that Warp would take for 32 bits."""
    return isinstance(value, float)


def _native_in_double(snippet: str) -> str:
    """Native C++ lines at 64 bits."""
    snippet = _NATIVE_NUMBER.sub(r"\1", _NATIVE_FUNCTION.sub(r"\1", snippet))
    return _NATIVE_TYPE.sub("double", snippet)


# -- the source -----------------------------------------------------------------------------------------------------


def in_double(source: str) -> str:
    """The source of a module that imports Warp as `wp`, in double precision."""
    return ast.unparse(ast.fix_missing_locations(_Host().visit(ast.parse(source))))


def _is_warp(node: ast.AST, names: Sequence[str] | None = None) -> bool:
    """Whether a node is wp.NAME, for any name or one of those given; or something of that, as in wp.types.vector."""
    if names is None and isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute):
        return _is_warp(node.value)
    return (
        isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "wp"
        and (names is None or node.attr in names)
    )


def _is_device(node: ast.FunctionDef | ast.ClassDef) -> bool:
    """Whether a function or class is one of Warp's."""
    called = [item.func if isinstance(item, ast.Call) else item for item in node.decorator_list]
    return any(_is_warp(item, _DECORATORS) for item in called)


def _root(node: ast.expr) -> str | None:
    """The name that a chain of attributes begins with; None where it begins with something else."""
    while isinstance(node, ast.Attribute):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


def _call(name: str | ast.expr, *arguments: ast.expr) -> ast.Call:
    function = ast.Name(name, ast.Load()) if isinstance(name, str) else name
    return ast.Call(function, list(arguments), [])


def _warp(name: str) -> ast.Attribute:
    return ast.Attribute(ast.Name("wp", ast.Load()), name, ast.Load())


class _Types(ast.NodeTransformer):
    """What names a type: an annotation of a device function, or what host code hands to Warp."""

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return _warp("float64") if node.id == "float" else node

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        return _wider(node) or node


def _wider(node: ast.Attribute) -> ast.expr | None:
    """A type of Warp, wp.float32 or wp.vec3, at 64 bits; None for all else."""
    import warp as wp

    if not _is_warp(node):
        return None
    if node.attr == "float32":
        return _warp("float64")
    short, twin = node.attr.removesuffix("f"), f"{node.attr.removesuffix('f')}d"
    single = isinstance(getattr(wp, short, None), type) and isinstance(getattr(wp, twin, None), type)
    return _warp(twin) if single else None


class _Host(ast.NodeTransformer):
    """Host code of a module: only what has to do with Warp changes."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        if not _is_device(node):
            return self.generic_visit(node)
        node.decorator_list = [self._decorator(item) for item in node.decorator_list]
        own = {argument.arg for argument in ast.walk(node.args) if isinstance(argument, ast.arg)}
        own |= {name.id for name in ast.walk(node) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)}
        node.args = _Types().visit(node.args)
        node.returns = node.returns and _Types().visit(node.returns)
        body = _Body(own)
        # What a statement becomes may be another one, but never none.
        node.body = [body.visit(statement) for statement in node.body]
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        return _Types().generic_visit(node) if _is_device(node) else self.generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        return _wider(node) or self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        ours = _is_warp(node.func)
        self.generic_visit(node)
        if ours:
            node.args = [self._type(argument) for argument in node.args]
            for keyword in node.keywords:
                keyword.value = self._type(keyword.value)
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        return _Types().generic_visit(node) if _is_warp(node.value) else self.generic_visit(node)

    def _type(self, node: ast.expr) -> ast.expr:
        return _Types().visit(node) if isinstance(node, ast.Name) else node

    def _decorator(self, node: ast.expr) -> ast.expr:
        if isinstance(node, ast.Call) and _is_warp(node.func, ("func_native",)):
            node.args = [_call(_native_in_double.__name__, snippet) for snippet in node.args]
            for keyword in node.keywords:
                if keyword.arg and keyword.arg.endswith("snippet"):
                    keyword.value = _call(_native_in_double.__name__, keyword.value)
        return self.visit(node)


class _Body(ast.NodeTransformer):
    """The body of a device function.

    A captured name may be a number, a vector, a type or a function. Only Warp, which has the value, can tell: it
    evaluates wp.static(...) when it builds the function.
    """

    def __init__(self, own: set[str]):
        self._own = own

    def _captured(self, node: ast.expr) -> bool:
        root = _root(node)
        return root is not None and root != "wp" and root not in self._own and not hasattr(builtins, root)

    def _static(self, node: ast.expr, function: Any = _to_double) -> ast.Call:
        return _call(_warp("static"), _call(function.__name__, node))

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        return _call(_warp("float64"), node) if isinstance(node.value, float) else node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id == "float":
            return _warp("float64")
        return self._static(node) if self._captured(node) else node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        import warp as wp

        if _is_warp(node):
            number = isinstance(getattr(wp, node.attr, None), float)  # wp.pi and the like
            return _call(_warp("float64"), node) if number else _wider(node) or node
        if self._captured(node):
            return self._static(node)
        return self.generic_visit(node) if _root(node) is None else node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        if _root(node.value) is None:
            node.value = self.visit(node.value)
        elif _is_warp(node.value):
            return _Types().generic_visit(node)
        node.slice = self.visit(node.slice)
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if _is_warp(node.func, ("static",)):
            return self._static(_Host().visit(node.args[0]))
        if _root(node.func) is None:
            node.func = self.visit(node.func)
        else:
            node.func = _Types().visit(node.func)
        node.args = [self.visit(argument) for argument in node.args]
        for keyword in node.keywords:
            visitor = _Types() if keyword.arg == "dtype" else self
            keyword.value = visitor.visit(keyword.value)
        return node

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        # A function that is only named, for Warp to emit it; or a docstring.
        return node if isinstance(node.value, (ast.Name, ast.Constant)) else self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        value = node.value
        node.targets = [self.visit(target) for target in node.targets]
        if not (isinstance(value, ast.Name) and self._captured(value)):
            node.value = self.visit(value)
            return node
        # `best = FAR` makes a variable that a loop may change, `best = wp.static(FAR)` a constant that none may.
        wide = ast.Assign(node.targets, _call(_warp("float64"), value))
        return ast.If(self._static(value, _is_single), [wide], [node])

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = _Types().visit(node.annotation)
        node.value = node.value and self.visit(node.value)
        return node
