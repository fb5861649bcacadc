"""Planes that are missing, and what that costs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from postfx.doctor.findings import Finding, error, info, warning
from postfx.doctor.material import Material
from postfx.frame import Role


class Cost(NamedTuple):
    """Least and most loss of PSNR in dB without a plane."""

    least: float
    most: float


COSTS = {
    Role.DIFFUSE_ALBEDO: Cost(0.92, 1.75),
    Role.SPECULAR_ALBEDO: Cost(0.06, 0.30),
    Role.NORMAL: Cost(0.25, 0.31),
    Role.ROUGHNESS: Cost(0.02, 0.04),
    Role.DEPTH: Cost(0.10, 0.42),
    Role.MOTION: Cost(1.22, 2.03),
}
"""Measured by leaving each plane out of three sequences: the table of ablations in docs/quality.md."""
MATTERS_DB = 0.2

FOLLOWING = (Role.MOTION, Role.DEPTH, Role.NORMAL, Role.ROUGHNESS, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
"""Without these planes reflections cannot be followed by their hit distance."""


def hit_distance_unused(material: Material) -> Iterator[Finding]:
    """A hit distance without what it takes to follow reflections by it."""
    first = material.first
    if Role.SPECULAR_HIT_DISTANCE not in first:
        return
    lacking = [str(role) for role in FOLLOWING if role not in first]
    lacking += ["worldToCamera"] if first.world_to_camera is None else []
    lacking += ["postfx:fovX"] if first.fov_x is None else []
    if lacking:
        yield info(Role.SPECULAR_HIT_DISTANCE, "hit-distance-unused", f"no {', '.join(lacking)}",
                   "planes or headers that are not written", "write them: then the history of reflections follows them")


def missing(material: Material) -> Iterator[Finding]:
    """Planes that would make the result better, and colour, without which there is none."""
    if Role.COLOUR not in material.first:
        yield error(Role.COLOUR, "missing-colour", "no colour plane was found", "another name or layer",
                    "name it in a profile (--profile FILE.toml)")
    for role, cost in COSTS.items():
        if role in material.first or role in material.first.guides:
            continue
        evidence = f"no plane; without it results were {cost.least:.2f} to {cost.most:.2f} dB worse (docs/quality.md)"
        where = material.enable.get(role, "")
        mend = f"switch it on: {where}" if where else "render it, or name it in a profile (--profile FILE.toml)"
        alone = role is Role.MOTION and not material.pairs
        level = warning if (cost.least + cost.most) / 2 >= MATTERS_DB and not alone else info
        yield level(role, f"missing-{role.replace('_', '-')}", evidence, "not rendered, or named otherwise", mend)
