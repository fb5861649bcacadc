"""Measure frames between frames against rendered ones, beside what other methods make of the same
pictures.

python samples/between_frames.py [FOLDER ...] [--most N] [--picture FILE.png]

A folder holds noisy.####.exr, whose motion and depth are used, and reference.####.exr, the
pictures; samples/room by default. From every two references with one between them that one is made,
as if it had not been rendered: its motion plane only carries the next one's on to the frame before,
and tells where flicker is looked for: the new frame is seen between the two rendered ones, and both
steps count. Planes are enlarged to the pictures' size as postfx run keeps them, each pixel that of
the nearest one. Printed are means over all of them. Farneback and DIS need OpenCV: python -m pip
install opencv-python-headless.
"""
import argparse
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio

import postfx
from postfx import Frame, Role
from postfx.colour.views import to_codes
from postfx.sampling import bilinear, motion_at
from postfx.tools.bench.metrics import Pictures, flicker, flip, grey_factor, psnr, ssim

try:
    import cv2
except ImportError:
    cv2 = None

ROOM = Path(__file__).parent / "room"
FLOWS = ("farneback", "dis") if cv2 else ()
ALIKE = 0.03  # relative difference in depth of one point in two frames


class Gap(NamedTuple):
    """Two frames, the one after and the one before them or None, the picture that was rendered
    between the two, and the motion from that to the frame before and from the frame after to it."""

    before: Frame
    after: Frame
    later: Frame | None
    earlier: Frame | None
    wanted: np.ndarray
    exposure_factor: float
    steps: tuple[np.ndarray, np.ndarray]


def gaps(folder: Path) -> Iterator[Gap]:
    """All pairs of frames with one between them: first those of odd place, then those of even
    place."""
    noisy = {frame.number: frame for frame in postfx.read_sequence(str(folder / "noisy.####.exr"))}
    pictures = {frame.number: frame
                for frame in postfx.read_sequence(str(folder / "reference.####.exr"))}
    numbers = sorted(pictures)
    factor = pictures[numbers[0]].exposure_factor or grey_factor(pictures[numbers[0]][Role.COLOUR])
    for first in (0, 1):
        shown = numbers[first::2]
        frames = [without_middle(noisy.get(n), noisy.get(n - 1), pictures[n], n == shown[0])
                  for n in shown]
        for k, (before, after) in enumerate(zip(frames, frames[1:], strict=False)):
            later = frames[k + 2] if k + 2 < len(frames) else None
            wanted = pictures[shown[k] + 1][Role.COLOUR]
            h, w = wanted.shape[:2]
            back, on = (motion_at(noisy[shown[k] + step][Role.MOTION], np.arange(h), np.arange(w),
                                  h, w)
                        for step in (1, 2))
            yield Gap(before, after, later, frames[k - 1] if k else None, wanted, factor,
                      (back, on))


def without_middle(noisy: Frame, middle: Frame | None, picture: Frame, first: bool) -> Frame:
    """The picture with planes of its size, and motion over two frames instead of one."""
    motion, depth = noisy[Role.MOTION], noisy[Role.DEPTH]
    h, w = motion.shape[:2]
    if middle is not None:
        y, x = np.indices((h, w), np.float32)
        u, v = x + motion[..., 0], y + motion[..., 1]
        inside = (u > -0.5) & (u < w - 0.5) & (v > -0.5) & (v < h - 0.5)
        u, v = u.clip(0, w - 1).ravel(), v.clip(0, h - 1).ravel()
        onwards, there = (bilinear(middle[role], u, v).reshape(h, w, -1)
                          for role in (Role.MOTION, Role.DEPTH))
        # else hidden there: it goes straight on
        same = inside[..., None] & (np.abs(there - depth) < ALIKE * depth)
        motion = motion + np.where(same, onwards, motion)
    times = picture[Role.COLOUR].shape[0] // h
    larger = {role: plane.repeat(times, 0).repeat(times, 1)
              for role, plane in ((Role.MOTION, motion * times), (Role.DEPTH, depth),
                                  (Role.SPECULAR_HIT_DISTANCE,
                                   noisy.planes.get(Role.SPECULAR_HIT_DISTANCE)))
              if plane is not None}
    return Frame({Role.COLOUR: picture[Role.COLOUR], **larger}, number=picture.number, reset=first,
                 fov_x=noisy.fov_x)


