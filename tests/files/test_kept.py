"""Everything beside the picture goes into the output bit for bit: files with all that a pipeline
may put into them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from postfx.cli.main import main, make_parser
from postfx.cli.run_options import explain_kept
from postfx.errors import ReadError
from postfx.frame import Frame, Role
from postfx.io.exr.container import ExrContainer
from postfx.io.exr.passthrough import Enlargement
from postfx.io.sequence import read_sequence
from postfx.io.windows import Window
from postfx.io.writer import is_complete, write_frame
from postfx.plan import Skip
from tests.files.exr_files import (
    COMPRESSIONS,
    HEIGHT,
    WIDTH,
    channel_hashes,
    chunk_hashes,
    headers_of,
    noise_bits,
    picture,
    write_mixed,
    write_studio,
)

PICTURE = ("R", "G", "B", "A")


def processed(path: Path, scale: int = 1) -> Frame:
    """The file's picture, enlarged and darker, and centred, as the denoiser leaves it."""
    frame = next(iter(read_sequence(path, planes=[Role.COLOUR, Role.ALPHA])))
    planes = {role: np.repeat(np.repeat(plane, scale, 0), scale, 1) * np.float32(0.5)
              for role, plane in frame.planes.items()}
    return dataclasses.replace(frame, planes=planes, jitter=(0.0, 0.0))


def keep(path: Path, scale: int = 1) -> tuple[Path, Frame]:
    frame = processed(path, scale)
    return write_frame(path.with_name("out.exr"), frame, keep=True), frame


def untouched(hashes: dict[tuple[str, str], str]) -> dict[str, str]:
    return {name: bits for (_, name), bits in hashes.items() if name not in PICTURE}


@pytest.mark.parametrize("tiled", [False, True], ids=["scanlines", "tiles"])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_channels_of_the_pictures_part_stay_in_place(tmp_path: Path, compression: str,
                                                     tiled: bool) -> None:
    source = write_mixed(tmp_path / "in.exr", compression, tiled)
    before = channel_hashes(source)
    out, frame = keep(source)
    after = channel_hashes(out)
    assert untouched(after) == untouched(before) and len(untouched(before)) == 7
    assert set(after) == set(before)
    again = next(iter(read_sequence(out, planes=[Role.COLOUR, Role.ALPHA])))
    np.testing.assert_array_equal(again[Role.COLOUR], frame[Role.COLOUR].astype(np.float16))
    np.testing.assert_array_equal(again[Role.ALPHA], frame[Role.ALPHA].astype(np.float16))


def pixels(path: Path, part: int = 0) -> dict[str, np.ndarray]:
    """Bits of a part's channels, as they are stored."""
    channels = OpenEXR.File(str(path), separate_channels=True).parts[part].channels
    return {name: channel.pixels.view(f"u{channel.pixels.itemsize}")
            for name, channel in channels.items()}


def larger(plane: np.ndarray) -> np.ndarray:
    return np.repeat(np.repeat(plane, 2, 0), 2, 1)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_beside_a_larger_picture_channels_have_the_bits_of_the_nearest_pixel(
    tmp_path: Path, compression: str
) -> None:
    source = write_mixed(tmp_path / "in.exr", compression)
    out, frame = keep(source, 2)
    before, after = pixels(source), pixels(out)
    assert set(after) == set(before)
    for name in before.keys() - set(PICTURE):
        np.testing.assert_array_equal(after[name], larger(before[name]), err_msg=name)
    with ExrContainer(out) as file:
        (header,) = file.headers
    assert ((header.data.width, header.data.height) == (2 * WIDTH, 2 * HEIGHT)
            and header.data == header.display)
    (again,) = read_sequence(out, planes=[Role.COLOUR])
    np.testing.assert_array_equal(again[Role.COLOUR], frame[Role.COLOUR].astype(np.float16))


def test_every_pixel_of_any_enlargement_is_that_of_the_nearest_one() -> None:
    """Also where data and display window differ, and the picture is no whole multiple of the
    render."""
    data = Window(-2, 3, 7, 9)
    enlargement = Enlargement(Window(0, 0, 9, 9), Window(0, 0, 16, 24))
    assert enlargement.window(data) == (-4, 7, 13, 24)
    lines, columns = enlargement.nearest(data)
    wanted = [min(max(int(np.floor((x + 0.5) / 1.7)) + 2, 0), 9) for x in range(-4, 14)]
    assert columns.tolist() == wanted
    assert lines.tolist() == [min(max(int(np.floor((y + 0.5) / 2.5)) - 3, 0), 6)
                              for y in range(7, 25)]


