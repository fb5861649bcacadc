"""One clip: a scene, a camera path, references and noisy variants of every frame."""

from __future__ import annotations

import gc
from dataclasses import asdict, dataclass

import mitsuba as mi
import numpy as np

from training.clips import GUIDES, first_only
from training.sampling import FILTERS, Style, draw_guide_style, draw_styles, filter_table
from training.scenes.build import BuiltScene
from training.scenes.draft import Draft
from training.scenes.lights import Environments
from training.scenes.motion import Camera, CameraPath, Cut
from training.scenes.procedural import draft
from training.scenes.real import RealScenes
from training.scenes.views import Probe, choose_path
from training.tracing import Film, Tracer

REPLACED = 4  # mirrors and faces of glass that planes see through, in the clips that replace primary surfaces
AVERAGED = ("diffuse_albedo", "specular_albedo", "normal", "roughness")


@dataclass(frozen=True)
class ClipOptions:
    """Sizes and counts; `scales` and `scale_chances` say how often each upscaling factor is drawn.

    A reference takes as many samples as bring its error after x/(1+x) to about `reference_error`, within half and
    four times `reference_spp`. Noisy renders have 1 to `even_spp` samples a pixel, evenly in stops, where it is given.
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


def make_clip(tracer: Tracer, options: ClipOptions, maps: Environments, real: RealScenes, seed: int,
              index: int) -> tuple[np.ndarray, list[dict], dict]:
    """Reference (T, H, W, 3), variants and facts, as `save_clip` takes them; the same for the same seed and index."""
    rng = np.random.default_rng([seed, index])
    drafted, built, path, gain, look = _scene(tracer, options, maps, real, rng)
    description = drafted.description
    path, reset = _cut(tracer, options, drafted, built, path, gain, rng)
    scale = float(rng.choice(options.scales, p=options.scale_chances))
    pixel_filter = FILTERS[int(rng.random() < 0.35)]
    styles = draw_styles(options.variants, options.frames, pixel_filter, rng, options.even_spp)
    size, output = (options.width, options.height), (round(options.width * scale), round(options.height * scale))
    wanted = look.samples_for(options.reference_error, gain)
    spp = int(np.clip(wanted, options.reference_spp / 2, 4 * options.reference_spp)) // 16 * 16 or 1
    steps = REPLACED if rng.random() < 0.5 else 0
    guide_style = draw_guide_style(options.frames, pixel_filter, rng)
    table, references, guides, variants = filter_table(pixel_filter), [], [], [[] for _ in styles]
    for frame in range(options.frames):
        built.move(frame, frame - 1)
        camera, previous = path.at(frame), path.at(frame - 1)
        references.append(gain * tracer.reference(built.scene, camera, output, table, spp, _seed(rng)))
        guides.append(guide_frame(tracer, built, (camera, previous), output, guide_style, frame, rng, steps))
        for style, frames in zip(styles, variants, strict=True):
            frames.append(noisy_frame(tracer, built, (camera, previous), size, style, frame, gain, rng, steps))
    meta = {
        "filter": pixel_filter, "gain": gain, "reference_spp": spp, "wanted_spp": wanted,
        "fov": [path.at(f).fov for f in range(options.frames)], **_path_facts(path), "movers": len(description.movers),
        "replaced": steps, "options": asdict(options),
        "to_world": [path.at(f).to_world.tolist() for f in range(options.frames)],
    }
    stacked_guides = {name: np.stack([frame[name] for frame in guides]) for name in GUIDES}
    facts = {"scale": scale, "seed": index, "scene": description.name, "meta": meta,
             "reset": reset, "guides": stacked_guides | {"jitter": guide_style.jitter}}
    stacked = [_stack(frames, style) for frames, style in zip(variants, styles, strict=True)]
    del built
    gc.collect()
    return np.stack(references), stacked, facts


def noisy_frame(tracer: Tracer, built: BuiltScene, cameras: tuple[Camera, Camera], size: tuple[int, int], style: Style,
                frame: int, gain: float, rng: np.random.Generator, steps: int = 0) -> dict[str, np.ndarray]:
    """Colour and planes (H, W, C) of one noisy frame; `cameras` are this frame's and the previous one's.

    Offline styles average the planes over the samples as renderers do, but depth is the first sample's, and so is
    motion with the box filter (an average of both sides of an edge would belong to neither).
    """
    film = film_of(size, style.offsets(frame, size[0] * size[1], rng))
    colour = tracer.noisy(built.scene, cameras[0], size[0] / size[1], film, style.spp, _seed(rng))
    result = {"colour": gain * colour.reshape(size[1], size[0], 3)}
    return result | plane_images(tracer, built, cameras, size, style, film, steps)


def guide_frame(tracer: Tracer, built: BuiltScene, cameras: tuple[Camera, Camera], size: tuple[int, int], style: Style,
                frame: int, rng: np.random.Generator, steps: int = 0) -> dict[str, np.ndarray]:
    """Planes (H, W, C) at output size, without motion."""
    film = film_of(size, style.offsets(frame, size[0] * size[1], rng))
    planes = plane_images(tracer, built, cameras, size, style, film, steps)
    return {name: planes[name] for name in GUIDES}


def plane_images(tracer: Tracer, built: BuiltScene, cameras: tuple[Camera, Camera], size: tuple[int, int],
                 style: Style, film: Film, steps: int = 0) -> dict[str, np.ndarray]:
    """Planes (H, W, C) of samples that lie as `style` says; one of real-time samples is enough, they lie together."""
    spp = style.spp
    if style.kind == "realtime" and spp > 1:
        film, spp = film.first(spp), 1
    mean = (*AVERAGED, "motion") if style.kind == "blackman-harris" else AVERAGED
    planes = tracer.planes(built, *cameras, size, film, spp, mean, steps)
    return {name: values.reshape(size[1], size[0], *values.shape[1:]) for name, values in planes.items()}


def film_of(size: tuple[int, int], offsets: np.ndarray) -> Film:
    """Samples at `offsets` (pixels, spp, 2) from the corners of the pixels of an image of `size`."""
    y, x = np.divmod(np.arange(size[0] * size[1], dtype=np.float32), size[0])
    u, v = (x[:, None] + offsets[..., 0]) / size[0], (y[:, None] + offsets[..., 1]) / size[1]
    return Film(mi.Float(u.ravel()), mi.Float(v.ravel()))


def _scene(tracer: Tracer, options: ClipOptions, maps: Environments, real: RealScenes,
           rng: np.random.Generator) -> tuple:
    """Draw scenes until one has a view of use."""
    while True:
        drafted = real.draft(rng, maps) if real and rng.random() < options.real_share else draft(rng, maps)
        built = BuiltScene(drafted.description)
        built.move(3.5, 2.5)
        chosen = choose_path(tracer, built, drafted.view, rng, options.width, drafted.near)
        if chosen and _affordable(chosen[2].samples_for(options.reference_error, chosen[1]), options, rng):
            return drafted, built, *chosen
        del built
        gc.collect()


def other_path(tracer: Tracer, built: BuiltScene, drafted: Draft, rng: np.random.Generator, width: int,
               gain: float) -> tuple[CameraPath, Probe] | None:
    """Another view of a scene, to cut to, and a look from it; None where none is of use at this gain."""
    found = choose_path(tracer, built, drafted.view, rng, width, drafted.near)
    return (found[0], found[2]) if found and 0.02 < gain * found[2].level() < 2 else None


def _cut(tracer: Tracer, options: ClipOptions, drafted: Draft, built: BuiltScene, path: CameraPath, gain: float,
         rng: np.random.Generator) -> tuple[CameraPath | Cut, np.ndarray]:
    """Few clips go on from another view; also where the history starts, (T,) uint8."""
    reset = first_only(options.frames)
    if rng.random() >= options.cut_share or options.frames < 2:
        return path, reset
    second = other_path(tracer, built, drafted, rng, options.width, gain)
    if second is None:
        return path, reset
    frame = int(rng.integers(1, options.frames))
    reset[frame] = 1
    return Cut(path, second[0], frame), reset


def _path_facts(path: CameraPath | Cut) -> dict:
    first = path.before if isinstance(path, Cut) else path
    return {"camera": first.kind, "amplitude": first.amplitude}


def _affordable(wanted: float, options: ClipOptions, rng: np.random.Generator) -> bool:
    """Most scenes whose references would stay noisy are dropped."""
    return wanted < 4 * options.reference_spp or rng.random() < 0.25


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1 << 31))


def _stack(frames: list[dict], style: Style) -> dict:
    planes = {name: np.stack([f[name] for f in frames]) for name in frames[0]}
    return planes | {"jitter": style.jitter, "spp": style.spp, "style": style.kind}
