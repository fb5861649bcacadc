"""Begin with published weights: those of Open Image Denoise, as a checkpoint for --start.

    python -m training.denoise.open_weights -o start.pt
    python -m training.denoise.open_weights --large -o start.pt

The package pyoidn (pip install 'pyoidn==2.5.1.0') holds Open Image Denoise 2.5.1 and its weights,
both under the Apache License 2.0. The library stores each network as a TZA archive: a table of
tensors in half precision. This program finds the archive by its symbol in the library (an ELF
file, so it runs on Linux) and renames nothing: `picture.PictureNetwork` has the same layers.
"""

from __future__ import annotations

import argparse
import math
import struct
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from training.denoise.checkpoint import PREFIX, save
from training.denoise.picture import LARGE, PictureConfig

NETWORK = "rt_hdr_alb_nrm"
LARGE_NETWORK = "rt_hdr_calb_cnrm_large"  # for albedo and normal without noise
ALBEDO_NETWORK = "rt_alb"  # for an albedo alone
SOURCE = "Open Image Denoise 2.5.1, Apache License 2.0, network {network}"
MAGIC = 0x41D7  # of a TZA archive
TYPES = {"f": "<f4", "h": "<f2"}
SYMBOLS = 11  # type of an ELF section: the dynamic symbol table
SECTION = struct.Struct("<IIQQQQIIQQ")  # name, type, flags, address, offset, size, link, ...
SYMBOL = struct.Struct("<IBBHQQ")  # name, info, other, section, value, size


def library() -> Path:
    """The library that holds the weights. Raises ValueError where the package is not installed."""
    spec = find_spec("pyoidn")
    if spec is None or spec.origin is None:
        raise ValueError("the package pyoidn is not installed: pip install 'pyoidn==2.5.1.0'")
    found = sorted(Path(spec.origin).parent.glob("**/libOpenImageDenoise_core.so.*"))
    if not found:
        raise ValueError(f"{Path(spec.origin).parent}: no libOpenImageDenoise_core.so (Linux only)")
    return found[0]


def sections(data: bytes) -> list[tuple[int, ...]]:
    """The section headers of an ELF file of 64 bits."""
    offset, = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    return [SECTION.unpack_from(data, offset + i * size) for i in range(count)]


def archive(data: bytes, name: str) -> bytes:
    """The bytes that the library's symbol of a network points to. Raises ValueError if there is
    none."""
    table = sections(data)
    for section in table:
        if section[1] != SYMBOLS:
            continue
        names = table[section[6]][4]
        for at in range(section[4], section[4] + section[5], SYMBOL.size):
            word, _, _, _, address, size = SYMBOL.unpack_from(data, at)
            end = data.index(b"\0", names + word)
            if data[names + word:end].endswith(f"{len(name)}{name}E".encode()):
                return _bytes_at(data, table, address, size)
    raise ValueError(f"no network {name} in this library")


def _bytes_at(data: bytes, table: list[tuple[int, ...]], address: int, size: int) -> bytes:
    for _, _, _, begin, offset, length, *_ in table:
        if begin and begin <= address < begin + length:
            return data[offset + address - begin:offset + address - begin + size]
    raise ValueError(f"no section holds address {address:x}")


def tensors(packed: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Names and values of a TZA archive. Raises ValueError for anything else."""
    magic, = struct.unpack_from("<H", packed, 0)
    if magic != MAGIC:
        raise ValueError(f"not a TZA archive: it begins with {magic:04x}")
    at, = struct.unpack_from("<Q", packed, 4)
    count, = struct.unpack_from("<I", packed, at)
    at += 4
    for _ in range(count):
        length, = struct.unpack_from("<H", packed, at)
        name = packed[at + 2:at + 2 + length].decode()
        at += 2 + length
        dims = packed[at]
        shape = struct.unpack_from(f"<{dims}I", packed, at + 1)
        at += 1 + 4 * dims + dims  # the layout has a letter for each dimension
        kind = chr(packed[at])
        offset, = struct.unpack_from("<Q", packed, at + 1)
        at += 9
        yield name, np.frombuffer(packed, TYPES[kind], math.prod(shape), offset).reshape(shape)


def published(name: str = NETWORK) -> dict[str, Tensor]:
    """The weights of one of Open Image Denoise's networks, in float32, by their names there."""
    found = tensors(archive(library().read_bytes(), name))
    return {key: torch.from_numpy(values.astype(np.float32)) for key, values in found}


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--large", action="store_true",
                        help="the large network, for albedo and normal without noise")
    parser.add_argument("-o", "--output", type=Path, required=True, help="checkpoint to write")
    return parser


def main(argv: list[str] | None = None) -> None:
    parser = options()
    args = parser.parse_args(argv)
    try:
        network, config = (LARGE_NETWORK, LARGE) if args.large else (NETWORK, PictureConfig())
        weights = {PREFIX + name: values.half() for name, values in published(network).items()}
        if config.filtered:
            weights |= {f"{PREFIX}alone.{name}": values.half()
                        for name, values in published(ALBEDO_NETWORK).items()}
            network = f"{network} and {ALBEDO_NETWORK}"
        notes = {"start": SOURCE.format(network=network)}
        save({"config": config.as_dict(), "weights": weights, "notes": notes}, args.output)
    except (OSError, ValueError) as fault:
        parser.error(str(fault))


if __name__ == "__main__":
    main()
