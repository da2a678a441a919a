"""The pair loop: sums of terms over the neighbours of a place, as fast as the compiler can make them.

The physics is in plain Warp functions of one pair (terms.py). Here they are called from a few native lines that run
over one row of cells at a time, because LLVM turns that loop into vector instructions where it does not for the same
loop in plain Warp. Two rules keep it so: the lanes of a block read neighbouring numbers (records.py), and the loop adds
up scalars. A plain Warp twin does the same sum; the tests hold one against the other.

Both sweeps share the loop. A query is a place X [m], a velocity U [m/s] and a field value a; each neighbour j meets it
with x = X - x_j, u = U - u_j and a_j + offset + tilt . x, the affine part being what a mirror image adds to the field.
In a force that part may not take a pressure below zero: a ceiling does not hold drops. A screened loop leaves out the
neighbours that a body hides. A leaning loop takes lean_j . x / (2 c_0^2) from the field as well, a half of what the
densities of two particles differ by where nothing is to be done about it (continuity.py).

Where threads come one after another, as on a CPU, half a loop is enough: i meets those after it in the order, adds to
its own sum and to theirs, and finds in its own what those before it have added. It knows where they are (neighbors.py):
to find rows sweep by sweep keeps a processor waiting for 15 % of a step. Mirror images are met likewise: what j is to
an image of i, i is to that of j, turned round.
"""

from functools import lru_cache

import warp as wp

from fluidgym.records import LANES, SUMS, fetch, place_on_cpu
from fluidgym.sph.constants import Constants
from fluidgym.sph.neighbors import Grid, rows_after, span_numbers
from fluidgym.sph.terms import Drag, Term, bound, total

_LANES = f"""
#if defined(__CUDA_ARCH__)
const int lanes = 1;
struct __align__(16) Four {{ float a, b, c, d; }};
#else
const int lanes = {LANES};
#endif
const float number[{LANES}] = {{{", ".join(f"{n}.0f" for n in range(LANES))}}};
"""


def _row_lines(dim: int, width: int) -> str:
    """Native lines that go through the rows: the sphere misses some, and of the others needs a part."""
    lines = [f"const int shift = world * grid.slack, first_cell = world * grid.stride, width = {width};"]
    for name, k in reversed((("y", 1), ("z", 2))[: dim - 1]):
        lines.append(f"int {name}_low = (int)((X[{k}] - reach - grid.lower[{k}]) * grid.inv_width[{k}]);")
        lines.append(f"if ({name}_low < 0) {name}_low = 0;")
        lines.append(f"int {name}_high = (int)((X[{k}] + reach - grid.lower[{k}]) * grid.inv_width[{k}]);")
        lines.append(f"if ({name}_high > grid.count[{k}] - 1) {name}_high = grid.count[{k}] - 1;")
        lines.append(f"for (int c{name} = {name}_low; c{name} <= {name}_high; ++c{name}) {{")
        lines.append(f"const float below_{name} = grid.lower[{k}] + c{name} * grid.width[{k}] - X[{k}];")
        lines.append(f"const float gap_{name} = {_gap(name, k)};")
    row = "(cz * grid.count[1] + cy)" if dim == 3 else "cy"
    lines.append(f"const float rest = reach * reach - gap_y * gap_y{' - gap_z * gap_z' * (dim == 3)};")
    lines.append(f"const int row = first_cell + {row} * grid.count[0];")
    return "\n".join([*lines, _ROW, _BLOCKS])


def _gap(name: str, k: int) -> str:
    """How far X is from a row whose lower side is so far above X."""
    return f"wp::max(wp::max(below_{name}, -below_{name} - grid.width[{k}]), 0.0f)"


def _span_lines(dim: int, width: int, of_images: bool) -> str:
    """Native lines that go through the spans of half a loop; a mirror image is out of reach of some, and has no others.

    It is farther from everything than what it shows.
    """
    rows = rows_after(dim)
    lines = [f"const int rows = {len(rows)}, width = {width};"]
    lines.append(f"const int* __restrict__ span = spans.data + i * {span_numbers(dim)};")
    if of_images:
        for n, name in enumerate("yz"[: dim - 1]):
            steps = ", ".join(f"{row[n]}.0f" for row in rows)
            lines.append(f"const float step_{name}[rows] = {{{steps}}};")
            lines.append(f"const float own_{name} = grid.lower[{n + 1}] - X[{n + 1}]")
            lines.append(f" + grid.width[{n + 1}] * span[2 * rows + {n}];")
    lines.append("for (int row = 0; row < rows; ++row) {")
    lines.append("const int first = span[2 * row], end = span[2 * row + 1];")
    if of_images:
        for n, name in enumerate("yz"[: dim - 1]):
            lines.append(f"const float below_{name} = own_{name} + grid.width[{n + 1}] * step_{name}[row];")
            lines.append(f"const float gap_{name} = {_gap(name, n + 1)};")
        gaps = " + ".join(f"gap_{name} * gap_{name}" for name in "yz"[: dim - 1])
        lines.append(f"if (({gaps} >= reach * reach) | (first >= end)) continue;")
    return "\n".join([*lines, _BLOCKS])


