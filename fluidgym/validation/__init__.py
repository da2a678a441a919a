"""Flows with a known answer, one file each: scene, reference, error, target."""

from fluidgym.validation import (
    channel,
    dam_break,
    dam_break_3d,
    elliptic_drop,
    free_fall,
    heat,
    lid_cavity,
    martin_moyce,
    oscillating_drop,
    shear_start_up,
    standing_wave,
    still_tank,
    taylor_green,
    taylor_green_3d,
    wavemaker,
)
from fluidgym.validation.case import Case, Result, limits_at, observed_order, run

CASES = {
    case.name: case
    for case in (
        still_tank.CASE,
        dam_break.CASE,
        martin_moyce.CASE,
        elliptic_drop.CASE,
        oscillating_drop.CASE,
        *standing_wave.CASES,
        *wavemaker.CASES,
        taylor_green.CASE,
        taylor_green_3d.CASE,
        shear_start_up.CASE,
        *lid_cavity.CASES,
        *channel.CASES,
        heat.CASE,
        *dam_break_3d.CASES,
        free_fall.CASE,
    )
}

__all__ = ["CASES", "Case", "Result", "limits_at", "observed_order", "run"]
