"""`postfx interpolate`: frames between the frames of a sequence."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from postfx.cli.options import Option, Options, Section, parse_from_zero, parse_positive
from postfx.cli.run_options import DEPTH_OPTION, FILES, INPUT, RUN, parse_cuts

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

    from postfx.frame import Frame
    from postfx.interpolate import Between
    from postfx.interpolate.timing import Moment, Times
    from postfx.io.sequence import Sequence
    from postfx.io.writer import OutputFiles

DESCRIPTION = """\
Make new frames between those of a sequence: twice as many, or for another frame rate. Motion
vectors and depth lead each pixel from both frames to the new time; without vectors, motion is
estimated from the pictures. Light stays scene-linear: interpolate renders or denoised frames,
before tone mapping.

The new sequence is numbered from the first frame's number on. Frame rate and time code in the
headers are adapted. Across a cut, and where nothing changes, the nearer frame is repeated. No
frames are made beside a missing one. Both cases are reported with the reason.
"""
EXAMPLES = """\
examples:
  postfx interpolate clean/shot.####.exr -o out/shot.####.exr
  postfx interpolate clean/shot.####.exr -o out/shot.####.exr --times 4 --planes
  postfx interpolate clean/shot.####.exr -o out/shot.####.exr --times 0.25,0.5
  postfx interpolate clean/shot.####.exr -o out/shot.####.exr --fps 24:60
  postfx interpolate clean/shot.####.exr -o out/shot.####.exr --overlays hud/shot.####.exr

