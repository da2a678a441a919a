"""All rays from a particle to one side of a body at once: in the lanes of a CPU, eight to a vector register.

bodies.py says what the rays are for, and has them one by one, in plain Warp; that is what a GPU runs, and what the
tests hold these native lines against. They spare themselves what does not turn into vector instructions: sines of
polynomials, no branch but a choice.
"""

from collections.abc import Sequence
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import warp as wp

from fluidgym.sph.constants import Constants

# Bodies this near to each other or to a wall, over the reach of the kernel, touch.
TOUCH = 1.0e-3

# A loop over lanes, and how its sums may be taken.
_LOOP = """
#pragma clang loop vectorize(assume_safety) vectorize_width(8) interleave(disable)
for (int lane = 0; lane < lanes; ++lane) {
#pragma clang fp reassociate(on) contract(fast)
"""

# Sine and cosine of an angle within a right angle, by Taylor's series: to 6e-8. In double precision, those of the
# library; what is not used leaves no code.
_SINE = """
const float {0}_2 = {0} * {0};
const float sine_{0} = sizeof(float) > 4 ? sinf({0}) : {0} * (1.0f + {0}_2 * (-1.6666667e-1f
    + {0}_2 * (8.3333333e-3f + {0}_2 * (-1.9841270e-4f + {0}_2 * (2.7557319e-6f - {0}_2 * 2.5052108e-8f)))));
const float cosine_{0} = sizeof(float) > 4 ? cosf({0}) : 1.0f + {0}_2 * (-0.5f + {0}_2 * (4.1666667e-2f
    + {0}_2 * (-1.3888889e-3f + {0}_2 * (2.4801587e-5f + {0}_2 * (-2.7557319e-7f + {0}_2 * 2.0876757e-9f)))));
"""

# Arc tangent (Abramowitz & Stegun 1964, 4.4.49, after one halving of the angle): to 1e-7.
_ARC = """
const float halved_{0} = {0} / (1.0f + sqrtf(1.0f + {0} * {0}));
const float square_{0} = halved_{0} * halved_{0};
const float arc_{0} = sizeof(float) > 4 ? atanf({0}) : 2.0f * halved_{0} * (1.0f
    + square_{0} * (-0.3333314528f + square_{0} * (0.1999355085f
    + square_{0} * (-0.1420889944f + square_{0} * (0.1065626393f + square_{0} * (-0.0752896400f
    + square_{0} * (0.0429096138f + square_{0} * (-0.0161657367f + square_{0} * 0.0028662257f))))))));
"""


def _table(name: str, values: Sequence[float] | np.ndarray) -> str:
    return f"const float {name}[{len(values)}] = {{{', '.join(f'{value:.17e}f' for value in values)}}};"


def _type(rows: int, columns: int) -> str:
    return f"wp::mat_t<{rows}, {columns}, float>"


