"""Time the looks: a tone-mapped frame with eight dithered bits, from light to what a file holds.

    python samples/look_speed.py [--width 1920] [--height 1080] [--runs 20] [--threads 2]
    python samples/look_speed.py --device cuda --runs 60

Prints medians and, in brackets, the least and the most: milliseconds of the call, and of all cores
together. The second also holds where other programs take the cores. The picture is the room's,
enlarged, with noise; compressing a file is not counted. On a GPU times are the device's own, of the
look's commands alone: the colour lies there, nothing is copied or dithered.
"""
import argparse
import statistics
import time
from functools import partial
from pathlib import Path

import numpy as np

import postfx
from postfx.io.quantisation import Dither, quantise
from postfx.passes.display import View
from postfx.runtime import Device

LOOKS = {
    **{name: partial(postfx.ToneMap, look=name)
       for name in ("aces2", "agx", "pbr_neutral", "local", "auto")},
    "ocio:, exact": partial(View, view="ocio:"),
    "ocio:, --fast-look": partial(View, view="ocio:", exact=False),
}
ROOM = Path(__file__).parent / "room" / "reference.####.exr"


def picture(height: int, width: int) -> np.ndarray:
    """The room (height, width, 3) by its nearest pixels, scene-linear; noise, so that neighbours
    differ."""
    room = next(iter(postfx.read_sequence(ROOM)))[postfx.Role.COLOUR]
    rows, columns = (np.arange(size) * given // size
                     for size, given in zip((height, width), room.shape, strict=False))
    noise = np.random.default_rng(1).uniform(0.9, 1.1, (height, width, 3))
    return (room[rows[:, None], columns] * noise).astype(np.float32)


def timed(chain: postfx.Pipeline, colour: np.ndarray, number: int) -> dict[str, float]:
    """Milliseconds of a frame, and of all cores; on a GPU, of its commands."""
    began = time.perf_counter(), time.process_time()
    shown = chain(postfx.Frame({postfx.Role.COLOUR: colour}, number=number))
    if not chain.device.memory.host_visible:
        return {"commands": sum(chain.timings.values())}
    quantise(shown[postfx.Role.COLOUR], 8, Dither.MOVING, number)
    return {"call": 1e3 * (time.perf_counter() - began[0]),
            "all cores": 1e3 * (time.process_time() - began[1])}


def summary(times: list[float]) -> str:
    """Median, least and most."""
    middle, least, most = (f"{fold(times):.{3 if fold(times) < 10 else 1}f}"
                           for fold in (statistics.median, min, max))
    return f"{middle:>6} ms ({least} to {most})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1080)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu", help="cpu (default) or cuda")
    args = parser.parse_args()
    colour, device = picture(args.height, args.width), Device(args.device, threads=args.threads)
    unmeasured = 2 if device.memory.host_visible else 20
    for look, make in LOOKS.items():
        chain = postfx.Pipeline([make()], device)
        times = [timed(chain, colour, number)
                 for number in range(unmeasured + args.runs)][unmeasured:]
        print(f"{look:18}",
              "   ".join(f"{name} {summary([one[name] for one in times])}" for name in times[0]))


if __name__ == "__main__":
    main()
