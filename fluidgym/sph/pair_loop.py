"""The pair loop: sums of terms over the neighbours of a place, as fast as the compiler can make them.

The physics is in plain Warp functions of one pair (terms.py). Here they are called from a few native lines that run
over one row of cells at a time, because LLVM turns that loop into vector instructions where it does not for the same
loop in plain Warp. Two rules keep it so: arrays hold one component each, and the loop adds up scalars. A plain Warp
twin does the same sum; the tests hold one against the other.

Both sweeps share the loop. A query is a place X [m], a velocity U [m/s] and a field value a; each neighbour j meets it
with x = X - x_j, u = U - u_j and a_j + offset + tilt . x, the affine part being what a mirror image adds to the field.
In a force that part may not take a pressure below zero: a ceiling does not hold drops. A screened loop leaves out the
neighbours that a body hides. A leaning loop takes lean_j . x / (2 c_0^2) from it as well, a half of what the densities
of two particles differ by where nothing is to be done about it (continuity.py).
"""

from functools import lru_cache

import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.neighbors import Grid
from fluidgym.sph.terms import Drag, Term, bound, total
from fluidgym.state import PADDING

# On a CPU a row is taken in blocks of eight lanes, each lane with sums of its own: what a block reads past its row is
# computed and not counted, so that there is no tail to run one by one. Arrays are padded for the last block.
LANES = 8
assert LANES <= PADDING

_LANES = f"""
#if defined(__CUDA_ARCH__)
const int lanes = 1;
#else
const int lanes = {LANES};
#endif
"""

# One row after another: rows the sphere misses are passed over, the others cut to the x that the sphere needs.
_ROWS_3D = """
int z_low = (int)floorf((X[2] - reach - grid.lower[2]) * grid.inv_width[2]);
int z_high = (int)floorf((X[2] + reach - grid.lower[2]) * grid.inv_width[2]);
if (z_low < 0) z_low = 0;
if (z_high > grid.count[2] - 1) z_high = grid.count[2] - 1;
for (int cz = z_low; cz <= z_high; ++cz) {
const float z_cell = grid.lower[2] + cz * grid.width[2];
const float gap_z = wp::max(wp::max(z_cell - X[2], X[2] - z_cell - grid.width[2]), 0.0f);
"""

_ROWS = """
int y_low = (int)floorf((X[1] - reach - grid.lower[1]) * grid.inv_width[1]);
int y_high = (int)floorf((X[1] + reach - grid.lower[1]) * grid.inv_width[1]);
if (y_low < 0) y_low = 0;
if (y_high > grid.count[1] - 1) y_high = grid.count[1] - 1;
for (int cy = y_low; cy <= y_high; ++cy) {
const float y_cell = grid.lower[1] + cy * grid.width[1];
const float gap_y = wp::max(wp::max(y_cell - X[1], X[1] - y_cell - grid.width[1]), 0.0f);
const float rest = reach * reach - gap_y * gap_y - gap_z * gap_z;
if (rest <= 0.0f) continue;
const float half = sqrtf(rest);
int x_low = (int)floorf((X[0] - half - grid.lower[0]) * grid.inv_width[0]);
int x_high = (int)floorf((X[0] + half - grid.lower[0]) * grid.inv_width[0]);
if (x_low < 0) x_low = 0;
if (x_high > grid.count[0] - 1) x_high = grid.count[0] - 1;
if (x_low > x_high) continue;
const int row = first_cell + (cz * grid.count[1] + cy) * grid.count[0];
const int end = bounds.data[row + x_high + 1];
for (int block = bounds.data[row + x_low]; block < end; block += lanes)
#if !defined(__CUDA_ARCH__)
#pragma clang loop vectorize(enable) vectorize_width(8) interleave(disable)
#endif
for (int lane = 0; lane < lanes; ++lane) {
#if !defined(__CUDA_ARCH__)
#pragma clang fp reassociate(on) contract(fast)
#endif
const int j = block + lane;
const bool counts = j < end;
"""


