"""The manifest of an output folder: its runs, their settings, the hash of every file, and
verification."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from postfx.errors import ManifestError, ManifestReadError
from postfx.files import hash_file, parse_json, read_text, remove, write_atomically
from postfx.io.pattern import parse_pattern
from postfx.runs.locks import FolderLock, is_alive
from postfx.streams import make_printable
from postfx.system import is_plain_name

MANIFEST_NAME = "postfx.manifest.json"
WORK_FOLDER = ".postfx"
"""Folder beside the frames for locks, claims and checkpoints; removed after the last run."""
MANIFEST_FORMAT = "postfx manifest"
MANIFEST_VERSION = 1
"""Version of the format: another one is not read."""


@dataclass(frozen=True)
class Output:
    """One file that a run has written or will write.

    Attributes:
        run: id of the run.
        frame: frame number.
        sha256: of the file; None until it is written.
        bytes, width, height: of the file, once it is written.
        inputs: path -> size in bytes and modification time in nanoseconds, of the frame's input
            files.
        starts: whether the frame begins a shot, so that earlier frames do not affect it.
    """

    run: str
    frame: int
    sha256: str | None = None
    bytes: int = 0
    width: int = 0
    height: int = 0
    inputs: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    starts: bool = False


@dataclass
class Manifest:
    """Records of a folder: run id -> facts about the run, file name -> Output."""

    runs: dict[str, dict[str, Any]] = field(default_factory=dict)
    outputs: dict[str, Output] = field(default_factory=dict)

    def drop_idle_runs(self, now: str = "") -> None:
        """Drop runs that own no file, except the run `now`."""
        used = {now, *(output.run for output in self.outputs.values())}
        self.runs = {run: facts for run, facts in self.runs.items() if run in used}

    def to_json(self) -> str:
        """The manifest as text."""
        head = json.dumps({"format": MANIFEST_FORMAT, "version": MANIFEST_VERSION,
                           "runs": self.runs}, indent=1)
        lines = [f"  {json.dumps(name)}: {json.dumps(vars(self.outputs[name]))}"
                 for name in sorted(self.outputs)]
        return f'{head[:-2]},\n "outputs": {{\n' + ",\n".join(lines) + "\n }\n}\n"

    @classmethod
    def from_json(cls, text: str) -> Manifest:
        """Parse a manifest; ManifestError if the text is not one. Output names must be plain file
        names."""
        try:
            facts = parse_json(text)
            if facts["format"] != MANIFEST_FORMAT or facts["version"] != MANIFEST_VERSION:
                raise ManifestError(f"it is of format {facts['format']!r} {facts['version']!r}")
            outputs = {str(name): _output(entry) for name, entry in facts["outputs"].items()}
            runs = {str(run): dict(entry) for run, entry in facts["runs"].items()}
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
            raise ManifestError(f"it is damaged ({type(error).__name__}: "
                                f"{make_printable(str(error))})") from error
        strange = [name for name in (*outputs, *runs) if not is_plain_name(name)]
        if strange:
            raise ManifestError("it names a file outside of its folder: "
                                f"{make_printable(strange[0])}")
        return cls(runs, outputs)


def load_manifest(folder: Path) -> Manifest:
    """A folder's manifest, empty if there is none; ManifestError if it is damaged,
    ManifestReadError if it cannot be read."""
    path = folder / MANIFEST_NAME
    try:
        return Manifest.from_json(read_text(path))
    except FileNotFoundError:
        return Manifest()
    except OSError as error:
        raise ManifestReadError(f"{path}: cannot be read: {error.strerror}; check its "
                                "rights") from error
    except (ValueError, ManifestError) as error:
        raise ManifestError(f"{path}: {error}: delete it; --skip-existing then decodes every "
                            "frame") from error


def update_manifest(folder: Path, change: Callable[[Manifest], None]) -> None:
    """Change a folder's manifest under its lock; an empty manifest is removed."""
    with FolderLock(folder / WORK_FOLDER / "lock"):
        manifest = load_manifest(folder)
        change(manifest)
        if not (manifest.runs or manifest.outputs):
            remove(folder / MANIFEST_NAME)
            return
        text = manifest.to_json().encode()
        write_atomically(folder / MANIFEST_NAME, lambda file: file.write(text), durable=True)


def _output(entry: Mapping[str, Any]) -> Output:
    output = Output(**entry)
    kinds = {"run": str, "frame": int, "bytes": int, "width": int, "height": int, "starts": bool}
    wrong = [name for name, kind in kinds.items() if type(getattr(output, name)) is not kind]
    if wrong or not isinstance(output.sha256, str | None):
        raise TypeError(f"'{wrong[0] if wrong else 'sha256'}' of a file")
    inputs = {path: (int(size), int(changed)) for path, (size, changed) in output.inputs.items()}
    return replace(output, inputs=inputs)


