"""How many of postfx's files a frame passes on its way through `postfx run`, once all is prepared.

`python -m tests.test_frame_path` lists them, with the functions in each. Those that call
compiled kernels are listed but do not count. Neither do the manifest and checkpoints, which are written every few
seconds and not for every frame.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
import threading
from collections import defaultdict
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
MOST = 51
"""Files that a steady frame may pass."""
FIRST, LAST = 4, 6
"""Frames that count: what begins between the first one's passes and the last one's, in any thread."""


class Watch:
    """Notes every function of postfx that is called while the frames that count are on their way.

    Attributes:
        found: path below the package -> names of functions.
    """

    def __init__(self) -> None:
        self.found: dict[str, set[str]] = defaultdict(set)
        self._frames = 0

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(str(PACKAGE)):
            return
        self._frames += code.co_qualname == "Pipeline.__call__"
        if FIRST <= self._frames < LAST:
            self.found[str(Path(code.co_filename).relative_to(PACKAGE))].add(code.co_qualname)


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
        threading.setprofile(None)  # type: ignore[arg-type]


def files_of(folder: Path, suffix: str, *options: str) -> dict[str, set[str]]:
    """Files, with functions, that a steady frame of the sample room passes."""
    command = ["run", str(ROOM / "noisy.####.exr"), "-o", str(folder / f"out.####.{suffix}"), "--frames", f"1-{LAST}",
               "--model", "s", "--device", "cpu", "--threads", "2", "--run-up", "0", "--checkpoint", "1e9"]
    with pytest.MonkeyPatch.context() as patch, watched() as watch:
        patch.setattr("postfx.runs.folder.LEAST_SECONDS", 1e9)
        assert main([*command, *options]) == 0
    return watch.found


def counted(found: Iterable[str]) -> list[str]:
    """The files that count, sorted."""
    return sorted(path for path in found if not path.startswith("kernels/"))


@pytest.mark.parametrize("output", OUTPUTS)
def test_a_steady_frame_passes_few_files(output: str, tmp_path: Path) -> None:
    found = files_of(tmp_path, *OUTPUTS[output])
    assert {"pipeline.py", "io/frame_reader.py", "io/writer.py", "runtime/commands.py"} <= set(found), "of every thread"
    passed = counted(found)
    assert len(passed) <= MOST, "\n".join(passed)


if __name__ == "__main__":
    for name, options in OUTPUTS.items():
        with tempfile.TemporaryDirectory() as made:
            listed = files_of(Path(made), *options)
        functions = sum(map(len, listed.values()))
        print(f"{name}: {len(counted(listed))} files, {len(listed)} with compiled kernels; {functions} functions")
        for path, names in sorted(listed.items()):
            print(f"  {path:<34}{' '.join(sorted(names))}")