_ROW = """
if (rest <= 0.0f) continue;
const float chord = sqrtf(rest);
int x_low = (int)((X[0] - chord - grid.lower[0]) * grid.inv_width[0]);
int x_high = (int)((X[0] + chord - grid.lower[0]) * grid.inv_width[0]);
if (x_low < 0) x_low = 0;
if (x_high > grid.count[0] - 1) x_high = grid.count[0] - 1;
if (x_low > x_high) continue;
const int end = bounds.data[row + x_high + 1] + shift;
const int first = bounds.data[row + x_low] + shift;
"""

# What a block has besides the row is put out of reach: all that is summed vanishes beyond the support.
_BLOCKS = """
int block = first & -lanes;
float before = (float)(first - block), until = (float)(end - block);
for (; block < end; block += lanes, before -= (float)lanes, until -= (float)lanes) {
#if defined(__CUDA_ARCH__)
const int quads = (width + 3) / 4;
float record[4 * quads];
const Four* __restrict__ packed = reinterpret_cast<const Four*>(records.data) + block * quads;
#pragma unroll
for (int n = 0; n < quads; ++n) {
const Four four = packed[n];
record[4 * n] = four.a; record[4 * n + 1] = four.b; record[4 * n + 2] = four.c; record[4 * n + 3] = four.d;
}
#else
const float* __restrict__ record = records.data + block * width;
#endif
#if !defined(__CUDA_ARCH__)
#pragma clang loop vectorize(assume_safety) vectorize_width(8) interleave(disable)
#endif
for (int lane = 0; lane < lanes; ++lane) {
#if !defined(__CUDA_ARCH__)
#pragma clang fp reassociate(on) contract(fast)
#endif
const bool counts = lanes == 1 || ((number[lane] >= before) & (number[lane] < until));
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


def _part(part: int) -> str:
    """A component of the neighbour's record."""
    return f"record[{part} * lanes + lane]"


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
    weight: wp.Function | None,
    width: int,
    field_at: int,
    half: bool,
    central: bool,
    of_images: bool,
) -> str:
    """The native lines of one pair loop."""
    axes = range(dim)
    bodies, look = _screen_lines(dim, screen) if screen else ([], [])
    lines = [_LANES]
    for k in axes:
        lines.append(f"const float X{k} = X[{k}], U{k} = U[{k}], T{k} = tilt[{k}], S{k} = sign[{k}];")
    if leaning:
        lines.append("const float halved = 0.5f * c.inv_c_0_squared;")
    lines.append("const float far = 16.0f * c.support * c.support;")
    lines += bodies
    weighed = None if force or weight is None else 2 if of_images else 1
    parts = range(dim if force else 3)
    lines += [f"float sum{k}[lanes] = {{}};" for k in parts]
    if half:
        lines.append(f"float* __restrict__ own = sums.data + {place_on_cpu('i + world * grid.slack', 0, SUMS)};")
        lines += [f"const float from_before{k} = own[{k} * lanes];" for k in parts]
    lines.append(_span_lines(dim, width, of_images) if half else _row_lines(dim, width))
    lines += [f"const float x{k} = X{k} - {_part(k)}, u{k} = U{k} - {_part(dim + k)};" for k in axes]
    lines.append(f"const float b = {_part(field_at)};")
    lines += look
    products = [f"S{k} * x{k} * u{k}" if signed else f"x{k} * u{k}" for k in axes]
    tilts = [f"(T{k} - halved * {_part(2 * dim + 1 + k)})" if leaning else f"T{k}" for k in axes]
    chosen = "(counts & !hidden)" if screen else "counts"
    affine = "".join(["offset", *(f" + {tilts[k]} * x{k}" for k in axes)])
    field = "b"
    if tilted:
        lines.append(f"const float more = {affine};")
        field = "wp::max(b + more, wp::min(b, 0.0f))" if force else "b + more"
    lines += [
        f"const float r2 = {chosen} ? " + " + ".join(f"x{k} * x{k}" for k in axes) + " : far;",
        "const float xu = " + " + ".join(products) + ";",
        f"const float a_j = {field};",
        "const float r = sqrtf(r2);",
        f"const float w = {slope.native_func}(r, c);",
        f"const float f = {term.native_func}(r2, xu, w, a, a_j, c);",
    ]
    values = {k: f"f * x{k}" for k in axes} if force else {0: "f"}
    if weighed:
        lines.append(f"const float v = -{weight.native_func}(r, c);")
        values[weighed] = "v"
    if drag is not None:
        lines.append(f"const float d = {drag.native_func}(r2, xu, w, a, a_j, c);")
        values = {k: f"{value} + d * {f'S{k} * ' * signed}u{k}" for k, value in values.items()}
    lines += [f"sum{k}[lane] += {value};" for k, value in values.items()]
    if half:
        # As j sees it: x and u turned round. The affine part of the density's field is then the opposite, but for what
        # a central force makes of it, which is not linear; that of the force's is the other half of the walls' pull.
        bend = " - c.central_force * c.inv_c_0_squared * r2" if central else ""
        turned = "wp::max(a - offset, wp::min(a, 0.0f))" if force else f"a - more{bend}"
        lines.append(f"const float a_i = {turned if tilted else 'a'};")
        lines.append(f"const float f_j = {term.native_func}(r2, xu, w, b, a_i, c);")
        values = {k: f"f_j * x{k}" for k in axes} if force else {0: "f_j"}
        if weighed:
            values[weighed] = "v"
        if drag is not None:
            lines.append(f"const float d_j = {drag.native_func}(r2, xu, w, b, a_i, c);")
            values = {k: f"{value} + d_j * u{k}" for k, value in values.items()}
        for k, value in values.items():
            lines.append(f"sums.data[block * {SUMS} + {k} * lanes + lane] {'-' if force else '+'}= {value};")
    lines.append("}" * (3 if half else dim + 1))
    lines += [f"for (int lane = 1; lane < lanes; ++lane) sum{k}[0] += sum{k}[lane];" for k in parts]
    if half:
        # What i has just given to itself goes with the rest: the next loop begins at nothing.
        lines += [f"sum{k}[0] += from_before{k}; own[{k} * lanes] = 0.0f;" for k in parts]
    lines.append("return {" + ", ".join(f"sum{k}[0]" for k in parts) + "};")
    return "\n".join(lines)