exit codes: 0 done; 2 an error whose message says how to fix it; 3 done, but without frames beside
missing ones
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    INTERPOLATE.add_to(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Interpolate a sequence; returns the exit code."""
    from postfx.cli.interruptions import EXIT_FAULTS
    from postfx.cli.summary import FrameProgress
    from postfx.cli.told import Told

    INTERPOLATE.refuse_conflicts(arguments)
    job = Interpolation(arguments)
    with FrameProgress(job.total) as progress, Told(lambda text: progress.note(f"warning  {text}")):
        progress.start(0)
        if job.reading:
            progress.note(job.reading)
        for number, reason in job.run(progress.advance):
            progress.note(f"frame {number}: {reason}")
    print(json.dumps(job.as_dict()) if arguments.json else job.text())
    return EXIT_FAULTS if job.summary.skipped else 0


SHUTTER_SAMPLES = 8
"""Times within an open shutter."""


def _parse_shutter(text: str) -> float:
    """An angle of a shutter, as argparse's `type`."""
    angle = parse_from_zero(text)
    if angle > 360:
        raise argparse.ArgumentTypeError(f"'{text}' is not an angle from 0 to 360")
    return angle


INTERPOLATE = Options(Section("", (
    INPUT,
    Option(flag="--output", short="-o", metavar="OUTPUT",
           help="EXR files to write: a pattern or a folder"),
    Option(flag="--times", metavar="N|T,...",
           help="how many times as many frames, or times between two frames, e.g. 0.25,0.5 "
           "(default: 2)"),
    Option(flag="--fps", metavar="OLD[:NEW]",
           help="frame rates: 24:60 makes 60 frames a second of 24. One number is the rate of "
           "INPUT, for files whose headers lack it"),
    Option(flag="--frames", metavar="RANGE", help="frames to use, e.g. 1-100"),
    Option(flag="--shutter", metavar="DEGREES", type=_parse_shutter, default=0.0,
           help="add motion blur to renders that have none: how long the shutter is open, where "
           f"360 is all of a new frame; the mean of {SHUTTER_SAMPLES} times (default: 0, none)"),
    Option(flag="--planes",
           help="write depth, motion, normals, reflectances and Cryptomattes of all frames, too, "
           "so that passes after this one can use them; the files hold floats"),
    Option(flag="--aov", metavar="NAMES|auto", sets="sequence.aov",
           help="make light groups and passes, too, which then add up to the picture: names like "
           "key,fill, or auto for those that the renderer is known to write"),
    Option(flag="--no-flow",
           help="do not estimate motion if there are motion vectors: faster, but shadows and "
           "reflections are only cross-faded"),
    Option(flag="--overlay", choices=("mix", "hold"), default="mix",
           help="between frames, mix the overlay's layer, or keep that of the frame before "
           "(default: mix)"),
    Option(flag="--composited",
           help="the picture already includes the overlay's layer: remove it first, and composite "
           "it over the result"),
    Option(flag="--overlays", metavar="FRAMES", is_file=True,
           excludes={"--composited": "--overlays are composited over pictures without one: leave "
                     "--composited out"},
           help="overlays for all frames of OUTPUT, numbered like it, to composite over the "
           "pictures"),
    Option(flag="--reference", metavar="FRAMES", is_file=True,
           help="rendered frames, numbered like OUTPUT: print the PSNR of each new frame that was "
           "also rendered"),
    Option(flag="--overwrite", help="replace output files that are there"),
    Option(flag="--bits", metavar="N", type=parse_positive, sets="writer.bits",
           help="bits of a channel: 16 (half floats, default) or 32 (floats, default with "
           "--planes)"),
    RUN["--compression"],
    RUN["--profile"],
    DEPTH_OPTION,
    *FILES,
    Option(flag="--cuts", metavar="auto|none|FRAMES", default="auto", sets="sequence.cuts",
           convert=parse_cuts,
           help="where shots begin: by headers and pictures, nowhere, or at these frames (default: "
           "auto)"),
    Option(flag="--json", help="print one JSON object"),
)))


CRYPTOMATTE = "cryptomatte/"
"""How the names of a Cryptomatte's attributes begin."""


@dataclass
class Summary:
    """What became of a sequence: reasons by the numbers of new frames, PSNR in dB by number, and
    how often what time passes in the picture from one new frame to the next, in frames of the
    input: none passes in a repeated one."""

    kept: int = 0
    made: int = 0
    seconds: float = 0.0
    repeated: dict[int, str] = field(default_factory=dict)
    skipped: dict[int, str] = field(default_factory=dict)
    psnr: dict[int, float] = field(default_factory=dict)
    intervals: dict[float, int] = field(default_factory=dict)


class Interpolation:
    """Everything that the arguments ask for. Raises PostfxError where they do not fit together."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        from postfx.cuts import CutDetector
        from postfx.errors import OptionError, WriteError
        from postfx.frame import Role
        from postfx.interpolate.timing import parse_times
        from postfx.io.sequence import read_sequence
        from postfx.io.writer import ExistingFiles, OutputFiles

        if not arguments.output:
            raise WriteError("nowhere to write: give -o OUTPUT, e.g. -o out/between.####.exr")
        self._arguments = arguments
        self._times: Times = parse_times(arguments.times, arguments.fps)
        values = INTERPOLATE.values_for("sequence", arguments)
        self._sequence: Sequence = read_sequence(arguments.input, arguments.frames, **values)
        self._sequence.refuse_none()
        existing = ExistingFiles.OVERWRITE if arguments.overwrite else ExistingFiles.REFUSE
        self._outputs: OutputFiles = OutputFiles(arguments.output, self._sequence, existing,
                                                 can_skip=False)
        if self._outputs.display:
            raise WriteError(f"{arguments.output}: is for a display: write EXR and tone-map it "
                             "afterwards")
        if len(self._sequence) < 2:
            raise OptionError(f"{self._sequence.pattern}: one frame is not enough: give two or "
                              "more")
        self._moments: list[Moment] = list(self._times.moments(self._sequence.numbers))
        self._outputs.check(tuple(moment.number for moment in self._moments))
        self._overlays = (read_sequence(arguments.overlays, planes=[Role.OVERLAY])
                          if arguments.overlays else None)
        self._reference = (read_sequence(arguments.reference, planes=[Role.COLOUR])
                           if arguments.reference else None)
        self._detector = CutDetector() if arguments.cuts == "auto" else None
        self._is_told = False
        self._frames: dict[int, Frame | None] = {}
        self._cuts: set[int] = set()
        self._between: dict[int, Between] = {}
        self._first: dict[str, Any] = {}
        self.summary = Summary()

    @property
    def reading(self) -> str:
        """How numbers that are several apart are understood, and how to ask for the other meaning;
        '' where they follow each other."""
        from postfx.io.pattern import format_frames

        numbers = self._sequence.numbers
        steps = [after - before for before, after in pairwise(numbers)
                 if self._sequence.before(after, 1) == [before]]
        if max(steps, default=1) == 1:
            return ""
        return (f"frames {format_frames(numbers)}: {max(steps)} apart, taken to follow each other; "
                "if frames between them are missing, give --frames="
                f"{numbers[0]}-{numbers[-1]}")

    @property
    def total(self) -> int:
        """How many frames of the new sequence there may be."""
        return len(self._moments)

    def run(self, tell: Callable[[str], None]) -> Iterator[tuple[int, str]]:
        """Write all frames; yields number and reason of those that are repeated or left out. tell:
        is called with the file of each that is written."""
        begin, last = time.perf_counter(), None
        for count, moment in enumerate(self._moments):
            frame, reason = self._make(moment)
            if frame is None:
                self.summary.skipped[moment.number] = reason
            else:
                frame = (self._blur(frame, moment) if self._arguments.shutter and not reason
                         else frame)
                tell(str(self._write(frame, count)))
                shown = moment.start + (moment.t >= 0.5 if reason else moment.t)
                if last is not None:
                    interval = round(shown - last, 4)
                    self.summary.intervals[interval] = self.summary.intervals.get(interval, 0) + 1
                last = shown
                self._compare(frame, moment)
                if reason:
                    self.summary.repeated[moment.number] = reason
                elif moment.t:
                    self.summary.made += 1
                else:
                    self.summary.kept += 1
            if reason:
                yield moment.number, reason
        self.summary.seconds = time.perf_counter() - begin

    def as_dict(self) -> dict[str, Any]:
        """The summary for programs."""
        return {"frames": len(self._sequence), "outputs": str(self._outputs.pattern),
                **vars(self.summary), "warnings": self._sequence.warnings}

    def text(self) -> str:
        """The summary for people."""
        from postfx.cli.summary import count_frames

        found = self.summary
        kept = f"{count_frames(found.kept)} of {self._sequence.pattern}"
        lines = [f"wrote    {self._arguments.output}: {kept}, {found.made} new",
                 f"time     {found.seconds:.1f} s"
                 + (f", {found.seconds / found.made:.2f} s a new frame" if found.made else "")]
        lines += [f"repeated {count_frames(len(found.repeated))}"] * bool(found.repeated)
        lines += [f"left out {count_frames(len(found.skipped))}"] * bool(found.skipped)
        passed = ", ".join(f"{interval:g} ({count} time{'s' * (count > 1)})"
                           for interval, count in sorted(found.intervals.items()))
        lines.append("timing   from one new frame to the next, in frames of "
                     f"{self._sequence.pattern}: {passed}")
        if found.psnr:
            mean = sum(found.psnr.values()) / len(found.psnr)
            lines.append(f"PSNR     {mean:.2f} dB, mean of {len(found.psnr)} new frames against "
                         "the reference")
        lines += [f"warning  {warning}" for warning in self._sequence.warnings]
        return "\n".join(lines)

    def _make(self, moment: Moment) -> tuple[Frame | None, str]:
        """The frame of a moment, with the reason if it is a repeated one; None with the reason if
        there is none."""
        from postfx.interpolate import CUT_REASON

        frame = self._read(moment.start)
        following = self._read(moment.start + 1) if moment.t else frame
        missing = next((index for index, one
                        in ((moment.start, frame), (moment.start + 1, following)) if one is None),
                       None)
        if missing is not None or frame is None:
            absent = self._sequence.numbers[missing or moment.start]
            return None, f"left out, as frame {absent} of the input is missing"
        if not moment.t:
            return self._renumber(frame, moment), ""
        between = self._between_at(moment.start)
        made = between.frame(moment.t, moment.number, moment.previous)
        if not between.reason:
            return made, ""
        first, second = self._sequence.numbers[moment.start : moment.start + 2]
        is_gap = (between.reason == CUT_REASON
                  and self._sequence.before(second, 1) != [first])
        reason = (f"frames {first} and {second} do not follow each other" if is_gap
                  else between.reason)
        return made, f"repeats frame {second if moment.t >= 0.5 else first}, as {reason}"

    def _renumber(self, frame: Frame, moment: Moment) -> Frame:
        """A frame of the input as one of the output, with motion from the new frame before it."""
        from postfx.frame import Role

        planes = dict(frame.planes)
        before = self._read(moment.start - 1) if moment.start else None
        if self._arguments.planes and Role.MOTION in frame and before is not None:
            between = self._between_at(moment.start - 1)
            if between.reason is None:
                planes[Role.MOTION] = between.motion_of_after(moment.previous)
        return replace(frame, planes=planes, number=moment.number)

    def _read(self, index: int) -> Frame | None:
        """A frame of the input; None where it is missing. Each is read once, in order."""
        if index not in self._frames and index < len(self._sequence):
            number = self._sequence.numbers[index]
            frame = self._sequence.read(number) if self._sequence.holds(number) else None
            if frame is not None:
                if not self._is_told:
                    self._is_told = True
                    self._warn_of_left_out(frame)
                    if any(frame.jitter):
                        self._sequence.warn("frames are jittered, and new ones between them are "
                                            "not: run 'postfx run' first, and interpolate its "
                                            "frames")
                if self._arguments.planes:
                    frame = with_cryptomattes(frame)
                self._first = self._first or frame.metadata
                if self._detector is not None and self._detector(frame):
                    self._cuts.add(index)
            self._frames = {other: one for other, one in self._frames.items()
                            if other >= index - 3} | {index: frame}
        return self._frames.get(index)

    def _warn_of_left_out(self, frame: Frame) -> None:
        """Warn of layers of a frame of the input that the output has not."""
        from postfx.io.parts import SHOWN_LAYERS

        with self._sequence.open(frame.number) as files:
            layers = files.unread()
        ways = "--aov NAMES makes those of light"
        if self._arguments.planes:
            mattes = tuple(str(text) for name, text in frame.metadata.items()
                           if name.startswith(CRYPTOMATTE) and name.endswith("/name"))
            layers = [layer for layer in layers if not layer.startswith(mattes)]
        else:
            ways += ", --planes Cryptomattes, nothing the others"
        if layers:
            held = "; ".join(layers[:SHOWN_LAYERS]) + "; ..." * (len(layers) > SHOWN_LAYERS)
            self._sequence.warn(f"new frames lack {held}: {ways}")

    def _between_at(self, index: int) -> Between:
        """The time between a frame, which is there like the one after it, and that one."""
        from postfx.interpolate import Between

        if index not in self._between:
            before, after, later = self._read(index), self._read(index + 1), self._read(index + 2)
            assert before is not None and after is not None, "the caller has read both"
            later = None if index + 2 in self._cuts else later
            made = Between(before, after, later, flow=not self._arguments.no_flow,
                           overlay=self._arguments.overlay,
                           composited=self._arguments.composited, is_cut=index + 1 in self._cuts,
                           last=self._between.get(index - 1))
            self._between = {other: one for other, one in self._between.items()
                             if other == index - 1} | {index: made}
        return self._between[index]

    def _blur(self, frame: Frame, moment: Moment) -> Frame:
        """The frame with the mean of colour and alpha while a shutter is open around its time."""
        import numpy as np

        from postfx.frame import Role

        time, last = moment.start + moment.t, len(self._sequence) - 1
        length = self._arguments.shutter / 360 / float(self._times.ratio or len(self._times.within))
        shown = []
        for k in range(SHUTTER_SAMPLES):
            at = min(max(time + length * ((k + 0.5) / SHUTTER_SAMPLES - 0.5), 0.0), float(last))
            start = min(int(at), last - 1)
            if self._read(start) is not None and self._read(start + 1) is not None:
                shown.append(self._between_at(start).frame(at - start))
        planes = {role: np.mean([one[role] for one in shown], 0)
                  for role in (Role.COLOUR, Role.ALPHA)
                  if shown and all(role in one for one in shown)}
        return replace(frame, planes={**frame.planes, **planes})

    def _write(self, frame: Frame, count: int) -> Path:
        """Write a new frame; returns its file, or that of its first view."""
        from postfx.io.writer import write_frame

        views = {name: self._prepare(view, count) for name, view in frame.views.items()}
        kept = {name: text for name, text in frame.metadata.items() if name.startswith(CRYPTOMATTE)}
        files = self._outputs.split(replace(self._prepare(frame, count), views=views))
        for path, picture in files:
            write_frame(path, picture, provenance=kept if self._arguments.planes else None,
                        **INTERPOLATE.values_for("writer", self._arguments))
        return files[0][0]

    def _prepare(self, frame: Frame, count: int) -> Frame:
        """A frame, or one of its views, as it is written: its header, its overlay and the planes
        beside it."""
        frame = replace(frame, metadata=self._times.header(frame.metadata, count, self._first))
        frame = frame if self._overlays is None else self._with_overlay(frame)
        return with_parts(frame) if self._arguments.planes else frame

    def _with_overlay(self, frame: Frame) -> Frame:
        """The frame under the overlay that is given for it (Porter and Duff 1984)."""
        from postfx.errors import FrameError
        from postfx.frame import Role

        assert self._overlays is not None, "asked only where --overlays is given"
        overlay = self._overlays.read(frame.number)[Role.OVERLAY]
        colour = frame[Role.COLOUR]
        if overlay.shape[:2] != colour.shape[:2]:
            raise FrameError(f"overlay of frame {frame.number} is "
                             f"{overlay.shape[1]}x{overlay.shape[0]}, the picture "
                             f"{colour.shape[1]}x{colour.shape[0]}: render it at the picture's "
                             "size")
        clear = 1 - overlay[..., 3:]
        planes = dict(frame.planes)
        planes.pop(Role.OVERLAY, None)
        planes[Role.COLOUR] = overlay[..., :3] + clear * colour
        if Role.ALPHA in frame:
            planes[Role.ALPHA] = overlay[..., 3:] + clear * frame[Role.ALPHA]
        return replace(frame, planes=planes)

    def _compare(self, frame: Frame, moment: Moment) -> None:
        """Keep the PSNR of a new frame."""
        if self._reference is None or not moment.t or not self._reference.holds(moment.number):
            return
        from postfx.colour.views import to_codes
        from postfx.errors import FrameError
        from postfx.frame import Role
        from postfx.tools.bench.metrics import grey_factor, psnr

        wanted = self._reference.read(moment.number)[Role.COLOUR]
        if wanted.shape != frame[Role.COLOUR].shape:
            height, width, _ = frame[Role.COLOUR].shape
            raise FrameError(f"{self._reference.pattern}: references are {wanted.shape[1]}x"
                             f"{wanted.shape[0]}, the frames {width}x{height}: give them at the "
                             "frames' size")
        factor = frame.exposure_factor or grey_factor(wanted)
        shown = [to_codes(colour, factor) for colour in (frame[Role.COLOUR], wanted)]
        self.summary.psnr[moment.number] = round(psnr(*shown), 3)


_CHANNELS = {"depth": ("depth.Z",), "normal": ("normal.X", "normal.Y", "normal.Z"),
             "diffuse_albedo": ("albedo.R", "albedo.G", "albedo.B"),
             "specular_albedo": ("specular_albedo.R", "specular_albedo.G", "specular_albedo.B"),
             "roughness": ("roughness.Y",), "specular_hit_distance": ("specular_hit_distance.Y",)}
"""Planes that are written beside the picture, and their channels by the generic profile."""


def with_parts(frame: Frame) -> Frame:
    """The frame with its planes as parts, which the writer writes by their generic names, in
    floats."""
    from postfx.frame import PartSource, Role

    planes: dict[str, tuple[np.ndarray, tuple[str, ...]]] = {
        name: (frame[name], channels) for name, channels in _CHANNELS.items() if name in frame}
    if Role.MOTION in frame:
        planes |= {f"motion {axis}": (frame[Role.MOTION][..., k:k + 1], (f"motion.{axis}",))
                   for k, axis in enumerate("XY")}
    sources = {name: PartSource(channels, exact=True) for name, (_, channels) in planes.items()}
    return replace(frame,
                   parts={**frame.parts, **{name: plane for name, (plane, _) in planes.items()}},
                   part_sources={**frame.part_sources, **sources})


def with_cryptomattes(frame: Frame) -> Frame:
    """The frame with the Cryptomattes of its file as parts that are copied bit for bit. Those of
    another size are left out. Raises StrengthError for a broken one."""
    from pathlib import Path

    from postfx.frame import PartSource
    from postfx.io.channels import ChannelIndex, read_channels
    from postfx.io.image_file import ImageFile
    from postfx.io.masks import cryptomattes

    if frame.source is None or not any(name.startswith(CRYPTOMATTE) for name in frame.metadata):
        return frame
    path, parts = Path(frame.source), dict(frame.parts)
    with ImageFile(path) as file:
        for matte in cryptomattes(ChannelIndex({"": file.parts}), frame.metadata, path):
            pixels = read_channels({"": file}, dict.fromkeys(matte.channels, 0.0))
            for k, channel in enumerate(matte.channels):
                if pixels[channel].shape == (frame.spec.height, frame.spec.width):
                    parts[f"{matte.name}{k // 4:02d}.{'RGBA'[k % 4]}"] = pixels[channel]
    sources = {name: PartSource((name,), exact=True) for name in parts.keys() - frame.parts.keys()}
    return replace(frame, parts=parts, part_sources={**frame.part_sources, **sources})
