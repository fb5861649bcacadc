"""The recipe of docs/howto/hosts.md for compositing programs: files of their layers through the
command line."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx import Role, read_sequence
from postfx.cli.main import main

PROFILE = str(Path(__file__).parents[2] / "hosts/nuke.toml")
NAMES = ("R", "G", "B", "A", "albedo.red", "albedo.green", "albedo.blue", "N.red", "N.green",
         "N.blue", "depth.Z", "backward.u", "backward.v", "mask.a", "cryptomatte00.red")


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
    """Three frames of a picture that moves 2 pixels to the right and 1 up, with Nuke's vectors to
    the frame before."""
    random = np.random.default_rng(0)
    wide = np.repeat(np.repeat(random.random((12, 16, 3), np.float32), 4, 0), 4, 1)
    for i in range(3):
        frame = random.random((32, 40, len(NAMES)), np.float32)
        albedo = wide[4 + i:36 + i, 20 - 2 * i:60 - 2 * i]
        frame[..., :3] = albedo * random.gamma(1, 1, (32, 40, 1))
        frame[..., 3] = 1
        frame[..., 4:7] = albedo
        frame[..., 7:10], frame[..., 10], frame[..., 11:13] = (0, 0, 1), 5, (-2, -1)  # y is up
        write(tmp_path / f"in.{i + 1:04d}.exr", frame)
    return tmp_path


@pytest.mark.parametrize("scale", ["1", "2"])
def test_planes_keep_their_names(shot, scale, capsys):
    given, out = str(shot / "in.%04d.exr"), str(shot / "out.%04d.exr")
    command = ["run", given, "-o", out, "--scale", scale, "--profile", PROFILE, "--keep", "all",
               "--model", "s"]
    assert main(command) == 0
    assert "no motion vectors" not in capsys.readouterr().out
    before, after = read(shot / "in.0003.exr"), read(shot / "out.0003.exr")
    assert after[0] == before[0] and set(after[0]) == set(NAMES)
    for name in NAMES[10:]:
        kept = np.repeat(np.repeat(before[1][name], int(scale), 0), int(scale), 1)
        # distances in pixels stay distances in pixels
        factor = (int(scale) if name.startswith("backward") else 1)
        assert np.array_equal(after[1][name], kept * factor), name


def test_motion_of_nuke_is_read_as_ours(shot):
    frame = next(iter(read_sequence(str(shot / "in.####.exr"), profile=PROFILE)))
    assert np.all(frame[Role.MOTION] == (-2, 1))


LAYERS = {
    "Nuke, one "
    "part": [("", ("R", "G", "B", "A", "albedo.red", "albedo.green", "albedo.blue", "mask.a"))],
    "Nuke, a part a layer": [("rgba", ("R", "G", "B", "A")), ("albedo", ("R", "G", "B")),
                             ("mask", ("A",))],
    "Nuke, a part a layer and view": [("rgba.main", ("R", "G", "B", "A")),
                                      ("albedo.main", ("R", "G", "B"))],
    "Natron": [("Color", ("R", "G", "B", "A")), ("Normal", ("Normal.R", "Normal.G", "Normal.B"))],
    "a layer of words": [("", ("beauty.red", "beauty.green", "beauty.blue", "mask.a"))],
    "Blender": [("", ("ViewLayer.Combined.R", "ViewLayer.Combined.G", "ViewLayer.Combined.B",
                      "ViewLayer.Combined.A",
                      "ViewLayer.Normal.X", "ViewLayer.Normal.Y", "ViewLayer.Normal.Z"))],
}
"""Parts and their channels as programs name them; the picture's come first."""


def write_parts(path: Path, parts: list[tuple[str, tuple[str, ...]]]) -> None:
    random, specs = np.random.default_rng(0), []
    for name, channels in parts:
        spec = oiio.ImageSpec(40, 32, len(channels), "float")
        spec.channelnames = channels
        if name:
            spec["oiio:subimagename"] = name
        specs.append(spec)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), tuple(specs))
    for k, (spec, (_, channels)) in enumerate(zip(specs, parts, strict=True)):
        if k:
            assert file.open(str(path), spec, "AppendSubimage")
        pixels = random.gamma(1, 0.3, (32, 40, len(channels))).astype(np.float32)
        pixels[..., [i for i, name in enumerate(channels) if name.rpartition(".")[2] == "A"]] = 1
        assert file.write_image(pixels)
    assert file.close()


def by_openimageio(path: Path) -> dict[tuple[str, str], np.ndarray]:
    """(Part, channel) -> pixels, as OpenImageIO reads them."""
    file, found = oiio.ImageInput.open(str(path)), {}
    for part in range(99):
        if not file.seek_subimage(part, 0):
            return found
        spec, pixels = file.spec(), file.read_image(part, 0, 0, file.spec().nchannels, "float")
        part_name = spec.get_string_attribute("oiio:subimagename")
        found |= {(part_name, name): pixels[..., i] for i, name in enumerate(spec.channelnames)}
    raise AssertionError("a file without an end")


def by_openexr(path: Path) -> dict[tuple[str, str], np.ndarray]:
    """The same, as OpenEXR itself reads them."""
    openexr = pytest.importorskip("OpenEXR")
    with openexr.File(str(path), separate_channels=True) as file:
        return {(part.header.get("name") or "", name): np.float32(channel.pixels)
                for part in file.parts for name, channel in part.channels.items()}


@pytest.mark.parametrize("layout", LAYERS)
@pytest.mark.parametrize("reader", [by_openimageio, by_openexr])
def test_the_picture_has_the_renders_names(tmp_path, layout, reader):
    """A node that shows the render's picture shows the denoised one; everything else is the
    render's, to the bit."""
    parts = LAYERS[layout]
    write_parts(tmp_path / "in.0001.exr", parts)
    assert main(["run", str(tmp_path / "in.0001.exr"), "-o", str(tmp_path / "out.0001.exr"),
                 "--model", "s"]) == 0
    before, after = reader(tmp_path / "in.0001.exr"), reader(tmp_path / "out.0001.exr")
    picture = parts[0][1][:3]
    assert after.keys() == before.keys()
    for key, pixels in before.items():
        if key[0] in ("", parts[0][0]) and key[1] in picture:
            assert np.abs(np.diff(after[key], axis=1)).mean() < 0.5 * np.abs(np.diff(
                pixels, axis=1
            )).mean(), key
        else:
            np.testing.assert_array_equal(after[key], pixels, err_msg=str(key))
