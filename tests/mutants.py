"""Do the tests find faults? Puts small faults into postfx, one at a time, and runs the tests that
should find them.

Faults are of two kinds: some are chosen by hand, the rest is drawn from the sources by a seed. A
drawn fault swaps an operator, adds 1 to or takes 1 from a number, swaps min and max, drops a `not`,
an `abs` or a statement. The draw goes by the text of each line, so that changes elsewhere in the
sources leave it as it is.

Everything happens in a copy of the checkout. Kernels of changed sources are compiled into a copy of
the cache. The test that found a fault in the table before is tried first: most faults then take
seconds.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import hashlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

CHECKOUT = Path(__file__).resolve().parent.parent
TABLE = Path(__file__).with_suffix(".md")
EXAMPLES = """examples:
  python -m tests.mutants                  all of them; writes tests/mutants.md (about half an hour)
  python -m tests.mutants --resume         goes on after a break, and tries again what nothing found
  python -m tests.mutants --only kernels/denoise   those of some files
  python -m tests.mutants --list                   what would be done
"""
SEED = 33
PATIENCE = 1200
"""Seconds after which tests that do not end count as having found the fault."""
NO_TESTS = 5
"""Exit code of pytest where no test was to be run."""
COPIED = ("postfx", "tests", "training", "docs", "samples", "pyproject.toml", "README.md",
          "Makefile", "LICENSE", "NOTICE", "constraints.txt", "web", "hosts", "mkdocs.yml",
          "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
LINKED = ("models",)


class Room(NamedTuple):
    """Sources, how many faults are drawn from them, and what pytest is given to find them."""

    sources: str
    drawn: int
    tests: str


def _kernels(module: str, drawn: int, *names: str, also: str = "") -> tuple[Room, Room]:
    """The compiled rows of some kernels, and their CUDA sources. also: more tests, if their names
    fit."""
    chosen = " or ".join(names)
    cuda = "tests/kernels/test_cuda_kernels.py"
    python = (f"tests/kernels/test_denoise_kernels.py {cuda} tests/stress/test_kernel_bounds.py "
              f"{also}")
    return (Room(f"postfx/kernels/denoise/{module}.py", drawn, f"{python} -k '{chosen}'"),
            Room(f"postfx/kernels/denoise/{module}.cu", 0, f"{cuda} -k '{chosen}'"))


def _room(sources: str, drawn: int, *tests: str) -> Room:
    return Room(f"postfx/{sources}", drawn,
                " ".join(test if " " in test else f"tests/{test}" for test in tests))


def _in(folder: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{folder}/test_{name}.py" for name in names)


ROOMS = (
    *_kernels("features", 1, "denoise_features", "denoise_guides", "denoise_trust",
              "denoise_upsample_guided"),
    *_kernels("pyramid", 3, "denoise_pool", "denoise_mix", "denoise_filter", "denoise_remodulate",
              "denoise_alpha_level", "denoise_enlarge_alpha"),
    *_kernels("prepare", 1, "denoise_scale", "denoise_dilate", "denoise_means",
              "denoise_accumulate"),
    *_kernels("network_io", 2, "denoise_pack", "denoise_open", "denoise_store", "stored"),
    *_kernels("output", 1, "denoise_judge", "denoise_detail", "denoise_restore", "detail_is_told",
              "denoise_assemble", "denoise_strength"),
    *_kernels("alpha", 2, "denoise_gather", "denoise_fit", "denoise_correct"),
    *_kernels("history", 1, "denoise_history", "denoise_resize", "denoise_reactive",
              "denoise_spread", "denoise_keep", "denoise_reflections", "error_of_reflections",
              also="tests/passes/test_denoise_reflections.py"),
    *_kernels("upsample", 3, "denoise_upsample"),
    *_kernels("parts", 1, "denoise_accumulate_part", "denoise_reflectance",
              "denoise_upsample_light", "denoise_balance", "denoise_decode"),
    _room("kernels/neural.", 2, "neural"),
    _room("kernels/common.cuh", 0, "kernels/test_cuda_kernels.py",
          "-k 'denoise_history or denoise_upsample_light'"),
    _room("kernels/denoise/__init__.py", 0, *_in("kernels", "denoise_kernels")),
    _room("kernels/image.", 3, "kernels", *_in("passes", "composite_overlay"), "test_sampling.py",
          "-k 'resampl or overlay or checkerboard or sampling or cells'"),
    _room("kernels/tonemap.", 2, *_in("kernels", "tonemap_kernels", "cuda_kernels"),
          "-k 'not denoise_'"),
    _room("kernels/colour.", 1, *_in("kernels", "tonemap_kernels"),
          "-k 'encode_display or apply_cube'"),
    _room("io/pixel_formats.", 8,
          *_in("io", "image_file", "encode_dither", "writer", "encode_light")),
    _room("passes/denoise/tiling.py", 3, *_in("passes", "denoise_tiles", "denoise_strength"),
          "test_memory_budget.py", *_in("stress", "tiles")),
    _room("passes/denoise/", 5,
          *_in("passes", "denoise_upscale", "denoise_1x", "denoise_guides", "denoise_reactive",
               "denoise_strength", "denoise_int8", "denoise_models", "denoise_budget",
               "denoise_restore", "denoise_reflections", "denoise_tiles", "denoise_parts"),
          "test_trouble.py"),
    _room("passes/", 3, *_in("passes", "registry", "contract", "display", "composite_overlay",
                             "exposure_tool",
                             "composite_both_ways", "tonemap"), "test_on_device.py"),
    _room("io/exr/", 4, *_in("files", "kept", "broken"), *_in("io", "writer", "image_file")),
    _room("io/quantisation.py", 1, *_in("io", "encode_dither", "writer")),
    _room("io/png.py", 1, *_in("io", "encode_png", "writer")),
    _room("io/icc.py", 1, *_in("io", "encode_tags")),
    _room("io/read_plan.py", 1, *_in("io", "read_plan", "frame_reader", "frame_reader_guides")),
    _room("io/windows.py", 1, *_in("files", "windows"), *_in("io", "frame_reader")),
    _room("io/masks.py", 1, *_in("io", "masks")),
    _room("io/convert.py", 1, *_in("io", "convert_depth", "frame_reader"),
          "files/test_profiles.py"),
    _room("io/pattern.py", 9, *_in("io", "sequence"), *_in("files", "paths")),
    _room("io/sequence.py", 5,
          *_in("io", "sequence", "frame_reader_guides", "parts", "views", "estimated_motion"),
          *_in("files", "broken")),
    _room("io/writer.py", 7, *_in("io", "writer", "encode_tags", "parts", "views"),
          *_in("files", "paths", "whole_or_nothing")),
    _room("io/", 4, "io", *_in("files", "windows", "profiles", "broken", "paths")),
    _room("runtime/hazards.py", 3, *_in("runtime", "hazards", "hazards_random", "barriers")),
    _room("runtime/heap.py", 3, *_in("runtime", "heap_plan", "heap_arena", "heap")),
    _room("runtime/memory.py", 1, *_in("runtime", "memory", "heap")),
    _room("runtime/model_file.py", 1, *_in("reliability", "models"), *_in("runtime", "models")),
    _room("runtime/", 5, "runtime"),
    _room("doctor/", 6, "doctor"),
    _room("runs/", 5, *_in("reliability", "schedule", "run", "locks", "resume"),
          *_in("cli", "chunks"), *_in("passes", "denoise_models")),
    _room("temporal/", 3, "temporal", *_in("integrate", "motion")),
    _room("masks/", 3, "masks", *_in("io", "masks")),
    _room("exposure.py", 1, "exposure"),
    _room("tools/exposure/", 1, "exposure"),
    _room("colour/", 2, "colour", *_in("exposure", "views"),
          *_in("passes", "display", "display_view"), "test_look_table.py"),
    _room("integrate/", 2, "integrate"),
    _room("interpolate/", 4, "interpolate"),
    _room("neural", 1, "neural"),
    _room("depth.py", 1, "integrate", *_in("io", "convert_depth"), "doctor/test_breakages.py"),
    _room("files.py", 1, "test_files.py", *_in("files", "whole_or_nothing")),
    _room("system.py", 1, "test_system.py", "test_memory_budget.py"),
    _room("sampling.py", 1, "test_sampling.py", "masks"),
    _room("tools/look_table.py", 1, "test_look_table.py"),
    _room("cuts.py", 1, "test_cuts.py"),
    _room("plan.py", 1, "test_plan.py"),
    _room("pipeline.py", 1, "test_pipeline.py", *_in("passes", "contract")),
    _room("frame.py", 1, "test_frame.py", *_in("io", "frame_reader")),
    _room("repair.py", 1, *_in("stress", "bad_pixels")),
    _room("tools/report/", 2, "report"),
    _room("tools/bench/", 1, "bench"),
    _room("cli/", 3, *_in("cli", "options", "run", "inspect", "report", "exposure", "ray"),
          *_in("files", "on_error"), *_in("io", "views")),
)
"""The first one that holds a source is its room."""
CHOSEN = (
    ("h", "clip(y + j, picture.height)", "clip(y + j, picture.height - 1)"),
    ("cpp", "Long(seen_columns.at[x])) + 1 + 2 * side", "Long(seen_columns.at[x])) + 1 + side"),
    ("cpp", "picked_planes<3>(normal(y), columns.at, -1.0f",
     "picked_planes<3>(normal(y), columns.at, 0.0f"),
    ("cpp", "within<F>(log, LEAST_LOG_ERROR, MOST_LOG_ERROR)", "log"),
    ("cpp", "((first + x + 1) * width + w - 1)", "((first + x + 1) * width)"),
    ("py", "(LASTING + WITHOUT_HISTORY / frames)", "(LASTING + WITHOUT_HISTORY)"),
    ("cuh", "clip(top + 3, height)", "clip(top + 2, height)"),
    ("cuh", "from_x - part.left", "from_x - part.top"),
    ("h", "found.inside = px <= float(w) - 0.5f", "found.inside = px <= float(w) + 0.5f"),
    ("h", "Four{gain, gain, gain, share}", "Four{gain, gain, gain, 1.0f}"),
    ("py", "BLEND = TAP_WEIGHTS + PHASES", "BLEND = TAP_WEIGHTS + PHASES - 1"),
    ("cpp", "x + column - REACH", "x - column + REACH"),
    ("cpp", "below + (x + second) / 2", "below + x / 2"),
    ("cpp", "phase = 4 * channel + 2 * (y % 2)", "phase = 4 * channel + (y % 2)"),
    ("cu", "2 * (y % 2) + x % 2) * part", "2 * (x % 2) + y % 2) * part"),
    ("cpp", "size_of<float>(columns.at[side]) > MARGIN - 3", "columns.at[side] > MARGIN - 3"),
    ("h", "low = least * alpha;", "low = least;"),
    ("cpp", "F(greys->equal) : F(greys->other)", "F(greys->other) : F(greys->equal)"),
    ("py", "_halo(model) * 4 // 3", "_halo(model) // 3"),
    ("py", "min(max(0, first - halo) // grid * grid, last)", "min(max(0, first - halo), last)"),
    ("py", 'pack("<2i", top + first, len(chunk))', 'pack("<2i", top, len(chunk))'),
    ("py", "if len(packed) < plain.size else plain.tobytes()", ""),
    ("py", "-down - first_row, -right", "-down, -right"),
    ("py", "self._inner |= self._current", "self._inner = self._current and self._inner"),
    ("py",
     "elif isinstance(record, ConsumerBarrier):\n            _order(self._finished, record, "
     "self._waits)",
     "elif isinstance(record, ConsumerBarrier):\n            _order(self._finished, record, "
     "self._later)"),
    ("py", "and _begun(self.pid) == self.begun", ""),
    ("py", "if _holder(self._path) == Process.me():", "if True:"),
    ("py", "(about.pattern, about.fingerprint) == (pattern, fingerprint)",
     "about.pattern == pattern"),
    ("py", "path.stat().st_size == output.bytes and hash_file(path) == output.sha256",
     "path.stat().st_size == output.bytes"),
    ("py", "if exponent in (0, 255)", "if exponent == 0"),
    ("cpp", "inverse(j, i)[1] = -down;", "inverse(j, i)[1] = down;"),
    ("cpp", "if (!(z < nearest(j)[i])) continue;", ""),
    ("py", "not (cut or frame.reset)", "not cut"),
)
"""The kind of source, what stands once in all of postfx's sources of that kind, and the fault in
its place."""
EQUIVALENT = {
    "number: 0 -> -1 in for before, frame in zip([frames[0]": "the motion of the first frame leads "
    "to none before it",
    "number: 1 -> 2 in head = json.dumps(": "JSON means the same with other spaces",
    "number: 0.0 -> -1.0 in signal = np.clip(": "what is below 0 becomes 0, too",
    "number: 0 -> -1 in mix_row(": "the output of a network holds one frame, the first and the "
    "last",
    "number: 0 -> -1 in headers[0].part_type == other": "a file of one part has one header",
    "number: 7 -> 6 in shifted = [correlation(": "noise is as unrelated to that of six pixels away "
    "as of seven",
    "number: 1 -> 0 in x += 1": "the pixel is computed a second time",
}
"""How the name of a fault begins -> why no test can find it."""


@dataclass(frozen=True)
class Mutant:
    """One fault: a part of a source's text, and what it is replaced by."""

    source: str
    start: int
    end: int
    new: str
    line: int
    old_line: str
    kind: str

    @property
    def name(self) -> str:
        """What tells it from all others, as long as its line is there."""
        old = " ".join(_text(self.source)[self.start:self.end].split())
        new = " ".join(self.new.split()) or "nothing"
        return f"{self.kind}: {old} -> {new} in {self.old_line}"

    @property
    def place(self) -> str:
        """Its source, within postfx."""
        return self.source.removeprefix("postfx/")

    @property
    def excuse(self) -> str:
        """Why no test can find it; empty where one should."""
        return next((why for start, why in EQUIVALENT.items() if self.name.startswith(start)), "")

    def apply(self) -> str:
        """The whole source with the fault."""
        text = _text(self.source)
        return text[:self.start] + self.new + text[self.end:]


