"""What `postfx run` makes of light for a display: the arguments, and the passes that they ask for."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from postfx.passes.base import Pass
    from postfx.plan import Skipped

DITHERS = ("moving", "static", "none")


def add_arguments(group: argparse._ArgumentGroup) -> None:
    """Add all arguments."""
    add_look(group)
    group.add_argument(
        "--dither", default="moving", choices=DITHERS, help="of 8 bits: another pattern each frame (default), one, none"
    )


def add_look(group: argparse._ActionsContainer) -> None:
    """Add those that say what pictures look like."""
    tonemap = group.add_mutually_exclusive_group()
    tonemap.add_argument(
        "--tonemap",
        nargs="?",
        const="",
        metavar="LOOK",
        help="tone-map, with the default network, another one ('postfx models' lists them), reinhard, neutral (Khronos "
        "PBR Neutral), ocio:VIEW (part of a view's name; of the config $OCIO or the built-in ACES 2 config; "
        "ocio:VIEW@DISPLAY for a display by its name there), or a look-up table: FILE.cube,input=SPACE",
    )
    tonemap.add_argument("--no-tonemap", action="store_true", help="for a display, but only exposed, cut and encoded")
    group.add_argument(
        "--display",
        metavar="NAME",
        help="make the picture for srgb (default), p3, rec709, rec2020, or in HDR for pq or hlg, like "
        "pq,peak=1000,white=203 (nits of the brightest light and of diffuse white). Networks know SDR only: what they "
        "make white becomes diffuse white",
    )


def display_passes(arguments: argparse.Namespace, picture: bool) -> tuple[list[Pass], list[Skipped]]:
    """Passes that make pictures for a display, and what is left out; `picture` tells that the files hold such.

    Raises ColourError for a display or view that there is not.
    """
    from postfx.colour.displays import parse_display
    from postfx.colour.views import is_view
    from postfx.passes.registry import create
    from postfx.plan import Skipped

    if not picture and arguments.display is None and arguments.tonemap is None:
        why = "--no-tonemap" if arguments.no_tonemap else "EXR output stays scene-linear; --tonemap changes that"
        return [], [Skipped("tonemap", why)]
    display = str(parse_display(arguments.display or "srgb"))
    if arguments.no_tonemap:
        return [create("display", display=display)], [Skipped("tonemap", "--no-tonemap")]
    if arguments.tonemap and is_view(arguments.tonemap):
        mapper = create("view", view=arguments.tonemap, display=display)
        made_for = mapper.output
    else:
        mapper = create("tonemap", **({"tag": arguments.tonemap} if arguments.tonemap else {}))
        made_for = "srgb"
    return [mapper] + ([create("display", display=display)] if made_for != display else []), []
