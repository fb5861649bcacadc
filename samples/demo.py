"""What `make demo` runs: the sample sequence, noisy frames to pictures, a video and a page that
shows them.

python samples/demo.py [FOLDER]

Says before each step how long it may take, and after it how long it took.
"""
from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import copyfile

import numpy as np
from pictures import beside, crops, means_of_blocks, name_corner, split, write_animation

import postfx
from postfx import oidn
from postfx.frame import Frame, Role

HERE = Path(__file__).parent
ROOM = HERE / "room"
SHOWCASE = HERE.parent / "docs/images/showcase.jpg"
NETWORK = "xl"
"""What `postfx run` takes at the render's size."""
SHOWN = 2
"""Pixels along a side of what shows one pixel."""
FRAMES_A_SECOND = 8
PLACES = ((60, 150), (380, 180))
"""Left upper corners of the enlarged crops, in pixels as shown."""
SIDE, ZOOM = 160, 2
PAGE = """<!doctype html><meta charset="utf-8"><title>postfx: the demo</title>
<style>
  body {{ font: 16px system-ui; margin: 2em auto; max-width: 1000px;
         background: #222; color: #eee }}
  img {{ max-width: 100% }}
</style>
<h1>Made on this machine, in {seconds:.0f} s</h1>
<p>Frame {number}, at twice its size: denoised, and as rendered with 4 samples a pixel.</p>
<img src="before_after.png">
<p>Enlarged: {columns}.</p><img src="crops.png">
<p>All frames, as rendered and denoised:</p><img src="video.png">
{showcase}
<p>The files beside this page: <code>clean.*.exr</code> (scene-linear) and
<code>picture.*.png</code>.</p>
"""
PRODUCT = """<h1>A product shot from Blender</h1>
<p>960x540, 4 samples a pixel, denoised at its own size (docs/gallery.md):</p>
<img src="showcase.jpg">
"""


def main(argv: list[str]) -> None:
    """Make everything; prints what it does."""
    out, began = Path(argv[0] if argv else "out/demo"), time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    sequence = postfx.read_sequence(ROOM / "noisy.####.exr")
    shot, clean = list(sequence), out / "clean.####.exr"
    run_up = postfx.RunUp(sequence)
    denoise = postfx.Pipeline([postfx.DenoiseUpscale(scale=1, model=NETWORK)],
                              exposure="metadata", run_up=run_up)
    show = postfx.Pipeline([postfx.ToneMap()], exposure="metadata")
    with step("2 of 4", "first frame, and those after it for its history: some seconds"):
        keep(clean, denoise(shot[0]))
    with step("3 of 4", f"{len(shot) - 1} more frames: some seconds"):
        for frame in shot[1:]:
            keep(clean, denoise(frame))
    with step("4 of 4", "pictures, crops and the video: some seconds"):
        before = [enlarge(show(frame)[Role.COLOUR]) for frame in shot]
        shown = [show(frame) for frame in postfx.read_sequence(clean)]
        after = [enlarge(frame[Role.COLOUR]) for frame in shown]
        for frame in shown:
            keep(out / "picture.####.png", frame)
        columns = compare(out, before[-1], after[-1], shot[-1], show)
        animate(out, before, after)
    if SHOWCASE.exists():
        copyfile(SHOWCASE, out / SHOWCASE.name)
    page = PAGE.format(seconds=time.perf_counter() - began, number=shot[-1].number,
                       columns=", ".join(columns), showcase=PRODUCT if SHOWCASE.exists() else "")
    (out / "index.html").write_text(page, encoding="utf-8")
    print(f"\nOpen {out / 'index.html'}. The same by two commands:")
    print(f"  postfx run 'samples/room/noisy.####.exr' -o '{clean}' --exposure metadata")
    print(f"  postfx run '{clean}' -o '{out}/picture.####.png' --no-denoise --exposure metadata")


@contextmanager
def step(number: str, what: str) -> Iterator[None]:
    """Say what is done and, after it, how long it took."""
    print(f"{number}  {what} ...", flush=True)
    began = time.perf_counter()
    yield
    print(f"        {time.perf_counter() - began:.1f} s", flush=True)


def keep(pattern: Path, frame: Frame) -> None:
    """Write a frame under the pattern's name of its number."""
    postfx.write_frame(pattern.with_name(pattern.name.replace("####", f"{frame.number:04d}")),
                       frame)


def enlarge(picture: np.ndarray) -> np.ndarray:
    """A picture as it is shown, by repeating pixels."""
    return picture.repeat(SHOWN, 0).repeat(SHOWN, 1)


def compare(out: Path, before: np.ndarray, after: np.ndarray, noisy: Frame,
            show: postfx.Pipeline) -> list[str]:
    """Write a frame before and after, and enlarged crops; returns what the crops' columns show."""
    reference = next(iter(postfx.read_sequence(ROOM / f"reference.{noisy.number:04d}.exr")))
    columns = {"as rendered": before}
    if oidn.is_installed():
        alone = postfx.Pipeline([postfx.Oidn()], exposure="metadata")(noisy)
        columns["Open Image Denoise"] = enlarge(show(alone)[Role.COLOUR])
    light = means_of_blocks(reference[Role.COLOUR], len(noisy[Role.COLOUR]))
    best = show(Frame({Role.COLOUR: light}, exposure=noisy.exposure))
    columns |= {"postfx": after, "192 samples a pixel": enlarge(best[Role.COLOUR])}
    write(out / "before_after.png",
          name_corner(name_corner(split(after, before), "postfx"), "as rendered", "right"))
    write(out / "crops.png", crops(list(columns.values()), PLACES, SIDE, ZOOM))
    return list(columns)


def animate(out: Path, before: list[np.ndarray], after: list[np.ndarray]) -> None:
    """Write all frames before and after, there and back, as a video."""
    files = []
    for number, pair in enumerate(zip(before, after, strict=True)):
        files.append(out / f"video.{number}.png")
        write(files[-1], beside(pair))
    write_animation(out / "video.png", files + files[-2:0:-1], FRAMES_A_SECOND)
    for file in files:
        file.unlink()


def write(path: Path, picture: np.ndarray) -> None:
    """Write code values (height, width, 3) of an sRGB display."""
    postfx.write_frame(path, Frame({Role.COLOUR: np.ascontiguousarray(picture, np.float32)},
                                   encoding="srgb"))


if __name__ == "__main__":
    main(sys.argv[1:])
