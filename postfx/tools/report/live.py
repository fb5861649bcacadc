"""Pictures sent to a viewer while frames are made: tev, and others that speak its protocol over
TCP.

The protocol is described by https://github.com/Tom94/tev (src/Ipc.cpp). A packet begins with its
length, itself included, and its type; numbers are little-endian, names end with a zero.
"""

from __future__ import annotations

import queue
import re
import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from postfx.colour.displays import srgb_decode
from postfx.errors import OptionError
from postfx.frame import LINEAR, Frame, Role

VIEWER_HOST = "localhost"
PORT = 14158
"""Where tev listens unless it is told otherwise."""
CREATE = 4
"""Type of a packet that makes an image without pixels."""
UPDATE = 6
"""Type of a packet with pixels of a part of an image (its third version)."""
PACKET_CHANNELS = ("R", "G", "B")
PACKET_ROWS = 256
"""Rows of a picture that one packet holds."""
VIEWER_TIMEOUT_SECONDS = 2.0
"""Seconds that a viewer may take to answer, or to take a packet."""
LAST_SECONDS = 5.0
"""Seconds that the end of a run waits for the last picture."""
MOST_QUEUED_PICTURES = 2
"""Pictures that wait for a slow viewer; of more, the oldest are left out."""


class Address(NamedTuple):
    """Where a viewer listens."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"tev at {self.host}:{self.port}"


def parse_address(text: str) -> Address:
    """The address in 'tev', 'tev:HOST' or 'tev:HOST:PORT'; OptionError for anything else."""
    found = re.fullmatch(r"tev(?::([^:]+|\[[0-9a-fA-F:]+\]))?(?::([0-9]{1,5}))?", text)
    port = int(found[2] or PORT) if found else 0
    if found is None or not 0 < port < 65536:
        raise OptionError(f"--live '{text}': give tev, tev:HOST or tev:HOST:PORT")
    return Address((found[1] or VIEWER_HOST).strip("[]"), port)


class LiveViewer:
    """Sends pictures to a viewer from a thread of its own. A viewer that is missing, closed or slow
    never holds or stops the frames: what it does not take is left out, and `notice` tells of it
    once.

    Raises OptionError for an address that is none.
    """

    def __init__(self, address: str) -> None:
        self._address = parse_address(address)
        self._waiting: queue.Queue[tuple[str, Frame] | None] = queue.Queue()
        self._has_failed = False
        self._notice: str | None = None
        self._deadline = float("inf")
        self._thread = threading.Thread(target=self._work, name="live viewer", daemon=True)
        self._thread.start()

    def show(self, name: str, frame: Frame) -> None:
        """Send a frame's picture, by this name; returns at once."""
        if Role.COLOUR in frame:
            while self._waiting.qsize() >= MOST_QUEUED_PICTURES:
                try:
                    self._waiting.get_nowait()
                except queue.Empty:
                    break
            self._waiting.put((name, frame))

    def notice(self) -> str | None:
        """What went wrong, a line that is told once."""
        told, self._notice = self._notice, None
        return told

    def close(self) -> None:
        """Wait for what is being sent, for some seconds at most."""
        self._deadline = time.monotonic() + LAST_SECONDS
        self._waiting.put(None)
        self._thread.join(LAST_SECONDS)

    def _work(self) -> None:
        """Send queued pictures to the viewer, until None comes."""
        connection: socket.socket | None = None
        while (item := self._waiting.get()) is not None:
            if time.monotonic() > self._deadline:
                continue
            try:
                connection = (connection
                              or socket.create_connection(self._address, VIEWER_TIMEOUT_SECONDS))
                for packet in packets(*item):
                    connection.sendall(packet)
            except OSError as error:
                self._tell(error)
                if connection:
                    connection.close()
                connection = None
        if connection:
            connection.close()

    def _tell(self, error: OSError) -> None:
        if not self._has_failed:
            self._notice = (f"{self._address} takes no pictures ({error.strerror or error}): the "
                            "run goes on without; open the viewer, and the next ones are sent to "
                            "it")
        self._has_failed = True


def packets(name: str, frame: Frame) -> Iterator[bytes]:
    """Messages that give a viewer a picture: light, or what a display shows as linear light."""
    colour = frame[Role.COLOUR]
    light = colour if frame.encoding in LINEAR else srgb_decode(colour)
    height, width, count = light.shape
    named = name.encode() + b"\0"
    names = [channel.encode() + b"\0" for channel in PACKET_CHANNELS[:count]]
    channels = struct.pack("<i", count) + b"".join(names)
    yield _packet(CREATE, named + struct.pack("<ii", width, height) + channels)
    places = np.arange(count, dtype="<i8").tobytes() + np.full(count, count, "<i8").tobytes()
    for top in range(0, height, PACKET_ROWS):
        band = np.ascontiguousarray(light[top : top + PACKET_ROWS], "<f4")
        area = struct.pack("<iiii", 0, top, width, len(band))
        yield _packet(UPDATE, named + channels + area + places + band.tobytes())


def _packet(kind: int, content: bytes) -> bytes:
    """A packet that leaves the viewer's window where it is."""
    grabs_focus = False
    return struct.pack("<Ibb", 6 + len(content), kind, grabs_focus) + content
