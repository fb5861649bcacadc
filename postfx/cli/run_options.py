"""The options of `postfx run`: each is declared here, once, beside what it means.

A new option is one more `Option` in a section. If `sets` names a parameter of a part of the run,
nothing else has to change:

    device    postfx.runtime.Device            sequence  postfx.io.sequence.Sequence
    denoiser  postfx.DenoiseUpscale            look      postfx.passes.display.make_display_passes
    writer    postfx.io.writer.write_frame     run       postfx.runs.run.Options
    page      postfx.cli.report.RunReport      capture   postfx.tools.report.page.FrameCapture
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from postfx.cli.options import (
    CHUNK_FRAMES,
    Option,
    Options,
    Section,
    parse_count,
    parse_from_zero,
    parse_number,
    parse_path,
    parse_positive,
    parse_ray,
    parse_size,
)
from postfx.errors import OptionError, suggest

if TYPE_CHECKING:
    from postfx.frame import Role
    from postfx.io.frame_reader import FrameFiles
    from postfx.io.sequence import Sequence
    from postfx.io.writer import OutputFiles
    from postfx.plan import Skip
    from postfx.temporal.reverse_order import RunUp

# Modules that load NumPy or the runtime are imported inside functions: --help must not wait for
# them.


PRESETS: dict[str, dict[str, Any]] = {
    "preview": {"model": "s", "run_up": 0, "preroll": 0, "fast_look": True},
    "final": {"model": "xl", "both_ways": True, "with": "auto"},
    "animation": {"both_ways": True, "exposure": "smooth"},
}
"""Preset -> option -> value; `--preset` says them in words."""

_FOR_DENOISER = {"--no-denoise": "{flag} is for the denoiser, which --no-denoise leaves out: give "
                 "one of them"}


# Frames


def _parse_preroll(text: str) -> int | str:
    return text if text == "auto" else parse_count(text)


INPUT = Option(flag="input", once=True, metavar="INPUT", is_file=True, several=True,
               help="frames to read: a pattern, a folder, wildcards or files")

FRAME_SECTION = Section("frames", (
    INPUT,
    Option(flag="--output", short="-o", basic=True, once=True, metavar="OUTPUT", changes="nothing",
           help="files to write: a pattern like out/clean.####.exr, a folder or one file"),
    Option(flag="--frames", basic=True, once=True, metavar="RANGE", changes="nothing",
           help="frames to process, e.g. 1-100, 1-100x2 (every second one) or 1,5,8-12; negative "
           "numbers as --frames=-10-20"),
    Option(flag="--overwrite", basic=True, either="existing", changes="nothing",
           help="replace output files that are there"),
    Option(flag="--skip-existing", basic=True, either="existing", changes="nothing",
           help="keep output files that are complete, and continue after them with the same pixels "
           "as an unbroken run"),
    Option(flag="--guides", once=True, metavar="GUIDES", sets="sequence.guides", is_file=True,
           help="albedo, normal, roughness or depth at output size, in files numbered like INPUT"),
    Option(flag="--preroll", once=True, metavar="N|auto", type=_parse_preroll, off=0,
           sets="run.preroll", changes="nothing",
           help="frames before the range, and in its gaps, to run without writing them, for the "
           "history: a number, 0 for none, or auto for those of the shot, at most 96 (default)"),
    Option(flag="--on-error", choices=("stop", "skip", "copy"), default="stop", changes="nothing",
           help="when a frame cannot be read or processed: stop ends the run (default), skip "
           "writes no file for it, copy writes it enlarged but not denoised. After skip or copy "
           "the run exits with 3"),
))

FILES_WRITTEN = Section("files that are written", (
    Option(flag="--keep", choices=("auto", "all", "none"), default="auto", off="auto",
           sets="writer.keep", convert={"auto": None, "all": True, "none": False}.get,
           help="what EXR output keeps of the input's other channels, parts and header. Auto keeps "
           "everything, bit for bit, if the output has the render's size (default). All also "
           "keeps it at other sizes, by repeating pixels; none keeps nothing"),
    Option(flag="--bits", metavar="N", type=parse_positive, sets="writer.bits",
           help="bits of a channel. EXR: 16 (half floats, default) or 32 (floats, default with "
           "--aov-denoise depth or position); PNG: 8 (default) or 16 (default in HDR); TIFF: 8 or "
           "16 (default)"),
    Option(flag="--compression", metavar="NAME", default="zip", sets="writer.compression",
           type=str.lower,
           help="compression of EXR files: none, rle, zips, zip, piz, pxr24, b44, b44a, dwaa, "
           "dwab, htj2k256, htj2k32, lj2k or zstd. Both kinds of dwa also have a level, as "
           "dwaa:45. Lossy are pxr24, b44, dwa and lj2k. Few programs read the last four yet "
           "(default: zip, the fastest of those that shrink files)"),
))


SHOWN_PARTS = 3
"""Light groups and passes that one line names."""


def explain_kept(
    arguments: argparse.Namespace, files: FrameFiles, size: tuple[int, int],
    views: Iterable[FrameFiles] = ()
) -> tuple[str, list[Skip]]:
    """A line on the channels beside the picture that an output of a size keeps, '' for none; and
    those that it does not. views: of the other views that are written."""
    from postfx.frame import Role
    from postfx.io.writer import is_display_format
    from postfx.plan import Skip

    is_picture = (arguments.output and os.path.splitext(arguments.output)[1]
                  and is_display_format(arguments.output))
    if arguments.keep == "none" or is_picture or Role.COLOUR not in files.layout.planes:
        return "", []
    written = []
    for one in (files, *views):
        written += [one.layout.planes[role].channels for role in (Role.COLOUR, Role.ALPHA)
                    if role in one.layout.planes]
        written += [found.channels for found in one.parts.values()]
    touched = {(channel.part.index, channel.name) for channels in written for channel in channels}
    colour = files.match(Role.COLOUR)
    held = files.files[colour.channels[0].word].parts
    others = {(part.index, name) for part in held for name in part.channels} - touched
    count = f"{len(others)} other channel{'s' * (len(others) != 1)}"
    if not others:
        return "", []
    if colour.size == size:
        return (f"keeps   {count} bit for bit (--keep none leaves them out)",
                _noisy(arguments, files))
    if arguments.keep == "all":
        return (f"keeps   {count}, enlarged by the nearest pixel, without the render's own colour",
                _noisy(arguments, files))
    return "", [Skip(count, "they have the render's size; --keep all enlarges them")]


def _noisy(arguments: argparse.Namespace, files: FrameFiles) -> list[Skip]:
    """What is kept beside a denoised picture that no longer adds up to it."""
    from postfx.passes.display import is_shown
    from postfx.plan import Skip

    if arguments.aov or arguments.no_denoise or arguments.strength == 0:
        return []
    layers = files.known_parts()
    more = f" and {len(layers) - SHOWN_PARTS} more" if len(layers) > SHOWN_PARTS else ""
    shown = is_shown(False, **RUN.values_for("look", arguments))
    remedy = ("only scene-linear output has denoised ones" if shown
              else "--aov auto denoises them, too")
    return [Skip(f"{', '.join(layers[:SHOWN_PARTS])}{more}",
                 f"kept as noisy as they are; {remedy}")] if layers else []


# Logs and resuming

_EXACT = "exact"


def _parse_seconds(text: str) -> float | None:
    return None if text == "none" else parse_from_zero(text)


def _parse_rerun(text: str) -> str | int:
    if text != _EXACT and not text.isdigit():
        raise argparse.ArgumentTypeError(f"'{text}' is not a number of frames: give one, or exact")
    return text if text == _EXACT else int(text)


LOG_SECTION = Section("logs and resuming", (
    Option(flag="--log", once=True, metavar="FILE", type=parse_path, sets="run.log",
           changes="nothing",
           help="append one JSON object a line for each frame and event (docs/lab/reliability.md)"),
    Option(flag="--checkpoint", metavar="SECONDS", type=_parse_seconds, default=30.0,
           sets="run.checkpoint", changes="nothing",
           help="seconds of work between two saves of the history in OUTPUT's folder, from which "
           "--skip-existing continues; it is also saved when the run is stopped. 0: every frame; "
           "none: never (default: 30)"),
    Option(flag="--resume", once=True, metavar="exact|N", type=_parse_rerun, default=_EXACT,
           sets="run.rerun",
           convert=lambda rerun: None if rerun == _EXACT else rerun, changes="nothing",
           help="with --skip-existing, how many finished frames to run again without writing them: "
           "exact, as many as the pixels of an unbroken run need (default), or at most N"),
))


# Denoising and looks

TONEMAP = Option(
    flag="--tonemap", basic=True, metavar="LOOK", type=parse_path, bare="", either="look",
    sets="look.tonemap", excludes={"--overlay=separate": "--overlay separate keeps scene-linear "
                                   "light, --tonemap does not: give one of them"},
    help="tone-map with the default look, or with another one: aces2, agx, pbr_neutral, local or "
    "auto ('postfx models' lists all), neutral, reinhard, ocio:VIEW or FILE.cube,input=SPACE. A "
    "VIEW is part of a view's name, of the config $OCIO or the built-in ACES 2 config; "
    "VIEW@DISPLAY names a display, too",
)
NO_TONEMAP = Option(flag="--no-tonemap", either="look", sets="look.no_tonemap",
                    help="make pictures without a look: apply the exposure, clip, and encode for "
                    "the display")
DISPLAY = Option(
    flag="--display", metavar="NAME", sets="look.display",
    help="display to make pictures for: srgb (default), p3, rec709, rec2020, or in HDR pq or hlg, "
    "e.g. pq,peak=1000,white=203 (nits of the brightest light and of diffuse white). Learned looks "
    "are SDR: their white becomes diffuse white",
)
FAST_LOOK = Option(
    flag="--fast-look", sets="look.fast",
    help="show an OpenColorIO view, a look-up table or a formula through a cube of 65 steps: "
    "faster, and up to 10 of 255 steps off in saturated light. By default every pixel is exact. "
    "Networks are not affected",
)
LOOK_OPTIONS = (TONEMAP, NO_TONEMAP, DISPLAY)
"""Options that say what pictures look like."""


def _roles_unread(overlay: str) -> tuple[Role, ...]:
    """Roles that are taken as absent."""
    from postfx.frame import Role

    return (Role.OVERLAY,) if overlay == "ignore" else ()


def _find_network(tag: str) -> str:
    """A denoiser's file, or its tag; ModelError that names the sizes for any other word."""
    from postfx.passes.denoise.models import FILE, check_is_there

    if not tag.endswith(FILE):
        check_is_there(tag)
    return tag


