"""Measure looks, as the run-time computes them, against the colour pipelines that they reproduce.

    python -m training.tonemap.evaluate aces2 local -o looks.json \\
        --photos 'hdr/*.exr' 'shot/reference.0001.exr'
        [--panoramas 'env/*.hdr'] [--sequences DIR...] [--report]
    python -m training.tonemap.evaluate local auto --following --side 320 \\
        --photos 'hdr/*.exr' 'shot/reference.0001.exr'

A look is a tag, or the file of a model. Each picture is exposed by the run-time's meter and shrunk
to at most --side pixels. Per picture: PSNR, SSIM and FLIP of sRGB code values, mean Delta E ITP
(ITU-R BT.2124, white at 100 cd/m2). Then the charts of `training.tonemap.checks`, and the
steadiness of sequences. --report writes the results into docs/lab/tonemap.md and makes its
pictures, for the looks measured now and those already in -o.

--following measures how fast looks with a network follow light that changes, at once (steps) or
evenly (ramps of a stop); it prints the least and the greatest value over the pictures.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import torch

from postfx.exposure import measure
from postfx.frame import Frame, Role
from postfx.kernels.colour import APPLY_CUBE
from postfx.kernels.tonemap import SLICE_APPLY
from postfx.passes.tonemap import ToneMap, find_tone_mapper, shaper
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.tools.bench.metrics import flip, psnr, ssim
from postfx.tools.look_table import delta_e_itp
from training.measure.quality_report.document import Block, compose, number, parse, table
from training.tonemap.checks import (
    SRGB,
    STEPS,
    Maker,
    Render,
    exposed_frames,
    flicker,
    greys,
    halo,
    nearest_exposure,
    sweep,
)
from training.tonemap.looks import Look, View, bake, exact_target, exact_view, look_from
from training.tonemap.model import default_shaper, look_up, shape
from training.tonemap.pairs import fit_cube
from training.tonemap.pictures import find_pictures, shrink

# The report ---------------------------------------------------------------------------------------
# Measurements of looks as tables and pictures of docs/lab/tonemap.md.

TILE, GAP, LOUD = 200, 4, 8.0  # height of a tile and the gap, in pixels; factor of the errors shown
MOST = 5  # pictures in a strip
Found = dict[str, dict[str, Any]]


def pictures_table(found: Found, look: str) -> str:
    """Figures of each picture."""
    heads = ["picture", "PSNR (dB)", "SSIM", "FLIP", "Delta E ITP"]
    rows = found[look]["pictures"].items()
    return table(heads, ([row_name(name, row), number(row["psnr"], ".1f"),
                          number(row["ssim"], ".3f"), number(row["flip"], ".3f"),
                          number(row["delta_e_itp"], ".2f")] for name, row in rows))


def looks_table(found: Found) -> str:
    """Means over the pictures that a look was not trained on, and the lowest PSNR."""
    heads = ["look", "PSNR (dB)", "lowest", "SSIM", "FLIP", "Delta E ITP"]
    return table(heads, ([f"`{look}`", *_means(one["pictures"])] for look, one in found.items()))


def _means(pictures: dict[str, dict[str, Any]]) -> list[str]:
    held = [row for row in pictures.values() if row["held_out"]]
    mean = {key: float(np.mean([row[key] for row in held]))
            for key in ("psnr", "ssim", "flip", "delta_e_itp")}
    lowest = min(row["psnr"] for row in held)
    return [number(mean["psnr"], ".1f"), number(lowest, ".1f"), number(mean["ssim"], ".3f"),
            number(mean["flip"], ".3f"), number(mean["delta_e_itp"], ".2f")]


def checks_table(found: Found) -> str:
    """Figures of the charts."""
    heads = ["look", "grey chroma", "fall", "rough", "halo", "hue flips", "in range"]
    keys = ("chroma", "fall", "rough", "halo")
    return table(heads, ([f"`{look}`", *(number(one["checks"][key], ".2f") for key in keys),
                          number(100 * one["checks"]["hue_flips"], ".2f", " %"),
                          "yes" if one["checks"]["in_range"] else "no"]
                         for look, one in found.items()))


def flicker_table(found: Found) -> str:
    """Flicker of each look and of its references on sequences, and contrast of the first two."""
    heads = ["look", "sequence", "look", "nearest static curve", "its mean held still",
             "its view alone",
             "pipeline, frame by frame", "nearest cube", "contrast", "of the static curve"]
    keys = ("look", "static", "still", "view", "pipeline", "cube")
    return table(heads, ([f"`{look}`", name.replace("_", " "),
                          *(_figure(row.get(key), "flicker") for key in keys),
                          *(_figure(row[key], "contrast") for key in ("look", "static"))]
                         for look, one in found.items() for name, row in one["flicker"].items()))


def _figure(figures: dict[str, float] | None, key: str) -> str:
    return number(figures[key], ".2f") if figures else "-"


def row_name(name: str, row: dict[str, Any]) -> str:
    return name.replace("_", " ") + ("" if row["held_out"] else " (trained on)")


MAKERS: dict[str, Callable[..., str]] = {
    "looks": looks_table, "pictures": pictures_table, "checks": checks_table,
    "flicker": flicker_table,
}


def write_report(doc: Path, found: Found) -> None:
    """Replace the tables of a document; looks that were not measured keep theirs."""
    parts, made = parse(doc.read_text(encoding="utf-8"), doc, MAKERS), {}
    for block in (part for part in parts if isinstance(part, Block)):
        if all(look in found for look in block.arguments):
            made[block.line] = MAKERS[block.name](found, *block.arguments)
    doc.write_text(compose(parts, made), encoding="utf-8")


def strip(pairs: list[tuple[np.ndarray, np.ndarray]], path: Path) -> None:
    """Write a picture with one column a pair: the look (H,W,3), its reference, and their amplified
    difference."""
    columns = [_column(*(shrink(x, round(TILE * max(x.shape) / len(x))) for x in pair))
               for pair in pairs[:MOST]]
    height = min(len(column) for column in columns)
    padded = [np.pad(column[:height], ((0, 0), (0, GAP), (0, 0)), constant_values=1.0)
              for column in columns]
    path.parent.mkdir(parents=True, exist_ok=True)
    image = oiio.ImageBuf(np.ascontiguousarray(np.round(np.concatenate(padded, 1) * 255)
                                               .astype(np.uint8)))
    image.specmod()["CompressionQuality"] = 90
    image.write(str(path))


def _column(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    error = np.minimum(np.abs(found - wanted) * LOUD, 1.0)
    gap = np.ones((GAP, found.shape[1], 3), found.dtype)
    return np.concatenate([found, gap, wanted, gap, error])


# The evaluation -----------------------------------------------------------------------------------

REPOSITORY = Path(__file__).resolve().parents[2]


class Mapper:
    """A look as the run-time computes it, for pictures of any size.

    keep: share of the last grid that is kept in steady light; None takes it from the look's card.
    """

    def __init__(self, tag: str, keep: float | None = None) -> None:
        self._device, self._tag, self._keep = Device("cpu"), tag, keep
        self._pipelines: dict[Any, Any] = {}
        library, model = find_tone_mapper(tag)
        self.name, self.card = model.removeprefix("tonemap."), library.card(model)

    def __call__(self, rgb: np.ndarray) -> np.ndarray:
        """Exposed scene-linear (H,W,3) to sRGB code values, without a past."""
        return self.follow(Frame({Role.COLOUR: np.ascontiguousarray(rgb, np.float32)}, reset=True))

    def follow(self, frame: Frame) -> np.ndarray:
        """The look of the next frame of a sequence, which is already exposed."""
        size = frame[Role.COLOUR].shape
        if size not in self._pipelines:
            passes = [ToneMap(look=self._tag, keep=self._keep)]
            self._pipelines[size] = Pipeline(passes, self._device, exposure=0.0, cuts="none")
        return self._pipelines[size](frame)[Role.COLOUR].copy()

    def smooth_state(self, frame: Frame) -> np.ndarray:
        """The smoothed grid (1,16,16,8,12), or exposure (3,) as in `postfx.kernels.tonemap`, of the
        next frame of a sequence, which is already exposed."""
        self.follow(frame)
        return self._pipelines[frame[Role.COLOUR].shape].passes[0].history()["held"].copy()

    def hold(self, kept: np.ndarray) -> Render:
        """The look with a constant grid or exposure."""
        library, model = find_tone_mapper(self._tag)
        constants = self._device.pipeline_state(library, model).constants
        numbers = shaper(library, model)
        params = np.array([1.0, numbers.toe, numbers.scale], np.float32)

        def render(rgb: np.ndarray) -> np.ndarray:
            output = np.empty_like(rgb)
            if "guide" in constants:
                given = rgb, params, numbers.matrix, constants["guide"], kept, constants["cube"]
                SLICE_APPLY.rows(0, len(rgb), *given, output)
            else:
                APPLY_CUBE.rows(0, len(rgb), rgb, kept, numbers.matrix, constants["cube"], output)
            return output

        return render


def compare(out: np.ndarray, wanted: np.ndarray) -> dict[str, float]:
    return {
        "psnr": round(psnr(out, wanted), 2),
        "ssim": round(ssim(out, wanted), 4),
        "flip": round(flip(out, wanted), 4),
        "delta_e_itp": round(float(delta_e_itp(out, wanted, SRGB).mean()), 2),
    }


def steadiness(mapper: Mapper, look: Look, folder: Path) -> dict[str, dict[str, float]]:
    """Flicker and contrast of a look with its history, and of its references; also the PSNR of the
    look's last frame against the pipeline, in dB.

    References: `static`, the nearest static curve, is the look's view after one exposure for the
    whole sequence; `view` is the view after the look's own gain; `pipeline` is the look's
    definition, frame by frame. For looks with a network,
    too: `still`, the look with its constant mean grid or exposure; `cube`, the colour cube nearest
    to the look's frames.
    """
    frames = list(exposed_frames(folder))
    light = [frame[Role.COLOUR] for frame in frames]
    shown = [mapper.follow(frame) for frame in frames]
    static = nearest_exposure(look.view, light, shown)
    renders: dict[str, Render] = {
        "static": lambda rgb: exact_view(look.view, rgb * np.float32(2.0**static)),
        "view": lambda rgb: exact_view(look.view, rgb * np.float32(2.0**look.gain)),
        "pipeline": lambda rgb: exact_target(rgb, look),
    }
    if not look.is_global:
        renders["still"] = mapper.hold(np.mean([mapper.smooth_state(frame) for frame in frames], 0))
        renders["cube"] = nearest_cube(look.view, light, shown)
    makers: dict[str, Maker] = {"look": mapper.follow}
    for name, render in renders.items():
        makers[name] = partial(_render_colour, render)
    figures = flicker(folder, makers, "view")
    figures["look"]["psnr"] = round(psnr(shown[-1], exact_target(light[-1], look)), 2)
    return figures


def _render_colour(render: Render, frame: Frame) -> np.ndarray:
    return render(frame[Role.COLOUR])


def nearest_cube(view: View, light: list[np.ndarray], shown: list[np.ndarray]) -> Render:
    """The static colour cube that is nearest, by least squares, to a look's frames."""
    colours = np.concatenate([shape_picture(x)[0].flatten(1).T.numpy() for x in light])
    cube = torch.from_numpy(fit_cube(colours, np.concatenate(shown).reshape(-1, 3), bake(view)))
    return lambda rgb: look_up(shape_picture(rgb), cube)[0].permute(1, 2, 0).numpy()


