"""Finds what was measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from training.measure.quality_report.errors import Missing, ReportError

Facts = dict[str, Any]


class Results:
    """A folder of results and one of models; every method raises Missing where there is no such file."""

    def __init__(self, folder: Path, models: Path) -> None:
        self._folder, self._models = folder, models

    def bench(self, sequence: str) -> Facts:
        """What `postfx bench` wrote of a sequence."""
        return self._load(f"{sequence}/bench.json")

    def ablations(self, sequence: str) -> list[Facts]:
        """Comparisons of networks that lack planes, of the sequence's folder or else of the one beside it."""
        try:
            found = self.bench(sequence)["ablations"]
        except Missing:
            found = []
        return found or self.bench(f"{sequence}-ablations")["ablations"]

    def validation(self) -> Facts:
        """What `training.measure.validation compare` wrote."""
        return self._load("validation/comparison.json")

    def equivalent(self, name: str) -> Facts:
        """What `training.measure.equivalent_samples` wrote."""
        return self._load(f"{name}/equivalent_samples.json")

    def convergence(self, name: str) -> Facts:
        """What `training.measure.convergence` wrote."""
        return self._load(f"{name}/convergence.json")

    def cards(self) -> list[Facts]:
        """Of the denoisers in full precision, by parameters."""
        cards = [_read(path) for path in sorted(self._models.glob("denoise_upscale.*.json"))]
        found = [card for card in cards if "precision" not in card]
        if not found:
            raise Missing(f"{self._models} holds no denoise_upscale.*.json")
        return sorted(found, key=lambda card: (card["parameters"], card["name"]))

    def picture(self, name: str) -> Path:
        """A picture's file."""
        path = self._folder / name
        if not path.is_file():
            raise Missing(f"there is no {path}")
        return path

    def _load(self, name: str) -> Facts:
        path = self._folder / name
        if not path.is_file():
            raise Missing(f"there is no {path}")
        return _read(path)


def _read(path: Path) -> Facts:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ReportError(f"{path}: is not JSON: {error}") from error
