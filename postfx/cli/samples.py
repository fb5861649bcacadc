"""`postfx samples`: where a shot needs more samples until its denoised frames are good enough."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from postfx.cli.options import Option, Options, Section, parse_from_zero, parse_positive
from postfx.cli.run_options import FILES, INPUT, RUN

if TYPE_CHECKING:
    import numpy as np

    from postfx.frame import Frame
    from postfx.tools.adaptive.plan import Outlook, Tiles

DESCRIPTION = """\
Say how many more samples each tile of a shot needs until its denoised frames reach a quality. This
is the PSNR against a perfect render, on the display: 'visible' (36 dB), 'draft' (30 dB), 'fine' (42
dB), or 38dB; or a FLIP like flip=0.05. With --budget the samples go where they lower the error of
the shot most, or its FLIP if that is the quality.

INPUT are the renders before denoising. The error of the denoised frames is measured where --halves
gives as many samples again with another seed: each half, denoised, is compared with the other. Else
it comes from an AOV 'error' in INPUT or --error, or is guessed from what the denoiser takes away,
often wrong by a factor of two. Frames are denoised for it, unless --denoised names the result.

OUTPUT are EXR files with the channels samples.Y (more samples), error.Y (expected squared error
now) and after.Y (with these samples). --json prints rectangles to render for a farm or a script.
"""
EXAMPLES = """\
examples:
  postfx samples 'shot/####.exr' --quality visible -o 'map/####.exr'
  postfx samples 'seed1/####.exr' --halves 'seed2/####.exr' --quality flip=0.05 \\
    --budget 32 --json > more.json
  postfx samples 'shot/####.exr' --denoised 'clean/####.exr' --pictures heat/
  postfx samples 'shot/####.exr' --error 'clean/####.exr' --tile 64 -o 'map/####.exr'
  postfx samples 'shot/####.exr' --leave auto,converged:0.01 -o 'map/####.exr'
"""


SAMPLE_OPTIONS = Options(Section("", (
    INPUT,
    Option(flag="--output", short="-o", metavar="OUTPUT",
           help="EXR files to write: a pattern, a folder or one file"),
    Option(flag="--quality", metavar="WORD|dB|flip=F", default="visible",
           help="draft, visible (default), fine, a PSNR like 38dB, or a FLIP like flip=0.05, for "
           "each tile"),
    Option(flag="--budget", metavar="N", type=parse_from_zero,
           help="at most so many more samples a pixel, on average over the shot (default: as many "
           "as the quality needs)"),
    Option(flag="--tile", metavar="N", type=parse_positive, default=32,
           help="side of a tile in pixels (default: 32)"),
    Option(flag="--error", metavar="FRAMES", is_file=True,
           help="files with the AOV 'error', numbered like INPUT (default: INPUT and --denoised)"),
    Option(flag="--halves", metavar="FRAMES", is_file=True,
           excludes={"--error": "{flag} and --error both tell the error: give one of them"},
           help="INPUT rendered again with another seed and as many samples: both together are the "
           "shot"),
    Option(flag="--denoised", metavar="FRAMES", is_file=True, several=True,
           help="INPUT denoised at its own size; with --halves three: INPUT, --halves and both "
           "merged (default: denoise them here)"),
    Option(flag="--samples", metavar="N", type=parse_positive,
           help="samples a pixel of INPUT (default: by its header)"),
    Option(flag="--seconds", metavar="S", type=parse_from_zero,
           help="seconds that a frame of INPUT took to render (default: by its header)"),
    Option(flag="--exposure", metavar="auto|metadata|EV", default="auto",
           help="as for 'postfx run' (default: auto)"),
    Option(flag="--pictures", metavar="DIR",
           help="write a PNG of each frame: picture, error, samples"),
    Option(flag="--frames", metavar="RANGE", help="frames of the shot, e.g. 1-100"),
    Option(flag="--overwrite", help="replace output files that are there"),
    RUN["--leave"]._replace(excludes={}),
    RUN["--model"]._replace(excludes={}, basic=False),
    RUN["--profile"],
    *FILES,
    Option(flag="--device", choices=("auto", "cpu", "cuda"), default="auto", help="where to run"),
    Option(flag="--json", help="print one JSON object"),
)))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    SAMPLE_OPTIONS.add_to(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Measure, plan and write; returns the exit code."""
    job = SamplesJob(arguments)
    job.measure()
    job.write()
    print(json.dumps(job.as_dict()) if arguments.json else job.text())
    return 0


