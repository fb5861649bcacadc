"""How frames came about: versions, settings, device and models, for manifests, headers and checkpoints."""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numba
import numpy
import OpenImageIO

from postfx import __version__
from postfx.plan import Plan
from postfx.runtime import Device, Library

NOT_PIXELS = frozenset({
    "execute", "output", "overwrite", "skip_existing", "explain", "json", "capture", "capture_frame", "capture_tensors",
    "capture_network", "log", "checkpoint", "resume", "frames", "preroll", "memory", "report", "reference", "on_error",
})
"""Arguments of `postfx run` that do not decide how a frame looks that a run writes."""
FILES = ("input", "guides", "profile")
"""Arguments that name files, of which headers hold the name without the folder."""


@dataclass(frozen=True)
class Provenance:
    """How the frames of a run come about.

    Attributes:
        settings: argument -> value, of those given and those that have a default.
        passes: name -> options, of the passes that run.
        versions: of postfx and what it is built on.
        device: where it runs.
        fingerprint: of all of these, of the models that are installed, and of what else decides about pixels.
    """

    settings: Mapping[str, Any]
    passes: Mapping[str, Mapping[str, Any]]
    versions: Mapping[str, str]
    device: Mapping[str, Any]
    fingerprint: str

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        return {"settings": dict(self.settings), "passes": dict(self.passes), "versions": dict(self.versions),
                "device": dict(self.device), "fingerprint": self.fingerprint}

    def header(self, models: Mapping[str, str]) -> dict[str, str]:
        """Attributes for an image's header. models: name -> SHA-256 of the networks that ran."""
        settings = {name: Path(str(value)).name if name in FILES and value else value
                    for name, value in self.settings.items()}
        return {
            "postfx:version": self.versions["postfx"],
            "postfx:models": ", ".join(f"{name} sha256:{digest}" for name, digest in sorted(models.items())),
            "postfx:settings": json.dumps({"settings": settings, "passes": dict(self.passes)}, default=str),
        }


def provenance_of(arguments: argparse.Namespace, plan: Plan, device: Device, frames: tuple[int, ...]) -> Provenance:
    """Provenance of a run. Its frames count where the exposure looks ahead."""
    given = vars(arguments)
    settings = {name: _plain(given[name]) for name in sorted(given) if name not in NOT_PIXELS}
    passes = {step.name: {key: _plain(value) for key, value in step.instance.options.items()} for step in plan.steps}
    place = {"name": device.name, "provider": device.placement.provider, "threads": device.threads}
    library = Library()
    decisive = [settings, passes, versions(), place, plan.as_dict(), {name: library.sha256(name) for name in
                library.names()}, sorted(frames) if arguments.exposure == "smooth" else None, arguments.memory]
    text = json.dumps(decisive, sort_keys=True, default=str)
    return Provenance(settings, passes, versions(), place, hashlib.sha256(text.encode()).hexdigest())


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
