"""Solids inside the box, by their shadows.

Two particles do not meet where the line between them goes in by one side of a box and out by the opposite one, and what
lies in or behind the box on such a line is, to a particle, filled with dummy points that continue the fluid into the
wall. They lie on rays from the particle, so a box may be as thin as a sheet: each side has its own shadow. Around an
edge the fluid goes on: there points fill just the body, whose kernel sum is then the gradient of a potential, without
which motion around an edge would slowly lose volume. A ball hides nothing unless it is smaller than the kernel.

The fluid is continued as at a wall of dummy particles (Adami, Hu & Adams 2012): a point takes the pressure of the
particle plus the weight of the fluid between them, rho_0 (g - a_n) . (x_k - x_i) with a_n the acceleration of the body
along its normal. Its velocity mirrors the particle's in the body's, u_i - u_k = 2 (u_i - u_b): with just that, the
pressure of the points takes from the motion what they put into compression, and still water around an edge stays
still. For viscosity that sticks it is the velocity that makes the body's own at the surface.

The sum over the points is a quadrature over the shadow: Gauss-Legendre along a ray, and across rays over the angle in
which each visible side is seen, so that it is smooth as the particle moves. The points run through the same terms as
particles.
"""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import warp as wp

from fluidgym.records import get, get_of
from fluidgym.sph.constants import Constants
from fluidgym.sph.fans import TOUCH, make_fans
from fluidgym.sph.structure import Structure
from fluidgym.state import Bodies, Faces


