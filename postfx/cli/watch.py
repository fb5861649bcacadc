"""`postfx watch`: a preview of frames while a renderer writes them."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from postfx.cli.options import parse_from_zero, parse_path, parse_positive

if TYPE_CHECKING:
    from postfx.cli.job import Job
    from postfx.io.pattern import Pattern

DESCRIPTION = """\
Process frames as a renderer writes them, in order, for a preview while the render runs. Networks
stay loaded, and each frame has the history of the ones before it. A frame counts as written when
its files have not changed for --settle seconds and can be read. Late frames are waited for. Options
of 'postfx run' go after --.

Frames that exist already come first. A shot's first frames are noisier than with 'postfx run',
which also uses the frames after them. Make final frames with 'postfx run': watch writes no
manifest, replaces outputs, takes the quick form of a look (--fast-look) and takes the network m.
"""
EXAMPLES = """\
examples:
  postfx watch render/ -o preview/
  postfx watch 'render/beauty.####.exr' -o preview/p.####.png -- --model s
  postfx watch render/ -o preview/ --until 240 --idle 600

exit codes: 0 the last frame of --until is done, or no frame came for --idle seconds; 2 an error
whose message says how to fix it; 130 ended by Ctrl-C
"""
POLL = 0.2
"""Seconds between two looks at the folder, as network folders do not report new files."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("input", metavar="FOLDER", type=parse_path,
                        help="folder to watch, or a pattern of frames in it")
    parser.add_argument("-o", "--output", metavar="OUTPUT", required=True, type=parse_path,
                        help="files to write: a pattern or a folder")
    parser.add_argument("--until", metavar="FRAME", type=int,
                        help="number of the last frame (default: keep watching)")
    parser.add_argument("--step", metavar="N", type=parse_positive, default=1,
                        help="step between frames, if the renderer leaves some out (default: 1)")
    parser.add_argument("--idle", metavar="SECONDS", type=parse_from_zero,
                        help="stop when no new frame has come for this time (default: never)")
    parser.add_argument("--patience", metavar="SECONDS", type=parse_from_zero, default=60.0,
                        help="how long to wait for a missing frame once later ones are there, "
                        "before it is left out (default: 60)")
    parser.add_argument("--settle", metavar="SECONDS", type=parse_from_zero, default=0.5,
                        help="how long a file must stay unchanged to count as written (default: "
                        "0.5)")
    parser.add_argument("--json", action="store_true",
                        help="print one JSON object a line for each frame")
    parser.usage = (f"{parser.prog} FOLDER -o OUTPUT [--until FRAME] [--idle SECONDS] [--json] [-- "
                    "RUN OPTIONS]")


