"""A run's part of an output folder: its claim, its entries in the manifest, its checkpoint."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from postfx.errors import CheckpointError, ManifestError, WriteError
from postfx.files import despite_readers, hash_file, remove, remove_leftovers
from postfx.runs.checkpoint import SUFFIX, About, load_checkpoint, read_about, save_checkpoint
from postfx.runs.locks import Claim, FolderLock, is_alive
from postfx.runs.manifest import NAME, WORK_FOLDER, Manifest, Output, load_manifest, update_manifest

LEAST_SECONDS, MOST_SHARE = 1.0, 0.05
"""Least seconds between two writes of the manifest, and the largest share of the run's time that they take."""


class RunFolder:
    """Reserves the files of one run in an output folder, and records them there.

    names: of the files that the run may write. Raises RunError if another run is writing one of them, OSError if the
    folder cannot be written, ManifestReadError if its manifest cannot be read.

    Attributes:
        before: the manifest of earlier runs.
        warnings: oddities found in it.
    """

    def __init__(self, folder: Path, run: str, names: Collection[str]) -> None:
        self.warnings: list[str] = []
        self._folder, self._work, self._run = folder, folder / WORK_FOLDER, run
        self._unsaved: dict[str, Output] = {}
        self._facts: dict[str, Any] = {}
        self._wrote = False
        self._flushed, self._cost = time.monotonic(), 0.0
        self._work.mkdir(parents=True, exist_ok=True)
        with FolderLock(self._work / "lock"):
            for path in folder.glob(f".{NAME}.*"):  # who writes the manifest holds the lock: these are of killed runs
                remove(path)
            self._claim = Claim(self._work, run, names)
        try:
            self._remove_leftovers(names)
            self.before = self._known()
        except BaseException:
            self.release()
            raise

    def note(self, facts: Mapping[str, Any], outputs: Mapping[str, Output]) -> None:
        """Record facts about the run and its outputs in the manifest."""
        self._facts.update(facts)
        self._unsaved.update(outputs)
        self.flush()

    def add_output(self, path: Path, run_facts: Mapping[str, Any], **facts: Any) -> Output:
        """Record a file that was written; it is in the manifest within a few seconds."""
        output = Output(self._run, sha256=hash_file(path), bytes=path.stat().st_size, **facts)
        self._facts.update(run_facts)
        self._unsaved[path.name] = output
        self._wrote = True
        if time.monotonic() - self._flushed > max(LEAST_SECONDS, self._cost / MOST_SHARE):
            self.flush()
        return output

    def flush(self) -> None:
        """Write the manifest."""
        begin = time.monotonic()
        try:
            update_manifest(self._folder, self._enter)
        except OSError as error:
            raise WriteError(f"{self._folder / NAME}: cannot be written: {error.strerror}; check free space") from error
        self._unsaved.clear()
        self._flushed = time.monotonic()
        self._cost = self._flushed - begin

    def checkpoints(self, pattern: str, fingerprint: str) -> dict[int, Path]:
        """Intact checkpoints that a run with this pattern and fingerprint can use, by frame number."""
        found: dict[int, Path] = {}
        for path, about in self._abouts():
            if (about.pattern, about.fingerprint) == (pattern, fingerprint):
                try:
                    load_checkpoint(path)
                    found[about.frame] = path
                except CheckpointError as error:
                    self.warnings.append(f"{error}: not used")
        return found

    def save(self, pattern: str, fingerprint: str, frame: int, history: Mapping[str, np.ndarray],
             relax: Callable[[], None]) -> int:
        """Replace the run's last checkpoint; returns the new one's size in bytes."""
        about = About(self._run, pattern, frame, fingerprint)
        return save_checkpoint(self._work / f"{self._run}{SUFFIX}", about, history, relax)

    def close(self, facts: Mapping[str, Any], finished: Collection[int], pattern: str) -> None:
        """End the run. Removes checkpoints after frames in `finished`, which are no longer needed, and the manifest's
        entries of a run that wrote nothing."""
        try:
            self.note(facts, {})
            if not self._wrote:
                update_manifest(self._folder, self._take_back)
            for path, about in self._abouts():
                own = about.run == self._run or not is_alive(self._work, about.run)
                if own and about.pattern == pattern and about.frame in finished:
                    remove(path)
        finally:
            self.release()

    def release(self) -> None:
        """Release the run's files."""
        self._claim.release()
        with suppress(OSError):  # other runs may use it
            self._work.rmdir()

    def _enter(self, manifest: Manifest) -> None:
        manifest.outputs.update(self._unsaved)
        manifest.runs[self._run] = {**manifest.runs.get(self._run, {}), **self._facts}
        manifest.drop_idle_runs(self._run)

    def _take_back(self, manifest: Manifest) -> None:
        mine = {name for name, output in manifest.outputs.items() if output.run == self._run}
        for name in mine:
            del manifest.outputs[name]
        manifest.outputs |= {name: self.before.outputs[name] for name in mine & self.before.outputs.keys()}
        manifest.runs = self.before.runs | manifest.runs
        manifest.drop_idle_runs()

    def _known(self) -> Manifest:
        """The manifest; a damaged one is renamed."""
        try:
            return load_manifest(self._folder)
        except ManifestError as error:
            path = self._folder / NAME
            with FolderLock(self._work / "lock"):
                despite_readers(lambda: os.replace(path, path.with_name(f"{NAME}.damaged")))
            fault = str(error).rpartition(': delete')[0]
            self.warnings.append(f"{fault}: renamed to {NAME}.damaged, a new one is started")
            return Manifest()

    def _abouts(self) -> list[tuple[Path, About]]:
        found = []
        for path in sorted(self._work.glob(f"*{SUFFIX}")):
            with suppress(CheckpointError):
                found.append((path, read_about(path)))
        return found

    def _remove_leftovers(self, names: Collection[str]) -> None:
        """Remove partial files that killed runs left: no other run may write these files now."""
        remove_leftovers(self._folder, names, any_host=True)
        for path in self._work.glob(f".*{SUFFIX}.*"):
            if not is_alive(self._work, path.name[1:].partition(SUFFIX)[0]):
                remove(path)
