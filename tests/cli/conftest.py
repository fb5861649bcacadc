"""Running the command line as people do, on small files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def shot(write_exr: Callable[..., Path], tmp_path: Path) -> Callable[..., Path]:
    """Writes in/shot.####.exr: noise around the frame number, with depth and still motion; gives
    the folder."""

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
            write_exr(f"in/shot.{number:04d}.exr", planes)
        return tmp_path / "in"

    return write


@pytest.fixture
def noise(write_exr: Callable[..., Path], tmp_path: Path) -> Path:
    """Six frames in/shot.####.exr of a wall at rest under noise of their own; gives the folder
    around."""
    rng = np.random.default_rng(8)
    for number in range(1, 7):
        planes = {name: rng.exponential(size=(32, 48)) for name in "RGB"}
        planes |= {"depth.Z": np.full((32, 48), 3.0), "motion.X": np.zeros((32, 48)),
                   "motion.Y": np.zeros((32, 48))}
        write_exr(f"in/shot.{number:04d}.exr", planes)
    return tmp_path
