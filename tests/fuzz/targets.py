"""What is fuzzed: everything that reads what others wrote. Each target takes bytes and may raise
PostfxError only."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from postfx.cli.run_options import parse_cuts
from postfx.errors import CheckpointError, ManifestError, PostfxError, SequenceError
from postfx.frame import Role
from postfx.io.convert import parse_depth
from postfx.io.exr.container import ExrContainer
from postfx.io.frame_reader import FrameFiles
from postfx.io.pattern import number_in_name, parse_frames, parse_pattern, pattern_of
from postfx.io.profile import BUILTIN, load_profile
from postfx.io.read_options import ReadOptions
from postfx.io.sequence import Sequence
from postfx.io.writer import write_frame
from postfx.masks import parse_leave
from postfx.passes.tonemap import check_constants, find_tone_mapper, shaper
from postfx.runs.folder import About, load_checkpoint, read_about, save_checkpoint
from postfx.runs.locks import Process, is_alive
from postfx.runs.manifest import MANIFEST_NAME, Manifest, Output, verify
from postfx.runtime import Device, Library
from postfx.system import parse_size
from tests.files.exr_files import write_mixed, write_studio
from tests.toys import save_model, value

MOST_PIXELS = 1 << 20
"""Frames above that are opened and not decoded, so that a run tries many files."""
SIZE = 9, 7
"""Of pictures to begin with: most of their bytes are headers, and many are tried."""
FOLDER = Path()
"""Where all that a target reads and writes lies: fuzz.py goes there. A name of its own would change
what is tried."""


def exr(content: bytes) -> None:
    """Open a file, read its planes, write it with all that it holds, and read that."""
    path = FOLDER / "a.exr"
    path.write_bytes(content)
    with FrameFiles({"": path}) as files:
        if (Role.COLOUR not in files.layout.planes
            or np.prod(files.match(Role.COLOUR).size) > MOST_PIXELS):
            return
        frame = files.read(1, [Role.COLOUR])
    frame = dataclasses.replace(frame, planes={Role.COLOUR: np.nan_to_num(frame[Role.COLOUR])})
    out = write_frame(FOLDER / "out.exr", frame, keep=True)
    with FrameFiles({"": out}) as files:
        assert files.match(Role.COLOUR).size == frame[Role.COLOUR].shape[1::-1]


def container(content: bytes) -> None:
    """Headers and chunks of a file without a decoder behind them."""
    path = FOLDER / "c.exr"
    path.write_bytes(content)
    with ExrContainer(path) as file:
        for part in range(len(file.headers)):
            size = sum(len(stored) for _, stored in file.copy_chunks(part))
            assert size <= len(content) * max(file.counts)


def hdr(content: bytes) -> None:
    """Open and read a Radiance file."""
    path = FOLDER / "a.hdr"
    path.write_bytes(content)
    with FrameFiles({"": path}) as files:
        if np.prod(files.match(Role.COLOUR).size) <= MOST_PIXELS:
            files.read(1)


def profile(content: bytes) -> None:
    """Parse a profile, and read a file by its rules."""
    path = FOLDER / "studio.toml"
    path.write_bytes(content)
    load_profile.cache_clear()
    load_profile(str(path))
    with FrameFiles({"": _sample()}, ReadOptions(profile=str(path))) as files:
        files.read(1)


def patterns(content: bytes) -> None:
    """Frame patterns, ranges, and the other small languages of the command line."""
    text = content.decode("utf-8", "surrogateescape").replace("\0", "")
    for parse in (parse_frames, parse_depth, parse_leave, parse_cuts, parse_size):
        try:
            parse(text)
        except PostfxError:
            pass
    number_in_name(Path(text)), pattern_of(Path(text))
    try:
        pattern = parse_pattern(text)
    except SequenceError:
        return
    path = pattern.path(7)
    if (os.path.isabs(text) or str(Path(text))[:1] == "~"
        or ".." in (*Path(text).parts, *path.parts)):
        return  # what lies elsewhere on a machine is no input
    try:
        Sequence(text)
    except PostfxError:
        pass
    if pattern.is_numbered and "{plane}" not in text and path.name:
        assert pattern.includes(path), (str(pattern), path)


def model(content: bytes) -> None:
    """A card and an ONNX file: the first line, in JSON, is the card."""
    card, _, network = content.partition(b"\n")
    (FOLDER / "models").mkdir(exist_ok=True)
    (FOLDER / "models/toy.json").write_bytes(card)
    (FOLDER / "models/toy.onnx").write_bytes(network)
    library = Library(FOLDER / "models")
    library.card("toy"), library.constants("toy")
    _device().pipeline_state(library, "toy", {"height": 4, "width": 4})


def records(content: bytes) -> None:
    """A manifest, a claim, a lock and a checkpoint of another run."""
    text = content.decode("utf-8", "surrogateescape")
    try:
        manifest = Manifest.from_json(text)
        assert Manifest.from_json(manifest.to_json()) == manifest
    except ManifestError:
        pass
    for path in (FOLDER / "run.claim", FOLDER / "run.checkpoint", FOLDER / MANIFEST_NAME):
        path.write_bytes(content)
    is_alive(FOLDER, "run")
    for read in (read_about, load_checkpoint):
        try:
            read(FOLDER / "run.checkpoint")
        except CheckpointError:
            pass
    verify(FOLDER)


def look(content: bytes) -> None:
    """The card of a look, and whether its cube can be used: the first line, in JSON, is the
    card."""
    card, _, network = content.partition(b"\n")
    (FOLDER / "looks").mkdir(exist_ok=True)
    (FOLDER / "looks/toy.json").write_bytes(card)
    (FOLDER / "looks/toy.onnx").write_bytes(network)
    library, name = find_tone_mapper(str(FOLDER / "looks/toy.onnx"))
    shaper(library, name)
    state = _device().pipeline_state(library, name)
    check_constants(name, state.constants,
                    any(binding.name == "grid" for binding in state.bindings))


def seeds(name: str, folder: Path) -> None:
    """A few small inputs that are all right, to begin with."""
    def add(stem: str, content: bytes) -> None:
        (folder / stem).write_bytes(content)

    if name in ("exr", "container"):
        for compression in ("NO", "ZIP", "PIZ", "DWAA"):
            add(compression, write_mixed(FOLDER / "seed.exr", compression, size=SIZE).read_bytes())
        add("tiles", write_mixed(FOLDER / "seed.exr", tiled=True, size=SIZE).read_bytes())
        add("parts", write_studio(FOLDER, SIZE).read_bytes())
    if name == "hdr":
        add("flat", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 3 +X 2\n" + bytes(range(24)))
        add("runs",
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 16\n\2\2\0\x10" + b"\x90\x55" * 4)
    if name == "profile":
        for path in BUILTIN.glob("*.toml"):
            add(path.stem, path.read_bytes())
    if name == "patterns":
        for place in ("in/0001.exr", "in/0002.exr", "shot.0007.exr", "left/depth.12.exr",
                      "deep/er/1/a.exr"):
            (FOLDER / place).parent.mkdir(parents=True, exist_ok=True)
            (FOLDER / place).touch()
        for text in ("shot.####.exr", "in/%04d.exr", "1-100x2,5", "ray,fov=54.4,miss=0",
                     "auto,logo=0.5,7-9@id", "<F4>.$F4.@@.exr", "{plane}.##.exr", "*/*.exr",
                     "**/*/a.exr", "{view}/d*.##.exr", "4.5G", "1,48,90"):
            add(text.replace("/", "_"), text.encode())
    if name == "model":
        from onnx import helper
        nodes = [helper.make_node("Neg", ["x"], ["y"])]
        save_model(FOLDER / "toy.onnx", nodes, [value("x", (1, 2, "height", "width"))],
                   [value("y", (1, 2, "height", "width"))])
        card = {"inputs": {"x": {}}, "outputs": {"y": {"constant": False}}, "weights": {}}
        add("toy", json.dumps(card).encode() + b"\n" + (FOLDER / "toy.onnx").read_bytes())
    if name == "look":
        from onnx import helper
        nodes = [helper.make_node("Identity", ["w"], ["cube"])]
        save_model(FOLDER / "toy.onnx", nodes, [], [value("cube", (2, 2, 2, 3))],
                   {"w": np.zeros((2, 2, 2, 3), "f4")})
        card = {"shaper": {"toe": 0.1, "scale": 0.1, "matrix": [1.0] * 9},
                "outputs": {"cube": {"constant": True}}}
        add("toy", json.dumps(card).encode() + b"\n" + (FOLDER / "toy.onnx").read_bytes())
    if name == "records":
        output = Output("run", 1, "0" * 64, 7, 2, 3, {"in.exr": (1, 2)}, True)
        add("manifest",
            Manifest({"run": {"status": "running"}}, {"a.0001.exr": output}).to_json().encode())
        add("claim", json.dumps({"process": Process.me().as_dict(), "files": ["a"]}).encode())
        save_checkpoint(FOLDER / "seed", About("run", "a.####.exr", 3, "f"),
                        {"grid": np.zeros((2, 3), "f4")})
        add("checkpoint", (FOLDER / "seed").read_bytes())


def _sample() -> Path:
    path = FOLDER / "sample.exr"
    return path if path.is_file() else write_mixed(path)


_devices: list[Device] = []


def _device() -> Device:
    if not _devices:
        _devices.append(Device("cpu", threads=1))
    return _devices[0]


TARGETS: dict[str, Callable[[bytes], None]] = {
    "exr": exr, "container": container, "hdr": hdr, "profile": profile, "patterns": patterns,
    "model": model, "look": look, "records": records,
}
