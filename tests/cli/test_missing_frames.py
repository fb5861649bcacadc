"""`--on-error skip` and `copy` beside every option that looks at frames: those that are missing
lose no run.

Every two values of two options stand together in at least one run; a run has a value of each
option, so few suffice.
"""

from __future__ import annotations

import itertools
import json
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from postfx.cli.main import main, make_parser
from postfx.cli.run_options import RUN
from postfx.errors import OptionError
from postfx.frame import Frame, Role
from postfx.io.writer import write_frame

Value = tuple[str, ...]
PARSER = make_parser()
APART = {"--guides", "--size"}, {"--reference", "--no-denoise"}, {"--capture", "--no-denoise"}
"""Guides and references here have the default size, and a run without passes has nothing to
capture."""
RUN_WORDS = ("run", "in/shot.####.exr", "--device", "cpu", "--json")
COPY, SKIP = ("--on-error", "copy"), ("--on-error", "skip")
NONE: Value = ()
TABLE: dict[str, tuple[Value, ...]] = {
    "on-error": (COPY, SKIP),
    "output": (("-o", "out/shot.####.exr"), ("-o", "out/shot.####.png")),
    "report": (NONE, ("--report", "report.html"),
               ("--report", "report.html", "--reference", "ref/shot.####.exr")),
    "capture": (NONE, ("--capture", "look")),
    "history": (NONE, ("--both-ways",), ("--run-up", "0"), ("--budget", "900")),
    "exposure": (NONE, ("--exposure", "smooth"), ("--exposure", "0")),
    "log": (NONE, ("--log", "log.jsonl", "--checkpoint", "0")),
    "preroll": (NONE, ("--preroll", "2"), ("--preroll", "0")),
    "existing": (NONE, ("--skip-existing",), ("--skip-existing", "--resume", "1")),
    "guides": (NONE, ("--guides", "guides/shot.####.exr")),
    "size": (("--model", "s", "--scale", "2"), ("--model", "s", "--size", "32x24"),
             ("--no-denoise",)),
    "look": (NONE, ("--tonemap",), ("--no-tonemap",)),
    "cuts": (NONE, ("--cuts", "none"), ("--cuts", "1,6")),
    "masks": (NONE, ("--leave", "auto"), ("--strength", "0")),
    "overlay": (NONE, ("--overlay", "ignore")),
    "memory": (NONE, ("--memory", "4G")),
    "frames": (NONE, ("--frames", "1-8"), ("--frames", "8-1")),
}


@cache
def go_together(*values: Value) -> bool:
    """Whether the values of two options may be given at once."""
    words = [*RUN_WORDS, *itertools.chain.from_iterable(values)]
    try:
        RUN.refuse_conflicts(PARSER.parse_args(words))
    except OptionError:
        return False
    return not any(pair <= {*words} for pair in APART)


def choose_runs() -> list[dict[str, Value]]:
    """Runs that have every two values that go together in at least one: each takes one value after
    the other, always the one that makes most new pairs."""
    pairs = [((a, x), (b, y)) for a, b in itertools.combinations(TABLE, 2) for x in TABLE[a]
             for y in TABLE[b]]
    left = {frozenset(pair) for pair in pairs if go_together(*(value for _, value in pair))}
    runs: list[dict[str, Value]] = []
    while left:
        run = dict(min(left, key=lambda pair: sorted(map(str, pair))))
        for name in sorted(TABLE.keys() - run, key=lambda name: (-len(TABLE[name]), name)):
            able = [value for value in TABLE[name]
                    if all(go_together(value, other) for other in run.values())]
            run[name] = max(able, key=lambda value: sum({(name, value), other} in left
                                                        for other in run.items()))
        left -= {frozenset(pair) for pair in itertools.combinations(run.items(), 2)}
        runs.append(run)
    return runs


@pytest.fixture
def troubled(write_exr, tmp_path: Path, monkeypatch) -> Path:
    """Seven frames: the second is cut short, the third is missing, the fourth lacks the motion that
    others have, the fifth has no guides and no reference. Frame 8 was never rendered."""
    random = np.random.default_rng(0)
    for number in (1, 2, 4, 5, 6, 7):
        planes = {name: random.random((12, 16), np.float32) for name in ("R", "G", "B", "depth.Z")}
        planes |= ({"motion.X": np.zeros((12, 16)), "motion.Y": np.zeros((12, 16))} if number != 4
                   else {})
        write_exr(f"in/shot.{number:04d}.exr", planes)
        if number != 5:
            write_exr(f"guides/shot.{number:04d}.exr",
                      {f"albedo.{name}": np.ones((24, 32)) for name in "RGB"})
            write_exr(f"ref/shot.{number:04d}.exr", {name: np.ones((24, 32)) for name in "RGB"})
    second = tmp_path / "in/shot.0002.exr"
    second.write_bytes(second.read_bytes()[:900])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def expected_faults(words: list[str]) -> dict[int, str]:
    """Frame -> what becomes of it, of those that fail."""
    copied = "resampled" if "copy" in words else "left out"
    faults = {2: "left out", 3: "left out"}
    # which read no motion
    faults |= ({} if {"--no-denoise", "--strength"} & {*words} else {4: copied})
    faults |= {5: copied} if "--guides" in words else {}
    return faults | ({8: "left out"} if "--frames" in words else {})


@pytest.mark.soak
def test_every_pair_of_options_beside_missing_frames(troubled, capsys):
    pytest.importorskip("flip_evaluator", reason="--reference needs the extra 'bench'")
    runs = choose_runs()
    assert len(runs) < 30
    for values in runs:
        words = [*RUN_WORDS, *itertools.chain.from_iterable(values.values())]
        for folder in ("out", "look"):
            shutil.rmtree(troubled / folder, ignore_errors=True)
        (troubled / "report.html").unlink(missing_ok=True)
        there = {6} if "--skip-existing" in words else set()
        for number in there:
            size = (12, 16) if "--no-denoise" in words else (24, 32)
            write_frame(words[words.index("-o") + 1].replace("####", f"{number:04d}"),
                        Frame({Role.COLOUR: np.ones((*size, 3), np.float32)}))
        code = main(words)
        told = capsys.readouterr()
        assert code == 3, (words, told.err)
        report = json.loads(told.out)
        faults = expected_faults(words)
        assert {fault["frame"]: fault["instead"] for fault in report["faults"]} == faults, words
        last = 9 if "--frames" in words else 8
        made = {number for number in range(1, last) if faults.get(number) != "left out"}
        assert {int(Path(path).name[5:9]) for path in report["outputs"]} == made - there, words
        assert {int(path.name[5:9]) for path in (troubled / "out").glob("shot.*")} == made, words
        assert ("--report" in words) == (troubled / "report.html").is_file(), words
        assert "--capture" not in words or json.loads((troubled / "look/capture.json")
                                                      .read_text())["buffers"], words
