"""One clip: a scene, a camera path, references and noisy variants of every frame."""

from __future__ import annotations

import gc
from dataclasses import asdict, dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from training.datagen.clip_file import GUIDES, first_only
from training.datagen.scenes.build import BuiltScene
from training.datagen.scenes.convert import RealScenes
from training.datagen.scenes.draft import Draft, Probe, choose_path
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.motion import Camera, CameraPath, Cut
from training.datagen.scenes.procedural import FINE, draft
from training.datagen.tracing import Film, Tracer

# Samples within a pixel ---------------------------------------------------------------------------
# Sample positions in a pixel: jitter sequences, pixel filters, and the random styles of a clip's
# noisy variants.

TABLE = 1024
FILTERS = ("box", "blackman-harris")


def radical_inverse(index: int, base: int) -> float:
    """Van der Corput radical inverse of `index`, 0..1 (Halton 1960)."""
    value, digit = 0.0, 1.0 / base
    while index:
        value += digit * (index % base)
        index //= base
        digit /= base
    return value


def filter_table(name: str) -> np.ndarray:
    """Inverse cumulative distribution (TABLE,) of a pixel filter: uniform random number -> offset
    from the corner.

    box: 0..1. blackman-harris: width 1.5 pixels about the centre, as Cycles' default pixel filter.
    """
    position = np.linspace(0, 1, TABLE)
    if name == "box":
        return position.astype(np.float32)
    fine = np.linspace(0, 1, 16 * TABLE)
    a = (0.35875, -0.48829, 0.14128, -0.01168)
    density = sum((c * np.cos(2 * np.pi * k * fine) for k, c in enumerate(a)), np.zeros(fine.size))
    cumulative = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)])
    offset = np.interp(position, cumulative / cumulative[-1], fine)
    return (0.5 + 1.5 * (offset - 0.5)).astype(np.float32)


@dataclass(frozen=True)
class Style:
    """Sampling of a noisy variant: `kind` realtime, box or blackman-harris, `spp`, and the jitter
    of each frame (T, 2)."""

    kind: str
    spp: int
    jitter: np.ndarray

    def offsets(self, frame: int, pixels: int, rng: np.random.Generator) -> np.ndarray:
        """Sample positions (pixels, spp, 2) in units of a pixel from its upper left corner."""
        if self.kind == "realtime":
            return np.broadcast_to(0.5 + self.jitter[frame],
                                   (pixels, self.spp, 2)).astype(np.float32)
        drawn = rng.random((pixels, self.spp, 2), np.float32)
        table = filter_table(self.kind)
        return np.interp(drawn, np.linspace(0, 1, TABLE), table).astype(np.float32)


def draw_jitter(frames: int, rng: np.random.Generator) -> np.ndarray:
    """Jitter (frames, 2) in -0.5..0.5: mostly Halton 2,3 from a random start, else random or
    none."""
    pick = rng.random()
    if pick < 0.1:
        return np.zeros((frames, 2), np.float32)
    if pick < 0.25:
        return rng.uniform(-0.5, 0.5, (frames, 2)).astype(np.float32)
    start = int(rng.integers(1, 33))
    halton = [[radical_inverse(start + t, 2), radical_inverse(start + t, 3)] for t in range(frames)]
    return np.array(halton, np.float32) - 0.5


def draw_guide_style(frames: int, pixel_filter: str, rng: np.random.Generator) -> Style:
    """Sampling of a clip's guides: spread like an offline frame, or at one position, jittered or at
    the centre."""
    still = np.zeros((frames, 2), np.float32)
    if rng.random() < 0.4:
        return Style(pixel_filter, 4, still)
    return Style("realtime", 1, draw_jitter(frames, rng) if rng.random() < 0.8 else still)


def draw_spp(rng: np.random.Generator, most: int | None = None) -> int:
    """Samples a pixel: evenly in stops from 1 to `most`; by default mostly 1 to 8, at most 256."""
    if most is not None:
        return round(2 ** rng.uniform(0, np.log2(most)))
    spp = int(rng.choice([1, 2, 3, 4, 6, 8], p=[0.2, 0.25, 0.1, 0.25, 0.08, 0.12]))
    if rng.random() < 0.25:
        spp = int(rng.choice([16, 32, 64, 128, 256], p=[0.3, 0.25, 0.2, 0.15, 0.1]))
    return spp


def draw_styles(count: int, frames: int, pixel_filter: str, rng: np.random.Generator,
                most_spp: int | None = None) -> list[Style]:
    """Styles of a clip's variants: all share the reference's filter; real-time ones occur with the
    box filter only."""
    styles = []
    for _ in range(count):
        spp = draw_spp(rng, most_spp)
        if pixel_filter == "box" and rng.random() < 0.6:
            styles.append(Style("realtime", spp, draw_jitter(frames, rng)))
        else:
            styles.append(Style(pixel_filter, spp, np.zeros((frames, 2), np.float32)))
    return styles