def test_a_larger_picture_takes_the_place_of_the_renders_colour_in_layers(tmp_path: Path) -> None:
    """Other layers stay, at the picture's size; distances in pixels grow."""
    light = picture()
    layers = {"ViewLayer.Combined": "RGBA", "ViewLayer.Noisy Image": "RGBA",
              "ViewLayer.Vector": "XYZW", "BG.Combined": "RGBA"}
    parts = [OpenEXR.Part(
        {"type": OpenEXR.scanlineimage},
        {f"{layer}.{name}": light[own] for name, own in zip(names, "RGBA", strict=True)}, layer
    ) for layer, names in layers.items()]
    OpenEXR.File(parts).write(str(tmp_path / "in.exr"))
    out, frame = keep(tmp_path / "in.exr", 2)
    assert [part.name() for part in OpenEXR.File(str(out)).parts] == ["rgba", "ViewLayer.Vector",
                                                                      "BG.Combined"]
    found = OpenEXR.File(str(out), separate_channels=True).parts
    motion = {name: channel.pixels for name, channel in found[1].channels.items()}
    for letter, own in zip("XYZW", "RGBA", strict=True):
        np.testing.assert_array_equal(motion[f"ViewLayer.Vector.{letter}"],
                                      larger(light[own]) * np.float16(2))
    np.testing.assert_array_equal(found[2].channels["BG.Combined.R"].pixels, larger(light["R"]))
    (again,) = read_sequence(out, planes=[Role.COLOUR])
    np.testing.assert_array_equal(again[Role.COLOUR], frame[Role.COLOUR].astype(np.float16))


def test_guides_of_the_pictures_size_stay_as_they_are(tmp_path: Path) -> None:
    window = {"displayWindow": (np.zeros(2, np.int32), np.int32([WIDTH - 1, HEIGHT - 1]))}
    guides = {f"albedo.{name}": noise_bits(seed, "half", 2 * WIDTH, 2 * HEIGHT)
              for seed, name in enumerate("RGB")}
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage, **window}, channels, name)
             for name, channels in (
        ("rgba", picture() | {"depth.Z": noise_bits(1, "float")}), ("albedo", guides))]
    OpenEXR.File(parts).write(str(tmp_path / "in.exr"))
    before = channel_hashes(tmp_path / "in.exr")
    out, _ = keep(tmp_path / "in.exr", 2)
    after = channel_hashes(out)
    assert {key: bits for key, bits in after.items() if key[0] == "albedo"} == \
        {key: bits for key, bits in before.items() if key[0] == "albedo"}
    with ExrContainer(out) as file:
        assert {header.data for header in file.headers} == {(0, 0, 2 * WIDTH - 1, 2 * HEIGHT - 1)}


def test_by_default_nothing_is_kept_beside_a_larger_picture(tmp_path: Path) -> None:
    source = write_mixed(tmp_path / "in.exr")
    same, enlarged = (write_frame(tmp_path / f"{scale}.exr", processed(source, scale), keep=None)
                      for scale in (1, 2))
    assert untouched(channel_hashes(same)) == untouched(channel_hashes(source))
    assert not untouched(channel_hashes(enlarged))


@pytest.mark.parametrize("scale", [1, 2])
def test_every_attribute_keeps_its_bytes(tmp_path: Path, scale: int) -> None:
    source = write_studio(tmp_path)
    before, (out, _) = headers_of(source), keep(source, scale)
    after = headers_of(out)
    fresh = {"channels", "compression", "dataWindow", "displayWindow", "lineOrder", "chunkCount",
             "name", "type"}
    assert set(after) == set(before) - ({"deep"} if scale > 1 else set())
    for part in after:
        moved = {"compression", "chunkCount"} if part == "beauty" else set()
        moved |= fresh | {"tiles"} if scale > 1 else set()
        assert {name
                for name, value in before[part].items() if after[part].get(name) != value} <= moved
    if scale > 1:
        assert after["mip"]["render:displayWindow"] == before["mip"]["displayWindow"]