@cache
def _text(source: str) -> str:
    return (CHECKOUT / source).read_text(encoding="utf-8")


def room_of(source: str) -> Room | None:
    """The first room that holds a source."""
    return next((room for room in ROOMS if source.startswith(room.sources)), None)


def chosen() -> Iterator[Mutant]:
    """Faults that are chosen by hand; those that the sources no longer have a place for are
    told."""
    for suffix, old, new in CHOSEN:
        places = [source for source in sources(suffix) for _ in range(_text(source).count(old))]
        if len(places) != 1:
            print(f"found {len(places)} times, not once: {old!r} {' '.join(places)}",
                  file=sys.stderr)
            continue
        first = _text(places[0]).index(old)
        yield _mutant(places[0], first, first + len(old), new, "chosen")


def sources(suffix: str) -> list[str]:
    """All of postfx's sources of a kind."""
    return sorted(path.relative_to(CHECKOUT).as_posix()
                  for path in (CHECKOUT / "postfx").rglob(f"*.{suffix}"))


def _mutant(source: str, first: int, last: int, new: str, kind: str) -> Mutant:
    line = _text(source)[:first].count("\n")
    return Mutant(source, first, last, new, line + 1, _text(source).splitlines()[line].strip(),
                  kind)


SWAPS = {
    ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.Add: ("+", "-"), ast.Sub: ("-", "+"),
    ast.Mult: ("*", "+"), ast.FloorDiv: ("//", "*"), ast.And: ("and", "or"), ast.Or: ("or", "and"),
}
NAMES = {"min": "max", "max": "min", "abs": "", "minimum": "maximum", "maximum": "minimum",
         "any": "all", "all": "any"}


