"""ICC profiles of displays (ICC.1:2022)."""

from __future__ import annotations

import struct
from functools import cache

import numpy as np

from postfx.colour import D50_XYZ, adapt, to_xyz
from postfx.colour.displays import SRGB, Display

ICC_VERSION = 0x04400000
"""Of the format, 4.4."""
PROFILE_DATE = (2025, 1, 1, 0, 0, 0)
"""Year, month, day, hours, minutes and seconds of every profile, so that equal ones have the same
bytes."""
CURVE_SAMPLES = 1024
"""Of a curve that no formula of the format describes."""
HEADER_BYTES = 128
ENTRY_BYTES = 12
"""Of an entry of the table of tags."""
FIXED_UNIT = 65536
"""Of s15Fixed16Number: what 1 is stored as."""


@cache
def make_profile(display: Display) -> bytes:
    """Profile of a display's code values.

    A curve cannot describe PQ and HLG up to their peak. It ends at diffuse white, so software
    without HDR clips brighter lights there; the tag `cicp` tells other software the true encoding.
    """
    primaries = display.kind.primaries
    colorants = adapt(primaries, D50_XYZ)
    curve = _curve(display)
    tags = {
        b"desc": _text(f"{display.kind.title} (postfx)"),
        b"cprt": _text("No copyright: CC0 1.0"),
        b"wtpt": _numbers(b"XYZ ", D50_XYZ),
        b"chad": _numbers(b"sf32", (colorants @ np.linalg.inv(to_xyz(primaries))).ravel()),
        b"rXYZ": _numbers(b"XYZ ", colorants[:, 0]),
        b"gXYZ": _numbers(b"XYZ ", colorants[:, 1]),
        b"bXYZ": _numbers(b"XYZ ", colorants[:, 2]),
        b"rTRC": curve,
        b"gTRC": curve,
        b"bTRC": curve,
    }
    if display.kind.cicp:
        tags[b"cicp"] = b"cicp" + bytes(4) + bytes(display.kind.cicp)
    return _assemble(tags)


def _assemble(tags: dict[bytes, bytes]) -> bytes:
    start = HEADER_BYTES + 4 + ENTRY_BYTES * len(tags)
    table, data, places = struct.pack(">I", len(tags)), b"", {}
    for name, content in tags.items():
        if content not in places:  # the three curves are one
            places[content] = start + len(data)
            data += content + bytes(-len(content) % 4)
        table += struct.pack(">4sII", name, places[content], len(content))
    return _header(start + len(data)) + table + data


def _header(size: int) -> bytes:
    kinds = struct.pack(">4s4s4s6H4s", b"mntr", b"RGB ", b"XYZ ", *PROFILE_DATE, b"acsp")
    white = b"".join(map(_encode_fixed, D50_XYZ))
    return (struct.pack(">I4sI", size, b"", ICC_VERSION) + kinds + bytes(28) + white).ljust(
        HEADER_BYTES, b"\0"
    )


def _curve(display: Display) -> bytes:
    if display.kind.curve is SRGB:
        numbers = 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045
        return b"para" + struct.pack(">IHH", 0, 3, 0) + b"".join(map(_encode_fixed, numbers))
    if not display.hdr:
        return b"para" + struct.pack(">IHH", 0, 0, 0) + _encode_fixed(2.4)
    codes = np.linspace(0, 1, CURVE_SAMPLES)
    light = np.minimum(display.decode(np.repeat(codes[:, None], 3, 1))[:, 0], 1)
    samples: bytes = np.rint(light * 65535).astype(">u2").tobytes()
    return b"curv" + struct.pack(">II", 0, CURVE_SAMPLES) + samples


def _text(text: str) -> bytes:
    """multiLocalizedUnicodeType with one language."""
    encoded = text.encode("utf-16-be")
    return b"mluc" + struct.pack(">III4sII", 0, 1, 12, b"enUS", len(encoded), 28) + encoded


def _numbers(kind: bytes, values: np.ndarray | tuple[float, ...]) -> bytes:
    return kind + bytes(4) + b"".join(map(_encode_fixed, values))


def _encode_fixed(value: float) -> bytes:
    """s15Fixed16Number."""
    return struct.pack(">i", round(float(value) * FIXED_UNIT))
