"""What a particle makes of how well it is surrounded.

The measure is its company, the sum of V h^2 |W'/r| over neighbours, images and bodies, which weighs the near ones most.
The core that a kernel may have does not count, or particles that meet within it would pass for a crowd.
Its company over that of a lattice is its crowd: 1 inside the fluid, 0.6 on a flat surface, less in a tongue or a drop.
"""

import warp as wp

# A particle whose company is less than this is spray and carries no pressure of its own. One neighbour, or its own
# mirror image, weighs about 0.4 at dx and 0.05 at 2 dx; a lattice weighs about 3.
SPRAY_COMPANY = 0.05

# Particles may gather in a collapsing void or a corner without their density knowing, as it is advanced and not
# counted. Past this crowd they push each other apart, by so much a unit of it.
PACKED = wp.constant(1.25)
PACKING_STIFFNESS = wp.constant(0.1)  # of P


@wp.func
def spray_share(company: float) -> float:
    """Share of its density error that a particle keeps: none where it has no company at all."""
    return wp.clamp(company / wp.static(SPRAY_COMPANY), 0.0, 1.0)


@wp.func
def packing_pressure(crowd: float) -> float:
    """P of particles that are too close."""
    return PACKING_STIFFNESS * wp.max(crowd - PACKED, 0.0)
