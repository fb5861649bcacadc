"""The recipe of docs/howto/hosts.md for compositing programs: a file of Nuke's layers through the command line."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx import Role, read_sequence
from postfx.cli.main import main

PROFILE = str(Path(__file__).parents[2] / "hosts/nuke.toml")
NAMES = ("R", "G", "B", "A", "albedo.red", "albedo.green", "albedo.blue", "N.red", "N.green", "N.blue", "depth.Z",
         "backward.u", "backward.v", "mask.a", "cryptomatte00.red")


def write(path: Path, channels: np.ndarray) -> None:
    spec = oiio.ImageSpec(*channels.shape[1::-1], len(NAMES), "float")
    spec.channelnames = NAMES
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(channels) and file.close()


def read(path: Path) -> tuple[list[str], dict[str, np.ndarray]]:
    file = oiio.ImageInput.open(str(path))
    names = list(file.spec().channelnames)
    return names, dict(zip(names, np.moveaxis(file.read_image("float"), 2, 0), strict=True))


@pytest.fixture
def shot(tmp_path):
    """Three frames of a picture that moves 2 pixels to the right and 1 up, with Nuke's vectors to the frame before."""
    random = np.random.default_rng(0)
    wide = np.repeat(np.repeat(random.random((12, 16, 3), np.float32), 4, 0), 4, 1)
    for i in range(3):
        frame = random.random((32, 40, len(NAMES)), np.float32)
        albedo = wide[4 + i:36 + i, 20 - 2 * i:60 - 2 * i]
        frame[..., :3], frame[..., 3], frame[..., 4:7] = albedo * random.gamma(1, 1, (32, 40, 1)), 1, albedo
        frame[..., 7:10], frame[..., 10], frame[..., 11:13] = (0, 0, 1), 5, (-2, -1)  # y is up
        write(tmp_path / f"in.{i + 1:04d}.exr", frame)
    return tmp_path


@pytest.mark.parametrize("scale", ["1", "2"])
def test_planes_keep_their_names(shot, scale, capsys):
    given, out = str(shot / "in.%04d.exr"), str(shot / "out.%04d.exr")
    command = ["run", given, "-o", out, "--scale", scale, "--profile", PROFILE, "--keep", "all", "--model", "s"]
    assert main(command) == 0
    assert "no motion plane" not in capsys.readouterr().out
    before, after = read(shot / "in.0003.exr"), read(shot / "out.0003.exr")
    assert after[0] == before[0] and set(after[0]) == set(NAMES)
    for name in NAMES[10:]:
        kept = np.repeat(np.repeat(before[1][name], int(scale), 0), int(scale), 1)
        factor = int(scale) if name.startswith("backward") else 1  # distances in pixels stay distances in pixels
        assert np.array_equal(after[1][name], kept * factor), name


def test_motion_of_nuke_is_read_as_ours(shot):
    frame = next(iter(read_sequence(str(shot / "in.####.exr"), profile=PROFILE)))
    assert np.all(frame[Role.MOTION] == (-2, 1))
