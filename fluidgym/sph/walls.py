"""Walls and periodic faces without wall particles: every face shows the fluid its own image.

A reflection R is an isometry, so the sum over the mirror images of all neighbours, seen from particle i, is the plain
sum seen from the reflected place of i:

    sum_j f(x_i - R x_j, u_i - R u_j) = R sum_j f(R x_i - x_j, R u_i - u_j)

A particle within reach of k faces therefore asks 2^k times, all others once, and the inner loop knows no wall. The
image of i itself comes along by itself. A periodic face is the same with a translation for R.

An image continues the hydrostatic pressure through the wall: p_m = p_j + rho_0 (g - a_w).n n.(x_m - x_j), which is
affine in x_j and rides along as offset + tilt . (X - x_j). No-slip walls hand the viscous term u_m = 2 u_w - u_j.
"""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp

from fluidgym.records import get
from fluidgym.sph.constants import Constants
from fluidgym.sph.structure import Structure
from fluidgym.state import Faces


@lru_cache
def make_images(s: Structure) -> SimpleNamespace:
    """Warp functions about the faces of a structure, which make the images of a particle.

    Returns:
        A namespace of Query (a struct), near (which faces are in reach), near_bare (whether one that shows no image
        is), count (how many queries that makes), query (the n-th of them), cushion (what else pushes off a wall),
        keep_inside (the safety net at walls), wrap (periodic faces) and has_left (open ones).
    """
    dim, kinds, no_slip, wall = s.dim, s.kinds, s.no_slip, s.wall
    warm = s.warm_faces
    vec = wp.types.vector(dim, wp.float32)
    flags = wp.types.vector(dim, wp.int32)
    # Bits, one a face: the compiler drops what a constant bit switches off.
    imaged = wp.int32(sum((kind in ("mirror", "periodic")) << face for face, kind in enumerate(kinds)))
    mirrors = wp.int32(sum((kind == "mirror") << face for face, kind in enumerate(kinds)))
    bare = wp.int32(sum((kind == "bare") << face for face, kind in enumerate(kinds)))
    walls = wp.int32(sum((kind in ("mirror", "bare")) << face for face, kind in enumerate(kinds)))
    exits = wp.int32(sum((kind == "open") << face for face, kind in enumerate(kinds)))
    held = wp.int32(sum(bool(own) << face for face, own in enumerate(warm)))
    sticky = wp.int32(sum(bool(stick) << face for face, stick in enumerate(no_slip)))

    @wp.struct
    class Query:
        """A particle seen from one of its images."""

        position: vec
        velocity: vec
        viscous_velocity: vec  # what the viscous term sees
        turn: vec  # diagonal of R
        viscous_turn: vec  # of x_k u_k in the viscous term
        offset: float  # of the relative density error, and of P
        density_tilt: vec  # [1/m]
        pressure_tilt: vec  # [1/m]
        plane: vec  # where the walls are that reflect, [m]
        face: flags  # which faces reflect: 1 + number of the face of each axis, 0 where none does
        flip: float  # temperature of an image: flip T_j + shift
        shift: float

    @wp.func
    def near(x: vec, world: int, faces: Faces, reach: float) -> flags:
        """Bit 1 of an axis: its lower face is within reach; bit 2: its upper face."""
        found = flags()
        for k in range(wp.static(dim)):
            if (imaged >> (2 * k)) & 1 != 0:
                if x[k] - get(faces.position, world, 2 * k) < reach:
                    found[k] = 1
            if (imaged >> (2 * k + 1)) & 1 != 0:
                if get(faces.position, world, 2 * k + 1) - x[k] < reach:
                    found[k] += 2
        return found

    @wp.func
    def count(found: flags) -> int:
        """Number of queries: the particle itself and its images, corners included."""
        n = int(1)
        for k in range(wp.static(dim)):
            n *= 1 + (found[k] & 1) + (found[k] >> 1)
        return n

    @wp.func
    def query(n: int, found: flags, x: vec, u: vec, g: vec, lean: vec, world: int, faces: Faces, c: Constants) -> Query:
        """The n-th query of a particle at x with velocity u and half of its acceleration; the first is itself."""
        q = Query()
        q.position = x
        q.velocity = u
        q.viscous_velocity = u
        q.viscous_turn = vec(1.0)
        q.flip = 1.0
        rest = int(n)
        for k in range(wp.static(dim)):
            q.turn[k] = 1.0
            q.density_tilt[k] = (g[k] - lean[k]) * c.inv_c_0_squared
            if (imaged >> (2 * k)) & 3 != 0:
                choices = 1 + (found[k] & 1) + (found[k] >> 1)
                choice = rest % choices
                rest = rest // choices
                if choice > 0:
                    face = 2 * k
                    if choice == 2 or found[k] == 2:
                        face = 2 * k + 1
                    if (mirrors >> face) & 1 != 0:
                        w = get(faces.position, world, face)
                        pull = (g[k] - get(faces.acceleration, world, face)) * c.inv_c_0_squared
                        q.position[k] = 2.0 * w - x[k]
                        q.velocity[k] = 2.0 * get(faces.velocity, world, face) - u[k]
                        q.turn[k] = -1.0
                        if (sticky >> face) & 1 != 0:
                            for m in range(wp.static(dim)):
                                wall_velocity = faces.sliding[world, face, m]
                                if m == k:
                                    wall_velocity += get(faces.velocity, world, face)
                                q.viscous_velocity[m] = 2.0 * wall_velocity - q.viscous_velocity[m]
                                if m != k:
                                    q.viscous_turn[m] = -q.viscous_turn[m]
                        else:
                            q.viscous_velocity[k] = 2.0 * get(faces.velocity, world, face) - q.viscous_velocity[k]
                        q.offset += 2.0 * pull * (w - q.position[k])
                        # The image accelerates by 2 a_w - a_j.
                        q.density_tilt[k] = pull + lean[k] * c.inv_c_0_squared
                        q.pressure_tilt[k] = 2.0 * pull
                        q.plane[k] = w
                        q.face[k] = 1 + face
                        if (held >> face) & 1 != 0:
                            q.shift = 2.0 * faces.temperature[face] - q.shift
                            q.flip = -q.flip
                    else:
                        other = 4 * k + 1 - face
                        q.position[k] = x[k] + get(faces.position, world, other) - get(faces.position, world, face)
        return q

    @wp.func
    def cushion(x: vec, world: int, faces: Faces, forces: wp.array3d[wp.int64], c: Constants) -> vec:
        """What pushes a particle off walls besides their images [m/s2].

        At a mirror: where a particle is about to merge with its own image, as W' vanishes with r. A spring of the
        stiffness of the fluid, c_0/dx, holds it a twentieth of the spacing away. At a penalty wall: its spring.
        """
        push = vec()
        depth = 0.05 * c.spacing
        stiffness = 0.22 * c.c_0 * c.c_0 / (c.spacing * c.spacing)
        if wp.static(wall == "penalty"):
            depth = c.wall_margin
            stiffness = c.wall_stiffness
        springs = mirrors
        if wp.static(wall == "penalty"):
            springs = bare
        for k in range(wp.static(dim)):
            if (springs >> (2 * k)) & 1 != 0:
                push[k] += stiffness * wp.max(depth - x[k] + get(faces.position, world, 2 * k), 0.0)
            if (springs >> (2 * k + 1)) & 1 != 0:
                push[k] -= stiffness * wp.max(depth + x[k] - get(faces.position, world, 2 * k + 1), 0.0)
            if wp.static(s.forces):
                if push[k] != 0.0:
                    face = 2 * k + wp.where(push[k] < 0.0, 1, 0)
                    wp.atomic_add(forces, world, face, k, wp.int64(wp.round(push[k] * c.force_unit)))
        return push

    @wp.func
    def record(value: vec, face: flags, world: int, forces: wp.array3d[wp.int64], c: Constants):
        """Add what the fluid behind walls does to a particle [m/s2] to the sum of each wall, in fixed point.

        A component belongs to the wall that reflects it, and the others are shared by the walls that reflect at all.
        """
        reflecting = float(0.0)
        for k in range(wp.static(dim)):
            reflecting += wp.where(face[k] > 0, 1.0, 0.0)
        for k in range(wp.static(dim)):
            if face[k] > 0:
                for m in range(wp.static(dim)):
                    part = value[m]
                    if m != k:
                        part = wp.where(face[m] > 0, 0.0, part / reflecting)
                    wp.atomic_add(forces, world, face[k] - 1, m, wp.int64(wp.round(part * c.force_unit)))

    @wp.func
    def near_bare(x: vec, world: int, faces: Faces, reach: float) -> bool:
        """Whether a wall that shows no image is within reach."""
        found = bool(False)
        for k in range(wp.static(dim)):
            if (bare >> (2 * k)) & 1 != 0:
                if x[k] - get(faces.position, world, 2 * k) < reach:
                    found = True
            if (bare >> (2 * k + 1)) & 1 != 0:
                if get(faces.position, world, 2 * k + 1) - x[k] < reach:
                    found = True
        return found

    @wp.struct
    class Motion:
        """Where a particle is and how it moves."""

        position: vec
        velocity: vec

    @wp.func
    def keep_inside(x: vec, u: vec, world: int, faces: Faces, c: Constants, clamped: wp.array[int]) -> Motion:
        """Put a particle that has crossed a wall back on it, moving no further out, and count that.

        A clamping wall does that for a living: it throws the particle back, and does not count.
        """
        kept = Motion()
        kept.position = x
        kept.velocity = u
        for k in range(wp.static(dim)):
            for side in range(2):
                face = 2 * k + side
                if (walls >> face) & 1 != 0:
                    outward = float(2 * side - 1)
                    if outward * (x[k] - get(faces.position, world, face)) > 0.0:
                        kept.position[k] = get(faces.position, world, face)
                        excess = u[k] - get(faces.velocity, world, face)
                        if outward * excess > 0.0:
                            if wp.static(wall == "clamp"):
                                excess *= -c.wall_damping
                            else:
                                excess = 0.0
                            kept.velocity[k] = get(faces.velocity, world, face) + excess
                        if wp.static(wall != "clamp"):
                            wp.atomic_add(clamped, world, 1)
        return kept

    @wp.func
    def wrap(x: vec, world: int, faces: Faces) -> vec:
        """Bring a particle that has left through a periodic face back in at the other side."""
        y = x
        for k in range(wp.static(dim)):
            if ((imaged & ~mirrors) >> (2 * k)) & 1 != 0:
                low = get(faces.position, world, 2 * k)
                high = get(faces.position, world, 2 * k + 1)
                if x[k] < low:
                    y[k] = x[k] + (high - low)
                if x[k] >= high:
                    y[k] = x[k] - (high - low)
        return y

    @wp.func
    def has_left(x: vec, world: int, faces: Faces) -> bool:
        """Whether a particle is beyond an open face."""
        left = bool(False)
        for k in range(wp.static(dim)):
            if (exits >> (2 * k)) & 1 != 0:
                if x[k] < get(faces.position, world, 2 * k):
                    left = True
            if (exits >> (2 * k + 1)) & 1 != 0:
                if x[k] > get(faces.position, world, 2 * k + 1):
                    left = True
        return left

    return SimpleNamespace(
        Query=Query,
        near=near,
        near_bare=near_bare,
        count=count,
        query=query,
        cushion=cushion,
        record=record,
        keep_inside=keep_inside,
        wrap=wrap,
        has_left=has_left,
    )
