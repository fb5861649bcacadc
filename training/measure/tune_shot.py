"""What `postfx tune` gains on a shot, on frames of which it has seen no clean pixel.

    python -m training.measure.tune_shot WORK NAME NOISY --references REFERENCES [--clean 2] \\
        [--model xl] [--minutes 10]
    python -m training.measure.tune_shot WORK NAME NOISY --references REFERENCES --halves OTHER \\
        [--model xl] [--minutes 10]

Without --halves the network learns from tiles of 16 pixels of the references of the frames --clean,
at random places, 3 % of the shot's pixels, and is judged on the other frames. With --halves it
learns from a second render alone, and is judged on all frames. References of twice the size are
averaged. Prints PSNR in dB and FLIP of the network as it ships and tuned, over the whole shot. A
network that is in WORK is not trained again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from postfx import DenoiseUpscale, Device, Pipeline, read_sequence
from postfx.bench.metrics import flip, grey_factor, psnr
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.io.sequence import Sequence
from postfx.io.writer import write_channels

TILE = 16
"""Side of the clean tiles, pixels."""
SAMPLES = 1024
"""Samples that the plane of counts gives to clean pixels; only whether there are any matters."""
SEED = 3


def reference_of(sequence: Sequence, number: int, height: int) -> np.ndarray:
    """A reference (height, width, 3), averaged to this height."""
    colour = sequence.read(number, [Role.COLOUR])[Role.COLOUR]
    factor = colour.shape[0] // height
    rows, columns = height, colour.shape[1] // factor
    mean: np.ndarray = colour.reshape(rows, factor, columns, factor, 3).mean(axis=(1, 3))
    return mean


def write_tiles(references: dict[int, np.ndarray], count: int, folder: Path) -> str:
    """Write references of which only so many tiles, in all together, have samples; returns their
    pattern."""
    random = np.random.default_rng(SEED)
    places = [(number, y, x) for number, colour in references.items()
              for y in range(colour.shape[0] // TILE) for x in range(colour.shape[1] // TILE)]
    chosen = [places[index] for index in random.permutation(len(places))[:count]]
    for number, colour in references.items():
        counts = np.zeros(colour.shape[:2])
        for _, y, x in (place for place in chosen if place[0] == number):
            counts[y * TILE : (y + 1) * TILE, x * TILE : (x + 1) * TILE] = SAMPLES
        planes = {name: colour[..., axis] * (counts > 0) for axis, name in enumerate("RGB")}
        write_channels(folder / f"clean.{number:04}.exr", planes | {"sample_count.Y": counts})
    return f"{folder}/clean.####.exr"


def tune(noisy: str, target: list[str], network: Path,
         given: argparse.Namespace) -> dict[str, Any]:
    """Run `postfx tune`; returns what it tells."""
    words = [sys.executable, "-m", "training.denoise.tune", noisy, *target, "-o", str(network),
             "--model", given.model, "--minutes", str(given.minutes), "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode > 1:
        raise SystemExit(done.stderr)
    facts: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return facts


def score(shot: Sequence, references: dict[int, np.ndarray], model: str) -> np.ndarray:
    """PSNR and FLIP of the frames with references, by frame (frames, 2), of a network that runs
    over the shot."""
    pipeline, found = Pipeline([DenoiseUpscale(scale=1.0, model=model)], Device("cpu")), []
    exposure = grey_factor(next(iter(references.values())))
    for frame in shot:
        colour = pipeline(frame)[Role.COLOUR]
        if frame.number in references:
            codes, wanted = (to_codes(light, exposure).astype(np.float32)
                             for light in (colour, references[frame.number]))
            found.append((psnr(codes, wanted), flip(codes, wanted)))
    return np.array(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("name")
    parser.add_argument("noisy", help="pattern of the shot's frames")
    parser.add_argument("--references", required=True, help="pattern of their references")
    parser.add_argument("--halves", help="pattern of a second render")
    parser.add_argument("--clean", default="2",
                        help="frames with clean tiles, by commas (default: 2)")
    parser.add_argument("--share", type=float, default=0.03,
                        help="of clean pixels in the shot (default: 0.03)")
    parser.add_argument("--model", default="xl", choices=("xl", "m", "s"))
    parser.add_argument("--minutes", type=float, default=10)
    given = parser.parse_args()
    shot = read_sequence(given.noisy)
    clean = read_sequence(given.references)
    height, width = shot.read(shot.numbers[0])[Role.COLOUR].shape[:2]
    references = {number: reference_of(clean, number, height) for number in shot.numbers}
    folder = given.work / f"{given.name}_{given.model}{'_halves' * bool(given.halves)}"
    folder.mkdir(parents=True, exist_ok=True)
    if given.halves:
        target = ["--halves", given.halves]
    else:
        seen = [int(word) for word in given.clean.split(",")]
        count = round(given.share * len(shot) * height * width / TILE**2)
        target = ["--references",
                  write_tiles({number: references[number] for number in seen}, count, folder)]
        references = {number: colour for number, colour in references.items() if number not in seen}
    network = folder / "tuned.onnx"
    facts = (json.loads(network.with_suffix(".json").read_text())["training"] if network.exists()
        else tune(given.noisy, target, network, given))
    shipped = given.model if given.model == "xl" else f"{given.model}.fp32"
    before = score(shot, references, shipped).mean(axis=0)
    after = score(shot, references, str(network)).mean(axis=0) if network.exists() else before
    print(f"{given.name} from {facts['target']}: {facts['steps']} steps in {facts['minutes']:.1f} "
          f"minutes, held back {facts['gain_db']:+.2f} dB, "
          f"{'written' if network.exists() else 'not written'}; {len(references)} frames: "
          f"{given.model} {before[0]:.2f} dB {before[1]:.4f}, tuned {after[0]:.2f} dB "
          f"{after[1]:.4f}, gain {after[0] - before[0]:+.2f} dB", flush=True)


if __name__ == "__main__":
    main()
