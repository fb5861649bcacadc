"""How many of postfx's files a frame passes on its way through `postfx run`, once all is prepared.

`python -m tests.test_frame_path` lists them, with the functions in each and the calls. Those that
call compiled kernels are listed but do not count. Neither do the manifest and checkpoints, which
are written every few seconds and not for every frame.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
import threading
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import postfx
from postfx.cli.main import main

PACKAGE = Path(postfx.__file__).parent
ROOM = PACKAGE.parent / "samples" / "room"
OUTPUTS = {"EXR": ("exr", "--tonemap", "neutral"), "PNG": ("png",)}
MOST = 52
"""Files that a steady frame may pass."""
CALL_KERNELS = ("kernels/", "compiled/", "planes.py", "io/pixel_formats.py")
"""Files and folders that call compiled kernels, which are not counted."""
FIRST, LAST = 4, 6
"""Frames that count: what begins between the first one's passes and the last one's, in any
thread."""


class Watch:
    """Notes every function of postfx that is called while the frames that count are on their way.

    Attributes:
        calls: path below the package and name of a function -> how often it is called.
    """

    def __init__(self) -> None:
        self.calls: Counter[tuple[str, str]] = Counter()
        self._frames = 0

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(str(PACKAGE)):
            return
        self._frames += code.co_qualname == "Pipeline.__call__"
        if FIRST <= self._frames < LAST:
            self.calls[code.co_filename[len(str(PACKAGE)) + 1 :], code.co_qualname] += 1

    @property
    def found(self) -> dict[str, set[str]]:
        """Path below the package -> names of functions."""
        found: dict[str, set[str]] = defaultdict(set)
        for path, name in self.calls:
            found[path].add(name)
        return found

    def count_calls(self, start: str = "") -> float:
        """Calls on a frame's way, of functions in files whose path begins so; comprehensions count
        as Python counts."""
        counts = (count for (path, _), count in self.calls.items() if path.startswith(start))
        return sum(counts) / (LAST - FIRST)

    def count_functions(self, start: str = "") -> int:
        """Functions that a reader steps into, in files whose path begins so: all but
        comprehensions."""
        return sum(path.startswith(start) and not name.endswith(("comp>", "genexpr>"))
                   for path, name in self.calls)


@contextlib.contextmanager
def watched() -> Iterator[Watch]:
    """Watch this thread and those that it starts."""
    watch = Watch()
    threading.setprofile(watch)
    sys.setprofile(watch)
    try:
        yield watch
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type,unused-ignore]


def watch_run(folder: Path, suffix: str, *options: str) -> Watch:
    """What steady frames of the sample room pass."""
    command = ["run", str(ROOM / "noisy.####.exr"), "-o", str(folder / f"out.####.{suffix}"),
               "--frames", f"1-{LAST}", "--model", "s", "--device", "cpu", "--threads", "2",
               "--run-up", "0", "--checkpoint", "1e9"]
    with pytest.MonkeyPatch.context() as patch, watched() as watch:
        patch.setattr("postfx.runs.folder.LEAST_SECONDS", 1e9)
        assert main([*command, *options]) == 0
    return watch


def counted(found: Iterable[str]) -> list[str]:
    """The files that count, sorted."""
    return sorted(path for path in found if not path.startswith(CALL_KERNELS))


@pytest.mark.parametrize("output", OUTPUTS)
def test_a_steady_frame_passes_few_files(output: str, tmp_path: Path) -> None:
    found = watch_run(tmp_path, *OUTPUTS[output]).found
    assert {"pipeline.py", "io/frame_reader.py", "io/writer.py",
            "runtime/commands.py"} <= set(found), "of every thread"
    passed = counted(found)
    assert len(passed) <= MOST, "\n".join(passed)


if __name__ == "__main__":
    for name, options in OUTPUTS.items():
        with tempfile.TemporaryDirectory() as made:
            passed = watch_run(Path(made), *options)
        listed = passed.found
        print(f"{name}: {len(counted(listed))} files, {len(listed)} with compiled kernels; "
              f"{passed.count_functions()} functions, {passed.count_calls():.0f} calls a frame")
        for file, names in sorted(listed.items()):
            print(f"  {file:<34}{passed.count_calls(file):>6.0f} calls  {' '.join(sorted(names))}")