@lru_cache
def make_fans(dim: int, nodes: tuple[float, ...], shares: tuple[float, ...], nothing: float) -> SimpleNamespace:
    """Native functions that lay out the rays to a side.

    Args:
        dim: Number of dimensions.
        nodes: Where the rays are across the angle, on [0, 1].
        shares: Of the angle, beside them.
        nothing: Distance to what is not there [m].

    Returns:
        A namespace of Fan, a matrix type whose columns are rays and whose rows are the components of the direction, the
        distance to the surface [m], the end of what is filled [m], the share of the angle [rad or sr], and the
        components of the normal out of the body; to_box and to_ball, which make one; past_box and past_ball, which take
        from one what another body hides or fills.
    """
    vec = wp.types.vector(dim, wp.float32)
    lanes = len(nodes) ** (dim - 1)
    rows = 2 * dim + 3
    Fan = wp.types.matrix((rows, lanes), wp.float32)
    first = [f"const int lanes = {lanes};", f"{_type(rows, lanes)} fan;"]

    @wp.func_native("\n".join([*first, *_box_lines(dim, nodes, shares, nothing), "return fan;"]))
    def to_box(
        gap: float, side: float, axis: int, start: float, width: float, low: vec, high: vec, middle: vec, half: vec,
        reach: float,
    ) -> Fan: ...  # fmt: skip

    @wp.func_native("\n".join([*first, *_ball_lines(dim, nodes, shares, nothing), "return fan;"]))
    def to_ball(middle: vec, gap: float, radius: float, reach: float) -> Fan: ...

    past = [f"const int lanes = {lanes};"]

    @wp.func_native("\n".join([*past, *_past_lines(dim, nothing, ball=False), "return fan;"]))
    def past_box(fan: Fan, middle: vec, half: vec, earlier: bool, reach: float) -> Fan: ...

    @wp.func_native("\n".join([*past, *_past_lines(dim, nothing, ball=True), "return fan;"]))
    def past_ball(fan: Fan, middle: vec, radius: float, earlier: bool, reach: float) -> Fan: ...

    return SimpleNamespace(Fan=Fan, to_box=to_box, to_ball=to_ball, past_box=past_box, past_ball=past_ball)


def _box_lines(dim: int, nodes: Sequence[float], shares: Sequence[float], nothing: float) -> list[str]:
    """Equal steps of the angle, so that the solid angle is exact; then the way through the box along each ray.

    The axes are taken in turn from that of the side's normal, which the way through does not mind.
    """
    axes = range(dim)
    lines = [f"const int turned[3] = {{axis, (axis + 1) % {dim}, (axis + 2) % {dim}}};"]
    for k in axes:
        lines.append(f"const float Y{k} = middle[turned[{k}]], H{k} = half[turned[{k}]];")
        lines.append(f"float* __restrict__ e{k}_at = fan.data[turned[{k}]];")
        lines.append(f"float* __restrict__ n{k}_at = fan.data[{dim + 3} + turned[{k}]];")
    if dim == 2:
        lines += [_table("nodes", nodes), _table("shares", shares), _LOOP]
        lines += ["const float a = start + width * nodes[lane];", _SINE.format("a")]
        lines += ["const float e0 = -side * cosine_a, e1 = sine_a;", "const float share = width * shares[lane];"]
        lines.append("const float distance = gap / cosine_a;")
    else:
        n = len(nodes)
        lines += [_table("nodes", np.repeat(nodes, n)), _table("shares", np.outer(shares, shares).ravel())]
        lines.append(_table("columns", np.tile(nodes, n)))
        lines += ["const float L2 = low[turned[2]], M2 = high[turned[2]];", _LOOP]
        lines += ["const float a = start + width * nodes[lane];", _SINE.format("a")]
        lines.append("const float far = gap / cosine_a;")
        lines.append("const float across = sqrtf(wp::max(reach * reach - far * far, 0.0f));")
        for name, end in (("p", "wp::max(L2, -across)"), ("q", "wp::min(M2, across)")):
            lines += [f"const float {name} = {end} / far;", _ARC.format(name)]
        lines += ["const float b = arc_p + (arc_q - arc_p) * columns[lane];", _SINE.format("b")]
        lines.append("const float share = width * shares[lane] * wp::max(arc_q - arc_p, 0.0f) * cosine_b;")
        lines.append("const float e0 = -side * cosine_a * cosine_b, e1 = sine_a * cosine_b, e2 = sine_b;")
        lines.append("const float distance = far / cosine_b;")
    lines += [f"e{k}_at[lane] = e{k}; n{k}_at[lane] = {'side' if k == 0 else '0.0f'};" for k in axes]
    lines += _passage_lines(dim)
    lines.append("const float end = meets ? (through ? reach : leaves) : distance;")
    lines.append(f"fan.data[{dim}][lane] = distance < reach ? distance : {nothing:e}f;")
    lines.append(f"fan.data[{dim + 1}][lane] = wp::min(end, reach);")
    return [*lines, f"fan.data[{dim + 2}][lane] = share;", "}"]


