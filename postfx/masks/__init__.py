"""Makes `strength` planes from other planes of a frame: names in a Cryptomatte, ids, sky and
misses, or converged pixels.

NumPy in, NumPy out, as in `frame.planes[Role.STRENGTH] = strength_of_misses(frame.planes)`.
docs/howto/masks.md explains them and the matching command-line options.
"""

from postfx.errors import StrengthError
from postfx.masks.cryptomatte import (
    AUTO,
    Cryptomatte,
    Entry,
    id_of_name,
    parse_leave,
    strength_from_cryptomatte,
    strength_from_ids,
)
from postfx.masks.noise import (
    Threshold,
    misses_of,
    parse_threshold,
    strength_of_converged,
    strength_of_misses,
)

__all__ = [
    "AUTO",
    "Cryptomatte",
    "Entry",
    "StrengthError",
    "Threshold",
    "id_of_name",
    "misses_of",
    "parse_leave",
    "parse_threshold",
    "strength_from_cryptomatte",
    "strength_from_ids",
    "strength_of_converged",
    "strength_of_misses",
]
