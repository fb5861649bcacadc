"""Measurements: figures from files, and small copies of pictures."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import Any

from PIL import Image

from training.measure.quality_report.document import Missing, ReportError

# Figures --------------------------------------------------------------------------------------------------------------

Facts = dict[str, Any]


class Results:
    """A folder of results and one of models; every method raises Missing if its file is not there."""

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


# Pictures -------------------------------------------------------------------------------------------------------------

WIDTH, LIMIT = 1100, 2_500_000
"""Greatest width in pixels, and bytes of all pictures together."""
PHOTOGRAPHS = "crops"
"""Part of the names of pictures that are kept as JPEG; others are drawings: PNG of 256 colours."""


class Album:
    """Pictures of a document, collected before they are written."""

    def __init__(self, folder: Path, beside: Path) -> None:
        self._folder, self._beside = folder, beside
        self._made: dict[str, bytes] = {}

    def add(self, results: Results, file: str, *words: str) -> str:
        """Take RESULTS/file; returns the line that shows it. Raises Missing."""
        source = results.picture(file)
        kind = "jpg" if PHOTOGRAPHS in source.stem else "png"
        target = f"{'.'.join(Path(file).with_suffix('').parts)}.{kind}"
        self._made[target] = shrunk(source, kind)
        address = Path(os.path.relpath(self._folder / target, self._beside)).as_posix()
        return f"![{' '.join(words)}]({address})\n"

    def check_size(self) -> None:
        """Raises ReportError when all pictures together are too large."""
        total = sum(map(len, self._made.values()))
        if total > LIMIT:
            raise ReportError(f"pictures take {total / 1e6:.1f} MB, more than {LIMIT / 1e6:g}: show fewer of them")

    def stale(self) -> list[str]:
        """Pictures whose file differs or is not there."""
        paths = {self._folder / name: made for name, made in self._made.items()}
        return [str(path) for path, made in paths.items() if not path.is_file() or path.read_bytes() != made]

    def write(self) -> None:
        """Write all pictures; others in the folder stay."""
        if self._made:
            self._folder.mkdir(parents=True, exist_ok=True)
        for name, made in self._made.items():
            (self._folder / name).write_bytes(made)


def shrunk(path: Path, kind: str) -> bytes:
    """A picture at most WIDTH wide, as the bytes of a JPEG ('jpg') or of a PNG with a palette."""
    with Image.open(path) as opened:
        picture = opened.convert("RGB")
    if picture.width > WIDTH:
        picture = picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    if kind == "jpg":
        picture.save(buffer, "JPEG", quality=84, optimize=True)
    else:
        few = picture.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
        few.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
