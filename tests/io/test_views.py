"""All views of stereo files in one run: each with a history of its own, written where its render
was."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from postfx import DenoiseUpscale, Pipeline, RunUp, read_sequence, write_frame
from postfx.cli.main import main
from postfx.errors import FrameError, MissingPlaneError, SequenceError, WriteError
from postfx.frame import Frame, Role
from postfx.passes.registry import create
from postfx.temporal.reverse_order import Backwards

WIDTH, HEIGHT = 24, 20
HALF = np.float32(0.5)
WORDS = ("red", "green", "blue", "alpha")


def picture(seed: int, names: str = "RGBA") -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.random((HEIGHT, WIDTH), np.float32).astype(np.float16) for name in names}


def named(layer: str, channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {f"{layer}.{name}": plane for name, plane in channels.items()}


def layouts(left: dict[str, np.ndarray],
            right: dict[str, np.ndarray]) -> dict[str, list[tuple[str, str, dict]]]:
    """Kinds of stereo files: name, view and channels of each part; a lone one lists its views."""
    left_rgba, right_rgba = ({name: eye[name] for name in "RGBA"} for eye in (left, right))
    left_rest, right_rest = ({"Z": eye["Z"]} for eye in (left, right))
    return {
        "layers of one part": [("", "", left | named("right", right))],
        "parts with a view": [("rgba_left", "left", left_rgba), ("depth_left", "left", left_rest),
                              ("rgba_right", "right", right_rgba),
                              ("depth_right", "right", right_rest)],
        "views in names": [("rgba.left", "", left_rgba), ("depth.left", "", left_rest),
                           ("rgba.right", "", right_rgba), ("depth.right", "", right_rest)],
        "parts named after views": [("left", "", left), ("right", "", right)],
        "red, green, blue": [(f"rgba.{view}", "", dict(zip(WORDS, eye.values(), strict=True)))
                             for view, eye in (("left", left_rgba), ("right", right_rgba))],
        "Blender": [(f"VL.Combined.{view}", view, named(f"VL.Combined.{view}", eye))
                    for view, eye in (("left", left_rgba), ("right", right_rgba))],
    }


KINDS = tuple(layouts(picture(0, "RGBAZ"), picture(1, "RGBAZ")))


def write(path: Path, parts: list[tuple[str, str, dict]], **header: object) -> Path:
    alone = {"multiView": ["left", "right"]} if len(parts) == 1 else {}
    OpenEXR.File([OpenEXR.Part(
        {"type": OpenEXR.scanlineimage, **alone, **header, **({"view": view} if view else {})},
        dict(channels), name
    ) for name, view, channels in parts]).write(str(path))
    return path


def channels_of(path: Path) -> list[tuple[str, str | None, dict[str, np.ndarray]]]:
    return [(part.name(), part.header.get("view"),
             {name: one.pixels for name, one in part.channels.items()})
            for part in OpenEXR.File(str(path), separate_channels=True).parts]


def darken(frame: Frame) -> Frame:
    dark = {role: frame[role] * HALF for role in (Role.COLOUR, Role.ALPHA)}
    views = {name: darken(view) for name, view in frame.views.items()}
    return dataclasses.replace(frame, planes=frame.planes | dark, views=views)


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_take_the_place_of_their_renders(tmp_path: Path, kind: str) -> None:
    left, right = picture(1, "RGBAZ"), picture(2, "RGBAZ")
    path = write(tmp_path / "in.exr", layouts(left, right)[kind])
    sequence = read_sequence(path, view="all")
    (frame,) = sequence
    assert list(frame.views) == ["right"] and not sequence.warnings
    np.testing.assert_array_equal(frame.views["right"][Role.COLOUR][..., 0], right["R"])
    before = channels_of(path)
    after = channels_of(write_frame(tmp_path / "out.exr", darken(frame), keep=None))
    assert [(*part[:2], {*part[2]}) for part in after] == [(*part[:2], {*part[2]})
                                                           for part in before]
    for (*_, old), (*_, new) in zip(before, after, strict=True):
        for name, plane in old.items():
            by = 1 if name.rpartition(".")[2] == "Z" else HALF
            np.testing.assert_array_equal(new[name], (plane * by).astype(np.float16), err_msg=name)
    (again,) = read_sequence(tmp_path / "out.exr", view="right,left")
    np.testing.assert_array_equal(again[Role.COLOUR][..., 1],
                                  (right["G"] * HALF).astype(np.float16))
    np.testing.assert_array_equal(again.views["left"][Role.COLOUR][..., 1],
                                  (left["G"] * HALF).astype(np.float16))


def test_windows_of_their_own(tmp_path: Path) -> None:
    """Views are rendered in different data windows; what lies beside a picture that grew stays in a
    part of its own."""
    parts = []
    for seed, (view, x) in enumerate((("left", 0), ("right", 4))):
        window = {"dataWindow": (np.array([x, 2], np.int32), np.array([x + 11, 9], np.int32)),
                  "view": view, "displayWindow": (np.zeros(2, np.int32),
                                                  np.array([WIDTH - 1, HEIGHT - 1], np.int32))}
        channels = {name: plane[:8, :12] for name, plane in picture(seed, "RGBAZ").items()}
        parts.append(OpenEXR.Part({"type": OpenEXR.scanlineimage, **window}, channels,
                                  f"rgba_{view}"))
    OpenEXR.File(parts).write(str(tmp_path / "in.exr"))
    (frame,) = read_sequence(tmp_path / "in.exr", view="all")
    whole = {"dataWindow": (0, 0, WIDTH - 1, HEIGHT - 1)}
    grown = dataclasses.replace(frame, metadata=frame.metadata | whole)
    (kept_left, rest, kept_right) = channels_of(write_frame(tmp_path / "out.exr", grown, keep=True))
    assert ((kept_left[0], {*kept_left[2]}) == ("rgba_left", {*"RGBA"})
            and kept_left[2]["R"].shape == (HEIGHT, WIDTH))
    assert (rest[0], {*rest[2]}) == ("rgba_left.other", {"Z"}) and rest[2]["Z"].shape == (8, 12)
    assert {*kept_right[2]} == {*"RGBAZ"} and kept_right[2]["R"].shape == (8, 12)


@pytest.mark.parametrize("keep", [None, True])
@pytest.mark.parametrize("kind", ["layers of one part", "parts with a view"])
def test_an_enlarged_pair_keeps_its_layout(tmp_path: Path, kind: str, keep: bool | None) -> None:
    path = write(tmp_path / "in.exr", layouts(picture(1, "RGBAZ"), picture(2, "RGBAZ"))[kind])
    (frame,) = read_sequence(path, view="all", planes=[Role.COLOUR, Role.ALPHA])
    larger = Pipeline([DenoiseUpscale(scale=2, strength=0.0)])(frame)
    found = channels_of(write_frame(tmp_path / "out.exr", larger, keep=keep))
    names = {name for *_, held in found for name in held}
    letters = {*"RGBA"} if kind != KINDS[0] else {*"RGBA", *(f"right.{name}" for name in "RGBA")}
    assert names == letters | ((({"Z", "right.Z"} if kind == KINDS[0] else {"Z"})) if keep
                               else set())
    assert all(plane.shape == (2 * HEIGHT, 2 * WIDTH) for *_, held in found
               for plane in held.values())


def test_each_view_has_its_own_history(tmp_path: Path) -> None:
    """A run of both equals runs of one each, with the exposure of the first, run-up and results
    from later frames included."""
    still = {name: np.zeros((HEIGHT, WIDTH), np.float16) for name in ("motion.X", "motion.Y")}
    for number in range(1, 5):
        left, right = picture(number, "RGB") | still, picture(10 + number, "RGB") | still
        write(tmp_path / f"in.{number:04d}.exr",
              [("rgba_left", "left", left), ("rgba_right", "right", right)])

    def run(view: str) -> list[Frame]:
        shot = read_sequence(tmp_path / "in.####.exr", view=view)
        later = Backwards(shot, exposure=0.0, model="s", scale=1.0)
        denoiser = DenoiseUpscale(model="s", scale=1.0)
        passes = Pipeline([denoiser, create("both_ways")], exposure=0.0, run_up=RunUp(shot, 2))
        return [passes(later(frame)) for frame in shot]

    both, left, right = run("all"), run("left"), run("right")
    for pair, one, other in zip(both, left, right, strict=True):
        np.testing.assert_array_equal(pair[Role.COLOUR], one[Role.COLOUR])
        np.testing.assert_array_equal(pair.views["right"][Role.COLOUR], other[Role.COLOUR])


def test_a_run_goes_on_with_the_histories_of_all_views(tmp_path: Path) -> None:
    still = {name: np.zeros((HEIGHT, WIDTH), np.float16) for name in ("motion.X", "motion.Y")}
    path = write(tmp_path / "in.exr", [(f"rgba_{view}", view, picture(seed, "RGB") | still)
                                       for seed, view in enumerate(("left", "right"))])
    (frame,) = read_sequence(path, view="all")
    passes, fresh = (Pipeline([DenoiseUpscale(model="s")], exposure=0.0) for _ in range(2))
    passes(frame)
    history = passes.history()
    assert history is not None and any(key.startswith("view right/") for key in history)
    fresh.recall(frame, history)
    expected, found = passes(frame), fresh(frame)
    np.testing.assert_array_equal(found.views["right"][Role.COLOUR],
                                  expected.views["right"][Role.COLOUR])
    with pytest.raises(FrameError, match="does not fit"):
        fresh.recall(dataclasses.replace(frame, views={}), {"pass other/x": np.zeros(1)})


def test_both_eyes_see_one_exposure(tmp_path: Path) -> None:
    left = picture(1, "RGB")
    dark = {name: (plane / 8).astype(np.float16) for name, plane in left.items()}
    path = write(tmp_path / "in.exr", [("rgba.left", "", left), ("rgba.right", "", dark)])
    (frame,) = read_sequence(path, view="all")
    result = Pipeline([create("tonemap")])(frame)
    assert result.views["right"][Role.COLOUR].mean() < 0.5 * result[Role.COLOUR].mean()


def test_planes_that_one_view_lacks(tmp_path: Path) -> None:
    path = write(tmp_path / "in.exr", [("rgba.left", "", picture(1)),
                                       ("depth.left", "", picture(1, "Z")),
                                       ("rgba.right", "", picture(2))])
    (frame,) = read_sequence(path, view="all", planes=[Role.COLOUR, Role.DEPTH])
    assert Role.DEPTH in frame and Role.DEPTH not in frame.views["right"]


def test_what_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "in.exr",
                 [("rgba.left", "", picture(1)), ("rgba.right", "", picture(2))])
    with pytest.raises(SequenceError, match="name each view once"):
        read_sequence(path, view="left,left")
    with pytest.raises(MissingPlaneError, match="no view 'up': it holds"):
        next(iter(read_sequence(path, view="left,up")))
    (frame,) = read_sequence(path, view="all")
    with pytest.raises(WriteError,
                       match=r"PNG holds one view: write EXR, or choose one with --view NAME"):
        write_frame(tmp_path / "out.png", frame)
    with pytest.raises(WriteError, match="not of one OpenEXR file"):
        write_frame(tmp_path / "out.exr", dataclasses.replace(frame, source=None))
    assert main(["run", str(path), "-o", str(tmp_path / "out.png"), "--view", "all"]) == 2
    assert main(["inspect", str(path), "--view", "all"]) == 2
    assert main(["exposure", str(path), "--view", "left,right"]) == 2
    told = capfd.readouterr().err
    assert ("only EXR holds several views: write EXR, or a file for each: put {view} into the "
            "name" in told)
    assert "'postfx inspect' uses one view: give --view one name" in told
    assert "'postfx exposure' uses one view: give --view one name" in told


def write_apart(folder: Path, numbers: range = range(1, 4),
                views: tuple[str, ...] = ("left", "right")) -> None:
    """Files of each view, whose pictures move one pixel to the right a frame."""
    for seed, view in enumerate(views):
        still, none = picture(seed, "RGBA"), np.zeros((HEIGHT, WIDTH), np.float16)
        for number in numbers:
            moved = {name: np.roll(plane, number, axis=1) for name, plane in still.items()}
            motion = {"motion.X": none - 1, "motion.Y": none}
            write_part(folder / f"in.{view}.{number:04d}.exr", moved | motion | {"Z": still["A"]})


def write_part(path: Path, channels: dict[str, np.ndarray]) -> None:
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))


def run(folder: Path, *words: str) -> int:
    return main(["run", str(folder / words[0]), "-o", str(folder / words[1]), "--exposure", "0",
                 "--device", "cpu", *words[2:]])


@pytest.mark.parametrize("view", ["%V", "{view}"])
def test_a_file_for_each_view_is_as_a_run_for_each(tmp_path: Path, view: str) -> None:
    """History, pixels and what is kept."""
    write_apart(tmp_path)
    assert run(tmp_path, f"in.{view}.####.exr", f"out.{view}.####.exr", "--denoise-only") == 0
    for name in ("left", "right"):
        assert run(tmp_path, f"in.{name}.####.exr", f"alone.{name}.####.exr", "--denoise-only") == 0
        for number in (1, 3):
            ((_, _, both),), ((_, _,
                               alone),) = (channels_of(tmp_path / f"{word}.{name}.{number:04d}.exr")
                                           for word in ("out", "alone"))
            assert {*both} == {*alone} == {*"RGBAZ", "motion.X", "motion.Y"}
            for channel, plane in alone.items():
                np.testing.assert_array_equal(both[channel], plane, err_msg=channel)


def test_a_run_of_files_for_each_view_goes_on_where_one_is_missing(tmp_path: Path, capfd) -> None:
    write_apart(tmp_path)
    words = ("in.%V.####.exr", "out.%V.####.png", "--skip-existing")
    assert run(tmp_path, *words) == 0
    whole = {path.name: path.read_bytes() for path in tmp_path.glob("out.*.png")}
    assert len(whole) == 6
    (tmp_path / "out.right.0003.png").unlink()
    (tmp_path / "out.left.0002.png").unlink()
    capfd.readouterr()
    assert run(tmp_path, *words) == 0
    told = capfd.readouterr().err
    assert "frame 1: " in told and "and" in told
    assert {path.name: path.read_bytes() for path in tmp_path.glob("out.*.png")} == whole
    assert main(["verify", str(tmp_path)]) == 0
    (tmp_path / "out.up.0001.png").write_bytes(b"")
    assert main(["verify", str(tmp_path)]) != 0 and "out.up.0001.png" in capfd.readouterr().out


def test_files_for_each_view_in_folders(tmp_path: Path, capfd) -> None:
    write_apart(tmp_path, range(1, 2))
    for view in ("left", "right"):
        (tmp_path / view).mkdir()
        (tmp_path / f"in.{view}.0001.exr").rename(tmp_path / view / "shot.0001.exr")
    assert run(tmp_path, "{view}/shot.####.exr", "out/", "--view", "right,left",
               "--no-denoise") == 0
    assert "views right, left" in capfd.readouterr().err
    written = [path.name for path in (tmp_path / "out").glob("*.exr")]
    assert sorted(written) == ["left.shot.0001.exr", "right.shot.0001.exr"]
    frames = read_sequence(tmp_path / "%V" / "shot.####.exr")
    assert ((frames.view, frames.views) == ("left", ("right",))
            and list(next(iter(frames)).views) == ["right"])
    assert read_sequence(tmp_path / "{view}" / "shot.0001.exr", view="right").numbers == (1,)


def test_views_of_one_file_into_files_for_each(tmp_path: Path) -> None:
    path = write(tmp_path / "in.exr",
                 layouts(picture(1, "RGBAZ"), picture(2, "RGBAZ"))["parts with a view"])
    assert run(tmp_path, "in.exr", "out.%V.png", "--view", "all", "--no-denoise") == 0
    assert run(tmp_path, "in.exr", "alone.png", "--view", "right", "--no-denoise") == 0
    assert (tmp_path / "out.right.png").read_bytes() == (tmp_path / "alone.png").read_bytes()
    assert (tmp_path / "out.left.png").is_file() and path.is_file()


def test_what_is_refused_of_files_for_each_view(tmp_path: Path, capfd) -> None:
    write_apart(tmp_path, range(1, 4))
    (tmp_path / "in.right.0002.exr").unlink()
    pattern = "in.%V.####.exr"
    told = {
        (pattern, "out.%V.####.exr"): "in.right.0002.exr: frame 2 is missing",
        (pattern, "out.####.exr"): "one file for 2 views, which have files of their own: put "
        "{view} into the name",
        (pattern,
         "%V/out.####.exr"): "all views go into one folder: put {view} into the file's name",
        (pattern, "in.%V.####.exr", "--overwrite"): "in.left.0001.exr: is an input",
        (pattern, "in.new_%V.####.exr"): "in.new_left.0001.exr: would be a frame of the input",
        (pattern, "out.%V.####.exr", "--view",
         "left,up"): "no view 'up': there are files of left, right",
        ("in.%V.*.exr", "out.%V.####.exr"): "name one of them, or all views by in.{view}.####.exr",
        ("in.left.####.exr",
         "out.%V.####.exr"): "{view} is for the names of views, and none is known",
        (pattern, "out.%V.####.exr", "--guides",
         str(tmp_path / "in.left.####.exr")): "put {view} into both",
    }
    for words, message in told.items():
        assert run(tmp_path, *words) == 2, words
        assert message in capfd.readouterr().err, words
    assert run(tmp_path, pattern, "out.%V.####.exr", "--on-error", "skip", "--no-denoise") == 3
    assert sorted(path.name for path in tmp_path.glob("out.*2.exr")) == []
    large = {name: np.repeat(plane, 2, axis=0) for name, plane in picture(1, "RGB").items()}
    write_part(tmp_path / "in.right.0001.exr", large)
    assert run(tmp_path, pattern, "big.%V.####.exr", "--frames", "1", "--no-denoise") == 2
    assert ("in.right.0001.exr: is 24x40, the first view 24x20: render all views at one "
            "size" in capfd.readouterr().err)


def test_verbs_that_look_at_one_view(tmp_path: Path, capfd) -> None:
    write_apart(tmp_path)
    assert main(["run", str(tmp_path / "in.%V.####.exr"), "--explain"]) == 0
    assert "in.{view}.####.exr: 3 frames (1-3), views left, right" in capfd.readouterr().out
    assert main(["inspect", str(tmp_path / "in.%V.####.exr")]) <= 2
    assert "view left is used, not right: --view chooses one" in capfd.readouterr().out
    assert main(["exposure", str(tmp_path / "in.%V.####.exr"), "--device", "cpu"]) <= 1
    assert (main(["watch", str(tmp_path / "in.%V.####.exr"), "-o", str(tmp_path / "p.####.png")])
            == 2)
    assert "watches one view: put its name for {view}" in capfd.readouterr().err


def test_a_report_shows_all_views(tmp_path: Path) -> None:
    pytest.importorskip("flip_evaluator")
    write_apart(tmp_path)
    page = tmp_path / "page.html"
    assert run(tmp_path, "in.%V.####.exr", "out.%V.####.exr", "--report", str(page), "--reference",
               str(tmp_path / "in.%V.####.exr"), "--denoise-only") == 0
    text = page.read_text()
    data = json.loads(text[text.index('id="data">') + 10:].partition("</script>")[0])
    (first, *_) = data["frames"]
    names = ["before left", "after left", "reference left", "before right", "after right",
             "reference right"]
    assert list(first["pictures"]) == names and list(first["maps"]) == ["FLIP left", "FLIP right"]
    curves = {"change after left", "change after right", "psnr after right", "flip after left"}
    assert curves <= {*data["readings"]["2"]}
    assert (list(data["views"]) == ["left", "right"]
            and {one["view"] for one in data["sheet"]} == {"left", "right"})
    assert first["pictures"]["after left"] != first["pictures"]["after right"]


def test_the_command_line_writes_both(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "in.exr", layouts(picture(1, "RGBAZ"), picture(2, "RGBAZ"))[KINDS[0]])
    assert main(["run", str(path), "-o", str(tmp_path / "out.exr"), "--view", "all",
                 "--denoise-only"]) == 0
    assert "not enlarged, views left, right" in capfd.readouterr().err
    ((_, _, old),), ((_, _, new),) = channels_of(path), channels_of(tmp_path / "out.exr")
    assert {name for name in old if not np.array_equal(old[name], new[name])} >= {"R", "right.R"}
    assert np.array_equal(old["Z"], new["Z"]) and np.array_equal(old["right.Z"], new["right.Z"])
