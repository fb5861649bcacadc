"""How frames came about: versions, settings, device and models, for manifests, headers and checkpoints."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numba
import numpy
import OpenImageIO

from postfx.plan import Plan
from postfx.runtime import Device, Library
from postfx.version import __version__


@dataclass(frozen=True)
class Provenance:
    """How the frames of a run come about.

    Attributes:
        settings: argument -> value, of those given and those that have a default.
        passes: name -> options, of the passes that run.
        versions: of postfx and what it is built on.
        device: where it runs.
        fingerprint: of all of these, of the models that are installed, and of what else decides about pixels.
        files: names of settings that are files; headers hold their names without the folder.
    """

    settings: Mapping[str, Any]
    passes: Mapping[str, Mapping[str, Any]]
    versions: Mapping[str, str]
    device: Mapping[str, Any]
    fingerprint: str
    files: Collection[str] = ()

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        return {"settings": dict(self.settings), "passes": dict(self.passes), "versions": dict(self.versions),
                "device": dict(self.device), "fingerprint": self.fingerprint}

    def header(self, models: Mapping[str, str]) -> dict[str, str]:
        """Attributes for an image's header. models: name -> SHA-256 of the networks that ran."""
        settings = {name: Path(str(value)).name if name in self.files and value else value
                    for name, value in self.settings.items()}
        return {
            "postfx:version": self.versions["postfx"],
            "postfx:models": ", ".join(f"{name} sha256:{digest}" for name, digest in sorted(models.items())),
            "postfx:settings": json.dumps({"settings": settings, "passes": dict(self.passes)}, default=str),
        }


def provenance_of(settings: Mapping[str, Any], plan: Plan, device: Device, also: Sequence[Any] = (),
                  files: Collection[str] = ()) -> Provenance:
    """Provenance of a run.

    settings: name -> value, of the options that change pixels; `files`: those of them that name files. also: what else
    decides about pixels, and is not recorded.
    """
    settings = {name: _plain(settings[name]) for name in sorted(settings)}
    passes = {step.name: {key: _plain(value) for key, value in step.instance.options.items()} for step in plan.steps}
    place = {"name": device.name, "provider": device.placement.provider, "threads": device.threads}
    library = Library()
    models = {name: library.sha256(name) for name in library.names()}
    decisive = [settings, passes, versions(), place, plan.as_dict(), models, *also]
    text = json.dumps(decisive, sort_keys=True, default=str)
    return Provenance(settings, passes, versions(), place, hashlib.sha256(text.encode()).hexdigest(), files)


def versions() -> dict[str, str]:
    """Versions of postfx and of what its pixels depend on."""
    runtimes = {name: _installed(name) for name in ("onnxruntime", "onnxruntime-gpu")}
    return {"postfx": __version__, "python": platform.python_version(), "numpy": numpy.__version__,
            "numba": numba.__version__, "OpenImageIO": OpenImageIO.VERSION_STRING,
            **{name: version for name, version in runtimes.items() if version}}


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool | None) else str(value)