RUNNING = "running"


@dataclass
class Verification:
    """The result of a check, by file name.

    Attributes:
        whole: files that are unchanged.
        altered: files that have changed since.
        missing: files that were written and no longer exist.
        unfinished: files that a run should have written but did not.
        unknown: files that match a run's pattern but that no run wrote.
        differing: where frames must be those of one sequence, runs with other settings or versions
            than the first one.
        runs: run id -> 'finished', 'stopped', 'failed', 'running', or 'killed' for a run that ended
            without saying so.
    """

    whole: list[str] = field(default_factory=list)
    altered: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    unfinished: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    differing: list[str] = field(default_factory=list)
    runs: dict[str, str] = field(default_factory=dict)

    @property
    def is_well(self) -> bool:
        """Whether every file is whole, none is missing or unknown, and all were made alike."""
        return not (self.altered or self.missing or self.unfinished or self.unknown
                    or self.differing)

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        return {"well": self.is_well, **vars(self)}


def verify(folder: Path) -> Verification:
    """Check a folder; ManifestError if it has no manifest."""
    if not os.path.isdir(folder):
        raise ManifestError(f"{folder}: no such folder: give the one that 'postfx run' wrote to")
    if not os.path.isfile(folder / MANIFEST_NAME):
        raise ManifestError(f"{folder}: has no {MANIFEST_NAME}: give the folder that 'postfx run' "
                            "wrote to")
    manifest = load_manifest(folder)
    found = Verification(runs=_states(folder, manifest))
    for name, output in manifest.outputs.items():
        path = folder / name
        if output.sha256 is None:
            found.unfinished.append(name)
        elif not os.path.isfile(path):
            found.missing.append(name)
        else:
            try:
                whole = path.stat().st_size == output.bytes and hash_file(path) == output.sha256
            except OSError as error:
                raise ManifestError(f"{path}: cannot be read: {error.strerror}; check its "
                                    "rights") from error
            (found.whole if whole else found.altered).append(name)
    found.unknown = _unknown(folder, manifest)
    return found


def verify_together(folders: Iterable[Path], frames: Collection[int]) -> Verification:
    """Check folders that hold the chunks of one sequence, such as those of several machines.

    Every frame of the range must have been written by some run, and all runs must have had the same
    settings, passes, models and versions. Names of files have their folder where there is more than
    one. Raises ManifestError.
    """
    folders, found, made, written = list(folders), Verification(), [], set()
    for folder in folders:
        part, manifest = verify(folder), load_manifest(folder)
        prefix = f"{folder}/" if len(folders) > 1 else ""
        for kind in ("whole", "altered", "missing", "unfinished", "unknown"):
            getattr(found, kind).extend(f"{prefix}{name}" for name in getattr(part, kind))
        found.runs |= {f"{prefix}{run}": state for run, state in part.runs.items()}
        made += [(f"{prefix}{run}", facts) for run, facts in manifest.runs.items()]
        written |= {output.frame for output in manifest.outputs.values()}
    patterns = sorted({str(facts.get("output", "")) for _, facts in made})
    for number in sorted(set(frames) - written):
        found.unfinished.append(str(parse_pattern(patterns[0]).path(number)) if patterns
                                else f"frame {number}")
    found.differing = [name for name, facts in made if not _are_alike(facts, made[0][1])]
    return found


def _are_alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two runs were made with the same settings, passes, versions, and files of the models
    that both used."""
    models, others = dict(one.get("models", {})), dict(other.get("models", {}))
    same = all(one.get(key) == other.get(key) for key in ("settings", "passes", "versions"))
    return same and all(models[name] == others[name] for name in models.keys() & others.keys())


def _states(folder: Path, manifest: Manifest) -> dict[str, str]:
    states = {}
    for run, facts in manifest.runs.items():
        state = str(facts.get("status", "unknown"))
        gone = state == RUNNING and not is_alive(folder / WORK_FOLDER, run)
        states[run] = "killed" if gone else state
    return states


def _unknown(folder: Path, manifest: Manifest) -> list[str]:
    patterns = {str(facts.get("output", "")) for facts in manifest.runs.values()}
    names = set()
    for pattern in filter(is_plain_name, patterns):
        for own in parse_pattern(str(folder / pattern)).by_view().values():
            names |= {path.name for words in own.find_frames().values() for path in words.values()}
    return sorted(names - set(manifest.outputs))