def test_deep_and_mip_mapped_parts_are_copied_as_they_are_stored(tmp_path: Path) -> None:
    source = write_studio(tmp_path)
    before, (out, _) = chunk_hashes(source), keep(source)
    after = chunk_hashes(out)
    assert {part: after[part] for part in ("deep", "mip")} == {part: before[part]
                                                               for part in ("deep", "mip")}
    file = oiio.ImageInput.open(str(out))
    samples = file.read_native_deep_image(1, 0)
    assert [samples.samples(pixel) for pixel in range(8)] == [0, 1, 2, 3, 0, 1, 2, 3]
    assert samples.deep_value(7, 1, 2) == 7.25
    assert file.seek_subimage(2, 6) and file.read_image(2, 6, 0, 1, oiio.FLOAT).item() == 6
    file.close()


def test_beside_a_larger_picture_there_are_no_deep_parts_and_no_smaller_levels(
    tmp_path: Path
) -> None:
    out, _ = keep(write_studio(tmp_path), 2)
    file = oiio.ImageInput.open(str(out))
    assert file.seek_subimage(1, 0) and not file.seek_subimage(1, 1)
    np.testing.assert_array_equal(file.read_image(1, 0, 0, 1, oiio.FLOAT), np.zeros((128, 128, 1)))
    file.close()


def test_a_colour_in_layers_gives_its_place_to_the_picture(tmp_path: Path) -> None:
    """Blender's own denoiser was on: the noisy image stays, and what compositors show is the
    picture."""
    light = picture()
    layers = ("ViewLayer.Combined", "ViewLayer.Noisy Image")
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage},
                          {f"{layer}.{name}": light[name] for name in "RGBA"}, layer)
             for layer in layers]
    OpenEXR.File(parts).write(str(tmp_path / "in.exr"))
    before, (out, frame) = channel_hashes(tmp_path / "in.exr"), keep(tmp_path / "in.exr")
    after = channel_hashes(out)
    shown = {key for key in after if key[0] == "ViewLayer.Combined"}
    assert (after.keys() == before.keys()
            and {key for key in after if after[key] != before[key]} == shown)
    (again,) = read_sequence(out)
    np.testing.assert_array_equal(again[Role.COLOUR], frame[Role.COLOUR].astype(np.float16))


def test_a_finished_file_is_read_back_with_its_planes(tmp_path: Path) -> None:
    source = write_mixed(tmp_path / "in.exr")
    out, _ = keep(source, 2)
    (frame,), (before,) = read_sequence(out), read_sequence(source)
    np.testing.assert_array_equal(frame[Role.DEPTH], larger(before[Role.DEPTH]))
    again = write_frame(tmp_path / "again.exr", frame, keep=True)
    assert untouched(channel_hashes(again)) == untouched(channel_hashes(out))


def test_planes_that_are_smaller_than_the_picture_beside_them_are_not_read(tmp_path: Path) -> None:
    """Older versions kept the render beside the picture at its own size."""
    display = {"displayWindow": (np.zeros(2, np.int32), np.int32([2 * WIDTH - 1, 2 * HEIGHT - 1]))}
    kind = {"type": OpenEXR.scanlineimage, **display}
    parts = [OpenEXR.Part({**kind, **header}, channels, name) for name, header, channels in (
        ("rgba", {"postfx:picture": "R,G,B,A"},
         {name: larger(plane) for name, plane in picture().items()}),
        ("render", {}, picture() | {"depth.Z": noise_bits(1, "float")}))]
    OpenEXR.File(parts).write(str(tmp_path / "old.exr"))
    sequence = read_sequence(tmp_path / "old.exr")
    (frame,) = sequence
    assert set(frame.planes) == {Role.COLOUR, Role.ALPHA} and frame.spec.width == 2 * WIDTH
    assert sequence.warnings == ["AOVs depth are of the render before it was enlarged: not read"]


def test_what_is_no_longer_true_of_the_picture_is_kept_apart(tmp_path: Path) -> None:
    source = write_mixed(tmp_path / "in.exr",
                         **{"postfx:jitter": np.float32([0.25, -0.25]), "postfx:spp": 4})
    (jittered,) = read_sequence(source)
    still = write_frame(tmp_path / "still.exr", jittered, keep=True)
    assert next(iter(read_sequence(still))).jitter == (0.25, -0.25), "as long as it is true"
    assert "render:postfx:jitter" not in headers_of(still)[""]
    out, _ = keep(source)
    header = headers_of(out)[""]
    before = headers_of(source)[""]
    for name in ("postfx:jitter", "postfx:spp"):
        assert name not in header and header[f"render:{name}"] == before[name]
    assert next(iter(read_sequence(out))).jitter == (0, 0)
    enlarged, _ = keep(source, 2)
    assert headers_of(enlarged)[""]["render:postfx:jitter"] == before["postfx:jitter"]
    assert next(iter(read_sequence(enlarged))).jitter == (0, 0)


