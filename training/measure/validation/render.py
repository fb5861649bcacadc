"""Render one clip of the validation set. Import after Mitsuba's variant is set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from postfx.colour.displays import srgb_encode
from training.datagen.clip import Style, filter_table, guide_frame, noisy_frame, radical_inverse
from training.datagen.clip_file import GUIDES, HALF_MAX, exposure_of, first_only
from training.datagen.held_out import FIRST_SEED, HeldOut, Kind, held_out_view
from training.datagen.tracing import Tracer
from training.measure.validation.clips import (
    FULL,
    GUIDE_SPP,
    HALF,
    SCENES,
    STYLES,
    Planes,
    Render,
    renders,
)

LEAST_SPP = 64


@dataclass(frozen=True)
class Options:
    """`size` (width, height) of the output; a reference's samples bring its error after x/(1+x) to
    `error`.

    Views that would need more than `most_spp` are skipped. `batch` light paths are traced at a
    time.
    """

    size: tuple[int, int] = (384, 216)
    frames: int = 8
    error: float = 0.004
    most_spp: int = 8192
    batch: int = 1 << 25


def render_clip(tracer: Tracer, index: int, options: Options,
                tell: Callable[[str], None]) -> tuple[np.ndarray, dict[str, Planes],
                                                      dict[str, Any]]:
    """References (T, H, W, 3), planes (T, h, w, C) of every render, and facts, for `clips.save`.

    Calls `tell` with progress messages.
    """
    kind, cut = _kind(index, options.frames)
    half_width = HALF.size(options.size)[0]
    view = held_out_view(tracer, FIRST_SEED + index, half_width, options.error, options.most_spp,
                         kind)
    spp = max(LEAST_SPP, int(view.samples)) // 2 * 2
    styles = {render: _style(index, render, options.frames) for render in renders(index)}
    halves, frames = [], []
    for t in range(options.frames):
        tell(f"{view.name}, reference of {spp} samples, frame {t + 1} of {options.frames}")
        view.built.move(t, t - 1)
        halves.append([_reference(tracer, view, t, spp // 2, options) for _ in range(2)])
        frames.append(_noisy(tracer, view, t, styles, options.size))
    stacked = {name: {plane: np.stack([frame[name][plane] for frame in frames]) for plane in planes}
               for name, planes in frames[0].items()}
    a, b = (np.stack(half) for half in zip(*halves, strict=True))
    reference = (a + b) / 2
    exposure = exposure_of(reference)
    cameras, reset = [view.path.at(t) for t in range(options.frames)], first_only(options.frames)
    if cut:
        reset[cut] = 1
    facts = {
        "scene": view.name, "trait": SCENES[index % len(SCENES)][1], "seed": FIRST_SEED + index,
        "gain": view.gain,
        "style": STYLES[index % len(STYLES)], "reference_spp": spp, "exposure": exposure,
        "reference_noise": _noise(a, b, exposure), "size": options.size, "reset": reset.tolist(),
        "to_world": [camera.to_world.tolist() for camera in cameras],
        "fov": [camera.fov for camera in cameras],
        "renders": {render.name: {"scale": render.scale, "spp": render.spp,
                                  "jitter": style.jitter.tolist()}
                    for render, style in styles.items()},
    }
    return reference, stacked, facts


def light_paths(facts: dict[str, Any], frames: int) -> int:
    """Camera samples that a clip took."""
    pixels = facts["size"][0] * facts["size"][1]
    noisy = sum(render["spp"] / render["scale"] ** 2 for render in facts["renders"].values())
    return int(frames * pixels * (facts["reference_spp"] + noisy))


def _kind(index: int, frames: int) -> tuple[Kind, int | None]:
    """The kind of a clip's scene, and the frame that a cut leads to."""
    family, trait = SCENES[index % len(SCENES)]
    cut = max(1, frames // 2 - 1) if trait == "cut" else None
    return Kind(family, None if cut else trait, cut, frames), cut


def _style(index: int, render: Render, frames: int) -> Style:
    kind = STYLES[index % len(STYLES)]
    halton = [[radical_inverse(t + 1, 2), radical_inverse(t + 1, 3)] for t in range(frames)]
    jitter = (np.array(halton, np.float32) - 0.5 if kind == "realtime"
              else np.zeros((frames, 2), np.float32))
    return Style(kind, render.spp, jitter)


def _reference(tracer: Tracer, view: HeldOut, t: int, spp: int, options: Options) -> np.ndarray:
    seed = int(view.rng.integers(1 << 31))
    light = tracer.reference(view.built.scene, view.path.at(t), options.size, filter_table("box"),
                             spp, seed, options.batch)
    return np.minimum(view.gain * light, HALF_MAX)


def _noisy(tracer: Tracer, view: HeldOut, t: int, styles: dict[Render, Style],
           output: tuple[int, int]) -> dict[str, Planes]:
    """One frame of every render, and guides unless they are the full-size frame's own planes."""
    cameras, made = (view.path.at(t), view.path.at(t - 1)), {}
    for render, style in styles.items():
        made[render.name] = noisy_frame(tracer, view.built, cameras, render.size(output), style, t,
                                        view.gain, view.rng)
    if styles[FULL].kind != "realtime":
        spread = Style(styles[FULL].kind, GUIDE_SPP, styles[FULL].jitter)
        guides = guide_frame(tracer, view.built, cameras, output, spread, t, view.rng)
        made["guides"] = {name: guides[name] for name in GUIDES}
    return made


def _noise(a: np.ndarray, b: np.ndarray, exposure: float) -> list[float]:
    """Mean square error (T) of the displayed mean of two independent halves: a quarter of their
    difference's square."""
    seen = [srgb_encode(exposure * half / (1 + exposure * half)) for half in (a, b)]
    return [float(value) for value in np.square(seen[0] - seen[1]).mean((1, 2, 3)) / 4]
