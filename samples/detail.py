"""Does detail beyond the render size come back? A slow pan of jittered frames, known exactly,
enlarged twice.

python samples/detail.py [--models m,s] [--frames 16] [--noise 0.5] [--pan 0.31,0.13] \\
    [--subsamples 8]

Needs the extra 'bench'.

A plane has three parts: fine detail in the albedo, the same in the light, and edges of shadows.
Methods:

    cubic             the frame without noise, cubic interpolation that knows the jitter
    perfect + cubic   the mean over every render pixel, without noise, enlarged: what a perfect
                      denoiser could give
    all samples kept  the mean of all noise-free samples so far in each output pixel, at their exact
                      places
    accumulation      noisy frames, cubic interpolation, motion-compensated mean
    OIDN + cubic      Open Image Denoise, high quality, at the render size; beside it the same
                      accumulated
    TAG; TAG, alone   a network with its history, and with the history dropped at every frame

Prints a table of the second half of the frames: PSNR as seen, and of luminance beyond the render
size's Nyquist frequency `share`, the part of the reference's amplitude that is there, and
`coherence`, the correlation with it.
"""
import argparse
from collections.abc import Callable
from importlib.util import find_spec
from itertools import pairwise
from typing import NamedTuple

import numpy as np

import postfx
from postfx import Frame, Role, integrate
from postfx.colour.views import to_codes
from postfx.tools.bench.methods import OTHERS, Method, make
from postfx.tools.bench.metrics import LUMINANCE_WEIGHTS, grey_factor, psnr

PARTS = ("albedo", "light", "shadow edges")
PATCH, COARSE, SCALE, SPECULAR = 64, 4, 2, 0.04
PART = 2 * PATCH
HEIGHT, WIDTH = PART, len(PARTS) * PART
BARS, STROKE = (0.55, 0.65, 0.75, 0.85), 0.75
DIGITS = (0x7B6F, 0x2C97, 0x73E7, 0x73CF, 0x5BC9, 0x79CF, 0x79EF, 0x7292, 0x7BEF, 0x7BCF)
TILE, EDGE = 64, 16


