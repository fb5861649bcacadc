"""Postfx against the five ways of Open Image Denoise, by kind of content, samples and size.

    python -m training.measure.table FOLDER [--ways 'xl:;both:--both-ways;s:--model s']
        [--json FILE]

FOLDER holds one folder for each kind, as `training/measure/validation/render_scenes.py` writes
them: noisy.SPP.####.exr at the references' size, half.SPP.####.exr at half of it, and
reference.####.exr. Frames that also have a second.####.exr, a reference with other noise, are
measured without the noise of references. The first frames of a shot may have no reference: they
run before the others, and are not measured. A way is a name, and options of `postfx run`. There are
three comparisons:

    1x           both on the full size
    2x           both on half the size; OIDN is enlarged by cubic interpolation
    same rays    postfx at 2x on half the size and four times the samples, OIDN on the full size

The five ways of Open Image Denoise: planes as clean, planes prefiltered each alone, planes as they
are, XX"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from postfx.errors import PostfxError
from postfx.frame import Frame, Role
from postfx.io.sequence import Sequence, read_sequence
from postfx.oidn import GUIDE_WAYS
from postfx.runtime import Device
from postfx.tools.bench.baselines import Accumulator, HostKernels, Oidn
from postfx.tools.bench.metrics import SequenceScore

FIGURES = ("psnr", "flip", "flicker")
SINGLE = (*GUIDE_WAYS, "none")
"""Ways to give planes to Open Image Denoise."""
ACCUMULATED = "accumulated"
SIZES = {"1x": ("noisy", 1), "2x": ("half", 2)}
"""Size -> first part of the files' names, and the factor to the references' size."""
RAYS = "same rays"
PIXELS = 4
"""Times as many pixels at full size as at half: so many more samples at half for the same rays."""
DEFAULT_WAYS = "m:--model m"

Row = dict[str, Any]
Scores = dict[str, float | None]


@dataclass(frozen=True)
class Shot:
    """A sequence to measure: noisy frames of one kind, size and number of samples."""

    folder: Path
    size: str
    samples: int

    @property
    def kind(self) -> str:
        return self.folder.name

    @property
    def scale(self) -> int:
        return SIZES[self.size][1]

    @property
    def noisy(self) -> str:
        return str(self.folder / f"{SIZES[self.size][0]}.{self.samples}.####.exr")

    @property
    def reference(self) -> str:
        return str(self.folder / "reference.####.exr")

    @property
    def second(self) -> str:
        """References of some frames, with other noise."""
        return str(self.folder / "second.####.exr")

    def stamp(self) -> list[list[Any]]:
        """Name, size and time of its files: results of others are not its own."""
        parts = [SIZES[self.size][0] + f".{self.samples}", "reference", "second"]
        files = sorted(path for part in parts for path in self.folder.glob(f"{part}.*.exr"))
        return [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in files]


def shots(folder: Path, kinds: list[str], sizes: list[str], samples: list[int]) -> Iterator[Shot]:
    """The shots in a folder, in the order of kinds, sizes and samples; empty lists choose all."""
    for sub in sorted(path for path in folder.iterdir() if path.is_dir()):
        if kinds and sub.name not in kinds or not any(sub.glob("reference.*.exr")):
            continue
        for size in sizes:
            found = {int(path.name.split(".")[1]) for path in sub.glob(f"{SIZES[size][0]}.*.*.exr")}
            for count in sorted(found):
                if not samples or count in samples:
                    yield Shot(sub, size, count)


# Measuring ----------------------------------------------------------------------------------------


class Judge:
    """Scores pictures of a shot against its references."""

    def __init__(self, shot: Shot) -> None:
        references = Sequence(shot.reference)
        self.noisy = Sequence(shot.noisy)
        self.frames = [self.noisy.read(number) for number in self.noisy.numbers]
        self._targets = {number: references.read(number, [Role.COLOUR])
                         for number in references.numbers}
        self._seconds: dict[int, Frame] = {}
        if any(shot.folder.glob("second.*.exr")):
            others = Sequence(shot.second)
            self._seconds = {number: others.read(number, [Role.COLOUR])
                             for number in others.numbers}
        height, width, _ = next(iter(self._targets.values()))[Role.COLOUR].shape
        self.size = height, width

    def score(self, pictures: list[np.ndarray]) -> Scores:
        """Means over the second half of the frames that have references."""
        scores = SequenceScore()
        for picture, frame in zip(pictures, self.frames, strict=True):
            number = frame.number
            if number in self._targets:
                scores.add(picture, self._targets[number], frame, self._seconds.get(number))
        summary = scores.summary()
        return {figure: summary[f"{figure}_late"] for figure in FIGURES}


def five_ways(judge: Judge, threads: int) -> dict[str, Scores]:
    """Scores of Open Image Denoise by way; frames without motion are not accumulated."""
    device = Device("cpu", threads)
    kernels = HostKernels(device)
    made, scores = {}, {}
    for planes in SINGLE:
        denoise = Oidn("high", "cpu", threads, planes)
        made[planes] = [kernels.enlarge(denoise(frame), *judge.size, frame.jitter)
                        for frame in judge.frames]
        scores[planes] = judge.score(made[planes])
    best = max(scores, key=lambda planes: psnr_of(scores[planes]))
    if all(Role.MOTION in frame for frame in judge.frames):
        accumulate = Accumulator(kernels)
        scores[ACCUMULATED] = judge.score([accumulate(picture, frame) for picture, frame
                                           in zip(made[best], judge.frames, strict=True)])
    return scores


def run_postfx(shot: Shot, judge: Judge, options: list[str]) -> Scores:
    """Scores of `postfx run`, in a process as users start it."""
    folder = Path(tempfile.mkdtemp(prefix="table."))
    size = ["--denoise-only"] if shot.scale == 1 else ["--scale", str(shot.scale)]
    output = str(folder / "frame.####.exr")
    command = [sys.executable, "-m", "postfx", "run", shot.noisy, "-o", output, *size, *options]
    try:
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            last = (done.stderr.strip() or "no message").splitlines()[-1]
            raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {last}")
        results = read_sequence(output, planes=[Role.COLOUR])
        return judge.score([results.read(frame.number)[Role.COLOUR] for frame in judge.frames])
    finally:
        shutil.rmtree(folder)


class Results:
    """Rows in a JSON file: what was measured before is read again."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.rows: list[Row] = json.loads(path.read_text()) if path and path.exists() else []

    def known(self, shot: Shot) -> dict[str, Scores]:
        """Open Image Denoise on the same files."""
        for row in self.rows:
            if (row["folder"], row["size"], row["samples"]) == self._key(shot):
                return dict(row["oidn"]) if row["stamp"] == shot.stamp() else {}
        return {}

    def add(self, shot: Shot, oidn: dict[str, Scores], ways: dict[str, Scores]) -> Row:
        """Keep the results of a shot; those of ways that were measured earlier, too."""
        key = self._key(shot)
        same = [row for row in self.rows if (row["folder"], row["size"], row["samples"]) == key]
        earlier = same[0]["ways"] if same and same[0]["stamp"] == shot.stamp() else {}
        folder, size, samples = key
        row = {"folder": folder, "kind": shot.kind, "size": size, "samples": samples,
               "stamp": shot.stamp(), "oidn": oidn, "ways": earlier | ways}
        self.rows = [other for other in self.rows if other not in same] + [row]
        if self._path:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.write_text(json.dumps(self.rows, indent=1) + "\n")
        return row

    @staticmethod
    def _key(shot: Shot) -> tuple[str, str, int]:
        return str(shot.folder.resolve()), shot.size, shot.samples


