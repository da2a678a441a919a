"""Flows with a known answer, one file each: scene, reference, error, target."""

from fluidgym.validation import dam_break, elliptic_drop, still_tank
from fluidgym.validation.case import Case, Result, limits_at, observed_order, run

CASES = {case.name: case for case in (dam_break.CASE, still_tank.CASE, elliptic_drop.CASE)}

__all__ = ["CASES", "Case", "Result", "limits_at", "observed_order", "run"]
