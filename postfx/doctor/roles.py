"""Which planes of a file became which role, and why."""

from __future__ import annotations

from typing import Any

from postfx.doctor.reading import Reading
from postfx.frame import Role
from postfx.io.layout import Layout, Match
from postfx.io.profile import PlaneRule

SHOWN = 3


def explain_roles(reading: Reading) -> dict[str, dict[str, Any]]:
    """Role -> names of the file's channels ('planes', empty when there are none) and the reason ('why')."""
    return {str(role): _explain(reading, role) for role in Role}


def _explain(reading: Reading, role: Role) -> dict[str, Any]:
    layout, guides = reading.layout, reading.guides
    match = layout.planes.get(role)
    guide = guides.planes.get(role) if guides else None
    used = match or guide
    if used is None:
        return {"planes": [], "why": _why_not(layout, role)}
    found = {"planes": _names(used), "why": _why(layout, used, _prefix(match, role))}
    return {**found, "guides": _names(guide)} if match and guide else found


def _prefix(match: Match | None, role: Role) -> str:
    if match is None:
        return "guide: "
    return "colour before transparents, as there is an overlay to composite; " if match.rule.role is not role else ""


def _names(match: Match) -> list[str]:
    return [channel.name for channel in match.channels]


def _why(layout: Layout, match: Match, prefix: str) -> str:
    rule, role = match.rule, match.rule.role
    known = [name for other in layout.profile.rules(role) for name in other.names]
    preferred = f"profile {layout.profile.name} knows {_listed(known, layout.layer)} for {role}, best first"
    steps = [f"(stored + {list(rule.offset)}) x {list(rule.scale)}"] if any(rule.offset) else []
    steps += [f"times {list(rule.scale)}"] if not any(rule.offset) and set(rule.scale) != {1} else []
    steps += [f"unit {rule.unit}"] if role is Role.MOTION else []
    steps += [f"{rule.space} space"] if role is Role.NORMAL else []
    steps += _depth_steps(rule) if role is Role.DEPTH else []
    return prefix + preferred + (f"; read as: {', '.join(steps)}" if steps else "")


def _depth_steps(rule: PlaneRule) -> list[str]:
    known = {"planar": "along the view axis", "ray": "ray distance", "device": "a depth buffer"}
    near = ["1 at the near plane"] if rule.reversed else []
    miss = [] if rule.miss is None else [f"{rule.miss:g} where nothing was hit"]
    return [known.get(rule.kind, rule.kind), *near, *miss]


def _why_not(layout: Layout, role: Role) -> str:
    rules = layout.profile.rules(role)
    colour = layout.planes.get(Role.COLOUR)
    if colour and colour.rule.role is role:
        return "it is the frame's colour, as there is an overlay to composite"
    if not rules:
        return f"profile {layout.profile.name} has no name for it"
    names = [",".join(names) for rule in rules for names in rule.candidates(layout.layer)]
    return f"none of {_listed(names, layout.layer)} is there (profile {layout.profile.name})"


def _listed(names: list[str], layer: str) -> str:
    shown = [f"'{name.replace('{layer}', layer)}'" for name in dict.fromkeys(names)]
    return ", ".join(shown[:SHOWN]) + (f" and {len(shown) - SHOWN} more" if len(shown) > SHOWN else "")
