"""Colour with and without transparents: which of the two is denoised."""

from __future__ import annotations

from postfx.frame import Role
from postfx.io.layout import ChannelIndex, Layout, Match


def take_opaque_colour(layout: Layout, index: ChannelIndex) -> None:
    """Let the colour before transparents be the frame's colour, as there is an overlay to composite over it.

    Its own alpha, channel A beside it, becomes the frame's; the alpha of all together counts the overlay already.
    """
    match = layout.planes.pop(Role.OPAQUE_COLOUR, None)
    if match is None:
        return
    layout.planes[Role.COLOUR] = match
    together = layout.planes.pop(Role.ALPHA, None)
    alpha = _alpha_beside(match, layout, index)
    if alpha:
        layout.planes[Role.ALPHA] = alpha
    elif together:
        layout.warnings.append(
            f"alpha {together.names} counts the overlay and is not used: write the alpha before transparents beside "
            f"{match.names}"
        )


def _alpha_beside(match: Match, layout: Layout, index: ChannelIndex) -> Match | None:
    names = next(names for names in match.rule.candidates(layout.layer) if index.find(names) == match.channels)
    channels = index.find([f"{names[0].rpartition('.')[0]}.A"])
    rules = layout.profile.rules(Role.ALPHA)
    return Match(rules[0], channels) if channels and rules else None
