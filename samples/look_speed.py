"""Time the looks on the CPU: a tone-mapped frame with eight dithered bits, from light to what a file holds.

    python samples/look_speed.py [--width 1920] [--height 1080] [--runs 20] [--threads 2]

Prints medians and, in brackets, the least: milliseconds of the call, and of all cores together. The second also holds
where other programs take the cores. The picture is the room's, enlarged, with noise; compressing a file is not counted.
"""
import argparse
import statistics
import time
from pathlib import Path

import numpy as np

import postfx
from postfx.io.dither import Dither, quantise
from postfx.runtime import Device

LOOKS = ("aces2", "agx", "pbr_neutral", "local", "auto")
ROOM = Path(__file__).parent / "room" / "reference.####.exr"


def picture(height: int, width: int) -> np.ndarray:
    """The room (height, width, 3) by its nearest pixels, scene-linear; noise, so that neighbours differ."""
    room = next(iter(postfx.read_sequence(ROOM)))[postfx.Role.COLOUR]
    rows, columns = (np.arange(size) * given // size for size, given in zip((height, width), room.shape, strict=False))
    noise = np.random.default_rng(1).uniform(0.9, 1.1, (height, width, 3))
    return (room[rows[:, None], columns] * noise).astype(np.float32)


def timed(chain: postfx.Pipeline, colour: np.ndarray, number: int) -> tuple[float, float]:
    """Milliseconds of a frame, and of all cores."""
    began = time.perf_counter(), time.process_time()
    shown = chain(postfx.Frame({postfx.Role.COLOUR: colour}, number=number))
    quantise(shown[postfx.Role.COLOUR], 8, Dither.MOVING, number)
    return 1e3 * (time.perf_counter() - began[0]), 1e3 * (time.process_time() - began[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1080)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    colour, device = picture(args.height, args.width), Device("cpu", threads=args.threads)
    for look in LOOKS:
        chain = postfx.Pipeline([postfx.ToneMap(tag=look)], device)
        times = [timed(chain, colour, number) for number in range(args.runs + 2)][2:]
        calls, cores = ([f"{fold(one):6.1f}" for fold in (statistics.median, min)] for one in zip(*times, strict=True))
        print(f"{look:12} call {calls[0]} ms ({calls[1]})   all cores {cores[0]} ms ({cores[1]})")


if __name__ == "__main__":
    main()