def find_partner(words: str, enlarges: bool) -> tuple[str | None, str | None]:
    """The pass that --with names, and its options, or None for none; and why auto, which is Open
    Image Denoise, takes none. Where frames are enlarged, mixtures are worse than the network `xl`
    alone. OptionError for any other word that is no pass."""
    from postfx.oidn import is_installed
    from postfx.passes.registry import names

    if words == "auto":
        lack = ("frames are enlarged (--with oidn runs it all the same)" if enlarges
                else None if is_installed() else "it is not installed")
        return (None, lack) if lack else ("oidn", None)
    name = words.partition(",")[0]
    if name.isidentifier() and name not in (*names(), "none"):
        raise OptionError(f"--with {name}{suggest(name, (*names(), 'auto', 'none')) or ':'} give "
                          "oidn, auto, none or a pass of your own ('postfx run --passes' lists "
                          "them)")
    return (None if words == "none" else words), None


def _list_passes() -> str:
    from postfx.passes.registry import describe_passes

    return describe_passes()


DENOISING = Section("denoising and size", (
    Option(flag="--preset", basic=True, choices=tuple(PRESETS), changes="nothing",
           help="preview: the fastest (--model s --run-up 0 --preroll 0 --fast-look); final: "
           "for delivery (--model xl --both-ways --with auto); "
           "animation: steady brightness (--both-ways --exposure smooth). Options that you "
           "give yourself win"),
    Option(flag="--scale", basic=True, metavar="S", type=parse_number, either="size",
           sets="denoiser.scale", excludes=_FOR_DENOISER,
           help="output size over render size, 1 to 3, e.g. 2 for frames twice as large (default: "
           "1, or the guides' size)"),
    Option(flag="--denoise-only", basic=True, either="size", sets="denoiser.scale",
           convert=lambda _: 1.0, also={"sequence.own_size": bool}, excludes=_FOR_DENOISER,
           help="keep the render's size, as --scale 1 does, and leave out larger guides"),
    Option(flag="--size", metavar="WxH", type=parse_size, either="size", sets="denoiser.size",
           excludes=_FOR_DENOISER,
           help="size of the output, overscan included, e.g. 1920x1080. The render's size may then "
           "change from frame to frame, down to a third of it"),
    Option(flag="--no-denoise",
           help="do not denoise or enlarge"),
    Option(flag="--model", basic=True, metavar="TAG|FILE", sets="denoiser.model",
           convert=_find_network, excludes=_FOR_DENOISER,
           help="network of the denoiser: s (the fastest), m, l, or xl (the cleanest); m.fp32 is m "
           "in full precision. Or FILE.onnx with its card beside it, or classic, a filter without "
           "a network. Default: xl; m where memory is short, for larger frames with guides, and "
           "with --budget or --memory"),
    Option(flag="--both-ways", basic=True,
           excludes={
               **_FOR_DENOISER,
               "--budget": "--both-ways runs every frame twice, --budget keeps to a time: give one "
               "of them",
               "--memory": "--both-ways keeps results of 32 frames, --memory keeps to a size: give "
               "one of them",
           },
           help="also denoise the sequence backwards, and mix both results: cleaner frames, above "
           "all a shot's first; takes two to three times as long"),
    Option(flag="--with", metavar="PASS[,OPTION=VALUE]", default="none", off="none",
           excludes={
               **_FOR_DENOISER,
               "--budget": "--with runs another denoiser, --budget keeps to a time: give one of "
               "them",
               "--memory": "--with runs another denoiser, --memory keeps to a size: give one of "
               "them",
           },
           help="also run another denoiser, and mix both results: oidn (Open Image Denoise; needs "
           "the extra 'oidn'), any pass that keeps the frame's size, auto or none (default). Auto "
           "is oidn if it is installed and frames keep their size"),
    Option(flag="--run-up", metavar="N", type=parse_count, off=0,
           excludes={
               "--no-denoise": "--run-up runs frames more than once, --no-denoise has no denoiser "
               "to run up: give one of them",
               "--both-ways": "--run-up runs frames more than once, --both-ways knows the frames "
               "after the first ones anyway: give one of them",
               "--budget": "--run-up runs frames more than once, --budget keeps to a time: give "
               "one of them",
           },
           help="begin a shot by running the N frames after its first one, in reverse order. The "
           "first frame is then as clean as the others. 0 for none (default: 8; none with "
           "--both-ways or --budget)"),
    Option(flag="--budget", metavar="MS", type=parse_number, sets="denoiser.budget",
           excludes=_FOR_DENOISER,
           help="longest time to denoise a frame, in milliseconds: a smaller network runs where "
           "--model would take longer"),
    Option(flag="--strength", metavar="S", type=parse_number, sets="denoiser.strength",
           excludes=_FOR_DENOISER,
           help="how strongly to denoise, from 0 (only resample) to 1 (default), times the AOV "
           "'strength' if there is one"),
    Option(flag="--motion", choices=("auto", "file", "estimate"), default="auto", off="auto",
           sets="sequence.motion", excludes=_FOR_DENOISER,
           help="where motion vectors come from: auto, the files, or an estimate if they have "
           "none, or only zeros although the picture moves (default); file, only the files; "
           "estimate, always an estimate. Estimates use albedo, normals and depth"),
    Option(flag="--clamp-fireflies", metavar="N", type=parse_number,
           sets="sequence.clamp_fireflies", excludes=_FOR_DENOISER,
           help="before denoising, darken pixels that are more than N times (such as 8) as bright "
           "as the third brightest of the 24 around them; the run prints how much light that took"),
    Option(flag="--pixel-filter", metavar="auto|none|PX", sets="denoiser.pixel_filter",
           excludes=_FOR_DENOISER,
           help="standard deviation, in pixels, of the gaussian by which the renderer added each "
           "sample to several pixels. Networks xl and l, and oidn, get frames without it, and it "
           "is applied to their picture. Or auto, to find it by the noise of the first frame "
           "(default), or none"),
))