def shape_picture(rgb: np.ndarray) -> torch.Tensor:
    """Shaped colour (1,3,H,W), the cube's input, from exposed scene-linear (H,W,3)."""
    return shape(torch.from_numpy(rgb).permute(2, 0, 1)[None], *default_shaper())


def examine(mapper: Mapper, look: Look, pictures: dict[str, np.ndarray],
            args: argparse.Namespace) -> dict[str, Any]:
    """All figures of one look."""
    reference: Render = lambda rgb: exact_target(rgb, look)  # noqa: E731
    trained, rows, strips = set(mapper.card["training"]["pictures"]), {}, []
    for name, rgb in pictures.items():
        out, wanted = mapper(rgb), reference(rgb)
        rows[name] = compare(out, wanted) | {"held_out": name.split(".")[0] not in trained}
        strips.append((out, wanted))
        print(mapper.name, name, rows[name], flush=True)
    if args.report:
        strip(strips, args.images / f"{mapper.name}.jpg")
    checks = greys(mapper, reference) | sweep(mapper, reference, next(iter(pictures.values())))
    checks["halo"] = halo(mapper, reference)
    print(mapper.name, checks, flush=True)
    steady = {Path(x).name: steadiness(mapper, look, Path(x)) for x in args.sequences}
    return {"pictures": rows, "checks": checks, "flicker": steady}


