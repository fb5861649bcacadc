"""All views of stereo files in one run: each with a history of its own, written where its render was."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from postfx import DenoiseUpscale, Pipeline, RunUp, read_sequence, write_frame
from postfx.cli.main import main
from postfx.errors import FrameError, MissingPlaneError, SequenceError, WriteError
from postfx.frame import Frame, Role
from postfx.passes.registry import create
from postfx.temporal.bidirectional import Backwards

WIDTH, HEIGHT = 24, 20
HALF = np.float32(0.5)
WORDS = ("red", "green", "blue", "alpha")


def picture(seed: int, names: str = "RGBA") -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.random((HEIGHT, WIDTH), np.float32).astype(np.float16) for name in names}


def named(layer: str, channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {f"{layer}.{name}": plane for name, plane in channels.items()}


def layouts(left: dict[str, np.ndarray], right: dict[str, np.ndarray]) -> dict[str, list[tuple[str, str, dict]]]:
    """Kinds of stereo files: name, view and channels of each part; a lone one lists its views."""
    left_rgba, right_rgba = ({name: eye[name] for name in "RGBA"} for eye in (left, right))
    left_rest, right_rest = ({"Z": eye["Z"]} for eye in (left, right))
    return {
        "layers of one part": [("", "", left | named("right", right))],
        "parts with a view": [("rgba_left", "left", left_rgba), ("depth_left", "left", left_rest),
                              ("rgba_right", "right", right_rgba), ("depth_right", "right", right_rest)],
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
    OpenEXR.File([OpenEXR.Part({"type": OpenEXR.scanlineimage, **alone, **header, **({"view": view} if view else {})},
                               dict(channels), name) for name, view, channels in parts]).write(str(path))
    return path


def channels_of(path: Path) -> list[tuple[str, str | None, dict[str, np.ndarray]]]:
    return [(part.name(), part.header.get("view"), {name: one.pixels for name, one in part.channels.items()})
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
    before, after = channels_of(path), channels_of(write_frame(tmp_path / "out.exr", darken(frame), keep=None))
    assert [(*part[:2], {*part[2]}) for part in after] == [(*part[:2], {*part[2]}) for part in before]
    for (*_, old), (*_, new) in zip(before, after, strict=True):
        for name, plane in old.items():
            by = 1 if name.rpartition(".")[2] == "Z" else HALF
            np.testing.assert_array_equal(new[name], (plane * by).astype(np.float16), err_msg=name)
    (again,) = read_sequence(tmp_path / "out.exr", view="right,left")
    np.testing.assert_array_equal(again[Role.COLOUR][..., 1], (right["G"] * HALF).astype(np.float16))
    np.testing.assert_array_equal(again.views["left"][Role.COLOUR][..., 1], (left["G"] * HALF).astype(np.float16))


def test_windows_of_their_own(tmp_path: Path) -> None:
    """Views are rendered in different data windows; what lies beside a picture that grew stays in a part of its own."""
    parts = []
    for seed, (view, x) in enumerate((("left", 0), ("right", 4))):
        window = {"dataWindow": (np.array([x, 2], np.int32), np.array([x + 11, 9], np.int32)), "view": view,
                  "displayWindow": (np.zeros(2, np.int32), np.array([WIDTH - 1, HEIGHT - 1], np.int32))}
        channels = {name: plane[:8, :12] for name, plane in picture(seed, "RGBAZ").items()}
        parts.append(OpenEXR.Part({"type": OpenEXR.scanlineimage, **window}, channels, f"rgba_{view}"))
    OpenEXR.File(parts).write(str(tmp_path / "in.exr"))
    (frame,) = read_sequence(tmp_path / "in.exr", view="all")
    whole = {"dataWindow": (0, 0, WIDTH - 1, HEIGHT - 1)}
    grown = dataclasses.replace(frame, metadata=frame.metadata | whole)
    (kept_left, rest, kept_right) = channels_of(write_frame(tmp_path / "out.exr", grown, keep=True))
    assert (kept_left[0], {*kept_left[2]}) == ("rgba_left", {*"RGBA"}) and kept_left[2]["R"].shape == (HEIGHT, WIDTH)
    assert (rest[0], {*rest[2]}) == ("rgba_left.other", {"Z"}) and rest[2]["Z"].shape == (8, 12)
    assert {*kept_right[2]} == {*"RGBAZ"} and kept_right[2]["R"].shape == (8, 12)


@pytest.mark.parametrize("keep", [None, True])
@pytest.mark.parametrize("kind", ["layers of one part", "parts with a view"])
def test_an_enlarged_pair_keeps_its_layout(tmp_path: Path, kind: str, keep: bool | None) -> None:
    path = write(tmp_path / "in.exr", layouts(picture(1, "RGBAZ"), picture(2, "RGBAZ"))[kind])
    (frame,) = read_sequence(path, view="all", planes=[Role.COLOUR, Role.ALPHA])
    larger = Pipeline([DenoiseUpscale(strength=0.0)])(frame)
    found = channels_of(write_frame(tmp_path / "out.exr", larger, keep=keep))
    names = {name for *_, held in found for name in held}
    letters = {*"RGBA"} if kind != KINDS[0] else {*"RGBA", *(f"right.{name}" for name in "RGBA")}
    assert names == letters | ((({"Z", "right.Z"} if kind == KINDS[0] else {"Z"})) if keep else set())
    assert all(plane.shape == (2 * HEIGHT, 2 * WIDTH) for *_, held in found for plane in held.values())


def test_each_view_has_its_own_history(tmp_path: Path) -> None:
    """A run of both equals runs of one each, with the exposure of the first, run-up and results from later frames
    included."""
    still = {name: np.zeros((HEIGHT, WIDTH), np.float16) for name in ("motion.X", "motion.Y")}
    for number in range(1, 5):
        left, right = picture(number, "RGB") | still, picture(10 + number, "RGB") | still
        write(tmp_path / f"in.{number:04d}.exr", [("rgba_left", "left", left), ("rgba_right", "right", right)])

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
    np.testing.assert_array_equal(found.views["right"][Role.COLOUR], expected.views["right"][Role.COLOUR])
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
    path = write(tmp_path / "in.exr", [("rgba.left", "", picture(1)), ("depth.left", "", picture(1, "Z")),
                                       ("rgba.right", "", picture(2))])
    (frame,) = read_sequence(path, view="all", planes=[Role.COLOUR, Role.DEPTH])
    assert Role.DEPTH in frame and Role.DEPTH not in frame.views["right"]


def test_what_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "in.exr", [("rgba.left", "", picture(1)), ("rgba.right", "", picture(2))])
    with pytest.raises(SequenceError, match="name each view once"):
        read_sequence(path, view="left,left")
    with pytest.raises(MissingPlaneError, match="no view 'up': it holds"):
        next(iter(read_sequence(path, view="left,up")))
    (frame,) = read_sequence(path, view="all")
    with pytest.raises(WriteError, match=r"PNG holds one view: write EXR, or choose one with --view NAME"):
        write_frame(tmp_path / "out.png", frame)
    with pytest.raises(WriteError, match="not of one OpenEXR file"):
        write_frame(tmp_path / "out.exr", dataclasses.replace(frame, source=None))
    assert main(["run", str(path), "-o", str(tmp_path / "out.png"), "--view", "all"]) == 2
    assert main(["inspect", str(path), "--view", "all"]) == 2
    told = capfd.readouterr().err
    assert "only EXR holds several views: write EXR, or run once for each with --view left, --view right" in told
    assert "'postfx inspect' looks at one view: give --view with one name" in told


def test_the_command_line_writes_both(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "in.exr", layouts(picture(1, "RGBAZ"), picture(2, "RGBAZ"))[KINDS[0]])
    assert main(["run", str(path), "-o", str(tmp_path / "out.exr"), "--view", "all", "--denoise-only"]) == 0
    assert "not enlarged, views left, right" in capfd.readouterr().err
    ((_, _, old),), ((_, _, new),) = channels_of(path), channels_of(tmp_path / "out.exr")
    assert {name for name in old if not np.array_equal(old[name], new[name])} >= {"R", "right.R"}
    assert np.array_equal(old["Z"], new["Z"]) and np.array_equal(old["right.Z"], new["right.Z"])