def pattern(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """0..1 at points, in render pixels: patches with a star, a zone plate, slanted bars and digits.

    Too fine for the render size are the star's centre, the zone plate's rim, all bars (BARS cycles
    a pixel) and the digits, whose strokes are STROKE pixels wide.
    """
    column, row = np.floor(x / PATCH).astype(int), np.floor(y / PATCH).astype(int)
    from_left, from_top = x - column * PATCH, y - row * PATCH
    u, v = from_left - PATCH / 2, from_top - PATCH / 2
    radius = np.hypot(u, v)
    star = np.where((radius < 6) | (radius > 31), 0.5, np.cos(72 * np.arctan2(v, u)) > 0)
    plate = np.where(radius < 31, 0.5 + 0.5 * np.cos(np.pi * 0.9 / 32 * radius * radius), 0.5)
    line = (from_top / (PATCH / 4)).astype(int)
    angle = 0.2 + 0.5 * np.pi * (line % 2)
    along = u * np.cos(angle) + v * np.sin(angle)
    bars = np.cos(2 * np.pi * np.array(BARS)[line] * along) > 0
    stroke, step = (from_left / STROKE).astype(int), (from_top / STROKE).astype(int)
    across, down = stroke // 4, step // 6
    cell = across * 7 + down * 5 + across * down % 3
    place = 14 - 3 * (step % 6) - stroke % 4
    shown = np.array(DIGITS)[cell % 10] >> np.maximum(place, 0) & 1
    digits = np.where((stroke % 4 > 2) | (step % 6 > 4), 1, 1 - shown)
    return np.choose(column % 2 + 2 * (row % 2), (star, plate, bars, digits)).astype(float)


class View(NamedTuple):
    """One frame: as rendered, the same without noise, and the truth (H, W, 3) at output size."""

    noisy: Frame
    clean: Frame
    reference: np.ndarray


def sampled(t: int, pan: tuple[float, float], scale: int,
            offset: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse albedo (h, w, 3) and light (h, w, 1) at one point of each pixel, `offset` (x, y) from
    its centre."""
    x = (np.arange(scale * WIDTH) + 0.5 + offset[0]) / scale + t * pan[0]
    y = (np.arange(scale * HEIGHT)[:, None] + 0.5 + offset[1]) / scale + t * pan[1]
    wide = x >= 2 * PART
    u, v = 0.75 * PATCH + (x - 2 * PART) / COARSE, 1.25 * PATCH + y / COARSE  # bars beside digits
    detail = pattern(np.where(wide, u, x), np.where(wide, v, y))[..., None]
    lit, even = x[:, None] >= PART, 1 + 0.2 * np.sin(2 * np.pi * y / 97)[..., None]
    return (np.where(lit, 0.6, 0.06 + 0.74 * detail) * np.array([1, 0.92, 0.8]),
            np.where(lit, 0.15 + 0.85 * detail, 0.7) * even)


def view(t: int, pan: tuple[float, float], noise: float, subsamples: int) -> View:
    """Frame `t`, counted from 0, of a plane that moves by `pan` (x, y) render pixels a frame to the
    left and up.

    `noise` is the deviation of a pixel's light over its mean: 0.5 is that of four paths of
    exponential light. The truth is the mean of `subsamples` squared points of an output pixel.
    """
    jitter = integrate.halton(t + 1, 2) - 0.5, integrate.halton(t + 1, 3) - 0.5
    albedo, light = sampled(t, pan, 1, jitter)
    random = np.random.default_rng([t, 1])
    lit = light * random.gamma(noise**-2, noise**2, light.shape) if noise else light
    steps = (np.arange(subsamples) + 0.5) / subsamples - 0.5
    fine = [sampled(t, pan, SCALE, (x, y)) for x in steps for y in steps]
    reference = np.mean([(albedo + SPECULAR) * light for albedo, light in fine],
                        0).astype(np.float32)
    shared = {Role.DIFFUSE_ALBEDO: albedo,
              Role.SPECULAR_ALBEDO: np.full((HEIGHT, WIDTH, 3), SPECULAR),
              Role.ROUGHNESS: np.ones((HEIGHT, WIDTH, 1)),
              Role.DEPTH: np.full((HEIGHT, WIDTH, 1), 4.0),
              Role.NORMAL: np.broadcast_to([0.0, 0.0, 1.0], (HEIGHT, WIDTH, 3)),
              Role.MOTION: np.broadcast_to(pan, (HEIGHT, WIDTH, 2))}
    noisy, clean = (Frame({Role.COLOUR: (albedo + SPECULAR) * each} | shared, number=t + 1,
                          jitter=jitter)
                    for each in (lit, light))
    return View(noisy, clean, reference)


def kept(frames: list[Frame], pan: tuple[float, float], filling: np.ndarray) -> np.ndarray:
    """The mean of all samples of the frames in each output pixel, at their exact places; empty
    pixels are filled."""
    height, width = filling.shape[:2]
    total, count = np.zeros((height * width, 3)), np.zeros(height * width)
    for frame in frames:
        moved = [frame.jitter[i] - (frames[-1].number - frame.number) * pan[i] for i in range(2)]
        x = np.floor((np.arange(WIDTH) + 0.5 + moved[0]) * SCALE).astype(int)
        y = np.floor((np.arange(HEIGHT)[:, None] + 0.5 + moved[1]) * SCALE).astype(int)
        inside = ((x >= 0) & (x < width) & (y >= 0) & (y < height)).ravel()
        at = (y * width + x).ravel()[inside]
        np.add.at(total, at, frame[Role.COLOUR].reshape(-1, 3)[inside])
        np.add.at(count, at, 1)
    mean = (total / np.maximum(count, 1)[:, None]).reshape(filling.shape)
    return np.where(count.reshape(height, width, 1) > 0, mean, filling).astype(np.float32)


def spectra(picture: np.ndarray) -> np.ndarray:
    """Spectra of luminance (H, W) beyond the render size's limit: tiles that overlap by half, Hann
    window, no mean."""
    tiles = np.lib.stride_tricks.sliding_window_view(picture,
                                                     (TILE, TILE))[:: TILE // 2, :: TILE // 2]
    tiles = tiles.reshape(-1, TILE, TILE).astype(np.float64)
    window, frequency = np.hanning(TILE + 1)[:-1], np.abs(np.fft.fftfreq(TILE))
    # the window spreads two steps
    beyond = np.maximum(frequency, frequency[:, None]) >= 0.5 / SCALE + 2 / TILE
    return (np.fft.fft2((tiles - tiles.mean((1, 2), keepdims=True)) * window * window[:, None])
            * beyond)


def share_and_coherence(picture: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Of the reference's detail: the share that a picture has, and its correlation with it, of
    luminances (H, W)."""
    found, wanted = spectra(picture), spectra(reference)
    both, own, whole = ((a * b.conj()).real.sum()
                        for a, b in ((found, wanted), (found, found), (wanted, wanted)))
    return float(both / whole), float(both / np.sqrt(max(own * whole, 1e-30)))


def methods(models: list[str]) -> dict[str, Callable[[Frame], np.ndarray]]:
    """What turns frames, in order, into pictures (H, W, 3), by name."""
    known = {method.name: method for method in OTHERS}
    wanted = {"cubic": known["bicubic"], "accumulation": known["accumulation"]}
    if find_spec("pyoidn"):
        wanted |= {"OIDN + cubic": known["oidn-high"],
                   "OIDN accumulated": known["oidn-high-accumulated"]}
    for tag in models:
        wanted |= {f"postfx {tag}, alone": Method(tag, tag, "ours", tag, alone=True),
                   f"postfx {tag}": Method(tag, tag, "ours", tag)}
    device = postfx.Device("cpu")
    return {name: make(method, device, SCALE, (SCALE * HEIGHT, SCALE * WIDTH))
            for name, method in wanted.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default="m,s")
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--noise", type=float, default=0.5)
    parser.add_argument("--pan", type=lambda text: tuple(map(float, text.split(","))),
                        default=(0.31, 0.13))
    parser.add_argument("--subsamples", type=int, default=8,
                        help="points of a reference's pixel, along each side")
    arguments = parser.parse_args()
    ways, frames, figures = methods(arguments.models.split(",")), [], {}
    exposure = 0.0
    for t in range(arguments.frames):
        noisy, clean, reference = view(t, arguments.pan, arguments.noise, arguments.subsamples)
        exposure, frames = exposure or grey_factor(reference), [*frames, clean]
        mean = reference.reshape(HEIGHT, SCALE, WIDTH, SCALE, 3).mean((1, 3))
        pictures = {name: way(clean if name == "cubic" else noisy) for name, way in ways.items()}
        pictures["perfect + cubic"] = ways["cubic"](Frame({Role.COLOUR: mean}))
        pictures["all samples kept"] = kept(frames, arguments.pan, pictures["perfect + cubic"])
        ends = [0, *(i * PART - t * arguments.pan[0] for i in range(1, len(PARTS))), WIDTH]
        if t < arguments.frames // 2:
            continue
        for name, picture in pictures.items():
            for part, (start, end) in zip(PARTS, pairwise(ends), strict=True):
                at = np.s_[EDGE:-EDGE, round(SCALE * start) + EDGE: round(SCALE * end) - EDGE]
                seen = psnr(to_codes(picture[at], exposure), to_codes(reference[at], exposure))
                found = share_and_coherence(picture[at] @ LUMINANCE_WEIGHTS,
                                            reference[at] @ LUMINANCE_WEIGHTS)
                figures.setdefault(name, {}).setdefault(part, []).append((seen, *found))
    print(f"| method | {' | '.join(f'{part}: PSNR, share, coherence' for part in PARTS)} "
          f"|\n|{' --- |' * 4}")
    for name in sorted(figures, key=lambda name: ("cubic" not in name or "OIDN" in name,
                                                  "kept" not in name)):
        means = (np.mean(found, axis=0) for found in figures[name].values())
        cells = " | ".join(
            f"{seen:.2f} dB, {share:.2f}, {match:.2f}" for seen, share, match in means)
        print(f"| {name} | {cells} |")


if __name__ == "__main__":
    main()
