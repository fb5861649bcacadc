"""What a plan says of the denoiser: notes on the work, and remarks on the result.

All of it follows from the options and the spec of the frames, before any frame is read.
"""

from __future__ import annotations

from postfx.frame import GUIDE_ROLES, FrameSpec, Role
from postfx.passes.denoise.choice import NetworkChoice, guides_stand_in
from postfx.passes.denoise.models import (
    CLASSIC,
    UNSCALED,
    denoises_first,
    enlarging_remarks,
    filter_model,
    mixture_model,
    model_of,
    network_name,
    short_tag,
    unscaled_remarks,
)

NO_HISTORY_REMARK = "no motion vectors, so every frame is denoised alone and may flicker"
"""How the remark on missing motion begins; the fix follows."""
SHARPENING = Role.DIFFUSE_ALBEDO, Role.NORMAL, Role.DEPTH
"""Planes without which results are 0.2 dB worse or more; the others are worth less than a line."""


# Remarks on the result


def remark_on_planes(spec: FrameSpec) -> list[str]:
    """Planes that frames of a spec lack and that would make the result better."""
    found = []
    if not spec.has(Role.MOTION):
        can_be_estimated = any(map(spec.has, (Role.DIFFUSE_ALBEDO, Role.NORMAL)))
        remedy = ("--motion auto estimates them" if can_be_estimated
                  else "render them, or albedo to estimate them from")
        found.append(f"{NO_HISTORY_REMARK}: {remedy}")
    seen = {*spec.roles, *spec.guide_roles}
    lost = [str(role).replace("_", " ") for role in SHARPENING if role not in seen]
    listed = " or ".join(filter(None, (", ".join(lost[:-1]), *lost[-1:])))
    return [*found, f"no {listed}: results are blurrier"] if lost else found


def remark_on_networks(networks: NetworkChoice, spec: FrameSpec) -> list[str]:
    """Where another network stands in for the one that was asked for."""
    tag = networks.tag
    if networks.is_render_size(spec):
        return unscaled_remarks(tag)
    found = enlarging_remarks(tag)
    if guides_stand_in(spec) and denoises_first(tag):
        asked, other = short_tag(tag), short_tag(model_of(tag))
        found.append(f"'{asked}' does not denoise at the render's size first, '{other}' alone "
                     "runs: guides stand in for planes of the render's size")
    return found


def remark_on_guides(networks: NetworkChoice, spec: FrameSpec) -> list[str]:
    """Guides that are not used, or that are missing."""
    if (spec.guides is None
        or (spec.guide_roles and not set(spec.guide_roles) & set(GUIDE_ROLES))):
        return []
    if not networks.has_guided_model():
        return [f"model '{short_tag(networks.tag)}' does not read guides: they only stand in for "
                "missing planes"]
    if networks.is_render_size(spec):
        return ["guides of the render size only stand in for missing planes"]
    rough = [str(role)
             for role in GUIDE_ROLES if spec.has(role) and role not in spec.guide_roles]
    return [f"edges are less exact without the guides {', '.join(rough)}"] if rough else []


# Notes on the work


def note_network(networks: NetworkChoice, spec: FrameSpec) -> str:
    """Which network runs for frames of a spec."""
    tag = networks.tag
    if tag == CLASSIC:
        return "the classical filter, no network"
    faster = ", or a faster one to keep the budget" if networks.has_budget else ""
    asked, ending = short_tag(tag), networks.ending(spec)
    name = network_name(asked, model_of(tag, ending))
    if not networks.has_first_stage(spec):
        return f"network {name}{faster}"
    second = network_name(asked, mixture_model(tag, ending))
    return (f"network {asked} at the render's size first, then {second} enlarges; {name} "
            f"alone where frames have jitter{faster}")


def note_filters(networks: NetworkChoice, spec: FrameSpec) -> list[str]:
    """Which other network filters the parts, if one does."""
    if not networks.gives_picture(spec):
        return []
    model = filter_model(networks.tag, networks.ending(spec)).removesuffix(UNSCALED)
    return [f"network {network_name(short_tag(networks.tag), model)} filters parts"]
