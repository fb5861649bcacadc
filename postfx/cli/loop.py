"""`postfx loop`: renders, denoises, and renders again where that pays, until a shot is good
enough."""

from __future__ import annotations

import argparse
import io
import json
import shlex
import shutil
import subprocess
import sys
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from postfx.cli.options import Option, Options, Section, parse_from_zero, parse_positive
from postfx.cli.samples import SAMPLE_OPTIONS

DESCRIPTION = """\
Render a shot with few samples, denoise it, render again the tiles that need more, merge, and so on
until all tiles have the quality, the budget is used up, or all rounds are done. Any renderer takes
part: --render is a command that renders the pictures and regions of a JSON file, whose name
replaces {jobs}. Scripts for Blender and Mitsuba come with postfx; docs/howto/render_more.md
describes the file for others.

Everything is rendered in two halves of one sequence of samples. Each half, denoised, is compared
with the other: that measures the error. With --error network the network predicts it: 'l' and the
default do, which takes a third of the time to denoise, and some more samples for the same picture.
With --budget a round renders at most as many samples as there are, the last one what is left.

OUTPUT always holds the denoised frames of the last round. The merged renders and a log are in
--work. A loop that was stopped goes on from there, and further with a larger budget or more rounds.
Options of 'postfx run' may follow --.
"""
EXAMPLES = """\
examples:
  postfx loop --frames 1-8 --samples 16 --quality visible -o 'clean/####.exr' \\
    --render 'blender -b shot.blend -P hosts/loop/render_blender.py -- {jobs}'
  postfx loop --frames 1 --samples 16 --budget 64 --rounds 4 -o 'clean/####.exr' \\
    --render 'python hosts/loop/render_mitsuba.py scene.xml {jobs}'
  postfx loop --frames 1-8 --samples 16 -o 'clean/####.exr' \\
    --render 'my_farm.sh {jobs}' -- --model l
"""
JOBS = "{jobs}"
HALVES = ("half1", "half2")
"""Names of the halves of the samples. A loop whose network predicts its error has the first one
alone."""
BY_NETWORK, BY_HALVES = "network", "halves"
"""Where the error comes from."""
SEEDS = 1009
"""Seeds between two halves of a round, so that no frame has the seed of another one of an earlier
half, in shots that are not longer."""

ROUND_FACTS = {"more_samples", "most_samples", "samples", "psnr", "render_seconds",
               "denoise_seconds", "plan", "asked"}
"""What is known of each round that is done."""

