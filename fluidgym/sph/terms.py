"""What a physics term is: one plain Warp function of a pair, and where its sum goes.

A term sees only what does not turn with the axes. Its function has the signature

    term(r, xu, slope, a_i, a_j, c: Constants) -> float

with r = |x_ij| [m], xu = x_ij . u_ij [m2/s], slope = W'(r)/r, and a the field of its sweep: the relative density
error s in a density rate, the reduced pressure P in a force. Where i meets a mirror image, xu and a_j are the image's.
A term with a weight of its own is handed that in place of the slope, a squared one r^2 in place of r, so that it need
not wait for a square root that it has no use for. Where the slope is 0, so must the term be: the loops
come across places beyond the support, and some that no particle is at.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import warp as wp

from fluidgym.sph.constants import Constants


@dataclass(frozen=True)
class _Term:
    function: wp.Function
    weight: Callable[[int], wp.Function] | None = None  # dim -> (r, Constants) -> what stands in for the slope
    reads_density: bool = False  # a Force or Drag whose field is s, not P
    squared: bool = False  # whether the function takes r^2, not r

    def __post_init__(self) -> None:
        if not isinstance(self.function, wp.Function):
            raise ValueError(f"{type(self).__name__}({self.function!r}) is not of a Warp function; use @wp.func")


@dataclass(frozen=True)
class DensityRate(_Term):
    """A term of ds_i/dt [1/s]: the sum over j of V function(...)."""


@dataclass(frozen=True)
class Force(_Term):
    """A term of du_i/dt [m/s2] along the line of the pair: the sum over j of V function(...) x_ij."""


@dataclass(frozen=True)
class Drag(_Term):
    """A term of du_i/dt [m/s2] along the pair's velocity: the sum over j of V function(...) u_ij."""


@wp.func
def just_weight(r: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
    """The weight itself."""
    return slope


@dataclass(frozen=True)
class DensitySum(_Term):
    """Density itself, by summation: rho_i / rho_0 is the sum over j, i included, of V weight."""

    function: wp.Function = just_weight


Term = DensityRate | DensitySum | Force | Drag


@wp.func
def no_term(r2: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
    """The sum of no terms."""
    return 0.0


@lru_cache
def bound(term: _Term, dim: int) -> wp.Function:
    """The function of a term, of r^2, with the weight of its own if it has one."""
    function, squared = term.function, term.squared
    if squared and term.weight is None:
        return function
    weight = term.weight(dim) if term.weight else None

    @wp.func
    def bound_term(r2: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
        r = wp.sqrt(r2)
        w = slope
        if wp.static(weight is not None):
            w = weight(r, c)
        if wp.static(squared):
            r = r2
        return function(r, xu, w, a_i, a_j, c)

    return bound_term


@lru_cache
def total(functions: tuple[wp.Function, ...]) -> wp.Function:
    """One function of r^2 that adds up several such."""
    if not functions:
        return no_term
    if len(functions) == 1:
        return functions[0]
    first, rest = functions[0], total(functions[1:])

    @wp.func
    def sum_of_terms(r2: float, xu: float, slope: float, a_i: float, a_j: float, c: Constants) -> float:
        return first(r2, xu, slope, a_i, a_j, c) + rest(r2, xu, slope, a_i, a_j, c)

    return sum_of_terms