def _screen_lines(dim: int, balls: tuple[bool, ...]) -> tuple[list[str], list[str]]:
    """Native lines that fetch the bodies, and lines that find whether one lies between X and X - x."""
    axes = range(dim)
    before = [
        f"const float A{row}_{k} = X{k} - screens.data[{row}][{k}], H{row}_{k} = screens.data[{row}][{dim + k}];"
        for row in range(len(balls))
        for k in axes
    ]
    lines = ["bool hidden = false;", "const float x_x = 1e-20f + " + " + ".join(f"x{k} * x{k}" for k in axes) + ";"]
    # The line is X - t x with t in 0 .. 1. A box is between where all its slabs overlap, and hides where the line goes
    # in and out by opposite sides; a ball is between where it comes near, and hides if it is small.
    lines += [f"const float n{k} = 1.0f / x{k};" for k in axes if not all(balls)]
    for row, ball in enumerate(balls):
        if ball:
            along = " + ".join(f"A{row}_{k} * x{k}" for k in axes)
            lines.append(f"const float t{row} = wp::min(wp::max(({along}) / x_x, 0.0f), 1.0f);")
            gaps = [f"(A{row}_{k} - t{row} * x{k})" for k in axes]
            lines.append(f"hidden |= ({' + '.join(f'{gap} * {gap}' for gap in gaps)} < H{row}_0 * H{row}_0)")
            lines.append(f"& (2.0f * H{row}_0 < c.support);")
            continue
        near, far = [], []
        for k in axes:
            lines.append(f"const float p{row}_{k} = (A{row}_{k} - H{row}_{k}) * n{k};")
            lines.append(f"const float q{row}_{k} = (A{row}_{k} + H{row}_{k}) * n{k};")
            near.append(f"wp::min(p{row}_{k}, q{row}_{k})")
            far.append(f"wp::max(p{row}_{k}, q{row}_{k})")
        first, last = near[0], far[0]
        for k in axes[1:]:
            first, last = f"wp::max({first}, {near[k]})", f"wp::min({last}, {far[k]})"
        lines.append(f"const float i{row} = {first}, o{row} = {last};")
        through = " | ".join(f"(({a} == i{row}) & ({b} == o{row}))" for a, b in zip(near, far, strict=True))
        lines.append(f"hidden |= (i{row} < o{row}) & (o{row} > 0.0f) & (i{row} < 1.0f) & ({through});")
    return before, lines


def _snippet(
    dim: int,
    term: wp.Function,
    drag: wp.Function | None,
    slope: wp.Function,
    force: bool,
    tilted: bool,
    signed: bool,
    screen: tuple[bool, ...],
    leaning: bool,
    weight: wp.Function,
) -> str:
    """The native lines of one pair loop."""
    axes = range(dim)
    fetch, look = _screen_lines(dim, screen) if screen else ([], [])
    lines = [_LANES]
    for k in axes:
        lines += [
            f"const float* __restrict__ px{k} = position.data + {k} * position.shape[1];",
            f"const float* __restrict__ pu{k} = velocity.data + {k} * velocity.shape[1];",
            f"const float X{k} = X[{k}], U{k} = U[{k}], T{k} = tilt[{k}], S{k} = sign[{k}];",
        ]
    lines.append("const float* __restrict__ pa = field.data;")
    if leaning:
        lines += [f"const float* __restrict__ pl{k} = lean.data + {k} * lean.shape[1];" for k in axes]
        lines.append("const float halved = 0.5f * c.inv_c_0_squared;")
    lines += fetch
    names = [f"sum{k}" for k in (axes if force else range(2))]
    lines += [f"float {name}[lanes] = {{}};" for name in names]
    lines.append(_ROWS_3D if dim == 3 else "const int cz = 0; const float gap_z = 0.0f;")
    lines.append(_ROWS)
    lines += [f"const float x{k} = X{k} - px{k}[j], u{k} = U{k} - pu{k}[j];" for k in axes]
    lines += look
    products = [f"S{k} * x{k} * u{k}" if signed else f"x{k} * u{k}" for k in axes]
    tilts = [f"(T{k} - halved * pl{k}[j])" if leaning else f"T{k}" for k in axes]
    affine = "".join(["pa[j] + offset", *(f" + {tilts[k]} * x{k}" for k in axes)])
    field = "pa[j]" if not tilted else f"wp::max({affine}, wp::min(pa[j], 0.0f))" if force else affine
    lines += [
        "const float r2 = " + " + ".join(f"x{k} * x{k}" for k in axes) + ";",
        "const float xu = " + " + ".join(products) + ";",
        f"const float a_j = {field};",
        "const float r = sqrtf(r2);",
        f"const float w = {slope.native_func}(r, c);",
        f"const float f = {term.native_func}(r, xu, w, a, a_j, c);",
    ]
    values = [f"f * x{k}" for k in axes] if force else ["f", f"-{weight.native_func}(r, c)"]
    if drag is not None:
        lines.append(f"const float d = {drag.native_func}(r, xu, w, a, a_j, c);")
        values = [f"{value} + d * {f'S{k} * ' * signed}u{k}" for k, value in enumerate(values)]
    chosen = "(counts & !hidden)" if screen else "counts"
    lines += [f"{name}[lane] += {chosen} ? {value} : 0.0f;" for name, value in zip(names, values, strict=True)]
    lines.append("}" * dim)
    lines += [f"for (int lane = 1; lane < lanes; ++lane) {name}[0] += {name}[lane];" for name in names]
    lines.append("return {" + ", ".join(f"{name}[0]" for name in names) + "};")
    return "\n".join(lines)


