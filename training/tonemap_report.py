"""What was measured of looks, as tables and pictures of docs/tonemap.md."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from training.quality_report.document import Block, compose, parse
from training.quality_report.markdown import number, table
from training.tonemap_set import shrink

TILE, GAP, LOUD = 200, 4, 8.0  # height of a tile and the gap, in pixels; factor of the errors shown
MOST = 5  # pictures in a strip
Found = dict[str, dict[str, Any]]


def pictures_table(found: Found, look: str) -> str:
    """Figures of each picture."""
    heads = ["picture", "PSNR (dB)", "SSIM", "FLIP", "Delta E ITP"]
    rows = found[look]["pictures"].items()
    return table(heads, ([named(name, row), number(row["psnr"], ".1f"), number(row["ssim"], ".3f"),
                          number(row["flip"], ".3f"), number(row["delta_e_itp"], ".2f")] for name, row in rows))


def looks_table(found: Found) -> str:
    """Means over the pictures that a look was not trained on, and its worst."""
    heads = ["look", "PSNR (dB)", "lowest", "SSIM", "FLIP", "Delta E ITP"]
    return table(heads, ([f"`{look}`", *_means(one["pictures"])] for look, one in found.items()))


def _means(pictures: dict[str, dict[str, Any]]) -> list[str]:
    held = [row for row in pictures.values() if row["held_out"]]
    mean = {key: float(np.mean([row[key] for row in held])) for key in ("psnr", "ssim", "flip", "delta_e_itp")}
    lowest = min(row["psnr"] for row in held)
    return [number(mean["psnr"], ".1f"), number(lowest, ".1f"), number(mean["ssim"], ".3f"),
            number(mean["flip"], ".3f"), number(mean["delta_e_itp"], ".2f")]


def checks_table(found: Found) -> str:
    """What charts show."""
    heads = ["look", "grey chroma", "fall", "rough", "halo", "hue flips", "in range"]
    keys = ("chroma", "fall", "rough", "halo")
    return table(heads, ([f"`{look}`", *(number(one["checks"][key], ".2f") for key in keys),
                          number(100 * one["checks"]["hue_flips"], ".2f", " %"),
                          "yes" if one["checks"]["in_range"] else "no"] for look, one in found.items()))


def flicker_table(found: Found) -> str:
    """How steady sequences are: flicker of a look and of what it is measured by, and contrast of the first two."""
    heads = ["look", "sequence", "look", "nearest static curve", "its mean held still", "its view alone",
             "pipeline, frame by frame", "nearest cube", "contrast", "of the static curve"]
    keys = ("look", "static", "still", "view", "pipeline", "cube")
    return table(heads, ([f"`{look}`", name.replace("_", " "), *(_figure(row.get(key), "flicker") for key in keys),
                          *(_figure(row[key], "contrast") for key in ("look", "static"))]
                         for look, one in found.items() for name, row in one["flicker"].items()))


def _figure(figures: dict[str, float] | None, key: str) -> str:
    return number(figures[key], ".2f") if figures else "-"


def named(name: str, row: dict[str, Any]) -> str:
    return name.replace("_", " ") + ("" if row["held_out"] else " (trained on)")


MAKERS: dict[str, Callable[..., str]] = {
    "looks": looks_table, "pictures": pictures_table, "checks": checks_table, "flicker": flicker_table,
}


def write_report(doc: Path, found: Found) -> None:
    """Replace the tables of a document; those of looks that were not measured stay."""
    parts, made = parse(doc.read_text(encoding="utf-8"), doc, MAKERS), {}
    for block in (part for part in parts if isinstance(part, Block)):
        if all(look in found for look in block.arguments):
            made[block.line] = MAKERS[block.name](found, *block.arguments)
    doc.write_text(compose(parts, made), encoding="utf-8")


def strip(pairs: list[tuple[np.ndarray, np.ndarray]], path: Path) -> None:
    """A picture of looks (H,W,3) over what was wanted over the difference, made louder; one column a pair."""
    columns = [_column(*(shrink(x, round(TILE * max(x.shape) / len(x))) for x in pair)) for pair in pairs[:MOST]]
    height = min(len(column) for column in columns)
    padded = [np.pad(column[:height], ((0, 0), (0, GAP), (0, 0)), constant_values=1.0) for column in columns]
    path.parent.mkdir(parents=True, exist_ok=True)
    image = oiio.ImageBuf(np.ascontiguousarray(np.round(np.concatenate(padded, 1) * 255).astype(np.uint8)))
    image.specmod()["CompressionQuality"] = 90
    image.write(str(path))


def _column(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    error = np.minimum(np.abs(found - wanted) * LOUD, 1.0)
    gap = np.ones((GAP, found.shape[1], 3), found.dtype)
    return np.concatenate([found, gap, wanted, gap, error])
