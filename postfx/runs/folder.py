"""A run's part of an output folder: its claim, its entries in the manifest, its checkpoint.

A checkpoint is the history of all passes after a frame, so that a run can resume with the same
pixels. Its file holds a line of text with the format, a line of JSON that describes the arrays, the
raw arrays, and the SHA-256 of everything before it.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from postfx.errors import CheckpointError, ManifestError, RunError, WriteError
from postfx.files import (
    FILE_PIECE_BYTES,
    despite_readers,
    hash_file,
    parse_json,
    remove,
    remove_leftovers,
    write_atomically,
)
from postfx.runs.locks import Claim, FolderLock, is_alive
from postfx.runs.manifest import (
    MANIFEST_NAME,
    WORK_FOLDER,
    Manifest,
    Output,
    load_manifest,
    update_manifest,
)

# Least seconds between two writes of the manifest, and the largest share of the run's time that
# they take.
LEAST_SECONDS = 1.0
MOST_SHARE = 0.05

CHECKPOINT_SUFFIX = ".checkpoint"
CHECKPOINT_MAGIC = b"postfx checkpoint 1\n"
_MOST_HEADER = 1 << 20
_ARRAY_TYPES = ("float32", "float64", "int64")
_DIGEST = 32  # bytes


class RunFolder:
    """Reserves the files of one run in an output folder, and records them there.

    names: of the files that the run may write. Raises RunError if another run is writing one of
    them, or something else has the name of its own folder, OSError if the folder cannot be written,
    ManifestReadError if its manifest cannot be read.

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
        try:
            self._work.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise RunError(f"{self._work}: is no folder, and runs need one of that name: delete "
                           "it") from None
        with FolderLock(self._work / "lock"):
            # who writes the manifest holds the lock: these are of killed runs
            for path in folder.glob(f".{MANIFEST_NAME}.*"):
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
            raise WriteError(f"{self._folder / MANIFEST_NAME}: cannot be written: "
                             f"{error.strerror}; check free space") from error
        self._unsaved.clear()
        self._flushed = time.monotonic()
        self._cost = self._flushed - begin

    def checkpoints(self, pattern: str, fingerprint: str) -> dict[int, Path]:
        """Intact checkpoints that a run with this pattern and fingerprint can use, by frame
        number."""
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
             relax: Callable[[], None] | None) -> int:
        """Replace the run's last checkpoint; returns the new one's size in bytes."""
        about = About(self._run, pattern, frame, fingerprint)
        return save_checkpoint(self._work / f"{self._run}{CHECKPOINT_SUFFIX}", about, history,
                               relax)

    def close(self, facts: Mapping[str, Any], finished: Collection[int], pattern: str) -> None:
        """End the run. Removes checkpoints after frames in `finished`, which are no longer needed,
        and the manifest's entries of a run that wrote nothing."""
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
        manifest.outputs |= {name: self.before.outputs[name]
                             for name in mine & self.before.outputs.keys()}
        manifest.runs = self.before.runs | manifest.runs
        manifest.drop_idle_runs()

    def _known(self) -> Manifest:
        """The manifest; a damaged one is renamed."""
        try:
            return load_manifest(self._folder)
        except ManifestError as error:
            path = self._folder / MANIFEST_NAME
            with FolderLock(self._work / "lock"):
                despite_readers(lambda: os.replace(path,
                                                   path.with_name(f"{MANIFEST_NAME}.damaged")))
            fault = str(error).rpartition(': delete')[0]
            self.warnings.append(f"{fault}: renamed to {MANIFEST_NAME}.damaged, a new one is "
                                 "started")
            return Manifest()

    def _abouts(self) -> list[tuple[Path, About]]:
        found = []
        for path in sorted(self._work.glob(f"*{CHECKPOINT_SUFFIX}")):
            with suppress(CheckpointError):
                found.append((path, read_about(path)))
        return found

    def _remove_leftovers(self, names: Collection[str]) -> None:
        """Remove partial files that killed runs left: no other run may write these files now."""
        remove_leftovers(self._folder, names, any_host=True)
        remove_leftovers(self._work, ["lock", "lock.breaking"])
        for path in self._work.glob(f".*{CHECKPOINT_SUFFIX}.*"):
            if not is_alive(self._work, path.name[1:].partition(CHECKPOINT_SUFFIX)[0]):
                remove(path)


