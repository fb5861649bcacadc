"""Tables by name."""

from __future__ import annotations

from collections.abc import Callable

from training.measure.quality_report import sequences, sets

MAKERS: dict[str, Callable[..., str]] = {
    "conditions": sequences.conditions,
    "gains": sequences.gains,
    "methods": sequences.methods,
    "frames": sequences.frames,
    "history": sequences.history,
    "front": sequences.front,
    "times": sequences.times,
    "ablations": sequences.ablations,
    "scales": sets.scales,
    "equal_rays": sets.equal_rays,
    "equivalent": sets.equivalent,
    "convergence": sets.convergence,
    "networks": sets.networks,
}
"""Name -> what makes a block's lines of the results and the marker's arguments; raises Missing."""
