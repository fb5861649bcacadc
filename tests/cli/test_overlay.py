"""Transparency overlays on the command line, with files as renderers write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx import Role, read_sequence
from postfx.integrate import write_planes

RUN = ("run", "in/shot.####.exr", "-o", "out/shot.####.exr", "--model", "s", "--scale", "2",
       "--device", "cpu")
HEIGHT, WIDTH = 90, 160
COLOUR, COVERAGE = np.array([0.8, 0.3, 0.1]), 0.75
INSIDE = np.s_[4:-4, 4:-4]  # beyond the border a cubic kernel has no samples


def smoke(number: int, jitter: tuple[float, float], scale: int = 1) -> np.ndarray:
    """A soft puff that drifts to the right by 2 pixels a frame, sampled at jittered positions."""
    y, x = np.indices((scale * HEIGHT, scale * WIDTH)) + 0.5
    x, y = (x + jitter[0]) / scale - 60 - 2 * number, (y + jitter[1]) / scale - 45
    alpha = COVERAGE * np.exp(-(x**2 + y**2) / (2 * 30**2))[..., None]
    return np.concatenate([COLOUR * alpha, alpha], 2)


@pytest.fixture
def shot(tmp_path: Path):
    """Writes in/shot.####.exr: a sequence of the sample room, cut to a part, with smoke in some of
    its frames."""
    room = Path(__file__).parents[2] / "samples" / "room" / "noisy.####.exr"

    def write(*empty: int, **planes) -> list:
        frames = []
        for frame in read_sequence(room, frames="1-3"):
            part = {role: plane[60 : 60 + HEIGHT, 100 : 100 + WIDTH].copy()
                    for role, plane in frame.planes.items()}
            frame.planes = part | {Role.OVERLAY: (smoke(frame.number, frame.jitter) *
                                                  (frame.number not in empty)).astype(np.float32)}
            frame.planes |= {Role(role): make(frame) for role, make in planes.items()}
            write_planes(tmp_path / f"in/shot.{frame.number:04d}.exr", frame)
            frames.append(frame)
        return frames

    return write


def channels(path: Path) -> dict[str, np.ndarray]:
    picture = oiio.ImageBuf(str(path))
    pixels = picture.get_pixels(oiio.FLOAT)
    return {name: pixels[..., i] for i, name in enumerate(picture.spec().channelnames)}


def picture(path: Path, *names: str) -> np.ndarray:
    held = channels(path)
    return np.stack([held[name] for name in names], -1).astype(np.float64)


def test_the_denoised_picture_is_under_the_overlay(postfx, shot, tmp_path):
    """Against the formula on the file without it and the smoke's own values at the output's
    pixels."""
    frames = shot()
    assert any(any(frame.jitter) for frame in frames)
    assert postfx(*RUN).code == 0
    bare = (*RUN[:3], "bare/shot.####.exr", *RUN[4:])
    assert postfx(*bare, "--overlay", "ignore").code == 0
    for number in (1, 2, 3):
        front, name = smoke(number, (0, 0), 2), f"shot.{number:04d}.exr"
        behind = picture(tmp_path / "bare" / name, *"RGB")
        found = picture(tmp_path / "out" / name, *"RGB")
        assert set(channels(tmp_path / "out" / name)) == {"R", "G", "B"}
        wanted = front[..., :3] + (1 - front[..., 3:]) * behind
        # Three roundings to half: of the picture behind, of the overlay and of what comes out.
        np.testing.assert_allclose(found[INSIDE], wanted[INSIDE], atol=6e-4, rtol=1.5e-3)


def test_the_layer_is_written_beside_the_picture_without_it(postfx, shot, tmp_path):
    shot()
    assert postfx(*RUN, "--overlay", "separate").code == 0
    held = channels(tmp_path / "out" / "shot.0002.exr")
    assert list(held) == ["R", "G", "B", "overlay.R", "overlay.G", "overlay.B", "overlay.A"]
    layer = np.stack([held[f"overlay.{c}"] for c in "RGBA"], -1)
    # half floats in and out
    np.testing.assert_allclose(layer[INSIDE], smoke(2, (0, 0), 2)[INSIDE], atol=6e-4)
    again = postfx("run", "out/shot.####.exr", "-o", "again/shot.####.exr", "--no-denoise")
    assert again.code == 0  # what was written apart is found and composited
    assert postfx(*RUN, "--overwrite").code == 0
    both = (picture(tmp_path / folder / "shot.0002.exr", *"RGB") for folder in ("again", "out"))
    np.testing.assert_allclose(*both, atol=2e-3, rtol=2e-3)


@pytest.mark.parametrize(("arguments", "message"), [
    (("-o", "out/x.####.png"), "--overlay separate writes a layer, which only EXR holds"),
    (("-o", "out/x.####.exr", "--tonemap"),
     "--overlay separate keeps scene-linear light, --tonemap does not"),
])
def test_a_layer_that_cannot_be_kept_is_refused(postfx, shot, tmp_path, arguments, message):
    shot()
    done = postfx("run", "in/shot.####.exr", *arguments, "--overlay", "separate")
    assert done.code == 2 and f"error: {message}" in done.err and not (tmp_path / "out").exists()


def test_what_is_skipped_is_told(postfx, shot, write_exr):
    shot(2, 3)
    explained = postfx(*RUN, "--explain").out
    assert "overlay: reads colour, overlay; writes colour" in explained
    assert ("skips   overlay: --overlay "
            "ignore" in postfx(*RUN, "--explain", "--overlay", "ignore").out)
    done = postfx(*RUN)
    line = next(line for line in done.err.splitlines() if "compositing for" in line)
    assert "compositing for 2 frames in overlay: the overlay is 0 there; which takes" in line
    write_exr("plain.exr", {c: np.ones((20, 30)) for c in "RGB"})
    assert "skips   overlay: there is no overlay" in postfx("run", "plain.exr", "--explain").out
    done = postfx("run", "plain.exr", "-o", "out.exr", "--model", "s")
    assert done.code == 0 and "overlay" not in done.err


def test_alpha_is_that_of_both(postfx, shot, tmp_path):
    shot(alpha=lambda frame: np.full((HEIGHT, WIDTH, 1), 0.5, np.float32))
    assert postfx(*RUN).code == 0
    found = picture(tmp_path / "out" / "shot.0001.exr", "A")
    np.testing.assert_allclose(found[INSIDE], 0.5 + 0.5 * smoke(1, (0, 0), 2)[..., 3:][INSIDE],
                               atol=1e-3)


def test_colour_before_transparents_is_what_is_denoised(postfx, shot, tmp_path):
    """The colour may hold the overlay already; then the one without it is taken, unless the overlay
    is ignored."""
    def together(frame):
        front = frame[Role.OVERLAY]
        return (front[..., :3] + (1 - front[..., 3:]) * frame[Role.COLOUR]).astype(np.float32)

    shot()
    assert postfx(*RUN).code == 0
    wanted = picture(tmp_path / "out" / "shot.0002.exr", *"RGB")
    shot(opaque_colour=lambda frame: frame[Role.COLOUR].copy(), colour=together)
    assert postfx(*RUN, "--overwrite").code == 0
    np.testing.assert_array_equal(picture(tmp_path / "out" / "shot.0002.exr", *"RGB"), wanted)
    explained = postfx(*RUN, "--explain").out
    assert ("skips   colour with transparents: opaque_colour.R,G,B is denoised under the "
            "overlay" in explained)
    assert postfx(*RUN, "--overwrite", "--overlay", "ignore").code == 0
    ignored = picture(tmp_path / "out" / "shot.0002.exr", *"RGB")
    assert np.abs(ignored - wanted).mean() < 0.1 and not np.array_equal(ignored, wanted)
    roles = postfx("inspect", "in/shot.####.exr", "--json").json["roles"]
    assert roles["colour"]["planes"] == [f"opaque_colour.{c}" for c in "RGB"]
    assert "before transparents" in roles["colour"]["why"]


def test_the_alpha_beside_the_colour_before_transparents_counts(postfx, write_exr, tmp_path):
    flat = {"R": 0.6, "G": 0.6, "B": 0.6, "A": 0.75, "opaque.R": 0.2, "opaque.G": 0.2,
            "opaque.B": 0.2, "overlay.R": 0.5, "overlay.G": 0.5, "overlay.B": 0.5, "overlay.A": 0.5}
    for beside in ({}, {"opaque.A": 0.5}):
        write_exr("x.exr",
                  {name: np.full((20, 30), value) for name, value in (flat | beside).items()})
        done = postfx("run", "x.exr", "-o", "y.exr", "--model", "s", "--scale", "2", "--overwrite")
        found = channels(tmp_path / "y.exr")
        np.testing.assert_allclose(found["R"], 0.6, atol=1e-3)
        if beside:
            np.testing.assert_allclose(found["A"], 0.75, atol=1e-3)
        else:
            assert ("A" not in found and "write the alpha before transparents beside "
                    "opaque.R,G,B" in done.err)


def test_an_overlay_at_output_size(postfx, shot, write_exr, tmp_path):
    """In the files of the guides, sampled at pixel centres."""
    shot(1, 2, 3)
    for number in (1, 2, 3):
        write_exr(f"in/fine.{number:04d}.exr", {f"overlay.{c}": smoke(number, (0, 0), 2)[..., i]
                                                for i, c in enumerate("RGBA")})
    done = postfx(*RUN, "--guides", "in/fine.####.exr", "--overlay", "separate", "--json")
    assert done.code == 0 and done.json["guides"]["used"] == ["overlay"]
    layer = picture(tmp_path / "out" / "shot.0003.exr", *(f"overlay.{c}" for c in "RGBA"))
    np.testing.assert_allclose(layer, smoke(3, (0, 0), 2), atol=6e-4)


def test_within_a_memory_budget(postfx, shot, tmp_path):
    shot(2)
    for name, budget in (("whole", ()), ("tiles", ("--memory", "420M"))):
        assert postfx(*RUN[:3], f"{name}/shot.####.exr", *RUN[4:], *budget).code == 0
    for number in (1, 2, 3):
        both = (picture(tmp_path / folder / f"shot.{number:04d}.exr", *"RGB")
                for folder in ("whole", "tiles"))
        np.testing.assert_allclose(*both, atol=1e-3)