def candidates(source: str) -> Iterator[Mutant]:
    """All faults that can be drawn from a source."""
    text = _text(source)
    starts = [0]
    for line in text.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line.decode()))
    lines = text.splitlines()

    def at(line: int, column: int) -> int:
        return starts[line - 1] + len(lines[line - 1].encode()[:column].decode())

    def end_of(node: ast.expr | ast.stmt) -> int:
        assert node.end_lineno is not None and node.end_col_offset is not None, "it was parsed"
        return at(node.end_lineno, node.end_col_offset)

    for function in (node
                     for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)):
        inner = [inside for part in function.body for inside in ast.walk(part)]
        for node in inner:
            if isinstance(node, ast.Compare | ast.BinOp | ast.BoolOp):
                pairs = _pairs(node)
                for operator, left, right in pairs:
                    if type(operator) not in SWAPS:
                        continue
                    old, new = SWAPS[type(operator)]
                    first, last = end_of(left), at(right.lineno, right.col_offset)
                    found = re.search(rf"(?<![<>=!*/]){re.escape(old)}(?![<>=*/])",
                                      text[first:last])
                    if found and not isinstance(getattr(left, "value", None), str):
                        yield _mutant(source, first + found.start(), first + found.end(), new,
                                      "operator")
            elif (isinstance(node, ast.Constant) and isinstance(node.value, int | float)
                  and not isinstance(node.value, bool)):
                first, last = at(node.lineno, node.col_offset), end_of(node)
                for new_value in (node.value + 1, node.value - 1):
                    yield _mutant(source, first, last, repr(new_value), "number")
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
                name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
                if name in NAMES:
                    last = end_of(node.func)
                    first = (last - len(name) if NAMES[name]
                             else at(node.func.lineno, node.func.col_offset))
                    yield _mutant(source, first, last, NAMES[name], "call")
            elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
                first = at(node.lineno, node.col_offset)
                last = at(node.operand.lineno, node.operand.col_offset)
                if text[first:last].strip() in ("not", "-"):
                    yield _mutant(source, first, last, "", "dropped")
            elif isinstance(node, ast.AugAssign | ast.Raise) or (
                isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
            ):
                first, last = at(node.lineno, node.col_offset), end_of(node)
                yield _mutant(source, first, last, "pass", "dropped")