def _passage_lines(dim: int) -> list[str]:
    """The way through a box H at Y from its middle along the unit vector e: whether and where, and by which sides."""
    lines, axes = [], range(dim)
    for k in axes:
        lines.append(f"const float v{k} = 1.0f / (wp::abs(e{k}) < 1e-20f ? 1e-20f : e{k});")
        lines.append(f"const float p{k} = (-H{k} - Y{k}) * v{k}, q{k} = (H{k} - Y{k}) * v{k};")
        lines.append(f"const float near{k} = wp::min(p{k}, q{k}), far{k} = wp::max(p{k}, q{k});")
    enters, leaves = "near0", "far0"
    for k in axes[1:]:
        enters, leaves = f"wp::max({enters}, near{k})", f"wp::min({leaves}, far{k})"
    through = " | ".join(f"((near{k} == enters) & (far{k} == leaves))" for k in axes)
    lines += [f"const float enters = {enters}, leaves = {leaves};", f"const bool through = {through};"]
    return [*lines, "const bool meets = (enters < leaves) & (leaves > 0.0f);"]


def _past_lines(dim: int, nothing: float, ball: bool) -> list[str]:
    """What another body leaves of each ray. Of two that begin at the same place the earlier one fills."""
    axes = range(dim)
    lines = [f"const float Y{k} = middle[{k}];" for k in axes]
    if not ball:
        lines += [f"const float H{k} = half[{k}];" for k in axes]
    lines += [f"const float skin = {TOUCH:e}f * reach;", _LOOP]
    lines += [f"const float e{k} = fan.data[{k}][lane];" for k in axes]
    lines += [f"const float hit = fan.data[{dim}][lane], end = fan.data[{dim + 1}][lane];"]
    if ball:
        lines.append(f"const float ye = {' + '.join(f'Y{k} * e{k}' for k in axes)};")
        lines.append(f"const float rest = ye * ye - ({' + '.join(f'Y{k} * Y{k}' for k in axes)}) + radius * radius;")
        lines.append("const float root = sqrtf(wp::max(rest, 0.0f)), enters = -ye - root, leaves = -ye + root;")
        lines.append("const bool meets = (rest > 0.0f) & (root > ye), through = 2.0f * radius < reach;")
    else:
        lines += _passage_lines(dim)
    # In front of this one; or beside it, and then only one of the two fills.
    lines.append("const bool met = meets & (hit < reach), tied = (wp::abs(enters - hit) < skin) & earlier;")
    lines.append("const bool before = (enters < hit - skin) | tied;")
    lines.append("const bool goes_on = met & !before & (enters <= end + skin) & (through | (leaves > end));")
    lines.append(f"fan.data[{dim}][lane] = (met & before & (enters > -0.5f * reach)) ? {nothing:e}f : hit;")
    lines.append(f"fan.data[{dim + 1}][lane] = goes_on ? (through ? reach : wp::min(leaves, reach)) : end;")
    return [*lines, "}"]


