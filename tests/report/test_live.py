"""Pictures for a viewer: a server that speaks tev's protocol gets them, and a missing or hanging
one stops nothing."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from postfx.cli.main import main
from postfx.colour.displays import srgb_decode
from postfx.errors import OptionError
from postfx.frame import Frame, Role
from postfx.io.sequence import Sequence
from postfx.io.writer import write_frame
from postfx.tools.report import live
from postfx.tools.report.live import LiveViewer, packets, parse_address


class Tev:
    """As much of the viewer as these tests need: images by name, made of the packets that come."""

    def __init__(self, listener: socket.socket) -> None:
        self.images: dict[str, np.ndarray] = {}
        self._listener = listener
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def wait(self) -> dict[str, np.ndarray]:
        self._thread.join(20)
        assert not self._thread.is_alive()
        return self.images

    def _listen(self) -> None:
        with self._listener.accept()[0] as connection, connection.makefile("rb") as stream:
            while length := stream.read(4):
                self.take(stream.read(struct.unpack("<I", length)[0] - 4))

    def take(self, packet: bytes) -> None:
        kind, rest = packet[0], packet[2:]
        name, rest = text(rest)
        if kind == live.CREATE:
            width, height, count = struct.unpack("<iii", rest[:12])
            assert (b"".join(part + b"\0" for part in rest[12:].split(b"\0")[:-1]) == b"R\0G\0B\0"
                    and count == 3)
            self.images[name] = np.full((height, width, count), np.nan, np.float32)
            return
        assert kind == live.UPDATE
        (count,), rest = struct.unpack("<i", rest[:4]), rest[4:]
        for _ in range(count):
            _, rest = text(rest)
        x, y, width, height = struct.unpack("<iiii", rest[:16])
        places = np.frombuffer(rest[16 : 16 + 16 * count], "<i8")
        data = np.frombuffer(rest[16 + 16 * count :], "<f4")
        assert len(data) == width * height * count
        for channel, (offset, stride) in enumerate(zip(places[:count], places[count:],
                                                       strict=True)):
            plane = data[offset::stride][: width * height].reshape(height, width)
            self.images[name][y : y + height, x : x + width, channel] = plane


def text(content: bytes) -> tuple[str, bytes]:
    name, _, rest = content.partition(b"\0")
    return name.decode(), rest


@contextmanager
def listening() -> Iterator[tuple[socket.socket, str]]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener, f"tev:127.0.0.1:{listener.getsockname()[1]}"


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shot")
    for number in (1, 2):
        colour = np.random.default_rng(number).random((40, 32, 3), np.float32)
        write_frame(folder / f"in.{number:04d}.exr", Frame({Role.COLOUR: colour}, number))
    return folder / "in.####.exr"


def run(shot, out, address: str) -> int:
    return main(["run", str(shot), "-o", str(out / "####.exr"), "--model", "classic", "--live",
                 address])


def test_a_viewer_gets_the_frames_that_are_written(shot, tmp_path, monkeypatch):
    monkeypatch.setattr(live, "PACKET_ROWS", 16)  # several packets, the last of fewer rows
    with listening() as (listener, address):
        tev = Tev(listener)
        assert run(shot, tmp_path, address) == 0
        images = tev.wait()
    written = {str(tmp_path / f"{frame.number:04d}.exr"): frame[Role.COLOUR]
               for frame in Sequence(str(tmp_path / "####.exr"))}
    assert images.keys() == written.keys() and len(written) == 2
    for name, colour in written.items():
        np.testing.assert_allclose(images[name], colour, rtol=1e-3)  # files hold halves


def test_packets_are_those_of_tev_s_own_client():
    """The module that tev's author publishes makes the same bytes."""
    packet = pytest.importorskip("tevclient").packet
    colour = np.random.default_rng(3).random((7, 5, 3), np.float32)
    made = list(packets("a frame.exr", Frame({Role.COLOUR: colour})))
    assert made == [packet.create_image("a frame.exr", 5, 7, ["R", "G", "B"], False),
                    packet.update_image("a frame.exr", colour, ["R", "G", "B"])]


def test_a_display_s_codes_are_sent_as_light():
    codes = np.random.default_rng(0).random((3, 5, 3), np.float32)
    viewer = Tev.__new__(Tev)
    viewer.images = {}
    for packet in packets("a", Frame({Role.COLOUR: codes}, encoding="srgb")):
        viewer.take(packet[4:])
    np.testing.assert_allclose(viewer.images["a"], srgb_decode(codes), rtol=1e-6)


def test_a_viewer_that_is_not_there_stops_nothing(shot, tmp_path, capsys):
    with listening() as (_, address):
        pass  # closed again
    assert run(shot, tmp_path, address) == 0
    assert len(list(tmp_path.glob("*.exr"))) == 2
    assert 1 <= capsys.readouterr().err.count("takes no pictures") <= 2  # at once, and at the end


def test_a_viewer_that_hangs_holds_nothing(monkeypatch):
    """It takes the connection and reads nothing: pictures that it does not take are left out."""
    monkeypatch.setattr(live, "VIEWER_TIMEOUT_SECONDS", 0.2)
    monkeypatch.setattr(live, "LAST_SECONDS", 0.5)
    frame = Frame({Role.COLOUR: np.zeros((1024, 2048, 3), np.float32)})
    with listening() as (_, address):
        viewer = LiveViewer(address)
        for number in range(50):
            viewer.show(str(number), frame)
        assert viewer._waiting.qsize() <= live.MOST_QUEUED_PICTURES
        viewer.close()


@pytest.mark.parametrize(("text", "host", "port"), [
    ("tev", "localhost", 14158), ("tev:wall", "wall", 14158), ("tev:wall:99", "wall", 99),
    ("tev:[::1]:7", "::1", 7)])
def test_addresses_of_viewers_are_parsed(text, host, port):
    assert parse_address(text) == (host, port)


@pytest.mark.parametrize("text",
                         ["nuke", "tev:", "tev:host:port", "tev:host:0", "tev:host:70000", ""])
def test_what_is_no_address_is_refused(text):
    with pytest.raises(OptionError, match="give tev, tev:HOST or tev:HOST:PORT"):
        parse_address(text)
