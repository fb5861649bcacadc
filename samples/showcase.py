"""The README's and the gallery's product shot: a full frame before and after, crops beside OIDN, a
video, and figures.

    python samples/showcase.py FOLDER OUT [--name showcase] [--places 310,105 490,70] [--side 79]
                               [--rendered "4 samples" --reference "80 samples"]

FOLDER holds noisy.####.exr and reference.####.exr, as `training/measure/validation/showcase.py`
renders them. They are denoised as `postfx run` does it by default. The last frame that has a
reference is shown and measured; a larger reference is averaged to the frame's size.

Writes OUT/NAME.jpg, the video OUT/NAME.webp, and for the gallery's sliders OUT/NAME_noisy.jpg,
NAME_oidn.jpg and NAME_postfx.jpg. Prints PSNR and FLIP behind the display curve of `postfx bench`.
"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from pictures import (
    below,
    beside,
    crops,
    means_of_blocks,
    name_columns,
    name_corner,
    split,
)
from PIL import Image

import postfx
from postfx.frame import Frame, Role
from postfx.tools.bench.metrics import psnr, to_codes

NETWORK = "xl"
"""What `postfx run` takes at the render's size."""
ZOOM = 3
FRAME_TIME = 125
"""Milliseconds of a frame of the video."""
QUALITY, VIDEO_QUALITY = 88, 60


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--name", default="showcase")
    parser.add_argument("--places", nargs="+", type=place, default=[(310, 105), (490, 70)],
                        help="left upper corners of the enlarged crops, in pixels")
    parser.add_argument("--side", type=int, default=79, help="pixels along a side of the crops")
    parser.add_argument("--rendered", default="as rendered", help="what the noisy one is named")
    parser.add_argument("--reference", default="many samples", help="and the reference")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    references = list(postfx.read_sequence(args.folder / "reference.####.exr"))
    sequence = postfx.read_sequence(args.folder / "noisy.####.exr")
    shot = [frame for frame in sequence if frame.number <= references[-1].number]
    reference = at_size(references[-1], shot[-1])
    exposure = auto_exposure(reference)
    ways = {"noisy": [], "oidn": [postfx.Oidn()],
            "postfx": [postfx.DenoiseUpscale(scale=1, model=NETWORK)]}
    light = {name: run(passes, shot if name != "oidn" else shot[-1:], exposure, sequence)
             for name, passes in ways.items()}
    print(f"{'as rendered':28} {figures(light['noisy'][-1], reference, exposure)}")
    print(f"{'Open Image Denoise':28} {figures(light['oidn'][-1], reference, exposure)}")
    print(f"{f'postfx, network {NETWORK}':28} {figures(light['postfx'][-1], reference, exposure)}")
    codes = {name: [shown(frame, exposure) for frame in frames] for name, frames in light.items()}
    last = {name: pictures[-1] for name, pictures in codes.items()}
    for name, one in last.items():
        save(one).save(args.out / f"{args.name}_{name}.jpg", quality=QUALITY)
    four = [*last.values(), shown(reference, exposure)]
    names = (args.rendered, "Open Image Denoise", "postfx", args.reference)
    # the clean side is the left one: noise makes lights look brighter than they are
    picture = below([name_corner(name_corner(split(last["postfx"], last["noisy"]), "postfx"),
                                 args.rendered, "right"),
                     name_columns(names, args.side * ZOOM),
                     crops(four, args.places, args.side, ZOOM)])
    save(picture).save(args.out / f"{args.name}.jpg", quality=QUALITY)
    pairs = [save(beside(pair)).reduce(2)
             for pair in zip(codes["noisy"], codes["postfx"], strict=True)]
    pairs[0].save(args.out / f"{args.name}.webp", save_all=True,
                  append_images=pairs[1:] + pairs[-2:0:-1],
                  duration=FRAME_TIME, loop=0, quality=VIDEO_QUALITY, method=4)


def place(text: str) -> tuple[int, int]:
    x, y = text.split(",")
    return int(x), int(y)


def at_size(reference: Frame, frame: Frame) -> Frame:
    """A reference at the frame's size, by means of whole blocks of pixels."""
    return Frame({Role.COLOUR: means_of_blocks(reference[Role.COLOUR],
                                               frame[Role.COLOUR].shape[0])})


def run(passes: list[postfx.Pass], shot: list[Frame], exposure: float,
        sequence: postfx.Sequence) -> list[Frame]:
    """Frames of a shot after some passes, with the run-up of its sequence."""
    pipeline = postfx.Pipeline(passes, exposure=exposure, run_up=postfx.RunUp(sequence))
    return list(map(pipeline, shot)) if passes else shot


def auto_exposure(frame: Frame) -> float:
    """Stops by the meter of `--exposure auto`."""
    pipeline = postfx.Pipeline([postfx.ToneMap()], exposure="auto")
    pipeline(frame)
    return pipeline.exposure or 0.0


def figures(frame: Frame, reference: Frame, exposure: float) -> str:
    """PSNR and FLIP behind the display curve."""
    from flip_evaluator import evaluate

    one, other = (to_codes(each[Role.COLOUR], 2.0**exposure) for each in (frame, reference))
    _, flip, _ = evaluate(other.astype(np.float32), one.astype(np.float32), "LDR")
    return f"PSNR {psnr(one, other):.2f} dB  FLIP {flip:.4f}"


def shown(frame: Frame, exposure: float) -> np.ndarray:
    """Code values by the default look."""
    light = Frame({Role.COLOUR: frame[Role.COLOUR]})
    return postfx.Pipeline([postfx.ToneMap()], exposure=exposure)(light)[Role.COLOUR]


def save(codes: np.ndarray) -> Image.Image:
    return Image.fromarray((np.clip(codes, 0, 1) * 255 + 0.5).astype(np.uint8))


if __name__ == "__main__":
    main(sys.argv[1:])
