"""Checks the files of a folder against its manifest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from postfx.errors import ManifestError
from postfx.files import hash_file
from postfx.io.pattern import parse_pattern
from postfx.runs.claim import is_alive
from postfx.runs.manifest import NAME, WORK_FOLDER, Manifest, load_manifest
from postfx.system import is_plain_name

RUNNING = "running"


@dataclass
class Verification:
    """What was found, by file name.

    Attributes:
        whole: files that are as they were written.
        altered: files that are not.
        missing: files that were written and are gone.
        unfinished: files that a run was to write and did not.
        unknown: files named like those of a run that no run wrote.
        runs: run id -> 'finished', 'stopped', 'failed', 'running', or 'killed' for one that ended without a word.
    """

    whole: list[str] = field(default_factory=list)
    altered: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    unfinished: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    runs: dict[str, str] = field(default_factory=dict)

    @property
    def is_well(self) -> bool:
        """Whether every file is whole, and there is none too few or too many."""
        return not (self.altered or self.missing or self.unfinished or self.unknown)

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        return {"well": self.is_well, **vars(self)}


def verify(folder: Path, told: Callable[[str], None] = lambda _: None) -> Verification:
    """Check a folder; ManifestError when it has no manifest. `told` gets the name of each file that is read."""
    if not (folder / NAME).is_file():
        raise ManifestError(f"{folder}: has no {NAME}: give the folder that 'postfx run' wrote to")
    manifest = load_manifest(folder)
    found = Verification(runs=_states(folder, manifest))
    for name, output in manifest.outputs.items():
        path = folder / name
        if output.sha256 is None:
            found.unfinished.append(name)
        elif not path.is_file():
            found.missing.append(name)
        else:
            told(name)
            whole = path.stat().st_size == output.bytes and hash_file(path) == output.sha256
            (found.whole if whole else found.altered).append(name)
    found.unknown = _unknown(folder, manifest)
    return found


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
        files = parse_pattern(str(folder / pattern)).found().values()
        names |= {path.name for words in files for path in words.values()}
    return sorted(names - set(manifest.outputs))
