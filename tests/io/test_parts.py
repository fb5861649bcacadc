"""Parts of the picture in files: found by profile or name, multiplied and divided as the renderer
does, written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.cli.main import main
from postfx.errors import MissingPlaneError, OptionError
from postfx.frame import Part, Role
from postfx.io.parts import find_sets, group_parts, parse_parts
from postfx.io.sequence import read_sequence
from tests.passes.denoise_frames import noisy

SIZE = 24, 32
BLENDER = Path(__file__).with_name("cycles-5.0004.exr")


def write(path: Path, layers: dict[str, np.ndarray]) -> Path:
    """A float EXR of layers; '' is the picture."""
    pixels = np.concatenate(list(layers.values()), axis=2).astype(np.float32)
    spec = oiio.ImageSpec(SIZE[1], SIZE[0], pixels.shape[2], oiio.FLOAT)
    letters = {3: "RGB", 2: "XY", 1: "V"}
    spec.channelnames = [f"{name}.{letter}" if name else letter
                         for name, plane in layers.items() for letter in letters[plane.shape[2]]]
    image = oiio.ImageOutput.create(str(path))
    assert image.open(str(path), spec) and image.write_image(pixels), image.geterror()
    image.close()
    return path


def read(path: Path) -> dict[str, np.ndarray]:
    """Every channel of all parts; of several of one name the first."""
    found: dict[str, np.ndarray] = {}
    image = oiio.ImageInput.open(str(path))
    part = 0
    while image.seek_subimage(part, 0):
        pixels = image.read_image(part, 0, 0, image.spec().nchannels, oiio.FLOAT)
        for i, name in enumerate(image.spec().channelnames):
            found.setdefault(name, pixels[..., i])
        part += 1
    image.close()
    return found


def picture_of(channels: dict[str, np.ndarray], scale: str) -> np.ndarray:
    """At the render's size the picture has the render's names."""
    return layer(channels, "ViewLayer.Combined" if scale == "1" else "")


def layer(channels: dict[str, np.ndarray], name: str) -> np.ndarray:
    return np.stack([channels[f"{name}.{letter}" if name else letter] for letter in "RGB"], axis=-1)


@pytest.fixture
def cycles(tmp_path: Path) -> Path:
    """A frame as Cycles stores it: light is divided by the colours of surfaces, two light groups,
    fog."""
    random = np.random.default_rng(0)
    light = {name: random.random((*SIZE, 3), np.float32) ** 3
             for name in ("dd", "di", "gd", "gi", "fog", "glow")}
    diffuse = 0.8 * random.random((*SIZE, 3), np.float32)
    glossy = np.full((*SIZE, 3), 0.04, np.float32)
    diffuse[:6] = 0  # nothing diffuse there: Cycles stores 0
    light["dd"][:6] = light["di"][:6] = 0
    picture = ((light["dd"] + light["di"]) * diffuse + (light["gd"] + light["gi"]) * glossy
               + light["fog"] + light["glow"])
    view = "ViewLayer."
    return write(tmp_path / "in.0001.exr", {
        f"{view}Combined": picture, f"{view}Diffuse Direct": light["dd"],
        f"{view}Diffuse Indirect": light["di"], f"{view}Diffuse Color": diffuse,
        f"{view}Glossy Direct": light["gd"], f"{view}Glossy Indirect": light["gi"],
        f"{view}Glossy Color": glossy, f"{view}Volume Direct": light["fog"],
        f"{view}Emission": light["glow"],
        f"{view}Combined_key": 0.75 * picture, f"{view}Combined_fill": 0.25 * picture,
        f"{view}Mist": random.random((*SIZE, 1), np.float32)})


def test_cycles_passes_are_found_multiplied_denoised_and_divided_again(cycles: Path,
                                                                       tmp_path: Path) -> None:
    sequence = read_sequence(str(cycles), aov="auto", aov_denoise="mist=Mist")
    with sequence.open(1) as files:
        kinds = {name.removeprefix("ViewLayer."): (found.part.kind, found.part.group)
                 for name, found in files.parts.items()}
    assert kinds == {
        "Combined_key": ("light", "light groups"), "Combined_fill": ("light", "light groups"),
        "Diffuse Direct": ("diffuse", "passes"), "Diffuse Indirect": ("diffuse", "passes"),
        "Diffuse Color": ("factor", ""), "Glossy Direct": ("specular", "passes"),
        "Glossy Indirect": ("specular", "passes"), "Glossy Color": ("factor", ""),
        "Volume Direct": ("scatter", "passes"),
        "Emission": ("emission", "passes"), "Mist": ("mist", "")}
    frame = sequence.read(1)
    np.testing.assert_allclose(sum(frame.parts[f"ViewLayer.{name}"]
                                   for name, (_, group) in kinds.items() if group == "passes"),
                               frame[Role.COLOUR], rtol=1e-5, atol=1e-6)
    for scale in ("2", "1"):
        output = tmp_path / f"out{scale}.0001.exr"
        assert main(["run", str(cycles), "-o", str(output), "--aov", "auto", "--aov-denoise",
                     "mist=Mist", "--scale", scale, "--model", "s", "--bits", "32"]) == 0
        found = read(output)
        picture = picture_of(found, scale)
        part = {name: layer(found, f"ViewLayer.{name}") for name in kinds if name != "Mist"}
        assert picture.shape[0] == int(scale) * SIZE[0] == found["ViewLayer.Mist.V"].shape[0]
        together = ((part["Diffuse Direct"] + part["Diffuse Indirect"]) * part["Diffuse Color"]
                    + (part["Glossy Direct"] + part["Glossy Indirect"]) * part["Glossy Color"]
                    + part["Volume Direct"] + part["Emission"])
        np.testing.assert_allclose(together, picture, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(part["Combined_key"] + part["Combined_fill"], picture, rtol=1e-3,
                                   atol=1e-5)
        assert part["Combined_key"].std() < 0.8 * (0.75 * frame[Role.COLOUR]).std()
        assert min(plane.min() for plane in part.values()) >= 0


@pytest.mark.parametrize(("words", "told"), [
    ((), True), (("--aov", "auto"), False), (("--strength", "0"), False),
    (("--scale", "2"), False), (("--scale", "2", "--keep", "all"), True),
    (("--keep", "none"), False), (("--tonemap", "agx"), True)])
def test_parts_that_stay_noisy_are_told(cycles: Path, tmp_path: Path, capsys, words, told) -> None:
    run = ["run", str(cycles), "-o", str(tmp_path / "out.0001.exr"), "--model", "s", "--explain"]
    assert main([*run, *words]) == 0
    found = capsys.readouterr().out
    assert ("Combined_key" in found and "more: kept as noisy as they are" in found) == told
    shown = "--tonemap" in words  # where --aov would be left out
    assert ("; --aov auto denoises them, too" in found) == (told and not shown)
    assert ("only scene-linear output has denoised ones" in found) == shown


def test_a_frame_of_blender_adds_up_by_groups_and_by_passes(tmp_path: Path) -> None:
    """Rendered by Cycles of Blender 5.0 at 2 samples a pixel: three lights, a world, fog, metal,
    plastic, glass, and a lamp. Reflections of glass cross into where nothing is of glass."""
    for scale in ("1", "2"):
        output = tmp_path / f"out{scale}.0004.exr"
        assert main(["run", str(BLENDER), "-o", str(output), "--aov", "auto", "--scale", scale,
                     "--model", "s", "--bits", "32"]) == 0
        found = read(output)
        picture = picture_of(found, scale)
        layers = [name.rpartition(".")[0] for name in found
                  if name.startswith("ViewLayer.") and name.endswith(".R")]
        part = {name.removeprefix("ViewLayer."): layer(found, name) for name in layers}
        groups = sum(part[f"Combined_{name}"] for name in ("key", "fill", "rim", "world"))
        passes = sum((part[f"{name} Direct"] + part[f"{name} Indirect"]) * part[f"{name} Color"]
                     for name in ("Diffuse", "Glossy", "Transmission"))
        passes = sum((part[name]
                      for name in ("Volume Direct", "Volume Indirect", "Emission", "Environment")),
                     passes)
        for total in (groups, passes):
            np.testing.assert_allclose(total, picture, rtol=1e-4, atol=1e-6)
        assert min(plane.min() for plane in part.values()) >= 0


def test_fireflies_are_clamped_in_the_picture_and_its_parts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    colour = np.full((*SIZE, 3), 0.5, np.float32)
    colour[5, 5], colour[9:11, 9] = (90, 30, 0), 40
    colour[20] = 40  # a line of light is no firefly
    path = write(tmp_path / "a.0001.exr", {"": colour, "key": 0.75 * colour, "fill": 0.25 * colour})
    plain, clamped = (read_sequence(str(path), aov="key,fill", clamp_fireflies=most)
                      for most in (None, 8))
    before, frame, count = plain.read(1), clamped.read(1), clamped.fireflies
    np.testing.assert_array_equal(before[Role.COLOUR], colour)
    most = 8 * colour.max(axis=2).mean()
    np.testing.assert_allclose(frame[Role.COLOUR][5, 5], (most, most / 3, 0), rtol=1e-5)
    np.testing.assert_allclose(frame[Role.COLOUR][9:11, 9], most, rtol=1e-5)
    np.testing.assert_array_equal(frame[Role.COLOUR][20], colour[20])
    np.testing.assert_allclose(frame.parts["key"] + frame.parts["fill"], frame[Role.COLOUR],
                               rtol=1e-6)
    assert count.pixels == 3 and count.frames == 1
    assert abs(count.share - (colour - frame[Role.COLOUR]).sum() / colour.sum()) < 1e-6
    run = ["run", str(path), "-o", str(tmp_path / "b.0001.exr"), "--model", "s", "--scale", "1",
           "--clamp-fireflies"]
    assert main([*run, "8"]) == 0
    assert (f"clamped  3 pixels in 1 frame: {count.share:.2%} of the light was "
            "taken" in capsys.readouterr().err)
    assert main([*run, "0.5"]) == 2
    assert "--clamp-fireflies 0.5: give a number above 1" in capsys.readouterr().err


def test_groups_by_name_and_what_is_not_there(cycles: Path) -> None:
    with read_sequence(str(cycles), aov="key, Combined_fill").open(1) as files:
        assert set(files.parts) == {"ViewLayer.Combined_key", "ViewLayer.Combined_fill"}
        assert files.parts["ViewLayer.Combined_key"].part.group == "light groups"
    with pytest.raises(MissingPlaneError,
                       match=r"in.0001.exr: no layer 'rim' for --aov: it holds \S*Combined_"):
        read_sequence(str(cycles), aov="rim").open(1)


def test_distances_are_written_as_floats_and_an_unknown_layer_is_named_with_its_option(
    tmp_path: Path
) -> None:
    """Half floats hold no 1e10, which stands for no distance, and only some of the others."""
    colour = noisy(1, *SIZE)[Role.COLOUR]
    depth = np.where(np.arange(SIZE[1])[:, None] < 8, 1e10,
                     1000.3).astype(np.float32) * np.ones((*SIZE, 1), np.float32)
    path = write(tmp_path / "a.0001.exr", {"": colour, "far": depth})
    output = tmp_path / "b.0001.exr"
    run = ["run", str(path), "-o", str(output), "--model", "s", "--scale", "1", "--aov-denoise"]
    assert main([*run, "depth=far"]) == 0
    found = read(output)["far.V"]
    assert (found[:, :6] == np.float32(1e10)).all() and np.abs(found[:, 10:] - 1000.3).max() < 1e-2
    with pytest.raises(MissingPlaneError,
                       match=r"no layer 'near' for --aov-denoise depth=near: it holds"):
        read_sequence(str(path), aov_denoise="depth=near").open(1)


@pytest.mark.parametrize("options", [
    ("--aov", "a,b"), ("--aov", "b,B,a"), ("--aov", "a", "--aov-denoise", "albedo=b"),
    ("--aov", "a,B", "--aov-denoise", "albedo=b")])
def test_layers_named_as_channels_of_the_picture_are_one_part_each(
        tmp_path: Path, options: tuple[str, ...]) -> None:
    # names count in any case: the channel B is also a layer, whose channels would be those of b
    half = np.full((*SIZE, 3), 0.5, np.float32)
    source = write(tmp_path / "in.0001.exr", {"": 2 * half, "a": half, "b": half})
    assert main(["run", str(source), "-o", str(tmp_path / "out.exr"), "--model", "s",
                 *options]) == 0
    found = read(tmp_path / "out.exr")
    for name in "ab":
        assert layer(found, name) == pytest.approx(half, abs=5e-3)


def test_plain_layers_are_light_by_name(tmp_path: Path) -> None:
    frame = noisy(1, *SIZE)
    path = write(tmp_path / "a.exr", {"": frame[Role.COLOUR], "key": 0.5 * frame[Role.COLOUR]})
    read_frame = read_sequence(str(path), aov="key").read(1)
    np.testing.assert_array_equal(read_frame.parts["key"], 0.5 * frame[Role.COLOUR])
    with pytest.raises(MissingPlaneError, match="no layer 'fill' for --aov: it holds"):
        read_sequence(str(path), aov="fill").open(1)


def test_a_run_goes_on_where_auto_finds_no_parts_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = write(tmp_path / "a.exr", {"": noisy(1, *SIZE)[Role.COLOUR]})
    files = [tmp_path / "auto.exr", tmp_path / "plain.exr"]
    for out, options in zip(files, (("--aov", "auto"), ()), strict=True):
        assert main(["run", str(source), "-o", str(out), "--model", "s", *options]) == 0
    assert capsys.readouterr().err.count("warning  --aov auto: the files hold no light groups") == 1
    auto, plain = map(read, files)
    np.testing.assert_array_equal(layer(auto, ""), layer(plain, ""))


@pytest.mark.parametrize(("text", "message"), [
    ("glow=N", "KIND one of albedo, normal, position, depth, mist, shadow, ao"),
    ("normal", "give KIND=LAYER"),
    ("mist=CryptoObject00", "holds ids"), ("mist=object.id", "holds ids")])
def test_kinds_are_checked_and_ids_are_never_filtered(text: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        parse_parts(None, text)


def test_ids_are_no_light_either(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="--aov CryptoObject00: 'CryptoObject00' holds ids"):
        parse_parts("key,CryptoObject00", None)
    colour = noisy(1, *SIZE)[Role.COLOUR]
    path = write(tmp_path / "a.exr",
                 {"": colour, "Cryptos.uCryptoAsset00": colour, "Crypto_00": colour})
    for aov, planes in (("00", None), (None, "mist=00")):
        with pytest.raises(OptionError, match="'Crypto_00' holds ids"):
            read_sequence(str(path), aov=aov, aov_denoise=planes).open(1)


def test_pictures_for_a_display_have_no_parts(cycles: Path, tmp_path: Path,
                                              capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(cycles), "-o", str(tmp_path / "a.0001.png"), "--aov", "auto",
                 "--explain"]) == 0
    assert "light groups and passes: they are scene-linear" in capsys.readouterr().out
    assert main(["run", str(cycles), "--aov", "key", "--explain"]) == 0
    assert "parts   ViewLayer.Combined_key" in capsys.readouterr().out


@pytest.mark.parametrize("words", [
    ("--fast-look",), ("--no-tonemap",), ("--preset", "preview"), ("--fast-look", "--no-tonemap")])
def test_options_of_pictures_leave_the_groups_of_scene_linear_files_alone(
    cycles: Path, tmp_path: Path, words: tuple[str, ...]
) -> None:
    plain, found = tmp_path / "plain.exr", tmp_path / "found.exr"
    run = ["run", str(cycles), "--aov", "auto", "--model", "s", "--run-up", "0"]
    assert main([*run, "-o", str(plain)]) == 0
    assert main([*run, "-o", str(found), *words]) == 0
    expected, denoised = read(plain), read(found)
    assert expected.keys() == denoised.keys()
    for name, plane in expected.items():
        np.testing.assert_array_equal(denoised[name], plane, err_msg=name)


def test_parts_add_up_to_the_picture_of_both_ways(tmp_path: Path) -> None:
    for number in (1, 2, 3):
        frame = noisy(number, *SIZE)
        light = {"": frame[Role.COLOUR], "key": 0.75 * frame[Role.COLOUR],
                 "fill": 0.25 * frame[Role.COLOUR]}
        write(tmp_path / f"a.{number:04d}.exr", light | {"motion": frame[Role.MOTION]})
    run = ["run", str(tmp_path / "a.####.exr"), "--model", "s", "--scale", "1", "--bits", "32",
           "--aov", "key,fill"]
    assert main([*run, "-o", str(tmp_path / "b.####.exr"), "--both-ways"]) == 0
    assert main([*run, "-o", str(tmp_path / "c.####.exr"), "--run-up", "0"]) == 0
    found, ahead = read(tmp_path / "b.0001.exr"), read(tmp_path / "c.0001.exr")
    np.testing.assert_allclose(layer(found, "key") + layer(found, "fill"), layer(found, ""),
                               rtol=1e-4, atol=1e-6)
    assert np.abs(layer(found, "") - layer(ahead, "")).mean() > 1e-3


@pytest.fixture
def two_splits() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """A picture, and its light by lamp and by surface."""
    rng = np.random.default_rng(1)
    key, fill = rng.random((2, 32, 40, 3)).astype(np.float32)
    picture = key + fill
    return picture, {"key": key, "diffuse": 0.7 * picture, "fill": fill, "specular": 0.3 * picture}


def test_sets_that_each_add_up_to_the_picture_are_found(two_splits):
    picture, parts = two_splits
    assert find_sets(picture, parts) == [("key", "fill"), ("diffuse", "specular")]
    assert find_sets(picture, {"whole": picture, **parts})[0] == ("whole",)
    assert find_sets(picture, {"key": parts["key"], "diffuse": parts["diffuse"]}) == []


def test_layers_that_are_too_bright_together_are_grouped_by_sets_and_what_is_left_is_named(
    two_splits
):
    picture, pixels = two_splits
    parts = [Part(name, "light", "named") for name in pixels]
    grouped, (note,) = group_parts(parts, picture, pixels)
    assert [part.group for part in grouped] == ["key,fill", "diffuse,specular", "key,fill",
                                                "diffuse,specular"]
    assert (note == "layers key, fill and diffuse, specular each add up to the picture: they are "
            "taken as 2 sets")
    more, glow = pixels | {"glow": 2 * picture}, Part("glow", "light", "named")
    grouped, notes = group_parts([*parts, glow], picture, more)
    assert grouped[-1].group == "glow" and len({part.group for part in grouped}) == 3
    assert (notes[1] == "layers glow do not add up to the picture with others: each is filtered on "
            "its own")


def test_a_part_brighter_than_the_picture_and_light_below_0_are_told(two_splits):
    picture, pixels = two_splits
    glow, dark = Part("glow", "light", "named"), Part("dark", "light", "named")
    (grouped,), (note,) = group_parts([glow], picture, {"glow": 2 * picture})
    assert grouped.group == "glow"
    assert (note == "layers glow do not add up to the picture with others: each is filtered on its "
            "own")
    darkened = {"key": picture + 0.1, "dark": np.full_like(picture, -0.1)}
    parts = (Part("key", "light", "named"), dark)
    note = "layers dark have light below 0: it is denoised apart, and stays"
    assert group_parts(parts, picture, darkened) == (parts, [note])
    rounded = {"key": picture, "dark": np.full_like(picture, -1e-7)}
    assert group_parts(parts, picture, rounded) == (parts, [])


def test_some_parts_of_the_picture_stay_one_group_in_silence(two_splits):
    picture, pixels = two_splits
    for names in (("key",), ("key", "fill"), ("diffuse", "specular")):
        parts = tuple(Part(name, "light", "named") for name in names)
        assert group_parts(parts, picture, pixels) == (parts, [])