def draw_fine_styles(count: int, frames: int, pixel_filter: str,
                     rng: np.random.Generator) -> tuple[list[Style], str]:
    """Styles of a clip of sub-pixel detail: few samples, spread over the pixel, one render of 64
    that shows the true planes; and of which samples depth and motion are (`Tracer.planes`)."""
    few = rng.choice([2, 3, 4, 6, 8, 16], count - 1, p=[0.1, 0.15, 0.4, 0.15, 0.15, 0.05])
    still = np.zeros((frames, 2), np.float32)
    return ([Style(pixel_filter, int(spp), still) for spp in (*few, 64)],
            str(rng.choice(["", "all", "hits"])))


# A clip -------------------------------------------------------------------------------------------

# mirrors and faces of glass that the planes see through, in clips with primary surface replacement
REPLACED = 4
AVERAGED = ("diffuse_albedo", "specular_albedo", "normal", "roughness")


@dataclass(frozen=True)
class ClipOptions:
    """Sizes and counts; `scales` and `scale_chances` say how often each upscaling factor is drawn.

    References take the samples that are needed for an error of about `reference_error` after
    x/(1+x), between half and four times `reference_spp`. With `even_spp`, noisy renders have 1 to
    that many samples a pixel, evenly in stops. `families` are the kinds of procedural scenes
    (default: drawn).
    """

    width: int = 128
    height: int = 128
    frames: int = 8
    variants: int = 3
    reference_spp: int = 128
    reference_error: float = 0.015
    scales: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0)
    scale_chances: tuple[float, ...] = (0.2, 0.1, 0.6, 0.1)
    real_share: float = 0.25
    cut_share: float = 0.04
    even_spp: int | None = None
    families: tuple[str, ...] = ()


def make_clip(tracer: Tracer, options: ClipOptions, maps: Environments, real: RealScenes, seed: int,
              index: int) -> tuple[np.ndarray, list[dict[str, Any]], dict[str, Any]]:
    """Reference (T, H, W, 3), variants and facts for `save_clip`; the same seed and index give the
    same clip."""
    rng = np.random.default_rng([seed, index])
    drafted, built, path, gain, look = _scene(tracer, options, maps, real, rng)
    description = drafted.description
    path, reset = _cut(tracer, options, drafted, built, path, gain, rng)
    scale = float(rng.choice(options.scales, p=options.scale_chances))
    pixel_filter = FILTERS[int(rng.random() < 0.35)]
    fine = description.name in FINE
    if fine:
        styles, positions = draw_fine_styles(options.variants, options.frames, pixel_filter, rng)
    else:
        styles = draw_styles(options.variants, options.frames, pixel_filter, rng, options.even_spp)
        positions = ""
    size = (options.width, options.height)
    output = (round(options.width * scale), round(options.height * scale))
    wanted = look.samples_for(options.reference_error, gain)
    spp = int(np.clip(wanted, options.reference_spp / 2, 4 * options.reference_spp)) // 16 * 16 or 1
    steps = REPLACED if rng.random() < 0.5 and not fine else 0
    guide_style = draw_guide_style(options.frames, pixel_filter, rng)
    table, references, guides = filter_table(pixel_filter), [], []
    variants: list[list[dict[str, Any]]] = [[] for _ in styles]
    for frame in range(options.frames):
        built.move(frame, frame - 1)
        camera, previous = path.at(frame), path.at(frame - 1)
        references.append(gain * tracer.reference(built.scene, camera, output, table, spp,
                                                  _seed(rng)))
        guides.append(guide_frame(tracer, built, (camera, previous), output, guide_style, frame,
                                  rng, steps))
        for style, frames in zip(styles, variants, strict=True):
            frames.append(noisy_frame(tracer, built, (camera, previous), size, style, frame, gain,
                                      rng, steps, positions))
    meta = {
        "filter": pixel_filter, "gain": gain, "reference_spp": spp, "wanted_spp": wanted,
        "fov": [path.at(f).fov for f in range(options.frames)], **_path_facts(path),
        "movers": len(description.movers), "replaced": steps, "options": asdict(options),
        "to_world": [path.at(f).to_world.tolist() for f in range(options.frames)],
    }
    stacked_guides = {name: np.stack([frame[name] for frame in guides]) for name in GUIDES}
    facts = {"scale": scale, "seed": index, "scene": description.name, "meta": meta,
             "reset": reset, "guides": stacked_guides | {"jitter": guide_style.jitter}}
    stacked = [_stack(frames, style) for frames, style in zip(variants, styles, strict=True)]
    del built
    gc.collect()
    return np.stack(references), stacked, facts


def noisy_frame(tracer: Tracer, built: BuiltScene, cameras: tuple[Camera, Camera],
                size: tuple[int, int], style: Style,
                frame: int, gain: float, rng: np.random.Generator, steps: int = 0,
                positions: str = "") -> dict[str, np.ndarray]:
    """Colour and planes (H, W, C) of one noisy frame; `cameras` are this frame's and the previous
    one's.

    Offline styles average the planes over the samples like renderers. Depth, and motion with the
    box filter, come from the first sample: an average across an edge would belong to neither side.
    """
    film = film_of(size, style.offsets(frame, size[0] * size[1], rng),
                   _lens(cameras[0], size, style.spp, rng))
    colour = tracer.noisy(built.scene, cameras[0], size[0] / size[1], film, style.spp, _seed(rng))
    result = {"colour": gain * colour.reshape(size[1], size[0], 3)}
    return result | plane_images(tracer, built, cameras, size, style, film, steps, positions)


