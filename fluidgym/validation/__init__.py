"""Flows with a known answer, one file each: scene, reference, error, target."""

from fluidgym.validation import (
    channel,
    dam_break,
    elliptic_drop,
    heat,
    oscillating_drop,
    shear_start_up,
    still_tank,
    wavemaker,
)
from fluidgym.validation.case import Case, Result, limits_at, observed_order, run

CASES = {
    case.name: case
    for case in (
        dam_break.CASE,
        still_tank.CASE,
        elliptic_drop.CASE,
        oscillating_drop.CASE,
        shear_start_up.CASE,
        *wavemaker.CASES,
        *channel.CASES,
        heat.CASE,
    )
}

__all__ = ["CASES", "Case", "Result", "limits_at", "observed_order", "run"]