_ERROR = "error"
"""The name in --aov of what no file holds: what the network expects to be off."""


def _words(names: str) -> list[str]:
    return [word.strip() for word in names.split(",") if word.strip()]


def _name_layers(names: str) -> str | None:
    """What --aov names of the files; None for nothing."""
    layers = [word for word in _words(names) if word != _ERROR]
    return ",".join(layers) or None


def _asks_error(names: str) -> bool:
    return _ERROR in _words(names)


PART_SECTION = Section("masks, light groups and passes", (
    Option(flag="--leave", metavar="NAMES", sets="sequence.leave", excludes=_FOR_DENOISER,
           help="what not to denoise: objects or materials of a Cryptomatte, ids of an AOV, auto "
           "for a noise-free sky, converged:0.01 for pixels whose error is at most 1 %%, or "
           "converged:256spp. Add =S to denoise with strength S, e.g. auto,sky_*,logo=0.5,7-9@id"),
    Option(flag="--reactive", metavar="KIND[,NAME=NUMBER]", sets="denoiser.reactive",
           excludes=_FOR_DENOISER,
           help="how to find pixels that have no motion vectors of their own, such as particles, "
           "so that they leave no ghosts. 'plane' takes the AOV 'reactive'. 'difference' compares "
           "colour with the AOV 'opaque_colour', with scale= and threshold=. 'auto' takes the "
           "first of these that is there (default), 'none' neither"),
    Option(flag="--aov", metavar="NAMES|auto", sets="sequence.aov", convert=_name_layers,
           also={"denoiser.error": _asks_error}, excludes=_FOR_DENOISER,
           help="light groups and passes to denoise with the picture, so that they still add up to "
           "it: names like key,fill,rim, or auto for those that the renderer is known to write "
           "(docs/howto/parts.md). The name error adds the squared error that the network expects "
           "of each pixel"),
    Option(flag="--aov-denoise", metavar="KIND=LAYER,...", sets="sequence.aov_denoise",
           excludes=_FOR_DENOISER,
           help="other layers to denoise with the picture's filters, each with its kind, like "
           "normal=N,mist=Mist: albedo, normal, position, depth, mist, shadow or ao. Ids and "
           "Cryptomattes are never filtered"),
    Option(flag="--aov-filters", choices=("picture", "own"), sets="denoiser.part_filters",
           excludes=_FOR_DENOISER,
           help="filters for the layers of --aov: the picture's (default), or their own, which are "
           "cleaner; each layer then takes as long as the picture"),
    Option(flag="--no-alpha-denoise", sets="denoiser.alpha", convert=lambda leave: not leave,
           excludes=_FOR_DENOISER,
           help="do not denoise alpha, only resample it; by default it is denoised where it has "
           "values between 0 and 1"),
    Option(flag="--overlay", choices=("composite", "separate", "ignore"), default="composite",
           sets="sequence.without", convert=_roles_unread,
           help="what to do with a transparency overlay: composite it over the denoised picture "
           "(default), write it as an EXR layer of its own, or ignore it"),
))

