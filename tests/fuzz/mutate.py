"""Damage to files, by chance: `python -m tests.fuzz.mutate KIND COUNT [FIRST]`, in a process of its
own.

Every input depends on its number alone. Before each, the number is written to the file `at`, so
that whoever started this knows which one ended it. Prints how many were read and how many were
refused in a line; ends with an error at the first that raised anything but PostfxError, or took
long. The kind `bomb` is no damage but files that claim much.
"""

from __future__ import annotations

import os
import random
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from postfx.cli.config import DEFAULTS_VARIABLE, read_defaults
from postfx.cli.run_options import RUN
from postfx.colour.ocio import file_transform
from postfx.errors import PostfxError
from postfx.io.exr.container import ExrContainer, NewPart, write_container
from postfx.io.sequence import read_sequence
from tests.files.exr_files import COMPRESSIONS, write_mixed, write_studio
from tests.fuzz import bombs, targets

MOST_SECONDS, MEMORY = 20.0, 4 << 30
"""Of computing, for one input; of the process, in bytes of address space."""
EXTREME = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
CUBE = b'TITLE "look"\nLUT_3D_SIZE 2\nDOMAIN_MIN 0 0 0\nDOMAIN_MAX 1 1 1\n' + b"".join(
    b"%d %d %d\n" % (i & 1, i >> 1 & 1, i >> 2) for i in range(8))
SPI3D = b"SPILUT 1.0\n3 3\n2 2 2\n" + b"".join(
    b"%d %d %d %d %d %d\n" % (i & 1, i >> 1 & 1, i >> 2, i & 1, i >> 1 & 1, i >> 2)
    for i in range(8))
CSP = b"CSPLUTV100\n3D\n\n2\n0 1\n0 1\n2\n0 1\n0 1\n2\n0 1\n0 1\n\n2 2 2\n" + b"0 0 0\n1 1 1\n" * 4
MANIFEST = b'{"logo":"1480c843","hero/left hand":"fedcba98","sky":"7f000001"}'
SETTINGS = (
    b'[run]\nmodel = "s"\nscale = 2\nexposure = "auto"\nclamp-fireflies = 5.0\nverbose = true\n'
)


def damaged(content: bytes, dice: random.Random) -> bytes:
    """Content with a few of: bytes changed, numbers made extreme, stretches cut, doubled, swapped
    or moved."""
    found = bytearray(content)
    for _ in range(dice.choice((1, 1, 2, 4, 8))):
        at, length = dice.randrange(len(found) + 1), dice.choice((1, 2, 4, 8, 16, 64))
        match dice.randrange(6):
            case 0:
                found[at:at + 1] = bytes([dice.randrange(256)])
            case 1:
                found[at:at + 4] = struct.pack("<I", dice.choice(EXTREME))
            case 2:
                del found[at:at + length]
            case 3:
                found[at:at] = found[at:at + length]
            case 4:
                found[at:] = b"" if dice.random() < 0.3 else found[at:]
            case 5:
                other = dice.randrange(len(found) + 1)
                found[at:at + length], found[other:other + length] = (found[other:other + length],
                                                                      found[at:at + length])
    return bytes(found)


def exr_seeds() -> list[bytes]:
    path = targets.FOLDER / "seed.exr"
    kinds = [write_mixed(path, name, size=targets.SIZE).read_bytes()
             for name in sorted(COMPRESSIONS)]
    return [*kinds, write_mixed(path, tiled=True, size=targets.SIZE).read_bytes(),
            write_studio(targets.FOLDER, targets.SIZE).read_bytes()]


def cryptomatte(content: bytes) -> None:
    """The manifest in a header, then in a file beside the frame, and a name looked up in it."""
    path = targets.FOLDER / "ids.exr"
    beside = targets.FOLDER / "ids.json"
    beside.write_bytes(content)
    for name, text in (("manifest", content), ("manif_file", beside.name.encode())):
        write_mixed(path, size=targets.SIZE)
        with ExrContainer(path) as file:
            header, chunks = file.headers[0], list(file.copy_chunks(0))
        del header.attributes["cryptomatte/abc/manifest"]
        header.set(f"cryptomatte/abc/{name}", "string", text)
        write_container(path, [NewPart(header, len(chunks), chunks)])
        next(iter(read_sequence(path, leave="logo")))


def seeds_of(name: str) -> Callable[[], list[bytes]]:
    """Inputs that are all right, of a target of coverage-guided fuzzing."""
    def make() -> list[bytes]:
        folder = targets.FOLDER / f"seeds of {name}"
        folder.mkdir()
        targets.seeds(name, folder)
        return [path.read_bytes() for path in sorted(folder.iterdir())]
    return make


def settings(content: bytes) -> None:
    """A studio's defaults."""
    path = targets.FOLDER / "postfx.toml"
    path.write_bytes(content)
    os.environ[DEFAULTS_VARIABLE] = str(path)
    read_defaults(RUN)


def table(ending: str) -> Callable[[bytes], None]:
    def read(content: bytes) -> None:
        import numpy as np

        # OpenColorIO keeps what it has read by name
        path = targets.FOLDER / f"{time.monotonic_ns()}{ending}"
        path.write_bytes(content)
        try:
            file_transform(f"{path},input=ACEScct").apply(np.full((1, 1, 3), 0.18, np.float32))
        finally:
            path.unlink()
    return read


KINDS: dict[str, tuple[Callable[[bytes], None], Callable[[], list[bytes]]]] = {
    "exr": (targets.exr, exr_seeds),
    "settings": (settings, lambda: [SETTINGS]),
    "cube": (table(".cube"), lambda: [CUBE]),
    "spi3d": (table(".spi3d"), lambda: [SPI3D]),
    "csp": (table(".csp"), lambda: [CSP]),
    "cryptomatte": (cryptomatte, lambda: [MANIFEST]),
    **{name: (targets.TARGETS[name], seeds_of(name))
       for name in ("hdr", "profile", "records", "model")},
    "bomb": (bombs.read, bombs.names),
}


def main(kind: str, count: int, first: int = 0) -> None:
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    except ImportError:
        pass  # Windows
    at = Path("at").resolve()
    with tempfile.TemporaryDirectory() as folder:
        targets.FOLDER = Path(folder)
        attempt, make = KINDS[kind]
        seeds, outcomes = make(), {"read": 0, "refused": 0}
        for number in range(first, first + count):
            dice, begin = random.Random(f"{kind} {number}"), time.process_time()
            content = (seeds[number % len(seeds)] if kind == "bomb"
                       else damaged(dice.choice(seeds), dice))
            at.write_text(str(number))
            try:
                attempt(content)
                outcomes["read"] += 1
            except PostfxError as error:
                assert str(error).strip(), number
                outcomes["refused"] += 1
            assert (took := time.process_time()
                    - begin) < MOST_SECONDS, f"{kind} {number} took {took:.0f} s"
    print(outcomes)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
