"""EXR files with everything that a pipeline may put into them, and the hashes of what is in a
file."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio

from postfx.io.exr import Header
from postfx.io.exr.container import ExrContainer, NewPart, can_compress, write_container

WIDTH, HEIGHT = 37, 41
DATE = "2024:05:06 07:08:09"  # else that of now: the same file comes out each time
COMPRESSIONS = {name: getattr(OpenEXR, f"{name}_COMPRESSION") for name in
                      ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB",
                       "HTJ2K256", "HTJ2K32", "LJ2K", "ZSTD")
                if hasattr(OpenEXR, f"{name}_COMPRESSION")
                and can_compress({"NO": "none"}.get(name, name.lower()))}
"""Those that both libraries know."""


def noise_bits(seed: int, kind: str, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """Samples of a stored type whose bits are random, so that NaN with payloads and denormals are
    among them."""
    random = np.random.default_rng(seed)
    if kind == "half":
        return random.integers(0, 1 << 16, (height, width)).astype(np.uint16).view(np.float16)
    bits = random.integers(0, 1 << 32, (height, width), np.uint64).astype(np.uint32)
    return bits if kind == "uint" else bits.view(np.float32)


def picture(width: int = WIDTH, height: int = HEIGHT, seed: int = 0) -> dict[str, np.ndarray]:
    """Channels R, G, B and A of light."""
    random = np.random.default_rng(seed)
    return {name: random.random((height, width)).astype(np.float16) for name in "RGBA"}


def write_mixed(path: Path, compression: str = "ZIP", tiled: bool = False,
                size: tuple[int, int] = (WIDTH, HEIGHT), **header: Any) -> Path:
    """One part: a picture, and beside it halves, floats and whole numbers of any bits, with a
    Cryptomatte's header."""
    lossy = compression in ("PXR24", "B44", "B44A", "DWAA", "DWAB")
    channels = picture(*size) | {"depth.Z": noise_bits(1, "float", *size),
                                 "objectId": noise_bits(2, "uint", *size)}
    channels |= {f"CryptoObject00.{letter}": noise_bits(3 + i, "float", *size)
                 for i, letter in enumerate("RGBA")}
    channels["mask.half"] = picture(*size, seed=4)["R"] if lossy else noise_bits(8, "half", *size)
    kind = {"tiles": OpenEXR.TileDescription()} if tiled else {}
    kind["type"] = OpenEXR.tiledimage if tiled else OpenEXR.scanlineimage
    crypto = {"cryptomatte/abc/name": "CryptoObject",
              "cryptomatte/abc/manifest": '{"logo":"0000abcd"}'}
    about = {**kind, **crypto, "compression": COMPRESSIONS[compression], "owner": "studio",
             **header}
    OpenEXR.File(about, channels).write(str(path))
    return path


def write_deep(path: Path) -> Path:
    """One deep part of two channels, with as many samples as the place of the pixel."""
    spec = oiio.ImageSpec(8, 6, 2, "float")
    spec.channelnames, spec.deep = ("A", "Z"), True
    spec.attribute("DateTime", DATE)
    deep = oiio.DeepData()
    deep.init(spec)
    for pixel in range(48):
        deep.set_samples(pixel, pixel % 4)
        for sample in range(pixel % 4):
            deep.set_deep_value(pixel, 1, sample, pixel + sample / 8)
    output = oiio.ImageOutput.create(str(path))
    assert output is not None, oiio.geterror()
    assert output.open(str(path), spec) and output.write_deep_image(deep) and output.close()
    return path


def write_mipmapped(path: Path) -> Path:
    """One tiled part with all its levels."""
    levels = [oiio.ImageBuf(np.full((64 >> level, 64 >> level, 1), level, np.float32))
              for level in range(7)]
    output, spec = oiio.ImageOutput.create(str(path)), oiio.ImageSpec(64, 64, 1, "half")
    assert output is not None, oiio.geterror()
    spec.tile_width = spec.tile_height = 16
    spec.channelnames = ("mip.Y",)
    spec.attribute("DateTime", DATE)
    spec.attribute("openexr:roundingmode", 0)
    spec.attribute("textureformat", "Plain Texture")
    assert output.open(str(path), spec) and output.write_image(levels[0].get_pixels())
    for level in range(1, 7):
        spec.width = spec.height = spec.full_width = spec.full_height = 64 >> level
        assert (output.open(str(path), spec, "AppendMIPLevel")
                and output.write_image(levels[level].get_pixels()))
    output.close()
    return path


def write_studio(folder: Path, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Path:
    """Parts of all kinds: picture with ids, a deep one, a mip-mapped one, and a header with types
    that nobody knows."""
    files = [write_mixed(folder / "mixed.exr", size=size), write_deep(folder / "deep.exr"),
             write_mipmapped(folder / "mip.exr")]
    containers = [ExrContainer(file) for file in files]
    parts = []
    for name, container in zip(("beauty", "deep", "mip"), containers, strict=True):
        header = Header(dict(container.headers[0].attributes))
        header.set_text("name", name)
        header.set("studioBlob", "studioType", bytes(range(256)))
        header.set("aVeryLongNameOfAnAttributeThatNeedsTheFlag", "float", struct.pack("<f", 0.1))
        header.attributes["displayWindow"] = containers[0].headers[0].attributes["displayWindow"]
        parts.append(NewPart(header, container.counts[0], container.copy_chunks(0)))
    write_container(folder / "studio.exr", parts)
    for container in containers:
        container.close()
    return folder / "studio.exr"


def channel_hashes(path: Path) -> dict[tuple[str, str], str]:
    """(part, channel) -> hash of its decoded bits, type and size, by OpenEXR; of files without deep
    parts."""
    found = {}
    for part in OpenEXR.File(str(path), separate_channels=True).parts:
        for name, channel in part.channels.items():
            bits = np.ascontiguousarray(channel.pixels)
            found[part.name(), name] = hashlib.sha256(f"{bits.dtype}{bits.shape}".encode()
                                                      + bits.tobytes()).hexdigest()
    return found


def chunk_hashes(path: Path) -> dict[str, str]:
    """Part -> hash of its chunks as they are stored, in the order of their places."""
    with ExrContainer(path) as file:
        chunks = {header.name: sorted(file.copy_chunks(part))
                  for part, header in enumerate(file.headers)}
    return {name: hashlib.sha256(b"".join(stored for _, stored in found)).hexdigest()
            for name, found in chunks.items()}


def headers_of(path: Path) -> dict[str, dict[str, tuple[str, bytes]]]:
    """Part -> attribute -> its type and bytes."""
    with ExrContainer(path) as file:
        return {header.name: {name: (kind, value)
                              for name, (kind, value) in header.attributes.items()}
                for header in file.headers}