def gauss(n: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Nodes and weights of Gauss and Legendre on [0, 1], each (n,)."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return tuple(0.5 * nodes + 0.5), tuple(0.5 * weights)


# Rays across the angle of a side: 8 in two dimensions, 5 by 5 in three. On [0, 1].
_EIGHT, _EIGHT_SHARES = gauss(8)
_FIVE, _FIVE_SHARES = gauss(5)

# Four nodes along a ray: exact for the default kernel. On [0, 1].
FOUR, FOUR_SHARES = gauss(4)
NODES, NODE_SHARES = wp.constant(wp.vec4(*FOUR)), wp.constant(wp.vec4(*FOUR_SHARES))

# For viscosity the velocity of a point, against the body's, is that of the particle times its own distance from the
# surface over the particle's, to this much at most.
STEEPEST = wp.constant(2.0)

# A particle is kept this far off a body, over the spacing: on its surface it would not know on which side it is.
CLEAR = wp.constant(0.01)

BITS = wp.constant(31)  # of the company of a patch

NOTHING = wp.constant(1.0e30)  # distance to what is not there [m]


@lru_cache
def make_bodies(s: Structure) -> SimpleNamespace:
    """Warp functions about the bodies of a structure.

    Returns:
        A namespace of Screens (a matrix type: middle and half sides, a row for each body and for its image), screens
        (fills one), near (whether any body is in reach), patches, rays and others (numbers: of sides that there may be,
        of rays to one, of bodies and images), company (which are near), patch (a side as the particle sees it), ray
        (one that meets it), Fan and fan (all that meet it, fans.py), record (of forces), cushion and keep_out (the
        safety net at bodies).
    """
    dim, n_bodies = s.dim, len(s.balls)
    vec = wp.types.vector(dim, wp.float32)
    flags = wp.types.vector(dim, wp.int32)
    rows = n_bodies * (2 if s.has_images else 1)
    Screens = wp.types.matrix((max(rows, 1), 2 * dim), wp.float32)
    images = 1 + (dim if "mirror" in s.kinds else 0)
    eight, eight_shares = wp.types.vector(8, wp.float32)(*_EIGHT), wp.types.vector(8, wp.float32)(*_EIGHT_SHARES)
    five, five_shares = wp.types.vector(5, wp.float32)(*_FIVE), wp.types.vector(5, wp.float32)(*_FIVE_SHARES)
    balls = wp.int32(sum(bool(ball) << body for body, ball in enumerate(s.balls)))
    mirrors = wp.int32(sum((kind == "mirror") << face for face, kind in enumerate(s.kinds)))
    fans = make_fans(dim, *((_EIGHT, _EIGHT_SHARES) if dim == 2 else (_FIVE, _FIVE_SHARES)), NOTHING)
    Fan, to_box, to_ball, past_box, past_ball = fans.Fan, fans.to_box, fans.to_ball, fans.past_box, fans.past_ball

    @wp.struct
    class Patch:
        """One side of a body, or of the image of a body beyond a wall, as a particle sees it."""

        seen: bool
        company: int  # which other bodies and images are within reach
        body: int
        image: int  # 0 is the body itself, 1 + axis its image
        axis: int  # of the side's normal
        side: float  # its sign
        gap: float  # to the plane of the side [m]; from the middle of a ball
        middle: vec  # from it to the particle [m]
        half: vec  # half sides [m]
        first: float  # angle to the near end of the part within reach, along the next axis [rad]
        width: float  # of that part [rad]
        low: vec  # of the part within reach, from the particle [m]
        high: vec
        velocity: vec
        acceleration: vec

    @wp.struct
    class Ray:
        """A ray from a particle to a patch."""

        direction: vec
        distance: float  # to the surface [m]; NOTHING where it is not the first body that the ray meets
        end: float  # of what is filled [m]
        share: float  # of the angle [rad or sr]
        normal: vec  # out of the body

    @wp.func
    def screens(world: int, bodies: Bodies, turn: vec, planes: vec, inward: vec, reach: float) -> Screens:
        """The bodies, and what a mirror query sees of them: their images, too."""
        found = Screens()
        for b in range(wp.static(n_bodies)):
            gone = bool(False)
            for k in range(wp.static(dim)):
                middle = get_of(bodies.position, world, b, k)
                half = get(bodies.half, b, k)
                image = middle
                if wp.static(s.has_images):
                    if turn[k] < 0.0:
                        image = 2.0 * planes[k] - middle
                        off = wp.sign(inward[k]) * (middle - planes[k])
                        if off + half <= TOUCH * reach:
                            gone = True
                        if (balls >> b) & 1 == 0 and off - half < TOUCH * reach:
                            # It stands on the wall or reaches through it: one box with its image.
                            middle = planes[k]
                            image = planes[k]
                            half = off + half
                    found[wp.static(n_bodies) + b, k] = image
                    found[wp.static(n_bodies) + b, wp.static(dim) + k] = half
                found[b, k] = middle
                found[b, wp.static(dim) + k] = half
            if gone:
                for k in range(wp.static(dim)):
                    found[b, k] = NOTHING
                    found[b, wp.static(dim) + k] = 0.0
                    if wp.static(s.has_images):
                        found[wp.static(n_bodies) + b, k] = NOTHING
                        found[wp.static(n_bodies) + b, wp.static(dim) + k] = 0.0
        return found

    @wp.func
    def outward(b: int, y: vec, bodies: Bodies) -> vec:
        """From the nearest place of a body to y, both from its middle; none where y is inside."""
        if (balls >> b) & 1 != 0:
            r = wp.length(y)
            return y * (wp.max(r - get(bodies.half, b, 0), 0.0) / wp.max(r, 1.0e-12))
        d = vec()
        for k in range(wp.static(dim)):
            d[k] = y[k] - wp.clamp(y[k], -get(bodies.half, b, k), get(bodies.half, b, k))
        return d

    @wp.func
    def from_middle(x: vec, world: int, b: int, bodies: Bodies) -> vec:
        y = vec()
        for k in range(wp.static(dim)):
            y[k] = x[k] - get_of(bodies.position, world, b, k)
        return y

    @wp.func
    def near(x: vec, world: int, bodies: Bodies, reach: float) -> bool:
        """Whether any body is within reach."""
        found = bool(False)
        for b in range(wp.static(n_bodies)):
            d = outward(b, from_middle(x, world, b, bodies), bodies)
            if wp.dot(d, d) < reach * reach:
                found = True
        return found

    @wp.struct
    class Crossing:
        """Where a line enters a body: at which multiple of its direction, and through which side."""

        at: float
        normal: vec

    @wp.func
    def cross(b: int, y: vec, e: vec, bodies: Bodies, skin: float) -> Crossing:
        """The line y + t e, from the middle of a body and its skin; at is NOTHING where it misses, negative inside."""
        met = Crossing()
        met.at = NOTHING
        if (balls >> b) & 1 != 0:
            radius = get(bodies.half, b, 0)
            ee = wp.dot(e, e)
            ye = wp.dot(y, e)
            rest = ye * ye - ee * (wp.dot(y, y) - radius * radius)
            if rest > 0.0 and ee > 0.0:
                root = wp.sqrt(rest)
                if root > ye:
                    met.at = (-ye - root) / ee
                    met.normal = wp.normalize(y + met.at * e)
            return met
        t_in = float(-NOTHING)
        t_out = float(NOTHING)
        axis = int(0)
        side = float(0.0)
        for k in range(wp.static(dim)):
            inverse = 1.0 / wp.where(wp.abs(e[k]) < 1.0e-20, 1.0e-20, e[k])
            t_1 = (-get(bodies.half, b, k) - skin - y[k]) * inverse
            t_2 = (get(bodies.half, b, k) + skin - y[k]) * inverse
            if wp.min(t_1, t_2) > t_in:
                t_in = wp.min(t_1, t_2)
                axis = k
                side = -wp.sign(inverse)
            t_out = wp.min(t_out, wp.max(t_1, t_2))
        if t_in < t_out and t_out > 0.0:
            met.at = t_in
            met.normal[axis] = side
        return met

    @wp.func
    def present(image: int, found: flags, world: int, faces: Faces) -> bool:
        """Whether there is such an image: of a wall within reach. The others are too far away to matter."""
        if image == 0:
            return True
        face = 2 * (image - 1) + wp.where(found[image - 1] == 2, 1, 0)
        return found[image - 1] > 0 and (mirrors >> face) & 1 != 0

    @wp.func
    def mirror_plane(image: int, found: flags, world: int, faces: Faces) -> int:
        """The face that makes an image."""
        return 2 * (image - 1) + wp.where(found[image - 1] == 2, 1, 0)

    @wp.func
    def from_image(x: vec, image: int, found: flags, world: int, b: int, bodies: Bodies, faces: Faces) -> vec:
        """From the middle of a body, or of its image, to x."""
        y = from_middle(x, world, b, bodies)
        if image > 0:
            k = image - 1
            w = get(faces.position, world, mirror_plane(image, found, world, faces))
            y[k] = x[k] - 2.0 * w + get_of(bodies.position, world, b, k)
        return y

    @wp.struct
    class Extent:
        """A body, or its image, from a particle."""

        middle: vec  # from it to the particle [m]
        half: vec  # half sides [m]
        absent: bool  # beyond a wall, or an image that is one box with its body, which stands for both

    @wp.func
    def extent(
        x: vec, image: int, found: flags, world: int, b: int, bodies: Bodies, faces: Faces, reach: float
    ) -> Extent:
        """Where a body is, one with its images where it stands on a wall."""
        it = Extent()
        it.middle = from_image(x, image, found, world, b, bodies, faces)
        for k in range(wp.static(dim)):
            it.half[k] = get(bodies.half, b, k)
        if wp.static(images > 1):
            for k in range(wp.static(dim)):
                if present(1 + k, found, world, faces):
                    face = mirror_plane(1 + k, found, world, faces)
                    inward = wp.where(face % 2 == 0, 1.0, -1.0)
                    off = inward * (get_of(bodies.position, world, b, k) - get(faces.position, world, face))
                    # How far the body reaches into the box, and how far the gap to the wall is.
                    if off + get(bodies.half, b, k) <= TOUCH * reach:
                        it.absent = True  # all of it is beyond the wall
                    if (balls >> b) & 1 == 0 and off - get(bodies.half, b, k) < TOUCH * reach:
                        if image == 1 + k:
                            it.absent = True
                        it.middle[k] = x[k] - get(faces.position, world, face)
                        it.half[k] = off + get(bodies.half, b, k)
                    if (balls >> b) & 1 != 0 and off < 0.0 and image == 1 + k:
                        it.absent = True
        return it

    @wp.struct
    class Passage:
        """Where a ray goes into a box or ball and where it leaves; begins at NOTHING where it misses."""

        begins: float
        ends: float  # NOTHING where all behind is in shadow

    @wp.func
    def passage(b: int, y: vec, half: vec, e: vec, reach: float) -> Passage:
        """The way through a body at y from its middle along the unit vector e."""
        it = Passage()
        it.begins = NOTHING
        if (balls >> b) & 1 != 0:
            ye = wp.dot(y, e)
            rest = ye * ye - wp.dot(y, y) + half[0] * half[0]
            if rest > 0.0 and wp.sqrt(rest) > ye:
                it.begins = -ye - wp.sqrt(rest)
                it.ends = -ye + wp.sqrt(rest)
                if 2.0 * half[0] < reach:
                    it.ends = NOTHING
            return it
        t_in = float(-NOTHING)
        t_out = float(NOTHING)
        axis_in = int(-1)
        axis_out = int(-2)
        for k in range(wp.static(dim)):
            inverse = 1.0 / wp.where(wp.abs(e[k]) < 1.0e-20, 1.0e-20, e[k])
            t_1 = wp.min((-half[k] - y[k]) * inverse, (half[k] - y[k]) * inverse)
            t_2 = wp.max((-half[k] - y[k]) * inverse, (half[k] - y[k]) * inverse)
            if t_1 > t_in:
                t_in = t_1
                axis_in = k
            if t_2 < t_out:
                t_out = t_2
                axis_out = k
        if t_in < t_out and t_out > 0.0:
            it.begins = t_in
            it.ends = wp.where(axis_in == axis_out, NOTHING, t_out)
        return it

    @wp.func
    def company(x: vec, found: flags, world: int, bodies: Bodies, faces: Faces, reach: float) -> int:
        """Which bodies and images are within reach: bits, shared by those BITS apart."""
        bits = int(0)
        for n in range(bodies.others):
            image = n % wp.static(images)
            if present(image, found, world, faces):
                other = extent(x, image, found, world, n // wp.static(images), bodies, faces, reach)
                gap = float(0.0)
                for k in range(wp.static(dim)):
                    beyond = wp.max(wp.abs(other.middle[k]) - other.half[k], 0.0)
                    gap += beyond * beyond
                if gap < reach * reach and not other.absent:
                    bits |= 1 << (n % BITS)
        return bits

    @wp.func
    def patch(
        n: int, near: int, x: vec, found: flags, world: int, bodies: Bodies, faces: Faces, reach: float
    ) -> Patch:  # fmt: skip
        """The n-th of the sides that there may be, where that company is near."""
        it = Patch()
        number = n // wp.static(dim)
        it.axis = n % wp.static(dim)
        it.image = number % wp.static(images)
        it.body = number // wp.static(images)
        if (near >> (number % BITS)) & 1 == 0 or not present(it.image, found, world, faces):
            return it
        it.company = near
        if wp.static(n_bodies * images) <= BITS:
            it.company = near & ~(1 << number)
        whole = extent(x, it.image, found, world, it.body, bodies, faces, reach)
        if whole.absent:
            return it
        y = whole.middle
        it.middle = y
        it.half = whole.half
        if (balls >> it.body) & 1 != 0:
            it.gap = wp.length(y)
            it.low = y
            it.seen = (
                it.axis == 0 and it.gap > get(bodies.half, it.body, 0) and it.gap - get(bodies.half, it.body, 0) < reach
            )
        else:
            it.side = wp.where(y[it.axis] < 0.0, -1.0, 1.0)
            it.gap = wp.abs(y[it.axis]) - it.half[it.axis]
            it.seen = it.gap > 0.0 and it.gap < reach
            across = wp.sqrt(wp.max(reach * reach - it.gap * it.gap, 0.0))
            for k in range(wp.static(dim)):
                if k != it.axis:
                    it.low[k] = wp.max(-it.half[k] - y[k], -across)
                    it.high[k] = wp.min(it.half[k] - y[k], across)
                    if it.low[k] >= it.high[k]:
                        it.seen = False
        if it.seen and (balls >> it.body) & 1 == 0:
            it.gap = wp.max(it.gap, 1.0e-9 * reach)
            m = (it.axis + 1) % wp.static(dim)
            it.first = wp.atan2(it.low[m], it.gap)
            it.width = wp.atan2(it.high[m], it.gap) - it.first
        for k in range(wp.static(dim)):
            it.velocity[k] = get_of(bodies.velocity, world, it.body, k)
            it.acceleration[k] = get_of(bodies.acceleration, world, it.body, k)
        if it.image > 0:
            k = it.image - 1
            face = mirror_plane(it.image, found, world, faces)
            it.velocity[k] = 2.0 * get(faces.velocity, world, face) - it.velocity[k]
            it.acceleration[k] = 2.0 * get(faces.acceleration, world, face) - it.acceleration[k]
        return it

    @wp.func
    def ray_to_box(n: int, p: Patch, reach: float) -> Ray:
        """The n-th ray to a side of a box: equal steps of the angle, so that the solid angle is exact."""
        it = Ray()
        it.normal[p.axis] = p.side
        gap = p.gap
        if wp.static(dim == 2):
            m = 1 - p.axis
            angle = p.first + p.width * eight[n]
            it.share = p.width * eight_shares[n]
            it.direction[p.axis] = -p.side * wp.cos(angle)
            it.direction[m] = wp.sin(angle)
            it.distance = gap / wp.cos(angle)
        else:
            m = (p.axis + 1) % 3
            k = (p.axis + 2) % 3
            row = n // 5
            column = n % 5
            alpha = p.first + p.width * five[row]
            share = p.width * five_shares[row]
            far = gap / wp.cos(alpha)
            across = wp.sqrt(wp.max(reach * reach - far * far, 0.0))
            low = wp.atan2(wp.max(p.low[k], -across), far)
            high = wp.atan2(wp.min(p.high[k], across), far)
            beta = low + (high - low) * five[column]
            it.share = share * wp.max(high - low, 0.0) * five_shares[column] * wp.cos(beta)
            it.direction[p.axis] = -p.side * wp.cos(alpha) * wp.cos(beta)
            it.direction[m] = wp.sin(alpha) * wp.cos(beta)
            it.direction[k] = wp.sin(beta)
            it.distance = far / wp.cos(beta)
        return it

    @wp.func
    def ray_to_ball(n: int, p: Patch, radius: float) -> Ray:
        """The n-th ray to a ball: equal steps of the angle about its middle in which the surface is met."""
        it = Ray()
        y = p.low
        inward = -y / p.gap
        widest = radius / p.gap  # sine of the angle under which the ball is seen
        if wp.static(dim == 2):
            psi = (eight[n] - 0.5) * wp.pi
            sine = widest * wp.sin(psi)
            cosine = wp.sqrt(1.0 - sine * sine)
            it.share = wp.pi * eight_shares[n] * widest * wp.cos(psi) / cosine
            it.direction[0] = inward[0] * cosine - inward[1] * sine
            it.direction[1] = inward[1] * cosine + inward[0] * sine
            it.distance = p.gap * cosine - radius * wp.cos(psi)
        else:
            psi = 0.5 * wp.pi * five[n // 5]
            phi = 0.4 * wp.pi * (float(n % 5) + 0.5)
            sine = widest * wp.sin(psi)
            cosine = wp.sqrt(1.0 - sine * sine)
            a = vec()
            a[wp.where(wp.abs(inward[0]) < 0.6, 0, 1)] = 1.0
            a = wp.normalize(a - wp.dot(a, inward) * inward)
            b = wp.cross(inward, a)
            it.share = 0.4 * wp.pi * 0.5 * wp.pi * five_shares[n // 5] * sine * widest * wp.cos(psi) / cosine
            it.direction = cosine * inward + sine * (wp.cos(phi) * a + wp.sin(phi) * b)
            it.distance = p.gap * cosine - radius * wp.cos(psi)
        it.normal = (y + it.distance * it.direction) / radius
        return it

    @wp.func
    def ray(n: int, p: Patch, x: vec, found: flags, world: int, bodies: Bodies, faces: Faces, reach: float) -> Ray:
        """The n-th ray to a patch."""
        it = Ray()
        if (balls >> p.body) & 1 != 0:
            it = ray_to_ball(n, p, get(bodies.half, p.body, 0))
        else:
            it = ray_to_box(n, p, reach)
        if it.distance < reach:
            own = passage(p.body, p.middle, p.half, it.direction, reach)
            it.end = wp.where(own.begins < NOTHING, own.ends, it.distance)
            if p.company != 0:
                # Twice, so that a ray may go through two more bodies that touch.
                for again in range(2 * bodies.others):
                    number = again % bodies.others
                    b = number // wp.static(images)
                    image = number % wp.static(images)
                    if (p.company >> (number % BITS)) & 1 != 0 and (b != p.body or image != p.image):
                        if present(image, found, world, faces):
                            other = extent(x, image, found, world, b, bodies, faces, reach)
                            if not other.absent:
                                way = passage(b, other.middle, other.half, it.direction, reach)
                                # Of two that begin at the same place the earlier one fills.
                                tie = wp.abs(way.begins - it.distance) < TOUCH * reach
                                earlier = b < p.body or (b == p.body and image < p.image)
                                if way.begins < it.distance - TOUCH * reach or (tie and earlier):
                                    # In front of this one; or beside it, and then only one of the two fills.
                                    if way.begins > -0.5 * reach:
                                        it.distance = NOTHING
                                elif way.begins <= it.end + TOUCH * reach and way.ends > it.end:
                                    it.end = way.ends
            it.end = wp.min(it.end, reach)
        return it

    @wp.func
    def fan(p: Patch, x: vec, found: flags, world: int, bodies: Bodies, faces: Faces, reach: float) -> Fan:
        """All rays to a patch."""
        it = Fan()
        if (balls >> p.body) & 1 != 0:
            it = to_ball(p.middle, p.gap, get(bodies.half, p.body, 0), reach)
        else:
            it = to_box(p.gap, p.side, p.axis, p.first, p.width, p.low, p.high, p.middle, p.half, reach)
        if p.company != 0:
            for again in range(2 * bodies.others):
                number = again % bodies.others
                b = number // wp.static(images)
                image = number % wp.static(images)
                if (p.company >> (number % BITS)) & 1 != 0 and (b != p.body or image != p.image):
                    if present(image, found, world, faces):
                        other = extent(x, image, found, world, b, bodies, faces, reach)
                        if not other.absent:
                            earlier = b < p.body or (b == p.body and image < p.image)
                            if (balls >> b) & 1 != 0:
                                it = past_ball(it, other.middle, other.half[0], earlier, reach)
                            else:
                                it = past_box(it, other.middle, other.half, earlier, reach)
        return it

    @wp.func
    def record(value: vec, world: int, b: int, forces: wp.array3d[wp.int64], c: Constants):
        """Add what a body does to a particle [m/s2] to the sum, in fixed point."""
        for k in range(wp.static(dim)):
            wp.atomic_add(forces, world, wp.static(2 * dim) + b, k, wp.int64(wp.round(value[k] * c.force_unit)))

    @wp.func
    def cushion(x: vec, world: int, bodies: Bodies, forces: wp.array3d[wp.int64], c: Constants) -> vec:
        """Push off a particle that all but touches a body, as the cushion of a wall does [m/s2]."""
        push = vec()
        depth = 0.05 * c.spacing
        stiffness = 0.22 * c.c_0 * c.c_0 / (c.spacing * c.spacing)
        for b in range(wp.static(n_bodies)):
            d = outward(b, from_middle(x, world, b, bodies), bodies)
            gap = wp.length(d)
            if gap < depth and gap > 0.0:
                push += d * (stiffness * (depth - gap) / gap)
                if wp.static(s.forces):
                    record(d * (stiffness * (depth - gap) / gap), world, b, forces, c)
        return push

    @wp.struct
    class Motion:
        """Where a particle is and how it moves."""

        position: vec
        velocity: vec

    @wp.func
    def keep_out(
        x_0: vec, x: vec, u: vec, world: int, before: Bodies, now: Bodies, c: Constants, clamped: wp.array[int]
    ) -> Motion:
        """Put a particle that has met a body on its way from x_0 to x back on the side it came from, and count that."""
        kept = Motion()
        kept.position = x
        kept.velocity = u
        gap = CLEAR * c.spacing
        for b in range(wp.static(n_bodies)):
            y_0 = from_middle(x_0, world, b, before)
            y = from_middle(kept.position, world, b, now)
            # With half of the gap as a skin: what slides along a wall does not slip between that and the body.
            met = cross(b, y_0, y - y_0, now, 0.5 * gap)
            if met.at <= 1.0:
                n = met.normal
                if met.at < 0.0 and (balls >> b) & 1 == 0:
                    # It was inside already, as where a body is put on it: out by the nearest side.
                    n = vec()
                    axis = int(0)
                    for k in range(wp.static(dim)):
                        if now.half[b, k] - wp.abs(y_0[k]) < now.half[b, axis] - wp.abs(y_0[axis]):
                            axis = k
                    n[axis] = wp.where(y_0[axis] < 0.0, -1.0, 1.0)
                if (balls >> b) & 1 != 0:
                    n = wp.normalize(y_0)
                    y = n * (now.half[b, 0] + gap)
                else:
                    for k in range(wp.static(dim)):
                        if n[k] != 0.0:
                            y[k] = n[k] * (now.half[b, k] + gap)
                inward = float(0.0)
                for k in range(wp.static(dim)):
                    kept.position[k] = y[k] + now.position[world, b, k]
                    inward += n[k] * (kept.velocity[k] - now.velocity[world, b, k])
                if inward < 0.0:
                    kept.velocity -= inward * n
                wp.atomic_add(clamped, world, 1)
        return kept

    return SimpleNamespace(
        Screens=Screens,
        Patch=Patch,
        Ray=Ray,
        patches=n_bodies * images * dim,
        rays=8 if dim == 2 else 25,
        others=n_bodies * images,
        screens=screens,
        near=near,
        company=company,
        patch=patch,
        ray=ray,
        Fan=Fan,
        fan=fan,
        record=record,
        cushion=cushion,
        keep_out=keep_out,
    )
