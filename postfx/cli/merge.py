"""`postfx merge`: renders of the same frames with different seeds as one."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING

from postfx.cli.options import Option, Options, Section, parse_positive
from postfx.cli.run_options import RUN

if TYPE_CHECKING:
    from postfx.io.exr.merge import Merged
    from postfx.io.sequence import Sequence

DESCRIPTION = """\
Merge renders of the same frames that differ in their seed, as one render with the samples of all.
Each pixel is weighted by its number of samples: by headers (Cycles, pbrt, postfx:spp), an AOV of
sample counts, or --samples.

Colours, alpha, reflectances, light groups and noise estimates are averaged; unit normals stay so.
Ids and Cryptomattes, depth, positions and motion come from the first render that has the
pixel. Samples and render times in the headers are added up. A render of a region counts only there:
by its data window, its sample counts, or the rectangle that holds its light. Where samples then
differ, an AOV of counts is written, by which the result can be merged again.
"""
EXAMPLES = """\
examples:
  postfx merge seed1.exr seed2.exr seed3.exr -o merged.exr
  postfx merge seed1.exr seed2.exr -o merged.exr --samples 16,64
  postfx merge 'first/shot.####.exr' 'second/shot.####.exr' -o 'merged/shot.####.exr'
  postfx merge frame.exr tile_3_7.exr tile_4_7.exr -o better.exr

Put patterns in quotes: each argument is one render of all frames. Frames that a later render lacks
are merged from the others.
"""


def _parse_samples(text: str) -> list[int]:
    return [parse_positive(word.strip()) for word in text.split(",")]


MERGE_OPTIONS = Options(Section("", (
    Option(flag="input", metavar="RENDER", is_file=True, several=True,
           help="renders to merge: files, patterns or folders, each with another seed"),
    Option(flag="--output", short="-o", metavar="OUTPUT",
           help="EXR files to write: a pattern like merged/shot.####.exr, a folder or one file"),
    Option(flag="--samples", metavar="N,N,...", type=_parse_samples,
           help="samples a pixel of each render, in their order (default: what the headers say)"),
    Option(flag="--frames", metavar="RANGE",
           help="frames to merge (default: those of the first render)"),
    Option(flag="--overwrite", either="existing", help="replace output files that are there"),
    Option(flag="--skip-existing", either="existing", help="keep output files that are there"),
    RUN["--profile"],
    Option(flag="--json", help="print one JSON object"),
)))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    MERGE_OPTIONS.add_to(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Merge all frames; returns the exit code."""
    from postfx.cli.summary import FrameProgress
    from postfx.io.exr.merge import merge_renders

    job, begin = MergeJob(arguments), time.perf_counter()
    done: list[Merged] = []
    with FrameProgress(len(job.numbers)) as progress:
        progress.start(0)
        for number in job.numbers:
            paths, samples = job.renders(number)
            done.append(merge_renders(paths, job.outputs.path(number), samples, arguments.profile))
            for note in [*job.lacking(number), *done[-1].notes]:
                progress.note(f"frame {number}: {note}")
            progress.advance(str(done[-1].path))
    seconds = time.perf_counter() - begin
    facts = {"renders": job.names, "outputs": [str(one.path) for one in done],
             "samples": [one.samples for one in done], "notes": [one.notes for one in done],
             "seconds": seconds}
    print(json.dumps(facts) if arguments.json else job.text(done, seconds))
    return 0


class MergeJob:
    """What the arguments ask for. Raises PostfxError where they do not fit together.

    Attributes:
        numbers: of the frames that are merged.
        names: the renders as they were given.
    """

    def __init__(self, arguments: argparse.Namespace) -> None:
        from postfx.errors import OptionError, WriteError
        from postfx.io.sequence import Sequence, read_sequence
        from postfx.io.writer import ExistingFiles, OutputFiles

        MERGE_OPTIONS.refuse_conflicts(arguments)
        if not arguments.output:
            raise WriteError("nowhere to write: give -o OUTPUT, e.g. -o merged.exr")
        self.names = ([arguments.input] if isinstance(arguments.input, str)
                      else list(arguments.input))
        if len(self.names) < 2:
            raise OptionError(f"{self.names[0]}: is one render: give two or more that differ in "
                              "their seed")
        self._samples: list[int] | None = arguments.samples
        if self._samples and len(self._samples) != len(self.names):
            raise OptionError(f"--samples has {len(self._samples)} numbers for {len(self.names)} "
                              "renders: give one for each")
        self._renders = [read_sequence(self.names[0], arguments.frames),
                         *map(Sequence, self.names[1:])]
        existing = ExistingFiles.OVERWRITE if arguments.overwrite else ExistingFiles.REFUSE
        self.outputs: OutputFiles = OutputFiles(arguments.output, self._renders[0], existing)
        if self.outputs.display:
            raise WriteError(f"{arguments.output}: is for a display: write EXR")
        numbers = self._renders[0].numbers
        self._renders[0].refuse_holes(numbers)
        paths = {number: self.outputs.path(number) for number in numbers}
        inputs = {path.resolve() for render in self._renders for path in render.all_files()}
        if replaced := next((path for path in paths.values() if path.resolve() in inputs), None):
            raise WriteError(f"{replaced}: is an input: write to another folder or name")
        self.numbers = [number for number in numbers
                        if not (arguments.skip_existing and paths[number].exists())]
        self.outputs.check(tuple(self.numbers))

    def renders(self, number: int) -> tuple[list[Path], list[int] | None]:
        """Files of a frame, and their samples if these are given."""
        found = [(self._file(render, number), index) for index, render in enumerate(self._renders)]
        held = [(path, index) for path, index in found if path is not None]
        samples = [self._samples[index] for _, index in held] if self._samples else None
        return [path for path, _ in held], samples

    def lacking(self, number: int) -> list[str]:
        """What to say of renders that do not have a frame."""
        return [f"{name} does not have it"
                for name, render in zip(self.names, self._renders, strict=True)
                if self._file(render, number) is None]

    def text(self, done: list[Merged], seconds: float) -> str:
        """The summary for people."""
        if not done:
            return "nothing to do: all frames are there"
        counts = sorted({one.samples for one in done})
        samples = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
        more = f" ... {done[-1].path}" if len(done) > 1 else ""
        return (f"wrote    {done[0].path}{more}: {len(self.names)} renders, {samples} samples a "
                f"pixel\ntime     {seconds:.1f} s")

    @staticmethod
    def _file(render: Sequence, number: int) -> Path | None:
        """The one file of a frame; a render of a single file is of whatever frame is asked for."""
        from postfx.errors import OptionError

        if len(render) == 1:
            number = render.numbers[0]
        if not render.holds(number):
            return None
        files = render.files(number)
        if set(files) != {""}:
            raise OptionError(f"{render.pattern}: has a file for each AOV: merge the files of each "
                              "AOV")
        return files[""]