class SamplesJob:
    """Everything that the arguments ask for. Raises PostfxError where they do not fit together."""

    def __init__(self, arguments: argparse.Namespace, is_quiet: bool = False) -> None:
        from postfx.errors import OptionError, WriteError
        from postfx.exposure import ExposureMeter
        from postfx.frame import Role
        from postfx.io.sequence import Sequence, read_sequence
        from postfx.io.writer import ExistingFiles, OutputFiles
        from postfx.tools.adaptive.plan import parse_quality

        SAMPLE_OPTIONS.refuse_conflicts(arguments)
        self._arguments, self._is_quiet = arguments, is_quiet
        self.quality = parse_quality(arguments.quality)
        if arguments.tile < 8:
            raise OptionError(f"--tile {arguments.tile}: is too small to render: give 8 or more, "
                              "such as 32 or 64")
        if not (arguments.output or arguments.json or arguments.pictures):
            raise WriteError("nowhere to write: give -o OUTPUT, --pictures DIR or --json")
        values = SAMPLE_OPTIONS.values_for("sequence", arguments)
        self._sequence = read_sequence(arguments.input, arguments.frames, **values).first_view()
        others = ([read_sequence(arguments.halves, **values).first_view()] if arguments.halves
                  else [])
        self._halves = [self._sequence, *others]
        given = arguments.denoised or []
        names = [given] if isinstance(given, str) else given
        if names and len(names) != (3 if others else 1):
            raise OptionError(f"--denoised {' '.join(names)}: give one for INPUT, or with --halves "
                              "three: of INPUT, of --halves, and of both merged")
        self._denoised = [read_sequence(name, planes=[Role.COLOUR]) for name in names]
        self._errors = Sequence(arguments.error) if arguments.error else None
        self._meter = ExposureMeter(arguments.exposure)
        existing = ExistingFiles.OVERWRITE if arguments.overwrite else ExistingFiles.REFUSE
        self._outputs = (OutputFiles(arguments.output, self._sequence, existing, can_skip=False)
                         if arguments.output else None)
        if self._outputs:
            if self._outputs.display:
                raise WriteError(f"{arguments.output}: maps are EXR files: --pictures writes PNG")
            self._outputs.check(self._sequence.numbers)
        self._sequence.refuse_holes(self._sequence.numbers)
        self.tiles: list[Tiles] = []
        self.plan: list[np.ndarray] = []
        self._thumbs: list[np.ndarray] = []
        self.sources: set[str] = set()
        self._tell: Callable[[str], None] = lambda text: None

    def measure(self) -> None:
        """Find the tiles of all frames, and plan their samples."""
        from postfx.cli.summary import FrameProgress
        from postfx.colour.views import to_codes
        from postfx.frame import Role
        from postfx.io.render_time import render_seconds
        from postfx.tools.adaptive.pictures import thumbnail
        from postfx.tools.adaptive.plan import make_tiles, plan_samples

        with FrameProgress(len(self._sequence), self._is_quiet) as progress:
            self._tell = progress.note
            progress.start(0)
            for frame, denoised, error in self._frames():
                seconds = self._arguments.seconds or render_seconds(frame.metadata)
                seconds = seconds and seconds * len(self._halves)
                strength = frame.planes.get(Role.STRENGTH)
                self.tiles.append(make_tiles(frame.number, error, self._samples(frame),
                                             None if strength is None else strength[:, :, 0],
                                             self._arguments.tile, seconds))
                if self._arguments.pictures:
                    self._thumbs.append(thumbnail(to_codes(denoised, self._meter(frame))))
                progress.advance(f"frame {frame.number}")
        self.plan = plan_samples(self.tiles, self.quality, self._arguments.budget)

    def write(self) -> None:
        """Write maps and pictures."""
        from postfx.io.writer import write_channels
        from postfx.tools.adaptive.pictures import write_picture
        from postfx.tools.adaptive.plan import spread

        for index, (tiles, more) in enumerate(zip(self.tiles, self.plan, strict=True)):
            if self._outputs:
                planes = {"samples.Y": more, "error.Y": tiles.errors,
                          "after.Y": tiles.error_with(more)}
                write_channels(self._outputs.path(tiles.number),
                               {name: spread(tiles, values) for name, values in planes.items()})
            if self._arguments.pictures:
                path = Path(self._arguments.pictures) / f"samples.{tiles.number:04d}.png"
                write_picture(path, self._thumbs[index], tiles, more, self.quality)

    def as_dict(self) -> dict[str, Any]:
        """The plan for programs."""
        from postfx.tools.adaptive.plan import find_regions, psnr

        frames = []
        for tiles, more in zip(self.tiles, self.plan, strict=True):
            counted = max(float(tiles.counted.sum()), 1)
            now, after = (float((error * tiles.counted).sum()) / counted
                          for error in (tiles.errors, tiles.error_with(more)))
            frames.append({
                "frame": tiles.number, "width": tiles.size[0], "height": tiles.size[1],
                "samples": float((tiles.samples * tiles.areas).sum() / tiles.areas.sum()),
                "more_samples": float((more * tiles.areas).sum() / tiles.areas.sum()),
                "psnr": psnr(now), "psnr_after": psnr(after),
                "regions": [region.__dict__ for region in find_regions(tiles, more)],
            })
        found = self._outlook()
        return {"quality": self.quality.words, "quality_psnr": self.quality.psnr,
                "tile": self._arguments.tile,
                "error_from": sorted(self.sources), "frames": frames, "psnr": psnr(found.now),
                "psnr_after": psnr(found.after), "more_samples": found.more,
                "uniform_samples": found.uniform, "hours": found.hours,
                "uniform_hours": found.uniform_hours, "tiles_done": found.done}

    def text(self) -> str:
        """The plan for people."""
        from postfx.tools.adaptive.plan import psnr

        found = self._outlook()
        marked, count = (sum(int(number) for number in numbers) for numbers in
                         ([(more > 0).sum() for more in self.plan],
                          [more.size for more in self.plan]))
        lines = [f"quality  {self.quality.words}: {self.quality.psnr:.1f} dB in each tile; the "
                 f"shot has {psnr(found.now):.1f} dB, by {' and '.join(sorted(self.sources))}",
                 f"render   {marked} of {count} tiles again: {found.more:.1f} more samples a pixel "
                 f"in the mean, then about {psnr(found.after):.1f} dB, and {found.done:.0%} of the "
                 "tiles are done"]
        if found.uniform > found.more > 0:
            hours = ("" if found.hours is None or found.uniform_hours is None else
                     f": {_duration(found.hours)} in place of {_duration(found.uniform_hours)}")
            lines.append(f"saves    {1 - found.more / found.uniform:.0%} of the samples that the "
                         f"same error would need everywhere ({found.uniform:.1f} a pixel){hours}")
        if self._outputs:
            first, last = (self._outputs.path(self.tiles[at].number) for at in (0, -1))
            lines.append(f"wrote    {first}" + f" ... {last}" * (last != first))
        return "\n".join(lines)

    def _outlook(self) -> Outlook:
        from postfx.tools.adaptive.plan import look_ahead

        return look_ahead(self.tiles, self.plan, self.quality)

    def _frames(self) -> Iterator[tuple[Frame, np.ndarray, np.ndarray]]:
        """Each frame, its denoised colour (its own where that is not needed) and the expected
        error."""
        from postfx.errors import FrameError, MissingPlaneError
        from postfx.frame import Role
        from postfx.other_shots import is_other_picture, squares_of
        from postfx.repeats import is_same_render
        from postfx.tools.adaptive.estimate import estimate_error, estimate_from_halves, mean_frame

        denoisers: list[Any] = []
        for frame in self._sequence:
            renders = [frame, *(half.read(frame.number) for half in self._halves[1:])]
            renders += [mean_frame(*renders)] if len(renders) == 2 else []
            error = None if len(renders) > 1 else self._read_error(frame)
            denoised = [render[Role.COLOUR] for render in renders]
            if self._denoised:
                denoised = [one.read(frame.number)[Role.COLOUR] for one in self._denoised]
            elif error is None:
                # What is denoised of a half must not know the other one, not even by its history.
                denoisers = denoisers or self._make_denoisers()
                denoised = [denoise(render)[Role.COLOUR]
                            for denoise, render in zip(denoisers, renders, strict=False)]
            if len(renders) > 1:
                halves = renders[0][Role.COLOUR], renders[1][Role.COLOUR]
                if is_same_render(*halves):
                    raise FrameError(f"{renders[1].source}: has the same noise as "
                                     f"{frame.source}: render it with another seed")
                if is_other_picture(*map(squares_of, halves)):
                    raise FrameError(f"{renders[1].source}: shows another picture than "
                                     f"{frame.source}: give the same shot, rendered with another "
                                     "seed")
                error = estimate_from_halves(halves, (denoised[0], denoised[1], denoised[2]),
                                             self._meter(frame), self._arguments.tile)
                self.sources.add("two halves of the samples")
            elif error is None:
                error = estimate_error(frame, denoised[0], self._meter(frame))
                self.sources.add("an estimate from the noise")
            elif error.shape != frame[Role.COLOUR].shape[:2]:
                raise MissingPlaneError(f"{frame.source}: has another size than the AOV 'error' of "
                                        "its frame: write that at the render's size")
            else:
                self.sources.add("the AOV 'error'")
            yield frame, denoised[-1], error

    def _read_error(self, frame: Frame) -> np.ndarray | None:
        """The plane 'error' of a frame, from the files that are to have it, or else from those that
        may."""
        from postfx.errors import MissingPlaneError
        from postfx.tools.adaptive.estimate import read_error

        places = [self._errors] if self._errors else [self._sequence, *self._denoised]
        paths = [path for place in places for path in place.files(frame.number).values()]
        found = next((error for error in map(read_error, paths) if error is not None), None)
        if found is None and self._errors:
            raise MissingPlaneError(f"{paths[0]}: no AOV 'error': write it with 'postfx run --aov "
                                    "error', or leave --error out")
        return found

    def _make_denoisers(self) -> list[Any]:
        """A denoiser for INPUT, or for both halves and what they are together."""
        from postfx.cli.usual_network import choose_network
        from postfx.passes.denoise import DenoiseUpscale
        from postfx.pipeline import Pipeline
        from postfx.runtime import Device
        from postfx.temporal.reverse_order import RunUp

        device = Device(self._arguments.device)
        options = {"scale": 1.0, **SAMPLE_OPTIONS.values_for("denoiser", self._arguments)}
        if "model" not in options:
            with self._sequence.open(self._sequence.numbers[0]) as files:
                options["model"] = choose_network(files.spec(), options, device).network
            self._tell(f"denoising with {options['model']}, as 'postfx run' does; --denoised takes "
                       "the frames that a run has made")
        shots = [*self._halves, self._sequence] if len(self._halves) > 1 else [self._sequence]
        return [Pipeline([DenoiseUpscale(**options)], device, run_up=RunUp(shot)) for shot in shots]

    def _samples(self, frame: Frame) -> Any:
        """Samples of each pixel, or of all; a half has half of them."""
        from postfx.errors import MissingPlaneError
        from postfx.frame import Role
        from postfx.masks.noise import count_unit

        samples = self._arguments.samples or frame.samples
        if Role.SAMPLE_COUNT in frame:
            counts = frame[Role.SAMPLE_COUNT]
            return counts[:, :, 0] * count_unit(counts, samples) * len(self._halves)
        if not samples:
            raise MissingPlaneError(f"{frame.source}: its header does not say how many samples a "
                                    "pixel it has: give --samples N")
        return samples * len(self._halves)


def _duration(hours: float) -> str:
    """'40 s', '25 min' or '3.2 hours'."""
    if hours < 1 / 30:
        return f"{3600 * hours:.0f} s"
    return f"{60 * hours:.0f} min" if hours < 2 else f"{hours:.1f} hours"
