"""Motion of renderers that do not say how they store it: the pictures tell, and the lines that are
offered read it."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np

from postfx.cli.main import main
from postfx.doctor.motion_convention import ReadMotion, UnreadMotion, measure_convention, unit_size
from postfx.frame import Frame, Role
from postfx.io.profile import load_profile
from postfx.io.sequence import read_sequence
from postfx.sampling import local_mean

ROOM = Path(__file__).parent.parent.parent / "samples" / "room"
WIDTH, HEIGHT = 120, 80
MOVED = np.float32((3, -2))
"""Pixels to the previous frame."""


def frames() -> list[Frame]:
    """A texture that moves from frame to frame, a little faster on the right."""
    rng, margin = np.random.default_rng(5), 16
    texture = local_mean(rng.random((HEIGHT + 2 * margin, WIDTH + 2 * margin, 3))
                         .astype(np.float32), 2)
    found = []
    for number in range(3):
        x, y = margin + number * int(MOVED[0]), margin + number * int(MOVED[1])
        planes = {Role.COLOUR: texture[y : y + HEIGHT, x : x + WIDTH],
                  Role.MOTION: np.empty((HEIGHT, WIDTH, 2))}
        planes[Role.MOTION][:] = MOVED
        held = {role: np.ascontiguousarray(plane, np.float32) for role, plane in planes.items()}
        found.append(Frame(held, number + 1))
    return found


def stored(
    motion: np.ndarray, signs: tuple[int, int], unit: str, times: float, most: float, swapped: bool
) -> np.ndarray:
    """As a renderer would write motion: `most` pixels are white, 0 for no colour."""
    found = (motion * np.float32(signs) / np.float32(unit_size(unit, (WIDTH, HEIGHT)))
             * np.float32(times))
    found = 0.5 + 0.5 * found / most if most else found
    return np.ascontiguousarray(found[..., ::-1] if swapped else found)


CONVENTIONS = {
    "pixels to the previous frame, y down": ((1, 1), "pixels", 1, 0, False),
    "pixels to the next frame, y up": ((-1, 1), "pixels", 1, 0, False),
    "pixels from the previous frame, y down": ((-1, -1), "pixels", 1, 0, False),
    "while half a frame, y up": ((1, -1), "pixels", 0.5, 0, False),
    "y before x": ((1, -1), "pixels", 1, 0, True),
    "parts of the image": ((-1, 1), "uv", 1, 0, False),
    "-1..1 of the image": ((1, -1), "ndc", 1, 0, False),
    "parts of the width": ((-1, 1), "width", 1, 0, False),
    "a colour of 20 pixels": ((-1, 1), "pixels", 1, 20, False),
    "Unreal's": ((-1, 1), "ndc", 1, 2, False),
}


def test_every_convention_is_measured() -> None:
    shown = frames()
    bare = [Frame({Role.COLOUR: frame[Role.COLOUR]}, frame.number) for frame in shown]
    for name, (signs, unit, times, most, swapped) in CONVENTIONS.items():
        planes = tuple(stored(frame[Role.MOTION], signs, unit, times, most, swapped)
                       for frame in shown)
        motion = UnreadMotion("mv", ("R", "G"), planes)
        found = measure_convention(bare, motion)
        assert found and found.fits, name
        read = found.convention.pixels(planes[2], (WIDTH, HEIGHT))
        np.testing.assert_allclose(read, np.broadcast_to(MOVED, read.shape), atol=0.12,
                                   err_msg=name)
        (plane,) = tomllib.loads(found.convention.lines(motion))["plane"]
        if times == 1 and not most:
            sizes = {abs(value) for value in plane.get("scale", [1])}
            assert (plane.get("unit", "pixels"), sizes) == (unit, {1}), name


def test_motion_of_a_square_picture_is_measured() -> None:
    square = [Frame({Role.COLOUR: frame[Role.COLOUR][:, :HEIGHT]}, frame.number)
              for frame in frames()[:2]]
    planes = tuple(np.broadcast_to(MOVED / np.float32(HEIGHT), (HEIGHT, HEIGHT, 2)) for _ in square)
    found = measure_convention(square, UnreadMotion("mv", ("R", "G"), planes))
    assert found and found.fits
    read = found.convention.pixels(planes[1], (HEIGHT, HEIGHT))
    np.testing.assert_allclose(read, np.broadcast_to(MOVED, read.shape), atol=0.12)


def test_what_is_no_motion_is_not_called_so() -> None:
    shown = frames()
    noise = tuple(np.random.default_rng(n).normal(size=(HEIGHT, WIDTH, 2)).astype(np.float32)
                  for n in range(3))
    for planes in (noise, tuple(np.zeros_like(plane) for plane in noise)):
        found = measure_convention(shown, UnreadMotion("vectors", ("R", "G"), planes))
        assert found is None or not found.fits
    still = [Frame({Role.COLOUR: shown[0][Role.COLOUR]}, number) for number in (1, 2)]
    found = measure_convention(still, UnreadMotion("vectors", ("R", "G"), noise))
    assert found is not None and not found.fits
    assert measure_convention(shown[:1], UnreadMotion("vectors", ("R", "G"), noise)) is None


def test_the_lines_that_are_offered_read_the_motion(write_exr, tmp_path: Path, capsys) -> None:
    """Karma's motionvectors, as if they were pixels to the next frame with y up."""
    for frame in read_sequence(ROOM / "noisy.####.exr", frames="2-3"):
        colour, albedo, motion = (frame[role]
                                  for role in (Role.COLOUR, Role.DIFFUSE_ALBEDO, Role.MOTION))
        write_exr(f"k.{frame.number}.exr", {
            **{f"C.{name}": colour[..., at] for at, name in enumerate("RGB")},
            **{f"albedo.{name}": albedo[..., at] for at, name in enumerate("RGB")},
            "motionvectors.R": -motion[..., 0], "motionvectors.G": motion[..., 1]},
            postfx__jitter=frame.jitter)
    assert main(["inspect", str(tmp_path / "k.#.exr"), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    (finding,) = [finding for finding in told["findings"] if finding["code"] == "motion-unread"]
    assert finding["level"] == "warning" and "motionvectors.R,G is not read" in finding["evidence"]
    (tmp_path / "studio.toml").write_text(finding["fix"].partition(":\n")[2])
    (read,) = read_sequence(tmp_path / "k.3.exr", profile=str(tmp_path / "studio.toml"))
    (truth,) = read_sequence(ROOM / "noisy.0003.exr")
    np.testing.assert_allclose(read[Role.MOTION], truth[Role.MOTION], atol=0.05)
    main(["inspect", str(tmp_path / "k.#.exr")])
    assert '\n         extends = "karma"\n' in capsys.readouterr().out


def test_a_correction_is_put_into_the_profile_that_reads_it() -> None:
    """Arnold's motion is read with y up, while the shutter is open."""
    rule = load_profile("arnold").rules(Role.MOTION)[0]
    read = ReadMotion("arnold", "motionvector", ("R", "G"), rule)
    lines = read.correct(False, (1, -1), "pixels")
    assert (lines is not None and tomllib.loads(lines) == {"extends": "arnold", "plane": [
        {"role": "motion", "names": ["motionvector"], "channels": [["R", "G"]], "scale": [-1, -1],
         "per": "shutter"}]})
    swapped = read.correct(True, (1, 1), "uv")
    assert (swapped is not None and tomllib.loads(swapped)["plane"] == [
        {"role": "motion", "names": ["motionvector"], "channels": [["G", "R"]], "scale": [1, -1],
         "unit": "uv", "per": "shutter"}])
    unreal = ReadMotion("unreal", "mv", ("R", "G"), load_profile("unreal").rules(Role.MOTION)[0])
    assert unreal.correct(False, (1, 1), "ndc") is None
