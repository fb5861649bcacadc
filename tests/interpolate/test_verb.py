"""`postfx interpolate`: files in, files out."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx import read_sequence, write_frame
from postfx.cli.interpolate import with_cryptomattes, with_parts
from postfx.cli.main import main
from postfx.frame import Frame, PartSource, Role
from tests.interpolate.conftest import picture

OTHER = np.random.default_rng(1).random((9, 14, 3), np.float32).repeat(8, 0).repeat(8, 1)
FACTS = {"framesPerSecond": 24.0, "timeCode": (0x01000000, 0)}


@pytest.fixture
def shot(scene, tmp_path):
    """Writes frames 1 to 4 of the scene, without those left out; from `cut` on they show something
    else."""

    def write(left_out: tuple[int, ...] = (), cut: int = 9) -> str:
        for number in {1, 2, 3, 4} - set(left_out):
            frame = replace(scene(number - 1), metadata=dict(FACTS))
            if number >= cut:
                frame = replace(frame, planes={**frame.planes, Role.COLOUR: OTHER,
                                               Role.DEPTH: 3 * OTHER[..., :1]})
            write_frame(tmp_path / f"in/shot.{number:04d}.exr", with_parts(frame))
        return str(tmp_path / "in/shot.####.exr")

    return write


def test_numbers_rates_time_codes_and_planes_of_a_sequence(shot, scene, tmp_path, capsys):
    pytest.importorskip("flip_evaluator", reason="--reference needs the extra 'bench'")
    reference = tmp_path / "rendered"
    for count in range(7):
        write_frame(reference / f"shot.{count + 1:04d}.exr", replace(scene(0), planes={
            Role.COLOUR: picture(count / 2)[0]}), bits=32)
    assert main(["interpolate", shot(), "-o", f"{tmp_path}/out/", "--planes", "--json",
                 "--reference", str(reference)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["kept"], found["made"], found["repeated"], found["skipped"]) == (4, 3, {}, {})
    assert found["intervals"] == {"0.5": 6}
    assert list(found["psnr"]) == ["2", "4", "6"] and min(found["psnr"].values()) > 30
    frames = list(read_sequence(f"{tmp_path}/out/"))
    assert [frame.number for frame in frames] == [1, 2, 3, 4, 5, 6, 7]
    assert [frame.metadata["timeCode"][0] & ~(1 << 15) for frame in frames] == [
        0x01000000, 0x01000000, 0x01000001, 0x01000001, 0x01000002, 0x01000002, 0x01000003]
    assert {frame.metadata["framesPerSecond"] for frame in frames} == {48.0}
    np.testing.assert_array_equal(frames[2][Role.COLOUR], scene(1)[Role.COLOUR],
                                  "a frame of the input, in floats")
    np.testing.assert_allclose(frames[2][Role.MOTION], scene(1, step=0.5)[Role.MOTION], atol=1e-5)
    assert np.abs(frames[3][Role.DEPTH] - scene(1.5)[Role.DEPTH]).mean() < 0.1


def test_a_cut_repeats_and_a_hole_leaves_out_with_a_reason(shot, tmp_path, capsys):
    assert (main(["interpolate", shot(left_out=(2,), cut=4), "-o", f"{tmp_path}/out/", "--json"])
            == 3)
    told = capsys.readouterr()
    found = json.loads(told.out)
    missing = "left out, as frame 2 of the input is missing"
    assert found["skipped"] == {"2": missing, "3": missing, "4": missing}
    assert found["repeated"] == {"6": "repeats frame 4, as another shot begins"}
    assert found["intervals"] == {"2.0": 1, "1.0": 1,
                                  "0.0": 1}, "over the hole, over the cut, and a repeated frame"
    assert f"frame 4: {missing}\n" in told.err
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        f"shot.{number:04d}.exr" for number in (1, 5, 6, 7)]


def test_numbers_apart_are_told_as_they_are_understood(shot, tmp_path, capsys):
    words = ["interpolate", shot(left_out=(2, 4)), "-o", f"{tmp_path}/out/"]
    assert main(words) == 0
    told = capsys.readouterr()
    assert told.err.splitlines()[0] == (
        "frames 1,3: 2 apart, taken to follow each other; if frames between them are missing, give "
        "--frames=1-3")
    assert "2 frames of" in told.out
    assert main([*words, "--frames=1-3", "--overwrite"]) == 3
    told = capsys.readouterr()
    assert "follow each other" not in told.err and "as frame 2 of the input is missing" in told.err


def test_given_overlays_are_put_over_all_frames(shot, tmp_path):
    overlay = np.zeros((72, 112, 4), np.float32)
    overlay[4:12, 4:40] = 3.0, 2.0, 1.0, 1.0
    for number in range(1, 4):
        planes = {Role.COLOUR: np.zeros((72, 112, 3)), Role.OVERLAY: overlay * number / 3}
        write_frame(tmp_path / f"hud/hud.{number:04d}.exr", Frame(planes))
    assert main(["interpolate", shot(), "--frames", "1-2", "-o", f"{tmp_path}/out/", "--bits", "32",
                 "--overlays", f"{tmp_path}/hud/hud.####.exr"]) == 0
    last = read_sequence(f"{tmp_path}/out/").read(3)
    np.testing.assert_allclose(last[Role.COLOUR][4:12, 4:40],
                               np.broadcast_to(np.float32([3, 2, 1]), (8, 36, 3)), atol=1e-3)


@pytest.mark.parametrize(("options", "message"), [
    (["-o", "out/f.####.png"], "is for a display: write EXR"), ([], "give -o OUTPUT"),
    (["-o", "in/shot.####.exr"], "would be a frame of the input|is an input"),
    (["-o", "out/", "--frames", "2"], "one frame is not enough"),
    (["-o", "out/", "--frames", "5-8"], "there are frames 1-4, none of 5-8: give --frames"),
    (["-o", "out/", "--overlays", "x", "--composited"], "leave --composited out")])
def test_what_cannot_be_is_one_line(shot, tmp_path, options, message, monkeypatch, capsys):
    shot()
    monkeypatch.chdir(tmp_path)
    assert main(["interpolate", "in/shot.####.exr", *options]) == 2
    error = capsys.readouterr().err
    assert (re.search(message, error) and error.count("\n") == 1
            and Path("in/shot.0004.exr").is_file())


def test_references_of_another_size_are_refused(shot, tmp_path, capsys):
    """The first frame, which needs none, is there by then."""
    write_frame(tmp_path / "true.0002.exr",
                Frame({Role.COLOUR: np.ones((24, 32, 3), np.float32)}, 2))
    words = ["interpolate", shot(), "-o", f"{tmp_path}/out/"]
    assert main([*words, "--reference", f"{tmp_path}/true.####.exr"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("error: ") and error.endswith(
        f"true.####.exr: references are 32x24, the frames {OTHER.shape[1]}x{OTHER.shape[0]}: give "
        "them at the frames' size")


def test_cryptomattes_come_from_the_nearest_pixel_bit_for_bit(scene, tmp_path):
    """The disc and the wall have ids that no mean of the two could have."""
    disc, ground = np.array([0x3F8ABCDE, 0x4B123457], np.uint32).view(np.float32)
    about = {"cryptomatte/abc1234/name": "CryptoObject",
             "cryptomatte/abc1234/hash": "MurmurHash3_32",
             "cryptomatte/abc1234/conversion": "uint32_to_float32",
             "cryptomatte/abc1234/manifest": "{}"}
    for number in (1, 2):
        there = picture(number - 1)[1][..., None]
        ranks = {"R": np.where(there, disc, ground), "G": np.ones_like(there, np.float32),
                 "B": np.zeros_like(there, np.float32), "A": np.zeros_like(there, np.float32)}
        names = {f"CryptoObject00.{letter}": plane for letter, plane in ranks.items()}
        frame = with_parts(replace(scene(number - 1), metadata=dict(FACTS)))
        frame = replace(frame, parts={**frame.parts, **names}, part_sources={
            **frame.part_sources, **{name: PartSource((name,), exact=True) for name in names}})
        write_frame(tmp_path / f"in/a.{number:04d}.exr", frame, provenance=about)
    assert main(["interpolate", f"{tmp_path}/in/", "-o", f"{tmp_path}/out/", "--planes"]) == 0
    made = with_cryptomattes(read_sequence(f"{tmp_path}/out/").read(2))
    ids = made.parts["CryptoObject00.R"][..., 0].view(np.uint32)
    assert set(np.unique(ids)) == {0x3F8ABCDE, 0x4B123457}
    assert ((ids == 0x3F8ABCDE) == picture(0.5)[1]).mean() > 0.99
    assert made.metadata["cryptomatte/abc1234/name"] == "CryptoObject"


def write_groups(scene, folder: Path, key_light: tuple[float, ...] = (1, 1, 1)) -> str:
    """Frames whose picture is the sum of two light groups, one of which may change, beside ids."""
    ramp = np.linspace(0, 1, 112, dtype=np.float32)[None, :, None]
    for number, light in enumerate(key_light, 1):
        frame = scene(number - 1)
        parts = {"key": frame[Role.COLOUR] * ramp * np.float32(light),
                 "fill": frame[Role.COLOUR] * (1 - ramp),
                 "id": np.ones((72, 112, 1), np.float32)}
        sources = {name: PartSource(tuple(f"{name}.{letter}" for letter in letters))
                   for name, letters in (("key", "RGB"), ("fill", "RGB"), ("id", "V"))}
        planes = {**frame.planes, Role.COLOUR: parts["key"] + parts["fill"]}
        write_frame(folder / f"in/a.{number:04d}.exr", with_parts(replace(
            frame, planes=planes, parts=parts, part_sources=sources)), bits=32)
    return f"{folder}/in/"


def test_frames_that_were_not_asked_for_are_no_cut(write_exr, tmp_path, capsys):
    for number in (1, 2, 3):
        planes = {name: np.full((32, 48), 0.1 * number) for name in "RGB"}
        write_exr(f"in/a.{number:04d}.exr", planes)
    words = ["interpolate", str(tmp_path / "in"), "-o", f"{tmp_path}/out/", "--frames", "1,3"]
    assert main(words) == 0
    printed = capsys.readouterr()
    assert "as frames 1 and 3 do not follow each other" in printed.err
    assert "s a new frame" not in printed.out
    assert main(words) == 2
    told = capsys.readouterr().err
    assert "is already there: give --overwrite" in told and "--skip-existing" not in told


def test_jittered_frames_are_told_to_be_denoised_first(write_exr, tmp_path, capsys):
    for number in (1, 2):
        planes = {name: np.full((32, 48), 0.1 * number) for name in "RGB"}
        write_exr(f"in/a.{number:04d}.exr", planes, postfx__jitter=(0.25, -0.25))
    assert main(["interpolate", str(tmp_path / "in"), "-o", f"{tmp_path}/out/"]) == 0
    assert "frames are jittered, and new ones between them are not" in capsys.readouterr().out


@pytest.mark.parametrize("more", [[], ["--planes"]])
def test_layers_that_new_frames_lack_are_told(scene, tmp_path, capsys, more):
    source = write_groups(scene, tmp_path)
    assert main(["interpolate", source, "-o", f"{tmp_path}/out/", *more]) == 0
    assert "new frames lack fill.R,G,B; id.V; key.R,G,B: --aov NAMES" in " ".join(
        capsys.readouterr().out.split())
    assert main(["interpolate", source, "-o", f"{tmp_path}/out/", "--overwrite", "--json",
                 "--aov", "key,fill", *more]) == 0
    assert [one for one in json.loads(capsys.readouterr().out)["warnings"] if "lack" in one] == [
        "new frames lack id.V: --aov NAMES makes those of light"
        + ", --planes Cryptomattes, nothing the others" * (not more)]


def test_light_groups_of_new_frames_add_up_to_the_picture(scene, tmp_path):
    """Also where the light of one of them changes."""
    source = write_groups(scene, tmp_path, (1, 4, 4))
    assert main(["interpolate", source, "-o", f"{tmp_path}/out/", "--aov", "key,fill",
                 "--bits", "32"]) == 0
    ramp = np.linspace(0, 1, 112, dtype=np.float32)[None, :, None]
    for number, time, light in ((2, 0.5, 2.5), (3, 1.0, 4.0), (4, 1.5, 4.0)):
        found = read_sequence(f"{tmp_path}/out/", aov="key,fill").read(number)
        np.testing.assert_allclose(found.parts["key"] + found.parts["fill"], found[Role.COLOUR],
                                   rtol=1e-4, atol=1e-4)
        wanted = picture(time)[0] * ramp * light
        apart = np.abs(np.log2(found.parts["key"][8:-8, 16:-8] / wanted[8:-8, 16:-8]))
        assert apart.mean() < 0.1


def test_both_eyes_are_interpolated(scene, tmp_path):
    for number in (1, 2):
        for view, shift in (("left", 0.0), ("right", 0.5)):
            frame = replace(scene(number - 1 + shift), metadata=dict(FACTS))
            write_frame(tmp_path / f"in/{view}.{number:04d}.exr", with_parts(frame))
    assert main(["interpolate", f"{tmp_path}/in/{{view}}.####.exr", "-o",
                 f"{tmp_path}/out/{{view}}.####.exr"]) == 0
    for view, t in (("left", 0.5), ("right", 1.0)):
        found = read_sequence(f"{tmp_path}/out/{view}.####.exr").read(2)
        inner = np.s_[8:-8, 8:-8]
        assert np.abs(np.log2(found[Role.COLOUR]) - np.log2(picture(t)[0]))[inner].mean() < 0.1
        assert found.metadata["framesPerSecond"] == 48.0


@pytest.mark.soak
def test_a_shutter_blurs_as_the_mean_of_rendered_times_does(shot, tmp_path):
    """Half of 360 degrees, twice as many frames: open for a quarter of the time between two frames
    of the input."""
    assert main(["interpolate", shot(), "-o", f"{tmp_path}/out/", "--shutter", "180", "--frames",
                 "1-3", "--no-flow"]) == 0
    sharp, errors = {}, {}
    for number, t in ((3, 1.0), (4, 1.5)):
        wanted = np.mean([picture(t + 0.25 * ((k + 0.5) / 32 - 0.5))[0] for k in range(32)], 0)
        found = read_sequence(f"{tmp_path}/out/").read(number)[Role.COLOUR]
        errors[t], sharp[t] = (np.abs(one - wanted)[8:-8, 8:-8].mean()
                               for one in (found, picture(t)[0]))
    assert errors[1.0] < 0.35 * sharp[1.0] and errors[1.5] < 0.6 * sharp[1.5]


def test_what_reading_notices_is_told(shot, tmp_path, capsys):
    """A file that is taken for none of the sequence; nothing was said of it, nor of views that are
    not read."""
    pattern = shot()
    (tmp_path / "in/shot.05.exr").write_bytes((tmp_path / "in/shot.0004.exr").read_bytes())
    arguments = ["interpolate", pattern, "-o", f"{tmp_path}/out/", "--overwrite"]
    assert main([*arguments, "--json"]) == 0
    (warning,) = json.loads(capsys.readouterr().out)["warnings"]
    assert "shot.05.exr" in warning
    assert main(arguments) == 0
    assert f"warning  {warning}" in capsys.readouterr().out
