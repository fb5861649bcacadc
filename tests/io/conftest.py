"""Small EXR files, written for one test each."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import OpenEXR
import pytest


@pytest.fixture
def write_parts(tmp_path: Path) -> Callable[..., Path]:
    """Writes a multi-part file: part name -> channels; all parts have the display window of `size`,
    or their own."""

    def write(
        name: str, parts: Mapping[str, Mapping[str, np.ndarray]],
        size: tuple[int, int] | None = None, **header
    ) -> Path:
        window = ({"displayWindow": (np.zeros(2, np.int32), np.array(size, np.int32) - 1)} if size
                  else {})
        made = [
            OpenEXR.Part(
                {"type": OpenEXR.scanlineimage, **window, **(header if index == 0 else {})},
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