def test_a_changed_attribute_is_the_writers(tmp_path: Path) -> None:
    frame = processed(write_mixed(tmp_path / "in.exr"))
    frame.metadata |= {"owner": "me", "note": "new"}
    header = headers_of(write_frame(tmp_path / "out.exr", frame, keep=True))[""]
    assert (header["owner"][1], header["note"][1], header["render:owner"][1]) == (b"me", b"new",
                                                                                  b"studio")


def test_without_keep_there_is_only_the_picture(tmp_path: Path) -> None:
    out = write_frame(tmp_path / "out.exr", processed(write_mixed(tmp_path / "in.exr")))
    assert {name for _, name in channel_hashes(out)} == set(PICTURE)


def test_a_source_that_lost_pixels_leaves_no_output(tmp_path: Path) -> None:
    source = write_studio(tmp_path)
    frame = processed(source)
    source.write_bytes(source.read_bytes()[:-40])
    with pytest.raises(ReadError, match=r"studio\.exr: broken file: it ends early; render or copy"):
        write_frame(tmp_path / "new/out.exr", frame, keep=True)
    assert list((tmp_path / "new").iterdir()) == []


def test_pixels_that_broke_since_the_frame_was_read_are_told(tmp_path: Path) -> None:
    source = write_mixed(tmp_path / "in.exr", "ZIP")
    frame = processed(source)
    with ExrContainer(source) as file:
        last = file.chunks(0)[-1]
    content = bytearray(source.read_bytes())
    content[last.at + last.head : last.at + last.head + last.size] = bytes(last.size)
    source.write_bytes(content)
    with pytest.raises(ReadError, match=r"in\.exr: broken file: .*; render or copy this frame"):
        write_frame(tmp_path / "out.exr", frame, keep=True)
    assert not (tmp_path / "out.exr").exists()



@pytest.mark.parametrize("scale", [1, 2])
def test_a_file_with_a_damaged_kept_part_is_not_complete(tmp_path: Path, scale: int) -> None:
    out, frame = keep(write_studio(tmp_path), scale)
    size = frame.spec.width, frame.spec.height
    assert is_complete(out, *size)
    out.write_bytes(out.read_bytes()[:-10])
    assert not is_complete(out, *size)


def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    source = write_mixed(tmp_path / "in.exr")
    first, _ = keep(source)
    before = first.read_bytes()
    assert b"capDate" not in before
    assert keep(source)[0].read_bytes() == before


def test_the_command_line_keeps_all_or_none(postfx, shot, tmp_path: Path) -> None:
    source = shot(1) / "shot.0001.exr"
    told = postfx("in/", "-o", "out/", "--explain")
    assert "keeps   7 other channels bit for bit (--keep none leaves them out)" in told.out
    assert postfx("in/", "-o", "out/").code == 0
    assert (untouched(channel_hashes(tmp_path / "out/shot.0001.exr"))
            == untouched(channel_hashes(source)))
    told = postfx("in/", "-o", "none/", "--keep", "none", "--explain")
    assert ("keeps" not in told.out
            and "keeps" not in postfx("in/", "-o", "a.####.png", "--explain").out)
    assert postfx("in/", "-o", "none/", "--keep", "none").code == 0
    assert not untouched(channel_hashes(tmp_path / "none/shot.0001.exr"))


def test_what_stays_in_the_pictures_part_gets_one_of_its_own_beside_other_compressions(
    tmp_path: Path
) -> None:
    frame = processed(write_mixed(tmp_path / "in.exr"))
    before = untouched(channel_hashes(tmp_path / "in.exr"))
    for compression in ("dwaa:45", "piz"):
        out = write_frame(tmp_path / "out.exr", frame, keep=True, compression=compression)
        assert untouched(channel_hashes(out)) == before
        assert str(oiio.ImageBuf(str(out)).spec()["compression"]).startswith(compression[:3])
        (again,) = read_sequence(out)
        np.testing.assert_allclose(again[Role.COLOUR], frame[Role.COLOUR], rtol=0.1, atol=0.1)