def moved(picture: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The picture taken from where motion leads."""
    h, w = picture.shape[:2]
    y, x = np.indices((h, w), np.float32)
    u, v = (x + motion[..., 0]).clip(0, w - 1).ravel(), (y + motion[..., 1]).clip(0, h - 1).ravel()
    return bilinear(picture, u, v).reshape(picture.shape)


def blend(gap: Gap) -> np.ndarray:
    return (gap.before[Role.COLOUR] + gap.after[Role.COLOUR]) / 2


def warp(gap: Gap) -> np.ndarray:
    """The frame before, taken from half way along the motion of the frame after."""
    return moved(gap.before[Role.COLOUR], gap.after[Role.MOTION] / 2)


def flow(gap: Gap, kind: str) -> np.ndarray:
    """Both frames, each from half way along OpenCV's flow between display pictures."""
    grey = [np.uint8(255 * to_codes(frame[Role.COLOUR], gap.exposure_factor).mean(-1))
            for frame in (gap.before, gap.after)]
    found = []
    for one, other, frame in ((*grey, gap.before), (*grey[::-1], gap.after)):
        field = (cv2.calcOpticalFlowFarneback(one, other, None, 0.5, 5, 21, 5, 7, 1.5, 0)
            if kind == "farneback" else
            cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(one, other, None))
        found.append(moved(frame[Role.COLOUR], -field / 2))
    return (found[0] + found[1]) / 2


def flicker_of(gap: Gap, shown: np.ndarray, wanted: np.ndarray) -> float:
    """Mean flicker of the steps to the new picture and from it, where motion explains the rendered
    ones; else NaN."""
    before, after = (Pictures(codes, codes) for codes in
                     (to_codes(frame[Role.COLOUR], gap.exposure_factor)
                      for frame in (gap.before, gap.after)))
    new = Pictures(shown, wanted)
    found = flicker(before, new, gap.steps[0]), flicker(new, after, gap.steps[1])
    return float(np.mean([np.nan if one is None else one for one in found]))


def between(gap: Gap, **options: bool) -> np.ndarray:
    last = (None if gap.earlier is None
            else postfx.Between(gap.earlier, gap.before, gap.after, **options))
    return postfx.Between(gap.before, gap.after, gap.later, last=last,
                          **options).frame(0.5)[Role.COLOUR]


METHODS: dict[str, Callable[[Gap], np.ndarray]] = {
    "blend": blend, "warp": warp,
    **{kind: lambda gap, kind=kind: flow(gap, kind) for kind in FLOWS},
    "postfx, no flow": lambda gap: between(gap, flow=False), "postfx": between}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("folders", nargs="*", type=Path, default=[ROOM])
    parser.add_argument("--most", type=int, default=99, help="frames to make of each folder")
    parser.add_argument("--picture",
                        help="write: blend, postfx, rendered, of the second frame of the last "
                        "folder")
    arguments = parser.parse_args()
    print(f"{'sequence':<14}{'method':<18}{'PSNR':>7}{'SSIM':>8}{'FLIP':>8}{'flicker':>9}"
          f"{'light %':>9}{'CPU s':>7}")
    for folder in arguments.folders:
        made = list(islice(gaps(folder), arguments.most))
        for name, method in METHODS.items():
            rows = []
            for gap in made:
                begin = time.process_time()
                colour = method(gap)
                seconds = time.process_time() - begin
                shown, wanted = (to_codes(one, gap.exposure_factor) for one in (colour, gap.wanted))
                light = 100 * (colour.mean() / gap.wanted.mean() - 1)
                rows.append((psnr(shown, wanted), ssim(shown, wanted), flip(shown, wanted),
                             flicker_of(gap, shown, wanted), light, seconds))
            means = np.nanmean(rows, 0)
            print(f"{folder.resolve().name:<14}{name:<18}{means[0]:>7.2f}{means[1]:>8.4f}"
                  f"{means[2]:>8.4f}{means[3]:>9.2f}{means[4]:>9.2f}{np.median(rows, 0)[5]:>7.2f}")
    if arguments.picture:
        gap = made[min(1, len(made) - 1)]
        codes = [to_codes(one, gap.exposure_factor)
                 for one in (blend(gap), between(gap), gap.wanted)]
        image = oiio.ImageBuf(np.ascontiguousarray(np.concatenate(codes, 1), np.float32))
        if not image.write(arguments.picture, "uint8"):
            raise SystemExit(image.geterror())


if __name__ == "__main__":
    main()