@lru_cache
def make_pair_loop(
    dim: int,
    terms: tuple[Term, ...],
    slope: wp.Function,
    force: bool,
    width: int,
    tilted: bool = True,
    signed: bool = False,
    plain: bool = False,
    screen: tuple[bool, ...] = (),
    leaning: bool = False,
    weight: wp.Function | None = None,
    field_at: int | None = None,
    half: bool = False,
    central: bool = False,
    of_images: bool = False,
) -> tuple[wp.Function, wp.Function]:
    """The sum of terms over the neighbours of a place.

    Args:
        dim: Number of dimensions.
        terms: The physics: DensityRate, or Force and Drag.
        slope: Warp function (r, Constants) -> W'(r)/r.
        force: True returns the vector sum of f x + d u (dim,), d from the Drags; False the sum of f, and of what the
            particles weigh, and of what images weigh, of which a loop is about one.
        width: Number of parts of a record.
        tilted: Whether the affine part of the field is compiled in.
        signed: Whether each u_k is multiplied by sign[k] (no-slip images).
        plain: True makes the twin in plain Warp, the reference for tests.
        screen: For each body that may hide neighbours whether it is a ball; the others are boxes.
        leaning: Whether the accelerations, which then are the last parts of a record, are compiled in; it goes with
            `tilted`.
        weight: Warp function (r, Constants) -> what each neighbour weighs, the opposite of it; None is nothing.
        field_at: Which part of a record is the field; None is the one after the velocity.
        half: Whether each pair is met once, by the first of the two, whose own place X must be, or the mirror image of
            it, signs apart. Every live particle of a world must then be called for, in order; one is asked for itself
            first and for its images then.
        central: In half a loop: whether a central force bends the field.
        of_images: Whether the loop is about images.

    Returns:
        The loop (i, X, U, a, offset, tilt, sign, world, reach, records, bounds, grid, c, sums, spans) -> sum. Of use in
        half a loop only are i, the particle's slot; sums, what those before it have added (as many records as slots,
        zero at first, and left zero by all who read theirs); and spans, where it meets others (neighbors.py). With a
        further argument where there are bodies, the matrix of their middles and half sides (body, 2 dim). And a
        function (c) -> float that a kernel must name in a branch never taken, so that Warp writes the terms ahead of
        the native lines that call them.
    """
    vec = wp.types.vector(dim, wp.float32)
    result = vec if force else wp.vec3
    field_at = 2 * dim if field_at is None else field_at
    drags = tuple(bound(term, dim) for term in terms if isinstance(term, Drag))
    term = total(tuple(bound(term, dim) for term in terms if not isinstance(term, Drag)))
    drag = total(drags) if drags else None

    @wp.func
    def emit_terms(c: Constants) -> float:
        value = term(0.0, 0.0, slope(0.0, c), 0.0, 0.0, c)
        if wp.static(drag is not None):
            value += drag(0.0, 0.0, slope(0.0, c), 0.0, 0.0, c)
        if wp.static(weight is not None):
            value += weight(0.0, c)
        return value

    if plain:
        twin = _plain_loop(
            dim, term, drag, slope, force, tilted, signed, screen, leaning, weight, width, field_at, of_images
        )
        return twin, emit_terms

    snippet = _snippet(
        dim, term, drag, slope, force, tilted, signed, screen, leaning, weight, width, field_at, half, central,
        of_images,
    )  # fmt: skip
    if screen:
        Screens = wp.types.matrix((len(screen), 2 * dim), wp.float32)

        @wp.func_native(snippet)
        def screened_loop(
            i: int,
            X: vec,
            U: vec,
            a: float,
            offset: float,
            tilt: vec,
            sign: vec,
            world: int,
            reach: float,
            records: wp.array[float],
            bounds: wp.array[int],
            grid: Grid,
            c: Constants,
            sums: wp.array[float],
            spans: wp.array[int],
            screens: Screens,
        ) -> result: ...

        return screened_loop, emit_terms

    @wp.func_native(snippet)
    def pair_loop(
        i: int,
        X: vec,
        U: vec,
        a: float,
        offset: float,
        tilt: vec,
        sign: vec,
        world: int,
        reach: float,
        records: wp.array[float],
        bounds: wp.array[int],
        grid: Grid,
        c: Constants,
        sums: wp.array[float],
        spans: wp.array[int],
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
    weight: wp.Function | None,
    width: int,
    field_at: int,
    of_images: bool,
) -> wp.Function:
    """The pair loop in plain Warp: every particle of every cell within reach, no rows cut."""
    vec = wp.types.vector(dim, wp.float32)
    result = vec if force else wp.vec3
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
        i: int,
        X: vec,
        U: vec,
        a: float,
        offset: float,
        tilt: vec,
        sign: vec,
        world: int,
        reach: float,
        records: wp.array[float],
        bounds: wp.array[int],
        grid: Grid,
        c: Constants,
        sums: wp.array[float],
        spans: wp.array[int],
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
                    cell = world * grid.stride + (cz * grid.count[1] + cy) * grid.count[0] + cx
                    for j in range(bounds[cell], bounds[cell + 1]):
                        x = vec()
                        u = vec()
                        xu = float(0.0)
                        k_j = j + world * grid.slack
                        a_j = fetch(records, k_j, wp.static(field_at), wp.static(width))
                        lowest = wp.min(a_j, 0.0)
                        if wp.static(tilted):
                            a_j += offset
                        seen = bool(True)
                        for k in range(wp.static(dim)):
                            x[k] = X[k] - fetch(records, k_j, k, wp.static(width))
                            u[k] = U[k] - fetch(records, k_j, wp.static(dim) + k, wp.static(width))
                            if wp.static(signed):
                                u[k] *= sign[k]
                            xu += x[k] * u[k]
                            if wp.static(tilted):
                                a_j += tilt[k] * x[k]
                            if wp.static(leaning):
                                lean = fetch(records, k_j, wp.static(2 * dim + 1) + k, wp.static(width))
                                a_j -= 0.5 * c.inv_c_0_squared * lean * x[k]
                        if wp.static(force and tilted):
                            a_j = wp.max(a_j, lowest)
                        if wp.static(len(screen) > 0):
                            seen = not hides(X, x, screens, c)
                        r = wp.length(x)
                        w = slope(r, c)
                        f = term(r * r, xu, w, a, a_j, c)
                        if seen:
                            if wp.static(force):
                                sum += f * x
                                if wp.static(drag is not None):
                                    sum += drag(r * r, xu, w, a, a_j, c) * u
                            else:
                                sum[0] += f
                                if wp.static(weight is not None):
                                    sum[wp.static(2 if of_images else 1)] -= weight(r, c)
        return sum

    if screen:
        return sum_over_pairs

    @wp.func
    def pair_loop(
        i: int,
        X: vec,
        U: vec,
        a: float,
        offset: float,
        tilt: vec,
        sign: vec,
        world: int,
        reach: float,
        records: wp.array[float],
        bounds: wp.array[int],
        grid: Grid,
        c: Constants,
        sums: wp.array[float],
        spans: wp.array[int],
    ) -> result:
        return sum_over_pairs(
            i, X, U, a, offset, tilt, sign, world, reach, records, bounds, grid, c, sums, spans, Screens()
        )

    return pair_loop
