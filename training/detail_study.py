"""Does detail beyond the render size come back? A slow pan of jittered frames, known exactly, enlarged twice.

python -m training.detail_study -o OUT [--model m,s] [--frames 16] [--noise 0.5]     needs postfx[bench], no renderer

    python -m training.detail_study -o out/detail --model m,s
    python -m training.detail_study -o out/clean --noise 0       # is it the noise?
    python -m training.detail_study -o out/still --pan 0,0       # is it the resampling of what moves?

The scene (training.detail_scene) has three parts: fine detail in the albedo, the same in the light, and shadows' edges.
Methods:

    cubic               the frame as rendered but without noise, cubic interpolation that knows the jitter
    perfect + cubic     the mean over every render pixel's area, without noise, enlarged by cubic interpolation: what a
                        perfect denoiser at render size could give
    all samples kept    the mean of all noise-free samples so far in each output pixel, at their exact places
    accumulation        noisy frames, cubic interpolation, motion-compensated mean
    OIDN + cubic        Open Image Denoise, high quality, at render size; beside it the same accumulated
    TAG; TAG, alone     our network with its history, and with the history dropped at every frame

Figures of each frame and part: PSNR of what is seen, and, of luminance in linear light beyond the render size's limit,
`share`, the part of the reference's amplitude that is there (a projection: 1 all, 0 none, noise adds nothing in the
mean), and `coherence`, the correlation with the reference (1: nothing but its detail). Interpolation does not end
sharply at the limit, so that every frame leaves a share, under 0.25; what it takes for coarser detail costs PSNR only.
Writes OUT/detail.json, detail.png (figures over frames) and detail_crops.png (the last frame).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from training.detail_plots import FIGURES, Pictures, draw_crops, plot
from training.detail_scene import PARTS, SCALE, Kept, Scene, View

TILE, EDGE = 64, 16
LIMIT = 0.5 / SCALE
"""Nyquist frequency of the render size, cycles an output pixel."""
PERFECT, KEPT = "perfect + cubic", "all samples kept"

class Detail(NamedTuple):
    """Of the reference's detail beyond the limit: the share that a picture has, and its correlation with it."""

    share: float
    coherence: float


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--results", type=Path, required=True, metavar="OUT")
    parser.add_argument("--model", default="m", help="tags of networks, comma-separated; crops are of the first")
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--noise", type=float, default=0.5,
                        help="deviation of a pixel's light over its mean: 1 as of one light path, 0.5 of four, 0 none")
    parser.add_argument("--pan", type=_pair, default="0.31,0.13", help="x,y, render pixels a frame")
    parser.add_argument("--no-oidn", action="store_true", help="leave Open Image Denoise out")
    parser.add_argument("--device", default="auto")
    args = parser.parse_args(argv)
    if args.frames < 2:
        parser.error("--frames: give at least 2")
    return args


def _pair(text: str) -> tuple[float, float]:
    x, y = map(float, text.split(","))
    return x, y


def band() -> np.ndarray:
    """1 for the frequencies (TILE, TILE) of `numpy.fft.fft2` that one frame's pixels cannot hold.

    Those of more than LIMIT along x or along y; two steps more, because the Hann window spreads each over two steps.
    """
    frequency = np.abs(np.fft.fftfreq(TILE))
    return (np.maximum(frequency, frequency[:, None]) >= LIMIT + 2 / TILE).astype(float)