def _ball_lines(dim: int, nodes: Sequence[float], shares: Sequence[float], nothing: float) -> list[str]:
    """Equal steps of the angle about the ball's middle in which the surface is met."""
    n, axes = len(nodes), range(dim)
    lines = [f"const float I{k} = -middle[{k}] / gap;" for k in axes]
    lines.append("const float widest = radius / gap, small = 2.0f * radius < reach ? 1.0f : 0.0f;")
    if dim == 2:
        psi = (np.asarray(nodes) - 0.5) * np.pi
        lines.append(_table("shares", np.pi * np.asarray(shares) * np.cos(psi)))
    else:
        psi = np.repeat(0.5 * np.pi * np.asarray(nodes), n)
        phi = np.tile(2.0 * np.pi / n * (np.arange(n) + 0.5), n)
        ring = 0.5 * np.pi * np.repeat(shares, n) * 2.0 * np.pi / n
        lines += [_table("shares", ring * np.cos(psi)), _table("A", np.cos(phi)), _table("B", np.sin(phi))]
        # Two unit vectors across.
        lines.append("const int least = wp::abs(I0) < 0.6f ? 0 : 1;")
        lines.append("const float I_least = least == 0 ? I0 : I1;")
        lines += [f"float a{k} = (least == {k} ? 1.0f : 0.0f) - I_least * I{k};" for k in axes]
        lines.append("const float a_length = sqrtf(a0 * a0 + a1 * a1 + a2 * a2);")
        lines += [f"a{k} /= a_length;" for k in axes]
        for k, l, m in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            lines.append(f"const float b{k} = I{l} * a{m} - I{m} * a{l};")
    lines += [_table("sines", np.sin(psi)), _table("cosines", np.cos(psi)), _LOOP]
    lines.append("const float sine = widest * sines[lane], cosine = sqrtf(1.0f - sine * sine);")
    lines.append("const float distance = gap * cosine - radius * cosines[lane];")
    if dim == 2:
        lines += ["const float e0 = I0 * cosine - I1 * sine, e1 = I1 * cosine + I0 * sine;"]
        lines.append("const float share = shares[lane] * widest / cosine;")
    else:
        lines += [f"const float e{k} = cosine * I{k} + sine * (A[lane] * a{k} + B[lane] * b{k});" for k in axes]
        lines.append("const float share = shares[lane] * sine * widest / cosine;")
    for k in axes:
        lines.append(f"fan.data[{k}][lane] = e{k};")
        lines.append(f"fan.data[{dim + 3 + k}][lane] = (middle[{k}] + distance * e{k}) / radius;")
    lines.append("const float end = small > 0.0f ? reach : gap * cosine + radius * cosines[lane];")
    lines.append(f"fan.data[{dim}][lane] = distance < reach ? distance : {nothing:e}f;")
    lines.append(f"fan.data[{dim + 1}][lane] = wp::min(end, reach);")
    return [*lines, f"fan.data[{dim + 2}][lane] = share;", "}"]


def _point_lines(dim: int, nodes: Sequence[float], shares: Sequence[float], slope: wp.Function) -> list[str]:
    """The dummy points of a fan, one of each ray at a time: distance, share of a volume, slope of the kernel."""
    area = "r" if dim == 2 else "r * r"
    return [
        _table("nodes", nodes),
        _table("parts", shares),
        f"for (int m = 0; m < {len(nodes)}; ++m) {{",
        "const float node = nodes[m], part = parts[m] * inverse;",
        _LOOP,
        f"const float hit = fan.data[{dim}][lane];",
        "const bool met = hit < c.support;",
        f"const float depth = met ? fan.data[{dim + 1}][lane] - hit : 0.0f;",
        "const float r = met ? hit + depth * node : 4.0f * c.support, r2 = r * r;",
        f"const float volume = part * fan.data[{dim + 2}][lane] * depth * {area};",
        f"const float w = {slope.native_func}(r, c);",
    ]


@lru_cache
def make_density_fan(
    dim: int, Fan: type, term: wp.Function, slope: wp.Function, weight: wp.Function,
    nodes: tuple[float, ...], shares: tuple[float, ...],
) -> wp.Function:  # fmt: skip
    """What the dummy points of a fan add to the first sweep: native (fan, u, a, c) -> as make_density_sum, over V.

    u is the particle's velocity in the body's, mirrored by the points.
    """
    vec = wp.types.vector(dim, wp.float32)
    lanes = Fan._shape_[1]  # pyright: ignore[reportAttributeAccessIssue]
    closing = " + ".join(f"U{k} * fan.data[{k}][lane]" for k in range(dim))
    lines = [
        f"const int lanes = {lanes};",
        "const float inverse = 1.0f / c.volume;",
        "float rate[lanes] = {}, company[lanes] = {};",
        *(f"const float U{k} = 2.0f * u[{k}];" for k in range(dim)),
        *_point_lines(dim, nodes, shares, slope),
        f"const float xu = -r * ({closing});",
        f"rate[lane] += volume * {term.native_func}(r2, xu, w, a, a, c);",
        f"company[lane] -= volume * {weight.native_func}(r, c);",
        "} }",
        "for (int lane = 1; lane < lanes; ++lane) { rate[0] += rate[lane]; company[0] += company[lane]; }",
        "return {rate[0], 0.0f, company[0]};",
    ]

    @wp.func_native("\n".join(lines))
    def density_fan(fan: Fan, u: vec, a: float, c: Constants) -> wp.vec3: ...

    return density_fan