# Tables -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gain:
    """One way on one shot against the best of the five, figure by figure.

    `psnr` is a difference in dB; `flip` and `flicker` are ratios, None where there is no figure.
    """

    kind: str
    samples: int
    best: str
    psnr: float
    flip: float | None
    flicker: float | None


def psnr_of(scores: Scores) -> float:
    """PSNR in dB, which every picture has."""
    found = scores["psnr"]
    assert found is not None, "there is a reference"
    return found


def best_psnr(oidn: dict[str, Scores]) -> tuple[str, float]:
    """The best way in PSNR, and its PSNR."""
    name = max(oidn, key=lambda way: psnr_of(oidn[way]))
    return name, psnr_of(oidn[name])


def compare(kind: str, samples: int, ours: Scores, oidn: dict[str, Scores]) -> Gain:
    name, level = best_psnr(oidn)
    ratios = {}
    for figure in ("flip", "flicker"):
        known = [value for scores in oidn.values() if (value := scores[figure])]
        own = ours[figure]
        ratios[figure] = own / min(known) if known and own is not None else None
    return Gain(kind, samples, name, psnr_of(ours) - level, ratios["flip"], ratios["flicker"])


def gains(rows: list[Row], size: str, way: str) -> list[Gain]:
    """All gains of a way in one comparison."""
    if size != RAYS:
        return [compare(row["kind"], row["samples"], row["ways"][way], row["oidn"])
                for row in rows if row["size"] == size and way in row["ways"]]
    found = []
    full = {(row["folder"], row["samples"]): row["oidn"] for row in rows if row["size"] == "1x"}
    for row in rows:
        theirs = full.get((row["folder"], row["samples"] // PIXELS))
        if row["size"] == "2x" and way in row["ways"] and theirs:
            found.append(compare(row["kind"], row["samples"] // PIXELS, row["ways"][way], theirs))
    return found


def table(found: list[Gain]) -> list[str]:
    """Lines of Markdown: a row for each kind, the worst first, then the mean."""
    samples = sorted({gain.samples for gain in found})
    by_kind: dict[str, list[Gain]] = {}
    for gain in found:
        by_kind.setdefault(gain.kind, []).append(gain)
    heads = [f"{what} {count}" for what in ("dB", "FLIP x", "flicker x") for count in samples]
    lines = [f"| kind | {' | '.join(heads)} | best of OIDN |",
             "|" + " --- |" * (len(heads) + 2)]
    for kind in sorted(by_kind, key=lambda kind: min(gain.psnr for gain in by_kind[kind])):
        cells = cells_of(by_kind[kind], samples)
        ways = ", ".join(dict.fromkeys(gain.best for gain in by_kind[kind]))
        lines.append(f"| {kind} | {' | '.join(cells)} | {ways} |")
    lines.append(f"| **mean** | {' | '.join(cells_of(found, samples))} | |")
    return lines


def cells_of(found: list[Gain], samples: list[int]) -> list[str]:
    cells = []
    for figure, form in (("psnr", "+.2f"), ("flip", ".2f"), ("flicker", ".2f")):
        for count in samples:
            values = [getattr(gain, figure) for gain in found if gain.samples == count]
            known = [value for value in values if value is not None]
            cells.append(format(float(np.mean(known)), form) if known else "")
    return cells


def report(rows: list[Row], ways: list[str]) -> str:
    """All tables, with the number of sequences that are above the best of the five."""
    lines: list[str] = []
    for size in (*SIZES, RAYS):
        for way in ways:
            found = gains(rows, size, way)
            if not found:
                continue
            above = sum(gain.psnr > 0 for gain in found)
            worst = min(found, key=lambda gain: gain.psnr)
            lines += [f"### {size}, `{way}` against the best of five ways of OIDN", "",
                      f"Above on {above} of {len(found)}; worst: {worst.kind} at {worst.samples} "
                      f"samples, {worst.psnr:+.2f} dB.", "", *table(found), ""]
    return "\n".join(lines)


def parse_ways(text: str) -> dict[str, list[str]]:
    """'m:;both:--both-ways' -> name -> options."""
    return {name.strip(): options.split() for name, _, options in
            (part.partition(":") for part in text.split(";") if part.strip())}


def numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(",") if part]


def words(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def parser_of_kinds(description: str) -> argparse.ArgumentParser:
    """Options of programs that measure one network on a folder of kinds."""
    parser = argparse.ArgumentParser(description=description,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", default="xl", help="tag or file (default: xl)")
    parser.add_argument("--kinds", default="", help="folders, with commas (default: all)")
    parser.add_argument("--threads", type=int, default=2)
    return parser


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="holds a folder for each kind")
    parser.add_argument("--ways", type=parse_ways, default=parse_ways(DEFAULT_WAYS),
                        help="NAME:OPTIONS of postfx run, separated by semicolons (default: "
                        f"{DEFAULT_WAYS})")
    parser.add_argument("--kinds", type=words, default=[], help="default: all")
    parser.add_argument("--sizes", type=words, default=list(SIZES), help="1x, 2x (default: both)")
    parser.add_argument("--samples", type=numbers, default=[], help="default: all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep results there")
    parser.add_argument("--threads", type=int, default=2, help="of OIDN (default: 2)")
    parser.add_argument("--again", action="store_true", help="measure ways again that FILE knows")
    args = parser.parse_args(argv)
    if not args.folder.is_dir():
        parser.error(f"{args.folder} is not a folder: render it by render_scenes.py")
    unknown = set(args.sizes) - set(SIZES)
    if unknown:
        parser.error(f"--sizes {min(unknown)}: there are {', '.join(SIZES)}")
    chosen = list(shots(args.folder, args.kinds, args.sizes, args.samples))
    if not chosen:
        parser.error(f"{args.folder} holds no KIND/noisy.SPP.####.exr with references")
    results = Results(args.json)
    rows = []
    for shot in chosen:
        try:
            rows.append(measure(shot, results, args))
        except (PostfxError, RuntimeError) as error:
            print(f"{shot.kind} {shot.size} {shot.samples}: {error}", file=sys.stderr, flush=True)
    print(report(rows, list(args.ways)))
    return 0 if len(rows) == len(chosen) else 1


def measure(shot: Shot, results: Results, args: argparse.Namespace) -> Row:
    """Open Image Denoise, if not known, and all ways on a shot."""
    judge = Judge(shot)
    oidn = results.known(shot) or five_ways(judge, args.threads)
    row = results.add(shot, oidn, {})
    for way, options in args.ways.items():
        if way not in row["ways"] or args.again:
            row = results.add(shot, oidn, {way: run_postfx(shot, judge, options)})
    best, level = best_psnr(oidn)
    told = [f"{way} {row['ways'][way]['psnr'] - level:+.2f}" for way in args.ways]
    print(f"{shot.kind} {shot.size} {shot.samples}: {best} {level:.2f} dB; {', '.join(told)}",
          file=sys.stderr, flush=True)
    return row


if __name__ == "__main__":
    sys.exit(main())