LOOK_SECTION = Section("look", (
    TONEMAP,
    NO_TONEMAP,
    Option(flag="--exposure", basic=True, metavar="auto|smooth|lit|metadata|EV", default="auto",
           help="exposure of pictures, in stops, or how to find it: auto, metered frame by frame "
           "(default); smooth, metered on the whole sequence; metadata, from the header; lit, from "
           "the header, else 0"),
    DISPLAY,
    FAST_LOOK,
    Option(flag="--dither", choices=("moving", "static", "none"), default="moving",
           sets="writer.dither",
           help="dithering of 8-bit pictures: another pattern in each frame (default), always the "
           "same one, or none"),
    Option(flag="--pass", metavar="NAME[,OPTION=VALUE]", repeated=True,
           help="also run a pass, such as another package's: before tone mapping, first if it "
           "reads the render, or where before=PASS or after=PASS say, e.g. "
           "vignette,amount=0.5,after=tonemap; may be repeated "
           "(docs/howto/passes.md)"),
    Option(flag="--passes", changes="nothing", shows=_list_passes,
           help="list all installed passes with their options, then stop"),
))


def make_run_up(arguments: argparse.Namespace, sequence: Sequence, cuts: str) -> RunUp | None:
    """The run-up that --run-up asks for; without that option 8 frames, if no other option rules a
    run-up out."""
    from postfx.temporal.reverse_order import RUN_UP, RunUp

    option = RUN["--run-up"]
    frames = RUN_UP if arguments.run_up is None else arguments.run_up
    if not frames or RUN.exclusions(option, arguments):
        return None
    return RunUp(sequence, frames, cuts, over_gaps=arguments.preroll != 0)


