"""Solids inside the box, by their shadows.

What a particle cannot see does not act on it: two particles do not meet where the line between them crosses a body, and
the space behind the body's surface, seen from the particle, is filled with dummy points that continue the fluid into
the wall. The points lie on rays from the particle, so a body may be as thin as a sheet: each side has its own shadow.

The fluid is continued as at a wall of dummy particles (Adami, Hu & Adams 2012): a point takes the pressure of the
particle plus the weight of the fluid between them, rho_0 (g - a_n) . (x_k - x_i) with a_n the acceleration of the body
along its normal. Its normal velocity mirrors the particle's in the surface, which is what the images of a plane wall
amount to; for viscosity that sticks, so does the rest of it. The sum over the points is a quadrature over the shadow:
Gauss-Legendre along a ray; equal angles (2D) or Lebedev's points of order 15 (3D) around. The points run through the
same terms as particles.
"""

import math
from functools import lru_cache
from itertools import permutations, product
from types import SimpleNamespace

import numpy as np
import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.structure import Structure
from fluidgym.state import Bodies, Faces

RAYS_2D = 32

# Lebedev & Laikov (1999), order 15: one point of each orbit under the symmetries of the cube, and its weight over 4 pi.
_LEBEDEV = (
    ((0.0, 0.0, 1.0), 0.011544011544011544),
    ((0.57735026919, 0.57735026919, 0.57735026919), 0.011943909085856),
    ((0.369602846454, 0.369602846454, 0.852518311701), 0.011110555710603),
    ((0.189063552885, 0.694354006603, 0.694354006603), 0.011876501294537),
    ((0.0, 0.374243039090, 0.927330657151), 0.011812303746904),
)

# Four nodes along a ray: exact for the default kernel. On [0, 1].
NODES = wp.constant(wp.vec4(0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970262))
NODE_SHARES = wp.constant(wp.vec4(0.17392742256872692, 0.32607257743127305, 0.32607257743127305, 0.17392742256872692))

# The velocity of a point is that of the particle, mirrored: it changes sign at the surface and grows no further.
STEEPEST = wp.constant(2.0)

# A particle is kept this far off a body, over the spacing: on its surface it would not know on which side it is.
CLEAR = wp.constant(0.01)

NOTHING = wp.constant(1.0e30)  # distance to what is not there


