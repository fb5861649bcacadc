"""What this project's Python and Blender's share: how a clip is seeded, how its files are named and
read.

Imported by both, so it needs NumPy and OpenImageIO only.
"""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio


def clip_generator(seed: int, clip: int) -> np.random.Generator:
    """Draws what does not depend on the kind of scene, such as the kind itself."""
    return np.random.default_rng([seed, clip])


def scene_generator(seed: int, clip: int, kind: str, attempt: int = 0) -> np.random.Generator:
    """Draws a scene of a kind. Kinds that build on the same setting get other bodies, and so does a
    new attempt."""
    return np.random.default_rng([seed, clip, zlib.crc32(kind.encode()), attempt])


def noisy_file(folder: Path, variant: int, frame: int) -> Path:
    """A noisy render, with all passes."""
    return folder / f"noisy.{variant}.{frame:02d}.exr"


def half_file(folder: Path, half: int, frame: int) -> Path:
    """Half of a reference, at output size; both halves have all passes."""
    return folder / f"half.{half}.{frame:02d}.exr"


def vectors_file(folder: Path, frame: int) -> Path:
    """The frame without motion blur, for its motion vectors."""
    return folder / f"vectors.{frame:02d}.exr"


def read_pass(path: Path, name: str, channels: int | None = None) -> np.ndarray:
    """A pass (h, w, C) by Blender's name, which has a part of its own; its first ``channels``, by
    default all.

    Raises KeyError where the file has no such pass.
    """
    file, part = oiio.ImageInput.open(str(path)), 0
    if file is None:
        raise OSError(f"{path}: {oiio.geterror()}")
    while file.seek_subimage(part, 0):
        spec = file.spec()
        if f".{name}." in spec.channelnames[0]:
            pixels = file.read_image(part, 0, 0, channels or spec.nchannels, "float")
            return np.asarray(pixels).reshape(spec.height, spec.width, -1)
        part += 1
    raise KeyError(f"{path}: no pass {name}")