def refuse_views(sequence: Sequence, outputs: OutputFiles | None) -> None:
    """WriteError if files cannot hold all views that are asked for, or are for views and there are
    none."""
    from postfx.errors import WriteError
    from postfx.io.pattern import VIEW_FIELD

    if sequence.views and outputs and outputs.display and not outputs.has_views:
        raise WriteError(f"{outputs.pattern}: only EXR holds several views: write EXR, or a file "
                         f"for each: put {VIEW_FIELD} into the name")
    if outputs and outputs.has_views and not sequence.view:
        raise WriteError(f"{outputs.pattern}: {VIEW_FIELD} is for the names of views, and none is "
                         "known: give --view all for stereo files, or leave it out")


def refuse_several_views(arguments: argparse.Namespace, verb: str) -> None:
    """OptionError if more than one view is given to a verb that looks at one."""
    if arguments.view and (arguments.view == "all" or "," in arguments.view):
        raise OptionError(f"--view {arguments.view}: 'postfx {verb}' uses one view: give --view "
                          "one name")


def refuse_layer(arguments: argparse.Namespace, outputs: OutputFiles | None) -> None:
    """WriteError if the overlay cannot be written beside the colour: its light is scene-linear."""
    from postfx.errors import WriteError

    if arguments.overlay == "separate" and outputs and outputs.display:
        raise WriteError("--overlay separate writes a layer, which only EXR holds: write EXR, or "
                         "composite the overlay")


