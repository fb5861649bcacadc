"""What noise costs that a renderer's pixel filter spreads over several pixels.

    python -m training.measure.pixel_filter FOLDER [--kinds water,fog] [--samples 4,16]
        [--stddev 0.5]

FOLDER holds one folder for each kind, as for `training.measure.table`. Cycles draws samples by its
pixel filter, so the noise of neighbouring pixels is independent. Mitsuba's gaussian filter (its
default has a standard deviation of half a pixel), Arnold's and others add each sample to several
pixels. Here a gaussian of that width is applied to the planes that renderers filter, of the noisy
frames and of the references. Printed are PSNR in dB, over all frames, of the noisy input, of `m`,
of `xl`, of Open Image Denoise at the better of prefiltered planes and none, and of `xl` on the
frames before the filter, with the filter applied to its result: so well a denoiser could do that
undid the filter first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from postfx import DenoiseUpscale, Device, Frame, Pipeline
from postfx.bench.baselines import Oidn
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.io.sequence import Sequence
from training.measure.table import Shot, numbers, parser_of_kinds, shots, words

FILTER_REACH_PX = 2
"""Pixels to each side that the filter covers."""
FILTERED_PLANES = (Role.COLOUR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.NORMAL,
            Role.DENOISING_ALBEDO, Role.DENOISING_NORMAL)
"""Planes that renderers filter."""
OIDN_WAYS = ("prefiltered", "none")
METHOD_COLUMNS = ("input", "m", "xl", "oidn", "undone")

Denoise = Callable[[Frame], np.ndarray]


def spread(plane: np.ndarray, stddev: float) -> np.ndarray:
    """A plane (height, width, channels) after a gaussian pixel filter of this width in pixels."""
    places = np.arange(-FILTER_REACH_PX, FILTER_REACH_PX + 1)
    weights = np.exp(-places**2 / (2 * stddev**2))
    weights /= weights.sum()
    for axis in (0, 1):
        border = [(0, 0)] * 3
        border[axis] = (FILTER_REACH_PX, FILTER_REACH_PX)
        padded = np.pad(plane, border, mode="edge")
        length = plane.shape[axis]
        plane = sum(weight * padded.take(range(first, first + length), axis)
                    for first, weight in enumerate(weights))
    return plane.astype(np.float32)


def spread_frame(frame: Frame, stddev: float) -> Frame:
    """A frame whose filtered planes are spread."""
    return replace(frame, planes={role: spread(plane, stddev) if role in FILTERED_PLANES else plane
                                  for role, plane in frame.planes.items()})


def measure(shot: Shot, stddev: float, threads: int) -> dict[str, float]:
    """PSNR in dB of a shot, by columns."""
    device = Device("cpu", threads)
    pipelines = {name: Pipeline([DenoiseUpscale(scale=1.0, model=model)], device)
                 for name, model in (("m", "m"), ("xl", "xl"), ("undone", "xl"))}
    oidn = [Oidn("high", "cpu", threads, way) for way in OIDN_WAYS]
    errors: dict[str, list[float]] = {name: [] for name in METHOD_COLUMNS}
    noisy, references = Sequence(shot.noisy), Sequence(shot.reference)
    for number in noisy.numbers:
        frame = noisy.read(number)
        filtered = spread_frame(frame, stddev)
        wanted = spread(references.read(number, [Role.COLOUR])[Role.COLOUR], stddev)
        found = {name: pipelines[name](filtered)[Role.COLOUR].copy() for name in ("m", "xl")}
        exposure = pipelines["xl"].exposure_factor or 1.0
        found["input"] = filtered[Role.COLOUR]
        found["undone"] = spread(pipelines["undone"](frame)[Role.COLOUR], stddev)

        def error(picture: np.ndarray, wanted: np.ndarray = wanted,
                  exposure: float = exposure) -> float:
            difference = to_codes(picture, exposure) - to_codes(wanted, exposure)
            return float(np.square(difference).mean())

        for name, picture in found.items():
            errors[name].append(error(picture))
        errors["oidn"].append(min(error(denoise(filtered)) for denoise in oidn))
    return {name: float(-10 * np.log10(np.mean(values))) for name, values in errors.items()}


def main(argv: list[str] | None = None) -> None:
    parser = parser_of_kinds(__doc__)
    parser.add_argument("--samples", type=numbers, default=[4, 16], help="default: 4,16")
    parser.add_argument("--stddev", type=float, default=0.5,
                        help="of the filter, in pixels (default: 0.5)")
    given = parser.parse_args(argv)
    wanted = list(shots(given.folder, words(given.kinds), ["1x"], given.samples))
    if not wanted:
        parser.error(f"{given.folder} holds no kinds with references: "
                     "training/measure/validation/render_scenes.py makes them")
    print(f"{'':12} {' '.join(f'{name:>7}' for name in METHOD_COLUMNS)}")
    rows = []
    for shot in wanted:
        rows.append(measure(shot, given.stddev, given.threads))
        print(line(f"{shot.kind} {shot.samples}", rows[-1]), flush=True)
    means = {name: float(np.mean([row[name] for row in rows])) for name in METHOD_COLUMNS}
    print(line("mean", means))


def line(name: str, row: dict[str, float]) -> str:
    """A row of the table."""
    return f"{name:12} {' '.join(f'{row[column]:7.2f}' for column in METHOD_COLUMNS)}"


if __name__ == "__main__":
    main()