def _pairs(node: ast.Compare | ast.BinOp | ast.BoolOp) -> list[tuple[ast.AST, ast.expr, ast.expr]]:
    """Operators with what stands on both sides."""
    if isinstance(node, ast.BinOp):
        return [(node.op, node.left, node.right)]
    values = node.values if isinstance(node, ast.BoolOp) else [node.left, *node.comparators]
    operators = [node.op] * len(values) if isinstance(node, ast.BoolOp) else node.ops
    return list(zip(operators, values, values[1:], strict=False))


def draw(seed: int) -> list[Mutant]:
    """Faults drawn from the rooms, spread over the lines of each."""
    found: list[Mutant] = []
    python = sources("py")
    for room in ROOMS:
        own = [item for source in python if room_of(source) is room for item in candidates(source)]
        names = {item.name: item for item in own}
        ranked = sorted(names, key=lambda name: _rank(seed, names[name]))
        found += [names[name] for name in ranked[:room.drawn]]
    return found


def _rank(seed: int, mutant: Mutant) -> bytes:
    return hashlib.sha256(f"{seed} {mutant.place}: {mutant.name}".encode()).digest()


class House:
    """A copy of the checkout, in which one source at a time is changed."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "checkout"
        self.root.mkdir()
        for name in COPIED:
            source = CHECKOUT / name
            if source.is_dir():
                shutil.copytree(source, self.root / name,
                                ignore=shutil.ignore_patterns("__pycache__"))
            elif source.exists():
                shutil.copy(source, self.root / name)
        for name in LINKED:
            (self.root / name).symlink_to(CHECKOUT / name)
        if (shared := CHECKOUT.parent / "shared").is_dir():
            (folder / "shared").symlink_to(shared.resolve())
        kernels = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "postfx"
        if kernels.is_dir():
            shutil.copytree(kernels, folder / "cache/postfx", copy_function=_copy_if_there)
        self._environment = {**os.environ, "PYTHONPATH": str(self.root),
                             "XDG_CACHE_HOME": str(folder / "cache"),
                             "PYTHONDONTWRITEBYTECODE": "1"}

    def find(self, arguments: list[str]) -> str | None:
        """The first test that fails, None where all pass; raises RuntimeError where no test
        runs."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "--tb=no", "--no-header",
                   "-p", "no:cacheprovider", "-m", "not soak and not slow", *arguments]
        try:
            done = subprocess.run(command, cwd=self.root, env=self._environment,
                                  capture_output=True, text=True, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired:
            return "does not end"
        if done.returncode == 0:
            return None
        found = re.search(r"^(?:FAILED|ERROR) (\S+::\w+(?:\[.*?\])?)(?= - |$)", done.stdout,
                          re.MULTILINE)
        if found:
            return found[1]
        if done.returncode == NO_TESTS or "directory not found" in done.stderr:
            raise RuntimeError(f"{arguments}\n{done.stdout}{done.stderr}")
        return "does not load" if done.returncode > 0 else f"signal {-done.returncode}"

    def find_fault(self, mutant: Mutant, before: str = "") -> str | None:
        """The first test that finds a fault; the one that found it `before` is tried first."""
        room = room_of(mutant.source)
        tests = "tests/kernels/test_denoise_kernels.py" if room is None else room.tests
        path = self.root / mutant.source
        path.write_text(mutant.apply(), encoding="utf-8")
        try:
            known = "::" in before and (self.root / before.partition("::")[0]).exists()
            return (before if known and self.find([before]) == before
                    else self.find(shlex.split(tests)))
        finally:
            path.write_text(_text(mutant.source), encoding="utf-8")


def _copy_if_there(source: str, target: str) -> None:
    """Copy a file, unless another process that shares the cache has just removed it."""
    with contextlib.suppress(FileNotFoundError):
        shutil.copy2(source, target)


def rows_of(table: Path) -> dict[str, str]:
    """Fault -> what found it, from a table; '' for one that nothing found."""
    found = {}
    for line in table.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 4 and cells[0].isdigit():
            found[cells[2].strip("`")] = "" if cells[3].startswith("**") else cells[3].strip("`")
    return found


def commit() -> str:
    """The commit of the checkout, and whether what is tested differs from it; empty outside of a
    repository."""
    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=CHECKOUT, capture_output=True, text=True,
                              check=False)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--", "postfx", "tests/*.py")
    return git("rev-parse", "--short", "HEAD") + (", with changes" if changed else "")


def write_table(results: dict[Mutant, str | None], path: Path, seed: int, version: str) -> None:
    """The table as Markdown."""
    lost = [mutant for mutant, killer in results.items() if killer is None]
    equal = sum(bool(mutant.excuse) for mutant in lost)
    lines = ["# Faults put into postfx, and the tests that find them", "",
             f"Written by `python -m tests.mutants` (seed {seed}, sources of {version}). Of "
             f"{len(results)} faults,",
             f"{len(results) - len(lost)} are found; {equal} change nothing that a test could see; "
             f"{len(lost) - equal} are not found.", "",
             "| room | faults | found | no effect | not found |", "| --- | --- | --- | --- | --- |"]
    rooms = sorted({mutant.place.partition("/")[0] for mutant in results})
    for room in rooms:
        here = [mutant for mutant in results if mutant.place.partition("/")[0] == room]
        missed = [mutant for mutant in here if mutant in lost]
        excused = sum(bool(mutant.excuse) for mutant in missed)
        lines.append(f"| {room} | {len(here)} | {len(here) - len(missed)} | {excused} | "
                     f"{len(missed) - excused} |")
    lines += ["", *(f"- Not found in {mutant.place}: `{mutant.name}`: "
                    f"{mutant.excuse or 'a test is missing'}." for mutant in lost)]
    lines += ["", "| | source | fault | found by |", "| --- | --- | --- | --- |"]
    for number, (mutant, killer) in enumerate(results.items(), 1):
        by = (f"`{killer}`" if killer else f"**nothing**: {mutant.excuse}" if mutant.excuse
              else "**nothing**")
        cells = (str(number), f"{mutant.place}:{mutant.line}", f"`{mutant.name}`", by)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def worse(results: dict[Mutant, str | None], before: dict[str, str]) -> list[str]:
    """Faults that a table says were found, and that were not now."""
    return [mutant.name
            for mutant, killer in results.items() if killer is None and before.get(mutant.name)]


def run(mutants: Iterable[Mutant], before: dict[str, str],
        house: House) -> Iterator[tuple[Mutant, str | None]]:
    """Each fault and the test that found it, as they come."""
    for mutant in mutants:
        begin = time.monotonic()
        found = house.find_fault(mutant, before.get(mutant.name, ""))
        took = f"{time.monotonic() - begin:5.0f} s"
        print(f"{took}  {mutant.source}: {mutant.name}: {found or 'NOT FOUND'}", flush=True)
        yield mutant, found


def main() -> int:
    """0 where no fault is missed that was found before."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__,
                                     epilog=EXAMPLES,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED,
                        help="draws other faults (default: %(default)s)")
    parser.add_argument("--only", default="", metavar="TEXT",
                        help="faults whose name or file has this text; writes no table")
    parser.add_argument("--list", action="store_true", help="show the faults and do nothing")
    parser.add_argument("--table", type=Path, default=TABLE,
                        help="where the table is written (default: %(default)s)")
    parser.add_argument("--against", type=Path, default=TABLE, metavar="TABLE",
                        help="an earlier table: what it found must be found again (default: "
                        "%(default)s)")
    parser.add_argument("--resume", action="store_true",
                        help="keep the rows that --table has with a test or a reason")
    options = parser.parse_args()
    mutants = [mutant for mutant in (*chosen(), *draw(options.seed))
               if options.only in f"{mutant.source} {mutant.name}"]
    if options.list:
        print(*(f"{mutant.source}: {mutant.name}" for mutant in mutants), sep="\n")
        return 0
    before, version = rows_of(options.against), commit()
    known = rows_of(options.table) if options.resume else {}
    results = {mutant: known[mutant.name] or None for mutant in mutants
               if mutant.name in known and (known[mutant.name] or mutant.excuse)}
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        house = House(Path(folder))
        for mutant, found in run([mutant for mutant in mutants if mutant not in results], before,
                                 house):
            results[mutant] = found
            if not options.only:
                in_order = {mutant: results[mutant] for mutant in mutants if mutant in results}
                write_table(in_order, options.table, options.seed, version)
        finders = sorted({found for found in results.values() if found and "::" in found})
        broken = house.find(finders) if finders else None
    missed = worse(results, before)
    print(f"{sum(map(bool, results.values()))} of {len(results)} faults found")
    print(*(f"was found before: {name}" for name in missed), sep="\n", end="\n" if missed else "")
    if broken:
        print(f"fails without any fault, so that it finds nothing: {broken}")
    return bool(missed or broken)


if __name__ == "__main__":
    sys.exit(main())
