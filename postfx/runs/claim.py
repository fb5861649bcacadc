"""Which files a run is about to write, told to other runs, so that no two write the same ones."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from postfx.errors import RunError
from postfx.files import parse_json, read_text
from postfx.runs.process import Process, age_of

BEAT = 10.0
"""Seconds between two signs of life."""
SILENT = 120.0
"""Seconds without one after which a run on another machine counts as gone."""
SUFFIX = ".claim"


class Claim:
    """Files of a folder that one run writes. Make it while holding the folder's lock.

    A sign of life is given by a thread that touches the claim's file. Claims of runs that are gone are removed. Raises
    RunError when a run that is not gone has one of the files.
    """

    def __init__(self, folder: Path, run: str, names: Iterable[str]) -> None:
        wanted = set(names)
        for other in folder.glob(f"*{SUFFIX}"):
            _refuse_shared(other, wanted)
        self.path = folder / f"{run}{SUFFIX}"
        facts = {"process": Process.me().as_dict(), "files": sorted(wanted)}
        self.path.write_text(json.dumps(facts), encoding="utf-8")
        self._over = threading.Event()
        threading.Thread(target=self._beat, name="postfx claim", daemon=True).start()

    def release(self) -> None:
        """The files may be written by others again."""
        self._over.set()
        self.path.unlink(missing_ok=True)

    def _beat(self) -> None:
        while not self._over.wait(BEAT):
            with suppress(OSError):
                os.utime(self.path)


def is_alive(folder: Path, run: str) -> bool:
    """Whether a run has a claim and is not gone."""
    path = folder / f"{run}{SUFFIX}"
    return path.exists() and not _is_gone(path, _process(path)[0])


def _refuse_shared(path: Path, wanted: set[str]) -> None:
    process, files = _process(path)
    if _is_gone(path, process):
        path.unlink(missing_ok=True)
        return
    shared = sorted(wanted & files)
    if shared:
        raise RunError(f"{path.parent.parent / shared[0]}: is being written by {process}: wait for it, or choose other "
                       f"frames or another folder (if it is gone, delete {path})")


def _process(path: Path) -> tuple[Process, set[str]]:
    """Whose claim it is, and to what; of one that cannot be read, nobody's to nothing."""
    try:
        facts = parse_json(read_text(path))
        return Process.of(facts.get("process")), set(facts.get("files", ()))
    except (OSError, ValueError, AttributeError, TypeError):
        return Process.of(None), set()


def _is_gone(path: Path, process: Process) -> bool:
    alive = process.is_alive()
    return alive is False or (alive is None and age_of(path) > SILENT)