@lru_cache
def make_pair_loop(
    dim: int,
    terms: tuple[Term, ...],
    slope: wp.Function,
    force: bool,
    tilted: bool = True,
    signed: bool = False,
    plain: bool = False,
    screen: tuple[bool, ...] = (),
    leaning: bool = False,
    weight: wp.Function | None = None,
) -> tuple[wp.Function, wp.Function]:
    """The sum of terms over the neighbours of a place.

    Args:
        dim: Number of dimensions.
        terms: The physics: DensityRate, or Force and Drag.
        slope: Warp function (r, Constants) -> W'(r)/r.
        force: True returns the vector sum of f x + d u (dim,), d from the Drags; False (sum of f, sum of -weight).
        tilted: Whether the affine part of the field is compiled in.
        signed: Whether each u_k is multiplied by sign[k] (no-slip images).
        plain: True makes the twin in plain Warp, the reference for tests.
        screen: For each body that may hide neighbours whether it is a ball; the others are boxes.
        leaning: Whether the accelerations `lean` are compiled in; it goes with `tilted`.
        weight: Warp function (r, Constants) -> what each neighbour weighs in the second sum; None is `slope`.

    Returns:
        The loop (X, U, a, offset, tilt, sign, first_cell, reach, position, velocity, field, lean, bounds, grid, c) ->
        sum, where a loop that does not lean leaves lean unread (hand it any array), with a further argument where there
        are bodies, the matrix of their middles and half sides (body, 2 dim); and a function (c) -> float that a kernel
        must name in a branch never taken, so that Warp writes the terms ahead of the native lines that call them.
    """
    vec = wp.types.vector(dim, wp.float32)
    result = vec if force else wp.vec2
    weight = weight or slope
    drags = tuple(bound(term, dim) for term in terms if isinstance(term, Drag))
    term = total(tuple(bound(term, dim) for term in terms if not isinstance(term, Drag)))
    drag = total(drags) if drags else None

    @wp.func
    def emit_terms(c: Constants) -> float:
        value = term(0.0, 0.0, slope(0.0, c), 0.0, 0.0, c)
        if wp.static(drag is not None):
            value += drag(0.0, 0.0, slope(0.0, c), 0.0, 0.0, c)
        return value + weight(0.0, c)

    if plain:
        return _plain_loop(dim, term, drag, slope, force, tilted, signed, screen, leaning, weight), emit_terms

    snippet = _snippet(dim, term, drag, slope, force, tilted, signed, screen, leaning, weight)
    if screen:
        Screens = wp.types.matrix((len(screen), 2 * dim), wp.float32)

        @wp.func_native(snippet)
        def screened_loop(
            X: vec,
            U: vec,
            a: float,
            offset: float,
            tilt: vec,
            sign: vec,
            first_cell: int,
            reach: float,
            position: wp.array2d[float],
            velocity: wp.array2d[float],
            field: wp.array[float],
            lean: wp.array2d[float],
            bounds: wp.array[int],
            grid: Grid,
            c: Constants,
            screens: Screens,
        ) -> result: ...

        return screened_loop, emit_terms

    @wp.func_native(snippet)
    def pair_loop(
        X: vec,
        U: vec,
        a: float,
        offset: float,
        tilt: vec,
        sign: vec,
        first_cell: int,
        reach: float,
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        field: wp.array[float],
        lean: wp.array2d[float],
        bounds: wp.array[int],
        grid: Grid,
        c: Constants,
    ) -> result: ...

    return pair_loop, emit_terms