def explain_overlay(arguments: argparse.Namespace, files: FrameFiles) -> list[Skip]:
    """What is not composited, and the colour that is not denoised because another one is."""
    from postfx.frame import Role
    from postfx.plan import Skip

    found = ([] if arguments.overlay == "composite"
             else [Skip("overlay", f"--overlay {arguments.overlay}")])
    colour = files.match(Role.COLOUR)
    if colour.rule.role is Role.OPAQUE_COLOUR:
        found.append(Skip("colour with transparents",
                          f"{colour.names} is denoised under the overlay"))
    return found


# Reading and running

DEPTH_OPTION = Option(
    flag="--depth", metavar="KIND[,NAME=NUMBER]", sets="sequence.depth",
    help="what the depth AOV holds: planar (along the view axis), ray (from the eye), device (a "
    "depth buffer), reversed, normalised or normalised-reversed. Give near, far, fov, miss and "
    "scale where needed, e.g. reversed,near=0.1 (default: by the profile)",
)

COLOURSPACE = Option(
    flag="--colourspace", metavar="NAME", sets="sequence.colourspace",
    help="linear primaries of the colours: rec709, p3, rec2020, acescg or aces2065-1 (default: by "
    "the headers colorInteropID or chromaticities, else rec709)",
)

LAYER = Option(flag="--layer", metavar="NAME", sets="sequence.layer",
               help="view layer, or other layer, to read (default: the view layer with the most "
               "AOVs)")
VIEW_OPTION = Option(flag="--view", metavar="NAMES", sets="sequence.view",
                     help="view of stereo files to read, e.g. left (default: the first, or all "
                     "where INPUT has {view}). 'postfx run' takes several, as left,right or all. "
                     "It writes them into one EXR, or into a file each where OUTPUT has {view}")
FILES = Options(Section("", (COLOURSPACE, LAYER, VIEW_OPTION)))
"""What every verb that reads frames must let the user say about them."""


def parse_cuts(text: str) -> tuple[int, ...] | None:
    """Frames at which shots begin, as --cuts says: 'auto' gives None, 'none' none, else '1,48' or
    '1-100x10'.

    Raises CutError for anything else.
    """
    from postfx.errors import CutError, SequenceError
    from postfx.io.pattern import parse_frames

    if text in ("auto", "none"):
        return None if text == "auto" else ()
    try:
        return tuple(parse_frames(text))
    except SequenceError:
        raise CutError(f"cuts '{text}': use auto, none, or the frames at which shots begin, e.g. "
                       "1,48,90") from None


