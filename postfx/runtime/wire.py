"""Reads protobuf's wire format: the fields of one message, without copying and without knowing what they mean."""

from __future__ import annotations

from collections.abc import Iterator

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
_WIDTHS = {FIXED64: 8, FIXED32: 4}
_MOST_VARINT = 10  # bytes that 64 bits take


class WireError(ValueError):
    """The bytes are no message: they end early, or hold a wire type that there is not."""


class Wire:
    """Reads messages of one file, whose fields and members of integer fields are at most `most`: a file of many empty
    ones would take far more memory than it has bytes."""

    def __init__(self, most: int) -> None:
        self._left = most

    def fields(self, message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
        """Number and value of each field: an integer for varints, the bytes as they lie there for anything else.

        The format is the one of https://protobuf.dev/programming-guides/encoding. Groups are not read.
        """
        for field in _fields(message):
            self._count()
            yield field

    def integers(self, value: int | memoryview) -> Iterator[int]:
        """Members of a repeated integer field, one of them or many packed, as signed 64 bits."""
        at = 0
        while not isinstance(value, int) and at < len(value):
            item, at = _varint(value, at)
            self._count()
            yield _signed(item)
        if isinstance(value, int):
            yield _signed(value)

    def _count(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise WireError("it has too many parts")


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, at = _varint(message, at)
            yield number, value
            continue
        if kind == BYTES:
            length, at = _varint(message, at)
        elif kind in _WIDTHS:
            length = _WIDTHS[kind]
        else:
            raise WireError(f"wire type {kind}")
        if length > len(message) - at:
            raise WireError("it ends early")
        yield number, message[at : at + length]
        at += length


def text(value: int | memoryview) -> str:
    """A string field; WireError when it is none."""
    if isinstance(value, int):
        raise WireError("a number where a name should be")
    try:
        return str(value, "utf-8")
    except UnicodeDecodeError as error:
        raise WireError("a name that is not UTF-8") from error


def _signed(value: int) -> int:
    return value - (1 << 64) if value >> 63 else value


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for index, byte in enumerate(message[at : at + _MOST_VARINT]):
        value |= (byte & 0x7F) << (7 * index)
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, at + index + 1
    raise WireError("it ends early" if len(message) - at < _MOST_VARINT else "a number of more than 64 bits")
