"""Clips of the validation set: planned scenes and renders, and their compact files."""

from __future__ import annotations

import json
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from postfx.colour.displays import srgb_encode
from training.datagen.clip_file import DEPTH_RANGE, HALF_MAX

# The plan -----------------------------------------------------------------------------------------

SCENES = (
    ("interior", "moving"), ("product", "metal"), ("outdoor", "bending"), ("interior", "cut"),
    ("product", "glass"), ("room", "flicker"), ("outdoor", "moving"), ("interior", None),
)
"""Family and trait (see held_out) of the clips, in turn; 'cut' changes to another view halfway."""
STYLES = ("realtime", "box")
"""In turn: all samples of a frame at one jittered position, or spread over the pixel."""
GUIDE_SPP = 4
"""Samples a pixel of guides if samples are spread; otherwise the guides are the planes of the
full-size frame."""


@dataclass(frozen=True)
class Render:
    """A noisy render of all frames, `scale` times smaller than the output, with `spp` samples a
    pixel."""

    name: str
    scale: float
    spp: int

    def size(self, output: tuple[int, int]) -> tuple[int, int]:
        """Width and height for an output's."""
        return round(output[0] / self.scale), round(output[1] / self.scale)


FULL, HALF = Render("x1", 1.0, 1), Render("x2", 2.0, 4)
"""Two ways to spend the same number of light paths."""


def renders(index: int) -> tuple[Render, ...]:
    """Renders of a clip. Sample counts at 1.5x and 3x change every other clip, so that both styles
    have all counts."""
    turn = index // len(STYLES) % 4
    return FULL, Render("x1.5", 1.5, (2, 4, 1, 8)[turn]), HALF, Render("x3", 3.0,
                                                                       (4, 2, 8, 1)[turn])


# Compact files ------------------------------------------------------------------------------------
# Planes as small whole numbers, packed by LZMA in an .npz that `numpy.load` reads.
#
# PACKING says how many bits of a half float's fraction colours keep (5: error at most 1.6 %, 7: 0.4
# %), and the step size of all other planes. Keys are RENDER/PLANE, 'reference/colour', and, as
# JSON, 'facts' and 'packing', so that files stay readable.

HALF_BITS = 10
PACKING = {"reference": 7, "colour": 5, "diffuse_albedo": 1 / 255, "specular_albedo": 1 / 255,
           "roughness": 1 / 255, "normal": 1 / 256, "depth": 1 / 512, "motion": 1 / 64}
"""Bits of colours; steps of albedos, roughness, normals, of depth's base-2 logarithm, and of motion
in pixels."""
REFERENCE = "reference"

Planes = dict[str, np.ndarray]


def pack_colour(light: np.ndarray, bits: int) -> np.ndarray:
    """Light (T, H, W, 3), 0..65504 -> bytes (2, 3, T, H, W): rounded half floats, red and blue
    minus green."""
    half = np.clip(light, 0, HALF_MAX).astype(np.float16).view(np.uint16).astype(np.uint32)
    drop = HALF_BITS - bits
    top = int(np.float16(HALF_MAX).view(np.uint16)) >> drop
    kept = np.minimum((half + (1 << drop >> 1)) >> drop, top).astype(np.uint16)
    return _bytes(np.stack([kept[..., 0] - kept[..., 1], kept[..., 1],
                            kept[..., 2] - kept[..., 1]]))


def unpack_colour(packed: np.ndarray, bits: int) -> np.ndarray:
    """Light (T, H, W, 3) float32, the inverse of `pack_colour`."""
    red, green, blue = _words(packed)
    kept = np.stack([red + green, green, blue + green], -1)
    return (kept << (HALF_BITS - bits)).astype(np.uint16).view(np.float16).astype(np.float32)