# Following the light ------------------------------------------------------------------------------

STEPPED = (0.5, 1.0, 3.0)  # stops, up and down
RAMPS = (24, 96)  # frames that a stop takes
LONGEST = 200  # frames after which a step is given up
LEFT = 0.1  # of the way


def frames_of_step(mapper: Mapper, picture: np.ndarray, stops: float) -> int:
    """Frames until a tenth of the way is left, in code values, from the changed light under the
    last grid or exposure to the look without a past. At most LONGEST."""
    stepped = picture * np.float32(2.0**stops)
    wanted, last = mapper(stepped), mapper.smooth_state(_frame(picture, 0))
    way = np.abs(mapper.hold(last)(stepped) - wanted).mean()
    for count in range(1, LONGEST):
        if np.abs(mapper.follow(_frame(stepped, count)) - wanted).mean() <= LEFT * way:
            return count
    return LONGEST


def measure_lag(mapper: Mapper, alone: Mapper, picture: np.ndarray, frames: int) -> float:
    """Greatest lag of a look behind itself without a past (`alone`) in a ramp of a stop: mean steps
    of 8 bits."""
    return STEPS * max(float(np.abs(mapper.follow(_frame(light, k)) - alone(light)).mean())
                       for k, light in enumerate(_ramp(picture, frames)))


