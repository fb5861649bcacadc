"""Running the command line as people do, on small files."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio
import pytest

REPOSITORY = Path(__file__).resolve().parent.parent.parent


class Outcome(NamedTuple):
    """Exit code and outputs of a command."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        return json.loads(self.out)


@pytest.fixture
def postfx(tmp_path: Path) -> Callable[..., Outcome]:
    """Runs `postfx ARGUMENTS` in the test's folder."""

    def run(*arguments: str) -> Outcome:
        path = os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")]))
        done = subprocess.run(
            [sys.executable, "-m", "postfx", *arguments],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        return Outcome(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def write_image(tmp_path: Path) -> Callable[..., Path]:
    """Writes an EXR of channels (name -> height x width array)."""

    def write(name: str, channels: Mapping[str, np.ndarray]) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        height, width = next(iter(channels.values())).shape
        spec = oiio.ImageSpec(width, height, len(channels), "float")
        spec.channelnames = tuple(channels)
        output = oiio.ImageOutput.create(str(path))
        assert output.open(str(path), spec)
        assert output.write_image(np.stack(list(channels.values()), axis=-1).astype(np.float32))
        output.close()
        return path

    return write


@pytest.fixture
def shot(write_image: Callable[..., Path], tmp_path: Path) -> Callable[..., Path]:
    """Writes in/shot.####.exr: noise around the frame number, with depth and still motion; gives the folder."""

    def write(*numbers: int, alpha: bool = False) -> Path:
        rng = np.random.default_rng(5)
        for number in numbers:
            planes = {name: number + rng.random((32, 48), np.float32) for name in "RGB"}
            planes |= {"A": np.ones((32, 48))} if alpha else {}
            planes |= {
                "depth.Z": np.full((32, 48), 3.0),
                "motion.X": np.zeros((32, 48)),
                "motion.Y": np.zeros((32, 48)),
            }
            write_image(f"in/shot.{number:04d}.exr", planes)
        return tmp_path / "in"

    return write
