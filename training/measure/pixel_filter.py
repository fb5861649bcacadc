"""What noise costs that a renderer's pixel filter spreads over several pixels, and what undoing the
filter saves.

    python -m training.measure.pixel_filter FOLDER [--kinds water,fog] [--samples 4,16]
        [--stddevs 0.35,0.5] [--mitsuba]

FOLDER holds one folder for each kind, as for `training.measure.table`. Cycles draws samples by its
pixel filter, so the noise of neighbouring pixels is independent. Mitsuba's gaussian filter (its
default has a standard deviation of half a pixel), Arnold's and others add each sample to several
pixels. Here a gaussian of each width is applied to the planes that renderers filter, of the noisy
frames and of the references. --mitsuba adds Mitsuba's own Cornell box with its default filter.

Printed are PSNR in dB, over all frames, of the noisy input; of `m`, of `xl` and of Open Image
Denoise, at the better of prefiltered planes and none, all without regard to the filter; of `xl` as
it runs by default, and of the pass `oidn`, which find the filter in the noise and undo it; and of
`xl` on the frames before the filter, with the filter applied to its result: what could be had where
all is known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from postfx import DenoiseUpscale, Device, Frame, Oidn, Pipeline
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.io.sequence import Sequence
from postfx.pixel_filter import FILTERED_ROLES
from postfx.tools.bench.baselines import Oidn as PlainOidn
from training.measure.table import Shot, numbers, parser_of_kinds, shots, words

FILTER_REACH_PX = 2
"""Pixels to each side that the filter covers."""
OIDN_WAYS = ("prefiltered", "none")
METHOD_COLUMNS = ("input", "m", "xl", "oidn", "xl_undone", "oidn_undone", "before")
BOX_SIZE_PX = 320, 192
"""Columns and rows of Mitsuba's box."""
BOX_SAMPLES = 4, 16
"""Samples a pixel of Mitsuba's box."""
BOX_REFERENCE_SAMPLES = 1024

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
    return replace(frame, planes={role: spread(plane, stddev) if role in FILTERED_ROLES else plane
                                  for role, plane in frame.planes.items()})


class Case(NamedTuple):
    """Frames of a shot, the same before the filter where there are such, and their references."""

    name: str
    filtered: list[Frame]
    before: list[Frame]
    references: list[np.ndarray]


def spread_case(shot: Shot, stddev: float) -> Case:
    """A shot after a gaussian filter."""
    noisy, references = Sequence(shot.noisy), Sequence(shot.reference)
    before = [noisy.read(number) for number in noisy.numbers]
    wanted = [references.read(number, [Role.COLOUR])[Role.COLOUR] for number in noisy.numbers]
    return Case(f"{shot.kind} {shot.samples} {stddev:g}",
                [spread_frame(frame, stddev) for frame in before], before,
                [spread(picture, stddev) for picture in wanted])


def mitsuba_cases() -> Iterator[Case]:
    """Mitsuba's Cornell box with its default filter: a frame of each number of samples."""
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    from training.measure.validation.mitsuba_box import build

    scene = build(1)
    width, height = BOX_SIZE_PX
    scene["sensor"]["film"] |= {"rfilter": {"type": "gaussian"}, "pixel_format": "rgb",
                                "component_format": "float32", "width": width, "height": height}
    scene["integrator"] = {"type": "aov", "aovs": "albedo:albedo,normal:sh_normal,depth:depth",
                           "light": {"type": "path", "max_depth": 6}}
    box = mitsuba.load_dict(scene)

    def render(samples: int) -> np.ndarray:
        return np.array(mitsuba.render(box, spp=samples, seed=samples), np.float32)

    reference = render(BOX_REFERENCE_SAMPLES)[..., :3]
    for samples in BOX_SAMPLES:
        found = render(samples)
        planes = {Role.COLOUR: found[..., :3], Role.DIFFUSE_ALBEDO: found[..., 3:6],
                  Role.NORMAL: found[..., 6:9], Role.DEPTH: found[..., 9:10]}
        yield Case(f"box {samples}", [Frame(planes)], [], [reference])


def measure(case: Case, threads: int) -> dict[str, float]:
    """PSNR in dB of a shot, by columns; NaN where there are no frames before the filter."""
    device = Device("cpu", threads)
    pipelines = {name: Pipeline([step], device) for name, step in (
        ("m", DenoiseUpscale(scale=1.0, model="m")),
        ("xl", DenoiseUpscale(scale=1.0, model="xl", pixel_filter="none")),
        ("xl_undone", DenoiseUpscale(scale=1.0, model="xl")), ("oidn_undone", Oidn()))}
    before = Pipeline([DenoiseUpscale(scale=1.0, model="xl", pixel_filter="none")], device)
    oidn = [PlainOidn("high", "cpu", threads, way) for way in OIDN_WAYS]
    errors: dict[str, list[float]] = {name: [] for name in METHOD_COLUMNS}
    for index, (frame, wanted) in enumerate(zip(case.filtered, case.references, strict=True)):
        found = {name: pipeline(frame)[Role.COLOUR].copy() for name, pipeline in pipelines.items()}
        exposure = pipelines["xl"].exposure_factor or 1.0
        found["input"] = frame[Role.COLOUR]
        if case.before:
            alone = before(case.before[index])[Role.COLOUR]
            found["before"] = spread(alone, float(case.name.split()[2]))

        def error(picture: np.ndarray, wanted: np.ndarray = wanted,
                  exposure: float = exposure) -> float:
            difference = to_codes(picture, exposure) - to_codes(wanted, exposure)
            return float(np.square(difference).mean())

        for name, picture in found.items():
            errors[name].append(error(picture))
        errors["oidn"].append(min(error(denoise(frame)) for denoise in oidn))
    return {name: float(-10 * np.log10(np.mean(values))) if values else np.nan
            for name, values in errors.items()}


def main(argv: list[str] | None = None) -> None:
    parser = parser_of_kinds(__doc__)
    parser.add_argument("--samples", type=numbers, default=[4, 16], help="default: 4,16")
    parser.add_argument("--stddevs", type=words, default="0.5",
                        help="of the filter, in pixels (default: 0.5)")
    parser.add_argument("--mitsuba", action="store_true", help="also Mitsuba's own Cornell box")
    given = parser.parse_args(argv)
    wanted = list(shots(given.folder, words(given.kinds), ["1x"], given.samples))
    if not wanted:
        parser.error(f"{given.folder} holds no kinds with references: "
                     "training/measure/validation/render_scenes.py makes them")
    print(f"{'':16} {' '.join(f'{name:>11}' for name in METHOD_COLUMNS)}")
    for stddev in map(float, given.stddevs):
        rows = []
        for shot in wanted:
            case = spread_case(shot, stddev)
            rows.append(measure(case, given.threads))
            print(line(case.name, rows[-1]), flush=True)
        means = {name: float(np.mean([row[name] for row in rows])) for name in METHOD_COLUMNS}
        print(line(f"mean {stddev:g}", means), flush=True)
    for case in mitsuba_cases() if given.mitsuba else ():
        print(line(case.name, measure(case, given.threads)), flush=True)


def line(name: str, row: dict[str, float]) -> str:
    """A row of the table."""
    return f"{name:16} " + " ".join(f"{'-':>11}" if np.isnan(row[column])
                                    else f"{row[column]:11.2f}" for column in METHOD_COLUMNS)


if __name__ == "__main__":
    main()