def _plain_loop(
    dim: int,
    term: wp.Function,
    drag: wp.Function | None,
    slope: wp.Function,
    force: bool,
    tilted: bool,
    signed: bool,
    screen: tuple[bool, ...],
    leaning: bool,
    weight: wp.Function,
) -> wp.Function:
    """The pair loop in plain Warp: every particle of every cell within reach, no rows cut."""
    vec = wp.types.vector(dim, wp.float32)
    result = vec if force else wp.vec2
    Screens = wp.types.matrix((max(len(screen), 1), 2 * dim), wp.float32)
    balls = wp.int32(sum(bool(ball) << row for row, ball in enumerate(screen)))

    @wp.func
    def hides(X: vec, x: vec, screens: Screens, c: Constants) -> bool:
        """Whether a body comes between X and X - x."""
        hidden = bool(False)
        for row in range(wp.static(len(screen))):
            if (balls >> row) & 1 != 0:
                A = vec()
                for k in range(wp.static(dim)):
                    A[k] = X[k] - screens[row, k]
                t = wp.clamp(wp.dot(A, x) / (wp.dot(x, x) + 1.0e-20), 0.0, 1.0)
                if (
                    wp.length(A - t * x) < screens[row, wp.static(dim)]
                    and 2.0 * screens[row, wp.static(dim)] < c.support
                ):
                    hidden = True
            else:
                side_in = int(0)
                side_out = int(0)
                t_in = float(-1.0e30)
                t_out = float(1.0e30)
                for k in range(wp.static(dim)):
                    A_k = X[k] - screens[row, k]
                    t_1 = (A_k - screens[row, wp.static(dim) + k]) / x[k]
                    t_2 = (A_k + screens[row, wp.static(dim) + k]) / x[k]
                    if wp.min(t_1, t_2) > t_in:
                        t_in = wp.min(t_1, t_2)
                        side_in = k
                    if wp.max(t_1, t_2) < t_out:
                        t_out = wp.max(t_1, t_2)
                        side_out = k
                if t_in < t_out and t_out > 0.0 and t_in < 1.0 and side_in == side_out:
                    hidden = True
        return hidden

    @wp.func
    def sum_over_pairs(
        X: vec,
        U: vec,
        a: float,
        offset: float,
        tilt: vec,
        sign: vec,
        first_cell: int,
        reach: float,
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        field: wp.array[float],
        lean: wp.array2d[float],
        bounds: wp.array[int],
        grid: Grid,
        c: Constants,
        screens: Screens,
    ) -> result:
        low = wp.vec3i(0, 0, 0)
        high = wp.vec3i(0, 0, 0)
        for k in range(wp.static(dim)):
            low[k] = wp.max(int(wp.floor((X[k] - reach - grid.lower[k]) * grid.inv_width[k])), 0)
            high[k] = wp.min(int(wp.floor((X[k] + reach - grid.lower[k]) * grid.inv_width[k])), grid.count[k] - 1)
        sum = result()
        for cz in range(low[2], high[2] + 1):
            for cy in range(low[1], high[1] + 1):
                for cx in range(low[0], high[0] + 1):
                    cell = first_cell + (cz * grid.count[1] + cy) * grid.count[0] + cx
                    for j in range(bounds[cell], bounds[cell + 1]):
                        x = vec()
                        u = vec()
                        xu = float(0.0)
                        a_j = field[j]
                        lowest = wp.min(a_j, 0.0)
                        if wp.static(tilted):
                            a_j += offset
                        seen = bool(True)
                        for k in range(wp.static(dim)):
                            x[k] = X[k] - position[k, j]
                            u[k] = U[k] - velocity[k, j]
                            if wp.static(signed):
                                u[k] *= sign[k]
                            xu += x[k] * u[k]
                            if wp.static(tilted):
                                a_j += tilt[k] * x[k]
                            if wp.static(leaning):
                                a_j -= 0.5 * c.inv_c_0_squared * lean[k, j] * x[k]
                        if wp.static(force and tilted):
                            a_j = wp.max(a_j, lowest)
                        if wp.static(len(screen) > 0):
                            seen = not hides(X, x, screens, c)
                        r = wp.length(x)
                        w = slope(r, c)
                        f = term(r, xu, w, a, a_j, c)
                        if seen:
                            if wp.static(force):
                                sum += f * x
                                if wp.static(drag is not None):
                                    sum += drag(r, xu, w, a, a_j, c) * u
                            else:
                                sum += wp.vec2(f, -weight(r, c))
        return sum

    if screen:
        return sum_over_pairs

    @wp.func
    def pair_loop(
        X: vec,
        U: vec,
        a: float,
        offset: float,
        tilt: vec,
        sign: vec,
        first_cell: int,
        reach: float,
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        field: wp.array[float],
        lean: wp.array2d[float],
        bounds: wp.array[int],
        grid: Grid,
        c: Constants,
    ) -> result:
        return sum_over_pairs(
            X, U, a, offset, tilt, sign, first_cell, reach, position, velocity, field, lean, bounds, grid, c, Screens()
        )

    return pair_loop
