"""Files that other software wrote: every untouched channel and attribute is in the output, by
hash."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.io.image_file import ImageFile
from postfx.io.sequence import read_sequence
from postfx.io.writer import write_frame
from tests.files.exr_files import channel_hashes, chunk_hashes, headers_of

FILES = (
    "exr/cryptomatte/cornellBox_CryptoWildcard.0001.exr",
    "exr/beachball/multipart.0001.exr",
    "exr/beachball/multipart.0002.exr",
    "exr/beachball/singlepart.0001.exr",
    "exr/crow/crow_dwa.exr",
    "exr/crow/crow_zip_half.exr",
    "exr/gaffer/imitateProductionLayers2.exr",
    "exr/gaffer/weirdPartNames.exr",
    "exr/oiio/grid-overscan.exr",
    "exr/openexr/Adjuster.exr",
    "exr/openexr/BrightRingsNanInf.exr",
    "sequences/garage/noisy.0001.exr",
    "sequences/garage/interleaved.0001.exr",
)
MORE = ("exr/beachball/multipart.0002.exr", "exr/beachball/singlepart.0001.exr")
"""Those that are large and of a kind that others are of."""
EACH = [pytest.param(name, marks=pytest.mark.soak if name in MORE else []) for name in FILES]
STRUCTURE = {"channels", "compression", "dataWindow", "displayWindow", "lineOrder", "chunkCount",
             "name", "type"}


def there(source: Path) -> Path:
    """The file; skips where that folder lacks it."""
    if not source.exists():
        pytest.skip(f"no {source.name}")
    return source


def write_darker(source: Path, out: Path, scale: int) -> tuple[Path, Frame]:
    frame = next(iter(read_sequence(source, planes=[Role.COLOUR])))
    larger = np.repeat(np.repeat(frame[Role.COLOUR], scale, 0), scale, 1) * np.float32(0.5)
    return (write_frame(out, dataclasses.replace(frame, planes={Role.COLOUR: larger}), keep=True),
            frame)


@pytest.mark.parametrize("name", EACH)
def test_every_untouched_channel_and_attribute_is_kept(shared_dir: Path, tmp_path: Path,
                                                       name: str) -> None:
    source = there(shared_dir / name)
    out, frame = write_darker(source, tmp_path / "out.exr", 1)
    before, after = channel_hashes(source), channel_hashes(out)
    shown = sorted(frame.colour_source.renders) if frame.colour_source else []
    in_place = bool(shown) or (frame.colour_source is not None
                               and frame.colour_source.channels == ("R", "G", "B"))
    parts = {part for part, _ in shown} or ({frame.colour_source.part} if in_place else set())
    touched = {list(headers_of(source))[part] for part in parts}
    for (part, channel), bits in before.items():
        if part not in touched or channel.rpartition(".")[2] not in ("R", "G", "B"):
            assert after[part if (part, channel) in after else "render", channel] == bits, (part,
                                                                                            channel)
    assert len(after) == len(before) + 3 * (not in_place)
    chunks, attributes = chunk_hashes(out), headers_of(out)
    for part, header in headers_of(source).items():
        kept = part if part in attributes else "render"
        if part not in touched:
            assert chunks[kept] == chunk_hashes(source)[part]
        changed = {key for key, value in header.items() if attributes[kept].get(key) != value}
        assert changed <= STRUCTURE


@pytest.mark.parametrize("name", EACH)
def test_enlarged_files_can_be_read_and_have_one_size(shared_dir: Path, tmp_path: Path,
                                                      name: str) -> None:
    source = there(shared_dir / name)
    out, frame = write_darker(source, tmp_path / "out.exr", 2)
    with ImageFile(source) as before, ImageFile(out) as after:
        sizes = {part.display: (2 * part.display.width, 2 * part.display.height)
                 for part in before.parts}
        assert {(part.display.width, part.display.height)
                for part in after.parts} == set(sizes.values())
        for part in after.parts:
            after.read(part, dict.fromkeys(part.channels, 0.0), (0, 8))
        names = {name for part in before.parts for name in part.channels}
        kept = {name for part in after.parts for name in part.channels}
        replaced = ({name for _, name in frame.colour_source.renders} if frame.colour_source
                    else set())
        assert names - replaced <= kept
        assert not {name for name in kept if name.endswith("Combined.R")}