@pytest.mark.parametrize("several", [False, True], ids=["one part", "a part for each layer"])
def test_light_groups_take_the_place_of_their_own(tmp_path: Path, several: bool) -> None:
    """Every name once, each in the part where it was, as programs that look for it expect."""
    light = picture()
    layers = {"ViewLayer.Combined": "RGBA", "ViewLayer.Combined_key": "RGB", "ViewLayer.Mist": "Z"}
    held = {layer: {f"{layer}.{letter}": light["R"] * (0.5 if "key" in layer else 1)
                    for letter in letters}
            for layer, letters in layers.items()}
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, channels, layer)
             for layer, channels in held.items()]
    one = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {key: value for each in held.values()
                                                          for key, value in each.items()}, "all")]
    OpenEXR.File(parts if several else one).write(str(tmp_path / "in.exr"))
    (frame,) = read_sequence(tmp_path / "in.exr", aov="key")
    (name,) = frame.parts
    half = dataclasses.replace(
        frame, planes={Role.COLOUR: frame[Role.COLOUR] / 2}, parts={name: frame.parts[name] / 2})
    out = write_frame(tmp_path / "out.exr", half, keep=True)
    before, after = (OpenEXR.File(str(path), separate_channels=True).parts
                     for path in (tmp_path / "in.exr", out))
    assert [(part.name(), sorted(part.channels)) for part in after] == [
        (part.name(), sorted(part.channels)) for part in before]
    for one, other in zip(before, after, strict=True):
        for key, channel in one.channels.items():
            factor = 0.5 if key[-1] in "RGB" else 1
            np.testing.assert_allclose(other.channels[key].pixels, channel.pixels * factor,
                                       rtol=1e-3, err_msg=key)


def test_the_command_line_keeps_nothing_beside_a_larger_picture_but_when_asked(
    shot, tmp_path: Path
) -> None:
    source = str(shot(1) / "shot.0001.exr")

    def told(*words: str) -> tuple[str, list[Skip]]:
        arguments = make_parser().parse_args(["run", source, "-o", str(tmp_path / "out/"), *words])
        with read_sequence(source).open(1) as files:
            return explain_kept(arguments, files, (2 * WIDTH, 2 * HEIGHT))

    line, left_out = told()
    assert (line == "" and str(left_out[0].what) == "7 other channels" and "--keep all enlarges "
            "them" in left_out[0].why)
    assert told("--keep", "all") == (
        "keeps   7 other channels, enlarged by the nearest pixel, without the render's own colour",
        [])
    assert told("--keep", "none") == ("", [])


@pytest.mark.parametrize("names", [("rgba.right", "rgba.left"), ("right", "left")])
def test_both_views_one_after_the_other(tmp_path: Path, names: tuple[str, str]) -> None:
    """The second run is given the output of the first."""
    views = [picture(seed=1), picture(seed=2)]
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage, "view": view}, dict(channels), name)
             for view, channels, name in zip(("right", "left"), views, names, strict=True)]
    OpenEXR.File(parts).write(str(tmp_path / "in.exr"))
    path = tmp_path / "in.exr"
    for view in ("right", "left"):
        (frame,) = read_sequence(path, view=view)
        darker = {role: plane * np.float32(0.5) for role, plane in frame.planes.items()}
        path = write_frame(tmp_path / f"{view}.exr", dataclasses.replace(frame, planes=darker),
                           keep=True)
    found = OpenEXR.File(str(path), separate_channels=True).parts
    assert [part.name() for part in found] == [*names]
    for part, before in zip(found, views, strict=True):
        for name, plane in before.items():
            np.testing.assert_array_equal(part.channels[name].pixels, plane * np.float16(0.5))


@pytest.mark.parametrize("place", [0, 1, 2])
def test_other_primaries_leave_a_file_that_openexr_opens(tmp_path: Path, place: int) -> None:
    """It has them once, so that all parts say them, whichever holds the picture."""
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage},
                          {f"{name}.Combined.{letter}": plane
                           for letter, plane in picture(seed=seed).items()}, f"{name}.Combined")
             for seed, name in enumerate(("Back", "Main", "Front"))]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    name = ("Back", "Main", "Front")[place]
    assert main(["run", str(tmp_path / "a.exr"), "-o", str(tmp_path / "out.exr"), "--model", "s",
                 "--layer", name, "--colourspace", "acescg"]) == 0
    written = OpenEXR.File(str(tmp_path / "out.exr"), separate_channels=True).parts
    assert [part.header["name"] for part in written] == ["Back.Combined", "Main.Combined",
                                                         "Front.Combined"]
    for other, (found, given) in enumerate(zip(written, parts, strict=True)):
        assert found.header["chromaticities"][0] == pytest.approx(0.713)
        light, noise = (part.channels[f"{given.name().split('.')[0]}.Combined.R"].pixels
                        for part in (found, given))
        assert np.array_equal(light, noise) == (other != place)