@lru_cache
def make_force_fan(
    dim: int, Fan: type, force: wp.Function, drag: wp.Function | None, slope: wp.Function, steepest: float,
    nodes: tuple[float, ...], shares: tuple[float, ...],
) -> wp.Function:  # fmt: skip
    """What the dummy points of a fan do to a particle: native (fan, u, pushed, a, g, sticky, c) -> vector, over V.

    u is the particle's velocity in the body's, pushed the body's acceleration; sticky says whether viscosity sees
    more of u than what is along the normal.
    """
    vec = wp.types.vector(dim, wp.float32)
    lanes = Fan._shape_[1]  # pyright: ignore[reportAttributeAccessIssue]
    axes = range(dim)

    def dot(a: str, b: str) -> str:
        return " + ".join(f"{a}{k} * {b}{k}" for k in axes)

    lines = [f"const int lanes = {lanes};", "const float inverse = 1.0f / c.volume;"]
    lines.append("float along[lanes] = {}, dragged[lanes] = {}, pull[lanes], closing[lanes];")
    lines += [f"float slip{k}[lanes], sum{k}[lanes];" for k in axes]
    lines += [f"const float U{k} = u[{k}], P{k} = pushed[{k}], G{k} = g[{k}];" for k in axes]
    lines.append(_LOOP)
    for k in axes:
        lines.append(f"const float e{k} = fan.data[{k}][lane], n{k} = fan.data[{dim + 3 + k}][lane];")
    # The fluid follows the body along its normal only, and so does the pressure.
    lines.append(f"pull[lane] = (({dot('G', 'e')}) - ({dot('P', 'n')}) * ({dot('n', 'e')})) * c.inv_c_0_squared;")
    lines.append(f"const float un = {dot('U', 'n')};")
    lines += [f"const float s{k} = sticky ? U{k} : un * n{k};" for k in axes]
    lines += [f"slip{k}[lane] = s{k};" for k in axes]
    lines += [f"closing[lane] = {dot('e', 's')};", "}"]
    lines += _point_lines(dim, nodes, shares, slope)
    lines.append(f"const float grown = wp::min(r / wp::max(hit, 1e-12f), {steepest:.3f}f);")
    lines.append("const float a_m = wp::max(a + pull[lane] * r, wp::min(a, 0.0f)), xu = -r * grown * closing[lane];")
    lines.append(f"along[lane] += volume * r * {force.native_func}(r2, xu, w, a, a_m, c);")
    if drag is not None:
        lines.append(f"dragged[lane] += volume * grown * {drag.native_func}(r2, xu, w, a, a_m, c);")
    lines += ["} }", _LOOP]
    lines += [f"sum{k}[lane] = dragged[lane] * slip{k}[lane] - along[lane] * fan.data[{k}][lane];" for k in axes]
    lines.append("}")
    lines += [f"for (int lane = 1; lane < lanes; ++lane) sum{k}[0] += sum{k}[lane];" for k in axes]
    lines.append(f"return {{{', '.join(f'sum{k}[0]' for k in axes)}}};")

    @wp.func_native("\n".join(lines))
    def force_fan(fan: Fan, u: vec, pushed: vec, a: float, g: vec, sticky: bool, c: Constants) -> vec: ...

    return force_fan