def spectra(picture: np.ndarray) -> np.ndarray:
    """Band-limited spectra (N, TILE, TILE) of luminance (H, W): tiles that overlap by half, Hann window, no mean."""
    tiles = np.lib.stride_tricks.sliding_window_view(picture, (TILE, TILE))[:: TILE // 2, :: TILE // 2]
    tiles = tiles.reshape(-1, TILE, TILE).astype(np.float64)
    window = np.hanning(TILE + 1)[:-1]
    return np.fft.fft2((tiles - tiles.mean((1, 2), keepdims=True)) * window * window[:, None]) * band()


def detail(picture: np.ndarray, reference: np.ndarray) -> Detail:
    """Of two luminances (H, W), both sides at least TILE; a picture without any detail has a coherence of 0."""
    found, wanted = spectra(picture), spectra(reference)
    both, own, whole = ((a * b.conj()).real.sum() for a, b in ((found, wanted), (found, found), (wanted, wanted)))
    return Detail(float(both / whole), float(both / np.sqrt(max(own * whole, 1e-30))))


def parts(scene: Scene, t: int) -> dict[str, tuple[slice, slice]]:
    """Where the parts are in frame `t` at output size, without what lies EDGE pixels from their borders."""
    rows, bounds = slice(EDGE, SCALE * scene.size[0] - EDGE), scene.bounds(t)
    columns = [slice(round(SCALE * start) + EDGE, round(SCALE * end) - EDGE) for start, end in bounds]
    return {part: (rows, column) for part, column in zip(PARTS, columns, strict=True)}


def methods(args: argparse.Namespace, scene: Scene) -> Callable[[View], Pictures]:
    """What turns a view into pictures (H, W, 3) by method; views must come in order."""
    import postfx
    from postfx.bench.methods import OTHERS, Method
    from postfx.bench.reconstruct import make
    from postfx.frame import Frame, Role

    device = postfx.Device(args.device)
    size = (SCALE * scene.size[0], SCALE * scene.size[1])
    wanted = {"accumulation": "accumulation"}
    if find_spec("pyoidn") and not args.no_oidn:
        wanted |= {"OIDN + cubic": "oidn-high", "OIDN accumulated": "oidn-high-accumulated"}
    known = {item.name: item for item in OTHERS}
    found = {title: known[name] for title, name in wanted.items()}
    for tag in args.model.split(","):
        found |= {f"{tag}, alone": Method(tag, tag, "ours", tag, alone=True), tag: Method(tag, tag, "ours", tag)}
    ways = {title: make(item, device, SCALE, size) for title, item in found.items()}
    enlarge, kept = make(known["bicubic"], device, SCALE, size), Kept(scene)

    def run(view: View) -> Pictures:
        h, w = scene.size
        mean = view.reference.reshape(h, SCALE, w, SCALE, 3).mean((1, 3))
        pictures = {"cubic": enlarge(view.clean), PERFECT: enlarge(Frame({Role.COLOUR: mean}))}
        pictures[KEPT] = kept(view, pictures[PERFECT])
        return pictures | {title: way(view.noisy) for title, way in ways.items()}

    return run


def rows_of(pictures: Pictures, reference: np.ndarray, where: dict[str, tuple[slice, slice]], frame: int,
            exposure: float) -> Iterator[dict[str, Any]]:
    """A row of figures for each method and part."""
    from postfx.bench.metrics import LUMINANCE, psnr, shown

    for method, picture in pictures.items():
        for part, at in where.items():
            found = detail(picture[at] @ LUMINANCE, reference[at] @ LUMINANCE)
            yield {"frame": frame, "method": method, "part": part,
                   "psnr": psnr(shown(picture[at], exposure), shown(reference[at], exposure)), **found._asdict()}


def late(rows: list[dict[str, Any]], frames: int) -> dict[str, dict[str, dict[str, float]]]:
    """Method -> part -> mean figures over the second half of the frames."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for method, part in dict.fromkeys((row["method"], row["part"]) for row in rows):
        own = [row for row in rows if (row["method"], row["part"]) == (method, part) and row["frame"] > frames // 2]
        found.setdefault(method, {})[part] = {key: float(np.mean([row[key] for row in own])) for key in FIGURES}
    return found


def table(summary: dict[str, dict[str, dict[str, float]]]) -> Iterator[str]:
    """Lines of text."""
    for part in PARTS:
        yield f"{part + ', second half of the frames':44}" + "".join(f"{key:>12}" for key in FIGURES)
        for method, found in summary.items():
            yield f"    {method:40}" + "".join(f"{value:12.3f}" for value in found[part].values())


def main(argv: list[str] | None = None) -> None:
    args = arguments(argv)
    from postfx.bench.metrics import grey_exposure
    from postfx.frame import Role

    scene = Scene(args.pan, args.noise)
    run, rows, exposure = methods(args, scene), [], None
    for t in range(args.frames):
        view = scene.view(t)
        exposure = exposure or grey_exposure(view.reference)
        pictures = run(view)
        rows += rows_of(pictures, view.reference, parts(scene, t), t + 1, exposure)
        print(f"frame {t + 1} of {args.frames}", file=sys.stderr, flush=True)
    args.results.mkdir(parents=True, exist_ok=True)
    summary, tag = late(rows, args.frames), args.model.split(",")[0]
    facts = {"frames": args.frames, "noise": args.noise, "pan": args.pan, "late": summary, "rows": rows}
    (args.results / "detail.json").write_text(json.dumps(facts, indent=1) + "\n")
    title = f"pan {args.pan[0]:g}, {args.pan[1]:g} pixels a frame, noise {args.noise:g}"
    plot(rows, title, args.results / "detail.png")
    columns = {"input": view.noisy[Role.COLOUR].repeat(SCALE, 0).repeat(SCALE, 1)}
    columns |= {name: pictures[name] for name in (PERFECT, f"{tag}, alone", tag, KEPT)} | {"reference": view.reference}
    draw_crops(columns, scene, args.frames - 1, exposure, args.results / "detail_crops.png")
    print("\n".join(table(summary)))


if __name__ == "__main__":
    main()
