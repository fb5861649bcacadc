"""Planes `strength` from what a frame holds: names in a Cryptomatte, whole-number ids, sky and misses, or
what has converged.

NumPy in, NumPy out, as in `frame.planes[Role.STRENGTH] = strength_of_misses(frame.planes)`. docs/masks.md explains it,
and how the same is asked for on the command line.
"""

from postfx.errors import StrengthError
from postfx.strength.converged import Threshold, strength_of_converged, threshold_of
from postfx.strength.cryptomatte import Cryptomatte, id_of_name, strength_from_cryptomatte
from postfx.strength.entries import AUTO, Entry, parse_leave
from postfx.strength.ids import strength_from_ids
from postfx.strength.misses import misses_of, strength_of_misses

__all__ = [
    "AUTO",
    "Cryptomatte",
    "Entry",
    "StrengthError",
    "Threshold",
    "id_of_name",
    "misses_of",
    "parse_leave",
    "strength_from_cryptomatte",
    "strength_from_ids",
    "strength_of_converged",
    "strength_of_misses",
    "threshold_of",
]
