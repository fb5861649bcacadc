"""A picture of validation clips, one row each: first, middle and last reference, noisy 1x, albedos, normal, motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from postfx.colour.curves import srgb_encode
from training.measure.validation.clips import FULL, load

WIDTH = 240  # of a panel, pixels
FASTEST = 20  # motion, pixels a frame, that is drawn in full colour


def panels(clip: Path) -> list[np.ndarray]:
    """Pictures (H, W, 3), 0..1, of a clip."""
    reference, renders, facts = load(clip)
    full, middle = renders[FULL.name], len(reference) // 2
    lights = [reference[0], reference[middle], reference[-1], full["colour"][middle]]
    exposed = [facts["exposure"] * light for light in lights]
    made = [srgb_encode(light / (1 + light)) for light in exposed]
    made += [srgb_encode(full[name][middle]) for name in ("diffuse_albedo", "specular_albedo")]
    motion = full["motion"][middle] / (2 * FASTEST) + 0.5
    return [*made, full["normal"][middle] / 2 + 0.5, np.dstack([motion, np.full_like(motion[..., :1], 0.5)])]


def draw(clips: list[Path], path: Path) -> None:
    """Write the picture."""
    rows = []
    for clip in clips:
        pictures = [Image.fromarray((255 * np.clip(panel, 0, 1)).astype(np.uint8)) for panel in panels(clip)]
        sizes = [(WIDTH, round(WIDTH * picture.height / picture.width)) for picture in pictures]
        resized = [picture.resize(size) for picture, size in zip(pictures, sizes, strict=True)]
        rows.append(np.concatenate([np.asarray(picture) for picture in resized], 1))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(rows)).save(path)