@dataclass(frozen=True)
class About:
    """Describes a checkpoint.

    Attributes:
        run: id of the run.
        pattern: of the output files.
        frame: number of the frame after which it was made.
        fingerprint: of everything that affects pixels; a run with another fingerprint cannot use
            the checkpoint.
    """

    run: str
    pattern: str
    frame: int
    fingerprint: str


def save_checkpoint(
    path: Path, about: About, history: Mapping[str, np.ndarray],
    relax: Callable[[], None] | None = None
) -> int:
    """Write a checkpoint; returns its size in bytes. `relax` is called between pieces."""
    arrays = {name: np.ascontiguousarray(array).reshape(np.shape(array))
              for name, array in history.items()}
    shapes = [[name, array.dtype.name, array.shape] for name, array in arrays.items()]
    header = CHECKPOINT_MAGIC + json.dumps({**asdict(about), "arrays": shapes}).encode() + b"\n"

    def write(file: BinaryIO) -> None:
        digest = hashlib.sha256()
        contents: list[bytes | memoryview] = [header]
        contents += [array.reshape(-1).data.cast("B") for array in arrays.values()]
        for content in contents:
            for first in range(0, len(content), FILE_PIECE_BYTES):
                piece = content[first : first + FILE_PIECE_BYTES]
                digest.update(piece)
                file.write(piece)
                if relax:
                    relax()
        file.write(digest.digest())

    write_atomically(path, write)
    return path.stat().st_size


def read_about(path: Path) -> About:
    """Description of a checkpoint, without reading its arrays; CheckpointError if it cannot be
    read."""
    with _open(path) as file:
        header = _header(path, file)
    try:
        return About(str(header.get("run")), str(header.get("pattern")),
                     int(header.get("frame", 0)), str(header.get("fingerprint")))
    except (ValueError, TypeError, OverflowError) as error:
        raise CheckpointError(f"{path}: is damaged") from error


def load_checkpoint(path: Path) -> dict[str, np.ndarray]:
    """The history that a checkpoint holds, as read-only arrays; CheckpointError if it is
    damaged."""
    if _is_altered(path):
        raise CheckpointError(f"{path}: is damaged")
    with _open(path) as file:
        shapes = _header(path, file).get("arrays", [])
        at = file.tell()
    arrays: dict[str, np.ndarray] = {}
    try:
        for name, kind, shape in shapes:
            if kind not in _ARRAY_TYPES:
                raise ValueError(f"an array of {kind}")
            arrays[name] = _array(path, kind, at, tuple(shape))
            at += arrays[name].nbytes
    except (OSError, ValueError, TypeError, OverflowError) as error:
        raise CheckpointError(f"{path}: cannot be read: {error}") from error
    return arrays


def _array(path: Path, kind: str, at: int, shape: tuple[int, ...]) -> np.ndarray:
    """An array of a file: mapped, so that memory holds it only while it is used; read on Windows,
    where the next checkpoint could not replace a mapped file."""
    if os.name != "nt":
        return np.memmap(path, kind, "r", at, shape or (1,)).reshape(shape)
    found = np.fromfile(path, kind, math.prod(shape), offset=at).reshape(shape)
    found.flags.writeable = False
    return found


def _open(path: Path) -> BinaryIO:
    if path.exists() and not path.is_file():  # reading a pipe would never end
        raise CheckpointError(f"{path}: is not a file")
    try:
        return path.open("rb")
    except OSError as error:
        raise CheckpointError(f"{path}: {error.strerror}") from error


def _header(path: Path, file: BinaryIO) -> dict[str, Any]:
    try:
        if file.readline(len(CHECKPOINT_MAGIC)) != CHECKPOINT_MAGIC:
            raise ValueError("not a checkpoint")
        return dict(parse_json(file.readline(_MOST_HEADER)))
    except (OSError, ValueError, TypeError) as error:
        raise CheckpointError(f"{path}: is damaged") from error


def _is_altered(path: Path) -> bool:
    digest, left = hashlib.sha256(), path.stat().st_size - _DIGEST
    with _open(path) as file:
        while left > 0:
            piece = file.read(min(left, FILE_PIECE_BYTES))
            if not piece:
                return True
            digest.update(piece)
            left -= len(piece)
        return file.read() != digest.digest()