def guide_frame(tracer: Tracer, built: BuiltScene, cameras: tuple[Camera, Camera],
                size: tuple[int, int], style: Style,
                frame: int, rng: np.random.Generator, steps: int = 0) -> dict[str, np.ndarray]:
    """Planes (H, W, C) at output size, without motion."""
    film = film_of(size, style.offsets(frame, size[0] * size[1], rng),
                   _lens(cameras[0], size, style.spp, rng))
    planes = plane_images(tracer, built, cameras, size, style, film, steps)
    return {name: planes[name] for name in GUIDES}


def plane_images(tracer: Tracer, built: BuiltScene, cameras: tuple[Camera, Camera],
                 size: tuple[int, int], style: Style, film: Film, steps: int = 0,
                 positions: str = "") -> dict[str, np.ndarray]:
    """Planes (H, W, C) of samples in this `style`. Real-time samples share one position: one of
    them is enough."""
    spp = style.spp
    if style.kind == "realtime" and spp > 1:
        film, spp = film.first(spp), 1
    mean = (*AVERAGED, "motion") if style.kind == "blackman-harris" else AVERAGED
    planes = tracer.planes(built, *cameras, size, film, spp, mean, steps, positions)
    return {name: values.reshape(size[1], size[0], *values.shape[1:])
            for name, values in planes.items()}


def film_of(size: tuple[int, int], offsets: np.ndarray, lens: mi.Point2f | None = None) -> Film:
    """Samples at `offsets` (pixels, spp, 2) from the corners of the pixels of an image of
    `size`."""
    y, x = np.divmod(np.arange(size[0] * size[1], dtype=np.float32), size[0])
    u, v = (x[:, None] + offsets[..., 0]) / size[0], (y[:, None] + offsets[..., 1]) / size[1]
    return Film(mi.Float(u.ravel()), mi.Float(v.ravel()), lens)


def _lens(camera: Camera, size: tuple[int, int], spp: int,
          rng: np.random.Generator) -> mi.Point2f | None:
    """Random places on the camera's lens for all samples, if it has one."""
    if not camera.aperture:
        return None
    drawn = rng.random((2, size[0] * size[1] * spp), np.float32)
    return mi.Point2f(mi.Float(drawn[0]), mi.Float(drawn[1]))


def _scene(tracer: Tracer, options: ClipOptions, maps: Environments, real: RealScenes,
           rng: np.random.Generator) -> tuple[Any, ...]:
    """Draw scenes until one has a usable view."""
    while True:
        taken = real and rng.random() < options.real_share
        drafted = real.draft(rng, maps) if taken else draft(rng, maps, options.families)
        built = BuiltScene(drafted.description)
        built.move(3.5, 2.5)
        chosen = choose_path(tracer, built, drafted.view, rng, options.width, drafted.near)
        if chosen and _affordable(chosen[2].samples_for(options.reference_error, chosen[1]),
                                  options, rng):
            return drafted, built, *chosen
        del built
        gc.collect()


def other_path(tracer: Tracer, built: BuiltScene, drafted: Draft, rng: np.random.Generator,
               width: int, gain: float) -> tuple[CameraPath, Probe] | None:
    """Another view of the same scene to cut to, with its probe; None if no view is usable at this
    gain."""
    found = choose_path(tracer, built, drafted.view, rng, width, drafted.near)
    return (found[0], found[2]) if found and 0.02 < gain * found[2].level() < 2 else None


def _cut(tracer: Tracer, options: ClipOptions, drafted: Draft, built: BuiltScene, path: CameraPath,
         gain: float, rng: np.random.Generator) -> tuple[CameraPath | Cut, np.ndarray]:
    """Let a few clips cut to another view. Also returns where the history starts, (T,) uint8."""
    reset = first_only(options.frames)
    if rng.random() >= options.cut_share or options.frames < 2:
        return path, reset
    second = other_path(tracer, built, drafted, rng, options.width, gain)
    if second is None:
        return path, reset
    frame = int(rng.integers(1, options.frames))
    reset[frame] = 1
    return Cut(path, second[0], frame), reset


def _path_facts(path: CameraPath | Cut) -> dict[str, Any]:
    first = path.before if isinstance(path, Cut) else path
    return {"camera": first.kind, "amplitude": first.amplitude}


def _affordable(wanted: float, options: ClipOptions, rng: np.random.Generator) -> bool:
    """Whether to keep a scene: most of those whose references would stay noisy are dropped."""
    return wanted < 4 * options.reference_spp or rng.random() < 0.25


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1 << 31))


def _stack(frames: list[dict[str, Any]], style: Style) -> dict[str, Any]:
    planes = {name: np.stack([f[name] for f in frames]) for name in frames[0]}
    return planes | {"jitter": style.jitter, "spp": style.spp, "style": style.kind}