LOOP = Options(Section("", (
    Option(flag="--render", metavar="COMMAND", help="renders what the JSON file {jobs} lists"),
    Option(flag="--output", short="-o", metavar="OUTPUT",
           help="denoised EXR files: a pattern like clean/####.exr"),
    Option(flag="--frames", metavar="RANGE", default="1", help="frames of the shot (default: 1)"),
    Option(flag="--samples", metavar="N", type=parse_positive, default=16,
           help="samples a pixel of the first round (default: 16)"),
    SAMPLE_OPTIONS["--quality"],
    Option(flag="--budget", metavar="N", type=parse_from_zero,
           help="samples a pixel of all later rounds together, on average over the shot (default: "
           "no limit)"),
    Option(flag="--rounds", metavar="N", type=parse_positive, default=4,
           help="rounds at most after the first one (default: 4)"),
    SAMPLE_OPTIONS["--tile"],
    Option(flag="--error", choices=(BY_HALVES, BY_NETWORK), default=BY_HALVES,
           help="where the error comes from: two halves of the samples (default), or what the "
           "network expects"),
    Option(flag="--work", metavar="DIR",
           help="folder of the renders (default: a folder loop beside OUTPUT)"),
    Option(flag="--overwrite", help="replace output files that are there"),
    Option(flag="--json", help="print one JSON object"),
)))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    LOOP.add_to(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Run rounds until the shot is done; returns the exit code."""
    loop = Loop(arguments)
    for line in loop.run():
        print(line, file=sys.stderr, flush=True)
    print(json.dumps(loop.as_dict()) if arguments.json else loop.text())
    return 0


def _load_rounds(path: Path) -> list[dict[str, Any]]:
    """Rounds that an earlier loop wrote down. Raises RunError for a file that holds none."""
    from postfx.errors import RunError
    from postfx.files import parse_json, read_text

    if not path.exists():
        return []
    try:
        rounds: list[dict[str, Any]] = parse_json(read_text(path))
        if not all(one.keys() >= ROUND_FACTS for one in rounds):
            raise ValueError("a round lacks what was measured of it")
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise RunError(f"{path}: is damaged ({error}): delete it to begin the loop "
                       "anew") from error
    return rounds


def find_predictor(forwarded: list[str]) -> str | None:
    """The network that predicts its error with these options of `run`: the one that they name for
    the render's size, or that it takes by itself where memory is enough. None for one that
    predicts none."""
    from postfx.cli.main import make_parser
    from postfx.cli.run_options import RUN
    from postfx.cli.usual_network import is_chosen
    from postfx.passes.denoise.default_network import USUAL_NETWORK, usual_network
    from postfx.passes.denoise.models import UNSCALED, model_of, predicts_error
    from postfx.runtime import Device

    given = make_parser(["run"]).parse_args(["run", "-", *forwarded])
    options = RUN.values_for("denoiser", given)
    if is_chosen(given, options):
        network = str(options.get("model", USUAL_NETWORK))
    else:
        network = usual_network((1, 1), 1, Device(given.device))
    return network if predicts_error(model_of(network, UNSCALED)) else None


def ask_error(forwarded: list[str]) -> list[str]:
    """Options of `run` that also write the error that the network expects, beside the layers that
    --aov names in these."""
    from postfx.cli.main import make_parser

    layers = make_parser(["run"]).parse_args(["run", "-", *forwarded]).aov
    return [*forwarded, "--aov", ",".join(filter(None, (layers, "error")))]


class Loop:
    """A shot that is rendered in rounds. Raises PostfxError where something does not fit together
    or fails."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        from postfx.errors import OptionError, WriteError
        from postfx.io.pattern import parse_frames, parse_pattern
        from postfx.io.writer import check_folder, is_display_format

        if not arguments.render or JOBS not in arguments.render:
            raise OptionError("--render: give a command with {jobs} in it, such as --render "
                              "'my_render {jobs}'")
        self._predictor = (find_predictor(arguments.forwarded) if arguments.error == BY_NETWORK
                           else None)
        if arguments.error == BY_NETWORK and not self._predictor:
            raise OptionError(f"--error {BY_NETWORK}: this network predicts none: give --error "
                              f"{BY_HALVES}, or another --model behind --")
        self._halves = HALVES[:1] if self._predictor else HALVES
        if arguments.samples < len(self._halves):
            raise OptionError(f"--samples {arguments.samples}: two halves need 2 or more, such as "
                              "16")
        if not arguments.output:
            raise WriteError("nowhere to write: give -o OUTPUT, e.g. -o 'clean/####.exr'")
        pattern = parse_pattern(arguments.output)
        if not pattern.is_numbered or is_display_format(str(pattern)):
            raise WriteError(f"{arguments.output}: give EXR files with a frame number, such as "
                             "clean/####.exr")
        self._arguments, self._numbers = arguments, parse_frames(arguments.frames)
        self._work = Path(arguments.work or pattern.path(1).parent / "loop")
        check_folder(self._work, "work")
        self._state = self._work / "loop.json"
        self.rounds = _load_rounds(self._state)
        self._go_on_alike()
        taken = [path for number in self._numbers if (path := pattern.path(number)).exists()]
        if taken and not (arguments.overwrite or self.rounds):
            raise WriteError(f"{taken[0]}: is already there: give --overwrite")
        self.done = ""

    def run(self) -> Any:
        """All rounds; yields a line for each."""
        if not self.rounds:
            jobs = [job for number in self._numbers
                    for job in self._jobs(number, None, self._arguments.samples)]
            seconds = self._render(jobs)
            for job in jobs:
                self._begin(job)
            for number in self._numbers:
                self._merge(number)
            self._finish_round(seconds, 0.0, self._arguments.samples)
            yield self._line()
        elif self.rounds[-1]["asked"] != self._asked():
            self.rounds[-1] |= self._plan()
        while not (self.done or self._is_done()):
            plan = self.rounds[-1]["plan"]
            jobs = [job for frame in plan["frames"] for index, region in enumerate(frame["regions"])
                    for job in self._jobs(frame["frame"], region, region["samples"],
                                          f".region{index}")]
            seconds = self._render(jobs)
            for number in self._numbers:
                for half in self._halves:
                    self._add(number, half, [job for job in jobs
                                             if (job["frame"], job["half"]) == (number, half)])
                self._merge(number)
            most = max(region["samples"] for frame in plan["frames"] for region in frame["regions"])
            self._finish_round(seconds, plan["more_samples"], most)
            yield self._line()

    def _go_on_alike(self) -> None:
        """Refuse to go on with other renders than those that the loop began with."""
        from postfx.errors import OptionError

        begun = (self.rounds[-1]["asked"].get("halves", len(HALVES)) if self.rounds
                 else len(self._halves))
        if begun != len(self._halves):
            way = BY_NETWORK if begun == 1 else BY_HALVES
            raise OptionError(f"{self._state}: was begun with --error {way}: give that, or another "
                              "--work")

    def as_dict(self) -> dict[str, Any]:
        """The loop for programs."""
        rounds = [{key: value for key, value in one.items() if key not in ("plan", "asked")}
                  for one in self.rounds]
        return {"output": self._arguments.output, "renders": str(self._work / "merged"),
                "done": self.done, "rounds": rounds}

    def text(self) -> str:
        """The loop for people."""
        last = self.rounds[-1]
        return (f"wrote    {self._arguments.output}: {last['samples']:.1f} samples a pixel in the "
                f"mean, about {last['psnr']:.1f} dB; {self.done}")

    def _is_done(self) -> bool:
        """Whether nothing is left to render, and why."""
        plan = self.rounds[-1]["plan"]
        if not any(frame["regions"] for frame in plan["frames"]):
            self.done = ("all tiles have the quality" if plan["tiles_done"] >= 1
                         else "the budget is used up")
        elif len(self.rounds) > self._arguments.rounds:
            self.done = (f"all rounds are done, and {plan['tiles_done']:.0%} of the tiles would be "
                         "after another")
        return bool(self.done)

    def _line(self) -> str:
        last = self.rounds[-1]
        return (f"round {len(self.rounds) - 1}: {last['samples']:.1f} samples a pixel, about "
                f"{last['psnr']:.1f} dB, {last['render_seconds']:.0f} s of rendering, "
                f"{last['denoise_seconds']:.0f} s of denoising")

    def _jobs(self, number: int, region: dict[str, int] | None, samples: int,
              more: str = "") -> list[dict[str, Any]]:
        """One picture or region to render: a job for each half. Halves are parts of one sequence,
        so that a renderer that can go on in it has no more noise than in one render of both."""
        count = len(self.rounds)
        box = None if region is None else {key: region[key]
                                           for key in ("x", "y", "width", "height")}
        shares = [samples] if len(self._halves) == 1 else [(samples + 1) // 2, samples // 2]
        drawn = sum(one["most_samples"] for one in self.rounds)
        return [{"frame": number, "half": half, "region": box, "samples": share,
                 "seed": SEEDS * (len(HALVES) * count + index) + number,
                 "first_seed": number, "first_sample": drawn + sum(shares[:index]),
                 "output": str(self._file(f"round{count}", number, half, more).absolute())}
                for index, (half, share) in enumerate(zip(self._halves, shares, strict=True))]

    def _render(self, jobs: list[dict[str, Any]]) -> float:
        """Let the renderer work, again where it ended early but got on; returns the seconds that it
        took."""
        from postfx.errors import MissingFrameError, RunError

        begin = time.perf_counter()
        for job in jobs:
            path = Path(job["output"])
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
        left, code = jobs, 1
        while left and code:
            before, (code, log) = len(left), self._call(left)
            left = [job for job in left if not Path(job["output"]).exists()]
            if code and len(left) == before:
                raise RunError(f"--render: the renderer ended with {code}: {log} says why")
        if left:
            raise MissingFrameError(f"{left[0]['output']}: the renderer did not write it: {log} "
                                    "may say why")
        return time.perf_counter() - begin

    def _call(self, jobs: list[dict[str, Any]]) -> tuple[int, Path]:
        """Start the renderer; returns its exit code and the log of what it said."""
        from postfx.errors import RunError
        from postfx.files import write_text

        count = len(self.rounds)
        path, log = self._work / f"round{count}.json", self._work / f"round{count}.log"
        write_text(path, json.dumps({"jobs": jobs}, indent=1))
        words = [word.replace(JOBS, str(path.absolute()))
                 for word in shlex.split(self._arguments.render)]
        try:
            with log.open("wb") as output:
                return subprocess.run(words, stdout=output, stderr=subprocess.STDOUT,
                                      check=False).returncode, log
        except OSError as error:
            reason = error.strerror or error
            raise RunError(f"--render: {words[0]} cannot be started: {reason}; check its "
                           "name") from error

    def _begin(self, job: dict[str, Any]) -> None:
        """Make the render of the first round that of a half."""
        from postfx.io.exr.merge import merge_renders

        rendered, merged = Path(job["output"]), self._merged(job["frame"], job["half"])
        if job["first_sample"]:  # headers of Cycles count those before it, too
            merge_renders([rendered], merged, [job["samples"]])
            rendered.unlink()
        else:
            rendered.replace(merged)

    def _add(self, number: int, half: str, jobs: list[dict[str, Any]]) -> None:
        """Merge regions into a half of a frame."""
        from postfx.io.exr.merge import merge_renders

        if jobs:  # headers of Cycles count the samples that were left out before the first one, too
            merge_renders([self._merged(number, half), *(Path(job["output"]) for job in jobs)],
                          self._merged(number, half), [None, *(job["samples"] for job in jobs)])

    def _merge(self, number: int) -> None:
        """Merge both halves of a frame; the only one is all that there is."""
        from postfx.io.exr.merge import merge_renders

        parts = [self._merged(number, half) for half in self._halves]
        if len(parts) == 1:
            shutil.copyfile(parts[0], self._merged(number))
        else:
            merge_renders(parts, self._merged(number))

    def _finish_round(self, seconds: float, more: float, most: int) -> None:
        """Denoise what was rendered, plan the next round, and write down where the loop stands;
        more, most: samples of the round, in the mean and of any region."""
        begin = time.perf_counter()
        if len(self._halves) == 1:
            forwarded = [*self._name_network(), *ask_error(self._arguments.forwarded)]
            self._denoise("merged", self._arguments.output, forwarded)
        else:
            for renders, output in (("merged", self._arguments.output),
                                    *((half, self._clean(half)) for half in self._halves)):
                self._denoise(renders, output, self._arguments.forwarded)
        self.rounds.append({"more_samples": more, "most_samples": most, "render_seconds": seconds})
        self.rounds[-1] |= self._plan()
        self.rounds[-1]["denoise_seconds"] = time.perf_counter() - begin
        self._write()

    def _name_network(self) -> list[str]:
        """The network that predicts the error, where `run` might take another one for large
        frames."""
        chosen = any(word.partition("=")[0] == "--model" for word in self._arguments.forwarded)
        return [] if chosen else ["--model", str(self._predictor)]

    def _denoise(self, renders: str, output: str, options: list[str]) -> None:
        """Denoise all frames of a folder of renders."""
        from postfx.cli.main import make_parser

        words = ["run", str(self._work / renders / "####.exr"), "-o", output,
                 f"--frames={self._arguments.frames}",
                 "--overwrite", "--scale", "1", "--quiet", *options]
        given = make_parser(["run"]).parse_args(words)
        given.words = words
        with redirect_stdout(io.StringIO()):
            given.execute(given)

    def _asked(self) -> dict[str, Any]:
        """What a plan depends on, beside the renders."""
        given = self._arguments
        return {"quality": given.quality, "budget": given.budget, "tile": given.tile,
                "rounds": given.rounds, "halves": len(self._halves)}

    def _plan(self) -> dict[str, Any]:
        """Plan the next round."""
        from postfx.cli.main import make_parser
        from postfx.cli.samples import SamplesJob

        given = self._arguments
        if len(self._halves) == 1:
            words = ["samples", str(self._work / "merged/####.exr"), "--denoised", given.output]
        else:
            one, other = (str(self._work / half / "####.exr") for half in self._halves)
            words = ["samples", one, "--halves", other, "--denoised",
                     *map(self._clean, self._halves), given.output]
        words += [f"--frames={given.frames}", "--quality", given.quality, "--tile",
                  str(given.tile), "--json"]
        used = sum(one["more_samples"] for one in self.rounds)
        if given.budget is not None:
            left = max(given.budget - used, 0)
            is_last = len(self.rounds) >= given.rounds
            words += ["--budget", str(left if is_last else min(left, given.samples + used))]
        job = SamplesJob(make_parser(["samples"]).parse_args(words), is_quiet=True)
        job.measure()
        plan = job.as_dict()
        frames = plan["frames"]
        return {"samples": sum(frame["samples"] for frame in frames) / len(frames),
                "psnr": plan["psnr"], "plan": plan, "asked": self._asked()}

    def _write(self) -> None:
        from postfx.files import write_text

        write_text(self._state, json.dumps(self.rounds))

    def _clean(self, half: str) -> str:
        """Pattern of the denoised frames of a half."""
        return str(self._work / f"clean_{half}" / "####.exr")

    def _merged(self, number: int, half: str = "") -> Path:
        path = self._work / (half or "merged") / f"{number:04d}.exr"
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def _file(self, folder: str, number: int, half: str, more: str = "") -> Path:
        """A file that the renderer writes."""
        return self._work / folder / f"{number:04d}.{half}{more}.exr"