def pack_plane(name: str, values: np.ndarray, step: float) -> np.ndarray:
    """A plane (T, H, W) or (T, H, W, C) -> bytes (2, C, T, H, W): steps, as differences along the
    rows."""
    values = values.reshape(*values.shape[:3], -1)
    values = np.log2(np.clip(values, *DEPTH_RANGE)) if name == "depth" else values
    steps = np.clip(np.round(values / step), -(2**15), 2**15 - 1).astype(np.int16).view(np.uint16)
    return _bytes(np.moveaxis(np.diff(steps, axis=2, prepend=np.uint16(0)), -1, 0))


def unpack_plane(name: str, packed: np.ndarray, step: float) -> np.ndarray:
    """A plane (T, H, W, C) float32, the inverse of `pack_plane`; misses have a depth of exactly
    1e10."""
    steps = np.cumsum(_words(packed), axis=-1, dtype=np.uint16).view(np.int16)
    values = np.moveaxis(steps.astype(np.float32) * np.float32(step), 0, -1)
    if name == "depth":
        far = values >= np.log2(DEPTH_RANGE[1]) - step
        values = np.where(far, np.float32(DEPTH_RANGE[1]), np.exp2(values))
    return np.ascontiguousarray(values)


def save(path: Path, reference: np.ndarray, renders: dict[str, Planes],
         facts: dict[str, Any]) -> None:
    """Write a clip atomically: references (T, H, W, 3), planes (T, h, w, C) of each render, and
    facts."""
    arrays: dict[str, np.ndarray | np.str_] = {
        name: np.str_(json.dumps(value))
        for name, value in (("facts", facts), ("packing", PACKING))}
    for name, planes in ({REFERENCE: {"colour": reference}} | renders).items():
        for plane, values in planes.items():
            arrays[f"{name}/{plane}"] = (pack_colour(values, _bits(name, PACKING)) if plane
                                         == "colour" else pack_plane(plane, values, PACKING[plane]))
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial.npz")
    with zipfile.ZipFile(partial, "w", zipfile.ZIP_LZMA) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, np.asanyarray(array), allow_pickle=False)
    partial.replace(path)


def load(path: Path) -> tuple[np.ndarray, dict[str, Planes], dict[str, Any]]:
    """The arguments of `save`, float32, apart from rounding."""
    renders: dict[str, Planes] = {}
    with np.load(path) as file:
        facts, packing = (json.loads(str(file[name])) for name in ("facts", "packing"))
        for key in (key for key in file.files if "/" in key):
            name, plane = key.split("/")
            values = (unpack_colour(file[key], _bits(name, packing)) if plane == "colour"
                      else unpack_plane(plane, file[key], packing[plane]))
            renders.setdefault(name, {})[plane] = values
    return renders.pop(REFERENCE)["colour"], renders, facts


def _bits(render: str, packing: dict[str, Any]) -> int:
    return packing[REFERENCE if render == REFERENCE else "colour"]


def _bytes(words: np.ndarray) -> np.ndarray:
    """uint16 (C, ...) -> uint8 (2, C, ...), the low bytes first: separated, they pack better."""
    return np.stack([words & 255, words >> 8]).astype(np.uint8)


def _words(packed: np.ndarray) -> np.ndarray:
    return packed[0].astype(np.uint16) | packed[1].astype(np.uint16) << 8


# A picture of clips -------------------------------------------------------------------------------
# A row each: first, middle and last reference, noisy 1x, albedos, normal, motion.

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
    return [*made, full["normal"][middle] / 2 + 0.5,
            np.dstack([motion, np.full_like(motion[..., :1], 0.5)])]


def draw(clips: list[Path], path: Path) -> None:
    """Write the picture."""
    rows = []
    for clip in clips:
        pictures = [Image.fromarray((255 * np.clip(panel, 0, 1)).astype(np.uint8))
                    for panel in panels(clip)]
        sizes = [(WIDTH, round(WIDTH * picture.height / picture.width)) for picture in pictures]
        resized = [picture.resize(size) for picture, size in zip(pictures, sizes, strict=True)]
        rows.append(np.concatenate([np.asarray(picture) for picture in resized], 1))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(rows)).save(path)
