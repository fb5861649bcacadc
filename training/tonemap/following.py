"""How fast a look follows light that changes, with the run-time's own pass.

    python -m training.tonemap.following local auto --photos 'hdr/*.exr' 'shot/reference.0001.exr' [--side 320]

Pictures are exposed by the run-time's meter, then all of their light changes at once (steps), or evenly (ramps of a
stop). Printed are the least and the most over the pictures.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator

import numpy as np

from postfx.exposure import measure
from postfx.frame import Frame, Role
from training.tonemap.checks import STEPS as CODES
from training.tonemap.evaluate import Mapper
from training.tonemap.pictures import find_pictures

STEPPED = (0.5, 1.0, 3.0)  # stops, up and down
RAMPS = (24, 96)  # frames that a stop takes
LONGEST = 200  # frames that a step is waited for
LEFT = 0.1  # of the way


def frames_of_step(mapper: Mapper, picture: np.ndarray, stops: float) -> int:
    """Frames until a tenth of the way is left, in code values, from what the look would make of the changed light with
    its last grid or exposure to what it makes of it without a past. At most LONGEST."""
    stepped = picture * np.float32(2.0**stops)
    wanted, last = mapper(stepped), mapper.kept(_frame(picture, 0))
    way = np.abs(mapper.held(last)(stepped) - wanted).mean()
    for number in range(1, LONGEST):
        if np.abs(mapper.follow(_frame(stepped, number)) - wanted).mean() <= LEFT * way:
            return number
    return LONGEST


def behind(mapper: Mapper, alone: Mapper, picture: np.ndarray, frames: int) -> float:
    """Most that a look is behind itself without a past (`alone`) in a ramp of a stop: mean steps of 8 bits."""
    return CODES * max(float(np.abs(mapper.follow(_frame(light, number)) - alone(light)).mean())
                       for number, light in enumerate(_ramp(picture, frames)))


def _ramp(picture: np.ndarray, frames: int) -> Iterator[np.ndarray]:
    return (picture * np.float32(2.0 ** (number / frames)) for number in range(frames + 1))


def _frame(light: np.ndarray, number: int) -> Frame:
    return Frame({Role.COLOUR: light}, number=number, reset=not number)


def span(values: Iterable[float]) -> str:
    """Least to most."""
    found = sorted(values)
    return f"{found[0]:.3g} to {found[-1]:.3g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("looks", nargs="+", help="tags, or files of models, with a network")
    parser.add_argument("--photos", nargs="+", required=True, help="HDR pictures (patterns)")
    parser.add_argument("--side", type=int, default=320)
    args = parser.parse_args()
    found = find_pictures(args.photos, [], args.side)
    pictures = [np.ascontiguousarray(rgb * np.float32(2.0 ** (measure(rgb) or 0.0))) for rgb in found.values()]
    for tag in args.looks:
        mapper, alone = Mapper(tag), Mapper(tag)
        for stops in STEPPED:
            frames = span(frames_of_step(mapper, rgb, way * stops) for rgb in pictures for way in (-1, 1))
            print(f"{tag}: a step of {stops:g} stops is followed in {frames} frames", flush=True)
        for frames in RAMPS:
            print(f"{tag}: {span(behind(mapper, alone, rgb, frames) for rgb in pictures)} code values behind in a ramp "
                  f"of a stop in {frames} frames", flush=True)


if __name__ == "__main__":
    main()