def execute(arguments: argparse.Namespace) -> int:
    """Watch until the end; returns the exit code."""
    from postfx.cli.interruptions import Stop
    from postfx.cli.told import Told
    from postfx.errors import ReadError, SequenceError
    from postfx.io.image_file import READABLE

    def tell(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    given = Path(arguments.input)
    names_frames = given.suffix.lower() in READABLE and not arguments.input.endswith("/")
    folder = given.parent if names_frames and not given.is_dir() else given
    if not folder.is_dir():
        raise SequenceError(f"{arguments.input}: there is no such folder: make it, or check its "
                            "name")
    with Stop(tell) as stop, Told(lambda text: tell(f"warning  {text}")):
        arrivals = Arrivals(arguments, stop.check, tell)
        job: Job | None = None
        while (number := arrivals.next()) is not None:
            begin = time.perf_counter()
            try:
                job = job or _make_job(arguments, arrivals.pattern, number)
                path = job.preview(number, arguments.step, tell)
            except ReadError as error:
                arrivals.refuse(number, str(error))
                continue
            seconds = time.perf_counter() - begin
            facts = {"frame": number, "file": str(path), "seconds": round(seconds, 3)}
            print(json.dumps(facts) if arguments.json else f"{path} ({seconds:.2f} s)", flush=True)
    return 0


def _make_job(arguments: argparse.Namespace, pattern: Pattern, first: int) -> Job:
    """A job whose first frame is known; those after it are not on the disk yet."""
    from postfx.cli.job import Job
    from postfx.cli.main import make_parser
    from postfx.cli.run_options import RUN
    from postfx.errors import OptionError
    from postfx.passes.denoise.default_network import USUAL_NETWORK

    words = [str(pattern), "-o", arguments.output, "--overwrite", f"--frames={first}",
             *arguments.forwarded]
    given = make_parser(["run"]).parse_args(["run", *words])
    # defaults of a studio yield
    given.both_ways = given.both_ways and "both_ways" not in given.filled
    if given.exposure == "smooth" and "exposure" in given.filled:
        given.exposure = RUN["--exposure"].default
    for flag, is_given in (("--both-ways", given.both_ways),
                           ("--exposure smooth", given.exposure == "smooth"),
                           ("--report", given.report), ("--capture", given.capture),
                           ("--explain", given.explain)):
        if is_given:
            whose = "" if not given.preset or flag.split()[0] in " ".join(words) else (
                f" of --preset {given.preset}")
            raise OptionError(f"{flag}{whose} needs all frames, but watch knows only those written "
                              "so far: leave it out")
    given.run_up = given.run_up or 0
    given.fast_look = True
    if not given.no_denoise:
        given.model = given.model or USUAL_NETWORK
    return Job(given)


class Arrivals:
    """Numbers of frames in order, each once it is written.

    Attributes:
        pattern: of the frames, once there is one.
    """

    def __init__(self, arguments: argparse.Namespace, check: Callable[[], None],
                 tell: Callable[[str], None]) -> None:
        self._arguments, self._check, self._tell = arguments, check, tell
        # size and change of a file, and since when
        self._seen: dict[Path, tuple[tuple[int, int], float]] = {}
        self._last: int | None = None
        self._before: int | None = None  # the frame before that one
        # a frame that could not be read, and since when
        self._unreadable: tuple[int, float] | None = None
        self._late: tuple[int, float] | None = None  # a frame that is waited for, and since when

    def next(self) -> int | None:
        """The number of the next frame; blocks until it is there. None at the end."""
        begin = time.monotonic()
        until, idle = self._arguments.until, self._arguments.idle
        while self._last is None or until is None or self._last < until:
            self._check()
            number = self._ready()
            if number is not None:
                self._before, self._last = self._last, number
                self._late = None
                return number
            if idle is not None and time.monotonic() - begin >= idle:
                return None
            time.sleep(POLL)
        return None

    def refuse(self, number: int, why: str) -> None:
        """Say that the frame that came last cannot be read: it comes again when its files have
        changed, as they do while a renderer still writes them; after some patience it is left
        out."""
        if self._unreadable is None or self._unreadable[0] != number:
            self._unreadable = number, time.monotonic()
        if time.monotonic() - self._unreadable[1] >= self._arguments.patience:
            self._tell(f"frame {number} is left out: {why}")
            return
        self._last = self._before

    def _ready(self) -> int | None:
        """The frame to take now, if there is one: the next in order, or a later one after some
        patience."""
        found = self._find_frames()
        numbers = [number for number in found if self._last is None or number > self._last]
        if not numbers or not self._may_go_on_with(numbers[0]):
            return None
        first = numbers[0]
        paths = list(found[first].values())
        if not all([self._has_settled(path) for path in paths]):
            return None
        if self._unreadable and self._unreadable[0] == first:
            since = self._unreadable[1]
            is_changed = any(self._seen[path][1] > since for path in paths)
            return first if is_changed or self._is_out_of_patience(since) else None
        return first

    def _find_frames(self) -> dict[int, dict[str, Path]]:
        """Files of the frames that are there; none in a folder that is empty, or not there yet."""
        from postfx.errors import SequenceError
        from postfx.io.pattern import VIEW_FIELD, locate

        try:
            self.pattern, _ = locate(self._arguments.input)
        except SequenceError:
            if any(Path(self._arguments.input).glob("*.exr")):
                raise
            return {}
        if self.pattern.has_views:
            raise SequenceError(f"{self.pattern}: 'postfx watch' watches one view: put its name "
                                f"for {VIEW_FIELD}")
        return self.pattern.find_frames()

    def _may_go_on_with(self, first: int) -> bool:
        """Whether the first frame that is there is the next in order, or patience for that ran
        out."""
        if self._last is None:
            return True
        next_one = self._last + self._arguments.step
        if first <= next_one:
            return True
        if self._late is None or self._late[0] != next_one:
            self._late = next_one, time.monotonic()
        if not self._is_out_of_patience(self._late[1]):
            return False
        self._tell(f"frame {next_one} did not come within {self._arguments.patience:g} s: going on "
                   f"with {first}")
        return True

    def _is_out_of_patience(self, since: float) -> bool:
        return bool(time.monotonic() - since >= self._arguments.patience)

    def _has_settled(self, path: Path) -> bool:
        """Whether a file has stayed as it is for long enough."""
        now = time.monotonic()
        try:
            status = path.stat()
        except FileNotFoundError:
            return False
        state = status.st_size, status.st_mtime_ns
        known, since = self._seen.get(path, (None, now))
        self._seen[path] = state, (since if known == state else now)
        # a file that was there before we looked need not be watched as long
        old = time.time() - status.st_mtime >= self._arguments.settle
        return status.st_size > 0 and (old or now - self._seen[path][1] >= self._arguments.settle)
