"""Numbers as JSON has them."""

from __future__ import annotations

import math


def finite_or_text(value: float | int | None) -> float | int | str | None:
    """NaN and infinities as text, which JSON has no numbers for."""
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