READING = Section("reading and running", (
    Option(flag="--profile", metavar="NAME|FILE", type=parse_path, sets="sequence.profile",
           is_file=True,
           help="the renderer's names for its AOVs: a built-in profile or a TOML file (default: "
           "found from the file)"),
    DEPTH_OPTION,
    *FILES,
    Option(flag="--cuts", once=True, metavar="auto|none|FRAMES", default="auto",
           sets="sequence.cuts", convert=parse_cuts,
           help="where shots begin: auto, found by headers and pictures (default); none; or frame "
           "numbers, e.g. 1,48,90. Frames never use those of another shot"),
    Option(flag="--wrap", choices=("auto", "x", "none"), default="auto", off="auto",
           help="whether the left and the right edge meet, as in panoramas: x, without a seam; "
           "none; auto, as the header says (default)"),
    Option(flag="--device", choices=("auto", "cpu", "cuda"), default="auto", sets="device.name",
           help="where to run"),
    Option(flag="--provider", once=True, metavar="NAME[,OPTION=VALUE...]", sets="device.provider",
           changes="rounding",
           help="run networks on an execution provider of ONNX Runtime, with options of its own, "
           "e.g. OpenVINO,device_type=CPU. library=FILE or PACKAGE loads a provider that is a "
           "plug-in. Everything else stays on the CPU"),
    Option(flag="--memory", metavar="SIZE", sets="device.memory", changes="rounding",
           help="limit of the process's memory, e.g. 4G: frames are processed in tiles, and large "
           "tensors are kept in temporary files (TMPDIR); CPU only (default: no limit)"),
    Option(flag="--threads", metavar="N", type=parse_positive, sets="device.threads",
           changes="nothing", help="CPU threads (default: all usable cores)"),
    Option(flag="--ray", once=True, metavar="ADDRESS[,size=N]", type=parse_ray, changes="nothing",
           excludes=dict.fromkeys(("--json", "--report", "--capture"),
                                  "--ray has other machines run the sequence, in chunks: leave "
                                  "--json, --report and --capture out"),
           help="run on the machines of a Ray cluster (HOST:PORT, ray://HOST:PORT, auto, or local "
           f"for this machine), in chunks of N frames (default: {CHUNK_FRAMES}) as 'postfx chunks' "
           "makes them (docs/howto/farm.md)"),
))


# Reports and captures

REPORTS = Section("reports", (
    Option(flag="--dry-run", basic=True, once=True, changes="nothing",
           help="check everything as a run would, show what would be read, run and written, then "
           "stop"),
    Option(flag="--explain", once=True, changes="nothing",
           help="show what would run on the first frame, with which network, and what is skipped "
           "and why, then stop; needs no OUTPUT"),
    Option(flag="--quiet", short="-q", either="words", changes="nothing",
           help="print warnings and errors only"),
    Option(flag="--verbose", short="-v", either="words", changes="nothing",
           help="also print what is going to run, and the time of each pass in each frame"),
    Option(flag="--json", once=True, changes="nothing",
           help="print one JSON object on standard output at the end"),
    Option(flag="--live", once=True, metavar="tev[:HOST[:PORT]]", changes="nothing",
           help="send each frame to the viewer tev as it is made; a viewer that is missing or "
           "closed stops nothing"),
    Option(flag="--report", once=True, metavar="HTML", type=parse_path, sets="page.path",
           changes="nothing",
           excludes={"--memory": "--report keeps whole frames in memory: leave --memory out"},
           help="write an HTML page that needs no network: before and after with an exposure "
           "slider, curves over the frames, times, what was skipped, mistakes that were found, and "
           "a picture of every AOV"),
    Option(flag="--reference", once=True, metavar="FRAMES", sets="page.reference",
           changes="nothing",
           needs={"--report": "--reference is for --report FILE.html: give both"},
           help="noise-free frames at output size, numbered like INPUT: the report compares with "
           "them by PSNR and FLIP (needs the extra 'bench')"),
))

_NEEDS_CAPTURE = {"--capture": "--capture-frame, --capture-tensors and --capture-network need "
                  "--capture DIR: where to write the capture"}

CAPTURE = Section("capture", (
    Option(flag="--capture", once=True, metavar="DIR", type=parse_path, sets="capture.folder",
           changes="nothing",
           help="write DIR/capture.html, a page on one frame's commands: times, memory, "
           "dependencies, tensors, networks"),
    Option(flag="--capture-frame", once=True, metavar="N", type=parse_count, sets="capture.number",
           needs=_NEEDS_CAPTURE, changes="nothing",
           help="frame to capture (default: the second, which has a history)"),
    Option(flag="--capture-tensors", once=True, choices=("thumbnails", "none", "all"),
           sets="capture.tensors", needs=_NEEDS_CAPTURE, changes="nothing",
           help="what to keep of each tensor: figures and small pictures (default), nothing, or "
           "everything, in DIR/tensors, for 'postfx capture-compare'"),
    Option(flag="--capture-network", once=True, sets="capture.network", needs=_NEEDS_CAPTURE,
           changes="nothing",
           help="also run the frame's networks once more, node by node: figures, pictures and time "
           "of each node"),
))

RUN = Options(FRAME_SECTION, DENOISING, LOOK_SECTION, PART_SECTION, FILES_WRITTEN, READING,
              LOG_SECTION, REPORTS, CAPTURE)
"""All of them."""
