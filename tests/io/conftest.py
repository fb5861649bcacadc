"""Small EXR files, written for one test each."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest


@pytest.fixture
def write_exr(tmp_path: Path) -> Callable[..., Path]:
    """Writes channels (name -> height x width array) as a single-part file."""

    def write(name: str, channels: Mapping[str, np.ndarray], **header) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        height, width = next(iter(channels.values())).shape
        spec = oiio.ImageSpec(width, height, len(channels), "float")
        spec.channelnames = tuple(channels)
        origin, display = header.pop("origin", (0, 0)), header.pop("display", None)
        spec.x, spec.y = origin
        if display:
            spec.full_x, spec.full_y, spec.full_width, spec.full_height = display
        for key, value in header.items():
            kind = {2: "float2", 16: "matrix"}.get(np.size(value))
            values = (oiio.TypeDesc(kind), tuple(map(float, value))) if kind else (value,)
            spec.attribute(key.replace("__", ":"), *values)
        output = oiio.ImageOutput.create(str(path))
        assert output.open(str(path), spec)
        assert output.write_image(np.stack(list(channels.values()), axis=-1).astype(np.float32))
        output.close()
        return path

    return write


@pytest.fixture
def write_parts(tmp_path: Path) -> Callable[..., Path]:
    """Writes a multi-part file: part name -> channels."""

    def write(name: str, parts: Mapping[str, Mapping[str, np.ndarray]], **header) -> Path:
        made = [
            OpenEXR.Part(
                {"type": OpenEXR.scanlineimage, **(header if index == 0 else {})},
                {channel: pixels.astype(np.float32) for channel, pixels in channels.items()},
                part,
            )
            for index, (part, channels) in enumerate(parts.items())
        ]
        OpenEXR.File(made).write(str(tmp_path / name))
        return tmp_path / name

    return write


@pytest.fixture
def ramp() -> Callable[..., dict[str, np.ndarray]]:
    """Channels with distinct, reproducible values in 0..1."""

    def make(*names: str, height: int = 6, width: int = 8) -> dict[str, np.ndarray]:
        rng = np.random.default_rng(len(names))
        return {name: rng.random((height, width), np.float32) for name in names}

    return make