def _ramp(picture: np.ndarray, frames: int) -> Iterator[np.ndarray]:
    return (picture * np.float32(2.0 ** (number / frames)) for number in range(frames + 1))


def _frame(light: np.ndarray, number: int) -> Frame:
    return Frame({Role.COLOUR: light}, number=number, reset=not number)


def span(values: Iterable[float]) -> str:
    """Least to most."""
    found = sorted(values)
    return f"{found[0]:.3g} to {found[-1]:.3g}"


def print_following(tag: str, pictures: dict[str, np.ndarray]) -> None:
    """How fast a look follows steps and ramps."""
    mapper = Mapper(tag)
    alone = Mapper(tag)
    lights = [np.ascontiguousarray(rgb) for rgb in pictures.values()]
    for stops in STEPPED:
        frames = span(frames_of_step(mapper, rgb, way * stops) for rgb in lights for way in (-1, 1))
        print(f"{tag}: a step of {stops:g} stops is followed in {frames} frames", flush=True)
    for length in RAMPS:
        print(f"{tag}: lags by {span(measure_lag(mapper, alone, rgb, length) for rgb in lights)} "
              f"code values in a ramp of a stop in {length} frames", flush=True)


# The command --------------------------------------------------------------------------------------

def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("looks", nargs="*",
                        help="tags, or files of models; none: only write the report")
    parser.add_argument("-o", "--output", type=Path,
                        help="JSON file; keeps the other looks that it holds")
    parser.add_argument("--photos", nargs="*", default=[], help="HDR pictures (patterns)")
    parser.add_argument("--panoramas", nargs="*", default=[],
                        help="equirectangular HDR environments (patterns)")
    parser.add_argument("--sequences", nargs="*", default=[],
                        help="folders of reference.####.exr and noisy.####.exr")
    parser.add_argument("--side", type=int, default=640)
    parser.add_argument("--following", action="store_true",
                        help="only print how fast looks follow light that changes")
    parser.add_argument("--report", action="store_true",
                        help="write docs/lab/tonemap.md and its pictures")
    parser.add_argument("--print", action="store_true", help="print the tables, too")
    parser.add_argument("--doc", type=Path, default=REPOSITORY / "docs/lab/tonemap.md")
    parser.add_argument("--images", type=Path, default=REPOSITORY / "docs/images/tonemap")
    args = parser.parse_args()
    if not args.output and not args.following:
        parser.error("name the JSON file to write with -o, or give --following")
    pictures = find_pictures(args.photos, args.panoramas, args.side)
    if args.looks and not pictures:
        parser.error("no pictures to compare looks on: give --photos or --panoramas")
    pictures = {name: rgb * np.float32(2.0 ** (measure(rgb) or 0.0))
                for name, rgb in pictures.items()}
    if args.following:
        for tag in args.looks:
            print_following(tag, pictures)
        return
    found = json.loads(args.output.read_text()) if args.output.exists() else {}
    for tag in args.looks:
        mapper = Mapper(tag)
        if "view" not in mapper.card["look"]:
            raise SystemExit(f"{tag}: was made from pairs of pictures: there is no pipeline to "
                             "compare it with")
        found[mapper.name] = examine(mapper, look_from(mapper.card["look"]), pictures, args)
        args.output.write_text(json.dumps(found, indent=2) + "\n")
    if args.report:
        write_report(args.doc, found)
    if args.print:
        print("\n".join([looks_table(found), checks_table(found), flicker_table(found),
                         *(pictures_table(found, look) for look in found)]))


if __name__ == "__main__":
    main()