def make_rays(dim: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (ray, dim) and the angle [rad or sr] that each stands for (ray,)."""
    if dim == 2:
        angle = (np.arange(RAYS_2D) + 0.5) * 2.0 * math.pi / RAYS_2D
        return np.stack([np.cos(angle), np.sin(angle)], axis=1), np.full(RAYS_2D, 2.0 * math.pi / RAYS_2D)
    weights = {}
    for point, weight in _LEBEDEV:
        for order, signs in product(permutations(point), product((1.0, -1.0), repeat=3)):
            weights[tuple(sign * x + 0.0 for sign, x in zip(signs, order, strict=True))] = weight
    rays = np.array(sorted(weights))
    share = np.array([weights[tuple(ray)] for ray in rays])
    return rays / np.linalg.norm(rays, axis=1)[:, None], 4.0 * math.pi * share / share.sum()


@lru_cache
def make_bodies(s: Structure) -> SimpleNamespace:
    """Warp functions about the bodies of a structure.

    Returns:
        A namespace of Screens (a matrix type: middle and half sides, a row for each body and for its image), screens
        (fills one), near (whether any body is in reach), Hit and cast (where a ray meets the first body), cushion and
        keep_out (the safety net at bodies).
    """
    dim, n_bodies = s.dim, len(s.balls)
    vec = wp.types.vector(dim, wp.float32)
    flags = wp.types.vector(dim, wp.int32)
    rows = n_bodies * (2 if s.has_images else 1)
    Screens = wp.types.matrix((max(rows, 1), 2 * dim), wp.float32)
    balls = wp.int32(sum(bool(ball) << body for body, ball in enumerate(s.balls)))
    mirrors = wp.int32(sum((kind == "mirror") << face for face, kind in enumerate(s.kinds)))

    @wp.struct
    class Hit:
        """Where a ray meets a body."""

        distance: float
        normal: vec  # out of the body
        velocity: vec  # of its surface
        acceleration: vec
        body: int

    @wp.func
    def screens(world: int, bodies: Bodies, turn: vec, images: vec) -> Screens:
        """The bodies, and what a mirror query sees of them: their images, too. images holds the mirrored planes."""
        found = Screens()
        for b in range(wp.static(n_bodies)):
            for k in range(wp.static(dim)):
                middle = bodies.position[world, b, k]
                found[b, k] = middle
                found[b, wp.static(dim) + k] = bodies.half[b, k]
                if wp.static(s.has_images):
                    if turn[k] < 0.0:
                        middle = 2.0 * images[k] - middle
                    found[wp.static(n_bodies) + b, k] = middle
                    found[wp.static(n_bodies) + b, wp.static(dim) + k] = bodies.half[b, k]
        return found

    @wp.func
    def outward(b: int, y: vec, bodies: Bodies) -> vec:
        """From the nearest place of a body to y, both from its middle; none where y is inside."""
        if (balls >> b) & 1 != 0:
            r = wp.length(y)
            return y * (wp.max(r - bodies.half[b, 0], 0.0) / wp.max(r, 1.0e-12))
        d = vec()
        for k in range(wp.static(dim)):
            d[k] = y[k] - wp.clamp(y[k], -bodies.half[b, k], bodies.half[b, k])
        return d

    @wp.func
    def from_middle(x: vec, world: int, b: int, bodies: Bodies) -> vec:
        y = vec()
        for k in range(wp.static(dim)):
            y[k] = x[k] - bodies.position[world, b, k]
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
    def cross(b: int, y: vec, e: vec, bodies: Bodies) -> Crossing:
        """The line y + t e, from the middle of a body; at is NOTHING where it misses, negative inside."""
        met = Crossing()
        met.at = NOTHING
        if (balls >> b) & 1 != 0:
            radius = bodies.half[b, 0]
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
            t_1 = (-bodies.half[b, k] - y[k]) * inverse
            t_2 = (bodies.half[b, k] - y[k]) * inverse
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
    def cast(x: vec, e: vec, found: flags, world: int, bodies: Bodies, faces: Faces) -> Hit:
        """Where the ray from x along the unit vector e meets the first body, or the image of one beyond a wall."""
        hit = Hit()
        hit.distance = NOTHING
        for b in range(wp.static(n_bodies)):
            for image in range(wp.static(1 + dim)):
                k = image - 1
                present = bool(True)
                face = int(0)
                y = from_middle(x, world, b, bodies)
                if image > 0:
                    # A wall within reach shows the body's image; the others are too far away to matter.
                    face = 2 * k + wp.where(found[k] == 2, 1, 0)
                    present = found[k] > 0 and (mirrors >> face) & 1 != 0
                    y[k] = x[k] - 2.0 * faces.position[world, face] + bodies.position[world, b, k]
                if present:
                    met = cross(b, y, e, bodies)
                    if met.at < hit.distance:
                        hit.distance = met.at
                        hit.normal = met.normal
                        hit.body = b
                        for m in range(wp.static(dim)):
                            hit.velocity[m] = bodies.velocity[world, b, m]
                            hit.acceleration[m] = bodies.acceleration[world, b, m]
                        if image > 0:
                            hit.velocity[k] = 2.0 * faces.velocity[world, face] - hit.velocity[k]
                            hit.acceleration[k] = 2.0 * faces.acceleration[world, face] - hit.acceleration[k]
        if hit.distance < 0.0:
            hit.distance = 0.0
            hit.normal = -e
        return hit

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
        stiffness = 0.5 * c.c_0 * c.c_0 / (c.h * c.h)
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
            met = cross(b, y_0, y - y_0, now)
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
        Hit=Hit,
        rows=rows,
        screens=screens,
        near=near,
        cast=cast,
        record=record,
        cushion=cushion,
        keep_out=keep_out,
    )
